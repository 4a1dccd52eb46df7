//! A controller of lower order that still does its work, shown on the closed loop.

use nalgebra::DMatrix;
use telepulse_lti::reduce::{OrderRule, ReduceOptions, Removal, Weights, reduce, reduce_weighted};
use telepulse_lti::{Continuous, GeneralizedPlant, PeakGain, StateSpace, hinf_norm};

use crate::{Error, Result};

type System = StateSpace<Continuous>;

/// How a controller of lower order was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ControllerRoute {
    /// Truncation under the weights with which the loop sees an error of the controller.
    LoopWeighted(Removal),
    /// Truncation of its normalized left coprime factors; for unstable controllers as well.
    CoprimeFactors(Removal),
    /// Balanced truncation of the controller alone, its unstable modes kept.
    Unweighted(Removal),
}

/// One order that was tried.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrderTried {
    /// Number of controller states.
    pub order: usize,
    /// The route with the lowest norm at this order; `None` where no route gave a stable loop.
    pub route: Option<ControllerRoute>,
    /// H-infinity norm of the loop (its proven upper end); infinite without a stable one.
    pub norm: f64,
}

/// A controller of lower order and the evidence for it.
#[derive(Debug, Clone, PartialEq)]
pub struct ReducedController {
    /// The controller.
    pub controller: StateSpace<Continuous>,
    /// How it was found.
    pub route: ControllerRoute,
    /// Norm of the loop with the controller as it was given.
    pub norm_before: PeakGain,
    /// Norm of the loop with the reduced controller.
    pub norm: PeakGain,
    /// Largest gain of that loop on a frequency grid: the second route, never above `norm.upper`.
    pub norm_on_grid: f64,
    /// Distance of the rightmost closed-loop pole inside the left half plane, in rad/s.
    pub pole_margin_rad_s: f64,
    /// What was tried, ascending in order; the last is the one returned.
    pub tried: Vec<OrderTried>,
}

/// The controller of smallest order whose loop is stable with a norm of at most `1 + max_increase_relative` times that of the
/// loop as given.
///
/// ```text
///   z <---+---------+<--- w
///         |  plant  |            the loop must stay stable, and |w -> z| nearly what it was
///   y <---+---------+<--- u
///   +----> K -> K_r -------+
/// ```
///
/// **Method**: orders ascend from zero. Each is tried by truncation and residualisation with loop weights (`v -> z` and `w -> y` of the
/// closed loop, `v` added to `u`: to first order the closed loop changes by their product with `K_r - K` between), of
/// normalized coprime factors, and of the controller alone. No route promises a stable loop: each loop is closed with the
/// plant, its poles are computed and its norm is bracketed, then compared with a grid of singular values. The first order with a loop
/// inside the limit ends the search.
///
/// **Source**: Anderson and Liu 1989, "Controller reduction: concepts and approaches", IEEE TAC 34(8); Enns 1984; for coprime
/// factors Zhou, Doyle and Glover 1996, section 19.2.
///
/// **Accuracy**: the order is the smallest that these routes find; a search over all controllers could find a smaller one.
///
/// **Errors**: [`Error::ControllerNotReducible`] where no smaller order is good enough, with the best that was found;
/// [`Error::OutOfRange`] for a negative or infinite increase; `Unstable` where the loop as given is not stable;
/// `PortCount` where the controller does not fit.
///
/// **Example**: a pole far beyond the bandwidth of the loop is not needed.
/// ```
/// use nalgebra::dmatrix;
/// use telepulse_design::implement::reduce_controller;
/// use telepulse_lti::{Continuous, GeneralizedPlant, StateSpace, TransferFunction};
/// // z = y = x + w, x' = -x + u.
/// let sys = StateSpace::<Continuous>::new(
///     dmatrix![-1.0], dmatrix![0.0, 1.0], dmatrix![1.0; 1.0], dmatrix![1.0, 0.0; 1.0, 0.0])?;
/// let plant = GeneralizedPlant::new(sys, 1, 1, 1, 1)?;
/// let k = TransferFunction::new(&[-2e4], &[1.0, 10002.0, 2e4])?.to_state_space();
/// let small = reduce_controller(&plant, &k, 0.01)?;
/// assert!(small.controller.n_states() < k.n_states());
/// assert!(small.norm.upper <= 1.01 * small.norm_before.upper);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn reduce_controller(
    plant: &GeneralizedPlant,
    controller: &StateSpace<Continuous>,
    max_increase_relative: f64,
) -> Result<ReducedController> {
    if !(max_increase_relative >= 0.0 && max_increase_relative.is_finite()) {
        let (key, allowed) = ("max_increase_relative", "finite and not negative");
        return Err(Error::OutOfRange { key, found: max_increase_relative, allowed });
    }
    let norm_before = hinf_norm(&plant.lower_lft(controller)?)?;
    let limit = (1.0 + max_increase_relative) * norm_before.upper;
    let (before, behind) = loop_weights(plant, controller)?;
    let factors = controller.left_coprime().ok().map(|factors| factors.both);
    let mut tried = Vec::new();
    for order in 0..controller.n_states() {
        let mut best: Option<(ControllerRoute, System, PeakGain)> = None;
        for route in ROUTES {
            let candidate = match route {
                ControllerRoute::LoopWeighted(removal) => {
                    let weights = Weights { input: Some(&before), output: Some(&behind) };
                    reduce_weighted(controller, weights, OrderRule::Count(order), removal).map(|r| r.sys)
                }
                ControllerRoute::Unweighted(removal) => {
                    let options = ReduceOptions { removal, ..ReduceOptions::new(OrderRule::Count(order)) };
                    reduce(controller, &options).map(|r| r.sys)
                }
                ControllerRoute::CoprimeFactors(removal) => {
                    let Some(both) = &factors else { continue };
                    let options = ReduceOptions { removal, ..ReduceOptions::new(OrderRule::Count(order)) };
                    reduce(both, &options).and_then(|r| quotient(&r.sys, controller.n_inputs()))
                }
            };
            // A route that has no controller of this order, or whose loop has no norm, is passed over.
            let Ok(candidate) = candidate else { continue };
            let Ok(norm) = plant.lower_lft(&candidate).and_then(|closed| hinf_norm(&closed)) else {
                continue;
            };
            if best.as_ref().is_none_or(|(_, _, found)| norm.upper < found.upper) {
                best = Some((route, candidate, norm));
            }
        }
        tried.push(OrderTried {
            order: best.as_ref().map_or(order, |(_, k, _)| k.n_states()),
            route: best.as_ref().map(|(route, _, _)| *route),
            norm: best.as_ref().map_or(f64::INFINITY, |(_, _, norm)| norm.upper),
        });
        let Some((route, small, norm)) = best else { continue };
        if norm.upper <= limit {
            let closed = plant.lower_lft(&small)?;
            let right = closed.poles()?.iter().fold(f64::NEG_INFINITY, |m, p| m.max(p.re));
            let norm_on_grid = gain_on_grid(&closed, norm.omega_rad_s)?;
            if right < 0.0 && norm_on_grid <= norm.upper * (1.0 + GRID_SLACK) {
                return Ok(ReducedController {
                    controller: small,
                    route,
                    norm_before,
                    norm,
                    norm_on_grid,
                    pole_margin_rad_s: -right,
                    tried,
                });
            }
        }
    }
    let best = tried.iter().min_by(|p, q| p.norm.total_cmp(&q.norm));
    Err(Error::ControllerNotReducible {
        n_states: controller.n_states(),
        limit,
        best_order: best.map_or(0, |b| b.order),
        best_norm: best.map_or(f64::INFINITY, |b| b.norm),
    })
}

/// `w -> y` and `v -> z` of the closed loop with `u = K y + v`.
fn loop_weights(plant: &GeneralizedPlant, controller: &System) -> Result<(System, System)> {
    let sys = plant.sys();
    let (n_w, n_u, n_z, n_y) = (plant.n_w(), plant.n_u(), plant.n_z(), plant.n_y());
    // Inputs w, v, u and outputs z, y, y.
    let inputs: Vec<usize> = (0..n_w + n_u).chain(n_w..n_w + n_u).collect();
    let outputs: Vec<usize> = (0..n_z + n_y).chain(n_z..n_z + n_y).collect();
    let twice = StateSpace::with_domain(
        sys.a().clone(),
        sys.b().select_columns(&inputs),
        sys.c().select_rows(&outputs),
        sys.d().select_columns(&inputs).select_rows(&outputs),
        *sys.domain(),
    )?;
    let closed = GeneralizedPlant::new(twice, n_w + n_u, n_u, n_z + n_y, n_y)?.lower_lft(controller)?;
    let range = |first: usize, count: usize| (first..first + count).collect::<Vec<usize>>();
    let before = closed.select(&range(n_z, n_y), &range(0, n_w))?;
    let behind = closed.select(&range(0, n_z), &range(n_w, n_u))?;
    Ok((before, behind))
}

/// `M⁻¹ N` of `[N M]`.
fn quotient(both: &System, n_inputs: usize) -> std::result::Result<System, telepulse_lti::Error> {
    let n_out = both.n_outputs();
    let (b, d) = (both.b(), both.d());
    let singular = telepulse_lti::Error::Singular { matrix: "direct term of M", reciprocal_condition: 0.0 };
    let inverse: DMatrix<f64> = d.columns(n_inputs, n_out).into_owned().try_inverse().ok_or(singular)?;
    let back = b.columns(n_inputs, n_out) * &inverse;
    StateSpace::with_domain(
        both.a() - &back * both.c(),
        b.columns(0, n_inputs) - &back * d.columns(0, n_inputs),
        &inverse * both.c(),
        &inverse * d.columns(0, n_inputs),
        *both.domain(),
    )
}

/// Largest singular value on a grid over all poles and at the reported peak.
fn gain_on_grid(closed: &System, peak_rad_s: f64) -> Result<f64> {
    let sizes: Vec<f64> = closed.poles()?.iter().map(|p| p.norm()).filter(|&size| size > 0.0).collect();
    let low = 1e-2 * sizes.iter().copied().fold(f64::INFINITY, f64::min).min(1e3);
    let high = 1e2 * sizes.iter().copied().fold(0.0, f64::max).max(low);
    let steps = (0..GRID_POINTS).map(|k| low * (high / low).powf(f64::from(k) / f64::from(GRID_POINTS - 1)));
    let mut largest: f64 = 0.0;
    for omega in steps.chain(sizes.iter().copied()).chain([0.0, peak_rad_s]).filter(|w| w.is_finite()) {
        largest = largest.max(closed.at(omega)?.singular_values().max());
    }
    Ok(largest)
}

/// In this sequence: of equal norms the first stays.
const ROUTES: [ControllerRoute; 6] = [
    ControllerRoute::LoopWeighted(Removal::Truncate),
    ControllerRoute::LoopWeighted(Removal::Residualize),
    ControllerRoute::CoprimeFactors(Removal::Truncate),
    ControllerRoute::CoprimeFactors(Removal::Residualize),
    ControllerRoute::Unweighted(Removal::Truncate),
    ControllerRoute::Unweighted(Removal::Residualize),
];
const GRID_POINTS: i32 = 400;
/// Rounding of a singular value on the grid against the proven upper end.
const GRID_SLACK: f64 = 1e-9;
