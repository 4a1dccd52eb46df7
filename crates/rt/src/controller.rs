//! A linear controller in modal delta form, with room for a fixed number of modes.
//!
//! A companion form loses its digits when poles crowd at `z = 1`, as they do at kilohertz rates. Here each mode stands alone and its
//! state is advanced by its *increment*, so a slow pole keeps its full relative accuracy.

use crate::error::{Error, finite};

/// Real modes that a [`ModalDeltaController`] can hold.
pub const MAX_REAL: usize = 16;
/// Complex-conjugate pairs that a [`ModalDeltaController`] can hold.
pub const MAX_COMPLEX: usize = 16;

/// A real mode: `x += lambda x + b e`, `y = c x`. Its discrete pole is `1 + lambda`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RealMode {
    /// Discrete pole minus one, per sample.
    pub lambda: f64,
    /// Input gain, state per unit of error.
    pub b: f64,
    /// Output gain, unit command per state.
    pub c: f64,
}

/// A conjugate pair: `x += [[sigma, omega], [-omega, sigma]] x + b e`, `y = c . x`. Its discrete poles are `1 + sigma +- i omega`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ComplexMode {
    /// Real part of the discrete pole minus one, per sample.
    pub sigma: f64,
    /// Imaginary part of the discrete pole, per sample.
    pub omega: f64,
    /// Input gains of the two states.
    pub b: [f64; 2],
    /// Output gains of the two states.
    pub c: [f64; 2],
}

/// A discrete controller `e -> y` as a sum of first- and second-order modes.
///
/// **Shapes and units**: `e` is in the controlled variable's unit (mm or N), `y` in unit command (1 = full scale). The sample time is
/// folded into the modes.
///
/// **Method**: for each tick, `y = sum c . x + d e` from the states *before* the update ([`output`](Self::output)), then the update
/// ([`advance`](Self::advance)). Defective (repeated) poles have no modal form and must be separated by whoever builds the modes.
///
/// **Example**
/// ```
/// use telepulse_rt::{ModalDeltaController, RealMode};
/// // A summator of gain 0.5: y[k] = 0.5 (e[0] + ... + e[k-1]).
/// let mut k = ModalDeltaController::new(&[RealMode { lambda: 0.0, b: 1.0, c: 0.5 }], &[], 0.0)?;
/// k.advance(2.0);
/// k.advance(4.0);
/// assert_eq!(k.output(9.0), 3.0);
/// # Ok::<(), telepulse_rt::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct ModalDeltaController {
    real: [RealMode; MAX_REAL],
    real_states: [f64; MAX_REAL],
    n_real: usize,
    complex: [ComplexMode; MAX_COMPLEX],
    complex_states: [[f64; 2]; MAX_COMPLEX],
    n_complex: usize,
    d: f64,
}

impl ModalDeltaController {
    /// A controller with all states at zero.
    ///
    /// # Errors
    /// [`Error::TooManyModes`] beyond [`MAX_REAL`] or [`MAX_COMPLEX`]; [`Error::NotFinite`] for a coefficient that is NaN or infinite.
    pub fn new(real: &[RealMode], complex: &[ComplexMode], d: f64) -> Result<Self, Error> {
        if real.len() > MAX_REAL {
            return Err(Error::TooManyModes { kind: "real", found: real.len(), capacity: MAX_REAL });
        }
        if complex.len() > MAX_COMPLEX {
            return Err(Error::TooManyModes { kind: "complex", found: complex.len(), capacity: MAX_COMPLEX });
        }
        for mode in real {
            finite("real mode lambda", mode.lambda)?;
            finite("real mode b", mode.b)?;
            finite("real mode c", mode.c)?;
        }
        for mode in complex {
            finite("complex mode sigma", mode.sigma)?;
            finite("complex mode omega", mode.omega)?;
            for idx in 0..2 {
                finite("complex mode b", mode.b[idx])?;
                finite("complex mode c", mode.c[idx])?;
            }
        }
        let mut controller = Self {
            real: [RealMode::default(); MAX_REAL],
            real_states: [0.0; MAX_REAL],
            n_real: real.len(),
            complex: [ComplexMode::default(); MAX_COMPLEX],
            complex_states: [[0.0; 2]; MAX_COMPLEX],
            n_complex: complex.len(),
            d: finite("controller feedthrough d", d)?,
        };
        controller.real[..real.len()].copy_from_slice(real);
        controller.complex[..complex.len()].copy_from_slice(complex);
        Ok(controller)
    }

    /// The output for error `e`, from the states as they are.
    #[must_use]
    pub fn output(&self, e: f64) -> f64 {
        let mut y = self.d * e;
        for (mode, x) in self.real[..self.n_real].iter().zip(&self.real_states) {
            y += mode.c * x;
        }
        for (mode, x) in self.complex[..self.n_complex].iter().zip(&self.complex_states) {
            y += mode.c[0] * x[0] + mode.c[1] * x[1];
        }
        y
    }

    /// Moves the states over one sample with error `e`.
    pub fn advance(&mut self, e: f64) {
        for (mode, x) in self.real[..self.n_real].iter().zip(&mut self.real_states) {
            *x += mode.lambda * *x + mode.b * e;
        }
        for (mode, x) in self.complex[..self.n_complex].iter().zip(&mut self.complex_states) {
            let delta0 = mode.sigma * x[0] + mode.omega * x[1] + mode.b[0] * e;
            let delta1 = mode.sigma * x[1] - mode.omega * x[0] + mode.b[1] * e;
            x[0] += delta0;
            x[1] += delta1;
        }
    }

    /// Puts all states back to zero.
    pub fn reset(&mut self) {
        self.real_states = [0.0; MAX_REAL];
        self.complex_states = [[0.0; 2]; MAX_COMPLEX];
    }

    /// The real modes.
    #[must_use]
    pub fn real_modes(&self) -> &[RealMode] {
        &self.real[..self.n_real]
    }

    /// The complex-conjugate pairs.
    #[must_use]
    pub fn complex_modes(&self) -> &[ComplexMode] {
        &self.complex[..self.n_complex]
    }

    /// The number of states: one for each real mode, two for each pair.
    #[must_use]
    pub fn n_states(&self) -> usize {
        self.n_real + 2 * self.n_complex
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::test_random::Random;
    use std::vec::Vec;

    /// The impulse response in closed form: powers of the poles in polar coordinates, not a recursion.
    fn impulse_response(real: &[RealMode], complex: &[ComplexMode], d: f64, k: i32) -> f64 {
        if k == 0 {
            return d;
        }
        let mut y = 0.0;
        for m in real {
            y += m.c * (1.0 + m.lambda).powi(k - 1) * m.b;
        }
        for m in complex {
            let radius = (1.0 + m.sigma).hypot(m.omega).powi(k - 1);
            let angle = f64::from(k - 1) * m.omega.atan2(1.0 + m.sigma);
            let (s, c) = angle.sin_cos();
            let x = [radius * (c * m.b[0] + s * m.b[1]), radius * (c * m.b[1] - s * m.b[0])];
            y += m.c[0] * x[0] + m.c[1] * x[1];
        }
        y
    }

    #[test]
    fn law_impulse_response_is_the_sum_of_pole_powers() {
        for seed in 0..50 {
            let mut random = Random::new(seed);
            let real: Vec<_> = (0..random.below(MAX_REAL + 1))
                .map(|_| RealMode {
                    lambda: random.between(-1.5, 0.0),
                    b: random.between(-1.0, 1.0),
                    c: random.between(-1.0, 1.0),
                })
                .collect();
            let complex: Vec<_> = (0..random.below(MAX_COMPLEX + 1))
                .map(|_| ComplexMode {
                    sigma: random.between(-0.5, -0.05),
                    omega: random.between(-0.3, 0.3),
                    b: [random.between(-1.0, 1.0), random.between(-1.0, 1.0)],
                    c: [random.between(-1.0, 1.0), random.between(-1.0, 1.0)],
                })
                .collect();
            let d = random.between(-1.0, 1.0);
            let mut controller = ModalDeltaController::new(&real, &complex, d).expect("valid modes");
            assert_eq!(controller.n_states(), real.len() + 2 * complex.len());
            for k in 0..60 {
                let e = if k == 0 { 1.0 } else { 0.0 };
                let found = controller.output(e);
                let expected = impulse_response(&real, &complex, d, k);
                // 60 steps of up to 48 terms of order one: rounding stays below 1e-12.
                assert!((found - expected).abs() < 1e-12, "seed {seed} k {k}: {found} against {expected}");
                controller.advance(e);
            }
            controller.reset();
            assert_eq!(controller.output(1.0), d, "seed {seed}: reset must clear every state");
        }
    }

    #[test]
    fn law_slow_pole_keeps_its_digits() {
        // A pole 1e-12 away from 1, driven by a constant: x = b/lambda ((1+lambda)^n - 1) = n b (1 + O(n lambda)).
        let mode = RealMode { lambda: -1e-12, b: 1e-3, c: 1.0 };
        let mut controller = ModalDeltaController::new(&[mode], &[], 0.0).expect("valid mode");
        let n = 100_000;
        for _ in 0..n {
            controller.advance(1.0);
        }
        let expected = f64::from(n) * 1e-3 * (1.0 - 0.5e-12 * f64::from(n));
        // The sum of 1e5 equal terms rounds by at most 1e5 half-ulps (1.1e-11 relative); the typical error is far smaller.
        assert!((controller.output(0.0) / expected - 1.0).abs() < 2e-11);
    }

    #[test]
    fn edge_too_many_modes_and_nan_are_refused() {
        let modes = [RealMode::default(); MAX_REAL + 1];
        assert_eq!(
            ModalDeltaController::new(&modes, &[], 0.0),
            Err(Error::TooManyModes { kind: "real", found: MAX_REAL + 1, capacity: MAX_REAL })
        );
        let nan = ComplexMode { c: [0.0, f64::NAN], ..ComplexMode::default() };
        assert!(matches!(ModalDeltaController::new(&[], &[nan], 0.0), Err(Error::NotFinite { .. })));
        assert!(ModalDeltaController::new(&[], &[], f64::INFINITY).is_err());
    }
}
