//! The drive that makes a nonlinear plate follow a reference, by inverting its model exactly.

use serde::{Deserialize, Serialize};
use telepulse_lti::SampleTime;

use super::preview_smoother::{PreviewSmoother, SmootherOptions, preview_smoother};
use super::reference_governor::{Governor, ROUNDS_MAX};
use crate::identify::{GreyBoxModel, GreyBoxState};
use crate::{Error, Result};

/// What the drive can do, in units of full scale.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FlatDrive {
    /// Lowest voltage.
    pub min_unit: f64,
    /// Highest voltage.
    pub max_unit: f64,
    /// Largest change per second; `None` for no limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub slew_unit_per_s: Option<f64>,
}

/// Flatness-based feedforward.
///
/// The displacement of a grey-box model is a flat output: the pull that the plate needs, and with it the voltage, follow from it and its
/// derivatives without solving a differential equation but that of creep.
///
/// ```text
///   r --> smoother --> x, x', x'' --> pull that the plate needs --> drive w --> voltage that brings the circuit there --> limits --> v^2
///                           ^                                                                                              |
///                           +---- deviation x the model runs along with what the limits let through <----------------------+
/// ```
///
/// **Shapes and units**: reference in mm from rest; the command is the square of the voltage in units of full scale.
///
/// **Method**: the smoother knows the reference a horizon ahead; derivatives are central differences of its output. The model is simulated
/// along with the limited voltage. As long as no limit is met it is where the reference is and the command is the exact inverse; after a limit
/// it is led back with the poles of [`RECOVERY_RAD_S`], as long as the drive allows it. The circuit is inverted over one sample, so that the hold of
/// the drive is part of it.
///
/// **Source**: Fliess, Levine, Martin, Rouchon, "Flatness and defect of non-linear systems", Int. J. Control 61, 1995.
///
/// **Accuracy**: that of the model, and of the smoother's [`expected_error`](PreviewSmoother::expected_error).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "PlainFeedforward", into = "PlainFeedforward")]
pub struct FlatFeedforward {
    plain: PlainFeedforward,
    smoother: PreviewSmoother,
}

/// What determines a [`FlatFeedforward`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PlainFeedforward {
    model: GreyBoxModel,
    smoother: SmootherOptions,
    sample_time_s: SampleTime,
    drive: FlatDrive,
    governor_reach_s: f64,
}

impl FlatFeedforward {
    /// The feedforward for a reference that is known `options.horizon_s` ahead.
    ///
    /// With a horizon of more than [`GOVERNED_FROM_S`] the smoother gets half of it and a reference governor the other half; a shorter one
    /// is the smoother's alone. [`AHEAD`] samples are spent on the differences, where there are as many.
    ///
    /// # Errors
    /// As [`preview_smoother`]; [`Error::OutOfRange`] for a drive without a range.
    pub fn new(
        model: &GreyBoxModel,
        sample_time: SampleTime,
        options: &SmootherOptions,
        drive: FlatDrive,
    ) -> Result<Self> {
        let governor_reach_s =
            if options.horizon_s > GOVERNED_FROM_S { 0.5 * options.horizon_s } else { 0.0 };
        let smoother = SmootherOptions { horizon_s: options.horizon_s - governor_reach_s, ..*options };
        Self::try_from(PlainFeedforward {
            model: model.clone(),
            smoother,
            sample_time_s: sample_time,
            drive,
            governor_reach_s,
        })
    }

    /// The same with another model of the plant.
    pub(super) fn with_model(&self, model: GreyBoxModel) -> Self {
        Self { plain: PlainFeedforward { model, ..self.plain.clone() }, smoother: self.smoother.clone() }
    }

    /// The model that is inverted.
    #[must_use]
    pub fn model(&self) -> &GreyBoxModel {
        &self.plain.model
    }

    /// The smoother of the reference.
    #[must_use]
    pub fn smoother(&self) -> &PreviewSmoother {
        &self.smoother
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
        self.plain.smoother.horizon_s + self.plain.governor_reach_s
    }

    /// The command for a whole reference that starts from relaxed rest at its first value.
    ///
    /// With a horizon shorter than [`AHEAD`] samples, the derivatives are those of so many samples ago.
    #[must_use]
    pub fn apply(&self, reference_mm: &[f64]) -> Vec<f64> {
        let wanted = self.smoother.apply(reference_mm);
        let mut reference = wanted.clone();
        for _ in 0..ROUNDS_MAX {
            let pass = self.pass(&reference);
            if pass.outside.is_empty() || self.plain.governor_reach_s == 0.0 {
                return pass.command;
            }
            self.governor().soften(&mut reference, &wanted, &pass.outside, &pass.creep);
        }
        self.pass(&reference).command
    }

    fn governor(&self) -> Governor<'_> {
        let PlainFeedforward { model, drive, sample_time_s, governor_reach_s, .. } = &self.plain;
        Governor { model, drive: *drive, sample_time_s: sample_time_s.seconds(), reach_s: *governor_reach_s }
    }

    /// The model led along a smooth reference, from relaxed rest at its first value.
    fn pass(&self, smooth: &[f64]) -> Pass {
        let ts = self.plain.sample_time_s.seconds();
        let mut pass = Pass::default();
        let Some(first) = smooth.first() else { return pass };
        // The end of the sample is what the voltage of its start can still reach: one sample, and three for the differences.
        let next = (self.plain.smoother.horizon_s / ts + 1e-9).min(AHEAD as f64) as isize - REACH as isize;
        let last = smooth.len() as isize - 1;
        let drive = self.plain.drive;
        let mut state = self.relaxed_at(*first);
        for k in 0..=last {
            let at = |i: isize| smooth[(k + next + i).clamp(0, last) as usize];
            let samples: [f64; 7] = std::array::from_fn(|i| at(i as isize - REACH as isize));
            let needed = self.needed_voltage(&Wanted::of(&samples, ts), &state);
            if needed < drive.min_unit - OUTSIDE_UNIT || needed > drive.max_unit + OUTSIDE_UNIT {
                pass.outside.push(k as usize);
            }
            let slew = drive.slew_unit_per_s.unwrap_or(f64::INFINITY) * ts;
            let before = pass.command.last().map_or(state.circuit_unit, |u: &f64| u.sqrt());
            let voltage = needed.clamp(before - slew, before + slew).clamp(drive.min_unit, drive.max_unit);
            pass.creep.push(self.dashpot_pull(&state));
            self.plain.model.advance(&mut state, voltage, ts);
            pass.command.push(voltage * voltage);
        }
        pass
    }

    /// Sum of stiffness times position over the dashpots, mm/s^2.
    fn dashpot_pull(&self, state: &GreyBoxState) -> f64 {
        let pairs = self.plain.model.branches().iter().zip(&state.branches_mm);
        pairs.map(|(branch, xi)| branch.stiffness_per_s2 * xi).sum()
    }

    pub(super) fn relaxed_at(&self, displacement_mm: f64) -> GreyBoxState {
        let model = &self.plain.model;
        GreyBoxState {
            displacement_mm,
            velocity_mm_per_s: 0.0,
            circuit_unit: model.drive_for(displacement_mm, 0.0, DRIVE_RANGE).sqrt(),
            branches_mm: vec![displacement_mm; model.branches().len()],
        }
    }

    /// The voltage that brings the model to what is wanted at the end of the sample, whatever the drive can do.
    pub(super) fn needed_voltage(&self, wanted: &Wanted, state: &GreyBoxState) -> f64 {
        let model = &self.plain.model;
        let ts = self.plain.sample_time_s.seconds();
        let (x, v) = (state.displacement_mm, state.velocity_mm_per_s);
        let stiffness: f64 = model.branches().iter().map(|branch| branch.stiffness_per_s2).sum();
        let dashpots = self.dashpot_pull(state);
        let resisted = |x: f64, v: f64| model.damping_per_s() * v + stiffness * x - dashpots;
        let acceleration = model.pull(x, state.circuit_unit.powi(2))[0] - resisted(x, v);
        let end_v = v + ts * acceleration;
        let end_x = x + ts * (v + 0.5 * ts * acceleration);
        let led_back = wanted.acceleration
            + 2.0 * RECOVERY_RAD_S * (wanted.velocity - end_v)
            + RECOVERY_RAD_S.powi(2) * (wanted.displacement - end_x);
        let w = model.drive_for(end_x, led_back + resisted(end_x, end_v), DRIVE_RANGE);
        let kept = (-ts / model.rc_s()).exp();
        (w.sqrt() - kept * state.circuit_unit) / (1.0 - kept)
    }
}

/// What came of leading the model along a reference.
#[derive(Default)]
struct Pass {
    /// Squared voltage at each sample.
    command: Vec<f64>,
    /// Samples at which more was needed than the drive can do.
    outside: Vec<usize>,
    /// Sum of stiffness times dashpot position at each sample, mm/s^2.
    creep: Vec<f64>,
}

/// The smooth reference at one time.
pub(super) struct Wanted {
    displacement: f64,
    velocity: f64,
    acceleration: f64,
}

impl Wanted {
    /// From seven samples about that time, by central differences of sixth order.
    pub(super) fn of(r: &[f64; 7], ts: f64) -> Self {
        let velocity = (45.0 * (r[4] - r[2]) - 9.0 * (r[5] - r[1]) + (r[6] - r[0])) / (60.0 * ts);
        let sum = 270.0 * (r[4] + r[2]) - 27.0 * (r[5] + r[1]) + 2.0 * (r[6] + r[0]) - 490.0 * r[3];
        Self { displacement: r[3], velocity, acceleration: sum / (180.0 * ts * ts) }
    }
}

/// Samples on each side that the differences read.
const REACH: usize = 3;
/// Samples of the horizon that are not the smoother's: the reach of the differences and the sample at whose end the circuit arrives.
pub const AHEAD: usize = REACH + 1;
/// Poles with which the model is led back to the reference after a limit, rad/s: several times faster than a plate of a few hertz, and
/// slow against the samples.
pub const RECOVERY_RAD_S: f64 = 100.0;
/// A shorter horizon is not divided: too little to act ahead of a limit.
pub const GOVERNED_FROM_S: f64 = 0.05;
/// A voltage this far outside of the drive's range is worth a governor's work.
const OUTSIDE_UNIT: f64 = 0.002;
/// Squared voltages that are looked for: beyond full scale the limits of the drive decide.
const DRIVE_RANGE: [f64; 2] = [0.0, 4.0];

impl From<FlatFeedforward> for PlainFeedforward {
    fn from(flat: FlatFeedforward) -> Self {
        flat.plain
    }
}

impl TryFrom<PlainFeedforward> for FlatFeedforward {
    type Error = Error;

    fn try_from(plain: PlainFeedforward) -> Result<Self> {
        let FlatDrive { min_unit, max_unit, slew_unit_per_s } = plain.drive;
        let slew = slew_unit_per_s.unwrap_or(1.0);
        for (key, found, ok, allowed) in [
            ("min_unit", min_unit, min_unit >= 0.0, "0 or above"),
            ("max_unit", max_unit, max_unit > min_unit, "above min_unit"),
            ("slew_unit_per_s", slew, slew > 0.0, "above 0"),
            (
                "governor_reach_s",
                plain.governor_reach_s,
                (0.0..=1.0).contains(&plain.governor_reach_s),
                "0 to 1",
            ),
        ] {
            if !ok || !found.is_finite() {
                return Err(Error::OutOfRange { key, found, allowed });
            }
        }
        let ts = plain.sample_time_s.seconds();
        let horizon_s = (plain.smoother.horizon_s - AHEAD as f64 * ts).max(0.0);
        let smoother =
            preview_smoother(plain.sample_time_s, &SmootherOptions { horizon_s, ..plain.smoother })?;
        Ok(Self { plain, smoother })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::{CreepBranch, PullTerm};

    fn model() -> GreyBoxModel {
        let term = |i, j, coefficient| PullTerm { displacement_power: i, drive_power: j, coefficient };
        let terms = vec![term(1, 0, -1425.0), term(0, 1, 1300.0), term(2, 0, -13.0), term(1, 1, 190.0)];
        let branch =
            |stiffness_per_s2, relaxation_time_s| CreepBranch { stiffness_per_s2, relaxation_time_s };
        GreyBoxModel::new(0.0045, 15.9, terms, vec![branch(22.0, 0.6), branch(25.0, 6.7)], 1.0)
            .expect("valid")
    }

    fn feedforward(horizon_s: f64, slew_unit_per_s: Option<f64>) -> FlatFeedforward {
        let options = SmootherOptions { horizon_s, ..SmootherOptions::default() };
        let drive = FlatDrive { min_unit: 0.0, max_unit: 1.0, slew_unit_per_s };
        FlatFeedforward::new(&model(), SampleTime::new(5e-4).expect("positive"), &options, drive)
            .expect("designs")
    }

    /// Displacement of the model under a command, and the largest error against the reference over some samples.
    fn worst_error(command: &[f64], reference: &[f64], judged: std::ops::Range<usize>) -> f64 {
        let model = model();
        let mut state = feedforward(0.1, None).relaxed_at(reference[0]);
        let mut worst = 0.0_f64;
        for (k, (u, r)) in command.iter().zip(reference).enumerate() {
            if judged.contains(&k) {
                worst = worst.max((state.displacement_mm - r).abs());
            }
            model.advance(&mut state, u.sqrt(), 5e-4);
        }
        worst
    }

    /// A pulse-like reference about 0.45 mm: three harmonics of 1.2 Hz.
    fn smooth_reference(n: usize) -> Vec<f64> {
        let harmonic = |k: usize, f: f64, a: f64| a * (std::f64::consts::TAU * f * k as f64 * 5e-4).cos();
        (0..n)
            .map(|k| 0.45 - harmonic(k, 1.2, 0.2) + harmonic(k, 3.6, 0.05) - harmonic(k, 8.4, 0.02))
            .collect()
    }

    #[test]
    fn law_the_model_follows_a_smooth_reference_exactly() {
        let reference = smooth_reference(8000);
        for horizon_s in [0.2, 0.1, 0.04] {
            let command = feedforward(horizon_s, None).apply(&reference);
            assert!(command.iter().all(|u| (0.0..=1.0).contains(u)));
            // The end of a record is held, so its last 0.3 s are not judged. 60 Hz leave 2e-7 of 8.4 Hz; the circuit's arrival at the end of each sample leaves the rest.
            let worst = worst_error(&command, &reference, 1000..7400);
            assert!(worst < 2e-4, "{horizon_s} s: {worst} mm");
        }
    }

    #[test]
    fn law_without_preview_it_lags_and_stays_bounded() {
        let reference = smooth_reference(8000);
        let worst = worst_error(&feedforward(0.0, None).apply(&reference), &reference, 1000..7400);
        assert!((1e-3..0.05).contains(&worst), "{worst} mm");
    }

    #[test]
    fn law_a_governed_rise_that_is_too_steep_is_closer_than_a_limited_one() {
        // 0.5 mm within 25 ms: more than full scale can do.
        let rise = |k: usize| {
            let t = ((k as f64 - 2000.0) / 50.0).clamp(0.0, 1.0);
            0.2 + 0.5 * t * t * (3.0 - 2.0 * t)
        };
        let reference: Vec<f64> = (0..6000).map(rise).collect();
        let governed = feedforward(0.2, None);
        let command = governed.apply(&reference);
        assert!(command.iter().all(|u| (0.0..=1.0).contains(u)));
        // The same smoother without the governor.
        let mut plain = governed.plain.clone();
        plain.governor_reach_s = 0.0;
        let limited = FlatFeedforward::try_from(plain).expect("valid");
        let square = |command: &[f64]| -> f64 {
            let model = model();
            let mut state = governed.relaxed_at(reference[0]);
            command
                .iter()
                .zip(&reference)
                .map(|(u, r)| {
                    let error = state.displacement_mm - r;
                    model.advance(&mut state, u.sqrt(), 5e-4);
                    error * error
                })
                .sum()
        };
        let (with, without) = (square(&command), square(&limited.apply(&reference)));
        assert!(with < 0.5 * without, "{with} {without}");
    }

    #[test]
    fn law_slew_and_range_are_never_left() {
        let command = feedforward(0.2, Some(4.0)).apply(&smooth_reference(8000));
        let voltage: Vec<f64> = command.iter().map(|u| u.sqrt()).collect();
        assert!(voltage.windows(2).all(|pair| (pair[1] - pair[0]).abs() <= 4.0 * 5e-4 + 1e-12));
        assert!(feedforward(0.2, None).apply(&[]).is_empty());
    }

    #[test]
    fn law_a_file_holds_what_determines_it_and_is_checked() {
        let flat = feedforward(0.2, None);
        let text = serde_json::to_string(&flat).expect("writes");
        assert!(!text.contains("taps"));
        assert_eq!(serde_json::from_str::<FlatFeedforward>(&text).expect("reads"), flat);
        let bad = text.replace("\"max_unit\":1.0", "\"max_unit\":-1.0");
        assert!(
            serde_json::from_str::<FlatFeedforward>(&bad)
                .expect_err("refused")
                .to_string()
                .contains("max_unit")
        );
    }
}
