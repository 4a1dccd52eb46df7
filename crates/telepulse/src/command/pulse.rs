//! `telepulse pulse info FILE` and `telepulse pulse analyze FILE`.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::{Args, Subcommand};
use serde::Serialize;
use telepulse_pulse::beats;
use telepulse_pulse::spectrum::{Spectrum, Window};

use super::{Verdict, answer};
use crate::recording;

#[derive(Debug, Args)]
pub(super) struct PulseArguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// What a recording holds: unit, rate, duration, range.
    Info {
        /// CSV with the columns time_s,value,unit.
        file: PathBuf,
    },
    /// Beats, heart rate and spectral peaks of a recording.
    Analyze {
        /// CSV with the columns time_s,value,unit.
        file: PathBuf,
    },
}

#[derive(Debug, Serialize)]
struct Info {
    file: String,
    unit: String,
    sample_rate_hz: f64,
    samples: usize,
    duration_s: f64,
    minimum: f64,
    maximum: f64,
    mean: f64,
    sha256: Option<String>,
}

#[derive(Debug, Serialize)]
struct Analysis {
    file: String,
    unit: String,
    sample_rate_hz: f64,
    duration_s: f64,
    beats_s: Vec<f64>,
    feet_s: Vec<f64>,
    heart_rate_bpm: f64,
    spectral_peaks_hz: Vec<f64>,
}

pub(super) fn run(typed: &PulseArguments, json: bool) -> Result<Verdict> {
    match &typed.action {
        Action::Info { file } => {
            let found = recording::read(file)?;
            let fold =
                |start: f64, pick: fn(f64, f64) -> f64| found.values().iter().copied().fold(start, pick);
            let info = Info {
                file: file.display().to_string(),
                unit: found.unit().symbol().to_owned(),
                sample_rate_hz: found.sample_rate_hz(),
                samples: found.n_samples(),
                duration_s: found.duration_s(),
                minimum: fold(f64::INFINITY, f64::min),
                maximum: fold(f64::NEG_INFINITY, f64::max),
                mean: found.mean(),
                sha256: found.provenance.sha256.clone(),
            };
            answer(json, &info, || {
                vec![
                    format!(
                        "{}: {} samples at {} Hz, {:.2} s",
                        info.file, info.samples, info.sample_rate_hz, info.duration_s
                    ),
                    format!(
                        "from {} to {} {}, mean {:.3} {}",
                        info.minimum, info.maximum, info.unit, info.mean, info.unit
                    ),
                ]
            })?;
        }
        Action::Analyze { file } => {
            let found = recording::read(file)?;
            let rate_hz = found.sample_rate_hz();
            let beats = beats::detect(&found).with_context(|| format!("in {}", file.display()))?;
            let spectrum = Spectrum::of(found.values(), rate_hz, Window::Hann)?;
            let strongest = spectrum.amplitudes().iter().copied().fold(0.0, f64::max);
            let analysis = Analysis {
                file: file.display().to_string(),
                unit: found.unit().symbol().to_owned(),
                sample_rate_hz: rate_hz,
                duration_s: found.duration_s(),
                beats_s: beats.beats.iter().map(|beat| beat.peak_s).collect(),
                feet_s: beats.beats.iter().map(|beat| beat.foot_s).collect(),
                heart_rate_bpm: beats.heart_rate_bpm,
                spectral_peaks_hz: spectrum
                    .peaks(0.1 * strongest)
                    .iter()
                    .map(|peak| peak.frequency_hz)
                    .collect(),
            };
            answer(json, &analysis, || {
                let peaks: Vec<String> =
                    analysis.spectral_peaks_hz.iter().map(|hz| format!("{hz:.3}")).collect();
                vec![
                    format!(
                        "{}: {} beats, {:.1} per minute",
                        analysis.file,
                        analysis.beats_s.len(),
                        analysis.heart_rate_bpm
                    ),
                    format!("spectral peaks at {} Hz", peaks.join(", ")),
                ]
            })?;
        }
    }
    Ok(Verdict::Done)
}
