//! The paper's printed equations of the membrane, put to solved states: what holds, and what does not.

use std::f64::consts::PI;

use telepulse_actuator::linearize::linearize;
use telepulse_actuator::statics::{
    Electrodes, Load, Material, Prestretch, Sheet, SheetSpec, Solution, solve,
};
use telepulse_actuator::{Error, ParameterSet};

use crate::assert_close;

const WEIGHT_N: f64 = 0.980_665;
const MU_PA: f64 = 38_635.0;
const PRESTRETCH: f64 = 2.0;

/// Set C with a neo-Hookean network, as the paper's equations assume.
fn sheet() -> Sheet {
    Sheet::new(SheetSpec {
        material: Material::NeoHookean { mu_pa: MU_PA },
        inner_radius_m: 0.0127,
        outer_radius_m: 0.068_58,
        thickness_m: 1e-3,
        prestretch_inner: PRESTRETCH,
        prestretch_outer: PRESTRETCH,
        prestretch: Prestretch::AtLeastOne,
        relative_permittivity: 6.0109,
    })
    .expect("valid")
}

fn at(load: Load, voltage_v: f64) -> Solution {
    solve(&sheet(), load, Electrodes::VoltageV(voltage_v)).expect("taut and stable")
}

/// d(values)/dR of the polynomial in ln R through the nodes.
fn by_radius(radius: &[f64], values: &[f64]) -> Vec<f64> {
    let u: Vec<f64> = radius.iter().map(|r| r.ln()).collect();
    let weight =
        |i: usize| -> f64 { (0..u.len()).filter(|j| *j != i).map(|j| 1.0 / (u[i] - u[j])).product() };
    let weights: Vec<f64> = (0..u.len()).map(weight).collect();
    (0..u.len())
        .map(|i| {
            let others = (0..u.len()).filter(|j| *j != i);
            let sum: f64 =
                others.map(|j| weights[j] / weights[i] / (u[i] - u[j]) * (values[j] - values[i])).sum();
            sum / radius[i]
        })
        .collect()
}

#[test]
fn paper_eq1_and_eq2_hold_along_the_radius() {
    let found = at(Load::ForceN(WEIGHT_N), 2500.0).profile;
    let radius = &found.radius_undeformed_m;
    let dr = by_radius(radius, &found.r_m);
    let dtheta = by_radius(radius, &found.theta_rad);
    for i in 0..radius.len() {
        // Differentiating 25 nodes costs three to four digits of the solver's twelve.
        assert_close(dr[i], found.lambda1[i] * found.theta_rad[i].cos(), 1e-8, 0.0, "Eq. (1)");
        let slope = -found.s2_pa[i] / (found.s1_pa[i] * radius[i]) * found.theta_rad[i].sin();
        assert_close(dtheta[i], slope, 1e-6, 0.0, "Eq. (2)");
    }
}

#[test]
fn paper_eq3_holds_in_dimensionless_groups() {
    let sheet = sheet();
    let voltage_v: f64 = 2500.0;
    let found = at(Load::ForceN(WEIGHT_N), voltage_v).profile;
    let v2 = sheet.field_scale_per_v2() * voltage_v * voltage_v;
    let f = WEIGHT_N / sheet.force_scale_n();
    for i in 0..found.r_m.len() {
        let (l1, l2) = (found.lambda1[i], found.lambda2[i]);
        let rho = found.radius_undeformed_m[i] / sheet.length_scale_m();
        let residual = (1.0 - v2 * l2 * l2) * l1.powi(4)
            - f / (rho * found.theta_rad[i].sin()) * l1.powi(3)
            - 1.0 / (l2 * l2);
        // Terms of order 10, solved to 1e-12.
        assert_close(residual, 0.0, 0.0, 1e-9, "Eq. (3)");
    }
}

/// The bracket of (4) at radius R = B, where r = b: R sin(theta) ((1 - (v r/R)^2) l1 - (R/r)^2/l1^3), m.
fn bracket(found: &Solution, voltage_v: f64) -> f64 {
    let sheet = sheet();
    let v2 = sheet.field_scale_per_v2() * voltage_v * voltage_v;
    let (l1, theta) = (found.lambda1_outer(), found.theta_outer_rad());
    let l2 = PRESTRETCH;
    sheet.length_scale_m() * theta.sin() * ((1.0 - v2 * l2 * l2) * l1 - 1.0 / (l2 * l2 * l1.powi(3)))
}

#[test]
fn paper_eq4_lacks_weight_sign_and_scale() {
    let found = at(Load::ForceN(WEIGHT_N), 2500.0);
    let printed = bracket(&found, 2500.0);
    // As printed, (5) and (7) alike, it is the acceleration times m: positive, away from the frame, and never balanced by a weight.
    assert!(printed > 0.0);
    // Times 2 pi mu H it is the force that carries m g.
    assert_close(2.0 * PI * MU_PA * 1e-3 * printed, WEIGHT_N, 1e-9, 0.0, "corrected (4) at rest");
}

#[test]
fn paper_eq8_has_no_input_and_one_stiffness_for_all_voltages() {
    let [idle, driven] = [0.0, 5000.0].map(|v| at(Load::ForceN(WEIGHT_N), v));
    // (8) puts the plate at m g/k whatever the voltage; the membrane sinks by about 1 mm and softens by more than a tenth.
    assert!(driven.point.displacement_m - idle.point.displacement_m > 0.8e-3);
    let ratio = driven.derivatives.stiffness_n_per_m / idle.derivatives.stiffness_n_per_m;
    assert!(ratio < 0.9, "{ratio}");
}

#[test]
fn paper_eq9_evaluates_at_a_radius_outside_of_the_sheet() {
    let found = at(Load::ForceN(WEIGHT_N), 0.0);
    let largest = found.profile.radius_undeformed_m.iter().copied().fold(0.0, f64::max);
    // R = b = lp B: twice the largest reference radius.
    assert_close(largest, 0.068_58 / PRESTRETCH, 1e-12, 0.0, "B");
}

#[test]
fn paper_eq11_needs_the_sheets_own_radius_and_the_other_sign() {
    let (voltage_v, mass_kg, h) = (2500.0, 0.1, 1e-5);
    let middle = at(Load::ForceN(WEIGHT_N), voltage_v);
    let x = middle.point.displacement_m;
    let [low, high] = [x - h, x + h].map(|x| at(Load::DisplacementM(x), voltage_v));
    let dtheta = (high.theta_outer_rad() - low.theta_outer_rad()) / (2.0 * h);
    let dl1 = (high.lambda1_outer() - low.lambda1_outer()) / (2.0 * h);
    let sheet = sheet();
    let v2 = sheet.field_scale_per_v2() * voltage_v * voltage_v;
    let (l1, theta) = (middle.lambda1_outer(), middle.theta_outer_rad());
    let scale = 2.0 * PI * MU_PA * 1e-3 / mass_kg;
    // Both forms are R (1 - v^2 l2^2)(l1 cos(theta) theta' + sin(theta) l1') - (R/l2^2)(cos(theta) theta'/l1^3 - 3 sin(theta) l1'/l1^4).
    let form = |radius: f64, l2: f64| {
        radius * (1.0 - v2 * l2 * l2) * (l1 * theta.cos() * dtheta + theta.sin() * dl1)
            - radius / (l2 * l2) * (theta.cos() * dtheta / l1.powi(3) - 3.0 * theta.sin() * dl1 / l1.powi(4))
    };
    let exact = -middle.derivatives.stiffness_n_per_m / mass_kg;
    // Central differences over 20 um leave 1e-7.
    assert_close(-scale * form(sheet.length_scale_m(), PRESTRETCH), exact, 1e-5, 0.0, "corrected (11)");
    // R = r = b, as printed: positive, and nearly twice as large, even with the last term mended, ...
    let printed = scale * form(0.068_58, 1.0);
    assert_close(
        printed / exact,
        -1.958,
        1e-3,
        0.0,
        "printed (11) with its last term mended, over the exact one",
    );
    // ... which has theta' where sin(theta) l1' belongs.
    let slip = scale * 3.0 * 0.068_58 / l1.powi(4) * (dtheta - theta.sin() * dl1);
    let literal = (printed + slip) / exact;
    assert!(literal < -1.958, "{literal}");
}

#[test]
fn paper_eq12_is_the_external_damping_and_eq13_is_positive_and_zero_without_bias() {
    let parameters = ParameterSet::C.parameters();
    let found = linearize(&parameters, 2500.0).expect("a bias");
    let spec = parameters.spec();
    assert_close(found.f2_per_s, -spec.damping_n_s_per_m / spec.mass_kg, 1e-12, 0.0, "f2");
    // Stored to five digits.
    assert_close(found.f3_m_per_s2_v, 2.7003e-4, 1e-4, 0.0, "f3");
    let smaller = linearize(&parameters, 25.0).expect("a bias").f3_m_per_s2_v;
    // Proportional to the bias but for the softening: a hundredth at a hundredth.
    assert!(smaller > 0.0 && smaller < 0.011 * found.f3_m_per_s2_v, "{smaller}");
    assert!(matches!(linearize(&parameters, 0.0), Err(Error::ZeroBias { .. })));
}
