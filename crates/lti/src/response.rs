//! Sampled frequency responses, and how they are read: magnitude, phase, largest gain.

use crate::Error;
use nalgebra::DMatrix;
use num_complex::Complex64;

/// The response matrices of a system on an increasing grid of frequencies.
///
/// **Shapes and units**: `values[k]` is `n_y × n_u` and belongs to `omega_rad_s[k]`.
///
/// **Example**: a first-order lag of 0.1 s is at -45 degrees and -3.01 dB at 10 rad/s.
/// ```
/// use telepulse_lti::TransferFunction;
/// let lag = TransferFunction::new(&[1.0], &[0.1, 1.0])?;
/// let response = lag.frequency_response(&[1.0, 10.0])?;
/// assert!((response.phase_deg(0, 0)[1] + 45.0).abs() < 1e-12);
/// assert!((response.magnitude(0, 0)[1] - 0.5f64.sqrt()).abs() < 1e-15);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct FrequencyResponse {
    /// Frequencies in rad/s, increasing.
    pub omega_rad_s: Vec<f64>,
    /// One response matrix per frequency.
    pub values: Vec<DMatrix<Complex64>>,
}

impl FrequencyResponse {
    /// Evaluates `response` on a grid of frequencies in rad/s.
    ///
    /// # Errors
    /// [`Error::FrequencyGrid`] unless the frequencies are finite, not negative and increasing, and whatever
    /// `response` reports.
    pub fn sample<F>(omega_rad_s: &[f64], response: F) -> Result<Self, Error>
    where
        F: Fn(f64) -> Result<DMatrix<Complex64>, Error>,
    {
        let mut previous = f64::NEG_INFINITY;
        for (index, &omega) in omega_rad_s.iter().enumerate() {
            if !omega.is_finite() || omega < 0.0 || omega <= previous {
                return Err(Error::FrequencyGrid { index, omega_rad_s: omega });
            }
            previous = omega;
        }
        let values = omega_rad_s.iter().map(|&omega| response(omega)).collect::<Result<Vec<_>, _>>()?;
        Ok(Self { omega_rad_s: omega_rad_s.to_vec(), values })
    }

    /// One entry of the response over all frequencies.
    ///
    /// # Panics
    /// When the indices are outside of the response matrix.
    #[must_use]
    pub fn entry(&self, output_idx: usize, input_idx: usize) -> Vec<Complex64> {
        self.values.iter().map(|v| v[(output_idx, input_idx)]).collect()
    }

    /// Magnitude of one entry over all frequencies.
    ///
    /// # Panics
    /// When the indices are outside of the response matrix.
    #[must_use]
    pub fn magnitude(&self, output_idx: usize, input_idx: usize) -> Vec<f64> {
        self.entry(output_idx, input_idx).into_iter().map(Complex64::norm).collect()
    }

    /// Magnitude of one entry in decibels, `20 log10`.
    ///
    /// # Panics
    /// When the indices are outside of the response matrix.
    #[must_use]
    pub fn magnitude_db(&self, output_idx: usize, input_idx: usize) -> Vec<f64> {
        self.magnitude(output_idx, input_idx).into_iter().map(|m| 20.0 * m.log10()).collect()
    }

    /// Phase of one entry in degrees, unwrapped: neighbours differ by at most 180.
    ///
    /// **Accuracy**: the first point lies in (-180, 180]; a grid on which the true phase turns by more than 180 degrees
    /// between neighbours is unwrapped wrongly.
    ///
    /// # Panics
    /// When the indices are outside of the response matrix.
    #[must_use]
    pub fn phase_deg(&self, output_idx: usize, input_idx: usize) -> Vec<f64> {
        let mut phases: Vec<f64> = Vec::with_capacity(self.values.len());
        for value in self.entry(output_idx, input_idx) {
            let wrapped = value.arg().to_degrees();
            let turns = match phases.last() {
                Some(&previous) => ((previous - wrapped) / 360.0).round(),
                None => 0.0,
            };
            phases.push(wrapped + 360.0 * turns);
        }
        phases
    }

    /// Largest singular value of the response matrix over all frequencies: the gain for the worst input direction.
    #[must_use]
    pub fn largest_singular_value(&self) -> Vec<f64> {
        self.values.iter().map(|v| v.singular_values().max()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_unwrapped_phase_of_a_delay_is_linear() {
        let omegas: Vec<f64> = (0..200).map(|k| 0.1 * f64::from(k)).collect();
        let delay_s = 2.0;
        let response = FrequencyResponse::sample(&omegas, |omega| {
            Ok(DMatrix::from_element(1, 1, Complex64::from_polar(1.0, -omega * delay_s)))
        })
        .expect("increasing grid");
        for (omega, phase) in omegas.iter().zip(response.phase_deg(0, 0)) {
            assert!((phase + (omega * delay_s).to_degrees()).abs() < 1e-9);
        }
    }

    #[test]
    fn edge_a_grid_must_increase_and_be_finite() {
        for grid in [&[1.0, 1.0][..], &[-1.0], &[0.0, f64::NAN], &[f64::INFINITY]] {
            let sampled = FrequencyResponse::sample(grid, |_| Ok(DMatrix::zeros(1, 1)));
            assert!(matches!(sampled, Err(Error::FrequencyGrid { .. })), "{grid:?}");
        }
    }

    #[test]
    fn law_the_largest_singular_value_bounds_every_entry() {
        let value = DMatrix::from_fn(2, 2, |i, j| Complex64::new(1.0 + i as f64, j as f64));
        let response = FrequencyResponse::sample(&[1.0], |_| Ok(value.clone())).expect("one point");
        let largest = response.largest_singular_value()[0];
        assert!(value.iter().all(|v| v.norm() <= largest));
        assert!(largest <= value.norm());
    }
}
