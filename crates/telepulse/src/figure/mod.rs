//! One description of a figure, two renderers.
//!
//! A [`Figure`] says *what* is shown: panels, axes with units, series. [`plotly`] turns it into an
//! interactive plot for the report page, [`svg`] into a drawing for print. Both take colours, dashes,
//! markers, ranges and tick values from here, so that the two pictures of one result cannot disagree.
//! [`html`] is the self-contained page around them.
//!
//! Absent here: files, numerics beyond ranges and ticks, and any knowledge of what the curves mean.

pub mod decimate;
pub mod html;
pub mod palette;
pub mod plotly;
pub mod stored;
pub mod svg;
pub mod text;
pub mod ticks;

use serde::{Deserialize, Serialize};

pub use html::{Cell, ReportPage, Status, Table};
pub use palette::{Colour, Dash, Marker};

/// A figure: one or more panels stacked from top to bottom.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "stored::StoredFigure")]
pub struct Figure {
    id: String,
    /// Heading of the figure, plain text.
    pub title: String,
    /// What the reader should see in it, plain text.
    pub caption: String,
    /// Panels from top to bottom.
    pub panels: Vec<Panel>,
    /// Whether the panels have one x axis in common.
    pub stacking: Stacking,
}

/// How stacked panels treat their x axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Stacking {
    /// Each panel has its own x axis.
    Independent,
    /// All panels show the same x range, labelled once at the bottom, as in a Bode diagram.
    SharedX,
}

/// One coordinate system with its series.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Panel {
    /// Heading of the panel; may be empty.
    pub title: String,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// Curves and point clouds, drawn in this order.
    pub series: Vec<Series>,
    /// Short remarks shown under the panel's heading.
    pub notes: Vec<String>,
}

/// An axis: label with unit, scale, range.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "stored::StoredAxis")]
pub struct Axis {
    /// Quantity and unit, such as `displacement, mm`.
    pub label: String,
    /// Linear or logarithmic.
    pub scale: Scale,
    /// Lower and upper end in data units; `None` fits the data.
    pub range: Option<(f64, f64)>,
    /// Ticks fall on 1, 2, 4, 8 ... times this value (45 for degrees); `None` takes 1, 2, 5 times a power of
    /// ten.
    pub tick_unit: Option<f64>,
}

/// How an axis maps values to lengths.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Scale {
    /// Equal differences are equal lengths.
    Linear,
    /// Equal ratios are equal lengths. Values that are not positive are left out.
    Log,
}

/// One named curve or point cloud.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "stored::StoredSeries")]
pub struct Series {
    /// Name in the legend; series of equal name, colour and style share one entry.
    pub name: String,
    x: Vec<f64>,
    y: Vec<f64>,
    /// Line, points or stems.
    pub style: Style,
    /// Colour slot.
    pub colour: Colour,
}

/// How the samples of a series are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Style {
    /// A line through the samples; a value that is not finite breaks it.
    Line {
        /// Stroke width in CSS pixels.
        width: f64,
        /// Dash pattern.
        dash: Dash,
    },
    /// One marker per sample.
    Points {
        /// Marker shape.
        marker: Marker,
    },
    /// One marker per sample on a stem from the foot of the panel (from zero on a linear axis).
    Stems,
}

impl Figure {
    /// An empty figure.
    ///
    /// **Panics** if `id` is not made of lower-case ASCII letters, digits, `-` and `_`: it becomes an element
    /// id and a file name.
    pub fn new(id: &str, title: impl Into<String>) -> Self {
        assert!(stored::is_safe_id(id), "figure id `{id}` must consist of a-z, 0-9, - and _");
        Self {
            id: id.to_owned(),
            title: title.into(),
            caption: String::new(),
            panels: Vec::new(),
            stacking: Stacking::Independent,
        }
    }

    /// The identifier: element id in the page and stem of the file name.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// The figure with this caption.
    pub fn caption(mut self, caption: impl Into<String>) -> Self {
        self.caption = caption.into();
        self
    }

    /// The figure with one more panel at the bottom.
    pub fn panel(mut self, panel: Panel) -> Self {
        self.panels.push(panel);
        self
    }

    /// The figure with one x axis for all panels.
    pub fn shared_x(mut self) -> Self {
        self.stacking = Stacking::SharedX;
        self
    }

    /// The distinct legend entries in the order of their first appearance.
    pub(crate) fn legend(&self) -> Vec<&Series> {
        let mut entries: Vec<&Series> = Vec::new();
        for series in self.panels.iter().flat_map(|panel| &panel.series) {
            if !series.name.is_empty() && !entries.iter().any(|e| e.same_entry(series)) {
                entries.push(series);
            }
        }
        entries
    }

    /// The x and y range of every panel, in panel order, with shared x ranges merged.
    pub(crate) fn ranges(&self) -> Vec<ticks::PanelRange> {
        let mut ranges: Vec<_> = self.panels.iter().map(ticks::panel_range).collect();
        if self.stacking == Stacking::SharedX {
            let low = ranges.iter().map(|r| r.x.0).fold(f64::INFINITY, f64::min);
            let high = ranges.iter().map(|r| r.x.1).fold(f64::NEG_INFINITY, f64::max);
            for range in &mut ranges {
                range.x = (low, high);
            }
        }
        ranges
    }
}

impl Panel {
    /// An empty panel with these axes and no heading.
    pub fn new(x: Axis, y: Axis) -> Self {
        Self { title: String::new(), x, y, series: Vec::new(), notes: Vec::new() }
    }

    /// The panel with this heading.
    pub fn title(mut self, title: impl Into<String>) -> Self {
        self.title = title.into();
        self
    }

    /// The panel with one more series on top.
    pub fn series(mut self, series: Series) -> Self {
        self.series.push(series);
        self
    }

    /// The panel with one more remark.
    pub fn note(mut self, note: impl Into<String>) -> Self {
        self.notes.push(note.into());
        self
    }
}

impl Axis {
    /// A linear axis that fits its data.
    pub fn linear(label: impl Into<String>) -> Self {
        Self { label: label.into(), scale: Scale::Linear, range: None, tick_unit: None }
    }

    /// A logarithmic axis that fits its data.
    pub fn log(label: impl Into<String>) -> Self {
        Self { scale: Scale::Log, ..Self::linear(label) }
    }

    /// A linear axis for angles in degrees, with ticks at multiples of 45.
    pub fn degrees(label: impl Into<String>) -> Self {
        Self { tick_unit: Some(45.0), ..Self::linear(label) }
    }

    /// The axis with a fixed range.
    ///
    /// **Panics** unless `low < high`, both finite, and `low > 0` on a logarithmic axis.
    pub fn range(mut self, low: f64, high: f64) -> Self {
        assert!(stored::is_range(self.scale, (low, high)), "an axis cannot show the range {low}..{high}");
        self.range = Some((low, high));
        self
    }
}

impl Series {
    /// A series with this style.
    ///
    /// **Panics** if `x` and `y` differ in length.
    pub fn new(name: impl Into<String>, x: Vec<f64>, y: Vec<f64>, style: Style, colour: Colour) -> Self {
        assert_eq!(x.len(), y.len(), "a series needs as many x as y values");
        Self { name: name.into(), x, y, style, colour }
    }

    /// A solid line, 1.6 pixels wide.
    pub fn line(name: impl Into<String>, x: Vec<f64>, y: Vec<f64>, colour: Colour) -> Self {
        let style = Style::Line { width: 1.6, dash: Dash::Solid };
        Self::new(name, x, y, style, colour)
    }

    /// A broken line, 1.6 pixels wide.
    pub fn dashed(name: impl Into<String>, x: Vec<f64>, y: Vec<f64>, colour: Colour, dash: Dash) -> Self {
        Self::new(name, x, y, Style::Line { width: 1.6, dash }, colour)
    }

    /// One marker per sample.
    pub fn points(name: impl Into<String>, x: Vec<f64>, y: Vec<f64>, colour: Colour, marker: Marker) -> Self {
        Self::new(name, x, y, Style::Points { marker }, colour)
    }

    /// One stem per sample, as for a line spectrum.
    pub fn stems(name: impl Into<String>, x: Vec<f64>, y: Vec<f64>, colour: Colour) -> Self {
        Self::new(name, x, y, Style::Stems, colour)
    }

    /// A dashed horizontal line at `y` from `x_low` to `x_high`, for a limit or a target.
    pub fn level(name: impl Into<String>, x_low: f64, x_high: f64, y: f64, colour: Colour) -> Self {
        Self::dashed(name, vec![x_low, x_high], vec![y, y], colour, Dash::Dashed)
    }

    /// Horizontal values.
    pub fn x(&self) -> &[f64] {
        &self.x
    }

    /// Vertical values, as many as horizontal ones.
    pub fn y(&self) -> &[f64] {
        &self.y
    }

    pub(crate) fn same_entry(&self, other: &Self) -> bool {
        self.name == other.name && self.colour == other.colour && self.style == other.style
    }
}

#[cfg(test)]
pub(crate) mod demo;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edge_series_of_unequal_lengths_are_refused() {
        let made = std::panic::catch_unwind(|| Series::line("a", vec![0.0, 1.0], vec![0.0], Colour::Blue));
        assert!(made.is_err());
    }

    #[test]
    fn edge_an_id_that_could_leave_its_folder_is_refused() {
        for id in ["", "../x", "a b", "Fig", "a\"b"] {
            assert!(std::panic::catch_unwind(|| Figure::new(id, "t")).is_err(), "{id}");
        }
    }

    #[test]
    fn law_equal_series_share_one_legend_entry() {
        let entries = demo::bode();
        let names: Vec<_> = entries.legend().iter().map(|s| s.name.clone()).collect();
        let mut unique = names.clone();
        unique.dedup();
        assert_eq!(names, unique);
        assert_eq!(names.len(), 4);
    }

    #[test]
    fn law_shared_x_panels_have_one_range() {
        let ranges = demo::bode().ranges();
        assert_eq!(ranges.len(), 2);
        assert_eq!(ranges[0].x, ranges[1].x);
    }
}
