//! Figures read back from a file: the same checks as when they were built.

use serde::Deserialize;

use super::{Axis, Colour, Figure, Panel, Scale, Series, Stacking, Style};

/// Why a stored figure is refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FigureError {
    /// The identifier could leave its folder or its element.
    #[error("figure id: expected a-z, 0-9, - and _, found `{found}`")]
    Id {
        /// The identifier.
        found: String,
    },
    /// A series with unpaired values.
    #[error("series `{name}`: expected as many x as y values, found {n_x} and {n_y}")]
    UnequalLengths {
        /// Name of the series.
        name: String,
        /// Number of x values.
        n_x: usize,
        /// Number of y values.
        n_y: usize,
    },
    /// A range that no axis can show.
    #[error(
        "axis `{label}`: expected a finite ascending range, positive if logarithmic, found {low}..{high}"
    )]
    Range {
        /// Label of the axis.
        label: String,
        /// Lower end.
        low: f64,
        /// Upper end.
        high: f64,
    },
}

/// Whether the identifier can serve as an element id and a file name.
pub(super) fn is_safe_id(id: &str) -> bool {
    let is_safe = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_';
    !id.is_empty() && id.chars().all(is_safe)
}

/// Whether an axis of this scale can show the range.
pub(super) fn is_range(scale: Scale, (low, high): (f64, f64)) -> bool {
    low.is_finite() && high.is_finite() && low < high && (scale == Scale::Linear || low > 0.0)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StoredFigure {
    id: String,
    title: String,
    caption: String,
    panels: Vec<Panel>,
    stacking: Stacking,
}

impl TryFrom<StoredFigure> for Figure {
    type Error = FigureError;

    fn try_from(stored: StoredFigure) -> Result<Self, FigureError> {
        let StoredFigure { id, title, caption, panels, stacking } = stored;
        if !is_safe_id(&id) {
            return Err(FigureError::Id { found: id });
        }
        Ok(Self { id, title, caption, panels, stacking })
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StoredAxis {
    label: String,
    scale: Scale,
    range: Option<(f64, f64)>,
    tick_unit: Option<f64>,
}

impl TryFrom<StoredAxis> for Axis {
    type Error = FigureError;

    fn try_from(stored: StoredAxis) -> Result<Self, FigureError> {
        let StoredAxis { label, scale, range, tick_unit } = stored;
        match range {
            Some((low, high)) if !is_range(scale, (low, high)) => {
                Err(FigureError::Range { label, low, high })
            }
            _ => Ok(Self { label, scale, range, tick_unit }),
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StoredSeries {
    name: String,
    // JSON has no NaN: a gap is stored as null.
    x: Vec<Option<f64>>,
    y: Vec<Option<f64>>,
    style: Style,
    colour: Colour,
}

impl TryFrom<StoredSeries> for Series {
    type Error = FigureError;

    fn try_from(stored: StoredSeries) -> Result<Self, FigureError> {
        let StoredSeries { name, x, y, style, colour } = stored;
        if x.len() != y.len() {
            return Err(FigureError::UnequalLengths { name, n_x: x.len(), n_y: y.len() });
        }
        let filled = |values: Vec<Option<f64>>| values.into_iter().map(|v| v.unwrap_or(f64::NAN)).collect();
        Ok(Self { name, x: filled(x), y: filled(y), style, colour })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::{demo, svg};

    #[test]
    fn law_a_figure_read_back_draws_the_same() {
        for figure in demo::all() {
            let text = serde_json::to_string(&figure).expect("serialises");
            let back: Figure = serde_json::from_str(&text).expect("reads back");
            assert_eq!(svg::render(&back), svg::render(&figure), "{}", figure.id());
        }
    }

    #[test]
    fn edge_stored_figures_are_checked_like_new_ones() {
        let text = serde_json::to_string(&demo::spectrum()).expect("serialises");
        let refused = |from: &str, to: &str| {
            let changed = text.replace(from, to);
            assert_ne!(changed, text, "{from} is not in the text");
            serde_json::from_str::<Figure>(&changed).expect_err(to).to_string()
        };
        assert!(refused("\"id\":\"spectrum\"", "\"id\":\"../spectrum\"").starts_with("figure id: expected"));
        assert!(refused("\"range\":null", "\"range\":[2.0,1.0]").contains("found 2..1"));
        assert!(refused("\"x\":[0.0,", "\"x\":[0.0,0.0,").contains("found 33 and 32"));
        assert!(refused("\"caption\"", "\"captoin\"").contains("captoin"));
    }
}
