//! Which diaphragm to build: stroke and bandwidth of variants that keep their distance from failure, and their Pareto front.

mod pareto;
mod performance;
mod space;

pub use pareto::{pareto_front, refined};
pub use performance::{EndOfStroke, Performance, StudyLimits, evaluate, source_resistance_ohm};
pub use space::{DesignVariable, Variant};
