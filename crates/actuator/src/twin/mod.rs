//! The reduced twin: plate, membrane maps, Maxwell branches and circuit, thousands of times faster than real time.

mod abreast;
mod arithmetic;
mod branch_reduction;
mod contact;
mod energy;
mod family;
mod fidelity;
mod kernel;
mod model;
mod pace;
mod stated;
mod surface;

pub(crate) use abreast::{N_ABREAST, Passage, run_abreast};
pub use contact::{Contact, ContactLaw, PlateLoad};
pub(crate) use family::{TwinFamily, shape};
pub use fidelity::Fidelity;
pub use model::{MapRange, TwinModel};
pub use stated::StatedError;

use arithmetic::{Baseline, Kernel, Processor, Single};
use kernel::{Motion, Plant};
use pace::{Pace, PaceOf};
use surface::{slope, value};

/// What acts from outside during one interval.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Inputs {
    /// Amplifier voltage, V; limited to 0..full scale by the amplifier.
    pub drive_v: f64,
    /// Disturbance force on the plate, N, positive down.
    pub disturbance_n: f64,
}

/// A twin in motion.
///
/// **Method**: the plate by Nystrom's method of order four with a fixed step, two evaluations of the membrane for each;
/// circuit, damping and the branches' memory are integrated exactly for what is held, linear or parabolic over a step, so
/// that neither a fast circuit nor a fast branch limits the step. A step neither allocates nor branches on data (but for the
/// map's edges). A plate in contact takes Runge-Kutta steps as short as the contact demands.
///
/// **Accuracy**: at steps of 1 ms the plate is within 3e-6 mm of a step sixteen times finer, at 0.5 ms within 3e-7 mm
/// (tests).
#[derive(Debug, Clone, PartialEq)]
pub struct Twin {
    model: TwinModel,
    load: PlateLoad,
    plant: Plant<f64>,
    max_step: f64,
    /// The interval that was advanced last is cut into so many steps of this length, at this pace.
    paced_s: f64,
    n_steps: u64,
    step_s: f64,
    pace: Pace<f64>,
    motion: Motion<f64>,
    drive_v: f64,
    left_map: bool,
}

/// Longest step, s: it resolves the circuit of 4.5 ms.
const LONGEST_STEP_S: f64 = 1e-3;
/// Steps per radian of the plate on its membrane.
const STEPS_PER_RADIAN: f64 = 10.0;
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
        let plant = Plant::new(&[model], &[load.mass_kg]);
        let mut max_step = longest_step(model, load.mass_kg);
        if let Some(contact) = load.contact {
            let omega = (contact.stiffest() / load.mass_kg).sqrt();
            max_step = max_step.min(1.0 / (CONTACT_STEPS_PER_RADIAN * omega));
        }
        let mut twin = Self {
            load,
            plant,
            max_step,
            pace: Pace::new(&[PaceOf::new(model.parameters(), load.mass_kg)], max_step),
            paced_s: max_step,
            n_steps: 1,
            step_s: max_step,
            motion: Motion::at(model.rest_sag),
            drive_v: 0.0,
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
        self.motion.membrane_v = self.drive_v;
        self.motion.v = 0.0;
        let slice = self.model.force.slice(self.model.normalized_v2(self.drive_v));
        let weight = self.load.mass_kg * self.model.parameters.spec().gravity_m_per_s2;
        let mut x = self.motion.x;
        for _ in 0..50 {
            let (u, excess) = self.clamped(x);
            let map_slope = slope(&slice, u);
            let force = value(&slice, u) + excess * map_slope;
            let contact = self.contact_force(x, 0.0);
            let contact_stiffness = self.load.contact.map_or(0.0, |c| c.stiffness(self.model.rest_sag, x));
            let stiffness = map_slope * self.model.x_axis.inverse_half() + contact_stiffness;
            let step = (weight + contact - force) / stiffness;
            x += step;
            if step.abs() < 1e-15 {
                break;
            }
        }
        self.motion.x = x;
        self.plant.relax(Single(Baseline), &mut self.motion);
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
        // Exact comparison: another duration, however close, has another pace.
        if duration_s.to_bits() != self.paced_s.to_bits() {
            let n_steps = n_steps(duration_s, self.max_step);
            self.step_s = duration_s / n_steps;
            self.pace = Pace::new(&[PaceOf::new(self.model.parameters(), self.load.mass_kg)], self.step_s);
            self.n_steps = n_steps as u64;
            self.paced_s = duration_s;
        }
        arithmetic::run(Steps { twin: self, disturbance: inputs.disturbance_n });
    }

    /// Compressive force of the contact, which pushes the plate down, N.
    fn contact_force(&self, x: f64, v: f64) -> f64 {
        self.load.contact.map_or(0.0, |contact| contact.force(self.model.rest_sag, x, v))
    }

    /// Normalized x within the map, and by how much it was exceeded.
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
        (self.motion.x - self.model.rest_sag) * 1e3
    }

    /// Velocity of the plate, mm/s, positive down.
    #[must_use]
    pub fn velocity_mm_per_s(&self) -> f64 {
        self.motion.v * 1e3
    }

    /// Voltage across the membrane, V.
    #[must_use]
    pub fn membrane_voltage_v(&self) -> f64 {
        self.motion.membrane_v
    }

    /// Compressive force between plate and contact, N; zero without a contact.
    #[must_use]
    pub fn contact_force_n(&self) -> f64 {
        self.contact_force(self.motion.x, self.motion.v)
    }

    /// Current from the amplifier, A: charging current C Phi' and the leak across the amplifier's output.
    #[must_use]
    pub fn supply_current_a(&self) -> f64 {
        let spec = self.model.parameters.spec();
        let membrane_v = self.membrane_voltage_v();
        let charging = self.model.capacitance_f(self.displacement_mm(), membrane_v)
            * (self.drive_v - membrane_v)
            / spec.rc_s;
        charging + self.drive_v / spec.leak_resistance_ohm
    }

    /// Power from the amplifier, W; current that flows back counts as zero.
    #[must_use]
    pub fn supply_power_w(&self) -> f64 {
        self.drive_v * self.supply_current_a().max(0.0)
    }

    /// True once the plate has left the range of the maps, beyond which they are continued linearly.
    #[must_use]
    pub fn has_left_map(&self) -> bool {
        self.left_map
    }
}

/// Longest step that resolves the plate of `mass_kg` on its membrane, s.
fn longest_step(model: &TwinModel, mass_kg: f64) -> f64 {
    let omega = (model.stiffest_n_per_m() / mass_kg).sqrt();
    LONGEST_STEP_S.min(1.0 / (STEPS_PER_RADIAN * omega))
}

/// A thousandth of a step of slack keeps a rounded tick from costing one more step.
fn n_steps(duration_s: f64, max_step_s: f64) -> f64 {
    (duration_s / max_step_s - 1e-3).ceil().max(1.0)
}

impl TwinModel {
    /// Steps that a plate under its own load takes over an interval.
    pub(crate) fn n_steps(&self, interval_s: f64) -> usize {
        n_steps(interval_s, longest_step(self, self.parameters.spec().mass_kg)) as usize
    }
}

/// Steps of one twin, compiled for the processor at hand.
struct Steps<'a> {
    twin: &'a mut Twin,
    disturbance: f64,
}

impl Kernel for Steps<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self, processor: impl Processor) {
        let (Self { twin, disturbance }, by) = (self, Single(processor));
        if let Some(contact) = twin.load.contact {
            for _ in 0..twin.n_steps {
                twin.step_in_contact(by, &contact, disturbance);
                twin.left_map |= twin.plant.is_outside(by, twin.motion.x);
            }
            return;
        }
        let pushed = twin.plant.acceleration(by, disturbance);
        for _ in 0..twin.n_steps {
            twin.plant.step(by, &twin.pace, &mut twin.motion, twin.drive_v, pushed);
            twin.left_map |= twin.plant.is_outside(by, twin.motion.x);
        }
    }
}
