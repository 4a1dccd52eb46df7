//! Margins over a run: a record of displacement and voltage.

use serde::Serialize;

use super::branch_history::BranchHistory;
use super::criteria::{Margin, Mechanism};
use super::envelope::Envelope;
use crate::Error;
use crate::statics::{Load, StaticPoint};

/// One sample of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RunSample {
    /// Time, s; increasing.
    pub time_s: f64,
    /// Displacement below the frame, m.
    pub displacement_m: f64,
    /// Voltage across the membrane, V.
    pub voltage_v: f64,
    /// Voltage at the amplifier, V.
    pub drive_v: f64,
}

/// The smallest margin to one mechanism over a run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RunMargin {
    /// When, s.
    pub time_s: f64,
    /// The margin there.
    pub margin: Margin,
}

/// Margins over a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunMargins {
    /// How many samples were judged.
    pub n_samples: usize,
    /// The smallest margin to each mechanism.
    pub worst: Vec<RunMargin>,
    /// When the first of them was used up, s, if any was, or when the membrane had no state any more.
    pub first_failure_s: Option<f64>,
    /// Where judging ended before the run did.
    pub ended: Option<RunEnd>,
}

/// A sample at which the membrane has no state: it has pulled in, or run out of chains.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunEnd {
    /// When, s.
    pub time_s: f64,
    /// Why.
    pub reason: String,
}

impl RunMargins {
    /// The smallest margin to `mechanism`.
    #[must_use]
    pub fn of(&self, mechanism: Mechanism) -> Option<&RunMargin> {
        self.worst.iter().find(|worst| worst.margin.mechanism == mechanism)
    }

    fn take(&mut self, time_s: f64, margin: Margin) {
        if margin.left <= 0.0 {
            self.first_failure_s.get_or_insert(time_s);
        }
        match self.worst.iter_mut().find(|worst| worst.margin.mechanism == margin.mechanism) {
            Some(worst) if worst.margin.left <= margin.left => {}
            Some(worst) => *worst = RunMargin { time_s, margin },
            None => self.worst.push(RunMargin { time_s, margin }),
        }
    }
}

impl Envelope {
    /// Margins over a run under the dead load `weight_n`.
    ///
    /// **Method**: at every sample the membrane is solved at the displacement and voltage of that instant, so a plate that
    /// overshoots is judged where it is and not where it will rest. Tension and modulus are compared with those at rest without
    /// voltage. The amplifier's current is the change of charge C V between samples plus the leak; its slew is the change of
    /// its voltage.
    ///
    /// What Maxwell branches ([`Envelope::with_branches`]) carry is added to the stresses: their dashpots follow the stretches of
    /// the relaxed membrane, from rest at the first sample on.
    ///
    /// **Accuracy**: the branches' own change of the membrane's shape at a given displacement is left out, which for set A
    /// is a third of what they carry, 0.3 % of the smallest stress; and so is their stiffness,
    /// which only adds to the modulus. Current and slew are means over a sampling interval: a jump inside one shows as the jump
    /// over the interval. A sample at which the membrane has no state ends the judgement and counts as failure.
    ///
    /// # Errors
    /// [`Error::Request`] names a sample that is out of range or order; those of [`crate::statics::StaticSolver::solve`] for the load
    /// without voltage.
    pub fn over_run(&mut self, weight_n: f64, samples: &[RunSample]) -> Result<RunMargins, Error> {
        let load = Load::ForceN(weight_n);
        self.resolve(load)?;
        let limit_v = match self.solver.limit_voltage(weight_n) {
            Ok(point) => Some(point.voltage_v),
            Err(Error::NoLimitPoint { .. }) => None,
            Err(error) => return Err(error),
        };
        let flat = self.near(load, 0.0)?;
        let mut found =
            RunMargins { n_samples: samples.len(), worst: Vec::new(), first_failure_s: None, ended: None };
        let profile = self.solver.profile()?;
        let mut history = BranchHistory::relaxed(&self.branches, &profile.lambda1, &profile.lambda2);
        let mut before: Option<(RunSample, StaticPoint)> = None;
        for &sample in samples {
            require_usable(&sample, before.map(|(sample, _)| sample))?;
            let point = match self.near(Load::DisplacementM(sample.displacement_m), sample.voltage_v) {
                Ok(point) => point,
                Err(error) => {
                    found.first_failure_s.get_or_insert(sample.time_s);
                    found.ended = Some(RunEnd { time_s: sample.time_s, reason: error.to_string() });
                    break;
                }
            };
            let dt = before.map_or(0.0, |(earlier, _)| sample.time_s - earlier.time_s);
            let carried = self.with_branch_stresses(&mut history, dt, &point)?;
            for margin in self.material_margins(&carried, &flat)? {
                found.take(sample.time_s, margin);
            }
            let criteria = &self.criteria;
            if let Some(limit) = limit_v {
                let margin = Margin::below(criteria, Mechanism::LimitPoint, "V", sample.voltage_v, limit);
                found.take(sample.time_s, margin);
            }
            if let Some(max_v) = criteria.amplifier.max_v {
                let margin = Margin::below(criteria, Mechanism::AmplifierVoltage, "V", sample.drive_v, max_v);
                found.take(sample.time_s, margin);
            }
            if let Some((earlier, state)) = before {
                let dt = sample.time_s - earlier.time_s;
                let leak = criteria.amplifier.leak_resistance_ohm.map_or(0.0, |ohm| sample.drive_v / ohm);
                let current = ((point.charge_c - state.charge_c) / dt + leak).abs();
                if let Some(limit) = criteria.amplifier.current_a {
                    let margin = Margin::below(criteria, Mechanism::AmplifierCurrent, "A", current, limit);
                    found.take(sample.time_s, margin);
                }
                if let Some(limit) = criteria.amplifier.slew_v_per_s {
                    let slew = ((sample.drive_v - earlier.drive_v) / dt).abs();
                    let margin = Margin::below(criteria, Mechanism::AmplifierSlew, "V/s", slew, limit);
                    found.take(sample.time_s, margin);
                }
            }
            before = Some((sample, point));
        }
        Ok(found)
    }
}

impl Envelope {
    /// The solver's last state, `point`, with the smallest stresses of network and branches together.
    fn with_branch_stresses(
        &self,
        history: &mut BranchHistory,
        dt: f64,
        point: &StaticPoint,
    ) -> Result<StaticPoint, Error> {
        let mut carried = *point;
        if self.branches.is_empty() {
            return Ok(carried);
        }
        let profile = self.solver.profile()?;
        history.advance(dt, &profile.lambda1, &profile.lambda2);
        let (mut relaxed, mut together) = ([f64::INFINITY; 2], [f64::INFINITY; 2]);
        for (node, (s1, s2)) in profile.s1_pa.iter().zip(&profile.s2_pa).enumerate() {
            let branches = history.stress_pa(node);
            for (k, network) in [*s1, *s2].into_iter().enumerate() {
                relaxed[k] = relaxed[k].min(network);
                together[k] = together[k].min(network + branches[k]);
            }
        }
        // Between the nodes the network's stress is lower by so much, and the branches' changes little.
        carried.s1_min_pa += together[0] - relaxed[0];
        carried.s2_min_pa += together[1] - relaxed[1];
        Ok(carried)
    }
}

fn require_usable(sample: &RunSample, before: Option<RunSample>) -> Result<(), Error> {
    let in_order = before.is_none_or(|before| sample.time_s > before.time_s);
    let checks = [
        (
            "time_s",
            sample.time_s,
            sample.time_s.is_finite() && in_order,
            "finite and later than the sample before",
        ),
        ("displacement_m", sample.displacement_m, sample.displacement_m.is_finite(), "finite"),
        (
            "voltage_v",
            sample.voltage_v,
            sample.voltage_v.is_finite() && sample.voltage_v >= 0.0,
            "finite and not negative",
        ),
        ("drive_v", sample.drive_v, sample.drive_v.is_finite(), "finite"),
    ];
    for (quantity, found, holds, allowed) in checks {
        if !holds {
            return Err(Error::Request { quantity, allowed, found });
        }
    }
    Ok(())
}
