//! From a controller to what runs.

use std::f64::consts::TAU;

use nalgebra::DMatrix;
use num_complex::Complex64;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use telepulse_design::Error;
use telepulse_design::implement::{
    Discretization, ModalDelta, PreviewFeedforward, PreviewOptions, preview_feedforward, realize_continuous,
    realize_discrete,
};
use telepulse_lti::{SampleTime, StateSpace, TransferFunction, polynomial};

/// Eq. (16).
fn printed_plant() -> TransferFunction {
    TransferFunction::new(&[1350.14], &[0.0045, 1.07182, 22.458, 1444.0]).expect("proper")
}

/// Eq. (21).
fn printed_controller() -> TransferFunction {
    let numerator = [30.4975, 1232.4466, 81241.5075];
    TransferFunction::new(&numerator, &[1.0, 17.5212, 5833.5515, 3.6648]).expect("proper")
}

fn sample_time(seconds: f64) -> SampleTime {
    SampleTime::new(seconds).expect("positive")
}

/// Largest relative difference of two responses over `n` frequencies from 0.01 rad/s to just below Nyquist.
fn difference(t: f64, found: impl Fn(f64) -> Complex64, expected: impl Fn(f64) -> Complex64) -> f64 {
    let top = 3.1 / t;
    (0..=400)
        .map(|k| 0.01 * (top / 0.01).powf(f64::from(k) / 400.0))
        .map(|w| (found(w) - expected(w)).norm() / expected(w).norm())
        .fold(0.0, f64::max)
}

/// K at the frequency that the bilinear map sends to w.
fn tustin(controller: &TransferFunction, t: f64, w: f64) -> Complex64 {
    controller.at(2.0 / t * (0.5 * w * t).tan())
}

#[test]
fn paper_eq21_in_modal_delta_form_is_its_tustin_image() {
    let controller = printed_controller();
    for t in [1e-4, 5e-4, 1e-3] {
        let done = realize_continuous(&controller.to_state_space(), sample_time(t), Discretization::Tustin)
            .expect("distinct poles");
        let off = difference(t, |w| done.law.at(w), |w| tustin(&controller, t, w));
        assert!(off < 1e-12, "{off} at {t} s");
        assert!(done.law.is_stable());
        assert_eq!((done.law.real.len(), done.law.complex.len()), (1, 1));
    }
}

#[test]
fn paper_eq21_prewarped_is_exact_at_its_frequency() {
    let controller = printed_controller();
    let how = Discretization::TustinPrewarped { omega_rad_s: 73.0 };
    let done =
        realize_continuous(&controller.to_state_space(), sample_time(2e-3), how).expect("distinct poles");
    let off = (done.law.at(73.0) - controller.at(73.0)).norm() / controller.at(73.0).norm();
    assert!(off < 1e-12, "{off}");
}

/// The modes with every coefficient rounded to single precision.
fn in_single_precision(law: &ModalDelta) -> ModalDelta {
    let mut rounded = law.clone();
    let round = |v: &mut f64| *v = f64::from(*v as f32);
    for m in &mut rounded.real {
        [&mut m.lambda, &mut m.b, &mut m.c].into_iter().for_each(round);
    }
    for m in &mut rounded.complex {
        let ([b0, b1], [c0, c1]) = (&mut m.b, &mut m.c);
        [&mut m.sigma, &mut m.omega, b0, b1, c0, c1].into_iter().for_each(round);
    }
    round(&mut rounded.d);
    rounded
}

/// The same controller as a quotient of polynomials in z with coefficients in single precision, as a companion form holds them.
fn companion_in_single_precision(law: &ModalDelta) -> impl Fn(f64) -> Complex64 + use<> {
    let real = law.real.iter().map(|m| Complex64::new(1.0 + m.lambda, 0.0));
    let pairs = law.complex.iter().flat_map(|m| {
        let p = Complex64::new(1.0 + m.sigma, m.omega);
        [p, p.conj()]
    });
    let denominator = polynomial::from_roots(&real.chain(pairs).collect::<Vec<_>>()).expect("pairs");
    // Numerator: n+1 values of (response x denominator) on the unit circle determine it.
    let n = denominator.len();
    let node = |k: usize| Complex64::from_polar(1.0, TAU * (k as f64 + 0.5) / n as f64);
    let value = |k: usize| {
        let angle = TAU * (k as f64 + 0.5) / n as f64;
        law.at(angle / law.sample_time_s) * polynomial::evaluate(&denominator, node(k))
    };
    let numerator: Vec<f64> = (0..n)
        .map(|power| {
            (0..n).map(|k| value(k) * node(k).powi(-(power as i32))).sum::<Complex64>().re / n as f64
        })
        .rev()
        .collect();
    let round = |c: Vec<f64>| c.into_iter().map(|v| f64::from(v as f32)).collect::<Vec<_>>();
    let (numerator, denominator, t) = (round(numerator), round(denominator), law.sample_time_s);
    move |w| {
        let z = Complex64::from_polar(1.0, w * t);
        polynomial::evaluate(&numerator, z) / polynomial::evaluate(&denominator, z)
    }
}

#[test]
fn paper_eq21_survives_single_precision_as_modes_but_not_as_a_companion_form() {
    let t = 1e-4;
    let done =
        realize_continuous(&printed_controller().to_state_space(), sample_time(t), Discretization::Tustin)
            .expect("distinct poles");
    let law = &done.law;
    let modal = in_single_precision(law);
    let modes_off = difference(t, |w| modal.at(w), |w| law.at(w));
    assert!(modes_off < 3e-6, "modal delta form is off by {modes_off}");
    // The slow pole 1 - 6.3e-8 is closer to 1 than single precision resolves: the gain at rest falls by four orders of
    // magnitude (measured: 32 500), and at 72 rad/s, near the resonance, the response still is wrong by more than itself.
    let companion = companion_in_single_precision(law);
    let lost = law.at(1e-3).norm() / companion(1e-3).norm();
    assert!(lost > 1e4, "companion form loses a factor {lost}");
    assert!((companion(72.4) - law.at(72.4)).norm() > law.at(72.4).norm());
}

#[test]
fn law_random_controllers_keep_their_response() {
    for seed in 0..200 {
        let mut random = Pcg64::seed_from_u64(seed);
        let n = random.random_range(1..=8);
        // Stable by shifting the spectrum left of its largest real part.
        let raw = DMatrix::from_fn(n, n, |_, _| random.random_range(-100.0..100.0));
        let b = DMatrix::from_fn(n, 1, |_, _| random.random_range(-1.0..1.0));
        let c = DMatrix::from_fn(1, n, |_, _| random.random_range(-1.0..1.0));
        let d = DMatrix::from_element(1, 1, random.random_range(-1.0..1.0));
        let rightmost = raw.complex_eigenvalues().iter().map(|p| p.re).fold(f64::MIN, f64::max);
        let a = raw - DMatrix::identity(n, n) * (rightmost + random.random_range(0.01..50.0));
        let controller = StateSpace::<telepulse_lti::Continuous>::new(a, b, c, d).expect("shapes");
        let t = sample_time(1e-3);
        let sampled = controller.to_discrete_tustin(t).expect("stable");
        for done in [realize_continuous(&controller, t, Discretization::Tustin), realize_discrete(&sampled)] {
            let done = done.expect("distinct poles");
            // Response of the state-space Tustin image, which knows nothing of modes; the pole condition
            // magnifies its rounding.
            let off = difference(1e-3, |w| done.law.at(w), |w| sampled.at(w).expect("no pole")[(0, 0)]);
            assert!(off < 1e-9 * done.condition, "seed {seed}: {off}, condition {}", done.condition);
            assert!(done.law.is_stable(), "seed {seed}");
        }
    }
}

#[test]
fn edge_controllers_without_modal_form_are_refused() {
    let t = sample_time(1e-3);
    let double = TransferFunction::new(&[1.0], &[1.0, 6.0, 9.0]).expect("proper").to_state_space();
    let found = realize_continuous(&double, t, Discretization::Tustin);
    assert!(matches!(found, Err(Error::ModesIllConditioned { .. })), "{found:?}");
    let two = StateSpace::<telepulse_lti::Continuous>::from_gain(DMatrix::identity(2, 2)).expect("finite");
    let found = realize_continuous(&two, t, Discretization::Tustin);
    assert!(matches!(found, Err(Error::NotSiso { n_inputs: 2, n_outputs: 2 })));
    let fast = TransferFunction::new(&[1.0], &[1.0, -2000.0]).expect("proper").to_state_space();
    let found = realize_continuous(&fast, t, Discretization::Tustin);
    assert!(matches!(found, Err(Error::PoleAtTwoOverT { .. })), "{found:?}");
}

const TICK_S: f64 = 5e-4;

/// The filter's drive applied to (16), integrated by the classical Runge-Kutta rule with ten steps per held sample.
fn tracked(filter: &PreviewFeedforward, reference: &[f64]) -> Vec<f64> {
    let slope = |x: [f64; 3], u: f64| {
        [x[1], 1444.0 * (x[2] - x[0]) - 15.96 * x[1], (1350.14 / 1444.0 * u - x[2]) / 0.0045]
    };
    let plus = |x: [f64; 3], k: [f64; 3], h: f64| [0, 1, 2].map(|i| x[i] + h * k[i]);
    let mut x = [reference[0], 0.0, reference[0]];
    let mut y = Vec::new();
    for u in filter.apply(reference) {
        y.push(x[0]);
        for _ in 0..10 {
            let h = TICK_S / 10.0;
            let k1 = slope(x, u);
            let k2 = slope(plus(x, k1, h / 2.0), u);
            let k3 = slope(plus(x, k2, h / 2.0), u);
            let k4 = slope(plus(x, k3, h), u);
            x = [0, 1, 2].map(|i| x[i] + h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]));
        }
    }
    y
}

/// Largest error over peak-to-peak of the reference, second half of the run.
fn worst_error(reference: &[f64], y: &[f64]) -> f64 {
    let half = reference.len() / 2;
    let span =
        |v: &[f64]| v.iter().fold(f64::MIN, |m, x| m.max(*x)) - v.iter().fold(f64::MAX, |m, x| m.min(*x));
    let error = reference[half..].iter().zip(&y[half..]).map(|(r, y)| (r - y).abs()).fold(0.0, f64::max);
    error / span(reference)
}

#[test]
fn paper_eq25_is_tracked_without_lag_on_eq16() {
    let filter = preview_feedforward(&printed_plant(), sample_time(TICK_S), &PreviewOptions::default());
    let filter = filter.expect("designs");
    let reference: Vec<f64> = (0..80_000)
        .map(|k| f64::from(k) * TICK_S)
        .map(|t| {
            0.2 * (0.2 * TAU * t + 0.75 * TAU).sin()
                + 0.2 * (0.05 * TAU * t + 0.5 * TAU).sin()
                + 0.1 * (0.4 * TAU * t + 0.25 * TAU).sin()
        })
        .collect();
    let worst = worst_error(&reference, &tracked(&filter, &reference));
    assert!(worst < 2e-4, "{worst}");
}

#[test]
fn law_a_pulse_is_tracked_without_lag() {
    // 1.3 Hz, a steep systolic rise and a dicrotic wave: harmonics up to the eighth, 10.4 Hz.
    let pulse = |t: f64| {
        [
            (1.0, 0.0),
            (0.62, -0.9),
            (0.4, -1.9),
            (0.22, -2.8),
            (0.12, -3.4),
            (0.06, -4.1),
            (0.03, -5.0),
            (0.015, -5.7),
        ]
        .iter()
        .enumerate()
        .map(|(n, (a, phase))| 0.3 * a * (TAU * 1.3 * (n as f64 + 1.0) * t + phase).sin())
        .sum::<f64>()
    };
    let reference: Vec<f64> = (0..12_000).map(|k| pulse(f64::from(k) * TICK_S)).collect();
    for delay_ticks in [0_usize, 4] {
        let options = PreviewOptions { delay_s: delay_ticks as f64 * TICK_S, ..PreviewOptions::default() };
        let filter = preview_feedforward(&printed_plant(), sample_time(TICK_S), &options).expect("designs");
        let y = tracked(&filter, &reference);
        // The simulated loop has no dead time of its own: it is put behind the plant.
        let late: Vec<f64> = (0..y.len()).map(|k| y[k.saturating_sub(delay_ticks)]).collect();
        let worst = worst_error(&reference, &late);
        assert!(worst < 2e-3, "{worst} with {delay_ticks} ticks of dead time");
    }
}
