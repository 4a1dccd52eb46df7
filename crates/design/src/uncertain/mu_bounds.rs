//! Both bounds of the structured singular value of one matrix.

use nalgebra::DMatrix;
use num_complex::Complex64;

use super::mu_lower::{MuLower, MuLowerOptions, search};
use super::mu_upper::{MuUpper, mu_upper_bound};
use super::structure::BlockStructure;
use crate::Error;

/// The structured singular value of a matrix, bracketed by a proof and an example.
#[derive(Clone, Debug, PartialEq)]
pub struct MuBounds {
    /// The example: a perturbation that makes the loop singular.
    pub lower: MuLower,
    /// The proof: scales that rule out every smaller one.
    pub upper: MuUpper,
}

/// Returns both bounds of the structured singular value of `m`.
///
/// ```text
///   mu(M) = 1 / min { |Delta| : det(I - M Delta) = 0, Delta in the structure },    0 where there is none
/// ```
///
/// **Shapes**: `m` is `n_z × n_w` as in [`BlockStructure`].
///
/// **Method**: [`mu_upper_bound`] first. Its dual solution holds the directions in which the bound is attained, and the search
/// for a perturbation starts there; power iterations from random starts follow unless the bounds already meet. With
/// real parameters an eigenvalue of `M Delta` is then made real and pushed up along parameters and phases.
///
/// **Source**: Packard and Doyle 1993, Automatica 29(1); Young and Doyle 1990, Proc. 29th CDC.
///
/// **Accuracy**: the upper bound as in [`mu_upper_bound`]. The lower bound is valid to rounding, but a local search:
/// with three or fewer full complex blocks it usually meets the upper bound to `1e-7`; for real parameters alone it may be
/// far below and is zero where nothing was found.
///
/// **Errors**: as [`mu_upper_bound`].
///
/// **Example**
/// ```
/// use nalgebra::dmatrix;
/// use num_complex::Complex64;
/// use telepulse_design::uncertain::{Block, BlockStructure, MuLowerOptions, mu_bounds};
/// let m = dmatrix![0.0, 4.0; 1.0, 0.0].map(|v| Complex64::new(v, 0.0));
/// let structure = BlockStructure::new(vec![Block::Full { rows: 1, cols: 1 }; 2])?;
/// let bounds = mu_bounds(&m, &structure, &MuLowerOptions::default())?;
/// assert!((bounds.upper.value - 2.0).abs() < 1e-8 && (bounds.lower.value - 2.0).abs() < 1e-8);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn mu_bounds(
    m: &DMatrix<Complex64>,
    structure: &BlockStructure,
    options: &MuLowerOptions,
) -> Result<MuBounds, Error> {
    let upper = mu_upper_bound(m, structure)?;
    let lower = search(m, structure, Some(&upper.directions), upper.value, options)?;
    Ok(MuBounds { lower, upper })
}
