//! The report: made from `report.json` and `figures.json` alone.

pub mod figures;
pub mod page;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};

use crate::artefact;
use crate::figure::{Figure, svg};
use crate::study::outcome::Outcome;

/// Version of `report.json` and `figures.json`.
pub const VERSION: u32 = 1;

/// Writes `report.html` and `figures/*.svg` into `folder`; returns the files.
///
/// # Errors
/// Names the file that cannot be written.
pub fn write(folder: &Path, outcome: &Outcome, figures: &[Figure]) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for figure in figures {
        let path = folder.join("figures").join(format!("{}.svg", figure.id()));
        artefact::write_file(&path, svg::render(figure).as_bytes())?;
        files.push(path);
    }
    let path = folder.join("report.html");
    artefact::write_file(&path, page::render(outcome, figures).as_bytes())?;
    files.push(path);
    Ok(files)
}

/// Writes the numbers and the figures' descriptions, from which [`read`] makes the report anew.
///
/// # Errors
/// Names the file that cannot be written.
pub fn write_data(folder: &Path, outcome: &Outcome, figures: &[Figure]) -> Result<()> {
    artefact::write_file(&folder.join("report.json"), &serde_json::to_vec_pretty(outcome)?)?;
    artefact::write_file(&folder.join("figures.json"), &serde_json::to_vec(figures)?)
}

/// Reads what [`write_data`] wrote.
///
/// # Errors
/// Names the file that is missing or is not what it should be.
pub fn read(folder: &Path) -> Result<(Outcome, Vec<Figure>)> {
    let numbers = folder.join("report.json");
    let outcome: Outcome = serde_json::from_str(&artefact::read_text(&numbers)?)
        .with_context(|| format!("{} is not the report of a study", numbers.display()))?;
    ensure!(
        outcome.version == VERSION,
        "{}: key `version`: found {}, allowed {VERSION}",
        numbers.display(),
        outcome.version
    );
    let drawings = folder.join("figures.json");
    let figures = serde_json::from_str(&artefact::read_text(&drawings)?)
        .with_context(|| format!("{} does not describe figures", drawings.display()))?;
    Ok((outcome, figures))
}
