//! What a loop of a plant and a PID controller is worth: stability and peaks, proven for all frequencies.

use num_complex::Complex64;
use serde::{Deserialize, Serialize};
use telepulse_lti::{Continuous, PeakGain, StateSpace, TransferFunction, hinf_norm};

use super::factors::Factors;
use super::peaks::ClosedLoopFunction;
use super::plant::DelayedPlant;
use super::stability::Characteristic;
use crate::implement::PidSettings;
use crate::{Error, Result};

/// Peaks and margins of a stable loop.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PidLoopCheck {
    /// Peak of `S = 1/(1 + G C)`.
    pub peak_s: PeakGain,
    /// Peak of `T = G C/(1 + G C)`.
    pub peak_t: PeakGain,
    /// Peak of `C S`, unit of command per unit of output.
    pub peak_ks: PeakGain,
    /// Peak of `W_s C S`; below 1 the loop is stable for every additive error under `W_s`. `None` without a weight.
    pub peak_ws_ks: Option<PeakGain>,
    /// Least phase margin in degrees; `None` where the loop gain never is one.
    pub phase_margin_deg: Option<f64>,
    /// Frequency of that margin in rad/s.
    pub crossover_rad_s: Option<f64>,
    /// Extra dead time at which the loop becomes unstable, in s; `None` where none does.
    pub delay_margin_s: Option<f64>,
}

/// Returns peaks and margins of the loop `u = C (r - y)`, `y = G u`.
///
/// **Method**: stability from the closed-loop poles, or with dead time by two counts that have to agree: the direct method of
/// Walton and Marshall, and the argument principle with every step of the argument certified. Peaks without dead time by
/// the Hamiltonian test of [`hinf_norm()`], with dead time by branch and bound over the frequency axis. Nothing rests on a
/// grid.
///
/// **Accuracy**: brackets to 1e-10 relative without dead time, 1e-5 with it.
///
/// # Errors
/// [`Error::PidLoopUnstable`], [`Error::PidLoopNeutral`], [`Error::PidStabilityUncertain`] where a pole lies on the axis as
/// far as rounding can tell; [`Error::UnstableElement`] for an unstable weight.
///
/// # Example
/// ```
/// use telepulse_design::{implement::PidSettings, synthesize::pid::{DelayedPlant, check_pid_loop}};
/// use telepulse_lti::TransferFunction;
/// // An integrator with delay 1 under gain 0.5: crossover 0.5 rad/s, phase margin 90 degrees - 0.5 rad.
/// let plant = DelayedPlant::new(TransferFunction::new(&[1.0], &[1.0, 0.0])?, 1.0)?;
/// let gain = PidSettings { p: 0.5, i_per_s: 0.0, d_s: 0.0, n_rad_s: 0.0 };
/// let check = check_pid_loop(&plant, &gain, None)?;
/// assert!((check.phase_margin_deg.unwrap() - (90.0 - 0.5_f64.to_degrees())).abs() < 1e-9);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn check_pid_loop(
    plant: &DelayedPlant,
    settings: &PidSettings,
    ws: Option<&TransferFunction>,
) -> Result<PidLoopCheck> {
    let controller = settings.transfer_function()?;
    let characteristic = Characteristic::new(plant.rational(), &controller, plant.delay_s());
    let n_unstable = characteristic.n_unstable_certified()?;
    if n_unstable > 0 {
        return Err(Error::PidLoopUnstable { n_unstable });
    }
    if let Some(pole) = ws.map(TransferFunction::poles).transpose()?.iter().flatten().find(|p| p.re >= 0.0) {
        return Err(Error::UnstableElement { system: "weight Ws", pole: *pole });
    }
    let peaks = if plant.delay_s() == 0.0 {
        rational_peaks(plant.rational(), &controller, ws)?
    } else {
        delayed_peaks(plant, &controller, ws)?
    };
    let crossings = characteristic.gain_crossings()?;
    let delay_s = plant.delay_s();
    // 180 degrees + arg L, with arg(-N/D) the angle of the crossing.
    let margin = |omega: f64, angle: f64| {
        let turned = (angle - omega * delay_s).rem_euclid(std::f64::consts::TAU);
        if turned > std::f64::consts::PI { turned - std::f64::consts::TAU } else { turned }
    };
    let least = crossings
        .iter()
        .map(|c| (margin(c.omega, c.angle), c.omega))
        .min_by(|a, b| a.0.abs().total_cmp(&b.0.abs()));
    let delays =
        crossings.iter().map(|c| (c.angle - c.omega * delay_s).rem_euclid(std::f64::consts::TAU) / c.omega);
    Ok(PidLoopCheck {
        peak_s: peaks.s,
        peak_t: peaks.t,
        peak_ks: peaks.ks,
        peak_ws_ks: peaks.ws_ks,
        phase_margin_deg: least.map(|l| l.0.to_degrees()),
        crossover_rad_s: least.map(|l| l.1),
        delay_margin_s: delays.min_by(f64::total_cmp),
    })
}

struct Peaks {
    s: PeakGain,
    t: PeakGain,
    ks: PeakGain,
    ws_ks: Option<PeakGain>,
}

fn rational_peaks(
    plant: &TransferFunction,
    controller: &TransferFunction,
    ws: Option<&TransferFunction>,
) -> Result<Peaks> {
    let (g, k) = (plant.to_state_space(), controller.to_state_space());
    let one = StateSpace::<Continuous>::from_gain(nalgebra::DMatrix::identity(1, 1))?;
    let loop_ = k.series(&g)?;
    let ks = k.feedback(&g)?;
    let ws_ks = match ws {
        Some(ws) => Some(hinf_norm(&ks.series(&ws.to_state_space())?)?),
        None => None,
    };
    let peak_t = hinf_norm(&loop_.feedback(&one)?)?;
    Ok(Peaks { s: hinf_norm(&one.feedback(&loop_)?)?, t: peak_t, ks: hinf_norm(&ks)?, ws_ks })
}

fn delayed_peaks(
    plant: &DelayedPlant,
    controller: &TransferFunction,
    ws: Option<&TransferFunction>,
) -> Result<Peaks> {
    let (g, k) = (Factors::new(plant.rational())?, Factors::new(controller)?);
    let (loop_, one) = (g.multiply(&k), Factors::default());
    let loop_at = |w: f64| -> Complex64 { plant.at(w) * controller.at(w) };
    let peak = |numerator: &Factors,
                over_loop: &Factors,
                numerator_at: &dyn Fn(f64) -> f64,
                over_loop_at: &dyn Fn(f64) -> f64| {
        let function = ClosedLoopFunction {
            loop_at: &loop_at,
            loop_: &loop_,
            delay_s: plant.delay_s(),
            numerator,
            over_loop,
            numerator_at,
            over_loop_at,
        };
        function.peak()
    };
    let (k_at, g_inverse_at) =
        (|w: f64| controller.at(w).norm(), |w: f64| 1.0 / plant.rational().at(w).norm());
    let ws_ks = match ws {
        Some(ws) => {
            let factors = Factors::new(ws)?;
            let at = |w: f64| ws.at(w).norm();
            Some(peak(&factors.multiply(&k), &factors.multiply(&g.inverse()), &|w| at(w) * k_at(w), &|w| {
                at(w) * g_inverse_at(w)
            })?)
        }
        None => None,
    };
    Ok(Peaks {
        s: peak(&one, &loop_.inverse(), &|_| 1.0, &|w| 1.0 / loop_at(w).norm())?,
        t: peak(&loop_, &one, &|w| loop_at(w).norm(), &|_| 1.0)?,
        ks: peak(&k, &g.inverse(), &k_at, &g_inverse_at)?,
        ws_ks,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plant(n: &[f64], d: &[f64], delay_s: f64) -> DelayedPlant {
        DelayedPlant::new(TransferFunction::new(n, d).expect("proper"), delay_s).expect("valid")
    }

    #[test]
    fn law_peaks_with_a_vanishing_delay_are_those_without() {
        // Two routes: branch and bound against the Hamiltonian test. A delay of 1e-9 changes a peak by about 1e-8.
        let ws = TransferFunction::new(&[0.05, 0.2], &[0.1, 1.0]).expect("proper");
        let settings = PidSettings { p: 1.2, i_per_s: 0.8, d_s: 0.6, n_rad_s: 20.0 };
        for (n, d) in [
            (&[1.0][..], &[1.0, 3.0, 3.0, 1.0][..]),
            (&[1.0], &[1.0, 1.0, 0.0]),
            (&[2.0], &[1.0, 0.1, 1.0]),
            (&[-0.1, 1.0], &[1.0, 2.0, 1.0]),
            (&[1.0, 1.0], &[1.0, 0.0, 4.0]),
        ] {
            let exact = check_pid_loop(&plant(n, d, 0.0), &settings, Some(&ws)).expect("stable");
            let other = check_pid_loop(&plant(n, d, 1e-9), &settings, Some(&ws)).expect("stable");
            for (a, b) in [
                (exact.peak_s, other.peak_s),
                (exact.peak_t, other.peak_t),
                (exact.peak_ks, other.peak_ks),
                (exact.peak_ws_ks.expect("weight"), other.peak_ws_ks.expect("weight")),
            ] {
                assert!((a.value / b.value - 1.0).abs() < 2e-5, "{d:?}: {a:?} {b:?}");
            }
        }
    }

    #[test]
    fn law_no_frequency_of_a_dense_grid_beats_the_peaks_of_a_loop_with_delay() {
        let plant = plant(&[1.0], &[1.0, 1.0], 1.0);
        let settings = PidSettings { p: 0.6, i_per_s: 0.5, d_s: 0.2, n_rad_s: 30.0 };
        let check = check_pid_loop(&plant, &settings, None).expect("stable");
        let controller = settings.transfer_function().expect("finite");
        let (mut s, mut t, mut ks) = (0.0_f64, 0.0_f64, 0.0_f64);
        for k in 0..200_000 {
            let w = 1e-3 * 10f64.powf(6.0 * f64::from(k) / 2e5);
            let (l, c) = (plant.at(w) * controller.at(w), controller.at(w));
            s = s.max(1.0 / (1.0 + l).norm());
            t = t.max(l.norm() / (1.0 + l).norm());
            ks = ks.max(c.norm() / (1.0 + l).norm());
        }
        for (grid, peak) in [(s, check.peak_s), (t, check.peak_t), (ks, check.peak_ks)] {
            assert!(grid <= peak.upper && grid >= peak.lower * (1.0 - 1e-5), "{grid} {peak:?}");
        }
    }

    #[test]
    fn paper_sec51_hand_tuned_pi_is_unstable_and_auto_tuned_pid_is_beyond_the_limit() {
        let plant = plant(&[1350.14], &[0.0045, 1.07182, 22.458, 1444.0], 0.0);
        let ws = TransferFunction::new(&[487.5], &[1.0, 45.0, 2500.0]).expect("proper");
        let hand = PidSettings { p: 1.7, i_per_s: 24.331, d_s: 0.0, n_rad_s: 0.0 };
        assert!(matches!(check_pid_loop(&plant, &hand, None), Err(Error::PidLoopUnstable { n_unstable: 2 })));
        let auto = PidSettings { p: 3.1738, i_per_s: 48.6620, d_s: 0.0443, n_rad_s: 9630.0667 };
        let check = check_pid_loop(&plant, &auto, Some(&ws)).expect("stable on (16)");
        // Far above the limit 4.12 of Eq. (24). Frequency by frequency the bound (17) is met, since it falls off as 1/s^2: what
        // fails is the test on the norms.
        assert!((check.peak_ks.value - 429.79).abs() < 0.01, "{check:?}");
        assert!(check.peak_ws_ks.expect("weight").upper < 1.0 && check.peak_ks.lower * 0.24262 > 1.0);
    }
}
