//! Riccati solutions from extended pencils, which need no inverse of `R` and none of `A`.

use nalgebra::DMatrix;
use num_complex::Complex64;

use super::StableSubspace;
use super::refinement::Scaled;
use crate::Error;
use crate::lyapunov::symmetric;
use crate::schur::RealSchur;

/// `M - lambda N` of size `2n` on states and costates.
struct Pencil {
    m: DMatrix<f64>,
    n: DMatrix<f64>,
}

impl Pencil {
    /// Frees `[m_xp inputs] - lambda [n_xp 0]` of its inputs by the orthogonal complement of their columns.
    fn new(m_xp: DMatrix<f64>, n_xp: DMatrix<f64>, inputs: DMatrix<f64>) -> Self {
        let (mut m, mut n) = (m_xp, n_xp);
        let n_inputs = inputs.ncols();
        let size = m.ncols();
        if n_inputs > 0 {
            let qr = inputs.qr();
            qr.q_tr_mul(&mut m);
            qr.q_tr_mul(&mut n);
        }
        Self { m: m.rows(n_inputs, size).into_owned(), n: n.rows(n_inputs, size).into_owned() }
    }

    /// `(M + shift N)⁻¹ (M - shift N)` and how far from singular the inverted matrix is.
    fn cayley(&self, shift: f64) -> Option<(f64, DMatrix<f64>)> {
        let lu = (&self.m + &self.n * shift).lu();
        let diagonal = lu.u().diagonal().abs();
        let transformed = lu.solve(&(&self.m - &self.n * shift))?;
        if transformed.iter().any(|v| !v.is_finite()) {
            return None;
        }
        Some((diagonal.min() / diagonal.max(), transformed))
    }

    /// The best conditioned of the Cayley transforms at the shifts given.
    fn best_cayley(&self, shifts: &[f64]) -> Result<(f64, DMatrix<f64>), Error> {
        let all = shifts.iter().filter_map(|&shift| self.cayley(shift).map(|(c, matrix)| (c, shift, matrix)));
        let best = all.max_by(|x, y| x.0.total_cmp(&y.0));
        let singular = Error::Singular { matrix: "the extended pencil", reciprocal_condition: 0.0 };
        best.map(|(_, shift, matrix)| (shift, matrix)).ok_or(singular)
    }
}

/// **Method**: `[A 0 B; -Q -Aᵀ -S; Sᵀ Bᵀ R] - lambda diag(I, I, 0)` has the stabilizing solution in the subspace of its
/// stable eigenvalues; the Cayley transform takes these into the unit circle.
pub(super) fn continuous(equation: &Scaled) -> Result<DMatrix<f64>, Error> {
    let Scaled { a, b, q, r, s, .. } = equation;
    let (n, m) = b.shape();
    if n == 0 {
        return Ok(DMatrix::zeros(0, 0));
    }
    let mut m_xp = DMatrix::zeros(2 * n + m, 2 * n);
    m_xp.view_mut((0, 0), (n, n)).copy_from(a);
    m_xp.view_mut((n, 0), (n, n)).copy_from(&-q);
    m_xp.view_mut((n, n), (n, n)).copy_from(&-a.transpose());
    m_xp.view_mut((2 * n, 0), (m, n)).copy_from(&s.transpose());
    m_xp.view_mut((2 * n, n), (m, n)).copy_from(&b.transpose());
    let n_xp = DMatrix::identity(2 * n + m, 2 * n);
    let pencil = Pencil::new(m_xp, n_xp, stack(b, &-s, r));
    // No eigenvalue may be at the shift; the mirror images of the closed loop's poles are real at few points only.
    let size = a.norm().max(q.norm().sqrt()).max(f64::MIN_POSITIVE.sqrt());
    let shifts = SHIFTS.map(|factor| -factor * size);
    let (shift, transformed) = pencil.best_cayley(&shifts)?;
    // nu = (lambda - shift) / (lambda + shift), and lambda stable where |nu| < 1 since the shift is negative.
    let schur = RealSchur::new(&transformed)?;
    let values = schur.eigenvalues();
    let ordered = schur.order(|nu| nu.norm() < 1.0)?;
    if ordered.n_selected != n {
        let off = |nu: &Complex64| (nu.norm() - 1.0).abs();
        let nearest = values.iter().min_by(|x, y| off(x).total_cmp(&off(y)));
        let lambda = nearest.map_or(Complex64::ZERO, |nu| shift * (1.0 + nu) / (1.0 - nu));
        return Err(Error::HamiltonianAxis { re: lambda.re.abs(), omega_rad_s: lambda.im.abs() });
    }
    let basis = ordered.form.q;
    let (x1, x2) = (basis.view((0, 0), (n, n)).into_owned(), basis.view((n, 0), (n, n)).into_owned());
    let singular_values = x1.singular_values();
    let reciprocal_condition = singular_values.min() / singular_values.max();
    let failed = Error::NoStabilizingSolution { reciprocal_condition };
    if reciprocal_condition.is_nan() || reciprocal_condition < f64::EPSILON {
        return Err(failed);
    }
    let x = x1.transpose().lu().solve(&x2.transpose()).ok_or(failed)?;
    Ok(symmetric(&x))
}

/// **Method**: `[A 0 B; -Q I -S; Sᵀ 0 R] - lambda [I 0 0; 0 Aᵀ 0; 0 -Bᵀ 0]`; the bilinear map at 1 or -1 makes it the
/// Hamiltonian matrix of a continuous equation with the same solution.
pub(super) fn discrete(equation: &Scaled) -> Result<DMatrix<f64>, Error> {
    let Scaled { a, b, q, r, s, .. } = equation;
    let (n, m) = b.shape();
    if n == 0 {
        return Ok(DMatrix::zeros(0, 0));
    }
    let mut m_xp = DMatrix::zeros(2 * n + m, 2 * n);
    m_xp.view_mut((0, 0), (n, n)).copy_from(a);
    m_xp.view_mut((n, 0), (n, n)).copy_from(&-q);
    m_xp.view_mut((n, n), (n, n)).fill_with_identity();
    m_xp.view_mut((2 * n, 0), (m, n)).copy_from(&s.transpose());
    let mut n_xp = DMatrix::zeros(2 * n + m, 2 * n);
    n_xp.view_mut((0, 0), (n, n)).fill_with_identity();
    n_xp.view_mut((n, n), (n, n)).copy_from(&a.transpose());
    n_xp.view_mut((2 * n, n), (m, n)).copy_from(&-b.transpose());
    let pencil = Pencil::new(m_xp, n_xp, stack(b, &-s, r));
    // (lambda - 1) / (lambda + 1) and its inverse both take the unit circle's inside to the left half plane.
    let (shift, h) = pencil.best_cayley(&[1.0, -1.0])?;
    let upper = h.view((0, 0), (n, n)).into_owned();
    let lower = h.view((n, n), (n, n)).transpose();
    let g = -symmetric(&h.view((0, n), (n, n)).into_owned());
    let q = -symmetric(&h.view((n, 0), (n, n)).into_owned());
    let found =
        StableSubspace::new(&((upper - lower) * 0.5), &g, &q).and_then(|subspace| subspace.solution());
    found.map_err(|error| match error {
        Error::HamiltonianAxis { omega_rad_s, .. } => {
            let nu = Complex64::new(0.0, omega_rad_s);
            Error::SymplecticCircle { point: shift * (1.0 + nu) / (1.0 - nu) }
        }
        other => other,
    })
}

fn stack(b: &DMatrix<f64>, s: &DMatrix<f64>, r: &DMatrix<f64>) -> DMatrix<f64> {
    let (n, m) = b.shape();
    let mut inputs = DMatrix::zeros(2 * n + m, m);
    inputs.rows_mut(0, n).copy_from(b);
    inputs.rows_mut(n, n).copy_from(s);
    inputs.rows_mut(2 * n, m).copy_from(r);
    inputs
}

/// Shifts tried, in units of the size of the equation; the best conditioned is taken.
const SHIFTS: [f64; 5] = [1.0, 3.7, 0.27, 14.0, 0.07];
