//! Tuning by crossover frequency and phase margin.

use num_complex::Complex64;
use serde::{Deserialize, Serialize};

use super::loop_samples::{LoopSamples, filtered_derivative};
use super::{DelayedPlant, PidLoopCheck, check_pid_loop};
use crate::implement::PidSettings;
use crate::{Error, Result};

/// Terms of a controller tuned by margin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MarginTerms {
    /// Proportional.
    P,
    /// Integral.
    I,
    /// Proportional and integral.
    Pi,
    /// Proportional and derivative, filter at `filter_ratio` times the crossover.
    Pd,
    /// All three, filter at `filter_ratio` times the crossover.
    Pid,
    /// All three with the filter tuned: as slow as costs at most a tenth of the integral gain.
    Pidf,
}

/// What the freedom that the margin leaves is used for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DesignFocus {
    /// Both zeros of the controller at one place: `Ti = 4 Td`.
    #[default]
    Balanced,
    /// Least overshoot: among the controllers with a peak of T at most 2 % above the least one, the largest integral gain.
    Reference,
    /// Largest integral gain with a peak of S within `ms_max`.
    Disturbance,
}

/// What a loop tuned by margin should have.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MarginTarget {
    /// Frequency of loop gain one in rad/s; `None` to have it chosen.
    pub crossover_rad_s: Option<f64>,
    /// Phase margin in degrees: met at the crossover by controllers with two terms or more, and nowhere less.
    pub phase_margin_deg: f64,
    /// Derivative filter pole over crossover frequency; for [`MarginTerms::Pidf`] the largest one tried.
    pub filter_ratio: f64,
    /// Largest peak of `S` that a chosen crossover may cause. With a given one a guide for [`DesignFocus::Disturbance`] alone.
    pub ms_max: f64,
    /// What the freedom that is left is used for.
    pub focus: DesignFocus,
}

impl Default for MarginTarget {
    /// 60 degrees at a crossover that is chosen for a peak of S of at most 1.7; filter two decades above; balanced.
    fn default() -> Self {
        Self {
            crossover_rad_s: None,
            phase_margin_deg: 60.0,
            filter_ratio: 100.0,
            ms_max: 1.7,
            focus: DesignFocus::Balanced,
        }
    }
}

/// A controller tuned by margin.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MarginDesign {
    /// The controller.
    pub settings: PidSettings,
    /// The crossover that was asked for or chosen, in rad/s.
    pub crossover_rad_s: f64,
    /// Peaks and margins, proven. The phase margin here is the least of all crossings.
    pub check: PidLoopCheck,
}

/// Returns the controller whose loop has the given phase margin at the given crossover, or at the best one.
///
/// **Method**: `L(j wc) = e^{j (margin - 180 degrees)}` fixes two numbers, which are those of a PI or PD controller. A PID controller has
/// one more, which the design focus settles: the controllers through the point are a line in the gains, and 25 of them are
/// looked at on a frequency grid. P and I controllers cross where they are told, and must have the margin or more there.
/// A crossover that is not given is looked for over the range of the plant's corners, among the stable loops that keep the margin at every
/// crossing and the peak of S: largest integral gain, for [`DesignFocus::Reference`] and controllers without integral action the
/// fastest crossover. Then the loop is proven ([`check_pid_loop`]), and the next best taken if the grid saw too little.
///
/// **Accuracy**: the margin at the crossover is met to rounding; a chosen crossover is the best of a search, to 1 %.
///
/// # Errors
/// At a given crossover [`Error::PidPhaseOutOfReach`] where the controller cannot turn the phase that far,
/// [`Error::PidMarginNotMet`] where the loop crosses with a smaller margin (elsewhere, or with P and I there),
/// [`Error::PidLoopUnstable`] where the loop with that margin is not stable. Without one [`Error::PidNoCrossover`]. Also
/// [`Error::OutOfRange`], and [`Error::PidPlantZeroAtOrigin`] for integral action that cannot reach the output.
///
/// # Example
/// ```
/// use telepulse_design::synthesize::pid::{DelayedPlant, MarginTarget, MarginTerms, tune_phase_margin};
/// use telepulse_lti::TransferFunction;
/// let plant = DelayedPlant::new(TransferFunction::new(&[1.0], &[1.0, 3.0, 3.0, 1.0])?, 0.2)?;
/// let target = MarginTarget { crossover_rad_s: Some(1.0), ..MarginTarget::default() };
/// let design = tune_phase_margin(&plant, MarginTerms::Pid, &target)?;
/// assert!((design.check.phase_margin_deg.unwrap() - 60.0).abs() < 1e-6);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn tune_phase_margin(
    plant: &DelayedPlant,
    terms: MarginTerms,
    target: &MarginTarget,
) -> Result<MarginDesign> {
    check_target(target)?;
    let has_integral = !matches!(terms, MarginTerms::P | MarginTerms::Pd);
    let sign = match plant.integral_sign() {
        Err(_) if !has_integral => {
            (plant.rational().numerator()[0] * plant.rational().denominator()[0]).signum()
        }
        sign => sign?,
    };
    let search = Search { plant, samples: LoopSamples::new(plant)?, terms, target: *target, sign };
    match target.crossover_rad_s {
        Some(omega) => search.at_given(omega),
        None => search.choose(),
    }
}

struct Search<'a> {
    plant: &'a DelayedPlant,
    samples: LoopSamples<'a>,
    terms: MarginTerms,
    target: MarginTarget,
    sign: f64,
}

/// A stable loop through the point, as the grid shows it.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    settings: PidSettings,
    omega: f64,
    peak_s: f64,
    peak_t: f64,
    /// Whether its zeros coincide.
    is_double: bool,
}

impl Search<'_> {
    fn at_given(&self, omega: f64) -> Result<MarginDesign> {
        let lines = self.lines(omega)?;
        let mut last_error = None;
        for settings in self.ranked_at(omega, &lines, f64::INFINITY)? {
            match self.prove(settings, omega) {
                Ok(design) => return Ok(design),
                Err(error) if is_refusal(&error) => {
                    last_error.get_or_insert(error);
                }
                Err(error) => return Err(error),
            }
        }
        if let Some(error) = last_error {
            return Err(error);
        }
        // None looked stable with the margin kept: say what is wrong with the first.
        match lines.first().and_then(|line| line.first()) {
            Some((settings, _)) => self.prove(*settings, omega),
            None => Err(self.no_crossover()),
        }
    }

    fn choose(&self) -> Result<MarginDesign> {
        let [bottom, top] = self.samples.ends();
        let n = (PER_DECADE * (top / bottom).log10()).ceil().clamp(1.0, CROSSOVERS_MAX) as usize;
        let ratio = (top / bottom).powf(1.0 / n as f64);
        let mut found = Vec::new();
        for k in 0..=n {
            found.extend(self.best_at(bottom * ratio.powi(k as i32))?);
        }
        found.sort_by(|a, b| self.value(b).total_cmp(&self.value(a)));
        if let Some(best) = found.first().copied() {
            let climbed = self.climb(best, ratio)?;
            found.insert(0, climbed);
        }
        for candidate in found.iter().take(PROOFS_MAX) {
            match self.prove(candidate.settings, candidate.omega) {
                Ok(design) if design.check.peak_s.upper <= self.target.ms_max => return Ok(design),
                Ok(_) => {}
                Err(error) if is_refusal(&error) => {}
                Err(error) => return Err(error),
            }
        }
        Err(self.no_crossover())
    }

    fn no_crossover(&self) -> Error {
        let [bottom_rad_s, top_rad_s] = self.samples.ends();
        let MarginTarget { phase_margin_deg, ms_max, .. } = self.target;
        Error::PidNoCrossover { bottom_rad_s, top_rad_s, phase_margin_deg, ms_max }
    }

    /// What makes one crossover better than another.
    fn value(&self, candidate: &Candidate) -> f64 {
        let by_speed = self.target.focus == DesignFocus::Reference
            || matches!(self.terms, MarginTerms::P | MarginTerms::Pd);
        if by_speed { candidate.omega } else { self.sign * candidate.settings.i_per_s }
    }

    /// The best controller at a crossover within the peak of S; none where there is none.
    fn best_at(&self, omega: f64) -> Result<Option<Candidate>> {
        let lines = match self.lines(omega) {
            Err(Error::PidPhaseOutOfReach { .. } | Error::PidMarginNotMet { .. }) => return Ok(None),
            lines => lines?,
        };
        // A little inside, since the grid sees a little less than the peak.
        let settings = self.ranked_at(omega, &lines, self.target.ms_max * (1.0 - 1e-4))?.into_iter().next();
        Ok(settings.map(|settings| {
            let glimpse = self.samples.glimpse(&settings);
            Candidate { settings, omega, peak_s: glimpse.peak_s, peak_t: glimpse.peak_t, is_double: false }
        }))
    }

    /// Moves the crossover as long as that improves it, by ever smaller steps.
    fn climb(&self, mut best: Candidate, ratio: f64) -> Result<Candidate> {
        let mut step = ratio.sqrt();
        for _ in 0..CLIMBS {
            let mut moved = false;
            for omega in [best.omega * step, best.omega / step] {
                if let Some(other) =
                    self.best_at(omega)?.filter(|other| self.value(other) > self.value(&best))
                {
                    best = other;
                    moved = true;
                    break;
                }
            }
            if !moved {
                step = step.sqrt();
            }
        }
        Ok(best)
    }

    fn prove(&self, settings: PidSettings, omega: f64) -> Result<MarginDesign> {
        let check = check_pid_loop(self.plant, &settings, None)?;
        let wanted_deg = self.target.phase_margin_deg;
        if let (Some(found), Some(omega_rad_s)) = (check.phase_margin_deg, check.crossover_rad_s)
            && found.abs() < wanted_deg - MARGIN_DEG
        {
            return Err(Error::PidMarginNotMet { wanted_deg, found_deg: found, omega_rad_s });
        }
        Ok(MarginDesign { settings, crossover_rad_s: omega, check })
    }

    /// Stable controllers of all filters that keep the margin, best first.
    fn ranked_at(
        &self,
        omega: f64,
        lines: &[Vec<(PidSettings, bool)>],
        ms_max: f64,
    ) -> Result<Vec<PidSettings>> {
        let mut ranked: Vec<Vec<PidSettings>> = Vec::new();
        for line in lines {
            let mut candidates = Vec::new();
            for (settings, is_double) in line {
                let glimpse = self.samples.glimpse(settings);
                let kept = glimpse.peak_s <= ms_max
                    && glimpse.phase_margin_deg >= self.target.phase_margin_deg - GLIMPSE_DEG;
                if kept && self.samples.is_stable(settings)? {
                    candidates.push(Candidate {
                        settings: *settings,
                        omega,
                        peak_s: glimpse.peak_s,
                        peak_t: glimpse.peak_t,
                        is_double: *is_double,
                    });
                }
            }
            ranked.push(self.rank(candidates));
        }
        // Lines go from the fastest filter to the slowest; the last whose best is nearly as good comes first.
        let integral =
            |list: &Vec<PidSettings>| list.first().map_or(f64::NEG_INFINITY, |s| self.sign * s.i_per_s);
        let most = ranked.iter().map(integral).fold(f64::NEG_INFINITY, f64::max);
        ranked.reverse();
        ranked.sort_by_key(|list| integral(list) < KEPT_INTEGRAL * most);
        Ok(ranked.into_iter().flatten().collect())
    }

    /// Best first, by the design focus.
    fn rank(&self, mut candidates: Vec<Candidate>) -> Vec<PidSettings> {
        candidates
            .sort_by(|a, b| (self.sign * b.settings.i_per_s).total_cmp(&(self.sign * a.settings.i_per_s)));
        let least = |of: fn(&Candidate) -> f64| candidates.iter().map(of).fold(f64::INFINITY, f64::min);
        let (peak_s, peak_t) = (least(|c| c.peak_s), least(|c| c.peak_t).max(1.0));
        let first = |c: &Candidate| match self.target.focus {
            DesignFocus::Balanced => c.is_double,
            DesignFocus::Reference => c.peak_t <= 1.02 * peak_t,
            DesignFocus::Disturbance => c.peak_s <= self.target.ms_max.max(1.02 * peak_s),
        };
        // Stable: within each half the largest integral gain stays first.
        candidates.sort_by_key(|c| !first(c));
        candidates.into_iter().map(|c| c.settings).collect()
    }

    /// Controllers through the point, one list per filter; whether the zeros coincide.
    fn lines(&self, omega: f64) -> Result<Vec<Vec<(PidSettings, bool)>>> {
        let g = self.plant.at(omega);
        let MarginTarget { phase_margin_deg: margin, filter_ratio, .. } = self.target;
        // The controller's response with the sign of its gains taken out.
        let wanted = Complex64::from_polar(1.0, (margin - 180.0).to_radians()) / g * self.sign;
        let needed_deg = wanted.arg().to_degrees();
        let none = PidSettings { p: 0.0, i_per_s: 0.0, d_s: 0.0, n_rad_s: 0.0 };
        let reach = |min_deg: f64, max_deg: f64| {
            let within = wanted.norm().is_finite()
                && wanted.norm() > 0.0
                && needed_deg > min_deg
                && needed_deg < max_deg;
            let error = Error::PidPhaseOutOfReach { omega_rad_s: omega, needed_deg, min_deg, max_deg };
            if within { Ok(()) } else { Err(error) }
        };
        let fixed = |phase_deg: f64, settings: PidSettings| {
            // The controller's phase is what it is, and may only be above what is needed.
            let spare_deg = phase_deg - needed_deg;
            let found_deg = margin + spare_deg;
            if spare_deg >= -MARGIN_DEG && found_deg < 180.0 && wanted.norm().is_finite() {
                return Ok(vec![vec![(settings, true)]]);
            }
            Err(Error::PidMarginNotMet { wanted_deg: margin, found_deg, omega_rad_s: omega })
        };
        let lead_deg = |ratio: f64| 90.0 - (1.0 / ratio).atan().to_degrees();
        let size = self.sign * wanted.norm();
        match self.terms {
            MarginTerms::P => fixed(0.0, PidSettings { p: size, ..none }),
            MarginTerms::I => fixed(-90.0, PidSettings { i_per_s: size * omega, ..none }),
            MarginTerms::Pi => {
                reach(-90.0, 0.0)?;
                let (p, i_per_s) = (self.sign * wanted.re, -self.sign * wanted.im * omega);
                Ok(vec![vec![(PidSettings { p, i_per_s, ..none }, true)]])
            }
            MarginTerms::Pd => {
                reach(0.0, lead_deg(filter_ratio))?;
                let n_rad_s = filter_ratio * omega;
                let unit = filtered_derivative(omega, n_rad_s);
                let d = wanted.im / unit.im;
                let (p, d_s) = (self.sign * (wanted.re - d * unit.re), self.sign * d);
                Ok(vec![vec![(PidSettings { p, i_per_s: 0.0, d_s, n_rad_s }, true)]])
            }
            MarginTerms::Pid => {
                reach(-90.0, lead_deg(filter_ratio))?;
                Ok(vec![self.line(wanted, omega, filter_ratio)])
            }
            MarginTerms::Pidf => {
                reach(-90.0, lead_deg(filter_ratio))?;
                let ratios =
                    FILTER_RATIOS.into_iter().filter(|r| *r < filter_ratio && needed_deg < lead_deg(*r));
                Ok(std::iter::once(filter_ratio).chain(ratios).map(|r| self.line(wanted, omega, r)).collect())
            }
        }
    }

    /// PID controllers with this response at `omega`: `P = Re - D Re(f)` and `I = omega (D Im(f) - Im)`, for D between the values
    /// that leave no integral and no proportional action.
    fn line(&self, wanted: Complex64, omega: f64, ratio: f64) -> Vec<(PidSettings, bool)> {
        let n_rad_s = ratio * omega;
        let unit = filtered_derivative(omega, n_rad_s);
        let (low, high) = ((wanted.im / unit.im).max(0.0), wanted.re / unit.re);
        let at = |d: f64| PidSettings {
            p: self.sign * (wanted.re - d * unit.re),
            i_per_s: self.sign * omega * (d * unit.im - wanted.im),
            d_s: self.sign * d,
            n_rad_s,
        };
        // (1 + j wc t)^2/(j wc (1 + j wc/N)) has the phase 2 atan(wc t) - 90 degrees - atan(wc/N).
        let turn = wanted.arg() + std::f64::consts::FRAC_PI_2 + (1.0 / ratio).atan();
        let t = (0.5 * turn).tan() / omega;
        let k = wanted.norm() * omega * (1.0 + ratio.powi(-2)).sqrt() / (1.0 + (omega * t).powi(2));
        let double = k * t * t - (2.0 * t * k - k / n_rad_s) / n_rad_s;
        let mut line = Vec::with_capacity(LINE + 1);
        if double > low && double < high {
            line.push((at(double), true));
        }
        for step in 1..=LINE {
            let share = (step as f64 / (LINE + 1) as f64).powi(2);
            line.push((at(low + share * (high - low)), false));
        }
        line
    }
}

/// Errors that another controller may not have.
fn is_refusal(error: &Error) -> bool {
    matches!(
        error,
        Error::PidLoopUnstable { .. }
            | Error::PidLoopNeutral { .. }
            | Error::PidStabilityUncertain { .. }
            | Error::PidMarginNotMet { .. }
            // A direct term next to -1: the closed loop would be all high frequency.
            | Error::System(telepulse_lti::Error::AlgebraicLoop { .. })
    )
}

fn check_target(target: &MarginTarget) -> Result<()> {
    let inside = |key, found: f64, low: f64, high: f64, allowed| {
        if found > low && found < high { Ok(()) } else { Err(Error::OutOfRange { key, found, allowed }) }
    };
    inside("phase_margin_deg", target.phase_margin_deg, 0.0, 180.0, "between 0 and 180")?;
    inside("filter_ratio", target.filter_ratio, 1.0, f64::INFINITY, "finite and above 1")?;
    inside("ms_max", target.ms_max, 1.0, f64::INFINITY, "finite and above 1")?;
    match target.crossover_rad_s {
        Some(omega) => inside("crossover_rad_s", omega, 0.0, f64::INFINITY, "finite and above 0"),
        None => Ok(()),
    }
}

/// Controllers on the line through the point.
const LINE: usize = 24;
/// Filter poles over crossover that are tried, besides the one given, fastest first.
const FILTER_RATIOS: [f64; 6] = [50.0, 30.0, 20.0, 10.0, 5.0, 3.0];
/// Share of the integral gain that a slower filter must leave.
const KEPT_INTEGRAL: f64 = 0.9;
/// Margins that are equal but for rounding.
const MARGIN_DEG: f64 = 1e-6;
/// Error of a phase margin between the points of the grid.
const GLIMPSE_DEG: f64 = 0.5;
const PER_DECADE: f64 = 20.0;
const CROSSOVERS_MAX: f64 = 300.0;
/// Steps of the climb: each moves, or takes the root of the step.
const CLIMBS: usize = 16;
/// Loops that are proven before the search gives up.
const PROOFS_MAX: usize = 50;

#[cfg(test)]
#[path = "phase_margin_tests.rs"]
mod tests;
