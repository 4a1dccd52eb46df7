//! Frequency-weighted balanced truncation.

use super::balancing::{Balancing, Projection};
use super::gramian_factor::{controllability_factor, observability_factor};
use super::order::OrderRule;
use super::split::split_stable;
use super::truncation::{Removal, check_stable, remove};
use crate::{Error, PeakGain, StateSpace, TimeDomain, hinf_norm};

/// Weights of a reduction; a side without one counts every frequency alike.
#[derive(Debug, Clone, Copy)]
pub struct Weights<'a, D: TimeDomain> {
    /// Before the system: as many outputs as the system has inputs. Stable.
    pub input: Option<&'a StateSpace<D>>,
    /// Behind the system: as many inputs as the system has outputs. Stable.
    pub output: Option<&'a StateSpace<D>>,
}

/// A system that was reduced under weights.
#[derive(Debug, Clone, PartialEq)]
pub struct WeightedReduction<D: TimeDomain> {
    /// The reduced system, the kept unstable modes last.
    pub sys: StateSpace<D>,
    /// Weighted Hankel singular values of the stable part, descending. They order the states; they bound nothing.
    pub weighted_singular_values: Vec<f64>,
    /// Modes outside of the stable region, all of them kept.
    pub n_unstable_kept: usize,
    /// H-infinity norm of `W_o (G - G_r) W_i`, measured.
    pub weighted_error: PeakGain,
}

/// A reduced system whose error is least where the weights are large.
///
/// ```text
///   ---> W_i ---> G - G_r ---> W_o --->   is to be small
/// ```
///
/// **Method**: the blocks that belong to `G` in the Gramians of `G W_i` and `W_o G` take the place of its own Gramians; the
/// square-root or balancing-free projection follows.
///
/// **Source**: Enns 1984, "Model reduction with balanced realizations: an error bound and a frequency weighted
/// generalization", 23rd IEEE CDC.
///
/// **Accuracy**: with one weight the result is stable in theory; with two nothing is guaranteed, neither stability nor a bound on the
/// error. Stability is checked and the error measured, so what is returned holds. The order rule reads its limits as twice the
/// tail of the weighted values, which with weights is a habit and not a bound.
///
/// **Errors**: [`Error::Unstable`] for an unstable weight, [`Error::PortCount`] where one does not fit,
/// [`Error::ReducedUnstable`]; those of [`super::reduce()`].
///
/// **Example**: a low-pass weight saves the slow resonance, although the fast one has ten times its gain.
/// ```
/// use telepulse_lti::TransferFunction;
/// use telepulse_lti::reduce::{OrderRule, Removal, Weights, reduce_weighted};
/// let slow = TransferFunction::new(&[0.1, 0.0], &[1.0, 0.1, 1.0])?.to_state_space();
/// let fast = TransferFunction::new(&[20.0, 0.0], &[1.0, 2.0, 1e4])?.to_state_space();
/// let low = TransferFunction::new(&[1.0], &[1.0, 2.0, 1.0])?.to_state_space();
/// let weights = Weights { input: None, output: Some(&low) };
/// let done = reduce_weighted(&slow.parallel(&fast)?, weights, OrderRule::Count(2), Removal::Truncate)?;
/// assert!((done.sys.poles()?[0].norm() - 1.0).abs() < 0.05);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn reduce_weighted<D: TimeDomain>(
    sys: &StateSpace<D>,
    weights: Weights<'_, D>,
    order: OrderRule,
    removal: Removal,
) -> Result<WeightedReduction<D>, Error> {
    let parts = split_stable(sys, None)?;
    let stable = &parts.stable;
    let n = stable.n_states();
    let s = match weights.input {
        None => controllability_factor(stable)?,
        Some(weight) => {
            let factor = controllability_factor(&weight.series(stable)?)?;
            // P = rows of the factor times their transpose; QR makes them square.
            factor.rows(weight.n_states(), n).transpose().qr().r().transpose()
        }
    };
    let r = match weights.output {
        None => observability_factor(stable)?,
        Some(weight) => {
            let factor = observability_factor(&stable.series(weight)?)?;
            factor.rows(0, n).transpose().qr().r().transpose()
        }
    };
    let balancing = Balancing::from_factors(s, r)?;
    let (values, rank) = (balancing.values.clone(), balancing.rank());
    let n_kept = parts.remaining.n_states();
    let order = order.resolve(&values, rank, n_kept, 2.0)?;
    let count = if removal == Removal::Residualize { rank } else { order };
    let bases = balancing.bases(order, count, Projection::Automatic)?;
    let projected = StateSpace::with_domain(
        bases.left.tr_mul(stable.a()) * &bases.right,
        bases.left.tr_mul(stable.b()),
        stable.c() * &bases.right,
        stable.d().clone(),
        *stable.domain(),
    )?;
    let small = remove(&projected, order, removal)?;
    check_stable(&small)?;
    let mut error = stable.parallel(&small.scale(-1.0)?)?;
    if let Some(weight) = weights.input {
        error = weight.series(&error)?;
    }
    if let Some(weight) = weights.output {
        error = error.series(weight)?;
    }
    Ok(WeightedReduction {
        sys: small.parallel(&parts.remaining)?,
        weighted_singular_values: values,
        n_unstable_kept: n_kept,
        weighted_error: hinf_norm(&error)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reduce::{ReduceOptions, reduce, testing};
    use crate::{Continuous, TransferFunction};

    #[test]
    fn law_without_weights_it_is_balanced_truncation() {
        for seed in 0..20 {
            let sys = testing::discrete(seed, 6, 2, 2);
            let none = Weights { input: None, output: None };
            let weighted =
                reduce_weighted(&sys, none, OrderRule::Count(3), Removal::Truncate).expect("stable");
            let plain = reduce(&sys, &ReduceOptions::new(OrderRule::Count(3))).expect("stable");
            assert!((weighted.weighted_error.value / plain.error.value - 1.0).abs() < 1e-6, "seed {seed}");
        }
    }

    #[test]
    fn law_one_weight_keeps_stability_and_lowers_the_weighted_error_on_the_whole() {
        let weight = TransferFunction::new(&[10.0], &[1.0, 1.0]).expect("proper").to_state_space();
        let mut better = 0;
        for seed in 0..40 {
            let sys = testing::continuous(seed, 7, 1, 1);
            let weights = Weights { input: None, output: Some(&weight) };
            for order in 1..7 {
                let weighted = reduce_weighted(&sys, weights, OrderRule::Count(order), Removal::Truncate)
                    .unwrap_or_else(|e| panic!("seed {seed} order {order}: {e}"));
                let plain = reduce(&sys, &ReduceOptions::new(OrderRule::Count(order))).expect("stable");
                let error = sys.parallel(&plain.sys.scale(-1.0).expect("finite")).expect("ports");
                let plain = hinf_norm(&error.series(&weight).expect("ports")).expect("stable").value;
                better += usize::from(weighted.weighted_error.value <= plain);
            }
        }
        // A habit and not a theorem: three of four is a demand that the wrong weight on the wrong side does not meet.
        assert!(better > 180, "{better} of 240");
    }

    #[test]
    fn edge_unstable_and_ill_fitting_weights_are_refused() {
        let sys = testing::continuous(1, 3, 1, 1);
        let unstable = TransferFunction::new(&[1.0], &[1.0, -1.0]).expect("proper").to_state_space();
        let weights = Weights { input: Some(&unstable), output: None };
        let found = reduce_weighted(&sys, weights, OrderRule::Count(1), Removal::Truncate);
        assert!(matches!(found, Err(Error::Unstable { .. })), "{found:?}");
        let wide = StateSpace::<Continuous>::from_gain(nalgebra::dmatrix![1.0; 1.0]).expect("ports");
        let weights = Weights { input: Some(&wide), output: None };
        let found = reduce_weighted(&sys, weights, OrderRule::Count(1), Removal::Truncate);
        assert!(matches!(found, Err(Error::PortCount { .. })), "{found:?}");
    }
}
