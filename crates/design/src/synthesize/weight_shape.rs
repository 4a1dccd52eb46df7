//! Weights from the numbers that an engineer has in mind: gains and a corner.

use telepulse_lti::{Discrete, SampleTime, StateSpace, TransferFunction};

use crate::Error;

/// A monotone magnitude: gain at rest, gain at one frequency, gain far above it.
///
/// ```text
///   |W|
///   dc  ------.
///              \                      or rising, with all three in the other order
///   gain . . .  o
///               .\______ high_frequency
///             omega
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WeightShape {
    /// `|W(0)|`.
    pub dc_gain: f64,
    /// The frequency at which the gain is prescribed, in rad/s.
    pub omega_rad_s: f64,
    /// `|W(j omega)|`, strictly between the two others. [`WeightShape::new`] sets it to 1: a crossover.
    pub gain: f64,
    /// `|W(j ∞)|`, or the gain at the Nyquist frequency of a discrete weight. Zero makes the weight strictly proper.
    pub high_frequency_gain: f64,
    /// Number of equal first-order factors, at least 1, which [`WeightShape::new`] sets. More make the transition steeper.
    pub order: usize,
}

impl WeightShape {
    /// A first-order weight that crosses 1 at `crossover_rad_s`.
    #[must_use]
    pub fn new(dc_gain: f64, crossover_rad_s: f64, high_frequency_gain: f64) -> Self {
        Self { dc_gain, omega_rad_s: crossover_rad_s, gain: 1.0, high_frequency_gain, order: 1 }
    }

    fn check(&self) -> Result<(), Error> {
        let range = |key, found: f64, valid: bool, allowed| {
            if valid { Ok(()) } else { Err(Error::OutOfRange { key, found, allowed }) }
        };
        let Self { dc_gain, omega_rad_s, gain, high_frequency_gain, order } = *self;
        let not_negative = |v: f64| v >= 0.0 && v.is_finite();
        range("dc_gain", dc_gain, not_negative(dc_gain), "finite and not negative")?;
        let high = high_frequency_gain;
        range("high_frequency_gain", high, not_negative(high), "finite and not negative")?;
        let omega = omega_rad_s;
        range("omega_rad_s", omega, omega > 0.0 && omega.is_finite(), "positive and finite")?;
        let between = (dc_gain > gain && gain > high) || (dc_gain < gain && gain < high);
        range("gain", gain, between, "strictly between dc_gain and high_frequency_gain")?;
        range("order", order as f64, (1..=ORDER_MAX).contains(&order), "from 1 to 20")
    }

    /// The factor `(high s + dc p) / (s + p)` whose power of `order` is the weight.
    fn factor(&self) -> Result<TransferFunction, Error> {
        self.check()?;
        let root = |gain: f64| gain.powf(1.0 / self.order as f64);
        let (dc, gain, high) = (root(self.dc_gain), root(self.gain), root(self.high_frequency_gain));
        // (high² w² + dc² p²) / (w² + p²) = gain², solved for p; differences of squares as products.
        let ratio = ((gain - high) * (gain + high)) / ((dc - gain) * (dc + gain));
        let pole = self.omega_rad_s * ratio.sqrt();
        if !(pole > 0.0 && pole.is_finite()) {
            return Err(Error::OutOfRange {
                key: "gain",
                found: self.gain,
                allowed: "apart from dc_gain and high_frequency_gain by more than rounding",
            });
        }
        Ok(TransferFunction::new(&[high, dc * pole], &[1.0, pole])?)
    }
}

/// Returns the stable, minimum-phase weight of this shape.
///
/// **Method**: `W = ((h s + d p) / (s + p))^n` with the `n`-th roots of the gains and
/// `p = omega sqrt((g² - h²) / (d² - g²))`; exact at rest, at `omega` and at infinity.
///
/// **Accuracy**: the coefficients of a power lose about one digit per two orders; [`makeweight_state_space`] keeps the factors.
///
/// **Errors**: [`Error::OutOfRange`].
///
/// **Example**
/// ```
/// use telepulse_design::synthesize::{WeightShape, makeweight};
/// let w = makeweight(&WeightShape { order: 2, ..WeightShape::new(100.0, 3.0, 0.5) })?;
/// assert!((w.dc_gain()? - 100.0).abs() < 1e-11);
/// assert!((w.at(3.0).norm() - 1.0).abs() < 1e-13);
/// assert!((w.at(1e9).norm() - 0.5).abs() < 1e-9);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn makeweight(shape: &WeightShape) -> Result<TransferFunction, Error> {
    power(&shape.factor()?, shape.order)
}

/// Returns the weight of this shape as a chain of its first-order factors.
///
/// **Errors**: [`Error::OutOfRange`].
///
/// **Example**
/// ```
/// use telepulse_design::synthesize::{WeightShape, makeweight_state_space};
/// let w = makeweight_state_space(&WeightShape { order: 3, ..WeightShape::new(0.1, 50.0, 1e3) })?;
/// assert_eq!(w.n_states(), 3);
/// assert!((w.at(50.0)?[(0, 0)].norm() - 1.0).abs() < 1e-13);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn makeweight_state_space(shape: &WeightShape) -> Result<StateSpace<telepulse_lti::Continuous>, Error> {
    let factor = shape.factor()?.to_state_space();
    let mut chain = factor.clone();
    for _ in 1..shape.order {
        chain = chain.series(&factor)?;
    }
    Ok(chain)
}

/// Returns the discrete weight of this shape: exact at rest, at `omega` and at the Nyquist frequency.
///
/// **Method**: the bilinear map of the continuous one, pre-warped at `omega`.
///
/// **Errors**: [`Error::OutOfRange`]; [`telepulse_lti::Error::PrewarpFrequency`] unless `omega` lies below Nyquist.
///
/// **Example**
/// ```
/// use telepulse_design::synthesize::{WeightShape, makeweight_discrete};
/// use telepulse_lti::SampleTime;
/// let ts = SampleTime::new(0.01)?;
/// let w = makeweight_discrete(&WeightShape::new(50.0, 20.0, 0.1), ts)?;
/// assert!((w.at(20.0)?[(0, 0)].norm() - 1.0).abs() < 1e-13);
/// assert!((w.at(ts.nyquist_rad_s())?[(0, 0)].norm() - 0.1).abs() < 1e-12);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn makeweight_discrete(
    shape: &WeightShape,
    sample_time: SampleTime,
) -> Result<StateSpace<Discrete>, Error> {
    let continuous = makeweight_state_space(shape)?;
    Ok(continuous.to_discrete_tustin_prewarped(sample_time, shape.omega_rad_s)?)
}

/// Returns the performance weight whose inverse bounds `|S|`: below `steady_error` at rest, below `peak` everywhere, crossing
/// near `bandwidth_rad_s`.
///
/// **Method**: `W = ((s / M^(1/n) + w_b) / (s + w_b A^(1/n)))^n` with the peak `M`, the bandwidth `w_b` and the steady error `A`.
/// The asymptote of `1 / W` crosses 1 at `w_b`; the gain there is not 1 exactly (use [`makeweight`] for that).
///
/// **Source**: Skogestad and Postlethwaite 2005, Eqs. (2.105) and (2.106).
///
/// **Errors**: [`Error::OutOfRange`]: the steady error must be positive and below the peak (an error of zero asks for a weight
/// with a pole on the axis, which no synthesis can stabilize), the order from 1 to 20.
///
/// **Example**
/// ```
/// use telepulse_design::synthesize::sensitivity_weight;
/// let w = sensitivity_weight(1.5, 10.0, 1e-3, 2)?;
/// assert!((1.0 / w.dc_gain()? - 1e-3).abs() < 1e-15);
/// assert!((1.0 / w.at(1e9).norm() - 1.5).abs() < 1e-6);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn sensitivity_weight(
    peak: f64,
    bandwidth_rad_s: f64,
    steady_error: f64,
    order: usize,
) -> Result<TransferFunction, Error> {
    let range = |key, found: f64, valid: bool, allowed| {
        if valid { Ok(()) } else { Err(Error::OutOfRange { key, found, allowed }) }
    };
    let wb = bandwidth_rad_s;
    range("peak", peak, peak > 0.0 && peak.is_finite(), "positive and finite")?;
    range("bandwidth_rad_s", wb, wb > 0.0 && wb.is_finite(), "positive and finite")?;
    range("steady_error", steady_error, steady_error > 0.0 && steady_error < peak, "above 0 and below peak")?;
    range("order", order as f64, (1..=ORDER_MAX).contains(&order), "from 1 to 20")?;
    let root = |v: f64| v.powf(1.0 / order as f64);
    let factor = TransferFunction::new(&[1.0 / root(peak), wb], &[1.0, wb * root(steady_error)])?;
    power(&factor, order)
}

/// `factor` to the power of `order`.
fn power(factor: &TransferFunction, order: usize) -> Result<TransferFunction, Error> {
    let times = |p: &[f64], q: &[f64]| {
        let mut product = vec![0.0; p.len() + q.len() - 1];
        for (i, a) in p.iter().enumerate() {
            for (j, b) in q.iter().enumerate() {
                product[i + j] += a * b;
            }
        }
        product
    };
    let (mut numerator, mut denominator) = (vec![1.0], vec![1.0]);
    for _ in 0..order {
        numerator = times(&numerator, factor.numerator());
        denominator = times(&denominator, factor.denominator());
    }
    Ok(TransferFunction::new(&numerator, &denominator)?)
}

/// More equal factors than this are steeper than anything a loop can follow.
const ORDER_MAX: usize = 20;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_shapes_pass_through_their_three_points_and_are_monotone() {
        for (dc, gain, high) in [(1e3, 1.0, 0.1), (0.01, 1.0, 200.0), (7.0, 0.7, 0.0), (0.0, 2.0, 3.0)] {
            for order in [1, 2, 5] {
                let shape =
                    WeightShape { dc_gain: dc, omega_rad_s: 12.0, gain, high_frequency_gain: high, order };
                let tf = makeweight(&shape).expect("monotone");
                let chain = makeweight_state_space(&shape).expect("monotone");
                assert!(chain.is_stable().expect("poles"));
                let at = |omega: f64| chain.at(omega).expect("stable")[(0, 0)].norm();
                // Small gains of the chain are differences of D and the states' part: D's rounding remains.
                let rounding = 1e-13 * (dc + high);
                assert!((at(0.0) - dc).abs() <= rounding, "{shape:?}: {}", at(0.0));
                assert!((at(12.0) - gain).abs() < 1e-12 * gain, "{shape:?}: {}", at(12.0));
                assert!((chain.d()[(0, 0)] - high).abs() <= 1e-12 * high, "{shape:?}");
                let mut last = at(0.0);
                for k in -40..40 {
                    let omega = 12.0 * 10f64.powf(f64::from(k) / 10.0);
                    let now = at(omega);
                    let step = (now - last) * (high - dc).signum();
                    assert!(step >= -1e-9 * last - rounding, "{shape:?} {omega}");
                    let difference = (tf.at(omega).norm() - now).abs();
                    assert!(difference < 1e-10 * now + rounding, "{shape:?} {omega}: {difference}");
                    last = now;
                }
            }
        }
    }

    #[test]
    fn edge_shapes_that_are_none_are_refused_by_name() {
        let base = WeightShape::new(10.0, 1.0, 0.1);
        for (shape, key) in [
            (WeightShape { dc_gain: f64::INFINITY, ..base }, "dc_gain"),
            (WeightShape { dc_gain: -1.0, ..base }, "dc_gain"),
            (WeightShape { high_frequency_gain: f64::NAN, ..base }, "high_frequency_gain"),
            (WeightShape { omega_rad_s: 0.0, ..base }, "omega_rad_s"),
            (WeightShape { gain: 10.0, ..base }, "gain"),
            (WeightShape { gain: 0.01, ..base }, "gain"),
            (WeightShape { gain: f64::NAN, ..base }, "gain"),
            (WeightShape { order: 0, ..base }, "order"),
            (WeightShape { order: 1000, ..base }, "order"),
        ] {
            match makeweight(&shape) {
                Err(Error::OutOfRange { key: found, .. }) => assert_eq!(found, key),
                other => panic!("{shape:?}: {other:?}"),
            }
        }
        assert!(matches!(
            sensitivity_weight(2.0, 1.0, 0.0, 1),
            Err(Error::OutOfRange { key: "steady_error", .. })
        ));
    }
}
