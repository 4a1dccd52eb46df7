//! PID controllers: tuned by rule, or by optimisation under limits that are certified afterwards.
//!
//! Every method takes a [`DelayedPlant`] (or a model fitted to one) and gives a
//! [`PidSettings`](crate::implement::PidSettings); [`check_pid_loop`] says what the loop is worth, exactly.

mod convex_step;
mod factors;
mod integral_gain;
#[cfg(test)]
mod integral_gain_tests;
mod loop_check;
mod peaks;
mod plant;
mod stability;
mod starts;

pub use integral_gain::{PidDesign, PidLimit, PidLimits, PidStructure, maximize_integral_gain};
pub use loop_check::{PidLoopCheck, check_pid_loop};
pub use plant::DelayedPlant;
