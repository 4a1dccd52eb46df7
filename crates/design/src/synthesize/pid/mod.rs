//! PID controllers: tuned by rule, or by optimisation under limits that are certified afterwards.
//!
//! Every method takes a [`DelayedPlant`] (or a model fitted to one) and gives a
//! [`PidSettings`](crate::implement::PidSettings); [`check_pid_loop`] says what the loop is worth, exactly.

mod convex_step;
mod factors;
mod half_rule;
mod integral_gain;
#[cfg(test)]
mod integral_gain_tests;
mod lag_model;
mod loop_check;
mod loop_samples;
mod peaks;
mod phase_margin;
mod plant;
mod rules;
mod stability;
mod standard_form;
mod starts;

pub use half_rule::RuleModel;
pub use integral_gain::{PidDesign, PidLimit, PidLimits, PidStructure, maximize_integral_gain};
pub use lag_model::{CriticalPoint, LagModel};
pub use loop_check::{PidLoopCheck, check_pid_loop};
pub use phase_margin::{DesignFocus, MarginDesign, MarginTarget, MarginTerms, tune_phase_margin};
pub use plant::DelayedPlant;
pub use rules::{
    RuleTerms, SimcDesign, SimcOptions, amigo, lambda_tuning, simc, tune_simc, tyreus_luyben, ziegler_nichols,
};
pub use standard_form::{SeriesPid, StandardPid, WithFilter};
