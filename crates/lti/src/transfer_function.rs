//! Continuous transfer functions with one input and one output, as printed in papers.

use crate::{Error, FrequencyResponse, polynomial};
use nalgebra::DMatrix;
use num_complex::Complex64;
use serde::{Deserialize, Serialize};

/// A proper rational function of `s`: numerator over denominator, coefficients in descending powers.
///
/// The coefficients are kept as given (no normalization to a monic denominator, no cancellation), so that a printed
/// formula can be read off again.
///
/// **Example**: the paper's identified plant, Eq. (16), in mm per unit of drive.
/// ```
/// use telepulse_lti::TransferFunction;
/// let plant = TransferFunction::new(&[1350.14], &[0.0045, 1.07182, 22.458, 1444.0])?;
/// assert!((plant.dc_gain()? - 0.935).abs() < 5e-4);
/// assert!(plant.is_stable()?);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "PlainTransferFunction", into = "PlainTransferFunction")]
pub struct TransferFunction {
    numerator: Vec<f64>,
    denominator: Vec<f64>,
}

impl TransferFunction {
    /// A transfer function from its coefficients in descending powers of `s`; leading zeros are dropped.
    ///
    /// # Errors
    /// [`Error::NotFinite`] for a coefficient that is no number, [`Error::ZeroPolynomial`] for a denominator without a
    /// coefficient other than zero, [`Error::Improper`] for a numerator of higher degree,
    /// [`Error::Overflow`] where dividing by the leading coefficient overflows.
    pub fn new(numerator: &[f64], denominator: &[f64]) -> Result<Self, Error> {
        polynomial::check_finite("numerator", numerator)?;
        polynomial::check_finite("denominator", denominator)?;
        let (numerator, denominator) = (polynomial::trim(numerator), polynomial::trim(denominator));
        let Some(&leading) = denominator.first() else {
            return Err(Error::ZeroPolynomial { polynomial: "denominator" });
        };
        if numerator.len() > denominator.len() {
            return Err(Error::Improper {
                numerator_degree: numerator.len() - 1,
                denominator_degree: denominator.len() - 1,
            });
        }
        if numerator.iter().chain(denominator).any(|c| !(c / leading).is_finite()) {
            return Err(Error::Overflow { operation: "division by the leading coefficient" });
        }
        let numerator = if numerator.is_empty() { vec![0.0] } else { numerator.to_vec() };
        Ok(Self { numerator, denominator: denominator.to_vec() })
    }

    /// A constant gain.
    ///
    /// # Errors
    /// [`Error::NotFinite`].
    pub fn from_gain(gain: f64) -> Result<Self, Error> {
        Self::new(&[gain], &[1.0])
    }

    /// Numerator coefficients in descending powers, without leading zeros; `[0]` for the zero function.
    #[must_use]
    pub fn numerator(&self) -> &[f64] {
        &self.numerator
    }

    /// Denominator coefficients in descending powers, without leading zeros.
    #[must_use]
    pub fn denominator(&self) -> &[f64] {
        &self.denominator
    }

    /// Degree of the denominator: the number of states of a realization.
    #[must_use]
    pub fn order(&self) -> usize {
        self.denominator.len() - 1
    }

    /// Degree of the denominator less that of the numerator.
    #[must_use]
    pub fn relative_degree(&self) -> usize {
        self.denominator.len() - self.numerator.len()
    }

    /// The response at `s = j omega`; infinite at a pole on the axis.
    #[must_use]
    pub fn at(&self, omega_rad_s: f64) -> Complex64 {
        self.evaluate(Complex64::new(0.0, omega_rad_s))
    }

    /// The value at a point of the `s` plane; infinite at a pole.
    #[must_use]
    pub fn evaluate(&self, point: Complex64) -> Complex64 {
        let denominator = polynomial::evaluate(&self.denominator, point);
        if denominator == Complex64::ZERO {
            return Complex64::new(f64::INFINITY, 0.0);
        }
        polynomial::evaluate(&self.numerator, point) / denominator
    }

    /// The response on a grid of frequencies in rad/s, as 1 × 1 matrices.
    ///
    /// # Errors
    /// [`Error::FrequencyGrid`] unless the frequencies are finite, not negative and increasing;
    /// [`Error::PoleAtFrequency`] where one of them hits a pole.
    pub fn frequency_response(&self, omega_rad_s: &[f64]) -> Result<FrequencyResponse, Error> {
        FrequencyResponse::sample(omega_rad_s, |omega| {
            let value = self.at(omega);
            let finite = value.re.is_finite() && value.im.is_finite();
            finite
                .then(|| DMatrix::from_element(1, 1, value))
                .ok_or(Error::PoleAtFrequency { omega_rad_s: omega })
        })
    }

    /// The gain for constant signals.
    ///
    /// # Errors
    /// [`Error::PoleAtFrequency`] where the function has a pole at zero.
    pub fn dc_gain(&self) -> Result<f64, Error> {
        let gain = self.at(0.0).re;
        if gain.is_finite() { Ok(gain) } else { Err(Error::PoleAtFrequency { omega_rad_s: 0.0 }) }
    }

    /// The roots of the denominator, in rad/s.
    ///
    /// # Errors
    /// [`Error::EigenvaluesNotConverged`].
    pub fn poles(&self) -> Result<Vec<Complex64>, Error> {
        polynomial::roots(&self.denominator)
    }

    /// The roots of the numerator, in rad/s.
    ///
    /// # Errors
    /// [`Error::ZeroPolynomial`] for the zero function, [`Error::EigenvaluesNotConverged`].
    pub fn zeros(&self) -> Result<Vec<Complex64>, Error> {
        polynomial::roots(&self.numerator)
    }

    /// Whether every pole lies in the open left half plane; common factors are not cancelled first.
    ///
    /// # Errors
    /// [`Error::EigenvaluesNotConverged`].
    pub fn is_stable(&self) -> Result<bool, Error> {
        Ok(self.poles()?.iter().all(|pole| pole.re < 0.0))
    }

    /// The function multiplied by a gain.
    ///
    /// # Errors
    /// [`Error::NotFinite`] where the gain or a product is not finite.
    pub fn scale(&self, gain: f64) -> Result<Self, Error> {
        let scaled: Vec<f64> = self.numerator.iter().map(|c| c * gain).collect();
        Self::new(&scaled, &self.denominator)
    }

    /// The product of two functions: one after the other.
    ///
    /// # Errors
    /// [`Error::NotFinite`] or [`Error::Overflow`] where a coefficient overflows.
    pub fn multiply(&self, other: &Self) -> Result<Self, Error> {
        Self::new(
            &polynomial::multiply(&self.numerator, &other.numerator),
            &polynomial::multiply(&self.denominator, &other.denominator),
        )
    }

    /// The sum of two functions: side by side. Equal denominators are kept, not squared.
    ///
    /// # Errors
    /// [`Error::NotFinite`] or [`Error::Overflow`] where a coefficient overflows.
    pub fn add(&self, other: &Self) -> Result<Self, Error> {
        if self.denominator == other.denominator {
            return Self::new(&polynomial::add(&self.numerator, &other.numerator), &self.denominator);
        }
        let numerator = polynomial::add(
            &polynomial::multiply(&self.numerator, &other.denominator),
            &polynomial::multiply(&other.numerator, &self.denominator),
        );
        Self::new(&numerator, &polynomial::multiply(&self.denominator, &other.denominator))
    }

    /// The negative feedback loop `G / (1 + G H)` of this function `G` with `H` in the return path.
    ///
    /// ```text
    ///   r --->(+)---> G ---+---> y
    ///          ^-          |
    ///          +---- H <---+
    /// ```
    ///
    /// # Errors
    /// [`Error::AlgebraicLoop`] where `1 + G H` vanishes at infinite frequency; [`Error::NotFinite`] or
    /// [`Error::Overflow`] where a coefficient overflows.
    ///
    /// # Example
    /// ```
    /// use telepulse_lti::TransferFunction;
    /// let integrator = TransferFunction::new(&[5.0], &[1.0, 0.0])?;
    /// let closed = integrator.feedback(&TransferFunction::from_gain(1.0)?)?;
    /// assert_eq!(closed.denominator(), [1.0, 5.0]);
    /// # Ok::<(), telepulse_lti::Error>(())
    /// ```
    pub fn feedback(&self, return_path: &Self) -> Result<Self, Error> {
        let open = polynomial::multiply(&self.denominator, &return_path.denominator);
        let looped = polynomial::multiply(&self.numerator, &return_path.numerator);
        let denominator = polynomial::add(&open, &looped);
        let threshold = 8.0 * f64::EPSILON;
        let direct_return = (denominator[0] / open[0]).abs();
        if direct_return <= threshold {
            return Err(Error::AlgebraicLoop { smallest_singular_value: direct_return, threshold });
        }
        Self::new(&polynomial::multiply(&self.numerator, &return_path.denominator), &denominator)
    }
}

/// The stored form of a transfer function.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PlainTransferFunction {
    numerator: Vec<f64>,
    denominator: Vec<f64>,
}

impl From<TransferFunction> for PlainTransferFunction {
    fn from(tf: TransferFunction) -> Self {
        Self { numerator: tf.numerator, denominator: tf.denominator }
    }
}

impl TryFrom<PlainTransferFunction> for TransferFunction {
    type Error = Error;

    fn try_from(plain: PlainTransferFunction) -> Result<Self, Error> {
        Self::new(&plain.numerator, &plain.denominator)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tf(numerator: &[f64], denominator: &[f64]) -> TransferFunction {
        TransferFunction::new(numerator, denominator).expect("a valid transfer function")
    }

    #[test]
    fn law_sum_product_and_feedback_agree_pointwise() {
        let (g, h) = (tf(&[2.0, 1.0], &[1.0, 0.4, 9.0]), tf(&[0.5, 3.0], &[1.0, 7.0]));
        let product = g.multiply(&h).expect("finite");
        let sum = g.add(&h).expect("finite");
        let closed = g.feedback(&h).expect("well posed");
        for omega in [0.0, 0.3, 3.0, 40.0] {
            let (gv, hv) = (g.at(omega), h.at(omega));
            assert!((product.at(omega) - gv * hv).norm() < 1e-14);
            assert!((sum.at(omega) - gv - hv).norm() < 1e-14);
            assert!((closed.at(omega) - gv / (1.0 + gv * hv)).norm() < 1e-14);
        }
        assert_eq!(g.add(&g).expect("finite").order(), 2);
    }

    #[test]
    fn edge_what_is_no_transfer_function_is_refused_by_name() {
        assert!(matches!(
            TransferFunction::new(&[1.0, 0.0, 0.0], &[1.0, 1.0]),
            Err(Error::Improper { numerator_degree: 2, denominator_degree: 1 })
        ));
        assert!(matches!(TransferFunction::new(&[1.0], &[0.0, 0.0]), Err(Error::ZeroPolynomial { .. })));
        assert!(matches!(TransferFunction::new(&[1.0], &[]), Err(Error::ZeroPolynomial { .. })));
        assert!(matches!(TransferFunction::new(&[f64::NAN], &[1.0]), Err(Error::NotFinite { .. })));
        assert!(matches!(TransferFunction::new(&[1.0], &[1.0, f64::INFINITY]), Err(Error::NotFinite { .. })));
        assert!(matches!(TransferFunction::new(&[1e300], &[1e-300]), Err(Error::Overflow { .. })));
        // A leading zero is no degree.
        assert_eq!(tf(&[0.0, 0.0, 1.0], &[0.0, 1.0, 1.0]).relative_degree(), 1);
        assert_eq!(tf(&[0.0], &[1.0, 1.0]).numerator(), [0.0]);
    }

    #[test]
    fn edge_poles_on_the_axis_have_no_response_there() {
        let integrator = tf(&[1.0], &[1.0, 0.0]);
        assert!(matches!(integrator.dc_gain(), Err(Error::PoleAtFrequency { .. })));
        assert!(matches!(integrator.frequency_response(&[0.0, 1.0]), Err(Error::PoleAtFrequency { .. })));
        assert!(integrator.at(0.0).re.is_infinite());
        assert!(!integrator.is_stable().expect("one pole"));
    }

    #[test]
    fn edge_an_algebraic_loop_is_refused() {
        let direct = tf(&[-1.0, 3.0], &[1.0, 5.0]);
        let unity = TransferFunction::from_gain(1.0).expect("finite");
        assert!(matches!(direct.feedback(&unity), Err(Error::AlgebraicLoop { .. })));
    }

    #[test]
    fn edge_a_stored_transfer_function_is_checked() {
        let good = r#"{"numerator":[1.0],"denominator":[2.0,1.0]}"#;
        let read: TransferFunction = serde_json::from_str(good).expect("valid");
        assert_eq!(serde_json::to_string(&read).expect("plain"), good);
        for bad in [
            r#"{"numerator":[1.0],"denominator":[2.0,1.0],"gain":1.0}"#,
            r#"{"numerator":[1.0,2.0],"denominator":[2.0]}"#,
            r#"{"numerator":[1.0]}"#,
        ] {
            assert!(serde_json::from_str::<TransferFunction>(bad).is_err(), "{bad}");
        }
    }
}
