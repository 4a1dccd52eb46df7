//! Disk margins: how far gain and phase of a loop may move together.

use nalgebra::DMatrix;
use num_complex::Complex64;
use serde::{Deserialize, Serialize};
use telepulse_lti::{PeakGain, StateSpace, TimeDomain, hinf_norm};

use crate::Error;

/// A set of factors `f` on a loop, and the largest size at which none of them destabilizes it.
///
/// ```text
///   f(delta) = (1 + (1 - sigma)/2 delta) / (1 - (1 + sigma)/2 delta),   |delta| < alpha, delta complex
/// ```
///
/// `sigma` is the skew: 0 for a disk that treats growth and loss of gain alike (the symmetric margin), 1 for
/// `f = 1 / (1 - delta)`, whose margin is the inverse peak of `S`, and -1 for `f = 1 + delta`, the inverse peak of `T`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DiskMargin {
    /// The skew `sigma`.
    pub skew: f64,
    /// No smaller `delta` destabilizes the loop; infinite where none does at all.
    #[serde(with = "infinity_as_null")]
    pub alpha: f64,
    /// A `delta` of this size does: [`DiskMargin::worst_delta`].
    #[serde(with = "infinity_as_null")]
    pub alpha_upper: f64,
    /// Where the closed loop then has a pole, in rad/s; infinite where only the limit reaches it.
    #[serde(with = "infinity_as_null")]
    pub omega_rad_s: f64,
    /// The loop bears every constant factor between `lowest` and `highest`.
    pub gain: GainInterval,
    /// The loop bears every turn of its phase by less than this, in degrees; 180 where it bears any.
    pub phase_deg: f64,
    /// The smallest destabilizing `delta`, at `omega_rad_s`; `None` where none does.
    pub worst_delta: Option<Complex64>,
}

/// An open interval of factors on a loop gain.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GainInterval {
    /// Lower end; below 1, may be negative, minus infinity (`null` in files) where there is none.
    #[serde(with = "minus_infinity_as_null")]
    pub lowest: f64,
    /// Upper end; above 1, infinite (`null` in files) where there is none.
    #[serde(with = "infinity_as_null")]
    pub highest: f64,
}

/// Returns the disk margin of a loop with one input and one output, closed by negative feedback.
///
/// ```text
///   --->(+)--- f ---> L ---+--->
///        ^ -               |
///        +-----------------+
/// ```
///
/// **Shapes and units**: `loop_` is `L`, continuous or discrete; `skew` without unit.
///
/// **Method**: `alpha = 1 / norm(S + (skew - 1)/2)` with `S = 1/(1 + L)`; the norm is a proven bracket, so no frequency
/// is missed. Gain and phase follow from where the disk of `f` meets the real axis and the unit circle.
///
/// **Source**: Seiler, Packard and Gahinet, "An introduction to disk margins", IEEE Control Systems 40(5), 2020, theorem 1
/// and Eqs. (7) to (10).
///
/// **Accuracy**: that of [`hinf_norm()`]; gain and phase are computed from the guaranteed `alpha`.
///
/// **Errors**: [`Error::UnstableLoop`] where the nominal loop is not stable, [`Error::NotSquareLoop`] for another number of
/// ports, [`Error::OutOfRange`] for a skew that is no number.
///
/// **Example**
/// ```
/// use telepulse_design::verify::disk_margin;
/// // L = 1/s: S - 1/2 = (s - 1) / (2 (s + 1)) has size 1/2 everywhere, so alpha = 2: all gains, and 90 degrees.
/// let integrator = telepulse_lti::TransferFunction::new(&[1.0], &[1.0, 0.0])?.to_state_space();
/// let margin = disk_margin(&integrator, 0.0)?;
/// assert!((margin.alpha - 2.0).abs() < 1e-3);
/// assert!(margin.gain.lowest < 1e-3 && margin.gain.highest > 1e3 && (margin.phase_deg - 90.0).abs() < 0.1);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn disk_margin<D: TimeDomain>(loop_: &StateSpace<D>, skew: f64) -> Result<DiskMargin, Error> {
    let (n_inputs, n_outputs) = (loop_.n_inputs(), loop_.n_outputs());
    if (n_inputs, n_outputs) != (1, 1) {
        return Err(Error::NotSquareLoop { n_inputs, n_outputs, expected: "1 input and 1 output" });
    }
    let margins = disk_margins_one_at_a_time(loop_, skew)?;
    margins.into_iter().next().ok_or(Error::EmptyList { key: "loops" })
}

/// Returns the disk margin of every channel of a loop with as many inputs as outputs, each broken while all others stay closed.
///
/// **Method**: with channel `i` broken, its sensitivity is the diagonal entry `S_ii` of `S = (I + L)^-1`; each is judged as
/// [`disk_margin`] does. Take `L = G K` for the outputs of the plant and `L = K G` for its inputs: the two differ. Channels
/// that move at the same time are judged by a multi-loop margin, whose margin is never larger.
///
/// **Errors**: as [`disk_margin`].
pub fn disk_margins_one_at_a_time<D: TimeDomain>(
    loop_: &StateSpace<D>,
    skew: f64,
) -> Result<Vec<DiskMargin>, Error> {
    let shifted = shifted_sensitivity(loop_, skew)?;
    (0..shifted.n_outputs())
        .map(|channel| {
            let entry = shifted.select(&[channel], &[channel])?;
            DiskMargin::from_norm(&entry, hinf_norm(&entry)?, skew)
        })
        .collect()
}

/// `S + (sigma - 1)/2 I`, stable.
pub(super) fn shifted_sensitivity<D: TimeDomain>(
    loop_: &StateSpace<D>,
    skew: f64,
) -> Result<StateSpace<D>, Error> {
    let (n_inputs, n_outputs) = (loop_.n_inputs(), loop_.n_outputs());
    if n_inputs != n_outputs {
        return Err(Error::NotSquareLoop { n_inputs, n_outputs, expected: "as many inputs as outputs" });
    }
    if !skew.is_finite() {
        return Err(Error::OutOfRange { key: "skew", found: skew, allowed: "finite" });
    }
    let n = n_inputs;
    let gain = |factor: f64| {
        let (zero_b, zero_c) = (DMatrix::zeros(0, n), DMatrix::zeros(n, 0));
        let d = DMatrix::identity(n, n) * factor;
        StateSpace::with_domain(DMatrix::zeros(0, 0), zero_b, zero_c, d, *loop_.domain())
    };
    let sensitivity = gain(1.0)?.feedback(loop_)?;
    let poles = sensitivity.poles()?;
    let unstable: Vec<Complex64> =
        poles.into_iter().filter(|&pole| !loop_.domain().is_stable_pole(pole)).collect();
    if !unstable.is_empty() {
        return Err(Error::UnstableLoop { poles: unstable });
    }
    Ok(sensitivity.parallel(&gain(0.5 * (skew - 1.0))?)?)
}

impl DiskMargin {
    fn from_norm<D: TimeDomain>(shifted: &StateSpace<D>, peak: PeakGain, skew: f64) -> Result<Self, Error> {
        let at_peak = response_or_limit(shifted, peak.omega_rad_s)?[(0, 0)];
        let worst_delta = (at_peak.norm() > 0.0).then(|| at_peak.inv());
        Ok(Self::new(skew, [1.0 / peak.upper, 1.0 / peak.lower], peak.omega_rad_s, worst_delta))
    }

    /// From the bracket of alpha.
    pub(super) fn new(skew: f64, alpha: [f64; 2], omega_rad_s: f64, worst_delta: Option<Complex64>) -> Self {
        Self {
            skew,
            alpha: alpha[0],
            alpha_upper: alpha[1],
            omega_rad_s,
            gain: GainInterval::of_disk(alpha[0], skew),
            phase_deg: phase_of_disk(alpha[0], skew),
            worst_delta,
        }
    }

    /// The factor that belongs to the smallest destabilizing `delta`; `None` where there is none, or it is infinite.
    pub fn worst_factor(&self) -> Option<Complex64> {
        let factor = factor_of(self.worst_delta?, self.skew);
        (factor.re.is_finite() && factor.im.is_finite()).then_some(factor)
    }

    /// The smallest destabilizing `delta` as a stable system of gain `alpha_upper`: put `f(delta)` into the loop and its
    /// closed loop has a pole at `j omega_rad_s`; `None` where no `delta` destabilizes it.
    ///
    /// **Method**: a real number, or an all-pass of first order that has the phase of `delta` at `omega_rad_s`.
    ///
    /// **Errors**: [`Error::System`] where a coefficient overflows.
    pub fn destabilizing_delta<D: TimeDomain>(&self, domain: D) -> Result<Option<StateSpace<D>>, Error> {
        self.worst_delta.map(|delta| all_pass_through(delta, self.omega_rad_s, domain)).transpose()
    }

    /// The factor `f` of [`DiskMargin::destabilizing_delta`] as a system to put in series with the loop.
    ///
    /// **Accuracy**: beyond `alpha (1 + sigma) = 2` the disk of factors has lost infinity, and `f` may be unstable.
    ///
    /// **Errors**: [`Error::System`] where `f` has no proper realization.
    pub fn destabilizing_factor<D: TimeDomain>(&self, domain: D) -> Result<Option<StateSpace<D>>, Error> {
        self.destabilizing_delta(domain)?.map(|delta| factor_system(&delta, self.skew)).transpose()
    }
}

/// `f(delta)`.
fn factor_of(delta: Complex64, skew: f64) -> Complex64 {
    (1.0 + 0.5 * (1.0 - skew) * delta) / (1.0 - 0.5 * (1.0 + skew) * delta)
}

/// `f(delta) = 1 + delta (1 - (1 + sigma)/2 delta)^-1` for a square system `delta`.
pub(super) fn factor_system<D: TimeDomain>(delta: &StateSpace<D>, skew: f64) -> Result<StateSpace<D>, Error> {
    let n = delta.n_inputs();
    let constant = |factor: f64| {
        let d = DMatrix::identity(n, n) * factor;
        StateSpace::with_domain(
            DMatrix::zeros(0, 0),
            DMatrix::zeros(0, n),
            DMatrix::zeros(n, 0),
            d,
            *delta.domain(),
        )
    };
    let fraction = delta.feedback(&constant(-0.5 * (1.0 + skew))?)?;
    Ok(fraction.parallel(&constant(1.0)?)?)
}

/// A stable all-pass of order one or zero that equals `delta` at a frequency.
pub(super) fn all_pass_through<D: TimeDomain>(
    delta: Complex64,
    omega_rad_s: f64,
    domain: D,
) -> Result<StateSpace<D>, Error> {
    let matrix = |v: f64| DMatrix::from_element(1, 1, v);
    let (size, phase) = (delta.norm(), delta.arg());
    if phase.sin().abs() < REAL_ENOUGH || !omega_rad_s.is_finite() || omega_rad_s == 0.0 {
        let d = matrix(size.copysign(delta.re));
        return Ok(StateSpace::with_domain(
            DMatrix::zeros(0, 0),
            DMatrix::zeros(0, 1),
            DMatrix::zeros(1, 0),
            d,
            domain,
        )?);
    }
    // c (beta - p)/(beta + p), with p = s or (z - 1)/(z + 1), has the phase -2 atan(Omega/beta) at p = j Omega.
    let (c, lag) = if phase < 0.0 { (size, -phase) } else { (-size, std::f64::consts::PI - phase) };
    let system = match domain.sample_time_of() {
        None => {
            let beta = omega_rad_s / (0.5 * lag).tan();
            let root = (2.0 * beta).sqrt();
            StateSpace::with_domain(matrix(-beta), matrix(root), matrix(c * root), matrix(-c), domain)
        }
        Some(ts) => {
            let beta = (0.5 * omega_rad_s * ts.seconds()).tan() / (0.5 * lag).tan();
            // c ((beta - 1) z + beta + 1) / ((beta + 1) z + beta - 1) = c (a z - 1)/(a - z) with a = (1 - beta)/(1 + beta).
            let a = (1.0 - beta) / (1.0 + beta);
            let root = 2.0 * beta.sqrt() / (1.0 + beta);
            StateSpace::with_domain(matrix(a), matrix(root), matrix(c * root), matrix(-c * a), domain)
        }
    };
    Ok(system?)
}

/// The response, or the direct term at infinity.
pub(super) fn response_or_limit<D: TimeDomain>(
    system: &StateSpace<D>,
    omega_rad_s: f64,
) -> Result<DMatrix<Complex64>, Error> {
    if omega_rad_s.is_finite() {
        Ok(system.at(omega_rad_s)?)
    } else {
        Ok(system.d().map(|v| Complex64::new(v, 0.0)))
    }
}

impl GainInterval {
    /// The part of the real axis around 1 that the factors of a disk cover: `f` rises with a real `delta` up to its pole.
    fn of_disk(alpha: f64, skew: f64) -> Self {
        let (num, den) = (0.5 * (1.0 - skew), 0.5 * (1.0 + skew));
        let end = |sign: f64| {
            // Written in 1/alpha, so that an infinite alpha has its limit.
            let denominator = 1.0 / alpha - sign * den;
            if denominator <= 0.0 {
                return sign * f64::INFINITY;
            }
            (1.0 / alpha + sign * num) / denominator
        };
        Self { lowest: end(-1.0), highest: end(1.0) }
    }
}

/// The angle at which the circle `|delta| = alpha` meets `|f| = 1`, in degrees.
///
/// On the unit circle `|delta|^2 = |f - 1|^2 / |(1 - sigma)/2 + (1 + sigma)/2 f|^2` rises with the angle from 0 to
/// `4 / sigma^2`.
fn phase_of_disk(alpha: f64, skew: f64) -> f64 {
    if alpha * skew.abs() >= 2.0 || alpha.is_infinite() {
        return 180.0;
    }
    let (square, skew_square) = (alpha * alpha, skew * skew);
    let cosine = (2.0 - 0.5 * square * (1.0 + skew_square)) / (2.0 + 0.5 * square * (1.0 - skew_square));
    cosine.clamp(-1.0, 1.0).acos().to_degrees()
}

/// A sine of the phase below which a perturbation counts as real: the all-pass would have its corner at rounding.
const REAL_ENOUGH: f64 = 1e-12;

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

/// As above, for a lower end.
mod minus_infinity_as_null {
    use serde::{Deserialize, Deserializer};

    pub(super) use super::infinity_as_null::serialize;

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
        Ok(Option::<f64>::deserialize(deserializer)?.unwrap_or(f64::NEG_INFINITY))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use telepulse_lti::{Continuous, Discrete, LoopMargins, SampleTime, TransferFunction};

    fn tf(numerator: &[f64], denominator: &[f64]) -> StateSpace<Continuous> {
        TransferFunction::new(numerator, denominator).expect("proper").to_state_space()
    }

    /// Closed loop of `f L` by negative unity feedback.
    fn closed_poles<D: TimeDomain>(loop_: &StateSpace<D>, factor: &StateSpace<D>) -> Vec<Complex64> {
        let one = StateSpace::with_domain(
            DMatrix::zeros(0, 0),
            DMatrix::zeros(0, 1),
            DMatrix::zeros(1, 0),
            DMatrix::identity(1, 1),
            *loop_.domain(),
        );
        let broken = factor.series(loop_).expect("siso");
        broken.feedback(&one.expect("a gain")).expect("well posed").poles().expect("converges")
    }

    #[test]
    fn law_third_order_lag_has_the_margins_of_its_circles() {
        // 4/(s + 1)³. Skew 1: the inverse peak of S, skew -1: the inverse peak of T, each from its own transfer function.
        let l = tf(&[4.0], &[1.0, 3.0, 3.0, 1.0]);
        let s = hinf_norm(&tf(&[1.0, 3.0, 3.0, 1.0], &[1.0, 3.0, 3.0, 5.0])).expect("stable").value;
        let t = hinf_norm(&tf(&[4.0], &[1.0, 3.0, 3.0, 5.0])).expect("stable").value;
        // S - T over 2 for the symmetric one.
        let half = hinf_norm(&tf(&[1.0, 3.0, 3.0, -3.0], &[1.0, 3.0, 3.0, 5.0])).expect("stable").value;
        for (skew, expected) in [(1.0, 1.0 / s), (-1.0, 1.0 / t), (0.0, 2.0 / half)] {
            let margin = disk_margin(&l, skew).expect("stable");
            assert!((margin.alpha / expected - 1.0).abs() < 1e-8, "{skew}: {margin:?}");
        }
        // Textbook intervals: S gives 1/(1 + alpha) .. 1/(1 - alpha), T gives 1 - alpha .. 1 + alpha.
        let m = disk_margin(&l, 1.0).expect("stable");
        assert!((m.gain.lowest - 1.0 / (1.0 + m.alpha)).abs() < 1e-12);
        assert!((m.gain.highest - 1.0 / (1.0 - m.alpha)).abs() < 1e-12);
        assert!((m.phase_deg - 2.0 * (0.5 * m.alpha).asin().to_degrees()).abs() < 1e-9);
        let m = disk_margin(&l, 0.0).expect("stable");
        assert!((m.phase_deg - 2.0 * (0.5 * m.alpha).atan().to_degrees()).abs() < 1e-9);
        assert!((m.gain.lowest * m.gain.highest - 1.0).abs() < 1e-12);
    }

    #[test]
    fn law_the_worst_factor_puts_a_pole_on_the_axis_and_the_margins_are_inside_the_classical_ones() {
        let seed = 20_200_901;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        let mut n_stable = 0;
        for trial in 0..300 {
            let mut m = |r, c| DMatrix::from_fn(r, c, |_, _| rng.random_range(-1.0..1.0));
            let n = 1 + trial % 4;
            let a = m(n, n) - DMatrix::identity(n, n) * 1.1;
            let l = StateSpace::<Continuous>::new(a, m(n, 1), m(1, n) * 2.0, m(1, 1) * 0.3).expect("valid");
            for skew in [-1.5, -1.0, 0.0, 0.6, 1.0, 2.0] {
                let margin = match disk_margin(&l, skew) {
                    Ok(margin) => margin,
                    Err(Error::UnstableLoop { .. }) => continue,
                    Err(error) => panic!("seed {seed} trial {trial}: {error}"),
                };
                n_stable += 1;
                let classical = LoopMargins::of_state_space(&l).expect("siso");
                let gains = classical.gain_margins.iter().map(|g| g.factor);
                for gain in gains {
                    let inside =
                        margin.gain.lowest * (1.0 + 1e-9) < gain && gain < margin.gain.highest * (1.0 - 1e-9);
                    assert!(!inside, "seed {seed} trial {trial} skew {skew}: {gain} inside {margin:?}");
                }
                if let Some(phase) = classical.phase_margin() {
                    assert!(margin.phase_deg < phase.degrees.abs() + 1e-6, "trial {trial}: {margin:?}");
                }
                // A loop whose worst factor acts at infinity becomes ill-posed instead.
                if margin.omega_rad_s > 1e4 {
                    continue;
                }
                let Some(factor) = margin.destabilizing_factor(Continuous).expect("proper") else { continue };
                let target = Complex64::new(0.0, margin.omega_rad_s);
                let distances = closed_poles(&l, &factor).into_iter().map(|p| (p - target).norm());
                let distance = distances.fold(f64::INFINITY, f64::min);
                assert!(
                    distance < 1e-5 * (1.0 + margin.omega_rad_s),
                    "seed {seed} trial {trial} skew {skew}: {distance:e}, {margin:?}"
                );
            }
        }
        assert!(n_stable > 500, "{n_stable}");
    }

    #[test]
    fn law_random_factors_inside_of_the_disk_never_destabilize() {
        let seed = 7;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        let l = tf(&[25.0], &[1.0, 10.0, 10.0, 10.0]);
        let ts = SampleTime::new(0.02).expect("positive");
        let sampled = l.to_discrete_tustin(ts).expect("no pole at 2/T");
        for skew in [-1.0, 0.0, 0.5, 1.0] {
            let margin = disk_margin(&l, skew).expect("stable");
            let discrete = disk_margin(&sampled, skew).expect("stable");
            // Tustin's map keeps every norm.
            assert!((margin.alpha / discrete.alpha - 1.0).abs() < 1e-8);
            for _ in 0..200 {
                let delta = Complex64::from_polar(
                    margin.alpha * 0.999 * rng.random_range(0.0_f64..1.0).sqrt(),
                    rng.random_range(-3.1..3.1),
                );
                let omega = 10_f64.powf(rng.random_range(-1.0..2.0));
                let factor =
                    factor_system(&all_pass_through(delta, omega, Continuous).expect("finite"), skew);
                let poles = closed_poles(&l, &factor.expect("well posed"));
                assert!(poles.iter().all(|p| p.re < 0.0), "seed {seed}, {delta} at {omega}: {poles:?}");
            }
            let domain = Discrete::new(ts);
            let factor = discrete.destabilizing_factor(domain).expect("proper").expect("some");
            let z = domain.point(discrete.omega_rad_s);
            let poles = closed_poles(&sampled, &factor);
            assert!(poles.iter().any(|p| (p - z).norm() < 1e-6), "{poles:?} lacks {z}");
        }
    }

    #[test]
    fn law_channels_of_a_decoupled_loop_have_their_own_margins() {
        let (first, second) = (tf(&[4.0], &[1.0, 3.0, 3.0, 1.0]), tf(&[2.0], &[1.0, 1.0]));
        let both = first.augment(&second).expect("continuous");
        let margins = disk_margins_one_at_a_time(&both, 0.0).expect("stable");
        for (margin, alone) in margins.iter().zip([first, second]) {
            let expected = disk_margin(&alone, 0.0).expect("stable");
            assert!((margin.alpha / expected.alpha - 1.0).abs() < 1e-8);
        }
    }

    #[test]
    fn edge_nothing_unstable_nothing_wide_and_no_loop_at_all() {
        assert!(matches!(
            disk_margin(&tf(&[20.0], &[1.0, 3.0, 3.0, 1.0]), 0.0),
            Err(Error::UnstableLoop { .. })
        ));
        let wide = StateSpace::<Continuous>::from_gain(DMatrix::zeros(1, 2)).expect("valid");
        assert!(matches!(disk_margin(&wide, 0.0), Err(Error::NotSquareLoop { .. })));
        assert!(matches!(disk_margins_one_at_a_time(&wide, 0.0), Err(Error::NotSquareLoop { .. })));
        assert!(matches!(disk_margin(&tf(&[1.0], &[1.0, 1.0]), f64::NAN), Err(Error::OutOfRange { .. })));
        // No loop: S = 1. With skew -1 nothing ever destabilizes it, with skew 0 only delta = 2, an infinite factor.
        let nothing = StateSpace::<Continuous>::from_gain(DMatrix::zeros(1, 1)).expect("valid");
        let margin = disk_margin(&nothing, -1.0).expect("stable");
        assert_eq!((margin.alpha, margin.phase_deg, margin.worst_delta), (f64::INFINITY, 180.0, None));
        assert_eq!((margin.gain.lowest, margin.gain.highest), (f64::NEG_INFINITY, f64::INFINITY));
        let margin = disk_margin(&nothing, 0.0).expect("stable");
        assert!((margin.alpha - 2.0).abs() < 1e-12 && margin.worst_factor().is_none());
        let text = serde_json::to_string(&margin).expect("serializable");
        assert_eq!(serde_json::from_str::<DiskMargin>(&text).expect("readable"), margin);
    }
}
