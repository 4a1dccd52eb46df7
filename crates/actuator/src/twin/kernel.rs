//! One step of the reduced twin, for one or for four abreast.

use super::arithmetic::{Arithmetic, PerTwin};
use super::branch_reduction::{CHANNELS, STRAIN_MODES};
use super::model::{BRANCH_POINTS_V2, BRANCH_POINTS_X, FORCE_POINTS_V2, FORCE_POINTS_X, TwinModel};
use super::pace::Pace;
use crate::MAX_BRANCHES;

/// Powers of u in a row of the force map, by fours.
const FORCE_FOURS: usize = FORCE_POINTS_X / 4;
const _: () = assert!(FORCE_POINTS_X == 8 && CHANNELS == 4 && STRAIN_MODES == 3);

/// Maps and constants of the twins.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Plant<O: PerTwin> {
    /// `[power of y][power of u]`, N.
    force: [[O::Four; FORCE_FOURS]; FORCE_POINTS_V2],
    /// `[power of y][power of u]` of `[K, c_0, c_1, c_2]`.
    branches: [[O::Four; BRANCH_POINTS_X]; BRANCH_POINTS_V2],
    /// u = x / half - center / half.
    x_inverse_half: O,
    x_center_over_half: O,
    v2_inverse_half: O,
    gravity: O,
    inverse_mass: O,
    modulus: [O; MAX_BRANCHES],
    modulus_sum: O,
}

/// The maps at one membrane voltage: polynomials in normalized x.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MapSlice<O: PerTwin> {
    force: [O::Four; FORCE_FOURS],
    branches: [O::Four; BRANCH_POINTS_X],
}

/// Where the twins stand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Motion<O: PerTwin> {
    /// Displacement below the frame, m.
    pub(super) x: O,
    /// Velocity, m/s.
    pub(super) v: O,
    pub(super) membrane_v: O,
    /// Dashpots in the unit of the strain coordinates: `[branch]` of modes, behind a first place that says nothing.
    pub(super) zeta: [O::Four; MAX_BRANCHES],
    /// Acceleration by weight and membrane alone, m/s^2.
    pub(super) free: O,
    /// E_k, behind a first place that says nothing.
    pub(super) strain: O::Four,
}

/// What the branches' memory leaves to an instant: they pull with `modulus E_k - held_k`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Memory<O: PerTwin> {
    modulus: O,
    held: O::Four,
}

/// The membrane at one displacement.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pull<O: PerTwin> {
    /// Acceleration by weight and membrane, m/s^2.
    pub(super) free: O,
    /// -d(free)/dx with the dashpots held, 1/s^2, but for the second derivatives of the strains.
    stiffness: O,
    pub(super) strain: O::Four,
}

impl<O: PerTwin> Plant<O> {
    /// `masses` in kg.
    pub(super) fn new(models: &[&TwinModel], masses: &[f64]) -> Self {
        let each = |f: &dyn Fn(&TwinModel) -> f64| O::gather(|k| f(models[k]));
        let fours = |f: &dyn Fn(&TwinModel, usize) -> f64| {
            O::four(std::array::from_fn(|c| O::gather(|k| f(models[k], c))))
        };
        let modulus =
            |m: &TwinModel, i: usize| m.parameters.spec().branches.get(i).map_or(0.0, |b| b.modulus_pa);
        Self {
            force: std::array::from_fn(|iy| {
                std::array::from_fn(|four| fours(&|m, c| m.force.coefficients()[iy][4 * four + c]))
            }),
            branches: std::array::from_fn(|iy| {
                std::array::from_fn(|ix| {
                    fours(&|m, c| m.branches.coefficients()[iy][ix][(c + STRAIN_MODES) % CHANNELS])
                })
            }),
            x_inverse_half: each(&|m| m.x_axis.inverse_half()),
            x_center_over_half: each(&|m| m.x_axis.center() * m.x_axis.inverse_half()),
            v2_inverse_half: each(&|m| m.v2_axis.inverse_half()),
            gravity: each(&|m| m.parameters.spec().gravity_m_per_s2),
            inverse_mass: O::gather(|k| 1.0 / masses[k]),
            modulus: std::array::from_fn(|i| each(&|m| modulus(m, i))),
            modulus_sum: each(&|m| m.parameters.branch_modulus_pa()),
        }
    }

    /// The maps at a membrane voltage.
    #[inline(always)]
    pub(super) fn slice<A: Arithmetic<One = O, Four = O::Four>>(&self, by: A, voltage_v: O) -> MapSlice<O> {
        // The axis of V^2 starts at zero, so that its centre is normalized to -1.
        let y = by.mul_add(by.mul(voltage_v, voltage_v), self.v2_inverse_half, by.all(-1.0));
        let mut force = self.force[FORCE_POINTS_V2 - 1];
        for row in self.force[..FORCE_POINTS_V2 - 1].iter().rev() {
            for four in 0..FORCE_FOURS {
                force[four] = by.scale_add(force[four], y, row[four]);
            }
        }
        let mut branches = self.branches[BRANCH_POINTS_V2 - 1];
        for rows in self.branches[..BRANCH_POINTS_V2 - 1].iter().rev() {
            for ix in 0..BRANCH_POINTS_X {
                branches[ix] = by.scale_add(branches[ix], y, rows[ix]);
            }
        }
        MapSlice { force, branches }
    }

    /// The branches' memory at the present instant.
    #[inline(always)]
    fn memory_now<A: Arithmetic<One = O, Four = O::Four>>(&self, by: A, at: &Motion<O>) -> Memory<O> {
        let mut held = by.scale(at.zeta[0], self.modulus[0]);
        for i in 1..MAX_BRANCHES {
            held = by.scale_add(at.zeta[i], self.modulus[i], held);
        }
        Memory { modulus: self.modulus_sum, held }
    }

    /// What weight and membrane do to the plate at `x`.
    ///
    /// **Method**: the internal amplitude is in balance, K a + modulus (c_0 + a) - held_0 = 0. Beyond the map force and
    /// strains go on linearly and K stays.
    #[inline(always)]
    pub(super) fn pull<A: Arithmetic<One = O, Four = O::Four>>(
        &self,
        by: A,
        slice: &MapSlice<O>,
        memory: &Memory<O>,
        x: O,
    ) -> Pull<O> {
        let raw = self.normalized(by, x);
        let outside = by.outside_one(raw);
        let u = if outside { by.within_one(raw) } else { raw };
        let (mut force, mut slope) = polynomial(by, &slice.force, u);
        let mut value = slice.branches[BRANCH_POINTS_X - 1];
        let mut by_u = value;
        value = by.scale_add(value, u, slice.branches[BRANCH_POINTS_X - 2]);
        for row in slice.branches[..BRANCH_POINTS_X - 2].iter().rev() {
            by_u = by.scale_add(by_u, u, value);
            value = by.scale_add(value, u, *row);
        }
        if outside {
            let excess = by.sub(raw, u);
            force = by.mul_add(slope, excess, force);
            // The first place is K, which stays.
            by_u = by.clear_first_unless_zero(by_u, excess);
            value = by.scale_add(by_u, excess, value);
        }
        let internal_stiffness = by.pick::<0>(value);
        let softness = by.div(by.all(1.0), by.add(internal_stiffness, memory.modulus));
        // With p_k = modulus c_k - held_k, the amplitude is -q = -p_0/(K + modulus), and
        // sum of (modulus E_k - held_k) c_k' + q^2 K'/2 = p_1 c_1' + p_2 c_2' + q (K c_0' + q K'/2).
        let p = by.scale_sub(value, memory.modulus, memory.held);
        let q = by.mul(by.pick::<1>(p), softness);
        let stiff = by.mul(internal_stiffness, by.pick::<1>(by_u));
        let inner = by.mul_add(q, by.mul(by.pick::<0>(by_u), by.all(0.5)), stiff);
        let branches = by.mul_add(q, inner, by.dot_upper(p, by_u));
        force = by.mul_add(branches, self.x_inverse_half, force);
        let along = by.pick::<1>(by_u);
        let along = by.mul_add(along, along, by.dot_upper(by_u, by_u));
        slope = by.mul_add(by.mul(memory.modulus, along), self.x_inverse_half, slope);
        Pull {
            free: by.less_mul(self.gravity, force, self.inverse_mass),
            stiffness: by.mul(by.mul(slope, self.x_inverse_half), self.inverse_mass),
            strain: by.less_in_second(value, q),
        }
    }

    /// Displacement in -1..1 over the map.
    #[inline(always)]
    pub(super) fn normalized<A: Arithmetic<One = O, Four = O::Four>>(&self, by: A, x: O) -> O {
        by.mul_sub(x, self.x_inverse_half, self.x_center_over_half)
    }

    /// True where any of the twins is outside of its map.
    #[inline(always)]
    pub(super) fn is_outside<A: Arithmetic<One = O, Four = O::Four>>(&self, by: A, x: O) -> bool {
        by.outside_one(self.normalized(by, x))
    }

    /// Acceleration and strains at the present instant: what a step starts from.
    #[inline(always)]
    pub(super) fn refresh<A: Arithmetic<One = O, Four = O::Four>>(&self, by: A, motion: &mut Motion<O>) {
        let slice = self.slice(by, motion.membrane_v);
        let pull = self.pull(by, &slice, &self.memory_now(by, motion), motion.x);
        motion.free = pull.free;
        motion.strain = pull.strain;
    }

    /// Relaxes the branches where the plate stands, and refreshes.
    pub(super) fn relax<A: Arithmetic<One = O, Four = O::Four>>(&self, by: A, motion: &mut Motion<O>) {
        let slice = self.slice(by, motion.membrane_v);
        // Without memory the internal mode does not move: the strains are those of the relaxed membrane.
        let zero = by.all(0.0);
        let absent = Memory { modulus: zero, held: O::four([zero; 4]) };
        motion.zeta = [self.pull(by, &slice, &absent, motion.x).strain; MAX_BRANCHES];
        self.refresh(by, motion);
    }

    /// Acceleration by a force on the plate, m/s^2.
    #[inline(always)]
    pub(super) fn acceleration<A: Arithmetic<One = O, Four = O::Four>>(&self, by: A, force_n: O) -> O {
        by.mul(force_n, self.inverse_mass)
    }

    /// One step of a plate without contact, with `drive_v` and the acceleration `pushed` held.
    ///
    /// **Method**: Nystrom's method of order four; circuit, damping and dashpots exactly. The last of its three evaluations
    /// serves as the first of the next step, carried over the small way to the new displacement by the stiffness there.
    #[inline(always)]
    pub(super) fn step<A: Arithmetic<One = O, Four = O::Four>>(
        &self,
        by: A,
        pace: &Pace<O>,
        at: &mut Motion<O>,
        drive_v: O,
        pushed: O,
    ) {
        let v_half = pace.toward(by, at.membrane_v, drive_v);
        let v_end = pace.toward(by, v_half, drive_v);
        let g_start = by.add(at.free, pushed);

        let x_middle = by.mul_add(pace.push_half, g_start, by.mul_add(pace.glide_half, at.v, at.x));
        let middle = self.pull(by, &self.slice(by, v_half), &pace.memory_half(by, at), x_middle);
        let g_middle = by.add(middle.free, pushed);

        let glided = by.mul_add(pace.glide, at.v, at.x);
        let x_end = by.mul_add(pace.push, g_middle, glided);
        let memory = pace.memory_full(by, at, middle.strain);
        let end = self.pull(by, &self.slice(by, v_end), &memory, x_end);
        let g_end = by.add(end.free, pushed);

        let (mut x, mut v) = (glided, by.mul(at.v, pace.brake));
        for (j, g) in [g_start, g_middle, g_end].into_iter().enumerate() {
            x = by.mul_add(pace.moves[j], g, x);
            v = by.mul_add(pace.kicks[j], g, v);
        }
        at.free = by.less_mul(end.free, end.stiffness, by.sub(x, x_end));
        at.x = x;
        at.v = v;
        at.membrane_v = v_end;
        at.remember(by, pace, middle.strain, end.strain);
    }
}

impl<O: PerTwin> Pace<O> {
    /// The membrane's voltage half a step later.
    #[inline(always)]
    pub(super) fn toward<A: Arithmetic<One = O, Four = O::Four>>(
        &self,
        by: A,
        voltage_v: O,
        drive_v: O,
    ) -> O {
        by.mul_add(by.sub(voltage_v, drive_v), self.circuit_half, drive_v)
    }

    /// The branches' memory half a step later.
    #[inline(always)]
    pub(super) fn memory_half<A: Arithmetic<One = O, Four = O::Four>>(
        &self,
        by: A,
        at: &Motion<O>,
    ) -> Memory<O> {
        let mut held = by.scale(at.strain, self.half_start);
        for (branch, zeta) in self.branches[..self.n_branches].iter().zip(&at.zeta) {
            held = by.scale_add(*zeta, branch.held_half, held);
        }
        Memory { modulus: self.half_modulus, held }
    }

    /// The branches' memory a whole step later, with the strains halfway.
    #[inline(always)]
    pub(super) fn memory_full<A: Arithmetic<One = O, Four = O::Four>>(
        &self,
        by: A,
        at: &Motion<O>,
        middle: O::Four,
    ) -> Memory<O> {
        let mut held = by.scale_add(middle, self.full_middle, by.scale(at.strain, self.full_start));
        for (branch, zeta) in self.branches[..self.n_branches].iter().zip(&at.zeta) {
            held = by.scale_add(*zeta, branch.held, held);
        }
        Memory { modulus: self.full_modulus, held }
    }
}

impl<O: PerTwin> Motion<O> {
    /// At `x`, still, at zero voltage; to be relaxed.
    pub(super) fn at(x: O) -> Self {
        let zero = O::gather(|_| 0.0);
        let none = O::four([zero; 4]);
        Self { x, v: zero, membrane_v: zero, zeta: [none; MAX_BRANCHES], free: zero, strain: none }
    }

    /// Moves the dashpots by a step, given the strains halfway and at its end.
    #[inline(always)]
    pub(super) fn remember<A: Arithmetic<One = O, Four = O::Four>>(
        &mut self,
        by: A,
        pace: &Pace<O>,
        middle: O::Four,
        end: O::Four,
    ) {
        for (branch, zeta) in pace.branches[..pace.n_branches].iter().zip(&mut self.zeta) {
            let decayed = by.scale_add(self.strain, branch.start, by.scale(*zeta, branch.decay));
            *zeta = by.scale_add(end, branch.end, by.scale_add(middle, branch.middle, decayed));
        }
        self.strain = end;
    }
}

/// Value and derivative of a polynomial of degree seven.
#[inline(always)]
fn polynomial<A: Arithmetic>(by: A, powers: &[A::Four; FORCE_FOURS], u: A::One) -> (A::One, A::One) {
    let [low, high] = *powers;
    let descending = [
        by.pick::<2>(high),
        by.pick::<1>(high),
        by.pick::<0>(high),
        by.pick::<3>(low),
        by.pick::<2>(low),
        by.pick::<1>(low),
        by.pick::<0>(low),
    ];
    let mut slope = by.pick::<3>(high);
    let mut value = by.mul_add(slope, u, descending[0]);
    for coefficient in &descending[1..] {
        slope = by.mul_add(slope, u, value);
        value = by.mul_add(value, u, *coefficient);
    }
    (value, slope)
}
