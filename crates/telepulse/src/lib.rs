//! From a dielectric-elastomer diaphragm's physics to a certified H-infinity controller and a replayed pulse.
//!
//! The stages are crates, re-exported here; this crate is the program around them: commands, studies, the two
//! stations of the link, figures and the report. It is the only place with arguments, files, threads and printing.

pub mod artefact;
pub mod command;
pub mod figure;
pub mod recording;
pub mod report;
pub mod station;
pub mod study;

pub use telepulse_actuator as actuator;
pub use telepulse_design as design;
pub use telepulse_link as link;
pub use telepulse_lti as lti;
pub use telepulse_pulse as pulse;
pub use telepulse_rt as rt;

/// Version of the program.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
