//! Everything that can go wrong in this crate.

/// Why a recording could not be read, built, converted or analysed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The text has no data line.
    #[error("the file is empty: expected the header `{expected_header}` and data lines")]
    EmptyFile {
        /// The header that was expected.
        expected_header: &'static str,
    },
    /// The header lacks a column.
    #[error("line 1: column `{column}` is missing; the header has: {found}")]
    MissingColumn {
        /// The missing column.
        column: &'static str,
        /// The columns that are there.
        found: String,
    },
    /// The header has a column that means nothing here, or one twice.
    #[error("line 1: unexpected column `{column}`; allowed are time_s, value, unit, each once")]
    UnexpectedColumn {
        /// The column that is too much.
        column: String,
    },
    /// A line has more or fewer fields than the header.
    #[error("line {line}: expected {expected} fields, found {found}")]
    FieldCount {
        /// Line in the file, the header being line 1.
        line: u64,
        /// Fields in the header.
        expected: usize,
        /// Fields in the line.
        found: usize,
    },
    /// A field is not a finite number.
    #[error("line {line}, column `{column}`: expected a finite number, found `{text}`")]
    NotANumber {
        /// Line in the file.
        line: u64,
        /// Column of the field.
        column: &'static str,
        /// What stands there.
        text: String,
    },
    /// A time stamp before zero.
    #[error("line {line}, column `time_s`: expected a time >= 0 s, found {found_s} s")]
    NegativeTime {
        /// Line in the file.
        line: u64,
        /// The stamp.
        found_s: f64,
    },
    /// Time stands still or runs backwards.
    #[error("line {line}, column `time_s`: expected a time after {previous_s} s, found {found_s} s")]
    TimeNotIncreasing {
        /// Line in the file.
        line: u64,
        /// The stamp before.
        previous_s: f64,
        /// The stamp.
        found_s: f64,
    },
    /// A step in time that is not one sample interval.
    #[error(
        "line {line}, column `time_s`: expected about {expected_s} s (one sample after {previous_s} s), found {found_s} s"
    )]
    TimeGap {
        /// Line in the file.
        line: u64,
        /// The stamp before.
        previous_s: f64,
        /// The stamp that uniform sampling asks for.
        expected_s: f64,
        /// The stamp.
        found_s: f64,
    },
    /// The unit is not the one of the first data line.
    #[error("line {line}, column `unit`: expected `{expected}` as on the first data line, found `{found}`")]
    UnitChanged {
        /// Line in the file.
        line: u64,
        /// Unit of the first data line.
        expected: String,
        /// Unit of this line.
        found: String,
    },
    /// A unit without a name.
    #[error("line {line}, column `unit`: expected a unit such as mmHg, Pa, mm, N, found nothing")]
    EmptyUnit {
        /// Line in the file.
        line: u64,
    },
    /// The text is not UTF-8.
    #[error("line {line}: expected UTF-8 text")]
    NotUtf8 {
        /// Line in the file.
        line: u64,
    },
    /// The source or sink failed.
    #[error("input or output failed ({kind:?}): {message}")]
    Io {
        /// The kind that the operating system reports.
        kind: std::io::ErrorKind,
        /// Its message.
        message: String,
    },
    /// Too few samples for the operation.
    #[error("expected at least {required} samples, found {found}")]
    TooShort {
        /// Least number.
        required: usize,
        /// Number given.
        found: usize,
    },
    /// A sample is NaN or infinite.
    #[error("sample {index}: expected a finite value, found {found}")]
    NotFinite {
        /// Zero-based sample index.
        index: usize,
        /// The value.
        found: f64,
    },
    /// A parameter outside its range.
    #[error("{name}: expected {allowed}, found {found}")]
    Parameter {
        /// Name with unit.
        name: &'static str,
        /// Allowed range in words.
        allowed: &'static str,
        /// The value.
        found: f64,
    },
    /// Two signals that should have one length do not.
    #[error("expected signals of equal length, found {reference} and {output} samples")]
    UnequalLengths {
        /// Samples of the reference.
        reference: usize,
        /// Samples of the output.
        output: usize,
    },
    /// A constant signal where shape matters.
    #[error("the {which} is constant: its shape cannot be compared or scaled")]
    NoVariation {
        /// Which signal.
        which: &'static str,
    },
    /// The best lag lies at the end of the search range, so the true one may lie beyond.
    #[error("the correlation still grows at the search limit of {limit_s} s: the lag is beyond it")]
    LagOutsideSearch {
        /// Half width of the search range.
        limit_s: f64,
    },
    /// No conversion exists between the units.
    #[error("cannot convert `{from}` to `{to}`")]
    Conversion {
        /// Unit of the recording.
        from: String,
        /// Unit asked for.
        to: String,
    },
    /// No beat stands out.
    #[error("no heart beat was found in {duration_s} s")]
    NoBeats {
        /// Length that was searched.
        duration_s: f64,
    },
}
