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

use nalgebra::{DMatrix, DVector, SymmetricEigen};
use num_complex::Complex64;

use crate::Error;
use crate::compensated::riccati_residual;
use crate::lyapunov::{check_symmetric, solve_adjoint_with};
use crate::schur::RealSchur;
use crate::triangular_equation::{Kind, Symmetry, inverse_norm};

/// The stable invariant subspace of a Hamiltonian matrix, `H [X1; X2] = [X1; X2] T`.
///
/// The basis is orthonormal in *balanced* coordinates: with `D = diag(scaling)`, the basis in the caller's
/// coordinates is `[D X1; D⁻¹ X2]`. All entries of `D` are powers of two.
#[derive(Clone, Debug, PartialEq)]
pub struct StableSubspace {
    /// Upper half of the basis in balanced coordinates, `n × n`.
    pub x1: DMatrix<f64>,
    /// Lower half of the basis in balanced coordinates, `n × n`.
    pub x2: DMatrix<f64>,
    /// Diagonal of the balancing matrix `D`.
    pub scaling: DVector<f64>,
    /// `T`: the restriction of `H` to the subspace, quasi-triangular; similar to `A - G X` where `X` exists.
    pub restriction: DMatrix<f64>,
    /// Eigenvalues of `T`, in rad/s.
    pub poles: Vec<Complex64>,
    /// Norm of `X1ᵀ X2 - X2ᵀ X1`, zero in exact arithmetic.
    pub isotropy_error: f64,
}

impl StableSubspace {
    /// Returns the stable subspace of the Hamiltonian matrix with the blocks `A`, `G`, `Q`.
    ///
    /// **Shapes and units**: all `n × n`; `g` and `q` symmetric, any definiteness.
    ///
    /// **Method**: symplectic balancing by powers of two, real Schur form, stable eigenvalues moved to the top. An
    /// eigenvalue on the axis shows either in the count of stable ones or, when rounding pushed a pair apart, in a
    /// subspace that is not isotropic (`X1ᵀ X2` not symmetric); no distance from the axis has to be chosen.
    ///
    /// **Source**: Laub 1979; Benner 2001, "Symplectic balancing of Hamiltonian matrices".
    ///
    /// **Errors**: [`Error::HamiltonianAxis`], [`Error::NotSymmetric`], and those of [`RealSchur`].
    pub fn new(a: &DMatrix<f64>, g: &DMatrix<f64>, q: &DMatrix<f64>) -> Result<Self, Error> {
        let n = a.nrows();
        for (matrix, m) in [("a", a), ("g", g), ("q", q)] {
            if m.shape() != (n, n) {
                let (rows, cols) = m.shape();
                return Err(Error::Shape { matrix, expected_rows: n, expected_cols: n, rows, cols });
            }
        }
        check_symmetric("g", g)?;
        check_symmetric("q", q)?;
        Balanced::new(a, g, q).stable_subspace()
    }

    /// Returns the principal angles `theta` of the subspace, sorted: the eigenvalues of `X` are their tangents.
    ///
    /// Angles lie in `(-pi/2, pi/2]`, in balanced coordinates. `X` is positive semidefinite where none is negative
    /// (beyond rounding), infinite where one is `pi/2`. Unlike the eigenvalues of `X1ᵀ X2`, the angles tell an eigenvalue
    /// of `X` that has passed through infinity (just above `-pi/2`) from one that is zero.
    ///
    /// **Method**: `W = X1 + i X2` is unitary, `W Wᵀ = P + i Q` has the eigenvalues `exp(2 i theta)`, and its real part
    /// `P = X1 X1ᵀ - X2 X2ᵀ` and imaginary part `Q = X1 X2ᵀ + X2 X1ᵀ` are symmetric and commute.
    pub fn angles(&self) -> Vec<f64> {
        let p = &self.x1 * self.x1.transpose() - &self.x2 * self.x2.transpose();
        let cross = &self.x1 * self.x2.transpose();
        let q = &cross + cross.transpose();
        // A combination with an irrational angle has the common eigenvectors of both.
        let common = SymmetricEigen::new(&p * MIX.cos() + &q * MIX.sin());
        let mut angles: Vec<f64> = common
            .eigenvectors
            .column_iter()
            .map(|v| 0.5 * (&q * v).dot(&v).atan2((&p * v).dot(&v)))
            .collect();
        angles.sort_by(f64::total_cmp);
        angles
    }

    /// Returns `X = X2 X1⁻¹` in the caller's coordinates.
    ///
    /// **Errors**: [`Error::NoStabilizingSolution`] when `X1` is singular to working precision.
    pub fn solution(&self) -> Result<DMatrix<f64>, Error> {
        Ok(unscale(&self.balanced_solution()?, &self.scaling))
    }

    fn balanced_solution(&self) -> Result<DMatrix<f64>, Error> {
        let n = self.x1.nrows();
        if n == 0 {
            return Ok(DMatrix::zeros(0, 0));
        }
        let singular_values = self.x1.singular_values();
        let reciprocal_condition = singular_values.min() / singular_values.max();
        let failed = Error::NoStabilizingSolution { reciprocal_condition };
        if reciprocal_condition.is_nan() || reciprocal_condition < RECIPROCAL_CONDITION_MIN {
            return Err(failed);
        }
        // X X1 = X2, so X1ᵀ Xᵀ = X2ᵀ.
        let xt = self.x1.transpose().lu().solve(&self.x2.transpose()).ok_or(failed)?;
        Ok((&xt + xt.transpose()) * 0.5)
    }
}

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

/// `D⁻¹ X D⁻¹`.
fn unscale(x: &DMatrix<f64>, d: &DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(x.nrows(), x.ncols(), |i, j| x[(i, j)] / d[i] / d[j])
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

/// The blocks of `S⁻¹ H S` with `S = diag(D, D⁻¹)`.
pub(crate) struct Balanced {
    a: DMatrix<f64>,
    g: DMatrix<f64>,
    q: DMatrix<f64>,
    scaling: DVector<f64>,
}

impl Balanced {
    pub(crate) fn new(a: &DMatrix<f64>, g: &DMatrix<f64>, q: &DMatrix<f64>) -> Self {
        let n = a.nrows();
        let mut blocks =
            Self { a: a.clone(), g: g.clone(), q: q.clone(), scaling: DVector::from_element(n, 1.0) };
        for _ in 0..BALANCING_SWEEPS_MAX {
            let mut settled = true;
            for i in 0..n {
                let f = blocks.factor(i);
                if f != 1.0 {
                    settled = false;
                    blocks.scale(i, f);
                }
            }
            if settled {
                break;
            }
        }
        blocks
    }

    /// Power of two by which state `i` should be scaled, 1 where that gains less than five per cent.
    fn factor(&self, i: usize) -> f64 {
        let off_diagonal = |sum: f64, k: usize, v: f64| if k == i { sum } else { sum + v.abs() };
        let column_a = self.a.column(i).iter().enumerate().fold(0.0, |s, (k, &v)| off_diagonal(s, k, v));
        let row_a = self.a.row(i).iter().enumerate().fold(0.0, |s, (k, &v)| off_diagonal(s, k, v));
        let column_q = self.q.column(i).iter().enumerate().fold(0.0, |s, (k, &v)| off_diagonal(s, k, v));
        let row_g = self.g.row(i).iter().enumerate().fold(0.0, |s, (k, &v)| off_diagonal(s, k, v));
        let (diagonal_q, diagonal_g) = (self.q[(i, i)].abs(), self.g[(i, i)].abs());
        // A state without column or row would be scaled without end (Parlett and Reinsch permute those away).
        if column_a + column_q + diagonal_q == 0.0 || row_a + row_g + diagonal_g == 0.0 {
            return 1.0;
        }
        // Scaling by f multiplies the column's entries by f, Q's diagonal by f², and divides row and G likewise.
        let cost = |f: f64| {
            (column_a + column_q) * f + (row_a + row_g) / f + diagonal_q * f * f + diagonal_g / (f * f)
        };
        let mut best = 1.0;
        for direction in [2.0, 0.5] {
            let mut f = direction;
            for _ in 0..FACTOR_EXPONENT_MAX {
                let total = (self.scaling[i] * f).log2().abs();
                if cost(f) >= WORTHWHILE * cost(best) || total > SCALING_EXPONENT_MAX {
                    break;
                }
                best = f;
                f *= direction;
            }
        }
        best
    }

    fn scale(&mut self, i: usize, f: f64) {
        self.scaling[i] *= f;
        self.a.column_mut(i).scale_mut(f);
        self.a.row_mut(i).unscale_mut(f);
        self.q.column_mut(i).scale_mut(f);
        self.q.row_mut(i).scale_mut(f);
        self.g.column_mut(i).unscale_mut(f);
        self.g.row_mut(i).unscale_mut(f);
    }

    fn symmetrize(&mut self) {
        self.g = (&self.g + self.g.transpose()) * 0.5;
        self.q = (&self.q + self.q.transpose()) * 0.5;
    }

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

    /// The balanced Hamiltonian matrix, `2n × 2n`.
    pub(crate) fn hamiltonian(&self) -> DMatrix<f64> {
        let n = self.a.nrows();
        let mut h = DMatrix::zeros(2 * n, 2 * n);
        h.view_mut((0, 0), (n, n)).copy_from(&self.a);
        h.view_mut((0, n), (n, n)).copy_from(&-&self.g);
        h.view_mut((n, 0), (n, n)).copy_from(&-&self.q);
        h.view_mut((n, n), (n, n)).copy_from(&-self.a.transpose());
        h
    }

    fn stable_subspace(self) -> Result<StableSubspace, Error> {
        let n = self.a.nrows();
        let schur = RealSchur::new(&self.hamiltonian())?;
        let values = schur.eigenvalues();
        let axis = |values: &[Complex64]| {
            let nearest = values.iter().min_by(|a, b| a.re.abs().total_cmp(&b.re.abs()));
            let (re, omega_rad_s) = nearest.map_or((0.0, 0.0), |v| (v.re.abs(), v.im.abs()));
            Error::HamiltonianAxis { re, omega_rad_s }
        };
        if values.iter().filter(|v| v.re < 0.0).count() != n {
            return Err(axis(&values));
        }
        let ordered = schur.order(|v| v.re < 0.0)?;
        if ordered.n_selected != n {
            return Err(axis(&values));
        }
        let form = ordered.form;
        let x1 = form.q.view((0, 0), (n, n)).into_owned();
        let x2 = form.q.view((n, 0), (n, n)).into_owned();
        let product = x1.transpose() * &x2;
        let isotropy_error = (&product - product.transpose()).norm();
        if isotropy_error > ISOTROPY_TOLERANCE {
            return Err(axis(&values));
        }
        let mut poles = form.eigenvalues();
        poles.truncate(n);
        let restriction = form.t.view((0, 0), (n, n)).into_owned();
        Ok(StableSubspace { x1, x2, scaling: self.scaling, restriction, poles, isotropy_error })
    }
}

/// Angle of the combination in [`StableSubspace::angles`]: not a rational part of pi, tangent not near a power of two.
const MIX: f64 = 0.9;

/// Below this ratio of singular values a basis half has no meaningful inverse.
const RECIPROCAL_CONDITION_MIN: f64 = 1e-15;

/// Newton converges quadratically from a subspace solution; more steps only shuffle rounding.
const NEWTON_STEPS_MAX: usize = 6;

/// Sweeps allowed; balancing may stop at any of them without harm.
const BALANCING_SWEEPS_MAX: usize = 64;

/// Largest exponent of one scaling step.
const FACTOR_EXPONENT_MAX: usize = 64;

/// Largest exponent of a state's scaling; beyond it entries are rounding of zeros.
const SCALING_EXPONENT_MAX: f64 = 100.0;

/// A scaling step that gains less than five per cent is not taken (LAPACK's `GEBAL` uses the same figure).
const WORTHWHILE: f64 = 0.95;

/// A pair of axis eigenvalues that rounding has split makes this of order one; sound subspaces stay below 1e-7 even with
/// eigenvalues within 1e-9 of the matrix norm from the axis.
const ISOTROPY_TOLERANCE: f64 = 1e-5;

#[cfg(test)]
mod tests {
    use super::*;
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
