//! Solving for a load and a voltage with the dashpots held.

use super::dashpots::BranchedLaw;
use super::{Dashpots, Equilibrium, Load, Membrane};
use crate::Error;
use crate::statics::{Electrodes, SlackStates};

impl Membrane {
    /// Equilibrium of the relaxed membrane with the plate at `displacement_m`.
    ///
    /// # Errors
    /// See [`Membrane::solve`].
    pub fn solve_at_displacement(&self, displacement_m: f64, voltage_v: f64) -> Result<Equilibrium, Error> {
        self.solve(Load::DisplacementM(displacement_m), voltage_v, &Dashpots::absent())
    }

    /// Stable equilibrium of the relaxed membrane that carries `force_n`.
    ///
    /// # Errors
    /// See [`Membrane::solve`].
    pub fn solve_at_force(&self, force_n: f64, voltage_v: f64) -> Result<Equilibrium, Error> {
        self.solve(Load::ForceN(force_n), voltage_v, &Dashpots::absent())
    }

    /// Stable relaxed equilibrium under the weight of plate and load.
    ///
    /// # Errors
    /// See [`Membrane::solve`].
    pub fn rest(&self, voltage_v: f64) -> Result<Equilibrium, Error> {
        self.solve_at_force(self.parameters().weight_n(), voltage_v)
    }

    /// Equilibrium at a load and a voltage, with the branches' dashpots held where `dashpots` says.
    ///
    /// **Accuracy**: see [`Membrane`]. A slack state is returned, not refused ([`Equilibrium::require_taut`]): the
    /// membrane equations still hold there, but a real membrane wrinkles.
    ///
    /// # Errors
    /// Those of [`StaticSolver::solve_even_slack`](crate::statics::StaticSolver::solve_even_slack).
    pub fn solve(&self, load: Load, voltage_v: f64, dashpots: &Dashpots) -> Result<Equilibrium, Error> {
        let mut solver = self.solver.clone();
        let law = self.law(dashpots);
        let electrodes = Electrodes::VoltageV(voltage_v);
        let point = solver.solve_with(&law, load, electrodes, SlackStates::Returned)?;
        Equilibrium::of(&solver, point)
    }

    /// Equilibrium near a known one: Newton from its shape, and [`Membrane::solve`] where that fails.
    ///
    /// # Errors
    /// See [`Membrane::solve`].
    pub fn solve_near(
        &self,
        known: &Equilibrium,
        load: Load,
        voltage_v: f64,
        dashpots: &Dashpots,
    ) -> Result<Equilibrium, Error> {
        let mut solver = self.solver.clone();
        let law = self.law(dashpots);
        solver.resume(known.state(), known.point());
        let electrodes = Electrodes::VoltageV(voltage_v);
        let point = solver.solve_near_with(&law, load, electrodes, SlackStates::Returned)?;
        Equilibrium::of(&solver, point)
    }

    pub(super) fn law<'a>(&'a self, dashpots: &'a Dashpots) -> BranchedLaw<'a> {
        BranchedLaw { network: self.sheet().law(), dashpots }
    }
}
