//! Judges a run by what truly happened: errors, effort, power, voltage, stability.

use anyhow::Result;
use telepulse_pulse::fidelity::{LagSearch, compare};

use super::config::Study;
use super::outcome::{PulseReplay, Tracking};
use crate::station::run::RunRecord;

/// A reference that asks for too much drives a loop into its ends a few times; an oscillation does so in each of its periods.
pub const HITS_MAX: usize = 8;

/// Share of full scale within which a feedforward is said to ask for an end of the drive: what the feedback adds to it decides the rest.
const NEAR_END: f64 = 0.03;

/// Time around a sample in which a feedforward that asks for an end explains that the drive is there.
const ASKED_WITHIN_S: f64 = 0.025;

/// What a drive may do.
#[derive(Debug, Clone, Copy)]
pub struct DriveRange {
    /// Lowest voltage.
    pub min_v: f64,
    /// Highest voltage.
    pub max_v: f64,
    /// Voltage of one unit.
    pub full_scale_v: f64,
}

impl DriveRange {
    /// That of a study.
    #[must_use]
    pub fn of(study: &Study) -> Self {
        let control = &study.control;
        Self { min_v: control.min_v, max_v: control.max_v, full_scale_v: control.full_scale_v }
    }
}

/// Why a run counts as unstable, if it does.
///
/// Saturation bounds the states of a simulated device, so instability shows as a limit cycle or a burst of one: the supervisor has
/// tripped, or the error is larger than the reference itself, or in the judged window the drive runs into one of its ends more often than
/// [`HITS_MAX`] times where the feedforward alone would not take it there: a steep reference may ask for the ends in each of its beats.
#[must_use]
pub fn instability(run: &RunRecord, window_start: usize, truth: &[f64], drive: DriveRange) -> Option<String> {
    if let Some(trip) = &run.trip {
        return Some(format!(
            "the supervisor ended the run after {:.2} s: {trip}",
            run.len() as f64 * run.sample_time_s
        ));
    }
    let reference = &run.reference[window_start..];
    let mean = reference.iter().sum::<f64>() / reference.len().max(1) as f64;
    let (mut swing, mut error) = (0.0, 0.0);
    for (r, y) in reference.iter().zip(&truth[window_start..]) {
        swing += (r - mean).powi(2);
        error += (r - y).powi(2);
    }
    let share_of_swing = (error / swing).sqrt();
    if share_of_swing > 1.0 {
        return Some(format!("oscillation: the error is {share_of_swing:.1} times the reference"));
    }
    let voltage = &run.voltage_v[window_start..];
    let at_end = |v: f64| v <= drive.min_v || v >= drive.max_v;
    let near = NEAR_END * drive.full_scale_v;
    let asked = |tick: usize| {
        let reach = (ASKED_WITHIN_S / run.sample_time_s).round() as usize;
        let n = run.feedforward_v.len();
        let here = window_start + tick;
        let around = here.saturating_sub(reach).min(n)..(here + reach + 1).min(n);
        run.feedforward_v[around].iter().any(|v| *v <= drive.min_v + near || *v >= drive.max_v - near)
    };
    let hit = |tick: &usize| !at_end(voltage[tick - 1]) && at_end(voltage[*tick]) && !asked(*tick);
    let hits = (1..voltage.len()).filter(hit).count();
    if hits > HITS_MAX {
        let share = voltage.iter().filter(|v| at_end(**v)).count() as f64 / voltage.len() as f64;
        return Some(format!(
            "oscillation: the drive runs into its ends {hits} times and spends {:.1} % of the time there",
            100.0 * share
        ));
    }
    None
}

/// The figures of Table 1 over the window that starts at `window_start`, in ticks. `truth` is in the reference's unit (mm).
#[must_use]
pub fn tracking(run: &RunRecord, window_start: usize, truth: &[f64], drive: DriveRange) -> Tracking {
    if let Some(reason) = instability(run, window_start, truth, drive) {
        return Tracking { unstable: true, unstable_reason: Some(reason), ..Tracking::default() };
    }
    let n = (run.len() - window_start) as f64;
    let errors = || run.reference.iter().zip(truth).skip(window_start).map(|(r, y)| (r - y).abs());
    let effort =
        run.voltage_v[window_start..].iter().map(|v| (v / drive.full_scale_v).powi(2)).sum::<f64>() / n;
    Tracking {
        unstable: false,
        unstable_reason: None,
        provenance: String::new(),
        mean_abs_error_mm: Some(errors().sum::<f64>() / n),
        max_abs_error_mm: Some(errors().fold(0.0, f64::max)),
        effort_index: Some(effort),
        average_power_w: Some(run.power_w[window_start..].iter().sum::<f64>() / n),
        max_voltage_v: Some(run.max_voltage_v()),
        min_voltage_v: Some(run.min_voltage_v()),
    }
}

/// Delay and error of a replayed pulse over the window that starts at `window_start`.
///
/// `controlled` is the true controlled variable in the reference's unit; `sign` is -1 where it falls with the pulse.
///
/// # Errors
/// Where the two cannot be compared.
pub fn replay(
    recording: &str,
    run: &RunRecord,
    window_start: usize,
    controlled: &[f64],
    sign: f64,
    drive: DriveRange,
) -> Result<PulseReplay> {
    let recording = recording.to_owned();
    if let Some(reason) = instability(run, window_start, controlled, drive) {
        return Ok(PulseReplay {
            recording,
            unstable: true,
            unstable_reason: Some(reason),
            ..PulseReplay::default()
        });
    }
    let upright = |series: &[f64]| series[window_start..].iter().map(|x| sign * x).collect::<Vec<f64>>();
    let (wanted, found) = (upright(&run.reference), upright(controlled));
    let fidelity = compare(&wanted, &found, 1.0 / run.sample_time_s, LagSearch::default())?;
    Ok(PulseReplay {
        recording,
        unstable: false,
        unstable_reason: None,
        provenance: String::new(),
        playout_delay_ms: 0.0,
        lag_ms: Some(fidelity.lag_ms),
        nrmse: Some(fidelity.nrmse),
        nrmse_aligned: Some(fidelity.nrmse_aligned),
        max_voltage_v: Some(run.max_voltage_v()),
        min_voltage_v: Some(run.min_voltage_v()),
    })
}
