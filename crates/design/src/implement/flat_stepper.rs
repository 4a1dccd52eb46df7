//! The flatness-based feedforward one sample at a time, with a model that may be scheduled anew in between.

use super::flat_feedforward::{AHEAD, FlatFeedforward, Wanted};
use crate::identify::{CreepBranch, GreyBoxModel, GreyBoxState, PullTerm};
use crate::{Error, Result};

/// How a plant differs from the model that was identified.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlantChange {
    /// Gain of the drive over that of the spring, against the identified one.
    pub gain: f64,
    /// Stiffness of the spring over the identified one.
    pub stiffness: f64,
    /// Change of the spring's curvature, in linear stiffnesses per mm.
    pub curvature_per_mm: f64,
    /// What creep pushes, as the displacement that the identified linear spring would give it, mm.
    pub offset_mm: f64,
}

impl Default for PlantChange {
    /// As identified.
    fn default() -> Self {
        Self { gain: 1.0, stiffness: 1.0, curvature_per_mm: 0.0, offset_mm: 0.0 }
    }
}

/// A [`FlatFeedforward`] along one reference.
///
/// The reference governor plays no part: what the drive cannot do is cut at its limits.
#[derive(Debug, Clone)]
pub struct FlatStepper {
    identified: GreyBoxModel,
    scheduled: FlatFeedforward,
    smooth: Vec<f64>,
    sample_idx: usize,
    state: GreyBoxState,
    before_unit: f64,
}

impl FlatStepper {
    /// A feedforward that starts from relaxed rest at the first value of `reference_mm`.
    ///
    /// # Errors
    /// [`Error::SampleCount`] for an empty reference; [`Error::OutOfRange`] where the model has as many branches as a model may have: one is
    /// needed for the offset.
    pub fn new(flat: &FlatFeedforward, reference_mm: &[f64]) -> Result<Self> {
        let smooth = flat.smoother().apply(reference_mm);
        let Some(first) = smooth.first() else {
            return Err(Error::SampleCount { signal: "reference", expected: 1, found: 0 });
        };
        let identified = flat.model().clone();
        let scheduled = flat.with_model(changed(&identified, PlantChange::default())?);
        let mut state = flat.relaxed_at(*first);
        state.branches_mm.push(0.0);
        let before_unit = state.circuit_unit;
        Ok(Self { identified, scheduled, smooth, sample_idx: 0, state, before_unit })
    }

    /// Inverts the identified model with this change from the next sample on.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] for a change that leaves no passive plate; then the schedule is as it was.
    pub fn schedule(&mut self, change: PlantChange) -> Result<()> {
        let model = changed(&self.identified, change)?;
        let offset = change.offset_mm * change.stiffness * linear_stiffness(&self.identified);
        self.scheduled = self.scheduled.with_model(model);
        if let Some(branch) = self.state.branches_mm.last_mut() {
            *branch = offset / OFFSET_STIFFNESS_PER_S2;
        }
        Ok(())
    }

    /// The command for the next sample; the last one again beyond the end of the reference.
    pub fn command(&mut self) -> f64 {
        let ts = self.scheduled.sample_time_s().seconds();
        let ahead = if self.scheduled.smoother().n_preview > 0 { AHEAD as isize - 3 } else { -3 };
        let last = self.smooth.len() as isize - 1;
        let at = |i: isize| self.smooth[(self.sample_idx as isize + ahead + i).clamp(0, last) as usize];
        let samples: [f64; 7] = std::array::from_fn(|i| at(i as isize - 3));
        let needed = self.scheduled.needed_voltage(&Wanted::of(&samples, ts), &self.state);
        let drive = self.scheduled.drive();
        let slew = drive.slew_unit_per_s.unwrap_or(f64::INFINITY) * ts;
        let voltage = needed
            .clamp(self.before_unit - slew, self.before_unit + slew)
            .clamp(drive.min_unit, drive.max_unit);
        self.scheduled.model().advance(&mut self.state, voltage, ts);
        self.before_unit = voltage;
        self.sample_idx += 1;
        voltage * voltage
    }
}

/// Minus the coefficient of the displacement, s^-2.
fn linear_stiffness(model: &GreyBoxModel) -> f64 {
    let linear = |term: &&PullTerm| (term.displacement_power, term.drive_power) == (1, 0);
    -model.terms().iter().filter(linear).map(|term| term.coefficient).sum::<f64>()
}

/// The changed model. A constant push is a branch that never relaxes, whose stiffness the spring makes up for.
fn changed(model: &GreyBoxModel, change: PlantChange) -> Result<GreyBoxModel> {
    let PlantChange { gain, stiffness, curvature_per_mm, .. } = change;
    let scaled = |term: &PullTerm| PullTerm {
        coefficient: term.coefficient * if term.drive_power > 0 { gain * stiffness } else { stiffness },
        ..*term
    };
    let mut terms: Vec<PullTerm> = model.terms().iter().map(scaled).collect();
    let term = |displacement_power, coefficient| PullTerm { displacement_power, drive_power: 0, coefficient };
    terms.push(term(1, OFFSET_STIFFNESS_PER_S2));
    terms.push(term(2, curvature_per_mm * stiffness * linear_stiffness(model)));
    let mut branches = model.branches().to_vec();
    branches.push(CreepBranch { stiffness_per_s2: OFFSET_STIFFNESS_PER_S2, relaxation_time_s: NEVER_S });
    GreyBoxModel::new(model.rc_s(), model.damping_per_s(), terms, branches, model.displacement_max_mm())
}

/// Stiffness of the branch that holds the constant push; any small number will do.
const OFFSET_STIFFNESS_PER_S2: f64 = 1.0;
/// Its relaxation time.
const NEVER_S: f64 = 1e15;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::implement::{FlatDrive, SmootherOptions};
    use telepulse_lti::SampleTime;

    fn model() -> GreyBoxModel {
        let term = |i, j, coefficient| PullTerm { displacement_power: i, drive_power: j, coefficient };
        let terms = vec![term(1, 0, -1425.0), term(0, 1, 1300.0), term(2, 0, -13.0), term(1, 1, 190.0)];
        let branch = CreepBranch { stiffness_per_s2: 22.0, relaxation_time_s: 0.6 };
        GreyBoxModel::new(0.0045, 15.9, terms, vec![branch], 1.0).expect("valid")
    }

    fn flat() -> FlatFeedforward {
        let drive = FlatDrive { min_unit: 0.0, max_unit: 1.0, slew_unit_per_s: None };
        let options = SmootherOptions { horizon_s: 0.04, ..SmootherOptions::default() };
        FlatFeedforward::new(&model(), SampleTime::new(5e-4).expect("positive"), &options, drive)
            .expect("designs")
    }

    fn reference() -> Vec<f64> {
        (0..8000).map(|k| 0.45 - 0.2 * (std::f64::consts::TAU * 0.7 * f64::from(k) * 5e-4).cos()).collect()
    }

    #[test]
    fn law_unchanged_it_commands_what_the_feedforward_for_a_whole_reference_does() {
        let (flat, reference) = (flat(), reference());
        let mut stepper = FlatStepper::new(&flat, &reference).expect("starts");
        let whole = flat.apply(&reference);
        // The branch that holds the offset rounds at 1e-16 of 1 s^-2 times a displacement.
        assert!(whole.iter().all(|u| (stepper.command() - u).abs() < 1e-9));
    }

    #[test]
    fn law_a_changed_plant_is_followed_once_its_change_is_scheduled() {
        let reference = reference();
        let change = PlantChange { gain: 1.2, stiffness: 0.8, curvature_per_mm: 0.1, offset_mm: 0.05 };
        // The changed plant, written out anew: its constant push as a force on the plate.
        let plant = |x: f64, v: f64, w: f64, xi: f64| {
            let spring = -1425.0 * x - 13.0 * x * x + 0.1 * 1425.0 * x * x + 0.05 * 1425.0;
            0.8 * (spring + 1.2 * (1300.0 * w + 190.0 * x * w)) - 15.9 * v - 22.0 * (x - xi)
        };
        let worst = |change: PlantChange| {
            let mut stepper = FlatStepper::new(&flat(), &reference).expect("starts");
            stepper.schedule(change).expect("passive");
            let (mut x, mut v, mut xi, mut circuit) = (reference[0], 0.0, reference[0], 0.5);
            let mut worst = 0.0_f64;
            for (k, r) in reference.iter().enumerate() {
                if (4000..7800).contains(&k) {
                    worst = worst.max((x - r).abs());
                }
                let u = stepper.command().sqrt();
                for _ in 0..20 {
                    let h = 5e-4 / 20.0;
                    circuit += h / 0.0045 * (u - circuit);
                    v += h * plant(x, v, circuit * circuit, xi);
                    x += h * v;
                    xi += h / 0.6 * (x - xi);
                }
            }
            worst
        };
        // Euler's steps of 25 us are off by about 1e-3 of the motion's 0.2 mm.
        assert!(worst(change) < 1e-3, "{}", worst(change));
        assert!(worst(PlantChange::default()) > 0.05);
        let mut stepper = FlatStepper::new(&flat(), &reference).expect("starts");
        assert!(stepper.schedule(PlantChange { stiffness: -1.0, ..change }).is_err());
        assert!(FlatStepper::new(&flat(), &[]).is_err());
    }
}
