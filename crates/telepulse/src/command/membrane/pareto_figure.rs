//! The drawing of a design study: all variants, what ended them, and the front.

use crate::figure::{Axis, Colour, Figure, Marker, Panel, Series};

/// A variant in the drawing.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shown {
    pub(super) stroke_mm: f64,
    pub(super) bandwidth_hz: f64,
    pub(super) ended_by: &'static str,
}

/// What can end a stroke, how it reads, and how it is drawn.
const ENDS: [(&str, &str, Colour, Marker); 5] = [
    ("amplifier", "ended by the amplifier", Colour::Grey, Marker::Circle),
    ("field", "ended by the field", Colour::Sky, Marker::Square),
    ("loss_of_tension", "ended by loss of tension", Colour::Orange, Marker::Diamond),
    ("instability", "ended by instability", Colour::Purple, Marker::Circle),
    ("chain_limit", "ended by the chain limit", Colour::Green, Marker::Square),
];

/// Stroke against bandwidth with the Pareto front on top.
pub(super) fn pareto_figure(all: &[Shown], front: &[Shown], base: Option<Shown>) -> Figure {
    let columns = |shown: &[Shown]| -> (Vec<f64>, Vec<f64>) {
        shown.iter().map(|one| (one.stroke_mm, one.bandwidth_hz)).unzip()
    };
    let mut panel = Panel::new(Axis::linear("stroke, mm"), Axis::linear("bandwidth, Hz")).note(format!(
        "{} variants that keep every margin, {} of them on the front",
        all.len(),
        front.len()
    ));
    for (end, name, colour, marker) in ENDS {
        let own: Vec<Shown> = all.iter().copied().filter(|one| one.ended_by == end).collect();
        if !own.is_empty() {
            let (x, y) = columns(&own);
            panel = panel.series(Series::points(name, x, y, colour, marker));
        }
    }
    let (x, y) = columns(front);
    panel = panel.series(Series::line("Pareto front", x, y, Colour::Blue));
    if let Some(base) = base {
        let (x, y) = columns(&[base]);
        panel = panel.series(Series::points("base", x, y, Colour::Vermilion, Marker::Diamond));
    }
    Figure::new("pareto", "Stroke and bandwidth without failure")
        .caption("Every variant at the largest voltage that keeps its margins to failure; no variant beats the front in both.")
        .panel(panel)
}
