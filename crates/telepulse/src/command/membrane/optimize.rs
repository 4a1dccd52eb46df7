//! `telepulse membrane optimize`: which geometry, pre-stretch and load give stroke and bandwidth without failure.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::Args;
use rayon::prelude::*;
use serde::Serialize;
use serde_json::{Map, Value};
use telepulse_actuator::design_study::{
    DesignVariable, EndOfStroke, Performance, StudyLimits, Variant, evaluate, pareto_front, refined,
    source_resistance_ohm,
};
use telepulse_actuator::{ActuatorParameters, Error};

use super::super::{Verdict, answer, notify};
use super::calibration_case::{actuator, only_known};
use super::case::{number, read_fields, said};
use super::pareto_figure::{Shown, pareto_figure};
use crate::artefact;
use crate::figure::svg;

#[derive(Debug, Args)]
pub(super) struct OptimizeArguments {
    /// Case as JSON; `-` for standard input. docs/manual/membrane.md lists the keys.
    file: PathBuf,
    /// File for a drawing of all variants and their Pareto front.
    #[arg(long, value_name = "SVG")]
    figure: Option<PathBuf>,
}

/// Most variants of one run: at about 3 ms each, five minutes of one core.
const VARIANTS_MAX: usize = 100_000;
/// Most rounds of refinement: each doubles the density about the front.
const ROUNDS_MAX: usize = 8;

/// A checked case.
struct StudyCase {
    base: ActuatorParameters,
    limits: StudyLimits,
    variables: Vec<DesignVariable>,
    levels: Vec<Vec<f64>>,
    rounds: usize,
}

#[derive(Debug, Serialize)]
struct Answer {
    /// The base itself under the same limits; null where it does not keep them.
    base: Option<Design>,
    /// The variant with the largest product of stroke and bandwidth.
    best_product: Option<Design>,
    /// By rising stroke.
    front: Vec<Design>,
    n_variants: usize,
    n_failed: usize,
    failed: Vec<Failed>,
    figure: Option<String>,
}

#[derive(Debug, Clone, Serialize)]
struct Design {
    variant: Map<String, Value>,
    stroke_mm: f64,
    bandwidth_hz: f64,
    product_mm_hz: f64,
    voltage_v: f64,
    ended_by: &'static str,
    field_max_v_per_m: f64,
    tension_min_pa: f64,
    sag_mm: f64,
    rc_s: f64,
}

#[derive(Debug, Serialize)]
struct Failed {
    variant: Map<String, Value>,
    reason: String,
}

type Outcome = (Variant, Result<Performance, Error>);

pub(super) fn run(typed: &OptimizeArguments, json: bool) -> Result<Verdict> {
    let (fields, name) = read_fields(&typed.file)?;
    let case = StudyCase::from_fields(&fields).map_err(|error| anyhow!("in {name}: {error:#}"))?;
    let source_ohm =
        source_resistance_ohm(&case.base).map_err(|error| anyhow!("in {name}: key `base`: {error}"))?;
    let outcomes = case.search(source_ohm).map_err(|error| anyhow!("in {name}: {error:#}"))?;
    let base = evaluate(&case.base, &[], &[], case.limits, source_ohm);
    if let Err(error) = &base {
        notify(&format!("telepulse: the base itself fails: {error}"));
    }
    let designs: Vec<Design> = outcomes
        .iter()
        .filter_map(|(variant, outcome)| outcome.as_ref().ok().map(|found| case.design(variant, found)))
        .collect();
    let front = front_of(&designs);
    let failed: Vec<Failed> = outcomes
        .iter()
        .filter_map(|(variant, outcome)| {
            let reason = said(outcome.as_ref().err()?);
            Some(Failed { variant: case.named(variant), reason })
        })
        .collect();
    let base = base.ok().map(|found| Design { variant: Map::new(), ..case.design(&[], &found) });
    if let Some(path) = &typed.figure {
        draw(path, &designs, &front, base.as_ref())?;
    }
    let best = designs.iter().max_by(|a, b| a.product_mm_hz.total_cmp(&b.product_mm_hz)).cloned();
    let answered = Answer {
        base,
        best_product: best,
        front: front.iter().map(|&idx| designs[idx].clone()).collect(),
        n_variants: outcomes.len(),
        n_failed: failed.len(),
        failed,
        figure: typed.figure.as_ref().map(|path| path.display().to_string()),
    };
    answer(json, &answered, || lines(&answered))?;
    // Without a single variant that holds there is no answer to the question.
    Ok(if designs.is_empty() { Verdict::CheckFailed } else { Verdict::Done })
}

impl StudyCase {
    fn from_fields(fields: &Map<String, Value>) -> Result<Self> {
        only_known(fields, &["base", "sweep", "limits", "refinements", "name", "note"])?;
        let Some(Value::Object(limits)) = fields.get("limits") else {
            bail!(
                "key `limits` is missing or no object, expected `amplifier_v`, `field_v_per_m`, `voltage_margin`"
            );
        };
        only_known(limits, &["amplifier_v", "field_v_per_m", "voltage_margin"]).context("key `limits`")?;
        let value = |key: &str| number(limits, key).context("key `limits`");
        let limits = StudyLimits {
            amplifier_v: value("amplifier_v")?,
            field_v_per_m: value("field_v_per_m")?,
            voltage_margin: value("voltage_margin")?,
        };
        limits.check().map_err(|error| anyhow!("key `limits`: {error}"))?;
        let Some(Value::Object(sweep)) = fields.get("sweep") else {
            bail!("key `sweep` is missing or no object, expected values for what is varied");
        };
        let (mut variables, mut levels) = (Vec::new(), Vec::new());
        for (key, value) in sweep {
            let known = DesignVariable::ALL.map(DesignVariable::key).join(", ");
            let variable = DesignVariable::from_key(key)
                .with_context(|| format!("key `sweep`: `{key}` cannot be varied, expected one of {known}"))?;
            variables.push(variable);
            levels.push(values(value).map_err(|error| anyhow!("key `sweep`, `{key}`: {error:#}"))?);
        }
        ensure!(!variables.is_empty(), "key `sweep`: nothing is varied");
        let n_variants = levels.iter().try_fold(1_usize, |n, level| n.checked_mul(level.len()));
        ensure!(
            n_variants.is_some_and(|n| n <= VARIANTS_MAX),
            "key `sweep`: more than {VARIANTS_MAX} variants, give fewer values"
        );
        let rounds = match fields.get("refinements") {
            None | Some(Value::Null) => 0,
            Some(value) => value
                .as_u64()
                .and_then(|n| usize::try_from(n).ok())
                .filter(|n| *n <= ROUNDS_MAX)
                .with_context(|| format!("key `refinements`: expected 0 to {ROUNDS_MAX}, found {value}"))?,
        };
        Ok(Self { base: actuator(fields, "base")?, limits, variables, levels, rounds })
    }

    /// All variants of the grid and of the rounds of refinement, on all cores.
    fn search(&self, source_ohm: f64) -> Result<Vec<Outcome>> {
        let mut levels = self.levels.clone();
        let mut fresh = product(&levels);
        let mut outcomes: Vec<Outcome> = Vec::new();
        for round in 0..=self.rounds {
            ensure!(
                outcomes.len() + fresh.len() <= VARIANTS_MAX,
                "key `refinements`: more than {VARIANTS_MAX} variants in round {round}, give fewer"
            );
            outcomes.par_extend(fresh.into_par_iter().map(|variant| {
                let found = evaluate(&self.base, &self.variables, &variant, self.limits, source_ohm);
                (variant, found)
            }));
            let good: Vec<(&Variant, [f64; 2])> = outcomes
                .iter()
                .filter_map(|(variant, found)| {
                    found.as_ref().ok().map(|found| (variant, [found.stroke_mm, found.bandwidth_hz]))
                })
                .collect();
            let points: Vec<[f64; 2]> = good.iter().map(|(_, point)| *point).collect();
            let members: Vec<Variant> =
                pareto_front(&points).into_iter().map(|idx| good[idx].0.clone()).collect();
            fresh = refined(&members, &mut levels);
            fresh.retain(|variant| !outcomes.iter().any(|(known, _)| known == variant));
        }
        Ok(outcomes)
    }

    fn named(&self, variant: &[f64]) -> Map<String, Value> {
        let pairs = self.variables.iter().zip(variant);
        pairs.map(|(variable, value)| (variable.key().to_owned(), Value::from(*value))).collect()
    }

    fn design(&self, variant: &[f64], found: &Performance) -> Design {
        Design {
            variant: self.named(variant),
            stroke_mm: found.stroke_mm,
            bandwidth_hz: found.bandwidth_hz,
            product_mm_hz: found.stroke_mm * found.bandwidth_hz,
            voltage_v: found.voltage_v,
            ended_by: EndOfStroke::name(found.ended_by),
            field_max_v_per_m: found.field_v_per_m,
            tension_min_pa: found.tension_min_pa,
            sag_mm: found.sag_mm,
            rc_s: found.rc_s,
        }
    }
}

/// A list of values, or `from`, `to` and `n`.
fn values(value: &Value) -> Result<Vec<f64>> {
    let mut found: Vec<f64> = match value {
        Value::Array(list) => list
            .iter()
            .map(|entry| entry.as_f64().with_context(|| format!("expected numbers, found {entry}")))
            .collect::<Result<_>>()?,
        Value::Object(fields) => {
            only_known(fields, &["from", "to", "n"])?;
            let (from, to, n) = (number(fields, "from")?, number(fields, "to")?, number(fields, "n")?);
            ensure!(
                n.fract() == 0.0 && (2.0..=1000.0).contains(&n),
                "`n` must be whole, 2 to 1000, found {n}"
            );
            (0..n as usize).map(|idx| from + (to - from) * idx as f64 / (n - 1.0)).collect()
        }
        other => bail!("expected a list, or `from`, `to` and `n`, found {other}"),
    };
    ensure!(!found.is_empty(), "expected at least one value, found none");
    found.sort_by(f64::total_cmp);
    found.dedup();
    Ok(found)
}

fn product(levels: &[Vec<f64>]) -> Vec<Variant> {
    levels.iter().fold(vec![Vec::new()], |variants, level| {
        let longer = variants.iter().flat_map(|variant| {
            level.iter().map(move |value| variant.iter().copied().chain([*value]).collect())
        });
        longer.collect()
    })
}

fn front_of(designs: &[Design]) -> Vec<usize> {
    let points: Vec<[f64; 2]> = designs.iter().map(|d| [d.stroke_mm, d.bandwidth_hz]).collect();
    pareto_front(&points)
}

fn draw(path: &Path, designs: &[Design], front: &[usize], base: Option<&Design>) -> Result<()> {
    let shown = |design: &Design| Shown {
        stroke_mm: design.stroke_mm,
        bandwidth_hz: design.bandwidth_hz,
        ended_by: design.ended_by,
    };
    let all: Vec<Shown> = designs.iter().map(shown).collect();
    let front: Vec<Shown> = front.iter().map(|&idx| shown(&designs[idx])).collect();
    let figure = pareto_figure(&all, &front, base.map(shown));
    artefact::write_file(path, svg::render(&figure).as_bytes())
}

fn lines(found: &Answer) -> Vec<String> {
    let line = |design: &Design| {
        let variant: Vec<String> =
            design.variant.iter().map(|(key, value)| format!("{key} {value}")).collect();
        format!(
            "{:8.4} mm {:7.3} Hz at {:6.0} V, ended by {}: {}",
            design.stroke_mm,
            design.bandwidth_hz,
            design.voltage_v,
            design.ended_by,
            variant.join(", ")
        )
    };
    let mut lines: Vec<String> = found.base.iter().map(|base| format!("base  {}", line(base))).collect();
    lines.extend(found.best_product.iter().map(|best| format!("best  {}", line(best))));
    lines.extend(found.front.iter().map(|design| format!("front {}", line(design))));
    lines.push(format!("{} variants, {} without an answer", found.n_variants, found.n_failed));
    lines
}
