//! Ten thousand random systems of many kinds, judged by dense LU at frequencies that the norm did not choose.

use nalgebra::DMatrix;
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::*;
use crate::eigenvalues::eigenvalues;
use crate::{Continuous, Discrete, SampleTime};

const SEED: u64 = 20_170;
const TRIALS: usize = 10_000;
const KINDS: usize = 8;
const SIZE_MAX: usize = 12;

fn matrix(rng: &mut Pcg64, rows: usize, cols: usize) -> DMatrix<f64> {
    DMatrix::from_fn(rows, cols, |_, _| rng.random_range(-1.0..1.0))
}

/// `10^x` with `x` uniform.
fn power(rng: &mut Pcg64, low: f64, high: f64) -> f64 {
    10.0_f64.powf(rng.random_range(low..high))
}

fn orthogonal(rng: &mut Pcg64, n: usize) -> DMatrix<f64> {
    matrix(rng, n, n).qr().q()
}

fn abscissa(a: &DMatrix<f64>) -> f64 {
    eigenvalues(a).expect("qr").iter().fold(f64::MIN, |m, p| m.max(p.re))
}

/// Resonances and, for odd sizes, one real pole, in coordinates that mix them.
fn flexible(rng: &mut Pcg64, n: usize, damping: (f64, f64)) -> DMatrix<f64> {
    let mut a = DMatrix::zeros(n, n);
    for i in (0..n).step_by(2) {
        let (w, zeta) = (power(rng, -1.0, 2.0), power(rng, damping.0, damping.1));
        a[(i, i)] = -2.0 * zeta * w;
        if i + 1 < n {
            a[(i, i + 1)] = w;
            a[(i + 1, i)] = -w;
        }
    }
    let q = orthogonal(rng, n);
    &q * a * q.transpose()
}

fn continuous_matrix(rng: &mut Pcg64, n: usize, kind: usize) -> DMatrix<f64> {
    match kind {
        0 | 1 => {
            let a = matrix(rng, n, n);
            let shift = abscissa(&a) + power(rng, -3.0, 0.0);
            a - DMatrix::identity(n, n) * shift
        }
        2 => flexible(rng, n, (-4.0, -1.0)),
        // Stiff: time constants over eight decades.
        3 => {
            let mut a = matrix(rng, n, n).upper_triangle();
            for i in 0..n {
                a[(i, i)] = -power(rng, -4.0, 4.0);
            }
            a
        }
        // Far from normal.
        4 => {
            let mut a = matrix(rng, n, n).upper_triangle() * 10.0;
            for i in 0..n {
                a[(i, i)] = -power(rng, 0.0, 1.0);
            }
            let q = orthogonal(rng, n);
            &q * a * q.transpose()
        }
        // Defective: one Jordan block.
        _ => DMatrix::from_fn(n, n, |i, j| if i == j { -0.5 } else { f64::from(u8::from(i + 1 == j)) }),
    }
}

/// Compares the bracket with dense LU, up to the rounding that dense LU itself may have.
fn check<D: TimeDomain>(sys: &StateSpace<D>, frequencies: &[f64], label: &str) {
    let peak = hinf_norm(sys).unwrap_or_else(|e| panic!("{label}: {e}"));
    assert!(peak.lower <= peak.value && peak.value <= peak.upper, "{label}: {peak:?}");
    let width = (peak.upper - peak.lower) / peak.value.max(1e-3);
    if width > 2e-8 {
        // Doubled precision resolves its own square times the condition, and no more.
        let condition = resolvent_condition(sys, peak.omega_rad_s);
        assert!(width <= 1e3 * f64::EPSILON * f64::EPSILON * condition, "{label}: {condition} {peak:?}");
    }
    for &omega in frequencies {
        let gain = sys.at(omega).expect("no pole on the boundary").singular_values().max();
        let rounding = 1e-9 + 100.0 * f64::EPSILON * resolvent_condition(sys, omega);
        assert!(gain <= peak.upper * (1.0 + rounding), "{label}: {gain} at {omega} beats {peak:?}");
    }
    if peak.omega_rad_s.is_finite() && sys.n_states() > 0 {
        let gain = sys.at(peak.omega_rad_s).expect("no pole on the boundary").singular_values().max();
        let rounding = 1e-9 + 100.0 * f64::EPSILON * resolvent_condition(sys, peak.omega_rad_s);
        assert!((gain - peak.value).abs() <= peak.value * rounding, "{label}: {gain} is not {peak:?}");
    }
}

/// What a relative error in `p I - A` is multiplied by in the gain.
fn resolvent_condition<D: TimeDomain>(sys: &StateSpace<D>, omega: f64) -> f64 {
    let n = sys.n_states();
    let point = sys.domain().point(omega);
    let m = sys.a().map(|v| num_complex::Complex64::new(-v, 0.0));
    let m = m + DMatrix::identity(n, n) * point;
    let inverse = m.clone().lu().try_inverse().expect("no pole on the boundary");
    let (x, y) =
        (&inverse * sys.b().map(num_complex::Complex64::from), sys.c().map(num_complex::Complex64::from));
    let gain = (&y * &x).norm().max(f64::MIN_POSITIVE);
    m.norm() * x.norm() * (y * inverse).norm() / gain
}

#[test]
fn law_ten_thousand_random_systems_are_bracketed() {
    let mut rng = Pcg64::seed_from_u64(SEED);
    let ts = SampleTime::new(0.1).expect("positive");
    for trial in 0..TRIALS {
        let kind = trial % KINDS;
        let n = 1 + rng.next_u64() as usize % SIZE_MAX;
        let (n_u, n_y) = (1 + rng.next_u64() as usize % 3, 1 + rng.next_u64() as usize % 3);
        let label = format!("seed {SEED} trial {trial} kind {kind} n {n}");
        let (b, c) = (matrix(&mut rng, n, n_u), matrix(&mut rng, n_y, n));
        let direct = [0.0, 1.0, 100.0][rng.next_u64() as usize % 3];
        let d = matrix(&mut rng, n_y, n_u) * direct;
        if kind < 6 {
            let a = continuous_matrix(&mut rng, n, kind);
            let sys = StateSpace::<Continuous>::new(a, b, c, d).expect("shapes");
            let mut frequencies: Vec<f64> = (0..12).map(|_| power(&mut rng, -4.0, 4.0)).collect();
            for pole in sys.poles().expect("qr").iter().filter(|p| p.im >= 0.0) {
                frequencies.extend([0.3, 1.1].map(|f| (pole.im + f * pole.re).abs()));
                frequencies.push(pole.norm());
            }
            check(&sys, &frequencies, &label);
        } else {
            let a = matrix(&mut rng, n, n);
            let radius = eigenvalues(&a).expect("qr").iter().fold(1e-3_f64, |m, p| m.max(p.norm()));
            let a = a * ((1.0 - power(&mut rng, -4.0, -0.3)) / radius);
            let sys = StateSpace::<Discrete>::new(a, b, c, d, ts).expect("shapes");
            let mut frequencies: Vec<f64> =
                (0..16).map(|k| f64::from(k) / 15.0 * ts.nyquist_rad_s()).collect();
            for pole in sys.poles().expect("qr").iter().filter(|p| p.im > 0.0) {
                frequencies.push(pole.arg() / ts.seconds());
            }
            check(&sys, &frequencies, &label);
        }
    }
}
