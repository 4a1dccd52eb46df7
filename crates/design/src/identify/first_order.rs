//! A first-order model: what a held plate shows of its circuit.

use num_complex::Complex64;
use telepulse_lti::TransferFunction;

use super::SweepRecord;
use crate::{Error, Result};

/// A gain behind a known circuit pole.
#[derive(Debug, Clone, PartialEq)]
pub struct FirstOrderFit {
    /// Gain at rest, output unit per unit of command.
    pub dc_gain: f64,
    /// Time constant of the circuit, in s; given, not fitted.
    pub rc_s: f64,
    /// `dc_gain / (rc_s s + 1)`.
    pub transfer_function: TransferFunction,
    /// Root mean square of the complex residual, output unit per unit.
    pub rms_residual: f64,
}

/// Fits `k / (rc s + 1)` to a sweep.
///
/// Where a load cell holds the plate, inertia and stiffness play no part below the cell's own resonance, and a
/// third-order model is not determined by the data.
///
/// **Method**: the model is linear in `k`, so the complex least-squares estimate is
/// `k = Re(sum conj(B) y) / sum |B|^2` with `B = 1/(1 + j omega rc)`.
///
/// # Errors
/// [`Error::OutOfRange`] for a time constant that is not positive.
pub fn fit_first_order(record: &SweepRecord, rc_s: f64) -> Result<FirstOrderFit> {
    if !(rc_s.is_finite() && rc_s > 0.0) {
        return Err(Error::OutOfRange { key: "rc_s", found: rc_s, allowed: "above 0" });
    }
    let basis = |omega: f64| 1.0 / Complex64::new(1.0, omega * rc_s);
    let (mut cross, mut power) = (0.0, 0.0);
    for point in record.points() {
        let b = basis(point.omega_rad_s());
        cross += (b.conj() * point.response()).re;
        power += b.norm_sqr();
    }
    let dc_gain = cross / power;
    let residual = |omega: f64, y: Complex64| (y - dc_gain * basis(omega)).norm_sqr();
    let sum: f64 = record.points().iter().map(|p| residual(p.omega_rad_s(), p.response())).sum();
    Ok(FirstOrderFit {
        dc_gain,
        rc_s,
        transfer_function: TransferFunction::new(&[dc_gain], &[rc_s, 1.0])?,
        rms_residual: (sum / record.points().len() as f64).sqrt(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::SweepPoint;

    #[test]
    fn law_a_first_order_device_is_recovered_exactly() {
        let device = TransferFunction::new(&[0.82], &[0.0045, 1.0]).expect("proper");
        let points = (1..=20)
            .map(|k| {
                let hz = 0.65 * f64::from(k);
                let response = device.at(std::f64::consts::TAU * hz);
                SweepPoint {
                    frequency_hz: hz,
                    amplitude: 0.2,
                    magnitude_mm_per_unit: response.norm(),
                    phase_deg: response.arg().to_degrees(),
                    distortion: None,
                }
            })
            .collect();
        let record = SweepRecord::new(points, Some(0.5)).expect("valid points");
        let fit = fit_first_order(&record, 0.0045).expect("fits");
        // Exact data: only the round trip through degrees rounds.
        assert!((fit.dc_gain - 0.82).abs() < 1e-12 && fit.rms_residual < 1e-12, "{fit:?}");
        assert!(fit_first_order(&record, 0.0).is_err());
    }
}
