//! What a rig shows to the rest of the program: a sensor to read and a drive to command.

use crate::DriveVoltage;

/// Time since the start of the run, in nanoseconds of a clock that never steps back.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct MonotonicNs(pub u64);

impl MonotonicNs {
    /// Seconds since the start of the run; exact to a nanosecond for 104 days.
    #[must_use]
    pub fn seconds(self) -> f64 {
        self.0 as f64 * 1e-9
    }
}

/// One sample of a sensor, in the sensor's own unit (laser: distance in mm; load cell: force in N).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// The value in the sensor's own unit.
    pub value: f64,
}

/// Why a sensor gave no usable value.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum SensorFault {
    /// The target lies outside of the measuring range.
    #[error("sensor reading {value} lies outside of its range {min} to {max}")]
    OutOfRange {
        /// The reading, in the sensor's unit.
        value: f64,
        /// Lower end of the range.
        min: f64,
        /// Upper end of the range.
        max: f64,
    },
    /// The reading is NaN or infinite.
    #[error("sensor reading is not a finite number")]
    NotFinite,
    /// No new value has arrived since the last cycle.
    #[error("sensor has not delivered a new value")]
    Stale,
}

/// Why a drive refused a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum DriveFault {
    /// The amplifier reports a fault or does not answer.
    #[error("amplifier did not accept the command")]
    Refused,
}

/// A sensor that is read once in each cycle.
pub trait Sensor {
    /// Returns the value at `now`.
    ///
    /// # Errors
    /// A [`SensorFault`] when there is no value that a controller may use.
    fn read(&mut self, now: MonotonicNs) -> Result<Reading, SensorFault>;
}

/// A high-voltage amplifier. The commanded voltage is held until the next command.
pub trait Drive {
    /// Commands `voltage` from `now` on.
    ///
    /// # Errors
    /// A [`DriveFault`] when the command did not take effect.
    fn apply(&mut self, now: MonotonicNs, voltage: DriveVoltage) -> Result<(), DriveFault>;
}
