//! The controller with fewer states that still proves the peak.

use telepulse_lti::reduce::{OrderRule, ReduceOptions, reduce};
use telepulse_lti::{Continuous, GeneralizedPlant, PeakGain, StateSpace, hinf_norm};

use super::blocks::FullBlocks;
use super::rational_scale::{RationalScale, scaled_system};

/// A controller of lower order, verified in the loop.
#[derive(Clone, Debug, PartialEq)]
pub struct ReducedController {
    /// The controller, `u = K y`.
    pub controller: StateSpace<Continuous>,
    /// The structured singular value of its closed loop is at or below this at every frequency.
    pub mu_peak_proven: f64,
    /// The norm of the scaled closed loop that proves it.
    pub proof: PeakGain,
}

/// The balanced truncation of least order whose loop is stable with a scaled norm of at most `allowed`.
///
/// Orders are tried from the lowest up: the norm need not fall with the order. A truncation that cannot be made or
/// judged counts as one that does not hold.
pub(super) fn reduced(
    plant: &GeneralizedPlant,
    blocks: &FullBlocks,
    scales: &[RationalScale],
    controller: &StateSpace<Continuous>,
    allowed: f64,
) -> Option<ReducedController> {
    (0..controller.n_states()).find_map(|order| {
        let small = reduce(controller, &ReduceOptions::new(OrderRule::Count(order))).ok()?.sys;
        if small.n_states() >= controller.n_states() {
            return None;
        }
        let closed = plant.lower_lft(&small).ok()?;
        let proof = hinf_norm(&scaled_system(&closed, blocks, scales).ok()?).ok()?;
        (proof.upper <= allowed).then_some(ReducedController {
            controller: small,
            mu_peak_proven: proof.upper,
            proof,
        })
    })
}
