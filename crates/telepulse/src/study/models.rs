//! The models a study identifies, each from a sweep of its own.

use anyhow::{Context, Result};
use rayon::prelude::*;
use telepulse_actuator::twin::TwinModel;
use telepulse_design::identify::{
    Controlled, GreyBoxFit, InputLinearisation, ModelProvenance, PlantModel, SweepRecord,
};
use telepulse_design::implement::StaticInverse;
use telepulse_lti::TransferFunction;

use super::bias_sweep::{self, LocalPlant};
use super::config::{RcTime, Study};
use super::grey_box;
use super::held_plate::{self, HeldModel};
use super::identify::{Identification, identify, plant_model, sweep};
use crate::station::device::{self, Conditions, STIFFNESS_FACTORS};

/// Sweeps of a study: voltage and its square, in displacement mode, and in force mode on cells of three stiffnesses; the small ones at
/// other biases, and the experiment of the nonlinear model.
pub const N_SWEEPS: u64 = 10;

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
    /// Squared voltage that holds a relief of the load cell.
    pub force_curve: StaticInverse,
}

/// Sweeps the rigs and fits the models, on both cores; `done` is called after each sweep.
///
/// # Errors
/// Where a rig trips or a sweep does not determine its model.
pub fn measure(study: &Study, twin: &TwinModel, done: &(dyn Fn() + Sync)) -> Result<Models> {
    let inputs = [InputLinearisation::None, InputLinearisation::SquareRoot];
    let free = |input| (None, input);
    let held = |input| STIFFNESS_FACTORS.map(|factor| (Some(factor), input));
    let jobs: Vec<(Option<f64>, InputLinearisation)> =
        inputs.map(free).into_iter().chain(inputs.into_iter().flat_map(held)).collect();
    let mut records = jobs
        .par_iter()
        .map(|(held, input)| {
            let record = match held {
                Some(factor) => held_plate::record(study, twin, *factor, *input),
                None => record(study, twin, *input),
            };
            done();
            record
        })
        .collect::<Result<Vec<SweepRecord>>>()?
        .into_iter();
    let mut next = || records.next().unwrap_or_else(|| unreachable!("each job gives a record"));
    let (voltage, square_root) = (next(), next());
    let force_voltage = [next(), next(), next()];
    let force_square_root = [next(), next(), next()];
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
        force_curve: held_plate::measure_curve(study, twin)?,
        voltage,
    })
}

fn record(study: &Study, twin: &TwinModel, input: InputLinearisation) -> Result<SweepRecord> {
    let mut rig = device::displacement(study, twin, Conditions::default())?;
    sweep(&mut rig, study, device::displacement_scale(), input)
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
