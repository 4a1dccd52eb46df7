//! Singular value decomposition by one-sided Jacobi rotations.

use nalgebra::DMatrix;

use crate::Error;

/// `M = U diag(values) Vᵀ` with the values in descending order.
pub(super) struct Svd {
    /// Orthonormal columns where the value is not zero, else zero columns.
    pub(super) u: DMatrix<f64>,
    pub(super) values: Vec<f64>,
    pub(super) v: DMatrix<f64>,
}

/// The decomposition of a square matrix of finite numbers.
///
/// **Method**: rotations of pairs of columns until all are orthogonal, on the triangular factor of a QR decomposition whose columns are
/// taken in descending size. Products of Gramian factors are graded by rows and columns, and this method finds
/// the small values of such matrices to relative accuracy, which methods that first bidiagonalise do not.
///
/// **Source**: Demmel and Veselić 1992, "Jacobi's method is more accurate than QR", SIAM J. Matrix Anal. Appl. 13(4); Drmač and
/// Veselić 2008 for the QR step.
///
/// **Errors**: [`Error::NotFinite`]; [`Error::EigenvaluesNotConverged`] after 60 sweeps, of which ten are usual.
pub(super) fn jacobi_svd(m: &DMatrix<f64>) -> Result<Svd, Error> {
    if let Some((index, &value)) = m.iter().enumerate().find(|(_, v)| !v.is_finite()) {
        return Err(Error::NotFinite { quantity: "matrix to decompose", index, value });
    }
    let n = m.nrows();
    let size = m.amax();
    if n == 0 || size == 0.0 {
        return Ok(Svd { u: DMatrix::zeros(n, n), values: vec![0.0; n], v: DMatrix::identity(n, n) });
    }
    // M Π = Q R, and Rᵀ = W S Zᵀ gives M = (Q Z) S (Π W)ᵀ; the columns of Rᵀ are nearly orthogonal already.
    let qr = (m / size).col_piv_qr();
    let mut w = qr.r().transpose();
    let mut z = DMatrix::<f64>::identity(n, n);
    let mut settled = false;
    for _ in 0..SWEEPS_MAX {
        settled = true;
        for p in 0..n {
            for q in (p + 1)..n {
                settled &= !rotate(&mut w, &mut z, p, q);
            }
        }
        if settled {
            break;
        }
    }
    if !settled {
        return Err(Error::EigenvaluesNotConverged { n, iterations: SWEEPS_MAX });
    }
    let norms: Vec<f64> = w.column_iter().map(|c| c.norm()).collect();
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&p, &q| norms[q].total_cmp(&norms[p]));
    let left = qr.q() * z;
    let (mut u, mut v) = (DMatrix::zeros(n, n), DMatrix::zeros(n, n));
    for (k, &source) in order.iter().enumerate() {
        if norms[source] > 0.0 {
            u.set_column(k, &left.column(source));
            v.set_column(k, &(w.column(source) / norms[source]));
        }
    }
    qr.p().inv_permute_rows(&mut v);
    Ok(Svd { u, values: order.iter().map(|&k| norms[k] * size).collect(), v })
}

/// Makes two columns orthogonal unless they are so to rounding; returns whether it did.
fn rotate(w: &mut DMatrix<f64>, z: &mut DMatrix<f64>, p: usize, q: usize) -> bool {
    let (alpha, beta) = (w.column(p).norm_squared(), w.column(q).norm_squared());
    let gamma = w.column(p).dot(&w.column(q));
    let limit = f64::EPSILON * (alpha.sqrt() * beta.sqrt());
    if gamma.abs() <= limit.max(f64::MIN_POSITIVE) {
        return false;
    }
    let zeta = (beta - alpha) / (2.0 * gamma);
    let t = if zeta.abs() > LARGE { 0.5 / zeta } else { zeta.signum() / (zeta.abs() + zeta.hypot(1.0)) };
    let cos = 1.0 / t.hypot(1.0);
    let sin = cos * t;
    for m in [w, z] {
        let n = m.nrows();
        let (left, right) = m.as_mut_slice().split_at_mut(q * n);
        for (x, y) in left[p * n..(p + 1) * n].iter_mut().zip(&mut right[..n]) {
            (*x, *y) = (cos * *x - sin * *y, sin * *x + cos * *y);
        }
    }
    // Rotations by less than the last bit would go on for ever.
    t.abs() > 0.25 * f64::EPSILON
}

const SWEEPS_MAX: usize = 60;
/// Beyond this the square of the number is all that counts.
const LARGE: f64 = 1e10;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reduce::testing;

    #[test]
    fn law_factors_are_orthogonal_and_give_the_matrix_back() {
        for seed in 0..40 {
            let n = 1 + seed as usize % 9;
            let m = testing::continuous(seed, n, n, n).a().clone();
            let svd = jacobi_svd(&m).expect("finite");
            let middle = DMatrix::from_fn(n, n, |i, j| if i == j { svd.values[i] } else { 0.0 });
            assert!((&svd.u * middle * svd.v.transpose() - &m).norm() < 1e-13 * m.norm(), "seed {seed}");
            assert!((svd.u.tr_mul(&svd.u) - DMatrix::identity(n, n)).norm() < 1e-13, "seed {seed}");
            assert!((svd.v.tr_mul(&svd.v) - DMatrix::identity(n, n)).norm() < 1e-13, "seed {seed}");
        }
    }

    #[test]
    fn law_small_values_of_a_graded_matrix_are_relatively_accurate() {
        // D1 K D2 with well-conditioned K; values by the characteristic polynomial of a triangular, exactly known case.
        let m = nalgebra::dmatrix![1.0, 1e-8; 0.0, 1e-20];
        let values = jacobi_svd(&m).expect("finite").values;
        // Product of the values is the determinant, and the larger one is 1 to rounding.
        assert!((values[0] - 1.0).abs() < 1e-15 && (values[1] / 1e-20 - 1.0).abs() < 1e-14, "{values:?}");
    }

    #[test]
    fn edge_rank_one_zero_and_no_number() {
        let m = nalgebra::dmatrix![2.0, 4.0, -6.0; 1.0, 2.0, -3.0; 0.5, 1.0, -1.5];
        let svd = jacobi_svd(&m).expect("finite");
        assert!((svd.values[0] - m.norm()).abs() < 1e-14 && svd.values[1] < 1e-15);
        assert!((svd.u.column(0) * svd.v.column(0).transpose() * svd.values[0] - &m).norm() < 1e-14);
        assert_eq!(jacobi_svd(&DMatrix::zeros(3, 3)).expect("finite").values, [0.0; 3]);
        assert!(matches!(jacobi_svd(&DMatrix::from_element(2, 2, f64::NAN)), Err(Error::NotFinite { .. })));
    }
}
