//! Riccati, Sylvester and Lyapunov equations against solutions to fifty digits in `testdata/matrix_equations`.

use nalgebra::DMatrix;
use serde_json::Value;
use telepulse_lti::riccati::{SecondRoute, Terms, care, dare};
use telepulse_lti::{lyapunov, sylvester};

fn problems(text: &str) -> Vec<Value> {
    let file: Value = serde_json::from_str(text).expect("json");
    file["problems"].as_array().expect("a list of problems").clone()
}

fn matrix(problem: &Value, key: &str) -> DMatrix<f64> {
    let rows = problem[key].as_array().expect("rows");
    let cols = rows[0].as_array().expect("a row").len();
    DMatrix::from_fn(rows.len(), cols, |i, j| rows[i][j].as_f64().expect("a number"))
}

/// Largest difference, every entry in the unit that the diagonal of the reference gives it.
fn error_in_units(found: &DMatrix<f64>, expected: &DMatrix<f64>) -> f64 {
    let unit = |i: usize| expected.row(i).norm().min(expected[(i, i)].abs().sqrt()).max(f64::MIN_POSITIVE);
    let mut worst: f64 = 0.0;
    for i in 0..found.nrows() {
        for j in 0..found.ncols() {
            let size = (expected[(i, i)].abs() * expected[(j, j)].abs()).sqrt().max(unit(i).min(unit(j)));
            worst = worst.max((found[(i, j)] - expected[(i, j)]).abs() / size.max(1e-30 * expected.norm()));
        }
    }
    worst
}

#[test]
fn oracle_riccati_solutions_to_fifty_digits() {
    let text = include_str!("../../../../testdata/matrix_equations/riccati.json");
    let mut n_better = 0;
    let problems = problems(text);
    for problem in &problems {
        let kind = problem["kind"].as_str().expect("kind");
        let label = format!("{kind} {}", problem["name"]);
        let [a, b, q, r, s, expected] = ["A", "B", "Q", "R", "S", "X"].map(|key| matrix(problem, key));
        let terms = Terms { a: &a, b: &b, q: &q, r: &r, s: Some(&s) };
        let solve = if kind == "care" { care } else { dare };
        let found = solve(&terms, SecondRoute::Always).unwrap_or_else(|e| panic!("{label}: {e}"));
        let error = (&found.x - &expected).norm() / expected.norm();
        // Rounding of the data once, times the condition that the solver itself reports.
        let bound = 4.0 * f64::EPSILON * (1.0 + found.condition);
        assert!(error <= bound, "{label}: {error:e} over {bound:e}: {found:?}");
        assert!(error <= 1e-8, "{label}: {error:e}");
        if label.contains("units") {
            let error = error_in_units(&found.x, &expected);
            assert!(error <= bound, "{label}: {error:e} in units over {bound:e}");
        }
        n_better +=
            usize::from(problem["scipy_error"].as_f64().is_none_or(|scipy| error <= scipy.max(1e-15)));
        let poles = problem["poles"].as_array().expect("poles");
        for pole in poles {
            let pole = num_complex::Complex64::new(pole[0].as_f64().unwrap(), pole[1].as_f64().unwrap());
            let distances = found.closed_loop_poles.iter().map(|p| (p - pole).norm());
            let nearest = distances.fold(f64::INFINITY, f64::min);
            // The shift register has a defective pole at zero, of which rounding makes a circle.
            let bound = if label.contains("register") { 0.02 } else { 1e-6 * (1.0 + pole.norm()) };
            assert!(nearest <= bound, "{label}: no pole near {pole}, {:?}", found.closed_loop_poles);
        }
    }
    assert!(n_better * 4 >= problems.len() * 3, "as accurate as scipy in {n_better} of {}", problems.len());
}

/// Refinement with a residual in doubled precision leaves no condition in the error.
fn error_bound(condition: f64, n_refinements: usize) -> f64 {
    if n_refinements > 0 { 1e-14 } else { 4.0 * f64::EPSILON * (1.0 + condition) }
}

#[test]
fn oracle_sylvester_solutions_to_fifty_digits() {
    let text = include_str!("../../../../testdata/matrix_equations/linear.json");
    for problem in problems(text) {
        let kind = problem["kind"].as_str().expect("kind");
        let label = format!("{kind} {}", problem["name"]);
        let [a, b, c, expected] = ["A", "B", "C", "X"].map(|key| matrix(&problem, key));
        let solve = if kind == "continuous" { sylvester::continuous } else { sylvester::discrete };
        let found = solve(&a, &b, &c).unwrap_or_else(|e| panic!("{label}: {e}"));
        let error = (&found.x - &expected).norm() / expected.norm();
        let bound = error_bound(found.condition, found.n_refinements);
        assert!(error <= bound, "{label}: {error:e} over {bound:e} {found:?}");
        if b == a.transpose() {
            let solve = if kind == "continuous" { lyapunov::continuous } else { lyapunov::discrete };
            let found = solve(&a, &c).unwrap_or_else(|e| panic!("{label}: {e}"));
            let error = (&found.x - &expected).norm() / expected.norm();
            let bound = error_bound(found.condition, found.n_refinements);
            assert!(error <= bound, "{label}: {error:e} over {bound:e} {found:?}");
        }
    }
}
