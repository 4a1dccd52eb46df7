//! Drives of `telepulse membrane simulate`: step, sine, or a table from a file.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail, ensure};
use serde_json::{Map, Value};

use super::case::{number, present};

/// A voltage as a function of time.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Drive {
    Step {
        voltage_v: f64,
        start_s: f64,
    },
    Sine {
        offset_v: f64,
        amplitude_v: f64,
        frequency_hz: f64,
        phase_rad: f64,
    },
    /// Each voltage is held until the next time.
    Table {
        time_s: Vec<f64>,
        voltage_v: Vec<f64>,
    },
}

/// Longest table, rows.
const ROWS_MAX: usize = 10_000_000;

impl Drive {
    /// Reads key `drive`; files are sought beside the case.
    pub(super) fn parse(fields: &Map<String, Value>, folder: &Path, full_scale_v: f64) -> Result<Self> {
        let expected = "an object with `shape`: \"step\", \"sine\" or \"csv\"";
        let found = match fields.get("drive") {
            Some(Value::Object(found)) => found,
            None | Some(Value::Null) => bail!("key `drive` is missing, expected {expected}"),
            Some(other) => bail!("key `drive`: expected {expected}, found {other}"),
        };
        let inside = |error: anyhow::Error| anyhow!("key `drive`: {error}");
        let value = |key: &str| number(found, key).map_err(inside);
        let or = |key: &str, default: f64| if present(found, key) { value(key) } else { Ok(default) };
        let (drive, known): (Self, &[&str]) = match found.get("shape").and_then(Value::as_str) {
            Some("step") => (
                Self::Step { voltage_v: value("voltage_v")?, start_s: or("start_s", 0.0)? },
                &["voltage_v", "start_s"],
            ),
            Some("sine") => (
                Self::Sine {
                    offset_v: value("offset_v")?,
                    amplitude_v: value("amplitude_v")?,
                    frequency_hz: value("frequency_hz")?,
                    phase_rad: or("phase_rad", 0.0)?,
                },
                &["offset_v", "amplitude_v", "frequency_hz", "phase_rad"],
            ),
            Some("csv") => {
                let Some(file) = found.get("file").and_then(Value::as_str) else {
                    bail!(
                        "key `drive`: `file` is missing or no text, expected a CSV with `time_s,voltage_v`"
                    );
                };
                (table(&folder.join(PathBuf::from(file)))?, &["file"])
            }
            Some(other) => bail!("key `drive`: `shape` \"{other}\" is unknown, expected step, sine or csv"),
            None => bail!("key `drive`: expected {expected}"),
        };
        for key in found.keys().filter(|key| *key != "shape" && !found[*key].is_null()) {
            ensure!(known.contains(&key.as_str()), "key `drive`: `{key}` has no meaning for this `shape`");
        }
        drive.check(full_scale_v)?;
        Ok(drive)
    }

    fn check(&self, full_scale_v: f64) -> Result<()> {
        if let Self::Sine { offset_v, amplitude_v, frequency_hz, phase_rad } = self {
            ensure!(
                *frequency_hz > 0.0 && frequency_hz.is_finite() && phase_rad.is_finite(),
                "key `drive`: `frequency_hz` must be positive and finite, found {frequency_hz}"
            );
            let (low, high) = (offset_v - amplitude_v.abs(), offset_v + amplitude_v.abs());
            within("`offset_v` less `amplitude_v`", low, full_scale_v)?;
            return within("`offset_v` plus `amplitude_v`", high, full_scale_v);
        }
        match self {
            Self::Step { voltage_v, start_s } => {
                ensure!(
                    *start_s >= 0.0,
                    "key `drive`: `start_s` must not be negative, found {start_s}: a run starts at rest"
                );
                within("`voltage_v`", *voltage_v, full_scale_v)
            }
            Self::Table { voltage_v, .. } => voltage_v.iter().enumerate().try_for_each(|(row, v)| {
                within(&format!("`voltage_v` in row {}", row + 1), *v, full_scale_v)
            }),
            Self::Sine { .. } => Ok(()),
        }
    }

    /// How long the drive itself lasts, s, if it ends.
    pub(super) fn duration_s(&self) -> Option<f64> {
        match self {
            Self::Table { time_s, .. } => time_s.last().copied(),
            _ => None,
        }
    }

    /// The voltages of `n` intervals, each taken at the interval's middle and held over it.
    pub(super) fn voltages(&self, interval_s: f64, n: usize) -> Vec<f64> {
        let middles = (0..n).map(|k| (k as f64 + 0.5) * interval_s);
        match self {
            Self::Step { voltage_v, start_s } => {
                middles.map(|t| if t >= *start_s { *voltage_v } else { 0.0 }).collect()
            }
            Self::Sine { offset_v, amplitude_v, frequency_hz, phase_rad } => middles
                .map(|t| {
                    let sine = (std::f64::consts::TAU * frequency_hz * t + phase_rad).sin();
                    // Rounding must not make a negative voltage of a sine that touches zero.
                    (offset_v + amplitude_v * sine).max(0.0)
                })
                .collect(),
            Self::Table { time_s, voltage_v } => middles
                .map(|t| match time_s.partition_point(|start| *start <= t) {
                    0 => voltage_v[0],
                    after => voltage_v[after - 1],
                })
                .collect(),
        }
    }
}

fn within(what: &str, found: f64, full_scale_v: f64) -> Result<()> {
    ensure!(
        found >= 0.0 && found <= full_scale_v,
        "key `drive`: {what} must lie within 0 and `full_scale_v` = {full_scale_v} V, found {found}: force goes with the \
         square of the voltage, and the amplifier ends there"
    );
    Ok(())
}

fn table(file: &Path) -> Result<Drive> {
    let place = file.display();
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_path(file)
        .with_context(|| format!("key `drive`: cannot read {place}"))?;
    let header = reader.headers().with_context(|| format!("key `drive`: in {place}"))?;
    ensure!(
        header.iter().eq(["time_s", "voltage_v"]),
        "key `drive`: in {place}: expected the columns time_s,voltage_v, found {}",
        header.iter().collect::<Vec<_>>().join(",")
    );
    let (mut time_s, mut voltage_v): (Vec<f64>, Vec<f64>) = (Vec::new(), Vec::new());
    for row in reader.deserialize::<(f64, f64)>() {
        let (t, v) = row.map_err(|error| anyhow!("key `drive`: in {place}: {error}"))?;
        let row = time_s.len() + 1;
        ensure!(
            t.is_finite() && time_s.last().is_none_or(|last| t > *last),
            "key `drive`: in {place}: `time_s` must rise from row to row, found {t} in row {row}"
        );
        ensure!(v.is_finite(), "key `drive`: in {place}: `voltage_v` must be finite, found {v} in row {row}");
        ensure!(row <= ROWS_MAX, "key `drive`: in {place}: at most {ROWS_MAX} rows are read");
        time_s.push(t);
        voltage_v.push(v);
    }
    ensure!(!time_s.is_empty(), "key `drive`: in {place}: expected rows of time_s,voltage_v, found none");
    Ok(Drive::Table { time_s, voltage_v })
}
