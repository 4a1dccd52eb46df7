//! One-sided amplitude spectrum and its peaks.

use std::f64::consts::TAU;

use realfft::RealFftPlanner;

use crate::Error;
use crate::recording::{check_finite, check_rate};

/// Amplitude of each harmonic of the record length.
///
/// **Shapes and units**: bin `k` belongs to `k sample_rate_hz / n`; a sine of amplitude `A` in the middle of
/// a bin shows `A` there. The mean is removed first, so bin 0 is 0 (with a window: close to it).
#[derive(Debug, Clone, PartialEq)]
pub struct Spectrum {
    bin_width_hz: f64,
    amplitudes: Vec<f64>,
}

/// Weighting of the record before the transform.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Window {
    /// None: narrowest peaks, most leakage.
    Rectangular,
    /// Raised cosine over one period: less leakage, peaks twice as wide.
    Hann,
}

/// A local maximum of a spectrum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpectralPeak {
    /// Bin of the maximum.
    pub bin: usize,
    /// Frequency of the bin.
    pub frequency_hz: f64,
    /// Amplitude in the bin.
    pub amplitude: f64,
    /// Height above the higher of the two valleys that part it from higher ground.
    pub prominence: f64,
}

impl Spectrum {
    /// The spectrum of `values`.
    ///
    /// **Method**: real FFT of any length, divided by the sum of the window and doubled except at 0 and at
    /// half the sample rate.
    ///
    /// **Errors**: fewer than two samples, a sample that is not finite, a rate that is not positive and
    /// finite.
    ///
    /// **Example**
    /// ```
    /// use telepulse_pulse::spectrum::{Spectrum, Window};
    /// let tone: Vec<f64> = (0..100).map(|i| 3.0 * (0.2 * std::f64::consts::PI * i as f64).cos()).collect();
    /// let spectrum = Spectrum::of(&tone, 50.0, Window::Rectangular)?;
    /// assert!((spectrum.amplitudes()[10] - 3.0).abs() < 1e-12 && spectrum.frequency_hz(10) == 5.0);
    /// # Ok::<(), telepulse_pulse::Error>(())
    /// ```
    pub fn of(values: &[f64], sample_rate_hz: f64, window: Window) -> Result<Self, Error> {
        check_rate(sample_rate_hz)?;
        check_finite(values)?;
        let n = values.len();
        if n < 2 {
            return Err(Error::TooShort { required: 2, found: n });
        }
        let mean = values.iter().sum::<f64>() / n as f64;
        let weights: Vec<f64> = (0..n).map(|idx| window.weight(idx, n)).collect();
        let mut input: Vec<f64> =
            values.iter().zip(&weights).map(|(value, weight)| (value - mean) * weight).collect();
        let transform = RealFftPlanner::<f64>::new().plan_fft_forward(n);
        let mut output = transform.make_output_vec();
        // The buffers come from the plan and the values, all of length n: the only error it knows cannot
        // occur.
        assert!(transform.process(&mut input, &mut output).is_ok());
        let scale = 2.0 / weights.iter().sum::<f64>();
        let mut amplitudes: Vec<f64> = output.iter().map(|bin| bin.norm() * scale).collect();
        amplitudes[0] /= 2.0;
        if n.is_multiple_of(2) {
            amplitudes[n / 2] /= 2.0;
        }
        Ok(Self { bin_width_hz: sample_rate_hz / n as f64, amplitudes })
    }

    /// Amplitudes from bin 0 to half the sample rate, in the unit of the values.
    pub fn amplitudes(&self) -> &[f64] {
        &self.amplitudes
    }

    /// Distance of two bins.
    pub fn bin_width_hz(&self) -> f64 {
        self.bin_width_hz
    }

    /// Frequency of a bin.
    pub fn frequency_hz(&self, bin: usize) -> f64 {
        bin as f64 * self.bin_width_hz
    }

    /// Frequencies of all bins.
    pub fn frequencies_hz(&self) -> Vec<f64> {
        (0..self.amplitudes.len()).map(|bin| self.frequency_hz(bin)).collect()
    }

    /// Local maxima of at least this prominence, by rising frequency.
    ///
    /// **Method**: prominence is the height above the higher of the two minima between the peak and the next
    /// higher bin (or the end) on either side. The first and the last bin are no peaks; of a plateau the
    /// first bin counts.
    pub fn peaks(&self, prominence_min: f64) -> Vec<SpectralPeak> {
        let a = &self.amplitudes;
        (1..a.len().saturating_sub(1))
            .filter(|&bin| a[bin] > a[bin - 1] && rises_no_more(&a[bin..]))
            .map(|bin| {
                let valley = |side: &mut dyn Iterator<Item = &f64>| {
                    side.take_while(|value| **value <= a[bin]).fold(a[bin], |low, &value| low.min(value))
                };
                let left = valley(&mut a[..bin].iter().rev());
                let right = valley(&mut a[bin + 1..].iter());
                let prominence = a[bin] - left.max(right);
                SpectralPeak { bin, frequency_hz: self.frequency_hz(bin), amplitude: a[bin], prominence }
            })
            .filter(|peak| peak.prominence >= prominence_min)
            .collect()
    }
}

/// Whether the first value that differs from `tail[0]` lies below it; a plateau that reaches the end is no
/// peak.
fn rises_no_more(tail: &[f64]) -> bool {
    tail.iter().find(|value| **value != tail[0]).is_some_and(|next| *next < tail[0])
}

impl Window {
    fn weight(self, idx: usize, n: usize) -> f64 {
        match self {
            Self::Rectangular => 1.0,
            Self::Hann => 0.5 - 0.5 * (TAU * idx as f64 / n as f64).cos(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_tones_show_their_amplitudes_with_each_window() {
        for n in [200, 201] {
            let rate = n as f64;
            let tone = |i: usize| {
                let t = i as f64 / rate;
                7.0 + 2.0 * (TAU * 10.0 * t).sin() + 0.5 * (TAU * 37.0 * t + 1.0).cos()
            };
            let values: Vec<f64> = (0..n).map(tone).collect();
            for window in [Window::Rectangular, Window::Hann] {
                let spectrum = Spectrum::of(&values, rate, window).expect("valid");
                assert!((spectrum.amplitudes()[10] - 2.0).abs() < 1e-12);
                assert!((spectrum.amplitudes()[37] - 0.5).abs() < 1e-12);
                assert!(spectrum.amplitudes()[0].abs() < 1e-12);
                let bins: Vec<usize> = spectrum.peaks(0.1).iter().map(|peak| peak.bin).collect();
                assert_eq!(bins, [10, 37]);
            }
        }
    }

    #[test]
    fn law_the_transform_agrees_with_the_plain_sum() {
        let values: Vec<f64> = (0..60).map(|i| ((i * i) % 17) as f64).collect();
        let spectrum = Spectrum::of(&values, 60.0, Window::Rectangular).expect("valid");
        for k in 1..30 {
            let angle = |i: usize| TAU * (k * i) as f64 / 60.0;
            let re: f64 = values.iter().enumerate().map(|(i, v)| v * angle(i).cos()).sum();
            let im: f64 = values.iter().enumerate().map(|(i, v)| v * angle(i).sin()).sum();
            assert!((spectrum.amplitudes()[k] - re.hypot(im) / 30.0).abs() < 1e-12);
        }
    }

    #[test]
    fn law_prominence_counts_from_the_higher_valley() {
        let spectrum =
            Spectrum { bin_width_hz: 1.0, amplitudes: vec![0.0, 5.0, 2.0, 3.0, 1.0, 9.0, 9.0, 0.0, 4.0] };
        let peaks: Vec<(usize, f64)> =
            spectrum.peaks(0.0).iter().map(|peak| (peak.bin, peak.prominence)).collect();
        assert_eq!(peaks, [(1, 4.0), (3, 1.0), (5, 9.0)]);
        assert_eq!(spectrum.peaks(2.0).len(), 2);
    }

    #[test]
    fn edge_bad_input_is_refused() {
        let of = |values: &[f64], rate| Spectrum::of(values, rate, Window::Hann);
        assert!(matches!(of(&[1.0], 1.0), Err(Error::TooShort { .. })));
        assert!(matches!(of(&[1.0, f64::INFINITY], 1.0), Err(Error::NotFinite { .. })));
        assert!(matches!(of(&[1.0, 2.0], -1.0), Err(Error::Parameter { .. })));
    }
}
