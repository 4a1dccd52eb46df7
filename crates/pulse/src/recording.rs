//! A checked pulse recording.

use serde::{Deserialize, Serialize};

use crate::Error;

/// One uniformly sampled channel of a body signal, with its unit and its origin.
///
/// **Shapes and units**: sample `i` belongs to the time `start_s + i / sample_rate_hz`. All values are
/// finite, there are at least two.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "PlainRecording", into = "PlainRecording")]
pub struct PulseRecording {
    /// Short name.
    pub title: String,
    /// Where on the body it was taken.
    pub site: String,
    /// What was measured.
    pub kind: SignalKind,
    /// Where it comes from and what was done to it.
    pub provenance: Provenance,
    unit: Unit,
    start_s: f64,
    sample_rate_hz: f64,
    values: Vec<f64>,
}

/// What a recording measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SignalKind {
    /// Arterial or contact pressure.
    Pressure,
    /// Contact force.
    Force,
    /// Displacement of skin or diaphragm.
    Displacement,
    /// Photoplethysmogram.
    Ppg,
    /// Not stated.
    Unstated,
}

/// Unit of the values.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", from = "String")]
pub enum Unit {
    /// Pa.
    Pascal,
    /// mmHg.
    MillimetreOfMercury,
    /// mm.
    Millimetre,
    /// N.
    Newton,
    /// A unit that cannot be converted, by its name.
    Arbitrary(String),
}

/// Where a recording comes from and what was done to it.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// Data base, device or paper.
    #[serde(default)]
    pub source: String,
    /// Licence of the data.
    #[serde(default)]
    pub licence: String,
    /// SHA-256 of the file it was read from, as 64 hexadecimal digits.
    #[serde(default)]
    pub sha256: Option<String>,
    /// Every change since, in order: scaling and resampling are never silent.
    #[serde(default)]
    pub steps: Vec<String>,
}

impl PulseRecording {
    /// A recording that starts at time zero; its kind follows from the unit, all else is blank.
    ///
    /// **Errors**: fewer than two samples, a sample that is not finite, a rate that is not positive and
    /// finite.
    pub fn new(unit: Unit, sample_rate_hz: f64, values: Vec<f64>) -> Result<Self, Error> {
        Self::starting_at(0.0, unit, sample_rate_hz, values)
    }

    /// A recording whose first sample belongs to the time `start_s`.
    ///
    /// **Errors**: as [`PulseRecording::new`], and a start that is not finite.
    pub fn starting_at(
        start_s: f64,
        unit: Unit,
        sample_rate_hz: f64,
        values: Vec<f64>,
    ) -> Result<Self, Error> {
        check_rate(sample_rate_hz)?;
        if !start_s.is_finite() {
            return Err(Error::Parameter { name: "start_s", allowed: "a finite time", found: start_s });
        }
        if values.len() < 2 {
            return Err(Error::TooShort { required: 2, found: values.len() });
        }
        check_finite(&values)?;
        Ok(Self {
            title: String::new(),
            site: String::new(),
            kind: unit.natural_kind(),
            provenance: Provenance::default(),
            unit,
            start_s,
            sample_rate_hz,
            values,
        })
    }

    /// Unit of the values.
    pub fn unit(&self) -> &Unit {
        &self.unit
    }

    /// Sample rate.
    pub fn sample_rate_hz(&self) -> f64 {
        self.sample_rate_hz
    }

    /// Time of the first sample.
    pub fn start_s(&self) -> f64 {
        self.start_s
    }

    /// The samples.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Number of samples.
    pub fn n_samples(&self) -> usize {
        self.values.len()
    }

    /// Time from the first to the last sample.
    pub fn duration_s(&self) -> f64 {
        (self.values.len() - 1) as f64 / self.sample_rate_hz
    }

    /// Times of all samples.
    pub fn times_s(&self) -> Vec<f64> {
        (0..self.values.len()).map(|idx| self.start_s + idx as f64 / self.sample_rate_hz).collect()
    }

    /// Largest minus smallest value.
    pub fn peak_to_peak(&self) -> f64 {
        peak_to_peak(&self.values)
    }

    /// Arithmetic mean of the values.
    pub fn mean(&self) -> f64 {
        self.values.iter().sum::<f64>() / self.values.len() as f64
    }

    /// The same recording with other samples at another rate or in another unit; `step` says what was done.
    ///
    /// **Errors**: as [`PulseRecording::new`].
    pub fn derived(
        &self,
        unit: Unit,
        sample_rate_hz: f64,
        values: Vec<f64>,
        step: String,
    ) -> Result<Self, Error> {
        let mut derived = Self::starting_at(self.start_s, unit, sample_rate_hz, values)?;
        derived.title.clone_from(&self.title);
        derived.site.clone_from(&self.site);
        derived.kind = self.kind;
        derived.provenance = self.provenance.clone();
        derived.provenance.steps.push(step);
        Ok(derived)
    }

    /// The recording with its shape kept, its foot (smallest value) moved to zero and its peak-to-peak value
    /// set, in `unit`.
    ///
    /// The change is written to the provenance: the absolute level and the size of the original are lost.
    ///
    /// **Errors**: a constant recording; a target that is not positive and finite.
    pub fn scaled_to_peak_to_peak(&self, target: f64, unit: Unit) -> Result<Self, Error> {
        if !(target.is_finite() && target > 0.0) {
            return Err(Error::Parameter { name: "target", allowed: "a finite value > 0", found: target });
        }
        let (low, high) = extent(&self.values);
        if high <= low {
            return Err(Error::NoVariation { which: "recording" });
        }
        let values = self.values.iter().map(|value| (value - low) / (high - low) * target).collect();
        let step = format!(
            "scaled from {} {} peak to peak to {target} {}, foot moved from {low} to 0",
            high - low,
            self.unit.symbol(),
            unit.symbol()
        );
        self.derived(unit, self.sample_rate_hz, values, step)
    }

    /// The recording in Pa or mmHg.
    ///
    /// **Errors**: the recording is not a pressure, or the wanted unit is none; see [`crate::calibration`]
    /// for force and displacement.
    pub fn to_pressure_unit(&self, unit: Unit) -> Result<Self, Error> {
        let pascals = |unit: &Unit| match unit {
            Unit::Pascal => Some(1.0),
            Unit::MillimetreOfMercury => Some(PASCAL_PER_MILLIMETRE_OF_MERCURY),
            _ => None,
        };
        let (Some(from), Some(to)) = (pascals(&self.unit), pascals(&unit)) else {
            return Err(Error::Conversion {
                from: self.unit.symbol().to_owned(),
                to: unit.symbol().to_owned(),
            });
        };
        if from == to {
            return Ok(self.clone());
        }
        let values = self.values.iter().map(|value| value * from / to).collect();
        let step = format!("converted from {} to {}", self.unit.symbol(), unit.symbol());
        self.derived(unit, self.sample_rate_hz, values, step)
    }
}

impl Unit {
    /// The symbol that stands in files.
    pub fn symbol(&self) -> &str {
        match self {
            Self::Pascal => "Pa",
            Self::MillimetreOfMercury => "mmHg",
            Self::Millimetre => "mm",
            Self::Newton => "N",
            Self::Arbitrary(name) => name,
        }
    }

    /// The unit with this symbol; an unknown symbol is an arbitrary unit.
    pub fn from_symbol(symbol: &str) -> Self {
        match symbol {
            "Pa" => Self::Pascal,
            "mmHg" => Self::MillimetreOfMercury,
            "mm" => Self::Millimetre,
            "N" => Self::Newton,
            other => Self::Arbitrary(other.to_owned()),
        }
    }

    pub(crate) fn natural_kind(&self) -> SignalKind {
        match self {
            Self::Pascal | Self::MillimetreOfMercury => SignalKind::Pressure,
            Self::Millimetre => SignalKind::Displacement,
            Self::Newton => SignalKind::Force,
            Self::Arbitrary(_) => SignalKind::Unstated,
        }
    }
}

impl From<Unit> for String {
    fn from(unit: Unit) -> Self {
        unit.symbol().to_owned()
    }
}

impl From<String> for Unit {
    fn from(symbol: String) -> Self {
        Self::from_symbol(&symbol)
    }
}

/// The serialised form; reading it back goes through the checks.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PlainRecording {
    title: String,
    site: String,
    kind: SignalKind,
    unit: Unit,
    start_s: f64,
    sample_rate_hz: f64,
    provenance: Provenance,
    values: Vec<f64>,
}

impl TryFrom<PlainRecording> for PulseRecording {
    type Error = Error;

    fn try_from(plain: PlainRecording) -> Result<Self, Error> {
        let mut recording = Self::starting_at(plain.start_s, plain.unit, plain.sample_rate_hz, plain.values)?;
        recording.title = plain.title;
        recording.site = plain.site;
        recording.kind = plain.kind;
        recording.provenance = plain.provenance;
        Ok(recording)
    }
}

impl From<PulseRecording> for PlainRecording {
    fn from(recording: PulseRecording) -> Self {
        Self {
            title: recording.title,
            site: recording.site,
            kind: recording.kind,
            unit: recording.unit,
            start_s: recording.start_s,
            sample_rate_hz: recording.sample_rate_hz,
            provenance: recording.provenance,
            values: recording.values,
        }
    }
}

pub(crate) fn check_rate(sample_rate_hz: f64) -> Result<(), Error> {
    if sample_rate_hz.is_finite() && sample_rate_hz > 0.0 {
        return Ok(());
    }
    Err(Error::Parameter { name: "sample_rate_hz", allowed: "a finite rate > 0 Hz", found: sample_rate_hz })
}

pub(crate) fn check_finite(values: &[f64]) -> Result<(), Error> {
    match values.iter().position(|value| !value.is_finite()) {
        Some(index) => Err(Error::NotFinite { index, found: values[index] }),
        None => Ok(()),
    }
}

pub(crate) fn extent(values: &[f64]) -> (f64, f64) {
    values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &v| (low.min(v), high.max(v)))
}

pub(crate) fn peak_to_peak(values: &[f64]) -> f64 {
    let (low, high) = extent(values);
    high - low
}

/// The conventional millimetre of mercury.
// Source: ISO 80000-4:2006, density 13595.1 kg/m^3 times standard gravity 9.80665 m/s^2 times 1 mm.
pub const PASCAL_PER_MILLIMETRE_OF_MERCURY: f64 = 133.322_387_415;

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> PulseRecording {
        PulseRecording::new(Unit::MillimetreOfMercury, 4.0, vec![80.0, 100.0, 120.0]).expect("valid")
    }

    #[test]
    fn edge_bad_samples_and_rates_are_refused() {
        let build = |rate, values| PulseRecording::new(Unit::Pascal, rate, values);
        assert_eq!(build(100.0, vec![1.0]), Err(Error::TooShort { required: 2, found: 1 }));
        assert!(matches!(build(100.0, vec![1.0, f64::NAN]), Err(Error::NotFinite { index: 1, .. })));
        for rate in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(
                build(rate, vec![0.0; 4]),
                Err(Error::Parameter { name: "sample_rate_hz", .. })
            ));
        }
    }

    #[test]
    fn law_scaling_sets_size_and_foot_and_leaves_a_trace() {
        let scaled = ramp().scaled_to_peak_to_peak(827.3709, Unit::Pascal).expect("valid");
        assert_eq!(scaled.values(), [0.0, 827.3709 / 2.0, 827.3709]);
        assert_eq!((scaled.unit(), scaled.provenance.steps.len()), (&Unit::Pascal, 1));
        let flat = PulseRecording::new(Unit::Pascal, 1.0, vec![5.0, 5.0]).expect("valid");
        assert!(matches!(flat.scaled_to_peak_to_peak(1.0, Unit::Pascal), Err(Error::NoVariation { .. })));
    }

    #[test]
    fn law_pressure_units_convert_and_others_do_not() {
        let pascal = ramp().to_pressure_unit(Unit::Pascal).expect("a pressure");
        // 120 mmHg is 15.9987 kPa.
        assert!((pascal.values()[2] - 15_998.686).abs() < 1e-3);
        assert!(matches!(ramp().to_pressure_unit(Unit::Newton), Err(Error::Conversion { .. })));
    }

    #[test]
    fn law_serde_round_trip_is_exact_and_checked() {
        let text = serde_json::to_string(&ramp()).expect("serialises");
        assert_eq!(serde_json::from_str::<PulseRecording>(&text).expect("reads back"), ramp());
        let bad = text.replace("\"sample_rate_hz\":4.0", "\"sample_rate_hz\":0.0");
        assert!(serde_json::from_str::<PulseRecording>(&bad).is_err());
        let unknown = text.replace("\"title\"", "\"tittle\"");
        assert!(serde_json::from_str::<PulseRecording>(&unknown).is_err());
    }
}
