//! The relay experiment on a rig: hold the bias, let the relay switch, read what the oscillation says.

use std::cell::Cell;

use anyhow::Result;
use telepulse_rt::{
    ControlLaw, ControlLoop, CycleInputs, Drive, InputLinearisation, LowPass, Relay, RelayAction,
    RelayEstimate, RelaySettings, RelayStatus, RelayStop, Sensor, SensorScale,
};
use thiserror::Error;

use super::control::open_loop;
use super::run::{ErrorWatch, tick_through};
use crate::study::config::Study;

/// What is asked of an experiment.
#[derive(Debug, Clone, Copy)]
pub struct RelayPlan {
    /// Command about which the relay switches, fraction of full scale.
    pub bias: f64,
    /// Step to both sides of it.
    pub step: f64,
    /// Half-width of the dead zone in mm; `None` for four times the spread of the measurement at rest.
    pub hysteresis_mm: Option<f64>,
    /// How far the measurement may go from where it rests, in mm.
    pub swing_max_mm: f64,
    /// How long the bias is held before.
    pub settle_s: f64,
    /// Longest time of the relay itself.
    pub timeout_s: f64,
}

/// What came of it.
#[derive(Debug, Clone, Copy)]
pub struct RelayOutcome {
    /// Mean of the measurement over the last second at the bias, in mm from rest.
    pub setpoint_mm: f64,
    /// The dead zone that was used.
    pub hysteresis_mm: f64,
    /// Time from the first switch to the end.
    pub duration_s: f64,
    /// What the oscillation says.
    pub estimate: RelayEstimate,
}

/// Why an experiment says nothing.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum RelayRefusal {
    /// The relay would leave the study's voltages.
    #[error(
        "bias {bias} with a step of {step} asks for {low_v} to {high_v} V, allowed are the study's {min_v} to {max_v} V"
    )]
    Voltage {
        /// Bias, fraction of full scale.
        bias: f64,
        /// Step.
        step: f64,
        /// Lowest voltage asked for.
        low_v: f64,
        /// Highest one.
        high_v: f64,
        /// The study's lowest voltage.
        min_v: f64,
        /// The study's highest voltage.
        max_v: f64,
    },
    /// The drive did not give what the relay asked for.
    #[error(
        "the drive gave {found_v} V where the relay asked for {asked_v} V: a saturated relay says nothing of the plant"
    )]
    Saturated {
        /// Asked for.
        asked_v: f64,
        /// Given.
        found_v: f64,
    },
    /// No steady oscillation in time.
    #[error(
        "no steady oscillation within {timeout_s} s, found {n_cycles} whole cycles: a larger step, less hysteresis ({hysteresis_mm} mm) or more time, or a plant that does not oscillate under a relay"
    )]
    NoOscillation {
        /// Time allowed.
        timeout_s: f64,
        /// Cycles seen that were kept.
        n_cycles: usize,
        /// Dead zone.
        hysteresis_mm: f64,
    },
    /// The relay follows noise.
    #[error(
        "the relay switches with the noise: found cycles of a few samples with a hysteresis of {hysteresis_mm} mm, allowed is more"
    )]
    Chatter {
        /// Dead zone.
        hysteresis_mm: f64,
    },
    /// The plate went too far.
    #[error("the measurement must stay within {swing_max_mm} mm of {setpoint_mm} mm, found {measured_mm} mm")]
    Swing {
        /// Allowed.
        swing_max_mm: f64,
        /// Where it rests at the bias.
        setpoint_mm: f64,
        /// Found.
        measured_mm: f64,
    },
    /// The measurement does not show the oscillation that made the relay switch.
    #[error(
        "the oscillation is no larger than the hysteresis of {hysteresis_mm} mm: a larger step or less hysteresis"
    )]
    TooSmall {
        /// Dead zone.
        hysteresis_mm: f64,
    },
    /// The supervisor ended the run.
    #[error("the experiment was ended: {reason}")]
    Tripped {
        /// Why.
        reason: String,
    },
}

/// Runs the experiment with the study's filter in the measurement, as a controller of the study has it.
///
/// The command of a tick follows from the measurement of the tick before: half a millisecond of delay at 2 kHz, which the
/// critical point includes.
///
/// # Errors
/// A [`RelayRefusal`] where the experiment says nothing; else where the rig cannot be armed or a setting is out of range.
pub fn run_relay<R: Sensor + Drive>(
    rig: &mut R,
    study: &Study,
    scale: SensorScale,
    plan: &RelayPlan,
) -> Result<RelayOutcome> {
    check_voltage(study, plan)?;
    let sample_time_s = study.sample_time_s();
    let corner = std::f64::consts::TAU * study.control.filter_hz;
    let mut control = {
        let open = open_loop(study, scale, InputLinearisation::Identity, ControlLaw::OpenLoop)?;
        let filter = Some(LowPass::new(corner, sample_time_s)?);
        ControlLoop::new(telepulse_rt::ControlSettings {
            measurement_filter: filter,
            ..open.settings().clone()
        })?
    };
    let n_settle = (plan.settle_s / sample_time_s).round().max(2.0) as usize;
    let n_all = n_settle + (plan.timeout_s / sample_time_s).ceil() as usize + 1;
    let mut watched = Watched { study, plan, n_settle, rest: Vec::new(), relay: None, refusal: None };
    let command = Cell::new(plan.bias);
    let ended = Cell::new(false);
    let inputs = (0..n_all)
        .map_while(|_| (!ended.get()).then(|| CycleInputs { reference: 0.0, feedforward: command.get() }));
    let mut n_ticks = 0;
    let trip = tick_through(rig, &mut control, inputs, ErrorWatch::OFF, |tick_idx, output, _| {
        n_ticks = tick_idx + 1;
        match watched.take(tick_idx, output.filtered, output.command, output.saturated, output.voltage_v) {
            Some(next) => command.set(next),
            None => ended.set(true),
        }
    })?;
    if let Some(refusal) = watched.refusal {
        return Err(refusal);
    }
    if let Some(reason) = trip {
        return Err(RelayRefusal::Tripped { reason: reason.to_string() }.into());
    }
    let Some((relay, setpoint_mm, hysteresis_mm)) = watched.relay else {
        return Err(RelayRefusal::NoOscillation { timeout_s: 0.0, n_cycles: 0, hysteresis_mm: 0.0 }.into());
    };
    let duration_s = n_ticks.saturating_sub(n_settle) as f64 * sample_time_s;
    match (relay.status(), relay.estimate()) {
        (_, Some(estimate)) => Ok(RelayOutcome { setpoint_mm, hysteresis_mm, duration_s, estimate }),
        (RelayStatus::Done, None) => Err(RelayRefusal::TooSmall { hysteresis_mm }.into()),
        (RelayStatus::Stopped(RelayStop::Chatter), _) => Err(RelayRefusal::Chatter { hysteresis_mm }.into()),
        (RelayStatus::Stopped(RelayStop::MeasuredRange { measured }), _) => {
            Err(RelayRefusal::Swing { swing_max_mm: plan.swing_max_mm, setpoint_mm, measured_mm: measured }
                .into())
        }
        (RelayStatus::Running | RelayStatus::Stopped(RelayStop::Timeout | RelayStop::NotFinite), _) => {
            let n_cycles = relay.cycles().len();
            Err(RelayRefusal::NoOscillation { timeout_s: plan.timeout_s, n_cycles, hysteresis_mm }.into())
        }
    }
}

fn check_voltage(study: &Study, plan: &RelayPlan) -> Result<(), RelayRefusal> {
    let control = &study.control;
    let (low_v, high_v) =
        ((plan.bias - plan.step) * control.full_scale_v, (plan.bias + plan.step) * control.full_scale_v);
    if low_v >= control.min_v && high_v <= control.max_v {
        return Ok(());
    }
    Err(RelayRefusal::Voltage {
        bias: plan.bias,
        step: plan.step,
        low_v,
        high_v,
        min_v: control.min_v,
        max_v: control.max_v,
    })
}

/// The experiment as the ticks see it.
struct Watched<'a> {
    study: &'a Study,
    plan: &'a RelayPlan,
    n_settle: usize,
    /// The last second at the bias.
    rest: Vec<f64>,
    /// With the setpoint and the hysteresis.
    relay: Option<(Relay, f64, f64)>,
    refusal: Option<anyhow::Error>,
}

impl Watched<'_> {
    /// Takes one tick and gives the next command; `None` where the experiment is over.
    fn take(
        &mut self,
        tick_idx: usize,
        measured: f64,
        asked: f64,
        saturated: bool,
        found_v: f64,
    ) -> Option<f64> {
        if saturated {
            let asked_v = asked * self.study.control.full_scale_v;
            self.refusal = Some(RelayRefusal::Saturated { asked_v, found_v }.into());
            return None;
        }
        let n_rest = (1.0 / self.study.sample_time_s()) as usize;
        if tick_idx < self.n_settle {
            if tick_idx + n_rest >= self.n_settle {
                self.rest.push(measured);
            }
            return Some(self.plan.bias);
        }
        if self.relay.is_none() {
            match self.start() {
                Ok(relay) => self.relay = Some(relay),
                Err(error) => {
                    self.refusal = Some(error);
                    return None;
                }
            }
        }
        let (relay, ..) = self.relay.as_mut()?;
        match relay.advance(measured) {
            RelayStatus::Running => Some(relay.command()),
            RelayStatus::Done | RelayStatus::Stopped(_) => None,
        }
    }

    fn start(&self) -> Result<(Relay, f64, f64)> {
        let n = self.rest.len() as f64;
        let mean = self.rest.iter().sum::<f64>() / n;
        let spread = (self.rest.iter().map(|y| (y - mean).powi(2)).sum::<f64>() / n).sqrt();
        let hysteresis = self.plan.hysteresis_mm.unwrap_or(SPREADS * spread);
        let control = &self.study.control;
        let relay = Relay::new(RelaySettings {
            bias: self.plan.bias,
            step_up: self.plan.step,
            step_down: self.plan.step,
            setpoint: mean,
            hysteresis,
            action: RelayAction::Direct,
            command_min: control.min_v / control.full_scale_v,
            command_max: control.max_v / control.full_scale_v,
            measured_min: mean - self.plan.swing_max_mm,
            measured_max: mean + self.plan.swing_max_mm,
            n_cycles: CYCLES,
            tolerance: TOLERANCE,
            timeout_s: self.plan.timeout_s,
            sample_time_s: self.study.sample_time_s(),
        })?;
        Ok((relay, mean, hysteresis))
    }
}

/// Dead zone over the standard deviation of the filtered measurement at rest: noise passes it once in some ten thousand samples.
const SPREADS: f64 = 4.0;
/// Cycles in a row that have to agree, and how well: creep moves the middle of the oscillation by a few per cent.
const CYCLES: usize = 4;
const TOLERANCE: f64 = 0.05;
