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

/// The front with its inner corners: what lies under it is reached by a variant, what lies between two members need not be.
fn staircase(front: &[Shown]) -> Vec<Shown> {
    let mut stairs = Vec::with_capacity(2 * front.len());
    for (idx, &member) in front.iter().enumerate() {
        if idx > 0 {
            stairs.push(Shown { stroke_mm: front[idx - 1].stroke_mm, ..member });
        }
        stairs.push(member);
    }
    stairs
}

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
    let (x, y) = columns(&staircase(front));
    panel = panel.series(Series::line("Pareto front", x, y, Colour::Blue));
    if let Some(base) = base {
        let (x, y) = columns(&[base]);
        panel = panel.series(Series::points("base", x, y, Colour::Vermilion, Marker::Diamond));
    }
    Figure::new("pareto", "Stroke and bandwidth without failure")
        .caption("Every variant at the largest voltage that keeps its margins to failure; no variant beats the front in both.")
        .panel(panel)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(stroke_mm: f64, bandwidth_hz: f64) -> Shown {
        Shown { stroke_mm, bandwidth_hz, ended_by: "field" }
    }

    #[test]
    fn law_stairs_claim_nothing_that_no_variant_reaches() {
        let front = [at(1.0, 9.0), at(2.0, 7.0), at(4.0, 3.0)];
        let corners: Vec<(f64, f64)> =
            staircase(&front).iter().map(|one| (one.stroke_mm, one.bandwidth_hz)).collect();
        assert_eq!(corners, [(1.0, 9.0), (1.0, 7.0), (2.0, 7.0), (2.0, 3.0), (4.0, 3.0)]);
        for (stroke, bandwidth) in corners {
            assert!(front.iter().any(|one| one.stroke_mm >= stroke && one.bandwidth_hz >= bandwidth));
        }
        assert!(staircase(&[]).is_empty());
    }

    #[test]
    fn law_every_end_of_a_stroke_has_its_marks() {
        use telepulse_actuator::design_study::EndOfStroke;
        let all = [
            EndOfStroke::Amplifier,
            EndOfStroke::Field,
            EndOfStroke::LossOfTension,
            EndOfStroke::Instability,
            EndOfStroke::ChainLimit,
        ];
        assert_eq!(all.map(EndOfStroke::name), ENDS.map(|(end, ..)| end));
    }
}
