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
    /// Slope of the map from -1..1 to the interval, at the nodes.
    slopes: Vec<f64>,
}

impl ChebyshevGrid {
    /// Grid of polynomial degree `degree >= 1` on `[lower, upper]`.
    ///
    /// # Panics
    /// When `degree` is zero: a bug of the caller.
    #[must_use]
    pub fn new(degree: usize, lower: f64, upper: f64) -> Self {
        let (center, half) = ((lower + upper) / 2.0, (upper - lower) / 2.0);
        Self::mapped(degree, [lower, upper], |s| (center + half * s, half))
    }

    /// Grid on `[lower, upper]`, `0 < lower`, for functions that are polynomials of degree `degree` in the logarithm.
    ///
    /// **Accuracy**: powers of the coordinate, 1/R among them, are entire functions of ln R, so the number of nodes that
    /// they need hardly depends on how close `lower` is to zero.
    ///
    /// # Panics
    /// When `degree` is zero or `lower` not positive: a bug of the caller.
    #[must_use]
    pub fn logarithmic(degree: usize, lower: f64, upper: f64) -> Self {
        assert!(lower > 0.0, "a logarithmic grid starts above zero");
        let (center, half) = ((lower * upper).sqrt(), (upper / lower).ln() / 2.0);
        Self::mapped(degree, [lower, upper], |s| {
            let node = center * (half * s).exp();
            (node, half * node)
        })
    }

    /// Grid whose nodes are the images of the Chebyshev-Lobatto points under `map`, which returns value and slope.
    ///
    /// **Method**: off-diagonal entries by barycentric weights with sines of half angles for the node differences,
    /// diagonal as the negative row sum; weights by Clenshaw and Curtis; then the chain rule.
    ///
    /// **Source**: Trefethen 2000, Spectral Methods in MATLAB, chapters 6 and 12; Baltensperger and Trummer 2003 for
    /// the negative sum.
    fn mapped(degree: usize, ends: [f64; 2], map: impl Fn(f64) -> (f64, f64)) -> Self {
        assert!(degree >= 1, "a Chebyshev grid needs two nodes");
        let n = degree;
        // sin(k pi/(2n)): every angle that occurs below is one of these.
        let sine: Vec<f64> =
            (0..=2 * n).map(|k| (std::f64::consts::PI * k as f64 / (2 * n) as f64).sin()).collect();
        let mapped: Vec<(f64, f64)> = (0..=n)
            // -cos(k pi/n) = sin((2k - n) pi/(2n)), which is exactly odd about the middle.
            .map(|k| map(if 2 * k >= n { sine[2 * k - n] } else { -sine[n - 2 * k] }))
            .collect();
        let mut nodes: Vec<f64> = mapped.iter().map(|(node, _)| *node).collect();
        (nodes[0], nodes[n]) = (ends[0], ends[1]);
        let mut differentiation = DMatrix::zeros(n + 1, n + 1);
        let end = |k: usize| if k == 0 || k == n { 2.0 } else { 1.0 };
        for i in 0..=n {
            let slope = mapped[i].1;
            let mut row_sum = 0.0;
            for j in (0..=n).filter(|&j| j != i) {
                // s_i - s_j = cos(a_j) - cos(a_i) = 2 sin((a_i + a_j)/2) sin((a_i - a_j)/2), without cancellation.
                let size = 2.0 * sine[i + j] * sine[i.abs_diff(j)];
                let sign = if (i + j).is_multiple_of(2) == (i > j) { 1.0 } else { -1.0 };
                let entry = sign * end(i) / (end(j) * size * slope);
                differentiation[(i, j)] = entry;
                row_sum += entry;
            }
            differentiation[(i, i)] = -row_sum;
        }
        let weights = clenshaw_curtis(n, &sine)
            .iter()
            .zip(&mapped)
            .map(|(weight, (_, slope))| weight * slope)
            .collect();
        let slopes = mapped.iter().map(|(_, slope)| *slope).collect();
        Self { nodes, differentiation, weights, slopes }
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

    /// Antiderivative at the nodes of the function with these values at the nodes, zero at the upper end.
    ///
    /// **Method**: Chebyshev coefficients of the values times the map's slope, integrated term by term; exact for the
    /// interpolant.
    #[must_use]
    pub fn antiderivative_from_upper(&self, values: &[f64]) -> Vec<f64> {
        let n = self.nodes.len() - 1;
        let scaled: Vec<f64> = values.iter().zip(&self.slopes).map(|(v, slope)| v * slope).collect();
        let c = self.coefficients(&scaled);
        let cosine = cosines(n);
        let at = |m: usize| c.get(m).copied().unwrap_or(0.0);
        let integrated: Vec<f64> = (1..=n + 1)
            .map(|m| (if m == 1 { 2.0 * at(0) } else { at(m - 1) } - at(m + 1)) / (2.0 * m as f64))
            .collect();
        (0..=n)
            .map(|k| {
                // T_m(s_k) - T_m(1) with s_k = -cos(k pi/n).
                let term = |m: usize| {
                    let sign = if m.is_multiple_of(2) { 1.0 } else { -1.0 };
                    sign * cosine[m * k % (2 * n)] - 1.0
                };
                integrated.iter().zip(1..).map(|(b, m)| b * term(m)).sum()
            })
            .collect()
    }

    /// Size of the two highest Chebyshev coefficients of the values at the nodes relative to the largest one: how well the
    /// grid resolves them. Coefficients at the level of rounding of numbers of order one count as zero.
    #[must_use]
    pub fn tail(&self, values: &[f64]) -> f64 {
        let c = self.coefficients(values);
        let largest = c.iter().fold(0.0, |a: f64, b| a.max(b.abs()));
        let tail = c.iter().rev().take(2).fold(0.0, |a: f64, b| a.max(b.abs())) - ROUNDING;
        if tail > 0.0 { tail / largest } else { 0.0 }
    }

    /// Least value of the interpolant of the values at the nodes, sought about the smallest of them.
    ///
    /// **Method**: where that stands at an inner node, Newton on the slope over the angle, at most eight steps, not beyond
    /// the neighbouring nodes.
    #[must_use]
    pub fn minimum(&self, values: &[f64]) -> f64 {
        let n = self.nodes.len() - 1;
        let (mut node, mut least) = (0, values[0]);
        for (j, &value) in values.iter().enumerate() {
            if value < least {
                (node, least) = (j, value);
            }
        }
        if node == 0 || node == n {
            return least;
        }
        let c = self.coefficients(values);
        let spacing = std::f64::consts::PI / n as f64;
        let start = spacing * (n - node) as f64;
        let mut angle = start;
        for _ in 0..8 {
            let [value, slope, curvature] = cosine_series(&c, angle);
            least = least.min(value);
            if curvature <= 0.0 {
                break;
            }
            let next = (angle - slope / curvature).clamp(start - spacing, start + spacing);
            if (next - angle).abs() < 1e-9 {
                break;
            }
            angle = next;
        }
        least
    }

    /// Chebyshev coefficients of the interpolant in the coordinate -1..1.
    fn coefficients(&self, values: &[f64]) -> Vec<f64> {
        let n = self.nodes.len() - 1;
        let cosine = cosines(n);
        let end = |k: usize| if k == 0 || k == n { 0.5 } else { 1.0 };
        (0..=n)
            .map(|m| {
                let sign = if m.is_multiple_of(2) { 1.0 } else { -1.0 };
                let sum: f64 =
                    values.iter().enumerate().map(|(k, v)| end(k) * v * cosine[m * k % (2 * n)]).sum();
                sign * 2.0 * end(m) * sum / n as f64
            })
            .collect()
    }
}

/// Value, first and second derivative of the sum of c_m cos(m t).
fn cosine_series(c: &[f64], t: f64) -> [f64; 3] {
    let (sin1, cos1) = t.sin_cos();
    let (mut sin, mut cos) = (0.0, 1.0);
    let mut sums = [0.0; 3];
    for (m, coefficient) in c.iter().enumerate() {
        let m = m as f64;
        sums[0] += coefficient * cos;
        sums[1] -= m * coefficient * sin;
        sums[2] -= m * m * coefficient * cos;
        (sin, cos) = (sin * cos1 + cos * sin1, cos * cos1 - sin * sin1);
    }
    sums
}

/// cos(k pi/n) over one period.
fn cosines(n: usize) -> Vec<f64> {
    (0..2 * n).map(|k| (std::f64::consts::PI * k as f64 / n as f64).cos()).collect()
}

/// Rounding of a coefficient of values of order one.
const ROUNDING: f64 = 2e-15;

/// Quadrature weights on `[-1, 1]` from the table sin(k pi/(2n)).
fn clenshaw_curtis(n: usize, sine: &[f64]) -> Vec<f64> {
    // cos(2 m k pi/n) = 1 - 2 sin^2(m k pi/n), and the sine has period n in m k up to its sign.
    let cosine = |m: usize, k: usize| 1.0 - 2.0 * sine[2 * (m * k % n)].powi(2);
    (0..=n)
        .map(|k| {
            let sum: f64 = (1..=n / 2)
                .map(|m| {
                    let b = if 2 * m == n { 1.0 } else { 2.0 };
                    b * cosine(m, k) / (4.0 * (m * m) as f64 - 1.0)
                })
                .sum();
            let end = if k == 0 || k == n { 0.5 } else { 1.0 };
            2.0 * end * (1.0 - sum) / n as f64
        })
        .collect()
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
    #[test]
    fn law_logarithmic_grid_needs_few_nodes_close_to_zero() {
        let grid = ChebyshevGrid::logarithmic(24, 0.05, 1.0);
        let inverse = nalgebra::DVector::from_iterator(25, grid.nodes().iter().map(|x| 1.0 / x));
        let slope = grid.differentiation() * inverse;
        for (x, d) in grid.nodes().iter().zip(slope.iter()) {
            // Rounding of values up to 20 under a matrix with entries up to degree^2/(half range of the logarithm)/x.
            assert!((d * x * x + 1.0).abs() < 1e-11, "{x} {d}");
        }
        let integral: f64 = grid.nodes().iter().zip(grid.weights()).map(|(x, w)| w * x).sum();
        assert!((integral - (1.0 - 0.05_f64.powi(2)) / 2.0).abs() < 1e-14);
    }
    #[test]
    fn law_antiderivative_undoes_differentiation_and_tail_falls_with_the_degree() {
        for grid in [ChebyshevGrid::new(17, 0.2, 1.0), ChebyshevGrid::logarithmic(24, 0.1, 1.0)] {
            let values: Vec<f64> = grid.nodes().iter().map(|x| (2.0 * x).cos()).collect();
            let found = grid.antiderivative_from_upper(&values);
            for (x, value) in grid.nodes().iter().zip(found) {
                let expected = 0.5 * ((2.0 * x).sin() - 2.0_f64.sin());
                assert!((value - expected).abs() < 1e-13, "{x}: {value} {expected}");
            }
        }
        let tail = |degree| {
            let grid = ChebyshevGrid::new(degree, -1.0, 1.0);
            let values: Vec<f64> = grid.nodes().iter().map(|x| 1.0 / (1.5 - x)).collect();
            grid.tail(&values)
        };
        // Coefficients fall as (1.5 + sqrt(1.25))^-k = 2.618^-k.
        assert!((tail(8) / tail(16) / 2.618_f64.powi(8)).ln().abs() < 0.2, "{} {}", tail(8), tail(16));
    }
    #[test]
    fn law_minimum_between_the_nodes_is_found() {
        let grid = ChebyshevGrid::logarithmic(20, 0.1, 1.0);
        let values: Vec<f64> = grid.nodes().iter().map(|x| x + 0.09 / x).collect();
        // x + c/x has its minimum 2 sqrt(c) at sqrt(c).
        assert!((grid.minimum(&values) - 0.6).abs() < 1e-13);
        assert_eq!(grid.minimum(grid.nodes()), 0.1);
    }
}
