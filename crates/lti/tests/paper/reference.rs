//! The reference, Eq. (25), and how well the printed loop follows it.

use super::assert_rounds_to;
use super::systems::{REFERENCE, REFERENCE_PERIOD_S, controller, measurement_filter, plant};
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use std::f64::consts::PI;
use telepulse_lti::{SampleTime, TransferFunction};

/// The reference passed through a system, in its steady state: each sinusoid by its phasor.
fn steady_state_mm(time_s: f64, system: impl Fn(f64) -> Complex64) -> f64 {
    let part = |s: &super::systems::Sinusoid| {
        let omega = PI * s.omega_over_pi_rad_s;
        let phasor = s.amplitude_mm * system(omega) * Complex64::from_polar(1.0, PI * s.phase_over_pi);
        (phasor * Complex64::from_polar(1.0, omega * time_s)).im
    };
    REFERENCE.iter().map(part).sum()
}

/// Error of the plant's output, not of the measured one: `e = r - y` with `y = G K / (1 + G K F) r`.
fn error_system(filter: &TransferFunction) -> impl Fn(f64) -> Complex64 {
    let open = plant().multiply(&controller()).unwrap();
    let closed = open.feedback(filter).unwrap();
    move |omega| 1.0 - closed.at(omega)
}

/// One period in steps of 1 ms: the mean of a function with 14 sign changes is then good to 1e-8 relative.
fn mean_abs(f: impl Fn(f64) -> f64) -> f64 {
    let samples = 20_000;
    (0..samples).map(|k| f(REFERENCE_PERIOD_S * f64::from(k) / f64::from(samples)).abs()).sum::<f64>()
        / f64::from(samples)
}

#[test]
fn paper_eq25_the_largest_reference_is_0_4424_mm() {
    // The paper relates its errors to 0.5 mm, the sum of the amplitudes, which the reference never reaches.
    let samples = 200_000;
    let largest = (0..samples)
        .map(|k| {
            steady_state_mm(REFERENCE_PERIOD_S * f64::from(k) / f64::from(samples), |_| Complex64::ONE).abs()
        })
        .fold(0.0, f64::max);
    assert_rounds_to(largest, "0.4424");
}

#[test]
fn paper_eq25_mean_error_of_the_printed_loop() {
    let unity = TransferFunction::from_gain(1.0).unwrap();
    for (filter, printed) in [(unity, "0.01542"), (measurement_filter(), "0.01385")] {
        let error = error_system(&filter);
        assert_rounds_to(mean_abs(|t| steady_state_mm(t, &error)), printed);
    }
}

#[test]
fn paper_eq25_mean_error_by_simulation() {
    // By another route: states instead of phasors, through series, feedback, Tustin and simulation. At 1 ms the Tustin
    // warping of the fastest sinusoid (0.8 pi rad/s) is (omega T)^2 / 12 = 5e-7.
    let ts = SampleTime::new(0.001).unwrap();
    for (filter, printed) in
        [(TransferFunction::from_gain(1.0).unwrap(), "0.01542"), (measurement_filter(), "0.01385")]
    {
        let open = controller().to_state_space().series(&plant().to_state_space()).unwrap();
        let closed = open.feedback(&filter.to_state_space()).unwrap().to_discrete_tustin(ts).unwrap();
        // The slowest closed-loop pole is at -2.9 rad/s: after one period the transient is exp(-58).
        let samples = 40_000;
        let reference =
            DMatrix::from_fn(samples, 1, |k, _| steady_state_mm(k as f64 * 0.001, |_| Complex64::ONE));
        let output = closed.simulate(&reference, &DVector::zeros(closed.n_states())).unwrap();
        let error = (reference - output).rows(samples / 2, samples / 2).abs().mean();
        assert_rounds_to(error, printed);
    }
}
