//! Uncertain systems: what is not known about a plant, how large it may be, and what it can do to the loop.
//!
//! The perturbation `Delta` is block-diagonal with a [`BlockStructure`]; the structured singular value says how large it
//! must be to make the loop around a matrix singular ([`mu_bounds`]), and [`mu_peak`] proves its peak on all frequencies. An
//! [`UncertainSystem`] has its margins and its worst gain from it. A [`ParametricSystem`] makes one from the ranges of physical
//! parameters, [`UncertainSystem::with_dynamics`] from a weight for what is not modelled.

mod affine_factor;
mod descriptor;
mod dynamics;
mod eigen;
mod hermitian;
mod interpolate;
mod lmi;
mod mu_bounds;
mod mu_lower;
mod mu_peak;
mod mu_upper;
mod parameters;
mod real_crossing;
mod scalings;
mod structure;
mod system;

pub use descriptor::DescriptorSystem;
pub use dynamics::UncertainDynamics;
pub use mu_bounds::{MuBounds, mu_bounds};
pub use mu_lower::{MuLower, MuLowerOptions};
pub use mu_peak::{MuPeak, mu_peak, mu_peak_discrete};
pub use mu_upper::{MuUpper, mu_upper_bound};
pub use parameters::{ParameterRange, ParametricSystem, RangeEnds};
pub use scalings::Scalings;
pub use structure::{Block, BlockStructure, BlockValue, Perturbation};
pub use system::{RobustMargin, UncertainSystem, WorstCaseGain};
