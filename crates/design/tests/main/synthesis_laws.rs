//! What must not change the smallest reachable norm, and an independent optimum for a hundred plants.

use nalgebra::DMatrix;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde_json::Value;
use telepulse_design::synthesize::{HinfDesign, HinfOptions, hinfsyn, hinfsyn_discrete};
use telepulse_lti::{Continuous, Discrete, GeneralizedPlant, SampleTime, StateSpace};

const SIZES: [usize; 4] = [3, 2, 3, 2];

fn random(rng: &mut Pcg64, rows: usize, cols: usize) -> DMatrix<f64> {
    DMatrix::from_fn(rows, cols, |_, _| rng.random_range(-1.0..1.0))
}

/// Well-conditioned, but neither orthogonal nor symmetric.
fn invertible(rng: &mut Pcg64, n: usize) -> DMatrix<f64> {
    DMatrix::identity(n, n) * 2.0 + random(rng, n, n)
}

fn orthogonal(rng: &mut Pcg64, n: usize) -> DMatrix<f64> {
    random(rng, n, n).qr().q()
}

fn design(a: DMatrix<f64>, b: DMatrix<f64>, c: DMatrix<f64>, d: DMatrix<f64>) -> HinfDesign {
    let [n_w, n_u, n_z, n_y] = SIZES;
    let sys = StateSpace::<Continuous>::new(a, b, c, d).expect("shapes");
    let plant = GeneralizedPlant::new(sys, n_w, n_u, n_z, n_y).expect("ports");
    hinfsyn(&plant, &HinfOptions::default()).expect("a regular plant has an answer")
}

/// `diag(first, second)`.
fn both(first: &DMatrix<f64>, second: &DMatrix<f64>) -> DMatrix<f64> {
    let (n, m) = (first.nrows(), second.nrows());
    let mut whole = DMatrix::zeros(n + m, n + m);
    whole.view_mut((0, 0), (n, n)).copy_from(first);
    whole.view_mut((n, n), (m, m)).copy_from(second);
    whole
}

#[test]
fn law_gamma_does_not_depend_on_coordinates_or_units() {
    let seed = 71;
    let mut rng = Pcg64::seed_from_u64(seed);
    let [n_w, n_u, n_z, n_y] = SIZES;
    for trial in 0..40 {
        let n = 1 + trial % 8;
        let (a, b) = (random(&mut rng, n, n), random(&mut rng, n, n_w + n_u));
        let (c, d) = (random(&mut rng, n_z + n_y, n), random(&mut rng, n_z + n_y, n_w + n_u));
        let reference = design(a.clone(), b.clone(), c.clone(), d.clone());
        // Both ends of a bracket of relative width 1e-6 move with the rounding of the path that found them.
        let same = |what: &str, found: &HinfDesign, factor: f64| {
            for (end, other) in
                [(reference.gamma_lower, found.gamma_upper), (found.gamma_lower, reference.gamma_upper)]
            {
                let scale = if end == reference.gamma_lower { factor } else { 1.0 / factor };
                assert!(
                    end * scale <= other * (1.0 + 1e-8),
                    "seed {seed} trial {trial} {what}: the brackets {} .. {} and {} .. {} do not meet",
                    reference.gamma_lower,
                    reference.gamma_upper,
                    found.gamma_lower / factor,
                    found.gamma_upper / factor,
                );
            }
            let norm = found.achieved.value / factor / reference.gamma_upper;
            assert!(norm <= 1.0101, "seed {seed} trial {trial} {what}: {norm} of the optimum");
        };
        let t = invertible(&mut rng, n);
        let back = t.clone().try_inverse().expect("diagonally dominant");
        same("similarity", &design(&t * &a * &back, &t * &b, &c * &back, d.clone()), 1.0);
        let units = DMatrix::from_diagonal(&nalgebra::DVector::from_fn(n, |i, _| {
            10.0_f64.powi(3 * (i as i32 % 3) - 3)
        }));
        let back = units.clone().try_inverse().expect("diagonal");
        same("units of the states", &design(&units * &a * &back, &units * &b, &c * &back, d.clone()), 1.0);
        // w and z turned and scaled: gamma goes with the scale.
        let (on_w, on_z) = (both(&(orthogonal(&mut rng, n_w) * 30.0), &DMatrix::identity(n_u, n_u)), 0.7);
        let on_z = both(&(orthogonal(&mut rng, n_z) * on_z), &DMatrix::identity(n_y, n_y));
        same("w and z", &design(a.clone(), &b * &on_w, &on_z * &c, &on_z * &d * &on_w), 30.0 * 0.7);
        // u and y in other units and combinations, which the controller undoes.
        let on_u = both(&DMatrix::identity(n_w, n_w), &(invertible(&mut rng, n_u) * 1e4));
        let on_y = both(&DMatrix::identity(n_z, n_z), &(invertible(&mut rng, n_y) * 1e-5));
        same("u and y", &design(a.clone(), &b * &on_u, &on_y * &c, &on_y * &d * &on_u), 1.0);
        let on_u = both(&DMatrix::identity(n_w, n_w), &(DMatrix::identity(n_u, n_u) * 1e4));
        let on_y = both(&DMatrix::identity(n_z, n_z), &(DMatrix::identity(n_y, n_y) * 1e4));
        same("u and y, both small", &design(a.clone(), &b * &on_u, &on_y * &c, &on_y * &d * &on_u), 1.0);
        // Time in another unit.
        same("time", &design(&a * 1e3, &b * 1e3, c.clone(), d.clone()), 1.0);
    }
}

#[test]
fn edge_a_plant_without_states_has_a_static_controller() {
    let empty = |rows, cols| DMatrix::<f64>::zeros(rows, cols);
    // z = w - u, y = w + noise / 10: the best static gain is 1 / 1.01, and 0.1 / sqrt(1.01) remains.
    let d = nalgebra::dmatrix![1.0, 0.0, -1.0; 1.0, 0.1, 0.0];
    let expected = 0.1 / 1.01_f64.sqrt();
    let sys =
        StateSpace::<Continuous>::new(empty(0, 0), empty(0, 3), empty(2, 0), d.clone()).expect("shapes");
    let plant = GeneralizedPlant::new(sys, 2, 1, 1, 1).expect("ports");
    let found = hinfsyn(&plant, &HinfOptions::default()).expect("regular");
    assert!(found.achieved.value >= expected * (1.0 - 1e-12) && found.achieved.value <= 1.0101 * expected);
    let time = SampleTime::new(0.1).expect("positive");
    let sys = StateSpace::<Discrete>::new(empty(0, 0), empty(0, 3), empty(2, 0), d, time).expect("shapes");
    let plant = GeneralizedPlant::new(sys, 2, 1, 1, 1).expect("ports");
    let found = hinfsyn_discrete(&plant, &HinfOptions::default()).expect("regular");
    assert!(found.achieved.value >= expected * (1.0 - 1e-12) && found.achieved.value <= 1.0101 * expected);
}

#[test]
fn oracle_brackets_hold_the_optimum_of_320_bit_arithmetic() {
    let text = include_str!("../../../../testdata/hinfsyn/solve_stress.json");
    let collection: Value = serde_json::from_str(text).expect("valid json");
    let problems = collection["problems"].as_array().expect("a list");
    let mut n_judged = 0;
    for problem in problems {
        let Some(reference) = problem["gamma_ref"].as_f64().filter(|gamma| *gamma > 0.0) else { continue };
        let (id, accuracy) = (&problem["id"], problem["gamma_ref_accuracy"].as_f64().expect("stated"));
        let found =
            hinfsyn(&plant(problem), &HinfOptions::default()).unwrap_or_else(|error| panic!("{id}: {error}"));
        let slack = 1.0 + accuracy + 5e-9;
        assert!(found.gamma_lower <= reference * slack, "{id}: {} {reference}", found.gamma_lower);
        assert!(found.gamma_upper * slack >= reference, "{id}: {} {reference}", found.gamma_upper);
        assert!(found.achieved.upper <= 1.01 * reference * slack, "{id}: {:?} {reference}", found.achieved);
        n_judged += 1;
    }
    assert!(n_judged > 100, "{n_judged}");
}

fn plant(problem: &Value) -> GeneralizedPlant {
    let size = |key: &str| problem[key].as_u64().expect("a size") as usize;
    let (n, n_w, n_u, n_z, n_y) = (size("n"), size("nw"), size("nu"), size("nz"), size("ny"));
    let matrix = |key: &str, rows: usize, cols: usize| {
        let lines = problem[key].as_array().expect("rows");
        let values: Vec<f64> = lines
            .iter()
            .flat_map(|line| line.as_array().expect("a row"))
            .map(|value| value.as_f64().expect("a number"))
            .collect();
        DMatrix::from_row_slice(rows, cols, &values)
    };
    let (mut b, mut c) = (DMatrix::zeros(n, n_w + n_u), DMatrix::zeros(n_z + n_y, n));
    let mut d = DMatrix::zeros(n_z + n_y, n_w + n_u);
    b.columns_mut(0, n_w).copy_from(&matrix("B1", n, n_w));
    b.columns_mut(n_w, n_u).copy_from(&matrix("B2", n, n_u));
    c.rows_mut(0, n_z).copy_from(&matrix("C1", n_z, n));
    c.rows_mut(n_z, n_y).copy_from(&matrix("C2", n_y, n));
    d.view_mut((0, 0), (n_z, n_w)).copy_from(&matrix("D11", n_z, n_w));
    d.view_mut((0, n_w), (n_z, n_u)).copy_from(&matrix("D12", n_z, n_u));
    d.view_mut((n_z, 0), (n_y, n_w)).copy_from(&matrix("D21", n_y, n_w));
    d.view_mut((n_z, n_w), (n_y, n_u)).copy_from(&matrix("D22", n_y, n_u));
    let sys = StateSpace::<Continuous>::new(matrix("A", n, n), b, c, d).expect("shapes");
    GeneralizedPlant::new(sys, n_w, n_u, n_z, n_y).expect("ports")
}
