//! Certification of a loop: is it stable for every plant inside the uncertainty bound, and with what margins.

mod certificate;
mod disk_margin;
mod loop_transfers;

pub use certificate::{Certificate, LoopUnderTest, verify};
pub use disk_margin::{DiskMargin, GainInterval, disk_margin, disk_margins_one_at_a_time};
