//! A bound on the difference between a model and everything that was measured.

use telepulse_lti::TransferFunction;

use super::certified_touch::{Segment, largest_excess};
use super::envelope::{ErrorCurve, envelope};
use super::magnitude_design::{BoundShape, NEIGHBOURHOOD, cover_magnitude};
use super::minimum_phase::MinimumPhase;
use super::record::SweepRecord;
use crate::{Error, Result};

/// Which error is bounded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ErrorSeries {
    /// `|G_measured - G_model|`: what the small-gain theorem asks for.
    #[default]
    Complex,
    /// `||G_measured| - |G_model||`, as in the paper, figure 8. It ignores the phase and is never larger.
    MagnitudeOnly,
}

/// How to bound.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CoverOptions {
    /// Shape of the bound.
    pub shape: BoundShape,
    /// Which error is bounded.
    pub series: ErrorSeries,
    /// The bound lies above the largest error by at least this factor, 1 or more.
    pub margin: f64,
}

impl Default for CoverOptions {
    /// The paper's shape around the complex error, 0.1 % above it where it touches.
    fn default() -> Self {
        Self { shape: BoundShape::default(), series: ErrorSeries::default(), margin: 1.001 }
    }
}

/// The error of one measured point, and the bound there; errors in mm per unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ErrorPoint {
    /// Which of the records it is from.
    pub record_idx: usize,
    /// Frequency in Hz.
    pub frequency_hz: f64,
    /// Amplitude of the drive, fraction of full scale.
    pub amplitude: f64,
    /// `|G_measured - G_model|`.
    pub complex: f64,
    /// `||G_measured| - |G_model||`.
    pub magnitude_only: f64,
    /// `|W|`.
    pub bound: f64,
}

impl ErrorPoint {
    /// The error of the series asked for.
    #[must_use]
    pub fn error(&self, series: ErrorSeries) -> f64 {
        match series {
            ErrorSeries::Complex => self.complex,
            ErrorSeries::MagnitudeOnly => self.magnitude_only,
        }
    }
}

/// A stable, minimum-phase bound on the additive error, with the evidence for it.
#[derive(Debug, Clone, PartialEq)]
pub struct UncertaintyBound {
    /// The bound, in mm per unit.
    pub weight: TransferFunction,
    /// What was asked for.
    pub options: CoverOptions,
    /// Every measured point, in the order of the records.
    pub points: Vec<ErrorPoint>,
    /// Points whose error, of the series that is bounded, lies above the bound: 0.
    pub violations: usize,
    /// Points whose complex error lies above the bound; not 0 where only the magnitude was bounded and the phase differs.
    pub complex_violations: usize,
    /// Largest ratio of error to bound over points and the lines between them; at most 1/margin.
    pub worst_ratio: f64,
    /// Frequency of that ratio in Hz: where the bound touches.
    pub worst_frequency_hz: f64,
    /// Largest ratio of bound to envelope over the measured range.
    pub loosest_ratio: f64,
}

/// A bound on the additive error between `nominal` and every point of one record.
///
/// # Errors
/// As [`cap_family_error`].
pub fn cap_additive_error(
    record: &SweepRecord,
    nominal: &TransferFunction,
    options: &CoverOptions,
) -> Result<UncertaintyBound> {
    cap_family_error(&[record], nominal, options)
}

/// A bound on the additive error between `nominal` and every point of every record.
///
/// **Shapes and units**: records in mm per unit of the same command as `nominal`, taken at any amplitude, bias or day.
///
/// **Method**: the errors of each record and amplitude are one curve, drawn straight between its points in log-log
/// coordinates. A weight is designed over the upper envelope of all curves and then scaled so that it
/// touches the envelope, times the margin. Errors and bound are compared again, point by point, through the transfer
/// function itself.
///
/// **Source**: the paper, section 3, figure 8 and Eq. (17); Boyd and Vandenberghe 2004, section 6.5, for the design.
///
/// **Accuracy**: the largest ratio of error to weight is found by branch and bound over the lines between the points, with
/// a bound on how far the weight can bend: no grid can miss it. That the error is straight between two points is an
/// assumption about the device, not a fact. Nothing is known outside of the measured range: there the bound continues as its
/// shape says.
///
/// # Errors
/// [`Error::EmptyList`] without records, [`Error::OutOfRange`] for a margin below 1, [`Error::CoverNoError`] where model and data
/// agree exactly, [`Error::CoverInfeasible`].
pub fn cap_family_error(
    records: &[&SweepRecord],
    nominal: &TransferFunction,
    options: &CoverOptions,
) -> Result<UncertaintyBound> {
    if records.is_empty() {
        return Err(Error::EmptyList { key: "records" });
    }
    if !(options.margin >= 1.0 && options.margin.is_finite()) {
        return Err(Error::OutOfRange { key: "margin", found: options.margin, allowed: "1 or more" });
    }
    let mut points = error_points(records, nominal);
    let curves = error_curves(&points, records.len(), options.series)?;
    options.shape.check()?;
    let design_step = if options.shape.order() <= 2 { DESIGN_STEP } else { FINE_STEP };
    let shape = cover_magnitude(&envelope(&curves, design_step), options.shape, NEIGHBOURHOOD)?.weight;
    let shape = shape.transfer_function()?;

    let segments: Vec<Segment> = curves.iter().flat_map(ErrorCurve::segments).collect();
    let touch = largest_excess(&segments, &MinimumPhase::of(&shape)?).upper.exp();
    // Rounding in the last place must not turn a touch into a violation.
    let weight = shape.scale(touch * options.margin * (1.0 + 1e-12))?;

    let worst = largest_excess(&segments, &MinimumPhase::of(&weight)?);
    let ratio = |p: &super::envelope::EnvelopePoint| p.error / weight.at(p.omega).norm();
    let tightest = envelope(&curves, CHECK_STEP).iter().map(ratio).fold(f64::INFINITY, f64::min);
    for point in &mut points {
        point.bound = weight.at(std::f64::consts::TAU * point.frequency_hz).norm();
    }
    let above = |series| points.iter().filter(|p| p.error(series) > p.bound).count();
    Ok(UncertaintyBound {
        violations: above(options.series),
        complex_violations: above(ErrorSeries::Complex),
        worst_ratio: worst.upper.exp(),
        worst_frequency_hz: worst.log_omega.exp() / std::f64::consts::TAU,
        loosest_ratio: 1.0 / tightest,
        options: *options,
        weight,
        points,
    })
}

/// Step of the design grid in ln(omega).
const DESIGN_STEP: f64 = 0.1;
/// The same for orders above two, which can bend more often.
const FINE_STEP: f64 = 0.05;
/// Step in ln(omega) at which the looseness is looked for.
const CHECK_STEP: f64 = 0.005;
/// Errors below this share of the largest are raised to it: 140 dB down there is only rounding.
const ERROR_FLOOR: f64 = 1e-7;

fn error_points(records: &[&SweepRecord], nominal: &TransferFunction) -> Vec<ErrorPoint> {
    let of_record = |(record_idx, record): (usize, &&SweepRecord)| {
        let of_point = move |p: &super::record::SweepPoint| {
            let model = nominal.at(p.omega_rad_s());
            ErrorPoint {
                record_idx,
                frequency_hz: p.frequency_hz,
                amplitude: p.amplitude,
                complex: (p.response() - model).norm(),
                magnitude_only: (p.magnitude_mm_per_unit - model.norm()).abs(),
                bound: 0.0,
            }
        };
        record.points().iter().map(of_point).collect::<Vec<_>>()
    };
    records.iter().enumerate().flat_map(of_record).collect()
}

/// One curve for each record and amplitude.
fn error_curves(points: &[ErrorPoint], n_records: usize, series: ErrorSeries) -> Result<Vec<ErrorCurve>> {
    let largest = points.iter().map(|p| p.error(series)).fold(0.0, f64::max);
    if largest <= f64::MIN_POSITIVE {
        return Err(Error::CoverNoError);
    }
    let mut curves = Vec::new();
    for record_idx in 0..n_records {
        let of_record = || points.iter().filter(move |p| p.record_idx == record_idx);
        let mut amplitudes: Vec<f64> = of_record().map(|p| p.amplitude).collect();
        amplitudes.sort_by(f64::total_cmp);
        amplitudes.dedup();
        for amplitude in amplitudes {
            let of_curve = of_record().filter(|p| p.amplitude == amplitude);
            let pairs = of_curve.map(|p| (std::f64::consts::TAU * p.frequency_hz, p.error(series))).collect();
            curves.push(ErrorCurve::new(pairs, ERROR_FLOOR * largest));
        }
    }
    Ok(curves)
}
