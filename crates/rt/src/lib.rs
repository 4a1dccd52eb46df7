//! What happens in every control tick: controller, filter, limits, supervisor, cycle, device traits.
//!
//! Nothing here allocates, blocks, prints or knows the time of day. The crate builds without the standard library.
//!
//! ```text
//!            +-----------------------------------[ cycle ]------------------------------------+
//! reference -+-> filter -> (+) -> law -> (+) -> linearise -> limits -> Drive                  |
//!            |              ^-            ^ feedforward + trim                                |
//!            |              +-- filter <- scale <- Sensor                                     |
//!            +--------------------------------------------------------------------------------+
//! ```
#![no_std]

mod controller;
mod cycle;
mod device;
mod error;
mod estimator;
mod filter;
mod limits;
mod linearisation;
mod pid;
mod relay;
mod supervisor;
#[cfg(test)]
mod test_random;
mod trip;

pub use controller::{ComplexMode, MAX_COMPLEX, MAX_REAL, ModalDeltaController, RealMode};
pub use cycle::{
    AntiWindup, ControlLaw, ControlLoop, ControlSettings, CycleInputs, CycleOutput, ErrorSign, FilterStart,
    SensorScale, cycle,
};
pub use device::{Drive, DriveFault, MonotonicNs, Reading, Sensor, SensorFault};
pub use error::Error;
pub use estimator::{Estimator, EstimatorSettings, N_PARAMETERS, Parameters, Update};
pub use filter::{EQ26_CUTOFF_RAD_S, LowPass};
pub use limits::{DriveVoltage, Limited, Limits, LimitsError};
pub use linearisation::InputLinearisation;
pub use pid::{Pid, PidAntiWindup, PidGains, PidInput, SetpointWeights};
pub use relay::{
    RELAY_CYCLES_MAX, RELAY_SAMPLES_MIN, Relay, RelayAction, RelayCycle, RelayEstimate, RelaySettings,
    RelayStatus, RelayStop,
};
pub use supervisor::{Armed, Disarmed, Running, Supervisor, SupervisorSettings, Tripped};
pub use trip::{Signal, TripReason};
