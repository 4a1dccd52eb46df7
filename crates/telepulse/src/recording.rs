//! Pulse recordings as files.

use std::fs::File;
use std::path::Path;

use anyhow::{Context, Result};
use telepulse_pulse::PulseRecording;
use telepulse_pulse::formats::csv;

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
