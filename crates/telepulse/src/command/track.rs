//! `telepulse track RECIPE --reference FILE.csv`: a reference of your own on the virtual rig.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use clap::Args;
use serde::Serialize;
use telepulse_actuator::twin::Fidelity;
use telepulse_pulse::{PulseRecording, Unit};

use super::{Verdict, answer};
use crate::artefact;
use crate::recording;
use crate::station::device;
use crate::station::replay::{Followed, MAX_MM, follow, pulse_reference, read_recipe};
use crate::study::config::{SensorChoice, Study};

#[derive(Debug, Args)]
pub(super) struct TrackArguments {
    /// Recipe of the controller.
    recipe: PathBuf,
    /// Reference: CSV with time_s,value,unit. In mm it is the displacement from rest; any other unit is a pulse, which is
    /// scaled to the study's peak-to-peak pressure unless it is in Pa.
    #[arg(long, value_name = "CSV")]
    reference: PathBuf,
    /// Study whose rig is used.
    #[arg(long, value_name = "DIR", default_value = "studies/diaphragm-2017")]
    study: PathBuf,
    /// File for the run, thinned: JSON.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// What came of it.
#[derive(Debug, Serialize)]
struct Answer {
    #[serde(flatten)]
    pulse: crate::study::outcome::PulseReplay,
    #[serde(skip_serializing_if = "Option::is_none")]
    mean_abs_error_mm: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    max_abs_error_mm: Option<f64>,
    /// Which model of the device moved.
    fidelity: Fidelity,
    /// What read the plate.
    sensor: SensorChoice,
    /// Largest difference between a reading of self-sensing and the true mean over its window.
    #[serde(skip_serializing_if = "Option::is_none")]
    sensing_error_max_mm: Option<f64>,
    /// Largest standard deviation stated with such a reading.
    #[serde(skip_serializing_if = "Option::is_none")]
    sensing_standard_deviation_max_mm: Option<f64>,
}

pub(super) fn run(typed: &TrackArguments, json: bool) -> Result<Verdict> {
    let study = Study::load(&typed.study)?;
    let recipe = read_recipe(&typed.recipe)?;
    let reference = recording::read(&typed.reference)?;
    let reference_mm =
        in_mm(&study, &reference).with_context(|| format!("in {}", typed.reference.display()))?;
    let twin = device::twin(&study)?;
    let Followed { result, trace, mean_abs_error_mm, max_abs_error_mm, sensing } =
        follow(&study, &twin, &recipe, &reference.title, reference_mm).with_context(|| {
            format!(
                "following {} with {} and {}",
                typed.reference.display(),
                typed.recipe.display(),
                study.file.display()
            )
        })?;
    if let Some(path) = &typed.out {
        artefact::write_file(path, &serde_json::to_vec(&trace)?)?;
    }
    let unstable = result.unstable;
    let answered = Answer {
        pulse: result,
        mean_abs_error_mm,
        max_abs_error_mm,
        fidelity: study.actuator.fidelity,
        sensor: study.actuator.sensor,
        sensing_error_max_mm: sensing.map(|sensing| sensing.error_max_mm),
        sensing_standard_deviation_max_mm: sensing.map(|sensing| sensing.standard_deviation_max_mm),
    };
    answer(json, &answered, || {
        vec![
            match (answered.pulse.lag_ms, answered.pulse.nrmse, answered.mean_abs_error_mm) {
                (Some(lag), Some(nrmse), Some(mm)) => {
                    format!("lag {lag:.3} ms, NRMSE {:.3} %, mean error {mm:.5} mm", 100.0 * nrmse)
                }
                _ => format!("UNSTABLE: {}", answered.pulse.unstable_reason.clone().unwrap_or_default()),
            },
            answered.pulse.provenance.clone(),
        ]
    })?;
    Ok(if unstable { Verdict::CheckFailed } else { Verdict::Done })
}

/// The reference in mm from rest at the control rate.
fn in_mm(study: &Study, reference: &PulseRecording) -> Result<Vec<f64>> {
    Ok(match reference.unit() {
        Unit::Millimetre => {
            let outside = reference.values().iter().copied().find(|x| !(0.0..=MAX_MM).contains(x));
            if let Some(found) = outside {
                bail!("column `value`: found {found} mm, allowed 0 to {MAX_MM} mm from rest");
            }
            telepulse_pulse::resample::resample(reference, study.control.sample_rate_hz)?.values().to_vec()
        }
        _ => pulse_reference(study, &recording::as_pressure(reference, study.pulse.peak_to_peak_pa)?)?,
    })
}
