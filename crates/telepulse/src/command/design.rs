//! `telepulse design MODEL.json`: weights and a plant to a certified recipe.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use serde::Serialize;
use telepulse_design::identify::PlantModel;

use super::{Verdict, answer};
use crate::artefact;
use crate::study::config::Study;
use crate::study::controllers::{certify, synthesize};
use crate::study::models::given;
use crate::study::outcome::{CertificateSummary, Synthesis};
use crate::study::recipes::feedback_recipe;

#[derive(Debug, Args)]
pub(super) struct DesignArguments {
    /// Model as written by `telepulse identify`; without it, the `[plant]` of the study.
    model: Option<PathBuf>,
    /// Study whose weights, filter and limits are used.
    #[arg(long, value_name = "DIR", default_value = "studies/diaphragm-2017")]
    study: PathBuf,
    /// File for the recipe.
    #[arg(long, value_name = "FILE", default_value = "hinf.recipe.json")]
    out: PathBuf,
}

#[derive(Debug, Serialize)]
struct Answer {
    synthesis: Synthesis,
    certificate: CertificateSummary,
    recipe: String,
}

pub(super) fn run(typed: &DesignArguments, json: bool) -> Result<Verdict> {
    let study = Study::load(&typed.study)?;
    let model = model(&study, typed.model.as_ref())?;
    let plant = typed.model.as_ref().map_or("`plant`".to_owned(), |path| path.display().to_string());
    let design = synthesize(&study, &model.nominal)
        .with_context(|| format!("in {}: key `weights` with {plant}", study.file.display()))?;
    let certified = certify(&study, &model, &design.controller).with_context(|| format!("with {plant}"))?;
    let recipe = feedback_recipe(&study, &model, &design.controller, &certified)
        .with_context(|| format!("with {plant} and {}", study.file.display()))?;
    artefact::write_file(&typed.out, &serde_json::to_vec_pretty(&recipe)?)?;
    let answered = Answer {
        synthesis: design.summary,
        certificate: certified.summary(),
        recipe: typed.out.display().to_string(),
    };
    answer(json, &answered, || {
        let (s, c) = (&answered.synthesis, &answered.certificate);
        vec![
            format!(
                "gamma {:.6}, no controller below {:.6}; fastest pole {:.1} rad/s",
                s.gamma_achieved, s.gamma_lower, s.fastest_pole_rad_s
            ),
            format!(
                "peaks: K S {:.4}, S {:.4}, T {:.4}; bandwidth {:.3} Hz",
                s.peak_ks, s.peak_s, s.peak_t, s.bandwidth_hz
            ),
            super::verify::line(c),
            format!("written: {}", answered.recipe),
        ]
    })?;
    Ok(if answered.certificate.holds { Verdict::Done } else { Verdict::CheckFailed })
}

/// The model from a file, or the plant that the study gives itself.
pub(super) fn model(study: &Study, file: Option<&PathBuf>) -> Result<PlantModel> {
    if let Some(path) = file {
        let model: PlantModel = serde_json::from_str(&artefact::read_text(path)?)
            .with_context(|| format!("in {}", path.display()))?;
        return model.checked().with_context(|| format!("in {}", path.display()));
    }
    let own = study.plant.as_ref().with_context(|| {
        format!(
            "{}: found none; give a [plant] with `nominal` and `uncertainty`, or name the file that \
             `telepulse identify` wrote",
            study.at_key("plant")
        )
    })?;
    let nominal = own.nominal.to_transfer_function("plant.nominal")?;
    let uncertainty = own.uncertainty.to_transfer_function("plant.uncertainty")?;
    given(study, nominal, uncertainty, "[plant] of study.toml").with_context(|| study.at_key("plant"))
}
