//! Which numbers of an actuator are fitted, and between which bounds.

use super::Refusal;
use crate::{ActuatorSpec, Error};

/// A number of [`ActuatorSpec`] that a calibration may fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// `mu_pa`, Pa.
    ShearModulus,
    /// `gent_limit`.
    ChainLimit,
    /// `branches[i].modulus_pa`, Pa.
    BranchModulus(usize),
    /// `branches[i].relaxation_time_s`, s.
    BranchTime(usize),
    /// `relative_permittivity`.
    Permittivity,
    /// `damping_n_s_per_m`, N s/m.
    Damping,
}

impl Quantity {
    /// All quantities that `spec` has.
    #[must_use]
    pub fn all(spec: &ActuatorSpec) -> Vec<Self> {
        let mut all = vec![Self::ShearModulus];
        all.extend(spec.gent_limit.map(|_| Self::ChainLimit));
        for idx in 0..spec.branches.len() {
            all.extend([Self::BranchModulus(idx), Self::BranchTime(idx)]);
        }
        all.extend([Self::Permittivity, Self::Damping]);
        all
    }

    /// The quantity of `spec` with this key, as [`Quantity::key`] writes it; `J` is the chain limit too.
    #[must_use]
    pub fn from_key(key: &str, spec: &ActuatorSpec) -> Option<Self> {
        let key = if key == "J" { "gent_limit" } else { key };
        Self::all(spec).into_iter().find(|quantity| quantity.key() == key)
    }

    /// Name as in files; branches count from 0.
    #[must_use]
    pub fn key(self) -> String {
        match self {
            Self::ShearModulus => "mu_pa".to_owned(),
            Self::ChainLimit => "gent_limit".to_owned(),
            Self::BranchModulus(idx) => format!("branches[{idx}].modulus_pa"),
            Self::BranchTime(idx) => format!("branches[{idx}].relaxation_time_s"),
            Self::Permittivity => "relative_permittivity".to_owned(),
            Self::Damping => "damping_n_s_per_m".to_owned(),
        }
    }

    /// Its value in `spec`, if that has it.
    #[must_use]
    pub fn value(self, spec: &ActuatorSpec) -> Option<f64> {
        match self {
            Self::ShearModulus => Some(spec.mu_pa),
            Self::ChainLimit => spec.gent_limit,
            Self::BranchModulus(idx) => spec.branches.get(idx).map(|branch| branch.modulus_pa),
            Self::BranchTime(idx) => spec.branches.get(idx).map(|branch| branch.relaxation_time_s),
            Self::Permittivity => Some(spec.relative_permittivity),
            Self::Damping => Some(spec.damping_n_s_per_m),
        }
    }

    /// Puts a value into `spec`; nothing happens where that has no such number.
    pub(super) fn set(self, spec: &mut ActuatorSpec, value: f64) {
        match self {
            Self::ShearModulus => spec.mu_pa = value,
            Self::ChainLimit => spec.gent_limit = spec.gent_limit.map(|_| value),
            Self::BranchModulus(idx) => {
                if let Some(branch) = spec.branches.get_mut(idx) {
                    branch.modulus_pa = value;
                }
            }
            Self::BranchTime(idx) => {
                if let Some(branch) = spec.branches.get_mut(idx) {
                    branch.relaxation_time_s = value;
                }
            }
            Self::Permittivity => spec.relative_permittivity = value,
            Self::Damping => spec.damping_n_s_per_m = value,
        }
    }
}

/// A quantity to be fitted with the bounds it must keep, in its own unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FreeParameter {
    /// What is fitted.
    pub quantity: Quantity,
    /// Lower bound, positive: the fit works with logarithms.
    pub lower: f64,
    /// Upper bound.
    pub upper: f64,
}

/// Default bounds: start over this, and start times this.
const DEFAULT_SPAN: f64 = 100.0;

impl FreeParameter {
    /// The quantity within a factor of 100 about its value in `spec`.
    ///
    /// # Errors
    /// [`Refusal::Free`] where that value is not positive: a logarithm starts nowhere.
    pub fn about(quantity: Quantity, spec: &ActuatorSpec) -> Result<Self, Error> {
        let start = quantity.value(spec).unwrap_or(f64::NAN);
        let free = Self { quantity, lower: start / DEFAULT_SPAN, upper: start * DEFAULT_SPAN };
        free.check(spec)?;
        Ok(free)
    }

    /// Checks the start in `spec` against the bounds.
    pub(super) fn check(&self, spec: &ActuatorSpec) -> Result<(), Error> {
        let refuse = |found: f64, reason| {
            Err(Error::Calibration(Refusal::Free { key: self.quantity.key(), found, reason }))
        };
        let start = self.quantity.value(spec).unwrap_or(f64::NAN);
        if !(start.is_finite() && start > 0.0) {
            return refuse(start, "the start must be finite and positive, since relative changes are fitted");
        }
        if !(self.lower.is_finite() && self.lower > 0.0) {
            return refuse(self.lower, "the lower bound must be finite and positive");
        }
        if !(self.upper.is_finite() && self.upper > self.lower) {
            return refuse(self.upper, "the upper bound must be finite and above the lower one");
        }
        if !(self.lower..=self.upper).contains(&start) {
            return refuse(start, "the start must lie within its bounds");
        }
        Ok(())
    }
}
