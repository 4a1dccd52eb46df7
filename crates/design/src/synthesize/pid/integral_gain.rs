//! The PID controller with the largest integral gain under limits on the peaks of the closed loop.

use serde::{Deserialize, Serialize};
use telepulse_lti::{PeakGain, TransferFunction};

use super::convex_step::{Aim, Gains, Samples, frequency_grid};
use super::starts::{Start, stabilizes, starts};
use super::{DelayedPlant, PidLoopCheck, check_pid_loop};
use crate::implement::PidSettings;
use crate::{Error, Result};

/// Which terms a controller has.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum PidStructure {
    /// `P + I/s`.
    Pi,
    /// `P + I/s + D N s/(s + N)`, with the pole N of the derivative filter given.
    Pid {
        /// Pole N of the derivative filter in rad/s.
        n_rad_s: f64,
    },
}

/// Limits that the closed loop keeps.
#[derive(Debug, Clone, PartialEq)]
pub struct PidLimits {
    /// Largest peak of the sensitivity `S`; above 1.
    pub ms_max: f64,
    /// Largest peak of the complementary sensitivity `T`; above 1.
    pub mt_max: f64,
    /// Largest peak of `C S` from noise to command, unit of command per unit of output.
    pub ks_max: Option<f64>,
    /// Weight for `max |W_s C S| < 1`: stability for every additive error of the plant under `W_s`.
    pub ws: Option<TransferFunction>,
}

impl Default for PidLimits {
    /// Both peaks at most 1.4, the usual choice for a well-damped loop; no other limit.
    fn default() -> Self {
        Self { ms_max: 1.4, mt_max: 1.4, ks_max: None, ws: None }
    }
}

/// One of the limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PidLimit {
    /// Peak of `S`.
    Sensitivity,
    /// Peak of `T`.
    ComplementarySensitivity,
    /// Peak of `C S`.
    Noise,
    /// Peak of `W_s C S`.
    Robustness,
}

/// A controller and what its loop was found to be worth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PidDesign {
    /// The controller.
    pub settings: PidSettings,
    /// Peaks and margins, proven.
    pub check: PidLoopCheck,
    /// Limits that hold the integral gain back: their peaks are within 0.1 % of them.
    pub binding: Vec<PidLimit>,
    /// Convex programs solved.
    pub n_programs: usize,
}

/// Returns the controller with the largest integral gain that keeps every limit.
///
/// Under a load step at the plant's input a loop with integral gain `I` has the integrated error `1/I`, so the largest one rejects
/// disturbances best, and the limits keep the loop robust.
///
/// **Method**: convex-concave procedure from several stabilising starts, steps lengthened while limits and stability hold;
/// then the peaks are computed for all frequencies ([`check_pid_loop`]), frequencies where one is above its limit are added, and
/// the search goes on until every upper end of a bracket is within its limit. What violates a limit is never returned.
///
/// **Source**: Åström, Panagopoulos and Hägglund 1998 (the problem); Hast, Åström, Bernhardsson and Boyd 2013 (the procedure).
///
/// **Accuracy**: limits are met with about 1e-4 to spare. The problem is not convex: the result is a local optimum, the best
/// of several starts.
///
/// # Errors
/// [`Error::PidNotStabilized`] where no stabilising controller was found, [`Error::PidLimitsNotMet`] where stabilising ones
/// exist and none was found that keeps the limits, [`Error::PidLimitImpossible`] where none can exist,
/// [`Error::PidGainUnbounded`] where the limits do not bound the gain, [`Error::PidPlantZeroAtOrigin`], [`Error::OutOfRange`].
///
/// # Example
/// ```
/// use telepulse_design::synthesize::pid::{DelayedPlant, PidLimits, PidStructure, maximize_integral_gain};
/// use telepulse_lti::TransferFunction;
/// let plant = DelayedPlant::new(TransferFunction::new(&[1.0], &[1.0, 3.0, 3.0, 1.0])?, 0.0)?;
/// let limits = PidLimits { ms_max: 2.0, mt_max: 2.0, ..PidLimits::default() };
/// let design = maximize_integral_gain(&plant, PidStructure::Pi, &limits)?;
/// assert!(design.check.peak_s.upper <= 2.0);
/// // Åström, Panagopoulos and Hägglund 1998: k = 1.22, ki = 0.685.
/// assert!((design.settings.i_per_s - 0.685).abs() < 2e-3);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn maximize_integral_gain(
    plant: &DelayedPlant,
    structure: PidStructure,
    limits: &PidLimits,
) -> Result<PidDesign> {
    let n_rad_s = check_options(structure, limits)?;
    check_at_rest(plant, limits)?;
    let mut search = Search::new(plant, n_rad_s, limits)?;
    let mut found = starts(plant, &search.samples)?;
    if found.is_empty() {
        return Err(Error::PidNotStabilized { n_unstable_plant: n_unstable(plant)? });
    }
    let sign = search.samples.sign;
    // Feasible starts by integral gain; where there is none, the least violation is worked down first.
    found.sort_by(|a, b| (sign * b.gains[1]).total_cmp(&(sign * a.gains[1])));
    let mut feasible: Vec<Start> = Vec::new();
    for start in found.iter().filter(|s| s.violation < 1.0) {
        if feasible.len() < STARTS
            && feasible.iter().all(|other| search.samples.far_apart(start.gains, other.gains))
        {
            feasible.push(*start);
        }
    }
    if feasible.is_empty() {
        found.sort_by(|a, b| a.violation.total_cmp(&b.violation));
        for start in found.iter().take(STARTS) {
            feasible.extend(search.make_feasible(*start)?);
        }
    }
    let mut best: Option<Gains> = None;
    for start in &feasible {
        let gains = search.climb(start.gains)?;
        if best.is_none_or(|b| sign * gains[1] > sign * b[1]) {
            best = Some(gains);
        }
    }
    match best {
        Some(gains) => {
            let gains = search.poke(gains)?;
            search.certify(gains)
        }
        None => {
            let violation = found.iter().fold(f64::INFINITY, |m, s| m.min(s.violation));
            Err(Error::PidLimitsNotMet { violation })
        }
    }
}

struct Search<'a> {
    plant: &'a DelayedPlant,
    limits: &'a PidLimits,
    samples: Samples,
    /// What the search multiplies the noise limit's weight and `W_s` by, so that the true limits hold.
    noise_factor: f64,
    ws_factor: f64,
    n_programs: usize,
}

impl<'a> Search<'a> {
    fn new(plant: &'a DelayedPlant, n_rad_s: f64, limits: &'a PidLimits) -> Result<Self> {
        let others = match &limits.ws {
            Some(ws) => ws
                .poles()?
                .into_iter()
                .chain(if ws.numerator() == [0.0] { vec![] } else { ws.zeros()? })
                .collect(),
            None => Vec::new(),
        };
        if let Some(pole) = limits
            .ws
            .as_ref()
            .map(TransferFunction::poles)
            .transpose()?
            .iter()
            .flatten()
            .find(|p| p.re >= 0.0)
        {
            return Err(Error::UnstableElement { system: "weight Ws", pole: *pole });
        }
        let sign = plant.integral_sign()?;
        let samples = Samples {
            rows: Vec::new(),
            n_rad_s,
            sign,
            ms_max: limits.ms_max * MARGIN,
            mt_max: limits.mt_max * MARGIN,
        };
        let mut search = Self {
            plant,
            limits,
            samples,
            noise_factor: 1.0 / MARGIN,
            ws_factor: 1.0 / MARGIN,
            n_programs: 0,
        };
        for omega in frequency_grid(plant, n_rad_s, &others)? {
            search.add_frequency(omega);
        }
        Ok(search)
    }

    fn add_frequency(&mut self, omega: f64) {
        let ws = self.limits.ws.as_ref().map_or(0.0, |ws| ws.at(omega).norm() * self.ws_factor);
        let noise = self.limits.ks_max.map_or(0.0, |max| self.noise_factor / max);
        if let Some(sample) = self.samples.sample(self.plant, omega, ws.max(noise)) {
            let place = self.samples.rows.partition_point(|row| row.omega < omega);
            self.samples.rows.insert(place, sample);
        }
    }

    fn step(&mut self, gains: Gains, aim: Aim) -> Option<Gains> {
        self.n_programs += 1;
        self.samples.step(gains, aim)
    }

    /// Works the violation of a stabilising start down below one.
    fn make_feasible(&mut self, start: Start) -> Result<Option<Start>> {
        let mut now = start;
        for _ in 0..FEASIBILITY_STEPS {
            if now.violation < 1.0 {
                return Ok(Some(now));
            }
            let Some(gains) = self.step(now.gains, Aim::Feasibility) else { return Ok(None) };
            let violation = self.samples.violation(gains);
            if violation > now.violation * (1.0 - 1e-4) || !stabilizes(self.plant, &self.samples, gains)? {
                return Ok(None);
            }
            now = Start { gains, violation };
        }
        Ok(None)
    }

    /// Repeats the convex step until the integral gain grows no more.
    fn climb(&mut self, start: Gains) -> Result<Gains> {
        let mut now = start;
        for _ in 0..STEPS_MAX {
            let Some(mut next) = self.step(now, Aim::IntegralGain) else { break };
            if !stabilizes(self.plant, &self.samples, next)? {
                break;
            }
            let direction = [next[0] - now[0], next[1] - now[1], next[2] - now[2]];
            let mut length = 1.0;
            for _ in 0..EXTENSIONS_MAX {
                let further = [0, 1, 2].map(|k| next[k] + length * direction[k]);
                let gains_more = self.samples.sign * direction[1] > 0.0;
                if !gains_more
                    || self.samples.violation(further) > 1.0
                    || !stabilizes(self.plant, &self.samples, further)?
                {
                    break;
                }
                next = further;
                length *= 2.0;
            }
            if self.samples.gain_at_top(next) > GAIN_AT_TOP_MAX {
                return Err(Error::PidGainUnbounded { i_per_s: next[1] });
            }
            let grown = (next[1] / now[1]).abs();
            now = next;
            if grown < 1.0 + GROWTH_MIN {
                break;
            }
        }
        Ok(now)
    }

    /// Climbs again from places beside an optimum, since the limits have kinks on which a climb may stop early.
    fn poke(&mut self, best: Gains) -> Result<Gains> {
        let mut best = best;
        let scale = self.samples.scale(best);
        let n_gains = if self.samples.n_rad_s > 0.0 { 3 } else { 1 };
        for axis in (0..n_gains).filter(|k| *k != 1) {
            for step in [-0.4, 0.4] {
                let mut start = best;
                start[axis] += step * scale[axis];
                // Weaker integral action until the limits hold.
                for _ in 0..POKE_HALVINGS {
                    if self.samples.violation(start) < 1.0 && stabilizes(self.plant, &self.samples, start)? {
                        let found = self.climb(start)?;
                        if self.samples.sign * found[1] > self.samples.sign * best[1] {
                            best = found;
                        }
                        break;
                    }
                    start[1] *= 0.7;
                }
            }
        }
        Ok(best)
    }

    /// Adds frequencies until the proven peaks keep the limits.
    fn certify(&mut self, mut gains: Gains) -> Result<PidDesign> {
        let mut last_violation = f64::INFINITY;
        for round in 0..ROUNDS_MAX {
            let check = check_pid_loop(self.plant, &self.samples.settings(gains), self.limits.ws.as_ref())?;
            let peaks = self.peaks(&check);
            let worst = peaks.iter().fold(0.0, |m: f64, p| m.max(p.ratio));
            // `max |Ws C S| < 1` is strict, and the margin inside makes it so.
            if worst < 1.0 {
                let binding = peaks.iter().filter(|p| p.ratio > BINDING).map(|p| p.limit).collect();
                let settings = self.samples.settings(gains);
                return Ok(PidDesign { settings, check, binding, n_programs: self.n_programs });
            }
            last_violation = worst;
            for peak in peaks.iter().filter(|p| p.ratio >= 1.0 && p.omega.is_finite() && p.omega > 0.0) {
                for factor in [1.0, 0.997, 1.003] {
                    self.add_frequency(peak.omega * factor);
                }
            }
            if round >= ROUNDS_EXACT {
                self.tighten(&peaks);
            }
            gains = self.climb(self.pulled_back(gains))?;
        }
        Err(Error::PidLimitsNotMet { violation: last_violation })
    }

    /// Lowers the limits of the search by what the proven peaks are above the true ones: a peak at infinite frequency, or a round
    /// that moves a peak as fast as frequencies are added.
    fn tighten(&mut self, peaks: &[Peak]) {
        for peak in peaks.iter().filter(|p| p.ratio >= 1.0) {
            let by = peak.ratio * (1.0 + 1e-7);
            match peak.limit {
                PidLimit::Sensitivity => self.samples.ms_max /= by,
                PidLimit::ComplementarySensitivity => self.samples.mt_max /= by,
                PidLimit::Noise => self.noise_factor *= by,
                PidLimit::Robustness => self.ws_factor *= by,
            }
        }
        let omegas: Vec<f64> = self.samples.rows.drain(..).map(|row| row.omega).collect();
        omegas.into_iter().for_each(|omega| self.add_frequency(omega));
    }

    /// The gains, or weaker ones in the same proportion where the linearisation at them would be empty.
    fn pulled_back(&self, gains: Gains) -> Gains {
        let mut now = gains;
        for _ in 0..40 {
            if self.samples.violation(now) <= 1.0 {
                return now;
            }
            now[1] *= 0.999;
        }
        gains
    }

    fn peaks(&self, check: &PidLoopCheck) -> Vec<Peak> {
        let of = |limit, peak: PeakGain, allowed: f64| Peak {
            limit,
            ratio: peak.upper / allowed,
            omega: peak.omega_rad_s,
        };
        let mut peaks = vec![
            of(PidLimit::Sensitivity, check.peak_s, self.limits.ms_max),
            of(PidLimit::ComplementarySensitivity, check.peak_t, self.limits.mt_max),
        ];
        peaks.extend(self.limits.ks_max.map(|max| of(PidLimit::Noise, check.peak_ks, max)));
        peaks.extend(check.peak_ws_ks.map(|peak| of(PidLimit::Robustness, peak, 1.0)));
        peaks
    }
}

struct Peak {
    limit: PidLimit,
    ratio: f64,
    omega: f64,
}

fn check_options(structure: PidStructure, limits: &PidLimits) -> Result<f64> {
    let above = |key, found: f64, least: f64, allowed| {
        if found.is_finite() && found > least {
            Ok(())
        } else {
            Err(Error::OutOfRange { key, found, allowed })
        }
    };
    above("ms_max", limits.ms_max, 1.0, "finite and above 1")?;
    above("mt_max", limits.mt_max, 1.0, "finite and above 1")?;
    if let Some(ks_max) = limits.ks_max {
        above("ks_max", ks_max, 0.0, "finite and above 0")?;
    }
    match structure {
        PidStructure::Pi => Ok(0.0),
        PidStructure::Pid { n_rad_s } => {
            above("n_rad_s", n_rad_s, 0.0, "finite and above 0")?;
            Ok(n_rad_s)
        }
    }
}

/// With integral action `C S` is the inverse of the plant at rest, whatever the controller.
fn check_at_rest(plant: &DelayedPlant, limits: &PidLimits) -> Result<()> {
    let inverse = 1.0 / plant.rational().at(0.0).norm();
    if let Some(ks_max) = limits.ks_max.filter(|max| inverse >= *max) {
        return Err(Error::PidLimitImpossible { limit: PidLimit::Noise, at_rest: inverse, allowed: ks_max });
    }
    if let Some(ws) = &limits.ws {
        let at_rest = ws.at(0.0).norm() * inverse;
        if at_rest >= 1.0 {
            return Err(Error::PidLimitImpossible { limit: PidLimit::Robustness, at_rest, allowed: 1.0 });
        }
    }
    Ok(())
}

fn n_unstable(plant: &DelayedPlant) -> Result<usize> {
    Ok(plant.rational().poles()?.iter().filter(|p| p.re >= 0.0).count())
}

/// The search keeps this much away from the limits, so that brackets of width 1e-5 fit below them.
const MARGIN: f64 = 1.0 - 3e-5;
/// Starts that are followed.
const STARTS: usize = 4;
/// Weakenings of the integral action before a place beside an optimum is given up.
const POKE_HALVINGS: usize = 8;
const STEPS_MAX: usize = 80;
const FEASIBILITY_STEPS: usize = 60;
/// Doublings of a step.
const EXTENSIONS_MAX: usize = 6;
/// Growth of the integral gain in one step that is worth another.
const GROWTH_MIN: f64 = 2e-6;
/// Loop gain at the top of the grid above which the crossover has left the range of the plant's corners.
const GAIN_AT_TOP_MAX: f64 = 0.5;
const ROUNDS_MAX: usize = 20;
/// Rounds that only add frequencies.
const ROUNDS_EXACT: usize = 2;
/// Ratio of a peak to its limit from which it counts as binding.
const BINDING: f64 = 0.999;
