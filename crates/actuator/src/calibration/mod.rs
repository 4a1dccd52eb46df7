//! Material parameters from a user's own records: sweep at a bias, step, creep.

mod free;
mod identifiability;
mod least_squares;
mod prediction;
mod printed_plant;
mod record;
mod refusal;

pub use free::{FreeParameter, Quantity};
pub use identifiability::{Combination, DETERMINED_BELOW};
pub use printed_plant::{printed_response, printed_sweep};
pub use record::{Record, SweepRecord, TimeRecord};
pub use refusal::Refusal;

use nalgebra::{DMatrix, DVector};

use crate::{ActuatorParameters, Error};
use least_squares::{Problem, minimize};
use prediction::Prediction;

/// A fitted number.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    /// What was fitted.
    pub quantity: Quantity,
    /// Its value, in its own unit.
    pub value: f64,
    /// Standard error of its logarithm, so relative: from the stated noise, to first order. Far above 1 where the records do
    /// not determine it, absent where it stands at a bound.
    pub relative_standard_error: Option<f64>,
    /// Whether the records push it against a bound.
    pub is_at_bound: bool,
}

/// How well one record is met.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordFit {
    /// Name of the record.
    pub name: String,
    /// Values in it.
    pub n_values: usize,
    /// Root mean square of (prediction - measurement)/noise: about 1 where the model holds and the noise is as stated.
    pub rms_over_noise: f64,
    /// Largest magnitude of the same.
    pub largest_over_noise: f64,
}

/// Outcome of a calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// The actuator with its fitted parameters.
    pub parameters: ActuatorParameters,
    /// The fitted numbers, in the order asked for.
    pub fitted: Vec<Fitted>,
    /// Covariance of the logarithms of the fitted numbers, from the stated noise.
    pub covariance: DMatrix<f64>,
    /// Correlation coefficients of the same.
    pub correlation: DMatrix<f64>,
    /// Combinations of the fitted numbers, best known first; parameters at a bound take no part.
    pub combinations: Vec<Combination>,
    /// Every record beside the model.
    pub records: Vec<RecordFit>,
    /// Sum of ((prediction - measurement)/noise)^2.
    pub chi_squared: f64,
    /// Values less parameters that were free to move.
    pub degrees_of_freedom: usize,
    /// Iterations of the fit.
    pub iterations: usize,
}

impl Calibration {
    /// Names of the fitted numbers.
    #[must_use]
    pub fn keys(&self) -> Vec<String> {
        self.fitted.iter().map(|fitted| fitted.quantity.key()).collect()
    }

    /// Combinations that the records do not determine.
    pub fn undetermined(&self) -> impl Iterator<Item = &Combination> {
        self.combinations.iter().filter(|combination| !combination.is_determined)
    }

    /// Whether the records can be met to their noise by any such model: chi squared is below its mean by chance plus five
    /// standard deviations.
    #[must_use]
    pub fn meets_records(&self) -> bool {
        let mean = self.degrees_of_freedom as f64;
        self.chi_squared <= mean + 5.0 * (2.0 * mean).sqrt()
    }
}

/// Fits `free` parameters of the actuator to `records`, from their values in `start`.
///
/// **Method**: least squares of (prediction - measurement)/noise in the logarithms of the parameters, within bounds
/// (Levenberg-Marquardt as a trust region, with an active set). A sweep is predicted by the full viscoelastic membrane
/// ([`MembraneResponse`](crate::frequency::MembraneResponse)), a time record by the reduced twin. Derivatives are central
/// differences in the logarithms of a model solved to 1e-12, good to 1e-7.
///
/// **Accuracy**: standard errors are of first order in the noise and hold where it is independent, Gaussian and as stated.
/// The reduced twin's own error, under 0.1 % of a stroke for set A, is not in them. The minimum is the one that the start leads to.
///
/// # Errors
/// [`Error::Calibration`] with record, key, value and row, or with the free parameter; the membrane's own where the start has no
/// equilibrium.
///
/// **Example**
/// ```
/// use telepulse_actuator::ParameterSet;
/// use telepulse_actuator::calibration::{FreeParameter, Quantity, Record, calibrate, printed_sweep};
/// let mut start = ParameterSet::C.parameters().spec().clone();
/// start.mu_pa = 30e3;
/// let free = [Quantity::ShearModulus, Quantity::Permittivity, Quantity::Damping]
///     .map(|quantity| FreeParameter::about(quantity, &start));
/// let free = free.into_iter().collect::<Result<Vec<_>, _>>()?;
/// let printed = Record::Sweep(printed_sweep(2500.0, 1e-3));
/// let start = telepulse_actuator::ActuatorParameters::new(start)?;
/// let found = calibrate(&start, &free, &[printed])?;
/// assert!((found.parameters.spec().mu_pa / 38_635.0 - 1.0).abs() < 1e-4);
/// # Ok::<(), telepulse_actuator::Error>(())
/// ```
pub fn calibrate(
    start: &ActuatorParameters,
    free: &[FreeParameter],
    records: &[Record],
) -> Result<Calibration, Error> {
    check(start, free, records)?;
    let prediction = Prediction { start: start.spec(), free, records };
    let logarithms = |of: &dyn Fn(&FreeParameter) -> f64| {
        DVector::from_iterator(free.len(), free.iter().map(|parameter| of(parameter).ln()))
    };
    let problem = Problem {
        residual: |at: &DVector<f64>| prediction.residual(at),
        jacobian: |at: &DVector<f64>| prediction.jacobian(at),
        lower: logarithms(&|parameter| parameter.lower),
        upper: logarithms(&|parameter| parameter.upper),
    };
    let from = logarithms(&|parameter| parameter.quantity.value(start.spec()).unwrap_or(f64::NAN));
    let minimum = minimize(from, &problem)?;
    let known = identifiability::identifiability(&minimum.jacobian, &minimum.held);
    let parameters = prediction.parameters(&minimum.parameters)?;
    let fitted = free.iter().enumerate().map(|(idx, parameter)| Fitted {
        quantity: parameter.quantity,
        value: parameter.quantity.value(parameters.spec()).unwrap_or(f64::NAN),
        relative_standard_error: (!minimum.held[idx]).then(|| known.covariance[(idx, idx)].sqrt()),
        is_at_bound: minimum.held[idx],
    });
    let n_moving = minimum.held.iter().filter(|held| !**held).count();
    Ok(Calibration {
        fitted: fitted.collect(),
        correlation: identifiability::correlation(&known.covariance),
        covariance: known.covariance,
        combinations: known.combinations,
        records: record_fits(records, minimum.residual.as_slice()),
        chi_squared: minimum.residual.norm_squared(),
        degrees_of_freedom: minimum.residual.len().saturating_sub(n_moving),
        iterations: minimum.iterations,
        parameters,
    })
}

fn check(start: &ActuatorParameters, free: &[FreeParameter], records: &[Record]) -> Result<(), Error> {
    for (idx, parameter) in free.iter().enumerate() {
        parameter.check(start.spec())?;
        if free[..idx].iter().any(|other| other.quantity == parameter.quantity) {
            let (key, found) = (parameter.quantity.key(), (idx + 1) as f64);
            let reason = "as its place in the list, but it is already in the list";
            return Err(Error::Calibration(Refusal::Free { key, found, reason }));
        }
    }
    for record in records {
        record.check(start.spec().full_scale_v)?;
    }
    let n_values = records.iter().map(Record::n_values).sum();
    if free.is_empty() || n_values < free.len() {
        return Err(Error::Calibration(Refusal::TooFew { n_values, n_free: free.len() }));
    }
    Ok(())
}

fn record_fits(records: &[Record], mut residual: &[f64]) -> Vec<RecordFit> {
    records
        .iter()
        .map(|record| {
            let (own, rest) = residual.split_at(record.n_values());
            residual = rest;
            let sum: f64 = own.iter().map(|value| value * value).sum();
            RecordFit {
                name: record.name().to_owned(),
                n_values: own.len(),
                rms_over_noise: (sum / own.len() as f64).sqrt(),
                largest_over_noise: own.iter().fold(0.0, |largest: f64, value| largest.max(value.abs())),
            }
        })
        .collect()
}
