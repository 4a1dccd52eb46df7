//! From a recipe to what the cycle runs: `rt` has no allocator and cannot read recipes itself.

use anyhow::{Result, ensure};
use telepulse_design::identify::{Controlled, InputLinearisation as DesignInput};
use telepulse_design::implement::{self as recipe, ControllerRecipe, Law, ReferencePath};
use telepulse_rt::{
    AntiWindup, ComplexMode, ControlLaw, ControlLoop, ControlSettings, ErrorSign, FilterStart,
    InputLinearisation, Limits, LowPass, ModalDeltaController, Pid, PidAntiWindup, PidGains, RealMode,
    SensorScale, SetpointWeights,
};

use crate::study::config::Study;

/// The same choice in the words of `rt`.
#[must_use]
pub fn linearisation(input: DesignInput) -> InputLinearisation {
    match input {
        DesignInput::None => InputLinearisation::Identity,
        DesignInput::SquareRoot => InputLinearisation::SquareRoot,
    }
}

/// A loop of the study without filters: what is commanded is the feedforward alone, if the law is open.
///
/// # Errors
/// Where the study's limits are refused.
pub fn open_loop(
    study: &Study,
    sensor_scale: SensorScale,
    linearisation: InputLinearisation,
    law: ControlLaw,
) -> Result<ControlLoop> {
    Ok(ControlLoop::new(ControlSettings {
        sample_time_s: study.sample_time_s(),
        sensor_scale,
        measurement_filter: None,
        reference_filter: None,
        filter_start: FilterStart::AtFirstSample,
        law,
        error_sign: ErrorSign::Positive,
        trim: 0.0,
        linearisation,
        full_scale_v: study.control.full_scale_v,
        limits: Limits::new(study.control.min_v, study.control.max_v, study.control.slew_v_per_s)?,
        anti_windup: AntiWindup::None,
    })?)
}

/// The loop that a recipe describes.
///
/// # Errors
/// Where the recipe was made for another quantity or sample time, reads further ahead than the play-out delay, or asks for more
/// voltage than the study allows.
pub fn from_recipe(
    study: &Study,
    recipe: &ControllerRecipe,
    controlled: Controlled,
    sensor_scale: SensorScale,
) -> Result<ControlLoop> {
    let settings = recipe.settings();
    ensure!(
        settings.controlled == controlled,
        "the recipe controls {}, allowed is {} in this mode",
        words(settings.controlled),
        words(controlled)
    );
    if let Some(preview) = &settings.feedforward {
        ensure!(
            preview.horizon_s() <= study.pulse.playout_delay_s,
            "the recipe reads the reference {} s ahead, allowed is up to the study's `pulse.playout_delay_s` = {} s",
            preview.horizon_s(),
            study.pulse.playout_delay_s
        );
    }
    let sample_time_s = study.sample_time_s();
    let found_s = settings.sample_time_s.seconds();
    ensure!(
        (found_s / sample_time_s - 1.0).abs() < 1e-9,
        "the recipe is for a sample time of {found_s} s, allowed is the study's {sample_time_s} s"
    );
    let limits = settings.limits;
    ensure!(
        limits.max_v <= study.control.max_v && limits.min_v >= study.control.min_v,
        "the recipe asks for {} to {} V, allowed are the study's {} to {} V",
        limits.min_v,
        limits.max_v,
        study.control.min_v,
        study.control.max_v
    );
    // The slower of the two: a recipe may be gentler than the study, not harsher.
    let slew_v_per_s = limits.slew_v_per_s.unwrap_or(f64::INFINITY).min(study.control.slew_v_per_s);
    let filter =
        settings.measurement_filter_rad_s.map(|corner| LowPass::new(corner, sample_time_s)).transpose()?;
    let hold = settings.anti_windup == recipe::AntiWindup::HoldOutward;
    Ok(ControlLoop::new(ControlSettings {
        sample_time_s,
        sensor_scale,
        measurement_filter: filter,
        reference_filter: match settings.reference_path {
            ReferencePath::Direct => None,
            ReferencePath::Filtered => filter,
        },
        filter_start: FilterStart::AtFirstSample,
        law: law(recipe.law(), settings)?,
        error_sign: ErrorSign::Positive,
        trim: settings.operating_point.bias_unit,
        linearisation: linearisation(settings.input_linearisation),
        full_scale_v: settings.operating_point.full_scale_v,
        limits: Limits::new(limits.min_v, limits.max_v, slew_v_per_s)?,
        anti_windup: if hold { AntiWindup::HoldOutward } else { AntiWindup::None },
    })?)
}

fn words(controlled: Controlled) -> &'static str {
    match controlled {
        Controlled::Displacement => "the displacement of the plate",
        Controlled::CellRelief => "the relief of the load cell",
    }
}

fn law(law: &Law, settings: &recipe::RecipeSettings) -> Result<ControlLaw> {
    Ok(match law {
        Law::StateSpace(modal) => {
            let real: Vec<RealMode> =
                modal.real.iter().map(|m| RealMode { lambda: m.lambda, b: m.b, c: m.c }).collect();
            let complex: Vec<ComplexMode> = modal
                .complex
                .iter()
                .map(|m| ComplexMode { sigma: m.sigma, omega: m.omega, b: m.b, c: m.c })
                .collect();
            ControlLaw::ModalDelta(ModalDeltaController::new(&real, &complex, modal.d)?)
        }
        Law::Pid(pid) => {
            let gains = PidGains { p: pid.p, i_per_s: pid.i_per_s, d_s: pid.d_s, n_rad_s: pid.n_rad_s };
            let anti_windup = match settings.anti_windup {
                recipe::AntiWindup::None => PidAntiWindup::None,
                recipe::AntiWindup::HoldOutward => PidAntiWindup::Clamping,
                recipe::AntiWindup::BackCalculation { tracking_time_s } => {
                    PidAntiWindup::BackCalculation { tracking_time_s }
                }
            };
            let weights = settings
                .setpoint_weights
                .map_or_else(SetpointWeights::default, |w| SetpointWeights { b: w.b, c: w.c });
            let pid = Pid::new(gains, settings.sample_time_s.seconds(), anti_windup)?;
            ControlLaw::Pid(pid.with_setpoint_weights(weights)?)
        }
    })
}

/// The feedforward command of a recipe for a whole reference in mm from rest; empty where it has none.
#[must_use]
pub fn feedforward(recipe: &ControllerRecipe, reference_mm: &[f64]) -> Vec<f64> {
    recipe.settings().feedforward_command(reference_mm).unwrap_or_default()
}
