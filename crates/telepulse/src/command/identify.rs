//! `telepulse identify`: a sweep, a model, a bound.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::Args;
use serde::Serialize;
use telepulse_design::identify::{InputLinearisation, SweepRecord};

use super::{Verdict, answer};
use crate::artefact::{self, GrowingFile};
use crate::station::device::{self, Conditions};
use crate::station::replay::Mode;
use crate::study::config::Study;
use crate::study::held_plate::HeldModel;
use crate::study::identify::{identify, plant_model, sweep};
use crate::study::outcome::Identified;

#[derive(Debug, Args)]
pub(super) struct IdentifyArguments {
    /// Study whose rig is swept, and whose settings are used.
    #[arg(long, value_name = "DIR", default_value = "studies/diaphragm-2017")]
    study: PathBuf,
    /// A sweep of your own instead: CSV with frequency_hz,amplitude,magnitude,phase_deg (mm per unit, degrees).
    #[arg(long, value_name = "CSV")]
    sweep: Option<PathBuf>,
    /// The command is the square of the voltage; the root is taken at the amplifier.
    #[arg(long)]
    square_root: bool,
    /// What is identified: the plate under its weight, or held by the load cell.
    #[arg(long, value_enum, default_value_t = Mode::Displacement)]
    mode: Mode,
    /// File for the model.
    #[arg(long, value_name = "FILE", default_value = "model.json")]
    out: PathBuf,
    /// File for the sweep as measured.
    #[arg(long, value_name = "CSV")]
    save_sweep: Option<PathBuf>,
}

#[derive(Debug, Serialize)]
struct Answer {
    identified: Identified,
    model: String,
}

pub(super) fn run(typed: &IdentifyArguments, json: bool) -> Result<Verdict> {
    let study = Study::load(&typed.study)?;
    let input = if typed.square_root { InputLinearisation::SquareRoot } else { InputLinearisation::None };
    let own = typed.sweep.clone().or_else(|| study.own_sweep());
    if typed.mode == Mode::Force {
        ensure!(
            own.is_none(),
            "`--mode force` sweeps the virtual rig, found a sweep of your own, allowed is none"
        );
        return held(&study, typed, input, json);
    }
    ensure!(
        !(typed.square_root && typed.sweep.is_none() && own.is_some()),
        "{}: found with `--square-root`, allowed without it: name the sweep with `--sweep` if its command was the square of the voltage",
        study.at_key("identify.sweep_csv")
    );
    let record = match (&typed.sweep, &own) {
        (Some(path), _) => read_sweep(path)?,
        (None, Some(path)) => read_sweep(path).with_context(|| study.at_key("identify.sweep_csv"))?,
        (None, None) => {
            let twin = device::twin(&study)?;
            let mut rig = device::displacement(&study, &twin, Conditions::default())?;
            sweep(&mut rig, &study, device::displacement_scale(), input)?
        }
    };
    let source = own.as_ref().map_or_else(|| "virtual rig".to_owned(), |path| path.display().to_string());
    let found = identify(record, study.identify.rc_s).with_context(|| format!("from {source}"))?;
    ensure!(
        found.bound.violations == 0,
        "from {source}: the bound lies below {} of its {} points, allowed none",
        found.bound.violations,
        found.bound.points.len()
    );
    let model = serde_json::to_vec_pretty(&plant_model(&study, &found, input, &source)?)?;
    let mut sweep_file = typed.save_sweep.as_deref().map(GrowingFile::beside).transpose()?;
    if let Some(file) = &mut sweep_file {
        file.write_all(found.record.to_csv().as_bytes()).context("cannot write the sweep")?;
    }
    artefact::write_file(&typed.out, &model)?;
    sweep_file.map_or(Ok(()), GrowingFile::commit)?;
    let answered = Answer { identified: found.summary(), model: typed.out.display().to_string() };
    answer(json, &answered, || {
        let i = &answered.identified;
        vec![
            format!(
                "G: {:.4} mm/unit, {:.3} rad/s, zeta {:.4}, RC {:.3} ms; rms residual {:.4} mm/unit",
                i.dc_gain_mm_per_unit,
                i.omega_n_rad_s,
                i.zeta,
                1e3 * i.rc_s,
                i.residual_rms
            ),
            format!(
                "W_s: {:?} / {:?}, above all {} points",
                i.bound_numerator, i.bound_denominator, i.bound_points
            ),
            format!("written: {}", answered.model),
        ]
    })?;
    Ok(Verdict::Done)
}

/// A model of the plate held by the load cell.
#[derive(Debug, Serialize)]
struct HeldAnswer {
    dc_gain_mm_per_unit: f64,
    bound_violations: usize,
    bound_points: usize,
    bound_numerator: Vec<f64>,
    bound_denominator: Vec<f64>,
    model: String,
}

fn held(study: &Study, typed: &IdentifyArguments, input: InputLinearisation, json: bool) -> Result<Verdict> {
    let found = HeldModel::measure(study, &device::twin(study)?, input)?;
    let model = serde_json::to_vec_pretty(&found.plant_model(study, input, "virtual rig, held")?)?;
    artefact::write_file(&typed.out, &model)?;
    if let Some(path) = &typed.save_sweep {
        artefact::write_file(path, found.record.to_csv().as_bytes())?;
    }
    let answered = HeldAnswer {
        dc_gain_mm_per_unit: found.plant.dc_gain()?,
        bound_violations: found.bound.violations,
        bound_points: found.bound.points.len(),
        bound_numerator: found.bound.weight.numerator().to_vec(),
        bound_denominator: found.bound.weight.denominator().to_vec(),
        model: typed.out.display().to_string(),
    };
    answer(json, &answered, || {
        vec![
            format!("G: {:.4} mm-equivalents per unit behind the circuit", answered.dc_gain_mm_per_unit),
            format!("written: {}", answered.model),
        ]
    })?;
    Ok(Verdict::Done)
}

/// Reads a sweep as CSV.
pub(super) fn read_sweep(path: &Path) -> Result<SweepRecord> {
    SweepRecord::from_csv(&artefact::read_text(path)?).with_context(|| format!("in {}", path.display()))
}
