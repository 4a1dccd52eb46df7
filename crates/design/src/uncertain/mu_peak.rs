//! The peak of the structured singular value over all frequencies, proven between the frequencies that were looked at.
#![allow(non_snake_case)]

use nalgebra::DMatrix;
use num_complex::Complex64;
use telepulse_lti::{Continuous, Discrete, StateSpace};

use super::eigen::complex_eigenvalues;
use super::mu_bounds::mu_bounds;
use super::mu_lower::{MuLower, MuLowerOptions};
use super::mu_upper::upper_bound_below;
use super::scalings::Scalings;
use super::structure::BlockStructure;
use crate::Error;

/// The peak over frequency of the structured singular value, bracketed.
#[derive(Clone, Debug, PartialEq)]
pub struct MuPeak {
    /// No frequency, on a grid or off it, has a structured singular value above this.
    pub upper: f64,
    /// The example: a perturbation that makes the loop singular at `omega_rad_s`.
    pub lower: MuLower,
    /// Where the example was found, in rad/s: of the three frequencies with the largest upper bounds that were looked at,
    /// the one with the largest lower bound. Infinite where the example is one of the direct term; equal to
    /// `upper_omega_rad_s` where `lower` is zero, without an example.
    pub omega_rad_s: f64,
    /// Where the bound by D,G-scales binds, in rad/s: the frequency with the largest one of all that were looked at, within the
    /// tolerance of `upper`; may be infinite.
    pub upper_omega_rad_s: f64,
    /// Frequency intervals, each proven with one set of scales, that cover the axis.
    pub intervals: usize,
}

/// Returns a proven bracket of the peak over `0 <= omega <= inf` of the structured singular value of a stable system.
///
/// **Shapes**: `sys` has the `n_w` inputs and `n_z` outputs of the structure.
///
/// **Method**: D,G-scales that prove the level at one frequency, with room to spare, are kept, and the imaginary eigenvalues of a Hamiltonian
/// matrix tell how far on both sides they prove the level. Intervals are added where the axis is not covered, and the
/// level rises to `1 + tolerance` times the largest bound met, until all of the axis is covered.
///
/// **Source**: Boyd, Balakrishnan and Kabamba 1989 for the Hamiltonian test; Fan, Tits and Doyle 1991 for the scales.
///
/// **Accuracy**: `upper` is within `tolerance`, relative, of the peak of the bound by D,G-scales, but for rounding. The
/// lower bound is that of [`mu_bounds`] at the worst frequencies met.
///
/// **Errors**: [`telepulse_lti::Error::Unstable`] for an unstable system, [`telepulse_lti::Error::Shape`],
/// [`telepulse_lti::Error::NotFinite`] for a tolerance that is not finite, [`Error::MuNotProven`] where rounding keeps the intervals from meeting.
pub fn mu_peak(
    sys: &StateSpace<Continuous>,
    structure: &BlockStructure,
    tolerance: f64,
) -> Result<MuPeak, Error> {
    structure.check(&sys.d().map(|v| Complex64::new(v, 0.0)))?;
    check_tolerance(tolerance)?;
    let poles = sys.poles()?;
    if let Some(&pole) = poles.iter().find(|p| p.re >= -1e-14 * p.norm()) {
        return Err(telepulse_lti::Error::Unstable { pole }.into());
    }
    let sys = &sys.balanced();
    let tolerance = tolerance.clamp(1e-6, 1.0);
    let mut starts: Vec<f64> = poles.iter().map(|p| p.norm()).chain([0.0, f64::INFINITY]).collect();
    starts.sort_by(f64::total_cmp);
    starts.dedup();
    let mut cover = Cover { sys, structure, tolerance, level: 0.0, seen: Vec::new(), intervals: 0 };
    for &omega in &starts {
        cover.evaluate(omega)?;
    }
    let mut open: Vec<(f64, f64)> = vec![(0.0, f64::INFINITY)];
    for &omega in &starts {
        let at: Vec<_> = open.iter().copied().filter(|&(a, b)| a <= omega && omega <= b).collect();
        open.retain(|&(a, b)| !(a <= omega && omega <= b));
        for interval in at {
            cover.prove(omega, interval, &mut open)?;
        }
    }
    while let Some((a, b)) = open.pop() {
        let omega = match (a > 0.0, b.is_finite()) {
            (true, true) => (a.sqrt() * b.sqrt()).clamp(a, b),
            (true, false) => 4.0 * a,
            (false, true) => 0.25 * b,
            (false, false) => 1.0,
        };
        cover.prove(omega, (a, b), &mut open)?;
    }
    cover.seen.sort_by(|x, y| y.1.total_cmp(&x.1));
    let mut found: Option<(f64, MuLower)> = None;
    for &(omega, _) in cover.seen.iter().take(LOWER_TRIES) {
        let lower = mu_bounds(&response(sys, omega)?, structure, &MuLowerOptions::default())?.lower;
        if found.as_ref().is_none_or(|(_, best)| lower.value > best.value) {
            found = Some((omega, lower));
        }
    }
    let (omega_rad_s, lower) = found.ok_or(Error::NoUncertainBlocks)?;
    let upper_omega_rad_s = cover.seen.first().map_or(omega_rad_s, |&(omega, _)| omega);
    Ok(MuPeak { upper: cover.level, lower, omega_rad_s, upper_omega_rad_s, intervals: cover.intervals })
}

/// Returns a proven bracket of the peak over `0 <= omega <= pi / T` of the structured singular value of a stable discrete system.
///
/// **Shapes**: as [`mu_peak`]; frequencies in the answer are those of the discrete system, at most `pi / T`.
///
/// **Method**: [`mu_peak`] of the continuous system whose bilinear image this one is: the map takes the unit circle to the imaginary
/// axis, `omega T / 2 = atan(nu T / 2)`, and keeps the response at every point.
///
/// **Accuracy**: as [`mu_peak`]; poles within rounding of `-1` cost digits.
///
/// **Errors**: as [`mu_peak`], with the pole in the unit of the z plane.
///
/// **Example**
/// ```
/// use nalgebra::dmatrix;
/// use telepulse_design::uncertain::{Block, BlockStructure, mu_peak_discrete};
/// use telepulse_lti::{Discrete, SampleTime, StateSpace};
/// // 1/(z + 0.5) is largest at z = -1.
/// let dt = SampleTime::new(0.1)?;
/// let sys = StateSpace::<Discrete>::new(dmatrix![-0.5], dmatrix![1.0], dmatrix![1.0], dmatrix![0.0], dt)?;
/// let structure = BlockStructure::new(vec![Block::Full { rows: 1, cols: 1 }])?;
/// let peak = mu_peak_discrete(&sys, &structure, 1e-4)?;
/// assert!(peak.lower.value > 1.9999 && peak.upper < 2.0005);
/// assert!((peak.omega_rad_s - dt.nyquist_rad_s()).abs() < 1e-9);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn mu_peak_discrete(
    sys: &StateSpace<Discrete>,
    structure: &BlockStructure,
    tolerance: f64,
) -> Result<MuPeak, Error> {
    if let Some(&pole) = sys.poles()?.iter().find(|p| p.norm() >= 1.0) {
        return Err(telepulse_lti::Error::Unstable { pole }.into());
    }
    let half_s = 0.5 * sys.sample_time().seconds();
    let to_discrete = |omega_rad_s: f64| (omega_rad_s * half_s).atan() / half_s;
    let peak = mu_peak(&sys.to_continuous_tustin()?, structure, tolerance)?;
    Ok(MuPeak {
        omega_rad_s: to_discrete(peak.omega_rad_s),
        upper_omega_rad_s: to_discrete(peak.upper_omega_rad_s),
        ..peak
    })
}

pub(super) fn check_tolerance(value: f64) -> Result<(), Error> {
    if value.is_finite() {
        return Ok(());
    }
    Err(telepulse_lti::Error::NotFinite { quantity: "tolerance", index: 0, value }.into())
}

struct Cover<'a> {
    sys: &'a StateSpace<Continuous>,
    structure: &'a BlockStructure,
    tolerance: f64,
    level: f64,
    seen: Vec<(f64, f64)>,
    intervals: usize,
}

impl Cover<'_> {
    fn evaluate(&mut self, omega: f64) -> Result<Scalings, Error> {
        let m = response(self.sys, omega)?;
        let bound = upper_bound_below(&m, self.structure, 0.0)?;
        self.seen.push((omega, bound.value));
        self.level = self.level.max(bound.value * (1.0 + self.tolerance)).max(f64::MIN_POSITIVE.sqrt());
        // Scales between the best and the level hold on wider intervals than the best ones.
        let enough = f64::midpoint(bound.value.powi(2), self.level.powi(2)).sqrt();
        let relaxed = upper_bound_below(&m, self.structure, enough)?;
        Ok(if relaxed.value < self.level * (1.0 - 2.0 * LEVEL_ROOM) {
            relaxed.scalings
        } else {
            bound.scalings
        })
    }

    /// Proves the level around `omega` and gives back what is left of the interval.
    fn prove(&mut self, omega: f64, (a, b): (f64, f64), open: &mut Vec<(f64, f64)>) -> Result<(), Error> {
        self.intervals += 1;
        if self.intervals > INTERVALS_MAX {
            return Err(Error::MuNotProven { level: self.level });
        }
        let scalings = self.evaluate(omega)?;
        let (mut low, mut high) = (0.0_f64, f64::INFINITY);
        // A level a little lower leaves room for the rounding of the test.
        for (frequency, off) in self.crossings(&scalings, self.level * (1.0 - LEVEL_ROOM))? {
            if frequency - off <= omega {
                low = low.max(frequency + off);
            }
            if frequency + off >= omega {
                high = high.min(frequency - off);
            }
        }
        // Neighbours have to overlap.
        if low > a {
            if low >= omega {
                return Err(Error::MuNotProven { level: self.level });
            }
            let end = if omega.is_finite() { low + OVERLAP * (omega - low) } else { low * (1.0 + OVERLAP) };
            open.push((a, end));
        }
        if high < b {
            if high <= omega {
                return Err(Error::MuNotProven { level: self.level });
            }
            open.push((high - OVERLAP * (high - omega), b));
        }
        Ok(())
    }

    /// Frequencies, with their uncertainty, at which the scales may cease to prove the level.
    fn crossings(&self, scalings: &Scalings, level: f64) -> Result<Vec<(f64, f64)>, Error> {
        let n = self.sys.n_states();
        if n == 0 {
            return Ok(vec![]);
        }
        let complex = |m: &DMatrix<f64>| m.map(|v| Complex64::new(v, 0.0));
        let (A, B, C, D) =
            (complex(self.sys.a()), complex(self.sys.b()), complex(self.sys.c()), complex(self.sys.d()));
        let (left, right) = (scalings.left(self.structure), scalings.right(self.structure));
        let j_g = scalings.g_matrix(self.structure) * Complex64::new(0.0, 1.0);
        let failed = Error::MuNotProven { level };
        let Q = -(C.adjoint() * &left * &C);
        let S_h = -(D.adjoint() * &left * &C) - &j_g * &C;
        let j_g_d = &j_g * &D;
        let R =
            right * Complex64::new(level * level, 0.0) - D.adjoint() * left * &D - &j_g_d - j_g_d.adjoint();
        let R_inverse = R.try_inverse().ok_or(failed.clone())?;
        let F = A - &B * &R_inverse * &S_h;
        let upper = -(&B * &R_inverse * B.adjoint());
        let lower = S_h.adjoint() * &R_inverse * &S_h - Q;
        let ratio = (lower.norm() / upper.norm()).sqrt();
        let ratio = Complex64::new(if ratio.is_finite() && ratio > 0.0 { ratio } else { 1.0 }, 0.0);
        let mut H = DMatrix::zeros(2 * n, 2 * n);
        H.view_mut((0, 0), (n, n)).copy_from(&F);
        H.view_mut((0, n), (n, n)).copy_from(&(upper * ratio));
        H.view_mut((n, 0), (n, n)).copy_from(&(lower / ratio));
        H.view_mut((n, n), (n, n)).copy_from(&(-F.adjoint()));
        let rounding = ROUNDING * f64::EPSILON * H.norm();
        let near = |v: &Complex64| v.re.abs() <= rounding + NEAR_AXIS * v.norm();
        let values = complex_eigenvalues(&H).ok_or(failed)?;
        let found = values.iter().filter(|v| near(v) && v.im >= -rounding);
        Ok(found.map(|v| (v.im.max(0.0), v.re.abs())).collect())
    }
}

fn response(sys: &StateSpace<Continuous>, omega: f64) -> Result<DMatrix<Complex64>, Error> {
    if omega.is_finite() {
        return Ok(sys.at(omega)?);
    }
    Ok(sys.d().map(|v| Complex64::new(v, 0.0)))
}

const INTERVALS_MAX: usize = 2000;
/// Frequencies, worst first, at which a lower bound is sought.
const LOWER_TRIES: usize = 3;
const LEVEL_ROOM: f64 = 1e-7;
/// Share of an interval that its neighbour covers again.
const OVERLAP: f64 = 1e-3;
const ROUNDING: f64 = 100.0;
const NEAR_AXIS: f64 = 1e-7;
