//! Self-sensing: the plate's displacement from voltage and current at the amplifier.

use std::f64::consts::TAU;

use nalgebra::{Complex, SMatrix, SVector};

use crate::Error;
use crate::twin::TwinModel;

/// How the amplifier's signals are taken and what noise they carry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SensingSettings {
    /// Frequency of the carrier on the drive, Hz. It must lie well above the plate's resonance, so that the plate stands still.
    pub carrier_hz: f64,
    /// Time between samples, s.
    pub sample_time_s: f64,
    /// Carrier periods in one window, at least 4: fewer cannot be told from a moving bias.
    pub n_periods: usize,
    /// Noise of a voltage sample, rms, V.
    pub voltage_noise_v: f64,
    /// Noise of a current sample, rms, A.
    pub current_noise_a: f64,
}

impl Default for SensingSettings {
    /// 100 Hz, 4 periods (40 ms) at 20 kHz; noise of 10 mV and 5 nA (assumed).
    fn default() -> Self {
        Self {
            carrier_hz: 100.0,
            sample_time_s: 5e-5,
            n_periods: 4,
            voltage_noise_v: 0.01,
            current_noise_a: 5e-9,
        }
    }
}

/// What one window of samples tells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SensedDisplacement {
    /// Displacement from rest, mm, positive down: a mean over the window, which is centred half a window ago.
    pub displacement_mm: f64,
    /// Standard deviation of it that the stated noise makes, mm.
    pub standard_deviation_mm: f64,
    /// Differential capacitance dq/dPhi at the bias, F.
    pub capacitance_f: f64,
    /// Series resistance of the electrodes, ohm.
    pub series_resistance_ohm: f64,
    /// Mean voltage across the membrane, V.
    pub bias_v: f64,
}

/// Displacement from the capacitance, which a carrier shows.
///
/// **Method**: to each record of voltage u and current i a carrier and a cubic, which takes up the moving bias, are fitted by
/// least squares under a Hann window. The leak u/R_leak taken off, their
/// ratio is R_s + 1/(j w C), so its imaginary part gives C whatever R_s is. Around a bias it is the chord of the charge
/// C(x, Phi) Phi over the carrier's swing that is seen; it is inverted for x on the maps of the twin.
///
/// **Accuracy**: the noise of one window enters as g sqrt(s_u^2 + |Z|^2 s_i^2)/|I|, g about sqrt(3/N), into the imaginary part of Z. On top
/// come a few micrometres because the plate follows the carrier a little (tests), an error of the leak resistance, and what
/// creep does to the shape at a given displacement. C changes by 0.36 % for each mm: without a carrier, from the drive's
/// own pulse, the plate's motion at the same frequency would pass for half a millimetre.
#[derive(Debug, Clone, PartialEq)]
pub struct CapacitiveSensor {
    model: TwinModel,
    settings: SensingSettings,
    /// Times a record, summed: the phasor of its carrier.
    demodulator: Vec<Complex<f64>>,
    /// Standard deviation of a phasor's parts for samples with one of 1.
    noise_gain: f64,
    /// Hann window of sum 1.
    window: Vec<f64>,
}

/// Halvings of the displacement's range.
const BISECTIONS: usize = 50;
/// Step in displacement over which the slope of the capacitance is taken, mm.
const SLOPE_STEP_MM: f64 = 0.01;

impl CapacitiveSensor {
    /// A sensor for the device of `model`.
    ///
    /// # Errors
    /// [`Error::Parameter`] names the setting that is out of range; a window must hold whole samples of whole periods.
    pub fn new(model: &TwinModel, settings: SensingSettings) -> Result<Self, Error> {
        for (key, found) in [("carrier_hz", settings.carrier_hz), ("sample_time_s", settings.sample_time_s)] {
            require(found.is_finite() && found > 0.0, key, "finite and positive", found)?;
        }
        for (key, found) in
            [("voltage_noise_v", settings.voltage_noise_v), ("current_noise_a", settings.current_noise_a)]
        {
            require(found.is_finite() && found >= 0.0, key, "finite and not negative", found)?;
        }
        let periods = settings.n_periods as f64;
        require((4..=1000).contains(&settings.n_periods), "n_periods", "4 to 1000", periods)?;
        let length = periods / (settings.carrier_hz * settings.sample_time_s);
        let whole = (length - length.round()).abs() < 1e-6 * length;
        require(
            whole && length >= 8.0 * periods && length <= 1e6,
            "sample_time_s",
            "such that a window has a whole number of samples, at least 8 for each period and at most a million",
            settings.sample_time_s,
        )?;
        let n_samples = length.round() as usize;
        let window: Vec<f64> = (0..n_samples)
            .map(|k| (1.0 - (TAU * (k as f64 + 0.5) / n_samples as f64).cos()) / n_samples as f64)
            .collect();
        let demodulator = demodulator(&window, TAU * settings.n_periods as f64);
        // Both parts of the phasor carry half of this.
        let noise_gain = (0.5 * demodulator.iter().map(Complex::norm_sqr).sum::<f64>()).sqrt();
        Ok(Self { model: model.clone(), settings, demodulator, noise_gain, window })
    }

    /// Samples in one window.
    #[must_use]
    pub fn n_samples(&self) -> usize {
        self.window.len()
    }

    /// The displacement over the last window of the amplifier's voltage and current.
    ///
    /// # Errors
    /// [`Error::Request`] for records of another length than a window or each other, or with values that are not finite;
    /// [`Error::CapacitanceOutOfRange`] where no displacement of the maps has this capacitance, as without a carrier.
    pub fn estimate(&self, voltage_v: &[f64], current_a: &[f64]) -> Result<SensedDisplacement, Error> {
        for (quantity, record) in [("voltage samples", voltage_v), ("current samples", current_a)] {
            let found = record.len() as f64;
            if record.len() != self.window.len() {
                return Err(Error::Request { quantity, allowed: "as many as the window has", found });
            }
            if let Some(&found) = record.iter().find(|value| !value.is_finite()) {
                return Err(Error::Request { quantity, allowed: "finite", found });
            }
        }
        let spec = self.model.parameters().spec();
        let omega = TAU * self.settings.carrier_hz;
        let at_carrier = |record: &[f64]| -> Complex<f64> {
            record.iter().zip(&self.demodulator).map(|(value, factor)| factor * value).sum()
        };
        let mean = |record: &[f64]| record.iter().zip(&self.window).map(|(value, w)| value * w).sum::<f64>();
        let voltage = at_carrier(voltage_v);
        let current = at_carrier(current_a) - voltage / spec.leak_resistance_ohm;
        let impedance = voltage / current;
        let capacitance_f = -1.0 / (omega * impedance.im);
        let series_resistance_ohm = impedance.re;
        let charging = mean(current_a) - mean(voltage_v) / spec.leak_resistance_ohm;
        let bias_v = mean(voltage_v) - series_resistance_ohm * charging;
        let swing_v = (voltage - current * impedance.re).norm();
        let displacement_mm = self.displacement_mm(capacitance_f, bias_v, swing_v)?;
        let slope = (self.chord_f(displacement_mm + SLOPE_STEP_MM, bias_v, swing_v)
            - self.chord_f(displacement_mm - SLOPE_STEP_MM, bias_v, swing_v))
            / (2.0 * SLOPE_STEP_MM);
        let SensingSettings { voltage_noise_v, current_noise_a, .. } = self.settings;
        let reactance_noise =
            self.noise_gain * voltage_noise_v.hypot(impedance.norm() * current_noise_a) / current.norm();
        Ok(SensedDisplacement {
            displacement_mm,
            standard_deviation_mm: omega * capacitance_f * capacitance_f * reactance_noise / slope.abs(),
            capacitance_f,
            series_resistance_ohm,
            bias_v,
        })
    }

    /// Change of charge over the carrier's swing, F.
    fn chord_f(&self, displacement_mm: f64, bias_v: f64, swing_v: f64) -> f64 {
        let charge = |voltage: f64| self.model.capacitance_f(displacement_mm, voltage.abs()) * voltage;
        (charge(bias_v + swing_v) - charge(bias_v - swing_v)) / (2.0 * swing_v)
    }

    /// Where the chord has this capacitance: it grows with displacement.
    fn displacement_mm(&self, capacitance_f: f64, bias_v: f64, swing_v: f64) -> Result<f64, Error> {
        let range = self.model.range();
        let (mut low, mut high) = (range.min_mm, range.max_mm);
        let ends = [low, high].map(|x| self.chord_f(x, bias_v, swing_v));
        // Written so that NaN is refused too.
        if !(capacitance_f >= ends[0] && capacitance_f <= ends[1]) {
            return Err(Error::CapacitanceOutOfRange { capacitance_f, min_f: ends[0], max_f: ends[1] });
        }
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            if self.chord_f(middle, bias_v, swing_v) < capacitance_f { low = middle } else { high = middle }
        }
        Ok(0.5 * (low + high))
    }
}

/// Functions fitted: cosine and sine of the carrier, and the powers 0 to 3 of time.
const FITTED: usize = 6;

/// Rows of the weighted least-squares solution that give the carrier's phasor, cosine minus j sine; `turns_rad` is the
/// carrier's phase over the window.
fn demodulator(window: &[f64], turns_rad: f64) -> Vec<Complex<f64>> {
    let n = window.len() as f64;
    let functions = |k: usize| {
        let phase = turns_rad * k as f64 / n;
        // From -1 to 1, so that the powers stay apart.
        let t = (2.0 * k as f64 + 1.0) / n - 1.0;
        SVector::<f64, FITTED>::from([phase.cos(), phase.sin(), 1.0, t, t * t, t * t * t])
    };
    let mut normal = SMatrix::<f64, FITTED, FITTED>::zeros();
    for (k, w) in window.iter().enumerate() {
        let f = functions(k);
        normal += *w * f * f.transpose();
    }
    // Six independent functions on at least 32 samples: the matrix is positive definite.
    let inverse = normal.try_inverse().expect("independent functions");
    window
        .iter()
        .enumerate()
        .map(|(k, w)| {
            let row = inverse * functions(k) * *w;
            Complex::new(row[0], -row[1])
        })
        .collect()
}

fn require(holds: bool, key: &'static str, allowed: &'static str, found: f64) -> Result<(), Error> {
    if holds { Ok(()) } else { Err(Error::Parameter { key, allowed, found }) }
}
