//! The viscoelastic membrane in motion at field level: every node carries its own dashpots. Slow, and the judge of the
//! reduced twin.

use crate::membrane::{DashpotRates, Dashpots, Equilibrium, Load, Membrane};
use crate::{ActuatorParameters, Error};

/// The actuator in motion with dashpots at every collocation node.
///
/// **Method**: the membrane is in equilibrium at all times (its own inertia is left out; first mode about 120 Hz), plate
/// and dashpots are integrated by classical Runge-Kutta with one membrane solve for each stage; the circuit is exact.
///
/// **Source**: branches by Foo, Cai, Koh, Bauer, Suo 2012.
#[derive(Debug, Clone)]
pub struct FieldTwin {
    membrane: Membrane,
    dashpots: Dashpots,
    state: Equilibrium,
    rest_sag_m: f64,
    x: f64,
    v: f64,
    membrane_v: f64,
}

#[derive(Debug, Clone)]
struct Rate {
    x: f64,
    v: f64,
    dashpots: DashpotRates,
}

impl FieldTwin {
    /// At rest under its load at zero voltage, all branches relaxed, with `degree + 1` nodes.
    ///
    /// # Errors
    /// Those of [`Membrane::with_degree`] and [`Membrane::solve`].
    pub fn new(parameters: &ActuatorParameters, degree: usize) -> Result<Self, Error> {
        let membrane = Membrane::with_degree(parameters, degree)?;
        let state = membrane.rest(0.0)?;
        let dashpots = Dashpots::relaxed_at(&membrane, &state);
        let x = state.displacement_m();
        Ok(Self { membrane, dashpots, state, rest_sag_m: x, x, v: 0.0, membrane_v: 0.0 })
    }

    /// One step of `step_s` with the drive voltage held.
    ///
    /// # Errors
    /// Those of [`Membrane::solve`].
    pub fn step(&mut self, step_s: f64, drive_v: f64) -> Result<(), Error> {
        let h = step_s;
        let half_decay = (-0.5 * h / self.membrane.parameters().spec().rc_s).exp();
        let v_half = drive_v + (self.membrane_v - drive_v) * half_decay;
        let v_end = drive_v + (v_half - drive_v) * half_decay;
        let start = (self.x, self.v, self.dashpots.clone());
        let k1 = self.rate(&start, None, 0.0, self.membrane_v)?;
        let k2 = self.rate(&start, Some(&k1), 0.5 * h, v_half)?;
        let k3 = self.rate(&start, Some(&k2), 0.5 * h, v_half)?;
        let k4 = self.rate(&start, Some(&k3), h, v_end)?;
        for (rate, weight) in [(&k1, 1.0), (&k2, 2.0), (&k3, 2.0), (&k4, 1.0)] {
            self.x += weight * h / 6.0 * rate.x;
            self.v += weight * h / 6.0 * rate.v;
            self.dashpots.advance(&rate.dashpots, weight * h / 6.0);
        }
        self.membrane_v = v_end;
        Ok(())
    }

    fn rate(
        &mut self,
        start: &(f64, f64, Dashpots),
        along: Option<&Rate>,
        h: f64,
        voltage_v: f64,
    ) -> Result<Rate, Error> {
        let (mut x, mut v, mut dashpots) = start.clone();
        if let Some(rate) = along {
            x += h * rate.x;
            v += h * rate.v;
            dashpots.advance(&rate.dashpots, h);
        }
        self.state = self.membrane.solve_near(&self.state, Load::DisplacementM(x), voltage_v, &dashpots)?;
        let spec = self.membrane.parameters().spec();
        let force = self.membrane.parameters().weight_n() - self.state.force_n() - spec.damping_n_s_per_m * v;
        Ok(Rate { x: v, v: force / spec.mass_kg, dashpots: dashpots.rates(&self.membrane, &self.state) })
    }

    /// Displacement from the rest position, mm, positive down.
    #[must_use]
    pub fn displacement_mm(&self) -> f64 {
        (self.x - self.rest_sag_m) * 1e3
    }
}
