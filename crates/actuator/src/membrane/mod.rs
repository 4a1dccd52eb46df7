//! The annular membrane of an actuator with its Maxwell branches: equilibria at a load and a voltage, and their tangents.
//!
//! The equations and their solution are those of [`crate::statics`]; here the branches' dashpots stand where they are told.

mod dashpots;
mod equilibrium;
mod solve;
mod tangent;

pub use crate::statics::Load;
pub use dashpots::{DashpotRates, Dashpots};
pub use equilibrium::Equilibrium;
pub(crate) use tangent::Sensitivity;
pub use tangent::{Network, Tangent};

use crate::collocation::ChebyshevGrid;
use crate::statics::{Sheet, StaticSolver};
use crate::{ActuatorParameters, Error};

pub use crate::statics::DEFAULT_DEGREE;

/// An annular membrane with the Maxwell branches of an actuator's parameters.
///
/// **Method**: see [`StaticSolver`]; a branch adds its stress at fixed dashpots to that of the network at every node.
///
/// **Accuracy**: 1e-12 relative at degree 24 for the built-in geometry, and at degree 16 nearly so.
///
/// **Example**
/// ```
/// use telepulse_actuator::{ParameterSet, membrane::Membrane};
/// let membrane = Membrane::new(&ParameterSet::A.parameters())?;
/// let rest = membrane.rest(0.0)?;
/// assert!((rest.displacement_m() - 6.840664085e-3).abs() < 1e-12);
/// # Ok::<(), telepulse_actuator::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Membrane {
    parameters: ActuatorParameters,
    /// Copied for every solve, so that solving leaves the membrane as it is.
    solver: StaticSolver,
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
        let solver = StaticSolver::with_degree(&parameters.sheet()?, degree)?;
        Ok(Self { parameters: parameters.clone(), solver })
    }

    /// The parameters of this membrane.
    #[must_use]
    pub fn parameters(&self) -> &ActuatorParameters {
        &self.parameters
    }

    pub(crate) fn grid(&self) -> &ChebyshevGrid {
        self.solver.grid()
    }

    fn sheet(&self) -> &Sheet {
        self.solver.sheet()
    }
}
