//! How long an answer takes, and how long to wait for one.

use std::time::Duration;

/// Smoothed round-trip time and the retransmission timeout that follows from it.
///
/// **Method**: `srtt += (r - srtt)/8`, `var += (|r - srtt| - var)/4`, timeout `srtt + 4 var` within bounds. Only packets that were sent
/// once may be measured (Karn): with a repeated one nobody knows which copy was answered.
///
/// **Source**: RFC 6298.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RoundTrip {
    smoothed: Option<Duration>,
    variation: Duration,
    initial: Duration,
    min: Duration,
    max: Duration,
}

impl RoundTrip {
    /// An estimator that answers `initial` until the first measurement, and never leaves `min` to `max`.
    #[must_use]
    pub fn new(initial: Duration, min: Duration, max: Duration) -> Self {
        Self { smoothed: None, variation: Duration::ZERO, initial, min, max }
    }

    /// Takes in one measured round trip.
    pub fn measure(&mut self, round_trip: Duration) {
        match self.smoothed {
            None => {
                self.smoothed = Some(round_trip);
                self.variation = round_trip / 2;
            }
            Some(smoothed) => {
                self.variation = (self.variation * 3 + smoothed.abs_diff(round_trip)) / 4;
                self.smoothed = Some((smoothed * 7 + round_trip) / 8);
            }
        }
    }

    /// The smoothed round-trip time, once one was measured.
    #[must_use]
    pub fn smoothed(&self) -> Option<Duration> {
        self.smoothed
    }

    /// How long to wait after transmission number `tries` (from 1): doubled for each one before.
    #[must_use]
    pub fn timeout(&self, tries: u32) -> Duration {
        let base = self.smoothed.map_or(self.initial, |smoothed| smoothed + self.variation * 4);
        let doubled = 1_u32 << tries.saturating_sub(1).min(16);
        base.max(self.min).saturating_mul(doubled).min(self.max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn law_constant_round_trip_is_learnt() {
        let mut estimator = RoundTrip::new(MS * 200, MS * 20, MS * 500);
        assert_eq!(estimator.timeout(1), MS * 200);
        estimator.measure(MS * 40);
        assert_eq!(estimator.timeout(1), MS * 120); // 40 + 4 * 20
        for _ in 0..200 {
            estimator.measure(MS * 40);
        }
        let timeout = estimator.timeout(1);
        assert!(timeout >= MS * 40 && timeout < MS * 41, "{timeout:?}");
    }

    #[test]
    fn edge_timeout_doubles_up_to_its_bound() {
        let estimator = RoundTrip::new(MS * 100, MS * 20, MS * 500);
        let timeouts: Vec<_> = [1, 2, 3, 4, 1000].map(|tries| estimator.timeout(tries)).to_vec();
        assert_eq!(timeouts, [MS * 100, MS * 200, MS * 400, MS * 500, MS * 500]);
    }
}
