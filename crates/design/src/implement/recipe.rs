//! Everything a real-time loop needs, in one file.

use std::fmt;

use serde::{Deserialize, Serialize};
use telepulse_lti::{Continuous, SampleTime, StateSpace, TransferFunction};

use super::feedforward::{Feedforward, drive};
use super::flat_feedforward::FlatDrive;
use super::modal_delta::ModalDelta;
use super::pid::PidSettings;
use super::realize::{Discretization, realize_continuous};
use super::static_inverse::StaticInverse;
use crate::identify::{Controlled, InputLinearisation, PlantModel};
use crate::verify::{Certificate, LoopUnderTest, verify};
use crate::{Error, Result};

/// What turns the tracking error into a command.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Law {
    /// A linear controller as modes.
    StateSpace(ModalDelta),
    /// A PID controller by its gains.
    Pid(PidSettings),
}

/// What the reference passes before it is compared with the measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ReferencePath {
    /// Nothing.
    #[default]
    Direct,
    /// The same filter as the measurement, so that the filter's lag cancels in the error. Feedforward then acts alone on a plant that
    /// is as modelled.
    Filtered,
}

/// What the law does while the drive is at a limit.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "snake_case")]
pub enum AntiWindup {
    /// It runs on.
    #[default]
    None,
    /// Its states hold while the error pushes the command further out.
    HoldOutward,
    /// The integrator of a PID controller is driven back by the part of the command that did not reach the drive.
    BackCalculation {
        /// Time constant in s.
        tracking_time_s: f64,
    },
}

/// How much of a change of the reference a PID controller's proportional and derivative part see: its second degree of freedom.
///
/// ```text
///   u = P (b r - y) + I/s (r - y) + D N s/(s + N) (c r - y)
/// ```
///
/// `r` and `y` in the weighted parts count from the first measurement of a run, so that a start at rest gives no bump.
/// The feedback from the measurement, and with it stability, margins and the answer to disturbances, is that of the gains alone.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SetpointWeights {
    /// Weight `b` of the reference in the proportional part, 0 to 1; 1 for a controller without integral gain, which would stay off the
    /// reference at rest.
    pub b: f64,
    /// Weight `c` of the reference in the derivative part, 0 to 1; 0 for the derivative of the measurement alone.
    pub c: f64,
}

/// Range and slew of the drive.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriveLimits {
    /// Lowest voltage in V; 0 or above.
    pub min_v: f64,
    /// Highest voltage in V.
    pub max_v: f64,
    /// Largest slew in V/s; `None` for no limit.
    pub slew_v_per_s: Option<f64>,
}

/// Where the loop works.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OperatingPoint {
    /// Command that is always added, in units.
    pub bias_unit: f64,
    /// Displacement that this command holds, in mm; references are relative to it in a linear feedforward.
    pub displacement_mm: f64,
    /// Voltage of one unit (of its square root, with [`InputLinearisation::SquareRoot`]), in V.
    pub full_scale_v: f64,
}

/// All of a recipe but its law and where that comes from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecipeSettings {
    /// What the loop controls.
    pub controlled: Controlled,
    /// Time between ticks.
    pub sample_time_s: SampleTime,
    /// What stands between command and amplifier.
    pub input_linearisation: InputLinearisation,
    /// Corner of the first-order filter in the measurement in rad/s, Eq. (26): 40 pi; `None` for none.
    pub measurement_filter_rad_s: Option<f64>,
    /// What the reference passes.
    pub reference_path: ReferencePath,
    /// Feedforward from a reference that is known ahead.
    pub feedforward: Option<Feedforward>,
    /// Static curve behind the feedforward: `u = static_inverse(shaped feedforward(r))`.
    pub static_inverse: Option<StaticInverse>,
    /// Range and slew of the drive.
    pub limits: DriveLimits,
    /// What the law does at a limit.
    pub anti_windup: AntiWindup,
    /// Weights of the reference in a PID controller; `None` for one degree of freedom, `b = c = 1`. Only a PID controller has them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub setpoint_weights: Option<SetpointWeights>,
    /// Where the loop works.
    pub operating_point: OperatingPoint,
}

impl RecipeSettings {
    /// The range of the drive in units of full scale, as a flatness-based feedforward needs it.
    #[must_use]
    pub fn flat_drive(&self) -> FlatDrive {
        drive(self)
    }

    /// The feedforward for a whole reference in mm from rest, in units relative to the bias; `None` without feedforward.
    ///
    /// With a static curve the reference is shaped by the filter at unit DC gain and then goes through the curve; without one it goes
    /// through the filter itself, relative to the operating point.
    #[must_use]
    pub fn feedforward_command(&self, reference_mm: &[f64]) -> Option<Vec<f64>> {
        let filter = match self.feedforward.as_ref()? {
            Feedforward::Flat(flat) => {
                let bias_unit = self.operating_point.bias_unit;
                return Some(flat.apply(reference_mm).into_iter().map(|u| u - bias_unit).collect());
            }
            Feedforward::Held(held) => {
                let bias_unit = self.operating_point.bias_unit;
                return Some(held.apply(reference_mm).into_iter().map(|u| u - bias_unit).collect());
            }
            Feedforward::Preview(filter) => filter,
        };
        let OperatingPoint { bias_unit, displacement_mm, .. } = self.operating_point;
        Some(match &self.static_inverse {
            Some(curve) => {
                let shaped = filter.shaped().apply(reference_mm);
                shaped.into_iter().map(|r| curve.command(r) - bias_unit).collect()
            }
            None => {
                let relative: Vec<f64> = reference_mm.iter().map(|r| r - displacement_mm).collect();
                filter.apply(&relative)
            }
        })
    }
}

/// The evidence behind a certified law: with it, anyone can repeat the verification.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CertifiedLoop {
    /// The plant and the bound of its error.
    pub model: PlantModel,
    /// The controller before it was discretised.
    pub controller: StateSpace<Continuous>,
    /// How it was discretised.
    pub discretization: Discretization,
    /// What was shown.
    pub certificate: Certificate,
}

/// Why a law may run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "snake_case")]
pub enum Provenance {
    /// It is robustly stable with the plant and the bound named.
    Certified(Box<CertifiedLoop>),
    /// Nobody has shown that it is; a run and its report say so.
    Uncertified {
        /// Why it is run all the same.
        reason: String,
    },
}

impl fmt::Display for Provenance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Certified(shown) => {
                write!(f, "certified: max |Ws Ms| {:.3} < 1", shown.certificate.frequency_wise.upper)
            }
            Self::Uncertified { reason } => write!(f, "uncertified: {reason}"),
        }
    }
}

/// A controller, ready to run.
///
/// There are two ways to make one: [`certified`](Self::certified), which runs the verification itself, and
/// [`uncertified`](Self::uncertified) with a reason. Reading a file runs the verification again: a law that was changed after it was
/// certified is refused.
///
/// **Accuracy**: the certificate is about the continuous loop. The hold of the drive adds half a sample of delay that is neither in the
/// model nor in its bound: at 2 kHz it costs 1.1 degrees of phase at the printed loop's 75 rad/s, at 200 Hz 11 degrees.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "PlainRecipe", into = "PlainRecipe")]
pub struct ControllerRecipe {
    plain: PlainRecipe,
}

/// [`ControllerRecipe`] before its check.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PlainRecipe {
    version: u32,
    law: Law,
    settings: RecipeSettings,
    provenance: Provenance,
}

impl ControllerRecipe {
    /// The version of the format written here.
    pub const VERSION: u32 = 1;

    /// A recipe whose controller is robustly stable with `model`, shown here and now.
    ///
    /// **Method**: the loop of model, controller and measurement filter is verified; then the controller is discretised.
    ///
    /// # Errors
    /// [`Error::NoUncertainty`] for a model without a bound; [`Error::LinearisationMismatch`] where model and settings mean
    /// different commands; [`Error::NotRobust`] where the loop is stable, but not for all of the bound;
    /// all of [`verify`] and [`realize_continuous`]; [`Error::OutOfRange`] for settings, [`Error::WeightsWithoutPid`] for set-point weights.
    pub fn certified(
        model: &PlantModel,
        controller: &StateSpace<Continuous>,
        discretization: Discretization,
        settings: RecipeSettings,
    ) -> Result<Self> {
        check_settings(&settings)?;
        let model = model.clone().checked()?;
        if model.input_linearisation != settings.input_linearisation {
            return Err(Error::LinearisationMismatch);
        }
        check_against_model(&settings, &model)?;
        let certificate = certify(&model, controller, &settings)?;
        let law =
            Law::StateSpace(realize_continuous(controller, settings.sample_time_s, discretization)?.law);
        check_weights(&law, settings.setpoint_weights)?;
        let controller = controller.clone();
        let evidence = CertifiedLoop { model, controller, discretization, certificate };
        let provenance = Provenance::Certified(Box::new(evidence));
        Ok(Self { plain: PlainRecipe { version: Self::VERSION, law, settings, provenance } })
    }

    /// A recipe without a certificate, for a stated reason.
    ///
    /// # Errors
    /// [`Error::EmptyList`] for an empty reason; [`Error::OutOfRange`] for settings, or for a law of another sample time;
    /// [`Error::WeightsWithoutPid`] for set-point weights of another law than a PID controller.
    pub fn uncertified(reason: &str, law: Law, settings: RecipeSettings) -> Result<Self> {
        check_settings(&settings)?;
        if reason.trim().is_empty() {
            return Err(Error::EmptyList { key: "reason" });
        }
        if let Law::StateSpace(modes) = &law {
            check_sample_time("sample time of the law", modes.sample_time_s, &settings)?;
        }
        check_weights(&law, settings.setpoint_weights)?;
        let provenance = Provenance::Uncertified { reason: reason.to_string() };
        Ok(Self { plain: PlainRecipe { version: Self::VERSION, law, settings, provenance } })
    }

    /// The same loop with another feedforward: the feedback and its evidence stay, and are checked again.
    ///
    /// # Errors
    /// As [`certified`](Self::certified) or [`uncertified`](Self::uncertified).
    pub fn with_feedforward(&self, feedforward: Option<Feedforward>) -> Result<Self> {
        let settings = RecipeSettings { feedforward, ..self.plain.settings.clone() };
        Self::try_from(PlainRecipe { settings, ..self.plain.clone() })
    }

    /// What turns the tracking error into a command.
    #[must_use]
    pub fn law(&self) -> &Law {
        &self.plain.law
    }

    /// Everything else that the loop needs.
    #[must_use]
    pub fn settings(&self) -> &RecipeSettings {
        &self.plain.settings
    }

    /// Why the law may run.
    #[must_use]
    pub fn provenance(&self) -> &Provenance {
        &self.plain.provenance
    }
}

impl From<ControllerRecipe> for PlainRecipe {
    fn from(recipe: ControllerRecipe) -> Self {
        recipe.plain
    }
}

impl TryFrom<PlainRecipe> for ControllerRecipe {
    type Error = Error;

    fn try_from(plain: PlainRecipe) -> Result<Self> {
        let (found, allowed) = (plain.version, Self::VERSION);
        if found != allowed {
            return Err(Error::Version { what: "controller recipe", found, allowed });
        }
        match plain.provenance {
            Provenance::Uncertified { reason } => Self::uncertified(&reason, plain.law, plain.settings),
            Provenance::Certified(evidence) => {
                let CertifiedLoop { model, controller, discretization, certificate } = *evidence;
                let again = Self::certified(&model, &controller, discretization, plain.settings)?;
                let claimed_holds = certificate.holds();
                if !claimed_holds || !same_law(&plain.law, &again.plain.law) {
                    return Err(Error::LawChanged);
                }
                Ok(again)
            }
        }
    }
}

/// A certificate is about a command of a certain size: the settings that give the command its meaning must be the model's.
fn check_against_model(settings: &RecipeSettings, model: &PlantModel) -> Result<()> {
    let found = settings.operating_point.full_scale_v;
    if found != model.full_scale_v {
        return Err(Error::OutOfRange {
            key: "full_scale_v",
            found,
            allowed: "the full scale of the certified model",
        });
    }
    if settings.limits.max_v > model.full_scale_v {
        let found = settings.limits.max_v;
        return Err(Error::OutOfRange {
            key: "max_v",
            found,
            allowed: "up to the full scale of the certified model",
        });
    }
    if settings.controlled != model.controlled {
        return Err(Error::ControlledMismatch);
    }
    match &settings.feedforward {
        Some(found) => found.check_against(model, settings),
        None => Ok(()),
    }
}

/// Verifies the loop that the recipe will close.
fn certify(
    model: &PlantModel,
    controller: &StateSpace<Continuous>,
    settings: &RecipeSettings,
) -> Result<Certificate> {
    let bound = model.uncertainty.as_ref().ok_or(Error::NoUncertainty)?;
    let filter = match settings.measurement_filter_rad_s {
        Some(corner) => Some(TransferFunction::new(&[corner], &[1.0, corner])?),
        None => None,
    };
    let certificate = verify(&LoopUnderTest {
        plant: &model.nominal,
        controller,
        bound,
        measurement_filter: filter.as_ref(),
    })?;
    if !certificate.holds() {
        return Err(Error::NotRobust {
            frequency_wise: certificate.frequency_wise.upper,
            norm_product: certificate.norm_ms.upper * certificate.norm_ws.upper,
        });
    }
    Ok(certificate)
}

/// Largest relative difference between the response of a stored law and that of its controller; a text file keeps 1e-16, another machine's
/// eigenvalues agree to about 1e-12.
const LAW_DIFFERENCE_MAX: f64 = 1e-9;

fn same_law(stored: &Law, expected: &Law) -> bool {
    let (Law::StateSpace(stored), Law::StateSpace(expected)) = (stored, expected) else { return false };
    if stored.sample_time_s != expected.sample_time_s {
        return false;
    }
    let top = 3.1 / expected.sample_time_s;
    (0..200).map(|k| top * 10_f64.powf(-f64::from(k) * 0.04)).all(|omega| {
        let (found, wanted) = (stored.at(omega), expected.at(omega));
        (found - wanted).norm() <= LAW_DIFFERENCE_MAX * wanted.norm()
    })
}

pub(super) fn check_sample_time(key: &'static str, found: f64, settings: &RecipeSettings) -> Result<()> {
    let wanted = settings.sample_time_s.seconds();
    // A sample time may be written as a decimal fraction or as one over a rate.
    if (found - wanted).abs() <= 1e-12 * wanted {
        Ok(())
    } else {
        Err(Error::OutOfRange { key, found, allowed: "the sample time of the recipe" })
    }
}

fn check_weights(law: &Law, weights: Option<SetpointWeights>) -> Result<()> {
    let Some(SetpointWeights { b, c }) = weights else { return Ok(()) };
    let Law::Pid(gains) = law else { return Err(Error::WeightsWithoutPid) };
    for (key, found) in [("setpoint_weights.b", b), ("setpoint_weights.c", c)] {
        if !(0.0..=1.0).contains(&found) {
            return Err(Error::OutOfRange { key, found, allowed: "0 to 1" });
        }
    }
    if gains.i_per_s == 0.0 && b != 1.0 {
        let allowed = "1 for a controller without integral gain, which would stay off the reference";
        return Err(Error::OutOfRange { key: "setpoint_weights.b", found: b, allowed });
    }
    Ok(())
}

fn check_settings(settings: &RecipeSettings) -> Result<()> {
    let (limits, point) = (settings.limits, settings.operating_point);
    let filter = settings.measurement_filter_rad_s.unwrap_or(1.0);
    let slew = limits.slew_v_per_s.unwrap_or(1.0);
    let tracking_time_s = match settings.anti_windup {
        AntiWindup::BackCalculation { tracking_time_s } => tracking_time_s,
        AntiWindup::None | AntiWindup::HoldOutward => 1.0,
    };
    let bias_allowed = (0.0..=1.0).contains(&point.bias_unit);
    for (key, found, ok, allowed) in [
        ("measurement_filter_rad_s", filter, filter > 0.0, "above 0"),
        ("min_v", limits.min_v, limits.min_v >= 0.0, "0 or above"),
        ("max_v", limits.max_v, limits.max_v > limits.min_v, "above min_v"),
        ("slew_v_per_s", slew, slew > 0.0, "above 0"),
        ("tracking_time_s", tracking_time_s, tracking_time_s > 0.0, "above 0"),
        ("bias_unit", point.bias_unit, bias_allowed, "0 to 1"),
        ("displacement_mm", point.displacement_mm, true, "finite"),
        ("full_scale_v", point.full_scale_v, point.full_scale_v > 0.0, "above 0"),
    ] {
        if !ok || !found.is_finite() {
            return Err(Error::OutOfRange { key, found, allowed });
        }
    }
    settings.feedforward.as_ref().map_or(Ok(()), |feedforward| feedforward.check_shape(settings))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::ModelProvenance;
    use crate::implement::{PreviewOptions, preview_feedforward};

    fn settings() -> RecipeSettings {
        RecipeSettings {
            sample_time_s: SampleTime::new(5e-4).expect("positive"),
            controlled: Controlled::Displacement,
            input_linearisation: InputLinearisation::None,
            measurement_filter_rad_s: Some(40.0 * std::f64::consts::PI),
            reference_path: ReferencePath::Filtered,
            feedforward: None,
            static_inverse: None,
            limits: DriveLimits { min_v: 0.0, max_v: 5000.0, slew_v_per_s: None },
            anti_windup: AntiWindup::HoldOutward,
            setpoint_weights: None,
            operating_point: OperatingPoint { bias_unit: 0.5, displacement_mm: 0.45, full_scale_v: 5000.0 },
        }
    }

    /// Eq. (16) and (17).
    fn printed_model() -> PlantModel {
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

    /// Eq. (21), times a gain.
    fn printed_controller(gain: f64) -> StateSpace<Continuous> {
        let numerator = [30.4975, 1232.4466, 81241.5075].map(|c| gain * c);
        TransferFunction::new(&numerator, &[1.0, 17.5212, 5833.5515, 3.6648])
            .expect("proper")
            .to_state_space()
    }

    fn certified() -> ControllerRecipe {
        let mut settings = settings();
        let filter =
            preview_feedforward(&printed_model().nominal, settings.sample_time_s, &PreviewOptions::default());
        settings.feedforward = Some(Feedforward::Preview(filter.expect("designs")));
        ControllerRecipe::certified(
            &printed_model(),
            &printed_controller(1.0),
            Discretization::Tustin,
            settings,
        )
        .expect("robust")
    }

    #[test]
    fn paper_eq21_makes_a_certified_recipe_that_survives_its_file() {
        let recipe = certified();
        let text = serde_json::to_string(&recipe).expect("writes");
        let read: ControllerRecipe = serde_json::from_str(&text).expect("reads");
        assert_eq!(read.law(), recipe.law());
        assert_eq!(read.settings(), recipe.settings());
        assert!(matches!(read.provenance(), Provenance::Certified(_)));
        let unknown = text.replacen("{\"version\"", "{\"gain\":1,\"version\"", 1);
        assert!(serde_json::from_str::<ControllerRecipe>(&unknown).is_err());
    }

    #[test]
    fn edge_a_law_changed_after_its_certificate_is_refused() {
        let text = serde_json::to_string(&certified()).expect("writes");
        let mut value: serde_json::Value = serde_json::from_str(&text).expect("reads");
        let d = &mut value["law"]["state_space"]["d"];
        *d = serde_json::json!(d.as_f64().expect("number") * 1.01);
        let message = serde_json::from_value::<ControllerRecipe>(value).expect_err("changed").to_string();
        assert!(message.contains("is not the one that was certified"), "{message}");
        let newer = text.replacen("\"version\":1", "\"version\":2", 1);
        let message = serde_json::from_str::<ControllerRecipe>(&newer).expect_err("version").to_string();
        assert!(message.contains("controller recipe has version 2"), "{message}");
    }

    #[test]
    fn edge_loops_that_are_not_robust_get_no_certificate() {
        let build = |model: &PlantModel, gain| {
            ControllerRecipe::certified(model, &printed_controller(gain), Discretization::Tustin, settings())
        };
        // The gain margin with the filter is 1.65 (PAPER_NOTES): 1.5 is stable but not for all of (17), 2 is unstable.
        assert!(matches!(build(&printed_model(), 1.5), Err(Error::NotRobust { .. })));
        assert!(matches!(build(&printed_model(), 2.0), Err(Error::UnstableLoop { .. })));
        let bare = PlantModel { uncertainty: None, ..printed_model() };
        assert_eq!(build(&bare, 1.0), Err(Error::NoUncertainty));
        let rooted = PlantModel { input_linearisation: InputLinearisation::SquareRoot, ..printed_model() };
        assert_eq!(build(&rooted, 1.0), Err(Error::LinearisationMismatch));
    }

    #[test]
    fn law_feedforward_rests_on_the_operating_point_or_on_the_curve() {
        let mut settings = certified().settings().clone();
        // At 0.45 mm nothing is added to the bias; 0.1 mm more needs 0.1 mm over the gain of (16).
        let at_rest = settings.feedforward_command(&[0.45; 300]).expect("has a filter");
        assert!(at_rest.iter().all(|u| u.abs() < 1e-12));
        let higher = settings.feedforward_command(&[0.55; 300]).expect("has a filter");
        assert!(higher.iter().all(|u| (u - 0.1 * 1444.0 / 1350.14).abs() < 1e-12));
        let command: Vec<f64> = (0..=20).map(|k| f64::from(k) / 20.0).collect();
        let displacement: Vec<f64> = command.iter().map(|v| 0.9 * v * v).collect();
        settings.static_inverse = Some(StaticInverse::new(&command, &displacement).expect("rises"));
        // 0.9 * 0.6^2 = 0.324 mm is held by 0.6, which is 0.1 above the bias.
        let curved = settings.feedforward_command(&[0.324; 300]).expect("has a filter");
        assert!(curved.iter().all(|u| (u - 0.1).abs() < 1e-12));
        if let Some(Feedforward::Preview(filter)) = &mut settings.feedforward {
            filter.n_preview = filter.taps.len();
        }
        assert!(matches!(check_settings(&settings), Err(Error::OutOfRange { key: "n_preview", .. })));
        settings.feedforward = None;
        assert_eq!(settings.feedforward_command(&[0.4]), None);
    }

    #[test]
    fn edge_uncertified_needs_a_reason_and_settings_in_range() {
        let pid = Law::Pid(PidSettings { p: 1.7, i_per_s: 24.331, d_s: 0.0, n_rad_s: 9630.0667 });
        let recipe =
            ControllerRecipe::uncertified("hand-tuned, as printed", pid.clone(), settings()).expect("valid");
        let text = serde_json::to_string(&recipe).expect("writes");
        assert_eq!(serde_json::from_str::<ControllerRecipe>(&text).expect("reads"), recipe);
        let found = ControllerRecipe::uncertified(" ", pid.clone(), settings());
        assert_eq!(found, Err(Error::EmptyList { key: "reason" }));
        let limits = DriveLimits { min_v: 0.0, max_v: -1.0, slew_v_per_s: None };
        let found = ControllerRecipe::uncertified("test", pid, RecipeSettings { limits, ..settings() });
        assert!(matches!(found, Err(Error::OutOfRange { key: "max_v", .. })));
        let slow = ModalDelta { real: Vec::new(), complex: Vec::new(), d: 1.0, sample_time_s: 1e-3 };
        let found = ControllerRecipe::uncertified("test", Law::StateSpace(slow), settings());
        assert!(matches!(found, Err(Error::OutOfRange { key: "sample time of the law", .. })));
    }

    #[test]
    fn edge_setpoint_weights_are_kept_in_range_and_belong_to_a_pid() {
        let pid = |i_per_s| Law::Pid(PidSettings { p: 1.7, i_per_s, d_s: 0.01, n_rad_s: 9630.0667 });
        let with = |b, c| RecipeSettings { setpoint_weights: Some(SetpointWeights { b, c }), ..settings() };
        let recipe = ControllerRecipe::uncertified("test", pid(24.331), with(0.3, 0.0)).expect("in range");
        let text = serde_json::to_string(&recipe).expect("writes");
        assert!(text.contains(r#""setpoint_weights":{"b":0.3,"c":0.0}"#), "{text}");
        assert_eq!(serde_json::from_str::<ControllerRecipe>(&text).expect("reads"), recipe);
        // A file that was written before there were weights, and one without them, say the same.
        let plain = ControllerRecipe::uncertified("test", pid(24.331), settings()).expect("valid");
        let plain_text = serde_json::to_string(&plain).expect("writes");
        assert!(!plain_text.contains("setpoint_weights"));
        assert_eq!(serde_json::from_str::<ControllerRecipe>(&plain_text).expect("reads"), plain);

        for (b, c, key_at_fault) in [
            (1.01, 0.0, "setpoint_weights.b"),
            (-0.1, 0.0, "setpoint_weights.b"),
            (f64::NAN, 0.0, "setpoint_weights.b"),
            (0.5, 1.5, "setpoint_weights.c"),
            (0.5, f64::INFINITY, "setpoint_weights.c"),
        ] {
            match ControllerRecipe::uncertified("test", pid(24.331), with(b, c)) {
                Err(Error::OutOfRange { key, allowed: "0 to 1", .. }) => assert_eq!(key, key_at_fault),
                other => panic!("{b}, {c}: {other:?}"),
            }
        }
        let off = text.replacen(r#""b":0.3"#, r#""b":3.0"#, 1);
        let message = serde_json::from_str::<ControllerRecipe>(&off).expect_err("out of range").to_string();
        assert!(message.contains("setpoint_weights.b") && message.contains("0 to 1"), "{message}");
        // Without an integrator the proportional part alone holds the output.
        let found = ControllerRecipe::uncertified("test", pid(0.0), with(0.5, 0.0));
        assert!(matches!(found, Err(Error::OutOfRange { key: "setpoint_weights.b", .. })), "{found:?}");
        assert!(ControllerRecipe::uncertified("test", pid(0.0), with(1.0, 0.0)).is_ok());
        let modes = ModalDelta { real: Vec::new(), complex: Vec::new(), d: 1.0, sample_time_s: 5e-4 };
        let found = ControllerRecipe::uncertified("test", Law::StateSpace(modes), with(0.5, 0.0));
        assert_eq!(found, Err(Error::WeightsWithoutPid));
        let found = ControllerRecipe::certified(
            &printed_model(),
            &printed_controller(1.0),
            Discretization::Tustin,
            with(1.0, 1.0),
        );
        assert_eq!(found, Err(Error::WeightsWithoutPid));
    }
}
