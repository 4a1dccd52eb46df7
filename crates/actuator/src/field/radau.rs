//! The Radau IIA method of three stages, solved stage after stage.

/// Stages of the method.
pub(super) const STAGES: usize = 3;

/// Coefficients of the method of order five.
///
/// **Method**: collocation at the right Radau points. It is L-stable (stiff branches and circuits are damped, not rung), its
/// last stage is the end of the step (the membrane is in equilibrium there), and its weights are positive, so a power that is
/// never negative adds up to an energy that never falls.
///
/// The stages are coupled by the full matrix A. With Crout's factors A = L U, U of unit diagonal, the sweep
/// `y_i = y_0 + h sum_j (A - L)_ij f_j(old) + h sum_(j <= i) L_ij f_j(new)` has one implicit stage at a time and converges fast
/// for all y' = z y with Re z <= 0.
///
/// **Source**: Hairer and Wanner 1996, Solving Ordinary Differential Equations II, section IV.5; the iteration is that of
/// van der Houwen and de Swart 1997.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Radau {
    pub(super) nodes: [f64; STAGES],
    pub(super) weights: [f64; STAGES],
    /// L.
    pub(super) lower: [[f64; STAGES]; STAGES],
    /// A - L.
    pub(super) rest: [[f64; STAGES]; STAGES],
}

impl Radau {
    pub(super) fn new() -> Self {
        let r = 6.0_f64.sqrt();
        let a = [
            [(88.0 - 7.0 * r) / 360.0, (296.0 - 169.0 * r) / 1800.0, (-2.0 + 3.0 * r) / 225.0],
            [(296.0 + 169.0 * r) / 1800.0, (88.0 + 7.0 * r) / 360.0, (-2.0 - 3.0 * r) / 225.0],
            [(16.0 - r) / 36.0, (16.0 + r) / 36.0, 1.0 / 9.0],
        ];
        let (mut lower, mut upper) = ([[0.0; STAGES]; STAGES], [[0.0; STAGES]; STAGES]);
        for j in 0..STAGES {
            for i in j..STAGES {
                lower[i][j] = a[i][j] - (0..j).map(|k| lower[i][k] * upper[k][j]).sum::<f64>();
            }
            for i in j + 1..STAGES {
                let known: f64 = (0..j).map(|k| lower[j][k] * upper[k][i]).sum();
                upper[j][i] = (a[j][i] - known) / lower[j][j];
            }
        }
        let rest = std::array::from_fn(|i| std::array::from_fn(|j| a[i][j] - lower[i][j]));
        Self { nodes: [(4.0 - r) / 10.0, (4.0 + r) / 10.0, 1.0], weights: a[STAGES - 1], lower, rest }
    }

    /// Weights `[i][j]` that extrapolate a quadratic through the stages of a step to stage i of the next one, which is `ratio`
    /// times as long.
    pub(super) fn extrapolation(&self, ratio: f64) -> [[f64; STAGES]; STAGES] {
        let c = &self.nodes;
        std::array::from_fn(|i| {
            let t = 1.0 + ratio * c[i];
            std::array::from_fn(|j| {
                (0..STAGES).filter(|&k| k != j).map(|k| (t - c[k]) / (c[j] - c[k])).product()
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Step of y' = z y from 1 by the sweeps; `[end, sweeps]`.
    fn linear_step(z: f64) -> [f64; 2] {
        let radau = Radau::new();
        let mut rates = [z; STAGES];
        for sweep in 1..=60 {
            let old = rates;
            for i in 0..STAGES {
                let known: f64 = (0..STAGES).map(|j| radau.rest[i][j] * old[j]).sum::<f64>()
                    + (0..i).map(|j| radau.lower[i][j] * rates[j]).sum::<f64>();
                rates[i] = z * (1.0 + known) / (1.0 - z * radau.lower[i][i]);
            }
            let change = (0..STAGES).map(|i| (rates[i] - old[i]).abs()).fold(0.0, f64::max);
            if change < 1e-13 * (1.0 + z.abs()) {
                let end = 1.0 + (0..STAGES).map(|j| radau.weights[j] * rates[j]).sum::<f64>();
                return [end, f64::from(sweep)];
            }
        }
        panic!("no convergence at z = {z}");
    }

    #[test]
    fn law_sweeps_reach_the_methods_own_stability_function() {
        for z in [-0.05, -0.9, -5.0, -100.0, -1e6, 0.1] {
            let [end, sweeps] = linear_step(z);
            // Pade (2, 3) of exp(z): (1 + 2z/5 + z^2/20)/(1 - 3z/5 + 3z^2/20 - z^3/60).
            let expected = (1.0 + 0.4 * z + z * z / 20.0) / (1.0 - 0.6 * z + 0.15 * z * z - z * z * z / 60.0);
            // Rounding of rates of size z that cancel in the end value.
            assert!((end - expected).abs() < 1e-12 * (1.0 + z.abs()), "{z}: {end} {expected}");
            assert!(sweeps <= 40.0, "{z}: {sweeps} sweeps");
        }
    }

    #[test]
    fn law_weights_are_positive_and_exact_to_degree_four() {
        let radau = Radau::new();
        assert!(radau.weights.iter().all(|b| *b > 0.0));
        for degree in 0..5 {
            let sum: f64 = radau.nodes.iter().zip(&radau.weights).map(|(c, b)| b * c.powi(degree)).sum();
            assert!((sum - 1.0 / f64::from(degree + 1)).abs() < 1e-15);
        }
        let weights = radau.extrapolation(0.5);
        for (i, row) in weights.iter().enumerate() {
            let value: f64 = row.iter().zip(&radau.nodes).map(|(w, c)| w * (c * c - 3.0 * c)).sum();
            let t = 1.0 + 0.5 * radau.nodes[i];
            assert!((value - (t * t - 3.0 * t)).abs() < 1e-12);
        }
    }
}
