//! The generalized plant of the S/KS (and S/KS/T) mixed-sensitivity problem.

use nalgebra::DMatrix;
use telepulse_lti::{Continuous, GeneralizedPlant, StateSpace, TransferFunction};

use crate::Error;

/// Weights of a mixed-sensitivity problem; all proper and stable.
#[derive(Clone, Copy, Debug)]
pub struct MixedSensitivityWeights<'a> {
    /// `W_e`, on the tracking error: `1 / |W_e|` is the shape that `S` should stay under. Eq. (20).
    pub we: &'a TransferFunction,
    /// `W_u`, on the control input: `1 / |W_u|` is the shape that `K S` should stay under. Eq. (19).
    pub wu: &'a TransferFunction,
    /// `W_t`, on the plant's output: `1 / |W_t|` is the shape that `T` should stay under. Not in the paper.
    pub wt: Option<&'a TransferFunction>,
}

/// Returns the generalized plant with `w = r`, `z = [W_e e; W_u u; W_t G u]` and `y = e = r - G u`.
///
/// ```text
///              +-----------------------------> W_e --> z1
///    w = r     |  e
///   ---->(+)---+--------------------------------------> y
///         ^ -
///         |              +-------------------> W_t --> z3 (if given)
///         +---- G <------+ (output of G)
///               ^
///    u ---------+----------------------------> W_u --> z2
/// ```
///
/// **Shapes and units**: one reference, one control input, one measured output; the norm of the closed loop from `w` to `z`
/// is that of `[W_e S; W_u K S; W_t T]`. States: those of `G`, `W_e`, `W_u`, `W_t`, each once. A plant written with a
/// separate `G` behind every weight has modes that no controller reaches.
///
/// **Source**: Skogestad and Postlethwaite 2005, section 9.3.5; weights as in Eqs. (19) and (20), whose roles the text
/// around figure 10 exchanges.
///
/// **Errors**: [`Error::WeightNotStable`] for a weight with a pole on the closed right half plane. (An improper weight
/// cannot be built: [`TransferFunction::new`] refuses it and names both degrees.)
///
/// **Example**
/// ```
/// use telepulse_design::synthesize::{MixedSensitivityWeights, mixed_sensitivity};
/// use telepulse_lti::TransferFunction;
/// let g = TransferFunction::new(&[1.0], &[1.0, 1.0])?;
/// let we = TransferFunction::new(&[0.5, 1.0], &[1.0, 0.001])?;
/// let wu = TransferFunction::new(&[0.1], &[1.0])?;
/// let plant = mixed_sensitivity(&g, &MixedSensitivityWeights { we: &we, wu: &wu, wt: None })?;
/// assert_eq!(plant.n_states(), 2);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn mixed_sensitivity(
    plant: &TransferFunction,
    weights: &MixedSensitivityWeights<'_>,
) -> Result<GeneralizedPlant, Error> {
    let named = [("W_e", Some(weights.we)), ("W_u", Some(weights.wu)), ("W_t", weights.wt)];
    for (weight, tf) in named.into_iter().filter_map(|(name, tf)| tf.map(|tf| (name, tf))) {
        if let Some(&pole) = tf.poles()?.iter().find(|pole| pole.re >= 0.0) {
            return Err(Error::WeightNotStable { weight, pole });
        }
    }
    let g = plant.to_state_space();
    let we = weights.we.to_state_space();
    let wu = weights.wu.to_state_space();
    let wt = weights.wt.map(TransferFunction::to_state_space);

    let n_z = 2 + usize::from(wt.is_some());
    let n_wt = wt.as_ref().map_or(0, StateSpace::n_states);
    let (n_g, n_we, n_wu) = (g.n_states(), we.n_states(), wu.n_states());
    let n = n_g + n_we + n_wu + n_wt;
    let (at_we, at_wu, at_wt) = (n_g, n_g + n_we, n_g + n_we + n_wu);
    let mut a = DMatrix::zeros(n, n);
    let mut b = DMatrix::zeros(n, 2);
    let mut c = DMatrix::zeros(n_z + 1, n);
    let mut d = DMatrix::zeros(n_z + 1, 2);
    let (dg, dwe, dwu) = (g.d()[(0, 0)], we.d()[(0, 0)], wu.d()[(0, 0)]);

    // x_g' = A_g x_g + B_g u
    a.view_mut((0, 0), (n_g, n_g)).copy_from(g.a());
    b.view_mut((0, 1), (n_g, 1)).copy_from(g.b());
    // x_we' = A_we x_we + B_we e, with e = r - C_g x_g - D_g u
    a.view_mut((at_we, at_we), (n_we, n_we)).copy_from(we.a());
    a.view_mut((at_we, 0), (n_we, n_g)).copy_from(&(-we.b() * g.c()));
    b.view_mut((at_we, 0), (n_we, 1)).copy_from(we.b());
    b.view_mut((at_we, 1), (n_we, 1)).copy_from(&(-we.b() * dg));
    // x_wu' = A_wu x_wu + B_wu u
    a.view_mut((at_wu, at_wu), (n_wu, n_wu)).copy_from(wu.a());
    b.view_mut((at_wu, 1), (n_wu, 1)).copy_from(wu.b());
    // z1 = C_we x_we + D_we e
    c.view_mut((0, 0), (1, n_g)).copy_from(&(g.c() * -dwe));
    c.view_mut((0, at_we), (1, n_we)).copy_from(we.c());
    d[(0, 0)] = dwe;
    d[(0, 1)] = -dwe * dg;
    // z2 = C_wu x_wu + D_wu u
    c.view_mut((1, at_wu), (1, n_wu)).copy_from(wu.c());
    d[(1, 1)] = dwu;
    // z3 = C_wt x_wt + D_wt G u
    if let Some(wt) = &wt {
        let dwt = wt.d()[(0, 0)];
        a.view_mut((at_wt, at_wt), (n_wt, n_wt)).copy_from(wt.a());
        a.view_mut((at_wt, 0), (n_wt, n_g)).copy_from(&(wt.b() * g.c()));
        b.view_mut((at_wt, 1), (n_wt, 1)).copy_from(&(wt.b() * dg));
        c.view_mut((2, 0), (1, n_g)).copy_from(&(g.c() * dwt));
        c.view_mut((2, at_wt), (1, n_wt)).copy_from(wt.c());
        d[(2, 1)] = dwt * dg;
    }
    // y = e
    c.view_mut((n_z, 0), (1, n_g)).copy_from(&-g.c());
    d[(n_z, 0)] = 1.0;
    d[(n_z, 1)] = -dg;

    let sys = StateSpace::<Continuous>::new(a, b, c, d)?;
    Ok(GeneralizedPlant::new(sys, 1, 1, n_z, 1)?)
}
