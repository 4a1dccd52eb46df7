//! Bounds of a rational function over a whole interval of frequencies, from its poles and zeros.

use num_complex::Complex64;
use telepulse_lti::TransferFunction;

use crate::Result;

/// A rational function by its factors, for bounds of its modulus on pieces of the imaginary axis.
#[derive(Debug, Clone, Default)]
pub(super) struct Factors {
    ln_gain: f64,
    zeros: Vec<Complex64>,
    poles: Vec<Complex64>,
}

/// The logarithmic derivative on a piece of the axis.
struct Slopes {
    /// Its value in the middle.
    at_centre: Complex64,
    /// How far it may be from that on the piece: half-width times a bound of the second derivative.
    change: f64,
    /// Sum of the largest sizes of its terms.
    largest: f64,
}

/// Bounds of a modulus.
#[derive(Debug, Clone, Copy)]
pub(super) struct Range {
    pub(super) low: f64,
    pub(super) high: f64,
}

impl Factors {
    pub(super) fn new(tf: &TransferFunction) -> Result<Self> {
        let gain = (tf.numerator()[0] / tf.denominator()[0]).abs();
        Ok(Self { ln_gain: gain.ln(), zeros: tf.zeros()?, poles: tf.poles()? })
    }

    pub(super) fn multiply(&self, other: &Self) -> Self {
        let join = |a: &[Complex64], b: &[Complex64]| a.iter().chain(b).copied().collect();
        Self {
            ln_gain: self.ln_gain + other.ln_gain,
            zeros: join(&self.zeros, &other.zeros),
            poles: join(&self.poles, &other.poles),
        }
    }

    pub(super) fn inverse(&self) -> Self {
        Self { ln_gain: -self.ln_gain, zeros: self.poles.clone(), poles: self.zeros.clone() }
    }

    /// Largest size of the logarithmic derivative, delay included, on `[a, b]`; infinite where a root lies on the piece.
    pub(super) fn rate(&self, delay_s: f64, a: f64, b: f64) -> f64 {
        let slopes = self.slopes(a, b);
        let by_taylor = (slopes.at_centre - delay_s).norm() + slopes.change;
        smaller(by_taylor, slopes.largest + delay_s)
    }

    /// Largest size of the derivative of the logarithm of the modulus on `[a, b]`.
    pub(super) fn modulus_rate(&self, a: f64, b: f64) -> f64 {
        let slopes = self.slopes(a, b);
        smaller(slopes.at_centre.im.abs() + slopes.change, slopes.largest)
    }

    fn slopes(&self, a: f64, b: f64) -> Slopes {
        let centre = Complex64::new(0.0, 0.5 * (a + b));
        let radius = 0.5 * (b - a);
        let mut slopes = Slopes { at_centre: Complex64::ZERO, change: 0.0, largest: 0.0 };
        let zeros = self.zeros.iter().map(|z| (z, 1.0));
        for (root, sign) in zeros.chain(self.poles.iter().map(|p| (p, -1.0))) {
            let nearest = distance_to_segment(*root, a, b);
            slopes.at_centre += sign / (centre - root);
            slopes.change += radius / (nearest * nearest);
            slopes.largest += 1.0 / nearest;
        }
        slopes
    }

    /// Bounds of the modulus on `[a, b]`.
    pub(super) fn range(&self, a: f64, b: f64) -> Range {
        let (mut low, mut high) = (self.ln_gain, self.ln_gain);
        for zero in &self.zeros {
            low += distance_to_segment(*zero, a, b).ln();
            high += farthest(*zero, a, b).ln();
        }
        for pole in &self.poles {
            low -= farthest(*pole, a, b).ln();
            high -= distance_to_segment(*pole, a, b).ln();
        }
        Range { low: low.exp(), high: high.exp() }
    }

    /// Bounds of the modulus from `top` to infinity; `top` must be above the size of every root.
    pub(super) fn tail(&self, top: f64) -> Range {
        let excess = self.zeros.len() as f64 - self.poles.len() as f64;
        let mut low = self.ln_gain + excess * top.ln();
        let mut high = low;
        for zero in &self.zeros {
            low += (-zero.norm() / top).ln_1p();
            high += (zero.norm() / top).ln_1p();
        }
        for pole in &self.poles {
            low -= (pole.norm() / top).ln_1p();
            high -= (-pole.norm() / top).ln_1p();
        }
        Range {
            low: if excess < 0.0 { 0.0 } else { low.exp() },
            high: if excess > 0.0 { f64::INFINITY } else { high.exp() },
        }
    }

    /// Sizes of all roots.
    pub(super) fn sizes(&self) -> impl Iterator<Item = f64> {
        self.zeros.iter().chain(&self.poles).map(|root| root.norm())
    }
}

/// Distance of a root from the piece `[ja, jb]` of the axis.
pub(super) fn distance_to_segment(root: Complex64, a: f64, b: f64) -> f64 {
    let beside = (a - root.im).max(root.im - b).max(0.0);
    root.re.hypot(beside)
}

fn farthest(root: Complex64, a: f64, b: f64) -> f64 {
    let along = (root.im - a).abs().max((b - root.im).abs());
    root.re.hypot(along)
}

/// The smaller of two bounds; one that is not a number does not bound.
pub(super) fn smaller(p: f64, q: f64) -> f64 {
    if q < p || p.is_nan() { q } else { p }
}

/// `e^x - 1` with one percent more: roots that were computed stand for exact ones that may lie a little closer.
pub(super) fn inflate(x: f64) -> f64 {
    (1.01 * x).exp_m1()
}
