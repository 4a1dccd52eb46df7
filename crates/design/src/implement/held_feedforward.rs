//! The drive that makes a held plate press along a reference, by inverting curve and circuit exactly.

use serde::{Deserialize, Serialize};
use telepulse_lti::SampleTime;

use super::flat_feedforward::FlatDrive;
use super::preview_smoother::{PreviewSmoother, SmootherOptions, preview_smoother};
use super::static_inverse::StaticInverse;
use crate::{Error, Result};

/// Feedforward for a plate that something stiff holds.
///
/// A held plate hardly moves, so that its force is a curve of the squared voltage behind the circuit: there is no motion to invert, and what
/// stiffness the plate is held with plays no part.
///
/// ```text
///   r --> smoother --> curve: squared voltage w --> sqrt --> voltage that brings the circuit there --> limits --> v^2
/// ```
///
/// **Shapes and units**: reference in mm-equivalents of relief; the command is the square of the voltage in units of full scale.
///
/// **Method**: the circuit `rc c' = v - c` is inverted over one sample, so that the hold of the drive is part of it: the voltage is the one
/// with which `c` arrives at the root of the curve's command at the end of the sample. The circuit is simulated along with what the
/// limits let through.
///
/// **Accuracy**: that of the curve, and of the smoother's [`expected_error`](PreviewSmoother::expected_error). Creep and the contact's own
/// resonance are left to the feedback.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "PlainFeedforward", into = "PlainFeedforward")]
pub struct HeldFeedforward {
    plain: PlainFeedforward,
    smoother: PreviewSmoother,
}

/// What determines a [`HeldFeedforward`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PlainFeedforward {
    curve: StaticInverse,
    rc_s: f64,
    smoother: SmootherOptions,
    sample_time_s: SampleTime,
    drive: FlatDrive,
}

impl HeldFeedforward {
    /// The feedforward for a reference that is known `options.horizon_s` ahead; any horizon from zero will do.
    ///
    /// `curve` gives the squared voltage (units) that holds a relief (mm-equivalents); `rc_s` is the circuit's time constant.
    ///
    /// # Errors
    /// As [`preview_smoother`]; [`Error::OutOfRange`] for a time constant or a drive out of range.
    pub fn new(
        curve: &StaticInverse,
        rc_s: f64,
        sample_time: SampleTime,
        options: &SmootherOptions,
        drive: FlatDrive,
    ) -> Result<Self> {
        let (curve, smoother) = (curve.clone(), *options);
        Self::try_from(PlainFeedforward { curve, rc_s, smoother, sample_time_s: sample_time, drive })
    }

    /// The smoother of the reference.
    #[must_use]
    pub fn smoother(&self) -> &PreviewSmoother {
        &self.smoother
    }

    /// From relief to squared voltage.
    #[must_use]
    pub fn curve(&self) -> &StaticInverse {
        &self.plain.curve
    }

    /// Time between samples.
    #[must_use]
    pub fn sample_time_s(&self) -> SampleTime {
        self.plain.sample_time_s
    }

    /// What the drive is taken to be able to do.
    #[must_use]
    pub fn drive(&self) -> FlatDrive {
        self.plain.drive
    }

    /// How far ahead the reference is read, s.
    #[must_use]
    pub fn horizon_s(&self) -> f64 {
        self.plain.smoother.horizon_s
    }

    /// The same plate for a reference that is known `horizon_s` ahead.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn with_horizon(&self, horizon_s: f64) -> Result<Self> {
        let mut plain = self.plain.clone();
        plain.smoother.horizon_s = horizon_s;
        Self::try_from(plain)
    }

    /// The command for a whole reference, from a circuit that has settled at its first value.
    #[must_use]
    pub fn apply(&self, reference_mm: &[f64]) -> Vec<f64> {
        let PlainFeedforward { curve, rc_s, sample_time_s, drive, .. } = &self.plain;
        let smooth = self.smoother.apply(reference_mm);
        let Some(first) = smooth.first() else { return Vec::new() };
        let ts = sample_time_s.seconds();
        let kept = (-ts / rc_s).exp();
        let slew = drive.slew_unit_per_s.unwrap_or(f64::INFINITY) * ts;
        let root = |relief: f64| curve.command(relief).max(0.0).sqrt();
        let (mut circuit, mut before) = (root(*first), root(*first));
        let ahead = self.ahead();
        (0..smooth.len())
            .map(|k| {
                let target = root(smooth[(k + ahead).min(smooth.len() - 1)]);
                let needed = (target - kept * circuit) / (1.0 - kept);
                let voltage =
                    needed.clamp(before - slew, before + slew).clamp(drive.min_unit, drive.max_unit);
                circuit = kept * circuit + (1.0 - kept) * voltage;
                before = voltage;
                voltage * voltage
            })
            .collect()
    }

    /// Samples from the start of a sample to where its voltage acts: one, unless nothing is known ahead.
    fn ahead(&self) -> usize {
        usize::from(self.plain.smoother.horizon_s >= self.plain.sample_time_s.seconds())
    }
}

impl From<HeldFeedforward> for PlainFeedforward {
    fn from(held: HeldFeedforward) -> Self {
        held.plain
    }
}

impl TryFrom<PlainFeedforward> for HeldFeedforward {
    type Error = Error;

    fn try_from(plain: PlainFeedforward) -> Result<Self> {
        let FlatDrive { min_unit, max_unit, slew_unit_per_s } = plain.drive;
        let slew = slew_unit_per_s.unwrap_or(1.0);
        for (key, found, ok, allowed) in [
            ("rc_s", plain.rc_s, plain.rc_s > 0.0, "above 0"),
            ("min_unit", min_unit, min_unit >= 0.0, "0 or above"),
            ("max_unit", max_unit, max_unit > min_unit, "above min_unit"),
            ("slew_unit_per_s", slew, slew > 0.0, "above 0"),
        ] {
            if !ok || !found.is_finite() {
                return Err(Error::OutOfRange { key, found, allowed });
            }
        }
        let ts = plain.sample_time_s.seconds();
        // One sample of the horizon is the circuit's.
        let horizon_s = if plain.smoother.horizon_s >= ts {
            plain.smoother.horizon_s - ts
        } else {
            plain.smoother.horizon_s
        };
        let options = SmootherOptions { horizon_s, ..plain.smoother };
        let smoother = preview_smoother(plain.sample_time_s, &options)?;
        Ok(Self { plain, smoother })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TS: f64 = 5e-4;
    const RC_S: f64 = 0.0045;
    const DRIVE: FlatDrive = FlatDrive { min_unit: 0.0, max_unit: 1.0, slew_unit_per_s: None };

    /// Relief of a made-up held plate, mm-equivalents.
    fn relief(w: f64) -> f64 {
        1.1 * w - 0.08 * w * w
    }

    fn held(horizon_s: f64, drive: FlatDrive) -> Result<HeldFeedforward> {
        let w: Vec<f64> = (0..=40).map(|k| f64::from(k) / 40.0).collect();
        let y: Vec<f64> = w.iter().map(|w| relief(*w)).collect();
        let curve = StaticInverse::new(&w, &y).expect("rises");
        let options = SmootherOptions { horizon_s, ..SmootherOptions::default() };
        HeldFeedforward::new(&curve, RC_S, SampleTime::new(TS).expect("positive"), &options, drive)
    }

    fn reference(n: usize) -> Vec<f64> {
        let harmonic = |k: usize, f: f64, a: f64| a * (std::f64::consts::TAU * f * k as f64 * TS).cos();
        (0..n)
            .map(|k| 0.45 - harmonic(k, 1.2, 0.2) + harmonic(k, 3.6, 0.05) - harmonic(k, 8.4, 0.02))
            .collect()
    }

    /// Largest error of the plate behind its circuit, integrated with a step sixteen times finer.
    fn worst(command: &[f64], reference: &[f64], judged: std::ops::Range<usize>) -> f64 {
        let mut circuit = command[0].sqrt();
        let mut worst = 0.0_f64;
        for (k, u) in command.iter().enumerate() {
            if judged.contains(&k) {
                worst = worst.max((relief(circuit * circuit) - reference[k]).abs());
            }
            for _ in 0..16 {
                circuit += TS / 16.0 / RC_S * (u.sqrt() - circuit) * (1.0 - TS / 32.0 / RC_S);
            }
        }
        worst
    }

    #[test]
    fn law_the_held_plate_follows_at_every_horizon_and_closer_with_a_longer_one() {
        let reference = reference(8000);
        let errors: Vec<f64> = [0.0, 0.005, 0.02, 0.04, 0.1, 0.25]
            .map(|horizon_s| {
                let command = held(horizon_s, DRIVE).expect("designs").apply(&reference);
                assert!(command.iter().all(|u| (0.0..=1.0).contains(u)));
                worst(&command, &reference, 1000..7400)
            })
            .to_vec();
        // The cubic through 41 points of the parabola is off by less than 1e-5; a step of TS/16 by 1e-6 of the motion.
        assert!(errors[5] < 5e-5 && errors[4] < 1e-4, "{errors:?}");
        assert!(errors[0] < 0.05, "{errors:?}");
        assert!(errors.windows(2).take(4).all(|pair| pair[1] < pair[0]), "{errors:?}");
    }

    #[test]
    fn law_rests_hold_and_limits_are_kept() {
        let at_rest = held(0.1, DRIVE).expect("designs").apply(&[0.4; 500]);
        // relief(w) = 0.4.
        let w = (1.1 - (1.21_f64 - 4.0 * 0.08 * 0.4).sqrt()) / 0.16;
        assert!(at_rest.iter().all(|u| (u - w).abs() < 1e-5), "{} {w}", at_rest[250]);
        let slow = FlatDrive { slew_unit_per_s: Some(2.0), max_unit: 0.8, ..DRIVE };
        let steps: Vec<f64> = (0..2000).map(|k| if k % 700 < 350 { 0.1 } else { 0.9 }).collect();
        let command = held(0.1, slow).expect("designs").apply(&steps);
        let roots: Vec<f64> = command.iter().map(|u| u.sqrt()).collect();
        assert!(roots.iter().all(|v| *v <= 0.8 + 1e-12));
        assert!(roots.windows(2).all(|pair| (pair[1] - pair[0]).abs() <= 2.0 * TS + 1e-12));
        assert!(held(0.1, DRIVE).expect("designs").apply(&[]).is_empty());
    }

    #[test]
    fn edge_numbers_out_of_range_are_refused_by_name() {
        let refused = |drive| held(0.1, drive).expect_err("refused").to_string();
        assert!(refused(FlatDrive { min_unit: -0.1, ..DRIVE }).contains("min_unit"));
        assert!(refused(FlatDrive { max_unit: 0.0, ..DRIVE }).contains("max_unit"));
        assert!(refused(FlatDrive { slew_unit_per_s: Some(0.0), ..DRIVE }).contains("slew_unit_per_s"));
        let text = serde_json::to_string(&held(0.1, DRIVE).expect("designs")).expect("writes");
        let read: HeldFeedforward = serde_json::from_str(&text).expect("reads");
        assert_eq!(read, held(0.1, DRIVE).expect("designs"));
        let bad = text.replacen("\"rc_s\":0.0045", "\"rc_s\":0.0", 1);
        assert!(serde_json::from_str::<HeldFeedforward>(&bad).expect_err("rc").to_string().contains("rc_s"));
    }
}
