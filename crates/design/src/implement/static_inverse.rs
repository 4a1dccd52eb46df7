//! The inverse of a measured quasi-static curve.

use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// From displacement to the command that holds it, through measured points.
///
/// **Shapes and units**: command in units, displacement in mm from rest, both strictly rising.
///
/// **Method**: monotone cubic interpolation of command over displacement: the slopes are harmonic means of the secants on both sides, so
/// the curve never overshoots its points. Outside of the measured range it holds the end values: a reference that asks for more
/// than was measured gets what was measured, and the drive's limits are not relied on.
///
/// Together with a preview filter it makes `u = inverse(D(r))`, where D is the preview filter of the plant scaled to unit DC gain
/// ([`PreviewFeedforward::shaped`](super::PreviewFeedforward::shaped)). That is exact for slow references, and for small ones about any bias as
/// far as the plant's *dynamics* do not change with the bias. A square law at the input, as in a dielectric elastomer, is
/// of this kind but for the circuit's lag, which lies before it; a stiffness that changes with displacement is not.
///
/// **Source**: Fritsch and Butland 1984, SIAM J. Sci. Stat. Comput. 5(2), 300-304.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "PlainCurve", into = "PlainCurve")]
pub struct StaticInverse {
    curve: PlainCurve,
    slopes: Vec<f64>,
}

/// [`StaticInverse`] before its check.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PlainCurve {
    command: Vec<f64>,
    displacement_mm: Vec<f64>,
}

impl TryFrom<PlainCurve> for StaticInverse {
    type Error = Error;
    fn try_from(plain: PlainCurve) -> Result<Self> {
        Self::new(&plain.command, &plain.displacement_mm)
    }
}

impl From<StaticInverse> for PlainCurve {
    fn from(inverse: StaticInverse) -> Self {
        inverse.curve
    }
}

impl StaticInverse {
    /// Checks a measured curve of at least two points.
    ///
    /// # Errors
    /// [`Error::SampleCount`], [`Error::SampleNotFinite`], [`Error::NotMonotone`].
    pub fn new(command: &[f64], displacement_mm: &[f64]) -> Result<Self> {
        if displacement_mm.len() != command.len() || command.len() < 2 {
            let (expected, found) = (command.len().max(2), displacement_mm.len());
            return Err(Error::SampleCount { signal: "static curve", expected, found });
        }
        for (column, values) in [("command", command), ("displacement_mm", displacement_mm)] {
            if let Some(sample_idx) = values.iter().position(|v| !v.is_finite()) {
                return Err(Error::SampleNotFinite { signal: column, sample_idx, found: values[sample_idx] });
            }
            if let Some(row) = (1..values.len()).find(|&row| values[row] <= values[row - 1]) {
                let (previous, found) = (values[row - 1], values[row]);
                return Err(Error::NotMonotone { column, row, previous, found });
            }
        }
        let curve = PlainCurve { command: command.to_vec(), displacement_mm: displacement_mm.to_vec() };
        let slopes = slopes(displacement_mm, command);
        Ok(Self { curve, slopes })
    }

    /// The command that holds a displacement.
    #[must_use]
    pub fn command(&self, displacement_mm: f64) -> f64 {
        let (x, y) = (&self.curve.displacement_mm, &self.curve.command);
        let last = x.len() - 1;
        if displacement_mm <= x[0] || displacement_mm.is_nan() {
            return y[0];
        }
        if displacement_mm >= x[last] {
            return y[last];
        }
        let left = x.partition_point(|v| *v <= displacement_mm) - 1;
        let width = x[left + 1] - x[left];
        let s = (displacement_mm - x[left]) / width;
        // Cubic Hermite polynomials.
        let (h00, h10) = ((1.0 + 2.0 * s) * (1.0 - s).powi(2), s * (1.0 - s).powi(2));
        let (h01, h11) = (s * s * (3.0 - 2.0 * s), s * s * (s - 1.0));
        h00 * y[left] + h01 * y[left + 1] + width * (h10 * self.slopes[left] + h11 * self.slopes[left + 1])
    }

    /// Smallest and largest displacement of the curve, in mm.
    #[must_use]
    pub fn range_mm(&self) -> [f64; 2] {
        let x = &self.curve.displacement_mm;
        [x[0], x[x.len() - 1]]
    }
}

/// Fritsch and Butland's slopes; the ends take their secant.
fn slopes(x: &[f64], y: &[f64]) -> Vec<f64> {
    let secant: Vec<f64> = (1..x.len()).map(|i| (y[i] - y[i - 1]) / (x[i] - x[i - 1])).collect();
    let inner = |i: usize| {
        let (before, after) = (x[i] - x[i - 1], x[i + 1] - x[i]);
        let share = (before + 2.0 * after) / (3.0 * (before + after));
        secant[i - 1] * secant[i] / (share * secant[i] + (1.0 - share) * secant[i - 1])
    };
    let last = x.len() - 1;
    (0..=last)
        .map(|i| match i {
            0 => secant[0],
            i if i == last => secant[last - 1],
            i => inner(i),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The square law of an electrostatic force.
    fn square_law(n: u32) -> StaticInverse {
        let command: Vec<f64> = (0..=n).map(|k| f64::from(k) / f64::from(n)).collect();
        let displacement: Vec<f64> = command.iter().map(|v| 0.95 * v * v).collect();
        StaticInverse::new(&command, &displacement).expect("rises")
    }

    #[test]
    fn law_inverse_meets_its_points_and_rises_between_them() {
        let inverse = square_law(20);
        let mut previous = -1.0;
        for k in 0..=2000 {
            let command = inverse.command(0.95 * f64::from(k) / 2000.0);
            assert!(command > previous);
            previous = command;
        }
        for k in 0..=20 {
            let v = f64::from(k) / 20.0;
            assert!((inverse.command(0.95 * v * v) - v).abs() < 1e-15);
        }
        // Between the points, away from the infinite slope at rest.
        for v in [0.325, 0.525, 0.775, 0.975] {
            assert!((inverse.command(0.95 * v * v) - v).abs() < 2e-4);
        }
    }

    #[test]
    fn edge_ends_are_held_and_bad_curves_refused() {
        let inverse = square_law(10);
        assert_eq!((inverse.command(-1.0), inverse.command(9.0)), (0.0, 1.0));
        assert_eq!(inverse.command(f64::NAN), 0.0);
        let found = StaticInverse::new(&[0.0, 0.5, 1.0], &[0.0, 0.4, 0.4]);
        assert!(matches!(found, Err(Error::NotMonotone { column: "displacement_mm", row: 2, .. })));
        assert!(matches!(StaticInverse::new(&[0.0], &[0.0]), Err(Error::SampleCount { .. })));
        let found = StaticInverse::new(&[0.0, f64::NAN], &[0.0, 1.0]);
        assert!(matches!(found, Err(Error::SampleNotFinite { .. })));
    }

    #[test]
    fn law_file_round_trip_checks_again() {
        let text = serde_json::to_string(&square_law(5)).expect("writes");
        assert_eq!(serde_json::from_str::<StaticInverse>(&text).expect("reads"), square_law(5));
        let falling = "{\"command\":[0.0,1.0],\"displacement_mm\":[1.0,0.0]}";
        assert!(serde_json::from_str::<StaticInverse>(falling).is_err());
    }
}
