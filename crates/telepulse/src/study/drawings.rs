//! The figures of a study, from what its stages found.

use std::f64::consts::TAU;

use anyhow::Result;
use telepulse_lti::TransferFunction;
use telepulse_pulse::spectrum::{Spectrum as LineSpectrum, Window};

use super::config::Study;
use super::outcome::Spectrum;
use super::recipes;
use super::tracking::{Step, Tracked};
use super::transmission::Transmitted;
use crate::figure::Figure;
use crate::recording;
use crate::report::figures;
use crate::station::replay::Mode;

pub(super) fn step_figure(steps: &[(&str, Step)], model: &TransferFunction) -> Result<Figure> {
    let shown_s = 3.0;
    let devices: Vec<(String, Vec<f64>, Vec<f64>)> = steps
        .iter()
        .map(|(name, step)| {
            let kept = || (0..step.time_s.len()).step_by(4).take_while(|k| step.time_s[*k] <= shown_s);
            (
                (*name).to_owned(),
                kept().map(|k| step.time_s[k]).collect(),
                kept().map(|k| step.displacement_mm[k]).collect(),
            )
        })
        .collect();
    let response = model.to_state_space().step_response(0, shown_s, telepulse_lti::SampleTime::new(2e-3)?)?;
    let linear_mm: Vec<f64> = response.outputs.column(0).iter().copied().collect();
    Ok(figures::step(&devices, (&response.time_s, &linear_mm)))
}

pub(super) fn closed_loop_figure(loops: &[recipes::Loop]) -> Result<Figure> {
    let hz: Vec<f64> = (0..400).map(|idx| 0.05 * (50.0_f64 / 0.05).powf(f64::from(idx) / 399.0)).collect();
    let curves = loops
        .iter()
        .map(|one| {
            let (mut t, mut ks) = (Vec::with_capacity(hz.len()), Vec::with_capacity(hz.len()));
            for hz in &hz {
                let omega = TAU * hz;
                let (g, k, f) =
                    (one.plant.at(omega), one.controller.at(omega)?[(0, 0)], one.filter.at(omega));
                let sensitivity = 1.0 / (1.0 + g * k * f);
                t.push(g * k * sensitivity);
                ks.push(k * sensitivity);
            }
            Ok((one.controller_name.clone(), t, ks))
        })
        .collect::<Result<Vec<_>>>()?;
    Ok(figures::closed_loop(&curves, &hz))
}

pub(super) fn tracking_figures(tracked: &[Tracked]) -> Vec<Figure> {
    let traces = |condition: &str| -> figures::Traces {
        tracked
            .iter()
            .filter(|run| run.condition == condition)
            .map(|run| (run.controller.clone(), run.trace.clone()))
            .collect()
    };
    let main = ["printed_k", "hinf", "best"];
    vec![
        figures::tracking(
            "fig13-tracking",
            "Tracking of (25) (counterpart of figure 13)",
            "Normal condition. The true displacement, not the measured one.",
            &traces("normal"),
            &main,
        ),
        figures::tracking(
            "fig14-pid",
            "Tracking of (25) with PID (counterpart of figure 14)",
            "The paper's two sets of gains, with the filter (26). A run that the supervisor ends stops early.",
            &traces("normal"),
            &["pid_auto", "pid_manual"],
        ),
        figures::tracking(
            "fig15-disturbance-noise",
            "Tracking of (25) under disturbance and noise (counterpart of figure 15)",
            "A constant force on the plate and a 50 Hz sine on the sensor. The true displacement, not the measured one.",
            &traces("both"),
            &main,
        ),
    ]
}

pub(super) fn pulse_figures(study: &Study) -> Result<(Spectrum, Vec<Figure>)> {
    let pulse = recording::read(&study.path(&study.pulse.recording))?
        .scaled_to_peak_to_peak(study.pulse.peak_to_peak_pa, telepulse_pulse::Unit::Pascal)?;
    let beats = telepulse_pulse::beats::detect(&pulse)?;
    let feet_s: Vec<f64> = beats.beats.iter().map(|beat| beat.foot_s).collect();
    let feet_pa: Vec<f64> = beats.beats.iter().map(|beat| beat.foot_value).collect();
    let mean = pulse.mean();
    let centred: Vec<f64> = pulse.values().iter().map(|p| p - mean).collect();
    let spectrum = LineSpectrum::of(&centred, pulse.sample_rate_hz(), Window::Hann)?;
    let strongest = spectrum.amplitudes().iter().copied().fold(0.0, f64::max);
    let peaks: Vec<_> = spectrum
        .peaks(0.08 * strongest)
        .into_iter()
        .filter(|peak| peak.frequency_hz > 0.7 && peak.frequency_hz < 10.0)
        .collect();
    let marks: Vec<(f64, f64)> = peaks.iter().map(|peak| (peak.frequency_hz, peak.amplitude)).collect();
    let found = Spectrum {
        heart_rate_bpm: beats.heart_rate_bpm,
        beats: beats.beats.len(),
        peaks_hz: peaks.iter().map(|peak| peak.frequency_hz).collect(),
    };
    let figures = vec![
        figures::pulse(&pulse.times_s(), pulse.values(), &feet_s, &feet_pa),
        figures::spectrum(&spectrum.frequencies_hz(), spectrum.amplitudes(), &marks),
    ];
    Ok((found, figures))
}

pub(super) fn replay_figures(transmitted: &Transmitted) -> Vec<Figure> {
    let traces = |mode: Mode| -> figures::Traces {
        transmitted
            .replays
            .iter()
            .filter(|r| r.mode == mode)
            .map(|r| (r.controller.clone(), r.trace.clone()))
            .collect()
    };
    let displacement = traces(Mode::Displacement);
    vec![
        figures::replay(
            "fig18-displacement",
            "Pulse replayed in displacement mode (counterpart of figure 18)",
            "Eight of forty seconds: received over the link, replayed on the virtual rig with weight and laser.",
            "displacement, mm",
            &displacement,
            10.0,
            18.0,
        ),
        figures::replay(
            "fig20-force",
            "Pulse replayed in force mode (counterpart of figure 20)",
            "The same eight seconds: pressure on the load cell that holds the plate.",
            "pressure, Pa",
            &traces(Mode::Force),
            10.0,
            18.0,
        ),
        figures::replay(
            "tracked-pulse",
            "A patient's pulse, felt at a distance",
            "Four seconds of the replay in displacement mode: the printed controller lags, preview removes the lag.",
            "displacement, mm",
            &displacement,
            10.0,
            14.0,
        ),
    ]
}
