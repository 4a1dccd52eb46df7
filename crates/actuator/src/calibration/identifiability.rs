//! What the records determine: covariance, correlation, and the combinations of parameters by how well they are known.

use nalgebra::{DMatrix, DVector};

/// A combination of the logarithms of the free parameters, of unit length, and how well the records determine it.
#[derive(Debug, Clone, PartialEq)]
pub struct Combination {
    /// Singular value of the Jacobian, weighted by noise and scaled by logarithms.
    pub singular_value: f64,
    /// Its standard error, one over the singular value: a relative change for one parameter alone. Not below 1e8 over the
    /// largest singular value is known of a combination that the records do not depend on at all.
    pub standard_error: f64,
    /// Exponent of each free parameter in it.
    pub exponents: Vec<f64>,
    /// Whether the records determine it: the standard error is below [`DETERMINED_BELOW`].
    pub is_determined: bool,
}

/// A combination counts as determined where one standard error changes it by less than a factor of 1.65.
pub const DETERMINED_BELOW: f64 = 0.5;
/// Singular values below this part of the largest are errors of the differences.
const ROUNDING: f64 = 1e-8;
/// Exponents below this are left out of a name.
const NAMED_ABOVE: f64 = 0.1;

impl Combination {
    /// The combination as a product of powers of the free parameters, such as `mu_pa^0.71 relative_permittivity^-0.71`.
    #[must_use]
    pub fn name(&self, keys: &[String]) -> String {
        let named = self.exponents.iter().zip(keys).filter(|(exponent, _)| exponent.abs() >= NAMED_ABOVE);
        named.map(|(exponent, key)| format!("{key}^{exponent:.2}")).collect::<Vec<_>>().join(" ")
    }
}

/// What the Jacobian at the minimum says.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Identifiability {
    /// By falling singular value; without parameters that are held at a bound.
    pub(super) combinations: Vec<Combination>,
    /// Of the logarithms.
    pub(super) covariance: DMatrix<f64>,
}

/// Singular values and covariance of a Jacobian in logarithms whose rows are divided by their noise.
pub(super) fn identifiability(jacobian: &DMatrix<f64>, held: &[bool]) -> Identifiability {
    let n = held.len();
    let loose: Vec<usize> = (0..n).filter(|&p| !held[p]).collect();
    let mut covariance = DMatrix::zeros(n, n);
    if loose.is_empty() {
        return Identifiability { combinations: Vec::new(), covariance };
    }
    // Squared by QR first: as many rows as parameters, and no product of the Jacobian with itself.
    let square = jacobian.select_columns(&loose).qr().r();
    let svd = square.svd(false, true);
    let largest = svd.singular_values.max();
    let mut combinations = Vec::with_capacity(loose.len());
    if let Some(directions) = &svd.v_t {
        for (row, &value) in directions.row_iter().zip(svd.singular_values.iter()) {
            let known = value.max(ROUNDING * largest).max(f64::MIN_POSITIVE);
            let mut exponents = vec![0.0; n];
            let mut direction = DVector::zeros(n);
            // The largest exponent is positive.
            let sign = if row[row.transpose().icamax()] < 0.0 { -1.0 } else { 1.0 };
            for (&p, exponent) in loose.iter().zip(row.iter()) {
                exponents[p] = sign * exponent;
                direction[p] = *exponent;
            }
            let standard_error = 1.0 / known;
            covariance += &direction * direction.transpose() * (standard_error * standard_error);
            let is_determined = standard_error < DETERMINED_BELOW;
            combinations.push(Combination {
                singular_value: value,
                standard_error,
                exponents,
                is_determined,
            });
        }
    }
    combinations.sort_by(|a, b| b.singular_value.total_cmp(&a.singular_value));
    Identifiability { combinations, covariance }
}

/// Correlation coefficients of a covariance; zero where a parameter is held.
pub(super) fn correlation(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(covariance.nrows(), covariance.ncols(), |i, j| {
        let size = (covariance[(i, i)] * covariance[(j, j)]).sqrt();
        match (i == j, size > 0.0) {
            (true, _) => 1.0,
            (false, true) => covariance[(i, j)] / size,
            (false, false) => 0.0,
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_covariance_is_the_inverse_of_the_normal_matrix_and_what_is_unknown_is_named() {
        let jacobian = DMatrix::from_row_slice(4, 2, &[3.0, 1.0, 2.0, -1.0, 0.5, 4.0, 1.0, 1.0]);
        let found = identifiability(&jacobian, &[false, false]);
        let normal = jacobian.tr_mul(&jacobian).try_inverse().expect("regular");
        assert!((found.covariance - normal).amax() < 1e-14);
        // Columns in proportion 1 : -2: 2 p + q stays unknown, along (2, 1)/sqrt(5).
        let blind = DMatrix::from_row_slice(3, 2, &[1.0, -2.0, 3.0, -6.0, -2.0, 4.0]);
        let found = identifiability(&blind, &[false, false]);
        let last = &found.combinations[1];
        assert!(!last.is_determined && last.standard_error > 1e6);
        assert_eq!(last.name(&["p".to_owned(), "q".to_owned()]), "p^0.89 q^0.45");
        assert!(found.covariance[(0, 0)] > 1e12 && found.covariance[(1, 1)] > 1e12);
    }

    #[test]
    fn edge_a_parameter_at_its_bound_takes_no_part() {
        let jacobian = DMatrix::from_row_slice(2, 2, &[2.0, 1.0, 0.0, 1.0]);
        let found = identifiability(&jacobian, &[false, true]);
        assert_eq!(found.combinations.len(), 1);
        assert!((found.covariance[(0, 0)] - 0.25).abs() < 1e-15 && found.covariance[(1, 1)] == 0.0);
        assert_eq!(correlation(&found.covariance)[(0, 1)], 0.0);
    }
}
