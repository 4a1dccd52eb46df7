//! From a model and weights to a controller: H-infinity synthesis.
//!
//! [`mixed_sensitivity`] builds the generalized plant of a tracking problem, [`hinfsyn`] finds the controller that
//! makes its closed-loop norm nearly as small as any controller can.

mod assumptions;
mod central_controller;
mod controller_gain;
mod controller_speed;
mod hinfsyn;
mod mixed_sensitivity;
mod normalized_plant;
pub mod pid;

pub use central_controller::Condition;
pub use hinfsyn::{HinfDesign, HinfOptions, Regularization, Repaired, SingularProblem, hinfsyn};
pub use mixed_sensitivity::{MixedSensitivityWeights, mixed_sensitivity};
