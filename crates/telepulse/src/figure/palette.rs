//! Colours, dashes and markers that both renderers use.

use serde::{Deserialize, Serialize};

/// A colour slot. The hues can be told apart with each common kind of colour blindness and on paper.
// Source: Okabe and Ito 2008, "Color universal design". Its yellow is left out: it is unreadable on white.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Colour {
    /// Near-black, for references and printed data.
    Ink,
    /// First choice for one's own result.
    Blue,
    /// Strong contrast to blue.
    Vermilion,
    /// Third curve.
    Green,
    /// Fourth curve.
    Orange,
    /// Fifth curve.
    Purple,
    /// Sixth curve, light.
    Sky,
    /// Limits, bands and other background.
    Grey,
}

impl Colour {
    /// Slots in the order in which an unnamed list of curves takes them.
    pub const CYCLE: [Self; 7] =
        [Self::Blue, Self::Vermilion, Self::Green, Self::Orange, Self::Purple, Self::Sky, Self::Ink];

    /// The slot of the `idx`-th curve; starts again after seven.
    pub fn cycle(idx: usize) -> Self {
        Self::CYCLE[idx % Self::CYCLE.len()]
    }

    /// The colour as `#rrggbb`.
    pub fn hex(self) -> &'static str {
        match self {
            Self::Ink => "#1a1a1a",
            Self::Blue => "#0072b2",
            Self::Vermilion => "#d55e00",
            Self::Green => "#009e73",
            Self::Orange => "#e69f00",
            Self::Purple => "#cc79a7",
            Self::Sky => "#56b4e9",
            Self::Grey => "#7f7f7f",
        }
    }
}

/// Dash pattern of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Dash {
    /// Unbroken.
    Solid,
    /// Long dashes.
    Dashed,
    /// Dots.
    Dotted,
    /// Dash, dot.
    DashDot,
}

impl Dash {
    /// On and off lengths in CSS pixels, separated by commas; `None` for an unbroken line. Understood by SVG
    /// and plotly alike.
    pub fn lengths_px(self) -> Option<&'static str> {
        match self {
            Self::Solid => None,
            Self::Dashed => Some("7px,4px"),
            Self::Dotted => Some("2px,3px"),
            Self::DashDot => Some("8px,3px,2px,3px"),
        }
    }
}

/// Marker shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Marker {
    /// Filled disk.
    Disk,
    /// Open circle, wide enough to ring another marker.
    Circle,
    /// Filled square.
    Square,
    /// Filled diamond.
    Diamond,
    /// Filled triangle.
    Triangle,
    /// Diagonal cross.
    Cross,
}

impl Marker {
    /// The shape's name in plotly.
    pub(super) fn plotly_symbol(self) -> &'static str {
        match self {
            Self::Disk => "circle",
            Self::Circle => "circle-open",
            Self::Square => "square",
            Self::Diamond => "diamond",
            Self::Triangle => "triangle-up",
            Self::Cross => "x-thin-open",
        }
    }

    /// Diameter in pixels.
    pub(super) fn size_px(self) -> f64 {
        if self == Self::Circle { 9.0 } else { 7.0 }
    }

    /// The shape as an SVG path of that size, centred on the origin.
    pub(super) fn svg_path(self) -> &'static str {
        match self {
            Self::Disk => "M-3.2 0a3.2 3.2 0 1 0 6.4 0a3.2 3.2 0 1 0-6.4 0z",
            Self::Circle => "M-4.5 0a4.5 4.5 0 1 0 9 0a4.5 4.5 0 1 0-9 0z",
            Self::Square => "M-3-3h6v6h-6z",
            Self::Diamond => "M0-4l4 4l-4 4l-4-4z",
            Self::Triangle => "M0-3.8l3.6 6.4h-7.2z",
            Self::Cross => "M-3-3l6 6M-3 3l6-6",
        }
    }

    /// Whether only the outline is drawn.
    pub(super) fn is_open(self) -> bool {
        matches!(self, Self::Circle | Self::Cross)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// WCAG relative luminance.
    fn luminance(hex: &str) -> f64 {
        let channel = |at: usize| {
            let value = u8::from_str_radix(&hex[at..at + 2], 16).expect("two hex digits");
            let s = f64::from(value) / 255.0;
            if s <= 0.04045 { s / 12.92 } else { ((s + 0.055) / 1.055).powf(2.4) }
        };
        0.2126 * channel(1) + 0.7152 * channel(3) + 0.0722 * channel(5)
    }

    #[test]
    fn law_every_colour_stands_out_on_white() {
        let all = Colour::CYCLE.into_iter().chain([Colour::Grey]);
        for colour in all {
            let contrast = 1.05 / (luminance(colour.hex()) + 0.05);
            assert!(contrast > 2.0, "{colour:?}: {contrast:.2}");
        }
    }
}
