//! Drives a rig through a sweep and hands the record to identification.

use anyhow::{Result, bail, ensure};
use telepulse_design::identify::{
    BoundShape, CoverOptions, FitOptions, InputLinearisation, ModelProvenance, PlantModel, RcPole, Residual,
    SweepOptions, SweepPlan, SweepRecord, ThirdOrderFit, UncertaintyBound, Weighting, cap_additive_error,
    fit_third_order, log_spaced,
};
use telepulse_lti::TransferFunction;
use telepulse_rt::{ControlLaw, CycleInputs, Drive, Sensor, SensorScale};

use super::config::{RcTime, Study};
use super::outcome::Identified;
use crate::station::control::{linearisation, open_loop};
use crate::station::run::{ErrorWatch, tick_through};

/// A measured plant: the sweep, what was fitted to it and what bounds the rest.
#[derive(Debug, Clone)]
pub struct Identification {
    /// The points.
    pub record: SweepRecord,
    /// Complex least squares.
    pub fit: ThirdOrderFit,
    /// The bound of what the fit leaves.
    pub bound: UncertaintyBound,
    /// By magnitudes only, as the paper did.
    pub magnitude_fit: ThirdOrderFit,
}

/// The sweep that the study asks for.
///
/// # Errors
/// Where a frequency or amplitude cannot be placed.
pub fn sweep_plan(study: &Study) -> Result<SweepPlan> {
    let identify = &study.identify;
    Ok(SweepPlan::new(&SweepOptions {
        frequencies_hz: log_spaced(
            identify.frequency_min_hz,
            identify.frequency_max_hz,
            identify.n_frequencies,
        ),
        amplitudes: identify.amplitudes.clone(),
        bias: identify.bias,
        sample_rate_hz: study.control.sample_rate_hz,
        ..SweepOptions::default()
    })?)
}

/// The sweep of a held plate: a gain behind the circuit, so that a dozen frequencies at the study's amplitudes determine it. It
/// starts at 0.25 Hz, below the slowest heart rate; slower changes are creep, which the feedback removes.
///
/// # Errors
/// Where a frequency or amplitude cannot be placed.
pub fn held_sweep_plan(study: &Study) -> Result<SweepPlan> {
    let identify = &study.identify;
    let lowest_hz = identify.frequency_min_hz.max(0.25).min(0.5 * identify.frequency_max_hz);
    Ok(SweepPlan::new(&SweepOptions {
        frequencies_hz: log_spaced(lowest_hz, identify.frequency_max_hz, 12),
        amplitudes: identify.amplitudes.clone(),
        bias: identify.bias,
        sample_rate_hz: study.control.sample_rate_hz,
        bias_settle_s: 20.0,
        settle_s: 0.5,
        measured_periods: 2,
        ..SweepOptions::default()
    })?)
}

/// Runs the study's sweep on a rig; see [`run_sweep`].
///
/// # Errors
/// Where the rig trips, or a window holds no usable line.
pub fn sweep<R: Sensor + Drive>(
    rig: &mut R,
    study: &Study,
    scale: SensorScale,
    input: InputLinearisation,
) -> Result<SweepRecord> {
    run_sweep(rig, study, &sweep_plan(study)?, scale, input, study.identify.bias)
}

/// Runs a sweep on a rig, through the same cycle as every other run, without feedback.
///
/// The command is the voltage or, with the square root, its square; `scale` makes the response from the sensor's reading.
///
/// # Errors
/// Where the rig trips, or a window holds no usable line.
pub fn run_sweep<R: Sensor + Drive>(
    rig: &mut R,
    study: &Study,
    plan: &SweepPlan,
    scale: SensorScale,
    input: InputLinearisation,
    bias: f64,
) -> Result<SweepRecord> {
    let mut control = open_loop(study, scale, linearisation(input), ControlLaw::OpenLoop)?;
    let full_scale_v = study.control.full_scale_v;
    let mut windows = Windows::new(plan);
    let inputs = plan.drive().map(|feedforward| CycleInputs { reference: 0.0, feedforward });
    let trip = tick_through(rig, &mut control, inputs, ErrorWatch::OFF, |tick_idx, output, _| {
        windows.take(tick_idx, input.command(output.voltage_v / full_scale_v), output.measured);
    })?;
    if let Some(reason) = trip {
        bail!("the sweep was ended: {reason}");
    }
    let points = windows.finished?;
    // The controller is designed for the continuous plant; the hold belongs to the sampled implementation.
    Ok(SweepRecord::new(points, Some(bias))?.without_hold(study.control.sample_rate_hz)?)
}

/// Keeps the measured window of one sine at a time: a whole sweep would be hundreds of megabytes.
struct Windows<'a> {
    plan: &'a SweepPlan,
    segment_idx: usize,
    drive: Vec<f64>,
    response: Vec<f64>,
    finished: telepulse_design::Result<Vec<telepulse_design::identify::SweepPoint>>,
}

impl<'a> Windows<'a> {
    fn new(plan: &'a SweepPlan) -> Self {
        Self { plan, segment_idx: 0, drive: Vec::new(), response: Vec::new(), finished: Ok(Vec::new()) }
    }

    fn take(&mut self, tick_idx: usize, drive: f64, response: f64) {
        let Some(segment) = self.plan.segments().get(self.segment_idx) else { return };
        let range = self.plan.measured_range(self.segment_idx);
        if !range.contains(&tick_idx) {
            return;
        }
        self.drive.push(drive);
        self.response.push(response);
        if tick_idx + 1 == range.end {
            match (segment.point(&self.drive, &self.response), &mut self.finished) {
                (Ok(point), Ok(points)) => points.push(point),
                (Err(error), Ok(_)) => self.finished = Err(error),
                (_, Err(_)) => {}
            }
            self.drive.clear();
            self.response.clear();
            self.segment_idx += 1;
        }
    }
}

/// A model that leaves more of the response than this share is no model of it.
const RESIDUAL_MAX: f64 = 0.3;

/// How far above the largest error the bound lies: room for what lies between the points.
const BOUND_MARGIN: f64 = 1.05;

/// Fits a third-order model to a sweep and bounds its error.
///
/// The nominal plant is fitted to the smallest amplitude, the one nearest to the linearisation (10); what the larger ones
/// differ is uncertainty, and the bound covers every point of every amplitude. With too few frequencies at the smallest
/// amplitude all points are fitted.
///
/// # Errors
/// Where the sweep does not determine a model, or no bound of second order exists.
pub fn identify(record: SweepRecord, rc: RcTime) -> Result<Identification> {
    let rc = match rc {
        RcTime::Known(rc_s) => RcPole::Known(rc_s),
        RcTime::Free(_) => RcPole::Free,
    };
    let options = FitOptions {
        rc,
        residual: Residual::Complex,
        weighting: Weighting::Relative,
        ..FitOptions::default()
    };
    let nominal = smallest_amplitude(&record);
    let fit = fit_third_order(&nominal, &options)?;
    let magnitude_fit =
        fit_third_order(&nominal, &FitOptions { residual: Residual::MagnitudeOnly, ..options })?;
    let power = nominal.points().iter().map(|p| p.magnitude_mm_per_unit.powi(2)).sum::<f64>();
    let share = fit.rms_complex_mm_per_unit / (power / nominal.points().len() as f64).sqrt();
    ensure!(
        share <= RESIDUAL_MAX,
        "a third-order model leaves {:.0} % of the response, allowed is {:.0} %: is the phase in degrees, and negative where the output lags?",
        100.0 * share,
        100.0 * RESIDUAL_MAX
    );
    let bound = bound(&record, &fit.transfer_function)?;
    Ok(Identification { record, fit, bound, magnitude_fit })
}

fn smallest_amplitude(record: &SweepRecord) -> SweepRecord {
    let smallest = record.amplitudes().into_iter().fold(f64::INFINITY, f64::min);
    let points = record.points().iter().filter(|point| point.amplitude == smallest).copied().collect();
    SweepRecord::new(points, record.bias()).unwrap_or_else(|_| record.clone())
}

/// Bounds the additive error of a model over a sweep by a weight of second order, as (17).
///
/// # Errors
/// Where no such bound exists.
pub fn bound(record: &SweepRecord, model: &TransferFunction) -> Result<UncertaintyBound> {
    Ok(cap_additive_error(record, model, &cover_options())?)
}

/// How every bound of a study is drawn.
#[must_use]
pub fn cover_options() -> CoverOptions {
    CoverOptions { shape: BoundShape::ConstantNumerator, margin: BOUND_MARGIN, ..CoverOptions::default() }
}

impl Identification {
    /// The numbers of the complex fit and its bound.
    #[must_use]
    pub fn summary(&self) -> Identified {
        summarise(&self.fit, &self.bound, self.fit.rms_complex_mm_per_unit)
    }

    /// The numbers of the magnitude-only fit, with a bound of its own.
    ///
    /// # Errors
    /// Where no bound of second order exists.
    pub fn magnitude_only_summary(&self) -> Result<Identified> {
        let bound = bound(&self.record, &self.magnitude_fit.transfer_function)?;
        Ok(summarise(&self.magnitude_fit, &bound, self.magnitude_fit.rms_complex_mm_per_unit))
    }
}

fn summarise(fit: &ThirdOrderFit, bound: &UncertaintyBound, residual_rms: f64) -> Identified {
    Identified {
        dc_gain_mm_per_unit: fit.dc_gain_mm_per_unit,
        omega_n_rad_s: fit.omega_n_rad_s,
        zeta: fit.zeta,
        rc_s: fit.rc_s,
        residual_rms,
        bound_violations: bound.violations,
        bound_points: bound.points.len(),
        bound_numerator: bound.weight.numerator().to_vec(),
        bound_denominator: bound.weight.denominator().to_vec(),
        numerator: fit.transfer_function.numerator().to_vec(),
        denominator: fit.transfer_function.denominator().to_vec(),
    }
}

/// The model as a file for later stages.
///
/// # Errors
/// Where the study's bias or full scale is out of range.
pub fn plant_model(
    study: &Study,
    found: &Identification,
    input: InputLinearisation,
    record: &str,
) -> Result<PlantModel> {
    Ok(PlantModel {
        version: PlantModel::VERSION,
        nominal: found.fit.transfer_function.clone(),
        uncertainty: Some(found.bound.weight.clone()),
        controlled: telepulse_design::identify::Controlled::Displacement,
        input_linearisation: input,
        bias_unit: found.record.bias().unwrap_or(study.identify.bias),
        bias_displacement_mm: None,
        full_scale_v: study.control.full_scale_v,
        provenance: ModelProvenance::Identified {
            record: record.to_owned(),
            n_points: found.fit.n_points,
            rms_residual_mm_per_unit: found.fit.rms_complex_mm_per_unit,
        },
    }
    .checked()?)
}
