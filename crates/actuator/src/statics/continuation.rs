//! From the flat state to a load and a voltage, and to the limit point of that path.

use super::kernel::{Edges, PointLaw, State};
use super::linearised::{Cause, Control, Electric, Held, Linearised, Step};
use super::newton::{Effort, Workspace};
use super::sheet::Sheet;
use super::solver::summarise;
use crate::Error;
use crate::material::{ElasticLaw, first_invariant};

/// Steps on one leg of the continuation.
const MAX_CONTINUATION_STEPS: usize = 150;
/// Smallest part of a leg that continuation tries before it gives up.
const MIN_CONTINUATION_STEP: f64 = 1e-5;
/// Continuation rejects a step at dead load that moves the plate by more than this part of B: it may have left the branch.
const MAX_PLATE_STEP: f64 = 0.1;
/// Displacement over B at which a membrane without pre-stretch starts: flat, it has no stiffness.
const UNSTRETCHED_START: f64 = 0.5;
/// Part of the Gent limit beyond which a failure is blamed on it.
const GENT_BLAME: f64 = 0.95;
/// Stress over mu below which a path without voltage has ended because tension is lost.
const SLACK_BLAME: f64 = 1e-3;
/// Modulus over mu below which a failure is blamed on pull-in.
const PULL_IN_BLAME: f64 = 1e-2;
/// Largest slope of the guessed profile: steeper guesses leave Newton's reach.
const GUESS_REACH: f64 = 0.25;
/// First step in x over B of the search for a limit point.
const LIMIT_STEP: f64 = 0.02;
/// Longest step of that search: the path bends on the way.
const LARGEST_LIMIT_STEP: f64 = 0.05;
/// Displacement over B at which the search for a limit point gives up.
const LIMIT_REACH: f64 = 4.0;
/// Halvings and secant steps of the search for the zero of the stiffness.
const MAX_LIMIT_STEPS: usize = 80;
/// Smallest part of a bracket that this search tries.
const LEAST_PART: f64 = 1e-3;
/// Part of B to which the displacement of a limit point is found; the voltage is quadratic there, so it is far better.
const LIMIT_TOLERANCE: f64 = 1e-9;

/// What a path needs of the solver.
pub(super) struct Follower<'a, L> {
    pub(super) sheet: &'a Sheet,
    pub(super) law: &'a L,
    pub(super) edges: Edges,
    pub(super) workspace: &'a mut Workspace,
    pub(super) backup: &'a mut State,
    pub(super) tangent: &'a mut Linearised,
    pub(super) response: &'a mut Step,
}

/// How far a leg came.
struct Stop {
    position: f64,
    effort: Effort,
}

impl<L: PointLaw> Follower<'_, L> {
    /// The equilibrium on the path from the flat state.
    pub(super) fn trace(&mut self, control: Control) -> Result<Effort, Error> {
        self.workspace.linear.discard();
        let field = match control.electric {
            Electric::Field(field) => field,
            Electric::ChargeSquared(_) | Electric::Displacement(_) => 0.0,
        };
        let guess = self.guess_displacement(control.load, field);
        self.workspace.state = State::guess(&self.workspace.operator, self.edges, guess);
        if let Held::Displacement(_) = control.load {
            self.workspace.state.force = self.guess_force(guess, field);
        }
        if let Ok(effort) = self.workspace.solve(self.law, control)
            && self.is_trusted(control)
        {
            return Ok(effort);
        }
        self.continuation(control)
    }

    /// Whether the state is taut and stable, and the only one within its stretches: see `StaticSolver::solve`.
    fn is_trusted(&mut self, control: Control) -> bool {
        let at = &self.workspace.at;
        if at.least_stress() <= 0.0 {
            return false;
        }
        let spec = self.sheet.spec();
        let flat = [spec.prestretch_inner, spec.prestretch_outer];
        let all = || at.l1.iter().chain(&at.l2).chain(&flat).copied();
        let (lower, upper) = (all().fold(f64::INFINITY, f64::min), all().fold(0.0, f64::max));
        // The electrical part -v^2 (l1 l2)^2/2 has curvatures down to -3 v^2 l^2.
        let softening = 3.0 * self.workspace.state.field * upper * upper;
        let convex = self.sheet.law().convexity(lower, upper).is_some_and(|least| least > softening);
        convex && self.is_stable(control)
    }

    /// Whether the displacement grows with a dead load.
    pub(super) fn is_stable(&mut self, control: Control) -> bool {
        match control.load {
            Held::Displacement(_) => true,
            Held::Force(_) => {
                let Workspace { operator, linear, .. } = &mut *self.workspace;
                linear.response(operator, Cause::Force, self.response);
                linear.displacement_of(self.response) > 0.0
            }
        }
    }

    /// Displacement of a flat membrane under uniform tension s: x = (F/(2 pi H)) (lp/s) ln(B/A), kept within a quarter of B.
    fn guess_displacement(&self, load: Held, field: f64) -> f64 {
        match load {
            Held::Displacement(x) => x,
            Held::Force(force) => {
                let inner = self.workspace.operator.rho[0];
                let linear = force / self.flat_tension(field) * -inner.ln();
                linear.clamp(-GUESS_REACH, GUESS_REACH)
            }
        }
    }

    fn guess_force(&self, displacement: f64, field: f64) -> f64 {
        displacement * self.flat_tension(field) / -self.workspace.operator.rho[0].ln()
    }

    /// s/lp of the flat sheet at the mean pre-stretch, kept positive.
    fn flat_tension(&self, field: f64) -> f64 {
        let spec = self.sheet.spec();
        let stretch = 0.5 * (spec.prestretch_inner + spec.prestretch_outer);
        let elastic = self.sheet.law().stress(stretch, stretch).map_or(0.0, |s| s.s1);
        (elastic - field * stretch.powi(3)).max(0.1 * elastic).max(0.01) / stretch
    }

    /// First at zero voltage to the load, then to the voltage or charge.
    fn continuation(&mut self, control: Control) -> Result<Effort, Error> {
        let start = self.start(control)?;
        let load_path = move |t: f64| Control {
            load: match control.load {
                Held::Displacement(x) => Held::Displacement(start[0] + t * (x - start[0])),
                Held::Force(force) => Held::Force(start[1] + t * (force - start[1])),
            },
            electric: Electric::Field(0.0),
        };
        let loaded = self.leg(load_path);
        if loaded.position < 1.0 {
            return Err(self.blame(control, load_path(loaded.position), &loaded));
        }
        let electric_path = move |t: f64| Control {
            electric: match control.electric {
                Electric::Field(field) => Electric::Field(t * field),
                Electric::ChargeSquared(square) => Electric::ChargeSquared(t * square),
                held @ Electric::Displacement(_) => held,
            },
            ..control
        };
        if matches!(control.electric, Electric::Field(0.0)) {
            return Ok(loaded.effort);
        }
        let charged = self.leg(electric_path);
        if charged.position < 1.0 {
            return Err(self.blame(control, electric_path(charged.position), &charged));
        }
        Ok(charged.effort)
    }

    /// Displacement and force of a state that is easily found: flat where pre-stretch holds it, else pulled out far.
    fn start(&mut self, control: Control) -> Result<[f64; 2], Error> {
        let spec = self.sheet.spec();
        let sign = match control.load {
            Held::Displacement(value) | Held::Force(value) => 1.0_f64.copysign(value),
        };
        let tensioned = spec.prestretch_inner > 1.0 && spec.prestretch_outer > 1.0;
        for pull in if tensioned { [0.0, 0.1, 0.5] } else { [UNSTRETCHED_START, 1.0, 2.0] } {
            let x = sign * pull;
            self.workspace.linear.discard();
            self.workspace.state = State::guess(&self.workspace.operator, self.edges, x);
            self.workspace.state.force = self.guess_force(x, 0.0);
            let held = Control { load: Held::Displacement(x), electric: Electric::Field(0.0) };
            if self.workspace.solve(self.law, held).is_ok() {
                return Ok([x, self.workspace.state.force]);
            }
        }
        if let ElasticLaw::Gent { limit } = *self.sheet.law() {
            // Stretches of the flat linear sheet, which the boundaries ask for on average.
            let flat = State::guess(&self.workspace.operator, self.edges, 0.0);
            self.workspace.operator.differentiate(&flat.r, &mut self.workspace.at.p);
            let hoop =
                flat.r.iter().zip(&self.workspace.operator.inverse_rho).map(|(r, inverse)| r * inverse);
            let invariants =
                self.workspace.at.p.iter().zip(hoop).map(|(&l1, l2)| first_invariant(l1, l2) - 3.0);
            let invariant = invariants.fold(0.0, f64::max);
            if invariant > GENT_BLAME * limit {
                return Err(Error::GentLimit { invariant, gent_limit: limit });
            }
        }
        Err(Error::NotConverged { voltage_v: 0.0, residual: f64::INFINITY, iterations: 0 })
    }

    /// Follows `path` from 0 to 1 with step control; at dead load every state on it must be stable.
    fn leg(&mut self, path: impl Fn(f64) -> Control) -> Stop {
        let (mut position, mut step) = (0.0, 0.25_f64);
        let mut stop = Stop { position, effort: Effort { iterations: 0, factorizations: 0, residual: 0.0 } };
        self.backup.copy_from(&self.workspace.state);
        let mut displacement = self.workspace.at.displacement;
        for _ in 0..MAX_CONTINUATION_STEPS {
            let next = (position + step).min(1.0);
            let control = path(next);
            let solved = self.workspace.solve(self.law, control);
            let moved = (self.workspace.at.displacement - displacement).abs();
            let near = moved < MAX_PLATE_STEP || matches!(control.load, Held::Displacement(_));
            match solved {
                Ok(effort) if near && self.workspace.at.least_s11 > 0.0 && self.is_stable(control) => {
                    position = next;
                    step *= 1.5;
                    displacement = self.workspace.at.displacement;
                    self.backup.copy_from(&self.workspace.state);
                    stop = Stop { position, effort };
                }
                _ => {
                    step *= 0.5;
                    self.workspace.state.copy_from(self.backup);
                    self.workspace.linear.discard();
                }
            }
            if position >= 1.0 || step < MIN_CONTINUATION_STEP {
                break;
            }
        }
        stop
    }

    /// Names the physical reason why a leg ended early, having returned to the last state on it.
    fn blame(&mut self, wanted: Control, reached: Control, stop: &Stop) -> Error {
        self.workspace.state.copy_from(self.backup);
        self.workspace.linear.discard();
        let effort = match self.workspace.solve(self.law, reached) {
            Ok(effort) | Err(effort) => effort,
        };
        if let ElasticLaw::Gent { limit } = *self.sheet.law() {
            let at = &self.workspace.at;
            let invariant =
                at.l1.iter().zip(&at.l2).map(|(&l1, &l2)| first_invariant(l1, l2) - 3.0).fold(0.0, f64::max);
            if invariant > GENT_BLAME * limit {
                return Error::GentLimit { invariant, gent_limit: limit };
            }
        }
        // Without voltage nothing but the loss of tension ends a path: it may stall just before.
        let unpowered = self.workspace.state.field <= 0.0;
        let slack = self.workspace.at.least_stress() <= if unpowered { SLACK_BLAME } else { 0.0 };
        // At a held plate, a path in voltage that ends taut ends in a fold: pull-in without the plate's help.
        let held_still = matches!(wanted.load, Held::Displacement(_));
        let held = held_still && !unpowered;
        if !slack && (held || self.workspace.at.least_s11 < PULL_IN_BLAME) {
            let state = summarise(self.sheet, self.workspace, effort);
            return Error::PullIn {
                voltage_v: state.voltage_v,
                displacement_m: state.displacement_m,
                modulus_min_pa: state.modulus_min_pa,
            };
        }
        let wanted_v = match wanted.electric {
            Electric::Field(field) => (field / self.sheet.field_scale_per_v2()).sqrt(),
            _ => (self.workspace.state.field.max(0.0) / self.sheet.field_scale_per_v2()).sqrt(),
        };
        match wanted.load {
            Held::Displacement(_) | Held::Force(_) if slack && (unpowered || held_still) => {
                let state = summarise(self.sheet, self.workspace, effort);
                Error::Slack {
                    voltage_v: state.voltage_v,
                    displacement_m: state.displacement_m,
                    s2_min_pa: state.s2_min_pa.min(state.s1_min_pa),
                }
            }
            Held::Force(force) => self.beyond_limit(force, wanted_v, reached, effort),
            Held::Displacement(_) => Error::NotConverged {
                voltage_v: wanted_v,
                residual: stop.effort.residual,
                iterations: stop.effort.iterations,
            },
        }
    }

    /// The refusal of a dead load, with the limit point where the path can be followed to it, else the last stable state.
    fn beyond_limit(&mut self, force: f64, wanted_v: f64, reached: Control, effort: Effort) -> Error {
        let effort = match reached.electric {
            Electric::Field(field) if field > 0.0 => match self.voltage_limit(force) {
                Ok(found) => found,
                Err(_) => {
                    self.workspace.state.copy_from(self.backup);
                    let Workspace { operator, at, state, .. } = &mut *self.workspace;
                    // A state that was solved has a value.
                    at.at(operator, self.law, state);
                    effort
                }
            },
            _ => effort,
        };
        let stiffness = self.stiffness().unwrap_or(0.0);
        let state = summarise(self.sheet, self.workspace, effort);
        Error::BeyondLimitPoint {
            voltage_v: wanted_v,
            force_n: force * self.sheet.force_scale_n(),
            reached_voltage_v: state.voltage_v,
            reached_force_n: state.force_n,
            stiffness_n_per_m: stiffness * self.sheet.force_scale_n() / self.sheet.length_scale_m(),
        }
    }

    /// df/dx at held v^2 of the present state.
    fn stiffness(&mut self) -> Option<f64> {
        let Workspace { operator, at, state, .. } = &*self.workspace;
        let control =
            Control { load: Held::Displacement(at.displacement), electric: Electric::Field(state.field) };
        if !self.tangent.factor(operator, at, state.field, control) {
            return None;
        }
        self.tangent.response(operator, Cause::Displacement, self.response);
        Some(self.response.force)
    }

    /// From a stable state under the dead load `force` to the limit point in voltage.
    pub(super) fn voltage_limit(&mut self, force: f64) -> Result<Effort, Error> {
        let side = 1.0_f64.copysign(force);
        let mut inner = self.workspace.at.displacement;
        let mut step = LIMIT_STEP;
        let no_limit = |at: &Workspace, sheet: &Sheet| Error::NoLimitPoint {
            force_n: force * sheet.force_scale_n(),
            displacement_m: at.at.displacement * sheet.length_scale_m(),
            voltage_v: (at.state.field.max(0.0) / sheet.field_scale_per_v2()).sqrt(),
        };
        let mut outer = None;
        // Part of the bracket that a step from its inner end takes.
        let mut part = 0.5;
        let mut reached = self.workspace.state.field;
        self.backup.copy_from(&self.workspace.state);
        let mut effort = Effort { iterations: 0, factorizations: 0, residual: 0.0 };
        for _ in 0..MAX_LIMIT_STEPS {
            let next = match outer {
                None => inner + side * step,
                Some(outer) => inner + part * (outer - inner),
            };
            if outer.is_some() && (next - inner).abs() < LIMIT_TOLERANCE {
                return Ok(effort);
            }
            if next.abs() > LIMIT_REACH {
                break;
            }
            let held = Control { load: Held::Force(force), electric: Electric::Displacement(next) };
            self.workspace.state.copy_from(self.backup);
            let solved = self.workspace.solve(self.law, held);
            match (solved, self.stiffness()) {
                // Up to the limit point the voltage rises with displacement. A step that has passed it may end on another
                // branch, which is stiff again: the voltage tells.
                (Ok(found), Some(stiffness)) if stiffness > 0.0 && self.workspace.state.field >= reached => {
                    effort = found;
                    reached = self.workspace.state.field;
                    inner = next;
                    part = 0.5;
                    self.backup.copy_from(&self.workspace.state);
                    step = (1.5 * step).min(LARGEST_LIMIT_STEP);
                }
                (Ok(_), _) => {
                    outer = Some(next);
                    part = 0.5;
                }
                // Old factors may have led astray; a shorter step with new ones goes on.
                (Err(_), _) if step > LIMIT_TOLERANCE && part > LEAST_PART => {
                    if outer.is_none() {
                        step *= 0.5
                    } else {
                        part *= 0.5
                    }
                    self.workspace.linear.discard();
                }
                (Err(_), _) => break,
            }
        }
        Err(no_limit(self.workspace, self.sheet))
    }
}
