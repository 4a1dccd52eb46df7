//! Runs a study from the device to the report.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use indicatif::{ProgressBar, ProgressStyle};
use telepulse_actuator::ParameterSet;
use telepulse_actuator::rig::rig_assumptions;
use telepulse_actuator::twin::{Fidelity, TwinModel};
use telepulse_design::identify::PlantModel;
use telepulse_lti::{StateSpace, TransferFunction};

use super::config::{SensorChoice, Study};
use super::contact::{PulseForce, pulse_force};
use super::controllers::{Certified, Design, certify, synthesize};
use super::disagreements::{self, Recomputed};
use super::drawings;
use super::grey_box::NonlinearModel;
use super::models::{self, Models};
use super::outcome::{Assumption, CertificateSummary, Device, Outcome, Printed, StepOutcome, Tracking};
use super::pulse_files::{self, PulseFiles};
use super::recipes::{self, Recipes};
use super::tracking::{self, CONDITIONS, LaserNoise, Step, Tracked};
use super::transmission::{self, Transmitted};
use crate::artefact::{self, StagedFolder};
use crate::figure::Figure;
use crate::report::{self, figures};
use crate::station::device;
use crate::station::replay::Mode;
use crate::{VERSION, recording};

/// A study that has run, with its files in place.
#[derive(Debug)]
pub struct Finished {
    /// Every number.
    pub outcome: Outcome,
    /// The results folder.
    pub folder: PathBuf,
}

/// Runs the study and puts its results into `folder`, all of them or none.
///
/// # Errors
/// Where a stage cannot run; then `folder` is as it was.
pub fn run(study: &Study, folder: &Path) -> Result<Finished> {
    // The study drives the virtual rig, which is neither the user's device nor the user's plant: numbers of both in one report
    // would look like one device's.
    ensure!(
        study.plant.is_none() && study.identify.sweep_csv.is_none(),
        "in {}: keys `plant` and `identify.sweep_csv` describe a device of your own, and `study run` drives the virtual rig: use \
         `telepulse identify`, `design` and `verify` with this study, or remove them",
        study.file.display()
    );
    // A study that cannot be transmitted is refused before hours of a real rig are spent on it.
    recording::read(&study.path(&study.pulse.recording))?;
    let staged = StagedFolder::beside(folder)?;
    let bar = progress_bar(study);
    bar.set_message("membrane and twin");
    let twin = device::twin_with_stated_error(study)?;
    bar.inc(1);

    bar.set_message("sweeps");
    let models = models::measure(study, &twin, &|| bar.inc(1))?;
    bar.set_message("synthesis and certificates");
    let recipes = recipes::build(study, &models)?;
    write_inputs_of_later_stages(study, staged.path(), &models, &recipes)?;
    bar.inc(1);

    bar.set_message("transmission, replay and tracking");
    let program = std::env::current_exe().context("this program's own file is not known")?;
    let link =
        transmission::start(study, &program, &staged.path().join("recipes"), &staged.path().join("doctor"))?;
    let tracked = Runs {
        table_1: tracking::track_all(
            study,
            &twin,
            &recipes.displacement,
            LaserNoise::OnlyTheCondition,
            &|| bar.inc(1),
        )?,
        laser_noise: tracking::track_all(
            study,
            &twin,
            &recipes.displacement,
            LaserNoise::AsAssumed,
            &|| bar.inc(1),
        )?,
        pulse_files: pulse_files(study, &twin, &models, &recipes, &|| bar.inc(1))?,
        pulse_force: force_on_recordings(study, &twin, &recipes)?,
    };
    let steps = [
        ("the study's device", tracking::step(study, study.actuator.parameter_set)?),
        ("set B, fitted to figure 9", tracking::step(study, ParameterSet::B)?),
    ];
    let transmitted = link.finish()?;
    bar.inc(1);

    bar.set_message("report");
    let (outcome, drawn) = assemble(study, &twin, &models, &recipes, &tracked, &steps, &transmitted)?;
    report::write_data(staged.path(), &outcome, &drawn)?;
    report::write(staged.path(), &outcome, &drawn)?;
    let folder = staged.commit()?;
    bar.finish_and_clear();
    Ok(Finished { outcome, folder })
}

/// Steps of the progress bar: twin, sweeps, design, tracking runs, link, recordings.
fn n_steps(study: &Study) -> u64 {
    let n_recorded = study.pulse.files.len() * study.pulse.horizons_s.len();
    1 + models::N_SWEEPS + 1 + 20 + 20 + 1 + n_recorded as u64
}

/// The recordings of the study in force mode at its own play-out delay; `study contact` has the other delays and the printed K.
fn force_on_recordings(
    study: &Study,
    twin: &TwinModel,
    recipes: &Recipes,
) -> Result<BTreeMap<String, PulseForce>> {
    let best = recipes.force.iter().find(|(name, _)| name == "best");
    match best {
        Some((_, best)) if study.actuator.fidelity == Fidelity::Reduced && !study.pulse.files.is_empty() => {
            let playout_ms = (1e3 * study.pulse.playout_delay_s).round() as u32;
            pulse_force(study, twin, best, None, &study.recordings(), &[playout_ms])
        }
        _ => Ok(BTreeMap::new()),
    }
}

/// The recordings of the study, followed; at field level a recording of minutes would take an hour, so there are none.
fn pulse_files(
    study: &Study,
    twin: &TwinModel,
    models: &Models,
    recipes: &Recipes,
    done: &(dyn Fn() + Sync),
) -> Result<PulseFiles> {
    let best = recipes.displacement.iter().find(|(name, _)| name == "best");
    match best {
        Some((_, best)) if study.actuator.fidelity == Fidelity::Reduced => {
            pulse_files::follow_all(study, twin, best, &models.motion.model, done)
        }
        _ => Ok(PulseFiles::new()),
    }
}

/// What was run while the link was at work.
struct Runs {
    table_1: Vec<Tracked>,
    laser_noise: Vec<Tracked>,
    pulse_files: PulseFiles,
    pulse_force: BTreeMap<String, PulseForce>,
}

fn progress_bar(study: &Study) -> ProgressBar {
    let style = ProgressStyle::with_template("{bar:32} {pos:>2}/{len} {msg} [{elapsed}]")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(n_steps(study)).with_style(style)
}

/// Models, sweeps and recipes as files: what a later stage, or a user, starts from.
fn write_inputs_of_later_stages(
    study: &Study,
    folder: &Path,
    models: &Models,
    recipes: &Recipes,
) -> Result<()> {
    let json = |name: &str, value: Vec<u8>| artefact::write_file(&folder.join(name), &value);
    for (name, model) in models::MODEL_FILES.iter().zip(models.plants(study)?) {
        json(name, serde_json::to_vec_pretty(&model)?)?;
    }
    json("identify/model_nonlinear.json", serde_json::to_vec_pretty(&models.motion.model)?)?;
    for (name, record) in models.sweeps() {
        artefact::write_file(&folder.join(name), record.to_csv().as_bytes())?;
    }
    for (mode, list) in [(Mode::Displacement, &recipes.displacement), (Mode::Force, &recipes.force)] {
        for (controller, recipe) in list {
            let name = crate::station::replay::recipe_name(controller, mode);
            json(&format!("recipes/{name}"), serde_json::to_vec_pretty(recipe)?)?;
        }
    }
    Ok(())
}

/// The printed systems.
struct PrintedSystems {
    plant: TransferFunction,
    controller: StateSpace<telepulse_lti::Continuous>,
    uncertainty: TransferFunction,
}

impl PrintedSystems {
    fn model(&self, study: &Study) -> Result<PlantModel> {
        models::given(study, self.plant.clone(), self.uncertainty.clone(), "Eq. (16) and (17)")
    }

    fn of(study: &Study) -> Result<Self> {
        Ok(Self {
            plant: study.printed.plant.to_transfer_function("printed.plant")?,
            controller: study.printed.controller.to_transfer_function("printed.controller")?.to_state_space(),
            uncertainty: study.printed.uncertainty.to_transfer_function("printed.uncertainty")?,
        })
    }
}

fn assemble(
    study: &Study,
    twin: &TwinModel,
    models: &Models,
    recipes: &Recipes,
    runs: &Runs,
    steps: &[(&str, Step); 2],
    transmitted: &Transmitted,
) -> Result<(Outcome, Vec<Figure>)> {
    let printed = PrintedSystems::of(study)?;
    let own = synthesize(study, &printed.plant)?;
    let (numbers, list) = judge_printed(study, &printed, &own)?;
    let model_step_mm = printed.plant.dc_gain()?;
    let at = |step: &Step, t_s: f64| {
        let idx = (t_s * study.control.sample_rate_hz).round() as usize;
        step.displacement_mm.get(idx).copied().context("the step is shorter than it should be")
    };
    let (pulse_spectrum, pulse_figures) = drawings::pulse_figures(study)?;
    let mut outcome = Outcome {
        version: report::VERSION,
        program: format!("telepulse {VERSION}"),
        study: study.name.clone(),
        title: study.title.clone(),
        inputs: inputs(study)?,
        seed: study.actuator.seed,
        device: Some(described(study, twin, runs)?),
        identified: models.voltage.summary(),
        identified_magnitude_only: models.voltage.magnitude_only_summary()?,
        identified_square_root: models.square_root.summary(),
        nonlinear_model: Some(NonlinearModel::of(&models.motion)),
        synthesis: own.summary.clone(),
        synthesis_identified: recipes.hinf.summary.clone(),
        synthesis_best: recipes.best.summary.clone(),
        printed: numbers,
        certificates: certificates(recipes),
        voltage_violations: voltage_violations(study, runs, transmitted),
        step: StepOutcome {
            peak_mm: steps[0].1.displacement_mm.iter().copied().fold(0.0, f64::max),
            at_500_ms_mm: at(&steps[0].1, 0.5)?,
            at_10_s_mm: at(&steps[0].1, 10.0)?,
            printed_model_mm: model_step_mm,
        },
        tracking: by_controller(&runs.table_1),
        tracking_laser_noise: by_controller(&runs.laser_noise),
        bias_sweep: recipes.bias_points.clone(),
        pulse: BTreeMap::new(),
        pulse_files: runs.pulse_files.clone(),
        pulse_force: runs.pulse_force.clone(),
        pulse_spectrum,
        link: transmitted.link.clone(),
        disagreements: list,
        assumptions: assumptions(study, twin),
    };
    for replay in &transmitted.replays {
        outcome
            .pulse
            .entry(replay.controller.clone())
            .or_default()
            .insert(replay.mode.word().to_owned(), replay.result.clone());
    }
    let mut figures_drawn = vec![
        drawings::step_figure(steps, &printed.plant)?,
        figures::frequency_response(&models.voltage, &printed.plant),
        figures::uncertainty(&models.voltage.bound, &printed.uncertainty),
        drawings::closed_loop_figure(recipes.shaped_loops())?,
    ];
    figures_drawn.push(figures::bias_sweep(&recipes.bias_points));
    figures_drawn.extend(drawings::tracking_figures(&runs.table_1));
    figures_drawn.extend(pulse_figures);
    figures_drawn.extend(drawings::replay_figures(transmitted));
    figures_drawn.extend(figures::pulse_files(&outcome.pulse_files));
    Ok((outcome, figures_drawn))
}

/// The device as it was used.
fn described(study: &Study, twin: &TwinModel, runs: &Runs) -> Result<Device> {
    let limits = device::envelope_limits(study.actuator.parameter_set, study.control.current_a)?;
    let stated = twin.stated_error();
    let sensing = || {
        let stable = runs.table_1.iter().chain(&runs.laser_noise).filter(|run| !run.result.unstable);
        stable.filter_map(|run| run.sensing)
    };
    let slew_v_per_s = study.control.slew_v_per_s;
    Ok(Device {
        parameter_set: study.actuator.parameter_set,
        fidelity: study.actuator.fidelity,
        sensor: study.actuator.sensor,
        stated_error_step_mm: stated.map(|error| error.step.max_mm),
        stated_error_step_percent: stated.map(|error| error.step.percent_of_stroke()),
        stated_error_reference_mm: stated.map(|error| error.reference.max_mm),
        stated_error_reference_percent: stated.map(|error| error.reference.percent_of_stroke()),
        sensing_error_max_mm: sensing().map(|found| found.error_max_mm).reduce(f64::max),
        sensing_standard_deviation_max_mm: sensing()
            .map(|found| found.standard_deviation_max_mm)
            .reduce(f64::max),
        max_v: study.control.max_v,
        max_v_derived: study.control.stated_max_v.is_none(),
        envelope_max_v: limits.max_v,
        envelope_limited_by: limits.limited_by.words().to_owned(),
        envelope_first_failure_v: limits.first_failure_v,
        envelope_unverified: limits.unverified,
        slew_v_per_s: slew_v_per_s.is_finite().then_some(slew_v_per_s),
    })
}

fn certificates(recipes: &Recipes) -> BTreeMap<String, CertificateSummary> {
    let summary = |(name, certified): (&String, &Certified)| {
        let mut summary = certified.summary();
        let biases = || recipes.bias_points.iter().filter(|p| p.controller == *name).map(|p| p.bias);
        if biases().next().is_some() {
            let (low, high) = (biases().fold(1.0, f64::min), biases().fold(0.0, f64::max));
            summary.scope =
                format!("the amplitudes of the sweep, and small signals at biases {low} to {high}");
        }
        (name.clone(), summary)
    };
    recipes.certificates.iter().map(summary).collect()
}

/// Runs in which a voltage outside of the study's limits was commanded; [`telepulse_rt::Limits`] makes that impossible, and this counts it
/// all the same.
fn voltage_violations(study: &Study, runs: &Runs, transmitted: &Transmitted) -> usize {
    let tracked = runs
        .table_1
        .iter()
        .chain(&runs.laser_noise)
        .map(|r| (r.result.min_voltage_v, r.result.max_voltage_v));
    let replayed = transmitted.replays.iter().map(|r| (r.result.min_voltage_v, r.result.max_voltage_v));
    tracked
        .chain(replayed)
        .filter(|(low, high)| {
            low.is_some_and(|v| v < study.control.min_v) || high.is_some_and(|v| v > study.control.max_v)
        })
        .count()
}

fn by_controller(runs: &[Tracked]) -> BTreeMap<String, BTreeMap<String, Tracking>> {
    let mut sorted: BTreeMap<String, BTreeMap<String, Tracking>> = BTreeMap::new();
    for run in runs {
        sorted
            .entry(run.controller.clone())
            .or_default()
            .insert(run.condition.to_owned(), run.result.clone());
    }
    sorted
}

fn judge_printed(
    study: &Study,
    printed: &PrintedSystems,
    own: &Design,
) -> Result<(Printed, Vec<super::outcome::Disagreement>)> {
    use telepulse_design::synthesize::{MixedSensitivityWeights, mixed_sensitivity};
    use telepulse_design::verify::{LoopUnderTest, verify};
    let bare = verify(&LoopUnderTest {
        plant: &printed.plant,
        controller: &printed.controller,
        bound: &printed.uncertainty,
        measurement_filter: None,
    })?;
    let filtered = certify(study, &printed.model(study)?, &printed.controller)?;
    let we = study.weights.error.to_transfer_function("weights.error")?;
    let wu = study.weights.control.to_transfer_function("weights.control")?;
    let generalized =
        mixed_sensitivity(&printed.plant, &MixedSensitivityWeights { we: &we, wu: &wu, wt: None })?;
    let stacked = telepulse_lti::hinf_norm(&generalized.lower_lft(&printed.controller)?)?;
    let margin = |c: &telepulse_design::verify::Certificate| c.gain_margin.as_ref().map(|m| m.factor);
    let gain_margin_filtered = match &filtered {
        Certified::Judged(certificate) | Certified::Fragile { certificate, .. } => margin(certificate),
        Certified::Refused(_) => None,
    };
    let list = disagreements::list(
        study,
        Recomputed {
            gamma_printed: stacked.value,
            gamma_lower: own.summary.gamma_lower,
            gain_margin: margin(&bare).unwrap_or(f64::INFINITY),
            gain_margin_filtered: gain_margin_filtered.unwrap_or(f64::INFINITY),
        },
    )?;
    let numbers = Printed {
        gamma: stacked.value,
        norm_ms: bare.norm_ms.value,
        norm_ws: bare.norm_ws.value,
        small_gain_limit: bare.small_gain_limit,
        frequency_wise: bare.frequency_wise.value,
    };
    Ok((numbers, list))
}

fn inputs(study: &Study) -> Result<BTreeMap<String, String>> {
    let mut paths = vec![study.file.clone(), study.path(&study.pulse.recording)];
    paths.extend(study.pulse.files.iter().map(|path| study.path(path)));
    paths.extend(study.identify.sweep_csv.as_ref().map(|path| study.path(path)));
    paths
        .into_iter()
        .map(|path| {
            let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            Ok((name, artefact::sha256_of(&path)?))
        })
        .collect()
}

fn assumptions(study: &Study, twin: &TwinModel) -> Vec<Assumption> {
    let own = |name: &str, value: String, why: &str| Assumption { name: name.into(), value, why: why.into() };
    let mut list = vec![
        own(
            "offset of the reference",
            format!("{} mm", study.reference.offset_mm),
            "(25) alone would ask for negative displacements, which no voltage makes",
        ),
        own(
            "constant disturbance",
            format!(
                "{} mN from {} s on",
                1e3 * study.conditions.disturbance_n,
                study.conditions.disturbance_start_s
            ),
            "its size is not given; it stands when the judged window begins",
        ),
        own("sample rate", format!("{} Hz", study.control.sample_rate_hz), "not given"),
        own(
            "bias of the sweep",
            format!("{} of full scale", study.identify.bias),
            "not given; a sine about zero volts has no response at its own frequency",
        ),
        own(
            "judged window",
            format!("{} s after {} s", study.reference.window_s, study.reference.settle_s),
            "one common period of the three sines, after the start transient",
        ),
        own(
            "errors",
            "true output against reference".into(),
            "the paper does not say whether its errors include the sensor's noise",
        ),
    ];
    if let (Some(error), Fidelity::Reduced) = (twin.stated_error(), study.actuator.fidelity) {
        list.push(own(
            "reduced twin for the field-level model",
            format!(
                "off by at most {:.4} % of stroke over a step to full scale, {:.4} % over (25)",
                error.step.percent_of_stroke(),
                error.reference.percent_of_stroke()
            ),
            "a control loop needs the twin thousands of times; its error was measured when it was built",
        ));
    }
    if study.actuator.sensor == SensorChoice::Capacitance {
        list.push(own(
            "self-sensing in runs, laser in sweeps",
            "its lag of half a window is in no identified model".into(),
            "certificates hold for the laser; each run shows whether the loop bears the lag",
        ));
    }
    list.extend(rig_assumptions().iter().map(|a| own(a.name, format!("{} {}", a.value, a.unit), a.reason)));
    list
}

impl Finished {
    /// True where every check of the study itself is met: bounds, certificates of our designs, link, and stable runs of our
    /// designs within the voltage limits.
    #[must_use]
    pub fn passed(&self) -> bool {
        let o = &self.outcome;
        let certified = ["hinf", "best", "hinf_force", "best_force"]
            .iter()
            .all(|name| o.certificates.get(*name).is_some_and(|c| c.holds));
        let tracked = |table: &BTreeMap<String, BTreeMap<String, Tracking>>| {
            ["hinf", "best"].iter().all(|name| {
                CONDITIONS.iter().all(|(condition, _)| {
                    table.get(*name).and_then(|runs| runs.get(*condition)).is_some_and(|run| !run.unstable)
                })
            })
        };
        let replayed = ["hinf", "best"].iter().all(|name| {
            ["displacement", "force"].iter().all(|mode| {
                o.pulse.get(*name).and_then(|runs| runs.get(*mode)).is_some_and(|run| !run.unstable)
            })
        });
        let bounds =
            [&o.identified, &o.identified_square_root].iter().all(|model| model.bound_violations == 0);
        bounds
            && certified
            && o.link.bit_exact
            && tracked(&o.tracking)
            && tracked(&o.tracking_laser_noise)
            && replayed
            && o.voltage_violations == 0
    }

    /// Ten lines for the terminal.
    #[must_use]
    pub fn summary_lines(&self) -> Vec<String> {
        let o = &self.outcome;
        let error = |controller: &str| {
            o.tracking
                .get(controller)
                .and_then(|runs| runs.get("normal"))
                .and_then(|run| run.mean_abs_error_mm)
                .map_or_else(|| "unstable".to_owned(), |mm| format!("{mm:.5} mm"))
        };
        let replay = |controller: &str, mode: &str| {
            o.pulse.get(controller).and_then(|runs| runs.get(mode)).map_or_else(
                || "not run".to_owned(),
                |run| match (run.lag_ms, run.nrmse) {
                    (Some(lag), Some(nrmse)) => format!("lag {lag:.2} ms, NRMSE {:.2} %", 100.0 * nrmse),
                    _ => "unstable".to_owned(),
                },
            )
        };
        let certified: Vec<String> = o
            .certificates
            .iter()
            .filter(|(_, certificate)| certificate.holds)
            .map(|(name, _)| name.clone())
            .collect();
        vec![
            o.title.clone(),
            format!(
                "identified   {:.4} mm/unit, {:.2} rad/s, zeta {:.3}; bound above all {} points",
                o.identified.dc_gain_mm_per_unit,
                o.identified.omega_n_rad_s,
                o.identified.zeta,
                o.identified.bound_points
            ),
            format!(
                "synthesis    gamma {:.5} on the printed plant (no controller below {:.5}; the printed K: {:.4})",
                o.synthesis.gamma_achieved, o.synthesis.gamma_lower, o.printed.gamma
            ),
            format!("certified    {}", certified.join(", ")),
            format!(
                "tracking     printed K {}, own S/KS {}, best {}",
                error("printed_k"),
                error("hinf"),
                error("best")
            ),
            format!(
                "link         {} samples, lost {}, duplicated {}, out of order {}, bit exact {}",
                o.link.received, o.link.lost, o.link.duplicated, o.link.out_of_order, o.link.bit_exact
            ),
            format!(
                "pulse        printed K: {}; best: {}",
                replay("printed_k", "displacement"),
                replay("best", "displacement")
            ),
            format!(
                "pulse force  printed K: {}; best: {}",
                replay("printed_k", "force"),
                replay("best", "force")
            ),
            format!("report       {}", self.folder.join("report.html").display()),
            format!(
                "numbers      {}   figures {}",
                self.folder.join("report.json").display(),
                self.folder.join("figures").display()
            ),
        ]
    }
}
