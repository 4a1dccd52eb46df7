//! The gain at one frequency to full accuracy, however close a pole is.

use nalgebra::DMatrix;
use num_complex::Complex64;

use super::gain::largest_singular_value;
use super::reduced::Reduced;
use crate::compensated::Doubled;

/// A gain and a bound on its error.
#[derive(Clone, Copy, Debug)]
pub(super) struct RefinedGain {
    pub(super) gain: f64,
    pub(super) error: f64,
}

/// Returns the largest singular value of `C (p I - A)⁻¹ B + D`, or `None` where `p I - A` is singular.
///
/// **Method**: LU of the balanced matrix and iterative refinement with residuals in doubled precision. In discrete time
/// `p` itself is doubled: a point a rounding off the unit circle is as bad as a pole a rounding off its place.
///
/// **Source**: Higham, "Accuracy and Stability of Numerical Algorithms", chapter 12.
///
/// **Accuracy**: of the order of the machine precision while the condition of `p I - A` stays below its inverse.
pub(super) fn refined_gain(sys: &Reduced, frequency: f64) -> Option<RefinedGain> {
    let n = sys.balanced.nrows();
    let (n_y, n_u) = sys.d.shape();
    let point = sys.point(frequency);
    let low = if sys.sample_time_s.is_some() { point * half_defect(point) } else { Complex64::ZERO };
    let mut resolvent = sys.balanced.map(|v| Complex64::new(-v, 0.0));
    for i in 0..n {
        resolvent[(i, i)] += point;
    }
    let lu = resolvent.lu();
    // The solution is an unevaluated sum as well, for outputs in which large states cancel.
    let mut x = [DMatrix::<Complex64>::zeros(n, n_u), DMatrix::zeros(n, n_u)];
    let mut g = DMatrix::zeros(n_y, n_u);
    let mut missing = f64::INFINITY;
    let mut size = f64::INFINITY;
    for _ in 0..REFINEMENTS_MAX {
        let step = lu.solve(&residual(sys, point, low, &x))?;
        let before = std::mem::replace(&mut size, step.norm());
        if !size.is_finite() {
            return None;
        }
        // A correction that does not shrink is rounding, or a condition beyond repair.
        if size >= before {
            break;
        }
        let [high, rest] = &mut x;
        for ((high, rest), dx) in high.iter_mut().zip(rest.iter_mut()).zip(step.iter()) {
            let sum = *high + (*rest + dx);
            *rest += dx - (sum - *high);
            *high = sum;
        }
        g = response(sys, &x);
        missing = terms(sys, &step);
        if missing <= f64::EPSILON * g.norm() {
            break;
        }
    }
    let mut gram = vec![Complex64::ZERO; n_u * n_u];
    let gain = largest_singular_value(g.as_slice(), n_y, n_u, &mut gram);
    let error = missing + 4.0 * f64::EPSILON * (gain + f64::EPSILON * terms(sys, &x[0]));
    gain.is_finite().then_some(RefinedGain { gain, error })
}

/// Half of `1 - |p|²`, to first order what `p` lacks to the unit circle.
fn half_defect(point: Complex64) -> f64 {
    let mut sum = Doubled { high: 1.0, low: 0.0 };
    sum.add_product(-point.re, point.re);
    sum.add_product(-point.im, point.im);
    0.5 * sum.value()
}

/// `B - (p I - A) X`, each entry rounded once.
fn residual(
    sys: &Reduced,
    point: Complex64,
    low: Complex64,
    x: &[DMatrix<Complex64>; 2],
) -> DMatrix<Complex64> {
    let n = sys.balanced.nrows();
    let rows = sys.balanced.transpose();
    DMatrix::from_fn(n, x[0].ncols(), |i, j| {
        let (mut re, mut im) = (Doubled { high: sys.b[(i, j)], low: 0.0 }, Doubled::default());
        for part in x {
            let column = &part.as_slice()[j * n..(j + 1) * n];
            for (&a, v) in rows.as_slice()[i * n..(i + 1) * n].iter().zip(column) {
                if a != 0.0 {
                    re.add_product(a, v.re);
                    im.add_product(a, v.im);
                }
            }
            for p in [point, low] {
                re.add_product(-p.re, column[i].re);
                re.add_product(p.im, column[i].im);
                im.add_product(-p.re, column[i].im);
                im.add_product(-p.im, column[i].re);
            }
        }
        Complex64::new(re.value(), im.value())
    })
}

/// `C X + D`, each entry rounded once.
fn response(sys: &Reduced, x: &[DMatrix<Complex64>; 2]) -> DMatrix<Complex64> {
    DMatrix::from_fn(sys.d.nrows(), sys.d.ncols(), |i, j| {
        let (mut re, mut im) = (Doubled { high: sys.d[(i, j)], low: 0.0 }, Doubled::default());
        for part in x {
            for (k, v) in part.column(j).iter().enumerate() {
                re.add_product(sys.c[(i, k)], v.re);
                im.add_product(sys.c[(i, k)], v.im);
            }
        }
        Complex64::new(re.value(), im.value())
    })
}

/// Norm of `|C| |X|`, the size of the terms in `C X`.
fn terms(sys: &Reduced, x: &DMatrix<Complex64>) -> f64 {
    (sys.c.abs() * x.map(Complex64::norm)).norm()
}

/// Refinement steps; each gains the digits that the condition leaves.
const REFINEMENTS_MAX: usize = 12;
