//! A controller as a sum of modes, each advanced by its increment.

use num_complex::Complex64;
use serde::{Deserialize, Serialize};

/// A real mode: `x += lambda x + b u`, output `c x`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RealMode {
    /// Discrete pole minus one.
    pub lambda: f64,
    /// Input gain.
    pub b: f64,
    /// Output gain.
    pub c: f64,
}

/// A pair of modes: `x += [[sigma, omega], [-omega, sigma]] x + b u`, output `c . x`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ComplexMode {
    /// Real part of the discrete poles, minus one.
    pub sigma: f64,
    /// Imaginary part of the discrete poles, per sample; positive.
    pub omega: f64,
    /// Input gains.
    pub b: [f64; 2],
    /// Output gains.
    pub c: [f64; 2],
}

/// A discrete controller with one input and one output, as plain data.
///
/// **Shapes and units**: input in mm (or N), output in units of command. At each tick the output is
/// `y = sum(c . x) + d u` from the states as they are, then every state is advanced. The sample time is folded into the modes.
///
/// **Accuracy**: at a kilohertz the poles of a slow controller crowd at z = 1. A companion form keeps their distance from 1 as
/// the difference of large numbers; here that distance itself is stored, so a pole keeps its relative accuracy
/// in any precision.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModalDelta {
    /// Real modes.
    pub real: Vec<RealMode>,
    /// Conjugate pairs.
    pub complex: Vec<ComplexMode>,
    /// Direct gain.
    pub d: f64,
    /// Sample time in s.
    pub sample_time_s: f64,
}

impl ModalDelta {
    /// Number of states.
    #[must_use]
    pub fn n_states(&self) -> usize {
        self.real.len() + 2 * self.complex.len()
    }

    /// The response at `z = exp(j omega T)`.
    #[must_use]
    pub fn at(&self, omega_rad_s: f64) -> Complex64 {
        let angle = omega_rad_s * self.sample_time_s;
        // z - 1 without the cancellation of a subtraction.
        let delta = Complex64::new(-2.0 * (0.5 * angle).sin().powi(2), angle.sin());
        let real = self.real.iter().map(|m| m.b * m.c / (delta - m.lambda));
        let complex = self.complex.iter().map(|m| {
            // (delta I - [[sigma, omega], [-omega, sigma]])^-1 written out.
            let p = delta - m.sigma;
            let (b, c, w) = (m.b, m.c, m.omega);
            ((b[0] * c[0] + b[1] * c[1]) * p + w * (b[1] * c[0] - b[0] * c[1])) / (p * p + w * w)
        });
        real.chain(complex).sum::<Complex64>() + self.d
    }

    /// True where every pole lies inside of the unit circle.
    #[must_use]
    pub fn is_stable(&self) -> bool {
        // |1 + lambda|^2 < 1 as lambda (2 + lambda) < 0, again without the subtraction.
        self.real.iter().all(|m| m.lambda * (2.0 + m.lambda) < 0.0)
            && self.complex.iter().all(|m| m.sigma * (2.0 + m.sigma) + m.omega * m.omega < 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The recursion as documented, run on a sine until it is steady.
    #[test]
    fn law_response_is_that_of_the_documented_recursion() {
        let law = ModalDelta {
            real: vec![RealMode { lambda: -0.05, b: 0.3, c: -1.2 }],
            complex: vec![ComplexMode { sigma: -0.04, omega: 0.1, b: [0.4, -0.1], c: [0.7, 0.9] }],
            d: 0.25,
            sample_time_s: 0.01,
        };
        assert!(law.is_stable());
        for omega in [3.0, 10.0, 60.0] {
            let (mut x, mut p) = (0.0, [0.0; 2]);
            let mut worst: f64 = 0.0;
            for k in 0..2000 {
                let angle = omega * 0.01 * f64::from(k);
                let u = angle.cos();
                let m = law.complex[0];
                let y = law.real[0].c * x + m.c[0] * p[0] + m.c[1] * p[1] + law.d * u;
                let steady = (law.at(omega) * Complex64::from_polar(1.0, angle)).re;
                if k > 1000 {
                    worst = worst.max((y - steady).abs());
                }
                x += law.real[0].lambda * x + law.real[0].b * u;
                p = [
                    p[0] + m.sigma * p[0] + m.omega * p[1] + m.b[0] * u,
                    p[1] - m.omega * p[0] + m.sigma * p[1] + m.b[1] * u,
                ];
            }
            assert!(worst < 1e-12, "{worst} at {omega}");
        }
    }
}
