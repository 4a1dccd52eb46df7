//! Eigenvalues of a real matrix by a bounded QR iteration.

use nalgebra::DMatrix;
use num_complex::Complex64;

use crate::Error;
use crate::balance::balance_matrix;
use crate::francis;
use crate::hessenberg::{check_square_and_finite, reduce};
use crate::isolation::{permute, triangular_order};
use crate::schur::scale_to_unit;

/// The eigenvalues of a square real matrix, conjugate pairs exactly conjugate and next to each other.
///
/// **Method**: a permutation that isolates what is triangular already, diagonal balancing by powers of two, Householder reduction to Hessenberg form, then the implicit
/// double-shift QR iteration with exceptional shifts on the active window alone.
///
/// **Source**: Golub and Van Loan 2013, section 7.5; LAPACK `dgebal`, `dgehrd` and `dlahqr`.
///
/// **Accuracy**: backward stable; a matrix that is triangular in some order of its states gives its diagonal exactly.
///
/// # Errors
/// [`Error::EigenvaluesNotConverged`] when the iteration ran into its bound, [`Error::Shape`] unless `a` is square,
/// [`Error::NotFinite`] where an entry is not finite.
pub fn eigenvalues(a: &DMatrix<f64>) -> Result<Vec<Complex64>, Error> {
    check_square_and_finite("a", a)?;
    let mut h = triangular_order(a).map_or_else(|| a.clone(), |order| permute(a, &order));
    let scale = scale_to_unit(&mut h);
    balance_matrix(&mut h);
    eigenvalues_in_place(&mut h, scale)
}

/// The eigenvalues of a square matrix that was multiplied by `scale`; overwrites it, without balancing.
pub(crate) fn eigenvalues_in_place(h: &mut DMatrix<f64>, scale: f64) -> Result<Vec<Complex64>, Error> {
    reduce(h);
    let mut values = francis::eigenvalues(h)?;
    if scale != 1.0 {
        values.iter_mut().for_each(|v| *v = v.unscale(scale));
    }
    Ok(values)
}

/// The spectrum of a real quasi upper triangular matrix: its diagonal and its 2 x 2 diagonal blocks.
///
/// Entries below the first subdiagonal are not read.
#[must_use]
pub fn quasi_triangular_eigenvalues(t: &DMatrix<f64>) -> Vec<Complex64> {
    let n = t.nrows();
    let mut values = Vec::with_capacity(n);
    let mut k = 0;
    while k < n {
        if k + 1 < n && t[(k + 1, k)] != 0.0 {
            values.extend(block_eigenvalues(t[(k, k)], t[(k, k + 1)], t[(k + 1, k)], t[(k + 1, k + 1)]));
            k += 2;
        } else {
            values.push(Complex64::new(t[(k, k)], 0.0));
            k += 1;
        }
    }
    values
}

/// Eigenvalues of `[[a, b], [c, d]]` without the cancellation of the schoolbook formula.
fn block_eigenvalues(a: f64, b: f64, c: f64, d: f64) -> [Complex64; 2] {
    let half_difference = 0.5 * (a - d);
    let product = b * c;
    let discriminant = half_difference * half_difference + product;
    if discriminant < 0.0 {
        let (re, im) = (d + half_difference, (-discriminant).sqrt());
        return [Complex64::new(re, im), Complex64::new(re, -im)];
    }
    let z = half_difference + discriminant.sqrt().copysign(half_difference);
    let other = if z == 0.0 { d } else { d - product / z };
    [Complex64::new(d + z, 0.0), Complex64::new(other, 0.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regress_a_cyclic_permutation_does_not_stall_the_iteration() {
        // Francis steps without exceptional shifts leave this matrix unchanged.
        for n in [3, 4, 5, 8] {
            let cycle = DMatrix::from_fn(n, n, |i, j| if i == (j + 1) % n { 1.0 } else { 0.0 });
            let values = eigenvalues(&cycle).expect("exceptional shifts");
            for value in values {
                assert!((value.powu(n as u32) - 1.0).norm() < 1e-13, "n {n}: {value}");
            }
        }
    }

    #[test]
    fn law_a_block_keeps_trace_and_determinant() {
        for (a, b, c, d) in
            [(1.0, 2.0, 3.0, 4.0), (1.0, -2.0, 3.0, 1.5), (1.0, 1e-9, 1e-9, 1.0), (2.0, 0.0, 1.0, 2.0)]
        {
            let [p, q] = block_eigenvalues(a, b, c, d);
            assert!((p + q - (a + d)).norm() < 1e-14);
            assert!((p * q - (a * d - b * c)).norm() < 1e-14);
        }
    }

    #[test]
    fn edge_eigenvalues_refuse_a_rectangle_and_a_nan() {
        assert!(matches!(eigenvalues(&DMatrix::zeros(2, 3)), Err(Error::Shape { .. })));
        assert!(matches!(eigenvalues(&DMatrix::from_element(2, 2, f64::NAN)), Err(Error::NotFinite { .. })));
        assert!(eigenvalues(&DMatrix::zeros(0, 0)).expect("empty").is_empty());
    }
}
