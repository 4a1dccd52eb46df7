//! The optimum against published values and against brute force.

use telepulse_lti::{TransferFunction, polynomial};

use super::*;
use crate::Error;
use crate::implement::PidSettings;

fn tf(n: &[f64], d: &[f64]) -> TransferFunction {
    TransferFunction::new(n, d).expect("proper")
}

fn plant(n: &[f64], d: &[f64], delay_s: f64) -> DelayedPlant {
    DelayedPlant::new(tf(n, d), delay_s).expect("valid")
}

fn lag_chain(n: usize) -> Vec<f64> {
    (0..n).fold(vec![1.0], |p, _| polynomial::multiply(&p, &[1.0, 1.0]))
}

fn paper() -> (DelayedPlant, TransferFunction) {
    (plant(&[1350.14], &[0.0045, 1.07182, 22.458, 1444.0], 0.0), tf(&[487.5], &[1.0, 45.0, 2500.0]))
}

#[test]
fn paper_migo_pi_of_three_equal_lags() {
    // Astrom, Panagopoulos and Hagglund 1998, 1/(s + 1)^3: Ms 1.4 gives k = 0.633, Ti = 1.95; Ms 2.0 gives k = 1.22,
    // Ti = 1.78. Only S was limited there.
    for (ms_max, k, ti) in [(1.4, 0.633, 1.95), (2.0, 1.22, 1.78)] {
        let limits = PidLimits { ms_max, mt_max: 20.0, ..PidLimits::default() };
        let design = maximize_integral_gain(&plant(&[1.0], &lag_chain(3), 0.0), PidStructure::Pi, &limits)
            .expect("found");
        let s = design.settings;
        assert!((s.p / k - 1.0).abs() < 6e-3 && (s.p / s.i_per_s / ti - 1.0).abs() < 6e-3, "{design:?}");
        assert_eq!(design.binding, [PidLimit::Sensitivity]);
    }
}

/// Best integral gain on a net of gains, judged on a dense grid of frequencies and by the roots (no dead time) or the sign
/// changes of the argument: a route that shares nothing with the search.
struct Net {
    p: (f64, f64, usize),
    d: (f64, f64, usize),
    i: (f64, f64, usize),
}

fn brute_force(plant: &DelayedPlant, n_rad_s: f64, limits: &PidLimits, net: &Net) -> f64 {
    let rows_of = |n: i32| -> Vec<_> {
        let omega = |k: i32| 1e-2 * 10f64.powf(5.0 * f64::from(k) / f64::from(n - 1));
        let row = |w: f64| {
            let s = num_complex::Complex64::new(0.0, w);
            (plant.at(w), s, limits.ws.as_ref().map_or(0.0, |ws| ws.at(w).norm()))
        };
        (0..n).map(|k| row(omega(k))).collect()
    };
    // A short list turns most gains away, a long one decides.
    let (short, long) = (rows_of(150), rows_of(6000));
    let at = |range: (f64, f64, usize), k: usize| {
        range.0 + (range.1 - range.0) * k as f64 / (range.2 - 1).max(1) as f64
    };
    let mut best = 0.0;
    for ip in 0..net.p.2 {
        for id in 0..net.d.2 {
            let (p, d) = (at(net.p, ip), at(net.d, id));
            // Largest first: the first that passes is the best of this column.
            for ii in (0..net.i.2).rev() {
                let i = at(net.i, ii);
                if i <= best {
                    break;
                }
                let within = short.iter().chain(&long).all(|(g, s, w)| {
                    let filter = if n_rad_s > 0.0 { n_rad_s / (s + n_rad_s) } else { 0.0.into() };
                    let c = p + i / s + d * s * filter;
                    let distance = (1.0 + g * c).norm();
                    distance * limits.ms_max >= 1.0
                        && (g * c).norm() <= limits.mt_max * distance
                        && w * c.norm() <= distance
                });
                let settings = PidSettings { p, i_per_s: i, d_s: d, n_rad_s };
                if within && check_pid_loop(plant, &settings, None).is_ok() {
                    best = i;
                    break;
                }
            }
        }
    }
    best
}

fn assert_not_beaten(
    plant: &DelayedPlant,
    structure: PidStructure,
    limits: &PidLimits,
    label: &str,
) -> PidDesign {
    let design = maximize_integral_gain(plant, structure, limits).unwrap_or_else(|e| panic!("{label}: {e}"));
    let s = design.settings;
    let n_rad_s = if let PidStructure::Pid { n_rad_s } = structure { n_rad_s } else { 0.0 };
    // Coarse over the whole region, then fine around the optimum.
    let wide = |v: f64, n| (-v.abs(), 3.0 * v.abs(), n);
    let near = |v: f64, n| (v - 0.15 * v.abs(), v + 0.15 * v.abs(), n);
    let has_d = n_rad_s > 0.0;
    let (n_wide, n_near) = if has_d { (13, 11) } else { (1, 1) };
    let coarse = Net {
        p: wide(s.p, if has_d { 25 } else { 61 }),
        d: if has_d { wide(s.d_s, n_wide) } else { (0.0, 0.0, 1) },
        i: (0.5 * s.i_per_s, 3.0 * s.i_per_s, 40),
    };
    let fine = Net {
        p: near(s.p, if has_d { 21 } else { 41 }),
        d: if has_d { near(s.d_s, n_near) } else { (0.0, 0.0, 1) },
        i: (0.9 * s.i_per_s, 1.1 * s.i_per_s, 41),
    };
    for net in [coarse, fine] {
        let beaten = brute_force(plant, n_rad_s, limits, &net);
        assert!(beaten <= 1.01 * s.i_per_s, "{label}: net finds {beaten}, search {design:?}");
    }
    assert!(design.check.peak_s.upper <= limits.ms_max && design.check.peak_t.upper <= limits.mt_max);
    design
}

#[test]
fn law_brute_force_does_not_beat_the_optimum_of_pi_controllers() {
    for (label, plant) in [
        ("lags", plant(&[1.0], &lag_chain(4), 0.0)),
        ("lag with delay", plant(&[1.0], &[1.0, 1.0], 1.0)),
        ("delay", plant(&[1.0], &[0.05, 1.0], 1.0)),
        ("integrator", plant(&[1.0], &[1.0, 1.0, 0.0], 0.2)),
        ("inverse response", plant(&[-1.0, 1.0], &lag_chain(3), 0.0)),
        ("resonance", plant(&[1.0], &[1.0, 0.2, 1.0], 0.1)),
    ] {
        let limits = PidLimits { ms_max: 1.6, mt_max: 1.5, ..PidLimits::default() };
        assert_not_beaten(&plant, PidStructure::Pi, &limits, label);
    }
}

#[test]
fn law_brute_force_does_not_beat_the_optimum_of_pid_controllers() {
    for (label, plant, n_rad_s) in [
        ("lags", plant(&[1.0], &lag_chain(4), 0.0), 20.0),
        ("lag with delay", plant(&[1.0], &[1.0, 1.0], 0.5), 40.0),
        ("unstable", plant(&[1.0], &polynomial::multiply(&[1.0, -1.0], &[0.1, 1.0]), 0.05), 200.0),
    ] {
        let limits = PidLimits { ms_max: 2.0, mt_max: 2.0, ..PidLimits::default() };
        assert_not_beaten(&plant, PidStructure::Pid { n_rad_s }, &limits, label);
    }
}

#[test]
fn paper_eq24_best_pid_under_the_bound_of_eq17() {
    let (plant, ws) = paper();
    let limits = PidLimits { ms_max: 2.0, mt_max: 1.5, ws: Some(ws), ..PidLimits::default() };
    let pi = assert_not_beaten(&plant, PidStructure::Pi, &limits, "PI");
    let pid = assert_not_beaten(&plant, PidStructure::Pid { n_rad_s: 1000.0 }, &limits, "PID");
    for design in [&pi, &pid] {
        assert!(design.check.peak_ws_ks.expect("weight").upper < 1.0);
    }
    // The derivative part pays, and the printed hand-tuned PI is out of reach of any PI within the limits.
    assert!(pid.settings.i_per_s > 1.2 * pi.settings.i_per_s, "{pi:?} {pid:?}");
    assert!(pi.settings.i_per_s < 24.331);
}

#[test]
fn paper_eq24_the_norm_test_leaves_a_pid_little() {
    // The small-gain limit on the norms alone, 4.12: the auto-tuned PID has a peak of C S of 427.
    let (plant, ws) = paper();
    let mut best = [0.0; 2];
    for (k, n_rad_s) in [100.0, 1000.0].into_iter().enumerate() {
        let limits = PidLimits { ms_max: 2.0, mt_max: 1.5, ks_max: Some(4.1218), ws: Some(ws.clone()) };
        let design = maximize_integral_gain(&plant, PidStructure::Pid { n_rad_s }, &limits).expect("found");
        assert!(design.check.peak_ks.upper <= 4.1218 && design.check.peak_ws_ks.expect("weight").upper < 1.0);
        assert!(design.binding.contains(&PidLimit::Noise), "{design:?}");
        best[k] = design.settings.i_per_s;
    }
    // A slow filter spends the noise gain better.
    assert!(best[0] > best[1], "{best:?}");
}

#[test]
fn edge_each_way_of_having_no_answer_has_its_error() {
    let limits = PidLimits::default();
    // A first-order lag under PI control: no limit on the gain.
    let lag = plant(&[1.0], &[1.0, 1.0], 0.0);
    let found = maximize_integral_gain(&lag, PidStructure::Pi, &limits);
    assert!(matches!(found, Err(Error::PidGainUnbounded { .. })), "{found:?}");
    // Three unstable poles far right with dead time: nothing stabilises.
    let wild = plant(&[1.0], &[1.0, -3.0, 3.0, -1.0], 1.0);
    let found = maximize_integral_gain(&wild, PidStructure::Pid { n_rad_s: 100.0 }, &limits);
    assert!(matches!(found, Err(Error::PidNotStabilized { n_unstable_plant: 3 })), "{found:?}");
    // An unstable lag with dead time: stabilised, but not with a peak of 1.1.
    let unstable = plant(&[1.0], &[1.0, -1.0], 0.3);
    let tight = PidLimits { ms_max: 1.1, mt_max: 1.1, ..PidLimits::default() };
    let found = maximize_integral_gain(&unstable, PidStructure::Pi, &tight);
    assert!(matches!(found, Err(Error::PidLimitsNotMet { .. })), "{found:?}");
    // An additive error as large as the plant at rest.
    let ws = PidLimits { ws: Some(tf(&[1.1], &[1.0])), ..PidLimits::default() };
    let found = maximize_integral_gain(&lag, PidStructure::Pi, &ws);
    assert!(matches!(found, Err(Error::PidLimitImpossible { limit: PidLimit::Robustness, .. })), "{found:?}");
    let washout = plant(&[1.0, 0.0], &[1.0, 2.0, 1.0], 0.0);
    assert_eq!(maximize_integral_gain(&washout, PidStructure::Pi, &limits), Err(Error::PidPlantZeroAtOrigin));
    for bad in [f64::NAN, 1.0, f64::INFINITY] {
        let limits = PidLimits { ms_max: bad, ..PidLimits::default() };
        assert!(matches!(
            maximize_integral_gain(&lag, PidStructure::Pi, &limits),
            Err(Error::OutOfRange { .. })
        ));
    }
    assert!(maximize_integral_gain(&lag, PidStructure::Pid { n_rad_s: 0.0 }, &PidLimits::default()).is_err());
}

#[test]
fn law_a_plant_of_negative_gain_gets_the_mirrored_controller() {
    let limits = PidLimits { ms_max: 1.7, mt_max: 1.7, ..PidLimits::default() };
    let structure = PidStructure::Pid { n_rad_s: 30.0 };
    let up = maximize_integral_gain(&plant(&[2.0], &lag_chain(3), 0.1), structure, &limits).expect("found");
    let down =
        maximize_integral_gain(&plant(&[-2.0], &lag_chain(3), 0.1), structure, &limits).expect("found");
    assert!((up.settings.i_per_s / down.settings.i_per_s + 1.0).abs() < 1e-4, "{up:?} {down:?}");
}
