//! Continuous and discrete Sylvester equations.

use nalgebra::DMatrix;

use crate::Error;
use crate::balance::balance_matrix;
use crate::doubled_matrix::DoubledMatrix;
use crate::hessenberg::check_square_and_finite;
use crate::schur::RealSchur;
use crate::triangular_equation::{self, Kind, SmallPivot, Symmetry, inverse_norm};

/// The solution of a Sylvester equation and the evidence for it.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// The solution `X`, `m × n`.
    pub x: DMatrix<f64>,
    /// Frobenius norm of the equation's left-hand side over the sum of the norms of its terms, in doubled precision and
    /// balanced coordinates.
    pub residual_relative: f64,
    /// Estimate, from above, of the separation: the least norm of `A N + N B` (or `A N B - N`) over `N` of norm one, in
    /// balanced coordinates.
    pub separation: f64,
    /// Estimate of the relative change of `X` over a relative change of the terms: their norms over `separation ||X||`.
    pub condition: f64,
    /// Steps of iterative refinement that were taken.
    pub n_refinements: usize,
}

/// Returns the `X` that solves `A X + X B + C = 0`.
///
/// **Shapes and units**: `a`: `m × m`; `b`: `n × n`; `c`, `X`: `m × n`. The sign of `C` is that of
/// [`crate::lyapunov`]: negate it for `A X + X B = C`.
///
/// **Method**: diagonal balancing of `A` and `B`, real Schur forms of both, back substitution, and refinement with a
/// residual in doubled precision where the equation is ill conditioned.
///
/// **Source**: Bartels and Stewart 1972; Higham 2002, chapter 16, for the condition.
///
/// **Errors**: [`Error::SylvesterSingular`] where an eigenvalue of `A` and one of `B` sum to zero; [`Error::Shape`],
/// [`Error::NotFinite`], [`Error::Overflow`].
///
/// **Example**
/// ```
/// use nalgebra::dmatrix;
/// // 2 x + 3 x - 10 = 0
/// let s = telepulse_lti::sylvester::continuous(&dmatrix![2.0], &dmatrix![3.0], &dmatrix![-10.0])?;
/// assert!((s.x[(0, 0)] - 2.0).abs() < 1e-15);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn continuous(a: &DMatrix<f64>, b: &DMatrix<f64>, c: &DMatrix<f64>) -> Result<Solution, Error> {
    solve(a, b, c, Kind::Continuous)
}

/// Returns the `X` that solves `A X B - X + C = 0`.
///
/// **Shapes and units**: as [`continuous`].
///
/// **Method**: as [`continuous`], without forming an inverse.
///
/// **Source**: Kitagawa 1977; Golub, Nash and Van Loan 1979.
///
/// **Errors**: [`Error::SylvesterSingular`] where an eigenvalue of `A` and one of `B` multiply to one; [`Error::Shape`],
/// [`Error::NotFinite`], [`Error::Overflow`].
///
/// **Example**
/// ```
/// use nalgebra::dmatrix;
/// // 3 x - x - 10 = 0
/// let s = telepulse_lti::sylvester::discrete(&dmatrix![1.5], &dmatrix![2.0], &dmatrix![-10.0])?;
/// assert!((s.x[(0, 0)] - 5.0).abs() < 1e-14);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn discrete(a: &DMatrix<f64>, b: &DMatrix<f64>, c: &DMatrix<f64>) -> Result<Solution, Error> {
    solve(a, b, c, Kind::Discrete)
}

fn solve(a: &DMatrix<f64>, b: &DMatrix<f64>, c: &DMatrix<f64>, kind: Kind) -> Result<Solution, Error> {
    check_square_and_finite("a", a)?;
    check_square_and_finite("b", b)?;
    let (m, n) = (a.nrows(), b.nrows());
    if c.shape() != (m, n) {
        let (rows, cols) = c.shape();
        return Err(Error::Shape { matrix: "c", expected_rows: m, expected_cols: n, rows, cols });
    }
    if let Some((index, &value)) = c.iter().enumerate().find(|(_, v)| !v.is_finite()) {
        return Err(Error::NotFinite { quantity: "c", index, value });
    }
    let (mut a, mut bt) = (a.clone(), b.transpose());
    let (d, e) = (balance_matrix(&mut a), balance_matrix(&mut bt));
    // X = D X' E with A' = D⁻¹ A D and (Bᵀ)' = E⁻¹ Bᵀ E.
    let c = DMatrix::from_fn(m, n, |i, j| c[(i, j)] / d[i] / e[j]);
    let (left, right) = (RealSchur::new(&a)?, RealSchur::new(&bt)?);
    let back = |c: &DMatrix<f64>| {
        let mut y = -(left.q.transpose() * c * &right.q);
        triangular_equation::solve(&left.t, &right.t, &mut y, kind, Symmetry::General)
            .map_err(|small| singular(kind, small))?;
        Ok::<_, Error>(&left.q * y * right.q.transpose())
    };
    let mut x = back(&c)?;
    let inverse = inverse_norm(&left.t, &right.t, kind, Symmetry::General);
    let (mut residual, mut scale) = residual(&a, &bt, &c, &x, kind);
    let condition = if scale > 0.0 { inverse * scale / x.norm() } else { inverse };
    let mut n_refinements = 0;
    while n_refinements < REFINEMENTS_MAX
        && (residual.norm() > REFINE_ABOVE * scale || condition > REFINE_ABOVE_CONDITION)
    {
        let candidate = &x + back(&residual)?;
        let (next, next_scale) = self::residual(&a, &bt, &c, &candidate, kind);
        if next.norm().is_nan() || next.norm() > 0.5 * residual.norm() {
            break;
        }
        (x, residual, scale) = (candidate, next, next_scale);
        n_refinements += 1;
    }
    let residual_relative = if scale > 0.0 { residual.norm() / scale } else { 0.0 };
    let x = DMatrix::from_fn(m, n, |i, j| x[(i, j)] * d[i] * e[j]);
    if x.iter().any(|v| !v.is_finite()) {
        return Err(Error::Overflow { operation: "the solution of a sylvester equation" });
    }
    Ok(Solution { x, residual_relative, separation: 1.0 / inverse, condition, n_refinements })
}

fn singular(kind: Kind, small: SmallPivot) -> Error {
    let relation = match kind {
        Kind::Continuous => "sum to zero",
        Kind::Discrete => "multiply to one",
    };
    Error::SylvesterSingular { relation, pivot: small.pivot, threshold: small.threshold }
}

/// The equation's left-hand side in doubled precision, and the sum of the norms of its terms.
fn residual(
    a: &DMatrix<f64>,
    bt: &DMatrix<f64>,
    c: &DMatrix<f64>,
    x: &DMatrix<f64>,
    kind: Kind,
) -> (DMatrix<f64>, f64) {
    let (a, b, c2, x2) =
        (DoubledMatrix::from(a), DoubledMatrix::from(&bt.transpose()), DoubledMatrix::from(c), x.into());
    match kind {
        Kind::Continuous => {
            let (left, right) = (a.times(&x2), x2.times(&b));
            let scale = left.rounded().norm() + right.rounded().norm() + c.norm();
            (left.plus(&right).plus(&c2).rounded(), scale)
        }
        Kind::Discrete => {
            let product = a.times(&x2).times(&b);
            let scale = product.rounded().norm() + x.norm() + c.norm();
            (product.minus(&x2).plus(&c2).rounded(), scale)
        }
    }
}

/// Back substitution stays below this unless the matrices are graded beyond balancing.
const REFINE_ABOVE: f64 = 1e-15;
/// Above this condition refinement gains digits in the solution although the residual is at rounding already.
const REFINE_ABOVE_CONDITION: f64 = 1e4;
/// Refinement gains the digits that the condition leaves with every step.
const REFINEMENTS_MAX: usize = 3;

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn law_random_equations_agree_with_the_kronecker_system() {
        let seed = 6;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        for trial in 0..150 {
            let (m, n) = (1 + trial % 7, 1 + trial % 5);
            let mut matrix = |rows, cols| DMatrix::from_fn(rows, cols, |_, _| rng.random_range(-1.0..1.0));
            let (a, b, c): (DMatrix<f64>, DMatrix<f64>, DMatrix<f64>) =
                (matrix(m, m), matrix(n, n), matrix(m, n));
            let (one_m, one_n) = (DMatrix::<f64>::identity(m, m), DMatrix::<f64>::identity(n, n));
            let rhs = -nalgebra::DVector::from_column_slice(c.as_slice());
            let systems = [
                (continuous(&a, &b, &c), one_n.kronecker(&a) + b.transpose().kronecker(&one_m)),
                (discrete(&a, &b, &c), b.transpose().kronecker(&a) - DMatrix::identity(m * n, m * n)),
            ];
            for (solution, system) in systems {
                let solution = solution.expect("random equations are regular");
                let svd = system.clone().svd(false, false).singular_values;
                let (largest, smallest) = (svd.max(), svd.min());
                let expected = system.lu().solve(&rhs).expect("regular");
                let found = nalgebra::DVector::from_column_slice(solution.x.as_slice());
                let bound = 1e-14 * largest / smallest * expected.norm();
                assert!((found - &expected).norm() < bound, "seed {seed} trial {trial}");
                assert!(solution.residual_relative < 1e-15, "seed {seed} trial {trial}");
                // Judged against all singular values of the Kronecker system, up to what balancing changes.
                let ratio = solution.separation / smallest;
                assert!((0.1..10.0).contains(&ratio), "seed {seed} trial {trial}: {ratio}");
            }
        }
    }

    #[test]
    fn law_the_transposed_equation_has_the_transposed_solution() {
        let seed = 7;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        for n in [1, 2, 5, 20, 45] {
            let mut matrix = |rows, cols| DMatrix::from_fn(rows, cols, |_, _| rng.random_range(-1.0..1.0));
            let shift = DMatrix::<f64>::identity(n, n) * (n as f64).sqrt();
            let (a, b, c) = (matrix(n, n) + &shift, matrix(n + 3, n + 3), matrix(n, n + 3));
            let x = continuous(&a, &b, &c).expect("regular");
            let y = continuous(&b.transpose(), &a.transpose(), &c.transpose()).expect("regular");
            let bound = 1e-15 * x.condition.min(1e10) * x.x.norm();
            assert!((&x.x - y.x.transpose()).norm() < bound, "seed {seed} n {n}");
        }
    }

    #[test]
    fn law_the_adjoint_substitution_solves_the_adjoint_equation() {
        let seed = 8;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        let mut matrix = |n| DMatrix::from_fn(n, n, |_, _| rng.random_range(-1.0..1.0));
        let t = RealSchur::new(&matrix(9)).expect("schur").t;
        let s = RealSchur::new(&matrix(6)).expect("schur").t;
        let f = matrix(9).columns(0, 6).into_owned();
        for kind in [Kind::Continuous, Kind::Discrete] {
            let y = triangular_equation::solve_adjoint(&t, &s, &f, kind, Symmetry::General).expect("regular");
            let left = match kind {
                Kind::Continuous => t.tr_mul(&y) + &y * &s,
                Kind::Discrete => t.tr_mul(&y) * &s - &y,
            };
            assert!((left - &f).norm() < 1e-11 * (1.0 + y.norm()), "seed {seed}");
        }
    }

    #[test]
    fn edge_empty_singular_and_misshapen_equations() {
        let empty = DMatrix::zeros(0, 0);
        assert_eq!(continuous(&empty, &empty, &empty).expect("empty").x.len(), 0);
        let one = DMatrix::identity(2, 2);
        let singular = continuous(&one, &-&one, &one);
        assert!(matches!(singular, Err(Error::SylvesterSingular { relation: "sum to zero", .. })));
        assert!(matches!(discrete(&one, &one, &one), Err(Error::SylvesterSingular { .. })));
        let wide = DMatrix::zeros(2, 3);
        assert!(matches!(continuous(&one, &one, &wide), Err(Error::Shape { matrix: "c", .. })));
        let nan = DMatrix::from_element(2, 2, f64::NAN);
        assert!(matches!(continuous(&one, &nan, &one), Err(Error::NotFinite { .. })));
    }
}
