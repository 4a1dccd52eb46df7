//! Measures how a device moves over its whole stroke and fits the nonlinear model that the feedforward inverts.

use anyhow::{Result, bail};
use serde::{Deserialize, Serialize};
use telepulse_design::identify::{
    GreyBoxExperiment, GreyBoxExperimentOptions, GreyBoxFit, GreyBoxFitOptions, GreyBoxRecord,
    InputLinearisation, RcPole, ThirdOrderFit, fit_grey_box,
};
use telepulse_rt::{ControlLaw, CycleInputs, Drive, Sensor, SensorScale};

use super::config::Study;
use crate::station::control::{linearisation, open_loop};
use crate::station::run::{ErrorWatch, tick_through};

/// The numbers of a nonlinear model.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct NonlinearModel {
    /// Root mean square of what it leaves of the record, averaged over four samples.
    pub rms_residual_mm: f64,
    /// The same over the part of the record that was held back.
    pub rms_held_back_mm: Option<f64>,
    /// Largest displacement of the record.
    pub displacement_max_mm: f64,
    /// Relaxation times of the creep branches.
    pub relaxation_times_s: Vec<f64>,
    /// Stiffness of each branch over that of the spring at rest.
    pub branch_shares: Vec<f64>,
    /// Condition number of the fit.
    pub condition: f64,
}

impl NonlinearModel {
    /// The numbers of a fit.
    #[must_use]
    pub fn of(fit: &GreyBoxFit) -> Self {
        let [_, by_x, _] = fit.model.pull(0.0, 0.0);
        let branches = fit.model.branches();
        Self {
            rms_residual_mm: fit.rms_residual_mm,
            rms_held_back_mm: fit.rms_held_back_mm,
            displacement_max_mm: fit.model.displacement_max_mm(),
            relaxation_times_s: branches.iter().map(|branch| branch.relaxation_time_s).collect(),
            branch_shares: branches.iter().map(|branch| branch.stiffness_per_s2 / -by_x).collect(),
            condition: fit.condition,
        }
    }
}

/// Drives a rig that stands at rest through the experiment and fits a model to what it shows, starting from a linear one.
///
/// # Errors
/// Where the rig trips or the fit does not converge.
pub fn measure<R: Sensor + Drive>(
    rig: &mut R,
    study: &Study,
    scale: SensorScale,
    start: &ThirdOrderFit,
) -> Result<GreyBoxFit> {
    let experiment = GreyBoxExperiment::new(&GreyBoxExperimentOptions {
        sample_rate_hz: study.control.sample_rate_hz,
        seed: study.actuator.seed,
        ..GreyBoxExperimentOptions::default()
    })?;
    let root = linearisation(InputLinearisation::SquareRoot);
    let mut control = open_loop(study, scale, root, ControlLaw::OpenLoop)?;
    let mut record = GreyBoxRecord { sample_time_s: study.sample_time_s(), ..GreyBoxRecord::default() };
    let inputs = experiment.drive().iter().map(|&feedforward| CycleInputs { reference: 0.0, feedforward });
    let trip = tick_through(rig, &mut control, inputs, ErrorWatch::OFF, |_, output, _| {
        record.voltage_unit.push(output.voltage_v / study.control.full_scale_v);
        record.response_mm.push(output.measured);
    })?;
    if let Some(reason) = trip {
        bail!("the experiment was ended: {reason}");
    }
    // The circuit is the linear model's: the experiment has little to say about it.
    let options = GreyBoxFitOptions { rc: RcPole::Known(start.rc_s), ..GreyBoxFitOptions::default() };
    Ok(fit_grey_box(&record, start, &options)?)
}
