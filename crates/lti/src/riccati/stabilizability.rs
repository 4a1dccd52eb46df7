//! Which unstable mode no input reaches.

use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;

use super::refinement::Scaled;
use crate::Error;
use crate::eigenvalues::eigenvalues;
use crate::triangular_equation::Kind;

/// The error that names a mode on or beyond the stability boundary that no input reaches, if there is one.
///
/// **Source**: the test of Popov, Belevitch and Hautus at every such eigenvalue.
pub(super) fn unreached_mode(equation: &Scaled) -> Option<Error> {
    let Scaled { a, b, kind, .. } = equation;
    let (n, m) = b.shape();
    let size = a.norm().max(f64::MIN_POSITIVE);
    let modes = eigenvalues(a).ok()?.into_iter().filter(|mode| match kind {
        Kind::Continuous => mode.re > -BOUNDARY * size,
        Kind::Discrete => mode.norm() > 1.0 - BOUNDARY,
    });
    // Columns of B of like size, so that a weak input still counts as one.
    let norms = DVector::from_fn(m, |j, _| b.column(j).norm());
    for pole in modes.filter(|mode| mode.im >= 0.0) {
        let test = DMatrix::from_fn(n, n + m, |i, j| {
            if j < n {
                let shift = if i == j { pole } else { Complex64::ZERO };
                (Complex64::from(a[(i, j)]) - shift) / size
            } else if norms[j - n] > 0.0 {
                Complex64::from(b[(i, j - n)] / norms[j - n])
            } else {
                Complex64::ZERO
            }
        });
        let smallest_singular_value = test.singular_values().min();
        if smallest_singular_value < UNREACHED * n as f64 {
            return Some(Error::NotStabilizable { pole, smallest_singular_value });
        }
    }
    None
}

/// Modes this close to the stability boundary, relative to the size of `A`, count as on it.
const BOUNDARY: f64 = 1e-9;
/// Singular values below this, per state, are rounding.
const UNREACHED: f64 = 1e-14;
