//! Newton's method that keeps its factors for as long as they contract.

use super::kernel::{Evaluation, PointLaw, State};
use super::linearised::{Control, Electric, Held, Linearised, Step, Surroundings};
use super::operator::Operator;

/// Scratch of the solver: no solve allocates.
#[derive(Debug, Clone)]
pub(crate) struct Workspace {
    pub(crate) operator: Operator,
    pub(crate) state: State,
    pub(crate) at: Evaluation,
    pub(crate) linear: Linearised,
    pub(crate) step: Step,
    /// Estimated error of the state, relative to B, at which iteration ends.
    pub(crate) tolerance: f64,
    trial: State,
    tried: Evaluation,
}

/// What a solve took, or how it ended without one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Effort {
    /// Newton or chord steps.
    pub(crate) iterations: usize,
    /// Factorizations among them.
    pub(crate) factorizations: usize,
    /// Largest residual, relative to mu.
    pub(crate) residual: f64,
}

/// Error at which a static solve ends: a hundred times rounding.
const ERROR_TOLERANCE: f64 = 1e-13;
/// Rounding of a slope over the largest entry of the differentiation matrix.
const SLOPE_ROUNDING: f64 = 8.0 * f64::EPSILON;
/// Rounding of the residual, which is differentiated twice, over the square of that entry.
const RESIDUAL_ROUNDING: f64 = 64.0 * f64::EPSILON;
/// Residual that a converged state may have in any case, relative to the larger of mu and the largest stress.
const RESIDUAL_TOLERANCE: f64 = 1e-10;
/// Old factors are kept while each step is smaller than this part of the one before.
const CHORD_CONTRACTION: f64 = 0.2;
/// From a good start Newton takes 3 to 6 iterations; chord steps are cheaper and more.
const MAX_ITERATIONS: usize = 40;
/// Halvings of one Newton step.
const MAX_HALVINGS: usize = 12;
/// Error after a Newton step over the square of the step: an upper end of what is seen well inside the stable range.
const QUADRATIC: f64 = 10.0;
/// Part of the residual that a step with old factors must leave behind it.
const CHORD_DECREASE: f64 = 0.3;
/// Below this step the residual is rounding noise.
const NOISE_STEP: f64 = 1e-9;

impl Workspace {
    pub(crate) fn new(operator: Operator, state: State) -> Self {
        let degree = operator.degree;
        Self {
            at: Evaluation::new(degree),
            tried: Evaluation::new(degree),
            linear: Linearised::new(degree),
            step: Step::new(degree),
            tolerance: ERROR_TOLERANCE,
            trial: state.clone(),
            state,
            operator,
        }
    }

    /// Solves for the state nearest to the present one under `control`.
    ///
    /// **Method**: chord steps with the factors at hand while they contract fivefold, else Newton with halved steps while
    /// the residual grows. Ends where the estimated error falls below 1e-13 of B.
    ///
    /// After a failure the state is finite but of no use.
    pub(crate) fn solve<L: PointLaw>(&mut self, law: &L, control: Control) -> Result<Effort, Effort> {
        let mut effort = Effort { iterations: 0, factorizations: 0, residual: f64::INFINITY };
        impose(&mut self.state, control);
        if !self.at.at(&self.operator, law, &self.state) {
            return Err(effort);
        }
        let mut norm = self.norm(&self.state, control);
        let mut fresh = !self.linear.serves(control);
        let rounding_step = SLOPE_ROUNDING * self.operator.largest;
        let tolerance = RESIDUAL_TOLERANCE.max(RESIDUAL_ROUNDING * self.operator.largest.powi(2));
        let mut last_size = f64::INFINITY;
        while effort.iterations < MAX_ITERATIONS {
            effort.iterations += 1;
            if fresh {
                effort.factorizations += 1;
                last_size = f64::INFINITY;
                if !self.linear.factor(&self.operator, &self.at, self.state.field, control) {
                    break;
                }
            }
            self.linear.step(&self.operator, &self.at, &self.state, control, &mut self.step);
            let size = self.step.size();
            let contraction = size / last_size;
            let worn = !size.is_finite() || contraction > CHORD_CONTRACTION && size > rounding_step;
            let advance = if !fresh && worn { None } else { self.advance(law, control, norm, size, fresh) };
            let Some(advance) = advance else {
                if fresh {
                    break;
                }
                fresh = true;
                continue;
            };
            norm = advance.norm;
            if advance.full && (error_left(size, last_size, fresh) < self.tolerance || size < rounding_step) {
                effort.residual = self.largest_residual(control);
                let allowed = tolerance * (self.tolerance / ERROR_TOLERANCE).max(1.0);
                let small = effort.residual < allowed * self.at.stress_scale();
                return if small { Ok(effort) } else { Err(effort) };
            }
            last_size = size;
            fresh = !advance.full;
        }
        effort.residual = self.largest_residual(control);
        self.linear.discard();
        Err(effort)
    }

    /// Takes the step, halved until the residual falls; with old factors a full step or none.
    fn advance<L: PointLaw>(
        &mut self,
        law: &L,
        control: Control,
        norm: f64,
        size: f64,
        fresh: bool,
    ) -> Option<Advance> {
        let mut factor = 1.0;
        for _ in 0..if fresh { MAX_HALVINGS } else { 1 } {
            self.trial.copy_from(&self.state);
            self.step.apply(&mut self.trial, factor);
            if self.tried.at(&self.operator, law, &self.trial) {
                std::mem::swap(&mut self.at, &mut self.tried);
                let next = self.norm(&self.trial, control);
                let enough = if fresh { 1.0 - 1e-4 * factor } else { CHORD_DECREASE };
                // Near the solution the residual is rounding noise and need not fall.
                if next <= norm * enough || size < NOISE_STEP {
                    std::mem::swap(&mut self.state, &mut self.trial);
                    return Some(Advance { norm: next, full: factor == 1.0 });
                }
                std::mem::swap(&mut self.at, &mut self.tried);
            }
            factor *= 0.5;
        }
        None
    }

    /// Root of the summed squares of all residuals.
    fn norm(&self, state: &State, control: Control) -> f64 {
        let borders = self.border_residuals(state, control);
        let all = self.at.vertical.iter().chain(&self.at.balance).chain(&borders);
        all.map(|value| value * value).sum::<f64>().sqrt()
    }

    fn largest_residual(&self, control: Control) -> f64 {
        let borders = self.border_residuals(&self.state, control);
        let all = self.at.vertical.iter().chain(&self.at.balance).chain(&borders);
        all.fold(0.0, |largest: f64, value| largest.max(value.abs()))
    }

    fn border_residuals(&self, state: &State, control: Control) -> [f64; 2] {
        let Surroundings { compliance, parallel } = self.linear.surroundings;
        let load = match control.load {
            Held::Force(_) => 0.0,
            Held::Displacement(x) => self.at.displacement + compliance * state.force - x,
        };
        let electric = match control.electric {
            Electric::Field(_) => 0.0,
            Electric::ChargeSquared(target) => {
                state.field * (self.at.capacitance + parallel).powi(2) - target
            }
            Electric::Displacement(x) => self.at.displacement - x,
        };
        [load, electric]
    }
}

/// A step that was taken.
struct Advance {
    norm: f64,
    /// Not halved.
    full: bool,
}

/// Puts what is prescribed and is itself an unknown of the state into it.
fn impose(state: &mut State, control: Control) {
    if let Held::Force(force) = control.load {
        state.force = force;
    }
    if let Electric::Field(field) = control.electric {
        state.field = field;
    }
}

/// Estimated error after a full step: quadratic after a Newton step, geometric after chord steps.
fn error_left(size: f64, last_size: f64, fresh: bool) -> f64 {
    if last_size.is_finite() {
        let contraction = size / last_size;
        size * contraction / (1.0 - contraction).max(0.1)
    } else if fresh {
        QUADRATIC * size * size
    } else {
        size
    }
}
