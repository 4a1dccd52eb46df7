//! Eigenvalues of a Hamiltonian matrix by way of its square, at a third of the work of the general method.

use nalgebra::DMatrix;
use num_complex::Complex64;

use crate::Error;
use crate::francis;
use crate::hessenberg::two_sided;
use crate::vectorized::{self, Kernel, axpy, dot, multiply_add, reflector};

/// Returns the squares of the eigenvalues of `H = [A, G; Q, -Aᵀ]`, each of the `n` pairs `±lambda` once, and the norm of `H²`.
///
/// **Shapes**: all `n × n`; `g` and `q` symmetric, any definiteness.
///
/// **Method**: `H²` is skew-Hamiltonian, `[M, N; K, Mᵀ]` with skew-symmetric `N` and `K`. Orthogonal symplectic reflections and
/// rotations take `K` to zero and `M` to Hessenberg form, whose eigenvalues those of `H²` are.
///
/// **Source**: Van Loan 1984, "A symplectic method for approximating all the eigenvalues of a Hamiltonian matrix"; Paige and Van
/// Loan 1981 for the reduction.
///
/// **Accuracy**: a square has an error of a few units of the machine precision times the norm of `H²`, so an eigenvalue loses
/// digits as its size falls below that of `H`: none may be trusted below `1e-8` times the norm.
///
/// **Errors**: [`Error::EigenvaluesNotConverged`].
pub(crate) fn squared_eigenvalues(
    a: &DMatrix<f64>,
    g: &DMatrix<f64>,
    q: &DMatrix<f64>,
) -> Result<SquaredEigenvalues, Error> {
    let n = a.nrows();
    let mut m = a * a;
    m.gemm(1.0, g, q, 1.0);
    let ag = a * g;
    let mut upper = &ag - ag.transpose();
    let qa = q * a;
    let mut lower = &qa - qa.transpose();
    let norm = (2.0 * m.norm_squared() + upper.norm_squared() + lower.norm_squared()).sqrt();
    let mut work = vec![0.0; 2 * n];
    vectorized::run(Reduce {
        m: m.as_mut_slice(),
        upper: upper.as_mut_slice(),
        lower: lower.as_mut_slice(),
        n,
        work: &mut work,
    });
    for (j, column) in m.as_mut_slice().chunks_exact_mut(n.max(1)).enumerate() {
        column.iter_mut().skip(j + 2).for_each(|v| *v = 0.0);
    }
    Ok(SquaredEigenvalues { values: francis::eigenvalues(&mut m)?, norm })
}

/// What [`squared_eigenvalues`] found.
pub(crate) struct SquaredEigenvalues {
    pub(crate) values: Vec<Complex64>,
    /// Frobenius norm of `H²`.
    pub(crate) norm: f64,
}

/// The reduction on column-major storage; only the columns of `upper` that are still to come are kept up to date.
struct Reduce<'a> {
    m: &'a mut [f64],
    upper: &'a mut [f64],
    lower: &'a mut [f64],
    n: usize,
    work: &'a mut [f64],
}

impl Kernel for Reduce<'_> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let Self { m, upper, lower, n, work } = self;
        let (v, w) = work.split_at_mut(n);
        for j in 0..n.saturating_sub(1) {
            let i = j + 1;
            let v = &mut v[..n - i];
            // K(i+1.., j) to zero.
            v.copy_from_slice(&lower[j * n + i..(j + 1) * n]);
            let reflection = reflector::<FUSED>(v);
            if reflection.tau != 0.0 {
                reflect_column::<FUSED>(&mut m[j * n + i..(j + 1) * n], v, reflection.tau);
                two_sided::<FUSED>(&mut m[i * n..], n, i, v, w, reflection.tau);
                two_sided::<FUSED>(&mut upper[i * n..], n, i, v, w, reflection.tau);
                skew_two_sided::<FUSED>(&mut lower[i * n..], n, i, v, w, reflection.tau);
            }
            // K(i, j) to zero, against M(i, j).
            let (x, y) = (m[j * n + i], reflection.beta);
            let r = x.hypot(y);
            if y != 0.0 && r > 0.0 {
                m[j * n + i] = r;
                rotate::<FUSED>(m, upper, lower, n, i, x / r, y / r);
            }
            // M(i+1.., j) to zero.
            v.copy_from_slice(&m[j * n + i..(j + 1) * n]);
            let reflection = reflector::<FUSED>(v);
            m[j * n + i] = reflection.beta;
            if reflection.tau != 0.0 {
                two_sided::<FUSED>(&mut m[i * n..], n, i, v, w, reflection.tau);
                two_sided::<FUSED>(&mut upper[i * n..], n, i, v, w, reflection.tau);
                skew_two_sided::<FUSED>(&mut lower[i * n..], n, i, v, w, reflection.tau);
            }
        }
    }
}

#[inline(always)]
fn reflect_column<const FUSED: bool>(column: &mut [f64], v: &[f64], tau: f64) {
    let projection = tau * dot::<FUSED>(v, column);
    axpy::<FUSED>(column, -projection, v);
}

/// `K <- P K P` for a skew-symmetric `K` that is zero outside of rows and columns from `top`: `K + v wᵀ - w vᵀ`, `w = tau K v`.
#[inline(always)]
fn skew_two_sided<const FUSED: bool>(
    columns: &mut [f64],
    n: usize,
    top: usize,
    v: &[f64],
    w: &mut [f64],
    tau: f64,
) {
    let w = &mut w[..n - top];
    w.fill(0.0);
    for (column, weight) in columns.chunks_exact(n).zip(v) {
        axpy::<FUSED>(w, tau * *weight, &column[top..]);
    }
    for ((column, v_k), w_k) in columns.chunks_exact_mut(n).zip(v).zip(w.iter()) {
        for ((x, v), w) in column[top..].iter_mut().zip(v).zip(w.iter()) {
            *x = multiply_add::<FUSED>(*v, *w_k, multiply_add::<FUSED>(-*w, *v_k, *x));
        }
    }
}

/// The symplectic rotation of the planes `i` and `n + i`, on all columns from `i`.
#[inline(always)]
fn rotate<const FUSED: bool>(
    m: &mut [f64],
    upper: &mut [f64],
    lower: &mut [f64],
    n: usize,
    i: usize,
    cos: f64,
    sin: f64,
) {
    // The diagonal entries of M and Mᵀ are equal and those of N and K zero: a multiple of the identity, which stays.
    let diagonal = m[i * n + i];
    // Rows i of M and K, from column i + 1 on.
    for k in i + 1..n {
        let (x, y) = (m[k * n + i], lower[k * n + i]);
        m[k * n + i] = multiply_add::<FUSED>(cos, x, sin * y);
        let turned = multiply_add::<FUSED>(cos, y, -sin * x);
        lower[k * n + i] = turned;
        lower[i * n + k] = -turned;
    }
    // Columns i of M and N.
    for (x, y) in m[i * n..(i + 1) * n].iter_mut().zip(&mut upper[i * n..(i + 1) * n]) {
        (*x, *y) = (multiply_add::<FUSED>(cos, *x, sin * *y), multiply_add::<FUSED>(cos, *y, -sin * *x));
    }
    m[i * n + i] = diagonal;
    upper[i * n + i] = 0.0;
    for k in i + 1..n {
        upper[k * n + i] = -upper[i * n + k];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::eigenvalues::eigenvalues;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn law_squares_are_those_of_the_general_method() {
        let seed = 37;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        for n in [0, 1, 2, 3, 4, 5, 8, 9, 17, 40] {
            for definite in [true, false] {
                let mut random = || DMatrix::from_fn(n, n, |_, _| rng.random_range(-1.0..1.0));
                let (a, x, y) = (random(), random(), random());
                let symmetric =
                    |m: &DMatrix<f64>| if definite { m * m.transpose() } else { m + m.transpose() };
                let (g, q) = (symmetric(&x), -symmetric(&y));
                let found = squared_eigenvalues(&a, &g, &q).expect("converges");
                let mut h = DMatrix::zeros(2 * n, 2 * n);
                h.view_mut((0, 0), (n, n)).copy_from(&a);
                h.view_mut((0, n), (n, n)).copy_from(&g);
                h.view_mut((n, 0), (n, n)).copy_from(&q);
                h.view_mut((n, n), (n, n)).copy_from(&-a.transpose());
                assert!((found.norm - (&h * &h).norm()).abs() <= 1e-13 * found.norm);
                let expected: Vec<Complex64> =
                    eigenvalues(&h).expect("converges").into_iter().map(|v| v * v).collect();
                // Each square stands for two eigenvalues.
                assert_eq!(2 * found.values.len(), expected.len());
                let near = |value: &Complex64, others: &[Complex64]| {
                    let nearest = others.iter().map(|v| (v - value).norm()).fold(f64::INFINITY, f64::min);
                    assert!(nearest < 1e-10 * found.norm, "seed {seed} n {n}: {value} {nearest:e}");
                };
                expected.iter().for_each(|value| near(value, &found.values));
                found.values.iter().for_each(|value| near(value, &expected));
                let sum: Complex64 = expected.iter().sum();
                let twice: Complex64 = found.values.iter().sum::<Complex64>() * 2.0;
                assert!((sum - twice).norm() < 1e-11 * found.norm.max(1.0), "seed {seed} n {n}");
            }
        }
    }
}
