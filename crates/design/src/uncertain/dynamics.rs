//! Unmodelled dynamics around a plant, as large as a weight says.

use nalgebra::DMatrix;
use telepulse_lti::{Continuous, StateSpace, Wiring};

use super::structure::{Block, BlockStructure};
use super::system::UncertainSystem;
use crate::Error;

/// Where unmodelled dynamics act; `Delta` is any stable system with an H-infinity norm of at most one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UncertainDynamics {
    /// `G + Delta W`.
    Additive,
    /// `G (I + Delta W)`: actuators.
    InputMultiplicative,
    /// `(I + Delta W) G`: sensors, and dead time.
    OutputMultiplicative,
}

impl UncertainSystem {
    /// A plant with unmodelled dynamics and nothing else that is uncertain.
    ///
    /// **Shapes**: `weight` has as many inputs as the signals that it weighs: those of the plant's inputs (additive, input) or outputs. One with a
    /// single input and output serves every channel. Its outputs are the columns of the block.
    ///
    /// **Errors**: [`Error::WeightNotStable`], [`telepulse_lti::Error::PortCount`].
    ///
    /// **Example**: a lag whose gain at high frequencies is not known.
    /// ```
    /// use telepulse_design::uncertain::{UncertainDynamics, UncertainSystem};
    /// use telepulse_lti::TransferFunction;
    /// let g = TransferFunction::new(&[1.0], &[1.0, 1.0])?.to_state_space();
    /// let w = TransferFunction::new(&[2.0, 1.0], &[1.0, 10.0])?.to_state_space();
    /// let plant = UncertainSystem::with_dynamics(&g, &w, UncertainDynamics::InputMultiplicative)?;
    /// // |W T| peaks below 1 for a small gain: the loop is robust.
    /// let k = TransferFunction::from_gain(0.5)?.to_state_space();
    /// let margin = plant.feedback(&k)?.robust_stability_margin(1e-4)?;
    /// assert!(margin.lower > 1.0);
    /// # Ok::<(), telepulse_design::Error>(())
    /// ```
    pub fn with_dynamics(
        plant: &StateSpace<Continuous>,
        weight: &StateSpace<Continuous>,
        place: UncertainDynamics,
    ) -> Result<Self, Error> {
        let (m, block) = surrounded(plant, (0, 0), weight, place)?;
        Self::new(m, BlockStructure::new(vec![block])?)
    }

    /// This system with unmodelled dynamics besides; their block comes last.
    ///
    /// **Shapes** and **Errors**: as [`Self::with_dynamics`], for the ports that are not closed by blocks.
    pub fn and_dynamics(
        &self,
        weight: &StateSpace<Continuous>,
        place: UncertainDynamics,
    ) -> Result<Self, Error> {
        let structure = self.structure();
        let (m, block) = surrounded(self.m(), (structure.n_w(), structure.n_z()), weight, place)?;
        Self::new(m, structure.followed_by(&BlockStructure::new(vec![block])?))
    }

    /// The loop with the controller `K`, `u = K (r - y)`: from `r` to `y`, with the same blocks.
    ///
    /// ```text
    ///              +---- Delta <----+
    ///              |                |
    ///   r -->(+)-- K -- u -->  M  --+--> y
    ///         ^-                    |
    ///         +---------------------+
    /// ```
    ///
    /// **Errors**: [`telepulse_lti::Error::PortCount`] unless the ports of `k` mirror those of this system,
    /// [`telepulse_lti::Error::AlgebraicLoop`].
    pub fn feedback(&self, k: &StateSpace<Continuous>) -> Result<Self, Error> {
        let (n_w, n_z) = (self.structure().n_w(), self.structure().n_z());
        let (n_u, n_y) = (self.m().n_inputs() - n_w, self.m().n_outputs() - n_z);
        check_count("the feedback of an uncertain system", "inputs", n_y, k.n_inputs())?;
        check_count("the feedback of an uncertain system", "outputs", n_u, k.n_outputs())?;
        // Inputs (w, u, e), outputs (z, y, output of K): u is K's output, e = r - y.
        let mut feedback = DMatrix::zeros(n_w + n_u + n_y, n_z + n_y + n_u);
        feedback.view_mut((n_w, n_z + n_y), (n_u, n_u)).fill_with_identity();
        feedback.view_mut((n_w + n_u, n_z), (n_y, n_y)).copy_from(&-DMatrix::identity(n_y, n_y));
        let mut external = DMatrix::zeros(n_w + n_u + n_y, n_w + n_y);
        external.view_mut((0, 0), (n_w, n_w)).fill_with_identity();
        external.view_mut((n_w + n_u, n_w), (n_y, n_y)).fill_with_identity();
        let outputs = DMatrix::identity(n_z + n_y, n_z + n_y + n_u);
        let m = self.m().augment(k)?.close_loop(&Wiring { feedback, external, outputs })?;
        Self::new(m, self.structure().clone())
    }
}

/// `M` with the ports of one more block behind those of the `n_w` inputs and `n_z` outputs of its blocks.
fn surrounded(
    m: &StateSpace<Continuous>,
    (n_w, n_z): (usize, usize),
    weight: &StateSpace<Continuous>,
    place: UncertainDynamics,
) -> Result<(StateSpace<Continuous>, Block), Error> {
    if let Some(&pole) = weight.poles()?.iter().find(|pole| pole.re >= 0.0) {
        return Err(Error::WeightNotStable { weight: "of the unmodelled dynamics", pole });
    }
    let (n_u, n_y) = (m.n_inputs() - n_w, m.n_outputs() - n_z);
    let n_seen = if place == UncertainDynamics::OutputMultiplicative { n_y } else { n_u };
    let n_added = if place == UncertainDynamics::InputMultiplicative { n_u } else { n_y };
    let mut all = weight.clone();
    if (weight.n_inputs(), weight.n_outputs()) == (1, 1) {
        for _ in 1..n_seen {
            all = all.augment(weight)?;
        }
    }
    check_count("unmodelled dynamics", "inputs of the weight", n_seen, all.n_inputs())?;
    let n_q = all.n_outputs();
    // Inputs (w of the blocks, u of M, input of W, input of I), outputs (z, y of M, output of W, output of I).
    let (v_u, v_seen) = (n_w, n_w + n_u);
    let v_one = v_seen + n_seen;
    let (y_y, y_q) = (n_z, n_z + n_y);
    let y_one = y_q + n_q;
    let one = StateSpace::<Continuous>::from_gain(DMatrix::identity(n_added, n_added))?;
    let system = m.augment(&all)?.augment(&one)?;
    let mut feedback = DMatrix::zeros(v_one + n_added, y_one + n_added);
    // External inputs (w, w of the new block, u).
    let mut external = DMatrix::zeros(v_one + n_added, n_w + n_added + n_u);
    external.view_mut((0, 0), (n_w, n_w)).fill_with_identity();
    external.view_mut((v_u, n_w + n_added), (n_u, n_u)).fill_with_identity();
    external.view_mut((v_one, n_w), (n_added, n_added)).fill_with_identity();
    // External outputs (z, z of the new block, y).
    let mut outputs = DMatrix::zeros(n_z + n_q + n_y, y_one + n_added);
    outputs.view_mut((0, 0), (n_z, n_z)).fill_with_identity();
    outputs.view_mut((n_z, y_q), (n_q, n_q)).fill_with_identity();
    outputs.view_mut((n_z + n_q, y_y), (n_y, n_y)).fill_with_identity();
    if place == UncertainDynamics::OutputMultiplicative {
        feedback.view_mut((v_seen, y_y), (n_y, n_y)).fill_with_identity();
    } else {
        external.view_mut((v_seen, n_w + n_added), (n_u, n_u)).fill_with_identity();
    }
    if place == UncertainDynamics::InputMultiplicative {
        feedback.view_mut((v_u, y_one), (n_u, n_u)).fill_with_identity();
    } else {
        outputs.view_mut((n_z + n_q, y_one), (n_y, n_y)).fill_with_identity();
    }
    let closed = system.close_loop(&Wiring { feedback, external, outputs })?;
    Ok((closed, Block::Full { rows: n_added, cols: n_q }))
}

fn check_count(
    operation: &'static str,
    port: &'static str,
    expected: usize,
    found: usize,
) -> Result<(), Error> {
    if expected == found {
        return Ok(());
    }
    Err(telepulse_lti::Error::PortCount { operation, port, expected, found }.into())
}
