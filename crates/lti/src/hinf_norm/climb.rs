//! The way from a frequency up to the local peak of the gain.

/// A gain and the frequency at which it was seen: rad/s, or radians per sample in discrete time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    pub(super) gain: f64,
    pub(super) frequency: f64,
}

/// How near to the peak a climb ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Goal {
    /// As near as rounding lets it.
    Peak,
    /// So near that the gain misses about a thousandth of the peak: enough to tell whether it is worth going on.
    Rough,
}

/// Returns the local peak that is reached from `start`, with steps that begin at `width`.
///
/// **Method**: doubles the step uphill until a peak is bracketed, then parabolas through `1 / gain²`, which for a lone
/// resonance *is* a parabola, with bisection where a parabola fails to shrink the bracket.
pub(super) fn climb(mut gain: impl FnMut(f64) -> f64, start: Seen, width: f64, goal: Goal) -> Seen {
    let mut at = |frequency: f64| Seen { gain: gain(frequency.abs()), frequency };
    let mut step = width.max(1e2 * f64::EPSILON * start.frequency);
    let mut best = start;
    let (mut left, mut right) = (at(best.frequency - step), at(best.frequency + step));
    for _ in 0..EXPANSIONS_MAX {
        if best.gain >= left.gain.max(right.gain) || best.gain.is_infinite() {
            break;
        }
        step *= 2.0;
        if left.gain > right.gain {
            (left, best, right) = (at(left.frequency - step), left, best);
        } else {
            (left, best, right) = (best, right, at(right.frequency + step));
        }
    }
    // Where the doubling ran out the gain still rises: the peak lies beyond any frequency that matters.
    let mut confirmed = false;
    for iteration in 0..STEPS_MAX {
        if best.gain < left.gain.max(right.gain) || best.gain == 0.0 || best.gain.is_infinite() {
            break;
        }
        let inverse_square = |seen: Seen| (best.gain / seen.gain) * (best.gain / seen.gain);
        let (to_left, to_right) = (best.frequency - left.frequency, right.frequency - best.frequency);
        let slope_left = (1.0 - inverse_square(left)) / to_left;
        let slope_right = (inverse_square(right) - 1.0) / to_right;
        let curvature = (slope_right - slope_left) / (to_left + to_right);
        let slope = slope_left + curvature * to_left;
        let improvement = 0.25 * slope * slope / curvature;
        let worthwhile = if goal == Goal::Peak { IMPROVEMENT_MIN } else { IMPROVEMENT_ROUGH };
        if improvement.is_nan() || improvement < worthwhile {
            if confirmed || goal == Goal::Rough {
                break;
            }
            // One look closer by, in case three points happened to lie symmetrically.
            confirmed = true;
            for side in [-to_left, to_right] {
                let seen = at(best.frequency + CLOSER * side);
                (left, best, right) = narrowed(left, best, right, seen);
            }
            continue;
        }
        let mut target = best.frequency - 0.5 * slope / curvature;
        let longer = if to_left > to_right { -to_left } else { to_right };
        let inside = target > left.frequency && target < right.frequency;
        if !inside || iteration % BISECTION_EVERY == BISECTION_EVERY - 1 {
            target = best.frequency + 0.5 * longer;
        }
        if target == best.frequency || to_left + to_right <= 4.0 * f64::EPSILON * best.frequency.abs() {
            break;
        }
        (left, best, right) = narrowed(left, best, right, at(target));
    }
    best.frequency = best.frequency.abs();
    best
}

/// The bracket after one more look inside of it.
fn narrowed(left: Seen, best: Seen, right: Seen, seen: Seen) -> (Seen, Seen, Seen) {
    match (seen.gain > best.gain, seen.frequency < best.frequency) {
        (true, true) => (left, seen, best),
        (true, false) => (best, seen, right),
        (false, true) => (seen, best, right),
        (false, false) => (left, best, seen),
    }
}

/// Doublings of the step; a step grows by a factor of 1e12.
const EXPANSIONS_MAX: usize = 40;
/// Parabolas and bisections; five to eight are usual.
const STEPS_MAX: usize = 40;
/// Every so many steps is a bisection, so that the bracket shrinks on both sides.
const BISECTION_EVERY: usize = 5;
/// Relative change of `1 / gain²` below which a step is not worth its evaluation.
const IMPROVEMENT_MIN: f64 = 1e-13;
/// The same where the peak is only sounded.
const IMPROVEMENT_ROUGH: f64 = 1e-3;
/// Share of the bracket at which the peak is looked at once more.
const CLOSER: f64 = 0.1;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_a_climb_ends_on_the_peak_of_a_smooth_hill() {
        // exp(-(x - 3)² / 2) peaks at 3, from both sides, near and far.
        for start in [2.9, 3.0, 0.5, 8.0] {
            for width in [1e-3, 0.3, 2.0] {
                let hill = |x: f64| (-0.5 * (x - 3.0) * (x - 3.0)).exp();
                let from = Seen { gain: hill(start), frequency: start };
                let mut looks = 0;
                let top = climb(
                    |x| {
                        looks += 1;
                        hill(x)
                    },
                    from,
                    width,
                    Goal::Peak,
                );
                assert!(1.0 - top.gain < 1e-13 && looks < 40, "{start} {width}: {top:?} {looks}");
            }
        }
    }

    #[test]
    fn law_a_rough_climb_sees_the_height_for_fewer_looks() {
        // 1 / gain² of this resonance is a parabola, one step of which ends on its peak of 1 at 3.
        let hill = |x: f64| 1.0 / (1.0 + (x - 3.0) * (x - 3.0)).sqrt();
        for start in [2.5, 3.2] {
            let looks_for = |goal| {
                let mut looks = 0;
                let look = |x| {
                    looks += 1;
                    hill(x)
                };
                let top = climb(look, Seen { gain: hill(start), frequency: start }, 0.3, goal);
                (top.gain, looks)
            };
            let ((rough, few), (fine, many)) = (looks_for(Goal::Rough), looks_for(Goal::Peak));
            assert!(
                rough > 0.998 && fine > 1.0 - 1e-13 && few < many,
                "{start}: {rough} {few}, {fine} {many}"
            );
        }
    }

    #[test]
    fn edge_a_flat_gain_ends_at_once() {
        let mut looks = 0;
        let flat = |_| {
            looks += 1;
            1.0
        };
        assert_eq!(climb(flat, Seen { gain: 1.0, frequency: 2.0 }, 0.1, Goal::Peak).gain, 1.0);
        assert!(looks <= 4);
    }
}
