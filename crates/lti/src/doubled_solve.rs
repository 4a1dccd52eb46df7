//! Matrices in doubled precision: parts, scaling, and linear systems solved to nearly all of their digits.

use nalgebra::DMatrix;

use crate::compensated::two_product;
use crate::doubled_matrix::DoubledMatrix;

impl DoubledMatrix {
    /// All zeros.
    #[must_use]
    pub fn zeros(n_rows: usize, n_cols: usize) -> Self {
        Self::from(&DMatrix::zeros(n_rows, n_cols))
    }

    /// The block of the given shape whose first entry is `start`, both as (row, column).
    #[must_use]
    pub fn block(&self, start: (usize, usize), shape: (usize, usize)) -> Self {
        Self {
            high: self.high.view(start, shape).into_owned(),
            low: self.low.view(start, shape).into_owned(),
        }
    }

    /// Writes `part` so that its first entry lies at `start`.
    pub fn set_block(&mut self, start: (usize, usize), part: &Self) {
        self.high.view_mut(start, part.high.shape()).copy_from(&part.high);
        self.low.view_mut(start, part.low.shape()).copy_from(&part.low);
    }

    /// `factor · self`.
    #[must_use]
    pub fn scale(mut self, factor: f64) -> Self {
        for (high, low) in self.high.iter_mut().zip(self.low.iter_mut()) {
            let (product, error) = two_product(*high, factor);
            *low = error + *low * factor;
            *high = product;
        }
        self
    }

    /// `-self`.
    #[must_use]
    pub fn negated(&self) -> Self {
        Self { high: -&self.high, low: -&self.low }
    }

    /// Solves `self · X = right` for a square matrix.
    ///
    /// **Method**: LU factors in working precision, the solution corrected by residuals in doubled precision until that no
    /// longer helps. Converges while the condition number is below about `1e15`.
    ///
    /// **Errors**: `None` where the matrix is singular to working precision or the corrections do not shrink.
    #[must_use]
    pub fn solve(&self, right: &Self) -> Option<Self> {
        let lu = self.rounded().full_piv_lu();
        let mut x = Self::zeros(self.high.ncols(), right.high.ncols());
        if x.high.is_empty() {
            return Some(x);
        }
        let mut last = f64::INFINITY;
        for _ in 0..CORRECTIONS_MAX {
            let residual = right.clone().minus(&self.times(&x));
            let correction = lu.solve(&residual.rounded())?;
            let step = correction.norm();
            let size = step / x.high.norm().max(step).max(f64::MIN_POSITIVE);
            if !size.is_finite() {
                return None;
            }
            if size >= 0.5 * last {
                return (last < SETTLED).then_some(x);
            }
            x = x.plus(&Self::from(&correction));
            if size <= FULL {
                return Some(x);
            }
            last = size;
        }
        (last < SETTLED).then_some(x)
    }
}

/// Corrections at most; each gains as many digits as the condition leaves.
const CORRECTIONS_MAX: usize = 30;
/// Relative corrections as small as this leave nothing to gain.
const FULL: f64 = 1e-30;
/// Relative corrections above this mean that nothing has been gained on working precision.
const SETTLED: f64 = 1e-14;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_a_hilbert_system_is_solved_beyond_working_precision() {
        // Rows 1/(i + j + 1) times their common multiple are whole numbers; the condition is 1e13 for n = 10.
        let n = 9;
        let multiple = 12_252_240.0;
        let hilbert = DMatrix::from_fn(n, n, |i, j| multiple / (i + j + 1) as f64);
        let x = DMatrix::from_fn(n, 1, |i, _| 1.0 + i as f64);
        let right = DoubledMatrix::from(&hilbert).times(&DoubledMatrix::from(&x));
        let found = DoubledMatrix::from(&hilbert).solve(&right).expect("regular");
        let error = found.minus(&DoubledMatrix::from(&x)).rounded().norm() / x.norm();
        assert!(error < 1e-17, "{error}");
    }

    #[test]
    fn edge_singular_and_empty_systems() {
        let singular = DoubledMatrix::from(&nalgebra::dmatrix![1.0, 2.0; 2.0, 4.0]);
        assert!(singular.solve(&DoubledMatrix::from(&nalgebra::dmatrix![1.0; 0.0])).is_none());
        assert!(DoubledMatrix::zeros(0, 0).solve(&DoubledMatrix::zeros(0, 3)).is_some());
    }
}
