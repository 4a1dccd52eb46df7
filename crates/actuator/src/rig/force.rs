//! The rig of the force-feedback runs: the plate pushes against a load cell.

use telepulse_rt::{Drive, DriveFault, DriveVoltage, MonotonicNs, Reading, Sensor, SensorFault};

use super::RigConditions;
use super::assumptions::{
    CELL_DAMPING_RATIO, CELL_NOISE_RMS_N, CELL_RANGE_N, CELL_RESOLUTION_N, CELL_STIFFNESS_N_PER_M,
    FORCE_PLATE_MASS_KG,
};
use super::instrument::{Imperfections, Instrument};
use super::plant::Plant;
use crate::Error;
use crate::twin::{Contact, ContactLaw, PlateLoad, TwinModel};

/// A load cell that holds the plate from above. All defaults are assumptions ([`super::rig_assumptions`]).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoadCell {
    /// Mass of the plate without a weight, kg.
    pub plate_mass_kg: f64,
    /// Stiffness, N/m.
    pub stiffness_n_per_m: f64,
    /// Damping ratio of the plate on the cell.
    pub damping_ratio: f64,
    /// Where it holds the plate at zero voltage, mm from the rest position under the weight.
    pub hold_at_mm: f64,
    /// Full scale in compression, N; the lower end of the range is 0.
    pub range_n: f64,
    /// White noise, rms, N.
    pub noise_rms_n: f64,
    /// Steps of the reading, N; zero for none.
    pub resolution_n: f64,
}

impl Default for LoadCell {
    fn default() -> Self {
        Self {
            plate_mass_kg: FORCE_PLATE_MASS_KG,
            stiffness_n_per_m: CELL_STIFFNESS_N_PER_M,
            damping_ratio: CELL_DAMPING_RATIO,
            hold_at_mm: 0.0,
            range_n: CELL_RANGE_N,
            noise_rms_n: CELL_NOISE_RMS_N,
            resolution_n: CELL_RESOLUTION_N,
        }
    }
}

/// The actuator without its weight, held down by a load cell.
///
/// ```text
///   fixed base ====  load cell (spring, damper)  ==== plate ==== membrane pulls up with F(x, V)
/// ```
/// **Sign**: the reading is the compression of the cell in N, which at rest is F minus the plate's own weight. Voltage lowers
/// F, so the reading **falls** as the voltage rises. The cell can push the plate, not pull it.
#[derive(Debug, Clone)]
pub struct ForceRig {
    plant: Plant,
    instrument: Instrument,
}

impl ForceRig {
    /// A rig with the default load cell; `seed` makes its noise.
    ///
    /// # Errors
    /// [`Error::Request`] names the condition that is out of range.
    pub fn new(model: &TwinModel, conditions: RigConditions, seed: u64) -> Result<Self, Error> {
        Self::with_load_cell(model, LoadCell::default(), conditions, seed)
    }

    /// A rig with a given load cell.
    ///
    /// # Errors
    /// [`Error::Request`] names the condition that is out of range.
    pub fn with_load_cell(
        model: &TwinModel,
        cell: LoadCell,
        conditions: RigConditions,
        seed: u64,
    ) -> Result<Self, Error> {
        let positive = [
            ("plate_mass_kg", cell.plate_mass_kg),
            ("load cell stiffness_n_per_m", cell.stiffness_n_per_m),
            ("load cell range_n", cell.range_n),
        ];
        for (quantity, found) in positive {
            if !(found.is_finite() && found > 0.0) {
                return Err(Error::Request { quantity, allowed: "finite and positive", found });
            }
        }
        if !(cell.damping_ratio.is_finite() && cell.damping_ratio >= 0.0) {
            return Err(Error::Request {
                quantity: "load cell damping_ratio",
                allowed: "finite and not negative",
                found: cell.damping_ratio,
            });
        }
        let range = model.range();
        if !(cell.hold_at_mm >= range.min_mm && cell.hold_at_mm <= range.max_mm) {
            return Err(Error::Request {
                quantity: "load cell hold_at_mm",
                allowed: "within the range of the twin's maps",
                found: cell.hold_at_mm,
            });
        }
        let gravity = model.parameters().spec().gravity_m_per_s2;
        let carried_n = model.force_n(cell.hold_at_mm, 0.0) - cell.plate_mass_kg * gravity;
        let contact = Contact {
            law: ContactLaw::SpringDamper {
                stiffness_n_per_m: cell.stiffness_n_per_m,
                damping_n_s_per_m: 2.0
                    * cell.damping_ratio
                    * (cell.stiffness_n_per_m * cell.plate_mass_kg).sqrt(),
            },
            touch_mm: cell.hold_at_mm + carried_n / cell.stiffness_n_per_m * 1e3,
        };
        let load = PlateLoad { mass_kg: cell.plate_mass_kg, contact: Some(contact) };
        let imperfections = Imperfections {
            noise_rms: cell.noise_rms_n,
            resolution: cell.resolution_n,
            min: 0.0,
            max: cell.range_n,
        };
        Ok(Self {
            plant: Plant::new(model, load, &conditions)?,
            instrument: Instrument::new(imperfections, conditions.sensing_noise, seed)?,
        })
    }

    /// True compression of the load cell at the last call, N. For evaluation only.
    #[must_use]
    pub fn true_force_n(&self) -> f64 {
        self.plant.contact_force_n()
    }

    /// True displacement from the rest position under the weight at the last call, mm. For evaluation only.
    #[must_use]
    pub fn true_displacement_mm(&self) -> f64 {
        self.plant.displacement_mm()
    }

    /// Power from the amplifier at the last call, W. For evaluation only.
    #[must_use]
    pub fn supply_power_w(&self) -> f64 {
        self.plant.supply_power_w()
    }

    /// Voltage across the membrane at the last call, V. For evaluation only.
    #[must_use]
    pub fn membrane_voltage_v(&self) -> f64 {
        self.plant.membrane_voltage_v()
    }

    /// True once a reduced twin has left the range of its maps. For evaluation only.
    #[must_use]
    pub fn has_left_map(&self) -> bool {
        self.plant.has_left_map()
    }

    /// Why the membrane moves no further, where a call has found no equilibrium. For evaluation only.
    #[must_use]
    pub fn fault(&self) -> Option<&Error> {
        self.plant.fault()
    }
}

impl Sensor for ForceRig {
    fn read(&mut self, now: MonotonicNs) -> Result<Reading, SensorFault> {
        self.plant.advance_to(now).map_err(|_| SensorFault::Stale)?;
        let truth = self.plant.contact_force_n();
        self.instrument.show(now, truth)
    }
}

impl Drive for ForceRig {
    fn apply(&mut self, now: MonotonicNs, voltage: DriveVoltage) -> Result<(), DriveFault> {
        self.plant.drive(now, voltage.volts()).map_err(|_| DriveFault::Refused)
    }
}
