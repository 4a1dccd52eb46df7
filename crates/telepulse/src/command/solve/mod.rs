//! `telepulse solve`: the library's solvers on a problem file, for any tool that can write JSON.
//!
//! An answer with another status than `ok` is still an answer: it is printed, and the exit code is 1. A file that
//! cannot be read is refused with exit code 2 and one message that names file, key and sizes.

mod answer;
mod hinfnorm;
mod hinfsyn;
mod input;
mod matrix_equations;
mod mu;
mod pid;
mod reduce;

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, ValueEnum};
use serde::Serialize;

use self::answer::Status;
use self::input::ProblemFile;
use super::Verdict;

#[derive(Debug, Args)]
pub(super) struct SolveArguments {
    /// What to solve.
    problem: Problem,
    /// Problem as JSON; `-` for standard input. docs/manual/robust.md lists the keys.
    file: PathBuf,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Problem {
    /// H-infinity output feedback for the plant A, B1, B2, C1, C2, D11, D12, D21, D22; discrete with dt.
    Hinfsyn,
    /// H-infinity norm of A, B, C, D; discrete with dt.
    Hinfnorm,
    /// Algebraic Riccati equation A, B, Q, R, S or A, G, Q; discrete with dt.
    Care,
    /// Lyapunov equation A, Q, or Sylvester equation A, B, C; discrete with dt.
    Lyap,
    /// Bounds of the structured singular value of M, M_imaginary for blocks; of its peak for A, B, C, D, discrete with dt.
    Mu,
    /// A system A, B, C, D with fewer states; discrete with dt.
    Reduce,
    /// PID controller for the plant numerator, denominator, delay_s.
    Pid,
}

pub(super) fn run(typed: &SolveArguments, json: bool) -> Result<Verdict> {
    let file = ProblemFile::read(&typed.file)?;
    file.refuse_mistaken(typed.problem.keys(), &OPTION_KEYS)?;
    match typed.problem {
        Problem::Hinfsyn => finish(json, typed.problem, &file, hinfsyn::solve(&file)?),
        Problem::Hinfnorm => finish(json, typed.problem, &file, hinfnorm::solve(&file)?),
        Problem::Care => finish(json, typed.problem, &file, matrix_equations::riccati(&file)?),
        Problem::Lyap => finish(json, typed.problem, &file, matrix_equations::lyapunov(&file)?),
        Problem::Mu => finish(json, typed.problem, &file, mu::solve(&file)?),
        Problem::Reduce => finish(json, typed.problem, &file, reduce::solve(&file)?),
        Problem::Pid => finish(json, typed.problem, &file, pid::solve(&file)?),
    }
}

/// An answer that can be printed either way.
trait Answer: Serialize {
    fn status(&self) -> Status;
    /// The same facts for a person.
    fn lines(&self) -> Vec<String>;
}

fn finish<A: Answer>(json: bool, problem: Problem, file: &ProblemFile, answer: A) -> Result<Verdict> {
    // A key of this problem, but not beside the others of the file; what is no key of it belongs to a collection.
    if let Some(key) = file.unread().iter().find(|key| problem.keys().contains(&key.as_str())) {
        return Err(file.complaint(key, "has no meaning beside the other keys of the file"));
    }
    super::answer(json, &answer, || answer.lines())?;
    Ok(if answer.status() == Status::Ok { Verdict::Done } else { Verdict::CheckFailed })
}

impl Problem {
    /// The keys that mean something in it.
    fn keys(self) -> &'static [&'static str] {
        match self {
            Self::Hinfsyn => &[
                "A", "B1", "B2", "C1", "C2", "D11", "D12", "D21", "D22", "n", "nw", "nu", "nz", "ny", "dt",
                "options",
            ],
            Self::Hinfnorm => &["A", "B", "C", "D", "n", "m", "p", "dt"],
            Self::Care => &["A", "B", "G", "Q", "R", "S", "n", "m", "dt"],
            Self::Lyap => &["A", "B", "C", "Q", "n", "m", "dt"],
            Self::Mu => &["A", "B", "C", "D", "M", "M_imaginary", "blocks", "n", "m", "p", "dt", "options"],
            Self::Reduce => {
                &["A", "B", "C", "D", "n", "m", "p", "dt", "input_weight", "output_weight", "options"]
            }
            Self::Pid => &["numerator", "denominator", "delay_s", "options"],
        }
    }
}

/// Keys that change an answer in one kind of problem: in another one they would be ignored silently.
const OPTION_KEYS: [&str; 4] = ["options", "blocks", "input_weight", "output_weight"];
