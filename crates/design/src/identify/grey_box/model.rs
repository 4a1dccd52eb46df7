//! The model: a plate on a nonlinear spring that the square of a voltage pulls.

use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// One term `coefficient x^i w^j` of the plate's acceleration.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PullTerm {
    /// Power of the displacement.
    pub displacement_power: u8,
    /// Power of the squared voltage.
    pub drive_power: u8,
    /// Coefficient, mm^(1-i) s^-2 per unit^j.
    pub coefficient: f64,
}

/// A spring behind a dashpot: it pulls back by `rate (x - xi)`, and `xi` follows `x` with its time constant.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CreepBranch {
    /// Stiffness over mass, s^-2.
    pub stiffness_per_s2: f64,
    /// Relaxation time, s.
    pub relaxation_time_s: f64,
}

/// Displacement from voltage, as far as a record shows it.
///
/// **Shapes and units**: displacement `x` in mm from rest, positive as the voltage moves it; drive voltage `v` in units of full
/// scale, `w` the square of the voltage behind the circuit.
///
/// ```text
///   rc c' = v - c,  w = c^2
///   x'' = sum of terms(x, w) - damping x' - sum over branches of stiffness (x - xi)
///   xi' = (x - xi) / relaxation time
/// ```
///
/// **Source**: the structure is that of a viscoelastic membrane with a plate: inertia, a spring whose force is smooth in
/// displacement and squared voltage (MODEL.md, "Dynamics"), Maxwell branches. The numbers come from a record alone.
///
/// **Accuracy**: the terms are a Taylor polynomial about rest: do not trust it beyond [`displacement_max_mm`](Self::displacement_max_mm).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "PlainModel", into = "PlainModel")]
pub struct GreyBoxModel {
    plain: PlainModel,
    /// Coefficient of `x^i w^j` at `[j][i]`.
    table: [[f64; POWERS]; POWERS],
}

/// [`GreyBoxModel`] before its check.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PlainModel {
    rc_s: f64,
    damping_per_s: f64,
    terms: Vec<PullTerm>,
    branches: Vec<CreepBranch>,
    displacement_max_mm: f64,
}

/// Where a model stands.
#[derive(Debug, Clone, PartialEq)]
pub struct GreyBoxState {
    /// Displacement, mm.
    pub displacement_mm: f64,
    /// Velocity, mm/s.
    pub velocity_mm_per_s: f64,
    /// Voltage behind the circuit, units of full scale.
    pub circuit_unit: f64,
    /// Where the dashpot of each branch stands, mm.
    pub branches_mm: Vec<f64>,
}

impl GreyBoxModel {
    /// A checked model.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] for a number that makes no passive plate: a time that is not positive, a negative damping or branch stiffness, a
    /// range that is not positive, or a linear spring that pushes away or a linear drive that does not pull.
    pub fn new(
        rc_s: f64,
        damping_per_s: f64,
        terms: Vec<PullTerm>,
        branches: Vec<CreepBranch>,
        displacement_max_mm: f64,
    ) -> Result<Self> {
        Self::try_from(PlainModel { rc_s, damping_per_s, terms, branches, displacement_max_mm })
    }

    /// Time constant of the circuit, s.
    #[must_use]
    pub fn rc_s(&self) -> f64 {
        self.plain.rc_s
    }

    /// Damping over mass, s^-1.
    #[must_use]
    pub fn damping_per_s(&self) -> f64 {
        self.plain.damping_per_s
    }

    /// Terms of the acceleration.
    #[must_use]
    pub fn terms(&self) -> &[PullTerm] {
        &self.plain.terms
    }

    /// Creep branches.
    #[must_use]
    pub fn branches(&self) -> &[CreepBranch] {
        &self.plain.branches
    }

    /// Largest displacement of the record that it was fitted to, mm.
    #[must_use]
    pub fn displacement_max_mm(&self) -> f64 {
        self.plain.displacement_max_mm
    }

    /// Acceleration by spring and drive alone, without damping and creep, and its derivatives with respect to displacement and drive, at
    /// displacement `x` (mm) and squared voltage `w`: mm/s^2, s^-2, mm/s^2 per unit.
    #[must_use]
    pub fn pull(&self, x: f64, w: f64) -> [f64; 3] {
        let mut out = [0.0; 3];
        for row in self.table.iter().rev() {
            let (value, slope) = horner(row, x);
            out[2] = out[2] * w + out[0];
            out[0] = out[0] * w + value;
            out[1] = out[1] * w + slope;
        }
        out
    }

    /// The squared voltage at which spring and drive alone give an acceleration (mm/s^2) at displacement `x` (mm), held in the range `allowed`.
    ///
    /// **Method**: Newton steps from the linear guess, kept inside a shrinking bracket; the pull rises with the drive wherever the
    /// record was taken.
    #[must_use]
    pub fn drive_for(&self, x: f64, acceleration: f64, allowed: [f64; 2]) -> f64 {
        let in_drive = self.table.map(|row| horner(&row, x).0);
        let pull = |w: f64| horner(&in_drive, w);
        let [mut low, mut high] = allowed;
        if pull(low).0 >= acceleration {
            return low;
        }
        if pull(high).0 <= acceleration {
            return high;
        }
        let mut w = ((acceleration - in_drive[0]) / in_drive[1]).clamp(low, high);
        for _ in 0..BISECTIONS {
            let (value, slope) = pull(w);
            if value < acceleration {
                low = w;
            } else {
                high = w;
            }
            let newton = w - (value - acceleration) / slope;
            let next = if newton >= low && newton <= high { newton } else { 0.5 * (low + high) };
            if (next - w).abs() <= 1e-14 * (allowed[1] - allowed[0]) {
                return next;
            }
            w = next;
        }
        w
    }

    /// At rest without voltage.
    #[must_use]
    pub fn at_rest(&self) -> GreyBoxState {
        GreyBoxState {
            displacement_mm: 0.0,
            velocity_mm_per_s: 0.0,
            circuit_unit: 0.0,
            branches_mm: vec![0.0; self.plain.branches.len()],
        }
    }

    /// Moves a state on by `step_s` under a held voltage (units of full scale).
    ///
    /// **Method**: the circuit exactly, the rest by one step of the classical Runge-Kutta method; 0.5 ms is good for 1e-8 of a motion
    /// below 20 Hz.
    pub fn advance(&self, state: &mut GreyBoxState, voltage_unit: f64, step_s: f64) {
        let n_b = self.plain.branches.len();
        let half = (-0.5 * step_s / self.plain.rc_s).exp();
        let circuit = |decay: f64| voltage_unit + (state.circuit_unit - voltage_unit) * decay;
        let w = [state.circuit_unit.powi(2), circuit(half).powi(2), circuit(half * half).powi(2)];
        let end_circuit = circuit(half * half);
        let mut start = [0.0; 2 + BRANCHES_MAX];
        start[0] = state.displacement_mm;
        start[1] = state.velocity_mm_per_s;
        start[2..2 + n_b].copy_from_slice(&state.branches_mm);
        let mut sum = [0.0; 2 + BRANCHES_MAX];
        let mut slope = [0.0; 2 + BRANCHES_MAX];
        for (stage, (share, weight)) in
            [(0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0)].into_iter().enumerate()
        {
            let at: [f64; 2 + BRANCHES_MAX] = std::array::from_fn(|k| start[k] + share * step_s * slope[k]);
            slope = self.slope(&at, w[[0, 1, 1, 2][stage]]);
            for (total, part) in sum.iter_mut().zip(&slope) {
                *total += weight * part;
            }
        }
        state.displacement_mm = start[0] + step_s / 6.0 * sum[0];
        state.velocity_mm_per_s = start[1] + step_s / 6.0 * sum[1];
        for (k, xi) in state.branches_mm.iter_mut().enumerate() {
            *xi = start[2 + k] + step_s / 6.0 * sum[2 + k];
        }
        state.circuit_unit = end_circuit;
    }

    fn slope(&self, at: &[f64; 2 + BRANCHES_MAX], w: f64) -> [f64; 2 + BRANCHES_MAX] {
        let (x, v) = (at[0], at[1]);
        let mut out = [0.0; 2 + BRANCHES_MAX];
        out[0] = v;
        out[1] = self.pull(x, w)[0] - self.plain.damping_per_s * v;
        for (k, branch) in self.plain.branches.iter().enumerate() {
            let stretch = x - at[2 + k];
            out[1] -= branch.stiffness_per_s2 * stretch;
            out[2 + k] = stretch / branch.relaxation_time_s;
        }
        out
    }
}

/// Value and slope of a polynomial, coefficients by rising power.
fn horner(coefficients: &[f64; POWERS], x: f64) -> (f64, f64) {
    let (mut value, mut slope) = (0.0, 0.0);
    for coefficient in coefficients.iter().rev() {
        slope = slope * x + value;
        value = value * x + coefficient;
    }
    (value, slope)
}

/// Powers of displacement and of drive, 0 to 3.
const POWERS: usize = 4;
/// Most branches of a model.
pub(crate) const BRANCHES_MAX: usize = 4;
/// Halvings that exhaust a double.
const BISECTIONS: usize = 60;

fn check(plain: &PlainModel) -> Result<()> {
    let linear = |i: u8, j: u8| {
        plain
            .terms
            .iter()
            .filter(|term| (term.displacement_power, term.drive_power) == (i, j))
            .map(|term| term.coefficient)
            .sum::<f64>()
    };
    let positive = "finite and above 0";
    let mut rules = vec![
        ("rc_s", plain.rc_s, plain.rc_s > 0.0, positive),
        ("damping_per_s", plain.damping_per_s, plain.damping_per_s >= 0.0, "finite and not negative"),
        ("displacement_max_mm", plain.displacement_max_mm, plain.displacement_max_mm > 0.0, positive),
        ("coefficient of x", linear(1, 0), linear(1, 0) < 0.0, "below 0: the spring pulls back"),
        ("coefficient of w", linear(0, 1), linear(0, 1) > 0.0, "above 0: voltage moves the plate"),
    ];
    for branch in &plain.branches {
        let (stiffness, time) = (branch.stiffness_per_s2, branch.relaxation_time_s);
        rules.push(("stiffness_per_s2", stiffness, stiffness >= 0.0, "finite and not negative"));
        rules.push(("relaxation_time_s", time, time > 0.0, positive));
    }
    for term in &plain.terms {
        let (i, j) = (term.displacement_power, term.drive_power);
        rules.push(("coefficient", term.coefficient, i > 0 || j > 0, "of a term with x or w"));
        let power = i.max(j);
        rules.push(("power of a term", f64::from(power), usize::from(power) < POWERS, "0 to 3"));
    }
    let n_branches = plain.branches.len();
    rules.push(("number of branches", n_branches as f64, n_branches <= BRANCHES_MAX, "0 to 4"));
    match rules.into_iter().find(|(_, found, ok, _)| !(*ok && found.is_finite())) {
        Some((key, found, _, allowed)) => Err(Error::OutOfRange { key, found, allowed }),
        None => Ok(()),
    }
}

impl From<GreyBoxModel> for PlainModel {
    fn from(model: GreyBoxModel) -> Self {
        model.plain
    }
}

impl TryFrom<PlainModel> for GreyBoxModel {
    type Error = Error;

    fn try_from(plain: PlainModel) -> Result<Self> {
        check(&plain)?;
        let mut table = [[0.0; POWERS]; POWERS];
        for term in &plain.terms {
            table[usize::from(term.drive_power)][usize::from(term.displacement_power)] += term.coefficient;
        }
        Ok(Self { plain, table })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model() -> GreyBoxModel {
        let term = |i, j, coefficient| PullTerm { displacement_power: i, drive_power: j, coefficient };
        let terms = vec![
            term(1, 0, -1425.0),
            term(0, 1, 1300.0),
            term(2, 0, -13.0),
            term(1, 1, 190.0),
            term(0, 3, -1.0),
            term(2, 1, 3.0),
        ];
        let branch = CreepBranch { stiffness_per_s2: 22.0, relaxation_time_s: 0.6 };
        GreyBoxModel::new(0.0045, 15.9, terms, vec![branch], 1.0).expect("valid")
    }

    #[test]
    fn law_pull_and_its_derivatives_are_those_of_the_polynomial() {
        let (x, w) = (0.7_f64, 0.4_f64);
        let [pull, by_x, by_w] = model().pull(x, w);
        let expected = -1425.0 * x + 1300.0 * w - 13.0 * x * x + 190.0 * x * w - w.powi(3) + 3.0 * x * x * w;
        assert!((pull - expected).abs() < 1e-10);
        assert!((by_x - (-1425.0 - 26.0 * x + 190.0 * w + 6.0 * x * w)).abs() < 1e-10);
        assert!((by_w - (1300.0 + 190.0 * x - 3.0 * w * w + 3.0 * x * x)).abs() < 1e-10);
    }

    #[test]
    fn law_the_drive_gives_the_acceleration_or_ends_at_its_range() {
        let model = model();
        for x in [0.0, 0.3, 0.9] {
            for acceleration in [-500.0, 0.0, 100.0, 250.0] {
                let w = model.drive_for(x, acceleration, [0.0, 4.0]);
                let reached = model.pull(x, w)[0];
                let low_end = w == 0.0 && reached >= acceleration;
                assert!(
                    low_end || (reached - acceleration).abs() < 1e-9,
                    "{x} {acceleration}: {w} {reached}"
                );
            }
            assert_eq!(model.drive_for(x, 1e6, [0.0, 4.0]), 4.0);
            assert!(model.drive_for(x, -3000.0, [-4.0, 4.0]) < 0.0);
        }
    }

    #[test]
    fn law_a_held_voltage_settles_where_the_pull_is_zero() {
        let model = model();
        let mut state = model.at_rest();
        for _ in 0..40_000 {
            model.advance(&mut state, 0.6, 5e-4);
        }
        // 20 s are 33 relaxation times: the branch is relaxed.
        let left = model.pull(state.displacement_mm, 0.36)[0];
        assert!(left.abs() < 1e-6 && state.velocity_mm_per_s.abs() < 1e-9, "{left}");
        assert!((state.branches_mm[0] - state.displacement_mm).abs() < 1e-9);
    }

    #[test]
    fn edge_models_of_no_plate_are_refused() {
        let good = model();
        let with = |rc_s, damping, terms: &[PullTerm], branches: &[CreepBranch]| {
            GreyBoxModel::new(rc_s, damping, terms.to_vec(), branches.to_vec(), 1.0)
                .expect_err("refused")
                .to_string()
        };
        assert!(with(0.0, 1.0, good.terms(), good.branches()).contains("rc_s"));
        assert!(with(0.01, -1.0, good.terms(), good.branches()).contains("damping_per_s"));
        let mut pushed = good.terms().to_vec();
        pushed[0].coefficient = 10.0;
        assert!(with(0.01, 1.0, &pushed, &[]).contains("coefficient of x"));
        let mut high = good.terms().to_vec();
        high[2].displacement_power = 4;
        assert!(with(0.01, 1.0, &high, &[]).contains("power of a term"));
        let slow = CreepBranch { stiffness_per_s2: 1.0, relaxation_time_s: 0.0 };
        assert!(with(0.01, 1.0, good.terms(), &[slow]).contains("relaxation_time_s"));
        let text = serde_json::to_string(&good).expect("writes");
        assert_eq!(serde_json::from_str::<GreyBoxModel>(&text).expect("reads"), good);
    }
}
