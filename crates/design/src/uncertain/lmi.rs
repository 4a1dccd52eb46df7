//! The linear matrix inequality of the D,G-scales, solved by a primal-dual interior-point method.
#![allow(non_snake_case)]

use num_complex::Complex64;

use super::hermitian::{
    ZERO, cholesky, gram_of_lower, invert_lower, multiply, multiply_adjoint, real_cholesky_frozen,
    real_cholesky_solve,
};
use super::structure::{Block, BlockStructure};

/// `S = lambda D_R - Mᴴ D_L M - j (G M - Mᴴ G)` with its unknowns, for one matrix `M: n_z × n_w`.
pub(crate) struct Lmi {
    n: usize,
    n_z: usize,
    /// `M`, column-major.
    M: Vec<Complex64>,
    blocks: Vec<ScaleBlock>,
    variables: Vec<Variable>,
    /// Length of all blocks of `D` (and of `G`) laid out one after the other.
    len: usize,
}

/// One block of the scales: a `k × k` Hermitian matrix that is repeated `copies` times along a full block.
#[derive(Clone, Copy)]
struct ScaleBlock {
    k: usize,
    offset: usize,
    row: usize,
    rows: usize,
    col: usize,
    cols: usize,
    is_real: bool,
}

/// A real unknown: a direction in `D` or in `G`.
struct Variable {
    is_g: bool,
    block: usize,
    /// The direction in its block: entries `(p, q, value)`.
    entries: Vec<(usize, usize, Complex64)>,
    /// The direction in `S`: dyads `value u_a u_bᴴ` over the columns of `U = [I, Mᴴ]`.
    dyads: Vec<Dyad>,
}

#[derive(Clone, Copy)]
struct Dyad {
    a: usize,
    b: usize,
    value: Complex64,
    /// Whether the dyad carries the factor `lambda`.
    with_lambda: bool,
}

/// What the interior-point method ends with.
pub(crate) struct Solution {
    /// A level at which `S` is positive definite with the scales below.
    pub(crate) lambda: f64,
    /// Blocks of `D`, column-major, in the order of the structure; `1 × 1` for a full block.
    pub(crate) d: Vec<Vec<Complex64>>,
    /// Blocks of `G`, empty for a block that is not real.
    pub(crate) g: Vec<Vec<Complex64>>,
    /// The dual matrix, `n_w × n_w`, column-major: its range holds the worst directions.
    pub(crate) Z: Vec<Complex64>,
    /// Newton steps made.
    pub(crate) steps: usize,
    /// Complementarity gap over `lambda` where it stopped.
    pub(crate) relative_gap: f64,
}

/// The moving parts of the iteration.
struct State {
    lambda: f64,
    D: Vec<Complex64>,
    G: Vec<Complex64>,
    Z: Vec<Complex64>,
    Y: Vec<Complex64>,
}

struct Direction {
    lambda: f64,
    D: Vec<Complex64>,
    G: Vec<Complex64>,
    S: Vec<Complex64>,
    Z: Vec<Complex64>,
    Y: Vec<Complex64>,
}

impl Lmi {
    pub(crate) fn new(structure: &BlockStructure, M: Vec<Complex64>) -> Self {
        let (n, n_z) = (structure.n_w(), structure.n_z());
        let (mut blocks, mut variables, mut len) = (Vec::new(), Vec::new(), 0);
        for (index, at) in structure.placed().enumerate() {
            let (rows, cols) = (at.block.rows(), at.block.cols());
            let k = if matches!(at.block, Block::Full { .. }) { 1 } else { rows };
            let block = ScaleBlock {
                k,
                offset: len,
                row: at.row,
                rows,
                col: at.col,
                cols,
                is_real: at.block.is_real(),
            };
            len += k * k;
            if let Block::Full { .. } = at.block {
                variables.push(full_variable(index, &block, n));
            } else {
                for is_g in [false, true] {
                    if is_g && !block.is_real {
                        continue;
                    }
                    for p in 0..k {
                        for q in 0..=p {
                            push_hermitian_variables(index, &block, n, is_g, p, q, &mut variables);
                        }
                    }
                }
            }
            blocks.push(block);
        }
        Self { n, n_z, M, blocks, variables, len }
    }

    /// Minimises `lambda` from `D = I`, `G = 0` until it is below `enough`; `lambda_start` must be above the largest eigenvalue of `Mᴴ M`.
    ///
    /// **Method**: at every step the problem `min t` with `t D_R(x_k) + S(x) ≥ 0`, `D ≥ 0`, `tr D` fixed, is linear; one
    /// predictor and one corrector of the H..K..M direction are made and the reference `D_R(x_k)` moves on, so that the
    /// generalised eigenvalue `lambda` itself decreases. Every iterate is strictly feasible by a Cholesky factorisation.
    ///
    /// **Source**: Fan, Tits and Doyle 1991 for the inequality; Helmberg, Rendl, Vanderbei and Wolkowicz 1996 for the
    /// direction; Mehrotra 1992 for the corrector.
    pub(crate) fn minimize(&self, lambda_start: f64, tolerance: f64, enough: f64) -> Solution {
        let n = self.n;
        let mut state = self.start(lambda_start);
        let mut work = Work::new(self);
        let n_d: usize = self.blocks.iter().map(|b| b.k).sum();
        let degree = (n + n_d) as f64;
        let (mut steps, mut relative_gap) = (0, f64::INFINITY);
        let (mut stalled, mut progress) = (0, f64::INFINITY);
        while steps < STEPS_MAX {
            self.assemble(&state.D, &state.G, state.lambda, &mut work.S);
            if !work.factor(self, &state) {
                break;
            }
            let gap = real_inner(&state.Z, &work.S) + real_inner(&state.Y, &state.D);
            let infeasibility = work.dual_infeasibility(self, &state);
            relative_gap = gap / state.lambda.abs();
            let settled = infeasibility < INFEASIBILITY_MAX || progress < tolerance * state.lambda;
            if (relative_gap < tolerance && settled) || state.lambda < LAMBDA_TINY.max(enough) {
                break;
            }
            steps += 1;
            let mu = gap / degree;
            work.form_system(self, &state);
            let affine = self.direction(&state, &mut work, 0.0, None);
            let (primal, dual) = self.step_lengths(&state, &affine, &mut work, 1.0);
            let ahead = gap_after(&state, &work.S, &affine, primal, dual) / gap;
            let sigma = (ahead.max(0.0).powi(3)).clamp(1e-6, 1.0);
            let step = self.direction(&state, &mut work, sigma * mu, Some(&affine));
            let (primal, dual) = self.step_lengths(&state, &step, &mut work, STEP_BACK);
            add_scaled(&mut state.D, &step.D, primal);
            add_scaled(&mut state.G, &step.G, primal);
            state.lambda += primal * step.lambda;
            if primal > 0.5 {
                progress = step.lambda.abs();
            }
            add_scaled(&mut state.Z, &step.Z, dual);
            add_scaled(&mut state.Y, &step.Y, dual);
            stalled = if primal.max(dual) < STALLED_BELOW { stalled + 1 } else { 0 };
            if stalled >= 3 {
                break;
            }
        }
        let cut = |all: &[Complex64], b: &ScaleBlock| all[b.offset..b.offset + b.k * b.k].to_vec();
        Solution {
            lambda: state.lambda,
            d: self.blocks.iter().map(|b| cut(&state.D, b)).collect(),
            g: self.blocks.iter().map(|b| if b.is_real { cut(&state.G, b) } else { vec![] }).collect(),
            Z: state.Z,
            steps,
            relative_gap,
        }
    }

    fn start(&self, lambda: f64) -> State {
        let n = self.n;
        let mut D = vec![ZERO; self.len];
        for b in &self.blocks {
            for p in 0..b.k {
                D[b.offset + p * b.k + p].re = 1.0;
            }
        }
        let G = vec![ZERO; self.len];
        // Z = mu S^-1 with tr(Z D_R) = 1, Y = mu D^-1: on the central path but for the dual constraints.
        let mut S = vec![ZERO; n * n];
        self.assemble(&D, &G, lambda, &mut S);
        let mut inverse = vec![ZERO; n * n];
        let mut Z = vec![ZERO; n * n];
        if cholesky(&mut S, n) {
            invert_lower(&S, n, &mut inverse);
            gram_of_lower(&inverse, n, &mut Z);
        } else {
            (0..n).for_each(|i| Z[i * n + i].re = 1.0);
        }
        let mu = 1.0 / (0..n).map(|i| Z[i * n + i].re).sum::<f64>();
        Z.iter_mut().for_each(|v| *v *= mu);
        let Y = D.iter().map(|v| v * mu).collect();
        State { lambda, D, G, Z, Y }
    }

    /// `S` for the given scales.
    pub(crate) fn assemble(&self, D: &[Complex64], G: &[Complex64], lambda: f64, S: &mut [Complex64]) {
        let (n, n_z) = (self.n, self.n_z);
        S.fill(ZERO);
        // The lower triangle of -Mᴴ (D_L M) - j G M + j Mᴴ G, block by block of rows of M.
        for b in &self.blocks {
            for j in 0..n {
                let column = &self.M[j * n_z..(j + 1) * n_z];
                for r in 0..b.cols {
                    let (mut d_m, mut g_m) = (ZERO, ZERO);
                    if b.k == 1 && !b.is_real {
                        d_m = column[b.col + r] * D[b.offset].re;
                    } else {
                        for q in 0..b.k {
                            d_m += D[b.offset + q * b.k + r] * column[b.col + q];
                            if b.is_real {
                                g_m += G[b.offset + q * b.k + r] * column[b.col + q];
                            }
                        }
                    }
                    for i in 0..n {
                        S[j * n + i] -= self.M[i * n_z + b.col + r].conj() * d_m;
                    }
                    if b.is_real {
                        // F = -j G M fills rows of this block; F + Fᴴ enters S.
                        let f = Complex64::new(g_m.im, -g_m.re);
                        S[j * n + b.row + r] += f;
                        S[(b.row + r) * n + j] += f.conj();
                    }
                }
            }
            self.add_right_scales(b, D, lambda, S);
        }
    }

    fn add_right_scales(&self, b: &ScaleBlock, D: &[Complex64], factor: f64, S: &mut [Complex64]) {
        let n = self.n;
        if b.k == 1 {
            for r in 0..b.rows {
                S[(b.row + r) * n + b.row + r] += D[b.offset] * factor;
            }
            return;
        }
        for q in 0..b.k {
            for p in 0..b.k {
                S[(b.row + q) * n + b.row + p] += D[b.offset + q * b.k + p] * factor;
            }
        }
    }

    fn direction(&self, state: &State, work: &mut Work, mu: f64, affine: Option<&Direction>) -> Direction {
        let (n, n_x) = (self.n, self.variables.len());
        if let Some(affine) = affine {
            // The second-order term sym(W dS dZ) of the predictor.
            multiply(&affine.S, &affine.Z, n, n, n, &mut work.scratch);
            multiply(&work.W, &work.scratch, n, n, n, &mut work.correction);
            hermitize(&mut work.correction, n);
            work.correction_y.fill(ZERO);
            for b in &self.blocks {
                let (at, k) = (b.offset..b.offset + b.k * b.k, b.k);
                let mut inner = vec![ZERO; k * k];
                multiply(&affine.D[at.clone()], &affine.Y[at.clone()], k, k, k, &mut inner);
                multiply(&work.D_inverse[at.clone()], &inner, k, k, k, &mut work.correction_y[at.clone()]);
                hermitize(&mut work.correction_y[at], k);
            }
        } else {
            work.correction.fill(ZERO);
            work.correction_y.fill(ZERO);
        }
        // C = mu W - correction is what Z + dZ would be without dS.
        let C: Vec<Complex64> = work.W.iter().zip(&work.correction).map(|(w, c)| w * mu - c).collect();
        let C_y: Vec<Complex64> =
            work.D_inverse.iter().zip(&work.correction_y).map(|(w, c)| w * mu - c).collect();
        work.project(self, &C);
        let mut rhs = vec![0.0; n_x + 1];
        for (i, v) in self.variables.iter().enumerate() {
            rhs[i] = v.trace_in_s(&work.projected, self.n + self.n_z, state.lambda);
            if !v.is_g {
                rhs[i] += v.trace_in_block(&C_y[self.blocks[v.block].offset..], self.blocks[v.block].k);
            }
        }
        let right: f64 = self.right_inner(&state.D, &C);
        rhs[n_x] = right - 1.0;
        // Bordered system: normalᵀ dx = 0 keeps tr D.
        real_cholesky_solve(&work.K, n_x + 1, &mut rhs);
        let numerator: f64 = work.normal.iter().zip(&rhs).map(|(a, b)| a * b).sum();
        let nu = numerator / work.normal_curvature;
        let x: Vec<f64> = rhs.iter().zip(&work.K_normal).map(|(r, k)| r - nu * k).collect();

        let mut d = Direction {
            lambda: x[n_x],
            D: vec![ZERO; self.len],
            G: vec![ZERO; self.len],
            S: vec![ZERO; n * n],
            Z: C,
            Y: C_y,
        };
        for (v, &value) in self.variables.iter().zip(&x) {
            let (b, target) = (&self.blocks[v.block], if v.is_g { &mut d.G } else { &mut d.D });
            for &(p, q, c) in &v.entries {
                target[b.offset + q * b.k + p] += c * value;
            }
        }
        self.assemble(&d.D, &d.G, state.lambda, &mut d.S);
        for b in &self.blocks {
            self.add_right_scales(b, &state.D, d.lambda, &mut d.S);
        }
        // dZ = mu W - correction - Z - sym(W dS Z).
        multiply(&d.S, &state.Z, n, n, n, &mut work.scratch);
        multiply(&work.W, &work.scratch, n, n, n, &mut work.scratch2);
        hermitize(&mut work.scratch2, n);
        for ((z, old), s) in d.Z.iter_mut().zip(&state.Z).zip(&work.scratch2) {
            *z -= old + s;
        }
        for b in &self.blocks {
            let (at, k) = (b.offset..b.offset + b.k * b.k, b.k);
            let mut inner = vec![ZERO; k * k];
            let mut outer = vec![ZERO; k * k];
            multiply(&d.D[at.clone()], &state.Y[at.clone()], k, k, k, &mut inner);
            multiply(&work.D_inverse[at.clone()], &inner, k, k, k, &mut outer);
            hermitize(&mut outer, k);
            for ((y, old), s) in d.Y[at.clone()].iter_mut().zip(&state.Y[at]).zip(&outer) {
                *y -= old + s;
            }
        }
        d
    }

    /// `tr(C D_R)`.
    fn right_inner(&self, D: &[Complex64], C: &[Complex64]) -> f64 {
        let n = self.n;
        let mut sum = 0.0;
        for b in &self.blocks {
            if b.k == 1 {
                for r in 0..b.rows {
                    sum += D[b.offset].re * C[(b.row + r) * n + b.row + r].re;
                }
            } else {
                for q in 0..b.k {
                    for p in 0..b.k {
                        sum += (D[b.offset + q * b.k + p].conj() * C[(b.row + q) * n + b.row + p]).re;
                    }
                }
            }
        }
        sum
    }

    /// Steps, up to one, that keep `S`, `D` and `Z`, `Y` positive definite.
    fn step_lengths(&self, state: &State, d: &Direction, work: &mut Work, back: f64) -> (f64, f64) {
        let n = self.n;
        let primal = longest(|alpha| {
            for b in &self.blocks {
                if !block_is_positive(&state.D, &d.D, alpha, b, &mut work.small) {
                    return false;
                }
            }
            // S is bilinear in lambda and D: S + alpha dS + alpha² dlambda dD_R.
            for ((t, s), ds) in work.scratch.iter_mut().zip(&work.S).zip(&d.S) {
                *t = s + ds * alpha;
            }
            for b in &self.blocks {
                self.add_right_scales(b, &d.D, alpha * alpha * d.lambda, &mut work.scratch);
            }
            cholesky(&mut work.scratch, n)
        });
        let dual = longest(|alpha| {
            for b in &self.blocks {
                if !block_is_positive(&state.Y, &d.Y, alpha, b, &mut work.small) {
                    return false;
                }
            }
            for ((t, z), dz) in work.scratch.iter_mut().zip(&state.Z).zip(&d.Z) {
                *t = z + dz * alpha;
            }
            cholesky(&mut work.scratch, n)
        });
        let shorten = |alpha: f64| if alpha < 1.0 { alpha * back } else { alpha };
        (shorten(primal), shorten(dual))
    }
}

/// Matrices that are reused from step to step.
struct Work {
    S: Vec<Complex64>,
    /// `S^-1`.
    W: Vec<Complex64>,
    D_inverse: Vec<Complex64>,
    /// Cholesky factor of the Newton matrix over the unknowns and `t`.
    K: Vec<f64>,
    normal: Vec<f64>,
    /// `K^-1 normal`.
    K_normal: Vec<f64>,
    normal_curvature: f64,
    /// `Uᴴ C U` of the matrix projected last, with `U = [I, Mᴴ]`.
    projected: Vec<Complex64>,
    projected_W: Vec<Complex64>,
    correction: Vec<Complex64>,
    correction_y: Vec<Complex64>,
    scratch: Vec<Complex64>,
    scratch2: Vec<Complex64>,
    wide: Vec<Complex64>,
    wide2: Vec<Complex64>,
    small: Vec<Complex64>,
}

impl Work {
    fn new(lmi: &Lmi) -> Self {
        let (n, n_z, n_x) = (lmi.n, lmi.n_z, lmi.variables.len());
        let (nn, n_u) = (n * n, n + n_z);
        let k_max = lmi.blocks.iter().map(|b| b.k).max().unwrap_or(1);
        let mut normal = vec![0.0; n_x + 1];
        for (slot, v) in normal.iter_mut().zip(&lmi.variables) {
            if !v.is_g && v.entries.len() == 1 {
                *slot = 1.0;
            }
        }
        Self {
            S: vec![ZERO; nn],
            W: vec![ZERO; nn],
            D_inverse: vec![ZERO; lmi.len],
            K: vec![0.0; (n_x + 1) * (n_x + 1)],
            normal,
            K_normal: vec![0.0; n_x + 1],
            normal_curvature: 1.0,
            projected: vec![ZERO; n_u * n_u],
            projected_W: vec![ZERO; n_u * n_u],
            correction: vec![ZERO; nn],
            correction_y: vec![ZERO; lmi.len],
            scratch: vec![ZERO; nn],
            scratch2: vec![ZERO; nn],
            wide: vec![ZERO; n * n_z],
            wide2: vec![ZERO; n_z * n_z],
            small: vec![ZERO; k_max * k_max],
        }
    }

    /// Inverts `S` and the blocks of `D`.
    fn factor(&mut self, lmi: &Lmi, state: &State) -> bool {
        let n = lmi.n;
        self.scratch.copy_from_slice(&self.S);
        if !cholesky(&mut self.scratch, n) {
            return false;
        }
        invert_lower(&self.scratch, n, &mut self.scratch2);
        gram_of_lower(&self.scratch2, n, &mut self.W);
        for b in &lmi.blocks {
            let (at, k) = (b.offset..b.offset + b.k * b.k, b.k);
            if k == 1 {
                if state.D[b.offset].re <= 0.0 {
                    return false;
                }
                self.D_inverse[b.offset] = Complex64::new(1.0 / state.D[b.offset].re, 0.0);
                continue;
            }
            let mut factor = state.D[at.clone()].to_vec();
            let mut inverse = vec![ZERO; k * k];
            if !cholesky(&mut factor, k) {
                return false;
            }
            invert_lower(&factor, k, &mut inverse);
            gram_of_lower(&inverse, k, &mut self.D_inverse[at]);
        }
        true
    }

    /// `projected = Uᴴ C U`.
    fn project(&mut self, lmi: &Lmi, C: &[Complex64]) {
        let (n, n_z) = (lmi.n, lmi.n_z);
        let n_u = n + n_z;
        multiply(&lmi.M, C, n_z, n, n, &mut self.wide);
        multiply_adjoint(&self.wide, &lmi.M, n_z, n, n_z, &mut self.wide2);
        for j in 0..n {
            self.projected[j * n_u..j * n_u + n].copy_from_slice(&C[j * n..(j + 1) * n]);
            self.projected[j * n_u + n..(j + 1) * n_u].copy_from_slice(&self.wide[j * n_z..(j + 1) * n_z]);
        }
        for j in 0..n_z {
            for i in 0..n {
                self.projected[(n + j) * n_u + i] = self.wide[i * n_z + j].conj();
            }
            let at = (n + j) * n_u + n;
            self.projected[at..at + n_z].copy_from_slice(&self.wide2[j * n_z..(j + 1) * n_z]);
        }
    }

    /// Largest violation of the dual constraints of `G` and of `tr(Z D_R) = 1`.
    fn dual_infeasibility(&mut self, lmi: &Lmi, state: &State) -> f64 {
        self.project(lmi, &state.Z);
        let n_u = lmi.n + lmi.n_z;
        // For D the constraint is [M Z Mᴴ - lambda Z] + nu I = Y with the nu that fits best.
        let residuals: Vec<f64> = lmi
            .variables
            .iter()
            .map(|v| {
                let in_s = v.trace_in_s(&self.projected, n_u, state.lambda);
                let b = &lmi.blocks[v.block];
                if v.is_g { in_s } else { in_s + v.trace_in_block(&state.Y[b.offset..], b.k) }
            })
            .collect();
        let count = self.normal.iter().sum::<f64>();
        let nu = self.normal.iter().zip(&residuals).map(|(a, r)| a * r).sum::<f64>() / count;
        let worst = self.normal.iter().zip(&residuals).map(|(a, r)| (r - nu * a).abs()).fold(0.0, f64::max);
        worst.max((lmi.right_inner(&state.D, &state.Z) - 1.0).abs())
    }

    /// The Newton matrix `K_ij = Re tr(B_i W B_j Z) + Re tr(E_i D^-1 E_j Y)` over the unknowns and `t`, factored.
    fn form_system(&mut self, lmi: &Lmi, state: &State) {
        let (n, n_x) = (lmi.n, lmi.variables.len());
        let (n_u, size) = (n + lmi.n_z, n_x + 1);
        let W = std::mem::take(&mut self.W);
        self.project(lmi, &W);
        self.W = W;
        std::mem::swap(&mut self.projected, &mut self.projected_W);
        self.project(lmi, &state.Z);
        let t_dyads: Vec<Dyad> = lmi.right_dyads(&state.D);
        let dyads_of = |i: usize| if i < n_x { &lmi.variables[i].dyads[..] } else { &t_dyads[..] };
        let weight = |d: &Dyad| if d.with_lambda { d.value * state.lambda } else { d.value };
        let (P_w, P_z) = (&self.projected_W, &self.projected);
        for i in 0..size {
            for j in 0..=i {
                let mut sum = 0.0;
                for s in dyads_of(i) {
                    let mut inner = ZERO;
                    for t in dyads_of(j) {
                        inner += weight(t) * P_w[t.a * n_u + s.b] * P_z[s.a * n_u + t.b];
                    }
                    sum += (weight(s) * inner).re;
                }
                self.K[j * size + i] = sum;
            }
        }
        for i in 0..n_x {
            for j in 0..=i {
                let (v, w) = (&lmi.variables[i], &lmi.variables[j]);
                if v.is_g || w.is_g || v.block != w.block {
                    continue;
                }
                let (at, k) = (lmi.blocks[v.block].offset, lmi.blocks[v.block].k);
                let mut sum = 0.0;
                for &(p, q, c) in &v.entries {
                    for &(r, s, e) in &w.entries {
                        let product = self.D_inverse[at + r * k + q] * state.Y[at + p * k + s];
                        sum += (c * e * product).re;
                    }
                }
                self.K[j * size + i] += sum;
            }
        }
        // Where G has more freedom than S has entries, some direction costs nothing: a proximal term keeps the step finite.
        (0..n_x).for_each(|i| self.K[i * size + i] *= 1.0 + PROXIMAL);
        real_cholesky_frozen(&mut self.K, size);
        self.K_normal.copy_from_slice(&self.normal);
        real_cholesky_solve(&self.K, size, &mut self.K_normal);
        self.normal_curvature = self.normal.iter().zip(&self.K_normal).map(|(a, b)| a * b).sum();
    }
}

impl Lmi {
    /// `D_R` as dyads of unit vectors.
    fn right_dyads(&self, D: &[Complex64]) -> Vec<Dyad> {
        let mut dyads = Vec::new();
        for b in &self.blocks {
            if b.k == 1 {
                let value = D[b.offset];
                dyads.extend((b.row..b.row + b.rows).map(|a| Dyad { a, b: a, value, with_lambda: false }));
                continue;
            }
            for q in 0..b.k {
                for p in 0..b.k {
                    let value = D[b.offset + q * b.k + p];
                    dyads.push(Dyad { a: b.row + p, b: b.row + q, value, with_lambda: false });
                }
            }
        }
        dyads
    }
}

impl Variable {
    /// `Re tr(B_i C)` from `Uᴴ C U`.
    fn trace_in_s(&self, projected: &[Complex64], n_u: usize, lambda: f64) -> f64 {
        let mut sum = 0.0;
        for d in &self.dyads {
            let factor = if d.with_lambda { lambda } else { 1.0 };
            sum += factor * (d.value * projected[d.a * n_u + d.b]).re;
        }
        sum
    }

    /// `Re tr(E_i Y)` for the block `Y`.
    fn trace_in_block(&self, Y: &[Complex64], k: usize) -> f64 {
        self.entries.iter().map(|&(p, q, c)| (c * Y[p * k + q]).re).sum()
    }
}

fn full_variable(index: usize, b: &ScaleBlock, n: usize) -> Variable {
    let one = Complex64::new(1.0, 0.0);
    let right = (b.row..b.row + b.rows).map(|a| Dyad { a, b: a, value: one, with_lambda: true });
    let left = (n + b.col..n + b.col + b.cols).map(|a| Dyad { a, b: a, value: -one, with_lambda: false });
    Variable { is_g: false, block: index, entries: vec![(0, 0, one)], dyads: right.chain(left).collect() }
}

/// The unknowns of entry `(p, q)` and its mirror image: real part, and imaginary part off the diagonal.
fn push_hermitian_variables(
    index: usize,
    b: &ScaleBlock,
    n: usize,
    is_g: bool,
    p: usize,
    q: usize,
    variables: &mut Vec<Variable>,
) {
    let mut push = |entries: Vec<(usize, usize, Complex64)>| {
        let mut dyads = Vec::new();
        for &(r, s, c) in &entries {
            let (e, m) = ((b.row + r, b.row + s), (n + b.col + r, n + b.col + s));
            if is_g {
                // -j G M + j Mᴴ G
                let j = Complex64::new(0.0, 1.0);
                dyads.push(Dyad { a: e.0, b: m.1, value: -j * c, with_lambda: false });
                dyads.push(Dyad { a: m.0, b: e.1, value: j * c, with_lambda: false });
            } else {
                dyads.push(Dyad { a: e.0, b: e.1, value: c, with_lambda: true });
                dyads.push(Dyad { a: m.0, b: m.1, value: -c, with_lambda: false });
            }
        }
        variables.push(Variable { is_g, block: index, entries, dyads });
    };
    let (one, j) = (Complex64::new(1.0, 0.0), Complex64::new(0.0, 1.0));
    if p == q {
        push(vec![(p, p, one)]);
    } else {
        push(vec![(p, q, one), (q, p, one)]);
        push(vec![(p, q, j), (q, p, -j)]);
    }
}

fn block_is_positive(
    base: &[Complex64],
    step: &[Complex64],
    alpha: f64,
    b: &ScaleBlock,
    small: &mut [Complex64],
) -> bool {
    if b.k == 1 {
        return base[b.offset].re + alpha * step[b.offset].re > 0.0;
    }
    let kk = b.k * b.k;
    for i in 0..kk {
        small[i] = base[b.offset + i] + step[b.offset + i] * alpha;
    }
    cholesky(&mut small[..kk], b.k)
}

/// The longest admissible step in `(0, 1]` up to a tenth of itself, by bisection.
fn longest(mut admissible: impl FnMut(f64) -> bool) -> f64 {
    if admissible(1.0) {
        return 1.0;
    }
    let (mut inside, mut outside) = (0.0, 1.0);
    for _ in 0..BISECTIONS_MAX {
        let middle = 0.5 * (inside + outside);
        if admissible(middle) {
            inside = middle;
            if outside - inside < 0.05 * inside {
                break;
            }
        } else {
            outside = middle;
        }
    }
    inside
}

fn gap_after(state: &State, S: &[Complex64], d: &Direction, primal: f64, dual: f64) -> f64 {
    let pair = |x: &[Complex64], dx: &[Complex64], z: &[Complex64], dz: &[Complex64]| -> f64 {
        (x.iter().zip(dx))
            .zip(z.iter().zip(dz))
            .map(|((x, dx), (z, dz))| ((x + dx * primal).conj() * (z + dz * dual)).re)
            .sum()
    };
    pair(S, &d.S, &state.Z, &d.Z) + pair(&state.D, &d.D, &state.Y, &d.Y)
}

fn real_inner(a: &[Complex64], b: &[Complex64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x.re * y.re + x.im * y.im).sum()
}

fn add_scaled(a: &mut [Complex64], b: &[Complex64], factor: f64) {
    for (x, y) in a.iter_mut().zip(b) {
        *x += y * factor;
    }
}

fn hermitize(a: &mut [Complex64], n: usize) {
    for j in 0..n {
        for i in 0..j {
            let mean = 0.5 * (a[j * n + i] + a[i * n + j].conj());
            a[j * n + i] = mean;
            a[i * n + j] = mean.conj();
        }
        a[j * n + j].im = 0.0;
    }
}

/// Four times what hard cases need.
const STEPS_MAX: usize = 100;
/// Share of the step to the boundary that is taken.
const STEP_BACK: f64 = 0.95;
/// Relative to the diagonal of the Newton matrix; ten times the pivot that counts as zero.
const PROXIMAL: f64 = 1e-12;
const STALLED_BELOW: f64 = 1e-4;
const BISECTIONS_MAX: usize = 24;
/// Dual constraints count as met below this; their scale is one.
const INFEASIBILITY_MAX: f64 = 1e-6;
/// Below this share of the starting level, `mu` is zero for every purpose.
const LAMBDA_TINY: f64 = 1e-16;
