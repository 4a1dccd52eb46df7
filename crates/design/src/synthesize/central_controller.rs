//! The conditions under which a gamma can be reached, and the central controller that reaches it.
//!
//! Both come from the stable subspaces `[X1; X2]` and `[Y1; Y2]` of two Hamiltonian matrices. Nothing is divided by `X1` or
//! `Y1`, so a solution `X` that is about to become infinite (the usual limit of a stable plant, whose `Y` is zero) does
//! no harm.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{DMatrix, DVector, SymmetricEigen};
use num_complex::Complex64;
use serde::{Deserialize, Serialize};
use telepulse_lti::riccati::{self, StableSubspace, Subspace};
use telepulse_lti::{Continuous, StateSpace};

use super::normalized_plant::NormalizedPlant;
use super::refined_controller::refined_controller;
use crate::Error;

/// A condition that a gamma must satisfy; the one that fails first is the one that binds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Condition {
    /// Gamma must exceed what remains of `D11` after the best static feedback (Parrott's bound).
    DirectTerm,
    /// The control Hamiltonian must have no eigenvalue on the imaginary axis.
    ControlAxis,
    /// The control Riccati solution `X` must be finite and positive semidefinite.
    ControlDefinite,
    /// The filter Hamiltonian must have no eigenvalue on the imaginary axis.
    FilterAxis,
    /// The filter Riccati solution `Y` must be finite and positive semidefinite.
    FilterDefinite,
    /// The spectral radius of `X Y` must be below `gamma²`.
    Coupling,
}

/// The two subspaces at a gamma that satisfies every condition.
pub(super) struct Feasible {
    gamma: f64,
    x: StableSubspace,
    y: StableSubspace,
    margins: Margins,
}

/// How far the smooth conditions are from their limit; positive where they hold.
#[derive(Clone, Copy)]
struct Margins {
    /// From the largest angle of `X` to a right angle, where it becomes infinite.
    control_definite: f64,
    /// The same of `Y`.
    filter_definite: f64,
    /// `1 / rho(X Y) - 1 / gamma²`, which is nearly linear in `1 / gamma²`.
    coupling: f64,
}

/// Outcome of testing one gamma.
pub(super) enum Test {
    Feasible(Box<Feasible>),
    Violated(Violation),
}

/// The first condition that a gamma was seen to violate.
pub(super) struct Violation {
    pub(super) condition: Condition,
    /// How far beyond its limit, below 0 and as in [`Feasible::margin`]; `None` for a condition that has no measure.
    pub(super) margin: Option<f64>,
    /// As `margin` for the coupling condition, followed through an infinite `X` or `Y` to where one of them is indefinite.
    pub(super) coupling: Option<f64>,
    /// Where the axis conditions fail: eigenvalues of the Hamiltonian on the axis or close to it, in rad/s and sorted.
    pub(super) frequencies: Vec<f64>,
}

impl Violation {
    fn new(condition: Condition, margin: Option<f64>) -> Self {
        Self { condition, margin, coupling: None, frequencies: Vec::new() }
    }

    fn axis(condition: Condition, eigenvalues: &[Complex64]) -> Self {
        let near = |v: &&Complex64| v.im >= 0.0 && v.re.abs() <= NEAR_AXIS * v.norm();
        let mut frequencies: Vec<f64> = eigenvalues.iter().filter(near).map(|v| v.im).collect();
        frequencies.sort_by(f64::total_cmp);
        Self { condition, margin: None, coupling: None, frequencies }
    }
}

/// Tests whether some controller reaches `gamma`.
///
/// **Method**: after the substitutions `u → u - C12 x - D112 w` and its dual, the two Hamiltonians of the general-`D11` problem
/// have definite constant terms, which need no indefinite inverse.
///
/// **Source**: Glover and Doyle 1988; Zhou, Doyle and Glover 1996, theorem 17.1.
///
/// **Errors**: those of the Schur form; a condition that fails is an answer, not an error.
pub(super) fn test(plant: &NormalizedPlant, gamma: f64) -> Result<Test, Error> {
    let violated = |condition, margin| Ok(Test::Violated(Violation::new(condition, margin)));
    if gamma <= plant.parrott_bound() {
        return violated(Condition::DirectTerm, None);
    }
    let Some(control) = ControlTerms::new(plant, gamma) else {
        return violated(Condition::DirectTerm, None);
    };
    let x = match subspace(&control.a, &control.g, &control.q)? {
        Subspace::Axis(eigenvalues) => {
            return Ok(Test::Violated(Violation::axis(Condition::ControlAxis, &eigenvalues)));
        }
        Subspace::Stable(x) => x,
    };
    let Some(filter) = FilterTerms::new(plant, gamma) else {
        return violated(Condition::DirectTerm, None);
    };
    let y = match subspace(&filter.a, &filter.g, &filter.q)? {
        Subspace::Axis(eigenvalues) => {
            return Ok(Test::Violated(Violation::axis(Condition::FilterAxis, &eigenvalues)));
        }
        Subspace::Stable(y) => y,
    };
    let (control_definite, filter_definite) = (definite_margin(&x), definite_margin(&y));
    let coupling = match (control_definite < 0.0, filter_definite < 0.0) {
        (true, true) => None,
        (false, false) => extreme_of_product(&x, &y).map(|extremes| extremes.highest),
        (true, false) => extreme_of_product(&x, &y).map(Extremes::passed),
        (false, true) => extreme_of_product(&y, &x).map(Extremes::passed),
    }
    .map(|extreme| 1.0 / extreme - 1.0 / (gamma * gamma));
    let violation =
        |condition, margin| Ok(Test::Violated(Violation { coupling, ..Violation::new(condition, margin) }));
    if control_definite < 0.0 {
        return violation(Condition::ControlDefinite, Some(control_definite));
    }
    if filter_definite < 0.0 {
        return violation(Condition::FilterDefinite, Some(filter_definite));
    }
    match coupling {
        Some(coupling) if coupling > 0.0 => {
            let margins = Margins { control_definite, filter_definite, coupling };
            Ok(Test::Feasible(Box::new(Feasible { gamma, x: *x, y: *y, margins })))
        }
        _ => violation(Condition::Coupling, coupling),
    }
}

impl Feasible {
    /// How far this gamma is from the limit that the condition sets; `None` for a condition that has no measure.
    pub(super) fn margin(&self, condition: Condition) -> Option<f64> {
        match condition {
            Condition::ControlDefinite => Some(self.margins.control_definite),
            Condition::FilterDefinite => Some(self.margins.filter_definite),
            Condition::Coupling => Some(self.margins.coupling),
            Condition::DirectTerm | Condition::ControlAxis | Condition::FilterAxis => None,
        }
    }

    /// A gamma that no controller reaches, by `rho(X Y)` here: the radius only grows as gamma becomes smaller.
    ///
    /// Lowered by what rounding may have done to solutions of this size; 0 where that leaves nothing.
    pub(super) fn coupling_floor(&self) -> f64 {
        let Margins { control_definite, filter_definite, coupling } = self.margins;
        let slack = FLOOR_ROUNDING * f64::EPSILON * (1.0 / control_definite + 1.0 / filter_definite);
        let floor = (1.0 - slack) / (coupling + 1.0 / (self.gamma * self.gamma)).sqrt();
        if slack < 1.0 && floor.is_finite() { floor } else { 0.0 }
    }

    /// The gamma that equals `rho(X Y)` here, with `X` and `Y` refined by Newton steps on residuals in doubled precision.
    ///
    /// Below the smallest reachable gamma where it is below this one, else above; `None` where the refinement has no answer.
    pub(super) fn refined_radius(&self, plant: &NormalizedPlant) -> Option<f64> {
        let (control, filter) = (ControlTerms::new(plant, self.gamma)?, FilterTerms::new(plant, self.gamma)?);
        let x = riccati::continuous(&control.a, &control.g, &control.q).ok()?.x;
        let y = riccati::continuous(&filter.a, &filter.g, &filter.q).ok()?.x;
        // As balanced as the subspace of Y was.
        let dual = self.y.scaling.map(|d| 1.0 / d);
        Some(extremes(&scaled(&x, &dual), scaled(&y, &self.y.scaling)).highest.sqrt())
    }

    /// Returns the central controller of the normalized plant.
    ///
    /// **Method**: Theorem 17.1 of Zhou, Doyle and Glover in the coordinates `x = X1 q`:
    ///
    /// ```text
    ///     q' = T q + E⁻¹ L (y - (C2 + F12) X1 q)       E = Y1ᵀ X1 - Y2ᵀ X2 / gamma²
    ///     u  = F2 X1 q + Dhat11 (y - (C2 + F12) X1 q)   L = Y1ᵀ (-H2 + (B2 + H12) Dhat11)
    /// ```
    ///
    /// where `T` is the restriction of the control Hamiltonian. At the optimum `E` becomes singular.
    ///
    /// **Errors**: [`Error::IllConditioned`] where `E` is singular to working precision.
    pub(super) fn controller(&self, plant: &NormalizedPlant) -> Result<StateSpace<Continuous>, Error> {
        let gamma = self.gamma;
        let lost = || Error::IllConditioned { gamma, achieved: f64::INFINITY };
        let control = ControlTerms::new(plant, gamma).ok_or_else(lost)?;
        let filter = FilterTerms::new(plant, gamma).ok_or_else(lost)?;
        let (n_zf, n_u, n_wf, n_y) = (plant.n_z_free(), plant.n_u(), plant.n_w_free(), plant.n_y());
        let (x1, x2) = bases(&self.x);
        let (y1, y2) = bases(&self.y);

        // F1 X1 (worst disturbance) and F2 X1 (control).
        let f1 = &control.rw_inverse * (control.b1.tr_mul(&x2) + control.du.tr_mul(&(&control.c11 * &x1)));
        let f2 = -(plant.c1.rows(n_zf, n_u) * &x1) - &control.d112 * &f1 - plant.b2.tr_mul(&x2);
        // Y1ᵀ H1 and Y1ᵀ H2.
        let h1 = (y2.tr_mul(&filter.c1.transpose()) + y1.tr_mul(&filter.b11) * filter.dl.transpose())
            * &filter.rz_inverse;
        let h2 = -(y1.tr_mul(&plant.b1.columns(n_wf, n_y)))
            - &h1 * &filter.d112
            - y2.tr_mul(&plant.c2.transpose());

        // Dhat11 = -D1121 D1111ᵀ (gamma² I - D1111 D1111ᵀ)⁻¹ D1112 - D1122
        let d1111 = plant.d11_quarter(false, false);
        let r = DMatrix::identity(n_zf, n_zf) * (gamma * gamma) - &d1111 * d1111.transpose();
        let d1112 = plant.d11_quarter(false, true);
        let inner = if d1112.is_empty() { d1112 } else { r.lu().solve(&d1112).ok_or_else(lost)? };
        let mut dhat =
            -(plant.d11_quarter(true, false) * d1111.transpose() * inner) - plant.d11_quarter(true, true);
        // Rounding of the rotations must not turn a strictly proper controller into one with zeros near infinity.
        let rounding = 4.0 * f64::EPSILON * plant.d11.norm();
        dhat.apply(|v| *v = if v.abs() <= rounding { 0.0 } else { *v });

        let e = y1.tr_mul(&x1) - y2.tr_mul(&x2) / (gamma * gamma);
        let l = -h2 + (y1.tr_mul(&plant.b2) + h1.columns(n_zf, n_u)) * &dhat;
        let Coordinates { to, from, bk } = coordinates(e, l).ok_or_else(lost)?;
        let seen = &plant.c2 * &x1 + f1.rows(n_wf, n_y);
        let ck = (f2 - &dhat * &seen) * &from;
        let ak = to * &self.x.restriction * &from - &bk * (seen * from);
        Ok(StateSpace::<Continuous>::new(ak, bk, ck, dhat)?.balanced())
    }

    /// Returns the same controller by way of [`refined_controller`]; `None` where `X` or `Y` is infinite or cannot be refined.
    pub(super) fn refined(&self, plant: &NormalizedPlant) -> Option<StateSpace<Continuous>> {
        let (x, y) = (self.x.solution().ok()?, self.y.solution().ok()?);
        refined_controller(plant, self.gamma, &x, &y)
    }

    /// Larger isotropy error of the two subspaces, a measure of their rounding.
    pub(super) fn isotropy_error(&self) -> f64 {
        self.x.isotropy_error.max(self.y.isotropy_error)
    }
}

/// Terms of `X`: `u` has been substituted so that it no longer meets `D11` and `C1`.
struct ControlTerms {
    a: DMatrix<f64>,
    g: DMatrix<f64>,
    q: DMatrix<f64>,
    b1: DMatrix<f64>,
    c11: DMatrix<f64>,
    du: DMatrix<f64>,
    d112: DMatrix<f64>,
    rw_inverse: DMatrix<f64>,
}

impl ControlTerms {
    /// `None` where `gamma² I - Duᵀ Du` is not positive definite.
    fn new(plant: &NormalizedPlant, gamma: f64) -> Option<Self> {
        let (n_zf, n_u, n_w) = (plant.n_z_free(), plant.n_u(), plant.b1.ncols());
        let c11 = plant.c1.rows(0, n_zf).into_owned();
        let du = plant.d11.rows(0, n_zf).into_owned();
        let d112 = plant.d11.rows(n_zf, n_u).into_owned();
        let b1 = &plant.b1 - &plant.b2 * &d112;
        let rw = DMatrix::identity(n_w, n_w) * (gamma * gamma) - du.tr_mul(&du);
        let rw_inverse = rw.cholesky()?.inverse();
        let feedthrough = &du * &rw_inverse;
        let a = &plant.a - &plant.b2 * plant.c1.rows(n_zf, n_u) + &b1 * feedthrough.transpose() * &c11;
        let g = &plant.b2 * plant.b2.transpose() - &b1 * &rw_inverse * b1.transpose();
        let weight = DMatrix::identity(n_zf, n_zf) + feedthrough * du.transpose();
        let q = c11.tr_mul(&(weight * &c11));
        Some(Self { a, g: symmetric(&g), q: symmetric(&q), b1, c11, du, d112, rw_inverse })
    }
}

/// Terms of `Y`, the dual of [`ControlTerms`].
struct FilterTerms {
    a: DMatrix<f64>,
    g: DMatrix<f64>,
    q: DMatrix<f64>,
    b11: DMatrix<f64>,
    c1: DMatrix<f64>,
    dl: DMatrix<f64>,
    d112: DMatrix<f64>,
    rz_inverse: DMatrix<f64>,
}

impl FilterTerms {
    /// `None` where `gamma² I - Dl Dlᵀ` is not positive definite.
    fn new(plant: &NormalizedPlant, gamma: f64) -> Option<Self> {
        let (n_wf, n_y, n_z) = (plant.n_w_free(), plant.n_y(), plant.c1.nrows());
        let b11 = plant.b1.columns(0, n_wf).into_owned();
        let dl = plant.d11.columns(0, n_wf).into_owned();
        let d112 = plant.d11.columns(n_wf, n_y).into_owned();
        let c1 = &plant.c1 - &d112 * &plant.c2;
        let rz = DMatrix::identity(n_z, n_z) * (gamma * gamma) - &dl * dl.transpose();
        let rz_inverse = rz.cholesky()?.inverse();
        let feedthrough = &rz_inverse * &dl;
        let a = &plant.a - plant.b1.columns(n_wf, n_y) * &plant.c2 + &b11 * feedthrough.transpose() * &c1;
        let g = plant.c2.tr_mul(&plant.c2) - c1.tr_mul(&(&rz_inverse * &c1));
        let weight = DMatrix::identity(n_wf, n_wf) + dl.tr_mul(&feedthrough);
        let q = &b11 * weight * b11.transpose();
        Some(Self { a: a.transpose(), g: symmetric(&g), q: symmetric(&q), b11, c1, dl, d112, rz_inverse })
    }
}

fn symmetric(m: &DMatrix<f64>) -> DMatrix<f64> {
    (m + m.transpose()) * 0.5
}

/// The stable subspace; inseparable eigenvalues next to the axis leave none either.
fn subspace(a: &DMatrix<f64>, g: &DMatrix<f64>, q: &DMatrix<f64>) -> Result<Subspace, Error> {
    match StableSubspace::search(a, g, q) {
        Err(telepulse_lti::Error::SwapFailed { .. }) => Ok(Subspace::Axis(Vec::new())),
        other => Ok(other?),
    }
}

/// Both halves of the basis in the plant's coordinates.
fn bases(s: &StableSubspace) -> (DMatrix<f64>, DMatrix<f64>) {
    let mut upper = s.x1.clone();
    let mut lower = s.x2.clone();
    for (i, &scale) in s.scaling.iter().enumerate() {
        upper.row_mut(i).scale_mut(scale);
        lower.row_mut(i).unscale_mut(scale);
    }
    (upper, lower)
}

/// From the largest angle to a right angle, where the solution becomes infinite; below 0 where an angle has gone beyond it
/// and come back as a negative one, which means an indefinite solution.
fn definite_margin(s: &StableSubspace) -> f64 {
    let angles = s.angles();
    let smallest = angles.iter().copied().fold(f64::INFINITY, f64::min);
    if smallest > -ZERO_ANGLE {
        FRAC_PI_2 - angles.iter().copied().fold(0.0, f64::max)
    } else {
        -(FRAC_PI_2 + smallest).max(f64::MIN_POSITIVE)
    }
}

/// The lowest and the highest eigenvalue of `X Y`, the latter not below 0.
struct Extremes {
    lowest: f64,
    highest: f64,
}

impl Extremes {
    /// The eigenvalue that has passed through infinity where `X` has, else the spectral radius.
    fn passed(self) -> f64 {
        // Below rounding of zero there is nothing that has passed.
        if self.lowest < -PASSED * self.highest { self.lowest } else { self.highest }
    }
}

/// Eigenvalues of `X Y` for a positive semidefinite `Y`; `None` where one of them is infinite.
fn extreme_of_product(x: &StableSubspace, y: &StableSubspace) -> Option<Extremes> {
    if x.x1.is_empty() {
        return Some(Extremes { lowest: 0.0, highest: 0.0 });
    }
    // X Y is similar to Xb W Yb W with W = Dx⁻¹ Dy⁻¹ (Y lives on the dual coordinates).
    let w = x.scaling.zip_map(&y.scaling, |dx, dy| 1.0 / (dx * dy));
    Some(extremes(&scaled(&balanced_solution(x)?, &w), balanced_solution(y)?))
}

/// `diag(d) M diag(d)`.
fn scaled(m: &DMatrix<f64>, d: &DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(m.nrows(), m.ncols(), |i, j| d[i] * m[(i, j)] * d[j])
}

/// [`extreme_of_product`] of matrices that are of like size in all their entries.
fn extremes(x: &DMatrix<f64>, y: DMatrix<f64>) -> Extremes {
    let eigen = SymmetricEigen::new(y);
    let mut root = eigen.eigenvectors;
    for (mut column, value) in root.column_iter_mut().zip(eigen.eigenvalues.iter()) {
        column.scale_mut(value.max(0.0).sqrt());
    }
    let eigenvalues = symmetric(&root.tr_mul(&(x * &root))).symmetric_eigenvalues();
    Extremes { lowest: eigenvalues.min(), highest: eigenvalues.max().max(0.0) }
}

fn balanced_solution(s: &StableSubspace) -> Option<DMatrix<f64>> {
    let xt = s.x1.transpose().lu().solve(&s.x2.transpose())?;
    xt.iter().all(|v| v.is_finite()).then(|| symmetric(&xt))
}

/// States in which a nearly singular `E` makes few rows of the controller large instead of all.
struct Coordinates {
    /// New states from old, `n × n`.
    to: DMatrix<f64>,
    from: DMatrix<f64>,
    /// `E⁻¹ L` in the new states.
    bk: DMatrix<f64>,
}

/// Solves `E X = L` by singular values, after rows and columns have been scaled to like size; `None` where `E` is singular.
///
/// With `E = R U S Vᵀ C` (`R` and `C` diagonal) the new states are `Vᵀ C q`, in which `E⁻¹ L` is `S⁻¹ Uᵀ R⁻¹ L`: each small singular
/// value makes one state fast, and the slow ones are not differences of large numbers.
fn coordinates(mut e: DMatrix<f64>, mut l: DMatrix<f64>) -> Option<Coordinates> {
    let n = e.nrows();
    if n == 0 {
        return Some(Coordinates { to: e.clone(), from: e, bk: l });
    }
    for i in 0..n {
        let size = e.row(i).amax();
        if size == 0.0 || !size.is_finite() {
            return None;
        }
        e.row_mut(i).unscale_mut(size);
        l.row_mut(i).unscale_mut(size);
    }
    let sizes: Vec<f64> = e.column_iter().map(|column| column.amax()).collect();
    for (mut column, size) in e.column_iter_mut().zip(&sizes) {
        column.unscale_mut(*size);
    }
    if e.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let svd = e.svd(true, true);
    let mut to = svd.v_t?;
    let mut from = to.transpose();
    let mut bk = svd.u?.tr_mul(&l);
    for (mut row, value) in bk.row_iter_mut().zip(svd.singular_values.iter()) {
        row.unscale_mut(*value);
    }
    for (k, size) in sizes.iter().enumerate() {
        to.column_mut(k).scale_mut(*size);
        from.row_mut(k).unscale_mut(*size);
    }
    [&bk, &to, &from].iter().all(|m| m.iter().all(|v| v.is_finite())).then_some(Coordinates { to, from, bk })
}

/// An angle this little below zero is a zero of `X` seen through rounding.
const ZERO_ANGLE: f64 = 1e-7;
/// Eigenvalues this close to the axis, relative to their size, are taken for crossings that rounding has moved.
const NEAR_AXIS: f64 = 1e-4;
/// Units of the machine precision, times the size of the solutions, that `rho(X Y)` may be off.
const FLOOR_ROUNDING: f64 = 1e3;
/// Part of the largest eigenvalue of `X Y` below which a negative one is rounding.
const PASSED: f64 = 1e-6;
