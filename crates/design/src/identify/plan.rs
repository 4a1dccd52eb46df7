//! Which sine is sent when, and how its recorded response becomes points.

use std::f64::consts::TAU;
use std::ops::Range;

use super::record::{Distortion, SweepPoint, SweepRecord};
use super::spectrum::extract_line;
use crate::{Error, Result};

/// What a stepped-sine sweep should do, as typed.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepOptions {
    /// Frequencies in Hz, in the order of the sweep; above 0 and below a quarter of half the sample rate.
    pub frequencies_hz: Vec<f64>,
    /// Amplitudes of the sine, fractions of full scale; all frequencies are swept at each.
    pub amplitudes: Vec<f64>,
    /// Mean of the drive, fraction of full scale. At zero bias a device whose force goes with voltage squared has
    /// no response at the frequency of the sine.
    pub bias: f64,
    /// Samples per second of drive and response.
    pub sample_rate_hz: f64,
    /// Least number of periods before each measured window.
    pub settle_periods: f64,
    /// Least time before each measured window, in s.
    pub settle_s: f64,
    /// Least number of periods in each measured window; made even, see [`extract_line`](super::extract_line).
    pub measured_periods: usize,
    /// Least length of each measured window, in s.
    pub measured_s: f64,
    /// Time at the bias alone before the first sine, in s.
    pub bias_settle_s: f64,
}

impl Default for SweepOptions {
    /// The sweep of the paper, section 3: 0.1 to 13 Hz (25 log-spaced, 6 more between 5 and 7.5 Hz) at amplitudes 0.2,
    /// 0.4 and 0.5. Bias 0.5, 2 kHz and the settling times are ours: the paper gives none.
    fn default() -> Self {
        let mut frequencies_hz = log_spaced(0.1, 13.0, 25);
        frequencies_hz.extend([5.0, 5.5, 6.0, 6.5, 7.0, 7.5]);
        frequencies_hz.sort_by(f64::total_cmp);
        Self {
            frequencies_hz,
            amplitudes: vec![0.2, 0.4, 0.5],
            bias: 0.5,
            sample_rate_hz: 2000.0,
            settle_periods: 1.0,
            settle_s: 1.5,
            measured_periods: 4,
            measured_s: 1.0,
            bias_settle_s: 60.0,
        }
    }
}

/// `n` frequencies from `min_hz` to `max_hz`, equally spaced on a logarithmic axis; both ends are exact.
#[must_use]
pub fn log_spaced(min_hz: f64, max_hz: f64, n: usize) -> Vec<f64> {
    let ratio = max_hz / min_hz;
    (0..n)
        .map(|k| match k {
            0 => min_hz,
            k if k + 1 == n => max_hz,
            k => min_hz * ratio.powf(k as f64 / (n - 1) as f64),
        })
        .collect()
}

/// One sine of a sweep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SweepSegment {
    /// The frequency sent, in Hz: the one asked for, moved so that the window holds whole periods.
    pub actual_frequency_hz: f64,
    /// The frequency asked for, in Hz.
    pub requested_frequency_hz: f64,
    /// Amplitude, fraction of full scale.
    pub amplitude: f64,
    /// Samples that are sent but not measured.
    pub n_settle_samples: usize,
    /// Samples of the measured window; even.
    pub n_measured_samples: usize,
    /// Periods in the measured window; even.
    pub n_measured_periods: usize,
}

impl SweepSegment {
    /// All samples of the segment.
    #[must_use]
    pub fn n_samples(&self) -> usize {
        self.n_settle_samples + self.n_measured_samples
    }

    /// The sine at sample `k` of the segment, fraction of full scale, without the bias.
    #[must_use]
    pub fn sine(&self, k: usize) -> f64 {
        // The phase is reduced in whole samples first, so that it is as exact at the end as at the start.
        let turn = (k * self.n_measured_periods) % self.n_measured_samples;
        self.amplitude * (TAU * turn as f64 / self.n_measured_samples as f64).sin()
    }
}

/// A checked stepped-sine sweep.
///
/// The drive is held between samples. It starts with the bias alone, then sends each segment in turn: amplitudes in
/// the order given, and within each all frequencies. Every sine starts at phase zero, so that the drive does not jump
/// at the start of a segment by more than one sample of the sine.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepPlan {
    bias: f64,
    sample_rate_hz: f64,
    n_bias_samples: usize,
    segments: Vec<SweepSegment>,
    starts: Vec<usize>,
    n_samples: usize,
}

impl SweepPlan {
    /// Checks the options and places every sample.
    ///
    /// # Errors
    /// [`Error::EmptyList`], [`Error::OutOfRange`], [`Error::DriveRange`] or [`Error::SameFrequency`], each with what was found.
    pub fn new(options: &SweepOptions) -> Result<Self> {
        check_options(options)?;
        let mut segments: Vec<SweepSegment> = Vec::new();
        for &amplitude in &options.amplitudes {
            let first_of_amplitude = segments.len();
            for &frequency_hz in &options.frequencies_hz {
                let segment = place_segment(options, frequency_hz, amplitude);
                let same = |s: &&SweepSegment| s.actual_frequency_hz == segment.actual_frequency_hz;
                if let Some(first) = segments[first_of_amplitude..].iter().find(same) {
                    let first_hz = first.requested_frequency_hz;
                    return Err(Error::SameFrequency { first_hz, second_hz: frequency_hz });
                }
                segments.push(segment);
            }
        }
        let n_bias_samples = (options.bias_settle_s * options.sample_rate_hz).round() as usize;
        let mut n_samples = n_bias_samples;
        let mut starts = Vec::with_capacity(segments.len());
        for segment in &segments {
            starts.push(n_samples);
            n_samples += segment.n_samples();
        }
        let SweepOptions { bias, sample_rate_hz, .. } = *options;
        Ok(Self { bias, sample_rate_hz, n_bias_samples, segments, starts, n_samples })
    }

    /// The sines in the order of the sweep.
    #[must_use]
    pub fn segments(&self) -> &[SweepSegment] {
        &self.segments
    }

    /// Samples at the bias alone, before the first sine.
    #[must_use]
    pub fn n_bias_samples(&self) -> usize {
        self.n_bias_samples
    }

    /// All samples of the sweep.
    #[must_use]
    pub fn n_samples(&self) -> usize {
        self.n_samples
    }

    /// Samples per second.
    #[must_use]
    pub fn sample_rate_hz(&self) -> f64 {
        self.sample_rate_hz
    }

    /// Length of the sweep in s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.n_samples as f64 / self.sample_rate_hz
    }

    /// Where the measured window of segment `segment_idx` lies in the sweep.
    ///
    /// # Panics
    /// Where there is no such segment.
    #[must_use]
    pub fn measured_range(&self, segment_idx: usize) -> Range<usize> {
        let segment = &self.segments[segment_idx];
        let start = self.starts[segment_idx] + segment.n_settle_samples;
        start..start + segment.n_measured_samples
    }

    /// The drive, sample by sample, fraction of full scale.
    pub fn drive(&self) -> impl Iterator<Item = f64> + '_ {
        let bias = self.bias;
        let lead = std::iter::repeat_n(bias, self.n_bias_samples);
        lead.chain(self.segments.iter().flat_map(move |s| (0..s.n_samples()).map(move |k| bias + s.sine(k))))
    }

    /// Turns the recorded drive and response of a whole sweep into points.
    ///
    /// **Shapes and units**: both signals hold [`n_samples`](Self::n_samples) values: the drive as it was applied (fraction
    /// of full scale, held until the next sample) and the response in mm, read at the instant that the drive of the same
    /// sample is applied.
    ///
    /// **Method**: the ratio of the two lines of each segment. Taking the drive as it was applied, and not as it was
    /// planned, keeps a clipped drive from changing the gain. The response then includes the hold of the drive; see
    /// [`SweepRecord::without_hold`].
    ///
    /// # Errors
    /// [`Error::SampleCount`], [`Error::SampleNotFinite`], [`Error::NoLine`] where drive or response does not move,
    /// [`Error::SweepTooFewFrequencies`].
    pub fn extract(&self, drive: &[f64], response_mm: &[f64]) -> Result<SweepRecord> {
        for (signal, values) in [("drive", drive), ("response", response_mm)] {
            if values.len() != self.n_samples {
                return Err(Error::SampleCount { signal, expected: self.n_samples, found: values.len() });
            }
        }
        let points = self.segments.iter().enumerate().map(|(segment_idx, segment)| {
            let range = self.measured_range(segment_idx);
            segment.point(&drive[range.clone()], &response_mm[range])
        });
        SweepRecord::new(points.collect::<Result<_>>()?, Some(self.bias))
    }
}

impl SweepSegment {
    /// Turns the recorded window of this segment into a point; signals as in [`SweepPlan::extract`].
    ///
    /// # Errors
    /// As [`SweepPlan::extract`].
    pub fn point(&self, drive: &[f64], response_mm: &[f64]) -> Result<SweepPoint> {
        for (signal, values) in [("drive", drive), ("response", response_mm)] {
            if values.len() != self.n_measured_samples {
                let expected = self.n_measured_samples;
                return Err(Error::SampleCount { signal, expected, found: values.len() });
            }
        }
        let input = extract_line("drive", drive, self.n_measured_periods)?;
        let output = extract_line("response", response_mm, self.n_measured_periods)?;
        for (signal, line) in [("drive", input), ("response", output)] {
            if line.value.norm() <= LINE_FLOOR {
                let (frequency_hz, found) = (self.actual_frequency_hz, line.value.norm());
                return Err(Error::NoLine { signal, frequency_hz, found });
            }
        }
        let fundamental = output.value.norm();
        let distortion =
            Distortion { second: output.second / fundamental, third: output.third / fundamental };
        let response = output.value / input.value;
        Ok(SweepPoint::from_response(self.actual_frequency_hz, self.amplitude, response, Some(distortion)))
    }
}

/// A line below this (mm or fraction of full scale) is rounding, not motion.
const LINE_FLOOR: f64 = 1e-12;

fn place_segment(options: &SweepOptions, frequency_hz: f64, amplitude: f64) -> SweepSegment {
    let rate = options.sample_rate_hz;
    let least_periods = (options.measured_s * frequency_hz).max(options.measured_periods as f64);
    let n_measured_periods = 2 * (least_periods / 2.0).ceil() as usize;
    // Even, as extract_line needs it.
    let n_measured_samples = 2 * (n_measured_periods as f64 * rate / frequency_hz / 2.0).round() as usize;
    let period_samples = n_measured_samples as f64 / n_measured_periods as f64;
    // Whole periods, so that the sine ends near phase zero.
    let settle_periods = options.settle_periods.max(options.settle_s * frequency_hz).ceil();
    SweepSegment {
        actual_frequency_hz: rate / period_samples,
        requested_frequency_hz: frequency_hz,
        amplitude,
        n_settle_samples: (settle_periods * period_samples).round() as usize,
        n_measured_samples,
        n_measured_periods,
    }
}

fn check_options(options: &SweepOptions) -> Result<()> {
    let range = |key, found: f64, ok: bool, allowed| {
        if ok && found.is_finite() { Ok(()) } else { Err(Error::OutOfRange { key, found, allowed }) }
    };
    let o = options;
    range("sample_rate_hz", o.sample_rate_hz, o.sample_rate_hz > 0.0, "above 0")?;
    range("bias", o.bias, (0.0..=1.0).contains(&o.bias), "0 to 1")?;
    for (key, found) in [
        ("settle_periods", o.settle_periods),
        ("settle_s", o.settle_s),
        ("measured_s", o.measured_s),
        ("bias_settle_s", o.bias_settle_s),
    ] {
        range(key, found, (0.0..=86_400.0).contains(&found), "0 to 86400")?;
    }
    let periods = o.measured_periods;
    range("measured_periods", periods as f64, (1..=10_000).contains(&periods), "1 to 10000")?;
    for (key, list) in [("frequencies_hz", &o.frequencies_hz), ("amplitudes", &o.amplitudes)] {
        if list.is_empty() {
            return Err(Error::EmptyList { key });
        }
    }
    for &found in &o.frequencies_hz {
        let ok = found > 0.0 && found < o.sample_rate_hz / 8.0;
        range("frequencies_hz", found, ok, "above 0 and below an eighth of the sample rate")?;
        let samples = o.sample_rate_hz / found * (o.measured_periods as f64 + 2.0);
        range("frequencies_hz", found, samples < 1e9, "high enough for a window below 1e9 samples")?;
    }
    for (idx, &amplitude) in o.amplitudes.iter().enumerate() {
        let new = !o.amplitudes[..idx].contains(&amplitude);
        range("amplitudes", amplitude, amplitude > 0.0 && new, "above 0 and not given twice")?;
        if o.bias - amplitude < 0.0 || o.bias + amplitude > 1.0 {
            return Err(Error::DriveRange { bias: o.bias, amplitude });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use num_complex::Complex64;

    use super::*;

    fn short(frequencies_hz: Vec<f64>) -> SweepOptions {
        SweepOptions {
            frequencies_hz,
            amplitudes: vec![0.2, 0.5],
            sample_rate_hz: 500.0,
            bias_settle_s: 0.5,
            ..SweepOptions::default()
        }
    }

    #[test]
    fn law_every_window_holds_whole_periods() {
        let plan = SweepPlan::new(&SweepOptions::default()).expect("default is valid");
        assert_eq!(plan.segments().len(), 3 * 31);
        for s in plan.segments() {
            let periods = s.n_measured_samples as f64 * s.actual_frequency_hz / plan.sample_rate_hz();
            assert!((periods - s.n_measured_periods as f64).abs() < 1e-9);
            assert!((s.actual_frequency_hz / s.requested_frequency_hz - 1.0).abs() < 1e-3);
            assert!(s.n_settle_samples as f64 >= 1.5 * plan.sample_rate_hz() - 1.0);
        }
        let drive: Vec<f64> = plan.drive().collect();
        assert_eq!(drive.len(), plan.n_samples());
        assert!(drive.iter().all(|u| (0.0..=1.0).contains(u)));
    }

    #[test]
    fn law_extraction_recovers_gain_delay_and_distortion_of_a_creeping_response() {
        // Static gain 0.8, a delay of 5 samples, a second-order distortion and a ramp.
        let plan = SweepPlan::new(&short(vec![1.0, 2.0, 3.3, 7.0, 13.0])).expect("valid");
        let drive: Vec<f64> = plan.drive().collect();
        let n = drive.len() as f64;
        let response: Vec<f64> = (0..drive.len())
            .map(|k| {
                let u = drive[k.saturating_sub(5)] - 0.5;
                0.8 * u + 0.1 * u * u + k as f64 / n
            })
            .collect();
        let record = plan.extract(&drive, &response).expect("valid");
        for p in record.points() {
            let expected = Complex64::from_polar(0.8, -TAU * p.frequency_hz * 5.0 / 500.0);
            assert!((p.response() - expected).norm() < 1e-11, "{p:?}");
            // 0.1 a^2/2 over 0.8 a.
            let distortion = p.distortion.expect("measured");
            assert!((distortion.second - 0.0625 * p.amplitude).abs() < 1e-10);
            assert!(distortion.third < 1e-10);
        }
    }

    #[test]
    fn edge_plans_outside_of_the_allowed_range_are_refused() {
        let refused = |change: fn(&mut SweepOptions)| {
            let mut options = SweepOptions::default();
            change(&mut options);
            SweepPlan::new(&options).expect_err("outside of the range").to_string()
        };
        assert!(refused(|o| o.frequencies_hz[3] = -1.0).contains("frequencies_hz must be above 0"));
        assert!(refused(|o| o.frequencies_hz[3] = 250.0).contains("eighth"));
        assert!(refused(|o| o.frequencies_hz[3] = f64::NAN).contains("found NaN"));
        assert!(refused(|o| o.amplitudes.clear()).contains("amplitudes must hold at least one"));
        assert!(refused(|o| o.bias = 0.6).contains("bias 0.6 with amplitude 0.5"));
        assert!(refused(|o| o.amplitudes[0] = 0.0).contains("amplitudes must be above 0"));
        assert!(refused(|o| o.frequencies_hz[1] = o.frequencies_hz[0]).contains("are the same"));
        assert!(refused(|o| o.measured_periods = 0).contains("measured_periods"));
    }

    #[test]
    fn edge_recordings_of_wrong_length_or_without_motion_are_refused() {
        let plan = SweepPlan::new(&short(vec![1.0, 2.0, 3.0, 4.0, 5.0])).expect("valid");
        let drive: Vec<f64> = plan.drive().collect();
        let found = plan.extract(&drive, &drive[1..]);
        assert!(matches!(found, Err(Error::SampleCount { signal: "response", .. })));
        let frozen = vec![0.3; drive.len()];
        let found = plan.extract(&drive, &frozen);
        assert!(matches!(found, Err(Error::NoLine { signal: "response", .. })));
    }
}
