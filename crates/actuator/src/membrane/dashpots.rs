//! Where the dashpots of the Maxwell branches stand, and how they move.

use super::{Equilibrium, Membrane};
use crate::material::{ElasticLaw, Stress, maxwell_branch};
use crate::statics::PointLaw;

/// Where the dashpots of all Maxwell branches stand, at every node. Without branches the membrane is relaxed.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Dashpots {
    branches: Vec<DashpotField>,
}

#[derive(Debug, Clone, PartialEq)]
struct DashpotField {
    /// Branch modulus over mu.
    modulus_ratio: f64,
    /// (xi1, xi2) at each node.
    stretches: Vec<[f64; 2]>,
}

impl Dashpots {
    /// No branch carries stress, at any deformation: the relaxed network alone.
    #[must_use]
    pub fn absent() -> Self {
        Self::default()
    }

    /// Rates of all dashpots at a state of the membrane.
    ///
    /// **Source**: Foo et al. 2012: xi1'/xi1 = (t1 - t2/2)/(3 mu_i tau_i) with t_k = l_k s_k of the branch, and 1, 2
    /// exchanged.
    #[must_use]
    pub fn rates(&self, membrane: &Membrane, state: &Equilibrium) -> DashpotRates {
        let branches = self
            .branches
            .iter()
            .zip(&membrane.parameters.spec().branches)
            .map(|(field, branch)| {
                let scale = 1.0 / (3.0 * branch.relaxation_time_s);
                field
                    .stretches
                    .iter()
                    .zip(state.lambda1().iter().zip(state.lambda2()))
                    .map(|(&[xi1, xi2], (&l1, &l2))| {
                        let s = maxwell_branch(l1, l2, xi1, xi2);
                        let (t1, t2) = (l1 * s.s1, l2 * s.s2);
                        [scale * xi1 * (t1 - 0.5 * t2), scale * xi2 * (t2 - 0.5 * t1)]
                    })
                    .collect()
            })
            .collect();
        DashpotRates { branches }
    }

    /// Moves all dashpots by `duration_s` times their rates.
    pub fn advance(&mut self, rates: &DashpotRates, duration_s: f64) {
        for (field, rate) in self.branches.iter_mut().zip(&rates.branches) {
            for (stretch, rate) in field.stretches.iter_mut().zip(rate) {
                stretch[0] += duration_s * rate[0];
                stretch[1] += duration_s * rate[1];
            }
        }
    }

    /// All branches of the membrane's parameters, relaxed at `equilibrium`: they carry no stress there.
    #[must_use]
    pub fn relaxed_at(membrane: &Membrane, equilibrium: &Equilibrium) -> Self {
        let mu_pa = membrane.parameters.spec().mu_pa;
        let stretches: Vec<[f64; 2]> =
            equilibrium.lambda1().iter().zip(equilibrium.lambda2()).map(|(&l1, &l2)| [l1, l2]).collect();
        let branches = membrane
            .parameters
            .spec()
            .branches
            .iter()
            .map(|branch| DashpotField {
                modulus_ratio: branch.modulus_pa / mu_pa,
                stretches: stretches.clone(),
            })
            .collect();
        Self { branches }
    }
}

/// Rates of the dashpots' stretches, 1/s, per branch and node.
#[derive(Debug, Clone, PartialEq)]
pub struct DashpotRates {
    branches: Vec<Vec<[f64; 2]>>,
}

/// The network with its branches, whose dashpots stand still: what a node feels at one instant.
#[derive(Debug, Clone, Copy)]
pub(super) struct BranchedLaw<'a> {
    pub(super) network: &'a ElasticLaw,
    pub(super) dashpots: &'a Dashpots,
}

impl PointLaw for BranchedLaw<'_> {
    #[inline]
    fn stress(&self, node: usize, l1: f64, l2: f64) -> Option<Stress> {
        let mut stress = self.network.stress(l1, l2)?;
        for branch in &self.dashpots.branches {
            let [xi1, xi2] = branch.stretches[node];
            stress.add_scaled(&maxwell_branch(l1, l2, xi1, xi2), branch.modulus_ratio);
        }
        Some(stress)
    }
}
