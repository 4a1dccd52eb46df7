//! The order of the rows in which a matrix is as triangular as a permutation can make it.

use nalgebra::DMatrix;

/// The order in which rows and columns should stand so that eigenvalues that can be read off come first and last;
/// `None` where the given order is as good.
///
/// A triangular matrix in any order of its states, a lower triangular one included, becomes upper triangular and gives
/// its diagonal without rounding. Without this step the reduction to Hessenberg form mixes a small eigenvalue with large
/// ones and moves it by the machine precision times the norm.
///
/// **Source**: Parlett and Reinsch 1969; the permutations of LAPACK `dgebal`.
pub(crate) fn triangular_order(m: &DMatrix<f64>) -> Option<Vec<usize>> {
    let mut active: Vec<usize> = (0..m.nrows()).collect();
    let (mut head, mut tail) = (Vec::new(), Vec::new());
    // Each pass removes one row, so n passes end the loop.
    while let Some(k) =
        (0..active.len()).rev().find(|&k| active.iter().all(|&j| j == active[k] || m[(active[k], j)] == 0.0))
    {
        tail.push(active.remove(k));
    }
    while let Some(k) =
        (0..active.len()).find(|&k| active.iter().all(|&i| i == active[k] || m[(i, active[k])] == 0.0))
    {
        head.push(active.remove(k));
    }
    head.extend(active);
    head.extend(tail.into_iter().rev());
    if head.is_sorted() { None } else { Some(head) }
}

/// Puts rows and columns in the given order.
pub(crate) fn permute(m: &DMatrix<f64>, order: &[usize]) -> DMatrix<f64> {
    DMatrix::from_fn(m.nrows(), m.ncols(), |i, j| m[(order[i], order[j])])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::eigenvalues::eigenvalues;
    use crate::schur::RealSchur;
    use rand::seq::SliceRandom;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn regress_a_stiff_triangular_matrix_in_any_order_gives_its_diagonal() {
        // A lower triangular matrix with a diagonal over eight decades lost its small eigenvalues in the reduction to
        // Hessenberg form: a stable system had a pole at 3e-4.
        let seed = 77;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        for n in [1, 2, 3, 5, 12, 30] {
            let upper = DMatrix::from_fn(n, n, |i, j| match i.cmp(&j) {
                std::cmp::Ordering::Less => rng.random_range(-1.0..1.0),
                std::cmp::Ordering::Equal => -10.0_f64.powf(rng.random_range(-4.0..4.0)),
                std::cmp::Ordering::Greater => 0.0,
            });
            let mut order: Vec<usize> = (0..n).collect();
            order.shuffle(&mut rng);
            let mut expected: Vec<f64> = upper.diagonal().iter().copied().collect();
            expected.sort_by(f64::total_cmp);
            for m in [upper.clone(), upper.transpose(), permute(&upper, &order)] {
                let schur = RealSchur::new(&m).expect("schur");
                let back = &schur.q * &schur.t * schur.q.transpose();
                assert_eq!(back, m, "seed {seed} n {n}");
                for values in [eigenvalues(&m).expect("eigenvalues"), schur.eigenvalues()] {
                    let mut found: Vec<f64> = values.iter().map(|v| v.re).collect();
                    found.sort_by(f64::total_cmp);
                    assert_eq!(found, expected, "seed {seed} n {n}");
                }
            }
        }
    }

    #[test]
    fn law_a_core_between_isolated_states_keeps_them_exact() {
        // States 0 and 4 are isolated at both ends; the 3 x 3 core between them is a rotation and one real state.
        let core = nalgebra::dmatrix![0.0, 1.0, 0.5; -1.0, 0.0, 0.5; 1.0, 1.0, -2.0];
        let mut m = DMatrix::zeros(5, 5);
        m.view_mut((1, 1), (3, 3)).copy_from(&core);
        m[(0, 0)] = 1e-9;
        m[(4, 4)] = -1e9;
        // State 0 drives the core, the core drives state 4: lower block triangular.
        (1..4).for_each(|i| (m[(i, 0)], m[(4, i)]) = (1e3, 1e3));
        let values = eigenvalues(&m).expect("eigenvalues");
        assert!(values.iter().any(|v| v.re == 1e-9) && values.iter().any(|v| v.re == -1e9), "{values:?}");
        let product = values
            .iter()
            .filter(|v| v.re.abs() > 1e-6 && v.re.abs() < 1e6)
            .fold(num_complex::Complex64::new(1.0, 0.0), |p, v| p * v);
        assert!((product.re - core.determinant()).abs() < 1e-14 && product.im.abs() < 1e-14, "{product}");
    }
}
