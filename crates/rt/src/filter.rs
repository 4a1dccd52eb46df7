//! The first-order low-pass filter of the measurement, Eq. (26).

use crate::error::{Error, positive};

/// Cut-off of Eq. (26), `40 pi / (s + 40 pi)`: 20 Hz.
pub const EQ26_CUTOFF_RAD_S: f64 = 40.0 * core::f64::consts::PI;

/// `omega_c / (s + omega_c)`, sampled.
///
/// **Method**: Tustin (bilinear) without pre-warping:
/// `y[k] = p y[k-1] + g (u[k] + u[k-1])`, `p = (2 - omega_c T)/(2 + omega_c T)`, `g = omega_c T/(2 + omega_c T)`.
/// The controller in the same loop is discretised by Tustin, and Tustin of a series connection is the series connection of the Tustin
/// parts: the sampled loop is then exactly the bilinear image of the designed one. A zero-order-hold equivalent would add half a sample
/// of delay that the design does not know. The frequency axis is warped by `(omega T)^2/12` (3e-4 at 20 Hz and 2 kHz).
///
/// **Example**
/// ```
/// use telepulse_rt::{EQ26_CUTOFF_RAD_S, LowPass};
/// let mut filter = LowPass::new(EQ26_CUTOFF_RAD_S, 5e-4)?;
/// filter.reset(0.3);
/// assert!((filter.output(0.3) - 0.3).abs() < 1e-15); // already settled: no start transient
/// # Ok::<(), telepulse_rt::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LowPass {
    pole: f64,
    gain: f64,
    state: f64,
}

impl LowPass {
    /// A filter at rest at zero, with the cut-off in rad/s and the sample time in seconds.
    ///
    /// # Errors
    /// [`Error::NotPositive`] unless both are finite and greater than zero.
    pub fn new(cutoff_rad_s: f64, sample_time_s: f64) -> Result<Self, Error> {
        let omega_t = positive("filter cut-off in rad/s", cutoff_rad_s)?
            * positive("filter sample time in seconds", sample_time_s)?;
        Ok(Self { pole: (2.0 - omega_t) / (2.0 + omega_t), gain: omega_t / (2.0 + omega_t), state: 0.0 })
    }

    /// The output for input `u`, from the state as it is.
    #[must_use]
    pub fn output(&self, u: f64) -> f64 {
        self.state + self.gain * u
    }

    /// Moves the state over one sample with input `u`.
    pub fn advance(&mut self, u: f64) {
        // state = p y[k-1] + g u[k-1], so that the output needs only the present input.
        self.state = self.pole * self.output(u) + self.gain * u;
    }

    /// Puts the filter where a constant input `value` would have brought it.
    pub fn reset(&mut self, value: f64) {
        self.state = (1.0 - self.gain) * value;
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;

    const SAMPLE_TIME_S: f64 = 5e-4;

    #[test]
    fn paper_eq26_step_response_follows_the_exponential() {
        let mut filter = LowPass::new(EQ26_CUTOFF_RAD_S, SAMPLE_TIME_S).expect("valid filter");
        let mut previous = 0.0;
        for k in 0..200 {
            let y = filter.output(1.0);
            filter.advance(1.0);
            // The bilinear filter sees a ramp from 0 to 1 over the sample before: the step is centred half a sample earlier.
            let t_s = (f64::from(k) + 0.5) * SAMPLE_TIME_S;
            let expected = 1.0 - (-EQ26_CUTOFF_RAD_S * t_s).exp();
            // Second order in omega T = 0.0628: (omega T)^2/12 = 3.3e-4 of the time axis and of the amplitude.
            assert!((y - expected).abs() < 8e-4, "sample {k}: {y} against {expected}");
            assert!(y > previous);
            previous = y;
        }
    }

    #[test]
    fn paper_eq26_gain_and_phase_at_20_hz() {
        let mut filter = LowPass::new(EQ26_CUTOFF_RAD_S, SAMPLE_TIME_S).expect("valid filter");
        // 20 Hz at 2 kHz: 100 samples a period. Project the settled output on sine and cosine over ten periods.
        let (mut in_phase, mut quadrature) = (0.0, 0.0);
        for k in 0..3000_u32 {
            let (s, c) = (core::f64::consts::TAU * f64::from(k % 100) / 100.0).sin_cos();
            let y = filter.output(s);
            filter.advance(s);
            if k >= 2000 {
                in_phase += 2.0 / 1000.0 * y * s;
                quadrature += 2.0 / 1000.0 * y * c;
            }
        }
        // Continuous: gain 1/sqrt 2 and -45 degrees; warping moves both by about 3e-4.
        assert!((in_phase.hypot(quadrature) - 0.5_f64.sqrt()).abs() < 4e-4);
        assert!((quadrature.atan2(in_phase) + core::f64::consts::FRAC_PI_4).abs() < 4e-4);
    }

    #[test]
    fn law_reset_is_the_settled_state() {
        let mut settled = LowPass::new(30.0, 0.01).expect("valid filter");
        for _ in 0..1000 {
            settled.advance(-2.5);
        }
        let mut preset = LowPass::new(30.0, 0.01).expect("valid filter");
        preset.reset(-2.5);
        assert!((settled.output(-2.5) - preset.output(-2.5)).abs() < 1e-14);
        assert!((preset.output(-2.5) + 2.5).abs() < 1e-15);
    }

    #[test]
    fn edge_bad_cutoff_is_refused() {
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(LowPass::new(bad, 1e-3).is_err());
            assert!(LowPass::new(1.0, bad).is_err());
        }
    }
}
