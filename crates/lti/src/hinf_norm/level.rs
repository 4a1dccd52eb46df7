//! Where a singular value of the response can cross a level: the eigenvalues of a Hamiltonian matrix near the axis.

use nalgebra::DMatrix;
use num_complex::Complex64;

use super::reduced::Reduced;
use crate::Error;
use crate::eigenvalues::eigenvalues;
use crate::square_reduced::squared_eigenvalues;

/// An eigenvalue of the level's Hamiltonian matrix close to the imaginary axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crossing {
    /// Frequency in rad/s, or radians per sample in discrete time.
    pub(super) frequency: f64,
    /// Distance from the axis in the same unit; zero for a crossing without rounding.
    pub(super) off_axis: f64,
}

/// A continuous system with the singular values of the given one on the imaginary axis, its direct term diagonal.
pub(super) struct LevelTest {
    a: DMatrix<f64>,
    b: DMatrix<f64>,
    c: DMatrix<f64>,
    /// Singular values of the direct term; a level has to lie above all of them.
    d: Vec<f64>,
    /// In discrete time `1` or `-1`, the sign of `z` under the bilinear map.
    bilinear_sign: Option<f64>,
}

impl LevelTest {
    pub(super) fn new(sys: &Reduced) -> Result<Self, Error> {
        let (mut a, mut b, mut c, mut d) =
            (sys.balanced.clone(), sys.b.clone(), sys.c.clone(), sys.d.clone());
        let mut bilinear_sign = None;
        if sys.sample_time_s.is_some() {
            // z = sign (1 + s) / (1 - s): the sign whose point at infinity, -sign, is farther from the poles.
            let nearest = |point: f64| sys.poles.iter().fold(f64::INFINITY, |m, p| m.min((p - point).norm()));
            let sign = if nearest(-1.0) >= nearest(1.0) { 1.0 } else { -1.0 };
            let n = a.nrows();
            let one = DMatrix::identity(n, n);
            a *= sign;
            let inverse = (&a + &one).try_inverse().ok_or(Error::BilinearPole { pole: -sign })?;
            let root = std::f64::consts::SQRT_2;
            let solved = &inverse * (b * sign);
            d -= &c * &solved;
            b = solved * root;
            c = c * &inverse * root;
            a = inverse * (a - one);
            bilinear_sign = Some(sign);
        }
        let mut singular_values = Vec::new();
        if d.iter().any(|&v| v != 0.0) {
            let (n_y, n_u) = d.shape();
            // Padded to a square, so that the factors are square as well.
            let size = n_y.max(n_u);
            let mut square = DMatrix::zeros(size, size);
            square.view_mut((0, 0), (n_y, n_u)).copy_from(&d);
            let svd = square.svd(true, true);
            if let (Some(u), Some(v_t)) = (&svd.u, &svd.v_t) {
                singular_values = svd.singular_values.as_slice().to_vec();
                // Columns of B and rows of C past the ports are zero.
                b *= v_t.columns(0, n_u).transpose();
                c = u.rows(0, n_y).transpose() * c;
            }
        }
        Ok(Self { a, b, c, d: singular_values, bilinear_sign })
    }

    /// The level below which no Hamiltonian exists.
    pub(super) fn floor(&self) -> f64 {
        self.d.iter().fold(0.0, |m, &v| m.max(v))
    }

    /// Returns everything that can be a crossing of `level`, sorted by frequency.
    ///
    /// **Method**: `level² I - Gᴴ G` is singular at `s` where `H` has the eigenvalue `s`; with `D = diag(d)` the weights
    /// `1 / (level² - d²)` of its blocks need no inversion. The off-diagonal blocks carry `level`, so that they are of like
    /// size.
    ///
    /// **Source**: Boyd, Balakrishnan and Kabamba 1989.
    pub(super) fn crossings(&self, level: f64) -> Result<Vec<Crossing>, Error> {
        let d = |k: usize| self.d.get(k).copied().unwrap_or(0.0);
        let weight = |k: usize| 1.0 / ((1.0 - d(k) / level) * (1.0 + d(k) / level));
        let (mut weighted_b, mut weighted_c) = (self.b.clone(), self.c.clone());
        for (k, mut column) in weighted_b.column_iter_mut().enumerate() {
            column *= weight(k) / level;
        }
        for (k, mut row) in weighted_c.row_iter_mut().enumerate() {
            row *= weight(k) / level;
        }
        let mut a = self.a.clone();
        if !self.d.is_empty() {
            let mut feedback = self.c.clone();
            for (k, mut row) in feedback.row_iter_mut().enumerate() {
                row *= weight(k) * d(k) / level / level;
            }
            // B diag(d / (level² - d²)) C, with B and C padded to the same number of ports.
            a += &self.b * feedback;
        }
        let upper = &weighted_b * self.b.transpose();
        let lower = -self.c.tr_mul(&weighted_c);
        let mut crossings = match self.crossings_by_squares(&a, &upper, &lower)? {
            Some(crossings) => crossings,
            None => self.crossings_by_eigenvalues(&a, &upper, &lower)?,
        };
        crossings.sort_by(|x, y| x.frequency.total_cmp(&y.frequency));
        crossings.dedup_by(|x, y| x.frequency == y.frequency && x.off_axis >= y.off_axis);
        Ok(crossings)
    }

    /// Near eigenvalues by the square of the Hamiltonian; `None` where some are too small against the norm for that.
    ///
    /// A single small square does no harm: a response that peaks at zero has one just above its peak. What is lost is lost
    /// where two of them meet, and one that stands alone is real and as accurate as the norm lets it be.
    fn crossings_by_squares(
        &self,
        a: &DMatrix<f64>,
        upper: &DMatrix<f64>,
        lower: &DMatrix<f64>,
    ) -> Result<Option<Vec<Crossing>>, Error> {
        if a.nrows() < SQUARES_FROM {
            return Ok(None);
        }
        let squares = squared_eigenvalues(a, upper, lower)?;
        let rounding = ROUNDING * f64::EPSILON * squares.norm;
        let mut sizes: Vec<f64> = squares.values.iter().map(|v| v.norm()).collect();
        sizes.sort_by(f64::total_cmp);
        if let [smallest, second, ..] = sizes[..] {
            let resolved = |size: f64| size > SQUARE_MIN * squares.norm;
            let alone = resolved(second) && second > ALONE * smallest;
            if !(resolved(smallest) || alone) {
                return Ok(None);
            }
        }
        // A double eigenvalue of the square moves by the root of its rounding.
        let near = |v: &Complex64| v.re <= (rounding / v.norm()).max(NEAR_AXIS * v.norm());
        let roots = squares.values.into_iter().map(|v| v.sqrt()).filter(near);
        Ok(Some(roots.map(|v| self.crossing(Complex64::new(v.re, v.im.abs()))).collect()))
    }

    fn crossings_by_eigenvalues(
        &self,
        a: &DMatrix<f64>,
        upper: &DMatrix<f64>,
        lower: &DMatrix<f64>,
    ) -> Result<Vec<Crossing>, Error> {
        let n = a.nrows();
        let mut h = DMatrix::zeros(2 * n, 2 * n);
        h.view_mut((0, 0), (n, n)).copy_from(a);
        h.view_mut((0, n), (n, n)).copy_from(upper);
        h.view_mut((n, 0), (n, n)).copy_from(lower);
        for j in 0..n {
            for i in 0..n {
                h[(n + i, n + j)] = -a[(j, i)];
            }
        }
        let rounding = ROUNDING * f64::EPSILON * h.norm();
        let near = |v: &Complex64| v.im >= 0.0 && v.re.abs() <= rounding.max(NEAR_AXIS * v.norm());
        Ok(eigenvalues(&h)?.into_iter().filter(near).map(|v| self.crossing(v)).collect())
    }

    fn crossing(&self, value: Complex64) -> Crossing {
        match self.bilinear_sign {
            None => Crossing { frequency: value.im, off_axis: value.re.abs() },
            Some(sign) => {
                let angle = 2.0 * value.im.atan();
                let frequency = if sign > 0.0 { angle } else { std::f64::consts::PI - angle };
                Crossing { frequency, off_axis: 2.0 * value.re.abs() / (1.0 + value.im * value.im) }
            }
        }
    }
}

/// Rounding of an eigenvalue in units of the machine precision times the norm.
const ROUNDING: f64 = 100.0;
/// Eigenvalues this close to the axis, relative to their size, may be crossings that rounding has moved.
const NEAR_AXIS: f64 = 1e-2;
/// Order from which the detour over squares pays.
const SQUARES_FROM: usize = 6;
/// Squares of eigenvalues this small against the norm of the matrix's square may lose half of their digits where two of them meet.
const SQUARE_MIN: f64 = 1e-9;
/// Ratio of two small squares that do not meet.
const ALONE: f64 = 10.0;
