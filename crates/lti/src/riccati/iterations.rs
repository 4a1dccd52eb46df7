//! Riccati solutions by iterations that use linear systems only: the second route.

use nalgebra::DMatrix;

use super::balancing::Balanced;
use super::refinement::Reduced;
use crate::Error;
use crate::lyapunov::symmetric;

/// The continuous solution from the sign of the Hamiltonian matrix: `(sign H + I) [I; X] = 0`.
///
/// **Method**: Newton iteration `Z <- (c Z + (c Z)⁻¹) / 2` with determinantal scaling, then least squares.
///
/// **Source**: Roberts 1980; Byers 1987.
pub(super) fn sign(reduced: &Reduced) -> Result<DMatrix<f64>, Error> {
    let n = reduced.a.nrows();
    if n == 0 {
        return Ok(DMatrix::zeros(0, 0));
    }
    let not_converged = Error::RiccatiNotConverged { route: "sign", iterations: STEPS_MAX };
    let mut z = Balanced::unscaled(&reduced.a, &reduced.g, &reduced.q).hamiltonian();
    let mut converged = false;
    for _ in 0..STEPS_MAX {
        let lu = z.clone().lu();
        let logarithms: f64 = lu.u().diagonal().iter().map(|v| v.abs().ln()).sum();
        let inverse = lu.try_inverse().ok_or_else(|| not_converged.clone())?;
        let scale = if converged { 1.0 } else { (-logarithms / (2 * n) as f64).exp() };
        let next = (&z * scale + inverse / scale) * 0.5;
        let change = (&next - &z).norm();
        let size = next.norm();
        if !size.is_finite() {
            return Err(not_converged);
        }
        z = next;
        if converged {
            return from_sign(z, n).ok_or(not_converged);
        }
        // Quadratic from here: one step more is exact to rounding.
        converged = change <= SETTLED * size;
    }
    Err(not_converged)
}

/// Least squares for `[Z12; Z22 + I] X = -[Z11 + I; Z21]`.
fn from_sign(mut z: DMatrix<f64>, n: usize) -> Option<DMatrix<f64>> {
    for i in 0..2 * n {
        z[(i, i)] += 1.0;
    }
    let mut rhs = -z.columns(0, n).into_owned();
    let qr = z.columns(n, n).into_owned().qr();
    qr.q_tr_mul(&mut rhs);
    let x = qr.r().solve_upper_triangular(&rhs.rows(0, n).into_owned())?;
    Some(symmetric(&x))
}

/// The discrete solution by structure-preserving doubling.
///
/// **Source**: Chu, Fan, Lin and Wang 2004, algorithm SDA.
pub(super) fn doubling(reduced: Reduced) -> Result<DMatrix<f64>, Error> {
    let n = reduced.a.nrows();
    let Reduced { mut a, mut g, q: mut h } = reduced;
    let not_converged = Error::RiccatiNotConverged { route: "doubling", iterations: STEPS_MAX };
    let one = DMatrix::<f64>::identity(n, n);
    for _ in 0..STEPS_MAX {
        let lu = (&one + &g * &h).lu();
        let (wa, wg) = match (lu.solve(&a), lu.solve(&g)) {
            (Some(wa), Some(wg)) => (wa, wg),
            _ => return Err(not_converged),
        };
        let change = symmetric(&(a.tr_mul(&h) * &wa));
        let size = h.norm();
        g = symmetric(&(&g + &a * wg * a.transpose()));
        a = &a * wa;
        h += &change;
        if !h.norm().is_finite() || !g.norm().is_finite() {
            return Err(not_converged);
        }
        if change.norm() <= f64::EPSILON * size {
            return Ok(h);
        }
    }
    Err(not_converged)
}

/// Both iterations converge quadratically once they have found the scale of the closed loop's poles.
const STEPS_MAX: usize = 60;
/// Relative change after which one more step of the sign iteration reaches rounding.
const SETTLED: f64 = 1e-7;
