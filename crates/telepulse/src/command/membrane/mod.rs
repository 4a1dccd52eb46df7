//! `telepulse membrane`: the membrane's physics from case files.

mod calibrate;
mod calibration_case;
mod case;
mod drive;
mod failure;
mod figures;
mod judged;
mod map;
mod motion_case;
mod optimize;
mod pareto_figure;
mod simulate;
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
    /// Force, capacitance, stiffness and dF/dV over displacement and voltage.
    Map(map::MapArguments),
    /// What ends the membrane: margins, voltages at which it sets in, a map over load and voltage, limits for a supervisor.
    Failure(failure::FailureArguments),
    /// Motion of plate and membrane under a drive, alone or with scattered parameters.
    Simulate(simulate::SimulateArguments),
}

pub(super) fn run(typed: &MembraneArguments, json: bool) -> Result<Verdict> {
    match &typed.task {
        Task::Solve(typed) => solve::run(typed, json),
        Task::Calibrate(typed) => calibrate::run(typed, json),
        Task::Optimize(typed) => optimize::run(typed, json),
        Task::Map(typed) => map::run(typed, json),
        Task::Failure(typed) => failure::run(typed, json),
        Task::Simulate(typed) => simulate::run(typed, json),
    }
}
