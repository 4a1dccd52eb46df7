//! `telepulse report DIR`: the page and the drawings anew, from `report.json` and `figures.json`.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;

use super::{Verdict, answer};
use crate::report;

#[derive(Debug, Args)]
pub(super) struct ReportArguments {
    /// Results folder of a study, with its report.json and figures.json.
    folder: PathBuf,
    /// Folder for the page and the drawings; the results folder unless given.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

pub(super) fn run(typed: &ReportArguments, json: bool) -> Result<Verdict> {
    let (outcome, figures) = report::read(&typed.folder)?;
    let target = typed.out.as_deref().unwrap_or(&typed.folder);
    let files: Vec<String> =
        report::write(target, &outcome, &figures)?.iter().map(|path| path.display().to_string()).collect();
    answer(json, &serde_json::json!({ "files": files }), || files.clone())?;
    Ok(Verdict::Done)
}
