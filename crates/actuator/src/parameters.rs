//! The numbers that describe one actuator, checked once.

use serde::{Deserialize, Serialize};

use crate::Error;
use crate::statics::{Material, Prestretch, Sheet, SheetSpec};

/// Vacuum permittivity, F/m. Source: CODATA 2018.
pub const VACUUM_PERMITTIVITY_F_PER_M: f64 = 8.854_187_812_8e-12;
/// Most Maxwell branches that the twin carries; its state has a fixed size so that a step never allocates.
pub const MAX_BRANCHES: usize = 4;

/// The twin's parameter sets.
///
/// **Accuracy**: A and C were fitted to the identified plant (16) at a bias of 2.5 kV, so agreement with (16) is no
/// evidence for the model. The permittivity of A is 20-25 % over published values; read it as a lumped coupling.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum ParameterSet {
    /// "Paper plant": viscoelastic, frozen stiffness and gain as in (16). The default.
    #[default]
    A,
    /// "Figure 9": fitted to the 2 mm step of figure 9; a stress plant.
    B,
    /// Elastic: the analytic test plant.
    C,
}

impl ParameterSet {
    /// The checked parameters of this set.
    #[must_use]
    pub fn parameters(self) -> ActuatorParameters {
        let shared = ActuatorSpec {
            mu_pa: 0.0,
            // Assumed in the fit of all three sets; the paper gives none.
            gent_limit: Some(110.0),
            branches: Vec::new(),
            relative_permittivity: 0.0,
            damping_n_s_per_m: 0.0,
            // Section 2: covering plate of radius 12.7 mm, frame opening of radius 68.58 mm (deformed radii).
            inner_radius_m: 0.0127,
            outer_radius_m: 0.068_58,
            // VHB 4910 is 1 mm thick as supplied; "stretched by 100 %" in both directions.
            thickness_m: 0.001,
            prestretch: 2.0,
            // Calibration weight of 0.1 kg, with which (16), omega_n = 38 rad/s, means 144.4 N/m.
            mass_kg: 0.1,
            // Standard gravity.
            gravity_m_per_s2: 9.806_65,
            // 1/(R_c C) as (14) uses it.
            rc_s: 0.0045,
            // Section 3: 5 kV is one unit.
            full_scale_v: 5000.0,
            // Table 1: power / mean(V^2) is 35-38 nS in all four rows; read as a resistor across the amplifier.
            leak_resistance_ohm: 27.4e6,
        };
        let branch =
            |modulus_pa: f64, relaxation_time_s: f64| MaxwellBranch { modulus_pa, relaxation_time_s };
        let spec = match self {
            // Fitted to (16) at 2.5 kV.
            Self::A => ActuatorSpec {
                mu_pa: 37_220.0,
                branches: vec![branch(26_060.0, 0.6074), branch(26_530.0, 6.56), branch(10_830.0, 61.25)],
                relative_permittivity: 5.80,
                damping_n_s_per_m: 1.589,
                ..shared
            },
            // Fitted to the step of figure 9.
            Self::B => ActuatorSpec {
                mu_pa: 24_180.0,
                branches: vec![branch(490_000.0, 0.0254), branch(33_200.0, 5.0)],
                relative_permittivity: 4.7,
                damping_n_s_per_m: 0.0,
                ..shared
            },
            // Fitted to (16) at 2.5 kV without viscoelasticity.
            Self::C => ActuatorSpec {
                mu_pa: 38_635.0,
                relative_permittivity: 6.0109,
                damping_n_s_per_m: 1.596,
                ..shared
            },
        };
        ActuatorParameters { spec }
    }
}

/// A Maxwell branch: a neo-Hookean spring in series with a dashpot, beside the elastic network.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaxwellBranch {
    /// Shear modulus, Pa.
    pub modulus_pa: f64,
    /// Relaxation time, s.
    pub relaxation_time_s: f64,
}

/// The numbers of an actuator as written in a file, unchecked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActuatorSpec {
    /// Shear modulus of the relaxed network, Pa.
    pub mu_pa: f64,
    /// Gent chain limit J of I1 - 3; absent for a neo-Hookean network.
    #[serde(default)]
    pub gent_limit: Option<f64>,
    /// Maxwell branches; may be empty.
    #[serde(default)]
    pub branches: Vec<MaxwellBranch>,
    /// Relative permittivity.
    pub relative_permittivity: f64,
    /// External viscous damping on the plate, N s/m.
    pub damping_n_s_per_m: f64,
    /// Radius of the plate, which is the membrane's deformed inner radius a, m.
    pub inner_radius_m: f64,
    /// Radius of the frame's opening, which is the membrane's deformed outer radius b, m.
    pub outer_radius_m: f64,
    /// Undeformed thickness H, m.
    pub thickness_m: f64,
    /// Equibiaxial pre-stretch lp: the undeformed radii are a/lp and b/lp.
    pub prestretch: f64,
    /// Mass of plate and load, kg.
    pub mass_kg: f64,
    /// Gravity, m/s^2.
    pub gravity_m_per_s2: f64,
    /// Time constant R_s C of the circuit, s.
    pub rc_s: f64,
    /// Voltage of one unit of drive, and the amplifier's upper limit, V.
    pub full_scale_v: f64,
    /// Leak resistance across the amplifier's output, ohm.
    pub leak_resistance_ohm: f64,
}

/// Parameters of an actuator that have passed every check.
///
/// **Example**
/// ```
/// use telepulse_actuator::ParameterSet;
/// let a = ParameterSet::A.parameters();
/// assert_eq!(a.spec().mass_kg, 0.1);
/// assert!((a.weight_n() - 0.980665).abs() < 1e-12);
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "ActuatorSpec", into = "ActuatorSpec")]
pub struct ActuatorParameters {
    spec: ActuatorSpec,
}

impl ActuatorParameters {
    /// Checks every number of `spec`.
    ///
    /// # Errors
    /// [`Error::Parameter`] names the first key out of range; [`Error::TooManyBranches`].
    pub fn new(spec: ActuatorSpec) -> Result<Self, Error> {
        let positive = [
            ("mu_pa", spec.mu_pa),
            ("relative_permittivity", spec.relative_permittivity),
            ("inner_radius_m", spec.inner_radius_m),
            ("outer_radius_m", spec.outer_radius_m),
            ("thickness_m", spec.thickness_m),
            ("prestretch", spec.prestretch),
            ("mass_kg", spec.mass_kg),
            ("gravity_m_per_s2", spec.gravity_m_per_s2),
            ("rc_s", spec.rc_s),
            ("full_scale_v", spec.full_scale_v),
            ("leak_resistance_ohm", spec.leak_resistance_ohm),
        ];
        for (key, found) in positive {
            require(found.is_finite() && found > 0.0, key, "finite and positive", found)?;
        }
        let damping = spec.damping_n_s_per_m;
        require(
            damping.is_finite() && damping >= 0.0,
            "damping_n_s_per_m",
            "finite and not negative",
            damping,
        )?;
        require(
            spec.inner_radius_m < spec.outer_radius_m,
            "inner_radius_m",
            "smaller than outer_radius_m",
            spec.inner_radius_m,
        )?;
        require(
            spec.prestretch >= 1.0,
            "prestretch",
            "at least 1 (a slack membrane wrinkles)",
            spec.prestretch,
        )?;
        if let Some(limit) = spec.gent_limit {
            let prestretched = crate::material::first_invariant(spec.prestretch, spec.prestretch) - 3.0;
            require(
                limit.is_finite() && limit > prestretched,
                "gent_limit",
                "finite and above I1 - 3 of the pre-stretch",
                limit,
            )?;
        }
        for branch in &spec.branches {
            let (modulus, time) = (branch.modulus_pa, branch.relaxation_time_s);
            require(modulus.is_finite() && modulus > 0.0, "modulus_pa", "finite and positive", modulus)?;
            require(time.is_finite() && time > 0.0, "relaxation_time_s", "finite and positive", time)?;
        }
        if spec.branches.len() > MAX_BRANCHES {
            return Err(Error::TooManyBranches { allowed: MAX_BRANCHES, found: spec.branches.len() });
        }
        Ok(Self { spec })
    }

    /// The numbers themselves.
    #[must_use]
    pub fn spec(&self) -> &ActuatorSpec {
        &self.spec
    }

    /// The relaxed membrane of these parameters as a sheet of its own.
    ///
    /// # Errors
    /// None that the parameters' own check has not caught; the signature is that of [`Sheet::new`].
    pub fn sheet(&self) -> Result<Sheet, Error> {
        let spec = &self.spec;
        let mu_pa = spec.mu_pa;
        Sheet::new(SheetSpec {
            material: match spec.gent_limit {
                Some(limit) => Material::Gent { mu_pa, limit },
                None => Material::NeoHookean { mu_pa },
            },
            inner_radius_m: spec.inner_radius_m,
            outer_radius_m: spec.outer_radius_m,
            thickness_m: spec.thickness_m,
            prestretch_inner: spec.prestretch,
            prestretch_outer: spec.prestretch,
            prestretch: Prestretch::AtLeastOne,
            relative_permittivity: spec.relative_permittivity,
        })
    }

    /// Weight m g of plate and load, N.
    #[must_use]
    pub fn weight_n(&self) -> f64 {
        self.spec.mass_kg * self.spec.gravity_m_per_s2
    }

    /// Sum of the branch moduli, Pa.
    #[must_use]
    pub fn branch_modulus_pa(&self) -> f64 {
        self.spec.branches.iter().map(|branch| branch.modulus_pa).sum()
    }

    /// Permittivity of the membrane, F/m.
    #[must_use]
    pub fn permittivity_f_per_m(&self) -> f64 {
        self.spec.relative_permittivity * VACUUM_PERMITTIVITY_F_PER_M
    }
}

impl TryFrom<ActuatorSpec> for ActuatorParameters {
    type Error = Error;

    fn try_from(spec: ActuatorSpec) -> Result<Self, Error> {
        Self::new(spec)
    }
}

impl From<ActuatorParameters> for ActuatorSpec {
    fn from(parameters: ActuatorParameters) -> Self {
        parameters.spec
    }
}

fn require(holds: bool, key: &'static str, allowed: &'static str, found: f64) -> Result<(), Error> {
    if holds { Ok(()) } else { Err(Error::Parameter { key, allowed, found }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_built_in_sets_pass_their_own_check_and_survive_a_file() {
        for set in [ParameterSet::A, ParameterSet::B, ParameterSet::C] {
            let parameters = set.parameters();
            assert_eq!(
                ActuatorParameters::new(parameters.spec().clone()).expect("valid set"),
                parameters,
                "{set:?}"
            );
            let text = serde_json::to_string(&parameters).expect("plain numbers");
            let back: ActuatorParameters = serde_json::from_str(&text).expect("own text");
            assert_eq!(back, parameters);
        }
    }

    #[test]
    fn edge_bad_parameters_name_their_key() {
        let good = ParameterSet::A.parameters().spec().clone();
        type Damage = fn(&mut ActuatorSpec);
        let cases: [(&str, Damage); 8] = [
            ("mu_pa", |s| s.mu_pa = f64::NAN),
            ("thickness_m", |s| s.thickness_m = 0.0),
            ("inner_radius_m", |s| s.inner_radius_m = 0.07),
            ("prestretch", |s| s.prestretch = 0.9),
            ("gent_limit", |s| s.gent_limit = Some(4.0)),
            ("damping_n_s_per_m", |s| s.damping_n_s_per_m = -1.0),
            ("relaxation_time_s", |s| s.branches[0].relaxation_time_s = 0.0),
            ("modulus_pa", |s| s.branches[1].modulus_pa = f64::INFINITY),
        ];
        for (expected, damage) in cases {
            let mut spec = good.clone();
            damage(&mut spec);
            match ActuatorParameters::new(spec) {
                Err(Error::Parameter { key, .. }) => assert_eq!(key, expected),
                other => panic!("{expected}: {other:?}"),
            }
        }
        let mut spec = good.clone();
        spec.branches = vec![good.branches[0]; 5];
        assert_eq!(ActuatorParameters::new(spec), Err(Error::TooManyBranches { allowed: 4, found: 5 }));
    }

    #[test]
    fn edge_unknown_key_is_refused() {
        let mut value = serde_json::to_value(ParameterSet::C.parameters()).expect("plain numbers");
        value["mu_kpa"] = serde_json::json!(37.0);
        let message =
            serde_json::from_value::<ActuatorParameters>(value).expect_err("unknown key").to_string();
        assert!(message.contains("mu_kpa"), "{message}");
    }
}
