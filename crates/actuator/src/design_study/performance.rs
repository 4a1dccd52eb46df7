//! Stroke and bandwidth of one variant at the largest voltage that keeps its margins.

use super::DesignVariable;
use super::space::varied;
use crate::frequency::MembraneResponse;
use crate::statics::{Electrodes, Load, StaticPoint, StaticSolver};
use crate::{ActuatorParameters, Error};

/// How close to failure a design may come.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StudyLimits {
    /// Largest voltage of the amplifier, V.
    pub amplifier_v: f64,
    /// Largest true field allowed in use, V/m: breakdown strength over the safety factor of whoever asks.
    pub field_v_per_m: f64,
    /// The membrane must still be in stable, taut equilibrium at this multiple of the voltage in use; at least 1.
    pub voltage_margin: f64,
}

impl StudyLimits {
    /// Checks the three numbers.
    ///
    /// # Errors
    /// [`Error::Parameter`].
    pub fn check(&self) -> Result<(), Error> {
        let positive = [("amplifier_v", self.amplifier_v), ("field_v_per_m", self.field_v_per_m)];
        for (key, found) in positive {
            if !(found.is_finite() && found > 0.0) {
                return Err(Error::Parameter { key, allowed: "finite and positive", found });
            }
        }
        let (key, found) = ("voltage_margin", self.voltage_margin);
        if !(found.is_finite() && found >= 1.0) {
            let allowed = "at least 1: below, the membrane fails in use";
            return Err(Error::Parameter { key, allowed, found });
        }
        Ok(())
    }
}

/// What keeps the voltage of a design from being higher.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EndOfStroke {
    /// The amplifier has no more.
    Amplifier,
    /// The true field.
    Field,
    /// The hoop or meridional stress vanishes: wrinkles.
    LossOfTension,
    /// Limit point under the dead load, or pull-in of the material.
    Instability,
    /// The chain limit of the material.
    ChainLimit,
}

impl EndOfStroke {
    /// Name as in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Amplifier => "amplifier",
            Self::Field => "field",
            Self::LossOfTension => "loss_of_tension",
            Self::Instability => "instability",
            Self::ChainLimit => "chain_limit",
        }
    }

    fn of(error: &Error) -> Option<Self> {
        match error {
            Error::Slack { .. } => Some(Self::LossOfTension),
            Error::BeyondLimitPoint { .. } | Error::PullIn { .. } => Some(Self::Instability),
            Error::GentLimit { .. } => Some(Self::ChainLimit),
            _ => None,
        }
    }
}

/// What one variant can do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Performance {
    /// Largest voltage that keeps all margins, V.
    pub voltage_v: f64,
    /// What ends it there.
    pub ended_by: EndOfStroke,
    /// Displacement between rest at zero voltage and at that voltage, branches relaxed, mm.
    pub stroke_mm: f64,
    /// Frequency at which the small-signal response about half of that voltage squared has fallen by 3 dB from its slow
    /// value, Hz; at most 100.
    pub bandwidth_hz: f64,
    /// Largest true field in use, V/m.
    pub field_v_per_m: f64,
    /// Smallest nominal stress at that voltage, Pa.
    pub tension_min_pa: f64,
    /// Sag under the load at zero voltage, mm.
    pub sag_mm: f64,
    /// Time constant of amplifier and membrane, s.
    pub rc_s: f64,
}

/// Resistance in series with the membrane of `base`, ohm: that design's time constant over its capacitance at rest.
///
/// # Errors
/// Those of [`StaticSolver::solve`] at zero voltage.
pub fn source_resistance_ohm(base: &ActuatorParameters) -> Result<f64, Error> {
    let mut solver = StaticSolver::new(&base.sheet()?)?;
    let rest = solver.solve(Load::ForceN(base.weight_n()), Electrodes::VoltageV(0.0))?;
    Ok(base.spec().rc_s / rest.capacitance_f)
}

/// Halvings of the voltage interval: 1e-6 of the amplifier's voltage.
const HALVINGS: usize = 20;

/// Stroke and bandwidth of the variant of `base` in which `variables` have the values `variant`.
///
/// **Method**: bisection for the largest voltage at which the field is allowed and a taut, stable equilibrium exists at
/// `voltage_margin` times it; solves start from their neighbours. The time constant is `source_ohm` times the variant's own
/// capacitance; the damping on the plate is the base's.
///
/// **Accuracy**: checks on the axisymmetric equilibrium alone; failure in motion (overshoot, rates) is not looked at.
///
/// # Errors
/// [`Error::Parameter`] for a geometry that is none; those of [`StaticSolver::solve`] where the load is not borne at zero
/// voltage, and [`Error::Request`] where a margin is already used up there.
///
/// **Example**
/// ```
/// use telepulse_actuator::ParameterSet;
/// use telepulse_actuator::design_study::{StudyLimits, evaluate, source_resistance_ohm};
/// let base = ParameterSet::A.parameters();
/// let limits = StudyLimits { amplifier_v: 5000.0, field_v_per_m: 30e6, voltage_margin: 1.5 };
/// let found = evaluate(&base, &[], &[], limits, source_resistance_ohm(&base)?)?;
/// // Nothing but the amplifier limits the paper's device: the relaxed stroke at 5 kV.
/// assert!((found.stroke_mm - 1.047_193).abs() < 1e-5);
/// # Ok::<(), telepulse_actuator::Error>(())
/// ```
pub fn evaluate(
    base: &ActuatorParameters,
    variables: &[DesignVariable],
    variant: &[f64],
    limits: StudyLimits,
    source_ohm: f64,
) -> Result<Performance, Error> {
    limits.check()?;
    let parameters = varied(base, variables, variant)?;
    let mut membrane = Loaded::new(&parameters)?;
    let rest = membrane.rest;
    let (voltage_v, ended_by) = membrane.largest_voltage(limits)?;
    let point = membrane.at(voltage_v)?;
    let mut spec = parameters.spec().clone();
    spec.rc_s = source_ohm * rest.capacitance_f;
    let rc_s = spec.rc_s;
    // The middle of the stroke is near half the voltage squared.
    let bandwidth_hz =
        bandwidth_hz(&ActuatorParameters::new(spec)?, voltage_v * std::f64::consts::FRAC_1_SQRT_2)?;
    Ok(Performance {
        voltage_v,
        ended_by,
        stroke_mm: (point.displacement_m - rest.displacement_m) * 1e3,
        bandwidth_hz,
        field_v_per_m: point.field_max_v_per_m,
        tension_min_pa: point.s1_min_pa.min(point.s2_min_pa),
        sag_mm: rest.displacement_m * 1e3,
        rc_s,
    })
}

/// A membrane under its load.
struct Loaded {
    solver: StaticSolver,
    load: Load,
    rest: StaticPoint,
}

impl Loaded {
    fn new(parameters: &ActuatorParameters) -> Result<Self, Error> {
        let mut solver = StaticSolver::new(&parameters.sheet()?)?;
        let load = Load::ForceN(parameters.weight_n());
        let rest = solver.solve(load, Electrodes::VoltageV(0.0))?;
        Ok(Self { solver, load, rest })
    }

    fn at(&mut self, voltage_v: f64) -> Result<StaticPoint, Error> {
        self.solver.solve_near(self.load, Electrodes::VoltageV(voltage_v))
    }

    /// What forbids this voltage, if anything.
    fn forbidden(&mut self, voltage_v: f64, limits: StudyLimits) -> Result<Option<EndOfStroke>, Error> {
        for (voltage, field_v_per_m) in
            [(voltage_v, limits.field_v_per_m), (voltage_v * limits.voltage_margin, f64::INFINITY)]
        {
            match self.at(voltage) {
                Ok(point) if point.field_max_v_per_m > field_v_per_m => return Ok(Some(EndOfStroke::Field)),
                Ok(_) => {}
                Err(error) => return EndOfStroke::of(&error).map(Some).ok_or(error),
            }
        }
        Ok(None)
    }

    fn largest_voltage(&mut self, limits: StudyLimits) -> Result<(f64, EndOfStroke), Error> {
        let Some(mut ended_by) = self.forbidden(limits.amplifier_v, limits)? else {
            return Ok((limits.amplifier_v, EndOfStroke::Amplifier));
        };
        let (mut allowed, mut beyond) = (0.0, limits.amplifier_v);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (allowed + beyond);
            match self.forbidden(middle, limits)? {
                None => allowed = middle,
                Some(reason) => (beyond, ended_by) = (middle, reason),
            }
        }
        if allowed == 0.0 {
            let allowed = "such that some voltage keeps every margin";
            return Err(Error::Request { quantity: "voltage_v", allowed, found: beyond });
        }
        Ok((allowed, ended_by))
    }
}

/// Lowest and highest frequency looked at, Hz: beyond, the membrane's own inertia, which the model leaves out, counts.
const BAND_HZ: [f64; 2] = [0.05, 100.0];
/// Frequencies tried, in equal ratios of 1.13.
const N_FREQUENCIES: i32 = 64;

/// Highest frequency below which the response stays above its slow value by -3 dB, from a scan and a bisection; a dip counts
/// as its end.
fn bandwidth_hz(parameters: &ActuatorParameters, bias_v: f64) -> Result<f64, Error> {
    let response = MembraneResponse::new(parameters, bias_v)?;
    let gain = |hz: f64| {
        let response = response.displacement_mm_per_unit(2.0 * std::f64::consts::PI * hz);
        response.map(|value| value.norm())
    };
    let threshold = gain(BAND_HZ[0])? * std::f64::consts::FRAC_1_SQRT_2;
    let mut low = BAND_HZ[0];
    for idx in 1..=N_FREQUENCIES {
        let ratio = f64::from(idx) / f64::from(N_FREQUENCIES);
        let high = BAND_HZ[0] * (BAND_HZ[1] / BAND_HZ[0]).powf(ratio);
        if gain(high)? < threshold {
            let mut bracket = [low, high];
            // The bracket of 12 % shrinks to 1e-6.
            for _ in 0..17 {
                let middle = (bracket[0] * bracket[1]).sqrt();
                bracket[usize::from(gain(middle)? < threshold)] = middle;
            }
            return Ok(bracket[0]);
        }
        low = high;
    }
    Ok(BAND_HZ[1])
}
