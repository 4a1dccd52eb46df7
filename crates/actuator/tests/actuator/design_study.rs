//! Design study: margins hold, ends are what they say, scaling laws.

use telepulse_actuator::design_study::{
    DesignVariable, EndOfStroke, StudyLimits, evaluate, source_resistance_ohm,
};
use telepulse_actuator::failure::{BreakdownLaw, Envelope, FailureCriteria, Mechanism};
use telepulse_actuator::statics::{Electrodes, Load, StaticSolver};
use telepulse_actuator::{ActuatorParameters, ActuatorSpec, Error, ParameterSet};

use crate::assert_close;

const WIDE: StudyLimits = StudyLimits { amplifier_v: 20_000.0, field_v_per_m: 1e12, voltage_margin: 1.25 };

#[test]
fn law_end_of_stroke_is_where_the_margin_is_used_up() {
    let base = ParameterSet::A.parameters();
    let source = source_resistance_ohm(&base).expect("solvable");
    // device_examples.json: 1.5168 MOhm.
    assert_close(source, 1.516_756_342_7e6, 1e-9, 0.0, "source resistance");
    let found = evaluate(&base, &[], &[], WIDE, source).expect("borne");
    // Loss of tension at about 10.25 kV (50 V grid), over the margin.
    assert_eq!(found.ended_by, EndOfStroke::LossOfTension);
    assert_close(found.voltage_v * 1.25, 10_250.0, 0.0, 60.0, "loss of tension");
    let mut solver = StaticSolver::new(&base.sheet().expect("valid")).expect("valid");
    let mut at = |v: f64| solver.solve(Load::ForceN(base.weight_n()), Electrodes::VoltageV(v));
    assert!(at(found.voltage_v * 1.25 * (1.0 - 1e-5)).is_ok());
    assert!(matches!(at(found.voltage_v * 1.25 * (1.0 + 1e-5)), Err(Error::Slack { .. })));
    let stroke = at(found.voltage_v).expect("taut").displacement_m - at(0.0).expect("taut").displacement_m;
    assert_close(found.stroke_mm, stroke * 1e3, 1e-9, 0.0, "stroke");
    // Half of that field allowed: the field ends the stroke, at that field.
    let limits = StudyLimits { field_v_per_m: 0.5 * found.field_v_per_m, ..WIDE };
    let less = evaluate(&base, &[], &[], limits, source).expect("borne");
    assert_eq!(less.ended_by, EndOfStroke::Field);
    assert_close(less.field_v_per_m, limits.field_v_per_m, 1e-5, 0.0, "field");
    assert!(less.stroke_mm < 0.5 * found.stroke_mm);
}

#[test]
fn paper_eq16_set_c_has_its_printed_bandwidth_at_half_scale() {
    // At sqrt(1/2) of the largest voltage the study looks at the bias: 2.5 kV of 3535.5 V.
    let base = ParameterSet::C.parameters();
    let limits =
        StudyLimits { amplifier_v: 2500.0 * 2.0_f64.sqrt(), field_v_per_m: 1e9, voltage_margin: 1.0 };
    let source = source_resistance_ohm(&base).expect("solvable");
    let found = evaluate(&base, &[], &[], limits, source).expect("borne");
    assert_eq!(found.ended_by, EndOfStroke::Amplifier);
    // (16) is at -3 dB at 9.01 Hz, printed to three digits.
    assert_close(found.bandwidth_hz, 9.01, 0.0, 0.006, "bandwidth");
}

#[test]
fn law_thickness_scales_force_and_voltage_together() {
    // With load, damping and thickness in one proportion k, statics repeat at k times the voltage; the plate's motion too.
    let base = ParameterSet::A.parameters();
    let spec = base.spec();
    let twice = ActuatorSpec {
        thickness_m: 2.0 * spec.thickness_m,
        mass_kg: 2.0 * spec.mass_kg,
        damping_n_s_per_m: 2.0 * spec.damping_n_s_per_m,
        ..spec.clone()
    };
    let twice = ActuatorParameters::new(twice).expect("valid");
    let limits = |k: f64| StudyLimits { amplifier_v: 6000.0 * k, field_v_per_m: 30e6, voltage_margin: 1.5 };
    let source = source_resistance_ohm(&base).expect("solvable");
    let one = evaluate(&base, &[], &[], limits(1.0), source).expect("borne");
    // Half the capacitance, twice the resistance.
    let other = evaluate(&twice, &[], &[], limits(2.0), 2.0 * source).expect("borne");
    assert_close(other.voltage_v, 2.0 * one.voltage_v, 1e-9, 0.0, "voltage");
    assert_close(other.stroke_mm, one.stroke_mm, 1e-9, 0.0, "stroke");
    assert_close(other.bandwidth_hz, one.bandwidth_hz, 1e-5, 0.0, "bandwidth");
}

#[test]
fn edge_variants_that_are_none_say_why() {
    let base = ParameterSet::A.parameters();
    let source = source_resistance_ohm(&base).expect("solvable");
    let with = |variable, value| evaluate(&base, &[variable], &[value], WIDE, source);
    let wide = with(DesignVariable::InnerRadius, 0.07);
    assert!(matches!(wide, Err(Error::Parameter { key: "inner_radius_m", .. })), "{wide:?}");
    let slack = with(DesignVariable::Prestretch, 0.9);
    assert!(matches!(slack, Err(Error::Parameter { key: "prestretch", .. })), "{slack:?}");
    let heavy = with(DesignVariable::Mass, 500.0);
    assert!(heavy.is_err(), "{heavy:?}");
    let margin = StudyLimits { voltage_margin: 0.5, ..WIDE };
    let unsafe_margin = evaluate(&base, &[], &[], margin, source);
    assert!(matches!(unsafe_margin, Err(Error::Parameter { key: "voltage_margin", .. })));
}

#[test]
fn law_a_stroke_ends_where_the_failure_envelope_has_its_lowest_limit() {
    let base = ParameterSet::A.parameters();
    let source = source_resistance_ohm(&base).expect("solvable");
    for (prestretch, thickness_m, field_v_per_m) in
        [(1.5, 1e-3, 35e6), (2.0, 1e-3, 35e6), (2.0, 1e-3, 1e9), (3.0, 0.7e-3, 35e6), (1.25, 1e-3, 1e9)]
    {
        let spec = ActuatorSpec { prestretch, thickness_m, ..base.spec().clone() };
        let parameters = ActuatorParameters::new(spec).expect("valid");
        let limits = StudyLimits { amplifier_v: 12_000.0, field_v_per_m, voltage_margin: 1.25 };
        let found = evaluate(&parameters, &[], &[], limits, source).expect("borne");
        let law = BreakdownLaw::constant(field_v_per_m).expect("positive");
        let criteria = FailureCriteria::default().with_breakdown(law);
        let ends = Envelope::new(&parameters.sheet().expect("valid"), criteria)
            .and_then(|mut envelope| envelope.voltage_limits(parameters.weight_n()))
            .expect("borne");
        let over_margin = [Mechanism::LossOfTension, Mechanism::PullIn, Mechanism::LimitPoint]
            .into_iter()
            .filter_map(|mechanism| ends.of(mechanism))
            .fold(f64::INFINITY, f64::min)
            / limits.voltage_margin;
        let field = ends.of(Mechanism::Breakdown).unwrap_or(f64::INFINITY);
        let lowest = limits.amplifier_v.min(over_margin).min(field);
        // The study halves the amplifier's 12 kV twenty times: 0.012 V.
        let what = format!("pre-stretch {prestretch}, {thickness_m} m, {field_v_per_m} V/m");
        assert_close(found.voltage_v, lowest, 0.0, 0.03, &what);
    }
}
