//! The errors of a family of measurements as curves over frequency.

use super::certified_touch::Segment;

/// One error curve: straight lines between measured points in log-log coordinates, as drawn in a Bode plot.
pub(crate) struct ErrorCurve {
    log_omega: Vec<f64>,
    log_error: Vec<f64>,
}

impl ErrorCurve {
    /// Takes `(omega, error)` pairs in any order. Errors below `floor` are raised to it, since a logarithm has no zero.
    pub fn new(mut points: Vec<(f64, f64)>, floor: f64) -> Self {
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self {
            log_omega: points.iter().map(|p| p.0.ln()).collect(),
            log_error: points.iter().map(|p| p.1.max(floor).ln()).collect(),
        }
    }

    /// The straight pieces; one of no width for a single point.
    pub fn segments(&self) -> Vec<Segment> {
        let last = self.log_omega.len().saturating_sub(1);
        let piece = |(left, right): (usize, usize)| Segment {
            log_omega: [self.log_omega[left], self.log_omega[right]],
            log_error: [self.log_error[left], self.log_error[right]],
        };
        match self.log_omega.len() {
            0 => Vec::new(),
            1 => vec![piece((0, 0))],
            _ => (0..last).map(|k| piece((k, k + 1))).collect(),
        }
    }

    /// The interpolated logarithm of the error; `None` outside of the measured range.
    fn log_at(&self, log_omega: f64) -> Option<f64> {
        let right = self.log_omega.partition_point(|w| *w < log_omega);
        let right_omega = *self.log_omega.get(right)?;
        if right_omega == log_omega {
            return Some(self.log_error[right]);
        }
        let left = right.checked_sub(1)?;
        let share = (log_omega - self.log_omega[left]) / (right_omega - self.log_omega[left]);
        Some(self.log_error[left] + share * (self.log_error[right] - self.log_error[left]))
    }
}

/// An error that a bound has to cover at one frequency.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct EnvelopePoint {
    pub omega: f64,
    pub error: f64,
}

/// The largest of all curves at every measured frequency and, between neighbours, at steps of at most `step` in
/// `ln(omega)`.
pub(crate) fn envelope(curves: &[ErrorCurve], step: f64) -> Vec<EnvelopePoint> {
    let mut measured: Vec<f64> = curves.iter().flat_map(|c| c.log_omega.iter().copied()).collect();
    measured.sort_by(f64::total_cmp);
    measured.dedup();
    let mut grid = Vec::new();
    for pair in measured.windows(2) {
        let gap = pair[1] - pair[0];
        let n = (gap / step).ceil().max(1.0);
        grid.extend((0..n as usize).map(|k| pair[0] + gap * k as f64 / n));
    }
    grid.extend(measured.last());
    let largest = |w: f64| curves.iter().filter_map(|c| c.log_at(w)).fold(f64::NEG_INFINITY, f64::max);
    grid.into_iter()
        .map(|w| EnvelopePoint { omega: w.exp(), error: largest(w).exp() })
        .filter(|p| p.error > 0.0)
        .collect()
}

/// For each point, the largest error within a factor `width` of its frequency.
pub(crate) fn running_maximum(points: &[EnvelopePoint], width: f64) -> Vec<f64> {
    points
        .iter()
        .map(|p| {
            let near = points.iter().filter(|q| q.omega <= p.omega * width && q.omega * width >= p.omega);
            near.fold(p.error, |largest, q| largest.max(q.error))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_envelope_interpolates_straight_in_log_log_and_takes_the_larger() {
        // Slope 1 from (1, 1) to (100, 100), and a constant 2 from 1 to 10.
        let curves = [
            ErrorCurve::new(vec![(100.0, 100.0), (1.0, 1.0)], 1e-9),
            ErrorCurve::new(vec![(1.0, 2.0), (10.0, 2.0)], 1e-9),
        ];
        let points = envelope(&curves, 0.1);
        assert!(points.len() > 46);
        for p in &points {
            let expected = if p.omega < 10.0 + 1e-9 { p.omega.max(2.0) } else { p.omega };
            assert!((p.error / expected - 1.0).abs() < 1e-12, "{p:?}");
        }
        let widened = running_maximum(&points, 1.5);
        assert!(widened.iter().zip(&points).all(|(w, p)| *w >= p.error && *w <= 2.0 * p.error));
    }

    #[test]
    fn edge_single_points_and_zero_errors_have_a_place() {
        let points = envelope(&[ErrorCurve::new(vec![(5.0, 0.0)], 1e-9)], 0.1);
        assert_eq!(points.len(), 1);
        assert!((points[0].error / 1e-9 - 1.0).abs() < 1e-9);
    }
}
