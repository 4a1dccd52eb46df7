//! D-K iteration through its public interface.

use std::cell::Cell;
use std::f64::consts::{PI, TAU};

use nalgebra::{DMatrix, dmatrix};
use num_complex::Complex64;
use telepulse_design::Error;
use telepulse_design::synthesize::dk::{
    DkDesign, DkOptions, DkStages, DkStop, FittedScales, FullBlock, FullBlocks, RationalScale, ScaleSample,
    ScaledGain, SynthesizedController, dk_iteration, dk_iteration_with, scaled_gain,
};
use telepulse_design::synthesize::{HinfOptions, MixedSensitivityWeights, hinfsyn, mixed_sensitivity};
use telepulse_lti::{Continuous, Diagram, GeneralizedPlant, StateSpace, TransferFunction};

use crate::printed;

fn tf(numerator: &[f64], denominator: &[f64]) -> StateSpace<Continuous> {
    TransferFunction::new(numerator, denominator).expect("proper").to_state_space()
}

fn print(design: &DkDesign) {
    for (k, h) in design.history.iter().enumerate() {
        println!(
            "{k}: gamma {:.4}, mu sampled {:.4} at {:.3e}, proven {:.4}, order {}, scales {:?}, fit {:.3}",
            h.gamma,
            h.mu_peak_sampled,
            h.omega_peak_rad_s,
            h.mu_peak_proven,
            h.controller_order,
            h.scale_orders,
            h.fit_excess
        );
    }
    let reduced = design.reduced.as_ref().map(|r| (r.controller.n_states(), r.mu_peak_proven));
    println!("best {} {:.4} {:?} reduced {reduced:?}", design.best_idx, design.mu_peak_proven, design.stop);
}

/// Skogestad and Postlethwaite 2005, section 8.12.4.
fn distillation() -> GeneralizedPlant {
    let gain = dmatrix![87.8, -86.4; 108.2, -109.6];
    let lag = dmatrix![-1.0, 0.0; 0.0, -1.0] / 75.0;
    let g = StateSpace::<Continuous>::new(
        lag,
        gain / 75.0,
        dmatrix![1.0, 0.0; 0.0, 1.0],
        dmatrix![0.0, 0.0; 0.0, 0.0],
    );
    let g = g.expect("fits");
    let wi = tf(&[1.0, 0.2], &[0.5, 1.0]);
    let wp = tf(&[0.5, 0.05], &[1.0, 1e-6]);
    let (wi, wp) = (wi.augment(&wi).expect("fits"), wp.augment(&wp).expect("fits"));
    Diagram::new()
        .external_inputs([("delta", 2), ("d", 2), ("u", 2)])
        .block(&wi, ["u"], [("to_delta", 2)])
        .sum("into_g = u + delta")
        .block(&g, ["into_g"], [("p", 2)])
        .sum("e = p + d")
        .block(&wp, ["e"], [("z", 2)])
        .sum("v = -e")
        .external_outputs(["to_delta", "z", "v"])
        .connect()
        .expect("no loop")
        .generalized_plant(&["u"], &["v"])
        .expect("ports")
}

#[test]
fn oracle_distillation_column_reaches_the_published_d_k_steps() {
    let blocks = FullBlocks::new(vec![FullBlock { n_w: 2, n_z: 2 }; 2]).expect("valid");
    let design = dk_iteration(&distillation(), &blocks, &DkOptions::default()).expect("feasible");
    print(&design);
    // The book: 1.1818 for plain H-infinity (with the scale of its start), 1.0238 and 1.019 after two and three D-K steps;
    // 0.974 is the optimum that a search over scales by hand found.
    assert!(design.history[0].mu_peak_proven < 1.2);
    assert!(design.mu_peak_proven < 1.024, "{}", design.mu_peak_proven);
    // Off the grid too, by free scales, which cannot lie above the proof.
    for k in 0..400 {
        let omega = 1e-7 * 10_f64.powf(f64::from(k) / 40.0) * 1.013;
        let here =
            scaled_gain(&design.closed_loop.at(omega).expect("stable"), &blocks).expect("finite").value;
        assert!(here <= design.mu_peak_proven * (1.0 + 1e-9), "{here} at {omega}");
    }
    let reduced = design.reduced.expect("a smaller controller does");
    assert!(reduced.controller.n_states() < design.controller.n_states());
    assert!(reduced.mu_peak_proven <= design.mu_peak_proven * 1.01);
    let closed = distillation().lower_lft(&reduced.controller).expect("fits");
    assert!(closed.is_stable().expect("poles"));
}

/// The paper's loop: from `(delta, r, u)` to `(W_s u, W_e e, effort W_u u, e)`, performance divided by `level`.
fn uncertain_paper_loop(level: f64, effort: f64) -> GeneralizedPlant {
    let (g, ws) = (printed::g().to_state_space(), printed::ws().to_state_space());
    let we = printed::we().to_state_space().scale(1.0 / level).expect("finite");
    let wu = printed::wu().to_state_space().scale(effort / level).expect("finite");
    let named = Diagram::new()
        .external_inputs([("delta", 1), ("r", 1), ("u", 1)])
        .block(&g, ["u"], [("p", 1)])
        .sum("e = r - p - delta")
        .block(&ws, ["u"], [("to_delta", 1)])
        .block(&we, ["e"], [("ze", 1)])
        .block(&wu, ["u"], [("zu", 1)])
        .external_outputs(["to_delta", "ze", "zu", "e"])
        .connect();
    named.expect("no loop").generalized_plant(&["u"], &["e"]).expect("ports")
}

fn paper_blocks() -> FullBlocks {
    FullBlocks::new(vec![FullBlock { n_w: 1, n_z: 1 }, FullBlock { n_w: 1, n_z: 2 }]).expect("valid")
}

/// Magnitudes of `S` and `K S` for the worst of 720 perturbations of size one, each closed around the perturbed plant.
fn worst(k: Complex64, omega: f64) -> [f64; 2] {
    let (g, ws) = (printed::g().at(omega), printed::ws().at(omega));
    (0..720).fold([0.0_f64; 2], |worst, step| {
        let delta = Complex64::from_polar(1.0, TAU * f64::from(step) / 720.0);
        let s = 1.0 / (1.0 + (g + ws * delta) * k);
        [worst[0].max(s.norm()), worst[1].max((s * k).norm())]
    })
}

#[test]
fn paper_d_k_lowers_the_worst_error_of_the_loop_under_ws_at_equal_control_effort() {
    let weights = MixedSensitivityWeights { we: &printed::we(), wu: &printed::wu(), wt: None };
    let plain = mixed_sensitivity(&printed::g(), &weights).expect("stable weights");
    let plain = hinfsyn(&plain, &HinfOptions { backoff: 1.003, ..HinfOptions::default() }).expect("feasible");
    // The plain loop's worst weighted cost is 0.406; effort weighted by 1.2 gives the same peak of K S as the plain loop.
    // The joint problem is not convex: at some levels the iteration stalls at its start, so several are tried, as the example does.
    let designs = [0.36, 0.38, 0.40634, 0.43].map(|level| {
        let plant = uncertain_paper_loop(level, 1.2);
        dk_iteration(&plant, &paper_blocks(), &DkOptions::default()).expect("feasible")
    });
    designs.iter().for_each(print);
    let judge = |k: &StateSpace<Continuous>| {
        let (mut cost, mut effort) = (0.0_f64, 0.0_f64);
        for step in 0..=1600 {
            let omega = 1e-3 * 10_f64.powf(f64::from(step) / 200.0);
            let [s, ks] = worst(k.at(omega).expect("no pole")[(0, 0)], omega);
            let (we, wu) = (printed::we().at(omega).norm(), printed::wu().at(omega).norm());
            cost = cost.max((we * s).hypot(wu * ks));
            effort = effort.max(ks);
        }
        // Eq. (25): three sines, mm and rad/s.
        let power = [(0.2, 0.4 * PI), (0.2, 0.1 * PI), (0.1, 0.8 * PI)].map(|(amplitude, omega)| {
            0.5 * (amplitude * worst(k.at(omega).expect("no pole")[(0, 0)], omega)[0]).powi(2)
        });
        [cost, effort, power.iter().sum::<f64>().sqrt()]
    };
    let before = judge(&plain.controller);
    let judged = designs.iter().map(|design| judge(&design.controller));
    let after = judged.min_by(|a, b| a[0].total_cmp(&b[0])).expect("four");
    println!("worst cost, effort, rms error in mm: {before:?} -> {after:?}");
    // Measured: cost 0.406 -> 0.376, rms 0.01646 -> 0.01512 mm, effort 1.437 -> 1.416.
    assert!(after[0] < 0.96 * before[0] && after[2] < 0.95 * before[2]);
    assert!(after[1] < 1.02 * before[1]);
}

#[test]
fn law_the_best_controller_is_kept_and_one_block_is_plain_synthesis() {
    let plant = uncertain_paper_loop(0.4, 1.0);
    let design =
        dk_iteration(&plant, &paper_blocks(), &DkOptions { iterations_max: 5, ..DkOptions::default() });
    let design = design.expect("feasible");
    print(&design);
    let least = design.history.iter().map(|h| h.mu_peak_proven).fold(f64::INFINITY, f64::min);
    assert_eq!(design.mu_peak_proven, least);
    assert_eq!(design.history[design.best_idx].mu_peak_proven, least);
    assert!(design.history[0].scale_orders.iter().all(|&order| order == 0));
    assert!(design.history.iter().all(|h| h.mu_peak_sampled <= h.mu_peak_proven * (1.0 + 1e-6)));

    let whole = FullBlocks::new(vec![FullBlock { n_w: 2, n_z: 3 }]).expect("valid");
    let one = dk_iteration(&plant, &whole, &DkOptions::default()).expect("feasible");
    let options = DkOptions::default().hinf;
    let plain = hinfsyn(&plant, &options).expect("feasible");
    assert_eq!((one.history.len(), one.stop), (1, DkStop::NoImprovement));
    assert!((one.mu_peak_proven / plain.achieved.upper - 1.0).abs() < 1e-8);
}

#[test]
fn law_stages_can_be_replaced_and_a_poor_one_makes_no_wrong_claim() {
    let plant = uncertain_paper_loop(0.4, 1.0);
    let calls = Cell::new(0);
    let controller = |scaled: &GeneralizedPlant| {
        calls.set(calls.get() + 1);
        let design = hinfsyn(scaled, &HinfOptions::default())?;
        // A lie: only the proof counts.
        Ok(SynthesizedController { controller: design.controller, gamma: 1e-3 })
    };
    let analysis = |m: &DMatrix<Complex64>, blocks: &FullBlocks| scaled_gain(m, blocks);
    let fit = |_: &[ScaleSample], _: &FullBlocks| {
        let scales = vec![RationalScale::constant(5.0)?, RationalScale::constant(1.0)?];
        Ok(FittedScales { scales, excess: 1.0 })
    };
    let stages = DkStages { controller: &controller, analysis: &analysis, fit: &fit };
    let options = DkOptions { iterations_max: 2, ..DkOptions::default() };
    let design = dk_iteration_with(&plant, &paper_blocks(), &options, &stages).expect("feasible");
    assert_eq!(calls.get(), design.history.len());
    let sampled = (0..200).map(|k| {
        let omega = 1e-2 * 10_f64.powf(f64::from(k) / 40.0);
        scaled_gain(&design.closed_loop.at(omega).expect("stable"), &paper_blocks()).expect("finite").value
    });
    assert!(design.mu_peak_proven * (1.0 + 1e-9) >= sampled.fold(0.0, f64::max));

    let wrong = |_: &DMatrix<Complex64>, _: &FullBlocks| {
        Ok(ScaledGain { value: 1.0, scales: vec![f64::NAN, 1.0], relative_gap: 0.0 })
    };
    let stages = DkStages { analysis: &wrong, ..stages };
    assert!(matches!(
        dk_iteration_with(&plant, &paper_blocks(), &options, &stages),
        Err(Error::StageScales { stage: "analysis", expected: 2, found: 1 })
    ));
}

#[test]
fn edge_blocks_grids_and_plants_that_do_not_fit() {
    let plant = uncertain_paper_loop(0.4, 1.0);
    let square = FullBlocks::new(vec![FullBlock { n_w: 1, n_z: 1 }; 2]).expect("valid");
    assert!(matches!(
        dk_iteration(&plant, &square, &DkOptions::default()),
        Err(Error::System(telepulse_lti::Error::PortCount { expected: 3, found: 2, .. }))
    ));
    for grid in [vec![], vec![f64::NAN], vec![2.0, 1.0], vec![-1.0]] {
        let options = DkOptions { omega_rad_s: Some(grid), ..DkOptions::default() };
        assert!(matches!(
            dk_iteration(&plant, &paper_blocks(), &options),
            Err(Error::EmptyList { .. } | Error::OutOfRange { .. })
        ));
    }
    let mut options = DkOptions::default();
    options.fit.order_max = 9;
    assert!(matches!(dk_iteration(&plant, &paper_blocks(), &options), Err(Error::OutOfRange { .. })));
    // One frequency only: a poor grid costs performance, never the claim.
    let options = DkOptions { omega_rad_s: Some(vec![10.0]), iterations_max: 2, ..DkOptions::default() };
    let design = dk_iteration(&plant, &paper_blocks(), &options).expect("feasible");
    assert!(design.mu_peak_proven <= design.history[0].mu_peak_proven);
}
