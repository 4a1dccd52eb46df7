//! Certification of a loop: is it stable for every plant inside the uncertainty bound, and with what margins.

mod certificate;
mod loop_transfers;

pub use certificate::{Certificate, LoopUnderTest, verify};
