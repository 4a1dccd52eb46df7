//! The static maps of the reduced twin, built from membrane solves.

use super::branch_reduction::{BranchMaps, branch_point};
use super::stated::StatedError;
use super::surface::{Axis, Surface, slope};
use crate::membrane::{Dashpots, Equilibrium, Load, Membrane};
use crate::{ActuatorParameters, Error};

/// Points in x of the force and capacitance maps.
pub(super) const FORCE_POINTS_X: usize = 8;
/// Points in V^2 of the force and capacitance maps.
pub(super) const FORCE_POINTS_V2: usize = 5;
/// Points in x of the branch maps: the branches add a few percent to the force, so they need less.
pub(super) const BRANCH_POINTS_X: usize = 5;
/// Points in V^2 of the branch maps.
pub(super) const BRANCH_POINTS_V2: usize = 3;
/// How far above the rest position the maps reach, m.
pub(super) const REACH_UP_M: f64 = 1.5e-3;
/// How far below the rest position the maps reach, m.
pub(super) const REACH_DOWN_M: f64 = 5.0e-3;
/// The maps keep this part of the rest sag as distance from the flat membrane, about which the force is odd.
pub(super) const LEAST_SAG: f64 = 0.3;

/// Range of the maps; beyond it the twin continues them linearly.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapRange {
    /// Smallest displacement from the rest position, mm.
    pub min_mm: f64,
    /// Largest displacement from the rest position, mm.
    pub max_mm: f64,
    /// Largest voltage, V.
    pub max_v: f64,
}

/// Reduced model of the actuator: what does not change during a run.
///
/// ```text
/// m x'' = m g + d - F(x, Phi) - F_branches - c x' + F_contact            Phi' = (u - Phi)/(R_s C)
/// F_branches = sum_i mu_i sum_k (E_k - zeta_ik) dc_k/dx + (a^2/2) dK/dx      zeta_ik' = (E_k - zeta_ik)/tau_i
/// ```
///
/// **Method**: F and the capacitance are tensor Chebyshev interpolants in (x, V^2) of membrane solves. The strain
/// fields that the branches see are reduced to three coordinates E_k = c_k(x, V^2) (+ a for k = 0) with a static internal
/// amplitude a; all of them follow from one energy, so the reduction is passive.
///
/// **Accuracy**: F and C within 1e-6 relative of direct solves inside [`TwinModel::range`]; against the
/// field-level model ([`crate::field::FieldTwin`]) see the tests.
///
/// **Example**
/// ```
/// use telepulse_actuator::{ParameterSet, twin::TwinModel};
/// let model = TwinModel::new(&ParameterSet::A.parameters())?;
/// assert!((model.rest_sag_m() - 6.840664085e-3).abs() < 1e-11);
/// // At rest the membrane carries plate and load.
/// assert!((model.force_n(0.0, 0.0) - 0.980665).abs() < 1e-6);
/// # Ok::<(), telepulse_actuator::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct TwinModel {
    pub(super) parameters: ActuatorParameters,
    pub(super) rest_sag: f64,
    pub(super) x_axis: Axis,
    pub(super) v2_axis: Axis,
    pub(super) force: Surface<FORCE_POINTS_X, FORCE_POINTS_V2>,
    pub(super) capacitance: Surface<FORCE_POINTS_X, FORCE_POINTS_V2>,
    pub(super) branches: BranchMaps,
    pub(super) stated_error: Option<StatedError>,
}

impl TwinModel {
    /// Builds the maps for `parameters`.
    ///
    /// # Errors
    /// Those of [`Membrane::solve`], and [`Error::Slack`] where the membrane would wrinkle inside the range.
    pub fn new(parameters: &ActuatorParameters) -> Result<Self, Error> {
        let membrane = Membrane::new(parameters)?;
        let rest = membrane.rest(0.0)?;
        let rest_sag = rest.displacement_m();
        let (x_axis, v2_axis) = axes(parameters, rest_sag);
        let mut force = [[0.0; FORCE_POINTS_X]; FORCE_POINTS_V2];
        let mut capacitance = force;
        let xs = x_axis.points(FORCE_POINTS_X);
        for (iy, v2) in v2_axis.points(FORCE_POINTS_V2).into_iter().enumerate() {
            let states = sweep(&membrane, &rest, &xs, v2.max(0.0).sqrt(), Slack::Refused)?;
            for (ix, state) in states.iter().enumerate() {
                force[iy][ix] = state.force_n();
                capacitance[iy][ix] = state.capacitance_f();
            }
        }
        let branches = if parameters.spec().branches.is_empty() {
            BranchMaps::absent()
        } else {
            BranchMaps::new(&membrane, &rest, x_axis, v2_axis)?
        };
        Ok(Self {
            parameters: parameters.clone(),
            rest_sag,
            x_axis,
            v2_axis,
            force: Surface::interpolate(&force),
            capacitance: Surface::interpolate(&capacitance),
            branches,
            stated_error: None,
        })
    }

    /// The parameters the maps were built for.
    #[must_use]
    pub fn parameters(&self) -> &ActuatorParameters {
        &self.parameters
    }

    /// Displacement of the plate below the frame at rest under its load at zero voltage, m.
    #[must_use]
    pub fn rest_sag_m(&self) -> f64 {
        self.rest_sag
    }

    /// Where the maps hold.
    #[must_use]
    pub fn range(&self) -> MapRange {
        MapRange {
            min_mm: (self.x_axis.lower() - self.rest_sag) * 1e3,
            max_mm: (self.x_axis.upper() - self.rest_sag) * 1e3,
            max_v: self.parameters.spec().full_scale_v,
        }
    }

    /// Force of the relaxed membrane on the plate, N, positive up, at a displacement from rest and a voltage.
    #[must_use]
    pub fn force_n(&self, displacement_mm: f64, voltage_v: f64) -> f64 {
        self.force.at(self.normalized_x(displacement_mm), self.normalized_v2(voltage_v))
    }

    /// Capacitance of the membrane, F, at a displacement from rest and a voltage.
    #[must_use]
    pub fn capacitance_f(&self, displacement_mm: f64, voltage_v: f64) -> f64 {
        self.capacitance.at(self.normalized_x(displacement_mm), self.normalized_v2(voltage_v))
    }

    /// Largest stiffness of the membrane over the rest position and both ends of the map at zero voltage, with the
    /// branches frozen and without the softening by internal motion, N/m.
    pub(super) fn stiffest_n_per_m(&self) -> f64 {
        let y = self.normalized_v2(0.0);
        let (force, branches) = (self.force.slice(y), self.branches.slice(y));
        let modulus = self.parameters.branch_modulus_pa();
        [-1.0, self.x_axis.normalized(self.rest_sag), 1.0]
            .map(|u| {
                let point = branch_point(&branches, u, 0.0);
                let along: f64 = point.strain_slope.iter().map(|g| g * g).sum();
                let inverse_half = self.x_axis.inverse_half();
                (slope(&force, u) + modulus * along * inverse_half) * inverse_half
            })
            .into_iter()
            .fold(0.0, f64::max)
    }

    fn normalized_x(&self, displacement_mm: f64) -> f64 {
        self.x_axis.normalized(self.rest_sag + displacement_mm * 1e-3)
    }

    pub(super) fn normalized_v2(&self, voltage_v: f64) -> f64 {
        self.v2_axis.normalized(voltage_v * voltage_v)
    }
}

/// The ranges of displacement and V^2 that the maps of `parameters` cover.
pub(super) fn axes(parameters: &ActuatorParameters, rest_sag: f64) -> (Axis, Axis) {
    let full_scale = parameters.spec().full_scale_v;
    let up = REACH_UP_M.min((1.0 - LEAST_SAG) * rest_sag);
    (Axis::new(rest_sag - up, rest_sag + REACH_DOWN_M), Axis::new(0.0, full_scale * full_scale))
}

/// What to do about a slack state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Slack {
    /// It is an error.
    Refused,
    /// It is a state like others: someone else judges.
    Kept,
}

/// Solves at all `xs` (ascending) at one voltage, each from its neighbour.
pub(super) fn sweep(
    membrane: &Membrane,
    rest: &Equilibrium,
    xs: &[f64],
    voltage_v: f64,
    slack: Slack,
) -> Result<Vec<Equilibrium>, Error> {
    let mut states: Vec<Equilibrium> = Vec::with_capacity(xs.len());
    for &x in xs {
        let known = states.last().unwrap_or(rest);
        let state = membrane.solve_near(known, Load::DisplacementM(x), voltage_v, &Dashpots::absent())?;
        if slack == Slack::Refused {
            state.require_taut()?;
        }
        states.push(state);
    }
    Ok(states)
}
