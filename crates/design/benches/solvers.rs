//! Time of every solver of this crate, over the number of states, blocks or terms.
//!
//! `cargo bench -p telepulse-design` runs all of it; `-- h2syn` only what contains that word. Random plants
//! from one seed, drawn like those of `benches/versus_slycot_hinfsyn.py`, which times a peer at the same sizes.

#![allow(missing_docs, clippy::approx_constant)]

use std::f64::consts::TAU;
use std::fmt::Display;
use std::hint::black_box;
use std::time::Duration;

use criterion::measurement::WallTime;
use criterion::{BenchmarkGroup, BenchmarkId, Criterion, criterion_group, criterion_main};
use nalgebra::DMatrix;
use num_complex::Complex64;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use telepulse_design::implement::reduce_controller;
use telepulse_design::synthesize::dk::{DkOptions, FullBlock, FullBlocks, dk_iteration};
use telepulse_design::synthesize::pid::{
    DelayedPlant, MarginTarget, MarginTerms, PidLimits, PidStructure, maximize_integral_gain,
    tune_phase_margin,
};
use telepulse_design::synthesize::{HinfOptions, LoopShape, h2syn, hinfsyn, hinfsyn_discrete, ncfsyn};
use telepulse_design::uncertain::{Block, BlockStructure, MuLowerOptions, mu_bounds, mu_peak};
use telepulse_lti::{
    Continuous, Diagram, Discrete, GeneralizedPlant, SampleTime, StateSpace, TransferFunction,
};

const SIZES: [usize; 5] = [2, 5, 10, 20, 50];
const SEED: u64 = 5;

type System = StateSpace<Continuous>;

/// Standard normal entries, by Box and Muller.
fn normal(rng: &mut Pcg64, rows: usize, cols: usize) -> DMatrix<f64> {
    DMatrix::from_fn(rows, cols, |_, _| {
        let (u, v): (f64, f64) = (rng.random_range(f64::MIN_POSITIVE..1.0), rng.random_range(0.0..1.0));
        (-2.0 * u.ln()).sqrt() * (TAU * v).cos()
    })
}

/// A normal matrix, shifted until its rightmost eigenvalue has the real part -0.5.
fn stable(rng: &mut Pcg64, n: usize) -> DMatrix<f64> {
    let a = normal(rng, n, n);
    let rightmost = a.complex_eigenvalues().iter().map(|l| l.re).fold(f64::NEG_INFINITY, f64::max);
    a - DMatrix::identity(n, n) * (rightmost + 0.5)
}

/// `(n_w, n_u, n_z, n_y) = (3, 2, 3, 2)`, `D11 = 0`, `D22 = 0`.
fn plant(n: usize) -> GeneralizedPlant {
    let mut rng = Pcg64::seed_from_u64(SEED + n as u64);
    let a = stable(&mut rng, n);
    let (b, c, mut d) = (normal(&mut rng, n, 5), normal(&mut rng, 5, n), normal(&mut rng, 5, 5));
    d.view_mut((0, 0), (3, 3)).fill(0.0);
    d.view_mut((3, 3), (2, 2)).fill(0.0);
    let sys = System::new(a, b, c, d).expect("shapes fit");
    GeneralizedPlant::new(sys, 3, 2, 3, 2).expect("ports fit")
}

fn sampled(plant: &GeneralizedPlant) -> GeneralizedPlant<Discrete> {
    let sample_time = SampleTime::new(0.1).expect("positive");
    let sys = plant.sys().to_discrete_zoh(sample_time).expect("finite");
    GeneralizedPlant::new(sys, 3, 2, 3, 2).expect("ports fit")
}

fn group<'a>(criterion: &'a mut Criterion, name: &str) -> BenchmarkGroup<'a, WallTime> {
    let mut group = criterion.benchmark_group(name);
    group
        .sample_size(10)
        .warm_up_time(Duration::from_millis(100))
        .measurement_time(Duration::from_millis(500));
    group
}

/// Times `solve` on every problem, each named by its label, after making sure that it has an answer.
fn over<P>(
    criterion: &mut Criterion,
    name: &str,
    problems: impl IntoIterator<Item = (impl Display, P)>,
    solve: impl Fn(&P) -> bool,
) {
    let mut group = group(criterion, name);
    for (label, problem) in problems {
        assert!(solve(&problem), "{name} has no answer for {label}");
        group.bench_with_input(BenchmarkId::from_parameter(label), &problem, |bencher, problem| {
            bencher.iter(|| black_box(solve(black_box(problem))));
        });
    }
    group.finish();
}

fn synthesis(criterion: &mut Criterion) {
    let options = HinfOptions::default();
    let plants = || SIZES.map(|n| (n, plant(n)));
    over(criterion, "hinfsyn", plants(), |p| hinfsyn(p, &options).is_ok());
    over(criterion, "hinfsyn_discrete", plants().map(|(n, p)| (n, sampled(&p))), |p| {
        hinfsyn_discrete(p, &options).is_ok()
    });
    over(criterion, "h2syn", plants(), |p| h2syn(p).is_ok());
    let measured = plants().map(|(n, p)| (n, p.sys().select(&[3, 4], &[3, 4]).expect("ports exist")));
    over(criterion, "ncfsyn", measured, |g| ncfsyn(g, &LoopShape::default(), 1.1).is_ok());
}

fn controller_order(criterion: &mut Criterion) {
    let designed = [5, 10, 20].map(|n| {
        let plant = plant(n);
        let k = hinfsyn(&plant, &HinfOptions::default()).expect("feasible").controller;
        (n, (plant, k))
    });
    over(criterion, "reduce_controller", designed, |(plant, k)| reduce_controller(plant, k, 0.2).is_ok());
}

/// Full 2 × 2 blocks; with `real`, every other one is a parameter that enters twice.
fn blocks(count: usize, real: bool) -> BlockStructure {
    let block = |k: usize| match real && k.is_multiple_of(2) {
        true => Block::RepeatedReal { size: 2 },
        false => Block::Full { rows: 2, cols: 2 },
    };
    BlockStructure::new((0..count).map(block).collect()).expect("not empty")
}

fn structured_singular_value(criterion: &mut Criterion) {
    for (name, real) in [("mu_bounds_complex", false), ("mu_bounds_mixed", true)] {
        let problems = [2, 4, 8].map(|count| {
            let mut rng = Pcg64::seed_from_u64(SEED + count as u64);
            let m = normal(&mut rng, 2 * count, 2 * count)
                .zip_map(&normal(&mut rng, 2 * count, 2 * count), Complex64::new);
            (count, (m, blocks(count, real)))
        });
        over(criterion, name, problems, |(m, structure)| {
            mu_bounds(m, structure, &MuLowerOptions::default()).is_ok()
        });
    }
    let systems = [2, 5, 10].map(|n| {
        let mut rng = Pcg64::seed_from_u64(SEED + n as u64);
        let a = stable(&mut rng, n);
        let (b, c) = (normal(&mut rng, n, 4), normal(&mut rng, 4, n));
        (n, System::new(a, b, c, DMatrix::zeros(4, 4)).expect("shapes fit"))
    });
    let structure = blocks(2, true);
    over(criterion, "mu_peak", systems, |sys| mu_peak(sys, &structure, 1e-3).is_ok());
}

fn tf(numerator: &[f64], denominator: &[f64]) -> TransferFunction {
    TransferFunction::new(numerator, denominator).expect("proper")
}

/// Eqs. (16) and (17): the plant and the weight of its uncertainty.
fn paper() -> (TransferFunction, TransferFunction) {
    (tf(&[1350.14], &[0.0045, 1.07182, 22.458, 1444.0]), tf(&[487.5], &[1.0, 45.0, 2500.0]))
}

/// From `(delta, r, u)` to `(W_s u, W_e e, W_u u, e)` with `e = r - G u - delta`; weights (17), (19), (20).
fn paper_uncertain() -> GeneralizedPlant {
    let (g, ws) = paper();
    let (g, ws) = (g.to_state_space(), ws.to_state_space());
    let wu = tf(&[0.1, 0.000_628_3], &[0.0001, 62.83]).to_state_space();
    let we = tf(&[0.2, 6.283], &[1.0, 0.000_628_3]).to_state_space();
    Diagram::new()
        .external_inputs([("delta", 1), ("r", 1), ("u", 1)])
        .block(&g, ["u"], [("p", 1)])
        .sum("e = r - p - delta")
        .block(&ws, ["u"], [("to_delta", 1)])
        .block(&we, ["e"], [("ze", 1)])
        .block(&wu, ["u"], [("zu", 1)])
        .external_outputs(["to_delta", "ze", "zu", "e"])
        .connect()
        .and_then(|named| named.generalized_plant(&["u"], &["e"]))
        .expect("a well-posed diagram")
}

fn dk(criterion: &mut Criterion) {
    let blocks = FullBlocks::new(vec![FullBlock { n_w: 1, n_z: 1 }, FullBlock { n_w: 1, n_z: 2 }])
        .expect("blocks with ports");
    // One controller after the first: the whole iteration is a multiple of this.
    let options = DkOptions { iterations_max: 1, ..DkOptions::default() };
    over(criterion, "dk_iteration", [("paper_two_controllers", paper_uncertain())], |plant| {
        dk_iteration(plant, &blocks, &options).is_ok()
    });
}

fn pid(criterion: &mut Criterion) {
    let (g, _) = paper();
    let plants = || {
        let delayed = |g: &TransferFunction, delay_s| DelayedPlant::new(g.clone(), delay_s).expect("valid");
        let lags = tf(&[1.0], &[1.0, 3.0, 3.0, 1.0]);
        [
            ("three_lags", delayed(&lags, 0.0)),
            ("three_lags_delayed", delayed(&lags, 0.5)),
            ("paper", delayed(&g, 0.0)),
        ]
    };
    over(criterion, "maximize_integral_gain_pi", plants(), |plant| {
        maximize_integral_gain(plant, PidStructure::Pi, &PidLimits::default()).is_ok()
    });
    // Lags alone from here on: for the paper's plant `tune_phase_margin` with PI returns an error at the default target, and a PID
    // under its weight took about 5 s a call.
    let lags = || plants().into_iter().take(2);
    over(criterion, "maximize_integral_gain_pid", lags(), |plant| {
        maximize_integral_gain(plant, PidStructure::Pid { n_rad_s: 10.0 }, &PidLimits::default()).is_ok()
    });
    for (name, terms) in
        [("tune_phase_margin_pi", MarginTerms::Pi), ("tune_phase_margin_pidf", MarginTerms::Pidf)]
    {
        over(criterion, name, lags(), |plant| {
            tune_phase_margin(plant, terms, &MarginTarget::default()).is_ok()
        });
    }
}

criterion_group!(benches, synthesis, controller_order, structured_singular_value, dk, pid);
criterion_main!(benches);
