//! `telepulse verify`: does a controller hold for every plant inside the bound?

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};

use super::{Verdict, answer};
use crate::artefact;
use crate::station::device;
use crate::study::amend::amend;
use crate::study::campaign::{Campaign, SAMPLES_MAX, campaign, replay};
use crate::study::config::{Polynomials, Study};
use crate::study::controllers::certify;
use crate::study::outcome::{CertificateSummary, Tracking};
use crate::study::{models, recipes};

#[derive(Debug, Args)]
pub(super) struct VerifyArguments {
    /// Controller as JSON with `numerator` and `denominator` (unit per mm, descending powers); without it, the printed one
    /// of the study.
    controller: Option<PathBuf>,
    /// Model as written by `telepulse identify`; without it, the `[plant]` of the study.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Study whose filter is in the loop.
    #[arg(long, value_name = "DIR", default_value = "studies/diaphragm-2017")]
    study: PathBuf,
    /// Track with the study's controllers on this many devices that differ from the identified one, in place of a certificate.
    #[arg(long, value_name = "N", conflicts_with_all = ["controller", "model"])]
    samples: Option<usize>,
    /// Seed of the devices.
    #[arg(long, value_name = "SEED", default_value_t = 1, requires = "samples")]
    seed: u64,
    /// Run only this device of the campaign, and print every figure of it.
    #[arg(long, value_name = "IDX", requires = "samples")]
    only: Option<u64>,
    /// Folder for the campaign's report.json; `out` unless given. The study's name is added to it.
    #[arg(long, value_name = "DIR", requires = "samples")]
    out: Option<PathBuf>,
}

/// The controllers that a campaign compares.
const COMPARED: [&str; 3] = ["best", "printed_k", "pid_auto"];

pub(super) fn run(typed: &VerifyArguments, json: bool) -> Result<Verdict> {
    let study = Study::load(&typed.study)?;
    if let Some(samples) = typed.samples {
        return run_campaign(&study, samples, typed, json);
    }
    let model = super::design::model(&study, typed.model.as_ref())?;
    let controller = match &typed.controller {
        Some(path) => {
            let typed: Polynomials = serde_json::from_str(&artefact::read_text(path)?)
                .with_context(|| format!("in {}", path.display()))?;
            typed.to_transfer_function("controller").with_context(|| format!("in {}", path.display()))?
        }
        None => study.printed.controller.to_transfer_function("printed.controller")?,
    };
    let plant = typed.model.as_ref().unwrap_or(&study.file);
    let summary = certify(&study, &model, &controller.to_state_space())
        .with_context(|| format!("in {}", plant.display()))?
        .summary();
    answer(json, &summary, || vec![line(&summary)])?;
    Ok(if summary.holds { Verdict::Done } else { Verdict::CheckFailed })
}

fn run_campaign(study: &Study, samples: usize, typed: &VerifyArguments, json: bool) -> Result<Verdict> {
    ensure!((1..=SAMPLES_MAX).contains(&samples), "--samples: found {samples}, allowed 1 to {SAMPLES_MAX}");
    let twin = device::twin(study)?;
    let models = models::measure(study, &twin, &|| {})?;
    let recipes: Vec<_> = recipes::build(study, &models)?
        .displacement
        .into_iter()
        .filter(|(name, _)| COMPARED.contains(&name.as_str()))
        .collect();
    if let Some(idx) = typed.only {
        let runs = replay(study, &recipes, typed.seed, idx)?;
        answer(json, &runs, || {
            let line = |(name, run): (&String, &Tracking)| match run.mean_abs_error_mm {
                Some(error) => format!("{name}: mean error {error:.6} mm"),
                None => format!("{name}: UNSTABLE, {}", run.unstable_reason.clone().unwrap_or_default()),
            };
            runs.iter().map(line).collect()
        })?;
        return Ok(if runs["best"].unstable { Verdict::CheckFailed } else { Verdict::Done });
    }
    let style = ProgressStyle::with_template("{bar:32} {pos:>6}/{len} devices [{elapsed} of {duration}]")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    let bar = ProgressBar::new(samples as u64).with_style(style);
    let found = campaign(study, &recipes, samples, typed.seed, &|| bar.inc(1))?;
    bar.finish_and_clear();
    let folder = typed.out.clone().unwrap_or_else(|| PathBuf::from("out")).join(&study.name);
    let report = amend(&folder, "campaign", &found)?;
    answer(json, &found, || {
        let mm = |value: Option<f64>| value.map_or_else(|| "none".to_owned(), |v| format!("{v:.6} mm"));
        let line = |(name, c): (&String, &Campaign)| {
            format!(
                "{name}: {} of {} unstable, {} voltage and {} field violations; mean error worst {}, median {}, as identified {}",
                c.unstable,
                c.samples,
                c.voltage_violations,
                c.field_violations,
                mm(c.worst_mean_abs_error_mm),
                mm(c.median_mean_abs_error_mm),
                mm(c.nominal_mean_abs_error_mm)
            )
        };
        let mut lines: Vec<String> = found.iter().map(line).collect();
        lines.push(format!("numbers {}", report.display()));
        lines
    })?;
    let best = &found["best"];
    let clean = best.unstable + best.voltage_violations + best.field_violations == 0;
    Ok(if clean { Verdict::Done } else { Verdict::CheckFailed })
}

/// A certificate in one line.
pub(super) fn line(c: &CertificateSummary) -> String {
    if !c.holds {
        return format!("UNCERTIFIED: {}", c.reason.clone().unwrap_or_default());
    }
    let number = |value: Option<f64>| value.map_or_else(|| "unknown".to_owned(), |v| format!("{v:.4}"));
    let margin = |value: Option<f64>, unit: &str| {
        value.map_or_else(|| "infinite".to_owned(), |v| format!("{v:.3}{unit}"))
    };
    format!(
        "certified: norm product {}, max |Ws K S| {}, gain margin {}, phase margin {}",
        number(c.norm_product),
        number(c.frequency_wise),
        margin(c.gain_margin, ""),
        margin(c.phase_margin_deg, " deg")
    )
}
