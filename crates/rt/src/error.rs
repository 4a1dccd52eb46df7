//! Why a controller, filter, loop or supervisor could not be built.

use crate::LimitsError;

/// A setting that this crate refuses. Nothing here can arise during a tick: see [`TripReason`](crate::TripReason).
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Error {
    /// The voltage limits are not usable.
    #[error(transparent)]
    Limits(#[from] LimitsError),
    /// More modes than the fixed capacity holds.
    #[error("controller has {found} {kind} modes, at most {capacity} are allowed")]
    TooManyModes {
        /// `real` or `complex`.
        kind: &'static str,
        /// Modes given.
        found: usize,
        /// Modes that fit.
        capacity: usize,
    },
    /// A setting is NaN or infinite.
    #[error("{name} must be a finite number, found {value}")]
    NotFinite {
        /// The setting, with its unit.
        name: &'static str,
        /// The value found.
        value: f64,
    },
    /// A setting is not finite and greater than zero.
    #[error("{name} must be finite and greater than zero, found {value}")]
    NotPositive {
        /// The setting, with its unit.
        name: &'static str,
        /// The value found.
        value: f64,
    },
    /// A setting is not finite and at least zero.
    #[error("{name} must be finite and at least zero, found {value}")]
    Negative {
        /// The setting, with its unit.
        name: &'static str,
        /// The value found.
        value: f64,
    },
    // ---- relay experiment ----
    /// Bias and steps of a relay experiment leave the range of commands.
    #[error("relay commands {low} to {high} leave the range {command_min} to {command_max}")]
    RelayRange {
        /// Bias less the step down.
        low: f64,
        /// Bias plus the step up.
        high: f64,
        /// Lowest command allowed.
        command_min: f64,
        /// Highest command allowed.
        command_max: f64,
    },
    /// A number of relay cycles that cannot agree or be kept.
    #[error("relay cycles that have to agree must be 2 to {capacity}, found {found}")]
    RelayCycles {
        /// Cycles asked for.
        found: usize,
        /// Cycles that are kept.
        capacity: usize,
    },
}

pub(crate) fn finite(name: &'static str, value: f64) -> Result<f64, Error> {
    if value.is_finite() { Ok(value) } else { Err(Error::NotFinite { name, value }) }
}

pub(crate) fn positive(name: &'static str, value: f64) -> Result<f64, Error> {
    if value.is_finite() && value > 0.0 { Ok(value) } else { Err(Error::NotPositive { name, value }) }
}

pub(crate) fn not_negative(name: &'static str, value: f64) -> Result<f64, Error> {
    if value.is_finite() && value >= 0.0 { Ok(value) } else { Err(Error::Negative { name, value }) }
}
