//! Parameters in ranges and unmodelled dynamics: the systems that are made of them, and their margins.

use nalgebra::{DMatrix, dmatrix};
use num_complex::Complex64;
use rand::{RngExt, SeedableRng};
use telepulse_design::Error;
use telepulse_design::uncertain::{
    Block, BlockValue, DescriptorSystem, ParameterRange, ParametricSystem, Perturbation, RangeEnds,
    UncertainDynamics, UncertainSystem,
};
use telepulse_lti::{Continuous, StateSpace, TransferFunction, hinf_norm};

fn range(name: &str, lower: f64, upper: f64) -> ParameterRange {
    ParameterRange::new(name, lower, upper).expect("a range")
}

/// `m x'' + c x' + k x = u`, `y = x`, for `p = [m, c, k]`.
fn mass_on_a_spring(p: &[f64]) -> Result<DescriptorSystem, Error> {
    DescriptorSystem::new(
        dmatrix![1.0, 0.0; 0.0, p[0]],
        dmatrix![0.0, 1.0; -p[2], -p[1]],
        dmatrix![0.0; 1.0],
        dmatrix![1.0, 0.0],
        dmatrix![0.0],
    )
}

fn plain(a: DMatrix<f64>, b: DMatrix<f64>, c: DMatrix<f64>) -> Result<DescriptorSystem, Error> {
    let d = DMatrix::zeros(c.nrows(), b.ncols());
    Ok(StateSpace::<Continuous>::new(a, b, c, d)?.into())
}

#[test]
fn law_a_mass_on_a_spring_is_reproduced_at_random_parameters() {
    let seed = 73;
    let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
    // In SI units, and with a mass in mg and a stiffness in N/m that differ by nine decades.
    for (m, c, k) in [(1.0, 0.3, 1.0), (2e-6, 3e-4, 4e3)] {
        let ranges =
            vec![range("m", 0.8 * m, 1.3 * m), range("c", 0.1 * c, 2.0 * c), range("k", 0.8 * k, 1.2 * k)];
        let plant = ParametricSystem::from_model(ranges.clone(), mass_on_a_spring).expect("affine");
        assert_eq!(plant.system().structure().blocks(), [Block::RepeatedReal { size: 1 }; 3]);
        let mut worst = 0.0_f64;
        for _ in 0..500 {
            // Inside of the ranges and half a width outside of them.
            let p: Vec<f64> = ranges.iter().map(|r| r.value(rng.random_range(-1.5..1.5))).collect();
            let omega = (k / m).sqrt() * 10f64.powf(rng.random_range(-2.0..2.0));
            let exact = Complex64::new(p[2] - p[0] * omega * omega, p[1] * omega).inv();
            let found = plant.at(&p).expect("well posed").at(omega).expect("no pole")[(0, 0)];
            worst = worst.max((found / exact - 1.0).norm());
        }
        println!("seed {seed}: mass {m}: largest relative error {worst:e}");
        // Near the resonance of a damping ratio of 0.01, k - m w² loses two digits to cancellation.
        assert!(worst < 1e-10, "seed {seed}: {worst:e}");
    }
}

#[test]
fn law_a_block_is_as_large_as_the_rank_of_its_parameter_in_any_units() {
    // Two carts on a spring k between them (rank one), the same damper c on each to the ground (rank two).
    let carts = |p: &[f64], unit: f64| {
        let (k, c) = (p[0], p[1]);
        let a = dmatrix![
            0.0, 0.0, 1.0, 0.0; 0.0, 0.0, 0.0, 1.0;
            -k, k, -c, 0.0; k, -k, 0.0, -c];
        // The second cart's position and speed in another unit.
        let units = DMatrix::from_diagonal(&nalgebra::dvector![1.0, unit, 1.0, unit]);
        let back = DMatrix::from_diagonal(&nalgebra::dvector![1.0, 1.0 / unit, 1.0, 1.0 / unit]);
        let (b, row) = (dmatrix![0.0; 0.0; 1.0; 0.0], dmatrix![0.0, 1.0, 0.0, 0.0]);
        plain(&units * a * &back, &units * b, row * &back)
    };
    for unit in [1.0, 1e9, 3e-11] {
        let ranges = vec![range("k", 1.0, 3.0), range("c", 0.1, 0.2)];
        let plant = ParametricSystem::from_model(ranges, |p| carts(p, unit)).expect("affine");
        let expected = [Block::RepeatedReal { size: 1 }, Block::RepeatedReal { size: 2 }];
        assert_eq!(plant.system().structure().blocks(), expected, "unit {unit:e}");
        let p = [1.7, 0.13];
        let s = Complex64::new(0.0, 0.9);
        let own = s * s + p[1] * s + p[0];
        let exact = p[0] / (own * own - p[0] * p[0]);
        let found = plant.at(&p).expect("well posed").at(0.9).expect("no pole")[(0, 0)];
        assert!((found / exact - 1.0).norm() < 1e-12, "unit {unit:e}: {found} {exact}");
    }
}

#[test]
fn oracle_the_margin_of_a_stiffness_is_the_one_of_hurwitz() {
    // s³ + a s² + b s + k: stable for 0 < k < a b, lost at s = 0 or at s = j sqrt(b).
    for (a, b) in [(2.0, 0.7), (1.0, 1.3), (0.9, 4.0), (5.0, 3.0)] {
        let model = |p: &[f64]| {
            plain(
                dmatrix![0.0, 1.0, 0.0; 0.0, 0.0, 1.0; -p[0], -b, -a],
                dmatrix![0.0; 0.0; 1.0],
                dmatrix![1.0, 0.0, 0.0],
            )
        };
        let plant = ParametricSystem::from_model(vec![range("k", 0.8, 1.2)], model).expect("affine");
        let margin = plant.system().robust_stability_margin(1e-6).expect("proven");
        let exact = f64::min(1.0, a * b - 1.0) / 0.2;
        println!("a {a}, b {b}: {} .. {} of {exact}", margin.lower, margin.upper);
        // Two tolerances: that of the level and that of the search beside the jump.
        assert!((margin.lower / exact - 1.0).abs() < 2e-6 && margin.lower <= exact, "{margin:?}");
        assert!((margin.upper / exact - 1.0).abs() < 1e-6, "{margin:?}");
        let worst = margin.peak.lower.perturbation.as_ref().expect("found");
        let k = plant.values(worst).expect("real")[0];
        let destabilizing = if a * b < 2.0 { a * b } else { 0.0 };
        assert!((k - destabilizing).abs() < 1e-6, "{k} {destabilizing}");
    }
}

#[test]
fn law_no_sampled_mass_damper_and_stiffness_beats_the_margin() {
    // A mass on a spring under PI control with a lag: stable at the centre, not for all parameters.
    let ranges = vec![range("m", 0.8, 1.2), range("c", 0.3, 0.5), range("k", 0.8, 1.2)];
    let plant = ParametricSystem::from_model(ranges.clone(), mass_on_a_spring).expect("affine");
    let k = TransferFunction::new(&[0.35, 0.15], &[0.2, 1.0, 0.0]).expect("proper").to_state_space();
    let margin = plant.system().feedback(&k).expect("fits").robust_stability_margin(1e-3).expect("proven");
    println!("margin {} .. {}", margin.lower, margin.upper);
    // Characteristic polynomial of the loop by hand: (m s² + c s + k)(0.2 s² + s) + 0.35 s + 0.15.
    let stable = |p: &[f64]| {
        let (a4, a3, a2, a1, a0) = (0.2 * p[0], p[0] + 0.2 * p[1], p[1] + 0.2 * p[2], p[2] + 0.35, 0.15);
        // Liénard and Chipart.
        [a4, a3, a2, a1, a0].iter().all(|&v| v > 0.0) && a1 * (a2 * a3 - a1 * a4) > a3 * a3 * a0
    };
    let seed = 79;
    let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
    let (mut kept, mut smallest) = (0, f64::INFINITY);
    for _ in 0..100_000 {
        let deltas: Vec<f64> = (0..3).map(|_| rng.random_range(-1.0..=1.0)).collect();
        let size = rng.random_range(0.0..2.0 * margin.lower);
        let at =
            |size: f64| -> Vec<f64> { ranges.iter().zip(&deltas).map(|(r, &d)| r.value(d * size)).collect() };
        let norm = size * deltas.iter().fold(0.0_f64, |a, d| a.max(d.abs()));
        if stable(&at(size)) {
            kept += 1;
        } else {
            smallest = smallest.min(norm);
        }
    }
    println!("seed {seed}: {kept} of 100000 stable, smallest perturbation that is not {smallest}");
    assert!(smallest >= margin.lower, "seed {seed}: {smallest} {margin:?}");
    assert!(smallest.is_finite() && smallest < 1.1 * margin.lower, "seed {seed}: {smallest} {margin:?}");
}

#[test]
fn law_no_sampled_parameter_beats_the_worst_case_gain() {
    let ranges = vec![range("m", 0.9, 1.1), range("c", 0.3, 0.5), range("k", 0.8, 1.2)];
    let plant = ParametricSystem::from_model(ranges.clone(), mass_on_a_spring).expect("affine");
    let worst = plant.system().worst_case_gain(1e-2).expect("proven");
    let seed = 83;
    let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
    // Peak of 1/(m s² + c s + k), largest at the least c: 1 / (c sqrt(k/m - c²/(4 m²))).
    let peak = |p: &[f64]| 1.0 / (p[1] * (p[2] / p[0] - p[1] * p[1] / (4.0 * p[0] * p[0])).sqrt());
    let corner = peak(&[1.1, 0.3, 0.8]);
    let mut seen = 0.0_f64;
    for _ in 0..100_000 {
        let p: Vec<f64> = ranges.iter().map(|r| r.value(rng.random_range(-1.0..=1.0))).collect();
        seen = seen.max(peak(&p));
    }
    println!("seed {seed}: sampled {seen}, corner {corner}, bounds {} .. {}", worst.lower, worst.upper);
    assert!(seen <= worst.upper && corner <= worst.upper && worst.upper < 1.02 * corner, "seed {seed}");
    assert!(worst.lower <= corner * (1.0 + 1e-9) && worst.lower > 0.95 * corner, "seed {seed}");
}

#[test]
fn oracle_dynamics_of_one_channel_bear_what_the_small_gain_theorem_says() {
    let g = TransferFunction::new(&[2.0], &[1.0, 0.6, 1.0]).expect("proper").to_state_space();
    let k = TransferFunction::new(&[0.3, 0.1], &[1.0, 0.0]).expect("proper").to_state_space();
    let w = TransferFunction::new(&[1.0, 0.2], &[0.1, 1.0]).expect("proper").to_state_space();
    let closed = k.series(&g).expect("fits");
    let one = TransferFunction::from_gain(1.0).expect("finite").to_state_space();
    let t = closed.feedback(&one).expect("well posed");
    let ks = k.feedback(&g).expect("well posed");
    for (place, function) in [
        (UncertainDynamics::InputMultiplicative, &t),
        (UncertainDynamics::OutputMultiplicative, &t),
        (UncertainDynamics::Additive, &ks),
    ] {
        let norm = hinf_norm(&function.series(&w).expect("fits")).expect("stable").value;
        let plant = UncertainSystem::with_dynamics(&g, &w, place).expect("fits");
        let margin = plant.feedback(&k).expect("fits").robust_stability_margin(1e-6).expect("proven");
        println!("{place:?}: {} .. {} of {}", margin.lower, margin.upper, 1.0 / norm);
        assert!((margin.lower * norm - 1.0).abs() < 3e-6, "{place:?}: {margin:?} {norm}");
        assert!((margin.upper * norm - 1.0).abs() < 1e-6, "{place:?}: {margin:?} {norm}");
    }
}

#[test]
fn law_dynamics_around_parameters_are_the_formula_at_every_value() {
    // Two inputs, one output, one parameter; a full weight from two signals to three.
    let model = |p: &[f64]| plain(dmatrix![-p[0]], dmatrix![1.0, p[0]], dmatrix![1.0]);
    let plant = ParametricSystem::from_model(vec![range("p", 1.0, 2.0)], model).expect("affine");
    let w = StateSpace::<Continuous>::new(
        dmatrix![-3.0],
        dmatrix![1.0, 0.5],
        dmatrix![1.0; -0.3; 0.2],
        dmatrix![0.1, 0.0; 0.0, 0.2; 0.3, 0.0],
    )
    .expect("valid");
    let (p, omega) = (1.8, 1.4);
    let c = |v: f64| Complex64::new(v, 0.0);
    let s = Complex64::new(0.0, omega);
    let g = DMatrix::from_row_slice(1, 2, &[c(1.0) / (s + p), c(p) / (s + p)]);
    let w_at = w.at(omega).expect("no pole");
    for (place, rows) in [(UncertainDynamics::InputMultiplicative, 2), (UncertainDynamics::Additive, 1)] {
        let system = plant.system().and_dynamics(&w, place).expect("fits");
        let sizes = system.structure().blocks().to_vec();
        assert_eq!(sizes[1], Block::Full { rows, cols: 3 });
        let delta = DMatrix::from_fn(rows, 3, |i, j| 0.3 - 0.2 * i as f64 + 0.1 * j as f64);
        let all = Perturbation {
            values: vec![BlockValue::Real(plant.parameters()[0].delta(p)), BlockValue::Full(delta.map(c))],
        };
        let all = all.matrix(system.structure()).expect("fits").map(|v| v.re);
        let gain = StateSpace::<Continuous>::from_gain(all).expect("finite");
        let found = system.close(&gain).expect("well posed").at(omega).expect("no pole");
        let exact = match place {
            UncertainDynamics::Additive => &g + delta.map(c) * &w_at,
            _ => &g * (DMatrix::identity(2, 2) + delta.map(c) * &w_at),
        };
        assert!((found - exact).norm() < 1e-13, "{place:?}");
    }
}

#[test]
fn edge_what_is_not_affine_is_refused_with_its_parameter() {
    // 1/m in A instead of a mass in E.
    let divided =
        |p: &[f64]| plain(dmatrix![0.0, 1.0; -p[1] / p[0], -0.1], dmatrix![0.0; 1.0], dmatrix![1.0, 0.0]);
    let ranges = vec![range("m", 0.9, 1.1), range("k", 0.8, 1.2)];
    match ParametricSystem::from_model(ranges.clone(), divided) {
        Err(Error::NotAffine { parameter, deviation, .. }) => {
            assert_eq!(parameter, "m");
            // 1/0.9 against the line through the centre: (1/1.1 - 1/0.9)/2 + 1/0.9 - 1.
            assert!((deviation * 1.2222 - 0.0121).abs() < 2e-3, "{deviation}");
        }
        other => panic!("{other:?}"),
    }
    // A product: affine in each, not in both; and a sine that vanishes at the ends and the centre.
    let product = |p: &[f64]| plain(dmatrix![-p[0] * p[1]], dmatrix![1.0], dmatrix![1.0]);
    let sine = |p: &[f64]| {
        let wave = (std::f64::consts::PI * (p[0] - 1.0) / 0.1).sin();
        plain(dmatrix![-1.0 - wave - 0.1 * p[1]], dmatrix![p[0]], dmatrix![1.0])
    };
    let refused = |found: Result<ParametricSystem, Error>| match found {
        Err(Error::NotAffine { parameter, .. }) => parameter,
        other => panic!("{other:?}"),
    };
    assert_eq!(refused(ParametricSystem::from_model(ranges.clone(), product)), "m`, `k");
    assert_eq!(refused(ParametricSystem::from_model(ranges, sine)), "m");
}

#[test]
fn edge_ranges_counts_and_shapes_are_refused_by_name() {
    for (lower, upper) in [(1.0, 1.0), (2.0, 1.0), (f64::NAN, 1.0), (0.0, f64::INFINITY), (-1e308, 1e308)] {
        assert!(matches!(ParameterRange::new("k", lower, upper), Err(Error::ParameterRange { .. })));
    }
    let lag = |pole: f64| plain(dmatrix![-pole], dmatrix![1.0], dmatrix![1.0]).expect("valid");
    let k = || vec![range("k", 0.5, 1.5)];
    let same = [RangeEnds { lower: lag(1.0), upper: lag(1.0) }];
    match ParametricSystem::from_ends(k(), &lag(1.0), &same) {
        Err(Error::ParameterWithoutEffect { parameter }) => assert_eq!(parameter, "k"),
        other => panic!("{other:?}"),
    }
    let odd = [RangeEnds { lower: lag(0.5), upper: mass_on_a_spring(&[1.0; 3]).expect("valid") }];
    match ParametricSystem::from_ends(k(), &lag(1.0), &odd) {
        Err(Error::ParameterShape { parameter }) => assert_eq!(parameter, "k"),
        other => panic!("{other:?}"),
    }
    assert!(matches!(
        ParametricSystem::from_ends(k(), &lag(1.0), &[]),
        Err(Error::ParameterCount { expected: 1, found: 0 })
    ));
    assert!(matches!(ParametricSystem::from_ends(vec![], &lag(1.0), &[]), Err(Error::NoUncertainBlocks)));
    let mass = vec![range("m", -1.0, 1.0), range("c", 0.1, 0.2), range("k", 0.8, 1.2)];
    assert!(matches!(
        ParametricSystem::from_model(mass, mass_on_a_spring),
        Err(Error::SingularDescriptor { .. })
    ));
    let right = [RangeEnds { lower: lag(0.5), upper: lag(1.5) }];
    let plant = ParametricSystem::from_ends(k(), &lag(1.0), &right).expect("affine");
    assert!(matches!(plant.at(&[]), Err(Error::ParameterCount { expected: 1, found: 0 })));
    let unstable = TransferFunction::new(&[1.0], &[1.0, -1.0]).expect("proper").to_state_space();
    let found = plant.system().and_dynamics(&unstable, UncertainDynamics::Additive);
    assert!(matches!(found, Err(Error::WeightNotStable { .. })));
}
