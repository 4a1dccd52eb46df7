//! Factors of Gramians, found without forming the Gramian: small Hankel singular values keep their digits.

use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;

use crate::schur::RealSchur;
use crate::{Error, StateSpace, TimeDomain};

/// A factor `S` with `P = S Sᵀ` the controllability Gramian of a stable system.
///
/// **Shapes and units**: `S: n_x × n_x`, lower triangular up to signs of columns.
///
/// **Method**: complex Schur form of `A`, then one column of the factor after the other from the last; the real factor is
/// the triangular part of a QR decomposition of `[Re, Im]`. Only unitary operations touch the factor, so
/// its relative error is a few roundings even where `P` itself would be singular to working precision.
///
/// **Source**: Hammarling 1982, "Numerical solution of the stable, non-negative definite Lyapunov equation",
/// IMA J. Numer. Anal. 2, 303-323, in the form that keeps the right-hand side as a full matrix.
///
/// **Errors**: [`Error::Unstable`], [`Error::EigenvaluesNotConverged`].
///
/// **Example**: `1/(s + 2)` has the Gramian 1/4.
/// ```
/// use telepulse_lti::{TransferFunction, reduce::controllability_factor};
/// let sys = TransferFunction::new(&[1.0], &[1.0, 2.0])?.to_state_space();
/// assert!((controllability_factor(&sys)?[(0, 0)].abs() - 0.5).abs() < 1e-15);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn controllability_factor<D: TimeDomain>(sys: &StateSpace<D>) -> Result<DMatrix<f64>, Error> {
    factor(&ComplexSchur::new(sys.a())?, sys.b(), sys.domain())
}

/// A factor `R` with `Q = R Rᵀ` the observability Gramian of a stable system.
///
/// **Method**, **Errors**: as [`controllability_factor`], for the transposed system.
pub fn observability_factor<D: TimeDomain>(sys: &StateSpace<D>) -> Result<DMatrix<f64>, Error> {
    factor(&ComplexSchur::new(&sys.a().transpose())?, &sys.c().transpose(), sys.domain())
}

fn factor<D: TimeDomain>(schur: &ComplexSchur, b: &DMatrix<f64>, domain: &D) -> Result<DMatrix<f64>, Error> {
    let n = b.nrows();
    if let Some(pole) = schur.t.diagonal().iter().find(|&&p| !domain.is_stable_pole(p)) {
        return Err(Error::Unstable { pole: *pole });
    }
    let discrete = domain.sample_time_of().is_some();
    let mut rhs = schur.q.adjoint() * b.map(|v| Complex64::new(v, 0.0));
    let mut u = DMatrix::<Complex64>::zeros(n, n);
    for k in (0..n).rev() {
        let pole = schur.t[(k, k)];
        let row = rhs.row(k).adjoint();
        let size = row.norm();
        if size == 0.0 {
            // The mode is not driven: its row and column of the Gramian are zero.
            continue;
        }
        let decay = if discrete { (1.0 - pole.norm()) * (1.0 + pole.norm()) } else { -2.0 * pole.re };
        let tau = size / decay.sqrt();
        let direction = row * Complex64::from(decay.sqrt() / size);
        u[(k, k)] = Complex64::from(tau);
        let upper = rhs.rows(0, k).into_owned();
        let coupling = schur.t.view((0, k), (k, 1)).column(0) * Complex64::from(tau);
        let driven = &upper * &direction;
        if discrete {
            // (conj(pole) T1 - I) u = -(conj(pole) t tau + B1 y).
            let right = -(&coupling * pole.conj() + &driven);
            let column = solve_shifted(&schur.t, k, pole.conj(), -Complex64::ONE, right)?;
            let carried = schur.t.view((0, 0), (k, k)) * &column + coupling;
            let mut extended = DMatrix::zeros(k, upper.ncols() + 1);
            extended.columns_mut(0, upper.ncols()).copy_from(&upper);
            extended.set_column(upper.ncols(), &carried);
            let mut unit = direction.resize_vertically(upper.ncols() + 1, Complex64::ZERO);
            unit[upper.ncols()] = pole.conj();
            rhs.rows_mut(0, k).copy_from(&complement_product(extended, unit));
            u.view_mut((0, k), (k, 1)).copy_from(&column);
        } else {
            // (T1 + conj(pole) I) u = -(t tau + B1 y), then B1 <- B1 - u yᴴ.
            let right = -(coupling + driven);
            let column = solve_shifted(&schur.t, k, Complex64::ONE, pole.conj(), right)?;
            rhs.rows_mut(0, k).copy_from(&(upper - &column * direction.adjoint()));
            u.view_mut((0, k), (k, 1)).copy_from(&column);
        }
    }
    let factor = &schur.q * u;
    // P = F Fᴴ is real, so P = [Re F, Im F] [Re F, Im F]ᵀ; QR halves the number of columns.
    let mut tall = DMatrix::zeros(2 * n, n);
    for i in 0..n {
        for j in 0..n {
            tall[(j, i)] = factor[(i, j)].re;
            tall[(n + j, i)] = factor[(i, j)].im;
        }
    }
    let compressed = tall.qr().r().transpose();
    match compressed.iter().enumerate().find(|(_, v)| !v.is_finite()) {
        Some((index, &value)) => Err(Error::NotFinite { quantity: "gramian factor", index, value }),
        None => Ok(compressed),
    }
}

/// Solves `(scale T + shift I) x = right` for the leading `k × k` triangle of `T`.
fn solve_shifted(
    t: &DMatrix<Complex64>,
    k: usize,
    scale: Complex64,
    shift: Complex64,
    mut right: DVector<Complex64>,
) -> Result<DVector<Complex64>, Error> {
    for i in (0..k).rev() {
        let pivot = scale * t[(i, i)] + shift;
        if pivot == Complex64::ZERO {
            let relation = "stable matrix reach the boundary";
            return Err(Error::LyapunovSingular { relation, pivot: 0.0, threshold: 0.0 });
        }
        let x = right[i] / pivot;
        right[i] = x;
        for row in 0..i {
            right[row] -= scale * t[(row, i)] * x;
        }
    }
    Ok(right)
}

/// `M N`, where the orthonormal columns of `N` span what is orthogonal to `unit`: a Householder reflection without its
/// last column.
fn complement_product(m: DMatrix<Complex64>, unit: DVector<Complex64>) -> DMatrix<Complex64> {
    let last = unit.len() - 1;
    let end = unit[last];
    let phase = if end == Complex64::ZERO { Complex64::ONE } else { end / end.norm() };
    let mut v = unit;
    v[last] += phase;
    let square = v.norm_squared();
    let reflected = &m - (&m * &v) * v.adjoint() * Complex64::from(2.0 / square);
    reflected.columns(0, last).into_owned()
}

/// `A = Q T Qᴴ` with unitary `Q` and upper triangular `T`.
struct ComplexSchur {
    q: DMatrix<Complex64>,
    t: DMatrix<Complex64>,
}

impl ComplexSchur {
    /// Splits the 2×2 blocks of the real form, each with one unitary rotation.
    fn new(a: &DMatrix<f64>) -> Result<Self, Error> {
        let real = RealSchur::new(a)?;
        let complex = |m: &DMatrix<f64>| m.map(|v| Complex64::new(v, 0.0));
        let (mut q, mut t) = (complex(&real.q), complex(&real.t));
        let n = a.nrows();
        for (k, size) in real.blocks() {
            if size == 1 {
                continue;
            }
            let (upper, lower) = (real.t[(k, k + 1)], real.t[(k + 1, k)]);
            let im = (upper.abs().sqrt()) * (lower.abs().sqrt());
            // Eigenvector (upper, i im) of [[a, upper], [lower, a]], scaled by its larger entry first.
            let large = upper.abs().max(im);
            let (p, r) = (Complex64::new(upper / large, 0.0), Complex64::new(0.0, im / large));
            let norm = p.norm().hypot(r.norm());
            let (p, r) = (p / norm, r / norm);
            for matrix in [&mut t, &mut q] {
                for row in 0..n {
                    let (x, y) = (matrix[(row, k)], matrix[(row, k + 1)]);
                    matrix[(row, k)] = x * p + y * r;
                    matrix[(row, k + 1)] = y * p.conj() - x * r.conj();
                }
            }
            for col in 0..n {
                let (x, y) = (t[(k, col)], t[(k + 1, col)]);
                t[(k, col)] = p.conj() * x + r.conj() * y;
                t[(k + 1, col)] = p * y - r * x;
            }
            let re = real.t[(k, k)];
            t[(k, k)] = Complex64::new(re, im);
            t[(k + 1, k + 1)] = Complex64::new(re, -im);
            t[(k + 1, k)] = Complex64::ZERO;
        }
        Ok(Self { q, t })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reduce::testing;
    use crate::{Continuous, lyapunov};
    use nalgebra::dmatrix;

    #[test]
    fn law_factors_solve_both_lyapunov_equations() {
        for seed in 0..60 {
            let n = 1 + seed as usize % 11;
            let (continuous, discrete) =
                (testing::continuous(seed, n, 2, 3), testing::discrete(seed, n, 2, 3));
            let pairs = [
                (
                    controllability_factor(&continuous),
                    lyapunov::continuous(continuous.a(), &(continuous.b() * continuous.b().transpose())),
                ),
                (
                    controllability_factor(&discrete),
                    lyapunov::discrete(discrete.a(), &(discrete.b() * discrete.b().transpose())),
                ),
                (
                    observability_factor(&continuous),
                    lyapunov::continuous(&continuous.a().transpose(), &continuous.c().tr_mul(continuous.c())),
                ),
                (
                    observability_factor(&discrete),
                    lyapunov::discrete(&discrete.a().transpose(), &discrete.c().tr_mul(discrete.c())),
                ),
            ];
            for (factor, gramian) in pairs {
                let (factor, gramian) = (factor.expect("stable"), gramian.expect("stable").x);
                let off = (&factor * factor.transpose() - &gramian).norm() / gramian.norm();
                assert!(off < 1e-11, "seed {seed}: {off:e}");
            }
        }
    }

    #[test]
    fn edge_modes_without_drive_and_no_modes() {
        let sys = StateSpace::<Continuous>::new(
            dmatrix![-1.0, 0.0; 0.0, -2.0],
            dmatrix![1.0; 0.0],
            dmatrix![1.0, 1.0],
            dmatrix![0.0],
        );
        let factor = controllability_factor(&sys.expect("shapes")).expect("stable");
        let gramian = &factor * factor.transpose();
        assert!((gramian - dmatrix![0.5, 0.0; 0.0, 0.0]).norm() < 1e-15);
        let gain = StateSpace::<Continuous>::from_gain(dmatrix![2.0]).expect("one port");
        assert_eq!(controllability_factor(&gain).expect("empty").shape(), (0, 0));
        let unstable =
            StateSpace::<Continuous>::new(dmatrix![1.0], dmatrix![1.0], dmatrix![1.0], dmatrix![0.0]);
        assert!(matches!(observability_factor(&unstable.expect("shapes")), Err(Error::Unstable { .. })));
    }
}
