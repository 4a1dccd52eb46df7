//! One step of time: sweeps over its three stages until they stop changing.

use super::FieldTwin;
use super::circuit::Circuit;
use super::radau::STAGES;
use super::springs::{BranchStress, Pairs, pairs};
use crate::Error;
use crate::statics::{State, Surroundings};

/// Plate and circuit at one instant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Motion {
    /// Displacement below the frame, m.
    pub(super) x_m: f64,
    pub(super) v_m_per_s: f64,
    /// Voltage (V) of a circuit of constant time constant, charge (C) of the membrane else.
    pub(super) electric: f64,
    pub(super) amplifier_v: f64,
    pub(super) voltage_v: f64,
}

/// Rates of x, v and the circuit's state in one stage.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Rates(pub(super) [f64; 3]);

/// What a step starts from, and what its stages have found.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct StepStart {
    pub(super) state: State,
    pub(super) rates: [Rates; STAGES],
    pub(super) known: [[f64; 3]; STAGES],
    pub(super) voltages_v: [f64; STAGES],
    /// Current from the amplifier, A; not of a circuit of constant time constant.
    pub(super) sources_a: [f64; STAGES],
    /// Logarithms of the stretches.
    pub(super) logs: [Pairs; STAGES],
    /// Surroundings whose factors are at hand.
    pub(super) factored: [Surroundings; STAGES],
    pub(super) branch_stress: BranchStress,
    pub(super) node_power: Vec<f64>,
    /// Length of the last step, if its stages foretell the next.
    last_s: Option<f64>,
    scratch: [State; STAGES],
}

impl StepStart {
    pub(super) fn at(state: &State) -> Self {
        Self {
            state: state.clone(),
            rates: [Rates::default(); STAGES],
            known: [[0.0; 3]; STAGES],
            voltages_v: [0.0; STAGES],
            sources_a: [0.0; STAGES],
            logs: std::array::from_fn(|_| pairs(state.r.len())),
            factored: [Surroundings::default(); STAGES],
            branch_stress: BranchStress::new(state.r.len()),
            node_power: vec![0.0; state.r.len()],
            last_s: None,
            scratch: std::array::from_fn(|_| state.clone()),
        }
    }

    /// Starts anew from `state`, about whose motion nothing is known.
    pub(super) fn forget(&mut self, state: &State) {
        self.state.copy_from(state);
        self.rates = [Rates::default(); STAGES];
        self.last_s = None;
    }
}

/// What acts during a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Acting {
    pub(super) target_v: f64,
    pub(super) disturbance_n: f64,
}

impl FieldTwin {
    /// One step of `step_s` with the command at the amplifier's input held.
    ///
    /// # Errors
    /// Those of [`FieldTwin::step_with`].
    pub fn step(&mut self, step_s: f64, drive_v: f64) -> Result<(), Error> {
        self.step_with(step_s, drive_v, 0.0)
    }

    /// One step of `step_s` with command and disturbance force (N, positive down) held.
    ///
    /// # Errors
    /// [`Error::Request`] for a step that is not positive, or numbers that are not finite: nothing has moved then.
    /// [`Error::PullIn`] or [`Error::NotConverged`] where the membrane finds no equilibrium even in a step 1024 times shorter; the
    /// twin then stands where it last found one.
    pub fn step_with(&mut self, step_s: f64, drive_v: f64, disturbance_n: f64) -> Result<(), Error> {
        for (quantity, allowed, found, usable) in [
            ("step_s", "finite and positive", step_s, step_s.is_finite() && step_s > 0.0),
            ("drive_v", "finite", drive_v, drive_v.is_finite()),
            ("disturbance_n", "finite", disturbance_n, disturbance_n.is_finite()),
        ] {
            if !usable {
                return Err(Error::Request { quantity, allowed, found });
            }
        }
        let acting = Acting { target_v: self.setup.amplifier.target_v(drive_v), disturbance_n };
        self.advance(step_s, acting, 0)
    }

    fn advance(&mut self, h: f64, acting: Acting, halvings: usize) -> Result<(), Error> {
        self.predict(h, acting);
        match self.converge(h, acting) {
            Ok(()) => {
                self.commit(h, acting);
                Ok(())
            }
            Err(error) => {
                self.restart();
                self.effort.halved += 1;
                if halvings == MAX_HALVINGS {
                    return Err(error);
                }
                self.advance(0.5 * h, acting, halvings + 1)?;
                self.advance(0.5 * h, acting, halvings + 1)
            }
        }
    }

    /// Guesses all stages by those of the step before.
    fn predict(&mut self, h: f64, acting: Acting) {
        let start = &mut self.start;
        start.state.copy_from(&self.membranes[STAGES - 1].state);
        let weights = match start.last_s {
            Some(last_s) => self.radau.extrapolation(h / last_s),
            None => {
                for membrane in &mut self.membranes {
                    membrane.state.copy_from(&start.state);
                }
                [[0.0, 0.0, 1.0]; STAGES]
            }
        };
        if weights[0][0] != 0.0 {
            for (guess, weights) in start.scratch.iter_mut().zip(&weights) {
                combine(guess, weights, self.membranes.each_ref().map(|membrane| &membrane.state));
                // No solve corrects the clamped edges, so their rounding would grow from step to step.
                let last = guess.r.len() - 1;
                (guess.r[0], guess.r[last]) = (start.state.r[0], start.state.r[last]);
            }
            for (membrane, guess) in self.membranes.iter_mut().zip(&mut start.scratch) {
                std::mem::swap(&mut membrane.state, guess);
            }
        }
        let old = start.rates;
        for (rates, weights) in start.rates.iter_mut().zip(&weights) {
            for (k, rate) in rates.0.iter_mut().enumerate() {
                *rate = weights.iter().zip(&old).map(|(w, f)| w * f.0[k]).sum();
            }
        }
        for branch in &mut self.branches {
            branch.predict(&weights);
        }
        self.predict_circuit(h, acting);
        for i in 0..STAGES {
            self.stretch(i);
        }
    }

    /// Guesses the circuit's rates with the capacitance as it stands: three linear equations, exact where it is constant.
    fn predict_circuit(&mut self, h: f64, acting: Acting) {
        let capacitance_f = self.capacitance_f();
        // y' = source - decay y in every stage.
        let (decay, source_per_v) = match self.setup.circuit {
            Circuit::ConstantRc => (1.0 / self.parameters.spec().rc_s, 1.0 / self.parameters.spec().rc_s),
            Circuit::Deformable { series_resistance_ohm: series, leak_resistance_ohm: leak } => {
                ((1.0 / series + 1.0 / leak) / capacitance_f, 1.0 / series)
            }
        };
        let sources: [f64; STAGES] = self.radau.nodes.map(|c| {
            source_per_v * self.setup.amplifier.output_v(self.motion.amplifier_v, acting.target_v, c * h)
        });
        for _ in 0..CIRCUIT_SWEEPS {
            let old = self.start.rates.map(|rates| rates.0[2]);
            for (i, source) in sources.iter().enumerate() {
                let known: f64 = (0..STAGES).map(|j| self.radau.rest[i][j] * old[j]).sum::<f64>()
                    + (0..i).map(|j| self.radau.lower[i][j] * self.start.rates[j].0[2]).sum::<f64>();
                self.start.rates[i].0[2] = (source - decay * (self.motion.electric + h * known))
                    / (1.0 + h * self.radau.lower[i][i] * decay);
            }
        }
    }

    /// Back to the start of the step, with no guess about its motion.
    fn restart(&mut self) {
        for membrane in &mut self.membranes {
            membrane.state.copy_from(&self.start.state);
            membrane.linear.discard();
        }
        // The evaluation belongs to the failed state: solve anew where the twin stood. It did so before.
        let _stood = self.rebalance();
        self.stand();
    }

    /// Nothing is known about the motion that goes on from here.
    pub(super) fn stand(&mut self) {
        let present = &self.membranes[STAGES - 1];
        self.start.forget(&present.state);
        for branch in &mut self.branches {
            branch.stop(&present.at.l1, &present.at.l2);
        }
    }

    /// Sweeps over the stages until they stop changing.
    ///
    /// The membrane takes one step of Newton's method in each stage and sweep, with factors of earlier steps while they contract.
    fn converge(&mut self, h: f64, acting: Acting) -> Result<(), Error> {
        let mut last = f64::INFINITY;
        let mut fresh = false;
        for _ in 0..MAX_SWEEPS {
            self.begin_sweep(h);
            let mut change = 0.0_f64;
            for i in 0..STAGES {
                change = change.max(self.stage(i, h, acting)?);
            }
            let contraction = change / last;
            // What is left is about the last change times the contraction, of which the first sweep, which also corrects the
            // guess, tells too much.
            if change * contraction.clamp(LEAST_CONTRACTION, 1.0) < self.setup.tolerance {
                return self.finish(h);
            }
            if contraction > WORN {
                if fresh && contraction > DIVERGED {
                    break;
                }
                if !fresh || contraction > 1.0 {
                    self.discard_factors();
                    fresh = true;
                }
            }
            last = change;
        }
        Err(self.unsolved())
    }

    /// What plate, circuit and dashpots know of the stages by the rates of the sweep before.
    fn begin_sweep(&mut self, h: f64) {
        let motion = self.motion;
        for (i, known) in self.start.known.iter_mut().enumerate() {
            let rest = &self.radau.rest[i];
            let initial = [motion.x_m, motion.v_m_per_s, motion.electric];
            for (k, value) in known.iter_mut().enumerate() {
                let sum: f64 = rest.iter().zip(&self.start.rates).map(|(a, f)| a * f.0[k]).sum();
                *value = initial[k] + h * sum;
            }
        }
        for branch in &mut self.branches {
            branch.begin_sweep(&self.radau, h);
        }
        self.effort.sweeps += 1;
    }

    fn discard_factors(&mut self) {
        for membrane in &mut self.membranes {
            membrane.linear.discard();
        }
    }

    /// Ends the step.
    fn commit(&mut self, h: f64, acting: Acting) {
        for (i, weight) in self.radau.weights.into_iter().enumerate() {
            let power = self.power(i, h, acting);
            self.flow.add(&power, h * weight);
        }
        let start = &mut self.start;
        let mut end = [self.motion.x_m, self.motion.v_m_per_s, self.motion.electric];
        for (rates, weight) in start.rates.iter().zip(&self.radau.weights) {
            for (value, rate) in end.iter_mut().zip(rates.0) {
                *value += h * weight * rate;
            }
        }
        start.last_s = Some(h);
        for branch in &mut self.branches {
            branch.commit(&self.radau, h);
        }
        let amplifier_v = self.setup.amplifier.output_v(self.motion.amplifier_v, acting.target_v, h);
        let [x_m, v_m_per_s, electric] = end;
        self.motion =
            Motion { x_m, v_m_per_s, electric, amplifier_v, voltage_v: start.voltages_v[STAGES - 1] };
        self.time_s += h;
        self.effort.steps += 1;
    }
}

/// `out = sum of weights times states`.
fn combine(out: &mut State, weights: &[f64; STAGES], states: [&State; STAGES]) {
    let sum = |values: [f64; STAGES]| -> f64 { weights.iter().zip(values).map(|(w, v)| w * v).sum() };
    for j in 0..out.r.len() {
        out.r[j] = sum(states.map(|state| state.r[j]));
        out.q[j] = sum(states.map(|state| state.q[j]));
    }
    out.force = sum(states.map(|state| state.force));
    out.field = sum(states.map(|state| state.field));
}

/// Sweeps that guess the circuit's rates; each gains a digit or more.
const CIRCUIT_SWEEPS: usize = 10;
/// Halvings of a step that fails.
const MAX_HALVINGS: usize = 10;
/// Sweeps over the stages; 3 to 6 are usual.
const MAX_SWEEPS: usize = 40;
/// Contraction of the sweeps that is counted on.
const LEAST_CONTRACTION: f64 = 0.1;
/// Contraction from which new factors pay.
const WORN: f64 = 0.3;
/// Growth of the change, with factors of the step itself, at which sweeping ends.
const DIVERGED: f64 = 10.0;
