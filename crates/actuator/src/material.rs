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

/// One term of Ogden's energy, `(modulus_ratio/exponent) (l1^exponent + l2^exponent + l3^exponent - 3)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OgdenTerm {
    /// Modulus of the term relative to the small-strain shear modulus of the network; may be negative.
    pub modulus_ratio: f64,
    /// Exponent alpha; not zero, may be negative.
    pub exponent: f64,
}

/// Elastic law of the relaxed network, relative to its small-strain shear modulus.
#[derive(Debug, Clone, PartialEq)]
pub enum ElasticLaw {
    /// W = (I1 - 3)/2.
    NeoHookean,
    /// W = -(J/2) ln(1 - (I1 - 3)/J) with the chain limit J (Gent 1996).
    Gent {
        /// The limit J of I1 - 3.
        limit: f64,
    },
    /// W = sum of (m/a)(l1^a + l2^a + l3^a - 3) with sum(m a) = 2 (Ogden 1972).
    Ogden {
        /// The terms.
        terms: Vec<OgdenTerm>,
    },
}

impl ElasticLaw {
    /// Stress and tangent at the stretches, or nothing where the law has no value (`l <= 0`, or beyond the limit).
    #[must_use]
    #[inline]
    pub fn stress(&self, l1: f64, l2: f64) -> Option<Stress> {
        // Written so that NaN is refused too.
        if !(l1 > 0.0 && l2 > 0.0) {
            return None;
        }
        match self {
            Self::NeoHookean => Some(neo_hookean(l1, l2)),
            Self::Gent { limit } => gent(l1, l2, *limit),
            Self::Ogden { terms } => Some(ogden(l1, l2, terms)),
        }
    }

    /// Energy density relative to the shear modulus, or nothing where the law has no value.
    #[must_use]
    pub fn energy(&self, l1: f64, l2: f64) -> Option<f64> {
        if !(l1 > 0.0 && l2 > 0.0) {
            return None;
        }
        match self {
            Self::NeoHookean => Some(0.5 * (first_invariant(l1, l2) - 3.0)),
            Self::Gent { limit } => {
                let used = (first_invariant(l1, l2) - 3.0) / limit;
                (used < 1.0).then(|| -0.5 * limit * (-used).ln_1p())
            }
            Self::Ogden { terms } => {
                let l3 = 1.0 / (l1 * l2);
                let power = |a: f64| l1.powf(a) + l2.powf(a) + l3.powf(a) - 3.0;
                Some(terms.iter().map(|t| t.modulus_ratio / t.exponent * power(t.exponent)).sum())
            }
        }
    }

    /// Lower bound of the tangent's smallest eigenvalue over all stretches between `lower` and `upper` in both
    /// directions, or nothing where none is known: then the energy need not be convex.
    ///
    /// **Method**: (l1 l2)^-a is convex in (l1, l2) for a > 0, so a term with a >= 1 and a positive modulus is at least as
    /// stiff as its part m (a - 1) l^(a - 2). A Gent network is stiffer than the neo-Hookean one, whose part is 1.
    #[must_use]
    pub fn convexity(&self, lower: f64, upper: f64) -> Option<f64> {
        match self {
            Self::NeoHookean | Self::Gent { .. } => Some(1.0),
            Self::Ogden { terms } => terms
                .iter()
                .map(|&OgdenTerm { modulus_ratio, exponent }| {
                    let least = lower.powf(exponent - 2.0).min(upper.powf(exponent - 2.0));
                    (modulus_ratio > 0.0 && exponent >= 1.0)
                        .then_some(modulus_ratio * (exponent - 1.0) * least)
                })
                .sum(),
        }
    }
}

#[inline]
fn gent(l1: f64, l2: f64, limit: f64) -> Option<Stress> {
    let neo = neo_hookean(l1, l2);
    let room = limit - (first_invariant(l1, l2) - 3.0);
    if room <= 0.0 {
        return None;
    }
    // dW/dl = g n with n the neo-Hookean stress and g = J/(J - I1 + 3); dg/dl = 2 g n/(J - I1 + 3).
    let inverse_room = 1.0 / room;
    let g = limit * inverse_room;
    let dg = 2.0 * g * inverse_room;
    Some(Stress {
        s1: g * neo.s1,
        s2: g * neo.s2,
        s11: g * neo.s11 + dg * neo.s1 * neo.s1,
        s12: g * neo.s12 + dg * neo.s1 * neo.s2,
        s22: g * neo.s22 + dg * neo.s2 * neo.s2,
    })
}

fn ogden(l1: f64, l2: f64, terms: &[OgdenTerm]) -> Stress {
    let (i1, i2) = (1.0 / l1, 1.0 / l2);
    let (log1, log2) = (l1.ln(), l2.ln());
    let mut stress = Stress::default();
    for &OgdenTerm { modulus_ratio: m, exponent: a } in terms {
        let (p1, p2) = (m * (a * log1).exp(), m * (a * log2).exp());
        let p3 = m * (-a * (log1 + log2)).exp();
        // s1 = m (l1^a - l3^a)/l1 with dl3/dl1 = -l3/l1.
        stress.s1 += (p1 - p3) * i1;
        stress.s2 += (p2 - p3) * i2;
        stress.s11 += ((a - 1.0) * p1 + (a + 1.0) * p3) * i1 * i1;
        stress.s12 += a * p3 * i1 * i2;
        stress.s22 += ((a - 1.0) * p2 + (a + 1.0) * p3) * i2 * i2;
    }
    stress
}

/// First invariant I1 = l1^2 + l2^2 + 1/(l1 l2)^2 of an incompressible sheet.
#[must_use]
#[inline]
pub fn first_invariant(l1: f64, l2: f64) -> f64 {
    let l12 = l1 * l2;
    l1 * l1 + l2 * l2 + 1.0 / (l12 * l12)
}

/// Neo-Hookean stress n1 = l1 - l1^-3 l2^-2, n2 = l2 - l1^-2 l2^-3, and its tangent.
#[must_use]
#[inline]
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

    fn laws() -> [ElasticLaw; 4] {
        let term = |modulus_ratio, exponent| OgdenTerm { modulus_ratio, exponent };
        [
            ElasticLaw::NeoHookean,
            ElasticLaw::Gent { limit: 110.0 },
            // Exponents of Ogden's rubber, moduli normalised so that sum(m a) = 2.
            ElasticLaw::Ogden { terms: vec![term(1.491, 1.3), term(0.003, 5.0), term(-0.0237, -2.0)] },
            ElasticLaw::Ogden { terms: vec![term(1.0, 2.0)] },
        ]
    }

    #[test]
    fn law_stress_is_gradient_of_energy_and_tangent_its_curvature() {
        let (l1, l2, h) = (2.1, 1.9, 1e-4);
        for law in laws() {
            let s = law.stress(l1, l2).expect("inside the limit");
            let w = |d1: f64, d2: f64| law.energy(l1 + d1 * h, l2 + d2 * h).expect("inside");
            // Fourth-order central difference: h^4 = 1e-16 times derivatives of order 1, plus rounding 1e-15/1e-4.
            let ds1 = (8.0 * (w(1.0, 0.0) - w(-1.0, 0.0)) - (w(2.0, 0.0) - w(-2.0, 0.0))) / (12.0 * h);
            let ds2 = (8.0 * (w(0.0, 1.0) - w(0.0, -1.0)) - (w(0.0, 2.0) - w(0.0, -2.0))) / (12.0 * h);
            assert!((ds1 - s.s1).abs() < 1e-9, "{law:?}: {ds1} {}", s.s1);
            assert!((ds2 - s.s2).abs() < 1e-9, "{law:?}: {ds2} {}", s.s2);
            let at = |d1: f64, d2: f64| law.stress(l1 + d1 * h, l2 + d2 * h).expect("inside");
            // Second-order central difference of a stress: h^2 = 1e-8 times third derivatives of order 1.
            let s11 = (at(1.0, 0.0).s1 - at(-1.0, 0.0).s1) / (2.0 * h);
            let s12 = (at(0.0, 1.0).s1 - at(0.0, -1.0).s1) / (2.0 * h);
            let s21 = (at(1.0, 0.0).s2 - at(-1.0, 0.0).s2) / (2.0 * h);
            let s22 = (at(0.0, 1.0).s2 - at(0.0, -1.0).s2) / (2.0 * h);
            for (numeric, exact) in [(s11, s.s11), (s12, s.s12), (s21, s.s12), (s22, s.s22)] {
                assert!((numeric - exact).abs() < 1e-7, "{law:?}: {numeric} {exact}");
            }
        }
    }

    #[test]
    fn law_ogden_with_one_quadratic_term_is_neo_hookean() {
        let ogden = ElasticLaw::Ogden { terms: vec![OgdenTerm { modulus_ratio: 1.0, exponent: 2.0 }] };
        for (l1, l2) in [(0.8, 1.3), (2.2, 2.0), (1.0, 1.0), (4.0, 0.9)] {
            let (a, b) = (ogden.stress(l1, l2).expect("positive"), neo_hookean(l1, l2));
            for (x, y) in [(a.s1, b.s1), (a.s2, b.s2), (a.s11, b.s11), (a.s12, b.s12), (a.s22, b.s22)] {
                // exp and ln each lose half a unit in the last place.
                assert!((x - y).abs() < 1e-14 * (1.0 + y.abs()), "{x} {y}");
            }
        }
    }

    #[test]
    fn law_convexity_bounds_the_smallest_eigenvalue_of_the_tangent() {
        let term = |modulus_ratio, exponent| OgdenTerm { modulus_ratio, exponent };
        let convex = ElasticLaw::Ogden { terms: vec![term(1.2, 1.3), term(0.05, 5.0)] };
        for law in [ElasticLaw::NeoHookean, ElasticLaw::Gent { limit: 50.0 }, convex] {
            let bound = law.convexity(0.7, 3.0).expect("convex");
            for step1 in 0..=10 {
                for step2 in 0..=10 {
                    let l = |step: i32| 0.7 + 0.23 * f64::from(step);
                    let s = law.stress(l(step1), l(step2)).expect("inside");
                    let mean = 0.5 * (s.s11 + s.s22);
                    let least = mean - (0.5 * (s.s11 - s.s22)).hypot(s.s12);
                    assert!(least >= bound, "{law:?} at step {step1}, {step2}: {least} {bound}");
                }
            }
        }
        let mooney = ElasticLaw::Ogden { terms: vec![term(0.8, 2.0), term(-0.2, -2.0)] };
        assert_eq!(mooney.convexity(1.0, 2.0), None);
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
