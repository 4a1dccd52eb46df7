//! Upper Hessenberg form by Householder reflections.

use nalgebra::DMatrix;

use crate::Error;
use crate::vectorized::{self, Kernel, axpy, dot, multiply_add, reflector};

/// An upper Hessenberg form `M = Q H Qᵀ`.
#[derive(Clone, Debug, PartialEq)]
pub struct Hessenberg {
    /// Orthogonal factor, `n × n`.
    pub q: DMatrix<f64>,
    /// Zero below the first subdiagonal, `n × n`.
    pub h: DMatrix<f64>,
}

impl Hessenberg {
    /// Returns the Hessenberg form of a square matrix.
    ///
    /// **Method**: one reflector for each column, applied from both sides in a single pass over the matrix.
    ///
    /// **Source**: Golub and Van Loan 2013, section 7.4.2.
    ///
    /// **Accuracy**: backward stable, `||M - Q H Qᵀ||` a small multiple of the machine precision times `||M||`.
    ///
    /// **Errors**: [`Error::Shape`], [`Error::NotFinite`].
    ///
    /// **Example**
    /// ```
    /// use nalgebra::dmatrix;
    /// let m = dmatrix![1.0, 2.0, 3.0; 4.0, 5.0, 6.0; 7.0, 8.0, 10.0];
    /// let form = telepulse_lti::hessenberg::Hessenberg::new(&m)?;
    /// assert_eq!(form.h[(2, 0)], 0.0);
    /// assert!((&form.q * &form.h * form.q.transpose() - m).norm() < 1e-14);
    /// # Ok::<(), telepulse_lti::Error>(())
    /// ```
    pub fn new(m: &DMatrix<f64>) -> Result<Self, Error> {
        check_square_and_finite("m", m)?;
        let mut h = m.clone();
        let q = reduce_with_vectors(&mut h);
        Ok(Self { q, h })
    }
}

/// Refuses a matrix that is not square or not finite.
pub(crate) fn check_square_and_finite(matrix: &'static str, m: &DMatrix<f64>) -> Result<(), Error> {
    let (n, cols) = m.shape();
    if n != cols {
        return Err(Error::Shape { matrix, expected_rows: n, expected_cols: n, rows: n, cols });
    }
    match m.iter().enumerate().find(|(_, v)| !v.is_finite()) {
        Some((index, &value)) => Err(Error::NotFinite { quantity: matrix, index, value }),
        None => Ok(()),
    }
}

/// Reduces a square matrix in place.
pub(crate) fn reduce(h: &mut DMatrix<f64>) {
    let n = h.nrows();
    let mut work = vec![0.0; 2 * n];
    vectorized::run(Reduce { h: h.as_mut_slice(), n, work: &mut work, q: None });
    clear_below(h);
}

/// Reduces a square matrix in place and returns the orthogonal factor.
pub(crate) fn reduce_with_vectors(h: &mut DMatrix<f64>) -> DMatrix<f64> {
    let n = h.nrows();
    let mut q = DMatrix::identity(n, n);
    let mut work = vec![0.0; 3 * n];
    vectorized::run(Reduce { h: h.as_mut_slice(), n, work: &mut work, q: Some(q.as_mut_slice()) });
    clear_below(h);
    q
}

fn clear_below(h: &mut DMatrix<f64>) {
    let n = h.nrows();
    for (j, column) in h.as_mut_slice().chunks_exact_mut(n.max(1)).enumerate() {
        column.iter_mut().skip(j + 2).for_each(|v| *v = 0.0);
    }
}

struct Reduce<'a> {
    h: &'a mut [f64],
    n: usize,
    work: &'a mut [f64],
    q: Option<&'a mut [f64]>,
}

impl Kernel for Reduce<'_> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let Self { h, n, work, q } = self;
        let (v, rest) = work.split_at_mut(n);
        let (w, taus) = rest.split_at_mut(n);
        for k in 0..n.saturating_sub(2) {
            let length = n - k - 1;
            let v = &mut v[..length];
            let source = &mut h[k * n + k + 1..(k + 1) * n];
            v.copy_from_slice(source);
            let reflection = reflector::<FUSED>(v);
            // The reflector's tail stays where its zeros are, for the orthogonal factor.
            source.copy_from_slice(v);
            source[0] = reflection.beta;
            if let Some(tau) = taus.get_mut(k) {
                *tau = reflection.tau;
            }
            if reflection.tau != 0.0 {
                two_sided::<FUSED>(&mut h[(k + 1) * n..], n, k + 1, v, w, reflection.tau);
            }
        }
        if let Some(q) = q {
            form_q::<FUSED>(h, q, n, taus, v);
        }
    }
}

/// `columns <- P columns P` with `P = I - tau v vᵀ` on rows and columns from `top`; `columns` starts at column `top`.
#[inline(always)]
pub(crate) fn two_sided<const FUSED: bool>(
    columns: &mut [f64],
    n: usize,
    top: usize,
    v: &[f64],
    w: &mut [f64],
    tau: f64,
) {
    // w = tau C v, four columns at a time.
    w.fill(0.0);
    let mut quads = columns.chunks_exact(4 * n);
    let mut weights = v.chunks_exact(4);
    for (quad, weight) in (&mut quads).zip(&mut weights) {
        let (c0, others) = quad.split_at(n);
        let (c1, others) = others.split_at(n);
        let (c2, c3) = others.split_at(n);
        let weight = [tau * weight[0], tau * weight[1], tau * weight[2], tau * weight[3]];
        for ((((w, a), b), c), d) in w.iter_mut().zip(c0).zip(c1).zip(c2).zip(c3) {
            let sum = multiply_add::<FUSED>(weight[1], *b, weight[0] * *a);
            let other = multiply_add::<FUSED>(weight[3], *d, weight[2] * *c);
            *w += sum + other;
        }
    }
    for (column, weight) in quads.remainder().chunks_exact(n).zip(weights.remainder()) {
        axpy::<FUSED>(w, tau * *weight, column);
    }
    // Every column first loses its multiple of w, then is reflected.
    let (w_top, w_tail) = w.split_at(top);
    let v_w = dot::<FUSED>(v, w_tail);
    for (column, weight) in columns.chunks_exact_mut(n).zip(v) {
        let (upper, lower) = column.split_at_mut(top);
        axpy::<FUSED>(upper, -*weight, w_top);
        let projection = tau * (dot::<FUSED>(v, lower) - *weight * v_w);
        for ((x, w), v) in lower.iter_mut().zip(w_tail).zip(v) {
            *x = multiply_add::<FUSED>(-projection, *v, multiply_add::<FUSED>(-*weight, *w, *x));
        }
    }
}

/// Multiplies the reflectors stored below the subdiagonal, the last one first so that the product stays a corner.
#[inline(always)]
fn form_q<const FUSED: bool>(h: &[f64], q: &mut [f64], n: usize, taus: &[f64], v: &mut [f64]) {
    for k in (0..n.saturating_sub(2)).rev() {
        if taus[k] == 0.0 {
            continue;
        }
        let length = n - k - 1;
        let v = &mut v[..length];
        v.copy_from_slice(&h[k * n + k + 1..(k + 1) * n]);
        v[0] = 1.0;
        for column in q[(k + 1) * n..].chunks_exact_mut(n) {
            let lower = &mut column[k + 1..];
            let projection = taus[k] * dot::<FUSED>(v, lower);
            axpy::<FUSED>(lower, -projection, v);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn law_the_form_is_an_orthogonal_similarity() {
        let seed = 31;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        for n in [0, 1, 2, 3, 4, 5, 7, 8, 9, 16, 33, 70] {
            for scale in [1e-150, 1.0, 1e150] {
                let m = DMatrix::from_fn(n, n, |_, _| scale * rng.random_range(-1.0..1.0));
                let Hessenberg { q, h } = Hessenberg::new(&m).expect("finite");
                let one = DMatrix::<f64>::identity(n, n);
                assert!((q.tr_mul(&q) - one).norm() < 1e-14 * (n + 1) as f64, "seed {seed} n {n}");
                let back = &q * &h * q.transpose();
                let error = (back - &m).norm() / m.norm().max(f64::MIN_POSITIVE);
                assert!(error < 1e-14, "seed {seed} n {n}: {error:e}");
                assert!((0..n).all(|j| (j + 2..n).all(|i| h[(i, j)] == 0.0)));
            }
        }
    }

    #[test]
    fn edge_a_rectangle_and_a_nan_are_refused() {
        assert!(matches!(Hessenberg::new(&DMatrix::zeros(2, 3)), Err(Error::Shape { .. })));
        let nan = DMatrix::from_element(3, 3, f64::NAN);
        assert!(matches!(Hessenberg::new(&nan), Err(Error::NotFinite { .. })));
    }
}
