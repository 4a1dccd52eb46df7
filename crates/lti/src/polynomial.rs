//! Real polynomials as slices of coefficients in descending powers: `[1, 2, 3]` is `s^2 + 2 s + 3`.

use crate::Error;
use crate::eigenvalues::eigenvalues;
use nalgebra::DMatrix;
use num_complex::Complex64;

/// The coefficients without leading zeros; the zero polynomial becomes the empty slice.
#[must_use]
pub fn trim(coefficients: &[f64]) -> &[f64] {
    let leading = coefficients.iter().position(|&c| c != 0.0).unwrap_or(coefficients.len());
    &coefficients[leading..]
}

/// The value at a point of the complex plane, by Horner's rule.
#[must_use]
pub fn evaluate(coefficients: &[f64], point: Complex64) -> Complex64 {
    coefficients.iter().fold(Complex64::ZERO, |sum, &c| sum * point + c)
}

/// The product of two polynomials.
#[must_use]
pub fn multiply(left: &[f64], right: &[f64]) -> Vec<f64> {
    if left.is_empty() || right.is_empty() {
        return Vec::new();
    }
    let mut product = vec![0.0; left.len() + right.len() - 1];
    for (i, l) in left.iter().enumerate() {
        for (j, r) in right.iter().enumerate() {
            product[i + j] += l * r;
        }
    }
    product
}

/// The sum of two polynomials.
#[must_use]
pub fn add(left: &[f64], right: &[f64]) -> Vec<f64> {
    let (long, short) = if left.len() >= right.len() { (left, right) } else { (right, left) };
    let mut sum = long.to_vec();
    let offset = long.len() - short.len();
    for (target, value) in sum[offset..].iter_mut().zip(short) {
        *target += value;
    }
    sum
}

/// The derivative.
#[must_use]
pub fn derivative(coefficients: &[f64]) -> Vec<f64> {
    let degree = coefficients.len().saturating_sub(1);
    coefficients.iter().take(degree).enumerate().map(|(k, c)| c * (degree - k) as f64).collect()
}

/// The roots, with their multiplicity; conjugate pairs are exactly conjugate and next to each other.
///
/// **Method**: roots at zero are split off, the others are eigenvalues of the balanced companion matrix, each then
/// improved by Newton steps that lessen the value of the polynomial and stay closer to the start than to any other root.
///
/// **Accuracy**: the roots are those of a polynomial whose coefficients differ by a few roundings; a root of
/// multiplicity `m` is therefore known to about `eps^(1/m)`.
///
/// # Errors
/// [`Error::ZeroPolynomial`] where every coefficient is zero, [`Error::NotFinite`],
/// [`Error::Overflow`] where dividing by the leading coefficient overflows, [`Error::EigenvaluesNotConverged`].
///
/// # Example
/// ```
/// use telepulse_lti::polynomial;
/// // The mechanical part of the paper's plant, Eq. (15).
/// let roots = polynomial::roots(&[1.0, 15.96, 1444.0])?;
/// assert!((roots[0].norm() - 38.0).abs() < 1e-13);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn roots(coefficients: &[f64]) -> Result<Vec<Complex64>, Error> {
    check_finite("polynomial coefficients", coefficients)?;
    let trimmed = trim(coefficients);
    let Some(&leading) = trimmed.first() else {
        return Err(Error::ZeroPolynomial { polynomial: "polynomial" });
    };
    let n_at_zero = trimmed.iter().rev().take_while(|&&c| c == 0.0).count();
    let rest = &trimmed[..trimmed.len() - n_at_zero];
    let n = rest.len() - 1;
    if rest.iter().any(|c| !(c / leading).is_finite()) {
        return Err(Error::Overflow { operation: "division by the leading coefficient" });
    }
    let companion = DMatrix::from_fn(n, n, |i, j| match (i, j) {
        (0, j) => -rest[j + 1] / leading,
        (i, j) if i == j + 1 => 1.0,
        _ => 0.0,
    });
    let mut roots = eigenvalues(&companion)?;
    polish(rest, &mut roots);
    roots.extend(std::iter::repeat_n(Complex64::ZERO, n_at_zero));
    Ok(roots)
}

/// The monic polynomial that has these roots.
///
/// # Errors
/// [`Error::UnpairedRoot`] unless roots off the real axis come in conjugate pairs (to a relative 1e-8),
/// [`Error::Overflow`] where a coefficient overflows.
pub fn from_roots(roots: &[Complex64]) -> Result<Vec<f64>, Error> {
    let mut upper: Vec<Complex64> = roots.iter().copied().filter(|r| r.im > 0.0).collect();
    let mut coefficients = vec![1.0];
    for &root in roots.iter().filter(|r| r.im <= 0.0) {
        if root.im == 0.0 {
            coefficients = multiply(&coefficients, &[1.0, -root.re]);
            continue;
        }
        let distance = |k: &usize| (upper[*k] - root.conj()).norm();
        let nearest = (0..upper.len()).min_by(|k, l| distance(k).total_cmp(&distance(l)));
        match nearest {
            Some(k) if distance(&k) <= PAIR_TOLERANCE * root.norm() => {
                let partner = upper.swap_remove(k);
                // (s - p)(s - q) with q = conj(p) up to the tolerance: the real part of the product.
                let pair = [1.0, -(root.re + partner.re), (root * partner).re];
                coefficients = multiply(&coefficients, &pair);
            }
            _ => return Err(Error::UnpairedRoot { root }),
        }
    }
    if let Some(&root) = upper.first() {
        return Err(Error::UnpairedRoot { root });
    }
    if coefficients.iter().any(|c| !c.is_finite()) {
        return Err(Error::Overflow { operation: "the product of root factors" });
    }
    Ok(coefficients)
}

/// Refuses coefficients that are not finite.
pub(crate) fn check_finite(quantity: &'static str, coefficients: &[f64]) -> Result<(), Error> {
    match coefficients.iter().enumerate().find(|(_, c)| !c.is_finite()) {
        Some((index, &value)) => Err(Error::NotFinite { quantity, index, value }),
        None => Ok(()),
    }
}

/// Improves each root in place; the lower member of a pair mirrors the upper one.
fn polish(coefficients: &[f64], roots: &mut [Complex64]) {
    let slope = derivative(coefficients);
    for k in 0..roots.len() {
        let start = roots[k];
        if start.im < 0.0 {
            // Pairs are adjacent, the member with the positive imaginary part first.
            roots[k] = roots[k - 1].conj();
            continue;
        }
        let others = roots.iter().enumerate().filter(|(j, _)| *j != k);
        let gap = others.map(|(_, other)| (other - start).norm()).fold(f64::INFINITY, f64::min);
        let mut value = evaluate(coefficients, start).norm();
        for _ in 0..NEWTON_STEPS {
            let next = roots[k] - evaluate(coefficients, roots[k]) / evaluate(&slope, roots[k]);
            let next_value = evaluate(coefficients, next).norm();
            let improves = next_value < value && (next - start).norm() < 0.25 * gap;
            if !improves {
                break;
            }
            (roots[k], value) = (next, next_value);
        }
    }
}

/// Newton doubles the digits per step and starts with about ten of sixteen.
const NEWTON_STEPS: usize = 4;
/// Conjugates that were computed apart may differ this much, relative to their size.
const PAIR_TOLERANCE: f64 = 1e-8;

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn law_poles_to_polynomial_and_back() {
        let seed = 7;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        for case in 0..200 {
            let mut expected = Vec::new();
            for _ in 0..rng.random_range(1..4) {
                let scale = 10f64.powf(rng.random_range(-3.0..4.0));
                let (re, im) = (rng.random_range(-1.0..1.0) * scale, rng.random_range(0.2..1.0) * scale);
                expected.extend([Complex64::new(re, im), Complex64::new(re, -im)]);
            }
            expected.push(Complex64::new(rng.random_range(-5.0..-1.0), 0.0));
            let coefficients = from_roots(&expected).expect("pairs");
            let found = roots(&coefficients).expect("converged");
            assert_eq!(found.len(), expected.len());
            for root in &expected {
                let gap = expected.iter().filter(|r| *r != root).map(|r| (r - root).norm() / root.norm());
                // The condition of a root grows as its neighbours come close: up to six of them, each to the power one.
                let condition = gap.fold(1.0, |product, g| product / g.min(1.0));
                let error = found.iter().map(|f| (f - root).norm()).fold(f64::INFINITY, f64::min);
                assert!(
                    error <= 1e-13 * condition * root.norm(),
                    "seed {seed} case {case}: {root} off by {error:e}"
                );
            }
        }
    }

    #[test]
    fn law_widely_spread_roots_keep_relative_accuracy() {
        // Roots 1e-6, 1e-3, 1, 1e3 and 1e6: without balancing the small ones drown in the large.
        let expected: Vec<f64> = (-2..=2).map(|k| -(10f64.powi(3 * k))).collect();
        let factors: Vec<Complex64> = expected.iter().map(|&r| Complex64::new(r, 0.0)).collect();
        let found = roots(&from_roots(&factors).expect("real")).expect("converged");
        for root in expected {
            assert!(found.iter().any(|f| (f - root).norm() < 1e-13 * root.abs()), "{root}: {found:?}");
        }
    }

    #[test]
    fn law_a_double_root_is_found_twice() {
        let found = roots(&[1.0, 2.0, 1.0]).expect("converged");
        // Accuracy eps^(1/2) for multiplicity two.
        assert!(found.iter().all(|f| (f + 1.0).norm() < 1e-7), "{found:?}");
    }

    #[test]
    fn edge_roots_of_nothing_and_of_a_constant() {
        assert!(matches!(roots(&[0.0, 0.0]), Err(Error::ZeroPolynomial { .. })));
        assert!(matches!(roots(&[1.0, f64::NAN]), Err(Error::NotFinite { .. })));
        assert!(roots(&[0.0, 3.0]).expect("a constant").is_empty());
        assert_eq!(roots(&[2.0, 0.0, 0.0]).expect("s^2"), vec![Complex64::ZERO; 2]);
        assert!(matches!(roots(&[1e-300, 1e300]), Err(Error::Overflow { .. })));
    }

    #[test]
    fn edge_an_unpaired_root_is_named() {
        let lone = Complex64::new(1.0, 2.0);
        assert_eq!(from_roots(&[lone]), Err(Error::UnpairedRoot { root: lone }));
        assert_eq!(from_roots(&[lone.conj()]), Err(Error::UnpairedRoot { root: lone.conj() }));
    }

    #[test]
    fn law_sum_and_product_evaluate_pointwise() {
        let (p, q) = ([1.0, -2.0, 3.0], [4.0, 5.0]);
        let z = Complex64::new(0.3, -1.1);
        let sum = evaluate(&add(&p, &q), z) - evaluate(&p, z) - evaluate(&q, z);
        let product = evaluate(&multiply(&p, &q), z) - evaluate(&p, z) * evaluate(&q, z);
        assert!(sum.norm() < 1e-14 && product.norm() < 1e-13);
        assert_eq!(derivative(&p), [2.0, -2.0]);
        assert_eq!(add(&q, &p), add(&p, &q));
    }
}
