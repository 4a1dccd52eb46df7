//! One step of the reduced twin, for one or for several side by side.

use super::branch_reduction::{CHANNELS, STRAIN_MODES};
use super::lanes::Lanes;
use super::model::{BRANCH_POINTS_V2, BRANCH_POINTS_X, FORCE_POINTS_V2, FORCE_POINTS_X, TwinModel};
use super::pace::Pace;
use crate::MAX_BRANCHES;

/// Maps and constants of `L` twins.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Plant<const L: usize> {
    /// `[power of y][power of u]`, N.
    force: [[Lanes<L>; FORCE_POINTS_X]; FORCE_POINTS_V2],
    /// `[power of y][power of u][c_0, c_1, c_2, K]`.
    branches: [[[Lanes<L>; CHANNELS]; BRANCH_POINTS_X]; BRANCH_POINTS_V2],
    x_center: Lanes<L>,
    x_inverse_half: Lanes<L>,
    v2_inverse_half: Lanes<L>,
    gravity: Lanes<L>,
    inverse_mass: Lanes<L>,
    modulus: [Lanes<L>; MAX_BRANCHES],
    modulus_sum: Lanes<L>,
}

/// The maps at one membrane voltage: polynomials in normalized x.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MapSlice<const L: usize> {
    pub(super) force: [Lanes<L>; FORCE_POINTS_X],
    pub(super) branches: [[Lanes<L>; CHANNELS]; BRANCH_POINTS_X],
}

/// Where `L` twins stand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Motion<const L: usize> {
    /// Displacement below the frame, m.
    pub(super) x: Lanes<L>,
    /// Velocity, m/s.
    pub(super) v: Lanes<L>,
    pub(super) membrane_v: Lanes<L>,
    /// Dashpots, in the unit of the strain coordinates: `[mode][branch]`.
    pub(super) zeta: [[Lanes<L>; MAX_BRANCHES]; STRAIN_MODES],
    /// Acceleration by weight and membrane alone, m/s^2.
    pub(super) free: Lanes<L>,
    /// E_k.
    pub(super) strain: [Lanes<L>; STRAIN_MODES],
}

/// What the branches' memory leaves to an instant: they pull with `modulus E_k - held_k`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Memory<const L: usize> {
    modulus: Lanes<L>,
    held: [Lanes<L>; STRAIN_MODES],
}

/// The membrane at one displacement.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pull<const L: usize> {
    /// Acceleration by weight and membrane, m/s^2.
    pub(super) free: Lanes<L>,
    /// -d(free)/dx with the dashpots held, 1/s^2, but for the second derivatives of the strains.
    stiffness: Lanes<L>,
    pub(super) strain: [Lanes<L>; STRAIN_MODES],
}

impl<const L: usize> Plant<L> {
    /// `masses` in kg.
    pub(super) fn new(models: &[&TwinModel; L], masses: &[f64; L]) -> Self {
        let lanes = |f: &dyn Fn(&TwinModel) -> f64| Lanes::from_fn(|k| f(models[k]));
        let spec =
            |f: &dyn Fn(&crate::ActuatorSpec) -> f64| Lanes::from_fn(|k| f(models[k].parameters.spec()));
        Self {
            force: std::array::from_fn(|iy| {
                std::array::from_fn(|ix| lanes(&|m| m.force.coefficients()[iy][ix]))
            }),
            branches: std::array::from_fn(|iy| {
                std::array::from_fn(|ix| {
                    std::array::from_fn(|c| lanes(&|m| m.branches.coefficients()[iy][ix][c]))
                })
            }),
            x_center: lanes(&|m| m.x_axis.center()),
            x_inverse_half: lanes(&|m| m.x_axis.inverse_half()),
            v2_inverse_half: lanes(&|m| m.v2_axis.inverse_half()),
            gravity: spec(&|s| s.gravity_m_per_s2),
            inverse_mass: Lanes::from_fn(|k| 1.0 / masses[k]),
            modulus: std::array::from_fn(|i| spec(&|s| s.branches.get(i).map_or(0.0, |b| b.modulus_pa))),
            modulus_sum: lanes(&|m| m.parameters.branch_modulus_pa()),
        }
    }

    /// The maps at a membrane voltage.
    #[inline(always)]
    pub(super) fn slice<const FUSED: bool>(&self, voltage_v: Lanes<L>) -> MapSlice<L> {
        // The axis of V^2 starts at zero, so that its centre is normalized to -1.
        let y = (voltage_v * voltage_v).times_plus::<FUSED>(self.v2_inverse_half, Lanes::all(-1.0));
        let mut force = self.force[FORCE_POINTS_V2 - 1];
        for iy in (0..FORCE_POINTS_V2 - 1).rev() {
            for ix in 0..FORCE_POINTS_X {
                force[ix] = force[ix].times_plus::<FUSED>(y, self.force[iy][ix]);
            }
        }
        let mut branches = self.branches[BRANCH_POINTS_V2 - 1];
        for iy in (0..BRANCH_POINTS_V2 - 1).rev() {
            for ix in 0..BRANCH_POINTS_X {
                for c in 0..CHANNELS {
                    branches[ix][c] = branches[ix][c].times_plus::<FUSED>(y, self.branches[iy][ix][c]);
                }
            }
        }
        MapSlice { force, branches }
    }

    /// The branches' memory at the present instant.
    #[inline(always)]
    pub(super) fn memory_now<const FUSED: bool>(&self, at: &Motion<L>) -> Memory<L> {
        let held = at.zeta.map(|zeta| weighted::<L, FUSED>(&self.modulus, &zeta, Lanes::ZERO));
        Memory { modulus: self.modulus_sum, held }
    }

    /// The branches' memory half a step later.
    #[inline(always)]
    pub(super) fn memory_half<const FUSED: bool>(&self, pace: &Pace<L>, at: &Motion<L>) -> Memory<L> {
        let mut held = [Lanes::ZERO; STRAIN_MODES];
        for k in 0..STRAIN_MODES {
            let strain = pace.half_start * at.strain[k];
            held[k] = weighted::<L, FUSED>(&pace.held_half, &at.zeta[k], strain);
        }
        Memory { modulus: pace.half_modulus, held }
    }

    /// The branches' memory a whole step later, with the strains halfway.
    #[inline(always)]
    pub(super) fn memory_full<const FUSED: bool>(
        &self,
        pace: &Pace<L>,
        at: &Motion<L>,
        middle: &[Lanes<L>; STRAIN_MODES],
    ) -> Memory<L> {
        let mut held = [Lanes::ZERO; STRAIN_MODES];
        for k in 0..STRAIN_MODES {
            let strain = pace.full_middle.times_plus::<FUSED>(middle[k], pace.full_start * at.strain[k]);
            held[k] = weighted::<L, FUSED>(&pace.held, &at.zeta[k], strain);
        }
        Memory { modulus: pace.full_modulus, held }
    }

    /// What weight and membrane do to the plate at `x`.
    ///
    /// **Method**: the internal amplitude is in balance, K a + modulus (c_0 + a) - held_0 = 0. Beyond the map force and
    /// strains go on linearly and K stays.
    #[inline(always)]
    pub(super) fn pull<const FUSED: bool>(
        &self,
        slice: &MapSlice<L>,
        memory: &Memory<L>,
        x: Lanes<L>,
    ) -> Pull<L> {
        let raw = (x - self.x_center) * self.x_inverse_half;
        let u = raw.within_one();
        let excess = raw - u;
        let mut force = slice.force[FORCE_POINTS_X - 1];
        let mut slope = Lanes::ZERO;
        for ix in (0..FORCE_POINTS_X - 1).rev() {
            slope = slope.times_plus::<FUSED>(u, force);
            force = force.times_plus::<FUSED>(u, slice.force[ix]);
        }
        let mut value = slice.branches[BRANCH_POINTS_X - 1];
        let mut by_u = [Lanes::ZERO; CHANNELS];
        for row in slice.branches[..BRANCH_POINTS_X - 1].iter().rev() {
            for c in 0..CHANNELS {
                by_u[c] = by_u[c].times_plus::<FUSED>(u, value[c]);
                value[c] = value[c].times_plus::<FUSED>(u, row[c]);
            }
        }
        let internal_stiffness = value[STRAIN_MODES];
        let mut stiffening = by_u[STRAIN_MODES];
        if excess.any() {
            force = slope.times_plus::<FUSED>(excess, force);
            for k in 0..STRAIN_MODES {
                value[k] = by_u[k].times_plus::<FUSED>(excess, value[k]);
            }
            stiffening = Lanes::from_fn(|k| if excess.0[k] == 0.0 { stiffening.0[k] } else { 0.0 });
        }
        let mut strain = [value[0], value[1], value[2]];
        let load = memory.held[0] - memory.modulus * strain[0];
        let internal = load.over(internal_stiffness + memory.modulus);
        strain[0] = strain[0] + internal;
        let mut branches = internal * internal * Lanes::all(0.5) * stiffening;
        let mut along = Lanes::ZERO;
        for k in 0..STRAIN_MODES {
            branches = by_u[k].times_plus::<FUSED>(memory.modulus * strain[k] - memory.held[k], branches);
            along = by_u[k].times_plus::<FUSED>(by_u[k], along);
        }
        let force = branches.times_plus::<FUSED>(self.x_inverse_half, force);
        let slope = (memory.modulus * along).times_plus::<FUSED>(self.x_inverse_half, slope);
        Pull {
            free: self.gravity - force * self.inverse_mass,
            stiffness: slope * self.x_inverse_half * self.inverse_mass,
            strain,
        }
    }

    /// Acceleration and strains at the present instant: what a step starts from.
    #[inline(always)]
    pub(super) fn refresh<const FUSED: bool>(&self, motion: &mut Motion<L>) {
        let slice = self.slice::<FUSED>(motion.membrane_v);
        let pull = self.pull::<FUSED>(&slice, &self.memory_now::<FUSED>(motion), motion.x);
        motion.free = pull.free;
        motion.strain = pull.strain;
    }

    /// Relaxes the branches where the plate stands, and refreshes.
    pub(super) fn relax(&self, motion: &mut Motion<L>) {
        let slice = self.slice::<false>(motion.membrane_v);
        // Without memory the internal mode does not move: the strains are those of the relaxed membrane.
        let absent = Memory { modulus: Lanes::ZERO, held: [Lanes::ZERO; STRAIN_MODES] };
        let relaxed = self.pull::<false>(&slice, &absent, motion.x).strain;
        motion.zeta = relaxed.map(|strain| [strain; MAX_BRANCHES]);
        self.refresh::<false>(motion);
    }

    /// Acceleration by a force on the plate, m/s^2.
    #[inline(always)]
    pub(super) fn acceleration(&self, force_n: Lanes<L>) -> Lanes<L> {
        force_n * self.inverse_mass
    }

    /// One step of a plate without contact, with `drive_v` and the acceleration `pushed` held.
    ///
    /// **Method**: Nystrom's method of order four; circuit, damping and dashpots exactly. The last of its three evaluations
    /// serves as the first of the next step, carried over the small way to the new displacement by the stiffness there.
    #[inline(always)]
    pub(super) fn step<const FUSED: bool>(
        &self,
        pace: &Pace<L>,
        at: &mut Motion<L>,
        drive_v: Lanes<L>,
        pushed: Lanes<L>,
    ) {
        let v_half = (at.membrane_v - drive_v).times_plus::<FUSED>(pace.circuit_half, drive_v);
        let v_end = (v_half - drive_v).times_plus::<FUSED>(pace.circuit_half, drive_v);
        let g_start = at.free + pushed;

        let x_middle =
            pace.push_half.times_plus::<FUSED>(g_start, pace.glide_half.times_plus::<FUSED>(at.v, at.x));
        let slice = self.slice::<FUSED>(v_half);
        let middle = self.pull::<FUSED>(&slice, &self.memory_half::<FUSED>(pace, at), x_middle);
        let g_middle = middle.free + pushed;

        let glided = pace.glide.times_plus::<FUSED>(at.v, at.x);
        let x_end = pace.push.times_plus::<FUSED>(g_middle, glided);
        let slice = self.slice::<FUSED>(v_end);
        let end = self.pull::<FUSED>(&slice, &self.memory_full::<FUSED>(pace, at, &middle.strain), x_end);
        let g_end = end.free + pushed;

        let g = [g_start, g_middle, g_end];
        let (mut x, mut v) = (glided, at.v * pace.brake);
        for j in 0..3 {
            x = pace.moves[j].times_plus::<FUSED>(g[j], x);
            v = pace.kicks[j].times_plus::<FUSED>(g[j], v);
        }
        at.free = end.free - end.stiffness * (x - x_end);
        at.x = x;
        at.v = v;
        at.membrane_v = v_end;
        at.remember::<FUSED>(pace, &middle.strain, &end.strain);
    }

    /// By how much a displacement lies outside of the map, in half its width; zero inside.
    #[inline(always)]
    pub(super) fn excess(&self, x: Lanes<L>) -> Lanes<L> {
        let raw = (x - self.x_center) * self.x_inverse_half;
        raw - raw.within_one()
    }
}

impl<const L: usize> Motion<L> {
    /// Moves the dashpots by a step, given the strains halfway and at its end.
    #[inline(always)]
    pub(super) fn remember<const FUSED: bool>(
        &mut self,
        pace: &Pace<L>,
        middle: &[Lanes<L>; STRAIN_MODES],
        end: &[Lanes<L>; STRAIN_MODES],
    ) {
        for k in 0..STRAIN_MODES {
            for i in 0..MAX_BRANCHES {
                let mut zeta = pace.decay[i] * self.zeta[k][i];
                zeta = pace.start[i].times_plus::<FUSED>(self.strain[k], zeta);
                zeta = pace.middle[i].times_plus::<FUSED>(middle[k], zeta);
                self.zeta[k][i] = pace.end[i].times_plus::<FUSED>(end[k], zeta);
            }
        }
        self.strain = *end;
    }
}

/// Sum of products over the branches, on top of `sum`.
#[inline(always)]
fn weighted<const L: usize, const FUSED: bool>(
    weights: &[Lanes<L>; MAX_BRANCHES],
    values: &[Lanes<L>; MAX_BRANCHES],
    sum: Lanes<L>,
) -> Lanes<L> {
    let one = weights[0].times_plus::<FUSED>(values[0], weights[1] * values[1]);
    let two = weights[2].times_plus::<FUSED>(values[2], weights[3].times_plus::<FUSED>(values[3], sum));
    one + two
}
