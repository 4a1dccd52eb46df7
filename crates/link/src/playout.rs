//! The doctor's buffer: samples come in when they come, values go out at a fixed delay, and each says how real it is.

use std::collections::VecDeque;
use std::time::Duration;

use crate::Error;

/// A value for the actuator, and how it came about.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Playout {
    /// A sample, at its own time.
    Exact(f64),
    /// On the line between two samples.
    Interpolated(f64),
    /// The last sample before one that is missing.
    Held(f64),
    /// Nothing: not begun, ended, or missing for too long.
    Silent,
}

impl Playout {
    /// The value, where there is one.
    #[must_use]
    pub fn value(self) -> Option<f64> {
        match self {
            Self::Exact(value) | Self::Interpolated(value) | Self::Held(value) => Some(value),
            Self::Silent => None,
        }
    }
}

/// How a [`PlayoutBuffer`] plays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlayoutSettings {
    /// Samples per second of the stream.
    pub sample_rate_hz: f64,
    /// Time between the arrival of the first sample and its playing; covers the network's jitter.
    pub delay: Duration,
    /// How long a sample may stand in for missing ones.
    pub max_hold: Duration,
    /// Most samples kept.
    pub capacity: usize,
}

/// A play-out buffer with fixed delay.
///
/// Sample `k` is due at `start + delay + k/rate`. Between two samples the value is interpolated; where the next one is missing the last one
/// is held, and after `max_hold` there is silence. A sample that is not a finite number counts as missing: it must never reach an actuator.
///
/// **Accuracy**: a time within a millionth of a sample period of a sample counts as that sample's time.
///
/// **Example**
/// ```
/// use std::time::Duration;
/// use telepulse_link::{Playout, PlayoutBuffer, PlayoutSettings};
/// let ms = Duration::from_millis;
/// let settings =
///     PlayoutSettings { sample_rate_hz: 100.0, delay: ms(50), max_hold: ms(30), capacity: 1000 };
/// let mut buffer = PlayoutBuffer::new(settings, ms(0))?;
/// buffer.push(0, &[1.0, 2.0])?;
/// assert_eq!(buffer.at(ms(49)), Playout::Silent);
/// assert_eq!(buffer.at(ms(50)), Playout::Exact(1.0));
/// assert_eq!(buffer.at(ms(55)), Playout::Interpolated(1.5));
/// assert_eq!(buffer.at(ms(70)), Playout::Held(2.0));
/// assert_eq!(buffer.at(ms(200)), Playout::Silent);
/// # Ok::<(), telepulse_link::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct PlayoutBuffer {
    settings: PlayoutSettings,
    start: Duration,
    /// Stream index of the front of `samples`.
    first: u64,
    samples: VecDeque<Option<f64>>,
}

/// Fraction of a sample period that counts as zero.
const EXACT_WITHIN: f64 = 1e-6;

impl PlayoutBuffer {
    /// An empty buffer for a stream whose first sample arrived at `start`.
    ///
    /// # Errors
    /// [`Error::Setting`] unless the rate is finite and positive and the capacity at least 2.
    pub fn new(settings: PlayoutSettings, start: Duration) -> Result<Self, Error> {
        if !(settings.sample_rate_hz.is_finite() && settings.sample_rate_hz > 0.0) {
            let found = settings.sample_rate_hz;
            return Err(Error::setting("sample rate in Hz", "finite and greater than zero", found));
        }
        if settings.capacity < 2 {
            return Err(Error::setting("play-out capacity in samples", "at least 2", settings.capacity));
        }
        Ok(Self { settings, start, first: 0, samples: VecDeque::new() })
    }

    /// Takes in samples from index `first_sample` on. They may overlap or leave gaps; what has been played already is dropped.
    ///
    /// # Errors
    /// [`Error::PlayoutFull`] when they reach further ahead than the capacity; then none of them is kept.
    pub fn push(&mut self, first_sample: u64, samples: &[f64]) -> Result<(), Error> {
        let end = first_sample.saturating_add(samples.len() as u64);
        let n_needed = end.saturating_sub(self.first);
        if n_needed > self.settings.capacity as u64 {
            return Err(Error::PlayoutFull { capacity: self.settings.capacity, sample: end - 1 });
        }
        if self.samples.len() < n_needed as usize {
            self.samples.resize(n_needed as usize, None);
        }
        for (index, sample) in (first_sample..).zip(samples) {
            if let Some(offset) = index.checked_sub(self.first) {
                self.samples[offset as usize] = Some(*sample).filter(|sample| sample.is_finite());
            }
        }
        Ok(())
    }

    /// The value due at `now`. Samples that no later time can need are forgotten, so `now` must not step back.
    pub fn at(&mut self, now: Duration) -> Playout {
        let Some(playing) = now.checked_sub(self.start + self.settings.delay) else { return Playout::Silent };
        let position = playing.as_secs_f64() * self.settings.sample_rate_hz;
        let nearest = position.round();
        let on_sample = (position - nearest).abs() < EXACT_WITHIN;
        let index = if on_sample { nearest } else { position.floor() } as u64;
        let fraction = position - index as f64;
        let value = match (self.sample(index), self.sample(index.saturating_add(1))) {
            (Some(sample), _) if on_sample => Playout::Exact(sample),
            (Some(left), Some(right)) => Playout::Interpolated(left + fraction * (right - left)),
            (Some(left), None) => Playout::Held(left),
            (None, _) => self.hold(index, position),
        };
        self.forget_before(index);
        value
    }

    /// Samples kept, missing ones included.
    #[must_use]
    pub fn len(&self) -> usize {
        self.samples.len()
    }

    /// True where nothing is kept.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.samples.is_empty()
    }

    fn sample(&self, index: u64) -> Option<f64> {
        let offset = usize::try_from(index.checked_sub(self.first)?).ok()?;
        self.samples.get(offset).copied().flatten()
    }

    fn max_hold_samples(&self) -> f64 {
        self.settings.max_hold.as_secs_f64() * self.settings.sample_rate_hz
    }

    /// The newest sample before `index`, unless it is too old. A gap is at most `capacity` long.
    fn hold(&self, index: u64, position: f64) -> Playout {
        let n_before = usize::try_from(index.saturating_sub(self.first)).unwrap_or(usize::MAX);
        let n_before = n_before.min(self.samples.len());
        let Some(offset) = self.samples.range(..n_before).rposition(Option::is_some) else {
            return Playout::Silent;
        };
        let age = position - (self.first + offset as u64) as f64;
        match self.samples[offset] {
            Some(sample) if age <= self.max_hold_samples() => Playout::Held(sample),
            _ => Playout::Silent,
        }
    }

    fn forget_before(&mut self, index: u64) {
        // Two more than the hold needs, for rounding.
        let keep_from = index.saturating_sub(self.max_hold_samples() as u64 + 2);
        while self.first < keep_from {
            if self.samples.pop_front().is_none() {
                self.first = keep_from;
                break;
            }
            self.first += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    fn settings() -> PlayoutSettings {
        PlayoutSettings { sample_rate_hz: 125.0, delay: ms(100), max_hold: ms(40), capacity: 64 }
    }

    #[test]
    fn law_a_timely_stream_plays_without_a_gap() {
        // 125 Hz played at 1 kHz; packets of 5 samples arrive up to 90 ms late. The signal is linear, so interpolation must be exact.
        for seed in 0..50 {
            let mut rng = Pcg64Mcg::seed_from_u64(seed);
            let line = |index: f64| 0.3 + 0.01 * index;
            let mut arrivals: Vec<(u64, u64)> =
                (0..40).map(|packet| (packet * 40 + rng.random_range(0..=90), packet * 5)).collect();
            arrivals[0].0 = 0;
            arrivals.sort_unstable();
            let mut buffer = PlayoutBuffer::new(settings(), ms(0)).expect("valid settings");
            let mut arrivals = arrivals.into_iter().peekable();
            let mut n_exact = 0;
            for now_ms in 0..100 + 199 * 8 {
                while let Some((_, first)) = arrivals.next_if(|(arrival_ms, _)| *arrival_ms <= now_ms) {
                    let samples: Vec<f64> = (first..first + 5).map(|index| line(index as f64)).collect();
                    buffer.push(first, &samples).expect("fits");
                }
                let played = buffer.at(ms(now_ms));
                assert!(buffer.len() <= 64);
                if now_ms < 100 {
                    assert_eq!(played, Playout::Silent);
                    continue;
                }
                let expected = line((now_ms - 100) as f64 / 8.0);
                let value = played.value().unwrap_or(f64::NAN);
                assert!((value - expected).abs() < 1e-12, "seed {seed} at {now_ms} ms: {played:?}");
                assert!(!matches!(played, Playout::Held(_)), "seed {seed} at {now_ms} ms");
                n_exact += u32::from(matches!(played, Playout::Exact(_)));
            }
            assert_eq!(n_exact, 199);
        }
    }

    #[test]
    fn edge_a_gap_is_held_then_silent_then_filled() {
        let mut buffer = PlayoutBuffer::new(settings(), ms(1000)).expect("valid settings");
        buffer.push(0, &[1.0, 2.0]).expect("fits");
        assert_eq!(buffer.at(ms(1108)), Playout::Exact(2.0));
        assert_eq!(buffer.at(ms(1112)), Playout::Held(2.0));
        assert_eq!(buffer.at(ms(1147)), Playout::Held(2.0));
        assert_eq!(buffer.at(ms(1149)), Playout::Silent);
        buffer.push(6, &[7.0, 8.0]).expect("fits");
        // Sample 6 was due at 1148 ms, sample 7 at 1156 ms.
        assert_eq!(buffer.at(ms(1150)), Playout::Interpolated(7.25));
        assert_eq!(buffer.at(ms(1156)), Playout::Exact(8.0));
    }

    #[test]
    fn edge_nan_is_missing() {
        let mut buffer = PlayoutBuffer::new(settings(), ms(0)).expect("valid settings");
        buffer.push(0, &[1.0, f64::NAN, f64::INFINITY, 4.0]).expect("fits");
        assert_eq!(buffer.at(ms(104)), Playout::Held(1.0));
        assert_eq!(buffer.at(ms(108)), Playout::Held(1.0));
        assert_eq!(buffer.at(ms(124)), Playout::Exact(4.0));
    }

    #[test]
    fn edge_late_samples_and_overflow() {
        let mut buffer = PlayoutBuffer::new(settings(), ms(0)).expect("valid settings");
        assert_eq!(
            buffer.push(60, &[0.0; 5]),
            Err(Error::PlayoutFull { capacity: 64, sample: 64 }),
            "a sample too far ahead must not grow the buffer"
        );
        assert!(buffer.is_empty());
        assert_eq!(buffer.at(ms(100_000)), Playout::Silent);
        buffer.push(0, &[1.0; 10]).expect("old samples are dropped");
        assert!(buffer.is_empty());
        assert!(buffer.push(u64::MAX, &[1.0, 2.0]).is_err());
    }
}
