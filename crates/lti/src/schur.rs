//! Real Schur form and its reordering: the tool behind invariant subspaces, Riccati and Lyapunov equations.
//!
//! Householder reduction and the double-shift iteration give the unordered form; orthogonal swaps of neighbouring
//! blocks move chosen eigenvalues to the leading position.

use nalgebra::{DMatrix, Matrix4, Vector4};
use num_complex::Complex64;

use crate::Error;
use crate::francis::{self, rotate_columns};
use crate::hessenberg::{check_square_and_finite, reduce_with_vectors};
use crate::isolation::{permute, triangular_order};
use crate::vectorized::{self, Kernel};

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
    /// **Method**: a permutation that isolates what is triangular already, Householder reduction to Hessenberg form, then the implicit double-shift QR iteration with
    /// exceptional shifts.
    ///
    /// **Source**: Golub and Van Loan 2013, section 7.5; LAPACK `dgehrd` and `dlahqr`.
    ///
    /// **Accuracy**: backward stable: `||M - Q T Qᵀ||` below 1e-13 `||M||` up to a few hundred rows. A matrix that
    /// is triangular in some order of its states keeps its diagonal exactly.
    ///
    /// **Errors**: [`Error::Shape`], [`Error::NotFinite`], [`Error::EigenvaluesNotConverged`].
    pub fn new(m: &DMatrix<f64>) -> Result<Self, Error> {
        check_square_and_finite("m", m)?;
        let order = triangular_order(m);
        let mut t = order.as_ref().map_or_else(|| m.clone(), |order| permute(m, order));
        let scale = scale_to_unit(&mut t);
        let mut q = reduce_with_vectors(&mut t);
        if let Some(order) = order {
            let plain = q.clone();
            order.iter().enumerate().for_each(|(i, &row)| q.set_row(row, &plain.row(i)));
        }
        francis::schur(&mut t, Some(&mut q))?;
        unscale(&mut t, scale);
        Ok(Self { q, t })
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
        let n = self.t.nrows();
        let (t, q) = (self.t.as_mut_slice(), self.q.as_mut_slice());
        let (n_selected, worst_swap) = vectorized::run(Ordering { t, q, n, select })?;
        Ok(OrderedSchur { form: self, n_selected, worst_swap })
    }
}

/// Scales a matrix whose largest entry is far from one to order one; returns the factor, a power of two.
pub(crate) fn scale_to_unit(m: &mut DMatrix<f64>) -> f64 {
    let largest = m.iter().fold(0.0_f64, |max, v| max.max(v.abs()));
    if largest == 0.0 || (UNSCALED_MIN..UNSCALED_MAX).contains(&largest) {
        return 1.0;
    }
    let scale = (-largest.log2()).round().clamp(-1000.0, 1000.0).exp2();
    m.scale_mut(scale);
    scale
}

fn unscale(m: &mut DMatrix<f64>, scale: f64) {
    if scale != 1.0 {
        m.unscale_mut(scale);
    }
}

/// Block reordering on column-major storage.
struct Ordering<'a, F> {
    t: &'a mut [f64],
    q: &'a mut [f64],
    n: usize,
    select: F,
}

impl<F: Fn(Complex64) -> bool> Kernel for Ordering<'_, F> {
    type Output = Result<(usize, f64), Error>;

    #[inline(always)]
    fn run<const FUSED: bool>(mut self) -> Self::Output {
        let mut target = 0;
        let mut worst_swap: f64 = 0.0;
        let mut position = 0;
        while position < self.n {
            let size = self.block_size(position);
            let re = self.at(position, position);
            let im = if size == 2 {
                self.at(position, position + 1).abs().sqrt() * self.at(position + 1, position).abs().sqrt()
            } else {
                0.0
            };
            if (self.select)(Complex64::new(re, im)) {
                let mut here = position;
                while here > target {
                    // The block above starts one or two rows up.
                    let above = if here >= target + 2 && self.at(here - 1, here - 2) != 0.0 { 2 } else { 1 };
                    if above == 1 && size == 1 {
                        self.swap_single(here - 1);
                    } else {
                        worst_swap = worst_swap.max(self.swap(here - above, above, size)?);
                    }
                    here -= above;
                }
                target += size;
            }
            position += size;
        }
        Ok((target, worst_swap))
    }
}

impl<F> Ordering<'_, F> {
    #[inline(always)]
    fn at(&self, i: usize, j: usize) -> f64 {
        self.t[j * self.n + i]
    }

    #[inline(always)]
    fn set(&mut self, i: usize, j: usize, value: f64) {
        self.t[j * self.n + i] = value;
    }

    #[inline(always)]
    fn block_size(&self, start: usize) -> usize {
        if start + 1 < self.n && self.at(start + 1, start) != 0.0 { 2 } else { 1 }
    }

    /// Rotates rows `i` and `i + 1` in the columns from `first_column`, and columns `i` and `i + 1` above row `rows`.
    #[inline(always)]
    fn rotate(&mut self, i: usize, first_column: usize, rows: usize, cos: f64, sin: f64) {
        let n = self.n;
        for column in self.t[first_column * n..].chunks_exact_mut(n) {
            if let Some([x, y]) = column[i..].first_chunk_mut::<2>() {
                (*x, *y) = (cos * *x + sin * *y, cos * *y - sin * *x);
            }
        }
        rotate_columns(self.t, n, i, rows, cos, sin);
        rotate_columns(self.q, n, i, n, cos, sin);
    }

    /// Swaps two real eigenvalues at `start` by one rotation, which cannot fail.
    #[inline(always)]
    fn swap_single(&mut self, start: usize) {
        let (upper, lower) = (self.at(start, start), self.at(start + 1, start + 1));
        let (x, y) = (self.at(start, start + 1), lower - upper);
        let r = x.hypot(y);
        if r > 0.0 {
            self.rotate(start, start + 2, start, x / r, y / r);
        }
        self.set(start, start, lower);
        self.set(start + 1, start + 1, upper);
        // The entry beside them is invariant up to a sign that this rotation keeps.
    }

    /// Brings the 2×2 block at `start` into standard form; it may fall apart into two real eigenvalues.
    #[inline(always)]
    fn standardize(&mut self, start: usize) {
        let (i, j) = (start, start + 1);
        let block = StandardBlock::new(self.at(i, i), self.at(i, j), self.at(j, i), self.at(j, j));
        self.rotate(i, j + 1, i, block.cos, block.sin);
        self.set(i, i, block.a);
        self.set(i, j, block.b);
        self.set(j, i, block.c);
        self.set(j, j, block.d);
    }

    /// Swaps the block of size `n1` at `start` with the block of size `n2` below it; returns what was discarded.
    #[inline(always)]
    fn swap(&mut self, start: usize, n1: usize, n2: usize) -> Result<f64, Error> {
        let size = n1 + n2;
        let mut local = Matrix4::zeros();
        for j in 0..size {
            for i in 0..size {
                local[(i, j)] = self.at(start + i, start + j);
            }
        }
        let (z, discarded) = checked_rotation(&local, n1, n2)?;
        if size == 4 {
            self.apply::<4>(start, &z);
        } else {
            self.apply::<3>(start, &z);
        }
        for j in 0..n2 {
            for i in n2..size {
                self.set(start + i, start + j, 0.0);
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

    /// Applies the orthogonal `z` (leading `SIZE × SIZE` part) as a similarity at `start`.
    #[inline(always)]
    fn apply<const SIZE: usize>(&mut self, start: usize, z: &Matrix4<f64>) {
        let n = self.n;
        let z: [[f64; SIZE]; SIZE] = std::array::from_fn(|j| std::array::from_fn(|i| z[(i, j)]));
        for column in self.t[start * n..].chunks_exact_mut(n) {
            if let Some(entries) = column[start..].first_chunk_mut::<SIZE>() {
                *entries = combine(&z, *entries);
            }
        }
        apply_to_columns(&mut self.t[start * n..], n, start + SIZE, &z);
        apply_to_columns(&mut self.q[start * n..], n, n, &z);
    }
}

#[inline(always)]
fn combine<const SIZE: usize>(z: &[[f64; SIZE]; SIZE], old: [f64; SIZE]) -> [f64; SIZE] {
    let mut new = [0.0; SIZE];
    for (new, z) in new.iter_mut().zip(z) {
        for (z, old) in z.iter().zip(&old) {
            *new += z * old;
        }
    }
    new
}

/// Multiplies the first `SIZE` columns by `z` from the right, in the leading `rows`.
#[inline(always)]
fn apply_to_columns<const SIZE: usize>(m: &mut [f64], n: usize, rows: usize, z: &[[f64; SIZE]; SIZE]) {
    let (c0, others) = m.split_at_mut(n);
    let (c1, others) = others.split_at_mut(n);
    let (c2, others) = others.split_at_mut(n);
    let head = c0[..rows].iter_mut().zip(&mut c1[..rows]).zip(&mut c2[..rows]);
    if SIZE == 4 {
        for (((a, b), c), d) in head.zip(&mut others[..rows]) {
            let mut old = [0.0; SIZE];
            (old[0], old[1], old[2], old[SIZE - 1]) = (*a, *b, *c, *d);
            let new = combine(z, old);
            (*a, *b, *c, *d) = (new[0], new[1], new[2], new[SIZE - 1]);
        }
    } else {
        for ((a, b), c) in head {
            let mut old = [0.0; SIZE];
            (old[0], old[1], old[2]) = (*a, *b, *c);
            let new = combine(z, old);
            (*a, *b, *c) = (new[0], new[1], new[2]);
        }
    }
}

/// The rotation that swaps two blocks, and what it leaves below the diagonal relative to their norm.
fn checked_rotation(local: &Matrix4<f64>, n1: usize, n2: usize) -> Result<(Matrix4<f64>, f64), Error> {
    let z = swap_rotation(local, n1, n2)?;
    let moved = z.transpose() * local * z;
    let scale = local.norm().max(f64::MIN_POSITIVE);
    let mut discarded: f64 = 0.0;
    for i in n2..n1 + n2 {
        for j in 0..n2 {
            discarded = discarded.max(moved[(i, j)].abs());
        }
    }
    let discarded = discarded / scale;
    if discarded.is_nan() || discarded > SWAP_TOLERANCE {
        return Err(Error::SwapFailed { discarded });
    }
    Ok((z, discarded))
}

/// Positive imaginary part of the standardised 2×2 block at `start`.
fn block_imaginary(t: &DMatrix<f64>, start: usize) -> f64 {
    t[(start, start + 1)].abs().sqrt() * t[(start + 1, start)].abs().sqrt()
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

/// Standard form of a 2×2 block and the rotation that leads to it.
pub(crate) struct StandardBlock {
    pub a: f64,
    pub b: f64,
    pub c: f64,
    pub d: f64,
    pub cos: f64,
    pub sin: f64,
}

impl StandardBlock {
    /// **Source**: LAPACK `dlanv2`; either `c = 0`, or `a = d` and `b c < 0`.
    pub fn new(mut a: f64, mut b: f64, mut c: f64, mut d: f64) -> Self {
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

    /// The two eigenvalues, the one with positive imaginary part first.
    pub fn eigenvalues(&self) -> (Complex64, Complex64) {
        let im = if self.c == 0.0 { 0.0 } else { self.b.abs().sqrt() * self.c.abs().sqrt() };
        (Complex64::new(self.a, im), Complex64::new(self.d, -im))
    }
}

/// Matrices with their largest entry between these bounds are taken as they are.
const UNSCALED_MIN: f64 = 1e-60;
const UNSCALED_MAX: f64 = 1e60;

/// Largest relative entry that a swap may discard; LAPACK `dlaexc` uses ten times the machine precision on the
/// largest entry, this is in the Frobenius norm of at most sixteen entries.
const SWAP_TOLERANCE: f64 = 100.0 * f64::EPSILON;

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// Orthogonal matrix without structure, the same on every call: a product of Householder reflectors.
    fn fixed_rotation(n: usize, attempt: usize) -> DMatrix<f64> {
        let mut q = DMatrix::identity(n, n);
        for k in 0..2 {
            let v = nalgebra::DVector::from_fn(n, |i, _| {
                1.0 + (1.7 * i as f64 + 0.9 * (k + attempt) as f64).sin()
            });
            let reflector = DMatrix::identity(n, n) - &v * v.transpose() * (2.0 / v.norm_squared());
            q *= reflector;
        }
        q
    }

    /// Matrices on which QR iterations are known to have trouble, each with its name.
    fn difficult(n: usize, rng: &mut rand_pcg::Pcg64) -> Vec<(&'static str, DMatrix<f64>)> {
        let mut random = |rows, cols| DMatrix::from_fn(rows, cols, |_, _| rng.random_range(-1.0..1.0));
        let m = random(n, n);
        let graded = |step: f64| DMatrix::from_fn(n, n, |i, j| m[(i, j)] * step.powi((i + j) as i32));
        let jordan = DMatrix::from_fn(n, n, |i, j| if i == j || i + 1 == j { 1.0 } else { 0.0 });
        let hidden = {
            let q = m.clone().qr().q();
            &q * &jordan * q.transpose()
        };
        let half = n / 2;
        let mut hamiltonian = random(2 * half, 2 * half);
        for i in 0..half {
            for j in 0..half {
                hamiltonian[(half + i, half + j)] = -hamiltonian[(j, i)];
                if j < i {
                    hamiltonian[(i, half + j)] = hamiltonian[(j, half + i)];
                    hamiltonian[(half + i, j)] = hamiltonian[(half + j, i)];
                }
            }
        }
        vec![
            ("random", m.clone()),
            ("symmetric", &m + m.transpose()),
            ("skew", &m - m.transpose()),
            ("orthogonal", m.clone().qr().q()),
            ("tiny", &m * 1e-150),
            ("huge", &m * 1e150),
            ("at the end of the range", &m * 1e306),
            ("subnormal", &m * 1e-310),
            ("graded down", graded(0.1)),
            ("graded up", graded(10.0)),
            ("rank one", random(n, 1) * random(1, n)),
            ("nilpotent", m.upper_triangle() - DMatrix::from_diagonal(&m.diagonal())),
            ("shift", DMatrix::from_fn(n, n, |i, j| if i == j + 1 { 1.0 } else { 0.0 })),
            ("cycle", DMatrix::from_fn(n, n, |i, j| if i == (j + 1) % n { 1.0 } else { 0.0 })),
            (
                "companion",
                DMatrix::from_fn(n, n, |i, j| if i == 0 { m[(0, j)] } else { f64::from(i == j + 1) }),
            ),
            ("frank", DMatrix::from_fn(n, n, |i, j| if j + 1 < i { 0.0 } else { (n - i.max(j)) as f64 })),
            ("jordan", jordan),
            ("hidden jordan", hidden),
            ("hamiltonian", hamiltonian),
            ("identity", DMatrix::identity(n, n)),
            ("zero", DMatrix::zeros(n, n)),
            ("ones", DMatrix::from_element(n, n, 1.0)),
        ]
    }

    #[test]
    fn law_difficult_matrices_have_a_schur_form_within_rounding() {
        let seed = 17;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        for n in [1, 2, 3, 4, 5, 6, 7, 8, 10, 13, 20, 31, 50] {
            for (name, m) in difficult(n, &mut rng) {
                let n = m.nrows();
                let form = RealSchur::new(&m).unwrap_or_else(|e| panic!("seed {seed} {name} {n}: {e}"));
                let RealSchur { q, t } = &form;
                let unit = 1.0 / m.amax().max(f64::MIN_POSITIVE);
                let (m, t_unit) = (&m * unit, t * unit);
                let error = (q * t_unit * q.transpose() - &m).norm();
                assert!(error < 1e-13 * m.norm().max(1e-3), "seed {seed} {name} {n}: {error:e}");
                let orthogonality = (q.tr_mul(q) - DMatrix::identity(n, n)).norm();
                assert!(orthogonality < 1e-13, "seed {seed} {name} {n}: {orthogonality:e}");
                for j in 0..n {
                    assert!((j + 2..n).all(|i| t[(i, j)] == 0.0), "{name} {n}");
                }
                for (k, size) in form.blocks() {
                    if size == 2 {
                        assert_eq!(t[(k, k)], t[(k + 1, k + 1)], "{name} {n}");
                        assert!(t[(k, k + 1)].signum() != t[(k + 1, k)].signum(), "{name} {n}");
                        assert!(k + 2 == n || t[(k + 2, k + 1)] == 0.0, "{name} {n}");
                    }
                }
            }
        }
    }

    #[test]
    fn law_eigenvalues_without_vectors_agree_with_the_schur_form() {
        // The two run through different windows and shifts; sorted spectra of well-conditioned matrices must agree.
        let seed = 19;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        for n in [1, 2, 3, 5, 8, 20, 60] {
            for (name, m) in difficult(n, &mut rng) {
                if !["symmetric", "skew", "orthogonal", "cycle", "identity"].contains(&name) {
                    continue;
                }
                let key = |v: &Complex64| ((v.re * 1e6).round(), v.im);
                let sorted = |mut v: Vec<Complex64>| {
                    v.sort_by(|a, b| key(a).partial_cmp(&key(b)).expect("finite"));
                    v
                };
                let whole = sorted(RealSchur::new(&m).expect("schur").eigenvalues());
                let alone = sorted(crate::eigenvalues::eigenvalues(&m).expect("eigenvalues"));
                for (a, b) in whole.iter().zip(&alone) {
                    assert!((a - b).norm() < 1e-12 * (1.0 + m.norm()), "seed {seed} {name} {n}: {a} {b}");
                }
            }
        }
    }

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
