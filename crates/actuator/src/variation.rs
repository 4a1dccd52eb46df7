//! How specimens differ from each other and from themselves over time: drift of the modulus, scatter of a batch.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::{ActuatorParameters, ActuatorSpec, Error};

/// Drift of all moduli with age and temperature.
///
/// **Method**: factor `(1 + a log10(1 + age/t_0)) (1 + b (T - T_0))`; physical ageing goes with the logarithm of time
/// (Struik 1978), and over a room's range of temperatures the change is linear.
///
/// **Accuracy**: the form is common, the numbers are the user's: none are built in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModulusDrift {
    /// a, relative change for each decade of age.
    pub ageing_per_decade: f64,
    /// t_0, s: age before which little happens.
    pub onset_s: f64,
    /// b, 1/K.
    pub per_kelvin: f64,
    /// T_0, degrees Celsius.
    pub reference_celsius: f64,
}

impl ModulusDrift {
    /// Moduli at an age (s) and a temperature (degrees Celsius) over those of a new specimen at T_0.
    ///
    /// # Errors
    /// [`Error::Parameter`] for an onset that is not positive; [`Error::Request`] for a negative age, or conditions that would
    /// leave no modulus.
    pub fn factor(&self, age_s: f64, celsius: f64) -> Result<f64, Error> {
        let onset = self.onset_s;
        if !(onset.is_finite() && onset > 0.0) {
            return Err(Error::Parameter { key: "onset_s", allowed: "finite and positive", found: onset });
        }
        if !(age_s.is_finite() && age_s >= 0.0) {
            let (quantity, allowed) = ("age_s", "finite and not negative");
            return Err(Error::Request { quantity, allowed, found: age_s });
        }
        let ageing = 1.0 + self.ageing_per_decade * (1.0 + age_s / onset).log10();
        let warming = 1.0 + self.per_kelvin * (celsius - self.reference_celsius);
        if !(ageing > 0.0 && warming > 0.0) {
            return Err(Error::Request {
                quantity: "modulus factor under drift",
                allowed: "positive for ageing and temperature alike",
                found: ageing.min(warming),
            });
        }
        Ok(ageing * warming)
    }

    /// The parameters of a specimen at an age and a temperature: network and branches have changed alike.
    ///
    /// # Errors
    /// Those of [`ModulusDrift::factor`].
    pub fn apply(
        &self,
        parameters: &ActuatorParameters,
        age_s: f64,
        celsius: f64,
    ) -> Result<ActuatorParameters, Error> {
        let factor = self.factor(age_s, celsius)?;
        let mut spec = parameters.spec().clone();
        scale_moduli(&mut spec, factor, factor);
        ActuatorParameters::new(spec)
    }
}

fn scale_moduli(spec: &mut ActuatorSpec, network: f64, branches: f64) {
    spec.mu_pa *= network;
    for branch in &mut spec.branches {
        branch.modulus_pa *= branches;
    }
}

/// Scatter of a batch: standard deviations of the logarithms, which for small ones are relative standard deviations.
///
/// **Method**: each quantity is multiplied by exp(sigma n), n standard normal and independent of the others, so the median is
/// that of the parameters and nothing can become negative. All branches share one factor.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BatchScatter {
    /// Of the network's modulus.
    pub mu: f64,
    /// Of the branches' moduli.
    pub branches: f64,
    /// Of the permittivity.
    pub permittivity: f64,
    /// Of the undeformed thickness.
    pub thickness: f64,
    /// Of the external damping.
    pub damping: f64,
    /// Of the pre-stretch, about 1: a draw below 1 is refused by the parameters' own check.
    pub prestretch: f64,
}

impl BatchScatter {
    /// Specimen number `idx` of the batch `seed`: the same pair gives the same specimen, whatever else was drawn.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a deviation that is negative or above 1, or a draw that the parameters' check refuses.
    pub fn draw(
        &self,
        parameters: &ActuatorParameters,
        seed: u64,
        idx: u64,
    ) -> Result<ActuatorParameters, Error> {
        for (key, found) in [
            ("scatter of mu", self.mu),
            ("scatter of branches", self.branches),
            ("scatter of permittivity", self.permittivity),
            ("scatter of thickness", self.thickness),
            ("scatter of damping", self.damping),
            ("scatter of prestretch", self.prestretch),
        ] {
            if !(0.0..=1.0).contains(&found) {
                return Err(Error::Parameter { key, allowed: "between 0 and 1", found });
            }
        }
        // Weyl's sequence sets neighbouring specimens apart.
        let mut random = Pcg64::seed_from_u64(seed ^ idx.wrapping_mul(GOLDEN));
        let mut factor = |sigma: f64| (sigma * normal(&mut random)).exp();
        let mut spec = parameters.spec().clone();
        // In the order of the fields: drawing one more later leaves the others as they are.
        let (network, branches) = (factor(self.mu), factor(self.branches));
        scale_moduli(&mut spec, network, branches);
        spec.relative_permittivity *= factor(self.permittivity);
        spec.thickness_m *= factor(self.thickness);
        spec.damping_n_s_per_m *= factor(self.damping);
        spec.prestretch *= factor(self.prestretch);
        ActuatorParameters::new(spec)
    }
}

/// 2^64 over the golden ratio, odd.
const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

/// A standard normal number by the method of Box and Muller 1958.
fn normal(random: &mut Pcg64) -> f64 {
    // 1 - u lies in (0, 1], so the logarithm is finite.
    let (u, w): (f64, f64) = (random.random(), random.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (2.0 * std::f64::consts::PI * w).cos()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ParameterSet;

    #[test]
    fn law_drift_is_one_for_a_new_specimen_and_scales_network_and_branches_alike() {
        let drift = ModulusDrift {
            ageing_per_decade: 0.03,
            onset_s: 3600.0,
            per_kelvin: -0.01,
            reference_celsius: 23.0,
        };
        assert_eq!(drift.factor(0.0, 23.0), Ok(1.0));
        let parameters = ParameterSet::A.parameters();
        // Three decades after the onset, 5 K warmer: 1.09 times 0.95.
        let aged = drift.apply(&parameters, 999.0 * 3600.0, 28.0).expect("valid");
        let (new, old) = (parameters.spec(), aged.spec());
        assert!((old.mu_pa / new.mu_pa - 1.0355).abs() < 1e-12);
        assert!((old.branches[2].modulus_pa / new.branches[2].modulus_pa - 1.0355).abs() < 1e-12);
        assert!(matches!(drift.factor(-1.0, 23.0), Err(Error::Request { quantity: "age_s", .. })));
        assert!(matches!(drift.factor(0.0, 200.0), Err(Error::Request { .. })));
    }

    #[test]
    fn law_draws_repeat_scatter_as_asked_and_leave_the_rest_alone() {
        let parameters = ParameterSet::A.parameters();
        let scatter = BatchScatter { mu: 0.1, thickness: 0.02, ..BatchScatter::default() };
        let seed = 5;
        let draws: Vec<ActuatorParameters> =
            (0..2000).map(|idx| scatter.draw(&parameters, seed, idx).expect("valid")).collect();
        assert_eq!(draws[7], scatter.draw(&parameters, seed, 7).expect("valid"));
        assert_ne!(draws[7], scatter.draw(&parameters, seed + 1, 7).expect("valid"));
        let logs = |of: &dyn Fn(&ActuatorSpec) -> f64| -> [f64; 2] {
            let logs: Vec<f64> = draws.iter().map(|d| (of(d.spec()) / of(parameters.spec())).ln()).collect();
            let mean = logs.iter().sum::<f64>() / logs.len() as f64;
            let square = logs.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / logs.len() as f64;
            [mean, square.sqrt()]
        };
        // Standard error of a mean of 2000: sigma/45, of a deviation sigma/63; four of them.
        let [mean, deviation] = logs(&|spec| spec.mu_pa);
        assert!(mean.abs() < 0.009 && (deviation - 0.1).abs() < 0.0064, "{mean} {deviation}");
        let [mean, deviation] = logs(&|spec| spec.thickness_m);
        assert!(mean.abs() < 0.0018 && (deviation - 0.02).abs() < 0.0013, "{mean} {deviation}");
        assert_eq!(logs(&|spec| spec.relative_permittivity), [0.0, 0.0]);
        let bad = BatchScatter { mu: -0.1, ..scatter };
        assert!(matches!(bad.draw(&parameters, seed, 0), Err(Error::Parameter { key: "scatter of mu", .. })));
    }
}
