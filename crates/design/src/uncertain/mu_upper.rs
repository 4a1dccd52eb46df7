//! Upper bound of the structured singular value of one matrix.
#![allow(non_snake_case)]

use nalgebra::DMatrix;
use num_complex::Complex64;

use super::lmi::Lmi;
use super::scalings::Scalings;
use super::structure::{Block, BlockStructure};
use crate::Error;

/// An upper bound of the structured singular value, with the scales that prove it.
#[derive(Clone, Debug, PartialEq)]
pub struct MuUpper {
    /// No admissible perturbation smaller than `1 / value` makes `I - M Delta` singular.
    pub value: f64,
    /// The scales that prove it: [`Scalings::prove`] holds at `value`.
    pub scalings: Scalings,
    /// How far `value` may lie above the least bound that D,G-scales can give, relative; from the duality gap.
    pub relative_gap: f64,
    /// Newton steps made.
    pub steps: usize,
    /// Worst directions: columns span the dominant range of the dual solution, `n_w × n_w`, in the units of `w`.
    pub(crate) directions: DMatrix<Complex64>,
}

/// Returns the least upper bound that D,G-scales give for the structured singular value of `m`.
///
/// **Shapes**: `m` is `n_z × n_w` as in [`BlockStructure`].
///
/// **Method**: Osborne balancing of the blocks, then a primal-dual interior-point method for
/// `min beta: Mᴴ D_L M + j (G M - Mᴴ G) < beta² D_R`. The value returned is one at which the inequality was confirmed by a
/// Cholesky factorisation with the scales returned and the matrix as it was given.
///
/// **Source**: Fan, Tits and Doyle 1991; Packard and Doyle 1993, Automatica 29(1), sections 8 and 9.
///
/// **Accuracy**: `1e-9` relative above the least bound. The least bound equals the structured singular value for
/// `2 S + F <= 3` (S repeated complex scalars, F full blocks, none real); otherwise it lies above. Where the infimum needs
/// infinite scales the bound is approached: to `1e-8` for a block triangular `m`, to about `1e-7` of the largest singular
/// value for a defective `m` with one repeated scalar, to 1e-5 where both come together.
///
/// **Errors**: [`telepulse_lti::Error::Shape`], [`telepulse_lti::Error::NotFinite`]; [`Error::MuNotProven`] where rounding
/// spoils every proof.
///
/// **Example**: a rank-one matrix `a bᴴ` with scalar blocks has the structured singular value `sum |a_i b_i|`.
/// ```
/// use nalgebra::dmatrix;
/// use num_complex::Complex64;
/// use telepulse_design::uncertain::{Block, BlockStructure, mu_upper_bound};
/// let m = dmatrix![1.0, 2.0; 10.0, 20.0].map(|v| Complex64::new(v, 0.0));
/// let structure = BlockStructure::new(vec![Block::Full { rows: 1, cols: 1 }; 2])?;
/// let bound = mu_upper_bound(&m, &structure)?;
/// assert!((bound.value - 21.0).abs() < 1e-6);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn mu_upper_bound(m: &DMatrix<Complex64>, structure: &BlockStructure) -> Result<MuUpper, Error> {
    upper_bound_below(m, structure, 0.0)
}

/// As [`mu_upper_bound`], but content with any bound below `enough`: scales that are not driven to the edge of what they
/// prove hold farther away.
pub(super) fn upper_bound_below(
    m: &DMatrix<Complex64>,
    structure: &BlockStructure,
    enough: f64,
) -> Result<MuUpper, Error> {
    structure.check(m)?;
    let (n_w, n_z) = (structure.n_w(), structure.n_z());
    let size = m.iter().fold(0.0_f64, |s, v| s.max(v.re.abs()).max(v.im.abs()));
    if size == 0.0 {
        let directions = DMatrix::zeros(n_w, n_w);
        let scalings = Scalings::identity(structure);
        return Ok(MuUpper { value: 0.0, scalings, relative_gap: 0.0, steps: 0, directions });
    }
    let m = &m.map(|v| v / size);
    let norms = block_norms(m, structure);
    let components = strong_components(&norms);
    let unscaled = Lmi::new(structure, m.as_slice().to_vec());
    let mut enough = enough / size;
    // A nilpotent part has no least bound but zero, and scales that go to infinity on the way there: where rounding spoils the proof,
    // a larger bound with milder scales is the answer.
    let shares = if components.len() == 1 { &COUPLING_SHARES[..1] } else { &COUPLING_SHARES[..] };
    for _ in 0..CONTENT_STEPS_MAX {
        let mut start = 0.0;
        for &share in shares {
            let mut bound = if components.len() == 1 {
                irreducible(m, structure, &norms, enough)
            } else {
                reducible(m, structure, &norms, &components, (enough, share))
            };
            // The level was confirmed for the balanced matrix; a few ulps may be missing for the original one.
            let mut margin = 4.0 * n_z.max(n_w) as f64 * f64::EPSILON;
            start = bound.value;
            let mut holds = bound.scalings.hold_in(&unscaled, n_w, bound.value);
            while !holds && margin <= MARGIN_MAX {
                bound.value = start * (1.0 + margin);
                margin *= 4.0;
                holds = bound.scalings.hold_in(&unscaled, n_w, bound.value);
            }
            if holds {
                bound.value *= size;
                bound.scalings.g.iter_mut().for_each(|g| g.apply(|v| *v *= size));
                return Ok(bound);
            }
        }
        enough = CONTENT_RATIO * enough.max(start);
    }
    Err(Error::MuNotProven { level: enough * size })
}

/// The bound of a matrix whose blocks all influence each other.
fn irreducible(
    m: &DMatrix<Complex64>,
    structure: &BlockStructure,
    norms: &DMatrix<f64>,
    enough: f64,
) -> MuUpper {
    let n_w = structure.n_w();
    let mut scalings = Scalings::identity(structure);
    let scale = balance_blocks(norms);
    let mut balanced = m.clone();
    for (i, at_z) in structure.placed().enumerate() {
        for (j, at_w) in structure.placed().enumerate() {
            let shape = (at_z.block.cols(), at_w.block.rows());
            balanced.view_mut((at_z.col, at_w.row), shape).apply(|v| *v *= scale[i] / scale[j]);
        }
    }
    let sigma = largest_singular_value(&balanced);
    if sigma == 0.0 {
        let directions = DMatrix::zeros(n_w, n_w);
        return MuUpper { value: VALUE_FLOOR, scalings, relative_gap: 0.0, steps: 0, directions };
    }
    if structure.blocks().len() == 1 && matches!(structure.blocks()[0], Block::Full { .. }) {
        let directions = dominant_gram(&balanced);
        return MuUpper { value: sigma, scalings, relative_gap: 0.0, steps: 0, directions };
    }
    balanced.apply(|v| *v /= sigma);
    let lmi = Lmi::new(structure, balanced.as_slice().to_vec());
    let solution = lmi.minimize(START_LEVEL, GAP_TARGET, (enough / sigma).powi(2));
    // M = sigma s^-1 M_b s, so D scales with the square of s, and G with that and sigma.
    let block = |data: &[Complex64], k: usize, f: f64| DMatrix::from_fn(k, k, |i, j| data[j * k + i] * f);
    for (i, s) in scale.iter().enumerate() {
        let k = scalings.d[i].nrows();
        scalings.d[i] = block(&solution.d[i], k, s * s);
        if !solution.g[i].is_empty() {
            scalings.g[i] = block(&solution.g[i], k, s * s * sigma);
        }
    }
    let mut directions = DMatrix::from_column_slice(n_w, n_w, &solution.Z);
    for (at, s) in structure.placed().zip(&scale) {
        directions.rows_mut(at.row, at.block.rows()).apply(|v| *v /= *s);
        directions.columns_mut(at.row, at.block.rows()).apply(|v| *v /= *s);
    }
    MuUpper {
        value: sigma * solution.lambda.max(0.0).sqrt().max(VALUE_FLOOR),
        scalings,
        relative_gap: solution.relative_gap.abs(),
        steps: solution.steps,
        directions,
    }
}

/// The bound of a matrix that is block triangular in the order of its components: that of the worst diagonal block.
///
/// The infimum needs infinitely different scales for the components; finite ones come within [`REDUCIBLE_MARGIN`].
fn reducible(
    m: &DMatrix<Complex64>,
    structure: &BlockStructure,
    norms: &DMatrix<f64>,
    components: &[Vec<usize>],
    (enough, coupling_share): (f64, f64),
) -> MuUpper {
    let placed: Vec<_> = structure.placed().collect();
    let mut whole = MuUpper {
        value: VALUE_FLOOR,
        scalings: Scalings::identity(structure),
        relative_gap: 0.0,
        steps: 0,
        directions: DMatrix::zeros(structure.n_w(), structure.n_w()),
    };
    let mut parts = Vec::new();
    for component in components {
        let rows: Vec<usize> =
            component.iter().flat_map(|&i| placed[i].col..placed[i].col + placed[i].block.cols()).collect();
        let cols: Vec<usize> =
            component.iter().flat_map(|&i| placed[i].row..placed[i].row + placed[i].block.rows()).collect();
        let sub = m.select_rows(&rows).select_columns(&cols);
        let sub_structure = structure.restricted(component);
        let sub_norms = norms.select_rows(component).select_columns(component);
        let part = irreducible(&sub, &sub_structure, &sub_norms, enough);
        if part.value > whole.value {
            whole.value = part.value;
            whole.directions.fill(Complex64::new(0.0, 0.0));
            for (j, &col) in cols.iter().enumerate() {
                for (i, &row) in cols.iter().enumerate() {
                    whole.directions[(row, col)] = part.directions[(i, j)];
                }
            }
        }
        whole.relative_gap = whole.relative_gap.max(part.relative_gap);
        whole.steps += part.steps;
        parts.push(part);
    }
    let is_coupled =
        |a: &Vec<usize>, b: &Vec<usize>| a.iter().any(|&i| b.iter().any(|&j| norms[(i, j)] != 0.0));
    if components.iter().enumerate().any(|(k, a)| components[k + 1..].iter().any(|b| is_coupled(a, b))) {
        whole.value *= 1.0 + REDUCIBLE_MARGIN;
    }
    // Scales grow from component to component until what couples them is negligible at this level.
    let mut factor = 1.0;
    let mut done: Vec<usize> = Vec::new();
    for (component, part) in components.iter().zip(parts) {
        let d_norm =
            |k: usize, scalings: &Scalings| scalings.d[k].iter().fold(0.0_f64, |s, v| s.max(v.norm()));
        let own = part
            .scalings
            .d
            .iter()
            .map(|d| d.iter().fold(f64::INFINITY, |s, v| if v.norm() > 0.0 { s.min(v.norm()) } else { s }))
            .fold(f64::INFINITY, f64::min);
        for &i in &done {
            for &j in component {
                let coupling = norms[(i, j)] / whole.value;
                let needed = d_norm(i, &whole.scalings) * coupling * coupling / (own * coupling_share);
                factor = f64::max(factor, needed.min(FACTOR_MAX));
            }
        }
        for (k, &i) in component.iter().enumerate() {
            whole.scalings.d[i] = &part.scalings.d[k] * Complex64::new(factor, 0.0);
            whole.scalings.g[i] = &part.scalings.g[k] * Complex64::new(factor, 0.0);
        }
        done.extend(component);
    }
    whole
}

/// Frobenius norms of the blocks of `m`: row block `i` belongs to the columns of `Delta_i`, column block `j` to its rows.
fn block_norms(m: &DMatrix<Complex64>, structure: &BlockStructure) -> DMatrix<f64> {
    let n = structure.blocks().len();
    let mut norms = DMatrix::zeros(n, n);
    for (i, at_z) in structure.placed().enumerate() {
        for (j, at_w) in structure.placed().enumerate() {
            let block = m.view((at_z.col, at_w.row), (at_z.block.cols(), at_w.block.rows()));
            // Squares of small blocks would underflow, and a block that is not zero would count as zero.
            let top = block.iter().fold(0.0_f64, |s, v| s.max(v.re.abs()).max(v.im.abs()));
            if top > 0.0 {
                norms[(i, j)] = top * block.map(|v| v / top).norm();
            }
        }
    }
    norms
}

/// Sets of blocks that influence each other, ordered so that `m` is upper block triangular.
///
/// **Method**: transitive closure of the graph of nonzero blocks; the order is by the number of blocks that can be reached.
fn strong_components(norms: &DMatrix<f64>) -> Vec<Vec<usize>> {
    let n = norms.nrows();
    let mut reach = norms.map(|v| v != 0.0);
    (0..n).for_each(|i| reach[(i, i)] = true);
    for k in 0..n {
        for i in 0..n {
            for j in 0..n {
                reach[(i, j)] |= reach[(i, k)] && reach[(k, j)];
            }
        }
    }
    let mut components: Vec<Vec<usize>> = Vec::new();
    for i in 0..n {
        match components.iter_mut().find(|c| reach[(i, c[0])] && reach[(c[0], i)]) {
            Some(component) => component.push(i),
            None => components.push(vec![i]),
        }
    }
    components.sort_by_key(|c| std::cmp::Reverse((0..n).filter(|&j| reach[(c[0], j)]).count()));
    components
}

/// Scales `s_i` that give the blocks `s_i M_ij / s_j` rows and columns of like size, leaving out the diagonal.
///
/// **Source**: Osborne 1960, as used by Safonov 1982 and Packard and Doyle 1993.
fn balance_blocks(norms: &DMatrix<f64>) -> Vec<f64> {
    let n = norms.nrows();
    let mut scale = vec![1.0_f64; n];
    for _ in 0..BALANCE_SWEEPS {
        let mut change = 0.0_f64;
        for i in 0..n {
            let others = || (0..n).filter(|&j| j != i);
            let row = others().map(|j| norms[(i, j)] / scale[j]).sum::<f64>();
            let col = others().map(|j| norms[(j, i)] * scale[j]).sum::<f64>();
            if row > 0.0 && col > 0.0 {
                let next = col.sqrt() / row.sqrt();
                if next.is_finite() && next > SCALE_MIN && next < 1.0 / SCALE_MIN {
                    change = change.max((next / scale[i] - 1.0).abs());
                    scale[i] = next;
                }
            }
        }
        if change < 1e-2 {
            break;
        }
    }
    // Around one, so that products with the squares of the scales stay in the range of floating point.
    let mean = (scale.iter().map(|s| s.ln()).sum::<f64>() / n as f64).exp();
    scale.iter_mut().for_each(|s| *s /= mean);
    scale
}

/// `v vᴴ` with the first right singular vector.
fn dominant_gram(m: &DMatrix<Complex64>) -> DMatrix<Complex64> {
    let gram = m.ad_mul(m).symmetric_eigen();
    let v = gram.eigenvectors.column(gram.eigenvalues.imax()).into_owned();
    &v * v.adjoint()
}

/// Of a matrix whose entries are of the order of one.
pub(crate) fn largest_singular_value(m: &DMatrix<Complex64>) -> f64 {
    let gram = if m.nrows() < m.ncols() { m * m.adjoint() } else { m.ad_mul(m) };
    gram.symmetric_eigenvalues().max().max(0.0).sqrt()
}

/// Level of the start over the largest singular value squared.
const START_LEVEL: f64 = 2.0;
/// Relative duality gap of `beta²` at which the iteration ends: half of it in `beta`.
const GAP_TARGET: f64 = 1e-9;
/// Smallest bound over the largest singular value of the balanced matrix.
const VALUE_FLOOR: f64 = 1e-8;
/// Largest relative increase that makes up for the rounding between the balanced and the original matrix.
const MARGIN_MAX: f64 = 1e-3;
/// What a block triangular matrix pays for finite scales, relative.
const REDUCIBLE_MARGIN: f64 = 1e-8;
/// Share of the squared level up to which the coupling of two components counts as negligible; the smaller ones where a component's own
/// proof has next to no room.
const COUPLING_SHARES: [f64; 4] = [1e-10, 1e-30, 1e-60, 1e-100];
/// Keeps the scales of the components within the range of floating point.
const FACTOR_MAX: f64 = 1e200;
const BALANCE_SWEEPS: usize = 30;
/// Steps towards larger bounds where none is proven, each by this ratio: from the floor to beyond the largest singular value.
const CONTENT_STEPS_MAX: usize = 30;
const CONTENT_RATIO: f64 = 4.0;
/// Scales are kept within this and its inverse.
const SCALE_MIN: f64 = 1e-140;
