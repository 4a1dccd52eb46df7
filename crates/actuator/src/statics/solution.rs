//! A solved membrane: scalars, profile along the radius, derivatives.

use super::sheet::Sheet;
use crate::Error;

/// What holds the plate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Load {
    /// The plate stands at this displacement, m, positive down, zero in the plane of the frame.
    DisplacementM(f64),
    /// The membrane carries this force, N, positive where it pulls the plate up.
    ForceN(f64),
}

/// What holds the electrodes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Electrodes {
    /// Voltage, V, not negative.
    VoltageV(f64),
    /// Charge, C, not negative.
    ChargeC(f64),
}

/// Scalars of an equilibrium.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StaticPoint {
    /// Displacement x of the plate below the plane of the frame, m.
    pub displacement_m: f64,
    /// Force with which the membrane pulls the plate up, N.
    pub force_n: f64,
    /// Voltage across the membrane, V.
    pub voltage_v: f64,
    /// Charge on the electrodes, C.
    pub charge_c: f64,
    /// Capacitance, F.
    pub capacitance_f: f64,
    /// Largest true electric field (V/H) l1 l2 over the nodes, V/m.
    pub field_max_v_per_m: f64,
    /// Smallest nominal meridional stress over the nodes, Pa.
    pub s1_min_pa: f64,
    /// Smallest nominal hoop stress, Pa, at the nodes and between them.
    pub s2_min_pa: f64,
    /// Smallest of the moduli ds1/dl1 and ds2/dl2 over the nodes, with their electrical part, Pa.
    pub modulus_min_pa: f64,
    /// Largest residual of the method's equations, relative to the shear modulus.
    pub residual: f64,
    /// Newton steps, with new or old factors.
    pub iterations: usize,
}

impl StaticPoint {
    /// The state itself, unless the membrane is slack in it.
    ///
    /// # Errors
    /// [`Error::Slack`]: a stress is not tensile somewhere, so a real membrane wrinkles and the model does not hold.
    pub fn require_taut(&self) -> Result<&Self, Error> {
        if self.s2_min_pa > 0.0 && self.s1_min_pa > 0.0 {
            return Ok(self);
        }
        Err(Error::Slack {
            voltage_v: self.voltage_v,
            displacement_m: self.displacement_m,
            s2_min_pa: self.s2_min_pa.min(self.s1_min_pa),
        })
    }

    /// The state itself, unless short waves of thinning would grow in it, whatever holds the plate.
    ///
    /// # Errors
    /// [`Error::PullIn`]: ds1/dl1 or ds2/dl2 is not positive somewhere. Laws that soften more than the neo-Hookean one reach
    /// this before they lose tension.
    pub fn require_no_pull_in(&self) -> Result<&Self, Error> {
        if self.modulus_min_pa > 0.0 {
            return Ok(self);
        }
        Err(Error::PullIn {
            voltage_v: self.voltage_v,
            displacement_m: self.displacement_m,
            modulus_min_pa: self.modulus_min_pa,
        })
    }
}

/// First derivatives of force and capacitance as functions of displacement and voltage.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Derivatives {
    /// dF/dx at held voltage, N/m.
    pub stiffness_n_per_m: f64,
    /// dF/dV at held displacement, N/V: negative, since voltage lowers the tension.
    pub dforce_dvoltage_n_per_v: f64,
    /// dF/d(V^2) at held displacement, N/V^2; finite at zero voltage too.
    pub dforce_dvoltage_squared_n_per_v2: f64,
    /// dC/dx at held voltage, F/m.
    pub dcapacitance_dx_f_per_m: f64,
    /// dC/dV at held displacement, F/V.
    pub dcapacitance_dvoltage_f_per_v: f64,
}

impl Derivatives {
    /// dx/dV at held force, m/V.
    #[must_use]
    pub fn gain_m_per_v(&self) -> f64 {
        -self.dforce_dvoltage_n_per_v / self.stiffness_n_per_m
    }
}

/// Fields along the undeformed radius, from the plate to the frame, one entry for each node.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// Undeformed radius R, m.
    pub radius_undeformed_m: Vec<f64>,
    /// Deformed radius r, m.
    pub r_m: Vec<f64>,
    /// Depth z below the plane of the frame, m.
    pub z_m: Vec<f64>,
    /// Slope below the horizontal, rad; positive where the membrane descends from the frame to the plate.
    pub theta_rad: Vec<f64>,
    /// Meridional stretch.
    pub lambda1: Vec<f64>,
    /// Hoop stretch.
    pub lambda2: Vec<f64>,
    /// Nominal meridional stress with its electrical part, Pa.
    pub s1_pa: Vec<f64>,
    /// Nominal hoop stress with its electrical part, Pa.
    pub s2_pa: Vec<f64>,
    /// True electric field (V/H) l1 l2, V/m.
    pub true_field_v_per_m: Vec<f64>,
}

impl Profile {
    pub(super) fn with_capacity(n_nodes: usize) -> Self {
        let empty = || Vec::with_capacity(n_nodes);
        Self {
            radius_undeformed_m: empty(),
            r_m: empty(),
            z_m: empty(),
            theta_rad: empty(),
            lambda1: empty(),
            lambda2: empty(),
            s1_pa: empty(),
            s2_pa: empty(),
            true_field_v_per_m: empty(),
        }
    }

    pub(super) fn push(&mut self, sheet: &Sheet, voltage_v: f64, node: ProfileNode) {
        let length = sheet.length_scale_m();
        let mu_pa = sheet.shear_modulus_pa();
        self.radius_undeformed_m.push(node.rho * length);
        self.r_m.push(node.r * length);
        self.z_m.push(node.z * length);
        self.theta_rad.push(node.theta);
        self.lambda1.push(node.l1);
        self.lambda2.push(node.r / node.rho);
        self.s1_pa.push(node.s1 * mu_pa);
        self.s2_pa.push(node.s2 * mu_pa);
        self.true_field_v_per_m.push(voltage_v / sheet.spec().thickness_m * node.l1 * node.r / node.rho);
    }
}

/// Dimensionless fields at one radius.
#[derive(Debug, Clone, Copy)]
pub(super) struct ProfileNode {
    pub(super) rho: f64,
    pub(super) r: f64,
    pub(super) z: f64,
    pub(super) theta: f64,
    pub(super) l1: f64,
    pub(super) s1: f64,
    pub(super) s2: f64,
}

/// A solved membrane, whichever method found it.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// Scalars.
    pub point: StaticPoint,
    /// Derivatives of the maps F(x, V) and C(x, V).
    pub derivatives: Derivatives,
    /// Fields along the radius.
    pub profile: Profile,
}

impl Solution {
    /// Meridional stretch at the plate.
    #[must_use]
    pub fn lambda1_inner(&self) -> f64 {
        self.profile.lambda1[0]
    }

    /// Meridional stretch at the frame.
    #[must_use]
    pub fn lambda1_outer(&self) -> f64 {
        last(&self.profile.lambda1)
    }

    /// Slope at the plate, rad.
    #[must_use]
    pub fn theta_inner_rad(&self) -> f64 {
        self.profile.theta_rad[0]
    }

    /// Slope at the frame, rad.
    #[must_use]
    pub fn theta_outer_rad(&self) -> f64 {
        last(&self.profile.theta_rad)
    }

    /// Nominal meridional stress at the plate, Pa.
    #[must_use]
    pub fn s1_inner_pa(&self) -> f64 {
        self.profile.s1_pa[0]
    }
}

/// A profile has at least two nodes.
fn last(values: &[f64]) -> f64 {
    values[values.len() - 1]
}
