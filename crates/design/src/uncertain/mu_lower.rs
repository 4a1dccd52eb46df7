//! Lower bound of the structured singular value: a perturbation that makes the loop singular.
#![allow(non_snake_case)]

use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use rand::{RngExt, SeedableRng};

use super::eigen::{EigenTriple, complex_eigenvalues, eigen_triple};
use super::structure::{Block, BlockStructure, BlockValue, Perturbation, PlacedBlock};
use crate::Error;

/// A lower bound of the structured singular value, with the perturbation that shows it.
#[derive(Clone, Debug, PartialEq)]
pub struct MuLower {
    /// `1 / perturbation.norm()`, or zero where no perturbation was found.
    pub value: f64,
    /// An admissible perturbation for which `I - M Delta` is singular; `None` where none was found, which for real
    /// parameters alone is the rule rather than the exception.
    pub perturbation: Option<Perturbation>,
    /// Smallest singular value of `I - M Delta`, recomputed: rounding only.
    pub residual: f64,
}

/// Where the search for a lower bound starts and how long it goes on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MuLowerOptions {
    /// Starts beyond the one that the upper bound suggests; 8.
    pub restarts: usize,
    /// Seed of the random starts; 1.
    pub seed: u64,
    /// The search ends when it comes this close to the upper bound, relative; `1e-7`.
    pub close_enough: f64,
}

impl Default for MuLowerOptions {
    fn default() -> Self {
        Self { restarts: 8, seed: 1, close_enough: 1e-7 }
    }
}

/// The iterates of the power method for one block structure.
struct Search<'a> {
    m: &'a DMatrix<Complex64>,
    structure: &'a BlockStructure,
    placed: Vec<PlacedBlock>,
    /// The best value found so far.
    at_least: f64,
}

/// `a = M b / |M b|`, `w = Mᴴ z / |Mᴴ z|`, and the real parameters `q`.
struct Iterate {
    a: DVector<Complex64>,
    b: DVector<Complex64>,
    w: DVector<Complex64>,
    q: Vec<f64>,
}

/// A point at which an eigenvalue of `M Delta` is real: parameters and phases, eigenvalue, and where it grows.
struct RealPoint {
    x: Vec<f64>,
    value: f64,
    ascent: Vec<f64>,
}

/// An eigenvalue of `M Delta` and its slopes.
struct Slopes {
    value: Complex64,
    slopes: Vec<Complex64>,
}

/// Finds a lower bound, starting from the directions of an upper bound where they are known.
pub(crate) fn search(
    m: &DMatrix<Complex64>,
    structure: &BlockStructure,
    directions: Option<&DMatrix<Complex64>>,
    upper: f64,
    options: &MuLowerOptions,
) -> Result<MuLower, Error> {
    let mut search = Search { m, structure, placed: structure.placed().collect(), at_least: 0.0 };
    let mut rng = rand_pcg::Pcg64::seed_from_u64(options.seed);
    let n_w = structure.n_w();
    let mut best = MuLower { value: 0.0, perturbation: None, residual: 0.0 };
    let root = directions.map(|z| {
        let eigen = ((z + z.adjoint()) * Complex64::new(0.5, 0.0)).symmetric_eigen();
        let top = eigen.eigenvalues.imax();
        let scales = eigen.eigenvalues.map(|v| Complex64::new(v.max(0.0).sqrt(), 0.0));
        let first = eigen.eigenvectors.column(top).into_owned();
        (first, &eigen.eigenvectors * DMatrix::from_diagonal(&scales))
    });
    for start in 0..=options.restarts {
        let mut random = || {
            DVector::from_fn(n_w, |_, _| {
                Complex64::new(rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0))
            })
        };
        let b = match (&root, start) {
            (Some((first, _)), 0) => first.clone(),
            // Every second start is drawn from the dual solution: its range holds the worst directions.
            (Some((_, factor)), k) if k % 2 == 1 => factor * random(),
            _ => random(),
        };
        let signs: Vec<f64> = search
            .placed
            .iter()
            .map(|_| if start == 0 || rng.random_range(0.0..1.0) < 0.5 { 1.0 } else { -1.0 })
            .collect();
        for candidate in search.candidates(b, signs, start) {
            if candidate.value > best.value {
                best = candidate;
            }
        }
        search.at_least = best.value;
        if best.value >= upper * (1.0 - options.close_enough) {
            break;
        }
    }
    Ok(best)
}

impl Search<'_> {
    /// What one start leads to.
    fn candidates(&self, b: DVector<Complex64>, signs: Vec<f64>, start: usize) -> Vec<MuLower> {
        let mut found = Vec::new();
        if b.norm() == 0.0 {
            return found;
        }
        let only_real = self.structure.blocks().iter().all(|b| b.is_real());
        if only_real && start % 2 == 1 {
            let values = signs.iter().map(|&s| BlockValue::Real(s)).collect();
            found.extend(self.finish(Perturbation { values }));
        }
        if start == 0 {
            found.extend(self.along_direction(&b));
        }
        if let Some(iterate) = self.power_iteration(b.normalize(), signs) {
            found.extend(self.finish(self.perturbation(&iterate)));
        }
        found
    }

    /// `Delta` that maps `M v` to `v` block by block: exact for a direction in which the upper bound is attained.
    fn along_direction(&self, v: &DVector<Complex64>) -> Option<MuLower> {
        let a = self.m * v;
        let w = v.clone();
        let q = self.placed.iter().map(|at| {
            let (a, w) = (part(&a, at.col, at.block.cols()), part(&w, at.row, at.block.rows()));
            if at.block.is_real() && a.norm() > 0.0 {
                (a.dotc(&w).re / a.norm_squared() * self.m.norm()).clamp(-1.0, 1.0)
            } else {
                1.0
            }
        });
        let q = q.collect();
        self.finish(self.perturbation(&Iterate { a, b: w.clone(), w, q }))
    }

    /// **Source**: Young and Doyle 1990, "Computation of mu with real and complex uncertainties", Proc. 29th CDC, eq. (14);
    /// Packard, Fan and Doyle 1988 for complex blocks.
    fn power_iteration(&self, b: DVector<Complex64>, q: Vec<f64>) -> Option<Iterate> {
        let mut it = Iterate { a: self.m * &b, w: b.clone(), b, q };
        let mut beta_before = 0.0;
        let mut z = DVector::zeros(self.structure.n_z());
        for step in 0..POWER_STEPS_MAX {
            it.a = self.m * &it.b;
            let beta = it.a.norm();
            if beta <= 0.0 || beta.is_nan() {
                return None;
            }
            it.a /= Complex64::new(beta, 0.0);
            self.update_q(&mut it);
            for (k, at) in self.placed.iter().enumerate() {
                let (a, w) = (part(&it.a, at.col, at.block.cols()), part(&it.w, at.row, at.block.rows()));
                let value = match at.block {
                    Block::RepeatedReal { .. } => w * Complex64::new(it.q[k], 0.0),
                    Block::RepeatedComplex { .. } => &w * phase(w.dotc(&a)),
                    Block::Full { .. } => &a * Complex64::new(ratio(w.norm(), a.norm()), 0.0),
                };
                z.rows_mut(at.col, at.block.cols()).copy_from(&value);
            }
            it.w = self.m.ad_mul(&z);
            let size = it.w.norm();
            if size <= 0.0 || size.is_nan() {
                return None;
            }
            it.w /= Complex64::new(size, 0.0);
            self.update_q(&mut it);
            for (k, at) in self.placed.iter().enumerate() {
                let (a, w) = (part(&it.a, at.col, at.block.cols()), part(&it.w, at.row, at.block.rows()));
                let value = match at.block {
                    Block::RepeatedReal { .. } => a * Complex64::new(it.q[k], 0.0),
                    Block::RepeatedComplex { .. } => &a * phase(a.dotc(&w)),
                    Block::Full { .. } => &w * Complex64::new(ratio(a.norm(), w.norm()), 0.0),
                };
                it.b.rows_mut(at.row, at.block.rows()).copy_from(&value);
            }
            if step > 3 && (beta - beta_before).abs() < 1e-9 * beta && (size - beta).abs() < 1e-8 * beta {
                break;
            }
            beta_before = beta;
        }
        Some(it)
    }

    fn update_q(&self, it: &mut Iterate) {
        for (k, at) in self.placed.iter().enumerate().filter(|(_, at)| at.block.is_real()) {
            let size = at.block.rows();
            let (a, w) = (part(&it.a, at.col, size), part(&it.w, at.row, size));
            let b = part(&it.b, at.row, size);
            let alpha = it.q[k].signum() * ratio(b.norm(), a.norm()) + a.dotc(&w).re;
            it.q[k] = alpha.clamp(-1.0, 1.0);
        }
    }

    /// The perturbation of size one that an iterate stands for.
    fn perturbation(&self, it: &Iterate) -> Perturbation {
        let values = self.placed.iter().enumerate().map(|(k, at)| {
            let (a, w) = (part(&it.a, at.col, at.block.cols()), part(&it.w, at.row, at.block.rows()));
            match at.block {
                Block::RepeatedReal { .. } => BlockValue::Real(it.q[k]),
                Block::RepeatedComplex { .. } => BlockValue::Complex(phase(a.dotc(&w))),
                Block::Full { rows, cols } => {
                    let size = w.norm() * a.norm();
                    BlockValue::Full(if size > 0.0 {
                        w * a.adjoint() / Complex64::new(size, 0.0)
                    } else {
                        DMatrix::from_fn(rows, cols, |i, j| {
                            Complex64::new(f64::from(u8::from(i + j == 0)), 0.0)
                        })
                    })
                }
            }
        });
        Perturbation { values: values.collect() }
    }

    /// Scales a perturbation of size one so that `I - M Delta` becomes singular.
    fn finish(&self, unit: Perturbation) -> Option<MuLower> {
        if self.structure.has_real() {
            return self.finish_real(unit);
        }
        let m_delta = self.m * unit.matrix(self.structure).ok()?;
        let values = complex_eigenvalues(&m_delta)?;
        let top = values.into_iter().max_by(|a, b| a.norm().total_cmp(&b.norm()))?;
        let turned = self.turned(&unit, 1.0 / top);
        self.confirm(turned)
    }

    /// The perturbation with its complex blocks multiplied by `factor`.
    fn turned(&self, p: &Perturbation, factor: Complex64) -> Perturbation {
        let values = p.values.iter().map(|v| match v {
            BlockValue::Real(v) => BlockValue::Real(*v),
            BlockValue::Complex(v) => BlockValue::Complex(v * factor),
            BlockValue::Full(m) => BlockValue::Full(m * factor),
        });
        Perturbation { values: values.collect() }
    }

    /// With real parameters an eigenvalue of `M Delta` must be real: climbs in its real part along the parameters and the
    /// phases of the complex blocks while its imaginary part is kept at zero.
    fn finish_real(&self, unit: Perturbation) -> Option<MuLower> {
        let m_delta = self.m * unit.matrix(self.structure).ok()?;
        let mut values = complex_eigenvalues(&m_delta)?;
        let promise = |v: &Complex64| v.re.abs() - 0.5 * v.im.abs();
        values.sort_by(|a, b| promise(b).total_cmp(&promise(a)));
        let climbs = values.iter().take(CLIMBS).filter_map(|&value| {
            let sign = if value.re < 0.0 { -1.0 } else { 1.0 };
            self.climb(unit.scaled(sign), value * sign)
        });
        climbs.max_by(|a, b| a.value.total_cmp(&b.value))
    }

    fn climb(&self, base: Perturbation, near: Complex64) -> Option<MuLower> {
        let start: Vec<f64> =
            base.values.iter().map(|v| if let BlockValue::Real(q) = v { *q } else { 0.0 }).collect();
        let mut at = self.restore(&base, start, near)?;
        if at.value < self.at_least * PROMISING {
            return None;
        }
        let mut length = FIRST_LENGTH;
        for _ in 0..CLIMB_STEPS {
            let size = at.ascent.iter().fold(0.0_f64, |m, s| m.max(s.abs()));
            if size <= 1e-9 * at.value {
                break;
            }
            let step = (length / at.value).min(0.5 / size);
            let x = at.x.iter().zip(&at.ascent).map(|(x, s)| x + step * s).collect();
            match self.restore(&base, x, Complex64::new(at.value, 0.0)) {
                Some(next) if next.value > at.value => {
                    // Barzilai and Borwein 1988: the curvature seen along the last step sets the length of the next.
                    let (mut moved, mut curved) = (0.0, 0.0);
                    for k in 0..at.x.len() {
                        let dx = next.x[k] - at.x[k];
                        moved += dx * dx;
                        curved += dx * (at.ascent[k] - next.ascent[k]);
                    }
                    let gain = next.value / at.value - 1.0;
                    length = if curved > 0.0 { moved / curved * next.value } else { 3.0 * length };
                    at = next;
                    if gain < GAIN_MIN {
                        break;
                    }
                }
                _ => length = 0.2 * (step * at.value),
            }
            if length < 1e-10 {
                break;
            }
        }
        self.confirm(self.moved(&base, &at.x).scaled(1.0 / at.value))
    }

    /// The point next to `x` at which the eigenvalue next to `near` is real, by Newton steps on its imaginary part.
    fn restore(&self, base: &Perturbation, mut x: Vec<f64>, mut near: Complex64) -> Option<RealPoint> {
        for _ in 0..RESTORE_STEPS {
            let p = self.moved(base, &x);
            let Slopes { value, slopes } = self.eigenvalue_at(&p, near)?;
            near = value;
            if near.re <= 0.0 {
                return None;
            }
            let is_real = near.im.abs() <= 1e-14 * near.re;
            let free = if is_real {
                self.free(&p, |k| slopes[k].re)
            } else {
                self.free(&p, |k| -near.im * slopes[k].im)
            };
            let sum = |f: &dyn Fn(usize) -> f64| (0..x.len()).filter(|&k| free[k]).map(f).sum::<f64>();
            let hh = sum(&|k| slopes[k].im.powi(2));
            if is_real {
                // Ascent of the real part, orthogonal to the imaginary part.
                let along = if hh > 0.0 { sum(&|k| slopes[k].re * slopes[k].im) / hh } else { 0.0 };
                let ascent = (0..x.len())
                    .map(|k| if free[k] { slopes[k].re - along * slopes[k].im } else { 0.0 })
                    .collect();
                return Some(RealPoint { x, value: near.re, ascent });
            }
            if hh.sqrt() < 1e-10 * near.re {
                return None;
            }
            for k in (0..x.len()).filter(|&k| free[k]) {
                let step = (-near.im * slopes[k].im / hh).clamp(-0.5, 0.5);
                let is_parameter = matches!(base.values[k], BlockValue::Real(_));
                x[k] = if is_parameter { (x[k] + step).clamp(-1.0, 1.0) } else { x[k] + step };
            }
        }
        None
    }

    /// The eigenvalue of `M Delta` next to `near`, and its change with each real parameter or phase of a complex block.
    fn eigenvalue_at(&self, p: &Perturbation, near: Complex64) -> Option<Slopes> {
        let m_delta = self.m * p.matrix(self.structure).ok()?;
        let EigenTriple { value, left, right } = eigen_triple(&m_delta, near)?;
        let product = left.dotc(&right);
        if product.norm() < 1e-12 {
            return None;
        }
        let left_m = self.m.ad_mul(&left);
        let j = Complex64::new(0.0, 1.0);
        let slopes = self.placed.iter().zip(&p.values).map(|(at, value)| {
            let (l, r) = (part(&left_m, at.row, at.block.rows()), part(&right, at.col, at.block.cols()));
            match value {
                BlockValue::Real(_) => l.dotc(&r) / product,
                BlockValue::Complex(v) => l.dotc(&r) * v * j / product,
                BlockValue::Full(m) => l.dotc(&(m * r)) * j / product,
            }
        });
        Some(Slopes { value, slopes: slopes.collect() })
    }

    /// Which parameters may move in the given direction: phases always, real ones unless they sit at that bound.
    fn free(&self, p: &Perturbation, direction: impl Fn(usize) -> f64) -> Vec<bool> {
        let free = p.values.iter().enumerate().map(|(k, v)| match v {
            BlockValue::Real(q) => q * direction(k).signum() < 1.0 - 1e-12,
            _ => true,
        });
        free.collect()
    }

    /// The base with its parameters set to `x`, and its complex blocks turned by the angle `x`.
    fn moved(&self, base: &Perturbation, x: &[f64]) -> Perturbation {
        let values = base.values.iter().zip(x).map(|(value, &x)| match value {
            BlockValue::Real(_) => BlockValue::Real(x.clamp(-1.0, 1.0)),
            BlockValue::Complex(v) => BlockValue::Complex(v * Complex64::from_polar(1.0, x)),
            BlockValue::Full(m) => BlockValue::Full(m * Complex64::from_polar(1.0, x)),
        });
        Perturbation { values: values.collect() }
    }

    /// Recomputes the residual and refuses a perturbation that does not make the loop singular.
    fn confirm(&self, perturbation: Perturbation) -> Option<MuLower> {
        let m_delta = self.m * perturbation.matrix(self.structure).ok()?;
        if m_delta.iter().any(|v| !v.re.is_finite() || !v.im.is_finite()) {
            return None;
        }
        let loop_ = DMatrix::identity(m_delta.nrows(), m_delta.nrows()) - &m_delta;
        let residual = loop_.singular_values().min();
        let value = 1.0 / perturbation.norm();
        let small = residual <= RESIDUAL_MAX * (1.0 + m_delta.norm());
        (small && value.is_finite()).then_some(MuLower { value, perturbation: Some(perturbation), residual })
    }
}

fn part(v: &DVector<Complex64>, start: usize, count: usize) -> DVector<Complex64> {
    v.rows(start, count).into_owned()
}

fn phase(v: Complex64) -> Complex64 {
    let size = v.norm();
    if size > 0.0 { v / size } else { Complex64::new(1.0, 0.0) }
}

fn ratio(a: f64, b: f64) -> f64 {
    if b > 0.0 { a / b } else { 0.0 }
}

const POWER_STEPS_MAX: usize = 60;
/// Eigenvalues from which a climb starts.
const CLIMBS: usize = 2;
const CLIMB_STEPS: usize = 40;
/// A climb ends when a step gains less than this, relative.
const GAIN_MIN: f64 = 1e-8;
/// A climb that starts below this share of the best value found so far is left out.
const PROMISING: f64 = 0.8;
const RESTORE_STEPS: usize = 12;
/// Length of the first step of a climb, for an eigenvalue of size one.
const FIRST_LENGTH: f64 = 0.5;
/// Smallest singular value of `I - M Delta` that counts as zero, over `1 + |M Delta|`.
const RESIDUAL_MAX: f64 = 1e-11;
