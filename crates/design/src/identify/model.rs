//! The model of a plant, as identification hands it to synthesis.

use serde::{Deserialize, Serialize};
use telepulse_lti::TransferFunction;

use crate::{Error, Result};

/// What stands between the controller's output and the amplifier.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum InputLinearisation {
    /// Nothing: one unit of command is full-scale voltage.
    #[default]
    None,
    /// The square root: one unit of command is the square of full-scale voltage, since the force of a dielectric elastomer goes
    /// with voltage squared.
    SquareRoot,
}

impl InputLinearisation {
    /// The voltage for a command, both as fractions of full scale; the command is taken as at least 0.
    #[must_use]
    pub fn voltage_fraction(self, command: f64) -> f64 {
        match self {
            Self::None => command.max(0.0),
            Self::SquareRoot => command.max(0.0).sqrt(),
        }
    }

    /// The command for a voltage; inverse of [`voltage_fraction`](Self::voltage_fraction).
    #[must_use]
    pub fn command(self, voltage_fraction: f64) -> f64 {
        match self {
            Self::None => voltage_fraction,
            Self::SquareRoot => voltage_fraction * voltage_fraction,
        }
    }
}

/// What a loop controls.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Controlled {
    /// Displacement of the plate under its weight, mm from rest.
    #[default]
    Displacement,
    /// Relief of the load cell that holds the plate, in mm-equivalents.
    CellRelief,
}

/// Where a model comes from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "snake_case", tag = "kind")]
pub enum ModelProvenance {
    /// Fitted to a sweep.
    Identified {
        /// Name of the record, as its owner calls it.
        record: String,
        /// Points used.
        n_points: usize,
        /// Root mean square of the fit's residual, in mm per unit.
        rms_residual_mm_per_unit: f64,
    },
    /// Taken from elsewhere.
    Given {
        /// Where from.
        source: String,
    },
}

/// A plant from drive command to displacement, about one operating point.
///
/// **Shapes and units**: `nominal` and `uncertainty` in mm per unit of command; the true plant is
/// `nominal + uncertainty * delta` with any stable `|delta(jw)| <= 1`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlantModel {
    /// Version of this format; [`PlantModel::VERSION`].
    pub version: u32,
    /// Nominal plant.
    pub nominal: TransferFunction,
    /// Bound of the additive error, where one is known.
    pub uncertainty: Option<TransferFunction>,
    /// What its output is.
    pub controlled: Controlled,
    /// What one unit of command means.
    pub input_linearisation: InputLinearisation,
    /// Command at the operating point, in units.
    pub bias_unit: f64,
    /// Displacement at the operating point in mm, where it is known.
    pub bias_displacement_mm: Option<f64>,
    /// Voltage of full scale, in V.
    pub full_scale_v: f64,
    /// Where the model comes from.
    pub provenance: ModelProvenance,
}

impl PlantModel {
    /// The version of the format written here.
    pub const VERSION: u32 = 1;

    /// The same model, once its version and ranges have been found good.
    ///
    /// # Errors
    /// [`Error::Version`], [`Error::NegativeGain`], [`Error::ZeroBound`] or [`Error::OutOfRange`].
    pub fn checked(self) -> Result<Self> {
        if self.version != Self::VERSION {
            return Err(Error::Version { what: "plant model", found: self.version, allowed: Self::VERSION });
        }
        // Only a stable plant has a gain at rest.
        if self.nominal.is_stable()? {
            let dc_gain = self.nominal.dc_gain()?;
            if dc_gain.is_nan() || dc_gain <= 0.0 {
                return Err(Error::NegativeGain { dc_gain });
            }
        }
        if self.uncertainty.as_ref().is_some_and(|bound| bound.numerator().iter().all(|c| *c == 0.0)) {
            return Err(Error::ZeroBound);
        }
        let displacement = self.bias_displacement_mm.unwrap_or(0.0);
        for (key, found, ok, allowed) in [
            ("bias_unit", self.bias_unit, (0.0..=1.0).contains(&self.bias_unit), "0 to 1"),
            ("full_scale_v", self.full_scale_v, self.full_scale_v > 0.0, "above 0"),
            ("bias_displacement_mm", displacement, true, "finite"),
        ] {
            if !ok || !found.is_finite() {
                return Err(Error::OutOfRange { key, found, allowed });
            }
        }
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn printed() -> PlantModel {
        PlantModel {
            version: PlantModel::VERSION,
            nominal: TransferFunction::new(&[1350.14], &[0.0045, 1.07182, 22.458, 1444.0]).expect("proper"),
            uncertainty: Some(TransferFunction::new(&[487.5], &[1.0, 45.0, 2500.0]).expect("proper")),
            controlled: Controlled::Displacement,
            input_linearisation: InputLinearisation::None,
            bias_unit: 0.5,
            bias_displacement_mm: None,
            full_scale_v: 5000.0,
            provenance: ModelProvenance::Given { source: "Eq. (16) and (17)".into() },
        }
    }

    #[test]
    fn law_model_survives_its_file_and_refuses_unknown_keys() {
        let text = serde_json::to_string(&printed()).expect("writes");
        assert_eq!(serde_json::from_str::<PlantModel>(&text).expect("reads"), printed());
        let unknown = text.replacen("{", "{\"gain\":1,", 1);
        let message = serde_json::from_str::<PlantModel>(&unknown).expect_err("unknown key").to_string();
        assert!(message.contains("unknown field `gain`"), "{message}");
    }

    #[test]
    fn edge_versions_and_ranges_are_checked() {
        assert!(printed().checked().is_ok());
        let newer = PlantModel { version: 2, ..printed() };
        assert!(matches!(newer.checked(), Err(Error::Version { found: 2, .. })));
        let wrong = PlantModel { bias_unit: 1.5, ..printed() };
        assert!(matches!(wrong.checked(), Err(Error::OutOfRange { key: "bias_unit", .. })));
    }

    #[test]
    fn law_linearization_and_its_inverse() {
        for kind in [InputLinearisation::None, InputLinearisation::SquareRoot] {
            for v in [0.0, 0.3, 1.0] {
                assert!((kind.voltage_fraction(kind.command(v)) - v).abs() < 1e-15);
            }
        }
        assert_eq!(InputLinearisation::SquareRoot.voltage_fraction(-1.0), 0.0);
    }
}
