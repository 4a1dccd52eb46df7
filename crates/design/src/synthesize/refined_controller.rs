//! The central controller once more, in doubled precision, for problems whose formulas cancel.
//!
//! Near the optimum, and where many modes are unstable, the Riccati solutions are large and the controller is a small
//! difference of large terms: computed in working precision it may miss its gamma or not stabilize at all, while the exact
//! controller, rounded to working precision, does what it should.

use nalgebra::DMatrix;
use telepulse_lti::doubled_matrix::DoubledMatrix;
use telepulse_lti::{Continuous, StateSpace, lyapunov};

use super::normalized_plant::NormalizedPlant;

/// Returns the central controller of the normalized plant from approximate Riccati solutions.
///
/// **Method**: both solutions are corrected by Newton steps with residuals in doubled precision; gains and controller follow the
/// formulas for a general `D11` in doubled precision, and are rounded once.
///
/// **Source**: Zhou, Doyle and Glover 1996, theorem 17.1.
///
/// **Errors**: `None` where the solutions are too rough to be corrected, or a matrix is singular.
pub(super) fn refined_controller(
    plant: &NormalizedPlant,
    gamma: f64,
    x_start: &DMatrix<f64>,
    y_start: &DMatrix<f64>,
) -> Option<StateSpace<Continuous>> {
    let (n, n_w, n_u) = (plant.a.nrows(), plant.b1.ncols(), plant.n_u());
    let (n_z, n_y) = (plant.c1.nrows(), plant.n_y());
    let (n_zf, n_wf) = (plant.n_z_free(), plant.n_w_free());
    let gamma2 = gamma * gamma;
    let exact = |m: &DMatrix<f64>| DoubledMatrix::from(m);
    let (a, b1, c1, d11) = (exact(&plant.a), exact(&plant.b1), exact(&plant.c1), exact(&plant.d11));

    // Control: R = D1ᵀ D1 - diag(gamma² I, 0) with D1 = [D11 D12].
    let b = beside(&b1, &exact(&plant.b2));
    let mut d1 = DoubledMatrix::zeros(n_z, n_w + n_u);
    d1.set_block((0, 0), &d11);
    d1.set_block((n_zf, n_w), &exact(&DMatrix::identity(n_u, n_u)));
    let control = Riccati::new(&a, &b, &c1, &d1, gamma2, n_w)?;
    let x = control.refine(x_start)?;
    let f = control.gain(&x)?;

    // Filter: the same of the dual plant.
    let c = beside(&c1.transpose(), &exact(&plant.c2.transpose()));
    let mut d2 = DoubledMatrix::zeros(n_w, n_z + n_y);
    d2.set_block((0, 0), &d11.transpose());
    d2.set_block((n_wf, n_z), &exact(&DMatrix::identity(n_y, n_y)));
    let filter = Riccati::new(&a.transpose(), &c, &b1.transpose(), &d2, gamma2, n_z)?;
    let y = filter.refine(y_start)?;
    let h = filter.gain(&y)?.transpose();

    let f12 = f.block((n_wf, 0), (n_y, n));
    let f2 = f.block((n_w, 0), (n_u, n));
    let h12 = h.block((0, n_zf), (n, n_u));
    let h2 = h.block((0, n_z), (n, n_y));

    // Dhat11 = -D1121 D1111ᵀ (gamma² I - D1111 D1111ᵀ)⁻¹ D1112 - D1122
    let d1111 = d11.block((0, 0), (n_zf, n_wf));
    let d1112 = d11.block((0, n_wf), (n_zf, n_y));
    let d1121 = d11.block((n_zf, 0), (n_u, n_wf));
    let inner = exact(&(DMatrix::identity(n_zf, n_zf) * gamma2))
        .minus(&d1111.times(&d1111.transpose()))
        .solve(&d1112)?;
    let dhat =
        d1121.times(&d1111.transpose().times(&inner)).plus(&d11.block((n_zf, n_wf), (n_u, n_y))).negated();

    // q' = (A + B F - Bk (C2 + F12)) q + Bk y, u = (F2 - Dhat (C2 + F12)) q + Dhat y,
    // Bk = (I - Y X / gamma²)⁻¹ (-H2 + (B2 + H12) Dhat)
    let seen = exact(&plant.c2).plus(&f12);
    let injected = exact(&plant.b2).plus(&h12).times(&dhat).minus(&h2).scale(gamma2);
    let coupling = exact(&(DMatrix::identity(n, n) * gamma2)).minus(&y.times(&x));
    let bk = coupling.solve(&injected)?;
    let ak = a.plus(&b.times(&f)).minus(&bk.times(&seen));
    let ck = f2.minus(&dhat.times(&seen));
    let sys = StateSpace::<Continuous>::new(ak.rounded(), bk.rounded(), ck.rounded(), dhat.rounded());
    Some(sys.ok()?.balanced())
}

/// `Aᵀ X + X A - X G X + Q = 0` of an H-infinity problem, with the terms that the gain needs.
struct Riccati {
    a: DoubledMatrix,
    g: DoubledMatrix,
    q: DoubledMatrix,
    r: DoubledMatrix,
    b: DoubledMatrix,
    /// `D1ᵀ C1`.
    cross: DoubledMatrix,
}

impl Riccati {
    fn new(
        a: &DoubledMatrix,
        b: &DoubledMatrix,
        c: &DoubledMatrix,
        d: &DoubledMatrix,
        gamma2: f64,
        n_w: usize,
    ) -> Option<Self> {
        let n_inputs = b.shape().1;
        let weight =
            DMatrix::from_fn(n_inputs, n_inputs, |i, j| if i == j && i < n_w { gamma2 } else { 0.0 });
        let r = d.transpose().times(d).minus(&DoubledMatrix::from(&weight));
        let cross = d.transpose().times(c);
        let (r_cross, r_b) = (r.solve(&cross)?, r.solve(&b.transpose())?);
        Some(Self {
            a: a.clone().minus(&b.times(&r_cross)),
            g: b.times(&r_b),
            q: c.transpose().times(c).minus(&cross.transpose().times(&r_cross)),
            r,
            b: b.clone(),
            cross,
        })
    }

    /// Newton steps from a solution in working precision.
    fn refine(&self, start: &DMatrix<f64>) -> Option<DoubledMatrix> {
        let mut x = DoubledMatrix::from(&((start + start.transpose()) * 0.5));
        let mut last = f64::INFINITY;
        for _ in 0..NEWTON_STEPS_MAX {
            let gx = self.g.times(&x);
            let left = x.times(&self.a);
            let residual = left.plus_transpose().plus(&self.q).minus(&x.times(&gx)).rounded();
            let closed = self.a.clone().minus(&gx).rounded();
            let step = lyapunov::continuous(&closed.transpose(), &((&residual + residual.transpose()) * 0.5))
                .ok()?
                .x;
            let size = step.norm() / x.rounded().norm().max(step.norm()).max(f64::MIN_POSITIVE);
            if !size.is_finite() || size >= 0.5 * last {
                break;
            }
            x = x.plus(&DoubledMatrix::from(&step));
            last = size;
            if size <= FULL {
                break;
            }
        }
        (last <= SETTLED || x.rounded().norm() == 0.0).then_some(x)
    }

    /// `-R⁻¹ (D1ᵀ C1 + Bᵀ X)`.
    fn gain(&self, x: &DoubledMatrix) -> Option<DoubledMatrix> {
        Some(self.r.solve(&self.cross.clone().plus(&self.b.transpose().times(x)))?.negated())
    }
}

fn beside(left: &DoubledMatrix, right: &DoubledMatrix) -> DoubledMatrix {
    let ((n_rows, n_left), (_, n_right)) = (left.shape(), right.shape());
    let mut m = DoubledMatrix::zeros(n_rows, n_left + n_right);
    m.set_block((0, 0), left);
    m.set_block((0, n_left), right);
    m
}

/// Newton steps at most.
const NEWTON_STEPS_MAX: usize = 12;
/// A relative step that leaves nothing to gain.
const FULL: f64 = 1e-26;
/// A relative step above this means that nothing was gained on working precision.
const SETTLED: f64 = 1e-8;
