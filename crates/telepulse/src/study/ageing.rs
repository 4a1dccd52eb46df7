//! Ten hours of creep and a drift of the modulus, with and without adaptation.

use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};
use telepulse_actuator::twin::TwinModel;
use telepulse_actuator::{ActuatorParameters, MaxwellBranch};
use telepulse_design::identify::{Controlled, PlantModel};
use telepulse_design::implement::{ControllerRecipe, Provenance};
use telepulse_lti::TransferFunction;

use super::config::Study;
use super::controllers::{Certified, certify};
use super::judge;
use super::models::Models;
use crate::station::adaptive::{self, Adapted, CertifiedSet, Later};
use crate::station::control;
use crate::station::device::{self, Conditions};
use crate::station::run::{RunPlan, run};

/// The paper's reference on a fresh and an aged device.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Ageing {
    /// Time at the held voltage before the runs.
    pub hours: f64,
    /// Relative change of the network's modulus.
    pub drift: f64,
    /// Mean absolute error of the fresh device, adaptation on.
    pub mean_abs_error_fresh_mm: Option<f64>,
    /// Mean absolute error of the device that has softened, with adaptation, on the whole reference.
    pub mean_abs_error_aged_mm: Option<f64>,
    /// Fresh without adaptation.
    pub mean_abs_error_fresh_without_adaptation_mm: Option<f64>,
    /// Each drift apart.
    pub cases: Vec<AgedCase>,
    /// Where the estimator may go.
    pub certified_set: CertifiedSet,
}

/// One aged device.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AgedCase {
    /// Relative change of the network's modulus.
    pub drift: f64,
    /// Share of the reference that was followed: a hardened device cannot reach all of it.
    pub reference_scale: f64,
    /// The fresh device on the same reference, with adaptation.
    pub mean_abs_error_fresh_mm: Option<f64>,
    /// With adaptation.
    pub mean_abs_error_mm: Option<f64>,
    /// Without.
    pub mean_abs_error_without_adaptation_mm: Option<f64>,
    /// Share of the judged window at the highest voltage, with adaptation.
    pub share_at_highest_voltage: f64,
    /// By how much the rest position has crept.
    pub zero_shift_mm: f64,
    /// What the estimator found.
    pub adapted: Adapted,
}

/// Runs a study's reference fresh and after `hours` with a drift of `+-drift` of the network's modulus.
///
/// The material of an aged device is what it is at the end throughout the hours of creep. A branch of two hours is added to the
/// study's device, fresh and aged alike, so that ten hours have something to creep. The laser's zero is set at rest before each
/// run: the weight sinks by more than the stroke as the network softens.
///
/// # Errors
/// Where a device has no solution, or `best` is not certified.
pub fn ageing(
    study: &Study,
    models: &Models,
    best: &ControllerRecipe,
    hours: f64,
    drift: f64,
) -> Result<Ageing> {
    let set = certified_set(study, models, best)?;
    let fresh = case(study, best, &set, &Age { hours: 0.0, drift: 0.0, reference_scale: 1.0 })?;
    let fresh_small =
        case(study, best, &set, &Age { hours: 0.0, drift: 0.0, reference_scale: HARDENED_SCALE })?;
    let softened = case(study, best, &set, &Age { hours, drift: -drift, reference_scale: 1.0 })?;
    let hardened = case(study, best, &set, &Age { hours, drift, reference_scale: HARDENED_SCALE })?;
    // Beyond what it can reach: shown so that nobody takes the smaller reference for the whole.
    let hardened_whole = case(study, best, &set, &Age { hours, drift, reference_scale: 1.0 })?;
    let aged = softened.mean_abs_error_mm;
    let beside = |case: AgedCase, fresh: &AgedCase| AgedCase {
        mean_abs_error_fresh_mm: fresh.mean_abs_error_mm,
        ..case
    };
    let cases =
        vec![beside(softened, &fresh), beside(hardened, &fresh_small), beside(hardened_whole, &fresh)];
    Ok(Ageing {
        hours,
        drift,
        mean_abs_error_fresh_mm: fresh.mean_abs_error_mm,
        mean_abs_error_aged_mm: aged,
        mean_abs_error_fresh_without_adaptation_mm: fresh.mean_abs_error_without_adaptation_mm,
        cases,
        certified_set: set,
    })
}

/// The twin of the study's device with a network of `1 + drift` of its modulus and a branch that creeps for hours.
///
/// # Errors
/// Where the membrane has no solution.
pub fn aged_twin(study: &Study, drift: f64) -> Result<TwinModel> {
    let mut spec = study.actuator.parameter_set.parameters().spec().clone();
    spec.mu_pa *= 1.0 + drift;
    let modulus_pa = spec.branches.last().map_or(0.1 * spec.mu_pa, |slowest| slowest.modulus_pa);
    spec.branches.push(MaxwellBranch { modulus_pa, relaxation_time_s: 7200.0 });
    TwinModel::new(&ActuatorParameters::new(spec)?).context("the aged membrane has no reduced twin")
}

/// How old a device is, and what it is asked to follow.
struct Age {
    hours: f64,
    drift: f64,
    reference_scale: f64,
}

/// Share of the reference that a device with a network 30 % harder still reaches below its highest voltage.
const HARDENED_SCALE: f64 = 0.6;
/// What the feedforward sees beyond the end of the judged window, s.
const BEYOND_S: f64 = 1.0;
/// Fraction of full scale at which the plate is held for hours.
const HOLD: f64 = 0.7;
/// Rest at zero volts before the laser's zero is set, s.
const REST_S: f64 = 120.0;
/// Periods of the reference before the judged one.
const PERIODS_BEFORE: f64 = 4.0;

fn case(study: &Study, best: &ControllerRecipe, set: &CertifiedSet, age: &Age) -> Result<AgedCase> {
    let Age { hours, drift, reference_scale } = *age;
    let twin = aged_twin(study, drift)?;
    let conditions = Conditions { noise: true, ..Conditions::default() };
    let rig = device::displacement(study, &twin, conditions)?;
    let (rig, scale) = Later::after_hold(rig, study, hours, HOLD * study.control.full_scale_v, REST_S)?;
    let rate_hz = study.control.sample_rate_hz;
    let window_start = (PERIODS_BEFORE * study.reference.window_s * rate_hz) as usize;
    let n = window_start + (study.reference.window_s * rate_hz) as usize;
    let n_known = n + (BEYOND_S * rate_hz) as usize;
    let mut reference: Vec<f64> =
        (0..n_known).map(|k| reference_scale * study.reference.at(k as f64 / rate_hz)).collect();
    let drive = judge::DriveRange::of(study);
    let (learned, adapted) = adaptive::run(study, &mut rig.clone(), scale, best, &reference, n, set)?;
    let judged = judge::tracking(&learned, window_start, &learned.true_output, drive);
    let mut feedforward = control::feedforward(best, &reference);
    feedforward.truncate(n);
    reference.truncate(n);
    let plan = RunPlan { feedforward, reference, watch: device::watch(study) };
    let mut law = control::from_recipe(study, best, Controlled::Displacement, scale)?;
    let plain = run(&mut rig.clone(), &mut law, &plan)?;
    let without = judge::tracking(&plain, window_start, &plain.true_output, drive);
    let window = learned.voltage_v.get(window_start..).unwrap_or_default();
    let at_end = window.iter().filter(|v| **v >= drive.max_v).count();
    Ok(AgedCase {
        drift,
        reference_scale,
        mean_abs_error_fresh_mm: None,
        mean_abs_error_mm: judged.mean_abs_error_mm,
        mean_abs_error_without_adaptation_mm: without.mean_abs_error_mm,
        share_at_highest_voltage: at_end as f64 / window.len().max(1) as f64,
        zero_shift_mm: rig.zero_mm,
        adapted,
    })
}

/// The largest box of plant gain times loop gain and of stiffness in which the loop's certificate holds, by verifying it again.
///
/// **Method**: the nominal plant with another stiffness (gain, damping and circuit kept) and its bound, both scaled by the gain, are verified on a
/// grid: first the stiffnesses around 1 that bear a gain of 0.8 to 1.25, then the gains around 1 that all of these bear.
///
/// **Accuracy**: between the points of the grid (steps of 10 % and 5 %) nothing is verified.
///
/// # Errors
/// Where `best` is not certified, or a plant cannot be formed.
pub fn certified_set(study: &Study, models: &Models, best: &ControllerRecipe) -> Result<CertifiedSet> {
    let Provenance::Certified(evidence) = best.provenance() else {
        anyhow::bail!("adaptation starts from a certified controller: {}", best.provenance());
    };
    let holds = |gain: f64, stiffness: f64| -> Result<bool> {
        let model = changed(&evidence.model, models, gain, stiffness)?;
        Ok(matches!(certify(study, &model, &evidence.controller)?, Certified::Judged(c) if c.holds()))
    };
    let all = |gains: &[f64], stiffness: f64| -> Result<bool> {
        for gain in gains {
            if !holds(*gain, stiffness)? {
                return Ok(false);
            }
        }
        Ok(true)
    };
    let reach = |step: f64, n: usize, ok: &dyn Fn(f64) -> Result<bool>| -> Result<f64> {
        let mut reached = 1.0;
        for _ in 0..n {
            if !ok(reached * step)? {
                break;
            }
            reached *= step;
        }
        Ok(reached)
    };
    ensure!(holds(1.0, 1.0)?, "the certificate of the recipe does not hold as it stands");
    let near = [0.8, 1.0, 1.25];
    let stiffness_max = reach(1.1, 8, &|s| all(&near, s))?;
    let stiffness_min = reach(1.0 / 1.1, 8, &|s| all(&near, s))?;
    let stiffnesses = [stiffness_min, stiffness_min.sqrt(), 1.0, stiffness_max.sqrt(), stiffness_max];
    let bears = |gain: f64| -> Result<bool> {
        for stiffness in stiffnesses {
            if !holds(gain, stiffness)? {
                return Ok(false);
            }
        }
        Ok(true)
    };
    Ok(CertifiedSet {
        loop_gain_max: reach(1.05, 20, &bears)?,
        loop_gain_min: reach(1.0 / 1.05, 20, &bears)?,
        stiffness_min,
        stiffness_max,
    })
}

fn changed(model: &PlantModel, models: &Models, gain: f64, stiffness: f64) -> Result<PlantModel> {
    let fit = &models.square_root.fit;
    let omega_squared = stiffness * fit.omega_n_rad_s.powi(2);
    let damping = 2.0 * fit.zeta * fit.omega_n_rad_s;
    let plate = TransferFunction::new(
        &[gain * fit.dc_gain_mm_per_unit * omega_squared],
        &[1.0, damping, omega_squared],
    )?;
    let circuit = TransferFunction::new(&[1.0], &[fit.rc_s, 1.0])?;
    let uncertainty = model.uncertainty.as_ref().map(|bound| bound.scale(gain)).transpose()?;
    Ok(PlantModel { nominal: plate.multiply(&circuit)?, uncertainty, ..model.clone() })
}
