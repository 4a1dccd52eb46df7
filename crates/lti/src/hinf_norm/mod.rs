//! The H-infinity norm: the peak of the largest singular value of the frequency response, as a proven bracket.

mod climb;
mod gain;
mod level;
mod reduced;
mod refined;
#[cfg(test)]
mod stress;

use num_complex::Complex64;
use serde::{Deserialize, Serialize};

use self::climb::{Goal, Seen, climb};
use self::gain::GainEvaluator;
use self::level::{Crossing, LevelTest};
use self::reduced::Reduced;
use self::refined::refined_gain;
use crate::{Error, StateSpace, TimeDomain};

/// The peak gain of a stable system over all frequencies, bracketed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PeakGain {
    /// Best value: the largest gain seen.
    pub value: f64,
    /// Frequency at which it was seen, in rad/s; infinite (`null` in files) where only the limit reaches it.
    #[serde(with = "infinity_as_null")]
    pub omega_rad_s: f64,
    /// `value` less the rounding error that its evaluation can have: the norm is not below it.
    pub lower: f64,
    /// A level that no singular value of the response reaches: the norm is not above it.
    pub upper: f64,
}

/// Returns the H-infinity norm of a stable system, continuous or discrete.
///
/// **Method**: states that no port sees go, the rest is balanced and brought to Hessenberg form, so that a gain costs
/// `O(n²)`. The best of the gains at zero, infinity and the frequencies of the poles are followed to their local peaks. A
/// level just above the highest has its crossing frequencies as the imaginary eigenvalues of a Hamiltonian matrix: one
/// that shows a higher gain starts another climb; when none does, the upper end is proven. Every eigenvalue that
/// rounding could have moved off the axis counts as a possible crossing. Discrete systems are evaluated on the unit
/// circle, and only the Hamiltonian goes through a bilinear map, with its pole at the point `1` or `-1` that is farther from
/// the poles.
///
/// **Source**: Boyd, Balakrishnan and Kabamba 1989; Bruinsma and Steinbuch 1990.
///
/// **Accuracy**: `value` is accurate to a few units of the machine precision: where a pole is so close that the Hessenberg
/// form would cost more, the gain is evaluated again with residuals in doubled precision. `upper / lower - 1` is
/// `1e-10`, or ten times the rounding of the Hessenberg form where that is more.
///
/// **Errors**: [`Error::Unstable`] for a pole on or beyond the stability boundary, seen by a port or not;
/// [`Error::PeakNotBounded`], [`Error::EigenvaluesNotConverged`].
///
/// **Example**
/// ```
/// // A resonance with damping ratio 0.1 peaks at 1 / (2 · 0.1 · sqrt(1 - 0.01)).
/// let g = telepulse_lti::TransferFunction::new(&[1.0], &[1.0, 0.2, 1.0])?;
/// let peak = telepulse_lti::hinf_norm(&g.to_state_space())?;
/// assert!((peak.value - 1.0 / (0.2 * 0.99_f64.sqrt())).abs() < 1e-14);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn hinf_norm<D: TimeDomain>(sys: &StateSpace<D>) -> Result<PeakGain, Error> {
    Ok(hinf_norm_and_poles(sys)?.0)
}

/// Returns the H-infinity norm and the poles, which it takes to find it.
///
/// **Method**, **Accuracy**, **Errors**: as [`hinf_norm()`]; the poles as those of [`StateSpace::poles`].
///
/// **Example**
/// ```
/// let g = telepulse_lti::TransferFunction::new(&[2.0], &[1.0, 4.0])?;
/// let (peak, poles) = telepulse_lti::hinf_norm::hinf_norm_and_poles(&g.to_state_space())?;
/// assert!((peak.value - 0.5).abs() < 1e-15 && (poles[0].re + 4.0).abs() < 1e-15);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn hinf_norm_and_poles<D: TimeDomain>(sys: &StateSpace<D>) -> Result<(PeakGain, Vec<Complex64>), Error> {
    let (reduced, poles) = Reduced::new(sys)?;
    match poles.iter().find(|&&pole| reduced.damping_of(pole) <= BOUNDARY) {
        Some(&pole) => Err(Error::Unstable { pole }),
        None => Ok((Search::new(&reduced).peak()?, poles)),
    }
}

/// Returns the L-infinity norm, the peak gain over all frequencies of a system that may be unstable.
///
/// **Method**, **Accuracy**: as [`hinf_norm()`], which equals it for a stable system.
///
/// **Errors**: [`Error::PoleAtFrequency`] for a pole on the stability boundary that the ports see, where the norm is
/// infinite; [`Error::PeakNotBounded`], [`Error::EigenvaluesNotConverged`].
///
/// **Example**
/// ```
/// // 2 / (s - 1) has no H-infinity norm; on the axis it is largest at zero.
/// let g = telepulse_lti::TransferFunction::new(&[2.0], &[1.0, -1.0])?;
/// assert!((telepulse_lti::hinf_norm::linf_norm(&g.to_state_space())?.value - 2.0).abs() < 1e-15);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn linf_norm<D: TimeDomain>(sys: &StateSpace<D>) -> Result<PeakGain, Error> {
    let (reduced, _) = Reduced::new(sys)?;
    match reduced.poles.iter().find(|&&pole| reduced.damping_of(pole).abs() <= BOUNDARY) {
        Some(&pole) => {
            let omega_rad_s = match reduced.sample_time_s {
                None => pole.im.abs(),
                Some(sample_time) => pole.arg().abs() / sample_time,
            };
            Err(Error::PoleAtFrequency { omega_rad_s })
        }
        None => Search::new(&reduced).peak(),
    }
}

impl<D: TimeDomain> StateSpace<D> {
    /// Returns the H-infinity norm; see [`hinf_norm()`].
    ///
    /// **Errors**: as [`hinf_norm()`].
    pub fn hinf_norm(&self) -> Result<PeakGain, Error> {
        hinf_norm(self)
    }
}

struct Search<'a> {
    sys: &'a Reduced,
    gains: GainEvaluator<'a>,
    best: Seen,
    /// Bound on the error of the best gain.
    error: f64,
    /// The same bound before the gain was refined: what the Hessenberg form and the Hamiltonian can resolve.
    rounding: f64,
}

impl<'a> Search<'a> {
    fn new(sys: &'a Reduced) -> Self {
        let best = Seen { gain: 0.0, frequency: 0.0 };
        Self { sys, gains: GainEvaluator::new(sys), best, error: 0.0, rounding: 0.0 }
    }

    fn peak(mut self) -> Result<PeakGain, Error> {
        if self.sys.balanced.is_empty() {
            let value = self.gains.gain(f64::INFINITY);
            let error = if self.sys.d.len() > 1 { 4.0 * f64::EPSILON * value } else { 0.0 };
            return Ok(PeakGain { value, omega_rad_s: 0.0, lower: value - error, upper: value + error });
        }
        self.climb_from_starts();
        self.refine()?;
        let test = LevelTest::new(self.sys)?;
        for _ in 0..LEVELS_MAX {
            let margin = (ROUNDING_MARGIN * self.rounding / self.best.gain).clamp(MARGIN, MARGIN_MAX);
            let margin = self.best.gain * if margin.is_nan() { MARGIN } else { margin };
            let level = (self.best.gain + margin).max(test.floor() * (1.0 + MARGIN));
            let level = level.max(f64::MIN_POSITIVE.sqrt());
            if !level.is_finite() {
                return Err(Error::PeakNotBounded { lower: self.best.gain, level });
            }
            let crossings = test.crossings(level)?;
            // Rounding of a graded Hamiltonian hides crossings: there the frequencies between the poles are looked at as well.
            if !self.climb_above(level, &crossings)? && !self.look_between_poles(level)? {
                let peak = self.bracket(level);
                // Where doubled precision leaves three digits or fewer, its own error bound is not to be trusted either.
                let lost = peak.upper - peak.lower > LOST * peak.value && peak.value > 0.0;
                return if lost {
                    Err(Error::PeakNotBounded { lower: peak.lower, level: peak.upper })
                } else {
                    Ok(peak)
                };
            }
        }
        Err(Error::PeakNotBounded { lower: self.best.gain, level: self.best.gain })
    }

    fn bracket(&self, level: f64) -> PeakGain {
        let value = self.best.gain;
        let frequency = self.best.frequency;
        PeakGain {
            value,
            omega_rad_s: self.sys.sample_time_s.map_or(frequency, |sample_time| frequency / sample_time),
            lower: (value - self.error).max(0.0),
            upper: level.max(value + self.error),
        }
    }

    /// Looks at zero, the far end and every pole, and climbs from the best few.
    fn climb_from_starts(&mut self) {
        let ends = [0.0, if self.sys.sample_time_s.is_some() { std::f64::consts::PI } else { f64::INFINITY }];
        for frequency in ends {
            let seen = Seen { gain: self.gains.gain(frequency), frequency };
            if seen.gain > self.best.gain {
                self.best = seen;
            }
        }
        let mut starts: Vec<(Seen, f64)> = self
            .sys
            .start_frequencies()
            .into_iter()
            .map(|(frequency, width)| (Seen { gain: self.gains.gain(frequency), frequency }, width))
            .collect();
        starts.sort_by(|x, y| y.0.gain.total_cmp(&x.0.gain));
        let mut known: Vec<(f64, f64)> = Vec::with_capacity(CLIMBS_MAX);
        for &(start, width) in &starts {
            if known.len() == CLIMBS_MAX || start.gain < WORTH_A_CLIMB * self.best.gain {
                break;
            }
            if known.iter().any(|&(low, high)| start.frequency >= low && start.frequency <= high) {
                continue;
            }
            // The highest start goes all the way, the others only as soon as they turn out to lead higher.
            let goal = if known.is_empty() { Goal::Peak } else { Goal::Rough };
            let mut top = climb(|f| self.gains.gain(f), start, STEP * width, goal);
            if goal == Goal::Rough && top.gain > WORTH_GOING_ON * self.best.gain {
                top = climb(|f| self.gains.gain(f), top, STEP_ON * width, Goal::Peak);
            }
            let (low, high) = (top.frequency.min(start.frequency), top.frequency.max(start.frequency));
            known.push((low - STEP * width, high + STEP * width));
            if top.gain > self.best.gain {
                self.best = top;
            }
        }
    }

    /// Evaluates the best gain anew where the Hessenberg form was not accurate enough.
    fn refine(&mut self) -> Result<(), Error> {
        if self.best.frequency.is_infinite() {
            (self.error, self.rounding) = (4.0 * f64::EPSILON * self.best.gain, 0.0);
            return Ok(());
        }
        self.gains.gain(self.best.frequency);
        self.rounding = self.gains.rounding(self.best.frequency);
        self.error = self.rounding;
        if self.rounding <= REFINE_ABOVE * self.best.gain {
            return Ok(());
        }
        let unrefined = self.best.gain;
        let sys = self.sys;
        let pole = sys.nearest_pole(self.best.frequency);
        let mut refined = refined_gain(sys, self.best.frequency).ok_or(Error::Unstable { pole })?;
        if self.rounding > CLIMB_AGAIN_ABOVE * refined.gain {
            // The Hessenberg form has moved the peak by a good part of its width.
            let start = Seen { gain: refined.gain, frequency: self.best.frequency };
            let look = |f: f64| refined_gain(sys, f).map_or(0.0, |r| r.gain);
            self.best = climb(look, start, STEP * sys.damping_width(pole), Goal::Peak);
            refined = refined_gain(sys, self.best.frequency).ok_or(Error::Unstable { pole })?;
        }
        // What the Hessenberg form really lost, far less than the bound where the system is graded.
        self.rounding = (unrefined - refined.gain).abs();
        (self.best.gain, self.error) = (refined.gain, refined.error);
        Ok(())
    }

    /// Looks at frequencies over the range of the poles, where that spans so many decades that the level test may be blind;
    /// whether a gain above the level was found.
    fn look_between_poles(&mut self, level: f64) -> Result<bool, Error> {
        let sys = self.sys;
        if sys.sample_time_s.is_some() {
            return Ok(false);
        }
        let sizes = sys.poles.iter().map(|pole| pole.norm()).filter(|size| *size > 0.0);
        let (low, high) =
            sizes.fold((f64::INFINITY, 0.0_f64), |(low, high), size| (low.min(size), high.max(size)));
        let decades = (high / low).log10();
        if !(decades > GRADED_DECADES && decades.is_finite()) {
            return Ok(false);
        }
        let count = (decades * PROBES_PER_DECADE).ceil();
        let mut best = Seen { gain: level, frequency: 0.0 };
        for k in 0..=count as u32 {
            let frequency = low * 10.0_f64.powf(decades / count * f64::from(k));
            let rough = self.gains.gain(frequency);
            // The Hessenberg form of a graded matrix may have lost the gain itself.
            let gain = if self.gains.rounding(frequency) > PROBE_ROUNDING * rough {
                refined_gain(sys, frequency).map_or(rough, |refined| refined.gain)
            } else {
                rough
            };
            if gain > best.gain {
                best = Seen { gain, frequency };
            }
        }
        if best.gain <= level {
            return Ok(false);
        }
        let look = |f: f64| refined_gain(sys, f).map_or(0.0, |refined| refined.gain);
        let (old, old_error, old_rounding) = (self.best, self.error, self.rounding);
        self.best = climb(look, best, PROBE_STEP * best.frequency, Goal::Peak);
        self.refine()?;
        if self.best.gain > level {
            return Ok(true);
        }
        (self.best, self.error, self.rounding) = (old, old_error, old_rounding);
        Ok(false)
    }

    /// Climbs from the crossings of a level; whether a gain above the level was found.
    fn climb_above(&mut self, level: f64, crossings: &[Crossing]) -> Result<bool, Error> {
        let mut starts: Vec<(Seen, f64)> = Vec::new();
        let mut previous: Option<Seen> = None;
        for crossing in crossings {
            let frequency = crossing.frequency;
            let seen = Seen { gain: self.gains.gain(frequency), frequency };
            // The peak already known has its own pair of eigenvalues beside the axis.
            let explained = (frequency - self.best.frequency).abs() <= crossing.off_axis;
            if seen.gain >= NEAR_LEVEL * level && !(explained && seen.gain <= level) {
                starts.push((seen, crossing.off_axis.max(1e-6 * frequency)));
            }
            if let Some(left) = previous {
                let middle = 0.5 * (left.frequency + frequency);
                let inside = Seen { gain: self.gains.gain(middle), frequency: middle };
                if inside.gain > left.gain.max(seen.gain).min(level) {
                    starts.push((inside, 0.25 * (frequency - left.frequency)));
                }
            }
            previous = Some(seen);
        }
        starts.sort_by(|x, y| y.0.gain.total_cmp(&x.0.gain));
        let mut best = Seen { gain: level, frequency: 0.0 };
        for &(start, width) in starts.iter().take(CLIMBS_MAX) {
            let top = climb(|f| self.gains.gain(f), start, width, Goal::Peak);
            if top.gain > best.gain {
                best = top;
            }
        }
        if best.gain <= level {
            return Ok(false);
        }
        let (old, old_error, old_rounding) = (self.best, self.error, self.rounding);
        self.best = best;
        self.refine()?;
        if self.best.gain > level {
            return Ok(true);
        }
        // Higher by rounding only.
        (self.best, self.error, self.rounding) = (old, old_error, old_rounding);
        Ok(false)
    }
}

/// JSON has no infinity, so files say `null`.
mod infinity_as_null {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub(super) fn serialize<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
        value.is_finite().then_some(*value).serialize(serializer)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
        Ok(Option::<f64>::deserialize(deserializer)?.unwrap_or(f64::INFINITY))
    }
}

/// Relative distance of the level that is tested above the largest gain.
const MARGIN: f64 = 1e-10;
/// The largest such distance. Where rounding moves eigenvalues by more, the climbs decide.
const MARGIN_MAX: f64 = 1e-8;
/// The same distance in units of the rounding of the best gain, where that is more.
const ROUNDING_MARGIN: f64 = 10.0;
/// Levels tried; the first one is free of crossings unless a broad peak lies between the poles' frequencies.
const LEVELS_MAX: usize = 50;
/// Local climbs per round.
const CLIMBS_MAX: usize = 6;
/// A start with less than this share of the best gain is left to the level test: starts lie at the resonances themselves.
const WORTH_A_CLIMB: f64 = 0.7;
/// First step of a climb in units of the half width of a resonance.
const STEP: f64 = 0.5;
/// The same where a climb goes on from a place near the peak.
const STEP_ON: f64 = 0.1;
/// Share of the best gain that a rough climb has to reach: it may miss a thousandth of its peak.
const WORTH_GOING_ON: f64 = 0.99;
/// Relative rounding above which the gain is evaluated again in doubled precision.
const REFINE_ABOVE: f64 = 1e-13;
/// Relative rounding above which the climb is repeated as well: half the square of it is lost in the gain.
const CLIMB_AGAIN_ABOVE: f64 = 1e-7;
/// Relative width of a bracket that is none.
const LOST: f64 = 1e-3;
/// Decades between the slowest and the fastest pole from which on the level test is not trusted alone.
const GRADED_DECADES: f64 = 7.0;
/// Frequencies looked at in each decade then.
const PROBES_PER_DECADE: f64 = 10.0;
/// Relative rounding of the gain above which they are looked at in doubled precision.
const PROBE_ROUNDING: f64 = 1e-6;
/// First step of a climb from there, relative to the frequency.
const PROBE_STEP: f64 = 0.05;
/// A possible crossing with less than this share of the level is none.
const NEAR_LEVEL: f64 = 0.99;
/// Damping ratio, or distance from the unit circle, that cannot be told from none.
const BOUNDARY: f64 = 4.0 * f64::EPSILON;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Continuous, SampleTime, TransferFunction};
    use nalgebra::DMatrix;
    use rand::{RngExt, SeedableRng};

    fn tf(numerator: &[f64], denominator: &[f64]) -> StateSpace<Continuous> {
        TransferFunction::new(numerator, denominator).expect("proper").to_state_space()
    }

    #[test]
    fn paper_ws_norm_is_02426() {
        // Eq. (17); the peak of b / (s² + 2 zeta w0 s + w0²) is b / (2 zeta w0² sqrt(1 - zeta²)), at w0 sqrt(1 - 2 zeta²).
        let zeta: f64 = 45.0 / (2.0 * 50.0);
        let exact = 487.5 / (2.0 * zeta * 2500.0 * (1.0 - zeta * zeta).sqrt());
        let peak = hinf_norm(&tf(&[487.5], &[1.0, 45.0, 2500.0])).expect("stable");
        assert!((peak.value - exact).abs() < 1e-13 && (peak.value - 0.2426).abs() < 5e-5);
        assert!((peak.omega_rad_s - 50.0 * (1.0 - 2.0 * zeta * zeta).sqrt()).abs() < 1e-5);
        assert!(peak.upper >= exact && peak.upper <= exact * (1.0 + 2e-10));
    }

    #[test]
    fn regress_a_loop_of_24_decades_is_not_bounded_below_its_own_gain() {
        // The level test alone proved 1.00189, and the Hessenberg form shows no more.
        let file = include_str!("../../../../testdata/norms/graded_loop.json");
        let file: serde_json::Value = serde_json::from_str(file).expect("json");
        let matrix = |key: &str| {
            let rows: Vec<Vec<f64>> = serde_json::from_value(file[key].clone()).expect("rows");
            DMatrix::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j])
        };
        let sys = StateSpace::<Continuous>::new(matrix("A"), matrix("B"), matrix("C"), matrix("D"));
        let peak = hinf_norm(&sys.expect("shapes")).expect("stable");
        let gain = file["gain"].as_f64().expect("a number");
        assert!(peak.upper >= gain && (peak.value / gain - 1.0).abs() < 1e-9, "{peak:?}");
    }

    #[test]
    fn law_an_all_pass_is_flat() {
        let peak = hinf_norm(&tf(&[1.0, -1.0], &[1.0, 1.0])).expect("stable");
        assert!((peak.value - 1.0).abs() < 1e-12 && peak.upper < 1.0 + 1e-4, "{peak:?}");
    }

    #[test]
    fn law_a_sharp_resonance_is_found() {
        for zeta in [1e-2, 1e-4, 1e-6_f64] {
            let exact = 1.0 / (2.0 * zeta * (1.0 - zeta * zeta).sqrt());
            let peak = hinf_norm(&tf(&[1.0], &[1.0, 2.0 * zeta, 1.0])).expect("stable");
            assert!((peak.value / exact - 1.0).abs() < 1e-9, "{zeta}: {peak:?}");
        }
    }

    #[test]
    fn law_random_systems_are_never_below_a_dense_grid() {
        let seed = 31;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        for trial in 0..300 {
            let n = 1 + trial % 8;
            let mut matrix = |rows, cols| DMatrix::from_fn(rows, cols, |_, _| rng.random_range(-1.0..1.0));
            let mut a: DMatrix<f64> = matrix(n, n);
            let shift =
                crate::eigenvalues::eigenvalues(&a).expect("qr").iter().fold(f64::MIN, |m, p| m.max(p.re));
            a -= DMatrix::identity(n, n) * (shift + 0.01);
            let sys =
                StateSpace::<Continuous>::new(a, matrix(n, 2), matrix(3, n), matrix(3, 2)).expect("shapes");
            let peak = hinf_norm(&sys).unwrap_or_else(|e| panic!("seed {seed} trial {trial}: {e}"));
            assert!(peak.upper / peak.lower < 1.0 + 1e-6, "seed {seed} trial {trial}: {peak:?}");
            for k in 0..400 {
                let omega = 1e-3 * 10.0_f64.powf(6.0 * k as f64 / 399.0);
                let gain = sys.at(omega).expect("no pole on the axis").singular_values().max();
                assert!(gain <= peak.upper, "seed {seed} trial {trial}: {gain} at {omega} beats {peak:?}");
            }
        }
    }

    #[test]
    fn law_discrete_norm_of_a_first_order_low_pass() {
        // 1 / (z - 0.5) peaks at z = 1 with 2; 1 / (z + 0.5) peaks at the Nyquist frequency.
        let ts = SampleTime::new(0.1).expect("positive");
        let m = |v: f64| DMatrix::from_element(1, 1, v);
        for (a, omega) in [(0.5, 0.0), (-0.5, std::f64::consts::PI / 0.1)] {
            let sys = StateSpace::<crate::Discrete>::new(m(a), m(1.0), m(1.0), m(0.0), ts).expect("shapes");
            let peak = hinf_norm(&sys).expect("stable");
            assert!((peak.value - 2.0).abs() < 1e-9, "{peak:?}");
            assert!((peak.omega_rad_s - omega).abs() < 1e-3, "{peak:?}");
        }
    }

    #[test]
    fn edge_unstable_and_zero_systems() {
        assert!(matches!(hinf_norm(&tf(&[1.0], &[1.0, -1.0])), Err(Error::Unstable { .. })));
        assert!(matches!(hinf_norm(&tf(&[1.0], &[1.0, 0.0])), Err(Error::Unstable { .. })));
        let zero = hinf_norm(&tf(&[0.0], &[1.0, 1.0])).expect("stable");
        assert_eq!((zero.lower, zero.upper), (0.0, 0.0));
    }

    #[test]
    fn edge_infinite_frequency_survives_a_file() {
        let peak = PeakGain { value: 1.0, omega_rad_s: f64::INFINITY, lower: 1.0, upper: 1.0 };
        let text = serde_json::to_string(&peak).expect("serializable");
        assert_eq!(serde_json::from_str::<PeakGain>(&text).expect("readable"), peak);
    }
}
