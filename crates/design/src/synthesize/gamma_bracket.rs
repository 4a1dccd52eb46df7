//! The smallest gamma that some controller reaches, between two values.

use telepulse_lti::GeneralizedPlant;

use super::assumptions::{self, Strictness};
use super::central_controller::{Condition, Feasible, Test, Violation, test};
use super::hinfsyn::HinfOptions;
use super::normalized_plant::NormalizedPlant;
use super::pointwise_bound::pointwise_bound;
use crate::Error;

/// The smallest reachable gamma between two values.
pub(super) struct GammaBracket {
    /// No controller reaches this: a condition was seen to fail here, or is known to by what was seen elsewhere.
    pub(super) lower: f64,
    /// Every condition was seen to hold here.
    pub(super) upper: f64,
    /// The condition that sets `lower`.
    pub(super) binding: Option<Condition>,
    /// Tests spent.
    pub(super) n_tests: usize,
}

impl GammaBracket {
    /// Returns a bracket of relative width `gamma_tolerance`.
    ///
    /// **Method**: each test moves one end to the gamma tested and, where it can, the other end or the next guess too:
    /// a Hamiltonian with eigenvalues on the axis tells at which frequencies no controller does better, and the gain there
    /// is a lower end that converges quadratically; `rho(X Y)` at a feasible gamma is one because the radius only grows
    /// below it. Otherwise the measure of the binding condition is followed by regula falsi (Illinois rule) in
    /// `1 / gamma²`, in which it is smooth. Bisection of the logarithm takes over where neither makes progress.
    ///
    /// **Source**: Boyd and Balakrishnan 1990 for the frequencies, Scherer 1990 and Gahinet 1992 for the coupling.
    ///
    /// **Errors**: [`Error::Infeasible`], [`Error::IllConditioned`] where not even a gamma without limit passes,
    /// [`Error::NotConverged`], those of the assumptions and of the Schur form.
    pub(super) fn find(
        plant: &GeneralizedPlant,
        normalized: &NormalizedPlant,
        options: &HinfOptions,
    ) -> Result<Self, Error> {
        let mut search = Search::new(plant, normalized, options);
        // Up until something is feasible.
        let mut gamma = search.first_gamma();
        let mut factor = GROWTH_FIRST;
        let mut n_steps = 0;
        while search.bracket.upper.is_infinite() {
            search.try_gamma(gamma.min(options.gamma_max))?;
            if search.bracket.upper.is_infinite() && gamma >= options.gamma_max {
                assumptions::check(normalized, Strictness::Likely)?;
                // Without a limit on gamma every plant that meets the assumptions has a solution: that it is not found is rounding.
                if matches!(test(normalized, UNLIMITED)?, Test::Violated(_)) {
                    return Err(Error::IllConditioned { gamma: options.gamma_max, achieved: f64::INFINITY });
                }
                let binding = search.bracket.binding;
                return Err(Error::Infeasible { gamma_max: options.gamma_max, binding });
            }
            if n_steps == STEPS_MAX {
                return Err(Error::NotConverged {
                    gamma_lower: search.bracket.lower,
                    gamma_upper: f64::INFINITY,
                });
            }
            n_steps += 1;
            gamma = if search.at_peak {
                search.just_above()
            } else {
                let higher = factor * gamma;
                factor = (factor * factor).min(FACTOR_MAX);
                // Once: a radius that has no meaning must not keep the search where it is.
                search.radius_hint.take().map_or(higher, |hint| hint.min(higher))
            };
        }
        // Down by factors, where no lower end is known yet.
        let smallest = search.bracket.upper * SMALLEST_RELATIVE;
        while search.bracket.lower == 0.0 && search.bracket.upper > smallest {
            search.try_gamma(search.bracket.upper / GROWTH)?;
        }
        if search.bracket.lower == 0.0 {
            return Ok(search.bracket);
        }
        for _ in 0..STEPS_MAX {
            if search.bracket.upper <= search.bracket.lower * (1.0 + options.gamma_tolerance) {
                search.widen_to_rounding();
                return Ok(search.bracket);
            }
            search.try_gamma(search.next_gamma())?;
        }
        let GammaBracket { lower, upper, .. } = search.bracket;
        Err(Error::NotConverged { gamma_lower: lower, gamma_upper: upper })
    }
}

struct Search<'a> {
    plant: &'a GeneralizedPlant,
    normalized: &'a NormalizedPlant,
    tolerance: f64,
    bracket: GammaBracket,
    failed: Option<Failed>,
    /// The measure of the coupling where it was seen, as pairs with `1 / gamma²`.
    couplings: Vec<(f64, f64)>,
    /// At the upper end, for whatever condition to ask.
    feasible: Option<Box<Feasible>>,
    /// Which end moved last, and how often without the other one.
    n_lower_moves: u32,
    n_upper_moves: u32,
    /// A gamma that the first failure of the coupling shows to be feasible: the one that equals the radius there.
    radius_hint: Option<f64>,
    n_hints: u32,
    /// Set where the last test left the lower end at the gain of a peak over frequency.
    at_peak: bool,
    n_peaks: u32,
}

/// The highest gamma that was tested and failed.
#[derive(Clone, Copy, Debug)]
struct Failed {
    gamma: f64,
    /// How far beyond the limit of the binding condition it is.
    margin: Option<f64>,
    /// How far beyond the limit of the coupling condition, followed through infinity.
    coupling: Option<f64>,
}

impl<'a> Search<'a> {
    fn new(plant: &'a GeneralizedPlant, normalized: &'a NormalizedPlant, options: &HinfOptions) -> Self {
        let lower = normalized.parrott_bound();
        let binding = (lower > 0.0).then_some(Condition::DirectTerm);
        Self {
            plant,
            normalized,
            tolerance: options.gamma_tolerance,
            bracket: GammaBracket { lower, upper: f64::INFINITY, binding, n_tests: 0 },
            failed: None,
            couplings: Vec::new(),
            feasible: None,
            n_lower_moves: 0,
            n_upper_moves: 0,
            radius_hint: None,
            n_hints: 0,
            at_peak: false,
            n_peaks: 0,
        }
    }

    /// Just above what no controller can do at a few frequencies: often that is the limit.
    fn first_gamma(&mut self) -> f64 {
        let a = &self.normalized.a;
        let mut sizes: Vec<f64> = a.diagonal().iter().map(|v| v.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let at = |part: f64| sizes.get((part * sizes.len() as f64) as usize).copied().unwrap_or(0.0);
        if self.look_at(&[0.0, at(0.25), at(0.5), at(0.75)]) {
            return self.just_above();
        }
        if self.bracket.lower > 0.0 { 2.0 * self.bracket.lower } else { FIRST_GAMMA }
    }

    /// Whether some of the frequencies raised the lower end.
    fn look_at(&mut self, frequencies: &[f64]) -> bool {
        let bound = pointwise_bound(self.plant, frequencies);
        let peak = bound.value() * (1.0 - PEAK_ROUNDING);
        if !(peak > self.bracket.lower && peak < self.bracket.upper) {
            return false;
        }
        self.bracket.lower = peak;
        let control = bound.control >= bound.filter;
        self.bracket.binding = Some(if control { Condition::ControlAxis } else { Condition::FilterAxis });
        true
    }

    fn just_above(&self) -> f64 {
        self.bracket.lower * (1.0 + NEAR_END * self.tolerance)
    }

    /// Where to look between a lower and a feasible end.
    fn next_gamma(&self) -> f64 {
        let GammaBracket { lower, upper, .. } = self.bracket;
        if self.at_peak {
            return self.just_above().min(upper);
        }
        let width = (upper / lower).ln();
        let middle = lower * (0.5 * width).exp();
        let near = (NEAR_END * self.tolerance).min(0.5 * width);
        let guess =
            if self.n_lower_moves.max(self.n_upper_moves) < MOVES_MAX { self.interpolated() } else { None };
        let guess = guess.filter(|g| g.is_finite()).unwrap_or(middle);
        // Where the two bounds meet, rounding may put them in the wrong order.
        guess.max(lower * near.exp()).min(upper * (-near).exp())
    }

    /// By the measure of the condition that binds at the lower end.
    fn interpolated(&self) -> Option<f64> {
        let feasible = self.feasible.as_ref()?;
        let (t_upper, t_lower) = (self.bracket.upper.powi(-2), self.bracket.lower.powi(-2));
        let Some(failed) = self.failed else {
            // The radius at the upper end is all that is known: a little above the end that it sets.
            return (self.bracket.binding == Some(Condition::Coupling))
                .then(|| (t_upper + TOWARDS_FLOOR * (t_lower - t_upper)).powf(-0.5));
        };
        let (beyond, within) = match (failed.coupling, feasible.margin(Condition::Coupling)) {
            (Some(beyond), Some(within)) if (within - beyond) * failed.gamma.powi(2) < SMOOTH => {
                if let Some(t) = inverse_quadratic(&self.couplings)
                    && t > t_upper
                    && t < t_lower
                {
                    return Some(t.powf(-0.5));
                }
                (beyond, within)
            }
            _ => (failed.margin?, feasible.margin(self.bracket.binding?)?),
        };
        // An end that stays is given less weight each time, so that the other one gets to it.
        let beyond = -beyond * 0.5_f64.powi(self.n_upper_moves.saturating_sub(1) as i32);
        let within = within * 0.5_f64.powi(self.n_lower_moves.saturating_sub(1) as i32);
        Some((t_upper + within / (within + beyond) * (failed.gamma.powi(-2) - t_upper)).powf(-0.5))
    }

    /// Takes down the measure of the coupling at a gamma, smallest in magnitude first.
    fn note_coupling(&mut self, gamma: f64, coupling: Option<f64>) {
        if let Some(coupling) = coupling.filter(|c| c.is_finite()) {
            self.couplings.push((gamma.powi(-2), coupling));
            self.couplings.sort_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
        }
    }

    fn try_gamma(&mut self, gamma: f64) -> Result<(), Error> {
        self.bracket.n_tests += 1;
        self.at_peak = false;
        match test(self.normalized, gamma)? {
            Test::Feasible(feasible) => self.reached(gamma, feasible),
            Test::Violated(violation) => self.missed(gamma, &violation),
        }
        if self.n_lower_moves.max(self.n_upper_moves) > MOVES_MAX {
            // The step in the middle has been made.
            (self.n_lower_moves, self.n_upper_moves) = (0, 0);
        }
        Ok(())
    }

    fn reached(&mut self, gamma: f64, feasible: Box<Feasible>) {
        self.note_coupling(gamma, feasible.margin(Condition::Coupling));
        let floor = feasible.coupling_floor();
        if floor > self.bracket.lower {
            self.bracket.lower = floor;
            if self.failed.is_none() {
                self.bracket.binding = Some(Condition::Coupling);
            }
        }
        self.bracket.upper = gamma;
        self.feasible = Some(feasible);
        self.n_upper_moves += 1;
        self.n_lower_moves = 0;
    }

    /// Moves the ends apart where the subspaces are so rough that the radius may be off by more than the tolerance.
    fn widen_to_rounding(&mut self) {
        let GammaBracket { lower, upper, .. } = self.bracket;
        let rough = self.feasible.as_ref().filter(|feasible| feasible.isotropy_error() > ROUGH);
        let Some(radius) = rough.and_then(|feasible| feasible.refined_radius(self.normalized)) else {
            return;
        };
        if self.bracket.binding == Some(Condition::Coupling) {
            self.bracket.lower = lower.min(radius * (1.0 - PEAK_ROUNDING));
        }
        self.bracket.upper = upper.max(radius * (1.0 + PEAK_ROUNDING));
    }

    fn missed(&mut self, gamma: f64, violation: &Violation) {
        self.note_coupling(gamma, violation.coupling);
        self.failed = Some(Failed { gamma, margin: violation.margin, coupling: violation.coupling });
        self.bracket.lower = self.bracket.lower.max(gamma);
        self.bracket.binding = Some(violation.condition);
        self.n_lower_moves += 1;
        self.n_upper_moves = 0;
        if let (Condition::Coupling, Some(margin)) = (violation.condition, violation.margin) {
            let hint = (margin + gamma.powi(-2)).powf(-0.5) * (1.0 + self.tolerance);
            self.radius_hint = (self.n_hints == 0 && hint > gamma).then_some(hint);
            self.n_hints += 1;
        }
        if violation.frequencies.is_empty() || self.n_peaks == PEAKS_MAX {
            return;
        }
        // The response is even, so zero lies in the middle between the lowest crossing and its mirror image.
        let between = violation.frequencies.windows(2).map(|pair| 0.5 * (pair[0] + pair[1]));
        let between: Vec<f64> = std::iter::once(0.0).chain(between).collect();
        if self.look_at(&between) {
            self.at_peak = true;
            self.n_peaks += 1;
        }
    }
}

/// The root of the function whose inverse is the parabola through the first three points `(t, h)`.
fn inverse_quadratic(points: &[(f64, f64)]) -> Option<f64> {
    let [(t0, h0), (t1, h1), (t2, h2), ..] = *points else { return None };
    let weight = |h: f64, other: f64, another: f64| other * another / ((h - other) * (h - another));
    let t = t0 * weight(h0, h1, h2) + t1 * weight(h1, h0, h2) + t2 * weight(h2, h0, h1);
    t.is_finite().then_some(t)
}

/// A gamma whose square is as good as infinite and still a number.
const UNLIMITED: f64 = 1e150;
/// First gamma tried where nothing gives a hint.
const FIRST_GAMMA: f64 = 1.0;
/// Factors between gammas while the upper end is unknown: each is the square of the one before.
const GROWTH_FIRST: f64 = 1.5;
const FACTOR_MAX: f64 = 256.0;
/// Factor between gammas while the lower end is unknown.
const GROWTH: f64 = 10.0;
/// A measure of the coupling that changes by more than this, relative to `1 / gamma²`, has no use.
const SMOOTH: f64 = 100.0;
/// A problem that is still feasible this far below the first feasible gamma has no lower end worth finding.
const SMALLEST_RELATIVE: f64 = 1e-12;
/// Part of the tolerance that a guess stays away from the ends: half of it would be near enough.
const NEAR_END: f64 = 0.4;
/// Part of the way to a lower end set by `rho(X Y)` where the first look goes.
const TOWARDS_FLOOR: f64 = 0.85;
/// Moves of the same end after which the middle is tried.
const MOVES_MAX: u32 = 3;
/// Peaks over frequency that are followed: the convergence is quadratic.
const PEAKS_MAX: u32 = 8;
/// Rounding of a gain at one frequency.
const PEAK_ROUNDING: f64 = 1e-9;
/// Halvings of the logarithm: a decade to `1e-12` takes 42.
const STEPS_MAX: usize = 80;
/// Isotropy error of a subspace above which its solution is looked at again; most are below 1e-13.
const ROUGH: f64 = 1e-11;
