//! The experiments of the paper on the virtual rig: step, and tracking of the multi-sine.

use anyhow::Result;
use rayon::prelude::*;
use telepulse_actuator::ParameterSet;
use telepulse_actuator::rig::SensingRecord;
use telepulse_actuator::twin::TwinModel;
use telepulse_design::identify::Controlled;
use telepulse_design::implement::ControllerRecipe;
use telepulse_rt::{ControlLaw, InputLinearisation};

use super::config::Study;
use super::judge;
use super::outcome::Tracking;
use super::trace::Trace;
use crate::station::control;
use crate::station::device::{self, Conditions};
use crate::station::run::{ErrorWatch, RunPlan, run};

/// The four conditions of Table 1.
pub const CONDITIONS: [(&str, Conditions); 4] = [
    ("normal", Conditions { disturbance: false, noise: false, ideal_laser: true }),
    ("disturbance", Conditions { disturbance: true, noise: false, ideal_laser: true }),
    ("noise", Conditions { disturbance: false, noise: true, ideal_laser: true }),
    ("both", Conditions { disturbance: true, noise: true, ideal_laser: true }),
];

/// What the laser adds by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LaserNoise {
    /// Nothing: the only noise on the sensor is that of the condition, as Table 1 names it.
    OnlyTheCondition,
    /// The noise and the steps that the rig assumes.
    AsAssumed,
}

/// One run, judged.
#[derive(Debug, Clone)]
pub struct Tracked {
    /// Name of the controller.
    pub controller: String,
    /// Name of the condition.
    pub condition: &'static str,
    /// Its figures.
    pub result: Tracking,
    /// What a figure shows of it.
    pub trace: Trace,
    /// How far the readings of self-sensing were from the truth, where it was used.
    pub sensing: Option<SensingRecord>,
}

/// Runs every recipe in every condition of Table 1, on both cores; `done` is called after each run.
///
/// # Errors
/// Where a rig cannot run.
pub fn track_all(
    study: &Study,
    twin: &TwinModel,
    recipes: &[(String, ControllerRecipe)],
    laser: LaserNoise,
    done: &(dyn Fn() + Sync),
) -> Result<Vec<Tracked>> {
    let jobs: Vec<_> = recipes
        .iter()
        .flat_map(|(name, recipe)| CONDITIONS.map(|(condition, c)| (name, recipe, condition, c)))
        .collect();
    jobs.par_iter()
        .map(|(name, recipe, condition, conditions)| {
            let ideal_laser = laser == LaserNoise::OnlyTheCondition;
            let tracked =
                track_one(study, twin, name, recipe, condition, Conditions { ideal_laser, ..*conditions });
            done();
            tracked
        })
        .collect()
}

/// Runs one recipe in one condition over the study's reference.
///
/// # Errors
/// Where the rig cannot run.
pub fn track_one(
    study: &Study,
    twin: &TwinModel,
    name: &str,
    recipe: &ControllerRecipe,
    condition: &'static str,
    conditions: Conditions,
) -> Result<Tracked> {
    let rate_hz = study.control.sample_rate_hz;
    let settle = (study.reference.settle_s * rate_hz).round() as usize;
    let n_ticks = settle + (study.reference.window_s * rate_hz).round() as usize;
    let reference: Vec<f64> = (0..n_ticks).map(|k| study.reference.at(k as f64 / rate_hz)).collect();
    let plan = RunPlan {
        feedforward: control::feedforward(recipe, &reference),
        reference,
        watch: device::watch(study),
    };
    let mut rig = device::sensed(study, twin, conditions)?;
    let mut control =
        control::from_recipe(study, recipe, Controlled::Displacement, device::sensed_scale(study))?;
    let record = run(&mut rig, &mut control, &plan)?;
    let mut result = judge::tracking(&record, settle, &record.true_output, judge::DriveRange::of(study));
    result.provenance = device::provenance(study, recipe);
    let trace =
        Trace::thin(&record.reference, &record.true_output, &record.voltage_v, record.sample_time_s, settle);
    Ok(Tracked { controller: name.to_owned(), condition, result, trace, sensing: record.sensing })
}

/// A step of full scale from rest.
#[derive(Debug, Clone)]
pub struct Step {
    /// Time since the step.
    pub time_s: Vec<f64>,
    /// Displacement from rest.
    pub displacement_mm: Vec<f64>,
}

/// How long a step is watched.
pub const STEP_S: f64 = 10.0;

/// Steps a parameter set's rig to full scale.
///
/// # Errors
/// Where the twin cannot be built or the rig trips.
pub fn step(study: &Study, set: ParameterSet) -> Result<Step> {
    let twin = device::twin_of(set)?;
    let mut rig = device::displacement(study, &twin, Conditions::default())?;
    let scale = device::displacement_scale();
    let mut control = control::open_loop(study, scale, InputLinearisation::Identity, ControlLaw::OpenLoop)?;
    let n_ticks = (STEP_S * study.control.sample_rate_hz) as usize + 1;
    let plan =
        RunPlan { reference: vec![0.0; n_ticks], feedforward: vec![1.0; n_ticks], watch: ErrorWatch::OFF };
    let record = run(&mut rig, &mut control, &plan)?;
    anyhow::ensure!(record.trip.is_none(), "the step was ended: {}", record.trip.unwrap_or_default());
    let time_s = (0..record.len()).map(|k| k as f64 * record.sample_time_s).collect();
    Ok(Step { time_s, displacement_mm: record.true_output })
}
