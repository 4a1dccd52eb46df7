//! Where the energy is, and where it went.

/// Stored energy at one instant, J.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StoredEnergy {
    /// Of the plate's motion.
    pub kinetic_j: f64,
    /// Of the relaxed network; zero in the undeformed membrane.
    pub elastic_j: f64,
    /// Of the branches' springs.
    pub branches_j: f64,
    /// Of the electric field, C Phi^2/2.
    pub electrical_j: f64,
}

impl StoredEnergy {
    /// Sum of all parts, J.
    #[must_use]
    pub fn total_j(&self) -> f64 {
        self.kinetic_j + self.elastic_j + self.branches_j + self.electrical_j
    }
}

/// Energy that has passed since the start, J.
///
/// **Accuracy**: powers are integrated with the weights of the time step, so the balance closes as well as the method of
/// order five does; the weights are positive, so what a part dissipates never falls.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct EnergyFlow {
    /// Work of gravity on the plate.
    pub gravity_j: f64,
    /// Work of the disturbance force on the plate.
    pub disturbance_j: f64,
    /// Work of the contact on the plate.
    pub contact_j: f64,
    /// Work of the amplifier at its output.
    pub source_j: f64,
    /// Work of what changed the modulus ([`FieldTwin::set_modulus_factor`](super::FieldTwin::set_modulus_factor)).
    pub ageing_j: f64,
    /// Dissipated by the damper on the plate.
    pub damper_j: f64,
    /// Dissipated by the branches' dashpots.
    pub branches_j: f64,
    /// Dissipated by the series resistor, and in the amplifier where the current is at its limit.
    pub series_j: f64,
    /// Dissipated by the leak across the electrodes.
    pub leak_j: f64,
}

impl EnergyFlow {
    /// Work done on the actuator, J.
    #[must_use]
    pub fn work_j(&self) -> f64 {
        self.gravity_j + self.disturbance_j + self.contact_j + self.source_j + self.ageing_j
    }

    /// Dissipated energy, J.
    #[must_use]
    pub fn dissipated_j(&self) -> f64 {
        self.damper_j + self.branches_j + self.series_j + self.leak_j
    }

    /// Adds `duration_s` times the powers in `rate`.
    pub(super) fn add(&mut self, rate: &Self, duration_s: f64) {
        self.gravity_j += duration_s * rate.gravity_j;
        self.disturbance_j += duration_s * rate.disturbance_j;
        self.contact_j += duration_s * rate.contact_j;
        self.source_j += duration_s * rate.source_j;
        self.damper_j += duration_s * rate.damper_j;
        self.branches_j += duration_s * rate.branches_j;
        self.series_j += duration_s * rate.series_j;
        self.leak_j += duration_s * rate.leak_j;
    }
}
