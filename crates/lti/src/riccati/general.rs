//! Continuous and discrete Riccati equations in the general form, with cross term and terms of any definiteness.

use nalgebra::DMatrix;
use num_complex::Complex64;

use super::iterations::{doubling, sign};
use super::pencil;
use super::refinement::{Candidate, Scaled};
use super::stabilizability::unreached_mode;
use crate::Error;
use crate::hessenberg::check_square_and_finite;
use crate::lyapunov::check_symmetric;
use crate::triangular_equation::Kind;

/// The matrices of a Riccati equation.
///
/// **Shapes and units**: `a`, `q`: `n × n`; `b`, `s`: `n × m`; `r`: `m × m`. `q` and `r` symmetric, any definiteness.
#[derive(Clone, Copy, Debug)]
pub struct Terms<'a> {
    /// State matrix.
    pub a: &'a DMatrix<f64>,
    /// Input matrix.
    pub b: &'a DMatrix<f64>,
    /// Weight of the states.
    pub q: &'a DMatrix<f64>,
    /// Weight of the inputs.
    pub r: &'a DMatrix<f64>,
    /// Weight of the products of states and inputs; zero where absent.
    pub s: Option<&'a DMatrix<f64>>,
}

/// The way on which a solution was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Route {
    /// Ordered Schur form of the Hamiltonian matrix.
    Schur,
    /// Extended pencil, which needs no inverse of `R` (nor of `A` in discrete time), then an ordered Schur form.
    Pencil,
    /// Matrix sign function of the Hamiltonian matrix.
    Sign,
    /// Structure-preserving doubling.
    Doubling,
}

/// When the second route (sign function or doubling) is taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SecondRoute {
    /// Where the first one failed, left a residual above 1e-12, or shows a condition above 1e10.
    #[default]
    IfNeeded,
    /// Always, as a cross-check.
    Always,
}

/// The stabilizing solution of a Riccati equation and the evidence for it.
#[derive(Clone, Debug, PartialEq)]
pub struct GeneralSolution {
    /// The symmetric solution `X`, `n × n`.
    pub x: DMatrix<f64>,
    /// The feedback `K` of `u = -K x`, `m × n`: `R⁻¹ (Bᵀ X + Sᵀ)`, or `(R + Bᵀ X B)⁻¹ (Bᵀ X A + Sᵀ)`.
    pub gain: DMatrix<f64>,
    /// Eigenvalues of `A - B K`: left of the axis, in rad/s, or within the unit circle.
    pub closed_loop_poles: Vec<Complex64>,
    /// Frobenius norm of the equation's left-hand side, evaluated in doubled precision and balanced coordinates, over the
    /// sum of the norms of its terms.
    pub residual_relative: f64,
    /// Estimate, from above, of the separation of the closed loop: the least norm of `Cᵀ N + N C` (or `Cᵀ N C - N`) with
    /// `C = A - B K` over symmetric `N` of norm one, in balanced coordinates.
    pub separation: f64,
    /// Estimate of the relative change of `X` over a relative change of the terms.
    pub condition: f64,
    /// The route that left the smaller residual.
    pub route: Route,
    /// Norm of the difference of the two routes over that of the solution, where both gave one.
    pub route_difference: Option<f64>,
    /// Newton corrections that were accepted.
    pub n_newton_steps: usize,
}

/// Returns the stabilizing solution of `Aᵀ X + X A - (X B + S) R⁻¹ (Bᵀ X + Sᵀ) + Q = 0`.
///
/// **Shapes and units**: see [`Terms`].
///
/// **Method**: states balanced symplectically and inputs by the diagonal of `R`, all by powers of two. Ordered Schur form
/// of the Hamiltonian matrix; where `R` is nearly singular, of a Cayley transform of the extended pencil. Then Newton
/// steps on a residual in doubled precision, each kept only where it lowers the residual and leaves the loop stable. The
/// matrix sign function is the second route.
///
/// **Source**: Laub 1979; van Dooren 1981 for the pencil; Roberts 1980 and Byers 1987 for the sign function; Kenney and
/// Hewer 1990 for the condition.
///
/// **Accuracy**: see the fields of [`GeneralSolution`]; a solution with a residual above 1e-8 is not returned.
///
/// **Errors**: [`Error::NotStabilizable`], [`Error::HamiltonianAxis`], [`Error::NoStabilizingSolution`],
/// [`Error::Singular`] for `r`, [`Error::RiccatiIllConditioned`], [`Error::RiccatiNotConverged`], and those of wrong
/// input.
///
/// **Example**
/// ```
/// use nalgebra::dmatrix;
/// use telepulse_lti::riccati::{SecondRoute, Terms, care};
/// // -2 x + 2 - (x + 1)² = 0, so x = sqrt(5) - 2.
/// let (a, one, q) = (dmatrix![-1.0], dmatrix![1.0], dmatrix![2.0]);
/// let terms = Terms { a: &a, b: &one, q: &q, r: &one, s: Some(&one) };
/// let solution = care(&terms, SecondRoute::Always)?;
/// assert!((solution.x[(0, 0)] - (5.0_f64.sqrt() - 2.0)).abs() < 1e-15);
/// assert!(solution.route_difference.is_some_and(|d| d < 1e-15));
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn care(terms: &Terms<'_>, second: SecondRoute) -> Result<GeneralSolution, Error> {
    solve(terms, second, Kind::Continuous)
}

/// Returns the stabilizing solution of `Aᵀ X A - X - (Aᵀ X B + S) (R + Bᵀ X B)⁻¹ (Bᵀ X A + Sᵀ) + Q = 0`.
///
/// **Shapes and units**: see [`Terms`]. Neither `A` nor `R` needs an inverse, `R + Bᵀ X B` does.
///
/// **Method**: as [`care`]. The extended symplectic pencil is freed of its inputs by an orthogonal transformation and
/// taken to a Hamiltonian matrix by the bilinear map at 1 or -1, whichever is farther from its eigenvalues.
/// Structure-preserving doubling is the second route, where `R` has an inverse.
///
/// **Source**: Pappas, Laub and Sandell 1980; van Dooren 1981; Chu, Fan, Lin and Wang 2004 for doubling.
///
/// **Accuracy**: as [`care`].
///
/// **Errors**: as [`care`], with [`Error::SymplecticCircle`] for eigenvalues on the unit circle.
///
/// **Example**
/// ```
/// use nalgebra::dmatrix;
/// use telepulse_lti::riccati::{SecondRoute, Terms, dare};
/// // x - x - x² / (1 + x) + 1 = 0: the golden ratio.
/// let one = dmatrix![1.0];
/// let terms = Terms { a: &one, b: &one, q: &one, r: &one, s: None };
/// let solution = dare(&terms, SecondRoute::IfNeeded)?;
/// assert!((solution.x[(0, 0)] - 1.618_033_988_749_895).abs() < 1e-15);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn dare(terms: &Terms<'_>, second: SecondRoute) -> Result<GeneralSolution, Error> {
    solve(terms, second, Kind::Discrete)
}

fn solve(terms: &Terms<'_>, second: SecondRoute, kind: Kind) -> Result<GeneralSolution, Error> {
    check(terms)?;
    let equation = Scaled::new(terms, kind);
    let first = first_route(&equation);
    let sound =
        |(_, c): &(Route, Candidate)| c.residual_relative <= SOUND_RESIDUAL && c.condition <= SOUND_CONDITION;
    let other = if second == SecondRoute::Always || !first.as_ref().is_ok_and(sound) {
        Some(second_route(&equation))
    } else {
        None
    };
    let (best, difference) = match (first, other) {
        (Ok(first), Some(Ok(other))) => {
            let difference = (&first.1.x - &other.1.x).norm() / first.1.x.norm().max(f64::MIN_POSITIVE);
            let best = if other.1.residual_relative < first.1.residual_relative { other } else { first };
            (best, Some(difference))
        }
        (Ok(found), _) | (Err(_), Some(Ok(found))) => (found, None),
        (Err(error), _) => return Err(unreached_mode(&equation).unwrap_or(error)),
    };
    let (route, candidate) = best;
    if candidate.residual_relative.is_nan() || candidate.residual_relative > ACCEPTED_RESIDUAL {
        let Candidate { residual_relative, condition, .. } = candidate;
        let error = Error::RiccatiIllConditioned { residual_relative, condition };
        return Err(unreached_mode(&equation).unwrap_or(error));
    }
    let (x, gain) = equation.unscale(&candidate);
    if x.iter().chain(gain.iter()).any(|v| !v.is_finite()) {
        return Err(Error::Overflow { operation: "the solution of a riccati equation" });
    }
    Ok(GeneralSolution {
        x,
        gain,
        closed_loop_poles: candidate.poles,
        residual_relative: candidate.residual_relative,
        separation: candidate.separation,
        condition: candidate.condition,
        route,
        route_difference: difference,
        n_newton_steps: candidate.n_newton_steps,
    })
}

fn first_route(equation: &Scaled) -> Result<(Route, Candidate), Error> {
    if equation.kind == Kind::Continuous
        && let Some(reduced) = equation.without_inputs(REGULAR_INPUTS)
    {
        let subspace = super::StableSubspace::new(&reduced.a, &reduced.g, &reduced.q)?;
        if let Ok(found) = subspace.solution().and_then(|x| equation.refine(x)) {
            return Ok((Route::Schur, found));
        }
    }
    let x = match equation.kind {
        Kind::Continuous => pencil::continuous(equation)?,
        Kind::Discrete => pencil::discrete(equation)?,
    };
    Ok((Route::Pencil, equation.refine(x)?))
}

fn second_route(equation: &Scaled) -> Result<(Route, Candidate), Error> {
    let singular = Error::Singular { matrix: "r", reciprocal_condition: equation.reciprocal_condition_r };
    let reduced = equation.without_inputs(f64::EPSILON).ok_or(singular)?;
    Ok(match equation.kind {
        Kind::Continuous => (Route::Sign, equation.refine(sign(&reduced)?)?),
        Kind::Discrete => (Route::Doubling, equation.refine(doubling(reduced)?)?),
    })
}

fn check(terms: &Terms<'_>) -> Result<(), Error> {
    check_square_and_finite("a", terms.a)?;
    let n = terms.a.nrows();
    let m = terms.b.ncols();
    let mut parts = vec![("b", terms.b, (n, m)), ("q", terms.q, (n, n)), ("r", terms.r, (m, m))];
    parts.extend(terms.s.map(|s| ("s", s, (n, m))));
    for (matrix, found, (expected_rows, expected_cols)) in parts {
        let (rows, cols) = found.shape();
        if (rows, cols) != (expected_rows, expected_cols) {
            return Err(Error::Shape { matrix, expected_rows, expected_cols, rows, cols });
        }
        if let Some((index, &value)) = found.iter().enumerate().find(|(_, v)| !v.is_finite()) {
            return Err(Error::NotFinite { quantity: matrix, index, value });
        }
    }
    check_symmetric("q", terms.q)?;
    check_symmetric("r", terms.r)
}

/// Below this reciprocal condition the inverse of `R` loses digits that the extended pencil keeps.
const REGULAR_INPUTS: f64 = 1e-8;
/// A solution whose residual and condition are below these needs no second opinion.
const SOUND_RESIDUAL: f64 = 1e-12;
const SOUND_CONDITION: f64 = 1e10;
/// A larger relative residual is no solution.
const ACCEPTED_RESIDUAL: f64 = 1e-8;
