//! What stands around the membrane: amplifier, circuit, contact, further branches.

use super::contact::ContactForce;
use super::{Amplifier, Circuit, PlateContact, require};
use crate::statics::{Electrodes, Load, StaticSolver};
use crate::{ActuatorParameters, Error, MaxwellBranch};

/// Surroundings of the membrane in a field-level simulation.
#[derive(Debug, Clone, PartialEq)]
pub struct FieldSetup {
    /// The amplifier.
    pub amplifier: Amplifier,
    /// How its output reaches the electrodes.
    pub circuit: Circuit,
    /// What the plate touches, if anything.
    pub contact: Option<PlateContact>,
    /// Maxwell branches beside those of the parameters, any number: see
    /// [`FractionalBranch::maxwell_branches`](crate::frequency::FractionalBranch::maxwell_branches).
    pub extra_branches: Vec<MaxwellBranch>,
    /// Error at which the equations of a step count as solved, in units of the undeformed outer radius, of full scale and of
    /// logarithmic strain.
    pub tolerance: f64,
}

/// 3e-8 mm for the built-in sets.
const DEFAULT_TOLERANCE: f64 = 1e-9;

impl FieldSetup {
    /// Ideal amplifier up to full scale, constant time constant, no contact.
    #[must_use]
    pub fn plain(parameters: &ActuatorParameters) -> Self {
        Self {
            amplifier: Amplifier::ideal(parameters.spec().full_scale_v),
            circuit: Circuit::ConstantRc,
            contact: None,
            extra_branches: Vec::new(),
            tolerance: DEFAULT_TOLERANCE,
        }
    }

    /// As [`FieldSetup::plain`], with the capacitance of the membrane as it deforms: the series resistance is the parameters' time
    /// constant over the capacitance at rest under the weight, and nothing leaks across the membrane.
    ///
    /// # Errors
    /// Those of [`StaticSolver::solve`].
    pub fn deformable(parameters: &ActuatorParameters) -> Result<Self, Error> {
        let mut solver = StaticSolver::new(&parameters.sheet()?)?;
        let rest = solver.solve(Load::ForceN(parameters.weight_n()), Electrodes::VoltageV(0.0))?;
        let circuit = Circuit::Deformable {
            series_resistance_ohm: parameters.spec().rc_s / rest.capacitance_f,
            leak_resistance_ohm: f64::INFINITY,
        };
        Ok(Self { circuit, ..Self::plain(parameters) })
    }

    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Parameter`] names the first key out of range.
    pub fn check(&self) -> Result<(), Error> {
        self.amplifier.check()?;
        self.circuit.check()?;
        if let Some(contact) = &self.contact {
            contact.check()?;
        }
        for branch in &self.extra_branches {
            let (modulus, time) = (branch.modulus_pa, branch.relaxation_time_s);
            require(modulus.is_finite() && modulus > 0.0, "modulus_pa", "finite and positive", modulus)?;
            require(time.is_finite() && time > 0.0, "relaxation_time_s", "finite and positive", time)?;
        }
        let usable = (1e-12..=1e-3).contains(&self.tolerance);
        require(usable, "tolerance", "between 1e-12 and 1e-3", self.tolerance)
    }

    /// Force of the contact on the plate at `x_m` from rest.
    pub(super) fn contact_force(&self, x_m: f64, v_m_per_s: f64) -> ContactForce {
        self.contact.map_or(ContactForce::default(), |contact| contact.force(x_m, v_m_per_s))
    }
}

impl Circuit {
    /// Voltage across the membrane after a long time at an amplifier voltage.
    pub(super) fn settled_v(&self, amplifier_v: f64, limit_a: f64) -> f64 {
        match *self {
            Self::ConstantRc => amplifier_v,
            Self::Deformable { series_resistance_ohm: series, leak_resistance_ohm: leak } => {
                let current = (amplifier_v / (series + leak)).min(limit_a);
                // An infinite leak resistance carries no current.
                if leak.is_finite() { current * leak } else { amplifier_v }
            }
        }
    }
}
