//! `telepulse replay RECIPE RECORDING`: a pulse on the virtual rig, without a link.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;

use super::{Verdict, answer};
use crate::artefact;
use crate::recording;
use crate::station::device;
use crate::station::replay::{Mode, Replayed, read_recipe, replay};
use crate::study::config::Study;

#[derive(Debug, Args)]
pub(super) struct ReplayArguments {
    /// Recipe of the controller.
    recipe: PathBuf,
    /// Recording to replay: CSV with time_s,value,unit. One in Pa is taken as it is, any other is scaled to the study's
    /// peak-to-peak pressure.
    recording: PathBuf,
    /// What follows the pulse.
    #[arg(long, value_enum, default_value_t = Mode::Displacement)]
    mode: Mode,
    /// Study whose rig is used.
    #[arg(long, value_name = "DIR", default_value = "studies/diaphragm-2017")]
    study: PathBuf,
    /// File for the run, thinned: JSON.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

pub(super) fn run(typed: &ReplayArguments, json: bool) -> Result<Verdict> {
    let study = Study::load(&typed.study)?;
    let recipe = read_recipe(&typed.recipe)?;
    let pulse = recording::as_pressure(&recording::read(&typed.recording)?, study.pulse.peak_to_peak_pa)
        .with_context(|| format!("in {}", typed.recording.display()))?;
    let twin = device::twin(&study)?;
    let name = typed.recipe.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let name = name.split('.').next().unwrap_or_default();
    let replayed = replay(&study, &twin, name, &recipe, &pulse, typed.mode).with_context(|| {
        format!(
            "replaying {} with {} and {}",
            typed.recording.display(),
            typed.recipe.display(),
            study.file.display()
        )
    })?;
    if let Some(path) = &typed.out {
        artefact::write_file(path, &serde_json::to_vec(&replayed)?)?;
    }
    answer(json, &replayed.result, || vec![line(&replayed)])?;
    Ok(if replayed.result.unstable { Verdict::CheckFailed } else { Verdict::Done })
}

/// A replay in one line.
pub(super) fn line(replayed: &Replayed) -> String {
    let result = &replayed.result;
    match (result.lag_ms, result.nrmse, result.nrmse_aligned) {
        (Some(lag_ms), Some(nrmse), Some(aligned)) => format!(
            "{}, {}: lag {lag_ms:.3} ms, NRMSE {:.3} %, after delay removal {:.3} %",
            replayed.controller,
            replayed.mode.word(),
            100.0 * nrmse,
            100.0 * aligned
        ),
        _ => format!(
            "{}, {}: UNSTABLE, {}",
            replayed.controller,
            replayed.mode.word(),
            result.unstable_reason.clone().unwrap_or_default()
        ),
    }
}
