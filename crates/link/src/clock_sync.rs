//! How far the other side's clock is ahead, and how sure that is.

use serde::{Deserialize, Serialize};

/// Exchanges that a [`ClockSync`] remembers.
const CAPACITY: usize = 64;

/// Offset and delay between two clocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClockEstimate {
    /// The other clock minus this one, in nanoseconds.
    pub offset_ns: i64,
    /// Round trip without the other side's own time, in nanoseconds, of the exchange with the least.
    pub delay_ns: u64,
    /// The true offset lies within this of `offset_ns`, however unequal the two ways are: half the delay.
    pub error_bound_ns: u64,
    /// Exchanges that the estimate chose from.
    pub n_exchanges: usize,
}

/// Clock offset from four time stamps of each question and answer.
///
/// **Method**: the question leaves at `t1` and the answer is back at `t4` of this clock; it arrived at `t2` and left at `t3` of the other.
/// Then `offset = ((t2 - t1) + (t3 - t4))/2` and `delay = (t4 - t1) - (t3 - t2)`. Of the last 64 exchanges the one with the least
/// delay is used: queues only ever add delay, so it is the least disturbed one.
///
/// **Source**: Mills, RFC 5905 section 8 (offset and delay) and section 10 (clock filter).
///
/// **Accuracy**: the bound holds for constant offset; drift between the clocks (50 ppm is 3 ms a minute) is not modelled, which is why old
/// exchanges are forgotten.
#[derive(Debug, Clone, Default)]
pub struct ClockSync {
    exchanges: std::collections::VecDeque<Exchange>,
}

#[derive(Debug, Clone, Copy)]
struct Exchange {
    offset_ns: i64,
    delay_ns: u64,
}

impl ClockSync {
    /// Takes in one exchange; returns whether its times were possible (`t4 >= t1`, `t3 >= t2`, delay of at least zero).
    pub fn push(&mut self, t1_ns: u64, t2_ns: u64, t3_ns: u64, t4_ns: u64) -> bool {
        let [t1, t2, t3, t4] = [t1_ns, t2_ns, t3_ns, t4_ns].map(i128::from);
        let delay = (t4 - t1) - (t3 - t2);
        let offset = ((t2 - t1) + (t3 - t4)) / 2;
        let (true, Ok(delay_ns), Ok(offset_ns)) =
            (t4 >= t1 && t3 >= t2, u64::try_from(delay), i64::try_from(offset))
        else {
            return false;
        };
        if self.exchanges.len() == CAPACITY {
            self.exchanges.pop_front();
        }
        self.exchanges.push_back(Exchange { offset_ns, delay_ns });
        true
    }

    /// The estimate from the exchange with the least delay; `None` before the first.
    #[must_use]
    pub fn estimate(&self) -> Option<ClockEstimate> {
        let best = self.exchanges.iter().min_by_key(|exchange| exchange.delay_ns)?;
        Some(ClockEstimate {
            offset_ns: best.offset_ns,
            delay_ns: best.delay_ns,
            // Rounded up, and one more for the halved offset.
            error_bound_ns: best.delay_ns / 2 + 1,
            n_exchanges: self.exchanges.len(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    #[test]
    fn law_true_offset_lies_within_the_bound() {
        for seed in 0..500 {
            let mut rng = Pcg64Mcg::seed_from_u64(seed);
            let offset_ns: i64 = rng.random_range(-1_000_000_000_000..1_000_000_000_000);
            let base_ns: u64 = 2_000_000_000_000;
            let mut sync = ClockSync::default();
            let mut least_delay = u64::MAX;
            for k in 0..rng.random_range(1..100_u64) {
                // Unequal, random ways.
                let (there, stay, back) = (
                    rng.random_range(0..80_000_000),
                    rng.random_range(0..1_000_000),
                    rng.random_range(0..5_000_000),
                );
                let t1 = base_ns + k * 100_000_000;
                let t2 = (t1 + there).wrapping_add_signed(offset_ns);
                assert!(sync.push(t1, t2, t2 + stay, t1 + there + stay + back), "seed {seed}");
                least_delay = least_delay.min(there + back);
            }
            let estimate = sync.estimate().expect("at least one exchange");
            assert!(
                estimate.offset_ns.abs_diff(offset_ns) <= estimate.error_bound_ns,
                "seed {seed}: {estimate:?} against {offset_ns}"
            );
            assert!(estimate.n_exchanges <= CAPACITY);
            assert!(estimate.delay_ns >= least_delay, "seed {seed}");
        }
    }

    #[test]
    fn edge_impossible_times_are_refused() {
        let mut sync = ClockSync::default();
        assert_eq!(sync.estimate(), None);
        assert!(!sync.push(10, 0, 0, 5));
        assert!(!sync.push(0, 10, 5, 20));
        assert!(!sync.push(0, 0, 100, 50));
        assert!(!sync.push(0, u64::MAX, u64::MAX, 1));
        assert_eq!(sync.estimate(), None);
    }
}
