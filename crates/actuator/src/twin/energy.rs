//! What a twin holds.

use super::Twin;
use super::branch_reduction::branch_point;
use super::surface::{slope, value};

impl Twin {
    /// Energy of the moving parts, J, relative to the settled state at zero voltage: kinetic, membrane and branches, minus
    /// the work of weight. Constant voltage only: the electrical co-energy is part of the membrane's.
    #[must_use]
    pub fn energy_j(&self) -> f64 {
        let half = self.model.x_axis.half();
        let (x, v) = (self.motion.x, self.motion.v);
        let y = self.model.normalized_v2(self.membrane_voltage_v());
        let slice = self.model.force.slice(y);
        let (u, excess) = self.clamped(x);
        let rest = self.model.x_axis.normalized(self.model.rest_sag);
        // Gauss-Legendre with 6 points is exact for the map's degree 7.
        let membrane: f64 = GAUSS
            .iter()
            .map(|(node, weight)| {
                let at = rest + (u - rest) * 0.5 * (1.0 + node);
                0.5 * weight * value(&slice, at)
            })
            .sum::<f64>()
            * (u - rest)
            * half
            + half * excess * (value(&slice, u) + 0.5 * excess * slope(&slice, u));
        let point = branch_point(&self.model.branches.slice(y), u, excess);
        let moduli = self.model.parameters.spec().branches.iter().map(|b| b.modulus_pa);
        let dashpots = self.motion.zeta.map(|z| [z.1, z.2, z.3]);
        let load: f64 = moduli.clone().zip(&dashpots).map(|(m, z)| m * (z[0] - point.strain[0])).sum();
        let internal = load / (point.stiffness + self.model.parameters.branch_modulus_pa());
        let mut branches = 0.5 * internal * internal * point.stiffness;
        for (modulus, zeta) in moduli.zip(&dashpots) {
            for (k, z) in zeta.iter().enumerate() {
                let total = point.strain[k] + if k == 0 { internal } else { 0.0 };
                branches += 0.5 * modulus * (total - z) * (total - z);
            }
        }
        let mass = self.load.mass_kg;
        let weight = mass * self.model.parameters.spec().gravity_m_per_s2;
        0.5 * mass * v * v + membrane + branches - weight * (x - self.model.rest_sag)
    }
}

/// Nodes and weights of 6-point Gauss-Legendre quadrature on -1..1. Source: Abramowitz and Stegun, table 25.4.
const GAUSS: [(f64, f64); 6] = [
    (-0.932_469_514_203_152, 0.171_324_492_379_170),
    (-0.661_209_386_466_265, 0.360_761_573_048_139),
    (-0.238_619_186_083_197, 0.467_913_934_572_691),
    (0.238_619_186_083_197, 0.467_913_934_572_691),
    (0.661_209_386_466_265, 0.360_761_573_048_139),
    (0.932_469_514_203_152, 0.171_324_492_379_170),
];
