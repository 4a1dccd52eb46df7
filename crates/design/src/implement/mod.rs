//! From a controller to what runs.
//!
//! - [`realize_continuous`], [`realize_discrete`]: modes that a real-time loop advances one by one;
//! - [`reduce_controller`]: fewer states, shown on the closed loop to be enough;
//! - [`forms`]: the forms that a controller can run in, and the error of each in single and double precision;
//! - [`PidSettings`]: the other kind of law;
//! - [`preview_feedforward`]: drive from a reference that is known ahead; [`StaticInverse`]: from a measured curve;
//! - [`ControllerRecipe`]: all of it in one file, with the evidence that the law may run.

mod controller_order;
mod feedforward;
mod flat_feedforward;
mod flat_stepper;
pub mod forms;
mod held_feedforward;
mod modal_delta;
mod pid;
mod preview;
mod preview_smoother;
mod realize;
mod recipe;
mod reference_governor;
mod static_inverse;

pub use controller_order::{ControllerRoute, OrderTried, ReducedController, reduce_controller};
pub use feedforward::Feedforward;
pub use flat_feedforward::{AHEAD, FlatDrive, FlatFeedforward, GOVERNED_FROM_S, RECOVERY_RAD_S};
pub use flat_stepper::{FlatStepper, PlantChange};
pub use held_feedforward::HeldFeedforward;
pub use modal_delta::{ComplexMode, ModalDelta, RealMode};
pub use pid::PidSettings;
pub use preview::{
    PreviewFeedforward, PreviewOptions, TAIL_MAX, preview_feedforward, transition_for_horizon_hz,
};
pub use preview_smoother::{PreviewSmoother, SmootherOptions, preview_smoother};
pub use realize::{Discretization, Realization, realize_continuous, realize_discrete};
pub use recipe::{
    AntiWindup, CertifiedLoop, ControllerRecipe, DriveLimits, Law, OperatingPoint, Provenance,
    RecipeSettings, ReferencePath, SetpointWeights,
};
pub use static_inverse::StaticInverse;
