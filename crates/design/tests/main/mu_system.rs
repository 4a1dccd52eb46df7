//! Uncertain systems: peaks of the structured singular value, margins and the worst gain.

use nalgebra::{DMatrix, dmatrix};
use num_complex::Complex64;
use rand::{RngExt, SeedableRng};
use telepulse_design::Error;
use telepulse_design::uncertain::{
    Block, BlockStructure, MuLowerOptions, UncertainSystem, mu_bounds, mu_peak, mu_peak_discrete,
};
use telepulse_lti::{Continuous, Discrete, SampleTime, StateSpace, hinf_norm};

fn structure(blocks: &[Block]) -> BlockStructure {
    BlockStructure::new(blocks.to_vec()).expect("blocks with ports")
}

/// A resonance beside a slow pole.
fn resonance(damping: f64) -> StateSpace<Continuous> {
    StateSpace::<Continuous>::new(
        dmatrix![0.0, 1.0, 0.0; -1.0, -2.0 * damping, 0.0; 0.0, 0.0, -0.1],
        dmatrix![0.0, 0.0; 2.0 * damping, 0.3 * damping; 0.05, 0.1],
        dmatrix![0.7, 0.2, 1.0; 0.4, 1.0, -0.5],
        dmatrix![0.0, 0.1; 0.2, 0.0],
    )
    .expect("valid")
}

#[test]
fn oracle_one_full_block_peaks_at_the_h_infinity_norm() {
    for damping in [0.3, 1e-2, 1e-5] {
        let sys = resonance(damping);
        let norm = hinf_norm(&sys).expect("stable").value;
        let peak = mu_peak(&sys, &structure(&[Block::Full { rows: 2, cols: 2 }]), 1e-4).expect("proven");
        println!("damping {damping}: {norm} {} {} {}", peak.upper, peak.lower.value, peak.intervals);
        assert!(peak.upper >= norm * (1.0 - 1e-9) && peak.upper <= norm * 1.0002);
        assert!(peak.lower.value <= norm * (1.0 + 1e-9));
    }
}

#[test]
fn law_a_narrow_resonance_is_not_missed_between_frequencies() {
    // Two scalar blocks leave no gap, so the proven peak must hold at every frequency of a very fine grid.
    let sys = resonance(1e-5);
    let s = structure(&[Block::Full { rows: 1, cols: 1 }; 2]);
    let peak = mu_peak(&sys, &s, 1e-3).expect("proven");
    let mut seen = 0.0_f64;
    for k in -2000..=2000 {
        let m = sys.at(1.0 + f64::from(k) * 1e-7).expect("no pole on the axis");
        seen = seen.max(telepulse_design::uncertain::mu_upper_bound(&m, &s).expect("finite").value);
    }
    println!("narrow: {} {seen} at {}", peak.upper, peak.omega_rad_s);
    assert!(peak.upper >= seen * (1.0 - 1e-9) && peak.upper <= seen * 1.01);
}

#[test]
fn paper_an_uncertain_pole_has_its_worst_gain_at_its_slowest() {
    // z = w / (s + 1 + 0.5 delta): the gain at zero is 1 / (1 - 0.5) = 2, and stability is lost at delta = -2.
    let m = StateSpace::<Continuous>::new(
        dmatrix![-1.0],
        dmatrix![-0.5, 1.0],
        dmatrix![1.0; 1.0],
        DMatrix::zeros(2, 2),
    )
    .expect("valid");
    for block in [Block::RepeatedReal { size: 1 }, Block::Full { rows: 1, cols: 1 }] {
        let sys = UncertainSystem::new(m.clone(), structure(&[block])).expect("ports");
        let margin = sys.robust_stability_margin(1e-4).expect("proven");
        assert!(margin.lower <= 2.0 && margin.lower > 1.999, "{margin:?}");
        let worst = sys.worst_case_gain(1e-3).expect("proven");
        println!("{block:?}: {} {}", worst.lower, worst.upper);
        assert!(worst.upper >= 2.0 && worst.upper < 2.005, "{worst:?}");
        assert!(worst.lower > 1.99 && worst.lower <= 2.0 + 1e-9, "{worst:?}");
    }
}

#[test]
fn paper_stiffness_and_damping_lose_stability_where_a_coefficient_vanishes() {
    // s² + (0.1 + 0.1 d2) s + 1 + 0.5 d1 with real d1, d2: stable until d2 = -1 or d1 = -2.
    let m = StateSpace::<Continuous>::new(
        dmatrix![0.0, 1.0; -1.0, -0.1],
        dmatrix![0.0, 0.0; -0.5, -0.1],
        dmatrix![1.0, 0.0; 0.0, 1.0],
        DMatrix::zeros(2, 2),
    )
    .expect("valid");
    let peak = mu_peak(&m, &structure(&[Block::RepeatedReal { size: 1 }; 2]), 1e-3).expect("proven");
    println!("two parameters: {} {} {}", peak.upper, peak.lower.value, peak.intervals);
    assert!(peak.upper >= 1.0 && peak.upper < 1.01, "{peak:?}");
    assert!(peak.lower.value <= 1.0 + 1e-9, "{peak:?}");
}

#[test]
fn law_no_random_perturbation_beats_the_worst_case_gain() {
    // M with a real parameter, a dynamic block and a performance port; 1e5 perturbations, constant at random frequencies.
    let m = StateSpace::<Continuous>::new(
        dmatrix![0.0, 1.0; -1.0, -0.4],
        dmatrix![0.0, 0.0, 0.0; 0.1, 0.15, 1.0],
        dmatrix![1.0, 0.0; 0.3, 0.2; 1.0, 0.1],
        dmatrix![0.0, 0.0, 0.0; 0.1, 0.0, 0.2; 0.0, 0.0, 0.0],
    )
    .expect("valid");
    let s = structure(&[Block::RepeatedReal { size: 1 }, Block::Full { rows: 1, cols: 1 }]);
    let sys = UncertainSystem::new(m.clone(), s).expect("ports");
    let worst = sys.worst_case_gain(1e-3).expect("proven");
    let check = hinf_norm(&sys.close(&worst.delta).expect("fits")).expect("stable").value;
    let size = hinf_norm(&worst.delta).expect("stable").value;
    println!("seed 61: worst {} {} at {}", worst.lower, worst.upper, worst.omega_rad_s);
    assert!(check >= worst.lower * (1.0 - 1e-9) && size <= 1.0 + 1e-9);
    assert!(worst.lower <= worst.upper * (1.0 + 1e-9));
    let mut rng = rand_pcg::Pcg64::seed_from_u64(61);
    let mut largest = 0.0_f64;
    for _ in 0..1000 {
        let response = m.at(rng.random_range(0.3_f64..2.0)).expect("no pole");
        for _ in 0..100 {
            let (a, phase) = (rng.random_range(-1.0..=1.0), rng.random_range(0.0..6.3));
            let delta = [Complex64::new(a, 0.0), Complex64::from_polar(1.0, phase)];
            // z = (M22 + M21 Delta (I - M11 Delta)^-1 M12) w by Cramer's rule.
            let p = |i: usize, j: usize| {
                response[(i, j)] * if j < 2 { delta[j] } else { Complex64::new(1.0, 0.0) }
            };
            let one = Complex64::new(1.0, 0.0);
            let det = (one - p(0, 0)) * (one - p(1, 1)) - p(0, 1) * p(1, 0);
            let z0 = ((one - p(1, 1)) * p(0, 2) + p(0, 1) * p(1, 2)) / det;
            let z1 = ((one - p(0, 0)) * p(1, 2) + p(1, 0) * p(0, 2)) / det;
            largest = largest.max((p(2, 2) + p(2, 0) * z0 + p(2, 1) * z1).norm());
        }
    }
    println!("random search reaches {largest}");
    assert!(largest <= worst.upper, "seed 61: {largest} {}", worst.upper);
    assert!(worst.lower > 0.98 * largest, "seed 61: {largest} {}", worst.lower);
}

#[test]
fn edge_an_unstable_or_misfitting_system_is_refused() {
    let unstable = StateSpace::<Continuous>::new(dmatrix![1.0], dmatrix![1.0], dmatrix![1.0], dmatrix![0.0])
        .expect("valid");
    let s = structure(&[Block::Full { rows: 1, cols: 1 }]);
    assert!(mu_peak(&unstable, &s, 1e-3).is_err());
    assert!(
        mu_peak(&StateSpace::<Continuous>::from_gain(dmatrix![0.5]).expect("valid"), &s, f64::NAN).is_err()
    );
    assert!(UncertainSystem::new(unstable, s).is_err());
}

/// `I - M Delta` at a frequency: its smallest singular value.
fn distance_to_singular(m: &DMatrix<Complex64>, delta: &DMatrix<Complex64>) -> f64 {
    (DMatrix::identity(m.nrows(), m.nrows()) - m * delta).singular_values().min()
}

#[test]
fn law_the_frequency_of_a_peak_is_that_of_its_example() {
    for blocks in [
        [Block::Full { rows: 1, cols: 1 }, Block::Full { rows: 1, cols: 1 }],
        [Block::RepeatedReal { size: 1 }, Block::Full { rows: 1, cols: 1 }],
    ] {
        let (sys, s) = (resonance(0.02), structure(&blocks));
        let peak = mu_peak(&sys, &s, 1e-3).expect("proven");
        let delta = peak.lower.perturbation.as_ref().expect("found").matrix(&s).expect("fits");
        let m = sys.at(peak.omega_rad_s).expect("no pole on the axis");
        // A search to 1e-7 of the bounds, on matrices of size one.
        assert!(distance_to_singular(&m, &delta) < 1e-6, "{peak:?}");
        let binding = sys.at(peak.upper_omega_rad_s).expect("no pole on the axis");
        let bound = telepulse_design::uncertain::mu_upper_bound(&binding, &s).expect("finite").value;
        assert!(bound <= peak.upper * (1.0 + 1e-9) && bound >= peak.upper / 1.0011, "{bound} {peak:?}");
    }
}

#[test]
fn law_a_sampled_peak_holds_on_a_grid_of_the_unit_circle_and_has_its_example_there() {
    let dt = SampleTime::new(0.02).expect("positive");
    let s = structure(&[Block::RepeatedReal { size: 1 }, Block::Full { rows: 1, cols: 1 }]);
    let mut rng = rand_pcg::Pcg64::seed_from_u64(17);
    for case in 0..20 {
        // Poles within 0.95: a rotation and a real one, mixed by a random similarity.
        let (radius, turn): (f64, f64) = (rng.random_range(0.3..0.95), rng.random_range(0.1..3.0));
        let (re, im) = (radius * turn.cos(), radius * turn.sin());
        let poles = dmatrix![re, im, 0.0; -im, re, 0.0; 0.0, 0.0, rng.random_range(-0.9..0.9)];
        let mut part = |rows, cols| DMatrix::<f64>::from_fn(rows, cols, |_, _| rng.random_range(-1.0..1.0));
        let mix = DMatrix::identity(3, 3) + part(3, 3) * 0.25;
        let a = mix.clone() * poles * mix.try_inverse().expect("near the identity");
        let sys = StateSpace::<Discrete>::new(a, part(3, 2), part(2, 3), part(2, 2), dt).expect("consistent");
        let peak = mu_peak_discrete(&sys, &s, 1e-3).expect("proven");
        let mut seen = 0.0_f64;
        for k in 0..=500 {
            let omega = dt.nyquist_rad_s() * f64::from(k) / 500.0;
            let found = mu_bounds(&sys.at(omega).expect("stable"), &s, &MuLowerOptions::default());
            seen = seen.max(found.expect("finite").lower.value);
        }
        // What an example shows, no proof may deny.
        assert!(seen <= peak.upper * (1.0 + 1e-9), "seed 17 case {case}: {seen} {peak:?}");
        assert!((0.0..=dt.nyquist_rad_s() * (1.0 + 1e-12)).contains(&peak.omega_rad_s));
        if let Some(example) = &peak.lower.perturbation {
            let m = sys.at(peak.omega_rad_s).expect("stable");
            let distance = distance_to_singular(&m, &example.matrix(&s).expect("fits"));
            assert!(distance < 1e-6, "seed 17 case {case}: {distance} {peak:?}");
        }
    }
}

#[test]
fn edge_a_sampled_system_with_a_pole_on_the_unit_circle_is_refused_with_it() {
    let dt = SampleTime::new(0.1).expect("positive");
    let s = structure(&[Block::Full { rows: 1, cols: 1 }]);
    for pole in [1.0, -1.0, 1.5] {
        let sys =
            StateSpace::<Discrete>::new(dmatrix![pole], dmatrix![1.0], dmatrix![1.0], dmatrix![0.0], dt)
                .expect("consistent");
        match mu_peak_discrete(&sys, &s, 1e-3) {
            Err(Error::System(telepulse_lti::Error::Unstable { pole: found })) => {
                assert_eq!(found, Complex64::new(pole, 0.0));
            }
            other => panic!("{pole}: {other:?}"),
        }
    }
}

#[test]
fn law_the_performance_margin_is_kept_by_samples_and_lost_by_its_own_perturbation() {
    let m = StateSpace::<Continuous>::new(
        dmatrix![0.0, 1.0; -1.0, -0.4],
        dmatrix![0.0, 0.0, 0.0; 0.3, 0.25, 0.5],
        dmatrix![1.0, 0.0; 0.3, 0.2; 1.0, 0.1],
        dmatrix![0.0, 0.0, 0.0; 0.1, 0.0, 0.2; 0.0, 0.0, 0.0],
    )
    .expect("valid");
    let s = structure(&[Block::RepeatedReal { size: 1 }, Block::Full { rows: 1, cols: 1 }]);
    let sys = UncertainSystem::new(m.clone(), s).expect("ports");
    let margin = sys.robust_performance_margin(1e-3).expect("proven");
    let stability = sys.robust_stability_margin(1e-3).expect("proven");
    assert!(margin.lower < stability.upper, "performance is harder to keep than stability");
    // Below: no constant perturbation smaller than k, at any of the frequencies, brings the gain to 1 / k.
    let seed = 67;
    let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
    let one = Complex64::new(1.0, 0.0);
    let mut largest = 0.0_f64;
    for _ in 0..1000 {
        let response = m.at(10.0_f64.powf(rng.random_range(-2.0..1.5))).expect("no pole");
        for _ in 0..20 {
            let (a, phase) = (rng.random_range(-1.0..=1.0), rng.random_range(0.0..6.3));
            let delta = DMatrix::from_diagonal(&nalgebra::dvector![
                Complex64::new(margin.lower * a, 0.0),
                Complex64::from_polar(margin.lower, phase)
            ]);
            let part = |r, c, nr, nc| response.view((r, c), (nr, nc)).into_owned();
            let inner = (DMatrix::identity(2, 2) * one - part(0, 0, 2, 2) * &delta)
                .try_inverse()
                .expect("stable for perturbations this small");
            let gain =
                (part(2, 2, 1, 1) + part(2, 0, 1, 2) * &delta * inner * part(0, 2, 2, 1))[(0, 0)].norm();
            largest = largest.max(gain * margin.lower);
        }
    }
    assert!(largest < 1.0, "seed {seed}: {largest}");
    // Above: the perturbation that was found, performance block included, makes the loop singular.
    let whole = structure(&[
        Block::RepeatedReal { size: 1 },
        Block::Full { rows: 1, cols: 1 },
        Block::Full { rows: 1, cols: 1 },
    ]);
    let found = &margin.peak.lower;
    let delta = found.perturbation.as_ref().expect("an example was found").matrix(&whole).expect("fits");
    let response = m.at(margin.peak.omega_rad_s).expect("no pole");
    let det = (DMatrix::identity(3, 3) * one - response * &delta).determinant().norm();
    let size = delta.singular_values().max();
    println!("performance margin {} .. {}, sampled to {largest}", margin.lower, margin.upper);
    assert!(det < 1e-8, "{det}");
    assert!((size - margin.upper).abs() < 1e-8 * size && margin.upper >= margin.lower, "{size} {margin:?}");
    assert!(margin.upper < 1.05 * margin.lower, "{margin:?}");
}
