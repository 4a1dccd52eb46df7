//! Small models that tuning rules are made for, and how they come from a plant, a step or a critical point.

use num_complex::Complex64;
use serde::{Deserialize, Serialize};
use telepulse_lti::SampleTime;

use super::DelayedPlant;
use super::convex_step::frequency_grid;
use super::stability::Characteristic;
use crate::{Error, Result};

/// `gain e^{-delay s}/((tau1 s + 1)(tau2 s + 1))`; first order where `tau2_s` is zero.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LagModel {
    /// Gain at rest, unit of output per unit of command.
    pub gain: f64,
    /// Longer time constant in s.
    pub tau1_s: f64,
    /// Shorter time constant in s.
    pub tau2_s: f64,
    /// Dead time in s.
    pub delay_s: f64,
}

/// Where proportional control brings a plant to its stability boundary.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CriticalPoint {
    /// Proportional gain at the boundary, positive for a plant of positive gain.
    pub gain: f64,
    /// Frequency of the sustained oscillation in rad/s.
    pub omega_rad_s: f64,
}

impl CriticalPoint {
    /// Period of the oscillation in s.
    #[must_use]
    pub fn period_s(&self) -> f64 {
        std::f64::consts::TAU / self.omega_rad_s
    }

    /// The critical point of a plant that is stable under small proportional gain.
    ///
    /// **Method**: crossings of -180 degrees on a grid, refined by bisection with the exact dead time; the least gain of which is
    /// taken, and judged on both sides by counting unstable poles.
    ///
    /// # Errors
    /// [`Error::PidNoCriticalPoint`] where no gain destabilises, or the loop is not stable below the gain.
    ///
    /// # Example
    /// ```
    /// use telepulse_design::synthesize::pid::{CriticalPoint, DelayedPlant};
    /// use telepulse_lti::TransferFunction;
    /// let plant = DelayedPlant::new(TransferFunction::new(&[1.0], &[1.0, 3.0, 3.0, 1.0])?, 0.0)?;
    /// let point = CriticalPoint::of_plant(&plant)?;
    /// assert!((point.gain - 8.0).abs() < 1e-9 && (point.omega_rad_s - 3.0_f64.sqrt()).abs() < 1e-9);
    /// # Ok::<(), telepulse_design::Error>(())
    /// ```
    pub fn of_plant(plant: &DelayedPlant) -> Result<Self> {
        let sign = plant.integral_sign()?;
        let response = |w: f64| plant.at(w) * sign;
        let grid = frequency_grid(plant, 0.0, &[])?;
        let mut least: Option<Self> = None;
        for pair in grid.windows(2) {
            let (mut a, mut b) = (pair[0], pair[1]);
            let side = response(a).im > 0.0;
            if side == (response(b).im > 0.0) {
                continue;
            }
            for _ in 0..BISECTIONS {
                let middle = 0.5 * (a + b);
                if (response(middle).im > 0.0) == side { a = middle } else { b = middle }
            }
            let here = response(0.5 * (a + b));
            let gain = 1.0 / here.norm();
            if here.re < 0.0 && least.is_none_or(|l| gain < l.gain) {
                least = Some(Self { gain, omega_rad_s: 0.5 * (a + b) });
            }
        }
        let point = least.ok_or(Error::PidNoCriticalPoint)?;
        let n_unstable = |gain: f64| -> Result<usize> {
            let p = telepulse_lti::TransferFunction::from_gain(gain * sign)?;
            Characteristic::new(plant.rational(), &p, plant.delay_s()).n_unstable()
        };
        if n_unstable(point.gain * (1.0 - 1e-6))? != 0 || n_unstable(point.gain * (1.0 + 1e-6))? == 0 {
            return Err(Error::PidNoCriticalPoint);
        }
        Ok(Self { gain: point.gain * sign, ..point })
    }
}

impl LagModel {
    /// The first-order model with this gain at rest and this response at one frequency, as a relay experiment measures it.
    ///
    /// **Method**: the modulus gives the time constant, `|response| = |gain|/sqrt(1 + (omega tau)^2)`, the phase the delay. Exact
    /// for a first-order plant, whatever the frequency below the first full turn of the phase.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] unless the response is smaller than the gain and lags by more than the time constant explains.
    ///
    /// # Example
    /// ```
    /// use telepulse_design::synthesize::pid::{DelayedPlant, LagModel};
    /// use telepulse_lti::TransferFunction;
    /// let plant = DelayedPlant::new(TransferFunction::new(&[3.0], &[2.0, 1.0])?, 0.7)?;
    /// let model = LagModel::from_response(3.0, 1.5, plant.at(1.5))?;
    /// assert!((model.tau1_s - 2.0).abs() < 1e-12 && (model.delay_s - 0.7).abs() < 1e-12);
    /// # Ok::<(), telepulse_design::Error>(())
    /// ```
    pub fn from_response(gain: f64, omega_rad_s: f64, response: Complex64) -> Result<Self> {
        if !(omega_rad_s.is_finite() && omega_rad_s > 0.0) {
            return Err(Error::OutOfRange {
                key: "omega_rad_s",
                found: omega_rad_s,
                allowed: "finite and above 0",
            });
        }
        let relative = response / gain;
        let ratio = 1.0 / relative.norm();
        if !(ratio.is_finite() && ratio > 1.0) {
            return Err(Error::OutOfRange {
                key: "gain at rest over response",
                found: ratio,
                allowed: "finite and above 1",
            });
        }
        let turn = (ratio * ratio - 1.0).sqrt();
        let mut lag = (-relative.arg()).rem_euclid(std::f64::consts::TAU) - turn.atan();
        // Without any delay the phase is that of the time constant, to rounding on either side.
        if lag < 0.0 && lag > -1e-9 {
            lag = 0.0;
        }
        if lag < 0.0 {
            return Err(Error::OutOfRange {
                key: "delay_s",
                found: lag / omega_rad_s,
                allowed: "at least 0",
            });
        }
        Ok(Self { gain, tau1_s: turn / omega_rad_s, tau2_s: 0.0, delay_s: lag / omega_rad_s })
    }

    /// The first-order model with this gain at rest and critical point.
    ///
    /// **Method**: `|G(j wu)| = 1/Ku` gives `tau = sqrt((gain Ku)^2 - 1)/wu`, and the phase -180 degrees the delay.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] unless `gain Ku > 1`.
    ///
    /// # Example
    /// ```
    /// use telepulse_design::synthesize::pid::{CriticalPoint, LagModel};
    /// let model = LagModel::from_critical_point(1.0, CriticalPoint { gain: 2.0, omega_rad_s: 1.0 })?;
    /// assert!((model.tau1_s - 3.0_f64.sqrt()).abs() < 1e-12);
    /// # Ok::<(), telepulse_design::Error>(())
    /// ```
    pub fn from_critical_point(gain: f64, point: CriticalPoint) -> Result<Self> {
        Self::from_response(gain, point.omega_rad_s, Complex64::new(-1.0 / point.gain, 0.0))
    }

    /// The first-order model of a measured step response, by the times at which 28.3 % and 63.2 % of the change are reached.
    ///
    /// **Shapes and units**: `time_s` rising from the step on, `output` of the same length and settled at its end; `step` the
    /// change of the command.
    ///
    /// **Source**: Smith 1972: `tau = 1.5 (t63 - t28)`, `delay = t63 - tau`.
    ///
    /// # Errors
    /// [`Error::SampleCount`], [`Error::SampleNotFinite`], [`Error::OutOfRange`] for a step of zero or an output that does not pass
    /// both levels.
    pub fn from_step(time_s: &[f64], output: &[f64], step: f64) -> Result<Self> {
        if output.len() != time_s.len() || output.len() < 3 {
            return Err(Error::SampleCount {
                signal: "output",
                expected: time_s.len().max(3),
                found: output.len(),
            });
        }
        for (signal, values) in [("time", time_s), ("output", output)] {
            if let Some((sample_idx, &found)) = values.iter().enumerate().find(|(_, v)| !v.is_finite()) {
                return Err(Error::SampleNotFinite { signal, sample_idx, found });
            }
        }
        let change = output[output.len() - 1] - output[0];
        if !(step.is_finite() && step != 0.0 && change != 0.0) {
            return Err(Error::OutOfRange {
                key: "step",
                found: step,
                allowed: "finite, not 0, with a response",
            });
        }
        let reached = |share: f64| {
            let level = |k: usize| (output[k] - output[0]) / change - share;
            let k = (1..output.len()).find(|&k| level(k) >= 0.0)?;
            let fraction = level(k - 1) / (level(k - 1) - level(k));
            Some(time_s[k - 1] + fraction * (time_s[k] - time_s[k - 1]) - time_s[0])
        };
        match (reached(1.0 - (-1.0_f64 / 3.0).exp()), reached(1.0 - (-1.0_f64).exp())) {
            (Some(t28), Some(t63)) if t63 > t28 => {
                let tau1_s = (1.5 * (t63 - t28)).min(t63);
                Ok(Self { gain: change / step, tau1_s, tau2_s: 0.0, delay_s: t63 - tau1_s })
            }
            _ => Err(Error::OutOfRange {
                key: "output",
                found: change,
                allowed: "rising through 28 % and 63 %",
            }),
        }
    }

    /// The first-order model of a stable plant by its step response; see [`LagModel::from_step`].
    ///
    /// # Errors
    /// [`Error::UnstableElement`], and as [`LagModel::from_step`].
    pub fn of_plant(plant: &DelayedPlant) -> Result<Self> {
        let poles = plant.rational().poles()?;
        if let Some(&pole) = poles.iter().find(|p| p.re >= 0.0) {
            return Err(Error::UnstableElement { system: "plant of a lag model", pole });
        }
        let slowest = poles.iter().fold(f64::INFINITY, |m, p| m.min(-p.re));
        let duration_s = if slowest.is_finite() { 20.0 / slowest } else { 1.0 };
        let sample_time = SampleTime::new(duration_s / STEP_SAMPLES)?;
        let response = plant.rational().to_state_space().step_response(0, duration_s, sample_time)?;
        let output: Vec<f64> = response.outputs.column(0).iter().copied().collect();
        let model = Self::from_step(&response.time_s, &output, 1.0)?;
        Ok(Self { delay_s: model.delay_s + plant.delay_s(), ..model })
    }
}

const BISECTIONS: usize = 100;
const STEP_SAMPLES: f64 = 8000.0;

#[cfg(test)]
mod tests {
    use telepulse_lti::TransferFunction;

    use super::*;

    #[test]
    fn law_three_routes_recover_a_first_order_plant_with_delay() {
        let plant = DelayedPlant::new(TransferFunction::new(&[3.0], &[2.0, 1.0]).expect("proper"), 0.7)
            .expect("valid");
        let point = CriticalPoint::of_plant(&plant).expect("exists");
        for model in [
            LagModel::from_critical_point(3.0, point).expect("valid"),
            LagModel::of_plant(&plant).expect("stable"),
            LagModel::from_response(3.0, 0.3, plant.at(0.3)).expect("valid"),
        ] {
            // The step response is settled to e^-20 and interpolated linearly.
            assert!((model.tau1_s - 2.0).abs() < 1e-4 && (model.delay_s - 0.7).abs() < 1e-4, "{model:?}");
            assert!((model.gain - 3.0).abs() < 1e-7);
        }
    }

    #[test]
    fn edge_models_that_do_not_exist_are_refused() {
        let resonant =
            DelayedPlant::new(TransferFunction::new(&[1.0], &[1.0, 0.2, 1.0]).expect("proper"), 0.0);
        let resonant = resonant.expect("valid");
        // Two lags never reach -180 degrees.
        assert_eq!(CriticalPoint::of_plant(&resonant), Err(Error::PidNoCriticalPoint));
        assert!(LagModel::from_step(&[0.0, 1.0, 2.0], &[0.0, 0.0, 0.0], 1.0).is_err());
        assert!(LagModel::from_step(&[0.0, 1.0], &[0.0, 1.0], 1.0).is_err());
        assert!(LagModel::from_step(&[0.0, 1.0, 2.0], &[0.0, f64::NAN, 1.0], 1.0).is_err());
        let point = CriticalPoint { gain: 0.5, omega_rad_s: 1.0 };
        assert!(LagModel::from_critical_point(1.0, point).is_err());
    }
}
