//! A second-order weight whose magnitude lies closely above given values.
#![allow(non_snake_case)]

use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettingsBuilder, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus, ZeroConeT,
};
use telepulse_lti::TransferFunction;

use super::envelope::{EnvelopePoint, running_maximum};
use crate::{Error, Result};

/// The shape of a second-order bound.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum BoundShape {
    /// `k / (s^2 + a s + b)`, as in Eq. (17): falls off above the measured range, where nothing was measured.
    #[default]
    ConstantNumerator,
    /// `(n2 s^2 + n1 s + n0) / (s^2 + a s + b)`: stays at the last measured error above the range.
    Biproper,
}

/// `|W|^2` as a ratio of polynomials in `x = (omega/scale)^2`, ascending powers.
struct PowerRatio {
    numerator: [f64; 3],
    denominator: [f64; 3],
    scale: f64,
}

/// One frequency of the design.
struct Row {
    /// `(omega/scale)^2`; infinity stands for the leading coefficients.
    x: f64,
    /// The weight must reach this, where there is something to reach.
    cover: Option<f64>,
    /// The weight should stay near this.
    near: f64,
}

/// The stable, minimum-phase weight that covers `points` with the least largest ratio to their running maximum.
///
/// **Shapes and units**: `points` in rad/s and in the unit of the error, frequencies rising.
///
/// **Method**: log-Chebyshev magnitude design. With `N/D = |W|^2` the wish "cover e, stay within a factor t" is linear in the
/// coefficients: `e^2 D <= N <= t^2 h^2 D`; it forces N, D > 0. One linear program (clarabel) maximises the slack of all
/// rows for a given t; bisection on ln t, where every feasible solution lowers the upper end to the ratio that it really
/// has. N and D are then factored in closed form. h is the largest error within [`NEIGHBOURHOOD`] of a frequency: a narrow null of the error
/// is nothing that a second-order weight could or should follow. Below the measured range the first error is held, and
/// above it the last one (for the constant numerator only as a limit from above), so that no resonance hides
/// where there are no data.
///
/// **Source**: Boyd and Vandenberghe, Convex Optimization, 2004, section 6.5 and exercise 4.10 (spectral factorisation).
///
/// **Accuracy**: ln t to [`TOLERANCE`]; damping ratio of numerator and denominator at least [`DAMPING_MIN`]. The weight
/// covers `points` up to the accuracy of the program, 1e-6; the caller scales it.
///
/// # Errors
/// [`Error::CoverInfeasible`] where no weight is found within the last of [`RATIOS_TRIED`].
pub(super) fn cover_magnitude(points: &[EnvelopePoint], shape: BoundShape) -> Result<TransferFunction> {
    let (first, last) = (points[0], points[points.len() - 1]);
    let scale = (first.omega * last.omega).sqrt();
    let peak = points.iter().fold(0.0, |m: f64, p| m.max(p.error));
    let rows = design_rows(points, shape, scale, peak);

    // A wide factor makes a badly scaled program, so the small ones are tried first.
    let mut lower: f64 = 0.0;
    let mut best = None;
    for t in RATIOS_TRIED {
        best = feasible(&rows, t, shape, scale);
        if best.is_some() {
            break;
        }
        lower = t.ln();
    }
    let mut best = best.ok_or(Error::CoverInfeasible { ratio_max: RATIOS_TRIED[RATIOS_TRIED.len() - 1] })?;
    let mut upper = ratio(&best, &rows).ln().max(lower);
    for _ in 0..BISECTIONS_MAX {
        if upper - lower <= TOLERANCE {
            break;
        }
        let middle = 0.5 * (lower + upper);
        match feasible(&rows, middle.exp(), shape, scale) {
            Some(found) => {
                upper = middle.min(ratio(&found, &rows).ln()).max(lower);
                best = found;
            }
            None => lower = middle,
        }
    }
    best.factor(peak)
}

/// Errors within this factor of a frequency count as errors at it when the tightness is judged: half an octave.
const NEIGHBOURHOOD: f64 = std::f64::consts::SQRT_2;
/// Factors between a weight and the data that are tried until one is feasible; beyond the last one there is no use in a bound.
const RATIOS_TRIED: [f64; 4] = [2.0, 8.0, 60.0, 1000.0];
/// Bracket of ln t at the end: one percent.
const TOLERANCE: f64 = 1e-2;
/// Bound on the bisections: ln(1000/60) / 2^9 is below the tolerance.
const BISECTIONS_MAX: usize = 10;
/// Smallest damping ratio of the weight: the bound may not have a peak or dip too narrow for the grid it is checked on.
pub(super) const DAMPING_MIN: f64 = 0.05;

/// Rows on each side of the measured range: two decades.
const OUTER_ROWS: u32 = 16;
/// Their density.
const ROWS_PER_DECADE: f64 = 8.0;

fn design_rows(points: &[EnvelopePoint], shape: BoundShape, scale: f64, peak: f64) -> Vec<Row> {
    let near = running_maximum(points, NEIGHBOURHOOD);
    let (first, last) = (points[0], points[points.len() - 1]);
    let row = |omega: f64, cover: Option<f64>, near: f64| Row {
        x: (omega / scale).powi(2),
        cover: cover.map(|e| e / peak),
        near: near / peak,
    };
    let above = match shape {
        BoundShape::ConstantNumerator => None,
        BoundShape::Biproper => Some(last.error),
    };
    let mut rows = vec![row(0.0, Some(first.error), near[0])];
    for k in (1..=OUTER_ROWS).rev() {
        rows.push(row(
            first.omega * 10_f64.powf(-f64::from(k) / ROWS_PER_DECADE),
            Some(first.error),
            near[0],
        ));
    }
    rows.extend(points.iter().zip(&near).map(|(p, n)| row(p.omega, Some(p.error), *n)));
    let near_last = near[near.len() - 1];
    for k in 1..=OUTER_ROWS {
        rows.push(row(last.omega * 10_f64.powf(f64::from(k) / ROWS_PER_DECADE), above, near_last));
    }
    rows.push(row(f64::INFINITY, above, near_last));
    rows
}

/// `[1, x, x^2] / (1 + x^2)`.
fn powers(x: f64) -> [f64; 3] {
    if x.is_infinite() {
        return [0.0, 0.0, 1.0];
    }
    let q = 1.0 + x * x;
    [1.0 / q, x / q, x * x / q]
}

/// A weight within `t` of the data, or `None`.
///
/// Variables: numerator (1 or 3), denominator (3), slack. Rows: the mean of the denominator over all frequencies is 1 (a
/// value at one frequency would leave the program unbounded where no row is near); then `N/e^2 - D >= slack` and
/// `D - N/(t h)^2 >= slack` for each frequency, scaled to size one; then the outer coefficients >= 0.
fn feasible(rows: &[Row], t: f64, shape: BoundShape, scale: f64) -> Option<PowerRatio> {
    let n_num = match shape {
        BoundShape::ConstantNumerator => 1,
        BoundShape::Biproper => 3,
    };
    let (d0, slack, n_var) = (n_num, n_num + 3, n_num + 4);
    // Clarabel: A z + s = b with s in the cone, so "expression >= 0" is the row -expression.
    let mut A: Vec<Vec<f64>> = Vec::with_capacity(2 * rows.len() + 4);
    let mut mean = vec![0.0; n_var];
    for row in rows {
        for (k, power) in powers(row.x).into_iter().enumerate() {
            mean[d0 + k] += power / rows.len() as f64;
        }
    }
    A.push(mean);
    for row in rows {
        let p = powers(row.x);
        let mut inequality = |numerator: f64, denominator: f64| {
            // Each row at size one; the slack is only asked for its sign.
            let size = numerator.abs().max(denominator.abs());
            let mut a = vec![0.0; n_var];
            for k in 0..n_num {
                a[k] = -numerator / size * p[k];
            }
            for k in 0..3 {
                a[d0 + k] = -denominator / size * p[k];
            }
            a[slack] = 1.0;
            A.push(a);
        };
        if let Some(e) = row.cover {
            inequality(1.0 / (e * e), -1.0);
        }
        inequality(-1.0 / (t * row.near).powi(2), 1.0);
    }
    for outer in [0, n_num - 1, d0, d0 + 2] {
        let mut a = vec![0.0; n_var];
        a[outer] = -1.0;
        A.push(a);
    }
    let solution = solve(&A, n_var, slack)?;
    if solution[slack] <= SLACK_MIN {
        return None;
    }
    let mut numerator = [0.0; 3];
    numerator[..n_num].copy_from_slice(&solution[..n_num]);
    let denominator = [solution[d0], solution[d0 + 1], solution[d0 + 2]];
    let found = PowerRatio { numerator, denominator, scale };
    ratio(&found, rows).is_finite().then_some(found)
}

/// Slack above which a program counts as feasible; its rows are of size one, its accuracy is 1e-8.
const SLACK_MIN: f64 = 1e-8;

/// Maximises variable `slack`; the first row is the equation `= 1`, the others are `<= 0`.
fn solve(A: &[Vec<f64>], n_var: usize, slack: usize) -> Option<Vec<f64>> {
    let mut q = vec![0.0; n_var];
    q[slack] = -1.0;
    let mut b = vec![0.0; A.len()];
    b[0] = 1.0;
    let settings = DefaultSettingsBuilder::default().verbose(false).max_iter(100).build().ok()?;
    let cones = [ZeroConeT(1), NonnegativeConeT(A.len() - 1)];
    let P = CscMatrix::zeros((n_var, n_var));
    let mut solver = DefaultSolver::new(&P, &q, &CscMatrix::from(A), &b, &cones, settings).ok()?;
    solver.solve();
    let solution = &solver.solution;
    let usable = matches!(solution.status, SolverStatus::Solved | SolverStatus::AlmostSolved);
    usable.then(|| solution.x.clone())
}

/// Largest ratio of the weight to the data, once it is scaled to cover them; infinite where `|W|^2` is not positive.
fn ratio(found: &PowerRatio, rows: &[Row]) -> f64 {
    let (mut short, mut over) = (0.0_f64, 0.0_f64);
    for row in rows {
        let p = powers(row.x);
        let dot = |c: &[f64; 3]| c[0] * p[0] + c[1] * p[1] + c[2] * p[2];
        let (N, D) = (dot(&found.numerator), dot(&found.denominator));
        if D <= 0.0 || N < 0.0 || (row.cover.is_some() && N == 0.0) {
            return f64::INFINITY;
        }
        if let Some(e) = row.cover {
            short = short.max(e * e * D / N);
        }
        over = over.max(N / (D * row.near * row.near));
    }
    (short * over).sqrt()
}

impl PowerRatio {
    /// The stable, minimum-phase spectral factor, with gain `peak`.
    ///
    /// `|alpha s^2 + beta s + gamma|^2 = alpha^2 x^2 + (beta^2 - 2 alpha gamma) x + gamma^2` at `s = j sqrt(x)`, which gives the
    /// three coefficients from those of the polynomial.
    fn factor(&self, peak: f64) -> Result<TransferFunction> {
        let quadratic = |c: [f64; 3], gain: f64| {
            let (alpha, gamma) = (c[2].max(0.0).sqrt(), c[0].max(0.0).sqrt());
            let beta = (c[1] + 2.0 * alpha * gamma).max(0.0).sqrt();
            let damped = beta.max(2.0 * DAMPING_MIN * (alpha * gamma).sqrt());
            // Descending powers of s, frequency scale taken out.
            [gain * alpha / self.scale.powi(2), gain * damped / self.scale, gain * gamma]
        };
        let denominator = quadratic(self.denominator, 1.0);
        let lead = denominator[0];
        let numerator = quadratic(self.numerator, peak).map(|c| c / lead);
        Ok(TransferFunction::new(&numerator, &denominator.map(|c| c / lead))?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(f: impl Fn(f64) -> f64) -> Vec<EnvelopePoint> {
        (0..60)
            .map(|k| 0.6 * 130_f64.powf(f64::from(k) / 59.0))
            .map(|omega| EnvelopePoint { omega, error: f(omega) })
            .collect()
    }

    #[test]
    fn paper_eq17_is_found_again_from_its_own_magnitude() {
        let printed = TransferFunction::new(&[487.5], &[1.0, 45.0, 2500.0]).expect("proper");
        let data = points(|w| printed.at(w).norm());
        let found = cover_magnitude(&data, BoundShape::ConstantNumerator).expect("feasible");
        assert_eq!(found.relative_degree(), 2);
        for p in &data {
            let ratio = found.at(p.omega).norm() / p.error;
            // The tightness is judged against the running maximum over half an octave, where (17) falls 2:1 at the upper end.
            assert!((0.999..2.05).contains(&ratio), "{ratio} at {}", p.omega);
        }
    }

    #[test]
    fn law_biproper_weight_holds_the_last_error() {
        let data = points(|w| 0.1 + 0.3 / (1.0 + ((w - 38.0) / 8.0).powi(2)));
        let found = cover_magnitude(&data, BoundShape::Biproper).expect("feasible");
        assert_eq!(found.relative_degree(), 0);
        assert!(found.at(1e6).norm() >= 0.999 * data[59].error);
        assert!(found.is_stable().expect("poles"));
        assert!(found.zeros().expect("zeros").iter().all(|z| z.re < 0.0));
        assert!(data.iter().all(|p| found.at(p.omega).norm() > 0.999 * p.error));
    }
}
