//! Which form to run a controller in.

use telepulse_lti::SampleTime;
use telepulse_lti::{Continuous, StateSpace};

use super::companion::{Companion, CompanionForm};
use super::delta_system::DeltaSystem;
use super::finite_precision::{PrecisionReport, predict};
use super::modal::ModalForm;
use super::program::{Operator, Precision, StepProgram};
use super::sections::{SectionForm, SectionScaling};
use crate::Result;
use crate::implement::Discretization;

/// The forms that are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FormKind {
    /// [`ModalForm`] in the given operator.
    Modal(Operator),
    /// [`SectionForm`] in the given operator, scaled by peak gain.
    Sections(Operator),
    /// [`CompanionForm`] in the given operator.
    Companion(Companion, Operator),
}

/// A form, and what it is predicted to cost.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// Which form.
    pub kind: FormKind,
    /// One tick of it.
    pub program: StepProgram,
    /// Predicted error.
    pub report: PrecisionReport,
    /// What it is ranked by, see [`PrecisionReport::score`].
    pub score: f64,
}

/// Every form that the system has, best first. The first is the recommendation.
///
/// **Method**: each form is built and its error predicted by [`predict`]; forms within a factor of two of the best are as good, and of
/// those the one with the fewest operations per tick comes first. Cascade and companion forms exist for one input and one
/// output only.
///
/// # Errors
/// Those of [`DeltaSystem::tustin`] and [`ModalForm::new`]; a form that the system does not have is left out.
///
/// # Example
/// ```
/// use telepulse_design::implement::Discretization;
/// use telepulse_design::implement::forms::{FormKind, Operator, Precision, recommend};
/// use telepulse_lti::{SampleTime, TransferFunction};
/// let k = TransferFunction::new(&[1.0, 3.0], &[1.0, 20.0, 9000.0, 9.0])?.to_state_space();
/// let ranked = recommend(&k, SampleTime::from_rate_hz(10_000.0)?, Discretization::Tustin, Precision::Single)?;
/// assert!(matches!(ranked[0].kind, FormKind::Modal(Operator::Delta) | FormKind::Sections(Operator::Delta)));
/// assert!(ranked[0].score < 1e-3 && ranked[ranked.len() - 1].score > 1e-2);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn recommend(
    controller: &StateSpace<Continuous>,
    sample_time: SampleTime,
    discretization: Discretization,
    precision: Precision,
) -> Result<Vec<Candidate>> {
    compare_forms(&DeltaSystem::tustin(controller, sample_time, discretization)?, precision)
}

/// As [`recommend`], for a system that is discrete already.
///
/// # Errors
/// Those of [`ModalForm::new`]; a form that the system does not have is left out.
pub fn compare_forms(sys: &DeltaSystem, precision: Precision) -> Result<Vec<Candidate>> {
    let stable = sys.is_stable()?;
    let mut candidates = Vec::new();
    let mut add = |kind, program: StepProgram| -> Result<()> {
        let report = predict(&program, sys, precision)?;
        let score = report.score(stable);
        candidates.push(Candidate { kind, program, score, report });
        Ok(())
    };
    for operator in [Operator::Delta, Operator::Shift] {
        add(FormKind::Modal(operator), ModalForm::new(sys, operator)?.program)?;
        if (sys.increment().n_inputs(), sys.increment().n_outputs()) != (1, 1) {
            continue;
        }
        if let Ok(form) = SectionForm::new(sys, operator, SectionScaling::PeakGain) {
            add(FormKind::Sections(operator), form.program)?;
        }
        for companion in [Companion::Controller, Companion::Observer] {
            if let Ok(form) = CompanionForm::new(sys, companion, operator) {
                add(FormKind::Companion(companion, operator), form.program)?;
            }
        }
    }
    candidates.sort_by(|p, q| p.score.total_cmp(&q.score));
    let best = candidates.first().map_or(0.0, |c| c.score);
    let n_alike = candidates.iter().take_while(|c| c.score <= 2.0 * best).count();
    candidates[..n_alike].sort_by_key(|c| c.program.n_operations());
    Ok(candidates)
}
