//! From a controller to its modes.

use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use serde::{Deserialize, Serialize};
use telepulse_lti::{Continuous, Discrete, SampleTime, StateSpace, TimeDomain};

use super::modal_delta::{ComplexMode, ModalDelta, RealMode};
use crate::{Error, Result};

/// How a continuous controller becomes a discrete one.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "snake_case")]
pub enum Discretization {
    /// Bilinear: `s = (2/T)(z - 1)/(z + 1)`.
    #[default]
    Tustin,
    /// Bilinear, with the response exact at one frequency.
    TustinPrewarped {
        /// That frequency in rad/s.
        omega_rad_s: f64,
    },
}

impl Discretization {
    /// The time `T` in `s = (2/T)(z - 1)/(z + 1)`: the sample time, or what makes the response exact at the chosen frequency.
    pub(super) fn tustin_time_s(self, sample_time: SampleTime) -> Result<f64> {
        let sample_time_s = sample_time.seconds();
        match self {
            Self::Tustin => Ok(sample_time_s),
            Self::TustinPrewarped { omega_rad_s } => {
                if !(omega_rad_s > 0.0 && omega_rad_s < sample_time.nyquist_rad_s()) {
                    let allowed = "above 0 and below the Nyquist frequency";
                    return Err(Error::OutOfRange { key: "omega_rad_s", found: omega_rad_s, allowed });
                }
                Ok(2.0 * (0.5 * omega_rad_s * sample_time_s).tan() / omega_rad_s)
            }
        }
    }
}

/// A controller in modal delta form, and what the change of form cost.
#[derive(Debug, Clone, PartialEq)]
pub struct Realization {
    /// The controller.
    pub law: ModalDelta,
    /// Largest condition number of its poles: a relative change e of the matrices moves a pole by this times e.
    pub condition: f64,
    /// Largest difference between the response of `law` and that of the controller it was made from, relative to the latter.
    pub response_error: f64,
}

/// The modal delta form of a continuous controller.
///
/// **Shapes and units**: one input, one output.
///
/// **Method**: the controller is split into its modes, `K = d + sum r/(s - p)`, while it is still continuous; the bilinear
/// image of a mode then is known in closed form,
/// `z - 1 = pT/(1 - pT/2)`, residue `4 r T/(2 - pT)^2`, direct part `r T/(2 - pT)`.
/// Nowhere is a number near 1 subtracted from 1. Poles come from the balanced real Schur form, residues from the null
/// vectors of `A - pI` on both sides, by inverse iteration. At the end the response is compared with K at the warped
/// frequencies, which involves no mode.
///
/// **Source**: Middleton and Goodwin 1986, IEEE Trans. Autom. Control 31(11), 1015-1021, for the delta operator.
///
/// **Accuracy**: `response_error`, at most 1e-6; near 1e-12 for poles that lie apart.
///
/// # Errors
/// [`Error::NotSiso`]; [`Error::ModesIllConditioned`] for (nearly) repeated poles, which have no modal form;
/// [`Error::PoleAtTwoOverT`]; [`Error::RealizationError`].
///
/// # Example
/// ```
/// use telepulse_design::implement::{Discretization, realize_continuous};
/// use telepulse_lti::{SampleTime, TransferFunction};
/// // 1/(s + 2) at 1 kHz: z - 1 = -0.002/1.001.
/// let lag = TransferFunction::new(&[1.0], &[1.0, 2.0])?.to_state_space();
/// let done = realize_continuous(&lag, SampleTime::new(1e-3)?, Discretization::Tustin)?;
/// assert!((done.law.real[0].lambda + 0.002 / 1.001).abs() < 1e-17);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn realize_continuous(
    controller: &StateSpace<Continuous>,
    sample_time: SampleTime,
    discretization: Discretization,
) -> Result<Realization> {
    let modes = split(controller)?;
    let sample_time_s = sample_time.seconds();
    let tustin_time_s = discretization.tustin_time_s(sample_time)?;
    let mut law =
        ModalDelta { real: Vec::new(), complex: Vec::new(), d: controller.d()[(0, 0)], sample_time_s };
    for mode in &modes.list {
        let (p, r, t) = (mode.pole, mode.residue, tustin_time_s);
        let distance = 2.0 - p * t;
        if distance.norm() < 1e-9 {
            return Err(Error::PoleAtTwoOverT { pole_rad_s: p.re, sample_time_s });
        }
        let direct = r * t / distance;
        law.d += if mode.is_pair() { 2.0 * direct.re } else { direct.re };
        // z - 1 = pT/(1 - pT/2).
        law.push(Mode { pole: 2.0 * p * t / distance, residue: 4.0 * r * t / (distance * distance) });
    }
    let warped = |omega: f64| 2.0 / tustin_time_s * (0.5 * omega * sample_time_s).tan();
    finish(law, modes.condition, |omega| Ok(controller.at(warped(omega))?[(0, 0)]))
}

/// The modal delta form of a discrete controller.
///
/// **Accuracy**: the distance of a pole from 1 is known only as well as the matrix A holds it; a continuous controller loses
/// nothing in [`realize_continuous`].
///
/// # Errors
/// As [`realize_continuous`].
pub fn realize_discrete(controller: &StateSpace<Discrete>) -> Result<Realization> {
    let sample_time_s = controller.sample_time().seconds();
    let modes = split(controller)?;
    let mut law =
        ModalDelta { real: Vec::new(), complex: Vec::new(), d: controller.d()[(0, 0)], sample_time_s };
    for mode in &modes.list {
        law.push(Mode { pole: mode.pole - 1.0, residue: mode.residue });
    }
    finish(law, modes.condition, |omega| Ok(controller.at(omega)?[(0, 0)]))
}

/// Largest condition number of a pole: half of the digits are left.
const CONDITION_MAX: f64 = 1e8;
/// Largest error of the response; a controller's certificate has no use for more digits.
const RESPONSE_ERROR_MAX: f64 = 1e-6;

/// One term `residue/(s - pole)`; a pole with positive imaginary part stands for the pair.
#[derive(Debug, Clone, Copy)]
struct Mode {
    pole: Complex64,
    residue: Complex64,
}

impl Mode {
    fn is_pair(&self) -> bool {
        self.pole.im != 0.0
    }
}

struct Modes {
    list: Vec<Mode>,
    condition: f64,
}

fn split<D: TimeDomain>(controller: &StateSpace<D>) -> Result<Modes> {
    let (n_inputs, n_outputs) = (controller.n_inputs(), controller.n_outputs());
    if (n_inputs, n_outputs) != (1, 1) {
        return Err(Error::NotSiso { n_inputs, n_outputs });
    }
    let balanced = controller.balanced();
    let complex = |m: &DMatrix<f64>| m.map(|v| Complex64::new(v, 0.0));
    let (a, b, c) = (complex(balanced.a()), complex(balanced.b()), complex(balanced.c()));
    let n = a.nrows();
    let mut list = Vec::new();
    let mut worst: f64 = 1.0;
    for pole in balanced.poles()?.into_iter().filter(|p| p.im >= 0.0) {
        // Off the pole by a little, so that the matrix can be inverted.
        let shift = pole + Complex64::new(1.0, 1.0) * (SHIFT * a.norm().max(f64::MIN_POSITIVE / SHIFT));
        let shifted = &a - DMatrix::identity(n, n) * shift;
        let (Some(right), Some(left)) = (null_vector(&shifted), null_vector(&shifted.adjoint())) else {
            return Err(Error::ModesIllConditioned {
                condition: f64::INFINITY,
                condition_max: CONDITION_MAX,
            });
        };
        let left = left.adjoint();
        let overlap = (&left * &right)[(0, 0)];
        let condition = 1.0 / overlap.norm();
        worst = worst.max(condition);
        if worst.is_nan() || worst > CONDITION_MAX {
            return Err(Error::ModesIllConditioned { condition, condition_max: CONDITION_MAX });
        }
        let residue = (&c * &right)[(0, 0)] * (&left * &b)[(0, 0)] / overlap;
        list.push(Mode { pole, residue });
    }
    Ok(Modes { list, condition: worst })
}

/// The direction that a nearly singular matrix nearly maps to zero, by inverse iteration.
fn null_vector(m: &DMatrix<Complex64>) -> Option<DVector<Complex64>> {
    let lu = m.clone().full_piv_lu();
    // A start without symmetry is not orthogonal to any particular vector.
    let mut x =
        DVector::from_fn(m.nrows(), |i, _| Complex64::new((1.0 + i as f64).sqrt(), 0.3 * i as f64 - 1.0));
    for _ in 0..INVERSE_ITERATIONS {
        x = lu.solve(&x)?.normalize();
    }
    x.iter().all(|v| v.re.is_finite() && v.im.is_finite()).then_some(x)
}

/// Each iteration divides what is left of the other directions by (distance to the next pole)/([`SHIFT`] x norm).
const INVERSE_ITERATIONS: usize = 3;
/// Distance from the pole, relative to the norm of the matrix.
const SHIFT: f64 = 1e-14;

impl ModalDelta {
    /// Adds `residue/(delta - pole)`, with input and output gains of the same size.
    fn push(&mut self, mode: Mode) {
        let Mode { pole, residue } = mode;
        if mode.is_pair() {
            // With x = x1 + j x2 the block has the eigenvalue sigma - j omega: y = 2 re(conj(residue) x).
            let b = (2.0 * residue.norm()).sqrt();
            let c = if b > 0.0 { [2.0 * residue.re / b, 2.0 * residue.im / b] } else { [0.0; 2] };
            self.complex.push(ComplexMode { sigma: pole.re, omega: pole.im, b: [b, 0.0], c });
        } else {
            let b = residue.re.abs().sqrt();
            let c = if b > 0.0 { residue.re / b } else { 0.0 };
            self.real.push(RealMode { lambda: pole.re, b, c });
        }
    }
}

/// Compares the law with what it was made from, on frequencies that no pole can hide between.
fn finish(
    law: ModalDelta,
    condition: f64,
    expected: impl Fn(f64) -> Result<Complex64>,
) -> Result<Realization> {
    let mut grid: Vec<f64> =
        (1..200).map(|k| 3.1 / law.sample_time_s * 10_f64.powf(-f64::from(k) * 0.04)).collect();
    grid.extend(law.complex.iter().map(|m| m.omega.atan2(1.0 + m.sigma) / law.sample_time_s));
    let mut pairs = Vec::with_capacity(grid.len());
    for omega in grid {
        pairs.push((omega, law.at(omega), expected(omega)?));
    }
    let peak = pairs.iter().map(|(_, _, e)| e.norm()).fold(0.0, f64::max);
    let mut worst = (0.0, 0.0);
    for (omega, found, expected) in pairs {
        // At a zero of the controller nothing is left to be relative to.
        let error = (found - expected).norm() / expected.norm().max(1e-6 * peak).max(f64::MIN_POSITIVE);
        if error > worst.0 || error.is_nan() {
            worst = (error, omega);
        }
    }
    if worst.0.is_nan() || worst.0 > RESPONSE_ERROR_MAX {
        let (found, omega_rad_s) = worst;
        return Err(Error::RealizationError { found, omega_rad_s, allowed: RESPONSE_ERROR_MAX });
    }
    Ok(Realization { law, condition, response_error: worst.0 })
}
