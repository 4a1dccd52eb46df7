//! A stable, minimum-phase system as gain, zeros and poles: what a magnitude alone determines.

use num_complex::Complex64;
use telepulse_lti::{TransferFunction, polynomial};

use crate::Result;

/// `W(s) = gain prod(s - zero) / prod(s - pole)`, all roots in the closed left half plane.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct MinimumPhase {
    pub(crate) gain: f64,
    pub(crate) zeros: Vec<Complex64>,
    pub(crate) poles: Vec<Complex64>,
}

impl MinimumPhase {
    /// The spectral factor of `N(x)/D(x) = |W(j sqrt(x))|^2`, coefficients in ascending powers of `x`, both positive on
    /// `x >= 0` up to touching zero; damping ratios are raised to `damping_min`.
    ///
    /// **Method**: a root `x` of the polynomial is a pair of roots `+-sqrt(-x)` of its square in `s`; the one on the left
    /// belongs to `W`. A double root on the positive axis, which rounding or a grid may split, becomes one lightly damped
    /// pair.
    pub(crate) fn from_power(numerator: &[f64], denominator: &[f64], damping_min: f64) -> Result<Self> {
        let (zeros, top) = left_roots(numerator, damping_min)?;
        let (poles, bottom) = left_roots(denominator, damping_min)?;
        Ok(Self { gain: (top / bottom).abs().sqrt(), zeros, poles })
    }

    /// Gain, zeros and poles of a transfer function.
    pub(crate) fn of(tf: &TransferFunction) -> Result<Self> {
        let gain = polynomial::trim(tf.numerator()).first().copied().unwrap_or(0.0) / tf.denominator()[0];
        let zeros = if gain == 0.0 { Vec::new() } else { tf.zeros()? };
        Ok(Self { gain: gain.abs(), zeros, poles: tf.poles()? })
    }

    pub(crate) fn transfer_function(&self) -> Result<TransferFunction> {
        let numerator: Vec<f64> =
            polynomial::from_roots(&self.zeros)?.iter().map(|c| c * self.gain).collect();
        Ok(TransferFunction::new(&numerator, &polynomial::from_roots(&self.poles)?)?)
    }

    /// `ln |W(j omega)|`; the frequency may be infinite.
    pub(crate) fn log_magnitude(&self, omega: f64) -> f64 {
        if omega.is_infinite() {
            return if self.zeros.len() < self.poles.len() { f64::NEG_INFINITY } else { self.gain.ln() };
        }
        let log = |roots: &[Complex64]| -> f64 {
            roots.iter().map(|r| Complex64::new(-r.re, omega - r.im).norm().ln()).sum()
        };
        self.gain.ln() + log(&self.zeros) - log(&self.poles)
    }

    /// A number that the second derivative of `ln |W|` by `ln omega` does not exceed on an interval of `ln omega`.
    ///
    /// With `y = 2 cosh(2 ln(omega/w))` a real root adds `2/(y + 2)`, and a pair of size `w` and damping `zeta` adds
    /// `2 (4 + c y)/(y + c)^2` with `c = 4 zeta^2 - 2`; roots that are poles subtract it. Each term is bounded over the
    /// interval by itself.
    pub(crate) fn curvature_max(&self, log_omega: [f64; 2]) -> f64 {
        let bound = |roots: &[Complex64], upper: bool| -> f64 {
            roots.iter().map(|root| root_curvature(*root, log_omega, upper)).sum()
        };
        bound(&self.zeros, true) - bound(&self.poles, false)
    }
}

/// Largest or smallest second derivative of `ln |j omega - root|` over an interval; one of a pair counts for half of it.
fn root_curvature(root: Complex64, log_omega: [f64; 2], upper: bool) -> f64 {
    let size = root.norm();
    if size == 0.0 {
        return 0.0;
    }
    let v = log_omega.map(|u| 2.0 * (u - size.ln()));
    let ends = v.map(|v| 2.0 * v.cosh());
    let y_max = ends[0].max(ends[1]);
    let y_min = if v[0] <= 0.0 && v[1] >= 0.0 { 2.0 } else { ends[0].min(ends[1]) };
    if root.im == 0.0 {
        return if upper { 2.0 / (y_min + 2.0) } else { 2.0 / (y_max + 2.0) };
    }
    let damping = root.re / size;
    let c = 4.0 * damping * damping - 2.0;
    let term = |y: f64| (4.0 + c * y) / (y + c).powi(2);
    let mut extremes = [term(y_min), term(y_max), term(y_min)];
    let turning = (c * c - 8.0) / c;
    if turning > y_min && turning < y_max {
        extremes[2] = term(turning);
    }
    let choose = if upper { f64::max } else { f64::min };
    extremes[1..].iter().fold(extremes[0], |best, &value| choose(best, value))
}

/// The left roots in `s` and the leading coefficient in `x`.
fn left_roots(ascending: &[f64], damping_min: f64) -> Result<(Vec<Complex64>, f64)> {
    let mut descending: Vec<f64> = ascending.iter().rev().copied().collect();
    let trimmed = polynomial::trim(&descending).len();
    descending.drain(..descending.len() - trimmed);
    let lead = descending.first().copied().unwrap_or(0.0);
    let roots = if descending.len() > 1 { polynomial::roots(&descending)? } else { Vec::new() };
    let mut left = Vec::with_capacity(roots.len());
    let mut touching: Vec<f64> = Vec::new();
    for x in roots {
        if x.im == 0.0 && x.re > 0.0 {
            touching.push(x.re);
        } else if x.im == 0.0 {
            left.push(Complex64::new(-(-x.re).sqrt(), 0.0));
        } else if x.im > 0.0 {
            let s = -(-x).sqrt();
            push_pair(&mut left, s.norm(), (-s.re / s.norm()).max(damping_min));
        }
    }
    touching.sort_by(f64::total_cmp);
    for pair in touching.chunks(2) {
        let size = pair.iter().fold(1.0, |product, x| product * x.powf(0.5 / pair.len() as f64));
        if pair.len() == 2 {
            push_pair(&mut left, size, damping_min);
        } else {
            left.push(Complex64::new(-size, 0.0));
        }
    }
    Ok((left, lead))
}

fn push_pair(roots: &mut Vec<Complex64>, size: f64, damping: f64) {
    if damping >= 1.0 {
        roots.extend([Complex64::new(-size, 0.0); 2]);
        return;
    }
    let s = Complex64::new(-damping * size, size * (1.0 - damping * damping).sqrt());
    roots.extend([s, s.conj()]);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_the_factor_has_the_power_it_was_made_from() {
        // (x + 4)(x^2 - 2 x + 9) over (x + 1)^2 (x + 100), at scattered frequencies.
        let numerator = polynomial::multiply(&[1.0, 4.0], &[1.0, -2.0, 9.0]);
        let denominator = polynomial::multiply(&[1.0, 2.0, 1.0], &[1.0, 100.0]);
        let ascending = |c: &[f64]| c.iter().rev().copied().collect::<Vec<f64>>();
        let w =
            MinimumPhase::from_power(&ascending(&numerator), &ascending(&denominator), 0.0).expect("roots");
        let tf = w.transfer_function().expect("proper");
        assert!(tf.is_stable().expect("poles") && tf.zeros().expect("zeros").iter().all(|z| z.re < 0.0));
        for omega in [0.0, 0.3, 1.0, 1.7, 20.0, 500.0_f64] {
            let x = Complex64::new(omega * omega, 0.0);
            let power = (polynomial::evaluate(&numerator, x) / polynomial::evaluate(&denominator, x)).re;
            assert!((w.log_magnitude(omega) - 0.5 * power.ln()).abs() < 1e-7, "{omega}");
            assert!((tf.at(omega).norm().ln() - 0.5 * power.ln()).abs() < 1e-7, "{omega}");
        }
    }

    #[test]
    fn law_the_curvature_is_never_above_its_bound() {
        let pair = |size: f64, zeta: f64| {
            let s = Complex64::new(-zeta * size, size * (1.0 - zeta * zeta).sqrt());
            [s, s.conj()]
        };
        let real = |size: f64| Complex64::new(-size, 0.0);
        for (zeta, other) in [(0.05, 0.3), (0.7, 0.9), (0.2, 0.02)] {
            let w = MinimumPhase {
                gain: 2.0,
                zeros: [pair(3.0, zeta).to_vec(), vec![real(0.5)]].concat(),
                poles: [pair(20.0, other).to_vec(), vec![real(40.0), real(0.01)]].concat(),
            };
            let (h, log) = (1e-4, |u: f64| w.log_magnitude(u.exp()));
            let mut tight = 0.0_f64;
            for k in 0..4000 {
                let u = -5.0 + 0.0025 * f64::from(k);
                let seen = (log(u + h) - 2.0 * log(u) + log(u - h)) / (h * h);
                let narrow = w.curvature_max([u - h, u + h]);
                assert!(
                    seen <= narrow + 1e-4 && narrow <= w.curvature_max([u - 0.3, u + 0.2]) + 1e-12,
                    "{u}"
                );
                tight = tight.max((narrow - seen) / (1.0 + seen.abs()));
            }
            assert!(tight < 0.2, "{tight}");
        }
    }

    #[test]
    fn edge_a_double_root_on_the_axis_becomes_a_damped_pair() {
        // (x - 4)^2 over (x + 1)^2.
        let w = MinimumPhase::from_power(&[16.0, -8.0, 1.0], &[1.0, 2.0, 1.0], 0.05).expect("roots");
        assert_eq!((w.zeros.len(), w.poles.len()), (2, 2));
        assert!(w.zeros.iter().all(|z| (z.norm() - 2.0).abs() < 1e-6 && z.re < -0.09));
    }
}
