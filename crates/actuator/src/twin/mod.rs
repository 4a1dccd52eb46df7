//! The reduced twin: plate, membrane maps, Maxwell branches and circuit, thousands of times faster than real time.

mod branch_reduction;
mod model;
mod surface;

pub use model::{MapRange, TwinModel};

use branch_reduction::{BranchPoint, BranchSlice, STRAIN_MODES, branch_point};
use model::FORCE_POINTS_X;
use surface::{Slice, slope, value};

use crate::MAX_BRANCHES;

/// What stands on the plate beside the membrane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlateLoad {
    /// Moving mass, kg.
    pub mass_kg: f64,
    /// What holds the plate from above, if anything.
    pub contact: Option<Contact>,
}

/// A spring and damper between the plate and a fixed base above it, which can push the plate down and cannot pull.
///
/// **Sign**: the contact force is positive in compression, that is while the membrane pushes the plate up against it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Stiffness, N/m.
    pub stiffness_n_per_m: f64,
    /// Damping, N s/m.
    pub damping_n_s_per_m: f64,
    /// Displacement of the plate from rest at which the spring just touches it, mm; above (below in value) it presses.
    pub touch_mm: f64,
}

/// What acts from outside during one interval.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Inputs {
    /// Amplifier voltage, V; limited to 0..full scale by the amplifier.
    pub drive_v: f64,
    /// Disturbance force on the plate, N, positive down.
    pub disturbance_n: f64,
}

/// State of the reduced twin.
#[derive(Debug, Clone, Copy, PartialEq)]
struct State {
    /// Displacement below the frame, m.
    x: f64,
    /// Velocity, m/s.
    v: f64,
    /// Dashpots, in the unit of the strain coordinates: `[mode][branch]`. Branches that do not exist have modulus 0.
    zeta: [[f64; MAX_BRANCHES]; STRAIN_MODES],
}

/// The maps at one membrane voltage: polynomials in normalized x.
#[derive(Debug, Clone, Copy, PartialEq)]
struct MapSlice {
    force: Slice<FORCE_POINTS_X>,
    branches: BranchSlice,
}

/// A twin in motion.
///
/// **Method**: classical fourth-order Runge-Kutta with a fixed step; the circuit is integrated exactly, since the drive is
/// held over a step. A step neither allocates nor branches on data (but for the map's edges).
///
/// **Accuracy**: at the default step of 0.5 ms the plate is within 1e-7 mm of a step eight times finer (tests).
#[derive(Debug, Clone, PartialEq)]
pub struct Twin {
    model: TwinModel,
    load: PlateLoad,
    /// Weight of the moving mass, N.
    weight: f64,
    inverse_mass: f64,
    damping: f64,
    max_step: f64,
    branches: Branches,
    state: State,
    membrane_v: f64,
    drive_v: f64,
    slice: MapSlice,
    left_map: bool,
}

/// Branch moduli and rates in fixed room, zero where there is no branch.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Branches {
    modulus: [f64; MAX_BRANCHES],
    rate: [f64; MAX_BRANCHES],
    /// Sum of the moduli.
    sum: f64,
}

/// Step that resolves the plate on the membrane (6 Hz) and the circuit (4.5 ms), one tick at 2 kHz, s.
const DEFAULT_STEP_S: f64 = 0.5e-3;
/// Steps per radian of the fastest contact mode.
const CONTACT_STEPS_PER_RADIAN: f64 = 4.0;

impl Twin {
    /// The twin under its own load, at rest at zero voltage, with its branches relaxed.
    #[must_use]
    pub fn new(model: &TwinModel) -> Self {
        let mass_kg = model.parameters().spec().mass_kg;
        Self::with_load(model, PlateLoad { mass_kg, contact: None })
    }

    /// The twin under another load, at the displacement of the rest position, with its branches relaxed.
    #[must_use]
    pub fn with_load(model: &TwinModel, load: PlateLoad) -> Self {
        let spec = model.parameters().spec();
        let mut branches = Branches {
            modulus: [0.0; MAX_BRANCHES],
            rate: [0.0; MAX_BRANCHES],
            sum: model.parameters().branch_modulus_pa(),
        };
        for (idx, branch) in spec.branches.iter().enumerate() {
            branches.modulus[idx] = branch.modulus_pa;
            branches.rate[idx] = 1.0 / branch.relaxation_time_s;
        }
        let max_step = load.contact.map_or(DEFAULT_STEP_S, |contact| {
            let omega = (contact.stiffness_n_per_m / load.mass_kg).sqrt();
            DEFAULT_STEP_S.min(1.0 / (CONTACT_STEPS_PER_RADIAN * omega))
        });
        let mut twin = Self {
            load,
            weight: load.mass_kg * spec.gravity_m_per_s2,
            inverse_mass: 1.0 / load.mass_kg,
            damping: spec.damping_n_s_per_m,
            max_step,
            branches,
            state: State { x: model.rest_sag, v: 0.0, zeta: [[0.0; MAX_BRANCHES]; STRAIN_MODES] },
            membrane_v: 0.0,
            drive_v: 0.0,
            slice: map_slice(model, 0.0),
            left_map: false,
            model: model.clone(),
        };
        twin.settle(0.0);
        twin
    }

    /// Puts the plate at rest, the circuit and all branches in their final state under `bias_v`.
    ///
    /// **Method**: Newton on the relaxed force balance with the map's own slope, at most 50 iterations; monotone, since the
    /// membrane and the contact both stiffen the plate.
    pub fn settle(&mut self, bias_v: f64) {
        self.drive_v = self.saturate(bias_v);
        self.membrane_v = self.drive_v;
        self.slice = map_slice(&self.model, self.membrane_v);
        self.state.v = 0.0;
        for _ in 0..50 {
            let (u, excess) = self.clamped(self.state.x);
            let map_slope = slope(&self.slice.force, u);
            let force = value(&self.slice.force, u) + excess * map_slope;
            let contact = self.contact_force(self.state.x, 0.0);
            let contact_stiffness =
                self.load.contact.filter(|_| contact > 0.0).map_or(0.0, |c| c.stiffness_n_per_m);
            let stiffness = map_slope * self.model.x_axis.inverse_half() + contact_stiffness;
            let step = (self.weight + contact - force) / stiffness;
            self.state.x += step;
            if step.abs() < 1e-15 {
                break;
            }
        }
        let (u, excess) = self.clamped(self.state.x);
        let relaxed = branch_point(&self.slice.branches, u, excess).strain;
        self.state.zeta = relaxed.map(|strain| [strain; MAX_BRANCHES]);
        self.left_map = false;
    }

    /// Advances by `duration_s` with `inputs` held.
    ///
    /// The interval is divided into equal steps no longer than the step chosen for the load.
    pub fn advance(&mut self, duration_s: f64, inputs: Inputs) {
        self.drive_v = self.saturate(inputs.drive_v);
        // Negative, zero and NaN durations do nothing.
        if duration_s.is_nan() || duration_s <= 0.0 {
            return;
        }
        // A thousandth of a step of slack keeps a rounded tick from costing one more step.
        let n_steps = (duration_s / self.max_step - 1e-3).ceil().max(1.0);
        let h = duration_s / n_steps;
        let half_decay = (-0.5 * h / self.model.parameters.spec().rc_s).exp();
        for _ in 0..n_steps as u64 {
            self.step(h, half_decay, inputs.disturbance_n);
        }
    }

    /// One Runge-Kutta step; `half_decay` is exp(-h/(2 RC)).
    fn step(&mut self, h: f64, half_decay: f64, disturbance: f64) {
        let v_half = self.drive_v + (self.membrane_v - self.drive_v) * half_decay;
        let v_end = self.drive_v + (v_half - self.drive_v) * half_decay;
        let slice_half = map_slice(&self.model, v_half);
        let slice_end = map_slice(&self.model, v_end);
        let y = self.state;
        let k1 = self.rate(&self.slice, &y, disturbance);
        let k2 = self.rate(&slice_half, &y.moved(&k1, 0.5 * h), disturbance);
        let k3 = self.rate(&slice_half, &y.moved(&k2, 0.5 * h), disturbance);
        let k4 = self.rate(&slice_end, &y.moved(&k3, h), disturbance);
        self.state = y.moved(&k1, h / 6.0).moved(&k2, h / 3.0).moved(&k3, h / 3.0).moved(&k4, h / 6.0);
        self.membrane_v = v_end;
        self.slice = slice_end;
        self.left_map |= self.clamped(self.state.x).1 != 0.0;
    }

    #[inline]
    fn rate(&self, slice: &MapSlice, y: &State, disturbance: f64) -> State {
        let (u, excess) = self.clamped(y.x);
        let mut membrane = value(&slice.force, u);
        if excess != 0.0 {
            membrane += excess * slope(&slice.force, u);
        }
        let mut zeta = [[0.0; MAX_BRANCHES]; STRAIN_MODES];
        if self.branches.sum > 0.0 {
            let point = branch_point(&slice.branches, u, excess);
            let strain = self.strain(&point, y);
            let mut force = 0.5 * strain.internal * strain.internal * point.stiffness_slope;
            for (k, rates) in zeta.iter_mut().enumerate() {
                let mut along = [0.0; MAX_BRANCHES];
                for idx in 0..MAX_BRANCHES {
                    let stretch = strain.total[k] - y.zeta[k][idx];
                    rates[idx] = self.branches.rate[idx] * stretch;
                    along[idx] = self.branches.modulus[idx] * stretch;
                }
                force += point.strain_slope[k] * lane_sum(&along);
            }
            membrane += force * self.model.x_axis.inverse_half();
        }
        let force = self.weight + disturbance - membrane - self.damping * y.v + self.contact_force(y.x, y.v);
        State { x: y.v, v: force * self.inverse_mass, zeta }
    }

    /// Strain coordinates with the internal amplitude in balance: a = sum mu_i (zeta_i0 - c_0)/(K + sum mu_i).
    #[inline]
    fn strain(&self, point: &BranchPoint, y: &State) -> Strain {
        let mut total = point.strain;
        let load: [f64; MAX_BRANCHES] =
            std::array::from_fn(|idx| self.branches.modulus[idx] * (y.zeta[0][idx] - total[0]));
        let internal = lane_sum(&load) / (point.stiffness + self.branches.sum);
        total[0] += internal;
        Strain { total, internal }
    }

    /// Compressive force of the contact, which pushes the plate down, N.
    #[inline]
    fn contact_force(&self, x: f64, v: f64) -> f64 {
        self.load.contact.map_or(0.0, |contact| {
            let compression = self.model.rest_sag + contact.touch_mm * 1e-3 - x;
            if compression > 0.0 {
                (contact.stiffness_n_per_m * compression - contact.damping_n_s_per_m * v).max(0.0)
            } else {
                0.0
            }
        })
    }

    /// Normalized x within the map, and by how much it was exceeded.
    #[inline]
    fn clamped(&self, x: f64) -> (f64, f64) {
        let u = self.model.x_axis.normalized(x);
        let inside = u.clamp(-1.0, 1.0);
        (inside, u - inside)
    }

    fn saturate(&self, drive_v: f64) -> f64 {
        if drive_v.is_nan() { 0.0 } else { drive_v.clamp(0.0, self.model.parameters.spec().full_scale_v) }
    }

    /// The maps this twin runs on.
    #[must_use]
    pub fn model(&self) -> &TwinModel {
        &self.model
    }

    /// Longest step it takes, s.
    #[must_use]
    pub fn max_step_s(&self) -> f64 {
        self.max_step
    }

    /// Displacement from the rest position, mm, positive down.
    #[must_use]
    pub fn displacement_mm(&self) -> f64 {
        (self.state.x - self.model.rest_sag) * 1e3
    }

    /// Velocity of the plate, mm/s, positive down.
    #[must_use]
    pub fn velocity_mm_per_s(&self) -> f64 {
        self.state.v * 1e3
    }

    /// Voltage across the membrane, V.
    #[must_use]
    pub fn membrane_voltage_v(&self) -> f64 {
        self.membrane_v
    }

    /// Compressive force between plate and contact, N; zero without a contact.
    #[must_use]
    pub fn contact_force_n(&self) -> f64 {
        self.contact_force(self.state.x, self.state.v)
    }

    /// Current from the amplifier, A: charging current C Phi' and the leak across the amplifier's output.
    #[must_use]
    pub fn supply_current_a(&self) -> f64 {
        let spec = self.model.parameters.spec();
        let charging = self.model.capacitance_f(self.displacement_mm(), self.membrane_v)
            * (self.drive_v - self.membrane_v)
            / spec.rc_s;
        charging + self.drive_v / spec.leak_resistance_ohm
    }

    /// Power from the amplifier, W; current that flows back counts as zero.
    #[must_use]
    pub fn supply_power_w(&self) -> f64 {
        self.drive_v * self.supply_current_a().max(0.0)
    }

    /// Energy of the moving parts, J, relative to the settled state at zero voltage: kinetic, membrane and branches, minus
    /// the work of weight. Constant voltage only: the electrical co-energy is part of the membrane's.
    #[must_use]
    pub fn energy_j(&self) -> f64 {
        let half = self.model.x_axis.half();
        let (u, excess) = self.clamped(self.state.x);
        let rest = self.model.x_axis.normalized(self.model.rest_sag);
        // Gauss-Legendre with 6 points is exact for the map's degree 7.
        let membrane: f64 = GAUSS
            .iter()
            .map(|(node, weight)| {
                let at = rest + (u - rest) * 0.5 * (1.0 + node);
                0.5 * weight * value(&self.slice.force, at)
            })
            .sum::<f64>()
            * (u - rest)
            * half
            + half * excess * (value(&self.slice.force, u) + 0.5 * excess * slope(&self.slice.force, u));
        let point = branch_point(&self.slice.branches, u, excess);
        let strain = self.strain(&point, &self.state);
        let mut branches = 0.5 * strain.internal * strain.internal * point.stiffness;
        for (zeta, total) in self.state.zeta.iter().zip(&strain.total) {
            for (z, modulus) in zeta.iter().zip(&self.branches.modulus) {
                branches += 0.5 * modulus * (total - z) * (total - z);
            }
        }
        0.5 * self.load.mass_kg * self.state.v * self.state.v + membrane + branches
            - self.weight * (self.state.x - self.model.rest_sag)
    }

    /// True once the plate has left the range of the maps, beyond which they are continued linearly.
    #[must_use]
    pub fn has_left_map(&self) -> bool {
        self.left_map
    }
}

impl State {
    /// `self + h rate`.
    #[inline]
    fn moved(&self, rate: &Self, h: f64) -> Self {
        let mut next = *self;
        next.x += h * rate.x;
        next.v += h * rate.v;
        for k in 0..STRAIN_MODES {
            for idx in 0..MAX_BRANCHES {
                next.zeta[k][idx] += h * rate.zeta[k][idx];
            }
        }
        next
    }
}

/// Sum over branches in two independent pairs.
#[inline]
fn lane_sum(lanes: &[f64; MAX_BRANCHES]) -> f64 {
    (lanes[0] + lanes[2]) + (lanes[1] + lanes[3])
}

/// Strain coordinates at one state.
#[derive(Debug, Clone, Copy)]
struct Strain {
    /// E_k.
    total: [f64; STRAIN_MODES],
    /// Amplitude of the internal mode.
    internal: f64,
}

#[inline]
fn map_slice(model: &TwinModel, voltage_v: f64) -> MapSlice {
    let y = model.normalized_v2(voltage_v);
    MapSlice { force: model.force.slice(y), branches: model.branches.slice(y) }
}

/// Nodes and weights of 6-point Gauss-Legendre quadrature on -1..1. Source: Abramowitz and Stegun, table 25.4.
const GAUSS: [(f64, f64); 6] = [
    (-0.932_469_514_203_152, 0.171_324_492_379_170),
    (-0.661_209_386_466_265, 0.360_761_573_048_139),
    (-0.238_619_186_083_197, 0.467_913_934_572_691),
    (0.238_619_186_083_197, 0.467_913_934_572_691),
    (0.661_209_386_466_265, 0.360_761_573_048_139),
    (0.932_469_514_203_152, 0.171_324_492_379_170),
];
