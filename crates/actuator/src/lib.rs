//! What the device is: material, membrane, circuit, equilibrium, linearisation, reduced twin, virtual rig, calibration.

pub mod batch;
pub mod calibration;
pub mod collocation;
pub mod design_study;
mod error;
pub mod failure;
pub mod field;
pub mod frequency;
pub mod linearize;
pub mod material;
pub mod membrane;
mod parameters;
pub mod rig;
pub mod sensing;
pub mod statics;
pub mod twin;
pub mod variation;

pub use error::Error;
pub use parameters::{
    ActuatorParameters, ActuatorSpec, MAX_BRANCHES, MaxwellBranch, ParameterSet, VACUUM_PERMITTIVITY_F_PER_M,
};
