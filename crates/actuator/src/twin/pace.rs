//! What a step of one length needs to know: exact weights of decaying memory.

use super::arithmetic::PerTwin;
use crate::{ActuatorParameters, MAX_BRANCHES};

/// Weights of a quantity given at the start, the middle and the end of a step, under a decaying memory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Quadrature {
    pub(super) start: f64,
    pub(super) middle: f64,
    pub(super) end: f64,
}

/// Integral of e^(-r(1 - s)) s^n over 0..1 (`order` 1), or of (1 - e^(-r(1 - s)))/r s^n (`order` 2).
///
/// **Method**: the power series sum of (-r)^k n!/(n + k + order)! for small r, recursion in n for large: each where the other
/// loses digits.
fn moment(r: f64, n: u32, order: u32) -> f64 {
    if r < 0.5 {
        let mut term =
            (1..=n).map(f64::from).product::<f64>() / (1..=n + order).map(f64::from).product::<f64>();
        let mut sum = term;
        // 0.5^16/16! is below 1e-17.
        for k in 1..=16 {
            term *= -r / f64::from(n + k + order);
            sum += term;
        }
        return sum;
    }
    if order == 2 {
        return (1.0 / f64::from(n + 1) - moment(r, n, 1)) / r;
    }
    let first = -(-r).exp_m1() / r;
    (1..=n).fold(first, |below, k| (1.0 - f64::from(k) * below) / r)
}

/// Integrates the parabola through start, middle and end against the kernel of [`moment`].
pub(super) fn parabola(r: f64, order: u32) -> Quadrature {
    let [m0, m1, m2] = [0, 1, 2].map(|n| moment(r, n, order));
    Quadrature { start: m0 - 3.0 * m1 + 2.0 * m2, middle: 4.0 * (m1 - m2), end: 2.0 * m2 - m1 }
}

/// Everything about a step that depends on its length alone.
///
/// ```text
/// zeta_i(h) = decay_i zeta_i(0) + start_i E(0) + middle_i E(h/2) + end_i E(h)      exact for parabolic E
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pace<O> {
    /// exp(-h/(2 RC)).
    pub(super) circuit_half: O,
    /// The branches; those from `n_branches` on do not exist.
    pub(super) branches: [BranchPace<O>; MAX_BRANCHES],
    pub(super) n_branches: usize,
    /// Sums over branches of modulus times weight: what of E at that time is already in the dashpots.
    pub(super) half_start: O,
    pub(super) full_start: O,
    pub(super) full_middle: O,
    /// Sum of the moduli less the weight of E at the end: the modulus that E meets at the middle and at the end.
    pub(super) half_modulus: O,
    pub(super) full_modulus: O,
    /// The damped plate: x(h/2) = x + v glide_half + g push_half, and x(h) = x + v glide + g push for constant g.
    pub(super) glide_half: O,
    pub(super) push_half: O,
    pub(super) glide: O,
    pub(super) push: O,
    /// The same for parabolic g: x(h) = x + v glide + sum of g moves, v(h) = v brake + sum of g kicks.
    pub(super) moves: [O; 3],
    pub(super) brake: O,
    pub(super) kicks: [O; 3],
}

/// What a step does to the dashpot of one branch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct BranchPace<O> {
    /// Modulus times decay over half a step, and over a whole one.
    pub(super) held_half: O,
    pub(super) held: O,
    pub(super) decay: O,
    pub(super) start: O,
    pub(super) middle: O,
    pub(super) end: O,
}

impl<O: PerTwin> Pace<O> {
    /// Steps of `h` seconds.
    pub(super) fn new(twins: &[PaceOf], h: f64) -> Self {
        let each = |f: &dyn Fn(&PaceOf) -> f64| O::gather(|k| f(&twins[k]));
        let sum = |f: &dyn Fn(f64, f64) -> f64| {
            each(&|p| (0..MAX_BRANCHES).map(|i| f(p.modulus[i], p.rate[i])).sum())
        };
        // Over half a step E is taken as linear: e^(-r(1 - s)) r against 1 - s and s.
        let half_end = |rate: f64| 0.5 * h * rate * moment(0.5 * h * rate, 1, 1);
        let half_start = |rate: f64| 0.5 * h * rate * moment(0.5 * h * rate, 0, 1) - half_end(rate);
        let full = |rate: f64| {
            let (r, q) = (h * rate, parabola(h * rate, 1));
            Quadrature { start: r * q.start, middle: r * q.middle, end: r * q.end }
        };
        let branches = std::array::from_fn(|i| {
            let branch = |f: &dyn Fn(f64, f64) -> f64| each(&|p| f(p.modulus[i], p.rate[i]));
            BranchPace {
                held_half: branch(&|modulus, rate| modulus * (-0.5 * h * rate).exp()),
                held: branch(&|modulus, rate| modulus * (-h * rate).exp()),
                decay: branch(&|_, rate| (-h * rate).exp()),
                start: branch(&|_, rate| full(rate).start),
                middle: branch(&|_, rate| full(rate).middle),
                end: branch(&|_, rate| full(rate).end),
            }
        });
        let exists = |i: &usize| twins.iter().any(|p| p.modulus[*i] > 0.0);
        let kick = |p: &PaceOf| parabola(p.damping_rate * h, 1);
        let shift = |p: &PaceOf| parabola(p.damping_rate * h, 2);
        Self {
            circuit_half: each(&|p| (-0.5 * h / p.rc_s).exp()),
            branches,
            n_branches: (0..MAX_BRANCHES).filter(exists).count(),
            half_start: sum(&|modulus, rate| modulus * half_start(rate)),
            full_start: sum(&|modulus, rate| modulus * full(rate).start),
            full_middle: sum(&|modulus, rate| modulus * full(rate).middle),
            half_modulus: sum(&|modulus, rate| modulus * (1.0 - half_end(rate))),
            full_modulus: sum(&|modulus, rate| modulus * (1.0 - full(rate).end)),
            glide_half: each(&|p| 0.5 * h * moment(0.5 * h * p.damping_rate, 0, 1)),
            push_half: each(&|p| 0.25 * h * h * moment(0.5 * h * p.damping_rate, 0, 2)),
            glide: each(&|p| h * moment(h * p.damping_rate, 0, 1)),
            push: each(&|p| h * h * moment(h * p.damping_rate, 0, 2)),
            moves: [
                each(&|p| h * h * shift(p).start),
                each(&|p| h * h * shift(p).middle),
                each(&|p| h * h * shift(p).end),
            ],
            brake: each(&|p| (-h * p.damping_rate).exp()),
            kicks: [each(&|p| h * kick(p).start), each(&|p| h * kick(p).middle), each(&|p| h * kick(p).end)],
        }
    }
}

/// What of one twin decides its pace.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PaceOf {
    pub(super) modulus: [f64; MAX_BRANCHES],
    /// 1/tau; zero where there is no branch.
    pub(super) rate: [f64; MAX_BRANCHES],
    pub(super) rc_s: f64,
    /// Damping over mass, 1/s.
    pub(super) damping_rate: f64,
}

impl PaceOf {
    pub(super) fn new(parameters: &ActuatorParameters, mass_kg: f64) -> Self {
        let spec = parameters.spec();
        let mut of = Self {
            modulus: [0.0; MAX_BRANCHES],
            rate: [0.0; MAX_BRANCHES],
            rc_s: spec.rc_s,
            damping_rate: spec.damping_n_s_per_m / mass_kg,
        };
        for (idx, branch) in spec.branches.iter().enumerate() {
            of.modulus[idx] = branch.modulus_pa;
            of.rate[idx] = 1.0 / branch.relaxation_time_s;
        }
        of
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_weights_agree_with_numerical_quadrature() {
        // Midpoint rule with 20000 panels: error below 1e-9 r^2.
        let n = 20_000;
        for r in [0.0, 1e-5, 0.03, 0.49, 0.51, 4.0, 60.0] {
            let (one, two) = (parabola(r, 1), parabola(r, 2));
            let mut sums = [[0.0; 3]; 2];
            for k in 0..n {
                let s = (f64::from(k) + 0.5) / f64::from(n);
                let shapes = [(1.0 - s) * (1.0 - 2.0 * s), 4.0 * s * (1.0 - s), s * (2.0 * s - 1.0)];
                let left = r * (1.0 - s);
                let glide = if r == 0.0 { 1.0 - s } else { -(-left).exp_m1() / r };
                for (j, shape) in shapes.iter().enumerate() {
                    sums[0][j] += (-left).exp() * shape / f64::from(n);
                    sums[1][j] += glide * shape / f64::from(n);
                }
            }
            for (found, expected) in [(one, sums[0]), (two, sums[1])] {
                for (a, b) in [found.start, found.middle, found.end].into_iter().zip(expected) {
                    assert!((a - b).abs() < 1e-9 * (1.0 + r * r), "r = {r}: {a} {b}");
                }
            }
        }
    }
}
