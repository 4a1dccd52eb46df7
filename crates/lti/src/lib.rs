//! Linear time-invariant systems: the language of control.
//!
//! Systems in [`StateSpace`] form and as [`TransferFunction`], their interconnection, responses, discretization,
//! poles and zeros, norms, margins and the matrix equations of robust control. Continuous and discrete time are
//! different types. Nothing here reads a file, a clock or the environment, or prints.
//!
//! **Conventions**: frequencies and poles in rad/s; polynomials in descending powers; feedback is negative.

pub mod balance;
mod compensated;
pub mod connect;
pub mod coprime;
pub mod discretize;
pub mod domain;
pub mod doubled_matrix;
mod doubled_solve;
pub mod eigenvalues;
pub mod error;
mod francis;
pub mod generalized_plant;
pub mod hessenberg;
pub mod hinf_norm;
pub mod interconnect;
mod isolation;
pub mod lyapunov;
pub mod margins;
pub mod norms;
pub mod polynomial;
pub mod realization;
pub mod reduce;
pub mod response;
pub mod riccati;
pub mod schur;
pub mod simulate;
mod square_reduced;
pub mod state_space;
pub mod sylvester;
pub mod transfer_function;
mod triangular_equation;
mod vectorized;
pub mod zeros;

pub use connect::{Diagram, NamedSystem};
pub use domain::{Continuous, Discrete, SampleTime, TimeDomain};
pub use error::Error;
pub use generalized_plant::GeneralizedPlant;
pub use hinf_norm::{PeakGain, hinf_norm};
pub use interconnect::Wiring;
pub use margins::LoopMargins;
pub use response::FrequencyResponse;
pub use simulate::StepResponse;
pub use state_space::StateSpace;
pub use transfer_function::TransferFunction;
