//! `telepulse study run DIR` and `telepulse study new DIR`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::{Args, Subcommand};

use super::identify::read_sweep;
use super::{Verdict, answer};
use crate::artefact;
use crate::recording;
use crate::study::{self, config::Study};

/// The study that runs when nothing is asked for.
const DEFAULT_STUDY: &str = "studies/diaphragm-2017";

macro_rules! of_default_study {
    ($name:literal) => {
        ($name, include_str!(concat!("../../../../studies/diaphragm-2017/", $name)))
    };
}

/// What `study new` writes: the default study.
const TEMPLATE: [(&str, &str); 10] = [
    of_default_study!("study.toml"),
    of_default_study!("or_abp_40s.csv"),
    of_default_study!("ATTRIBUTION.md"),
    of_default_study!("pulses/or_patA_abp.csv"),
    of_default_study!("pulses/mimic037_abp.csv"),
    of_default_study!("pulses/mimic2_s00001_abp.csv"),
    of_default_study!("pulses/finger_aac27_22.csv"),
    of_default_study!("pulses/finger_aac276_4.csv"),
    of_default_study!("pulses/finger_aac409_0.csv"),
    of_default_study!("pulses/finger_aac3_3.csv"),
];

#[derive(Debug, Args)]
pub(super) struct StudyArguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Run a study and write its report.
    Run {
        /// Folder of the study, or its study.toml.
        study: PathBuf,
        /// Folder for the results; `out` unless given. The study's name is added to it.
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
    },
    /// Start a study of your own: a copy of the default one.
    New {
        /// Folder to make; it must not exist or be empty.
        folder: PathBuf,
    },
}

pub(super) fn run(typed: StudyArguments, json: bool) -> Result<Verdict> {
    match typed.action {
        Action::Run { study, out } => run_study(&study, out, json),
        Action::New { folder } => new_study(&folder, json),
    }
}

pub(super) fn run_default(out: Option<PathBuf>, json: bool) -> Result<Verdict> {
    let folder = Path::new(DEFAULT_STUDY);
    ensure!(
        folder.is_dir(),
        "there is no {DEFAULT_STUDY} here: run from the folder that holds it, name a study (`telepulse study run DIR`), \
         or start one (`telepulse study new DIR`)"
    );
    run_study(folder, out, json)
}

fn run_study(path: &Path, out: Option<PathBuf>, json: bool) -> Result<Verdict> {
    let study = Study::load(path)?;
    // What the study names must be there before any work is done.
    recording::read(&study.path(&study.pulse.recording)).with_context(|| study.at_key("pulse.recording"))?;
    if let Some(sweep) = study.own_sweep() {
        read_sweep(&sweep).with_context(|| study.at_key("identify.sweep_csv"))?;
    }
    let folder = out.unwrap_or_else(|| PathBuf::from("out")).join(&study.name);
    let done = study::run::run(&study, &folder)
        .with_context(|| format!("while running {}", study.file.display()))?;
    answer(json, &done.outcome, || done.summary_lines())?;
    Ok(if done.passed() { Verdict::Done } else { Verdict::CheckFailed })
}

fn new_study(folder: &Path, json: bool) -> Result<Verdict> {
    let empty =
        !folder.exists() || std::fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_none());
    ensure!(empty, "{} exists and is not an empty folder: it is left alone", folder.display());
    for (name, content) in TEMPLATE {
        artefact::write_file(&folder.join(name), content.as_bytes())
            .with_context(|| format!("while starting a study in {}", folder.display()))?;
    }
    let files: Vec<String> =
        TEMPLATE.iter().map(|(name, _)| folder.join(name).display().to_string()).collect();
    answer(json, &serde_json::json!({ "files": files }), || {
        let mut lines = files.clone();
        lines.push(format!("next: telepulse study run {}", folder.display()));
        lines
    })?;
    Ok(Verdict::Done)
}
