//! One stage: the membrane with plate, contact and circuit around it and dashpots in it.

use super::FieldTwin;
use super::branches::{Stage, StageLaw};
use super::circuit::{Circuit, Current};
use super::energy::EnergyFlow;
use super::radau::STAGES;
use super::step::{Acting, Rates};
use crate::Error;
use crate::statics::{Control, Effort, Electric, Held, Surroundings};

/// A stage's affine surroundings of the membrane.
struct Linear {
    control: Control,
    surroundings: Surroundings,
}

impl FieldTwin {
    /// One sweep's step of Newton's method in stage `i`; returns the change of the stage, in units of B, of full scale and of
    /// strain.
    pub(super) fn stage(&mut self, i: usize, h: f64, acting: Acting) -> Result<f64, Error> {
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
        let x_m = self.membranes[i].at.displacement * self.sheet.length_scale_m();
        let current = Current::of(self.charge(i, g, u, Current::Free).1, amplifier.current_limit_a);
        let (contact, slope) = self.contact(i, g, x_m);
        let linear = self.surround(i, g, u, current, acting, [x_m, contact, slope]);
        let mut imposed = 0.0;
        if let Electric::Field(field) = linear.control.electric {
            let old = std::mem::replace(&mut self.membranes[i].state.field, field);
            imposed = (field - old).abs();
        }
        if !self.evaluate(stage) {
            return Err(self.unsolved());
        }
        let moved = self.step_membrane(i, &linear)?;
        Ok(imposed.max(moved).max(self.end_stage(stage, u, current, acting)))
    }

    /// Stretches of stage `i` as its state stands.
    pub(super) fn stretch(&mut self, i: usize) {
        let membrane = &mut self.membranes[i];
        membrane.at.stretch(&membrane.operator, &membrane.state);
        for (logs, stretches) in self.start.logs[i].iter_mut().zip([&membrane.at.l1, &membrane.at.l2]) {
            for (log, stretch) in logs.iter_mut().zip(stretches) {
                *log = stretch.ln();
            }
        }
    }

    /// Residual and tangent of a stage as its state stands; false where the law has no value.
    fn evaluate(&mut self, stage: Stage) -> bool {
        let start = &mut self.start;
        start.branch_stress.clear();
        for branch in &mut self.branches {
            branch.respond(stage, &start.logs[stage.index], &mut start.branch_stress);
        }
        let law = StageLaw {
            network: self.sheet.law(),
            modulus_factor: self.modulus_factor,
            branches: &start.branch_stress,
        };
        let membrane = &mut self.membranes[stage.index];
        membrane.at.balance(&membrane.operator, &law, &membrane.state)
    }

    /// One Newton step of the membrane in stage `i`; returns its size.
    fn step_membrane(&mut self, i: usize, linear: &Linear) -> Result<f64, Error> {
        let membrane = &mut self.membranes[i];
        let serves = membrane.linear.serves(linear.control)
            && near(self.start.factored[i].compliance, linear.surroundings.compliance)
            && near(self.start.factored[i].parallel, linear.surroundings.parallel);
        membrane.linear.surroundings = linear.surroundings;
        self.effort.iterations += 1;
        self.last_solve.iterations = self.effort.iterations;
        if !serves {
            self.effort.factorizations += 1;
            self.start.factored[i] = linear.surroundings;
            let field = membrane.state.field;
            if !membrane.linear.factor(&membrane.operator, &membrane.at, field, linear.control) {
                return Err(self.unsolved());
            }
        }
        membrane.linear.step(
            &membrane.operator,
            &membrane.at,
            &membrane.state,
            linear.control,
            &mut membrane.step,
        );
        let size = membrane.step.size();
        membrane.step.apply(&mut membrane.state, 1.0);
        self.stretch(i);
        // A huge step may overflow the capacitance.
        let sound = size.is_finite() && self.membranes[i].at.capacitance.is_finite();
        if sound { Ok(size) } else { Err(self.unsolved()) }
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

    /// Why the present stage has no solution.
    pub(super) fn unsolved(&self) -> Error {
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

    /// Takes the rates of a stage as its state stands; returns by how much the stage has changed.
    fn end_stage(&mut self, stage: Stage, u: f64, current: Current, acting: Acting) -> f64 {
        let (i, g) = (stage.index, stage.diagonal_s);
        let spec = self.parameters.spec();
        let at = &self.membranes[i].at;
        let membrane_n = self.membranes[i].state.force * self.sheet.force_scale_n();
        let length = self.sheet.length_scale_m();
        let x = at.displacement * length;
        let v = (x - self.start.known[i][0]) / g;
        let contact = self.setup.contact_force(x - self.rest_sag_m, v).force_n;
        let push = self.parameters.weight_n() + acting.disturbance_n + contact;
        let acceleration = (push - membrane_n - spec.damping_n_s_per_m * v) / spec.mass_kg;
        let voltage = self.charge(i, g, u, current).0;
        self.start.voltages_v[i] = voltage;
        let (electric, electric_scale) = match self.setup.circuit {
            Circuit::ConstantRc => (self.constant_rc_v(i, g, u).1, spec.full_scale_v),
            Circuit::Deformable { series_resistance_ohm: series, leak_resistance_ohm: leak } => {
                let free = (u - voltage) / series;
                let source = current.limited_a(self.setup.amplifier.current_limit_a).unwrap_or(free);
                self.start.sources_a[i] = source;
                let scale = spec.full_scale_v * at.capacitance * self.sheet.capacitance_scale_f();
                (source - voltage / leak, scale)
            }
        };
        let mut change = 0.0_f64;
        for branch in &mut self.branches {
            change = change.max(branch.end_stage(stage, &self.start.logs[i]));
        }
        let new = [v, acceleration, electric];
        let old = std::mem::replace(&mut self.start.rates[i], Rates(new)).0;
        let scales = [length, length / g, electric_scale];
        for k in 0..3 {
            change = change.max((new[k] - old[k]).abs() / scales[k]);
        }
        change * g
    }

    /// Ends the sweeps of a step: checks what was found, and evaluates the membrane at its end.
    pub(super) fn finish(&mut self, h: f64) -> Result<(), Error> {
        let sound = self.membranes.iter().all(|membrane| membrane.at.least_s11 > 0.0);
        let index = STAGES - 1;
        let stage = Stage { index, diagonal_s: h * self.radau.lower[index][index] };
        if sound && self.evaluate(stage) && self.membranes[index].at.least_s11 > 0.0 {
            return Ok(());
        }
        Err(self.unsolved())
    }

    /// Powers in stage `i` as it was found.
    pub(super) fn power(&mut self, i: usize, h: f64, acting: Acting) -> EnergyFlow {
        let Rates([v, _, _]) = self.start.rates[i];
        let x = self.membranes[i].at.displacement * self.sheet.length_scale_m();
        let mut power = EnergyFlow {
            gravity_j: self.parameters.weight_n() * v,
            disturbance_j: acting.disturbance_n * v,
            contact_j: self.setup.contact_force(x - self.rest_sag_m, v).force_n * v,
            damper_j: self.parameters.spec().damping_n_s_per_m * v * v,
            ..EnergyFlow::default()
        };
        if let Circuit::Deformable { leak_resistance_ohm: leak, .. } = self.setup.circuit {
            let (voltage, source) = (self.start.voltages_v[i], self.start.sources_a[i]);
            let amplifier = self.setup.amplifier;
            let u = amplifier.output_v(self.motion.amplifier_v, acting.target_v, h * self.radau.nodes[i]);
            power.source_j = u * source;
            power.series_j = (u - voltage) * source;
            power.leak_j = voltage * voltage / leak;
        }
        let start = &mut self.start;
        start.node_power.fill(0.0);
        for branch in &self.branches {
            branch.add_power(i, &mut start.node_power);
        }
        let operator = &self.membranes[i].operator;
        let nodes = operator.weights.iter().zip(&operator.rho).zip(&start.node_power);
        let branches: f64 = nodes.map(|((weight, rho), power)| weight * rho * power).sum();
        power.branches_j = self.energy_scale_j() * branches;
        power
    }
}

/// Whether factors for surroundings `a` still serve `b`.
fn near(a: f64, b: f64) -> bool {
    (a - b).abs() <= 0.01 * b.abs()
}
