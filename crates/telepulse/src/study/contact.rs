//! Force mode on recorded pulses, on contacts softer and stiffer than assumed.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use telepulse_actuator::twin::TwinModel;
use telepulse_design::implement::{ControllerRecipe, Feedforward};
use telepulse_pulse::{PulseRecording, Unit};

use super::config::Study;
use crate::recording;
use crate::station::device::STIFFNESS_FACTORS;
use crate::station::replay::replay_held;

/// Play-out delays at which the table is made, ms; the first one is what the headline figures are for.
pub const HORIZONS_MS: [u32; 5] = [250, 100, 40, 20, 0];

/// Lag and error of one replay.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Fidelity {
    /// Delay against the held-back pulse, positive behind.
    pub lag_ms: f64,
    /// RMS error over the pulse's peak-to-peak.
    pub nrmse: f64,
}

/// Force mode on one recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PulseForce {
    /// Lag of the largest size over the contact stiffnesses, at the first play-out delay.
    pub lag_ms: f64,
    /// Largest error over the contact stiffnesses, at the first play-out delay.
    pub nrmse: f64,
    /// At the first play-out delay by contact stiffness, as a factor of the assumed one.
    pub by_stiffness: BTreeMap<String, Fidelity>,
    /// Worst over the contact stiffnesses by play-out delay in ms.
    pub by_horizon_ms: BTreeMap<u32, Fidelity>,
    /// Worst of the printed K over the contact stiffnesses, where it ran; it knows no preview.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub printed_k: Option<Fidelity>,
}

/// Replays every recording in force mode with `best`, on every contact stiffness and at every play-out delay of `horizons_ms`, and with `printed_k` if
/// it is given.
///
/// Recordings are scaled to the study's peak-to-peak pressure. The result is by file stem; its headline is of the first delay.
///
/// # Errors
/// Where a recording cannot be read, two have one stem, or a run becomes unstable.
pub fn pulse_force(
    study: &Study,
    twin: &TwinModel,
    best: &ControllerRecipe,
    printed_k: Option<&ControllerRecipe>,
    files: &[PathBuf],
    horizons_ms: &[u32],
) -> Result<BTreeMap<String, PulseForce>> {
    let mut found = BTreeMap::new();
    for file in files {
        let stem = file.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        let pulse = read(study, file)?;
        let one = one_recording(study, twin, best, printed_k, &pulse, horizons_ms)
            .with_context(|| format!("replaying {} in force mode", file.display()))?;
        ensure!(found.insert(stem, one).is_none(), "{} has the name of another recording", file.display());
    }
    Ok(found)
}

/// A recording, scaled to the study's peak-to-peak pressure.
fn read(study: &Study, file: &Path) -> Result<PulseRecording> {
    recording::read(file)?
        .scaled_to_peak_to_peak(study.pulse.peak_to_peak_pa, Unit::Pascal)
        .with_context(|| format!("in {}", file.display()))
}

fn one_recording(
    study: &Study,
    twin: &TwinModel,
    best: &ControllerRecipe,
    printed_k: Option<&ControllerRecipe>,
    pulse: &PulseRecording,
    horizons_ms: &[u32],
) -> Result<PulseForce> {
    let by_horizon = horizons_ms
        .iter()
        .map(|ms| Ok((*ms, at_horizon(best, f64::from(*ms) * 1e-3)?)))
        .collect::<Result<Vec<(u32, ControllerRecipe)>>>()?;
    let mut jobs: Vec<(Option<u32>, &ControllerRecipe, f64)> = Vec::new();
    for factor in STIFFNESS_FACTORS {
        jobs.extend(by_horizon.iter().map(|(ms, recipe)| (Some(*ms), recipe, factor)));
        jobs.extend(printed_k.map(|recipe| (None, recipe, factor)));
    }
    let runs = jobs
        .par_iter()
        .map(|(ms, recipe, factor)| {
            let name = if ms.is_some() { "best" } else { "printed_k" };
            let result = replay_held(study, twin, name, recipe, pulse, *factor)?.result;
            let reason = result.unstable_reason.unwrap_or_default();
            let figures = result.lag_ms.zip(result.nrmse);
            let (lag_ms, nrmse) =
                figures.with_context(|| format!("{name}, stiffness x {factor}: {reason}"))?;
            Ok((*ms, *factor, Fidelity { lag_ms, nrmse }))
        })
        .collect::<Result<Vec<(Option<u32>, f64, Fidelity)>>>()?;
    let worst_at = |ms: Option<u32>| worst(runs.iter().filter(|run| run.0 == ms).map(|run| run.2));
    let first = horizons_ms.first().copied();
    let headline = worst_at(first);
    Ok(PulseForce {
        lag_ms: headline.lag_ms,
        nrmse: headline.nrmse,
        by_stiffness: runs
            .iter()
            .filter(|run| run.0 == first)
            .map(|run| (run.1.to_string(), run.2))
            .collect(),
        by_horizon_ms: horizons_ms.iter().map(|ms| (*ms, worst_at(Some(*ms)))).collect(),
        printed_k: printed_k.map(|_| worst_at(None)),
    })
}

/// The recipe for a reference that is known so far ahead.
fn at_horizon(recipe: &ControllerRecipe, horizon_s: f64) -> Result<ControllerRecipe> {
    let Some(Feedforward::Held(held)) = &recipe.settings().feedforward else {
        anyhow::bail!("the recipe has no feedforward of a held plate");
    };
    let horizon_s = horizon_s.min(super::recipes::HORIZON_MAX_S);
    Ok(recipe.with_feedforward(Some(Feedforward::Held(Box::new(held.with_horizon(horizon_s)?))))?)
}

/// The lag of the largest size and the largest error, which need not be of one run.
fn worst(runs: impl Iterator<Item = Fidelity>) -> Fidelity {
    runs.fold(Fidelity { lag_ms: 0.0, nrmse: 0.0 }, |worst, run| Fidelity {
        lag_ms: if run.lag_ms.abs() > worst.lag_ms.abs() { run.lag_ms } else { worst.lag_ms },
        nrmse: worst.nrmse.max(run.nrmse),
    })
}
