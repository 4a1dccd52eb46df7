//! The paper's parallel PID controller, sampled so that its fast derivative filter stays stable.

use crate::error::{Error, finite, not_negative, positive};

/// Gains of `P + I/s + D N/(1 + N/s)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PidGains {
    /// Proportional gain `P`, unit command per unit of error.
    pub p: f64,
    /// Integral gain `I`, per second.
    pub i_per_s: f64,
    /// Derivative gain `D`, seconds.
    pub d_s: f64,
    /// Derivative filter pole `N`, rad/s.
    pub n_rad_s: f64,
}

/// What the integrator does while the command is saturated.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum PidAntiWindup {
    /// It integrates on.
    #[default]
    None,
    /// It holds while the error would push the command further out.
    Clamping,
    /// It is driven back by the command that did not reach the drive, with time constant `tracking_time_s`.
    BackCalculation {
        /// Time constant in seconds.
        tracking_time_s: f64,
    },
}

/// A PID controller `e -> u` at a fixed sample time `T`.
///
/// **Method**: trapezoidal integral, backward-Euler derivative filter
/// `d[k] = (d[k-1] + D N (e[k] - e[k-1]))/(1 + N T)`.
/// The paper's `N = 9630.0667` rad/s gives `N T = 4.8` at 2 kHz. Forward Euler has its pole at `1 - N T = -3.8`: unstable. Tustin has it
/// at -0.41: stable, but it rings at half the sample rate. Backward Euler has it at 0.17 and keeps the filter's impulse area `D` exactly.
///
/// **Source**: text below Eq. (26), gains "auto tuned" and "manually tuned".
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pid {
    gains: PidGains,
    anti_windup: PidAntiWindup,
    sample_time_s: f64,
    integral: f64,
    derivative: f64,
    previous_error: f64,
}

impl Pid {
    /// A controller with all states at zero.
    ///
    /// # Errors
    /// [`Error::NotFinite`], [`Error::Negative`] or [`Error::NotPositive`] unless `P`, `I`, `D` are finite, `N` is at least zero, and
    /// sample and tracking time are greater than zero.
    pub fn new(gains: PidGains, sample_time_s: f64, anti_windup: PidAntiWindup) -> Result<Self, Error> {
        finite("PID gain P", gains.p)?;
        finite("PID gain I in 1/s", gains.i_per_s)?;
        finite("PID gain D in seconds", gains.d_s)?;
        not_negative("PID derivative filter N in rad/s", gains.n_rad_s)?;
        positive("PID sample time in seconds", sample_time_s)?;
        if let PidAntiWindup::BackCalculation { tracking_time_s } = anti_windup {
            positive("PID tracking time in seconds", tracking_time_s)?;
        }
        Ok(Self { gains, anti_windup, sample_time_s, integral: 0.0, derivative: 0.0, previous_error: 0.0 })
    }

    /// The output for error `e`, from the states as they are.
    #[must_use]
    pub fn output(&self, e: f64) -> f64 {
        let half_step = 0.5 * self.sample_time_s * self.gains.i_per_s * e;
        self.gains.p * e + self.integral + half_step + self.filtered_derivative(e)
    }

    /// Moves the states over one sample with error `e`.
    ///
    /// `excess` is the unit command that reached the drive minus the one that was asked for: zero when not saturated, negative when the
    /// request was too high.
    pub fn advance(&mut self, e: f64, excess: f64) {
        let wanted = self.sample_time_s * self.gains.i_per_s * e;
        self.integral += match self.anti_windup {
            PidAntiWindup::Clamping if excess * wanted < 0.0 => 0.0,
            PidAntiWindup::BackCalculation { tracking_time_s } => {
                // No more than the whole excess in one sample: a shorter tracking time would overshoot it.
                wanted + excess * (self.sample_time_s / tracking_time_s).min(1.0)
            }
            PidAntiWindup::None | PidAntiWindup::Clamping => wanted,
        };
        self.derivative = self.filtered_derivative(e);
        self.previous_error = e;
    }

    /// Puts all states back to zero.
    pub fn reset(&mut self) {
        self.integral = 0.0;
        self.derivative = 0.0;
        self.previous_error = 0.0;
    }

    /// The gains.
    #[must_use]
    pub fn gains(&self) -> PidGains {
        self.gains
    }

    fn filtered_derivative(&self, e: f64) -> f64 {
        let step = self.gains.d_s * self.gains.n_rad_s * (e - self.previous_error);
        (self.derivative + step) / (1.0 + self.gains.n_rad_s * self.sample_time_s)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;

    /// The auto-tuned gains as printed.
    const AUTO: PidGains = PidGains { p: 3.1738, i_per_s: 48.6620, d_s: 0.0443, n_rad_s: 9630.0667 };

    #[test]
    fn paper_auto_tuned_step_response_has_the_right_parts() {
        let t_s = 5e-4;
        let mut pid = Pid::new(AUTO, t_s, PidAntiWindup::None).expect("valid gains");
        let mut derivative_area = 0.0;
        for k in 0..400 {
            let u = pid.output(1.0);
            pid.advance(1.0, 0.0);
            // Continuous: P + I t + D N exp(-N t). The trapezoid sees the step half a sample early.
            let rest = u - AUTO.p - AUTO.i_per_s * (f64::from(k) + 0.5) * t_s;
            derivative_area += rest * t_s;
            if k > 20 {
                // 0.172^20 of D N/(1 + N T) = 73 is 3e-14.
                assert!(rest.abs() < 1e-12, "sample {k}: derivative part {rest} has not died out");
            }
        }
        // The area under D N exp(-N t) is D.
        assert!((derivative_area - AUTO.d_s).abs() < 1e-12, "area {derivative_area}");
    }

    #[test]
    fn law_without_filter_pole_there_is_no_derivative() {
        let gains = PidGains { n_rad_s: 0.0, ..AUTO };
        let pid = Pid::new(gains, 1e-3, PidAntiWindup::None).expect("valid gains");
        assert!((pid.output(1.0) - (AUTO.p + 0.5e-3 * AUTO.i_per_s)).abs() < 1e-15);
    }

    fn integral_after_saturation(anti_windup: PidAntiWindup) -> f64 {
        let gains = PidGains { p: 0.0, i_per_s: 10.0, d_s: 0.0, n_rad_s: 0.0 };
        let mut pid = Pid::new(gains, 1e-3, anti_windup).expect("valid gains");
        for _ in 0..5000 {
            let u = pid.output(1.0);
            pid.advance(1.0, u.clamp(0.0, 1.0) - u);
        }
        pid.output(0.0)
    }

    #[test]
    fn edge_anti_windup_bounds_the_integral() {
        assert!((integral_after_saturation(PidAntiWindup::None) - 50.0).abs() < 1e-9);
        // One step of 0.01 past the limit at most.
        assert!(integral_after_saturation(PidAntiWindup::Clamping) <= 1.01);
        // Balance at I e = excess/T_t: excess = 10 * 0.01.
        let back = integral_after_saturation(PidAntiWindup::BackCalculation { tracking_time_s: 0.01 });
        assert!((back - 1.1).abs() < 0.02, "{back}");
    }

    #[test]
    fn edge_clamping_lets_the_integral_return() {
        let gains = PidGains { p: 0.0, i_per_s: 10.0, d_s: 0.0, n_rad_s: 0.0 };
        let mut pid = Pid::new(gains, 1e-3, PidAntiWindup::Clamping).expect("valid gains");
        pid.advance(-1.0, -0.5);
        assert!(pid.output(0.0) < 0.0);
    }

    #[test]
    fn edge_bad_gains_are_refused() {
        assert!(Pid::new(PidGains { p: f64::NAN, ..AUTO }, 1e-3, PidAntiWindup::None).is_err());
        assert!(Pid::new(PidGains { n_rad_s: -1.0, ..AUTO }, 1e-3, PidAntiWindup::None).is_err());
        assert!(Pid::new(AUTO, 0.0, PidAntiWindup::None).is_err());
        assert!(Pid::new(AUTO, 1e-3, PidAntiWindup::BackCalculation { tracking_time_s: 0.0 }).is_err());
    }
}
