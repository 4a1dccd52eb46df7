//! A nonlinear model of an actuator's motion, with the structure of the physics and the numbers of a record.
//!
//! ```text
//!   voltage --> circuit (rc) --> square --> w --+--> [ plate on a nonlinear spring, pulled by w ] --> x
//!                                               |          ^ creep branches pull back
//! ```
//!
//! - [`GreyBoxExperiment`]: the drive that shows all of it: steps over the stroke, then random-phase multisines;
//! - [`fit_grey_box`]: the model whose simulation comes closest to the record, with standard errors;
//! - [`GreyBoxModel`]: what the feedforward inverts.

mod experiment;
mod fit;
mod model;
mod sensitivity;

pub use experiment::{GreyBoxExperiment, GreyBoxExperimentOptions};
pub use fit::{GreyBoxFit, GreyBoxFitOptions, GreyBoxRecord, fit_grey_box};
pub use model::{CreepBranch, GreyBoxModel, GreyBoxState, PullTerm};
