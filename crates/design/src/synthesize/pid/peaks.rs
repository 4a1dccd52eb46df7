//! The peak of `A/(1 + L)` over all frequencies, with dead time in the loop `L`, as a proven bracket.

use num_complex::Complex64;
use telepulse_lti::PeakGain;

use super::factors::{Factors, inflate, smaller};
use crate::Result;

/// A loop and one of its closed-loop functions.
pub(super) struct ClosedLoopFunction<'a> {
    /// The loop's response, with delay.
    pub(super) loop_at: &'a dyn Fn(f64) -> Complex64,
    /// The loop without delay.
    pub(super) loop_: &'a Factors,
    /// Dead time in the loop, above zero.
    pub(super) delay_s: f64,
    /// `A`.
    pub(super) numerator: &'a Factors,
    /// `A/L`.
    pub(super) over_loop: &'a Factors,
    /// Modulus of `A` at a frequency.
    pub(super) numerator_at: &'a dyn Fn(f64) -> f64,
    /// Modulus of `A/L` at a frequency.
    pub(super) over_loop_at: &'a dyn Fn(f64) -> f64,
}

impl ClosedLoopFunction<'_> {
    /// The bracketed peak.
    ///
    /// **Method**: branch and bound over the frequency axis. On a piece of half-width r around c, L differs from `L(c)` by at most
    /// `|L(c)| (e^{M r} - 1)`, with M a bound of its logarithmic derivative from its poles, zeros and delay, and likewise A. That
    /// bounds `A/(1 + L)`, and `(A/L)/(1 + 1/L)`, from above; where a pole lies on the axis, bounds of the moduli do. The ends of the
    /// axis are covered by the moduli alone. Pieces whose bound is above the largest value seen are cut in two.
    ///
    /// **Accuracy**: `upper/lower - 1` is [`TOLERANCE`].
    pub(super) fn peak(&self) -> Result<PeakGain> {
        let mut search = Search { function: self, best: 0.0, omega: 0.0 };
        let sizes = || self.loop_.sizes().chain(self.numerator.sizes()).filter(|w| *w > 0.0);
        let slowest = sizes().fold(1.0 / self.delay_s, f64::min);
        let fastest = sizes().fold(1.0 / self.delay_s, f64::max);
        let (bottom, mut top) = (1e-3 * slowest, 10.0 * fastest);
        let n_start = (START_PER_DECADE * (top / bottom).log10()).ceil() as usize;
        let edge = |k: usize| bottom * (top / bottom).powf(k as f64 / n_start as f64);
        let mut pieces = vec![(0.0, bottom)];
        pieces.extend((0..n_start).map(|k| (edge(k), edge(k + 1))));
        for (a, b) in &pieces {
            search.look(0.5 * (a + b));
        }
        search.climb();
        let mut growths = 0;
        loop {
            search.look(top);
            if self.tail_bound(top) <= search.best * (1.0 + TOLERANCE) {
                break;
            }
            growths += 1;
            if growths > GROWTHS_MAX {
                return Err(search.not_bounded(self.tail_bound(top)));
            }
            pieces.push((top, 2.0 * top));
            top *= 2.0;
        }
        let mut examined = 0;
        while let Some((a, b)) = pieces.pop() {
            let centre = 0.5 * (a + b);
            search.look(centre);
            let bound = self.bound(a, b);
            if bound <= search.best * (1.0 + TOLERANCE) {
                continue;
            }
            examined += 1;
            if examined > PIECES_MAX {
                return Err(search.not_bounded(bound));
            }
            pieces.push((a, centre));
            pieces.push((centre, b));
        }
        let (value, omega_rad_s) = (search.best, search.omega);
        Ok(PeakGain { value, omega_rad_s, lower: value, upper: value * (1.0 + TOLERANCE) })
    }

    fn value(&self, omega: f64) -> f64 {
        let l = (self.loop_at)(omega);
        if l.norm() > 1.0 {
            (self.over_loop_at)(omega) / (1.0 + l.inv()).norm()
        } else {
            (self.numerator_at)(omega) / (1.0 + l).norm()
        }
    }

    fn bound(&self, a: f64, b: f64) -> f64 {
        let (centre, radius) = (0.5 * (a + b), 0.5 * (b - a));
        let l = (self.loop_at)(centre);
        let change = inflate(radius * (self.loop_.rate(self.delay_s, a, b)));
        let numerator =
            (self.numerator_at)(centre) * (1.0 + inflate(radius * self.numerator.modulus_rate(a, b)));
        let over_loop =
            (self.over_loop_at)(centre) * (1.0 + inflate(radius * self.over_loop.modulus_rate(a, b)));
        // A / (1 + L)
        let first = {
            let below = (1.0 + l).norm() - l.norm() * change;
            if below > 0.0 { numerator / below } else { f64::INFINITY }
        };
        // (A/L) / (1 + 1/L)
        let second = {
            let below = (1.0 + l.inv()).norm() - change / l.norm();
            if below > 0.0 { over_loop / below } else { f64::INFINITY }
        };
        // Where the loop is strong or weak its phase, which a delay turns fast, does not matter.
        let range = self.loop_.range(a, b);
        let third = if range.low > 1.0 {
            smaller(over_loop, self.over_loop.range(a, b).high) / (1.0 - 1.0 / range.low)
        } else {
            f64::INFINITY
        };
        let fourth = if range.high < 1.0 {
            smaller(numerator, self.numerator.range(a, b).high) / (1.0 - range.high)
        } else {
            f64::INFINITY
        };
        smaller(smaller(first, second), smaller(third, fourth))
    }

    fn tail_bound(&self, top: f64) -> f64 {
        let range = self.loop_.tail(top);
        if range.high < 1.0 {
            return self.numerator.tail(top).high / (1.0 - range.high);
        }
        if range.low > 1.0 {
            return self.over_loop.tail(top).high / (1.0 - 1.0 / range.low);
        }
        f64::INFINITY
    }
}

struct Search<'a> {
    function: &'a ClosedLoopFunction<'a>,
    best: f64,
    omega: f64,
}

impl Search<'_> {
    fn look(&mut self, omega: f64) {
        let value = self.function.value(omega);
        if value > self.best {
            (self.best, self.omega) = (value, omega);
        }
    }

    /// Golden-section-like climb from the best frequency: fewer pieces have to be cut later.
    fn climb(&mut self) {
        let mut width = 1.0 / START_PER_DECADE;
        for _ in 0..CLIMBS {
            let centre = self.omega;
            self.look(centre * (1.0 + width));
            self.look(centre / (1.0 + width));
            if self.omega == centre {
                width *= 0.5;
            }
        }
    }

    fn not_bounded(&self, level: f64) -> crate::Error {
        telepulse_lti::Error::PeakNotBounded { lower: self.best, level }.into()
    }
}

/// Relative width of the bracket.
pub(super) const TOLERANCE: f64 = 1e-5;
const START_PER_DECADE: f64 = 30.0;
/// Each climb moves or halves; 60 exhaust the digits that a flat peak can show.
const CLIMBS: usize = 60;
/// Doublings of the last frequency.
const GROWTHS_MAX: usize = 80;
/// Cuts; usual are some thousand.
const PIECES_MAX: usize = 2_000_000;
