//! A solved state of the membrane and what follows from it.

use nalgebra::DVector;

use super::assembly::Shape;
use super::newton::Converged;
use super::{Dashpots, Membrane, PointState};
use crate::Error;

/// A state of the membrane in equilibrium.
///
/// **Shapes and units**: fields are given at the collocation nodes, from the plate to the frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Equilibrium {
    shape: Shape,
    displacement_m: f64,
    force_n: f64,
    voltage_v: f64,
    capacitance_f: f64,
    field_max_v_per_m: f64,
    radius_undeformed_m: Vec<f64>,
    lambda1: Vec<f64>,
    lambda2: Vec<f64>,
    theta_rad: Vec<f64>,
    s1_pa: Vec<f64>,
    s2_pa: Vec<f64>,
    residual: f64,
    iterations: usize,
}

impl Membrane {
    /// Evaluates all fields of a converged shape.
    pub(super) fn equilibrium(
        &self,
        dashpots: &Dashpots,
        converged: Converged,
        field: f64,
        voltage_v: f64,
    ) -> Result<Equilibrium, Error> {
        let spec = self.parameters().spec();
        let grid = self.grid();
        let shape = converged.shape;
        let dr: DVector<f64> = grid.differentiation() * &shape.r;
        let dz: DVector<f64> = grid.differentiation() * &shape.z;
        let n_nodes = grid.n_nodes();
        let (mut lambda1, mut lambda2, mut theta_rad) =
            (vec![0.0; n_nodes], vec![0.0; n_nodes], vec![0.0; n_nodes]);
        let (mut s1_pa, mut s2_pa) = (vec![0.0; n_nodes], vec![0.0; n_nodes]);
        let mut area_integral = 0.0;
        let mut area_stretch_max: f64 = 0.0;
        for (j, (&rho, &weight)) in grid.nodes().iter().zip(grid.weights()).enumerate() {
            let (l1, l2) = (dr[j].hypot(dz[j]), shape.r[j] / rho);
            let stress =
                self.stress(dashpots, j, PointState { l1, l2, field }).ok_or(Error::NotConverged {
                    voltage_v,
                    residual: converged.residual.value.amax(),
                    iterations: converged.iterations,
                })?;
            lambda1[j] = l1;
            lambda2[j] = l2;
            theta_rad[j] = (-dz[j]).atan2(dr[j]);
            s1_pa[j] = spec.mu_pa * stress.s1;
            s2_pa[j] = spec.mu_pa * stress.s2;
            area_integral += weight * rho * (l1 * l2) * (l1 * l2);
            area_stretch_max = area_stretch_max.max(l1 * l2);
        }
        let length = self.length_scale();
        // C = (eps/H) integral of 2 pi R (l1 l2)^2 dR.
        let capacitance_f = self.parameters().permittivity_f_per_m() / spec.thickness_m
            * 2.0
            * std::f64::consts::PI
            * length
            * length
            * area_integral;
        Ok(Equilibrium {
            displacement_m: shape.z[0] * length,
            force_n: converged.residual.force * self.force_scale(),
            voltage_v,
            capacitance_f,
            field_max_v_per_m: voltage_v / spec.thickness_m * area_stretch_max,
            radius_undeformed_m: grid.nodes().iter().map(|rho| rho * length).collect(),
            lambda1,
            lambda2,
            theta_rad,
            s1_pa,
            s2_pa,
            residual: converged.residual.value.amax(),
            iterations: converged.iterations,
            shape,
        })
    }
}

impl Equilibrium {
    pub(super) fn shape(&self) -> &Shape {
        &self.shape
    }

    /// Displacement x of the plate below the plane of the frame, m.
    #[must_use]
    pub fn displacement_m(&self) -> f64 {
        self.displacement_m
    }

    /// Force with which the membrane pulls the plate up, N.
    #[must_use]
    pub fn force_n(&self) -> f64 {
        self.force_n
    }

    /// Voltage across the membrane, V.
    #[must_use]
    pub fn voltage_v(&self) -> f64 {
        self.voltage_v
    }

    /// Capacitance of the membrane, F.
    #[must_use]
    pub fn capacitance_f(&self) -> f64 {
        self.capacitance_f
    }

    /// Largest true electric field (V/H) l1 l2, V/m.
    #[must_use]
    pub fn field_max_v_per_m(&self) -> f64 {
        self.field_max_v_per_m
    }

    /// Undeformed radius R of each node, m.
    #[must_use]
    pub fn radius_undeformed_m(&self) -> &[f64] {
        &self.radius_undeformed_m
    }

    /// Meridional stretch at each node.
    #[must_use]
    pub fn lambda1(&self) -> &[f64] {
        &self.lambda1
    }

    /// Hoop stretch at each node.
    #[must_use]
    pub fn lambda2(&self) -> &[f64] {
        &self.lambda2
    }

    /// Slope below the horizontal at each node, rad; positive where the membrane descends from the frame to the plate.
    #[must_use]
    pub fn theta_rad(&self) -> &[f64] {
        &self.theta_rad
    }

    /// Nominal meridional stress at each node, Pa, with the electrical part.
    #[must_use]
    pub fn s1_pa(&self) -> &[f64] {
        &self.s1_pa
    }

    /// Nominal hoop stress at each node, Pa, with the electrical part.
    #[must_use]
    pub fn s2_pa(&self) -> &[f64] {
        &self.s2_pa
    }

    /// Meridional stretch at the plate.
    #[must_use]
    pub fn lambda1_inner(&self) -> f64 {
        self.lambda1[0]
    }

    /// Slope at the plate, rad.
    #[must_use]
    pub fn theta_inner_rad(&self) -> f64 {
        self.theta_rad[0]
    }

    /// Smallest nominal hoop stress over the nodes, Pa. The membrane wrinkles where it is not positive.
    #[must_use]
    pub fn s2_min_pa(&self) -> f64 {
        self.s2_pa.iter().copied().fold(f64::INFINITY, f64::min)
    }

    /// Largest residual of the collocated equations, relative to the shear modulus.
    #[must_use]
    pub fn residual(&self) -> f64 {
        self.residual
    }

    /// Newton iterations of the last solve.
    #[must_use]
    pub fn iterations(&self) -> usize {
        self.iterations
    }

    /// The state itself, unless the membrane is slack in it.
    ///
    /// # Errors
    /// [`Error::Slack`] with the smallest hoop stress.
    pub fn require_taut(&self) -> Result<&Self, Error> {
        let s2_min_pa = self.s2_min_pa();
        if s2_min_pa > 0.0 {
            Ok(self)
        } else {
            Err(Error::Slack { voltage_v: self.voltage_v, displacement_m: self.displacement_m, s2_min_pa })
        }
    }
}
