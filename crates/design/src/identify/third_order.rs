//! The third-order model and its derivatives.
#![allow(non_snake_case)]

use num_complex::Complex64;

/// The pole of the circuit: measured apart from the sweep, or left to the fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RcPole {
    /// Its time constant in s, held fixed.
    Known(f64),
    /// Found by the fit.
    Free,
}

/// Standard errors of the parameters of a fit, each in the unit of its parameter.
///
/// They come from the scatter of the residual about the fit, taken as independent between points. Where the model is
/// too simple, the residual is systematic and they are too small.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterErrors {
    /// Of the DC gain, in mm per unit.
    pub dc_gain_mm_per_unit: f64,
    /// Of the natural frequency, in rad/s.
    pub omega_n_rad_s: f64,
    /// Of the damping ratio.
    pub zeta: f64,
    /// Of the time constant of the circuit, in s; `None` where it was known.
    pub rc_s: Option<f64>,
}

/// `g / ((rc s + 1)((s/wn)^2 + 2 zeta s/wn + 1))`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ThirdOrder {
    pub dc_gain: f64,
    pub omega_n: f64,
    pub zeta: f64,
    pub rc: f64,
}

impl ThirdOrder {
    /// Logarithms of gain, natural frequency and damping ratio, and of the time constant where it is free: every step of
    /// the fit then keeps all poles in the left half plane.
    pub fn from_logs(p: &[f64], rc: RcPole) -> Self {
        let rc = match rc {
            RcPole::Known(rc_s) => rc_s,
            RcPole::Free => p[3].exp(),
        };
        Self { dc_gain: p[0].exp(), omega_n: p[1].exp(), zeta: p[2].exp(), rc }
    }

    pub fn to_logs(self, rc: RcPole) -> Vec<f64> {
        let mut p = vec![self.dc_gain.ln(), self.omega_n.ln(), self.zeta.ln()];
        if rc == RcPole::Free {
            p.push(self.rc.ln());
        }
        p
    }

    pub fn at(&self, w: f64) -> Complex64 {
        self.derivatives(w).value
    }

    pub fn derivatives(&self, w: f64) -> Derivatives {
        let j = Complex64::i();
        let x = w / self.omega_n;
        let damping = j * (2.0 * self.zeta * x);
        let D = 1.0 - x * x + damping;
        let E = 1.0 + j * (w * self.rc);
        let G = self.dc_gain / (D * E);
        Derivatives {
            value: G,
            by_logs: [G, -G / D * (2.0 * x * x - damping), -G / D * damping, -G / E * (j * w * self.rc)],
        }
    }

    /// Numerator and denominator as printed in Eq. (16): `g wn^2 / ((rc s + 1)(s^2 + 2 zeta wn s + wn^2))`.
    pub fn polynomials(&self) -> (f64, [f64; 4]) {
        let Self { dc_gain, omega_n: wn, zeta, rc } = *self;
        let damping = 2.0 * zeta * wn;
        (dc_gain * wn * wn, [rc, 1.0 + rc * damping, damping + rc * wn * wn, wn * wn])
    }
}

/// Response and its derivatives by the logarithms of gain, natural frequency, damping ratio and time constant.
pub(super) struct Derivatives {
    pub value: Complex64,
    pub by_logs: [Complex64; 4],
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paper_eq16_follows_from_eq14_and_eq15() {
        // (16) = 1350.14 x (14) x (15): 1 / (0.0045 s + 1) and 1 / (s^2 + 15.96 s + 1444).
        let model = ThirdOrder { dc_gain: 1350.14 / 1444.0, omega_n: 38.0, zeta: 0.21, rc: 0.0045 };
        let (numerator, denominator) = model.polynomials();
        assert!((numerator - 1350.14).abs() < 1e-10);
        for (found, printed) in denominator.into_iter().zip([0.0045, 1.07182, 22.458, 1444.0]) {
            assert!((found - printed).abs() < 1e-10 * printed.max(1.0), "{found} against {printed}");
        }
    }

    #[test]
    fn law_derivatives_agree_with_differences() {
        let logs = [0.2, 3.4, -1.3, -5.0];
        for w in [0.6, 20.0, 31.0, 38.0, 300.0] {
            let exact = ThirdOrder::from_logs(&logs, RcPole::Free).derivatives(w);
            for p in 0..4 {
                let shifted = |h: f64| {
                    let mut l = logs;
                    l[p] += h;
                    ThirdOrder::from_logs(&l, RcPole::Free).at(w)
                };
                let h = 1e-5;
                let difference = (shifted(h) - shifted(-h)) / (2.0 * h);
                assert!((exact.by_logs[p] - difference).norm() < 1e-8 * exact.value.norm());
            }
        }
    }
}
