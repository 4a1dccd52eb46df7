//! Limits for the supervisor, derived from the envelope.

use serde::Serialize;
use telepulse_rt::{Limits, LimitsError};

use super::criteria::Mechanism;
use super::envelope::Envelope;
use crate::Error;
use crate::statics::Load;

/// Which part of a limit may be used.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SafetyFactors {
    /// Of the voltage at which the first mechanism sets in.
    pub voltage: f64,
    /// Of the amplifier's current.
    pub current: f64,
}

impl Default for SafetyFactors {
    /// 0.8 of both: the batch scatter and ageing of the shear modulus move the voltages by about 10 %.
    fn default() -> Self {
        Self { voltage: 0.8, current: 0.8 }
    }
}

/// Limits that keep a run inside the envelope.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SupervisorLimits {
    /// Largest voltage to command, V.
    pub max_v: f64,
    /// What sets in first above it.
    pub limited_by: Mechanism,
    /// Voltage at which it does, V.
    pub first_failure_v: f64,
    /// Fastest change of voltage that the amplifier's current or slew allows, V/s; none where neither is given.
    pub slew_v_per_s: Option<f64>,
    /// Displacement below the frame at which the plate rests under `max_v`, m.
    pub displacement_at_max_m: f64,
    /// True where a number has not been checked against its source.
    pub unverified: bool,
}

impl SupervisorLimits {
    /// As the real-time part takes them, from `min_v` on.
    ///
    /// # Errors
    /// [`LimitsError`] where `min_v` is not below the largest voltage.
    pub fn rt_limits(&self, min_v: f64) -> Result<Limits, LimitsError> {
        Limits::new(min_v, self.max_v, self.slew_v_per_s.unwrap_or(f64::INFINITY))
    }
}

impl Envelope {
    /// Limits for a run under the dead load `weight_n`.
    ///
    /// **Method**: the largest voltage is a part of the lowest one at which anything sets in, and never more than the amplifier's
    /// own. The slew is what the current left beside the leak charges the largest capacitance with.
    ///
    /// # Errors
    /// [`Error::Parameter`] for factors outside of 0 to 1; those of [`Envelope::voltage_limits`]; [`Error::NoVoltageBorne`]
    /// where something has set in without voltage, or nothing ever does, so that no limit follows.
    pub fn supervisor_limits(
        &mut self,
        weight_n: f64,
        factors: SafetyFactors,
    ) -> Result<SupervisorLimits, Error> {
        for (key, found) in [("safety.voltage", factors.voltage), ("safety.current", factors.current)] {
            if !(found > 0.0 && found <= 1.0) {
                return Err(Error::Parameter { key, allowed: "above 0 and at most 1", found });
            }
        }
        let limits = self.voltage_limits(weight_n)?;
        let amplifier = self.criteria.amplifier;
        // What the amplifier gives by itself is no failure: no safety factor is lost on it.
        let allowed = |mechanism: Mechanism| match mechanism {
            Mechanism::AmplifierVoltage => 1.0,
            Mechanism::AmplifierCurrent => factors.current,
            _ => factors.voltage,
        };
        let lowest = limits
            .limits
            .iter()
            .filter_map(|limit| limit.voltage_v.map(|v| (limit.mechanism, v, v * allowed(limit.mechanism))))
            .min_by(|a, b| a.2.total_cmp(&b.2));
        let Some((limited_by, first_failure_v, max_v)) = lowest.filter(|(_, _, max_v)| *max_v > 0.0) else {
            return Err(Error::NoVoltageBorne { force_n: weight_n });
        };
        let point = self.near(Load::ForceN(weight_n), max_v)?;
        let by_current = amplifier.current_a.map(|current| {
            let leak = amplifier.leak_resistance_ohm.map_or(0.0, |ohm| max_v / ohm);
            (factors.current * current - leak).max(0.0) / point.capacitance_f
        });
        let slew_v_per_s = [by_current, amplifier.slew_v_per_s].into_iter().flatten().reduce(f64::min);
        Ok(SupervisorLimits {
            max_v,
            limited_by,
            first_failure_v,
            slew_v_per_s: slew_v_per_s.filter(|slew| *slew > 0.0),
            displacement_at_max_m: point.displacement_m,
            unverified: limits.limits.iter().any(|limit| limit.unverified),
        })
    }
}
