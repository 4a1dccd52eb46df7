//! Self-sensing: the plate's displacement from voltage and current at the amplifier.

use std::f64::consts::TAU;

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
/// **Shapes and units**: `u[k]` (V) is held over sample k, `i[k]` (A) is the mean current over it, as integrating converters give
/// both; `dt` is the sample time.
///
/// **Method**: the leak u/R_leak taken off, the charge at the start of each sample is q\[k\] = dt (i\[0\] + .. + i\[k-1\]) but for a constant,
/// and for a constant capacitance u\[k\] = q\[k\]/C + R' i\[k\] + constant holds exactly, whatever the drive does, with
/// R' = dt/(C (1 - exp(-dt/(R_s C)))). 1/C and R' are fitted by least squares under a Hann window; a cubic in time takes up the
/// constant and what the plate's motion does to q/C. Around a bias it is the chord of the charge C(x, Phi) Phi over the
/// carrier's swing that is seen; it is inverted for x on the maps of the twin.
///
/// **Accuracy**: the noise of the samples is carried through to the estimate. On top come a few micrometres because the plate follows
/// the carrier a little, what motion within a window leaves beside a cubic (0.02 mm at 1.2 Hz, tests), an error of the
/// leak resistance, and what creep does to the shape at a given displacement. C changes by 0.36 % for each mm: without a
/// carrier, from the drive's own pulse, the plate's motion at the same frequency would pass for half a millimetre. A jump of the bias within
/// the window passes for some tenths of a millimetre, since C at a given displacement changes with voltage.
#[derive(Debug, Clone, PartialEq)]
pub struct CapacitiveSensor {
    model: TwinModel,
    settings: SensingSettings,
    /// Hann window of sum 1.
    window: Vec<f64>,
    /// Powers 0 to 3 of time, orthonormal under the window.
    powers: [Vec<f64>; N_POWERS],
}

/// Powers of time beside the circuit.
const N_POWERS: usize = 4;
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
        let powers = orthonormal_powers(&window);
        Ok(Self { model: model.clone(), settings, window, powers })
    }

    /// Samples in one window.
    #[must_use]
    pub fn n_samples(&self) -> usize {
        self.window.len()
    }

    /// Time by which an estimate lags: half a window, s.
    #[must_use]
    pub fn lag_s(&self) -> f64 {
        0.5 * self.n_samples() as f64 * self.settings.sample_time_s
    }

    /// Weights of the samples in an estimate, of sum 1.
    pub(crate) fn window(&self) -> &[f64] {
        &self.window
    }

    /// The displacement over the last window of the amplifier's voltage (held over each sample) and current (mean over each sample).
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
        let leak_ohm = self.model.parameters().spec().leak_resistance_ohm;
        let dt = self.settings.sample_time_s;
        let charging: Vec<f64> = current_a.iter().zip(voltage_v).map(|(i, u)| i - u / leak_ohm).collect();
        let mut charge = 0.0;
        let charges: Vec<f64> = charging
            .iter()
            .map(|i| {
                let before = charge;
                charge += i * dt;
                before
            })
            .collect();
        let seen = self.circuit(voltage_v, &charging, &charges);
        let capacitance_f = 1.0 / seen.elastance_per_f;
        let mean = |record: &[f64]| record.iter().zip(&self.window).map(|(value, w)| value * w).sum::<f64>();
        let bias_v = mean(voltage_v) - seen.resistance_ohm * mean(&charging);
        let swing_v = seen.charge_swing_c * seen.elastance_per_f;
        let displacement_mm = self.displacement_mm(capacitance_f, bias_v, swing_v)?;
        let slope = (self.chord_f(displacement_mm + SLOPE_STEP_MM, bias_v, swing_v)
            - self.chord_f(displacement_mm - SLOPE_STEP_MM, bias_v, swing_v))
            / (2.0 * SLOPE_STEP_MM);
        // R' = dt/(C (1 - a)), a = exp(-dt/(R_s C)).
        let decay = 1.0 - dt * seen.elastance_per_f / seen.resistance_ohm;
        let series_resistance_ohm = -dt * seen.elastance_per_f / decay.ln();
        Ok(SensedDisplacement {
            displacement_mm,
            standard_deviation_mm: capacitance_f * capacitance_f * seen.elastance_noise / slope.abs(),
            capacitance_f,
            series_resistance_ohm,
            bias_v,
        })
    }

    /// Fits u = q/C + R' i + cubic.
    fn circuit(&self, voltage_v: &[f64], charging_a: &[f64], charges_c: &[f64]) -> SeenCircuit {
        let [u, q, i] = [voltage_v, charges_c, charging_a].map(|record| self.without_powers(record));
        let dot = |a: &[f64], b: &[f64]| -> f64 {
            a.iter().zip(b).zip(&self.window).map(|((a, b), w)| a * b * w).sum()
        };
        let (qq, qi, ii) = (dot(&q, &q), dot(&q, &i), dot(&i, &i));
        let (uq, ui) = (dot(&u, &q), dot(&u, &i));
        let determinant = qq * ii - qi * qi;
        let elastance_per_f = (uq * ii - ui * qi) / determinant;
        let resistance_ohm = (ui * qq - uq * qi) / determinant;
        // 1/C is a sum of g[k] u[k] with these weights; the cubic is in neither q nor i.
        let weights =
            q.iter().zip(&i).zip(&self.window).map(|((q, i), w)| w * (q * ii - i * qi) / determinant);
        let weights: Vec<f64> = weights.collect();
        let SensingSettings { voltage_noise_v, current_noise_a, sample_time_s, .. } = self.settings;
        // A current's error enters by R' at once and by q/C from the next sample on.
        let (mut variance, mut later) = (0.0, 0.0);
        for g in weights.iter().rev() {
            let by_current = resistance_ohm * g + sample_time_s * elastance_per_f * later;
            variance += (voltage_noise_v * g).powi(2) + (current_noise_a * by_current).powi(2);
            later += g;
        }
        SeenCircuit {
            elastance_per_f,
            resistance_ohm,
            charge_swing_c: (2.0 * qq).sqrt(),
            elastance_noise: variance.sqrt(),
        }
    }

    /// What a cubic leaves of a record.
    fn without_powers(&self, record: &[f64]) -> Vec<f64> {
        let mut left = record.to_vec();
        // Each part is taken from what the ones before have left: rounding does not add up.
        for power in &self.powers {
            let part: f64 = left.iter().zip(power).zip(&self.window).map(|((v, p), w)| v * p * w).sum();
            for (value, p) in left.iter_mut().zip(power) {
                *value -= part * p;
            }
        }
        left
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
        // Without a carrier nothing determines C: the quotient may be anything, or no number.
        let capacitance_f = if capacitance_f.is_finite() { capacitance_f } else { 0.0 };
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

/// What a window shows of the circuit.
struct SeenCircuit {
    /// 1/C.
    elastance_per_f: f64,
    /// R'.
    resistance_ohm: f64,
    /// Amplitude of a sine with the charge's mean square.
    charge_swing_c: f64,
    /// Standard deviation of 1/C by the stated noise.
    elastance_noise: f64,
}

/// Powers 0 to 3 of time, made orthonormal under the window by Gram and Schmidt.
fn orthonormal_powers(window: &[f64]) -> [Vec<f64>; N_POWERS] {
    let n = window.len() as f64;
    let mut powers: [Vec<f64>; N_POWERS] = Default::default();
    for degree in 0..N_POWERS {
        // From -1 to 1, so that the powers stay apart.
        let mut power: Vec<f64> =
            (0..window.len()).map(|k| ((2.0 * k as f64 + 1.0) / n - 1.0).powi(degree as i32)).collect();
        for lower in &powers[..degree] {
            let part: f64 = power.iter().zip(lower).zip(window).map(|((a, b), w)| a * b * w).sum();
            for (value, l) in power.iter_mut().zip(lower) {
                *value -= part * l;
            }
        }
        let norm = power.iter().zip(window).map(|(p, w)| p * p * w).sum::<f64>().sqrt();
        power.iter_mut().for_each(|value| *value /= norm);
        powers[degree] = power;
    }
    powers
}

fn require(holds: bool, key: &'static str, allowed: &'static str, found: f64) -> Result<(), Error> {
    if holds { Ok(()) } else { Err(Error::Parameter { key, allowed, found }) }
}
