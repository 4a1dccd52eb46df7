//! The solver that a user holds: cold and warm solves, scalars, profile and derivatives.

use std::sync::Arc;

use super::continuation::Follower;
use super::kernel::{Edges, PointLaw, State};
use super::linearised::{Cause, Control, Electric, Held, Linearised, Step};
use super::newton::{Effort, Workspace};
use super::operator::Operator;
use super::sheet::Sheet;
use super::solution::{Derivatives, Electrodes, Load, Profile, ProfileNode, Solution, StaticPoint};
use super::{DEFAULT_DEGREE, MAX_DEGREE, MIN_DEGREE};
use crate::Error;
use crate::collocation::ChebyshevGrid;

/// Equilibria of one sheet, with all memory that solving takes.
///
/// **Method**: collocation on Chebyshev nodes in ln R, with analytic derivatives:
/// ```text
/// l1 = hypot(r', z'),  l2 = r/R,  cos(theta) = r'/l1,  sin(theta) = -z'/l1          Eq. (1)
/// (R s1 cos(theta))' = s2,   R s1 sin(theta) = F/(2 pi H)                         equivalent to Eq. (2)
/// r(A) = a,  r(B) = b,  z(B) = 0,  z(A) = x
/// ```
/// z' is eliminated at every node, so a Newton step factors one matrix of the size of the inner nodes; its factors are kept
/// from solve to solve while they contract.
///
/// **Accuracy**: see [`solve`](super::solve), which chooses the degree; at the default degree of 24, 1e-12 for A/B down to
/// about a tenth.
///
/// **Example**
/// ```
/// use telepulse_actuator::statics::{Electrodes, Load, Material, Prestretch, Sheet, SheetSpec, StaticSolver};
/// let sheet = Sheet::new(SheetSpec {
///     material: Material::Gent { mu_pa: 37_220.0, limit: 110.0 },
///     inner_radius_m: 0.0127,
///     outer_radius_m: 0.068_58,
///     thickness_m: 1e-3,
///     prestretch_inner: 2.0,
///     prestretch_outer: 2.0,
///     prestretch: Prestretch::AtLeastOne,
///     relative_permittivity: 5.8,
/// })?;
/// let mut solver = StaticSolver::new(&sheet)?;
/// let rest = solver.solve(Load::ForceN(0.980_665), Electrodes::VoltageV(0.0))?;
/// assert!((rest.displacement_m - 6.840_664_085e-3).abs() < 1e-12);
/// let driven = solver.solve_near(Load::ForceN(0.980_665), Electrodes::VoltageV(2500.0))?;
/// assert!((driven.displacement_m - 7.075_507_773e-3).abs() < 1e-12);
/// # Ok::<(), telepulse_actuator::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct StaticSolver {
    sheet: Arc<Sheet>,
    edges: Edges,
    workspace: Workspace,
    backup: State,
    tangent: Linearised,
    response: Step,
    known: Option<StaticPoint>,
}

impl StaticSolver {
    /// A solver at the default degree.
    ///
    /// # Errors
    /// None that the sheet's own check has not caught; the signature is that of [`StaticSolver::with_degree`].
    pub fn new(sheet: &Sheet) -> Result<Self, Error> {
        Self::with_degree(sheet, DEFAULT_DEGREE)
    }

    /// A solver with `degree + 1` nodes.
    ///
    /// # Errors
    /// [`Error::CollocationDegree`].
    pub fn with_degree(sheet: &Sheet, degree: usize) -> Result<Self, Error> {
        if !(MIN_DEGREE..=MAX_DEGREE).contains(&degree) {
            return Err(Error::CollocationDegree { min: MIN_DEGREE, max: MAX_DEGREE, found: degree });
        }
        let edges = edges(sheet);
        let operator = Operator::new(ChebyshevGrid::logarithmic(degree, sheet.radius_ratio(), 1.0));
        let state = State::guess(&operator, edges, 0.0);
        Ok(Self {
            sheet: Arc::new(sheet.clone()),
            edges,
            backup: state.clone(),
            workspace: Workspace::new(operator, state),
            tangent: Linearised::new(degree),
            response: Step::new(degree),
            known: None,
        })
    }

    /// The sheet that is solved for.
    #[must_use]
    pub fn sheet(&self) -> &Sheet {
        &self.sheet
    }

    /// Nodes, weights and differentiation matrix over R/B.
    pub(crate) fn grid(&self) -> &ChebyshevGrid {
        self.workspace.operator.grid()
    }

    /// The equilibrium that continues the flat state, whatever was solved before.
    ///
    /// **Method**: Newton from the shape of a uniformly tensioned membrane. Its result is trusted where it is taut, stable
    /// at its load, and the energy at this voltage is convex over all stretches between the flat state's and its own, so that no
    /// other equilibrium lies between. Otherwise continuation from the flat state at zero voltage, first in load, then in
    /// voltage squared (or charge squared), with step control.
    ///
    /// # Errors
    /// [`Error::Request`], [`Error::BeyondLimitPoint`] (dead load), [`Error::Slack`], [`Error::PullIn`],
    /// [`Error::GentLimit`], [`Error::NotConverged`].
    pub fn solve(&mut self, load: Load, electrodes: Electrodes) -> Result<StaticPoint, Error> {
        let sheet = Arc::clone(&self.sheet);
        self.solve_with(sheet.law(), load, electrodes, SlackStates::Refused)
    }

    /// As [`StaticSolver::solve`], but a slack state, in which the equations hold and a real membrane wrinkles, is returned.
    ///
    /// # Errors
    /// Those of [`StaticSolver::solve`] but for a state that is slack itself.
    pub fn solve_even_slack(&mut self, load: Load, electrodes: Electrodes) -> Result<StaticPoint, Error> {
        let sheet = Arc::clone(&self.sheet);
        self.solve_with(sheet.law(), load, electrodes, SlackStates::Returned)
    }

    /// [`StaticSolver::solve`] with another law at the nodes than the sheet's own, stiffer by branches that stand still.
    pub(crate) fn solve_with<L: PointLaw>(
        &mut self,
        law: &L,
        load: Load,
        electrodes: Electrodes,
        slack: SlackStates,
    ) -> Result<StaticPoint, Error> {
        let control = self.control(load, electrodes)?;
        self.known = None;
        let effort = self.follower(law).trace(control)?;
        let point = self.summarise(effort);
        if slack == SlackStates::Refused {
            point.require_taut()?.require_no_pull_in()?;
        }
        Ok(point)
    }

    /// The equilibrium near the last one: Newton from its state, and [`StaticSolver::solve`] where that fails or leads far.
    ///
    /// # Errors
    /// Those of [`StaticSolver::solve`].
    pub fn solve_near(&mut self, load: Load, electrodes: Electrodes) -> Result<StaticPoint, Error> {
        let sheet = Arc::clone(&self.sheet);
        self.solve_near_with(sheet.law(), load, electrodes, SlackStates::Refused)
    }

    /// [`StaticSolver::solve_near`] with another law at the nodes than the sheet's own.
    pub(crate) fn solve_near_with<L: PointLaw>(
        &mut self,
        law: &L,
        load: Load,
        electrodes: Electrodes,
        slack: SlackStates,
    ) -> Result<StaticPoint, Error> {
        let control = self.control(load, electrodes)?;
        if self.known.is_none() {
            return self.solve_with(law, load, electrodes, slack);
        }
        let before = self.workspace.at.displacement;
        if let Ok(effort) = self.workspace.solve(law, control) {
            let at = &self.workspace.at;
            let moved = (at.displacement - before).abs();
            let sound = at.least_stress() > 0.0 && at.least_modulus > 0.0;
            let near = moved < LARGEST_MOVE && at.least_s11 > 0.0;
            if near && (sound || slack == SlackStates::Returned) && self.follower(law).is_stable(control) {
                return Ok(self.summarise(effort));
            }
        }
        self.solve_with(law, load, electrodes, slack)
    }

    /// Goes back to an equilibrium that was solved before.
    pub(crate) fn resume(&mut self, state: &State, point: StaticPoint) {
        self.workspace.state.copy_from(state);
        self.workspace.at.displacement = point.displacement_m / self.sheet.length_scale_m();
        self.known = Some(point);
    }

    pub(crate) fn state(&self) -> &State {
        &self.workspace.state
    }

    pub(crate) fn operator(&self) -> &Operator {
        &self.workspace.operator
    }

    /// Scalars of the last equilibrium.
    #[must_use]
    pub fn point(&self) -> Option<StaticPoint> {
        self.known
    }

    /// Exact derivatives at the last equilibrium by implicit differentiation.
    ///
    /// # Errors
    /// [`Error::NoEquilibrium`] before the first solve or after a failed one; [`Error::SingularTangent`].
    pub fn derivatives(&mut self) -> Result<Derivatives, Error> {
        let point = self.known.ok_or(Error::NoEquilibrium)?;
        let Workspace { operator, at, state, .. } = &self.workspace;
        let control =
            Control { load: Held::Displacement(at.displacement), electric: Electric::Field(state.field) };
        if !self.tangent.factor(operator, at, state.field, control) {
            return Err(Error::SingularTangent {
                voltage_v: point.voltage_v,
                displacement_m: point.displacement_m,
            });
        }
        let mut by = |cause: Cause| {
            self.tangent.response(operator, cause, &mut self.response);
            [self.response.force, self.tangent.capacitance_of(&self.response)]
        };
        let [force_by_x, capacitance_by_x] = by(Cause::Displacement);
        let [force_by_field, capacitance_by_field] = by(Cause::Field);
        let sheet = &self.sheet;
        let per_length = 1.0 / sheet.length_scale_m();
        let per_v2 = sheet.force_scale_n() * sheet.field_scale_per_v2() * force_by_field;
        Ok(Derivatives {
            stiffness_n_per_m: sheet.force_scale_n() * per_length * force_by_x,
            dforce_dvoltage_n_per_v: 2.0 * point.voltage_v * per_v2,
            dforce_dvoltage_squared_n_per_v2: per_v2,
            dcapacitance_dx_f_per_m: sheet.capacitance_scale_f() * per_length * capacitance_by_x,
            dcapacitance_dvoltage_f_per_v: 2.0
                * point.voltage_v
                * sheet.capacitance_scale_f()
                * sheet.field_scale_per_v2()
                * capacitance_by_field,
        })
    }

    /// Fields of the last equilibrium.
    ///
    /// # Errors
    /// [`Error::NoEquilibrium`].
    pub fn profile(&self) -> Result<Profile, Error> {
        let point = self.known.ok_or(Error::NoEquilibrium)?;
        let Workspace { operator, at, state, .. } = &self.workspace;
        let z = operator.grid().antiderivative_from_upper(&state.q);
        let mut profile = Profile::with_capacity(operator.degree + 1);
        for (j, &z) in z.iter().enumerate() {
            let node = ProfileNode {
                rho: operator.rho[j],
                r: state.r[j],
                z,
                theta: (-state.q[j]).atan2(at.p[j]),
                l1: at.l1[j],
                s1: at.s1[j],
                s2: at.s2[j],
            };
            profile.push(&self.sheet, point.voltage_v, node);
        }
        Ok(profile)
    }

    /// The last equilibrium with everything that follows from it.
    ///
    /// # Errors
    /// Those of [`StaticSolver::derivatives`].
    pub fn solution(&mut self) -> Result<Solution, Error> {
        let derivatives = self.derivatives()?;
        Ok(Solution { point: self.known.ok_or(Error::NoEquilibrium)?, derivatives, profile: self.profile()? })
    }

    /// Largest part that the two highest of the Chebyshev coefficients have in the stretches and in z': the error of resolution.
    #[must_use]
    pub fn resolution(&self) -> f64 {
        let grid = self.workspace.operator.grid();
        let Workspace { at, state, .. } = &self.workspace;
        grid.tail(&at.l1).max(grid.tail(&at.l2)).max(grid.tail(&state.q))
    }

    /// The limit point under a dead load: the largest voltage that it bears, and the state there.
    ///
    /// **Method**: the displacement is prescribed beside the force and the voltage follows, so nothing is singular at the
    /// limit point; there dF/dx at held voltage is zero.
    ///
    /// # Errors
    /// Those of [`StaticSolver::solve`] for the load without voltage; [`Error::NoLimitPoint`] where the voltage still rises at
    /// the end of the search, as for a Gent material that stiffens in time.
    pub fn limit_voltage(&mut self, force_n: f64) -> Result<StaticPoint, Error> {
        let control = self.control(Load::ForceN(force_n), Electrodes::VoltageV(0.0))?;
        self.known = None;
        let sheet = Arc::clone(&self.sheet);
        self.follower(sheet.law()).trace(control)?;
        let effort = self.follower(sheet.law()).voltage_limit(force_n / sheet.force_scale_n())?;
        Ok(self.summarise(effort))
    }

    fn follower<'a, L>(&'a mut self, law: &'a L) -> Follower<'a, L> {
        Follower {
            sheet: &self.sheet,
            law,
            edges: self.edges,
            workspace: &mut self.workspace,
            backup: &mut self.backup,
            tangent: &mut self.tangent,
            response: &mut self.response,
        }
    }

    fn control(&self, load: Load, electrodes: Electrodes) -> Result<Control, Error> {
        let (quantity, value) = match load {
            Load::DisplacementM(x) => ("displacement_m", x),
            Load::ForceN(force) => ("force_n", force),
        };
        if !value.is_finite() {
            return Err(Error::Request { quantity, allowed: "finite", found: value });
        }
        let (quantity, value) = match electrodes {
            Electrodes::VoltageV(v) => ("voltage_v", v),
            Electrodes::ChargeC(charge) => ("charge_c", charge),
        };
        if !(value.is_finite() && value >= 0.0) {
            return Err(Error::Request { quantity, allowed: "finite and not negative", found: value });
        }
        let sheet = &self.sheet;
        Ok(Control {
            load: match load {
                Load::DisplacementM(x) => Held::Displacement(x / sheet.length_scale_m()),
                Load::ForceN(force) => Held::Force(force / sheet.force_scale_n()),
            },
            electric: match electrodes {
                Electrodes::VoltageV(v) => Electric::Field(sheet.field_scale_per_v2() * v * v),
                Electrodes::ChargeC(charge) => Electric::ChargeSquared(
                    sheet.field_scale_per_v2() * (charge / sheet.capacitance_scale_f()).powi(2),
                ),
            },
        })
    }

    fn summarise(&mut self, effort: Effort) -> StaticPoint {
        let point = summarise(&self.sheet, &self.workspace, effort);
        self.known = Some(point);
        point
    }
}

/// Scalars of a converged workspace.
pub(crate) fn summarise(sheet: &Sheet, workspace: &Workspace, effort: Effort) -> StaticPoint {
    let Workspace { operator, at, state, .. } = workspace;
    let voltage_v = (state.field.max(0.0) / sheet.field_scale_per_v2()).sqrt();
    let capacitance_f = at.capacitance * sheet.capacitance_scale_f();
    let area_stretch = at.l1.iter().zip(&at.l2).fold(0.0, |a: f64, (l1, l2)| a.max(l1 * l2));
    let mu_pa = sheet.shear_modulus_pa();
    StaticPoint {
        displacement_m: at.displacement * sheet.length_scale_m(),
        force_n: state.force * sheet.force_scale_n(),
        voltage_v,
        charge_c: voltage_v * capacitance_f,
        capacitance_f,
        field_max_v_per_m: voltage_v / sheet.spec().thickness_m * area_stretch,
        s1_min_pa: mu_pa * at.s1.iter().copied().fold(f64::INFINITY, f64::min),
        s2_min_pa: mu_pa * operator.grid().minimum(&at.s2),
        modulus_min_pa: mu_pa * at.least_modulus,
        residual: effort.residual,
        iterations: effort.iterations,
    }
}

/// Deformed radii of the boundaries over B.
pub(super) fn edges(sheet: &Sheet) -> Edges {
    let length = sheet.length_scale_m();
    Edges { inner: sheet.spec().inner_radius_m / length, outer: sheet.spec().outer_radius_m / length }
}

/// What becomes of a state in which the membrane would wrinkle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SlackStates {
    /// A typed refusal.
    Refused,
    /// Returned as it is: the equations hold in it.
    Returned,
}

/// A warm solve may move the plate by this part of B: further, it may have left the branch.
const LARGEST_MOVE: f64 = 0.1;
