//! The certificate of a loop and how it is obtained.

use num_complex::Complex64;
use serde::{Deserialize, Serialize};
use telepulse_lti::margins::{GainMargin, PhaseMargin};
use telepulse_lti::{Continuous, LoopMargins, PeakGain, StateSpace, TransferFunction, hinf_norm};

use super::loop_transfers::LoopTransfers;
use crate::Error;

/// A tracking loop `u = K (r - F y)`, `y = (G + Delta_a) u` with `|Delta_a(j omega)| <= |W_s(j omega)|`.
#[derive(Clone, Copy, Debug)]
pub struct LoopUnderTest<'a> {
    /// `G`, the nominal plant, mm per unit.
    pub plant: &'a TransferFunction,
    /// `K`, from tracking error to command, unit per mm; one input, one output.
    pub controller: &'a StateSpace<Continuous>,
    /// `W_s`, the bound of the additive uncertainty, mm per unit; stable.
    pub bound: &'a TransferFunction,
    /// `F`, the filter between sensor and controller, e.g. Eq. (26); `None` for a direct measurement.
    pub measurement_filter: Option<&'a TransferFunction>,
}

/// What is known about a stable loop and the plants around its nominal one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Certificate {
    /// Norm of `M_s = K F S`, unit per mm. Eq. (22).
    pub norm_ms: PeakGain,
    /// Norm of `W_s`, mm per unit. Eq. (17).
    pub norm_ws: PeakGain,
    /// `1 / norm_ws`, which `norm_ms` has to stay below, unit per mm. Eq. (24).
    pub small_gain_limit: f64,
    /// Whether `norm(M_s) norm(W_s) < 1`, both at the upper ends of their brackets. Eq. (23).
    pub norm_test_passes: bool,
    /// Peak of `|W_s M_s|`: the same test frequency by frequency, which is sharper.
    pub frequency_wise: PeakGain,
    /// Whether `frequency_wise` is below one, at the upper end of its bracket.
    pub frequency_wise_passes: bool,
    /// All poles of the nominal closed loop, rad/s; cancelled modes are listed as well.
    pub closed_loop_poles: Vec<Complex64>,
    /// Whether all of them are in the open left half plane.
    pub stable: bool,
    /// Smallest factor above one that makes the loop unstable; `None` where none does.
    pub gain_margin: Option<GainMargin>,
    /// Largest factor below one that makes the loop unstable; `None` where none does.
    pub lower_gain_margin: Option<GainMargin>,
    /// Phase margin of least size; `None` where the loop gain never is one.
    pub phase_margin: Option<PhaseMargin>,
    /// Peak of `S = 1 / (1 + G K F)`.
    pub peak_s: PeakGain,
    /// Peak of `T = G K S`, from reference to displacement.
    pub peak_t: PeakGain,
    /// Peak of `K S`, from reference to command, unit per mm.
    pub peak_ks: PeakGain,
    /// First frequency at which `|T|` falls through -3 dB, in Hz; `None` where it never does.
    pub bandwidth_hz: Option<f64>,
}

impl Certificate {
    /// Whether the loop is stable for every plant inside the bound: nominally stable, and one of the two tests passes.
    ///
    /// Judged from the poles and peaks that the certificate lists, so that an edited file cannot claim what its numbers do
    /// not show.
    pub fn holds(&self) -> bool {
        let stable = !self.closed_loop_poles.is_empty() && self.closed_loop_poles.iter().all(|p| p.re < 0.0);
        let norm_test = self.norm_ms.upper * self.norm_ws.upper < 1.0;
        stable && self.stable && (norm_test || self.frequency_wise.upper < 1.0)
    }
}

/// Returns the certificate of a loop that is nominally stable.
///
/// [`Certificate::holds`] says whether the loop stays stable for every plant inside the bound; a loop may be nominally
/// stable and yet fail that. A loop that is not even nominally stable has no certificate: peaks and margins would be numbers
/// without a meaning.
///
/// **Method**: closed loops are formed in state space and every peak is the bracketed H-infinity norm. The small-gain
/// theorem is applied twice, to the norms, Eq. (23), and to the product `W_s M_s` frequency by frequency. With a filter
/// `F` in the measurement, an additive error sees `M_s = K F S`.
///
/// **Source**: Eqs. (22) to (24); Zhou and Doyle 1998, theorem 8.1 and section 8.3.
///
/// **Errors**: [`Error::UnstableLoop`] with the poles at fault, [`Error::UnstableElement`] for an unstable bound or
/// filter; [`Error::System`] for a controller that is not single-input single-output or a loop without solution.
///
/// **Example**
/// ```
/// use telepulse_design::verify::{LoopUnderTest, verify};
/// use telepulse_lti::TransferFunction;
/// let plant = TransferFunction::new(&[1.0], &[1.0, 1.0])?;
/// let bound = TransferFunction::new(&[0.1], &[1.0])?;
/// let controller = TransferFunction::new(&[2.0], &[1.0, 0.001])?.to_state_space();
/// let loop_ = LoopUnderTest { plant: &plant, controller: &controller, bound: &bound, measurement_filter: None };
/// let certificate = verify(&loop_)?;
/// assert!(certificate.holds());
/// assert!((certificate.small_gain_limit - 10.0).abs() < 1e-12);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn verify(loop_under_test: &LoopUnderTest<'_>) -> Result<Certificate, Error> {
    check_stable("uncertainty bound", loop_under_test.bound)?;
    if let Some(filter) = loop_under_test.measurement_filter {
        check_stable("measurement filter", filter)?;
    }
    let (n_inputs, n_outputs) =
        (loop_under_test.controller.n_inputs(), loop_under_test.controller.n_outputs());
    if (n_inputs, n_outputs) != (1, 1) {
        return Err(telepulse_lti::Error::NotSiso { n_inputs, n_outputs }.into());
    }
    let transfers = LoopTransfers::new(loop_under_test)?;
    let closed_loop_poles = transfers.s.poles()?;
    let unstable: Vec<Complex64> = closed_loop_poles.iter().filter(|pole| pole.re >= 0.0).copied().collect();
    if !unstable.is_empty() {
        return Err(Error::UnstableLoop { poles: unstable });
    }

    let ws = loop_under_test.bound.to_state_space();
    let norm_ms = hinf_norm(&transfers.ms)?;
    let norm_ws = hinf_norm(&ws)?;
    let frequency_wise = hinf_norm(&transfers.ms.series(&ws)?)?;
    let margins = LoopMargins::of_state_space(&transfers.loop_)?;
    Ok(Certificate {
        norm_ms,
        norm_ws,
        small_gain_limit: 1.0 / norm_ws.value,
        norm_test_passes: norm_ms.upper * norm_ws.upper < 1.0,
        frequency_wise,
        frequency_wise_passes: frequency_wise.upper < 1.0,
        bandwidth_hz: bandwidth_hz(&transfers.t, &closed_loop_poles)?,
        closed_loop_poles,
        stable: true,
        gain_margin: margins.upper_gain_margin(),
        lower_gain_margin: margins.lower_gain_margin(),
        phase_margin: margins.phase_margin(),
        peak_s: hinf_norm(&transfers.s)?,
        peak_t: hinf_norm(&transfers.t)?,
        peak_ks: hinf_norm(&transfers.ks)?,
    })
}

fn check_stable(system: &'static str, tf: &TransferFunction) -> Result<(), Error> {
    match tf.poles()?.into_iter().find(|pole| pole.re >= 0.0) {
        Some(pole) => Err(Error::UnstableElement { system, pole }),
        None => Ok(()),
    }
}

/// First frequency at which `|T|` falls through `1 / sqrt(2)`.
///
/// **Method**: logarithmic grid from two decades below the slowest pole to two above the fastest, then bisection.
fn bandwidth_hz(t: &StateSpace<Continuous>, poles: &[Complex64]) -> Result<Option<f64>, Error> {
    let sizes = || poles.iter().map(|pole| pole.norm()).filter(|size| *size > 0.0);
    let low = 1e-2 * sizes().fold(1.0, f64::min);
    let high = 1e2 * sizes().fold(1.0, f64::max);
    let n_points = ((high / low).log10() * POINTS_PER_DECADE).ceil() as usize;
    let below = |omega: f64| -> Result<bool, Error> {
        Ok(t.at(omega)?[(0, 0)].norm() < std::f64::consts::FRAC_1_SQRT_2)
    };
    let mut left = low;
    let mut left_below = below(low)?;
    for k in 1..=n_points {
        let right = low * (high / low).powf(k as f64 / n_points as f64);
        let right_below = below(right)?;
        if right_below && !left_below {
            let (mut inside, mut outside) = (left, right);
            for _ in 0..BISECTIONS {
                let middle = 0.5 * (inside + outside);
                if below(middle)? {
                    outside = middle;
                } else {
                    inside = middle;
                }
            }
            return Ok(Some(outside / std::f64::consts::TAU));
        }
        (left, left_below) = (right, right_below);
    }
    Ok(None)
}

const POINTS_PER_DECADE: f64 = 200.0;
/// Enough to exhaust a double from neighbouring grid points.
const BISECTIONS: usize = 60;
