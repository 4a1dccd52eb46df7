//! The high-voltage side: amplifier with its limits, and the circuit that charges the membrane.

use super::require;
use crate::Error;

/// The amplifier: command (V) to output voltage.
///
/// **Method**: gain, saturation between 0 and `max_v`, then a lag whose speed is limited. Within a step, over which the
/// command is held, the output is known in closed form: a ramp at the slew rate, then an exponential.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Amplifier {
    /// Output over command; 1 for a calibrated one.
    pub gain: f64,
    /// Highest output, V; the lowest is 0.
    pub max_v: f64,
    /// Time constant of the output, s; 0 for none.
    pub time_constant_s: f64,
    /// Fastest change of the output, V/s; may be infinite.
    pub slew_v_per_s: f64,
    /// Largest current into the membrane, A; may be infinite. Where it is reached, the output gives way.
    pub current_limit_a: f64,
}

impl Amplifier {
    /// An amplifier that does no more than saturate at `max_v`.
    #[must_use]
    pub fn ideal(max_v: f64) -> Self {
        Self {
            gain: 1.0,
            max_v,
            time_constant_s: 0.0,
            slew_v_per_s: f64::INFINITY,
            current_limit_a: f64::INFINITY,
        }
    }

    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Parameter`] names the first key out of range.
    pub fn check(&self) -> Result<(), Error> {
        let Self { gain, max_v, time_constant_s: lag, slew_v_per_s: slew, current_limit_a: limit } = *self;
        require(gain.is_finite() && gain > 0.0, "amplifier gain", "finite and positive", gain)?;
        require(max_v.is_finite() && max_v > 0.0, "amplifier max_v", "finite and positive", max_v)?;
        let usable = lag.is_finite() && lag >= 0.0;
        require(usable, "amplifier time_constant_s", "finite and not negative", lag)?;
        require(slew > 0.0, "amplifier slew_v_per_s", "positive", slew)?;
        require(limit > 0.0, "amplifier current_limit_a", "positive", limit)
    }

    /// Where the output goes under a command.
    pub(super) fn target_v(&self, command_v: f64) -> f64 {
        (self.gain * command_v).clamp(0.0, self.max_v)
    }

    /// Output `t` seconds after it stood at `start_v`, under a target that is held.
    pub(super) fn output_v(&self, start_v: f64, target_v: f64, t: f64) -> f64 {
        let distance = target_v - start_v;
        // While the distance exceeds this, the lag alone would be faster than the slew rate.
        let knee = if self.time_constant_s > 0.0 { self.slew_v_per_s * self.time_constant_s } else { 0.0 };
        let ramp_s = ((distance.abs() - knee) / self.slew_v_per_s).max(0.0);
        if t < ramp_s {
            return start_v + (self.slew_v_per_s * t).copysign(distance);
        }
        if self.time_constant_s == 0.0 {
            return target_v;
        }
        let left = distance.abs().min(knee).copysign(distance);
        target_v - left * (-(t - ramp_s) / self.time_constant_s).exp()
    }
}

/// How the amplifier's output reaches the electrodes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Circuit {
    /// Phi' = (u - Phi)/(R C) with the constant R C of the parameters: the membrane's capacitance does not change.
    ConstantRc,
    /// d(C Phi)/dt = (u - Phi)/R_s - Phi/R_leak with the capacitance of the membrane as it deforms.
    Deformable {
        /// R_s, ohm.
        series_resistance_ohm: f64,
        /// R_leak across the electrodes, ohm; may be infinite.
        leak_resistance_ohm: f64,
    },
}

impl Circuit {
    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Parameter`] names the first key out of range.
    pub fn check(&self) -> Result<(), Error> {
        let Self::Deformable { series_resistance_ohm: series, leak_resistance_ohm: leak } = *self else {
            return Ok(());
        };
        let usable = series.is_finite() && series > 0.0;
        require(usable, "series_resistance_ohm", "finite and positive", series)?;
        require(leak > 0.0, "membrane leak_resistance_ohm", "positive", leak)
    }
}

/// Which way the current limit acts in a stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Current {
    /// The resistor sets it.
    Free,
    /// At the limit, charging.
    Charging,
    /// At the limit, discharging.
    Discharging,
}

impl Current {
    /// Where a current that the resistor would set lies.
    pub(super) fn of(free_a: f64, limit_a: f64) -> Self {
        if free_a > limit_a {
            Self::Charging
        } else if free_a < -limit_a {
            Self::Discharging
        } else {
            Self::Free
        }
    }

    /// The limit with its sign, or nothing where the resistor sets the current.
    pub(super) fn limited_a(self, limit_a: f64) -> Option<f64> {
        match self {
            Self::Free => None,
            Self::Charging => Some(limit_a),
            Self::Discharging => Some(-limit_a),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_output_is_continuous_bounded_in_speed_and_composes() {
        let amplifier = Amplifier { time_constant_s: 2e-3, slew_v_per_s: 5e5, ..Amplifier::ideal(5000.0) };
        let (start, target) = (100.0, amplifier.target_v(9000.0));
        assert_eq!(target, 5000.0);
        let mut last = start;
        for k in 1..=4000 {
            let t = f64::from(k) * 5e-6;
            let value = amplifier.output_v(start, target, t);
            assert!(value >= last && value - last <= 5e5 * 5e-6 * (1.0 + 1e-9), "{t}: {last} {value}");
            last = value;
        }
        // A ramp of 7.8 ms to 1000 V short of it, then six time constants: 1000 exp(-6.1) = 2.2 V.
        assert!((last - target).abs() < 3.0, "{last}");
        // Two steps in a row are one long step, also across the knee.
        let middle = amplifier.output_v(start, target, 7e-3);
        let (two, one) = (amplifier.output_v(middle, target, 6e-3), amplifier.output_v(start, target, 13e-3));
        assert!((two - one).abs() < 1e-9, "{two} {one}");
        let ramp = Amplifier { slew_v_per_s: 1e5, ..Amplifier::ideal(5000.0) };
        assert!((ramp.output_v(3000.0, 0.0, 0.01) - 2000.0).abs() < 1e-9);
        assert_eq!(Amplifier::ideal(5000.0).output_v(3000.0, 0.0, 0.0), 0.0);
    }

    #[test]
    fn edge_bad_amplifier_and_circuit_name_their_key() {
        let bad = Amplifier { slew_v_per_s: 0.0, ..Amplifier::ideal(5000.0) };
        assert!(matches!(bad.check(), Err(Error::Parameter { key: "amplifier slew_v_per_s", .. })));
        let bad = Circuit::Deformable { series_resistance_ohm: -1.0, leak_resistance_ohm: 1e9 };
        assert!(matches!(bad.check(), Err(Error::Parameter { key: "series_resistance_ohm", .. })));
    }
}
