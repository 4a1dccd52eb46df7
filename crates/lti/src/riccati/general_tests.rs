//! The general equations, judged by plain arithmetic in the caller's coordinates, by invariances and by the other route.

use nalgebra::{DMatrix, dmatrix};
use num_complex::Complex64;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::{GeneralSolution, Route, SecondRoute, Terms, care, dare};
use crate::Error;
use crate::eigenvalues::eigenvalues;

type Solver = fn(&Terms<'_>, SecondRoute) -> Result<GeneralSolution, Error>;

struct Problem {
    a: DMatrix<f64>,
    b: DMatrix<f64>,
    q: DMatrix<f64>,
    r: DMatrix<f64>,
    s: DMatrix<f64>,
}

impl Problem {
    fn terms(&self) -> Terms<'_> {
        Terms { a: &self.a, b: &self.b, q: &self.q, r: &self.r, s: Some(&self.s) }
    }

    /// Norm of the left-hand side in plain arithmetic over that of the terms it sums.
    fn plain_residual(&self, x: &DMatrix<f64>, k: &DMatrix<f64>, discrete: bool) -> f64 {
        let Self { a, b, q, s, .. } = self;
        let (linear, cross, size) = if discrete {
            let axa = a.tr_mul(x) * a;
            (&axa - x, a.tr_mul(x) * b + s, axa.abs() + x.abs())
        } else {
            let xa = x * a;
            (&xa + xa.transpose(), x * b + s, xa.abs() + xa.abs().transpose())
        };
        let size = size + q.abs() + cross.abs() * k.abs();
        let left = linear + q - cross * k;
        left.norm() / size.norm()
    }
}

/// What rounding the entries of `X` alone leaves in the residual, relative to the terms as the solver counts them.
fn storage_limit(problem: &Problem, found: &GeneralSolution, discrete: bool) -> f64 {
    let closed = (&problem.a - &problem.b * &found.gain).norm();
    let amplification = if discrete { 1.0 + closed * closed } else { 2.0 * closed };
    // The terms over ||X|| are the condition times the separation.
    f64::EPSILON * (1.0 + amplification / (found.condition * found.separation))
}

fn matrix(rng: &mut Pcg64, rows: usize, cols: usize) -> DMatrix<f64> {
    DMatrix::from_fn(rows, cols, |_, _| rng.random_range(-1.0..1.0))
}

/// `[Q S; Sᵀ R]` positive semidefinite with regular `R`; in an indefinite problem a first input is a weak opponent.
fn random_problem(rng: &mut Pcg64, n: usize, m: usize, indefinite: bool) -> Problem {
    let root = matrix(rng, n + m, n + m);
    let weight = &root * root.transpose();
    let (a, mut b) = (matrix(rng, n, n), matrix(rng, n, m));
    let mut r = weight.view((n, n), (m, m)) + DMatrix::identity(m, m);
    let mut s = weight.view((0, n), (n, m)).into_owned();
    if indefinite && m > 1 {
        s.fill(0.0);
        r = DMatrix::identity(m, m);
        r[(0, 0)] = -1e4;
        b.column_mut(0).scale_mut(0.1);
    }
    Problem { a, b, q: weight.view((0, 0), (n, n)).into_owned(), r, s }
}

fn is_stable(pole: &Complex64, discrete: bool) -> bool {
    if discrete { pole.norm() < 1.0 } else { pole.re < 0.0 }
}

const SOLVERS: [(bool, Solver); 2] = [(false, care), (true, dare)];

#[test]
fn law_random_equations_are_solved_on_two_routes() {
    let seed = 61;
    let mut rng = Pcg64::seed_from_u64(seed);
    for trial in 0..400 {
        let (n, m) = (trial % 13, 1 + trial % 4);
        let problem = random_problem(&mut rng, n, m, trial % 3 == 0);
        for (discrete, solve) in SOLVERS {
            let label = format!("seed {seed} trial {trial} n {n} m {m} discrete {discrete}");
            let found =
                solve(&problem.terms(), SecondRoute::Always).unwrap_or_else(|e| panic!("{label}: {e}"));
            assert_eq!(found.x, found.x.transpose(), "{label}");
            if n == 0 {
                continue;
            }
            let limit = storage_limit(&problem, &found, discrete);
            assert!(
                found.residual_relative < 2.0 * limit,
                "{label}: {:e} {limit:e}",
                found.residual_relative
            );
            let difference = found.route_difference.expect("both routes");
            assert!(
                difference < 1e-15 * found.condition.max(10.0),
                "{label}: {difference:e} {}",
                found.condition
            );
            let plain = problem.plain_residual(&found.x, &found.gain, discrete);
            assert!(plain < 1e3 * limit, "{label}: {plain:e}");
            let closed = eigenvalues(&(&problem.a - &problem.b * &found.gain)).expect("eigenvalues");
            assert!(closed.iter().all(|p| is_stable(p, discrete)), "{label}");
        }
    }
}

#[test]
fn law_coordinates_do_not_matter_however_badly_scaled() {
    let seed = 62;
    let mut rng = Pcg64::seed_from_u64(seed);
    for trial in 0..120 {
        let (n, m) = (1 + trial % 8, 1 + trial % 3);
        let plain = random_problem(&mut rng, n, m, false);
        // x = T x', u = V u' over sixteen and twelve decades.
        let t = DMatrix::from_diagonal(
            &DMatrix::from_fn(n, 1, |_, _| 10.0_f64.powf(rng.random_range(-8.0..8.0))).column(0).into_owned(),
        );
        let v = DMatrix::from_diagonal(
            &DMatrix::from_fn(m, 1, |_, _| 10.0_f64.powf(rng.random_range(-6.0..6.0))).column(0).into_owned(),
        );
        let inverse = t.map(|x: f64| if x == 0.0 { 0.0 } else { 1.0 / x });
        let scaled = Problem {
            a: &inverse * &plain.a * &t,
            b: &inverse * &plain.b * &v,
            q: &t * &plain.q * &t,
            r: &v * &plain.r * &v,
            s: &t * &plain.s * &v,
        };
        for (discrete, solve) in SOLVERS {
            let label = format!("seed {seed} trial {trial} discrete {discrete}");
            let expected =
                solve(&plain.terms(), SecondRoute::IfNeeded).unwrap_or_else(|e| panic!("{label}: {e}"));
            let found =
                solve(&scaled.terms(), SecondRoute::IfNeeded).unwrap_or_else(|e| panic!("{label}: {e}"));
            let back = &inverse * &found.x * &inverse;
            let error = (&back - &expected.x).norm() / expected.x.norm();
            assert!(
                error < 1e-14 * expected.condition.max(10.0),
                "{label}: {error:e} {}",
                expected.condition
            );
        }
    }
}

#[test]
fn law_rotation_scaling_and_duality() {
    let seed = 63;
    let mut rng = Pcg64::seed_from_u64(seed);
    for trial in 0..60 {
        let n = 1 + trial % 9;
        let mut problem = random_problem(&mut rng, n, 2, false);
        let t = matrix(&mut rng, n, n).qr().q();
        for (discrete, solve) in SOLVERS {
            let label = format!("seed {seed} trial {trial} discrete {discrete}");
            let found = solve(&problem.terms(), SecondRoute::IfNeeded).expect("regular");
            let bound = 1e-14 * found.condition.max(10.0) * found.x.norm();
            let rotated = Problem {
                a: t.tr_mul(&problem.a) * &t,
                b: t.tr_mul(&problem.b),
                q: t.tr_mul(&problem.q) * &t,
                r: &problem.r * 7.0,
                s: t.tr_mul(&problem.s) * 7.0,
            };
            let rotated = Problem { q: rotated.q * 7.0, ..rotated };
            let other = solve(&rotated.terms(), SecondRoute::IfNeeded).expect("regular");
            assert!((t.tr_mul(&found.x) * &t * 7.0 - other.x).norm() < 7.0 * bound, "{label}");
        }
        // The equation of the transposed system, with Q and G exchanged, has the same closed-loop poles.
        problem.s.fill(0.0);
        let root = problem.q.clone().symmetric_eigen();
        let c = &root.eigenvectors * DMatrix::from_diagonal(&root.eigenvalues.map(|v| v.max(0.0).sqrt()));
        let one = DMatrix::identity(n, n);
        let g = &problem.b * problem.r.clone().try_inverse().expect("regular") * problem.b.transpose();
        let dual = Problem {
            a: problem.a.transpose(),
            b: c,
            q: (&g + g.transpose()) * 0.5,
            r: one,
            s: DMatrix::zeros(n, n),
        };
        for (discrete, solve) in SOLVERS {
            let primal = solve(&problem.terms(), SecondRoute::IfNeeded).expect("regular");
            let dual = solve(&dual.terms(), SecondRoute::IfNeeded).expect("regular");
            for pole in &primal.closed_loop_poles {
                let nearest =
                    dual.closed_loop_poles.iter().map(|p| (p - pole).norm()).fold(f64::INFINITY, f64::min);
                let bound = 1e-8 * (1.0 + pole.norm());
                assert!(nearest < bound, "seed {seed} trial {trial} discrete {discrete}: {pole} {nearest:e}");
            }
        }
    }
}

#[test]
fn law_a_nearly_singular_input_weight_goes_by_the_pencil() {
    // R = U diag(1, eps) Uᵀ with U a rotation, so that no diagonal scaling removes the condition.
    let (c, s) = (0.6, 0.8);
    let u = dmatrix![c, -s; s, c];
    let a = dmatrix![0.0, 1.0, 0.0; 0.0, 0.0, 1.0; 1.0, -1.0, 0.5];
    let b = dmatrix![1.0, 0.0; 0.0, 1.0; 1.0, 1.0];
    for eps in [1e-4, 1e-9, 1e-11] {
        let r = &u * DMatrix::from_diagonal(&dmatrix![1.0; eps].column(0).into_owned()) * u.transpose();
        let problem =
            Problem { a: a.clone(), b: b.clone(), q: DMatrix::identity(3, 3), r, s: DMatrix::zeros(3, 2) };
        let found = care(&problem.terms(), SecondRoute::IfNeeded).expect("regular");
        let limit = storage_limit(&problem, &found, false);
        assert!(found.residual_relative < 2.0 * limit, "{eps}: {:e} {limit:e}", found.residual_relative);
        assert_eq!(found.route == Route::Pencil, eps < 1e-8);
        assert!(found.closed_loop_poles.iter().all(|p| p.re < 0.0));
        // Discrete equations need R + Bᵀ X B only: R = 0 is a minimum-time regulator.
        let problem = Problem { r: DMatrix::zeros(2, 2), ..problem };
        let found = dare(&problem.terms(), SecondRoute::IfNeeded).expect("R + Bᵀ X B is regular");
        assert!(found.residual_relative < 1e-14, "{}", found.residual_relative);
        assert!(found.closed_loop_poles.iter().all(|p| p.norm() < 1.0));
    }
}

#[test]
fn edge_what_has_no_stabilizing_solution_is_named() {
    let one = dmatrix![1.0];
    let zero = dmatrix![0.0];
    for (discrete, solve) in SOLVERS {
        let unstable = if discrete { dmatrix![2.0] } else { dmatrix![1.0] };
        let terms = Terms { a: &unstable, b: &zero, q: &one, r: &one, s: None };
        match solve(&terms, SecondRoute::IfNeeded) {
            Err(Error::NotStabilizable { pole, .. }) => assert_eq!(pole.re, unstable[(0, 0)]),
            other => panic!("expected an unreachable mode, found {other:?}"),
        }
        // A mode on the boundary that no weight sees.
        let boundary = if discrete { dmatrix![-1.0] } else { dmatrix![0.0] };
        let terms = Terms { a: &boundary, b: &one, q: &zero, r: &one, s: None };
        let outcome = solve(&terms, SecondRoute::Always);
        assert!(
            matches!(outcome, Err(Error::HamiltonianAxis { .. } | Error::SymplecticCircle { .. })),
            "discrete {discrete}: {outcome:?}"
        );
        // An opponent stronger than the player: no real solution.
        let terms = Terms { a: &zero, b: &one, q: &one, r: &dmatrix![-1.0], s: None };
        assert!(solve(&terms, SecondRoute::IfNeeded).is_err(), "discrete {discrete}");
    }
    let terms = Terms { a: &one, b: &one, q: &one, r: &zero, s: None };
    assert!(care(&terms, SecondRoute::IfNeeded).is_err(), "R = 0 in continuous time");
}

#[test]
fn edge_wrong_input_is_refused_by_name() {
    let (one, two) = (dmatrix![1.0], DMatrix::<f64>::identity(2, 2));
    let nan = dmatrix![f64::NAN];
    let skew = dmatrix![0.0, 1.0; -1.0, 0.0];
    let row = dmatrix![1.0; 1.0];
    for (_, solve) in SOLVERS {
        let terms = Terms { a: &one, b: &one, q: &two, r: &one, s: None };
        assert!(matches!(solve(&terms, SecondRoute::IfNeeded), Err(Error::Shape { matrix: "q", .. })));
        let terms = Terms { a: &one, b: &one, q: &one, r: &one, s: Some(&two) };
        assert!(matches!(solve(&terms, SecondRoute::IfNeeded), Err(Error::Shape { matrix: "s", .. })));
        let terms = Terms { a: &one, b: &nan, q: &one, r: &one, s: None };
        assert!(matches!(solve(&terms, SecondRoute::IfNeeded), Err(Error::NotFinite { quantity: "b", .. })));
        let terms = Terms { a: &two, b: &row, q: &skew, r: &one, s: None };
        assert!(matches!(solve(&terms, SecondRoute::IfNeeded), Err(Error::NotSymmetric { matrix: "q", .. })));
    }
}

#[test]
fn edge_no_states_and_no_inputs() {
    let (none, wide) = (DMatrix::zeros(0, 0), DMatrix::zeros(0, 2));
    let two = DMatrix::identity(2, 2);
    let tall = DMatrix::zeros(2, 0);
    for (discrete, solve) in SOLVERS {
        let terms = Terms { a: &none, b: &wide, q: &none, r: &two, s: None };
        assert_eq!(solve(&terms, SecondRoute::Always).expect("empty").gain.shape(), (2, 0));
        // Without inputs the equation is that of Lyapunov.
        let a = &two * if discrete { 0.5 } else { -0.5 };
        let terms = Terms { a: &a, b: &tall, q: &two, r: &none, s: None };
        let found = solve(&terms, SecondRoute::Always).expect("lyapunov");
        let expected = if discrete { 4.0 / 3.0 } else { 1.0 };
        assert!((found.x - &two * expected).norm() < 1e-15, "discrete {discrete}");
    }
}
