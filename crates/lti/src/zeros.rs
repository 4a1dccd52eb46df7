//! Transmission zeros of square systems.
#![allow(non_snake_case)]

use crate::eigenvalues::eigenvalues;
use crate::interconnect::blocks;
use crate::{Error, StateSpace, TimeDomain};
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;

impl<D: TimeDomain> StateSpace<D> {
    /// The finite transmission zeros of a system with as many inputs as outputs, in the plane of its poles.
    ///
    /// A zero is a number `lambda` for which the system matrix `[A - lambda I, B; C, D]` is singular, so modes that no
    /// port sees (invariant zeros) are among them.
    ///
    /// **Method**: balance and normalize; orthogonal row compression of `D` and column compression of the rows of `C` that
    /// it leaves, which removes one state or more per step until `D` is invertible; eigenvalues of a shifted inverse; Newton
    /// steps on the determinant of the original system matrix.
    ///
    /// **Source**: Emami-Naeini and Van Dooren 1982, "Computation of zeros of linear multivariable systems",
    /// Automatica 18(4), algorithm 1 for the square case of full normal rank, where one of its two passes suffices.
    ///
    /// **Accuracy**: simple zeros to about 1e-12 relative in well-scaled systems. Ranks are decided at `100 n eps` of the
    /// normalized system; a rounding error that passes for a direct term shows as spurious zeros far outside of the poles.
    /// That can happen for a relative degree above four with poles spread over decades, where the response is blind to it.
    ///
    /// # Errors
    /// [`Error::NotSquare`]; [`Error::RankDeficientSystem`] where every number is a zero;
    /// [`Error::EigenvaluesNotConverged`].
    ///
    /// # Example
    /// ```
    /// use telepulse_lti::TransferFunction;
    /// let sys = TransferFunction::new(&[2.0, 6.0], &[1.0, 1.0, 1.0])?.to_state_space();
    /// assert!((sys.zeros()?[0] + 3.0).norm() < 1e-14);
    /// # Ok::<(), telepulse_lti::Error>(())
    /// ```
    pub fn zeros(&self) -> Result<Vec<Complex64>, Error> {
        let (n_inputs, n_outputs) = (self.n_inputs(), self.n_outputs());
        if n_inputs != n_outputs {
            return Err(Error::NotSquare { n_inputs, n_outputs });
        }
        let (system, rate) = SystemMatrix::normalized(self)?;
        let mut zeros = system.reduced()?.zeros_with_invertible_d()?;
        system.polish(&mut zeros);
        Ok(zeros.into_iter().map(|zero| zero * rate).collect())
    }
}

/// The blocks of the system matrix, with `n` states and `m` inputs and outputs.
#[derive(Clone)]
struct SystemMatrix {
    A: DMatrix<f64>,
    B: DMatrix<f64>,
    C: DMatrix<f64>,
    D: DMatrix<f64>,
    rank_tolerance: f64,
}

impl SystemMatrix {
    /// The balanced system in units of time in which `A` has norm one, inputs and outputs scaled to norm one; and the rate
    /// by which its zeros are to be multiplied. None of this moves a zero otherwise.
    fn normalized<T: TimeDomain>(sys: &StateSpace<T>) -> Result<(Self, f64), Error> {
        let sys = sys.balanced();
        let norm = sys.a().norm();
        let rate = if norm > 0.0 { norm } else { 1.0 };
        // (A / rate - lambda / rate, B / rate) are the upper rows of the system matrix divided by the rate.
        let (mut B, mut C, mut D) = (sys.b() / rate, sys.c().clone(), sys.d().clone());
        for j in 0..D.ncols() {
            let size = B.column(j).norm().hypot(D.column(j).norm());
            if size == 0.0 {
                return Err(Error::RankDeficientSystem);
            }
            B.column_mut(j).unscale_mut(size);
            D.column_mut(j).unscale_mut(size);
        }
        for i in 0..D.nrows() {
            let size = C.row(i).norm().hypot(D.row(i).norm());
            if size == 0.0 {
                return Err(Error::RankDeficientSystem);
            }
            C.row_mut(i).unscale_mut(size);
            D.row_mut(i).unscale_mut(size);
        }
        let rank_tolerance = 100.0 * (sys.n_states() + D.nrows()) as f64 * f64::EPSILON;
        Ok((Self { A: sys.a() / rate, B, C, D, rank_tolerance }, rate))
    }

    /// A system with the same zeros and an invertible `D`.
    fn reduced(&self) -> Result<Self, Error> {
        let mut s = self.clone();
        let m = s.D.nrows();
        // Each pass removes at least one state, and without states D is invertible or the rank is deficient.
        for _ in 0..=self.A.nrows() {
            let (U, rank) = row_compression(&s.D, s.rank_tolerance);
            if rank == m {
                return Ok(s);
            }
            let (C, D) = (U.transpose() * &s.C, U.transpose() * &s.D);
            let free_rows = C.rows(rank, m - rank).into_owned();
            let (V, fixed) = row_compression(&free_rows.transpose(), s.rank_tolerance);
            if fixed < m - rank {
                return Err(Error::RankDeficientSystem);
            }
            // States ordered as (fixed, kept): the free rows of C force the fixed ones to zero.
            let (A, B, C) = (V.transpose() * &s.A * &V, V.transpose() * &s.B, C * &V);
            let kept = A.nrows() - fixed;
            let mut next_C = DMatrix::zeros(m, kept);
            let mut next_D = DMatrix::zeros(m, m);
            next_C.rows_mut(0, fixed).copy_from(&A.view((0, fixed), (fixed, kept)));
            next_C.rows_mut(fixed, rank).copy_from(&C.view((0, fixed), (rank, kept)));
            next_D.rows_mut(0, fixed).copy_from(&B.rows(0, fixed));
            next_D.rows_mut(fixed, rank).copy_from(&D.rows(0, rank));
            s.A = A.view((fixed, fixed), (kept, kept)).into_owned();
            s.B = B.rows(fixed, kept).into_owned();
            (s.C, s.D) = (next_C, next_D);
        }
        Err(Error::RankDeficientSystem)
    }

    /// The zeros of a system with an invertible `D`.
    ///
    /// The eigenvalues of `A - B D^-1 C` would do, but an ill-conditioned `D` has zeros far out, whose size sets the
    /// rounding error of the small ones. With the upper left block `X` of the inverse of the system matrix at a real `sigma`,
    /// every zero is `sigma + 1 / mu` for an eigenvalue `mu` of `X`: here it is the far ones that lose digits.
    fn zeros_with_invertible_d(&self) -> Result<Vec<Complex64>, Error> {
        let n = self.A.nrows();
        let at_shift = |sigma: f64| {
            let inverse = self.at(Complex64::new(sigma, 0.0)).try_inverse()?;
            let X = inverse.view((0, 0), (n, n)).map(|v| v.re);
            X.iter().all(|v| v.is_finite()).then_some((sigma, X))
        };
        let best =
            SHIFTS.into_iter().filter_map(at_shift).min_by(|(_, X), (_, Y)| X.norm().total_cmp(&Y.norm()));
        let (sigma, X) = best.ok_or(Error::RankDeficientSystem)?;
        let smallest = self.rank_tolerance * X.norm();
        let mut zeros = eigenvalues(&X)?;
        // Below that size a zero cannot be told from one at infinity.
        zeros.retain(|mu| mu.norm() > smallest);
        // The inverse of the conjugate keeps the upper member of a pair first.
        Ok(zeros.into_iter().map(|mu| sigma + mu.conj().inv()).collect())
    }

    /// Newton's method on `det [A - lambda I, B; C, D]`, whose logarithmic derivative is `-trace` of the upper left
    /// block of the inverse.
    fn polish(&self, zeros: &mut [Complex64]) {
        for k in 0..zeros.len() {
            let start = zeros[k];
            if start.im < 0.0 {
                // Pairs are adjacent, the member with the positive imaginary part first.
                zeros[k] = zeros[k - 1].conj();
                continue;
            }
            let others = zeros.iter().enumerate().filter(|(j, _)| *j != k);
            let gap = others.map(|(_, other)| (other - start).norm()).fold(f64::INFINITY, f64::min);
            let mut last_step = 0.25 * gap;
            for _ in 0..NEWTON_STEPS {
                let Some(step) = self.newton_step(zeros[k]) else { break };
                if step.norm() >= 0.5 * last_step || (zeros[k] + step - start).norm() >= 0.25 * gap {
                    break;
                }
                // A zero on the real axis stays there.
                zeros[k] += if start.im == 0.0 { Complex64::new(step.re, 0.0) } else { step };
                last_step = step.norm();
            }
        }
    }

    fn newton_step(&self, zero: Complex64) -> Option<Complex64> {
        let inverse = self.at(zero).try_inverse()?;
        let trace: Complex64 = (0..self.A.nrows()).map(|i| inverse[(i, i)]).sum();
        let step = trace.inv();
        (step.re.is_finite() && step.im.is_finite()).then_some(step)
    }

    /// `[A - lambda I, B; C, D]`.
    fn at(&self, lambda: Complex64) -> DMatrix<Complex64> {
        let real = blocks(&self.A, &self.B, &self.C, &self.D);
        let mut matrix = real.map(|v| Complex64::new(v, 0.0));
        for i in 0..self.A.nrows() {
            matrix[(i, i)] -= lambda;
        }
        matrix
    }
}

/// An orthogonal `U` for which only the first `rank` rows of `U^T m` exceed the tolerance, and that rank.
///
/// Householder reflections with column pivoting. A reflection that moves a coordinate axis onto another is an exact
/// permutation, so the zeros of a companion form stay zeros; singular vectors would fill them with rounding errors, which
/// a high relative degree then multiplies.
pub(crate) fn row_compression(m: &DMatrix<f64>, tolerance: f64) -> (DMatrix<f64>, usize) {
    let n = m.nrows();
    let (mut rest, mut U) = (m.clone(), DMatrix::identity(n, n));
    let mut rank = 0;
    while rank < n {
        let below = |j: usize| rest.view((rank, j), (n - rank, 1)).norm();
        let Some(pivot) = (0..m.ncols()).max_by(|&j, &k| below(j).total_cmp(&below(k))) else { break };
        if below(pivot) <= tolerance {
            break;
        }
        let mut v = DVector::zeros(n);
        v.rows_mut(rank, n - rank).copy_from(&rest.view((rank, pivot), (n - rank, 1)));
        v[rank] += v.norm().copysign(v[rank]);
        let twice = 2.0 / v.norm_squared();
        let (row, column) = (v.transpose() * &rest, &U * &v);
        rest -= &v * row * twice;
        U -= column * v.transpose() * twice;
        rank += 1;
    }
    (U, rank)
}

/// Real points to invert at, of the size of the normalized system; that with the smallest inverse is farthest from a zero.
const SHIFTS: [f64; 4] = [0.618, -0.382, 0.146, -1.272];
/// Newton doubles the digits per step and starts with six or more of sixteen.
const NEWTON_STEPS: usize = 4;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Continuous, TransferFunction};
    use nalgebra::dmatrix;
    use rand::{RngExt, SeedableRng};

    fn nearest(zeros: &[Complex64], expected: Complex64) -> f64 {
        zeros.iter().map(|z| (z - expected).norm()).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn law_zeros_make_the_system_matrix_singular_for_random_systems() {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(11);
        let mut random = |r, c| DMatrix::from_fn(r, c, |_, _| rng.random_range(-1.0..1.0));
        for (n, m, direct) in [(3, 1, 0.0), (5, 2, 0.0), (6, 2, 1.0), (8, 3, 0.0), (7, 3, 1e-9)] {
            let (A, B, C, D) = (random(n, n), random(n, m), random(m, n), random(m, m) * direct);
            let sys =
                StateSpace::<Continuous>::new(A.clone(), B.clone(), C.clone(), D.clone()).expect("valid");
            let zeros = sys.zeros().expect("full rank");
            // Generic systems have n zeros with a direct term and n - m without.
            assert_eq!(zeros.len(), if direct == 0.0 { n - m } else { n });
            for zero in zeros {
                let mut pencil = DMatrix::<Complex64>::zeros(n + m, n + m);
                for (row, col, block) in [(0, 0, &A), (0, n, &B), (n, 0, &C), (n, n, &D)] {
                    pencil
                        .view_mut((row, col), block.shape())
                        .copy_from(&block.map(|v| Complex64::new(v, 0.0)));
                }
                for i in 0..n {
                    pencil[(i, i)] -= zero;
                }
                let singular = pencil.singular_values();
                assert!(singular.min() < 1e-13 * singular.max(), "n {n} m {m}: {zero} {:e}", singular.min());
            }
        }
    }

    #[test]
    fn law_similarity_does_not_move_a_zero() {
        let tf = TransferFunction::new(&[1.0, 2.0, 50.0], &[1.0, 3.0, 80.0, 90.0, 700.0]).expect("valid");
        let sys = tf.to_state_space();
        let T = dmatrix![1.0, 0.3, 0.0, 0.2; 0.1, 2.0, 0.5, 0.0; 0.0, 0.4, 1.5, 0.1; 0.7, 0.0, 0.2, 1.0];
        let inverse = T.clone().try_inverse().expect("regular");
        let moved = StateSpace::<Continuous>::new(
            &inverse * sys.a() * &T,
            &inverse * sys.b(),
            sys.c() * &T,
            sys.d().clone(),
        );
        let zeros = moved.expect("valid").zeros().expect("full rank");
        assert_eq!(zeros.len(), 2);
        for expected in [Complex64::new(-1.0, 7.0), Complex64::new(-1.0, -7.0)] {
            assert!(nearest(&zeros, expected) < 1e-12, "{zeros:?}");
        }
    }

    #[test]
    fn law_a_nearly_singular_direct_term_does_not_spoil_the_small_zeros() {
        // (s + 1e-3)(s + 2)(s 1e-9 + 1): zeros twelve decades apart.
        let numerator = crate::polynomial::multiply(&[1.0, 2.001, 0.002], &[1e-9, 1.0]);
        let tf = TransferFunction::new(&numerator, &[1.0, 6.0, 11.0, 6.0]).expect("valid");
        let zeros = tf.to_state_space().zeros().expect("full rank");
        for expected in [-1e-3, -2.0, -1e9] {
            let error = nearest(&zeros, Complex64::new(expected, 0.0)) / expected.abs();
            // 1e9 is known from D, which the realization stores to a rounding of 1e-9 against 1.
            assert!(error < 1e-6, "{expected}: {error:e}");
        }
        assert!(nearest(&zeros, Complex64::new(-1e-3, 0.0)) < 1e-12);
    }

    #[test]
    fn edge_a_system_without_rank_or_square_shape_is_refused() {
        let parallel_rows = StateSpace::<Continuous>::new(
            dmatrix![-1.0],
            dmatrix![1.0, 2.0],
            dmatrix![1.0; 3.0],
            DMatrix::zeros(2, 2),
        );
        assert_eq!(parallel_rows.expect("valid").zeros(), Err(Error::RankDeficientSystem));
        let zero = StateSpace::<Continuous>::from_gain(dmatrix![0.0]).expect("valid");
        assert_eq!(zero.zeros(), Err(Error::RankDeficientSystem));
        let wide = StateSpace::<Continuous>::from_gain(dmatrix![1.0, 2.0]).expect("valid");
        assert!(matches!(wide.zeros(), Err(Error::NotSquare { n_inputs: 2, n_outputs: 1 })));
    }
}
