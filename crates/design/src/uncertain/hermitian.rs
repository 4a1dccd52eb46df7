//! Small dense complex kernels on column-major slices, without allocation.

use num_complex::Complex64;

pub(crate) const ZERO: Complex64 = Complex64::new(0.0, 0.0);

/// Replaces the lower triangle of a Hermitian `a` by its Cholesky factor; `false` unless it is positive definite.
///
/// The strict upper triangle is neither read nor written.
pub(crate) fn cholesky(a: &mut [Complex64], n: usize) -> bool {
    for j in 0..n {
        let (left, right) = a.split_at_mut(j * n);
        let column = &mut right[..n];
        for k in 0..j {
            let factor = left[k * n + j].conj();
            for i in j..n {
                column[i] -= left[k * n + i] * factor;
            }
        }
        let pivot = column[j].re;
        // A NaN fails this comparison as well.
        if !(pivot > 0.0 && pivot.is_finite()) {
            return false;
        }
        let root = pivot.sqrt();
        column[j] = Complex64::new(root, 0.0);
        for entry in &mut column[j + 1..n] {
            *entry /= root;
        }
    }
    true
}

/// The inverse `L^-1` (lower triangular, zeros above) of a Cholesky factor.
pub(crate) fn invert_lower(l: &[Complex64], n: usize, inverse: &mut [Complex64]) {
    inverse[..n * n].fill(ZERO);
    for j in 0..n {
        inverse[j * n + j] = Complex64::new(1.0 / l[j * n + j].re, 0.0);
        for k in j..n {
            let value = inverse[j * n + k] / if k == j { 1.0 } else { l[k * n + k].re };
            inverse[j * n + k] = value;
            for i in k + 1..n {
                inverse[j * n + i] -= l[k * n + i] * value;
            }
        }
    }
}

/// `out = Aᴴ A` for a lower triangular `A`: with `A = L^-1` the inverse of `L Lᴴ`.
pub(crate) fn gram_of_lower(a: &[Complex64], n: usize, out: &mut [Complex64]) {
    for j in 0..n {
        for i in 0..=j {
            let mut sum = ZERO;
            for k in j..n {
                sum += a[i * n + k].conj() * a[j * n + k];
            }
            out[j * n + i] = sum;
            out[i * n + j] = sum.conj();
        }
        out[j * n + j].im = 0.0;
    }
}

/// `out = A B` with `A: n × k`, `B: k × m`.
pub(crate) fn multiply(
    a: &[Complex64],
    b: &[Complex64],
    n: usize,
    k: usize,
    m: usize,
    out: &mut [Complex64],
) {
    out[..n * m].fill(ZERO);
    for j in 0..m {
        let column = &mut out[j * n..(j + 1) * n];
        for l in 0..k {
            let factor = b[j * k + l];
            for (entry, &v) in column.iter_mut().zip(&a[l * n..(l + 1) * n]) {
                *entry += v * factor;
            }
        }
    }
}

/// `out = A Bᴴ` with `A: n × k`, `B: m × k`.
pub(crate) fn multiply_adjoint(
    a: &[Complex64],
    b: &[Complex64],
    n: usize,
    k: usize,
    m: usize,
    out: &mut [Complex64],
) {
    out[..n * m].fill(ZERO);
    for j in 0..m {
        let column = &mut out[j * n..(j + 1) * n];
        for l in 0..k {
            let factor = b[l * m + j].conj();
            for (entry, &v) in column.iter_mut().zip(&a[l * n..(l + 1) * n]) {
                *entry += v * factor;
            }
        }
    }
}

/// Cholesky factor of a real symmetric matrix in which directions without curvature are frozen.
///
/// A pivot below `1e-13` of its diagonal entry is replaced by infinity, so that a solve leaves that unknown at zero.
pub(crate) fn real_cholesky_frozen(a: &mut [f64], n: usize) {
    for j in 0..n {
        let original = a[j * n + j];
        for k in 0..j {
            let factor = a[k * n + j];
            for i in j..n {
                a[j * n + i] -= a[k * n + i] * factor;
            }
        }
        let pivot = a[j * n + j];
        if pivot > FROZEN_BELOW * original && pivot.is_finite() {
            let root = pivot.sqrt();
            a[j * n + j] = root;
            for i in j + 1..n {
                a[j * n + i] /= root;
            }
        } else {
            a[j * n + j] = f64::INFINITY;
            a[j * n + j + 1..(j + 1) * n].fill(0.0);
        }
    }
}

/// Solves `L Lᵀ x = b` in place.
pub(crate) fn real_cholesky_solve(l: &[f64], n: usize, b: &mut [f64]) {
    for j in 0..n {
        b[j] /= l[j * n + j];
        let value = b[j];
        for i in j + 1..n {
            b[i] -= l[j * n + i] * value;
        }
    }
    for j in (0..n).rev() {
        for i in j + 1..n {
            b[j] -= l[j * n + i] * b[i];
        }
        b[j] /= l[j * n + j];
    }
}

/// Hundreds of times the rounding of an entry that was formed as a sum over blocks.
const FROZEN_BELOW: f64 = 1e-13;
