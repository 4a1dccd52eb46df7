//! The H-infinity norm: the peak of the largest singular value of the frequency response, as a proven bracket.

use nalgebra::DMatrix;
use num_complex::Complex64;
use serde::{Deserialize, Serialize};

use crate::riccati::Balanced;
use crate::schur::RealSchur;
use crate::{Continuous, Error, StateSpace, TimeDomain};

/// The peak gain of a stable system over all frequencies, bracketed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PeakGain {
    /// Best value: the largest gain seen, equal to `lower`.
    pub value: f64,
    /// Frequency at which it was seen, in rad/s; infinite (`null` in files) where only the limit reaches it.
    #[serde(with = "infinity_as_null")]
    pub omega_rad_s: f64,
    /// Gain of the frequency response at `omega_rad_s`: the norm is not below it.
    pub lower: f64,
    /// A level that no singular value of the response reaches: the norm is not above it.
    pub upper: f64,
}

/// Returns the H-infinity norm of a stable system, continuous or discrete.
///
/// **Method**: start from the response at zero, infinity and the frequencies of the poles; raise a level just above the
/// largest gain seen; the level's Hamiltonian matrix has the crossing frequencies as its imaginary eigenvalues, and
/// between two of them lies a higher gain. Ends when a level `1e-10` above the largest gain has no crossing, which
/// proves the upper end. Discrete systems go through the bilinear map, which keeps the norm.
///
/// **Source**: Boyd, Balakrishnan and Kabamba 1989; Bruinsma and Steinbuch 1990.
///
/// **Accuracy**: `upper / lower - 1` is `1e-10` unless rounding hides the crossings just above the peak; then the
/// bracket is wider, at most `1e-4`.
///
/// **Errors**: [`Error::Unstable`] for a pole on or beyond the stability boundary, [`Error::PeakNotBounded`],
/// [`Error::EigenvaluesNotConverged`].
///
/// **Example**
/// ```
/// // A resonance with damping ratio 0.1 peaks at 1 / (2 · 0.1 · sqrt(1 - 0.01)).
/// let g = telepulse_lti::TransferFunction::new(&[1.0], &[1.0, 0.2, 1.0])?;
/// let peak = telepulse_lti::hinf_norm(&g.to_state_space())?;
/// assert!((peak.value - 1.0 / (0.2 * 0.99_f64.sqrt())).abs() < 1e-9);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn hinf_norm<D: TimeDomain>(sys: &StateSpace<D>) -> Result<PeakGain, Error> {
    let poles = sys.poles()?;
    if let Some(&pole) = poles.iter().find(|&&p| !sys.domain().is_stable_pole(p)) {
        return Err(Error::Unstable { pole });
    }
    match sys.domain().sample_time_of() {
        None => {
            let parts = (sys.a().clone(), sys.b().clone(), sys.c().clone(), sys.d().clone());
            let sys = StateSpace::<Continuous>::new(parts.0, parts.1, parts.2, parts.3)?;
            Levels { sys: sys.balanced() }.peak(&poles)
        }
        Some(sample_time) => {
            let sys = bilinear(sys)?.balanced();
            let poles = sys.poles()?;
            let peak = Levels { sys }.peak(&poles)?;
            let omega_rad_s = 2.0 * peak.omega_rad_s.atan() / sample_time.seconds();
            Ok(PeakGain { omega_rad_s, ..peak })
        }
    }
}

impl<D: TimeDomain> StateSpace<D> {
    /// Returns the H-infinity norm; see [`hinf_norm`].
    ///
    /// **Errors**: as [`hinf_norm`].
    pub fn hinf_norm(&self) -> Result<PeakGain, Error> {
        hinf_norm(self)
    }
}

/// The continuous system with the same responses under `s = (z - 1) / (z + 1)`.
fn bilinear<D: TimeDomain>(sys: &StateSpace<D>) -> Result<StateSpace<Continuous>, Error> {
    let n = sys.n_states();
    let one = DMatrix::identity(n, n);
    // All poles lie inside of the unit circle, so A + I is regular.
    let inverse = (sys.a() + &one).try_inverse().ok_or(Error::BilinearPole { pole: -1.0 })?;
    let root = std::f64::consts::SQRT_2;
    let b = &inverse * sys.b();
    let d = sys.d() - sys.c() * &b;
    StateSpace::<Continuous>::new(&inverse * (sys.a() - one), b * root, sys.c() * inverse * root, d)
}

/// A gain and where it occurs.
#[derive(Clone, Copy)]
struct Seen {
    gain: f64,
    omega: f64,
}

struct Levels {
    sys: StateSpace<Continuous>,
}

impl Levels {
    fn peak(&self, poles: &[Complex64]) -> Result<PeakGain, Error> {
        let mut best = Seen { gain: largest_singular_value(self.sys.d()), omega: f64::INFINITY };
        if self.sys.n_states() == 0 {
            return Ok(PeakGain { value: best.gain, omega_rad_s: 0.0, lower: best.gain, upper: best.gain });
        }
        for omega in start_frequencies(poles) {
            self.look(omega, &mut best);
        }
        self.refine(&mut best);
        if best.gain == 0.0 && (self.sys.b().amax() == 0.0 || self.sys.c().amax() == 0.0) {
            return Ok(PeakGain { value: 0.0, omega_rad_s: 0.0, lower: 0.0, upper: 0.0 });
        }
        // A system that cancels identically has no gain to start from: take the rounding of its terms.
        let floor = f64::EPSILON * self.sys.b().norm() * self.sys.c().norm()
            / poles.iter().fold(f64::INFINITY, |m, p| m.min(p.re.abs()));
        let mut margin = MARGIN_MIN;
        for _ in 0..LEVELS_MAX {
            let level = (best.gain * (1.0 + margin)).max(floor);
            let crossings = self.crossings(level)?;
            let before = best.gain;
            for (k, &omega) in crossings.candidates.iter().enumerate() {
                self.look(omega, &mut best);
                if let Some(next) = crossings.candidates.get(k + 1) {
                    self.look(0.5 * (omega + next), &mut best);
                }
            }
            if best.gain > level {
                self.refine(&mut best);
                margin = MARGIN_MIN;
            } else if crossings.none_is_certain {
                let upper = level.max(best.gain);
                return Ok(PeakGain { value: best.gain, omega_rad_s: best.omega, lower: best.gain, upper });
            } else if best.gain <= before {
                margin *= 10.0;
                if margin > MARGIN_MAX {
                    return Err(Error::PeakNotBounded { lower: best.gain, level });
                }
            }
        }
        Err(Error::PeakNotBounded { lower: best.gain, level: best.gain * (1.0 + margin) })
    }

    fn gain(&self, omega: f64) -> f64 {
        match self.sys.evaluate(Complex64::new(0.0, omega)) {
            Some(response) => largest_complex_singular_value(&response),
            None => 0.0,
        }
    }

    fn look(&self, omega: f64, best: &mut Seen) {
        let gain = self.gain(omega);
        if gain > best.gain {
            *best = Seen { gain, omega };
        }
    }

    /// Climbs to the local peak next to the best frequency by parabolas of shrinking width.
    fn refine(&self, best: &mut Seen) {
        if !best.omega.is_finite() || best.omega == 0.0 {
            return;
        }
        let mut width = 1e-2 * best.omega;
        for _ in 0..REFINEMENTS_MAX {
            let centre = best.omega;
            let (left, middle, right) = (self.gain(centre - width), best.gain, self.gain(centre + width));
            let curvature = left - 2.0 * middle + right;
            let vertex = if curvature < 0.0 {
                (0.5 * width * (left - right) / curvature).clamp(-width, width)
            } else {
                width.copysign(right - left)
            };
            self.look(centre + vertex, best);
            let moved = (best.omega - centre).abs();
            width = (2.0 * moved).clamp(0.05 * width, width);
        }
    }

    /// Frequencies at which a singular value may equal `level`.
    fn crossings(&self, level: f64) -> Result<Crossings, Error> {
        let (a, b, c, d) = (self.sys.a(), self.sys.b(), self.sys.c(), self.sys.d());
        let n_inputs = self.sys.n_inputs();
        // R = level² I - Dᵀ D is positive definite, since the level is above the gain at infinity.
        let r = DMatrix::identity(n_inputs, n_inputs) * (level * level) - d.tr_mul(d);
        let lu = r.lu();
        let lost = Error::Singular { matrix: "level² I - Dᵀ D", reciprocal_condition: 0.0 };
        let dc = lu.solve(&d.tr_mul(c)).ok_or_else(|| lost.clone())?;
        let rb = lu.solve(&b.transpose()).ok_or(lost)?;
        // G(s) ᵀ-conjugate G(s) has the eigenvalue level² where H has the eigenvalue s. Both products carry 1/level so that
        // the off-diagonal blocks are of like size.
        let g = -(b * rb) * level;
        let q = (c.tr_mul(c) + c.tr_mul(&(d * &dc))) / level;
        let h = Balanced::new(&(a + b * dc), &g, &q).hamiltonian();
        let rounding = ROUNDING * h.nrows() as f64 * f64::EPSILON * h.norm();
        let eigenvalues = RealSchur::new(&h)?.eigenvalues();
        let mut candidates = Vec::new();
        let mut none_is_certain = true;
        for value in eigenvalues.into_iter().filter(|v| v.im >= 0.0) {
            if value.re.abs() <= rounding {
                // On the axis as far as rounding can tell; it is a crossing only if the gain there is near the level.
                let near = self.gain(value.im) > level * (1.0 - NEAR_LEVEL);
                none_is_certain &= !near;
            }
            if value.re.abs() <= rounding.max(NEAR_AXIS * value.norm()) {
                candidates.push(value.im);
            }
        }
        candidates.sort_by(f64::total_cmp);
        Ok(Crossings { candidates, none_is_certain })
    }
}

struct Crossings {
    /// Imaginary parts of eigenvalues near the axis, sorted, in rad/s.
    candidates: Vec<f64>,
    /// Whether no eigenvalue can lie on the axis.
    none_is_certain: bool,
}

/// Zero, the resonances of complex poles and the corners of real ones.
fn start_frequencies(poles: &[Complex64]) -> Vec<f64> {
    let mut frequencies = vec![0.0];
    for pole in poles.iter().filter(|p| p.im >= 0.0) {
        let size = pole.norm();
        let damping = -pole.re / size.max(f64::MIN_POSITIVE);
        // Bruinsma and Steinbuch: the resonance of a lone pair, and a corner where damping hides it.
        frequencies.push(size * (1.0 - 2.0 * damping * damping).max(0.25).sqrt());
        frequencies.push(size);
    }
    frequencies
}

fn largest_singular_value(m: &DMatrix<f64>) -> f64 {
    if m.len() == 1 { m[(0, 0)].abs() } else { m.singular_values().max() }
}

fn largest_complex_singular_value(m: &DMatrix<Complex64>) -> f64 {
    if m.len() == 1 { m[(0, 0)].norm() } else { m.singular_values().max() }
}

/// JSON has no infinity, so files say `null`.
mod infinity_as_null {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub(super) fn serialize<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
        value.is_finite().then_some(*value).serialize(serializer)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
        Ok(Option::<f64>::deserialize(deserializer)?.unwrap_or(f64::INFINITY))
    }
}

/// Relative distance of the first level above the largest gain seen.
const MARGIN_MIN: f64 = 1e-10;
/// Relative width beyond which the bracket is not worth the name.
const MARGIN_MAX: f64 = 1e-4;
/// Levels tried; the iteration converges quadratically and takes two to five.
const LEVELS_MAX: usize = 100;
/// Parabolas per refinement.
const REFINEMENTS_MAX: usize = 12;
/// Rounding of an eigenvalue, in units of the machine precision times size times norm.
const ROUNDING: f64 = 10.0;
/// Eigenvalues this close to the axis, relative to their size, are worth a look at the gain.
const NEAR_AXIS: f64 = 1e-3;
/// An eigenvalue on the axis whose frequency has less than this share below the level is rounding, not a crossing.
const NEAR_LEVEL: f64 = 1e-3;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SampleTime, TransferFunction};
    use rand::{RngExt, SeedableRng};

    fn tf(numerator: &[f64], denominator: &[f64]) -> StateSpace<Continuous> {
        TransferFunction::new(numerator, denominator).expect("proper").to_state_space()
    }

    #[test]
    fn paper_ws_norm_is_02426() {
        // Eq. (17); the peak of b / (s² + 2 zeta w0 s + w0²) is b / (2 zeta w0² sqrt(1 - zeta²)), at w0 sqrt(1 - 2 zeta²).
        let zeta: f64 = 45.0 / (2.0 * 50.0);
        let exact = 487.5 / (2.0 * zeta * 2500.0 * (1.0 - zeta * zeta).sqrt());
        let peak = hinf_norm(&tf(&[487.5], &[1.0, 45.0, 2500.0])).expect("stable");
        assert!((peak.value - exact).abs() < 1e-13 && (peak.value - 0.2426).abs() < 5e-5);
        assert!((peak.omega_rad_s - 50.0 * (1.0 - 2.0 * zeta * zeta).sqrt()).abs() < 1e-5);
        assert!(peak.upper >= exact && peak.upper <= exact * (1.0 + 2e-10));
    }

    #[test]
    fn law_an_all_pass_is_flat() {
        let peak = hinf_norm(&tf(&[1.0, -1.0], &[1.0, 1.0])).expect("stable");
        assert!((peak.value - 1.0).abs() < 1e-12 && peak.upper < 1.0 + 1e-4, "{peak:?}");
    }

    #[test]
    fn law_a_sharp_resonance_is_found() {
        for zeta in [1e-2, 1e-4, 1e-6_f64] {
            let exact = 1.0 / (2.0 * zeta * (1.0 - zeta * zeta).sqrt());
            let peak = hinf_norm(&tf(&[1.0], &[1.0, 2.0 * zeta, 1.0])).expect("stable");
            assert!((peak.value / exact - 1.0).abs() < 1e-9, "{zeta}: {peak:?}");
        }
    }

    #[test]
    fn law_random_systems_are_never_below_a_dense_grid() {
        let seed = 31;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        for trial in 0..300 {
            let n = 1 + trial % 8;
            let mut matrix = |rows, cols| DMatrix::from_fn(rows, cols, |_, _| rng.random_range(-1.0..1.0));
            let mut a: DMatrix<f64> = matrix(n, n);
            let shift =
                crate::eigenvalues::eigenvalues(&a).expect("qr").iter().fold(f64::MIN, |m, p| m.max(p.re));
            a -= DMatrix::identity(n, n) * (shift + 0.01);
            let sys =
                StateSpace::<Continuous>::new(a, matrix(n, 2), matrix(3, n), matrix(3, 2)).expect("shapes");
            let peak = hinf_norm(&sys).unwrap_or_else(|e| panic!("seed {seed} trial {trial}: {e}"));
            assert!(peak.upper / peak.lower < 1.0 + 1e-6, "seed {seed} trial {trial}: {peak:?}");
            for k in 0..400 {
                let omega = 1e-3 * 10.0_f64.powf(6.0 * k as f64 / 399.0);
                let gain = sys.at(omega).expect("no pole on the axis").singular_values().max();
                assert!(gain <= peak.upper, "seed {seed} trial {trial}: {gain} at {omega} beats {peak:?}");
            }
        }
    }

    #[test]
    fn law_discrete_norm_of_a_first_order_low_pass() {
        // 1 / (z - 0.5) peaks at z = 1 with 2; 1 / (z + 0.5) peaks at the Nyquist frequency.
        let ts = SampleTime::new(0.1).expect("positive");
        let m = |v: f64| DMatrix::from_element(1, 1, v);
        for (a, omega) in [(0.5, 0.0), (-0.5, std::f64::consts::PI / 0.1)] {
            let sys = StateSpace::<crate::Discrete>::new(m(a), m(1.0), m(1.0), m(0.0), ts).expect("shapes");
            let peak = hinf_norm(&sys).expect("stable");
            assert!((peak.value - 2.0).abs() < 1e-9, "{peak:?}");
            assert!((peak.omega_rad_s - omega).abs() < 1e-3, "{peak:?}");
        }
    }

    #[test]
    fn edge_unstable_and_zero_systems() {
        assert!(matches!(hinf_norm(&tf(&[1.0], &[1.0, -1.0])), Err(Error::Unstable { .. })));
        assert!(matches!(hinf_norm(&tf(&[1.0], &[1.0, 0.0])), Err(Error::Unstable { .. })));
        let zero = hinf_norm(&tf(&[0.0], &[1.0, 1.0])).expect("stable");
        assert_eq!((zero.lower, zero.upper), (0.0, 0.0));
    }

    #[test]
    fn edge_infinite_frequency_survives_a_file() {
        let peak = PeakGain { value: 1.0, omega_rad_s: f64::INFINITY, lower: 1.0, upper: 1.0 };
        let text = serde_json::to_string(&peak).expect("serializable");
        assert_eq!(serde_json::from_str::<PeakGain>(&text).expect("readable"), peak);
    }
}
