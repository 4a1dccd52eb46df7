//! Eigenvalues of small complex matrices and their left and right vectors.

use nalgebra::{DMatrix, DVector, Schur};
use num_complex::Complex64;

/// All eigenvalues; `None` where the QR iteration did not end within its bound, twice.
pub(crate) fn complex_eigenvalues(a: &DMatrix<Complex64>) -> Option<Vec<Complex64>> {
    let n = a.nrows();
    if n == 1 {
        return Some(vec![a[(0, 0)]]);
    }
    let size = a.norm();
    if size == 0.0 {
        return Some(vec![Complex64::new(0.0, 0.0); n]);
    }
    for restart in 0..2 {
        let start = if restart == 0 { a.clone() } else { reflected(a) };
        if let Some(schur) = Schur::try_new(start / Complex64::new(size, 0.0), f64::EPSILON, 60 * n) {
            let t = schur.unpack().1;
            let values: Vec<Complex64> = (0..n).map(|k| t[(k, k)] * size).collect();
            if values.iter().all(|v| v.re.is_finite() && v.im.is_finite()) {
                return Some(values);
            }
        }
    }
    None
}

/// `H A H` with the reflection of a fixed vector without symmetry: the same eigenvalues from another start.
fn reflected(a: &DMatrix<Complex64>) -> DMatrix<Complex64> {
    let v = DVector::from_fn(a.nrows(), |i, _| Complex64::new((i as f64 + 1.618).sin(), (i as f64).cos()));
    let v = v.normalize();
    let h = DMatrix::identity(a.nrows(), a.nrows()) - &v * v.adjoint() * Complex64::new(2.0, 0.0);
    &h * a * &h
}

/// An eigenvalue with its unit right and left vectors.
pub(crate) struct EigenTriple {
    pub(crate) value: Complex64,
    pub(crate) right: DVector<Complex64>,
    pub(crate) left: DVector<Complex64>,
}

/// The eigenvalue next to `near`, refined, with its vectors.
///
/// **Method**: inverse iteration from both sides with a generalised Rayleigh quotient.
pub(crate) fn eigen_triple(a: &DMatrix<Complex64>, near: Complex64) -> Option<EigenTriple> {
    let n = a.nrows();
    let size = a.norm().max(f64::MIN_POSITIVE);
    let mut value = near;
    let seed = |k: f64| {
        DVector::from_fn(n, |i, _| {
            Complex64::new(1.0 + 0.3 * (k + i as f64).sin(), 0.2 * (i as f64 * k).cos())
        })
        .normalize()
    };
    let (mut right, mut left) = (seed(0.7), seed(1.9));
    for _ in 0..INVERSE_STEPS {
        // A shift just off the eigenvalue keeps the factors finite.
        let shift = value + Complex64::new(1.0, 0.7) * (4.0 * f64::EPSILON * size);
        let shifted = a - DMatrix::identity(n, n) * shift;
        let inverse = shifted.try_inverse()?;
        for _ in 0..2 {
            right = (&inverse * right).normalize();
            left = inverse.ad_mul(&left).normalize();
        }
        let product = left.dotc(&right);
        if product.norm() < 1e-14 {
            break;
        }
        let next = left.dotc(&(a * &right)) / product;
        let change = (next - value).norm();
        value = next;
        if change < 1e-15 * size {
            break;
        }
    }
    let usable = value.re.is_finite() && value.im.is_finite() && right.iter().all(|v| v.re.is_finite());
    usable.then_some(EigenTriple { value, right, left })
}

const INVERSE_STEPS: usize = 4;
