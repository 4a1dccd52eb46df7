//! Modal form: one block per pole, pair or cluster, each advanced by its increment.

use nalgebra::DMatrix;
use telepulse_lti::reduce::block_diagonalize;
use telepulse_lti::{Continuous, StateSpace};

use super::delta_system::DeltaSystem;
use super::program::{Operator, StepProgram};
use crate::Result;

/// A system in real modal form, for any number of ports; poles that cannot be told apart share a block.
///
/// **Method**: the increment is block-diagonalised with a bounded transformation; a pair becomes
/// `[[sigma, omega], [-omega, sigma]]`, and input and output gains of every block are brought to like size.
///
/// **Source**: Bavely and Stewart 1979; Gevers and Li 1993, "Parametrizations in Control, Estimation and Filtering
/// Problems", chapters 10 and 11.
///
/// **Example**: two equal poles share a block, which a form of single modes could not hold.
/// ```
/// use telepulse_design::implement::Discretization;
/// use telepulse_design::implement::forms::{DeltaSystem, ModalForm, Operator};
/// use telepulse_lti::{SampleTime, TransferFunction};
/// let double = TransferFunction::new(&[1.0], &[1.0, 4.0, 4.0])?.to_state_space();
/// let sys = DeltaSystem::tustin(&double, SampleTime::new(1e-3)?, Discretization::Tustin)?;
/// let form = ModalForm::new(&sys, Operator::Delta)?;
/// assert_eq!(form.block_sizes, [2]);
/// assert!((form.program.to_delta()?.at(1.0)? - sys.at(1.0)?).norm() < 1e-12);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct ModalForm {
    /// One tick.
    pub program: StepProgram,
    /// Sizes of the blocks from the top; more than two states only for clustered poles.
    pub block_sizes: Vec<usize>,
    /// Condition number of the transformation to the modes.
    pub condition: f64,
}

impl ModalForm {
    /// The modal form of a system in the given operator.
    ///
    /// # Errors
    /// Eigenvalues that do not converge.
    pub fn new(sys: &DeltaSystem, operator: Operator) -> Result<Self> {
        let done = block_diagonalize(sys.increment(), COUPLING_MAX)?;
        let (mut a, mut b, mut c) = (done.sys.a().clone(), done.sys.b().clone(), done.sys.c().clone());
        let mut scale = |k: usize, f: f64| {
            a.column_mut(k).scale_mut(f);
            a.row_mut(k).unscale_mut(f);
            b.row_mut(k).unscale_mut(f);
            c.column_mut(k).scale_mut(f);
        };
        let mut start = 0;
        for &size in &done.block_sizes {
            let (upper, lower) = if size == 2 {
                (done.sys.a()[(start, start + 1)], done.sys.a()[(start + 1, start)])
            } else {
                (0.0, 0.0)
            };
            // A pair: off-diagonals of one size.
            if lower != 0.0 {
                scale(start + 1, (lower / upper).abs().sqrt());
            }
            start += size;
        }
        let mut start = 0;
        for &size in &done.block_sizes {
            let (input, output) = (b.rows(start, size).norm(), c.columns(start, size).norm());
            if input > 0.0 && output > 0.0 {
                let f = (output / input).sqrt();
                b.rows_mut(start, size).scale_mut(f);
                c.columns_mut(start, size).unscale_mut(f);
            }
            start += size;
        }
        if operator == Operator::Shift {
            a += DMatrix::<f64>::identity(a.nrows(), a.nrows());
        }
        let equation = StateSpace::<Continuous>::new(a, b, c, done.sys.d().clone())?;
        let program = StepProgram::from_matrices(&equation, operator, sys.sample_time());
        Ok(Self { program, block_sizes: done.block_sizes, condition: done.condition })
    }
}

/// Largest entry of a decoupling matrix: four digits may go, of which two precisions have seven and sixteen.
const COUPLING_MAX: f64 = 1e4;
