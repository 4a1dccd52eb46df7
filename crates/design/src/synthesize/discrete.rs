//! Discrete-time H-infinity synthesis by way of the bilinear map, which keeps the norm.

use nalgebra::DMatrix;
use num_complex::Complex64;
use telepulse_lti::{Continuous, Discrete, GeneralizedPlant, PeakGain, StateSpace, Wiring, hinf_norm};

use super::central_controller::Condition;
use super::hinfsyn::{HinfDesign, HinfOptions, hinfsyn};
use crate::Error;

/// A discrete controller and the evidence for it.
#[derive(Clone, Debug, PartialEq)]
pub struct DiscreteHinfDesign {
    /// The controller, `u = K y`.
    pub controller: StateSpace<Discrete>,
    /// No controller reaches this norm.
    pub gamma_lower: f64,
    /// Some controller reaches this norm.
    pub gamma_upper: f64,
    /// The norm that this controller was designed for.
    pub gamma_design: f64,
    /// The closed-loop norm on the plant as it was given, recomputed in discrete time.
    pub achieved: PeakGain,
    /// Poles of the closed loop, all inside of the unit circle.
    pub closed_loop_poles: Vec<Complex64>,
    /// The condition that fails at `gamma_lower`.
    pub binding_condition: Option<Condition>,
    /// The point of the unit circle that the map sent to infinity: -1 or 1.
    pub mapped_to_infinity: f64,
    /// Static feedback `u = shift y + v` that was applied first to free both points of poles; zero in most cases.
    pub shift: DMatrix<f64>,
    /// The circle on which the norm was bounded: 1, or slightly less where the controller has a pole at the mapped point. The norm
    /// on the unit circle is no larger; `gamma_lower` belongs to the smaller circle.
    pub radius: f64,
    /// The synthesis in continuous time, with whatever else it reports.
    pub continuous: HinfDesign,
}

/// Returns a discrete controller whose closed-loop H-infinity norm is within the back-off of the smallest possible.
///
/// ```text
///   w[k] --->+-------+---> z[k]
///            |   P   |
///   u[k] +-->+-------+--+ y[k]       u = K y (positive feedback, as in GeneralizedPlant)
///        +------ K <----+
/// ```
///
/// **Shapes and units**: see [`GeneralizedPlant`]. The limit on the controller's poles is one of continuous time and is refused.
///
/// **Method**: `s = (z - 1) / (z + 1)` maps the unit circle onto the axis and every gain onto the same gain, so the problem is that of
/// [`hinfsyn()`] (the direct terms that the map makes, `D22` among them, are its business). The map is singular for a pole at -1; its
/// mirror image `s = (z + 1) / (1 - z)` for one at 1. The better conditioned of the two is taken; where both are poor, a static
/// feedback moves the poles first. A controller that has a pole at that point itself (integral action of a plant with poles at 1
/// and -1) is found for the circle of radius `1 - 1e-6`, outside of which the loop is then analytic, so that its norm on the unit
/// circle is no larger. The controller is mapped back and the norm recomputed in discrete time.
///
/// **Source**: Green and Limebeer 1995, appendix B; Zhou and Doyle 1998, section 21.1.
///
/// **Accuracy**: `achieved.upper <= 1.0001 · gamma_design`, checked.
///
/// **Errors**: those of [`hinfsyn()`], where modes and frequencies are those of the mapped plant; [`Error::IllConditioned`] where no map
/// leads to a controller that keeps its norm in discrete time.
///
/// **Example**: a sampled integrator with noise, and its norm measured again.
/// ```
/// use nalgebra::dmatrix;
/// use telepulse_design::synthesize::{HinfOptions, hinfsyn_discrete};
/// use telepulse_lti::{Discrete, GeneralizedPlant, SampleTime, StateSpace, hinf_norm};
/// let sys = StateSpace::<Discrete>::new(
///     dmatrix![1.0], dmatrix![0.1, 0.0, 0.1], dmatrix![1.0; 0.0; 1.0],
///     dmatrix![0.0, 0.0, 0.0; 0.0, 0.0, 1.0; 0.0, 1.0, 0.0], SampleTime::new(0.1)?)?;
/// let plant = GeneralizedPlant::new(sys, 2, 1, 2, 1)?;
/// let design = hinfsyn_discrete(&plant, &HinfOptions::default())?;
/// let norm = hinf_norm(&plant.lower_lft(&design.controller)?)?;
/// assert!(norm.value >= design.gamma_lower && norm.upper <= 1.0101 * design.gamma_upper);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn hinfsyn_discrete(
    plant: &GeneralizedPlant<Discrete>,
    options: &HinfOptions,
) -> Result<DiscreteHinfDesign, Error> {
    if let Some(found) = options.max_controller_pole_rad_s {
        let (key, allowed) = ("max_controller_pole_rad_s", "absent in discrete time");
        return Err(Error::OutOfRange { key, found, allowed });
    }
    let (n_u, n_y) = (plant.n_u(), plant.n_y());
    let mut candidates = Vec::new();
    for shift in [DMatrix::zeros(n_u, n_y), generic_gain(plant)] {
        let Ok(shifted) = with_static_feedback(plant, &shift) else { continue };
        for map in [Map::MinusOne, Map::PlusOne] {
            if let Some(quality) = map.quality(&shifted) {
                candidates.push((quality, shift.clone(), map, shifted.clone()));
            }
        }
        // The shift is a last resort: it mixes the signals that the caller kept apart.
        if candidates.iter().any(|(quality, ..)| *quality > QUALITY_ENOUGH) {
            break;
        }
    }
    candidates.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut first_error = None;
    for radius in [1.0, RADIUS_REDUCED] {
        for (_, shift, map, shifted) in &candidates {
            match attempt(plant, &with_radius(shifted, radius)?, Path { shift, map: *map, radius }, options) {
                Ok(design) => return Ok(design),
                // Facts about the plant, which no other map changes.
                Err(
                    error @ (Error::NotStabilizable { .. }
                    | Error::NotDetectable { .. }
                    | Error::AxisZero { .. }
                    | Error::Infeasible { .. }
                    | Error::OutOfRange { .. }),
                ) => return Err(error),
                Err(error) => first_error = first_error.or(Some(error)),
            }
        }
    }
    Err(first_error.unwrap_or(Error::IllConditioned { gamma: f64::INFINITY, achieved: f64::INFINITY }))
}

/// How a plant went to continuous time.
#[derive(Clone, Copy)]
struct Path<'a> {
    shift: &'a DMatrix<f64>,
    map: Map,
    radius: f64,
}

/// Synthesis by one map.
fn attempt(
    plant: &GeneralizedPlant<Discrete>,
    moved: &GeneralizedPlant<Discrete>,
    Path { shift, map, radius }: Path<'_>,
    options: &HinfOptions,
) -> Result<DiscreteHinfDesign, Error> {
    let (n_w, n_u, n_z, n_y) = (plant.n_w(), plant.n_u(), plant.n_z(), plant.n_y());
    let lost = Error::IllConditioned { gamma: f64::INFINITY, achieved: f64::INFINITY };
    let mapped = map.to_continuous(&moved.sys().balanced()).ok_or(lost)?;
    let mapped = GeneralizedPlant::new(mapped, n_w, n_u, n_z, n_y)?;
    let mut options = *options;
    // A controller pole may fall on the point that maps to infinity: the next one is designed further from the optimum.
    for _ in 0..DESIGNS_MAX {
        let design = hinfsyn(&mapped, &options)?;
        if let Some(found) = map.to_discrete(&design.controller, *plant.sys().domain()) {
            let controller = StateSpace::<Discrete>::new(
                found.a() * radius,
                found.b() * radius,
                found.c().clone(),
                found.d() + shift,
                found.sample_time(),
            )?
            .balanced();
            if let Some((achieved, closed_loop_poles)) = verified(plant, &controller, design.gamma_design)? {
                return Ok(DiscreteHinfDesign {
                    controller,
                    gamma_lower: design.gamma_lower,
                    gamma_upper: design.gamma_upper,
                    gamma_design: design.gamma_design,
                    achieved,
                    closed_loop_poles,
                    binding_condition: design.binding_condition,
                    mapped_to_infinity: map.point(),
                    shift: shift.clone(),
                    radius,
                    continuous: design,
                });
            }
        }
        if options.backoff >= options.relaxation_max {
            return Err(Error::IllConditioned { gamma: design.gamma_design, achieved: f64::INFINITY });
        }
        options.backoff = (1.0 + 2.0 * (options.backoff - 1.0)).min(options.relaxation_max);
    }
    Err(Error::IllConditioned { gamma: f64::INFINITY, achieved: f64::INFINITY })
}

/// Norm and poles of the discrete loop, or `None` where it is unstable or misses its gamma.
fn verified(
    plant: &GeneralizedPlant<Discrete>,
    controller: &StateSpace<Discrete>,
    gamma: f64,
) -> Result<Option<(PeakGain, Vec<Complex64>)>, Error> {
    let closed_loop = match plant.lower_lft(controller) {
        Err(telepulse_lti::Error::AlgebraicLoop { .. }) => return Ok(None),
        other => other?,
    };
    let poles = closed_loop.poles()?;
    if poles.iter().any(|pole| pole.norm() >= 1.0) {
        return Ok(None);
    }
    let achieved = hinf_norm(&closed_loop)?;
    Ok((achieved.upper <= gamma * (1.0 + ACHIEVED_TOLERANCE)).then_some((achieved, poles)))
}

/// Which point of the unit circle goes to infinity.
#[derive(Clone, Copy, Debug)]
enum Map {
    /// `s = (z - 1) / (z + 1)`.
    MinusOne,
    /// `s = (z + 1) / (1 - z)`: the first one after `z → -z`.
    PlusOne,
}

impl Map {
    fn point(self) -> f64 {
        match self {
            Self::MinusOne => -1.0,
            Self::PlusOne => 1.0,
        }
    }

    /// How well the map is conditioned: the reciprocal conditions of the resolvent at its point, and of what becomes `D12` and
    /// `D21` there.
    fn quality(self, plant: &GeneralizedPlant<Discrete>) -> Option<f64> {
        let (n_w, n_u, n_z, n_y) = (plant.n_w(), plant.n_u(), plant.n_z(), plant.n_y());
        let sys = plant.sys().balanced();
        let n = sys.n_states();
        let pencil = DMatrix::identity(n, n) * self.point() - sys.a();
        let mapped = self.to_continuous(&sys)?;
        let d12 = mapped.d().view((0, n_w), (n_z, n_u)).into_owned();
        let d21 = mapped.d().view((n_z, 0), (n_y, n_w)).into_owned();
        let direct = reciprocal_condition(&d12).min(reciprocal_condition(&d21));
        // A rank-deficient direct term can be regularized, a pole at the point cannot.
        let quality = reciprocal_condition(&pencil) * (DIRECT_SHARE + direct);
        (quality > 0.0).then_some(quality)
    }

    /// With `R = (I + A)⁻¹`: `A_c = R (A - I)`, `B_c = sqrt(2) R B`, `C_c = sqrt(2) C R`, `D_c = D - C R B`; for the mirror image,
    /// `A` and `B` change their signs first.
    fn to_continuous(self, sys: &StateSpace<Discrete>) -> Option<StateSpace<Continuous>> {
        let one = DMatrix::<f64>::identity(sys.n_states(), sys.n_states());
        let sign = -self.point();
        let (a, b) = (sys.a() * sign, sys.b() * sign);
        let resolvent = Resolvent::new(&one + &a);
        let root = std::f64::consts::SQRT_2;
        let rb = resolvent.times(&b)?;
        let d = sys.d() - sys.c() * &rb;
        let cr = resolvent.after(sys.c())?;
        StateSpace::<Continuous>::new(resolvent.times(&(a - one))?, rb * root, cr * root, d).ok()
    }

    /// The inverse of [`Self::to_continuous`]: with `R = (I - A_c)⁻¹`, `A = R (I + A_c)`, `B = sqrt(2) R B_c`, `C = sqrt(2) C_c R`,
    /// `D = D_c + C_c R B_c`.
    fn to_discrete(self, sys: &StateSpace<Continuous>, domain: Discrete) -> Option<StateSpace<Discrete>> {
        let one = DMatrix::<f64>::identity(sys.n_states(), sys.n_states());
        let sign = -self.point();
        let resolvent = Resolvent::new(&one - sys.a());
        let root = std::f64::consts::SQRT_2;
        let rb = resolvent.times(sys.b())?;
        let d = sys.d() + sys.c() * &rb;
        let a = resolvent.times(&(one + sys.a()))? * sign;
        let c = resolvent.after(sys.c())? * root;
        StateSpace::with_domain(a, rb * (root * sign), c, d, domain).ok()
    }
}

/// The inverse of a matrix, as solutions that are refined once: a controller near the optimum has a state matrix whose explicit inverse
/// loses ten digits.
struct Resolvent {
    matrix: DMatrix<f64>,
    lu: nalgebra::LU<f64, nalgebra::Dyn, nalgebra::Dyn>,
    transposed_lu: nalgebra::LU<f64, nalgebra::Dyn, nalgebra::Dyn>,
}

impl Resolvent {
    fn new(matrix: DMatrix<f64>) -> Self {
        let (lu, transposed_lu) = (matrix.clone().lu(), matrix.transpose().lu());
        Self { matrix, lu, transposed_lu }
    }

    /// `M⁻¹ b`.
    fn times(&self, b: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        if self.matrix.is_empty() {
            return Some(b.clone());
        }
        let x = self.lu.solve(b)?;
        let correction = self.lu.solve(&(b - &self.matrix * &x))?;
        Some(x + correction)
    }

    /// `c M⁻¹`.
    fn after(&self, c: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        if self.matrix.is_empty() {
            return Some(c.clone());
        }
        let c = c.transpose();
        let x = self.transposed_lu.solve(&c)?;
        let correction = self.transposed_lu.solve(&(&c - self.matrix.tr_mul(&x)))?;
        Some((x + correction).transpose())
    }
}

/// `P(radius z)`.
fn with_radius(plant: &GeneralizedPlant<Discrete>, radius: f64) -> Result<GeneralizedPlant<Discrete>, Error> {
    let sys = plant.sys();
    let (a, b) = (sys.a() / radius, sys.b() / radius);
    let sys = StateSpace::with_domain(a, b, sys.c().clone(), sys.d().clone(), *sys.domain())?;
    Ok(GeneralizedPlant::new(sys, plant.n_w(), plant.n_u(), plant.n_z(), plant.n_y())?)
}

/// The plant from `(w, v)` to `(z, y)` with `u = gain y + v`.
fn with_static_feedback(
    plant: &GeneralizedPlant<Discrete>,
    gain: &DMatrix<f64>,
) -> Result<GeneralizedPlant<Discrete>, Error> {
    if gain.amax() == 0.0 {
        return Ok(plant.clone());
    }
    let (n_w, n_u, n_z, n_y) = (plant.n_w(), plant.n_u(), plant.n_z(), plant.n_y());
    let mut feedback = DMatrix::zeros(n_w + n_u, n_z + n_y);
    feedback.view_mut((n_w, n_z), (n_u, n_y)).copy_from(gain);
    let (external, outputs) =
        (DMatrix::identity(n_w + n_u, n_w + n_u), DMatrix::identity(n_z + n_y, n_z + n_y));
    let closed = plant.sys().close_loop(&Wiring { feedback, external, outputs })?;
    Ok(GeneralizedPlant::new(closed, n_w, n_u, n_z, n_y)?)
}

/// A gain of moderate size without structure, so that it moves every mode that can be moved.
fn generic_gain(plant: &GeneralizedPlant<Discrete>) -> DMatrix<f64> {
    let sys = plant.sys().balanced();
    let size = |m: DMatrix<f64>| m.norm().max(f64::MIN_POSITIVE);
    let b2 = sys.b().columns(plant.n_w(), plant.n_u()).into_owned();
    let c2 = sys.c().rows(plant.n_z(), plant.n_y()).into_owned();
    let scale = SHIFT_SIZE * sys.a().norm().max(1.0) / (size(b2) * size(c2));
    // Fractional parts of multiples of the golden ratio: no two rows or columns are alike.
    DMatrix::from_fn(plant.n_u(), plant.n_y(), |i, j| {
        let k = (1 + i + 7 * j) as f64;
        let gain = scale * (0.5 + (k * 0.618_033_988_749_895).fract());
        if gain.is_finite() { gain } else { 0.0 }
    })
}

/// Smallest over largest singular value.
fn reciprocal_condition(m: &DMatrix<f64>) -> f64 {
    if m.is_empty() {
        return 1.0;
    }
    let values = m.singular_values();
    if values.max() > 0.0 { values.min() / values.max() } else { 0.0 }
}

/// A map of this quality needs no help.
const QUALITY_ENOUGH: f64 = 1e-10;
/// How much a map is worth whose direct terms are singular.
const DIRECT_SHARE: f64 = 1e-4;
/// Size of the static feedback relative to the loop gain that would move the poles by their own size.
const SHIFT_SIZE: f64 = 0.1;
/// Circle for controllers with a pole at the mapped point: costs a millionth of the norm and six digits of the pole.
const RADIUS_REDUCED: f64 = 1.0 - 1e-6;
/// Designs tried, each further from the optimum than the one before.
const DESIGNS_MAX: usize = 8;
/// How far the measured norm may exceed the gamma of the design.
const ACHIEVED_TOLERANCE: f64 = 1e-4;
