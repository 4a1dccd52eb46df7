//! The third-order model that lies closest to a measured frequency response.

use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use telepulse_lti::{TransferFunction, polynomial};

use super::least_squares::{Linearized, Minimum, Stop, minimize};
use super::record::{SweepPoint, SweepRecord};
use super::third_order::{ParameterErrors, RcPole, ThirdOrder};
use crate::{Error, Result};

/// Which difference between measurement and model is made small.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Residual {
    /// The complex difference: magnitude and phase.
    Complex,
    /// The difference of the magnitudes, as in the paper, section 3; the phase is ignored.
    MagnitudeOnly,
}

/// How much each point counts.
#[derive(Debug, Clone, PartialEq)]
pub enum Weighting {
    /// All differences count the same, in mm per unit (the paper's mean square error).
    Absolute,
    /// Each difference is divided by the measured magnitude.
    Relative,
    /// Each difference is divided by this standard deviation, in mm per unit, one for each point of the record.
    StandardDeviation(Vec<f64>),
}

/// What to fit.
#[derive(Debug, Clone, PartialEq)]
pub struct FitOptions {
    /// The pole of the circuit.
    pub rc: RcPole,
    /// Which difference is made small.
    pub residual: Residual,
    /// How much each point counts.
    pub weighting: Weighting,
    /// A dead time that the measurement contains and the model shall not, in s.
    pub delay_s: f64,
}

impl Default for FitOptions {
    /// Circuit as in Eq. (14), complex residual, absolute weighting, no dead time.
    fn default() -> Self {
        Self {
            rc: RcPole::Known(0.0045),
            residual: Residual::Complex,
            weighting: Weighting::Absolute,
            delay_s: 0.0,
        }
    }
}

/// A stable third-order model with the evidence for it.
#[derive(Debug, Clone, PartialEq)]
pub struct ThirdOrderFit {
    /// Gain at rest, in mm per unit.
    pub dc_gain_mm_per_unit: f64,
    /// Natural frequency in rad/s.
    pub omega_n_rad_s: f64,
    /// Damping ratio.
    pub zeta: f64,
    /// Time constant of the circuit in s.
    pub rc_s: f64,
    /// Standard errors of the parameters.
    pub standard_errors: ParameterErrors,
    /// The model, numerator and denominator in the form of Eq. (16).
    pub transfer_function: TransferFunction,
    /// Root mean square over the points of the difference that was made small, unweighted, in mm per unit.
    pub rms_residual_mm_per_unit: f64,
    /// Root mean square of the complex difference, in mm per unit: shows what a magnitude-only fit leaves in the phase.
    pub rms_complex_mm_per_unit: f64,
    /// Condition number of the Jacobian with its columns scaled to unit length.
    pub condition: f64,
    /// Points used.
    pub n_points: usize,
    /// Iterations made.
    pub iterations: usize,
}

/// The third-order model `k / ((rc s + 1)(s^2 + 2 zeta wn s + wn^2))` that fits all amplitudes of `record` at once.
///
/// **Shapes and units**: frequencies in Hz, response in mm per unit of full scale; `k / wn^2` is the DC gain.
///
/// **Method**: start by Sanathanan and Koerner's iteration (linear least squares of `M(jw) den(jw) - num`, reweighted by
/// the last denominator), for the magnitude-only residual by the same on `1/|M|^2`, a polynomial in w^2. Then
/// Levenberg-Marquardt on the weighted residual with the exact Jacobian, also from a resonance at the peak of the response and from one
/// above the range: noise can lead the linear start astray. The lowest minimum counts. Parameters are logarithms, so the model is
/// stable at every step.
///
/// **Source**: Sanathanan and Koerner 1963, IEEE Trans. Autom. Control 8(1), 56-58; the paper, section 3.
///
/// **Accuracy**: parameters to 1e-10 of the minimum. Standard errors as said at [`ParameterErrors`].
///
/// # Errors
/// [`Error::FitNotConverged`]; [`Error::FitIllConditioned`] where the data leave a parameter open; [`Error::OutOfRange`]
/// and [`Error::SampleCount`] for options out of range.
///
/// # Example
/// ```
/// use telepulse_design::identify::{FitOptions, SweepPoint, SweepRecord, fit_third_order, log_spaced};
/// use telepulse_lti::TransferFunction;
/// // Eq. (16), measured without error.
/// let plant = TransferFunction::new(&[1350.14], &[0.0045, 1.07182, 22.458, 1444.0])?;
/// let point = |f: f64| SweepPoint::from_response(f, 0.2, plant.at(std::f64::consts::TAU * f), None);
/// let record = SweepRecord::new(log_spaced(0.1, 13.0, 25).into_iter().map(point).collect(), None)?;
/// let fit = fit_third_order(&record, &FitOptions::default())?;
/// assert!((fit.omega_n_rad_s - 38.0).abs() < 1e-6);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn fit_third_order(record: &SweepRecord, options: &FitOptions) -> Result<ThirdOrderFit> {
    let data = weighted_data(record, options)?;
    let end = best_of_starts(&starts(&data, options)?, |p| {
        let model = ThirdOrder::from_logs(p.as_slice(), options.rc);
        linearize(&data, &model, p.len(), options.residual)
    })?;
    let model = ThirdOrder::from_logs(end.parameters.as_slice(), options.rc);
    let (relative_errors, condition) = relative_standard_errors(&end.linearized)?;
    let (numerator, denominator) = model.polynomials();
    let rms = |difference: &dyn Fn(&Datum) -> f64| {
        (data.iter().map(|d| difference(d).powi(2)).sum::<f64>() / data.len() as f64).sqrt()
    };
    let complex = |d: &Datum| (model.at(d.omega) - d.response).norm();
    let magnitude = |d: &Datum| model.at(d.omega).norm() - d.response.norm();
    Ok(ThirdOrderFit {
        dc_gain_mm_per_unit: model.dc_gain,
        omega_n_rad_s: model.omega_n,
        zeta: model.zeta,
        rc_s: model.rc,
        standard_errors: ParameterErrors {
            dc_gain_mm_per_unit: relative_errors[0] * model.dc_gain,
            omega_n_rad_s: relative_errors[1] * model.omega_n,
            zeta: relative_errors[2] * model.zeta,
            rc_s: relative_errors.get(3).map(|e| e * model.rc),
        },
        transfer_function: TransferFunction::new(&[numerator], &denominator)?,
        rms_residual_mm_per_unit: match options.residual {
            Residual::Complex => rms(&complex),
            Residual::MagnitudeOnly => rms(&magnitude),
        },
        rms_complex_mm_per_unit: rms(&complex),
        condition,
        n_points: data.len(),
        iterations: end.iterations,
    })
}

/// The linear estimate, the resonance at the peak of the response, and the resonance above the range.
fn starts(data: &[Datum], options: &FitOptions) -> Result<Vec<DVector<f64>>> {
    let linear = match options.residual {
        Residual::Complex => start_from_response(data, options.rc)?,
        Residual::MagnitudeOnly => start_from_magnitude(data, options.rc),
    };
    let at_peak = fallback(data, options.rc);
    let top = data.iter().map(|d| d.omega).fold(0.0, f64::max);
    let above = ThirdOrder { omega_n: 3.0 * top, zeta: 0.5, ..at_peak };
    Ok([linear, at_peak, above].map(|s| DVector::from_vec(s.to_logs(options.rc))).to_vec())
}

/// The lowest of the minima that the starts lead to. Where a start ended lower without convergence, the fit has not converged.
fn best_of_starts(
    starts: &[DVector<f64>],
    linearize: impl Fn(&DVector<f64>) -> Linearized,
) -> Result<Minimum> {
    let rms = |end: &Result<Minimum>| match end {
        Ok(end) => (end.linearized.residual.norm_squared() / end.linearized.residual.len() as f64).sqrt(),
        Err(Error::FitNotConverged { rms_residual, .. }) => *rms_residual,
        Err(_) => f64::INFINITY,
    };
    let mut ends = starts.iter().map(|start| minimize(start.clone(), Stop::AtTheMinimum, &linearize));
    let first = ends.next().ok_or(Error::EmptyList { key: "starts" })?;
    // A gain of less than a millionth is the same minimum, found with another rounding.
    ends.fold(first, |best, next| if rms(&next) < (1.0 - 1e-6) * rms(&best) { next } else { best })
}

/// A measured point, ready for the fit.
struct Datum {
    omega: f64,
    response: Complex64,
    weight: f64,
}

fn weighted_data(record: &SweepRecord, options: &FitOptions) -> Result<Vec<Datum>> {
    let check = |key, found: f64, ok: bool, allowed| {
        if ok && found.is_finite() { Ok(()) } else { Err(Error::OutOfRange { key, found, allowed }) }
    };
    if let RcPole::Known(rc_s) = options.rc {
        check("rc_s", rc_s, rc_s >= 0.0, "0 or above")?;
    }
    check("delay_s", options.delay_s, options.delay_s >= 0.0, "0 or above")?;
    if let Weighting::StandardDeviation(deviations) = &options.weighting {
        let (expected, found) = (record.points().len(), deviations.len());
        if expected != found {
            return Err(Error::SampleCount { signal: "standard deviations", expected, found });
        }
        for &deviation in deviations {
            check("standard deviation", deviation, deviation > 0.0, "above 0")?;
        }
    }
    let datum = |(idx, point): (usize, &SweepPoint)| {
        let omega = point.omega_rad_s();
        let response = point.response() * Complex64::from_polar(1.0, omega * options.delay_s);
        let weight = match &options.weighting {
            Weighting::Absolute => 1.0,
            Weighting::Relative => 1.0 / point.magnitude_mm_per_unit,
            Weighting::StandardDeviation(deviations) => 1.0 / deviations[idx],
        };
        Datum { omega, response, weight }
    };
    Ok(record.points().iter().enumerate().map(datum).collect())
}

fn linearize(data: &[Datum], model: &ThirdOrder, n_p: usize, residual: Residual) -> Linearized {
    let rows_per_point = match residual {
        Residual::Complex => 2,
        Residual::MagnitudeOnly => 1,
    };
    let n_r = rows_per_point * data.len();
    let mut r = DVector::zeros(n_r);
    let mut jacobian = DMatrix::zeros(n_r, n_p);
    for (idx, datum) in data.iter().enumerate() {
        let model = model.derivatives(datum.omega);
        let row = rows_per_point * idx;
        match residual {
            Residual::Complex => {
                let difference = (model.value - datum.response) * datum.weight;
                (r[row], r[row + 1]) = (difference.re, difference.im);
                for p in 0..n_p {
                    let by = model.by_logs[p] * datum.weight;
                    (jacobian[(row, p)], jacobian[(row + 1, p)]) = (by.re, by.im);
                }
            }
            Residual::MagnitudeOnly => {
                let norm = model.value.norm();
                r[row] = (norm - datum.response.norm()) * datum.weight;
                for p in 0..n_p {
                    jacobian[(row, p)] = (model.value.conj() * model.by_logs[p]).re / norm * datum.weight;
                }
            }
        }
    }
    Linearized { residual: r, jacobian }
}

/// Largest condition number of the scaled Jacobian that still counts as determined: standard errors then are below
/// 1e6 times what each parameter alone would have.
const CONDITION_MAX: f64 = 1e6;

/// Standard errors of the logarithms, and the condition number of the Jacobian with unit columns.
fn relative_standard_errors(at: &Linearized) -> Result<(Vec<f64>, f64)> {
    let (n_r, n_p) = at.jacobian.shape();
    let lengths: Vec<f64> = at.jacobian.column_iter().map(|c| c.norm()).collect();
    if lengths.iter().any(|length| !length.is_normal()) {
        // A parameter without any effect on the response.
        return Err(Error::FitIllConditioned { condition: f64::INFINITY, condition_max: CONDITION_MAX });
    }
    let mut scaled = at.jacobian.clone();
    for (mut column, length) in scaled.column_iter_mut().zip(&lengths) {
        column /= *length;
    }
    let svd = scaled.svd(false, true);
    let condition = svd.singular_values.max() / svd.singular_values.min();
    let Some(v_t) = svd.v_t.filter(|_| condition <= CONDITION_MAX) else {
        return Err(Error::FitIllConditioned { condition, condition_max: CONDITION_MAX });
    };
    let variance = at.residual.norm_squared() / (n_r - n_p) as f64;
    let error = |p: usize| {
        // Diagonal of (J'J)^-1 from the singular values.
        let inverse: f64 = (0..n_p).map(|k| (v_t[(k, p)] / svd.singular_values[k]).powi(2)).sum();
        (variance * inverse).sqrt() / lengths[p]
    };
    Ok(((0..n_p).map(error).collect(), condition))
}

/// Rounds of reweighting; each is one small linear solve, and the change is below 1e-3 after five.
const REWEIGHTINGS: usize = 10;

/// Sanathanan and Koerner: `M (1 + a1 s + a2 s^2 [+ a3 s^3]) - g = 0`, where a known circuit pole is taken into M.
fn start_from_response(data: &[Datum], rc: RcPole) -> Result<ThirdOrder> {
    let scale = centre(data);
    let order = match rc {
        RcPole::Known(_) => 2,
        RcPole::Free => 3,
    };
    let mut coefficients = DVector::zeros(order + 1);
    for _ in 0..REWEIGHTINGS {
        let mut lhs = DMatrix::zeros(2 * data.len(), order + 1);
        let mut rhs = DVector::zeros(2 * data.len());
        for (idx, datum) in data.iter().enumerate() {
            let s = Complex64::i() * (datum.omega / scale);
            let circuit = match rc {
                RcPole::Known(rc_s) => 1.0 + Complex64::i() * (datum.omega * rc_s),
                RcPole::Free => Complex64::from(1.0),
            };
            let last: Complex64 =
                1.0 + (1..=order).map(|k| s.powi(k as i32) * coefficients[k]).sum::<Complex64>();
            let weight = datum.weight / (circuit * last).norm().max(1e-9);
            let m = datum.response * circuit;
            for k in 0..=order {
                let entry = if k == 0 { Complex64::from(-1.0) } else { m * s.powi(k as i32) } * weight;
                (lhs[(2 * idx, k)], lhs[(2 * idx + 1, k)]) = (entry.re, entry.im);
            }
            let target = -m * weight;
            (rhs[2 * idx], rhs[2 * idx + 1]) = (target.re, target.im);
        }
        match lhs.svd(true, true).solve(&rhs, 1e-12) {
            Ok(solution) if solution.iter().all(|c| c.is_finite()) => coefficients = solution,
            _ => return Ok(fallback(data, rc)),
        }
    }
    let mut descending: Vec<f64> = (1..=order).rev().map(|k| coefficients[k]).collect();
    descending.push(1.0);
    let start = from_roots(&polynomial::roots(&descending)?, scale, coefficients[0], rc);
    Ok(start.unwrap_or_else(|| fallback(data, rc)))
}

/// Reads gain, resonance and circuit pole off the roots; `None` where they are not those of a stable third-order lag.
fn from_roots(roots: &[Complex64], scale: f64, gain: f64, rc: RcPole) -> Option<ThirdOrder> {
    let mut poles: Vec<Complex64> = roots.iter().map(|r| r * scale).collect();
    // The circuit is the fastest real pole.
    poles.sort_by(|a, b| (a.im != 0.0).cmp(&(b.im != 0.0)).then(a.re.total_cmp(&b.re)));
    let rc_s = match rc {
        RcPole::Known(rc_s) => rc_s,
        RcPole::Free => -1.0 / poles.remove(0).re,
    };
    let product = poles[0] * poles[1];
    let omega_n = product.re.max(0.0).sqrt();
    let zeta = -(poles[0] + poles[1]).re / (2.0 * omega_n);
    let start = ThirdOrder { dc_gain: gain, omega_n, zeta, rc: rc_s };
    let usable = |x: f64| x.is_finite() && x > 0.0;
    (usable(gain) && usable(omega_n) && usable(zeta) && (rc != RcPole::Free || usable(rc_s))).then_some(start)
}

/// `1/|M|^2` over the known circuit's part is `(1 + (4 zeta^2 - 2) x + x^2)/g^2` with `x = (w/wn)^2`: linear in its
/// coefficients. Relative weighting, since the inverse magnifies the small responses.
fn start_from_magnitude(data: &[Datum], rc: RcPole) -> ThirdOrder {
    let scale = centre(data);
    let known = match rc {
        RcPole::Known(rc_s) => rc_s,
        RcPole::Free => 0.0,
    };
    let mut lhs = DMatrix::zeros(data.len(), 3);
    for (idx, datum) in data.iter().enumerate() {
        let x = (datum.omega / scale).powi(2);
        let weight = datum.response.norm_sqr() * (1.0 + (datum.omega * known).powi(2));
        for k in 0..3 {
            lhs[(idx, k)] = weight * x.powi(k as i32);
        }
    }
    let start = fallback(data, rc);
    let Ok(c) = lhs.svd(true, true).solve(&DVector::from_element(data.len(), 1.0), 1e-12) else {
        return start;
    };
    if !(c[0] > 0.0 && c[2] > 0.0) {
        return start;
    }
    // x = (scale/wn)^2 times the scaled variable.
    let omega_n = scale * (c[0] / c[2]).powf(0.25);
    let four_zeta_squared = 2.0 + c[1] / (c[0] * c[2]).sqrt();
    let zeta = if four_zeta_squared > 1e-4 { 0.5 * four_zeta_squared.sqrt() } else { start.zeta };
    ThirdOrder { dc_gain: c[0].sqrt().recip(), omega_n, zeta, ..start }
}

/// The peak of the response as the resonance.
fn fallback(data: &[Datum], rc: RcPole) -> ThirdOrder {
    let by_norm = |a: &&Datum, b: &&Datum| a.response.norm().total_cmp(&b.response.norm());
    let by_omega = |a: &&Datum, b: &&Datum| a.omega.total_cmp(&b.omega);
    // A record holds at least five points.
    let peak = data.iter().max_by(by_norm).map_or(1.0, |d| d.omega);
    let dc_gain = data.iter().min_by(by_omega).map_or(1.0, |d| d.response.norm());
    let rc = match rc {
        RcPole::Known(rc_s) => rc_s,
        RcPole::Free => 0.2 / peak,
    };
    ThirdOrder { dc_gain, omega_n: peak, zeta: 0.2, rc }
}

/// Geometric mean of the frequencies.
fn centre(data: &[Datum]) -> f64 {
    (data.iter().map(|d| d.omega.ln()).sum::<f64>() / data.len() as f64).exp()
}
