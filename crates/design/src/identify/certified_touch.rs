//! Where a weight comes closest to an error that was measured at points, proven between the points.

use std::collections::BinaryHeap;

use super::minimum_phase::MinimumPhase;

/// A straight piece of an error curve in log-log coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Segment {
    /// `ln omega` of both ends, rising; equal for a single point.
    pub(crate) log_omega: [f64; 2],
    /// `ln error` at both ends.
    pub(crate) log_error: [f64; 2],
}

impl Segment {
    fn log_error_at(&self, log_omega: f64) -> f64 {
        let width = self.log_omega[1] - self.log_omega[0];
        if width <= 0.0 {
            return self.log_error[0].max(self.log_error[1]);
        }
        let share = (log_omega - self.log_omega[0]) / width;
        self.log_error[0] + share * (self.log_error[1] - self.log_error[0])
    }
}

/// The largest `ln(error / |W|)` over all pieces, between two bounds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Touch {
    /// Reached at `log_omega`.
    pub(crate) lower: f64,
    /// Exceeded nowhere.
    pub(crate) upper: f64,
    pub(crate) log_omega: f64,
}

/// Returns the largest excess of the error over the weight, without a grid.
///
/// **Method**: branch and bound. On an interval of width `h` the excess `r` lies below the larger of its ends plus
/// `M h^2/8`, where `M` is [`MinimumPhase::curvature_max`]: the error is straight, so the weight alone bends. Intervals that cannot
/// beat the best point are dropped, the others halved.
///
/// **Accuracy**: `upper - lower` at most [`GAP`] unless [`STEPS_MAX`] comes first; `upper` holds in either case, up to
/// the rounding of a logarithm.
pub(crate) fn largest_excess(segments: &[Segment], weight: &MinimumPhase) -> Touch {
    let mut best = Touch { lower: f64::NEG_INFINITY, upper: f64::NEG_INFINITY, log_omega: 0.0 };
    let mut open = BinaryHeap::new();
    let excess = |segment: &Segment, u: f64| segment.log_error_at(u) - weight.log_magnitude(u.exp());
    for (segment_idx, segment) in segments.iter().enumerate() {
        let ends = segment.log_omega.map(|u| excess(segment, u));
        for (u, r) in segment.log_omega.into_iter().zip(ends) {
            if r > best.lower {
                (best.lower, best.log_omega) = (r, u);
            }
        }
        open.push(Interval::new(segment_idx, segment.log_omega, ends, weight));
    }
    best.upper = best.lower;
    for _ in 0..STEPS_MAX {
        let Some(widest) = open.pop() else { break };
        best.upper = best.lower.max(widest.bound);
        if widest.bound <= best.lower + GAP {
            break;
        }
        let segment = &segments[widest.segment_idx];
        let middle = 0.5 * (widest.log_omega[0] + widest.log_omega[1]);
        let r = excess(segment, middle);
        if r > best.lower {
            (best.lower, best.log_omega) = (r, middle);
        }
        let [left, right] = widest.log_omega;
        open.push(Interval::new(widest.segment_idx, [left, middle], [widest.excess[0], r], weight));
        open.push(Interval::new(widest.segment_idx, [middle, right], [r, widest.excess[1]], weight));
        best.upper = best.lower.max(open.peek().map_or(f64::NEG_INFINITY, |i| i.bound));
    }
    best
}

/// Width at which the bracket of the excess is narrow enough: relative, since it is a logarithm.
const GAP: f64 = 1e-11;
/// Bound on the halvings.
const STEPS_MAX: usize = 200_000;

struct Interval {
    segment_idx: usize,
    log_omega: [f64; 2],
    excess: [f64; 2],
    bound: f64,
}

impl Interval {
    fn new(segment_idx: usize, log_omega: [f64; 2], excess: [f64; 2], weight: &MinimumPhase) -> Self {
        let width = log_omega[1] - log_omega[0];
        let bend = weight.curvature_max(log_omega).max(0.0) * width * width / 8.0;
        Self { segment_idx, log_omega, excess, bound: excess[0].max(excess[1]) + bend }
    }
}

impl PartialEq for Interval {
    fn eq(&self, other: &Self) -> bool {
        self.bound.total_cmp(&other.bound).is_eq()
    }
}

impl Eq for Interval {}

impl PartialOrd for Interval {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Interval {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.bound.total_cmp(&other.bound)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use num_complex::Complex64;

    #[test]
    fn law_a_dip_between_two_points_is_found() {
        // A notch of damping 1e-3 at 1 rad/s, halfway between points at 0.1 and 10 rad/s: |W| is 2 zeta there.
        let notch = [Complex64::new(-1e-3, 1.0), Complex64::new(-1e-3, -1.0)];
        let weight =
            MinimumPhase { gain: 1.0, zeros: notch.to_vec(), poles: vec![Complex64::new(-1.0, 0.0); 2] };
        let segment = Segment { log_omega: [0.1_f64.ln(), 10.0_f64.ln()], log_error: [0.0, 0.0] };
        let touch = largest_excess(&[segment], &weight);
        assert!((touch.log_omega).abs() < 1e-4, "{touch:?}");
        assert!((touch.lower + (2e-3_f64 / 2.0).ln()).abs() < 1e-5, "{touch:?}");
        assert!(touch.upper >= touch.lower && touch.upper - touch.lower <= GAP);
    }

    #[test]
    fn law_a_slope_touches_a_lag_where_the_derivatives_agree() {
        // |W| = 1/sqrt(1 + w^2) against error w^-1/2 c: ln ratio = -u/2 + ln(1 + e^2u)/2 has its largest value at an end.
        let weight = MinimumPhase { gain: 1.0, zeros: vec![], poles: vec![Complex64::new(-1.0, 0.0)] };
        let (a, b) = (-3.0, 2.0);
        let segment = Segment { log_omega: [a, b], log_error: [-0.5 * a, -0.5 * b] };
        let touch = largest_excess(&[segment], &weight);
        let end = |u: f64| -0.5 * u + 0.5 * (1.0 + (2.0 * u).exp()).ln();
        assert!((touch.lower - end(a).max(end(b))).abs() < 1e-12);
    }

    #[test]
    fn edge_a_single_point_and_nothing() {
        let weight = MinimumPhase { gain: 2.0, zeros: vec![], poles: vec![] };
        let point = Segment { log_omega: [0.0, 0.0], log_error: [0.0, 0.0] };
        assert!((largest_excess(&[point], &weight).upper + 2.0_f64.ln()).abs() < 1e-15);
        assert_eq!(largest_excess(&[], &weight).upper, f64::NEG_INFINITY);
    }
}
