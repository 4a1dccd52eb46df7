//! The plant (16) that the paper prints, as a record to calibrate against.

use nalgebra::Complex;

use super::SweepRecord;

/// Response of the printed plant, mm per unit of 5 kV.
///
/// **Source**: Eq. (16): 1350.14/((0.0045 s + 1)(s^2 + 15.96 s + 1444)).
#[must_use]
pub fn printed_response(frequency_hz: f64) -> Complex<f64> {
    let s = Complex::new(0.0, 2.0 * std::f64::consts::PI * frequency_hz);
    Complex::from(1350.14) / ((s * 0.0045 + 1.0) * (s * s + s * 15.96 + 1444.0))
}

/// The printed plant from 0.1 to 13 Hz, the range of the paper's figure 7, in 40 equal ratios, as if measured at `bias_v`.
///
/// The paper states no noise: `noise_mm_per_unit` is what the caller asks the fit to be good to.
#[must_use]
pub fn printed_sweep(bias_v: f64, noise_mm_per_unit: f64) -> SweepRecord {
    let frequencies = (0..=40).map(|idx| 0.1 * 130.0_f64.powf(f64::from(idx) / 40.0));
    SweepRecord {
        name: "Eq. (16)".to_owned(),
        bias_v,
        noise_mm_per_unit,
        rows: frequencies.map(|hz| (hz, printed_response(hz))).collect(),
    }
}
