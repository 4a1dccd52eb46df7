//! `telepulse membrane`: the membrane's physics from case files.

mod calibrate;
mod calibration_case;
mod case;
mod optimize;
mod pareto_figure;
mod solve;

use anyhow::Result;
use clap::{Args, Subcommand};

use super::Verdict;

#[derive(Debug, Args)]
pub(super) struct MembraneArguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Debug, Subcommand)]
enum Task {
    /// Equilibrium of a membrane at a load and a voltage, with stiffness, capacitance and margins.
    Solve(solve::SolveArguments),
    /// Material parameters from sweeps, steps and creep, with their errors and what the records do not determine.
    Calibrate(calibrate::CalibrateArguments),
    /// Geometry, pre-stretch and load for stroke and bandwidth without failure; exit code 1 where no variant holds.
    Optimize(optimize::OptimizeArguments),
}

pub(super) fn run(typed: &MembraneArguments, json: bool) -> Result<Verdict> {
    match &typed.task {
        Task::Solve(typed) => solve::run(typed, json),
        Task::Calibrate(typed) => calibrate::run(typed, json),
        Task::Optimize(typed) => optimize::run(typed, json),
    }
}
