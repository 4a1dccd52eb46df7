//! The annular sheet and its material, checked once.

use crate::material::{ElasticLaw, OgdenTerm, first_invariant};
use crate::{Error, VACUUM_PERMITTIVITY_F_PER_M};

/// Hyperelastic material in physical units, unchecked.
#[derive(Debug, Clone, PartialEq)]
pub enum Material {
    /// W = (mu/2)(I1 - 3).
    NeoHookean {
        /// Shear modulus, Pa.
        mu_pa: f64,
    },
    /// W = -(mu J/2) ln(1 - (I1 - 3)/J).
    Gent {
        /// Shear modulus, Pa.
        mu_pa: f64,
        /// Chain limit J of I1 - 3.
        limit: f64,
    },
    /// W = sum of (mu_i/alpha_i)(l1^alpha_i + l2^alpha_i + l3^alpha_i - 3).
    Ogden {
        /// `[mu_i in Pa, alpha_i]`.
        terms: Vec<[f64; 2]>,
    },
}

impl Material {
    /// Small-strain shear modulus, Pa: half the sum of mu_i alpha_i for Ogden's law.
    #[must_use]
    pub fn shear_modulus_pa(&self) -> f64 {
        match self {
            Self::NeoHookean { mu_pa } | Self::Gent { mu_pa, .. } => *mu_pa,
            Self::Ogden { terms } => 0.5 * terms.iter().map(|[mu_pa, alpha]| mu_pa * alpha).sum::<f64>(),
        }
    }

    /// The law relative to the small-strain shear modulus.
    fn law(&self) -> ElasticLaw {
        match self {
            Self::NeoHookean { .. } => ElasticLaw::NeoHookean,
            Self::Gent { limit, .. } => ElasticLaw::Gent { limit: *limit },
            Self::Ogden { terms } => {
                let mu_pa = self.shear_modulus_pa();
                ElasticLaw::Ogden {
                    terms: terms
                        .iter()
                        .map(|[term_pa, alpha]| OgdenTerm {
                            modulus_ratio: term_pa / mu_pa,
                            exponent: *alpha,
                        })
                        .collect(),
                }
            }
        }
    }

    fn check(&self) -> Result<(), Error> {
        match self {
            Self::NeoHookean { mu_pa } => positive("mu_pa", *mu_pa),
            Self::Gent { mu_pa, limit } => {
                positive("mu_pa", *mu_pa)?;
                positive("J", *limit)
            }
            Self::Ogden { terms } => {
                for [mu_pa, alpha] in terms {
                    require(mu_pa.is_finite(), "terms: mu_pa", "finite", *mu_pa)?;
                    let usable = alpha.is_finite() && *alpha != 0.0 && alpha.abs() <= LARGEST_EXPONENT;
                    require(usable, "terms: alpha", "not zero and at most 40 in magnitude", *alpha)?;
                }
                let mu_pa = self.shear_modulus_pa();
                require(
                    mu_pa.is_finite() && mu_pa > 0.0,
                    "terms",
                    "such that the shear modulus, half the sum of mu_pa alpha, is positive in Pa",
                    mu_pa,
                )
            }
        }
    }
}

/// Larger exponents overflow at the stretches of elastomers.
const LARGEST_EXPONENT: f64 = 40.0;

/// Whether a membrane may be clamped with less than its natural length.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Prestretch {
    /// Both boundary stretches must be at least 1: a shorter membrane is slack until it is loaded.
    #[default]
    AtLeastOne,
    /// Boundary stretches below 1 are meant.
    BelowOneAllowed,
}

/// An annular sheet as a user describes it, unchecked.
#[derive(Debug, Clone, PartialEq)]
pub struct SheetSpec {
    /// Hyperelastic material.
    pub material: Material,
    /// Deformed inner radius a, the plate's, m.
    pub inner_radius_m: f64,
    /// Deformed outer radius b, the frame's, m.
    pub outer_radius_m: f64,
    /// Undeformed thickness H, m.
    pub thickness_m: f64,
    /// Radial boundary stretch at the plate: the undeformed inner radius is A = a/lp_a.
    pub prestretch_inner: f64,
    /// Radial boundary stretch at the frame: the undeformed outer radius is B = b/lp_b.
    pub prestretch_outer: f64,
    /// Whether boundary stretches below 1 are meant.
    pub prestretch: Prestretch,
    /// Relative permittivity.
    pub relative_permittivity: f64,
}

/// An annular sheet that has passed every check, with the scales that make its equations dimensionless.
///
/// **Shapes and units**: undeformed radii A < B and thickness H, clamped to radii a = lp_a A and b = lp_b B. Inside, lengths
/// are divided by B, stresses by the small-strain shear modulus mu, f = F/(2 pi mu H B), v = (V/H) sqrt(eps/mu).
#[derive(Debug, Clone, PartialEq)]
pub struct Sheet {
    spec: SheetSpec,
    law: ElasticLaw,
    mu_pa: f64,
}

impl Sheet {
    /// Checks every number of `spec`.
    ///
    /// # Errors
    /// [`Error::Parameter`] names the first key out of range, as in files; [`Error::GentLimit`] where the pre-stretch alone
    /// exceeds the chain limit.
    pub fn new(spec: SheetSpec) -> Result<Self, Error> {
        spec.material.check()?;
        positive("a_m", spec.inner_radius_m)?;
        positive("b_m", spec.outer_radius_m)?;
        positive("thickness_m", spec.thickness_m)?;
        positive("relative_permittivity", spec.relative_permittivity)?;
        for found in [spec.prestretch_inner, spec.prestretch_outer] {
            positive("prestretch", found)?;
            let taut = found >= 1.0 || spec.prestretch == Prestretch::BelowOneAllowed;
            require(taut, "prestretch", "at least 1, or the membrane is slack before it is loaded", found)?;
        }
        let (a, b) = (spec.inner_radius_m, spec.outer_radius_m);
        require(a < b, "a_m", "smaller than b_m: the membrane spans from the plate out to the frame", a)?;
        let (inner, outer) = (a / spec.prestretch_inner, b / spec.prestretch_outer);
        require(
            inner < outer,
            "prestretch",
            "such that the undeformed inner radius a_m/prestretch stays below the outer one, b_m/prestretch",
            spec.prestretch_inner,
        )?;
        if let Material::Gent { limit, .. } = spec.material {
            let invariant = [spec.prestretch_inner, spec.prestretch_outer]
                .map(|stretch| first_invariant(stretch, stretch) - 3.0)
                .into_iter()
                .fold(0.0, f64::max);
            if invariant >= limit {
                return Err(Error::GentLimit { invariant, gent_limit: limit });
            }
        }
        let (law, mu_pa) = (spec.material.law(), spec.material.shear_modulus_pa());
        Ok(Self { spec, law, mu_pa })
    }

    /// The numbers themselves.
    #[must_use]
    pub fn spec(&self) -> &SheetSpec {
        &self.spec
    }

    /// The elastic law relative to [`Sheet::shear_modulus_pa`].
    #[must_use]
    pub fn law(&self) -> &ElasticLaw {
        &self.law
    }

    /// Small-strain shear modulus mu, Pa.
    #[must_use]
    pub fn shear_modulus_pa(&self) -> f64 {
        self.mu_pa
    }

    /// Undeformed outer radius B, m: the unit of length inside.
    #[must_use]
    pub fn length_scale_m(&self) -> f64 {
        self.spec.outer_radius_m / self.spec.prestretch_outer
    }

    /// A/B.
    #[must_use]
    pub fn radius_ratio(&self) -> f64 {
        self.spec.inner_radius_m / self.spec.prestretch_inner / self.length_scale_m()
    }

    /// 2 pi mu H B, N: the unit of force inside.
    #[must_use]
    pub fn force_scale_n(&self) -> f64 {
        2.0 * std::f64::consts::PI * self.mu_pa * self.spec.thickness_m * self.length_scale_m()
    }

    /// v^2 = (V/H)^2 eps/mu for one V^2.
    #[must_use]
    pub fn field_scale_per_v2(&self) -> f64 {
        self.permittivity_f_per_m() / (self.mu_pa * self.spec.thickness_m * self.spec.thickness_m)
    }

    /// (eps/H) 2 pi B^2, F: the unit of capacitance inside.
    #[must_use]
    pub fn capacitance_scale_f(&self) -> f64 {
        let length = self.length_scale_m();
        self.permittivity_f_per_m() / self.spec.thickness_m * 2.0 * std::f64::consts::PI * length * length
    }

    /// Permittivity, F/m.
    #[must_use]
    pub fn permittivity_f_per_m(&self) -> f64 {
        self.spec.relative_permittivity * VACUUM_PERMITTIVITY_F_PER_M
    }
}

fn positive(key: &'static str, found: f64) -> Result<(), Error> {
    require(found.is_finite() && found > 0.0, key, "finite and positive", found)
}

fn require(holds: bool, key: &'static str, allowed: &'static str, found: f64) -> Result<(), Error> {
    if holds { Ok(()) } else { Err(Error::Parameter { key, allowed, found }) }
}
