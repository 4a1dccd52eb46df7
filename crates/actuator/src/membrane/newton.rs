//! Newton's method with line search, and continuation in load and voltage.

use super::assembly::{Closure, Residual, Shape, jacobian, residual};
use super::{Dashpots, Equilibrium, Membrane};
use crate::Error;
use crate::material::{ElasticLaw, first_invariant};

/// How the plate is held.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Load {
    /// The plate stands at this displacement, m, positive down, zero in the plane of the frame.
    DisplacementM(f64),
    /// The membrane carries this force, N, positive where it pulls the plate up.
    ForceN(f64),
}

/// Newton stops after the step whose largest entry, relative to B, falls below this; convergence is quadratic there, so the
/// error left is far below rounding.
const STEP_TOLERANCE: f64 = 1e-9;
/// Largest residual, relative to the larger of mu and the largest stress, that a converged state may have. Rounding of two differentiations leaves 1e-12.
const RESIDUAL_TOLERANCE: f64 = 1e-9;
/// From a good start Newton takes 3 to 6 iterations.
const MAX_ITERATIONS: usize = 40;
/// Halvings of one Newton step.
const MAX_HALVINGS: usize = 25;
/// Steps on one leg of the continuation.
const MAX_CONTINUATION_STEPS: usize = 400;
/// Smallest part of a leg that continuation tries before it gives up.
const MIN_CONTINUATION_STEP: f64 = 1e-5;
/// Continuation rejects a step that moves the plate by more than this part of B: it may have left the branch.
const MAX_PLATE_STEP: f64 = 0.1;
/// Part of the load at which continuation starts without pre-stretch: the flat state has no stiffness there.
const UNSTRETCHED_START: f64 = 0.02;
/// Part of the Gent limit beyond which a failure is blamed on it.
const GENT_BLAME: f64 = 0.95;

impl Membrane {
    /// Equilibrium of the relaxed membrane with the plate at `displacement_m`.
    ///
    /// # Errors
    /// See [`Membrane::solve`].
    pub fn solve_at_displacement(&self, displacement_m: f64, voltage_v: f64) -> Result<Equilibrium, Error> {
        self.solve(Load::DisplacementM(displacement_m), voltage_v, &Dashpots::absent())
    }

    /// Stable equilibrium of the relaxed membrane that carries `force_n`.
    ///
    /// # Errors
    /// See [`Membrane::solve`].
    pub fn solve_at_force(&self, force_n: f64, voltage_v: f64) -> Result<Equilibrium, Error> {
        self.solve(Load::ForceN(force_n), voltage_v, &Dashpots::absent())
    }

    /// Stable relaxed equilibrium under the weight of plate and load.
    ///
    /// # Errors
    /// See [`Membrane::solve`].
    pub fn rest(&self, voltage_v: f64) -> Result<Equilibrium, Error> {
        self.solve_at_force(self.parameters().weight_n(), voltage_v)
    }

    /// Equilibrium at a load and a voltage, with the branches' dashpots held where `dashpots` says.
    ///
    /// **Method**: Newton from the shape of a uniformly tensioned membrane. Where that fails, or at dead load ends in
    /// a state that is slack or unstable (and so may lie beyond the limit point), continuation from the flat state at zero
    /// voltage, first in load, then in voltage squared, with step control.
    ///
    /// **Accuracy**: see [`Membrane`]. A slack state is returned, not refused ([`Equilibrium::require_taut`]): the
    /// membrane equations still hold there, but a real membrane wrinkles.
    ///
    /// # Errors
    /// [`Error::Request`], [`Error::BeyondLimitPoint`] (dead load only), [`Error::GentLimit`],
    /// [`Error::NotConverged`], [`Error::SingularTangent`].
    pub fn solve(&self, load: Load, voltage_v: f64, dashpots: &Dashpots) -> Result<Equilibrium, Error> {
        check_request(load, voltage_v)?;
        let field = self.field_scale() * voltage_v * voltage_v;
        let closure = self.closure(load);
        let start = Shape::guess(self, self.guess_displacement(closure, field));
        if let Ok(found) = self.newton(dashpots, start, field, closure) {
            let equilibrium = self.equilibrium(dashpots, found, field, voltage_v)?;
            let trusted = match load {
                Load::DisplacementM(_) => true,
                Load::ForceN(_) => {
                    equilibrium.s2_min_pa() > 0.0 && self.stiffness(dashpots, &equilibrium)? > 0.0
                }
            };
            if trusted {
                return Ok(equilibrium);
            }
        }
        self.continuation(load, voltage_v, dashpots)
    }

    /// Equilibrium near a known one: Newton from its shape, and [`Membrane::solve`] where that fails.
    ///
    /// # Errors
    /// See [`Membrane::solve`].
    pub fn solve_near(
        &self,
        known: &Equilibrium,
        load: Load,
        voltage_v: f64,
        dashpots: &Dashpots,
    ) -> Result<Equilibrium, Error> {
        check_request(load, voltage_v)?;
        let field = self.field_scale() * voltage_v * voltage_v;
        let closure = self.closure(load);
        match self.newton(dashpots, known.shape().clone(), field, closure) {
            Ok(found) => {
                let equilibrium = self.equilibrium(dashpots, found, field, voltage_v)?;
                let moved = (equilibrium.displacement_m() - known.displacement_m()).abs();
                let near = moved < MAX_PLATE_STEP * self.length_scale();
                let stable = match load {
                    Load::DisplacementM(_) => true,
                    Load::ForceN(_) => near && self.stiffness(dashpots, &equilibrium)? > 0.0,
                };
                if stable { Ok(equilibrium) } else { self.solve(load, voltage_v, dashpots) }
            }
            Err(_) => self.solve(load, voltage_v, dashpots),
        }
    }

    pub(super) fn closure(&self, load: Load) -> Closure {
        match load {
            Load::DisplacementM(x) => Closure::Displacement(x / self.length_scale()),
            Load::ForceN(force) => Closure::Force(force / self.force_scale()),
        }
    }

    /// Displacement of a flat membrane under uniform tension s: x = (F/(2 pi H)) (lp/s) ln(B/A), kept within a quarter of B.
    fn guess_displacement(&self, closure: Closure, field: f64) -> f64 {
        match closure {
            Closure::Displacement(x) => x,
            Closure::Force(force) => {
                let prestretch = self.parameters().spec().prestretch;
                let elastic = self.law().stress(prestretch, prestretch).map_or(0.0, |s| s.s1);
                let tension = (elastic - field * prestretch.powi(3)).max(0.1 * elastic).max(1e-3);
                let linear = force * prestretch / tension * -self.grid().nodes()[0].ln();
                linear.clamp(-0.25, 0.25)
            }
        }
    }

    fn newton(
        &self,
        dashpots: &Dashpots,
        start: Shape,
        field: f64,
        closure: Closure,
    ) -> Result<Converged, NewtonFailure> {
        let mut shape = start;
        let mut current = residual(self, dashpots, &shape, field, closure)
            .ok_or(NewtonFailure { residual: f64::INFINITY, iterations: 0 })?;
        for iteration in 1..=MAX_ITERATIONS {
            let failure = NewtonFailure { residual: current.value.amax(), iterations: iteration };
            let step = -jacobian(self, &current, closure).lu().solve(&current.value).ok_or(failure)?;
            let size = step.amax();
            if !size.is_finite() {
                return Err(failure);
            }
            let norm = current.value.norm();
            let mut factor = 1.0;
            let mut accepted = None;
            for _ in 0..MAX_HALVINGS {
                let trial = shape.stepped(&step, factor);
                if let Some(next) = residual(self, dashpots, &trial, field, closure) {
                    // Near the solution the residual is rounding noise and need not fall.
                    if next.value.norm() < norm * (1.0 - 1e-4 * factor) || size < STEP_TOLERANCE {
                        accepted = Some((trial, next));
                        break;
                    }
                }
                factor *= 0.5;
            }
            let (next_shape, next) = accepted.ok_or(failure)?;
            shape = next_shape;
            current = next;
            if size < STEP_TOLERANCE && factor == 1.0 {
                let largest = current.value.amax();
                return if largest < RESIDUAL_TOLERANCE * current.stress_scale {
                    Ok(Converged { shape, residual: current, iterations: iteration })
                } else {
                    Err(NewtonFailure { residual: largest, iterations: iteration })
                };
            }
        }
        Err(NewtonFailure { residual: current.value.amax(), iterations: MAX_ITERATIONS })
    }

    /// From no load (or little, where there is no pre-stretch to hold the flat state) to the full load at zero voltage, then
    /// to the full voltage.
    fn continuation(&self, load: Load, voltage_v: f64, dashpots: &Dashpots) -> Result<Equilibrium, Error> {
        let field = self.field_scale() * voltage_v * voltage_v;
        let target = self.closure(load);
        let scaled = |part: f64| match target {
            Closure::Displacement(x) => Closure::Displacement(part * x),
            Closure::Force(force) => Closure::Force(part * force),
        };
        let first_part = if self.parameters().spec().prestretch > 1.0 { 0.0 } else { UNSTRETCHED_START };
        let start = scaled(first_part);
        let guess = Shape::guess(self, self.guess_displacement(start, 0.0));
        let first = self.newton(dashpots, guess, 0.0, start).map_err(|failure| Error::NotConverged {
            voltage_v,
            residual: failure.residual,
            iterations: failure.iterations,
        })?;
        let loaded = self.leg(
            dashpots,
            first,
            |t| (0.0, scaled(first_part + (1.0 - first_part) * t)),
            load,
            voltage_v,
        )?;
        let found = if voltage_v > 0.0 {
            self.leg(dashpots, loaded, |t| (t * field, target), load, voltage_v)?
        } else {
            loaded
        };
        self.equilibrium(dashpots, found, field, voltage_v)
    }

    /// Follows `path` from 0 to 1 with step control; at dead load every state on it must be stable.
    fn leg(
        &self,
        dashpots: &Dashpots,
        start: Converged,
        path: impl Fn(f64) -> (f64, Closure),
        load: Load,
        voltage_v: f64,
    ) -> Result<Converged, Error> {
        let mut known = start;
        let (mut position, mut step) = (0.0, 0.25_f64);
        let mut last_failure = NewtonFailure { residual: 0.0, iterations: 0 };
        for _ in 0..MAX_CONTINUATION_STEPS {
            if position >= 1.0 {
                return Ok(known);
            }
            let next = (position + step).min(1.0);
            let (field, closure) = path(next);
            let accepted = match self.newton(dashpots, known.shape.clone(), field, closure) {
                Ok(found) => {
                    let moved = (found.shape.z[0] - known.shape.z[0]).abs();
                    let stable = matches!(closure, Closure::Displacement(_))
                        || (moved < MAX_PLATE_STEP && self.stiffness_of(&found.residual, voltage_v)? > 0.0);
                    stable.then_some(found)
                }
                Err(failure) => {
                    last_failure = failure;
                    None
                }
            };
            match accepted {
                Some(found) => {
                    known = found;
                    position = next;
                    step *= 1.5;
                }
                None => step *= 0.5,
            }
            if step < MIN_CONTINUATION_STEP {
                break;
            }
        }
        Err(self.blame(dashpots, &known, path(position), load, voltage_v, last_failure)?)
    }

    /// Names the physical reason why a leg ended early.
    fn blame(
        &self,
        dashpots: &Dashpots,
        known: &Converged,
        reached: (f64, Closure),
        load: Load,
        voltage_v: f64,
        failure: NewtonFailure,
    ) -> Result<Error, Error> {
        let reached_voltage_v = (reached.0 / self.field_scale()).sqrt();
        let state = self.equilibrium(dashpots, known.clone(), reached.0, reached_voltage_v)?;
        if let ElasticLaw::Gent { limit } = *self.law() {
            let invariant = state
                .lambda1()
                .iter()
                .zip(state.lambda2())
                .map(|(&l1, &l2)| first_invariant(l1, l2) - 3.0)
                .fold(0.0, f64::max);
            if invariant > GENT_BLAME * limit {
                return Ok(Error::GentLimit { invariant, gent_limit: limit });
            }
        }
        Ok(match load {
            Load::ForceN(force_n) => Error::BeyondLimitPoint {
                voltage_v,
                force_n,
                reached_voltage_v,
                reached_force_n: state.force_n(),
                stiffness_n_per_m: self.stiffness_of(&known.residual, voltage_v)?,
            },
            Load::DisplacementM(_) => {
                Error::NotConverged { voltage_v, residual: failure.residual, iterations: failure.iterations }
            }
        })
    }
}

/// A converged state in the solver's own units.
#[derive(Debug, Clone)]
pub(super) struct Converged {
    pub(super) shape: Shape,
    pub(super) residual: Residual,
    pub(super) iterations: usize,
}

#[derive(Debug, Clone, Copy)]
struct NewtonFailure {
    residual: f64,
    iterations: usize,
}

fn check_request(load: Load, voltage_v: f64) -> Result<(), Error> {
    let (quantity, value) = match load {
        Load::DisplacementM(x) => ("displacement_m", x),
        Load::ForceN(force) => ("force_n", force),
    };
    if !value.is_finite() {
        return Err(Error::Request { quantity, allowed: "finite", found: value });
    }
    if !(voltage_v.is_finite() && voltage_v >= 0.0) {
        return Err(Error::Request {
            quantity: "voltage_v",
            allowed: "finite and not negative",
            found: voltage_v,
        });
    }
    Ok(())
}
