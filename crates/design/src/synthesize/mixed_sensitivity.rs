//! The generalized plant of the mixed-sensitivity problem `[W1 S; W2 K S; W3 T]`, and its solution.

use nalgebra::DMatrix;
use telepulse_lti::{
    Continuous, Diagram, GeneralizedPlant, PeakGain, StateSpace, TimeDomain, TransferFunction, hinf_norm,
};

use super::hinfsyn::{HinfDesign, HinfOptions, hinfsyn};
use crate::Error;

/// Weights of a mixed-sensitivity problem with one input and one output; all proper and stable.
#[derive(Clone, Copy, Debug)]
pub struct MixedSensitivityWeights<'a> {
    /// `W_e`, on the tracking error: `1 / |W_e|` is the shape that `S` should stay under. Eq. (20).
    pub we: &'a TransferFunction,
    /// `W_u`, on the control input: `1 / |W_u|` is the shape that `K S` should stay under. Eq. (19).
    pub wu: &'a TransferFunction,
    /// `W_t`, on the plant's output: `1 / |W_t|` is the shape that `T` should stay under. Not in the paper.
    pub wt: Option<&'a TransferFunction>,
}

/// Returns the generalized plant with `w = r`, `z = [W_e e; W_u u; W_t G u]` and `y = e = r - G u`: [`augw`] for transfer
/// functions.
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
    for (weight, tf) in [("W_e", weights.we), ("W_u", weights.wu)] {
        check_stable(weight, &tf.to_state_space())?;
    }
    let (we, wu) = (weights.we.to_state_space(), weights.wu.to_state_space());
    let wt = weights.wt.map(TransferFunction::to_state_space);
    if let Some(wt) = &wt {
        check_stable("W_t", wt)?;
    }
    augw(&plant.to_state_space(), &LoopWeights { w1: Some(&we), w2: Some(&wu), w3: wt.as_ref() })
}

/// Weights of the three functions of a loop; those that are not given leave their function free.
///
/// A weight with one input and one output stands for itself on every channel; any other must have as many inputs as the
/// signal has channels.
#[derive(Clone, Copy, Debug)]
pub struct LoopWeights<'a, D: TimeDomain = Continuous> {
    /// On `S`, from the reference to the error.
    pub w1: Option<&'a StateSpace<D>>,
    /// On `K S`, from the reference to the control input.
    pub w2: Option<&'a StateSpace<D>>,
    /// On `T`, from the reference to the plant's output.
    pub w3: Option<&'a StateSpace<D>>,
}

/// Returns the generalized plant with `w = r`, `z = [W1 e; W2 u; W3 G u]` and `y = e = r - G u`.
///
/// ```text
///              +-----------------------------> W1 --> z1
///    w = r     |  e
///   ---->(+)---+--------------------------------------> y
///         ^ -
///         |              +-------------------> W3 --> z3
///         +---- G <------+ (output of G)
///               ^
///    u ---------+----------------------------> W2 --> z2
/// ```
///
/// **Shapes and units**: for a plant `G: n_y × n_u`, `W1` and `W3` take `n_y` channels and `W2` takes `n_u`; the norm of the
/// closed loop from `w` to `z` is that of `[W1 S; W2 K S; W3 T]`. States: those of `G`, `W1`, `W2`, `W3` in this order, each
/// once. A plant written with a separate `G` behind every weight has modes that no controller reaches.
///
/// **Source**: Skogestad and Postlethwaite 2005, section 9.3.5.
///
/// **Errors**: [`Error::NoWeight`], [`Error::WeightNotStable`]; [`telepulse_lti::Error::PortCount`] for a weight that does not
/// fit, [`telepulse_lti::Error::SampleTimeMismatch`]. (A state space model is proper by construction.)
///
/// **Example**: two channels, scalar weights on each.
/// ```
/// use nalgebra::dmatrix;
/// use telepulse_design::synthesize::{LoopWeights, augw};
/// use telepulse_lti::{Continuous, StateSpace, TransferFunction};
/// let g = StateSpace::<Continuous>::new(
///     dmatrix![-1.0, 0.0; 0.0, -2.0], dmatrix![1.0, 0.0; 0.0, 1.0], dmatrix![1.0, 1.0; 0.0, 1.0], dmatrix![0.0, 0.0; 0.0, 0.0])?;
/// let w1 = TransferFunction::new(&[0.5, 1.0], &[1.0, 0.001])?.to_state_space();
/// let w2 = TransferFunction::from_gain(0.1)?.to_state_space();
/// let plant = augw(&g, &LoopWeights { w1: Some(&w1), w2: Some(&w2), w3: None })?;
/// assert_eq!((plant.n_states(), plant.n_z(), plant.n_y()), (4, 4, 2));
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn augw<D: TimeDomain>(
    plant: &StateSpace<D>,
    weights: &LoopWeights<'_, D>,
) -> Result<GeneralizedPlant<D>, Error> {
    let g = plant;
    let (n_y, n_u) = (g.n_outputs(), g.n_inputs());
    let weight = |name, weight: Option<&StateSpace<D>>, channels| {
        weight.map(|weight| fitted(name, weight, channels, *g.domain())).transpose()
    };
    let (w1, w2, w3) =
        (weight("W1", weights.w1, n_y)?, weight("W2", weights.w2, n_u)?, weight("W3", weights.w3, n_y)?);
    let all = [&w1, &w2, &w3];
    let n_z = all.iter().map(|w| w.as_ref().map_or(0, StateSpace::n_outputs)).sum::<usize>();
    if n_z == 0 {
        return Err(Error::NoWeight);
    }
    let n_g = g.n_states();
    let n = n_g + all.iter().map(|w| w.as_ref().map_or(0, StateSpace::n_states)).sum::<usize>();
    let mut a = DMatrix::zeros(n, n);
    let mut b = DMatrix::zeros(n, n_y + n_u);
    let mut c = DMatrix::zeros(n_z + n_y, n);
    let mut d = DMatrix::zeros(n_z + n_y, n_y + n_u);

    // x_g' = A_g x_g + B_g u
    a.view_mut((0, 0), (n_g, n_g)).copy_from(g.a());
    b.view_mut((0, n_y), (n_g, n_u)).copy_from(g.b());
    // What a weight reads, as `reads_g x_g + reads_r r + reads_u u`: e = r - C_g x_g - D_g u, then u, then C_g x_g + D_g u.
    let (zero_g, zero_r) = (DMatrix::zeros(n_u, n_g), DMatrix::zeros(n_y, n_y));
    let reads = [
        (-g.c(), DMatrix::identity(n_y, n_y), -g.d()),
        (zero_g, DMatrix::zeros(n_u, n_y), DMatrix::identity(n_u, n_u)),
        (g.c().clone(), zero_r, g.d().clone()),
    ];
    let (mut state, mut row) = (n_g, 0);
    for (w, (reads_g, reads_r, reads_u)) in all.into_iter().zip(&reads) {
        let Some(w) = w else { continue };
        let (n_w, rows) = (w.n_states(), w.n_outputs());
        a.view_mut((state, state), (n_w, n_w)).copy_from(w.a());
        a.view_mut((state, 0), (n_w, n_g)).copy_from(&(w.b() * reads_g));
        b.view_mut((state, 0), (n_w, n_y)).copy_from(&(w.b() * reads_r));
        b.view_mut((state, n_y), (n_w, n_u)).copy_from(&(w.b() * reads_u));
        c.view_mut((row, state), (rows, n_w)).copy_from(w.c());
        c.view_mut((row, 0), (rows, n_g)).copy_from(&(w.d() * reads_g));
        d.view_mut((row, 0), (rows, n_y)).copy_from(&(w.d() * reads_r));
        d.view_mut((row, n_y), (rows, n_u)).copy_from(&(w.d() * reads_u));
        state += n_w;
        row += rows;
    }
    // y = e
    c.view_mut((n_z, 0), (n_y, n_g)).copy_from(&reads[0].0);
    d.view_mut((n_z, 0), (n_y, n_y)).fill_with_identity();
    d.view_mut((n_z, n_y), (n_y, n_u)).copy_from(&reads[0].2);

    let sys = StateSpace::with_domain(a, b, c, d, *g.domain())?;
    Ok(GeneralizedPlant::new(sys, n_y, n_u, n_z, n_y)?)
}

/// The weight on that many channels, repeated where it is scalar.
fn fitted<D: TimeDomain>(
    name: &'static str,
    weight: &StateSpace<D>,
    channels: usize,
    domain: D,
) -> Result<StateSpace<D>, Error> {
    check_stable(name, weight)?;
    if weight.domain() != &domain {
        let seconds = |domain: &D| domain.sample_time_of().map_or(0.0, |ts| ts.seconds());
        let (left_s, right_s) = (seconds(&domain), seconds(weight.domain()));
        return Err(telepulse_lti::Error::SampleTimeMismatch { left_s, right_s }.into());
    }
    if weight.n_inputs() == channels {
        return Ok(weight.clone());
    }
    let fitted = repeated(weight, channels)?;
    if fitted.n_inputs() != channels {
        let (operation, port, found) = ("mixed sensitivity", "inputs of a weight", weight.n_inputs());
        return Err(telepulse_lti::Error::PortCount { operation, port, expected: channels, found }.into());
    }
    Ok(fitted)
}

/// A system with one input and one output on that many channels; any other as it is.
pub(super) fn repeated<D: TimeDomain>(
    weight: &StateSpace<D>,
    channels: usize,
) -> Result<StateSpace<D>, Error> {
    if (weight.n_inputs(), weight.n_outputs()) != (1, 1) {
        return Ok(weight.clone());
    }
    let mut repeated = weight.clone();
    for _ in 1..channels {
        repeated = repeated.augment(weight)?;
    }
    Ok(repeated)
}

fn check_stable<D: TimeDomain>(weight: &'static str, sys: &StateSpace<D>) -> Result<(), Error> {
    match sys.poles()?.into_iter().find(|&pole| !sys.domain().is_stable_pole(pole)) {
        Some(pole) => Err(Error::WeightNotStable { weight, pole }),
        None => Ok(()),
    }
}

/// A mixed-sensitivity controller, the loop that it makes and the evidence for both.
#[derive(Clone, Debug, PartialEq)]
pub struct MixsynDesign {
    /// The synthesis: controller `u = K (r - y)`, bracket, achieved norm.
    pub hinf: HinfDesign,
    /// The generalized plant that was solved.
    pub plant: GeneralizedPlant,
    /// `S = (I + G K)⁻¹`, from `r` to `e`.
    pub s: StateSpace<Continuous>,
    /// `K S`, from `r` to `u`.
    pub ks: StateSpace<Continuous>,
    /// `T = G K S`, from `r` to the plant's output.
    pub t: StateSpace<Continuous>,
    /// Norm of `W1 S`, where `W1` is given.
    pub weighted_s: Option<PeakGain>,
    /// Norm of `W2 K S`, where `W2` is given.
    pub weighted_ks: Option<PeakGain>,
    /// Norm of `W3 T`, where `W3` is given.
    pub weighted_t: Option<PeakGain>,
}

/// Returns the controller that makes the norm of `[W1 S; W2 K S; W3 T]` nearly as small as any can.
///
/// ```text
///    r --->(+)-- e --> K -- u --> G ---+---> y
///           ^ -                        |
///           +--------------------------+
/// ```
///
/// **Shapes and units**: see [`augw`]. The feedback is negative: the controller acts on `e = r - y`.
///
/// **Method**: [`augw`], [`hinfsyn()`], then the loop from `G` and `K` alone ([`Diagram`]) and the norm of each weighted function by
/// itself; none exceeds the norm of the stack.
///
/// **Errors**: those of [`augw`] and [`hinfsyn()`].
///
/// **Example**
/// ```
/// use telepulse_design::synthesize::{HinfOptions, LoopWeights, makeweight, mixsyn, WeightShape};
/// use telepulse_lti::TransferFunction;
/// let g = TransferFunction::new(&[200.0], &[0.025, 10.0251, 10.02, 1.0])?.to_state_space();
/// let w1 = makeweight(&WeightShape::new(1e3, 10.0, 0.5))?.to_state_space();
/// let w2 = TransferFunction::from_gain(1.0)?.to_state_space();
/// let design = mixsyn(&g, &LoopWeights { w1: Some(&w1), w2: Some(&w2), w3: None }, &HinfOptions::default())?;
/// let of_s = design.weighted_s.map_or(0.0, |norm| norm.value);
/// assert!(of_s <= design.hinf.achieved.upper && design.hinf.achieved.value < 2.2);
/// assert!(design.s.dc_gain()?[(0, 0)].abs() <= design.hinf.achieved.upper / 1e3);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn mixsyn(
    plant: &StateSpace<Continuous>,
    weights: &LoopWeights<'_>,
    options: &HinfOptions,
) -> Result<MixsynDesign, Error> {
    let generalized = augw(plant, weights)?;
    let hinf = hinfsyn(&generalized, options)?;
    let (n_y, n_u) = (plant.n_outputs(), plant.n_inputs());
    let loop_ = Diagram::new()
        .external_inputs([("r", n_y)])
        .sum("e = r - y")
        .block(&hinf.controller, ["e"], [("u", n_u)])
        .block(plant, ["u"], [("y", n_y)])
        .external_outputs(["e", "u", "y"])
        .connect()?;
    let [s, ks, t] = ["e", "u", "y"].map(|output| loop_.from_to(&["r"], &[output]));
    let (s, ks, t) = (s?, ks?, t?);
    let weighted = |name, weight: Option<&StateSpace<Continuous>>, function: &StateSpace<Continuous>| {
        let Some(weight) = weight else { return Ok::<_, Error>(None) };
        let weight = fitted(name, weight, function.n_outputs(), Continuous)?;
        Ok(Some(hinf_norm(&function.series(&weight)?)?))
    };
    let weighted_s = weighted("W1", weights.w1, &s)?;
    let weighted_ks = weighted("W2", weights.w2, &ks)?;
    let weighted_t = weighted("W3", weights.w3, &t)?;
    Ok(MixsynDesign { hinf, plant: generalized, s, ks, t, weighted_s, weighted_ks, weighted_t })
}
