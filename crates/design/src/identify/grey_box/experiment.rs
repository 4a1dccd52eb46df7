//! The drive that shows stroke, resonance and creep in one record.

use std::f64::consts::TAU;

use num_complex::Complex64;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use realfft::RealFftPlanner;

use crate::{Error, Result};

/// What a grey-box experiment should do, as typed.
#[derive(Debug, Clone, PartialEq)]
pub struct GreyBoxExperimentOptions {
    /// Levels of the squared voltage, in units of full scale squared, that are held one after another.
    pub levels: Vec<f64>,
    /// Time for which each level is held, s.
    pub hold_s: f64,
    /// Mean of the multisine, squared voltage.
    pub bias: f64,
    /// Largest excursion of the multisine from its mean, squared voltage.
    pub peak: f64,
    /// Lines of the multisine, Hz: all multiples of the lowest one up to the highest.
    pub frequency_min_hz: f64,
    /// Highest line, Hz.
    pub frequency_max_hz: f64,
    /// Periods of the lowest line, each with phases of its own.
    pub n_realisations: usize,
    /// Samples per second.
    pub sample_rate_hz: f64,
    /// Seed of the phases.
    pub seed: u64,
}

impl Default for GreyBoxExperimentOptions {
    /// Nine levels of 3 s up to 0.9 and back, then four multisines of 10 s with lines from 0.1 to 20 Hz about 0.45.
    fn default() -> Self {
        Self {
            levels: vec![0.1, 0.3, 0.6, 0.9, 0.45, 0.75, 0.2, 0.5, 0.05],
            hold_s: 3.0,
            bias: 0.45,
            peak: 0.4,
            frequency_min_hz: 0.1,
            frequency_max_hz: 20.0,
            n_realisations: 4,
            sample_rate_hz: 2000.0,
            seed: 1,
        }
    }
}

/// A checked experiment.
///
/// The command is the *square* of the voltage in units of full scale, held between samples.
#[derive(Debug, Clone, PartialEq)]
pub struct GreyBoxExperiment {
    drive: Vec<f64>,
    sample_rate_hz: f64,
}

impl GreyBoxExperiment {
    /// Checks the options and places every sample.
    ///
    /// **Method**: the amplitudes of the multisine fall with frequency beyond 3 Hz as `1/f`, so that a resonant plate of a few
    /// hertz is moved alike by all lines; every realisation is scaled to the same peak.
    ///
    /// # Errors
    /// [`Error::EmptyList`] without levels; [`Error::OutOfRange`] for a drive that leaves 0 to 1 or lines that do not fit the sample rate.
    pub fn new(options: &GreyBoxExperimentOptions) -> Result<Self> {
        check(options)?;
        let rate = options.sample_rate_hz;
        let n_hold = (options.hold_s * rate).round() as usize;
        let mut drive = vec![0.0; (0.5 * rate).round() as usize];
        for level in &options.levels {
            drive.extend(std::iter::repeat_n(*level, n_hold));
        }
        drive.extend(std::iter::repeat_n(options.bias, n_hold));
        let mut random = Pcg64Mcg::seed_from_u64(options.seed);
        for _ in 0..options.n_realisations {
            drive.extend(multisine(options, &mut random));
        }
        Ok(Self { drive, sample_rate_hz: rate })
    }

    /// Squared voltage of every sample, units of full scale squared.
    #[must_use]
    pub fn drive(&self) -> &[f64] {
        &self.drive
    }

    /// Samples per second.
    #[must_use]
    pub fn sample_rate_hz(&self) -> f64 {
        self.sample_rate_hz
    }

    /// Length in s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.drive.len() as f64 / self.sample_rate_hz
    }
}

fn multisine(options: &GreyBoxExperimentOptions, random: &mut Pcg64Mcg) -> Vec<f64> {
    let n = (options.sample_rate_hz / options.frequency_min_hz).round() as usize;
    let n_lines = (options.frequency_max_hz / options.frequency_min_hz).floor() as usize;
    let transform = RealFftPlanner::<f64>::new().plan_fft_inverse(n);
    let mut spectrum = transform.make_input_vec();
    for (line, bin) in spectrum.iter_mut().enumerate().skip(1).take(n_lines) {
        let amplitude = (ROLL_OFF_HZ / (line as f64 * options.frequency_min_hz)).min(1.0);
        *bin = Complex64::from_polar(amplitude, TAU * f64::from(random.next_u32()) / f64::from(u32::MAX));
    }
    let mut wave = transform.make_output_vec();
    assert!(transform.process(&mut spectrum, &mut wave).is_ok(), "buffers of the planned length, ends real");
    let top = wave.iter().fold(0.0, |top: f64, value| top.max(value.abs()));
    for value in &mut wave {
        *value = options.bias + options.peak * *value / top;
    }
    wave
}

/// Up to here all lines have the same amplitude.
const ROLL_OFF_HZ: f64 = 3.0;

fn check(options: &GreyBoxExperimentOptions) -> Result<()> {
    if options.levels.is_empty() {
        return Err(Error::EmptyList { key: "levels" });
    }
    for &found in &options.levels {
        if !(0.0..=1.0).contains(&found) {
            return Err(Error::OutOfRange { key: "levels", found, allowed: "0 to 1" });
        }
    }
    let GreyBoxExperimentOptions { bias, peak, frequency_min_hz, frequency_max_hz, sample_rate_hz, .. } =
        *options;
    let rules = [
        ("bias - peak", bias - peak, bias - peak >= 0.0, "not negative: the square of a voltage"),
        ("bias + peak", bias + peak, bias + peak <= 1.0, "up to 1"),
        ("hold_s", options.hold_s, options.hold_s > 0.0, "above 0"),
        ("frequency_min_hz", frequency_min_hz, frequency_min_hz > 0.0, "above 0"),
        (
            "frequency_max_hz",
            frequency_max_hz,
            frequency_max_hz >= frequency_min_hz && frequency_max_hz < 0.25 * sample_rate_hz,
            "from the lowest line to a quarter of the sample rate",
        ),
    ];
    match rules.into_iter().find(|(_, found, ok, _)| !(*ok && found.is_finite())) {
        Some((key, found, _, allowed)) => Err(Error::OutOfRange { key, found, allowed }),
        None => Ok(()),
    }
}
