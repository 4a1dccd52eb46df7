//! A scale over frequency as a system: stable with a stable inverse.

use nalgebra::{DMatrix, dmatrix};
use num_complex::Complex64;
use telepulse_lti::{Continuous, StateSpace};

use super::blocks::FullBlocks;
use crate::Error;
use crate::identify::MinimumPhase;

/// `d(s) = gain prod(s - zero) / prod(s - pole)`, stable and minimum phase, with as many zeros as poles.
#[derive(Clone, Debug, PartialEq)]
pub struct RationalScale {
    pub(super) factor: MinimumPhase,
}

impl RationalScale {
    /// A constant scale.
    ///
    /// **Errors**: [`Error::OutOfRange`] unless it is positive and finite.
    pub fn constant(gain: f64) -> Result<Self, Error> {
        Self::new(gain, Vec::new(), Vec::new())
    }

    /// A scale from gain, zeros and poles in rad/s, complex ones with their conjugates.
    ///
    /// **Errors**: [`Error::OutOfRange`] unless the gain is positive and finite, zeros and poles are as many and finite and
    /// have negative real parts.
    pub fn new(gain: f64, zeros: Vec<Complex64>, poles: Vec<Complex64>) -> Result<Self, Error> {
        let range = |key, found, allowed| Err(Error::OutOfRange { key, found, allowed });
        if !(gain > 0.0 && gain.is_finite()) {
            return range("scale gain", gain, "positive and finite");
        }
        if zeros.len() != poles.len() {
            return range("number of zeros of a scale", zeros.len() as f64, "the number of its poles");
        }
        for roots in [&zeros, &poles] {
            if let Some(root) = roots.iter().find(|r| !(r.is_finite() && r.re < 0.0)) {
                return range("real part of a zero or pole of a scale", root.re, "negative and finite");
            }
            let unpaired: f64 = roots.iter().map(|r| r.im).sum();
            if unpaired.abs() > 1e-9 * roots.iter().map(|r| r.norm()).fold(0.0, f64::max) {
                return range("sum of the imaginary parts of a scale's roots", unpaired, "zero");
            }
        }
        Ok(Self { factor: MinimumPhase { gain, zeros, poles } })
    }

    /// Number of poles.
    #[must_use]
    pub fn order(&self) -> usize {
        self.factor.poles.len()
    }

    /// `|d(j omega)|`, the frequency in rad/s.
    #[must_use]
    pub fn magnitude(&self, omega_rad_s: f64) -> f64 {
        self.factor.log_magnitude(omega_rad_s).exp()
    }

    /// The scale as a system, a chain of sections of first and second order.
    ///
    /// **Errors**: those of [`StateSpace::series`].
    pub fn system(&self) -> Result<StateSpace<Continuous>, Error> {
        chain(self.factor.gain, &self.factor.zeros, &self.factor.poles)
    }

    /// `1 / d(s)` as a system.
    ///
    /// **Errors**: as [`RationalScale::system`].
    pub fn inverse(&self) -> Result<StateSpace<Continuous>, Error> {
        chain(1.0 / self.factor.gain, &self.factor.poles, &self.factor.zeros)
    }
}

/// `D_L sys D_R^-1` on the first signals of `sys`, whose others pass unscaled.
pub(super) fn scaled_system(
    sys: &StateSpace<Continuous>,
    blocks: &FullBlocks,
    scales: &[RationalScale],
) -> Result<StateSpace<Continuous>, Error> {
    let side = |owners: Vec<usize>, total: usize, inverse: bool| -> Result<StateSpace<Continuous>, Error> {
        let mut all: Option<StateSpace<Continuous>> = None;
        let rest = total - owners.len();
        let parts =
            owners.into_iter().map(|k| if inverse { scales[k].inverse() } else { scales[k].system() }).chain(
                (rest > 0).then(|| Ok(StateSpace::<Continuous>::from_gain(DMatrix::identity(rest, rest))?)),
            );
        for part in parts {
            let part = part?;
            all = Some(match all {
                Some(all) => all.augment(&part)?,
                None => part,
            });
        }
        all.ok_or(Error::EmptyList { key: "blocks" })
    };
    let right = side(blocks.owners_w(), sys.n_inputs(), true)?;
    let left = side(blocks.owners_z(), sys.n_outputs(), false)?;
    Ok(right.series(sys)?.series(&left)?)
}

/// Sections `(s² + b1 s + b0)/(s² + a1 s + a0)`, sorted by size so that zeros meet near poles, and one of first order.
fn chain(gain: f64, zeros: &[Complex64], poles: &[Complex64]) -> Result<StateSpace<Continuous>, Error> {
    let (zeros, poles) = (Factors::new(zeros), Factors::new(poles));
    let mut sys = StateSpace::<Continuous>::from_gain(dmatrix![gain])?;
    for ([b1, b0], [a1, a0]) in zeros.second.into_iter().zip(poles.second) {
        let w = a0.sqrt();
        let a = dmatrix![0.0, w; -w, -a1];
        let c = dmatrix![(b0 - a0) / w, b1 - a1] / w;
        sys = sys.series(&StateSpace::<Continuous>::new(a, dmatrix![0.0; w], c, dmatrix![1.0])?)?;
    }
    if let (Some(b), Some(a)) = (zeros.first, poles.first) {
        let size = (b - a).abs().sqrt();
        let (b, c) = (dmatrix![size], dmatrix![size.copysign(b - a)]);
        sys = sys.series(&StateSpace::<Continuous>::new(dmatrix![-a], b, c, dmatrix![1.0])?)?;
    }
    Ok(sys)
}

/// Real factors of a polynomial: `s² + c1 s + c0` by rising `c0`, and `s + c` where the degree is odd.
struct Factors {
    second: Vec<[f64; 2]>,
    first: Option<f64>,
}

impl Factors {
    fn new(roots: &[Complex64]) -> Self {
        let mut real: Vec<f64> = roots.iter().filter(|r| r.im == 0.0).map(|r| -r.re).collect();
        real.sort_by(f64::total_cmp);
        let first = if real.len() % 2 == 1 { real.pop() } else { None };
        let pairs = real.chunks(2).map(|pair| [pair[0] + pair[1], pair[0] * pair[1]]);
        let complex = roots.iter().filter(|r| r.im > 0.0).map(|r| [-2.0 * r.re, r.norm_sqr()]);
        let mut second: Vec<[f64; 2]> = complex.chain(pairs).collect();
        second.sort_by(|a, b| a[1].total_cmp(&b[1]));
        Self { second, first }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_the_system_has_the_magnitude_of_its_roots_and_its_inverse_undoes_it() {
        let c = Complex64::new;
        let real = |v: f64| c(v, 0.0);
        let cases = [
            (vec![], vec![]),
            (vec![real(-1e-3)], vec![real(-5.0)]),
            (vec![c(-1.0, 2.0), c(-1.0, -2.0), real(-1e4)], vec![real(-0.1), real(-30.0), real(-40.0)]),
            (vec![real(-1.0), real(-2.0)], vec![c(-3.0, 3.0), c(-3.0, -3.0)]),
        ];
        for (zeros, poles) in cases {
            let scale = RationalScale::new(3.0, zeros, poles).expect("stable");
            let (sys, inverse) = (scale.system().expect("fits"), scale.inverse().expect("fits"));
            assert_eq!(sys.n_states(), scale.order());
            for omega in [0.0, 1e-3, 0.7, 20.0, 1e5] {
                let (d, i) =
                    (sys.at(omega).expect("stable")[(0, 0)], inverse.at(omega).expect("stable")[(0, 0)]);
                assert!((d.norm() / scale.magnitude(omega) - 1.0).abs() < 1e-9, "{omega}");
                assert!((d * i - 1.0).norm() < 1e-9, "{omega}");
            }
        }
    }

    #[test]
    fn edge_scales_that_are_none() {
        assert!(RationalScale::constant(0.0).is_err());
        assert!(RationalScale::constant(f64::NAN).is_err());
        let c = Complex64::new;
        assert!(RationalScale::new(1.0, vec![c(1.0, 0.0)], vec![c(-1.0, 0.0)]).is_err());
        assert!(RationalScale::new(1.0, vec![], vec![c(-1.0, 0.0)]).is_err());
        assert!(RationalScale::new(1.0, vec![c(-1.0, 1.0)], vec![c(-1.0, 0.0)]).is_err());
    }
}
