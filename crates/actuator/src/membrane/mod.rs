//! The annular membrane between plate and frame: equilibrium at a given load and voltage, and its tangent.
//!
//! Lengths inside are divided by the undeformed outer radius B, stresses by the shear modulus mu of the elastic network.
//! `z` points down; the plate sits at the inner edge, the frame at the outer edge.

mod assembly;
mod equilibrium;
mod newton;
mod tangent;

pub use equilibrium::Equilibrium;
pub use newton::Load;
pub(crate) use tangent::Sensitivity;
pub use tangent::{Network, Tangent};

use crate::collocation::ChebyshevGrid;
use crate::material::{ElasticLaw, Stress, electrical, maxwell_branch};
use crate::{ActuatorParameters, Error};

/// Collocation degree that resolves the membrane to 1e-12 for the built-in geometry. Measured: see `oracle_` tests.
pub const DEFAULT_DEGREE: usize = 24;
/// Fewer nodes cannot hold the boundary layer at the plate.
const MIN_DEGREE: usize = 6;
/// More nodes only add rounding: it grows with the square of the degree.
const MAX_DEGREE: usize = 128;

/// An annular membrane with the scales that make its equations dimensionless.
///
/// **Method**: collocation in (r, z) on Chebyshev nodes in the undeformed radius R, with the analytic Jacobian:
/// ```text
/// l1 = hypot(r', z'),  l2 = r/R,  cos(theta) = r'/l1,  sin(theta) = -z'/l1          Eq. (1)
/// (R s1 cos(theta))' = s2,   (R s1 sin(theta))' = 0                               equivalent to Eq. (2)
/// r(A) = a,  r(B) = b,  z(B) = 0,  z(A) = x   or   2 pi H R s1 sin(theta) = F
/// ```
///
/// **Accuracy**: 1e-12 relative at degree 24 for the built-in geometry, 1e-7 at degree 16.
///
/// **Example**
/// ```
/// use telepulse_actuator::{ParameterSet, membrane::Membrane};
/// let membrane = Membrane::new(&ParameterSet::A.parameters())?;
/// let rest = membrane.rest(0.0)?;
/// assert!((rest.displacement_m() - 6.840664085e-3).abs() < 1e-12);
/// # Ok::<(), telepulse_actuator::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Membrane {
    parameters: ActuatorParameters,
    grid: ChebyshevGrid,
    law: ElasticLaw,
}

impl Membrane {
    /// The membrane of `parameters` at the default collocation degree.
    ///
    /// # Errors
    /// None that the parameters' own check has not caught; the signature is that of [`Membrane::with_degree`].
    pub fn new(parameters: &ActuatorParameters) -> Result<Self, Error> {
        Self::with_degree(parameters, DEFAULT_DEGREE)
    }

    /// The membrane with `degree + 1` collocation nodes.
    ///
    /// # Errors
    /// [`Error::CollocationDegree`].
    pub fn with_degree(parameters: &ActuatorParameters, degree: usize) -> Result<Self, Error> {
        if !(MIN_DEGREE..=MAX_DEGREE).contains(&degree) {
            return Err(Error::CollocationDegree { min: MIN_DEGREE, max: MAX_DEGREE, found: degree });
        }
        let spec = parameters.spec();
        let grid = ChebyshevGrid::new(degree, spec.inner_radius_m / spec.outer_radius_m, 1.0);
        Ok(Self { parameters: parameters.clone(), grid, law: parameters.elastic_law() })
    }

    /// The parameters of this membrane.
    #[must_use]
    pub fn parameters(&self) -> &ActuatorParameters {
        &self.parameters
    }

    pub(crate) fn grid(&self) -> &ChebyshevGrid {
        &self.grid
    }

    pub(crate) fn law(&self) -> &ElasticLaw {
        &self.law
    }

    /// Undeformed outer radius B, m: the unit of length inside.
    pub(crate) fn length_scale(&self) -> f64 {
        self.parameters.spec().outer_radius_m / self.parameters.spec().prestretch
    }

    /// 2 pi mu H B, N: the unit of force inside.
    pub(crate) fn force_scale(&self) -> f64 {
        let spec = self.parameters.spec();
        2.0 * std::f64::consts::PI * spec.mu_pa * spec.thickness_m * self.length_scale()
    }

    /// v^2 = (V/H)^2 eps/mu per V^2.
    pub(crate) fn field_scale(&self) -> f64 {
        let spec = self.parameters.spec();
        self.parameters.permittivity_f_per_m() / (spec.mu_pa * spec.thickness_m * spec.thickness_m)
    }

    /// Stress and tangent at node `node`, with `field` = v^2, or nothing where the law has no value.
    pub(crate) fn stress(&self, dashpots: &Dashpots, node: usize, state: PointState) -> Option<Stress> {
        let PointState { l1, l2, field } = state;
        let mut stress = self.law.stress(l1, l2)?;
        for branch in &dashpots.branches {
            let [xi1, xi2] = branch.stretches[node];
            stress.add_scaled(&maxwell_branch(l1, l2, xi1, xi2), branch.modulus_ratio);
        }
        if field != 0.0 {
            stress.add_scaled(&electrical(l1, l2), field);
        }
        Some(stress)
    }
}

/// Stretches and electric load of a material point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PointState {
    pub(crate) l1: f64,
    pub(crate) l2: f64,
    /// v^2.
    pub(crate) field: f64,
}

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
