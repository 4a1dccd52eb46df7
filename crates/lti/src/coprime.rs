//! Normalized coprime factorizations: a plant as a quotient of two stable systems that together have unit gain.

use nalgebra::DMatrix;

use crate::{Continuous, Error, StateSpace, riccati};

/// The two Riccati solutions behind the normalized coprime factors of `G = C (s I - A)⁻¹ B + D`.
///
/// With `S = I + Dᵀ D` and `R = I + D Dᵀ`:
///
/// ```text
///     (A - B S⁻¹ Dᵀ C)ᵀ X + X (A - B S⁻¹ Dᵀ C) - X B S⁻¹ Bᵀ X + Cᵀ R⁻¹ C = 0
///     (A - B Dᵀ R⁻¹ C) Z + Z (A - B Dᵀ R⁻¹ C)ᵀ - Z Cᵀ R⁻¹ C Z + B S⁻¹ Bᵀ = 0
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct CoprimeRiccati {
    /// `X`, of the control problem, `n_x × n_x`.
    pub x: DMatrix<f64>,
    /// `Z`, of the filter problem, `n_x × n_x`.
    pub z: DMatrix<f64>,
    /// `F = -S⁻¹ (Dᵀ C + Bᵀ X)`, so that `A + B F` is stable, `n_u × n_x`.
    pub f: DMatrix<f64>,
    /// `H = -(B Dᵀ + Z Cᵀ) R⁻¹`, so that `A + H C` is stable, `n_x × n_y`.
    pub h: DMatrix<f64>,
    /// Larger of the two relative residuals.
    pub residual_relative: f64,
}

impl CoprimeRiccati {
    /// Solves both equations for a stabilizable and detectable system.
    ///
    /// **Source**: McFarlane and Glover 1990; Zhou and Doyle 1998, section 13.3 (with `D`).
    ///
    /// **Errors**: those of [`riccati::continuous`]: an axis mode that no input reaches or no output sees.
    pub fn new(sys: &StateSpace<Continuous>) -> Result<Self, Error> {
        let (a, b, c, d) = (sys.a(), sys.b(), sys.c(), sys.d());
        let s_inverse = inverse_of_one_plus(&d.tr_mul(d));
        let r_inverse = inverse_of_one_plus(&(d * d.transpose()));
        let a_shifted = a - b * (&s_inverse * d.tr_mul(c));
        let g = symmetric(&(b * &s_inverse * b.transpose()));
        let q = symmetric(&(c.tr_mul(&(&r_inverse * c))));
        let control = riccati::continuous(&a_shifted, &g, &q)?;
        let filter = riccati::continuous(&a_shifted.transpose(), &q, &g)?;
        let f = -&s_inverse * (d.tr_mul(c) + b.tr_mul(&control.x));
        let h = -(b * d.transpose() + &filter.x * c.transpose()) * &r_inverse;
        let residual_relative = control.residual_relative.max(filter.residual_relative);
        Ok(Self { x: control.x, z: filter.x, f, h, residual_relative })
    }

    /// Largest eigenvalue of `X Z`; the best robustness of any controller is `1 / sqrt(1 + lambda)`.
    #[must_use]
    pub fn coupling(&self) -> f64 {
        if self.x.is_empty() {
            return 0.0;
        }
        // X Z has the eigenvalues of Rᵀ Z R with X = R Rᵀ.
        let eigen = nalgebra::SymmetricEigen::new(self.x.clone());
        let mut root = eigen.eigenvectors;
        for (mut column, value) in root.column_iter_mut().zip(eigen.eigenvalues.iter()) {
            column.scale_mut(value.max(0.0).sqrt());
        }
        symmetric(&root.tr_mul(&(&self.z * &root))).symmetric_eigenvalues().max().max(0.0)
    }
}

/// A plant as a quotient of stable systems.
#[derive(Clone, Debug, PartialEq)]
pub struct CoprimeFactors {
    /// The denominator `M`, square.
    pub m: StateSpace<Continuous>,
    /// The numerator `N`.
    pub n: StateSpace<Continuous>,
    /// Both in one system with the states once: `[N M]` for left factors, `[M; N]` for right ones.
    pub both: StateSpace<Continuous>,
}

impl StateSpace<Continuous> {
    /// The normalized left coprime factors: `G = M⁻¹ N` with `N N* + M M* = I` on the axis.
    ///
    /// **Method**: `[N M] = [A + H C | B + H D, H; R^(-1/2) C | R^(-1/2) D, R^(-1/2)]` with `H` of [`CoprimeRiccati`].
    ///
    /// **Source**: McFarlane and Glover 1990; Zhou and Doyle 1998, theorem 13.37 and its dual.
    ///
    /// # Errors
    /// Those of [`CoprimeRiccati::new`].
    ///
    /// # Example
    /// ```
    /// // G = 1 / s: M = s / (s + 1), N = 1 / (s + 1).
    /// let g = telepulse_lti::TransferFunction::new(&[1.0], &[1.0, 0.0])?.to_state_space();
    /// let factors = g.left_coprime()?;
    /// let (m, n) = (factors.m.at(1.0)?[(0, 0)], factors.n.at(1.0)?[(0, 0)]);
    /// assert!((m.norm_sqr() - 0.5).abs() < 1e-15 && (n.norm_sqr() - 0.5).abs() < 1e-15);
    /// # Ok::<(), telepulse_lti::Error>(())
    /// ```
    pub fn left_coprime(&self) -> Result<CoprimeFactors, Error> {
        let sys = self.balanced();
        let h = CoprimeRiccati::new(&sys)?.h;
        let (n_u, n_y) = (sys.n_inputs(), sys.n_outputs());
        let root = inverse_root_of_one_plus(&(sys.d() * sys.d().transpose()));
        let mut b = DMatrix::zeros(sys.n_states(), n_u + n_y);
        b.columns_mut(0, n_u).copy_from(&(sys.b() + &h * sys.d()));
        b.columns_mut(n_u, n_y).copy_from(&h);
        let mut d = DMatrix::zeros(n_y, n_u + n_y);
        d.columns_mut(0, n_u).copy_from(&(&root * sys.d()));
        d.columns_mut(n_u, n_y).copy_from(&root);
        let both = Self::new(sys.a() + &h * sys.c(), b, &root * sys.c(), d)?;
        let all: Vec<usize> = (0..n_y).collect();
        let (n_ports, m_ports): (Vec<usize>, Vec<usize>) = (0..n_u + n_y).partition(|&k| k < n_u);
        Ok(CoprimeFactors { m: both.select(&all, &m_ports)?, n: both.select(&all, &n_ports)?, both })
    }

    /// The normalized right coprime factors: `G = N M⁻¹` with `M* M + N* N = I` on the axis.
    ///
    /// **Method**: `[M; N] = [A + B F | B S^(-1/2); F | S^(-1/2); C + D F | D S^(-1/2)]` with `F` of [`CoprimeRiccati`].
    ///
    /// **Source**: Zhou and Doyle 1998, theorem 13.37.
    ///
    /// # Errors
    /// Those of [`CoprimeRiccati::new`].
    pub fn right_coprime(&self) -> Result<CoprimeFactors, Error> {
        let sys = self.balanced();
        let f = CoprimeRiccati::new(&sys)?.f;
        let (n_u, n_y) = (sys.n_inputs(), sys.n_outputs());
        let root = inverse_root_of_one_plus(&sys.d().tr_mul(sys.d()));
        let mut c = DMatrix::zeros(n_u + n_y, sys.n_states());
        c.rows_mut(0, n_u).copy_from(&f);
        c.rows_mut(n_u, n_y).copy_from(&(sys.c() + sys.d() * &f));
        let mut d = DMatrix::zeros(n_u + n_y, n_u);
        d.rows_mut(0, n_u).copy_from(&root);
        d.rows_mut(n_u, n_y).copy_from(&(sys.d() * &root));
        let both = Self::new(sys.a() + sys.b() * &f, sys.b() * &root, c, d)?;
        let all: Vec<usize> = (0..n_u).collect();
        let (m_ports, n_ports): (Vec<usize>, Vec<usize>) = (0..n_u + n_y).partition(|&k| k < n_u);
        Ok(CoprimeFactors { m: both.select(&m_ports, &all)?, n: both.select(&n_ports, &all)?, both })
    }
}

/// `(I + p)⁻¹` for a positive semidefinite `p`.
fn inverse_of_one_plus(p: &DMatrix<f64>) -> DMatrix<f64> {
    power_of_one_plus(p, |value| 1.0 / value)
}

/// `(I + p)^(-1/2)`, symmetric, for a positive semidefinite `p`.
fn inverse_root_of_one_plus(p: &DMatrix<f64>) -> DMatrix<f64> {
    power_of_one_plus(p, |value| 1.0 / value.sqrt())
}

fn power_of_one_plus(p: &DMatrix<f64>, power: impl Fn(f64) -> f64) -> DMatrix<f64> {
    if p.amax() == 0.0 {
        return DMatrix::identity(p.nrows(), p.nrows());
    }
    let eigen = nalgebra::SymmetricEigen::new(symmetric(p));
    let values = eigen.eigenvalues.map(|value| power(1.0 + value.max(0.0)));
    symmetric(&(&eigen.eigenvectors * DMatrix::from_diagonal(&values) * eigen.eigenvectors.transpose()))
}

fn symmetric(m: &DMatrix<f64>) -> DMatrix<f64> {
    (m + m.transpose()) * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn law_factors_are_stable_normalized_and_have_the_plant_as_quotient() {
        let seed = 51;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        for trial in 0..40 {
            let (n, n_y, n_u) = (1 + trial % 6, 1 + trial % 2, 1 + trial % 3);
            let mut m = |r, c| DMatrix::from_fn(r, c, |_, _| rng.random_range(-1.0..1.0));
            let g = StateSpace::<Continuous>::new(m(n, n), m(n, n_u), m(n_y, n), m(n_y, n_u)).expect("fits");
            let left = g.left_coprime().expect("stabilizable with probability one");
            let right = g.right_coprime().expect("detectable with probability one");
            assert!(left.both.is_stable().expect("poles") && right.both.is_stable().expect("poles"));
            for omega in [0.0, 0.3, 4.0, 1e3] {
                let at = |sys: &StateSpace<Continuous>| sys.at(omega).expect("no pole there");
                let plant = at(&g);
                let scale = 1e-10 * (1.0 + plant.norm());
                let (l, r) = (at(&left.both), at(&right.both));
                assert!((&l * l.adjoint() - DMatrix::identity(n_y, n_y)).norm() < 1e-11, "{seed} {trial}");
                assert!((r.adjoint() * &r - DMatrix::identity(n_u, n_u)).norm() < 1e-11, "{seed} {trial}");
                assert!((at(&left.m) * &plant - at(&left.n)).norm() < scale, "{seed} {trial} {omega}");
                assert!((&plant * at(&right.m) - at(&right.n)).norm() < scale, "{seed} {trial} {omega}");
            }
        }
    }

    #[test]
    fn edge_a_mode_on_the_axis_that_nothing_reaches_is_refused() {
        let g = StateSpace::<Continuous>::new(
            nalgebra::dmatrix![0.0, 0.0; 0.0, -1.0],
            nalgebra::dmatrix![0.0; 1.0],
            nalgebra::dmatrix![1.0, 1.0],
            nalgebra::dmatrix![0.0],
        );
        assert!(matches!(g.expect("valid").left_coprime(), Err(Error::HamiltonianAxis { .. })));
    }
}
