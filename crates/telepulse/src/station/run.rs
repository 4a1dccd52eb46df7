//! A supervised run: ticks a rig through a reference and keeps what happened.

use anyhow::{Result, anyhow};
use serde::Serialize;
use telepulse_actuator::rig::SensingRecord;
use telepulse_rt::{
    ControlLoop, CycleInputs, CycleOutput, Drive, MonotonicNs, Sensor, Supervisor, SupervisorSettings,
    TripReason,
};

/// What may be known about a virtual rig when a run is judged. No controller and no identification sees it.
pub trait Truth {
    /// The controlled quantity without sensor noise: mm from the rest position, or N on the load cell.
    fn true_output(&self) -> f64;
    /// Power drawn from the supply, in W; a negative current counts as zero.
    fn supply_power_w(&self) -> f64;
    /// Why the device moves no further or tells nothing, where that happened.
    fn fault(&self) -> Option<String>;
    /// How far the readings of self-sensing were from the truth, where the rig has it.
    fn sensing(&self) -> Option<SensingRecord>;
}

/// What a run is to follow, tick by tick.
#[derive(Debug, Clone)]
pub struct RunPlan {
    /// Reference in the controlled variable's unit.
    pub reference: Vec<f64>,
    /// Feedforward command, unit; as long as the reference, or empty for none.
    pub feedforward: Vec<f64>,
    /// When the supervisor ends the run.
    pub watch: ErrorWatch,
}

/// The supervisor ends a run whose error stays above `limit` for longer than `time_s`.
#[derive(Debug, Clone, Copy)]
pub struct ErrorWatch {
    /// In the controlled variable's unit; infinite for none.
    pub limit: f64,
    /// In seconds.
    pub time_s: f64,
}

impl ErrorWatch {
    /// No watch: for open-loop experiments, where the error means nothing.
    pub const OFF: Self = Self { limit: f64::INFINITY, time_s: 0.0 };
}

/// What happened in a run. All series have one value for each tick.
#[derive(Debug, Clone, Default, Serialize)]
pub struct RunRecord {
    /// Time between two ticks.
    pub sample_time_s: f64,
    /// Reference, controlled variable's unit.
    pub reference: Vec<f64>,
    /// The controlled quantity without noise, in the rig's unit (mm, N).
    pub true_output: Vec<f64>,
    /// Scaled measurement before its filter, controlled variable's unit.
    pub measured: Vec<f64>,
    /// Voltage commanded.
    pub voltage_v: Vec<f64>,
    /// Voltage that the feedforward alone would command, without limits; empty where there is none.
    pub feedforward_v: Vec<f64>,
    /// Supply power.
    pub power_w: Vec<f64>,
    /// Why the supervisor ended the run, if it did.
    pub trip: Option<String>,
    /// How far the readings of self-sensing were from the truth, where it was used.
    #[serde(skip)]
    pub sensing: Option<SensingRecord>,
}

impl RunRecord {
    /// Number of ticks that ran.
    #[must_use]
    pub fn len(&self) -> usize {
        self.measured.len()
    }

    /// True where no tick ran.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.measured.is_empty()
    }

    /// Highest voltage of the run.
    #[must_use]
    pub fn max_voltage_v(&self) -> f64 {
        self.voltage_v.iter().copied().fold(f64::NEG_INFINITY, f64::max)
    }

    /// Lowest voltage of the run.
    #[must_use]
    pub fn min_voltage_v(&self) -> f64 {
        self.voltage_v.iter().copied().fold(f64::INFINITY, f64::min)
    }
}

/// Arms the rig, ticks it through `inputs` under the supervisor, and leaves it at zero volts.
///
/// `each` sees every tick that ran: its index, what the cycle did, and the rig.
/// Returns why the supervisor ended the run early, if it did.
///
/// # Errors
/// Where the rig cannot be armed, the supervisor's settings are refused, or the drive does not return to zero volts.
pub fn tick_through<R: Sensor + Drive>(
    rig: &mut R,
    control: &mut ControlLoop,
    inputs: impl Iterator<Item = CycleInputs>,
    watch: ErrorWatch,
    mut each: impl FnMut(usize, &CycleOutput, &R),
) -> Result<Option<TripReason>> {
    let sample_time_s = control.settings().sample_time_s;
    let limits = control.settings().limits;
    let settings = SupervisorSettings {
        error_limit: watch.limit,
        error_time_s: watch.time_s,
        period_s: sample_time_s,
        overrun_tolerance_s: 0.1 * sample_time_s,
    };
    let tick_at = |tick_idx: usize| MonotonicNs((tick_idx as f64 * sample_time_s * 1e9).round() as u64);
    let mut supervisor = Supervisor::new(settings, limits)?
        .arm(rig, tick_at(0))
        .map_err(|tripped| anyhow!("the rig cannot be armed: {}", tripped.reason()))?
        .start(tick_at(0));
    let mut n_ticks = 0;
    for (tick_idx, inputs) in inputs.enumerate() {
        match supervisor.tick(rig, control, tick_at(tick_idx), inputs) {
            Ok(output) => each(tick_idx, &output, rig),
            // The cycle has commanded zero volts already.
            Err(reason) => return Ok(Some(supervisor.trip(reason).reason())),
        }
        n_ticks = tick_idx + 1;
    }
    let lowest = supervisor.finish().voltage();
    rig.apply(tick_at(n_ticks), lowest)
        .map_err(|fault| anyhow!("the drive did not return to zero volts: {fault}"))?;
    Ok(None)
}

/// Runs a plan and keeps what happened.
///
/// A trip ends the run early: the record holds what was measured until then, and the reason.
///
/// # Errors
/// As [`tick_through`].
pub fn run<R: Sensor + Drive + Truth>(
    rig: &mut R,
    control: &mut ControlLoop,
    plan: &RunPlan,
) -> Result<RunRecord> {
    let sample_time_s = control.settings().sample_time_s;
    let mut record = RunRecord { sample_time_s, ..RunRecord::with_capacity(plan.reference.len()) };
    let settings = control.settings();
    let volts = |u: &f64| settings.linearisation.volts(u + settings.trim, settings.full_scale_v);
    record.feedforward_v = plan.feedforward.iter().map(volts).collect();
    let inputs = plan.reference.iter().enumerate().map(|(tick_idx, &reference)| CycleInputs {
        reference,
        feedforward: plan.feedforward.get(tick_idx).copied().unwrap_or(0.0),
    });
    let trip = tick_through(rig, control, inputs, plan.watch, |tick_idx, output, rig| {
        record.reference.push(plan.reference[tick_idx]);
        record.true_output.push(rig.true_output());
        record.measured.push(output.measured);
        record.voltage_v.push(output.voltage_v);
        record.power_w.push(rig.supply_power_w());
    })?;
    record.trip = trip.map(|reason| match rig.fault() {
        Some(fault) => format!("{reason}: {fault}"),
        None => reason.to_string(),
    });
    record.sensing = rig.sensing();
    Ok(record)
}

impl RunRecord {
    fn with_capacity(n: usize) -> Self {
        let series = || Vec::with_capacity(n);
        Self {
            reference: series(),
            true_output: series(),
            measured: series(),
            voltage_v: series(),
            power_w: series(),
            ..Self::default()
        }
    }
}
