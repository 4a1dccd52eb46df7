//! How many closed-loop poles of a loop with dead time are not stable, by two routes.
#![allow(non_snake_case)]

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use num_complex::Complex64;
use telepulse_lti::{TransferFunction, polynomial};

use super::factors::{distance_to_segment, inflate};
use crate::{Error, Result};

/// The characteristic function `D(s) + N(s) e^{-s delay}` of a loop.
#[derive(Debug, Clone)]
pub(super) struct Characteristic {
    pub(super) N: Vec<f64>,
    pub(super) D: Vec<f64>,
    pub(super) delay_s: f64,
}

/// A frequency at which the loop gain is one.
#[derive(Debug, Clone, Copy)]
pub(super) struct GainCrossing {
    pub(super) omega: f64,
    /// Whether the gain falls there, so that more delay moves a pair of poles to the right.
    pub(super) falls: bool,
    /// `omega tau` at which poles cross, in `[0, 2 pi)`.
    pub(super) angle: f64,
}

impl Characteristic {
    pub(super) fn new(plant: &TransferFunction, controller: &TransferFunction, delay_s: f64) -> Self {
        Self {
            N: polynomial::multiply(plant.numerator(), controller.numerator()),
            D: polynomial::multiply(plant.denominator(), controller.denominator()),
            delay_s,
        }
    }

    /// The number of closed-loop poles with real part at least zero.
    ///
    /// **Method**: without delay, roots. With delay, the direct method: poles cross the axis only at frequencies where
    /// `|D| = |N|`, the positive real roots of a polynomial in `omega^2`; at each, the delays of the crossings are known in
    /// closed form and the direction is that of the gain. So the count at the delay is the count without delay plus the crossings
    /// up to it.
    ///
    /// **Source**: Walton and Marshall 1987, "Direct method for TDS stability analysis", IEE Proceedings D 134(2).
    ///
    /// **Errors**: [`Error::PidLoopNeutral`] for a loop gain of one or more at infinite frequency together with a delay;
    /// [`Error::PidStabilityUncertain`] where the crossings contradict each other.
    pub(super) fn n_unstable(&self) -> Result<usize> {
        let (N, D, delay_s) = self.scaled();
        let at_infinity = self.gain_at_infinity();
        let closed = polynomial::add(&D, &N);
        if at_infinity > 0.0 && closed[0].abs() <= 1e-12 * D[0].abs() {
            return Err(Error::PidLoopNeutral { gain: at_infinity });
        }
        let n_without_delay = polynomial::roots(&closed)?.iter().filter(|p| p.re >= 0.0).count();
        if delay_s == 0.0 {
            return Ok(n_without_delay);
        }
        if at_infinity >= 1.0 {
            return Err(Error::PidLoopNeutral { gain: at_infinity });
        }
        if closed[closed.len() - 1] == 0.0 {
            // A root at the origin, whatever the delay.
            return Ok(n_without_delay.max(1));
        }
        let mut count = n_without_delay as i64;
        for crossing in crossings(&N, &D)? {
            let turned = crossing.omega * delay_s;
            if turned >= crossing.angle {
                let times = ((turned - crossing.angle) / TAU).floor() as i64 + 1;
                count += 2 * times * if crossing.falls { 1 } else { -1 };
            }
        }
        usize::try_from(count).map_err(|_| Error::PidStabilityUncertain { direct: count, nyquist: None })
    }

    /// Frequencies of loop gain one, in rad/s, rising.
    pub(super) fn gain_crossings(&self) -> Result<Vec<GainCrossing>> {
        let scale = self.scale();
        let (N, D, _) = self.scaled();
        let mut found = crossings(&N, &D)?;
        found.iter_mut().for_each(|c| c.omega *= scale);
        found.sort_by(|a, b| a.omega.total_cmp(&b.omega));
        Ok(found)
    }

    /// Limit of `|N/D|` for large frequencies.
    pub(super) fn gain_at_infinity(&self) -> f64 {
        if self.N.len() == self.D.len() { (self.N[0] / self.D[0]).abs() } else { 0.0 }
    }

    /// Geometric mean of the sizes of the open-loop poles that are not at the origin.
    fn scale(&self) -> f64 {
        let trailing = self.D.iter().rev().take_while(|&&c| c == 0.0).count();
        let n = self.D.len() - 1 - trailing;
        if n == 0 {
            return 1.0;
        }
        let size = (self.D[n] / self.D[0]).abs().powf(1.0 / n as f64);
        if size.is_finite() && size > 0.0 { size } else { 1.0 }
    }

    /// N, D and delay with `scale` as the unit of frequency, leading coefficient of D one.
    fn scaled(&self) -> (Vec<f64>, Vec<f64>, f64) {
        let scale = self.scale();
        let n = self.D.len() - 1;
        let of = |p: &[f64]| -> Vec<f64> {
            let degree = p.len() - 1;
            p.iter()
                .enumerate()
                .map(|(k, c)| c / self.D[0] * scale.powi((degree - k) as i32 - n as i32))
                .collect()
        };
        (of(&self.N), of(&self.D), self.delay_s * scale)
    }

    /// The same number by the argument principle, each step of the argument certified.
    ///
    /// **Method**: `f = D + N e^{-s delay}` of degree n has `n/2 - (change of its argument from 0 to infinity)/pi` zeros on the
    /// right. The axis is cut until on every piece `|f(j omega) - f(centre)| < |f(centre)|` is proven from the logarithmic
    /// derivatives of D and N; then the argument moves by less than half a turn and its principal value is exact. Beyond the last
    /// piece `|N/D| < 1`, so f stays in the half plane of D, whose argument is known from its roots.
    ///
    /// **Errors**: [`Error::PidStabilityUncertain`] where no such cutting exists: a closed-loop pole on or next to the axis.
    pub(super) fn n_unstable_nyquist(&self) -> Result<usize> {
        let (N, D, delay_s) = self.scaled();
        if self.gain_at_infinity() >= 1.0 {
            return Err(Error::PidLoopNeutral { gain: self.gain_at_infinity() });
        }
        let uncertain = Error::PidStabilityUncertain { direct: -1, nyquist: None };
        let (n_roots, d_roots) = (polynomial::roots(&N)?, polynomial::roots(&D)?);
        let value = |w: f64| {
            let s = Complex64::new(0.0, w);
            let turned = polynomial::evaluate(&N, s) * Complex64::from_polar(1.0, -w * delay_s);
            (polynomial::evaluate(&D, s), turned)
        };
        let largest = n_roots.iter().chain(&d_roots).fold(1.0_f64, |m, r| m.max(r.norm()));
        let mut top = 4.0 * largest;
        // |N/D| beyond `top` from the factors: (1 + |z|/top) and (1 - |p|/top).
        let bound = |top: f64| {
            let zeros: f64 = n_roots.iter().map(|z| 1.0 + z.norm() / top).product();
            let poles: f64 = d_roots.iter().map(|p| 1.0 - p.norm() / top).product();
            N[0].abs() * zeros / poles * top.powi(N.len() as i32 - D.len() as i32)
        };
        let mut growths = 0;
        while bound(top) >= 1.0 {
            top *= 2.0;
            growths += 1;
            if growths > GROWTHS_MAX {
                return Err(uncertain);
            }
        }
        let mut argument = 0.0;
        let mut stack = vec![(0.0, top)];
        let mut pieces = 0;
        while let Some((a, b)) = stack.pop() {
            pieces += 1;
            if pieces > PIECES_MAX {
                return Err(uncertain);
            }
            let (centre, radius) = (0.5 * (a + b), 0.5 * (b - a));
            let (d, n) = value(centre);
            let d_rate: f64 = d_roots.iter().map(|p| 1.0 / distance_to_segment(*p, a, b)).sum();
            let n_rate: f64 =
                n_roots.iter().map(|z| 1.0 / distance_to_segment(*z, a, b)).sum::<f64>() + delay_s;
            let by_rates = d.norm() * inflate(d_rate * radius) + n.norm() * inflate(n_rate * radius);
            let moved = by_rates.min(taylor_change(&D, &N, delay_s, centre, radius));
            if moved < (d + n).norm() {
                let ends = (value(a), value(b));
                argument += ((ends.1.0 + ends.1.1) / (ends.0.0 + ends.0.1)).arg();
            } else {
                stack.push((a, centre));
                stack.push((centre, b));
            }
        }
        // From `top` to infinity f/D stays in the right half plane and D turns by what its roots say.
        let (d, n) = value(top);
        argument -= ((d + n) / d).arg();
        for p in &d_roots {
            argument += FRAC_PI_2 - (Complex64::new(0.0, top) - p).arg();
        }
        let count = (D.len() - 1) as f64 / 2.0 - argument / PI;
        // Conjugate symmetry leaves an integer, or for a neutral loop one within asin(q)/pi < 1/2.
        let nearest = count.round();
        if (count - nearest).abs() > 1e-3 && self.gain_at_infinity() == 0.0 || nearest < 0.0 {
            return Err(uncertain);
        }
        Ok(nearest as usize)
    }

    /// Both counts, which have to agree.
    ///
    /// **Errors**: [`Error::PidStabilityUncertain`] where they do not.
    pub(super) fn n_unstable_certified(&self) -> Result<usize> {
        let direct = self.n_unstable()?;
        if self.delay_s == 0.0 {
            return Ok(direct);
        }
        let nyquist = match self.n_unstable_nyquist() {
            Ok(count) => count,
            Err(Error::PidStabilityUncertain { .. }) if direct > 0 => return Ok(direct),
            Err(error) => return Err(error),
        };
        if nyquist != direct {
            return Err(Error::PidStabilityUncertain { direct: direct as i64, nyquist: Some(nyquist) });
        }
        Ok(direct)
    }
}

/// Bound of `|f(j omega) - f(j centre)|` for `|omega - centre| <= radius` from the coefficients; sharp near the origin, where
/// the roots there make the logarithmic derivative infinite.
fn taylor_change(D: &[f64], N: &[f64], delay_s: f64, centre: f64, radius: f64) -> f64 {
    let change = |p: &[f64]| -> f64 {
        let degree = p.len() - 1;
        let term = |k: usize| (centre + radius).powi(k as i32) - centre.powi(k as i32);
        p.iter().enumerate().map(|(k, c)| c.abs() * term(degree - k)).sum()
    };
    let size = |p: &[f64]| p.iter().fold(0.0, |sum, c| sum * (centre + radius) + c.abs());
    change(D) + change(N) + size(N) * delay_s * radius
}

/// Frequencies where `|N| = |D|` with direction and angle.
fn crossings(N: &[f64], D: &[f64]) -> Result<Vec<GainCrossing>> {
    let difference =
        polynomial::add(&squared_magnitude(D), &squared_magnitude(N).iter().map(|c| -c).collect::<Vec<_>>());
    let difference = polynomial::trim(&difference);
    if difference.len() < 2 {
        return Ok(Vec::new());
    }
    let slope = polynomial::derivative(difference);
    let mut found = Vec::new();
    for root in polynomial::roots(difference)?.iter().filter(|x| x.im == 0.0 && x.re > 0.0) {
        let omega = root.re.sqrt();
        let s = Complex64::new(0.0, omega);
        // e^{j omega tau} = -N/D
        let turned = -polynomial::evaluate(N, s) / polynomial::evaluate(D, s);
        let falls = polynomial::evaluate(&slope, *root).re > 0.0;
        found.push(GainCrossing { omega, falls, angle: turned.arg().rem_euclid(TAU) });
    }
    Ok(found)
}

/// `|p(j omega)|^2` as a polynomial in `omega^2`.
fn squared_magnitude(p: &[f64]) -> Vec<f64> {
    let degree = p.len() - 1;
    // p(j w) = sum c_m j^m w^m: even m are real, odd m imaginary; (Re)^2 + (Im)^2.
    let mut square = vec![0.0; degree + 1];
    for (i, ci) in p.iter().enumerate() {
        for (k, ck) in p.iter().enumerate() {
            let (m, l) = (degree - i, degree - k);
            if (m + l) % 2 == 0 {
                // j^m conj(j^l) = j^(m-l) is 1 or -1.
                let sign = if (m as i64 - l as i64).rem_euclid(4) == 0 { 1.0 } else { -1.0 };
                square[degree - (m + l) / 2] += sign * ci * ck;
            }
        }
    }
    square
}

/// Doublings of the last frequency; `2^80` is beyond any ratio of poles that a double resolves.
const GROWTHS_MAX: usize = 80;
/// Pieces of the axis; usual are a few hundred.
const PIECES_MAX: usize = 200_000;

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    fn characteristic(n: &[f64], d: &[f64], delay_s: f64) -> Characteristic {
        Characteristic { N: n.to_vec(), D: d.to_vec(), delay_s }
    }

    #[test]
    fn law_an_integrator_with_delay_turns_unstable_at_its_textbook_gain() {
        // k e^{-s}/s is stable for k < pi/2; each 2 pi further another pair crosses.
        for (gain, expected) in
            [(1.57, 0), (1.572, 2), (FRAC_PI_2 + TAU - 0.01, 2), (FRAC_PI_2 + TAU + 0.01, 4)]
        {
            let c = characteristic(&[gain], &[1.0, 0.0], 1.0);
            assert_eq!(c.n_unstable().expect("counted"), expected, "{gain}");
            assert_eq!(c.n_unstable_nyquist().expect("counted"), expected, "{gain}");
        }
    }

    #[test]
    fn law_an_unstable_lag_with_delay_is_stable_up_to_its_textbook_delay() {
        // k e^{-s L}/(s - 1): omega = sqrt(k^2 - 1), stable for L < atan(omega)/omega.
        let omega: f64 = (4.0_f64 - 1.0).sqrt();
        let limit = omega.atan() / omega;
        for (delay, expected) in [(0.99 * limit, 0), (1.01 * limit, 2)] {
            let c = characteristic(&[2.0], &[1.0, -1.0], delay);
            assert_eq!(c.n_unstable().expect("counted"), expected);
            assert_eq!(c.n_unstable_nyquist().expect("counted"), expected);
        }
    }

    #[test]
    fn law_both_counts_agree_on_random_loops() {
        let seed = 90;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        let (mut stable, mut unstable) = (0, 0);
        for trial in 0..400 {
            let n = 1 + trial % 5;
            let mut poles = Vec::new();
            while poles.len() < n {
                let size = 10f64.powf(rng.random_range(-1.5..1.5));
                let re = if rng.random_range(0.0..1.0) < 0.1 { size } else { -size };
                if poles.len() + 2 <= n && rng.random_range(0.0..1.0) < 0.4 {
                    let im = size * rng.random_range(0.2..5.0);
                    poles.extend([Complex64::new(re, im), Complex64::new(re, -im)]);
                } else {
                    poles.push(Complex64::new(re, 0.0));
                }
            }
            let d = polynomial::multiply(&polynomial::from_roots(&poles).expect("paired"), &[1.0, 0.0]);
            let gain = 10f64.powf(rng.random_range(-1.0..1.0)) * d[d.len() - 2].abs();
            let n = [gain * rng.random_range(0.0..3.0), gain * rng.random_range(0.1..1.0)];
            let c = characteristic(&n, &d, 10f64.powf(rng.random_range(-2.0..1.0)));
            if c.gain_at_infinity() >= 0.98 {
                continue;
            }
            let direct = c.n_unstable().unwrap_or_else(|e| panic!("seed {seed} trial {trial}: {e}"));
            let nyquist = c.n_unstable_nyquist().unwrap_or_else(|e| panic!("seed {seed} trial {trial}: {e}"));
            assert_eq!(direct, nyquist, "seed {seed} trial {trial}: {c:?}");
            if direct == 0 { stable += 1 } else { unstable += 1 }
        }
        assert!(stable > 30 && unstable > 30, "{stable} stable, {unstable} unstable");
    }

    #[test]
    fn edge_a_neutral_loop_is_refused_and_a_pole_on_the_axis_is_not_stable() {
        let neutral = characteristic(&[1.5, 1.0], &[1.0, 1.0], 0.1);
        assert!(matches!(neutral.n_unstable(), Err(Error::PidLoopNeutral { .. })));
        // A zero at the origin against the integrator: s/(s (s + 1)).
        let hidden = characteristic(&[1.0, 0.0], &[1.0, 1.0, 0.0], 0.5);
        assert!(hidden.n_unstable().expect("counted") > 0);
        let mild = characteristic(&[0.5, 1.0], &[1.0, 1.0], 0.1);
        assert_eq!(mild.n_unstable_certified().expect("counted"), 0);
    }
}
