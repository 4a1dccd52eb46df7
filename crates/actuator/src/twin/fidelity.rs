//! How much of the membrane a simulation carries.

use serde::{Deserialize, Serialize};

/// Which model of the actuator moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Fidelity {
    /// [`crate::twin::Twin`]: maps and a few states, thousands of times faster than real time. The default.
    #[default]
    Reduced,
    /// [`crate::field::FieldTwin`]: dashpots at every node, one membrane solve for each stage.
    Field,
}

impl Fidelity {
    /// Step that suits the model where the drive does not ask for a shorter one, s.
    #[must_use]
    pub fn usual_step_s(self) -> f64 {
        match self {
            Self::Reduced => 1e-3,
            Self::Field => 4e-3,
        }
    }
}
