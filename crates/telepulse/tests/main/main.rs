//! Integration tests of the program.

mod command_line;
mod dependencies;
mod solve;
mod study;
