//! One tick as a list of multiplications and additions, which can be run, converted back and judged in any precision.

use std::ops::{Add, Mul};

use nalgebra::DMatrix;
use telepulse_lti::{Continuous, Discrete, SampleTime, StateSpace};

use super::delta_system::DeltaSystem;
use crate::{Error, Result};

/// Floating-point arithmetic of the target.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Precision {
    /// `f32`: 24 bits.
    Single,
    /// `f64`: 53 bits.
    Double,
}

impl Precision {
    /// Largest relative error of one rounding to nearest.
    #[must_use]
    pub fn unit_roundoff(self) -> f64 {
        match self {
            Self::Single => f64::from(f32::EPSILON) / 2.0,
            Self::Double => f64::EPSILON / 2.0,
        }
    }

    /// The nearest number of this precision.
    #[must_use]
    pub fn round(self, value: f64) -> f64 {
        match self {
            Self::Single => f64::from(value as f32),
            Self::Double => value,
        }
    }
}

/// A number type in which a program can be run.
pub trait Real: Copy + Add<Output = Self> + Mul<Output = Self> {
    /// The nearest number of this type.
    fn from_f64(value: f64) -> Self;
    /// The number as a double.
    fn to_f64(self) -> f64;
}

impl Real for f32 {
    fn from_f64(value: f64) -> Self {
        value as f32
    }

    fn to_f64(self) -> f64 {
        f64::from(self)
    }
}

impl Real for f64 {
    fn from_f64(value: f64) -> Self {
        value
    }

    fn to_f64(self) -> f64 {
        self
    }
}

/// A value inside of a tick: states first, then inputs, then the results of the operations.
pub(super) type Node = usize;

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Operation {
    /// A coefficient times a value.
    Multiply { coefficient: usize, of: Node },
    /// The sum of two values.
    Add { left: Node, right: Node },
}

/// What becomes of a state at the end of a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Update {
    /// The state takes this value.
    Replace(Option<Node>),
    /// This value is added to the state.
    Increment(Option<Node>),
}

/// The operator in which a state equation is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Operator {
    /// `x[k+1] = A x[k] + B u[k]`.
    Shift,
    /// `x[k+1] = x[k] + (A x[k] + B u[k])`.
    Delta,
}

/// One tick of a discrete system as multiplications by coefficients and additions, each of which rounds.
///
/// **Shapes and units**: the outputs belong to the states before the update. Terms with the coefficient zero are left out, those
/// with the coefficient one are not multiplied.
#[derive(Debug, Clone, PartialEq)]
pub struct StepProgram {
    pub(super) n_states: usize,
    pub(super) n_inputs: usize,
    pub(super) sample_time: SampleTime,
    pub(super) coefficients: Vec<f64>,
    pub(super) operations: Vec<Operation>,
    pub(super) updates: Vec<Update>,
    pub(super) outputs: Vec<Option<Node>>,
}

impl StepProgram {
    pub(super) fn empty(n_states: usize, n_inputs: usize, sample_time: SampleTime) -> Self {
        let (coefficients, operations, outputs) = (Vec::new(), Vec::new(), Vec::new());
        let updates = vec![Update::Replace(None); n_states];
        Self { n_states, n_inputs, sample_time, coefficients, operations, updates, outputs }
    }

    /// The program of a state equation written in the given operator, row by row, without its zeros.
    ///
    /// `equation` holds `A` (or `A - I` for [`Operator::Delta`]), `B`, `C` and `D`.
    #[must_use]
    pub fn from_matrices(
        equation: &StateSpace<Continuous>,
        operator: Operator,
        sample_time: SampleTime,
    ) -> Self {
        let (n, m) = (equation.n_states(), equation.n_inputs());
        let mut program = Self::empty(n, m, sample_time);
        let terms = |of_x: &DMatrix<f64>, of_u: &DMatrix<f64>, row: usize| {
            let states = (0..n).map(|k| (of_x[(row, k)], k));
            states.chain((0..m).map(|k| (of_u[(row, k)], n + k))).collect::<Vec<_>>()
        };
        program.outputs =
            (0..equation.n_outputs()).map(|k| program.dot(&terms(equation.c(), equation.d(), k))).collect();
        for k in 0..n {
            let value = program.dot(&terms(equation.a(), equation.b(), k));
            program.updates[k] = match operator {
                Operator::Shift => Update::Replace(value),
                Operator::Delta => Update::Increment(value),
            };
        }
        program
    }

    /// Appends a sum of products; `None` where nothing is left of it.
    pub(super) fn dot(&mut self, terms: &[(f64, Node)]) -> Option<Node> {
        let mut sum = None;
        for &(coefficient, of) in terms {
            if coefficient == 0.0 {
                continue;
            }
            let product = if coefficient == 1.0 {
                of
            } else {
                self.coefficients.push(coefficient);
                self.push(Operation::Multiply { coefficient: self.coefficients.len() - 1, of })
            };
            sum = Some(match sum {
                None => product,
                Some(left) => self.push(Operation::Add { left, right: product }),
            });
        }
        sum
    }

    fn push(&mut self, operation: Operation) -> Node {
        self.operations.push(operation);
        self.n_states + self.n_inputs + self.operations.len() - 1
    }

    /// Number of states.
    #[must_use]
    pub fn n_states(&self) -> usize {
        self.n_states
    }

    /// Number of inputs.
    #[must_use]
    pub fn n_inputs(&self) -> usize {
        self.n_inputs
    }

    /// Number of outputs.
    #[must_use]
    pub fn n_outputs(&self) -> usize {
        self.outputs.len()
    }

    /// The coefficients, in the order of their use.
    #[must_use]
    pub fn coefficients(&self) -> &[f64] {
        &self.coefficients
    }

    /// Multiplications and additions per tick.
    #[must_use]
    pub fn n_operations(&self) -> usize {
        let increments = self.updates.iter().filter(|u| matches!(u, Update::Increment(Some(_)))).count();
        self.operations.len() + increments
    }

    /// The same program with every coefficient rounded.
    #[must_use]
    pub fn rounded(&self, precision: Precision) -> Self {
        let mut program = self.clone();
        program.coefficients.iter_mut().for_each(|c| *c = precision.round(*c));
        program
    }

    /// Every value of a tick as a linear function of states and inputs: one column per node.
    pub(super) fn node_functions(&self) -> DMatrix<f64> {
        let n_given = self.n_states + self.n_inputs;
        let mut functions = DMatrix::zeros(n_given, n_given + self.operations.len());
        functions.view_mut((0, 0), (n_given, n_given)).fill_with_identity();
        for (k, operation) in self.operations.iter().enumerate() {
            let value = match *operation {
                Operation::Multiply { coefficient, of } => {
                    functions.column(of) * self.coefficients[coefficient]
                }
                Operation::Add { left, right } => functions.column(left) + functions.column(right),
            };
            functions.set_column(n_given + k, &value);
        }
        functions
    }

    /// How an error of each value appears in the next states and the outputs: one column per node.
    pub(super) fn node_effects(&self) -> DMatrix<f64> {
        let n_given = self.n_states + self.n_inputs;
        let n_results = self.n_states + self.outputs.len();
        let mut effects = DMatrix::zeros(n_results, n_given + self.operations.len());
        for (k, update) in self.updates.iter().enumerate() {
            if let Update::Replace(Some(node)) | Update::Increment(Some(node)) = *update {
                effects[(k, node)] += 1.0;
            }
        }
        for (k, output) in self.outputs.iter().enumerate() {
            if let Some(node) = *output {
                effects[(self.n_states + k, node)] += 1.0;
            }
        }
        for (k, operation) in self.operations.iter().enumerate().rev() {
            let own = effects.column(n_given + k).into_owned();
            match *operation {
                Operation::Multiply { coefficient, of } => {
                    let mut column = effects.column_mut(of);
                    column += own * self.coefficients[coefficient];
                }
                Operation::Add { left, right } => {
                    for node in [left, right] {
                        let mut column = effects.column_mut(node);
                        column += &own;
                    }
                }
            }
        }
        effects
    }

    /// The system that the program realises in exact arithmetic.
    ///
    /// # Errors
    /// A system error for coefficients that are not finite.
    pub fn to_delta(&self) -> Result<DeltaSystem> {
        let functions = self.node_functions();
        let (n, m) = (self.n_states, self.n_inputs);
        let mut rows = DMatrix::zeros(n + self.outputs.len(), n + m);
        for (k, update) in self.updates.iter().enumerate() {
            match *update {
                Update::Increment(None) => {}
                Update::Increment(Some(node)) => {
                    rows.row_mut(k).copy_from(&functions.column(node).transpose())
                }
                Update::Replace(node) => {
                    if let Some(node) = node {
                        rows.row_mut(k).copy_from(&functions.column(node).transpose());
                    }
                    rows[(k, k)] -= 1.0;
                }
            }
        }
        for (k, output) in self.outputs.iter().enumerate() {
            if let Some(node) = *output {
                rows.row_mut(n + k).copy_from(&functions.column(node).transpose());
            }
        }
        let p = self.outputs.len();
        let part = |i: usize, j: usize, r: usize, c: usize| rows.view((i, j), (r, c)).into_owned();
        let increment = StateSpace::<Continuous>::new(
            part(0, 0, n, n),
            part(0, n, n, m),
            part(n, 0, p, n),
            part(n, n, p, m),
        )?;
        Ok(DeltaSystem::new(increment, self.sample_time))
    }

    /// The system that the program realises, in the usual form.
    ///
    /// # Errors
    /// A system error for coefficients that are not finite.
    pub fn to_discrete(&self) -> Result<StateSpace<Discrete>> {
        self.to_delta()?.to_discrete()
    }

    /// The program at rest, ready to run in the arithmetic of `T`.
    #[must_use]
    pub fn stepper<T: Real>(&self) -> Stepper<T> {
        let zero = T::from_f64(0.0);
        Stepper {
            coefficients: self.coefficients.iter().map(|&c| T::from_f64(c)).collect(),
            values: vec![zero; self.n_states + self.n_inputs + self.operations.len()],
            next: vec![zero; self.n_states],
            program: self.clone(),
        }
    }
}

/// A program with its states, in one arithmetic.
///
/// **Example**: a summator.
/// ```
/// use nalgebra::dmatrix;
/// use telepulse_design::implement::forms::{Operator, StepProgram};
/// use telepulse_lti::{Continuous, SampleTime, StateSpace};
/// let sum = StateSpace::<Continuous>::new(dmatrix![0.0], dmatrix![1.0], dmatrix![1.0], dmatrix![0.0])?;
/// let mut run = StepProgram::from_matrices(&sum, Operator::Delta, SampleTime::new(1.0)?).stepper::<f32>();
/// let mut y = [0.0];
/// for u in [1.0, 2.0, 4.0] {
///     run.step(&[u], &mut y)?;
/// }
/// assert_eq!(y, [3.0]);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Stepper<T: Real> {
    program: StepProgram,
    coefficients: Vec<T>,
    values: Vec<T>,
    next: Vec<T>,
}

impl<T: Real> Stepper<T> {
    /// Advances by one tick: writes the outputs, then updates the states. Every operation rounds to `T`. Does not allocate.
    ///
    /// # Errors
    /// [`Error::SampleCount`] where inputs or outputs are not as many as the program has.
    pub fn step(&mut self, inputs: &[T], outputs: &mut [T]) -> Result<()> {
        let program = &self.program;
        let (n, m) = (program.n_states, program.n_inputs);
        for (signal, expected, found) in
            [("inputs", m, inputs.len()), ("outputs", program.outputs.len(), outputs.len())]
        {
            if expected != found {
                return Err(Error::SampleCount { signal, expected, found });
            }
        }
        self.values[n..n + m].copy_from_slice(inputs);
        for (k, operation) in program.operations.iter().enumerate() {
            self.values[n + m + k] = match *operation {
                Operation::Multiply { coefficient, of } => self.coefficients[coefficient] * self.values[of],
                Operation::Add { left, right } => self.values[left] + self.values[right],
            };
        }
        let zero = T::from_f64(0.0);
        for (target, node) in outputs.iter_mut().zip(&program.outputs) {
            *target = node.map_or(zero, |node| self.values[node]);
        }
        // A state may pass its value to another one, so none is overwritten before all are known.
        for (k, update) in program.updates.iter().enumerate() {
            self.next[k] = match *update {
                Update::Replace(node) => node.map_or(zero, |node| self.values[node]),
                Update::Increment(None) => self.values[k],
                Update::Increment(Some(node)) => self.values[k] + self.values[node],
            };
        }
        self.values[..n].copy_from_slice(&self.next);
        Ok(())
    }
}
