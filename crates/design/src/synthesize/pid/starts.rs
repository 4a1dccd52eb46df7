//! Stabilising gains to start a search from.

use num_complex::Complex64;

use super::DelayedPlant;
use super::convex_step::{Gains, Samples};
use super::stability::Characteristic;
use crate::Result;

/// Gains that stabilise the plant, with the largest ratio of a peak to its limit.
#[derive(Debug, Clone, Copy)]
pub(super) struct Start {
    pub(super) gains: Gains,
    pub(super) violation: f64,
}

/// Stabilising gains on a coarse net: loops through a given phase margin at a given crossover, weak integral action, and
/// where none of these is stable a wide net over all gains.
pub(super) fn starts(plant: &DelayedPlant, samples: &Samples) -> Result<Vec<Start>> {
    let mut candidates = Vec::new();
    let stride = (samples.rows.len() / CROSSOVERS).max(1);
    for row in samples.rows.iter().step_by(stride) {
        let g = plant.at(row.omega);
        for margin_deg in MARGINS_DEG {
            candidates.extend(through_margin(g, row.omega, margin_deg, samples.n_rad_s));
        }
        // Weak integral action alone, crossing at this frequency if the plant is flat below.
        candidates.push([0.0, samples.sign * row.omega / g.norm(), 0.0]);
    }
    let mut found = keep_stabilizing(plant, samples, &candidates)?;
    if found.is_empty() {
        found = keep_stabilizing(plant, samples, &wide_net(plant, samples))?;
    }
    Ok(found)
}

/// Whether these gains stabilise the plant; a loop that cannot be judged does not count as stable.
pub(super) fn stabilizes(plant: &DelayedPlant, samples: &Samples, gains: Gains) -> Result<bool> {
    let controller = samples.settings(gains).transfer_function()?;
    let characteristic = Characteristic::new(plant.rational(), &controller, plant.delay_s());
    Ok(gains[1] * samples.sign > 0.0 && matches!(characteristic.n_unstable(), Ok(0)))
}

fn keep_stabilizing(plant: &DelayedPlant, samples: &Samples, candidates: &[Gains]) -> Result<Vec<Start>> {
    let mut found = Vec::new();
    for &gains in candidates {
        if gains.iter().all(|v| v.is_finite()) && stabilizes(plant, samples, gains)? {
            found.push(Start { gains, violation: samples.violation(gains) });
        }
    }
    Ok(found)
}

/// Controllers with `L(j omega) = e^{j(margin - 180 degrees)}`: PI, and with a filter PID with a double zero.
fn through_margin(g: Complex64, omega: f64, margin_deg: f64, n_rad_s: f64) -> Vec<Gains> {
    let wanted = Complex64::from_polar(1.0, (margin_deg - 180.0).to_radians()) / g;
    // P + I/(j omega): real part P, imaginary part -I/omega.
    let mut found = vec![[wanted.re, -wanted.im * omega, 0.0]];
    if n_rad_s > 0.0 {
        // P + I/(j omega) + D f with f = j omega N/(j omega + N) and P, I, D of a double zero at 1/t:
        // the phase of (1 + j omega t)^2/(j omega (1 + j omega/N)) fixes t.
        for turn in [0.0, std::f64::consts::PI] {
            let phase = (wanted.arg() + turn + std::f64::consts::FRAC_PI_2 + (omega / n_rad_s).atan())
                .rem_euclid(std::f64::consts::TAU);
            let t = (0.5 * phase).tan() / omega;
            if phase < std::f64::consts::PI && t > 0.0 {
                found.push(double_zero(t, wanted.norm() * turn.cos(), omega, n_rad_s));
            }
        }
    }
    found
}

/// Parallel gains of `k (1 + s t)^2 / (s (1 + s/N))` with modulus `size` (and its sign) at `omega`.
pub(super) fn double_zero(t: f64, size: f64, omega: f64, n_rad_s: f64) -> Gains {
    let k = size * omega * (1.0 + (omega / n_rad_s).powi(2)).sqrt() / (1.0 + (omega * t).powi(2));
    // k (1 + s t)^2 N = (P + D N) s^2 + (P N + I) s + I N
    let p = 2.0 * t * k - k / n_rad_s;
    [p, k, k * t * t - p / n_rad_s]
}

fn wide_net(plant: &DelayedPlant, samples: &Samples) -> Vec<Gains> {
    let stride = (samples.rows.len() / NET).max(1);
    let mut net = Vec::new();
    for row in samples.rows.iter().step_by(stride) {
        for size in [0.2, 0.5, 1.0, 2.0, 5.0] {
            let p = size / plant.at(row.omega).norm();
            for sign in [1.0, -1.0] {
                let derivatives =
                    if samples.n_rad_s > 0.0 { &[0.0, 0.1, 0.3, 1.0, 3.0, 10.0][..] } else { &[0.0] };
                for derivative in derivatives {
                    for integral in [1e-4, 1e-2, 0.1] {
                        let i = samples.sign * p * integral * row.omega;
                        net.push([sign * p, i, sign * p * derivative / row.omega]);
                    }
                }
            }
        }
    }
    net
}

const CROSSOVERS: usize = 50;
const MARGINS_DEG: [f64; 6] = [30.0, 45.0, 60.0, 75.0, 90.0, 105.0];
const NET: usize = 25;
