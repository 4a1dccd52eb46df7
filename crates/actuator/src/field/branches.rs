//! Maxwell branches at the nodes over one implicit stage: dashpots, stress with its consistent tangent, dissipation.

use super::radau::{Radau, STAGES};
use crate::MaxwellBranch;
use crate::material::{ElasticLaw, Stress};
use crate::statics::PointLaw;

/// One branch at all nodes.
///
/// **Shapes and units**: the logarithmic stretches (ln xi1, ln xi2) of the dashpots, one pair for each node; rates in 1/s.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Branch {
    /// Modulus over mu.
    ratio: f64,
    /// 1/tau.
    rate: f64,
    start: Vec<[f64; 2]>,
    /// What a stage knows of them before it is solved.
    known: [Vec<[f64; 2]>; STAGES],
    /// xi^-2 of what the present stage knows.
    inverse_squares: Vec<[f64; 2]>,
    rates: [Vec<[f64; 2]>; STAGES],
}

impl Branch {
    /// Relaxed at the stretches.
    pub(super) fn relaxed(branch: MaxwellBranch, mu_pa: f64, l1: &[f64], l2: &[f64]) -> Self {
        let start: Vec<[f64; 2]> = l1.iter().zip(l2).map(|(l1, l2)| [l1.ln(), l2.ln()]).collect();
        let still = vec![[0.0; 2]; start.len()];
        Self {
            ratio: branch.modulus_pa / mu_pa,
            rate: 1.0 / branch.relaxation_time_s,
            known: std::array::from_fn(|_| start.clone()),
            rates: std::array::from_fn(|_| still.clone()),
            inverse_squares: still,
            start,
        }
    }

    /// Extrapolates the rates to the next step's stages.
    pub(super) fn predict(&mut self, weights: &[[f64; STAGES]; STAGES]) {
        for node in 0..self.start.len() {
            for k in 0..2 {
                let old: [f64; STAGES] = std::array::from_fn(|j| self.rates[j][node][k]);
                for (rates, weights) in self.rates.iter_mut().zip(weights) {
                    rates[node][k] = weights.iter().zip(&old).map(|(w, f)| w * f).sum();
                }
            }
        }
    }

    /// Forgets the rates.
    pub(super) fn stop(&mut self) {
        for rates in &mut self.rates {
            rates.fill([0.0; 2]);
        }
    }

    /// Begins a sweep over the stages of a step of `h`: what the rates of the sweep before contribute.
    pub(super) fn begin_sweep(&mut self, radau: &Radau, h: f64) {
        for (i, known) in self.known.iter_mut().enumerate() {
            // The first column of A - L is zero.
            let w: [f64; STAGES] = std::array::from_fn(|j| h * radau.rest[i][j]);
            for (node, value) in known.iter_mut().enumerate() {
                let (start, second, third) = (self.start[node], self.rates[1][node], self.rates[2][node]);
                *value = std::array::from_fn(|k| start[k] + (w[1] * second[k] + w[2] * third[k]));
            }
        }
    }

    /// Adds to stage `i` what the stages before it contribute in this sweep.
    pub(super) fn begin_stage(&mut self, radau: &Radau, h: f64, i: usize) {
        for j in 0..i {
            let w = h * radau.lower[i][j];
            for (value, rate) in self.known[i].iter_mut().zip(&self.rates[j]) {
                value[0] += w * rate[0];
                value[1] += w * rate[1];
            }
        }
        self.square(i);
    }

    fn square(&mut self, i: usize) {
        for (square, known) in self.inverse_squares.iter_mut().zip(&self.known[i]) {
            *square = [(-2.0 * known[0]).exp(), (-2.0 * known[1]).exp()];
        }
    }

    /// Takes the rates of stage `i` from its stretches; returns the largest change of a rate, and adds the dissipated power
    /// over mu, per undeformed volume, to `power`.
    pub(super) fn end_stage(&mut self, stage: Stage, l1: &[f64], l2: &[f64], power: &mut [f64]) -> f64 {
        let mut change = 0.0_f64;
        for (node, (l1, l2)) in l1.iter().zip(l2).enumerate() {
            let known = self.inverse_squares[node];
            let spring =
                Spring::solve([l1 * l1 * known[0], l2 * l2 * known[1]], stage.diagonal_s * self.rate);
            let [t1, t2] = spring.kirchhoff();
            let third = self.rate / 3.0;
            let rates = [third * (t1 - 0.5 * t2), third * (t2 - 0.5 * t1)];
            let old = std::mem::replace(&mut self.rates[stage.index][node], rates);
            change = change.max((rates[0] - old[0]).abs()).max((rates[1] - old[1]).abs());
            power[node] += self.ratio * (t1 * rates[0] + t2 * rates[1]);
        }
        change
    }

    /// Ends a step of `h`.
    pub(super) fn commit(&mut self, radau: &Radau, h: f64) {
        for (node, value) in self.start.iter_mut().enumerate() {
            for (k, value) in value.iter_mut().enumerate() {
                let sum: f64 = (0..STAGES).map(|j| radau.weights[j] * self.rates[j][node][k]).sum();
                *value += h * sum;
            }
        }
    }

    /// Uses the dashpots as they stand now, for a solve at an instant.
    pub(super) fn hold(&mut self) {
        let Self { start, known, .. } = self;
        known[STAGES - 1].copy_from_slice(start);
        self.square(STAGES - 1);
    }

    /// Stored energy over mu, per undeformed volume, added to `energy`.
    pub(super) fn add_energy(&self, l1: &[f64], l2: &[f64], energy: &mut [f64]) {
        for (node, (l1, l2)) in l1.iter().zip(l2).enumerate() {
            let e1 = l1 * l1 * (-2.0 * self.start[node][0]).exp();
            let e2 = l2 * l2 * (-2.0 * self.start[node][1]).exp();
            energy[node] += 0.5 * self.ratio * (e1 + e2 + 1.0 / (e1 * e2) - 3.0);
        }
    }
}

/// A stage within a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Stage {
    pub(super) index: usize,
    /// h L_ii: how long the stage's own rate acts.
    pub(super) diagonal_s: f64,
}

/// What a node feels within a stage: the network, and branches whose dashpots move with it.
#[derive(Debug, Clone, Copy)]
pub(super) struct StageLaw<'a> {
    pub(super) network: &'a ElasticLaw,
    /// All moduli over those of the parameters.
    pub(super) modulus_factor: f64,
    pub(super) branches: &'a [Branch],
    pub(super) stage: Stage,
}

impl PointLaw for StageLaw<'_> {
    #[inline]
    fn stress(&self, node: usize, l1: f64, l2: f64) -> Option<Stress> {
        let network = self.network.stress(l1, l2)?;
        if self.branches.is_empty() && self.modulus_factor == 1.0 {
            return Some(network);
        }
        let mut total = Stress::default();
        total.add_scaled(&network, self.modulus_factor);
        let (square1, square2) = (l1 * l1, l2 * l2);
        let (i1, i2) = (1.0 / l1, 1.0 / l2);
        for branch in self.branches {
            let [known1, known2] = branch.inverse_squares[node];
            let spring =
                Spring::solve([square1 * known1, square2 * known2], self.stage.diagonal_s * branch.rate);
            total.add_scaled(&spring.stress(i1, i2), self.modulus_factor * branch.ratio);
        }
        Some(total)
    }
}

/// A branch's neo-Hookean spring of unit modulus at the end of a stage.
///
/// **Method**: with the logarithmic strains e = ln(l/xi) and t_k = l_k s_k, the stage's e + phi M t(e) = trial, phi = h L_ii/tau, is
/// solved by Newton. M is symmetric, so the stage has a potential and its tangent by ln l, (T^-1 + phi M)^-1, is symmetric.
///
/// **Source**: rates by Foo, Cai, Koh, Bauer, Suo 2012: M = [1, -1/2; -1/2, 1]/3.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Spring {
    /// exp(2 e1), exp(2 e2), exp(-2 e1 - 2 e2).
    squares: [f64; 3],
    phi: f64,
}

/// Bound of Newton's error after a step of size d, phi d^2, at which iteration ends.
const LAST_ERROR: f64 = 1e-15;
/// From the linear solution one or two steps do.
const MAX_STEPS: usize = 50;
/// Largest change of a logarithmic strain in one step.
const LARGEST_STEP: f64 = 0.5;

impl Spring {
    /// The spring whose squared stretches would be `trial` if its dashpot did not move in this stage.
    #[inline]
    fn solve(trial: [f64; 2], phi: f64) -> Self {
        let mut spring = Self { squares: [trial[0], trial[1], 1.0 / (trial[0] * trial[1])], phi };
        if phi == 0.0 {
            return spring;
        }
        let third = phi / 3.0;
        let [t1, t2] = spring.kirchhoff();
        // d = e - trial = -phi M t(e); for small strains M t = e.
        let part = -third / (1.0 + phi);
        let mut moved = [part * (t1 - 0.5 * t2), part * (t2 - 0.5 * t1)];
        let large = moved[0].abs().max(moved[1].abs());
        if large > LARGEST_STEP {
            moved = moved.map(|value| value * LARGEST_STEP / large);
        }
        spring.squares = stretched(&spring.squares, moved);
        for _ in 0..MAX_STEPS {
            let [t1, t2] = spring.kirchhoff();
            let r1 = moved[0] + third * (t1 - 0.5 * t2);
            let r2 = moved[1] + third * (t2 - 0.5 * t1);
            let [j11, j12, j21, j22] = spring.jacobian();
            let inverse = 1.0 / (j11 * j22 - j12 * j21);
            let mut step = [inverse * (j12 * r2 - j22 * r1), inverse * (j21 * r1 - j11 * r2)];
            let size = step[0].abs().max(step[1].abs());
            if size > LARGEST_STEP {
                step = step.map(|value| value * LARGEST_STEP / size);
            }
            moved = [moved[0] + step[0], moved[1] + step[1]];
            spring.squares = stretched(&spring.squares, step);
            if phi.min(1.0) * size * size < LAST_ERROR {
                break;
            }
        }
        spring
    }

    /// t_k = l_k s_k.
    #[inline]
    fn kirchhoff(&self) -> [f64; 2] {
        let [e1, e2, e3] = self.squares;
        [e1 - e3, e2 - e3]
    }

    /// I + phi M T, with T = dt/de.
    #[inline]
    fn jacobian(&self) -> [f64; 4] {
        let [e1, e2, e3] = self.squares;
        let third = self.phi / 3.0;
        // M T = (2/3) [e1 + e3/2, (e3 - e2)/2; (e3 - e1)/2, e2 + e3/2].
        [1.0 + third * (2.0 * e1 + e3), third * (e3 - e2), third * (e3 - e1), 1.0 + third * (2.0 * e2 + e3)]
    }

    /// Nominal stress and consistent tangent at inverse stretches `i1`, `i2`.
    #[inline]
    fn stress(&self, i1: f64, i2: f64) -> Stress {
        let [e1, e2, e3] = self.squares;
        let [t1, t2] = self.kirchhoff();
        let [j11, j12, j21, j22] = self.jacobian();
        let inverse = 1.0 / (j11 * j22 - j12 * j21);
        // H = T J^-1 with T = 2 [e1 + e3, e3; e3, e2 + e3].
        let (a, b, d) = (2.0 * (e1 + e3), 2.0 * e3, 2.0 * (e2 + e3));
        let h11 = inverse * (a * j22 - b * j21);
        let h12 = inverse * (b * j11 - a * j12);
        let h22 = inverse * (d * j11 - b * j12);
        Stress {
            s1: t1 * i1,
            s2: t2 * i2,
            s11: (h11 - t1) * i1 * i1,
            s12: h12 * i1 * i2,
            s22: (h22 - t2) * i2 * i2,
        }
    }
}

/// Squares after a change of the logarithmic strains.
#[inline]
fn stretched(squares: &[f64; 3], by: [f64; 2]) -> [f64; 3] {
    let (e1, e2) = (squares[0] * exp(2.0 * by[0]), squares[1] * exp(2.0 * by[1]));
    [e1, e2, 1.0 / (e1 * e2)]
}

/// exp(x), by its series where a few terms give all digits.
#[inline]
fn exp(x: f64) -> f64 {
    if x.abs() < 0.01 {
        // x^7/5040 < 2e-18.
        let cubic = 1.0 / 6.0 + x * (1.0 / 24.0 + x * (1.0 / 120.0 + x / 720.0));
        1.0 + x * (1.0 + x * (0.5 + x * cubic))
    } else {
        x.exp()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::maxwell_branch;

    fn branch(known: [f64; 2], rate: f64) -> Branch {
        let maxwell = MaxwellBranch { modulus_pa: 2.0, relaxation_time_s: 1.0 / rate };
        Branch::relaxed(maxwell, 1.0, &[known[0].exp()], &[known[1].exp()])
    }

    #[test]
    fn law_held_dashpots_are_the_maxwell_branch_and_slow_stages_relax_it() {
        let network = ElasticLaw::NeoHookean;
        let mut branches = [branch([0.5, 0.8], 3.0)];
        branches[0].square(0);
        let (l1, l2) = (2.1, 1.9);
        let law = |diagonal_s| StageLaw {
            network: &network,
            modulus_factor: 1.5,
            branches: &branches,
            stage: Stage { index: 0, diagonal_s },
        };
        let found = law(0.0).stress(0, l1, l2).expect("positive");
        let mut expected = Stress::default();
        expected.add_scaled(&network.stress(l1, l2).expect("positive"), 1.5);
        expected.add_scaled(&maxwell_branch(l1, l2, 0.5_f64.exp(), 0.8_f64.exp()), 3.0);
        for (a, b) in [(found.s1, expected.s1), (found.s2, expected.s2), (found.s12, expected.s12)] {
            assert!((a - b).abs() < 1e-13, "{a} {b}");
        }
        let slow = law(1e9).stress(0, l1, l2).expect("positive");
        let relaxed = network.stress(l1, l2).expect("positive");
        // Left over: strain over phi = 3e9.
        assert!((slow.s1 - 1.5 * relaxed.s1).abs() < 1e-8 && (slow.s2 - 1.5 * relaxed.s2).abs() < 1e-8);
    }

    #[test]
    fn law_stage_tangent_is_the_slope_of_the_stage_stress_and_symmetric() {
        let network = ElasticLaw::Gent { limit: 110.0 };
        for phi in [0.003, 0.7, 40.0] {
            let mut branches = [branch([0.3, 0.9], phi)];
            branches[0].square(1);
            let law = StageLaw {
                network: &network,
                modulus_factor: 1.0,
                branches: &branches,
                stage: Stage { index: 1, diagonal_s: 1.0 },
            };
            let (l1, l2, d) = (2.2, 1.8, 1e-5);
            let at = |d1: f64, d2: f64| law.stress(0, l1 + d1, l2 + d2).expect("inside");
            let here = at(0.0, 0.0);
            let slope =
                |f: &dyn Fn(Stress) -> f64, d1: f64, d2: f64| (f(at(d1, d2)) - f(at(-d1, -d2))) / (2.0 * d);
            for (found, expected) in [
                (here.s11, slope(&|s| s.s1, d, 0.0)),
                (here.s12, slope(&|s| s.s1, 0.0, d)),
                (here.s12, slope(&|s| s.s2, d, 0.0)),
                (here.s22, slope(&|s| s.s2, 0.0, d)),
            ] {
                // Central differences: 1e-10 times third derivatives, rounding 1e-15/1e-5.
                assert!(
                    (found - expected).abs() < 2e-9 * (1.0 + expected.abs()),
                    "{phi}: {found} {expected}"
                );
            }
        }
    }
}
