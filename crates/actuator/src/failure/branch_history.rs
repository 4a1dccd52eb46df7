//! Stresses that Maxwell branches carry beside the relaxed network over a run.

use crate::MaxwellBranch;

/// Dashpots of all branches at all nodes, driven by the stretches of the relaxed membrane.
///
/// **Method**: with e_k = l_k/xi_k a neo-Hookean branch carries t_k = l_k s_k = mu_i (e_k^2 - 1/(e_1 e_2)^2).
#[derive(Debug, Clone)]
pub(super) struct BranchHistory {
    branches: Vec<MaxwellBranch>,
    /// Of each branch, (ln xi_1, ln xi_2) at each node.
    dashpots: Vec<Vec<[f64; 2]>>,
    /// (ln l_1, ln l_2) at each node where the last interval ended.
    before: Vec<[f64; 2]>,
}

/// A substep is at most this part of a branch's relaxation time.
const SUBSTEP: f64 = 0.1;
/// An interval of so many relaxation times leaves nothing of a branch.
const RELAXED: f64 = 100.0;

impl BranchHistory {
    /// Relaxed at these stretches.
    pub(super) fn relaxed(branches: &[MaxwellBranch], lambda1: &[f64], lambda2: &[f64]) -> Self {
        let before = logarithms(lambda1, lambda2);
        Self { branches: branches.to_vec(), dashpots: vec![before.clone(); branches.len()], before }
    }

    /// Goes on by `dt`, over which the logarithms of the stretches change evenly to these.
    ///
    /// **Source**: xi_1'/xi_1 = (t_1 - t_2/2)/(3 mu_i tau_i), t_k = l_k s_k of the branch: Foo, Cai, Koh, Bauer, Suo 2012.
    pub(super) fn advance(&mut self, dt: f64, lambda1: &[f64], lambda2: &[f64]) {
        let after = logarithms(lambda1, lambda2);
        for (branch, dashpots) in self.branches.iter().zip(&mut self.dashpots) {
            let tau = branch.relaxation_time_s;
            if dt > RELAXED * tau {
                dashpots.clone_from(&after);
                continue;
            }
            let n = (dt / (SUBSTEP * tau)).ceil().max(1.0);
            let h = dt / n;
            for (node, xi) in dashpots.iter_mut().enumerate() {
                let at = |part: f64| {
                    let [from, to] = [self.before[node], after[node]];
                    [0, 1].map(|k| from[k] + part * (to[k] - from[k]))
                };
                for step in 0..n as usize {
                    // Midpoint rule, of order two.
                    let start = *xi;
                    let slope = rates(at(step as f64 / n), start, tau);
                    let middle = [0, 1].map(|k| start[k] + 0.5 * h * slope[k]);
                    let slope = rates(at((step as f64 + 0.5) / n), middle, tau);
                    *xi = [0, 1].map(|k| start[k] + h * slope[k]);
                }
            }
        }
        self.before = after;
    }

    /// Nominal stresses (s_1, s_2) of all branches together at a node, Pa.
    pub(super) fn stress_pa(&self, node: usize) -> [f64; 2] {
        let log_l = self.before[node];
        self.branches.iter().zip(&self.dashpots).fold([0.0; 2], |sum, (branch, dashpots)| {
            let over_mu = kirchhoff(log_l, dashpots[node]);
            [0, 1].map(|k| sum[k] + branch.modulus_pa * over_mu[k] / log_l[k].exp())
        })
    }
}

fn logarithms(lambda1: &[f64], lambda2: &[f64]) -> Vec<[f64; 2]> {
    lambda1.iter().zip(lambda2).map(|(l1, l2)| [l1.ln(), l2.ln()]).collect()
}

/// (t_1, t_2)/mu = e_k^2 - 1/(e_1 e_2)^2 of an incompressible neo-Hookean branch, e_k = l_k/xi_k.
fn kirchhoff(log_l: [f64; 2], log_xi: [f64; 2]) -> [f64; 2] {
    let e = [0, 1].map(|k| log_l[k] - log_xi[k]);
    let third = (-2.0 * (e[0] + e[1])).exp();
    e.map(|e| (2.0 * e).exp() - third)
}

fn rates(log_l: [f64; 2], log_xi: [f64; 2], tau: f64) -> [f64; 2] {
    let [t1, t2] = kirchhoff(log_l, log_xi);
    [(t1 - 0.5 * t2) / (3.0 * tau), (t2 - 0.5 * t1) / (3.0 * tau)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_small_step_relaxes_exponentially_in_any_division() {
        let branch = MaxwellBranch { modulus_pa: 2e4, relaxation_time_s: 0.6 };
        let (from, to) = ([2.0, 1.9], [2.0 * 1.001, 1.9 * 0.9995]);
        for n in [1, 7, 40] {
            let mut history = BranchHistory::relaxed(&[branch], &from[..1], &from[1..]);
            // A jump, then a hold of one relaxation time.
            history.advance(1e-9, &to[..1], &to[1..]);
            let jump = history.stress_pa(0);
            // mu (2 e_1 + 2 (e_1 + e_2)) for small strains, over the stretch.
            let expected = 2e4 * (2.0 * 0.001 + 2.0 * (0.001 - 0.0005)) / 2.002;
            assert!((jump[0] / expected - 1.0).abs() < 2e-3, "{jump:?} {expected}");
            for _ in 0..n {
                history.advance(0.6 / f64::from(n), &to[..1], &to[1..]);
            }
            let left = history.stress_pa(0);
            // Strains of 1e-3 are linear to 1e-3; ten midpoint steps to a relaxation time add 2e-3.
            for k in 0..2 {
                assert!((left[k] / jump[k] / (-1.0_f64).exp() - 1.0).abs() < 7e-3, "{n}: {left:?} {jump:?}");
            }
        }
        let mut history = BranchHistory::relaxed(&[branch], &from[..1], &from[1..]);
        history.advance(1e-9, &to[..1], &to[1..]);
        history.advance(1e3, &to[..1], &to[1..]);
        assert_eq!(history.stress_pa(0), [0.0, 0.0]);
    }
}
