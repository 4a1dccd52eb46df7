//! Where real parameters alone bring a loop to its stability boundary.
//!
//! Such a place is a single frequency that no grid hits, and the structured singular value jumps there.

use nalgebra::DMatrix;
use num_complex::Complex64;
use telepulse_lti::{Continuous, StateSpace, hinf_norm};

use super::mu_lower::MuLower;
use super::structure::{BlockStructure, BlockValue, Perturbation};
use crate::Error;

/// A perturbation of real parameters with which the loop has a pole on the axis.
pub(super) struct Crossing {
    pub(super) omega_rad_s: f64,
    pub(super) lower: MuLower,
}

/// The smallest crossings along the diagonals and, up to four parameters, the axes and half diagonals of the box; smallest first.
///
/// **Method**: the size of the perturbation grows geometrically from the small-gain bound until a pole is unstable, and bisection
/// finds where. A pole that crosses and returns between two sizes is missed: the examples are examples, no proof.
///
/// **Errors**: those of [`hinf_norm`]; [`Error::BlockMismatch`] never for blocks of this structure.
pub(super) fn real_crossings(
    sys: &StateSpace<Continuous>,
    structure: &BlockStructure,
) -> Result<Vec<Crossing>, Error> {
    let n = structure.blocks().len();
    if n > PARAMETERS_MAX || sys.n_states() == 0 || structure.blocks().iter().any(|b| !b.is_real()) {
        return Ok(vec![]);
    }
    let norm = hinf_norm(sys)?.upper;
    if norm <= 0.0 {
        return Ok(vec![]);
    }
    let digits: &[f64] = if n <= AXES_MAX { &[-1.0, 1.0, 0.0] } else { &[-1.0, 1.0] };
    let mut found = Vec::new();
    for code in 0..digits.len().pow(n as u32) {
        let direction: Vec<f64> =
            (0..n).map(|i| digits[code / digits.len().pow(i as u32) % digits.len()]).collect();
        if direction.iter().all(|&d| d == 0.0) {
            continue;
        }
        let direction = Perturbation { values: direction.into_iter().map(BlockValue::Real).collect() };
        found.extend(along(sys, structure, &direction, 1.0 / norm)?);
    }
    found.sort_by(|x, y| y.lower.value.total_cmp(&x.lower.value));
    found.truncate(CROSSINGS_MAX);
    Ok(found)
}

/// The smallest crossing on one ray.
fn along(
    sys: &StateSpace<Continuous>,
    structure: &BlockStructure,
    direction: &Perturbation,
    start: f64,
) -> Result<Option<Crossing>, Error> {
    let delta = direction.matrix(structure)?.map(|v| v.re);
    let rightmost = |size: f64| -> Option<Complex64> {
        let delta = &delta * size;
        let inner = (DMatrix::identity(delta.nrows(), delta.nrows()) - &delta * sys.d()).try_inverse()?;
        let closed = sys.a() + sys.b() * inner * delta * sys.c();
        let poles = closed.complex_eigenvalues();
        poles.iter().copied().max_by(|x, y| x.re.total_cmp(&y.re))
    };
    let mut stable = start * (1.0 - f64::EPSILON);
    let mut unstable = None;
    for step in 0..GROWTH_STEPS {
        let size = start * GROWTH.powi(step);
        match rightmost(size) {
            Some(pole) if pole.re < 0.0 => stable = size,
            Some(_) => {
                unstable = Some(size);
                break;
            }
            None => return Ok(None),
        }
    }
    let Some(mut unstable) = unstable else { return Ok(None) };
    for _ in 0..BISECTIONS_MAX {
        let middle = f64::midpoint(stable, unstable);
        if middle <= stable || middle >= unstable {
            break;
        }
        match rightmost(middle) {
            Some(pole) if pole.re < 0.0 => stable = middle,
            Some(_) => unstable = middle,
            None => return Ok(None),
        }
    }
    let Some(pole) = rightmost(unstable) else { return Ok(None) };
    // A pole at the origin, but for rounding, crosses there.
    let omega_rad_s = if pole.im.abs() <= AT_REST * sys.a().norm() { 0.0 } else { pole.im.abs() };
    let perturbation = direction.scaled(unstable);
    let Ok(response) = sys.at(omega_rad_s) else { return Ok(None) };
    let size = response.nrows();
    let distance = DMatrix::identity(size, size) - response * perturbation.matrix(structure)?;
    let residual = distance.singular_values().min();
    if residual.is_nan() || residual >= RESIDUAL_MAX {
        return Ok(None);
    }
    let lower = MuLower { value: 1.0 / perturbation.norm(), perturbation: Some(perturbation), residual };
    Ok(Some(Crossing { omega_rad_s, lower }))
}

/// Parameters up to which all diagonals are looked at.
const PARAMETERS_MAX: usize = 8;
/// Parameters up to which faces and axes are, too.
const AXES_MAX: usize = 4;
/// Crossings that are worth a proof of their own.
const CROSSINGS_MAX: usize = 4;
/// Sizes of the perturbation, from one over the norm to 10 000 times that.
const GROWTH: f64 = 1.2;
const GROWTH_STEPS: i32 = 51;
const BISECTIONS_MAX: usize = 80;
/// Frequency that is zero but for rounding, relative to the state matrix.
const AT_REST: f64 = 1e-12;
/// Largest distance from singularity of an example; rounding is far below for poles that move with the parameters.
const RESIDUAL_MAX: f64 = 1e-6;
