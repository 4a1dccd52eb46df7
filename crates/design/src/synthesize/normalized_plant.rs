//! The generalized plant in the coordinates of the Glover-Doyle formulas: `D12 = [0; I]`, `D21 = [0 I]`, `D22 = 0`.

use nalgebra::{DMatrix, SymmetricEigen};
use telepulse_lti::{Continuous, GeneralizedPlant, StateSpace};

use crate::Error;

/// A generalized plant after scaling of `u`, `y` and rotation of `w`, `z`, none of which changes any closed-loop norm.
///
/// The last `n_u` rows of `z` are those that `u` reaches directly, the last `n_y` columns of `w` those that reach `y` directly.
#[derive(Clone, Debug)]
pub(super) struct NormalizedPlant {
    pub(super) a: DMatrix<f64>,
    pub(super) b1: DMatrix<f64>,
    pub(super) b2: DMatrix<f64>,
    pub(super) c1: DMatrix<f64>,
    pub(super) c2: DMatrix<f64>,
    pub(super) d11: DMatrix<f64>,
    /// `u = u_scale · u_normalized`.
    u_scale: DMatrix<f64>,
    /// `y_normalized = y_scale · y`.
    y_scale: DMatrix<f64>,
    /// The direct term that was removed.
    d22: DMatrix<f64>,
    parrott_bound: f64,
}

impl NormalizedPlant {
    /// Normalizes a plant.
    ///
    /// **Method**: states balanced by powers of two; singular value decompositions of `D12` and `D21`, the missing orthogonal
    /// directions from the spectral decomposition of the projector.
    ///
    /// **Errors**: [`Error::SingularD12`] unless `D12` has full column rank, [`Error::SingularD21`] unless `D21` has full row
    /// rank.
    pub(super) fn new(plant: &GeneralizedPlant) -> Result<Self, Error> {
        let (n_w, n_u, n_z, n_y) = (plant.n_w(), plant.n_u(), plant.n_z(), plant.n_y());
        let balanced = GeneralizedPlant::new(plant.sys().balanced(), n_w, n_u, n_z, n_y)?;
        let column = Factors::new(&balanced.d12()).ok_or_else(|| {
            let (largest, smallest) = extreme_singular_values(&balanced.d12());
            Error::SingularD12 { n_z, n_u, largest, smallest }
        })?;
        let row = Factors::new(&balanced.d21().transpose()).ok_or_else(|| {
            let (largest, smallest) = extreme_singular_values(&balanced.d21());
            Error::SingularD21 { n_y, n_w, largest, smallest }
        })?;
        // z_normalized = rotationᵀ z, w = rotation w_normalized
        let (z_rotation, u_scale) = (column.rotation, column.inverse);
        let (w_rotation, y_scale) = (row.rotation, row.inverse.transpose());
        let d11 = z_rotation.tr_mul(&balanced.d11()) * &w_rotation;
        let norm = |m: DMatrix<f64>| if m.is_empty() { 0.0 } else { m.singular_values().max() };
        let (upper, left) = (d11.rows(0, n_z - n_u), d11.columns(0, n_w - n_y));
        let parrott_bound = norm(upper.into_owned()).max(norm(left.into_owned()));
        Ok(Self {
            a: balanced.a(),
            b1: balanced.b1() * &w_rotation,
            b2: balanced.b2() * &u_scale,
            c1: z_rotation.tr_mul(&balanced.c1()),
            c2: &y_scale * balanced.c2(),
            d11,
            parrott_bound,
            u_scale,
            y_scale,
            d22: balanced.d22(),
        })
    }

    pub(super) fn n_u(&self) -> usize {
        self.b2.ncols()
    }

    pub(super) fn n_y(&self) -> usize {
        self.c2.nrows()
    }

    /// Rows of `z` that `u` does not reach directly.
    pub(super) fn n_z_free(&self) -> usize {
        self.c1.nrows() - self.n_u()
    }

    /// Columns of `w` that do not reach `y` directly.
    pub(super) fn n_w_free(&self) -> usize {
        self.b1.ncols() - self.n_y()
    }

    /// Parrott's bound: the norm of `D11` that no static feedback can lower.
    pub(super) fn parrott_bound(&self) -> f64 {
        self.parrott_bound
    }

    /// The part of `D11` with the given quarter: `(false, false)` is `D1111`, `(true, false)` is `D1121`.
    pub(super) fn d11_quarter(&self, reached_by_u: bool, reaches_y: bool) -> DMatrix<f64> {
        let (zf, wf) = (self.n_z_free(), self.n_w_free());
        let (row, n_rows) = if reached_by_u { (zf, self.n_u()) } else { (0, zf) };
        let (col, n_cols) = if reaches_y { (wf, self.n_y()) } else { (0, wf) };
        self.d11.view((row, col), (n_rows, n_cols)).into_owned()
    }

    /// Undoes scaling and the removal of `D22` for a controller of the normalized plant.
    ///
    /// **Errors**: those of the loop `K (I + D22 K)⁻¹`, if `I + D22 D_K` is singular.
    pub(super) fn recover(
        &self,
        controller: &StateSpace<Continuous>,
    ) -> Result<StateSpace<Continuous>, Error> {
        let scaled = StateSpace::<Continuous>::new(
            controller.a().clone(),
            controller.b() * &self.y_scale,
            &self.u_scale * controller.c(),
            &self.u_scale * controller.d() * &self.y_scale,
        )?;
        if self.d22.amax() == 0.0 {
            return Ok(scaled);
        }
        // y - D22 u enters the controller.
        Ok(scaled.feedback(&StateSpace::<Continuous>::from_gain(self.d22.clone())?)?)
    }
}

/// A tall matrix `M` of full rank written as `rotation [0; I] inverse⁻¹`.
struct Factors {
    rotation: DMatrix<f64>,
    inverse: DMatrix<f64>,
}

impl Factors {
    /// `None` unless the columns, brought to like size, are independent.
    fn new(m: &DMatrix<f64>) -> Option<Self> {
        let (rows, cols) = m.shape();
        // Each signal has a unit of its own, which must not decide on the rank.
        let sizes: Vec<f64> = m.column_iter().map(|column| unit_of(column.amax())).collect();
        let mut m = m.clone();
        for (mut column, size) in m.column_iter_mut().zip(&sizes) {
            column.unscale_mut(*size);
        }
        let svd = m.svd(true, true);
        let (u, v_t) = (svd.u?, svd.v_t?);
        let largest = svd.singular_values.max();
        if rows < cols || largest == 0.0 || svd.singular_values.min() < RANK_TOLERANCE * largest {
            return None;
        }
        // Directions that M does not reach: the kernel of U Uᵀ.
        let mut rotation = DMatrix::zeros(rows, rows);
        let complement = SymmetricEigen::new(DMatrix::identity(rows, rows) - &u * u.transpose());
        let mut filled = 0;
        for (value, vector) in complement.eigenvalues.iter().zip(complement.eigenvectors.column_iter()) {
            if *value > 0.5 && filled < rows - cols {
                rotation.set_column(filled, &vector);
                filled += 1;
            }
        }
        rotation.view_mut((0, rows - cols), (rows, cols)).copy_from(&u);
        let mut inverse = v_t.transpose();
        for (mut column, value) in inverse.column_iter_mut().zip(svd.singular_values.iter()) {
            column.unscale_mut(*value);
        }
        for (mut row, size) in inverse.row_iter_mut().zip(&sizes) {
            row.unscale_mut(*size);
        }
        (filled == rows - cols).then_some(Self { rotation, inverse })
    }
}

/// The power of two next to a size, 1 for 0.
fn unit_of(size: f64) -> f64 {
    if size > 0.0 { size.log2().round().exp2() } else { 1.0 }
}

fn extreme_singular_values(m: &DMatrix<f64>) -> (f64, f64) {
    let values = m.singular_values();
    (values.max(), values.min())
}

/// Ratio of singular values below which a direct term counts as rank-deficient: the scaling would cost half of the digits.
const RANK_TOLERANCE: f64 = 1e-8;
