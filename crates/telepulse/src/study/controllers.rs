//! From a model to recipes: synthesis, certificate, realisation.

use anyhow::{Context, Result};
use telepulse_design::identify::PlantModel;
use telepulse_design::synthesize::{
    HinfOptions, MixedSensitivityWeights, SingularProblem, hinfsyn, mixed_sensitivity,
};
use telepulse_design::verify::{Certificate, LoopUnderTest, verify};
use telepulse_lti::{Continuous, StateSpace, TransferFunction};

use super::config::Study;
use super::outcome::{BiasPoint, CertificateSummary, Synthesis};

/// No controller pole is faster than this: well inside what the sample rate can follow.
const FASTEST_POLE_RAD_S: f64 = 5e4;

/// A synthesised controller.
#[derive(Debug, Clone)]
pub struct Design {
    /// From tracking error in mm to command.
    pub controller: StateSpace<Continuous>,
    /// What was reached.
    pub summary: Synthesis,
}

/// S/KS synthesis with the study's weights.
///
/// # Errors
/// Where the weights are refused or no controller exists.
pub fn synthesize(study: &Study, plant: &TransferFunction) -> Result<Design> {
    let error_weight = study.weights.error.to_transfer_function("weights.error")?;
    let control_weight = study.weights.control.to_transfer_function("weights.control")?;
    let weights = MixedSensitivityWeights { we: &error_weight, wu: &control_weight, wt: None };
    let generalized =
        mixed_sensitivity(plant, &weights).context("the mixed-sensitivity problem cannot be posed")?;
    let options = HinfOptions {
        max_controller_pole_rad_s: Some(FASTEST_POLE_RAD_S),
        // Weights that leave the command free are to be mended by whoever wrote them, not by a small addition.
        singular: SingularProblem::Refuse,
        ..HinfOptions::default()
    };
    let design = hinfsyn(&generalized, &options).context("no H-infinity controller")?;
    // The peaks of the loop as designed; the bound plays no part in them.
    let zero = TransferFunction::from_gain(0.0)?;
    let certificate = verify(&LoopUnderTest {
        plant,
        controller: &design.controller,
        bound: &zero,
        measurement_filter: None,
    })?;
    let summary = Synthesis {
        gamma_achieved: design.achieved.value,
        gamma_lower: design.gamma_lower,
        fastest_pole_rad_s: design.fastest_controller_pole_rad_s()?,
        peak_ks: certificate.peak_ks.value,
        peak_s: certificate.peak_s.value,
        peak_t: certificate.peak_t.value,
        bandwidth_hz: certificate
            .bandwidth_hz
            .context("the loop has no bandwidth: T never falls through -3 dB")?,
    };
    Ok(Design { controller: design.controller, summary })
}

/// A certificate, or why there is none.
#[derive(Debug, Clone)]
pub enum Certified {
    /// The verifier's certificate; whether it holds is in it.
    Judged(Box<Certificate>),
    /// A certificate at the bias of the sweep, for a loop that is unstable at another bias of the stroke.
    Fragile {
        /// The verifier's certificate.
        certificate: Box<Certificate>,
        /// The lowest bias at which the loop was found unstable.
        unstable_from: f64,
    },
    /// The loop is not even nominally stable, or cannot be judged.
    Refused(String),
}

impl Certified {
    /// Why a controller must run as uncertified, if it must.
    #[must_use]
    pub fn objection(&self) -> Option<String> {
        match self {
            Self::Judged(certificate) if certificate.holds() => None,
            Self::Judged(certificate) => Some(format!(
                "small-gain test not met: norm product {:.3}, max |Ws K S| {:.3}",
                certificate.norm_ms.value * certificate.norm_ws.value,
                certificate.frequency_wise.value
            )),
            Self::Fragile { certificate, unstable_from } => Some(format!(
                "unstable from bias {unstable_from} on; at the bias of the sweep max |Ws K S| is {:.3}",
                certificate.frequency_wise.value
            )),
            Self::Refused(reason) => Some(reason.clone()),
        }
    }

    /// The same, in the light of what the loop does at other biases.
    #[must_use]
    pub fn over_the_stroke(self, points: &[BiasPoint]) -> Self {
        let unstable_from =
            points.iter().filter(|point| !point.stable).map(|point| point.bias).min_by(f64::total_cmp);
        match (self, unstable_from) {
            (Self::Judged(certificate), Some(unstable_from)) => Self::Fragile { certificate, unstable_from },
            (judged, _) => judged,
        }
    }

    /// The certificate in numbers.
    #[must_use]
    pub fn summary(&self) -> CertificateSummary {
        match self {
            Self::Judged(c) | Self::Fragile { certificate: c, .. } => CertificateSummary {
                holds: self.objection().is_none(),
                scope: "the bias and the amplitudes of the sweep".into(),
                small_gain_test_passes: c.holds(),
                reason: self.objection(),
                norm_ms: Some(c.norm_ms.value),
                norm_ws: Some(c.norm_ws.value),
                norm_product: Some(c.norm_ms.value * c.norm_ws.value),
                frequency_wise: Some(c.frequency_wise.value),
                gain_margin: c.gain_margin.as_ref().map(|margin| margin.factor),
                phase_margin_deg: c.phase_margin.as_ref().map(|margin| margin.degrees),
                closed_loop_poles_rad_s: c.closed_loop_poles.iter().map(|p| (p.re, p.im)).collect(),
            },
            Self::Refused(reason) => {
                CertificateSummary { reason: Some(reason.clone()), ..CertificateSummary::default() }
            }
        }
    }
}

/// Judges a controller against a model, with the study's filter (26) in the measurement.
///
/// # Errors
/// Where the model holds no bound.
pub fn certify(study: &Study, model: &PlantModel, controller: &StateSpace<Continuous>) -> Result<Certified> {
    let filter = measurement_filter(study)?;
    let bound = model
        .uncertainty
        .as_ref()
        .context("the model holds no `uncertainty`: nothing can be certified with it")?;
    let judged = verify(&LoopUnderTest {
        plant: &model.nominal,
        controller,
        bound,
        measurement_filter: Some(&filter),
    });
    Ok(match judged {
        Ok(certificate) => Certified::Judged(Box::new(certificate)),
        Err(error) => Certified::Refused(error.to_string()),
    })
}

/// Eq. (26).
///
/// # Errors
/// Never with a checked study.
pub fn measurement_filter(study: &Study) -> Result<TransferFunction> {
    let corner = std::f64::consts::TAU * study.control.filter_hz;
    Ok(TransferFunction::new(&[corner], &[1.0, corner])?)
}
