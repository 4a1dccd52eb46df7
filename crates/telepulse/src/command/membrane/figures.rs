//! Figures of a membrane: shape, fields, map, failure map.

use std::path::Path;

use anyhow::Result;
use telepulse_actuator::failure::{FailureCriteria, FailureMap, Mechanism, StateMargins};
use telepulse_actuator::statics::{Sheet, Solution};

use super::map::StaticMap;
use crate::artefact;
use crate::figure::{Axis, Colour, Dash, Figure, Marker, Panel, Series, svg};

/// Writes each figure as `<id>.svg`.
pub(super) fn write(folder: &Path, figures: &[Figure]) -> Result<()> {
    for figure in figures {
        artefact::write_file(&folder.join(format!("{}.svg", figure.id())), svg::render(figure).as_bytes())?;
    }
    Ok(())
}

fn volts(solution: &Solution) -> String {
    format!("{} V", solution.point.voltage_v.round())
}

fn scaled(values: &[f64], factor: f64) -> Vec<f64> {
    values.iter().map(|value| value * factor).collect()
}

/// Deformed shapes in section, with the plate between the two halves.
pub(super) fn shape(sheet: &Sheet, states: &[Solution]) -> Figure {
    let mut panel = Panel::new(Axis::linear("radius r, mm"), Axis::linear("height above the frame, mm"));
    for (idx, state) in states.iter().enumerate() {
        let r = scaled(&state.profile.r_m, 1e3);
        let height = scaled(&state.profile.z_m, -1e3);
        // From the left edge over the plate to the right one.
        let x = r.iter().rev().map(|r| -r).chain(r.iter().copied()).collect();
        let y = height.iter().rev().chain(&height).copied().collect();
        panel = panel.series(Series::line(volts(state), x, y, Colour::cycle(idx)));
    }
    let spec = sheet.spec();
    Figure::new("membrane-shape", "Deformed membrane in section")
        .caption(format!(
            "Section through plate (radius {} mm, the level middle part) and membrane, clamped at {} mm.",
            spec.inner_radius_m * 1e3,
            spec.outer_radius_m * 1e3
        ))
        .panel(panel)
}

/// Stretches, stresses and true field along the undeformed radius.
pub(super) fn fields(states: &[Solution]) -> Figure {
    let radius = || Axis::linear("undeformed radius R, mm");
    let mut stretch = Panel::new(radius(), Axis::linear("stretch"));
    let mut stress = Panel::new(radius(), Axis::linear("nominal stress, kPa"));
    let mut field = Panel::new(radius(), Axis::linear("true field, MV/m"))
        .note("The field has one value in each point: the colour is that of the voltage.");
    for (idx, state) in states.iter().enumerate() {
        let profile = &state.profile;
        let x = || scaled(&profile.radius_undeformed_m, 1e3);
        let colour = Colour::cycle(idx);
        let meridional = format!("meridional, {}", volts(state));
        let hoop = format!("hoop, {}", volts(state));
        stretch = stretch
            .series(Series::line(meridional.clone(), x(), profile.lambda1.clone(), colour))
            .series(Series::dashed(hoop.clone(), x(), profile.lambda2.clone(), colour, Dash::Dashed));
        stress = stress
            .series(Series::line(meridional.clone(), x(), scaled(&profile.s1_pa, 1e-3), colour))
            .series(Series::dashed(hoop, x(), scaled(&profile.s2_pa, 1e-3), colour, Dash::Dashed));
        field =
            field.series(Series::line(meridional, x(), scaled(&profile.true_field_v_per_m, 1e-6), colour));
    }
    Figure::new("membrane-fields", "Stretch, stress and true field along the radius")
        .caption("Plate on the left, frame on the right. Hoop stretch stays near the pre-stretch: what the load does is meridional and near the plate.")
        .shared_x()
        .panel(stretch)
        .panel(stress)
        .panel(field)
}

/// Force over displacement, one curve for each voltage.
pub(super) fn map(map: &StaticMap) -> Figure {
    let mut panel = Panel::new(
        Axis::linear("displacement of the plate below the frame, mm"),
        Axis::linear("force of the membrane, N"),
    );
    for (column, voltage) in map.voltage_v.iter().enumerate() {
        let force = map.force_n.iter().map(|row| row[column].unwrap_or(f64::NAN)).collect();
        let name = format!("{} V", voltage.round());
        panel =
            panel.series(Series::line(name, scaled(&map.displacement_m, 1e3), force, Colour::cycle(column)));
    }
    Figure::new("membrane-map", "Force over displacement and voltage")
        .caption("Voltage lowers the force at a held plate, and so lets a load sink. Gaps: no taut state.")
        .panel(panel)
}

/// Upper end of the voltage axis over the highest limit.
const HEADROOM: f64 = 1.05;

fn style(mechanism: Mechanism) -> (Colour, Dash) {
    match mechanism {
        Mechanism::LossOfTension => (Colour::Blue, Dash::Solid),
        Mechanism::LimitPoint => (Colour::Vermilion, Dash::Solid),
        Mechanism::PullIn => (Colour::Purple, Dash::Dashed),
        Mechanism::Breakdown => (Colour::Orange, Dash::Dashed),
        Mechanism::Rupture => (Colour::Green, Dash::DashDot),
        Mechanism::AmplifierVoltage => (Colour::Ink, Dash::Dotted),
        Mechanism::AmplifierCurrent | Mechanism::AmplifierSlew => (Colour::Grey, Dash::Dotted),
    }
}

/// Voltages at which each mechanism sets in, over the dead load.
pub(super) fn failure(map: &FailureMap, criteria: &FailureCriteria, state: &StateMargins) -> Figure {
    let found = map.curves.iter().flat_map(|curve| curve.voltage_v.iter().flatten());
    let highest_kv = found.fold(state.voltage_v, |a, &b| a.max(b)).max(1.0) * 1e-3;
    let voltage = Axis::linear("voltage, kV").range(0.0, HEADROOM * highest_kv);
    let mut panel = Panel::new(Axis::linear("dead load, N"), voltage);
    for curve in &map.curves {
        let (colour, dash) = style(curve.mechanism);
        let mut name = curve.mechanism.words().to_owned();
        if curve.mechanism == Mechanism::Breakdown {
            name.push_str(&format!(" ({})", criteria.breakdown().name()));
        }
        if curve.unverified {
            name.push_str(", unverified");
        }
        let voltage = curve.voltage_v.iter().map(|v| v.map_or(f64::NAN, |v| v * 1e-3)).collect();
        panel = panel.series(Series::dashed(name, map.force_n.clone(), voltage, colour, dash));
    }
    panel = panel.series(Series::points(
        "state of the case",
        vec![state.force_n],
        vec![state.voltage_v * 1e-3],
        Colour::Ink,
        Marker::Disk,
    ));
    Figure::new("failure-map", "What ends the membrane, over dead load and voltage")
        .caption("Below the lowest curve a state is taut, stable and whole. A curve ends where its mechanism comes after the limit point.")
        .panel(panel)
}
