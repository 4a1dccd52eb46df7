//! Residual and Jacobian of the collocated equilibrium.

use nalgebra::{DMatrix, DVector};

use super::{Dashpots, Membrane, PointState};
use crate::material::electrical;

/// Shape of the membrane: r and z at the nodes, divided by B. Inner node first.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Shape {
    pub(super) r: DVector<f64>,
    pub(super) z: DVector<f64>,
}

impl Shape {
    /// Flat at the pre-stretch, with the vertical profile z = x ln(R/B)/ln(A/B) of a membrane under uniform tension.
    pub(super) fn guess(membrane: &Membrane, x: f64) -> Self {
        let nodes = membrane.grid().nodes();
        let prestretch = membrane.parameters().spec().prestretch;
        let log_inner = nodes[0].ln();
        Self {
            r: DVector::from_iterator(nodes.len(), nodes.iter().map(|rho| prestretch * rho)),
            z: DVector::from_iterator(nodes.len(), nodes.iter().map(|rho| x * rho.ln() / log_inner)),
        }
    }

    /// Adds `factor * step`, `step` in the order of the unknowns: r at the inner nodes, z at all but the frame.
    pub(super) fn stepped(&self, step: &DVector<f64>, factor: f64) -> Self {
        let mut next = self.clone();
        let n = self.r.len() - 1;
        for i in 1..n {
            next.r[i] += factor * step[i - 1];
        }
        for i in 0..n {
            next.z[i] += factor * step[n - 1 + i];
        }
        next
    }
}

/// What closes the equations: the last row of residual and Jacobian. Both values are dimensionless.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Closure {
    /// z(A) = value.
    Displacement(f64),
    /// Force on the plate = value.
    Force(f64),
}

/// Residual at a shape, with all that the Jacobian needs.
#[derive(Debug, Clone)]
pub(super) struct Residual {
    pub(super) value: DVector<f64>,
    /// Dimensionless force with which the membrane pulls the plate up.
    pub(super) force: f64,
    /// Largest stress, at least 1: rounding of the residual grows with it.
    pub(super) stress_scale: f64,
    points: Vec<Point>,
}

/// Derivatives of P = R s1 cos, Q = -R s1 sin and s2 at one node.
///
/// `p`, `q` stand for dr/dR and dz/dR. P depends on q as Q does on p.
#[derive(Debug, Clone, Copy, Default)]
struct Point {
    p_p: f64,
    p_q: f64,
    p_r: f64,
    q_q: f64,
    q_r: f64,
    s2_p: f64,
    s2_q: f64,
    s2_r: f64,
    /// Derivatives with respect to v^2.
    p_field: f64,
    q_field: f64,
    s2_field: f64,
}

/// Residual at `shape`, or nothing where the material law has no value.
pub(super) fn residual(
    membrane: &Membrane,
    dashpots: &Dashpots,
    shape: &Shape,
    field: f64,
    closure: Closure,
) -> Option<Residual> {
    let grid = membrane.grid();
    let n = grid.n_nodes() - 1;
    let dr = grid.differentiation() * &shape.r;
    let dz = grid.differentiation() * &shape.z;
    let mut points = vec![Point::default(); n + 1];
    let mut radial = DVector::zeros(n + 1);
    let mut vertical = DVector::zeros(n + 1);
    let mut hoop = DVector::zeros(n + 1);
    let mut stress_scale: f64 = 1.0;
    for (j, &rho) in grid.nodes().iter().enumerate() {
        let l1 = dr[j].hypot(dz[j]);
        let l2 = shape.r[j] / rho;
        let s = membrane.stress(dashpots, j, PointState { l1, l2, field })?;
        let el = electrical(l1, l2);
        // c = cos(theta), d = -sin(theta).
        let (c, d) = (dr[j] / l1, dz[j] / l1);
        let geometric = s.s1 / l1;
        radial[j] = rho * s.s1 * c;
        vertical[j] = rho * s.s1 * d;
        hoop[j] = s.s2;
        stress_scale = stress_scale.max(s.s1.abs()).max(s.s2.abs());
        points[j] = Point {
            p_p: rho * (s.s11 * c * c + geometric * d * d),
            p_q: rho * (s.s11 - geometric) * c * d,
            p_r: s.s12 * c,
            q_q: rho * (s.s11 * d * d + geometric * c * c),
            q_r: s.s12 * d,
            s2_p: s.s12 * c,
            s2_q: s.s12 * d,
            s2_r: s.s22 / rho,
            p_field: rho * el.s1 * c,
            q_field: rho * el.s1 * d,
            s2_field: el.s2,
        };
    }
    let d_radial = grid.differentiation() * &radial;
    let d_vertical = grid.differentiation() * &vertical;
    let force = -flux_mean(&vertical);
    let mut value = DVector::zeros(2 * n - 1);
    for i in 1..n {
        value[i - 1] = d_radial[i] - hoop[i];
        value[n - 2 + i] = d_vertical[i];
    }
    value[2 * n - 2] = match closure {
        Closure::Displacement(x) => shape.z[0] - x,
        Closure::Force(target) => force - target,
    };
    value.iter().all(|entry| entry.is_finite()).then_some(Residual { value, force, stress_scale, points })
}

/// Jacobian of the residual by the unknowns: the product of differentiation matrices with pointwise tangents.
pub(super) fn jacobian(membrane: &Membrane, residual: &Residual, closure: Closure) -> DMatrix<f64> {
    let differentiation = membrane.grid().differentiation();
    let n = differentiation.nrows() - 1;
    let n_unknowns = 2 * n - 1;
    // Derivatives of P and Q at all nodes by the unknowns (r at 1..n, z at 0..n).
    let mut radial = DMatrix::zeros(n + 1, n_unknowns);
    let mut vertical = DMatrix::zeros(n + 1, n_unknowns);
    let mut hoop = DMatrix::zeros(n + 1, n_unknowns);
    for k in 0..n {
        for (j, point) in residual.points.iter().enumerate() {
            let d = differentiation[(j, k)];
            if k > 0 {
                radial[(j, k - 1)] = point.p_p * d;
                vertical[(j, k - 1)] = point.p_q * d;
                hoop[(j, k - 1)] = point.s2_p * d;
            }
            radial[(j, n - 1 + k)] = point.p_q * d;
            vertical[(j, n - 1 + k)] = point.q_q * d;
            hoop[(j, n - 1 + k)] = point.s2_q * d;
        }
    }
    for (j, point) in residual.points.iter().enumerate().take(n).skip(1) {
        radial[(j, j - 1)] += point.p_r;
        vertical[(j, j - 1)] += point.q_r;
        hoop[(j, j - 1)] += point.s2_r;
    }
    let inner = differentiation.rows(1, n - 1);
    let mut jacobian = DMatrix::zeros(n_unknowns, n_unknowns);
    jacobian.rows_mut(0, n - 1).gemm(1.0, &inner, &radial, 0.0);
    let mut top = jacobian.rows_mut(0, n - 1);
    top -= hoop.rows(1, n - 1);
    jacobian.rows_mut(n - 1, n - 1).gemm(1.0, &inner, &vertical, 0.0);
    match closure {
        Closure::Displacement(_) => jacobian[(n_unknowns - 1, n - 1)] = 1.0,
        Closure::Force(_) => {
            let mean = (vertical.row(0) + vertical.row(1)) * -0.5;
            jacobian.row_mut(n_unknowns - 1).copy_from(&mean);
        }
    }
    jacobian
}

/// Mean of the vertical flux over the two innermost nodes.
///
/// The collocated flux has zero slope at all inner nodes, so it is a constant plus a multiple of the Chebyshev polynomial
/// T_n, which is +1 and -1 in turn at the nodes: the mean of two neighbours is the constant, free of that error.
fn flux_mean(vertical: &DVector<f64>) -> f64 {
    0.5 * (vertical[0] + vertical[1])
}

/// Derivative of the dimensionless force by the unknowns.
pub(super) fn force_gradient(membrane: &Membrane, residual: &Residual) -> DVector<f64> {
    let differentiation = membrane.grid().differentiation();
    let n = differentiation.nrows() - 1;
    DVector::from_fn(2 * n - 1, |unknown, _| {
        let of_node = |j: usize| {
            let point = residual.points[j];
            if unknown < n - 1 {
                let direct = if j == unknown + 1 { point.q_r } else { 0.0 };
                point.p_q * differentiation[(j, unknown + 1)] + direct
            } else {
                point.q_q * differentiation[(j, unknown + 1 - n)]
            }
        };
        -0.5 * (of_node(0) + of_node(1))
    })
}

/// Derivatives by v^2 at fixed shape and closure value.
pub(super) struct FieldDerivative {
    pub(super) residual: DVector<f64>,
    pub(super) force: f64,
}

/// Derivative of residual and force by v^2, with the displacement held.
pub(super) fn field_derivative(membrane: &Membrane, residual: &Residual) -> FieldDerivative {
    let differentiation = membrane.grid().differentiation();
    let n = differentiation.nrows() - 1;
    let radial = DVector::from_iterator(n + 1, residual.points.iter().map(|point| point.p_field));
    let vertical = DVector::from_iterator(n + 1, residual.points.iter().map(|point| point.q_field));
    let d_radial = differentiation * &radial;
    let d_vertical = differentiation * &vertical;
    let mut value = DVector::zeros(2 * n - 1);
    for i in 1..n {
        value[i - 1] = d_radial[i] - residual.points[i].s2_field;
        value[n - 2 + i] = d_vertical[i];
    }
    FieldDerivative { residual: value, force: -flux_mean(&vertical) }
}
