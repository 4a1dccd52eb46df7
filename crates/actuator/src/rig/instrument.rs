//! What an instrument does to a true value: sine, white noise, steps, range.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use telepulse_rt::{MonotonicNs, Reading, SensorFault};

use super::SensingSine;
use crate::Error;

/// Noise, steps and range of an instrument, in its own unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Imperfections {
    pub(super) noise_rms: f64,
    pub(super) resolution: f64,
    pub(super) min: f64,
    pub(super) max: f64,
}

/// An instrument with its own stream of random numbers.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Instrument {
    imperfections: Imperfections,
    sine: Option<SensingSine>,
    noise: Gaussian,
}

impl Instrument {
    pub(super) fn new(
        imperfections: Imperfections,
        sine: Option<SensingSine>,
        seed: u64,
    ) -> Result<Self, Error> {
        let Imperfections { noise_rms, resolution, min, max } = imperfections;
        for (quantity, found) in [("sensor noise", noise_rms), ("sensor resolution", resolution)] {
            if !(found.is_finite() && found >= 0.0) {
                return Err(Error::Request { quantity, allowed: "finite and not negative", found });
            }
        }
        if !(min.is_finite() && max.is_finite() && min < max) {
            return Err(Error::Request {
                quantity: "upper end of the sensor range",
                allowed: "above the lower end",
                found: max,
            });
        }
        if let Some(sine) = sine {
            sine.check()?;
        }
        Ok(Self { imperfections, sine, noise: Gaussian::new(seed) })
    }

    /// What the instrument shows for a true value at `now`. Every call draws one random number.
    pub(super) fn show(&mut self, now: MonotonicNs, truth: f64) -> Result<Reading, SensorFault> {
        let Imperfections { noise_rms, resolution, min, max } = self.imperfections;
        let sine = self.sine.map_or(0.0, |sine| sine.at(now));
        let analog = truth + sine + noise_rms * self.noise.draw();
        let value = if resolution > 0.0 { (analog / resolution).round() * resolution } else { analog };
        if !value.is_finite() {
            return Err(SensorFault::NotFinite);
        }
        if !(min..=max).contains(&value) {
            return Err(SensorFault::OutOfRange { value, min, max });
        }
        Ok(Reading { value })
    }
}

/// Standard normal numbers from a seed.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Gaussian(Pcg64Mcg);

impl Gaussian {
    pub(super) fn new(seed: u64) -> Self {
        Self(Pcg64Mcg::seed_from_u64(seed))
    }

    /// The next number, by Box and Muller.
    pub(super) fn draw(&mut self) -> f64 {
        // 53 random bits, moved by half a step so that the logarithm never sees zero.
        let mut uniform = || ((self.0.next_u64() >> 11) as f64 + 0.5) * (0.5_f64).powi(53);
        let radius = (-2.0 * uniform().ln()).sqrt();
        radius * (2.0 * std::f64::consts::PI * uniform()).cos()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_noise_has_the_stated_spread_and_repeats_from_its_seed() {
        let imperfections = Imperfections { noise_rms: 0.003, resolution: 0.001, min: -1.0, max: 1.0 };
        let run = |seed: u64| -> Vec<f64> {
            let mut instrument = Instrument::new(imperfections, None, seed).expect("valid");
            (0..20_000).map(|k| instrument.show(MonotonicNs(k), 0.2).expect("in range").value).collect()
        };
        let values = run(7);
        let mean = values.iter().sum::<f64>() / 2e4;
        let rms = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 2e4).sqrt();
        // Quantisation adds q^2/12; standard errors over 20000 samples: 2e-5 of the mean, 0.5 % of the spread; 5 of them.
        let expected = (0.003_f64.powi(2) + 0.001_f64.powi(2) / 12.0).sqrt();
        assert!((mean - 0.2).abs() < 1.1e-4, "{mean}");
        assert!((rms / expected - 1.0).abs() < 0.025, "{rms} {expected}");
        for value in &values {
            assert!((value / 0.001 - (value / 0.001).round()).abs() < 1e-9);
        }
        assert_eq!(values, run(7));
        assert_ne!(values, run(8));
    }

    #[test]
    fn edge_nan_and_out_of_range_are_faults() {
        let imperfections = Imperfections { noise_rms: 0.0, resolution: 0.0, min: 30.0, max: 70.0 };
        let mut instrument = Instrument::new(imperfections, None, 1).expect("valid");
        assert_eq!(instrument.show(MonotonicNs(0), f64::NAN), Err(SensorFault::NotFinite));
        assert_eq!(
            instrument.show(MonotonicNs(0), 71.0),
            Err(SensorFault::OutOfRange { value: 71.0, min: 30.0, max: 70.0 })
        );
        let bad = Imperfections { noise_rms: -1.0, ..imperfections };
        assert!(Instrument::new(bad, None, 1).is_err());
    }
}
