//! The loop of the printed plant, Eq. (16), and the printed controller, Eq. (21).

use super::systems::{controller, measurement_filter, plant};
use super::{assert_rounds_to, first_fall_below, largest_between, rad_s, slowest_pole_re};
use num_complex::Complex64;
use telepulse_lti::{StateSpace, TransferFunction};

fn open_loop() -> TransferFunction {
    plant().multiply(&controller()).unwrap()
}

fn complementary_sensitivity() -> TransferFunction {
    open_loop().feedback(&TransferFunction::from_gain(1.0).unwrap()).unwrap()
}

/// The poles as printed, each pair by its upper member, in any order.
fn assert_poles_round_to(poles: &[Complex64], real: &[&str], pairs: &[(&str, &str)]) {
    assert_eq!(poles.len(), real.len() + 2 * pairs.len(), "{poles:?}");
    let mut reals: Vec<f64> = poles.iter().filter(|p| p.im == 0.0).map(|p| p.re).collect();
    reals.sort_by(f64::total_cmp);
    let mut uppers: Vec<Complex64> = poles.iter().copied().filter(|p| p.im > 0.0).collect();
    uppers.sort_by(|p, q| q.im.total_cmp(&p.im));
    for (found, printed) in reals.iter().zip(real) {
        assert_rounds_to(*found, printed);
    }
    for (found, (re, im)) in uppers.iter().zip(pairs) {
        assert_rounds_to(found.re, re);
        assert_rounds_to(found.im, im);
    }
}

const CLOSED_LOOP_REAL: [&str; 2] = ["-221.48", "-12.496"];
const CLOSED_LOOP_PAIRS: [(&str, &str); 2] = [("-6.892", "73.226"), ("-3.969", "40.154")];

#[test]
fn paper_eq21_closed_loop_poles_from_polynomials() {
    let poles = complementary_sensitivity().poles().unwrap();
    assert_poles_round_to(&poles, &CLOSED_LOOP_REAL, &CLOSED_LOOP_PAIRS);
}

#[test]
fn paper_eq21_closed_loop_poles_from_state_space() {
    let unity = TransferFunction::from_gain(1.0).unwrap().to_state_space();
    let open = controller().to_state_space().series(&plant().to_state_space()).unwrap();
    let poles = open.feedback(&unity).unwrap().poles().unwrap();
    assert_poles_round_to(&poles, &CLOSED_LOOP_REAL, &CLOSED_LOOP_PAIRS);
}

#[test]
fn paper_eq26_the_measurement_filter_slows_the_loop() {
    let filter = measurement_filter();
    let closed = open_loop().feedback(&filter).unwrap();
    assert_eq!(closed.order(), 7);
    let slowest = closed.poles().unwrap().into_iter().max_by(|p, q| p.re.total_cmp(&q.re)).unwrap();
    assert_rounds_to(slowest.re, "-2.884");
    assert_rounds_to(slowest.im.abs(), "38.80");
    let open: StateSpace<_> = controller().to_state_space().series(&plant().to_state_space()).unwrap();
    let by_states = open.feedback(&filter.to_state_space()).unwrap().poles().unwrap();
    let re = by_states.iter().map(|p| p.re).fold(f64::NEG_INFINITY, f64::max);
    assert!((re - slowest_pole_re(&closed)).abs() < 1e-9);
}

#[test]
fn paper_fig12_peaks_of_sensitivity_and_of_tracking() {
    let l = open_loop();
    let sensitivity = largest_between(0.01, 100.0, |hz| (1.0 + l.at(rad_s(hz))).inv().norm());
    assert_rounds_to(sensitivity.value, "2.264");
    assert_rounds_to(sensitivity.frequency_hz, "6.53");
    let t = complementary_sensitivity();
    let tracking = largest_between(0.01, 100.0, |hz| t.at(rad_s(hz)).norm());
    assert_rounds_to(tracking.value, "1.532");
    assert_rounds_to(tracking.frequency_hz, "6.34");
}

#[test]
fn paper_fig12_tracking_is_not_flat_up_to_6_07_hz() {
    // The paper: "relatively flat when its input frequency is lower than 6.07 Hz". Its own formulas dip before.
    let t = complementary_sensitivity();
    let db = |hz: f64| 20.0 * t.at(rad_s(hz)).norm().log10();
    let dip = largest_between(1.0, 6.0, |hz| -db(hz));
    assert_rounds_to(-dip.value, "-3.5");
    assert_rounds_to(dip.frequency_hz, "3.5");
    assert_rounds_to(first_fall_below(20.0 * 0.5f64.sqrt().log10(), 0.1, db), "2.61");
}
