//! Records of a user's own measurements, checked.

use nalgebra::Complex;

use super::Refusal;
use crate::Error;

/// Frequency response of the displacement at a bias.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepRecord {
    /// Name for messages.
    pub name: String,
    /// Bias voltage, V.
    pub bias_v: f64,
    /// Standard deviation of real and imaginary part, mm per unit of drive.
    pub noise_mm_per_unit: f64,
    /// Frequency (Hz) and response (mm per unit), frequencies ascending.
    pub rows: Vec<(f64, Complex<f64>)>,
}

/// Displacement in time after the drive goes from one voltage, at which the actuator had come to rest, to another.
///
/// A record of creep is one of these over minutes; a record of a step one over a second.
#[derive(Debug, Clone, PartialEq)]
pub struct TimeRecord {
    /// Name for messages.
    pub name: String,
    /// Drive before time zero, V.
    pub from_v: f64,
    /// Drive from time zero on, V.
    pub to_v: f64,
    /// Standard deviation of a displacement, mm.
    pub noise_mm: f64,
    /// Time (s) and displacement (mm) from the rest position at zero voltage, positive down; times ascending.
    pub rows: Vec<(f64, f64)>,
}

/// What was measured.
#[derive(Debug, Clone, PartialEq)]
pub enum Record {
    /// Frequency response at a bias.
    Sweep(SweepRecord),
    /// Step or creep.
    Time(TimeRecord),
}

/// Half of the membrane's first own frequency, about 120 Hz for the built-in geometry: its inertia is not in the model. Hz.
const HIGHEST_HZ: f64 = 60.0;
/// An interval this many times longer than both of its neighbours is a gap.
const GAP: f64 = 10.0;

impl Record {
    /// Name for messages.
    #[must_use]
    pub fn name(&self) -> &str {
        match self {
            Self::Sweep(sweep) => &sweep.name,
            Self::Time(time) => &time.name,
        }
    }

    /// Numbers in it: two for each row of a sweep.
    #[must_use]
    pub fn n_values(&self) -> usize {
        match self {
            Self::Sweep(sweep) => 2 * sweep.rows.len(),
            Self::Time(time) => time.rows.len(),
        }
    }

    /// Checks every number.
    ///
    /// # Errors
    /// [`Refusal::Row`] or [`Refusal::Setting`] for the first that is no number, out of range, out of order, or after a gap.
    pub fn check(&self, full_scale_v: f64) -> Result<(), Error> {
        match self {
            Self::Sweep(sweep) => sweep.check(full_scale_v),
            Self::Time(time) => time.check(full_scale_v),
        }
    }
}

impl SweepRecord {
    fn check(&self, full_scale_v: f64) -> Result<(), Error> {
        let setting = |key, found| Setting { record: &self.name, key, found };
        setting("noise_mm_per_unit", self.noise_mm_per_unit).positive()?;
        setting("bias_v", self.bias_v).positive_voltage(full_scale_v)?;
        setting("rows", self.rows.len() as f64).not_empty()?;
        let mut last = 0.0;
        for (idx, &(hz, response)) in self.rows.iter().enumerate() {
            let row = |key, found| Row { record: &self.name, key, row: idx + 1, found };
            row("frequency_hz", hz).finite()?;
            row("frequency_hz", hz).require(hz > 0.0, "frequencies must be positive")?;
            row("frequency_hz", hz).require(hz > last, "frequencies must ascend")?;
            let slow = "must be at most 60 Hz: the membrane's own inertia, which the model leaves out, counts beyond";
            row("frequency_hz", hz).require(hz <= HIGHEST_HZ, slow)?;
            row("real_mm_per_unit", response.re).finite()?;
            row("imag_mm_per_unit", response.im).finite()?;
            last = hz;
        }
        Ok(())
    }
}

impl TimeRecord {
    fn check(&self, full_scale_v: f64) -> Result<(), Error> {
        let setting = |key, found| Setting { record: &self.name, key, found };
        setting("noise_mm", self.noise_mm).positive()?;
        setting("from_v", self.from_v).voltage(full_scale_v)?;
        setting("to_v", self.to_v).voltage(full_scale_v)?;
        let same = "must differ from from_v: without a step nothing moves";
        setting("to_v", self.to_v).require(self.to_v != self.from_v, same)?;
        setting("rows", self.rows.len() as f64).not_empty()?;
        for (idx, &(time, displacement)) in self.rows.iter().enumerate() {
            let row = |key, found| Row { record: &self.name, key, row: idx + 1, found };
            row("time_s", time).finite()?;
            row("time_s", time).require(time >= 0.0, "times must not be negative: the step is at zero")?;
            let ascends = idx == 0 || time > self.rows[idx - 1].0;
            row("time_s", time).require(ascends, "times must ascend")?;
            row("displacement_mm", displacement).finite()?;
        }
        for (idx, times) in self.rows.windows(4).enumerate() {
            let [before, gap, after] = std::array::from_fn(|k| times[k + 1].0 - times[k].0);
            let row = Row { record: &self.name, key: "time_s", row: idx + 3, found: times[2].0 };
            let reason = "a gap: the interval before it is over ten times as long as those beside it; make two records";
            row.require(gap <= GAP * before.max(after), reason)?;
        }
        Ok(())
    }
}

/// A value of a record as a whole.
struct Setting<'a> {
    record: &'a str,
    key: &'static str,
    found: f64,
}

impl Setting<'_> {
    fn require(&self, holds: bool, reason: &'static str) -> Result<(), Error> {
        let Self { record, key, found } = *self;
        if holds {
            return Ok(());
        }
        Err(Error::Calibration(Refusal::Setting { record: record.to_owned(), key, found, reason }))
    }

    fn positive(&self) -> Result<(), Error> {
        let holds = self.found.is_finite() && self.found > 0.0;
        self.require(holds, "must be finite and positive: the weight of a value is one over it")
    }

    fn voltage(&self, full_scale_v: f64) -> Result<(), Error> {
        let holds = self.found.is_finite() && self.found >= 0.0;
        self.require(holds, "must be finite and not negative: force goes with its square")?;
        self.require(self.found <= full_scale_v, "must not exceed full_scale_v: the amplifier ends there")
    }

    fn positive_voltage(&self, full_scale_v: f64) -> Result<(), Error> {
        self.voltage(full_scale_v)?;
        self.require(self.found > 0.0, "must be positive: the input gain is zero at zero bias")
    }

    fn not_empty(&self) -> Result<(), Error> {
        self.require(self.found > 0.0, "must not be empty")
    }
}

/// A value in a row.
struct Row<'a> {
    record: &'a str,
    key: &'static str,
    row: usize,
    found: f64,
}

impl Row<'_> {
    fn require(&self, holds: bool, reason: &'static str) -> Result<(), Error> {
        let Self { record, key, row, found } = *self;
        if holds {
            return Ok(());
        }
        Err(Error::Calibration(Refusal::Row { record: record.to_owned(), key, row, found, reason }))
    }

    fn finite(&self) -> Result<(), Error> {
        self.require(self.found.is_finite(), "must be a finite number: no value was measured here")
    }
}
