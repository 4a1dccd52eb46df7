//! Many devices that differ from the one that was identified, each tracked by every controller under the same seed.

use std::collections::BTreeMap;

use anyhow::{Context, Result, ensure};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use telepulse_actuator::failure::{Envelope, FailureCriteria, Mechanism};
use telepulse_actuator::statics::{Electrodes, Load};
use telepulse_actuator::twin::TwinModel;
use telepulse_actuator::variation::BatchScatter;
use telepulse_actuator::{ActuatorParameters, ActuatorSpec};
use telepulse_design::implement::ControllerRecipe;

use super::config::Study;
use super::outcome::Tracking;
use super::tracking::track_one;
use crate::station::device::Conditions;

/// Scatter between specimens. No source gives these for the paper's material: assumptions, in the range that its makers' tolerances and repeated
/// tests of acrylic films suggest.
pub const SCATTER: BatchScatter = BatchScatter {
    mu: 0.05,
    branches: 0.1,
    permittivity: 0.03,
    thickness: 0.02,
    damping: 0.1,
    prestretch: 0.0,
};
/// Drift of all moduli with age and temperature, uniform within plus and minus this. Assumption.
pub const DRIFT: f64 = 0.1;
/// Shift of the reference's offset, mm, uniform within plus and minus this: another bias.
pub const OFFSET_MM: f64 = 0.05;
/// Time before the judged window, s: the start transient is over in less.
const SETTLE_S: f64 = 5.0;
/// Judged window, s.
const WINDOW_S: f64 = 5.0;
/// Most samples of one campaign.
pub const SAMPLES_MAX: usize = 1_000_000;

/// What a campaign found of one controller.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Campaign {
    /// Devices.
    pub samples: usize,
    /// Seed of the draws.
    pub seed: u64,
    /// Devices on which the run was judged unstable.
    pub unstable: usize,
    /// Devices on which a voltage outside of the study's limits was commanded.
    pub voltage_violations: usize,
    /// Devices whose largest true field exceeded the breakdown law.
    pub field_violations: usize,
    /// Largest mean absolute error of the stable runs.
    pub worst_mean_abs_error_mm: Option<f64>,
    /// Median of it.
    pub median_mean_abs_error_mm: Option<f64>,
    /// The device as identified, in the same window and conditions.
    pub nominal_mean_abs_error_mm: Option<f64>,
    /// Number of the device with the largest error, or of the first unstable one: `--only N` runs it again.
    pub worst_sample: Option<u64>,
}

/// One device of a campaign and what it is exposed to.
#[derive(Debug, Clone)]
struct Specimen {
    parameters: ActuatorParameters,
    study: Study,
}

impl Specimen {
    /// Specimen number `idx`: the same for every controller, thread count and campaign length.
    fn draw(study: &Study, seed: u64, idx: u64) -> Result<Self> {
        let nominal = study.actuator.parameter_set.parameters();
        let scattered = SCATTER.draw(&nominal, seed, idx)?;
        let mut random = Pcg64Mcg::seed_from_u64(seed.rotate_left(17) ^ idx);
        let mut within = |half: f64| half * (2.0 * f64::from(random.next_u32()) / f64::from(u32::MAX) - 1.0);
        let mut spec: ActuatorSpec = scattered.spec().clone();
        let drift = 1.0 + within(DRIFT);
        spec.mu_pa *= drift;
        for branch in &mut spec.branches {
            branch.modulus_pa *= drift;
        }
        let mut own = study.clone();
        own.reference.offset_mm += within(OFFSET_MM);
        own.conditions.disturbance_n = within(study.conditions.disturbance_n);
        own.conditions.disturbance_start_s = SETTLE_S + 1.0;
        own.conditions.noise_mm *= 0.5 + within(0.5);
        own.actuator.seed = seed.wrapping_add(idx);
        Ok(Self { parameters: ActuatorParameters::new(spec)?, study: shortened(own) })
    }

    /// The device as identified, with the study's own conditions.
    fn nominal(study: &Study) -> Self {
        let parameters = study.actuator.parameter_set.parameters();
        Self { parameters, study: shortened(study.clone()) }
    }

    fn run(&self, twin: &TwinModel, name: &str, recipe: &ControllerRecipe) -> Result<Tracking> {
        let conditions = Conditions { disturbance: true, noise: true, ideal_laser: false };
        Ok(track_one(&self.study, twin, name, recipe, "both", conditions)?.result)
    }

    /// Whether the highest voltage of a run would break the membrane down where it hung.
    fn breaks_down(&self, run: &Tracking) -> Result<bool> {
        let Some(highest_v) = run.max_voltage_v else { return Ok(false) };
        let mut envelope = Envelope::new(&self.parameters.sheet()?, FailureCriteria::default())?;
        let load = Load::ForceN(self.parameters.weight_n());
        let state = envelope.at(load, Electrodes::VoltageV(highest_v))?;
        Ok(state.margins.iter().any(|m| m.mechanism == Mechanism::Breakdown && m.left < 0.0))
    }
}

fn shortened(mut study: Study) -> Study {
    study.reference.settle_s = SETTLE_S;
    study.reference.window_s = WINDOW_S;
    study
}

/// What one device did under one controller.
#[derive(Debug, Clone, Copy)]
struct Sample {
    idx: u64,
    error_mm: Option<f64>,
    voltage_violated: bool,
    field_violated: bool,
}

/// Runs `samples` devices under every recipe, on all cores; `done` is called after each device.
///
/// # Errors
/// Where a device cannot be built or run: a scatter that makes impossible devices is a mistake, not a result.
pub fn campaign(
    study: &Study,
    recipes: &[(String, ControllerRecipe)],
    samples: usize,
    seed: u64,
    done: &(dyn Fn() + Sync),
) -> Result<BTreeMap<String, Campaign>> {
    ensure!((1..=SAMPLES_MAX).contains(&samples), "--samples: found {samples}, allowed 1 to {SAMPLES_MAX}");
    let runs = (0..samples as u64)
        .into_par_iter()
        .map(|idx| {
            let row = device_under_all(study, recipes, seed, idx)
                .with_context(|| format!("device {idx} of seed {seed}"))?;
            done();
            Ok(row)
        })
        .collect::<Result<Vec<Vec<Sample>>>>()?;
    let nominal = Specimen::nominal(study);
    let twin = TwinModel::new(&nominal.parameters)?;
    let mut found = BTreeMap::new();
    for (column, (name, recipe)) in recipes.iter().enumerate() {
        let mine: Vec<Sample> = runs.iter().map(|row| row[column]).collect();
        let nominal_error = nominal.run(&twin, name, recipe)?.mean_abs_error_mm;
        found.insert(name.clone(), summarise(&mine, seed, nominal_error));
    }
    Ok(found)
}

/// Runs one device of a campaign again: by controller.
///
/// # Errors
/// As [`campaign`].
pub fn replay(
    study: &Study,
    recipes: &[(String, ControllerRecipe)],
    seed: u64,
    idx: u64,
) -> Result<BTreeMap<String, Tracking>> {
    let specimen = Specimen::draw(study, seed, idx)?;
    let twin = TwinModel::new(&specimen.parameters)?;
    recipes.iter().map(|(name, recipe)| Ok((name.clone(), specimen.run(&twin, name, recipe)?))).collect()
}

fn device_under_all(
    study: &Study,
    recipes: &[(String, ControllerRecipe)],
    seed: u64,
    idx: u64,
) -> Result<Vec<Sample>> {
    let specimen = Specimen::draw(study, seed, idx)?;
    let twin = TwinModel::new(&specimen.parameters)?;
    recipes
        .iter()
        .map(|(name, recipe)| {
            let run = specimen.run(&twin, name, recipe)?;
            let (low, high) = (study.control.min_v, study.control.max_v);
            Ok(Sample {
                idx,
                error_mm: run.mean_abs_error_mm,
                voltage_violated: run.min_voltage_v.is_some_and(|v| v < low)
                    || run.max_voltage_v.is_some_and(|v| v > high),
                field_violated: specimen.breaks_down(&run)?,
            })
        })
        .collect()
}

fn summarise(samples: &[Sample], seed: u64, nominal_mean_abs_error_mm: Option<f64>) -> Campaign {
    let mut errors: Vec<(f64, u64)> = samples.iter().filter_map(|s| Some((s.error_mm?, s.idx))).collect();
    errors.sort_by(|a, b| a.0.total_cmp(&b.0));
    let first_unstable = samples.iter().find(|s| s.error_mm.is_none()).map(|s| s.idx);
    Campaign {
        samples: samples.len(),
        seed,
        unstable: samples.len() - errors.len(),
        voltage_violations: samples.iter().filter(|s| s.voltage_violated).count(),
        field_violations: samples.iter().filter(|s| s.field_violated).count(),
        worst_mean_abs_error_mm: errors.last().map(|e| e.0),
        median_mean_abs_error_mm: errors.get(errors.len() / 2).map(|e| e.0),
        nominal_mean_abs_error_mm,
        worst_sample: first_unstable.or(errors.last().map(|e| e.1)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_a_summary_counts_and_names_the_worst() {
        let sample =
            |idx, error_mm| Sample { idx, error_mm, voltage_violated: idx == 1, field_violated: false };
        let found =
            summarise(&[sample(0, Some(0.2)), sample(1, Some(0.5)), sample(2, Some(0.1))], 9, Some(0.1));
        assert_eq!((found.unstable, found.voltage_violations, found.worst_sample), (0, 1, Some(1)));
        assert_eq!((found.worst_mean_abs_error_mm, found.median_mean_abs_error_mm), (Some(0.5), Some(0.2)));
        let found = summarise(&[sample(0, Some(0.2)), sample(3, None)], 9, None);
        assert_eq!((found.unstable, found.worst_sample), (1, Some(3)));
    }
}
