//! H-infinity synthesis: bracket the smallest reachable norm, design once just above it, measure what was achieved.

use num_complex::Complex64;
use telepulse_lti::hinf_norm::hinf_norm_and_poles;
use telepulse_lti::{Continuous, GeneralizedPlant, PeakGain, StateSpace};

use super::assumptions::{self, Strictness};
use super::central_controller::{Condition, Feasible, Test, test};
use super::controller_gain::peak_gain;
use super::controller_speed::slowed_down;
use super::gamma_bracket::GammaBracket;
use super::measured_loop::{FormedLoop, measured};
use super::normalized_plant::NormalizedPlant;
use super::pointwise_bound::{frequencies, pointwise_bound};
use super::regularize::regularized_design;
use crate::Error;

/// Settings of [`hinfsyn`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HinfOptions {
    /// The controller is designed at this factor times the bracket's upper end; above 1. Controllers at the optimum
    /// itself have poles near infinity. Default 1.01.
    pub backoff: f64,
    /// Relative width at which the bracket is narrow enough. Default `1e-6`.
    pub gamma_tolerance: f64,
    /// Largest gamma that is tried before the problem counts as infeasible. Default `1e9`.
    pub gamma_max: f64,
    /// Fastest controller pole allowed, in rad/s (default: no limit). Modes beyond it are replaced by their static gain
    /// where the loop bears that, else gamma is relaxed up to [`HinfOptions::relaxation_max`].
    pub max_controller_pole_rad_s: Option<f64>,
    /// Largest controller gain allowed, the peak over frequency of its largest singular value (default: no limit).
    /// A controller that is not stable has no such peak; its gain is then the largest on the imaginary axis.
    pub max_controller_gain: Option<f64>,
    /// Largest factor on the bracket's upper end to which gamma may be relaxed. Default 2.
    pub relaxation_max: f64,
    /// What to do where `D12`, `D21` or a zero on the imaginary axis makes the problem singular. Default
    /// [`SingularProblem::Regularize`].
    pub singular: SingularProblem,
}

impl Default for HinfOptions {
    fn default() -> Self {
        Self {
            backoff: 1.01,
            gamma_tolerance: 1e-6,
            gamma_max: 1e9,
            max_controller_pole_rad_s: None,
            max_controller_gain: None,
            relaxation_max: 2.0,
            singular: SingularProblem::Regularize,
        }
    }
}

/// What to do about a singular problem, whose smallest norm is only approached.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SingularProblem {
    /// Solve a nearby regular problem and measure its controller on the plant as given.
    Regularize,
    /// Refuse with [`Error::SingularD12`], [`Error::SingularD21`] or [`Error::AxisZero`].
    Refuse,
}

/// What was added to a singular plant to make it solvable, and what it led to.
///
/// Signals are appended to `z` and `w` whose size is `epsilon` times the plant's own; the controller of the enlarged
/// plant is used on the plant as given, whose norm is at most that of the enlarged one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Regularization {
    /// Size of what was added relative to the plant's own direct terms.
    pub epsilon: f64,
    /// Whether the control input needed a direct weight (`D12`).
    pub d12: Repaired,
    /// Whether the measurement needed noise (`D21`).
    pub d21: Repaired,
    /// Whether zeros on the imaginary axis needed weights or disturbances of the states.
    pub axis_zeros: Repaired,
    /// Smallest norm of the enlarged plant that some controller is known to reach.
    pub gamma_enlarged: f64,
}

/// Whether a part of the plant had to be repaired.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Repaired {
    /// It was regular.
    No,
    /// It was singular and something was added.
    Yes,
}

/// A controller and the evidence for it.
#[derive(Clone, Debug, PartialEq)]
pub struct HinfDesign {
    /// The controller, `u = K y`.
    pub controller: StateSpace<Continuous>,
    /// No controller reaches this norm.
    pub gamma_lower: f64,
    /// Some controller reaches this norm.
    pub gamma_upper: f64,
    /// The norm that this controller was designed for.
    pub gamma_design: f64,
    /// The closed-loop norm on the plant as it was given, recomputed from the closed loop and held against the response of
    /// plant and controller that are not joined into one system; the ends are moved apart by what the two differ.
    pub achieved: PeakGain,
    /// Poles of the closed loop in rad/s, all stable.
    pub closed_loop_poles: Vec<Complex64>,
    /// The condition that fails at `gamma_lower`; `None` where the norm can be made as small as one likes.
    pub binding_condition: Option<Condition>,
    /// Feasibility tests spent on the bracket.
    pub n_feasibility_tests: usize,
    /// What was added to a singular plant to make it solvable; `None` for a regular one.
    pub regularization: Option<Regularization>,
    /// Controller modes that were replaced by their static gain to satisfy `max_controller_pole_rad_s`.
    pub n_residualized: usize,
    /// Norm of `X1ᵀ X2 - X2ᵀ X1` of the worse of the two subspaces: rounding of the design.
    pub isotropy_error: f64,
    /// Why the last design nearer to the optimum was discarded; `None` where the first one, at the back-off, was kept. Then
    /// `gamma_design` is more than the back-off times `gamma_upper`, and so may be the norm.
    pub discarded: Option<Error>,
}

impl HinfDesign {
    /// Largest magnitude of a controller pole, in rad/s.
    ///
    /// **Errors**: those of the eigenvalue iteration.
    pub fn fastest_controller_pole_rad_s(&self) -> Result<f64, Error> {
        Ok(fastest_pole(&self.controller)?)
    }
}

/// Returns a controller whose closed-loop H-infinity norm is within the back-off of the smallest possible.
///
/// **Shapes and units**: see [`GeneralizedPlant`] for the loop; feedback is `u = K y`.
///
/// **Method**: normalize `D12` and `D21`, check the assumptions mode by mode, bracket gamma
/// by the gains that no controller lowers at single frequencies, the coupling of the two Riccati solutions, and tests in between, design the central controller once at `backoff` times the upper end,
/// undo the normalization (including `D22`), close the loop on the given plant and compute its norm through
/// [`telepulse_lti::hinf_norm()`]. A design whose loop is unstable or misses its gamma is discarded and repeated further from the
/// optimum; it is never returned.
///
/// **Source**: Glover and Doyle 1988; Zhou, Doyle and Glover 1996, chapters 16 and 17.
///
/// **Accuracy**: `achieved.upper <= 1.0001 · gamma_design`, checked.
///
/// **Errors**: [`Error::SingularD12`], [`Error::SingularD21`], [`Error::NotStabilizable`], [`Error::NotDetectable`],
/// [`Error::AxisZero`], [`Error::Infeasible`], [`Error::NotConverged`], [`Error::IllConditioned`],
/// [`Error::ControllerTooFast`], [`Error::ControllerGainTooHigh`], [`Error::OutOfRange`] for options.
///
/// **Example**
/// ```
/// use telepulse_design::synthesize::{HinfOptions, MixedSensitivityWeights, hinfsyn, mixed_sensitivity};
/// use telepulse_lti::TransferFunction;
/// let g = TransferFunction::new(&[1.0], &[1.0, 1.0])?;
/// let we = TransferFunction::new(&[0.5, 1.0], &[1.0, 0.001])?;
/// let wu = TransferFunction::new(&[0.1], &[1.0])?;
/// let plant = mixed_sensitivity(&g, &MixedSensitivityWeights { we: &we, wu: &wu, wt: None })?;
/// let design = hinfsyn(&plant, &HinfOptions::default())?;
/// assert!(design.gamma_lower <= design.achieved.value);
/// assert!(design.achieved.upper <= 1.011 * design.gamma_upper);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn hinfsyn(plant: &GeneralizedPlant, options: &HinfOptions) -> Result<HinfDesign, Error> {
    check_options(options)?;
    match regular_design(plant, plant, options, DESIGNS_MAX) {
        Err(
            reason @ (Error::SingularD12 { .. }
            | Error::SingularD21 { .. }
            | Error::AxisZero { .. }
            | Error::IllConditioned { .. }
            | Error::Infeasible { .. }
            | Error::NotConverged { .. }),
        ) if options.singular == SingularProblem::Regularize => regularized_design(plant, options, reason),
        other => other,
    }
}

/// Designs for `solved`, which must be regular, and measures on `plant`, which has the same `u` and `y`; tries `n_designs`,
/// each further from the optimum, before it gives up.
pub(super) fn regular_design(
    solved: &GeneralizedPlant,
    plant: &GeneralizedPlant,
    options: &HinfOptions,
    n_designs: usize,
) -> Result<HinfDesign, Error> {
    let normalized = NormalizedPlant::new(solved)?;
    assumptions::check(&normalized, Strictness::Certain)?;
    let mut bracket = GammaBracket::find(solved, &normalized, options)?;
    let gamma_floor = bracket.upper.max(bracket.lower);
    let mut factor = options.backoff;
    let mut discarded = None;
    for _ in 0..n_designs {
        let gamma = factor * gamma_floor;
        match Attempt::new(plant, &normalized, gamma, options) {
            Ok(attempt) => {
                let (attempt, gamma) = nearer(attempt, plant, &normalized, gamma, gamma_floor, options);
                // A loop that does better than the lower end proves that the conditions failed by rounding there: what is left is
                // what no controller can do at single frequencies.
                if attempt.achieved.value < bracket.lower {
                    bracket.lower = pointwise_bound(solved, &frequencies(solved)).value();
                    bracket.lower = bracket.lower.min(attempt.achieved.value);
                    bracket.upper = bracket.upper.min(attempt.achieved.upper);
                    bracket.binding = None;
                }
                return Ok(HinfDesign {
                    controller: attempt.controller,
                    gamma_lower: bracket.lower,
                    gamma_upper: bracket.upper,
                    gamma_design: gamma,
                    achieved: attempt.achieved,
                    closed_loop_poles: attempt.closed_loop_poles,
                    binding_condition: bracket.binding,
                    n_feasibility_tests: bracket.n_tests,
                    regularization: None,
                    n_residualized: attempt.n_residualized,
                    isotropy_error: attempt.isotropy_error,
                    discarded,
                });
            }
            Err(
                error @ (Error::IllConditioned { .. }
                | Error::ControllerTooFast { .. }
                | Error::ControllerGainTooHigh { .. }),
            ) => discarded = Some(error),
            Err(error) => return Err(error),
        }
        if factor >= options.relaxation_max {
            break;
        }
        factor = (1.0 + RELAXATION_GROWTH * (factor - 1.0)).min(options.relaxation_max);
    }
    let GammaBracket { lower, upper, .. } = bracket;
    Err(discarded.unwrap_or(Error::NotConverged { gamma_lower: lower, gamma_upper: upper }))
}

/// Where rounding made the loop miss its gamma by a little, the better of it and a design nearer to the optimum.
fn nearer(
    attempt: Attempt,
    plant: &GeneralizedPlant,
    normalized: &NormalizedPlant,
    gamma: f64,
    gamma_floor: f64,
    options: &HinfOptions,
) -> (Attempt, f64) {
    if attempt.achieved.upper <= gamma {
        return (attempt, gamma);
    }
    let closer = gamma_floor + NEARER * (gamma - gamma_floor);
    match Attempt::new(plant, normalized, closer, options) {
        Ok(other) if other.achieved.value < attempt.achieved.value => (other, closer),
        _ => (attempt, gamma),
    }
}

fn check_options(options: &HinfOptions) -> Result<(), Error> {
    let range = |key, found: f64, valid: bool, allowed| {
        if valid { Ok(()) } else { Err(Error::OutOfRange { key, found, allowed }) }
    };
    let &HinfOptions { backoff, gamma_tolerance, gamma_max, relaxation_max, .. } = options;
    range("backoff", backoff, backoff > 1.0 && backoff.is_finite(), "above 1")?;
    range("gamma_tolerance", gamma_tolerance, (1e-12..=0.1).contains(&gamma_tolerance), "from 1e-12 to 0.1")?;
    range("gamma_max", gamma_max, gamma_max > 0.0 && gamma_max.is_finite(), "positive and finite")?;
    range(
        "relaxation_max",
        relaxation_max,
        relaxation_max >= backoff && relaxation_max.is_finite(),
        "at least backoff",
    )?;
    for (key, limit) in [
        ("max_controller_pole_rad_s", options.max_controller_pole_rad_s),
        ("max_controller_gain", options.max_controller_gain),
    ] {
        let limit = limit.unwrap_or(1.0);
        range(key, limit, limit > 0.0 && limit.is_finite(), "positive and finite")?;
    }
    Ok(())
}

/// A verified design at one gamma.
struct Attempt {
    controller: StateSpace<Continuous>,
    achieved: PeakGain,
    closed_loop_poles: Vec<Complex64>,
    n_residualized: usize,
    isotropy_error: f64,
}

impl Attempt {
    fn new(
        plant: &GeneralizedPlant,
        normalized: &NormalizedPlant,
        gamma: f64,
        options: &HinfOptions,
    ) -> Result<Self, Error> {
        let attempt = Self::slow_enough(plant, normalized, gamma, options.max_controller_pole_rad_s)?;
        if let Some(limit) = options.max_controller_gain {
            let gain = match peak_gain(&attempt.controller) {
                // A pole on the axis.
                Err(Error::System(telepulse_lti::Error::Unstable { .. })) => f64::INFINITY,
                other => other?,
            };
            if gain > limit {
                return Err(Error::ControllerGainTooHigh { gamma, gain, limit });
            }
        }
        Ok(attempt)
    }

    fn slow_enough(
        plant: &GeneralizedPlant,
        normalized: &NormalizedPlant,
        gamma: f64,
        limit_rad_s: Option<f64>,
    ) -> Result<Self, Error> {
        let feasible: Feasible = match test(normalized, gamma)? {
            Test::Feasible(feasible) => *feasible,
            Test::Violated(_) => return Err(Error::IllConditioned { gamma, achieved: f64::INFINITY }),
        };
        let central = feasible.controller(normalized).and_then(|central| normalized.recover(&central));
        let verified = central.and_then(|central| Self::verified(plant, central, gamma));
        let mut attempt = match verified {
            Ok(attempt) if attempt.achieved.upper <= gamma => attempt,
            // The formulas may have cancelled: once more in doubled precision, and the better of the two.
            Ok(attempt) => match Self::refined(plant, normalized, &feasible, gamma) {
                Some(Ok(refined)) if refined.achieved.value < attempt.achieved.value => refined,
                _ => attempt,
            },
            Err(error @ Error::IllConditioned { .. }) => {
                Self::refined(plant, normalized, &feasible, gamma).unwrap_or(Err(error))?
            }
            Err(error) => return Err(error),
        };
        attempt.isotropy_error = feasible.isotropy_error();
        let Some(limit_rad_s) = limit_rad_s else { return Ok(attempt) };
        let pole_rad_s = fastest_pole(&attempt.controller)?;
        if pole_rad_s <= limit_rad_s {
            return Ok(attempt);
        }
        let too_fast = Error::ControllerTooFast { gamma, pole_rad_s, limit_rad_s };
        let n_before = attempt.controller.n_states();
        let slow = slowed_down(&attempt.controller, limit_rad_s)?.ok_or_else(|| too_fast.clone())?;
        let n_residualized = n_before - slow.n_states();
        // A loop that does not bear the static replacement is one more reason to relax gamma.
        let slow = Self::verified(plant, slow, gamma).map_err(|error| match error {
            Error::IllConditioned { .. } => too_fast,
            other => other,
        })?;
        Ok(Self { n_residualized, isotropy_error: attempt.isotropy_error, ..slow })
    }

    fn refined(
        plant: &GeneralizedPlant,
        normalized: &NormalizedPlant,
        feasible: &Feasible,
        gamma: f64,
    ) -> Option<Result<Self, Error>> {
        let central = feasible.refined(normalized)?;
        Some(normalized.recover(&central).and_then(|central| Self::verified(plant, central, gamma)))
    }

    /// Closes the loop on the plant as given and measures it.
    fn verified(
        plant: &GeneralizedPlant,
        controller: StateSpace<Continuous>,
        gamma: f64,
    ) -> Result<Self, Error> {
        let sys = plant.lower_lft(&controller)?;
        let unstable = Error::IllConditioned { gamma, achieved: f64::INFINITY };
        let (peak, poles) = match hinf_norm_and_poles(&sys) {
            Err(telepulse_lti::Error::Unstable { .. }) => return Err(unstable),
            other => other?,
        };
        // A real part that rounding of the loop's own entries can turn is no evidence of stability.
        let rounding = STABLE_ROUNDING * f64::EPSILON * sys.balanced().a().norm();
        if poles.iter().any(|pole| pole.re >= -rounding) {
            return Err(unstable);
        }
        let formed = FormedLoop { sys, poles, peak };
        let achieved = measured(plant, &controller, &formed, gamma)?;
        if achieved.upper > gamma * (1.0 + ACHIEVED_TOLERANCE) {
            return Err(Error::IllConditioned { gamma, achieved: achieved.value });
        }
        let closed_loop_poles = formed.poles;
        Ok(Self { controller, achieved, closed_loop_poles, n_residualized: 0, isotropy_error: 0.0 })
    }
}

fn fastest_pole(sys: &StateSpace<Continuous>) -> Result<f64, telepulse_lti::Error> {
    Ok(sys.poles()?.into_iter().fold(0.0, |fastest, pole| pole.norm().max(fastest)))
}

/// Units of the last place of the loop's state matrix that a stable pole must be away from the axis.
const STABLE_ROUNDING: f64 = 4.0;
/// Designs tried, each further from the optimum than the one before.
const DESIGNS_MAX: usize = 12;
/// Part of the distance from the optimum that is tried where a loop missed its gamma.
const NEARER: f64 = 0.9;
/// Growth of the distance from the optimum between designs.
const RELAXATION_GROWTH: f64 = 2.0;
/// How far the measured norm may exceed the gamma of the design.
const ACHIEVED_TOLERANCE: f64 = 1e-4;
