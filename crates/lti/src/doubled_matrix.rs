//! Matrices in doubled precision: products and sums for residuals that would otherwise be rounding only.

use nalgebra::DMatrix;

use crate::compensated::{two_product, two_sum};
use crate::vectorized::{self, Kernel};

/// An unevaluated sum `high + low` of two matrices, `low` below the last bit of `high`.
#[derive(Clone, Debug)]
pub struct DoubledMatrix {
    pub(crate) high: DMatrix<f64>,
    pub(crate) low: DMatrix<f64>,
}

impl From<&DMatrix<f64>> for DoubledMatrix {
    fn from(m: &DMatrix<f64>) -> Self {
        Self { high: m.clone(), low: DMatrix::zeros(m.nrows(), m.ncols()) }
    }
}

impl DoubledMatrix {
    /// Rows and columns.
    #[must_use]
    pub fn shape(&self) -> (usize, usize) {
        self.high.shape()
    }

    /// `self * other`.
    #[must_use]
    pub fn times(&self, other: &Self) -> Self {
        let (rows, inner) = self.high.shape();
        let cols = other.high.ncols();
        let mut product = Self { high: DMatrix::zeros(rows, cols), low: DMatrix::zeros(rows, cols) };
        if rows * inner * cols > 0 {
            vectorized::run(Product { left: self, right: other, product: &mut product });
        }
        product
    }

    /// `self + other`.
    #[must_use]
    pub fn plus(mut self, other: &Self) -> Self {
        let parts = self.high.iter_mut().zip(self.low.iter_mut());
        for ((high, low), (h, l)) in parts.zip(other.high.iter().zip(other.low.iter())) {
            let (sum, error) = two_sum(*high, *h);
            (*high, *low) = two_sum(sum, error + *low + *l);
        }
        self
    }

    /// `self - other`.
    #[must_use]
    pub fn minus(self, other: &Self) -> Self {
        self.plus(&Self { high: -&other.high, low: -&other.low })
    }

    /// `selfᵀ`.
    #[must_use]
    pub fn transpose(&self) -> Self {
        Self { high: self.high.transpose(), low: self.low.transpose() }
    }

    /// `self + selfᵀ`.
    #[must_use]
    pub fn plus_transpose(self) -> Self {
        let transpose = self.transpose();
        self.plus(&transpose)
    }

    /// Rounded to working precision.
    #[must_use]
    pub fn rounded(&self) -> DMatrix<f64> {
        &self.high + &self.low
    }
}

struct Product<'a> {
    left: &'a DoubledMatrix,
    right: &'a DoubledMatrix,
    product: &'a mut DoubledMatrix,
}

impl Kernel for Product<'_> {
    type Output = ();

    /// **Source**: Ogita, Rump and Oishi 2005, algorithm `Dot2`, one column of the product at a time.
    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let (rows, inner) = self.left.high.shape();
        let highs = self.product.high.as_mut_slice().chunks_exact_mut(rows);
        let lows = self.product.low.as_mut_slice().chunks_exact_mut(rows);
        let (b_high, b_low) = (self.right.high.as_slice(), self.right.low.as_slice());
        for (j, (high, low)) in highs.zip(lows).enumerate() {
            for k in 0..inner {
                let (b, b_rest) = (b_high[j * inner + k], b_low[j * inner + k]);
                let a = &self.left.high.as_slice()[k * rows..(k + 1) * rows];
                let a_rest = &self.left.low.as_slice()[k * rows..(k + 1) * rows];
                for (((high, low), a), a_rest) in high.iter_mut().zip(&mut *low).zip(a).zip(a_rest) {
                    let (product, error) = if FUSED {
                        let product = a * b;
                        (product, a.mul_add(b, -product))
                    } else {
                        two_product(*a, b)
                    };
                    let (sum, rest) = two_sum(*high, product);
                    *high = sum;
                    *low += rest + (error + (a * b_rest + a_rest * b));
                }
            }
            for (high, low) in high.iter_mut().zip(low) {
                (*high, *low) = two_sum(*high, *low);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_a_product_that_cancels_keeps_its_last_bits() {
        // (1 + e)(1 - e) - 1 = -e² with e = 2^-40, far below the rounding of the product.
        let e = (-40.0_f64).exp2();
        let left = nalgebra::dmatrix![1.0 + e, 1.0];
        let right = nalgebra::dmatrix![1.0 - e; -1.0];
        let product = DoubledMatrix::from(&left).times(&(&right).into()).rounded();
        assert_eq!(product[(0, 0)], -e * e);
        // A factor that itself carries a low part: ((1 + e²) - 1) * 2^80 = 1.
        let small = DoubledMatrix::from(&nalgebra::dmatrix![e]);
        let one = DoubledMatrix::from(&nalgebra::dmatrix![1.0]);
        let sum = small.times(&small).plus(&one);
        let large = DoubledMatrix::from(&nalgebra::dmatrix![80.0_f64.exp2()]);
        assert_eq!(sum.times(&large).minus(&large).rounded()[(0, 0)], 1.0);
    }
}
