//! Sylvester and Stein equations between upper quasi-triangular matrices: the core of Bartels-Stewart methods.

use nalgebra::DMatrix;

use crate::vectorized::{self, Kernel, axpy};

/// Which equation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Kind {
    /// `T Y + Y Sᵀ = F`.
    Continuous,
    /// `T Y Sᵀ - Y = F`.
    Discrete,
}

/// Whether `S = T` and `F` is symmetric, so that half of `Y` gives the other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Symmetry {
    General,
    Symmetric,
}

/// A pivot that is zero to working precision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SmallPivot {
    pub(crate) pivot: f64,
    pub(crate) threshold: f64,
}

/// Overwrites `F` with the solution `Y` for upper quasi-triangular `T` and `S`.
///
/// **Method**: block columns from the right, block rows from the bottom; all long loops run along columns.
///
/// **Source**: Bartels and Stewart 1972; Kitagawa 1977 for the discrete equation.
pub(crate) fn solve(
    t: &DMatrix<f64>,
    s: &DMatrix<f64>,
    f: &mut DMatrix<f64>,
    kind: Kind,
    symmetry: Symmetry,
) -> Result<(), SmallPivot> {
    let (m, n) = (t.nrows(), s.nrows());
    if m == 0 || n == 0 {
        return Ok(());
    }
    let largest = match kind {
        Kind::Continuous => t.amax().max(s.amax()),
        Kind::Discrete => (t.amax() * s.amax()).max(1.0),
    };
    let threshold = (f64::EPSILON * largest).max(f64::MIN_POSITIVE);
    let mut work = vec![0.0; 2 * m];
    let (t, s, f) = (t.as_slice(), s.as_slice(), f.as_mut_slice());
    vectorized::run(Substitution { t, m, s, n, f, kind, symmetry, threshold, work: &mut work })
}

/// As [`solve`] for the adjoint equation: `Tᵀ Y + Y S = F`, or `Tᵀ Y S - Y = F`.
///
/// **Method**: with rows and columns in reverse order the transposes are upper quasi-triangular.
pub(crate) fn solve_adjoint(
    t: &DMatrix<f64>,
    s: &DMatrix<f64>,
    f: &DMatrix<f64>,
    kind: Kind,
    symmetry: Symmetry,
) -> Result<DMatrix<f64>, SmallPivot> {
    let mut reversed = reverse(f);
    solve(&reverse(&t.transpose()), &reverse(&s.transpose()), &mut reversed, kind, symmetry)?;
    Ok(reverse(&reversed))
}

fn reverse(m: &DMatrix<f64>) -> DMatrix<f64> {
    let (rows, cols) = m.shape();
    let mut reversed = DMatrix::zeros(rows, cols);
    reversed.iter_mut().zip(m.as_slice().iter().rev()).for_each(|(r, v)| *r = *v);
    reversed
}

/// Estimates the 2-norm of the inverse of the operator `Y -> T Y + Y Sᵀ` or `Y -> T Y Sᵀ - Y`: one over its separation.
///
/// **Accuracy**: a lower bound by power iteration, commonly within a factor of three; infinite for a singular operator.
pub(crate) fn inverse_norm(t: &DMatrix<f64>, s: &DMatrix<f64>, kind: Kind, symmetry: Symmetry) -> f64 {
    let (m, n) = (t.nrows(), s.nrows());
    if m == 0 || n == 0 {
        return 0.0;
    }
    // A symmetric start that no structure of the matrices is likely to be orthogonal to.
    let mut y = DMatrix::from_fn(m, n, |i, j| ((i * j + i + j) % 7) as f64 - if i == j { 1.0 } else { 3.0 });
    let mut norm: f64 = 0.0;
    for step in 1..=POWER_STEPS {
        let size = y.norm();
        if size == 0.0 || !size.is_finite() {
            break;
        }
        y /= size;
        if solve(t, s, &mut y, kind, symmetry).is_err() {
            return f64::INFINITY;
        }
        norm = norm.max(y.norm());
        if step == POWER_STEPS {
            break;
        }
        match solve_adjoint(t, s, &y, kind, symmetry) {
            Ok(next) => y = next,
            Err(_) => return f64::INFINITY,
        }
    }
    norm
}

struct Substitution<'a> {
    t: &'a [f64],
    m: usize,
    s: &'a [f64],
    n: usize,
    f: &'a mut [f64],
    kind: Kind,
    symmetry: Symmetry,
    threshold: f64,
    work: &'a mut [f64],
}

impl Kernel for Substitution<'_> {
    type Output = Result<(), SmallPivot>;

    #[inline(always)]
    fn run<const FUSED: bool>(self) -> Self::Output {
        let Self { t, m, s, n, f, kind, symmetry, threshold, work } = self;
        let mut end = n;
        while end > 0 {
            let width = block_size(s, n, end);
            let j = end - width;
            let (left, right) = f.split_at_mut(end * m);
            let block = &mut left[j * m..];
            // Rows above `rows` are unknown; in the symmetric case the others are known from the columns to the right.
            let rows = if symmetry == Symmetry::Symmetric { end } else { m };
            for k in rows..m {
                for c in 0..width {
                    block[c * m + k] = right[(k - end) * m + j + c];
                }
            }
            let mut diagonal = [[0.0; 2]; 2];
            for c in 0..width {
                for d in 0..width {
                    diagonal[c][d] = s[(j + d) * n + j + c];
                }
            }
            // What the columns already known contribute: the sum of S_jl Y_l.
            let w = &mut work[..width * m];
            w.fill(0.0);
            for (l, column) in right.chunks_exact(m).enumerate() {
                let weights = &s[(end + l) * n + j..];
                for (w, weight) in w.chunks_exact_mut(m).zip(weights) {
                    if kind == Kind::Continuous {
                        axpy::<FUSED>(&mut w[..rows], *weight, &column[..rows]);
                    } else {
                        axpy::<FUSED>(w, *weight, column);
                    }
                }
            }
            match kind {
                Kind::Continuous => {
                    for (column, w) in block.chunks_exact_mut(m).zip(w.chunks_exact(m)) {
                        let (upper, known) = column.split_at_mut(rows);
                        upper.iter_mut().zip(w).for_each(|(x, w)| *x -= w);
                        for (k, y) in known.iter().enumerate() {
                            axpy::<FUSED>(upper, -*y, &t[(rows + k) * m..]);
                        }
                    }
                }
                Kind::Discrete => {
                    for k in rows..m {
                        for c in 0..width {
                            for d in 0..width {
                                w[c * m + k] += diagonal[c][d] * block[d * m + k];
                            }
                        }
                    }
                    for (column, w) in block.chunks_exact_mut(m).zip(w.chunks_exact(m)) {
                        for (k, weight) in w.iter().enumerate() {
                            // One entry below the diagonal at most.
                            let length = rows.min(k + 2);
                            axpy::<FUSED>(&mut column[..length], -*weight, &t[k * m..k * m + length]);
                        }
                    }
                }
            }
            substitute_column::<FUSED>(t, m, block, rows, &diagonal, kind, threshold)?;
            end = j;
        }
        Ok(())
    }
}

/// Size of the diagonal block whose last row is `end - 1`.
#[inline(always)]
fn block_size(t: &[f64], n: usize, end: usize) -> usize {
    if end >= 2 && t[(end - 2) * n + end - 1] != 0.0 { 2 } else { 1 }
}

/// Solves one block column for its leading `rows`, from the bottom.
#[inline(always)]
fn substitute_column<const FUSED: bool>(
    t: &[f64],
    m: usize,
    block: &mut [f64],
    rows: usize,
    diagonal: &[[f64; 2]; 2],
    kind: Kind,
    threshold: f64,
) -> Result<(), SmallPivot> {
    let width = block.len() / m;
    let mut bottom = rows;
    while bottom > 0 {
        let height = block_size(t, m, bottom);
        let i = bottom - height;
        let y = match (height, width) {
            (1, 1) => solve_block::<1, 1, 1>(t, m, i, block, diagonal, kind, threshold)?,
            (1, _) => solve_block::<1, 2, 2>(t, m, i, block, diagonal, kind, threshold)?,
            (_, 1) => solve_block::<2, 1, 2>(t, m, i, block, diagonal, kind, threshold)?,
            _ => solve_block::<2, 2, 4>(t, m, i, block, diagonal, kind, threshold)?,
        };
        for (c, column) in block.chunks_exact_mut(m).enumerate() {
            for b in 0..height {
                let weight = match kind {
                    Kind::Continuous => y[b + height * c],
                    Kind::Discrete => (0..width).map(|d| diagonal[c][d] * y[b + height * d]).sum(),
                };
                axpy::<FUSED>(&mut column[..i], -weight, &t[(i + b) * m..]);
            }
        }
        bottom = i;
    }
    Ok(())
}

/// Solves for the `H × W` block whose first row is `i`, in place; returns it by columns.
#[inline(always)]
fn solve_block<const H: usize, const W: usize, const N: usize>(
    t: &[f64],
    m: usize,
    i: usize,
    block: &mut [f64],
    diagonal: &[[f64; 2]; 2],
    kind: Kind,
    threshold: f64,
) -> Result<[f64; 4], SmallPivot> {
    let mut system = [[0.0; N]; N];
    let mut y = [0.0; N];
    for c in 0..W {
        for a in 0..H {
            let row = a + H * c;
            y[row] = block[c * m + i + a];
            for d in 0..W {
                for b in 0..H {
                    let upper = t[(i + b) * m + i + a];
                    system[row][b + H * d] = match kind {
                        Kind::Continuous => {
                            (if c == d { upper } else { 0.0 }) + (if a == b { diagonal[c][d] } else { 0.0 })
                        }
                        Kind::Discrete => upper * diagonal[c][d] - (if a == b && c == d { 1.0 } else { 0.0 }),
                    };
                }
            }
        }
    }
    eliminate(&mut system, &mut y, threshold)?;
    let mut solution = [0.0; 4];
    solution[..N].copy_from_slice(&y);
    for c in 0..W {
        block[c * m + i..c * m + i + H].copy_from_slice(&y[H * c..H * (c + 1)]);
    }
    Ok(solution)
}

/// Gaussian elimination with partial pivoting.
#[inline(always)]
fn eliminate<const N: usize>(
    system: &mut [[f64; N]; N],
    y: &mut [f64; N],
    threshold: f64,
) -> Result<(), SmallPivot> {
    for k in 0..N {
        let (mut row, mut pivot) = (k, system[k][k].abs());
        for (i, entries) in system.iter().enumerate().skip(k + 1) {
            if entries[k].abs() > pivot {
                (row, pivot) = (i, entries[k].abs());
            }
        }
        if pivot <= threshold || pivot.is_nan() {
            return Err(SmallPivot { pivot, threshold });
        }
        system.swap(k, row);
        y.swap(k, row);
        let upper = system[k];
        for i in k + 1..N {
            let factor = system[i][k] / upper[k];
            system[i].iter_mut().zip(upper).skip(k + 1).for_each(|(x, u)| *x -= factor * u);
            y[i] -= factor * y[k];
        }
    }
    for k in (0..N).rev() {
        let known: f64 = (k + 1..N).map(|j| system[k][j] * y[j]).sum();
        y[k] = (y[k] - known) / system[k][k];
    }
    Ok(())
}

/// Each step squares the ratio of the operator's singular values; two suffice for an order of magnitude.
const POWER_STEPS: usize = 2;
