//! The model's motion together with its derivatives with respect to every parameter.

use nalgebra::DVector;

use super::model::{BRANCHES_MAX, CreepBranch, GreyBoxModel, PullTerm};
use crate::Result;

/// Powers of displacement and squared voltage of the terms that are fitted: all of total degree three and below, but the constant.
pub(super) const POWERS: [(u8, u8); 9] =
    [(1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3)];
const N_TERMS: usize = POWERS.len();
/// Terms, damping, circuit, and two for each branch.
const P_MAX: usize = N_TERMS + 2 + 2 * BRANCHES_MAX;
/// A value and its derivatives.
type Dual = [f64; 1 + P_MAX];
/// Displacement, velocity, dashpots.
type State = [Dual; 2 + BRANCHES_MAX];

/// How parameters become a model: coefficients linear in units of `omega_0^2`, all else as logarithms of their ratio to the start.
///
/// Of a branch these are first stiffness over relaxation time, then the time: of a branch that is slower than the record only the former
/// shows, and with stiffness and time as parameters the fit would creep along a bent valley.
#[derive(Debug, Clone)]
pub(super) struct Parametrization {
    /// Square of the natural frequency of the start, s^-2.
    pub omega_squared: f64,
    /// Damping of the start, s^-1.
    pub damping: f64,
    /// Circuit of the start, s.
    pub rc_s: f64,
    /// Whether the circuit is fitted.
    pub rc_is_free: bool,
    /// Branches of the start.
    pub branches: Vec<CreepBranch>,
}

/// The numbers behind a parameter vector.
struct Numbers {
    coefficients: [f64; N_TERMS],
    damping: f64,
    rc_s: f64,
    branches: Vec<CreepBranch>,
}

impl Parametrization {
    /// Length of the parameter vector.
    pub(super) fn n_parameters(&self) -> usize {
        N_TERMS + 1 + 2 * self.branches.len() + usize::from(self.rc_is_free)
    }

    fn numbers(&self, parameters: &DVector<f64>) -> Numbers {
        let n_b = self.branches.len();
        let branches = self.branches.iter().enumerate().map(|(k, start)| CreepBranch {
            stiffness_per_s2: start.stiffness_per_s2
                * (parameters[N_TERMS + 1 + k] + parameters[N_TERMS + 1 + n_b + k]).exp(),
            relaxation_time_s: start.relaxation_time_s * parameters[N_TERMS + 1 + n_b + k].exp(),
        });
        let rc_factor = if self.rc_is_free { parameters[N_TERMS + 1 + 2 * n_b].exp() } else { 1.0 };
        Numbers {
            coefficients: std::array::from_fn(|t| self.omega_squared * parameters[t]),
            damping: self.damping * parameters[N_TERMS].exp(),
            rc_s: self.rc_s * rc_factor,
            branches: branches.collect(),
        }
    }

    /// The model of a parameter vector.
    pub(super) fn model(&self, parameters: &DVector<f64>, displacement_max_mm: f64) -> Result<GreyBoxModel> {
        let numbers = self.numbers(parameters);
        let terms = POWERS.iter().zip(numbers.coefficients).map(|(&(i, j), coefficient)| PullTerm {
            displacement_power: i,
            drive_power: j,
            coefficient,
        });
        GreyBoxModel::new(
            numbers.rc_s,
            numbers.damping,
            terms.collect(),
            numbers.branches,
            displacement_max_mm,
        )
    }

    /// Displacement and its derivatives at every sample, to `each`: the value before the drive of that sample acts.
    ///
    /// **Method**: the variational equations, integrated by the same steps as the motion, so that the derivatives are those of the
    /// numerical solution.
    pub(super) fn simulate(
        &self,
        parameters: &DVector<f64>,
        drive_unit: &[f64],
        sample_time_s: f64,
        mut each: impl FnMut(&[f64]),
    ) {
        let motion = Motion {
            numbers: self.numbers(parameters),
            omega_squared: self.omega_squared,
            rc_is_free: self.rc_is_free,
        };
        let n_p = self.n_parameters();
        let mut state: State = [[0.0; 1 + P_MAX]; 2 + BRANCHES_MAX];
        let mut circuit = [0.0; 2];
        let (h, rc) = (sample_time_s, motion.numbers.rc_s);
        // e^(-t/rc) at the middle and the end of a step, and its derivative with respect to ln rc.
        let decay = [0.5, 1.0].map(|share| (-share * h / rc).exp());
        let decay_slope = [decay[0] * 0.5 * h / rc, decay[1] * h / rc];
        for &u in drive_unit {
            each(&state[0][..=n_p]);
            let at = |k: usize| {
                [u + (circuit[0] - u) * decay[k], circuit[1] * decay[k] + (circuit[0] - u) * decay_slope[k]]
            };
            let (middle, end) = (at(0), at(1));
            motion.step(&mut state, [circuit, middle, end].map(|[c, dc]| [c * c, 2.0 * c * dc]), h);
            circuit = end;
        }
    }
}

struct Motion {
    numbers: Numbers,
    omega_squared: f64,
    rc_is_free: bool,
}

impl Motion {
    /// One classical Runge-Kutta step; `w` at its start, middle and end, each with its derivative with respect to ln rc.
    fn step(&self, state: &mut State, w: [[f64; 2]; 3], h: f64) {
        let n = 2 + self.numbers.branches.len();
        let zero: State = [[0.0; 1 + P_MAX]; 2 + BRANCHES_MAX];
        let (mut sum, mut slope, mut at) = (zero, zero, *state);
        for (stage, (next_share, weight)) in
            [(0.5, 1.0), (0.5, 2.0), (1.0, 2.0), (0.0, 1.0)].into_iter().enumerate()
        {
            self.slope(&at, w[[0, 1, 1, 2][stage]], &mut slope);
            for k in 0..n {
                for q in 0..=P_MAX {
                    sum[k][q] += weight * slope[k][q];
                    at[k][q] = state[k][q] + next_share * h * slope[k][q];
                }
            }
        }
        for k in 0..n {
            for q in 0..=P_MAX {
                state[k][q] += h / 6.0 * sum[k][q];
            }
        }
    }

    fn slope(&self, at: &State, [w, dw]: [f64; 2], out: &mut State) {
        let Numbers { coefficients, damping, branches, .. } = &self.numbers;
        let (x, v) = (at[0][0], at[1][0]);
        let n_b = branches.len();
        let (powers_x, powers_w) = ([1.0, x, x * x, x * x * x], [1.0, w, w * w, w * w * w]);
        let (mut pull, mut by_x, mut by_w) = (0.0, 0.0, 0.0);
        let mut monomials = [0.0; N_TERMS];
        for (t, &(i, j)) in POWERS.iter().enumerate() {
            let (i, j) = (usize::from(i), usize::from(j));
            monomials[t] = powers_x[i] * powers_w[j];
            pull += coefficients[t] * monomials[t];
            if i > 0 {
                by_x += coefficients[t] * i as f64 * powers_x[i - 1] * powers_w[j];
            }
            if j > 0 {
                by_w += coefficients[t] * j as f64 * powers_x[i] * powers_w[j - 1];
            }
        }
        out[0] = at[1];
        for q in 0..=P_MAX {
            out[1][q] = by_x * at[0][q] - damping * at[1][q];
        }
        out[1][0] = pull - damping * v;
        for (t, monomial) in monomials.iter().enumerate() {
            out[1][1 + t] += self.omega_squared * monomial;
        }
        out[1][1 + N_TERMS] -= damping * v;
        for (k, branch) in branches.iter().enumerate() {
            let (p, rate) = (branch.stiffness_per_s2, 1.0 / branch.relaxation_time_s);
            let dashpot = at[2 + k];
            for q in 0..=P_MAX {
                let stretch = at[0][q] - dashpot[q];
                out[1][q] -= p * stretch;
                out[2 + k][q] = rate * stretch;
            }
            let stretch = x - dashpot[0];
            out[1][2 + N_TERMS + k] -= p * stretch;
            out[1][2 + N_TERMS + n_b + k] -= p * stretch;
            out[2 + k][2 + N_TERMS + n_b + k] -= rate * stretch;
        }
        if self.rc_is_free {
            out[1][2 + N_TERMS + 2 * n_b] += by_w * dw;
        }
    }
}
