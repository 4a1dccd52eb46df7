//! Virtual rigs: a twin behind the sensor and drive traits, with the imperfections of real instruments.
//!
//! The rest of the program sees a rig through [`telepulse_rt::Sensor`] and [`telepulse_rt::Drive`]; what it may not know
//! during a run (the true displacement, say) is there for evaluation afterwards.

mod assumptions;
mod capacitance;
mod displacement;
mod force;
mod instrument;
mod plant;

pub use assumptions::{RigAssumption, rig_assumptions};
pub use capacitance::{CapacitiveReading, SensingRecord};
pub use displacement::{DisplacementRig, Fingertip, Laser};
pub use force::{ForceRig, LoadCell};

use telepulse_rt::MonotonicNs;

use crate::Error;
use crate::twin::Fidelity;

/// A force on the plate that sets in during the run and stays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceStep {
    /// Force, N, positive down.
    pub force_n: f64,
    /// Time since the start of the run at which it sets in, s.
    pub start_s: f64,
}

/// A sine added to what the sensor reads, as the sensing noise of Table 1: amplitude * sin(2 pi f t).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SensingSine {
    /// Amplitude in the unit of the sensor: mm for the laser, N for the load cell.
    pub amplitude_in_sensor_unit: f64,
    /// Frequency, Hz.
    pub frequency_hz: f64,
}

impl SensingSine {
    fn at(&self, now: MonotonicNs) -> f64 {
        self.amplitude_in_sensor_unit * (std::f64::consts::TAU * self.frequency_hz * now.seconds()).sin()
    }

    fn check(&self) -> Result<(), Error> {
        let parts = [
            ("sensing noise amplitude", self.amplitude_in_sensor_unit),
            ("sensing noise frequency_hz", self.frequency_hz),
        ];
        for (quantity, found) in parts {
            if !(found.is_finite() && found >= 0.0) {
                return Err(Error::Request { quantity, allowed: "finite and not negative", found });
            }
        }
        Ok(())
    }
}

/// What a run is exposed to. The default is the normal condition from zero voltage.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RigConditions {
    /// Disturbance force on the plate.
    pub disturbance: Option<ForceStep>,
    /// Sine on the sensor.
    pub sensing_noise: Option<SensingSine>,
    /// Voltage under which plate, circuit and branches have settled before the run starts, V.
    pub initial_bias_v: f64,
    /// Which model of the device moves: the reduced twin, or the field-level model, some hundred times slower.
    pub fidelity: Fidelity,
}
