//! A system whose derivatives have a matrix of their own, as masses and inductances give it.

use nalgebra::DMatrix;
use telepulse_lti::{Continuous, StateSpace};

use crate::Error;

/// `E x' = A x + B u`, `y = C x + D u` with an invertible `E`.
///
/// Laws of physics are affine in their parameters in this form: a mass stands in `E`, where `1/m` in `A` would not be.
#[derive(Clone, Debug, PartialEq)]
pub struct DescriptorSystem {
    e: DMatrix<f64>,
    sys: StateSpace<Continuous>,
}

impl DescriptorSystem {
    /// A system from its matrices.
    ///
    /// **Shapes**: `e: n_x × n_x`, the others as [`StateSpace::new`].
    ///
    /// **Errors**: [`telepulse_lti::Error::Shape`], [`telepulse_lti::Error::NotFinite`], and those of [`StateSpace::new`].
    pub fn new(
        e: DMatrix<f64>,
        a: DMatrix<f64>,
        b: DMatrix<f64>,
        c: DMatrix<f64>,
        d: DMatrix<f64>,
    ) -> Result<Self, Error> {
        let sys = StateSpace::<Continuous>::new(a, b, c, d)?;
        let n = sys.n_states();
        if e.shape() != (n, n) {
            let (rows, cols) = e.shape();
            let shape =
                telepulse_lti::Error::Shape { matrix: "e", expected_rows: n, expected_cols: n, rows, cols };
            return Err(shape.into());
        }
        if let Some((index, &value)) = e.iter().enumerate().find(|(_, v)| !v.is_finite()) {
            return Err(telepulse_lti::Error::NotFinite { quantity: "e", index, value }.into());
        }
        Ok(Self { e, sys })
    }

    /// States, inputs and outputs.
    pub(super) fn sizes(&self) -> [usize; 3] {
        [self.sys.n_states(), self.sys.n_inputs(), self.sys.n_outputs()]
    }

    /// `[A B -E; C D 0]`: what multiplies `(x, u, x')` in the equations.
    pub(super) fn coefficients(&self) -> DMatrix<f64> {
        let [n, m, p] = self.sizes();
        let mut all = DMatrix::zeros(n + p, n + m + n);
        all.view_mut((0, 0), (n, n)).copy_from(self.sys.a());
        all.view_mut((0, n), (n, m)).copy_from(self.sys.b());
        all.view_mut((0, n + m), (n, n)).copy_from(&-&self.e);
        all.view_mut((n, 0), (p, n)).copy_from(self.sys.c());
        all.view_mut((n, n), (p, m)).copy_from(self.sys.d());
        all
    }
}

impl From<StateSpace<Continuous>> for DescriptorSystem {
    fn from(sys: StateSpace<Continuous>) -> Self {
        let n = sys.n_states();
        Self { e: DMatrix::identity(n, n), sys }
    }
}

/// Solves `E X = right`, with the rows and columns of `E` brought to like size first.
///
/// **Errors**: [`Error::SingularDescriptor`] where `E` has no inverse within rounding.
pub(super) fn solve(e: &DMatrix<f64>, right: &DMatrix<f64>) -> Result<DMatrix<f64>, Error> {
    let n = e.nrows();
    if n == 0 {
        return Ok(right.clone());
    }
    let by_largest = |v: f64| if v > 0.0 { 1.0 / v } else { 1.0 };
    let rows: Vec<f64> = e.row_iter().map(|row| by_largest(row.amax())).collect();
    let scaled = DMatrix::from_fn(n, n, |i, j| e[(i, j)] * rows[i]);
    let cols: Vec<f64> = scaled.column_iter().map(|col| by_largest(col.amax())).collect();
    let scaled = DMatrix::from_fn(n, n, |i, j| scaled[(i, j)] * cols[j]);
    let singular = scaled.singular_values();
    let (largest, smallest) = (singular.max(), singular.min());
    let refused = Error::SingularDescriptor { smallest, largest };
    if smallest.is_nan() || smallest <= 8.0 * n as f64 * f64::EPSILON * largest {
        return Err(refused);
    }
    let scaled_right = DMatrix::from_fn(n, right.ncols(), |i, j| right[(i, j)] * rows[i]);
    let solution = scaled.lu().solve(&scaled_right).ok_or(refused)?;
    Ok(DMatrix::from_fn(n, right.ncols(), |i, j| solution[(i, j)] * cols[i]))
}
