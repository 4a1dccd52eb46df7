//! `telepulse membrane calibrate`: material parameters from a user's own records.

use std::path::PathBuf;

use anyhow::{Result, anyhow};
use clap::Args;
use serde::Serialize;
use telepulse_actuator::ActuatorParameters;
use telepulse_actuator::calibration::{Calibration, calibrate};

use super::super::{Verdict, answer, notify};
use super::calibration_case::CalibrationCase;

#[derive(Debug, Args)]
pub(super) struct CalibrateArguments {
    /// Case as JSON; `-` for standard input. docs/manual/membrane.md lists the keys.
    file: PathBuf,
}

#[derive(Debug, Serialize)]
struct Answer {
    parameters: ActuatorParameters,
    fitted: Vec<Fitted>,
    /// Of the logarithms, in the order of `fitted`.
    covariance: Vec<Vec<f64>>,
    correlation: Vec<Vec<f64>>,
    combinations: Vec<Combination>,
    records: Vec<RecordFit>,
    chi_squared: f64,
    degrees_of_freedom: usize,
    /// Whether the model meets the records to their stated noise.
    meets_records: bool,
    iterations: usize,
}

#[derive(Debug, Serialize)]
struct Fitted {
    key: String,
    value: f64,
    /// Null at a bound.
    standard_error: Option<f64>,
    relative_standard_error: Option<f64>,
    at_bound: bool,
    /// Whether one standard error is less than half of the value.
    determined: bool,
}

#[derive(Debug, Serialize)]
struct Combination {
    name: String,
    singular_value: f64,
    standard_error: f64,
    determined: bool,
    exponents: Vec<f64>,
}

#[derive(Debug, Serialize)]
struct RecordFit {
    name: String,
    n_values: usize,
    rms_over_noise: f64,
    largest_over_noise: f64,
}

pub(super) fn run(typed: &CalibrateArguments, json: bool) -> Result<Verdict> {
    let case = CalibrationCase::read(&typed.file)?;
    let found = calibrate(&case.start, &case.free, &case.records)
        .map_err(|error| anyhow!("in {}: {error}", case.name))?;
    let answered = Answer::new(&found);
    if !answered.meets_records {
        notify(
            "telepulse: the model does not meet the records to their stated noise: standard errors are too small",
        );
    }
    answer(json, &answered, || lines(&answered))?;
    Ok(Verdict::Done)
}

impl Answer {
    fn new(found: &Calibration) -> Self {
        let keys = found.keys();
        let rows = |matrix: &nalgebra::DMatrix<f64>| -> Vec<Vec<f64>> {
            matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
        };
        Self {
            parameters: found.parameters.clone(),
            fitted: found
                .fitted
                .iter()
                .map(|fitted| Fitted {
                    key: fitted.quantity.key(),
                    value: fitted.value,
                    standard_error: fitted.relative_standard_error.map(|relative| relative * fitted.value),
                    relative_standard_error: fitted.relative_standard_error,
                    at_bound: fitted.is_at_bound,
                    determined: fitted
                        .relative_standard_error
                        .is_some_and(|relative| relative < telepulse_actuator::calibration::DETERMINED_BELOW),
                })
                .collect(),
            covariance: rows(&found.covariance),
            correlation: rows(&found.correlation),
            combinations: found
                .combinations
                .iter()
                .map(|combination| Combination {
                    name: combination.name(&keys),
                    singular_value: combination.singular_value,
                    standard_error: combination.standard_error,
                    determined: combination.is_determined,
                    exponents: combination.exponents.clone(),
                })
                .collect(),
            records: found
                .records
                .iter()
                .map(|record| RecordFit {
                    name: record.name.clone(),
                    n_values: record.n_values,
                    rms_over_noise: record.rms_over_noise,
                    largest_over_noise: record.largest_over_noise,
                })
                .collect(),
            chi_squared: found.chi_squared,
            degrees_of_freedom: found.degrees_of_freedom,
            meets_records: found.meets_records(),
            iterations: found.iterations,
        }
    }
}

fn lines(found: &Answer) -> Vec<String> {
    let mut lines: Vec<String> = found
        .fitted
        .iter()
        .map(|fitted| match fitted.relative_standard_error {
            _ if fitted.at_bound => format!("{} = {} (at its bound)", fitted.key, fitted.value),
            Some(relative) => format!("{} = {} +- {:.2} %", fitted.key, fitted.value, 100.0 * relative),
            None => format!("{} = {}", fitted.key, fitted.value),
        })
        .collect();
    lines.extend(found.combinations.iter().filter(|combination| !combination.determined).map(
        |combination| {
            format!("not determined: {} (standard error {:.2})", combination.name, combination.standard_error)
        },
    ));
    lines.extend(found.records.iter().map(|record| {
        format!(
            "{}: {} values, {:.3} of the noise rms, largest {:.3}",
            record.name, record.n_values, record.rms_over_noise, record.largest_over_noise
        )
    }));
    lines.push(format!(
        "chi squared {:.2} for {} degrees of freedom",
        found.chi_squared, found.degrees_of_freedom
    ));
    lines
}
