//! What happens in every control tick: controller, filter, limits, supervisor, cycle, device traits.
//!
//! Nothing here allocates, blocks, prints or knows the time of day. The crate builds without the standard library.
#![no_std]

mod device;
mod limits;

pub use device::{Drive, DriveFault, MonotonicNs, Reading, Sensor, SensorFault};
pub use limits::{DriveVoltage, Limited, Limits, LimitsError};
