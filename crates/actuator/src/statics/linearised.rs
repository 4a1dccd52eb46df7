//! The linearised equilibrium: q eliminated at every node, the rest factored.
//!
//! With G = vertical residual, a Newton step needs Q_q dq = -(G + Q_p dp + Q_r dr + df + Q_v dv^2) at every node, dp = D dr. Put
//! into the radial balance this leaves a dense system in dr at the inner nodes, symmetric but for the collocation, with df
//! and dv^2 as borders where they are unknown:
//! ```text
//! [ D a D + D b - b D - c   | D(-Q_p/Q_q) + Q_r/Q_q | D(..) - .. ] [ dr   ]
//! [ displacement by dr      |   sum w/Q_q           | ..         ] [ df   ]        a, b, c: condensed derivatives
//! [ capacitance by dr       |   ..                  | ..         ] [ dv^2 ]
//! ```

use super::kernel::{Evaluation, State};
use super::lu::{Factors, dot};
use super::operator::Operator;

/// Which two of force, displacement, voltage and charge are prescribed, dimensionless: the others follow.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Control {
    pub(crate) load: Held,
    pub(crate) electric: Electric,
}

/// What holds the plate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Held {
    /// f.
    Force(f64),
    /// x.
    Displacement(f64),
}

/// What holds the electrodes; the last variant holds none of both but the plate twice.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Electric {
    /// v^2.
    Field(f64),
    /// v^2 c^2 with c the dimensionless capacitance.
    ChargeSquared(f64),
    /// v^2 follows from the displacement, which is held beside the force.
    Displacement(f64),
}

impl Control {
    fn force_unknown(self) -> bool {
        matches!(self.load, Held::Displacement(_))
    }

    fn field_unknown(self) -> bool {
        !matches!(self.electric, Electric::Field(_))
    }

    /// Whether a factorization for `self` serves `other`.
    fn same_kind(self, other: Self) -> bool {
        std::mem::discriminant(&self.load) == std::mem::discriminant(&other.load)
            && std::mem::discriminant(&self.electric) == std::mem::discriminant(&other.electric)
    }
}

/// What stands between the prescribed quantities and the membrane, dimensionless; nothing in a static solve.
///
/// ```text
/// displacement + compliance f = x            a plate that moves freely, seen over one implicit step of time
/// v^2 (c + parallel)^2        = charge^2     a resistor to a source, seen over one implicit step of time
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Surroundings {
    /// In series with a prescribed displacement.
    pub(crate) compliance: f64,
    /// In parallel to a prescribed charge.
    pub(crate) parallel: f64,
}

/// A change of the state.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Step {
    pub(crate) r: Vec<f64>,
    pub(crate) p: Vec<f64>,
    pub(crate) q: Vec<f64>,
    pub(crate) force: f64,
    pub(crate) field: f64,
}

impl Step {
    pub(crate) fn new(degree: usize) -> Self {
        let zeros = || vec![0.0; degree + 1];
        Self { r: zeros(), p: zeros(), q: zeros(), force: 0.0, field: 0.0 }
    }

    pub(crate) fn apply(&self, state: &mut State, factor: f64) {
        for (value, change) in state.r.iter_mut().zip(&self.r).chain(state.q.iter_mut().zip(&self.q)) {
            *value += factor * change;
        }
        state.force += factor * self.force;
        state.field += factor * self.field;
    }

    /// Largest change of a radius, a slope, the force or v^2; not a number where one of them is none.
    pub(crate) fn size(&self) -> f64 {
        let both = [self.force, self.field];
        let all = self.r.iter().chain(&self.q).chain(&both);
        // `max` passes over what is not a number.
        all.fold(0.0, |a: f64, b| if a.is_nan() || b.is_nan() { f64::NAN } else { a.max(b.abs()) })
    }
}

/// Gradient of a scalar in the state with q eliminated: `p` and `r` per node, then force, v^2.
#[derive(Debug, Clone, PartialEq)]
struct Gradient {
    p: Vec<f64>,
    r: Vec<f64>,
    force: f64,
    field: f64,
}

impl Gradient {
    fn new(degree: usize) -> Self {
        Self { p: vec![0.0; degree + 1], r: vec![0.0; degree + 1], force: 0.0, field: 0.0 }
    }
}

/// The factored linearisation at one state, kept for as long as it serves.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Linearised {
    pub(crate) surroundings: Surroundings,
    control: Option<Control>,
    /// Q_p/Q_q = P_q/Q_q, Q_r/Q_q = s2_q/Q_q, 1/Q_q, Q_v/Q_q.
    by_p: Vec<f64>,
    by_r: Vec<f64>,
    by_force: Vec<f64>,
    by_field: Vec<f64>,
    /// Condensed P_p and P_r.
    p_p: Vec<f64>,
    p_r: Vec<f64>,
    displacement: Gradient,
    capacitance: Gradient,
    capacitance_by_q: Vec<f64>,
    /// Columns of the balance by f and by v^2, at the inner nodes.
    force_column: Vec<f64>,
    field_column: Vec<f64>,
    field: f64,
    capacitance_value: f64,
    lu: Factors,
    rhs: Vec<f64>,
    work: Vec<f64>,
    slope: Vec<f64>,
}

impl Linearised {
    pub(crate) fn new(degree: usize) -> Self {
        let zeros = || vec![0.0; degree + 1];
        Self {
            surroundings: Surroundings::default(),
            control: None,
            by_p: zeros(),
            by_r: zeros(),
            by_force: zeros(),
            by_field: zeros(),
            p_p: zeros(),
            p_r: zeros(),
            displacement: Gradient::new(degree),
            capacitance: Gradient::new(degree),
            capacitance_by_q: zeros(),
            force_column: zeros(),
            field_column: zeros(),
            field: 0.0,
            capacitance_value: 0.0,
            lu: Factors::new(degree + 1),
            rhs: zeros(),
            work: zeros(),
            slope: zeros(),
        }
    }

    /// Whether there are factors that serve `control`.
    pub(crate) fn serves(&self, control: Control) -> bool {
        self.control.is_some_and(|known| known.same_kind(control))
    }

    /// Forgets the factors.
    pub(crate) fn discard(&mut self) {
        self.control = None;
    }

    /// Linearises and factors; false where the system is singular.
    pub(crate) fn factor(
        &mut self,
        operator: &Operator,
        at: &Evaluation,
        field: f64,
        control: Control,
    ) -> bool {
        self.control = None;
        if !self.condense(operator, at) {
            return false;
        }
        let n = operator.degree;
        let (n_inner, force_unknown, field_unknown) =
            (n - 1, control.force_unknown(), control.field_unknown());
        let size = n_inner + usize::from(force_unknown) + usize::from(field_unknown);
        (self.field, self.capacitance_value) = (field, at.capacitance + self.surroundings.parallel);
        self.lu.reset(size);
        self.columns(operator, at);
        for i in 1..n {
            let row = self.lu.row_mut(i - 1);
            operator.add_product_row(i, &self.p_p, row);
            // (D b - b D)_ik = D_ik (b_k - b_i).
            let b_i = self.p_r[i];
            for ((value, d), b) in row.iter_mut().zip(operator.inner_row(i)).zip(&self.p_r[1..n]) {
                *value += d * (b - b_i);
            }
            row[i - 1] -= at.points[i].s2_r - self.by_r[i] * at.points[i].q_r;
            let mut column = n_inner;
            if force_unknown {
                row[column] = self.force_column[i];
                column += 1;
            }
            if field_unknown {
                row[column] = self.field_column[i];
            }
        }
        let mut next = n_inner;
        if force_unknown {
            self.border_row(operator, next, Border::Displacement, control);
            self.lu.row_mut(next)[n_inner] += self.surroundings.compliance;
            next += 1;
        }
        match control.electric {
            Electric::Field(_) => {}
            Electric::ChargeSquared(_) => self.border_row(operator, next, Border::Charge, control),
            Electric::Displacement(_) => self.border_row(operator, next, Border::Displacement, control),
        }
        if self.lu.factor() {
            self.control = Some(control);
        }
        self.control.is_some()
    }

    /// Eliminates q at every node; false where a node has no vertical stiffness left.
    fn condense(&mut self, operator: &Operator, at: &Evaluation) -> bool {
        let (mut displacement, mut capacitance) = ([0.0; 2], [0.0; 2]);
        for (j, point) in at.points.iter().enumerate() {
            if point.q_q.abs() <= SMALLEST_STIFFNESS {
                return false;
            }
            let weight = operator.weights[j];
            let by_force = 1.0 / point.q_q;
            let (by_p, by_r, by_field) =
                (point.p_q * by_force, point.q_r * by_force, point.q_field * by_force);
            self.by_p[j] = by_p;
            self.by_r[j] = by_r;
            self.by_force[j] = by_force;
            self.by_field[j] = by_field;
            self.p_p[j] = point.p_p - point.p_q * by_p;
            self.p_r[j] = point.p_r - point.p_q * by_r;
            self.displacement.p[j] = weight * by_p;
            self.displacement.r[j] = weight * by_r;
            displacement[0] += weight * by_force;
            displacement[1] += weight * by_field;
            // The capacitance is -2 times the derivative of the electrical energy by v^2.
            let by_q = -2.0 * weight * point.q_field;
            self.capacitance_by_q[j] = by_q;
            self.capacitance.p[j] = -2.0 * weight * point.p_field - by_q * by_p;
            self.capacitance.r[j] = -2.0 * weight * point.s2_field - by_q * by_r;
            capacitance[0] -= by_q * by_force;
            capacitance[1] -= by_q * by_field;
        }
        [self.displacement.force, self.displacement.field] = displacement;
        [self.capacitance.force, self.capacitance.field] = capacitance;
        true
    }

    /// Derivatives of the balance by f and by v^2.
    fn columns(&mut self, operator: &Operator, at: &Evaluation) {
        for (work, by_p) in self.work.iter_mut().zip(&self.by_p) {
            *work = -by_p;
        }
        operator.differentiate(&self.work, &mut self.force_column);
        for (value, by_r) in self.force_column.iter_mut().zip(&self.by_r) {
            *value += by_r;
        }
        for (j, point) in at.points.iter().enumerate() {
            self.work[j] = point.p_field - self.by_p[j] * point.q_field;
        }
        operator.differentiate(&self.work, &mut self.field_column);
        for (j, point) in at.points.iter().enumerate() {
            self.field_column[j] -= point.s2_field - self.by_r[j] * point.q_field;
        }
    }

    fn border_row(&mut self, operator: &Operator, index: usize, border: Border, control: Control) {
        let n = operator.degree;
        let (gradient, factor) = match border {
            Border::Displacement => (&self.displacement, 1.0),
            Border::Charge => (&self.capacitance, 2.0 * self.field * self.capacitance_value),
        };
        let row = self.lu.row_mut(index);
        for (j, by_p) in gradient.p.iter().enumerate() {
            for (value, d) in row.iter_mut().zip(operator.inner_row(j)) {
                *value += factor * by_p * d;
            }
        }
        for (value, by_r) in row.iter_mut().zip(&gradient.r[1..n]) {
            *value += factor * by_r;
        }
        let mut column = n - 1;
        if control.force_unknown() {
            row[column] = factor * gradient.force;
            column += 1;
        }
        if control.field_unknown() {
            let own = if border == Border::Charge { self.capacitance_value.powi(2) } else { 0.0 };
            row[column] = factor * gradient.field + own;
        }
    }

    /// Newton step from a state with evaluation `at`, which need not be the state that was factored.
    pub(crate) fn step(
        &mut self,
        operator: &Operator,
        at: &Evaluation,
        state: &State,
        control: Control,
        step: &mut Step,
    ) {
        let n = operator.degree;
        for (j, work) in self.work.iter_mut().enumerate() {
            *work = at.radial[j] - self.by_p[j] * at.vertical[j];
        }
        operator.differentiate(&self.work, &mut self.slope);
        for i in 1..n {
            self.rhs[i - 1] = at.s2[i] - self.by_r[i] * at.vertical[i] - self.slope[i];
        }
        // What the elimination of q alone does to displacement and capacitance.
        let mut shift = [0.0; 2];
        for j in 0..=n {
            let own = -at.vertical[j] * self.by_force[j];
            shift[0] -= operator.weights[j] * own;
            shift[1] += self.capacitance_by_q[j] * own;
        }
        let mut next = n - 1;
        if let Held::Displacement(target) = control.load {
            self.rhs[next] = target - at.displacement - self.surroundings.compliance * state.force - shift[0];
            next += 1;
        }
        match control.electric {
            Electric::Field(_) => {}
            Electric::ChargeSquared(target) => {
                self.rhs[next] = target
                    - state.field * (at.capacitance + self.surroundings.parallel).powi(2)
                    - 2.0 * self.field * self.capacitance_value * shift[1];
            }
            Electric::Displacement(target) => self.rhs[next] = target - at.displacement - shift[0],
        }
        self.lu.solve(&mut self.rhs);
        self.unpack(operator, control, step);
        for j in 0..=n {
            step.q[j] -= self.by_force[j] * at.vertical[j];
        }
    }

    /// Spreads the solution over a step, q by back substitution without the residual's share.
    fn unpack(&mut self, operator: &Operator, control: Control, step: &mut Step) {
        let n = operator.degree;
        step.r[1..n].copy_from_slice(&self.rhs[..n - 1]);
        (step.r[0], step.r[n]) = (0.0, 0.0);
        let mut next = n - 1;
        (step.force, step.field) = (0.0, 0.0);
        if control.force_unknown() {
            step.force = self.rhs[next];
            next += 1;
        }
        if control.field_unknown() {
            step.field = self.rhs[next];
        }
        self.back_substitute(operator, step);
    }

    fn back_substitute(&self, operator: &Operator, step: &mut Step) {
        operator.differentiate(&step.r, &mut step.p);
        for j in 0..=operator.degree {
            step.q[j] = -(self.by_p[j] * step.p[j]
                + self.by_r[j] * step.r[j]
                + self.by_force[j] * step.force
                + self.by_field[j] * step.field);
        }
    }

    /// Response of the equilibrium that was factored to a unit change of a prescribed quantity, the other one held.
    ///
    /// Only meaningful for a quantity that the control of the factors prescribes.
    pub(crate) fn response(&mut self, operator: &Operator, cause: Cause, step: &mut Step) {
        let Some(control) = self.control else { return };
        let n = operator.degree;
        let charge_factor = 2.0 * self.field * self.capacitance_value;
        let (direct, displacement, capacitance) = match cause {
            Cause::Displacement => (None, 0.0, 0.0),
            Cause::Force => (Some(&self.force_column), self.displacement.force, self.capacitance.force),
            Cause::Field => (Some(&self.field_column), self.displacement.field, self.capacitance.field),
        };
        for i in 1..n {
            self.rhs[i - 1] = direct.map_or(0.0, |column| -column[i]);
        }
        let held = if cause == Cause::Displacement { 1.0 } else { -displacement };
        let mut next = n - 1;
        if control.force_unknown() {
            self.rhs[next] = held;
            next += 1;
        }
        match control.electric {
            Electric::Field(_) => {}
            Electric::ChargeSquared(_) => self.rhs[next] = -charge_factor * capacitance,
            Electric::Displacement(_) => self.rhs[next] = held,
        }
        self.lu.solve(&mut self.rhs);
        self.unpack(operator, control, step);
        match cause {
            Cause::Displacement => {}
            Cause::Force => step.force += 1.0,
            Cause::Field => step.field += 1.0,
        }
        self.back_substitute(operator, step);
    }

    /// Change of the displacement in a response.
    pub(crate) fn displacement_of(&self, step: &Step) -> f64 {
        of_step(&self.displacement, step)
    }

    /// Change of the capacitance in a response.
    pub(crate) fn capacitance_of(&self, step: &Step) -> f64 {
        of_step(&self.capacitance, step)
    }
}

fn of_step(gradient: &Gradient, step: &Step) -> f64 {
    dot(&gradient.p, &step.p)
        + dot(&gradient.r, &step.r)
        + gradient.force * step.force
        + gradient.field * step.field
}

/// What a border row holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Border {
    Displacement,
    Charge,
}

/// Which prescribed quantity changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Cause {
    /// x.
    Displacement,
    /// f.
    Force,
    /// v^2.
    Field,
}

/// Vertical stiffness R ds1/dtheta below which a node counts as slack.
const SMALLEST_STIFFNESS: f64 = 1e-10;
