//! Companion forms: the coefficients of the transfer function themselves.

use nalgebra::DMatrix;
use telepulse_lti::{Continuous, StateSpace};

use super::delta_system::DeltaSystem;
use super::program::{Operator, StepProgram};
use crate::Result;

/// Which of the two companion forms.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Companion {
    /// Denominator in the first row, numerator in the output.
    Controller,
    /// Denominator in the first column, numerator in the input.
    Observer,
}

/// A system with one input and one output in companion form.
///
/// **Method**: the transfer function in `z` (shift) or in `z - 1` (delta), its states scaled by powers of two. In the shift operator
/// this is the form that textbooks and code generators write, and the one that loses most at high rates: it is here to be
/// compared with.
///
/// **Source**: Zhou and Doyle 1998, section 3.7; Middleton and Goodwin 1986 for the delta operator.
#[derive(Debug, Clone, PartialEq)]
pub struct CompanionForm {
    /// One tick.
    pub program: StepProgram,
    /// Which form.
    pub companion: Companion,
    /// In which operator.
    pub operator: Operator,
}

impl CompanionForm {
    /// The companion form of a system.
    ///
    /// # Errors
    /// A system error for more than one input or output, or eigenvalues that do not converge.
    pub fn new(sys: &DeltaSystem, companion: Companion, operator: Operator) -> Result<Self> {
        let mut matrices = sys.increment().clone();
        if operator == Operator::Shift {
            let a = matrices.a() + DMatrix::<f64>::identity(matrices.n_states(), matrices.n_states());
            matrices = StateSpace::<Continuous>::new(
                a,
                matrices.b().clone(),
                matrices.c().clone(),
                matrices.d().clone(),
            )?;
        }
        let controller = matrices.to_transfer_function()?.to_state_space();
        let equation = match companion {
            Companion::Controller => controller,
            Companion::Observer => StateSpace::<Continuous>::new(
                controller.a().transpose(),
                controller.c().transpose(),
                controller.b().transpose(),
                controller.d().clone(),
            )?,
        };
        let program = StepProgram::from_matrices(&equation, operator, sys.sample_time());
        Ok(Self { program, companion, operator })
    }
}
