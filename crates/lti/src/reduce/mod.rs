//! Systems with fewer states that respond (nearly) alike, and by how much they differ.
//!
//! - [`reduce()`]: balanced truncation and residualisation, with the bound and the measured error;
//! - [`hankel_approximation`]: the least Hankel norm of the error; [`reduce_weighted`]: an error that is small where it counts;
//! - [`minimal_realization`]: without what no port sees, stable or not;
//! - [`split_stable`], [`block_diagonalize`]: additive decompositions;
//! - [`controllability_factor`], [`observability_factor`]: square roots of the Gramians;
//! - [`hankel_singular_values`]: how much each state counts.

mod balancing;
mod gramian_factor;
mod hankel_approximation;
mod jacobi_svd;
mod minimal;
mod order;
mod split;
#[cfg(test)]
pub(crate) mod testing;
mod truncation;
mod weighted;

pub use balancing::Projection;
pub use gramian_factor::{controllability_factor, observability_factor};
pub use hankel_approximation::{HankelApproximation, hankel_approximation};
pub use minimal::{MinimalRealization, minimal_realization};
pub use order::{OrderRule, distinct_tail};
pub use split::{BlockDiagonal, StableSplit, block_diagonalize, split_stable};
pub use truncation::{ReduceOptions, Reduction, Removal, hankel_singular_values, reduce};
pub use weighted::{WeightedReduction, Weights, reduce_weighted};
