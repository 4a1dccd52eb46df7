//! How many states to keep, and what the tail costs.

use crate::Error;

/// How the order of a reduced system is chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum OrderRule {
    /// This many states, the modes that are kept in any case among them. Where the numerical rank of the Gramians is
    /// lower, so is the order.
    Count(usize),
    /// The fewest states for which the error bound is at most this, in the unit of the system's gain.
    ErrorAtMost(f64),
    /// The fewest states for which the error bound is at most this times the largest Hankel singular value.
    RelativeErrorAtMost(f64),
    /// Where the ratio of neighbouring Hankel singular values is largest.
    LargestGap,
}

/// Sum of the Hankel singular values from index `first` on, those equal to rounding counted once.
///
/// **Source**: Glover 1984, theorem 9.6; Enns 1984. Twice this bounds the error of balanced truncation and of
/// residualisation, once this bounds that of optimal Hankel-norm approximation with the right direct term.
#[must_use]
pub fn distinct_tail(hankel_singular_values: &[f64], first: usize) -> f64 {
    let mut sum = 0.0;
    // A value that belongs to a group begun before `first` is a group of its own here.
    let mut last = f64::INFINITY;
    for &value in hankel_singular_values.iter().skip(first) {
        if value < last * (1.0 - EQUAL) || last.is_infinite() {
            sum += value;
            last = value;
        }
    }
    sum
}

impl OrderRule {
    /// The number of states of the stable part to keep.
    ///
    /// `rank` is the number of values above rounding, `n_kept` that of modes outside of the stable part, `factor` what the
    /// tail is multiplied by to give the bound.
    pub(super) fn resolve(
        self,
        values: &[f64],
        rank: usize,
        n_kept: usize,
        factor: f64,
    ) -> Result<usize, Error> {
        let bounded = |limit: f64| {
            (0..rank).find(|&order| factor * distinct_tail(values, order) <= limit).unwrap_or(rank)
        };
        let check = |setting, found: f64| {
            let allowed = "finite and not negative";
            if found >= 0.0 && found.is_finite() {
                Ok(found)
            } else {
                Err(Error::ReductionSetting { setting, found, allowed })
            }
        };
        match self {
            Self::Count(found) => {
                let max = n_kept + values.len();
                if found < n_kept || found > max {
                    return Err(Error::ReductionOrder { found, min: n_kept, max });
                }
                Ok((found - n_kept).min(rank))
            }
            Self::ErrorAtMost(limit) => Ok(bounded(check("error bound", limit)?)),
            Self::RelativeErrorAtMost(limit) => {
                let largest = values.first().copied().unwrap_or(0.0);
                Ok(bounded(check("relative error bound", limit)? * largest))
            }
            Self::LargestGap => {
                // The last gap is to the first value below rounding, or to the rounding itself.
                let floor = values.first().copied().unwrap_or(0.0) * f64::EPSILON;
                let next = |k: usize| values.get(k).copied().unwrap_or(0.0).max(floor);
                let ratio = |k: usize| values[k - 1] / next(k);
                Ok((1..=rank).max_by(|&p, &q| ratio(p).total_cmp(&ratio(q)).then(q.cmp(&p))).unwrap_or(0))
            }
        }
    }
}

/// Relative difference below which two Hankel singular values are one: their own accuracy.
pub(super) const EQUAL: f64 = 1e-12;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_equal_values_count_once() {
        assert_eq!(distinct_tail(&[4.0, 2.0, 2.0, 1.0], 1), 3.0);
        assert_eq!(distinct_tail(&[4.0, 2.0, 2.0, 1.0], 4), 0.0);
    }

    #[test]
    fn law_every_rule_finds_its_order() {
        let values = [10.0, 8.0, 0.1, 0.05, 1e-18];
        let order = |rule: OrderRule| rule.resolve(&values, 4, 0, 2.0).expect("allowed");
        assert_eq!(order(OrderRule::Count(3)), 3);
        assert_eq!(order(OrderRule::Count(5)), 4);
        assert_eq!(order(OrderRule::ErrorAtMost(0.31)), 2);
        assert_eq!(order(OrderRule::RelativeErrorAtMost(0.02)), 3);
        assert_eq!(order(OrderRule::ErrorAtMost(0.0)), 4);
        // 0.05 to rounding at 10 eps is the largest gap of all.
        assert_eq!(order(OrderRule::LargestGap), 4);
        assert_eq!(OrderRule::LargestGap.resolve(&[10.0, 8.0, 0.1, 0.05], 3, 0, 2.0).expect("allowed"), 2);
        assert_eq!(OrderRule::LargestGap.resolve(&[], 0, 0, 2.0).expect("allowed"), 0);
    }

    #[test]
    fn edge_orders_and_limits_out_of_range() {
        assert!(matches!(
            OrderRule::Count(6).resolve(&[1.0; 3], 3, 2, 2.0),
            Err(Error::ReductionOrder { max: 5, .. })
        ));
        assert!(matches!(
            OrderRule::Count(1).resolve(&[1.0; 3], 3, 2, 2.0),
            Err(Error::ReductionOrder { min: 2, .. })
        ));
        assert!(OrderRule::ErrorAtMost(f64::NAN).resolve(&[1.0], 1, 0, 2.0).is_err());
        assert!(OrderRule::RelativeErrorAtMost(-1.0).resolve(&[1.0], 1, 0, 2.0).is_err());
    }
}
