//! Variants of an actuator: its geometry, pre-stretch and load.

use crate::{ActuatorParameters, ActuatorSpec, Error};

/// A number of the design that a study varies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum DesignVariable {
    /// `inner_radius_m`: plate.
    InnerRadius,
    /// `outer_radius_m`: frame.
    OuterRadius,
    /// `thickness_m`: undeformed.
    Thickness,
    /// `prestretch`.
    Prestretch,
    /// `mass_kg`: plate and load.
    Mass,
}

impl DesignVariable {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::InnerRadius, Self::OuterRadius, Self::Thickness, Self::Prestretch, Self::Mass];

    /// Name as in files.
    #[must_use]
    pub fn key(self) -> &'static str {
        match self {
            Self::InnerRadius => "inner_radius_m",
            Self::OuterRadius => "outer_radius_m",
            Self::Thickness => "thickness_m",
            Self::Prestretch => "prestretch",
            Self::Mass => "mass_kg",
        }
    }

    /// The variable with this key.
    #[must_use]
    pub fn from_key(key: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|variable| variable.key() == key)
    }

    fn set(self, spec: &mut ActuatorSpec, value: f64) {
        match self {
            Self::InnerRadius => spec.inner_radius_m = value,
            Self::OuterRadius => spec.outer_radius_m = value,
            Self::Thickness => spec.thickness_m = value,
            Self::Prestretch => spec.prestretch = value,
            Self::Mass => spec.mass_kg = value,
        }
    }
}

/// Values of the variables of a study, in their order.
pub type Variant = Vec<f64>;

/// The actuator that `base` becomes with these values.
pub(super) fn varied(
    base: &ActuatorParameters,
    variables: &[DesignVariable],
    variant: &[f64],
) -> Result<ActuatorParameters, Error> {
    let mut spec = base.spec().clone();
    for (variable, value) in variables.iter().zip(variant) {
        variable.set(&mut spec, *value);
    }
    ActuatorParameters::new(spec)
}
