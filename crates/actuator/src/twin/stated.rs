//! The error of the reduced twin against the field-level model, measured by whoever builds it.

use super::{Inputs, Twin, TwinModel};
use crate::field::FieldTwin;
use crate::{ActuatorParameters, Error};

/// Largest difference between the reduced twin and the field-level model, over two motions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StatedError {
    /// A step from rest to full scale.
    pub step: MotionError,
    /// Voltages that would hold the reference (25) of the paper, about its offset, if it moved slowly.
    pub reference: MotionError,
}

/// Largest difference over one motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionError {
    /// Largest difference of displacements, mm.
    pub max_mm: f64,
    /// Largest displacement from rest of the field-level model, mm.
    pub stroke_mm: f64,
}

impl MotionError {
    /// Difference in percent of the stroke.
    #[must_use]
    pub fn percent_of_stroke(&self) -> f64 {
        100.0 * self.max_mm / self.stroke_mm
    }
}

/// Interval over which the drive is held, s, and field-level steps taken.
const INTERVAL_S: f64 = 4e-3;
/// The step is followed for this long: the difference is largest while the branches relax.
const STEP_S: f64 = 2.0;
/// Period of the reference (25), s.
const REFERENCE_S: f64 = 20.0;
/// Nodes less one of the field-level model.
const DEGREE: usize = 16;
/// Offset of the reference, mm, that keeps the voltage real: an assumption, since the paper gives none.
const OFFSET_MM: f64 = 0.45;

/// The paper's reference (25) at `t_s`, mm.
fn reference_25(t_s: f64) -> f64 {
    let turn = std::f64::consts::TAU * t_s;
    OFFSET_MM - 0.2 * (0.2 * turn).cos() - 0.2 * (0.05 * turn).sin() + 0.1 * (0.4 * turn).cos()
}

impl TwinModel {
    /// [`TwinModel::new`] with its error against the field-level model, measured on the spot.
    ///
    /// # Errors
    /// Those of [`TwinModel::new`] and of [`FieldTwin`].
    pub fn with_stated_error(parameters: &ActuatorParameters) -> Result<Self, Error> {
        let mut model = Self::new(parameters)?;
        let full_scale = parameters.spec().full_scale_v;
        let step = model.follow(STEP_S, |_| full_scale)?;
        let reference = model.follow(REFERENCE_S, |t_s| model.holding_voltage_v(reference_25(t_s)))?;
        model.stated_error = Some(StatedError { step, reference });
        Ok(model)
    }

    /// Error against the field-level model, if [`TwinModel::with_stated_error`] has measured it.
    #[must_use]
    pub fn stated_error(&self) -> Option<StatedError> {
        self.stated_error
    }

    /// Runs both models from rest under one drive.
    fn follow(&self, duration_s: f64, drive_v: impl Fn(f64) -> f64) -> Result<MotionError, Error> {
        let mut field = FieldTwin::new(&self.parameters, DEGREE)?;
        let mut reduced = Twin::new(self);
        let mut error = MotionError { max_mm: 0.0, stroke_mm: 0.0 };
        for k in 0..(duration_s / INTERVAL_S).round() as usize {
            let drive_v = drive_v((k as f64 + 0.5) * INTERVAL_S);
            field.step(INTERVAL_S, drive_v)?;
            reduced.advance(INTERVAL_S, Inputs { drive_v, disturbance_n: 0.0 });
            let at_mm = field.displacement_mm();
            error.max_mm = error.max_mm.max((at_mm - reduced.displacement_mm()).abs());
            error.stroke_mm = error.stroke_mm.max(at_mm.abs());
        }
        Ok(error)
    }

    /// Voltage under which the relaxed membrane holds its weight at `displacement_mm`, within 0 and full scale, by bisection of V^2.
    fn holding_voltage_v(&self, displacement_mm: f64) -> f64 {
        let weight = self.parameters.weight_n();
        let full_scale = self.parameters.spec().full_scale_v;
        let (mut low, mut high) = (0.0, full_scale * full_scale);
        // 2^-50 of full scale squared.
        for _ in 0..50 {
            let middle: f64 = 0.5 * (low + high);
            // Voltage lowers the force.
            if self.force_n(displacement_mm, middle.sqrt()) > weight { low = middle } else { high = middle }
        }
        (0.5 * (low + high)).sqrt()
    }
}
