//! Continuous and discrete Lyapunov equations by the method of Bartels and Stewart.

use nalgebra::{DMatrix, Matrix4, Vector4};

use crate::Error;
use crate::schur::RealSchur;

/// The solution of a Lyapunov equation and the evidence for it.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// The symmetric solution `X`, `n × n`.
    pub x: DMatrix<f64>,
    /// Frobenius norm of the equation's left-hand side over the sum of the norms of its terms.
    pub residual_relative: f64,
}

/// Returns the `X` that solves `A X + X Aᵀ + Q = 0`.
///
/// **Shapes and units**: `a`, `q`: `n × n`, `q` symmetric. With `Q = B Bᵀ`, `X` is the controllability Gramian.
///
/// **Method**: real Schur form of `A`, then back substitution by columns and rows of blocks.
///
/// **Source**: Bartels and Stewart 1972.
///
/// **Errors**: [`Error::LyapunovSingular`] where two eigenvalues of `A` sum to zero; [`Error::NotSymmetric`],
/// [`Error::Shape`], [`Error::NotFinite`].
///
/// **Example**
/// ```
/// use nalgebra::dmatrix;
/// let s = telepulse_lti::lyapunov::continuous(&dmatrix![-2.0], &dmatrix![1.0])?;
/// assert!((s.x[(0, 0)] - 0.25).abs() < 1e-15);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn continuous(a: &DMatrix<f64>, q: &DMatrix<f64>) -> Result<Solution, Error> {
    check(a, q)?;
    let schur = RealSchur::new(a)?;
    let x = back_substitute(&schur, q, Kind::Continuous)?;
    let product = a * &x;
    let residual = (&product + product.transpose() + q).norm();
    let scale = 2.0 * product.norm() + q.norm();
    Ok(Solution { x, residual_relative: relative(residual, scale) })
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
/// [`Error::Shape`], [`Error::NotFinite`].
pub fn discrete(a: &DMatrix<f64>, q: &DMatrix<f64>) -> Result<Solution, Error> {
    check(a, q)?;
    let schur = RealSchur::new(a)?;
    let x = back_substitute(&schur, q, Kind::Discrete)?;
    let product = a * &x * a.transpose();
    let residual = (&product - &x + q).norm();
    let scale = product.norm() + x.norm() + q.norm();
    Ok(Solution { x, residual_relative: relative(residual, scale) })
}

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Continuous,
    Discrete,
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

/// Solves the equation in Schur coordinates, block column by block column from the right.
fn back_substitute(schur: &RealSchur, q: &DMatrix<f64>, kind: Kind) -> Result<DMatrix<f64>, Error> {
    let (u, t) = (&schur.q, &schur.t);
    let n = t.nrows();
    let f = u.transpose() * q * u;
    let mut y = DMatrix::zeros(n, n);
    let blocks = schur.blocks();
    let largest = t.amax().max(if kind == Kind::Discrete { 1.0 } else { 0.0 });
    for &(j, nj) in blocks.iter().rev() {
        // What the columns already known contribute: Σ_{l>j} Y_l T_jlᵀ.
        let right = n - j - nj;
        let known = y.columns(j + nj, right) * t.view((j, j + nj), (nj, right)).transpose();
        let mut rhs = match kind {
            Kind::Continuous => -(f.columns(j, nj) + &known),
            Kind::Discrete => -(f.columns(j, nj) + t * &known),
        };
        let tjj = t.view((j, j), (nj, nj)).into_owned();
        for &(i, ni) in blocks.iter().rev() {
            // What the rows already known in this column contribute: Σ_{k>i} T_ik Y_kj (times T_jjᵀ if discrete).
            let below = n - i - ni;
            let mut sum = t.view((i, i + ni), (ni, below)) * y.view((i + ni, j), (below, nj));
            if kind == Kind::Discrete {
                sum *= tjj.transpose();
            }
            let mut part = rhs.rows_mut(i, ni);
            part -= sum;
            let tii = t.view((i, i), (ni, ni)).into_owned();
            let block = solve_block(&tii, &tjj, &part.into_owned(), kind, largest)?;
            y.view_mut((i, j), (ni, nj)).copy_from(&block);
        }
    }
    let x = u * y * u.transpose();
    Ok((&x + x.transpose()) * 0.5)
}

/// Solves `L Y + Y Rᵀ = F`, or `L Y Rᵀ - Y = F`, for blocks of at most 2×2.
fn solve_block(
    left: &DMatrix<f64>,
    right: &DMatrix<f64>,
    f: &DMatrix<f64>,
    kind: Kind,
    largest: f64,
) -> Result<DMatrix<f64>, Error> {
    let (ni, nj) = f.shape();
    let index = |i: usize, j: usize| i + ni * j;
    // Rows beyond ni * nj stay an identity scaled to be above the threshold.
    let mut system = Matrix4::identity() * largest.max(f64::MIN_POSITIVE);
    let mut rhs = Vector4::zeros();
    for j in 0..nj {
        for i in 0..ni {
            let row = index(i, j);
            rhs[row] = f[(i, j)];
            system[(row, row)] = if kind == Kind::Discrete { -1.0 } else { 0.0 };
        }
    }
    for j in 0..nj {
        for i in 0..ni {
            let row = index(i, j);
            match kind {
                Kind::Continuous => {
                    (0..ni).for_each(|k| system[(row, index(k, j))] += left[(i, k)]);
                    (0..nj).for_each(|k| system[(row, index(i, k))] += right[(j, k)]);
                }
                Kind::Discrete => {
                    for k in 0..ni {
                        for l in 0..nj {
                            system[(row, index(k, l))] += left[(i, k)] * right[(j, l)];
                        }
                    }
                }
            }
        }
    }
    let threshold = f64::EPSILON * largest;
    let lu = system.full_piv_lu();
    let pivot = lu.u().diagonal().iter().fold(f64::INFINITY, |m, v| m.min(v.abs()));
    let relation = match kind {
        Kind::Continuous => "sum to zero",
        Kind::Discrete => "multiply to one",
    };
    let singular = Error::LyapunovSingular { relation, pivot, threshold };
    if pivot <= threshold {
        return Err(singular);
    }
    let solution = lu.solve(&rhs).ok_or(singular)?;
    Ok(DMatrix::from_fn(ni, nj, |i, j| solution[index(i, j)]))
}

/// Relative asymmetry that counts as rounding of the caller's products.
const SYMMETRY_TOLERANCE: f64 = 1e-8;

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
