//! Recursive least squares that forgets, stands still without excitation and never leaves a box.

use crate::error::{Error, finite, positive};

/// Parameters of an [`Estimator`].
pub const N_PARAMETERS: usize = 4;

/// One value for each parameter.
pub type Parameters = [f64; N_PARAMETERS];

/// What an [`Estimator`] starts from and may do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EstimatorSettings {
    /// First estimate.
    pub start: Parameters,
    /// Lower ends of what may be estimated: the certified set.
    pub low: Parameters,
    /// Upper ends.
    pub high: Parameters,
    /// Standard deviations of the first estimate; the estimator never believes that it knows less.
    pub spread: Parameters,
    /// Share of the old information that is kept at each update; above 0, up to 1.
    pub forgetting: f64,
    /// Standard deviation of the equation's error, in its unit.
    pub noise: f64,
    /// For each parameter, the mean square of its regressor's part that no other regressor explains, below which it is not
    /// estimated; in the square of the equation's unit.
    pub excitation_min: Parameters,
}

/// What an update did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Update {
    /// Parameters that stood still for want of excitation.
    pub frozen: [bool; N_PARAMETERS],
    /// Parameters that would have left the box and were put on its edge.
    pub at_edge: [bool; N_PARAMETERS],
}

/// Estimator of `theta` in `y = phi' theta + error`.
///
/// **Method**: least squares with exponential forgetting. Beside the covariance it keeps the mean of `phi phi'` over the same memory. A
/// parameter is updated while the part of its regressor that the others do not explain (the inverse of the diagonal of the inverse of that mean)
/// is above its floor: persistence of excitation, one parameter at a time. The others keep their value, and what they are known by
/// is not forgotten. After an update each parameter is put back into its box.
///
/// **Source**: Ljung, "System Identification", 1999, section 11.2; Ioannou and Sun, "Robust Adaptive Control", 1996, section 4.4 on
/// projection.
///
/// **Accuracy**: an update costs a fixed number of operations, allocates nothing, and leaves every value finite.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimator {
    settings: EstimatorSettings,
    theta: Parameters,
    covariance: Matrix,
    excitation: Matrix,
}

type Matrix = [[f64; N_PARAMETERS]; N_PARAMETERS];

// Indices stay: they are those of the formulas.
#[allow(clippy::needless_range_loop)]
impl Estimator {
    /// An estimator that knows its first estimate and no more.
    ///
    /// # Errors
    /// [`Error::NotPositive`] or [`Error::NotFinite`] names what is out of range: spreads, noise, floors, a forgetting outside of (0, 1], a box
    /// without the first estimate in it.
    pub fn new(settings: EstimatorSettings) -> Result<Self, Error> {
        positive("noise of the estimator", settings.noise)?;
        positive("forgetting of the estimator", settings.forgetting)?;
        positive(
            "1 + epsilon less the forgetting of the estimator",
            1.0 + f64::EPSILON - settings.forgetting,
        )?;
        let mut covariance = [[0.0; N_PARAMETERS]; N_PARAMETERS];
        for i in 0..N_PARAMETERS {
            positive("spread of a parameter", settings.spread[i])?;
            positive("floor of the excitation", settings.excitation_min[i])?;
            for value in [settings.start[i], settings.low[i], settings.high[i]] {
                finite("start and box of a parameter", value)?;
            }
            positive(
                "height of the box above the start",
                settings.high[i] - settings.start[i] + f64::MIN_POSITIVE,
            )?;
            positive(
                "depth of the box below the start",
                settings.start[i] - settings.low[i] + f64::MIN_POSITIVE,
            )?;
            covariance[i][i] = settings.spread[i] * settings.spread[i];
        }
        let excitation = [[0.0; N_PARAMETERS]; N_PARAMETERS];
        Ok(Self { settings, theta: settings.start, covariance, excitation })
    }

    /// The present estimate.
    #[must_use]
    pub fn estimate(&self) -> Parameters {
        self.theta
    }

    /// Standard deviations of the present estimate, as far as the equation's error is white.
    #[must_use]
    pub fn deviation_squared(&self) -> Parameters {
        core::array::from_fn(|i| self.covariance[i][i])
    }

    /// Takes one equation. One that is not finite is passed over, and everything counts as frozen.
    pub fn update(&mut self, phi: Parameters, y: f64) -> Update {
        if !(y.is_finite() && phi.iter().all(|value| value.is_finite())) {
            return Update { frozen: [true; N_PARAMETERS], ..Update::default() };
        }
        let kept = self.settings.forgetting;
        for i in 0..N_PARAMETERS {
            for j in 0..N_PARAMETERS {
                let mean = &mut self.excitation[i][j];
                *mean = kept * *mean + (1.0 - kept) * phi[i] * phi[j];
            }
        }
        let unexplained = self.unexplained();
        let frozen: [bool; N_PARAMETERS] =
            core::array::from_fn(|i| unexplained[i] < self.settings.excitation_min[i]);
        self.separate(&frozen);
        self.forget(&frozen);
        self.correct(&phi, y, &frozen);
        Update { frozen, at_edge: self.project() }
    }

    /// For each parameter the mean square of what the others leave of its regressor.
    fn unexplained(&self) -> Parameters {
        core::array::from_fn(|target| {
            // Elimination with the target last: its last pivot is what is left.
            let order: [usize; N_PARAMETERS] = core::array::from_fn(|k| {
                if k + 1 == N_PARAMETERS { target } else { k + usize::from(k >= target) }
            });
            let mut m: Matrix =
                core::array::from_fn(|i| core::array::from_fn(|j| self.excitation[order[i]][order[j]]));
            for k in 0..N_PARAMETERS - 1 {
                // A regressor that is explained by those before it explains nothing more.
                if m[k][k] <= SINGULAR * self.excitation[order[k]][order[k]] || m[k][k] <= 0.0 {
                    continue;
                }
                for i in k + 1..N_PARAMETERS {
                    let share = m[i][k] / m[k][k];
                    for j in k + 1..N_PARAMETERS {
                        m[i][j] -= share * m[k][j];
                    }
                }
            }
            m[N_PARAMETERS - 1][N_PARAMETERS - 1].max(0.0)
        })
    }

    /// A parameter that stands still is taken as known: what is learned of the others says nothing about it.
    fn separate(&mut self, frozen: &[bool; N_PARAMETERS]) {
        for i in 0..N_PARAMETERS {
            for j in 0..N_PARAMETERS {
                if i != j && (frozen[i] || frozen[j]) {
                    self.covariance[i][j] = 0.0;
                }
            }
        }
    }

    /// Widens the covariance of what is estimated, but no variance beyond the first one.
    fn forget(&mut self, frozen: &[bool; N_PARAMETERS]) {
        let widen = (1.0 / self.settings.forgetting).sqrt_by_newton();
        let factor: Parameters = core::array::from_fn(|i| {
            let room = self.settings.spread[i] * self.settings.spread[i] / self.covariance[i][i];
            if frozen[i] { 1.0 } else { widen.min(room.max(1.0).sqrt_by_newton()) }
        });
        for i in 0..N_PARAMETERS {
            for j in 0..N_PARAMETERS {
                self.covariance[i][j] *= factor[i] * factor[j];
            }
        }
    }

    fn correct(&mut self, phi: &Parameters, y: f64, frozen: &[bool; N_PARAMETERS]) {
        let active: Parameters = core::array::from_fn(|i| if frozen[i] { 0.0 } else { phi[i] });
        let towards: Parameters =
            core::array::from_fn(|i| (0..N_PARAMETERS).map(|j| self.covariance[i][j] * active[j]).sum());
        let power: f64 = (0..N_PARAMETERS).map(|i| active[i] * towards[i]).sum();
        let total = power + self.settings.noise * self.settings.noise;
        let error = y - (0..N_PARAMETERS).map(|i| phi[i] * self.theta[i]).sum::<f64>();
        for i in 0..N_PARAMETERS {
            self.theta[i] += towards[i] / total * error;
            for j in 0..N_PARAMETERS {
                self.covariance[i][j] -= towards[i] * towards[j] / total;
            }
        }
        for i in 0..N_PARAMETERS {
            // Rounding may not take the last of a variance.
            let floor = VARIANCE_FLOOR * self.settings.spread[i] * self.settings.spread[i];
            self.covariance[i][i] = self.covariance[i][i].max(floor);
        }
    }

    fn project(&mut self) -> [bool; N_PARAMETERS] {
        core::array::from_fn(|i| {
            let inside = self.theta[i].clamp(self.settings.low[i], self.settings.high[i]);
            let left = inside != self.theta[i];
            self.theta[i] = inside;
            left
        })
    }
}

/// Pivots below this share of their diagonal are rounding.
const SINGULAR: f64 = 1e-12;
/// Smallest variance, as a share of the first one.
const VARIANCE_FLOOR: f64 = 1e-12;

/// `core` has no square root.
trait RootByNewton {
    /// Square root of a number from 1 up, by Newton's method; within rounding after the steps that 1e24 would take.
    fn sqrt_by_newton(self) -> Self;
}

impl RootByNewton for f64 {
    fn sqrt_by_newton(self) -> Self {
        let mut root = 0.5 * (self + 1.0);
        for _ in 0..50 {
            root = 0.5 * (root + self / root);
        }
        root
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::test_random::Random;

    fn settings() -> EstimatorSettings {
        EstimatorSettings {
            start: [1.0, 1.0, 0.0, 0.0],
            low: [0.5, 0.6, -0.3, -0.5],
            high: [2.0, 1.7, 0.3, 0.5],
            spread: [0.5, 0.5, 0.2, 0.2],
            forgetting: 0.998,
            noise: 1e-2,
            excitation_min: [1e-4, 1e-4, 1e-4, 1e-3],
        }
    }

    fn symmetric(random: &mut Random) -> f64 {
        random.between(-1.0, 1.0)
    }

    fn excited(random: &mut Random) -> Parameters {
        [0.5 + 0.3 * symmetric(random), 0.1 * symmetric(random), 0.2 * symmetric(random), 1.0]
    }

    fn answer(phi: &Parameters, theta: &Parameters) -> f64 {
        phi.iter().zip(theta).map(|(a, b)| a * b).sum()
    }

    #[test]
    fn law_it_converges_and_follows_a_drift() {
        for seed in 1..6 {
            let mut random = Random::new(seed);
            let mut estimator = Estimator::new(settings()).expect("valid");
            let mut truth = [1.3, 0.8, 0.05, -0.1];
            for k in 0..12_000 {
                // 15 % in 6000 updates, a dozen memories.
                truth[0] = 1.3 - 0.2 * (f64::from(k) / 6000.0 - 0.5).clamp(0.0, 1.0);
                let phi = excited(&mut random);
                let update = estimator.update(phi, answer(&phi, &truth) + 1e-2 * symmetric(&mut random));
                // The first equations know too little to stay clear of the edge.
                assert!(k < 500 || update.at_edge == [false; 4], "seed {seed}, {k}");
            }
            let found = estimator.estimate();
            // 500 equations of memory with errors of 6e-3 rms, regressors of 0.17, 0.06 and 0.12 rms: 5 deviations of each.
            for (i, tolerance) in [0.008, 0.024, 0.012, 0.006].into_iter().enumerate() {
                assert!((found[i] - truth[i]).abs() < tolerance, "seed {seed}, {i}: {found:?} {truth:?}");
            }
        }
    }

    #[test]
    fn law_without_excitation_it_stands_still_whatever_the_equation_says() {
        let mut random = Random::new(3);
        let mut estimator = Estimator::new(settings()).expect("valid");
        for _ in 0..4000 {
            let phi = excited(&mut random);
            estimator.update(phi, answer(&phi, &[1.2, 0.9, 0.0, 0.1]));
        }
        // A plate at rest: regressors that do not move tell gain and offset apart by nothing. Their old excitation fades over ten memories.
        let rest = [0.5, 0.0, 0.1, 1.0];
        for _ in 0..5000 {
            estimator.update(rest, 0.9);
        }
        let before = (estimator.estimate(), estimator.deviation_squared());
        for k in 0..20_000 {
            let update = estimator.update(rest, 0.9 + f64::from(k % 7) * 0.1);
            assert_eq!(update.frozen, [true; 4]);
        }
        assert_eq!((estimator.estimate(), estimator.deviation_squared()), before);
    }

    #[test]
    fn law_a_single_direction_without_excitation_is_frozen_and_the_others_converge() {
        let mut random = Random::new(9);
        let mut estimator = Estimator::new(settings()).expect("valid");
        for _ in 0..6000 {
            let phi = excited(&mut random);
            let phi = [phi[0], 1e-3 * phi[1], phi[2], 1.0];
            let update = estimator.update(phi, answer(&phi, &[1.4, 1.0, -0.1, 0.2]));
            assert!(update.frozen[1]);
        }
        let found = estimator.estimate();
        assert_eq!(found[1].to_bits(), 1.0_f64.to_bits());
        // No error in the equation: only the first estimate, forgotten by 0.998^6000, is left.
        assert!((found[0] - 1.4).abs() < 1e-6 && (found[3] - 0.2).abs() < 1e-6, "{found:?}");
    }

    #[test]
    fn law_it_never_leaves_its_box_and_says_when_it_would() {
        for seed in 1..6 {
            let mut random = Random::new(seed);
            let mut estimator = Estimator::new(settings()).expect("valid");
            let mut n_at_edge = 0;
            for _ in 0..3000 {
                let phi = excited(&mut random);
                // Far outside, and now and then nonsense.
                let y = if symmetric(&mut random) > 0.98 {
                    f64::NAN
                } else {
                    answer(&phi, &[4.0, 0.1, 0.6, -2.0])
                };
                n_at_edge += usize::from(estimator.update(phi, y).at_edge[0]);
                let settings = settings();
                for (i, value) in estimator.estimate().into_iter().enumerate() {
                    assert!((settings.low[i]..=settings.high[i]).contains(&value), "seed {seed}");
                }
            }
            assert!(n_at_edge > 1000, "{n_at_edge}");
        }
    }

    #[test]
    fn edge_settings_out_of_range_are_refused() {
        let good = settings();
        for bad in [
            EstimatorSettings { noise: 0.0, ..good },
            EstimatorSettings { forgetting: 1.1, ..good },
            EstimatorSettings { forgetting: 0.0, ..good },
            EstimatorSettings { spread: [0.0; 4], ..good },
            EstimatorSettings { start: [3.0, 1.0, 0.0, 0.0], ..good },
            EstimatorSettings { low: [f64::NAN; 4], ..good },
        ] {
            assert!(Estimator::new(bad).is_err(), "{bad:?}");
        }
    }
}
