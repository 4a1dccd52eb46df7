//! Membrane statics.

use serde::Deserialize;
use telepulse_actuator::membrane::{Dashpots, Load, Membrane, Network};
use telepulse_actuator::{
    ActuatorParameters, ActuatorSpec, Error, ParameterSet, VACUUM_PERMITTIVITY_F_PER_M,
};

use crate::{assert_close, uniform};

#[derive(Deserialize)]
struct Stored {
    sets: Vec<SetCase>,
    dimensionless: Vec<crate::statics::Case>,
}

#[derive(Deserialize)]
struct SetCase {
    set: ParameterSet,
    voltage_v: f64,
    displacement_mm: f64,
    capacitance_nf: f64,
    theta_inner_rad: f64,
    lambda1_inner: f64,
    s2_min_pa: f64,
    field_max_mv_per_m: f64,
    stiffness_relaxed_n_per_m: f64,
    dforce_dvoltage_relaxed_n_per_v: f64,
    gain_relaxed_mm_per_unit: f64,
    stiffness_frozen_n_per_m: f64,
    f3_m_per_s2_v: f64,
    gain_frozen_mm_per_unit: f64,
    instant_from_rest_mm: f64,
}

fn stored() -> Stored {
    // Other methods' solutions; the file says how they were made.
    let text = include_str!("../../../../testdata/actuator/membrane_static.json");
    serde_json::from_str(text).expect("stored cases")
}

#[test]
fn oracle_equilibria_of_sets_a_b_c() {
    for case in stored().sets {
        let parameters = case.set.parameters();
        let membrane = Membrane::new(&parameters).expect("valid");
        let state = membrane.rest(case.voltage_v).expect("below the limit point");
        let what = |name: &str| format!("{:?} at {} V: {name}", case.set, case.voltage_v);
        // The stored states carry a discretisation error of 1e-10 mm; local fields at n = 24 one of 4e-10 relative.
        assert_close(state.displacement_m() * 1e3, case.displacement_mm, 1e-10, 0.0, &what("displacement"));
        assert_close(state.theta_inner_rad(), case.theta_inner_rad, 1e-9, 0.0, &what("theta"));
        assert_close(state.lambda1_inner(), case.lambda1_inner, 1e-9, 0.0, &what("lambda1"));
        assert_close(state.capacitance_f() * 1e9, case.capacitance_nf, 1e-10, 0.0, &what("capacitance"));
        // The stored minimum is one over 25 nodes, ours one between them too.
        assert_close(state.s2_min_pa(), case.s2_min_pa, 2e-6, 0.0, &what("s2_min"));
        assert_close(state.field_max_v_per_m() * 1e-6, case.field_max_mv_per_m, 1e-9, 1e-12, &what("field"));
        // An equilibrium solved for force must carry it.
        assert_close(state.force_n(), parameters.weight_n(), 1e-12, 0.0, &what("force"));

        let relaxed = membrane.tangent(&state, Network::Relaxed).expect("regular");
        let frozen = membrane.tangent(&state, Network::Frozen).expect("regular");
        assert_close(
            relaxed.stiffness_n_per_m,
            case.stiffness_relaxed_n_per_m,
            1e-9,
            0.0,
            &what("stiffness"),
        );
        assert_close(
            frozen.stiffness_n_per_m,
            case.stiffness_frozen_n_per_m,
            1e-8,
            0.0,
            &what("frozen stiffness"),
        );
        assert_close(
            relaxed.dforce_dvoltage_n_per_v,
            case.dforce_dvoltage_relaxed_n_per_v,
            1e-9,
            1e-18,
            &what("dF/dV"),
        );
        let per_unit = 5000.0 * 1e3;
        // The stored frozen gain has about 9 digits.
        assert_close(
            relaxed.gain_m_per_v() * per_unit,
            case.gain_relaxed_mm_per_unit,
            1e-8,
            1e-12,
            &what("gain"),
        );
        assert_close(
            frozen.gain_m_per_v() * per_unit,
            case.gain_frozen_mm_per_unit,
            1e-8,
            1e-12,
            &what("frozen gain"),
        );
        assert_close(
            -frozen.dforce_dvoltage_n_per_v / parameters.spec().mass_kg,
            case.f3_m_per_s2_v,
            1e-8,
            1e-15,
            &what("f3"),
        );

        // All dashpots held where they stand at rest: the instant response.
        let rest = membrane.rest(0.0).expect("rest");
        let held = Dashpots::relaxed_at(&membrane, &rest);
        let instant =
            membrane.solve(Load::ForceN(parameters.weight_n()), case.voltage_v, &held).expect("stable");
        assert_close(
            (instant.displacement_m() - rest.displacement_m()) * 1e3,
            case.instant_from_rest_mm,
            1e-8,
            1e-9,
            &what("instant response"),
        );
    }
}

#[test]
fn oracle_dimensionless_neo_hookean_cases() {
    // Any length, modulus and thickness must do: these are not the paper's.
    let (outer, mu, thickness, permittivity) = (0.05, 1.0e5, 2.0e-4, 3.0);
    for case in stored().dimensionless {
        let parameters = ActuatorParameters::new(ActuatorSpec {
            mu_pa: mu,
            gent_limit: None,
            branches: Vec::new(),
            relative_permittivity: permittivity,
            inner_radius_m: case.prestretch * case.A_over_B * outer,
            outer_radius_m: case.prestretch * outer,
            thickness_m: thickness,
            prestretch: case.prestretch,
            ..ParameterSet::C.parameters().spec().clone()
        })
        .expect("valid");
        // A tenth of the outer radius inside needs more nodes than the built-in geometry.
        let membrane = Membrane::with_degree(&parameters, 40).expect("valid degree");
        let force_scale = 2.0 * std::f64::consts::PI * mu * thickness * outer;
        let voltage_v = case.v * thickness * (mu / (permittivity * VACUUM_PERMITTIVITY_F_PER_M)).sqrt();
        let state = membrane.solve_at_force(case.f * force_scale, voltage_v).expect("stable");
        let last = state.lambda1().len() - 1;
        let found = [
            ("u/B", state.displacement_m() / outer, case.u_over_B),
            ("lambda1 inner", state.lambda1()[0], case.lambda1_inner),
            ("lambda1 outer", state.lambda1()[last], case.lambda1_outer),
            ("theta inner", state.theta_rad()[0], case.theta_inner),
            ("theta outer", state.theta_rad()[last], case.theta_outer),
            ("s1 inner", state.s1_pa()[0] / mu, case.s1_inner),
            ("s1 outer", state.s1_pa()[last] / mu, case.s1_outer),
            ("s2 inner", state.s2_pa()[0] / mu, case.s2_inner),
            ("s2 outer", state.s2_pa()[last] / mu, case.s2_outer),
        ];
        for (name, value, expected) in found {
            assert_close(value, expected, 1e-9, 0.0, &format!("{name} at f = {}, v = {}", case.f, case.v));
        }
        let stiffness = membrane.tangent(&state, Network::Relaxed).expect("regular").stiffness_n_per_m;
        // The stored compliance has about 8 digits.
        assert_close(force_scale / outer / stiffness, case.compliance_du_df, 1e-7, 0.0, "compliance");
    }
}

#[test]
fn law_tangent_is_the_difference_of_neighbouring_states_and_voltage_work_is_symmetric() {
    let seed = 20_170_728_u64;
    let mut random = seed;
    for _ in 0..20 {
        let parameters = ParameterSet::B.parameters();
        let membrane = Membrane::new(&parameters).expect("valid");
        let x = 4e-3 + 9e-3 * uniform(&mut random);
        let voltage_v = 500.0 + 5000.0 * uniform(&mut random);
        let at = |dx: f64, dv: f64| membrane.solve_at_displacement(x + dx, voltage_v + dv).expect("solvable");
        let state = at(0.0, 0.0);
        let tangent = membrane.tangent(&state, Network::Relaxed).expect("regular");
        let (hx, hv) = (1e-6, 1.0);
        let stiffness = (at(hx, 0.0).force_n() - at(-hx, 0.0).force_n()) / (2.0 * hx);
        let by_voltage = (at(0.0, hv).force_n() - at(0.0, -hv).force_n()) / (2.0 * hv);
        // Central differences: relative step 1e-4 squared, and rounding 1e-13/1e-4.
        assert_close(tangent.stiffness_n_per_m, stiffness, 1e-6, 0.0, &format!("dF/dx, seed {seed}"));
        assert_close(tangent.dforce_dvoltage_n_per_v, by_voltage, 1e-6, 0.0, &format!("dF/dV, seed {seed}"));
        // One potential: dF/dV = -dQ/dx with Q = C V at held voltage.
        let charge_by_x =
            voltage_v * (at(hx, 0.0).capacitance_f() - at(-hx, 0.0).capacitance_f()) / (2.0 * hx);
        assert_close(
            -charge_by_x,
            tangent.dforce_dvoltage_n_per_v,
            1e-5,
            0.0,
            &format!("Maxwell, seed {seed}"),
        );
    }
}

#[test]
fn law_force_is_odd_in_displacement_and_refining_changes_nothing() {
    let parameters = ParameterSet::A.parameters();
    let coarse = Membrane::with_degree(&parameters, 24).expect("valid");
    let fine = Membrane::with_degree(&parameters, 40).expect("valid");
    for (x, voltage_v) in [(1e-3, 0.0), (7e-3, 3000.0), (15e-3, 5000.0)] {
        let down = coarse.solve_at_displacement(x, voltage_v).expect("solvable");
        let up = coarse.solve_at_displacement(-x, voltage_v).expect("solvable");
        assert_close(up.force_n(), -down.force_n(), 1e-11, 0.0, "odd force");
        let check = fine.solve_at_displacement(x, voltage_v).expect("solvable");
        assert_close(down.force_n(), check.force_n(), 1e-9, 0.0, "refined force");
    }
    let flat = coarse.solve_at_displacement(0.0, 1000.0).expect("solvable");
    assert!(flat.force_n().abs() < 1e-14, "a flat membrane pulls neither way: {}", flat.force_n());
}

#[test]
fn oracle_loss_of_tension_and_limit_point_of_set_a() {
    let membrane = Membrane::new(&ParameterSet::A.parameters()).expect("valid");
    // Stored on a 50 V grid by another solver: loss of tension at 10250 V, limit point under dead load near 10800 V.
    assert!(membrane.rest(10_200.0).expect("taut").require_taut().is_ok());
    let slack = membrane.rest(10_300.0).expect("still an equilibrium");
    match slack.require_taut() {
        Err(Error::Slack { s2_min_pa, .. }) => assert!(s2_min_pa <= 0.0),
        other => panic!("{other:?}"),
    }
    assert!(membrane.rest(10_700.0).is_ok());
    match membrane.rest(11_000.0) {
        Err(Error::BeyondLimitPoint { reached_voltage_v, stiffness_n_per_m, .. }) => {
            assert!((10_700.0..10_900.0).contains(&reached_voltage_v), "{reached_voltage_v}");
            // The reason names the limit point itself, found to 1e-9 of B.
            assert!(stiffness_n_per_m.abs() < 1e-3, "{stiffness_n_per_m}");
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn edge_impossible_requests_get_a_typed_reason() {
    let membrane = Membrane::new(&ParameterSet::A.parameters()).expect("valid");
    assert!(matches!(membrane.rest(f64::NAN), Err(Error::Request { quantity: "voltage_v", .. })));
    assert!(matches!(membrane.rest(-1.0), Err(Error::Request { quantity: "voltage_v", .. })));
    assert!(matches!(
        membrane.solve_at_force(f64::INFINITY, 0.0),
        Err(Error::Request { quantity: "force_n", .. })
    ));
    let tight = ActuatorParameters::new(ActuatorSpec {
        gent_limit: Some(6.0),
        ..ParameterSet::C.parameters().spec().clone()
    })
    .expect("above the pre-stretch");
    match Membrane::new(&tight).expect("valid").solve_at_displacement(0.2, 0.0) {
        Err(Error::GentLimit { invariant, gent_limit }) => {
            assert!(invariant > 0.95 * 6.0 && invariant < 6.0);
            assert_eq!(gent_limit, 6.0);
        }
        other => panic!("{other:?}"),
    }
    assert!(matches!(Membrane::with_degree(&tight, 3), Err(Error::CollocationDegree { found: 3, .. })));
}
