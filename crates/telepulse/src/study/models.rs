//! The models a study identifies, each from a sweep of its own.

use anyhow::{Context, Result, bail};
use rayon::prelude::*;
use telepulse_actuator::twin::TwinModel;
use telepulse_design::identify::{
    Controlled, GreyBoxFit, InputLinearisation, ModelProvenance, PlantModel, SweepRecord, UncertaintyBound,
    fit_first_order,
};
use telepulse_lti::TransferFunction;

use super::bias_sweep::{self, LocalPlant};
use super::config::{RcTime, Study};
use super::grey_box;
use super::identify::{Identification, bound, held_sweep_plan, identify, plant_model, run_sweep, sweep};
use crate::station::device::{self, Conditions};

/// Sweeps of a study: voltage and its square, in displacement and in force mode, and the small ones at other biases.
pub const N_SWEEPS: u64 = 6;

/// Everything that identification knows about the device.
#[derive(Debug, Clone)]
pub struct Models {
    /// Displacement from voltage, as in the paper.
    pub voltage: Identification,
    /// Displacement from the square of the voltage.
    pub square_root: Identification,
    /// Displacement from both at other biases.
    pub locals: Vec<LocalPlant>,
    /// Displacement over the whole stroke: the nonlinear model.
    pub motion: GreyBoxFit,
    /// Relief of the load cell from voltage.
    pub force_voltage: HeldModel,
    /// Relief of the load cell from the square of the voltage.
    pub force_square_root: HeldModel,
}

/// A first-order model of the held plate, in mm-equivalents per unit.
#[derive(Debug, Clone)]
pub struct HeldModel {
    /// The points.
    pub record: SweepRecord,
    /// What was fitted.
    pub plant: TransferFunction,
    /// The bound of what the fit leaves.
    pub bound: UncertaintyBound,
    rms_residual: f64,
}

/// Sweeps the rigs and fits the models, on both cores; `done` is called after each sweep.
///
/// # Errors
/// Where a rig trips or a sweep does not determine its model.
pub fn measure(study: &Study, twin: &TwinModel, done: &(dyn Fn() + Sync)) -> Result<Models> {
    let inputs = [InputLinearisation::None, InputLinearisation::SquareRoot];
    let jobs = [(false, inputs[0]), (false, inputs[1]), (true, inputs[0]), (true, inputs[1])];
    let records = jobs
        .par_iter()
        .map(|(held, input)| {
            let record = record(study, twin, *held, *input);
            done();
            record
        })
        .collect::<Result<Vec<SweepRecord>>>()?;
    let [voltage, square_root, force_voltage, force_square_root] =
        <[SweepRecord; 4]>::try_from(records).unwrap_or_else(|_| unreachable!("four jobs give four records"));
    // The circuit is the same in all four; where it is left to the fit, the displacement sweep determines it.
    let voltage = identify(voltage, study.identify.rc_s).context("the displacement sweep")?;
    let rc = RcTime::Known(voltage.fit.rc_s);
    let square_root =
        identify(square_root, rc).context("the displacement sweep with the square of the voltage")?;
    let (locals, motion) = rayon::join(
        || bias_sweep::measure(study, twin, voltage.fit.rc_s),
        || {
            let mut rig = device::displacement(study, twin, Conditions::default())?;
            grey_box::measure(&mut rig, study, device::displacement_scale(), &square_root.fit)
                .context("the nonlinear model")
        },
    );
    let (locals, motion) = (locals?, motion?);
    done();
    done();
    Ok(Models {
        locals,
        motion,
        square_root,
        force_voltage: HeldModel::fit(force_voltage, voltage.fit.rc_s).context("the force sweep")?,
        force_square_root: HeldModel::fit(force_square_root, voltage.fit.rc_s)
            .context("the force sweep with the square of the voltage")?,
        voltage,
    })
}

fn record(study: &Study, twin: &TwinModel, held: bool, input: InputLinearisation) -> Result<SweepRecord> {
    if held {
        let mut rig = device::force(study, twin)?;
        let scale = device::force_scale(study, &rig)?;
        let plan = held_sweep_plan(study)?;
        return run_sweep(&mut rig, study, &plan, scale, input, study.identify.bias);
    }
    let mut rig = device::displacement(study, twin, Conditions::default())?;
    sweep(&mut rig, study, device::displacement_scale(), input)
}

impl HeldModel {
    fn fit(record: SweepRecord, rc_s: f64) -> Result<Self> {
        let fit = fit_first_order(&record, rc_s)?;
        let bound = bound(&record, &fit.transfer_function)?;
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
        Self::fit(record(study, twin, true, input)?, rc_s)
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

impl Models {
    /// The sweeps with their file names.
    #[must_use]
    pub fn sweeps(&self) -> [(&'static str, &SweepRecord); 4] {
        [
            ("identify/sweep.csv", &self.voltage.record),
            ("identify/sweep_square_root.csv", &self.square_root.record),
            ("identify/sweep_force.csv", &self.force_voltage.record),
            ("identify/sweep_force_square_root.csv", &self.force_square_root.record),
        ]
    }

    /// The models for later stages: voltage and its square in displacement mode, then both in force mode.
    ///
    /// # Errors
    /// Where a model is out of its range.
    pub fn plants(&self, study: &Study) -> Result<[PlantModel; 4]> {
        let (plain, root) = (InputLinearisation::None, InputLinearisation::SquareRoot);
        Ok([
            plant_model(study, &self.voltage, plain, "sweep.csv")?,
            plant_model(study, &self.square_root, root, "sweep_square_root.csv")?,
            self.force_voltage.plant_model(study, plain, "sweep_force.csv")?,
            self.force_square_root.plant_model(study, root, "sweep_force_square_root.csv")?,
        ])
    }
}

/// Files of the models of [`Models::plants`], in that order.
pub const MODEL_FILES: [&str; 4] = [
    "identify/model.json",
    "identify/model_square_root.json",
    "identify/model_force.json",
    "identify/model_force_square_root.json",
];

/// A plant that was not identified here, with voltage as its command.
///
/// # Errors
/// Where the plant or its bound is refused.
pub fn given(
    study: &Study,
    nominal: TransferFunction,
    uncertainty: TransferFunction,
    source: &str,
) -> Result<PlantModel> {
    Ok(PlantModel {
        version: PlantModel::VERSION,
        nominal,
        uncertainty: Some(uncertainty),
        controlled: Controlled::Displacement,
        input_linearisation: InputLinearisation::None,
        bias_unit: study.identify.bias,
        bias_displacement_mm: None,
        full_scale_v: study.control.full_scale_v,
        provenance: ModelProvenance::Given { source: source.to_owned() },
    }
    .checked()?)
}
