//! The grid's matrices laid out for speed: a product with a vector runs over columns, one with a matrix over rows.

use crate::collocation::ChebyshevGrid;

/// Differentiation on a grid, with nodes and weights at hand.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Operator {
    /// Degree; `degree + 1` nodes, `degree - 1` of them inner ones.
    pub(crate) degree: usize,
    pub(crate) rho: Vec<f64>,
    pub(crate) inverse_rho: Vec<f64>,
    pub(crate) weights: Vec<f64>,
    /// Column j at `j (degree + 1)`.
    columns: Vec<f64>,
    /// Row j without its first and last entry, at `j (degree - 1)`.
    inner_rows: Vec<f64>,
    /// Largest entry of the differentiation matrix: one differentiation multiplies rounding by it.
    pub(crate) largest: f64,
    grid: ChebyshevGrid,
}

impl Operator {
    pub(crate) fn new(grid: ChebyshevGrid) -> Self {
        let n = grid.n_nodes() - 1;
        let d = grid.differentiation();
        let inner_rows = (0..=n).flat_map(|j| (1..n).map(move |k| d[(j, k)])).collect();
        Self {
            degree: n,
            rho: grid.nodes().to_vec(),
            inverse_rho: grid.nodes().iter().map(|rho| 1.0 / rho).collect(),
            weights: grid.weights().to_vec(),
            // Storage of nalgebra runs down the columns.
            columns: d.as_slice().to_vec(),
            inner_rows,
            largest: d.amax(),
            grid,
        }
    }

    pub(crate) fn grid(&self) -> &ChebyshevGrid {
        &self.grid
    }

    /// Row j of the differentiation matrix at the inner nodes.
    #[inline]
    pub(crate) fn inner_row(&self, j: usize) -> &[f64] {
        let width = self.degree - 1;
        &self.inner_rows[j * width..(j + 1) * width]
    }

    /// `out = D x`.
    #[inline]
    pub(crate) fn differentiate(&self, x: &[f64], out: &mut [f64]) {
        let size = self.degree + 1;
        let out = &mut out[..size];
        out.fill(0.0);
        let mut pairs = self.columns.chunks_exact(2 * size);
        let mut j = 0;
        for pair in pairs.by_ref() {
            let (first, second) = pair.split_at(size);
            let (x0, x1) = (x[j], x[j + 1]);
            for ((value, a), b) in out.iter_mut().zip(first).zip(second) {
                *value += x0 * a + x1 * b;
            }
            j += 2;
        }
        for column in pairs.remainder().chunks_exact(size) {
            for (value, a) in out.iter_mut().zip(column) {
                *value += x[j] * a;
            }
            j += 1;
        }
    }

    /// Row i of the inner part of `D diag(scale) D`, added to `out`.
    #[inline]
    pub(crate) fn add_product_row(&self, i: usize, scale: &[f64], out: &mut [f64]) {
        let width = self.degree - 1;
        let size = self.degree + 1;
        let out = &mut out[..width];
        let coefficient = |j: usize| self.columns[j * size + i] * scale[j];
        let mut j = 0;
        let mut blocks = self.inner_rows.chunks_exact(4 * width);
        for block in blocks.by_ref() {
            let (low, high) = block.split_at(2 * width);
            let ((b0, b1), (b2, b3)) = (low.split_at(width), high.split_at(width));
            let c = [coefficient(j), coefficient(j + 1), coefficient(j + 2), coefficient(j + 3)];
            for k in 0..width {
                out[k] += (c[0] * b0[k] + c[1] * b1[k]) + (c[2] * b2[k] + c[3] * b3[k]);
            }
            j += 4;
        }
        for row in blocks.remainder().chunks_exact(width) {
            let c = coefficient(j);
            for (value, b) in out.iter_mut().zip(row) {
                *value += c * b;
            }
            j += 1;
        }
    }
}
