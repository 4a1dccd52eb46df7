//! Relay experiment: a bounded oscillation that shows where a loop would become unstable.

use core::f64::consts::{PI, TAU};

use crate::error::{Error, finite, not_negative, positive};

/// Cycles that are kept.
pub const RELAY_CYCLES_MAX: usize = 16;

/// Samples below which a cycle is not believed.
pub const RELAY_SAMPLES_MIN: u32 = 10;

/// What a relay experiment may do and when it has seen enough. Commands in unit, measurements in the unit of the controlled quantity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RelaySettings {
    /// Command around which the relay switches, and to which it returns.
    pub bias: f64,
    /// Step above the bias.
    pub step_up: f64,
    /// Step below the bias; other than `step_up`, the experiment shows the gain at rest as well.
    pub step_down: f64,
    /// Measurement at rest under the bias, around which the relay switches.
    pub setpoint: f64,
    /// Half-width of the dead zone, above the measurement's noise.
    pub hysteresis: f64,
    /// Sign of the plant's gain.
    pub action: RelayAction,
    /// Lowest command the drive takes.
    pub command_min: f64,
    /// Highest command the drive takes.
    pub command_max: f64,
    /// Measurement below which the experiment stops.
    pub measured_min: f64,
    /// Measurement above which the experiment stops.
    pub measured_max: f64,
    /// Consecutive cycles that have to agree, from 2 to [`RELAY_CYCLES_MAX`].
    pub n_cycles: usize,
    /// Largest relative spread of their periods and amplitudes.
    pub tolerance: f64,
    /// Longest duration in seconds.
    pub timeout_s: f64,
    /// Sample time in seconds.
    pub sample_time_s: f64,
}

/// Sign of the plant's gain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RelayAction {
    /// The measurement rises with the command.
    Direct,
    /// The measurement falls with the command.
    Reverse,
}

/// One whole cycle, from one switch up to the next.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RelayCycle {
    /// Duration in samples.
    pub n_samples: u32,
    /// Of these with the command up.
    pub n_samples_up: u32,
    /// Largest measurement.
    pub measured_max: f64,
    /// Smallest measurement.
    pub measured_min: f64,
    /// Mean of the command less the bias.
    pub command_mean: f64,
    /// Mean of the measurement less the setpoint.
    pub measured_mean: f64,
    /// Frequency of the two sums below in rad/s: that of the cycle before. Zero for the first cycle, which has none.
    pub omega_rad_s: f64,
    /// `sum (u - bias) e^{-j omega t}`, real and imaginary part.
    pub command_sum: [f64; 2],
    /// `sum (y - setpoint) e^{-j omega t}`, real and imaginary part.
    pub measured_sum: [f64; 2],
}

/// What the steady oscillation says of the plant: means over the cycles that agree.
///
/// **Accuracy**: `critical_gain` and `period_s` leave out the harmonics, and hysteresis moves the point: 2 to 5 % for plants with three
/// lags or more, up to 20 % for a single lag with little delay. `response` is exact but for the sampling (an error of the order of one
/// sample per period), whatever the wave's form.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RelayEstimate {
    /// Period of the oscillation in seconds.
    pub period_s: f64,
    /// Half the distance of the measurement's extrema.
    pub amplitude: f64,
    /// Proportional gain at which the loop oscillates by itself: `4 d/(pi sqrt(a^2 - h^2))`, `d` half the step from low to high and `h`
    /// the hysteresis. Positive; the sign is that of [`RelayAction`].
    pub critical_gain: f64,
    /// The plant at `2 pi/period_s`, real and imaginary part, from the fundamentals of both signals; the hold before it is taken out.
    pub response: [f64; 2],
    /// The plant at rest, from the means of both signals; `None` where the relay is so even that the mean command says nothing.
    pub static_gain: Option<f64>,
    /// Largest less smallest period of the cycles used, over their mean.
    pub period_spread: f64,
    /// Largest less smallest amplitude of the cycles used, over their mean.
    pub amplitude_spread: f64,
}

/// Why an experiment stopped before it was done.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RelayStop {
    /// The cycles did not agree in time; those that were seen are kept.
    Timeout,
    /// The measurement left its limits.
    MeasuredRange {
        /// The measurement.
        measured: f64,
    },
    /// The measurement was not a number.
    NotFinite,
    /// [`RELAY_CYCLES_MAX`] cycles in a row of less than [`RELAY_SAMPLES_MIN`] samples: the relay follows the noise, or the plant is too fast
    /// for the sample time. More hysteresis, or faster sampling.
    Chatter,
}

/// Where an experiment stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RelayStatus {
    /// Switching.
    Running,
    /// The cycles agree; the command is back at the bias.
    Done,
    /// Ended early; the command is back at the bias.
    Stopped(RelayStop),
}

/// The experiment as a state machine: one measurement in, one command out per sample.
///
/// ```text
///   setpoint -->(+)-- e --> relay with hysteresis --> command in {bias - step_down, bias + step_up} --> plant --+--> measured
///                ^-                                                                                             |
///                +----------------------------------------------------------------------------------------------+
/// ```
///
/// **Method**: the relay's fundamental sees the plant at the frequency where the phases add to a turn: the critical frequency, or a
/// little below with hysteresis. Each cycle's period, extrema, means and first Fourier coefficients (at the frequency of the cycle
/// before) are kept; [`estimate`](Self::estimate) reads them. No command leaves the drive's range, which is checked before the start; the whole is bounded in time.
///
/// **Source**: Åström and Hägglund 1984, Automatica 20(5).
///
/// **Example**
/// ```
/// use telepulse_rt::{Relay, RelayAction, RelaySettings, RelayStatus};
/// let settings = RelaySettings {
///     bias: 0.5, step_up: 0.1, step_down: 0.1, setpoint: 0.0, hysteresis: 0.0, action: RelayAction::Direct,
///     command_min: 0.0, command_max: 1.0, measured_min: -1.0, measured_max: 1.0,
///     n_cycles: 3, tolerance: 0.01, timeout_s: 60.0, sample_time_s: 0.01,
/// };
/// let mut relay = Relay::new(settings)?;
/// assert_eq!(relay.advance(-0.1), RelayStatus::Running);
/// assert_eq!(relay.command(), 0.6);
/// assert!(Relay::new(RelaySettings { step_up: 0.6, ..settings }).is_err());
/// # Ok::<(), telepulse_rt::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Relay {
    settings: RelaySettings,
    status: RelayStatus,
    up: bool,
    n_seen: u64,
    n_max: u64,
    /// Switches up so far.
    n_up: u32,
    current: RelayCycle,
    kept: [RelayCycle; RELAY_CYCLES_MAX],
    n_kept: usize,
}

impl Relay {
    /// An experiment that has not seen a sample.
    ///
    /// # Errors
    /// [`Error::RelayRange`] where bias and steps leave the range of commands, [`Error::RelayCycles`], and [`Error::NotFinite`],
    /// [`Error::NotPositive`] or [`Error::Negative`] for the other settings.
    pub fn new(settings: RelaySettings) -> Result<Self, Error> {
        finite("relay bias", settings.bias)?;
        positive("relay step up", settings.step_up)?;
        positive("relay step down", settings.step_down)?;
        finite("relay setpoint", settings.setpoint)?;
        not_negative("relay hysteresis", settings.hysteresis)?;
        positive("relay tolerance", settings.tolerance)?;
        let sample_time_s = positive("relay sample time in seconds", settings.sample_time_s)?;
        let timeout_s = positive("relay timeout in seconds", settings.timeout_s)?;
        let (low, high) = (settings.bias - settings.step_down, settings.bias + settings.step_up);
        if !(low >= settings.command_min && high <= settings.command_max) {
            let (command_min, command_max) = (settings.command_min, settings.command_max);
            return Err(Error::RelayRange { low, high, command_min, command_max });
        }
        positive("relay setpoint above the lowest measurement", settings.setpoint - settings.measured_min)?;
        positive("relay setpoint below the highest measurement", settings.measured_max - settings.setpoint)?;
        if !(2..=RELAY_CYCLES_MAX).contains(&settings.n_cycles) {
            return Err(Error::RelayCycles { found: settings.n_cycles, capacity: RELAY_CYCLES_MAX });
        }
        // A cast saturates, so a long timeout is bounded too.
        let n_max = libm::ceil(timeout_s / sample_time_s) as u64;
        Ok(Self {
            settings,
            status: RelayStatus::Running,
            up: true,
            n_seen: 0,
            n_max,
            n_up: 0,
            current: RelayCycle::default(),
            kept: [RelayCycle::default(); RELAY_CYCLES_MAX],
            n_kept: 0,
        })
    }

    /// The command to hold until the next sample: the bias before the start and after the end.
    #[must_use]
    pub fn command(&self) -> f64 {
        if self.status != RelayStatus::Running || self.n_seen == 0 {
            return self.settings.bias;
        }
        self.settings.bias + self.deviation()
    }

    /// Takes the measurement of this sample; [`command`](Self::command) then gives what to apply at once.
    pub fn advance(&mut self, measured: f64) -> RelayStatus {
        if self.status != RelayStatus::Running {
            return self.status;
        }
        if !measured.is_finite() {
            return self.stop(RelayStop::NotFinite);
        }
        if measured < self.settings.measured_min || measured > self.settings.measured_max {
            return self.stop(RelayStop::MeasuredRange { measured });
        }
        if self.n_seen >= self.n_max {
            return self.stop(RelayStop::Timeout);
        }
        self.n_seen += 1;
        let error = match self.settings.action {
            RelayAction::Direct => self.settings.setpoint - measured,
            RelayAction::Reverse => measured - self.settings.setpoint,
        };
        if self.up && error < -self.settings.hysteresis {
            self.up = false;
        } else if !self.up && error > self.settings.hysteresis {
            self.up = true;
            self.begin_cycle();
            if self.agree() {
                self.status = RelayStatus::Done;
                return self.status;
            }
            if self.n_kept == RELAY_CYCLES_MAX && self.kept.iter().all(RelayCycle::is_short) {
                return self.stop(RelayStop::Chatter);
            }
        }
        self.record(measured);
        self.status
    }

    /// The cycles that were kept, oldest first: the last [`RELAY_CYCLES_MAX`], without the start.
    #[must_use]
    pub fn cycles(&self) -> &[RelayCycle] {
        &self.kept[..self.n_kept]
    }

    /// What the plant is at the oscillation; `None` until the experiment is done.
    #[must_use]
    pub fn estimate(&self) -> Option<RelayEstimate> {
        if self.status != RelayStatus::Done {
            return None;
        }
        let settings = &self.settings;
        let used = &self.kept[self.n_kept - settings.n_cycles..self.n_kept];
        let n = settings.n_cycles as f64;
        let mean = |of: fn(&RelayCycle) -> f64| used.iter().map(of).sum::<f64>() / n;
        let samples = mean(|c| f64::from(c.n_samples));
        let amplitude = 0.5 * mean(RelayCycle::swing);
        let half_step = 0.5 * (settings.step_up + settings.step_down);
        // -1/N(a) = -(pi/(4 d)) (sqrt(a^2 - h^2) + j h). The measurement has crossed the hysteresis, so a >= h, but may just have.
        let inside = (amplitude - settings.hysteresis) * (amplitude + settings.hysteresis);
        let critical_gain = 4.0 * half_step / (PI * libm::sqrt(inside));
        if !(critical_gain.is_finite() && critical_gain > 0.0) {
            return None;
        }
        // Sums over the cycles of Y U* and U U*.
        let (mut re, mut im, mut size) = (0.0, 0.0, 0.0);
        for cycle in used {
            let ([u_re, u_im], [y_re, y_im]) = (cycle.command_sum, cycle.measured_sum);
            re += y_re * u_re + y_im * u_im;
            im += y_im * u_re - y_re * u_im;
            size += u_re * u_re + u_im * u_im;
        }
        // A held command has the fundamental sinc(x) e^{-j x} of its samples, with x half the angle per sample.
        let half_angle = PI / samples;
        let (sine, cosine) = (libm::sin(half_angle), libm::cos(half_angle));
        let scale = half_angle / (sine * size);
        let response = [scale * (re * cosine - im * sine), scale * (re * sine + im * cosine)];
        let command = mean(|c| c.command_mean);
        let static_gain = (command.abs() >= EVEN * half_step).then(|| mean(|c| c.measured_mean) / command);
        Some(RelayEstimate {
            period_s: samples * settings.sample_time_s,
            amplitude,
            critical_gain,
            response,
            static_gain,
            period_spread: spread(used, |c| f64::from(c.n_samples)) / samples,
            amplitude_spread: spread(used, RelayCycle::swing) / (2.0 * amplitude),
        })
    }

    /// Where the experiment stands.
    #[must_use]
    pub fn status(&self) -> RelayStatus {
        self.status
    }

    fn stop(&mut self, why: RelayStop) -> RelayStatus {
        self.status = RelayStatus::Stopped(why);
        self.status
    }

    fn deviation(&self) -> f64 {
        if self.up { self.settings.step_up } else { -self.settings.step_down }
    }

    /// Closes the cycle that ends here, if it was a whole one, and opens the next.
    fn begin_cycle(&mut self) {
        self.n_up += 1;
        let mut next = RelayCycle {
            measured_max: f64::NEG_INFINITY,
            measured_min: f64::INFINITY,
            ..RelayCycle::default()
        };
        if self.n_up > 1 {
            let mut done = self.current;
            let n = f64::from(done.n_samples);
            done.command_mean /= n;
            done.measured_mean /= n;
            if self.n_kept == RELAY_CYCLES_MAX {
                self.kept.rotate_left(1);
                self.n_kept -= 1;
            }
            self.kept[self.n_kept] = done;
            self.n_kept += 1;
            next.omega_rad_s = TAU / (n * self.settings.sample_time_s);
        }
        self.current = next;
    }

    fn record(&mut self, measured: f64) {
        if self.n_up == 0 {
            return;
        }
        let (u, y) = (self.deviation(), measured - self.settings.setpoint);
        let cycle = &mut self.current;
        let angle = cycle.omega_rad_s * self.settings.sample_time_s * f64::from(cycle.n_samples);
        let (sine, cosine) = (libm::sin(angle), libm::cos(angle));
        for (sum, value) in [(&mut cycle.command_sum, u), (&mut cycle.measured_sum, y)] {
            sum[0] += value * cosine;
            sum[1] -= value * sine;
        }
        cycle.command_mean += u;
        cycle.measured_mean += y;
        cycle.measured_max = cycle.measured_max.max(measured);
        cycle.measured_min = cycle.measured_min.min(measured);
        cycle.n_samples = cycle.n_samples.saturating_add(1);
        cycle.n_samples_up = cycle.n_samples_up.saturating_add(u32::from(self.up));
    }

    /// Whether the last cycles have one period (to a sample) and one amplitude.
    fn agree(&self) -> bool {
        let wanted = self.settings.n_cycles;
        if self.n_kept < wanted {
            return false;
        }
        let last = &self.kept[self.n_kept - wanted..self.n_kept];
        if last.iter().any(|c| c.omega_rad_s == 0.0 || c.is_short()) {
            return false;
        }
        let most = |of: fn(&RelayCycle) -> f64| last.iter().map(of).fold(0.0, f64::max);
        let tolerance = self.settings.tolerance;
        spread(last, |c| f64::from(c.n_samples)) <= tolerance * most(|c| f64::from(c.n_samples)) + 1.0
            && spread(last, RelayCycle::swing) <= tolerance * most(RelayCycle::swing)
    }
}

impl RelayCycle {
    fn swing(&self) -> f64 {
        self.measured_max - self.measured_min
    }

    fn is_short(&self) -> bool {
        self.n_samples < RELAY_SAMPLES_MIN
    }
}

/// Largest less smallest value.
fn spread(cycles: &[RelayCycle], of: fn(&RelayCycle) -> f64) -> f64 {
    let (low, high) = cycles
        .iter()
        .map(of)
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    high - low
}

/// Mean command over half the step below which the static gain would be made of noise and switching times.
const EVEN: f64 = 0.05;

#[cfg(test)]
#[path = "relay_tests.rs"]
mod tests;
