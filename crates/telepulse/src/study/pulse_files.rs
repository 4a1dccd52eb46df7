//! How well the best controller follows recorded pulses, by how far ahead it knows them.

use std::collections::BTreeMap;

use anyhow::{Context, Result};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use telepulse_actuator::twin::TwinModel;
use telepulse_design::identify::GreyBoxModel;
use telepulse_design::implement::ControllerRecipe;

use super::config::Study;
use super::recipes;
use crate::recording;
use crate::station::replay::{follow, pulse_reference};

/// Lag and error of one recording at one horizon.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct PulseFile {
    /// Delay of the plate against the pulse, on top of the play-out delay; absent where unstable.
    pub lag_ms: Option<f64>,
    /// Error over the peak-to-peak value.
    pub nrmse: Option<f64>,
    /// The same with the lag taken out.
    pub nrmse_aligned: Option<f64>,
    /// Why the run counts as unstable, if it does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unstable_reason: Option<String>,
}

/// By file stem, then by horizon in whole milliseconds.
pub type PulseFiles = BTreeMap<String, BTreeMap<String, PulseFile>>;

/// Follows every recording of `pulse.files` at every horizon of `pulse.horizons_s`, on both cores; `done` is called after each.
///
/// The recording is scaled to the study's peak-to-peak pressure, and the feedback is the same at every horizon: only the feedforward is
/// made for it.
///
/// # Errors
/// Where a recording cannot be read or a rig cannot run.
pub fn follow_all(
    study: &Study,
    twin: &TwinModel,
    best: &ControllerRecipe,
    motion: &GreyBoxModel,
    done: &(dyn Fn() + Sync),
) -> Result<PulseFiles> {
    let horizons = &study.pulse.horizons_s;
    let recipes = horizons
        .iter()
        .map(|horizon_s| recipes::at_horizon(best, motion, *horizon_s))
        .collect::<Result<Vec<ControllerRecipe>>>()?;
    let references = study
        .pulse
        .files
        .iter()
        .map(|file| {
            let path = study.path(file);
            let recording = recording::read(&path)?;
            let pressure = recording::as_pressure(&recording, study.pulse.peak_to_peak_pa)
                .with_context(|| format!("in {}", path.display()))?;
            Ok((
                recording.title,
                pulse_reference(study, &pressure).with_context(|| path.display().to_string())?,
            ))
        })
        .collect::<Result<Vec<(String, Vec<f64>)>>>()?;
    let jobs: Vec<_> =
        references.iter().flat_map(|r| horizons.iter().zip(&recipes).map(move |h| (r, h))).collect();
    let results = jobs
        .par_iter()
        .map(|((title, reference), (horizon_s, recipe))| {
            let followed = follow(study, twin, recipe, title, reference.clone())
                .with_context(|| format!("following {title} {horizon_s} s ahead"))?;
            done();
            let result = followed.result;
            let found = PulseFile {
                lag_ms: result.lag_ms,
                nrmse: result.nrmse,
                nrmse_aligned: result.nrmse_aligned,
                unstable_reason: result.unstable_reason,
            };
            Ok((title.clone(), horizon_key(**horizon_s), found))
        })
        .collect::<Result<Vec<_>>>()?;
    let mut files = PulseFiles::new();
    for (title, horizon, found) in results {
        files.entry(title).or_default().insert(horizon, found);
    }
    Ok(files)
}

fn horizon_key(horizon_s: f64) -> String {
    format!("{:.0}", 1e3 * horizon_s)
}
