//! From a model and weights to a controller: H-infinity and H2 synthesis, loop shaping.
//!
//! [`makeweight`] makes weights, [`augw`] the generalized plant of a tracking problem; [`hinfsyn`] finds the controller that
//! makes its closed-loop norm nearly as small as any controller can, [`mixsyn`] does both. [`hinfsyn_discrete`] is its sampled
//! form, [`h2syn`] minimizes power under white noise instead of the peak gain, [`ncfsyn`] makes a shaped loop robust, and
//! [`hinf_state_feedback`] and [`hinf_full_information`] serve where the state is measured.

mod assumptions;
mod central_controller;
mod controller_gain;
mod controller_speed;
mod discrete;
pub mod dk;
mod full_information;
mod gamma_bracket;
mod h2syn;
mod hinfsyn;
mod measured_loop;
mod mixed_sensitivity;
mod ncfsyn;
mod normalized_plant;
pub mod pid;
mod pointwise_bound;
mod refined_controller;
mod regularize;
mod weight_shape;

pub use central_controller::Condition;
pub use discrete::{DiscreteHinfDesign, hinfsyn_discrete};
pub use full_information::{StaticHinfDesign, hinf_full_information, hinf_state_feedback};
pub use h2syn::{H2Design, h2syn};
pub use hinfsyn::{HinfDesign, HinfOptions, Regularization, Repaired, SingularProblem, hinfsyn};
pub use mixed_sensitivity::{
    LoopWeights, MixedSensitivityWeights, MixsynDesign, augw, mixed_sensitivity, mixsyn,
};
pub use ncfsyn::{LoopShape, NcfDesign, NcfMargin, ncfmargin, ncfsyn};
pub use weight_shape::{
    WeightShape, makeweight, makeweight_discrete, makeweight_state_space, sensitivity_weight,
};
