//! What the model predicts for the records, and how that changes with the free parameters.

use nalgebra::{DMatrix, DVector};

use super::{FreeParameter, Record, Refusal, SweepRecord, TimeRecord};
use crate::frequency::MembraneResponse;
use crate::twin::{Inputs, Twin, TwinModel};
use crate::{ActuatorParameters, ActuatorSpec, Error};

/// Records beside the model whose parameters are sought.
pub(super) struct Prediction<'a> {
    pub(super) start: &'a ActuatorSpec,
    pub(super) free: &'a [FreeParameter],
    pub(super) records: &'a [Record],
}

/// Half width of the differences in a logarithm: the model is smooth and solved to 1e-12, so truncation (1e-8) and
/// rounding (1e-8) are even.
const DIFFERENCE: f64 = 1e-4;

impl Prediction<'_> {
    /// The actuator with these logarithms of the free parameters.
    pub(super) fn parameters(&self, logarithms: &DVector<f64>) -> Result<ActuatorParameters, Error> {
        let mut spec = self.start.clone();
        for (free, logarithm) in self.free.iter().zip(logarithms.iter()) {
            // The bounds themselves, not what rounding makes of them.
            free.quantity.set(&mut spec, logarithm.exp().clamp(free.lower, free.upper));
        }
        ActuatorParameters::new(spec)
    }

    /// (prediction - measurement)/noise of all records, in their order.
    pub(super) fn residual(&self, logarithms: &DVector<f64>) -> Result<DVector<f64>, Error> {
        self.residual_of(&self.parameters(logarithms)?)
    }

    /// As [`Prediction::residual`], for an actuator.
    fn residual_of(&self, parameters: &ActuatorParameters) -> Result<DVector<f64>, Error> {
        let mut all = Vec::new();
        let mut twin = None;
        for record in self.records {
            match record {
                Record::Sweep(sweep) => sweep_residual(sweep, parameters, &mut all)?,
                Record::Time(time) => {
                    let model = match twin.take() {
                        Some(model) => model,
                        None => TwinModel::new(parameters)?,
                    };
                    time_residual(time, &model, &mut all)?;
                    twin = Some(model);
                }
            }
        }
        Ok(DVector::from_vec(all))
    }

    /// Derivatives of the residual by the logarithms: central differences of a model that is smooth in them.
    pub(super) fn jacobian(&self, logarithms: &DVector<f64>) -> Result<DMatrix<f64>, Error> {
        let mut columns = Vec::with_capacity(logarithms.len());
        for (idx, free) in self.free.iter().enumerate() {
            let at = |offset: f64| {
                let mut spec = self.parameters(logarithms)?.spec().clone();
                free.quantity.set(&mut spec, (logarithms[idx] + offset).exp());
                self.residual_of(&ActuatorParameters::new(spec)?)
            };
            columns.push((at(DIFFERENCE)? - at(-DIFFERENCE)?) / (2.0 * DIFFERENCE));
        }
        Ok(DMatrix::from_columns(&columns))
    }
}

fn sweep_residual(
    record: &SweepRecord,
    parameters: &ActuatorParameters,
    into: &mut Vec<f64>,
) -> Result<(), Error> {
    let response = MembraneResponse::new(parameters, record.bias_v)?;
    for &(hz, measured) in &record.rows {
        let predicted = response.displacement_mm_per_unit(2.0 * std::f64::consts::PI * hz)?;
        let difference = (predicted - measured) / record.noise_mm_per_unit;
        into.extend([difference.re, difference.im]);
    }
    Ok(())
}

fn time_residual(record: &TimeRecord, model: &TwinModel, into: &mut Vec<f64>) -> Result<(), Error> {
    let mut twin = Twin::new(model);
    twin.settle(record.from_v);
    let mut now = 0.0;
    for &(time, measured) in &record.rows {
        twin.advance(time - now, Inputs { drive_v: record.to_v, disturbance_n: 0.0 });
        now = time;
        into.push((twin.displacement_mm() - measured) / record.noise_mm);
    }
    if twin.has_left_map() {
        let (record, reached_mm) = (record.name.clone(), twin.displacement_mm());
        return Err(Error::Calibration(Refusal::OutsideOfMaps { record, reached_mm }));
    }
    Ok(())
}
