//! What every answer of `telepulse solve` says, and how the errors of the libraries become a status.

use std::time::Instant;

use nalgebra::DMatrix;
use num_complex::Complex64;
use serde::Serialize;
use telepulse_design::Error as DesignError;
use telepulse_lti::Error as SystemError;
use telepulse_lti::{StateSpace, TimeDomain};

/// How a problem ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Status {
    /// Solved; the evidence is in the answer.
    Ok,
    /// No controller reaches the norm allowed.
    Infeasible,
    /// A condition of the theory fails and could not be, or was not to be, regularised away.
    Singular,
    /// An unstable mode is out of reach of the control input.
    NotStabilizable,
    /// An unstable mode does not show in the measured output.
    NotDetectable,
    /// A system that must be stable is not.
    Unstable,
    /// An iteration ended without its tolerance.
    NotConverged,
    /// Rounding spoils every answer.
    IllConditioned,
}

/// Time since the start of a solution, in seconds.
pub(super) struct Watch(Instant);

impl Watch {
    pub(super) fn start() -> Self {
        Self(Instant::now())
    }

    pub(super) fn seconds(&self) -> f64 {
        self.0.elapsed().as_secs_f64()
    }
}

/// The status of an error that is an answer; `None` for one that says that the question was wrong.
pub(super) fn design_status(error: &DesignError) -> Option<Status> {
    Some(match error {
        DesignError::System(error) => return system_status(error),
        DesignError::SingularD12 { .. } | DesignError::SingularD21 { .. } | DesignError::AxisZero { .. } => {
            Status::Singular
        }
        DesignError::NotStabilizable { .. } => Status::NotStabilizable,
        DesignError::NotDetectable { .. } => Status::NotDetectable,
        DesignError::Infeasible { .. }
        | DesignError::ControllerTooFast { .. }
        | DesignError::ControllerGainTooHigh { .. } => Status::Infeasible,
        DesignError::NotConverged { .. } | DesignError::MuNotProven { .. } => Status::NotConverged,
        DesignError::PidNotStabilized { .. } => Status::NotStabilizable,
        DesignError::PidLimitsNotMet { .. }
        | DesignError::PidLimitImpossible { .. }
        | DesignError::PidGainUnbounded { .. }
        | DesignError::PidPlantZeroAtOrigin
        | DesignError::PidHalfRule { .. }
        | DesignError::PidPhaseOutOfReach { .. }
        | DesignError::PidMarginNotMet { .. }
        | DesignError::PidNoCrossover { .. }
        | DesignError::PidLoopNeutral { .. }
        | DesignError::PidLoopUnstable { .. } => Status::Infeasible,
        DesignError::PidStabilityUncertain { .. } => Status::IllConditioned,
        DesignError::IllConditioned { .. } => Status::IllConditioned,
        DesignError::UnstableLoop { .. } | DesignError::UnstableElement { .. } => Status::Unstable,
        _ => return None,
    })
}

/// As [`design_status`], for the errors of `telepulse-lti`.
pub(super) fn system_status(error: &SystemError) -> Option<Status> {
    Some(match error {
        SystemError::Unstable { .. } => Status::Unstable,
        SystemError::HamiltonianAxis { .. } | SystemError::SymplecticCircle { .. } => Status::Infeasible,
        SystemError::NotStabilizable { .. } => Status::NotStabilizable,
        SystemError::LyapunovSingular { .. }
        | SystemError::SylvesterSingular { .. }
        | SystemError::HankelGap { .. }
        | SystemError::Singular { .. }
        | SystemError::AlgebraicLoop { .. }
        | SystemError::RankDeficientSystem => Status::Singular,
        SystemError::EigenvaluesNotConverged { .. }
        | SystemError::RiccatiNotConverged { .. }
        | SystemError::PeakNotBounded { .. } => Status::NotConverged,
        SystemError::NoStabilizingSolution { .. }
        | SystemError::RiccatiIllConditioned { .. }
        | SystemError::ReducedUnstable { .. }
        | SystemError::SwapFailed { .. }
        | SystemError::BilinearPole { .. }
        | SystemError::Overflow { .. } => Status::IllConditioned,
        _ => return None,
    })
}

/// A matrix by rows.
#[derive(Serialize)]
pub(super) struct Rows(Vec<Vec<f64>>);

impl From<&DMatrix<f64>> for Rows {
    fn from(m: &DMatrix<f64>) -> Self {
        Self(m.row_iter().map(|row| row.iter().copied().collect()).collect())
    }
}

/// A system by its matrices; `dt` only where it is discrete, in seconds.
#[derive(Serialize)]
#[allow(non_snake_case)]
pub(super) struct SystemAnswer {
    A: Rows,
    B: Rows,
    C: Rows,
    D: Rows,
    #[serde(skip_serializing_if = "Option::is_none")]
    dt: Option<f64>,
}

impl<T: TimeDomain> From<&StateSpace<T>> for SystemAnswer {
    fn from(sys: &StateSpace<T>) -> Self {
        Self {
            A: sys.a().into(),
            B: sys.b().into(),
            C: sys.c().into(),
            D: sys.d().into(),
            dt: sys.domain().sample_time_of().map(telepulse_lti::SampleTime::seconds),
        }
    }
}

/// Complex numbers as pairs of real and imaginary part.
pub(super) fn pairs(values: &[Complex64]) -> Vec<[f64; 2]> {
    values.iter().map(|value| [value.re, value.im]).collect()
}

impl Rows {
    /// One line for each row.
    pub(super) fn lines(&self) -> Vec<String> {
        let line = |row: &Vec<f64>| row.iter().map(|value| format!("{value:>24.16e}")).collect::<String>();
        self.0.iter().map(line).collect()
    }
}
