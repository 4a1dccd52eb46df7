//! The kinds of feedforward that a recipe can hold.

use serde::{Deserialize, Serialize};

use super::flat_feedforward::{FlatDrive, FlatFeedforward};
use super::held_feedforward::HeldFeedforward;
use super::preview::{PreviewFeedforward, PreviewOptions, preview_feedforward};
use super::recipe::{RecipeSettings, check_sample_time};
use crate::identify::{InputLinearisation, PlantModel};
use crate::{Error, Result};

/// From a reference that is known ahead to a command.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Feedforward {
    /// The inverse of the linear model as a filter.
    Preview(PreviewFeedforward),
    /// The inverse of a nonlinear model of the motion; needs the square root at the amplifier.
    Flat(Box<FlatFeedforward>),
    /// The inverse of the curve of a held plate behind its circuit; needs the square root at the amplifier.
    Held(Box<HeldFeedforward>),
}

impl Feedforward {
    /// How far ahead the reference is read, s.
    #[must_use]
    pub fn horizon_s(&self) -> f64 {
        match self {
            Self::Preview(filter) => filter.horizon_s,
            Self::Flat(flat) => flat.horizon_s(),
            Self::Held(held) => held.horizon_s(),
        }
    }

    /// Whether the filter is a filter of the recipe's sample time.
    pub(super) fn check_shape(&self, settings: &RecipeSettings) -> Result<()> {
        let (taps, n_preview, sample_time_s) = match self {
            Self::Preview(filter) => (&filter.taps, filter.n_preview, filter.sample_time_s),
            Self::Flat(flat) => {
                (&flat.smoother().taps, flat.smoother().n_preview, flat.sample_time_s().seconds())
            }
            Self::Held(held) => {
                (&held.smoother().taps, held.smoother().n_preview, held.sample_time_s().seconds())
            }
        };
        if n_preview >= taps.len() {
            let allowed = "fewer samples than the filter has taps";
            return Err(Error::OutOfRange { key: "n_preview", found: n_preview as f64, allowed });
        }
        check_sample_time("sample time of the feedforward", sample_time_s, settings)
    }

    /// Whether this is what follows from a model and the design stored with it: a file that was changed is refused.
    pub(super) fn check_against(&self, model: &PlantModel, settings: &RecipeSettings) -> Result<()> {
        let same = match self {
            Self::Preview(found) => {
                let PreviewFeedforward { bandwidth_hz, transition_hz, .. } = *found;
                let options = PreviewOptions { bandwidth_hz, transition_hz, ..PreviewOptions::default() };
                let wanted = preview_feedforward(&model.nominal, settings.sample_time_s, &options)?;
                found.n_preview == wanted.n_preview && same_taps(&found.taps, &wanted.taps)
            }
            Self::Flat(found) => {
                if model.input_linearisation != InputLinearisation::SquareRoot {
                    return Err(Error::LinearisationMismatch);
                }
                found.drive() == drive(settings) && is_of(found, model)?
            }
            Self::Held(found) => {
                if model.input_linearisation != InputLinearisation::SquareRoot {
                    return Err(Error::LinearisationMismatch);
                }
                found.drive() == drive(settings) && is_curve_of(found, model)?
            }
        };
        if same { Ok(()) } else { Err(Error::FeedforwardMismatch) }
    }
}

/// The drive of a recipe, as the feedforward counts it.
pub(super) fn drive(settings: &RecipeSettings) -> FlatDrive {
    let (limits, full_scale_v) = (settings.limits, settings.operating_point.full_scale_v);
    FlatDrive {
        min_unit: limits.min_v / full_scale_v,
        max_unit: limits.max_v / full_scale_v,
        slew_unit_per_s: limits.slew_v_per_s.map(|slew| slew / full_scale_v),
    }
}

/// Whether both models speak of one plant: the gain at rest of the nonlinear one at the linear one's bias, creep relaxed, is near the other.
fn is_of(flat: &FlatFeedforward, model: &PlantModel) -> Result<bool> {
    let drive = model.bias_unit;
    let mut x = 0.0;
    for _ in 0..FIXED_POINTS {
        let [pull, by_x, _] = flat.model().pull(x, drive);
        x -= pull / by_x;
    }
    let [_, by_x, by_w] = flat.model().pull(x, drive);
    let ratio = -by_w / by_x / model.nominal.dc_gain()?;
    Ok((1.0 / GAIN_RATIO_MAX..=GAIN_RATIO_MAX).contains(&ratio))
}

/// Whether the mean slope of the curve up to the linear model's bias is near the linear model's gain.
fn is_curve_of(held: &HeldFeedforward, model: &PlantModel) -> Result<bool> {
    let gain = model.nominal.dc_gain()?;
    let ratio = held.curve().command(gain * model.bias_unit) / model.bias_unit;
    Ok((1.0 / GAIN_RATIO_MAX..=GAIN_RATIO_MAX).contains(&ratio))
}

fn same_taps(a: &[f64], b: &[f64]) -> bool {
    let scale = b.iter().fold(0.0, |top: f64, tap| top.max(tap.abs()));
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= TAP_DIFFERENCE_MAX * scale)
}

/// Largest relative difference between a stored tap and the one that its design gives on another machine.
const TAP_DIFFERENCE_MAX: f64 = 1e-9;
/// Newton steps to a rest position; ten digits are plenty.
const FIXED_POINTS: usize = 20;
/// Further apart, the two models are of different devices.
const GAIN_RATIO_MAX: f64 = 2.0;
