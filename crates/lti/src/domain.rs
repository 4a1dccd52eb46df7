//! Continuous and discrete time as types, so that the two do not mix.

use crate::Error;
use num_complex::Complex64;
use serde::{Deserialize, Serialize};
use std::fmt::Debug;

/// A sample time in seconds: positive and finite.
///
/// # Example
/// ```
/// use telepulse_lti::SampleTime;
/// let ts = SampleTime::new(0.0005)?;
/// assert_eq!(ts.seconds(), 0.0005);
/// assert!(SampleTime::new(0.0).is_err());
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Serialize, Deserialize)]
#[serde(try_from = "f64", into = "f64")]
pub struct SampleTime(f64);

impl SampleTime {
    /// A sample time of so many seconds.
    ///
    /// # Errors
    /// [`Error::Duration`] unless `seconds` is positive and finite.
    pub fn new(seconds: f64) -> Result<Self, Error> {
        if seconds > 0.0 && seconds.is_finite() {
            Ok(Self(seconds))
        } else {
            Err(Error::Duration { quantity: "sample time", seconds })
        }
    }

    /// The sample time of a rate in samples per second.
    ///
    /// # Errors
    /// [`Error::Duration`] with the resulting sample time, unless it is positive and finite.
    pub fn from_rate_hz(rate_hz: f64) -> Result<Self, Error> {
        Self::new(1.0 / rate_hz)
    }

    /// The sample time in seconds.
    #[must_use]
    pub fn seconds(self) -> f64 {
        self.0
    }

    /// Half the sampling frequency, in rad/s.
    #[must_use]
    pub fn nyquist_rad_s(self) -> f64 {
        std::f64::consts::PI / self.0
    }
}

impl TryFrom<f64> for SampleTime {
    type Error = Error;

    fn try_from(seconds: f64) -> Result<Self, Error> {
        Self::new(seconds)
    }
}

impl From<SampleTime> for f64 {
    fn from(sample_time: SampleTime) -> Self {
        sample_time.0
    }
}

/// Continuous time: the response is evaluated at `s = j omega`, stable poles lie in the open left half plane.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Continuous;

/// Discrete time: the response is evaluated at `z = exp(j omega T)`, stable poles lie inside of the unit circle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Discrete {
    sample_time: SampleTime,
}

impl Discrete {
    /// Discrete time with the given sample time.
    #[must_use]
    pub fn new(sample_time: SampleTime) -> Self {
        Self { sample_time }
    }

    /// The sample time.
    #[must_use]
    pub fn sample_time(&self) -> SampleTime {
        self.sample_time
    }
}

mod sealed {
    pub trait Sealed {}
    impl Sealed for super::Continuous {}
    impl Sealed for super::Discrete {}
}

/// The time in which a system lives: [`Continuous`] or [`Discrete`], and nothing else.
pub trait TimeDomain: sealed::Sealed + Copy + Debug + PartialEq {
    /// The point of the complex plane at which a response at `omega_rad_s` is evaluated.
    fn point(&self, omega_rad_s: f64) -> Complex64;

    /// Whether a mode with this pole dies out.
    fn is_stable_pole(&self, pole: Complex64) -> bool;

    /// The sample time, or `None` in continuous time.
    fn sample_time_of(&self) -> Option<SampleTime>;

    /// The domain that has this sample time.
    ///
    /// # Errors
    /// [`Error::WrongTimeDomain`] where a continuous system is given a sample time or a discrete one has none.
    fn from_sample_time(sample_time: Option<SampleTime>) -> Result<Self, Error>;
}

impl TimeDomain for Continuous {
    fn point(&self, omega_rad_s: f64) -> Complex64 {
        Complex64::new(0.0, omega_rad_s)
    }

    fn is_stable_pole(&self, pole: Complex64) -> bool {
        pole.re < 0.0
    }

    fn sample_time_of(&self) -> Option<SampleTime> {
        None
    }

    fn from_sample_time(sample_time: Option<SampleTime>) -> Result<Self, Error> {
        match sample_time {
            None => Ok(Self),
            Some(ts) => {
                Err(Error::WrongTimeDomain { expected: "continuous", sample_time_s: Some(ts.seconds()) })
            }
        }
    }
}

impl TimeDomain for Discrete {
    fn point(&self, omega_rad_s: f64) -> Complex64 {
        Complex64::from_polar(1.0, omega_rad_s * self.sample_time.seconds())
    }

    fn is_stable_pole(&self, pole: Complex64) -> bool {
        pole.norm() < 1.0
    }

    fn sample_time_of(&self) -> Option<SampleTime> {
        Some(self.sample_time)
    }

    fn from_sample_time(sample_time: Option<SampleTime>) -> Result<Self, Error> {
        sample_time.map(Self::new).ok_or(Error::WrongTimeDomain { expected: "discrete", sample_time_s: None })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edge_sample_time_refuses_what_is_no_time() {
        for seconds in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(SampleTime::new(seconds), Err(Error::Duration { .. })), "{seconds}");
        }
        assert!(SampleTime::from_rate_hz(0.0).is_err());
        assert!(serde_json::from_str::<SampleTime>("-0.1").is_err());
    }

    #[test]
    fn law_the_discrete_point_at_nyquist_is_minus_one() {
        let ts = SampleTime::new(0.003).expect("positive");
        let z = Discrete::new(ts).point(ts.nyquist_rad_s());
        assert!((z - Complex64::new(-1.0, 0.0)).norm() < 1e-15);
    }
}
