//! The controllers that a study compares, ready to run.

use std::collections::BTreeMap;

use anyhow::{Context, Result};
use telepulse_design::identify::{Controlled, GreyBoxModel, InputLinearisation, PlantModel};
use telepulse_design::implement::{
    AntiWindup, ControllerRecipe, Discretization, DriveLimits, Feedforward, FlatFeedforward, HeldFeedforward,
    Law, OperatingPoint, PidSettings, RecipeSettings, ReferencePath, SmootherOptions, realize_continuous,
};
use telepulse_lti::{Continuous, SampleTime, StateSpace, TransferFunction};

use super::bias_sweep;
use super::config::{Pid, Study};
use super::controllers::{Certified, Design, certify, measurement_filter, synthesize};
use super::models::Models;
use super::outcome::BiasPoint;

/// Every recipe of a study, with the evidence behind it.
#[derive(Debug, Clone)]
pub struct Recipes {
    /// For the weight and the laser: `printed_k`, `hinf`, `best`, `pid_auto`, `pid_manual`.
    pub displacement: Vec<(String, ControllerRecipe)>,
    /// For the load cell: `printed_k`, `hinf`, `best`.
    pub force: Vec<(String, ControllerRecipe)>,
    /// Certificates in displacement mode by controller, in force mode by controller with `_force` behind it.
    pub certificates: BTreeMap<String, Certified>,
    /// Each loop in displacement mode on the plant as it is at other biases.
    pub bias_points: Vec<BiasPoint>,
    /// Our S/KS design on the identified plant.
    pub hinf: Design,
    /// The feedback of our best controller.
    pub best: Design,
    /// Every loop in displacement mode on its own model, H-infinity designs first.
    pub loops: Vec<Loop>,
}

impl Recipes {
    /// The loops that figure 12 shows: all but the PIDs.
    #[must_use]
    pub fn shaped_loops(&self) -> &[Loop] {
        &self.loops[..3]
    }
}

/// A feedback loop on its own model.
#[derive(Debug, Clone)]
pub struct Loop {
    /// Name of the controller.
    pub controller_name: String,
    /// Its model.
    pub plant: TransferFunction,
    /// What its command is.
    pub input: InputLinearisation,
    /// The controller.
    pub controller: StateSpace<Continuous>,
    /// The filter in the measurement.
    pub filter: TransferFunction,
}

/// Designs, certifies and realises every controller of the study.
///
/// # Errors
/// Where a synthesis finds no controller or a controller cannot be realised.
pub fn build(study: &Study, models: &Models) -> Result<Recipes> {
    let filter = measurement_filter(study)?;
    let printed = study.printed.controller.to_transfer_function("printed.controller")?.to_state_space();
    let [displacement, squared, held, held_squared] = models.plants(study)?;

    let hinf = synthesize(study, &displacement.nominal)?;
    let best = best_feedback(study, &squared.nominal)?;
    let hinf_force = synthesize(study, &held.nominal).context("in force mode")?;
    let best_force = best_feedback(study, &held_squared.nominal).context("in force mode")?;

    let shown = |name: &str, model: &PlantModel, controller: &StateSpace<Continuous>| Loop {
        controller_name: name.to_owned(),
        plant: model.nominal.clone(),
        input: model.input_linearisation,
        controller: controller.clone(),
        filter: filter.clone(),
    };
    let pid = |typed: &Pid| Ok::<_, anyhow::Error>(typed.settings().transfer_function()?.to_state_space());
    let loops = vec![
        shown("printed_k", &displacement, &printed),
        shown("hinf", &displacement, &hinf.controller),
        shown("best", &squared, &best.controller),
        shown("pid_auto", &displacement, &pid(&study.pid.auto)?),
        shown("pid_manual", &displacement, &pid(&study.pid.manual)?),
    ];
    let mut out = Recipes {
        displacement: Vec::new(),
        force: Vec::new(),
        certificates: BTreeMap::new(),
        bias_points: Vec::new(),
        hinf,
        best,
        loops,
    };
    for one in &out.loops {
        let name = one.controller_name.as_str();
        let model = if name == "best" { &squared } else { &displacement };
        let points = bias_sweep::judge(study, one, &models.locals)?;
        let certified = certify(study, model, &one.controller)?.over_the_stroke(&points);
        let recipe = match name {
            "pid_auto" => pid_recipe(study, &study.pid.auto, model, &certified)?,
            "pid_manual" => pid_recipe(study, &study.pid.manual, model, &certified)?,
            "best" => {
                let settings = flat_settings(study, model, &models.motion.model)?;
                linear_recipe(model, &one.controller, settings, &certified)?
            }
            _ => linear_recipe(model, &one.controller, settings(study, model)?, &certified)?,
        };
        out.displacement.push((name.to_owned(), recipe));
        out.certificates.insert(name.to_owned(), certified);
        out.bias_points.extend(points);
    }
    for (name, controller, model, settings) in [
        ("printed_k", &printed, &held, settings(study, &held)?),
        ("hinf", &hinf_force.controller, &held, settings(study, &held)?),
        ("best", &best_force.controller, &held_squared, held_settings(study, &held_squared, models)?),
    ] {
        let certified = certify(study, model, controller)?;
        out.force.push((name.to_owned(), linear_recipe(model, controller, settings, &certified)?));
        out.certificates.insert(format!("{name}_force"), certified);
    }
    Ok(out)
}

fn pid_recipe(
    study: &Study,
    pid: &Pid,
    model: &PlantModel,
    certified: &Certified,
) -> Result<ControllerRecipe> {
    let reason =
        certified.objection().unwrap_or_else(|| "a PID law is not realised from its certificate".into());
    let settings = RecipeSettings { setpoint_weights: pid.setpoint_weights, ..settings(study, model)? };
    Ok(ControllerRecipe::uncertified(&reason, Law::Pid(pid.settings()), settings)?)
}

/// A PID controller from a relay experiment, which knows one point of the plant and nothing of its error.
///
/// # Errors
/// Where a gain is refused.
pub fn relay_recipe(study: &Study, pid: PidSettings, bias: f64) -> Result<ControllerRecipe> {
    let reason = format!(
        "tuned by a rule from a relay experiment at bias {bias}: no bound of the plant's error is known"
    );
    let settings = plain_settings(
        study,
        Controlled::Displacement,
        InputLinearisation::None,
        study.control.full_scale_v,
    )?;
    Ok(ControllerRecipe::uncertified(&reason, Law::Pid(pid), settings)?)
}

/// The feedback of the best controller: S/KS with the filter (26) as part of the plant, so that the loop is designed as it runs.
fn best_feedback(study: &Study, plant: &TransferFunction) -> Result<Design> {
    synthesize(study, &plant.multiply(&measurement_filter(study)?)?)
}

/// A linear controller as feedback alone, with the filter (26), as the paper runs it: certified where its certificate holds.
///
/// # Errors
/// Where the controller cannot be realised at the study's sample rate.
pub fn feedback_recipe(
    study: &Study,
    model: &PlantModel,
    controller: &StateSpace<Continuous>,
    certified: &Certified,
) -> Result<ControllerRecipe> {
    linear_recipe(model, controller, settings(study, model)?, certified)
}

fn linear_recipe(
    model: &PlantModel,
    controller: &StateSpace<Continuous>,
    settings: RecipeSettings,
    certified: &Certified,
) -> Result<ControllerRecipe> {
    let Some(reason) = certified.objection() else {
        return Ok(ControllerRecipe::certified(model, controller, Discretization::Tustin, settings)?);
    };
    let realisation = realize_continuous(controller, settings.sample_time_s, Discretization::Tustin)
        .context("the controller cannot be realised at the study's sample rate")?;
    Ok(ControllerRecipe::uncertified(&reason, Law::StateSpace(realisation.law), settings)?)
}

/// With the square root at the amplifier, the reference filtered as the measurement is, and the inverse of the held plate's curve.
fn held_settings(study: &Study, model: &PlantModel, models: &Models) -> Result<RecipeSettings> {
    let sample_time = SampleTime::new(study.sample_time_s())?;
    let horizon_s = study.pulse.playout_delay_s.min(HORIZON_MAX_S);
    let options = SmootherOptions { horizon_s, ..SmootherOptions::default() };
    let settings = settings(study, model)?;
    let rc_s = models.voltage.fit.rc_s;
    let held = HeldFeedforward::new(&models.force_curve, rc_s, sample_time, &options, settings.flat_drive())?;
    Ok(RecipeSettings {
        reference_path: ReferencePath::Filtered,
        feedforward: Some(Feedforward::Held(Box::new(held))),
        ..settings
    })
}

/// With the square root at the amplifier, the reference filtered as the measurement is, and the inverse of the nonlinear model.
fn flat_settings(study: &Study, model: &PlantModel, motion: &GreyBoxModel) -> Result<RecipeSettings> {
    let sample_time = SampleTime::new(study.sample_time_s())?;
    let horizon_s = study.pulse.playout_delay_s.min(HORIZON_MAX_S);
    let options = SmootherOptions { horizon_s, ..SmootherOptions::default() };
    let settings = settings(study, model)?;
    let flat = FlatFeedforward::new(motion, sample_time, &options, settings.flat_drive())?;
    Ok(RecipeSettings {
        reference_path: ReferencePath::Filtered,
        feedforward: Some(Feedforward::Flat(Box::new(flat))),
        ..settings
    })
}

/// The best controller with a feedforward for another horizon.
///
/// # Errors
/// Where no feedforward can be designed for it.
pub fn at_horizon(
    best: &ControllerRecipe,
    motion: &GreyBoxModel,
    horizon_s: f64,
) -> Result<ControllerRecipe> {
    let settings = best.settings();
    let options = SmootherOptions { horizon_s: horizon_s.min(HORIZON_MAX_S), ..SmootherOptions::default() };
    let flat = FlatFeedforward::new(motion, settings.sample_time_s, &options, settings.flat_drive())?;
    Ok(best.with_feedforward(Some(Feedforward::Flat(Box::new(flat))))?)
}

/// Beyond this a longer horizon makes no difference that could be measured.
pub const HORIZON_MAX_S: f64 = 0.2;

fn settings(study: &Study, model: &PlantModel) -> Result<RecipeSettings> {
    plain_settings(study, model.controlled, model.input_linearisation, model.full_scale_v)
}

/// Feedback alone, with the filter (26), within the study's limits.
fn plain_settings(
    study: &Study,
    controlled: Controlled,
    input_linearisation: InputLinearisation,
    full_scale_v: f64,
) -> Result<RecipeSettings> {
    Ok(RecipeSettings {
        controlled,
        sample_time_s: SampleTime::new(study.sample_time_s())?,
        input_linearisation,
        measurement_filter_rad_s: Some(std::f64::consts::TAU * study.control.filter_hz),
        reference_path: ReferencePath::Direct,
        feedforward: None,
        static_inverse: None,
        limits: DriveLimits { min_v: study.control.min_v, max_v: study.control.max_v, slew_v_per_s: None },
        anti_windup: AntiWindup::HoldOutward,
        setpoint_weights: None,
        // Every run starts from rest, so commands and displacements count from there.
        operating_point: OperatingPoint { bias_unit: 0.0, displacement_mm: 0.0, full_scale_v },
    })
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use telepulse_design::implement::SetpointWeights;

    use super::*;
    use crate::study::models::given;

    #[test]
    fn law_setpoint_weights_of_the_study_reach_the_recipe() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../studies/diaphragm-2017");
        let mut study = Study::load(Path::new(folder)).expect("a study");
        let lag = TransferFunction::new(&[1.0], &[0.1, 1.0]).expect("proper");
        let model = given(&study, lag.clone(), lag, "a lag").expect("a model");
        for weights in [None, Some(SetpointWeights { b: 0.4, c: 0.0 })] {
            study.pid.auto.setpoint_weights = weights;
            let refused = Certified::Refused("not looked at".to_owned());
            let recipe = pid_recipe(&study, &study.pid.auto, &model, &refused).expect("a recipe");
            assert_eq!(recipe.settings().setpoint_weights, weights);
        }
    }
}
