//! The viscoelastic membrane in motion at field level: every node carries its own dashpots. The judge of the reduced twin.

mod branches;
mod circuit;
mod contact;
mod energy;
mod fractional;
mod radau;
mod setup;
mod springs;
mod stage;
mod step;

pub use circuit::{Amplifier, Circuit};
pub use contact::PlateContact;
pub use energy::{EnergyFlow, StoredEnergy};
pub use setup::FieldSetup;

use branches::{Branch, HeldLaw};
use radau::{Radau, STAGES};
use step::{Motion, StepStart};

use crate::statics::{
    Control, Effort, Electric, Electrodes, Held, Load, Sheet, SlackStates, StaticPoint, StaticSolver,
    Surroundings, Workspace, summarise,
};
use crate::{ActuatorParameters, Error};

/// The actuator in motion with dashpots at every collocation node.
///
/// ```text
/// m x'' = m g - F(x, Phi, dashpots) - c x' + N + d          N: contact, d: disturbance, both positive down
/// d(C Phi)/dt = (u - Phi)/R_s - Phi/R_leak                  u: amplifier, C: capacitance of the membrane as it stands
/// xi1'/xi1 = (t1 - t2/2)/(3 mu_i tau_i),  1 <-> 2           at every node and branch
/// ```
/// **Method**: Radau IIA of order five, its stages swept over one after the other. In each sweep a stage takes one Newton step of
/// the membrane, in which the plate is a compliance in series with the force, the resistor a capacitance beside the electrodes,
/// and a branch a spring that yields, its dashpot eliminated node by node. Nothing is lagged once the sweeps end, and stiff
/// branches, circuits and contacts need no small steps. Factors serve for as long as the sweeps contract; stages are guessed by
/// those of the step before. A step that fails is halved.
///
/// **Source**: branches by Foo, Cai, Koh, Bauer, Suo 2012.
///
/// **Accuracy**: the membrane's own inertia is left out (first mode about 120 Hz). In time, see the tests: at steps of 4 ms the
/// response of set A follows the frequency-domain solve to 0.1 % and 0.1 degree up to 13 Hz.
///
/// **Example**
/// ```
/// use telepulse_actuator::{ParameterSet, field::FieldTwin};
/// let mut twin = FieldTwin::new(&ParameterSet::A.parameters(), 16)?;
/// for _ in 0..125 {
///     twin.step(4e-3, 5000.0)?;
/// }
/// // 1.006 mm half a second after a step to 5 kV.
/// assert!((twin.displacement_mm() - 1.006).abs() < 1e-3);
/// # Ok::<(), telepulse_actuator::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct FieldTwin {
    parameters: ActuatorParameters,
    setup: FieldSetup,
    sheet: Sheet,
    radau: Radau,
    branches: Vec<Branch>,
    /// One for each stage; the last is also the present.
    membranes: [Workspace; STAGES],
    start: StepStart,
    motion: Motion,
    rest_sag_m: f64,
    modulus_factor: f64,
    flow: EnergyFlow,
    time_s: f64,
    last_solve: Effort,
    effort: FieldEffort,
}

impl FieldTwin {
    /// At rest under its load at zero voltage, all branches relaxed, with `degree + 1` nodes; ideal amplifier, constant time
    /// constant of the circuit, no contact.
    ///
    /// # Errors
    /// Those of [`FieldTwin::with_setup`].
    pub fn new(parameters: &ActuatorParameters, degree: usize) -> Result<Self, Error> {
        Self::with_setup(parameters, degree, FieldSetup::plain(parameters))
    }

    /// At rest under its load and contact at zero voltage, all branches relaxed.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a setup out of range; those of [`StaticSolver::with_degree`] and [`StaticSolver::solve`].
    pub fn with_setup(
        parameters: &ActuatorParameters,
        degree: usize,
        setup: FieldSetup,
    ) -> Result<Self, Error> {
        setup.check()?;
        let sheet = parameters.sheet()?;
        let mut solver = StaticSolver::with_degree(&sheet, degree)?;
        let rest = solver.solve(Load::ForceN(parameters.weight_n()), Electrodes::VoltageV(0.0))?;
        let workspace = Workspace::new(solver.operator().clone(), solver.state().clone());
        let mut twin = Self {
            parameters: parameters.clone(),
            setup,
            sheet,
            radau: Radau::new(),
            branches: Vec::new(),
            start: StepStart::at(&workspace.state),
            membranes: std::array::from_fn(|_| workspace.clone()),
            motion: Motion::default(),
            rest_sag_m: rest.displacement_m,
            modulus_factor: 1.0,
            flow: EnergyFlow::default(),
            time_s: 0.0,
            last_solve: Effort { iterations: 0, factorizations: 0, residual: rest.residual },
            effort: FieldEffort::default(),
        };
        twin.settle(0.0)?;
        Ok(twin)
    }

    /// Puts everything at rest under `bias_v` at the amplifier's input, all branches relaxed; clock and energies start anew.
    ///
    /// **Method**: Newton on the balance of plate, membrane and contact, at most 50 solves.
    ///
    /// # Errors
    /// [`Error::Request`] for a voltage that is not a number; those of [`StaticSolver::solve`]; [`Error::NotConverged`].
    pub fn settle(&mut self, bias_v: f64) -> Result<(), Error> {
        if !bias_v.is_finite() {
            return Err(Error::Request { quantity: "bias_v", allowed: "finite", found: bias_v });
        }
        let amplifier_v = self.setup.amplifier.target_v(bias_v);
        let voltage_v = self.setup.circuit.settled_v(amplifier_v, self.setup.amplifier.current_limit_a);
        let mut solver = StaticSolver::with_degree(&self.sheet, self.membranes[0].operator.degree)?;
        let point = self.settled(&mut solver, voltage_v)?;
        let state = solver.state();
        for membrane in &mut self.membranes {
            membrane.state.copy_from(state);
            membrane.linear.discard();
        }
        let profile = solver.profile()?;
        let mu_pa = self.parameters.spec().mu_pa;
        self.branches = self
            .parameters
            .spec()
            .branches
            .iter()
            .chain(&self.setup.extra_branches)
            .map(|branch| Branch::relaxed(*branch, mu_pa, &profile.lambda1, &profile.lambda2))
            .collect();
        self.motion = Motion {
            x_m: point.displacement_m,
            v_m_per_s: 0.0,
            electric: match self.setup.circuit {
                Circuit::ConstantRc => voltage_v,
                Circuit::Deformable { .. } => point.charge_c,
            },
            amplifier_v,
            voltage_v,
        };
        (self.flow, self.time_s) = (EnergyFlow::default(), 0.0);
        self.effort = FieldEffort::default();
        self.rebalance()?;
        self.stand();
        Ok(())
    }

    /// Relaxed equilibrium of plate, membrane and contact.
    fn settled(&self, solver: &mut StaticSolver, voltage_v: f64) -> Result<StaticPoint, Error> {
        let law = HeldLaw { network: self.sheet.law(), modulus_factor: self.modulus_factor, branches: &[] };
        let (weight, electrodes) = (self.parameters.weight_n(), Electrodes::VoltageV(voltage_v));
        let slack = SlackStates::Refused;
        let mut point = solver.solve_with(&law, Load::ForceN(weight), electrodes, slack)?;
        for _ in 0..MAX_SETTLING {
            let contact = self.setup.contact_force(point.displacement_m - self.rest_sag_m, 0.0);
            let surplus = weight + contact.force_n - point.force_n;
            let stiffness = solver.derivatives()?.stiffness_n_per_m - contact.by_x;
            let change = surplus / stiffness;
            if change.abs() < SETTLED * self.sheet.length_scale_m() {
                return Ok(point);
            }
            let load = Load::DisplacementM(point.displacement_m + change);
            point = solver.solve_near_with(&law, load, electrodes, slack)?;
        }
        let (residual, iterations) = (point.residual, MAX_SETTLING);
        Err(Error::NotConverged { voltage_v, residual, iterations })
    }

    /// Changes all moduli, network and branches, to `factor` times those of the parameters: ageing or temperature, in between two
    /// steps. Plate, charge and dashpots stay where they are.
    ///
    /// # Errors
    /// [`Error::Request`] for a factor that is not positive; [`Error::NotConverged`].
    pub fn set_modulus_factor(&mut self, factor: f64) -> Result<(), Error> {
        if !(factor.is_finite() && factor > 0.0) {
            let (quantity, allowed) = ("modulus factor", "finite and positive");
            return Err(Error::Request { quantity, allowed, found: factor });
        }
        let before = self.stored().total_j();
        self.modulus_factor = factor;
        self.rebalance()?;
        self.flow.ageing_j += self.stored().total_j() - before;
        self.stand();
        Ok(())
    }

    /// Solves the membrane at the present plate position, charge and dashpots.
    fn rebalance(&mut self) -> Result<(), Error> {
        let sheet = &self.sheet;
        let electric = match self.setup.circuit {
            Circuit::ConstantRc => {
                Electric::Field(sheet.field_scale_per_v2() * self.motion.voltage_v.powi(2))
            }
            Circuit::Deformable { .. } => Electric::ChargeSquared(
                sheet.field_scale_per_v2() * (self.motion.electric / sheet.capacitance_scale_f()).powi(2),
            ),
        };
        let load = Held::Displacement(self.motion.x_m / sheet.length_scale_m());
        let law =
            HeldLaw { network: sheet.law(), modulus_factor: self.modulus_factor, branches: &self.branches };
        let present = &mut self.membranes[STAGES - 1];
        present.linear.surroundings = Surroundings::default();
        present.linear.discard();
        self.last_solve =
            present.solve(&law, Control { load, electric }).map_err(|effort| Error::NotConverged {
                voltage_v: self.motion.voltage_v,
                residual: effort.residual,
                iterations: effort.iterations,
            })?;
        present.linear.discard();
        if let Circuit::Deformable { .. } = self.setup.circuit {
            let capacitance_f = present.at.capacitance * sheet.capacitance_scale_f();
            self.motion.voltage_v = self.motion.electric / capacitance_f;
        }
        Ok(())
    }

    /// Scalars of the membrane as it stands; nothing is refused, see [`StaticPoint::require_taut`] and its neighbours.
    #[must_use]
    pub fn point(&self) -> StaticPoint {
        summarise(&self.sheet, &self.membranes[STAGES - 1], self.last_solve)
    }

    /// Displacement from the rest position under the weight at zero voltage without contact, mm, positive down.
    #[must_use]
    pub fn displacement_mm(&self) -> f64 {
        (self.motion.x_m - self.rest_sag_m) * 1e3
    }

    /// Velocity of the plate, mm/s, positive down.
    #[must_use]
    pub fn velocity_mm_per_s(&self) -> f64 {
        self.motion.v_m_per_s * 1e3
    }

    /// Voltage across the membrane, V.
    #[must_use]
    pub fn membrane_voltage_v(&self) -> f64 {
        self.motion.voltage_v
    }

    /// Voltage at the amplifier's output, V.
    #[must_use]
    pub fn amplifier_v(&self) -> f64 {
        self.motion.amplifier_v
    }

    /// Capacitance of the membrane, F.
    #[must_use]
    pub fn capacitance_f(&self) -> f64 {
        self.membranes[STAGES - 1].at.capacitance * self.sheet.capacitance_scale_f()
    }

    /// Force with which the membrane pulls the plate up, N.
    #[must_use]
    pub fn membrane_force_n(&self) -> f64 {
        self.membranes[STAGES - 1].state.force * self.sheet.force_scale_n()
    }

    /// Force with which the contact pushes the plate down, N.
    #[must_use]
    pub fn contact_force_n(&self) -> f64 {
        self.setup.contact_force(self.motion.x_m - self.rest_sag_m, self.motion.v_m_per_s).force_n
    }

    /// Current from the amplifier into the membrane, A.
    #[must_use]
    pub fn current_a(&self) -> f64 {
        let resistance_ohm = match self.setup.circuit {
            Circuit::ConstantRc => self.parameters.spec().rc_s / self.capacitance_f(),
            Circuit::Deformable { series_resistance_ohm, .. } => series_resistance_ohm,
        };
        let limit = self.setup.amplifier.current_limit_a;
        ((self.motion.amplifier_v - self.motion.voltage_v) / resistance_ohm).clamp(-limit, limit)
    }

    /// Time since the twin was last put at rest, s.
    #[must_use]
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// What simulating has taken since the twin was last put at rest.
    #[must_use]
    pub fn effort(&self) -> FieldEffort {
        self.effort
    }

    /// What the twin stands in.
    #[must_use]
    pub fn setup(&self) -> &FieldSetup {
        &self.setup
    }

    /// Energy that is stored now.
    #[must_use]
    pub fn stored(&self) -> StoredEnergy {
        let Workspace { at, operator, .. } = &self.membranes[STAGES - 1];
        let mut branches = vec![0.0; at.l1.len()];
        for branch in &self.branches {
            branch.add_energy(&at.l1, &at.l2, &mut branches);
        }
        let (mut elastic, mut viscous) = (0.0, 0.0);
        for (j, branches) in branches.iter().enumerate() {
            let volume = operator.weights[j] * operator.rho[j];
            // A state that was solved lies within the law's domain.
            elastic += volume * self.sheet.law().energy(at.l1[j], at.l2[j]).unwrap_or(f64::NAN);
            viscous += volume * branches;
        }
        let scale = self.energy_scale_j();
        StoredEnergy {
            kinetic_j: 0.5 * self.parameters.spec().mass_kg * self.motion.v_m_per_s.powi(2),
            elastic_j: scale * elastic,
            branches_j: scale * viscous,
            electrical_j: 0.5 * self.capacitance_f() * self.motion.voltage_v.powi(2),
        }
    }

    /// Energy that has passed since the twin was last put at rest; nothing for [`Circuit::ConstantRc`], which is no circuit of
    /// charges and keeps no account.
    #[must_use]
    pub fn flow(&self) -> Option<EnergyFlow> {
        match self.setup.circuit {
            Circuit::ConstantRc => None,
            Circuit::Deformable { .. } => Some(self.flow),
        }
    }

    /// Energy of a density mu over the unit of volume inside, 2 pi H B^2, J.
    fn energy_scale_j(&self) -> f64 {
        self.modulus_factor * self.sheet.force_scale_n() * self.sheet.length_scale_m()
    }
}

/// What the steps since the twin was last put at rest have taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FieldEffort {
    /// Steps, each half of a halved one counted.
    pub steps: usize,
    /// Steps that failed and were halved.
    pub halved: usize,
    /// Sweeps over the three stages of a step.
    pub sweeps: usize,
    /// Newton steps of the membrane, with new or old factors.
    pub iterations: usize,
    /// Factorizations among them.
    pub factorizations: usize,
}

/// Solves that bring the plate to rest on its contact; Newton on a monotone balance takes about six.
const MAX_SETTLING: usize = 50;
/// Correction at which the plate counts as at rest, over B.
const SETTLED: f64 = 1e-13;

fn require(holds: bool, key: &'static str, allowed: &'static str, found: f64) -> Result<(), Error> {
    if holds { Ok(()) } else { Err(Error::Parameter { key, allowed, found }) }
}
