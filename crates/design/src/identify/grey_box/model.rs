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
        let plain = PlainModel { rc_s, damping_per_s, terms, branches, displacement_max_mm };
        check(&plain)?;
        Ok(Self { plain })
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
        for term in &self.plain.terms {
            let (i, j) = (i32::from(term.displacement_power), i32::from(term.drive_power));
            let (xi, wj) = (x.powi(i), w.powi(j));
            out[0] += term.coefficient * xi * wj;
            if i > 0 {
                out[1] += term.coefficient * f64::from(i) * x.powi(i - 1) * wj;
            }
            if j > 0 {
                out[2] += term.coefficient * f64::from(j) * xi * w.powi(j - 1);
            }
        }
        out
    }

    /// The squared voltage at which spring and drive alone give an acceleration (mm/s^2) at displacement `x` (mm), held in the range `allowed`.
    ///
    /// **Method**: Newton steps from the linear guess, kept inside a shrinking bracket; the pull rises with the drive wherever the
    /// record was taken.
    #[must_use]
    pub fn drive_for(&self, x: f64, acceleration: f64, allowed: [f64; 2]) -> f64 {
        let [mut low, mut high] = allowed;
        if self.pull(x, low)[0] >= acceleration {
            return low;
        }
        if self.pull(x, high)[0] <= acceleration {
            return high;
        }
        let mut w = 0.5 * (low + high);
        for _ in 0..BISECTIONS {
            let [pull, _, slope] = self.pull(x, w);
            if pull < acceleration {
                low = w;
            } else {
                high = w;
            }
            let newton = w - (pull - acceleration) / slope;
            let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
            if (next - w).abs() <= 1e-15 * (allowed[1] - allowed[0]) {
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
        rules.push(("coefficient", term.coefficient, i + j > 0, "of a term with x or w"));
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
        Ok(Self { plain })
    }
}
