//! Integration tests of the program.

mod command_line;
mod dependencies;
mod membrane;
mod membrane_calibrate;
mod membrane_motion;
mod membrane_optimize;
mod membrane_program;
mod membrane_refusals;
mod solve;
mod study;
