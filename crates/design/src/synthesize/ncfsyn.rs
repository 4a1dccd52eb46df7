//! Loop shaping with robust stabilization of normalized coprime factors (Glover and McFarlane).

use nalgebra::DMatrix;
use num_complex::Complex64;
use telepulse_lti::coprime::CoprimeRiccati;
use telepulse_lti::{Continuous, Diagram, PeakGain, StateSpace, TimeDomain, hinf_norm};

use super::mixed_sensitivity::repeated;
use crate::Error;

/// How much uncertainty of its coprime factors a loop bears.
#[derive(Clone, Debug, PartialEq)]
pub struct NcfMargin {
    /// `b(G, K)`, between 0 and 1: the loop stays stable for every perturbation `||[dN dM]|| < b`.
    pub margin: f64,
    /// The norm whose reciprocal is the margin, as a bracket.
    pub norm: PeakGain,
    /// Poles of the loop, all stable.
    pub closed_loop_poles: Vec<Complex64>,
}

/// Returns `b(G, K) = 1 / || [I; K] (I + G K)⁻¹ [I G] ||` of a loop with negative feedback.
///
/// ```text
///    w1                w2
///    |    e        u -  |
///   (+)------> K ---->(+)---> G ---+      from (w1, w2) to (e, u)
///    ^                             |
///    +-----------------------------+
/// ```
///
/// **Shapes and units**: `G: n_y × n_u`, `K: n_u × n_y`, both in the units in which they were shaped: the margin depends on them. A
/// margin `b` guarantees, for a loop with one input, a gain margin of `(1 + b) / (1 - b)` and a phase margin of `2 asin(b)`: 0.3
/// stands for 1.86 and 35 degrees.
///
/// **Method**: the four functions in one system with the states of `G` and `K` once; [`hinf_norm()`].
///
/// **Source**: McFarlane and Glover 1990; Vinnicombe 2001, section 2.3.
///
/// **Errors**: [`Error::UnstableLoop`]; those of the connection where the ports do not fit.
///
/// **Example**: for `G = 1 / s` and `K = 1`, `[1; 1] (s + 1)⁻¹ [s 1]` has the gain `sqrt(2)` everywhere.
/// ```
/// use telepulse_design::synthesize::ncfmargin;
/// use telepulse_lti::TransferFunction;
/// let g = TransferFunction::new(&[1.0], &[1.0, 0.0])?.to_state_space();
/// let k = TransferFunction::from_gain(1.0)?.to_state_space();
/// assert!((ncfmargin(&g, &k)?.margin - 0.5f64.sqrt()).abs() < 1e-9);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn ncfmargin<D: TimeDomain>(
    plant: &StateSpace<D>,
    controller: &StateSpace<D>,
) -> Result<NcfMargin, Error> {
    let (n_y, n_u) = (plant.n_outputs(), plant.n_inputs());
    let loop_ = Diagram::new()
        .external_inputs([("w1", n_y), ("w2", n_u)])
        .sum("v = w2 - u")
        .sum("e = w1 + y")
        .block(plant, ["v"], [("y", n_y)])
        .block(controller, ["e"], [("u", n_u)])
        .external_outputs(["e", "u"])
        .connect()?;
    let closed_loop_poles = loop_.sys().poles()?;
    let unstable = |pole: &&Complex64| !plant.domain().is_stable_pole(**pole);
    let poles: Vec<Complex64> = closed_loop_poles.iter().filter(unstable).copied().collect();
    if !poles.is_empty() {
        return Err(Error::UnstableLoop { poles });
    }
    let norm = hinf_norm(loop_.sys())?;
    Ok(NcfMargin { margin: 1.0 / norm.value, norm, closed_loop_poles })
}

/// Shaping of a plant before [`ncfsyn`]; a system with one input and one output stands for itself on every channel.
#[derive(Clone, Copy, Debug, Default)]
pub struct LoopShape<'a> {
    /// `W1`, before the plant (integral action goes here). Default: none.
    pub w1: Option<&'a StateSpace<Continuous>>,
    /// `W2`, behind the plant. Default: none.
    pub w2: Option<&'a StateSpace<Continuous>>,
}

/// A loop-shaping controller and the evidence for it.
#[derive(Clone, Debug, PartialEq)]
pub struct NcfDesign {
    /// `K = W1 K_s W2`, for negative feedback around `G`.
    pub controller: StateSpace<Continuous>,
    /// `K_s`, for negative feedback around the shaped plant.
    pub shaped_controller: StateSpace<Continuous>,
    /// `G_s = W2 G W1`.
    pub shaped_plant: StateSpace<Continuous>,
    /// `gamma_min = sqrt(1 + lambda_max(X Z))`, exact: no controller reaches less. Above 4, the shape asks for too much.
    pub gamma_min: f64,
    /// The gamma of this controller.
    pub gamma_design: f64,
    /// `b(G_s, K_s)`, recomputed from the loop; at least `1 / gamma_design`.
    pub achieved: NcfMargin,
    /// Larger of the relative residuals of the two Riccati equations.
    pub residual_relative: f64,
}

/// Returns the controller that makes the shaped loop robust against uncertainty of its normalized coprime factors.
///
/// ```text
///    r --->(+)---> [ W2 ---> K_s ---> W1 ] ---> G ---+---> y        G_s = W2 G W1
///           ^ -             controller               |
///           +----------------------------------------+
/// ```
///
/// **Shapes and units**: for `G: n_y × n_u`, `W1` gives `n_u` signals and `W2` takes `n_y`. `factor > 1` is the distance from the
/// optimum: 1.1 is usual; at 1 the controller becomes improper.
///
/// **Method**: the optimum is exact, from two Riccati equations, without any search; the controller is the central one for
/// `factor · gamma_min`. The margin of the loop is then recomputed by [`ncfmargin`].
///
/// **Source**: McFarlane and Glover 1992; Skogestad and Postlethwaite 2005, section 9.4, Eqs. (9.70) to (9.73) (there with
/// positive feedback).
///
/// **Accuracy**: `achieved.margin >= (1 - 1e-4) / gamma_design`, checked.
///
/// **Errors**: [`Error::OutOfRange`] for the factor; [`Error::ShapedPlant`] where the shaped plant has a mode that is not stable
/// and that its inputs do not reach or its outputs do not see; [`Error::IllConditioned`]; those of a weight that does not fit.
///
/// **Example**: `G = 1 / s²`: the textbook optimum is `gamma_min² = 4 + 2 sqrt(2)`.
/// ```
/// use telepulse_design::synthesize::{LoopShape, ncfsyn};
/// use telepulse_lti::TransferFunction;
/// let g = TransferFunction::new(&[1.0], &[1.0, 0.0, 0.0])?.to_state_space();
/// let design = ncfsyn(&g, &LoopShape::default(), 1.01)?;
/// assert!((design.gamma_min - (4.0 + 2.0 * 2f64.sqrt()).sqrt()).abs() < 1e-12);
/// assert!(design.achieved.margin * design.gamma_min > 0.99);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn ncfsyn(
    plant: &StateSpace<Continuous>,
    shape: &LoopShape<'_>,
    factor: f64,
) -> Result<NcfDesign, Error> {
    if !(factor > 1.0 && factor.is_finite()) {
        return Err(Error::OutOfRange { key: "factor", found: factor, allowed: "above 1 and finite" });
    }
    let w1 = shape.w1.map(|w| repeated(w, plant.n_inputs())).transpose()?;
    let w2 = shape.w2.map(|w| repeated(w, plant.n_outputs())).transpose()?;
    let mut shaped_plant = plant.clone();
    if let Some(w1) = &w1 {
        shaped_plant = w1.series(&shaped_plant)?;
    }
    if let Some(w2) = &w2 {
        shaped_plant = shaped_plant.series(w2)?;
    }
    let sys = shaped_plant.balanced();
    let pair = CoprimeRiccati::new(&sys).map_err(|error| match error {
        telepulse_lti::Error::HamiltonianAxis { .. } | telepulse_lti::Error::NoStabilizingSolution { .. } => {
            Error::ShapedPlant { reason: error }
        }
        other => other.into(),
    })?;
    let gamma_min = (1.0 + pair.coupling()).sqrt();
    let gamma_design = factor * gamma_min;
    let shaped_controller = central(&sys, &pair, gamma_design)?;
    let achieved = match ncfmargin(&shaped_plant, &shaped_controller) {
        Ok(achieved) if achieved.norm.upper <= gamma_design * (1.0 + ACHIEVED_TOLERANCE) => achieved,
        Ok(achieved) => {
            return Err(Error::IllConditioned { gamma: gamma_design, achieved: achieved.norm.value });
        }
        Err(Error::UnstableLoop { .. }) => {
            return Err(Error::IllConditioned { gamma: gamma_design, achieved: f64::INFINITY });
        }
        Err(other) => return Err(other),
    };
    let mut controller = shaped_controller.clone();
    if let Some(w2) = &w2 {
        controller = w2.series(&controller)?;
    }
    if let Some(w1) = &w1 {
        controller = controller.series(w1)?;
    }
    let residual_relative = pair.residual_relative;
    Ok(NcfDesign {
        controller,
        shaped_controller,
        shaped_plant,
        gamma_min,
        gamma_design,
        achieved,
        residual_relative,
    })
}

/// The central controller for a gamma above the optimum, for negative feedback.
fn central(
    sys: &StateSpace<Continuous>,
    pair: &CoprimeRiccati,
    gamma: f64,
) -> Result<StateSpace<Continuous>, Error> {
    let (a, b, c, d) = (sys.a(), sys.b(), sys.c(), sys.d());
    let n = sys.n_states();
    // With L = (1 - gamma²) I + X Z: B_K = gamma² (Lᵀ)⁻¹ Z Cᵀ, A_K = A + B F + B_K (C + D F), C_K = Bᵀ X, D_K = -Dᵀ.
    let squared = gamma * gamma;
    let lt = DMatrix::identity(n, n) * (1.0 - squared) + &pair.z * &pair.x;
    let lost = Error::IllConditioned { gamma, achieved: f64::INFINITY };
    let filter = &pair.z * c.transpose() * squared;
    let bk = if n == 0 { filter } else { lt.full_piv_lu().solve(&filter).ok_or(lost)? };
    let ak = a + b * &pair.f + &bk * (c + d * &pair.f);
    let (ck, dk) = (-b.tr_mul(&pair.x), d.transpose());
    Ok(StateSpace::<Continuous>::new(ak, bk, ck, dk)?.balanced())
}

/// How far the measured norm may exceed the gamma of the design.
const ACHIEVED_TOLERANCE: f64 = 1e-4;
