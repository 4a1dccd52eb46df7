//! H2 and Hankel norm, and how far a system is from instability.

use nalgebra::DMatrix;
use num_complex::Complex64;

use crate::reduce::{controllability_factor, hankel_singular_values};
use crate::{Error, StateSpace, TimeDomain, hinf_norm};

/// How far the poles of a system, and its state matrix, are from the stability boundary.
#[derive(Debug, Clone, PartialEq)]
pub struct StabilityMargin {
    /// Whether every pole lies inside.
    pub is_stable: bool,
    /// The pole nearest to the boundary, or farthest outside. `None` without states.
    pub critical_pole: Option<Complex64>,
    /// Distance of that pole inside the boundary: minus the spectral abscissa in rad/s (continuous), one minus the spectral
    /// radius (discrete). Negative outside; infinite without states.
    pub pole_margin: f64,
    /// The spectral norm of the least complex change of `A` that puts a pole on the boundary, for a stable system: a
    /// proven bracket. `None` for one that is not stable.
    pub distance: Option<InstabilityDistance>,
}

/// Bracket of the distance to instability.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InstabilityDistance {
    /// No change of `A` below this makes it unstable.
    pub lower: f64,
    /// Some change of this size does.
    pub upper: f64,
    /// Where the pole then lies, in rad/s.
    pub omega_rad_s: f64,
}

/// The H2 norm: root of the summed output power for white noise of unit intensity at every input.
///
/// **Shapes and units**: output unit over input unit, times `sqrt(rad/s)` for a continuous system.
///
/// **Method**: `|C S|` in the Frobenius norm with `P = S Sᵀ` the controllability Gramian in factored form; `D` adds to it in
/// discrete time.
///
/// **Source**: Hammarling 1982 for the factor; Zhou, Doyle and Glover 1996, lemma 4.4.
///
/// **Errors**: [`Error::DirectTerm`] for a continuous system whose `D` is not zero, for its norm is infinite;
/// [`Error::Unstable`], for modes that no port sees as well ([`crate::reduce::minimal_realization`] leaves them out);
/// [`Error::EigenvaluesNotConverged`], [`Error::Overflow`].
///
/// **Example**: the norm of `1/(s + 1)` is `1/sqrt(2)`.
/// ```
/// use telepulse_lti::{TransferFunction, norms::h2_norm};
/// let lag = TransferFunction::new(&[1.0], &[1.0, 1.0])?.to_state_space();
/// assert!((h2_norm(&lag)? - 0.5_f64.sqrt()).abs() < 1e-15);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn h2_norm<D: TimeDomain>(sys: &StateSpace<D>) -> Result<f64, Error> {
    let states = (sys.c() * controllability_factor(sys)?).norm();
    let direct = sys.d().norm();
    let continuous = sys.domain().sample_time_of().is_none();
    if continuous && direct > 0.0 {
        return Err(Error::DirectTerm { norm: direct });
    }
    finite(states.hypot(direct), "the H2 norm")
}

/// The Hankel norm: the most that past input energy can give as future output energy, as a gain.
///
/// **Method**: the largest Hankel singular value, from factors of both Gramians. `D` has no part in it.
///
/// **Source**: Glover 1984, section 2.
///
/// **Errors**: those of [`hankel_singular_values`]; [`Error::Overflow`].
///
/// **Example**: the norm of `1/(s + 1)` is one half.
/// ```
/// use telepulse_lti::{TransferFunction, norms::hankel_norm};
/// let lag = TransferFunction::new(&[1.0], &[1.0, 1.0])?.to_state_space();
/// assert!((hankel_norm(&lag)? - 0.5).abs() < 1e-15);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn hankel_norm<D: TimeDomain>(sys: &StateSpace<D>) -> Result<f64, Error> {
    finite(hankel_singular_values(sys)?.first().copied().unwrap_or(0.0), "the Hankel norm")
}

/// The margins of the poles and of the state matrix to instability.
///
/// **Method**: eigenvalues for the poles. The distance is one over the H-infinity norm of the resolvent, so its bracket is
/// that of [`hinf_norm()`]; it depends on the coordinates, as the poles do not.
///
/// **Source**: Van Loan 1985, "How near is a stable matrix to an unstable matrix?"; Byers 1988.
///
/// **Errors**: those of [`hinf_norm()`].
///
/// **Example**: a strong coupling makes two fast modes fragile.
/// ```
/// use nalgebra::dmatrix;
/// use telepulse_lti::{Continuous, StateSpace, norms::stability_margin};
/// let a = dmatrix![-1.0, 100.0; 0.0, -1.0];
/// let sys = StateSpace::<Continuous>::new(a, dmatrix![0.0; 1.0], dmatrix![1.0, 0.0], dmatrix![0.0])?;
/// let margin = stability_margin(&sys)?;
/// assert!((margin.pole_margin - 1.0).abs() < 1e-12);
/// assert!(margin.distance.is_some_and(|d| d.upper < 0.0101));
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn stability_margin<D: TimeDomain>(sys: &StateSpace<D>) -> Result<StabilityMargin, Error> {
    let continuous = sys.domain().sample_time_of().is_none();
    let margin = |pole: &Complex64| if continuous { -pole.re } else { 1.0 - pole.norm() };
    let poles = sys.poles()?;
    let critical_pole = poles.iter().copied().min_by(|p, q| margin(p).total_cmp(&margin(q)));
    let is_stable = poles.iter().all(|&p| sys.domain().is_stable_pole(p));
    let mut distance = None;
    if is_stable {
        let n = sys.n_states();
        distance = Some(InstabilityDistance { lower: f64::INFINITY, upper: f64::INFINITY, omega_rad_s: 0.0 });
        if n > 0 {
            let (eye, zero) = (DMatrix::identity(n, n), DMatrix::zeros(n, n));
            let resolvent = StateSpace::with_domain(sys.a().clone(), eye.clone(), eye, zero, *sys.domain())?;
            let peak = hinf_norm(&resolvent)?;
            distance = Some(InstabilityDistance {
                lower: 1.0 / peak.upper,
                upper: 1.0 / peak.lower,
                omega_rad_s: peak.omega_rad_s,
            });
        }
    }
    let pole_margin = critical_pole.as_ref().map_or(f64::INFINITY, margin);
    Ok(StabilityMargin { is_stable, critical_pole, pole_margin, distance })
}

fn finite(value: f64, operation: &'static str) -> Result<f64, Error> {
    if value.is_finite() { Ok(value) } else { Err(Error::Overflow { operation }) }
}

#[cfg(test)]
mod tests {
    use nalgebra::dmatrix;

    use super::*;
    use crate::reduce::testing;
    use crate::{Continuous, Discrete, SampleTime, TransferFunction};

    fn close(found: f64, expected: f64, relative: f64, what: &str) {
        assert!((found - expected).abs() <= relative * expected.abs(), "{what}: {found:e} for {expected:e}");
    }

    #[test]
    fn law_second_order_lag_has_its_textbook_norm() {
        for (omega, zeta) in [(1.0_f64, 0.5), (300.0, 1e-3), (1e-4, 2.0)] {
            let w2 = omega * omega;
            let sys = TransferFunction::new(&[w2], &[1.0, 2.0 * zeta * omega, w2]).expect("proper");
            // The integral of |G|^2 over all frequencies is omega/(4 zeta).
            let found = h2_norm(&sys.to_state_space()).expect("stable");
            close(found, (omega / (4.0 * zeta)).sqrt(), 1e-12, "h2");
        }
    }

    /// Markov parameters `C A^k B`, by powers.
    fn markov(sys: &StateSpace<Discrete>, count: usize) -> Vec<DMatrix<f64>> {
        let mut x = sys.b().clone();
        (0..count)
            .map(|_| {
                let h = sys.c() * &x;
                x = sys.a() * &x;
                h
            })
            .collect()
    }

    #[test]
    fn law_discrete_norms_are_those_of_the_impulse_response() {
        for seed in 0..20 {
            let sys = testing::discrete(seed, 1 + seed as usize % 6, 2, 1 + seed as usize % 3);
            // 0.95^600 = 4e-14.
            let h = markov(&sys, 800);
            let energy: f64 = h.iter().map(DMatrix::norm_squared).sum::<f64>() + sys.d().norm_squared();
            close(h2_norm(&sys).expect("stable"), energy.sqrt(), 1e-9, "h2");
            // Largest gain of the infinite Hankel matrix, by power iteration on a finite one.
            let (m, p, size) = (sys.n_inputs(), sys.n_outputs(), 150);
            let hankel = DMatrix::from_fn(size * p, size * m, |i, j| h[i / p + j / m][(i % p, j % m)]);
            let mut x = DMatrix::from_element(size * m, 1, 1.0);
            let mut gain = 0.0;
            for _ in 0..300 {
                let y = &hankel * &x;
                gain = y.norm() / x.norm();
                x = hankel.tr_mul(&y);
                x /= x.norm();
            }
            let found = hankel_norm(&sys).expect("stable");
            // What 150 of infinitely many rows leave out is 0.95^300 = 2e-7; the iteration comes from below.
            assert!(gain <= found * (1.0 + 1e-9), "seed {seed}: {gain} {found}");
            close(gain, found, 1e-3, "hankel");
        }
    }

    #[test]
    fn law_continuous_h2_is_the_integral_over_frequency() {
        for seed in 0..10 {
            let sys = testing::continuous(seed, 5, 2, 2);
            let sys = StateSpace::<Continuous>::new(
                sys.a().clone(),
                sys.b().clone(),
                sys.c().clone(),
                DMatrix::zeros(2, 2),
            )
            .expect("shapes");
            // omega = tan(theta/2) makes the half axis finite; midpoint rule on a smooth periodic integrand.
            let (points, mut sum) = (20_000, 0.0);
            for k in 0..points {
                let half = std::f64::consts::FRAC_PI_2 * (f64::from(k) + 0.5) / f64::from(points);
                let omega = 10.0 * half.tan();
                sum += sys.at(omega).expect("stable").norm_squared() * 10.0 / half.cos().powi(2);
            }
            let integral = sum * std::f64::consts::FRAC_PI_2 / f64::from(points) / std::f64::consts::PI;
            close(h2_norm(&sys).expect("stable"), integral.sqrt(), 1e-6, &format!("seed {seed}"));
        }
    }

    #[test]
    fn law_transposition_and_similarity_change_nothing() {
        for seed in 0..20 {
            let sys = testing::discrete(seed, 5, 3, 2);
            let t = testing::continuous(seed + 700, 5, 5, 5).b() + DMatrix::identity(5, 5) * 3.0;
            let inverse = t.clone().try_inverse().expect("diagonally heavy");
            let domain = *sys.domain();
            let moved = StateSpace::with_domain(
                &inverse * sys.a() * &t,
                &inverse * sys.b(),
                sys.c() * &t,
                sys.d().clone(),
                domain,
            )
            .expect("shapes");
            let turned = StateSpace::with_domain(
                sys.a().transpose(),
                sys.c().transpose(),
                sys.b().transpose(),
                sys.d().transpose(),
                domain,
            )
            .expect("shapes");
            let (h2, hankel) = (h2_norm(&sys).expect("stable"), hankel_norm(&sys).expect("stable"));
            for other in [&moved, &turned] {
                close(h2_norm(other).expect("stable"), h2, 1e-10, "h2");
                close(hankel_norm(other).expect("stable"), hankel, 1e-10, "hankel");
            }
            assert!(hankel <= hinf_norm(&sys).expect("stable").upper * (1.0 + 1e-12));
            let one = stability_margin(&sys).expect("poles");
            let two = stability_margin(&moved).expect("poles");
            close(two.pole_margin, one.pole_margin, 1e-8, "pole margin");
        }
    }

    #[test]
    fn law_no_smaller_change_destabilises_and_one_of_that_size_does() {
        for seed in 0..20 {
            let sys = testing::continuous(seed, 5, 1, 1);
            let margin = stability_margin(&sys).expect("poles");
            let distance = margin.distance.expect("stable");
            assert!(margin.is_stable && distance.lower <= margin.pole_margin * (1.0 + 1e-9));
            let shifted = |omega: f64| {
                let point = DMatrix::from_diagonal_element(5, 5, Complex64::new(0.0, omega));
                (point - sys.a().map(|v| Complex64::new(v, 0.0))).singular_values().min()
            };
            for k in 0..200 {
                let omega = 10f64.powf(-2.0 + 0.03 * f64::from(k));
                assert!(shifted(omega) >= distance.lower * (1.0 - 1e-9), "seed {seed} at {omega}");
            }
            let there = shifted(distance.omega_rad_s);
            assert!(there <= distance.upper * (1.0 + 1e-6), "seed {seed}: {there} {distance:?}");
        }
    }

    #[test]
    fn edge_infinite_undefined_and_empty() {
        let direct = TransferFunction::new(&[1.0, 2.0], &[1.0, 1.0]).expect("proper").to_state_space();
        assert_eq!(h2_norm(&direct), Err(Error::DirectTerm { norm: 1.0 }));
        for pole in [0.0, 3.0] {
            let sys = TransferFunction::new(&[1.0], &[1.0, -pole]).expect("proper").to_state_space();
            assert!(matches!(h2_norm(&sys), Err(Error::Unstable { .. })), "{pole}");
            assert!(matches!(hankel_norm(&sys), Err(Error::Unstable { .. })), "{pole}");
            let margin = stability_margin(&sys).expect("poles");
            assert!(!margin.is_stable && margin.distance.is_none() && margin.pole_margin == -pole);
        }
        let ts = SampleTime::new(0.1).expect("positive");
        let gain = StateSpace::<Discrete>::new(
            DMatrix::zeros(0, 0),
            DMatrix::zeros(0, 2),
            DMatrix::zeros(1, 0),
            dmatrix![3.0, 4.0],
            ts,
        )
        .expect("ports");
        assert_eq!((h2_norm(&gain), hankel_norm(&gain)), (Ok(5.0), Ok(0.0)));
        let margin = stability_margin(&gain).expect("no poles");
        assert!(margin.is_stable && margin.critical_pole.is_none() && margin.pole_margin.is_infinite());
    }
}
