//! Maxwell branches at the nodes over one implicit step: dashpots, what a stage knows of them, dissipation.

use super::radau::{Radau, STAGES};
use super::springs::{BranchStress, Pairs, Springs, pairs};
use crate::MaxwellBranch;
use crate::material::{ElasticLaw, Stress, maxwell_branch};
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
    start: Pairs,
    stages: [BranchStage; STAGES],
    /// Strains or rates of a step's stages, to be combined.
    before: [Pairs; STAGES],
    /// Rates of the sweep before.
    old: Pairs,
}

/// One branch in one stage.
#[derive(Debug, Clone, PartialEq)]
struct BranchStage {
    /// What the stage knows of the dashpots before it is solved.
    known: Pairs,
    springs: Springs,
    rates: Pairs,
}

impl Branch {
    /// Relaxed at the stretches.
    pub(super) fn relaxed(branch: MaxwellBranch, mu_pa: f64, l1: &[f64], l2: &[f64]) -> Self {
        let start = [l1, l2].map(|stretch| stretch.iter().map(|l| l.ln()).collect::<Vec<f64>>());
        let n_nodes = l1.len();
        let stage =
            || BranchStage { known: start.clone(), springs: Springs::new(n_nodes), rates: pairs(n_nodes) };
        Self {
            ratio: branch.modulus_pa / mu_pa,
            rate: 1.0 / branch.relaxation_time_s,
            stages: std::array::from_fn(|_| stage()),
            before: std::array::from_fn(|_| pairs(n_nodes)),
            old: pairs(n_nodes),
            start,
        }
    }

    /// Extrapolates strains and rates to the next step's stages.
    pub(super) fn predict(&mut self, weights: &[[f64; STAGES]; STAGES]) {
        let Self { stages, before, .. } = self;
        for (before, stage) in before.iter_mut().zip(stages.iter()) {
            copy(before, &stage.rates);
        }
        for (stage, weights) in stages.iter_mut().zip(weights) {
            for (k, rates) in stage.rates.iter_mut().enumerate() {
                for (node, rate) in rates.iter_mut().enumerate() {
                    *rate = (0..STAGES).map(|j| weights[j] * before[j][k][node]).sum();
                }
            }
        }
        for (before, stage) in before.iter_mut().zip(stages.iter()) {
            copy(before, stage.springs.strain());
        }
        for (stage, weights) in stages.iter_mut().zip(weights) {
            stage.springs.set(|k, node| (0..STAGES).map(|j| weights[j] * before[j][k][node]).sum());
        }
    }

    /// Forgets the rates: the dashpots stand still while the stretches are `l1` and `l2`.
    pub(super) fn stop(&mut self, l1: &[f64], l2: &[f64]) {
        let Self { stages, start, .. } = self;
        for stage in stages {
            for rates in &mut stage.rates {
                rates.fill(0.0);
            }
            stage.springs.set(|k, node| [l1[node], l2[node]][k].ln() - start[k][node]);
        }
    }

    /// Begins a sweep over the stages of a step of `h`: what the rates of the sweep before contribute.
    pub(super) fn begin_sweep(&mut self, radau: &Radau, h: f64) {
        for i in 0..STAGES {
            // The first column of A - L is zero.
            let (w1, w2) = (h * radau.rest[i][1], h * radau.rest[i][2]);
            for k in 0..2 {
                let mut known = std::mem::take(&mut self.stages[i].known[k]);
                let (second, third) = (&self.stages[1].rates[k], &self.stages[2].rates[k]);
                for (((value, start), a), b) in known.iter_mut().zip(&self.start[k]).zip(second).zip(third) {
                    *value = start + (w1 * a + w2 * b);
                }
                self.stages[i].known[k] = known;
            }
        }
    }

    /// Adds to stage `i` what the stages before it contribute in this sweep.
    pub(super) fn begin_stage(&mut self, radau: &Radau, h: f64, i: usize) {
        let (before, rest) = self.stages.split_at_mut(i);
        for (j, earlier) in before.iter().enumerate() {
            let w = h * radau.lower[i][j];
            for (known, rates) in rest[0].known.iter_mut().zip(&earlier.rates) {
                for (value, rate) in known.iter_mut().zip(rates) {
                    *value += w * rate;
                }
            }
        }
    }

    /// Follows the stretches with logarithms `logs` in `stage`, and adds stress and tangent over mu to `sum`.
    pub(super) fn respond(&mut self, stage: Stage, logs: &Pairs, sum: &mut BranchStress) {
        let phi = stage.diagonal_s * self.rate;
        let BranchStage { known, springs, .. } = &mut self.stages[stage.index];
        springs.relax(logs, known, phi);
        springs.add_stress(phi, self.ratio, sum);
    }

    /// Takes the rates of `stage` from its stretches; returns the largest change of a rate.
    pub(super) fn end_stage(&mut self, stage: Stage, logs: &Pairs) -> f64 {
        let BranchStage { known, springs, rates } = &mut self.stages[stage.index];
        std::mem::swap(&mut self.old, rates);
        springs.relax(logs, known, stage.diagonal_s * self.rate);
        springs.rates(self.rate, rates);
        let mut change = 0.0_f64;
        for (new, old) in rates.iter().flatten().zip(self.old.iter().flatten()) {
            change = change.max((new - old).abs());
        }
        change
    }

    /// Adds the power over mu, per undeformed volume, that is dissipated in stage `i` to `power`.
    pub(super) fn add_power(&self, i: usize, power: &mut [f64]) {
        let BranchStage { springs, rates, .. } = &self.stages[i];
        springs.add_power(rates, self.ratio, power);
    }

    /// Ends a step of `h`.
    pub(super) fn commit(&mut self, radau: &Radau, h: f64) {
        for (k, start) in self.start.iter_mut().enumerate() {
            for (node, value) in start.iter_mut().enumerate() {
                let sum: f64 = (0..STAGES).map(|j| radau.weights[j] * self.stages[j].rates[k][node]).sum();
                *value += h * sum;
            }
        }
    }

    /// Stored energy over mu, per undeformed volume, added to `energy`.
    pub(super) fn add_energy(&self, l1: &[f64], l2: &[f64], energy: &mut [f64]) {
        for (node, (l1, l2)) in l1.iter().zip(l2).enumerate() {
            let e1 = l1 * l1 * (-2.0 * self.start[0][node]).exp();
            let e2 = l2 * l2 * (-2.0 * self.start[1][node]).exp();
            energy[node] += 0.5 * self.ratio * (e1 + e2 + 1.0 / (e1 * e2) - 3.0);
        }
    }

    /// Stress over mu, and tangent, with the dashpots held as they stand.
    fn held(&self, node: usize, l1: f64, l2: f64) -> Stress {
        let mut stress = Stress::default();
        let (xi1, xi2) = (self.start[0][node].exp(), self.start[1][node].exp());
        stress.add_scaled(&maxwell_branch(l1, l2, xi1, xi2), self.ratio);
        stress
    }
}

fn copy(to: &mut Pairs, from: &Pairs) {
    for (to, from) in to.iter_mut().zip(from) {
        to.copy_from_slice(from);
    }
}

/// A stage within a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Stage {
    pub(super) index: usize,
    /// h L_ii.
    pub(super) diagonal_s: f64,
}

/// Network at the present modulus, and branches whose dashpots are held.
#[derive(Debug, Clone, Copy)]
pub(super) struct HeldLaw<'a> {
    pub(super) network: &'a ElasticLaw,
    /// All moduli over those of the parameters.
    pub(super) modulus_factor: f64,
    pub(super) branches: &'a [Branch],
}

impl PointLaw for HeldLaw<'_> {
    fn stress(&self, node: usize, l1: f64, l2: f64) -> Option<Stress> {
        let mut total = Stress::default();
        total.add_scaled(&self.network.stress(l1, l2)?, self.modulus_factor);
        for branch in self.branches {
            total.add_scaled(&branch.held(node, l1, l2), self.modulus_factor);
        }
        Some(total)
    }
}

/// Network at the present modulus, and what the branches answer in a stage.
#[derive(Debug, Clone, Copy)]
pub(super) struct StageLaw<'a> {
    pub(super) network: &'a ElasticLaw,
    /// All moduli over those of the parameters.
    pub(super) modulus_factor: f64,
    pub(super) branches: &'a BranchStress,
}

impl PointLaw for StageLaw<'_> {
    #[inline]
    fn stress(&self, node: usize, l1: f64, l2: f64) -> Option<Stress> {
        let mut total = self.branches.at(node, l1, l2);
        total.add_scaled(&self.network.stress(l1, l2)?, 1.0);
        let mut scaled = Stress::default();
        scaled.add_scaled(&total, self.modulus_factor);
        Some(scaled)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_held_dashpots_are_the_maxwell_branch_and_slow_stages_relax_it() {
        let network = ElasticLaw::NeoHookean;
        let maxwell = MaxwellBranch { modulus_pa: 2.0, relaxation_time_s: 1.0 / 3.0 };
        let branches = [Branch::relaxed(maxwell, 1.0, &[1.6], &[2.2])];
        let (l1, l2) = (2.1_f64, 1.9_f64);
        let held = HeldLaw { network: &network, modulus_factor: 1.5, branches: &branches };
        let logs = [vec![l1.ln()], vec![l2.ln()]];
        for (diagonal_s, expected) in
            [(0.0, held.stress(0, l1, l2)), (1e9, HeldLaw { branches: &[], ..held }.stress(0, l1, l2))]
        {
            let mut sum = BranchStress::new(1);
            let mut branch = branches[0].clone();
            for _ in 0..30 {
                sum.clear();
                branch.respond(Stage { index: 0, diagonal_s }, &logs, &mut sum);
            }
            let law = StageLaw { network: &network, modulus_factor: 1.5, branches: &sum };
            let (found, expected) = (law.stress(0, l1, l2).expect("positive"), expected.expect("positive"));
            let pairs = [(found.s1, expected.s1), (found.s2, expected.s2), (found.s12, expected.s12)];
            for (a, b) in pairs {
                // The slow stage has strain over phi = 3e9 left.
                assert!((a - b).abs() < 1e-8, "{diagonal_s}: {a} {b}");
            }
        }
    }
}
