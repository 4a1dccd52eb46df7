//! Ranges and tick marks.

use super::{Axis, Panel, Scale, Style};

/// The range of both axes of a panel in data units, low end first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PanelRange {
    /// Horizontal range.
    pub x: (f64, f64),
    /// Vertical range.
    pub y: (f64, f64),
}

/// A tick mark.
#[derive(Debug, Clone, PartialEq)]
pub struct Tick {
    /// Position in data units.
    pub value: f64,
    /// Label; empty for a minor tick.
    pub label: String,
}

/// The range that a panel shows: as given by its axes, else fitted to its finite data.
///
/// **Accuracy**: fitted x ranges are tight (2 % of air with markers), fitted y ranges have 5 % of air at each
/// end. Without any data the range is 0..1 (1..10 on a logarithmic axis).
pub fn panel_range(panel: &Panel) -> PanelRange {
    let log_x = panel.x.scale == Scale::Log;
    let log_y = panel.y.scale == Scale::Log;
    let mut x = Extent::EMPTY;
    let mut y = Extent::EMPTY;
    for series in &panel.series {
        let drawn =
            |x: f64, y: f64| x.is_finite() && y.is_finite() && (x > 0.0 || !log_x) && (y > 0.0 || !log_y);
        for (&px, &py) in series.x().iter().zip(series.y()) {
            let in_x = panel.x.range.is_none_or(|(low, high)| (low..=high).contains(&px));
            if drawn(px, py) && in_x {
                x.include(px);
                y.include(py);
            }
        }
        if series.style == Style::Stems && !log_y {
            y.include(0.0);
        }
    }
    // Markers at the ends are cut in half without some air.
    let has_markers = panel.series.iter().any(|series| !matches!(series.style, Style::Line { .. }));
    let air = if has_markers { 0.02 } else { 0.0 };
    PanelRange {
        x: panel.x.range.unwrap_or_else(|| x.padded(panel.x.scale, air)),
        y: panel.y.range.unwrap_or_else(|| y.padded(panel.y.scale, 0.05)),
    }
}

/// Tick marks inside `range`, ascending; about `n_wanted` of them carry a label.
///
/// **Method**: linear axes take steps of 1, 2 or 5 times a power of ten, or 1, 2, 4 ... times the axis's own
/// tick unit. Logarithmic axes label 1, 2, 5 within three decades and whole decades beyond; the other digits
/// become minor ticks, up to five decades.
/// A logarithmic axis that spans less than a factor of three takes linear steps.
pub fn ticks(axis: &Axis, range: (f64, f64), n_wanted: usize) -> Vec<Tick> {
    match axis.scale {
        Scale::Log if range.1 / range.0 >= 3.0 => log_ticks(range, n_wanted),
        _ => linear_ticks(range, n_wanted, axis.tick_unit),
    }
}

fn linear_ticks((low, high): (f64, f64), n_wanted: usize, unit: Option<f64>) -> Vec<Tick> {
    let raw = (high - low) / n_wanted.max(1) as f64;
    let step = match unit.filter(|unit| unit.is_finite() && *unit > 0.0) {
        Some(unit) => unit * (raw / unit).max(1.0).log2().ceil().exp2(),
        None => {
            let decade = 10f64.powf(raw.log10().floor());
            let nice = [1.0, 2.0, 5.0, 10.0];
            decade * nice.into_iter().find(|n| n * decade >= raw * 0.75).unwrap_or(10.0)
        }
    };
    let decimals = usize::try_from((-(step.log10() + 1e-9).floor()) as i64).unwrap_or(0);
    let first = (low / step - 1e-9).ceil() as i64;
    let last = (high / step + 1e-9).floor() as i64;
    (first..=last.min(first + MAX_TICKS))
        .map(|k| {
            let value = k as f64 * step;
            Tick { value, label: label(value, decimals) }
        })
        .collect()
}

fn log_ticks((low, high): (f64, f64), n_wanted: usize) -> Vec<Tick> {
    let first = low.log10().floor() as i32;
    let last = (high.log10().ceil() as i32).min(first + MAX_DECADES);
    let n_decades = high.log10() - low.log10();
    let digits: &[u32] = if n_decades * 3.0 <= n_wanted as f64 + 3.0 { &[1, 2, 5] } else { &[1] };
    // Whole decades, thinned when even they are too many.
    let every = (n_decades / n_wanted.max(1) as f64).ceil().max(1.0) as i32;
    let mut ticks = Vec::new();
    for decade in first..=last {
        for digit in 1..=9 {
            let value = f64::from(digit) * 10f64.powi(decade);
            if value < low * (1.0 - 1e-9) || value > high * (1.0 + 1e-9) {
                continue;
            }
            let is_labelled = digits.contains(&digit) && decade.rem_euclid(every) == 0;
            // Minor ticks of many decades would blacken the grid.
            if is_labelled || digit == 1 || n_decades <= 5.0 {
                let label = if is_labelled { log_label(digit, decade) } else { String::new() };
                ticks.push(Tick { value, label });
            }
        }
    }
    ticks
}

fn log_label(digit: u32, decade: i32) -> String {
    match decade {
        0..=3 => format!("{}", u64::from(digit) * 10u64.pow(decade.unsigned_abs())),
        -3..=-1 => format!("{:.*}", decade.unsigned_abs() as usize, f64::from(digit) * 10f64.powi(decade)),
        _ if digit == 1 => format!("10{}", superscript(decade)),
        _ => format!("{digit}\u{b7}10{}", superscript(decade)),
    }
}

/// The number with `decimals` decimals, or as mantissa and power of ten when it would be too long.
fn label(value: f64, decimals: usize) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let magnitude = value.abs();
    if magnitude < 1e5 && decimals <= 4 {
        return format!("{value:.decimals$}").replace('-', "\u{2212}");
    }
    let exponent = magnitude.log10().floor() as i32;
    let mantissa = value / 10f64.powi(exponent);
    let text = format!("{mantissa:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    format!("{text}\u{b7}10{}", superscript(exponent)).replace('-', "\u{2212}")
}

fn superscript(exponent: i32) -> String {
    const DIGITS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    exponent.to_string().chars().map(|c| c.to_digit(10).map_or('⁻', |digit| DIGITS[digit as usize])).collect()
}

/// The smallest and the largest value seen.
#[derive(Debug, Clone, Copy)]
struct Extent {
    low: f64,
    high: f64,
}

impl Extent {
    const EMPTY: Self = Self { low: f64::INFINITY, high: f64::NEG_INFINITY };

    fn include(&mut self, value: f64) {
        self.low = self.low.min(value);
        self.high = self.high.max(value);
    }

    fn padded(self, scale: Scale, fraction: f64) -> (f64, f64) {
        let Self { low, high } = self;
        match scale {
            _ if low > high => {
                if scale == Scale::Log {
                    (1.0, 10.0)
                } else {
                    (0.0, 1.0)
                }
            }
            Scale::Linear if high - low <= 1e-12 * high.abs().max(low.abs()) => {
                let air = if high == 0.0 { 1.0 } else { 0.5 * high.abs() };
                (low - air, high + air)
            }
            Scale::Linear => {
                let air = fraction * (high - low);
                (low - air, high + air)
            }
            Scale::Log if high / low < 1.0 + 1e-9 => (low / 2.0, high * 2.0),
            Scale::Log => {
                let air = (high / low).powf(fraction);
                (low / air, high * air)
            }
        }
    }
}

/// Bounds on what can be drawn, far above any sensible figure.
const MAX_TICKS: i64 = 200;
const MAX_DECADES: i32 = 60;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::{Colour, Series};

    fn labels(axis: &Axis, range: (f64, f64), n_wanted: usize) -> Vec<String> {
        let ticks = ticks(axis, range, n_wanted);
        ticks.into_iter().map(|t| t.label).filter(|l| !l.is_empty()).collect()
    }

    #[test]
    fn law_linear_labels_are_round() {
        let axis = Axis::linear("t, s");
        assert_eq!(labels(&axis, (0.0, 1.0), 5), ["0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        assert_eq!(labels(&axis, (-0.13, 0.31), 4), ["\u{2212}0.1", "0", "0.1", "0.2", "0.3"]);
        assert_eq!(labels(&axis, (0.0, 3e6), 3), ["0", "1·10⁶", "2·10⁶", "3·10⁶"]);
        assert_eq!(labels(&axis, (0.0, 2e-6), 2), ["0", "1·10⁻⁶", "2·10⁻⁶"]);
    }

    #[test]
    fn law_phase_ticks_are_multiples_of_45() {
        let axis = Axis::degrees("phase, deg");
        assert_eq!(
            labels(&axis, (-270.0, 0.0), 6),
            ["\u{2212}270", "\u{2212}225", "\u{2212}180", "\u{2212}135", "\u{2212}90", "\u{2212}45", "0"]
        );
        assert_eq!(labels(&axis, (-270.0, 0.0), 3), ["\u{2212}270", "\u{2212}180", "\u{2212}90", "0"]);
    }

    #[test]
    fn law_log_labels_are_plain_near_one_and_powers_far_away() {
        let axis = Axis::log("f, Hz");
        assert_eq!(labels(&axis, (0.1, 13.0), 8), ["0.1", "0.2", "0.5", "1", "2", "5", "10"]);
        assert_eq!(
            labels(&axis, (1e-6, 1e1), 8),
            ["10⁻⁶", "10⁻⁵", "10⁻⁴", "0.001", "0.01", "0.1", "1", "10"]
        );
        assert_eq!(labels(&axis, (1.5, 2.1), 3), ["1.6", "1.8", "2.0"]);
    }

    #[test]
    fn edge_empty_constant_and_non_finite_data_still_have_a_range() {
        let panel = |y: Axis, values: Vec<f64>| {
            let x = (0..values.len()).map(|i| i as f64).collect();
            panel_range(&Panel::new(Axis::linear("x"), y).series(Series::line("a", x, values, Colour::Blue)))
        };
        assert_eq!(panel(Axis::linear("y"), vec![]).y, (0.0, 1.0));
        assert_eq!(panel(Axis::log("y"), vec![-1.0, f64::NAN]).y, (1.0, 10.0));
        assert_eq!(panel(Axis::linear("y"), vec![2.0, 2.0]).y, (1.0, 3.0));
        assert_eq!(panel(Axis::linear("y"), vec![0.0, 0.0, f64::INFINITY]).y, (-1.0, 1.0));
    }
}
