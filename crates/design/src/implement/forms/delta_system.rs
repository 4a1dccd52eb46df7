//! A discrete system held as its increment, so that poles near 1 keep their digits.

use nalgebra::DMatrix;
use num_complex::Complex64;
use telepulse_lti::{Continuous, Discrete, SampleTime, StateSpace};

use super::super::realize::Discretization;
use crate::{Error, Result};

/// A discrete system `x[k+1] = x[k] + (A x[k] + B u[k])`, `y[k] = C x[k] + D u[k]`.
///
/// **Shapes and units**: `A: n_x × n_x` is the usual state matrix minus the identity; its eigenvalues are `z - 1` for the poles `z`.
///
/// **Source**: Middleton and Goodwin 1986, IEEE Trans. Autom. Control 31(11), 1015-1021.
///
/// **Example**: `1/(s + 2)` at 1 MHz: `z - 1 = -2e-6/(1 + 1e-6)`, to the last digit.
/// ```
/// use telepulse_design::implement::Discretization;
/// use telepulse_design::implement::forms::DeltaSystem;
/// use telepulse_lti::{SampleTime, TransferFunction};
/// let lag = TransferFunction::new(&[1.0], &[1.0, 2.0])?.to_state_space();
/// let sys = DeltaSystem::tustin(&lag, SampleTime::new(1e-6)?, Discretization::Tustin)?;
/// assert!((sys.increment().a()[(0, 0)] / (-2e-6 / (1.0 + 1e-6)) - 1.0).abs() < 1e-15);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct DeltaSystem {
    increment: StateSpace<Continuous>,
    sample_time: SampleTime,
}

impl DeltaSystem {
    /// A system from its increment: the four matrices, read with `z - 1` in the place of `s`.
    #[must_use]
    pub fn new(increment: StateSpace<Continuous>, sample_time: SampleTime) -> Self {
        Self { increment, sample_time }
    }

    /// The increment of a discrete system. The subtraction is exact near 1; what the state matrix has lost before stays lost.
    ///
    /// # Errors
    /// None for a system with finite entries.
    pub fn from_discrete(sys: &StateSpace<Discrete>) -> Result<Self> {
        let a = sys.a() - DMatrix::<f64>::identity(sys.n_states(), sys.n_states());
        let increment = StateSpace::<Continuous>::new(a, sys.b().clone(), sys.c().clone(), sys.d().clone())?;
        Ok(Self { increment, sample_time: sys.sample_time() })
    }

    /// The bilinear image of a continuous system, formed without a subtraction from 1.
    ///
    /// # Errors
    /// [`Error::PoleAtTwoOverT`], [`Error::OutOfRange`] for a pre-warping frequency beyond Nyquist.
    pub fn tustin(
        sys: &StateSpace<Continuous>,
        sample_time: SampleTime,
        discretization: Discretization,
    ) -> Result<Self> {
        let t = discretization.tustin_time_s(sample_time)?;
        // Balanced first, so that the state matrix rounds slow modes relative to themselves.
        let sys = sys.balanced();
        let n = sys.n_states();
        if n == 0 {
            return Ok(Self { increment: sys, sample_time });
        }
        let denominator = DMatrix::<f64>::identity(n, n) - sys.a() * (0.5 * t);
        let lost = Error::PoleAtTwoOverT { pole_rad_s: 2.0 / t, sample_time_s: sample_time.seconds() };
        let singular = denominator.clone().singular_values();
        if singular.min().is_nan() || singular.min() <= 1e-12 * singular.max() {
            return Err(lost);
        }
        let lu = denominator.clone().lu();
        let (Some(a), Some(b)) = (lu.solve(&(sys.a() * t)), lu.solve(&(sys.b() * t))) else {
            return Err(lost);
        };
        let c = denominator.transpose().lu().solve(&sys.c().transpose()).ok_or(lost)?.transpose();
        let d = sys.d() + sys.c() * &b * 0.5;
        Ok(Self { increment: StateSpace::<Continuous>::new(a, b, c, d)?, sample_time })
    }

    /// The four matrices of the increment.
    #[must_use]
    pub fn increment(&self) -> &StateSpace<Continuous> {
        &self.increment
    }

    /// The sample time.
    #[must_use]
    pub fn sample_time(&self) -> SampleTime {
        self.sample_time
    }

    /// The system in the usual form; its state matrix is rounded next to 1.
    ///
    /// # Errors
    /// None for a system with finite entries.
    pub fn to_discrete(&self) -> Result<StateSpace<Discrete>> {
        let inc = &self.increment;
        let a = inc.a() + DMatrix::<f64>::identity(inc.n_states(), inc.n_states());
        Ok(StateSpace::<Discrete>::new(
            a,
            inc.b().clone(),
            inc.c().clone(),
            inc.d().clone(),
            self.sample_time,
        )?)
    }

    /// The response at `z = exp(j omega T)`.
    ///
    /// # Errors
    /// A system error at a pole on the unit circle.
    pub fn at(&self, omega_rad_s: f64) -> Result<DMatrix<Complex64>> {
        let inc = &self.increment;
        let n = inc.n_states();
        let complex = |m: &DMatrix<f64>| m.map(|v| Complex64::new(v, 0.0));
        let states = self.states_at(omega_rad_s, &complex(inc.b()))?;
        debug_assert_eq!(states.nrows(), n);
        Ok(complex(inc.c()) * states + complex(inc.d()))
    }

    /// `((z - 1) I - A)^-1 right`.
    pub(super) fn states_at(
        &self,
        omega_rad_s: f64,
        right: &DMatrix<Complex64>,
    ) -> Result<DMatrix<Complex64>> {
        let mut resolvent = self.increment.a().map(|v| Complex64::new(-v, 0.0));
        let delta = delta_at(omega_rad_s, self.sample_time);
        for k in 0..resolvent.nrows() {
            resolvent[(k, k)] += delta;
        }
        let pole = telepulse_lti::Error::PoleAtFrequency { omega_rad_s };
        if resolvent.is_empty() {
            return Ok(right.clone());
        }
        let states = resolvent.lu().solve(right).ok_or(pole.clone())?;
        if states.iter().all(|v| v.re.is_finite() && v.im.is_finite()) {
            Ok(states)
        } else {
            Err(pole.into())
        }
    }

    /// The continuous image under `w = (z - 1)/(z + 1) = d/(2 + d)`: same peak gain, same Gramians, same kind of stability.
    ///
    /// # Errors
    /// A system error for a pole at `z = -1`.
    pub fn continuous_image(&self) -> Result<StateSpace<Continuous>> {
        let inc = &self.increment;
        let n = inc.n_states();
        let denominator = inc.a() + DMatrix::<f64>::identity(n, n) * 2.0;
        let lost = telepulse_lti::Error::BilinearPole { pole: -1.0 };
        if denominator.is_empty() {
            return Ok(inc.clone());
        }
        let lu = denominator.clone().lu();
        let (Some(a), Some(b)) = (lu.solve(inc.a()), lu.solve(inc.b())) else { return Err(lost.into()) };
        let c = denominator.transpose().lu().solve(&inc.c().transpose()).ok_or(lost)?.transpose();
        let (root, d) = (std::f64::consts::SQRT_2, inc.d() - inc.c() * &b);
        Ok(StateSpace::<Continuous>::new(a, b * root, c * root, d)?)
    }

    /// Whether every pole lies inside of the unit circle, told from `z - 1`.
    ///
    /// # Errors
    /// Eigenvalues that do not converge.
    pub fn is_stable(&self) -> Result<bool> {
        // |1 + d|² < 1 as 2 re d + |d|² < 0, without the subtraction.
        Ok(self.increment.poles()?.iter().all(|d| 2.0 * d.re + d.norm_sqr() < 0.0))
    }
}

/// `z - 1` on the unit circle without the cancellation of a subtraction.
pub(super) fn delta_at(omega_rad_s: f64, sample_time: SampleTime) -> Complex64 {
    let angle = omega_rad_s * sample_time.seconds();
    Complex64::new(-2.0 * (0.5 * angle).sin().powi(2), angle.sin())
}
