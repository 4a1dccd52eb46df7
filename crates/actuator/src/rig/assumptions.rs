//! The numbers of the rigs that no source gives.

/// One assumed number, for the report.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RigAssumption {
    /// What it is.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// Its unit.
    pub unit: &'static str,
    /// Why this value.
    pub reason: &'static str,
}

pub(super) const LASER_STANDOFF_MM: f64 = 50.0;
pub(super) const LASER_MIN_MM: f64 = 30.0;
pub(super) const LASER_MAX_MM: f64 = 70.0;
pub(super) const LASER_NOISE_RMS_MM: f64 = 0.003;
pub(super) const LASER_RESOLUTION_MM: f64 = 0.001;
pub(super) const FORCE_PLATE_MASS_KG: f64 = 0.005;
pub(super) const CELL_STIFFNESS_N_PER_M: f64 = 16_000.0;
pub(super) const CELL_DAMPING_RATIO: f64 = 0.1;
pub(super) const CELL_RANGE_N: f64 = 2.45;
pub(super) const CELL_NOISE_RMS_N: f64 = 0.0005;
pub(super) const CELL_RESOLUTION_N: f64 = 0.0001;
const LEAK_RESISTANCE_MOHM: f64 = 27.4;

/// Every number of the rigs that is assumed and not taken from the paper.
#[must_use]
pub fn rig_assumptions() -> &'static [RigAssumption] {
    &ASSUMPTIONS
}

const fn assume(name: &'static str, value: f64, unit: &'static str, reason: &'static str) -> RigAssumption {
    RigAssumption { name, value, unit, reason }
}

const ASSUMPTIONS: [RigAssumption; 11] = [
    assume(
        "laser stand-off at rest",
        LASER_STANDOFF_MM,
        "mm",
        "middle of the named sensor's range of 30 to 70 mm; the paper does not say where the plate stood",
    ),
    assume(
        "laser noise, white, rms",
        LASER_NOISE_RMS_MM,
        "mm",
        "the paper names the sensor and not its noise; typical of a triangulation laser of 40 mm range",
    ),
    assume(
        "laser resolution",
        LASER_RESOLUTION_MM,
        "mm",
        "the paper names the sensor and not its steps; 1 um is typical of this class",
    ),
    assume(
        "moving mass in force mode",
        FORCE_PLATE_MASS_KG,
        "kg",
        "two wooden covering plates without the calibration weight; the paper does not give their mass",
    ),
    assume(
        "load cell stiffness",
        CELL_STIFFNESS_N_PER_M,
        "N/m",
        "250 g full scale over about 0.15 mm of deflection, typical of a small beam cell",
    ),
    assume(
        "load cell damping ratio",
        CELL_DAMPING_RATIO,
        "1",
        "lightly damped beam with an elastomer against it",
    ),
    assume("load cell range", CELL_RANGE_N, "N", "250 g full scale"),
    assume(
        "load cell noise, white, rms",
        CELL_NOISE_RMS_N,
        "N",
        "0.02 % of full scale, typical of a bridge amplifier",
    ),
    assume("load cell resolution", CELL_RESOLUTION_N, "N", "about 14.6 bits over the range"),
    assume(
        "pre-deflection in force mode",
        0.0,
        "mm from rest",
        "the cell holds the plate where the weight held it, so that it carries about the static load of the weight",
    ),
    assume(
        "leak across the amplifier output",
        LEAK_RESISTANCE_MOHM,
        "Mohm",
        "Table 1: power / mean(V^2) is 35 to 38 nS in all four rows, so the load is resistive; where it sits is not known",
    ),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ParameterSet;

    #[test]
    fn law_every_assumption_has_value_unit_and_reason_and_the_leak_is_the_one_in_use() {
        for assumption in rig_assumptions() {
            assert!(assumption.value.is_finite());
            assert!(!assumption.unit.is_empty() && assumption.reason.len() > 10, "{}", assumption.name);
        }
        let leak = ParameterSet::A.parameters().spec().leak_resistance_ohm;
        assert!((leak - LEAK_RESISTANCE_MOHM * 1e6).abs() < 1e-3);
    }
}
