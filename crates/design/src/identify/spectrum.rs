//! Amplitude, phase and harmonics of a sine that fills a whole number of periods.

use num_complex::Complex64;
use realfft::RealFftPlanner;

use crate::{Error, Result};

/// What a window of whole periods holds at the frequency of its excitation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Complex amplitude of the fundamental: `re(value * exp(j w t))`, t = 0 at the first sample of the window.
    pub value: Complex64,
    /// Amplitude of the second harmonic, in the unit of the signal.
    pub second: f64,
    /// Amplitude of the third harmonic, in the unit of the signal.
    pub third: f64,
    /// Mean of the window.
    pub mean: f64,
    /// Linear drift over the whole window, in the unit of the signal; it was removed before the transform.
    pub drift: f64,
}

/// The line at `n_periods` periods per window.
///
/// **Shapes and units**: `window` is one real signal of N samples, N even, which holds `n_periods` whole periods,
/// `n_periods` even; results have the unit of the signal.
///
/// **Method**: a viscoelastic rig creeps while it is swept, and a ramp leaks into every line of a discrete Fourier
/// transform. Removing the least-squares line first would be wrong, since a sine over whole periods is not orthogonal
/// to a ramp and loses part of itself. Both halves of the window hold whole periods, so the difference of their means
/// is free of the fundamental and of all harmonics: `(mean of second half - mean of first half) / (N/2)` is the
/// slope, exactly, for any periodic signal plus a straight line. It is subtracted, then one FFT of length N gives the
/// bins `n_periods`, `2 n_periods` and `3 n_periods`.
///
/// **Accuracy**: rounding for a periodic signal plus a ramp. A drift that bends by q over the window (its deviation from
/// the chord at the middle) leaves an error of at most `4 q / (pi n_periods)^2` in the line.
///
/// # Errors
/// [`Error::SampleNotFinite`]; [`Error::OutOfRange`] where N or `n_periods` is odd or zero, or where the third
/// harmonic would pass half of the sample rate.
pub fn extract_line(signal: &'static str, window: &[f64], n_periods: usize) -> Result<Line> {
    let n = window.len();
    if n_periods == 0 || !n_periods.is_multiple_of(2) {
        let allowed = "even and at least 2";
        return Err(Error::OutOfRange { key: "n_periods", found: n_periods as f64, allowed });
    }
    if !n.is_multiple_of(2) || n <= 6 * n_periods {
        let allowed = "even, and more than 6 samples per period";
        return Err(Error::OutOfRange { key: "samples in window", found: n as f64, allowed });
    }
    if let Some(sample_idx) = window.iter().position(|v| !v.is_finite()) {
        return Err(Error::SampleNotFinite { signal, sample_idx, found: window[sample_idx] });
    }

    let half = n / 2;
    let first_mean = window[..half].iter().sum::<f64>() / half as f64;
    let second_mean = window[half..].iter().sum::<f64>() / half as f64;
    let slope = (second_mean - first_mean) / half as f64;
    let mean = 0.5 * (first_mean + second_mean);
    let centre = (n as f64 - 1.0) / 2.0;

    let mut work: Vec<f64> =
        window.iter().enumerate().map(|(k, v)| v - mean - slope * (k as f64 - centre)).collect();
    let forward = RealFftPlanner::<f64>::new().plan_fft_forward(n);
    let mut bins = forward.make_output_vec();
    // Both buffers come from the plan's own length, which is the only thing that the transform can refuse.
    assert!(forward.process(&mut work, &mut bins).is_ok(), "buffers of the planned length");

    let amplitude = |bin: usize| bins[bin] * (2.0 / n as f64);
    Ok(Line {
        value: amplitude(n_periods),
        second: amplitude(2 * n_periods).norm(),
        third: amplitude(3 * n_periods).norm(),
        mean,
        drift: slope * n as f64,
    })
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    fn window(n: usize, f: impl Fn(f64) -> f64) -> Vec<f64> {
        (0..n).map(|k| f(k as f64 / n as f64)).collect()
    }

    #[test]
    fn law_line_is_exact_under_offset_ramp_and_harmonics() {
        let w = window(1234, |x| {
            3.0 + 5.0 * x
                + 0.25 * (TAU * 4.0 * x + 0.7).cos()
                + 0.02 * (TAU * 8.0 * x).sin()
                + 0.01 * (TAU * 12.0 * x + 1.0).sin()
        });
        let line = extract_line("response", &w, 4).expect("valid window");
        assert!((line.value - Complex64::from_polar(0.25, 0.7)).norm() < 1e-13);
        assert!((line.second - 0.02).abs() < 1e-13 && (line.third - 0.01).abs() < 1e-13);
        assert!((line.drift - 5.0).abs() < 1e-12);
    }

    #[test]
    fn law_bent_drift_stays_within_the_stated_error() {
        // A parabola with deviation 1 from its chord at the middle.
        for n_periods in [2, 4, 6] {
            let w = window(4000, |x| 4.0 * x * (1.0 - x));
            let line = extract_line("response", &w, n_periods).expect("valid window");
            let bound = 4.0 / (std::f64::consts::PI * n_periods as f64).powi(2);
            assert!(line.value.norm() <= bound, "{} over {bound}", line.value.norm());
        }
    }

    #[test]
    fn edge_windows_that_cannot_hold_whole_periods_are_refused() {
        assert!(matches!(extract_line("response", &[0.0; 100], 3), Err(Error::OutOfRange { .. })));
        assert!(matches!(extract_line("response", &[0.0; 101], 2), Err(Error::OutOfRange { .. })));
        assert!(matches!(extract_line("response", &[0.0; 12], 2), Err(Error::OutOfRange { .. })));
        let mut w = vec![0.0; 100];
        w[17] = f64::NAN;
        let found = extract_line("response", &w, 2);
        assert!(matches!(found, Err(Error::SampleNotFinite { sample_idx: 17, .. })));
    }
}
