//! What no controller can do at single frequencies.

use nalgebra::DMatrix;
use num_complex::Complex64;
use telepulse_lti::GeneralizedPlant;

/// The largest gains over some frequencies that no controller can lower.
pub(super) struct PointwiseBound {
    /// What `u` does not reach of `z`.
    pub(super) control: f64,
    /// What `y` does not see of `w`.
    pub(super) filter: f64,
}

/// Returns the largest gain over some frequencies that no controller, stabilizing or not, can lower.
///
/// **Method**: at one frequency the closed loop is `P11 + P12 Q P21` with any matrix `Q`; what `P12` does not reach on the
/// left and what `P21` does not see on the right stays. At infinity this is Parrott's bound.
///
/// **Accuracy**: a lower bound of the optimum; the true one over all frequencies is the limit set by the Hamiltonian
/// matrices having no eigenvalue on the axis.
pub(super) fn pointwise_bound(plant: &GeneralizedPlant, frequencies: &[f64]) -> PointwiseBound {
    let (n_w, n_z) = (plant.n_w(), plant.n_z());
    let (n_u, n_y) = (plant.n_u(), plant.n_y());
    if n_z <= n_u && n_w <= n_y {
        return PointwiseBound { control: 0.0, filter: 0.0 };
    }
    let infinity = plant.sys().d().map(|value| Complex64::new(value, 0.0));
    let finite = frequencies.iter().filter_map(|omega| plant.sys().at(*omega).ok());
    let none = PointwiseBound { control: 0.0, filter: 0.0 };
    finite.chain(std::iter::once(infinity)).fold(none, |bound, p| {
        let p11 = p.view((0, 0), (n_z, n_w)).into_owned();
        let p12 = p.view((0, n_w), (n_z, n_u)).into_owned();
        let p21 = p.view((n_z, 0), (n_y, n_w)).adjoint();
        PointwiseBound {
            control: bound.control.max(unreached(&p12, &p11)),
            filter: bound.filter.max(unreached(&p21, &p11.adjoint())),
        }
    })
}

impl PointwiseBound {
    /// The larger of the two.
    pub(super) fn value(&self) -> f64 {
        self.control.max(self.filter)
    }
}

/// Largest singular value of the part of `target` that is orthogonal to the columns of `reach`.
fn unreached(reach: &DMatrix<Complex64>, target: &DMatrix<Complex64>) -> f64 {
    if reach.nrows() <= reach.ncols() {
        return 0.0;
    }
    // Where the columns of `reach` depend on each other, this basis spans more than they do, and the bound is only lower.
    let u = reach.clone().qr().q();
    let rest = target - &u * (u.adjoint() * target);
    // The larger Gram matrix has no more eigenvalues than the smaller one.
    let gram = if rest.nrows() < rest.ncols() { &rest * rest.adjoint() } else { rest.ad_mul(&rest) };
    let size = gram.symmetric_eigenvalues().max().max(0.0).sqrt();
    // Cancellation leaves rounding where nothing is left.
    if size.is_finite() && size > ROUNDING * target.norm() { size } else { 0.0 }
}

/// Frequencies in rad/s that span the plant's own poles, a few to the decade.
pub(super) fn frequencies(plant: &GeneralizedPlant) -> Vec<f64> {
    let mut own: Vec<f64> = plant
        .sys()
        .poles()
        .unwrap_or_default()
        .iter()
        .flat_map(|pole| [pole.norm(), pole.im.abs()])
        .filter(|omega| *omega > 0.0 && omega.is_finite())
        .collect();
    own.sort_by(f64::total_cmp);
    let (low, high) = match (own.first(), own.last()) {
        (Some(low), Some(high)) => (0.1 * low, 10.0 * high),
        _ => (1e-2, 1e2),
    };
    let step = (high / low).powf(1.0 / (GRID - 1) as f64);
    own.extend((0..GRID).map(|k| low * step.powi(k)));
    own
}

/// Frequencies between a tenth of the slowest and ten times the fastest pole.
const GRID: i32 = 24;
/// Part of a response that may be rounding.
const ROUNDING: f64 = 1e-9;
