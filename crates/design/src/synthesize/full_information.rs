//! H-infinity control where the state is measured, or the state and the disturbance: static gains.

use nalgebra::DMatrix;
use num_complex::Complex64;
use telepulse_lti::eigenvalues::eigenvalues;
use telepulse_lti::riccati::{self, StableSubspace};
use telepulse_lti::{Continuous, PeakGain, StateSpace, hinf_norm};

use super::hinfsyn::HinfOptions;
use crate::Error;

/// A static gain and the evidence for it.
#[derive(Clone, Debug, PartialEq)]
pub struct StaticHinfDesign {
    /// `u = state_gain x (+ disturbance_gain w)`, `n_u × n_x`.
    pub state_gain: DMatrix<f64>,
    /// Gain from the disturbance, `n_u × n_w`; `None` for state feedback.
    pub disturbance_gain: Option<DMatrix<f64>>,
    /// No gain (and no dynamic controller) reaches this norm.
    pub gamma_lower: f64,
    /// Some gain reaches this norm.
    pub gamma_upper: f64,
    /// The norm that this gain was designed for.
    pub gamma_design: f64,
    /// The norm of the closed loop from `w` to `z`, recomputed.
    pub achieved: PeakGain,
    /// Poles of the closed loop in rad/s, all stable.
    pub closed_loop_poles: Vec<Complex64>,
    /// Relative residual of the Riccati equation at `gamma_design`.
    pub residual_relative: f64,
    /// Feasibility tests spent on the bracket.
    pub n_feasibility_tests: usize,
}

/// Returns a state feedback `u = F x` whose closed-loop norm is within the back-off of the smallest possible.
///
/// ```text
///    w ---->+---------+----> z        dx/dt = A x + B1 w + B2 u
///           |  plant  |                   z = C1 x + D11 w + D12 u
///    u +--->+---------+--+ x
///      +------- F <------+
/// ```
///
/// **Shapes and units**: `sys` has the inputs `(w, u)`, the last `n_u` of them `u`, and the outputs `z`.
///
/// **Method**: gamma is bracketed by bisection of its logarithm between `max sigma(D11)`, which no gain on the state can lower, and
/// a feasible value. A gamma is feasible where the stable subspace of the Hamiltonian matrix is that of a positive semidefinite
/// `X`, tested on the subspace's angles. The gain is the saddle point's: `F = -(D12ᵀ D12)⁻¹ (D12ᵀ (C1 + D11 F1) + B2ᵀ X)` with the worst
/// disturbance `w = F1 x`.
///
/// **Source**: Zhou, Doyle and Glover 1996, section 16.4; Green and Limebeer 1995, chapter 6.
///
/// **Accuracy**: `achieved.upper <= 1.0001 · gamma_design`, checked.
///
/// **Errors**: [`Error::SingularD12`], [`Error::NotStabilizable`], [`Error::AxisZero`], [`Error::Infeasible`],
/// [`Error::IllConditioned`], [`Error::NotConverged`], [`Error::OutOfRange`] for options;
/// [`telepulse_lti::Error::PortCount`] unless `n_u` leaves a disturbance.
///
/// **Example**: `dx/dt = -x + w + u`, `z = [x; u]`: the Riccati equation `-2 X - X² (1 - 1/gamma²) + 1 = 0` has a real solution
/// where `gamma² >= 1/2`.
/// ```
/// use nalgebra::dmatrix;
/// use telepulse_design::synthesize::{HinfOptions, hinf_state_feedback};
/// use telepulse_lti::{Continuous, StateSpace};
/// let sys = StateSpace::<Continuous>::new(
///     dmatrix![-1.0], dmatrix![1.0, 1.0], dmatrix![1.0; 0.0], dmatrix![0.0, 0.0; 0.0, 1.0])?;
/// let design = hinf_state_feedback(&sys, 1, &HinfOptions::default())?;
/// assert!((design.gamma_upper - 0.5f64.sqrt()).abs() < 1e-5);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn hinf_state_feedback(
    sys: &StateSpace<Continuous>,
    n_u: usize,
    options: &HinfOptions,
) -> Result<StaticHinfDesign, Error> {
    solve(sys, n_u, options, Information::State)
}

/// Returns a full-information feedback `u = F x + E w` whose closed-loop norm is within the back-off of the smallest possible.
///
/// **Shapes and units**, **Source**, **Accuracy** and **Errors**: as [`hinf_state_feedback`]. Knowing `w` helps where `D12` reaches what `D11`
/// does: only the part of `D11` outside of the range of `D12` bounds gamma from below.
///
/// **Method**: as [`hinf_state_feedback`], with `F = -R⁻¹ (D12ᵀ C1 + B2ᵀ X)` and `E = -R⁻¹ D12ᵀ D11`, `R = D12ᵀ D12`.
///
/// **Example**: `z = 3 w + u` is cancelled by `u = -3 w`, which a state feedback cannot do.
/// ```
/// use nalgebra::dmatrix;
/// use telepulse_design::synthesize::{HinfOptions, hinf_full_information, hinf_state_feedback};
/// use telepulse_lti::{Continuous, StateSpace};
/// let sys = StateSpace::<Continuous>::new(
///     dmatrix![-1.0], dmatrix![1.0, 0.0], dmatrix![1.0; 0.0], dmatrix![0.1, 0.0; 3.0, 1.0])?;
/// let informed = hinf_full_information(&sys, 1, &HinfOptions::default())?;
/// let blind = hinf_state_feedback(&sys, 1, &HinfOptions::default())?;
/// assert!((informed.gamma_upper - 1.1).abs() < 1e-5 && blind.gamma_upper > 3.0);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn hinf_full_information(
    sys: &StateSpace<Continuous>,
    n_u: usize,
    options: &HinfOptions,
) -> Result<StaticHinfDesign, Error> {
    solve(sys, n_u, options, Information::StateAndDisturbance)
}

#[derive(Clone, Copy, PartialEq)]
enum Information {
    State,
    StateAndDisturbance,
}

fn solve(
    sys: &StateSpace<Continuous>,
    n_u: usize,
    options: &HinfOptions,
    information: Information,
) -> Result<StaticHinfDesign, Error> {
    check_options(options)?;
    if n_u == 0 || n_u >= sys.n_inputs() {
        let (operation, port) = ("state feedback", "control inputs beside at least one disturbance");
        let expected = sys.n_inputs().saturating_sub(1).min(n_u.max(1));
        return Err(telepulse_lti::Error::PortCount { operation, port, expected, found: n_u }.into());
    }
    // Judged in balanced coordinates, designed in those of the caller (the Riccati equation balances by itself).
    let balanced = Problem::new(&sys.balanced(), n_u)?;
    balanced.check_assumptions()?;
    let problem = Problem::new(sys, n_u)?;
    let floor = match information {
        Information::State => largest_singular_value(&problem.d11),
        Information::StateAndDisturbance => largest_singular_value(&problem.du),
    };
    let mut bracket = Bracket { lower: floor, upper: f64::INFINITY, n_tests: 0 };
    bracket.find(&balanced, options)?;
    let mut factor = options.backoff;
    let mut last = Error::NotConverged { gamma_lower: bracket.lower, gamma_upper: bracket.upper };
    for _ in 0..DESIGNS_MAX {
        let gamma = factor * bracket.upper;
        match problem.design(sys, gamma, information) {
            Ok(design) => {
                return Ok(StaticHinfDesign {
                    gamma_lower: bracket.lower,
                    gamma_upper: bracket.upper,
                    n_feasibility_tests: bracket.n_tests,
                    ..design
                });
            }
            Err(error @ Error::IllConditioned { .. }) => last = error,
            Err(error) => return Err(error),
        }
        if factor >= options.relaxation_max {
            break;
        }
        factor = (1.0 + RELAXATION_GROWTH * (factor - 1.0)).min(options.relaxation_max);
    }
    Err(last)
}

fn check_options(options: &HinfOptions) -> Result<(), Error> {
    let range = |key, found: f64, valid: bool, allowed| {
        if valid { Ok(()) } else { Err(Error::OutOfRange { key, found, allowed }) }
    };
    let (backoff, tolerance, max) = (options.backoff, options.gamma_tolerance, options.gamma_max);
    range("backoff", backoff, backoff > 1.0 && backoff.is_finite(), "above 1")?;
    range("gamma_tolerance", tolerance, (1e-12..=0.1).contains(&tolerance), "from 1e-12 to 0.1")?;
    range("gamma_max", max, max > 0.0 && max.is_finite(), "positive and finite")?;
    let relaxation = options.relaxation_max;
    range("relaxation_max", relaxation, relaxation >= backoff && relaxation.is_finite(), "at least backoff")
}

/// The plant with `u` scaled so that the columns of `D12` are orthonormal, and `z` split into what they reach and the rest.
struct Problem {
    a: DMatrix<f64>,
    b1: DMatrix<f64>,
    b2: DMatrix<f64>,
    d11: DMatrix<f64>,
    /// What `u` does not reach of `C1` and `D11`.
    c11: DMatrix<f64>,
    du: DMatrix<f64>,
    /// What `u` reaches of `C1` and `D11`.
    c12: DMatrix<f64>,
    d112: DMatrix<f64>,
    /// `u = u_scale · u_normalized`.
    u_scale: DMatrix<f64>,
    n_w: usize,
}

impl Problem {
    fn new(sys: &StateSpace<Continuous>, n_u: usize) -> Result<Self, Error> {
        let (n_z, n_w) = (sys.n_outputs(), sys.n_inputs() - n_u);
        let (b1, b2) = (sys.b().columns(0, n_w).into_owned(), sys.b().columns(n_w, n_u).into_owned());
        let (d11, d12) = (sys.d().columns(0, n_w).into_owned(), sys.d().columns(n_w, n_u).into_owned());
        let svd = d12.svd(true, true);
        let (largest, smallest) = (svd.singular_values.max(), svd.singular_values.min());
        let singular = Error::SingularD12 { n_z, n_u, largest, smallest };
        let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return Err(singular) };
        if n_z < n_u || smallest <= RANK_TOLERANCE * largest {
            return Err(singular);
        }
        let mut u_scale = v_t.transpose();
        for (mut column, value) in u_scale.column_iter_mut().zip(svd.singular_values.iter()) {
            column.unscale_mut(*value);
        }
        let (c12, d112) = (u.tr_mul(sys.c()), u.tr_mul(&d11));
        // Where D12 is square nothing is out of reach, whatever rounding says.
        let out_of_reach = |m: &DMatrix<f64>, reached: &DMatrix<f64>| {
            if n_z == n_u { DMatrix::zeros(m.nrows(), m.ncols()) } else { m - &u * reached }
        };
        let (c11, du) = (out_of_reach(sys.c(), &c12), out_of_reach(&d11, &d112));
        let b2 = b2 * &u_scale;
        Ok(Self { a: sys.a().clone(), b1, b2, d11, c11, du, c12, d112, u_scale, n_w })
    }

    /// Popov-Belevitch-Hautus tests: unstable modes within reach of `u`, no zero of `u → z` on the imaginary axis.
    fn check_assumptions(&self) -> Result<(), Error> {
        let margin = |m: &DMatrix<f64>| 100.0 * m.nrows() as f64 * f64::EPSILON * m.norm();
        let near = -margin(&self.a);
        for mode in eigenvalues(&self.a)?.into_iter().filter(|m| m.im >= 0.0 && m.re >= near) {
            if loses_rank(&self.a.transpose(), &self.b2.transpose(), mode) {
                return Err(Error::NotStabilizable { mode });
            }
        }
        let dynamics = &self.a - &self.b2 * &self.c12;
        let near = margin(&dynamics);
        for zero in eigenvalues(&dynamics)?.into_iter().filter(|m| m.im >= 0.0 && m.re.abs() <= near) {
            if loses_rank(&dynamics, &self.c11, Complex64::new(0.0, zero.im)) {
                return Err(Error::AxisZero { path: "u to z (P12)", omega_rad_s: zero.im });
            }
        }
        Ok(())
    }

    fn terms(&self, gamma: f64) -> Option<Terms> {
        let b1 = &self.b1 - &self.b2 * &self.d112;
        let rw = DMatrix::identity(self.n_w, self.n_w) * (gamma * gamma) - self.du.tr_mul(&self.du);
        let rw_inverse = rw.cholesky()?.inverse();
        let feedthrough = &self.du * &rw_inverse;
        let a = &self.a - &self.b2 * &self.c12 + &b1 * feedthrough.transpose() * &self.c11;
        let g = &self.b2 * self.b2.transpose() - &b1 * &rw_inverse * b1.transpose();
        let q =
            self.c11.tr_mul(&self.c11) + (feedthrough.tr_mul(&self.c11)).tr_mul(&self.du.tr_mul(&self.c11));
        let terms = Terms { a, g: symmetric(&g), q: symmetric(&q), b1, rw_inverse };
        let finite = [&terms.a, &terms.g, &terms.q].iter().all(|m| m.iter().all(|v| v.is_finite()));
        finite.then_some(terms)
    }

    fn is_feasible(&self, gamma: f64) -> Result<bool, Error> {
        let Some(terms) = self.terms(gamma) else { return Ok(false) };
        match StableSubspace::new(&terms.a, &terms.g, &terms.q) {
            Ok(subspace) => Ok(subspace.angles().iter().all(|&angle| angle > -ZERO_ANGLE)),
            Err(telepulse_lti::Error::HamiltonianAxis { .. } | telepulse_lti::Error::SwapFailed { .. }) => {
                Ok(false)
            }
            Err(error) => Err(error.into()),
        }
    }

    /// The gain for one gamma, verified on the plant as given.
    fn design(
        &self,
        sys: &StateSpace<Continuous>,
        gamma: f64,
        information: Information,
    ) -> Result<StaticHinfDesign, Error> {
        let lost = |achieved| Error::IllConditioned { gamma, achieved };
        let terms = self.terms(gamma).ok_or(lost(f64::INFINITY))?;
        let solution = riccati::continuous(&terms.a, &terms.g, &terms.q).map_err(|_| lost(f64::INFINITY))?;
        let x = &solution.x;
        let mut gain = -(&self.c12 + self.b2.tr_mul(x));
        let disturbance_gain = match information {
            Information::State => {
                // The worst disturbance w = F1 x enters through D11.
                let f1 = &terms.rw_inverse * (terms.b1.tr_mul(x) + self.du.tr_mul(&self.c11));
                gain -= &self.d112 * f1;
                None
            }
            Information::StateAndDisturbance => Some(-(&self.u_scale * &self.d112)),
        };
        let gain = &self.u_scale * gain;
        let n_u = gain.nrows();
        let zero = DMatrix::zeros(n_u, self.n_w);
        let on_w = disturbance_gain.as_ref().unwrap_or(&zero);
        let (b2, d12) = (sys.b().columns(self.n_w, n_u), sys.d().columns(self.n_w, n_u));
        let closed_loop = StateSpace::<Continuous>::new(
            sys.a() + b2 * &gain,
            sys.b().columns(0, self.n_w) + b2 * on_w,
            sys.c() + d12 * &gain,
            sys.d().columns(0, self.n_w) + d12 * on_w,
        )?;
        let closed_loop_poles = closed_loop.poles()?;
        if closed_loop_poles.iter().any(|pole| pole.re >= 0.0) {
            return Err(lost(f64::INFINITY));
        }
        let achieved = hinf_norm(&closed_loop)?;
        if achieved.upper > gamma * (1.0 + ACHIEVED_TOLERANCE) {
            return Err(lost(achieved.value));
        }
        Ok(StaticHinfDesign {
            state_gain: gain,
            disturbance_gain,
            gamma_lower: 0.0,
            gamma_upper: gamma,
            gamma_design: gamma,
            achieved,
            closed_loop_poles,
            residual_relative: solution.residual_relative,
            n_feasibility_tests: 0,
        })
    }
}

/// Terms of the Riccati equation at one gamma, after `u → u - C12 x - D112 w`.
struct Terms {
    a: DMatrix<f64>,
    g: DMatrix<f64>,
    q: DMatrix<f64>,
    b1: DMatrix<f64>,
    rw_inverse: DMatrix<f64>,
}

/// The smallest reachable gamma between two tested values.
struct Bracket {
    lower: f64,
    upper: f64,
    n_tests: usize,
}

impl Bracket {
    fn find(&mut self, problem: &Problem, options: &HinfOptions) -> Result<(), Error> {
        let mut gamma = if self.lower > 0.0 { 2.0 * self.lower } else { 1.0 };
        // Each turn is ten times the last, up to gamma_max.
        while self.upper.is_infinite() {
            self.try_gamma(problem, gamma.min(options.gamma_max))?;
            if self.upper.is_infinite() && gamma >= options.gamma_max {
                return Err(Error::Infeasible { gamma_max: options.gamma_max, binding: None });
            }
            gamma *= GROWTH;
        }
        let smallest = self.upper * SMALLEST_RELATIVE;
        while self.lower == 0.0 && self.upper > smallest {
            self.try_gamma(problem, self.upper / GROWTH)?;
        }
        if self.lower == 0.0 {
            return Ok(());
        }
        for _ in 0..BISECTIONS_MAX {
            if self.upper <= self.lower * (1.0 + options.gamma_tolerance) {
                return Ok(());
            }
            self.try_gamma(problem, (self.lower * self.upper).sqrt())?;
        }
        Err(Error::NotConverged { gamma_lower: self.lower, gamma_upper: self.upper })
    }

    fn try_gamma(&mut self, problem: &Problem, gamma: f64) -> Result<(), Error> {
        self.n_tests += 1;
        if problem.is_feasible(gamma)? {
            self.upper = gamma
        } else {
            self.lower = gamma
        }
        Ok(())
    }
}

/// Whether `[A - mode I; C]` has a singular value that counts as zero.
fn loses_rank(a: &DMatrix<f64>, c: &DMatrix<f64>, mode: Complex64) -> bool {
    let n = a.nrows();
    let mut pencil = DMatrix::from_fn(n + c.nrows(), n, |i, j| {
        Complex64::new(if i < n { a[(i, j)] } else { c[(i - n, j)] }, 0.0)
    });
    for k in 0..n {
        pencil[(k, k)] -= mode;
    }
    let values = pencil.singular_values();
    values.min() <= 10.0 * n as f64 * f64::EPSILON * values.max()
}

fn largest_singular_value(m: &DMatrix<f64>) -> f64 {
    if m.is_empty() { 0.0 } else { m.singular_values().max() }
}

fn symmetric(m: &DMatrix<f64>) -> DMatrix<f64> {
    (m + m.transpose()) * 0.5
}

/// An angle this little below zero is a zero of `X` seen through rounding.
const ZERO_ANGLE: f64 = 1e-7;
/// Ratio of singular values below which `D12` counts as rank-deficient: the scaling would cost half of the digits.
const RANK_TOLERANCE: f64 = 1e-8;
/// Factor between gammas while one end of the bracket is unknown.
const GROWTH: f64 = 10.0;
/// A problem that is still feasible this far below the first feasible gamma has no lower end worth finding.
const SMALLEST_RELATIVE: f64 = 1e-12;
/// Halvings of the logarithm: a decade to `1e-12` takes 42.
const BISECTIONS_MAX: usize = 80;
/// Designs tried, each further from the optimum than the one before.
const DESIGNS_MAX: usize = 12;
/// Growth of the distance from the optimum between designs.
const RELAXATION_GROWTH: f64 = 2.0;
/// How far the measured norm may exceed the gamma of the design.
const ACHIEVED_TOLERANCE: f64 = 1e-4;
