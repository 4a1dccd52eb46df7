//! One step of time: three stages, each a static solve of the membrane with plate and circuit around it.

use super::branches::{Stage, StageLaw};
use super::circuit::{Circuit, Current};
use super::radau::STAGES;
use super::{EnergyFlow, FieldTwin};
use crate::Error;
use crate::statics::{Control, Effort, Electric, Held, State, Surroundings};

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
struct Rates([f64; 3]);

/// What a step starts from, and what its stages have found.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct StepStart {
    state: State,
    rates: [Rates; STAGES],
    known: [[f64; 3]; STAGES],
    voltages_v: [f64; STAGES],
    power: [EnergyFlow; STAGES],
    /// The last step, if the stages of it foretell the next.
    last: Option<(f64, Acting)>,
    node_power: Vec<f64>,
    scratch: [State; STAGES],
}

impl StepStart {
    pub(super) fn at(state: &State) -> Self {
        Self {
            state: state.clone(),
            rates: [Rates::default(); STAGES],
            known: [[0.0; 3]; STAGES],
            voltages_v: [0.0; STAGES],
            power: [EnergyFlow::default(); STAGES],
            last: None,
            node_power: vec![0.0; state.r.len()],
            scratch: std::array::from_fn(|_| state.clone()),
        }
    }

    /// Starts anew from `state`, about whose motion nothing is known.
    pub(super) fn forget(&mut self, state: &State) {
        self.state.copy_from(state);
        self.rates = [Rates::default(); STAGES];
        self.last = None;
    }
}

/// What acts during a step.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Acting {
    target_v: f64,
    disturbance_n: f64,
}

/// A stage's affine surroundings of the membrane.
struct Linear {
    control: Control,
    surroundings: Surroundings,
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

    /// Guesses all stages: by those of the step before while the inputs stay, else by its end.
    fn predict(&mut self, h: f64, acting: Acting) {
        let start = &mut self.start;
        start.state.copy_from(&self.membranes[STAGES - 1].state);
        let weights = match start.last {
            Some((last_s, before)) if before == acting => self.radau.extrapolation(h / last_s),
            _ => {
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
        for branch in &mut self.branches {
            branch.stop();
        }
        self.start.rates = [Rates::default(); STAGES];
        self.start.last = None;
        // The evaluation belongs to the failed state: solve anew where the twin stood. It did so before.
        let _stood = self.rebalance();
    }

    /// Sweeps over the stages until they stop changing.
    fn converge(&mut self, h: f64, acting: Acting) -> Result<(), Error> {
        let mut last = f64::INFINITY;
        for _ in 0..MAX_SWEEPS {
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
            let mut change = 0.0_f64;
            for i in 0..STAGES {
                change = change.max(self.stage(i, h, acting)?);
            }
            // What is left is about the last change times the contraction, of which the first sweep, which also corrects the
            // guess, tells too much.
            let left = change * (change / last).clamp(LEAST_CONTRACTION, 1.0);
            if left < self.setup.tolerance {
                return Ok(());
            }
            last = change;
        }
        Err(self.unsolved())
    }

    /// Solves stage `i`; returns the change of its rates, times the step, in units of B and of full scale.
    fn stage(&mut self, i: usize, h: f64, acting: Acting) -> Result<f64, Error> {
        for j in 0..i {
            for k in 0..3 {
                self.start.known[i][k] += h * self.radau.lower[i][j] * self.start.rates[j].0[k];
            }
        }
        for branch in &mut self.branches {
            branch.begin_stage(&self.radau, h, i);
        }
        let stage = Stage { index: i, diagonal_s: h * self.radau.lower[i][i] };
        let g = stage.diagonal_s;
        let amplifier = self.setup.amplifier;
        let u = amplifier.output_v(self.motion.amplifier_v, acting.target_v, h * self.radau.nodes[i]);
        let mut x_m = self.start.known[i][0] + g * self.start.rates[i].0[0];
        let mut current = Current::Free;
        for _ in 0..MAX_LINEARISATIONS {
            let (contact, slope) = self.contact(i, g, x_m);
            let linear = self.surround(i, g, u, current, acting, [x_m, contact, slope]);
            self.solve_membrane(stage, &linear)?;
            let length = self.sheet.length_scale_m();
            let solved_m = self.membranes[i].at.displacement * length;
            let (voltage, free_a) = self.charge(i, g, u, current);
            let next = Current::of(free_a, amplifier.current_limit_a);
            let missed = self.contact(i, g, solved_m).0 - (contact + slope * (solved_m - x_m));
            let settled = missed.abs() * g * g / self.parameters.spec().mass_kg
                < MEMBRANE_SHARE * self.setup.tolerance * length;
            x_m = solved_m;
            if settled && next == current {
                self.start.voltages_v[i] = voltage;
                return Ok(self.end_stage(stage, u, current, acting));
            }
            current = next;
        }
        Err(self.unsolved())
    }

    /// Contact force at `x_m` in stage `i`, and its slope by x, the velocity following from x.
    fn contact(&self, i: usize, g: f64, x_m: f64) -> (f64, f64) {
        let v = (x_m - self.start.known[i][0]) / g;
        let contact = self.setup.contact_force(x_m - self.rest_sag_m, v);
        (contact.force_n, contact.by_x + contact.by_v / g)
    }

    /// Plate and circuit as the membrane of stage `i` sees them; the contact is `[x, force, slope]`.
    fn surround(
        &self,
        i: usize,
        g: f64,
        u: f64,
        current: Current,
        acting: Acting,
        [x_m, contact_n, slope]: [f64; 3],
    ) -> Linear {
        let (spec, sheet) = (self.parameters.spec(), &self.sheet);
        let [known_x, known_v, known_electric] = self.start.known[i];
        // v = v* + g (W + d + N - F - c v)/m, x = x* + g v, so x + k F = x* + k (m v*/g + W + d + N), k = g^2/(m + g c).
        let k = g * g / (spec.mass_kg + g * spec.damping_n_s_per_m);
        let push = self.parameters.weight_n() + acting.disturbance_n + contact_n - slope * x_m;
        let stiffened = 1.0 / (1.0 - k * slope);
        let free_m = stiffened * (known_x + k * (spec.mass_kg * known_v / g + push));
        let (length, force) = (sheet.length_scale_m(), sheet.force_scale_n());
        let mut surroundings = Surroundings { compliance: stiffened * k * force / length, parallel: 0.0 };
        let limited = current.limited_a(self.setup.amplifier.current_limit_a);
        let electric = match self.setup.circuit {
            Circuit::ConstantRc => {
                Electric::Field(sheet.field_scale_per_v2() * self.constant_rc_v(i, g, u).0.powi(2))
            }
            Circuit::Deformable { series_resistance_ohm: series, leak_resistance_ohm: leak } => {
                // (C + g/R_s + g/R_leak) Phi = Q* + g u/R_s, or without R_s at the limit.
                let scale = sheet.capacitance_scale_f();
                let series = limited.map_or(1.0 / series, |_| 0.0);
                let charge = known_electric + g * limited.unwrap_or(u * series);
                surroundings.parallel = g * (series + 1.0 / leak) / scale;
                Electric::ChargeSquared(sheet.field_scale_per_v2() * (charge / scale).powi(2))
            }
        };
        Linear { control: Control { load: Held::Displacement(free_m / length), electric }, surroundings }
    }

    /// Voltage of a circuit of constant time constant in stage `i`, and its rate, with the amplifier's current limit.
    fn constant_rc_v(&self, i: usize, g: f64, u: f64) -> (f64, f64) {
        let (rc, known) = (self.parameters.spec().rc_s, self.start.known[i][2]);
        let limit = self.setup.amplifier.current_limit_a / self.capacitance_f();
        let rate = ((u - known) / (rc + g)).clamp(-limit, limit);
        (known + g * rate, rate)
    }

    fn solve_membrane(&mut self, stage: Stage, linear: &Linear) -> Result<(), Error> {
        let law = StageLaw {
            network: self.sheet.law(),
            modulus_factor: self.modulus_factor,
            branches: &self.branches,
            stage,
        };
        let membrane = &mut self.membranes[stage.index];
        membrane.linear.surroundings = linear.surroundings;
        membrane.tolerance = MEMBRANE_SHARE * self.setup.tolerance;
        let mut solved = membrane.solve(&law, linear.control);
        if solved.is_err() {
            // A bad guess: once more from the start of the step.
            membrane.state.copy_from(&self.start.state);
            membrane.linear.discard();
            solved = membrane.solve(&law, linear.control);
        }
        let (Ok(effort) | Err(effort)) = solved;
        self.effort.iterations += effort.iterations;
        self.effort.factorizations += effort.factorizations;
        let sound = membrane.at.least_s11 > 0.0;
        match solved {
            Ok(effort) if sound => self.last_solve = effort,
            Ok(effort) | Err(effort) => {
                self.last_solve = effort;
                return Err(self.unsolved());
            }
        }
        Ok(())
    }

    /// Why the present stage has no solution.
    fn unsolved(&self) -> Error {
        let Effort { residual, iterations, .. } = self.last_solve;
        let voltage_v = self.motion.voltage_v;
        let stiffness = self.membranes.iter().map(|m| m.at.least_modulus).fold(f64::INFINITY, f64::min);
        if stiffness <= 0.0 {
            return Error::PullIn {
                voltage_v,
                displacement_m: self.motion.x_m,
                modulus_min_pa: stiffness * self.sheet.shear_modulus_pa(),
            };
        }
        Error::NotConverged { voltage_v, residual, iterations }
    }

    /// Voltage across the membrane in stage `i` as solved, and the current that the resistor alone would carry.
    fn charge(&self, i: usize, g: f64, u: f64, current: Current) -> (f64, f64) {
        let known = self.start.known[i][2];
        match self.setup.circuit {
            Circuit::ConstantRc => (self.constant_rc_v(i, g, u).0, 0.0),
            Circuit::Deformable { series_resistance_ohm: series, leak_resistance_ohm: leak } => {
                let capacitance_f = self.membranes[i].at.capacitance * self.sheet.capacitance_scale_f();
                let voltage = match current.limited_a(self.setup.amplifier.current_limit_a) {
                    None => (known + g * u / series) / (capacitance_f + g / series + g / leak),
                    Some(limited) => (known + g * limited) / (capacitance_f + g / leak),
                };
                (voltage, (u - voltage) / series)
            }
        }
    }

    /// Takes rates and powers from a solved stage.
    fn end_stage(&mut self, stage: Stage, u: f64, current: Current, acting: Acting) -> f64 {
        let (i, g) = (stage.index, stage.diagonal_s);
        let spec = self.parameters.spec();
        let weight = self.parameters.weight_n();
        let at = &self.membranes[i].at;
        let membrane_n = self.membranes[i].state.force * self.sheet.force_scale_n();
        let x = at.displacement * self.sheet.length_scale_m();
        let v = (x - self.start.known[i][0]) / g;
        let contact = self.setup.contact_force(x - self.rest_sag_m, v).force_n;
        let damper = spec.damping_n_s_per_m * v;
        let acceleration = (weight + acting.disturbance_n + contact - membrane_n - damper) / spec.mass_kg;
        let voltage = self.start.voltages_v[i];
        let mut power = EnergyFlow {
            gravity_j: weight * v,
            disturbance_j: acting.disturbance_n * v,
            contact_j: contact * v,
            damper_j: damper * v,
            ..EnergyFlow::default()
        };
        let (electric, electric_scale) = match self.setup.circuit {
            Circuit::ConstantRc => (self.constant_rc_v(i, g, u).1, spec.full_scale_v),
            Circuit::Deformable { series_resistance_ohm: series, leak_resistance_ohm: leak } => {
                let free = (u - voltage) / series;
                let source = current.limited_a(self.setup.amplifier.current_limit_a).unwrap_or(free);
                power.source_j = u * source;
                power.series_j = (u - voltage) * source;
                power.leak_j = voltage * voltage / leak;
                let scale = spec.full_scale_v * at.capacitance * self.sheet.capacitance_scale_f();
                (source - voltage / leak, scale)
            }
        };
        self.start.node_power.fill(0.0);
        let mut change = 0.0_f64;
        for branch in &mut self.branches {
            change = change.max(branch.end_stage(stage, &at.l1, &at.l2, &mut self.start.node_power));
        }
        let operator = &self.membranes[i].operator;
        let nodes = operator.weights.iter().zip(&operator.rho).zip(&self.start.node_power);
        power.branches_j =
            self.energy_scale_j() * nodes.map(|((weight, rho), power)| weight * rho * power).sum::<f64>();
        self.start.power[i] = power;
        let new = [v, acceleration, electric];
        let old = std::mem::replace(&mut self.start.rates[i], Rates(new)).0;
        let length = self.sheet.length_scale_m();
        let scales = [length, length / g, electric_scale];
        for k in 0..3 {
            change = change.max((new[k] - old[k]).abs() / scales[k]);
        }
        change * g
    }

    /// Ends the step.
    fn commit(&mut self, h: f64, acting: Acting) {
        let start = &mut self.start;
        let mut end = [self.motion.x_m, self.motion.v_m_per_s, self.motion.electric];
        for ((rates, weight), power) in start.rates.iter().zip(&self.radau.weights).zip(&start.power) {
            for (value, rate) in end.iter_mut().zip(rates.0) {
                *value += h * weight * rate;
            }
            self.flow.add(power, h * weight);
        }
        start.last = Some((h, acting));
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
/// Sweeps over the stages; 3 to 8 are usual.
const MAX_SWEEPS: usize = 60;
/// Contraction of the sweeps that is counted on.
const LEAST_CONTRACTION: f64 = 0.1;
/// Part of the tolerance that a stage's membrane may use up, and its linearised contact.
const MEMBRANE_SHARE: f64 = 0.1;
/// Linearisations of contact and current limit in one stage.
const MAX_LINEARISATIONS: usize = 50;
