//! The best linear estimate of where a reference should be, from as much of its future as is known.

use std::f64::consts::TAU;

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};
use telepulse_lti::SampleTime;

use crate::{Error, Result};

/// What a smoother should do.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SmootherOptions {
    /// How far ahead the reference is known, s.
    pub horizon_s: f64,
    /// How far back it looks, s.
    pub past_s: f64,
    /// Where following costs as much as it gains, Hz: the half-amplitude frequency with an endless horizon.
    pub bandwidth_hz: f64,
    /// Corner of the reference's assumed spectrum, Hz: amplitudes fall with the square of frequency beyond it.
    pub reference_corner_hz: f64,
}

impl Default for SmootherOptions {
    /// 0.2 s ahead and 0.25 s back, 60 Hz, a reference whose amplitudes fall beyond 2 Hz as those of a pulse.
    fn default() -> Self {
        Self { horizon_s: 0.2, past_s: 0.25, bandwidth_hz: 60.0, reference_corner_hz: 2.0 }
    }
}

/// A finite filter with unit gain at rest, from a reference known ahead to a smooth reference that a drive can follow.
///
/// **Shapes and units**: `out[k] = sum over i of taps[i] r[k + n_preview - i]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PreviewSmoother {
    /// The filter, its most advanced tap first.
    pub taps: Vec<f64>,
    /// Samples ahead of the present that it reads.
    pub n_preview: usize,
    /// Relative mean square of what it cannot follow of a reference with the assumed spectrum.
    pub expected_error: f64,
}

/// The H2-optimal smoother for a horizon.
///
/// **Method**: the reference is taken as noise of the power spectrum `S(f) = 1/(1 + (f/f_r)^2)^2`; the taps `h` minimise the mean square
/// `integral of S (|h - 1|^2 + (f/f_b)^8 |h|^2) df`, tracking error and effort of the drive, whose need grows with the
/// third power of frequency at a plate behind a circuit. With an endless horizon that is the zero-phase low-pass `1/(1 + (f/f_b)^8)`; with a
/// finite one the optimum uses the past to guess what is not known yet. The normal equations are Toeplitz, solved by Cholesky's method.
/// The DC gain is made exact afterwards.
///
/// **Source**: Wiener's filter with a finite lag (Kailath, Sayed, Hassibi, "Linear Estimation", 2000, chapter 7).
///
/// # Errors
/// [`Error::OutOfRange`] for times and frequencies that make no filter at this sample rate.
pub fn preview_smoother(sample_time: SampleTime, options: &SmootherOptions) -> Result<PreviewSmoother> {
    let sample_time_s = sample_time.seconds();
    check(options, sample_time_s)?;
    let n_preview = (options.horizon_s / sample_time_s + 1e-9) as usize;
    let n_past = (options.past_s / sample_time_s + 1e-9) as usize;
    let n = n_preview + n_past + 1;
    let spectra = Spectra::new(options, sample_time_s);
    let total: Vec<f64> = (0..n).map(|k| spectra.correlation(k as f64 * sample_time_s, Part::All)).collect();
    let wanted = DVector::from_fn(n, |i, _| {
        let lag_s = (i as f64 - n_preview as f64) * sample_time_s;
        spectra.correlation(lag_s, Part::Reference)
    });
    let normal = DMatrix::from_fn(n, n, |i, j| total[i.abs_diff(j)]);
    let Some(factor) = normal.cholesky() else {
        return Err(Error::OutOfRange {
            key: "bandwidth_hz",
            found: options.bandwidth_hz,
            allowed: "within reach of double precision for this horizon",
        });
    };
    let mut taps = factor.solve(&wanted);
    let expected_error = (1.0 - taps.dot(&wanted) / spectra.correlation(0.0, Part::Reference)).max(0.0);
    taps /= taps.sum();
    Ok(PreviewSmoother { taps: taps.as_slice().to_vec(), n_preview, expected_error })
}

impl PreviewSmoother {
    /// The smoothed reference; before its first sample and after its last one the reference is taken as held.
    #[must_use]
    pub fn apply(&self, reference: &[f64]) -> Vec<f64> {
        let (Some(first), Some(last)) = (reference.first(), reference.last()) else { return Vec::new() };
        let n_past = self.taps.len() - 1 - self.n_preview;
        let mut padded = vec![*first; n_past];
        padded.extend_from_slice(reference);
        padded.extend(std::iter::repeat_n(*last, self.n_preview));
        padded
            .windows(self.taps.len())
            .map(|window| self.taps.iter().zip(window.iter().rev()).map(|(tap, r)| tap * r).sum())
            .collect()
    }
}

#[derive(Clone, Copy)]
enum Part {
    Reference,
    All,
}

/// Spectra on a grid of frequencies from 0 to half of the sample rate.
struct Spectra {
    step_hz: f64,
    reference: Vec<f64>,
    all: Vec<f64>,
}

impl Spectra {
    fn new(options: &SmootherOptions, sample_time_s: f64) -> Self {
        let step_hz = GRID_STEP_PER_TIME / (options.horizon_s + options.past_s).max(20.0 * sample_time_s);
        let n = (0.5 / sample_time_s / step_hz) as usize + 1;
        let reference: Vec<f64> = (0..n)
            .map(|k| (1.0 + (k as f64 * step_hz / options.reference_corner_hz).powi(2)).powi(-2))
            .collect();
        let all = reference
            .iter()
            .enumerate()
            .map(|(k, s)| s * (1.0 + (k as f64 * step_hz / options.bandwidth_hz).powi(EFFORT_POWER)))
            .collect();
        Self { step_hz, reference, all }
    }

    /// Integral of a spectrum times `cos(2 pi f lag)`.
    fn correlation(&self, lag_s: f64, part: Part) -> f64 {
        let values = match part {
            Part::Reference => &self.reference,
            Part::All => &self.all,
        };
        // cos(k phi) by its recurrence; the grid is short enough for its rounding.
        let phi = TAU * self.step_hz * lag_s;
        let double = 2.0 * phi.cos();
        let (mut before, mut here, mut sum) = (phi.cos(), 1.0, 0.0);
        for (k, value) in values.iter().enumerate() {
            // Trapezoidal at the start; the end is far below everything.
            sum += if k == 0 { 0.5 * value } else { value * here };
            let next = double * here - before;
            before = here;
            here = next;
        }
        sum * self.step_hz
    }
}

/// Grid step times the length of the filter: correlations wrap around only after four lengths.
const GRID_STEP_PER_TIME: f64 = 0.125;
/// Effort of the drive over frequency, as a power of its square.
const EFFORT_POWER: i32 = 8;

fn check(options: &SmootherOptions, sample_time_s: f64) -> Result<()> {
    let SmootherOptions { horizon_s, past_s, bandwidth_hz, reference_corner_hz } = *options;
    let n = (horizon_s + past_s) / sample_time_s;
    for (key, found, ok, allowed) in [
        ("horizon_s", horizon_s, horizon_s >= 0.0, "0 or above"),
        ("past_s", past_s, past_s > 0.0, "above 0"),
        ("horizon_s + past_s in samples", n, (8.0..=N_MAX).contains(&n), "8 to 4096"),
        (
            "bandwidth_hz",
            bandwidth_hz,
            bandwidth_hz > 0.0 && bandwidth_hz * sample_time_s < 0.25,
            "below half of the Nyquist frequency",
        ),
        (
            "reference_corner_hz",
            reference_corner_hz,
            reference_corner_hz > 0.0 && reference_corner_hz < bandwidth_hz,
            "above 0 and below the bandwidth",
        ),
    ] {
        if !ok || !found.is_finite() {
            return Err(Error::OutOfRange { key, found, allowed });
        }
    }
    Ok(())
}

/// Longest filter: its normal equations are solved densely.
const N_MAX: f64 = 4096.0;

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    fn smoother(horizon_s: f64) -> PreviewSmoother {
        let options = SmootherOptions { horizon_s, ..SmootherOptions::default() };
        preview_smoother(SampleTime::new(5e-4).expect("positive"), &options).expect("designs")
    }

    /// The response `sum of taps e^(-i omega t)` at a frequency, real and imaginary part.
    fn response(filter: &PreviewSmoother, frequency_hz: f64) -> [f64; 2] {
        let mut sum = [0.0; 2];
        for (i, tap) in filter.taps.iter().enumerate() {
            let angle = TAU * frequency_hz * 5e-4 * (filter.n_preview as f64 - i as f64);
            sum[0] += tap * angle.cos();
            sum[1] += tap * angle.sin();
        }
        sum
    }

    #[test]
    fn law_a_long_horizon_gives_the_zero_phase_low_pass() {
        let filter = smoother(0.2);
        for frequency_hz in [0.0, 1.0, 5.0, 10.0, 20.0, 40.0, 60.0, 90.0] {
            let expected = 1.0 / (1.0 + (frequency_hz / 60.0_f64).powi(8));
            let [re, im] = response(&filter, frequency_hz);
            // The finite past of 0.25 s and the exact DC gain leave less than a thousandth.
            assert!((re - expected).abs() < 1e-3 && im.abs() < 1e-3, "{frequency_hz} Hz: {re} {im}");
        }
    }

    #[test]
    fn law_the_expected_error_is_met_by_noise_of_the_assumed_spectrum_and_falls_with_the_horizon() {
        // White noise through 1/(1 + s/(2 pi 2 Hz))^2, sampled: two equal first-order sections.
        let mut random = Pcg64Mcg::seed_from_u64(11);
        let keep = (-TAU * 2.0 * 5e-4_f64).exp();
        let mut sections = [0.0; 2];
        let signal: Vec<f64> = (0..400_000)
            .map(|_| {
                let white: f64 =
                    (0..3).map(|_| f64::from(random.next_u32()) / f64::from(u32::MAX) - 0.5).sum();
                sections[0] += (1.0 - keep) * (white - sections[0]);
                sections[1] += (1.0 - keep) * (sections[0] - sections[1]);
                sections[1]
            })
            .collect();
        let power = signal.iter().map(|r| r * r).sum::<f64>();
        let mut previous = f64::INFINITY;
        for horizon_s in [0.0, 0.004, 0.01, 0.05] {
            let filter = smoother(horizon_s);
            let error: f64 = filter.apply(&signal).iter().zip(&signal).map(|(a, b)| (a - b).powi(2)).sum();
            // The expectation holds the effort too; what is measured is the error alone.
            let relative = error / power;
            assert!(relative < 1.3 * filter.expected_error, "{relative} {}", filter.expected_error);
            assert!(relative > 0.1 * filter.expected_error, "{relative} {}", filter.expected_error);
            assert!(filter.expected_error < previous);
            previous = filter.expected_error;
        }
    }

    #[test]
    fn edge_options_that_make_no_filter_are_refused() {
        let sample_time = SampleTime::new(5e-4).expect("positive");
        let good = SmootherOptions::default();
        for (options, key) in [
            (SmootherOptions { horizon_s: -0.1, ..good }, "horizon_s"),
            (SmootherOptions { past_s: 0.0, ..good }, "past_s"),
            (SmootherOptions { horizon_s: 9.0, ..good }, "in samples"),
            (SmootherOptions { bandwidth_hz: 600.0, ..good }, "bandwidth_hz"),
            (SmootherOptions { reference_corner_hz: 70.0, ..good }, "reference_corner_hz"),
            (SmootherOptions { bandwidth_hz: f64::NAN, ..good }, "bandwidth_hz"),
        ] {
            let message = preview_smoother(sample_time, &options).expect_err("refused").to_string();
            assert!(message.contains(key), "{message}");
        }
    }
}
