//! Small signals about a bias voltage.

use nalgebra::DMatrix;
use telepulse_lti::{Continuous, StateSpace};

use crate::membrane::{Dashpots, Membrane, Sensitivity, Tangent};
use crate::{ActuatorParameters, Error};

/// The actuator linearised at rest under its load at a bias voltage, branches relaxed there.
///
/// **Shapes and units**: `system` has one input, the drive in units of full scale, and one output, the displacement in mm.
/// Its states are displacement (mm), velocity (mm/s), membrane voltage (unit) and two dashpot coordinates (m^1.5) for each
/// branch.
#[derive(Debug, Clone, PartialEq)]
pub struct Linearization {
    /// Drive (unit) to displacement (mm).
    pub system: StateSpace<Continuous>,
    /// Bias, V.
    pub bias_v: f64,
    /// Displacement at the bias from the rest position at zero voltage, mm.
    pub displacement_mm: f64,
    /// Derivatives of the force with all branches relaxed.
    pub relaxed: Tangent,
    /// Derivatives of the force with all branches frozen.
    pub frozen: Tangent,
    /// f1 of (11): -(1/m) dF/dx with frozen branches, 1/s^2.
    pub f1_per_s2: f64,
    /// f2 of (12): -c/m; branches add states, not f2. 1/s.
    pub f2_per_s: f64,
    /// f3 of (13): -(1/m) dF/dPhi with frozen branches, m/(s^2 V).
    pub f3_m_per_s2_v: f64,
}

/// Linearises the actuator at `bias_v`.
///
/// **Method**: derivatives of F(x, Phi) by implicit differentiation. The strains that the branches see are projected on two
/// coordinates: E_0 along the difference between the frozen and the relaxed response, with an internal amplitude `a` that
/// is in balance at all times, and E_1 along the rest of the response to displacement. What lies beyond them does no work
/// on the plate.
/// ```text
/// m x'' = -k x - F_Phi Phi - sum_i mu_i sum_k g_k (E_k - zeta_ik) - c x'      zeta_ik' = (E_k - zeta_ik)/tau_i
/// E_0 = g_0 x + h_0 Phi + a,  E_1 = g_1 x + h_1 Phi,  0 = K a + sum_i mu_i (E_0 - zeta_i0),  Phi' = (u - Phi)/(R_s C)
/// ```
///
/// **Source**: Eq. (10)-(14) with the corrections listed in `docs/paper.md`.
///
/// **Accuracy**: exact where all branches are frozen or all relaxed; between, the shape of the membrane has one internal
/// amplitude and not a continuum.
///
/// **Errors**: [`Error::ZeroBias`] at zero bias, where the input gain vanishes; those of [`Membrane::solve`];
/// [`Error::Slack`].
///
/// **Example**
/// ```
/// use telepulse_actuator::{ParameterSet, linearize::linearize};
/// let at_half_scale = linearize(&ParameterSet::C.parameters(), 2500.0)?;
/// assert!((at_half_scale.f1_per_s2 + 1444.00).abs() < 0.005);
/// # Ok::<(), telepulse_actuator::Error>(())
/// ```
pub fn linearize(parameters: &ActuatorParameters, bias_v: f64) -> Result<Linearization, Error> {
    if bias_v == 0.0 {
        return Err(Error::ZeroBias { bias_v });
    }
    let membrane = Membrane::new(parameters)?;
    let rest = membrane.rest(0.0)?;
    let state = membrane.rest(bias_v)?;
    state.require_taut()?;
    let relaxed = membrane.sensitivity(&state, &Dashpots::absent())?;
    let frozen = membrane.sensitivity(&state, &Dashpots::relaxed_at(&membrane, &state))?;
    let spec = parameters.spec();
    Ok(Linearization {
        system: assemble(parameters, bias_v, &relaxed, &frozen)?,
        bias_v,
        displacement_mm: (state.displacement_m() - rest.displacement_m()) * 1e3,
        f1_per_s2: -frozen.tangent.stiffness_n_per_m / spec.mass_kg,
        f2_per_s: -spec.damping_n_s_per_m / spec.mass_kg,
        f3_m_per_s2_v: -frozen.tangent.dforce_dvoltage_n_per_v / spec.mass_kg,
        relaxed: relaxed.tangent,
        frozen: frozen.tangent,
    })
}

/// How the branches' strain coordinates E_0, E_1 follow displacement and voltage.
struct StrainPath {
    /// g: by displacement, m^1.5 per mm.
    by_displacement: [f64; 2],
    /// h: by voltage, m^1.5 per unit.
    by_voltage: [f64; 2],
    /// m/(K + m), m the sum of the branch moduli: the part of E_0 that the internal amplitude takes back.
    yielding: f64,
}

/// Projects the strains; with `delta` = frozen minus relaxed response, K = -m (<e, delta>/<delta, delta> + 1).
fn strain_path(relaxed: &Sensitivity, frozen: &Sensitivity, units_per_v2: f64) -> StrainPath {
    let response = &relaxed.strain_by_displacement;
    let delta = &frozen.strain_by_displacement - response;
    let length = delta.norm();
    let internal = if length > 0.0 { &delta / length } else { delta.clone() };
    let along = internal.dot(response);
    let across = response - &internal * along;
    let across_length = across.norm();
    let other = if across_length > 0.0 { across / across_length } else { across };
    let by_v2 = &relaxed.strain_by_voltage_squared;
    StrainPath {
        by_displacement: [along * 1e-3, across_length * 1e-3],
        by_voltage: [internal.dot(by_v2) * units_per_v2, other.dot(by_v2) * units_per_v2],
        // K + m = -m <e, delta>/<delta, delta> = -m along/length.
        yielding: if along < 0.0 { -length / along } else { 0.0 },
    }
}

fn assemble(
    parameters: &ActuatorParameters,
    bias_v: f64,
    relaxed: &Sensitivity,
    frozen: &Sensitivity,
) -> Result<StateSpace<Continuous>, Error> {
    let spec = parameters.spec();
    let mass = spec.mass_kg;
    let path = strain_path(relaxed, frozen, 2.0 * bias_v * spec.full_scale_v);
    let modulus = parameters.branch_modulus_pa();
    // Displacement in mm, voltage in units, forces in N; work in J = N m is 1e3 N mm.
    let force_to_mm_per_s2 = 1e3 / mass;
    let branch_force = 1e3;
    let n_states = 3 + 2 * spec.branches.len();
    let mut a = DMatrix::zeros(n_states, n_states);
    a[(0, 1)] = 1.0;
    a[(1, 0)] = -force_to_mm_per_s2 * relaxed.tangent.stiffness_n_per_m * 1e-3;
    a[(1, 1)] = -spec.damping_n_s_per_m / mass;
    a[(1, 2)] = -force_to_mm_per_s2 * relaxed.tangent.dforce_dvoltage_n_per_v * spec.full_scale_v;
    a[(2, 2)] = -1.0 / spec.rc_s;
    // Rows of E_0 and E_1 over the states.
    let mut strain = DMatrix::zeros(2, n_states);
    for k in 0..2 {
        let kept = if k == 0 { 1.0 - path.yielding } else { 1.0 };
        strain[(k, 0)] = kept * path.by_displacement[k];
        strain[(k, 2)] = kept * path.by_voltage[k];
    }
    for (idx, branch) in spec.branches.iter().enumerate() {
        strain[(0, 3 + 2 * idx)] = path.yielding * branch.modulus_pa / modulus;
    }
    for (idx, branch) in spec.branches.iter().enumerate() {
        for k in 0..2 {
            let dashpot = 3 + 2 * idx + k;
            let mut stretch = strain.row(k).into_owned();
            stretch[dashpot] -= 1.0;
            let force = force_to_mm_per_s2 * branch_force * branch.modulus_pa * path.by_displacement[k];
            let mut velocity_row = a.row_mut(1);
            velocity_row -= &stretch * force;
            let mut dashpot_row = a.row_mut(dashpot);
            dashpot_row += &stretch / branch.relaxation_time_s;
        }
    }
    let mut b = DMatrix::zeros(n_states, 1);
    b[(2, 0)] = 1.0 / spec.rc_s;
    let mut c = DMatrix::zeros(1, n_states);
    c[(0, 0)] = 1.0;
    Ok(StateSpace::<Continuous>::new(a, b, c, DMatrix::zeros(1, 1))?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ParameterSet;

    #[test]
    fn paper_eq16_set_c_is_the_identified_plant() {
        let linear = linearize(&ParameterSet::C.parameters(), 2500.0).expect("taut");
        // C was fitted to (16) and its inputs are given to five digits: 2e-4 relative.
        let omega_rc = 1.0 / 0.0045;
        for hz in [0.0, 0.1, 1.0, 4.0, 6.0, 9.0, 13.0] {
            let s = nalgebra::Complex::new(0.0, 2.0 * std::f64::consts::PI * hz);
            let printed = 1350.14 / ((s / omega_rc + 1.0) * (s * s + s * 15.96 + 1444.0));
            let found = linear.system.at(s.im).expect("no pole on the axis")[(0, 0)];
            assert!((found - printed).norm() < 2e-4 * printed.norm(), "{hz} Hz: {found} {printed}");
        }
    }

    #[test]
    fn paper_eq16_set_a_stays_within_its_stated_ratio_from_0_1_to_13_hz() {
        let linear = linearize(&ParameterSet::A.parameters(), 2500.0).expect("taut");
        for idx in 0..=60 {
            let hz = 0.1 * 130.0_f64.powf(f64::from(idx) / 60.0);
            let s = nalgebra::Complex::new(0.0, 2.0 * std::f64::consts::PI * hz);
            let printed = 1350.14 / ((s * 0.0045 + 1.0) * (s * s + s * 15.96 + 1444.0));
            let found = linear.system.at(s.im).expect("no pole on the axis")[(0, 0)];
            let ratio = found.norm() / printed.norm();
            // Full field at small signals: 0.998-1.012, printed to three digits.
            assert!((0.9975..=1.0125).contains(&ratio), "{hz} Hz: ratio {ratio}");
        }
    }

    #[test]
    fn law_dc_gain_is_the_relaxed_gain_and_the_system_is_stable() {
        for set in [ParameterSet::A, ParameterSet::B, ParameterSet::C] {
            let linear = linearize(&set.parameters(), 2500.0).expect("taut");
            assert!(linear.system.is_stable().expect("finite"), "{set:?}");
            let dc = linear.system.dc_gain().expect("no integrator")[(0, 0)];
            let relaxed = linear.relaxed.gain_m_per_v() * 1e3 * 5000.0;
            assert!((dc - relaxed).abs() < 1e-9, "{set:?}: {dc} {relaxed}");
        }
    }

    #[test]
    fn edge_zero_bias_is_refused_with_the_reason() {
        let error = linearize(&ParameterSet::A.parameters(), 0.0).expect_err("no gain at zero bias");
        assert_eq!(error, Error::ZeroBias { bias_v: 0.0 });
        assert!(error.to_string().contains("positive bias"));
    }
}
