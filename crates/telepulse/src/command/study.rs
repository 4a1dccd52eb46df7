//! `telepulse study run DIR` and `telepulse study new DIR`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::{Args, Subcommand};

use super::identify::read_sweep;
use super::{Verdict, answer};
use crate::artefact;
use crate::recording;
use crate::station::device;
use crate::study::ageing::{aged_twin, ageing};
use crate::study::amend::amend;
use crate::study::contact::{HORIZONS_MS, PulseForce, pulse_force};
use crate::study::controllers::Certified;
use crate::study::{self, config::Study, models, recipes};

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
    /// Replay recordings in force mode on contacts of three stiffnesses; adds `pulse_force` to the study's report.json.
    Contact {
        /// Folder of the study, or its study.toml.
        study: PathBuf,
        /// Recordings, CSV with time_s,value,unit; the study's own unless given.
        recordings: Vec<PathBuf>,
        /// Folder for the results; `out` unless given. The study's name is added to it.
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
    },
    /// Age the study's device by hours of creep and a drift of its modulus; adds `ageing` to the study's report.json.
    Age {
        /// Folder of the study, or its study.toml.
        study: PathBuf,
        /// Hours at a held voltage.
        #[arg(long, default_value_t = 10.0)]
        hours: f64,
        /// Relative drift of the network's modulus, taken both ways.
        #[arg(long, default_value_t = 0.3)]
        drift: f64,
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
        Action::Contact { study, recordings, out } => contact(&study, recordings, out, json),
        Action::Age { study, hours, drift, out } => age(&study, hours, drift, out, json),
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

fn contact(path: &Path, recordings: Vec<PathBuf>, out: Option<PathBuf>, json: bool) -> Result<Verdict> {
    let study = Study::load(path)?;
    let files = if recordings.is_empty() { study.recordings() } else { recordings };
    for file in &files {
        recording::read(file)?;
    }
    let folder = out.unwrap_or_else(|| PathBuf::from("out")).join(&study.name);
    let twin = device::twin(&study)?;
    let recipes = recipes::build(&study, &models::measure(&study, &twin, &|| {})?)?;
    let named = |name: &str| {
        let found = recipes.force.iter().find(|(controller, _)| controller == name);
        found.map(|(_, recipe)| recipe).with_context(|| format!("the study has no controller `{name}`"))
    };
    let found = pulse_force(&study, &twin, named("best")?, Some(named("printed_k")?), &files, &HORIZONS_MS)
        .with_context(|| format!("while running {}", study.file.display()))?;
    let certificate = recipes.certificates.get("best_force").map(Certified::summary);
    let certified = certificate.is_some_and(|c| c.holds);
    let report = amend(&folder, "pulse_force", &found)?;
    answer(json, &found, || {
        let line = |(stem, one): (&String, &PulseForce)| {
            format!(
                "{stem}: lag {:.3} ms, NRMSE {:.3} % (worst of stiffness x 0.5, 1, 1.5)",
                one.lag_ms,
                100.0 * one.nrmse
            )
        };
        let mut lines: Vec<String> = found.iter().map(line).collect();
        lines.push(format!("certified over the contact's stiffness: {certified}"));
        lines.push(format!("numbers in {}", report.display()));
        lines
    })?;
    Ok(if certified { Verdict::Done } else { Verdict::CheckFailed })
}

fn age(path: &Path, hours: f64, drift: f64, out: Option<PathBuf>, json: bool) -> Result<Verdict> {
    ensure!((0.0..=100.0).contains(&hours), "`--hours`: found {hours}, allowed are 0 to 100");
    ensure!((0.0..=0.5).contains(&drift), "`--drift`: found {drift}, allowed are 0 to 0.5");
    let study = Study::load(path)?;
    let folder = out.unwrap_or_else(|| PathBuf::from("out")).join(&study.name);
    let fresh = aged_twin(&study, 0.0)?;
    let models = models::measure(&study, &fresh, &|| {})?;
    let recipes = recipes::build(&study, &models)?;
    let best = recipes.displacement.iter().find(|(name, _)| name == "best");
    let (_, best) = best.context("the study has no controller `best`")?;
    let found = ageing(&study, &models, best, hours, drift)
        .with_context(|| format!("while running {}", study.file.display()))?;
    let report = amend(&folder, "ageing", &found)?;
    let shown = |error: Option<f64>| error.map_or("unstable".to_owned(), |mm| format!("{mm:.6} mm"));
    answer(json, &found, || {
        let mut lines = vec![format!(
            "fresh: {} (without adaptation {})",
            shown(found.mean_abs_error_fresh_mm),
            shown(found.mean_abs_error_fresh_without_adaptation_mm)
        )];
        lines.extend(found.cases.iter().map(|case| {
            format!(
                "modulus {:+} %, reference x {}: fresh {}, aged {} (without adaptation {}); gain {:.3}, stiffness {:.3}, at highest \
                 voltage {:.1} %",
                100.0 * case.drift,
                case.reference_scale,
                shown(case.mean_abs_error_fresh_mm),
                shown(case.mean_abs_error_mm),
                shown(case.mean_abs_error_without_adaptation_mm),
                case.adapted.gain,
                case.adapted.stiffness,
                100.0 * case.share_at_highest_voltage
            )
        }));
        lines.push(format!("numbers in {}", report.display()));
        lines
    })?;
    let stable = found.cases.iter().all(|case| case.mean_abs_error_mm.is_some());
    Ok(if stable { Verdict::Done } else { Verdict::CheckFailed })
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
