//! From transfer function to state space and back.

use crate::{Continuous, Error, StateSpace, TransferFunction, polynomial};
use nalgebra::DMatrix;
use num_complex::Complex64;

impl TransferFunction {
    /// A realization with as many states as the denominator has degrees.
    ///
    /// **Method**: controllable canonical form with the strictly proper part in `C`, states then scaled by powers of
    /// two, which costs no rounding.
    ///
    /// **Source**: Zhou and Doyle 1998, section 3.7.
    ///
    /// # Example
    /// ```
    /// use telepulse_lti::TransferFunction;
    /// let tf = TransferFunction::new(&[3.0, 4.0], &[1.0, 0.2, 9.0])?;
    /// let sys = tf.to_state_space();
    /// assert!((sys.at(3.0)?[(0, 0)] - tf.at(3.0)).norm() < 1e-13);
    /// # Ok::<(), telepulse_lti::Error>(())
    /// ```
    #[must_use]
    pub fn to_state_space(&self) -> StateSpace<Continuous> {
        let (denominator, n) = (self.denominator(), self.order());
        let monic: Vec<f64> = denominator.iter().map(|c| c / denominator[0]).collect();
        let mut numerator = vec![0.0; self.relative_degree()];
        numerator.extend(self.numerator().iter().map(|c| c / denominator[0]));
        let direct = numerator[0];
        let a = DMatrix::from_fn(n, n, |i, j| match (i, j) {
            (0, j) => -monic[j + 1],
            (i, j) if i == j + 1 => 1.0,
            _ => 0.0,
        });
        let b = DMatrix::from_fn(n, 1, |i, _| if i == 0 { 1.0 } else { 0.0 });
        let c = DMatrix::from_fn(1, n, |_, j| numerator[j + 1] - direct * monic[j + 1]);
        StateSpace::from_valid_parts(a, b, c, DMatrix::from_element(1, 1, direct), Continuous).balanced()
    }
}

impl StateSpace<Continuous> {
    /// The transfer function of a system with one input and one output, its denominator monic.
    ///
    /// **Method**: denominator from the poles, numerator from the transmission zeros, gain from one evaluation away from
    /// both. Modes that no port sees appear in both polynomials and are not cancelled.
    ///
    /// **Accuracy**: coefficients of a high order (above about ten) lose digits whatever the method; the state space form
    /// is the better carrier there.
    ///
    /// # Errors
    /// [`Error::NotSiso`], [`Error::EigenvaluesNotConverged`], [`Error::Overflow`] where a coefficient overflows.
    pub fn to_transfer_function(&self) -> Result<TransferFunction, Error> {
        let (n_inputs, n_outputs) = (self.n_inputs(), self.n_outputs());
        if (n_inputs, n_outputs) != (1, 1) {
            return Err(Error::NotSiso { n_inputs, n_outputs });
        }
        let poles = self.poles()?;
        let denominator = polynomial::from_roots(&poles)?;
        let zeros = match self.zeros() {
            Ok(zeros) => zeros,
            Err(Error::RankDeficientSystem) => return TransferFunction::new(&[0.0], &denominator),
            Err(other) => return Err(other),
        };
        // A real point outside of all poles, at a distance of their own size: that of four which is farthest from a zero.
        let radius = poles.iter().map(|pole| pole.norm()).fold(0.0, f64::max);
        let radius = if radius > 0.0 { radius } else { 1.0 };
        let clearance =
            |point: &f64| zeros.iter().map(|z| (z - point).norm() / z.norm().max(radius)).fold(1.0, f64::min);
        let candidates = [2.0, -2.0, 3.0, -3.0].map(|k| k * radius);
        let farthest = candidates.into_iter().max_by(|p, q| clearance(p).total_cmp(&clearance(q)));
        let point = Complex64::new(farthest.unwrap_or(2.0 * radius), 0.0);
        let overflow = Error::Overflow { operation: "conversion to a transfer function" };
        let value = self.evaluate(point).ok_or(overflow)?[(0, 0)];
        let product = |roots: &[Complex64]| roots.iter().fold(Complex64::ONE, |p, r| p * (point - r));
        let gain = (value * product(&poles) / product(&zeros)).re;
        let numerator: Vec<f64> = polynomial::from_roots(&zeros)?.iter().map(|c| c * gain).collect();
        TransferFunction::new(&numerator, &denominator)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::dmatrix;
    use rand::{RngExt, SeedableRng};

    fn close(found: &[f64], expected: &[f64], relative: f64) {
        assert_eq!(found.len(), expected.len(), "{found:?} against {expected:?}");
        for (f, e) in found.iter().zip(expected) {
            assert!((f - e).abs() <= relative * e.abs(), "{found:?} against {expected:?}");
        }
    }

    #[test]
    fn law_transfer_function_to_state_space_and_back() {
        let cases: [(&[f64], &[f64]); 6] = [
            (&[3.0], &[1.0]),
            (&[1.0, 2.0], &[1.0, 5.0]),
            (&[2.0, 0.5, 7.0], &[1.0, 0.3, 4.0]),
            (&[5.0], &[1.0, 2.0, 3.0, 4.0]),
            (&[1.0, -2.0], &[1.0, 6.0, 11.0, 6.0]),
            (&[1300.0, 2.0e5], &[1.0, 200.0, 5000.0, 3.0e5]),
        ];
        for (numerator, denominator) in cases {
            let tf = TransferFunction::new(numerator, denominator).expect("valid");
            let back = tf.to_state_space().to_transfer_function().expect("converted");
            close(back.numerator(), numerator, 1e-12);
            close(back.denominator(), denominator, 1e-12);
        }
    }

    #[test]
    fn law_realization_and_function_have_one_response() {
        let tf = TransferFunction::new(&[2.0, 3.0, 5.0], &[4.0, 1.0, 20.0]).expect("valid");
        let sys = tf.to_state_space();
        for omega in [0.0, 0.1, 2.2, 50.0] {
            assert!((sys.at(omega).expect("no pole")[(0, 0)] - tf.at(omega)).norm() < 1e-13);
        }
    }

    #[test]
    fn law_random_functions_of_order_up_to_eight_survive_the_round_trip() {
        let seed = 31;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        for case in 0..200 {
            let mut pairs = |n: usize| -> Vec<Complex64> {
                let mut roots = Vec::new();
                for _ in 0..n {
                    let size = 10f64.powf(rng.random_range(0.0..2.5));
                    let (re, im) = (-size * rng.random_range(0.05..1.0), size * rng.random_range(0.1..1.0));
                    roots.extend([Complex64::new(re, im), Complex64::new(re, -im)]);
                }
                roots
            };
            let n_pairs = 1 + case % 4;
            let (poles, zeros) = (pairs(n_pairs), pairs((case / 4) % (n_pairs + 1)));
            let [numerator, denominator] = [zeros, poles].map(|r| polynomial::from_roots(&r).expect("pairs"));
            let tf = TransferFunction::new(&numerator, &denominator).expect("proper");
            let back = tf.to_state_space().to_transfer_function().expect("converted");
            // Beyond a relative degree of four, zeros far outside of the poles may appear (see `StateSpace::zeros`); the
            // response below is the same with them.
            if tf.relative_degree() <= 4 {
                assert_eq!(back.relative_degree(), tf.relative_degree(), "seed {seed} case {case}");
            }
            let omegas = [0.0, 0.5, 5.0, 50.0, 500.0];
            // A small response beside a direct term is a difference of large ones, and poles that lie near each other and
            // a hundred times below the largest are known to about 1e-10: 1e-9 of the largest response covers both.
            let largest = omegas.map(|omega| tf.at(omega).norm()).into_iter().fold(0.0, f64::max);
            for omega in omegas {
                let error = (back.at(omega) - tf.at(omega)).norm();
                assert!(error < 1e-9 * largest, "seed {seed} case {case}: {error:e}");
            }
        }
    }

    #[test]
    fn edge_the_zero_system_becomes_the_zero_function() {
        let sys = StateSpace::<Continuous>::new(dmatrix![-1.0], dmatrix![1.0], dmatrix![0.0], dmatrix![0.0]);
        let tf = sys.expect("valid").to_transfer_function().expect("zero");
        assert_eq!((tf.numerator(), tf.denominator()), (&[0.0][..], &[1.0, 1.0][..]));
    }

    #[test]
    fn edge_a_system_of_two_outputs_has_no_transfer_function() {
        let sys = StateSpace::<Continuous>::from_gain(dmatrix![1.0; 2.0]).expect("valid");
        assert!(matches!(sys.to_transfer_function(), Err(Error::NotSiso { n_outputs: 2, .. })));
    }
}
