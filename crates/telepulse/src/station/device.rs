//! The virtual rigs as a study asks for them, and what may be known about them when a run is judged.

use anyhow::{Context, Result, ensure};
use telepulse_actuator::ParameterSet;
use telepulse_actuator::failure::{Envelope, FailureCriteria, SafetyFactors};
use telepulse_actuator::rig::{DisplacementRig, ForceRig, ForceStep, Laser, RigConditions, SensingSine};
use telepulse_actuator::twin::TwinModel;
use telepulse_pulse::calibration::Plate;
use telepulse_rt::{MonotonicNs, Sensor, SensorScale};

use super::run::{ErrorWatch, Truth};
use crate::study::config::Study;

/// What a tracking run is exposed to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Conditions {
    /// The study's force step is on the plate.
    pub disturbance: bool,
    /// The study's sine is on the sensor.
    pub noise: bool,
    /// The laser shows the study's device without noise and steps of its own.
    pub ideal_laser: bool,
}

/// The reduced twin of the study's device.
///
/// # Errors
/// Where the membrane has no solution for it, or the study's voltages are more than it bears.
pub fn twin(study: &Study) -> Result<TwinModel> {
    require_within_envelope(study)?;
    twin_of(study.actuator.parameter_set)
}

/// Refuses a study whose largest voltage lies above what its membrane bears with the usual safety factor.
fn require_within_envelope(study: &Study) -> Result<()> {
    let parameters = study.actuator.parameter_set.parameters();
    let limits = Envelope::new(&parameters.sheet()?, FailureCriteria::default())?
        .supervisor_limits(parameters.weight_n(), SafetyFactors::default())
        .context("no voltage limit follows for the membrane of the study")?;
    ensure!(
        study.control.max_v <= limits.max_v,
        "key `control.max_v`: found {} V, allowed is up to {:.0} V: {} sets in at {:.0} V",
        study.control.max_v,
        limits.max_v,
        limits.limited_by.words(),
        limits.first_failure_v
    );
    Ok(())
}

/// The reduced twin of the study's device, with its error against the field-level model, measured on the spot.
///
/// # Errors
/// As [`twin`].
pub fn twin_with_stated_error(study: &Study) -> Result<TwinModel> {
    require_within_envelope(study)?;
    TwinModel::with_stated_error(&study.actuator.parameter_set.parameters())
        .context("the membrane of the study has no reduced twin")
}

/// The reduced twin of a parameter set.
///
/// # Errors
/// Where the membrane has no solution for it.
pub fn twin_of(set: ParameterSet) -> Result<TwinModel> {
    TwinModel::new(&set.parameters()).context("the membrane of the study has no reduced twin")
}

/// The rig with weight and laser, at rest.
///
/// # Errors
/// Where a condition is out of range.
pub fn displacement(study: &Study, twin: &TwinModel, conditions: Conditions) -> Result<DisplacementRig> {
    let typed = &study.conditions;
    let laser = if conditions.ideal_laser {
        Laser { noise_rms_mm: 0.0, resolution_mm: 0.0, ..Laser::default() }
    } else {
        Laser::default()
    };
    let conditions = RigConditions {
        disturbance: conditions
            .disturbance
            .then_some(ForceStep { force_n: typed.disturbance_n, start_s: typed.disturbance_start_s }),
        sensing_noise: conditions.noise.then_some(SensingSine {
            amplitude_in_sensor_unit: typed.noise_mm,
            frequency_hz: typed.noise_hz,
        }),
        initial_bias_v: 0.0,
    };
    Ok(DisplacementRig::with_laser(twin, laser, conditions, study.actuator.seed)?)
}

/// The rig whose plate is held by a load cell, at rest.
///
/// # Errors
/// Where the cell cannot hold the plate.
pub fn force(study: &Study, twin: &TwinModel) -> Result<ForceRig> {
    Ok(ForceRig::new(twin, RigConditions::default(), study.actuator.seed)?)
}

/// From the laser's distance to the displacement from rest, in mm.
#[must_use]
pub fn displacement_scale() -> SensorScale {
    SensorScale { gain: 1.0, offset: -Laser::default().standoff_mm }
}

/// From the cell's load to its relief since rest in mm-equivalents: the study's pressure per mm on the plate's area.
///
/// Tares the cell: the rest load is the mean of readings over the first second, before any voltage.
///
/// # Errors
/// Where the cell cannot be read.
pub fn force_scale(study: &Study, rig: &ForceRig) -> Result<SensorScale> {
    let plate = Plate::from_pa_per_mm(1e-3 * study.pulse.plate_radius_mm, study.pulse.pa_per_mm)?;
    let mut tared = rig.clone();
    let n_readings = 500_u32;
    let mut sum_n = 0.0;
    for k in 0..n_readings {
        let now = MonotonicNs(u64::from(k) * 2_000_000);
        sum_n += tared.read(now).context("the load cell cannot be tared")?.value;
    }
    let rest_n = sum_n / f64::from(n_readings);
    Ok(SensorScale { gain: -1.0 / plate.n_per_mm(), offset: rest_n / plate.n_per_mm() })
}

/// The supervisor ends a run that is a whole stroke off for half a second.
#[must_use]
pub fn watch(study: &Study) -> ErrorWatch {
    ErrorWatch { limit: 2.0 * study.reference.offset_mm.max(0.1), time_s: 0.5 }
}

impl Truth for DisplacementRig {
    fn true_output(&self) -> f64 {
        self.true_displacement_mm()
    }

    fn supply_power_w(&self) -> f64 {
        Self::supply_power_w(self)
    }
}

impl Truth for ForceRig {
    fn true_output(&self) -> f64 {
        self.true_force_n()
    }

    fn supply_power_w(&self) -> f64 {
        Self::supply_power_w(self)
    }
}
