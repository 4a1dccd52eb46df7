//! Laws of electrical breakdown, each with its source and with what is known of it.

use serde::Serialize;

use crate::Error;

/// Where a law is asked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Site {
    /// Meridional stretch.
    pub lambda1: f64,
    /// Hoop stretch.
    pub lambda2: f64,
    /// Deformed thickness, m.
    pub thickness_m: f64,
}

/// Breakdown strength of the elastomer as a true field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum BreakdownLaw {
    /// One strength everywhere, from the user.
    Constant {
        /// True field, V/m.
        strength_v_per_m: f64,
    },
    /// 35 to 70 MV/m over 0 to 500 % of stretch, linear between (VHB 4905).
    Smirnov2018,
    /// 51 h^-0.25 l^0.63 MV/m with the deformed thickness h in mm.
    Huang2012,
    /// 30.6 l^1.13 MV/m.
    Koh2011,
}

/// How far a number can be relied on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(tag = "status", rename_all = "kebab-case")]
pub enum Standing {
    /// The user's own.
    Given,
    /// Numbers as its source states them; what the law adds to them is said.
    Published {
        /// What is not in the source.
        added: &'static str,
    },
    /// Not checked against its source.
    Unverified {
        /// What is open.
        reason: &'static str,
    },
}

/// Where a law comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Source {
    /// Authors, year, place.
    pub citation: &'static str,
    /// What is known of it.
    pub standing: Standing,
}

impl BreakdownLaw {
    /// The law of this name in files.
    ///
    /// # Errors
    /// [`Error::UnknownBreakdownLaw`].
    pub fn named(name: &str) -> Result<Self, Error> {
        [Self::Smirnov2018, Self::Huang2012, Self::Koh2011]
            .into_iter()
            .find(|law| law.name() == name)
            .ok_or_else(|| Error::UnknownBreakdownLaw { found: name.to_owned() })
    }

    /// One strength everywhere.
    ///
    /// # Errors
    /// [`Error::Parameter`] unless it is finite and positive.
    pub fn constant(strength_v_per_m: f64) -> Result<Self, Error> {
        if strength_v_per_m.is_finite() && strength_v_per_m > 0.0 {
            return Ok(Self::Constant { strength_v_per_m });
        }
        Err(Error::Parameter {
            key: "breakdown",
            allowed: "a law's name, or a positive field in V/m",
            found: strength_v_per_m,
        })
    }

    /// Name in files.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Constant { .. } => "constant",
            Self::Smirnov2018 => "smirnov-2018",
            Self::Huang2012 => "huang-2012",
            Self::Koh2011 => "koh-2011",
        }
    }

    /// Where the numbers come from.
    #[must_use]
    pub fn source(&self) -> Source {
        match self {
            Self::Constant { .. } => Source { citation: "given with the case", standing: Standing::Given },
            Self::Smirnov2018 => Source {
                citation: "Smirnov, Springhetti, Morozov, Lukin 2018, Technical Physics 63 (VHB 4905, quasi-static)",
                standing: Standing::Published {
                    added: "both ends are printed for uniaxial stretch; the straight line between them and the use of the \
                            smaller principal stretch for biaxial states are assumptions",
                },
            },
            Self::Huang2012 => Source {
                citation: "Huang, Shian, Diebold, Suo, Clarke 2012, Appl. Phys. Lett. 101, 122905",
                standing: Standing::Unverified {
                    reason: "coefficient and exponents are printed, the units are not checked: h in mm is assumed, since h in \
                             micrometres would have the paper's device break down at the 5 kV it was run at",
                },
            },
            Self::Koh2011 => Source {
                citation: "attributed to Koh et al. 2011",
                standing: Standing::Unverified { reason: "from memory, not checked against the publication" },
            },
        }
    }

    /// True field at which the elastomer breaks down, V/m.
    ///
    /// **Method**: where the states in print were stretched in one way and the membrane in another, the smaller principal
    /// stretch is taken: strength rises with stretch, so this errs on the safe side.
    #[must_use]
    pub fn strength_v_per_m(&self, site: Site) -> f64 {
        let stretch = site.lambda1.min(site.lambda2).max(1.0);
        match self {
            Self::Constant { strength_v_per_m } => *strength_v_per_m,
            Self::Smirnov2018 => 35.0e6 * (1.0 + ((stretch - 1.0) / 5.0).min(1.0)),
            Self::Huang2012 => 51.0e6 * (site.thickness_m * 1e3).powf(-0.25) * stretch.powf(0.63),
            Self::Koh2011 => 30.6e6 * stretch.powf(1.13),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(law: BreakdownLaw, stretch: f64) -> f64 {
        let thickness_m = 1e-3 / (stretch * stretch);
        law.strength_v_per_m(Site { lambda1: stretch, lambda2: stretch, thickness_m })
    }

    #[test]
    fn oracle_printed_ends_of_the_laws() {
        // Abstract of Smirnov et al.: 35 to 70 kV/mm over 0-500 %; no value is printed beyond.
        assert_eq!(at(BreakdownLaw::Smirnov2018, 1.0), 35.0e6);
        assert_eq!(at(BreakdownLaw::Smirnov2018, 6.0), 70.0e6);
        assert_eq!(at(BreakdownLaw::Smirnov2018, 8.0), 70.0e6);
        // At a thickness and a stretch of one unit only the coefficients are left.
        assert!((at(BreakdownLaw::Huang2012, 1.0) / 51.0e6 - 1.0).abs() < 1e-12);
        assert!((at(BreakdownLaw::Koh2011, 1.0) / 30.6e6 - 1.0).abs() < 1e-12);
    }

    #[test]
    fn law_strength_never_falls_with_stretch() {
        for law in [BreakdownLaw::Smirnov2018, BreakdownLaw::Huang2012, BreakdownLaw::Koh2011] {
            let values: Vec<f64> = (0..60).map(|k| at(law, 1.0 + 0.1 * f64::from(k))).collect();
            assert!(values.windows(2).all(|pair| pair[0] <= pair[1]), "{law:?}");
        }
    }

    #[test]
    fn edge_what_is_unverified_says_so_and_unknown_names_are_refused() {
        for law in [BreakdownLaw::Huang2012, BreakdownLaw::Koh2011] {
            assert!(matches!(law.source().standing, Standing::Unverified { .. }), "{law:?}");
            assert_eq!(BreakdownLaw::named(law.name()), Ok(law));
        }
        assert!(matches!(BreakdownLaw::named("paschen"), Err(Error::UnknownBreakdownLaw { .. })));
        for found in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(BreakdownLaw::constant(found), Err(Error::Parameter { .. })), "{found}");
        }
    }
}
