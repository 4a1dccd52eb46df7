//! A solved state of the membrane.

use crate::Error;
use crate::statics::{Profile, State, StaticPoint, StaticSolver};

/// A state of the membrane in equilibrium.
///
/// **Shapes and units**: fields are given at the collocation nodes, from the plate to the frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Equilibrium {
    point: StaticPoint,
    profile: Profile,
    state: State,
}

impl Equilibrium {
    /// The last equilibrium of `solver`.
    pub(super) fn of(solver: &StaticSolver, point: StaticPoint) -> Result<Self, Error> {
        Ok(Self { point, profile: solver.profile()?, state: solver.state().clone() })
    }

    pub(super) fn state(&self) -> &State {
        &self.state
    }

    /// All scalars.
    #[must_use]
    pub fn point(&self) -> StaticPoint {
        self.point
    }

    /// All fields.
    #[must_use]
    pub fn profile(&self) -> &Profile {
        &self.profile
    }

    /// Displacement x of the plate below the plane of the frame, m.
    #[must_use]
    pub fn displacement_m(&self) -> f64 {
        self.point.displacement_m
    }

    /// Force with which the membrane pulls the plate up, N.
    #[must_use]
    pub fn force_n(&self) -> f64 {
        self.point.force_n
    }

    /// Voltage across the membrane, V.
    #[must_use]
    pub fn voltage_v(&self) -> f64 {
        self.point.voltage_v
    }

    /// Capacitance of the membrane, F.
    #[must_use]
    pub fn capacitance_f(&self) -> f64 {
        self.point.capacitance_f
    }

    /// Largest true electric field (V/H) l1 l2, V/m.
    #[must_use]
    pub fn field_max_v_per_m(&self) -> f64 {
        self.point.field_max_v_per_m
    }

    /// Undeformed radius R of each node, m.
    #[must_use]
    pub fn radius_undeformed_m(&self) -> &[f64] {
        &self.profile.radius_undeformed_m
    }

    /// Meridional stretch at each node.
    #[must_use]
    pub fn lambda1(&self) -> &[f64] {
        &self.profile.lambda1
    }

    /// Hoop stretch at each node.
    #[must_use]
    pub fn lambda2(&self) -> &[f64] {
        &self.profile.lambda2
    }

    /// Slope below the horizontal at each node, rad; positive where the membrane descends from the frame to the plate.
    #[must_use]
    pub fn theta_rad(&self) -> &[f64] {
        &self.profile.theta_rad
    }

    /// Nominal meridional stress at each node, Pa, with the electrical part.
    #[must_use]
    pub fn s1_pa(&self) -> &[f64] {
        &self.profile.s1_pa
    }

    /// Nominal hoop stress at each node, Pa, with the electrical part.
    #[must_use]
    pub fn s2_pa(&self) -> &[f64] {
        &self.profile.s2_pa
    }

    /// Meridional stretch at the plate.
    #[must_use]
    pub fn lambda1_inner(&self) -> f64 {
        self.profile.lambda1[0]
    }

    /// Slope at the plate, rad.
    #[must_use]
    pub fn theta_inner_rad(&self) -> f64 {
        self.profile.theta_rad[0]
    }

    /// Smallest nominal hoop stress, Pa, at the nodes and between them. The membrane wrinkles where it is not positive.
    #[must_use]
    pub fn s2_min_pa(&self) -> f64 {
        self.point.s2_min_pa
    }

    /// Largest residual of the collocated equations, relative to the shear modulus.
    #[must_use]
    pub fn residual(&self) -> f64 {
        self.point.residual
    }

    /// Newton iterations of the last solve.
    #[must_use]
    pub fn iterations(&self) -> usize {
        self.point.iterations
    }

    /// The state itself, unless the membrane is slack in it.
    ///
    /// # Errors
    /// [`Error::Slack`] with the smallest hoop stress.
    pub fn require_taut(&self) -> Result<&Self, Error> {
        self.point.require_taut()?;
        Ok(self)
    }
}
