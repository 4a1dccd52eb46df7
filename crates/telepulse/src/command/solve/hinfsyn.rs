//! `telepulse solve hinfsyn`: output feedback for a generalized plant.

use anyhow::Result;
use nalgebra::DMatrix;
use serde::Serialize;
use telepulse_design::synthesize::{
    Condition, DiscreteHinfDesign, HinfDesign, HinfOptions, Regularization, Repaired, SingularProblem,
    hinfsyn, hinfsyn_discrete,
};
use telepulse_lti::{Continuous, Discrete, GeneralizedPlant, StateSpace, TimeDomain};

use super::Answer;
use super::answer::{Status, SystemAnswer, Watch, design_status, pairs};
use super::input::{ProblemFile, Size};

#[derive(Serialize)]
pub(super) struct HinfAnswer {
    status: Status,
    /// No controller reaches this norm.
    gamma_lower: Option<f64>,
    /// Some controller reaches this norm.
    gamma_upper: Option<f64>,
    /// What the controller was designed for.
    gamma_design: Option<f64>,
    /// Closed-loop norm on the plant as given, recomputed from the closed loop.
    achieved_norm: Option<f64>,
    stable: bool,
    /// Pairs of real and imaginary part, rad/s.
    closed_loop_poles: Vec<[f64; 2]>,
    controller: Option<SystemAnswer>,
    binding_condition: Option<Condition>,
    /// What was added to a singular plant to make it solvable; null for a regular one.
    regularization: Option<RegularizationAnswer>,
    message: String,
    seconds: f64,
}

#[derive(Serialize)]
struct RegularizationAnswer {
    /// Size of what was added relative to the plant's own direct terms.
    epsilon: f64,
    /// `d12`, `d21`, `axis_zeros`: what needed it.
    repaired: Vec<&'static str>,
    /// Smallest norm of the enlarged plant that some controller is known to reach.
    gamma_enlarged: f64,
    /// The norm on the plant as given; the same as `achieved_norm`.
    norm_on_original_plant: f64,
}

const OPTIONS: [&str; 7] = [
    "backoff",
    "gamma_tolerance",
    "gamma_max",
    "max_controller_pole_rad_s",
    "max_controller_gain",
    "relaxation_max",
    "singular",
];

pub(super) fn solve(file: &ProblemFile) -> Result<HinfAnswer> {
    let options = options(file)?;
    let watch;
    let outcome = match super::hinfnorm::sample_time(file)? {
        None => {
            let plant = plant(file, Continuous)?;
            watch = Watch::start();
            hinfsyn(&plant, &options).map(|design| HinfAnswer::solved(&design))
        }
        Some(sample_time) => {
            let plant = plant(file, Discrete::new(sample_time))?;
            watch = Watch::start();
            hinfsyn_discrete(&plant, &options).map(|design| HinfAnswer::solved_discrete(&design))
        }
    };
    let seconds = watch.seconds();
    match outcome {
        Ok(answer) => Ok(HinfAnswer { seconds, ..answer }),
        Err(error) => match design_status(&error) {
            Some(status) => Ok(HinfAnswer::unsolved(status, error.to_string(), seconds)),
            None => Err(error.into()),
        },
    }
}

impl HinfAnswer {
    fn solved(design: &HinfDesign) -> Self {
        Self {
            status: Status::Ok,
            gamma_lower: Some(design.gamma_lower),
            gamma_upper: Some(design.gamma_upper),
            gamma_design: Some(design.gamma_design),
            achieved_norm: Some(design.achieved.value),
            stable: true,
            closed_loop_poles: pairs(&design.closed_loop_poles),
            controller: Some((&design.controller).into()),
            binding_condition: design.binding_condition,
            message: message(design),
            regularization: regularization(design, design.achieved.value),
            seconds: 0.0,
        }
    }

    fn solved_discrete(design: &DiscreteHinfDesign) -> Self {
        let mut message = message(&design.continuous);
        if design.radius < 1.0 {
            message.push_str(&format!("; the optimum is that of the circle of radius {}", design.radius));
        }
        Self {
            gamma_lower: Some(design.gamma_lower),
            gamma_upper: Some(design.gamma_upper),
            gamma_design: Some(design.gamma_design),
            achieved_norm: Some(design.achieved.value),
            closed_loop_poles: pairs(&design.closed_loop_poles),
            controller: Some((&design.controller).into()),
            binding_condition: design.binding_condition,
            regularization: regularization(&design.continuous, design.achieved.value),
            message,
            ..Self::solved(&design.continuous)
        }
    }

    fn unsolved(status: Status, message: String, seconds: f64) -> Self {
        Self {
            status,
            gamma_lower: None,
            gamma_upper: None,
            gamma_design: None,
            achieved_norm: None,
            stable: false,
            closed_loop_poles: Vec::new(),
            controller: None,
            binding_condition: None,
            regularization: None,
            message,
            seconds,
        }
    }
}

fn regularization(design: &HinfDesign, norm_on_original_plant: f64) -> Option<RegularizationAnswer> {
    design.regularization.as_ref().map(|r| RegularizationAnswer::new(r, norm_on_original_plant))
}

impl RegularizationAnswer {
    fn new(r: &Regularization, norm_on_original_plant: f64) -> Self {
        let parts = [("d12", r.d12), ("d21", r.d21), ("axis_zeros", r.axis_zeros)];
        let repaired =
            parts.into_iter().filter(|(_, part)| *part == Repaired::Yes).map(|(name, _)| name).collect();
        Self { epsilon: r.epsilon, repaired, gamma_enlarged: r.gamma_enlarged, norm_on_original_plant }
    }
}

/// What a reader of the numbers should know besides.
fn message(design: &HinfDesign) -> String {
    let mut parts = Vec::new();
    match (&design.regularization, design.binding_condition) {
        (Some(r), _) => parts.push(format!(
            "the problem is singular and was regularised with epsilon {:e}; the norm is that of the plant as given",
            r.epsilon
        )),
        (None, Some(condition)) => parts.push(format!("the optimum is set by {condition:?}")),
        (None, None) => parts.push("the norm can be made as small as one likes".to_owned()),
    }
    if design.n_residualized > 0 {
        parts.push(format!(
            "{} fast controller modes were replaced by their static gain",
            design.n_residualized
        ));
    }
    parts.join("; ")
}

/// The plant's nine matrices; sizes from `n`, `nw`, `nu`, `nz`, `ny` where they are given, else from the matrices.
fn plant<T: TimeDomain>(file: &ProblemFile, domain: T) -> Result<GeneralizedPlant<T>> {
    let sizes = Sizes::read(file)?;
    let Sizes { n, nw, nu, nz, ny } = sizes;
    let (a, b1, b2) = (file.matrix("A", n, n)?, file.matrix("B1", n, nw)?, file.matrix("B2", n, nu)?);
    let (c1, c2) = (file.matrix("C1", nz, n)?, file.matrix("C2", ny, n)?);
    let d11 = file.matrix_or_zeros("D11", nz, nw)?;
    let d12 = file.matrix_or_zeros("D12", nz, nu)?;
    let d21 = file.matrix_or_zeros("D21", ny, nw)?;
    let d22 = file.matrix_or_zeros("D22", ny, nu)?;
    for size in [nw, nu, nz, ny] {
        if size.value == Some(0) {
            return Err(
                file.complaint(size.name, "expected at least 1: a plant without such signals has no problem")
            );
        }
    }
    let b = beside(&b1, &b2);
    let c = stack(&c1, &c2);
    let d = stack(&beside(&d11, &d12), &beside(&d21, &d22));
    let sys = StateSpace::with_domain(a, b, c, d, domain)?;
    Ok(GeneralizedPlant::new(sys, b1.ncols(), b2.ncols(), c1.nrows(), c2.nrows())?)
}

/// The sizes of a generalized plant, all known.
#[derive(Clone, Copy)]
struct Sizes {
    n: Size,
    nw: Size,
    nu: Size,
    nz: Size,
    ny: Size,
}

impl Sizes {
    fn read(file: &ProblemFile) -> Result<Self> {
        let unknown = |name| Size { name, value: None };
        let rows = |size: Size, keys: [&str; 3]| -> Result<Size> {
            let mut size = size;
            for key in keys {
                if size.value.is_none()
                    && let Some(m) = file.optional_matrix(key, size, unknown("any"))?
                {
                    size.value = Some(m.nrows());
                }
            }
            Ok(size)
        };
        let n = rows(file.size("n")?, ["A", "B1", "B2"])?;
        let cols = |size: Size, keys: [&str; 3]| -> Result<Size> {
            let mut size = size;
            for key in keys {
                // A matrix without rows does not tell how many columns it has.
                if size.value.is_none()
                    && let Some(m) = file.optional_matrix(key, unknown("any"), size)?
                    && m.nrows() > 0
                {
                    size.value = Some(m.ncols());
                }
            }
            Ok(size)
        };
        Ok(Self {
            n,
            nw: cols(file.size("nw")?, ["B1", "D11", "D21"])?,
            nu: cols(file.size("nu")?, ["B2", "D12", "D22"])?,
            nz: rows(file.size("nz")?, ["C1", "D11", "D12"])?,
            ny: rows(file.size("ny")?, ["C2", "D21", "D22"])?,
        })
    }
}

fn options(file: &ProblemFile) -> Result<HinfOptions> {
    let typed = file.options(&OPTIONS)?;
    let default = HinfOptions::default();
    let positive = |key: &str| typed.number_in(key, "a positive number", |v| v > 0.0);
    let backoff = typed.number_in("backoff", "a number above 1", |v| v > 1.0)?.unwrap_or(default.backoff);
    let relaxation_max = match typed.number("relaxation_max")? {
        None if backoff > default.relaxation_max => {
            let what = format!(
                "expected up to {} without `relaxation_max`, which must be as large at least, found {backoff}",
                default.relaxation_max
            );
            return Err(typed.complaint("backoff", &what));
        }
        None => default.relaxation_max,
        Some(found) if found < backoff => {
            let what = format!("expected at least the `backoff`, {backoff}, found {found}");
            return Err(typed.complaint("relaxation_max", &what));
        }
        Some(found) => found,
    };
    let max_controller_pole_rad_s = positive("max_controller_pole_rad_s")?;
    if max_controller_pole_rad_s.is_some() && super::hinfnorm::sample_time(file)?.is_some() {
        let what = "has no meaning with `dt`: the sample time bounds the poles already";
        return Err(typed.complaint("max_controller_pole_rad_s", what));
    }
    let tolerance = typed.number_in("gamma_tolerance", "1e-12 to 0.1", |v| (1e-12..=0.1).contains(&v))?;
    Ok(HinfOptions {
        backoff,
        gamma_tolerance: tolerance.unwrap_or(default.gamma_tolerance),
        gamma_max: positive("gamma_max")?.unwrap_or(default.gamma_max),
        max_controller_pole_rad_s,
        max_controller_gain: positive("max_controller_gain")?,
        relaxation_max,
        singular: match typed.word("singular")? {
            None | Some("regularize") => SingularProblem::Regularize,
            Some("refuse") => SingularProblem::Refuse,
            Some(_) => return Err(typed.complaint("singular", "expected `regularize` or `refuse`")),
        },
    })
}

fn beside(left: &DMatrix<f64>, right: &DMatrix<f64>) -> DMatrix<f64> {
    let mut m = DMatrix::zeros(left.nrows(), left.ncols() + right.ncols());
    m.columns_mut(0, left.ncols()).copy_from(left);
    m.columns_mut(left.ncols(), right.ncols()).copy_from(right);
    m
}

fn stack(upper: &DMatrix<f64>, lower: &DMatrix<f64>) -> DMatrix<f64> {
    let mut m = DMatrix::zeros(upper.nrows() + lower.nrows(), upper.ncols());
    m.rows_mut(0, upper.nrows()).copy_from(upper);
    m.rows_mut(upper.nrows(), lower.nrows()).copy_from(lower);
    m
}

impl Answer for HinfAnswer {
    fn status(&self) -> Status {
        self.status
    }

    fn lines(&self) -> Vec<String> {
        match (self.achieved_norm, self.gamma_lower, self.gamma_upper) {
            (Some(achieved), Some(lower), Some(upper)) => {
                let mut lines =
                    vec![format!("norm {achieved} achieved, the optimum lies within {lower} and {upper}")];
                lines.extend((!self.message.is_empty()).then(|| self.message.clone()));
                lines
            }
            _ => vec![self.message.clone()],
        }
    }
}
