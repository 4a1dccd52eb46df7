//! Integration tests of the program.

mod command_line;
mod dependencies;
mod membrane;
mod solve;
mod study;
