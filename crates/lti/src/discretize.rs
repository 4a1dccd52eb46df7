//! From continuous to discrete time and back.

use crate::balance::balance_matrix;
use crate::interconnect::{beside, stack};
use crate::{Continuous, Discrete, Error, SampleTime, StateSpace};
use nalgebra::DMatrix;

impl StateSpace<Continuous> {
    /// The discrete system that agrees with this one at the sampling instants when its input is held between them.
    ///
    /// **Method**: exponential of `[[A, B], [0, 0]] T`, whose upper row is `[A_d, B_d]`; no inverse of `A` is needed, so
    /// integrators are no exception.
    ///
    /// **Source**: Van Loan 1978, "Computing integrals involving the matrix exponential", theorem 1.
    ///
    /// # Errors
    /// [`Error::NotFinite`] where the exponential overflows: an unstable mode over too long a sample time.
    ///
    /// # Example
    /// ```
    /// use telepulse_lti::{SampleTime, TransferFunction};
    /// let lag = TransferFunction::new(&[1.0], &[0.1, 1.0])?.to_state_space();
    /// let held = lag.to_discrete_zoh(SampleTime::new(0.1)?)?;
    /// assert!((held.a()[(0, 0)] - (-1.0f64).exp()).abs() < 1e-15);
    /// # Ok::<(), telepulse_lti::Error>(())
    /// ```
    pub fn to_discrete_zoh(&self, sample_time: SampleTime) -> Result<StateSpace<Discrete>, Error> {
        let sys = self.balanced();
        let (n, n_u) = (sys.n_states(), sys.n_inputs());
        let held = stack(&beside(sys.a(), sys.b()), &DMatrix::zeros(n_u, n + n_u)) * sample_time.seconds();
        if let Some((index, &value)) = held.iter().enumerate().find(|(_, v)| !v.is_finite()) {
            return Err(Error::NotFinite { quantity: "the matrix exponential's argument", index, value });
        }
        let moved = held.exp();
        let (a, b) = (moved.view((0, 0), (n, n)).into_owned(), moved.view((0, n), (n, n_u)).into_owned());
        StateSpace::<Discrete>::new(a, b, sys.c().clone(), sys.d().clone(), sample_time)
    }

    /// The discrete system by the bilinear map `s = (2 / T) (z - 1) / (z + 1)` (trapezoidal rule, Tustin).
    ///
    /// The response at the discrete frequency `omega` is that of this system at `(2 / T) tan(omega T / 2)`. Stability
    /// and the H-infinity norm are preserved, and the states are scaled so that the Gramians are as well.
    ///
    /// # Errors
    /// [`Error::BilinearPole`] for a pole at `2 / T`, which the map sends to infinity.
    pub fn to_discrete_tustin(&self, sample_time: SampleTime) -> Result<StateSpace<Discrete>, Error> {
        let alpha = 2.0 / sample_time.seconds();
        bilinear(self, sample_time, alpha)
    }

    /// As [`Self::to_discrete_tustin`], with the factor chosen so that the responses agree at `omega_rad_s`.
    ///
    /// **Method**: `alpha = omega / tan(omega T / 2)` in place of `2 / T`.
    ///
    /// # Errors
    /// [`Error::PrewarpFrequency`] unless the frequency lies strictly between zero and Nyquist,
    /// [`Error::BilinearPole`] for a pole at `alpha`.
    pub fn to_discrete_tustin_prewarped(
        &self,
        sample_time: SampleTime,
        omega_rad_s: f64,
    ) -> Result<StateSpace<Discrete>, Error> {
        let nyquist_rad_s = sample_time.nyquist_rad_s();
        if !(omega_rad_s > 0.0 && omega_rad_s < nyquist_rad_s) {
            return Err(Error::PrewarpFrequency { omega_rad_s, nyquist_rad_s });
        }
        let alpha = omega_rad_s / (0.5 * omega_rad_s * sample_time.seconds()).tan();
        bilinear(self, sample_time, alpha)
    }
}

impl StateSpace<Discrete> {
    /// The continuous system whose [`StateSpace::to_discrete_tustin`] is this one.
    ///
    /// # Errors
    /// [`Error::BilinearPole`] for a pole at `z = -1`, which the map sends to infinity.
    pub fn to_continuous_tustin(&self) -> Result<StateSpace<Continuous>, Error> {
        // With R = (I + A_d)^-1: A = alpha R (A_d - I), B = sqrt(2 alpha) R B_d, C = sqrt(2 alpha) C_d R,
        // D = D_d - C_d R B_d.
        let alpha = 2.0 / self.sample_time().seconds();
        let identity = DMatrix::<f64>::identity(self.n_states(), self.n_states());
        let resolvent = regular_inverse(&identity + self.a()).ok_or(Error::BilinearPole { pole: -1.0 })?;
        let root = (2.0 * alpha).sqrt();
        let a = &resolvent * (self.a() - identity) * alpha;
        let d = self.d() - self.c() * &resolvent * self.b();
        StateSpace::<Continuous>::new(a, &resolvent * self.b() * root, self.c() * &resolvent * root, d)
    }
}

/// From `s` to `z` by `s = alpha (z - 1) / (z + 1)`: with `R = (alpha I - A)^-1`, `A_d = R (alpha I + A)`,
/// `B_d = sqrt(2 alpha) R B`, `C_d = sqrt(2 alpha) C R`, `D_d = D + C R B`.
fn bilinear(
    sys: &StateSpace<Continuous>,
    sample_time: SampleTime,
    alpha: f64,
) -> Result<StateSpace<Discrete>, Error> {
    let identity = DMatrix::<f64>::identity(sys.n_states(), sys.n_states());
    let resolvent =
        regular_inverse(&identity * alpha - sys.a()).ok_or(Error::BilinearPole { pole: alpha })?;
    let root = (2.0 * alpha).sqrt();
    let a = &resolvent * (identity * alpha + sys.a());
    let d = sys.d() + sys.c() * &resolvent * sys.b();
    let (b, c) = (&resolvent * sys.b() * root, sys.c() * &resolvent * root);
    StateSpace::<Discrete>::new(a, b, c, d, sample_time)
}

/// The inverse, or `None` for a matrix that is singular to working precision however its rows and columns are scaled.
fn regular_inverse(matrix: DMatrix<f64>) -> Option<DMatrix<f64>> {
    let inverse = matrix.clone().try_inverse()?;
    // The condition number would count bad scaling as well; that of the balanced matrix hardly does.
    let mut balanced = matrix;
    let scale = balance_matrix(&mut balanced);
    let balanced_inverse =
        DMatrix::from_fn(scale.len(), scale.len(), |i, j| inverse[(i, j)] * scale[j] / scale[i]);
    let condition = balanced.norm() * balanced_inverse.norm();
    (condition < CONDITION_LIMIT).then_some(inverse)
}

/// Above this condition number no digit of an inverse is certain.
const CONDITION_LIMIT: f64 = 0.1 / f64::EPSILON;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::TransferFunction;
    use nalgebra::{DVector, dmatrix};
    use num_complex::Complex64;

    /// Two inputs, two outputs, stiff and lightly damped, with an integrator.
    fn sample_system() -> StateSpace<Continuous> {
        let a = dmatrix![
            0.0, 1.0, 0.0, 0.0;
            -1444.0, -15.96, 30.0, 0.0;
            0.0, 0.0, -222.2, 0.0;
            1.0, 0.0, 0.0, 0.0];
        let b = dmatrix![0.0, 0.0; 0.0, 2.0; 200.0, 0.0; 0.0, 1.0];
        let c = dmatrix![1.0, 0.0, 0.0, 0.0; 0.0, 0.0, 1.0, 3.0];
        StateSpace::<Continuous>::new(a, b, c, dmatrix![0.0, 0.1; 0.0, 0.0]).expect("valid")
    }

    /// Classical Runge-Kutta steps with the input held.
    fn runge_kutta(
        sys: &StateSpace<Continuous>,
        x: &DVector<f64>,
        u: &DVector<f64>,
        time_s: f64,
    ) -> DVector<f64> {
        let steps = 2000;
        let h = time_s / f64::from(steps);
        let rate = |x: &DVector<f64>| sys.a() * x + sys.b() * u;
        let mut x = x.clone();
        for _ in 0..steps {
            let k1 = rate(&x);
            let k2 = rate(&(&x + &k1 * (0.5 * h)));
            let k3 = rate(&(&x + &k2 * (0.5 * h)));
            let k4 = rate(&(&x + &k3 * h));
            x += (k1 + k2 * 2.0 + k3 * 2.0 + k4) * (h / 6.0);
        }
        x
    }

    #[test]
    fn law_hold_discretization_agrees_with_fine_integration() {
        let sys = sample_system();
        let ts = SampleTime::new(0.02).expect("positive");
        let held = sys.to_discrete_zoh(ts).expect("finite");
        let (mut fine, mut sampled) = (DVector::zeros(4), DVector::zeros(4));
        for k in 0..25 {
            let u = DVector::from_vec(vec![(0.7 * f64::from(k)).sin(), (0.3 * f64::from(k)).cos()]);
            let expected = sys.c() * &fine + sys.d() * &u;
            let found = held.c() * &sampled + held.d() * &u;
            // Runge-Kutta of order four with h = 1e-5 s and a fastest rate of 222/s: (h rate)^4 = 2e-11.
            assert!((&found - &expected).norm() < 1e-10 * (1.0 + expected.norm()), "step {k}");
            fine = runge_kutta(&sys, &fine, &u, ts.seconds());
            sampled = held.a() * &sampled + held.b() * &u;
        }
    }

    #[test]
    fn law_a_long_hold_is_many_short_ones() {
        // The exponential is scaled and squared inside by another factor; here the fastest mode times T is 444.
        let sys = sample_system();
        let discretize = |seconds: f64| sys.to_discrete_zoh(SampleTime::new(seconds).expect("positive"));
        let (long, short) = (discretize(2.0).expect("finite"), discretize(2.0 / 1024.0).expect("finite"));
        let (mut a, mut b) = (DMatrix::identity(4, 4), DMatrix::zeros(4, 2));
        for _ in 0..1024 {
            b = short.a() * b + short.b();
            a = short.a() * a;
        }
        // A thousand products, each with a rounding error of 1e-16 times the norm of its factors.
        assert!((long.a() - &a).norm() < 1e-11 * long.a().norm(), "{} against {a}", long.a());
        assert!((long.b() - &b).norm() < 1e-11 * long.b().norm(), "{} against {b}", long.b());
    }

    #[test]
    fn law_hold_response_of_a_lag_is_the_textbook_one() {
        let (tau, t) = (0.05, 0.01);
        let held = TransferFunction::new(&[3.0], &[tau, 1.0]).expect("valid").to_state_space();
        let held = held.to_discrete_zoh(SampleTime::new(t).expect("positive")).expect("finite");
        let p = (-t / tau).exp();
        for omega in [0.0, 10.0, 200.0] {
            let z = Complex64::from_polar(1.0, omega * t);
            let expected = 3.0 * (1.0 - p) / (z - p);
            assert!((held.at(omega).expect("no pole")[(0, 0)] - expected).norm() < 1e-14);
        }
    }

    #[test]
    fn law_tustin_warps_frequencies_by_the_tangent() {
        let sys = sample_system();
        let ts = SampleTime::new(0.004).expect("positive");
        let discrete = sys.to_discrete_tustin(ts).expect("regular");
        for omega in [0.5, 38.0, 300.0, 700.0] {
            let warped = 2.0 / 0.004 * (0.5 * omega * 0.004_f64).tan();
            let (found, expected) = (discrete.at(omega).expect("no pole"), sys.at(warped).expect("no pole"));
            assert!((&found - &expected).norm() < 1e-12 * expected.norm(), "{omega}");
        }
    }

    #[test]
    fn law_prewarped_tustin_is_exact_at_its_frequency() {
        let sys = sample_system();
        let ts = SampleTime::new(0.02).expect("positive");
        let discrete = sys.to_discrete_tustin_prewarped(ts, 38.0).expect("regular");
        let (found, expected) = (discrete.at(38.0).expect("no pole"), sys.at(38.0).expect("no pole"));
        assert!((&found - &expected).norm() < 1e-12 * expected.norm());
        let plain = sys.to_discrete_tustin(ts).expect("regular").at(38.0).expect("no pole");
        assert!((&plain - &expected).norm() > 1e-2 * expected.norm());
    }

    #[test]
    fn law_tustin_and_back_is_the_identity() {
        let sys = sample_system();
        let there = sys.to_discrete_tustin(SampleTime::new(0.004).expect("positive")).expect("regular");
        let back = there.to_continuous_tustin().expect("regular");
        for (found, expected) in
            [(back.a(), sys.a()), (back.b(), sys.b()), (back.c(), sys.c()), (back.d(), sys.d())]
        {
            assert!((found - expected).norm() < 1e-12 * expected.norm(), "{found} against {expected}");
        }
    }

    #[test]
    fn edge_poles_that_the_bilinear_map_cannot_take() {
        let ts = SampleTime::new(0.5).expect("positive");
        let fast = StateSpace::<Continuous>::new(dmatrix![4.0], dmatrix![1.0], dmatrix![1.0], dmatrix![0.0]);
        assert_eq!(fast.expect("valid").to_discrete_tustin(ts), Err(Error::BilinearPole { pole: 4.0 }));
        let nyquist =
            StateSpace::<Discrete>::new(dmatrix![-1.0], dmatrix![1.0], dmatrix![1.0], dmatrix![0.0], ts);
        assert_eq!(nyquist.expect("valid").to_continuous_tustin(), Err(Error::BilinearPole { pole: -1.0 }));
    }

    #[test]
    fn edge_prewarping_beyond_nyquist_and_overflow_are_refused() {
        let sys = sample_system();
        let ts = SampleTime::new(0.02).expect("positive");
        for omega in [0.0, -1.0, 158.0, f64::NAN] {
            let refused = sys.to_discrete_tustin_prewarped(ts, omega);
            assert!(matches!(refused, Err(Error::PrewarpFrequency { .. })), "{omega}");
        }
        let unstable =
            StateSpace::<Continuous>::new(dmatrix![1.0], dmatrix![1.0], dmatrix![1.0], dmatrix![0.0]);
        let long = SampleTime::new(1e4).expect("positive");
        assert!(matches!(unstable.expect("valid").to_discrete_zoh(long), Err(Error::NotFinite { .. })));
    }
}
