//! Integration tests of the program.

mod dependencies;
