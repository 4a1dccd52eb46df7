//! Eigenvalues of a real matrix by a bounded QR iteration.

use crate::Error;
use crate::balance::balance_matrix;
use nalgebra::{DMatrix, DVector, Schur};
use num_complex::Complex64;

/// The eigenvalues of a square real matrix, conjugate pairs exactly conjugate and next to each other.
///
/// **Method**: diagonal balancing by powers of two, then the real Schur form. The QR iteration in use has no
/// exceptional shifts and stalls on matrices such as a cyclic permutation; it is then restarted from an orthogonally
/// similar matrix, which has the same eigenvalues and another Hessenberg form.
///
/// # Errors
/// [`Error::EigenvaluesNotConverged`] when every restart ran into the bound, [`Error::Shape`] unless `a` is square,
/// [`Error::NotFinite`] where an entry is not finite.
pub fn eigenvalues(a: &DMatrix<f64>) -> Result<Vec<Complex64>, Error> {
    let n = a.nrows();
    if a.ncols() != n {
        return Err(Error::Shape {
            matrix: "a",
            expected_rows: n,
            expected_cols: n,
            rows: n,
            cols: a.ncols(),
        });
    }
    if let Some((index, &value)) = a.iter().enumerate().find(|(_, v)| !v.is_finite()) {
        return Err(Error::NotFinite { quantity: "a", index, value });
    }
    let mut balanced = a.clone();
    balance_matrix(&mut balanced);
    let iterations = ITERATIONS_PER_ROW * n.max(1);
    for restart in 0..RESTARTS {
        let start = if restart == 0 { balanced.clone() } else { reflected(&balanced, restart) };
        if let Some(schur) = Schur::try_new(start, f64::EPSILON, iterations) {
            let values = quasi_triangular_eigenvalues(&schur.unpack().1);
            if values.iter().all(|v| v.re.is_finite() && v.im.is_finite()) {
                return Ok(values);
            }
        }
    }
    Err(Error::EigenvaluesNotConverged { n, iterations })
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

/// `H A H` with the Householder reflection `H` of a fixed vector without symmetry.
fn reflected(a: &DMatrix<f64>, restart: usize) -> DMatrix<f64> {
    let v = DVector::from_fn(a.nrows(), |i, _| ((i + 1) as f64 * (restart as f64 + GOLDEN_RATIO)).sin());
    let v = v.normalize();
    let left = a - (&v * 2.0) * (v.transpose() * a);
    let shadow = &left * &v;
    left - shadow * (v.transpose() * 2.0)
}

/// Double-shift steps allowed per row; two to four are usual (Golub and Van Loan 2013, section 7.5).
const ITERATIONS_PER_ROW: usize = 60;
/// Starting points tried before the answer is "not converged".
const RESTARTS: usize = 4;
/// An irrational offset: no restart repeats the symmetry of the matrix.
const GOLDEN_RATIO: f64 = 1.618_033_988_749_895;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regress_a_cyclic_permutation_does_not_stall_the_iteration() {
        // Francis steps without exceptional shifts leave this matrix unchanged.
        for n in [3, 4, 5, 8] {
            let cycle = DMatrix::from_fn(n, n, |i, j| if i == (j + 1) % n { 1.0 } else { 0.0 });
            let values = eigenvalues(&cycle).expect("restarted");
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
