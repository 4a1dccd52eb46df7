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

/// How much of a change of the reference the proportional and the derivative part see.
///
/// They leave the feedback from the measurement alone, and with it stability, margins and the answer to disturbances. Below one they take
/// the overshoot, and the derivative's kick, out of the answer to the reference. Without integral action a `b` other than one leaves
/// an error at rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SetpointWeights {
    /// Weight in the proportional part; 1 for all of it.
    pub b: f64,
    /// Weight in the derivative part; 0 for the derivative of the measurement alone.
    pub c: f64,
}

impl Default for SetpointWeights {
    /// One degree of freedom: both parts act on the error.
    fn default() -> Self {
        Self { b: 1.0, c: 1.0 }
    }
}

/// What a PID controller sees in one sample, both with the sign of [`ErrorSign`](crate::ErrorSign).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PidInput {
    /// Reference less measurement.
    pub error: f64,
    /// The reference itself; it counts only through [`SetpointWeights`].
    pub reference: f64,
}

/// A PID controller at a fixed sample time `T`, with set-point weights where it is told so.
///
/// ```text
///   u = P (b (r - y0) - (y - y0)) + I/s (r - y) + D N s/(s + N) (c (r - y0) - (y - y0))
/// ```
///
/// `y0` is the measurement of the first sample after a start, so that a start at rest gives no bump whatever the weights.
///
/// **Method**: trapezoidal integral, backward-Euler derivative filter
/// `d[k] = (d[k-1] + D N (e[k] - e[k-1]))/(1 + N T)`.
/// The paper's `N = 9630.0667` rad/s gives `N T = 4.8` at 2 kHz. Forward Euler has its pole at `1 - N T = -3.8`: unstable. Tustin has it
/// at -0.41: stable, but it rings at half the sample rate. Backward Euler has it at 0.17 and keeps the filter's impulse area `D` exactly.
///
/// **Source**: text below Eq. (26), gains "auto tuned" and "manually tuned"; weights and tracking: Åström and Hägglund 2006, chapter 3.
///
/// **Example**
/// ```
/// use telepulse_rt::{Pid, PidAntiWindup, PidGains, PidInput, SetpointWeights};
/// let gains = PidGains { p: 2.0, i_per_s: 0.0, d_s: 0.0, n_rad_s: 0.0 };
/// let weights = SetpointWeights { b: 0.5, c: 0.0 };
/// let mut pid = Pid::new(gains, 1e-3, PidAntiWindup::Clamping)?.with_setpoint_weights(weights)?;
/// pid.advance(PidInput { error: 0.0, reference: 3.0 }, 0.0);
/// assert_eq!(pid.output(PidInput { error: 1.0, reference: 4.0 }), 1.0);
/// assert_eq!(pid.output(PidInput { error: 1.0, reference: 3.0 }), 2.0);
/// # Ok::<(), telepulse_rt::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pid {
    gains: PidGains,
    anti_windup: PidAntiWindup,
    weights: SetpointWeights,
    sample_time_s: f64,
    /// `y0`; none before the first sample.
    origin: Option<f64>,
    integral: f64,
    derivative: f64,
    /// Weighted error of the derivative part one sample ago.
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
        Ok(Self {
            gains,
            anti_windup,
            weights: SetpointWeights::default(),
            sample_time_s,
            origin: None,
            integral: 0.0,
            derivative: 0.0,
            previous_error: 0.0,
        })
    }

    /// The same controller with other set-point weights.
    ///
    /// # Errors
    /// [`Error::NotFinite`] for weights that are not finite.
    pub fn with_setpoint_weights(mut self, weights: SetpointWeights) -> Result<Self, Error> {
        finite("PID set-point weight b", weights.b)?;
        finite("PID set-point weight c", weights.c)?;
        self.weights = weights;
        Ok(self)
    }

    /// The output for this input, from the states as they are.
    #[must_use]
    pub fn output(&self, input: PidInput) -> f64 {
        let e = input.error;
        let half_step = 0.5 * self.sample_time_s * self.gains.i_per_s * e;
        let proportional = self.gains.p * self.weighted(self.weights.b, input);
        let derivative = self.filtered_derivative(self.weighted(self.weights.c, input));
        proportional + self.integral + half_step + derivative
    }

    /// Moves the states over one sample with this input.
    ///
    /// `excess` is the unit command that reached the drive minus the one that was asked for: zero when not saturated, negative when the
    /// request was too high.
    pub fn advance(&mut self, input: PidInput, excess: f64) {
        let e = input.error;
        let wanted = self.sample_time_s * self.gains.i_per_s * e;
        self.integral += match self.anti_windup {
            PidAntiWindup::Clamping if excess * wanted < 0.0 => 0.0,
            PidAntiWindup::BackCalculation { tracking_time_s } => {
                // No more than the whole excess in one sample: a shorter tracking time would overshoot it.
                wanted + excess * (self.sample_time_s / tracking_time_s).min(1.0)
            }
            PidAntiWindup::None | PidAntiWindup::Clamping => wanted,
        };
        let weighted = self.weighted(self.weights.c, input);
        self.derivative = self.filtered_derivative(weighted);
        self.previous_error = weighted;
        self.origin.get_or_insert(input.reference - input.error);
    }

    /// Puts all states back to zero.
    pub fn reset(&mut self) {
        self.integral = 0.0;
        self.derivative = 0.0;
        self.previous_error = 0.0;
        self.origin = None;
    }

    /// The gains.
    #[must_use]
    pub fn gains(&self) -> PidGains {
        self.gains
    }

    /// `weight (r - y0) - (y - y0)`, which is the error itself for a weight of one.
    fn weighted(&self, weight: f64, input: PidInput) -> f64 {
        let moved = input.reference - self.origin.unwrap_or(input.reference - input.error);
        input.error - (1.0 - weight) * moved
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

    fn at(error: f64) -> PidInput {
        PidInput { error, reference: 0.0 }
    }

    #[test]
    fn paper_auto_tuned_step_response_has_the_right_parts() {
        let t_s = 5e-4;
        let mut pid = Pid::new(AUTO, t_s, PidAntiWindup::None).expect("valid gains");
        let mut derivative_area = 0.0;
        for k in 0..400 {
            let u = pid.output(at(1.0));
            pid.advance(at(1.0), 0.0);
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
        assert!((pid.output(at(1.0)) - (AUTO.p + 0.5e-3 * AUTO.i_per_s)).abs() < 1e-15);
    }

    fn integral_after_saturation(anti_windup: PidAntiWindup) -> f64 {
        let gains = PidGains { p: 0.0, i_per_s: 10.0, d_s: 0.0, n_rad_s: 0.0 };
        let mut pid = Pid::new(gains, 1e-3, anti_windup).expect("valid gains");
        for _ in 0..5000 {
            let u = pid.output(at(1.0));
            pid.advance(at(1.0), u.clamp(0.0, 1.0) - u);
        }
        pid.output(at(0.0))
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
        pid.advance(at(-1.0), -0.5);
        assert!(pid.output(at(0.0)) < 0.0);
    }

    #[test]
    fn edge_bad_gains_are_refused() {
        assert!(Pid::new(PidGains { p: f64::NAN, ..AUTO }, 1e-3, PidAntiWindup::None).is_err());
        assert!(Pid::new(PidGains { n_rad_s: -1.0, ..AUTO }, 1e-3, PidAntiWindup::None).is_err());
        assert!(Pid::new(AUTO, 0.0, PidAntiWindup::None).is_err());
        assert!(Pid::new(AUTO, 1e-3, PidAntiWindup::BackCalculation { tracking_time_s: 0.0 }).is_err());
    }

    /// `1/((0.5 s + 1)(0.1 s + 1))` with a load at its input, each lag stepped finely.
    #[derive(Default)]
    struct TwoLags([f64; 2]);

    impl TwoLags {
        fn advance(&mut self, u: f64) {
            for _ in 0..10 {
                self.0[0] += 1e-4 / 0.1 * (u - self.0[0]);
                self.0[1] += 1e-4 / 0.5 * (self.0[0] - self.0[1]);
            }
        }
    }

    const LIVELY: PidGains = PidGains { p: 6.0, i_per_s: 20.0, d_s: 0.2, n_rad_s: 100.0 };

    /// Measurements of a loop that is at rest at a reference of 2, follows a step to 3 at 1 s and bears a load from 5 s on.
    fn step_and_load(weights: SetpointWeights) -> [std::vec::Vec<f64>; 2] {
        let pid = Pid::new(LIVELY, 1e-3, PidAntiWindup::None).expect("valid gains");
        let mut pid = pid.with_setpoint_weights(weights).expect("finite");
        // A command of 2 is the trim.
        let mut plant = TwoLags([2.0; 2]);
        let (mut y, mut u) = (std::vec![], std::vec![]);
        for k in 0..10_000 {
            let reference = if k < 1000 { 2.0 } else { 3.0 };
            let input = PidInput { error: reference - plant.0[1], reference };
            u.push(pid.output(input));
            pid.advance(input, 0.0);
            y.push(plant.0[1]);
            plant.advance(2.0 + u[k] + if k < 5000 { 0.0 } else { 1.0 });
        }
        [y, u]
    }

    #[test]
    fn law_weights_shape_the_step_and_leave_the_load_alone() {
        let [one, u_one] = step_and_load(SetpointWeights::default());
        let [two, u_two] = step_and_load(SetpointWeights { b: 0.4, c: 0.0 });
        // At rest, a start with weights gives no bump.
        assert!(two[..1000].iter().all(|y| (y - 2.0).abs() < 1e-12));
        let most = |y: &[f64]| y.iter().fold(f64::NEG_INFINITY, |a, b| a.max(*b));
        assert!(most(&one[..5000]) > 3.1 && most(&two[..5000]) < 3.02, "{} {}", most(&one), most(&two));
        // The kick P + D N/(1 + N T) becomes b P.
        assert!(u_one[1000] > 20.0 && (u_two[1000] - 0.4 * 6.0 - 0.5e-3 * 20.0).abs() < 1e-9);
        // By the time of the load both are at rest at 3, and answer it alike.
        assert!((two[4999] - 3.0).abs() < 1e-3);
        for k in 5000..10_000 {
            assert!((one[k] - two[k]).abs() < 2e-3, "{k}: {} {}", one[k], two[k]);
        }
        assert!((one[9999] - 3.0).abs() < 1e-3 && (two[9999] - 3.0).abs() < 1e-3);
    }

    #[test]
    fn law_weighted_output_is_two_controllers_added() {
        // By superposition: one of gains (b P, I, c D) on the reference, one of (P, I, D) on minus the measurement.
        let seed = 5;
        let mut random = crate::test_random::Random::new(seed);
        let (b, c) = (0.3, 0.6);
        let new = |gains| Pid::new(gains, 1e-3, PidAntiWindup::None).expect("valid gains");
        let mut both = new(AUTO).with_setpoint_weights(SetpointWeights { b, c }).expect("finite");
        let (mut of_r, mut of_y) = (new(PidGains { p: b * AUTO.p, d_s: c * AUTO.d_s, ..AUTO }), new(AUTO));
        for k in 0..1000 {
            // Both start at zero, which is the origin then.
            let (r, y) =
                if k == 0 { (0.0, 0.0) } else { (random.between(-1.0, 1.0), random.between(-1.0, 1.0)) };
            let input = PidInput { error: r - y, reference: r };
            let apart = of_r.output(at(r)) + of_y.output(at(-y));
            assert!((both.output(input) - apart).abs() < 1e-9, "seed {seed} sample {k}");
            both.advance(input, 0.0);
            of_r.advance(at(r), 0.0);
            of_y.advance(at(-y), 0.0);
        }
    }

    /// Samples from the return of the reference until the drive has left its limit for good, and overshoot below the reference after that; after a
    /// reference out of reach for so many samples.
    fn recovery(anti_windup: PidAntiWindup, weights: SetpointWeights, n_out_of_reach: usize) -> (usize, f64) {
        let pid = Pid::new(LIVELY, 1e-3, anti_windup).expect("valid gains");
        let mut pid = pid.with_setpoint_weights(weights).expect("finite");
        let mut plant = TwoLags::default();
        let (mut left, mut lowest) = (0, f64::INFINITY);
        for k in 0..n_out_of_reach + 20_000 {
            let reference = if k < n_out_of_reach { 5.0 } else { 0.5 };
            let input = PidInput { error: reference - plant.0[1], reference };
            let asked = pid.output(input);
            let applied = asked.clamp(0.0, 1.0);
            pid.advance(input, applied - asked);
            plant.advance(applied);
            if k >= n_out_of_reach {
                if applied >= 1.0 {
                    left = k + 1 - n_out_of_reach;
                }
                lowest = lowest.min(plant.0[1]);
            }
        }
        assert!((plant.0[1] - 0.5).abs() < 1e-3, "{anti_windup:?}: {}", plant.0[1]);
        (left, 0.5 - lowest)
    }

    #[test]
    fn law_recovery_does_not_depend_on_how_long_the_drive_was_at_its_limit() {
        for weights in [SetpointWeights::default(), SetpointWeights { b: 0.4, c: 0.0 }] {
            for anti_windup in
                [PidAntiWindup::Clamping, PidAntiWindup::BackCalculation { tracking_time_s: 0.1 }]
            {
                let (short, long) =
                    (recovery(anti_windup, weights, 10_000), recovery(anti_windup, weights, 200_000));
                assert!(
                    short.0.abs_diff(long.0) <= 1 && (short.1 - long.1).abs() < 1e-6,
                    "{short:?} {long:?}"
                );
                assert!(long.0 < 200 && long.1 < 0.25, "{anti_windup:?} {weights:?}: {long:?}");
            }
        }
        // Without it the wait grows with the time at the limit: seconds for tenths of a second.
        let (short, long) = (
            recovery(PidAntiWindup::None, SetpointWeights::default(), 1000).0,
            recovery(PidAntiWindup::None, SetpointWeights::default(), 1400).0,
        );
        assert!(short > 1000 && long > short + 1000, "{short} {long}");
    }

    #[test]
    fn edge_weights_that_are_not_numbers_are_refused() {
        let pid = Pid::new(AUTO, 1e-3, PidAntiWindup::None).expect("valid gains");
        for weights in [SetpointWeights { b: f64::NAN, c: 0.0 }, SetpointWeights { b: 1.0, c: f64::INFINITY }]
        {
            assert!(pid.with_setpoint_weights(weights).is_err());
        }
    }
}
