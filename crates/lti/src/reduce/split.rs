//! Splitting a system into parts that share no pole: stable and unstable, or one block per mode.

use nalgebra::{DMatrix, Matrix4, Vector4};
use num_complex::Complex64;

use crate::schur::RealSchur;
use crate::{Error, StateSpace, TimeDomain};

/// A system as the sum of a stable and a remaining part.
#[derive(Debug, Clone, PartialEq)]
pub struct StableSplit<D: TimeDomain> {
    /// The part with poles inside of the boundary; carries the direct term.
    pub stable: StateSpace<D>,
    /// The part with the other poles; strictly proper.
    pub remaining: StateSpace<D>,
    /// Norm of the matrix that decouples the two: the angle between the two subspaces is about its inverse.
    pub coupling: f64,
}

/// The stable and the remaining part of a system, which add up to it.
///
/// **Shapes and units**: `boundary` is a real part in rad/s (continuous, at most 0) or a modulus (discrete, at most 1);
/// `None` means the stability boundary itself.
///
/// **Method**: ordered real Schur form, then the Sylvester equation that decouples the two diagonal blocks.
///
/// **Source**: Safonov, Jonckheere, Verma and Limebeer 1987, "Synthesis of positive real multivariable feedback systems",
/// Int. J. Control 45, appendix.
///
/// **Accuracy**: the response of the sum is that of the system up to rounding times `coupling`.
///
/// **Errors**: [`Error::ReductionSetting`] for a boundary outside of the stable region, [`Error::SpectraOverlap`] where a
/// pole lies on both sides to working precision; [`Error::SwapFailed`], [`Error::EigenvaluesNotConverged`].
///
/// **Example**
/// ```
/// use telepulse_lti::{TransferFunction, reduce::split_stable};
/// // 1/((s + 1)(s - 1)) = -0.5/(s + 1) + 0.5/(s - 1)
/// let sys = TransferFunction::new(&[1.0], &[1.0, 0.0, -1.0])?.to_state_space();
/// let parts = split_stable(&sys, None)?;
/// assert!((parts.stable.dc_gain()?[(0, 0)] + 0.5).abs() < 1e-14);
/// assert!((parts.remaining.dc_gain()?[(0, 0)] + 0.5).abs() < 1e-14);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn split_stable<D: TimeDomain>(
    sys: &StateSpace<D>,
    boundary: Option<f64>,
) -> Result<StableSplit<D>, Error> {
    let domain = *sys.domain();
    let discrete = domain.sample_time_of().is_some();
    let edge = boundary.unwrap_or(if discrete { 1.0 } else { 0.0 });
    let allowed = if discrete { edge > 0.0 && edge <= 1.0 } else { edge <= 0.0 && edge.is_finite() };
    if !allowed {
        let allowed = if discrete { "above 0 and at most 1" } else { "finite and at most 0 rad/s" };
        return Err(Error::ReductionSetting { setting: "stability boundary", found: edge, allowed });
    }
    let inside = |pole: Complex64| if discrete { pole.norm() < edge } else { pole.re < edge };
    let balanced = sys.balanced();
    let ordered = RealSchur::new(balanced.a())?.order(inside)?;
    let (q, t, n_stable) = (&ordered.form.q, &ordered.form.t, ordered.n_selected);
    let (b, c) = (q.tr_mul(balanced.b()), balanced.c() * q);
    let (n, n_rest) = (t.nrows(), t.nrows() - n_stable);
    let (t11, t12) = (t.view((0, 0), (n_stable, n_stable)), t.view((0, n_stable), (n_stable, n_rest)));
    let t22 = t.view((n_stable, n_stable), (n_rest, n_rest));
    // [I X; 0 I] decouples: T11 X - X T22 = -T12.
    let x = solve_sylvester(&t11.into_owned(), &t22.into_owned(), &-t12)?;
    let (b1, b2) = (b.rows(0, n_stable), b.rows(n_stable, n_rest).into_owned());
    let (c1, c2) = (c.columns(0, n_stable).into_owned(), c.columns(n_stable, n_rest));
    let stable =
        StateSpace::with_domain(t11.into_owned(), b1 - &x * &b2, c1.clone(), sys.d().clone(), domain)?;
    let zero = DMatrix::zeros(sys.n_outputs(), sys.n_inputs());
    let remaining = StateSpace::with_domain(t22.into_owned(), b2, &c1 * &x + c2, zero, domain)?;
    debug_assert_eq!(n, stable.n_states() + remaining.n_states());
    Ok(StableSplit { stable, remaining, coupling: x.norm() })
}

/// A system in real block-diagonal form.
#[derive(Debug, Clone, PartialEq)]
pub struct BlockDiagonal<D: TimeDomain> {
    /// The system; `A` is zero outside of the blocks, and each block is in real Schur form.
    pub sys: StateSpace<D>,
    /// Sizes of the blocks from the top.
    pub block_sizes: Vec<usize>,
    /// Condition number of the transformation that led here, in the 2-norm.
    pub condition: f64,
}

/// The real block-diagonal form with the smallest blocks that a bounded transformation allows.
///
/// **Method**: real Schur form; the leading block is decoupled from the rest by a Sylvester equation where the solution
/// stays below `coupling_max`, otherwise the nearest eigenvalue joins the block and it is tried again. Defective and nearly
/// defective poles so stay together in one triangular block.
///
/// **Source**: Bavely and Stewart 1979, "An algorithm for computing reducing subspaces by block diagonalization",
/// SIAM J. Numer. Anal. 16(2), 359-367.
///
/// **Accuracy**: the response changes by rounding times `condition`.
///
/// **Errors**: [`Error::ReductionSetting`] unless `coupling_max` is at least one and finite;
/// [`Error::EigenvaluesNotConverged`].
///
/// **Example**: two equal poles that cannot be told apart stay together.
/// ```
/// use telepulse_lti::{TransferFunction, reduce::block_diagonalize};
/// let sys = TransferFunction::new(&[1.0], &[1.0, 7.0, 15.0, 9.0])?.to_state_space();
/// let blocks = block_diagonalize(&sys, 1e3)?;
/// let mut sizes = blocks.block_sizes.clone();
/// sizes.sort();
/// assert_eq!(sizes, [1, 2]);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn block_diagonalize<D: TimeDomain>(
    sys: &StateSpace<D>,
    coupling_max: f64,
) -> Result<BlockDiagonal<D>, Error> {
    if !(coupling_max >= 1.0 && coupling_max.is_finite()) {
        let (setting, found, allowed) = ("coupling_max", coupling_max, "at least 1 and finite");
        return Err(Error::ReductionSetting { setting, found, allowed });
    }
    let balanced = sys.balanced();
    let n = balanced.n_states();
    if n == 0 {
        // Neither an LU nor an SVD exists of a matrix without entries.
        return Ok(BlockDiagonal { sys: balanced, block_sizes: Vec::new(), condition: 1.0 });
    }
    let RealSchur { mut q, mut t } = RealSchur::new(balanced.a())?;
    let mut block_sizes = Vec::new();
    let mut start = 0;
    while start < n {
        let mut size = leading_size(&t, start);
        // Each pass takes at least one eigenvalue into the block.
        loop {
            let rest = n - start - size;
            if rest == 0 {
                break;
            }
            let t11 = t.view((start, start), (size, size)).into_owned();
            let t12 = t.view((start, start + size), (size, rest)).into_owned();
            let t22 = t.view((start + size, start + size), (rest, rest)).into_owned();
            if let Ok(x) = solve_sylvester(&t11, &t22, &-&t12)
                && x.amax() <= coupling_max
            {
                // Q [I X; 0 I]: the columns of the rest change, and with them what stands above in T.
                let moved = q.columns(start, size) * &x;
                let mut columns = q.columns_mut(start + size, rest);
                columns += moved;
                t.view_mut((start, start + size), (size, rest)).fill(0.0);
                break;
            }
            let centre = t11.trace() / size as f64;
            let spread = RealSchur { q: DMatrix::identity(rest, rest), t: t22.clone() };
            let values = spread.eigenvalues();
            let distance = |p: &Complex64| (p - centre).norm();
            let nearest = values.iter().copied().min_by(|p, r| distance(p).total_cmp(&distance(r)));
            let Some(nearest) = nearest else { break };
            match spread.order(|p| p == nearest || p == nearest.conj()) {
                Ok(ordered) => {
                    let form = ordered.form;
                    let columns = q.columns(start + size, rest) * &form.q;
                    q.columns_mut(start + size, rest).copy_from(&columns);
                    let above = &t12 * &form.q;
                    t.view_mut((start, start + size), (size, rest)).copy_from(&above);
                    t.view_mut((start + size, start + size), (rest, rest)).copy_from(&form.t);
                    size += leading_size(&t, start + size);
                }
                // Too close to be swapped: everything up to that eigenvalue joins as it stands.
                Err(_) => size += leading_size(&t, start + size),
            }
        }
        block_sizes.push(size);
        start += size;
    }
    let singular = q.clone().singular_values();
    let condition = singular.max() / singular.min();
    let lost = Error::Singular {
        matrix: "block-diagonalizing transformation",
        reciprocal_condition: 1.0 / condition,
    };
    let lu = q.clone().lu();
    let b = lu.solve(balanced.b()).ok_or(lost)?;
    let sys = StateSpace::with_domain(t, b, balanced.c() * &q, sys.d().clone(), *sys.domain())?;
    Ok(BlockDiagonal { sys, block_sizes, condition })
}

fn leading_size(t: &DMatrix<f64>, start: usize) -> usize {
    if start + 1 < t.nrows() && t[(start + 1, start)] != 0.0 { 2 } else { 1 }
}

/// Solves `L X - X R = F` for quasi-triangular `L` and `R` without a common eigenvalue.
pub(super) fn solve_sylvester(
    l: &DMatrix<f64>,
    r: &DMatrix<f64>,
    f: &DMatrix<f64>,
) -> Result<DMatrix<f64>, Error> {
    let (n, m) = (l.nrows(), r.nrows());
    let mut x = DMatrix::zeros(n, m);
    let row_blocks = blocks(l);
    let scale = l.amax().max(r.amax());
    for (j, nj) in blocks(r) {
        // Columns to the left are known: L X_j - X_j R_jj = F_j + sum X_l R_lj.
        let right = f.columns(j, nj) + x.columns(0, j) * r.view((0, j), (j, nj));
        for &(i, ni) in row_blocks.iter().rev() {
            let below = n - i - ni;
            let known = l.view((i, i + ni), (ni, below)) * x.view((i + ni, j), (below, nj));
            let mut system = Matrix4::identity() * scale.max(f64::MIN_POSITIVE);
            let mut rhs = Vector4::zeros();
            let index = |p: usize, q: usize| p + ni * q;
            for q in 0..nj {
                for p in 0..ni {
                    let row = index(p, q);
                    rhs[row] = right[(i + p, q)] - known[(p, q)];
                    system[(row, row)] = 0.0;
                    for k in 0..ni {
                        system[(row, index(k, q))] += l[(i + p, i + k)];
                    }
                    for k in 0..nj {
                        system[(row, index(p, k))] -= r[(j + k, j + q)];
                    }
                }
            }
            let lu = system.full_piv_lu();
            let pivot = lu.u().diagonal().iter().fold(f64::INFINITY, |m, v| m.min(v.abs()));
            let overlap = Error::SpectraOverlap { pivot, threshold: f64::EPSILON * scale };
            if pivot <= f64::EPSILON * scale {
                return Err(overlap);
            }
            let solution = lu.solve(&rhs).ok_or(overlap)?;
            for q in 0..nj {
                for p in 0..ni {
                    x[(i + p, j + q)] = solution[index(p, q)];
                }
            }
        }
    }
    Ok(x)
}

fn blocks(t: &DMatrix<f64>) -> Vec<(usize, usize)> {
    let mut list = Vec::new();
    let mut start = 0;
    while start < t.nrows() {
        let size = leading_size(t, start);
        list.push((start, size));
        start += size;
    }
    list
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reduce::testing;
    use crate::{Continuous, SampleTime, TransferFunction};

    #[test]
    fn law_parts_add_up_and_lie_on_their_sides() {
        for seed in 0..40 {
            let n = 1 + seed as usize % 9;
            let stable = testing::continuous(seed, n, 2, 2);
            let a = stable.a() + DMatrix::identity(n, n) * (0.1 + 2.0 * (seed % 5) as f64);
            let sys =
                StateSpace::<Continuous>::new(a, stable.b().clone(), stable.c().clone(), stable.d().clone())
                    .expect("shapes");
            let Ok(parts) = split_stable(&sys, None) else { panic!("seed {seed}") };
            assert!(parts.stable.is_stable().expect("poles"));
            assert!(parts.remaining.poles().expect("poles").iter().all(|p| p.re >= -1e-9), "seed {seed}");
            let sum = parts.stable.parallel(&parts.remaining).expect("ports");
            for omega in [0.3, 3.0, 30.0] {
                let (found, expected) =
                    (sum.at(omega).expect("off the axis"), sys.at(omega).expect("off the axis"));
                assert!(
                    (&found - &expected).norm() < 1e-11 * (1.0 + parts.coupling) * (1.0 + expected.norm()),
                    "seed {seed}"
                );
            }
        }
    }

    #[test]
    fn law_blocks_keep_the_response_and_decouple() {
        for seed in 0..40 {
            let sys = testing::continuous(seed, 2 + seed as usize % 10, 2, 2);
            let done = block_diagonalize(&sys, 1e4).expect("finite");
            assert_eq!(done.block_sizes.iter().sum::<usize>(), sys.n_states());
            assert!(done.block_sizes.iter().all(|&s| s <= 2), "seed {seed}: distinct poles");
            for omega in [0.0, 1.0, 20.0] {
                let off = (done.sys.at(omega).expect("stable") - sys.at(omega).expect("stable")).norm();
                assert!(
                    off < 1e-13 * done.condition * (1.0 + sys.at(omega).expect("stable").norm()),
                    "seed {seed}: {off:e}"
                );
            }
        }
    }

    #[test]
    fn edge_a_boundary_outside_of_the_stable_region_is_refused() {
        let sys = testing::continuous(1, 2, 1, 1);
        for boundary in [1.0, f64::NAN, f64::NEG_INFINITY] {
            assert!(matches!(split_stable(&sys, Some(boundary)), Err(Error::ReductionSetting { .. })));
        }
        assert!(matches!(block_diagonalize(&sys, 0.5), Err(Error::ReductionSetting { .. })));
        let held = sys.to_discrete_zoh(SampleTime::new(0.1).expect("positive")).expect("finite");
        assert!(split_stable(&held, Some(1.5)).is_err() && split_stable(&held, Some(0.5)).is_ok());
    }

    #[test]
    fn edge_a_quadruple_pole_stays_one_block() {
        let sys = TransferFunction::new(&[1.0], &[1.0, 4.0, 6.0, 4.0, 1.0]).expect("proper").to_state_space();
        let done = block_diagonalize(&sys, 100.0).expect("finite");
        assert_eq!(done.block_sizes, [4]);
        assert!(done.condition < 1e3);
    }
}
