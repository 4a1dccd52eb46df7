//! A plate that is felt and not seen: carrier on the drive, voltage and current sampled, displacement from the capacitance.

use std::collections::VecDeque;
use std::f64::consts::TAU;

use telepulse_rt::{MonotonicNs, Reading, SensorFault};

use super::SensingSine;
use super::instrument::Gaussian;
use super::plant::{Plant, PlantFault};
use crate::Error;
use crate::sensing::{CapacitiveSensor, SensingSettings};
use crate::twin::TwinModel;

/// Self-sensing of a rig.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CapacitiveReading {
    /// Carrier, sampling and noise.
    pub settings: SensingSettings,
    /// Amplitude of the carrier, V. The command is kept this far from zero and from the ceiling.
    pub carrier_v: f64,
    /// Highest voltage that command and carrier together may reach, V.
    pub ceiling_v: f64,
}

impl CapacitiveReading {
    /// The default settings with a carrier of 100 V under a ceiling.
    #[must_use]
    pub fn below(ceiling_v: f64) -> Self {
        Self { settings: SensingSettings::default(), carrier_v: CARRIER_V, ceiling_v }
    }
}

/// How far the readings of a run were from the truth. For evaluation only.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SensingRecord {
    /// Readings that were given.
    pub n_readings: usize,
    /// Largest difference between a reading and the true mean over its window, mm.
    pub error_max_mm: f64,
    /// Largest standard deviation that was stated with a reading, mm.
    pub standard_deviation_max_mm: f64,
}

/// 2 % of full scale: assumed.
const CARRIER_V: f64 = 100.0;
/// Windows that pass before a run starts, so that the first reading has one behind it and the carrier has settled.
const WINDOWS_AHEAD: u64 = 5;

/// The samples of the last window, and what is made of them.
#[derive(Debug, Clone)]
pub(super) struct CapacitanceGauge {
    sensor: CapacitiveSensor,
    reading: CapacitiveReading,
    sine: Option<SensingSine>,
    leak_ohm: f64,
    sample_ns: u64,
    command_v: f64,
    /// Samples since the start of the clock.
    sample_idx: u64,
    volt_seconds: f64,
    charge_c: f64,
    displacement_mm: f64,
    voltage_v: VecDeque<f64>,
    current_a: VecDeque<f64>,
    truth_mm: VecDeque<f64>,
    noise: Gaussian,
    record: SensingRecord,
    fault: Option<Error>,
}

impl CapacitanceGauge {
    /// A gauge on `plant`, which has stood under the carrier for a while: its clock starts anew.
    pub(super) fn new(
        model: &TwinModel,
        reading: CapacitiveReading,
        sine: Option<SensingSine>,
        seed: u64,
        plant: &mut Plant,
        bias_v: f64,
    ) -> Result<Self, Error> {
        let CapacitiveReading { settings, carrier_v, ceiling_v } = reading;
        let sensor = CapacitiveSensor::new(model, settings)?;
        let spec = model.parameters().spec();
        let usable = carrier_v.is_finite() && carrier_v > 0.0;
        require(usable, "carrier_v", "finite and positive", carrier_v)?;
        let usable = ceiling_v > 2.0 * carrier_v && ceiling_v <= spec.full_scale_v;
        require(usable, "ceiling_v", "above twice carrier_v and at most full scale", ceiling_v)?;
        let sample_ns = (settings.sample_time_s * 1e9).round();
        let whole = (sample_ns * 1e-9 / settings.sample_time_s - 1.0).abs() < 1e-9;
        require(whole, "sample_time_s", "a whole number of nanoseconds", settings.sample_time_s)?;
        let n = sensor.n_samples();
        let mut gauge = Self {
            sensor,
            reading,
            sine,
            leak_ohm: spec.leak_resistance_ohm,
            sample_ns: sample_ns as u64,
            command_v: bias_v,
            sample_idx: 0,
            volt_seconds: 0.0,
            charge_c: plant.charge_c(),
            displacement_mm: plant.displacement_mm(),
            voltage_v: VecDeque::with_capacity(n + 1),
            current_a: VecDeque::with_capacity(n + 1),
            truth_mm: VecDeque::with_capacity(n + 1),
            noise: Gaussian::new(seed),
            record: SensingRecord::default(),
            fault: None,
        };
        let ahead = MonotonicNs(WINDOWS_AHEAD * n as u64 * gauge.sample_ns);
        if let Err(PlantFault::NoEquilibrium) = gauge.advance_to(plant, ahead) {
            return Err(plant.fault().cloned().unwrap_or(Error::NoEquilibrium));
        }
        // Whole windows hold whole periods, so the carrier goes on without a jump.
        gauge.sample_idx = 0;
        plant.restart_clock();
        Ok(gauge)
    }

    /// The carrier is added from now on to another command.
    pub(super) fn command(&mut self, command_v: f64) {
        self.command_v = command_v;
    }

    /// Drives the device up to `now`, sample by sample.
    pub(super) fn advance_to(&mut self, plant: &mut Plant, now: MonotonicNs) -> Result<(), PlantFault> {
        // Refuses times that lie behind or too far ahead before anything is driven.
        plant.require_ahead(now)?;
        let CapacitiveReading { carrier_v, ceiling_v, settings } = self.reading;
        let dt = self.sample_ns as f64 * 1e-9;
        // Bounded: the device refuses gaps of more than an hour.
        while plant.now() < now {
            let middle_s = (self.sample_idx as f64 + 0.5) * dt;
            let carrier = carrier_v * (TAU * settings.carrier_hz * middle_s).sin();
            let drive_v = self.command_v.clamp(carrier_v, ceiling_v - carrier_v) + carrier;
            let from = plant.now();
            let end = MonotonicNs((self.sample_idx + 1) * self.sample_ns);
            let stop = end.min(now);
            plant.drive(from, drive_v)?;
            plant.advance_to(stop)?;
            self.volt_seconds += drive_v * (stop.0 - from.0) as f64 * 1e-9;
            if stop == end {
                self.sample(plant, dt);
            }
        }
        Ok(())
    }

    /// Ends a sample: what an integrating converter shows of the last interval.
    fn sample(&mut self, plant: &Plant, dt: f64) {
        let SensingSettings { voltage_noise_v, current_noise_a, .. } = self.reading.settings;
        let (charge_c, displacement_mm) = (plant.charge_c(), plant.displacement_mm());
        let mean_v = self.volt_seconds / dt;
        let voltage_v = mean_v + voltage_noise_v * self.noise.draw();
        let current_a =
            (charge_c - self.charge_c) / dt + mean_v / self.leak_ohm + current_noise_a * self.noise.draw();
        let n = self.sensor.n_samples();
        push(&mut self.voltage_v, voltage_v, n);
        push(&mut self.current_a, current_a, n);
        push(&mut self.truth_mm, 0.5 * (self.displacement_mm + displacement_mm), n);
        (self.charge_c, self.displacement_mm) = (charge_c, displacement_mm);
        self.volt_seconds = 0.0;
        self.sample_idx += 1;
    }

    /// Displacement from rest as the last window shows it, mm.
    pub(super) fn show(&mut self, now: MonotonicNs) -> Result<Reading, SensorFault> {
        let (voltage_v, current_a) = (self.voltage_v.make_contiguous(), self.current_a.make_contiguous());
        let found = self.sensor.estimate(voltage_v, current_a).map_err(|error| {
            self.fault.get_or_insert(error);
            SensorFault::Stale
        })?;
        let truth: f64 = self.truth_mm.iter().zip(self.sensor.window()).map(|(x, w)| x * w).sum();
        let record = &mut self.record;
        record.n_readings += 1;
        record.error_max_mm = record.error_max_mm.max((found.displacement_mm - truth).abs());
        record.standard_deviation_max_mm = record.standard_deviation_max_mm.max(found.standard_deviation_mm);
        let sine = self.sine.map_or(0.0, |sine| sine.at(now));
        Ok(Reading { value: found.displacement_mm + sine })
    }

    pub(super) fn record(&self) -> SensingRecord {
        self.record
    }

    /// Why there was no reading, where one failed.
    pub(super) fn fault(&self) -> Option<&Error> {
        self.fault.as_ref()
    }
}

fn push(queue: &mut VecDeque<f64>, value: f64, capacity: usize) {
    if queue.len() == capacity {
        queue.pop_front();
    }
    queue.push_back(value);
}

fn require(holds: bool, key: &'static str, allowed: &'static str, found: f64) -> Result<(), Error> {
    if holds { Ok(()) } else { Err(Error::Parameter { key, allowed, found }) }
}
