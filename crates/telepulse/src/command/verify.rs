//! `telepulse verify`: does a controller hold for every plant inside the bound?

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;

use super::{Verdict, answer};
use crate::artefact;
use crate::study::config::{Polynomials, Study};
use crate::study::controllers::certify;
use crate::study::outcome::CertificateSummary;

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
}

pub(super) fn run(typed: &VerifyArguments, json: bool) -> Result<Verdict> {
    let study = Study::load(&typed.study)?;
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
