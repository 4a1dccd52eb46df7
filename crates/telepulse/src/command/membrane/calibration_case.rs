//! Case files of `telepulse membrane calibrate`: where the fit starts, what is free, and the records.

use std::path::Path;

use anyhow::{Context, Result, anyhow, bail, ensure};
use nalgebra::Complex;
use serde_json::{Map, Value};
use telepulse_actuator::calibration::{
    FreeParameter, Quantity, Record, SweepRecord, TimeRecord, printed_sweep,
};
use telepulse_actuator::{ActuatorParameters, ParameterSet};

use super::case::{number, read_fields};
use crate::artefact;

/// A checked case.
#[derive(Debug)]
pub(super) struct CalibrationCase {
    /// Where it came from, for messages.
    pub(super) name: String,
    pub(super) start: ActuatorParameters,
    pub(super) free: Vec<FreeParameter>,
    pub(super) records: Vec<Record>,
}

impl CalibrationCase {
    /// Reads a file, or standard input where the path is `-`. Files of records are sought beside it.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let (fields, name) = read_fields(path)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        Self::from_fields(&fields, folder, &name).map_err(|error| anyhow!("in {name}: {error:#}"))
    }

    fn from_fields(fields: &Map<String, Value>, folder: &Path, name: &str) -> Result<Self> {
        only_known(fields, &["start", "free", "records", "name", "note"])?;
        let start = actuator(fields, "start")?;
        let Some(Value::Array(free)) = fields.get("free") else {
            bail!("key `free` is missing or no list, expected names of parameters to fit");
        };
        ensure!(!free.is_empty(), "key `free`: found an empty list, expected names of parameters to fit");
        let free = free.iter().map(|entry| free_parameter(entry, &start)).collect::<Result<Vec<_>>>()?;
        let Some(Value::Array(records)) = fields.get("records") else {
            bail!("key `records` is missing or no list, expected sweeps, steps or creeps");
        };
        let records = records
            .iter()
            .enumerate()
            .map(|(idx, entry)| record(entry, idx, folder))
            .collect::<Result<Vec<_>>>()?;
        Ok(Self { name: name.to_owned(), start, free, records })
    }
}

/// Refuses keys that mean nothing.
pub(super) fn only_known(fields: &Map<String, Value>, known: &[&str]) -> Result<()> {
    match fields.keys().find(|key| !known.contains(&key.as_str())) {
        Some(key) => bail!("key `{key}` has no meaning here, expected one of {}", known.join(", ")),
        None => Ok(()),
    }
}

/// A built-in parameter set by name, or all numbers of an actuator.
pub(super) fn actuator(fields: &Map<String, Value>, key: &str) -> Result<ActuatorParameters> {
    match fields.get(key) {
        None | Some(Value::Null) => {
            bail!("key `{key}` is missing, expected \"A\", \"B\", \"C\" or an actuator")
        }
        Some(value @ Value::String(_)) => match serde_json::from_value::<ParameterSet>(value.clone()) {
            Ok(set) => Ok(set.parameters()),
            Err(_) => bail!("key `{key}`: found {value}, expected \"A\", \"B\", \"C\" or an actuator"),
        },
        Some(value) => serde_json::from_value(value.clone()).map_err(|error| anyhow!("key `{key}`: {error}")),
    }
}

/// A name, or an object with `key` and `bounds`.
fn free_parameter(entry: &Value, start: &ActuatorParameters) -> Result<FreeParameter> {
    let spec = start.spec();
    let (key, bounds) = match entry {
        Value::String(key) => (key.as_str(), None),
        Value::Object(fields) => {
            only_known(fields, &["key", "bounds"]).context("key `free`")?;
            let key = fields.get("key").and_then(Value::as_str);
            (key.context("key `free`: `key` is missing or no word")?, fields.get("bounds"))
        }
        other => bail!("key `free`: expected names, or objects with `key` and `bounds`, found {other}"),
    };
    let Some(quantity) = Quantity::from_key(key, spec) else {
        let known: Vec<String> = Quantity::all(spec).into_iter().map(Quantity::key).collect();
        bail!("key `free`: parameter `{key}` is unknown for this start, expected {}", known.join(", "));
    };
    let Some(bounds) = bounds else { return Ok(FreeParameter::about(quantity, spec)?) };
    match bounds.as_array().map(|both| both.iter().map(Value::as_f64).collect::<Vec<_>>()).as_deref() {
        Some([Some(lower), Some(upper)]) => Ok(FreeParameter { quantity, lower: *lower, upper: *upper }),
        _ => bail!("key `free`, parameter `{key}`: expected `bounds` [lower, upper], found {bounds}"),
    }
}

fn record(entry: &Value, idx: usize, folder: &Path) -> Result<Record> {
    let Value::Object(fields) = entry else {
        bail!("key `records`, entry {}: expected an object with `kind`, found {entry}", idx + 1);
    };
    let name = fields.get("name").and_then(Value::as_str);
    let name = name.map_or_else(|| format!("{}", idx + 1), str::to_owned);
    let inside = |error: anyhow::Error| anyhow!("record `{name}`, {error:#}");
    let value = |key: &str| number(fields, key).map_err(inside);
    let kind = fields.get("kind").and_then(Value::as_str);
    match kind {
        Some("printed") => {
            only_known(fields, &["kind", "name", "bias_v", "noise_mm_per_unit"]).map_err(inside)?;
            Ok(Record::Sweep(printed_sweep(value("bias_v")?, value("noise_mm_per_unit")?)))
        }
        Some("sweep") => {
            only_known(fields, &["kind", "name", "bias_v", "noise_mm_per_unit", "rows", "file"])
                .map_err(inside)?;
            let rows = rows(fields, folder, SWEEP_KEYS).map_err(inside)?;
            Ok(Record::Sweep(SweepRecord {
                bias_v: value("bias_v")?,
                noise_mm_per_unit: value("noise_mm_per_unit")?,
                rows: rows
                    .into_iter()
                    .map(|[hz, size, degrees]| (hz, Complex::from_polar(size, degrees.to_radians())))
                    .collect(),
                name,
            }))
        }
        Some("step" | "creep") => {
            only_known(fields, &["kind", "name", "from_v", "to_v", "noise_mm", "rows", "file"])
                .map_err(inside)?;
            let rows = rows(fields, folder, TIME_KEYS).map_err(inside)?;
            Ok(Record::Time(TimeRecord {
                from_v: if fields.contains_key("from_v") { value("from_v")? } else { 0.0 },
                to_v: value("to_v")?,
                noise_mm: value("noise_mm")?,
                rows: rows.into_iter().map(|[time, displacement]| (time, displacement)).collect(),
                name,
            }))
        }
        _ => bail!(
            "record `{name}`, key `kind`: expected \"sweep\", \"step\", \"creep\" or \"printed\", found {}",
            fields.get("kind").unwrap_or(&Value::Null)
        ),
    }
}

/// Columns of a sweep.
const SWEEP_KEYS: [&str; 3] = ["frequency_hz", "magnitude", "phase_deg"];
/// Columns of a step or of creep.
const TIME_KEYS: [&str; 2] = ["time_s", "displacement_mm"];

/// Rows of a record: in the case itself, or in a CSV file with these columns among others.
fn rows<const N: usize>(
    fields: &Map<String, Value>,
    folder: &Path,
    keys: [&str; N],
) -> Result<Vec<[f64; N]>> {
    match (fields.get("rows"), fields.get("file")) {
        (Some(Value::Array(rows)), None) => {
            rows.iter().enumerate().map(|(idx, row)| listed(row, idx + 1, keys)).collect()
        }
        (None, Some(Value::String(file))) => columns(&folder.join(file), keys),
        (None, None) => bail!("key `rows` or `file` is missing: [{}] in each row", keys.join(", ")),
        (Some(_), Some(_)) => bail!("keys `rows` and `file`: give one"),
        (Some(other), None) | (None, Some(other)) => {
            bail!("key `rows` or `file`: expected a list of rows, or a file's name, found {other}")
        }
    }
}

fn listed<const N: usize>(row: &Value, number: usize, keys: [&str; N]) -> Result<[f64; N]> {
    let found = row.as_array().filter(|values| values.len() == N);
    let found = found
        .with_context(|| format!("key `rows`, row {number}: expected [{}], found {row}", keys.join(", ")))?;
    let mut values = [0.0; N];
    for ((value, key), found) in values.iter_mut().zip(keys).zip(found) {
        *value = found.as_f64().with_context(|| {
            format!("key `{key}`, row {number}: found {found}, must be a number: no value was measured here")
        })?;
    }
    Ok(values)
}

/// Columns of a CSV file by their heads; rows count from 1 below the head.
fn columns<const N: usize>(path: &Path, keys: [&str; N]) -> Result<Vec<[f64; N]>> {
    let text = artefact::read_text(path).map_err(|error| anyhow!("key `file`: {error:#}"))?;
    let place = path.display();
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_bytes());
    let heads = reader.headers().with_context(|| format!("key `file`: {place} has no head"))?.clone();
    let mut at = [0; N];
    for (column, key) in at.iter_mut().zip(keys) {
        let found = heads.iter().position(|head| head == key);
        *column = found.with_context(|| format!("key `file`: {place} has no column `{key}`"))?;
    }
    let mut rows = Vec::new();
    for (idx, line) in reader.records().enumerate() {
        let line = line.map_err(|error| anyhow!("key `file`: {place}, row {}: {error}", idx + 1))?;
        let mut values = [0.0; N];
        for ((value, key), column) in values.iter_mut().zip(keys).zip(at) {
            let found = &line[column];
            let parsed: Option<f64> = found.parse().ok();
            *value = parsed.with_context(|| {
                format!("key `{key}`, row {} of {place}: found `{found}`, must be a number: no value was measured here", idx + 1)
            })?;
        }
        rows.push(values);
    }
    ensure!(!rows.is_empty(), "key `file`: {place} has no rows");
    Ok(rows)
}
