//! The same equilibria by integration from the plate outwards: an independent second method.
//!
//! Nothing is shared with collocation but the material law and the choice of nodes at which the fields are reported.

use nalgebra::{Matrix3, Vector3};

use super::extrapolation::integrate;
use super::sheet::Sheet;
use super::solution::{Derivatives, Electrodes, Load, Profile, ProfileNode, Solution, StaticPoint};
use super::{DEFAULT_DEGREE, solver};
use crate::Error;
use crate::collocation::ChebyshevGrid;
use crate::material::{ElasticLaw, Stress, electrical};

/// Tolerance of the integration over one interval between nodes.
const INTEGRATION_TOLERANCE: f64 = 1e-13;
/// Newton steps for one load.
const MAX_ITERATIONS: usize = 30;
/// Halvings of one Newton step.
const MAX_HALVINGS: usize = 8;
/// Newton ends after a step below this part of the unknowns: it converges quadratically.
const STEP_TOLERANCE: f64 = 1e-9;
/// Loads on the way from nothing to the full one, where the direct way fails.
const MAX_PATH_STEPS: usize = 60;
/// Smallest part of the path that is tried.
const MIN_PATH_STEP: f64 = 5e-3;
/// Steps of the inversion of s1(l1).
const MAX_INVERSION_STEPS: usize = 80;

/// Equilibrium by shooting, with the fields at as many nodes as the default collocation has.
///
/// **Method**: with P = R s1 cos(theta) and T = hypot(P, F/(2 pi H)), so that s1 = T/R,
/// ```text
/// dr/dR = l1 P/T    dP/dR = s2    dz/dR = -l1 F/(2 pi H T)    dC/dR = 2 pi eps R (l1 l2)^2/H
/// ```
/// where l1 comes from s1(l1, l2) by safeguarded Newton, so nothing is singular for F = 0. Unknown P(A), and the force or
/// the voltage where they are not prescribed, follow by Newton from r(B) = b and what is; its derivatives are
/// integrated beside the state, and give those of the solution.
///
/// **Accuracy**: integration to 1e-13 over each interval between nodes.
///
/// # Errors
/// [`Error::Request`]; [`Error::BeyondLimitPoint`] for an unstable state at dead load; [`Error::Slack`]; [`Error::PullIn`];
/// [`Error::NotConverged`], also where there is no equilibrium: this method looks for no reasons.
///
/// # Example
/// ```
/// use telepulse_actuator::statics::{Electrodes, Load, Material, Prestretch, Sheet, SheetSpec, shooting};
/// let sheet = Sheet::new(SheetSpec {
///     material: Material::NeoHookean { mu_pa: 1e5 },
///     inner_radius_m: 0.02,
///     outer_radius_m: 0.1,
///     thickness_m: 1e-3,
///     prestretch_inner: 2.0,
///     prestretch_outer: 2.0,
///     prestretch: Prestretch::AtLeastOne,
///     relative_permittivity: 4.7,
/// })?;
/// let found = shooting::solve(&sheet, Load::ForceN(1.0), Electrodes::VoltageV(3000.0))?;
/// assert!((found.point.force_n - 1.0).abs() < 1e-12 && found.point.displacement_m > 0.0);
/// # Ok::<(), telepulse_actuator::Error>(())
/// ```
pub fn solve(sheet: &Sheet, load: Load, electrodes: Electrodes) -> Result<Solution, Error> {
    let target = Target::new(sheet, load, electrodes)?;
    let grid = ChebyshevGrid::logarithmic(DEFAULT_DEGREE, sheet.radius_ratio(), 1.0);
    let edges = solver::edges(sheet);
    let shooter = Shooter { law: sheet.law(), rho: grid.nodes(), inner: edges.inner, outer: edges.outer };
    let start = shooter.start(target, sheet);
    let found = shooter.newton(start, target).or_else(|| shooter.path(target, sheet));
    let Some(found) = found else {
        let voltage_v = target.field().map_or(f64::NAN, |field| (field / sheet.field_scale_per_v2()).sqrt());
        return Err(Error::NotConverged { voltage_v, residual: f64::INFINITY, iterations: MAX_ITERATIONS });
    };
    let solution = shooter.solution(sheet, &grid, &found)?;
    if let Load::ForceN(force_n) = load
        && solution.derivatives.stiffness_n_per_m <= 0.0
    {
        return Err(Error::BeyondLimitPoint {
            voltage_v: solution.point.voltage_v,
            force_n,
            reached_voltage_v: solution.point.voltage_v,
            reached_force_n: force_n,
            stiffness_n_per_m: solution.derivatives.stiffness_n_per_m,
        });
    }
    solution.point.require_taut()?.require_no_pull_in()?;
    Ok(solution)
}

/// What is prescribed, dimensionless.
#[derive(Debug, Clone, Copy)]
struct Target {
    load: Load,
    electrodes: Electrodes,
}

impl Target {
    /// Reads f for N, x for m, v^2 for V and v^2 c^2 for C.
    fn new(sheet: &Sheet, load: Load, electrodes: Electrodes) -> Result<Self, Error> {
        let finite = |quantity, found: f64| {
            let error = Error::Request { quantity, allowed: "finite", found };
            if found.is_finite() { Ok(found) } else { Err(error) }
        };
        let not_negative = |quantity, found: f64| {
            let error = Error::Request { quantity, allowed: "finite and not negative", found };
            if found.is_finite() && found >= 0.0 { Ok(found) } else { Err(error) }
        };
        Ok(Self {
            load: match load {
                Load::ForceN(force) => Load::ForceN(finite("force_n", force)? / sheet.force_scale_n()),
                Load::DisplacementM(x) => {
                    Load::DisplacementM(finite("displacement_m", x)? / sheet.length_scale_m())
                }
            },
            electrodes: match electrodes {
                Electrodes::VoltageV(v) => {
                    Electrodes::VoltageV(not_negative("voltage_v", v)?.powi(2) * sheet.field_scale_per_v2())
                }
                Electrodes::ChargeC(charge) => Electrodes::ChargeC(
                    (not_negative("charge_c", charge)? / sheet.capacitance_scale_f()).powi(2)
                        * sheet.field_scale_per_v2(),
                ),
            },
        })
    }

    fn field(self) -> Option<f64> {
        match self.electrodes {
            Electrodes::VoltageV(field) => Some(field),
            Electrodes::ChargeC(_) => None,
        }
    }

    fn scaled(self, part: f64) -> Self {
        Self {
            load: match self.load {
                Load::ForceN(force) => Load::ForceN(part * force),
                Load::DisplacementM(x) => Load::DisplacementM(part * x),
            },
            electrodes: match self.electrodes {
                Electrodes::VoltageV(field) => Electrodes::VoltageV(part * field),
                Electrodes::ChargeC(square) => Electrodes::ChargeC(part * square),
            },
        }
    }
}

/// r, P, z, c and their derivatives by P(A), f, v^2: `[value, by P(A), by f, by v^2]` for each.
const COMPONENTS: usize = 16;
type Ray = [f64; COMPONENTS];
const R: usize = 0;
const P: usize = 4;
const Z: usize = 8;
const C: usize = 12;

struct Shooter<'a> {
    law: &'a ElasticLaw,
    rho: &'a [f64],
    inner: f64,
    outer: f64,
}

/// A converged shot: its parameters P(A), f, v^2, and the rays at all nodes.
struct Shot {
    parameters: Vector3<f64>,
    rays: Vec<Ray>,
    residual: f64,
    iterations: usize,
}

impl Shooter<'_> {
    /// Parameters of a shallow cone under the flat sheet's tension.
    fn start(&self, target: Target, sheet: &Sheet) -> Vector3<f64> {
        let field = target.field().unwrap_or(0.0);
        let rho = self.rho[0];
        let stretch = self.inner / rho;
        let elastic = self.law.stress(stretch, stretch).map_or(0.0, |s| s.s1);
        let tension = (elastic - field * stretch.powi(3)).max(0.1 * elastic).max(0.01);
        let log = -rho.ln();
        let mean = 0.5 * (sheet.spec().prestretch_inner + sheet.spec().prestretch_outer);
        let (slope, force) = match target.load {
            Load::ForceN(force) => (force / (rho * tension), force),
            Load::DisplacementM(x) => (x / (rho * log) / mean, x / log * tension / mean),
        };
        // P = T cos(theta) with tan(theta) = slope, T from the stretch along the cone.
        let l1 = (stretch * (1.0 + slope * slope).sqrt()).min(1.5 * stretch);
        let pull = self.law.stress(l1, stretch).map_or(tension, |s| s.s1 - field * l1 * stretch * stretch);
        Vector3::new(rho * pull.max(tension) / (1.0 + slope * slope).sqrt(), force, field)
    }

    /// From a small part of load and voltage to the whole.
    fn path(&self, target: Target, sheet: &Sheet) -> Option<Shot> {
        let (mut done, mut step) = (0.0, 0.1_f64);
        let mut known: Option<Shot> = None;
        for _ in 0..MAX_PATH_STEPS {
            let next = (done + step).min(1.0);
            let part = target.scaled(next);
            let start = known.as_ref().map_or_else(|| self.start(part, sheet), |shot| shot.parameters);
            match self.newton(start, part) {
                Some(shot) if next >= 1.0 => return Some(shot),
                Some(shot) => {
                    known = Some(shot);
                    done = next;
                    step *= 1.5;
                }
                None => step *= 0.5,
            }
            if step < MIN_PATH_STEP {
                break;
            }
        }
        None
    }

    fn newton(&self, start: Vector3<f64>, target: Target) -> Option<Shot> {
        let mut parameters = start;
        match target.load {
            Load::ForceN(force) => parameters[1] = force,
            Load::DisplacementM(_) => {}
        }
        if let Some(field) = target.field() {
            parameters[2] = field;
        }
        let mut rays = self.shoot(parameters)?;
        let mut miss = self.miss(&rays, parameters, target);
        for iteration in 1..=MAX_ITERATIONS {
            let step = -(self.miss_slope(&rays, parameters, target).lu().solve(&miss)?);
            let relative = step.abs().component_div(&parameters.abs().add_scalar(0.1)).max();
            let mut factor = 1.0;
            let mut accepted = false;
            for _ in 0..MAX_HALVINGS {
                let trial = parameters + step * factor;
                if let Some(next) = self.shoot(trial) {
                    let next_miss = self.miss(&next, trial, target);
                    if next_miss.norm() < miss.norm() || relative < STEP_TOLERANCE {
                        (parameters, rays, miss, accepted) = (trial, next, next_miss, true);
                        break;
                    }
                }
                factor *= 0.5;
            }
            if !accepted {
                return None;
            }
            if relative < STEP_TOLERANCE {
                return Some(Shot { parameters, rays, residual: miss.amax(), iterations: iteration });
            }
        }
        None
    }

    /// r(B) - b, and the distance to what is prescribed.
    fn miss(&self, rays: &[Ray], parameters: Vector3<f64>, target: Target) -> Vector3<f64> {
        let end = rays[rays.len() - 1];
        Vector3::new(
            end[R] - self.outer,
            match target.load {
                Load::ForceN(force) => parameters[1] - force,
                Load::DisplacementM(x) => -end[Z] - x,
            },
            match target.electrodes {
                Electrodes::VoltageV(field) => parameters[2] - field,
                Electrodes::ChargeC(square) => parameters[2] * end[C] * end[C] - square,
            },
        )
    }

    fn miss_slope(&self, rays: &[Ray], parameters: Vector3<f64>, target: Target) -> Matrix3<f64> {
        let end = rays[rays.len() - 1];
        let mut slope = Matrix3::zeros();
        for k in 0..3 {
            slope[(0, k)] = end[R + 1 + k];
            slope[(1, k)] = match target.load {
                Load::ForceN(_) => f64::from(k == 1),
                Load::DisplacementM(_) => -end[Z + 1 + k],
            };
            slope[(2, k)] = match target.electrodes {
                Electrodes::VoltageV(_) => f64::from(k == 2),
                Electrodes::ChargeC(_) => {
                    2.0 * parameters[2] * end[C] * end[C + 1 + k] + f64::from(k == 2) * end[C] * end[C]
                }
            };
        }
        slope
    }

    /// Rays at all nodes; nothing where the membrane goes slack or beyond its law on the way.
    fn shoot(&self, parameters: Vector3<f64>) -> Option<Vec<Ray>> {
        let (force, field) = (parameters[1], parameters[2]);
        let mut ray = [0.0; COMPONENTS];
        ray[R] = self.inner;
        ray[P] = parameters[0];
        ray[P + 1] = 1.0;
        let mut l1 = self.inner / self.rho[0];
        let mut rays = Vec::with_capacity(self.rho.len());
        rays.push(ray);
        let mut rate = |rho: f64, ray: &Ray| {
            let point = self.point(rho, ray, force, field, l1)?;
            l1 = point.l1;
            Some(slope_of(rho, ray, force, &point))
        };
        for ends in self.rho.windows(2) {
            integrate(&mut ray, ends[0], ends[1], INTEGRATION_TOLERANCE, &mut rate)?;
            rays.push(ray);
        }
        Some(rays)
    }

    fn point(&self, rho: f64, ray: &Ray, force: f64, field: f64, near: f64) -> Option<RayPoint> {
        let tension = ray[P].hypot(force);
        let l2 = ray[R] / rho;
        let (l1, stress) = self.stretch(tension / rho, l2, field, near)?;
        Some(RayPoint { tension, l1, l2, stress, field_stress: electrical(l1, l2) })
    }

    /// l1 at which the meridional stress is `s1`, by Newton within a bracket, from `near`.
    fn stretch(&self, s1: f64, l2: f64, field: f64, near: f64) -> Option<(f64, Stress)> {
        let (mut lower, mut upper) = (0.0, f64::INFINITY);
        let mut l1 = near;
        for _ in 0..MAX_INVERSION_STEPS {
            let middle =
                |lower: f64, upper: f64| if upper.is_finite() { 0.5 * (lower + upper) } else { 2.0 * l1 };
            let Some(mut stress) = self.law.stress(l1, l2) else {
                upper = l1;
                l1 = middle(lower, upper);
                continue;
            };
            let elastic_size = 1.0 + stress.s1.abs();
            stress.add_scaled(&electrical(l1, l2), field);
            let excess = stress.s1 - s1;
            let newton = l1 - excess / stress.s11;
            // Rounding of a difference of stresses of this size, seen through the modulus.
            let noise = 8.0 * f64::EPSILON * (l1 + elastic_size / stress.s11);
            if stress.s11 > 0.0 && (newton - l1).abs() <= noise {
                return Some((l1, stress));
            }
            // Voltage may bend s1(l1) down again on either side: the root is sought on the rising part about `near`.
            let beyond = if stress.s11 > 0.0 { excess > 0.0 } else { l1 > near };
            if beyond {
                upper = l1;
            } else {
                lower = l1;
            }
            let inside = stress.s11 > 0.0 && newton > lower && newton < upper;
            l1 = if inside { newton } else { middle(lower, upper) };
        }
        None
    }

    fn solution(&self, sheet: &Sheet, grid: &ChebyshevGrid, shot: &Shot) -> Result<Solution, Error> {
        let (force, field) = (shot.parameters[1], shot.parameters[2]);
        let end = shot.rays[shot.rays.len() - 1];
        let voltage_v = (field.max(0.0) / sheet.field_scale_per_v2()).sqrt();
        let capacitance_f = end[C] * sheet.capacitance_scale_f();
        let mut profile = Profile::with_capacity(self.rho.len());
        let mut near = self.inner / self.rho[0];
        let mut modulus_min = f64::INFINITY;
        for (&rho, ray) in self.rho.iter().zip(&shot.rays) {
            let lost =
                Error::NotConverged { voltage_v, residual: shot.residual, iterations: shot.iterations };
            let point = self.point(rho, ray, force, field, near).ok_or(lost)?;
            near = point.l1;
            modulus_min = modulus_min.min(point.stress.s11).min(point.stress.s22);
            let node = ProfileNode {
                rho,
                r: ray[R],
                // z(B) = 0.
                z: ray[Z] - end[Z],
                theta: force.atan2(ray[P]),
                l1: point.l1,
                s1: point.stress.s1,
                s2: point.stress.s2,
            };
            profile.push(sheet, voltage_v, node);
        }
        let least = |values: &[f64]| values.iter().copied().fold(f64::INFINITY, f64::min);
        let point = StaticPoint {
            displacement_m: -end[Z] * sheet.length_scale_m(),
            force_n: force * sheet.force_scale_n(),
            voltage_v,
            charge_c: voltage_v * capacitance_f,
            capacitance_f,
            field_max_v_per_m: profile.true_field_v_per_m.iter().copied().fold(0.0, f64::max),
            s1_min_pa: least(&profile.s1_pa),
            s2_min_pa: grid.minimum(&profile.s2_pa),
            modulus_min_pa: modulus_min * sheet.shear_modulus_pa(),
            residual: shot.residual,
            iterations: shot.iterations,
        };
        Ok(Solution { point, derivatives: derivatives(sheet, &end, voltage_v), profile })
    }
}

/// A point of a ray with its total stress.
struct RayPoint {
    tension: f64,
    l1: f64,
    l2: f64,
    stress: Stress,
    /// Electrical stress for one v^2.
    field_stress: Stress,
}

/// Rates of a ray and of its derivatives.
fn slope_of(rho: f64, ray: &Ray, force: f64, point: &RayPoint) -> Ray {
    let RayPoint { tension, l1, l2, stress, field_stress } = *point;
    let inverse = 1.0 / tension;
    let (cosine, sine) = (ray[P] * inverse, force * inverse);
    let mut slope = [0.0; COMPONENTS];
    slope[R] = l1 * cosine;
    slope[P] = stress.s2;
    slope[Z] = -l1 * sine;
    slope[C] = rho * (l1 * l2) * (l1 * l2);
    for k in 1..=3 {
        let (d_force, d_field) = (f64::from(k == 2), f64::from(k == 3));
        let (d_l2, d_p) = (ray[R + k] / rho, ray[P + k]);
        let d_tension = cosine * d_p + sine * d_force;
        // s1(l1, l2, v^2) = T/R.
        let d_l1 = (d_tension / rho - stress.s12 * d_l2 - field_stress.s1 * d_field) / stress.s11;
        slope[R + k] = d_l1 * cosine + l1 * inverse * (d_p - cosine * d_tension);
        slope[P + k] = stress.s12 * d_l1 + stress.s22 * d_l2 + field_stress.s2 * d_field;
        slope[Z + k] = -d_l1 * sine - l1 * inverse * (d_force - sine * d_tension);
        slope[C + k] = 2.0 * rho * l1 * l2 * (d_l1 * l2 + l1 * d_l2);
    }
    slope
}

/// Derivatives of F(x, V) and C(x, V) from those of r(B), x and c by P(A), f, v^2: P(A) moves so that r(B) stays.
fn derivatives(sheet: &Sheet, end: &Ray, voltage_v: f64) -> Derivatives {
    let kept = |component: usize, k: usize| end[component + k] - end[component + 1] * end[R + k] / end[R + 1];
    let (x_force, x_field) = (-kept(Z, 2), -kept(Z, 3));
    let (c_force, c_field) = (kept(C, 2), kept(C, 3));
    let per_length = 1.0 / sheet.length_scale_m();
    let force_by_field = -x_field / x_force;
    let per_v2 = sheet.force_scale_n() * sheet.field_scale_per_v2() * force_by_field;
    let capacitance_scale = sheet.capacitance_scale_f();
    Derivatives {
        stiffness_n_per_m: sheet.force_scale_n() * per_length / x_force,
        dforce_dvoltage_n_per_v: 2.0 * voltage_v * per_v2,
        dforce_dvoltage_squared_n_per_v2: per_v2,
        dcapacitance_dx_f_per_m: capacitance_scale * per_length * c_force / x_force,
        dcapacitance_dvoltage_f_per_v: 2.0
            * voltage_v
            * capacitance_scale
            * sheet.field_scale_per_v2()
            * (c_field + c_force * force_by_field),
    }
}
