//! Pressure, force and displacement of a plate on a spring.

use std::f64::consts::PI;

use crate::{Error, PulseRecording, Unit};

/// A flat round plate pressed against an elastic ground.
///
/// **Shapes and units**: a uniform pressure `p` on the plate is the force `p pi r^2`; it moves the plate by
/// that force over its stiffness `k`.
///
/// **Source**: the paper converts pressure to displacement with one factor, 1296.2144 Pa/mm. That factor is
/// `k / (pi r^2)`: with its r = 6.35 mm it asks for k = 164.20 N/m; its k = 160 N/m would give 1263.06 Pa/mm,
/// and its 12.7 mm plate 315.8 Pa/mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plate {
    radius_m: f64,
    stiffness_n_per_m: f64,
}

impl Plate {
    /// A plate of this radius and stiffness.
    ///
    /// **Errors**: a value that is not positive and finite.
    pub fn new(radius_m: f64, stiffness_n_per_m: f64) -> Result<Self, Error> {
        for (name, found) in [("radius_m", radius_m), ("stiffness_n_per_m", stiffness_n_per_m)] {
            if !(found.is_finite() && found > 0.0) {
                return Err(Error::Parameter { name, allowed: "a finite value > 0", found });
            }
        }
        Ok(Self { radius_m, stiffness_n_per_m })
    }

    /// The plate of this radius whose stiffness gives the wanted pressure per displacement.
    ///
    /// **Errors**: a value that is not positive and finite.
    pub fn from_pa_per_mm(radius_m: f64, pa_per_mm: f64) -> Result<Self, Error> {
        if !(pa_per_mm.is_finite() && pa_per_mm > 0.0) {
            return Err(Error::Parameter {
                name: "pa_per_mm",
                allowed: "a finite value > 0",
                found: pa_per_mm,
            });
        }
        Self::new(radius_m, pa_per_mm * 1e3 * PI * radius_m * radius_m)
    }

    /// Radius.
    pub fn radius_m(&self) -> f64 {
        self.radius_m
    }

    /// Stiffness of the ground.
    pub fn stiffness_n_per_m(&self) -> f64 {
        self.stiffness_n_per_m
    }

    /// Area.
    pub fn area_m2(&self) -> f64 {
        PI * self.radius_m * self.radius_m
    }

    /// Pressure that moves the plate by one millimetre.
    pub fn pa_per_mm(&self) -> f64 {
        self.stiffness_n_per_m / self.area_m2() * 1e-3
    }

    /// Force that moves the plate by one millimetre.
    pub fn n_per_mm(&self) -> f64 {
        self.stiffness_n_per_m * 1e-3
    }

    /// The recording as pressure (Pa, mmHg), force (N) or displacement (mm) of this plate; the step is
    /// written to its provenance.
    ///
    /// **Errors**: an arbitrary unit on either side.
    ///
    /// **Example**
    /// ```
    /// use telepulse_pulse::{PulseRecording, Unit, calibration::Plate};
    /// let plate = Plate::from_pa_per_mm(6.35e-3, 1296.2144)?;
    /// let pressure = PulseRecording::new(Unit::Pascal, 100.0, vec![0.0, 827.3709])?;
    /// let displacement = plate.convert(&pressure, Unit::Millimetre)?;
    /// assert!((displacement.peak_to_peak() - 0.63830).abs() < 1e-5);
    /// # Ok::<(), telepulse_pulse::Error>(())
    /// ```
    pub fn convert(&self, recording: &PulseRecording, unit: Unit) -> Result<PulseRecording, Error> {
        if *recording.unit() == unit {
            return Ok(recording.clone());
        }
        let unknown =
            || Error::Conversion { from: recording.unit().symbol().to_owned(), to: unit.symbol().to_owned() };
        let from = self.newton_per(recording.unit()).ok_or_else(unknown)?;
        let to = self.newton_per(&unit).ok_or_else(unknown)?;
        let values = recording.values().iter().map(|value| value * from / to).collect();
        let step = format!(
            "converted from {} to {} on a plate of radius {} m and stiffness {} N/m",
            recording.unit().symbol(),
            unit.symbol(),
            self.radius_m,
            self.stiffness_n_per_m
        );
        let mut converted = recording.derived(unit.clone(), recording.sample_rate_hz(), values, step)?;
        converted.kind = unit.natural_kind();
        Ok(converted)
    }

    /// Force that one of this unit stands for.
    fn newton_per(&self, unit: &Unit) -> Option<f64> {
        match unit {
            Unit::Pascal => Some(self.area_m2()),
            Unit::MillimetreOfMercury => {
                Some(self.area_m2() * crate::recording::PASCAL_PER_MILLIMETRE_OF_MERCURY)
            }
            Unit::Millimetre => Some(self.n_per_mm()),
            Unit::Newton => Some(1.0),
            Unit::Arbitrary(_) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paper_pressure_per_displacement_needs_a_stiffness_that_it_does_not_state() {
        // Printed 1296.2144 Pa/mm, r = 6.35 mm and k = 160 N/m do not fit together.
        let stated = Plate::new(6.35e-3, 160.0).expect("valid");
        assert!((stated.pa_per_mm() - 1263.06).abs() < 0.01, "{}", stated.pa_per_mm());
        let needed = Plate::from_pa_per_mm(6.35e-3, 1296.2144).expect("valid");
        assert!((needed.stiffness_n_per_m() - 164.20).abs() < 0.005, "{}", needed.stiffness_n_per_m());
    }

    #[test]
    fn paper_plate_of_section_2_gives_a_quarter() {
        let plate = Plate::new(12.7e-3, 160.0).expect("valid");
        assert!((plate.pa_per_mm() - 315.8).abs() < 0.05, "{}", plate.pa_per_mm());
    }

    #[test]
    fn law_conversions_close_a_circle() {
        let plate = Plate::new(6.35e-3, 164.2).expect("valid");
        let start =
            PulseRecording::new(Unit::MillimetreOfMercury, 100.0, vec![1.0, 6.2, 3.5]).expect("valid");
        let mut recording = start.clone();
        for unit in [Unit::Newton, Unit::Millimetre, Unit::Pascal, Unit::MillimetreOfMercury] {
            recording = plate.convert(&recording, unit).expect("known units");
        }
        for (end, begin) in recording.values().iter().zip(start.values()) {
            assert!((end / begin - 1.0).abs() < 1e-14);
        }
        assert_eq!(recording.provenance.steps.len(), 4);
    }

    #[test]
    fn edge_arbitrary_units_and_bad_plates_are_refused() {
        let plate = Plate::new(6.35e-3, 164.2).expect("valid");
        let ppg = PulseRecording::new(Unit::Arbitrary("au".into()), 100.0, vec![0.0, 1.0]).expect("valid");
        assert!(matches!(plate.convert(&ppg, Unit::Pascal), Err(Error::Conversion { .. })));
        for (radius, stiffness) in [(0.0, 1.0), (1.0, -1.0), (f64::NAN, 1.0)] {
            assert!(matches!(Plate::new(radius, stiffness), Err(Error::Parameter { .. })));
        }
    }
}
