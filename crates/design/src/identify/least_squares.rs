//! Nonlinear least squares by Levenberg and Marquardt's method.

use nalgebra::{DMatrix, DVector};

use crate::{Error, Result};

/// Residual and Jacobian at one point.
pub(super) struct Linearized {
    /// Residual, n_r.
    pub residual: DVector<f64>,
    /// Jacobian of the residual, n_r x n_p.
    pub jacobian: DMatrix<f64>,
}

/// Where the iteration ended.
pub(super) struct Minimum {
    /// Parameters.
    pub parameters: DVector<f64>,
    /// Residual and Jacobian there.
    pub linearized: Linearized,
    /// Iterations made.
    pub iterations: usize,
}

/// When an iteration may end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Stop {
    /// Where the parameters no longer move.
    AtTheMinimum,
    /// Where a nearly undamped step would lower the sum of squares by less than a ten-thousandth of one residual's variance: the parameters are then
    /// about a hundredth of their standard errors from the minimum.
    WithinNoise,
}

/// Minimises `|residual|^2` from `start`.
///
/// **Method**: damped Gauss-Newton, `(J'J + mu D) step = -J'r` with D the diagonal of J'J, solved through QR of the stacked
/// matrix `[J; sqrt(mu D)]`; mu falls by the rule of Nielsen with the ratio of actual to predicted gain and grows on
/// every rejected step. The parameters are logarithms here, so a step is a relative change.
///
/// **Source**: Madsen, Nielsen, Tingleff, "Methods for non-linear least squares problems", 2004, algorithm 3.16.
///
/// **Accuracy**: ends where a step is below [`STEP_MAX`] in every parameter while the damping is small, where the
/// residual is at the level of rounding, or where `stop` says that noise hides what is left to gain.
///
/// # Errors
/// [`Error::FitNotConverged`] after [`ITERATIONS_MAX`] iterations or where no step makes the residual smaller.
pub(super) fn minimize(
    start: DVector<f64>,
    stop: Stop,
    linearize: impl Fn(&DVector<f64>) -> Linearized,
) -> Result<Minimum> {
    let mut parameters = start;
    let mut here = linearize(&parameters);
    let mut damping = 1e-3;
    let mut growth = 2.0;
    let mut last_step = f64::INFINITY;
    for iterations in 1..=ITERATIONS_MAX {
        let mut step = damped_step(&here, damping);
        last_step = step.amax();
        if last_step > STEP_TRUSTED {
            step *= STEP_TRUSTED / last_step;
        }
        let next_parameters = &parameters + &step;
        let next = linearize(&next_parameters);
        let cost = here.residual.norm_squared();
        let model = &here.residual + &here.jacobian * &step;
        let predicted = cost - model.norm_squared();
        let gain = (cost - next.residual.norm_squared()) / predicted;
        // Once the predicted gain is lost in rounding, a small step is all that can be asked for.
        let at_rounding = predicted <= 1e-14 * cost;
        let within_noise = stop == Stop::WithinNoise
            && damping <= DAMPING_FREE
            && predicted <= GAIN_WITHIN_NOISE * cost / here.residual.len() as f64;
        if last_step <= STEP_MAX || (at_rounding && last_step <= 1e3 * STEP_MAX) || within_noise {
            return Ok(Minimum { parameters, linearized: here, iterations });
        }
        let usable = next.residual.iter().chain(next.jacobian.iter()).all(|v| v.is_finite());
        if gain > 0.0 && usable {
            parameters = next_parameters;
            here = next;
            damping *= (1.0 - (2.0 * gain - 1.0).powi(3)).max(1.0 / 3.0);
            growth = 2.0;
        } else {
            damping = (damping * growth).min(DAMPING_MAX);
            growth *= 2.0;
        }
    }
    let rms_residual = (here.residual.norm_squared() / here.residual.len() as f64).sqrt();
    Err(Error::FitNotConverged {
        iterations: ITERATIONS_MAX,
        relative_step: last_step,
        relative_step_max: STEP_MAX,
        rms_residual,
    })
}

/// Beyond this damping every step is below rounding.
const DAMPING_MAX: f64 = 1e30;
/// Bound on the iterations; a third-order fit takes 5 to 20.
const ITERATIONS_MAX: usize = 200;
/// A longer step is shortened to this: the linearisation of logarithms says nothing beyond a few factors of e.
const STEP_TRUSTED: f64 = 2.0;
/// A relative change of every parameter below this counts as converged.
const STEP_MAX: f64 = 1e-10;

/// Share of one residual's variance below which a gain is not worth another step.
const GAIN_WITHIN_NOISE: f64 = 1e-4;
/// A step damped by less than this is nearly that of Gauss and Newton.
const DAMPING_FREE: f64 = 1e-2;

fn damped_step(here: &Linearized, damping: f64) -> DVector<f64> {
    let (n_r, n_p) = here.jacobian.shape();
    let mut stacked = DMatrix::zeros(n_r + n_p, n_p);
    stacked.rows_mut(0, n_r).copy_from(&here.jacobian);
    for p in 0..n_p {
        // A column of zeros gets a unit weight, so that the step along it is zero and not undefined.
        let column = here.jacobian.column(p).norm();
        let scale = if column > 0.0 { column } else { 1.0 };
        stacked[(n_r + p, p)] = damping.sqrt() * scale;
    }
    let mut target = DVector::zeros(n_r + n_p);
    target.rows_mut(0, n_r).copy_from(&(-&here.residual));
    let qr = stacked.qr();
    let rhs = qr.q().tr_mul(&target);
    // The damping makes the triangle invertible.
    qr.r().solve_upper_triangular(&rhs).unwrap_or_else(|| DVector::zeros(n_p))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn oracle_rosenbrock_valley_ends_at_its_known_minimum() {
        let f = |p: &DVector<f64>| Linearized {
            residual: DVector::from_vec(vec![10.0 * (p[1] - p[0] * p[0]), 1.0 - p[0]]),
            jacobian: DMatrix::from_row_slice(2, 2, &[-20.0 * p[0], 10.0, -1.0, 0.0]),
        };
        let end = minimize(DVector::from_vec(vec![-1.2, 1.0]), Stop::AtTheMinimum, f).expect("converges");
        assert!((end.parameters[0] - 1.0).abs() < 1e-9 && (end.parameters[1] - 1.0).abs() < 1e-9);
        assert!(end.iterations < 60, "{}", end.iterations);
    }

    #[test]
    fn edge_a_residual_without_minimum_is_not_called_converged() {
        // exp(-p) falls for ever.
        let f = |p: &DVector<f64>| Linearized {
            residual: DVector::from_vec(vec![(-1e-3 * p[0]).exp()]),
            jacobian: DMatrix::from_element(1, 1, -1e-3 * (-1e-3 * p[0]).exp()),
        };
        assert!(matches!(
            minimize(DVector::zeros(1), Stop::AtTheMinimum, f),
            Err(Error::FitNotConverged { .. })
        ));
    }
}
