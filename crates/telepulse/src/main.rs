//! The `telepulse` program: parses, dispatches and maps the outcome to an exit code.
//!
//! 0: done; 1: a check failed (unstable, margin not met); 2: could not run.

use std::process::ExitCode;

use clap::Parser;
use telepulse::command::{self, Arguments, Verdict};

fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            // clap prints help to standard output with code 0 and mistakes to standard error with code 2.
            let code = if error.use_stderr() { 2 } else { 0 };
            let _ = error.print();
            return ExitCode::from(code);
        }
    };
    match command::run(arguments) {
        Ok(Verdict::Done) => ExitCode::SUCCESS,
        Ok(Verdict::CheckFailed) => ExitCode::from(1),
        Err(error) => {
            command::complain(&error);
            ExitCode::from(2)
        }
    }
}
