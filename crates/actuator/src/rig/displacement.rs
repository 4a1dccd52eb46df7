//! The rig of the paper's displacement runs: a weight on the plate, a laser above it, or its own capacitance as the sensor.

use telepulse_rt::{Drive, DriveFault, DriveVoltage, MonotonicNs, Reading, Sensor, SensorFault};

use super::RigConditions;
use super::assumptions::{
    LASER_MAX_MM, LASER_MIN_MM, LASER_NOISE_RMS_MM, LASER_RESOLUTION_MM, LASER_STANDOFF_MM,
};
use super::capacitance::{CapacitanceGauge, CapacitiveReading, SensingRecord};
use super::instrument::{Imperfections, Instrument};
use super::plant::{Plant, PlantFault};
use crate::Error;
use crate::field::PlateContact;
use crate::twin::{Contact, ContactLaw, PlateLoad, TwinModel};

/// A laser distance sensor above the plate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Laser {
    /// Distance to the plate at rest, mm.
    pub standoff_mm: f64,
    /// Lower end of the range, mm.
    pub min_mm: f64,
    /// Upper end of the range, mm.
    pub max_mm: f64,
    /// White noise, rms, mm.
    pub noise_rms_mm: f64,
    /// Steps of the reading, mm; zero for none.
    pub resolution_mm: f64,
}

impl Default for Laser {
    /// Range 30-70 mm as the paper's sensor; stand-off 50 mm, 3 um noise and 1 um steps are assumptions.
    fn default() -> Self {
        Self {
            standoff_mm: LASER_STANDOFF_MM,
            min_mm: LASER_MIN_MM,
            max_mm: LASER_MAX_MM,
            noise_rms_mm: LASER_NOISE_RMS_MM,
            resolution_mm: LASER_RESOLUTION_MM,
        }
    }
}

/// The actuator under its weight, read by a laser or by its own capacitance.
///
/// **Sign**: the laser reads its stand-off plus the displacement from rest; voltage lowers the plate and raises the reading. The
/// capacitance reads the displacement from rest, as the mean over a window that ends now.
///
/// **Example**
/// ```
/// use telepulse_actuator::{ParameterSet, rig::{DisplacementRig, RigConditions}, twin::TwinModel};
/// use telepulse_rt::{Drive, Limits, MonotonicNs, Sensor};
/// let model = TwinModel::new(&ParameterSet::A.parameters())?;
/// let mut rig = DisplacementRig::new(&model, RigConditions::default(), 1)?;
/// let limits = Limits::new(0.0, 5000.0, f64::INFINITY).expect("valid limits");
/// rig.apply(MonotonicNs(0), limits.clamp(5000.0, limits.off(), 5e-4).voltage).expect("time runs ahead");
/// let reading = rig.read(MonotonicNs(10_000_000_000)).expect("in range");
/// assert!((reading.value - 51.03).abs() < 0.02);
/// # Ok::<(), telepulse_actuator::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct DisplacementRig {
    plant: Plant,
    gauge: Gauge,
}

/// A fingertip above the plate: force `k d^p (1 + chi d')` at compression d (Hunt and Crossley 1975).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fingertip {
    /// k, N/m^p.
    pub stiffness_n_per_m_p: f64,
    /// p, 1 to 4; 1.5 for smooth bodies (Hertz).
    pub exponent: f64,
    /// chi, s/m.
    pub dissipation_s_per_m: f64,
    /// Displacement of the plate from rest at which it just touches, mm.
    pub touch_mm: f64,
}

/// What reads the plate.
#[derive(Debug, Clone)]
enum Gauge {
    Laser { standoff_mm: f64, instrument: Instrument },
    Capacitance(Box<CapacitanceGauge>),
}

impl DisplacementRig {
    /// A rig with the default laser; `seed` makes its noise.
    ///
    /// # Errors
    /// [`Error::Request`] names the condition that is out of range.
    pub fn new(model: &TwinModel, conditions: RigConditions, seed: u64) -> Result<Self, Error> {
        Self::with_laser(model, Laser::default(), conditions, seed)
    }

    /// A rig with a given laser.
    ///
    /// # Errors
    /// [`Error::Request`] names the condition that is out of range.
    pub fn with_laser(
        model: &TwinModel,
        laser: Laser,
        conditions: RigConditions,
        seed: u64,
    ) -> Result<Self, Error> {
        let imperfections = Imperfections {
            noise_rms: laser.noise_rms_mm,
            resolution: laser.resolution_mm,
            min: laser.min_mm,
            max: laser.max_mm,
        };
        let instrument = Instrument::new(imperfections, conditions.sensing_noise, seed)?;
        let gauge = Gauge::Laser { standoff_mm: laser.standoff_mm, instrument };
        Ok(Self { plant: Plant::new(model, own_load(model), &conditions)?, gauge })
    }

    /// A rig with a given laser whose plate a fingertip touches from above: it is pressed while the plate is above `touch_mm`.
    ///
    /// The plate starts where weight, membrane and fingertip are in balance.
    ///
    /// # Errors
    /// [`Error::Request`] names the condition and [`Error::Parameter`] the number of the fingertip that is out of range.
    pub fn with_fingertip(
        model: &TwinModel,
        laser: Laser,
        fingertip: Fingertip,
        conditions: RigConditions,
        seed: u64,
    ) -> Result<Self, Error> {
        let Fingertip { stiffness_n_per_m_p, exponent, dissipation_s_per_m, touch_mm } = fingertip;
        // The field-level model's own check says what a fingertip may be.
        PlateContact::HuntCrossley { stiffness_n_per_m_p, exponent, dissipation_s_per_m, touch_mm }
            .check()?;
        let law = ContactLaw::HuntCrossley { stiffness_n_per_m_p, exponent, dissipation_s_per_m };
        let mut rig = Self::with_laser(model, laser, conditions, seed)?;
        let load = PlateLoad { contact: Some(Contact { law, touch_mm }), ..own_load(model) };
        rig.plant = Plant::new(model, load, &conditions)?;
        Ok(rig)
    }

    /// Compressive force of a fingertip at the last call, N; zero without one. For evaluation only.
    #[must_use]
    pub fn true_contact_force_n(&self) -> f64 {
        self.plant.contact_force_n()
    }

    /// A rig that feels its plate by the capacitance: a carrier is added to the drive, which is sampled with current and voltage.
    ///
    /// **Method**: [`crate::sensing::CapacitiveSensor`] on the last window, at every reading. The carrier has run for five windows when the
    /// clock starts. Commands are kept `carrier_v` away from zero and from `ceiling_v`.
    ///
    /// **Accuracy**: a reading is the mean over a window, so it lags by half of it (20 ms); [`DisplacementRig::sensing`] says how
    /// far readings were from that mean.
    ///
    /// # Errors
    /// [`Error::Request`] names the condition and [`Error::Parameter`] the setting that is out of range.
    pub fn with_capacitance(
        model: &TwinModel,
        reading: CapacitiveReading,
        conditions: RigConditions,
        seed: u64,
    ) -> Result<Self, Error> {
        if let Some(sine) = conditions.sensing_noise {
            sine.check()?;
        }
        let mut plant = Plant::new(model, own_load(model), &conditions)?;
        let disturbance = plant.undisturbed();
        let (sine, bias_v) = (conditions.sensing_noise, conditions.initial_bias_v);
        let gauge = CapacitanceGauge::new(model, reading, sine, seed, &mut plant, bias_v)?;
        plant.disturb(disturbance);
        Ok(Self { plant, gauge: Gauge::Capacitance(Box::new(gauge)) })
    }

    /// Reading at the rest position, mm: the laser's stand-off, or zero.
    #[must_use]
    pub fn standoff_mm(&self) -> f64 {
        match &self.gauge {
            Gauge::Laser { standoff_mm, .. } => *standoff_mm,
            Gauge::Capacitance(_) => 0.0,
        }
    }

    /// How far readings of the capacitance were from the truth; nothing for a laser. For evaluation only.
    #[must_use]
    pub fn sensing(&self) -> Option<SensingRecord> {
        match &self.gauge {
            Gauge::Laser { .. } => None,
            Gauge::Capacitance(gauge) => Some(gauge.record()),
        }
    }

    fn advance_to(&mut self, now: MonotonicNs) -> Result<(), PlantFault> {
        match &mut self.gauge {
            Gauge::Laser { .. } => self.plant.advance_to(now),
            Gauge::Capacitance(gauge) => gauge.advance_to(&mut self.plant, now),
        }
    }

    /// True displacement from rest at the last call, mm, positive down. For evaluation only.
    #[must_use]
    pub fn true_displacement_mm(&self) -> f64 {
        self.plant.displacement_mm()
    }

    /// Power from the amplifier at the last call, W. For evaluation only.
    #[must_use]
    pub fn supply_power_w(&self) -> f64 {
        self.plant.supply_power_w()
    }

    /// Voltage across the membrane at the last call, V. For evaluation only.
    #[must_use]
    pub fn membrane_voltage_v(&self) -> f64 {
        self.plant.membrane_voltage_v()
    }

    /// True once a reduced twin has left the range of its maps. For evaluation only.
    #[must_use]
    pub fn has_left_map(&self) -> bool {
        self.plant.has_left_map()
    }

    /// Why the membrane moves no further, where a call has found no equilibrium, or why its capacitance told nothing. For
    /// evaluation only.
    #[must_use]
    pub fn fault(&self) -> Option<&Error> {
        self.plant.fault().or(match &self.gauge {
            Gauge::Laser { .. } => None,
            Gauge::Capacitance(gauge) => gauge.fault(),
        })
    }
}

fn own_load(model: &TwinModel) -> PlateLoad {
    PlateLoad { mass_kg: model.parameters().spec().mass_kg, contact: None }
}

impl Sensor for DisplacementRig {
    fn read(&mut self, now: MonotonicNs) -> Result<Reading, SensorFault> {
        self.advance_to(now).map_err(|_| SensorFault::Stale)?;
        match &mut self.gauge {
            Gauge::Laser { standoff_mm, instrument } => {
                instrument.show(now, *standoff_mm + self.plant.displacement_mm())
            }
            Gauge::Capacitance(gauge) => gauge.show(now),
        }
    }
}

impl Drive for DisplacementRig {
    fn apply(&mut self, now: MonotonicNs, voltage: DriveVoltage) -> Result<(), DriveFault> {
        self.advance_to(now).map_err(|_| DriveFault::Refused)?;
        match &mut self.gauge {
            Gauge::Laser { .. } => self.plant.drive(now, voltage.volts()).map_err(|_| DriveFault::Refused),
            Gauge::Capacitance(gauge) => {
                gauge.command(voltage.volts());
                Ok(())
            }
        }
    }
}
