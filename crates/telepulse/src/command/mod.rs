//! The stages of the work as subcommands. Each reads files and writes files; none needs another in the same process.

mod design;
mod identify;
mod membrane;
mod pulse;
mod receive;
mod relay;
mod replay;
mod report;
mod send;
mod solve;
mod study;
mod track;
mod verify;

use std::io::{ErrorKind, Write};
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use serde::Serialize;

/// Takes a dielectric-elastomer diaphragm actuator from physics to a certified H-infinity controller and replays a
/// patient's wrist pulse with it. Without a subcommand: `telepulse study run studies/diaphragm-2017`.
#[derive(Debug, Parser)]
#[command(name = "telepulse", version, propagate_version = true)]
pub struct Arguments {
    #[command(subcommand)]
    stage: Option<Stage>,
    /// Print the results as JSON on standard output.
    #[arg(long, global = true)]
    json: bool,
    /// Folder for the results; `out` unless given. The study's name is added to it.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

#[derive(Debug, Subcommand)]
enum Stage {
    /// Run a study, or start a new one.
    Study(study::StudyArguments),
    /// Identify a plant and the bound of its uncertainty, from the virtual rig or from a sweep of your own.
    Identify(identify::IdentifyArguments),
    /// Synthesize an H-infinity controller for an identified plant or a plant of your own.
    Design(design::DesignArguments),
    /// Certify a controller against a plant and its uncertainty bound; exit code 1 where it does not hold.
    Verify(verify::VerifyArguments),
    /// Run a controller on the virtual rig against a reference from a file.
    Track(track::TrackArguments),
    /// Find where the loop would oscillate, with a relay on the virtual rig, and make a PID controller from it.
    Relay(relay::RelayArguments),
    /// Solve a problem of robust control given as a file: synthesis, norms, matrix equations.
    Solve(solve::SolveArguments),
    /// Look at the membrane's physics: equilibria from case files.
    Membrane(membrane::MembraneArguments),
    /// Look at a pulse recording.
    Pulse(pulse::PulseArguments),
    /// Patient's side: send a recording.
    Send(send::SendArguments),
    /// Doctor's side: receive a recording, and replay it if asked.
    Receive(receive::ReceiveArguments),
    /// Replay a pulse recording on the virtual rig, in displacement or force mode.
    Replay(replay::ReplayArguments),
    /// Make the report of a finished study anew.
    Report(report::ReportArguments),
}

/// How a command that could run has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// Done.
    Done,
    /// A check failed: unstable, or a margin not met.
    CheckFailed,
}

/// Runs the stage that was asked for.
///
/// # Errors
/// When the stage could not run; the chain of causes names file, key or line.
pub fn run(arguments: Arguments) -> Result<Verdict> {
    let json = arguments.json;
    let Some(stage) = arguments.stage else {
        return study::run_default(arguments.out, json);
    };
    anyhow::ensure!(
        arguments.out.is_none(),
        "`--out` before a subcommand has no meaning: write it after the subcommand"
    );
    match stage {
        Stage::Study(typed) => study::run(typed, json),
        Stage::Identify(typed) => identify::run(&typed, json),
        Stage::Design(typed) => design::run(&typed, json),
        Stage::Verify(typed) => verify::run(&typed, json),
        Stage::Track(typed) => track::run(&typed, json),
        Stage::Relay(typed) => relay::run(&typed, json),
        Stage::Solve(typed) => solve::run(&typed, json),
        Stage::Membrane(typed) => membrane::run(&typed, json),
        Stage::Pulse(typed) => pulse::run(&typed, json),
        Stage::Send(typed) => send::run(&typed, json),
        Stage::Receive(typed) => receive::run(&typed, json),
        Stage::Replay(typed) => replay::run(&typed, json),
        Stage::Report(typed) => report::run(&typed, json),
    }
}

/// Prints an error with its causes, one line, to standard error.
pub fn complain(error: &anyhow::Error) {
    let line = format!("{error:#}").lines().map(str::trim).collect::<Vec<_>>().join("; ");
    let _ = writeln!(std::io::stderr(), "telepulse: {line}");
}

/// Prints a line of progress or notice to standard error.
fn notify(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// Prints results to standard output: as JSON, or as the lines given.
fn answer<T: Serialize>(json: bool, value: &T, lines: impl FnOnce() -> Vec<String>) -> Result<()> {
    let mut text = if json { serde_json::to_string_pretty(value)? } else { lines().join("\n") };
    text.push('\n');
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        // Whoever reads has had enough, as `head` does: the work is done all the same.
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        written => written.context("cannot write to standard output"),
    }
}
