//! Derivatives of the equilibrium by implicit differentiation.

use nalgebra::DVector;

use super::{Dashpots, Equilibrium, Membrane};
use crate::Error;
use crate::statics::{Cause, Control, Electric, Evaluation, Held, Linearised, Step};

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
        let voltage_v = equilibrium.voltage_v();
        let singular = Error::SingularTangent { voltage_v, displacement_m: equilibrium.displacement_m() };
        let operator = self.solver.operator();
        let (mut at, mut linear) = (Evaluation::new(operator.degree), Linearised::new(operator.degree));
        let state = equilibrium.state();
        if !at.at(operator, &self.law(dashpots), state) {
            return Err(singular);
        }
        let control =
            Control { load: Held::Displacement(at.displacement), electric: Electric::Field(state.field) };
        if !linear.factor(operator, &at, state.field, control) {
            return Err(singular);
        }
        let mut step = Step::new(operator.degree);
        let sheet = self.sheet();
        let per_length = 1.0 / sheet.length_scale_m();
        linear.response(operator, Cause::Displacement, &mut step);
        let stiffness = step.force;
        let strain_by_displacement = self.strain(equilibrium, &step, per_length);
        linear.response(operator, Cause::Field, &mut step);
        let per_v2 = sheet.force_scale_n() * sheet.field_scale_per_v2() * step.force;
        let tangent = Tangent {
            stiffness_n_per_m: sheet.force_scale_n() * per_length * stiffness,
            dforce_dvoltage_n_per_v: 2.0 * voltage_v * per_v2,
            dforce_dvoltage_squared_n_per_v2: per_v2,
        };
        let strain_by_voltage_squared = self.strain(equilibrium, &step, sheet.field_scale_per_v2());
        Ok(Sensitivity { tangent, strain_by_displacement, strain_by_voltage_squared })
    }

    /// Change of the logarithmic strains in a response, times `scale`, in flat coordinates.
    fn strain(&self, equilibrium: &Equilibrium, step: &Step, scale: f64) -> DVector<f64> {
        let state = equilibrium.state();
        self.flat_coordinates((0..state.r.len()).map(|j| {
            let theta = equilibrium.theta_rad()[j];
            let dl1 = theta.cos() * step.p[j] - theta.sin() * step.q[j];
            [scale * dl1 / equilibrium.lambda1()[j], scale * step.r[j] / state.r[j]]
        }))
    }

    /// Coordinates of a field of logarithmic strains (ln l1, ln l2) in which the energy of a branch of unit modulus, for small
    /// strains 2 pi H integral of (4 e1^2 + 4 e1 e2 + 4 e2^2)/2 R dR, is half the square of the Euclidean length.
    ///
    /// **Shapes and units**: two entries for each node, m^1.5.
    pub(crate) fn flat_coordinates(&self, field: impl Iterator<Item = [f64; 2]>) -> DVector<f64> {
        let grid = self.grid();
        let length = self.sheet().length_scale_m();
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
}
