//! Symplectic balancing of Hamiltonian matrices by powers of two.

use nalgebra::{DMatrix, DVector};

/// `D⁻¹ X D⁻¹`.
pub(super) fn unscale(x: &DMatrix<f64>, d: &DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(x.nrows(), x.ncols(), |i, j| x[(i, j)] / d[i] / d[j])
}

/// The blocks of `S⁻¹ H S` with `S = diag(D, D⁻¹)`.
pub(super) struct Balanced {
    pub(super) a: DMatrix<f64>,
    pub(super) g: DMatrix<f64>,
    pub(super) q: DMatrix<f64>,
    pub(super) scaling: DVector<f64>,
}

impl Balanced {
    pub(super) fn new(a: &DMatrix<f64>, g: &DMatrix<f64>, q: &DMatrix<f64>) -> Self {
        let n = a.nrows();
        let mut blocks = Self::unscaled(a, g, q);
        for _ in 0..BALANCING_SWEEPS_MAX {
            let mut settled = true;
            for i in 0..n {
                let f = blocks.factor(i);
                if f != 1.0 {
                    settled = false;
                    blocks.scale(i, f);
                }
            }
            if settled {
                break;
            }
        }
        blocks
    }

    /// The blocks as they are.
    pub(super) fn unscaled(a: &DMatrix<f64>, g: &DMatrix<f64>, q: &DMatrix<f64>) -> Self {
        let scaling = DVector::from_element(a.nrows(), 1.0);
        Self { a: a.clone(), g: g.clone(), q: q.clone(), scaling }
    }

    /// Power of two by which state `i` should be scaled, 1 where that gains less than five per cent.
    fn factor(&self, i: usize) -> f64 {
        let off_diagonal = |sum: f64, k: usize, v: f64| if k == i { sum } else { sum + v.abs() };
        let column_a = self.a.column(i).iter().enumerate().fold(0.0, |s, (k, &v)| off_diagonal(s, k, v));
        let row_a = self.a.row(i).iter().enumerate().fold(0.0, |s, (k, &v)| off_diagonal(s, k, v));
        let column_q = self.q.column(i).iter().enumerate().fold(0.0, |s, (k, &v)| off_diagonal(s, k, v));
        let row_g = self.g.row(i).iter().enumerate().fold(0.0, |s, (k, &v)| off_diagonal(s, k, v));
        let (diagonal_q, diagonal_g) = (self.q[(i, i)].abs(), self.g[(i, i)].abs());
        // A state without column or row would be scaled without end (Parlett and Reinsch permute those away).
        if column_a + column_q + diagonal_q == 0.0 || row_a + row_g + diagonal_g == 0.0 {
            return 1.0;
        }
        // Scaling by f multiplies the column's entries by f, Q's diagonal by f², and divides row and G likewise.
        let cost = |f: f64| {
            (column_a + column_q) * f + (row_a + row_g) / f + diagonal_q * f * f + diagonal_g / (f * f)
        };
        let mut best = 1.0;
        for direction in [2.0, 0.5] {
            let mut f = direction;
            for _ in 0..FACTOR_EXPONENT_MAX {
                let total = (self.scaling[i] * f).log2().abs();
                if cost(f) >= WORTHWHILE * cost(best) || total > SCALING_EXPONENT_MAX {
                    break;
                }
                best = f;
                f *= direction;
            }
        }
        best
    }

    fn scale(&mut self, i: usize, f: f64) {
        self.scaling[i] *= f;
        self.a.column_mut(i).scale_mut(f);
        self.a.row_mut(i).unscale_mut(f);
        self.q.column_mut(i).scale_mut(f);
        self.q.row_mut(i).scale_mut(f);
        self.g.column_mut(i).unscale_mut(f);
        self.g.row_mut(i).unscale_mut(f);
    }

    pub(super) fn symmetrize(&mut self) {
        self.g = (&self.g + self.g.transpose()) * 0.5;
        self.q = (&self.q + self.q.transpose()) * 0.5;
    }

    /// The balanced Hamiltonian matrix, `2n × 2n`.
    pub(super) fn hamiltonian(&self) -> DMatrix<f64> {
        let n = self.a.nrows();
        let mut h = DMatrix::zeros(2 * n, 2 * n);
        h.view_mut((0, 0), (n, n)).copy_from(&self.a);
        h.view_mut((0, n), (n, n)).copy_from(&-&self.g);
        h.view_mut((n, 0), (n, n)).copy_from(&-&self.q);
        h.view_mut((n, n), (n, n)).copy_from(&-self.a.transpose());
        h
    }
}

/// Sweeps allowed; balancing may stop at any of them without harm.
const BALANCING_SWEEPS_MAX: usize = 64;

/// Largest exponent of one scaling step.
const FACTOR_EXPONENT_MAX: usize = 64;

/// Largest exponent of a state's scaling; beyond it entries are rounding of zeros.
const SCALING_EXPONENT_MAX: f64 = 100.0;

/// A scaling step that gains less than five per cent is not taken (LAPACK's `GEBAL` uses the same figure).
const WORTHWHILE: f64 = 0.95;
