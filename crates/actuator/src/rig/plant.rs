//! A device that follows the time of a run: the reduced twin or the field-level model.

use telepulse_rt::MonotonicNs;

use super::{ForceStep, RigConditions};
use crate::field::{FieldSetup, FieldTwin, PlateContact};
use crate::statics::{Electrodes, Load, StaticSolver};
use crate::twin::{Contact, ContactLaw, Fidelity, Inputs, PlateLoad, Twin, TwinModel};
use crate::{ActuatorParameters, Error};

/// Longest gap between two calls that a rig bridges, s: a bound on the work of one call.
const MAX_GAP_S: f64 = 3600.0;
/// Nodes less one of the field-level model.
const FIELD_DEGREE: usize = 16;

/// Why the device could not be brought to a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PlantFault {
    /// Time went backwards, or too far ahead.
    NotAhead,
    /// The membrane has no equilibrium there; [`Plant::fault`] knows more.
    NoEquilibrium,
}

/// What moves.
#[derive(Debug, Clone)]
enum Body {
    Reduced(Box<Twin>),
    Field(Box<FieldBody>),
}

/// The field-level model, measured from the rest position of the device under its own load.
#[derive(Debug, Clone)]
struct FieldBody {
    twin: FieldTwin,
    parameters: ActuatorParameters,
    /// Rest position of the field-level model, which may carry another load, below that of the device, mm.
    origin_mm: f64,
}

/// A device with its clock, the held drive voltage and the disturbance.
#[derive(Debug, Clone)]
pub(super) struct Plant {
    body: Body,
    now: MonotonicNs,
    drive_v: f64,
    disturbance: Option<ForceStep>,
    fault: Option<Error>,
}

impl Plant {
    /// The device of `model` under a load, settled under the bias of the conditions, at their fidelity.
    pub(super) fn new(model: &TwinModel, load: PlateLoad, conditions: &RigConditions) -> Result<Self, Error> {
        let full_scale = model.parameters().spec().full_scale_v;
        let bias = conditions.initial_bias_v;
        if !(bias >= 0.0 && bias <= full_scale) {
            return Err(Error::Request {
                quantity: "initial_bias_v",
                allowed: "between 0 and full scale",
                found: bias,
            });
        }
        if let Some(step) = conditions.disturbance {
            for (quantity, found) in
                [("disturbance force_n", step.force_n), ("disturbance start_s", step.start_s)]
            {
                if !found.is_finite() {
                    return Err(Error::Request { quantity, allowed: "finite", found });
                }
            }
        }
        let body = match conditions.fidelity {
            Fidelity::Reduced => {
                let mut twin = Box::new(Twin::with_load(model, load));
                twin.settle(bias);
                Body::Reduced(twin)
            }
            Fidelity::Field => {
                let mut body = Box::new(FieldBody::new(model, load)?);
                body.twin.settle(bias)?;
                Body::Field(body)
            }
        };
        let disturbance = conditions.disturbance;
        Ok(Self { body, now: MonotonicNs(0), drive_v: bias, disturbance, fault: None })
    }

    /// Seconds from the time reached to `now`, which may lie neither behind nor too far ahead.
    pub(super) fn require_ahead(&self, now: MonotonicNs) -> Result<f64, PlantFault> {
        let gap_ns = now.0.checked_sub(self.now.0).ok_or(PlantFault::NotAhead)?;
        let duration = gap_ns as f64 * 1e-9;
        if duration <= MAX_GAP_S { Ok(duration) } else { Err(PlantFault::NotAhead) }
    }

    /// Integrates up to `now` with the held voltage; a disturbance that sets in between splits the interval there.
    pub(super) fn advance_to(&mut self, now: MonotonicNs) -> Result<(), PlantFault> {
        let duration = self.require_ahead(now)?;
        let before =
            self.disturbance.map_or(duration, |step| step.start_s - self.now.seconds()).clamp(0.0, duration);
        let force = self.disturbance.map_or(0.0, |step| step.force_n);
        self.advance(before, 0.0)?;
        self.advance(duration - before, force)?;
        self.now = now;
        Ok(())
    }

    fn advance(&mut self, duration_s: f64, disturbance_n: f64) -> Result<(), PlantFault> {
        let drive_v = self.drive_v;
        match &mut self.body {
            Body::Reduced(twin) => {
                twin.advance(duration_s, Inputs { drive_v, disturbance_n });
                Ok(())
            }
            Body::Field(body) => body.advance(duration_s, drive_v, disturbance_n).map_err(|error| {
                self.fault.get_or_insert(error);
                PlantFault::NoEquilibrium
            }),
        }
    }

    /// Commands `drive_v` from `now` on.
    pub(super) fn drive(&mut self, now: MonotonicNs, drive_v: f64) -> Result<(), PlantFault> {
        self.advance_to(now)?;
        self.drive_v = drive_v;
        // A step of no length puts the voltage on the amplifier, so that current and power see it at once.
        self.advance(0.0, 0.0)
    }

    /// Time that the device has reached.
    pub(super) fn now(&self) -> MonotonicNs {
        self.now
    }

    /// Starts the clock anew where the device stands.
    pub(super) fn restart_clock(&mut self) {
        self.now = MonotonicNs(0);
    }

    /// Takes the disturbance off until [`Plant::disturb`] puts it back.
    pub(super) fn undisturbed(&mut self) -> Option<ForceStep> {
        self.disturbance.take()
    }

    /// Lets this disturbance act.
    pub(super) fn disturb(&mut self, disturbance: Option<ForceStep>) {
        self.disturbance = disturbance;
    }

    /// The first refusal of the membrane, after which nothing moves any more.
    pub(super) fn fault(&self) -> Option<&Error> {
        self.fault.as_ref()
    }

    /// Displacement from the rest position under the weight, mm, positive down.
    pub(super) fn displacement_mm(&self) -> f64 {
        match &self.body {
            Body::Reduced(twin) => twin.displacement_mm(),
            Body::Field(body) => body.twin.displacement_mm() + body.origin_mm,
        }
    }

    /// Voltage across the membrane, V.
    pub(super) fn membrane_voltage_v(&self) -> f64 {
        match &self.body {
            Body::Reduced(twin) => twin.membrane_voltage_v(),
            Body::Field(body) => body.twin.membrane_voltage_v(),
        }
    }

    /// Charge on the membrane, C.
    pub(super) fn charge_c(&self) -> f64 {
        match &self.body {
            Body::Reduced(twin) => {
                let voltage_v = twin.membrane_voltage_v();
                twin.model().capacitance_f(twin.displacement_mm(), voltage_v) * voltage_v
            }
            Body::Field(body) => body.twin.capacitance_f() * body.twin.membrane_voltage_v(),
        }
    }

    /// Compressive force between plate and contact, N.
    pub(super) fn contact_force_n(&self) -> f64 {
        match &self.body {
            Body::Reduced(twin) => twin.contact_force_n(),
            Body::Field(body) => body.twin.contact_force_n(),
        }
    }

    /// Power from the amplifier, W; current that flows back counts as zero.
    pub(super) fn supply_power_w(&self) -> f64 {
        match &self.body {
            Body::Reduced(twin) => twin.supply_power_w(),
            Body::Field(body) => body.supply_power_w(self.drive_v),
        }
    }

    /// True once a reduced twin has left the range of its maps; the field-level model has none.
    pub(super) fn has_left_map(&self) -> bool {
        match &self.body {
            Body::Reduced(twin) => twin.has_left_map(),
            Body::Field(_) => false,
        }
    }
}

/// The same contact, measured from the rest position of the field-level model.
fn field_contact(contact: Contact, origin_mm: f64) -> PlateContact {
    let touch_mm = contact.touch_mm - origin_mm;
    match contact.law {
        ContactLaw::SpringDamper { stiffness_n_per_m, damping_n_s_per_m } => {
            PlateContact::SpringDamper { stiffness_n_per_m, damping_n_s_per_m, touch_mm }
        }
        ContactLaw::HuntCrossley { stiffness_n_per_m_p, exponent, dissipation_s_per_m } => {
            PlateContact::HuntCrossley { stiffness_n_per_m_p, exponent, dissipation_s_per_m, touch_mm }
        }
    }
}

impl FieldBody {
    fn new(model: &TwinModel, load: PlateLoad) -> Result<Self, Error> {
        let mut spec = model.parameters().spec().clone();
        spec.mass_kg = load.mass_kg;
        let parameters = ActuatorParameters::new(spec)?;
        let mut solver = StaticSolver::with_degree(&parameters.sheet()?, FIELD_DEGREE)?;
        let free = solver.solve(Load::ForceN(parameters.weight_n()), Electrodes::VoltageV(0.0))?;
        let origin_mm = (free.displacement_m - model.rest_sag_m()) * 1e3;
        let mut setup = FieldSetup::plain(&parameters);
        setup.contact = load.contact.map(|contact| field_contact(contact, origin_mm));
        let twin = FieldTwin::with_setup(&parameters, FIELD_DEGREE, setup)?;
        Ok(Self { twin, parameters, origin_mm })
    }

    fn advance(&mut self, duration_s: f64, drive_v: f64, disturbance_n: f64) -> Result<(), Error> {
        if duration_s <= 0.0 {
            return Ok(());
        }
        // A thousandth of a step of slack keeps a rounded tick from costing one more step.
        let n_steps = (duration_s / Fidelity::Field.usual_step_s() - 1e-3).ceil().max(1.0);
        for _ in 0..n_steps as u64 {
            self.twin.step_with(duration_s / n_steps, drive_v, disturbance_n)?;
        }
        Ok(())
    }

    fn supply_power_w(&self, drive_v: f64) -> f64 {
        let spec = self.parameters.spec();
        let charging = self.twin.capacitance_f() * (drive_v - self.twin.membrane_voltage_v()) / spec.rc_s;
        drive_v * (charging + drive_v / spec.leak_resistance_ohm).max(0.0)
    }
}
