//! Margins of static states, and the voltages at which they are used up.

use serde::Serialize;

use super::breakdown::Site;
use super::criteria::{FailureCriteria, Margin, Mechanism};
use crate::statics::{DEFAULT_DEGREE, Electrodes, Load, Sheet, SlackStates, StaticPoint, StaticSolver};
use crate::{Error, MaxwellBranch};

/// Where one sheet ends, by given criteria.
///
/// **Accuracy**: states are the relaxed membrane's. Fields and stretches are the largest over the collocation nodes, which
/// include plate and frame; stresses are also sought between the nodes.
///
/// **Example**
/// ```
/// use telepulse_actuator::{ParameterSet, failure::{Envelope, FailureCriteria, Mechanism}};
/// let parameters = ParameterSet::A.parameters();
/// let mut envelope = Envelope::new(&parameters.sheet()?, FailureCriteria::default())?;
/// let limits = envelope.voltage_limits(parameters.weight_n())?;
/// let slack_v = limits.of(Mechanism::LossOfTension).expect("reached before the limit point");
/// assert!((10_200.0..10_250.0).contains(&slack_v));
/// # Ok::<(), telepulse_actuator::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Envelope {
    pub(super) sheet: Sheet,
    pub(super) criteria: FailureCriteria,
    pub(super) solver: StaticSolver,
    pub(super) branches: Vec<MaxwellBranch>,
}

/// A static state and its margins.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StateMargins {
    /// Displacement below the frame, m.
    pub displacement_m: f64,
    /// Force of the membrane on the plate, N.
    pub force_n: f64,
    /// Voltage, V.
    pub voltage_v: f64,
    /// To each mechanism that applies.
    pub margins: Vec<Margin>,
}

impl StateMargins {
    /// The smallest margin.
    #[must_use]
    pub fn least(&self) -> Option<&Margin> {
        self.margins.iter().min_by(|a, b| a.left.total_cmp(&b.left))
    }
}

/// Voltage at which a mechanism sets in under a dead load.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct VoltageLimit {
    /// Which.
    pub mechanism: Mechanism,
    /// Voltage, V; none where the mechanism does not come before the end of the path.
    pub voltage_v: Option<f64>,
    /// True where the limit has not been checked against its source.
    pub unverified: bool,
}

/// All voltages at which something sets in under one dead load.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct VoltageLimits {
    /// Dead load, N.
    pub force_n: f64,
    /// By mechanism.
    pub limits: Vec<VoltageLimit>,
}

impl VoltageLimits {
    /// Voltage at which `mechanism` sets in, V.
    #[must_use]
    pub fn of(&self, mechanism: Mechanism) -> Option<f64> {
        self.limits.iter().find(|limit| limit.mechanism == mechanism).and_then(|limit| limit.voltage_v)
    }

    /// The lowest of them.
    #[must_use]
    pub fn first(&self) -> Option<VoltageLimit> {
        let lowest = |a: &&VoltageLimit, b: &&VoltageLimit| {
            let value = |limit: &VoltageLimit| limit.voltage_v.unwrap_or(f64::INFINITY);
            value(a).total_cmp(&value(b))
        };
        self.limits.iter().filter(|limit| limit.voltage_v.is_some()).min_by(lowest).copied()
    }
}

/// Steps in voltage in which a sign change is looked for.
const SCAN_STEPS: usize = 40;
/// Halvings of a bracket: from a step of some hundred volts to well under a millivolt.
const BISECTIONS: usize = 26;
/// Resolution (see [`StaticSolver::resolution`]) that limits ask of the grid.
const RESOLVED: f64 = 1e-8;
/// Degrees tried in turn.
const DEGREES: [usize; 4] = [DEFAULT_DEGREE, 36, 54, 80];
/// What a state's gauges measure, in this order.
const GAUGED: [Mechanism; 4] =
    [Mechanism::LossOfTension, Mechanism::PullIn, Mechanism::Breakdown, Mechanism::Rupture];

impl Envelope {
    /// An envelope of `sheet`.
    ///
    /// # Errors
    /// Those of [`StaticSolver::new`].
    pub fn new(sheet: &Sheet, criteria: FailureCriteria) -> Result<Self, Error> {
        Ok(Self { sheet: sheet.clone(), criteria, solver: StaticSolver::new(sheet)?, branches: Vec::new() })
    }

    /// This envelope for a membrane with Maxwell branches: [`Envelope::over_run`] adds what they carry. Static states are relaxed
    /// and not concerned.
    #[must_use]
    pub fn with_branches(mut self, branches: &[MaxwellBranch]) -> Self {
        self.branches = branches.to_vec();
        self
    }

    /// The criteria.
    #[must_use]
    pub fn criteria(&self) -> &FailureCriteria {
        &self.criteria
    }

    /// A static state and how much is left to each mechanism.
    ///
    /// **Method**: tension and modulus are compared with their values without voltage at the same load (or displacement); the
    /// limit point, which a dead load alone has, and the amplifier's current and voltage by their own limits.
    ///
    /// # Errors
    /// Those of [`StaticSolver::solve`], in the state asked for or without voltage.
    pub fn at(&mut self, load: Load, electrodes: Electrodes) -> Result<StateMargins, Error> {
        self.resolve(load)?;
        let flat = self.solver.solve_even_slack(load, Electrodes::VoltageV(0.0))?;
        let limit_voltage_v = match load {
            Load::ForceN(force_n) => match self.solver.limit_voltage(force_n) {
                Ok(point) => Some(point.voltage_v),
                Err(Error::NoLimitPoint { .. }) => None,
                Err(error) => return Err(error),
            },
            Load::DisplacementM(_) => None,
        };
        let point = self.solver.solve(load, electrodes)?;
        let mut margins = self.material_margins(&point, &flat)?;
        if let Some(limit) = limit_voltage_v {
            margins.push(Margin::below(&self.criteria, Mechanism::LimitPoint, "V", point.voltage_v, limit));
        }
        let amplifier = self.criteria.amplifier;
        if let Some(max_v) = amplifier.max_v {
            margins.push(Margin::below(
                &self.criteria,
                Mechanism::AmplifierVoltage,
                "V",
                point.voltage_v,
                max_v,
            ));
        }
        if let (Some(limit), Some(leak)) = (amplifier.current_a, amplifier.leak_resistance_ohm) {
            let current = point.voltage_v / leak;
            margins.push(Margin::below(&self.criteria, Mechanism::AmplifierCurrent, "A", current, limit));
        }
        let StaticPoint { displacement_m, force_n, voltage_v, .. } = point;
        Ok(StateMargins { displacement_m, force_n, voltage_v, margins })
    }

    /// Margins of the membrane itself in the solver's last state, `point`; `flat` is the state without voltage.
    pub(super) fn material_margins(
        &self,
        point: &StaticPoint,
        flat: &StaticPoint,
    ) -> Result<Vec<Margin>, Error> {
        let tension = |point: &StaticPoint| point.s1_min_pa.min(point.s2_min_pa);
        let criteria = &self.criteria;
        let profile = self.solver.profile()?;
        let thickness_m = self.sheet.spec().thickness_m;
        let (mut field, mut strength, mut stretch) = (0.0, f64::INFINITY, 0.0_f64);
        let nodes = profile.lambda1.iter().zip(&profile.lambda2).zip(&profile.true_field_v_per_m);
        for ((&lambda1, &lambda2), &here) in nodes {
            let site = Site { lambda1, lambda2, thickness_m: thickness_m / (lambda1 * lambda2) };
            let bears = criteria.breakdown.strength_v_per_m(site);
            if strength == f64::INFINITY || here * strength > field * bears {
                (field, strength) = (here, bears);
            }
            stretch = stretch.max(lambda1).max(lambda2);
        }
        Ok(vec![
            Margin::above_zero(Mechanism::LossOfTension, tension(point), tension(flat)),
            Margin::above_zero(Mechanism::PullIn, point.modulus_min_pa, flat.modulus_min_pa),
            Margin::below(criteria, Mechanism::Breakdown, "V/m", field, strength),
            Margin::below(criteria, Mechanism::Rupture, "1", stretch, criteria.rupture_stretch),
        ])
    }

    /// Voltages at which each mechanism sets in under a dead load.
    ///
    /// **Method**: the path from zero voltage to the limit point (or to where the search for it ends) is scanned in 40 steps for
    /// the first change of sign of each margin, which is then halved 26 times. Slack states are solved through.
    ///
    /// **Accuracy**: 1e-9 of the path's last voltage, of the relaxed membrane.
    ///
    /// # Errors
    /// Those of [`StaticSolver::limit_voltage`] for the load without voltage.
    pub fn voltage_limits(&mut self, force_n: f64) -> Result<VoltageLimits, Error> {
        let load = Load::ForceN(force_n);
        self.resolve(load)?;
        let (end_v, limit_v) = match self.solver.limit_voltage(force_n) {
            Ok(point) => (point.voltage_v, Some(point.voltage_v)),
            Err(Error::NoLimitPoint { voltage_v, .. }) => (voltage_v, None),
            Err(error) => return Err(error),
        };
        let flat = self.solver.solve_even_slack(load, Electrodes::VoltageV(0.0))?;
        let mut found: [Option<f64>; 4] = [None; 4];
        let mut before = self.gauges(&flat, &flat)?;
        for (slot, left) in found.iter_mut().zip(before) {
            if left <= 0.0 {
                *slot = Some(0.0);
            }
        }
        let mut low = 0.0;
        for step in 1..=SCAN_STEPS {
            let high = end_v * (step as f64 / SCAN_STEPS as f64).min(1.0 - 1e-9);
            // Close to the limit point a state may not be reached any more: the path ends here.
            let Some(after) = self.gauges_at(force_n, high, &flat)? else { break };
            for idx in 0..GAUGED.len() {
                if found[idx].is_none() && before[idx] > 0.0 && after[idx] <= 0.0 {
                    found[idx] = Some(self.crossing(force_n, [low, high], idx, &flat)?);
                }
            }
            (low, before) = (high, after);
        }
        Ok(self.collect(force_n, found, limit_v))
    }

    fn collect(&self, force_n: f64, found: [Option<f64>; 4], limit_v: Option<f64>) -> VoltageLimits {
        let amplifier = self.criteria.amplifier;
        let leak_v = amplifier.current_a.zip(amplifier.leak_resistance_ohm).map(|(i, r)| i * r);
        let mut all: Vec<(Mechanism, Option<f64>)> = GAUGED.into_iter().zip(found).collect();
        all.push((Mechanism::LimitPoint, limit_v));
        if amplifier.max_v.is_some() {
            all.push((Mechanism::AmplifierVoltage, amplifier.max_v));
        }
        if leak_v.is_some() {
            all.push((Mechanism::AmplifierCurrent, leak_v));
        }
        let limits = all
            .into_iter()
            .map(|(mechanism, voltage_v)| VoltageLimit {
                mechanism,
                voltage_v,
                unverified: self.criteria.is_unverified(mechanism),
            })
            .collect();
        VoltageLimits { force_n, limits }
    }

    /// Halves `[low, high]` down to where the gauge `idx` changes its sign.
    fn crossing(
        &mut self,
        force_n: f64,
        [mut low, mut high]: [f64; 2],
        idx: usize,
        flat: &StaticPoint,
    ) -> Result<f64, Error> {
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            match self.gauges_at(force_n, middle, flat)? {
                Some(gauges) if gauges[idx] > 0.0 => low = middle,
                _ => high = middle,
            }
        }
        // The lower end: there the mechanism has not set in.
        Ok(low)
    }

    /// What is left to each of [`GAUGED`] under a dead load and a voltage, or nothing where no state was reached.
    pub(super) fn gauges_at(
        &mut self,
        force_n: f64,
        voltage_v: f64,
        flat: &StaticPoint,
    ) -> Result<Option<[f64; 4]>, Error> {
        match self.near(Load::ForceN(force_n), voltage_v) {
            Ok(point) => self.gauges(&point, flat).map(Some),
            Err(_) => Ok(None),
        }
    }

    fn gauges(&self, point: &StaticPoint, flat: &StaticPoint) -> Result<[f64; 4], Error> {
        let margins = self.material_margins(point, flat)?;
        Ok([margins[0].left, margins[1].left, margins[2].left, margins[3].left])
    }

    /// The state near the last one, slack or not.
    pub(super) fn near(&mut self, load: Load, voltage_v: f64) -> Result<StaticPoint, Error> {
        let electrodes = Electrodes::VoltageV(voltage_v);
        self.solver.solve_near_with(self.sheet.law(), load, electrodes, SlackStates::Returned)
    }

    /// Chooses the degree that resolves the membrane without voltage, and leaves the solver there.
    pub(super) fn resolve(&mut self, load: Load) -> Result<(), Error> {
        for degree in DEGREES {
            let mut solver = StaticSolver::with_degree(&self.sheet, degree)?;
            let solved = solver.solve_even_slack(load, Electrodes::VoltageV(0.0));
            let enough = solver.resolution() < RESOLVED || degree == DEGREES[DEGREES.len() - 1];
            self.solver = solver;
            if enough {
                return solved.map(|_| ());
            }
        }
        Ok(())
    }
}
