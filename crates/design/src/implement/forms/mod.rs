//! Forms in which a controller can run, and what finite precision costs in each.
//!
//! - [`DeltaSystem`]: a discrete system held as `z - 1`; [`StepProgram`], [`Stepper`]: one tick, operation by operation;
//! - [`ModalForm`], [`SectionForm`], [`CompanionForm`]: the forms, each in the shift or the delta operator;
//! - [`predict`]: coefficient and roundoff error; [`recommend`]: the form with the least of both.

mod companion;
mod delta_system;
mod finite_precision;
mod modal;
mod program;
mod recommend;
mod sections;

pub use companion::{Companion, CompanionForm};
pub use delta_system::DeltaSystem;
pub use finite_precision::{PrecisionReport, predict};
pub use modal::ModalForm;
pub use program::{Operator, Precision, Real, StepProgram, Stepper};
pub use recommend::{Candidate, FormKind, compare_forms, recommend};
pub use sections::{Section, SectionForm, SectionScaling};
