//! Chebyshev collocation on an interval: nodes, differentiation matrix, quadrature weights.

use nalgebra::DMatrix;

/// Chebyshev-Lobatto nodes on `[lower, upper]` with what is needed to differentiate and integrate on them.
///
/// **Shapes and units**: `n + 1` nodes for polynomial degree `n`, in ascending order; the differentiation matrix is
/// `(n + 1) x (n + 1)`.
#[derive(Debug, Clone, PartialEq)]
pub struct ChebyshevGrid {
    nodes: Vec<f64>,
    differentiation: DMatrix<f64>,
    weights: Vec<f64>,
}

impl ChebyshevGrid {
    /// Grid of polynomial degree `degree >= 1` on `[lower, upper]`.
    ///
    /// **Method**: off-diagonal entries by barycentric weights with sines of half angles for the node differences,
    /// diagonal as the negative row sum; weights by Clenshaw and Curtis.
    ///
    /// **Source**: Trefethen 2000, Spectral Methods in MATLAB, chapters 6 and 12; Baltensperger and Trummer 2003 for
    /// the negative sum.
    ///
    /// # Panics
    /// When `degree` is zero: a bug of the caller.
    #[must_use]
    pub fn new(degree: usize, lower: f64, upper: f64) -> Self {
        assert!(degree >= 1, "a Chebyshev grid needs two nodes");
        let n = degree;
        let half = (upper - lower) / 2.0;
        let angle = |k: usize| std::f64::consts::PI * k as f64 / n as f64;
        let nodes = (0..=n)
            .map(|k| match k {
                0 => lower,
                k if k == n => upper,
                _ => (lower + upper) / 2.0 - half * angle(k).cos(),
            })
            .collect();
        let mut differentiation = DMatrix::zeros(n + 1, n + 1);
        let end = |k: usize| if k == 0 || k == n { 2.0 } else { 1.0 };
        for i in 0..=n {
            let mut row_sum = 0.0;
            for j in (0..=n).filter(|&j| j != i) {
                // x_i - x_j = cos(a_j) - cos(a_i) = 2 sin((a_i + a_j)/2) sin((a_i - a_j)/2), without cancellation.
                let difference = 2.0
                    * ((angle(i) + angle(j)) / 2.0).sin()
                    * ((i as f64 - j as f64) * std::f64::consts::PI / (2.0 * n as f64)).sin();
                let sign = if (i + j).is_multiple_of(2) { 1.0 } else { -1.0 };
                let entry = sign * end(i) / end(j) / difference / half;
                differentiation[(i, j)] = entry;
                row_sum += entry;
            }
            differentiation[(i, i)] = -row_sum;
        }
        let weights = (0..=n)
            .map(|k| {
                let sum: f64 = (1..=n / 2)
                    .map(|m| {
                        let b = if 2 * m == n { 1.0 } else { 2.0 };
                        b * (2.0 * m as f64 * angle(k)).cos() / (4.0 * (m * m) as f64 - 1.0)
                    })
                    .sum();
                half * (2.0 / end(k)) * (1.0 - sum) / n as f64
            })
            .collect();
        Self { nodes, differentiation, weights }
    }

    /// Number of nodes.
    #[must_use]
    pub fn n_nodes(&self) -> usize {
        self.nodes.len()
    }

    /// Nodes in ascending order.
    #[must_use]
    pub fn nodes(&self) -> &[f64] {
        &self.nodes
    }

    /// Quadrature weights; exact for polynomials up to the grid's degree.
    #[must_use]
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// Matrix that turns values at the nodes into derivatives at the nodes.
    #[must_use]
    pub fn differentiation(&self) -> &DMatrix<f64> {
        &self.differentiation
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_exact_for_polynomials_and_spectral_for_exp() {
        for degree in [5, 16, 24] {
            let grid = ChebyshevGrid::new(degree, 0.2, 1.0);
            let cubic =
                nalgebra::DVector::from_iterator(degree + 1, grid.nodes().iter().map(|x| x * x * x - x));
            let slope = grid.differentiation() * cubic;
            for (x, d) in grid.nodes().iter().zip(slope.iter()) {
                // Rounding grows with degree^2.
                assert!((d - (3.0 * x * x - 1.0)).abs() < 1e-12 * (degree * degree) as f64, "{degree} {x}");
            }
            let integral: f64 = grid.nodes().iter().zip(grid.weights()).map(|(x, w)| w * x.powi(3)).sum();
            assert!((integral - (1.0 - 0.2_f64.powi(4)) / 4.0).abs() < 1e-15);
        }
        let grid = ChebyshevGrid::new(16, -1.0, 2.0);
        let integral: f64 = grid.nodes().iter().zip(grid.weights()).map(|(x, w)| w * x.exp()).sum();
        assert!((integral - (2.0_f64.exp() - (-1.0_f64).exp())).abs() < 1e-13);
    }
}
