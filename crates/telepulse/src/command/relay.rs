//! `telepulse relay`: where the loop would oscillate, by experiment, and a PID controller from it.

use std::f64::consts::TAU;
use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::{Args, ValueEnum};
use serde::Serialize;
use telepulse_design::implement::PidSettings;
use telepulse_design::synthesize::pid::{CriticalPoint, RuleTerms, tyreus_luyben, ziegler_nichols};

use super::{Verdict, answer};
use crate::artefact;
use crate::station::device::{self, Conditions};
use crate::station::relay::{RelayPlan, run_relay};
use crate::station::replay::MAX_MM;
use crate::study::config::Study;
use crate::study::recipes::relay_recipe;

#[derive(Debug, Args)]
pub(super) struct RelayArguments {
    /// Study whose rig is used, with its filter and limits.
    #[arg(long, value_name = "DIR", default_value = "studies/diaphragm-2017")]
    study: PathBuf,
    /// Command about which the relay switches, fraction of full scale; the study's `identify.bias` unless given.
    #[arg(long)]
    bias: Option<f64>,
    /// Step to both sides of it.
    #[arg(long, default_value_t = 0.1)]
    step: f64,
    /// Half-width of the dead zone in mm; four times the spread of the measurement at rest unless given.
    #[arg(long, value_name = "MM")]
    hysteresis_mm: Option<f64>,
    /// Time at the bias before, in s: the membrane creeps.
    #[arg(long, value_name = "S", default_value_t = 20.0)]
    settle_s: f64,
    /// Longest time of the relay itself, in s.
    #[arg(long, value_name = "S", default_value_t = 30.0)]
    timeout_s: f64,
    /// Terms of the controller.
    #[arg(long, value_enum, default_value_t = Terms::Pi)]
    terms: Terms,
    /// Rule that makes it from the critical point.
    #[arg(long, value_enum, default_value_t = Rule::TyreusLuyben)]
    rule: Rule,
    /// Pole of the derivative filter times the derivative time.
    #[arg(long, default_value_t = 10.0)]
    filter_ratio: f64,
    /// File for the recipe.
    #[arg(long, value_name = "FILE", default_value = "pid.recipe.json")]
    out: PathBuf,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Terms {
    /// Proportional and integral.
    Pi,
    /// With a filtered derivative.
    Pid,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Rule {
    /// Tyreus and Luyben 1992: well damped.
    TyreusLuyben,
    /// Ziegler and Nichols 1942: for comparison.
    ZieglerNichols,
}

#[derive(Debug, Serialize)]
struct Answer {
    /// Unit per mm: the proportional gain at which the loop oscillates by itself.
    ultimate_gain_unit_per_mm: f64,
    ultimate_period_s: f64,
    /// Half the swing of the filtered measurement.
    amplitude_mm: f64,
    /// Largest difference of the cycles used, relative.
    period_spread: f64,
    /// The plant behind its filter at the period, mm per unit.
    response_mm_per_unit: [f64; 2],
    bias: f64,
    setpoint_mm: f64,
    hysteresis_mm: f64,
    duration_s: f64,
    settings: PidSettings,
    recipe: String,
}

pub(super) fn run(typed: &RelayArguments, json: bool) -> Result<Verdict> {
    let study = Study::load(&typed.study)?;
    let plan = checked(typed, &study)?;
    let twin = device::twin(&study)?;
    let mut rig = device::displacement(&study, &twin, Conditions::default())?;
    let found = run_relay(&mut rig, &study, device::displacement_scale(), &plan)
        .with_context(|| format!("relay experiment with {}", study.file.display()))?;
    let estimate = &found.estimate;
    let point = CriticalPoint { gain: estimate.critical_gain, omega_rad_s: TAU / estimate.period_s };
    let terms = match typed.terms {
        Terms::Pi => RuleTerms::Pi,
        Terms::Pid => RuleTerms::Pid,
    };
    let standard = match typed.rule {
        Rule::TyreusLuyben => tyreus_luyben(&point, terms),
        Rule::ZieglerNichols => ziegler_nichols(&point, terms),
    };
    let settings = standard.parallel(typed.filter_ratio)?;
    let recipe = relay_recipe(&study, settings, plan.bias)?;
    artefact::write_file(&typed.out, &serde_json::to_vec_pretty(&recipe)?)?;
    let answered = Answer {
        ultimate_gain_unit_per_mm: estimate.critical_gain,
        ultimate_period_s: estimate.period_s,
        amplitude_mm: estimate.amplitude,
        period_spread: estimate.period_spread,
        response_mm_per_unit: estimate.response,
        bias: plan.bias,
        setpoint_mm: found.setpoint_mm,
        hysteresis_mm: found.hysteresis_mm,
        duration_s: found.duration_s,
        settings,
        recipe: typed.out.display().to_string(),
    };
    answer(json, &answered, || answered.lines())?;
    Ok(Verdict::Done)
}

impl Answer {
    fn lines(&self) -> Vec<String> {
        let PidSettings { p, i_per_s, d_s, n_rad_s } = self.settings;
        vec![
            format!(
                "ultimate gain {:.4} unit/mm, period {:.4} s; amplitude {:.4} mm about {:.4} mm, hysteresis {:.4} mm",
                self.ultimate_gain_unit_per_mm,
                self.ultimate_period_s,
                self.amplitude_mm,
                self.setpoint_mm,
                self.hysteresis_mm
            ),
            format!("p {p:.5}, i {i_per_s:.5} per s, d {d_s:.6} s, filter {n_rad_s:.2} rad/s"),
            format!("written: {}", self.recipe),
        ]
    }
}

/// What was typed, within its ranges.
fn checked(typed: &RelayArguments, study: &Study) -> Result<RelayPlan> {
    let within = |flag: &str, value: f64, min: f64, max: f64| -> Result<f64> {
        ensure!((min..=max).contains(&value), "`--{flag}`: found {value}, allowed {min} to {max}");
        Ok(value)
    };
    within("filter-ratio", typed.filter_ratio, 1.0, 1e3)?;
    Ok(RelayPlan {
        bias: within("bias", typed.bias.unwrap_or(study.identify.bias), 0.0, 1.0)?,
        step: within("step", typed.step, 1e-3, 0.5)?,
        hysteresis_mm: typed.hysteresis_mm.map(|mm| within("hysteresis-mm", mm, 0.0, MAX_MM)).transpose()?,
        swing_max_mm: MAX_MM,
        settle_s: within("settle-s", typed.settle_s, 1.0, 600.0)?,
        timeout_s: within("timeout-s", typed.timeout_s, 0.1, 600.0)?,
    })
}
