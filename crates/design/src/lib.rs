//! Everything that is done at the desk: from a sweep to a certified controller, ready to run.
//!
//! The stages are modules, in the order of the work:
//!
//! - [`identify`]: plan a stepped-sine sweep, extract its lines, fit a model, bound its error;
//! - [`synthesize`]: find the controller with the least weighted closed-loop norm;
//! - [`uncertain`]: structured uncertainty around a plant, the structured singular value and what follows from it;
//! - [`verify`]: certify a loop against every plant inside the bound;
//! - [`implement`]: turn a controller into what a real-time loop runs.
//!
//! Nothing here touches a rig, a file or a clock. Experiments are planned as numbers, and measurements come in as
//! numbers, whoever measured them.

mod error;
pub mod identify;
pub mod implement;
pub mod synthesize;
pub mod uncertain;
pub mod verify;

pub use error::Error;

/// Result of every stage.
pub type Result<T> = std::result::Result<T, Error>;

/// The examples of the manual, compiled and run.
#[cfg(doctest)]
#[doc = include_str!("../../../docs/manual/robust.md")]
struct RobustManual;
