//! Balanced coordinates from the factors of two Gramians.

use nalgebra::DMatrix;

use super::gramian_factor::{controllability_factor, observability_factor};
use super::jacobi_svd::{Svd, jacobi_svd};
use crate::{Error, StateSpace, TimeDomain};

/// The bases in which a reduced model is cut out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Projection {
    /// Square root where the kept Hankel singular values lie within eight decades, else balancing-free.
    #[default]
    Automatic,
    /// Balanced coordinates: both Gramians of the result are diagonal and equal.
    SquareRoot,
    /// Orthogonal bases of the same subspaces: the same response, better conditioned for nearly non-minimal systems.
    BalancingFree,
}

/// Factors of both Gramians and the singular value decomposition of their product.
pub(super) struct Balancing {
    /// `P = S Sᵀ`.
    s: DMatrix<f64>,
    /// `Q = R Rᵀ`.
    r: DMatrix<f64>,
    /// `Rᵀ S = U diag(values) Vᵀ`.
    u: DMatrix<f64>,
    v: DMatrix<f64>,
    /// Hankel singular values, descending.
    pub(super) values: Vec<f64>,
}

/// Two bases with `leftᵀ right` the identity, the first `order` columns for what is kept.
pub(super) struct Bases {
    pub(super) left: DMatrix<f64>,
    pub(super) right: DMatrix<f64>,
    pub(super) used: Projection,
}

impl Balancing {
    pub(super) fn new<D: TimeDomain>(sys: &StateSpace<D>) -> Result<Self, Error> {
        Self::from_factors(controllability_factor(sys)?, observability_factor(sys)?)
    }

    /// From any two factors with as many rows as the system has states.
    pub(super) fn from_factors(s: DMatrix<f64>, r: DMatrix<f64>) -> Result<Self, Error> {
        let Svd { u, values, v } = jacobi_svd(&r.tr_mul(&s))?;
        Ok(Self { s, r, u, v, values })
    }

    /// Number of Hankel singular values above rounding.
    pub(super) fn rank(&self) -> usize {
        let floor = self.values.first().copied().unwrap_or(0.0) * self.values.len() as f64 * f64::EPSILON;
        self.values.iter().take_while(|&&v| v > floor).count()
    }

    /// Bases for the leading `order` directions followed by those up to `count` (at most the rank).
    pub(super) fn bases(&self, order: usize, count: usize, wanted: Projection) -> Result<Bases, Error> {
        let spread = |k: usize| if k == 0 { 1.0 } else { self.values[0] / self.values[k - 1] };
        let used = match wanted {
            Projection::Automatic if spread(count) <= SPREAD_OF_SQUARE_ROOT => Projection::SquareRoot,
            Projection::Automatic => Projection::BalancingFree,
            other => other,
        };
        let (mut right, mut left) = (&self.s * self.v.columns(0, count), &self.r * self.u.columns(0, count));
        if used == Projection::SquareRoot {
            for k in 0..count {
                let scale = 1.0 / self.values[k].sqrt();
                right.column_mut(k).scale_mut(scale);
                left.column_mut(k).scale_mut(scale);
            }
            return Ok(Bases { left, right, used });
        }
        // The kept and the other directions each get an orthonormal basis; across the two the product stays zero.
        for (first, width) in [(0, order), (order, count - order)] {
            if width == 0 {
                continue;
            }
            let basis = right.columns(first, width).into_owned().qr().q();
            let dual = left.columns(first, width).into_owned().qr().q();
            let overlap = dual.tr_mul(&basis);
            let rank = overlap.clone().singular_values();
            let reciprocal_condition = rank.min() / rank.max();
            let lost = Error::Singular { matrix: "product of the projection bases", reciprocal_condition };
            // left = dual overlap^-T, so that leftᵀ right = I.
            let dual = overlap.lu().solve(&dual.transpose()).ok_or(lost)?.transpose();
            right.columns_mut(first, width).copy_from(&basis);
            left.columns_mut(first, width).copy_from(&dual);
        }
        Ok(Bases { left, right, used })
    }
}

/// Spread of kept Hankel singular values up to which balanced coordinates lose fewer than half of the digits.
const SPREAD_OF_SQUARE_ROOT: f64 = 1e8;
