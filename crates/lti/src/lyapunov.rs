//! Continuous and discrete Lyapunov equations by the method of Bartels and Stewart.

use nalgebra::{DMatrix, DVector};

use crate::Error;
use crate::balance::balance_matrix;
use crate::doubled_matrix::DoubledMatrix;
use crate::schur::RealSchur;
use crate::triangular_equation::{self, Kind, SmallPivot, Symmetry, inverse_norm};

/// The solution of a Lyapunov equation and the evidence for it.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// The symmetric solution `X`, `n × n`.
    pub x: DMatrix<f64>,
    /// Frobenius norm of the equation's left-hand side over the sum of the norms of its terms, in doubled precision and
    /// balanced coordinates.
    pub residual_relative: f64,
    /// Estimate, from above, of the separation: the least norm of `A N + N Aᵀ` (or `A N Aᵀ - N`) over symmetric `N` of
    /// norm one, in balanced coordinates.
    pub separation: f64,
    /// Estimate of the relative change of `X` over a relative change of the terms: their norms over `separation ||X||`.
    pub condition: f64,
    /// Steps of iterative refinement that were taken.
    pub n_refinements: usize,
}

/// Returns the `X` that solves `A X + X Aᵀ + Q = 0`.
///
/// **Shapes and units**: `a`, `q`: `n × n`, `q` symmetric. With `Q = B Bᵀ`, `X` is the controllability Gramian.
///
/// **Method**: diagonal balancing, real Schur form of `A`, back substitution by columns of blocks of which symmetry
/// saves half, and refinement with a residual in doubled precision where the equation is ill conditioned.
///
/// **Source**: Bartels and Stewart 1972; Higham 2002, chapter 16, for the condition.
///
/// **Errors**: [`Error::LyapunovSingular`] where two eigenvalues of `A` sum to zero; [`Error::NotSymmetric`],
/// [`Error::Shape`], [`Error::NotFinite`], [`Error::Overflow`].
///
/// **Example**
/// ```
/// use nalgebra::dmatrix;
/// let s = telepulse_lti::lyapunov::continuous(&dmatrix![-2.0], &dmatrix![1.0])?;
/// assert!((s.x[(0, 0)] - 0.25).abs() < 1e-15);
/// assert!((s.separation - 4.0).abs() < 1e-14);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn continuous(a: &DMatrix<f64>, q: &DMatrix<f64>) -> Result<Solution, Error> {
    solve(a, q, Kind::Continuous)
}

/// Returns the `X` that solves `A X Aᵀ - X + Q = 0`.
///
/// **Shapes and units**: `a`, `q`: `n × n`, `q` symmetric. With `Q = B Bᵀ`, `X` is the controllability Gramian of a
/// discrete system.
///
/// **Method**: as [`continuous`], on the Schur form of `A`, without forming an inverse.
///
/// **Source**: Kitagawa 1977; Barraud 1977.
///
/// **Errors**: [`Error::LyapunovSingular`] where two eigenvalues of `A` multiply to one; [`Error::NotSymmetric`],
/// [`Error::Shape`], [`Error::NotFinite`], [`Error::Overflow`].
///
/// **Example**
/// ```
/// use nalgebra::dmatrix;
/// // x / 4 - x + 3 = 0
/// let s = telepulse_lti::lyapunov::discrete(&dmatrix![0.5], &dmatrix![3.0])?;
/// assert!((s.x[(0, 0)] - 4.0).abs() < 1e-15);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn discrete(a: &DMatrix<f64>, q: &DMatrix<f64>) -> Result<Solution, Error> {
    solve(a, q, Kind::Discrete)
}

fn solve(a: &DMatrix<f64>, q: &DMatrix<f64>, kind: Kind) -> Result<Solution, Error> {
    check(a, q)?;
    let n = a.nrows();
    let mut balanced = a.clone();
    let d = balance_matrix(&mut balanced);
    // D⁻¹ Q D⁻¹, made symmetric; X scales likewise.
    let f = DMatrix::from_fn(n, n, |i, j| 0.5 * (q[(i, j)] + q[(j, i)]) / d[i] / d[j]);
    let schur = RealSchur::new(&balanced)?;
    let back = |f: &DMatrix<f64>| solve_with(&schur, f, kind).map_err(|small| singular(kind, small));
    let mut x = back(&f)?;
    let inverse = inverse_norm(&schur.t, &schur.t, kind, Symmetry::Symmetric);
    let (mut residual, mut scale) = residual(&balanced, &f, &x, kind);
    let condition = inverse * scale / x.norm();
    let mut n_refinements = 0;
    while n_refinements < REFINEMENTS_MAX
        && (relative(residual.norm(), scale) > REFINE_ABOVE || condition > REFINE_ABOVE_CONDITION)
    {
        let candidate = &x + back(&residual)?;
        let (next, next_scale) = self::residual(&balanced, &f, &candidate, kind);
        if next.norm().is_nan() || next.norm() > 0.5 * residual.norm() {
            break;
        }
        (x, residual, scale) = (candidate, next, next_scale);
        n_refinements += 1;
    }
    let residual_relative = relative(residual.norm(), scale);
    let x = unscale(&x, &d);
    if x.iter().any(|v| !v.is_finite()) {
        return Err(Error::Overflow { operation: "the solution of a lyapunov equation" });
    }
    let condition = if scale > 0.0 { condition } else { inverse };
    Ok(Solution { x, residual_relative, separation: 1.0 / inverse, condition, n_refinements })
}

/// `D X D`.
fn unscale(x: &DMatrix<f64>, d: &DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(x.nrows(), x.ncols(), |i, j| x[(i, j)] * d[i] * d[j])
}

fn singular(kind: Kind, small: SmallPivot) -> Error {
    let relation = match kind {
        Kind::Continuous => "sum to zero",
        Kind::Discrete => "multiply to one",
    };
    Error::LyapunovSingular { relation, pivot: small.pivot, threshold: small.threshold }
}

/// Solves `A X + X Aᵀ + F = 0`, or `A X Aᵀ - X + F = 0`, for `A` in Schur form and symmetric `F`.
pub(crate) fn solve_with(
    schur: &RealSchur,
    f: &DMatrix<f64>,
    kind: Kind,
) -> Result<DMatrix<f64>, SmallPivot> {
    let (u, t) = (&schur.q, &schur.t);
    let mut y = -(u.transpose() * f * u);
    triangular_equation::solve(t, t, &mut y, kind, Symmetry::Symmetric)?;
    Ok(symmetric(&(u * y * u.transpose())))
}

/// Solves `Aᵀ X + X A + F = 0`, or `Aᵀ X A - X + F = 0`, for `A` in Schur form and symmetric `F`.
pub(crate) fn solve_adjoint_with(
    schur: &RealSchur,
    f: &DMatrix<f64>,
    kind: Kind,
) -> Result<DMatrix<f64>, SmallPivot> {
    let (u, t) = (&schur.q, &schur.t);
    let y = triangular_equation::solve_adjoint(t, t, &-(u.transpose() * f * u), kind, Symmetry::Symmetric)?;
    Ok(symmetric(&(u * y * u.transpose())))
}

pub(crate) fn symmetric(m: &DMatrix<f64>) -> DMatrix<f64> {
    (m + m.transpose()) * 0.5
}

/// The equation's left-hand side in doubled precision, and the sum of the norms of its terms.
fn residual(a: &DMatrix<f64>, q: &DMatrix<f64>, x: &DMatrix<f64>, kind: Kind) -> (DMatrix<f64>, f64) {
    let (a, x2, q2) = (DoubledMatrix::from(a), DoubledMatrix::from(x), DoubledMatrix::from(q));
    let product = a.times(&x2);
    let (sum, scale) = match kind {
        Kind::Continuous => {
            let scale = 2.0 * product.rounded().norm() + q.norm();
            (product.plus_transpose().plus(&q2), scale)
        }
        Kind::Discrete => {
            let product = product.times(&a.transpose());
            let scale = product.rounded().norm() + x.norm() + q.norm();
            (product.minus(&x2).plus(&q2), scale)
        }
    };
    (symmetric(&sum.rounded()), scale)
}

fn relative(residual: f64, scale: f64) -> f64 {
    if scale > 0.0 { residual / scale } else { 0.0 }
}

fn check(a: &DMatrix<f64>, q: &DMatrix<f64>) -> Result<(), Error> {
    let n = a.nrows();
    for (matrix, m) in [("a", a), ("q", q)] {
        if m.shape() != (n, n) {
            let (rows, cols) = m.shape();
            return Err(Error::Shape { matrix, expected_rows: n, expected_cols: n, rows, cols });
        }
        if let Some((index, &value)) = m.iter().enumerate().find(|(_, v)| !v.is_finite()) {
            return Err(Error::NotFinite { quantity: matrix, index, value });
        }
    }
    check_symmetric("q", q)
}

/// Refuses a matrix whose antisymmetric part is more than rounding.
pub(crate) fn check_symmetric(matrix: &'static str, m: &DMatrix<f64>) -> Result<(), Error> {
    let asymmetry = relative((m - m.transpose()).norm(), m.norm());
    if asymmetry > SYMMETRY_TOLERANCE { Err(Error::NotSymmetric { matrix, asymmetry }) } else { Ok(()) }
}

/// Relative asymmetry that counts as rounding of the caller's products.
const SYMMETRY_TOLERANCE: f64 = 1e-8;
/// Back substitution stays below this unless the matrix is graded beyond balancing.
const REFINE_ABOVE: f64 = 1e-15;
/// Above this condition refinement gains digits in the solution although the residual is at rounding already.
const REFINE_ABOVE_CONDITION: f64 = 1e4;
/// Refinement gains the digits that the condition leaves with every step.
const REFINEMENTS_MAX: usize = 3;

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    fn random(n: usize, rng: &mut rand_pcg::Pcg64) -> DMatrix<f64> {
        DMatrix::from_fn(n, n, |_, _| rng.random_range(-1.0..1.0))
    }

    #[test]
    fn law_random_equations_agree_with_the_kronecker_system() {
        let seed = 5;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        for trial in 0..120 {
            let n = 1 + trial % 9;
            let a = random(n, &mut rng);
            let b = random(n, &mut rng);
            let q = &b + b.transpose();
            let one = DMatrix::<f64>::identity(n, n);
            let rhs = -nalgebra::DVector::from_column_slice(q.as_slice());
            let systems = [
                (continuous(&a, &q), one.kronecker(&a) + a.kronecker(&one)),
                (discrete(&a, &q), a.kronecker(&a) - DMatrix::identity(n * n, n * n)),
            ];
            for (solution, system) in systems {
                let solution = solution.expect("random equations are regular");
                let svd = system.clone().svd(false, false).singular_values;
                let condition = svd.max() / svd.min();
                let expected = system.lu().solve(&rhs).expect("regular");
                let difference =
                    (nalgebra::DVector::from_column_slice(solution.x.as_slice()) - &expected).norm();
                assert!(difference < 1e-14 * condition * expected.norm(), "seed {seed} trial {trial}");
                assert!(solution.residual_relative < 1e-12, "seed {seed} trial {trial}");
            }
        }
    }

    #[test]
    fn edge_eigenvalues_on_the_boundary_are_refused() {
        let rotation = nalgebra::dmatrix![0.0, 1.0; -1.0, 0.0];
        let one = DMatrix::identity(2, 2);
        assert!(matches!(continuous(&rotation, &one), Err(Error::LyapunovSingular { .. })));
        assert!(matches!(discrete(&rotation, &one), Err(Error::LyapunovSingular { .. })));
    }

    #[test]
    fn edge_an_unsymmetric_term_is_refused() {
        let q = nalgebra::dmatrix![1.0, 2.0; 0.0, 1.0];
        assert!(matches!(continuous(&-DMatrix::identity(2, 2), &q), Err(Error::NotSymmetric { .. })));
    }
}
