//! Real Schur form and its reordering: the tool behind invariant subspaces, Riccati and Lyapunov equations.
//!
//! The unordered form comes from `nalgebra`; this file puts its 2×2 blocks into standard form and moves
//! chosen eigenvalues to the leading position with orthogonal swaps of neighbouring blocks.

use nalgebra::{DMatrix, Matrix4, Schur, Vector4};
use num_complex::Complex64;

use crate::Error;

/// A real Schur form `M = Q T Qᵀ` with standardised 2×2 blocks (equal diagonal, off-diagonals of opposite sign).
#[derive(Clone, Debug, PartialEq)]
pub struct RealSchur {
    /// Orthogonal factor, `n × n`.
    pub q: DMatrix<f64>,
    /// Upper quasi-triangular factor, `n × n`.
    pub t: DMatrix<f64>,
}

/// A real Schur form whose selected eigenvalues come first.
#[derive(Clone, Debug, PartialEq)]
pub struct OrderedSchur {
    /// The reordered form.
    pub form: RealSchur,
    /// Number of selected eigenvalues, i.e. the dimension of the leading invariant subspace.
    pub n_selected: usize,
    /// Largest entry discarded in a swap, relative to the norm of the four entries around it; of the order of the
    /// machine precision when every swap was sound.
    pub worst_swap: f64,
}

impl RealSchur {
    /// Returns the real Schur form of a square matrix.
    ///
    /// **Method**: Francis double-shift QR (`nalgebra`). Where that does not converge, the matrix is rotated by a
    /// fixed orthogonal matrix and tried again: QR without exceptional shifts stalls on symmetric patterns only.
    ///
    /// **Errors**: [`Error::Shape`], [`Error::NotFinite`], [`Error::EigenvaluesNotConverged`].
    pub fn new(m: &DMatrix<f64>) -> Result<Self, Error> {
        let n = m.nrows();
        if n != m.ncols() {
            let (expected_rows, expected_cols, rows, cols) = (n, n, n, m.ncols());
            return Err(Error::Shape { matrix: "m", expected_rows, expected_cols, rows, cols });
        }
        if let Some((index, &value)) = m.iter().enumerate().find(|(_, v)| !v.is_finite()) {
            return Err(Error::NotFinite { quantity: "m", index, value });
        }
        if n == 0 {
            return Ok(Self { q: DMatrix::zeros(0, 0), t: DMatrix::zeros(0, 0) });
        }
        let max_iterations = 100 * n + 100;
        for attempt in 0..MAX_ATTEMPTS {
            let rotation = (attempt > 0).then(|| fixed_rotation(n, attempt));
            let work = match &rotation {
                None => m.clone(),
                Some(p) => p.transpose() * m * p,
            };
            if let Some(schur) = Schur::try_new(work, f64::EPSILON, max_iterations) {
                let (q, t) = schur.unpack();
                if q.iter().chain(t.iter()).all(|v| v.is_finite()) {
                    let q = match rotation {
                        None => q,
                        Some(p) => p * q,
                    };
                    let mut form = Self { q, t };
                    form.clean();
                    return Ok(form);
                }
            }
        }
        Err(Error::EigenvaluesNotConverged { n, iterations: max_iterations })
    }

    /// Returns the eigenvalues in the order in which they stand on the diagonal.
    pub fn eigenvalues(&self) -> Vec<Complex64> {
        let mut values = Vec::with_capacity(self.t.nrows());
        for (start, size) in self.blocks() {
            if size == 1 {
                values.push(Complex64::new(self.t[(start, start)], 0.0));
            } else {
                let (re, im) = (self.t[(start, start)], block_imaginary(&self.t, start));
                values.push(Complex64::new(re, im));
                values.push(Complex64::new(re, -im));
            }
        }
        values
    }

    /// Returns first index and size (1 or 2) of every diagonal block, from the top.
    pub fn blocks(&self) -> Vec<(usize, usize)> {
        let n = self.t.nrows();
        let mut blocks = Vec::with_capacity(n);
        let mut start = 0;
        while start < n {
            let size = if start + 1 < n && self.t[(start + 1, start)] != 0.0 { 2 } else { 1 };
            blocks.push((start, size));
            start += size;
        }
        blocks
    }

    /// Moves the eigenvalues for which `select` holds to the top.
    ///
    /// **Method**: bubbles each selected block upwards by orthogonal swaps with its upper neighbour. A swap of
    /// 1×1 blocks is one Givens rotation; larger ones solve a small Sylvester equation and take its QR factor.
    ///
    /// **Source**: Bai and Demmel, "On swapping diagonal blocks in real Schur form", 1993.
    ///
    /// **Errors**: [`Error::SwapFailed`] when two eigenvalues are too close to be told apart in this order.
    pub fn order(mut self, select: impl Fn(Complex64) -> bool) -> Result<OrderedSchur, Error> {
        let mut target = 0;
        let mut worst_swap: f64 = 0.0;
        let mut position = 0;
        while position < self.t.nrows() {
            let size = self.block_size(position);
            let im = if size == 2 { block_imaginary(&self.t, position) } else { 0.0 };
            if select(Complex64::new(self.t[(position, position)], im)) {
                let mut here = position;
                while here > target {
                    // The block above starts one or two rows up.
                    let above = if here >= target + 2 && self.t[(here - 1, here - 2)] != 0.0 { 2 } else { 1 };
                    worst_swap = worst_swap.max(self.swap(here - above, above, size)?);
                    here -= above;
                }
                target += size;
            }
            position += size;
        }
        Ok(OrderedSchur { form: self, n_selected: target, worst_swap })
    }

    fn block_size(&self, start: usize) -> usize {
        if start + 1 < self.t.nrows() && self.t[(start + 1, start)] != 0.0 { 2 } else { 1 }
    }

    /// Sets what must be zero to zero and standardises every 2×2 block.
    fn clean(&mut self) {
        let n = self.t.nrows();
        for j in 0..n {
            for i in (j + 2)..n {
                self.t[(i, j)] = 0.0;
            }
        }
        let mut start = 0;
        while start < n {
            if self.block_size(start) == 2 {
                self.standardize(start);
                start += 2;
            } else {
                start += 1;
            }
        }
    }

    /// Brings the 2×2 block at `start` into standard form; it may fall apart into two real eigenvalues.
    fn standardize(&mut self, start: usize) {
        let (i, j) = (start, start + 1);
        let block = StandardBlock::new(self.t[(i, i)], self.t[(i, j)], self.t[(j, i)], self.t[(j, j)]);
        let n = self.t.nrows();
        for k in (j + 1)..n {
            let (x, y) = (self.t[(i, k)], self.t[(j, k)]);
            self.t[(i, k)] = block.cos * x + block.sin * y;
            self.t[(j, k)] = block.cos * y - block.sin * x;
        }
        rotate_columns(&mut self.t, i, j, i, block.cos, block.sin);
        rotate_columns(&mut self.q, i, j, n, block.cos, block.sin);
        self.t[(i, i)] = block.a;
        self.t[(i, j)] = block.b;
        self.t[(j, i)] = block.c;
        self.t[(j, j)] = block.d;
    }

    /// Swaps the block of size `n1` at `start` with the block of size `n2` below it; returns what was discarded.
    fn swap(&mut self, start: usize, n1: usize, n2: usize) -> Result<f64, Error> {
        let size = n1 + n2;
        let mut local = Matrix4::zeros();
        for i in 0..size {
            for j in 0..size {
                local[(i, j)] = self.t[(start + i, start + j)];
            }
        }
        let z = swap_rotation(&local, n1, n2)?;
        let moved = z.transpose() * local * z;
        let scale = local.norm().max(f64::MIN_POSITIVE);
        let mut discarded: f64 = 0.0;
        for i in n2..size {
            for j in 0..n2 {
                discarded = discarded.max(moved[(i, j)].abs());
            }
        }
        let discarded = discarded / scale;
        if discarded.is_nan() || discarded > SWAP_TOLERANCE {
            return Err(Error::SwapFailed { discarded });
        }
        self.apply(start, size, &z);
        for j in 0..n2 {
            for i in n2..size {
                self.t[(start + i, start + j)] = 0.0;
            }
        }
        if n2 == 2 {
            self.standardize(start);
        }
        if n1 == 2 {
            self.standardize(start + n2);
        }
        Ok(discarded)
    }

    /// Applies the orthogonal `z` (leading `size × size` part) as a similarity at `start`.
    fn apply(&mut self, start: usize, size: usize, z: &Matrix4<f64>) {
        let n = self.t.nrows();
        for k in start..n {
            let mut old = Vector4::zeros();
            for i in 0..size {
                old[i] = self.t[(start + i, k)];
            }
            let new = z.tr_mul(&old);
            for i in 0..size {
                self.t[(start + i, k)] = new[i];
            }
        }
        for (matrix, rows) in [(&mut self.t, start + size), (&mut self.q, n)] {
            for k in 0..rows {
                let mut old = Vector4::zeros();
                for i in 0..size {
                    old[i] = matrix[(k, start + i)];
                }
                let new = z.tr_mul(&old);
                for i in 0..size {
                    matrix[(k, start + i)] = new[i];
                }
            }
        }
    }
}

/// Positive imaginary part of the standardised 2×2 block at `start`.
fn block_imaginary(t: &DMatrix<f64>, start: usize) -> f64 {
    t[(start, start + 1)].abs().sqrt() * t[(start + 1, start)].abs().sqrt()
}

fn rotate_columns(m: &mut DMatrix<f64>, i: usize, j: usize, rows: usize, cos: f64, sin: f64) {
    for k in 0..rows {
        let (x, y) = (m[(k, i)], m[(k, j)]);
        m[(k, i)] = cos * x + sin * y;
        m[(k, j)] = cos * y - sin * x;
    }
}

/// Orthogonal matrix whose leading `n2` columns span the invariant subspace of the lower block.
fn swap_rotation(local: &Matrix4<f64>, n1: usize, n2: usize) -> Result<Matrix4<f64>, Error> {
    // T11 X - X T22 = T12 makes [-X; I] invariant: T [-X; I] = [-X; I] T22.
    let unknowns = n1 * n2;
    let mut system = Matrix4::<f64>::identity();
    let mut rhs = Vector4::zeros();
    let index = |i: usize, j: usize| i + n1 * j;
    for j in 0..n2 {
        for i in 0..n1 {
            let row = index(i, j);
            system[(row, row)] = 0.0;
            rhs[row] = local[(i, n1 + j)];
        }
    }
    for j in 0..n2 {
        for i in 0..n1 {
            let row = index(i, j);
            for k in 0..n1 {
                system[(row, index(k, j))] += local[(i, k)];
            }
            for k in 0..n2 {
                system[(row, index(i, k))] -= local[(n1 + k, n1 + j)];
            }
        }
    }
    // Unused rows stay an identity with a zero right-hand side; scale them so that pivoting is not misled.
    let scale = system.view((0, 0), (unknowns, unknowns)).amax().max(f64::MIN_POSITIVE);
    for k in unknowns..4 {
        system[(k, k)] = scale;
    }
    let x = system.full_piv_lu().solve(&rhs).ok_or(Error::SwapFailed { discarded: f64::INFINITY })?;

    // Householder QR of the (n1 + n2) × n2 matrix [-X; s I], with s chosen so that no column overflows.
    let s = 1.0 / x.amax().max(1.0);
    let mut basis = Matrix4::zeros();
    for j in 0..n2 {
        for i in 0..n1 {
            basis[(i, j)] = -x[index(i, j)] * s;
        }
        basis[(n1 + j, j)] = s;
    }
    let mut z = Matrix4::identity();
    for j in 0..n2 {
        let mut v = Vector4::zeros();
        for i in j..(n1 + n2) {
            v[i] = basis[(i, j)];
        }
        let norm = v.norm();
        v[j] += norm.copysign(v[j]);
        let square = v.norm_squared();
        if square > 0.0 {
            let reflector = Matrix4::identity() - v * v.transpose() * (2.0 / square);
            basis = reflector * basis;
            z *= reflector;
        }
    }
    Ok(z)
}

/// Orthogonal matrix without structure, the same on every call: a product of Householder reflectors.
fn fixed_rotation(n: usize, attempt: usize) -> DMatrix<f64> {
    let mut q = DMatrix::identity(n, n);
    for k in 0..2 {
        let v =
            nalgebra::DVector::from_fn(n, |i, _| 1.0 + (1.7 * i as f64 + 0.9 * (k + attempt) as f64).sin());
        let reflector = DMatrix::identity(n, n) - &v * v.transpose() * (2.0 / v.norm_squared());
        q *= reflector;
    }
    q
}

/// Standard form of a 2×2 block and the rotation that leads to it.
struct StandardBlock {
    a: f64,
    b: f64,
    c: f64,
    d: f64,
    cos: f64,
    sin: f64,
}

impl StandardBlock {
    /// **Source**: LAPACK `dlanv2`; either `c = 0`, or `a = d` and `b c < 0`.
    fn new(mut a: f64, mut b: f64, mut c: f64, mut d: f64) -> Self {
        if c == 0.0 {
            return Self { a, b, c, d, cos: 1.0, sin: 0.0 };
        }
        if b == 0.0 {
            return Self { a: d, b: -c, c: 0.0, d: a, cos: 0.0, sin: 1.0 };
        }
        if a == d && b.signum() != c.signum() {
            return Self { a, b, c, d, cos: 1.0, sin: 0.0 };
        }
        let difference = a - d;
        let p = 0.5 * difference;
        let larger = b.abs().max(c.abs());
        let smaller = b.abs().min(c.abs()) * b.signum() * c.signum();
        let scale = p.abs().max(larger);
        let z = p / scale * p + larger / scale * smaller;
        if z >= 4.0 * f64::EPSILON {
            let z = p + (scale.sqrt() * z.sqrt()).copysign(p);
            a = d + z;
            d -= larger / z * smaller;
            let tau = c.hypot(z);
            return Self { a, b: b - c, c: 0.0, d, cos: z / tau, sin: c / tau };
        }
        // Complex, or real and nearly equal: make the diagonal equal first.
        let sigma = b + c;
        let tau = sigma.hypot(difference);
        let mut cos = (0.5 * (1.0 + sigma.abs() / tau)).sqrt();
        let mut sin = -(p / (tau * cos)) * sigma.signum();
        let (aa, bb, cc, dd) = (a * cos + b * sin, -a * sin + b * cos, c * cos + d * sin, -c * sin + d * cos);
        let middle = 0.5 * ((aa * cos + cc * sin) + (-bb * sin + dd * cos));
        b = bb * cos + dd * sin;
        c = -aa * sin + cc * cos;
        a = middle;
        d = middle;
        if c != 0.0 {
            if b == 0.0 {
                (b, c) = (-c, 0.0);
                (cos, sin) = (-sin, cos);
            } else if b.signum() == c.signum() {
                let (root_b, root_c) = (b.abs().sqrt(), c.abs().sqrt());
                let p = (root_b * root_c).copysign(c);
                let tau = 1.0 / (b + c).abs().sqrt();
                a = middle + p;
                d = middle - p;
                b -= c;
                c = 0.0;
                let (cos1, sin1) = (root_b * tau, root_c * tau);
                (cos, sin) = (cos * cos1 - sin * sin1, cos * sin1 + sin * cos1);
            }
        }
        Self { a, b, c, d, cos, sin }
    }
}

/// Attempts at a Schur form before giving up.
const MAX_ATTEMPTS: usize = 4;

/// Largest relative entry that a swap may discard; LAPACK `dlaexc` uses ten times the machine precision on the
/// largest entry, this is in the Frobenius norm of at most sixteen entries.
const SWAP_TOLERANCE: f64 = 100.0 * f64::EPSILON;

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn law_ordering_keeps_the_matrix_and_the_spectrum() {
        let seed = 11;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        for trial in 0..200 {
            let n = 1 + trial % 12;
            let m = DMatrix::from_fn(n, n, |_, _| rng.random_range(-1.0..1.0));
            let before = RealSchur::new(&m).expect("schur").eigenvalues();
            let ordered = RealSchur::new(&m).expect("schur").order(|l| l.re < 0.0).expect("order");
            let RealSchur { q, t } = &ordered.form;
            let back = q * t * q.transpose();
            assert!((back - &m).norm() < 1e-12 * n as f64, "seed {seed} trial {trial}");
            assert!((q.transpose() * q - DMatrix::identity(n, n)).norm() < 1e-12);
            let after = ordered.form.eigenvalues();
            assert_eq!(ordered.n_selected, before.iter().filter(|l| l.re < 0.0).count());
            assert!(after[..ordered.n_selected].iter().all(|l| l.re < 0.0));
            assert!(after[ordered.n_selected..].iter().all(|l| l.re >= 0.0));
            let trace: f64 = after.iter().map(|l| l.re).sum();
            assert!((trace - m.trace()).abs() < 1e-12 * n as f64);
        }
    }

    #[test]
    fn law_swaps_of_every_block_size_keep_a_prescribed_spectrum() {
        // Block diagonal with known eigenvalues, hidden by a similarity; the selected ones must come first.
        let mut t = DMatrix::<f64>::zeros(6, 6);
        for (k, (re, im)) in [(2.0, 3.0), (-1.0, 5.0), (0.5, 0.25)].into_iter().enumerate() {
            t[(2 * k, 2 * k)] = re;
            t[(2 * k + 1, 2 * k + 1)] = re;
            t[(2 * k, 2 * k + 1)] = im;
            t[(2 * k + 1, 2 * k)] = -im;
        }
        let p = fixed_rotation(6, 3);
        let m = &p * t * p.transpose();
        let ordered = RealSchur::new(&m).expect("schur").order(|l| l.im.abs() > 4.0).expect("order");
        let top = ordered.form.eigenvalues()[0];
        assert!((top.re + 1.0).abs() < 1e-13 && (top.im - 5.0).abs() < 1e-13, "{top}");
    }

    #[test]
    fn edge_not_square_and_not_finite() {
        assert!(matches!(RealSchur::new(&DMatrix::zeros(2, 3)), Err(Error::Shape { .. })));
        let nan = DMatrix::from_element(2, 2, f64::NAN);
        assert!(matches!(RealSchur::new(&nan), Err(Error::NotFinite { .. })));
    }

    #[test]
    fn edge_cyclic_permutation_converges() {
        // Francis steps without exceptional shifts stall on this one.
        let n = 6;
        let m = DMatrix::from_fn(n, n, |i, j| if (i + 1) % n == j { 1.0 } else { 0.0 });
        let values = RealSchur::new(&m).expect("schur").eigenvalues();
        assert!(values.iter().all(|l| (l.norm() - 1.0).abs() < 1e-13));
    }
}
