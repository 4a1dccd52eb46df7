//! The problem files of `telepulse solve`: JSON with the field's matrix names as keys.
//!
//! Whatever a tool wrote should be read: rows as lists, a flat list where the sizes are given, a number for a `1 × 1`
//! matrix. Whatever cannot be read is refused with file, key and sizes.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::io::Read;
use std::path::Path;

use anyhow::{Context, Result, anyhow, bail, ensure};
use nalgebra::DMatrix;
use serde_json::{Map, Value};

use crate::artefact;

/// A problem file, and which of its keys have been asked for.
pub(super) struct ProblemFile {
    name: String,
    fields: Map<String, Value>,
    asked: RefCell<BTreeSet<String>>,
}

/// A number of rows or columns: known from the file, or to be learned from the matrix itself.
#[derive(Clone, Copy, Debug)]
pub(super) struct Size {
    /// How a message calls it, `nz` or `n`.
    pub(super) name: &'static str,
    pub(super) value: Option<usize>,
}

impl Size {
    fn describe(self) -> String {
        match self.value {
            Some(value) if self.name == value.to_string() => self.name.to_owned(),
            Some(value) => format!("{value} ({})", self.name),
            None => self.name.to_owned(),
        }
    }

    fn matches(self, found: usize) -> bool {
        self.value.is_none_or(|value| value == found)
    }
}

impl ProblemFile {
    /// Reads a file, or standard input where the path is `-`.
    ///
    /// # Errors
    /// Names the file, and the key before the place where it stops being JSON.
    pub(super) fn read(path: &Path) -> Result<Self> {
        if path.as_os_str() == "-" {
            let mut text = String::new();
            std::io::stdin().read_to_string(&mut text).context("cannot read standard input")?;
            return Self::parse(&text, "standard input".to_owned());
        }
        Self::parse(&artefact::read_text(path)?, path.display().to_string())
    }

    fn parse(text: &str, name: String) -> Result<Self> {
        let text = &quote_nonfinite(text);
        let value: Value = serde_json::from_str(text).map_err(|error| {
            let near = last_key_before(text, error.line(), error.column());
            let key = near.map_or_else(String::new, |key| format!(", key `{key}`"));
            anyhow!("in {name}{key}: {error}")
        })?;
        let Value::Object(fields) = value else {
            bail!(
                "in {name}: expected an object with the problem's matrices as keys, found {}",
                kind(&value)
            );
        };
        Ok(Self { name, fields, asked: RefCell::default() })
    }

    fn field(&self, key: &str) -> Option<&Value> {
        self.asked.borrow_mut().insert(key.to_owned());
        self.fields.get(key).filter(|value| !value.is_null())
    }

    /// Whether the key is there and not null.
    pub(super) fn has(&self, key: &str) -> bool {
        self.field(key).is_some()
    }

    /// An error about a key.
    pub(super) fn complaint(&self, key: &str, what: &str) -> anyhow::Error {
        anyhow!("in {}: key `{key}`: {what}", self.name)
    }

    /// Refuses a key that a slip of the pen made of a known one, and any key that is known to another kind of problem only.
    ///
    /// Collections carry keys of their own beside a problem, to tell it apart and to judge its answer: those may be anything.
    ///
    /// # Errors
    /// Names the first such key and the one that was meant, or the keys that have a meaning.
    pub(super) fn refuse_mistaken(&self, known: &[&str], elsewhere: &[&str]) -> Result<()> {
        for key in self.fields.keys().filter(|key| !known.contains(&key.as_str())) {
            if let Some(meant) = known.iter().find(|name| is_slip(key, name)) {
                return Err(self.complaint(key, &format!("is unknown, `{meant}` may be meant")));
            }
            if elsewhere.contains(&key.as_str()) {
                let known = known.join(", ");
                return Err(self.complaint(key, &format!("is unknown here, expected one of {known}")));
            }
        }
        Ok(())
    }

    /// `n`, or the rows of `A`; the message about another matrix then names where the size comes from.
    ///
    /// # Errors
    /// About `A` where it is not square, or where all of the matrices named beside, two or more, have another number of rows in
    /// common.
    pub(super) fn state_count(&self, beside: &[&'static str]) -> Result<(DMatrix<f64>, Size)> {
        let n = self.size("n")?;
        let a = self.matrix("A", n, n)?;
        let found = a.nrows();
        let rows = |key: &&str| self.fields.get(*key).and_then(Value::as_array).map(Vec::len);
        let others: Vec<usize> = beside.iter().filter_map(rows).collect();
        if n.value.is_none() && others.len() >= 2 && others.iter().all(|&k| k == others[0] && k != found) {
            let (k, keys) = (others[0], beside.iter().filter(|key| rows(key).is_some()));
            let keys = keys.map(|key| format!("`{key}`")).collect::<Vec<_>>().join(" and ");
            let what = format!("expected {k} x {k} as {keys} have {k} rows, found {found} x {found}");
            return Err(self.complaint("A", &what));
        }
        let name = if n.value.is_some() { "n" } else { "n, by `A`" };
        Ok((a, Size { name, value: Some(found) }))
    }

    /// A number, if it is there, that lies in a range given in words.
    pub(super) fn number_in(
        &self,
        key: &str,
        allowed: &str,
        is_allowed: impl Fn(f64) -> bool,
    ) -> Result<Option<f64>> {
        let number = self.number(key)?;
        match number.filter(|&number| !is_allowed(number)) {
            None => Ok(number),
            Some(found) => Err(self.complaint(key, &format!("expected {allowed}, found {found}"))),
        }
    }

    /// Keys that no call has asked for.
    pub(super) fn unread(&self) -> Vec<String> {
        let asked = self.asked.borrow();
        self.fields.keys().filter(|key| !asked.contains(*key)).cloned().collect()
    }

    /// A whole number that counts something.
    pub(super) fn count(&self, key: &'static str) -> Result<Option<usize>> {
        let Some(value) = self.field(key) else { return Ok(None) };
        let whole = value.as_u64().or_else(|| {
            let number = value.as_f64()?;
            (number >= 0.0 && number.fract() == 0.0 && number <= COUNT_MAX as f64).then_some(number as u64)
        });
        match whole {
            Some(count) if count <= COUNT_MAX => Ok(Some(count as usize)),
            _ => {
                Err(self
                    .complaint(key, &format!("expected a whole number from 0 to {COUNT_MAX}, found {value}")))
            }
        }
    }

    /// A size under its own key.
    pub(super) fn size(&self, key: &'static str) -> Result<Size> {
        Ok(Size { name: key, value: self.count(key)? })
    }

    /// A number.
    pub(super) fn number(&self, key: &str) -> Result<Option<f64>> {
        let Some(value) = self.field(key) else { return Ok(None) };
        match value.as_f64().filter(|number| number.is_finite()) {
            Some(number) => Ok(Some(number)),
            None => Err(self.complaint(key, &format!("expected a number, found {}", kind(value)))),
        }
    }

    /// A word.
    pub(super) fn word(&self, key: &str) -> Result<Option<&str>> {
        let Some(value) = self.field(key) else { return Ok(None) };
        match value.as_str() {
            Some(word) => Ok(Some(word)),
            None => Err(self.complaint(key, &format!("expected a word, found {}", kind(value)))),
        }
    }

    /// The settings under `options`, of which only the named ones are known; none where the key is absent.
    pub(super) fn options(&self, known: &[&str]) -> Result<Self> {
        match self.part("options", known)? {
            Some(options) => Ok(options),
            None => {
                let name = format!("{}, options", self.name);
                Ok(Self { name, fields: Map::new(), asked: RefCell::default() })
            }
        }
    }

    /// An object inside of the file, of which only the named keys are known.
    pub(super) fn part(&self, key: &str, known: &[&str]) -> Result<Option<Self>> {
        let name = format!("{}, {key}", self.name);
        let Some(value) = self.field(key) else { return Ok(None) };
        let Value::Object(fields) = value else {
            return Err(self.complaint(key, &format!("expected an object, found {}", kind(value))));
        };
        for key in fields.keys() {
            ensure!(
                known.contains(&key.as_str()),
                "in {name}: key `{key}` is unknown, expected one of {}",
                known.join(", ")
            );
        }
        Ok(Some(Self { name, fields: fields.clone(), asked: RefCell::default() }))
    }

    /// A matrix that must be there.
    pub(super) fn matrix(&self, key: &str, rows: Size, cols: Size) -> Result<DMatrix<f64>> {
        self.optional_matrix(key, rows, cols)?
            .ok_or_else(|| self.complaint(key, &format!("is missing, expected {}", expected(rows, cols))))
    }

    /// A matrix, or zeros of the given size.
    pub(super) fn matrix_or_zeros(&self, key: &str, rows: Size, cols: Size) -> Result<DMatrix<f64>> {
        match self.optional_matrix(key, rows, cols)? {
            Some(matrix) => Ok(matrix),
            None => match (rows.value, cols.value) {
                (Some(n_rows), Some(n_cols)) => Ok(DMatrix::zeros(n_rows, n_cols)),
                _ => Err(self.complaint(key, &format!("is missing, expected {}", expected(rows, cols)))),
            },
        }
    }

    /// A matrix, if it is there.
    pub(super) fn optional_matrix(&self, key: &str, rows: Size, cols: Size) -> Result<Option<DMatrix<f64>>> {
        let Some(value) = self.field(key) else { return Ok(None) };
        let matrix = self.parse_matrix(key, value, rows, cols)?;
        let (n_rows, n_cols) = matrix.shape();
        // A matrix that is to be square without saying how large.
        let square = rows.name != cols.name || n_rows == n_cols;
        if !rows.matches(n_rows) || !cols.matches(n_cols) || !square {
            let what = format!("expected {}, found {n_rows} x {n_cols}", expected(rows, cols));
            return Err(self.complaint(key, &what));
        }
        Ok(Some(matrix))
    }

    fn parse_matrix(&self, key: &str, value: &Value, rows: Size, cols: Size) -> Result<DMatrix<f64>> {
        let number = |entry: &Value, place: &str| -> Result<f64> {
            let finite = entry.as_f64().filter(|number| number.is_finite()).ok_or_else(|| {
                self.complaint(key, &format!("{place}: expected a finite number, found {}", kind(entry)))
            })?;
            if finite.abs() > ENTRY_MAX {
                let what = format!("{place}: expected a size of {ENTRY_MAX:e} at most, found {finite:e}");
                return Err(self.complaint(key, &what));
            }
            Ok(finite)
        };
        let entries = match value {
            Value::Array(entries) => entries,
            Value::Number(_) => return Ok(DMatrix::from_element(1, 1, number(value, "entry")?)),
            other => {
                return Err(self.complaint(key, &format!("expected a list of rows, found {}", kind(other))));
            }
        };
        if entries.is_empty() {
            // Without rows there is nothing to count columns by.
            return Ok(DMatrix::zeros(0, cols.value.unwrap_or(0)));
        }
        if entries.iter().all(|entry| !entry.is_array()) {
            return self.parse_flat(key, entries, rows, cols, &number);
        }
        let mut n_cols = None;
        let mut data = Vec::new();
        for (row_idx, row) in entries.iter().enumerate() {
            let Value::Array(row) = row else {
                let what = format!("row {row_idx}: expected a list, found {}", kind(row));
                return Err(self.complaint(key, &what));
            };
            let expected_cols = *n_cols.get_or_insert(row.len());
            if row.len() != expected_cols {
                let what = format!("row {row_idx} has {} entries where row 0 has {expected_cols}", row.len());
                return Err(self.complaint(key, &what));
            }
            for (col_idx, entry) in row.iter().enumerate() {
                data.push(number(entry, &format!("row {row_idx}, column {col_idx}"))?);
            }
        }
        Ok(DMatrix::from_row_slice(entries.len(), n_cols.unwrap_or(0), &data))
    }

    /// A list without rows, by rows, where the sizes leave one reading only.
    fn parse_flat(
        &self,
        key: &str,
        entries: &[Value],
        rows: Size,
        cols: Size,
        number: &dyn Fn(&Value, &str) -> Result<f64>,
    ) -> Result<DMatrix<f64>> {
        let data = entries
            .iter()
            .enumerate()
            .map(|(idx, entry)| number(entry, &format!("entry {idx}")))
            .collect::<Result<Vec<f64>>>()?;
        let shape = match (rows.value, cols.value) {
            (Some(n_rows), Some(n_cols)) if n_rows * n_cols == data.len() => Some((n_rows, n_cols)),
            (Some(n_rows), None) if n_rows > 0 && data.len().is_multiple_of(n_rows) => {
                Some((n_rows, data.len() / n_rows))
            }
            (None, Some(n_cols)) if n_cols > 0 && data.len().is_multiple_of(n_cols) => {
                Some((data.len() / n_cols, n_cols))
            }
            _ => None,
        };
        match shape {
            Some((n_rows, n_cols)) => Ok(DMatrix::from_row_slice(n_rows, n_cols, &data)),
            None => {
                let what = format!(
                    "expected {} as a list of rows, found a list of {} numbers",
                    expected(rows, cols),
                    data.len()
                );
                Err(self.complaint(key, &what))
            }
        }
    }
}

/// Whether a key is another one in other case, or, if that is long enough to tell, with one letter more, less or changed, or two exchanged.
fn is_slip(key: &str, name: &str) -> bool {
    if key.eq_ignore_ascii_case(name) {
        return true;
    }
    let (a, b): (Vec<char>, Vec<char>) = (key.chars().collect(), name.chars().collect());
    if b.len() < SLIP_MIN {
        return false;
    }
    let start = a.iter().zip(&b).take_while(|(x, y)| x == y).count();
    let (a, b) = (&a[start..], &b[start..]);
    let end = a.iter().rev().zip(b.iter().rev()).take_while(|(x, y)| x == y).count();
    let (a, b) = (&a[..a.len() - end], &b[..b.len() - end]);
    match (a.len(), b.len()) {
        (0 | 1, 0 | 1) => true,
        (2, 2) => a[0] == b[1] && a[1] == b[0],
        _ => false,
    }
}

/// Shorter keys are one letter apart from each other.
const SLIP_MIN: usize = 5;

fn expected(rows: Size, cols: Size) -> String {
    format!("{} x {}", rows.describe(), cols.describe())
}

fn kind(value: &Value) -> String {
    match value {
        Value::Null => "null".to_owned(),
        Value::Bool(flag) => flag.to_string(),
        Value::Number(number) => number.to_string(),
        Value::String(text) => format!("\"{}\"", text.chars().take(40).collect::<String>()),
        Value::Array(entries) => format!("a list of {}", entries.len()),
        Value::Object(_) => "an object".to_owned(),
    }
}

/// Puts quotes around `NaN`, `Infinity` and `-Infinity`, which JSON does not have but many tools write.
///
/// In a key that nobody reads they do no harm; where a number is wanted, the message then says which entry it was.
fn quote_nonfinite(text: &str) -> String {
    let mut quoted = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(next) = rest.chars().next() {
        if next == '"' {
            // A string, to its closing quote: one that no odd number of backslashes precedes.
            let mut escaped = false;
            let end = rest[1..].find(|c| {
                let closes = c == '"' && !escaped;
                escaped = c == '\\' && !escaped;
                closes
            });
            let length = end.map_or(rest.len(), |end| end + 2);
            quoted.push_str(&rest[..length]);
            rest = &rest[length..];
        } else if let Some(word) =
            ["NaN", "Infinity", "-Infinity"].into_iter().find(|word| rest.starts_with(word))
        {
            quoted.push('"');
            quoted.push_str(word);
            quoted.push('"');
            rest = &rest[word.len()..];
        } else {
            quoted.push(next);
            rest = &rest[next.len_utf8()..];
        }
    }
    quoted
}

/// The last `"key":` that starts before a place in the text.
fn last_key_before(text: &str, line: usize, column: usize) -> Option<&str> {
    let start: usize = text.split_inclusive('\n').take(line.saturating_sub(1)).map(str::len).sum();
    let mut end = (start + column).min(text.len());
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    let before = &text[..end];
    let mut colon = before.len();
    while let Some(position) = before[..colon].rfind(':') {
        let head = before[..position].trim_end();
        if let Some(inner) = head.strip_suffix('"')
            && let Some(open) = inner.rfind('"')
        {
            return Some(&inner[open + 1..]);
        }
        colon = position;
    }
    None
}

/// Largest size that a file may name; far beyond what can be solved, far below an overflow.
const COUNT_MAX: u64 = 100_000;
/// Largest entry of a matrix: products of three stay in the range of floating point.
const ENTRY_MAX: f64 = 1e100;

#[cfg(test)]
mod tests {
    use super::*;

    fn size(name: &'static str, value: Option<usize>) -> Size {
        Size { name, value }
    }

    fn file(text: &str) -> ProblemFile {
        ProblemFile::parse(text, "f.json".to_owned()).expect("an object")
    }

    #[test]
    fn law_rows_flat_lists_and_numbers_are_matrices() {
        let f = file(r#"{"A": [[1, 2], [3, 4]], "B": [5, 6], "D": 7, "C": [], "E": [[], []]}"#);
        let (n, one) = (size("n", Some(2)), size("nu", Some(1)));
        assert_eq!(f.matrix("A", n, n).expect("rows"), nalgebra::dmatrix![1.0, 2.0; 3.0, 4.0]);
        assert_eq!(f.matrix("B", n, one).expect("flat"), nalgebra::dmatrix![5.0; 6.0]);
        assert_eq!(f.matrix("B", one, n).expect("flat"), nalgebra::dmatrix![5.0, 6.0]);
        assert_eq!(f.matrix("D", one, one).expect("a number")[(0, 0)], 7.0);
        assert_eq!(f.matrix("C", size("nz", Some(0)), n).expect("no rows").shape(), (0, 2));
        assert_eq!(f.matrix("E", n, size("nw", Some(0))).expect("no columns").shape(), (2, 0));
        assert!(f.unread().is_empty());
    }

    #[test]
    fn edge_messages_name_file_key_and_sizes() {
        let f = file(r#"{"A": [[1, 2], [3]], "B": [[1, 2]], "C": [["x"]], "D": {}, "n": -1, "m": 2.5}"#);
        let (n, m) = (size("n", Some(2)), size("nu", Some(1)));
        for (found, parts) in [
            (f.matrix("A", n, n).map(drop), ["f.json", "`A`", "row 1 has 1 entries where row 0 has 2"]),
            (f.matrix("B", n, m).map(drop), ["f.json", "`B`", "expected 2 (n) x 1 (nu), found 1 x 2"]),
            (f.matrix("C", n, m).map(drop), ["f.json", "`C`", "row 0, column 0: expected a finite number"]),
            (f.matrix("D", n, m).map(drop), ["f.json", "`D`", "expected a list of rows, found an object"]),
            (f.matrix("F", n, m).map(drop), ["f.json", "`F`", "is missing, expected 2 (n) x 1 (nu)"]),
            (f.count("n").map(drop), ["f.json", "`n`", "whole number"]),
            (f.count("m").map(drop), ["f.json", "`m`", "whole number"]),
        ] {
            let message = found.expect_err("refused").to_string();
            assert!(parts.iter().all(|part| message.contains(part)), "{message}");
        }
    }

    #[test]
    fn edge_what_is_no_json_names_the_key_before_it() {
        for (text, part) in [("{\"A\": [[1.0]],\n \"B2\": [[x]]}", "`B2`"), ("{\"C\": [[1e999]]}", "`C`")] {
            let message = ProblemFile::parse(text, "f.json".to_owned()).err().expect("refused").to_string();
            assert!(message.contains(part) && message.contains("f.json"), "{message}");
        }
        assert!(ProblemFile::parse("[1]", "f.json".to_owned()).is_err());
    }

    #[test]
    fn edge_numbers_that_are_not_finite_matter_only_where_they_are_read() {
        let f = file(r#"{"note": "NaN \" -Infinity", "peak": -Infinity, "A": [[NaN]], "D": [[1]]}"#);
        let n = size("n", Some(1));
        assert_eq!(f.matrix("D", n, n).expect("finite")[(0, 0)], 1.0);
        let message = f.matrix("A", n, n).expect_err("not finite").to_string();
        assert!(message.contains("row 0, column 0") && message.contains("NaN"), "{message}");
        assert_eq!(f.word("note").expect("a word"), Some("NaN \" -Infinity"));
    }
}
