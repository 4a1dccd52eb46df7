//! Derivatives of the equilibrium by implicit differentiation.

use nalgebra::DVector;

use super::assembly::{Closure, Residual, field_derivative, force_gradient, jacobian, residual};
use super::{Dashpots, Equilibrium, Membrane};
use crate::Error;

/// Which part of the material follows a small change.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Network {
    /// All Maxwell branches have relaxed: slow changes.
    Relaxed,
    /// All Maxwell branches are held, having been relaxed at the state: fast changes.
    Frozen,
}

/// First derivatives of the force F(x, V) at an equilibrium.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tangent {
    /// dF/dx at held voltage, N/m.
    pub stiffness_n_per_m: f64,
    /// dF/dV at held displacement, N/V: negative, since voltage lowers the tension.
    pub dforce_dvoltage_n_per_v: f64,
    /// dF/d(V^2) at held displacement, N/V^2; finite at zero voltage too.
    pub dforce_dvoltage_squared_n_per_v2: f64,
}

/// A tangent with the strains behind it, in the coordinates of [`Membrane::flat_coordinates`].
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Sensitivity {
    pub(crate) tangent: Tangent,
    /// By displacement, m^1.5 per m.
    pub(crate) strain_by_displacement: DVector<f64>,
    /// By V^2, m^1.5 per V^2.
    pub(crate) strain_by_voltage_squared: DVector<f64>,
}

impl Tangent {
    /// dx/dV at held force, m/V.
    #[must_use]
    pub fn gain_m_per_v(&self) -> f64 {
        -self.dforce_dvoltage_n_per_v / self.stiffness_n_per_m
    }
}

impl Membrane {
    /// Derivatives of F(x, V) at an equilibrium of the relaxed membrane.
    ///
    /// **Method**: implicit differentiation of the collocated equations, no differences. The frozen tangent adds the branch
    /// moduli at the relaxed state: 4 mu_i/l1^2 to ds1/dl1, 2 mu_i/(l1 l2) to ds1/dl2, 4 mu_i/l2^2 to ds2/dl2.
    ///
    /// # Errors
    /// [`Error::SingularTangent`].
    pub fn tangent(&self, equilibrium: &Equilibrium, network: Network) -> Result<Tangent, Error> {
        let dashpots = match network {
            Network::Relaxed => Dashpots::absent(),
            Network::Frozen => Dashpots::relaxed_at(self, equilibrium),
        };
        self.tangent_with(equilibrium, &dashpots)
    }

    /// Derivatives of F(x, V) at an equilibrium that was solved with these dashpots, which stay where they are.
    ///
    /// # Errors
    /// [`Error::SingularTangent`].
    pub fn tangent_with(&self, equilibrium: &Equilibrium, dashpots: &Dashpots) -> Result<Tangent, Error> {
        Ok(self.sensitivity(equilibrium, dashpots)?.tangent)
    }

    /// Tangent with the change of the shape that goes with it.
    pub(crate) fn sensitivity(
        &self,
        equilibrium: &Equilibrium,
        dashpots: &Dashpots,
    ) -> Result<Sensitivity, Error> {
        let singular = Error::SingularTangent {
            voltage_v: equilibrium.voltage_v(),
            displacement_m: equilibrium.displacement_m(),
        };
        let voltage_v = equilibrium.voltage_v();
        let field = self.field_scale() * voltage_v * voltage_v;
        let closure = Closure::Displacement(equilibrium.shape().z[0]);
        let current =
            residual(self, dashpots, equilibrium.shape(), field, closure).ok_or(singular.clone())?;
        let lu = jacobian(self, &current, closure).lu();
        let gradient = force_gradient(self, &current);
        let mut unit = current.value.clone();
        unit.fill(0.0);
        let last = unit.len() - 1;
        unit[last] = 1.0;
        let by_displacement = lu.solve(&unit).ok_or(singular.clone())?;
        let partial = field_derivative(self, &current);
        let by_field = -lu.solve(&partial.residual).ok_or(singular)?;
        let force_by_field = partial.force + gradient.dot(&by_field);
        let per_v2 = self.force_scale() * self.field_scale() * force_by_field;
        let tangent = Tangent {
            stiffness_n_per_m: self.force_scale() / self.length_scale() * gradient.dot(&by_displacement),
            dforce_dvoltage_n_per_v: 2.0 * voltage_v * per_v2,
            dforce_dvoltage_squared_n_per_v2: per_v2,
        };
        Ok(Sensitivity {
            tangent,
            strain_by_displacement: self.strain(equilibrium, &by_displacement, 1.0 / self.length_scale()),
            strain_by_voltage_squared: self.strain(equilibrium, &by_field, self.field_scale()),
        })
    }

    /// Change of the logarithmic strains with the unknowns, times `scale`, in flat coordinates.
    fn strain(&self, equilibrium: &Equilibrium, unknowns: &DVector<f64>, scale: f64) -> DVector<f64> {
        let mut change = equilibrium.shape().clone();
        change.r.fill(0.0);
        change.z.fill(0.0);
        let change = change.stepped(unknowns, scale);
        let differentiation = self.grid().differentiation();
        let dr = differentiation * &change.r;
        let dz = differentiation * &change.z;
        self.flat_coordinates((0..self.grid().n_nodes()).map(|j| {
            let theta = equilibrium.theta_rad()[j];
            let dl1 = theta.cos() * dr[j] - theta.sin() * dz[j];
            [dl1 / equilibrium.lambda1()[j], change.r[j] / equilibrium.shape().r[j]]
        }))
    }

    /// Coordinates of a field of logarithmic strains (ln l1, ln l2) in which the energy of a branch of unit modulus, for small
    /// strains 2 pi H integral of (4 e1^2 + 4 e1 e2 + 4 e2^2)/2 R dR, is half the square of the Euclidean length.
    ///
    /// **Shapes and units**: two entries for each node, m^1.5.
    pub(crate) fn flat_coordinates(&self, field: impl Iterator<Item = [f64; 2]>) -> DVector<f64> {
        let grid = self.grid();
        let length = self.length_scale();
        let volume = 2.0 * std::f64::consts::PI * self.parameters().spec().thickness_m * length * length;
        let mut flat = DVector::zeros(2 * grid.n_nodes());
        for (j, [e1, e2]) in field.enumerate() {
            let root = (volume * grid.nodes()[j] * grid.weights()[j]).sqrt();
            // 4 e1^2 + 4 e1 e2 + 4 e2^2 = (2 e1 + e2)^2 + 3 e2^2.
            flat[2 * j] = root * (2.0 * e1 + e2);
            flat[2 * j + 1] = root * 3.0_f64.sqrt() * e2;
        }
        flat
    }

    pub(super) fn stiffness(&self, dashpots: &Dashpots, equilibrium: &Equilibrium) -> Result<f64, Error> {
        Ok(self.tangent_with(equilibrium, dashpots)?.stiffness_n_per_m)
    }

    /// Stiffness dF/dx from a residual, N/m.
    pub(super) fn stiffness_of(&self, current: &Residual, voltage_v: f64) -> Result<f64, Error> {
        let lu = jacobian(self, current, Closure::Displacement(0.0)).lu();
        let mut unit = current.value.clone();
        unit.fill(0.0);
        let last = unit.len() - 1;
        unit[last] = 1.0;
        let by_displacement =
            lu.solve(&unit).ok_or(Error::SingularTangent { voltage_v, displacement_m: f64::NAN })?;
        Ok(self.force_scale() / self.length_scale() * force_gradient(self, current).dot(&by_displacement))
    }
}
