//! A figure as an interactive plot in the report page.

use serde_json::{Value, json};

use super::decimate::decimate;
use super::text::{escape, wrap};
use super::ticks::{PanelRange, ticks};
use super::{Axis, Figure, Marker, Panel, Scale, Series, Stacking, Style, svg};

/// The script element that a page needs once in its head: plotly.js, embedded, 4.6 MB.
///
/// **Method**: the `plotly` crate carries the script; its second element (MathJax, 2.1 MB) is left out, since
/// no label here uses TeX.
pub fn head_script() -> String {
    let sources = plotly::Plot::offline_js_sources();
    let end = "</script>";
    match sources.find(end) {
        Some(at) => sources[..at + end.len()].to_owned(),
        None => sources,
    }
}

/// The element and the inline script that show one figure; the page needs [`head_script`] before it.
///
/// **Accuracy**: a series of more than 4000 samples is thinned to its envelope (see [`decimate`]), and values
/// are rounded to 8 significant digits, so that a report stays small.
pub fn fragment(figure: &Figure) -> String {
    let id = format!("plot-{}", figure.id());
    let layout = Layout::of(figure);
    format!(
        "<div id=\"{id}\" class=\"plot\" style=\"height:{:.0}px\"></div>\n\
         <script>Plotly.newPlot(\"{id}\",{},{},{});</script>\n",
        layout.height_px,
        script_safe(&Value::Array(traces(figure))),
        script_safe(&layout.to_json(figure)),
        script_safe(&json!({
            "responsive": true,
            "displaylogo": false,
            "modeBarButtonsToRemove": ["select2d", "lasso2d"],
            "toImageButtonOptions": {"format": "svg", "filename": figure.id()},
        })),
    )
}

/// JSON that cannot end the script element around it.
fn script_safe(value: &Value) -> String {
    value.to_string().replace('<', "\\u003c").replace('\u{2028}', "\\u2028").replace('\u{2029}', "\\u2029")
}

fn traces(figure: &Figure) -> Vec<Value> {
    let entries = figure.legend();
    let mut is_listed = vec![false; entries.len()];
    let ranges = figure.ranges();
    let mut traces = Vec::new();
    for (idx, (panel, range)) in figure.panels.iter().zip(&ranges).enumerate() {
        for series in &panel.series {
            let mut trace = trace(series, panel, range);
            trace["xaxis"] = json!(axis_name("x", idx));
            trace["yaxis"] = json!(axis_name("y", idx));
            let entry = entries.iter().position(|e| e.same_entry(series));
            trace["showlegend"] = json!(entry.is_some_and(|at| !std::mem::replace(&mut is_listed[at], true)));
            if let Some(at) = entry {
                trace["legendgroup"] = json!(format!("entry {at}"));
            }
            traces.push(trace);
        }
    }
    traces
}

fn trace(series: &Series, panel: &Panel, range: &PanelRange) -> Value {
    let points = decimate(series.x(), series.y(), MAX_POINTS);
    let colour = series.colour.hex();
    let mut trace = json!({
        "type": "scatter",
        "name": escape(&series.name),
        "x": numbers(&points.x, panel.x.scale),
        "y": numbers(&points.y, panel.y.scale),
    });
    match series.style {
        Style::Line { width, dash } => {
            trace["mode"] = json!("lines");
            trace["line"] =
                json!({"color": colour, "width": width, "dash": dash.lengths_px().unwrap_or("solid")});
        }
        Style::Points { marker } => {
            trace["mode"] = json!("markers");
            trace["marker"] = marker_json(marker, colour);
        }
        Style::Stems => {
            let foot = if panel.y.scale == Scale::Log { range.y.0 } else { 0.0 };
            let stems: Vec<f64> = points.y.iter().map(|y| y - foot).collect();
            trace["mode"] = json!("markers");
            trace["marker"] = marker_json(Marker::Disk, colour);
            trace["error_y"] = json!({
                "type": "data", "symmetric": false, "array": vec![0.0; stems.len()],
                "arrayminus": numbers(&stems, Scale::Linear), "width": 0, "thickness": 1.4, "color": colour,
            });
        }
    }
    trace
}

fn marker_json(marker: Marker, colour: &str) -> Value {
    let outline_px = if marker.is_open() { 1.4 } else { 0.0 };
    json!({
        "symbol": marker.plotly_symbol(), "color": colour, "size": marker.size_px(),
        "line": {"width": outline_px, "color": colour},
    })
}

/// Values with 8 significant digits; what cannot be drawn becomes null, which plotly shows as a gap.
fn numbers(values: &[f64], scale: Scale) -> Vec<Value> {
    values
        .iter()
        .map(|&value| {
            let drawable = value.is_finite() && (scale == Scale::Linear || value > 0.0);
            let rounded = format!("{value:.7e}").parse::<f64>().ok().filter(|_| drawable);
            rounded.map_or(Value::Null, Value::from)
        })
        .collect()
}

fn axis_name(letter: &str, panel_idx: usize) -> String {
    if panel_idx == 0 { letter.to_owned() } else { format!("{letter}{}", panel_idx + 1) }
}

/// Vertical arrangement in pixels.
struct Layout {
    height_px: f64,
    /// Height of panels and gaps together: the unit of plotly's `paper` coordinates.
    plot_px: f64,
    top_px: f64,
    bottom_px: f64,
    /// Bottom and top of each panel in `paper` coordinates.
    domains: Vec<(f64, f64)>,
}

impl Layout {
    fn of(figure: &Figure) -> Self {
        let n_panels = figure.panels.len().max(1);
        let panel_px = if n_panels > 1 { 210.0 } else { 340.0 };
        let headings: Vec<f64> =
            figure.panels.iter().map(|p| heading_lines(p).len() as f64 * LINE_PX).collect();
        let axis_px = if figure.stacking == Stacking::SharedX { 14.0 } else { 58.0 };
        let gaps: f64 = headings.iter().skip(1).map(|heading| heading + axis_px).sum();
        let plot_px = n_panels as f64 * panel_px + gaps;
        let mut top = plot_px;
        let mut domains = Vec::new();
        for (idx, heading) in headings.iter().enumerate() {
            if idx > 0 {
                top -= heading + axis_px;
            }
            domains.push(((top - panel_px) / plot_px, top / plot_px));
            top -= panel_px;
        }
        let top_px = 34.0 + headings.first().copied().unwrap_or(0.0);
        let bottom_px = AXIS_PX + 24.0 * svg::legend_row_count(figure) as f64 + 8.0;
        Self { height_px: top_px + plot_px + bottom_px, plot_px, top_px, bottom_px, domains }
    }

    fn to_json(&self, figure: &Figure) -> Value {
        let mut layout = json!({
            "height": self.height_px,
            "margin": {"l": 84, "r": 24, "t": self.top_px, "b": self.bottom_px},
            "paper_bgcolor": "#ffffff",
            "plot_bgcolor": "#ffffff",
            "font": {"family": "Helvetica, Arial, sans-serif", "size": 13, "color": "#1a1a1a"},
            "hovermode": "closest",
            "legend": {
                "orientation": "h", "x": 0.5, "xanchor": "center", "y": -AXIS_PX / self.plot_px, "yanchor": "top",
                "font": {"size": 12},
            },
        });
        let mut annotations = Vec::new();
        let ranges = figure.ranges();
        for (idx, (panel, range)) in figure.panels.iter().zip(&ranges).enumerate() {
            let (low, high) = self.domains[idx];
            let is_last = idx + 1 == figure.panels.len();
            let mut x = axis_json(&panel.x, range.x, 8);
            let mut y = axis_json(&panel.y, range.y, 6);
            y["domain"] = json!([low.max(0.0), high.min(1.0)]);
            y["anchor"] = json!(axis_name("x", idx));
            x["anchor"] = json!(axis_name("y", idx));
            if figure.stacking == Stacking::SharedX {
                if idx > 0 {
                    x["matches"] = json!("x");
                }
                if !is_last {
                    x["showticklabels"] = json!(false);
                    x["title"] = Value::Null;
                }
            }
            layout[format!("xaxis{}", suffix(idx))] = x;
            layout[format!("yaxis{}", suffix(idx))] = y;
            annotations.extend(heading_json(panel, high));
        }
        layout["annotations"] = json!(annotations);
        layout
    }
}

fn suffix(panel_idx: usize) -> String {
    if panel_idx == 0 { String::new() } else { (panel_idx + 1).to_string() }
}

fn heading_lines(panel: &Panel) -> Vec<String> {
    let title = wrap(&panel.title, 13.0, 700.0).into_iter().map(|line| format!("<b>{}</b>", escape(&line)));
    let notes = panel.notes.iter().flat_map(|note| wrap(note, 12.0, 700.0));
    title.chain(notes.map(|line| escape(&line))).collect()
}

fn heading_json(panel: &Panel, panel_top: f64) -> Option<Value> {
    let lines = heading_lines(panel);
    (!lines.is_empty()).then(|| {
        json!({
            "text": lines.join("<br>"), "showarrow": false, "align": "left", "font": {"size": 12},
            "xref": "paper", "x": 0, "xanchor": "left",
            "yref": "paper", "y": panel_top, "yanchor": "bottom", "yshift": 2,
        })
    })
}

fn axis_json(axis: &Axis, range: (f64, f64), n_wanted: usize) -> Value {
    let mut json = json!({
        "title": {"text": escape(&axis.label), "standoff": 8},
        "automargin": true, "showline": true, "mirror": true, "linecolor": "#444444", "gridcolor": "#d9d9d9",
        "zeroline": false, "ticks": "outside", "ticklen": 4, "exponentformat": "power",
        "range": [range.0, range.1],
    });
    match axis.scale {
        Scale::Linear => {
            json["nticks"] = json!(n_wanted + 1);
            if let (Some(_), [first, second, ..]) = (axis.tick_unit, ticks(axis, range, n_wanted).as_slice())
            {
                json["tick0"] = json!(0);
                json["dtick"] = json!(second.value - first.value);
            }
        }
        Scale::Log => {
            // Two decades more on either side, so that panning finds labelled ticks.
            let inside = ticks(axis, range, n_wanted);
            let beyond = ticks(axis, (range.0 / 100.0, range.1 * 100.0), n_wanted + 12);
            let beyond = beyond.into_iter().filter(|t| t.value < range.0 || t.value > range.1);
            let minor = inside.iter().any(|t| t.label.is_empty());
            let shown: Vec<_> = inside.into_iter().chain(beyond).filter(|t| !t.label.is_empty()).collect();
            if minor {
                json["minor"] = json!({
                    "dtick": "D1", "ticks": "outside", "ticklen": 2, "showgrid": true, "gridcolor": "#f0f0f0",
                });
            }
            json["type"] = json!("log");
            json["range"] = json!([range.0.log10(), range.1.log10()]);
            json["tickmode"] = json!("array");
            json["tickvals"] = shown.iter().map(|t| json!(t.value)).collect();
            json["ticktext"] = shown.iter().map(|t| json!(t.label)).collect();
        }
    }
    json
}

const MAX_POINTS: usize = 4000;
const LINE_PX: f64 = 17.0;
const AXIS_PX: f64 = 52.0;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::{Colour, demo};

    #[test]
    fn law_the_head_holds_plotly_once_and_nothing_from_the_network() {
        let head = head_script();
        assert!(head.starts_with("<script") && head.ends_with("</script>"));
        assert_eq!(head.matches("plotly.js v").count(), 1);
        // With MathJax it would be 6.7 MB.
        assert!(!head.contains("<script src") && head.len() < 5_000_000);
    }

    #[test]
    fn law_long_series_give_small_fragments() {
        let long = fragment(&demo::time_series());
        assert!(long.len() < 400_000, "{}", long.len());
    }

    #[test]
    fn edge_text_cannot_leave_the_script() {
        let hostile = "</script><script>alert(1)</script>";
        let figure = Figure::new("x", hostile).panel(
            Panel::new(Axis::linear(hostile), Axis::linear("y"))
                .title(hostile)
                .note(hostile)
                .series(Series::line(hostile, vec![0.0], vec![1.0], Colour::Blue)),
        );
        let text = fragment(&figure);
        assert_eq!(text.matches("</script>").count(), 1);
        assert_eq!(text.matches("<script").count(), 1);
    }

    #[test]
    fn edge_gaps_become_null() {
        let values = numbers(&[1.0, f64::NAN, -1.0, f64::INFINITY, 1.234_567_891_2], Scale::Log);
        assert_eq!(values, [json!(1.0), Value::Null, Value::Null, Value::Null, json!(1.234_567_9)]);
    }
}
