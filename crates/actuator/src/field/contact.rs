//! What the plate touches: a load cell, or a fingertip that dissipates where it is compressed.

use super::require;
use crate::Error;

/// A body above the plate on a fixed base, which can push the plate down and cannot pull it.
///
/// **Shapes and units**: compression `d = touch - x`, x positive down, so the plate presses as it rises. The force on the plate
/// is positive down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PlateContact {
    /// Spring and damper side by side: N = k d + c d', not negative. A load cell. The damper sets in over the first 10 um of
    /// compression, so that the force does not jump at touch.
    SpringDamper {
        /// k, N/m.
        stiffness_n_per_m: f64,
        /// c, N s/m.
        damping_n_s_per_m: f64,
        /// Displacement from the rest position at which the plate just touches, mm.
        touch_mm: f64,
    },
    /// N = k d^p (1 + chi d'), not negative: the loss vanishes with the compression, so contact neither jumps nor sticks. A
    /// fingertip.
    ///
    /// **Source**: Hunt and Crossley 1975; chi = 3 (1 - e)/(2 v) gives a restitution e at small speeds v.
    HuntCrossley {
        /// k, N/m^p.
        stiffness_n_per_m_p: f64,
        /// p; 1.5 for smooth bodies (Hertz).
        exponent: f64,
        /// chi, s/m.
        dissipation_s_per_m: f64,
        /// Displacement from the rest position at which the plate just touches, mm.
        touch_mm: f64,
    },
}

/// Force at one state of the plate, with its slope along a stage.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct ContactForce {
    /// N, positive down on the plate.
    pub(super) force_n: f64,
    /// dN/dx, N/m.
    pub(super) by_x: f64,
    /// dN/dx', N s/m.
    pub(super) by_v: f64,
}

impl PlateContact {
    /// Checks every number.
    ///
    /// # Errors
    /// [`Error::Parameter`] names the first key out of range.
    pub fn check(&self) -> Result<(), Error> {
        let touch_mm = match *self {
            Self::SpringDamper { stiffness_n_per_m: k, damping_n_s_per_m: c, touch_mm } => {
                require(k.is_finite() && k > 0.0, "contact stiffness_n_per_m", "finite and positive", k)?;
                let usable = c.is_finite() && c >= 0.0;
                require(usable, "contact damping_n_s_per_m", "finite and not negative", c)?;
                touch_mm
            }
            Self::HuntCrossley {
                stiffness_n_per_m_p: k,
                exponent: p,
                dissipation_s_per_m: chi,
                touch_mm,
            } => {
                require(k.is_finite() && k > 0.0, "contact stiffness_n_per_m_p", "finite and positive", k)?;
                require((1.0..=4.0).contains(&p), "contact exponent", "between 1 and 4", p)?;
                let usable = chi.is_finite() && chi >= 0.0;
                require(usable, "contact dissipation_s_per_m", "finite and not negative", chi)?;
                touch_mm
            }
        };
        require(touch_mm.is_finite(), "contact touch_mm", "finite", touch_mm)
    }

    /// Force on the plate at `x_m` below the rest position, moving down at `v_m_per_s`.
    pub(super) fn force(&self, x_m: f64, v_m_per_s: f64) -> ContactForce {
        let (found, touching) = match *self {
            Self::SpringDamper { stiffness_n_per_m: k, damping_n_s_per_m: c, touch_mm } => {
                let d = touch_mm * 1e-3 - x_m;
                let part = (d / ONSET_M).clamp(0.0, 1.0);
                let part_by_x = if part < 1.0 { -1.0 / ONSET_M } else { 0.0 };
                let found = ContactForce {
                    force_n: k * d - part * c * v_m_per_s,
                    by_x: -k - part_by_x * c * v_m_per_s,
                    by_v: -part * c,
                };
                (found, d > 0.0)
            }
            Self::HuntCrossley {
                stiffness_n_per_m_p: k,
                exponent: p,
                dissipation_s_per_m: chi,
                touch_mm,
            } => {
                let d = (touch_mm * 1e-3 - x_m).max(0.0);
                let (spring, loss) = (k * d.powf(p), 1.0 - chi * v_m_per_s);
                let by_d = k * p * d.powf(p - 1.0) * loss;
                (ContactForce { force_n: spring * loss, by_x: -by_d, by_v: -spring * chi }, d > 0.0)
            }
        };
        if touching && found.force_n > 0.0 { found } else { ContactForce::default() }
    }
}

/// Compression over which the damper of a load cell sets in, m.
const ONSET_M: f64 = 10e-6;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_contact_pushes_only_and_its_slopes_are_those_of_the_force() {
        let cell =
            PlateContact::SpringDamper { stiffness_n_per_m: 300.0, damping_n_s_per_m: 2.0, touch_mm: 0.5 };
        let finger = PlateContact::HuntCrossley {
            stiffness_n_per_m_p: 2e4,
            exponent: 1.5,
            dissipation_s_per_m: 3.0,
            touch_mm: 0.5,
        };
        for contact in [cell, finger] {
            assert!(contact.check().is_ok());
            // Away, and pulled off faster than it could follow.
            assert_eq!(contact.force(0.6e-3, -1.0), ContactForce::default());
            assert_eq!(contact.force(0.4e-3, 10.0), ContactForce::default());
            let (x, v, h) = (-0.5e-3, -0.01, 1e-7);
            let here = contact.force(x, v);
            assert!(here.force_n > 0.0);
            let by_x = (contact.force(x + h, v).force_n - contact.force(x - h, v).force_n) / (2.0 * h);
            let by_v = (contact.force(x, v + h).force_n - contact.force(x, v - h).force_n) / (2.0 * h);
            // h^2 times third derivatives, and rounding 1e-16/1e-7.
            assert!((by_x - here.by_x).abs() < 1e-6 * here.by_x.abs(), "{by_x} {here:?}");
            assert!((by_v - here.by_v).abs() < 1e-6 * here.by_v.abs(), "{by_v} {here:?}");
        }
    }

    #[test]
    fn edge_bad_contact_names_its_key() {
        let bad = PlateContact::HuntCrossley {
            stiffness_n_per_m_p: 1.0,
            exponent: 0.5,
            dissipation_s_per_m: 0.0,
            touch_mm: 0.0,
        };
        assert!(matches!(bad.check(), Err(Error::Parameter { key: "contact exponent", .. })));
    }
}
