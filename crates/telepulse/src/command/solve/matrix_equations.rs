//! `telepulse solve care` and `telepulse solve lyap`: Riccati, Lyapunov and Sylvester equations.

use anyhow::Result;
use serde::Serialize;
use telepulse_lti::{lyapunov, riccati};

use super::Answer;
use super::answer::{Rows, Status, Watch, pairs, system_status};
use super::input::{ProblemFile, Size};

#[derive(Serialize)]
#[allow(non_snake_case)]
pub(super) struct EquationAnswer {
    status: Status,
    /// The solution.
    X: Option<Rows>,
    /// Poles of the closed loop that the solution gives, pairs of real and imaginary part; Riccati only.
    #[serde(skip_serializing_if = "Option::is_none")]
    closed_loop_poles: Option<Vec<[f64; 2]>>,
    /// Norm of the equation's left-hand side over the sum of the norms of its terms.
    residual_relative: Option<f64>,
    message: String,
    seconds: f64,
}

impl EquationAnswer {
    fn unsolved(error: telepulse_lti::Error, seconds: f64) -> Result<Self> {
        let Some(status) = system_status(&error) else { return Err(error.into()) };
        let message = error.to_string();
        Ok(Self { status, X: None, closed_loop_poles: None, residual_relative: None, message, seconds })
    }
}

pub(super) fn riccati(file: &ProblemFile) -> Result<EquationAnswer> {
    let n = file.size("n")?;
    let a = file.matrix("A", n, n)?;
    let n = Size { value: Some(a.nrows()), ..n };
    let q = file.matrix("Q", n, n)?;
    let watch;
    let outcome = if file.has("G") {
        let g = file.matrix("G", n, n)?;
        watch = Watch::start();
        riccati::continuous(&a, &g, &q)
    } else {
        let b = file.matrix("B", n, file.size("m")?)?;
        let m = Size { name: "m", value: Some(b.ncols()) };
        let r = file.matrix("R", m, m)?;
        let s = file.matrix_or_zeros("S", n, m)?;
        watch = Watch::start();
        riccati::continuous_with_cross_term(&a, &b, &q, &r, &s)
    };
    let seconds = watch.seconds();
    match outcome {
        Ok(solution) => Ok(EquationAnswer {
            status: Status::Ok,
            X: Some((&solution.x).into()),
            closed_loop_poles: Some(pairs(&solution.closed_loop_poles)),
            residual_relative: Some(solution.residual_relative),
            message: String::new(),
            seconds,
        }),
        Err(error) => EquationAnswer::unsolved(error, seconds),
    }
}

pub(super) fn lyapunov(file: &ProblemFile) -> Result<EquationAnswer> {
    let n = file.size("n")?;
    let a = file.matrix("A", n, n)?;
    let n = Size { value: Some(a.nrows()), ..n };
    let q = file.matrix("Q", n, n)?;
    let watch = Watch::start();
    let outcome = match super::hinfnorm::sample_time(file)? {
        None => lyapunov::continuous(&a, &q),
        Some(_) => lyapunov::discrete(&a, &q),
    };
    let seconds = watch.seconds();
    match outcome {
        Ok(solution) => Ok(EquationAnswer {
            status: Status::Ok,
            X: Some((&solution.x).into()),
            closed_loop_poles: None,
            residual_relative: Some(solution.residual_relative),
            message: String::new(),
            seconds,
        }),
        Err(error) => EquationAnswer::unsolved(error, seconds),
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
