//! Stable subspaces of Hamiltonian matrices and the continuous Riccati equation.
//!
//! `X` solves `Aᵀ X + X A - X G X + Q = 0` with `A - G X` stable if and only if the columns of `[I; X]` span the
//! stable invariant subspace of
//!
//! ```text
//!     H = [  A   -G  ]
//!         [ -Q   -Aᵀ ]
//! ```
//!
//! The subspace exists wherever `H` has no eigenvalues on the imaginary axis, also where `X` does not; it is what
//! H-infinity conditions should be tested on.

mod balancing;
mod general;
#[cfg(test)]
mod general_tests;
mod iterations;
mod pencil;
mod refinement;
mod stabilizability;
mod subspace;

use nalgebra::DMatrix;
use num_complex::Complex64;

use crate::Error;
use crate::compensated::riccati_residual;
use crate::lyapunov::{check_symmetric, solve_adjoint_with};
use crate::schur::RealSchur;
use crate::triangular_equation::{Kind, Symmetry, inverse_norm};
use balancing::{Balanced, unscale};
use subspace::RECIPROCAL_CONDITION_MIN;

pub use general::{GeneralSolution, Route, SecondRoute, Terms, care, dare};
pub use subspace::{StableSubspace, Subspace};

/// The stabilizing solution of a Riccati equation and the evidence for it.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// The symmetric solution `X`, `n × n`.
    pub x: DMatrix<f64>,
    /// Frobenius norm of the equation's left-hand side, evaluated in doubled precision and balanced coordinates, over the
    /// sum of the norms of its terms.
    pub residual_relative: f64,
    /// Eigenvalues of `A - G X`, all with negative real part, in rad/s.
    pub closed_loop_poles: Vec<Complex64>,
    /// Newton corrections that were accepted after the subspace method.
    pub n_newton_steps: usize,
    /// Estimate of the relative change of `X` over a relative change of the terms, in balanced coordinates: the norms of
    /// the terms over `||X||` and the separation of `A - G X` from its negative transpose.
    pub condition: f64,
}

/// Returns the stabilizing solution of `Aᵀ X + X A - X G X + Q = 0`.
///
/// **Shapes and units**: all `n × n`; `g` and `q` symmetric, any definiteness.
///
/// **Method**: [`StableSubspace`], then Newton steps (a Lyapunov equation each) on the residual in doubled precision. A step
/// is kept only when it lowers the residual and leaves `A - G X` stable: unguarded Newton diverges near the limits of
/// H-infinity problems.
///
/// **Accuracy**: see [`Solution::residual_relative`]; near the machine precision for well-posed equations.
///
/// **Errors**: [`Error::HamiltonianAxis`], [`Error::NoStabilizingSolution`], [`Error::NotSymmetric`].
///
/// **Example**
/// ```
/// use nalgebra::dmatrix;
/// // -2 X - X² + 3 = 0
/// let s = telepulse_lti::riccati::continuous(&dmatrix![-1.0], &dmatrix![1.0], &dmatrix![3.0])?;
/// assert!((s.x[(0, 0)] - 1.0).abs() < 1e-15);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn continuous(a: &DMatrix<f64>, g: &DMatrix<f64>, q: &DMatrix<f64>) -> Result<Solution, Error> {
    let subspace = StableSubspace::new(a, g, q)?;
    let mut balanced = Balanced::new(a, g, q);
    balanced.symmetrize();
    let mut best = balanced.candidate(subspace.balanced_solution()?)?;
    let mut n_newton_steps = 0;
    for _ in 0..NEWTON_STEPS_MAX {
        if best.residual.relative < f64::EPSILON {
            break;
        }
        // (A - G X)ᵀ N + N (A - G X) + R = 0
        let Ok(step) = solve_adjoint_with(&best.closed_loop, &best.residual.matrix, Kind::Continuous) else {
            break;
        };
        let next = balanced.candidate(&best.x + step)?;
        let improved = next.residual.relative < best.residual.relative;
        if !improved || next.poles.iter().any(|p| p.re >= 0.0) {
            break;
        }
        let negligible = next.residual.relative > 0.5 * best.residual.relative;
        best = next;
        n_newton_steps += 1;
        if negligible {
            break;
        }
    }
    let t = &best.closed_loop.t;
    let inverse = inverse_norm(t, t, Kind::Continuous, Symmetry::Symmetric);
    let condition = inverse * best.residual.scale / best.x.norm();
    Ok(Solution {
        x: unscale(&best.x, &balanced.scaling),
        residual_relative: best.residual.relative,
        closed_loop_poles: best.poles,
        n_newton_steps,
        condition: if best.residual.scale > 0.0 { condition } else { inverse },
    })
}

/// Returns the stabilizing solution of `Aᵀ X + X A - (X B + S) R⁻¹ (Bᵀ X + Sᵀ) + Q = 0`.
///
/// **Shapes and units**: `a`, `q`: `n × n`; `b`, `s`: `n × m`; `r`: `m × m`, symmetric and invertible, any
/// definiteness.
///
/// **Method**: eliminates the cross term and calls [`continuous`] with `A - B R⁻¹ Sᵀ`, `B R⁻¹ Bᵀ`, `Q - S R⁻¹ Sᵀ`.
///
/// **Errors**: as [`continuous`]; [`Error::Singular`] for `r`.
pub fn continuous_with_cross_term(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
    s: &DMatrix<f64>,
) -> Result<Solution, Error> {
    let (n, m) = b.shape();
    for (matrix, found, expected) in [
        ("a", a.shape(), (n, n)),
        ("q", q.shape(), (n, n)),
        ("r", r.shape(), (m, m)),
        ("s", s.shape(), (n, m)),
    ] {
        if found != expected {
            let ((rows, cols), (expected_rows, expected_cols)) = (found, expected);
            return Err(Error::Shape { matrix, expected_rows, expected_cols, rows, cols });
        }
    }
    check_symmetric("r", r)?;
    let singular_values = r.singular_values();
    let reciprocal_condition = if m == 0 { 1.0 } else { singular_values.min() / singular_values.max() };
    let singular = Error::Singular { matrix: "r", reciprocal_condition };
    if reciprocal_condition.is_nan() || reciprocal_condition < RECIPROCAL_CONDITION_MIN {
        return Err(singular);
    }
    let lu = r.clone().lu();
    let (rs, rb) = match (lu.solve(&s.transpose()), lu.solve(&b.transpose())) {
        (Some(rs), Some(rb)) => (rs, rb),
        _ => return Err(singular),
    };
    let g = b * rb;
    let q = q - s * &rs;
    continuous(&(a - b * rs), &((&g + g.transpose()) * 0.5), &((&q + q.transpose()) * 0.5))
}

struct Residual {
    matrix: DMatrix<f64>,
    relative: f64,
    scale: f64,
}

/// A solution in balanced coordinates with what is known of it.
struct Candidate {
    x: DMatrix<f64>,
    residual: Residual,
    closed_loop: RealSchur,
    poles: Vec<Complex64>,
}

impl Balanced {
    fn residual(&self, x: &DMatrix<f64>) -> Residual {
        let matrix = riccati_residual(&self.a, &self.g, &self.q, x);
        let scale = 2.0 * (x * &self.a).norm() + (x * &self.g * x).norm() + self.q.norm();
        let relative = if scale > 0.0 { matrix.norm() / scale } else { 0.0 };
        Residual { matrix, relative, scale }
    }

    fn candidate(&self, x: DMatrix<f64>) -> Result<Candidate, Error> {
        let residual = self.residual(&x);
        let closed_loop = RealSchur::new(&(&self.a - &self.g * &x))?;
        let poles = closed_loop.eigenvalues();
        Ok(Candidate { x, residual, closed_loop, poles })
    }
}

/// Newton converges quadratically from a subspace solution; more steps only shuffle rounding.
const NEWTON_STEPS_MAX: usize = 6;

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DVector;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn law_random_equations_have_small_residuals_and_stable_loops() {
        let seed = 21;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        for trial in 0..200 {
            let n = 1 + trial % 10;
            let mut matrix = |rows, cols| DMatrix::from_fn(rows, cols, |_, _| rng.random_range(-1.0..1.0));
            let (a, b, c) = (matrix(n, n), matrix(n, 2), matrix(2, n));
            let (g, q) = (&b * b.transpose(), c.transpose() * &c);
            let s = continuous(&a, &g, &q).expect("stabilizable and detectable with probability one");
            assert!(s.residual_relative < 1e-13, "seed {seed} trial {trial}: {}", s.residual_relative);
            assert!(s.closed_loop_poles.iter().all(|p| p.re < 0.0));
            // Judged by another route: plain arithmetic, and definiteness by eigenvalues.
            let r = a.transpose() * &s.x + &s.x * &a - &s.x * &g * &s.x + &q;
            assert!(r.norm() < 1e-10 * (1.0 + s.x.norm() * s.x.norm()), "seed {seed} trial {trial}");
            assert!(s.x.clone().symmetric_eigenvalues().min() > -1e-10 * s.x.norm());
        }
    }

    #[test]
    fn law_badly_scaled_states_do_not_hurt() {
        // x = T x' with T spanning twelve decades must give X' = Tᵀ X T.
        let a = nalgebra::dmatrix![-1.0, 2.0, 0.0; 0.0, 1.0, 1.0; 1.0, 0.0, -3.0];
        let (b, c) = (nalgebra::dmatrix![1.0; 0.5; 0.0], nalgebra::dmatrix![1.0, 0.0, 2.0]);
        let (g, q) = (&b * b.transpose(), c.transpose() * &c);
        let plain = continuous(&a, &g, &q).expect("regular").x;
        let t = DMatrix::from_diagonal(&DVector::from_column_slice(&[1e-6, 1.0, 1e6]));
        let inverse = DMatrix::from_diagonal(&DVector::from_column_slice(&[1e6, 1.0, 1e-6]));
        let scaled = continuous(&(&inverse * &a * &t), &(&inverse * &g * &inverse), &(&t * &q * &t))
            .expect("regular")
            .x;
        let back = &inverse * scaled * &inverse;
        assert!((&back - &plain).norm() < 1e-12 * plain.norm(), "{}", (&back - &plain).norm());
    }

    #[test]
    fn regress_a_state_without_a_row_is_not_scaled_without_end() {
        // Q = 0 and a triangular A leave the last state without off-diagonal entries in its column; its scaling used to
        // run to 2^1000 and the basis with it.
        let a = nalgebra::dmatrix![-1.0, 0.0; 3.0, -2.0];
        let g = nalgebra::dmatrix![1.0, 0.0; 0.0, 0.0];
        let s = StableSubspace::new(&a, &g, &DMatrix::zeros(2, 2)).expect("stable");
        assert!(s.scaling.iter().all(|d| d.log2().abs() <= 4.0), "{}", s.scaling);
        assert!(s.solution().expect("finite").norm() < 1e-15);
    }

    #[test]
    fn law_cross_terms_agree_with_a_hand_solved_equation() {
        // a = -1, b = 1, q = 2, r = 1, s = 1: -2x - (x + 1)² + 2 = 0, so x² + 4x - 1 = 0 and x = sqrt(5) - 2.
        let m = |v: f64| DMatrix::from_element(1, 1, v);
        let s = continuous_with_cross_term(&m(-1.0), &m(1.0), &m(2.0), &m(1.0), &m(1.0)).expect("regular");
        assert!((s.x[(0, 0)] - (5.0_f64.sqrt() - 2.0)).abs() < 1e-15);
    }

    #[test]
    fn law_angles_tell_zero_from_beyond_infinity() {
        // Scalar H-infinity equation -2 x + g x² ... with g = -1 (disturbance): x² - 2x + q = 0 for q < 1.
        let m = |v: f64| DMatrix::from_element(1, 1, v);
        let small = StableSubspace::new(&m(-1.0), &m(-1.0), &m(0.0)).expect("no axis eigenvalues");
        assert!(small.angles()[0].abs() < 1e-15);
        // a = 1, g = -1, q = -1e-12: the stabilizing x of x² + 2x - 1e-12 = 0 is about -2, i.e. negative.
        let beyond = StableSubspace::new(&m(1.0), &m(-1.0), &m(-1e-12)).expect("no axis eigenvalues");
        assert!(beyond.angles()[0] < -0.1);
    }

    #[test]
    fn edge_axis_eigenvalues_are_reported_with_their_frequency() {
        // Undamped and unobservable oscillator at 3 rad/s.
        let a = nalgebra::dmatrix![0.0, 3.0; -3.0, 0.0];
        let b = nalgebra::dmatrix![0.0; 1.0];
        let zero = DMatrix::zeros(2, 2);
        match continuous(&a, &(&b * b.transpose()), &zero) {
            Err(Error::HamiltonianAxis { re, omega_rad_s }) => {
                assert!(re < 1e-6 && (omega_rad_s - 3.0).abs() < 1e-6, "{re} {omega_rad_s}");
            }
            other => panic!("expected axis eigenvalues, found {other:?}"),
        }
    }
}
