//! Pulse recordings as files.

use std::fs::File;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use telepulse_pulse::formats::csv;
use telepulse_pulse::{PulseRecording, Unit};

use crate::artefact;

/// Reads a recording from a CSV file with the columns `time_s,value,unit`.
///
/// # Errors
/// Names the file, and the line and column at fault.
pub fn read(path: &Path) -> Result<PulseRecording> {
    let file = File::open(path).with_context(|| format!("cannot read {}", path.display()))?;
    let mut recording = csv::read(file).with_context(|| format!("in {}", path.display()))?;
    recording.title = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    recording.provenance.sha256 = Some(artefact::sha256_of(path)?);
    Ok(recording)
}

/// Writes a recording as CSV, whole or not at all.
///
/// # Errors
/// Names the file.
pub fn write(path: &Path, recording: &PulseRecording) -> Result<()> {
    let mut content = Vec::new();
    csv::write(recording, &mut content).with_context(|| format!("cannot write {}", path.display()))?;
    artefact::write_file(path, &content)
}

/// Units without an absolute size, in which pulse sensors deliver; any of them may be scaled to a pressure.
const UNSCALED: [&str; 8] = ["mmHg", "au", "a.u.", "AU", "NU", "adu", "mV", "counts"];

/// The pulse in Pa: as it is if it is in Pa, else scaled to a peak-to-peak pressure.
///
/// # Errors
/// Where the recording does not move, or its unit is that of something else than a pulse: a length, say, would be scaled to a
/// motion that nobody asked for.
pub fn as_pressure(recording: &PulseRecording, peak_to_peak_pa: f64) -> Result<PulseRecording> {
    if *recording.unit() == Unit::Pascal {
        return Ok(recording.clone());
    }
    let unit = recording.unit().symbol();
    ensure!(
        UNSCALED.contains(&unit),
        "column `unit`: found `{unit}`, allowed is `Pa`, or one that is scaled to the study's pulse: {}",
        UNSCALED.join(", ")
    );
    Ok(recording.scaled_to_peak_to_peak(peak_to_peak_pa, Unit::Pascal)?)
}
