//! The transfer functions that the paper prints (Ye, Chen, Asmatulu and Chan 2017), in one place.

use telepulse_lti::{Error, TransferFunction};

/// The identified plant in mm per unit of drive, Eq. (16).
pub fn plant() -> TransferFunction {
    tf(&[1350.14], &[0.0045, 1.07182, 22.458, 1444.0])
}

/// The electrical part of the plant, Eq. (14).
pub fn circuit() -> TransferFunction {
    tf(&[1.0], &[0.0045, 1.0])
}

/// The mechanical part of the plant, Eq. (15), whose numerator Eq. (16) replaces.
pub fn mechanics() -> TransferFunction {
    tf(&[1.0], &[1.0, 15.96, 1444.0])
}

/// The cap of the additive modelling error, Eq. (17).
pub fn uncertainty() -> TransferFunction {
    tf(&[487.5], &[1.0, 45.0, 2500.0])
}

/// The weight of the control effort, Eq. (19).
pub fn effort_weight() -> TransferFunction {
    tf(&[0.1, 0.000_628_3], &[0.0001, 62.83])
}

/// The weight of the tracking error, Eq. (20).
#[expect(clippy::approx_constant, reason = "the paper prints four digits of what may have been 2 pi")]
pub fn error_weight() -> TransferFunction {
    tf(&[0.2, 6.283], &[1.0, 0.000_628_3])
}

/// The H-infinity controller, Eq. (21).
pub fn controller() -> TransferFunction {
    tf(&[30.4975, 1232.4466, 81241.5075], &[1.0, 17.5212, 5833.5515, 3.6648])
}

/// The low-pass filter of the laser signal, Eq. (26).
pub fn measurement_filter() -> TransferFunction {
    let corner = 40.0 * std::f64::consts::PI;
    tf(&[corner], &[1.0, corner])
}

/// The PID controller of section 5.1 that was tuned automatically.
pub fn auto_tuned_pid() -> TransferFunction {
    pid(3.1738, 48.6620, 0.0443).unwrap()
}

/// The PI controller of section 5.1 that was tuned by hand.
pub fn hand_tuned_pi() -> TransferFunction {
    tf(&[1.7, 24.331], &[1.0, 0.0])
}

/// `P + I / s + D N s / (s + N)` with the paper's filter coefficient `N`.
fn pid(p: f64, i: f64, d: f64) -> Result<TransferFunction, Error> {
    let n = 9630.0667;
    let proportional_integral = TransferFunction::new(&[p, i], &[1.0, 0.0])?;
    proportional_integral.add(&TransferFunction::new(&[d * n, 0.0], &[1.0, n])?)
}

/// The reference, Eq. (25), as sinusoids in mm.
pub const REFERENCE: [Sinusoid; 3] = [
    Sinusoid { amplitude_mm: 0.2, omega_over_pi_rad_s: 0.4, phase_over_pi: 1.5 },
    Sinusoid { amplitude_mm: 0.2, omega_over_pi_rad_s: 0.1, phase_over_pi: 1.0 },
    Sinusoid { amplitude_mm: 0.1, omega_over_pi_rad_s: 0.8, phase_over_pi: 0.5 },
];

/// The shortest time after which Eq. (25) repeats: 5 s, 20 s and 2.5 s have it in common.
pub const REFERENCE_PERIOD_S: f64 = 20.0;

/// `amplitude sin(omega t + phase)`.
pub struct Sinusoid {
    pub amplitude_mm: f64,
    pub omega_over_pi_rad_s: f64,
    pub phase_over_pi: f64,
}

fn tf(numerator: &[f64], denominator: &[f64]) -> TransferFunction {
    TransferFunction::new(numerator, denominator).unwrap()
}
