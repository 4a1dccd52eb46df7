//! Fitting step: rational scales that hold the bound which the analysis found frequency by frequency.

use nalgebra::DMatrix;
use num_complex::Complex64;

use super::blocks::FullBlocks;
use super::mu_step::{ScaledGain, gain_at};
use super::rational_scale::RationalScale;
use crate::Error;
use crate::identify::{MagnitudeDesign, MagnitudeRow, ORDER_MAX, design_magnitude};

/// One frequency of the analysis.
#[derive(Clone, Debug, PartialEq)]
pub struct ScaleSample {
    /// Frequency in rad/s.
    pub omega_rad_s: f64,
    /// The closed loop from `w` to `z` there.
    pub response: DMatrix<Complex64>,
    /// Its bound and scales.
    pub bound: ScaledGain,
}

/// Settings of [`fit_scales`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScaleFitOptions {
    /// Largest order of a scale, 0 to 8; 5.
    pub order_max: usize,
    /// By how much, relative, a fitted scale may exceed the bound at a frequency before the fit counts as poor; 0.003.
    pub tolerance: f64,
    /// Bounds below this share of their peak count as being there: scales need not be exact where nothing binds; 0.3.
    pub floor: f64,
}

impl Default for ScaleFitOptions {
    fn default() -> Self {
        Self { order_max: 5, tolerance: 0.003, floor: 0.3 }
    }
}

impl ScaleFitOptions {
    pub(super) fn check(&self) -> Result<(), Error> {
        let range = |key, found, allowed| Err(Error::OutOfRange { key, found, allowed });
        if self.order_max > ORDER_MAX {
            return range("order_max", self.order_max as f64, "from 0 to 8");
        }
        if !(self.tolerance > 0.0 && self.tolerance <= 1.0) {
            return range("tolerance", self.tolerance, "above 0, at most 1");
        }
        if !(0.0..=1.0).contains(&self.floor) {
            return range("floor", self.floor, "from 0 to 1");
        }
        Ok(())
    }
}

/// Scales as systems, one per block, and how well they hold the bound.
#[derive(Clone, Debug, PartialEq)]
pub struct FittedScales {
    /// One per block; the last is 1.
    pub scales: Vec<RationalScale>,
    /// Largest ratio, over the samples, of the singular value with these scales to the bound (or to the floor).
    pub excess: f64,
}

/// Returns stable, minimum-phase scales of the least order that hold the bounds of `samples`.
///
/// **Shapes and units**: frequencies in rad/s, rising.
///
/// **Method**: at each frequency the scales of a block which keep the largest singular value below the bound, widened by the
/// tolerance, are an interval, because that singular value is convex in the logarithm of the scale. A linear program
/// (log-Chebyshev magnitude design) finds the rational magnitude that lies in all intervals, or misses them by the
/// least factor; its spectral factor is the scale. Orders rise from zero until the singular values with all fitted scales hold
/// the widened bounds; where none does, the best order is taken.
///
/// **Source**: Safonov and Chiang 1993 and Balas et al., mu-Analysis and Synthesis Toolbox, 1993, for the fitting by its
/// effect on the bound; the intervals are exact for two blocks.
///
/// **Accuracy**: `excess` is measured at the samples; between them the norm of the scaled loop is what counts.
///
/// **Errors**: [`Error::EmptyList`] without samples; those of [`super::scaled_gain`].
pub fn fit_scales(
    samples: &[ScaleSample],
    blocks: &FullBlocks,
    options: &ScaleFitOptions,
) -> Result<FittedScales, Error> {
    options.check()?;
    if samples.is_empty() {
        return Err(Error::EmptyList { key: "samples" });
    }
    let n = blocks.blocks().len() - 1;
    let peak = samples.iter().map(|s| s.bound.value).fold(0.0, f64::max);
    let floor = (options.floor * peak).max(f64::MIN_POSITIVE);
    let share = options.tolerance / n.max(1) as f64;
    let mut rows = Vec::with_capacity(n);
    let at_peak = samples.iter().max_by(|a, b| a.bound.value.total_cmp(&b.bound.value));
    for block in 0..n {
        let centre = at_peak.map_or(1.0, |s| s.bound.scales[block]);
        let row = |s: &ScaleSample| -> Result<MagnitudeRow, Error> {
            let level = s.bound.value.max(floor) * (1.0 + share);
            let [low, high] = interval(s, blocks, block, level)?
                .map(|end| end.clamp(centre * (-RANGE).exp(), centre * RANGE.exp()));
            Ok(MagnitudeRow { omega: s.omega_rad_s, cover: Some(low), near: high })
        };
        rows.push(samples.iter().map(row).collect::<Result<Vec<_>, _>>()?);
    }
    let band = band(samples.iter().map(|s| s.omega_rad_s));
    let mut best: Option<FittedScales> = None;
    for order in 0..=options.order_max {
        let Ok(scales) = rows.iter().map(|rows| fit_one(rows, order, band)).collect::<Result<Vec<_>, _>>()
        else {
            continue;
        };
        let scales: Vec<_> = scales.into_iter().chain([RationalScale::constant(1.0)?]).collect();
        let mut excess = 0.0_f64;
        for s in samples {
            let at: Vec<f64> = scales.iter().map(|d| d.magnitude(s.omega_rad_s)).collect();
            excess = excess.max(gain_at(&s.response, blocks, &at)? / s.bound.value.max(floor));
        }
        if best.as_ref().is_none_or(|best| excess < best.excess) {
            best = Some(FittedScales { scales, excess });
        }
        if n == 0 || excess <= 1.0 + options.tolerance {
            break;
        }
    }
    best.ok_or(Error::CoverInfeasible { ratio_max: 1000.0 })
}

/// The scale of that order closest to magnitudes given at frequencies in rad/s, in the logarithm.
pub(super) fn fit_magnitude(targets: &[(f64, f64)], order: usize) -> Result<RationalScale, Error> {
    let rows: Vec<_> =
        targets.iter().map(|&(omega, near)| MagnitudeRow { omega, cover: Some(near), near }).collect();
    fit_one(&rows, order, band(targets.iter().map(|t| t.0)))
}

/// The first and last frequency that are positive and finite.
fn band(mut omegas: impl DoubleEndedIterator<Item = f64>) -> [f64; 2] {
    let usable = |w: &f64| *w > 0.0 && w.is_finite();
    let low = omegas.find(usable).unwrap_or(1.0);
    [low, omegas.rfind(usable).unwrap_or(low)]
}

/// The scales of one block that keep the largest singular value at or below `level`, the other scales as they are.
fn interval(s: &ScaleSample, blocks: &FullBlocks, block: usize, level: f64) -> Result<[f64; 2], Error> {
    let mut scales = s.bound.scales.clone();
    let centre = scales[block];
    let mut holds = |log: f64| -> Result<bool, Error> {
        scales[block] = centre * log.exp();
        Ok(gain_at(&s.response, blocks, &scales)? <= level)
    };
    let mut ends = [centre; 2];
    for (end, sign) in ends.iter_mut().zip([-1.0, 1.0]) {
        // Convex: what lies between the centre and a point that holds, holds.
        let (mut inside, mut outside) = (0.0, WIDTH_MAX);
        if holds(sign * WIDTH_MAX)? {
            inside = WIDTH_MAX;
        } else {
            for _ in 0..INTERVAL_STEPS {
                let middle = 0.5 * (inside + outside);
                if holds(sign * middle)? { inside = middle } else { outside = middle }
            }
        }
        *end = centre * (sign * inside).exp();
    }
    Ok(ends)
}

fn fit_one(rows: &[MagnitudeRow], order: usize, band: [f64; 2]) -> Result<RationalScale, Error> {
    let design =
        MagnitudeDesign { order, n_zeros: order, band, damping_min: DAMPING_MIN, tolerance: TOLERANCE };
    let designed = design_magnitude(rows, &design)?;
    // It reaches every lower end and is over an upper one by the ratio at most: half of that on each side.
    let mut factor = designed.weight;
    factor.gain /= designed.ratio.sqrt();
    if factor.gain < 0.0 {
        factor.gain = -factor.gain;
    }
    RationalScale::new(factor.gain, factor.zeros, factor.poles)
}

/// Half width, in logarithms, to which an interval of scales is cut.
const WIDTH_MAX: f64 = 14.0;
const INTERVAL_STEPS: usize = 16;
/// Scales are fitted within `e^7`, a factor of 1000, of those at the peak of the bound.
const RANGE: f64 = 7.0;
/// Smallest damping ratio of a scale's poles and zeros.
const DAMPING_MIN: f64 = 0.1;
/// Bracket of the logarithm of the ratio at the end.
const TOLERANCE: f64 = 2e-3;
