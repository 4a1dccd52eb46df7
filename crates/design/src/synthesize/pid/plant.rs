//! A plant with a pure dead time.

use num_complex::Complex64;
use telepulse_lti::TransferFunction;

use crate::{Error, Result};

/// Dead times that a search over frequency can resolve.
const DELAY_MIN_S: f64 = 1e-12;
const DELAY_MAX_S: f64 = 1e12;

/// `G(s) = rational(s) e^{-s delay_s}`, one input and one output.
#[derive(Debug, Clone, PartialEq)]
pub struct DelayedPlant {
    rational: TransferFunction,
    delay_s: f64,
}

impl DelayedPlant {
    /// A plant from its rational part and its dead time in seconds.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] unless the delay is finite and at least zero, [`Error::PidPlantZero`] for the zero function.
    ///
    /// # Example
    /// ```
    /// use telepulse_design::synthesize::pid::DelayedPlant;
    /// use telepulse_lti::TransferFunction;
    /// let plant = DelayedPlant::new(TransferFunction::new(&[1.0], &[1.0, 1.0])?, 0.5)?;
    /// assert!((plant.at(2.0).arg() + 2.0_f64.atan() + 1.0).abs() < 1e-14);
    /// # Ok::<(), telepulse_design::Error>(())
    /// ```
    pub fn new(rational: TransferFunction, delay_s: f64) -> Result<Self> {
        if !(delay_s == 0.0 || (DELAY_MIN_S..=DELAY_MAX_S).contains(&delay_s)) {
            return Err(Error::OutOfRange {
                key: "delay_s",
                found: delay_s,
                allowed: "0, or from 1e-12 to 1e12",
            });
        }
        if rational.numerator() == [0.0] {
            return Err(Error::PidPlantZero);
        }
        Ok(Self { rational, delay_s })
    }

    /// The part without the dead time.
    #[must_use]
    pub fn rational(&self) -> &TransferFunction {
        &self.rational
    }

    /// The dead time in seconds.
    #[must_use]
    pub fn delay_s(&self) -> f64 {
        self.delay_s
    }

    /// The response at `s = j omega`, with the dead time exact; infinite at a pole on the axis.
    #[must_use]
    pub fn at(&self, omega_rad_s: f64) -> Complex64 {
        self.rational.at(omega_rad_s) * Complex64::from_polar(1.0, -omega_rad_s * self.delay_s)
    }

    /// Sizes of the poles and zeros that are not at the origin, and the inverse of the delay: where the response bends.
    pub(super) fn corner_frequencies(&self) -> Result<Vec<f64>> {
        let mut corners: Vec<f64> = self.rational.poles()?.iter().map(|p| p.norm()).collect();
        corners.extend(self.rational.zeros()?.iter().map(|z| z.norm()));
        if self.delay_s > 0.0 {
            corners.push(1.0 / self.delay_s);
        }
        corners.retain(|w| *w > 0.0);
        if corners.is_empty() {
            // A gain or a chain of integrators: the frequency of gain one, or any for a mere gain.
            let (n, d) = (self.rational.numerator(), self.rational.denominator());
            let order = self.rational.relative_degree().max(1) as f64;
            corners.push((n[0] / d[0]).abs().powf(1.0 / order));
        }
        Ok(corners)
    }

    /// Sign that the integral gain must have for a stable loop.
    ///
    /// The characteristic function must have the same sign at `s = 0`, where it is `ki` times the numerator, as for large real
    /// `s`, where it is the denominator.
    pub(super) fn integral_sign(&self) -> Result<f64> {
        let (n, d) = (self.rational.numerator(), self.rational.denominator());
        let at_zero = n[n.len() - 1];
        if at_zero == 0.0 {
            return Err(Error::PidPlantZeroAtOrigin);
        }
        Ok((at_zero * d[0]).signum())
    }
}
