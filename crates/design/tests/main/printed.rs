//! The transfer functions that the paper prints.

// The weights carry 2 pi as it was printed, to four digits.
#![allow(clippy::approx_constant)]

use telepulse_design::synthesize::{MixedSensitivityWeights, mixed_sensitivity};
use telepulse_lti::{GeneralizedPlant, TransferFunction};

fn tf(numerator: &[f64], denominator: &[f64]) -> TransferFunction {
    TransferFunction::new(numerator, denominator).expect("proper")
}

/// Eq. (16), mm per unit.
pub fn g() -> TransferFunction {
    tf(&[1350.14], &[0.0045, 1.07182, 22.458, 1444.0])
}

/// Eq. (17), mm per unit.
pub fn ws() -> TransferFunction {
    tf(&[487.5], &[1.0, 45.0, 2500.0])
}

/// Eq. (19).
pub fn wu() -> TransferFunction {
    tf(&[0.1, 0.0006283], &[0.0001, 62.83])
}

/// Eq. (20).
pub fn we() -> TransferFunction {
    tf(&[0.2, 6.283], &[1.0, 0.0006283])
}

/// Eq. (21), unit per mm.
pub fn k() -> TransferFunction {
    tf(&[30.4975, 1232.4466, 81241.5075], &[1.0, 17.5212, 5833.5515, 3.6648])
}

/// Eq. (26).
pub fn filter() -> TransferFunction {
    let corner = 40.0 * std::f64::consts::PI;
    tf(&[corner], &[1.0, corner])
}

/// The S/KS problem of figure 10 with the printed weights.
pub fn generalized_plant() -> GeneralizedPlant {
    let weights = MixedSensitivityWeights { we: &we(), wu: &wu(), wt: None };
    mixed_sensitivity(&g(), &weights).expect("stable weights")
}
