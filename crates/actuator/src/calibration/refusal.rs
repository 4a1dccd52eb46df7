//! Why records or free parameters were refused, or a fit did not end.

use thiserror::Error;

/// What keeps a calibration from running or from ending, with the values that show it.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum Refusal {
    /// A row of a record cannot be used. Rows count from 1.
    #[error("record `{record}`, key `{key}`, row {row}: found {found}, {reason}")]
    Row {
        /// Name of the record.
        record: String,
        /// Which of the row's values, as in files.
        key: &'static str,
        /// Row, the first is 1.
        row: usize,
        /// What was found there.
        found: f64,
        /// What is allowed, and why.
        reason: &'static str,
    },
    /// A number that belongs to a whole record cannot be used.
    #[error("record `{record}`, key `{key}`: found {found}, {reason}")]
    Setting {
        /// Name of the record.
        record: String,
        /// Key, as in files.
        key: &'static str,
        /// What was found.
        found: f64,
        /// What is allowed, and why.
        reason: &'static str,
    },
    /// A parameter cannot be fitted from this start or within these bounds.
    #[error("key `free`, parameter `{key}`: found {found}, {reason}")]
    Free {
        /// The parameter.
        key: String,
        /// What was found.
        found: f64,
        /// What is allowed, and why.
        reason: &'static str,
    },
    /// There are fewer values in the records than parameters to fit.
    #[error(
        "key `records`: found {n_values} values for {n_free} free parameters, at least as many are needed"
    )]
    TooFew {
        /// Values in all records; a row of a sweep has two.
        n_values: usize,
        /// Free parameters.
        n_free: usize,
    },
    /// The reduced twin left the range of its maps in a time record.
    #[error(
        "record `{record}`: the plate leaves the range of the reduced twin, found {reached_mm} mm from rest"
    )]
    OutsideOfMaps {
        /// Name of the record.
        record: String,
        /// Displacement at the last row, mm.
        reached_mm: f64,
    },
    /// The iteration ended without a minimum.
    #[error(
        "no minimum after {iterations} iterations: last step {last_step} in the logarithms, residual {rms} rms of the noise; \
         the records may pull the parameters to where the membrane has no equilibrium: narrow the bounds or free fewer"
    )]
    NotConverged {
        /// Iterations made.
        iterations: usize,
        /// Length of the last step in the logarithms.
        last_step: f64,
        /// Root mean square of the weighted residuals.
        rms: f64,
    },
}
