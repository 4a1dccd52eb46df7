//! A smooth function of displacement and squared voltage as a polynomial that is cheap to evaluate.

/// An interval with its map to -1..1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Axis {
    center: f64,
    half: f64,
    inverse_half: f64,
}

impl Axis {
    pub(super) fn new(lower: f64, upper: f64) -> Self {
        let half = (upper - lower) / 2.0;
        Self { center: (lower + upper) / 2.0, half, inverse_half: 1.0 / half }
    }

    #[inline]
    pub(super) fn normalized(&self, value: f64) -> f64 {
        (value - self.center) * self.inverse_half
    }

    pub(super) fn center(&self) -> f64 {
        self.center
    }

    pub(super) fn half(&self) -> f64 {
        self.half
    }

    #[inline]
    pub(super) fn inverse_half(&self) -> f64 {
        self.inverse_half
    }

    pub(super) fn lower(&self) -> f64 {
        self.center - self.half
    }

    pub(super) fn upper(&self) -> f64 {
        self.center + self.half
    }

    /// The `n` Chebyshev-Lobatto points, ascending.
    pub(super) fn points(&self, n: usize) -> Vec<f64> {
        (0..n).map(|k| self.center - self.half * lobatto_angle(k, n).cos()).collect()
    }
}

/// Polynomial in two normalized coordinates, powers of y outside, powers of x inside.
///
/// **Accuracy**: powers instead of Chebyshev polynomials lose a factor of (1 + sqrt(2))^NX of rounding, 2e4 at NX = 11,
/// which leaves 1e-11; in return one evaluation at fixed y is a Horner chain over a flat array.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Surface<const NX: usize, const NY: usize> {
    coefficients: [[f64; NX]; NY],
}

/// A [`Surface`] at one y: polynomial in normalized x, ascending powers.
pub(super) type Slice<const NX: usize> = [f64; NX];

impl<const NX: usize, const NY: usize> Surface<NX, NY> {
    /// Interpolates values at the tensor of Chebyshev-Lobatto points: `values[iy][ix]`.
    pub(super) fn interpolate(values: &[[f64; NX]; NY]) -> Self {
        let slices = values.map(|row| powers(&chebyshev_coefficients(&row)));
        let mut coefficients = [[0.0; NX]; NY];
        for ix in 0..NX {
            let mut column = [0.0; NY];
            for iy in 0..NY {
                column[iy] = slices[iy][ix];
            }
            let column = powers(&chebyshev_coefficients(&column));
            for iy in 0..NY {
                coefficients[iy][ix] = column[iy];
            }
        }
        Self { coefficients }
    }

    /// The polynomial in x at normalized `y`.
    #[inline]
    pub(super) fn slice(&self, y: f64) -> Slice<NX> {
        let mut slice = self.coefficients[NY - 1];
        for row in self.coefficients[..NY - 1].iter().rev() {
            for (value, coefficient) in slice.iter_mut().zip(row) {
                *value = *value * y + coefficient;
            }
        }
        slice
    }

    /// Coefficients: `[power of y][power of x]`.
    pub(super) fn coefficients(&self) -> &[[f64; NX]; NY] {
        &self.coefficients
    }

    /// Value at normalized coordinates.
    pub(super) fn at(&self, x: f64, y: f64) -> f64 {
        value(&self.slice(y), x)
    }
}

/// Value of a polynomial at normalized `x`, ascending powers; `NX` is even.
#[inline]
pub(super) fn value<const NX: usize>(slice: &Slice<NX>, x: f64) -> f64 {
    // Even and odd powers in two chains, which the processor runs side by side.
    let x2 = x * x;
    let (mut even, mut odd) = (slice[NX - 2], slice[NX - 1]);
    for pair in (0..NX / 2 - 1).rev() {
        even = even * x2 + slice[2 * pair];
        odd = odd * x2 + slice[2 * pair + 1];
    }
    even + x * odd
}

/// Derivative of a polynomial by normalized `x`.
pub(super) fn slope<const NX: usize>(slice: &Slice<NX>, x: f64) -> f64 {
    slice
        .iter()
        .enumerate()
        .skip(1)
        .rev()
        .fold(0.0, |sum, (power, coefficient)| sum * x + power as f64 * coefficient)
}

fn lobatto_angle(k: usize, n: usize) -> f64 {
    std::f64::consts::PI * k as f64 / (n - 1) as f64
}

/// Discrete cosine transform of values at ascending Lobatto points.
fn chebyshev_coefficients<const N: usize>(values: &[f64; N]) -> [f64; N] {
    let last = N - 1;
    let end = |k: usize| if k == 0 || k == last { 0.5 } else { 1.0 };
    let mut coefficients = [0.0; N];
    for (m, coefficient) in coefficients.iter_mut().enumerate() {
        let sum: f64 = values
            .iter()
            .enumerate()
            // Ascending points stand at x = -cos(angle), so T_m(x_k) = (-1)^m cos(m angle_k).
            .map(|(k, v)| end(k) * v * (m as f64 * lobatto_angle(k, N)).cos())
            .sum();
        let sign = if m.is_multiple_of(2) { 1.0 } else { -1.0 };
        *coefficient = sign * 2.0 * end(m) * sum / last as f64;
    }
    coefficients
}

/// Powers from Chebyshev coefficients, by T_{k+1} = 2 x T_k - T_{k-1}.
fn powers<const N: usize>(chebyshev: &[f64; N]) -> [f64; N] {
    let mut previous = [0.0; N];
    let mut current = [0.0; N];
    let mut sum = [0.0; N];
    previous[0] = 1.0;
    sum[0] = chebyshev[0];
    if N > 1 {
        current[1] = 1.0;
        sum[1] += chebyshev[1];
    }
    for &coefficient in chebyshev.iter().skip(2) {
        let mut next = [0.0; N];
        for power in 0..N {
            let shifted = if power > 0 { current[power - 1] } else { 0.0 };
            next[power] = 2.0 * shifted - previous[power];
        }
        for (total, entry) in sum.iter_mut().zip(&next) {
            *total += coefficient * entry;
        }
        previous = current;
        current = next;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_surface_reproduces_a_polynomial_and_its_slope() {
        let (x_axis, y_axis) = (Axis::new(1.0, 3.0), Axis::new(0.0, 2.0));
        let f = |x: f64, y: f64| x.powi(4) - 2.0 * x * y * y + y - 0.5;
        let (xs, ys) = (x_axis.points(6), y_axis.points(4));
        let values = std::array::from_fn(|iy| std::array::from_fn(|ix| f(xs[ix], ys[iy])));
        let surface = Surface::<6, 4>::interpolate(&values);
        for (x, y) in [(1.1, 0.3), (2.9, 1.9), (2.0, 0.0)] {
            let (u, w) = (x_axis.normalized(x), y_axis.normalized(y));
            assert!((surface.at(u, w) - f(x, y)).abs() < 1e-12);
            let slice = surface.slice(w);
            let dx = 4.0 * x.powi(3) - 2.0 * y * y;
            assert!((slope(&slice, u) / x_axis.half() - dx).abs() < 1e-11);
        }
    }
}
