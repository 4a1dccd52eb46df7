//! A constant complex perturbation as a stable system that takes its value at one frequency.

use nalgebra::{DMatrix, dmatrix};
use num_complex::Complex64;
use telepulse_lti::{Continuous, StateSpace};

use super::structure::{Block, BlockStructure, BlockValue, Perturbation};
use crate::Error;

impl Perturbation {
    /// A stable system, no larger than this perturbation at any frequency, that agrees with it at `omega_rad_s`.
    ///
    /// **Method**: each complex entry is its size times a first-order all-pass of the phase wanted; of a full block the
    /// dominant dyad is kept, a column and a row of all-passes, whose gain is the same at every frequency.
    ///
    /// **Accuracy**: at zero and at infinity a system is real, so that only the nearer sign of a phase remains.
    ///
    /// **Errors**: [`Error::BlockMismatch`] where a value does not fit its block.
    pub fn interpolated(
        &self,
        structure: &BlockStructure,
        omega_rad_s: f64,
    ) -> Result<StateSpace<Continuous>, Error> {
        self.matrix(structure)?;
        let mut all: Option<StateSpace<Continuous>> = None;
        for (block, value) in structure.blocks().iter().zip(&self.values) {
            let own =
                match value {
                    BlockValue::Real(v) => StateSpace::<Continuous>::from_gain(
                        DMatrix::from_diagonal_element(block.rows(), block.rows(), *v),
                    )?,
                    BlockValue::Complex(v) => diagonal(&vec![*v; block.rows()], omega_rad_s)?,
                    BlockValue::Full(m) => dyad(m, omega_rad_s)?,
                };
            all = Some(match all {
                Some(before) => before.augment(&own)?,
                None => own,
            });
        }
        all.ok_or(Error::NoUncertainBlocks)
    }
}

/// One first-order section per entry.
fn diagonal(entries: &[Complex64], omega: f64) -> Result<StateSpace<Continuous>, Error> {
    let mut all: Option<StateSpace<Continuous>> = None;
    for &entry in entries {
        let own = all_pass(entry, omega)?;
        all = Some(match all {
            Some(before) => before.augment(&own)?,
            None => own,
        });
    }
    all.ok_or(Error::NoUncertainBlocks)
}

fn dyad(m: &DMatrix<Complex64>, omega: f64) -> Result<StateSpace<Continuous>, Error> {
    let gram = (m * m.adjoint()).symmetric_eigen();
    let u = gram.eigenvectors.column(gram.eigenvalues.imax()).into_owned();
    // uᴴ m is the size of the dyad times its row.
    let row: Vec<Complex64> = (m.adjoint() * &u).iter().map(Complex64::conj).collect();
    let right = diagonal(&row, omega)?;
    let left = diagonal(u.as_slice(), omega)?;
    let sum = StateSpace::<Continuous>::from_gain(DMatrix::from_element(u.len(), row.len(), 1.0))?;
    Ok(right.series(&sum)?.series(&left)?)
}

/// `|value|` times an all-pass of first order with the phase of `value` at `omega`.
fn all_pass(value: Complex64, omega: f64) -> Result<StateSpace<Continuous>, Error> {
    let (size, phase) = value.to_polar();
    let sign = if phase > 0.0 { -1.0 } else { 1.0 };
    // (a - s) / (a + s) turns by -2 atan(omega / a).
    let half = if phase > 0.0 { (std::f64::consts::PI - phase) / 2.0 } else { -phase / 2.0 };
    let corner = omega / half.tan();
    let is_plain = omega == 0.0 || !omega.is_finite() || half < PHASE_MIN || !corner.is_finite();
    if is_plain || std::f64::consts::FRAC_PI_2 - half < PHASE_MIN {
        let gain = if value.re < 0.0 { -size } else { size };
        return Ok(StateSpace::<Continuous>::from_gain(dmatrix![gain])?);
    }
    let root = (2.0 * corner).sqrt();
    let gain = sign * size;
    Ok(StateSpace::<Continuous>::new(
        dmatrix![-corner],
        dmatrix![root],
        dmatrix![gain * root],
        dmatrix![-gain],
    )?)
}

/// Phases closer to a sign than this are taken as the sign.
const PHASE_MIN: f64 = 1e-9;

/// The structure with a full block for the performance ports `(n_in, n_out)` behind its own.
pub(super) fn with_performance(
    structure: &BlockStructure,
    n_in: usize,
    n_out: usize,
) -> Result<BlockStructure, Error> {
    let performance = BlockStructure::new(vec![Block::Full { rows: n_in, cols: n_out }])?;
    Ok(structure.followed_by(&performance))
}
