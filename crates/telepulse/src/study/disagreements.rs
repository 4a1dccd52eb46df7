//! Where the paper disagrees with itself: recomputed in every run from what it prints.

use std::f64::consts::{PI, TAU};

use anyhow::Result;
use telepulse_lti::TransferFunction;

use super::config::{Pid, Study};
use super::outcome::Disagreement;

/// What the synthesis and the verification of this run add to the list.
#[derive(Debug, Clone, Copy)]
pub struct Recomputed {
    /// Stacked norm that the printed controller reaches.
    pub gamma_printed: f64,
    /// Lower bound of the optimum.
    pub gamma_lower: f64,
    /// Gain margin of the printed loop.
    pub gain_margin: f64,
    /// The same with the filter (26) in the measurement.
    pub gain_margin_filtered: f64,
}

/// The list of disagreements.
///
/// # Errors
/// Where a printed system cannot be evaluated.
pub fn list(study: &Study, recomputed: Recomputed) -> Result<Vec<Disagreement>> {
    let plant = study.printed.plant.to_transfer_function("printed.plant")?;
    let controller = study.printed.controller.to_transfer_function("printed.controller")?;
    let error_weight = study.weights.error.to_transfer_function("weights.error")?;
    let control_weight = study.weights.control.to_transfer_function("weights.control")?;
    let mut rows = Vec::new();
    let mut row = |item: &str, printed: String, recomputed: String, note: &str| {
        rows.push(Disagreement { item: item.into(), printed, recomputed, note: note.into() });
    };

    let dc_gain = plant.dc_gain()?;
    row(
        "Displacement at 5 kV: figure 9 against (16)",
        "2 mm, model error 6.91 %".into(),
        format!("(16) gives {dc_gain:.3} mm"),
        "One plant cannot have both. 2 x 0.935 / (1 - 0.0691) = 2.009 suggests a factor-2 amplitude convention (conjecture).",
    );
    let omega_n = plant.poles()?.iter().filter(|p| p.im > 0.0).map(|p| p.norm()).fold(f64::NAN, f64::max);
    row(
        "Natural frequency and stiffness, (18)",
        "40 rad/s, 160 N/m".into(),
        format!("{omega_n:.2} rad/s, {:.1} N/m", 0.1 * omega_n * omega_n),
        "(16) has its pole pair at 38 rad/s; with m = 0.1 kg that is another stiffness.",
    );
    let pa_per_mm = |k: f64, radius_m: f64| k / (PI * radius_m * radius_m) * 1e-3;
    let k_needed = 1296.2144e3 * PI * 0.006_35_f64.powi(2);
    row(
        "Pressure that makes 1 mm",
        "1296.2144 Pa/mm".into(),
        format!("{:.2} Pa/mm", pa_per_mm(160.0, 0.006_35)),
        &format!(
            "160 N/m on r = 6.35 mm. The printed value needs {k_needed:.2} N/m; the plate of section 2 has r = 12.7 mm: {:.1} Pa/mm.",
            pa_per_mm(160.0, 0.0127)
        ),
    );
    row(
        "Peak-to-peak pulse",
        "827.3709 Pa and 841.16039 Pa".into(),
        "two values".into(),
        "Both are called the peak-to-peak pressure of the same pulse; the first is used here.",
    );
    let peak_mm = largest_reference(study);
    row(
        "Largest reference (25)",
        "0.5 mm; 0.0107 mm is 2.15 %".into(),
        format!("{peak_mm:.4} mm; 0.0107 mm is {:.2} %", 100.0 * 0.0107 / peak_mm),
        "0.2 + 0.2 + 0.1 bounds the sum of the three sines; they never add up.",
    );
    let back_at_dc = last_crossing_hz(&plant, dc_gain);
    let minus_3_db = last_crossing_hz(&plant, dc_gain / 2.0_f64.sqrt());
    row(
        "Cut-off of the actuator",
        "8 Hz".into(),
        format!("{minus_3_db:.2} Hz at -3 dB"),
        &format!("The magnitude of (16) is back at its DC value at {back_at_dc:.2} Hz."),
    );
    let closed = |omega: f64| {
        let l = plant.at(omega) * controller.at(omega);
        (l / (l + 1.0)).norm()
    };
    let (dip_hz, dip_db, rise_hz, rise_db, first_hz) = closed_loop_features(closed);
    row(
        "Closed loop, figure 12",
        "relatively flat to 6.07 Hz".into(),
        format!("dip {dip_db:.1} dB at {dip_hz:.1} Hz, peak {rise_db:+.1} dB at {rise_hz:.2} Hz"),
        &format!("It first crosses -3 dB at {first_hz:.2} Hz."),
    );
    row(
        "Roles of We and Wu",
        "We for control effort, Wu for tracking".into(),
        format!("DC gains: We {:.0}, Wu {:.1e}", error_weight.dc_gain()?, control_weight.dc_gain()?),
        "The shapes of (19) and (20) demand the opposite; taken literally the norm would be 1000.",
    );
    row(
        "Optimality of (21)",
        "from hinfsyn".into(),
        format!(
            "reaches {:.4}; no controller gets below {:.4}",
            recomputed.gamma_printed, recomputed.gamma_lower
        ),
        "With the printed plant and weights a better controller exists in every printed measure.",
    );
    row(
        "Margins with the filter (26) in the loop",
        "not in the analysis".into(),
        format!("gain margin {:.2} falls to {:.2}", recomputed.gain_margin, recomputed.gain_margin_filtered),
        "The implementation has the filter; (22)-(24) do not.",
    );
    let siemens = |power_w: f64, effort: f64| power_w / (effort * 25e6) * 1e9;
    row(
        "Table 1: power",
        "actuator read as a capacitor".into(),
        format!(
            "{:.1}, {:.1}, {:.1}, {:.1} nS",
            siemens(0.3186, 0.3431),
            siemens(0.2678, 0.3008),
            siemens(0.3355, 0.3565),
            siemens(0.2589, 0.2935)
        ),
        "Power over mean square voltage is the same in all rows: a resistance of about 27 MOhm, not a capacitance.",
    );
    let bin_hz = 100.0 / 256.0;
    row(
        "Harmonics of the pulse",
        "1.172, 2.734, 3.906 Hz".into(),
        format!("{:.3}, {:.3}, {:.3} Hz", 3.0 * bin_hz, 7.0 * bin_hz, 10.0 * bin_hz),
        "Bins 3, 7 and 10 of a 2.56 s record: the true rate was about 1.305 Hz (inference).",
    );
    let hand = slowest_pole(&plant, &study.pid.manual)?;
    row(
        "Hand-set PID, figure 14",
        "tracks".into(),
        format!("closed-loop pole at {hand:+.1} rad/s on (16)"),
        "Unstable on the nominal plant: the rig and (16) disagree here.",
    );
    let auto = slowest_pole(&plant, &study.pid.auto)?;
    let auto_pid = study.pid.auto.settings().transfer_function()?;
    let unity_loop = auto_pid.to_state_space().feedback(&plant.to_state_space())?;
    let peak_ks = telepulse_lti::hinf_norm(&unity_loop)?.value;
    row(
        "Auto-tuned PID",
        "lost stability on the rig".into(),
        format!(
            "stable on (16), slowest pole {auto:.1} rad/s; peak of K S {peak_ks:.0} against a limit of 4.12"
        ),
        "Stable on paper and not robust: a hundred times over the small-gain limit.",
    );
    for (item, printed, corrected, note) in TEXTUAL {
        row(item, printed.into(), corrected.into(), note);
    }
    Ok(rows)
}

/// What is wrong in print without a number to recompute.
const TEXTUAL: [(&str, &str, &str, &str); 5] = [
    (
        "Plate dynamics (4), (5), (7)-(9)",
        "no m g, no restoring sign",
        "m x'' = m g - F(x, Phi) - c x'",
        "As printed the membrane pushes the plate away; 2 pi mu H and the voltage's scaling are missing as well, and (8) has no input.",
    ),
    ("Circuit (6), (9)", "- u/(Rc C)", "+ u/(Rc C)", "(7), (10) and (14) have the right sign."),
    (
        "Linearisation (10)-(13)",
        "about u = 0",
        "about a bias",
        "Force goes with voltage squared, so the input gain at zero bias is zero; (11) needs R = B, (12) is zero without viscosity.",
    ),
    ("Circuit time constant", "Rc C = 1/0.0045", "Rc C = 0.0045 s", "As (14) uses it."),
    ("Numerator of (15)", "1", "1350.14", "(16) is 1350.14 x (14) x (15) with numerator 1."),
];

/// Largest magnitude of the reference about its offset over the measured window, one common period of the sines.
fn largest_reference(study: &Study) -> f64 {
    let steps = 200_000;
    (0..=steps)
        .map(|idx| study.reference.window_s * f64::from(idx) / f64::from(steps))
        .map(|t_s| (study.reference.at(t_s) - study.reference.offset_mm).abs())
        .fold(0.0, f64::max)
}

/// Highest frequency below 100 Hz at which the magnitude falls through `level`.
fn last_crossing_hz(plant: &TransferFunction, level: f64) -> f64 {
    let excess = |hz: f64| plant.at(TAU * hz).norm() - level;
    let (mut low, mut high) = (100.0, 100.0);
    while excess(low) < 0.0 && low > 0.01 {
        high = low;
        low *= 0.999;
    }
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if excess(middle) < 0.0 { high = middle } else { low = middle }
    }
    0.5 * (low + high)
}

/// Dip, peak and first -3 dB crossing of the complementary sensitivity, below 20 Hz.
fn closed_loop_features(magnitude: impl Fn(f64) -> f64) -> (f64, f64, f64, f64, f64) {
    let db = |hz: f64| 20.0 * magnitude(TAU * hz).log10();
    let grid: Vec<f64> = (0..40_000).map(|idx| 0.05 + 20.0 * f64::from(idx) / 40_000.0).collect();
    let peak_hz = grid.iter().copied().max_by(|a, b| db(*a).total_cmp(&db(*b))).unwrap_or(f64::NAN);
    let below = grid.iter().copied().filter(|hz| *hz < peak_hz);
    let dip_hz = below.min_by(|a, b| db(*a).total_cmp(&db(*b))).unwrap_or(f64::NAN);
    let first_hz = grid.iter().copied().find(|hz| db(*hz) < -3.0103).unwrap_or(f64::NAN);
    (dip_hz, db(dip_hz), peak_hz, db(peak_hz), first_hz)
}

/// Real part of the rightmost pole of the loop of `plant` and PID.
fn slowest_pole(plant: &TransferFunction, pid: &Pid) -> Result<f64> {
    let loop_gain = plant.multiply(&pid.settings().transfer_function()?)?;
    let closed = loop_gain.feedback(&TransferFunction::from_gain(1.0)?)?;
    Ok(closed.poles()?.iter().map(|p| p.re).fold(f64::NEG_INFINITY, f64::max))
}
