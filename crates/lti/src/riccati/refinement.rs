//! A Riccati equation in balanced coordinates: elimination of inputs, residual, gain, and guarded Newton steps.

use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;

use super::Terms;
use super::balancing::Balanced;
use crate::Error;
use crate::doubled_matrix::DoubledMatrix;
use crate::lyapunov::{solve_adjoint_with, symmetric};
use crate::schur::RealSchur;
use crate::triangular_equation::{Kind, Symmetry, inverse_norm};

/// The equation with `x = D x'` and `u = V u'`, both diagonal and powers of two.
pub(super) struct Scaled {
    pub(super) a: DMatrix<f64>,
    pub(super) b: DMatrix<f64>,
    pub(super) q: DMatrix<f64>,
    pub(super) r: DMatrix<f64>,
    pub(super) s: DMatrix<f64>,
    pub(super) kind: Kind,
    pub(super) reciprocal_condition_r: f64,
    d: DVector<f64>,
    v: DVector<f64>,
}

/// `A - B R⁻¹ Sᵀ`, `B R⁻¹ Bᵀ` and `Q - S R⁻¹ Sᵀ`: the equation without its inputs.
pub(super) struct Reduced {
    pub(super) a: DMatrix<f64>,
    pub(super) g: DMatrix<f64>,
    pub(super) q: DMatrix<f64>,
}

/// A stabilizing solution in balanced coordinates.
pub(super) struct Candidate {
    pub(super) x: DMatrix<f64>,
    pub(super) gain: DMatrix<f64>,
    pub(super) poles: Vec<Complex64>,
    pub(super) residual_relative: f64,
    pub(super) separation: f64,
    pub(super) condition: f64,
    pub(super) n_newton_steps: usize,
}

/// What is known of an approximate solution.
struct Evaluation {
    x: DMatrix<f64>,
    gain: DMatrix<f64>,
    closed_loop: RealSchur,
    poles: Vec<Complex64>,
    residual: DMatrix<f64>,
    scale: f64,
}

impl Evaluation {
    fn relative(&self) -> f64 {
        if self.scale > 0.0 { self.residual.norm() / self.scale } else { 0.0 }
    }
}

impl Scaled {
    pub(super) fn new(terms: &Terms<'_>, kind: Kind) -> Self {
        let (n, m) = terms.b.shape();
        let (q, r) = (symmetric(terms.q), symmetric(terms.r));
        let s = terms.s.cloned().unwrap_or_else(|| DMatrix::zeros(n, m));
        // Inputs of like weight: r_ii is brought between 1/2 and 2.
        let v = DVector::from_fn(m, |i, _| {
            let weight = r[(i, i)].abs();
            if weight > 0.0 {
                (-0.5 * weight.log2()).round().clamp(-EXPONENT_MAX, EXPONENT_MAX).exp2()
            } else {
                1.0
            }
        });
        let (mut b, mut s, mut r) = (terms.b.clone(), s, r);
        for j in 0..m {
            b.column_mut(j).scale_mut(v[j]);
            s.column_mut(j).scale_mut(v[j]);
            r.column_mut(j).scale_mut(v[j]);
            r.row_mut(j).scale_mut(v[j]);
        }
        let singular_values = if m == 0 { DVector::zeros(0) } else { r.singular_values() };
        let reciprocal_condition_r = match m {
            0 => 1.0,
            _ if singular_values.max() == 0.0 => 0.0,
            _ => singular_values.min() / singular_values.max(),
        };
        let mut equation =
            Self { a: terms.a.clone(), b, q, r, s, kind, reciprocal_condition_r, d: DVector::zeros(n), v };
        let balanced = match equation.without_inputs(BALANCING_INPUTS) {
            Some(reduced) => Balanced::new(&reduced.a, &reduced.g, &reduced.q),
            None => Balanced::new(&equation.a, &(&equation.b * equation.b.transpose()), &equation.q),
        };
        let d = balanced.scaling;
        for i in 0..n {
            equation.a.column_mut(i).scale_mut(d[i]);
            equation.a.row_mut(i).unscale_mut(d[i]);
            equation.b.row_mut(i).unscale_mut(d[i]);
            equation.s.row_mut(i).scale_mut(d[i]);
            equation.q.column_mut(i).scale_mut(d[i]);
            equation.q.row_mut(i).scale_mut(d[i]);
        }
        equation.d = d;
        equation
    }

    /// Eliminates the inputs where `R` has at least this reciprocal condition.
    pub(super) fn without_inputs(&self, reciprocal_condition_min: f64) -> Option<Reduced> {
        if self.b.ncols() == 0 {
            let n = self.a.nrows();
            return Some(Reduced { a: self.a.clone(), g: DMatrix::zeros(n, n), q: self.q.clone() });
        }
        if self.reciprocal_condition_r.is_nan() || self.reciprocal_condition_r < reciprocal_condition_min {
            return None;
        }
        let lu = self.r.clone().lu();
        let (rs, rb) = (lu.solve(&self.s.transpose())?, lu.solve(&self.b.transpose())?);
        let (g, q) = (symmetric(&(&self.b * rb)), symmetric(&(&self.q - &self.s * &rs)));
        Some(Reduced { a: &self.a - &self.b * rs, g, q })
    }

    /// Solution and gain in the caller's coordinates.
    pub(super) fn unscale(&self, candidate: &Candidate) -> (DMatrix<f64>, DMatrix<f64>) {
        let (d, v) = (&self.d, &self.v);
        let (x, k) = (&candidate.x, &candidate.gain);
        (
            DMatrix::from_fn(x.nrows(), x.ncols(), |i, j| x[(i, j)] / d[i] / d[j]),
            DMatrix::from_fn(k.nrows(), k.ncols(), |i, j| k[(i, j)] * v[i] / d[j]),
        )
    }

    /// Newton steps from an approximate solution, kept only where they lower the residual and leave the loop stable.
    ///
    /// **Source**: Kleinman 1968 and Hewer 1971 for the step; halved steps as in Benner and Byers 1998.
    ///
    /// **Errors**: [`Error::RiccatiIllConditioned`] where the closed loop is not stable.
    pub(super) fn refine(&self, x: DMatrix<f64>) -> Result<Candidate, Error> {
        let mut best = self.evaluate(x)?;
        let mut n_newton_steps = 0;
        'newton: while n_newton_steps < NEWTON_STEPS_MAX && best.relative() > 0.5 * f64::EPSILON {
            // Cᵀ N + N C + M = 0, or Cᵀ N C - N + M = 0.
            let Ok(step) = solve_adjoint_with(&best.closed_loop, &best.residual, self.kind) else { break };
            let mut fraction = 1.0;
            while fraction >= FRACTION_MIN {
                let next = self.evaluate(&best.x + &step * fraction)?;
                let stable = self.is_stable(&next) || !self.is_stable(&best);
                if stable && next.relative() < best.relative() {
                    let negligible = next.relative() > 0.5 * best.relative();
                    best = next;
                    n_newton_steps += 1;
                    if negligible {
                        break 'newton;
                    }
                    continue 'newton;
                }
                // A residual of rounding size does not improve by smaller steps.
                if best.relative() < HALVING_ABOVE {
                    break 'newton;
                }
                fraction *= 0.5;
            }
            break;
        }
        let residual_relative = best.relative();
        if !self.is_stable(&best) {
            return Err(Error::RiccatiIllConditioned { residual_relative, condition: f64::INFINITY });
        }
        let t = &best.closed_loop.t;
        let inverse = inverse_norm(t, t, self.kind, Symmetry::Symmetric);
        let condition = if best.scale > 0.0 { inverse * best.scale / best.x.norm() } else { inverse };
        let Evaluation { x, gain, poles, .. } = best;
        Ok(Candidate {
            x,
            gain,
            poles,
            residual_relative,
            separation: 1.0 / inverse,
            condition,
            n_newton_steps,
        })
    }

    fn is_stable(&self, evaluation: &Evaluation) -> bool {
        evaluation.poles.iter().all(|pole| match self.kind {
            Kind::Continuous => pole.re < 0.0,
            Kind::Discrete => pole.norm() < 1.0,
        })
    }

    fn evaluate(&self, x: DMatrix<f64>) -> Result<Evaluation, Error> {
        if let Some((index, &value)) = x.iter().enumerate().find(|(_, v)| !v.is_finite()) {
            return Err(Error::NotFinite { quantity: "an approximate riccati solution", index, value });
        }
        let x = symmetric(&x);
        let xb = &x * &self.b;
        let (cross, weight) = match self.kind {
            Kind::Continuous => (xb + &self.s, self.r.clone()),
            Kind::Discrete => (self.a.tr_mul(&xb) + &self.s, symmetric(&(&self.r + self.b.tr_mul(&xb)))),
        };
        let gain = divide(weight, &cross.transpose())?;
        let closed_loop = RealSchur::new(&(&self.a - &self.b * &gain))?;
        let poles = closed_loop.eigenvalues();
        let xa = &x * &self.a;
        let scale = (&cross * &gain).norm()
            + self.q.norm()
            + match self.kind {
                Kind::Continuous => 2.0 * xa.norm(),
                Kind::Discrete => self.a.tr_mul(&xa).norm() + x.norm(),
            };
        let residual = self.residual(&x, &gain);
        Ok(Evaluation { x, gain, closed_loop, poles, residual, scale })
    }

    /// The left-hand side in the form of Joseph, `Cᵀ X + X C + Q - S K - Kᵀ Sᵀ + Kᵀ R K` with `C = A - B K` (discrete:
    /// `Cᵀ X C - X + ...`), in doubled precision. An error of `K` enters it squared, so that no inverse has to be known to
    /// more than working precision.
    fn residual(&self, x: &DMatrix<f64>, gain: &DMatrix<f64>) -> DMatrix<f64> {
        let doubled = DoubledMatrix::from;
        let (x, k, s) = (doubled(x), doubled(gain), doubled(&self.s));
        let closed_loop = doubled(&self.a).minus(&doubled(&self.b).times(&k));
        let inputs = doubled(&self.r).times(&k).minus(&s.transpose());
        let weights = doubled(&self.q).minus(&s.times(&k)).plus(&k.transpose().times(&inputs));
        let product = x.times(&closed_loop);
        let sum = match self.kind {
            Kind::Continuous => product.plus_transpose().plus(&weights),
            Kind::Discrete => closed_loop.transpose().times(&product).minus(&x).plus(&weights),
        };
        symmetric(&sum.rounded())
    }
}

/// `W⁻¹ rhs` with one step of refinement.
fn divide(weight: DMatrix<f64>, rhs: &DMatrix<f64>) -> Result<DMatrix<f64>, Error> {
    if weight.is_empty() {
        return Ok(rhs.clone());
    }
    let singular = Error::Singular { matrix: "r", reciprocal_condition: 0.0 };
    let lu = weight.clone().lu();
    let k = lu.solve(rhs).ok_or_else(|| singular.clone())?;
    let correction = lu.solve(&(rhs - weight * &k)).ok_or(singular)?;
    Ok(k + correction)
}

/// Newton converges quadratically from a subspace solution; a poor start of an ill-conditioned equation needs more.
const NEWTON_STEPS_MAX: usize = 12;
/// Smallest fraction of a Newton step.
const FRACTION_MIN: f64 = 0.1;
/// Below this relative residual a step that fails is rounding.
const HALVING_ABOVE: f64 = 1e-13;
/// Largest exponent of the scaling of an input.
const EXPONENT_MAX: f64 = 100.0;
/// The inverse of `R` is good enough for balancing above this reciprocal condition.
const BALANCING_INPUTS: f64 = 1e-12;
