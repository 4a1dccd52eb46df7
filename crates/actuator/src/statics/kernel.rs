//! Residual of the collocated equilibrium at a state, and the pointwise derivatives that its linearisation needs.
//!
//! Everything is dimensionless: lengths over B, stresses over mu, `force` = F/(2 pi mu H B), `field` = v^2.

use super::operator::Operator;
use crate::material::{ElasticLaw, Stress};

/// Elastic and viscous stress at a node, without the electrical part.
pub(crate) trait PointLaw {
    /// Stress and tangent over mu, or nothing where the law has no value.
    fn stress(&self, node: usize, l1: f64, l2: f64) -> Option<Stress>;
}

impl PointLaw for ElasticLaw {
    #[inline]
    fn stress(&self, _node: usize, l1: f64, l2: f64) -> Option<Stress> {
        Self::stress(self, l1, l2)
    }
}

/// Unknowns of a membrane: r and q = dz/dR at all nodes, force, v^2. Inner node first.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct State {
    pub(crate) r: Vec<f64>,
    pub(crate) q: Vec<f64>,
    pub(crate) force: f64,
    pub(crate) field: f64,
}

impl State {
    /// Flat between the two boundary radii as a linear sheet would be, r = alpha R + beta/R, with the vertical profile
    /// z = x ln(R)/ln(A/B) of a membrane under uniform tension.
    pub(crate) fn guess(operator: &Operator, edges: Edges, displacement: f64) -> Self {
        let inner = operator.rho[0];
        // r(A) = a, r(1) = b.
        let beta = (edges.inner - edges.outer * inner) / (1.0 / inner - inner);
        let alpha = edges.outer - beta;
        let slope = displacement / inner.ln();
        let mut r: Vec<f64> = operator
            .rho
            .iter()
            .zip(&operator.inverse_rho)
            .map(|(rho, inv)| alpha * rho + beta * inv)
            .collect();
        r[0] = edges.inner;
        r[operator.degree] = edges.outer;
        Self {
            r,
            q: operator.inverse_rho.iter().map(|inverse| slope * inverse).collect(),
            force: 0.0,
            field: 0.0,
        }
    }

    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.r.copy_from_slice(&other.r);
        self.q.copy_from_slice(&other.q);
        (self.force, self.field) = (other.force, other.field);
    }
}

/// Deformed radii of the boundaries over B.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Edges {
    pub(crate) inner: f64,
    pub(crate) outer: f64,
}

/// Derivatives of P = R s1 cos(theta), Q = -R s1 sin(theta) and s2 at one node, by p = dr/dR, q = dz/dR, r and v^2.
///
/// Since a potential exists, Q depends on p as P does on q, and so on: each is stored once.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Point {
    pub(crate) p_p: f64,
    pub(crate) p_q: f64,
    pub(crate) q_q: f64,
    pub(crate) p_r: f64,
    pub(crate) q_r: f64,
    pub(crate) s2_r: f64,
    pub(crate) p_field: f64,
    pub(crate) q_field: f64,
    pub(crate) s2_field: f64,
}

/// Residual at a state with what goes with it.
///
/// ```text
/// balance_i = (D P)_i - s2_i         inner nodes                (R s1 cos(theta))' = s2
/// vertical_j = Q_j + f               all nodes                  R s1 sin(theta) = f, constant
/// displacement = -sum_j w_j q_j                                 x = z(A), z(B) = 0
/// capacitance = sum_j w_j R_j (l1 l2)_j^2                       over (eps/H) 2 pi B^2
/// ```
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Evaluation {
    pub(crate) p: Vec<f64>,
    pub(crate) l1: Vec<f64>,
    pub(crate) l2: Vec<f64>,
    pub(crate) s1: Vec<f64>,
    pub(crate) s2: Vec<f64>,
    pub(crate) radial: Vec<f64>,
    pub(crate) vertical: Vec<f64>,
    /// Zero at the two boundaries, where nothing is asked of it.
    pub(crate) balance: Vec<f64>,
    pub(crate) points: Vec<Point>,
    pub(crate) displacement: f64,
    pub(crate) capacitance: f64,
    /// Smallest of ds1/dl1 and ds2/dl2 over the nodes, with the electrical part.
    pub(crate) least_modulus: f64,
    /// Smallest ds1/dl1: where it is not positive, the equations of the axisymmetric membrane have lost their type.
    pub(crate) least_s11: f64,
}

impl Evaluation {
    pub(crate) fn new(degree: usize) -> Self {
        let zeros = || vec![0.0; degree + 1];
        Self {
            p: zeros(),
            l1: zeros(),
            l2: zeros(),
            s1: zeros(),
            s2: zeros(),
            radial: zeros(),
            vertical: zeros(),
            balance: zeros(),
            points: vec![Point::default(); degree + 1],
            displacement: 0.0,
            capacitance: 0.0,
            least_modulus: 0.0,
            least_s11: 0.0,
        }
    }

    /// Evaluates at `state`; false where the law has no value at some node.
    pub(crate) fn at<L: PointLaw>(&mut self, operator: &Operator, law: &L, state: &State) -> bool {
        self.stretch(operator, state);
        self.balance(operator, law, state)
    }

    /// Slopes, stretches, displacement and capacitance at `state`: what comes before the material.
    #[inline]
    pub(crate) fn stretch(&mut self, operator: &Operator, state: &State) {
        operator.differentiate(&state.r, &mut self.p);
        let (mut displacement, mut capacitance) = (0.0, 0.0);
        for j in 0..=operator.degree {
            let (p, q, weight) = (self.p[j], state.q[j], operator.weights[j]);
            let (l1, l2) = ((p * p + q * q).sqrt(), state.r[j] * operator.inverse_rho[j]);
            (self.l1[j], self.l2[j]) = (l1, l2);
            displacement -= weight * q;
            let area = l1 * l2;
            capacitance += weight * operator.rho[j] * area * area;
        }
        (self.displacement, self.capacitance) = (displacement, capacitance);
    }

    /// The rest at the state that was stretched last; false where the law has no value at some node.
    #[inline]
    pub(crate) fn balance<L: PointLaw>(&mut self, operator: &Operator, law: &L, state: &State) -> bool {
        let (mut least_s11, mut least_s22) = (f64::INFINITY, f64::INFINITY);
        for j in 0..=operator.degree {
            let (p, q) = (self.p[j], state.q[j]);
            let (rho, inverse_rho) = (operator.rho[j], operator.inverse_rho[j]);
            let (l1, l2) = (self.l1[j], self.l2[j]);
            let Some(elastic) = law.stress(j, l1, l2) else { return false };
            let area = l1 * l2;
            // Electrical stress for one v^2: -l1 l2^2 and -l1^2 l2.
            let (e1, e2) = (-area * l2, -area * l1);
            let field = state.field;
            let (s1, s2) = (elastic.s1 + field * e1, elastic.s2 + field * e2);
            let s11 = elastic.s11 - field * l2 * l2;
            let s12 = elastic.s12 - 2.0 * field * area;
            let s22 = elastic.s22 - field * l1 * l1;
            least_s11 = least_s11.min(s11);
            least_s22 = least_s22.min(s22);
            let inverse_l1 = 1.0 / l1;
            // c = cos(theta), d = -sin(theta).
            let (c, d) = (p * inverse_l1, q * inverse_l1);
            let geometric = s1 * inverse_l1;
            (self.s1[j], self.s2[j]) = (s1, s2);
            self.radial[j] = rho * s1 * c;
            self.vertical[j] = rho * s1 * d + state.force;
            self.points[j] = Point {
                p_p: rho * (s11 * c * c + geometric * d * d),
                p_q: rho * (s11 - geometric) * c * d,
                q_q: rho * (s11 * d * d + geometric * c * c),
                p_r: s12 * c,
                q_r: s12 * d,
                s2_r: s22 * inverse_rho,
                p_field: rho * e1 * c,
                q_field: rho * e1 * d,
                s2_field: e2,
            };
        }
        let n = operator.degree;
        operator.differentiate(&self.radial, &mut self.balance);
        for (slope, s2) in self.balance.iter_mut().zip(&self.s2) {
            *slope -= s2;
        }
        (self.balance[0], self.balance[n]) = (0.0, 0.0);
        (self.least_s11, self.least_modulus) = (least_s11, least_s11.min(least_s22));
        self.displacement.is_finite() && self.capacitance.is_finite()
    }

    /// Largest stress, at least 1: rounding of the residual grows with it.
    pub(crate) fn stress_scale(&self) -> f64 {
        self.s1.iter().chain(&self.s2).fold(1.0, |a: f64, s| a.max(s.abs()))
    }

    /// Smaller of the smallest meridional and hoop stress over the nodes.
    pub(crate) fn least_stress(&self) -> f64 {
        self.s1.iter().chain(&self.s2).copied().fold(f64::INFINITY, f64::min)
    }
}
