//! Numbers that follow from the paper's printed formulas.

mod control_loop;
mod norms;
mod pid;
mod plant;
mod reference;
mod systems;

use telepulse_lti::TransferFunction;

/// Asserts that a number rounds to the figure as printed: the tolerance is half a unit of the last printed digit, and a
/// rounding error of the test's own (1e-9 relative) so that a figure which is exact in its last digit is not refused.
pub fn assert_rounds_to(found: f64, printed: &str) {
    let value: f64 = printed.parse().unwrap();
    let decimals = printed.split_once('.').map_or(0, |(_, digits)| digits.len());
    let half_unit = 0.5 * 0.1f64.powi(i32::try_from(decimals).unwrap());
    assert!((found - value).abs() <= half_unit + 1e-9 * value.abs(), "{found} does not round to {printed}");
}

/// A point at which a function of frequency has an extreme value.
pub struct Extreme {
    pub value: f64,
    pub frequency_hz: f64,
}

/// The largest value between two frequencies: a scan of 20000 points, 1e-3 relative apart or closer, then golden section
/// in the bracket that it leaves.
pub fn largest_between(from_hz: f64, to_hz: f64, f: impl Fn(f64) -> f64) -> Extreme {
    let points = 20_000;
    let grid = |k: i32| from_hz * (to_hz / from_hz).powf(f64::from(k) / f64::from(points));
    let best = (0..=points).max_by(|&k, &l| f(grid(k)).total_cmp(&f(grid(l)))).unwrap();
    let (mut low, mut high) = (grid((best - 1).max(0)), grid((best + 1).min(points)));
    let ratio = 0.5 * (5.0f64.sqrt() - 1.0);
    for _ in 0..60 {
        let (left, right) = (high - ratio * (high - low), low + ratio * (high - low));
        if f(left) > f(right) { high = right } else { low = left }
    }
    let frequency_hz = 0.5 * (low + high);
    Extreme { value: f(frequency_hz), frequency_hz }
}

/// The first frequency after `from_hz` at which a function falls below a level: steps of 0.01 Hz, then bisection.
pub fn first_fall_below(level: f64, from_hz: f64, f: impl Fn(f64) -> f64) -> f64 {
    let step = 0.01;
    let passed = (1..10_000).map(|k| from_hz + step * f64::from(k)).find(|&hz| f(hz) < level).unwrap();
    let (mut above, mut below) = (passed - step, passed);
    for _ in 0..50 {
        let middle = 0.5 * (above + below);
        if f(middle) < level { below = middle } else { above = middle }
    }
    0.5 * (above + below)
}

/// The slowest pole: the one with the largest real part.
pub fn slowest_pole_re(tf: &TransferFunction) -> f64 {
    tf.poles().unwrap().iter().map(|pole| pole.re).fold(f64::NEG_INFINITY, f64::max)
}

/// Angular frequency in rad/s of a frequency in Hz.
pub fn rad_s(frequency_hz: f64) -> f64 {
    std::f64::consts::TAU * frequency_hz
}
