//! Classical margins of a single loop: how much gain and phase it can lose or gain before it becomes unstable.

use num_complex::Complex64;
use serde::{Deserialize, Serialize};

use crate::{Error, StateSpace, TimeDomain, TransferFunction};

/// A gain margin: the loop's phase is -180 degrees at `omega_rad_s`, and `factor · L` passes through -1 there.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GainMargin {
    /// The gain factor that brings the loop to its stability boundary.
    pub factor: f64,
    /// Frequency of the crossing, in rad/s.
    pub omega_rad_s: f64,
}

/// A phase margin: the loop's gain is one at `omega_rad_s`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhaseMargin {
    /// Phase above -180 degrees, in `(-180, 180]`. Negative: the loop leads to -1 by less than nothing.
    pub degrees: f64,
    /// Frequency of the crossing, in rad/s.
    pub omega_rad_s: f64,
    /// Extra delay that turns the phase by the margin, in s; one period more where the margin is negative.
    pub delay_margin_s: f64,
}

/// All crossings of a loop `L` and the distance of its locus from -1.
///
/// The margins are those of negative feedback, `1 / (1 + L)`. They mean what their names say only for a loop that is
/// stable when closed, which this type does not check.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoopMargins {
    /// Every crossing of the negative real axis, in order of frequency.
    pub gain_margins: Vec<GainMargin>,
    /// Every crossing of gain one, in order of frequency.
    pub phase_margins: Vec<PhaseMargin>,
    /// Smallest distance of the locus from -1, the inverse of the peak of the sensitivity.
    pub modulus_margin: f64,
    /// Frequency of that distance, in rad/s.
    pub modulus_omega_rad_s: f64,
}

impl LoopMargins {
    /// Returns the margins of the loop `L = frequency response of loop_`.
    ///
    /// **Method**: evaluates `L` on a logarithmic grid that is refined around its poles and zeros, brackets every change of
    /// sign of `Im L` (with `Re L < 0`) and of `|L| - 1`, and refines each by bisection; golden-section search for the
    /// modulus margin.
    ///
    /// **Accuracy**: crossings to about `1e-12` relative. Two crossings closer than the grid (400 points a decade and 80
    /// around each resonance) are missed together.
    ///
    /// **Errors**: [`Error::NotSiso`], [`Error::EigenvaluesNotConverged`].
    ///
    /// **Example**
    /// ```
    /// use telepulse_lti::{LoopMargins, TransferFunction};
    /// // 1 / (s + 1)³ crosses -180 degrees at sqrt(3) rad/s with gain 1/8.
    /// let l = TransferFunction::new(&[1.0], &[1.0, 3.0, 3.0, 1.0])?;
    /// let margins = LoopMargins::of_state_space(&l.to_state_space())?;
    /// assert!((margins.upper_gain_margin().unwrap().factor - 8.0).abs() < 1e-9);
    /// # Ok::<(), telepulse_lti::Error>(())
    /// ```
    pub fn of_state_space<D: TimeDomain>(loop_: &StateSpace<D>) -> Result<Self, Error> {
        let (n_inputs, n_outputs) = (loop_.n_inputs(), loop_.n_outputs());
        if (n_inputs, n_outputs) != (1, 1) {
            return Err(Error::NotSiso { n_inputs, n_outputs });
        }
        let balanced = loop_.balanced();
        let mut features = balanced.poles()?;
        features.extend(balanced.zeros().unwrap_or_default());
        let limit = loop_.domain().sample_time_of().map(|ts| ts.nyquist_rad_s());
        if let Some(ts) = loop_.domain().sample_time_of() {
            // Where a discrete feature sits on the frequency axis.
            for feature in &mut features {
                *feature = feature.ln() / ts.seconds();
            }
        }
        let response =
            |omega: f64| balanced.evaluate(balanced.domain().point(omega)).map(|values| values[(0, 0)]);
        Ok(Self::search(response, &grid(&features, limit)))
    }

    /// Returns the margins of a continuous loop given as a transfer function; see [`LoopMargins::of_state_space`].
    ///
    /// **Errors**: as [`LoopMargins::of_state_space`].
    pub fn of_transfer_function(loop_: &TransferFunction) -> Result<Self, Error> {
        Self::of_state_space(&loop_.to_state_space())
    }

    /// Smallest gain margin above one: how much the gain may grow.
    pub fn upper_gain_margin(&self) -> Option<GainMargin> {
        let above = self.gain_margins.iter().filter(|m| m.factor > 1.0);
        above.min_by(|a, b| a.factor.total_cmp(&b.factor)).copied()
    }

    /// Largest gain margin below one: how far the gain may fall; `None` where it may fall to zero.
    pub fn lower_gain_margin(&self) -> Option<GainMargin> {
        let below = self.gain_margins.iter().filter(|m| m.factor <= 1.0);
        below.max_by(|a, b| a.factor.total_cmp(&b.factor)).copied()
    }

    /// The phase margin of least size.
    pub fn phase_margin(&self) -> Option<PhaseMargin> {
        self.phase_margins.iter().min_by(|a, b| a.degrees.abs().total_cmp(&b.degrees.abs())).copied()
    }

    /// Peak of the sensitivity `1 / (1 + L)`.
    pub fn peak_sensitivity(&self) -> f64 {
        1.0 / self.modulus_margin
    }

    fn search(response: impl Fn(f64) -> Option<Complex64>, grid: &[f64]) -> Self {
        let points: Vec<(f64, Complex64)> =
            grid.iter().filter_map(|&omega| response(omega).map(|value| (omega, value))).collect();
        let distance = |omega: f64| response(omega).map_or(f64::INFINITY, |l| (l + 1.0).norm());
        let mut margins = Self {
            gain_margins: Vec::new(),
            phase_margins: Vec::new(),
            modulus_margin: f64::INFINITY,
            modulus_omega_rad_s: 0.0,
        };
        for pair in points.windows(2) {
            let ((left, l0), (right, l1)) = (pair[0], pair[1]);
            if (l0.im < 0.0) != (l1.im < 0.0) && (l0.re < 0.0 || l1.re < 0.0) {
                let omega = bisect(left, right, |omega| response(omega).map(|l| l.im));
                // A pole on the axis also changes the sign, with a gain that no factor brings to one.
                if let Some(l) = response(omega).filter(|l| l.re < 0.0 && l.im.abs() < 1e-3 * l.norm()) {
                    margins.gain_margins.push(GainMargin { factor: -1.0 / l.re, omega_rad_s: omega });
                }
            }
            if (l0.norm() < 1.0) != (l1.norm() < 1.0) {
                let omega = bisect(left, right, |omega| response(omega).map(|l| l.norm() - 1.0));
                if let Some(l) = response(omega) {
                    // Angle of L measured from -1.
                    let degrees = (-l).arg().to_degrees();
                    let turn = if degrees < 0.0 { degrees + 360.0 } else { degrees };
                    let delay_margin_s = turn.to_radians() / omega;
                    margins.phase_margins.push(PhaseMargin { degrees, omega_rad_s: omega, delay_margin_s });
                }
            }
        }
        for (k, &(omega, value)) in points.iter().enumerate() {
            let here = (value + 1.0).norm();
            let before = if k > 0 { (points[k - 1].1 + 1.0).norm() } else { f64::INFINITY };
            let after = points.get(k + 1).map_or(f64::INFINITY, |p| (p.1 + 1.0).norm());
            if here <= before && here <= after && here < 1.1 * margins.modulus_margin {
                let left = if k > 0 { points[k - 1].0 } else { omega };
                let right = points.get(k + 1).map_or(omega, |p| p.0);
                let refined = golden_section(left, right, &distance);
                for candidate in [omega, refined] {
                    let found = distance(candidate);
                    if found < margins.modulus_margin {
                        margins.modulus_margin = found;
                        margins.modulus_omega_rad_s = candidate;
                    }
                }
            }
        }
        margins
    }
}

/// Increasing frequencies from two decades below the slowest feature to two above the fastest.
fn grid(features: &[Complex64], limit: Option<f64>) -> Vec<f64> {
    let sizes = || features.iter().map(|f| f.norm()).filter(|v| *v > 1e-9 && v.is_finite());
    let slowest = sizes().fold(f64::INFINITY, f64::min).min(1.0);
    let fastest = sizes().fold(0.0, f64::max).max(1.0);
    let (low, high) = ((1e-2 * slowest).log10(), (1e2 * fastest).log10());
    let n_points = ((high - low) * POINTS_PER_DECADE).ceil() as usize;
    let mut grid: Vec<f64> =
        (0..=n_points).map(|k| 10.0_f64.powf(low + (high - low) * k as f64 / n_points as f64)).collect();
    for feature in features.iter().filter(|f| f.im > 0.0) {
        // Around a resonance the locus turns within its damping.
        for k in 0..POINTS_PER_RESONANCE {
            let offset = (2.0 * k as f64 / (POINTS_PER_RESONANCE - 1) as f64 - 1.0) * 4.0;
            grid.push(feature.im + offset * offset.abs() * feature.re.abs());
        }
    }
    let limit = limit.unwrap_or(f64::INFINITY);
    grid.push(if limit.is_finite() { limit } else { 10.0 * 10.0_f64.powf(high) });
    grid.retain(|omega| *omega > 0.0 && *omega <= limit);
    grid.sort_by(f64::total_cmp);
    grid.dedup();
    grid
}

/// Zero of a function that changes sign between `left` and `right`.
fn bisect(mut left: f64, mut right: f64, f: impl Fn(f64) -> Option<f64>) -> f64 {
    let negative_left = f(left).is_some_and(|v| v < 0.0);
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (left + right);
        if f(middle).is_some_and(|v| v < 0.0) == negative_left {
            left = middle;
        } else {
            right = middle;
        }
    }
    0.5 * (left + right)
}

/// Minimum of a function with one minimum between `left` and `right`.
fn golden_section(mut left: f64, mut right: f64, f: &impl Fn(f64) -> f64) -> f64 {
    let ratio = 0.5 * (5.0_f64.sqrt() - 1.0);
    let mut inner = [right - ratio * (right - left), left + ratio * (right - left)];
    let mut values = [f(inner[0]), f(inner[1])];
    for _ in 0..GOLDEN_STEPS {
        if values[0] < values[1] {
            right = inner[1];
            inner = [right - ratio * (right - left), inner[0]];
            values = [f(inner[0]), values[0]];
        } else {
            left = inner[0];
            inner = [inner[1], left + ratio * (right - left)];
            values = [values[1], f(inner[1])];
        }
    }
    0.5 * (left + right)
}

const POINTS_PER_DECADE: f64 = 400.0;
const POINTS_PER_RESONANCE: usize = 80;
/// Enough to exhaust a double from neighbouring grid points.
const BISECTIONS: usize = 60;
/// 0.618^60 of the interval, far below the square root of rounding at which a minimum is flat.
const GOLDEN_STEPS: usize = 60;

#[cfg(test)]
mod tests {
    use super::*;

    fn margins(numerator: &[f64], denominator: &[f64]) -> LoopMargins {
        let l = TransferFunction::new(numerator, denominator).expect("proper");
        LoopMargins::of_transfer_function(&l).expect("siso")
    }

    #[test]
    fn law_third_order_lag_has_its_textbook_margins() {
        // 4 / (s + 1)³: -180 degrees at sqrt(3), gain 4/8; |L| = 1 at sqrt(4^(2/3) - 1).
        let m = margins(&[4.0], &[1.0, 3.0, 3.0, 1.0]);
        let gain = m.upper_gain_margin().expect("crosses");
        assert!((gain.factor - 2.0).abs() < 1e-11 && (gain.omega_rad_s - 3.0_f64.sqrt()).abs() < 1e-11);
        let omega = (4.0_f64.powf(2.0 / 3.0) - 1.0).sqrt();
        let phase = m.phase_margin().expect("crosses");
        assert!((phase.omega_rad_s - omega).abs() < 1e-11);
        assert!((phase.degrees - (180.0 - 3.0 * omega.atan().to_degrees())).abs() < 1e-9);
        assert!(m.lower_gain_margin().is_none());
    }

    #[test]
    fn law_conditionally_stable_loop_has_a_lower_gain_margin() {
        // k (s + 1)² / s³ is stable for k > 1/2: the locus crosses -180 degrees at 1 rad/s with gain 2k.
        let m = margins(&[2.0, 4.0, 2.0], &[1.0, 0.0, 0.0, 0.0]);
        let lower = m.lower_gain_margin().expect("crosses");
        assert!((lower.factor - 0.25).abs() < 1e-10 && (lower.omega_rad_s - 1.0).abs() < 1e-9, "{lower:?}");
    }

    #[test]
    fn law_modulus_margin_is_the_inverse_norm_of_the_sensitivity() {
        let l = TransferFunction::new(&[4.0], &[1.0, 3.0, 3.0, 1.0]).expect("proper");
        // S = (s + 1)³ / ((s + 1)³ + 4)
        let s = TransferFunction::new(&[1.0, 3.0, 3.0, 1.0], &[1.0, 3.0, 3.0, 5.0]).expect("proper");
        let norm = crate::hinf_norm(&s.to_state_space()).expect("stable");
        let m = LoopMargins::of_transfer_function(&l).expect("siso");
        assert!((m.peak_sensitivity() / norm.value - 1.0).abs() < 1e-12);
        assert!((m.modulus_omega_rad_s / norm.omega_rad_s - 1.0).abs() < 1e-6);
    }

    #[test]
    fn edge_a_small_loop_has_no_crossings() {
        let m = margins(&[0.1], &[1.0, 1.0]);
        assert!(m.upper_gain_margin().is_none() && m.phase_margin().is_none());
        assert!((m.modulus_margin - 1.0).abs() < 1e-2);
    }
}
