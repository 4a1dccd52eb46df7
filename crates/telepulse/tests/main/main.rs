//! Integration tests of the program.

mod command_line;
mod dependencies;
mod membrane;
mod membrane_calibrate;
mod membrane_motion;
mod membrane_optimize;
mod solve;
mod study;
