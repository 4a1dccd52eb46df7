//! A synthetic pulse: a sum of Gaussians per beat.

use crate::recording::{check_rate, extent};
use crate::{Error, PulseRecording, Unit};

/// One Gaussian of a beat.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GaussianComponent {
    /// Height relative to the others.
    pub amplitude: f64,
    /// Time of its maximum after the start of the beat.
    pub centre_s: f64,
    /// Standard deviation.
    pub width_s: f64,
}

/// A strictly periodic pulse.
///
/// **Shapes and units**: `y(t) = sum_k sum_n a_k exp(-(t - mu_k - n T)^2 / (2 s_k^2))`, `T = 1 / rate_hz`:
/// each beat runs on into the next. A record is then moved so that its smallest sample is 0 and scaled so
/// that its largest is `peak_to_peak_pa`.
#[derive(Debug, Clone, PartialEq)]
pub struct SyntheticPulse {
    /// Beats per second.
    pub rate_hz: f64,
    /// The Gaussians of one beat.
    pub components: Vec<GaussianComponent>,
    /// Largest minus smallest sample of a record.
    pub peak_to_peak_pa: f64,
}

impl Default for SyntheticPulse {
    /// The pulse whose 2.56 s record at 100 Hz has the paper's spectral peaks and its 827.3709 Pa.
    fn default() -> Self {
        // Rate: inferred from the paper's three peaks, bins 3, 7 and 10 of 0.390625 Hz. Components: systolic,
        // reflected, dicrotic and diastolic wave, chosen for a plausible shape; the paper prints no waveform.
        let gaussian = |amplitude, centre_s, width_s| GaussianComponent { amplitude, centre_s, width_s };
        Self {
            rate_hz: 1.3055,
            components: vec![
                gaussian(1.0, 0.13, 0.047),
                gaussian(0.5, 0.26, 0.06),
                gaussian(0.3, 0.43, 0.06),
                gaussian(0.22, 0.42, 0.17),
            ],
            peak_to_peak_pa: 827.3709,
        }
    }
}

impl SyntheticPulse {
    /// The value at time `t_s` before shift and scaling.
    ///
    /// **Accuracy**: the sum runs over the beats within 8 standard deviations, so it is exact to 1e-14 of the
    /// largest amplitude.
    pub fn shape_at(&self, t_s: f64) -> f64 {
        let period = 1.0 / self.rate_hz;
        let wave = |component: &GaussianComponent| {
            let phase = (t_s - component.centre_s).rem_euclid(period);
            let n_beats = (8.0 * component.width_s / period).ceil() as i64 + 1;
            let beat = |n: i64| (-0.5 * ((phase - n as f64 * period) / component.width_s).powi(2)).exp();
            component.amplitude * (-n_beats..=n_beats).map(beat).sum::<f64>()
        };
        self.components.iter().map(wave).sum()
    }

    /// A record of `n_samples` from the start of a beat.
    ///
    /// **Errors**: fewer than two samples; a rate, width or peak-to-peak value that is not positive and
    /// finite, or a width of more than 100 periods; a shape that is constant over the record.
    pub fn record(&self, sample_rate_hz: f64, n_samples: usize) -> Result<PulseRecording, Error> {
        self.check()?;
        check_rate(sample_rate_hz)?;
        if n_samples < 2 {
            return Err(Error::TooShort { required: 2, found: n_samples });
        }
        let shape: Vec<f64> = (0..n_samples).map(|idx| self.shape_at(idx as f64 / sample_rate_hz)).collect();
        let (low, high) = extent(&shape);
        if high <= low {
            return Err(Error::NoVariation { which: "synthetic pulse" });
        }
        let values = shape.iter().map(|y| (y - low) / (high - low) * self.peak_to_peak_pa).collect();
        let mut recording = PulseRecording::new(Unit::Pascal, sample_rate_hz, values)?;
        recording.title = "synthetic pulse".to_owned();
        recording.provenance.source = format!(
            "sum of {} Gaussians per beat, {} beats per second, {} Pa peak to peak",
            self.components.len(),
            self.rate_hz,
            self.peak_to_peak_pa
        );
        Ok(recording)
    }

    fn check(&self) -> Result<(), Error> {
        let positive = |name, found: f64| {
            let fits = found.is_finite() && found > 0.0;
            if fits { Ok(()) } else { Err(Error::Parameter { name, allowed: "a finite value > 0", found }) }
        };
        positive("rate_hz", self.rate_hz)?;
        positive("peak_to_peak_pa", self.peak_to_peak_pa)?;
        for component in &self.components {
            positive("width_s", component.width_s)?;
            if component.width_s * self.rate_hz > 100.0 {
                return Err(Error::Parameter {
                    name: "width_s",
                    allowed: "at most 100 periods",
                    found: component.width_s,
                });
            }
            for (name, found) in [("amplitude", component.amplitude), ("centre_s", component.centre_s)] {
                if !found.is_finite() {
                    return Err(Error::Parameter { name, allowed: "a finite value", found });
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spectrum::{Spectrum, Window};

    #[test]
    fn paper_fig17_default_record_peaks_in_bins_3_7_and_10() {
        let record = SyntheticPulse::default().record(100.0, 256).expect("valid");
        assert!((record.peak_to_peak() - 827.3709).abs() < 1e-10);
        let spectrum = Spectrum::of(record.values(), 100.0, Window::Rectangular).expect("valid");
        let peaks = spectrum.peaks(0.05 * spectrum.amplitudes().iter().skip(1).copied().fold(0.0, f64::max));
        let bins: Vec<usize> = peaks.iter().take(3).map(|peak| peak.bin).collect();
        assert_eq!(bins, [3, 7, 10]);
        // Printed 1.172, 2.734 and 3.906 Hz are these bins to four digits.
        for (peak, printed) in peaks.iter().zip([1.172, 2.734, 3.906]) {
            assert!((peak.frequency_hz - printed).abs() < 5e-4);
        }
    }

    #[test]
    fn law_the_pulse_repeats_with_its_period() {
        let pulse = SyntheticPulse::default();
        for t in [0.0, 0.1, 0.37, 0.7659] {
            let later = pulse.shape_at(t + 3.0 / pulse.rate_hz);
            assert!((later - pulse.shape_at(t)).abs() < 1e-12);
        }
    }

    #[test]
    fn edge_impossible_pulses_are_refused() {
        let default = SyntheticPulse::default;
        let cases = [
            SyntheticPulse { rate_hz: 0.0, ..default() },
            SyntheticPulse { peak_to_peak_pa: f64::NAN, ..default() },
            SyntheticPulse {
                components: vec![GaussianComponent { amplitude: 1.0, centre_s: 0.1, width_s: 0.0 }],
                ..default()
            },
            SyntheticPulse {
                components: vec![GaussianComponent { amplitude: 1.0, centre_s: 0.1, width_s: 1e9 }],
                ..default()
            },
        ];
        for pulse in cases {
            assert!(matches!(pulse.record(100.0, 256), Err(Error::Parameter { .. })), "{pulse:?}");
        }
        let flat = SyntheticPulse { components: vec![], ..default() };
        assert!(matches!(flat.record(100.0, 256), Err(Error::NoVariation { .. })));
    }
}
