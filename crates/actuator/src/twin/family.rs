//! Twins that differ by scale alone, from one set of membrane solves.

use super::branch_reduction::{BranchMaps, CHANNELS, STRAIN_MODES, channels};
use super::model::{
    BRANCH_POINTS_V2, BRANCH_POINTS_X, FORCE_POINTS_V2, FORCE_POINTS_X, LEAST_SAG, REACH_DOWN_M, REACH_UP_M,
    Slack, TwinModel, axes, sweep,
};
use super::surface::{Axis, Surface, slope, value};
use crate::membrane::Membrane;
use crate::{ActuatorParameters, Error};

/// Points of the family's own maps: more than a twin's, since they span the ranges of all members.
const WIDE_X: usize = 12;
const WIDE_V2: usize = 8;
const WIDE_BRANCH_X: usize = 8;
const WIDE_BRANCH_V2: usize = 6;
/// Members whose load or squared voltage, in the units of the reference, differ from it by more than this factor are left out:
/// the maps would have to be wider than their degree is good for.
const WIDEST: f64 = 1.8;
/// A member is left to a model of its own where the least hoop stress over its map falls below this part of its modulus.
const TAUT_PART: f64 = 0.02;

/// Maps shared by all actuators whose membranes have one shape: the same ratio of radii, pre-stretch and chain limit.
///
/// In the groups of MODEL, lengths over B, stresses over mu, f = F/(2 pi mu H B) and v = (Phi/H) sqrt(eps/mu), such
/// membranes have the same maps; a member's are found by scaling instead of by solving.
///
/// **Accuracy**: force and capacitance within 1e-6 relative of a model of the member's own; the internal stiffness K is that of
/// the reference, in units of mu, though it depends a little on the ratio of branch moduli to mu (tests give the error).
#[derive(Debug, Clone)]
pub(crate) struct TwinFamily {
    reference: ActuatorParameters,
    x_axis: Axis,
    v2_axis: Axis,
    force: Surface<WIDE_X, WIDE_V2>,
    capacitance: Surface<WIDE_X, WIDE_V2>,
    /// Least hoop stress over the membrane, Pa.
    tension: Surface<WIDE_X, WIDE_V2>,
    branches: Option<[Surface<WIDE_BRANCH_X, WIDE_BRANCH_V2>; CHANNELS]>,
}

/// What makes a member's numbers out of the reference's.
struct Scale {
    length: f64,
    modulus: f64,
    force: f64,
    /// V^2 of the reference over V^2 of the member.
    v2: f64,
    capacitance: f64,
    volume: f64,
}

impl Scale {
    /// None where the shapes differ.
    fn between(reference: &ActuatorParameters, member: &ActuatorParameters) -> Option<Self> {
        if shape(reference) != shape(member) {
            return None;
        }
        let (r, m) = (reference.spec(), member.spec());
        let length = m.outer_radius_m / r.outer_radius_m;
        let modulus = m.mu_pa / r.mu_pa;
        let thickness = m.thickness_m / r.thickness_m;
        let permittivity = m.relative_permittivity / r.relative_permittivity;
        Some(Self {
            length,
            modulus,
            force: modulus * thickness * length,
            v2: permittivity / (modulus * thickness * thickness),
            capacitance: permittivity * length * length / thickness,
            volume: thickness * length * length,
        })
    }

    /// Load and largest V^2 of a member in the reference's units, over the reference's own; length.
    fn reach(&self, reference: &ActuatorParameters, member: &ActuatorParameters) -> [f64; 3] {
        let voltage = member.spec().full_scale_v / reference.spec().full_scale_v;
        [member.weight_n() / reference.weight_n() / self.force, self.v2 * voltage * voltage, self.length]
    }
}

/// Equal for membranes of one shape.
pub(crate) fn shape(parameters: &ActuatorParameters) -> [u64; 3] {
    let spec = parameters.spec();
    // No chain limit is a limit at infinity.
    [
        (spec.inner_radius_m / spec.outer_radius_m).to_bits(),
        spec.prestretch.to_bits(),
        spec.gent_limit.unwrap_or(f64::INFINITY).to_bits(),
    ]
}

impl TwinFamily {
    /// Maps wide enough for those of `members` that are near the first of them.
    ///
    /// # Errors
    /// Those of [`TwinModel::new`] for the corners of the range; [`Error::NoEquilibrium`] without members.
    pub(crate) fn covering(members: &[&ActuatorParameters]) -> Result<Self, Error> {
        let reference = (*members.first().ok_or(Error::NoEquilibrium)?).clone();
        let (mut load, mut v2, mut length) = ([1.0_f64; 2], 1.0_f64, 1.0_f64);
        let near = |ratio: f64| (1.0 / WIDEST..=WIDEST).contains(&ratio);
        for member in members {
            let Some(scale) = Scale::between(&reference, member) else { continue };
            let [w, e, l] = scale.reach(&reference, member);
            if near(w) && e <= WIDEST && near(l) {
                load = [load[0].min(w), load[1].max(w)];
                v2 = v2.max(e);
                length = length.min(l);
            }
        }
        let membrane = Membrane::new(&reference)?;
        let rest = membrane.rest(0.0)?;
        let sag = |part: f64| -> Result<f64, Error> {
            Ok(membrane.solve_at_force(part * reference.weight_n(), 0.0)?.displacement_m())
        };
        let (least, most) = (sag(load[0])?, sag(load[1])?);
        let lower = least - (REACH_UP_M / length).min((1.0 - LEAST_SAG) * least);
        let full_scale = reference.spec().full_scale_v;
        // A little wider, so that rounding leaves no member at the edge outside.
        let x_axis = Axis::new(0.999 * lower, 1.001 * (most + REACH_DOWN_M / length));
        let v2_axis = Axis::new(0.0, 1.001 * v2 * full_scale * full_scale);
        let mut force = [[0.0; WIDE_X]; WIDE_V2];
        let (mut capacitance, mut tension) = (force, force);
        let xs = x_axis.points(WIDE_X);
        for (iy, v2) in v2_axis.points(WIDE_V2).into_iter().enumerate() {
            let states = sweep(&membrane, &rest, &xs, v2.max(0.0).sqrt(), Slack::Kept)?;
            for (ix, state) in states.iter().enumerate() {
                force[iy][ix] = state.force_n();
                capacitance[iy][ix] = state.capacitance_f();
                tension[iy][ix] = state.s2_min_pa();
            }
        }
        let branches = match reference.spec().branches.is_empty() {
            true => None,
            false => Some(channels(&membrane, &rest, x_axis, v2_axis, Slack::Kept)?),
        };
        Ok(Self {
            reference,
            x_axis,
            v2_axis,
            force: Surface::interpolate(&force),
            capacitance: Surface::interpolate(&capacitance),
            tension: Surface::interpolate(&tension),
            branches,
        })
    }

    /// The model of a member, or nothing where the family does not reach it: then [`TwinModel::new`] decides.
    pub(crate) fn member(&self, parameters: &ActuatorParameters) -> Option<TwinModel> {
        let scale = Scale::between(&self.reference, parameters)?;
        let rest_sag = scale.length * self.sag(parameters.weight_n() / scale.force)?;
        let (x_axis, v2_axis) = axes(parameters, rest_sag);
        let x_of = |x: f64| self.x_axis.normalized(x / scale.length);
        let y_of = |v2: f64| self.v2_axis.normalized(v2 * scale.v2);
        let within =
            x_of(x_axis.lower()) >= -1.0 && x_of(x_axis.upper()) <= 1.0 && y_of(v2_axis.upper()) <= 1.0;
        if !within {
            return None;
        }
        let sample = |surface: &Surface<WIDE_X, WIDE_V2>, factor: f64| {
            resample::<WIDE_X, WIDE_V2, FORCE_POINTS_X, FORCE_POINTS_V2>(
                surface, factor, x_axis, v2_axis, &x_of, &y_of,
            )
        };
        let taut = sample(&self.tension, 1.0 / self.reference.spec().mu_pa);
        if taut.iter().flatten().any(|part| *part < TAUT_PART) {
            return None;
        }
        let branches = match (&self.branches, parameters.spec().branches.is_empty()) {
            (_, true) => BranchMaps::absent(),
            (None, false) => return None,
            (Some(wide), false) => {
                let volume = scale.volume.sqrt();
                BranchMaps::from_channels(&std::array::from_fn(|c| {
                    let factor = if c < STRAIN_MODES { volume } else { scale.modulus };
                    let values = resample::<WIDE_BRANCH_X, WIDE_BRANCH_V2, BRANCH_POINTS_X, BRANCH_POINTS_V2>(
                        &wide[c], factor, x_axis, v2_axis, &x_of, &y_of,
                    );
                    Surface::interpolate(&values)
                }))
            }
        };
        Some(TwinModel {
            parameters: parameters.clone(),
            rest_sag,
            x_axis,
            v2_axis,
            force: Surface::interpolate(&sample(&self.force, scale.force)),
            capacitance: Surface::interpolate(&sample(&self.capacitance, scale.capacitance)),
            branches,
            stated_error: None,
        })
    }

    /// Displacement of the reference under `force_n` at zero voltage, m, by Newton on its map; nothing outside of it.
    fn sag(&self, force_n: f64) -> Option<f64> {
        let slice = self.force.slice(self.v2_axis.normalized(0.0));
        let mut u = 0.0_f64;
        for _ in 0..50 {
            let step = (force_n - value(&slice, u)) / slope(&slice, u);
            u = (u + step).clamp(-1.0, 1.0);
            if step.abs() < 1e-15 {
                break;
            }
        }
        let found = value(&slice, u);
        ((found - force_n).abs() <= 1e-12 * force_n).then(|| self.x_axis.center() + u * self.x_axis.half())
    }
}

/// Values of a wide surface at the Chebyshev points of a narrower one.
fn resample<const WX: usize, const WY: usize, const NX: usize, const NY: usize>(
    surface: &Surface<WX, WY>,
    factor: f64,
    x_axis: Axis,
    v2_axis: Axis,
    x_of: &dyn Fn(f64) -> f64,
    y_of: &dyn Fn(f64) -> f64,
) -> [[f64; NX]; NY] {
    let (xs, v2s) = (x_axis.points(NX), v2_axis.points(NY));
    std::array::from_fn(|iy| {
        let slice = surface.slice(y_of(v2s[iy]));
        std::array::from_fn(|ix| factor * value(&slice, x_of(xs[ix])))
    })
}
