//! Systems with fewer states that respond (nearly) alike, and by how much they differ.
//!
//! - [`reduce()`]: balanced truncation and residualisation, with the bound and the measured error;
//! - [`split_stable`], [`block_diagonalize`]: additive decompositions;
//! - [`controllability_factor`], [`observability_factor`]: square roots of the Gramians.

mod balancing;
mod gramian_factor;
mod order;
mod split;
#[cfg(test)]
pub(crate) mod testing;
mod truncation;

pub use balancing::Projection;
pub use gramian_factor::{controllability_factor, observability_factor};
pub use order::{OrderRule, distinct_tail};
pub use split::{BlockDiagonal, StableSplit, block_diagonalize, split_stable};
pub use truncation::{ReduceOptions, Reduction, Removal, reduce};
