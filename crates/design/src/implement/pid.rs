//! A PID controller by its settings.

use serde::{Deserialize, Serialize};
use telepulse_lti::TransferFunction;

use crate::Result;

/// Gains of `P + I/s + D N/(1 + N/s)`: parallel form, derivative through a filter, as the paper's tool writes it.
///
/// The settings are given, not found: the paper prints the gains of its auto-tuned and its hand-tuned controller, and a
/// tuner that ignores the uncertainty is what that comparison warns of.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PidSettings {
    /// Proportional gain P, unit of command per mm.
    pub p: f64,
    /// Integral gain I, unit of command per mm and s.
    pub i_per_s: f64,
    /// Derivative gain D, unit of command times s per mm.
    pub d_s: f64,
    /// Pole N of the derivative filter in rad/s.
    pub n_rad_s: f64,
}

impl PidSettings {
    /// The controller as a transfer function from error to command.
    ///
    /// `P + I/s + D N s/(s + N)` over one denominator: `((P + D N) s^2 + (P N + I) s + I N)/(s^2 + N s)`. Without a
    /// derivative part the filter's pole is left out, and without an integral part the integrator.
    ///
    /// # Errors
    /// Where a gain is not finite.
    ///
    /// # Example
    /// ```
    /// use telepulse_design::implement::PidSettings;
    /// let pi = PidSettings { p: 1.7, i_per_s: 24.331, d_s: 0.0, n_rad_s: 9630.0667 };
    /// assert_eq!(pi.transfer_function()?.denominator(), [1.0, 0.0]);
    /// # Ok::<(), telepulse_design::Error>(())
    /// ```
    pub fn transfer_function(&self) -> Result<TransferFunction> {
        let Self { p, i_per_s: i, d_s: d, n_rad_s: n } = *self;
        let system = match (i == 0.0, d == 0.0) {
            (true, true) => TransferFunction::new(&[p], &[1.0]),
            (false, true) => TransferFunction::new(&[p, i], &[1.0, 0.0]),
            (true, false) => TransferFunction::new(&[p + d * n, p * n], &[1.0, n]),
            (false, false) => TransferFunction::new(&[p + d * n, p * n + i, i * n], &[1.0, n, 0.0]),
        };
        Ok(system?)
    }
}

#[cfg(test)]
mod tests {
    use num_complex::Complex64;

    use super::*;

    #[test]
    fn law_transfer_function_is_the_sum_of_its_parts() {
        for (p, i, d) in [(3.1738, 48.662, 0.0443), (1.7, 24.331, 0.0), (2.0, 0.0, 0.1), (0.5, 0.0, 0.0)] {
            let n = 9630.0667;
            let system =
                PidSettings { p, i_per_s: i, d_s: d, n_rad_s: n }.transfer_function().expect("finite");
            for omega in [0.1, 7.0, 300.0, 2e4] {
                let s = Complex64::new(0.0, omega);
                let sum = p + i / s + d * n / (1.0 + n / s);
                assert!((system.at(omega) - sum).norm() < 1e-12 * sum.norm());
            }
        }
    }
}
