//! Rigs seen through the sensor and drive traits.

use telepulse_actuator::rig::{
    CapacitiveReading, DisplacementRig, Fingertip, ForceRig, ForceStep, Laser, LoadCell, RigConditions,
    SensingSine,
};
use telepulse_actuator::twin::{Fidelity, TwinModel};
use telepulse_actuator::{Error, ParameterSet};
use telepulse_rt::{Drive, DriveFault, DriveVoltage, Limits, MonotonicNs, Sensor, SensorFault};

use crate::assert_close;

const TICK_NS: u64 = 500_000;

fn model() -> TwinModel {
    TwinModel::new(&ParameterSet::A.parameters()).expect("taut")
}

fn volts(request_v: f64) -> DriveVoltage {
    let limits = Limits::new(0.0, 5000.0, f64::INFINITY).expect("valid limits");
    limits.clamp(request_v, limits.off(), 1.0).voltage
}

/// Reads at every tick while the voltage is held.
fn run(rig: &mut (impl Sensor + Drive), from_tick: u64, n_ticks: u64, drive_v: f64) -> Vec<f64> {
    (from_tick..from_tick + n_ticks)
        .map(|tick| {
            let now = MonotonicNs(tick * TICK_NS);
            let reading = rig.read(now).expect("in range");
            rig.apply(now, volts(drive_v)).expect("time runs ahead");
            reading.value
        })
        .collect()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[test]
fn law_laser_reads_standoff_plus_displacement_and_runs_repeat() {
    let model = model();
    let mut rig = DisplacementRig::new(&model, RigConditions::default(), 3).expect("valid");
    let at_rest = run(&mut rig, 0, 400, 0.0);
    // 3 um over 400 samples: 0.15 um, five of them.
    assert_close(mean(&at_rest), 50.0, 0.0, 0.00075, "at rest");
    let driven = run(&mut rig, 400, 8000, 5000.0);
    assert_close(
        mean(&driven[7600..]),
        50.0 + rig.true_displacement_mm(),
        0.0,
        0.0015,
        "reading against truth",
    );
    assert!(rig.true_displacement_mm() > 1.0, "voltage lowers the plate");
    let mut again = DisplacementRig::new(&model, RigConditions::default(), 3).expect("valid");
    assert_eq!(run(&mut again, 0, 400, 0.0), at_rest);
    assert_eq!(run(&mut again, 400, 8000, 5000.0), driven);
}

#[test]
fn law_disturbance_sets_in_on_time_and_moves_the_plate_by_force_over_stiffness() {
    let conditions = RigConditions {
        disturbance: Some(ForceStep { force_n: 0.010, start_s: 1.00013 }),
        ..RigConditions::default()
    };
    let mut rig = DisplacementRig::new(&model(), conditions, 1).expect("valid");
    run(&mut rig, 0, 2001, 0.0);
    assert!(rig.true_displacement_mm().abs() < 1e-9, "not before its time");
    run(&mut rig, 2001, 600_000, 0.0);
    // 10 mN over 143.87 N/m, softening by 1 % along the way.
    assert_close(rig.true_displacement_mm(), 0.0695, 0.01, 0.0, "settled under the disturbance");
}

#[test]
fn law_sensing_sine_is_on_the_sensor_and_not_on_the_plate() {
    let quiet = Laser { noise_rms_mm: 0.0, resolution_mm: 0.0, ..Laser::default() };
    let conditions = RigConditions {
        sensing_noise: Some(SensingSine { amplitude_in_sensor_unit: 0.02, frequency_hz: 50.0 }),
        ..RigConditions::default()
    };
    let mut rig = DisplacementRig::with_laser(&model(), quiet, conditions, 1).expect("valid");
    let values = run(&mut rig, 0, 400, 0.0);
    for (tick, value) in values.iter().enumerate() {
        let t = tick as f64 * 5e-4;
        let expected = 50.0 + 0.02 * (100.0 * std::f64::consts::PI * t).sin();
        assert_close(*value, expected, 0.0, 1e-9, "sine");
    }
    assert!(rig.true_displacement_mm().abs() < 1e-9);
}

#[test]
fn law_load_cell_carries_the_load_of_the_weight_and_falls_with_voltage() {
    let model = model();
    let mut rig = ForceRig::new(&model, RigConditions::default(), 5).expect("valid");
    let at_rest = run(&mut rig, 0, 2000, 0.0);
    // Weight of the original load less that of the bare plate.
    let expected = (0.1 - 0.005) * 9.80665;
    assert_close(mean(&at_rest), expected, 0.0, 1e-4, "static load");
    assert!(rig.true_displacement_mm().abs() < 1e-6);
    let driven = run(&mut rig, 2000, 40_000, 5000.0);
    // The cell is a hundred times stiffer than the membrane: nearly all of F(x, 5 kV) - F(x, 0) shows as force.
    let drop = model.force_n(0.0, 0.0) - model.force_n(0.0, 5000.0);
    let found = mean(&at_rest) - mean(&driven[39_000..]);
    assert!(drop > 0.1, "{drop}");
    assert_close(found, drop, 0.02, 0.0, "drop under 5 kV");
    assert_close(mean(&driven[39_990..]), rig.true_force_n(), 0.0, 1e-3, "reading against truth");
}

#[test]
fn law_load_cell_mode_is_resolved() {
    // A finer step must not change the ringing of the plate on the cell: compare with a tick that forces finer steps.
    let quiet = LoadCell { noise_rms_n: 0.0, resolution_n: 0.0, ..LoadCell::default() };
    let model = model();
    let kick = RigConditions {
        disturbance: Some(ForceStep { force_n: -0.2, start_s: 0.0 }),
        ..RigConditions::default()
    };
    let mut coarse = ForceRig::with_load_cell(&model, quiet, kick, 1).expect("valid");
    let mut fine = coarse.clone();
    let mut largest = 0.0_f64;
    for tick in 1..=200_u64 {
        let a = coarse.read(MonotonicNs(tick * TICK_NS)).expect("in range").value;
        let mut b = 0.0;
        for part in 1..=50 {
            b = fine.read(MonotonicNs((tick - 1) * TICK_NS + part * TICK_NS / 50)).expect("in range").value;
        }
        largest = largest.max((a - b).abs());
    }
    // 0.1 % of the kick; step 0.0625 ms against 0.01 ms.
    assert!(largest < 2e-4, "{largest} N");
}

#[test]
fn law_initial_bias_starts_settled() {
    let conditions = RigConditions { initial_bias_v: 2500.0, ..RigConditions::default() };
    let mut rig = DisplacementRig::new(&model(), conditions, 1).expect("valid");
    run(&mut rig, 0, 2000, 2500.0);
    assert_close(rig.true_displacement_mm(), 0.234_843_69, 0.0, 3e-6, "settled at the bias");
    assert_close(rig.membrane_voltage_v(), 2500.0, 1e-12, 0.0, "circuit at the bias");
}

#[test]
fn edge_time_backwards_range_and_bad_conditions_are_faults() {
    let model = model();
    let mut rig = DisplacementRig::new(&model, RigConditions::default(), 1).expect("valid");
    rig.read(MonotonicNs(10 * TICK_NS)).expect("ahead");
    assert_eq!(rig.read(MonotonicNs(9 * TICK_NS)), Err(SensorFault::Stale));
    assert_eq!(rig.apply(MonotonicNs(0), volts(0.0)), Err(DriveFault::Refused));

    let near = Laser { standoff_mm: 69.5, ..Laser::default() };
    let mut rig = DisplacementRig::with_laser(&model, near, RigConditions::default(), 1).expect("valid");
    rig.apply(MonotonicNs(0), volts(5000.0)).expect("ahead");
    assert!(matches!(rig.read(MonotonicNs(1_000_000_000)), Err(SensorFault::OutOfRange { .. })));

    let pulled = RigConditions {
        disturbance: Some(ForceStep { force_n: -2.0, start_s: 0.0 }),
        ..RigConditions::default()
    };
    let mut rig = ForceRig::new(&model, pulled, 1).expect("valid");
    assert!(matches!(rig.read(MonotonicNs(1_000_000_000)), Err(SensorFault::OutOfRange { .. })));

    let bad = RigConditions { initial_bias_v: 6000.0, ..RigConditions::default() };
    assert!(matches!(
        DisplacementRig::new(&model, bad, 1),
        Err(Error::Request { quantity: "initial_bias_v", .. })
    ));
    let bad = RigConditions {
        disturbance: Some(ForceStep { force_n: f64::NAN, start_s: 0.0 }),
        ..RigConditions::default()
    };
    assert!(ForceRig::new(&model, bad, 1).is_err());
    let cell = LoadCell { plate_mass_kg: 0.0, ..LoadCell::default() };
    assert!(ForceRig::with_load_cell(&model, cell, RigConditions::default(), 1).is_err());
}

/// Readings are compared without the laser's own noise.
fn quiet_laser() -> Laser {
    Laser { noise_rms_mm: 0.0, resolution_mm: 0.0, ..Laser::default() }
}

#[test]
fn law_field_level_rig_agrees_with_the_reduced_one_within_its_stated_error() {
    let model = TwinModel::with_stated_error(&ParameterSet::A.parameters()).expect("taut");
    let stated = model.stated_error().expect("measured");
    let mut rigs = [Fidelity::Reduced, Fidelity::Field].map(|fidelity| {
        let conditions = RigConditions {
            fidelity,
            disturbance: Some(ForceStep { force_n: 0.010, start_s: 0.30013 }),
            ..RigConditions::default()
        };
        DisplacementRig::with_laser(&model, quiet_laser(), conditions, 1).expect("valid")
    });
    let (mut largest, mut stroke) = (0.0_f64, 0.0_f64);
    for tick in 0..1200_u64 {
        // A rise to 4 kV and a fall, as a loop may ask for.
        let drive_v = 4000.0 * (std::f64::consts::PI * tick as f64 / 1200.0).sin();
        let [a, b] = rigs.each_mut().map(|rig| run(rig, tick, 1, drive_v)[0]);
        largest = largest.max((a - b).abs());
        stroke = stroke.max(b - 50.0);
    }
    // The stated error holds over a step to full scale and over (25); twice it covers the disturbance, which is in neither.
    let allowed = 2.0 * stated.step.max_mm.max(stated.reference.max_mm);
    assert!(stroke > 0.5, "{stroke}");
    assert!(largest < allowed, "{largest} mm, stated {stated:?}");
    assert!(largest > 0.0, "two models, not one twice");
    let [reduced, field] = &rigs;
    assert_close(field.supply_power_w(), reduced.supply_power_w(), 1e-3, 1e-9, "power");
    assert_close(field.membrane_voltage_v(), reduced.membrane_voltage_v(), 1e-6, 0.0, "membrane voltage");
    assert!(field.fault().is_none() && !field.has_left_map());
}

#[test]
fn law_field_level_load_cell_agrees_with_the_reduced_one() {
    let model = model();
    let quiet = LoadCell { noise_rms_n: 0.0, resolution_n: 0.0, ..LoadCell::default() };
    let mut rigs = [Fidelity::Reduced, Fidelity::Field].map(|fidelity| {
        let conditions = RigConditions { fidelity, ..RigConditions::default() };
        ForceRig::with_load_cell(&model, quiet, conditions, 1).expect("valid")
    });
    let [at_rest, field_at_rest] = rigs.each_mut().map(|rig| run(rig, 0, 1, 0.0)[0]);
    assert_close(field_at_rest, at_rest, 1e-6, 0.0, "static load");
    for tick in 1..800_u64 {
        let drive_v = 3000.0 * (1.0 - (std::f64::consts::TAU * tick as f64 / 800.0).cos());
        let [a, b] = rigs.each_mut().map(|rig| run(rig, tick, 1, drive_v.min(5000.0))[0]);
        // The relief under full scale is 0.13 N; 0.5 % of it.
        assert_close(b, a, 0.0, 7e-4, &format!("tick {tick}"));
    }
    let [reduced, field] = &rigs;
    assert_close(field.true_displacement_mm(), reduced.true_displacement_mm(), 0.0, 1e-4, "held plate");
}

#[test]
fn edge_a_field_level_membrane_without_equilibrium_stops_the_rig_with_the_reason() {
    let conditions = RigConditions {
        fidelity: Fidelity::Field,
        disturbance: Some(ForceStep { force_n: 1e4, start_s: 0.0 }),
        ..RigConditions::default()
    };
    // A laser that sees any distance: it is the membrane that has to say no.
    let laser = Laser { max_mm: 1e9, ..quiet_laser() };
    let mut rig = DisplacementRig::with_laser(&model(), laser, conditions, 1).expect("valid");
    let refused = (1..2000).find_map(|tick| rig.read(MonotonicNs(tick * TICK_NS)).err());
    assert_eq!(refused, Some(SensorFault::Stale), "10 kN are more than a membrane of 1 N bears");
    assert!(rig.fault().is_some());
    assert!(rig.read(MonotonicNs(u64::from(u32::MAX))).is_err(), "it does not come back");
}

#[test]
fn law_capacitance_feels_the_plate_within_its_stated_error_in_both_fidelities() {
    let model = model();
    for (fidelity, n_ticks) in [(Fidelity::Reduced, 4000_u64), (Fidelity::Field, 400)] {
        let conditions = RigConditions { fidelity, initial_bias_v: 2500.0, ..RigConditions::default() };
        let reading = CapacitiveReading::below(5000.0);
        let mut rig = DisplacementRig::with_capacitance(&model, reading, conditions, 11).expect("valid");
        for tick in 0..n_ticks {
            let drive_v = 2500.0 + 800.0 * (std::f64::consts::TAU * 1.2 * tick as f64 * 5e-4).sin();
            run(&mut rig, tick, 1, drive_v);
        }
        let found = rig.sensing().expect("felt");
        assert_eq!(found.n_readings as u64, n_ticks);
        // 0.02 mm on a moving plate, as the sensor's own tests have it, and five standard deviations of noise.
        let allowed = 0.02 + 5.0 * found.standard_deviation_max_mm;
        assert!(found.error_max_mm < allowed, "{fidelity:?}: {found:?}");
        assert!(found.standard_deviation_max_mm < 0.01, "{fidelity:?}: {found:?}");
        assert!(rig.fault().is_none());
    }
}

#[test]
fn edge_carrier_keeps_command_and_ceiling_apart_and_bad_settings_are_refused() {
    let model = model();
    let reading = CapacitiveReading::below(5000.0);
    let mut rig =
        DisplacementRig::with_capacitance(&model, reading, RigConditions::default(), 1).expect("valid");
    let mut highest = 0.0_f64;
    for tick in 0..2000 {
        run(&mut rig, tick, 1, 5000.0);
        highest = highest.max(rig.membrane_voltage_v());
    }
    // The circuit passes 1/sqrt(1 + (w RC)^2) = 0.33 of the carrier, about a command that was lowered to 4900 V.
    assert!((4900.0..4940.0).contains(&highest), "{highest}");
    for (key, bad) in [
        ("carrier_v", CapacitiveReading { carrier_v: f64::NAN, ..reading }),
        ("ceiling_v", CapacitiveReading { ceiling_v: 150.0, ..reading }),
        ("ceiling_v", CapacitiveReading { ceiling_v: 6000.0, ..reading }),
    ] {
        match DisplacementRig::with_capacitance(&model, bad, RigConditions::default(), 1) {
            Err(Error::Parameter { key: found, .. }) => assert_eq!(found, key),
            other => panic!("{key}: {other:?}"),
        }
    }
    assert_eq!(rig.read(MonotonicNs(0)), Err(SensorFault::Stale));
}

#[test]
fn law_a_fingertip_balances_the_plate_lets_go_and_touches_again_without_a_jump() {
    let (k, p, touch_mm) = (4e3, 1.5, 0.5);
    let fingertip = Fingertip { stiffness_n_per_m_p: k, exponent: p, dissipation_s_per_m: 2.0, touch_mm };
    let model = model();
    let mut rig =
        DisplacementRig::with_fingertip(&model, quiet_laser(), fingertip, RigConditions::default(), 1)
            .expect("valid");
    // At rest the fingertip carries what the membrane pulls more than the weight, at a compression of its own law.
    let pressed_mm = touch_mm - rig.true_displacement_mm();
    let by_law = k * (1e-3 * pressed_mm).powf(p);
    let weight = model.parameters().weight_n();
    let excess = model.force_n(rig.true_displacement_mm(), 0.0) - weight;
    assert!(pressed_mm > 0.05 && by_law > 1e-3, "{pressed_mm}");
    // force_n is the relaxed map itself; Newton's method has stopped at 1e-15 m.
    assert!((by_law + excess).abs() < 1e-9 || (by_law - excess).abs() < 1e-9, "{by_law} {excess}");
    assert!((rig.true_contact_force_n() - by_law).abs() < 1e-9);
    // 4.5 kV for two seconds moves the plate away, zero volts bring it back against the finger.
    run(&mut rig, 0, 4000, 4500.0);
    assert!(rig.true_displacement_mm() > touch_mm && rig.true_contact_force_n() == 0.0);
    let back = run(&mut rig, 4000, 4000, 0.0);
    assert!(rig.true_contact_force_n() > 0.0);
    // 0.5 ms of a plate that moves at most at 30 mm/s.
    assert!(back.windows(2).all(|pair| (pair[1] - pair[0]).abs() < 0.015));
    let soft = Fingertip { exponent: 0.5, ..fingertip };
    let refused = DisplacementRig::with_fingertip(&model, quiet_laser(), soft, RigConditions::default(), 1);
    assert!(matches!(refused, Err(Error::Parameter { key: "contact exponent", .. })));
}
