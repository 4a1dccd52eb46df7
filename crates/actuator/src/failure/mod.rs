//! Where a membrane ends: what ends it, how far a state or a run is from it, and the limits a supervisor should keep.
//!
//! [`Envelope`] judges static states and finds the voltages that end them; [`Envelope::over_run`] judges a record of
//! displacement and voltage; [`Envelope::map`] does so over load and voltage; [`Envelope::supervisor_limits`] derives limits.

mod branch_history;
mod breakdown;
mod criteria;
mod envelope;
mod map;
mod run;
mod supervisor;

pub use breakdown::{BreakdownLaw, Site, Source, Standing};
pub use criteria::{AmplifierLimits, FailureCriteria, Margin, Mechanism};
pub use envelope::{Envelope, StateMargins, VoltageLimit, VoltageLimits};
pub use map::{FailureMap, MapCurve};
pub use run::{RunEnd, RunMargin, RunMargins, RunSample};
pub use supervisor::{SafetyFactors, SupervisorLimits};
