//! A run that learns how its plant has changed and schedules feedforward and loop gain anew, inside of what is certified.

use anyhow::{Context, Result, anyhow};
use serde::{Deserialize, Serialize};
use telepulse_actuator::rig::DisplacementRig;
use telepulse_design::identify::{Controlled, GreyBoxModel};
use telepulse_design::implement::{ControllerRecipe, Feedforward, FlatStepper, PlantChange};
use telepulse_rt::{
    CycleInputs, Drive, DriveFault, DriveVoltage, Estimator, EstimatorSettings, MonotonicNs, N_PARAMETERS,
    Reading, Sensor, SensorFault, SensorScale, Supervisor, SupervisorSettings,
};

use super::run::{ErrorWatch, RunRecord, Truth};
use super::{control, device};
use crate::study::config::Study;

/// The changes of the plant for which the loop is certified, with the loop gain that the schedule gives them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CertifiedSet {
    /// Plant gain times loop gain, over the identified one, lowest.
    pub loop_gain_min: f64,
    /// Highest.
    pub loop_gain_max: f64,
    /// Stiffness over the identified one, lowest.
    pub stiffness_min: f64,
    /// Highest.
    pub stiffness_max: f64,
}

/// What the estimator did in a run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Adapted {
    /// Gain of the plant over the identified one, at the end.
    pub gain: f64,
    /// Stiffness over the identified one, at the end.
    pub stiffness: f64,
    /// Change of the spring's curvature, in linear stiffnesses per mm, at the end.
    pub curvature_per_mm: f64,
    /// Push of creep, as a displacement, at the end.
    pub offset_mm: f64,
    /// Gain of the law at the end.
    pub law_gain: f64,
    /// Share of updates in which the gain stood still for want of excitation.
    pub frozen_share: f64,
    /// Share of updates in which the stiffness stood still for want of excitation.
    pub stiffness_frozen_share: f64,
    /// Updates that were held back at the edge of the certified set.
    pub updates_at_edge: usize,
}

/// A rig whose clock starts later than its own.
#[derive(Debug, Clone)]
pub struct Later {
    /// The rig.
    pub rig: DisplacementRig,
    /// Its time when this clock starts.
    pub start: MonotonicNs,
    /// Its true displacement that counts as zero.
    pub zero_mm: f64,
}

impl Sensor for Later {
    fn read(&mut self, now: MonotonicNs) -> Result<Reading, SensorFault> {
        self.rig.read(MonotonicNs(self.start.0 + now.0))
    }
}

impl Drive for Later {
    fn apply(&mut self, now: MonotonicNs, voltage: DriveVoltage) -> Result<(), DriveFault> {
        self.rig.apply(MonotonicNs(self.start.0 + now.0), voltage)
    }
}

/// Time between two updates, s.
const UPDATE_S: f64 = 0.02;
/// Corner of the filters before the estimator, rad/s: above a pulse's strongest harmonics.
const CORNER_RAD_S: f64 = 20.0;
/// Time in which the schedule follows the estimate, s.
const SCHEDULE_S: f64 = 1.0;
/// Memory of the estimator, s: one period of the paper's reference.
const MEMORY_S: f64 = 20.0;
/// The filters have settled after this, s.
const FILTERS_S: f64 = 2.0;
/// Range of the law's gain.
const LAW_GAIN: [f64; 2] = [0.5, 2.0];

/// Follows the first `n_ticks` of a reference in mm with a recipe, adapting inside of `set`; the feedforward sees the rest ahead.
///
/// # Errors
/// Where the recipe has no flatness-based feedforward or the rig cannot run.
pub fn run(
    study: &Study,
    rig: &mut Later,
    scale: SensorScale,
    recipe: &ControllerRecipe,
    reference: &[f64],
    n_ticks: usize,
    set: &CertifiedSet,
) -> Result<(RunRecord, Adapted)> {
    let Some(Feedforward::Flat(flat)) = &recipe.settings().feedforward else {
        return Err(anyhow!("adaptation needs a recipe with a flatness-based feedforward"));
    };
    let mut control = control::from_recipe(study, recipe, Controlled::Displacement, scale)?;
    let mut stepper = FlatStepper::new(flat, reference)?;
    let ts = study.sample_time_s();
    let mut learner = Learner::new(flat.model(), ts, set)?;
    let tick_at = |k: usize| MonotonicNs((k as f64 * ts * 1e9).round() as u64);
    let ErrorWatch { limit, time_s } = device::watch(study);
    let settings = SupervisorSettings {
        error_limit: limit,
        error_time_s: time_s,
        period_s: ts,
        overrun_tolerance_s: 0.1 * ts,
    };
    let mut supervisor = Supervisor::new(settings, control.settings().limits)?
        .arm(rig, tick_at(0))
        .map_err(|tripped| anyhow!("the rig cannot be armed: {}", tripped.reason()))?
        .start(tick_at(0));
    let mut record = RunRecord { sample_time_s: ts, ..RunRecord::default() };
    for (k, r) in reference.iter().take(n_ticks).enumerate() {
        let inputs = CycleInputs { reference: *r, feedforward: stepper.command() };
        let output = match supervisor.tick(rig, &mut control, tick_at(k), inputs) {
            Ok(output) => output,
            Err(reason) => {
                record.trip = Some(reason.to_string());
                break;
            }
        };
        record.reference.push(*r);
        record.true_output.push(rig.rig.true_displacement_mm() - rig.zero_mm);
        record.measured.push(output.measured);
        record.voltage_v.push(output.voltage_v);
        record.power_w.push(rig.rig.supply_power_w());
        if let Some((change, law_gain)) =
            learner.take(output.measured, output.voltage_v / study.control.full_scale_v)
        {
            stepper.schedule(change)?;
            control.set_law_gain(law_gain)?;
        }
    }
    Ok((record, learner.adapted()))
}

/// Three equal lags in a row.
#[derive(Debug, Clone, Copy, Default)]
struct Lags([f64; 3]);

impl Lags {
    fn take(&mut self, input: f64, share: f64) {
        let mut from = input;
        for lag in &mut self.0 {
            *lag += share * (from - *lag);
            from = *lag;
        }
    }

    /// The filtered signal and its first two derivatives, exact for the filter's states.
    fn derivatives(&self, corner: f64) -> [f64; 3] {
        let [a, b, c] = self.0;
        [c, corner * (b - c), corner * corner * (a - 2.0 * b + c)]
    }
}

/// Makes equations of what is measured, in mm: every term of the motion over the identified linear stiffness, filtered alike.
///
/// ```text
///   -S(x) = gain D(x, w) - (1/stiffness) (x'' + d x' + creep) + curvature x^2 + offset
/// ```
struct Learner {
    model: GreyBoxModel,
    stiffness: f64,
    estimator: Estimator,
    set: CertifiedSet,
    ts: f64,
    n_ticks: usize,
    circuit_unit: f64,
    dashpots_mm: Option<Vec<f64>>,
    spring: Lags,
    drive: Lags,
    motion: Lags,
    creep: Lags,
    square: Lags,
    scheduled: [f64; N_PARAMETERS],
    n_updates: usize,
    n_frozen: usize,
    n_stiffness_frozen: usize,
    n_at_edge: usize,
}

impl Learner {
    fn new(model: &GreyBoxModel, ts: f64, set: &CertifiedSet) -> Result<Self> {
        let stiffness = -model.pull(0.0, 0.0)[1];
        let start = [1.0, 1.0, 0.0, 0.0];
        let estimator = Estimator::new(EstimatorSettings {
            start,
            low: [set.loop_gain_min / LAW_GAIN[1], 1.0 / set.stiffness_max, -0.5, -0.5],
            high: [set.loop_gain_max / LAW_GAIN[0], 1.0 / set.stiffness_min, 0.5, 0.5],
            spread: [0.3, 0.3, 0.1, 0.1],
            forgetting: (-UPDATE_S / MEMORY_S).exp(),
            noise: 2e-3,
            excitation_min: [1e-4, 1e-5, 1e-5, 1e-4],
        })?;
        let lags = Lags::default();
        Ok(Self {
            model: model.clone(),
            stiffness,
            estimator,
            set: *set,
            ts,
            n_ticks: 0,
            circuit_unit: 0.0,
            dashpots_mm: None,
            spring: lags,
            drive: lags,
            motion: lags,
            creep: lags,
            square: lags,
            scheduled: start,
            n_updates: 0,
            n_frozen: 0,
            n_stiffness_frozen: 0,
            n_at_edge: 0,
        })
    }

    /// Takes one tick; now and then says what to schedule.
    fn take(&mut self, x: f64, voltage_unit: f64) -> Option<(PlantChange, f64)> {
        let ts = self.ts;
        let branches = self.model.branches();
        // Runs start at rest, at zero.
        let dashpots = self.dashpots_mm.get_or_insert_with(|| vec![0.0; branches.len()]);
        let mut creep = 0.0;
        for (xi, branch) in dashpots.iter_mut().zip(branches) {
            creep += branch.stiffness_per_s2 * (x - *xi);
            *xi += (1.0 - (-ts / branch.relaxation_time_s).exp()) * (x - *xi);
        }
        let w = self.circuit_unit * self.circuit_unit;
        let spring = self.model.pull(x, 0.0)[0];
        let drive = self.model.pull(x, w)[0] - spring;
        let share = 1.0 - (-CORNER_RAD_S * ts).exp();
        for (lags, input) in [
            (&mut self.spring, spring / self.stiffness),
            (&mut self.drive, drive / self.stiffness),
            (&mut self.motion, x),
            (&mut self.creep, creep / self.stiffness),
            (&mut self.square, x * x),
        ] {
            lags.take(input, share);
        }
        self.circuit_unit += (1.0 - (-ts / self.model.rc_s()).exp()) * (voltage_unit - self.circuit_unit);
        self.n_ticks += 1;
        let per_update = (UPDATE_S / ts).round().max(1.0) as usize;
        let settled = self.n_ticks as f64 * ts > FILTERS_S;
        (settled && self.n_ticks.is_multiple_of(per_update)).then(|| self.update())
    }

    fn update(&mut self) -> (PlantChange, f64) {
        let [_, velocity, acceleration] = self.motion.derivatives(CORNER_RAD_S);
        let motion =
            (acceleration + self.model.damping_per_s() * velocity) / self.stiffness + self.creep.0[2];
        let phi = [self.drive.0[2], -motion, self.square.0[2], 1.0];
        let update = self.estimator.update(phi, -self.spring.0[2]);
        self.n_updates += 1;
        self.n_frozen += usize::from(update.frozen[0]);
        self.n_stiffness_frozen += usize::from(update.frozen[1]);
        self.n_at_edge += usize::from(update.at_edge[0] || update.at_edge[1]);
        let share = 1.0 - (-UPDATE_S / SCHEDULE_S).exp();
        for (scheduled, found) in self.scheduled.iter_mut().zip(self.estimator.estimate()) {
            *scheduled += share * (found - *scheduled);
        }
        (self.change(), self.law_gain())
    }

    fn change(&self) -> PlantChange {
        let [gain, compliance, curvature_per_mm, offset_mm] = self.scheduled;
        PlantChange { gain, stiffness: 1.0 / compliance, curvature_per_mm, offset_mm }
    }

    /// What keeps the product of plant and law where it was certified.
    fn law_gain(&self) -> f64 {
        let gain = self.scheduled[0];
        let [low, high] = [self.set.loop_gain_min / gain, self.set.loop_gain_max / gain];
        (1.0 / gain).clamp(LAW_GAIN[0], LAW_GAIN[1]).clamp(low, high)
    }

    fn adapted(&self) -> Adapted {
        let PlantChange { gain, stiffness, curvature_per_mm, offset_mm } = self.change();
        let n = self.n_updates.max(1) as f64;
        Adapted {
            gain,
            stiffness,
            curvature_per_mm,
            offset_mm,
            law_gain: self.law_gain(),
            frozen_share: self.n_frozen as f64 / n,
            stiffness_frozen_share: self.n_stiffness_frozen as f64 / n,
            updates_at_edge: self.n_at_edge,
        }
    }
}

impl Truth for Later {
    fn true_output(&self) -> f64 {
        self.rig.true_displacement_mm() - self.zero_mm
    }

    fn supply_power_w(&self) -> f64 {
        self.rig.supply_power_w()
    }

    fn fault(&self) -> Option<String> {
        self.rig.fault().map(ToString::to_string)
    }

    fn sensing(&self) -> Option<telepulse_actuator::rig::SensingRecord> {
        None
    }
}

impl Later {
    /// A rig after hours at a voltage and a rest at zero volts: its clock starts anew, its sensor's zero is where it rests now.
    ///
    /// # Errors
    /// Where the rig cannot be driven or read.
    pub fn after_hold(
        mut rig: DisplacementRig,
        study: &Study,
        hours: f64,
        hold_v: f64,
        rest_s: f64,
    ) -> Result<(Self, SensorScale)> {
        let limits = telepulse_rt::Limits::new(0.0, study.control.max_v, f64::INFINITY)?;
        let hold = limits.clamp(hold_v, limits.off(), 1.0).voltage;
        let mut now_s = 0.0;
        let at = |s: f64| MonotonicNs((s * 1e9).round() as u64);
        let refused = |_| anyhow!("the drive refuses the hold");
        rig.apply(at(0.0), hold).map_err(refused)?;
        // A rig bridges an hour at most.
        let n = (2.0 * hours).ceil();
        for _ in 0..n as usize {
            now_s += 3600.0 * hours / n;
            rig.read(at(now_s)).context("the laser while the plate is held")?;
        }
        rig.apply(at(now_s), limits.off()).map_err(refused)?;
        now_s += rest_s;
        let mut sum = 0.0;
        let n_readings = 2000;
        for k in 0..n_readings {
            sum += rig.read(at(now_s + f64::from(k) * 5e-4)).context("the laser's zero")?.value;
        }
        let start = at(now_s + f64::from(n_readings) * 5e-4);
        let zero_mm = rig.true_displacement_mm();
        let scale = SensorScale { gain: 1.0, offset: -sum / f64::from(n_readings) };
        Ok((Self { rig, start, zero_mm }, scale))
    }
}
