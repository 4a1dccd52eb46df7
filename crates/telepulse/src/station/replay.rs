//! The doctor's side: a received pulse becomes motion or force.

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use telepulse_actuator::rig::SensingRecord;
use telepulse_actuator::twin::TwinModel;
use telepulse_design::identify::Controlled;
use telepulse_design::implement::ControllerRecipe;
use telepulse_pulse::resample::resample;
use telepulse_pulse::{PulseRecording, Unit};

use super::control;
use super::device::{self, Conditions};
use super::run::{RunPlan, run};
use crate::artefact;
use crate::study::config::Study;
use crate::study::judge;
use crate::study::outcome::PulseReplay;
use crate::study::trace::Trace;

/// What is made to follow the pulse.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// The plate's displacement under its weight, read by the laser.
    Displacement,
    /// The force on a load cell that holds the plate.
    Force,
}

impl Mode {
    /// The word in files.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Displacement => "displacement",
            Self::Force => "force",
        }
    }
}

/// One replay, judged, with what a figure shows of it.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Replayed {
    /// Name of the controller.
    pub controller: String,
    /// What followed the pulse.
    pub mode: Mode,
    /// The figures.
    pub result: PulseReplay,
    /// Displacement in mm or pressure on the cell in Pa.
    pub trace: Trace,
}

/// Time for which the first value is held before the pulse starts, so that creep and start transient are not judged.
const LEAD_S: f64 = 15.0;
/// Time for which it is raised from rest within that.
const RISE_S: f64 = 2.0;

/// Largest displacement that a reference may ask for: what 5 kV makes on the weakest parameter set.
pub const MAX_MM: f64 = 2.5;
/// A shorter reference cannot be judged: the lag is searched over a quarter of it, 0.3 s.
const SHORTEST_S: f64 = 1.2;

/// How a pulse's pressure becomes the controlled variable.
#[derive(Debug, Clone, Copy)]
struct PressureScale {
    offset_mm: f64,
    middle_pa: f64,
    pa_per_mm: f64,
    sign: f64,
}

impl PressureScale {
    /// The middle of the pulse lies at the study's reference offset.
    fn of(study: &Study, pressure_pa: &[f64], mode: Mode) -> Self {
        let fold = |start: f64, pick: fn(f64, f64) -> f64| pressure_pa.iter().copied().fold(start, pick);
        let middle_pa = 0.5 * (fold(f64::INFINITY, f64::min) + fold(f64::NEG_INFINITY, f64::max));
        // The load of the cell falls with voltage, so its relief is the mirror image of the pulse.
        let sign = if mode == Mode::Force { -1.0 } else { 1.0 };
        Self { offset_mm: study.reference.offset_mm, middle_pa, pa_per_mm: study.pulse.pa_per_mm, sign }
    }

    /// The controlled variable for a whole pulse.
    fn reference_mm(self, pressure_pa: &[f64]) -> Result<Vec<f64>> {
        let reference: Vec<f64> = pressure_pa.iter().map(|p| self.to_mm(*p)).collect();
        if let Some(found) = reference.iter().find(|x| !(0.0..=MAX_MM).contains(*x)) {
            bail!(
                "the pulse asks for {found} mm, allowed 0 to {MAX_MM} mm from rest: its middle lies at the study's \
                 `reference.offset_mm` = {} mm, and `pulse.pa_per_mm` = {} Pa make a mm",
                self.offset_mm,
                self.pa_per_mm
            );
        }
        Ok(reference)
    }

    fn to_mm(self, pressure_pa: f64) -> f64 {
        self.offset_mm + self.sign * (pressure_pa - self.middle_pa) / self.pa_per_mm
    }

    fn to_pa(self, controlled_mm: f64) -> f64 {
        self.middle_pa + self.sign * (controlled_mm - self.offset_mm) * self.pa_per_mm
    }
}

fn at_control_rate(study: &Study, recording: &PulseRecording) -> Result<PulseRecording> {
    ensure!(
        *recording.unit() == Unit::Pascal,
        "the pulse is in {}, allowed is Pa: scale it before it is sent",
        recording.unit().symbol()
    );
    resample(recording, study.control.sample_rate_hz)
        .context("the pulse cannot be resampled to the control rate")
}

/// A pulse in Pa as displacement in mm from rest, at the control rate.
///
/// # Errors
/// Where the recording is no pressure or cannot be resampled.
pub fn pulse_reference(study: &Study, recording: &PulseRecording) -> Result<Vec<f64>> {
    let pressure = at_control_rate(study, recording)?;
    PressureScale::of(study, pressure.values(), Mode::Displacement).reference_mm(pressure.values())
}

/// A reference followed in displacement mode.
#[derive(Debug, Clone)]
pub struct Followed {
    /// Lag and error as of a pulse.
    pub result: PulseReplay,
    /// What a figure shows.
    pub trace: Trace,
    /// Mean absolute error; absent where unstable.
    pub mean_abs_error_mm: Option<f64>,
    /// Largest absolute error; absent where unstable.
    pub max_abs_error_mm: Option<f64>,
    /// How far the readings of self-sensing were from the truth, where it was used.
    pub sensing: Option<SensingRecord>,
}

/// Follows a reference in mm from rest, given at the control rate, with weight and laser.
///
/// # Errors
/// Where the recipe does not fit the study or the rig cannot run.
pub fn follow(
    study: &Study,
    twin: &TwinModel,
    recipe: &ControllerRecipe,
    title: &str,
    reference_mm: Vec<f64>,
) -> Result<Followed> {
    let mut rig = device::sensed(study, twin, Conditions::default())?;
    let plan = Lead::of(study).plan(study, recipe, reference_mm)?;
    let mut control =
        control::from_recipe(study, recipe, Controlled::Displacement, device::sensed_scale(study))?;
    let record = run(&mut rig, &mut control, &plan)?;
    let lead = Lead::of(study).ticks;
    let drive = judge::DriveRange::of(study);
    let result =
        stamped(study, recipe, judge::replay(title, &record, lead, &record.true_output, 1.0, drive)?);
    let result = PulseReplay { provenance: device::provenance(study, recipe), ..result };
    let tracking = judge::tracking(&record, lead, &record.true_output, drive);
    let trace =
        Trace::thin(&record.reference, &record.true_output, &record.voltage_v, record.sample_time_s, lead);
    Ok(Followed {
        result,
        trace,
        mean_abs_error_mm: tracking.mean_abs_error_mm,
        max_abs_error_mm: tracking.max_abs_error_mm,
        sensing: record.sensing,
    })
}

/// Replays a recording in Pa with one recipe on the study's virtual rig.
///
/// The recording is resampled to the control rate and turned into displacement by the study's pressure per mm. Its middle lies
/// at the study's reference offset. In force mode the cell's load is the membrane's pull, which falls with voltage:
/// what is controlled there is the *relief* of the cell in mm-equivalents, and the pulse is its mirror image.
///
/// # Errors
/// Where the recording is no pressure, the recipe does not fit the study, or the rig cannot run.
pub fn replay(
    study: &Study,
    twin: &TwinModel,
    controller: &str,
    recipe: &ControllerRecipe,
    recording: &PulseRecording,
    mode: Mode,
) -> Result<Replayed> {
    if mode == Mode::Force {
        return replay_held(study, twin, controller, recipe, recording, 1.0);
    }
    let controller = controller.to_owned();
    let reference_mm = pulse_reference(study, recording)?;
    let followed = follow(study, twin, recipe, &recording.title, reference_mm)?;
    Ok(Replayed { controller, mode, result: followed.result, trace: followed.trace })
}

/// Replays a recording in Pa in force mode, on a load cell of `stiffness_factor` times the assumed stiffness; see [`replay`].
///
/// # Errors
/// As [`replay`].
pub fn replay_held(
    study: &Study,
    twin: &TwinModel,
    controller: &str,
    recipe: &ControllerRecipe,
    recording: &PulseRecording,
    stiffness_factor: f64,
) -> Result<Replayed> {
    let (controller, mode) = (controller.to_owned(), Mode::Force);
    let pressure = at_control_rate(study, recording)?;
    let scale = PressureScale::of(study, pressure.values(), mode);
    let lead = Lead::of(study);
    let plan = lead.plan(study, recipe, scale.reference_mm(pressure.values())?)?;
    let mut rig = device::force_on(study, twin, stiffness_factor)?;
    let cell = device::force_scale(study, &rig)?;
    let mut control = control::from_recipe(study, recipe, Controlled::CellRelief, cell)?;
    let record = run(&mut rig, &mut control, &plan)?;
    let controlled: Vec<f64> = record.true_output.iter().map(|f| cell.gain * f + cell.offset).collect();
    let drive = judge::DriveRange::of(study);
    let result = judge::replay(&recording.title, &record, lead.ticks, &controlled, scale.sign, drive)?;
    let result = stamped(study, recipe, result);
    let pressures = |series: &[f64]| series.iter().map(|x| scale.to_pa(*x)).collect::<Vec<f64>>();
    let (wanted, found) = (pressures(&record.reference), pressures(&controlled));
    let trace = Trace::thin(&wanted, &found, &record.voltage_v, record.sample_time_s, lead.ticks);
    Ok(Replayed { controller, mode, result, trace })
}

/// The result with the right by which its controller ran, and the delay at which the pulse was played out.
fn stamped(study: &Study, recipe: &ControllerRecipe, result: PulseReplay) -> PulseReplay {
    PulseReplay {
        provenance: recipe.provenance().to_string(),
        playout_delay_ms: 1e3 * study.pulse.playout_delay_s,
        ..result
    }
}

/// What stands before the judged part of a replay.
#[derive(Debug, Clone, Copy)]
struct Lead {
    ticks: usize,
    rise_ticks: usize,
}

impl Lead {
    fn of(study: &Study) -> Self {
        let rate_hz = study.control.sample_rate_hz;
        Self { ticks: (LEAD_S * rate_hz) as usize, rise_ticks: (RISE_S * rate_hz) as usize }
    }

    /// The reference with its first value held before it, reached from rest by a smooth rise.
    fn plan(self, study: &Study, recipe: &ControllerRecipe, reference: Vec<f64>) -> Result<RunPlan> {
        let found_s = reference.len() as f64 * study.sample_time_s();
        ensure!(found_s >= SHORTEST_S, "the reference lasts {found_s} s, allowed at least {SHORTEST_S} s");
        let first = reference.first().copied().unwrap_or(0.0);
        let smooth = |k: usize| {
            let x = (k as f64 / self.rise_ticks as f64).min(1.0);
            first * x * x * (3.0 - 2.0 * x)
        };
        let reference: Vec<f64> = (0..self.ticks).map(smooth).chain(reference).collect();
        Ok(RunPlan {
            feedforward: control::feedforward(recipe, &reference),
            reference,
            watch: device::watch(study),
        })
    }
}

/// File name of the recipe of a controller for a mode.
#[must_use]
pub fn recipe_name(controller: &str, mode: Mode) -> String {
    format!("{controller}.{}.recipe.json", mode.word())
}

/// A recipe and the mode it is for.
#[derive(Debug, Clone)]
pub struct Job {
    controller: &'static str,
    mode: Mode,
    recipe: ControllerRecipe,
}

/// Reads every recipe of a folder that follows [`recipe_name`].
///
/// # Errors
/// Where there is no recipe, or one cannot be read.
pub fn read_recipes(recipes: &Path) -> Result<Vec<Job>> {
    let mut jobs = Vec::new();
    for controller in ["printed_k", "hinf", "best"] {
        for mode in [Mode::Displacement, Mode::Force] {
            let path = recipes.join(recipe_name(controller, mode));
            if path.is_file() {
                jobs.push(Job { controller, mode, recipe: read_recipe(&path)? });
            }
        }
    }
    ensure!(
        !jobs.is_empty(),
        "{} holds no recipe such as {}",
        recipes.display(),
        recipe_name("best", Mode::Force)
    );
    Ok(jobs)
}

/// Replays a recording with every recipe.
///
/// # Errors
/// Where one cannot run.
pub fn replay_all(
    study: &Study,
    twin: &TwinModel,
    jobs: &[Job],
    recording: &PulseRecording,
) -> Result<Vec<Replayed>> {
    jobs.iter()
        .map(|job| {
            replay(study, twin, job.controller, &job.recipe, recording, job.mode)
                .with_context(|| recipe_name(job.controller, job.mode))
        })
        .collect()
}

/// Reads a recipe.
///
/// # Errors
/// Names the file and the key.
pub fn read_recipe(path: &Path) -> Result<ControllerRecipe> {
    serde_json::from_str(&artefact::read_text(path)?).with_context(|| format!("in {}", path.display()))
}
