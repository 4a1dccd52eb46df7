//! What ends a membrane, what is known of the limits, and how a distance to them is written.

use serde::Serialize;

use super::breakdown::{BreakdownLaw, Standing};
use crate::Error;

/// What ends the model, the membrane or the amplifier's reach.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mechanism {
    /// The smallest stress is zero: the membrane wrinkles.
    LossOfTension,
    /// Under its dead load the membrane bears no more voltage.
    LimitPoint,
    /// ds1/dl1 or ds2/dl2 is zero: the voltage thins the membrane without bound at a held plate.
    PullIn,
    /// The true field reaches the material's strength.
    Breakdown,
    /// The largest stretch reaches the one at which the material tears.
    Rupture,
    /// The amplifier gives no more voltage.
    AmplifierVoltage,
    /// The amplifier gives no more current.
    AmplifierCurrent,
    /// The amplifier is no faster.
    AmplifierSlew,
}

impl Mechanism {
    /// In words, for legends and messages.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::LossOfTension => "loss of tension",
            Self::LimitPoint => "limit point",
            Self::PullIn => "pull-in",
            Self::Breakdown => "electrical breakdown",
            Self::Rupture => "rupture",
            Self::AmplifierVoltage => "amplifier voltage",
            Self::AmplifierCurrent => "amplifier current",
            Self::AmplifierSlew => "amplifier slew",
        }
    }
}

/// What the amplifier can do; what is not given is not judged.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct AmplifierLimits {
    /// Largest voltage, V.
    pub max_v: Option<f64>,
    /// Largest current, A.
    pub current_a: Option<f64>,
    /// Fastest change of voltage, V/s.
    pub slew_v_per_s: Option<f64>,
    /// Leak resistance across its output, ohm; none where not given.
    pub leak_resistance_ohm: Option<f64>,
}

/// What a state is judged by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FailureCriteria {
    pub(super) breakdown: BreakdownLaw,
    pub(super) rupture_stretch: f64,
    pub(super) rupture_standing: Standing,
    pub(super) amplifier: AmplifierLimits,
}

impl Default for FailureCriteria {
    /// Smirnov's breakdown law, rupture at a stretch of 5 (assumed), and no amplifier.
    fn default() -> Self {
        Self {
            breakdown: BreakdownLaw::Smirnov2018,
            rupture_stretch: DEFAULT_RUPTURE_STRETCH,
            rupture_standing: Standing::Unverified {
                reason: "assumed: below the elongation at break of acrylic tape",
            },
            amplifier: AmplifierLimits::default(),
        }
    }
}

/// Assumed; give the material's own with the case.
const DEFAULT_RUPTURE_STRETCH: f64 = 5.0;

impl FailureCriteria {
    /// These criteria with another breakdown law.
    #[must_use]
    pub fn with_breakdown(mut self, law: BreakdownLaw) -> Self {
        self.breakdown = law;
        self
    }

    /// These criteria with the material's own stretch at rupture.
    ///
    /// # Errors
    /// [`Error::Parameter`] unless it is finite and above 1.
    pub fn with_rupture_stretch(mut self, stretch: f64) -> Result<Self, Error> {
        if !(stretch.is_finite() && stretch > 1.0) {
            return Err(Error::Parameter {
                key: "rupture_stretch",
                allowed: "finite and above 1",
                found: stretch,
            });
        }
        self.rupture_stretch = stretch;
        self.rupture_standing = Standing::Given;
        Ok(self)
    }

    /// These criteria with an amplifier.
    ///
    /// # Errors
    /// [`Error::Parameter`] names the limit that is not finite and positive.
    pub fn with_amplifier(mut self, amplifier: AmplifierLimits) -> Result<Self, Error> {
        let all = [
            ("amplifier.max_v", amplifier.max_v),
            ("amplifier.current_a", amplifier.current_a),
            ("amplifier.slew_v_per_s", amplifier.slew_v_per_s),
            ("amplifier.leak_resistance_ohm", amplifier.leak_resistance_ohm),
        ];
        for (key, found) in all {
            if let Some(found) = found.filter(|found| !(found.is_finite() && *found > 0.0)) {
                return Err(Error::Parameter { key, allowed: "finite and positive", found });
            }
        }
        self.amplifier = amplifier;
        Ok(self)
    }

    /// The breakdown law.
    #[must_use]
    pub fn breakdown(&self) -> BreakdownLaw {
        self.breakdown
    }

    /// Stretch at which the material tears.
    #[must_use]
    pub fn rupture_stretch(&self) -> f64 {
        self.rupture_stretch
    }

    /// What is known of that stretch.
    #[must_use]
    pub fn rupture_standing(&self) -> Standing {
        self.rupture_standing
    }

    /// The amplifier.
    #[must_use]
    pub fn amplifier(&self) -> AmplifierLimits {
        self.amplifier
    }

    /// Whether a mechanism is judged by a number that has not been checked against its source.
    #[must_use]
    pub fn is_unverified(&self, mechanism: Mechanism) -> bool {
        let standing = match mechanism {
            Mechanism::Breakdown => self.breakdown.source().standing,
            Mechanism::Rupture => self.rupture_standing,
            _ => return false,
        };
        matches!(standing, Standing::Unverified { .. })
    }
}

/// Distance to one mechanism.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Margin {
    /// Which.
    pub mechanism: Mechanism,
    /// What was found.
    pub value: f64,
    /// Where it ends.
    pub limit: f64,
    /// Unit of both.
    pub unit: &'static str,
    /// Part that is left: 1 untouched, 0 at the limit, negative beyond. For an upper limit 1 - value/limit; for tension and
    /// modulus, which end at zero, the value over that without voltage.
    pub left: f64,
    /// True where the limit has not been checked against its source.
    pub unverified: bool,
}

impl Margin {
    /// Distance to an upper limit.
    pub(super) fn below(
        criteria: &FailureCriteria,
        mechanism: Mechanism,
        unit: &'static str,
        value: f64,
        limit: f64,
    ) -> Self {
        let unverified = criteria.is_unverified(mechanism);
        Self { mechanism, value, limit, unit, left: 1.0 - value / limit, unverified }
    }

    /// Distance to zero, from where `untouched` was found.
    pub(super) fn above_zero(mechanism: Mechanism, value: f64, untouched: f64) -> Self {
        // A state that is slack without voltage has nothing left whatever its sign.
        let left = if untouched > 0.0 { value / untouched } else { value.min(0.0) };
        Self { mechanism, value, limit: 0.0, unit: "Pa", left, unverified: false }
    }
}
