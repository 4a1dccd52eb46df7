//! The virtual rigs as a study asks for them, and what may be known about them when a run is judged.

use anyhow::{Context, Result, ensure};
use telepulse_actuator::ParameterSet;
use telepulse_actuator::failure::{
    AmplifierLimits, Envelope, FailureCriteria, SafetyFactors, SupervisorLimits,
};
use telepulse_actuator::rig::{
    CapacitiveReading, DisplacementRig, ForceRig, ForceStep, Laser, LoadCell, RigConditions, SensingRecord,
    SensingSine,
};
use telepulse_actuator::twin::TwinModel;
use telepulse_design::implement::ControllerRecipe;
use telepulse_pulse::calibration::Plate;
use telepulse_rt::{MonotonicNs, Sensor, SensorScale};

use super::run::{ErrorWatch, Truth};
use crate::study::config::{SensorChoice, Study};

/// What a tracking run is exposed to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Conditions {
    /// The study's force step is on the plate.
    pub disturbance: bool,
    /// The study's sine is on the sensor.
    pub noise: bool,
    /// The laser shows the study's device without noise and steps of its own; so does the capacitance, without noise of its samples.
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

/// Limits of a run that keep the membrane of a parameter set, under its weight, within its failure envelope with the usual safety
/// factors, and within what its amplifier gives; `current_a` is the amplifier's largest current, if it is known.
///
/// # Errors
/// Where no limit follows.
pub fn envelope_limits(set: ParameterSet, current_a: Option<f64>) -> Result<SupervisorLimits> {
    let parameters = set.parameters();
    let spec = parameters.spec();
    let amplifier = AmplifierLimits {
        max_v: Some(spec.full_scale_v),
        current_a,
        slew_v_per_s: None,
        leak_resistance_ohm: Some(spec.leak_resistance_ohm),
    };
    Envelope::new(&parameters.sheet()?, FailureCriteria::default().with_amplifier(amplifier)?)?
        .supervisor_limits(parameters.weight_n(), SafetyFactors::default())
        .context("no voltage limit follows for the membrane of the study")
}

/// Refuses a study whose voltage or slew lies above what its membrane and amplifier bear with the usual safety factors.
fn require_within_envelope(study: &Study) -> Result<()> {
    let control = &study.control;
    let within = || study.file.display().to_string();
    let limits = envelope_limits(study.actuator.parameter_set, control.current_a)?;
    require_voltage(control.max_v, &limits).with_context(|| format!("in {}", within()))?;
    if let (Some(slew), Some(_)) = (limits.slew_v_per_s, control.current_a) {
        ensure!(
            control.slew_v_per_s <= slew,
            "in {}: key `control.slew_v_per_s`: found {} V/s, allowed is up to {slew:.0} V/s: faster, charging the membrane takes more \
             than the amplifier's current with its safety factor",
            within(),
            control.slew_v_per_s
        );
    }
    Ok(())
}

fn require_voltage(max_v: f64, limits: &SupervisorLimits) -> Result<()> {
    ensure!(
        max_v <= limits.max_v,
        "key `control.max_v`: found {max_v} V, allowed is up to {:.0} V: {} sets in at {:.0} V",
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

/// The rig with weight and laser, at rest: what sweeps are made on.
///
/// # Errors
/// Where a condition is out of range.
pub fn displacement(study: &Study, twin: &TwinModel, conditions: Conditions) -> Result<DisplacementRig> {
    let laser = if conditions.ideal_laser {
        Laser { noise_rms_mm: 0.0, resolution_mm: 0.0, ..Laser::default() }
    } else {
        Laser::default()
    };
    let exposed = exposed(study, conditions);
    Ok(DisplacementRig::with_laser(twin, laser, exposed, study.actuator.seed)?)
}

/// The rig with weight and the study's sensor, at rest: what runs are made on.
///
/// # Errors
/// Where a condition is out of range.
pub fn sensed(study: &Study, twin: &TwinModel, conditions: Conditions) -> Result<DisplacementRig> {
    if study.actuator.sensor == SensorChoice::Laser {
        return displacement(study, twin, conditions);
    }
    let mut reading = CapacitiveReading::below(study.control.max_v);
    if conditions.ideal_laser {
        (reading.settings.voltage_noise_v, reading.settings.current_noise_a) = (0.0, 0.0);
    }
    let exposed = exposed(study, conditions);
    DisplacementRig::with_capacitance(twin, reading, exposed, study.actuator.seed)
        .context("key `actuator.sensor`: the plate cannot be felt by its capacitance")
}

fn exposed(study: &Study, conditions: Conditions) -> RigConditions {
    let typed = &study.conditions;
    RigConditions {
        disturbance: conditions
            .disturbance
            .then_some(ForceStep { force_n: typed.disturbance_n, start_s: typed.disturbance_start_s }),
        sensing_noise: conditions.noise.then_some(SensingSine {
            amplitude_in_sensor_unit: typed.noise_mm,
            frequency_hz: typed.noise_hz,
        }),
        initial_bias_v: 0.0,
        fidelity: study.actuator.fidelity,
    }
}

/// The rig whose plate is held by a load cell, at rest.
///
/// # Errors
/// Where the cell cannot hold the plate.
pub fn force(study: &Study, twin: &TwinModel) -> Result<ForceRig> {
    force_on(study, twin, 1.0)
}

/// The same with a cell of another stiffness: `stiffness_factor` times the assumed one.
///
/// # Errors
/// Where the cell cannot hold the plate.
pub fn force_on(study: &Study, twin: &TwinModel, stiffness_factor: f64) -> Result<ForceRig> {
    let conditions = RigConditions { fidelity: study.actuator.fidelity, ..RigConditions::default() };
    let usual = LoadCell::default();
    let cell = LoadCell { stiffness_n_per_m: stiffness_factor * usual.stiffness_n_per_m, ..usual };
    Ok(ForceRig::with_load_cell(twin, cell, conditions, study.actuator.seed)?)
}

/// Factors of the contact's stiffness that force mode must bear: as assumed, and 50 % less and more.
pub const STIFFNESS_FACTORS: [f64; 3] = [1.0, 0.5, 1.5];

/// From the laser's distance to the displacement from rest, in mm.
#[must_use]
pub fn displacement_scale() -> SensorScale {
    SensorScale { gain: 1.0, offset: -Laser::default().standoff_mm }
}

/// The right by which a recipe runs on the study's sensor in displacement mode: its own, and what that does not cover.
#[must_use]
pub fn provenance(study: &Study, recipe: &ControllerRecipe) -> String {
    let own = recipe.provenance();
    match study.actuator.sensor {
        SensorChoice::Laser => own.to_string(),
        SensorChoice::Capacitance => {
            format!("{own}; with a laser: the lag of self-sensing is in no certificate")
        }
    }
}

/// From the reading of the study's sensor to the displacement from rest, in mm.
#[must_use]
pub fn sensed_scale(study: &Study) -> SensorScale {
    match study.actuator.sensor {
        SensorChoice::Laser => displacement_scale(),
        SensorChoice::Capacitance => SensorScale { gain: 1.0, offset: 0.0 },
    }
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

    fn fault(&self) -> Option<String> {
        Self::fault(self).map(ToString::to_string)
    }

    fn sensing(&self) -> Option<SensingRecord> {
        Self::sensing(self)
    }
}

impl Truth for ForceRig {
    fn true_output(&self) -> f64 {
        self.true_force_n()
    }

    fn supply_power_w(&self) -> f64 {
        Self::supply_power_w(self)
    }

    fn fault(&self) -> Option<String> {
        Self::fault(self).map(ToString::to_string)
    }

    fn sensing(&self) -> Option<SensingRecord> {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edge_voltage_above_the_envelope_is_refused_with_the_mechanism() {
        for set in [ParameterSet::A, ParameterSet::B, ParameterSet::C] {
            // Without its amplifier the membrane itself sets the limit.
            let parameters = set.parameters();
            let sheet = parameters.sheet().expect("a sheet");
            let limits = Envelope::new(&sheet, FailureCriteria::default())
                .and_then(|mut found| {
                    found.supervisor_limits(parameters.weight_n(), SafetyFactors::default())
                })
                .expect("a limit");
            require_voltage(limits.max_v, &limits).expect("the limit itself is allowed");
            let refused = require_voltage(limits.max_v + 1.0, &limits).expect_err("above").to_string();
            for part in ["`control.max_v`", limits.limited_by.words(), "sets in at"] {
                assert!(refused.contains(part), "{set:?}: `{part}` is not in: {refused}");
            }
            // 5 kV is the amplifier's end, and lies within the envelope of all three.
            let with_amplifier = envelope_limits(set, None).expect("a limit");
            assert!((with_amplifier.max_v - 5000.0).abs() < 1e-9, "{set:?}: {with_amplifier:?}");
            assert!(with_amplifier.slew_v_per_s.is_none());
        }
    }

    #[test]
    fn law_slew_follows_from_the_current_left_beside_the_leak() {
        let limits = envelope_limits(ParameterSet::A, Some(0.5e-3)).expect("a limit");
        // (0.8 x 0.5 mA - 5 kV/27.4 Mohm)/2.9787 nF, the capacitance of set A at 5 kV by another solver.
        let expected = (0.8 * 0.5e-3 - 5000.0 / 27.4e6) / 2.978_701_651_554_214e-9;
        let found = limits.slew_v_per_s.expect("a slew");
        assert!((found / expected - 1.0).abs() < 1e-6, "{found} {expected}");
        // A current that the leak takes up entirely limits the voltage.
        let weak = envelope_limits(ParameterSet::A, Some(0.1e-3)).expect("a limit");
        assert!((weak.max_v / (0.8 * 0.1e-3 * 27.4e6) - 1.0).abs() < 1e-9, "{weak:?}");
    }
}
