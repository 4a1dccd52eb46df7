//! `telepulse membrane`: the membrane's physics from case files.

mod case;
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
}

pub(super) fn run(typed: &MembraneArguments, json: bool) -> Result<Verdict> {
    match &typed.task {
        Task::Solve(typed) => solve::run(typed, json),
    }
}
