//! Comma-separated recordings: the columns `time_s,value,unit` under a header.
//!
//! ```text
//! time_s,value,unit
//! 0.0000,68.125,mmHg
//! 0.0080,67.875,mmHg
//! ```

use std::io::{Read, Write};

use csv::{ErrorKind, ReaderBuilder, StringRecord, Trim};

use crate::{Error, PulseRecording, Unit};

/// Reads a recording.
///
/// **Method**: the columns may stand in any order; each is needed once. The rate is that of the first and
/// last stamp, `(n - 1) / (t_last - t_first)`; because stamps are rounded, the rate with the fewest digits
/// that still explains every stamp to one unit in its last printed place is taken instead if there is one
/// (stamps `0.0000, 0.0080, ...` give 125 Hz, but 120 s of 125.002 Hz stay 125.002 Hz).
///
/// **Accuracy**: a stamp may be off uniform sampling by a tenth of the sample interval plus one unit in its
/// last printed place, and a step by half an interval plus that unit; more is a gap. Values are read exactly.
///
/// **Errors**: each names line and column: missing or unexpected column, wrong number of fields, not a finite
/// number, negative or not increasing time, gap, change of unit; also an empty file, a single sample, text
/// that is not UTF-8, and failure of the source.
pub fn read(source: impl Read) -> Result<PulseRecording, Error> {
    let mut reader = ReaderBuilder::new().trim(Trim::All).flexible(true).from_reader(source);
    let header = reader.headers().map_err(|error| from_csv(&error))?.clone();
    if header.iter().all(str::is_empty) {
        return Err(Error::EmptyFile { expected_header: HEADER });
    }
    let columns = Columns::of(&header)?;
    let mut lines = Lines::default();
    let mut record = StringRecord::new();
    while reader.read_record(&mut record).map_err(|error| from_csv(&error))? {
        let line = record.position().map_or(0, csv::Position::line);
        if record.len() != header.len() {
            return Err(Error::FieldCount { line, expected: header.len(), found: record.len() });
        }
        lines.push(line, &record, &columns)?;
    }
    lines.finish()
}

/// Writes a recording; reading it back gives the same values bit for bit.
///
/// **Accuracy**: numbers are written in the shortest form that reads back exactly. The sample rate comes back
/// exactly if it has at most 12 significant digits, else to about 1e-12. Title, site and provenance have no
/// place in this format.
///
/// **Errors**: failure of the sink.
pub fn write(recording: &PulseRecording, sink: impl Write) -> Result<(), Error> {
    let mut sink = std::io::BufWriter::new(sink);
    let unit = quoted(recording.unit().symbol());
    let mut write_all = || -> std::io::Result<()> {
        writeln!(sink, "{HEADER}")?;
        for (time, value) in recording.times_s().iter().zip(recording.values()) {
            writeln!(sink, "{time},{value},{unit}")?;
        }
        sink.flush()
    };
    write_all().map_err(|error| Error::Io { kind: error.kind(), message: error.to_string() })
}

/// Positions of the columns in a line.
struct Columns {
    time: usize,
    value: usize,
    unit: usize,
}

impl Columns {
    fn of(header: &StringRecord) -> Result<Self, Error> {
        let names: Vec<&str> = header.iter().map(|name| name.trim_start_matches('\u{feff}')).collect();
        let find = |column: &'static str| {
            let missing = || Error::MissingColumn { column, found: names.join(", ") };
            names.iter().position(|name| *name == column).ok_or_else(missing)
        };
        let columns = Self { time: find("time_s")?, value: find("value")?, unit: find("unit")? };
        let known = [columns.time, columns.value, columns.unit];
        match (0..names.len()).find(|idx| !known.contains(idx)) {
            Some(idx) => Err(Error::UnexpectedColumn { column: names[idx].to_owned() }),
            None => Ok(columns),
        }
    }
}

/// The data lines read so far.
#[derive(Default)]
struct Lines {
    line_numbers: Vec<u64>,
    times: Vec<f64>,
    values: Vec<f64>,
    unit: String,
    /// Most decimals in any stamp: how finely the stamps are rounded.
    decimals: i32,
}

impl Lines {
    fn push(&mut self, line: u64, record: &StringRecord, columns: &Columns) -> Result<(), Error> {
        let time = number(record, columns.time, line, "time_s")?;
        let value = number(record, columns.value, line, "value")?;
        let unit = &record[columns.unit];
        if time < 0.0 {
            return Err(Error::NegativeTime { line, found_s: time });
        }
        if let Some(&previous) = self.times.last().filter(|&&previous| time <= previous) {
            return Err(Error::TimeNotIncreasing { line, previous_s: previous, found_s: time });
        }
        if unit.is_empty() {
            return Err(Error::EmptyUnit { line });
        }
        if self.times.is_empty() {
            unit.clone_into(&mut self.unit);
        } else if unit != self.unit {
            return Err(Error::UnitChanged { line, expected: self.unit.clone(), found: unit.to_owned() });
        }
        self.decimals = self.decimals.max(decimals(&record[columns.time]));
        self.line_numbers.push(line);
        self.times.push(time);
        self.values.push(value);
        Ok(())
    }

    fn finish(self) -> Result<PulseRecording, Error> {
        if self.times.is_empty() {
            return Err(Error::EmptyFile { expected_header: HEADER });
        }
        if self.times.len() < 2 {
            return Err(Error::TooShort { required: 2, found: self.times.len() });
        }
        let sample_rate_hz = self.sample_rate_hz()?;
        PulseRecording::starting_at(self.times[0], Unit::from_symbol(&self.unit), sample_rate_hz, self.values)
    }

    fn sample_rate_hz(&self) -> Result<f64, Error> {
        let resolution = 10f64.powi(-self.decimals);
        let mut steps: Vec<f64> = self.times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let middle = steps.len() / 2;
        let median = *steps.select_nth_unstable_by(middle, f64::total_cmp).1;
        for (idx, pair) in self.times.windows(2).enumerate() {
            if (pair[1] - pair[0] - median).abs() > 0.5 * median + resolution {
                return Err(self.gap(idx + 1, pair[0] + median));
            }
        }
        let span = self.times[self.times.len() - 1] - self.times[0];
        let mean_rate = (self.times.len() - 1) as f64 / span;
        if let Some(idx) = self.first_off(mean_rate, 0.1 / mean_rate + resolution) {
            return Err(self.gap(idx, self.times[0] + idx as f64 / mean_rate));
        }
        let explains = |rate: &f64| *rate > 0.0 && self.first_off(*rate, resolution).is_none();
        Ok((0..MAX_RATE_DIGITS).map(|digits| rounded(mean_rate, digits)).find(explains).unwrap_or(mean_rate))
    }

    /// The first sample whose stamp is further than `tolerance` from uniform sampling at this rate.
    fn first_off(&self, rate: f64, tolerance: f64) -> Option<usize> {
        // Stamps are decimal fractions and only known to a few units in the last place of the binary number.
        let allowed = |time: f64| tolerance + 8.0 * f64::EPSILON * time;
        let expected = |idx: usize| self.times[0] + idx as f64 / rate;
        let mut stamps = self.times.iter().enumerate();
        stamps.find(|&(idx, &time)| (time - expected(idx)).abs() > allowed(time)).map(|(idx, _)| idx)
    }

    fn gap(&self, idx: usize, expected_s: f64) -> Error {
        Error::TimeGap {
            line: self.line_numbers[idx],
            previous_s: self.times[idx - 1],
            expected_s: rounded(expected_s, 9),
            found_s: self.times[idx],
        }
    }
}

fn number(record: &StringRecord, idx: usize, line: u64, column: &'static str) -> Result<f64, Error> {
    let text = &record[idx];
    let parsed = text.parse::<f64>().ok().filter(|value| value.is_finite());
    parsed.ok_or_else(|| Error::NotANumber { line, column, text: text.chars().take(40).collect() })
}

/// Decimals of a printed number, counting its exponent: `1.25e-3` has 5.
fn decimals(text: &str) -> i32 {
    let (mantissa, exponent) = text.split_once(['e', 'E']).unwrap_or((text, "0"));
    let places = mantissa.split_once('.').map_or(0, |(_, fraction)| fraction.len());
    i32::try_from(places).unwrap_or(i32::MAX).saturating_sub(exponent.parse().unwrap_or(0)).clamp(0, 300)
}

/// The value with `digits + 1` significant digits.
fn rounded(value: f64, digits: usize) -> f64 {
    format!("{value:.digits$e}").parse().unwrap_or(value)
}

fn quoted(unit: &str) -> String {
    if unit.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", unit.replace('"', "\"\""))
    } else {
        unit.to_owned()
    }
}

fn from_csv(error: &csv::Error) -> Error {
    let line = error.position().map_or(0, csv::Position::line);
    match error.kind() {
        ErrorKind::Utf8 { .. } => Error::NotUtf8 { line },
        ErrorKind::Io(io) => Error::Io { kind: io.kind(), message: io.to_string() },
        other => {
            Error::Io { kind: std::io::ErrorKind::InvalidData, message: format!("line {line}: {other:?}") }
        }
    }
}

const HEADER: &str = "time_s,value,unit";
const MAX_RATE_DIGITS: usize = 12;

#[cfg(test)]
mod tests {
    use super::*;

    fn read_text(text: &str) -> Result<PulseRecording, Error> {
        read(text.as_bytes())
    }

    /// Stamps with four decimals at this rate.
    fn stamped(rate: f64, n: u32) -> String {
        let lines = (0..n).map(|i| format!("{:.4},{},mmHg\n", f64::from(i) / rate, i % 7));
        format!("{HEADER}\n{}", lines.collect::<String>())
    }

    #[test]
    fn law_the_rate_behind_rounded_stamps_is_found() {
        for rate in [125.0, 250.0, 1000.0, 20.0, 125.002, 62.4725, 360.0] {
            let recording = read_text(&stamped(rate, 15_000)).expect("uniform");
            assert_eq!(recording.sample_rate_hz(), rate);
        }
        // Six samples at 128 Hz cannot be told from 128.1 Hz, but not from 125 Hz either.
        let short = read_text(&stamped(128.0, 6)).expect("uniform").sample_rate_hz();
        assert!((short - 128.0).abs() < 0.4, "{short}");
    }

    #[test]
    fn law_round_trip_is_bit_exact() {
        let values: Vec<f64> =
            (0..4000).map(|i| (f64::from(i) * 0.1).sin() / 3.0 + 1e-300 * f64::from(i)).collect();
        for (start, rate) in [(0.0, 2000.0), (12.5, 125.0), (0.0, 125.002), (1e4, 333.25)] {
            let unit = Unit::Arbitrary("a,\"u\"".to_owned());
            let recording = PulseRecording::starting_at(start, unit, rate, values.clone()).expect("valid");
            let mut bytes = Vec::new();
            write(&recording, &mut bytes).expect("memory does not fail");
            assert_eq!(read(bytes.as_slice()).expect("reads back"), recording);
        }
    }

    #[test]
    fn law_column_order_and_byte_order_mark_do_not_matter() {
        let recording = read_text("\u{feff}unit,value,time_s\r\nPa,1.5,0\r\nPa,2.5,0.5\r\n").expect("valid");
        assert_eq!((recording.values(), recording.sample_rate_hz()), ([1.5, 2.5].as_slice(), 2.0));
    }

    #[test]
    fn edge_each_defect_names_its_line_and_column() {
        let head = "time_s,value,unit\n0.00,1,Pa\n0.01,2,Pa\n";
        let cases = [
            (String::new(), "the file is empty: expected the header `time_s,value,unit` and data lines"),
            (
                "time_s,value,unit\n".to_owned(),
                "the file is empty: expected the header `time_s,value,unit` and data lines",
            ),
            (
                "time_s,value\n0,1\n".to_owned(),
                "line 1: column `unit` is missing; the header has: time_s, value",
            ),
            ("0.0,1.0,Pa\n".to_owned(), "line 1: column `time_s` is missing; the header has: 0.0, 1.0, Pa"),
            (
                "time_s,value,unit,value\n".to_owned(),
                "line 1: unexpected column `value`; allowed are time_s, value, unit, each once",
            ),
            ("time_s,value,unit\n0,1,Pa\n".to_owned(), "expected at least 2 samples, found 1"),
            (format!("{head}0.02,NaN,Pa\n"), "line 4, column `value`: expected a finite number, found `NaN`"),
            (format!("{head}0.02,,Pa\n"), "line 4, column `value`: expected a finite number, found ``"),
            (format!("{head}inf,3,Pa\n"), "line 4, column `time_s`: expected a finite number, found `inf`"),
            (format!("{head}0.02,3\n"), "line 4: expected 3 fields, found 2"),
            (
                format!("{head}0.02,3,mmHg\n"),
                "line 4, column `unit`: expected `Pa` as on the first data line, found `mmHg`",
            ),
            (
                format!("{head}0.02,3,\n"),
                "line 4, column `unit`: expected a unit such as mmHg, Pa, mm, N, found nothing",
            ),
            (
                format!("{head}0.01,3,Pa\n"),
                "line 4, column `time_s`: expected a time after 0.01 s, found 0.01 s",
            ),
            (
                "time_s,value,unit\n-0.01,1,Pa\n".to_owned(),
                "line 2, column `time_s`: expected a time >= 0 s, found -0.01 s",
            ),
            (
                format!("{head}0.02,3,Pa\n0.05,4,Pa\n0.06,5,Pa\n"),
                "line 5, column `time_s`: expected about 0.03 s (one sample after 0.02 s), found 0.05 s",
            ),
        ];
        for (text, message) in cases {
            assert_eq!(read_text(&text).expect_err(message).to_string(), message);
        }
        assert_eq!(read([b't', 0xff, b'\n', b'x', b'\n'].as_slice()), Err(Error::NotUtf8 { line: 1 }));
    }

    #[test]
    fn edge_one_missing_sample_in_a_long_recording_is_a_gap() {
        let text = stamped(125.0, 5000);
        let cut: Vec<&str> =
            text.lines().enumerate().filter(|(idx, _)| *idx != 2001).map(|(_, line)| line).collect();
        let error = read_text(&cut.join("\n")).expect_err("a sample is missing");
        assert!(matches!(error, Error::TimeGap { line: 2002, .. }), "{error}");
    }

    #[test]
    fn edge_a_slowly_drifting_clock_is_refused() {
        let lines = (0..2000).map(|i| {
            let t = f64::from(i) / 100.0;
            format!("{:.6},0,Pa\n", t + 1e-3 * t * t)
        });
        let text = format!("{HEADER}\n{}", lines.collect::<String>());
        assert!(matches!(read_text(&text), Err(Error::TimeGap { .. })));
    }

    #[test]
    fn edge_a_failing_source_is_reported() {
        struct Broken;
        impl Read for Broken {
            fn read(&mut self, _: &mut [u8]) -> std::io::Result<usize> {
                Err(std::io::Error::other("unplugged"))
            }
        }
        assert!(matches!(read(Broken), Err(Error::Io { .. })));
    }
}
