//! The figures of a study, each the counterpart of one of the paper's.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use telepulse_design::identify::UncertaintyBound;
use telepulse_lti::TransferFunction;

use crate::figure::{Axis, Colour, Dash, Figure, Marker, Panel, Series};
use crate::study::identify::Identification;
use crate::study::outcome::BiasPoint;
use crate::study::pulse_files::{PulseFile, PulseFiles};
use crate::study::trace::Trace;

/// Traces by controller.
pub type Traces = BTreeMap<String, Trace>;

/// How a controller is named and coloured everywhere.
#[must_use]
pub fn controller_style(controller: &str) -> (&'static str, Colour) {
    match controller {
        "printed_k" => ("printed K (21)", Colour::Vermilion),
        "hinf" => ("own S/KS", Colour::Blue),
        "best" => ("best", Colour::Green),
        "pid_auto" => ("auto-tuned PID", Colour::Orange),
        "pid_manual" => ("hand-set PID", Colour::Purple),
        _ => ("controller", Colour::Sky),
    }
}

fn decibel(value: f64) -> f64 {
    20.0 * value.log10()
}

fn grid_hz(low: f64, high: f64, n: usize) -> Vec<f64> {
    (0..n).map(|idx| low * (high / low).powf(idx as f64 / (n - 1) as f64)).collect()
}

/// Phase of a response over a grid in degrees, without jumps of a full turn.
fn phase_deg(values: &[num_complex::Complex64]) -> Vec<f64> {
    let mut unwrapped: Vec<f64> = Vec::with_capacity(values.len());
    for value in values {
        let mut phase = value.arg().to_degrees();
        if let Some(&previous) = unwrapped.last() {
            phase -= 360.0 * ((phase - previous) / 360.0).round();
        }
        unwrapped.push(phase);
    }
    unwrapped
}

/// Figure 7: the measured frequency response and its models.
#[must_use]
pub fn frequency_response(identification: &Identification, printed: &TransferFunction) -> Figure {
    let hz = grid_hz(0.08, 16.0, 400);
    let mut magnitude = Panel::new(Axis::log("frequency, Hz"), Axis::linear("gain, dB (mm/unit)"));
    let mut phase = Panel::new(Axis::log("frequency, Hz"), Axis::degrees("phase, deg"));
    let markers = [Marker::Circle, Marker::Square, Marker::Triangle, Marker::Diamond];
    for (idx, amplitude) in identification.record.amplitudes().into_iter().enumerate() {
        let points: Vec<_> =
            identification.record.points().iter().filter(|p| p.amplitude == amplitude).collect();
        let x: Vec<f64> = points.iter().map(|p| p.frequency_hz).collect();
        let name = format!("measured, amplitude {amplitude}");
        let (colour, marker) =
            ([Colour::Sky, Colour::Orange, Colour::Purple, Colour::Grey][idx % 4], markers[idx % 4]);
        let db = points.iter().map(|p| decibel(p.magnitude_mm_per_unit)).collect();
        magnitude = magnitude.series(Series::points(name.clone(), x.clone(), db, colour, marker));
        let deg = points.iter().map(|p| p.phase_deg).collect();
        phase = phase.series(Series::points(name, x, deg, colour, marker));
    }
    let models = [
        ("fit, complex least squares", &identification.fit.transfer_function, Colour::Blue, Dash::Solid),
        (
            "fit by magnitude only",
            &identification.magnitude_fit.transfer_function,
            Colour::Green,
            Dash::Dashed,
        ),
        ("printed (16)", printed, Colour::Ink, Dash::Dotted),
    ];
    for (name, model, colour, dash) in models {
        let values: Vec<_> = hz.iter().map(|hz| model.at(TAU * hz)).collect();
        let db = values.iter().map(|v| decibel(v.norm())).collect();
        magnitude = magnitude.series(Series::dashed(name, hz.clone(), db, colour, dash));
        phase = phase.series(Series::dashed(name, hz.clone(), phase_deg(&values), colour, dash));
    }
    Figure::new("fig07-frequency-response", "Frequency response of the device (counterpart of figure 7)")
        .caption("Stepped sine about the bias at three amplitudes, and third-order models of it.")
        .shared_x()
        .panel(magnitude)
        .panel(phase)
}

/// Figure 8: what the model leaves, and the weight that bounds it.
#[must_use]
pub fn uncertainty(bound: &UncertaintyBound, printed: &TransferFunction) -> Figure {
    let hz = grid_hz(0.08, 40.0, 400);
    let mut panel = Panel::new(Axis::log("frequency, Hz"), Axis::log("additive error, mm per unit"));
    let mut amplitudes: Vec<f64> = bound.points.iter().map(|p| p.amplitude).collect();
    amplitudes.sort_by(f64::total_cmp);
    amplitudes.dedup();
    let markers = [Marker::Circle, Marker::Square, Marker::Triangle, Marker::Diamond];
    for (idx, amplitude) in amplitudes.into_iter().enumerate() {
        let points: Vec<_> = bound.points.iter().filter(|p| p.amplitude == amplitude).collect();
        panel = panel.series(Series::points(
            format!("measured, amplitude {amplitude}"),
            points.iter().map(|p| p.frequency_hz).collect(),
            points.iter().map(|p| p.complex).collect(),
            [Colour::Sky, Colour::Orange, Colour::Purple, Colour::Grey][idx % 4],
            markers[idx % 4],
        ));
    }
    for (name, weight, colour, dash) in [
        ("own bound W_s", &bound.weight, Colour::Blue, Dash::Solid),
        ("printed (17)", printed, Colour::Ink, Dash::Dotted),
    ] {
        let y = hz.iter().map(|hz| weight.at(TAU * hz).norm()).collect();
        panel = panel.series(Series::dashed(name, hz.clone(), y, colour, dash));
    }
    Figure::new("fig08-uncertainty", "Model error and its bound (counterpart of figure 8)")
        .caption("Complex additive error of every point and amplitude; no point lies above the own bound.")
        .panel(panel)
}

/// Figure 9: the step of full scale.
#[must_use]
pub fn step(devices: &[(String, Vec<f64>, Vec<f64>)], model: (&[f64], &[f64])) -> Figure {
    let mut panel = Panel::new(Axis::linear("time, s"), Axis::linear("displacement, mm"));
    let colours = [Colour::Blue, Colour::Green, Colour::Purple];
    for (idx, (name, time_s, displacement_mm)) in devices.iter().enumerate() {
        let colour = colours[idx % colours.len()];
        panel = panel.series(Series::line(name.clone(), time_s.clone(), displacement_mm.clone(), colour));
    }
    panel = panel.series(Series::dashed(
        "linear model (16)",
        model.0.to_vec(),
        model.1.to_vec(),
        Colour::Ink,
        Dash::Dotted,
    ));
    Figure::new("fig09-step", "Step of 5 kV (counterpart of figure 9)")
        .caption("From rest under the load. The paper's figure settles at 2 mm, its model (16) at 0.935 mm.")
        .panel(panel)
}

/// Figure 12: complementary sensitivities.
#[must_use]
pub fn closed_loop(
    loops: &[(String, Vec<num_complex::Complex64>, Vec<num_complex::Complex64>)],
    hz: &[f64],
) -> Figure {
    let mut tracking = Panel::new(Axis::log("frequency, Hz"), Axis::linear("T, dB").range(-40.0, 10.0));
    let mut effort = Panel::new(Axis::log("frequency, Hz"), Axis::linear("K S, dB (unit/mm)"));
    for (controller, t, ks) in loops {
        let (name, colour) = controller_style(controller);
        let db = |values: &[num_complex::Complex64]| values.iter().map(|v| decibel(v.norm())).collect();
        tracking = tracking.series(Series::line(name, hz.to_vec(), db(t), colour));
        effort = effort.series(Series::line(name, hz.to_vec(), db(ks), colour));
    }
    Figure::new("fig12-closed-loop", "Closed loop: feedback alone (counterpart of figure 12)")
        .caption("Complementary sensitivity T and control sensitivity K S on each controller's own model; preview is not in it.")
        .shared_x()
        .panel(tracking)
        .panel(effort)
}

/// Gain margin of each loop on the plant as it is at other biases.
#[must_use]
pub fn bias_sweep(points: &[BiasPoint]) -> Figure {
    let mut gain = Panel::new(
        Axis::linear("bias, fraction of full-scale voltage"),
        Axis::linear("static gain, mm per unit"),
    );
    let mut margin =
        Panel::new(Axis::linear("bias, fraction of full-scale voltage"), Axis::log("gain margin, factor"));
    let mut names: Vec<&str> = points.iter().map(|point| point.controller.as_str()).collect();
    names.dedup();
    for controller in &names {
        let (name, colour) = controller_style(controller);
        let of = |value: &dyn Fn(&BiasPoint) -> f64| -> (Vec<f64>, Vec<f64>) {
            points.iter().filter(|p| p.controller == *controller).map(|p| (p.bias, value(p))).unzip()
        };
        let (x, y) = of(&|p| p.dc_gain_mm_per_unit);
        gain = gain.series(Series::line(name, x, y, colour));
        let (x, y) = of(&|p| p.gain_margin.unwrap_or(f64::NAN));
        margin = margin.series(Series::line(name, x, y, colour));
    }
    let ends = (
        points.iter().map(|p| p.bias).fold(1.0, f64::min),
        points.iter().map(|p| p.bias).fold(0.0, f64::max),
    );
    margin = margin.series(Series::level("limit of stability", ends.0, ends.1, 1.0, Colour::Grey));
    Figure::new("bias-sweep", "Gain margin over the stroke")
        .caption(
            "Each loop on the plant as identified with small sines at other biases, with the filter (26). Below 1 the loop is \
             unstable. Force goes with voltage squared: the square root at the amplifier removes most of the change.",
        )
        .shared_x()
        .panel(gain)
        .panel(margin)
}

/// Figures 13, 14 and 15: tracking of the multi-sine.
#[must_use]
pub fn tracking(id: &str, title: &str, caption: &str, traces: &Traces, controllers: &[&str]) -> Figure {
    let time = || Axis::linear("time in the window, s");
    let mut output = Panel::new(time(), Axis::linear("displacement, mm"));
    let mut error = Panel::new(time(), Axis::linear("error, mm"));
    let mut voltage = Panel::new(time(), Axis::linear("voltage, kV").range(-0.2, 5.2));
    if let Some(trace) = controllers.iter().find_map(|c| traces.get(*c)) {
        output = output.series(Series::line(
            "reference (25)",
            trace.time_s.clone(),
            trace.reference.clone(),
            Colour::Ink,
        ));
    }
    for &controller in controllers {
        let Some(trace) = traces.get(controller) else { continue };
        let (name, colour) = controller_style(controller);
        output = output.series(Series::line(name, trace.time_s.clone(), trace.output.clone(), colour));
        error = error.series(Series::line(name, trace.time_s.clone(), trace.error(), colour));
        voltage = voltage.series(Series::line(name, trace.time_s.clone(), trace.voltage_kv.clone(), colour));
    }
    Figure::new(id, title).caption(caption).shared_x().panel(output).panel(error).panel(voltage)
}

/// Figure 16: the recording as it is sent.
#[must_use]
pub fn pulse(time_s: &[f64], pressure_pa: &[f64], feet_s: &[f64], feet_pa: &[f64]) -> Figure {
    Figure::new("fig16-pulse", "The pulse (counterpart of figure 16)")
        .caption("A real arterial pressure recording, its rate and shape kept, its amplitude scaled to the paper's.")
        .panel(
            Panel::new(Axis::linear("time, s"), Axis::linear("pressure above minimum, Pa"))
                .series(Series::line("pressure", time_s.to_vec(), pressure_pa.to_vec(), Colour::Ink))
                .series(Series::points("foot of the beat", feet_s.to_vec(), feet_pa.to_vec(), Colour::Vermilion, Marker::Circle)),
        )
}

/// Figure 17: its spectrum.
#[must_use]
pub fn spectrum(frequency_hz: &[f64], amplitude_pa: &[f64], peaks: &[(f64, f64)]) -> Figure {
    let n = frequency_hz.iter().take_while(|hz| **hz <= 10.0).count();
    Figure::new("fig17-spectrum", "Spectrum of the pulse (counterpart of figure 17)")
        .caption("The paper's peaks are at 1.172, 2.734 and 3.906 Hz: bins 3, 7 and 10 of a 2.56 s record.")
        .panel(
            Panel::new(Axis::linear("frequency, Hz").range(0.0, 10.0), Axis::linear("amplitude, Pa"))
                .series(Series::line(
                    "spectrum",
                    frequency_hz[..n].to_vec(),
                    amplitude_pa[..n].to_vec(),
                    Colour::Blue,
                ))
                .series(Series::points(
                    "peaks",
                    peaks.iter().map(|p| p.0).collect(),
                    peaks.iter().map(|p| p.1).collect(),
                    Colour::Vermilion,
                    Marker::Circle,
                )),
        )
}

/// Figures 18 and 20: the pulse as replayed, `unit` being that of the traces.
#[must_use]
pub fn replay(
    id: &str,
    title: &str,
    caption: &str,
    unit: &str,
    traces: &Traces,
    from_s: f64,
    to_s: f64,
) -> Figure {
    let time = || Axis::linear("time, s");
    let mut output = Panel::new(time(), Axis::linear(unit));
    let mut error =
        Panel::new(time(), Axis::linear(format!("error, {}", unit.rsplit(' ').next().unwrap_or(unit))));
    let mut voltage = Panel::new(time(), Axis::linear("voltage, kV").range(-0.2, 5.2));
    let cut = |trace: &Trace, series: &[f64]| -> Vec<f64> {
        let inside = |t: f64| t >= from_s && t <= to_s;
        trace.time_s.iter().zip(series).filter(|(t, _)| inside(**t)).map(|(_, y)| *y).collect()
    };
    for (idx, controller) in ["printed_k", "hinf", "best"].into_iter().enumerate() {
        let Some(trace) = traces.get(controller) else { continue };
        let (name, colour) = controller_style(controller);
        let time_s = cut(trace, &trace.time_s);
        if idx == 0 {
            output = output.series(Series::line(
                "pulse as received",
                time_s.clone(),
                cut(trace, &trace.reference),
                Colour::Ink,
            ));
        }
        output = output.series(Series::line(name, time_s.clone(), cut(trace, &trace.output), colour));
        error = error.series(Series::line(name, time_s.clone(), cut(trace, &trace.error()), colour));
        voltage = voltage.series(Series::line(name, time_s, cut(trace, &trace.voltage_kv), colour));
    }
    Figure::new(id, title).caption(caption).shared_x().panel(output).panel(error).panel(voltage)
}

/// Error and lag of recorded pulses over how far ahead they are known; none without recordings.
#[must_use]
pub fn pulse_files(files: &PulseFiles) -> Option<Figure> {
    let horizons = || Axis::linear("horizon, ms");
    let mut error = Panel::new(horizons(), Axis::log("NRMSE, %"));
    let mut lag = Panel::new(horizons(), Axis::linear("lag, ms"));
    let colours = [
        Colour::Ink,
        Colour::Vermilion,
        Colour::Blue,
        Colour::Green,
        Colour::Orange,
        Colour::Sky,
        Colour::Purple,
        Colour::Grey,
    ];
    for ((name, by_horizon), colour) in files.iter().zip(colours.iter().cycle()) {
        let mut runs: Vec<(f64, &PulseFile)> =
            by_horizon.iter().filter_map(|(key, run)| Some((key.parse().ok()?, run))).collect();
        runs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let x: Vec<f64> = runs.iter().map(|(horizon, _)| *horizon).collect();
        let of = |value: fn(&PulseFile) -> Option<f64>| -> Vec<f64> {
            runs.iter().map(|(_, run)| value(run).unwrap_or(f64::NAN)).collect()
        };
        error = error.series(Series::line(
            name,
            x.clone(),
            of(|run| run.nrmse).into_iter().map(|e| 100.0 * e).collect(),
            *colour,
        ));
        lag = lag.series(Series::line(name, x, of(|run| run.lag_ms), *colour));
    }
    (!files.is_empty()).then(|| {
        Figure::new("pulse-horizon", "Error of recorded pulses against the horizon")
            .caption(
                "Displacement mode, best controller. The horizon is how far ahead the pulse is known, that is, how long the doctor's side \
                 holds it back; at 0 ms the feedforward extrapolates.",
            )
            .shared_x()
            .panel(error)
            .panel(lag)
    })
}
