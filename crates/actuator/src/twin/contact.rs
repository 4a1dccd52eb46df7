//! What stands on the plate, and the step of a plate that something stiff holds.

use super::Twin;
use super::arithmetic::{Arithmetic, PerTwin};

/// What stands on the plate beside the membrane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlateLoad {
    /// Moving mass, kg.
    pub mass_kg: f64,
    /// What holds the plate from above, if anything.
    pub contact: Option<Contact>,
}

/// A body between the plate and a fixed base above it, which can push the plate down and cannot pull.
///
/// **Sign**: the contact force is positive in compression, that is while the membrane pushes the plate up against it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// How it resists.
    pub law: ContactLaw,
    /// Displacement of the plate from rest at which the body just touches it, mm; above (below in value) it presses.
    pub touch_mm: f64,
}

/// Force of a body that is compressed by `d` at the rate `d'`; never negative.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ContactLaw {
    /// `k d + c d'`: a load cell.
    SpringDamper {
        /// k, N/m.
        stiffness_n_per_m: f64,
        /// c, N s/m.
        damping_n_s_per_m: f64,
    },
    /// `k d^p (1 + chi d')`: a fingertip. The loss vanishes with the compression, so that touch and release do not jump.
    ///
    /// **Source**: Hunt and Crossley 1975.
    HuntCrossley {
        /// k, N/m^p.
        stiffness_n_per_m_p: f64,
        /// p, 1 or above; 1.5 for smooth bodies (Hertz).
        exponent: f64,
        /// chi, s/m.
        dissipation_s_per_m: f64,
    },
}

impl Contact {
    /// Compressive force, N, of a plate at `x` that moves with `v`, the rest position being at `rest`.
    #[inline(always)]
    pub(super) fn force(&self, rest: f64, x: f64, v: f64) -> f64 {
        let compression = rest + self.touch_mm * 1e-3 - x;
        if compression <= 0.0 {
            return 0.0;
        }
        match self.law {
            ContactLaw::SpringDamper { stiffness_n_per_m, damping_n_s_per_m } => {
                (stiffness_n_per_m * compression - damping_n_s_per_m * v).max(0.0)
            }
            ContactLaw::HuntCrossley { stiffness_n_per_m_p, exponent, dissipation_s_per_m } => {
                stiffness_n_per_m_p * compression.powf(exponent) * (1.0 - dissipation_s_per_m * v).max(0.0)
            }
        }
    }

    /// Slope of the force over compression at `x`, N/m, the plate at rest.
    pub(super) fn stiffness(&self, rest: f64, x: f64) -> f64 {
        let compression = rest + self.touch_mm * 1e-3 - x;
        if compression <= 0.0 {
            return 0.0;
        }
        match self.law {
            ContactLaw::SpringDamper { stiffness_n_per_m, .. } => stiffness_n_per_m,
            ContactLaw::HuntCrossley { stiffness_n_per_m_p, exponent, .. } => {
                stiffness_n_per_m_p * exponent * compression.powf(exponent - 1.0)
            }
        }
    }

    /// The largest slope that a compression of [`DEEPEST_M`] meets, N/m: what the step must resolve.
    pub(super) fn stiffest(&self) -> f64 {
        self.stiffness(DEEPEST_M, self.touch_mm * 1e-3)
    }
}

/// Deeper than a plate of this device can press, m.
const DEEPEST_M: f64 = 3e-3;

impl Twin {
    /// One step of a plate in contact.
    ///
    /// **Method**: classical Runge-Kutta of order four for plate and contact, since the contact's force may jump; circuit and
    /// dashpots exactly, as without contact.
    #[inline(always)]
    pub(super) fn step_in_contact<A>(&mut self, by: A, contact: &Contact, disturbance: f64)
    where
        A: Arithmetic<One = f64, Four = <f64 as PerTwin>::Four>,
    {
        let (plant, pace, h) = (&self.plant, &self.pace, self.step_s);
        let at = self.motion;
        let (x, v, rest) = (at.x, at.v, self.model.rest_sag);
        let damping = self.model.parameters.spec().damping_n_s_per_m;
        let acceleration = |free: f64, x: f64, v: f64| {
            free + plant.acceleration(by, disturbance + contact.force(rest, x, v) - damping * v)
        };
        let v_half = pace.toward(by, at.membrane_v, self.drive_v);
        let v_end = pace.toward(by, v_half, self.drive_v);
        let (slice, memory) = (plant.slice(by, v_half), pace.memory_half(by, &at));
        let a1 = acceleration(at.free, x, v);
        let (x2, v2) = (x + 0.5 * h * v, v + 0.5 * h * a1);
        let a2 = acceleration(plant.pull(by, &slice, &memory, x2).free, x2, v2);
        let (x3, v3) = (x + 0.5 * h * v2, v + 0.5 * h * a2);
        let middle = plant.pull(by, &slice, &memory, x3);
        let a3 = acceleration(middle.free, x3, v3);
        let (x4, v4) = (x + h * v3, v + h * a3);
        let memory = pace.memory_full(by, &at, middle.strain);
        let end = plant.pull(by, &plant.slice(by, v_end), &memory, x4);
        let a4 = acceleration(end.free, x4, v4);
        self.motion.x = x + h / 6.0 * (v + 2.0 * (v2 + v3) + v4);
        self.motion.v = v + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4);
        self.motion.membrane_v = v_end;
        self.motion.remember(by, pace, middle.strain, end.strain);
        plant.refresh(by, &mut self.motion);
    }
}
