//! A twin that follows the time of a run.

use telepulse_rt::MonotonicNs;

use super::{ForceStep, RigConditions};
use crate::Error;
use crate::twin::{Inputs, Twin};

/// Longest gap between two calls that a rig bridges, s: a bound on the work of one call.
const MAX_GAP_S: f64 = 3600.0;

/// Why the twin could not be brought to a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TimeFault {
    /// Time went backwards, or too far ahead.
    NotAhead,
}

/// A twin with its clock, the held drive voltage and the disturbance.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Plant {
    pub(super) twin: Twin,
    now: MonotonicNs,
    drive_v: f64,
    disturbance: Option<ForceStep>,
}

impl Plant {
    pub(super) fn new(mut twin: Twin, conditions: &RigConditions) -> Result<Self, Error> {
        let full_scale = twin.model().parameters().spec().full_scale_v;
        let bias = conditions.initial_bias_v;
        if !(bias >= 0.0 && bias <= full_scale) {
            return Err(Error::Request {
                quantity: "initial_bias_v",
                allowed: "between 0 and full scale",
                found: bias,
            });
        }
        if let Some(step) = conditions.disturbance {
            for (quantity, found) in
                [("disturbance force_n", step.force_n), ("disturbance start_s", step.start_s)]
            {
                if !found.is_finite() {
                    return Err(Error::Request { quantity, allowed: "finite", found });
                }
            }
        }
        twin.settle(bias);
        Ok(Self { twin, now: MonotonicNs(0), drive_v: bias, disturbance: conditions.disturbance })
    }

    /// Integrates up to `now` with the held voltage; a disturbance that sets in between splits the interval there.
    pub(super) fn advance_to(&mut self, now: MonotonicNs) -> Result<(), TimeFault> {
        let Some(gap_ns) = now.0.checked_sub(self.now.0) else {
            return Err(TimeFault::NotAhead);
        };
        let duration = gap_ns as f64 * 1e-9;
        if duration > MAX_GAP_S {
            return Err(TimeFault::NotAhead);
        }
        let before =
            self.disturbance.map_or(duration, |step| step.start_s - self.now.seconds()).clamp(0.0, duration);
        let force = self.disturbance.map_or(0.0, |step| step.force_n);
        self.twin.advance(before, Inputs { drive_v: self.drive_v, disturbance_n: 0.0 });
        self.twin.advance(duration - before, Inputs { drive_v: self.drive_v, disturbance_n: force });
        self.now = now;
        Ok(())
    }

    /// Commands `drive_v` from `now` on.
    pub(super) fn drive(&mut self, now: MonotonicNs, drive_v: f64) -> Result<(), TimeFault> {
        self.advance_to(now)?;
        self.drive_v = drive_v;
        // A step of no length puts the voltage on the amplifier, so that current and power see it at once.
        self.twin.advance(0.0, Inputs { drive_v, disturbance_n: 0.0 });
        Ok(())
    }
}
