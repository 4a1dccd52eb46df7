//! How often a parameter enters: the rank of a matrix whose rows and columns have units of their own.

use nalgebra::DMatrix;

use crate::Error;

/// A matrix as `left right`, with as many inner columns as the matrix has rank.
pub(super) struct Factors {
    pub(super) left: DMatrix<f64>,
    pub(super) right: DMatrix<f64>,
}

/// Factors `change` through its rank; an entry of at most `noise` counts as zero.
///
/// **Method**: the rows and columns that are linked by entries form groups. Each group is scaled so that the logarithms of its entries
/// have mean zero in every row and column, which fixes the scales but for one factor and so takes out the units; the
/// singular value decomposition then decides, against the scaled noise. Groups without a link cannot share a rank.
///
/// **Source**: Curtis and Reid 1972, "On the automatic scaling of matrices for Gaussian elimination", J. Inst. Math. Appl. 10, for the
/// scales.
///
/// **Errors**: [`Error::SingularValuesNotConverged`].
pub(super) fn factor(change: &DMatrix<f64>, noise: &DMatrix<f64>) -> Result<Factors, Error> {
    let (n_rows, n_cols) = change.shape();
    let change = change.zip_map(noise, |value, floor| if value.abs() > floor { value } else { 0.0 });
    let (mut left, mut right) = (DMatrix::zeros(n_rows, 0), DMatrix::zeros(0, n_cols));
    for group in groups(&change) {
        let part = change.select_rows(&group.rows).select_columns(&group.cols);
        let floor = noise.select_rows(&group.rows).select_columns(&group.cols);
        let (row_scales, col_scales) = scales(&part);
        let scaled = |m: &DMatrix<f64>| {
            DMatrix::from_fn(m.nrows(), m.ncols(), |i, j| m[(i, j)] * row_scales[i] * col_scales[j])
        };
        let (values_u, v) = jacobi(scaled(&part)).ok_or(Error::SingularValuesNotConverged)?;
        let values: Vec<f64> = values_u.column_iter().map(|column| column.norm()).collect();
        let largest = values.iter().copied().fold(0.0, f64::max);
        let threshold = (RANK_TOLERANCE * largest).max(scaled(&floor).norm());
        for (k, &value) in values.iter().enumerate().filter(|(_, value)| **value > threshold) {
            let at = left.ncols();
            left = left.insert_column(at, 0.0);
            right = right.insert_row(at, 0.0);
            for (i, &row) in group.rows.iter().enumerate() {
                left[(row, at)] = values_u[(i, k)] / value.sqrt() / row_scales[i];
            }
            for (j, &col) in group.cols.iter().enumerate() {
                right[(at, col)] = v[(j, k)] * value.sqrt() / col_scales[j];
            }
        }
    }
    Ok(Factors { left, right })
}

/// `U diag(values)` and `V` of the singular value decomposition, in no order; none where it does not converge.
///
/// **Method**: rotations of pairs of columns until all are orthogonal. The library's own decomposition gave factors whose product
/// was another matrix for some of rank below full.
///
/// **Source**: Hestenes 1958; Demmel and Veselić 1992 for its accuracy.
fn jacobi(mut w: DMatrix<f64>) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
    let n = w.ncols();
    let mut v = DMatrix::identity(n, n);
    // Below this a column is what rotations leave of one that depends on the others.
    let negligible = f64::EPSILON * w.norm();
    for _ in 0..SWEEPS_MAX {
        let mut is_settled = true;
        for p in 0..n {
            for q in p + 1..n {
                let (a, b) = (w.column(p).norm_squared(), w.column(q).norm_squared());
                let inner = w.column(p).dot(&w.column(q));
                let size = (a * b).sqrt();
                if a.min(b).sqrt() <= negligible || inner.abs() <= ORTHOGONAL * size {
                    continue;
                }
                is_settled = false;
                // tan(2 angle) = 2 inner / (a - b); the smaller rotation.
                let zeta = (b - a) / (2.0 * inner);
                let tangent = zeta.signum() / (zeta.abs() + zeta.hypot(1.0));
                let cosine = 1.0 / tangent.hypot(1.0);
                let sine = cosine * tangent;
                for m in [&mut w, &mut v] {
                    for i in 0..m.nrows() {
                        let (x, y) = (m[(i, p)], m[(i, q)]);
                        m[(i, p)] = cosine * x - sine * y;
                        m[(i, q)] = sine * x + cosine * y;
                    }
                }
            }
        }
        if is_settled {
            return Some((w, v));
        }
    }
    None
}

/// Rows and columns that entries link, directly or through others.
struct Group {
    rows: Vec<usize>,
    cols: Vec<usize>,
}

fn groups(m: &DMatrix<f64>) -> Vec<Group> {
    let mut row_taken = vec![false; m.nrows()];
    let mut found = Vec::new();
    for start in 0..m.nrows() {
        if row_taken[start] {
            continue;
        }
        row_taken[start] = true;
        let mut group = Group { rows: vec![start], cols: Vec::new() };
        let mut next = 0;
        while next < group.rows.len() {
            for col in 0..m.ncols() {
                if m[(group.rows[next], col)] == 0.0 || group.cols.contains(&col) {
                    continue;
                }
                group.cols.push(col);
                for (row, taken) in row_taken.iter_mut().enumerate() {
                    if !*taken && m[(row, col)] != 0.0 {
                        *taken = true;
                        group.rows.push(row);
                    }
                }
            }
            next += 1;
        }
        if !group.cols.is_empty() {
            found.push(group);
        }
    }
    found
}

/// Factors of rows and columns that bring the geometric mean of the entries of each to one.
fn scales(m: &DMatrix<f64>) -> (Vec<f64>, Vec<f64>) {
    let log = m.map(|v| if v == 0.0 { f64::NAN } else { v.abs().ln() });
    let (mut rows, mut cols) = (vec![0.0_f64; m.nrows()], vec![0.0_f64; m.ncols()]);
    for _ in 0..SCALE_SWEEPS_MAX {
        let mut change = 0.0_f64;
        for i in 0..m.nrows() {
            let step = mean((0..m.ncols()).map(|j| log[(i, j)] + rows[i] + cols[j]));
            rows[i] -= step;
            change = change.max(step.abs());
        }
        for j in 0..m.ncols() {
            let step = mean((0..m.nrows()).map(|i| log[(i, j)] + rows[i] + cols[j]));
            cols[j] -= step;
            change = change.max(step.abs());
        }
        if change < SCALE_TOLERANCE {
            break;
        }
    }
    (rows.into_iter().map(f64::exp).collect(), cols.into_iter().map(f64::exp).collect())
}

/// The mean of what is a number; a linked row or column has at least one.
fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) =
        values.filter(|v| !v.is_nan()).fold((0.0, 0), |(sum, count), value| (sum + value, count + 1));
    sum / f64::from(count.max(1))
}

/// Relative to the largest singular value of the scaled matrix, whose entries are near one.
const RANK_TOLERANCE: f64 = 1e-12;
/// Ten are usual.
const SWEEPS_MAX: usize = 60;
/// Cosine of the angle between two columns that counts as zero.
const ORTHOGONAL: f64 = 1e-15;
const SCALE_SWEEPS_MAX: usize = 1000;
/// Of a natural logarithm: scales to a millionth decide nothing.
const SCALE_TOLERANCE: f64 = 1e-6;

#[cfg(test)]
mod tests {
    use nalgebra::dmatrix;
    use rand::{RngExt, SeedableRng};

    use super::*;

    #[test]
    fn law_the_rank_and_the_product_do_not_depend_on_the_units() {
        let seed = 71;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        for case in 0..200 {
            let rank = rng.random_range(1..=3);
            let mut part =
                |rows, cols| DMatrix::<f64>::from_fn(rows, cols, |_, _| rng.random_range(0.5..2.0));
            let mut product = part(5, rank) * part(rank, 4);
            for (row, decades) in [9, -7, 0, 4, -2].into_iter().enumerate() {
                product.row_mut(row).scale_mut(10f64.powi(decades));
            }
            for (col, decades) in [-8, 3, 0, 11].into_iter().enumerate() {
                product.column_mut(col).scale_mut(10f64.powi(decades));
            }
            let noise = product.map(|v| v.abs() * 16.0 * f64::EPSILON);
            let found = factor(&product, &noise).expect("decomposed");
            assert_eq!(found.left.ncols(), rank, "seed {seed} case {case}");
            let again = found.left * found.right;
            let worst = again.zip_map(&product, |a, b| (a / b - 1.0).abs()).max();
            // Sums of four terms of one size, each good to rounding.
            assert!(worst < 1e-12, "seed {seed} case {case}: {worst:e}");
        }
    }

    #[test]
    fn law_entries_without_a_link_each_count_and_noise_does_not() {
        let change = dmatrix![1e-9, 0.0, 0.0; 0.0, 1e9, 1e-3; 0.0, 0.0, 1e-17];
        let noise = dmatrix![0.0, 0.0, 0.0; 0.0, 0.0, 0.0; 0.0, 0.0, 1e-16];
        let found = factor(&change, &noise).expect("decomposed");
        assert_eq!(found.left.ncols(), 2);
        let none = factor(&DMatrix::zeros(2, 3), &DMatrix::zeros(2, 3)).expect("decomposed");
        assert_eq!((none.left.shape(), none.right.shape()), ((2, 0), (0, 3)));
    }
}
