//! A family of measured responses as one nominal response and a weight: unstructured uncertainty.

use nalgebra::DMatrix;
use num_complex::Complex64;
use telepulse_lti::{Continuous, FrequencyResponse, StateSpace, TransferFunction};

use super::certified_touch::{Segment, largest_excess};
use super::envelope::{ErrorCurve, envelope};
use super::magnitude_design::{BoundShape, ORDER_MAX, cover_magnitude};
use super::minimum_phase::MinimumPhase;
use crate::{Error, Result};

/// How a member `G_k` of the family differs from the nominal `G`; `|Delta| <= 1` at every frequency.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum UncertaintyForm {
    /// `G_k = G + W Delta`.
    #[default]
    Additive,
    /// `G_k = G (I + Delta W)`: at the inputs of the plant.
    InputMultiplicative,
    /// `G_k = (I + W Delta) G`: at its outputs.
    OutputMultiplicative,
}

/// What is known about an error between two measured frequencies.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Between {
    /// It is straight in log-log coordinates, as drawn in a Bode diagram.
    #[default]
    Straight,
    /// It rises and falls by at most this power of the frequency (2: by 40 dB a decade), so it may be larger
    /// between two points than at either of them.
    Slope(f64),
}

/// One weight for all channels, or one for each.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum WeightStructure {
    /// `W = w I`, over the largest singular value of the error.
    #[default]
    Scalar,
    /// `W = diag(w_1, w_2, ..)`: one weight for each output of an additive or output error, each input of an input error.
    Diagonal,
}

/// Number of poles of each weight.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OrderChoice {
    /// This many, 0 to [`ORDER_MAX`].
    Fixed(usize),
    /// The smallest number up to this one whose looseness, as a logarithm, is within a tenth, plus two percent, of the
    /// least among all of them.
    UpTo(usize),
}

/// How to bound a family.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FamilyOptions {
    /// Which error is bounded.
    pub form: UncertaintyForm,
    /// One weight or several.
    pub structure: WeightStructure,
    /// Poles of each weight.
    pub order: OrderChoice,
    /// Poles in excess of zeros; 0 holds the last error above the measured range.
    pub relative_degree: usize,
    /// What is assumed between the points.
    pub between: Between,
    /// The weight lies above the largest error by at least this factor, 1 or more.
    pub margin: f64,
    /// A weight is compared with the largest error within this factor of a frequency, 1 or more. Above 1, narrow nulls of the error do
    /// not draw zeros to them.
    pub neighbourhood: f64,
}

impl Default for FamilyOptions {
    /// Additive, one biproper weight of up to fourth order, straight between the points, compared within a third of an octave.
    fn default() -> Self {
        Self {
            form: UncertaintyForm::default(),
            structure: WeightStructure::default(),
            order: OrderChoice::UpTo(4),
            relative_degree: 0,
            between: Between::default(),
            margin: 1.001,
            neighbourhood: 1.26,
        }
    }
}

/// One stable, minimum-phase weight, with the evidence for it.
#[derive(Debug, Clone, PartialEq)]
pub struct FamilyWeight {
    /// The weight.
    pub weight: TransferFunction,
    /// Largest ratio of error to weight over all points and everything between them, a proven upper bound; at most
    /// `1 / margin`.
    pub worst_ratio: f64,
    /// Where it occurs, in rad/s.
    pub worst_omega_rad_s: f64,
    /// Largest ratio of weight to the envelope of the errors over the measured range.
    pub loosest_ratio: f64,
    /// The same against the largest error in the neighbourhood, which the design makes small.
    pub design_ratio: f64,
    /// `design_ratio` of each order that was tried, from 0 (or the one asked for) upwards; `None` where none was found.
    pub ratio_of_order: Vec<(usize, Option<f64>)>,
    /// The envelope of the errors: measured frequencies in rad/s and the largest error there.
    pub envelope: Vec<(f64, f64)>,
}

/// A family as uncertainty around a nominal response.
#[derive(Debug, Clone, PartialEq)]
pub struct FamilyCover {
    /// What was asked for.
    pub options: FamilyOptions,
    /// One weight, or one for each channel.
    pub weights: Vec<FamilyWeight>,
    /// Channels on which the weight acts.
    pub n_channels: usize,
}

impl FamilyCover {
    /// `W` as a system with `n_channels` inputs and outputs.
    ///
    /// # Errors
    /// Those of building a system.
    pub fn weight_system(&self) -> Result<StateSpace<Continuous>> {
        let of_channel =
            |channel: usize| self.weights[channel.min(self.weights.len() - 1)].weight.to_state_space();
        let mut all = of_channel(0);
        for channel in 1..self.n_channels {
            all = all.augment(&of_channel(channel))?;
        }
        Ok(all)
    }
}

/// Returns weights that cover the error between a nominal system and every member of a family of measured responses.
///
/// **Shapes and units**: all responses `n_y × n_u`, each on a grid of its own in rad/s, above zero.
///
/// **Method**: the error matrix of the form asked for at each measured point; its largest singular value is one curve for each
/// member. For diagonal weights, row `i` (column, for an input error) of size `r_i` asks for `e_i = s r_i` with
/// `s = norm(diag(1/r) E)`, since `norm(diag(1/w) E) <= norm(diag(1/e) E) = 1` for all `w >= e`. Each curve is continued between its points as
/// [`Between`] says, a weight is designed over the upper envelope (see [`super::cap_family_error`]), and then scaled to
/// touch it; the touch is proven by branch and bound, without a grid.
///
/// **Accuracy**: what holds between two points follows from [`Between`], which is an assumption about the device. Outside of the measured
/// range nothing is known.
///
/// # Errors
/// [`Error::EmptyList`] without responses, [`Error::FamilyShape`], [`Error::FamilyNotFinite`], [`Error::FamilyGrid`] for responses that do not fit, [`Error::NominalNotInvertible`] for a
/// multiplicative error where `G` has no inverse on its side, [`Error::CoverNoError`], [`Error::CoverInfeasible`],
/// [`Error::OutOfRange`] for options.
///
/// # Example
/// ```
/// use telepulse_design::identify::{FamilyOptions, OrderChoice, cover_family};
/// use telepulse_lti::TransferFunction;
/// let nominal = TransferFunction::new(&[1.0], &[1.0, 1.0])?;
/// let omegas: Vec<f64> = (0..40).map(|k| 0.01 * 10_f64.powf(f64::from(k) / 10.0)).collect();
/// let slower = TransferFunction::new(&[1.0], &[1.3, 1.0])?.frequency_response(&omegas)?;
/// let options = FamilyOptions { order: OrderChoice::Fixed(2), ..FamilyOptions::default() };
/// let cover = cover_family(&nominal.to_state_space(), &[slower], &options)?;
/// assert!(cover.weights[0].worst_ratio <= 1.0);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
pub fn cover_family(
    nominal: &StateSpace<Continuous>,
    family: &[FrequencyResponse],
    options: &FamilyOptions,
) -> Result<FamilyCover> {
    let at = |omega: f64| Ok(nominal.at(omega)?);
    cover_family_around(at, (nominal.n_outputs(), nominal.n_inputs()), family, options)
}

/// As [`cover_family`], around any nominal response, for instance a measured one ([`central_response`]).
///
/// # Errors
/// As [`cover_family`], and those of `nominal`, which is asked for the response at every measured frequency.
pub fn cover_family_around(
    nominal: impl Fn(f64) -> Result<DMatrix<Complex64>>,
    shape: (usize, usize),
    family: &[FrequencyResponse],
    options: &FamilyOptions,
) -> Result<FamilyCover> {
    check(options, family, shape)?;
    let n_channels = if options.form == UncertaintyForm::InputMultiplicative { shape.1 } else { shape.0 };
    let n_weights = if options.structure == WeightStructure::Scalar { 1 } else { n_channels };
    // errors[weight][member] is a curve.
    let mut errors: Vec<Vec<Vec<(f64, f64)>>> = vec![vec![Vec::new(); family.len()]; n_weights];
    let mut differs = false;
    for (member_idx, member) in family.iter().enumerate() {
        for (&omega, value) in member.omega_rad_s.iter().zip(&member.values) {
            let nominal = nominal(omega)?;
            differs |= (value - &nominal).norm() > DIFFERENCE_MIN * value.norm().max(nominal.norm());
            let mut error = error_matrix(options.form, &nominal, value, omega)?;
            if options.form == UncertaintyForm::InputMultiplicative {
                // Delta W: the weight acts on columns.
                error = error.transpose();
            }
            for (weight_idx, size) in sizes(&error, options.structure).into_iter().enumerate() {
                errors[weight_idx][member_idx].push((omega, size));
            }
        }
    }
    if !differs {
        return Err(Error::CoverNoError);
    }
    let weights = errors.into_iter().map(|curves| cover_curves(curves, options)).collect::<Result<_>>()?;
    Ok(FamilyCover { options: *options, weights, n_channels })
}

/// The centre of a family: at each frequency and entry, the centre of the smallest circle around all members.
///
/// **Method**: Welzl's move to the boundary, exact for the two or three points that hold the circle. Entry by entry it makes the largest
/// additive error as small as any nominal response can; for a matrix it is the centre of each entry, not of the largest
/// singular value.
///
/// # Errors
/// [`Error::EmptyList`], [`Error::FamilyShape`], [`Error::FamilyNotFinite`], [`Error::FamilyGrid`] unless all members share
/// one grid.
pub fn central_response(family: &[FrequencyResponse]) -> Result<FrequencyResponse> {
    let first = family.first().ok_or(Error::EmptyList { key: "family" })?;
    let shape = first.values.first().ok_or(Error::EmptyList { key: "family" })?.shape();
    check_members(family, shape)?;
    if let Some(member_idx) = family.iter().position(|m| m.omega_rad_s != first.omega_rad_s) {
        return Err(Error::FamilyGrid { member_idx, expected: "the same frequencies as the first" });
    }
    let centre = |k: usize| {
        DMatrix::from_fn(shape.0, shape.1, |i, j| {
            let points: Vec<Complex64> = family.iter().map(|m| m.values[k][(i, j)]).collect();
            smallest_circle(&points).centre
        })
    };
    let values = (0..first.values.len()).map(centre).collect();
    Ok(FrequencyResponse { omega_rad_s: first.omega_rad_s.clone(), values })
}

fn check(options: &FamilyOptions, family: &[FrequencyResponse], shape: (usize, usize)) -> Result<()> {
    let range = |key, found: f64, valid: bool, allowed| {
        if valid { Ok(()) } else { Err(Error::OutOfRange { key, found, allowed }) }
    };
    range("margin", options.margin, options.margin >= 1.0 && options.margin.is_finite(), "1 or more")?;
    let near = options.neighbourhood;
    range("neighbourhood", near, near >= 1.0 && near.is_finite(), "1 or more")?;
    if let Between::Slope(slope) = options.between {
        range("slope", slope, slope > 0.0 && slope.is_finite(), "above 0")?;
    }
    let (OrderChoice::Fixed(order) | OrderChoice::UpTo(order)) = options.order;
    BoundShape::Rational { order, relative_degree: options.relative_degree }.check()?;
    if family.is_empty() {
        return Err(Error::EmptyList { key: "family" });
    }
    check_members(family, shape)
}

fn check_members(family: &[FrequencyResponse], shape: (usize, usize)) -> Result<()> {
    for (member_idx, member) in family.iter().enumerate() {
        if member.omega_rad_s.is_empty() || member.omega_rad_s.len() != member.values.len() {
            return Err(Error::FamilyGrid {
                member_idx,
                expected: "as many matrices as frequencies, at least one",
            });
        }
        let rising = member.omega_rad_s.windows(2).all(|pair| pair[0] < pair[1]);
        if !rising || !member.omega_rad_s.iter().all(|w| *w > 0.0 && w.is_finite()) {
            return Err(Error::FamilyGrid { member_idx, expected: "rising frequencies above zero" });
        }
        for (point_idx, value) in member.values.iter().enumerate() {
            if value.shape() != shape || value.is_empty() {
                let (rows, cols) = value.shape();
                return Err(Error::FamilyShape {
                    member_idx,
                    expected_rows: shape.0,
                    expected_cols: shape.1,
                    rows,
                    cols,
                });
            }
            if value.iter().any(|v| !v.re.is_finite() || !v.im.is_finite()) {
                return Err(Error::FamilyNotFinite { member_idx, point_idx });
            }
        }
    }
    Ok(())
}

/// The `Delta W` or `W Delta` that makes the member of the nominal response.
fn error_matrix(
    form: UncertaintyForm,
    nominal: &DMatrix<Complex64>,
    member: &DMatrix<Complex64>,
    omega: f64,
) -> Result<DMatrix<Complex64>> {
    let difference = member - nominal;
    let lost = |smallest: f64, largest: f64| {
        let side = if form == UncertaintyForm::InputMultiplicative { "right" } else { "left" };
        Error::NominalNotInvertible { side, omega_rad_s: omega, smallest, largest }
    };
    // E with G E = difference needs full row rank, E with E G = difference full column rank; both by the transposed
    // problem of least norm.
    let solve = |g: &DMatrix<Complex64>, right: &DMatrix<Complex64>| {
        let svd = g.clone().svd(true, true);
        let (largest, smallest) = (svd.singular_values.max(), svd.singular_values.min());
        if g.nrows() > g.ncols() || smallest <= RANK_TOLERANCE * largest || largest == 0.0 {
            return Err(lost(smallest, largest));
        }
        svd.solve(right, 0.0).map_err(|_| lost(smallest, largest))
    };
    match form {
        UncertaintyForm::Additive => Ok(difference),
        UncertaintyForm::InputMultiplicative => solve(nominal, &difference),
        UncertaintyForm::OutputMultiplicative => {
            Ok(solve(&nominal.transpose(), &difference.transpose())?.transpose())
        }
    }
}

/// What each weight has to reach.
fn sizes(error: &DMatrix<Complex64>, structure: WeightStructure) -> Vec<f64> {
    let norm =
        |m: &DMatrix<Complex64>| if m.len() == 1 { m[(0, 0)].norm() } else { m.singular_values().max() };
    if structure == WeightStructure::Scalar {
        return vec![norm(error)];
    }
    let rows: Vec<f64> = error.row_iter().map(|row| row.norm()).collect();
    // A row without an error asks for nothing, and is left out of the scaled matrix.
    let scaled = DMatrix::from_fn(error.nrows(), error.ncols(), |i, j| {
        if rows[i] > 0.0 { error[(i, j)] / rows[i] } else { Complex64::ZERO }
    });
    let stretch = norm(&scaled);
    rows.iter().map(|row| stretch * row).collect()
}

fn cover_curves(curves: Vec<Vec<(f64, f64)>>, options: &FamilyOptions) -> Result<FamilyWeight> {
    let largest = curves.iter().flatten().map(|p| p.1).fold(0.0, f64::max);
    if largest <= f64::MIN_POSITIVE {
        return Err(Error::CoverNoError);
    }
    let floor = ERROR_FLOOR * largest;
    let curves: Vec<ErrorCurve> = curves
        .into_iter()
        .map(|points| ErrorCurve::new(with_knees(points, floor, options.between), floor))
        .collect();
    let segments: Vec<Segment> = curves.iter().flat_map(ErrorCurve::segments).collect();
    let points = envelope(&curves, DESIGN_STEP);
    let orders = match options.order {
        OrderChoice::Fixed(order) => order..=order,
        OrderChoice::UpTo(order) => options.relative_degree..=order.min(ORDER_MAX),
    };
    let tried: Vec<_> = orders
        .map(|order| {
            let shape = BoundShape::Rational { order, relative_degree: options.relative_degree };
            (order, cover_magnitude(&points, shape, options.neighbourhood))
        })
        .collect();
    let ratio_of_order = tried.iter().map(|(n, d)| (*n, d.as_ref().ok().map(|d| d.ratio))).collect();
    let least = tried.iter().filter_map(|(_, d)| Some(d.as_ref().ok()?.ratio)).fold(f64::INFINITY, f64::min);
    let enough = least.ln() * (1.0 + ORDER_GAIN) + ORDER_FLOOR;
    let mut designed = Err(Error::CoverNoError);
    for (_, design) in tried {
        let done = design.as_ref().is_ok_and(|d| d.ratio.ln() <= enough);
        designed = design;
        if done {
            break;
        }
    }
    let designed = designed?;
    let shape = designed.weight.transfer_function()?;
    let touch = largest_excess(&segments, &MinimumPhase::of(&shape)?).upper.exp();
    // Rounding in the last place must not turn a touch into a violation.
    let weight = shape.scale(touch * options.margin * (1.0 + 1e-12))?;
    let worst = largest_excess(&segments, &MinimumPhase::of(&weight)?);
    let looseness = envelope(&curves, CHECK_STEP).into_iter().map(|p| weight.at(p.omega).norm() / p.error);
    Ok(FamilyWeight {
        worst_ratio: worst.upper.exp(),
        worst_omega_rad_s: worst.log_omega.exp(),
        loosest_ratio: looseness.fold(0.0, f64::max),
        design_ratio: designed.ratio,
        ratio_of_order,
        envelope: envelope(&curves, f64::INFINITY).into_iter().map(|p| (p.omega, p.error)).collect(),
        weight,
    })
}

/// The points, and between each two of them the highest point that a curve of limited slope can reach.
fn with_knees(points: Vec<(f64, f64)>, floor: f64, between: Between) -> Vec<(f64, f64)> {
    let Between::Slope(slope) = between else { return points };
    let mut all = Vec::with_capacity(2 * points.len());
    for pair in points.windows(2) {
        let [(left, e_left), (right, e_right)] = [pair[0], pair[1]];
        all.push(pair[0]);
        let width = (right / left).ln();
        let rise = (e_right.max(floor) / e_left.max(floor)).ln();
        // Up from the left and down to the right at the largest slope; where the points themselves are steeper, their
        // line stays as it is.
        if rise.abs() < slope * width {
            let share = 0.5 * (1.0 + rise / (slope * width));
            all.push((left * (share * width).exp(), e_left.max(floor) * (slope * share * width).exp()));
        }
    }
    all.extend(points.last());
    all
}

/// A circle in the complex plane.
#[derive(Debug, Clone, Copy)]
struct Circle {
    centre: Complex64,
    radius: f64,
}

impl Circle {
    fn holds(&self, point: Complex64) -> bool {
        (point - self.centre).norm() <= self.radius * (1.0 + 1e-12) + f64::MIN_POSITIVE
    }

    fn around_two(a: Complex64, b: Complex64) -> Self {
        Self { centre: 0.5 * (a + b), radius: 0.5 * (a - b).norm() }
    }

    /// Through three points; around the widest two of them where they are in line.
    fn around_three(a: Complex64, b: Complex64, c: Complex64) -> Self {
        let (p, q) = (b - a, c - a);
        let cross = 2.0 * (p.re * q.im - p.im * q.re);
        let pairs = [Self::around_two(a, b), Self::around_two(a, c), Self::around_two(b, c)];
        let widest = pairs.into_iter().fold(pairs[0], |w, p| if p.radius > w.radius { p } else { w });
        if cross.abs() <= 1e-14 * p.norm() * q.norm() {
            return widest;
        }
        let centre = Complex64::new(
            (q.im * p.norm_sqr() - p.im * q.norm_sqr()) / cross,
            (p.re * q.norm_sqr() - q.re * p.norm_sqr()) / cross,
        );
        Self { centre: a + centre, radius: centre.norm() }
    }
}

/// The smallest circle around points: three nested loops, each entered only where a point lies outside.
fn smallest_circle(points: &[Complex64]) -> Circle {
    let mut circle = Circle { centre: points[0], radius: 0.0 };
    for (i, &a) in points.iter().enumerate() {
        if circle.holds(a) {
            continue;
        }
        circle = Circle { centre: a, radius: 0.0 };
        for (j, &b) in points[..i].iter().enumerate() {
            if circle.holds(b) {
                continue;
            }
            circle = Circle::around_two(a, b);
            for &c in &points[..j] {
                if !circle.holds(c) {
                    circle = Circle::around_three(a, b, c);
                }
            }
        }
    }
    circle
}

/// A higher order must lessen the logarithm of the looseness by this share to be worth its states.
const ORDER_GAIN: f64 = 0.1;
/// And by this much: two percent.
const ORDER_FLOOR: f64 = 0.02;
/// Step of the design grid in ln(omega).
const DESIGN_STEP: f64 = 0.05;
/// Step in ln(omega) at which the looseness is looked for.
const CHECK_STEP: f64 = 0.005;
/// Errors below this share of the largest are raised to it: 140 dB down there is only rounding.
const ERROR_FLOOR: f64 = 1e-7;
/// A relative difference of this size is rounding of a response.
const DIFFERENCE_MIN: f64 = 1e-14;
/// Ratio of singular values below which a nominal response counts as having no inverse.
const RANK_TOLERANCE: f64 = 1e-12;

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn law_the_smallest_circle_holds_all_points_and_no_smaller_one_does() {
        let seed = 11;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        for trial in 0..300 {
            let mut point = || Complex64::new(rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0));
            let points: Vec<Complex64> = (0..1 + trial % 9).map(|_| point()).collect();
            let circle = smallest_circle(&points);
            let reach = |c: Complex64| points.iter().map(|p| (p - c).norm()).fold(0.0, f64::max);
            assert!(reach(circle.centre) <= circle.radius + 1e-12, "seed {seed} trial {trial}");
            // The largest distance is convex in the centre, so no nearby centre may do better.
            for k in 0..32 {
                let moved = circle.centre + Complex64::from_polar(1e-4, f64::from(k) * 0.2);
                assert!(reach(moved) >= circle.radius - 1e-12, "seed {seed} trial {trial}");
            }
        }
    }

    #[test]
    fn law_a_knee_is_as_high_as_the_slope_allows() {
        let points = with_knees(vec![(1.0, 1.0), (100.0, 1.0)], 1e-9, Between::Slope(2.0));
        assert!((points[1].0 - 10.0).abs() < 1e-9 && (points[1].1 - 100.0).abs() < 1e-9, "{points:?}");
        let steep = vec![(1.0, 1.0), (2.0, 100.0)];
        assert_eq!(with_knees(steep.clone(), 1e-9, Between::Slope(2.0)), steep);
    }
}
