//! Feedforward from a reference that is known ahead of time.

use std::f64::consts::{PI, SQRT_2, TAU};

use num_complex::Complex64;
use realfft::RealFftPlanner;
use serde::{Deserialize, Serialize};
use telepulse_lti::{SampleTime, TransferFunction};

use crate::{Error, Result};

/// What a preview filter should do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PreviewOptions {
    /// Half-amplitude frequency of the low-pass F, in Hz: references above it are not followed.
    pub bandwidth_hz: f64,
    /// Width of its edge, in Hz: F is within 0.14 % of 1 up to `bandwidth_hz - 3 transition_hz`. A narrow edge rings for longer and
    /// so needs a longer horizon, see [`transition_for_horizon_hz`].
    pub transition_hz: f64,
    /// Dead time of the loop in s, in addition to the hold of the drive: computation, transport.
    pub delay_s: f64,
}

impl Default for PreviewOptions {
    /// 25 Hz with an edge of 5 Hz: flat to 10 Hz, where the pulse ends, and a horizon near 0.12 s.
    fn default() -> Self {
        Self { bandwidth_hz: 25.0, transition_hz: 5.0, delay_s: 0.0 }
    }
}

/// The narrowest edge whose ringing fits into a horizon, in Hz.
///
/// **Method**: the filter rings under a Gaussian of standard deviation `1/(2 pi transition)`; 5 of them leave the share
/// [`TAIL_MAX`] for a plant like Eq. (16). The dead time is not part of `horizon_s`.
#[must_use]
pub fn transition_for_horizon_hz(horizon_s: f64) -> f64 {
    5.0 / (TAU * horizon_s)
}

/// A finite filter from the future and past of a reference to the drive that makes the plant follow it.
///
/// **Shapes and units**: `u[k] = sum over i of taps[i] r[k + n_preview - i]`, r in mm and u in units of command, both relative
/// to the operating point; `taps` in units per mm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PreviewFeedforward {
    /// The filter, its most advanced tap first.
    pub taps: Vec<f64>,
    /// Samples of the reference ahead of the present that it reads.
    pub n_preview: usize,
    /// Sample time in s.
    pub sample_time_s: f64,
    /// Sum of the taps: the inverse of the plant's DC gain, in units per mm.
    pub dc_gain_unit_per_mm: f64,
    /// How far ahead it reads, in s.
    pub horizon_s: f64,
    /// How far ahead all but 1e-6 (-60 dB) of its energy lies, in s.
    pub horizon_energy_s: f64,
    /// Half-amplitude frequency of its low-pass in Hz.
    pub bandwidth_hz: f64,
    /// Width of the low-pass' edge in Hz.
    pub transition_hz: f64,
}

/// The preview filter `F/G`: a zero-phase low-pass over the sampled plant.
///
/// **Shapes and units**: `plant` in mm per unit of command, stable, with a finite DC gain.
///
/// **Method**: at each frequency of a long grid the filter is `F(w) exp(j w delay)/G_d(w)`, where `G_d` is the plant with its
/// zero-order hold, sampled exactly, so that hold, circuit and dead time are all inverted. F is a box of half-width
/// `bandwidth_hz` smoothed by a Gaussian, `(erf((f + B)/(sqrt 2 s)) - erf((f - B)/(sqrt 2 s)))/2`: flat inside, and its
/// impulse response dies like a Gaussian. An inverse FFT gives the taps. The plant has no zeros, so 1/G is a polynomial in s and adds no
/// tail. Taps are cut where the sum of the rest, in absolute value, is below [`TAIL_MAX`] of the DC gain on each side;
/// at no frequency can the cut change the response by more than the sum of both. Then the DC gain is made exact.
///
/// **Accuracy**: on the plant it was made for, tracking is off by `1 - F` of each component plus twice [`TAIL_MAX`] times
/// `|G(jw)/G(0)|`.
///
/// # Errors
/// [`Error::OutOfRange`] for options that make no low-pass below half of the sample rate; [`Error::PreviewPlantZero`];
/// [`Error::PreviewTooLong`]; [`Error::System`] for a plant without a finite DC gain.
pub fn preview_feedforward(
    plant: &TransferFunction,
    sample_time: SampleTime,
    options: &PreviewOptions,
) -> Result<PreviewFeedforward> {
    let sample_time_s = sample_time.seconds();
    check_options(options, sample_time_s)?;
    let PreviewOptions { bandwidth_hz, transition_hz, .. } = *options;
    let dc_gain = 1.0 / plant.dc_gain()?;
    if !dc_gain.is_finite() {
        return Err(Error::PreviewPlantZero { frequency_hz: 0.0 });
    }
    let response = circular_response(plant, sample_time, options)?;

    let n_preview = reach(response.iter().take(GRID / 2).copied(), dc_gain.abs())?;
    let n_past = reach(response.iter().rev().take(GRID / 2).copied(), dc_gain.abs())?;
    // Index i of `response` is i samples of advance, counted around the circle.
    let mut taps: Vec<f64> = (0..=n_preview).rev().map(|i| response[i]).collect();
    taps.extend((1..=n_past).map(|i| response[GRID - i]));
    let sum: f64 = taps.iter().sum();
    for tap in &mut taps {
        *tap *= dc_gain / sum;
    }
    let energy: f64 = taps.iter().map(|t| t * t).sum();
    let mut ahead = 0.0;
    let n_little = taps.iter().take_while(|t| {
        ahead += *t * *t;
        ahead <= 1e-6 * energy
    });
    let n_energy = n_preview.saturating_sub(n_little.count());
    Ok(PreviewFeedforward {
        taps,
        n_preview,
        sample_time_s,
        dc_gain_unit_per_mm: dc_gain,
        horizon_s: n_preview as f64 * sample_time_s,
        horizon_energy_s: n_energy as f64 * sample_time_s,
        bandwidth_hz,
        transition_hz,
    })
}

impl PreviewFeedforward {
    /// Samples of the past that the filter reads.
    #[must_use]
    pub fn n_past(&self) -> usize {
        self.taps.len() - 1 - self.n_preview
    }

    /// The drive at one tick, for use while the reference streams in.
    ///
    /// `window` holds the reference from `n_past` samples before the present to `n_preview` after it, oldest first; in mm relative to the
    /// operating point.
    ///
    /// # Errors
    /// [`Error::SampleCount`] for a window of another length.
    pub fn command(&self, window: &[f64]) -> Result<f64> {
        if window.len() != self.taps.len() {
            let (expected, found) = (self.taps.len(), window.len());
            return Err(Error::SampleCount { signal: "reference window", expected, found });
        }
        Ok(self.taps.iter().zip(window.iter().rev()).map(|(tap, r)| tap * r).sum())
    }

    /// The drive for a whole reference, in units relative to the operating point.
    ///
    /// Before its first sample and after its last one the reference is taken as held: the plant is expected to rest at the first
    /// sample when the run starts.
    #[must_use]
    pub fn apply(&self, reference_mm: &[f64]) -> Vec<f64> {
        let Some(last) = reference_mm.len().checked_sub(1) else { return Vec::new() };
        let at = |k: isize| reference_mm[k.clamp(0, last as isize) as usize];
        (0..reference_mm.len())
            .map(|k| {
                let newest = (k + self.n_preview) as isize;
                self.taps.iter().enumerate().map(|(i, tap)| tap * at(newest - i as isize)).sum()
            })
            .collect()
    }

    /// The same filter for a plant of unit DC gain: it shapes a reference and leaves its unit, for use before a
    /// [`StaticInverse`](super::StaticInverse).
    #[must_use]
    pub fn shaped(&self) -> Self {
        let taps = self.taps.iter().map(|t| t / self.dc_gain_unit_per_mm).collect();
        Self { taps, dc_gain_unit_per_mm: 1.0, ..self.clone() }
    }
}

/// Points of the frequency grid: 16 s at 2 kHz, far longer than any filter here, so that nothing wraps around.
const GRID: usize = 1 << 15;
/// Share of the DC gain that the taps cut off on one side may sum up to.
pub const TAIL_MAX: f64 = 1e-4;
/// A response below this share of the DC gain cannot be inverted.
const PLANT_FLOOR: f64 = 1e-9;

/// Gaussian-smoothed box of half-width `bandwidth_hz`; 1 at zero frequency.
fn low_pass(frequency_hz: f64, bandwidth_hz: f64, transition_hz: f64) -> f64 {
    let edge = |f: f64| 0.5 * libm::erfc(f / (SQRT_2 * transition_hz));
    edge(frequency_hz - bandwidth_hz) - edge(frequency_hz + bandwidth_hz)
}

/// The filter on the circle of [`GRID`] samples, index 0 at the present, rising indices ahead of it.
fn circular_response(
    plant: &TransferFunction,
    sample_time: SampleTime,
    options: &PreviewOptions,
) -> Result<Vec<f64>> {
    let sample_time_s = sample_time.seconds();
    let sampled = plant.to_state_space().to_discrete_zoh(sample_time)?;
    let floor = PLANT_FLOOR * plant.dc_gain()?.abs();
    let mut spectrum = vec![Complex64::default(); GRID / 2 + 1];
    for (k, bin) in spectrum.iter_mut().enumerate() {
        let frequency_hz = k as f64 / (GRID as f64 * sample_time_s);
        let pass = low_pass(frequency_hz, options.bandwidth_hz, options.transition_hz);
        if pass < f64::EPSILON {
            continue;
        }
        let omega = TAU * frequency_hz;
        let response = sampled.at(omega)?[(0, 0)];
        if response.norm() < floor {
            return Err(Error::PreviewPlantZero { frequency_hz });
        }
        let filter = pass * Complex64::from_polar(1.0, omega * options.delay_s) / response;
        // Conjugate, so that a lead becomes a positive index.
        *bin = filter.conj() / GRID as f64;
    }
    // A real signal has real ends of its spectrum.
    spectrum[0].im = 0.0;
    spectrum[GRID / 2].im = 0.0;
    let mut response = vec![0.0; GRID];
    let inverse = RealFftPlanner::<f64>::new().plan_fft_inverse(GRID);
    assert!(
        inverse.process(&mut spectrum, &mut response).is_ok(),
        "buffers of the planned length, ends real"
    );
    Ok(response)
}

/// The last index that must be kept so that the rest sums to less than the tail allowed.
fn reach(side: impl DoubleEndedIterator<Item = f64> + ExactSizeIterator, dc_gain: f64) -> Result<usize> {
    let n = side.len();
    let mut rest = 0.0;
    for (from_end, tap) in side.rev().enumerate() {
        rest += tap.abs();
        if rest > TAIL_MAX * dc_gain {
            let kept = n - from_end;
            return if kept < TAPS_MAX {
                Ok(kept)
            } else {
                Err(Error::PreviewTooLong { taps_max: TAPS_MAX })
            };
        }
    }
    Ok(0)
}

/// Longest side of a filter: 4 s at 2 kHz.
const TAPS_MAX: usize = 8192;

fn check_options(options: &PreviewOptions, sample_time_s: f64) -> Result<()> {
    let PreviewOptions { bandwidth_hz, transition_hz, delay_s } = *options;
    let top = bandwidth_hz + 6.0 * transition_hz;
    for (key, found, ok, allowed) in [
        ("bandwidth_hz", bandwidth_hz, bandwidth_hz > 0.0, "above 0"),
        ("transition_hz", transition_hz, transition_hz > 0.0, "above 0"),
        ("delay_s", delay_s, (0.0..1.0).contains(&delay_s), "0 to 1"),
        (
            "bandwidth_hz + 6 transition_hz",
            top,
            TAU * top < PI / sample_time_s,
            "below half of the sample rate",
        ),
    ] {
        if !ok || !found.is_finite() {
            return Err(Error::OutOfRange { key, found, allowed });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn printed() -> TransferFunction {
        TransferFunction::new(&[1350.14], &[0.0045, 1.07182, 22.458, 1444.0]).expect("proper")
    }

    fn design(options: &PreviewOptions) -> PreviewFeedforward {
        preview_feedforward(&printed(), SampleTime::new(5e-4).expect("positive"), options).expect("designs")
    }

    #[test]
    fn law_dc_gain_is_the_inverse_of_the_plants() {
        let filter = design(&PreviewOptions::default());
        let sum: f64 = filter.taps.iter().sum();
        assert!((sum - 1444.0 / 1350.14).abs() < 1e-12);
        assert!(filter.apply(&[0.3; 500]).iter().all(|u| (u - 0.3 * sum).abs() < 1e-12));
        let shaped: f64 = filter.shaped().taps.iter().sum();
        assert!((shaped - 1.0).abs() < 1e-12);
    }

    #[test]
    fn law_horizon_grows_with_the_dead_time_and_shrinks_with_the_edge() {
        let plain = design(&PreviewOptions::default());
        assert!((0.1..0.16).contains(&plain.horizon_s), "{}", plain.horizon_s);
        assert!(plain.horizon_energy_s < plain.horizon_s);
        let late = design(&PreviewOptions { delay_s: 0.02, ..PreviewOptions::default() });
        assert!((late.horizon_s - plain.horizon_s - 0.02).abs() < 2e-3);
        for horizon_s in [0.04, 0.1, 0.25] {
            let transition_hz = transition_for_horizon_hz(horizon_s);
            let fitted = design(&PreviewOptions { transition_hz, ..PreviewOptions::default() });
            assert!(fitted.horizon_s <= horizon_s, "{} over {horizon_s}", fitted.horizon_s);
            assert!(fitted.horizon_s > 0.7 * horizon_s, "{} far below {horizon_s}", fitted.horizon_s);
        }
    }

    #[test]
    fn law_one_tick_equals_the_whole() {
        let filter = design(&PreviewOptions::default());
        let reference: Vec<f64> = (0..3000).map(|k| (f64::from(k) * 0.013).sin() + 0.1).collect();
        let whole = filter.apply(&reference);
        let k = 1500;
        let tick = filter.command(&reference[k - filter.n_past()..=k + filter.n_preview]).expect("length");
        assert!((tick - whole[k]).abs() < 1e-12);
        assert!(filter.command(&reference[..5]).is_err());
        assert!(filter.apply(&[]).is_empty());
    }

    #[test]
    fn edge_options_and_plants_out_of_range_are_refused() {
        let sample_time = SampleTime::new(5e-4).expect("positive");
        let refused = |options| preview_feedforward(&printed(), sample_time, &options).expect_err("refused");
        let wide = PreviewOptions { bandwidth_hz: 990.0, ..PreviewOptions::default() };
        assert!(refused(wide).to_string().contains("below half of the sample rate"));
        let nan = PreviewOptions { transition_hz: f64::NAN, ..PreviewOptions::default() };
        assert!(matches!(refused(nan), Error::OutOfRange { key: "transition_hz", .. }));
        // An edge of 1 mHz rings for minutes.
        let narrow = PreviewOptions { transition_hz: 1e-3, ..PreviewOptions::default() };
        assert!(matches!(refused(narrow), Error::PreviewTooLong { .. }));
        let blind = TransferFunction::new(&[1.0, 0.0], &[1.0, 1.0]).expect("proper");
        let found = preview_feedforward(&blind, sample_time, &PreviewOptions::default());
        assert!(matches!(found, Err(Error::PreviewPlantZero { .. })), "{found:?}");
    }
}
