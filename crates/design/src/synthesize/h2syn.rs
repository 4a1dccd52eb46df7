//! H2 synthesis: the controller whose closed loop has the least output power under white noise.

use nalgebra::DMatrix;
use num_complex::Complex64;
use telepulse_lti::{Continuous, GeneralizedPlant, StateSpace, lyapunov, riccati};

use super::assumptions::{self, Strictness};
use super::normalized_plant::NormalizedPlant;
use crate::Error;

/// The H2-optimal controller and the evidence for it.
#[derive(Clone, Debug, PartialEq)]
pub struct H2Design {
    /// The controller, `u = K y`.
    pub controller: StateSpace<Continuous>,
    /// The smallest H2 norm of any controller, from the Riccati solutions.
    pub optimum: f64,
    /// The H2 norm of the closed loop on the plant as it was given, from its controllability Gramian.
    pub achieved: f64,
    /// Poles of the closed loop in rad/s, all stable.
    pub closed_loop_poles: Vec<Complex64>,
    /// Larger of the relative residuals of the two Riccati equations.
    pub residual_relative: f64,
}

/// Returns the controller whose closed loop from `w` to `z` has the smallest H2 norm.
///
/// ```text
///   w --->+-------+---> z        ||T_zw||_2² = (1 / 2 pi) ∫ trace(T* T) d omega
///         |   P   |
///   u +-->+-------+--+ y         u = K y (positive feedback, as in GeneralizedPlant)
///     +------ K <----+
/// ```
///
/// **Shapes and units**: see [`GeneralizedPlant`]. With `w` and `z` of the form `z = [Q^(1/2) x; R^(1/2) u]`, `w` white process and
/// measurement noise, this is the linear quadratic Gaussian controller; cross terms are allowed.
///
/// **Method**: plant normalized to `D12 = [0; I]`, `D21 = [0 I]`; the static feedback that cancels `D11` is split off (the norm is
/// infinite with any other); one control and one filter Riccati equation; normalization and `D22` undone. The norm is then
/// recomputed from the closed loop on the plant as it was given.
///
/// **Source**: Doyle, Glover, Khargonekar and Francis 1989; Zhou and Doyle 1998, chapter 13.
///
/// **Accuracy**: `achieved` exceeds `optimum` by less than `1e-4` (relative), checked; typically by rounding.
///
/// **Errors**: [`Error::InfiniteH2Norm`] where no static feedback cancels `D11`; [`Error::SingularD12`], [`Error::SingularD21`],
/// [`Error::NotStabilizable`], [`Error::NotDetectable`], [`Error::AxisZero`], [`Error::IllConditioned`].
///
/// **Example**: an integrator with noise in the state and in the measurement, all weights one: both Riccati solutions are 1, and
/// the squared norm is `trace(B1ᵀ X B1) + trace(F Y Fᵀ) = 1 + 1`.
/// ```
/// use nalgebra::dmatrix;
/// use telepulse_design::synthesize::h2syn;
/// use telepulse_lti::{Continuous, GeneralizedPlant, StateSpace};
/// let sys = StateSpace::<Continuous>::new(
///     dmatrix![0.0], dmatrix![1.0, 0.0, 1.0], dmatrix![1.0; 0.0; 1.0],
///     dmatrix![0.0, 0.0, 0.0; 0.0, 0.0, 1.0; 0.0, 1.0, 0.0])?;
/// let design = h2syn(&GeneralizedPlant::new(sys, 2, 1, 2, 1)?)?;
/// assert!((design.achieved - 2f64.sqrt()).abs() < 1e-14);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn h2syn(plant: &GeneralizedPlant) -> Result<H2Design, Error> {
    let p = NormalizedPlant::new(plant)?;
    let (n_zf, n_u, n_wf, n_y) = (p.n_z_free(), p.n_u(), p.n_w_free(), p.n_y());
    // D11 + D12 K D21 = 0 with K = -D1122 in these coordinates, if the other quarters are zero.
    let mut left = p.d11.clone();
    left.view_mut((n_zf, n_wf), (n_u, n_y)).fill(0.0);
    if left.amax() > ROUNDING * p.d11.amax() {
        return Err(Error::InfiniteH2Norm { direct_term: left.norm() });
    }
    assumptions::check(&p, Strictness::Certain)?;
    let dk = -p.d11_quarter(true, true);
    let a = &p.a + &p.b2 * &dk * &p.c2;
    let mut b1 = p.b1.clone();
    let reached = b1.columns(n_wf, n_y) + &p.b2 * &dk;
    b1.columns_mut(n_wf, n_y).copy_from(&reached);
    let mut c1 = p.c1.clone();
    let seen = c1.rows(n_zf, n_u) + &dk * &p.c2;
    c1.rows_mut(n_zf, n_u).copy_from(&seen);

    // Cross terms leave A - B2 C12 and the part of C1 that u does not reach; likewise for the filter.
    let (c11, c12) = (c1.rows(0, n_zf).into_owned(), c1.rows(n_zf, n_u).into_owned());
    let (b11, b12) = (b1.columns(0, n_wf).into_owned(), b1.columns(n_wf, n_y).into_owned());
    let control = riccati::continuous(
        &(&a - &p.b2 * &c12),
        &symmetric(&(&p.b2 * p.b2.transpose())),
        &symmetric(&c11.tr_mul(&c11)),
    )?;
    let filter = riccati::continuous(
        &(&a - &b12 * &p.c2).transpose(),
        &symmetric(&p.c2.tr_mul(&p.c2)),
        &symmetric(&(&b11 * b11.transpose())),
    )?;
    let f = -(p.b2.tr_mul(&control.x) + c12);
    let l = -(&filter.x * p.c2.transpose() + b12);
    let squared = b1.tr_mul(&(&control.x * &b1)).trace() + (&f * &filter.x * f.transpose()).trace();
    let optimum = squared.max(0.0).sqrt();
    let ak = &a + &p.b2 * &f + &l * &p.c2;
    let central = StateSpace::<Continuous>::new(ak, -l, f, dk)?.balanced();
    let controller = p.recover(&central)?;

    let closed_loop = plant.lower_lft(&controller)?;
    let closed_loop_poles = closed_loop.poles()?;
    let lost = |achieved| Error::IllConditioned { gamma: optimum, achieved };
    let slowest = closed_loop_poles.iter().map(|pole| -pole.re).fold(f64::INFINITY, f64::min);
    if slowest <= 0.0 {
        return Err(lost(f64::INFINITY));
    }
    let sys = closed_loop.balanced();
    let gramian = lyapunov::continuous(sys.a(), &symmetric(&(sys.b() * sys.b().transpose())))?.x;
    let achieved = (sys.c() * gramian * sys.c().transpose()).trace().max(0.0).sqrt();
    // A loop in which z cannot be moved at all has a norm of rounding.
    let rounding = ROUNDING_OF_NORM * sys.b().norm() * sys.c().norm() / (2.0 * slowest).sqrt();
    if !achieved.is_finite() || achieved > optimum * (1.0 + ACHIEVED_TOLERANCE) + rounding {
        return Err(lost(achieved));
    }
    let residual_relative = control.residual_relative.max(filter.residual_relative);
    Ok(H2Design { controller, optimum, achieved, closed_loop_poles, residual_relative })
}

fn symmetric(m: &DMatrix<f64>) -> DMatrix<f64> {
    (m + m.transpose()) * 0.5
}

/// Share of `D11` that counts as the rounding of its rotations.
const ROUNDING: f64 = 1e-13;
/// Share of the largest norm that the closed loop's matrices allow, below which a norm is rounding.
const ROUNDING_OF_NORM: f64 = 1e-9;
/// How far the measured norm may exceed the optimum.
const ACHIEVED_TOLERANCE: f64 = 1e-4;
