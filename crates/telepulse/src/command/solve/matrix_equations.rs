//! `telepulse solve care` and `telepulse solve lyap`: Riccati, Lyapunov and Sylvester equations.

use anyhow::Result;
use nalgebra::DMatrix;
use serde::Serialize;
use telepulse_lti::riccati::{SecondRoute, Terms, care, dare};
use telepulse_lti::{lyapunov, riccati, sylvester};

use super::Answer;
use super::answer::{Rows, Status, Watch, pairs, system_status};
use super::input::{ProblemFile, Size};

#[derive(Serialize)]
#[allow(non_snake_case)]
pub(super) struct EquationAnswer {
    status: Status,
    /// The solution.
    X: Option<Rows>,
    /// The feedback `K` of `u = -K x`; Riccati equations given by `B` and `R` only.
    #[serde(skip_serializing_if = "Option::is_none")]
    gain: Option<Rows>,
    /// Poles of the closed loop that the solution gives, pairs of real and imaginary part; Riccati only.
    #[serde(skip_serializing_if = "Option::is_none")]
    closed_loop_poles: Option<Vec<[f64; 2]>>,
    /// Norm of the equation's left-hand side over the sum of the norms of its terms, both in the balanced coordinates in which the
    /// equation was solved.
    residual_relative: Option<f64>,
    /// Estimate of the relative change of the solution over a relative change of the terms.
    condition: Option<f64>,
    message: String,
    seconds: f64,
}

impl EquationAnswer {
    fn solved(x: &DMatrix<f64>, residual_relative: f64, condition: f64, watch: &Watch) -> Self {
        Self {
            status: Status::Ok,
            X: Some(x.into()),
            gain: None,
            closed_loop_poles: None,
            residual_relative: Some(residual_relative),
            condition: condition.is_finite().then_some(condition),
            message: String::new(),
            seconds: watch.seconds(),
        }
    }

    fn unsolved(error: telepulse_lti::Error, seconds: f64) -> Result<Self> {
        let Some(status) = system_status(&error) else { return Err(error.into()) };
        Ok(Self {
            status,
            X: None,
            gain: None,
            closed_loop_poles: None,
            residual_relative: None,
            condition: None,
            message: error.to_string(),
            seconds,
        })
    }
}

pub(super) fn riccati(file: &ProblemFile) -> Result<EquationAnswer> {
    let (a, n) = file.state_count(&["Q", "B", "G"])?;
    let q = file.matrix("Q", n, n)?;
    let sample_time = super::hinfnorm::sample_time(file)?;
    if file.has("G") {
        if sample_time.is_some() {
            return Err(file.complaint("G", "has no meaning with `dt`: give `B` and `R`"));
        }
        let g = file.matrix("G", n, n)?;
        let watch = Watch::start();
        return match riccati::continuous(&a, &g, &q) {
            Ok(solution) => Ok(EquationAnswer {
                closed_loop_poles: Some(pairs(&solution.closed_loop_poles)),
                ..EquationAnswer::solved(&solution.x, solution.residual_relative, solution.condition, &watch)
            }),
            Err(error) => EquationAnswer::unsolved(error, watch.seconds()),
        };
    }
    let b = file.matrix("B", n, file.size("m")?)?;
    let m = Size { name: "m, by `B`", value: Some(b.ncols()) };
    let (r, s) = (file.matrix("R", m, m)?, file.matrix_or_zeros("S", n, m)?);
    let terms = Terms { a: &a, b: &b, q: &q, r: &r, s: Some(&s) };
    let watch = Watch::start();
    let outcome = match sample_time {
        None => care(&terms, SecondRoute::IfNeeded),
        Some(_) => dare(&terms, SecondRoute::IfNeeded),
    };
    match outcome {
        Ok(solution) => Ok(EquationAnswer {
            gain: Some((&solution.gain).into()),
            closed_loop_poles: Some(pairs(&solution.closed_loop_poles)),
            message: format!("route: {:?}; the gain is that of u = -K x", solution.route),
            ..EquationAnswer::solved(&solution.x, solution.residual_relative, solution.condition, &watch)
        }),
        Err(error) => EquationAnswer::unsolved(error, watch.seconds()),
    }
}

/// `A X + X A' + Q = 0`, or with `B` and `C` instead of `Q` the Sylvester equation `A X + X B + C = 0`; discrete:
/// `A X A' - X + Q = 0`, `A X B - X + C = 0`.
pub(super) fn lyapunov(file: &ProblemFile) -> Result<EquationAnswer> {
    let (a, n) = file.state_count(&[])?;
    let is_discrete = super::hinfnorm::sample_time(file)?.is_some();
    let (outcome, watch) = if file.has("B") {
        if file.has("Q") {
            return Err(file.complaint("B", "belongs to a Sylvester equation, which has `C` and no `Q`"));
        }
        let m = file.size("m")?;
        let b = file.matrix("B", m, m)?;
        let c = file.matrix("C", n, Size { name: "m", value: Some(b.nrows()) })?;
        let watch = Watch::start();
        let solution =
            if is_discrete { sylvester::discrete(&a, &b, &c) } else { sylvester::continuous(&a, &b, &c) };
        (solution.map(|s| (s.x, s.residual_relative, s.condition)), watch)
    } else {
        let q = file.matrix("Q", n, n)?;
        let watch = Watch::start();
        let solution = if is_discrete { lyapunov::discrete(&a, &q) } else { lyapunov::continuous(&a, &q) };
        (solution.map(|s| (s.x, s.residual_relative, s.condition)), watch)
    };
    match outcome {
        Ok((x, residual, condition)) => Ok(EquationAnswer::solved(&x, residual, condition, &watch)),
        Err(error) => EquationAnswer::unsolved(error, watch.seconds()),
    }
}

impl Answer for EquationAnswer {
    fn status(&self) -> Status {
        self.status
    }

    fn lines(&self) -> Vec<String> {
        match (&self.X, self.residual_relative) {
            (Some(x), Some(residual)) => {
                let mut lines = x.lines();
                lines.push(format!("relative residual {residual:e}"));
                lines
            }
            _ => vec![self.message.clone()],
        }
    }
}
