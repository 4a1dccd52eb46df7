//! Displacement from voltage and current at the amplifier, with a carrier on the drive of the twin.

use std::f64::consts::TAU;

use telepulse_actuator::sensing::{CapacitiveSensor, SensingSettings};
use telepulse_actuator::twin::{Inputs, Twin, TwinModel};
use telepulse_actuator::{Error, ParameterSet};

use crate::{assert_close, uniform};

const CARRIER_V: f64 = 100.0;
/// The last window of a run with `drive(t)` and the carrier: voltages, currents and the mean true displacement.
struct Window {
    voltage_v: Vec<f64>,
    current_a: Vec<f64>,
    displacement_mm: f64,
}

fn record(model: &TwinModel, settings: SensingSettings, start_v: f64, drive: impl Fn(f64) -> f64) -> Window {
    let mut twin = Twin::new(model);
    twin.settle(start_v);
    let dt = settings.sample_time_s;
    let leak = model.parameters().spec().leak_resistance_ohm;
    let n = (settings.n_periods as f64 / (settings.carrier_hz * dt)).round() as usize;
    let ahead = (0.5 / dt).round() as usize;
    let command = |t: f64| drive(t) + CARRIER_V * (TAU * settings.carrier_hz * t).sin();
    let charge = |twin: &Twin| {
        model.capacitance_f(twin.displacement_mm(), twin.membrane_voltage_v()) * twin.membrane_voltage_v()
    };
    let mut window = Window { voltage_v: Vec::new(), current_a: Vec::new(), displacement_mm: 0.0 };
    for k in 0..ahead + n {
        let drive_v = command((k as f64 + 0.5) * dt);
        let (charge_before, mm_before) = (charge(&twin), twin.displacement_mm());
        twin.advance(dt, Inputs { drive_v, disturbance_n: 0.0 });
        if k >= ahead {
            window.voltage_v.push(drive_v);
            window.current_a.push((charge(&twin) - charge_before) / dt + drive_v / leak);
            let idx = window.voltage_v.len() as f64 - 0.5;
            let weight = (1.0 - (TAU * idx / n as f64).cos()) / n as f64;
            window.displacement_mm += weight * 0.5 * (mm_before + twin.displacement_mm());
        }
    }
    window
}

#[test]
fn law_displacement_is_found_over_the_range_without_noise() {
    let model = TwinModel::new(&ParameterSet::A.parameters()).expect("valid");
    let settings = SensingSettings::default();
    let sensor = CapacitiveSensor::new(&model, settings).expect("valid");
    for bias_v in [1000.0, 2500.0, 4500.0] {
        let window = record(&model, settings, bias_v, |_| bias_v);
        let found = sensor.estimate(&window.voltage_v, &window.current_a).expect("in range");
        // The plate follows the carrier by (6.05/100)^2 of its static response, which at 4.5 kV passes for 6 um.
        assert_close(found.displacement_mm, window.displacement_mm, 0.0, 0.01, &format!("{bias_v} V"));
        assert_close(found.bias_v, bias_v, 1e-3, 0.0, "bias");
        assert_close(found.series_resistance_ohm, 1.5168e6, 0.01, 0.0, "series resistance");
    }
}

#[test]
fn law_a_moving_plate_is_followed() {
    let model = TwinModel::new(&ParameterSet::A.parameters()).expect("valid");
    let settings = SensingSettings::default();
    let sensor = CapacitiveSensor::new(&model, settings).expect("valid");
    for phase in [0.0, 1.2, 2.5, 4.0] {
        let drive = |t: f64| 2500.0 + 800.0 * (TAU * 1.2 * t + phase).sin();
        let window = record(&model, settings, drive(0.0), drive);
        let found = sensor.estimate(&window.voltage_v, &window.current_a).expect("in range");
        // Stroke 0.3 mm; the bias moves by up to 240 V within the window.
        assert_close(found.displacement_mm, window.displacement_mm, 0.0, 0.02, &format!("phase {phase}"));
    }
}

#[test]
fn regress_a_kink_of_the_drive_does_not_pass_for_displacement() {
    // The carrier was demodulated, and what a kink of the bias leaked into its frequency passed for up to 1.7 mm.
    let model = TwinModel::new(&ParameterSet::A.parameters()).expect("valid");
    let settings = SensingSettings::default();
    let sensor = CapacitiveSensor::new(&model, settings).expect("valid");
    for start_s in [0.505, 0.52, 0.533] {
        let drive = |t: f64| 2500.0 + 6000.0 * (t - start_s).max(0.0);
        let window = record(&model, settings, 2500.0, drive);
        let found = sensor.estimate(&window.voltage_v, &window.current_a).expect("in range");
        assert_close(found.displacement_mm, window.displacement_mm, 0.0, 0.02, &format!("from {start_s} s"));
    }
}

#[test]
fn law_noise_spreads_the_estimate_as_stated() {
    let model = TwinModel::new(&ParameterSet::A.parameters()).expect("valid");
    let settings = SensingSettings::default();
    let sensor = CapacitiveSensor::new(&model, settings).expect("valid");
    let window = record(&model, settings, 2500.0, |_| 2500.0);
    let clean = sensor.estimate(&window.voltage_v, &window.current_a).expect("in range");
    const SEED: u64 = 4;
    let mut seed = SEED;
    let mut normal = || {
        let (a, b) = (1.0 - uniform(&mut seed), uniform(&mut seed));
        (-2.0 * a.ln()).sqrt() * (TAU * b).cos()
    };
    let n_runs = 400;
    let mut sum = 0.0;
    for _ in 0..n_runs {
        let mut noisy =
            |record: &[f64], rms: f64| record.iter().map(|v| v + rms * normal()).collect::<Vec<_>>();
        let voltage = noisy(&window.voltage_v, settings.voltage_noise_v);
        let current = noisy(&window.current_a, settings.current_noise_a);
        let found = sensor.estimate(&voltage, &current).expect("in range");
        sum += (found.displacement_mm - clean.displacement_mm).powi(2);
    }
    let spread = (sum / f64::from(n_runs)).sqrt();
    // The spread of 400 runs is itself known to 1/sqrt(800) = 3.5 %; five of those.
    assert_close(spread, clean.standard_deviation_mm, 0.18, 0.0, &format!("spread from seed {SEED}"));
    assert!(clean.standard_deviation_mm < 0.01, "{}", clean.standard_deviation_mm);
}

#[test]
fn edge_no_carrier_wrong_length_and_bad_settings_are_refused() {
    let model = TwinModel::new(&ParameterSet::C.parameters()).expect("valid");
    let settings = SensingSettings::default();
    let sensor = CapacitiveSensor::new(&model, settings).expect("valid");
    let n = sensor.n_samples();
    assert_eq!(n, 800);
    let silent = sensor.estimate(&vec![2500.0; n], &vec![0.0; n]);
    assert!(matches!(silent, Err(Error::CapacitanceOutOfRange { .. })), "{silent:?}");
    assert!(matches!(sensor.estimate(&[1.0], &[1.0]), Err(Error::Request { .. })));
    assert!(matches!(sensor.estimate(&vec![f64::NAN; n], &vec![0.0; n]), Err(Error::Request { .. })));
    for (key, bad) in [
        ("carrier_hz", SensingSettings { carrier_hz: 0.0, ..settings }),
        ("n_periods", SensingSettings { n_periods: 1, ..settings }),
        ("sample_time_s", SensingSettings { sample_time_s: 3.3e-4, ..settings }),
        ("current_noise_a", SensingSettings { current_noise_a: f64::NAN, ..settings }),
    ] {
        match CapacitiveSensor::new(&model, bad) {
            Err(Error::Parameter { key: found, .. }) => assert_eq!(found, key),
            other => panic!("{key}: {other:?}"),
        }
    }
}
