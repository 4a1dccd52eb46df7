//! Judges a run by what truly happened: errors, effort, power, voltage, stability.

use anyhow::Result;
use telepulse_pulse::fidelity::{LagSearch, compare};

use super::outcome::{PulseReplay, Tracking};
use crate::station::run::RunRecord;

/// A loop that swings its drive between both ends for this share of the window has lost its stability.
const BANG_BANG_SHARE: f64 = 0.02;

/// Why a run counts as unstable, if it does.
///
/// Saturation bounds the states of a simulated device, so instability shows as a limit cycle: the supervisor has tripped, or in
/// the judged window the drive spends 2 % of the time at each end of its range, or the error is larger than the
/// reference itself.
#[must_use]
pub fn instability(
    run: &RunRecord,
    window_start: usize,
    truth: &[f64],
    min_v: f64,
    max_v: f64,
) -> Option<String> {
    if let Some(trip) = &run.trip {
        return Some(format!(
            "the supervisor ended the run after {:.2} s: {trip}",
            run.len() as f64 * run.sample_time_s
        ));
    }
    let voltage = &run.voltage_v[window_start..];
    let share = |at_end: &dyn Fn(f64) -> bool| {
        voltage.iter().filter(|v| at_end(**v)).count() as f64 / voltage.len().max(1) as f64
    };
    let (low, high) = (share(&|v| v <= min_v), share(&|v| v >= max_v));
    if low > BANG_BANG_SHARE && high > BANG_BANG_SHARE {
        return Some(format!(
            "limit cycle: the drive spends {:.0} % of the time at its lower and {:.0} % at its upper end",
            100.0 * low,
            100.0 * high
        ));
    }
    let reference = &run.reference[window_start..];
    let mean = reference.iter().sum::<f64>() / reference.len().max(1) as f64;
    let (mut swing, mut error) = (0.0, 0.0);
    for (r, y) in reference.iter().zip(&truth[window_start..]) {
        swing += (r - mean).powi(2);
        error += (r - y).powi(2);
    }
    (error > swing)
        .then(|| format!("oscillation: the error is {:.1} times the reference", (error / swing).sqrt()))
}

/// The figures of Table 1 over the window that starts at `window_start`, in ticks. `truth` is in the reference's unit (mm).
#[must_use]
pub fn tracking(run: &RunRecord, window_start: usize, truth: &[f64], min_v: f64, max_v: f64) -> Tracking {
    if let Some(reason) = instability(run, window_start, truth, min_v, max_v) {
        return Tracking { unstable: true, unstable_reason: Some(reason), ..Tracking::default() };
    }
    let n = (run.len() - window_start) as f64;
    let errors = || run.reference.iter().zip(truth).skip(window_start).map(|(r, y)| (r - y).abs());
    let effort = run.voltage_v[window_start..].iter().map(|v| (v / max_v).powi(2)).sum::<f64>() / n;
    Tracking {
        unstable: false,
        unstable_reason: None,
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
    limits_v: (f64, f64),
) -> Result<PulseReplay> {
    let recording = recording.to_owned();
    if let Some(reason) = instability(run, window_start, controlled, limits_v.0, limits_v.1) {
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
        lag_ms: Some(fidelity.lag_ms),
        nrmse: Some(fidelity.nrmse),
        nrmse_aligned: Some(fidelity.nrmse_aligned),
        max_voltage_v: Some(run.max_voltage_v()),
        min_voltage_v: Some(run.min_voltage_v()),
    })
}
