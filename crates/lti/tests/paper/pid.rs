//! The two PID controllers of section 5.1 on the printed plant.

use super::systems::{auto_tuned_pid, hand_tuned_pi, measurement_filter, plant};
use super::{assert_rounds_to, slowest_pole_re};
use telepulse_lti::TransferFunction;

#[test]
fn paper_sec51_the_hand_tuned_pi_is_unstable_on_eq16() {
    // It tracked on the rig (figure 14), so rig and Eq. (16) disagree here.
    let open = plant().multiply(&hand_tuned_pi()).unwrap();
    let closed = open.feedback(&TransferFunction::from_gain(1.0).unwrap()).unwrap();
    assert!(!closed.is_stable().unwrap());
    assert_rounds_to(slowest_pole_re(&closed), "1.2");
    let filtered = open.feedback(&measurement_filter()).unwrap();
    assert_rounds_to(slowest_pole_re(&filtered), "6.4");
}

#[test]
fn paper_sec51_the_auto_tuned_pid_is_stable_on_eq16_but_not_robust() {
    let (g, pid) = (plant(), auto_tuned_pid());
    let closed = g.multiply(&pid).unwrap().feedback(&TransferFunction::from_gain(1.0).unwrap()).unwrap();
    assert!(closed.is_stable().unwrap());
    assert_rounds_to(slowest_pole_re(&closed), "-13.7");
    // K S = K / (1 + G K) rises towards K at infinite frequency, which is P + D N = 429.79: a hundred times the limit of
    // 4.1218 that Eq. (24) allows.
    let supremum = 3.1738 + 0.0443 * 9630.0667;
    let effort = pid.feedback(&g).unwrap();
    let peak = effort.to_state_space().hinf_norm().unwrap();
    assert_rounds_to(supremum, "429.79");
    assert!(peak.lower <= supremum * (1.0 + 1e-9) && peak.upper >= supremum * (1.0 - 1e-9), "{peak:?}");
    assert!(peak.lower > 100.0 * 4.1218);
}
