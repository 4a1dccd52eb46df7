//! Stress in the membrane from its stretches: elastic network, Maxwell branches, electric field.
//!
//! All stresses are nominal (force per undeformed area) and divided by the shear modulus of the elastic network.

/// Nominal stresses of a plane, incompressible sheet and their derivatives with respect to the stretches.
///
/// **Shapes and units**: all relative to the shear modulus; index 1 is the meridional direction, 2 the hoop direction.
/// Since a potential exists, `ds1/dl2 = ds2/dl1`, stored once as `s12`.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Stress {
    /// Meridional stress s1.
    pub s1: f64,
    /// Hoop stress s2.
    pub s2: f64,
    /// ds1/dl1.
    pub s11: f64,
    /// ds1/dl2 = ds2/dl1.
    pub s12: f64,
    /// ds2/dl2.
    pub s22: f64,
}

impl Stress {
    /// Adds `factor * other`.
    pub fn add_scaled(&mut self, other: &Self, factor: f64) {
        self.s1 += factor * other.s1;
        self.s2 += factor * other.s2;
        self.s11 += factor * other.s11;
        self.s12 += factor * other.s12;
        self.s22 += factor * other.s22;
    }
}

/// Elastic law of the relaxed network, relative to its shear modulus.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ElasticLaw {
    /// W = (I1 - 3)/2.
    NeoHookean,
    /// W = -(J/2) ln(1 - (I1 - 3)/J) with the chain limit J (Gent 1996).
    Gent {
        /// The limit J of I1 - 3.
        limit: f64,
    },
}

impl ElasticLaw {
    /// Stress and tangent at the stretches, or nothing where the law has no value (`l <= 0`, or beyond the limit).
    #[must_use]
    pub fn stress(&self, l1: f64, l2: f64) -> Option<Stress> {
        // Written so that NaN is refused too.
        if !(l1 > 0.0 && l2 > 0.0) {
            return None;
        }
        let neo = neo_hookean(l1, l2);
        match *self {
            Self::NeoHookean => Some(neo),
            Self::Gent { limit } => {
                let room = limit - (first_invariant(l1, l2) - 3.0);
                if room <= 0.0 {
                    return None;
                }
                // dW/dl = g n with n the neo-Hookean stress and g = J/(J - I1 + 3); dg/dl = 2 g n/(J - I1 + 3).
                let g = limit / room;
                let dg = 2.0 * g / room;
                Some(Stress {
                    s1: g * neo.s1,
                    s2: g * neo.s2,
                    s11: g * neo.s11 + dg * neo.s1 * neo.s1,
                    s12: g * neo.s12 + dg * neo.s1 * neo.s2,
                    s22: g * neo.s22 + dg * neo.s2 * neo.s2,
                })
            }
        }
    }
}

/// First invariant I1 = l1^2 + l2^2 + 1/(l1 l2)^2 of an incompressible sheet.
#[must_use]
pub fn first_invariant(l1: f64, l2: f64) -> f64 {
    let l12 = l1 * l2;
    l1 * l1 + l2 * l2 + 1.0 / (l12 * l12)
}

/// Neo-Hookean stress n1 = l1 - l1^-3 l2^-2, n2 = l2 - l1^-2 l2^-3, and its tangent.
#[must_use]
pub fn neo_hookean(l1: f64, l2: f64) -> Stress {
    let (i1, i2) = (1.0 / l1, 1.0 / l2);
    // 1/(l1 l2)^2 is l3^2.
    let l3_squared = (i1 * i2) * (i1 * i2);
    Stress {
        s1: l1 - l3_squared * i1,
        s2: l2 - l3_squared * i2,
        s11: 1.0 + 3.0 * l3_squared * i1 * i1,
        s12: 2.0 * l3_squared * i1 * i2,
        s22: 1.0 + 3.0 * l3_squared * i2 * i2,
    }
}

/// Stress of a neo-Hookean Maxwell branch of unit modulus whose dashpots stand at `xi1`, `xi2`.
///
/// **Method**: W(l1/xi1, l2/xi2), so s1 = n1(l1/xi1, l2/xi2)/xi1, and so on.
///
/// **Source**: Foo, Cai, Koh, Bauer, Suo 2012.
#[must_use]
pub fn maxwell_branch(l1: f64, l2: f64, xi1: f64, xi2: f64) -> Stress {
    let n = neo_hookean(l1 / xi1, l2 / xi2);
    Stress {
        s1: n.s1 / xi1,
        s2: n.s2 / xi2,
        s11: n.s11 / (xi1 * xi1),
        s12: n.s12 / (xi1 * xi2),
        s22: n.s22 / (xi2 * xi2),
    }
}

/// Electrical part of the stress per unit of v^2 = (Phi/H)^2 eps/mu: -l1 l2^2 and -l1^2 l2, with its tangent.
///
/// **Source**: ideal dielectric elastomer; W_el = -(v^2/2) (l1 l2)^2.
#[must_use]
pub fn electrical(l1: f64, l2: f64) -> Stress {
    Stress { s1: -l1 * l2 * l2, s2: -l1 * l1 * l2, s11: -l2 * l2, s12: -2.0 * l1 * l2, s22: -l1 * l1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Energy density by its own formula, as the independent route.
    fn gent_energy(l1: f64, l2: f64, limit: f64) -> f64 {
        -(limit / 2.0) * (1.0 - (first_invariant(l1, l2) - 3.0) / limit).ln()
    }

    #[test]
    fn law_stress_is_gradient_of_energy_and_tangent_its_curvature() {
        let (l1, l2, limit, h) = (2.1, 1.9, 110.0, 1e-4);
        let law = ElasticLaw::Gent { limit };
        let s = law.stress(l1, l2).expect("inside the limit");
        let w = |d1: f64, d2: f64| gent_energy(l1 + d1 * h, l2 + d2 * h, limit);
        // Fourth-order central difference: error of order h^4 = 1e-16 times derivatives of order 1, plus rounding 1e-12.
        let ds1 = (8.0 * (w(1.0, 0.0) - w(-1.0, 0.0)) - (w(2.0, 0.0) - w(-2.0, 0.0))) / (12.0 * h);
        assert!((ds1 - s.s1).abs() < 1e-9, "{ds1} {}", s.s1);
        let at = |d1: f64, d2: f64| law.stress(l1 + d1 * h, l2 + d2 * h).expect("inside");
        // Second-order central difference of a stress: h^2 = 1e-8 times third derivatives of order 1.
        let s11 = (at(1.0, 0.0).s1 - at(-1.0, 0.0).s1) / (2.0 * h);
        let s12 = (at(0.0, 1.0).s1 - at(0.0, -1.0).s1) / (2.0 * h);
        let s21 = (at(1.0, 0.0).s2 - at(-1.0, 0.0).s2) / (2.0 * h);
        let s22 = (at(0.0, 1.0).s2 - at(0.0, -1.0).s2) / (2.0 * h);
        for (numeric, exact) in [(s11, s.s11), (s12, s.s12), (s21, s.s12), (s22, s.s22)] {
            assert!((numeric - exact).abs() < 1e-7, "{numeric} {exact}");
        }
    }

    #[test]
    fn law_relaxed_branch_carries_no_stress_and_has_tangent_4_2_4() {
        let (l1, l2) = (2.2, 2.05);
        let s = maxwell_branch(l1, l2, l1, l2);
        assert!(s.s1.abs() < 1e-15 && s.s2.abs() < 1e-15);
        for (found, expected) in
            [(s.s11, 4.0 / (l1 * l1)), (s.s12, 2.0 / (l1 * l2)), (s.s22, 4.0 / (l2 * l2))]
        {
            assert!((found - expected).abs() < 1e-14, "{found} {expected}");
        }
    }

    #[test]
    fn edge_stress_has_no_value_beyond_the_limit_or_for_nan() {
        let law = ElasticLaw::Gent { limit: 5.0 };
        assert!(law.stress(2.5, 2.5).is_none());
        assert!(law.stress(f64::NAN, 1.0).is_none());
        assert!(ElasticLaw::NeoHookean.stress(-1.0, 1.0).is_none());
    }
}
