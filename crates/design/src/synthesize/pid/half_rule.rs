//! From a plant of any order to the small model that a tuning rule is made for: the half rule.

use num_complex::Complex64;
use serde::{Deserialize, Serialize};

use super::DelayedPlant;
use super::lag_model::LagModel;
use super::rules::RuleTerms;
use crate::{Error, Result};

/// What is left of a plant for a tuning rule.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum RuleModel {
    /// One or two lags and a dead time.
    Lag(LagModel),
    /// `slope e^{-delay s}/(s (tau2 s + 1))`.
    Integrating {
        /// Slope of the output under a unit command, per s.
        slope_per_s: f64,
        /// Time constant in s; zero for none.
        tau2_s: f64,
        /// Dead time in s.
        delay_s: f64,
    },
    /// `curvature e^{-delay s}/s^2`.
    DoubleIntegrating {
        /// Second derivative of the output under a unit command, per s².
        curvature_per_s2: f64,
        /// Dead time in s.
        delay_s: f64,
    },
    /// `gain wn^2 e^{-delay s}/(s^2 + 2 zeta wn s + wn^2)` with `zeta < 1`.
    Resonant {
        /// Gain at rest.
        gain: f64,
        /// Natural frequency in rad/s.
        omega_n_rad_s: f64,
        /// Damping ratio.
        zeta: f64,
        /// Dead time in s.
        delay_s: f64,
    },
}

impl RuleModel {
    /// The model of a plant by the half rule: the largest neglected time constant goes half to the delay and half to the last one
    /// that is kept, all smaller ones and zeros on the right go to the delay; zeros on the left are first cancelled against a lag.
    ///
    /// `terms` says how many time constants are kept: one for PI, two for PID. `closed_loop_time_s` is the time constant that is
    /// aimed at; it matters only where a zero on the left is slow. One resonant pair of poles is kept as it is for PID, with all
    /// lags in the delay: that is an addition to the source, as is the refusal of whatever else it does not cover.
    ///
    /// **Source**: Skogestad 2003, "Simple analytic rules for model reduction and PID controller tuning", J. Process Control 13,
    /// eqs. (10), (11) and (13) to (15), rules T1 to T3.
    ///
    /// **Accuracy**: poles that are equal are found with an error (a fourfold one to 1e-4 relative), and the model has it too.
    ///
    /// # Errors
    /// [`Error::PidHalfRule`] for a pole or zero that the rule has no reduction for, [`Error::OutOfRange`] for the time.
    ///
    /// # Example
    /// ```
    /// use telepulse_design::synthesize::pid::{DelayedPlant, RuleModel, RuleTerms};
    /// use telepulse_lti::TransferFunction;
    /// // 1/((s + 1)(0.2 s + 1)): tau1 = 1.1, delay 0.1.
    /// let plant = DelayedPlant::new(TransferFunction::new(&[1.0], &[0.2, 1.2, 1.0])?, 0.0)?;
    /// let RuleModel::Lag(model) = RuleModel::of_plant(&plant, RuleTerms::Pi, 0.1)? else { unreachable!() };
    /// assert!((model.tau1_s - 1.1).abs() < 1e-9 && (model.delay_s - 0.1).abs() < 1e-9);
    /// # Ok::<(), telepulse_design::Error>(())
    /// ```
    pub fn of_plant(plant: &DelayedPlant, terms: RuleTerms, closed_loop_time_s: f64) -> Result<Self> {
        if !(closed_loop_time_s.is_finite() && closed_loop_time_s > 0.0) {
            let found = closed_loop_time_s;
            return Err(Error::OutOfRange {
                key: "closed_loop_time_s",
                found,
                allowed: "finite and above 0",
            });
        }
        let mut parts = Parts::of(plant)?;
        for lead in std::mem::take(&mut parts.leads) {
            parts.gain *= cancel_lead(lead, &mut parts.lags, closed_loop_time_s);
        }
        let Parts { gain, lags, pair, n_integrators, mut delay_s, .. } = parts;
        if let Some(pole) = pair {
            if terms == RuleTerms::Pi || n_integrators > 0 {
                return Err(Error::PidHalfRule { root: pole });
            }
            delay_s += lags.iter().sum::<f64>();
            let (omega_n_rad_s, zeta) = (pole.norm(), -pole.re / pole.norm());
            return Ok(Self::Resonant { gain, omega_n_rad_s, zeta, delay_s });
        }
        // An integrator is a lag without end: it is kept first, and the half that it would get does not show in it.
        let n_terms = if terms == RuleTerms::Pi { 1 } else { 2 };
        if n_integrators > n_terms {
            return Err(Error::PidHalfRule { root: Complex64::ZERO });
        }
        let n_kept = n_terms - n_integrators;
        let mut kept: Vec<f64> = lags.iter().copied().take(n_kept).collect();
        if let Some(next) = lags.get(n_kept) {
            if let Some(last) = kept.last_mut() {
                *last += 0.5 * next;
            }
            delay_s += 0.5 * next + lags[n_kept + 1..].iter().sum::<f64>();
        }
        let at = |k: usize| kept.get(k).copied().unwrap_or(0.0);
        Ok(match n_integrators {
            0 => Self::Lag(LagModel { gain, tau1_s: at(0), tau2_s: at(1), delay_s }),
            1 => Self::Integrating { slope_per_s: gain, tau2_s: at(0), delay_s },
            _ => Self::DoubleIntegrating { curvature_per_s2: gain, delay_s },
        })
    }

    /// Dead time of the model in s.
    #[must_use]
    pub fn delay_s(&self) -> f64 {
        match *self {
            Self::Lag(LagModel { delay_s, .. })
            | Self::Integrating { delay_s, .. }
            | Self::DoubleIntegrating { delay_s, .. }
            | Self::Resonant { delay_s, .. } => delay_s,
        }
    }
}

/// A plant as gain, integrators, lags, leads, one resonant pair and dead time; lags and leads slowest first.
struct Parts {
    gain: f64,
    n_integrators: usize,
    lags: Vec<f64>,
    leads: Vec<f64>,
    pair: Option<Complex64>,
    delay_s: f64,
}

impl Parts {
    fn of(plant: &DelayedPlant) -> Result<Self> {
        let poles = plant.rational().poles()?;
        let fastest = poles.iter().fold(0.0_f64, |m, p| m.max(p.norm()));
        let is_origin = |p: &Complex64| p.norm() <= ORIGIN * fastest;
        let n_integrators = poles.iter().filter(|p| is_origin(p)).count();
        let (mut lags, mut pair) = (Vec::new(), None);
        for &pole in poles.iter().filter(|p| !is_origin(p)) {
            // Equal poles are found as a small ring: their mean is what counts, and the sum of 1/p keeps it.
            let real = pole.im.abs() <= REAL * pole.norm();
            if pole.re >= 0.0 || (!real && pole.im > 0.0 && pair.is_some()) {
                return Err(Error::PidHalfRule { root: pole });
            }
            if real {
                lags.push((-1.0 / pole).re);
            } else if pole.im > 0.0 {
                pair = Some(pole);
            }
        }
        let (mut leads, mut delay_s) = (Vec::new(), plant.delay_s());
        for zero in plant.rational().zeros()? {
            if zero.norm() == 0.0 || zero.im.abs() > REAL * zero.norm() {
                return Err(Error::PidHalfRule { root: zero });
            }
            let time = (-1.0 / zero).re;
            if time < 0.0 { delay_s -= time } else { leads.push(time) }
        }
        lags.sort_by(|a, b| b.total_cmp(a));
        leads.sort_by(|a, b| b.total_cmp(a));
        // The gain of what is left once the integrators are taken out.
        let (n, d) = (plant.rational().numerator(), plant.rational().denominator());
        let gain = n[n.len() - 1] / d[d.len() - 1 - n_integrators];
        Ok(Self { gain, n_integrators, lags, leads, pair, delay_s })
    }
}

/// Replaces `(lead s + 1)/(lag s + 1)` by a gain or a smaller lag; returns the gain.
fn cancel_lead(lead: f64, lags: &mut Vec<f64>, closed_loop_time_s: f64) -> f64 {
    // Lags are sorted, slowest first: the closest one that is not faster, unless a faster one is much closer.
    let slower = lags.iter().rposition(|lag| *lag >= lead);
    let faster = lags.iter().position(|lag| *lag < lead);
    let k = match (slower, faster) {
        (Some(a), Some(b)) if lead / lags[b] < (lags[a] / lead).min(CLOSE) => b,
        (Some(k), _) | (None, Some(k)) => k,
        // Against an integrator or a bare gain there is nothing to cancel: the lead makes the loop faster, and is left out.
        (None, None) => return 1.0,
    };
    let lag = lags.remove(k);
    if lead >= lag {
        // T1, T1a, T1b
        let reached = lag.max(closed_loop_time_s);
        return if lead >= reached { lead / reached } else { 1.0 };
    }
    if lead >= 5.0 * closed_loop_time_s {
        // T2
        return lead / lag;
    }
    // T3
    let shortened = lag.min(5.0 * closed_loop_time_s);
    let rest = shortened - lead;
    let place = lags.partition_point(|other| *other > rest);
    lags.insert(place, rest);
    shortened / lag
}

/// Imaginary part, relative, up to which a pole counts as one of several equal real ones.
const REAL: f64 = 0.02;
/// Size, relative to the fastest pole, below which a pole is one at the origin.
const ORIGIN: f64 = 1e-12;
/// Ratio of a lead to a faster lag below which they count as close: 1.6 in Skogestad 2003, text after T3, less the error of a
/// multiple pole. (His example E2 has a ratio of 1.6, which is not close.)
const CLOSE: f64 = 1.6 * (1.0 - 1e-3);

#[cfg(test)]
mod tests {
    use telepulse_lti::{TransferFunction, polynomial};

    use super::*;

    fn plant(leads: &[f64], lags: &[f64], n_integrators: usize, delay_s: f64) -> DelayedPlant {
        let product =
            |times: &[f64]| times.iter().fold(vec![1.0], |p, t| polynomial::multiply(&p, &[*t, 1.0]));
        let mut d = product(lags);
        d.extend(std::iter::repeat_n(0.0, n_integrators));
        DelayedPlant::new(TransferFunction::new(&product(leads), &d).expect("proper"), delay_s)
            .expect("valid")
    }

    /// The time aimed at equal to the delay that comes out, as the paper has it.
    fn tight(plant: &DelayedPlant, terms: RuleTerms) -> RuleModel {
        super::super::rules::tight_time(plant, terms)
            .and_then(|time| RuleModel::of_plant(plant, terms, time))
            .expect("covered")
    }

    fn assert_lags(plant: &DelayedPlant, terms: RuleTerms, wanted: [f64; 4]) {
        let RuleModel::Lag(m) = tight(plant, terms) else { panic!("integrating") };
        for (found, wanted) in [m.gain, m.tau1_s, m.tau2_s, m.delay_s].into_iter().zip(wanted) {
            // Multiple poles are known to 1e-4.
            assert!((found - wanted).abs() < 1e-3 * wanted.max(1.0), "{m:?} {wanted:?}");
        }
    }

    #[test]
    fn paper_skogestad_2003_table_4_reductions() {
        // Example, gain, tau1, tau2, delay for PI and for PID.
        let e1 = plant(&[], &[1.0, 0.2], 0, 0.0);
        assert_lags(&e1, RuleTerms::Pi, [1.0, 1.1, 0.0, 0.1]);
        let e2 = plant(&[-0.3, 0.08], &[2.0, 1.0, 0.4, 0.2, 0.05, 0.05, 0.05], 0, 0.0);
        assert_lags(&e2, RuleTerms::Pi, [1.0, 2.5, 0.0, 1.47]);
        assert_lags(&e2, RuleTerms::Pid, [1.0, 2.0, 1.2, 0.77]);
        // The gain 2 of E3 is left out here: 1.5/2.
        let e3 = plant(&[15.0], &[20.0, 1.0, 0.1, 0.1], 0, 0.0);
        assert_lags(&e3, RuleTerms::Pi, [0.75, 1.05, 0.0, 0.15]);
        assert_lags(&e3, RuleTerms::Pid, [0.75, 1.0, 0.15, 0.05]);
        let e4 = plant(&[], &[1.0; 4], 0, 0.0);
        assert_lags(&e4, RuleTerms::Pi, [1.0, 1.5, 0.0, 2.5]);
        assert_lags(&e4, RuleTerms::Pid, [1.0, 1.0, 1.5, 1.5]);
        let e5 = plant(&[], &[1.0, 0.2, 0.04, 0.008], 0, 0.0);
        assert_lags(&e5, RuleTerms::Pi, [1.0, 1.1, 0.0, 0.148]);
        assert_lags(&e5, RuleTerms::Pid, [1.0, 1.0, 0.22, 0.028]);
        let e7 = plant(&[-2.0], &[1.0; 3], 0, 0.0);
        assert_lags(&e7, RuleTerms::Pi, [1.0, 1.5, 0.0, 3.5]);
        assert_lags(&e7, RuleTerms::Pid, [1.0, 1.0, 1.5, 2.5]);
        let e11 = plant(&[-1.0], &[6.0, 2.0, 2.0], 0, 1.0);
        assert_lags(&e11, RuleTerms::Pi, [1.0, 7.0, 0.0, 5.0]);
        assert_lags(&e11, RuleTerms::Pid, [1.0, 6.0, 3.0, 3.0]);
        let e12 = plant(&[6.0, 3.0], &[10.0, 8.0, 1.0], 0, 0.3);
        assert_lags(&e12, RuleTerms::Pi, [0.225, 1.0, 0.0, 0.3]);
        let e13 = plant(&[2.0], &[10.0, 0.5], 0, 1.0);
        assert_lags(&e13, RuleTerms::Pi, [0.625, 4.5, 0.0, 1.25]);
    }

    #[test]
    fn paper_skogestad_2003_integrating_examples() {
        let near = |found: RuleModel, wanted: [f64; 3]| {
            let RuleModel::Integrating { slope_per_s, tau2_s, delay_s } = found else { panic!("{found:?}") };
            for (f, w) in [slope_per_s, tau2_s, delay_s].into_iter().zip(wanted) {
                assert!((f - w).abs() < 1e-3, "{found:?} {wanted:?}");
            }
        };
        let e6 = plant(&[0.17, 0.17], &[1.0, 1.0, 0.028], 1, 0.0);
        near(tight(&e6, RuleTerms::Pid), [1.0, 1.33, 0.358]);
        let e8 = plant(&[], &[1.0, 1.0], 1, 0.0);
        near(tight(&e8, RuleTerms::Pi), [1.0, 0.0, 1.5]);
        near(tight(&e8, RuleTerms::Pid), [1.0, 1.5, 0.5]);
        let double =
            RuleModel::of_plant(&plant(&[], &[0.4, 0.1], 2, 0.2), RuleTerms::Pid, 1.0).expect("covered");
        let RuleModel::DoubleIntegrating { curvature_per_s2, delay_s } = double else { panic!("{double:?}") };
        assert!((curvature_per_s2 - 1.0).abs() < 1e-9 && (delay_s - 0.5).abs() < 1e-9);
    }

    #[test]
    fn law_the_half_rule_keeps_the_sum_of_all_times() {
        // Half of the largest neglected lag is kept and half becomes delay; with zeros on the right alone nothing is lost.
        for (leads, lags) in [
            (&[-0.3][..], &[3.0, 1.0, 0.5, 0.2][..]),
            (&[], &[5.0, 4.0, 3.0]),
            (&[-1.0, -0.1], &[2.0, 0.3, 0.1]),
        ] {
            let sum = lags.iter().sum::<f64>() - leads.iter().sum::<f64>() + 0.4;
            for terms in [RuleTerms::Pi, RuleTerms::Pid] {
                let model = RuleModel::of_plant(&plant(leads, lags, 0, 0.4), terms, 1.0).expect("covered");
                let RuleModel::Lag(m) = model else { panic!("integrating") };
                assert!((m.tau1_s + m.tau2_s + m.delay_s - sum).abs() < 1e-6, "{m:?}");
            }
        }
    }

    #[test]
    fn edge_plants_without_a_reduction_are_refused() {
        let of = |n: &[f64], d: &[f64]| {
            let plant = DelayedPlant::new(TransferFunction::new(n, d).expect("proper"), 0.0).expect("valid");
            RuleModel::of_plant(&plant, RuleTerms::Pi, 1.0)
        };
        assert!(matches!(of(&[1.0], &[1.0, 0.2, 1.0]), Err(Error::PidHalfRule { .. })));
        assert!(matches!(of(&[1.0], &[1.0, -1.0]), Err(Error::PidHalfRule { .. })));
        assert!(matches!(of(&[1.0], &[1.0, 0.0, 0.0]), Err(Error::PidHalfRule { .. })));
        assert!(matches!(of(&[1.0, 0.0], &[1.0, 3.0, 2.0]), Err(Error::PidHalfRule { .. })));
        assert!(matches!(of(&[1.0, 0.1, 1.0], &[1.0, 3.0, 3.0, 1.0]), Err(Error::PidHalfRule { .. })));
        let lag = plant(&[], &[1.0], 0, 0.0);
        assert!(RuleModel::of_plant(&lag, RuleTerms::Pi, f64::NAN).is_err());
        // A bare gain has no lag at all: a model without time constants, for an integral controller.
        let gain = DelayedPlant::new(TransferFunction::from_gain(2.0).expect("finite"), 0.3).expect("valid");
        let model = RuleModel::of_plant(&gain, RuleTerms::Pi, 1.0).expect("covered");
        assert_eq!(model, RuleModel::Lag(LagModel { gain: 2.0, tau1_s: 0.0, tau2_s: 0.0, delay_s: 0.3 }));
    }
}
