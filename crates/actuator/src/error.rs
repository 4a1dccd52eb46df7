//! Why a parameter set, a membrane state, a twin or a rig was refused.

use thiserror::Error;

/// What went wrong, with the values that show it.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum Error {
    /// A parameter lies outside of its allowed range.
    #[error("parameter `{key}` must be {allowed}, found {found}")]
    Parameter {
        /// Name of the parameter, as in files.
        key: &'static str,
        /// The allowed range in words.
        allowed: &'static str,
        /// What was given.
        found: f64,
    },
    /// More Maxwell branches than the twin has room for.
    #[error("at most {allowed} Maxwell branches are supported, found {found}")]
    TooManyBranches {
        /// The capacity.
        allowed: usize,
        /// How many were given.
        found: usize,
    },
    /// The collocation grid is too coarse or too large.
    #[error("collocation degree must lie between {min} and {max}, found {found}")]
    CollocationDegree {
        /// Smallest degree allowed.
        min: usize,
        /// Largest degree allowed.
        max: usize,
        /// What was asked for.
        found: usize,
    },
    /// A requested load, displacement or voltage is not a finite number, or the voltage is negative.
    #[error("requested {quantity} must be {allowed}, found {found}")]
    Request {
        /// Which quantity, with its unit.
        quantity: &'static str,
        /// The allowed range in words.
        allowed: &'static str,
        /// What was given.
        found: f64,
    },
    /// At dead load there is no stable equilibrium at this voltage and force.
    #[error(
        "no stable equilibrium at {voltage_v} V under {force_n} N: the limit point of the loading path lies near \
         {reached_voltage_v} V and {reached_force_n} N, where the stiffness has fallen to {stiffness_n_per_m} N/m"
    )]
    BeyondLimitPoint {
        /// Voltage asked for, V.
        voltage_v: f64,
        /// Force asked for, N.
        force_n: f64,
        /// Voltage of the last stable state on the path, V.
        reached_voltage_v: f64,
        /// Force of the last stable state on the path, N.
        reached_force_n: f64,
        /// Stiffness dF/dx of the last state on the path, N/m.
        stiffness_n_per_m: f64,
    },
    /// The material would have to stretch beyond its chain limit.
    #[error("stretch invariant I1 - 3 = {invariant} comes too close to the Gent limit {gent_limit}")]
    GentLimit {
        /// I1 - 3 of the last state on the path.
        invariant: f64,
        /// The Gent limit J.
        gent_limit: f64,
    },
    /// Newton's method stopped for no reason that the model knows of.
    #[error(
        "membrane equilibrium did not converge at {voltage_v} V: relative residual {residual} after {iterations} iterations"
    )]
    NotConverged {
        /// Voltage asked for, V.
        voltage_v: f64,
        /// Largest residual, relative to the shear modulus.
        residual: f64,
        /// Newton iterations spent.
        iterations: usize,
    },
    /// The Jacobian has no inverse.
    #[error("the membrane's tangent is singular at {voltage_v} V and {displacement_m} m")]
    SingularTangent {
        /// Voltage, V.
        voltage_v: f64,
        /// Displacement of the plate, m.
        displacement_m: f64,
    },
    /// The membrane would wrinkle: the hoop stress is not tensile everywhere.
    #[error(
        "the membrane is slack at {voltage_v} V and {displacement_m} m: smallest hoop stress {s2_min_pa} Pa"
    )]
    Slack {
        /// Voltage, V.
        voltage_v: f64,
        /// Displacement of the plate, m.
        displacement_m: f64,
        /// Smallest nominal hoop stress, Pa.
        s2_min_pa: f64,
    },
    /// The membrane would thin without bound: electromechanical pull-in of the material itself.
    #[error(
        "the membrane pulls in at {voltage_v} V and {displacement_m} m: beyond, the voltage thins it without bound \
         (smallest of the moduli ds1/dl1 and ds2/dl2 there: {modulus_min_pa} Pa)"
    )]
    PullIn {
        /// Voltage, V.
        voltage_v: f64,
        /// Displacement of the plate, m.
        displacement_m: f64,
        /// Smallest of ds1/dl1 and ds2/dl2 over the nodes, Pa.
        modulus_min_pa: f64,
    },
    /// A run went beyond all bounds.
    #[error("the plate's motion grew without bound within the {duration_s} s of the run")]
    Diverged {
        /// Length of the run, s.
        duration_s: f64,
    },
    /// Derivatives or fields were asked for where nothing has been solved.
    #[error("there is no equilibrium to look at: nothing has been solved, or the last solve failed")]
    NoEquilibrium,
    /// The search for a limit point ended without one.
    #[error(
        "no limit point under {force_n} N up to a displacement of {displacement_m} m: the voltage still rises at \
         {voltage_v} V"
    )]
    NoLimitPoint {
        /// Dead load, N.
        force_n: f64,
        /// Displacement at which the search ended, m.
        displacement_m: f64,
        /// Voltage there, V.
        voltage_v: f64,
    },
    /// A linearisation at zero bias was asked for.
    #[error(
        "the input gain is zero at a bias of {bias_v} V since force goes with voltage squared: linearise at a positive bias"
    )]
    ZeroBias {
        /// Bias asked for, V.
        bias_v: f64,
    },
    /// Records or free parameters of a calibration were refused, or its fit did not end.
    #[error(transparent)]
    Calibration(#[from] crate::calibration::Refusal),
    /// No breakdown law has this name.
    #[error(
        "breakdown law \"{found}\" is unknown, expected \"smirnov-2018\", \"huang-2012\" or \"koh-2011\""
    )]
    UnknownBreakdownLaw {
        /// The name.
        found: String,
    },
    /// No limit for the voltage follows: something has set in without voltage, or nothing ever does.
    #[error(
        "no voltage limit follows under {force_n} N: the membrane has failed without voltage, or never does"
    )]
    NoVoltageBorne {
        /// Dead load, N.
        force_n: f64,
    },
    /// No displacement inside the maps has the capacitance that was measured.
    #[error("capacitance {capacitance_f} F lies outside of the {min_f} to {max_f} F of the actuator's range")]
    CapacitanceOutOfRange {
        /// What was measured, F.
        capacitance_f: f64,
        /// Smallest of the range, F.
        min_f: f64,
        /// Largest of the range, F.
        max_f: f64,
    },
    /// A linear system could not be assembled.
    #[error("linearised actuator is not a valid system: {0}")]
    Lti(#[from] telepulse_lti::Error),
}
