//! Beats: feet, systolic peaks, heart rate and how far each beat can be trusted.

use crate::fidelity::pearson;
use crate::recording::extent;
use crate::{Error, PulseRecording};

/// One beat of a pulse wave.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Beat {
    /// Time of the foot by intersecting tangents.
    pub foot_s: f64,
    /// Level of the horizontal tangent before the upstroke.
    pub foot_value: f64,
    /// Time of the systolic peak.
    pub peak_s: f64,
    /// Value of the systolic peak.
    pub peak_value: f64,
    /// 0 (no likeness with the record's average beat) to 1 (same shape, usual size).
    pub quality: f64,
}

impl Beat {
    /// Whether shape and size are those of the other beats.
    pub fn is_good(&self) -> bool {
        self.quality >= QUALITY_MIN
    }
}

/// All beats of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct BeatTrain {
    /// Beats by rising time.
    pub beats: Vec<Beat>,
    /// Sixty over the median interval between neighbouring peaks.
    pub heart_rate_bpm: f64,
}

/// Finds the beats of a recording.
///
/// **Shapes and units**: times count as in the recording, so its `start_s` is contained.
///
/// **Method**: Gaussian smoothing of 12 ms (it moves no extreme of a symmetric wave); the sum of all rises
/// within 128 ms (slope sum function) marks upstrokes; its autocorrelation gives the usual period. An
/// upstroke is a maximum of that sum within 0.45 periods, at least 0.35 times the median of the eleven around
/// it. The foot is where the tangent at the steepest point meets the level of the minimum before it; the peak
/// is the highest sample between the upstroke and 0.6 periods after. Quality is the correlation with the
/// average beat, halved and more for beats of less than half or more than twice the median size.
///
/// **Source**: slope sum: Zong, Heldt, Moody, Mark 2003, "An open-source algorithm to detect onset of
/// arterial blood pressure pulses". Intersecting tangents: Chiu, Arand, Shroff, Feldman, Carroll 1991.
///
/// **Accuracy**: meant for 30-240 beats per minute and clean to moderately noisy pressure and PPG; a rate
/// that changes more than twofold within one record, or long artefacts, are beyond it. A beat whose foot or
/// peak lies outside the record is left out.
///
/// **Errors**: a record of less than one second or under 10 Hz, a constant record, no or only one beat.
pub fn detect(recording: &PulseRecording) -> Result<BeatTrain, Error> {
    let rate = recording.sample_rate_hz();
    if rate < 10.0 {
        return Err(Error::Parameter { name: "sample_rate_hz", allowed: "at least 10 Hz", found: rate });
    }
    let required = rate.ceil() as usize;
    if recording.n_samples() < required {
        return Err(Error::TooShort { required, found: recording.n_samples() });
    }
    let (low, high) = extent(recording.values());
    if high <= low {
        return Err(Error::NoVariation { which: "recording" });
    }
    let wave = Wave::of(recording);
    let none = || Error::NoBeats { duration_s: recording.duration_s() };
    let period = wave.usual_period().ok_or_else(none)?;
    let upstrokes = wave.upstrokes(period);
    let mut beats: Vec<Beat> =
        (0..upstrokes.len()).filter_map(|idx| wave.delineate(&upstrokes, idx, period)).collect();
    if beats.len() < 2 {
        return Err(none());
    }
    wave.grade(&mut beats, period);
    let mut intervals: Vec<f64> = beats.windows(2).map(|pair| pair[1].peak_s - pair[0].peak_s).collect();
    let heart_rate_bpm = 60.0 / median(&mut intervals);
    for beat in &mut beats {
        beat.foot_s += recording.start_s();
        beat.peak_s += recording.start_s();
    }
    Ok(BeatTrain { beats, heart_rate_bpm })
}

/// The smoothed wave and what is derived from it, sample by sample.
struct Wave {
    rate: f64,
    value: Vec<f64>,
    /// Rise per sample.
    slope: Vec<f64>,
    /// Sum of all rises within [`SLOPE_SUM_S`] around a sample.
    slope_sum: Vec<f64>,
}

impl Wave {
    fn of(recording: &PulseRecording) -> Self {
        let rate = recording.sample_rate_hz();
        let value = smoothed(recording.values(), SMOOTHING_S * rate);
        let n = value.len();
        let slope = (0..n)
            .map(|idx| {
                let (before, after) = (idx.saturating_sub(1), (idx + 1).min(n - 1));
                (value[after] - value[before]) / (after - before) as f64
            })
            .collect::<Vec<f64>>();
        let mut rise = vec![0.0];
        for step in value.windows(2) {
            rise.push(rise[rise.len() - 1] + (step[1] - step[0]).max(0.0));
        }
        let half = (0.5 * SLOPE_SUM_S * rate).round().max(1.0) as usize;
        let slope_sum =
            (0..n).map(|idx| rise[(idx + half).min(n - 1)] - rise[idx.saturating_sub(half)]).collect();
        Self { rate, value, slope, slope_sum }
    }

    /// The usual distance of beats in samples: the shortest lag whose autocorrelation of the slope sum is
    /// nearly the largest.
    fn usual_period(&self) -> Option<f64> {
        let n = self.slope_sum.len();
        // A minute is enough, and bounds the work.
        let used = &self.slope_sum[..n.min((60.0 * self.rate) as usize)];
        let mean = used.iter().sum::<f64>() / used.len() as f64;
        let x: Vec<f64> = used.iter().map(|v| v - mean).collect();
        // High rates are thinned: 100 values per second resolve the period well enough.
        let stride = (self.rate / 100.0).floor().max(1.0) as usize;
        let x: Vec<f64> = x.into_iter().step_by(stride).collect();
        let rate = self.rate / stride as f64;
        let (first, last) =
            ((PERIOD_S_MIN * rate) as usize, ((PERIOD_S_MAX * rate) as usize).min(x.len() / 2));
        let correlation = |lag: usize| {
            let products: f64 = x[lag..].iter().zip(&x).map(|(a, b)| a * b).sum();
            products / (x.len() - lag) as f64
        };
        let values: Vec<f64> = (first..=last + 1).map(correlation).collect();
        let is_peak = |i: usize| values[i] > 0.0 && values[i] >= values[i - 1] && values[i] >= values[i + 1];
        let peaks: Vec<usize> = (1..values.len().saturating_sub(1)).filter(|&i| is_peak(i)).collect();
        let largest = peaks.iter().map(|&i| values[i]).fold(0.0, f64::max);
        let shortest = peaks.into_iter().find(|&i| values[i] >= 0.7 * largest)?;
        Some(((first + shortest) * stride) as f64)
    }

    /// Samples where upstrokes are strongest.
    fn upstrokes(&self, period: f64) -> Vec<usize> {
        let n = self.slope_sum.len();
        let reach = (0.45 * period).max(1.0) as usize;
        let is_largest = |idx: usize| {
            let here = self.slope_sum[idx];
            let before = &self.slope_sum[idx.saturating_sub(reach)..idx];
            let after = &self.slope_sum[idx + 1..(idx + reach + 1).min(n)];
            before.iter().all(|v| *v < here) && after.iter().all(|v| *v <= here)
        };
        let candidates: Vec<usize> = (0..n).filter(|&idx| is_largest(idx)).collect();
        let is_strong = |k: usize| {
            let around = &candidates[k.saturating_sub(5)..(k + 6).min(candidates.len())];
            let mut sums: Vec<f64> = around.iter().map(|&idx| self.slope_sum[idx]).collect();
            self.slope_sum[candidates[k]] >= 0.35 * median(&mut sums)
        };
        (0..candidates.len()).filter(|&k| is_strong(k)).map(|k| candidates[k]).collect()
    }

    /// Foot and peak of the `k`-th upstroke, if both lie inside the record.
    fn delineate(&self, upstrokes: &[usize], k: usize, period: f64) -> Option<Beat> {
        let n = self.value.len();
        let centre = upstrokes[k];
        let half = (0.5 * SLOPE_SUM_S * self.rate).round().max(1.0) as usize;
        let steepest = largest(&self.slope, centre.saturating_sub(half), (centre + half + 1).min(n))?;
        let reach = (0.6 * period) as usize;
        let after = upstrokes.get(k + 1).copied().unwrap_or(n);
        let peak = largest(&self.value, steepest, (steepest + reach + 1).min(after).min(n))?;
        let before = if k > 0 { upstrokes[k - 1] } else { 0 };
        let begin = steepest.saturating_sub(reach).max(before);
        let lowest = (begin..=steepest).min_by(|&a, &b| self.value[a].total_cmp(&self.value[b]))?;
        // A record that begins in the middle of an upstroke does not show the foot.
        let begins_rising = lowest == 0 && self.slope[0] > 0.2 * self.slope[steepest];
        let is_cut = begins_rising || peak == n - 1 || peak == steepest || self.slope[steepest] <= 0.0;
        if is_cut {
            return None;
        }
        let foot_value = self.value[lowest];
        let foot = steepest as f64 - (self.value[steepest] - foot_value) / self.slope[steepest];
        let (peak, peak_value) = vertex(&self.value, peak);
        Some(Beat {
            foot_s: foot.max(lowest as f64) / self.rate,
            foot_value,
            peak_s: peak / self.rate,
            peak_value,
            quality: 0.0,
        })
    }

    /// Sets the quality of each beat.
    fn grade(&self, beats: &mut [Beat], period: f64) {
        let shapes: Vec<Vec<f64>> = beats.iter().map(|beat| self.shape(beat, period)).collect();
        let mut average = vec![0.0; SHAPE_POINTS];
        for shape in &shapes {
            for (sum, value) in average.iter_mut().zip(shape) {
                *sum += value;
            }
        }
        let mut sizes: Vec<f64> = beats.iter().map(|beat| beat.peak_value - beat.foot_value).collect();
        let usual_size = median(&mut sizes);
        for (beat, shape) in beats.iter_mut().zip(&shapes) {
            let size = beat.peak_value - beat.foot_value;
            let likeness = (size / usual_size).min(usual_size / size).max(0.0);
            beat.quality = pearson(shape, &average).max(0.0) * (2.0 * likeness).min(1.0);
        }
    }

    /// The beat from just before its foot over 0.7 periods, in units of its own size.
    fn shape(&self, beat: &Beat, period: f64) -> Vec<f64> {
        let begin = beat.foot_s * self.rate - 0.1 * period;
        let size = beat.peak_value - beat.foot_value;
        let at = |k: usize| begin + 0.8 * period * k as f64 / SHAPE_POINTS as f64;
        (0..SHAPE_POINTS).map(|k| (interpolated(&self.value, at(k)) - beat.foot_value) / size).collect()
    }
}

/// Index of the largest value in `begin..end`; `None` if that is empty.
fn largest(values: &[f64], begin: usize, end: usize) -> Option<usize> {
    (begin..end).max_by(|&a, &b| values[a].total_cmp(&values[b]).then(b.cmp(&a)))
}

/// Position and value of the parabola's vertex through an inner maximum and its neighbours.
fn vertex(values: &[f64], idx: usize) -> (f64, f64) {
    if idx == 0 || idx + 1 == values.len() {
        return (idx as f64, values[idx]);
    }
    let (before, here, after) = (values[idx - 1], values[idx], values[idx + 1]);
    let curvature = before - 2.0 * here + after;
    if curvature >= 0.0 {
        return (idx as f64, here);
    }
    let offset = (0.5 * (before - after) / curvature).clamp(-0.5, 0.5);
    (idx as f64 + offset, here - 0.25 * (before - after) * offset)
}

/// Linear interpolation, held beyond the ends.
fn interpolated(values: &[f64], position: f64) -> f64 {
    let position = position.clamp(0.0, (values.len() - 1) as f64);
    let idx = (position as usize).min(values.len() - 2);
    let fraction = position - idx as f64;
    values[idx] * (1.0 - fraction) + values[idx + 1] * fraction
}

/// Convolution with a Gaussian of this standard deviation in samples; the ends are held.
fn smoothed(values: &[f64], sigma: f64) -> Vec<f64> {
    let reach = (4.0 * sigma).ceil() as i64;
    let weight = |offset: i64| (-0.5 * (offset as f64 / sigma).powi(2)).exp();
    let weights: Vec<f64> = (-reach..=reach).map(weight).collect();
    let sum: f64 = weights.iter().sum();
    let last = values.len() as i64 - 1;
    let at = |idx: i64| values[idx.clamp(0, last) as usize];
    (0..=last)
        .map(|idx| (-reach..=reach).zip(&weights).map(|(o, w)| at(idx + o) * w).sum::<f64>() / sum)
        .collect()
}

/// The upper median of values that are not empty.
fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

const SMOOTHING_S: f64 = 0.012;
const SLOPE_SUM_S: f64 = 0.128;
const PERIOD_S_MIN: f64 = 0.25;
const PERIOD_S_MAX: f64 = 2.0;
const SHAPE_POINTS: usize = 64;
const QUALITY_MIN: f64 = 0.8;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Unit;
    use crate::synth::SyntheticPulse;

    #[test]
    fn law_every_beat_of_a_synthetic_pulse_is_found_in_place() {
        let pulse = SyntheticPulse::default();
        // The maximum of the unsmoothed shape, by search on a fine grid.
        let fine = (0..4000).map(|k| f64::from(k) * 1e-4);
        let peak = fine.max_by(|a, b| pulse.shape_at(*a).total_cmp(&pulse.shape_at(*b))).expect("not empty");
        for rate_hz in [50.0, 125.0, 1000.0, 2000.0] {
            let record = pulse.record(rate_hz, (20.0 * rate_hz) as usize).expect("valid");
            let train = detect(&record).expect("beats");
            // 20 s at 1.3055 Hz are 26.1 periods.
            assert_eq!(train.beats.len(), 26, "{rate_hz} Hz");
            assert!((train.heart_rate_bpm - 78.33).abs() < 0.2, "{}", train.heart_rate_bpm);
            for (idx, beat) in train.beats.iter().enumerate() {
                let start = idx as f64 / pulse.rate_hz;
                assert!((beat.peak_s - start - peak).abs() < 0.004, "{rate_hz} Hz: {beat:?}");
                assert!((beat.foot_s - start - 0.035).abs() < 0.004, "{rate_hz} Hz: {beat:?}");
                assert!(beat.is_good());
            }
        }
    }

    #[test]
    fn law_size_and_offset_do_not_matter() {
        let record = SyntheticPulse::default().record(125.0, 2500).expect("valid");
        let values = record.values().iter().map(|v| 80.0 + 1e-3 * v).collect();
        let other = PulseRecording::starting_at(100.0, Unit::Newton, 125.0, values).expect("valid");
        let (a, b) = (detect(&record).expect("beats"), detect(&other).expect("beats"));
        assert_eq!(a.beats.len(), b.beats.len());
        for (a, b) in a.beats.iter().zip(&b.beats) {
            assert!((b.foot_s - a.foot_s - 100.0).abs() < 1e-6 && (b.peak_s - a.peak_s - 100.0).abs() < 1e-6);
        }
    }

    #[test]
    fn law_a_damaged_beat_is_flagged() {
        let record = SyntheticPulse::default().record(125.0, 2500).expect("valid");
        let mut values = record.values().to_vec();
        let begin = (10.0 / 1.3055 * 125.0) as usize + 12;
        for (k, value) in values[begin..begin + 60].iter_mut().enumerate() {
            *value += 2500.0 * (k as f64 * std::f64::consts::PI / 60.0).sin();
        }
        let damaged = PulseRecording::new(Unit::Pascal, 125.0, values).expect("valid");
        let train = detect(&damaged).expect("beats");
        let poor: Vec<f64> =
            train.beats.iter().filter(|beat| !beat.is_good()).map(|beat| beat.peak_s).collect();
        assert!(!poor.is_empty() && poor.iter().all(|peak| (peak - 7.9).abs() < 0.8), "{poor:?}");
    }

    #[test]
    fn edge_nothing_to_find_is_an_error() {
        let record = |values: Vec<f64>| PulseRecording::new(Unit::Pascal, 100.0, values).expect("valid");
        assert!(matches!(detect(&record(vec![1.0; 500])), Err(Error::NoVariation { .. })));
        assert!(matches!(detect(&record(vec![1.0, 2.0])), Err(Error::TooShort { .. })));
        let ramp = record((0..500).map(f64::from).collect());
        assert!(matches!(detect(&ramp), Err(Error::NoBeats { .. })), "{:?}", detect(&ramp));
        let slow = PulseRecording::new(Unit::Pascal, 1.0, vec![1.0; 500]).expect("valid");
        assert!(matches!(detect(&slow), Err(Error::Parameter { .. })));
    }
}
