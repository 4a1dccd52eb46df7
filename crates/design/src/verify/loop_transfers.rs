//! The transfer functions of a tracking loop with a filter in its measurement.

use telepulse_lti::{Continuous, StateSpace};

use super::certificate::LoopUnderTest;
use crate::Error;

/// ```text
///    r -->(+)-- e --> K -- u --> G ---+--> y
///          ^ -                        |
///          +------------- F <---------+
/// ```
///
/// Without a filter, `F = 1`. All are formed in state space, so no pole is cancelled on the way.
pub(super) struct LoopTransfers {
    /// `G K F`, the loop.
    pub(super) loop_: StateSpace<Continuous>,
    /// `S = 1 / (1 + G K F)`, from `r` to `e`.
    pub(super) s: StateSpace<Continuous>,
    /// `T = G K / (1 + G K F)`, from `r` to `y`.
    pub(super) t: StateSpace<Continuous>,
    /// `K S`, from `r` to `u`.
    pub(super) ks: StateSpace<Continuous>,
    /// `M_s = K F S`: what an additive error of the plant sees. Eq. (22) where `F = 1`.
    pub(super) ms: StateSpace<Continuous>,
}

impl LoopTransfers {
    pub(super) fn new(loop_under_test: &LoopUnderTest<'_>) -> Result<Self, Error> {
        let g = loop_under_test.plant.to_state_space();
        let k = loop_under_test.controller;
        let one = || StateSpace::<Continuous>::from_gain(nalgebra::DMatrix::identity(1, 1));
        let f = match loop_under_test.measurement_filter {
            Some(filter) => filter.to_state_space(),
            None => one()?,
        };
        let (kg, gf, fk) = (k.series(&g)?, g.series(&f)?, f.series(k)?);
        let loop_ = kg.series(&f)?;
        Ok(Self {
            s: one()?.feedback(&loop_)?,
            t: kg.feedback(&f)?,
            ks: k.feedback(&gf)?,
            ms: fk.feedback(&g)?,
            loop_,
        })
    }
}
