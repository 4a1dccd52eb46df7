//! LU factors of a small dense matrix in place, with partial pivoting.

/// A square matrix and, after [`Factors::factor`], its LU factors.
///
/// **Shapes and units**: at most `capacity x capacity`, rows next to each other; no call but [`Factors::new`] allocates.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Factors {
    size: usize,
    entries: Vec<f64>,
    pivots: Vec<usize>,
    inverse_diagonal: Vec<f64>,
}

/// A pivot smaller than this part of the largest entry means a singular matrix.
const SINGULAR: f64 = 1e-15;

impl Factors {
    pub(crate) fn new(capacity: usize) -> Self {
        Self {
            size: 0,
            entries: vec![0.0; capacity * capacity],
            pivots: vec![0; capacity],
            inverse_diagonal: vec![0.0; capacity],
        }
    }

    /// Zeros of a new size, which does not exceed the capacity.
    pub(crate) fn reset(&mut self, size: usize) {
        self.size = size;
        self.entries[..size * size].fill(0.0);
    }

    #[inline]
    pub(crate) fn row_mut(&mut self, i: usize) -> &mut [f64] {
        &mut self.entries[i * self.size..(i + 1) * self.size]
    }

    /// Factors in place; false for a singular matrix.
    pub(crate) fn factor(&mut self) -> bool {
        let n = self.size;
        let entries = &mut self.entries[..n * n];
        let largest = entries.iter().fold(0.0, |a: f64, b| a.max(b.abs()));
        if !largest.is_finite() {
            return false;
        }
        for k in 0..n {
            let (mut pivot, mut best) = (k, entries[k * n + k].abs());
            for i in k + 1..n {
                let size = entries[i * n + k].abs();
                if size > best {
                    (pivot, best) = (i, size);
                }
            }
            if best <= SINGULAR * largest {
                return false;
            }
            self.pivots[k] = pivot;
            let (above, below) = entries.split_at_mut((k + 1) * n);
            let row_k = &mut above[k * n..];
            if pivot > k {
                let start = (pivot - k - 1) * n;
                row_k.swap_with_slice(&mut below[start..start + n]);
            }
            let inverse = 1.0 / row_k[k];
            self.inverse_diagonal[k] = inverse;
            let tail = &row_k[k + 1..];
            for row in below.chunks_exact_mut(n) {
                let factor = row[k] * inverse;
                row[k] = factor;
                for (value, upper) in row[k + 1..].iter_mut().zip(tail) {
                    *value -= factor * upper;
                }
            }
        }
        true
    }

    /// Replaces the right-hand side by the solution.
    pub(crate) fn solve(&self, rhs: &mut [f64]) {
        let n = self.size;
        let rhs = &mut rhs[..n];
        for k in 0..n {
            rhs.swap(k, self.pivots[k]);
        }
        for i in 1..n {
            let row = &self.entries[i * n..i * n + i];
            rhs[i] -= dot(row, &rhs[..i]);
        }
        for i in (0..n).rev() {
            let row = &self.entries[i * n + i + 1..(i + 1) * n];
            rhs[i] = (rhs[i] - dot(row, &rhs[i + 1..])) * self.inverse_diagonal[i];
        }
    }
}

/// Scalar product in four chains, which the processor runs side by side.
#[inline]
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 4];
    let (quads_a, quads_b) = (a.chunks_exact(4), b.chunks_exact(4));
    let rest: f64 = quads_a.remainder().iter().zip(quads_b.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in quads_a.zip(quads_b) {
        for lane in 0..4 {
            sums[lane] += x[lane] * y[lane];
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_solution_satisfies_the_equations_and_singular_is_seen() {
        let n = 9;
        let entry = |i: usize, j: usize| ((3 * i + 7 * j * j + i * j) % 11) as f64 - 5.0;
        let mut lu = Factors::new(12);
        lu.reset(n);
        for i in 0..n {
            for (j, value) in lu.row_mut(i).iter_mut().enumerate() {
                // A zero diagonal needs the row exchange.
                *value = if i == j { 0.0 } else { entry(i, j) };
            }
        }
        let matrix: Vec<f64> = lu.entries[..n * n].to_vec();
        assert!(lu.factor());
        let rhs: Vec<f64> = (0..n).map(|i| i as f64 - 3.5).collect();
        let mut solution = rhs.clone();
        lu.solve(&mut solution);
        for i in 0..n {
            let found = dot(&matrix[i * n..(i + 1) * n], &solution);
            assert!((found - rhs[i]).abs() < 1e-12, "{found} {}", rhs[i]);
        }
        lu.reset(2);
        for i in 0..2 {
            lu.row_mut(i).copy_from_slice(&[1.0, 2.0]);
        }
        assert!(!lu.factor());
    }
}
