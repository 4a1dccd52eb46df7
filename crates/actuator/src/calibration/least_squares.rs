//! Nonlinear least squares within bounds by a trust region after Levenberg, Marquardt and More.

use nalgebra::{DMatrix, DVector};

use super::Refusal;
use crate::Error;

/// Where the iteration ended.
pub(super) struct Minimum {
    pub(super) parameters: DVector<f64>,
    pub(super) residual: DVector<f64>,
    pub(super) jacobian: DMatrix<f64>,
    /// Whether a parameter is held by a bound that the residual pushes against.
    pub(super) held: Vec<bool>,
    pub(super) iterations: usize,
}

/// The function whose square is minimised.
pub(super) struct Problem<R, J> {
    pub(super) residual: R,
    pub(super) jacobian: J,
    pub(super) lower: DVector<f64>,
    pub(super) upper: DVector<f64>,
}

/// Bound on the iterations; a fit of ten parameters takes 5 to 60.
const ITERATIONS_MAX: usize = 200;
/// Largest step, as a Euclidean length in logarithms: the linearisation says nothing beyond a factor of e.
const RADIUS_MAX: f64 = 1.0;
/// A step this short that is still refused shows that the differences of the Jacobian see no further.
const RADIUS_MIN: f64 = 1e-7;
/// The end: no step within the largest radius is predicted to lower the sum of squares, whose unit is the noise, by more than
/// this: a twentieth of a standard error in every direction, or 1e-7 of what is left.
const GAIN_MIN: [f64; 2] = [3e-3, 1e-7];
/// Where steps are refused at the smallest radius, a predicted gain below this counts as an end too.
const GAIN_STALLED: [f64; 2] = [1e-2, 1e-3];
/// A parameter this close to a bound stands at it.
const AT_BOUND: f64 = 1e-9;
/// Singular values below this part of the largest are errors of the differences.
const ROUNDING: f64 = 1e-7;

/// Minimises `|residual|^2` from `start` between the bounds.
///
/// **Method**: trust region, `(J'J + d I) step = -J'r` with d such that the step has at most the trusted length, through the
/// singular values of J; logarithms are the scaling. Parameters at a bound that the gradient pushes against are held, other
/// steps end at the first bound that they meet. A point where the model has no value counts as worse than any other.
///
/// **Source**: Levenberg 1944, Marquardt 1963 in the form of More 1978, with an active set for the bounds.
///
/// # Errors
/// Those of the residual at the start; [`Refusal::NotConverged`].
pub(super) fn minimize<R, J>(start: DVector<f64>, problem: &Problem<R, J>) -> Result<Minimum, Error>
where
    R: Fn(&DVector<f64>) -> Result<DVector<f64>, Error>,
    J: Fn(&DVector<f64>) -> Result<DMatrix<f64>, Error>,
{
    let mut parameters = start;
    let mut residual = (problem.residual)(&parameters)?;
    let mut jacobian = (problem.jacobian)(&parameters)?;
    let (mut radius, mut last_step, mut iterations) = (RADIUS_MAX, f64::INFINITY, 0);
    while iterations < ITERATIONS_MAX {
        iterations += 1;
        let held = held_at_bounds(&parameters, &jacobian.tr_mul(&residual), problem);
        let cost = residual.norm_squared();
        let within = |radius: f64| problem.propose(&parameters, &jacobian, &residual, &held, radius);
        let farthest = within(RADIUS_MAX);
        let stalled = radius < RADIUS_MIN;
        let [absolute, relative] = if stalled { GAIN_STALLED } else { GAIN_MIN };
        if farthest.gain_unbounded <= absolute + relative * cost {
            return Ok(Minimum { parameters, residual, jacobian, held, iterations });
        }
        if stalled {
            break;
        }
        let Proposal { next, gain: predicted, .. } = within(radius);
        last_step = (&next - &parameters).norm();
        let tried = (problem.residual)(&next).ok().filter(|r| r.iter().all(|value| value.is_finite()));
        let gain = tried.as_ref().map_or(-1.0, |r| (cost - r.norm_squared()) / predicted);
        radius = match gain {
            good if good > 0.75 => (2.0 * radius).min(RADIUS_MAX),
            fair if fair > 0.25 => radius,
            _ => 0.25 * last_step.min(radius),
        };
        if let Some(better) = tried.filter(|_| gain > 0.0) {
            (parameters, residual) = (next, better);
            jacobian = (problem.jacobian)(&parameters)?;
        }
    }
    let rms = (residual.norm_squared() / residual.len() as f64).sqrt();
    Err(Error::Calibration(Refusal::NotConverged { iterations, last_step, rms }))
}

/// A step within bounds and what it promises.
struct Proposal {
    next: DVector<f64>,
    /// Decrease of the sum of squares that the linearisation predicts.
    gain: f64,
    /// The same for the step before it was cut short at a bound: no step of this length promises more.
    gain_unbounded: f64,
}

impl<R, J> Problem<R, J> {
    /// The step of at most `radius`. Parameters at a bound that it would cross are held and the step is sought anew; where it
    /// meets another bound on its way, it ends there: cutting one parameter alone could make it climb.
    fn propose(
        &self,
        parameters: &DVector<f64>,
        jacobian: &DMatrix<f64>,
        residual: &DVector<f64>,
        held: &[bool],
        radius: f64,
    ) -> Proposal {
        let mut held = held.to_vec();
        let mut step = LinearModel::new(jacobian, residual, &held).step(radius);
        // Each round holds at least one more.
        for _ in 0..held.len() {
            let blocked = (0..held.len()).find(|&idx| !held[idx] && self.room(parameters, &step, idx) <= 0.0);
            let Some(idx) = blocked else { break };
            held[idx] = true;
            step = LinearModel::new(jacobian, residual, &held).step(radius);
        }
        let rooms: Vec<f64> = (0..held.len()).map(|idx| self.room(parameters, &step, idx)).collect();
        let part = rooms.iter().fold(1.0, |part: f64, room| part.min(*room));
        let mut next = parameters + &step * part;
        for (idx, room) in rooms.iter().enumerate() {
            // Onto the bound itself, not beside it by rounding.
            if part < 1.0 && *room <= part {
                next[idx] = if step[idx] < 0.0 { self.lower[idx] } else { self.upper[idx] };
            }
        }
        let gain =
            |step: &DVector<f64>| residual.norm_squared() - (residual + jacobian * step).norm_squared();
        Proposal { gain: gain(&(&next - parameters)), gain_unbounded: gain(&step), next }
    }

    /// Which part of the step a parameter can take before its bound.
    fn room(&self, parameters: &DVector<f64>, step: &DVector<f64>, idx: usize) -> f64 {
        let bound = if step[idx] < 0.0 { self.lower[idx] } else { self.upper[idx] };
        let distance = bound - parameters[idx];
        match (step[idx] == 0.0, distance.abs() <= AT_BOUND) {
            (true, _) => f64::INFINITY,
            (false, true) => 0.0,
            (false, false) => distance / step[idx],
        }
    }
}

/// Which parameters stand at a bound with the descent pointing out of it.
fn held_at_bounds<R, J>(
    parameters: &DVector<f64>,
    gradient: &DVector<f64>,
    problem: &Problem<R, J>,
) -> Vec<bool> {
    (0..parameters.len())
        .map(|idx| {
            let (p, g) = (parameters[idx], gradient[idx]);
            p <= problem.lower[idx] + AT_BOUND && g > 0.0 || p >= problem.upper[idx] - AT_BOUND && g < 0.0
        })
        .collect()
}

/// The linearised residual in its singular directions.
struct LinearModel {
    /// Directions as rows, zero for what is held.
    directions: DMatrix<f64>,
    values: DVector<f64>,
    /// Residual along the image of each direction.
    along: DVector<f64>,
}

impl LinearModel {
    fn new(jacobian: &DMatrix<f64>, residual: &DVector<f64>, held: &[bool]) -> Self {
        let mut loose = jacobian.clone();
        for p in (0..held.len()).filter(|&p| held[p]) {
            loose.column_mut(p).fill(0.0);
        }
        let svd = loose.svd(true, true);
        let (Some(u), Some(mut directions)) = (svd.u, svd.v_t) else {
            unreachable!("both were asked for");
        };
        // Zero but for rounding, which would count as a step against the bound.
        for p in (0..held.len()).filter(|&p| held[p]) {
            directions.column_mut(p).fill(0.0);
        }
        Self { directions, along: u.tr_mul(residual), values: svd.singular_values }
    }

    /// Step of at most this length: a longer one is damped until its length is right, by bisection in the logarithm of the
    /// damping.
    fn step(&self, radius: f64) -> DVector<f64> {
        let least = ROUNDING * self.values.max();
        let damped = |damping: f64| {
            let amplitudes = self.values.zip_map(&self.along, |value, along| {
                if value > least { -value * along / (value * value + damping) } else { 0.0 }
            });
            self.directions.tr_mul(&amplitudes)
        };
        let free = damped(0.0);
        if free.norm() <= radius {
            return free;
        }
        // |step| <= |J'r|/damping, so the upper end is long enough damped.
        let steepest = self.values.component_mul(&self.along).norm();
        let (mut low, mut high) = (1e-20 * (1.0 + steepest), 2.0 * steepest / radius);
        for _ in 0..60 {
            let middle = (low * high).sqrt();
            if damped(middle).norm() > radius { low = middle } else { high = middle }
        }
        damped(high)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rosenbrock(lower: f64, upper: f64) -> Minimum {
        let problem = Problem {
            residual: |p: &DVector<f64>| {
                Ok(DVector::from_vec(vec![1e5 * (p[1] - p[0] * p[0]), 1e4 * (1.0 - p[0])]))
            },
            jacobian: |p: &DVector<f64>| Ok(DMatrix::from_row_slice(2, 2, &[-2e5 * p[0], 1e5, -1e4, 0.0])),
            lower: DVector::from_element(2, lower),
            upper: DVector::from_element(2, upper),
        };
        minimize(DVector::from_vec(vec![-1.2, 0.5]), &problem).expect("converges")
    }

    #[test]
    fn oracle_rosenbrock_valley_free_and_within_bounds() {
        let free = rosenbrock(-5.0, 5.0);
        // A gain of 3e-3 is an error of 5e-6 along x and of twice that along y.
        assert!((&free.parameters - DVector::from_element(2, 1.0)).amax() < 1.2e-5, "{}", free.parameters);
        // With both below 0.5 the minimum is x = 0.5, y = x^2: there the slope in y vanishes, and in x it
        // points out. The end: 1e-7 of the 2.5e7 that are left, 1.6e-5 along y.
        let bound = rosenbrock(-5.0, 0.5);
        assert!((bound.parameters[0] - 0.5).abs() < 1e-12 && (bound.parameters[1] - 0.25).abs() < 1e-4);
        assert_eq!(bound.held, [true, false]);
    }

    #[test]
    fn edge_a_residual_without_minimum_is_not_called_converged() {
        // exp(-p/1000) falls for ever; in units of the noise by 2000 with each step at first.
        let problem = Problem {
            residual: |p: &DVector<f64>| Ok(DVector::from_element(1, 1e3 * (-1e-3 * p[0]).exp())),
            jacobian: |p: &DVector<f64>| Ok(DMatrix::from_element(1, 1, -(-1e-3 * p[0]).exp())),
            lower: DVector::from_element(1, -1e9),
            upper: DVector::from_element(1, 1e9),
        };
        let ended = minimize(DVector::zeros(1), &problem);
        assert!(matches!(ended, Err(Error::Calibration(Refusal::NotConverged { .. }))));
    }
}
