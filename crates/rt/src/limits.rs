//! The only place where a drive voltage is made.

use thiserror::Error;

/// A voltage that has passed [`Limits`]; there is no other way to build one.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct DriveVoltage(f64);

impl DriveVoltage {
    /// The voltage in volts.
    #[must_use]
    pub fn volts(self) -> f64 {
        self.0
    }
}

/// Why a set of limits was refused.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum LimitsError {
    /// Not `0 <= min_v < max_v`, or not finite.
    #[error("voltage limits must satisfy 0 <= min_v < max_v, found {min_v} and {max_v}")]
    Range {
        /// Lower limit in volts.
        min_v: f64,
        /// Upper limit in volts.
        max_v: f64,
    },
    /// The slew limit is not positive.
    #[error("slew limit must be positive, found {slew_v_per_s} V/s")]
    Slew {
        /// Slew limit in volts per second.
        slew_v_per_s: f64,
    },
}

/// Range and slew rate that no command may leave.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    min_v: f64,
    max_v: f64,
    slew_v_per_s: f64,
}

/// A voltage within limits, and whether the request had to be changed for it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limited {
    /// The voltage to apply.
    pub voltage: DriveVoltage,
    /// True where the request lay outside of range or slew, or was not a number.
    pub saturated: bool,
}

impl Limits {
    /// Limits in volts; `slew_v_per_s` may be infinite.
    ///
    /// # Errors
    /// [`LimitsError`] unless `0 <= min_v < max_v` and the slew rate is positive.
    pub fn new(min_v: f64, max_v: f64, slew_v_per_s: f64) -> Result<Self, LimitsError> {
        if !(min_v >= 0.0 && min_v < max_v && max_v.is_finite()) {
            return Err(LimitsError::Range { min_v, max_v });
        }
        if slew_v_per_s.is_nan() || slew_v_per_s <= 0.0 {
            return Err(LimitsError::Slew { slew_v_per_s });
        }
        Ok(Self { min_v, max_v, slew_v_per_s })
    }

    /// Zero volts: where a drive stands before a run, after it, and after a trip.
    ///
    /// `min_v` bounds the commands of a running loop only; an actuator that is not driven carries no voltage.
    #[must_use]
    pub fn off(&self) -> DriveVoltage {
        DriveVoltage(0.0)
    }

    /// Highest voltage allowed, in volts.
    #[must_use]
    pub fn max_v(&self) -> f64 {
        self.max_v
    }

    /// The allowed voltage nearest to `request_v`, at most `slew_v_per_s * dt_s` away from `previous`.
    ///
    /// A request that is not a number yields the lowest voltage, within the slew limit. From [`off`](Self::off) the range comes
    /// before the slew limit: the first voltage may be `min_v` at once.
    #[must_use]
    pub fn clamp(&self, request_v: f64, previous: DriveVoltage, dt_s: f64) -> Limited {
        let wanted_v = if request_v.is_nan() { self.min_v } else { request_v };
        let in_range_v = wanted_v.clamp(self.min_v, self.max_v);
        let step_v = self.slew_v_per_s * dt_s;
        // An infinite slew rate over a zero step is NaN; it means "no limit".
        let in_slew_v = if step_v.is_nan() {
            in_range_v
        } else {
            in_range_v.clamp(previous.0 - step_v, previous.0 + step_v).clamp(self.min_v, self.max_v)
        };
        Limited { voltage: DriveVoltage(in_slew_v), saturated: request_v.is_nan() || in_slew_v != request_v }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_random::Random;

    #[test]
    fn law_every_voltage_lies_in_range_and_slew() {
        for seed in 0..500 {
            let mut random = Random::new(seed);
            let min_v = random.between(0.0, 2000.0);
            let limits = Limits::new(min_v, min_v + random.between(0.1, 4000.0), random.between(1.0, 1e7))
                .expect("valid limits");
            let dt_s = random.between(0.0, 1e-2);
            let mut previous = limits.off();
            for _ in 0..100 {
                let exotic = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -0.0];
                let request_v =
                    if random.below(10) == 0 { exotic[random.below(4)] } else { random.between(-1e4, 1e4) };
                let limited = limits.clamp(request_v, previous, dt_s);
                let volts = limited.voltage.volts();
                assert!(volts >= limits.min_v && volts <= limits.max_v, "seed {seed}: {volts}");
                // One rounding of the bound. From the off state the range comes first: there is no allowed voltage below it.
                let step_v = (volts - previous.volts().max(min_v)).abs();
                assert!(step_v <= limits.slew_v_per_s * dt_s + 1e-9, "seed {seed}: step {step_v}");
                assert_eq!(limited.saturated, volts != request_v, "seed {seed}: request {request_v}");
                previous = limited.voltage;
            }
        }
    }

    #[test]
    fn edge_infinite_slew_over_no_time_is_no_limit() {
        let limits = Limits::new(0.0, 5000.0, f64::INFINITY).expect("valid limits");
        assert_eq!(limits.clamp(4000.0, limits.off(), 0.0).voltage.volts(), 4000.0);
        assert_eq!(limits.clamp(f64::INFINITY, limits.off(), 1e-3).voltage.volts(), 5000.0);
    }

    #[test]
    fn edge_unusable_limits_are_refused() {
        for (min_v, max_v) in
            [(-1.0, 5.0), (5.0, 5.0), (f64::NAN, 5.0), (0.0, f64::NAN), (0.0, f64::INFINITY)]
        {
            assert!(matches!(Limits::new(min_v, max_v, 1.0), Err(LimitsError::Range { .. })));
        }
        for slew in [0.0, -1.0, f64::NAN] {
            assert!(matches!(Limits::new(0.0, 1.0, slew), Err(LimitsError::Slew { .. })));
        }
    }
}
