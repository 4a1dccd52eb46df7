//! Text for figures: escaping, estimated widths, numbers.

/// The text with the five characters that mean something in HTML, SVG and plotly labels replaced by entities.
pub fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len() + 8);
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            // Control characters are not allowed in XML, not even as entities.
            c if c.is_control() && c != '\n' && c != '\t' => escaped.push('\u{fffd}'),
            c => escaped.push(c),
        }
    }
    escaped
}

/// An upper estimate of the text's width in pixels at this font size.
///
/// **Accuracy**: from the widths of DejaVu Sans, which runs wider than Helvetica and Arial; rather 5-15 % too
/// wide than clipped.
pub fn width_px(text: &str, font_px: f64) -> f64 {
    let em: f64 = text
        .chars()
        .map(|c| match c {
            'i' | 'j' | 'l' | 'I' | '.' | ',' | ':' | ';' | '\'' | '|' | ' ' | '!' => 0.34,
            'f' | 't' | 'r' | '(' | ')' | '[' | ']' | '-' | '/' => 0.42,
            'm' | 'w' | 'M' | 'W' | '@' | '%' => 0.98,
            c if c.is_ascii_uppercase() => 0.72,
            c if c.is_ascii() => 0.64,
            // Wide scripts take a full square.
            c if u32::from(c) >= 0x2e80 => 1.0,
            _ => 0.7,
        })
        .sum();
    em * font_px
}

/// The text in lines no wider than `limit_px` by estimate; a single longer word keeps its own line.
pub fn wrap(text: &str, font_px: f64, limit_px: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if width_px(line, font_px) + width_px(word, font_px) + 0.34 * font_px <= limit_px => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

/// The number with this many significant digits, without an exponent between 1e-4 and 1e7; `n/a` if it is not
/// finite.
pub fn number(value: f64, significant_digits: usize) -> String {
    if !value.is_finite() {
        return "n/a".to_owned();
    }
    let digits = significant_digits.max(1);
    if value == 0.0 {
        return "0".to_owned();
    }
    // Rounding first: 9.996 with three digits is 10.0 and has one decimal less than 9.99.
    let scientific = format!("{value:.*e}", digits - 1);
    let exponent: i32 = scientific.rsplit_once('e').and_then(|(_, e)| e.parse().ok()).unwrap_or(0);
    if !(-4..7).contains(&exponent) {
        return scientific.replace('-', "\u{2212}");
    }
    let decimals = usize::try_from(digits as i64 - 1 - i64::from(exponent)).unwrap_or(0);
    format!("{value:.decimals$}").replace('-', "\u{2212}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edge_markup_in_text_is_defused() {
        assert_eq!(escape("<b a=\"1\">&'\u{1}"), "&lt;b a=&quot;1&quot;&gt;&amp;&#39;\u{fffd}");
    }

    #[test]
    fn law_numbers_keep_their_significant_digits() {
        let cases = [
            (0.935, 4, "0.9350"),
            (9.996, 3, "10.0"),
            (-38.0, 3, "\u{2212}38.0"),
            (1234567.0, 3, "1234567"),
            (0.0, 3, "0"),
            (2.5e-7, 2, "2.5e\u{2212}7"),
            (f64::NAN, 3, "n/a"),
        ];
        for (value, digits, text) in cases {
            assert_eq!(number(value, digits), text);
        }
    }

    #[test]
    fn law_wrapped_lines_fit_and_lose_no_word() {
        let text = "a remark that is rather longer than the narrow column it has to fit";
        let lines = wrap(text, 11.0, 120.0);
        assert!(lines.len() > 2);
        assert!(lines.iter().all(|line| width_px(line, 11.0) <= 120.0));
        assert_eq!(lines.join(" "), text);
    }
}
