//! Diagonal scaling of the states by powers of two, which costs no rounding.

use crate::{StateSpace, TimeDomain};
use nalgebra::{DMatrix, DVector};

/// Scales a square matrix in place to `D^-1 A D` with rows and columns of like norm; returns the diagonal of `D`.
///
/// **Method**: sweeps over the rows with the 2-norm including the diagonal, factors are powers of two.
///
/// **Source**: James, Langou and Lowery 2014, "On matrix balancing and eigenvector computation", algorithm 3. The
/// older criterion without the diagonal can make Hessenberg matrices much worse.
///
/// # Panics
/// Unless `a` is square.
pub fn balance_matrix(a: &mut DMatrix<f64>) -> DVector<f64> {
    assert!(a.is_square(), "balancing is a similarity");
    let n = a.nrows();
    balance_blocks(a, &mut DMatrix::zeros(n, 0), &mut DMatrix::zeros(0, n))
}

impl<D: TimeDomain> StateSpace<D> {
    /// The same input-output behaviour with states scaled by powers of two so that the rows of `[A B]` and the columns
    /// of `[A; C]` have like norms.
    ///
    /// # Example
    /// ```
    /// use telepulse_lti::TransferFunction;
    /// let sys = TransferFunction::new(&[1.0], &[1.0, 1e4, 1e8])?.to_state_space();
    /// assert_eq!(sys.balanced().dc_gain()?[(0, 0)], sys.dc_gain()?[(0, 0)]);
    /// # Ok::<(), telepulse_lti::Error>(())
    /// ```
    #[must_use]
    pub fn balanced(&self) -> Self {
        let (mut a, mut b, mut c) = (self.a().clone(), self.b().clone(), self.c().clone());
        balance_blocks(&mut a, &mut b, &mut c);
        Self::from_valid_parts(a, b, c, self.d().clone(), *self.domain())
    }
}

/// Scales `D^-1 A D`, `D^-1 B`, `C D` in place; returns the diagonal of `D`.
fn balance_blocks(a: &mut DMatrix<f64>, b: &mut DMatrix<f64>, c: &mut DMatrix<f64>) -> DVector<f64> {
    let n = a.nrows();
    let mut scale = DVector::from_element(n, 1.0);
    for _ in 0..MAX_SWEEPS {
        let mut settled = true;
        for i in 0..n {
            let column = a.column(i).norm().hypot(c.column(i).norm());
            let row = a.row(i).norm().hypot(b.row(i).norm());
            if column == 0.0 || row == 0.0 || !column.is_finite() || !row.is_finite() {
                continue;
            }
            // The power of two f that makes f * column and row / f equal up to a factor of two.
            let exponent = (0.5 * (row / column).log2()).round().clamp(-MAX_EXPONENT, MAX_EXPONENT);
            let f = exponent.exp2();
            let (scaled, plain) = ((f * column).hypot(row / f), column.hypot(row));
            if exponent != 0.0 && scaled < WORTHWHILE * plain {
                settled = false;
                scale[i] *= f;
                a.column_mut(i).scale_mut(f);
                c.column_mut(i).scale_mut(f);
                a.row_mut(i).unscale_mut(f);
                b.row_mut(i).unscale_mut(f);
            }
        }
        if settled {
            break;
        }
    }
    scale
}

/// Sweeps allowed; balancing may stop at any of them without harm.
const MAX_SWEEPS: usize = 64;
/// Largest single step, well inside the exponent range of `f64`.
const MAX_EXPONENT: f64 = 256.0;
/// A step that gains less than five per cent is not taken (LAPACK's `GEBAL` uses the same figure).
const WORTHWHILE: f64 = 0.95;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_balancing_is_an_exact_similarity() {
        let original = DMatrix::from_row_slice(3, 3, &[1.0, 1e6, 3.0, 1e-6, 2.0, 1e-7, 5.0, 1e8, -4.0]);
        let mut a = original.clone();
        let d = balance_matrix(&mut a);
        for i in 0..3 {
            for j in 0..3 {
                // Powers of two: equality to the last bit.
                assert_eq!(a[(i, j)] * d[i] / d[j], original[(i, j)]);
            }
        }
        assert!(a.norm() < 1e-4 * original.norm());
    }
}
