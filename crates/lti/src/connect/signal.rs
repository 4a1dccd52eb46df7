//! Names of signals, parts of signals, and sums of them, as they are written.

use crate::Error;

/// A signal that is made somewhere: a name and, for a vector, the number of its channels.
///
/// **Example**
/// ```
/// use telepulse_lti::connect::Signal;
/// assert_eq!(Signal::from(("u", 3)).width(), Some(3));
/// assert_eq!(Signal::from("r").width(), None);
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Signal {
    name: String,
    width: Option<usize>,
}

impl Signal {
    /// The name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The number of channels, where it was given.
    #[must_use]
    pub fn width(&self) -> Option<usize> {
        self.width
    }

    pub(super) fn width_or(&self, default: usize) -> usize {
        self.width.unwrap_or(default)
    }
}

impl From<&str> for Signal {
    fn from(name: &str) -> Self {
        Self { name: name.to_owned(), width: None }
    }
}

impl From<String> for Signal {
    fn from(name: String) -> Self {
        Self { name, width: None }
    }
}

impl From<(&str, usize)> for Signal {
    fn from((name, width): (&str, usize)) -> Self {
        Self { name: name.to_owned(), width: Some(width) }
    }
}

/// A signal or some neighbouring channels of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Reference {
    pub(super) name: String,
    /// First channel and the one after the last; never empty.
    pub(super) range: Option<(usize, usize)>,
}

impl Reference {
    /// Reads `y`, `y[2]` or `y[0..2]`.
    pub(super) fn parse(text: &str) -> Result<Self, Error> {
        let text = text.trim();
        let bad = || Error::SignalName { name: text.to_owned() };
        let Some((name, rest)) = text.split_once('[') else {
            check_name(text)?;
            return Ok(Self { name: text.to_owned(), range: None });
        };
        check_name(name.trim()).map_err(|_| bad())?;
        let inner = rest.strip_suffix(']').ok_or_else(bad)?;
        let number = |text: &str| text.trim().parse::<usize>().map_err(|_| bad());
        let (from, to) = match inner.split_once("..") {
            Some((from, to)) => (number(from)?, number(to)?),
            None => (number(inner)?, number(inner)?.checked_add(1).ok_or_else(bad)?),
        };
        if from >= to {
            return Err(bad());
        }
        Ok(Self { name: name.trim().to_owned(), range: Some((from, to)) })
    }
}

/// `makes = factor*reference + ...`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct SumExpression {
    pub(super) makes: String,
    pub(super) terms: Vec<Term>,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Term {
    pub(super) factor: f64,
    pub(super) reference: Reference,
}

impl SumExpression {
    /// Reads `e = r - y`, with factors as in `v = 0.5*a - b[1]`.
    pub(super) fn parse(text: &str) -> Result<Self, Error> {
        let bad = |reason| Error::SumExpression { expression: text.to_owned(), reason };
        let (makes, mut rest) = text.split_once('=').ok_or(bad("an equals sign after the result"))?;
        let makes = makes.trim().to_owned();
        check_name(&makes)?;
        let mut terms = Vec::new();
        let mut sign = 1.0;
        rest = rest.trim_start();
        if let Some(after) = rest.strip_prefix(['+', '-']) {
            sign = if rest.starts_with('-') { -1.0 } else { 1.0 };
            rest = after;
        }
        // Each turn takes at least one character off the text.
        loop {
            let end = end_of_term(rest);
            let (term, after) = rest.split_at(end);
            let (factor, reference) = match term.split_once('*') {
                Some((factor, reference)) => {
                    let factor: f64 = factor.trim().parse().map_err(|_| bad("a number before the star"))?;
                    (factor, reference)
                }
                None => (1.0, term),
            };
            if !f64::is_finite(factor) {
                return Err(bad("a finite factor"));
            }
            if reference.trim().is_empty() {
                return Err(bad("a signal after each sign"));
            }
            terms.push(Term { factor: sign * factor, reference: Reference::parse(reference)? });
            let Some(next) = after.strip_prefix(['+', '-']) else { break };
            sign = if after.starts_with('-') { -1.0 } else { 1.0 };
            rest = next;
        }
        Ok(Self { makes, terms })
    }
}

/// Where the next sign stands that is not part of an exponent such as `1e-3`.
fn end_of_term(text: &str) -> usize {
    let bytes = text.as_bytes();
    let star = text.find('*').unwrap_or(0);
    let in_exponent = |k: usize| {
        k >= 2 && k < star && matches!(bytes[k - 1], b'e' | b'E') && {
            let head = text[..k - 1].trim_start();
            !head.is_empty() && head.bytes().all(|b| b.is_ascii_digit() || b == b'.')
        }
    };
    let sign = bytes.iter().enumerate().find(|&(k, b)| matches!(b, b'+' | b'-') && !in_exponent(k));
    sign.map_or(text.len(), |(k, _)| k)
}

/// Refuses a name that could not be told from an index or from a sum.
pub(super) fn check_name(name: &str) -> Result<(), Error> {
    let starts_well = name.chars().next().is_some_and(|c| c.is_alphabetic() || c == '_');
    if starts_well && name.chars().all(|c| c.is_alphanumeric() || matches!(c, '_' | '.' | '\'')) {
        Ok(())
    } else {
        Err(Error::SignalName { name: name.to_owned() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_sums_are_read_with_signs_factors_and_parts() {
        let sum = SumExpression::parse(" v = -0.5*a[1] + b - 1e-3*c[0..2]+d").expect("readable");
        let read: Vec<_> = sum.terms.iter().map(|t| (t.factor, t.reference.name.as_str())).collect();
        assert_eq!(sum.makes, "v");
        assert_eq!(read, [(-0.5, "a"), (1.0, "b"), (-1e-3, "c"), (1.0, "d")]);
        assert_eq!(sum.terms[0].reference.range, Some((1, 2)));
        assert_eq!(sum.terms[2].reference.range, Some((0, 2)));
        // A name that ends in e is no number.
        let sum = SumExpression::parse("x = e-y").expect("readable");
        assert_eq!((sum.terms[0].factor, sum.terms[1].factor), (1.0, -1.0));
    }

    #[test]
    fn edge_what_is_no_sum_is_refused() {
        for text in ["e", "= r", "e = ", "e = r -", "e = r y", "e = r = y", "e = two*r", "e = r[", "e = *r"] {
            assert!(SumExpression::parse(text).is_err(), "{text}");
        }
        for text in
            ["e = nan*r", "e = inf*r", "e = r[1..1]", "e = r[-1]", "3 = r", "e = r[18446744073709551615]"]
        {
            assert!(SumExpression::parse(text).is_err(), "{text}");
        }
    }
}
