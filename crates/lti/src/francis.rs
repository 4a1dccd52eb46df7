//! The implicit double-shift QR iteration on an upper Hessenberg matrix.
//!
//! **Source**: Francis 1961; shifts, exceptional shifts and the search for two small subdiagonals as in LAPACK's
//! `dlahqr`; deflation by Ahues and Tisseur 1997, which keeps the eigenvalues of graded matrices.

use nalgebra::DMatrix;
use num_complex::Complex64;

use crate::Error;
use crate::schur::StandardBlock;
use crate::vectorized::{self, Kernel, multiply_add};

/// Returns the eigenvalues of an upper Hessenberg matrix, which is overwritten; only the active window is updated.
pub(crate) fn eigenvalues(h: &mut DMatrix<f64>) -> Result<Vec<Complex64>, Error> {
    let n = h.nrows();
    let mut values = vec![Complex64::new(0.0, 0.0); n];
    let iteration = Iteration { h: h.as_mut_slice(), n, q: None, whole: false, values: &mut values };
    finish(vectorized::run(iteration), n).map(|()| values)
}

/// Brings an upper Hessenberg matrix to real Schur form; multiplies `q` by the similarity where given.
pub(crate) fn schur(h: &mut DMatrix<f64>, q: Option<&mut DMatrix<f64>>) -> Result<Vec<Complex64>, Error> {
    let n = h.nrows();
    let mut values = vec![Complex64::new(0.0, 0.0); n];
    let q = q.map(DMatrix::as_mut_slice);
    let iteration = Iteration { h: h.as_mut_slice(), n, q, whole: true, values: &mut values };
    finish(vectorized::run(iteration), n).map(|()| values)
}

fn finish(converged: bool, n: usize) -> Result<(), Error> {
    if converged { Ok(()) } else { Err(Error::EigenvaluesNotConverged { n, iterations: sweeps_max(n) }) }
}

/// Double-shift sweeps allowed in total; two to three for each eigenvalue pair are usual.
fn sweeps_max(n: usize) -> usize {
    SWEEPS_PER_ROW * n.max(10)
}

struct Iteration<'a> {
    h: &'a mut [f64],
    n: usize,
    q: Option<&'a mut [f64]>,
    /// Whether the rows and columns outside of the active window are updated.
    whole: bool,
    values: &'a mut [Complex64],
}

/// Two shifts, equal and real, different and real, or a conjugate pair.
#[derive(Clone, Copy)]
struct Shifts {
    re1: f64,
    im1: f64,
    re2: f64,
    im2: f64,
}

impl Kernel for Iteration<'_> {
    type Output = bool;

    #[inline(always)]
    fn run<const FUSED: bool>(mut self) -> bool {
        let n = self.h.len().checked_div(self.n).unwrap_or(0);
        let mut end = n;
        let mut sweeps = 0;
        let limit = sweeps_max(n);
        // Sweeps since the last deflation; every tenth takes an exceptional shift.
        let mut stalled = 0;
        while end > 0 {
            let last = end - 1;
            let top = self.deflation(last);
            if top > 0 {
                self.h[(top - 1) * n + top] = 0.0;
            }
            if top == last {
                self.values[last] = Complex64::new(self.h[last * n + last], 0.0);
                end -= 1;
                stalled = 0;
            } else if top + 1 == last {
                self.split_pair::<FUSED>(top);
                end -= 2;
                stalled = 0;
            } else {
                if sweeps == limit {
                    return false;
                }
                sweeps += 1;
                stalled += 1;
                let shifts = self.shifts(top, last, stalled);
                self.sweep::<FUSED>(top, last, shifts);
            }
        }
        true
    }
}

impl Iteration<'_> {
    #[inline(always)]
    fn at(&self, i: usize, j: usize) -> f64 {
        self.h[j * self.n + i]
    }

    /// Row at which the unreduced block that ends in row `last` begins.
    #[inline(always)]
    fn deflation(&self, last: usize) -> usize {
        let mut k = last;
        while k > 0 {
            let below = self.at(k, k - 1).abs();
            if below <= SMALL {
                break;
            }
            let (upper, lower) = (self.at(k - 1, k - 1), self.at(k, k));
            let mut size = upper.abs() + lower.abs();
            if size == 0.0 {
                if k >= 2 {
                    size += self.at(k - 1, k - 2).abs();
                }
                if k < last {
                    size += self.at(k + 1, k).abs();
                }
            }
            if below <= f64::EPSILON * size {
                // Ahues and Tisseur: the product of the off-diagonals must be negligible too.
                let above = self.at(k - 1, k).abs();
                let (ab, ba) = (below.max(above), below.min(above));
                let gap = (upper - lower).abs();
                let (aa, bb) = (lower.abs().max(gap), lower.abs().min(gap));
                let s = aa + ab;
                if ba * (ab / s) <= SMALL.max(f64::EPSILON * (bb * (aa / s))) {
                    break;
                }
            }
            k -= 1;
        }
        k
    }

    /// Eigenvalues of the trailing 2×2 block, or an exceptional pair where the iteration stalls.
    #[inline(always)]
    fn shifts(&self, top: usize, last: usize, stalled: usize) -> Shifts {
        let (a, b, c, d);
        if stalled.is_multiple_of(20) {
            let s = self.at(last, last - 1).abs() + self.at(last - 1, last - 2).abs();
            let x = EXCEPTIONAL_DIAGONAL * s + self.at(last, last);
            (a, b, c, d) = (x, EXCEPTIONAL_UPPER * s, s, x);
        } else if stalled.is_multiple_of(10) {
            let s = self.at(top + 1, top).abs() + self.at(top + 2, top + 1).abs();
            let x = EXCEPTIONAL_DIAGONAL * s + self.at(top, top);
            (a, b, c, d) = (x, EXCEPTIONAL_UPPER * s, s, x);
        } else {
            let k = last - 1;
            (a, b, c, d) = (self.at(k, k), self.at(k, last), self.at(last, k), self.at(last, last));
        }
        let s = a.abs() + b.abs() + c.abs() + d.abs();
        if s == 0.0 {
            return Shifts { re1: 0.0, im1: 0.0, re2: 0.0, im2: 0.0 };
        }
        let (a, b, c, d) = (a / s, b / s, c / s, d / s);
        let middle = 0.5 * (a + d);
        let determinant = (a - middle) * (d - middle) - b * c;
        let root = determinant.abs().sqrt();
        if determinant >= 0.0 {
            return Shifts { re1: middle * s, im1: root * s, re2: middle * s, im2: -root * s };
        }
        // Real: both shifts at the one nearer to the corner.
        let (r1, r2) = (middle + root, middle - root);
        let r = s * if (r1 - d).abs() <= (r2 - d).abs() { r1 } else { r2 };
        Shifts { re1: r, im1: 0.0, re2: r, im2: 0.0 }
    }

    /// First column of the shifted product at row `m`, up to scale.
    #[inline(always)]
    fn start(&self, m: usize, shifts: &Shifts) -> [f64; 3] {
        let (h00, h10, h01) = (self.at(m, m), self.at(m + 1, m), self.at(m, m + 1));
        let (h11, h21) = (self.at(m + 1, m + 1), self.at(m + 2, m + 1));
        let s = 1.0 / ((h00 - shifts.re2).abs() + shifts.im2.abs() + h10.abs());
        let below = h10 * s;
        let v = [
            below * h01 + (h00 - shifts.re1) * ((h00 - shifts.re2) * s) - shifts.im1 * (shifts.im2 * s),
            below * (h00 + h11 - shifts.re1 - shifts.re2),
            below * h21,
        ];
        let size = v[0].abs() + v[1].abs() + v[2].abs();
        if size > 0.0 && size.is_finite() { v.map(|x| x / size) } else { [1.0, 0.0, 0.0] }
    }

    /// One double-shift sweep over the block from `top` to `last`.
    #[inline(always)]
    fn sweep<const FUSED: bool>(&mut self, top: usize, last: usize, shifts: Shifts) {
        let n = self.n;
        let mut m = last - 2;
        let mut v = self.start(m, &shifts);
        while m > top {
            let size = self.at(m - 1, m - 1).abs() + self.at(m, m).abs() + self.at(m + 1, m + 1).abs();
            let spill = self.at(m, m - 1).abs() * (v[1].abs() + v[2].abs());
            if spill <= f64::EPSILON * v[0].abs() * size {
                break;
            }
            m -= 1;
            v = self.start(m, &shifts);
        }
        let (first_row, end_column) = if self.whole { (0, n) } else { (top, last + 1) };
        for k in m..last - 1 {
            if k > m {
                let column = &self.h[(k - 1) * n + k..];
                v = [column[0], column[1], column[2]];
            }
            let (tau, beta) = reflector3::<FUSED>(&mut v);
            if k > m {
                let column = &mut self.h[(k - 1) * n + k..];
                (column[0], column[1], column[2]) = (beta, 0.0, 0.0);
            } else if m > top {
                // A start below the top of the block: the entry beside it is only scaled (LAPACK's safeguard).
                self.h[(k - 1) * n + k] *= 1.0 - tau;
            }
            let scaled = [tau, tau * v[1], tau * v[2]];
            for column in self.h[k * n..end_column * n].chunks_exact_mut(n) {
                if let Some([x, y, z]) = column[k..].first_chunk_mut::<3>() {
                    let sum = multiply_add::<FUSED>(v[2], *z, multiply_add::<FUSED>(v[1], *y, *x));
                    *x = multiply_add::<FUSED>(-scaled[0], sum, *x);
                    *y = multiply_add::<FUSED>(-scaled[1], sum, *y);
                    *z = multiply_add::<FUSED>(-scaled[2], sum, *z);
                }
            }
            let end_row = (k + 4).min(last + 1);
            combine3::<FUSED>(self.h, n, k, first_row..end_row, &v, &scaled);
            if let Some(q) = self.q.as_deref_mut() {
                combine3::<FUSED>(q, n, k, 0..n, &v, &scaled);
            }
        }
        self.finish_sweep::<FUSED>(last, first_row, end_column);
    }

    /// The last reflector of a sweep has two entries.
    #[inline(always)]
    fn finish_sweep<const FUSED: bool>(&mut self, last: usize, first_row: usize, end_column: usize) {
        let (n, k) = (self.n, last - 1);
        let mut v = [self.at(k, k - 1), self.at(last, k - 1), 0.0];
        let (tau, beta) = reflector3::<FUSED>(&mut v);
        self.h[(k - 1) * n + k] = beta;
        self.h[(k - 1) * n + last] = 0.0;
        let scaled = [tau, tau * v[1]];
        for column in self.h[k * n..end_column * n].chunks_exact_mut(n) {
            if let Some([x, y]) = column[k..].first_chunk_mut::<2>() {
                let sum = multiply_add::<FUSED>(v[1], *y, *x);
                *x = multiply_add::<FUSED>(-scaled[0], sum, *x);
                *y = multiply_add::<FUSED>(-scaled[1], sum, *y);
            }
        }
        combine2::<FUSED>(self.h, n, k, first_row..last + 1, v[1], &scaled);
        if let Some(q) = self.q.as_deref_mut() {
            combine2::<FUSED>(q, n, k, 0..n, v[1], &scaled);
        }
    }

    /// Records the pair of eigenvalues at `top` and brings its block into standard form.
    #[inline(always)]
    fn split_pair<const FUSED: bool>(&mut self, top: usize) {
        let (n, k) = (self.n, top + 1);
        let block = StandardBlock::new(self.at(top, top), self.at(top, k), self.at(k, top), self.at(k, k));
        let (first, second) = block.eigenvalues();
        self.values[top] = first;
        self.values[k] = second;
        if !self.whole {
            return;
        }
        let (cos, sin) = (block.cos, block.sin);
        for column in self.h[(k + 1) * n..].chunks_exact_mut(n) {
            if let Some([x, y]) = column[top..].first_chunk_mut::<2>() {
                (*x, *y) = (cos * *x + sin * *y, cos * *y - sin * *x);
            }
        }
        rotate_columns(self.h, n, top, top, cos, sin);
        if let Some(q) = self.q.as_deref_mut() {
            rotate_columns(q, n, top, n, cos, sin);
        }
        self.h[top * n + top] = block.a;
        self.h[k * n + top] = block.b;
        self.h[top * n + k] = block.c;
        self.h[k * n + k] = block.d;
    }
}

/// Reflector of three entries: returns `tau` and the new first entry, leaves `[1, v1, v2]`.
#[inline(always)]
fn reflector3<const FUSED: bool>(v: &mut [f64; 3]) -> (f64, f64) {
    let tail = multiply_add::<FUSED>(v[1], v[1], v[2] * v[2]);
    let square = multiply_add::<FUSED>(v[0], v[0], tail);
    if tail > SQUARE_MIN && square < SQUARE_MAX {
        let beta = -square.sqrt().copysign(v[0]);
        let inverse = 1.0 / (v[0] - beta);
        let tau = (beta - v[0]) / beta;
        *v = [1.0, v[1] * inverse, v[2] * inverse];
        return (tau, beta);
    }
    let r = vectorized::reflector::<FUSED>(v);
    (r.tau, r.beta)
}

/// Applies a reflector of three entries to the columns from `k` of a matrix, in the rows given.
#[inline(always)]
fn combine3<const FUSED: bool>(
    m: &mut [f64],
    n: usize,
    k: usize,
    rows: std::ops::Range<usize>,
    v: &[f64; 3],
    scaled: &[f64; 3],
) {
    let (first, others) = m[k * n..(k + 3) * n].split_at_mut(n);
    let (second, third) = others.split_at_mut(n);
    let (first, second, third) = (&mut first[rows.clone()], &mut second[rows.clone()], &mut third[rows]);
    for ((x, y), z) in first.iter_mut().zip(second).zip(third) {
        let sum = multiply_add::<FUSED>(v[2], *z, multiply_add::<FUSED>(v[1], *y, *x));
        *x = multiply_add::<FUSED>(-scaled[0], sum, *x);
        *y = multiply_add::<FUSED>(-scaled[1], sum, *y);
        *z = multiply_add::<FUSED>(-scaled[2], sum, *z);
    }
}

/// Applies a reflector of two entries to the columns from `k` of a matrix, in the rows given.
#[inline(always)]
fn combine2<const FUSED: bool>(
    m: &mut [f64],
    n: usize,
    k: usize,
    rows: std::ops::Range<usize>,
    v: f64,
    scaled: &[f64; 2],
) {
    let (first, second) = m[k * n..(k + 2) * n].split_at_mut(n);
    for (x, y) in first[rows.clone()].iter_mut().zip(&mut second[rows]) {
        let sum = multiply_add::<FUSED>(v, *y, *x);
        *x = multiply_add::<FUSED>(-scaled[0], sum, *x);
        *y = multiply_add::<FUSED>(-scaled[1], sum, *y);
    }
}

/// Rotates columns `k` and `k + 1` of a matrix in the leading `rows`.
#[inline(always)]
pub(crate) fn rotate_columns(m: &mut [f64], n: usize, k: usize, rows: usize, cos: f64, sin: f64) {
    let (first, second) = m[k * n..(k + 2) * n].split_at_mut(n);
    for (x, y) in first[..rows].iter_mut().zip(&mut second[..rows]) {
        (*x, *y) = (cos * *x + sin * *y, cos * *y - sin * *x);
    }
}

/// LAPACK allows thirty; graded matrices need more than random ones.
const SWEEPS_PER_ROW: usize = 40;
/// Entries below this are zero; callers scale the matrix to be of order one where it is far from that.
const SMALL: f64 = 1e-290;
/// Wilkinson's ad hoc shifts, as in LAPACK's `dlahqr`.
const EXCEPTIONAL_DIAGONAL: f64 = 0.75;
const EXCEPTIONAL_UPPER: f64 = -0.4375;
/// Squares between these bounds can be summed without care.
const SQUARE_MIN: f64 = 1e-270;
const SQUARE_MAX: f64 = 1e270;
