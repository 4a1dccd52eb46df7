//! The peak of the structured singular value over all frequencies, proven between the frequencies that were looked at.
#![allow(non_snake_case)]

use nalgebra::DMatrix;
use num_complex::Complex64;
use telepulse_lti::{Continuous, Discrete, StateSpace};

use super::eigen::complex_eigenvalues;
use super::mu_bounds::mu_bounds;
use super::mu_lower::{MuLower, MuLowerOptions};
use super::mu_upper::{MuUpper, upper_bound_below};
use super::real_crossing::real_crossings;
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
/// level rises to `1 + tolerance` times the largest bound met, until all of the axis is covered. Each interval is checked with the
/// inequality itself at and between the frequencies of all eigenvalues, and on a ladder of frequencies around its start. Real parameters alone can make the structured singular value jump
/// at a single frequency: such places are sought by following the poles along the diagonals of the box, and
/// where intervals close in on one, the level rises to what scales prove across it.
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
    peak_above(sys, structure, tolerance, 0.0, Aim::Peak)
}

/// What a search for the peak is for.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Aim {
    /// The peak itself.
    Peak,
    /// Whether the peak is proven to lie at or below the floor: the search ends where it is not.
    Test,
}

/// As [`mu_peak`], but content with an upper bound of `floor`; for [`Aim::Test`] an `upper` above it proves nothing.
pub(super) fn peak_above(
    sys: &StateSpace<Continuous>,
    structure: &BlockStructure,
    tolerance: f64,
    floor: f64,
    aim: Aim,
) -> Result<MuPeak, Error> {
    structure.check(&sys.d().map(|v| Complex64::new(v, 0.0)))?;
    check_tolerance(tolerance)?;
    let poles = sys.poles()?;
    if let Some(&pole) = poles.iter().find(|p| p.re >= -1e-14 * p.norm()) {
        return Err(telepulse_lti::Error::Unstable { pole }.into());
    }
    let sys = &sys.balanced();
    let tolerance = tolerance.clamp(1e-6, 1.0);
    let crossings = real_crossings(sys, structure)?;
    let mut starts: Vec<f64> = poles.iter().map(|p| p.norm()).chain([0.0, f64::INFINITY]).collect();
    starts.extend(crossings.iter().map(|crossing| crossing.omega_rad_s));
    starts.sort_by(f64::total_cmp);
    starts.dedup();
    let mut cover = Cover { sys, structure, tolerance, level: floor, seen: Vec::new(), intervals: 0 };
    cover.level = cover.level.max(f64::MIN_POSITIVE.sqrt());
    for &omega in &starts {
        cover.evaluate(omega)?;
    }
    // What an example shows is not to be denied by rounding.
    if let Some(first) = crossings.first() {
        cover.level = cover.level.max(first.lower.value * (1.0 + tolerance));
    }
    let is_done = |cover: &Cover<'_>| aim == Aim::Test && cover.level > floor;
    let mut open: Vec<(f64, f64)> = vec![(0.0, f64::INFINITY)];
    for &omega in &starts {
        let at: Vec<_> = open.iter().copied().filter(|&(a, b)| a <= omega && omega <= b).collect();
        open.retain(|&(a, b)| !(a <= omega && omega <= b));
        for interval in at {
            if !is_done(&cover) {
                cover.prove(omega, interval, &mut open)?;
            }
        }
    }
    while let Some((a, b)) = open.pop().filter(|_| !is_done(&cover)) {
        let omega = match (a > 0.0, b.is_finite()) {
            (true, true) => (a.sqrt() * b.sqrt()).clamp(a, b),
            (true, false) => 4.0 * a,
            (false, true) => 0.25 * b,
            (false, false) => 1.0,
        };
        cover.prove(omega, (a, b), &mut open)?;
    }
    cover.seen.sort_by(|x, y| y.1.total_cmp(&x.1));
    let mut found: Option<(f64, MuLower)> =
        crossings.into_iter().next().map(|crossing| (crossing.omega_rad_s, crossing.lower));
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
        let bound = self.least_bound(&m, omega)?;
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

    /// The least bound at a frequency; where the search for its scales ends early, that of scales from close by if it is smaller.
    fn least_bound(&self, m: &DMatrix<Complex64>, omega: f64) -> Result<MuUpper, Error> {
        let mut best = upper_bound_below(m, self.structure, 0.0)?;
        if best.relative_gap <= GAP_MAX || omega == 0.0 || omega.is_infinite() {
            return Ok(best);
        }
        for shift in NEARBY {
            let beside = response(self.sys, omega * (1.0 + shift))?;
            let scalings = upper_bound_below(&beside, self.structure, 0.0)?.scalings;
            let (mut low, mut high) = (0.0, best.value);
            if !scalings.prove(m, self.structure, high * (1.0 - NEARBY_GAIN))? {
                continue;
            }
            for _ in 0..NEARBY_STEPS {
                let middle = f64::midpoint(low, high);
                if scalings.prove(m, self.structure, middle)? {
                    high = middle;
                } else {
                    low = middle;
                }
            }
            best = MuUpper { value: high, scalings, ..best };
        }
        Ok(best)
    }

    /// Proves the level around `omega` and gives back what is left of the interval.
    fn prove(&mut self, omega: f64, (a, b): (f64, f64), open: &mut Vec<(f64, f64)>) -> Result<(), Error> {
        self.intervals += 1;
        if self.intervals > INTERVALS_MAX {
            return Err(Error::MuNotProven { level: self.level });
        }
        let scalings = self.evaluate(omega)?;
        let (low, high) = match self.reach(&scalings, omega, self.level)? {
            Some(ends) => ends,
            None => self.raise(omega)?,
        };
        // Neighbours have to overlap.
        if low > a {
            let end = if omega.is_finite() { low + OVERLAP * (omega - low) } else { low * (1.0 + OVERLAP) };
            open.push((a, end));
        }
        if high < b {
            open.push((high - OVERLAP * (high - omega), b));
        }
        Ok(())
    }

    /// How far on both sides of `omega` the scales prove the level; none where not even there.
    fn reach(&self, scalings: &Scalings, omega: f64, level: f64) -> Result<Option<(f64, f64)>, Error> {
        let (mut low, mut high) = (0.0_f64, f64::INFINITY);
        // A level a little lower leaves room for the rounding of the test.
        let candidates = self.crossings(scalings, level * (1.0 - LEVEL_ROOM))?;
        for &Candidate { frequency, off, is_near } in &candidates {
            if is_near && frequency - off <= omega {
                low = low.max(frequency + off);
            }
            if is_near && frequency + off >= omega {
                high = high.min(frequency - off);
            }
        }
        // An eigenvalue that rounding has moved off the axis would hide a crossing: the level is tested at the frequencies of
        // all of them, and between neighbours.
        let mut points: Vec<f64> = candidates.iter().map(|c| c.frequency).filter(|&f| f > 0.0).collect();
        if omega > 0.0 && omega.is_finite() {
            for k in 1..=LADDER {
                let step = 0.5_f64.powi(k);
                points.extend([omega * (1.0 + step), omega * (1.0 - step), omega / step, omega * step]);
            }
        }
        points.sort_by(f64::total_cmp);
        let between: Vec<f64> = points.windows(2).map(|pair| pair[0].sqrt() * pair[1].sqrt()).collect();
        points.extend(between);
        points.sort_by(f64::total_cmp);
        points.dedup();
        let holds = |at: f64| scalings.prove(&response(self.sys, at)?, self.structure, level);
        for &point in points.iter().filter(|&&p| p > omega && p < high) {
            if !holds(point)? {
                high = f64::midpoint(omega, point);
                break;
            }
        }
        for &point in points.iter().rev().filter(|&&p| p < omega && p > low) {
            if !holds(point)? {
                low = if omega.is_finite() { f64::midpoint(omega, point) } else { 2.0 * point };
                break;
            }
        }
        let is_low_end = omega == 0.0 || low < omega;
        let is_high_end = omega.is_infinite() || high > omega;
        Ok((is_low_end && is_high_end).then_some((low, high)))
    }

    /// Raises the level to the least one that scales of `omega` prove around it.
    ///
    /// With real blocks alone the structured singular value jumps: at a single frequency it may be large that is small on
    /// both sides. The frequencies that were looked at close in on such a place without hitting it, and the scales that prove
    /// a small bound beside it prove nothing on the other side. Scales that are content with more do.
    fn raise(&mut self, omega: f64) -> Result<(f64, f64), Error> {
        let m = response(self.sys, omega)?;
        let is_wide = |(low, high): (f64, f64)| {
            let span = JUMP_SHARE * omega;
            omega == 0.0 || omega.is_infinite() || (low <= omega - span && high >= omega + span)
        };
        let attempt = |level: f64| -> Result<Option<(f64, f64)>, Error> {
            let bound = upper_bound_below(&m, self.structure, level * (1.0 - 2.0 * LEVEL_ROOM))?;
            // Beside the place a small bound needs a large G of one sign, across it one near zero.
            for k in 0..=G_SHARES {
                let share = if k < G_SHARES { 10.0_f64.powf(-0.5 * f64::from(k)) } else { 0.0 };
                let mut scalings = bound.scalings.clone();
                scalings.g.iter_mut().for_each(|g| g.apply(|v| *v *= share));
                if let Some(ends) = self.reach(&scalings, omega, level)?.filter(|&ends| is_wide(ends))
                    && scalings.prove(&m, self.structure, level)?
                {
                    return Ok(Some(ends));
                }
            }
            Ok(None)
        };
        let (mut failed, mut proven) = (self.level, None);
        let mut level = self.level;
        for _ in 0..RAISES_MAX {
            level *= RAISE;
            if let Some(ends) = attempt(level)? {
                proven = Some((level, ends));
                break;
            }
            failed = level;
        }
        let (mut level, mut ends) = proven.ok_or(Error::MuNotProven { level: self.level })?;
        for _ in 0..RAISES_MAX {
            if level <= failed * (1.0 + 0.25 * self.tolerance) {
                break;
            }
            let middle = failed.sqrt() * level.sqrt();
            match attempt(middle)? {
                Some(found) => (level, ends) = (middle, found),
                None => failed = middle,
            }
        }
        self.level = level * (1.0 + 0.25 * self.tolerance);
        self.seen.push((omega, failed));
        Ok(ends)
    }

    /// Frequencies at which the scales may cease to prove the level.
    fn crossings(&self, scalings: &Scalings, level: f64) -> Result<Vec<Candidate>, Error> {
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
        let found = values.iter().filter(|v| v.im >= -rounding);
        let candidate =
            |v: &Complex64| Candidate { frequency: v.im.max(0.0), off: v.re.abs(), is_near: near(v) };
        Ok(found.map(candidate).collect())
    }
}

/// An eigenvalue of the Hamiltonian matrix, seen from the axis.
struct Candidate {
    frequency: f64,
    /// Distance from the axis.
    off: f64,
    /// Whether the distance may be rounding.
    is_near: bool,
}

fn response(sys: &StateSpace<Continuous>, omega: f64) -> Result<DMatrix<Complex64>, Error> {
    if omega.is_finite() {
        return Ok(sys.at(omega)?);
    }
    Ok(sys.d().map(|v| Complex64::new(v, 0.0)))
}

/// Reached where a bound is flat over decades and the tolerance small: the count grows with its inverse.
const INTERVALS_MAX: usize = 20_000;
/// Frequencies, worst first, at which a lower bound is sought.
const LOWER_TRIES: usize = 3;
const LEVEL_ROOM: f64 = 1e-7;
/// Gap of a search for scales, relative, above which those of frequencies close by are tried, and how far away they are.
const GAP_MAX: f64 = 1e-6;
const NEARBY: [f64; 6] = [1e-4, -1e-4, 1e-3, -1e-3, 1e-2, -1e-2];
/// Least gain for which they are taken, and steps of the bisection for their level.
const NEARBY_GAIN: f64 = 1e-6;
const NEARBY_STEPS: usize = 40;
/// Frequencies on each side at which a proof is checked: one more halving of the distance each.
const LADDER: i32 = 12;
/// Shares of G that are tried across a jump, half a decade apart, and zero.
const G_SHARES: u32 = 14;
/// Steps of a search for the level that holds beside a jump, and their ratio.
const RAISES_MAX: usize = 80;
const RAISE: f64 = 1.5;
/// What scales have to prove on each side of a frequency near a jump, relative to it, to count as proof across the jump.
const JUMP_SHARE: f64 = 1e-6;
/// Share of an interval that its neighbour covers again.
const OVERLAP: f64 = 1e-3;
const ROUNDING: f64 = 100.0;
const NEAR_AXIS: f64 = 1e-7;
