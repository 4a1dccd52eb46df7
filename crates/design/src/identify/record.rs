//! The measured frequency response: points over frequency and amplitude.

use std::f64::consts::{PI, TAU};

use num_complex::Complex64;
use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// Harmonics of the response to one sine, relative to its fundamental.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Distortion {
    /// Second harmonic over fundamental.
    pub second: f64,
    /// Third harmonic over fundamental.
    pub third: f64,
}

/// The response at one frequency and amplitude.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SweepPoint {
    /// Frequency in Hz.
    pub frequency_hz: f64,
    /// Amplitude of the drive, fraction of full scale.
    pub amplitude: f64,
    /// Response over drive, in mm per unit; one unit is full scale.
    pub magnitude_mm_per_unit: f64,
    /// Phase of the response against the drive, in degrees; negative where the response lags.
    pub phase_deg: f64,
    /// Harmonics, where they were measured.
    pub distortion: Option<Distortion>,
}

impl SweepPoint {
    /// The point with this complex response. Its phase is put between -270 and 90 degrees, where a third-order lag
    /// never jumps.
    #[must_use]
    pub fn from_response(
        frequency_hz: f64,
        amplitude: f64,
        response_mm_per_unit: Complex64,
        distortion: Option<Distortion>,
    ) -> Self {
        let principal_deg = response_mm_per_unit.arg().to_degrees();
        let phase_deg = if principal_deg > 90.0 { principal_deg - 360.0 } else { principal_deg };
        Self {
            frequency_hz,
            amplitude,
            magnitude_mm_per_unit: response_mm_per_unit.norm(),
            phase_deg,
            distortion,
        }
    }

    /// Angular frequency in rad/s.
    #[must_use]
    pub fn omega_rad_s(&self) -> f64 {
        TAU * self.frequency_hz
    }

    /// The complex response in mm per unit.
    #[must_use]
    pub fn response(&self) -> Complex64 {
        Complex64::from_polar(self.magnitude_mm_per_unit, self.phase_deg.to_radians())
    }
}

/// A checked sweep: every value in its range, no point given twice, enough frequencies for a third-order model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "PlainRecord", into = "PlainRecord")]
pub struct SweepRecord {
    points: Vec<SweepPoint>,
    bias: Option<f64>,
}

/// [`SweepRecord`] before its check.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PlainRecord {
    points: Vec<SweepPoint>,
    bias: Option<f64>,
}

impl TryFrom<PlainRecord> for SweepRecord {
    type Error = Error;
    fn try_from(plain: PlainRecord) -> Result<Self> {
        Self::new(plain.points, plain.bias)
    }
}

impl From<SweepRecord> for PlainRecord {
    fn from(record: SweepRecord) -> Self {
        Self { points: record.points, bias: record.bias }
    }
}

/// Fewest different frequencies of a record: a third-order model has up to four parameters.
pub(super) const FREQUENCIES_MIN: usize = 5;

impl SweepRecord {
    /// Checks the points. `bias` is a fraction of full scale, where it is known.
    ///
    /// # Errors
    /// [`Error::SweepField`], [`Error::SweepDuplicate`] (both count points from 1) or [`Error::SweepTooFewFrequencies`].
    pub fn new(points: Vec<SweepPoint>, bias: Option<f64>) -> Result<Self> {
        let lines: Vec<usize> = (1..=points.len()).collect();
        Self::with_lines(points, bias, &lines)
    }

    /// [`new`](Self::new) with the line number of each point for the error messages.
    pub(super) fn with_lines(points: Vec<SweepPoint>, bias: Option<f64>, lines: &[usize]) -> Result<Self> {
        for (point, &line) in points.iter().zip(lines) {
            check_point(point, line)?;
        }
        if let Some(found) = bias.filter(|b| !(0.0..=1.0).contains(b)) {
            return Err(Error::OutOfRange { key: "bias", found, allowed: "0 to 1" });
        }
        let mut order: Vec<usize> = (0..points.len()).collect();
        let key = |i: usize| (points[i].frequency_hz, points[i].amplitude);
        order.sort_by(|&a, &b| {
            let ((fa, aa), (fb, ab)) = (key(a), key(b));
            fa.total_cmp(&fb).then(aa.total_cmp(&ab)).then(a.cmp(&b))
        });
        if let Some(pair) = order.windows(2).find(|pair| key(pair[0]) == key(pair[1])) {
            let (frequency_hz, amplitude) = key(pair[1]);
            let (line, first_line) = (lines[pair[1]], lines[pair[0]]);
            return Err(Error::SweepDuplicate { line, first_line, frequency_hz, amplitude });
        }
        let mut frequencies: Vec<f64> = order.iter().map(|&i| points[i].frequency_hz).collect();
        frequencies.dedup();
        if frequencies.len() < FREQUENCIES_MIN {
            return Err(Error::SweepTooFewFrequencies { needed: FREQUENCIES_MIN, found: frequencies.len() });
        }
        Ok(Self { points, bias })
    }

    /// The points in the order in which they were given.
    #[must_use]
    pub fn points(&self) -> &[SweepPoint] {
        &self.points
    }

    /// Mean of the drive, fraction of full scale, where it is known.
    #[must_use]
    pub fn bias(&self) -> Option<f64> {
        self.bias
    }

    /// The different amplitudes, rising.
    #[must_use]
    pub fn amplitudes(&self) -> Vec<f64> {
        let mut amplitudes: Vec<f64> = self.points.iter().map(|p| p.amplitude).collect();
        amplitudes.sort_by(f64::total_cmp);
        amplitudes.dedup();
        amplitudes
    }

    /// The record as it would be without the zero-order hold of the drive.
    ///
    /// **Method**: each response is divided by `exp(-j w T/2) sin(w T/2)/(w T/2)`, T = 1/`sample_rate_hz`: the hold acts on
    /// a sine below half of the sample rate as this factor. A model fitted afterwards is the plant alone, and a
    /// discretisation with hold brings the factor back. At 2 kHz and 13 Hz it is 1.17 degrees of phase.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] where a point lies at or above half of `sample_rate_hz`.
    pub fn without_hold(&self, sample_rate_hz: f64) -> Result<Self> {
        let mut points = self.points.clone();
        for point in &mut points {
            let half_angle = PI * point.frequency_hz / sample_rate_hz;
            if !(half_angle > 0.0 && half_angle < PI / 2.0) {
                let allowed = "more than twice the highest frequency";
                return Err(Error::OutOfRange { key: "sample_rate_hz", found: sample_rate_hz, allowed });
            }
            let hold = Complex64::from_polar(half_angle.sin() / half_angle, -half_angle);
            let SweepPoint { frequency_hz, amplitude, distortion, .. } = *point;
            *point = SweepPoint::from_response(frequency_hz, amplitude, point.response() / hold, distortion);
        }
        Ok(Self { points, bias: self.bias })
    }
}

fn check_point(point: &SweepPoint, line: usize) -> Result<()> {
    let p = point;
    let check = |column, found: f64, ok: bool, allowed| {
        let bad = !ok || !found.is_finite();
        if bad { Err(Error::SweepField { line, column, found: found.to_string(), allowed }) } else { Ok(()) }
    };
    check("frequency_hz", p.frequency_hz, p.frequency_hz > 0.0, "a number above 0")?;
    check("amplitude", p.amplitude, p.amplitude > 0.0 && p.amplitude <= 1.0, "a number above 0 and up to 1")?;
    check("magnitude", p.magnitude_mm_per_unit, p.magnitude_mm_per_unit > 0.0, "a number above 0")?;
    // Wider than any device by orders of magnitude; beyond it the squares in the fit leave the range of floating point.
    let usable = |found: f64| (1e-9..=1e6).contains(&found);
    check("frequency_hz", p.frequency_hz, usable(p.frequency_hz), "a number from 1e-9 to 1e6")?;
    let magnitude = p.magnitude_mm_per_unit;
    check("magnitude", magnitude, usable(magnitude), "a number from 1e-9 to 1e6")?;
    check("phase_deg", p.phase_deg, p.phase_deg.abs() <= 3600.0, "a number between -3600 and 3600")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(frequencies_hz: &[f64]) -> Vec<SweepPoint> {
        let one = Complex64::new(1.0, 0.0);
        frequencies_hz.iter().map(|&f| SweepPoint::from_response(f, 0.2, one, None)).collect()
    }

    #[test]
    fn law_phase_of_a_third_order_lag_does_not_jump() {
        for step in 0..36 {
            let lag = -7.5 * f64::from(step);
            let p = SweepPoint::from_response(1.0, 0.2, Complex64::from_polar(2.0, lag.to_radians()), None);
            assert!((p.phase_deg - lag).abs() < 1e-10 && (p.magnitude_mm_per_unit - 2.0).abs() < 1e-12);
        }
    }

    #[test]
    fn law_hold_is_removed() {
        let n = 64;
        // A sine held for n sub-steps of each of 20 samples per period, against the sine itself.
        let held: Complex64 = (0..20 * n)
            .map(|i| {
                let sample = f64::from(i / n) / 20.0;
                let t = (f64::from(i) + 0.5) / f64::from(20 * n);
                (TAU * sample).cos() * Complex64::from_polar(2.0 / f64::from(20 * n), -TAU * t)
            })
            .sum();
        let mut points = flat(&[1.0, 2.0, 3.0, 4.0, 5.0]);
        points[0] = SweepPoint::from_response(1.0, 0.2, held, None);
        let record = SweepRecord::new(points, None).expect("valid").without_hold(20.0).expect("valid");
        // The sub-step midpoint rule itself is off by (pi/1280)^2/6.
        assert!((record.points()[0].response() - 1.0).norm() < 2e-6);
    }

    #[test]
    fn edge_bad_points_are_refused_with_their_number() {
        let mut points = flat(&[1.0, 2.0, 3.0, 4.0, 5.0]);
        points[2].magnitude_mm_per_unit = f64::NAN;
        let message = SweepRecord::new(points, None).expect_err("NaN").to_string();
        assert_eq!(message, "line 3, column `magnitude`: allowed is a number above 0, found `NaN`");
        let found = SweepRecord::new(flat(&[1.0, 2.0, 3.0, 4.0]), None);
        assert_eq!(found, Err(Error::SweepTooFewFrequencies { needed: 5, found: 4 }));
        let found = SweepRecord::new(flat(&[1.0, 2.0, 3.0, 4.0, 2.0, 5.0]), None);
        assert!(matches!(found, Err(Error::SweepDuplicate { line: 5, first_line: 2, .. })));
        assert!(SweepRecord::new(flat(&[1.0, 2.0, 3.0, 4.0, 5.0]), Some(1.5)).is_err());
    }
}
