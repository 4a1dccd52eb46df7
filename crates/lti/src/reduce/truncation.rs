//! Balanced truncation and residualisation with their error bound.

use nalgebra::DMatrix;

use super::balancing::{Balancing, Projection};
use super::order::{OrderRule, distinct_tail};
use super::split::split_stable;
use crate::{Error, PeakGain, StateSpace, TimeDomain, hinf_norm};

/// What happens to the states that are not kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Removal {
    /// They are left out: the response is kept best at high frequencies, and exactly at infinite frequency.
    #[default]
    Truncate,
    /// They are taken as settled (singular perturbation): the gain for constant signals is kept exactly.
    Residualize,
}

/// Settings of [`reduce`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReduceOptions {
    /// How many states to keep.
    pub order: OrderRule,
    /// What happens to the others; default truncation.
    pub removal: Removal,
    /// Which bases to use; default automatic.
    pub projection: Projection,
    /// Modes on the far side of this are kept as they are: a real part in rad/s (continuous) or a modulus (discrete).
    /// Default: the stability boundary.
    pub stability_boundary: Option<f64>,
}

impl ReduceOptions {
    /// Defaults with this rule for the order.
    #[must_use]
    pub fn new(order: OrderRule) -> Self {
        Self {
            order,
            removal: Removal::Truncate,
            projection: Projection::Automatic,
            stability_boundary: None,
        }
    }
}

/// A reduced system and the evidence for it.
#[derive(Debug, Clone, PartialEq)]
pub struct Reduction<D: TimeDomain> {
    /// The reduced system: kept modes of the stable part first, then the modes kept as they are.
    pub sys: StateSpace<D>,
    /// Hankel singular values of the stable part, descending.
    pub hankel_singular_values: Vec<f64>,
    /// Modes outside of the stability boundary, all of them kept.
    pub n_unstable_kept: usize,
    /// What theory promises the H-infinity norm of the error to stay below.
    pub error_bound: f64,
    /// H-infinity norm of the error, measured on the difference of the two systems.
    pub error: PeakGain,
    /// The bases that were used.
    pub projection: Projection,
}

/// A reduced system by balanced truncation or residualisation, with the bound and the measured error.
///
/// **Shapes and units**: ports stay; the error is in the unit of the system's gain.
///
/// **Method**: unstable modes are split off and kept. Factors of the Gramians of the rest come from the method of Hammarling,
/// and the singular value decomposition of their product gives Hankel singular values and projections (square-root method), on
/// request or where the kept values spread widely from orthogonal bases of the same subspaces (balancing-free).
///
/// **Source**: Moore 1981; Tombs and Postlethwaite 1987; Varga 1991; residualisation: Liu and Anderson 1989. Bound: Enns
/// 1984, Glover 1984; discrete truncation: Al-Saggaf and Franklin 1987.
///
/// **Accuracy**: Hankel singular values to rounding of the largest. The measured error is rounded at `1e-15` of
/// the system's own norm; where its upper end cannot be proven, the bound takes its place.
///
/// **Errors**: [`Error::ReductionOrder`], [`Error::ReductionSetting`]; those of [`split_stable`]; [`Error::ReducedUnstable`] where
/// rounding lost the stability that theory promises; [`Error::Singular`] for a residualisation of states that integrate.
///
/// **Example**: a fast lag beside a slow one costs half a per cent.
/// ```
/// use telepulse_lti::TransferFunction;
/// use telepulse_lti::reduce::{OrderRule, ReduceOptions, reduce};
/// let slow = TransferFunction::new(&[1.0], &[1.0, 1.0])?.to_state_space();
/// let fast = TransferFunction::new(&[1.0], &[1.0, 100.0])?.to_state_space();
/// let done = reduce(&slow.parallel(&fast)?, &ReduceOptions::new(OrderRule::Count(1)))?;
/// assert!(done.error.upper <= done.error_bound * (1.0 + 1e-9) && done.error_bound < 0.01);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn reduce<D: TimeDomain>(sys: &StateSpace<D>, options: &ReduceOptions) -> Result<Reduction<D>, Error> {
    let parts = split_stable(sys, options.stability_boundary)?;
    let balancing = Balancing::new(&parts.stable)?;
    let (values, rank) = (balancing.values.clone(), balancing.rank());
    let n_kept = parts.remaining.n_states();
    let order = options.order.resolve(&values, rank, n_kept, 2.0)?;
    // Truncation needs the kept directions alone; settled states are computed from all that count.
    let count = if options.removal == Removal::Residualize { rank } else { order };
    let bases = balancing.bases(order, count, options.projection)?;
    let stable = &parts.stable;
    let (a, b, c) = (
        bases.left.tr_mul(stable.a()) * &bases.right,
        bases.left.tr_mul(stable.b()),
        stable.c() * &bases.right,
    );
    let projected = StateSpace::with_domain(a, b, c, stable.d().clone(), *stable.domain())?;
    let small = remove(&projected, order, options.removal)?;
    check_stable(&small)?;
    let error_bound = 2.0 * distinct_tail(&values, order);
    let error = measured_error(stable, &small, error_bound)?;
    Ok(Reduction {
        sys: small.parallel(&parts.remaining)?,
        hankel_singular_values: values,
        n_unstable_kept: n_kept,
        error_bound,
        error,
        projection: bases.used,
    })
}

/// The Hankel singular values of a stable system, descending.
///
/// **Method**: as in [`reduce()`], without forming a Gramian.
///
/// **Accuracy**: to rounding of the largest.
///
/// **Errors**: [`Error::Unstable`], [`Error::EigenvaluesNotConverged`].
///
/// **Example**
/// ```
/// use telepulse_lti::{TransferFunction, reduce::hankel_singular_values};
/// let lag = TransferFunction::new(&[1.0], &[1.0, 1.0])?.to_state_space();
/// assert!((hankel_singular_values(&lag)?[0] - 0.5).abs() < 1e-15);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn hankel_singular_values<D: TimeDomain>(sys: &StateSpace<D>) -> Result<Vec<f64>, Error> {
    Ok(Balancing::new(sys)?.values)
}

/// Leaves out or settles the states from `order` on.
pub(super) fn remove<D: TimeDomain>(
    sys: &StateSpace<D>,
    order: usize,
    removal: Removal,
) -> Result<StateSpace<D>, Error> {
    let n_gone = sys.n_states() - order;
    let (a, b, c) = (sys.a(), sys.b(), sys.c());
    let a11 = a.view((0, 0), (order, order)).into_owned();
    let (b1, c1) = (b.rows(0, order).into_owned(), c.columns(0, order).into_owned());
    if removal == Removal::Truncate || n_gone == 0 {
        return StateSpace::with_domain(a11, b1, c1, sys.d().clone(), *sys.domain());
    }
    // Settled: 0 = A21 x1 + A22 x2 + B2 u, or x2 = A21 x1 + A22 x2 + B2 u in discrete time.
    let mut settled = -a.view((order, order), (n_gone, n_gone));
    if sys.domain().sample_time_of().is_some() {
        settled += DMatrix::<f64>::identity(n_gone, n_gone);
    }
    let singular = settled.clone().singular_values();
    let reciprocal_condition = singular.min() / singular.max();
    let lost = Error::Singular { matrix: "dynamics of the removed states", reciprocal_condition };
    if reciprocal_condition.is_nan() || reciprocal_condition < f64::EPSILON {
        return Err(lost);
    }
    let lu = settled.lu();
    let x = lu.solve(&a.view((order, 0), (n_gone, order)).into_owned()).ok_or(lost.clone())?;
    let u = lu.solve(&b.rows(order, n_gone).into_owned()).ok_or(lost)?;
    let (a12, c2) = (a.view((0, order), (order, n_gone)), c.columns(order, n_gone));
    StateSpace::with_domain(a11 + a12 * &x, b1 + a12 * &u, c1 + c2 * x, sys.d() + c2 * u, *sys.domain())
}

pub(super) fn check_stable<D: TimeDomain>(sys: &StateSpace<D>) -> Result<(), Error> {
    match sys.poles()?.into_iter().find(|&p| !sys.domain().is_stable_pole(p)) {
        Some(pole) => Err(Error::ReducedUnstable { order: sys.n_states(), pole }),
        None => Ok(()),
    }
}

/// The norm of the difference of two stable systems. Where it cannot be bounded from above by itself, `bound` does so.
pub(super) fn measured_error<D: TimeDomain>(
    full: &StateSpace<D>,
    small: &StateSpace<D>,
    bound: f64,
) -> Result<PeakGain, Error> {
    match hinf_norm(&full.parallel(&small.scale(-1.0)?)?) {
        Err(Error::PeakNotBounded { lower, .. }) => {
            Ok(PeakGain { value: lower, omega_rad_s: 0.0, lower, upper: bound.max(lower) })
        }
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reduce::testing;
    use crate::{Continuous, TransferFunction};

    fn every_way() -> impl Iterator<Item = (Removal, Projection)> {
        [Removal::Truncate, Removal::Residualize]
            .into_iter()
            .flat_map(|removal| [Projection::SquareRoot, Projection::BalancingFree].map(|p| (removal, p)))
    }

    fn check<D: TimeDomain>(name: &str, sys: &StateSpace<D>) {
        let scale = hinf_norm(sys).expect("stable").value;
        for order in 0..=sys.n_states() {
            let mut responses = Vec::new();
            for (removal, projection) in every_way() {
                let options =
                    ReduceOptions { removal, projection, ..ReduceOptions::new(OrderRule::Count(order)) };
                let done = reduce(sys, &options).unwrap_or_else(|e| panic!("{name} order {order}: {e}"));
                // Rounding of the two systems whose difference is measured.
                let rounding = 1e-11 * scale;
                assert!(
                    done.error.value <= done.error_bound * (1.0 + 1e-12) + rounding,
                    "{name} order {order} {removal:?} {projection:?}: {:?} above {:e}",
                    done.error,
                    done.error_bound
                );
                // No system of this order can be closer than the next Hankel singular value.
                let next = done.hankel_singular_values.get(order).copied().unwrap_or(0.0);
                assert!(done.error.value >= next * (1.0 - 1e-9) - rounding, "{name} order {order}");
                if removal == Removal::Residualize {
                    let off = (done.sys.dc_gain().expect("stable") - sys.dc_gain().expect("stable")).norm();
                    assert!(off < 1e-10 * scale, "{name} order {order}: gain at rest off by {off:e}");
                }
                responses.push([0.1, 3.0, 40.0].map(|omega| done.sys.at(omega).expect("stable")));
            }
            for (one, other) in [(0, 1), (2, 3)] {
                for (x, y) in responses[one].iter().zip(&responses[other]) {
                    assert!((x - y).norm() < 1e-9 * scale, "{name} order {order}: bases change the response");
                }
            }
        }
    }

    #[test]
    fn law_errors_stay_below_the_bound_on_random_systems() {
        for seed in 0..30 {
            let n = 1 + seed as usize % 8;
            check(
                &format!("continuous seed {seed}"),
                &testing::continuous(seed, n, 1 + seed as usize % 3, 2),
            );
            check(&format!("discrete seed {seed}"), &testing::discrete(seed, n, 1 + seed as usize % 3, 2));
        }
    }

    #[test]
    fn law_a_similarity_changes_nothing() {
        for seed in 0..20 {
            let sys = testing::continuous(seed, 6, 2, 2);
            let t = testing::continuous(seed + 500, 6, 6, 6).b() + DMatrix::identity(6, 6) * 3.0;
            let inverse = t.clone().try_inverse().expect("diagonally heavy");
            let moved = StateSpace::<Continuous>::new(
                &inverse * sys.a() * &t,
                &inverse * sys.b(),
                sys.c() * &t,
                sys.d().clone(),
            )
            .expect("shapes");
            let options = ReduceOptions::new(OrderRule::Count(3));
            let (p, q) = (reduce(&sys, &options).expect("stable"), reduce(&moved, &options).expect("stable"));
            for (x, y) in p.hankel_singular_values.iter().zip(&q.hankel_singular_values) {
                assert!((x - y).abs() < 1e-10 * p.hankel_singular_values[0], "seed {seed}: {x:e} {y:e}");
            }
            assert!(
                (p.sys.at(2.0).expect("stable") - q.sys.at(2.0).expect("stable")).norm() < 1e-8,
                "seed {seed}"
            );
        }
    }

    #[test]
    fn law_a_system_that_is_not_minimal_is_reduced_exactly() {
        for seed in 0..20 {
            let small = testing::continuous(seed, 4, 2, 2);
            // The same system twice, halved: eight states, order four.
            let twice = small.scale(0.5).expect("finite");
            let doubled = twice.parallel(&twice).expect("ports");
            for rule in [OrderRule::LargestGap, OrderRule::RelativeErrorAtMost(1e-10), OrderRule::Count(8)] {
                let done = reduce(&doubled, &ReduceOptions::new(rule)).expect("stable");
                if rule != OrderRule::Count(8) {
                    assert_eq!(done.sys.n_states(), 4, "seed {seed} {rule:?}");
                }
                assert!(
                    done.error.value < 1e-11 * done.hankel_singular_values[0],
                    "seed {seed} {rule:?}: {:?}",
                    done.error
                );
            }
        }
    }

    #[test]
    fn law_unstable_modes_are_kept() {
        let unstable = TransferFunction::new(&[3.0], &[1.0, -2.0]).expect("proper").to_state_space();
        let integrator = TransferFunction::new(&[1.0], &[1.0, 0.0]).expect("proper").to_state_space();
        let stable = testing::continuous(3, 5, 1, 1);
        let sys = stable.parallel(&unstable).and_then(|s| s.parallel(&integrator)).expect("ports");
        let done = reduce(&sys, &ReduceOptions::new(OrderRule::Count(4))).expect("split");
        assert_eq!((done.n_unstable_kept, done.sys.n_states()), (2, 4));
        let far = done.sys.poles().expect("poles").iter().filter(|p| p.re > -1e-9).count();
        assert_eq!(far, 2);
        for omega in [0.5, 5.0, 50.0] {
            let off = (done.sys.at(omega).expect("no pole") - sys.at(omega).expect("no pole")).norm();
            assert!(off <= done.error_bound * (1.0 + 1e-9), "{off} at {omega}");
        }
        assert!(matches!(
            reduce(&sys, &ReduceOptions::new(OrderRule::Count(1))),
            Err(Error::ReductionOrder { min: 2, max: 7, found: 1 })
        ));
    }

    #[test]
    fn law_equal_hankel_values_are_counted_once_in_the_bound() {
        // Two equal all-pass-like sections side by side: values come in pairs, and the bound is that of one.
        let one = testing::continuous(7, 4, 1, 1);
        let two = one.augment(&one).expect("same time");
        let single = reduce(&one, &ReduceOptions::new(OrderRule::Count(2))).expect("stable");
        let pair = reduce(&two, &ReduceOptions::new(OrderRule::Count(4))).expect("stable");
        assert!((single.error_bound - pair.error_bound).abs() < 1e-10 * single.error_bound);
        assert!(pair.error.upper <= pair.error_bound * (1.0 + 1e-9));
    }

    #[test]
    fn edge_badly_scaled_nearly_cancelled_and_empty() {
        // Poles and residues over 18 decades.
        let mut sys = TransferFunction::new(&[1.0], &[1.0, 1.0]).expect("proper").to_state_space();
        for k in 1..7 {
            let pole = 10f64.powi(3 * k);
            let term = TransferFunction::new(&[pole * 10f64.powi(-2 * k)], &[1.0, pole])
                .expect("proper")
                .to_state_space();
            sys = sys.parallel(&term).expect("ports");
        }
        for (removal, projection) in every_way() {
            let options = ReduceOptions { removal, projection, ..ReduceOptions::new(OrderRule::Count(3)) };
            let done = reduce(&sys, &options).expect("stable");
            assert!(
                done.error.upper <= done.error_bound * (1.0 + 1e-6),
                "{removal:?} {projection:?}: {:?} {:e}",
                done.error,
                done.error_bound
            );
        }
        let gain = StateSpace::<Continuous>::from_gain(nalgebra::dmatrix![2.0]).expect("port");
        let done = reduce(&gain, &ReduceOptions::new(OrderRule::LargestGap)).expect("nothing to do");
        assert_eq!((done.sys.n_states(), done.error_bound, done.error.upper), (0, 0.0, 0.0));
        let silent = StateSpace::<Continuous>::new(
            nalgebra::dmatrix![-1.0],
            nalgebra::dmatrix![0.0],
            nalgebra::dmatrix![1.0],
            nalgebra::dmatrix![0.5],
        )
        .expect("shapes");
        assert_eq!(
            reduce(&silent, &ReduceOptions::new(OrderRule::Count(1))).expect("nothing seen").sys.n_states(),
            0
        );
    }
}
