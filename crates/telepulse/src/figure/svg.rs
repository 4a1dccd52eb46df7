//! A figure as a static SVG drawing for print.
//!
//! Written by hand rather than with a plotting crate, so that ranges, ticks, colours, dashes and the legend
//! are those of the interactive plot, and the program's build does not grow.

use std::fmt::Write as _;

use super::decimate::{Points, decimate};
use super::text::{escape, width_px, wrap};
use super::ticks::{PanelRange, Tick, ticks};
use super::{Axis, Figure, Marker, Panel, Scale, Series, Stacking, Style};

/// The figure as a complete SVG document, 760 pixels wide, on a white ground.
///
/// **Shapes and units**: the height follows from the number of panels and legend rows. The caption is the
/// description for screen readers; it is not drawn.
///
/// **Accuracy**: a series of more than 2000 samples is thinned to its envelope (see [`decimate`]);
/// coordinates are rounded to 0.01 pixel.
pub fn render(figure: &Figure) -> String {
    let legend = legend_rows(figure);
    let left = left_margin(figure);
    let mut body = String::new();
    let mut top = MARGIN;
    for line in wrap(&figure.title, TITLE_PX, WIDTH - 2.0 * MARGIN) {
        top += TITLE_PX + 3.0;
        text(&mut body, WIDTH / 2.0, top, "middle", TITLE_PX, "font-weight=\"600\"", &line);
    }
    let ranges = figure.ranges();
    for (idx, (panel, range)) in figure.panels.iter().zip(&ranges).enumerate() {
        let is_last = idx + 1 == figure.panels.len();
        let shows_x = is_last || figure.stacking == Stacking::Independent;
        top = panel_heading(&mut body, panel, left, top + 8.0);
        let frame = Frame {
            left,
            right: WIDTH - RIGHT_MARGIN,
            top,
            bottom: top + panel_height(figure),
            range: *range,
            log_x: panel.x.scale == Scale::Log,
            log_y: panel.y.scale == Scale::Log,
        };
        let clip = format!("{}-clip-{idx}", figure.id());
        draw_panel(&mut body, panel, &frame, &clip, shows_x);
        top = frame.bottom + if shows_x { X_AXIS_PX } else { 4.0 };
    }
    let height = top + draw_legend(&mut body, &legend, top) + MARGIN;
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{height:.0}\" viewBox=\"0 0 {WIDTH} {height:.0}\" \
         role=\"img\" font-family=\"Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif\" fill=\"#1a1a1a\">\n\
         <title>{}</title>\n<desc>{}</desc>\n<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n{body}</svg>\n",
        escape(&figure.title),
        escape(&figure.caption),
    )
}

/// The pixel frame of a panel and its data range.
struct Frame {
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
    range: PanelRange,
    log_x: bool,
    log_y: bool,
}

impl Frame {
    fn x_px(&self, x: f64) -> f64 {
        self.left + fraction(x, self.range.x, self.log_x) * (self.right - self.left)
    }

    fn y_px(&self, y: f64) -> f64 {
        self.bottom - fraction(y, self.range.y, self.log_y) * (self.bottom - self.top)
    }

    /// Pixel position, or `None` where the sample cannot be drawn. Far outliers are brought near the frame,
    /// which clips them.
    fn place(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        let drawable = x.is_finite() && y.is_finite() && (x > 0.0 || !self.log_x) && (y > 0.0 || !self.log_y);
        let near = |px: f64| px.clamp(-1e5, 1e5);
        drawable.then(|| (near(self.x_px(x)), near(self.y_px(y))))
    }
}

/// Where a value lies in a range: 0 at the low end, 1 at the high end.
fn fraction(value: f64, (low, high): (f64, f64), log: bool) -> f64 {
    if log { (value / low).ln() / (high / low).ln() } else { (value - low) / (high - low) }
}

fn panel_height(figure: &Figure) -> f64 {
    if figure.panels.len() > 1 { 190.0 } else { 320.0 }
}

/// Heading and notes of a panel; returns the top of its frame.
fn panel_heading(body: &mut String, panel: &Panel, left: f64, mut top: f64) -> f64 {
    let room = WIDTH - RIGHT_MARGIN - left;
    for line in wrap(&panel.title, LABEL_PX, room) {
        top += LABEL_PX + 2.0;
        text(body, left, top, "start", LABEL_PX, "font-weight=\"600\"", &line);
    }
    for line in panel.notes.iter().flat_map(|note| wrap(note, TICK_PX, room)) {
        top += TICK_PX + 3.0;
        text(body, left, top, "start", TICK_PX, "fill=\"#555555\"", &line);
    }
    top + 8.0
}

fn draw_panel(body: &mut String, panel: &Panel, frame: &Frame, clip: &str, shows_x: bool) {
    let Frame { left, right, top, bottom, .. } = *frame;
    let (width, height) = (right - left, bottom - top);
    let _ = writeln!(
        body,
        "<clipPath id=\"{clip}\"><rect x=\"{left:.2}\" y=\"{top:.2}\" width=\"{width:.2}\" height=\"{height:.2}\"/></clipPath>"
    );
    draw_x_axis(body, frame, &x_ticks(panel, frame), shows_x.then_some(&panel.x.label));
    draw_y_axis(body, frame, &y_ticks(&panel.y, frame.range.y, height), &panel.y.label);
    let _ = writeln!(body, "<g clip-path=\"url(#{clip})\">");
    for series in &panel.series {
        draw_series(body, series, frame);
    }
    let _ = writeln!(
        body,
        "</g>\n<rect x=\"{left:.2}\" y=\"{top:.2}\" width=\"{width:.2}\" height=\"{height:.2}\" fill=\"none\" stroke=\"#444444\"/>"
    );
}

fn x_ticks(panel: &Panel, frame: &Frame) -> Vec<Tick> {
    ticks(&panel.x, frame.range.x, 8)
}

fn y_ticks(axis: &Axis, range: (f64, f64), height: f64) -> Vec<Tick> {
    ticks(axis, range, if height < 250.0 { 5 } else { 7 })
}

fn draw_x_axis(body: &mut String, frame: &Frame, ticks: &[Tick], label: Option<&String>) {
    let mut free_from = f64::NEG_INFINITY;
    for tick in ticks {
        let x = frame.x_px(tick.value);
        grid_line(body, (x, frame.top), (x, frame.bottom), tick.label.is_empty());
        let half = width_px(&tick.label, TICK_PX) / 2.0;
        if label.is_some() && !tick.label.is_empty() && x - half > free_from {
            text(body, x, frame.bottom + 16.0, "middle", TICK_PX, "", &tick.label);
            free_from = x + half + 6.0;
        }
    }
    if let Some(label) = label {
        let middle = (frame.left + frame.right) / 2.0;
        text(body, middle, frame.bottom + 36.0, "middle", LABEL_PX, "", label);
    }
}

fn draw_y_axis(body: &mut String, frame: &Frame, ticks: &[Tick], label: &str) {
    let mut free_below = f64::INFINITY;
    for tick in ticks {
        let y = frame.y_px(tick.value);
        grid_line(body, (frame.left, y), (frame.right, y), tick.label.is_empty());
        if !tick.label.is_empty() && y < free_below {
            text(body, frame.left - 7.0, y + 4.0, "end", TICK_PX, "", &tick.label);
            free_below = y - TICK_PX;
        }
    }
    // A long label breaks into lines along the axis, so that it is never cut.
    let lines = wrap(label, LABEL_PX, frame.bottom - frame.top + 20.0);
    let middle = (frame.top + frame.bottom) / 2.0;
    for (idx, line) in lines.iter().enumerate() {
        let x = MARGIN + LABEL_PX + idx as f64 * (LABEL_PX + 2.0);
        let turn = format!("transform=\"rotate(-90 {x:.2} {middle:.2})\"");
        text(body, x, middle, "middle", LABEL_PX, &turn, line);
    }
}

fn grid_line(body: &mut String, from: (f64, f64), to: (f64, f64), is_minor: bool) {
    let stroke = if is_minor { "#eeeeee" } else { "#d4d4d4" };
    let _ = writeln!(
        body,
        "<path d=\"M{:.2} {:.2}L{:.2} {:.2}\" stroke=\"{stroke}\"/>",
        from.0, from.1, to.0, to.1
    );
}

fn draw_series(body: &mut String, series: &Series, frame: &Frame) {
    let points = decimate(series.x(), series.y(), MAX_POINTS);
    match series.style {
        Style::Line { width, .. } => {
            let path = line_path(&points, frame);
            let _ = writeln!(
                body,
                "<path d=\"{path}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{width}\" stroke-linejoin=\"round\"{}/>",
                series.colour.hex(),
                dash_attribute(&series.style)
            );
        }
        Style::Points { marker } => draw_markers(body, &points, frame, marker, series),
        Style::Stems => {
            let foot = if frame.log_y { frame.bottom } else { frame.y_px(0.0) };
            let mut path = String::new();
            for (x, y) in placed(&points, frame).flatten() {
                let _ = write!(path, "M{x:.2} {foot:.2}L{x:.2} {y:.2}");
            }
            let _ = writeln!(
                body,
                "<path d=\"{path}\" stroke=\"{}\" stroke-width=\"1.4\"/>",
                series.colour.hex()
            );
            draw_markers(body, &points, frame, Marker::Disk, series);
        }
    }
}

fn placed<'a>(points: &'a Points, frame: &'a Frame) -> impl Iterator<Item = Option<(f64, f64)>> + 'a {
    points.x.iter().zip(&points.y).map(|(&x, &y)| frame.place(x, y))
}

fn line_path(points: &Points, frame: &Frame) -> String {
    let mut path = String::new();
    let mut pen_is_down = false;
    for place in placed(points, frame) {
        if let Some((x, y)) = place {
            let _ = write!(path, "{}{x:.2} {y:.2}", if pen_is_down { 'L' } else { 'M' });
        }
        pen_is_down = place.is_some();
    }
    path
}

fn draw_markers(body: &mut String, points: &Points, frame: &Frame, marker: Marker, series: &Series) {
    for (x, y) in placed(points, frame).flatten() {
        draw_marker(body, x, y, marker, series);
    }
}

fn draw_marker(body: &mut String, x: f64, y: f64, marker: Marker, series: &Series) {
    let colour = series.colour.hex();
    let paint = if marker.is_open() {
        format!("fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.4\"")
    } else {
        format!("fill=\"{colour}\"")
    };
    let _ =
        writeln!(body, "<path transform=\"translate({x:.2} {y:.2})\" d=\"{}\" {paint}/>", marker.svg_path());
}

fn dash_attribute(style: &Style) -> String {
    match style {
        Style::Line { dash, .. } => dash.lengths_px().map_or_else(String::new, |lengths| {
            format!(" stroke-dasharray=\"{}\"", lengths.replace("px", ""))
        }),
        Style::Points { .. } | Style::Stems => String::new(),
    }
}

/// Width of the margin that holds the widest tick label and the lines of the axis label.
fn left_margin(figure: &Figure) -> f64 {
    let height = panel_height(figure);
    let ranges = figure.ranges();
    let panels = figure.panels.iter().zip(&ranges);
    let widest = panels
        .map(|(panel, range)| {
            let labels = y_ticks(&panel.y, range.y, height);
            let tick = labels.iter().map(|t| width_px(&t.label, TICK_PX)).fold(0.0, f64::max);
            let lines = wrap(&panel.y.label, LABEL_PX, height + 20.0).len() as f64;
            tick + lines * (LABEL_PX + 2.0)
        })
        .fold(0.0, f64::max);
    MARGIN + widest + 20.0
}

/// Legend entries in rows that fit the width.
fn legend_rows(figure: &Figure) -> Vec<Vec<&Series>> {
    let mut rows: Vec<Vec<&Series>> = Vec::new();
    let mut used = f64::INFINITY;
    for entry in figure.legend() {
        let width = entry_width(entry);
        if used + width > WIDTH - 2.0 * MARGIN {
            rows.push(Vec::new());
            used = 0.0;
        }
        used += width;
        if let Some(row) = rows.last_mut() {
            row.push(entry);
        }
    }
    rows
}

/// Number of legend rows in the static drawing; the interactive plot reserves as many.
pub(super) fn legend_row_count(figure: &Figure) -> usize {
    legend_rows(figure).len()
}

fn entry_width(entry: &Series) -> f64 {
    KEY_PX + 6.0 + width_px(&entry.name, TICK_PX) + 18.0
}

/// Draws the legend below `top`; returns its height.
fn draw_legend(body: &mut String, rows: &[Vec<&Series>], top: f64) -> f64 {
    for (idx, row) in rows.iter().enumerate() {
        let row_width: f64 = row.iter().map(|entry| entry_width(entry)).sum();
        let mut x = ((WIDTH - row_width) / 2.0).max(MARGIN);
        let y = top + (idx as f64 + 0.6) * ROW_PX;
        for entry in row {
            draw_key(body, entry, x, y);
            text(body, x + KEY_PX + 6.0, y + 4.0, "start", TICK_PX, "", &entry.name);
            x += entry_width(entry);
        }
    }
    rows.len() as f64 * ROW_PX
}

fn draw_key(body: &mut String, entry: &Series, x: f64, y: f64) {
    let middle = x + KEY_PX / 2.0;
    match entry.style {
        Style::Line { width, .. } => {
            let _ = writeln!(
                body,
                "<path d=\"M{x:.2} {y:.2}h{KEY_PX}\" stroke=\"{}\" stroke-width=\"{}\"{}/>",
                entry.colour.hex(),
                width.max(1.6),
                dash_attribute(&entry.style)
            );
        }
        Style::Points { marker } => draw_marker(body, middle, y, marker, entry),
        Style::Stems => {
            let _ = writeln!(
                body,
                "<path d=\"M{middle:.2} {:.2}V{y:.2}\" stroke=\"{}\"/>",
                y + 8.0,
                entry.colour.hex()
            );
            draw_marker(body, middle, y, Marker::Disk, entry);
        }
    }
}

fn text(body: &mut String, x: f64, y: f64, anchor: &str, size_px: f64, attributes: &str, content: &str) {
    let _ = writeln!(
        body,
        "<text x=\"{x:.2}\" y=\"{y:.2}\" text-anchor=\"{anchor}\" font-size=\"{size_px}\" {attributes}>{}</text>",
        escape(content)
    );
}

/// All lengths are CSS pixels; 760 of them are 20.1 cm at 96 pixels per inch, the text width of an A4 page.
const WIDTH: f64 = 760.0;
const MARGIN: f64 = 10.0;
const RIGHT_MARGIN: f64 = 22.0;
const X_AXIS_PX: f64 = 46.0;
const ROW_PX: f64 = 20.0;
const KEY_PX: f64 = 28.0;
const TITLE_PX: f64 = 15.0;
const LABEL_PX: f64 = 13.0;
const TICK_PX: f64 = 12.0;
const MAX_POINTS: usize = 2000;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::{Colour, demo};

    #[test]
    fn law_every_open_element_is_closed() {
        for figure in demo::all() {
            let svg = render(&figure);
            for name in ["svg", "g", "text", "clipPath", "title", "desc"] {
                let opened =
                    svg.matches(&format!("<{name} ")).count() + svg.matches(&format!("<{name}>")).count();
                assert_eq!(opened, svg.matches(&format!("</{name}>")).count(), "{name} in {}", figure.id());
            }
            assert!(!svg.contains("NaN") && !svg.contains("inf\""), "{}", figure.id());
        }
    }

    #[test]
    fn law_long_series_give_small_files() {
        assert!(render(&demo::time_series()).len() < 150_000);
    }

    #[test]
    fn edge_hostile_text_is_escaped() {
        let figure = Figure::new("x", "<script>alert(1)</script>").panel(
            Panel::new(Axis::linear("a & b"), Axis::linear("\"y\"")).series(Series::line(
                "<i>",
                vec![0.0, 1.0],
                vec![f64::NAN, 2.0],
                Colour::Blue,
            )),
        );
        let svg = render(&figure);
        assert!(!svg.contains("<script") && !svg.contains("<i>"));
        assert!(svg.contains("a &amp; b"));
    }

    #[test]
    fn edge_a_figure_without_data_is_drawn() {
        let empty = Figure::new("empty", "").panel(Panel::new(Axis::log("x"), Axis::linear("y")));
        assert!(render(&empty).ends_with("</svg>\n"));
    }
}
