//! Equilibria of an annular membrane for any material, geometry and way of holding plate and electrodes.

mod continuation;
mod extrapolation;
mod kernel;
mod linearised;
mod lu;
mod newton;
mod operator;
mod sheet;
pub mod shooting;
mod solution;
mod solver;

pub use sheet::{Material, Prestretch, Sheet, SheetSpec};
pub use solution::{Derivatives, Electrodes, Load, Profile, Solution, StaticPoint};
pub use solver::StaticSolver;

pub(crate) use kernel::{Evaluation, PointLaw, State};
pub(crate) use linearised::{Cause, Control, Electric, Held, Linearised, Step, Surroundings};
pub(crate) use newton::{Effort, Workspace};
pub(crate) use solver::{SlackStates, summarise};

use crate::Error;

/// Degree that resolves ordinary membranes to 1e-12.
pub const DEFAULT_DEGREE: usize = 24;
/// Fewer nodes cannot hold the boundary layer at the plate.
const MIN_DEGREE: usize = 6;
/// More nodes only add rounding: it grows with the square of the degree.
const MAX_DEGREE: usize = 128;
/// Degrees that [`solve`] tries in turn.
const DEGREES: [usize; 5] = [DEFAULT_DEGREE, 36, 54, 80, MAX_DEGREE];
/// Size of the highest Chebyshev coefficients, relative to the largest, at which a solution counts as resolved.
const RESOLVED: f64 = 1e-11;

/// The equilibrium that continues the flat state, at the lowest degree that resolves it.
///
/// **Accuracy**: the highest Chebyshev coefficients are below 1e-11 of the largest, or the degree is 128.
///
/// # Errors
/// Those of [`StaticSolver::solve`] and [`StaticSolver::derivatives`].
pub fn solve(sheet: &Sheet, load: Load, electrodes: Electrodes) -> Result<Solution, Error> {
    for degree in DEGREES {
        let mut solver = StaticSolver::with_degree(sheet, degree)?;
        let solved = solver.solve(load, electrodes);
        let last = degree == MAX_DEGREE;
        match solved {
            Ok(_) if last || solver.resolution() < RESOLVED => return solver.solution(),
            // A coarse grid may fail where a finer one does not: what led to the refusal must be resolved.
            Err(error) if degree >= REFUSAL_DEGREE || solver.resolution() < REFUSED => return Err(error),
            _ => {}
        }
    }
    Err(Error::NoEquilibrium)
}

/// Resolution of the last state on the path at which a refusal is believed.
const REFUSED: f64 = 1e-6;
/// Degree from which a refusal is believed in any case.
const REFUSAL_DEGREE: usize = 54;
