//! What rounding of coefficients and of every operation does to a controller: predicted, not simulated.

use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use telepulse_lti::{Continuous, PeakGain, StateSpace, hinf_norm, lyapunov};

use super::delta_system::DeltaSystem;
use super::program::{Operation, Precision, StepProgram, Update};
use crate::Result;

/// Predicted error of one form in one precision.
///
/// Where a number says "relative", it is relative to the largest response on the frequencies examined, unless it says to what.
#[derive(Debug, Clone, PartialEq)]
pub struct PrecisionReport {
    /// The arithmetic.
    pub precision: Precision,
    /// Whether the system with rounded coefficients is stable.
    pub stable_when_rounded: bool,
    /// H-infinity norm of what rounding of the coefficients changes, absolute; the change of form itself, in double precision, is
    /// not in it. `None` where one of the two systems is not stable, and in double precision, where coefficients are not
    /// rounded once more.
    pub coefficient_error: Option<PeakGain>,
    /// Largest of `|K_rounded - K| / |K|` over the frequencies examined, each relative to the response there. The change of form, computed in
    /// double precision, is in it.
    pub coefficient_error_pointwise: f64,
    /// The frequency in rad/s at which it is found.
    pub worst_omega_rad_s: f64,
    /// First-order bound on the error by coefficients, each off by the unit roundoff in the worst direction, relative to
    /// the response, at the worst frequency.
    pub coefficient_bound_pointwise: f64,
    /// RMS of the output error by rounded operations over RMS of the output, for white input. `None` for a system that is not
    /// stable, whose states have no variance.
    pub roundoff_noise: Option<f64>,
}

impl PrecisionReport {
    /// The error of the response to be expected at the worst frequency, relative to the response there: no smaller than the one found.
    ///
    /// In single precision that is the error of the rounded coefficients itself. In double precision the computed coefficients are those
    /// that run, and their error is the larger of two: the first-order bound, which is for a rounding in the worst direction, and what the
    /// change of form has already cost, which that bound does not know where the form is reached by an ill-conditioned computation.
    #[must_use]
    pub fn predicted_error(&self) -> f64 {
        match self.precision {
            Precision::Single => self.coefficient_error_pointwise,
            Precision::Double => self.coefficient_bound_pointwise.max(self.coefficient_error_pointwise),
        }
    }

    /// What forms are ranked by: [`predicted_error`](Self::predicted_error) plus the noise. Infinite where rounding made a stable system
    /// unstable.
    #[must_use]
    pub fn score(&self, system_is_stable: bool) -> f64 {
        if system_is_stable && !self.stable_when_rounded {
            return f64::INFINITY;
        }
        self.predicted_error() + self.roundoff_noise.unwrap_or(0.0)
    }
}

/// The predicted finite-precision error of a program that is to realise `sys`.
///
/// **Method**: coefficients are rounded as they would be and the response compared with that of `sys`, at frequencies
/// down to the slowest pole, in `z - 1`. The H-infinity norm is that of the error system, in which the errors of the matrices
/// stand themselves: a difference of two nearly equal systems has lost its Hamiltonian to rounding. The first-order bound adds up
/// `|c| |dK/dc|` over all coefficients from the two transfer functions that meet at each multiplication. Noise: every operation
/// adds an error of variance `0.18 u² E[v²]`, with `v` its result and `u` the unit roundoff; the variance of `v` comes from the
/// controllability Gramian, the gain from there to the output from the observability Gramian.
///
/// **Source**: Gevers and Li 1993, "Parametrizations in Control, Estimation and Filtering Problems", chapters 3 and 4; Rao
/// 1996, "Analysis of coefficient quantization errors in state-space digital filters"; for floating point Liu and Kaneko 1969,
/// IEEE Trans. Audio Electroacoust. 17(1), 49-57. The factor is `E[1/m²]/3` for a significand with logarithmic density.
///
/// **Accuracy**: the coefficient error is exact up to double precision. The noise figure holds for errors that are independent and
/// signals that move by more than one unit in the last place per tick (then within a factor of two); a state that stands
/// still because its increments are below that is not foreseen.
///
/// # Errors
/// A system error where eigenvalues do not converge or a response does not exist.
pub fn predict(program: &StepProgram, sys: &DeltaSystem, precision: Precision) -> Result<PrecisionReport> {
    let realised = program.rounded(precision).to_delta()?;
    let stable = sys.is_stable()?;
    let stable_when_rounded = realised.is_stable()?;
    let mut coefficient_error = None;
    if stable && stable_when_rounded && precision == Precision::Single {
        coefficient_error = rounding_error(&program.to_delta()?, &realised, precision)?;
    }
    let grid = frequencies(sys)?;
    let mut responses = Vec::with_capacity(grid.len());
    for &omega in &grid {
        // A pole on the unit circle may be hit; the response next to it is examined as well.
        let (Ok(expected), Ok(found)) = (sys.at(omega), realised.at(omega)) else { continue };
        responses.push((omega, expected, found));
    }
    let peak = responses.iter().map(|(_, e, _)| e.norm()).fold(0.0, f64::max);
    let bounds = Sensitivities::new(program)?;
    let (mut worst, mut worst_omega_rad_s, mut bound): (f64, f64, f64) = (0.0, 0.0, 0.0);
    for (omega, expected, found) in &responses {
        // At a zero of the system nothing is left to be relative to.
        let scale = expected.norm().max(ZERO_FLOOR * peak).max(f64::MIN_POSITIVE);
        let error = (found - expected).norm() / scale;
        if error > worst {
            (worst, worst_omega_rad_s) = (error, *omega);
        }
        bound = bound.max(precision.unit_roundoff() * bounds.at(*omega)? / scale);
    }
    let roundoff_noise = if stable { roundoff_noise(program, sys, precision)? } else { None };
    Ok(PrecisionReport {
        precision,
        stable_when_rounded,
        coefficient_error,
        coefficient_error_pointwise: worst,
        worst_omega_rad_s,
        coefficient_bound_pointwise: bound,
        roundoff_noise,
    })
}

/// Norm of the difference of two systems whose matrices are nearly equal.
///
/// With `e` the error of the state in units of the roundoff `u`: `e+ = A_r e + (dA x + dB v)/u`, `(y_r - y)/u = C_r e + (dC x + dD v)/u`,
/// where every entry is as large as those of the system.
fn rounding_error(
    exact: &DeltaSystem,
    rounded: &DeltaSystem,
    precision: Precision,
) -> Result<Option<PeakGain>> {
    let u = precision.unit_roundoff();
    let (e, r) = (exact.increment(), rounded.increment());
    let (n, m, p) = (e.n_states(), e.n_inputs(), e.n_outputs());
    let mut a = DMatrix::zeros(2 * n, 2 * n);
    a.view_mut((0, 0), (n, n)).copy_from(e.a());
    a.view_mut((n, 0), (n, n)).copy_from(&((r.a() - e.a()) / u));
    a.view_mut((n, n), (n, n)).copy_from(r.a());
    let mut b = DMatrix::zeros(2 * n, m);
    b.rows_mut(0, n).copy_from(e.b());
    b.rows_mut(n, n).copy_from(&((r.b() - e.b()) / u));
    let mut c = DMatrix::zeros(p, 2 * n);
    c.columns_mut(0, n).copy_from(&((r.c() - e.c()) / u));
    c.columns_mut(n, n).copy_from(r.c());
    let error = StateSpace::<Continuous>::new(a, b, c, (r.d() - e.d()) / u)?;
    let image = DeltaSystem::new(error, exact.sample_time()).continuous_image()?;
    // On the unit circle the image's frequency is tan(omega T / 2).
    let angle = |w: f64| 2.0 * w.atan();
    Ok(hinf_norm(&image).ok().map(|peak| PeakGain {
        omega_rad_s: angle(peak.omega_rad_s) / exact.sample_time().seconds(),
        value: peak.value * u,
        lower: peak.lower * u,
        upper: peak.upper * u,
    }))
}

/// From a decade below the slowest pole (five below Nyquist without one) to just below Nyquist, and the angles of all poles.
fn frequencies(sys: &DeltaSystem) -> Result<Vec<f64>> {
    let t = sys.sample_time().seconds();
    let top = 3.1 / t;
    let poles = sys.increment().poles()?;
    let rates = poles.iter().map(|d| d.norm() / t).filter(|&rate| rate > 0.0);
    let low = 0.1 * rates.fold(1e-4 * top, f64::min).max(1e-12 * top);
    let mut grid: Vec<f64> =
        (0..POINTS).map(|k| low * (top / low).powf(f64::from(k) / f64::from(POINTS - 1))).collect();
    grid.extend(poles.iter().filter(|d| d.im > 0.0).map(|d| d.im.atan2(1.0 + d.re) / t));
    grid.retain(|omega| *omega <= top);
    Ok(grid)
}

/// Sums of `|c dK/dc|`.
struct Sensitivities {
    sys: DeltaSystem,
    /// For each multiplication: the value it takes as a function of states and inputs, and the effect of its result.
    of_values: DMatrix<f64>,
    effects: DMatrix<f64>,
    sizes: Vec<f64>,
}

impl Sensitivities {
    fn new(program: &StepProgram) -> Result<Self> {
        let (functions, effects) = (program.node_functions(), program.node_effects());
        let n_given = program.n_states + program.n_inputs;
        let (mut sources, mut results, mut sizes) = (Vec::new(), Vec::new(), Vec::new());
        for (k, operation) in program.operations.iter().enumerate() {
            if let Operation::Multiply { coefficient, of } = *operation {
                sources.push(of);
                results.push(n_given + k);
                sizes.push(program.coefficients[coefficient].abs());
            }
        }
        Ok(Self {
            sys: program.to_delta()?,
            of_values: functions.select_columns(&sources),
            effects: effects.select_columns(&results),
            sizes,
        })
    }

    fn at(&self, omega_rad_s: f64) -> Result<f64> {
        let inc = self.sys.increment();
        let n = inc.n_states();
        let complex = |m: &DMatrix<f64>| m.map(|v| Complex64::new(v, 0.0));
        // Input to states, and states to output: two solves serve all coefficients.
        let Ok(states) = self.sys.states_at(omega_rad_s, &complex(inc.b())) else { return Ok(0.0) };
        let Ok(injected) = self.sys.states_at(omega_rad_s, &complex(&self.effects.rows(0, n).into_owned()))
        else {
            return Ok(0.0);
        };
        let to_output =
            complex(inc.c()) * injected + complex(&self.effects.rows(n, inc.n_outputs()).into_owned());
        let mut sum = 0.0;
        for (k, size) in self.sizes.iter().enumerate() {
            let row = self.of_values.column(k);
            let mut value = row.rows(n, inc.n_inputs()).transpose().map(|v| Complex64::new(v, 0.0));
            value += row.rows(0, n).transpose().map(|v| Complex64::new(v, 0.0)) * &states;
            sum += size * value.norm() * to_output.column(k).norm();
        }
        Ok(sum)
    }
}

fn roundoff_noise(program: &StepProgram, sys: &DeltaSystem, precision: Precision) -> Result<Option<f64>> {
    let realised = program.to_delta()?;
    if !realised.is_stable()? {
        return Ok(None);
    }
    let (n, m) = (program.n_states, program.n_inputs);
    // The bilinear image has the Gramians of the discrete system.
    let image = realised.continuous_image()?;
    let p = lyapunov::continuous(image.a(), &(image.b() * image.b().transpose()))?.x;
    let q = lyapunov::continuous(&image.a().transpose(), &image.c().tr_mul(image.c()))?.x;
    let mut covariance = DMatrix::identity(n + m, n + m);
    covariance.view_mut((0, 0), (n, n)).copy_from(&p);
    let variance = |row: &DVector<f64>| (row.transpose() * &covariance * row)[(0, 0)].max(0.0);
    let gain = |effect: &DVector<f64>| {
        let (x, y) = (effect.rows(0, n).into_owned(), effect.rows(n, effect.len() - n));
        (x.transpose() * &q * &x)[(0, 0)].max(0.0) + y.norm_squared()
    };
    let (functions, effects) = (program.node_functions(), program.node_effects());
    let mut noise = 0.0;
    for k in 0..program.operations.len() {
        if let Operation::Multiply { coefficient, .. } = program.operations[k]
            && is_power_of_two(program.coefficients[coefficient])
        {
            continue;
        }
        let node = n + m + k;
        noise += variance(&functions.column(node).into_owned()) * gain(&effects.column(node).into_owned());
    }
    for (k, update) in program.updates.iter().enumerate() {
        if let Update::Increment(Some(_)) = update {
            // The sum of a state and its increment has the variance of the state.
            noise += p[(k, k)].max(0.0) * q[(k, k)].max(0.0);
        }
    }
    let (c, d) = (sys.increment().c(), sys.increment().d());
    let output = super::sections::variance_gain(sys)?;
    debug_assert_eq!(c.nrows(), d.nrows());
    let u = precision.unit_roundoff();
    Ok((output > 0.0).then(|| (NOISE_FACTOR * noise).sqrt() * u / output))
}

fn is_power_of_two(value: f64) -> bool {
    let size = value.abs();
    size > 0.0 && size == size.log2().round().exp2()
}

/// Variance of the relative rounding error in units of the squared roundoff: `E[1/m²]/3 = (3/8)/(3 ln 2)` for a significand
/// `m` in [1, 2) with density `1/(m ln 2)`.
const NOISE_FACTOR: f64 = 0.180_337;
/// Responses below this fraction of the largest are taken as that large.
const ZERO_FLOOR: f64 = 1e-6;
const POINTS: i32 = 300;
