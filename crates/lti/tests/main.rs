//! The integration tests of the crate, in one binary.
#![allow(clippy::unwrap_used)]

mod oracle;
mod paper;
mod solutions;
