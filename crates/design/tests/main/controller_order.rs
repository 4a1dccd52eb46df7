//! Controllers of lower order, judged on the closed loop by its response, poles and refusals.

use nalgebra::DMatrix;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use telepulse_design::Error;
use telepulse_design::implement::{ReducedController, reduce_controller};
use telepulse_design::synthesize::{HinfOptions, MixedSensitivityWeights, hinfsyn, mixed_sensitivity};
use telepulse_lti::{Continuous, GeneralizedPlant, StateSpace, TransferFunction};

use crate::printed;

fn tf(numerator: &[f64], denominator: &[f64]) -> TransferFunction {
    TransferFunction::new(numerator, denominator).expect("proper")
}

/// Closes the loop frequency by frequency, without a state-space interconnection, and compares with the claims.
fn judge(name: &str, plant: &GeneralizedPlant, done: &ReducedController, increase: f64) {
    let limit = (1.0 + increase) * done.norm_before.upper;
    assert!(done.norm.upper <= limit, "{name}");
    assert!(done.norm_on_grid <= done.norm.upper * (1.0 + 1e-9), "{name}");
    let (n_w, n_u, n_z, n_y) = (plant.n_w(), plant.n_u(), plant.n_z(), plant.n_y());
    let mut largest: f64 = 0.0;
    for k in 0..400 {
        let omega = 10f64.powf(-4.0 + 0.02 * f64::from(k));
        let p = plant.sys().at(omega).expect("no pole there");
        let kv = done.controller.at(omega).expect("no pole there");
        let p11 = p.view((0, 0), (n_z, n_w)).into_owned();
        let (p12, p21) = (p.view((0, n_w), (n_z, n_u)), p.view((n_z, 0), (n_y, n_w)));
        let p22 = p.view((n_z, n_w), (n_y, n_u)).into_owned();
        let inner = (DMatrix::identity(n_u, n_u) - &kv * p22).try_inverse().expect("regular");
        largest = largest.max((p11 + p12 * inner * &kv * p21).singular_values().max());
    }
    assert!(largest <= done.norm.upper * (1.0 + 1e-7), "{name}: {largest} above {:?}", done.norm);
    let closed = plant.lower_lft(&done.controller).expect("ports");
    assert!(closed.poles().expect("poles").iter().all(|p| p.re < 0.0), "{name}");
    println!(
        "{name}: order {} by {:?}, norm {:.6} before {:.6}",
        done.controller.n_states(),
        done.route,
        done.norm.value,
        done.norm_before.value
    );
}

#[test]
fn paper_eq21_and_the_central_controller_lose_states() {
    let plant = printed::generalized_plant();
    let central = hinfsyn(&plant, &HinfOptions::default()).expect("feasible").controller;
    for (name, k) in [("printed", printed::k().to_state_space()), ("central", central)] {
        let mut last = k.n_states();
        for increase in [1e-3, 0.05, 0.5] {
            match reduce_controller(&plant, &k, increase) {
                Ok(done) => {
                    judge(&format!("{name} at {increase}"), &plant, &done, increase);
                    assert!(done.controller.n_states() <= last);
                    last = done.controller.n_states();
                }
                Err(Error::ControllerNotReducible { n_states, limit, best_norm, .. }) => {
                    println!("{name} at {increase}: {best_norm} above {limit}");
                    assert!(n_states == k.n_states() && best_norm > limit && last == n_states);
                }
                Err(other) => panic!("{name}: {other}"),
            }
        }
    }
}

#[test]
fn law_states_that_the_loop_does_not_need_are_found_with_several_ports() {
    let mut n_found = 0;
    let kinds = (0..6).flat_map(|seed| [(seed, true), (seed, false)]);
    for (seed, with_d11) in kinds {
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut m = |r, c| DMatrix::from_fn(r, c, |_, _| rng.random_range(-1.0..1.0));
        let (a, b, c) = (m(3, 3), m(3, 4), m(4, 3));
        let mut d = m(4, 4);
        d.view_mut((2, 2), (2, 2)).fill(0.0);
        if !with_d11 {
            d.view_mut((0, 0), (2, 2)).fill(0.0);
        }
        let sys = StateSpace::<Continuous>::new(a, b, c, d).expect("shapes");
        let plant = GeneralizedPlant::new(sys, 2, 2, 2, 2).expect("ports");
        let Ok(design) = hinfsyn(&plant, &HinfOptions::default()) else { continue };
        // Two more states: lags far beyond the loop, at both inputs of the controller.
        let pace = 1e5 * design.fastest_controller_pole_rad_s().expect("poles").max(1.0);
        let lag = tf(&[pace], &[1.0, pace]).to_state_space();
        let padded = lag.augment(&lag).and_then(|lags| lags.series(&design.controller)).expect("ports");
        let Ok(done) = reduce_controller(&plant, &padded, 0.01) else {
            panic!("seed {seed}: a lag must go");
        };
        judge(&format!("seed {seed}"), &plant, &done, 0.01);
        // A controller with a direct term needs its lags where the plant has one as well: at high frequencies.
        assert!(done.controller.n_states() < padded.n_states(), "seed {seed}: {:?}", done.tried);
        if !with_d11 {
            // Strictly proper: the loop sees neither lag, and nothing else than the lags may cost one per cent.
            assert!(
                done.controller.n_states() <= design.controller.n_states(),
                "seed {seed}: {:?}",
                done.tried
            );
        }
        n_found += usize::from(done.controller.n_states() <= 3);
    }
    assert!(n_found >= 6, "{n_found}");
}

#[test]
fn law_a_controller_that_has_to_be_unstable_is_reduced() {
    // One zero at 1 and one pole at 2: no stable controller stabilises this plant.
    let g = tf(&[1.0, -1.0], &[1.0, -1.0, -2.0]);
    let we = tf(&[0.1, 0.01], &[1.0, 0.01]);
    let wu = tf(&[0.1], &[1.0]);
    let weights = MixedSensitivityWeights { we: &we, wu: &wu, wt: None };
    let plant = mixed_sensitivity(&g, &weights).expect("stable weights");
    let design = hinfsyn(&plant, &HinfOptions::default()).expect("feasible");
    let lag = tf(&[1e5], &[1.0, 1e5]).to_state_space();
    let padded = design.controller.series(&lag).expect("ports");
    let done = reduce_controller(&plant, &padded, 0.05).expect("the lag at least");
    judge("unstable", &plant, &done, 0.05);
    assert!(done.controller.n_states() < padded.n_states());
    assert!(done.controller.poles().expect("poles").iter().any(|p| p.re > 0.0));
}

#[test]
fn edge_refusals_have_names() {
    let plant = printed::generalized_plant();
    let k = printed::k().to_state_space();
    for increase in [-0.1, f64::NAN, f64::INFINITY] {
        let found = reduce_controller(&plant, &k, increase);
        assert!(matches!(found, Err(Error::OutOfRange { .. })), "{found:?}");
    }
    // Positive feedback of a large gain: the loop as given is not stable.
    let found = reduce_controller(&plant, &k.scale(-100.0).expect("finite"), 0.1);
    assert!(matches!(found, Err(Error::System(telepulse_lti::Error::Unstable { .. }))), "{found:?}");
    let wide = StateSpace::<Continuous>::from_gain(DMatrix::zeros(2, 1)).expect("ports");
    let found = reduce_controller(&plant, &wide, 0.1);
    assert!(matches!(found, Err(Error::System(telepulse_lti::Error::PortCount { .. }))), "{found:?}");
    let nothing = StateSpace::<Continuous>::from_gain(DMatrix::zeros(1, 1)).expect("ports");
    let found = reduce_controller(&plant, &nothing, 0.1);
    assert!(matches!(found, Err(Error::ControllerNotReducible { n_states: 0, .. })), "{found:?}");
}
