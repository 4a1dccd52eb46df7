//! Why a run was ended for safety.

use crate::{DriveFault, SensorFault};

/// A signal of the loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Signal {
    /// The reference `r` of the cycle.
    Reference,
    /// The feedforward command of the cycle.
    Feedforward,
    /// The scaled measurement `y`.
    Measurement,
    /// The unit command before limits.
    Command,
}

impl core::fmt::Display for Signal {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Reference => "reference",
            Self::Feedforward => "feedforward",
            Self::Measurement => "measurement",
            Self::Command => "command",
        })
    }
}

/// What ended a run. The drive has been commanded to the lowest voltage by the time anyone sees one of these.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum TripReason {
    /// The sensor gave no usable value.
    #[error("sensor fault: {0}")]
    Sensor(SensorFault),
    /// The drive refused a command.
    #[error("drive fault: {0}")]
    Drive(DriveFault),
    /// A signal is NaN or infinite.
    #[error("{0} is not a finite number")]
    NotFinite(Signal),
    /// The tracking error stayed over its limit for too long.
    #[error("tracking error {error} stayed over its limit {limit} for more than {allowed_s} s")]
    TrackingError {
        /// Error at the trip, in the controlled variable's unit.
        error: f64,
        /// Limit in the same unit.
        limit: f64,
        /// Time allowed over the limit, in seconds.
        allowed_s: f64,
    },
    /// A cycle began later than its period and tolerance allow.
    #[error("cycle began {interval_s} s after the one before, at most {allowed_s} s are allowed")]
    CycleOverrun {
        /// Time since the cycle before, in seconds.
        interval_s: f64,
        /// Longest interval allowed, in seconds.
        allowed_s: f64,
    },
    /// The clock that must never step back did.
    #[error("cycle clock stepped back by {step_s} s")]
    ClockStep {
        /// Size of the step, in seconds.
        step_s: f64,
    },
    /// The operator stopped the run.
    #[error("operator stop")]
    OperatorStop,
}
