//! `telepulse membrane simulate`: the plate's motion under a drive, from a case file.

use std::path::PathBuf;

use anyhow::{Result, anyhow, ensure};
use clap::Args;
use rand::{Rng, SeedableRng};
use serde::Serialize;
use telepulse_actuator::batch::{self, BatchDrive, BatchRecord, VariantRun};
use telepulse_actuator::failure::{Envelope, RunMargins, RunSample};
use telepulse_actuator::field::FieldTwin;
use telepulse_actuator::statics::{Electrodes, Load, StaticSolver};
use telepulse_actuator::twin::{Fidelity, Inputs, Twin, TwinModel};

use super::super::{Verdict, answer, notify};
use super::judged::{self, StatedCriteria};
use super::motion_case::{MotionCase, Scatter, as_typed, multiply};

#[derive(Debug, Args)]
pub(super) struct SimulateArguments {
    /// Case as JSON; `-` for standard input. docs/manual/membrane.md lists the keys.
    file: PathBuf,
}

/// Nodes less one of the field-level model.
const FIELD_DEGREE: usize = 16;

#[derive(Debug, Serialize)]
struct Answer {
    fidelity: Fidelity,
    step_s: f64,
    duration_s: f64,
    #[serde(flatten)]
    content: Content,
}

#[derive(Debug, Serialize)]
#[serde(untagged)]
enum Content {
    Single(Box<Single>),
    Batch(Batch),
}

#[derive(Debug, Serialize)]
struct Single {
    #[serde(flatten)]
    motion: Motion,
    /// Largest difference to the field-level model, percent of the stroke, over a step to full scale and over the paper's (25).
    stated_error_percent: Option<Stated>,
    /// What the margins are judged by.
    criteria: StatedCriteria,
    /// The smallest over the run, at up to 5000 of its instants.
    margins: RunMargins,
    samples: Samples,
}

#[derive(Debug, Serialize)]
struct Stated {
    full_scale_step: f64,
    reference_25: f64,
}

/// Displacements are from the rest position, positive down, at the ends of the steps.
#[derive(Debug, Clone, Serialize)]
struct Motion {
    rest_sag_m: f64,
    displacement_max_m: f64,
    displacement_max_at_s: f64,
    displacement_min_m: f64,
    displacement_mean_m: f64,
    displacement_rms_m: f64,
    displacement_end_m: f64,
    /// True where the plate left the range of the reduced twin's maps, beyond which they are continued linearly.
    left_map: bool,
}

#[derive(Debug, Default, Serialize)]
struct Samples {
    time_s: Vec<f64>,
    voltage_v: Vec<f64>,
    displacement_m: Vec<f64>,
}

#[derive(Debug, Serialize)]
struct Batch {
    n_variants: usize,
    n_failed: usize,
    seed: u64,
    variants: Vec<Variant>,
}

#[derive(Debug, Serialize)]
struct Variant {
    /// Each scattered parameter over its nominal value.
    factors: serde_json::Map<String, serde_json::Value>,
    #[serde(flatten)]
    motion: Option<Motion>,
    /// Why this variant has no motion.
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<String>,
}

pub(super) fn run(typed: &SimulateArguments, json: bool) -> Result<Verdict> {
    let case = MotionCase::read(&typed.file)?;
    if !case.unread.is_empty() {
        notify(&format!("telepulse: keys without a meaning here: {}", case.unread.join(", ")));
    }
    let voltages = case.drive.voltages(case.interval_s, case.n_intervals);
    let content = match (&case.scatter, case.fidelity) {
        (Some(scatter), _) => Content::Batch(scattered(&case, scatter, voltages)?),
        (None, Fidelity::Reduced) => Content::Single(Box::new(reduced(&case, &voltages)?)),
        (None, Fidelity::Field) => Content::Single(Box::new(field(&case, &voltages)?)),
    };
    let found = Answer {
        fidelity: case.fidelity,
        step_s: case.interval_s,
        duration_s: case.interval_s * case.n_intervals as f64,
        content,
    };
    answer(json, &found, || lines(&found))?;
    Ok(Verdict::Done)
}

fn refused(case: &MotionCase, error: telepulse_actuator::Error) -> anyhow::Error {
    let spec = case.parameters.spec();
    let key = match error {
        telepulse_actuator::Error::Parameter { .. } => String::new(),
        // What is not borne without voltage is the load's fault, and so is a chain limit close to it.
        telepulse_actuator::Error::GentLimit { .. } => format!("key `mass_kg`, found {}: ", spec.mass_kg),
        _ if !bears_its_load(case) => format!("key `mass_kg`, found {}: ", spec.mass_kg),
        _ => format!("key `full_scale_v`, found {}: ", spec.full_scale_v),
    };
    anyhow!("in {}: {key}{:#}", case.name, as_typed(error))
}

fn bears_its_load(case: &MotionCase) -> bool {
    let solved = case.parameters.sheet().and_then(|sheet| {
        StaticSolver::new(&sheet)?.solve(Load::ForceN(case.parameters.weight_n()), Electrodes::VoltageV(0.0))
    });
    solved.is_ok()
}

fn reduced(case: &MotionCase, voltages: &[f64]) -> Result<Single> {
    let model = TwinModel::with_stated_error(&case.parameters).map_err(|error| refused(case, error))?;
    let mut twin = Twin::new(&model);
    let mut log = Log::new(case, model.rest_sag_m());
    for &drive_v in voltages {
        twin.advance(case.interval_s, Inputs { drive_v, disturbance_n: 0.0 });
        log.add(drive_v, twin.membrane_voltage_v(), twin.displacement_mm());
    }
    let stated = model.stated_error().map(|error| Stated {
        full_scale_step: error.step.percent_of_stroke(),
        reference_25: error.reference.percent_of_stroke(),
    });
    log.finish(twin.has_left_map(), stated)
}

fn field(case: &MotionCase, voltages: &[f64]) -> Result<Single> {
    let refused = |error| refused(case, error);
    let mut twin = FieldTwin::new(&case.parameters, FIELD_DEGREE).map_err(refused)?;
    let rest = telepulse_actuator::membrane::Membrane::with_degree(&case.parameters, FIELD_DEGREE)
        .and_then(|membrane| membrane.rest(0.0))
        .map_err(refused)?;
    let mut log = Log::new(case, rest.displacement_m());
    for &drive_v in voltages {
        twin.step(case.interval_s, drive_v).map_err(refused)?;
        log.add(drive_v, twin.membrane_voltage_v(), twin.displacement_mm());
    }
    log.finish(false, None)
}

/// Statistics and samples of one run.
struct Log<'a> {
    case: &'a MotionCase,
    motion: Motion,
    n: usize,
    samples: Samples,
    /// Instants at which the margins are judged, so many intervals apart.
    judged: Vec<RunSample>,
    judged_every: usize,
}

/// Most instants at which margins are judged: each is a membrane solve of some 20 us.
const JUDGED_MAX: usize = 5000;

impl<'a> Log<'a> {
    fn new(case: &'a MotionCase, rest_sag_m: f64) -> Self {
        let motion = Motion {
            rest_sag_m,
            displacement_max_m: f64::NEG_INFINITY,
            displacement_max_at_s: 0.0,
            displacement_min_m: f64::INFINITY,
            displacement_mean_m: 0.0,
            displacement_rms_m: 0.0,
            displacement_end_m: 0.0,
            left_map: false,
        };
        // The run starts at rest without voltage.
        let start = RunSample { time_s: 0.0, displacement_m: rest_sag_m, voltage_v: 0.0, drive_v: 0.0 };
        let judged_every = case.n_intervals.div_ceil(JUDGED_MAX).max(1);
        Self { case, motion, n: 0, samples: Samples::default(), judged: vec![start], judged_every }
    }

    fn add(&mut self, drive_v: f64, membrane_v: f64, at_mm: f64) {
        self.n += 1;
        let (at_m, time_s) = (1e-3 * at_mm, self.n as f64 * self.case.interval_s);
        let motion = &mut self.motion;
        if at_m > motion.displacement_max_m {
            (motion.displacement_max_m, motion.displacement_max_at_s) = (at_m, time_s);
        }
        motion.displacement_min_m = motion.displacement_min_m.min(at_m);
        motion.displacement_mean_m += at_m;
        motion.displacement_rms_m += at_m * at_m;
        motion.displacement_end_m = at_m;
        if self.n.is_multiple_of(self.judged_every) {
            let displacement_m = motion.rest_sag_m + at_m;
            self.judged.push(RunSample { time_s, displacement_m, voltage_v: membrane_v, drive_v });
        }
        if self.n.is_multiple_of(self.case.sample_every) {
            self.samples.time_s.push(time_s);
            self.samples.voltage_v.push(drive_v);
            self.samples.displacement_m.push(at_m);
        }
    }

    fn finish(mut self, left_map: bool, stated: Option<Stated>) -> Result<Single> {
        let margins = self.margins()?;
        let n = self.n.max(1) as f64;
        self.motion.displacement_mean_m /= n;
        self.motion.displacement_rms_m = (self.motion.displacement_rms_m / n).sqrt();
        self.motion.left_map = left_map;
        Ok(Single {
            motion: self.motion,
            stated_error_percent: stated,
            criteria: StatedCriteria::of(&self.case.criteria),
            margins,
            samples: self.samples,
        })
    }

    /// The smallest margins; a run that fails is told, and refused where the case has named what it fails by.
    fn margins(&self) -> Result<RunMargins> {
        let case = self.case;
        let refused = |error| refused(case, error);
        let sheet = case.parameters.sheet().map_err(refused)?;
        let found = Envelope::new(&sheet, case.criteria)
            .map_err(refused)?
            .with_branches(&case.parameters.spec().branches)
            .over_run(case.parameters.weight_n(), &self.judged)
            .map_err(refused)?;
        let Some(time_s) = found.first_failure_s else { return Ok(found) };
        let worst =
            found.worst.iter().filter(|w| w.margin.left <= 0.0).min_by(|a, b| a.time_s.total_cmp(&b.time_s));
        let reason = match (worst, &found.ended) {
            (Some(worst), _) => judged::failed(&worst.margin),
            (None, Some(ended)) => ended.reason.clone(),
            (None, None) => "a margin is used up".to_owned(),
        };
        ensure!(
            !case.gives_criteria,
            "in {}: key `drive`: from {time_s} s on the membrane has failed: {reason}",
            case.name
        );
        notify(&format!("telepulse: from {time_s} s on the membrane has failed: {reason}"));
        Ok(found)
    }
}

fn scattered(case: &MotionCase, scatter: &Scatter, voltages: Vec<f64>) -> Result<Batch> {
    let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(scatter.seed);
    let mut specs = Vec::with_capacity(scatter.n_variants);
    let mut factors = Vec::with_capacity(scatter.n_variants);
    for _ in 0..scatter.n_variants {
        let mut spec = case.parameters.spec().clone();
        let mut used = serde_json::Map::new();
        for (name, part) in &scatter.relative {
            // 53 random bits.
            let uniform = (random.next_u64() >> 11) as f64 * 0.5_f64.powi(53);
            let factor = 1.0 + part * (2.0 * uniform - 1.0);
            multiply(&mut spec, name, factor);
            used.insert((*name).to_owned(), factor.into());
        }
        specs.push(spec);
        factors.push(used);
    }
    let drive = BatchDrive::new(case.interval_s, voltages, 0.0)?;
    let runs = batch::simulate(&specs, &drive, BatchRecord::Statistics)?;
    let n_failed = runs.iter().filter(|run| run.is_err()).count();
    let variants = runs
        .into_iter()
        .zip(factors)
        .map(|(run, factors)| match run {
            Ok(run) => Variant { factors, motion: Some(Motion::of(&run)), error: None },
            Err(error) => Variant { factors, motion: None, error: Some(as_typed(error).to_string()) },
        })
        .collect();
    Ok(Batch { n_variants: scatter.n_variants, n_failed, seed: scatter.seed, variants })
}

impl Motion {
    fn of(run: &VariantRun) -> Self {
        Self {
            rest_sag_m: run.rest_sag_m,
            displacement_max_m: 1e-3 * run.max_mm,
            displacement_max_at_s: run.max_at_s,
            displacement_min_m: 1e-3 * run.min_mm,
            displacement_mean_m: 1e-3 * run.mean_mm,
            displacement_rms_m: 1e-3 * run.rms_mm,
            displacement_end_m: 1e-3 * run.final_mm,
            left_map: run.left_map,
        }
    }
}

fn lines(found: &Answer) -> Vec<String> {
    match &found.content {
        Content::Single(single) => {
            let motion = &single.motion;
            let mut lines = vec![
                format!("rest sag      {} mm", motion.rest_sag_m * 1e3),
                format!(
                    "largest       {} mm at {} s",
                    motion.displacement_max_m * 1e3,
                    motion.displacement_max_at_s
                ),
                format!("smallest      {} mm", motion.displacement_min_m * 1e3),
                format!("at the end    {} mm after {} s", motion.displacement_end_m * 1e3, found.duration_s),
            ];
            lines.extend(single.margins.worst.iter().map(|worst| {
                let margin = &worst.margin;
                format!(
                    "{:<22}{:.1} % left at {} s: {} of {} {}{}",
                    margin.mechanism.words(),
                    100.0 * margin.left,
                    worst.time_s,
                    margin.value,
                    margin.limit,
                    margin.unit,
                    if margin.unverified { "  [limit not verified against its source]" } else { "" }
                )
            }));
            if let Some(stated) = &single.stated_error_percent {
                lines.push(format!(
                    "stated error  {:.4} % of stroke over a step to full scale, {:.4} % over (25)",
                    stated.full_scale_step, stated.reference_25
                ));
            }
            lines
        }
        Content::Batch(batch) => {
            let mut strokes: Vec<f64> = batch
                .variants
                .iter()
                .filter_map(|v| v.motion.as_ref())
                .map(|m| m.displacement_max_m)
                .collect();
            strokes.sort_by(f64::total_cmp);
            let mut lines = vec![format!("variants      {}, failed {}", batch.n_variants, batch.n_failed)];
            if let (Some(least), Some(most)) = (strokes.first(), strokes.last()) {
                lines.push(format!(
                    "largest       {} to {} mm, median {} mm",
                    least * 1e3,
                    most * 1e3,
                    strokes[strokes.len() / 2] * 1e3
                ));
            }
            let failed = batch.variants.iter().enumerate().filter_map(|(k, v)| Some((k, v.error.as_ref()?)));
            lines.extend(failed.take(10).map(|(k, error)| format!("variant {k}     {error}")));
            lines
        }
    }
}
