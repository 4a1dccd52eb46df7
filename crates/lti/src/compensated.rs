//! Sums of products in doubled precision, for residuals that would otherwise be rounding only.

use nalgebra::DMatrix;

use crate::doubled_matrix::DoubledMatrix;

/// An unevaluated sum `high + low` with `low` below the last bit of `high`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Doubled {
    pub(crate) high: f64,
    pub(crate) low: f64,
}

impl Doubled {
    /// Adds `a * b`. **Source**: Ogita, Rump and Oishi 2005, algorithm `Dot2`.
    pub(crate) fn add_product(&mut self, a: f64, b: f64) {
        let (product, product_error) = two_product(a, b);
        let (sum, sum_error) = two_sum(self.high, product);
        self.high = sum;
        self.low += sum_error + product_error;
    }

    pub(crate) fn value(self) -> f64 {
        self.high + self.low
    }
}

/// `a + b` and its rounding error. **Source**: Knuth, TAOCP volume 2, section 4.2.2.
#[inline(always)]
pub(crate) fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let shadow = sum - a;
    (sum, (a - (sum - shadow)) + (b - shadow))
}

/// `a * b` and its rounding error. **Source**: Dekker 1971; exact while no product overflows.
#[inline(always)]
pub(crate) fn two_product(a: f64, b: f64) -> (f64, f64) {
    let product = a * b;
    let (a_high, a_low) = split(a);
    let (b_high, b_low) = split(b);
    (product, ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low)
}

/// Two halves of a significand that multiply without rounding.
#[inline(always)]
fn split(a: f64) -> (f64, f64) {
    let shifted = SPLITTER * a;
    let high = shifted - (shifted - a);
    (high, a - high)
}

/// Returns `Aᵀ X + X A - X G X + Q` for symmetric `G`, `Q` and `X`, accumulated in doubled precision and rounded once.
pub(crate) fn riccati_residual(
    a: &DMatrix<f64>,
    g: &DMatrix<f64>,
    q: &DMatrix<f64>,
    x: &DMatrix<f64>,
) -> DMatrix<f64> {
    let (a, g, q, x) =
        (DoubledMatrix::from(a), DoubledMatrix::from(g), DoubledMatrix::from(q), DoubledMatrix::from(x));
    let product = a.transpose().times(&x);
    let cubic = x.times(&g.times(&x));
    let residual = product.plus_transpose().plus(&q).minus(&cubic).rounded();
    (&residual + residual.transpose()) * 0.5
}

/// 2^27 + 1.
const SPLITTER: f64 = 134_217_729.0;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_a_sum_that_cancels_keeps_its_last_bits() {
        // (1 + e)(1 - e) - 1 = -e² with e = 2^-40, far below the rounding of the product.
        let e = (-40.0_f64).exp2();
        let mut sum = Doubled { high: -1.0, low: 0.0 };
        sum.add_product(1.0 + e, 1.0 - e);
        assert_eq!(sum.value(), -e * e);
    }
}
