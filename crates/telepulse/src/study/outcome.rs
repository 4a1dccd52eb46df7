//! Every number of a study, with its unit in its name: the content of `report.json`.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use telepulse_actuator::ParameterSet;
use telepulse_actuator::twin::Fidelity;

use super::config::SensorChoice;
use super::contact::PulseForce;
use super::grey_box::NonlinearModel;
use super::pulse_files::PulseFiles;

/// Everything a study found. The keys are read by others: add, never rename.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Outcome {
    /// Version of this format.
    pub version: u32,
    /// Name and version of the program.
    pub program: String,
    /// Name of the study.
    pub study: String,
    /// Title of the study.
    pub title: String,
    /// SHA-256 of `study.toml` and of every input it names.
    pub inputs: BTreeMap<String, String>,
    /// Seed of the sensor noise.
    pub seed: u64,
    /// The virtual device, and what its supervisor allows; absent in reports of earlier versions.
    #[serde(default)]
    pub device: Option<Device>,
    /// The identified model, voltage as input.
    pub identified: Identified,
    /// The same by magnitudes only, as the paper did.
    pub identified_magnitude_only: Identified,
    /// The model with the square of the voltage as input.
    pub identified_square_root: Identified,
    /// The nonlinear model that the feedforward inverts; absent in reports of earlier versions.
    #[serde(default)]
    pub nonlinear_model: Option<NonlinearModel>,
    /// Synthesis on the printed plant and weights.
    pub synthesis: Synthesis,
    /// Synthesis on the identified plant.
    pub synthesis_identified: Synthesis,
    /// Synthesis of the feedback of our best controller.
    pub synthesis_best: Synthesis,
    /// What the printed systems amount to.
    pub printed: Printed,
    /// Certificates, by controller.
    pub certificates: BTreeMap<String, CertificateSummary>,
    /// Runs in which a voltage left the study's limits.
    pub voltage_violations: usize,
    /// 5 kV step.
    pub step: StepOutcome,
    /// By controller, then condition.
    pub tracking: BTreeMap<String, BTreeMap<String, Tracking>>,
    /// The same with the laser's own noise on top: by controller, then condition.
    pub tracking_laser_noise: BTreeMap<String, BTreeMap<String, Tracking>>,
    /// Each loop on the plant as identified at other biases.
    pub bias_sweep: Vec<BiasPoint>,
    /// By controller, then mode.
    pub pulse: BTreeMap<String, BTreeMap<String, PulseReplay>>,
    /// Other recordings, followed by the best controller: by file stem, then horizon in ms.
    #[serde(default)]
    pub pulse_files: PulseFiles,
    /// The same in force mode, over softer and stiffer contacts: by file stem.
    #[serde(default)]
    pub pulse_force: BTreeMap<String, PulseForce>,
    /// Spectrum of the pulse.
    pub pulse_spectrum: Spectrum,
    /// Transmission.
    pub link: Link,
    /// Where the paper disagrees with itself or with us.
    pub disagreements: Vec<Disagreement>,
    /// What the paper does not give and was assumed.
    pub assumptions: Vec<Assumption>,
}

impl Outcome {
    /// The lowest bias of the stroke at which a controller's loop was found unstable, if there is one.
    #[must_use]
    pub fn unstable_from(&self, controller: &str) -> Option<f64> {
        let unstable = self.bias_sweep.iter().filter(|point| point.controller == controller && !point.stable);
        unstable.map(|point| point.bias).min_by(f64::total_cmp)
    }
}

/// The virtual device of a study.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Device {
    /// `A`, `B` or `C`.
    pub parameter_set: ParameterSet,
    /// Which model of it moved.
    pub fidelity: Fidelity,
    /// What read the plate in displacement runs.
    pub sensor: SensorChoice,
    /// Largest difference of the reduced twin to the field-level model, over a step to full scale.
    pub stated_error_step_mm: Option<f64>,
    /// The same in percent of its stroke.
    pub stated_error_step_percent: Option<f64>,
    /// Largest difference over the paper's (25).
    pub stated_error_reference_mm: Option<f64>,
    /// The same in percent of its stroke.
    pub stated_error_reference_percent: Option<f64>,
    /// Largest difference between a reading of self-sensing and the true mean over its window, in stable runs.
    pub sensing_error_max_mm: Option<f64>,
    /// Largest standard deviation that was stated with such a reading.
    pub sensing_standard_deviation_max_mm: Option<f64>,
    /// Highest voltage that could be commanded.
    pub max_v: f64,
    /// True where it was derived from the failure envelope, false where the study states it.
    pub max_v_derived: bool,
    /// Highest that the failure envelope and the amplifier allow, with their safety factors.
    pub envelope_max_v: f64,
    /// What sets in first above it.
    pub envelope_limited_by: String,
    /// Where that sets in.
    pub envelope_first_failure_v: f64,
    /// True where a limit has not been checked against its source.
    pub envelope_unverified: bool,
    /// Fastest change of the command; absent where nothing limits it.
    pub slew_v_per_s: Option<f64>,
}

/// A third-order model and the bound of its error.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Identified {
    /// Static gain.
    pub dc_gain_mm_per_unit: f64,
    /// Undamped natural frequency.
    pub omega_n_rad_s: f64,
    /// Damping ratio.
    pub zeta: f64,
    /// Time constant of the circuit.
    pub rc_s: f64,
    /// RMS of the relative residual.
    pub residual_rms: f64,
    /// Error points above the bound.
    pub bound_violations: usize,
    /// Error points in all.
    pub bound_points: usize,
    /// Bound of the additive error, descending powers.
    pub bound_numerator: Vec<f64>,
    /// Its denominator.
    pub bound_denominator: Vec<f64>,
    /// Plant, descending powers.
    pub numerator: Vec<f64>,
    /// Its denominator.
    pub denominator: Vec<f64>,
}

/// What a synthesis delivered.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Synthesis {
    /// Norm of the closed loop with the delivered controller.
    pub gamma_achieved: f64,
    /// No controller does better than this.
    pub gamma_lower: f64,
    /// Fastest pole of the controller.
    pub fastest_pole_rad_s: f64,
    /// Peak of `K S`, unit per mm.
    pub peak_ks: f64,
    /// Peak of `S`.
    pub peak_s: f64,
    /// Peak of `T`.
    pub peak_t: f64,
    /// First -3 dB crossing of `T`.
    pub bandwidth_hz: f64,
}

/// The printed systems (16), (17), (21), recomputed.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Printed {
    /// Stacked norm of the printed loop with the weights (19), (20).
    pub gamma: f64,
    /// Norm of (22).
    pub norm_ms: f64,
    /// Norm of (17).
    pub norm_ws: f64,
    /// `1 / norm_ws`, Eq. (24).
    pub small_gain_limit: f64,
    /// `max abs(Ws K S)`.
    pub frequency_wise: f64,
}

/// A certificate in numbers; there are none for a loop that is not even nominally stable.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct CertificateSummary {
    /// Whether the loop is certified: stable inside of the bound at the bias of the sweep and, in displacement mode, stable at
    /// every other bias examined.
    pub holds: bool,
    /// What was examined: where `holds` says something.
    #[serde(default)]
    pub scope: String,
    /// Whether the small-gain test passes at the bias of the sweep, by norms (23) or frequency by frequency.
    pub small_gain_test_passes: bool,
    /// Why not, where it does not.
    pub reason: Option<String>,
    /// Norm of `K S`.
    pub norm_ms: Option<f64>,
    /// Norm of the bound.
    pub norm_ws: Option<f64>,
    /// `norm_ms * norm_ws`.
    pub norm_product: Option<f64>,
    /// `max abs(Ws K S)`.
    pub frequency_wise: Option<f64>,
    /// Upper gain margin, a factor; absent where infinite.
    pub gain_margin: Option<f64>,
    /// Phase margin; absent where infinite.
    pub phase_margin_deg: Option<f64>,
    /// Closed-loop poles as pairs of real and imaginary part, rad/s.
    pub closed_loop_poles_rad_s: Vec<(f64, f64)>,
}

/// A controller on the plant as it is at one bias.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct BiasPoint {
    /// Bias of the drive, fraction of full-scale voltage.
    pub bias: f64,
    /// Name of the controller.
    pub controller: String,
    /// Static gain of the plant there, mm per unit of the controller's command.
    pub dc_gain_mm_per_unit: f64,
    /// Natural frequency of the plant there.
    pub omega_n_rad_s: f64,
    /// Factor by which the loop gain can rise, with the filter (26) in the loop; below 1 where it had to fall; absent where
    /// infinite.
    pub gain_margin: Option<f64>,
    /// Whether the loop is stable there.
    pub stable: bool,
}

/// Figure 9: a step of full scale.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct StepOutcome {
    /// Largest displacement.
    pub peak_mm: f64,
    /// Displacement after half a second.
    pub at_500_ms_mm: f64,
    /// Displacement after ten seconds.
    pub at_10_s_mm: f64,
    /// Linear model (16) at rest.
    pub printed_model_mm: f64,
}

/// Tracking of the multi-sine.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Tracking {
    /// True where the loop lost its stability: then there are no figures.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub unstable: bool,
    /// What told so.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unstable_reason: Option<String>,
    /// Mean of the absolute error of the true displacement.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mean_abs_error_mm: Option<f64>,
    /// Largest absolute error.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_abs_error_mm: Option<f64>,
    /// Mean square of the normalised voltage.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub effort_index: Option<f64>,
    /// Mean supply power, negative currents as zero.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub average_power_w: Option<f64>,
    /// By what right the controller ran.
    #[serde(default)]
    pub provenance: String,
    /// Highest voltage of the whole run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_voltage_v: Option<f64>,
    /// Lowest voltage of the whole run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min_voltage_v: Option<f64>,
}

/// Replay of the pulse.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct PulseReplay {
    /// The recording.
    pub recording: String,
    /// True where the loop lost its stability: then there are no figures.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub unstable: bool,
    /// What told so.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unstable_reason: Option<String>,
    /// By what right the controller ran.
    #[serde(default)]
    pub provenance: String,
    /// How long the doctor's side holds the pulse back; the lag comes on top of it.
    #[serde(default)]
    pub playout_delay_ms: f64,
    /// Delay of the output against the held-back pulse, positive behind.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lag_ms: Option<f64>,
    /// RMS error over the reference's peak-to-peak.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nrmse: Option<f64>,
    /// The same after removing the lag.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nrmse_aligned: Option<f64>,
    /// Highest voltage.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_voltage_v: Option<f64>,
    /// Lowest voltage.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min_voltage_v: Option<f64>,
}

/// Figure 17.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Spectrum {
    /// Heart rate by beats.
    pub heart_rate_bpm: f64,
    /// Number of beats.
    pub beats: usize,
    /// Peaks of the spectrum, strongest harmonics first by frequency.
    pub peaks_hz: Vec<f64>,
}

/// What the link did.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Link {
    /// Samples the patient's side sent.
    pub sent: u64,
    /// Samples the doctor's side delivered.
    pub received: u64,
    /// Samples never delivered.
    pub lost: u64,
    /// Duplicated samples that reached the output (must be none).
    pub duplicated: u64,
    /// Samples delivered out of order (must be none).
    pub out_of_order: u64,
    /// Every bit of every sample the same, by comparison and by hash.
    pub bit_exact: bool,
    /// Number of processes that took part.
    pub processes: usize,
    /// Frames that had to be sent again.
    pub retransmitted_frames: u64,
    /// Frames that arrived more than once and were dropped.
    pub duplicate_frames_dropped: u64,
    /// SHA-256 of the samples as received.
    pub sha256: String,
}

/// Something the paper prints that does not hold.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Disagreement {
    /// What it is about.
    pub item: String,
    /// As printed.
    pub printed: String,
    /// As recomputed.
    pub recomputed: String,
    /// What it means.
    pub note: String,
}

/// Something the paper does not give.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Assumption {
    /// Name of the quantity.
    pub name: String,
    /// Value with unit.
    pub value: String,
    /// Why this value.
    pub why: String,
}
