//! Certificates of the printed loop: every number that the paper prints or implies.

use crate::printed;
use telepulse_design::Error;
use telepulse_design::verify::{Certificate, LoopUnderTest, verify};
use telepulse_lti::{TransferFunction, hinf_norm};

fn printed_certificate(filter: Option<&TransferFunction>) -> Certificate {
    let (plant, bound) = (printed::g(), printed::ws());
    let controller = printed::k().to_state_space();
    verify(&LoopUnderTest {
        plant: &plant,
        controller: &controller,
        bound: &bound,
        measurement_filter: filter,
    })
    .expect("the printed loop is stable")
}

#[track_caller]
fn close(found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() <= tolerance, "found {found}, expected {expected} within {tolerance}");
}

#[test]
fn paper_eq16_poles_gain_and_resonance() {
    let g = printed::g();
    close(g.dc_gain().expect("no pole at zero"), 0.935, 1e-5);
    let mut poles = g.poles().expect("qr");
    poles.sort_by(|a, b| a.re.total_cmp(&b.re));
    close(poles[0].re, -222.222, 1e-3);
    let pair = poles[1];
    close(pair.re, -7.98, 1e-9);
    close(pair.im.abs(), 37.1527, 1e-4);
    // omega_n 38.00 rad/s and zeta 0.2100
    close(pair.norm(), 38.0, 1e-9);
    close(-pair.re / pair.norm(), 0.21, 1e-9);
}

#[test]
fn paper_eq22_norm_of_ms() {
    let c = printed_certificate(None);
    // Printed 1.7687; the printed coefficients, rounded to four decimals, give 1.76890.
    close(c.norm_ms.value, 1.768897693, 1e-8);
    close(c.norm_ms.value, 1.7687, 3e-4);
    close(c.norm_ms.omega_rad_s, 73.65, 5e-3);
}

#[test]
fn paper_eq17_norm_of_ws_and_eq24_small_gain() {
    let c = printed_certificate(None);
    close(c.norm_ws.value, 0.242620088, 1e-9);
    close(c.norm_ws.omega_rad_s, 38.57, 5e-3);
    // 1 / 0.2426 = 4.12: printed 4.1218 from the unrounded norm.
    close(c.small_gain_limit, 4.1218, 2e-4);
    assert!(c.norm_test_passes && c.frequency_wise_passes && c.holds());
    // Not printed: norm product 0.429, frequency by frequency 0.209.
    close(c.norm_ms.value * c.norm_ws.value, 0.429, 5e-4);
    close(c.frequency_wise.value, 0.209, 5e-4);
}

#[test]
fn paper_printed_loop_poles_margins_and_peaks() {
    let c = printed_certificate(None);
    let mut real: Vec<f64> = c.closed_loop_poles.iter().filter(|p| p.im == 0.0).map(|p| p.re).collect();
    real.sort_by(f64::total_cmp);
    assert_eq!(real.len(), 2);
    close(real[0], -221.48, 5e-3);
    close(real[1], -12.496, 5e-4);
    let mut pairs: Vec<_> = c.closed_loop_poles.iter().filter(|p| p.im > 0.0).collect();
    pairs.sort_by(|a, b| a.re.total_cmp(&b.re));
    for (pair, (re, im)) in pairs.into_iter().zip([(-6.892, 73.226), (-3.969, 40.154)]) {
        close(pair.re, re, 5e-4);
        close(pair.im, im, 5e-4);
    }
    close(c.gain_margin.expect("one crossing").factor, 3.17, 5e-3);
    close(c.gain_margin.expect("one crossing").omega_rad_s, 64.75, 5e-3);
    // |L| = 1 once, at 14.73 rad/s, where the phase of L is -93.59 degrees.
    close(c.phase_margin.expect("one crossing").degrees, 86.41, 5e-3);
    close(c.phase_margin.expect("one crossing").omega_rad_s, 14.73, 5e-3);
    close(c.peak_s.value, 2.264, 5e-4);
    close(c.peak_s.omega_rad_s / std::f64::consts::TAU, 6.53, 5e-3);
    close(c.peak_t.value, 1.532, 5e-4);
    close(c.peak_t.omega_rad_s / std::f64::consts::TAU, 6.34, 5e-3);
    close(c.bandwidth_hz.expect("falls off"), 2.61, 5e-3);
}

#[test]
fn paper_printed_loop_with_the_filter_of_eq26() {
    let filter = printed::filter();
    let c = printed_certificate(Some(&filter));
    close(c.gain_margin.expect("crosses").factor, 1.65, 5e-3);
    let slowest = c.closed_loop_poles.iter().max_by(|a, b| a.re.total_cmp(&b.re)).expect("has poles");
    close(slowest.re, -2.884, 5e-4);
    close(slowest.im.abs(), 38.80, 5e-3);
    // The margin is true: a loop with 1.66 times the gain is unstable, with 1.64 times it is not.
    for (factor, stable) in [(1.64, true), (1.66, false)] {
        let plant = printed::g().scale(factor).expect("finite");
        let (controller, bound) = (printed::k().to_state_space(), printed::ws());
        let result = verify(&LoopUnderTest {
            plant: &plant,
            controller: &controller,
            bound: &bound,
            measurement_filter: Some(&filter),
        });
        assert_eq!(result.is_ok(), stable, "{factor}");
    }
}

#[test]
fn paper_printed_k_in_the_weights_of_eqs_19_and_20() {
    let g = printed::g();
    let k = printed::k();
    let loop_ = g.multiply(&k).expect("proper");
    let one = TransferFunction::from_gain(1.0).expect("finite");
    let s = one.feedback(&loop_).expect("well-posed");
    let ks = k.feedback(&g).expect("well-posed");
    let we_s = printed::we().multiply(&s).expect("proper");
    let wu_ks = printed::wu().multiply(&ks).expect("proper");
    close(hinf_norm(&we_s.to_state_space()).expect("stable").value, 0.5706, 5e-5);
    close(hinf_norm(&wu_ks.to_state_space()).expect("stable").value, 0.2083, 5e-5);
    // Stacked, through the generalized plant and another route to the closed loop.
    let stacked = printed::generalized_plant().lower_lft(&k.to_state_space()).expect("well-posed");
    close(hinf_norm(&stacked).expect("stable").value, 0.5728, 5e-5);
}

#[test]
fn paper_hand_tuned_pi_is_unstable_on_the_printed_plant() {
    // PAPER_NOTES: kp 1.7, ki 24.331 gives poles at +1.2, with the filter at +6.4.
    let pi = TransferFunction::new(&[1.7, 24.331], &[1.0, 0.0]).expect("proper").to_state_space();
    let (plant, bound, filter) = (printed::g(), printed::ws(), printed::filter());
    for (filter, expected) in [(None, 1.2), (Some(&filter), 6.4)] {
        let loop_ =
            LoopUnderTest { plant: &plant, controller: &pi, bound: &bound, measurement_filter: filter };
        match verify(&loop_) {
            Err(Error::UnstableLoop { poles }) => {
                assert_eq!(poles.len(), 2);
                close(poles[0].re, expected, 0.05);
            }
            other => panic!("expected an unstable loop, found {other:?}"),
        }
    }
}

#[test]
fn law_brackets_agree_with_a_dense_grid() {
    let filter = printed::filter();
    let c = printed_certificate(Some(&filter));
    let (g, k, ws) = (printed::g(), printed::k(), printed::ws());
    let mut peaks = [0.0_f64; 4];
    for i in 0..60_000 {
        let omega = 1e-2 * 10.0_f64.powf(5.0 * f64::from(i) / 60_000.0);
        let (g, k, f) = (g.at(omega), k.at(omega), filter.at(omega));
        let s = (1.0 + g * k * f).inv();
        for (peak, value) in peaks.iter_mut().zip([s, g * k * s, k * f * s, ws.at(omega) * k * f * s]) {
            *peak = peak.max(value.norm());
        }
    }
    for (grid, norm) in peaks.into_iter().zip([c.peak_s, c.peak_t, c.norm_ms, c.frequency_wise]) {
        assert!(grid <= norm.upper && grid > norm.lower * (1.0 - 1e-6), "{grid} {norm:?}");
    }
}

#[test]
fn law_a_certificate_survives_a_file_and_an_edited_one_does_not_hold() {
    let c = printed_certificate(None);
    let text = serde_json::to_string(&c).expect("serializable");
    let back: Certificate = serde_json::from_str(&text).expect("readable");
    assert_eq!(back, c);
    let mut edited = c.clone();
    edited.closed_loop_poles[0].re = 1.0;
    assert!(!edited.holds());
    let with_extra = text.replacen('{', "{\"extra\":1,", 1);
    assert!(serde_json::from_str::<Certificate>(&with_extra).is_err());
}

#[test]
fn edge_a_large_bound_fails_and_an_unstable_bound_is_refused() {
    let plant = printed::g();
    let controller = printed::k().to_state_space();
    let large = printed::ws().scale(6.0).expect("finite");
    let loop_ =
        LoopUnderTest { plant: &plant, controller: &controller, bound: &large, measurement_filter: None };
    let c = verify(&loop_).expect("nominally stable");
    assert!(c.stable && !c.norm_test_passes && !c.frequency_wise_passes && !c.holds());
    let unstable = TransferFunction::new(&[1.0], &[1.0, -1.0]).expect("proper");
    let loop_ = LoopUnderTest { bound: &unstable, ..loop_ };
    assert!(matches!(verify(&loop_), Err(Error::UnstableElement { system: "uncertainty bound", .. })));
}
