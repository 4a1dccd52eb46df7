//! A fractional branch as a ladder of Maxwell branches.

use super::require;
use crate::frequency::FractionalBranch;
use crate::{Error, MaxwellBranch};

/// Spacing of the ladder's rates on a natural logarithmic axis. The trapezoidal rule errs by 2 exp(-pi^2/spacing).
const SPACING: f64 = 0.9;
/// The ladder goes on beyond the band by this factor on either side; what lies outside is lumped, in error by its square.
const MARGIN: f64 = 50.0;
/// Beyond, a simulation would carry more branches than it could ever pay for.
const MAX_DECADES: f64 = 12.0;

impl FractionalBranch {
    /// Maxwell branches that together have the modulus mu (j omega tau)^alpha of this branch over a band of frequencies.
    ///
    /// **Method**: s^alpha = (sin(alpha pi)/pi) integral of u^(alpha - 1) s/(s + u) du over u > 0, a continuum of Maxwell branches;
    /// trapezoidal rule in ln u, which converges exponentially. Slower branches than the ladder's act as one spring, faster
    /// ones as one dashpot.
    ///
    /// **Accuracy**: 1e-3 of the modulus within the band (test); about 2.6 branches for each decade, and 9 more.
    ///
    /// # Errors
    /// [`Error::Parameter`] for numbers of the branch out of range; [`Error::Request`] for a band that is empty, not positive
    /// or longer than 12 decades.
    pub fn maxwell_branches(&self, band_rad_s: [f64; 2]) -> Result<Vec<MaxwellBranch>, Error> {
        let Self { modulus_pa, time_s, exponent: alpha } = *self;
        require(modulus_pa.is_finite() && modulus_pa > 0.0, "modulus_pa", "finite and positive", modulus_pa)?;
        require(time_s.is_finite() && time_s > 0.0, "time_s", "finite and positive", time_s)?;
        require(
            alpha > 0.0 && alpha < 1.0,
            "exponent",
            "between 0 and 1, both excluded (a spring or a dashpot is no fractional branch)",
            alpha,
        )?;
        let [low, high] = band_rad_s;
        let decades = (high / low).log10();
        if !(low > 0.0 && decades > 0.0 && decades <= MAX_DECADES) {
            let (quantity, allowed) =
                ("decades of band_rad_s", "above 0 and at most 12, from a positive frequency");
            return Err(Error::Request { quantity, allowed, found: decades });
        }
        let (first, last) = ((low / MARGIN).ln(), (high * MARGIN).ln());
        let count = ((last - first) / SPACING).ceil() as usize;
        let scale =
            modulus_pa * time_s.powf(alpha) * (alpha * std::f64::consts::PI).sin() / std::f64::consts::PI;
        let mut branches: Vec<MaxwellBranch> = (0..=count)
            .map(|k| {
                let rate = (first + SPACING * k as f64).exp();
                MaxwellBranch {
                    modulus_pa: scale * SPACING * rate.powf(alpha),
                    relaxation_time_s: 1.0 / rate,
                }
            })
            .collect();
        // The sum beyond either end is a geometric series: the spring sum of u^alpha, the dashpot sum of u^(alpha - 1).
        let (slowest, fastest) = (first - SPACING, first + SPACING * (count + 1) as f64);
        branches.push(MaxwellBranch {
            modulus_pa: scale * SPACING * (alpha * slowest).exp() / (1.0 - (-alpha * SPACING).exp()),
            relaxation_time_s: MARGIN * (-slowest).exp(),
        });
        let viscosity =
            scale * SPACING * ((alpha - 1.0) * fastest).exp() / (1.0 - ((alpha - 1.0) * SPACING).exp());
        let time = (-fastest).exp() / MARGIN;
        branches.push(MaxwellBranch { modulus_pa: viscosity / time, relaxation_time_s: time });
        Ok(branches)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Complex;

    #[test]
    fn law_ladder_has_the_fractional_modulus_over_its_band() {
        for exponent in [0.1, 0.3, 0.5, 0.8] {
            let branch = FractionalBranch { modulus_pa: 2e4, time_s: 0.03, exponent };
            let ladder = branch.maxwell_branches([0.1, 1000.0]).expect("valid");
            assert!(ladder.len() < 25, "{}", ladder.len());
            for k in 0..=40 {
                let omega = 0.1 * 1e4_f64.powf(f64::from(k) / 40.0);
                let s = Complex::new(0.0, omega);
                let found: Complex<f64> = ladder
                    .iter()
                    .map(|b| s * b.relaxation_time_s / (s * b.relaxation_time_s + 1.0) * b.modulus_pa)
                    .sum();
                let expected = Complex::new(0.0, omega * 0.03).powf(exponent) * 2e4;
                // Trapezoidal rule 2 exp(-pi^2/0.9) = 3.5e-5; the lumped ends 1/50^2 of what lies beyond them.
                let error = (found - expected).norm() / expected.norm();
                assert!(error < 1e-3, "alpha {exponent}, {omega} rad/s: {error}");
            }
        }
    }

    #[test]
    fn edge_bad_band_and_exponent_are_refused() {
        let branch = FractionalBranch { modulus_pa: 2e4, time_s: 0.03, exponent: 0.3 };
        assert!(matches!(branch.maxwell_branches([1.0, 1.0]), Err(Error::Request { .. })));
        assert!(matches!(branch.maxwell_branches([f64::NAN, 1.0]), Err(Error::Request { .. })));
        let spring = FractionalBranch { exponent: 0.0, ..branch };
        assert!(matches!(
            spring.maxwell_branches([0.1, 10.0]),
            Err(Error::Parameter { key: "exponent", .. })
        ));
    }
}
