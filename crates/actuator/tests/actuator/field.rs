//! The field-level simulation against the frequency-domain solve, energy laws and simple limits.

use std::f64::consts::PI;

use nalgebra::{Complex, Matrix4, Vector4};
use telepulse_actuator::field::{Amplifier, FieldSetup, FieldTwin, PlateContact};
use telepulse_actuator::frequency::{FractionalBranch, MembraneResponse};
use telepulse_actuator::{ActuatorParameters, ActuatorSpec, Error, ParameterSet};

use crate::assert_close;

const BIAS_V: f64 = 2500.0;

/// Phasors of displacement (mm) by drive (unit) and by membrane voltage (unit) for a small sine about the bias.
struct Measured {
    by_drive: Complex<f64>,
    by_voltage: Complex<f64>,
}

/// Least squares of `value = a cos + b sin + c + d t` over whole periods; the line takes the slow creep of a branch.
fn phasor(samples: &[(f64, f64)], omega: f64) -> Complex<f64> {
    let middle = samples[samples.len() / 2].0;
    let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
    for &(t, value) in samples {
        let row = Vector4::new((omega * t).cos(), (omega * t).sin(), 1.0, (t - middle) / middle);
        normal += row * row.transpose();
        right += row * value;
    }
    let fit = normal.lu().solve(&right).expect("whole periods");
    Complex::new(fit[0], -fit[1])
}

fn measure(parameters: &ActuatorParameters, setup: FieldSetup, hz: f64, step_s: f64) -> Measured {
    let omega = 2.0 * PI * hz;
    let mut twin = FieldTwin::with_setup(parameters, 16, setup).expect("taut");
    twin.settle(BIAS_V).expect("taut");
    // 5 V: the response is linear to the square of 5/2500.
    let amplitude_v = 5.0;
    // The plate's own motion decays as exp(-8 t); one slow period is enough for the branches.
    let periods = (3.0 * hz).ceil().max(2.0);
    let (skip, total) = (((periods - 1.0) / hz / step_s) as usize, (periods / hz / step_s).round() as usize);
    let skip = skip.min((2.5 / step_s) as usize);
    let per_period = (1.0 / hz / step_s).round() as usize;
    let first = total - (total - skip) / per_period * per_period;
    let (mut displacement, mut voltage) = (Vec::new(), Vec::new());
    for k in 0..total {
        let middle = (k as f64 + 0.5) * step_s;
        twin.step(step_s, BIAS_V + amplitude_v * (omega * middle).sin()).expect("taut");
        if k >= first {
            let t = (k + 1) as f64 * step_s;
            displacement.push((t, twin.displacement_mm()));
            voltage.push((t, twin.membrane_voltage_v() / 5000.0));
        }
    }
    let x = phasor(&displacement, omega);
    // The held samples of a sine at mid-step hold this much of it, without delay; 1/i turns a sine's phasor to the cosine's.
    let held = (0.5 * omega * step_s).sin() / (0.5 * omega * step_s);
    let drive = Complex::new(0.0, -amplitude_v / 5000.0 * held);
    Measured { by_drive: x / drive, by_voltage: x / phasor(&voltage, omega) }
}

#[track_caller]
fn assert_phasor(found: Complex<f64>, expected: Complex<f64>, what: &str) {
    let ratio = found / expected;
    let (amplitude, degrees) = (ratio.norm() - 1.0, ratio.arg().to_degrees());
    assert!(amplitude.abs() < 1e-3 && degrees.abs() < 0.1, "{what}: {amplitude:e}, {degrees} degrees");
}

#[test]
fn oracle_set_a_follows_the_frequency_domain_solve_from_0_1_to_13_hz() {
    let parameters = ParameterSet::A.parameters();
    let response = MembraneResponse::new(&parameters, BIAS_V).expect("taut");
    let spec = parameters.spec();
    // Periods of a whole number of steps.
    for hz in [0.1, 0.5, 1.0, 2.5, 5.0, 6.25, 10.0, 250.0 / 19.0] {
        let omega = 2.0 * PI * hz;
        let plain = measure(&parameters, FieldSetup::plain(&parameters), hz, 4e-3);
        let expected = response.displacement_mm_per_unit(omega).expect("regular");
        assert_phasor(plain.by_drive, expected, &format!("{hz} Hz by drive"));
    }
    // By membrane voltage the capacitance, constant there and deformable here, does not matter. The images of the held drive, at
    // multiples of 1/step, reach the voltage by 1/(R C omega): the step is short enough to hide them.
    for (hz, step_s) in [(0.5, 4e-3), (6.25, 0.5e-3), (250.0 / 19.0, 0.5e-3)] {
        let omega = 2.0 * PI * hz;
        let deformable = FieldSetup::deformable(&parameters).expect("taut");
        let deformable = measure(&parameters, deformable, hz, step_s);
        let expected = response.displacement_mm_per_unit(omega).expect("regular");
        let circuit = Complex::new(1.0, omega * spec.rc_s);
        assert_phasor(deformable.by_voltage, expected * circuit, &format!("{hz} Hz by voltage"));
    }
}

#[test]
fn oracle_fractional_branch_follows_the_frequency_domain_solve() {
    let parameters = ParameterSet::C.parameters();
    let branch = FractionalBranch { modulus_pa: 2e4, time_s: 0.01, exponent: 0.3 };
    let response = MembraneResponse::new(&parameters, BIAS_V).expect("taut").with_fractional(branch);
    let response = response.expect("valid");
    let mut setup = FieldSetup::plain(&parameters);
    setup.extra_branches = branch.maxwell_branches([1.0, 100.0]).expect("valid");
    let hz = 5.0;
    let found = measure(&parameters, setup, hz, 4e-3).by_drive;
    let expected = response.displacement_mm_per_unit(2.0 * PI * hz).expect("regular");
    // The ladder is good to 1e-3 of the branch, a tenth of the stiffness; its slow rungs have not settled after 3 s.
    assert_phasor(found, expected, "fractional");
}

/// Command of a pulse with three harmonics, V.
fn pulse(t: f64) -> f64 {
    let turn = 2.0 * PI * 1.25 * t;
    2500.0 - 1200.0 * turn.cos() + 700.0 * (2.0 * turn).sin() + 300.0 * (3.0 * turn).sin()
}

#[test]
fn law_energy_balances_over_a_cycle_of_the_elastic_membrane() {
    let parameters = ParameterSet::C.parameters();
    let mut setup = FieldSetup::deformable(&parameters).expect("taut");
    setup.tolerance = 1e-12;
    let mut twin = FieldTwin::with_setup(&parameters, 24, setup).expect("taut");
    twin.settle(pulse(0.0)).expect("taut");
    let before = twin.stored();
    let step_s = 1e-3;
    let mut traffic = 0.0;
    for k in 0..800 {
        let earlier = twin.flow().expect("a circuit of charges");
        twin.step(step_s, pulse((f64::from(k) + 0.5) * step_s)).expect("taut");
        let now = twin.flow().expect("a circuit of charges");
        traffic += (now.work_j() - earlier.work_j()).abs();
        let gained = twin.stored().total_j() - before.total_j();
        let missing = now.work_j() - now.dissipated_j() - gained;
        // Required: 1e-6 of the total. Stored: about 0.3 J; what goes to and fro: 0.05 J, the sharper measure.
        assert!(missing.abs() < 1e-6 * traffic, "step {k}: {missing:e} J of {traffic} J");
    }
    assert!(traffic > 0.01, "{traffic}");
}

#[test]
fn law_energy_balances_and_dissipation_never_falls_in_the_viscoelastic_membrane() {
    for set in [ParameterSet::A, ParameterSet::B] {
        let parameters = set.parameters();
        let setup = FieldSetup::deformable(&parameters).expect("taut");
        let mut twin = FieldTwin::with_setup(&parameters, 16, setup).expect("taut");
        let before = twin.stored();
        let (mut last, mut traffic) = (twin.flow().expect("a circuit of charges"), 0.0);
        for k in 0..400 {
            twin.step(4e-3, pulse((f64::from(k) + 0.5) * 4e-3)).expect("taut");
            let now = twin.flow().expect("a circuit of charges");
            // Positive weights times powers that are squares.
            for (earlier, later) in [
                (last.branches_j, now.branches_j),
                (last.damper_j, now.damper_j),
                (last.series_j, now.series_j),
            ] {
                assert!(later >= earlier, "{set:?}, step {k}: {earlier} {later}");
            }
            traffic += (now.work_j() - last.work_j()).abs();
            last = now;
        }
        assert!(last.branches_j > 0.0);
        let missing = last.work_j() - last.dissipated_j() - (twin.stored().total_j() - before.total_j());
        // Steps of 4 ms against 4.5 ms of the circuit: 0.9^6/7200 of what a jump of the held command moves.
        assert!(missing.abs() < 1e-4 * traffic, "{set:?}: {missing:e} of {traffic}");
    }
}

#[test]
fn law_halving_the_step_changes_little() {
    for set in [ParameterSet::A, ParameterSet::B] {
        let parameters = set.parameters();
        let mut coarse = FieldTwin::new(&parameters, 16).expect("taut");
        let mut fine = coarse.clone();
        for _ in 0..50 {
            coarse.step(4e-3, 5000.0).expect("taut");
            for _ in 0..4 {
                fine.step(1e-3, 5000.0).expect("taut");
            }
            // Order five: the coarse steps resolve the plate (0.15 rad), the circuit (0.9) and B's fast branch (0.16).
            assert_close(coarse.displacement_mm(), fine.displacement_mm(), 0.0, 2e-4, &format!("{set:?}"));
        }
    }
}

#[test]
fn regress_a_plate_at_rest_does_not_drift() {
    // Extrapolation from step to step once let the rounding of the clamped radii grow, to 0.1 mm in 10 s.
    let parameters = ParameterSet::C.parameters();
    let mut twin = FieldTwin::new(&parameters, 16).expect("taut");
    for _ in 0..2500 {
        twin.step(4e-3, 5000.0).expect("taut");
    }
    let moved_mm = twin.displacement_mm();
    twin.settle(5000.0).expect("taut");
    // The tolerance of 1e-9 of B is 3e-8 mm in each step; a stable plate forgets it within 0.1 s, 30 steps.
    assert_close(moved_mm, twin.displacement_mm(), 0.0, 1e-7, "at rest");
}

#[test]
fn law_plate_rests_on_a_load_cell_and_on_a_fingertip() {
    let light = ActuatorSpec { mass_kg: 0.02, ..ParameterSet::A.parameters().spec().clone() };
    let light = ActuatorParameters::new(light).expect("valid");
    let cell = PlateContact::SpringDamper { stiffness_n_per_m: 16e3, damping_n_s_per_m: 3.0, touch_mm: 0.2 };
    let finger = PlateContact::HuntCrossley {
        stiffness_n_per_m_p: 3e4,
        exponent: 1.5,
        dissipation_s_per_m: 2.0,
        touch_mm: 0.2,
    };
    for contact in [cell, finger] {
        let free = FieldTwin::new(&light, 16).expect("taut");
        let setup = FieldSetup { contact: Some(contact), ..FieldSetup::plain(&light) };
        let mut twin = FieldTwin::with_setup(&light, 16, setup).expect("taut");
        // The rest without contact is zero; the contact holds the plate below it.
        assert!(free.displacement_mm().abs() < 1e-9 && twin.displacement_mm() > 0.0);
        let balance = |twin: &FieldTwin| twin.membrane_force_n() - light.weight_n() - twin.contact_force_n();
        assert!(balance(&twin).abs() < 1e-9, "{contact:?}: {}", balance(&twin));
        let held = twin.contact_force_n();
        for _ in 0..500 {
            twin.step(4e-3, 2000.0).expect("taut");
        }
        // Voltage lowers the membrane's pull, so the contact carries less, and after 2 s all is nearly still.
        assert!(twin.contact_force_n() < held && twin.contact_force_n() >= 0.0);
        assert!(balance(&twin).abs() < 1e-4, "{contact:?}: {}", balance(&twin));
        twin.settle(0.0).expect("taut");
        assert_close(twin.contact_force_n(), held, 1e-9, 0.0, "settles where it began");
    }
}

#[test]
fn law_plate_that_strikes_a_fingertip_loses_energy_and_does_not_stick() {
    let parameters = ParameterSet::A.parameters();
    let contact = PlateContact::HuntCrossley {
        stiffness_n_per_m_p: 3e4,
        exponent: 1.5,
        dissipation_s_per_m: 5.0,
        touch_mm: -0.3,
    };
    let setup = FieldSetup { contact: Some(contact), ..FieldSetup::deformable(&parameters).expect("taut") };
    let mut twin = FieldTwin::with_setup(&parameters, 16, setup).expect("taut");
    // Pulled down by 0.2 N, then let go: the plate flies up into the fingertip.
    for _ in 0..500 {
        twin.step_with(1e-3, 0.0, 0.2).expect("taut");
    }
    let (mut largest, mut touched, mut left) = (0.0_f64, false, false);
    for _ in 0..500 {
        twin.step(1e-3, 0.0).expect("taut");
        let force = twin.contact_force_n();
        assert!(force >= 0.0);
        largest = largest.max(force);
        left |= touched && force == 0.0;
        touched |= force > 0.0;
    }
    assert!(touched && left && largest > 0.05, "{touched} {left} {largest}");
    // The contact took more than it gave.
    assert!(twin.flow().expect("a circuit of charges").contact_j < 0.0);
}

#[test]
fn law_amplifier_charges_at_its_current_limit_and_slews() {
    let parameters = ParameterSet::A.parameters();
    let mut setup = FieldSetup::deformable(&parameters).expect("taut");
    setup.amplifier = Amplifier { current_limit_a: 0.2e-3, ..Amplifier::ideal(5000.0) };
    let mut twin = FieldTwin::with_setup(&parameters, 16, setup.clone()).expect("taut");
    for _ in 0..5 {
        twin.step(4e-3, 5000.0).expect("taut");
        assert_close(twin.current_a(), 0.2e-3, 1e-12, 0.0, "at the limit");
    }
    // 0.2 mA for 20 ms: the charge is exact, whatever the membrane does.
    let charge = twin.capacitance_f() * twin.membrane_voltage_v();
    assert_close(charge, 0.2e-3 * 0.02, 1e-9, 0.0, "charge");
    setup.amplifier = Amplifier { slew_v_per_s: 2e4, time_constant_s: 1e-3, ..Amplifier::ideal(5000.0) };
    let mut twin = FieldTwin::with_setup(&parameters, 16, setup).expect("taut");
    for _ in 0..25 {
        twin.step(4e-3, 9000.0).expect("taut");
    }
    // 0.1 s of slewing at 20 kV/s; the command exceeds full scale and is cut there.
    assert_close(twin.amplifier_v(), 2000.0, 1e-9, 0.0, "slewing");
    for _ in 0..250 {
        twin.step(4e-3, 9000.0).expect("taut");
    }
    assert_close(twin.membrane_voltage_v(), 5000.0, 1e-6, 0.0, "saturated");
}

#[test]
fn law_stiffer_polymer_rises_and_the_change_does_work() {
    let parameters = ParameterSet::A.parameters();
    let setup = FieldSetup::deformable(&parameters).expect("taut");
    let mut twin = FieldTwin::with_setup(&parameters, 16, setup).expect("taut");
    twin.set_modulus_factor(1.1).expect("positive");
    assert!(twin.flow().expect("a circuit of charges").ageing_j > 0.0);
    for _ in 0..1000 {
        twin.step(4e-3, 0.0).expect("taut");
    }
    let aged = ActuatorSpec { mu_pa: 1.1 * parameters.spec().mu_pa, ..parameters.spec().clone() };
    let aged = ActuatorParameters::new(aged).expect("valid");
    let aged = FieldTwin::new(&aged, 16).expect("taut").point().displacement_m * 1e3;
    let young = FieldTwin::new(&parameters, 16).expect("taut").point().displacement_m * 1e3;
    // Its branches creep for minutes: 4 s leave 4 % of a change that they hold back by 7 %.
    assert_close(twin.displacement_mm(), aged - young, 0.05, 0.0, "rest of the aged membrane");
    assert!(matches!(twin.set_modulus_factor(0.0), Err(Error::Request { quantity: "modulus factor", .. })));
}

#[test]
fn edge_bad_steps_are_refused_and_pull_in_is_named() {
    let parameters = ParameterSet::A.parameters();
    let mut twin = FieldTwin::new(&parameters, 16).expect("taut");
    for (step_s, drive_v, expected) in
        [(0.0, 0.0, "step_s"), (f64::NAN, 0.0, "step_s"), (1e-3, f64::NAN, "drive_v")]
    {
        match twin.step(step_s, drive_v) {
            Err(Error::Request { quantity, .. }) => assert_eq!(quantity, expected),
            other => panic!("{other:?}"),
        }
    }
    assert_eq!(twin.time_s(), 0.0);
    // 14 kV is far beyond the limit point of about 10.8 kV.
    let setup = FieldSetup { amplifier: Amplifier::ideal(14_000.0), ..FieldSetup::plain(&parameters) };
    let mut twin = FieldTwin::with_setup(&parameters, 16, setup).expect("taut");
    let error = (0..1000).find_map(|_| twin.step(4e-3, 14_000.0).err());
    assert!(matches!(error, Some(Error::PullIn { .. } | Error::NotConverged { .. })), "{error:?}");
    assert!(twin.displacement_mm().is_finite() && twin.point().s2_min_pa < 0.0);
}
