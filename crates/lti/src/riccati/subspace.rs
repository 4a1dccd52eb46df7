//! Stable invariant subspaces of Hamiltonian matrices.

use nalgebra::{DMatrix, DVector, SymmetricEigen};
use num_complex::Complex64;

use super::balancing::{Balanced, unscale};
use crate::Error;
use crate::lyapunov::check_symmetric;
use crate::schur::RealSchur;

/// What a Hamiltonian matrix has.
#[derive(Clone, Debug, PartialEq)]
pub enum Subspace {
    /// A stable invariant subspace of half its size.
    Stable(Box<StableSubspace>),
    /// Eigenvalues on the imaginary axis, as far as rounding can tell; all eigenvalues, in rad/s.
    Axis(Vec<Complex64>),
}

/// The stable invariant subspace of a Hamiltonian matrix, `H [X1; X2] = [X1; X2] T`.
///
/// The basis is orthonormal in *balanced* coordinates: with `D = diag(scaling)`, the basis in the caller's
/// coordinates is `[D X1; D⁻¹ X2]`. All entries of `D` are powers of two.
#[derive(Clone, Debug, PartialEq)]
pub struct StableSubspace {
    /// Upper half of the basis in balanced coordinates, `n × n`.
    pub x1: DMatrix<f64>,
    /// Lower half of the basis in balanced coordinates, `n × n`.
    pub x2: DMatrix<f64>,
    /// Diagonal of the balancing matrix `D`.
    pub scaling: DVector<f64>,
    /// `T`: the restriction of `H` to the subspace, quasi-triangular; similar to `A - G X` where `X` exists.
    pub restriction: DMatrix<f64>,
    /// Eigenvalues of `T`, in rad/s.
    pub poles: Vec<Complex64>,
    /// Norm of `X1ᵀ X2 - X2ᵀ X1`, zero in exact arithmetic.
    pub isotropy_error: f64,
}

impl StableSubspace {
    /// Returns the stable subspace of the Hamiltonian matrix with the blocks `A`, `G`, `Q`.
    ///
    /// **Shapes and units**: all `n × n`; `g` and `q` symmetric, any definiteness.
    ///
    /// **Method**: symplectic balancing by powers of two, real Schur form, stable eigenvalues moved to the top. An
    /// eigenvalue on the axis shows either in the count of stable ones or, when rounding pushed a pair apart, in a
    /// subspace that is not isotropic (`X1ᵀ X2` not symmetric); no distance from the axis has to be chosen.
    ///
    /// **Source**: Laub 1979; Benner 2001, "Symplectic balancing of Hamiltonian matrices".
    ///
    /// **Errors**: [`Error::HamiltonianAxis`], [`Error::NotSymmetric`], and those of [`RealSchur`].
    pub fn new(a: &DMatrix<f64>, g: &DMatrix<f64>, q: &DMatrix<f64>) -> Result<Self, Error> {
        match Self::search(a, g, q)? {
            Subspace::Stable(subspace) => Ok(*subspace),
            Subspace::Axis(eigenvalues) => {
                let nearest = eigenvalues.iter().min_by(|a, b| a.re.abs().total_cmp(&b.re.abs()));
                let (re, omega_rad_s) = nearest.map_or((0.0, 0.0), |v| (v.re.abs(), v.im.abs()));
                Err(Error::HamiltonianAxis { re, omega_rad_s })
            }
        }
    }

    /// Returns the stable subspace, or the eigenvalues of a Hamiltonian matrix that has none because some lie on the axis.
    ///
    /// **Shapes and units**, **Method**: as [`StableSubspace::new`].
    ///
    /// **Errors**: as [`StableSubspace::new`], but for [`Error::HamiltonianAxis`].
    pub fn search(a: &DMatrix<f64>, g: &DMatrix<f64>, q: &DMatrix<f64>) -> Result<Subspace, Error> {
        let n = a.nrows();
        for (matrix, m) in [("a", a), ("g", g), ("q", q)] {
            if m.shape() != (n, n) {
                let (rows, cols) = m.shape();
                return Err(Error::Shape { matrix, expected_rows: n, expected_cols: n, rows, cols });
            }
        }
        check_symmetric("g", g)?;
        check_symmetric("q", q)?;
        Balanced::new(a, g, q).stable_subspace()
    }

    /// Returns the principal angles `theta` of the subspace, sorted: the eigenvalues of `X` are their tangents.
    ///
    /// Angles lie in `(-pi/2, pi/2]`, in balanced coordinates. `X` is positive semidefinite where none is negative
    /// (beyond rounding), infinite where one is `pi/2`. Unlike the eigenvalues of `X1ᵀ X2`, the angles tell an eigenvalue
    /// of `X` that has passed through infinity (just above `-pi/2`) from one that is zero.
    ///
    /// **Method**: `W = X1 + i X2` is unitary, `W Wᵀ = P + i Q` has the eigenvalues `exp(2 i theta)`, and its real part
    /// `P = X1 X1ᵀ - X2 X2ᵀ` and imaginary part `Q = X1 X2ᵀ + X2 X1ᵀ` are symmetric and commute.
    pub fn angles(&self) -> Vec<f64> {
        if self.x1.is_empty() {
            return Vec::new();
        }
        let p = &self.x1 * self.x1.transpose() - &self.x2 * self.x2.transpose();
        let cross = &self.x1 * self.x2.transpose();
        let q = &cross + cross.transpose();
        // A combination with an irrational angle has the common eigenvectors of both.
        let common = SymmetricEigen::new(&p * MIX.cos() + &q * MIX.sin());
        let mut angles: Vec<f64> = common
            .eigenvectors
            .column_iter()
            .map(|v| 0.5 * (&q * v).dot(&v).atan2((&p * v).dot(&v)))
            .collect();
        angles.sort_by(f64::total_cmp);
        angles
    }

    /// Returns `X = X2 X1⁻¹` in the caller's coordinates.
    ///
    /// **Errors**: [`Error::NoStabilizingSolution`] when `X1` is singular to working precision.
    pub fn solution(&self) -> Result<DMatrix<f64>, Error> {
        Ok(unscale(&self.balanced_solution()?, &self.scaling))
    }

    pub(super) fn balanced_solution(&self) -> Result<DMatrix<f64>, Error> {
        let n = self.x1.nrows();
        if n == 0 {
            return Ok(DMatrix::zeros(0, 0));
        }
        let singular_values = self.x1.singular_values();
        let reciprocal_condition = singular_values.min() / singular_values.max();
        let failed = Error::NoStabilizingSolution { reciprocal_condition };
        if reciprocal_condition.is_nan() || reciprocal_condition < RECIPROCAL_CONDITION_MIN {
            return Err(failed);
        }
        // X X1 = X2, so X1ᵀ Xᵀ = X2ᵀ.
        let xt = self.x1.transpose().lu().solve(&self.x2.transpose()).ok_or(failed)?;
        Ok((&xt + xt.transpose()) * 0.5)
    }
}

impl Balanced {
    fn stable_subspace(self) -> Result<Subspace, Error> {
        let n = self.a.nrows();
        let schur = RealSchur::new(&self.hamiltonian())?;
        let values = schur.eigenvalues();
        if values.iter().filter(|v| v.re < 0.0).count() != n {
            return Ok(Subspace::Axis(values));
        }
        let ordered = schur.order(|v| v.re < 0.0)?;
        if ordered.n_selected != n {
            return Ok(Subspace::Axis(values));
        }
        let form = ordered.form;
        let x1 = form.q.view((0, 0), (n, n)).into_owned();
        let x2 = form.q.view((n, 0), (n, n)).into_owned();
        let product = x1.transpose() * &x2;
        let isotropy_error = (&product - product.transpose()).norm();
        if isotropy_error > ISOTROPY_TOLERANCE {
            return Ok(Subspace::Axis(values));
        }
        let mut poles = form.eigenvalues();
        poles.truncate(n);
        let restriction = form.t.view((0, 0), (n, n)).into_owned();
        let scaling = self.scaling;
        Ok(Subspace::Stable(Box::new(StableSubspace { x1, x2, scaling, restriction, poles, isotropy_error })))
    }
}

/// Angle of the combination in [`StableSubspace::angles`]: not a rational part of pi, tangent not near a power of two.
const MIX: f64 = 0.9;

/// Below this ratio of singular values a basis half has no meaningful inverse.
pub(super) const RECIPROCAL_CONDITION_MIN: f64 = 1e-15;

/// A pair of axis eigenvalues that rounding has split makes this of order one; sound subspaces stay below 1e-7 even with
/// eigenvalues within 1e-9 of the matrix norm from the axis.
const ISOTROPY_TOLERANCE: f64 = 1e-5;
