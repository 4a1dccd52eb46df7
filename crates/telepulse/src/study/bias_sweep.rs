//! How a design fares away from the bias it was made for: force goes with voltage squared.

use anyhow::{Context, Result};
use rayon::prelude::*;
use telepulse_actuator::twin::TwinModel;
use telepulse_design::identify::{
    FitOptions, InputLinearisation, RcPole, SweepOptions, SweepPlan, ThirdOrderFit, Weighting,
    fit_third_order, log_spaced,
};
use telepulse_lti::{LoopMargins, StateSpace};

use super::config::Study;
use super::controllers::measurement_filter;
use super::identify::run_sweep;
use super::outcome::BiasPoint;
use super::recipes::Loop;
use crate::station::device::{self, Conditions};

/// Biases as fractions of full-scale voltage; the last one leaves just room for the sine.
const BIASES: [f64; 9] = [0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95];
/// Amplitude of the small sine, a fraction of full-scale voltage.
const AMPLITUDE: f64 = 0.04;

/// The plant at one bias, for voltage or for its square as the command.
#[derive(Debug, Clone)]
pub struct LocalPlant {
    bias: f64,
    input: InputLinearisation,
    fit: ThirdOrderFit,
}

/// Identifies the plant with small sines at several biases, on both cores.
///
/// # Errors
/// Where a rig trips or a sweep does not determine a model.
pub fn measure(study: &Study, twin: &TwinModel, rc_s: f64) -> Result<Vec<LocalPlant>> {
    let jobs: Vec<(f64, InputLinearisation)> = BIASES
        .iter()
        .flat_map(|bias| [(*bias, InputLinearisation::None), (*bias, InputLinearisation::SquareRoot)])
        .collect();
    jobs.par_iter()
        .map(|(bias, input)| {
            local(study, twin, rc_s, *bias, *input)
                .with_context(|| format!("small sines about a bias of {bias}"))
        })
        .collect()
}

/// Judges a loop on every plant that has its kind of command, with the filter (26) in the measurement.
///
/// # Errors
/// Where a loop cannot be formed.
pub fn judge(study: &Study, one: &Loop, locals: &[LocalPlant]) -> Result<Vec<BiasPoint>> {
    let filter = measurement_filter(study)?.to_state_space();
    locals
        .iter()
        .filter(|local| local.input == one.input)
        .map(|local| judge_at(one, local, &filter))
        .collect()
}

fn local(
    study: &Study,
    twin: &TwinModel,
    rc_s: f64,
    bias: f64,
    input: InputLinearisation,
) -> Result<LocalPlant> {
    // The same swing of the voltage, in units of the command.
    let (centre, amplitude) = match input {
        InputLinearisation::None => (bias, AMPLITUDE),
        InputLinearisation::SquareRoot => (bias * bias, 2.0 * bias * AMPLITUDE),
    };
    let plan = SweepPlan::new(&SweepOptions {
        frequencies_hz: log_spaced(0.5, 12.0, 10),
        amplitudes: vec![amplitude],
        bias: centre,
        sample_rate_hz: study.control.sample_rate_hz,
        bias_settle_s: 20.0,
        ..SweepOptions::default()
    })?;
    let mut rig = device::displacement(study, twin, Conditions::default())?;
    let record = run_sweep(&mut rig, study, &plan, device::displacement_scale(), input, centre)?;
    let options =
        FitOptions { rc: RcPole::Known(rc_s), weighting: Weighting::Relative, ..FitOptions::default() };
    Ok(LocalPlant { bias, input, fit: fit_third_order(&record, &options)? })
}

fn judge_at(
    one: &Loop,
    local: &LocalPlant,
    filter: &StateSpace<telepulse_lti::Continuous>,
) -> Result<BiasPoint> {
    let open = one.controller.series(&local.fit.transfer_function.to_state_space())?.series(filter)?;
    let unity = StateSpace::from_gain(nalgebra::DMatrix::identity(1, 1))?;
    let stable = open.feedback(&unity)?.is_stable()?;
    let margins = LoopMargins::of_state_space(&open)?;
    // For a loop that has become unstable the question is by how much its gain would have to fall.
    let margin = if stable { margins.upper_gain_margin() } else { margins.lower_gain_margin() };
    Ok(BiasPoint {
        bias: local.bias,
        controller: one.controller_name.clone(),
        dc_gain_mm_per_unit: local.fit.dc_gain_mm_per_unit,
        omega_n_rad_s: local.fit.omega_n_rad_s,
        gain_margin: margin.map(|m| m.factor),
        stable,
    })
}
