use rand::{RngExt, SeedableRng};
use telepulse_lti::{TransferFunction, polynomial};

use super::*;

fn plant(n: &[f64], d: &[f64], delay_s: f64) -> DelayedPlant {
    DelayedPlant::new(TransferFunction::new(n, d).expect("proper"), delay_s).expect("valid")
}

fn target(crossover_rad_s: Option<f64>, phase_margin_deg: f64) -> MarginTarget {
    MarginTarget { crossover_rad_s, phase_margin_deg, ..MarginTarget::default() }
}

#[test]
fn oracle_pi_of_three_lags_is_that_of_the_usual_tool() {
    // The manual of MATLAB's pidtune: 1/(s + 1)^3 with PI, 60 degrees at 0.5205 rad/s: Kp = 1.14, Ki = 0.454.
    let plant = plant(&[1.0], &[1.0, 3.0, 3.0, 1.0], 0.0);
    let design =
        tune_phase_margin(&plant, MarginTerms::Pi, &target(Some(0.5205), 60.0)).expect("within reach");
    assert!(
        (design.settings.p - 1.14).abs() < 5e-3 && (design.settings.i_per_s - 0.454).abs() < 5e-4,
        "{design:?}"
    );
    // PIDF with 60 degrees at 1 rad/s there: Kp = 2.72, Ki = 0.985, Kd = 1.72. The line of controllers is the same, and the
    // balanced point of it next to theirs.
    let design = tune_phase_margin(&plant, MarginTerms::Pid, &target(Some(1.0), 60.0)).expect("within reach");
    let PidSettings { p, i_per_s, d_s, .. } = design.settings;
    assert!(
        (p / 2.72 - 1.0).abs() < 0.01
            && (i_per_s / 0.985 - 1.0).abs() < 0.1
            && (d_s / 1.72 - 1.0).abs() < 0.05
    );
}

#[test]
fn law_a_given_crossover_and_margin_are_met_exactly() {
    let third = |gain: f64| plant(&[gain], &[1.0, 3.0, 3.0, 1.0], 0.0);
    for (plant, omega, terms) in [
        (third(1.0), 0.4, MarginTerms::Pi),
        (third(-2.0), 1.2, MarginTerms::Pid),
        (third(1.0), 1.0, MarginTerms::Pidf),
        (third(1.0), 1.4, MarginTerms::Pd),
        (plant(&[1.0], &[1.0, 1.0, 0.0], 0.1), 1.0, MarginTerms::Pid),
        (plant(&[1.0], &[1.0, 1.0], 0.5), 1.0, MarginTerms::Pi),
    ] {
        for focus in [DesignFocus::Balanced, DesignFocus::Reference, DesignFocus::Disturbance] {
            let target = MarginTarget { focus, ..target(Some(omega), 50.0) };
            let design = tune_phase_margin(&plant, terms, &target).expect("within reach");
            assert!((design.check.phase_margin_deg.expect("crosses") - 50.0).abs() < 1e-6, "{design:?}");
            assert!((design.check.crossover_rad_s.expect("crosses") / omega - 1.0).abs() < 1e-8);
        }
    }
}

#[test]
fn law_the_focus_moves_what_it_names() {
    for plant in [
        plant(&[1.0], &[1.0, 3.0, 3.0, 1.0], 0.2),
        plant(&[1.0], &[1.0, 1.0], 0.3),
        plant(&[1350.14], &[0.0045, 1.07182, 22.458, 1444.0], 0.0),
    ] {
        let of = |focus| {
            let target = MarginTarget { focus, ..target(None, 55.0) };
            tune_phase_margin(&plant, MarginTerms::Pid, &target).expect("found")
        };
        let (reference, balanced, disturbance) =
            (of(DesignFocus::Reference), of(DesignFocus::Balanced), of(DesignFocus::Disturbance));
        assert!(
            disturbance.settings.i_per_s >= 0.99 * balanced.settings.i_per_s,
            "{disturbance:?} {balanced:?}"
        );
        assert!(disturbance.settings.i_per_s >= 0.99 * reference.settings.i_per_s);
        assert!(
            reference.check.peak_t.value <= disturbance.check.peak_t.value + 1e-6,
            "{reference:?} {disturbance:?}"
        );
        for design in [&reference, &balanced, &disturbance] {
            assert!(
                design.check.peak_s.upper <= 1.7 && design.check.phase_margin_deg.expect("crosses") > 54.99
            );
        }
    }
}

#[test]
fn law_a_chosen_crossover_is_stable_and_robust_and_nothing_near_is_better() {
    for (plant, terms) in [
        (plant(&[1.0], &[1.0, 3.0, 3.0, 1.0], 0.3), MarginTerms::Pid),
        (plant(&[1350.14], &[0.0045, 1.07182, 22.458, 1444.0], 0.0), MarginTerms::Pid),
        (plant(&[1.0], &[1.0, 1.0], 1.0), MarginTerms::Pi),
        (plant(&[1.0], &[1.0, 3.0, 3.0, 1.0], 0.3), MarginTerms::I),
        (plant(&[1.0], &[1.0, -1.0], 0.1), MarginTerms::Pi),
    ] {
        let target = MarginTarget { ms_max: 2.0, ..target(None, 50.0) };
        let design = tune_phase_margin(&plant, terms, &target).expect("found");
        assert!(design.check.peak_s.upper <= 2.0);
        assert!(design.check.phase_margin_deg.expect("crosses").abs() > 50.0 - 1e-5);
        for factor in [0.8, 0.9, 1.1, 1.25] {
            let other = MarginTarget { crossover_rad_s: Some(factor * design.crossover_rad_s), ..target };
            if let Ok(near) = tune_phase_margin(&plant, terms, &other) {
                let better = near.settings.i_per_s > 1.02 * design.settings.i_per_s;
                assert!(!better || near.check.peak_s.value > 2.0, "{design:?} {near:?}");
            }
        }
    }
}

#[test]
fn law_p_and_i_controllers_take_the_margin_or_more() {
    // 1/(s + 1)^3 under P: 60 degrees where each lag has 40; gain 1/cos(40)^3.
    let plant = plant(&[1.0], &[1.0, 3.0, 3.0, 1.0], 0.0);
    let wide = MarginTarget { ms_max: 3.0, ..target(None, 60.0) };
    let design = tune_phase_margin(&plant, MarginTerms::P, &wide).expect("found");
    let (omega, gain) = (40f64.to_radians().tan(), 40f64.to_radians().cos().powi(-3));
    assert!(
        (design.crossover_rad_s / omega - 1.0).abs() < 0.01 && (design.settings.p / gain - 1.0).abs() < 0.02,
        "{design:?}"
    );
    // Under I: each lag has 10 degrees.
    let design = tune_phase_margin(&plant, MarginTerms::I, &wide).expect("found");
    let omega = 10f64.to_radians().tan();
    assert!((design.crossover_rad_s / omega - 1.0).abs() < 0.01, "{design:?}");
    // At a crossover that is given the margin is what it is.
    let design =
        tune_phase_margin(&plant, MarginTerms::P, &target(Some(0.5), 60.0)).expect("more than enough");
    let margin = 180.0 - 3.0 * 0.5_f64.atan().to_degrees();
    assert!((design.check.phase_margin_deg.expect("crosses") - margin).abs() < 1e-6, "{design:?}");
    let found = tune_phase_margin(&plant, MarginTerms::P, &target(Some(1.5), 60.0));
    assert!(
        matches!(found, Err(Error::PidMarginNotMet { found_deg, .. }) if (found_deg - 11.07).abs() < 0.01),
        "{found:?}"
    );
}

#[test]
fn law_what_is_returned_keeps_its_margins_on_random_plants() {
    let seed = 411;
    let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
    let (mut found, mut refused) = (0, 0);
    for trial in 0..60 {
        let mut d = vec![1.0];
        for _ in 0..1 + trial % 4 {
            let time = 10f64.powf(rng.random_range(-1.5..1.5));
            d = if rng.random_range(0.0..1.0) < 0.3 {
                polynomial::multiply(&d, &[time * time, 2.0 * rng.random_range(0.02..0.9) * time, 1.0])
            } else {
                polynomial::multiply(&d, &[time, 1.0])
            };
        }
        if rng.random_range(0.0..1.0) < 0.2 {
            d.push(0.0);
        }
        let n =
            [rng.random_range(-0.3..1.0), 10f64.powf(rng.random_range(-1.0..1.0)) * [1.0, -1.0][trial % 2]];
        let delay_s = if trial % 3 == 0 { 0.0 } else { 10f64.powf(rng.random_range(-2.0..0.5)) };
        let plant = plant(&n, &d, delay_s);
        let terms = [MarginTerms::Pi, MarginTerms::Pid, MarginTerms::Pidf, MarginTerms::Pd, MarginTerms::I]
            [trial % 5];
        let design = match tune_phase_margin(&plant, terms, &target(None, 45.0)) {
            Ok(design) => design,
            Err(Error::PidNoCrossover { .. }) => {
                refused += 1;
                continue;
            }
            Err(error) => panic!("seed {seed} trial {trial}: {error}"),
        };
        found += 1;
        // Another route: a dense walk along the axis that counts the turns around -1 and looks at every crossing.
        let controller = design.settings.transfer_function().expect("finite");
        let loop_at = |w: f64| plant.at(w) * controller.at(w);
        let (mut least_deg, mut peak, mut before) = (180.0_f64, 0.0_f64, loop_at(1e-5));
        for k in 1..400_000 {
            let w = 1e-5 * 10f64.powf(10.0 * f64::from(k) / 4e5);
            let here = loop_at(w);
            if (here.norm() > 1.0) != (before.norm() > 1.0) {
                least_deg = least_deg.min((-here).arg().to_degrees().abs());
            }
            peak = peak.max(1.0 / (1.0 + here).norm());
            before = here;
        }
        assert!(least_deg > 44.9, "seed {seed} trial {trial} {terms:?}: {least_deg} {design:?}");
        assert!(peak <= 1.7 * (1.0 + 1e-9), "seed {seed} trial {trial}: {peak}");
    }
    assert!(found > 40, "{found} found, {refused} refused");
}

#[test]
fn edge_a_target_out_of_reach_says_what_is_within() {
    let third = plant(&[1.0], &[1.0, 3.0, 3.0, 1.0], 0.0);
    // The plant is at -190 degrees: a PI controller only adds to that.
    let found = tune_phase_margin(&third, MarginTerms::Pi, &target(Some(2.0), 60.0));
    assert!(
        matches!(found, Err(Error::PidPhaseOutOfReach { needed_deg, .. }) if (needed_deg - 70.3).abs() < 0.1)
    );
    for bad in [f64::NAN, 0.0, 180.0] {
        let found = tune_phase_margin(&third, MarginTerms::Pi, &target(None, bad));
        assert!(matches!(found, Err(Error::OutOfRange { .. })));
    }
    assert!(tune_phase_margin(&third, MarginTerms::Pi, &target(Some(f64::INFINITY), 60.0)).is_err());
    // Unstable and slow to be controlled: no margin of 60 degrees anywhere.
    let hard = plant(&[1.0], &[1.0, -1.0], 0.9);
    let found = tune_phase_margin(&hard, MarginTerms::Pid, &target(None, 60.0));
    assert!(matches!(found, Err(Error::PidNoCrossover { .. })), "{found:?}");
    let blocked = plant(&[1.0, 0.0], &[1.0, 3.0, 2.0], 0.0);
    assert_eq!(
        tune_phase_margin(&blocked, MarginTerms::Pi, &target(None, 60.0)),
        Err(Error::PidPlantZeroAtOrigin)
    );
}

#[test]
fn edge_a_second_crossing_with_less_margin_is_refused() {
    // A light resonance above the crossover lifts the gain over one again, with hardly a margin.
    let resonant = plant(&[1.0], &polynomial::multiply(&[1.0, 1.0], &[1e-2, 2e-3, 1.0]), 0.0);
    let found = tune_phase_margin(&resonant, MarginTerms::Pi, &target(Some(2.0), 60.0));
    assert!(matches!(found, Err(Error::PidMarginNotMet { .. } | Error::PidLoopUnstable { .. })), "{found:?}");
    // Chosen freely, the crossover stays where all margins hold.
    let design = tune_phase_margin(&resonant, MarginTerms::Pi, &target(None, 60.0)).expect("found");
    assert!(design.check.phase_margin_deg.expect("crosses") > 59.99, "{design:?}");
}
