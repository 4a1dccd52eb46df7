//! D-K iteration: a controller for the worst perturbation instead of the nominal plant.
//!
//! [`dk_iteration`] does it with the stages of this module; [`dk_iteration_with`] takes others: any [`ControllerStage`],
//! [`AnalysisStage`] and [`FitStage`], closures among them.

mod blocks;
mod mu_step;
mod rational_scale;
mod reduction;
mod scale_fit;
mod stages;

pub use blocks::{FullBlock, FullBlocks};
pub use mu_step::{ScaledGain, scaled_gain};
pub use rational_scale::RationalScale;
pub use reduction::ReducedController;
pub use scale_fit::{FittedScales, ScaleFitOptions, ScaleSample, fit_scales};
pub use stages::{AnalysisStage, ControllerStage, DkStages, FitStage, SynthesizedController};

use telepulse_lti::{Continuous, GeneralizedPlant, PeakGain, StateSpace, hinf_norm};

use super::hinfsyn::{HinfOptions, hinfsyn};
use crate::Error;
use rational_scale::scaled_system;

/// Settings of [`dk_iteration`].
#[derive(Clone, Debug, PartialEq)]
pub struct DkOptions {
    /// Controllers designed after the first, which is plain H-infinity synthesis; 30.
    pub iterations_max: usize,
    /// The iteration ends when four controllers in a row lower the best peak by less than this, relative; 0.0002.
    pub improvement_min: f64,
    /// The iteration ends when the proven peak is at or below this; 0, never.
    pub peak_target: f64,
    /// Frequencies of the analysis in rad/s, rising; `None`: 12 a decade from a tenth of the slowest to ten times
    /// the fastest pole or corner of the plant.
    pub omega_rad_s: Option<Vec<f64>>,
    /// How scales are fitted.
    pub fit: ScaleFitOptions,
    /// How controllers are synthesized; the defaults with a back-off of 1.003.
    pub hinf: HinfOptions,
    /// By how much, relative, the reduced controller may raise the proven peak; 0.01.
    pub reduction_loss: f64,
}

impl Default for DkOptions {
    fn default() -> Self {
        Self {
            iterations_max: 30,
            improvement_min: 2e-4,
            peak_target: 0.0,
            omega_rad_s: None,
            fit: ScaleFitOptions::default(),
            hinf: HinfOptions { backoff: 1.003, ..HinfOptions::default() },
            reduction_loss: 0.01,
        }
    }
}

/// One controller of a D-K iteration.
#[derive(Clone, Debug, PartialEq)]
pub struct DkIterate {
    /// Order of each block's scale in the plant that the controller was designed for; all zero at first.
    pub scale_orders: Vec<usize>,
    /// States of the controller.
    pub controller_order: usize,
    /// The norm that the controller was designed for.
    pub gamma: f64,
    /// Peak of the upper bound of mu over the frequencies of the analysis, with free scales at each.
    pub mu_peak_sampled: f64,
    /// Where, in rad/s.
    pub omega_peak_rad_s: f64,
    /// What no frequency exceeds: the proven norm of the loop with rational scales, or its largest sampled gain where rounding
    /// makes the two disagree.
    pub mu_peak_proven: f64,
    /// Largest ratio of the fitted scales' bound to the free scales' bound.
    pub fit_excess: f64,
}

/// Why a D-K iteration ended.
#[derive(Clone, Debug, PartialEq)]
pub enum DkStop {
    /// The proven peak is at the target.
    TargetReached,
    /// The last controllers brought nothing more.
    NoImprovement,
    /// As many controllers as allowed.
    IterationsUsed,
    /// A stage gave no answer after the first controller; the best one before is returned.
    StageFailed(Error),
}

/// The controller with the lowest proven peak of the structured singular value, and how it was found.
#[derive(Clone, Debug, PartialEq)]
pub struct DkDesign {
    /// The controller, `u = K y`.
    pub controller: StateSpace<Continuous>,
    /// Its loop from `w` to `z`.
    pub closed_loop: StateSpace<Continuous>,
    /// The structured singular value of the closed loop is at or below this at every frequency.
    pub mu_peak_proven: f64,
    /// The norm of the scaled closed loop that proves it.
    pub proof: PeakGain,
    /// The scales of the proof, one per block.
    pub scales: Vec<RationalScale>,
    /// Index of the controller in `history`.
    pub best_idx: usize,
    /// Every controller in order; the first is plain H-infinity synthesis.
    pub history: Vec<DkIterate>,
    /// Why it ended.
    pub stop: DkStop,
    /// The controller of lowest order whose proven peak is within `reduction_loss`, where there is one.
    pub reduced: Option<ReducedController>,
}

/// Returns the controller of least proven peak of mu that D-K iteration finds.
///
/// **Shapes and units**: see [`FullBlocks`]; all signals of `w` and `z` belong to a block, the performance channels to one of
/// their own. A repeated or real parameter must be given as full blocks of one signal each: the result then holds for more
/// perturbations than there are, so it is safe, and pessimistic.
///
/// **Method**: synthesize for the scaled plant `D_L P D_R^-1` ([`hinfsyn()`]), find the best constant scales of the closed loop at
/// each frequency ([`scaled_gain`]), fit rational ones ([`fit_scales`]), repeat. The joint problem is not convex, so a step may
/// make things worse: the best controller is kept, and none is worse than the first, which has `D = 1`.
///
/// **Source**: Doyle 1985, Proc. IFAC Workshop on Model Error Concepts; Skogestad and Postlethwaite 2005, section 8.12.
///
/// **Accuracy**: the proven peak comes from [`hinf_norm()`] of the scaled closed loop, a Hamiltonian test that shares nothing
/// with the grid and the synthesis. Where the frequency response of a loop on the edge of rounding exceeds that norm, the
/// larger value counts. It lies above `mu_peak_sampled` by what the fit loses.
///
/// **Errors**: [`telepulse_lti::Error::PortCount`] for blocks that do not fit the plant, [`Error::OutOfRange`] for options,
/// those of [`hinfsyn()`] for the first controller.
///
/// **Example**
/// ```
/// use telepulse_design::synthesize::dk::{DkOptions, FullBlock, FullBlocks, dk_iteration};
/// use telepulse_lti::{Diagram, StateSpace, TransferFunction};
/// // y = G u + 0.4 d, d = Delta u with |Delta| <= 1; performance: from r to W e.
/// let g = TransferFunction::new(&[1.0], &[1.0, 1.0])?.to_state_space();
/// let w = TransferFunction::new(&[0.4, 0.4], &[1.0, 0.01])?.to_state_space();
/// let size = TransferFunction::from_gain(0.4)?.to_state_space();
/// let plant = Diagram::new()
///     .external_inputs([("d", 1), ("r", 1), ("u", 1)])
///     .block(&size, ["d"], [("q", 1)])
///     .block(&g, ["u"], [("p", 1)])
///     .sum("e = r - p - q")
///     .sum("to_delta = u")
///     .block(&w, ["e"], [("z", 1)])
///     .external_outputs(["to_delta", "z", "e"])
///     .connect()?
///     .generalized_plant(&["u"], &["e"])?;
/// let blocks = FullBlocks::new(vec![FullBlock { n_w: 1, n_z: 1 }; 2])?;
/// let design = dk_iteration(&plant, &blocks, &DkOptions::default())?;
/// assert!(design.mu_peak_proven <= design.history[0].mu_peak_proven);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn dk_iteration(
    plant: &GeneralizedPlant,
    blocks: &FullBlocks,
    options: &DkOptions,
) -> Result<DkDesign, Error> {
    let controller = |plant: &GeneralizedPlant| {
        let design = hinfsyn(plant, &options.hinf)?;
        Ok(SynthesizedController { controller: design.controller, gamma: design.gamma_design })
    };
    let fit = |samples: &[ScaleSample], blocks: &FullBlocks| fit_scales(samples, blocks, &options.fit);
    let stages = DkStages { controller: &controller, analysis: &scaled_gain, fit: &fit };
    dk_iteration_with(plant, blocks, options, &stages)
}

/// Returns what [`dk_iteration`] does, with stages of the caller's choice.
///
/// **Method**: whatever the stages answer, the peak is proven here, so that a poor stage makes a poor controller, but no
/// wrong claim.
///
/// **Errors**: as [`dk_iteration`]; [`Error::StageScales`] for scales that do not fit the blocks.
pub fn dk_iteration_with(
    plant: &GeneralizedPlant,
    blocks: &FullBlocks,
    options: &DkOptions,
    stages: &DkStages<'_>,
) -> Result<DkDesign, Error> {
    blocks.check_ports(plant.n_w(), plant.n_z())?;
    let mut grid = checked_grid(plant, options)?;
    let mut scales =
        blocks.blocks().iter().map(|_| RationalScale::constant(1.0)).collect::<Result<Vec<_>, _>>()?;
    let mut history: Vec<DkIterate> = Vec::new();
    let mut best: Option<Proven> = None;
    let mut stop = DkStop::IterationsUsed;
    let mut idle = 0;
    let mut line = Line::start(&scales);
    for idx in 0..=options.iterations_max {
        let step = match step(plant, blocks, &scales, &grid, stages) {
            Ok(step) => step,
            Err(error) if idx == 0 => return Err(error),
            // Scales beyond what a stage bears: try ones closer to the best.
            Err(error) => {
                line.retreat();
                idle += 1;
                if idle >= IDLE_MAX || line.stretch < STRETCH_MIN {
                    stop = DkStop::StageFailed(error);
                    break;
                }
                scales = line.next(&grid, options.fit.order_max);
                continue;
            }
        };
        history.push(step.iterate);
        insert(&mut grid, step.proven.proof.omega_rad_s);
        let before = best.as_ref().map_or(f64::INFINITY, |b| b.peak);
        let now = step.proven.peak;
        if now < before {
            line.advance(scales, step.next_scales);
        } else {
            line.retreat();
        }
        idle = if now < before * (1.0 - options.improvement_min) { 0 } else { idle + 1 };
        if now < before {
            best = Some(Proven { idx: history.len() - 1, ..step.proven });
        }
        if now.min(before) <= options.peak_target {
            stop = DkStop::TargetReached;
            break;
        }
        if idle >= IDLE_MAX || line.stretch < STRETCH_MIN || blocks.blocks().len() == 1 {
            stop = DkStop::NoImprovement;
            break;
        }
        scales = line.next(&grid, options.fit.order_max);
    }
    let best = best.ok_or(Error::IllConditioned { gamma: f64::INFINITY, achieved: f64::INFINITY })?;
    let allowed = best.peak * (1.0 + options.reduction_loss);
    let reduced = reduction::reduced(plant, blocks, &best.scales, &best.controller, allowed);
    Ok(DkDesign {
        controller: best.controller,
        closed_loop: best.closed_loop,
        mu_peak_proven: best.peak,
        proof: best.proof,
        scales: best.scales,
        best_idx: best.idx,
        history,
        stop,
        reduced,
    })
}

/// A controller with the proof of its peak.
struct Proven {
    controller: StateSpace<Continuous>,
    closed_loop: StateSpace<Continuous>,
    peak: f64,
    proof: PeakGain,
    scales: Vec<RationalScale>,
    idx: usize,
}

struct Step {
    proven: Proven,
    iterate: DkIterate,
    next_scales: Vec<RationalScale>,
}

/// The scales to try: from those of the best controller through those fitted to its loop, and beyond while that pays.
struct Line {
    from: Vec<RationalScale>,
    to: Vec<RationalScale>,
    /// 0 stays at `from`, 1 is at `to`.
    stretch: f64,
}

impl Line {
    fn start(scales: &[RationalScale]) -> Self {
        Self { from: scales.to_vec(), to: scales.to_vec(), stretch: 0.5 }
    }

    fn advance(&mut self, from: Vec<RationalScale>, to: Vec<RationalScale>) {
        self.from = from;
        self.to = to;
        self.stretch = (2.0 * self.stretch).min(STRETCH_MAX);
    }

    fn retreat(&mut self) {
        self.stretch *= 0.25;
    }

    /// The scales at the stretch, fitted again; those at 1 where they cannot be.
    fn next(&self, grid: &[f64], order: usize) -> Vec<RationalScale> {
        if self.stretch == 1.0 {
            return self.to.clone();
        }
        let one = |(from, to): (&RationalScale, &RationalScale)| {
            let target = |&omega: &f64| {
                let (a, b) = (from.magnitude(omega).ln(), to.magnitude(omega).ln());
                (omega, (a + self.stretch * (b - a)).exp())
            };
            let targets: Vec<_> = grid.iter().map(target).collect();
            let order = order.min(from.order().max(to.order()));
            scale_fit::fit_magnitude(&targets, order).unwrap_or_else(|_| to.clone())
        };
        self.from.iter().zip(&self.to).map(one).collect()
    }
}

/// One controller for given scales, its analysis, and the scales for the next.
fn step(
    plant: &GeneralizedPlant,
    blocks: &FullBlocks,
    scales: &[RationalScale],
    grid: &[f64],
    stages: &DkStages<'_>,
) -> Result<Step, Error> {
    let scaled = scaled_system(plant.sys(), blocks, scales)?;
    let scaled = GeneralizedPlant::new(scaled, plant.n_w(), plant.n_u(), plant.n_z(), plant.n_y())?;
    let made = stages.controller.controller(&scaled)?;
    let closed_loop = plant.lower_lft(&made.controller)?;
    let count = blocks.blocks().len();
    let samples = grid
        .iter()
        .map(|&omega_rad_s| {
            let response = closed_loop.at(omega_rad_s)?;
            let bound = stages.analysis.bound(&response, blocks)?;
            let found = bound.scales.iter().filter(|d| **d > 0.0 && d.is_finite()).count();
            if found != count || bound.scales.len() != count {
                return Err(Error::StageScales { stage: "analysis", expected: count, found });
            }
            Ok(ScaleSample { omega_rad_s, response, bound })
        })
        .collect::<Result<Vec<_>, Error>>()?;
    let (mu_peak_sampled, omega_peak_rad_s) = samples.iter().fold((0.0, 0.0), |best, s| {
        if s.bound.value > best.0 { (s.bound.value, s.omega_rad_s) } else { best }
    });
    let mut proof = hinf_norm(&scaled_system(&closed_loop, blocks, scales)?)?;
    let mut proof_scales = scales.to_vec();
    let fitted = stages.fit.fit(&samples, blocks)?;
    if fitted.scales.len() != count {
        let found = fitted.scales.len();
        return Err(Error::StageScales { stage: "fit", expected: count, found });
    }
    // Any scales prove a bound; the better of the two sets does.
    let refit = hinf_norm(&scaled_system(&closed_loop, blocks, &fitted.scales)?)?;
    if refit.upper < proof.upper {
        proof = refit;
        proof_scales.clone_from(&fitted.scales);
    }
    // The claim must hold on the frequency response too; a loop on the edge of rounding may show more there.
    let mut peak = proof.upper;
    for s in &samples {
        let at: Vec<f64> = proof_scales.iter().map(|d| d.magnitude(s.omega_rad_s)).collect();
        peak = peak.max(mu_step::gain_at(&s.response, blocks, &at)?);
    }
    let iterate = DkIterate {
        scale_orders: scales.iter().map(RationalScale::order).collect(),
        controller_order: made.controller.n_states(),
        gamma: made.gamma,
        mu_peak_sampled,
        omega_peak_rad_s,
        mu_peak_proven: peak,
        fit_excess: fitted.excess,
    };
    let proven =
        Proven { controller: made.controller, closed_loop, peak, proof, scales: proof_scales, idx: 0 };
    Ok(Step { proven, iterate, next_scales: fitted.scales })
}

fn checked_grid(plant: &GeneralizedPlant, options: &DkOptions) -> Result<Vec<f64>, Error> {
    let range = |key, found, allowed| Err(Error::OutOfRange { key, found, allowed });
    if !(0.0..1.0).contains(&options.improvement_min) {
        return range("improvement_min", options.improvement_min, "from 0 to below 1");
    }
    if !(0.0..10.0).contains(&options.reduction_loss) {
        return range("reduction_loss", options.reduction_loss, "from 0 to below 10");
    }
    if options.peak_target.is_nan() {
        return range("peak_target", options.peak_target, "a number");
    }
    options.fit.check()?;
    if let Some(grid) = &options.omega_rad_s {
        if grid.is_empty() {
            return Err(Error::EmptyList { key: "omega_rad_s" });
        }
        if let Some(&bad) = grid.iter().find(|w| !(**w >= 0.0 && w.is_finite())) {
            return range("omega_rad_s", bad, "at least 0 and finite");
        }
        if let Some(pair) = grid.windows(2).find(|pair| pair[1] <= pair[0]) {
            return range("omega_rad_s", pair[1], "rising");
        }
        return Ok(grid.clone());
    }
    let sizes: Vec<f64> = plant.sys().poles()?.iter().map(|p| p.norm()).filter(|&s| s > TINY).collect();
    let low = sizes.iter().copied().fold(f64::INFINITY, f64::min);
    let high = sizes.iter().copied().fold(0.0, f64::max);
    let (low, high) = if sizes.is_empty() { (0.01, 100.0) } else { (0.1 * low, 10.0 * high) };
    let count = ((high / low).log10() * POINTS_PER_DECADE).ceil().min(POINTS_MAX);
    Ok((0..=count as usize).map(|k| low * (high / low).powf(k as f64 / count)).collect())
}

/// Adds a frequency to a rising list, unless it or a close one is there.
fn insert(grid: &mut Vec<f64>, omega: f64) {
    if !(omega > grid[0] && omega < grid[grid.len() - 1]) {
        return;
    }
    let at = grid.partition_point(|&w| w < omega);
    let near = |w: f64| (w / omega).ln().abs() < 1e-3;
    if !(at > 0 && near(grid[at - 1]) || at < grid.len() && near(grid[at])) {
        grid.insert(at, omega);
    }
}

/// Controllers in a row without progress that end the iteration.
const IDLE_MAX: usize = 4;
/// A step this much shorter than the fit proposes ends the iteration.
const STRETCH_MIN: f64 = 0.1;
/// Bound on the stretch of a step of the scales.
const STRETCH_MAX: f64 = 64.0;
/// Poles closer to the origin than this, in rad/s, say nothing about the range of frequencies.
const TINY: f64 = 1e-9;
const POINTS_PER_DECADE: f64 = 12.0;
const POINTS_MAX: f64 = 300.0;
