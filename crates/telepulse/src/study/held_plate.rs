//! What identification learns of a plate that a load cell holds: a linear model with its bound, and the curve of its force.

use anyhow::{Context, Result, bail, ensure};
use telepulse_actuator::twin::TwinModel;
use telepulse_design::identify::{
    Controlled, InputLinearisation, ModelProvenance, PlantModel, SweepRecord, UncertaintyBound,
    cap_family_error, fit_first_order,
};
use telepulse_design::implement::StaticInverse;
use telepulse_lti::TransferFunction;
use telepulse_rt::{ControlLaw, CycleInputs};

use super::config::{RcTime, Study};
use super::identify::{cover_options, held_sweep_plan, run_sweep};
use crate::station::control::{linearisation, open_loop};
use crate::station::device::{self, STIFFNESS_FACTORS};
use crate::station::run::{ErrorWatch, tick_through};

/// A first-order model of the held plate, in mm-equivalents per unit.
#[derive(Debug, Clone)]
pub struct HeldModel {
    /// The points on the cell as assumed.
    pub record: SweepRecord,
    /// What was fitted to them.
    pub plant: TransferFunction,
    /// The bound of what the fit leaves, on cells of every stiffness in [`STIFFNESS_FACTORS`].
    pub bound: UncertaintyBound,
    rms_residual: f64,
}

/// Sweeps the held plate on a cell of `stiffness_factor` times the assumed stiffness.
///
/// # Errors
/// Where the rig trips or a window holds no usable line.
pub fn record(
    study: &Study,
    twin: &TwinModel,
    stiffness_factor: f64,
    input: InputLinearisation,
) -> Result<SweepRecord> {
    let mut rig = device::force_on(study, twin, stiffness_factor)?;
    let scale = device::force_scale(study, &rig)?;
    run_sweep(&mut rig, study, &held_sweep_plan(study)?, scale, input, study.identify.bias)
}

impl HeldModel {
    /// The model of sweeps on cells of the stiffnesses [`STIFFNESS_FACTORS`]: fitted to the first, bounded over all, so that the contact's
    /// stiffness is part of the uncertainty that a certificate covers.
    ///
    /// # Errors
    /// Where no model or no bound follows from the records.
    pub fn fit(records: [SweepRecord; STIFFNESS_FACTORS.len()], rc_s: f64) -> Result<Self> {
        let fit = fit_first_order(&records[0], rc_s)?;
        let bound = cap_family_error(&records.each_ref(), &fit.transfer_function, &cover_options())?;
        let [record, ..] = records;
        Ok(Self { record, plant: fit.transfer_function, bound, rms_residual: fit.rms_residual })
    }

    /// Sweeps the study's held plate and fits its model; the circuit's time constant must be known.
    ///
    /// # Errors
    /// Where the rig trips, the study leaves the circuit to the fit, or no bound exists.
    pub fn measure(study: &Study, twin: &TwinModel, input: InputLinearisation) -> Result<Self> {
        let RcTime::Known(rc_s) = study.identify.rc_s else {
            bail!(
                "key `identify.rc_s`: found \"free\", allowed is a time constant in s: a held plate does not determine it"
            );
        };
        let [usual, soft, stiff] = STIFFNESS_FACTORS.map(|factor| record(study, twin, factor, input));
        Self::fit([usual?, soft?, stiff?], rc_s)
    }

    /// The model as a file for later stages.
    ///
    /// # Errors
    /// Where a number is out of its range.
    pub fn plant_model(&self, study: &Study, input: InputLinearisation, record: &str) -> Result<PlantModel> {
        Ok(PlantModel {
            version: PlantModel::VERSION,
            nominal: self.plant.clone(),
            uncertainty: Some(self.bound.weight.clone()),
            controlled: Controlled::CellRelief,
            input_linearisation: input,
            bias_unit: study.identify.bias,
            bias_displacement_mm: None,
            full_scale_v: study.control.full_scale_v,
            provenance: ModelProvenance::Identified {
                record: record.to_owned(),
                n_points: self.record.points().len(),
                rms_residual_mm_per_unit: self.rms_residual,
            },
        }
        .checked()?)
    }
}

/// Steps of the staircase.
const N_STEPS: usize = 20;
/// Time on each, s.
const STEP_S: f64 = 1.0;
/// The rest of it is averaged, s: circuit and cell have settled long before.
const SETTLE_S: f64 = 0.4;

/// The curve of the held plate: the squared voltage (units) over the relief of the cell (mm-equivalents), from a staircase over the whole range.
///
/// # Errors
/// Where the rig trips, or the relief does not rise with the voltage.
pub fn measure_curve(study: &Study, twin: &TwinModel) -> Result<StaticInverse> {
    let mut rig = device::force(study, twin)?;
    let scale = device::force_scale(study, &rig)?;
    let root = linearisation(InputLinearisation::SquareRoot);
    let mut control = open_loop(study, scale, root, ControlLaw::OpenLoop)?;
    let per_step = (STEP_S * study.control.sample_rate_hz) as usize;
    let settle = (SETTLE_S * study.control.sample_rate_hz) as usize;
    let top = (study.control.max_v / study.control.full_scale_v).powi(2);
    let drive: Vec<f64> = (0..=N_STEPS).map(|k| top * k as f64 / N_STEPS as f64).collect();
    let mut sums = vec![0.0; drive.len()];
    let inputs = (0..drive.len() * per_step)
        .map(|tick| CycleInputs { reference: 0.0, feedforward: drive[tick / per_step] });
    let trip = tick_through(&mut rig, &mut control, inputs, ErrorWatch::OFF, |tick, output, _| {
        if tick % per_step >= settle {
            sums[tick / per_step] += output.measured;
        }
    })?;
    ensure!(trip.is_none(), "the staircase was ended: {}", trip.map_or(String::new(), |r| r.to_string()));
    let relief: Vec<f64> = sums.iter().map(|sum| sum / (per_step - settle) as f64).collect();
    StaticInverse::new(&drive, &relief).context("the curve of the held plate")
}
