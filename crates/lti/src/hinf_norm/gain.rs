//! The largest singular value of a response, at `O(n²)` per frequency.

use nalgebra::DMatrix;
use num_complex::Complex64;

use super::reduced::Reduced;

/// Evaluates gains of a reduced system without allocating.
///
/// **Method**: Gaussian elimination with partial pivoting on the Hessenberg matrix `p I - H`, row by row, with separate
/// real and imaginary parts: one multiplier per row.
///
/// **Source**: Laub 1981, "Efficient multivariable frequency response computations".
pub(super) struct GainEvaluator<'a> {
    sys: &'a Reduced,
    n: usize,
    n_u: usize,
    n_y: usize,
    /// `-H` by rows, and `B` and `C` by columns of right-hand sides and rows of outputs.
    minus_h: Vec<f64>,
    b: Vec<f64>,
    c: Vec<f64>,
    /// The triangular factor by rows, and the multiplier and the exchange of each elimination step.
    upper_re: Vec<f64>,
    upper_im: Vec<f64>,
    steps: Vec<(Complex64, bool)>,
    row_re: Vec<f64>,
    row_im: Vec<f64>,
    x_re: Vec<f64>,
    x_im: Vec<f64>,
    response: Vec<Complex64>,
    gram: Vec<Complex64>,
    norm_h: f64,
    /// Evaluations so far.
    pub(super) count: usize,
}

impl<'a> GainEvaluator<'a> {
    pub(super) fn new(sys: &'a Reduced) -> Self {
        let n = sys.hessenberg.nrows();
        let (n_y, n_u) = sys.d.shape();
        let mut minus_h = vec![0.0; n * n];
        for i in 0..n {
            for j in i.saturating_sub(1)..n {
                minus_h[i * n + j] = -sys.hessenberg[(i, j)];
            }
        }
        Self {
            sys,
            n,
            n_u,
            n_y,
            minus_h,
            b: sys.hessenberg_b.as_slice().to_vec(),
            c: sys.hessenberg_c.transpose().as_slice().to_vec(),
            upper_re: vec![0.0; n * n],
            upper_im: vec![0.0; n * n],
            steps: vec![(Complex64::ZERO, false); n],
            row_re: vec![0.0; n],
            row_im: vec![0.0; n],
            x_re: vec![0.0; n * n_u],
            x_im: vec![0.0; n * n_u],
            response: vec![Complex64::ZERO; n_y * n_u],
            gram: vec![Complex64::ZERO; n_u * n_u],
            norm_h: sys.hessenberg.norm(),
            count: 0,
        }
    }

    /// The largest gain at a frequency; infinite at a pole.
    pub(super) fn gain(&mut self, frequency: f64) -> f64 {
        if frequency.is_infinite() {
            for (k, value) in self.response.iter_mut().enumerate() {
                *value = Complex64::new(self.sys.d[(k % self.n_y, k / self.n_y)], 0.0);
            }
        } else {
            self.count += 1;
            self.eliminate(self.sys.point(frequency));
            self.back_substitute();
            self.outputs();
        }
        let gain = largest_singular_value(&self.response, self.n_y, self.n_u, &mut self.gram);
        if gain.is_nan() { f64::INFINITY } else { gain }
    }

    /// First-order bound on the error of the last gain that the rounding of the Hessenberg form can cause.
    pub(super) fn rounding(&mut self, frequency: f64) -> f64 {
        let x = norm(&self.x_re, &self.x_im);
        let mut square = 0.0;
        for output in 0..self.n_y {
            square += self.left_solution_square(output);
        }
        let size = if self.sys.sample_time_s.is_some() { 1.0 } else { frequency.abs() };
        f64::EPSILON * (self.norm_h + size) * x * square.sqrt()
    }

    fn eliminate(&mut self, point: Complex64) {
        let n = self.n;
        for (k, &value) in self.b.iter().enumerate() {
            self.x_re[k] = value;
            self.x_im[k] = 0.0;
        }
        if n == 0 {
            return;
        }
        self.row_re.copy_from_slice(&self.minus_h[..n]);
        self.row_im.fill(0.0);
        self.row_re[0] += point.re;
        self.row_im[0] = point.im;
        for k in 0..n - 1 {
            let next = &self.minus_h[(k + 1) * n..(k + 2) * n];
            let below = next[k];
            let pivot = Complex64::new(self.row_re[k], self.row_im[k]);
            let exchange = pivot.re.abs().max(pivot.im.abs()) < below.abs();
            let upper_re = &mut self.upper_re[k * n + k..(k + 1) * n];
            let upper_im = &mut self.upper_im[k * n + k..(k + 1) * n];
            let (row_re, row_im) = (&mut self.row_re[k..n], &mut self.row_im[k..n]);
            let next = &next[k..];
            let f;
            if exchange {
                f = pivot / below;
                upper_re.copy_from_slice(next);
                upper_im.fill(0.0);
                upper_re[1] += point.re;
                upper_im[1] += point.im;
                for ((re, im), &x) in row_re.iter_mut().zip(row_im.iter_mut()).zip(next) {
                    *re -= f.re * x;
                    *im -= f.im * x;
                }
                let diagonal = f * point;
                row_re[1] -= diagonal.re;
                row_im[1] -= diagonal.im;
            } else {
                f = if below == 0.0 { Complex64::ZERO } else { below / pivot };
                upper_re.copy_from_slice(row_re);
                upper_im.copy_from_slice(row_im);
                for ((re, im), &x) in row_re.iter_mut().zip(row_im.iter_mut()).zip(next) {
                    let (old_re, old_im) = (*re, *im);
                    *re = x - (f.re * old_re - f.im * old_im);
                    *im = -(f.re * old_im + f.im * old_re);
                }
                row_re[1] += point.re;
                row_im[1] += point.im;
            }
            self.steps[k] = (f, exchange);
            for column in 0..self.n_u {
                let (i, j) = (column * n + k, column * n + k + 1);
                if exchange {
                    self.x_re.swap(i, j);
                    self.x_im.swap(i, j);
                }
                let (re, im) = (self.x_re[i], self.x_im[i]);
                self.x_re[j] -= f.re * re - f.im * im;
                self.x_im[j] -= f.re * im + f.im * re;
            }
        }
        self.upper_re[n * n - 1] = self.row_re[n - 1];
        self.upper_im[n * n - 1] = self.row_im[n - 1];
    }

    fn back_substitute(&mut self) {
        let n = self.n;
        for column in 0..self.n_u {
            let x_re = &mut self.x_re[column * n..(column + 1) * n];
            let x_im = &mut self.x_im[column * n..(column + 1) * n];
            for k in (0..n).rev() {
                let row = k * n + k + 1..(k + 1) * n;
                let sum = complex_dot(
                    &self.upper_re[row.clone()],
                    &self.upper_im[row],
                    &x_re[k + 1..],
                    &x_im[k + 1..],
                );
                let pivot = Complex64::new(self.upper_re[k * n + k], self.upper_im[k * n + k]);
                let value = (Complex64::new(x_re[k], x_im[k]) - sum) / pivot;
                x_re[k] = value.re;
                x_im[k] = value.im;
            }
        }
    }

    fn outputs(&mut self) {
        let n = self.n;
        for column in 0..self.n_u {
            let x_re = &self.x_re[column * n..(column + 1) * n];
            let x_im = &self.x_im[column * n..(column + 1) * n];
            for output in 0..self.n_y {
                let c = &self.c[output * n..(output + 1) * n];
                let value = Complex64::new(real_dot(c, x_re), real_dot(c, x_im));
                self.response[column * self.n_y + output] = value + self.sys.d[(output, column)];
            }
        }
    }

    /// Square of the norm of `C_output (p I - H)⁻¹`, from the factors of the last evaluation.
    fn left_solution_square(&mut self, output: usize) -> f64 {
        let n = self.n;
        let (re, im) = (&mut self.row_re, &mut self.row_im);
        re.copy_from_slice(&self.c[output * n..(output + 1) * n]);
        im.fill(0.0);
        for k in 0..n {
            let pivot = Complex64::new(self.upper_re[k * n + k], self.upper_im[k * n + k]);
            let value = Complex64::new(re[k], im[k]) / pivot;
            (re[k], im[k]) = (value.re, value.im);
            for j in k + 1..n {
                let (u_re, u_im) = (self.upper_re[k * n + j], self.upper_im[k * n + j]);
                re[j] -= u_re * value.re - u_im * value.im;
                im[j] -= u_re * value.im + u_im * value.re;
            }
        }
        for k in (0..n.saturating_sub(1)).rev() {
            let (f, exchange) = self.steps[k];
            let correction = f * Complex64::new(re[k + 1], im[k + 1]);
            re[k] -= correction.re;
            im[k] -= correction.im;
            if exchange {
                re.swap(k, k + 1);
                im.swap(k, k + 1);
            }
        }
        let size = norm(re, im);
        size * size
    }
}

fn norm(re: &[f64], im: &[f64]) -> f64 {
    re.iter().chain(im).map(|v| v * v).sum::<f64>().sqrt()
}

/// Sum of products in four lanes, which the compiler keeps in vector registers.
fn real_dot(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0; LANES];
    let (a_chunks, b_chunks) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest: f64 = a_chunks.remainder().iter().zip(b_chunks.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in a_chunks.zip(b_chunks) {
        for lane in 0..LANES {
            lanes[lane] += x[lane] * y[lane];
        }
    }
    rest + lanes.iter().sum::<f64>()
}

fn complex_dot(a_re: &[f64], a_im: &[f64], b_re: &[f64], b_im: &[f64]) -> Complex64 {
    let (mut re, mut im) = ([0.0; LANES], [0.0; LANES]);
    let whole = a_re.len() / LANES * LANES;
    let chunks = a_re.chunks_exact(LANES).zip(a_im.chunks_exact(LANES));
    for ((ar, ai), (br, bi)) in chunks.zip(b_re.chunks_exact(LANES).zip(b_im.chunks_exact(LANES))) {
        for lane in 0..LANES {
            re[lane] += ar[lane] * br[lane] - ai[lane] * bi[lane];
            im[lane] += ar[lane] * bi[lane] + ai[lane] * br[lane];
        }
    }
    let mut sum = Complex64::new(re.iter().sum(), im.iter().sum());
    for k in whole..a_re.len() {
        sum += Complex64::new(a_re[k], a_im[k]) * Complex64::new(b_re[k], b_im[k]);
    }
    sum
}

/// The largest singular value of an `n_y × n_u` matrix given by columns, `n_u <= n_y`; `gram` has room for `n_u²`.
///
/// **Accuracy**: the square root of the largest eigenvalue of `Gᴴ G`, which for the largest one loses nothing.
pub(super) fn largest_singular_value(g: &[Complex64], n_y: usize, n_u: usize, gram: &mut [Complex64]) -> f64 {
    if g.len() == 1 {
        return g[0].norm();
    }
    let scale = g.iter().fold(0.0_f64, |m, v| {
        let size = v.re.abs().max(v.im.abs());
        if size.is_nan() { f64::INFINITY } else { m.max(size) }
    });
    if scale == 0.0 || scale.is_infinite() {
        return scale;
    }
    // A power of two, so that scaling rounds nothing.
    let scale = scale.log2().floor().clamp(-1000.0, 1000.0).exp2();
    let unit = 1.0 / scale;
    for j in 0..n_u {
        for i in 0..=j {
            let (left, right) = (&g[i * n_y..(i + 1) * n_y], &g[j * n_y..(j + 1) * n_y]);
            let dot: Complex64 = left.iter().zip(right).map(|(x, y)| (x * unit).conj() * (y * unit)).sum();
            gram[j * n_u + i] = dot;
            gram[i * n_u + j] = dot.conj();
        }
    }
    let square = match n_u {
        1 => gram[0].re,
        2 => {
            let (p, q) = (gram[0].re, gram[3].re);
            0.5 * (p + q) + (0.5 * (p - q)).hypot(gram[1].norm())
        }
        3 => largest_of_three(gram).unwrap_or_else(|| jacobi_largest(gram, 3)),
        k if k <= JACOBI_SIZE_MAX => jacobi_largest(gram, k),
        k => DMatrix::from_column_slice(k, k, &gram[..k * k]).symmetric_eigenvalues().max(),
    };
    scale * square.max(0.0).sqrt()
}

/// The largest eigenvalue of a Hermitian matrix of order three in closed form; `None` where the two largest nearly meet, which
/// would cost half of the digits.
///
/// **Source**: Smith 1961, "Eigenvalues of a symmetric 3 × 3 matrix".
fn largest_of_three(a: &[Complex64]) -> Option<f64> {
    let (x, y, z) = (a[3], a[6], a[7]);
    let mean = (a[0].re + a[4].re + a[8].re) / 3.0;
    let [p, q, r] = [a[0].re - mean, a[4].re - mean, a[8].re - mean];
    let (xx, yy, zz) = (x.norm_sqr(), y.norm_sqr(), z.norm_sqr());
    let spread = ((p * p + q * q + r * r + 2.0 * (xx + yy + zz)) / 6.0).sqrt();
    if spread <= f64::EPSILON * mean {
        return None;
    }
    let determinant = p * (q * r - zz) - q * yy - r * xx + 2.0 * (x * z * y.conj()).re;
    // cos(3 phi) = det((A - mean I) / spread) / 2
    let cos = 0.5 * determinant / (spread * spread * spread);
    (cos > CLOSED_FORM_MIN).then(|| mean + 2.0 * spread * (cos.min(1.0).acos() / 3.0).cos())
}

/// The largest eigenvalue of a Hermitian matrix by cyclic Jacobi rotations.
fn jacobi_largest(a: &mut [Complex64], k: usize) -> f64 {
    for _ in 0..JACOBI_SWEEPS_MAX {
        let largest = (0..k).fold(0.0_f64, |m, i| m.max(a[i * k + i].re));
        let mut off = 0.0;
        for j in 1..k {
            for i in 0..j {
                off += a[j * k + i].norm_sqr();
            }
        }
        // An off-diagonal part of relative size e moves the largest eigenvalue by e at most.
        if off.sqrt() <= JACOBI_TOLERANCE * largest {
            return largest;
        }
        for q in 1..k {
            for p in 0..q {
                rotate(a, k, p, q);
            }
        }
    }
    (0..k).fold(0.0_f64, |m, i| m.max(a[i * k + i].re))
}

/// Zeroes the entry `(p, q)` of a Hermitian matrix by a unitary rotation.
fn rotate(a: &mut [Complex64], k: usize, p: usize, q: usize) {
    let entry = a[q * k + p];
    let size = entry.norm();
    if size < f64::MIN_POSITIVE {
        return;
    }
    let phase = entry / size;
    let theta = 0.5 * (a[q * k + q].re - a[p * k + p].re) / size;
    let t = 1.0_f64.copysign(theta) / (theta.abs() + theta.hypot(1.0));
    let cos = 1.0 / t.hypot(1.0);
    let sin = phase * (t * cos);
    // Columns p and q, then rows p and q: the entry (i, j) is stored at j * k + i.
    for i in 0..k {
        let (x, y) = (a[p * k + i], a[q * k + i]);
        a[p * k + i] = x * cos - y * sin.conj();
        a[q * k + i] = x * sin + y * cos;
    }
    for j in 0..k {
        let (x, y) = (a[j * k + p], a[j * k + q]);
        a[j * k + p] = x * cos - y * sin;
        a[j * k + q] = x * sin.conj() + y * cos;
    }
}

/// Lanes of a sum: two registers of two or one of four.
const LANES: usize = 4;
/// `cos(3 phi)` is -1 where the two largest eigenvalues of three meet.
const CLOSED_FORM_MIN: f64 = -0.99;
/// Larger Gram matrices are tridiagonalized instead.
const JACOBI_SIZE_MAX: usize = 8;
/// Sweeps allowed; convergence is quadratic and takes three to six.
const JACOBI_SWEEPS_MAX: usize = 30;
/// Relative size of the off-diagonal part at which the diagonal is the spectrum.
const JACOBI_TOLERANCE: f64 = 1e-15;

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn law_the_largest_singular_value_agrees_with_an_svd() {
        let seed = 11;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        for trial in 0..400 {
            let n_u = 1 + trial % 10;
            let n_y = n_u + trial % 3;
            let scale = 10.0_f64.powi(trial as i32 % 41 - 20);
            let g = DMatrix::from_fn(n_y, n_u, |_, _| {
                Complex64::new(rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0)) * scale
            });
            let mut gram = vec![Complex64::ZERO; n_u * n_u];
            let ours = largest_singular_value(g.as_slice(), n_y, n_u, &mut gram);
            let svd = g.singular_values().max();
            assert!((ours / svd - 1.0).abs() < 2e-14, "seed {seed} trial {trial}: {ours} {svd}");
        }
    }
}
