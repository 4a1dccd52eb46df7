//! The nearest reference that a drive can follow.

use std::ops::Range;

use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettingsBuilder, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus};

use super::flat_feedforward::FlatDrive;
use crate::identify::GreyBoxModel;

/// Moves a reference as little as possible so that the voltage for it stays within the drive's range.
///
/// ```text
///   minimise  sum (x - r)^2   subject to   min <= c + rc c' <= max,   c = sqrt(w(x, x', x''))
/// ```
///
/// **Method**: only around samples whose voltage leaves the range, `reach_s` to each side; there the change is a cubic spline with a knot
/// every [`KNOT_S`], and a quadratic program (clarabel) with the constraints linearised about the last reference, repeated up to
/// [`ROUNDS_MAX`] times. It acts before the limit is met, which a limited drive alone cannot: a rise that is too steep starts earlier.
///
/// **Accuracy**: slew is not constrained here; it is in the feedforward that follows. A window whose program has no solution is left as it is.
pub(super) struct Governor<'a> {
    pub model: &'a GreyBoxModel,
    pub drive: FlatDrive,
    pub sample_time_s: f64,
    pub reach_s: f64,
}

impl Governor<'_> {
    /// Changes `reference` (mm) around the samples `outside`; `creep` is the sum of stiffness times dashpot position at each sample.
    pub(super) fn soften(&self, reference: &mut [f64], wanted: &[f64], outside: &[usize], creep: &[f64]) {
        let stride = (KNOT_S / self.sample_time_s).round().max(1.0) as usize;
        for window in self.windows(outside, reference.len()) {
            let n_knots = (window.len() - 1) / stride + 1;
            if n_knots < 4 * EDGE_KNOTS {
                continue;
            }
            let knots = Knots::new(self, reference, wanted, creep, window.start, stride, n_knots);
            if let Some(change) = knots.solve() {
                add_spline(&mut reference[window], &change, stride);
            }
        }
    }

    /// Ranges around the samples, merged where they overlap.
    fn windows(&self, outside: &[usize], n: usize) -> Vec<Range<usize>> {
        let reach = (self.reach_s / self.sample_time_s).round() as usize;
        let mut windows: Vec<Range<usize>> = Vec::new();
        for &k in outside {
            let (start, end) = (k.saturating_sub(reach), (k + reach + 1).min(n));
            match windows.last_mut() {
                Some(last) if start <= last.end => last.end = end,
                _ => windows.push(start..end),
            }
        }
        windows
    }
}

/// Distance of two knots, s.
const KNOT_S: f64 = 0.002;
/// Rounds of linearising and solving.
pub(super) const ROUNDS_MAX: usize = 4;
/// Knots at each end of a window that do not move, so that the change starts and ends smoothly.
const EDGE_KNOTS: usize = 3;
/// Room that is kept to the limits, units of full scale, for what linearising and the coarser grid leave.
const ROOM_UNIT: f64 = 0.005;
/// Squared voltages that are looked for, beyond what any drive gives.
const SOUGHT: [f64; 2] = [-4.0, 8.0];
/// A drive this small has no root to be linearised.
const DRIVE_FLOOR: f64 = 1e-3;

/// One window of a reference at its knots, and what the constraints are made of.
struct Knots {
    step_s: f64,
    rc_s: f64,
    /// What the reference lacks to what is wanted.
    lack: Vec<f64>,
    /// Drive, and its derivatives with respect to displacement, velocity and acceleration.
    drive: Vec<[f64; 4]>,
    min_unit: f64,
    max_unit: f64,
}

impl Knots {
    fn new(
        governor: &Governor<'_>,
        reference: &[f64],
        wanted: &[f64],
        creep: &[f64],
        start: usize,
        stride: usize,
        n_knots: usize,
    ) -> Self {
        let model = governor.model;
        let step_s = stride as f64 * governor.sample_time_s;
        let last = reference.len() as isize - 1;
        let at = |j: isize| reference[(start as isize + j * stride as isize).clamp(0, last) as usize];
        let stiffness: f64 = model.branches().iter().map(|branch| branch.stiffness_per_s2).sum();
        let drive = (0..n_knots as isize).map(|j| {
            let x = at(j);
            let velocity = (at(j + 1) - at(j - 1)) / (2.0 * step_s);
            let acceleration = (at(j + 1) - 2.0 * x + at(j - 1)) / (step_s * step_s);
            let k = (start + j as usize * stride).min(creep.len() - 1);
            let pull = acceleration + model.damping_per_s() * velocity + stiffness * x - creep[k];
            let w = model.drive_for(x, pull, SOUGHT);
            let [_, by_x, by_w] = model.pull(x, w);
            [w, (stiffness - by_x) / by_w, model.damping_per_s() / by_w, 1.0 / by_w]
        });
        let drive = drive.collect();
        let lack = (0..n_knots).map(|j| {
            let k = start + j * stride;
            wanted[k] - reference[k]
        });
        Self {
            step_s,
            rc_s: model.rc_s(),
            lack: lack.collect(),
            drive,
            min_unit: governor.drive.min_unit + if governor.drive.min_unit > 0.0 { ROOM_UNIT } else { 0.0 },
            max_unit: governor.drive.max_unit - ROOM_UNIT,
        }
    }

    /// Weights of the spline's coefficients j - 1, j, j + 1 in the change of the drive at knot j.
    fn drive_row(&self, j: usize) -> [f64; 3] {
        let [_, by_x, by_v, by_a] = self.drive[j];
        let h = self.step_s;
        let (value, velocity, acceleration) = ([1.0, 4.0, 1.0], [-1.0, 0.0, 1.0], [1.0, -2.0, 1.0]);
        std::array::from_fn(|i| {
            by_x * value[i] / 6.0 + by_v * velocity[i] / (2.0 * h) + by_a * acceleration[i] / (h * h)
        })
    }

    /// Coefficients of the spline that is to be added; the first and last ones are zero.
    fn solve(&self) -> Option<Vec<f64>> {
        let n = self.drive.len();
        let free = EDGE_KNOTS..n - EDGE_KNOTS;
        let n_free = free.len();
        let (mut rows, mut columns, mut values, mut bounds) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        // A x + s = b with s >= 0.
        for j in 2..n - 2 {
            let w = self.drive[j][0];
            let rate = (self.drive[j + 1][0] - self.drive[j - 1][0]) / (2.0 * self.step_s);
            let root = w.max(DRIVE_FLOOR).sqrt();
            // v = (w + rc w'/2) / sqrt(w): both limits times the root, which is linearised.
            for (limit, sign) in [(self.max_unit, 1.0), (self.min_unit, -1.0)] {
                let row = bounds.len();
                let by_w = 1.0 - limit / (2.0 * root);
                let by_rate = 0.5 * self.rc_s / (2.0 * self.step_s);
                let mut weights = [0.0; 5];
                for (i, weight) in self.drive_row(j).into_iter().enumerate() {
                    weights[i + 1] += by_w * weight;
                }
                for (i, weight) in self.drive_row(j + 1).into_iter().enumerate() {
                    weights[i + 2] += by_rate * weight;
                }
                for (i, weight) in self.drive_row(j - 1).into_iter().enumerate() {
                    weights[i] -= by_rate * weight;
                }
                for (i, weight) in weights.into_iter().enumerate() {
                    let knot = j + i - 2;
                    if free.contains(&knot) {
                        rows.push(row);
                        columns.push(knot - free.start);
                        values.push(sign * weight);
                    }
                }
                bounds.push(sign * (limit * root - w - 0.5 * self.rc_s * rate));
            }
        }
        let (quadratic, linear) = self.cost(&free);
        let constraints = CscMatrix::new_from_triplets(bounds.len(), n_free, rows, columns, values);
        let settings = DefaultSettingsBuilder::default().verbose(false).max_iter(60).build().ok()?;
        let cones = [NonnegativeConeT(bounds.len())];
        let mut solver =
            DefaultSolver::new(&quadratic, &linear, &constraints, &bounds, &cones, settings).ok()?;
        solver.solve();
        let usable = matches!(solver.solution.status, SolverStatus::Solved | SolverStatus::AlmostSolved);
        usable.then(|| {
            let mut all = vec![0.0; n];
            all[free].copy_from_slice(&solver.solution.x);
            all
        })
    }

    /// `sum (value - lack)^2` over the knots as the upper triangle of its quadratic form and a linear one, in units of the wanted accuracy.
    fn cost(&self, free: &Range<usize>) -> (CscMatrix<f64>, Vec<f64>) {
        let n_free = free.len();
        // The products of the stencil (1, 4, 1)/6 with itself.
        let products = [18.0, 8.0, 1.0].map(|p| 2.0 * p / 36.0);
        let (mut rows, mut columns, mut values) = (Vec::new(), Vec::new(), Vec::new());
        for column in 0..n_free {
            for (distance, product) in products.iter().enumerate().filter(|(distance, _)| *distance <= column)
            {
                rows.push(column - distance);
                columns.push(column);
                values.push(*product);
            }
        }
        let lack = |j: usize| self.lack[j];
        let linear = free.clone().map(|j| -2.0 * (lack(j - 1) + 4.0 * lack(j) + lack(j + 1)) / 6.0).collect();
        (CscMatrix::new_from_triplets(n_free, n_free, rows, columns, values), linear)
    }
}

/// Adds a cubic spline with a coefficient every `stride` samples.
fn add_spline(window: &mut [f64], coefficients: &[f64], stride: usize) {
    let at = |j: isize| usize::try_from(j).ok().and_then(|j| coefficients.get(j)).copied().unwrap_or(0.0);
    for (k, value) in window.iter_mut().enumerate() {
        let (j, t) = ((k / stride) as isize, (k % stride) as f64 / stride as f64);
        let basis = [
            (1.0 - t).powi(3),
            3.0 * t.powi(3) - 6.0 * t * t + 4.0,
            -3.0 * t.powi(3) + 3.0 * t * t + 3.0 * t + 1.0,
            t.powi(3),
        ];
        *value += basis.iter().enumerate().map(|(i, b)| b / 6.0 * at(j + i as isize - 1)).sum::<f64>();
    }
}
