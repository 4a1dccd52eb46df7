//! H-infinity synthesis: the paper's problem, the reference collection, hand-solvable problems and refusals.

use crate::printed;
use nalgebra::DMatrix;
use serde_json::Value;
use telepulse_design::Error;
use telepulse_design::synthesize::{
    Condition, HinfOptions, LoopWeights, MixedSensitivityWeights, Repaired, SingularProblem, augw, hinfsyn,
    mixed_sensitivity,
};
use telepulse_design::verify::{LoopUnderTest, verify};
use telepulse_lti::{Continuous, GeneralizedPlant, StateSpace, TransferFunction, hinf_norm};

fn tf(numerator: &[f64], denominator: &[f64]) -> TransferFunction {
    TransferFunction::new(numerator, denominator).expect("proper")
}

/// The optimum of the S/KS problem with the printed weights, from a high-precision bracket.
const PRINTED_OPTIMUM: f64 = 0.320641;

#[test]
fn paper_own_synthesis_beats_the_printed_controller() {
    let design = hinfsyn(&printed::generalized_plant(), &HinfOptions::default()).expect("feasible");
    let fastest = design.fastest_controller_pole_rad_s().expect("qr");
    assert!(design.gamma_lower <= PRINTED_OPTIMUM + 1e-6 && design.gamma_upper >= PRINTED_OPTIMUM - 1e-6);
    assert!(design.achieved.upper <= 0.3240 && design.achieved.value >= PRINTED_OPTIMUM - 1e-6);
    assert!(fastest < 1e5, "{fastest}");
    assert_eq!(design.controller.d()[(0, 0)], 0.0);
    assert_eq!(design.binding_condition, Some(Condition::ControlDefinite));
    let (plant, bound) = (printed::g(), printed::ws());
    let loop_ = LoopUnderTest {
        plant: &plant,
        controller: &design.controller,
        bound: &bound,
        measurement_filter: None,
    };
    let c = verify(&loop_).expect("stable");
    assert!(c.holds());
    // At the optimum: peak KS 1.3041, peak T 1.000, bandwidth 5.17 Hz; one per cent of back-off moves them a little.
    assert!((c.peak_ks.value - 1.304).abs() < 0.03, "{:?}", c.peak_ks);
    assert!((c.peak_t.value - 1.0).abs() < 0.002, "{:?}", c.peak_t);
    assert!((c.bandwidth_hz.expect("falls off") - 5.17).abs() < 0.15, "{:?}", c.bandwidth_hz);
}

#[test]
fn paper_minimal_plant_has_every_state_once() {
    let plant = printed::generalized_plant();
    assert_eq!(plant.n_states(), 5);
    // Against the definition, S = 1, K = 0: z = [We; 0], y = 1; and the column of u: z = [-We G; Wu], y = -G.
    for omega in [0.1, 10.0, 38.0, 1e3] {
        let response = plant.sys().at(omega).expect("no pole there");
        let (g, we, wu) = (printed::g().at(omega), printed::we().at(omega), printed::wu().at(omega));
        let expected = [[we, -we * g], [0.0.into(), wu], [1.0.into(), -g]];
        for (i, row) in expected.iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                assert!((response[(i, j)] - value).norm() < 1e-10 * (1.0 + value.norm()), "{omega} {i} {j}");
            }
        }
    }
}

#[test]
fn law_third_weight_shapes_the_output() {
    let (g, we, wu, wt) = (printed::g(), printed::we(), printed::wu(), tf(&[0.5, 1.0], &[0.001, 1.0]));
    let plant =
        mixed_sensitivity(&g, &MixedSensitivityWeights { we: &we, wu: &wu, wt: Some(&wt) }).expect("stable");
    assert_eq!((plant.n_states(), plant.n_z()), (6, 3));
    let response = plant.sys().at(20.0).expect("no pole there");
    assert!((response[(2, 1)] - wt.at(20.0) * g.at(20.0)).norm() < 1e-12);
    let design = hinfsyn(&plant, &HinfOptions::default()).expect("feasible");
    assert!(design.achieved.upper <= 1.0101 * design.gamma_upper);
}

#[test]
fn law_double_integrator_reaches_its_analytic_optimum() {
    // x1' = x2, x2' = w1 + u, z = [x1; u], y = x1 + w2: the symmetric double-integrator problem. By symmetry X and Y have
    // the same spectrum and the optimum is known: gamma² = 6.8284... = 4 + 2 sqrt(2).
    let sys = StateSpace::<Continuous>::new(
        nalgebra::dmatrix![0.0, 1.0; 0.0, 0.0],
        nalgebra::dmatrix![0.0, 0.0, 0.0; 1.0, 0.0, 1.0],
        nalgebra::dmatrix![1.0, 0.0; 0.0, 0.0; 1.0, 0.0],
        nalgebra::dmatrix![0.0, 0.0, 0.0; 0.0, 0.0, 1.0; 0.0, 1.0, 0.0],
    )
    .expect("shapes");
    let plant = GeneralizedPlant::new(sys, 2, 1, 2, 1).expect("ports");
    let design = hinfsyn(&plant, &HinfOptions::default()).expect("feasible");
    let exact = (4.0 + 2.0 * 2.0_f64.sqrt()).sqrt();
    assert!((design.gamma_upper / exact - 1.0).abs() < 2e-6, "{} {exact}", design.gamma_upper);
    assert_eq!(design.binding_condition, Some(Condition::Coupling));
}

#[test]
fn law_static_problem_reaches_the_parrott_bound() {
    // Stable scalar plant whose direct term [3 . ; . .] cannot be lowered: gamma is at least 3.
    let sys = StateSpace::<Continuous>::new(
        nalgebra::dmatrix![-1.0],
        nalgebra::dmatrix![0.01, 0.0, 0.01],
        nalgebra::dmatrix![0.01; 0.0; 0.01],
        nalgebra::dmatrix![3.0, 1.0, 0.0; 1.0, 5.0, 1.0; 0.0, 1.0, 0.7],
    )
    .expect("shapes");
    let plant = GeneralizedPlant::new(sys, 2, 1, 2, 1).expect("ports");
    let design = hinfsyn(&plant, &HinfOptions::default()).expect("feasible");
    let parrott = 10.0_f64.sqrt();
    assert!(design.gamma_lower >= parrott * (1.0 - 1e-12));
    assert!(
        design.achieved.value >= parrott && design.achieved.value < 1.02 * parrott,
        "{:?}",
        design.achieved
    );
}

#[test]
fn law_gamma_does_not_depend_on_units_or_states() {
    let plant = printed::generalized_plant();
    let reference = hinfsyn(&plant, &HinfOptions::default()).expect("feasible").gamma_upper;
    // States, u and y in other units (not powers of two): the norm from w to z must stay.
    let sys = plant.sys();
    let t = DMatrix::from_diagonal(&nalgebra::DVector::from_column_slice(&[1e3, 3.7, 0.02, 50.0, 1e-4]));
    let inverse = t.clone().try_inverse().expect("diagonal");
    let inputs = DMatrix::from_diagonal(&nalgebra::DVector::from_column_slice(&[1.0, 37.0]));
    let outputs = DMatrix::from_diagonal(&nalgebra::DVector::from_column_slice(&[1.0, 1.0, -0.013]));
    let scaled = StateSpace::<Continuous>::new(
        &inverse * sys.a() * &t,
        &inverse * sys.b() * &inputs,
        &outputs * sys.c() * &t,
        &outputs * sys.d() * &inputs,
    )
    .expect("shapes");
    let scaled = GeneralizedPlant::new(scaled, 1, 1, 2, 1).expect("ports");
    let found = hinfsyn(&scaled, &HinfOptions::default()).expect("feasible").gamma_upper;
    assert!((found / reference - 1.0).abs() < 3e-6, "{found} {reference}");
}

#[test]
fn law_pole_limit_is_kept_and_the_loop_still_verified() {
    let plant = printed::generalized_plant();
    let free = hinfsyn(&plant, &HinfOptions::default()).expect("feasible");
    let limit = 0.5 * free.fastest_controller_pole_rad_s().expect("qr");
    let options = HinfOptions { max_controller_pole_rad_s: Some(limit), ..HinfOptions::default() };
    let slow = hinfsyn(&plant, &options).expect("feasible");
    assert!(slow.fastest_controller_pole_rad_s().expect("qr") <= limit);
    let closed = plant.lower_lft(&slow.controller).expect("well-posed");
    let norm = hinf_norm(&closed).expect("stable");
    assert!(norm.value <= slow.gamma_design * 1.0001, "{norm:?}");
    let hopeless = HinfOptions { max_controller_pole_rad_s: Some(1e-6), ..options };
    assert!(matches!(hinfsyn(&plant, &hopeless), Err(Error::ControllerTooFast { .. })));
}

#[test]
fn law_gain_limit_is_kept_or_refused() {
    let plant = printed::generalized_plant();
    let free = hinfsyn(&plant, &HinfOptions::default()).expect("feasible");
    let gain = hinf_norm(&free.controller).expect("stable controller").value;
    let options = HinfOptions {
        max_controller_gain: Some(0.8 * gain),
        relaxation_max: 100.0,
        ..HinfOptions::default()
    };
    let tame = hinfsyn(&plant, &options).expect("some gain can be traded");
    // Judged on a grid rather than by the norm that the search used.
    for k in 0..600 {
        let omega = 1e-4 * 10.0_f64.powf(9.0 * k as f64 / 599.0);
        let found = tame.controller.at(omega).expect("no pole there").norm();
        assert!(found <= 0.8 * gain * (1.0 + 1e-9), "{omega}: {found} {gain}");
    }
    assert!(tame.gamma_design > free.gamma_design);
    let hopeless = HinfOptions { max_controller_gain: Some(1e-9), relaxation_max: 2.0, ..options };
    assert!(matches!(hinfsyn(&plant, &hopeless), Err(Error::ControllerGainTooHigh { .. })));
}

fn random_plant(rng: &mut rand_pcg::Pcg64, n: usize) -> GeneralizedPlant {
    use rand::RngExt;
    let mut m = |rows, cols| DMatrix::from_fn(rows, cols, |_, _| rng.random_range(-1.0..1.0));
    // Two of each signal but three of w and z; all direct terms are there.
    let sys = StateSpace::<Continuous>::new(m(n, n), m(n, 5), m(5, n), m(5, 5)).expect("shapes");
    GeneralizedPlant::new(sys, 3, 2, 3, 2).expect("ports")
}

#[test]
fn law_random_plants_are_solved_and_their_duals_agree() {
    use rand::SeedableRng;
    let seed = 41;
    let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
    for trial in 0..60 {
        let plant = random_plant(&mut rng, 1 + trial % 8);
        let design = hinfsyn(&plant, &HinfOptions::default())
            .unwrap_or_else(|error| panic!("seed {seed} trial {trial}: {error}"));
        assert!(design.closed_loop_poles.iter().all(|pole| pole.re < 0.0));
        assert!(design.gamma_upper / design.gamma_lower < 1.0 + 2e-6);
        assert!(design.achieved.value >= design.gamma_lower * (1.0 - 1e-6), "seed {seed} trial {trial}");
        assert!(design.achieved.upper <= 1.0101 * design.gamma_upper, "seed {seed} trial {trial}");
        // By another route: the closed loop pointwise, from the plant's and the controller's own responses.
        for omega in [0.0, 0.1, 1.0, 10.0, 1e3] {
            let (p, k) = (plant.sys().at(omega), design.controller.at(omega));
            let (p, k) = (p.expect("no pole there"), k.expect("no pole there"));
            let part = |row, col, rows, cols| p.view((row, col), (rows, cols)).into_owned();
            let (p11, p12, p21, p22) =
                (part(0, 0, 3, 3), part(0, 3, 3, 2), part(3, 0, 2, 3), part(3, 3, 2, 2));
            let inner = (DMatrix::identity(2, 2) - p22 * &k).try_inverse().expect("well-posed");
            let gain = (p11 + p12 * k * inner * p21).singular_values().max();
            assert!(
                gain <= design.achieved.upper * (1.0 + 1e-6),
                "seed {seed} trial {trial} {omega}: {gain}"
            );
        }
        // The transposed problem exchanges the roles of X and Y and has the same optimum.
        let sys = plant.sys();
        let dual = StateSpace::<Continuous>::new(
            sys.a().transpose(),
            sys.c().transpose(),
            sys.b().transpose(),
            sys.d().transpose(),
        )
        .expect("shapes");
        let dual = GeneralizedPlant::new(dual, 3, 2, 3, 2).expect("ports");
        let found = hinfsyn(&dual, &HinfOptions::default()).expect("as solvable as the plant").gamma_upper;
        assert!((found / design.gamma_upper - 1.0).abs() < 3e-6, "seed {seed} trial {trial}: {found}");
    }
}

#[test]
fn edge_unstable_weights_are_refused_by_name() {
    let (g, we, wu) = (printed::g(), printed::we(), printed::wu());
    let integrator = tf(&[1.0], &[1.0, 0.0]);
    let weights = MixedSensitivityWeights { we: &integrator, wu: &wu, wt: None };
    assert!(matches!(mixed_sensitivity(&g, &weights), Err(Error::WeightNotStable { weight: "W_e", .. })));
    let growing = tf(&[1.0, 0.0], &[1.0, -2.0]);
    let weights = MixedSensitivityWeights { we: &we, wu: &growing, wt: None };
    let error = mixed_sensitivity(&g, &weights).expect_err("unstable");
    assert!(error.to_string().contains("W_u") && error.to_string().contains('2'), "{error}");
}

/// `n = 2` plant with one signal of each kind unless `d` says otherwise.
fn small_plant(a: [f64; 4], b: [f64; 4], c: [f64; 4], d: [f64; 4]) -> GeneralizedPlant {
    let m = |v: [f64; 4]| DMatrix::from_row_slice(2, 2, &v);
    let sys = StateSpace::<Continuous>::new(m(a), m(b), m(c), m(d)).expect("shapes");
    GeneralizedPlant::new(sys, 1, 1, 1, 1).expect("ports")
}

#[test]
fn edge_each_violated_assumption_has_its_own_error() {
    let options = HinfOptions { singular: SingularProblem::Refuse, ..HinfOptions::default() };
    let regular = [0.0, 1.0, 1.0, 0.0];
    // A control input without a weight, a measurement without noise.
    let plant =
        small_plant([-1.0, 0.0, 0.0, -2.0], [1.0, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0], [0.0, 0.0, 1.0, 0.0]);
    assert!(matches!(hinfsyn(&plant, &options), Err(Error::SingularD12 { smallest: 0.0, .. })));
    let plant =
        small_plant([-1.0, 0.0, 0.0, -2.0], [1.0, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0], [0.0, 1.0, 0.0, 0.0]);
    assert!(matches!(hinfsyn(&plant, &options), Err(Error::SingularD21 { smallest: 0.0, .. })));
    // The mode at +2 is not reached by u, or not seen in y.
    let plant = small_plant([-1.0, 0.0, 0.0, 2.0], [1.0, 1.0, 1.0, 0.0], [1.0, 1.0, 1.0, 1.0], regular);
    match hinfsyn(&plant, &options) {
        Err(Error::NotStabilizable { mode }) => assert!((mode.re - 2.0).abs() < 1e-12),
        other => panic!("{other:?}"),
    }
    let plant = small_plant([-1.0, 0.0, 0.0, 2.0], [1.0, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, 0.0], regular);
    assert!(matches!(hinfsyn(&plant, &options), Err(Error::NotDetectable { .. })));
    // A = [0 1; -2 -3], u enters x2, z = 7 x1 - 3 x2 + u: the numerator of P12 is s² + 3 s + 2 + 7 - 3 s = s² + 9.
    let plant = small_plant([0.0, 1.0, -2.0, -3.0], [0.0, 0.0, 1.0, 1.0], [7.0, -3.0, 1.0, 0.0], regular);
    match hinfsyn(&plant, &options) {
        Err(Error::AxisZero { omega_rad_s, .. }) => assert!((omega_rad_s - 3.0).abs() < 1e-9),
        other => panic!("{other:?}"),
    }
}

#[test]
fn law_singular_problems_come_near_the_bound_that_interpolation_sets() {
    let siso = |num: &[f64], den: &[f64]| tf(num, den).to_state_space();
    // No weight on u. A zero at 1 fixes S(1) = 1, a pole at 1 fixes T(1) = 1: the infimum is the weight there.
    let w1 = siso(&[0.5, 1.0], &[1.0, 0.01]);
    let nonminimum_phase = siso(&[-1.0, 1.0], &[1.0, 2.0, 1.0]);
    let w3 = siso(&[1.0, 2.0], &[1.0, 10.0]);
    let unstable = siso(&[1.0], &[1.0, -1.0]);
    // A plant without zeros leaves the weight at infinity.
    let lag = siso(&[3.0], &[1.0, 1.0]);
    let cases = [
        (&nonminimum_phase, Some(&w1), None, 1.5 / 1.01),
        (&unstable, None, Some(&w3), 3.0 / 11.0),
        (&lag, Some(&w1), None, 0.5),
    ];
    for (case, (g, w1, w3, infimum)) in cases.into_iter().enumerate() {
        let weights = LoopWeights { w1, w2: None, w3 };
        let plant = augw(g, &weights).expect("stable weights");
        // The dual plant is singular in D21 instead of D12.
        let (b, c) = (plant.sys().b().clone(), plant.sys().c().clone());
        let sys = StateSpace::<Continuous>::new(
            plant.a().transpose(),
            c.transpose(),
            b.transpose(),
            plant.sys().d().transpose(),
        );
        let dual =
            GeneralizedPlant::new(sys.expect("shapes"), plant.n_z(), 1, plant.n_w(), 1).expect("ports");
        for (plant, is_dual) in [(&plant, false), (&dual, true)] {
            let design = hinfsyn(plant, &HinfOptions::default()).expect("regularised");
            let how = design.regularization.expect("singular");
            let (here, there) = if is_dual { (how.d21, how.d12) } else { (how.d12, how.d21) };
            assert_eq!((here, there), (Repaired::Yes, Repaired::No), "case {case}");
            let closed = plant.lower_lft(&design.controller).expect("proper");
            assert!(closed.poles().expect("poles").iter().all(|p| p.re < 0.0), "case {case}");
            let largest = (0..4000)
                .map(|k| 10f64.powf(-6.0 + f64::from(k) * 0.003))
                .fold(0.0, |most: f64, w| most.max(closed.at(w).expect("stable").singular_values().max()));
            assert!(
                (largest / design.achieved.value - 1.0).abs() < 1e-3,
                "case {case}: {largest} {design:?}"
            );
            assert!(design.gamma_lower <= infimum * (1.0 + 1e-9), "case {case}: {}", design.gamma_lower);
            let ratio = design.achieved.value / infimum;
            assert!((1.0 - 1e-9..1.011).contains(&ratio), "case {case} dual {is_dual}: {ratio}");
        }
    }
}

#[test]
fn law_zeros_on_the_axis_are_regularised_and_measured_on_the_plant_as_given() {
    // The numerator of P12 is s² + 9, or s²: a resonance, a double integrator.
    for (c, omega) in [([7.0, -3.0, 1.0, 0.0], 3.0), ([-2.0, -3.0, 1.0, 0.0], 0.0)] {
        let plant = small_plant([0.0, 1.0, -2.0, -3.0], [0.0, 0.0, 1.0, 1.0], c, [0.0, 1.0, 1.0, 0.0]);
        let design = hinfsyn(&plant, &HinfOptions::default()).expect("regularised");
        let how = design.regularization.expect("singular");
        assert_eq!(how.axis_zeros, Repaired::Yes, "{omega}");
        let closed = plant.lower_lft(&design.controller).expect("proper");
        assert!(closed.poles().expect("poles").iter().all(|p| p.re < 0.0));
        let norm = hinf_norm(&closed).expect("stable").value;
        assert!((norm / design.achieved.value - 1.0).abs() < 1e-9);
        // K = 0 is a controller too.
        let open = plant.sys().select(&[0], &[0]).expect("ports");
        assert!(norm <= 1.01 * hinf_norm(&open).expect("stable").value, "{omega}: {norm}");
    }
}

#[test]
fn edge_options_out_of_range_and_an_unreachable_gamma() {
    let plant = printed::generalized_plant();
    let bad = HinfOptions { backoff: 1.0, ..HinfOptions::default() };
    assert!(matches!(hinfsyn(&plant, &bad), Err(Error::OutOfRange { key: "backoff", .. })));
    let bad = HinfOptions { gamma_max: f64::NAN, ..HinfOptions::default() };
    assert!(matches!(hinfsyn(&plant, &bad), Err(Error::OutOfRange { key: "gamma_max", .. })));
    let low = HinfOptions { gamma_max: 0.3, ..HinfOptions::default() };
    assert!(matches!(hinfsyn(&plant, &low), Err(Error::Infeasible { gamma_max: 0.3, .. })));
}

fn matrix(problem: &Value, key: &str, rows: usize, cols: usize) -> DMatrix<f64> {
    let flat: Vec<f64> = problem[key]
        .as_array()
        .expect("rows")
        .iter()
        .flat_map(|row| row.as_array().expect("row").iter().map(|v| v.as_f64().expect("number")))
        .collect();
    DMatrix::from_row_slice(rows, cols, &flat)
}

fn stack(tl: &DMatrix<f64>, tr: &DMatrix<f64>, bl: &DMatrix<f64>, br: &DMatrix<f64>) -> DMatrix<f64> {
    let (rows, cols) = tl.shape();
    DMatrix::from_fn(rows + bl.nrows(), cols + tr.ncols(), |i, j| match (i < rows, j < cols) {
        (true, true) => tl[(i, j)],
        (true, false) => tr[(i, j - cols)],
        (false, true) => bl[(i - rows, j)],
        (false, false) => br[(i - rows, j - cols)],
    })
}

/// A stored collection, or `None` (said on standard output) where the checkout has none beside it.
fn collection(name: &str) -> Option<Value> {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/reference").join(name);
    match std::fs::read_to_string(&path) {
        // The file was written with bare infinities, which JSON does not have.
        Ok(text) => Some(serde_json::from_str(&text.replace("Infinity", "null")).expect("json")),
        Err(_) => {
            println!("skipped: {name} is not beside the checkout");
            None
        }
    }
}

#[test]
fn oracle_reference_syntheses() {
    let Some(collection) = collection("hinfsyn_examples.json") else { return };
    let mut failures = Vec::new();
    for problem in collection["problems"].as_array().expect("list") {
        let size = |key: &str| problem[key].as_u64().expect("size") as usize;
        let (n, nw, nu, nz, ny) = (size("n"), size("nw"), size("nu"), size("nz"), size("ny"));
        let m = |key: &str, rows, cols| matrix(problem, key, rows, cols);
        let b = stack(&m("B1", n, nw), &m("B2", n, nu), &DMatrix::zeros(0, nw), &DMatrix::zeros(0, nu));
        let c = stack(&m("C1", nz, n), &DMatrix::zeros(nz, 0), &m("C2", ny, n), &DMatrix::zeros(ny, 0));
        let d = stack(&m("D11", nz, nw), &m("D12", nz, nu), &m("D21", ny, nw), &m("D22", ny, nu));
        let sys = StateSpace::<Continuous>::new(m("A", n, n), b, c, d).expect("shapes");
        let plant = GeneralizedPlant::new(sys, nw, nu, nz, ny).expect("ports");
        let id = problem["id"].as_str().expect("id");
        let start = std::time::Instant::now();
        let result = hinfsyn(&plant, &HinfOptions::default());
        let seconds = start.elapsed().as_secs_f64();
        match (problem["gamma_ref"].as_f64(), result) {
            (Some(reference), Ok(design)) => {
                let ratio = design.achieved.value / reference;
                println!(
                    "{id}: upper/ref-1 {:.2e}, achieved/ref {ratio:.6}, fastest pole {:.3e}, {:?}, {} tests, {:.2} ms",
                    design.gamma_upper / reference - 1.0,
                    design.fastest_controller_pole_rad_s().expect("qr"),
                    design.binding_condition,
                    design.n_feasibility_tests,
                    1e3 * seconds
                );
                if !(1.0 - 1e-6..=1.01).contains(&ratio) {
                    failures.push(format!("{id}: {ratio}"));
                }
            }
            // Singular: what the norm is worth is judged where the loop is closed anew.
            (None, Ok(design)) if design.regularization.is_some() => {
                let closed =
                    hinf_norm(&plant.lower_lft(&design.controller).expect("proper")).expect("stable");
                println!("{id}: regularised, norm {}, {:.2} ms", closed.value, 1e3 * seconds);
                if (closed.value / design.achieved.value - 1.0).abs() > 1e-6 {
                    failures.push(format!("{id}: {closed:?}"));
                }
            }
            (_, result) => failures.push(format!("{id}: {result:?}")),
        }
    }
    assert!(failures.is_empty(), "{failures:#?}");
}

#[test]
fn oracle_reference_norms() {
    let Some(collection) = collection("hinfnorm_examples.json") else { return };
    for problem in collection["problems"].as_array().expect("list") {
        let size = |key: &str| problem[key].as_u64().expect("size") as usize;
        let (n, inputs, outputs) = (size("n"), size("m"), size("p"));
        let sys = StateSpace::<Continuous>::new(
            matrix(problem, "A", n, n),
            matrix(problem, "B", n, inputs),
            matrix(problem, "C", outputs, n),
            matrix(problem, "D", outputs, inputs),
        )
        .expect("shapes");
        let id = problem["id"].as_str().expect("id");
        let start = std::time::Instant::now();
        let peak = hinf_norm(&sys).unwrap_or_else(|error| panic!("{id}: {error}"));
        let micros = 1e6 * start.elapsed().as_secs_f64();
        let grid = problem["grid_norm"].as_f64().expect("number");
        println!(
            "{id}: {} at {}, bracket {:.1e}, over grid {:.1e}, {micros:.0} us",
            peak.value,
            peak.omega_rad_s,
            peak.upper / peak.lower - 1.0,
            peak.value / grid - 1.0
        );
        assert!(peak.value >= grid * (1.0 - 1e-9) && peak.upper >= grid, "{id}: {peak:?} {grid}");
        if let Some(exact) = problem["exact"].as_f64() {
            assert!((peak.value / exact - 1.0).abs() < 1e-9, "{id}: {peak:?} {exact}");
        }
    }
}
