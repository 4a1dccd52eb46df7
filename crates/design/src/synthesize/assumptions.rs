//! What a plant must satisfy for the H-infinity problem to have an answer, tested mode by mode.

use nalgebra::DMatrix;
use num_complex::Complex64;
use telepulse_lti::eigenvalues::eigenvalues;

use super::normalized_plant::NormalizedPlant;
use crate::Error;

/// How small a singular value has to be to count as zero.
#[derive(Clone, Copy)]
pub(super) enum Strictness {
    /// At rounding: refuses only what is certainly violated. For use before the search.
    Certain,
    /// At a thousand times that: names the likely cause of a search that found nothing.
    Likely,
}

/// Checks stabilizability, detectability and the absence of zeros on the imaginary axis.
///
/// **Method**: Popov-Belevitch-Hautus tests at the eigenvalues that matter: the unstable ones of `A`, and those on the axis
/// of `A - B2 C12` (of `A - B12 C2`), which are the zeros of `P12` (of `P21`) where the output (input) that is left does not
/// see them.
///
/// **Errors**: [`Error::NotStabilizable`], [`Error::NotDetectable`], [`Error::AxisZero`].
pub(super) fn check(plant: &NormalizedPlant, strictness: Strictness) -> Result<(), Error> {
    let (a, b2, c2) = (&plant.a, &plant.b2, &plant.c2);
    let (n_zf, n_u, n_wf, n_y) = (plant.n_z_free(), plant.n_u(), plant.n_w_free(), plant.n_y());
    for mode in eigenvalues(a)?.into_iter().filter(|m| m.im >= 0.0 && m.re >= -margin(a, strictness)) {
        if loses_rank(&a.transpose(), &b2.transpose(), mode, strictness) {
            return Err(Error::NotStabilizable { mode });
        }
        if loses_rank(a, c2, mode, strictness) {
            return Err(Error::NotDetectable { mode });
        }
    }
    let zeros_12 = a - b2 * plant.c1.rows(n_zf, n_u);
    let zeros_21 = (a - plant.b1.columns(n_wf, n_y) * c2).transpose();
    let seen_12 = plant.c1.rows(0, n_zf).into_owned();
    let seen_21 = plant.b1.columns(0, n_wf).transpose();
    for (path, dynamics, seen) in [(CONTROL_PATH, zeros_12, seen_12), (FILTER_PATH, zeros_21, seen_21)] {
        let near = margin(&dynamics, strictness);
        for zero in eigenvalues(&dynamics)?.into_iter().filter(|m| m.im >= 0.0 && m.re.abs() <= near) {
            let on_axis = Complex64::new(0.0, zero.im);
            if loses_rank(&dynamics, &seen, on_axis, strictness) {
                return Err(Error::AxisZero { path, omega_rad_s: zero.im });
            }
        }
    }
    Ok(())
}

fn margin(m: &DMatrix<f64>, strictness: Strictness) -> f64 {
    match strictness {
        Strictness::Certain => 100.0 * m.nrows() as f64 * f64::EPSILON * m.norm(),
        Strictness::Likely => 1e5 * m.nrows() as f64 * f64::EPSILON * m.norm(),
    }
}

/// Whether `[A - mode I; C]` has a singular value that counts as zero.
fn loses_rank(a: &DMatrix<f64>, c: &DMatrix<f64>, mode: Complex64, strictness: Strictness) -> bool {
    let n = a.nrows();
    let mut pencil = DMatrix::zeros(n + c.nrows(), n);
    for j in 0..n {
        for i in 0..n {
            pencil[(i, j)] = Complex64::new(a[(i, j)], 0.0);
        }
        pencil[(j, j)] -= mode;
        for i in 0..c.nrows() {
            pencil[(n + i, j)] = Complex64::new(c[(i, j)], 0.0);
        }
    }
    let values = pencil.singular_values();
    let threshold = match strictness {
        Strictness::Certain => 10.0 * n as f64 * f64::EPSILON,
        Strictness::Likely => 1e4 * n as f64 * f64::EPSILON,
    };
    values.min() <= threshold * values.max()
}

/// The path whose zeros limit the control Riccati equation.
pub(super) const CONTROL_PATH: &str = "u to z (P12)";
/// The path whose zeros limit the filter Riccati equation.
const FILTER_PATH: &str = "w to y (P21)";
