//! `telepulse solve reduce`: a system with fewer states, the bound on the error and the error itself.

use anyhow::Result;
use serde::Serialize;
use telepulse_lti::reduce::{
    OrderRule, ReduceOptions, Removal, Weights, hankel_approximation, minimal_realization, reduce,
    reduce_weighted,
};
use telepulse_lti::{Error, StateSpace, TimeDomain};

use super::Answer;
use super::answer::{Status, SystemAnswer, Watch, system_status};
use super::hinfnorm::SystemParts;
use super::input::ProblemFile;

#[derive(Serialize)]
pub(super) struct ReduceAnswer {
    status: Status,
    /// The reduced system.
    system: Option<SystemAnswer>,
    order: Option<usize>,
    order_before: usize,
    /// Of the stable part, descending; under weights the weighted ones, which bound nothing. Absent for `minimal`.
    hankel_singular_values: Option<Vec<f64>>,
    /// Modes outside of the stable region, all of them kept.
    n_unstable_kept: Option<usize>,
    /// What theory promises the H-infinity norm of the error to stay below; null where it promises nothing.
    error_bound: Option<f64>,
    /// H-infinity norm of the error, measured; under weights that of the weighted error. For `minimal`: largest change of the
    /// response over the frequencies examined, relative to its largest value there.
    error: Option<f64>,
    /// Hankel norm of the error, for `hankel` only.
    #[serde(skip_serializing_if = "Option::is_none")]
    hankel_error: Option<f64>,
    message: String,
    seconds: f64,
}

const OPTIONS: [&str; 5] = ["method", "order", "error_max", "relative_error_max", "tolerance"];
const SYSTEM: [&str; 4] = ["A", "B", "C", "D"];

pub(super) fn solve(file: &ProblemFile) -> Result<ReduceAnswer> {
    let parts = SystemParts::read(file)?;
    match parts.sample_time {
        None => with_system(file, parts.continuous()?, |weight| weight.continuous()),
        Some(ts) => with_system(file, parts.discrete(ts)?, |weight| weight.discrete(ts)),
    }
}

fn with_system<T: TimeDomain>(
    file: &ProblemFile,
    sys: StateSpace<T>,
    convert: impl Fn(SystemParts) -> Result<StateSpace<T>>,
) -> Result<ReduceAnswer> {
    let weight = |key: &str| -> Result<Option<StateSpace<T>>> {
        match file.part(key, &SYSTEM)? {
            Some(part) => Ok(Some(convert(SystemParts::read(&part)?)?)),
            None => Ok(None),
        }
    };
    let (before, behind) = (weight("input_weight")?, weight("output_weight")?);
    let method = Method::read(file, before.is_some() || behind.is_some())?;
    let typed = file.options(&OPTIONS)?;
    let weights = Weights { input: before.as_ref(), output: behind.as_ref() };
    let watch = Watch::start();
    let outcome = method.apply(&sys, weights);
    let seconds = watch.seconds();
    let order_before = sys.n_states();
    match outcome {
        Ok(answer) => Ok(ReduceAnswer { order_before, seconds, ..answer }),
        Err(error) => {
            let Some(status) = system_status(&error) else {
                // The system and the bounds have been read and checked: what is left is an order that is too large or too small.
                return Err(match typed.has("order") {
                    true => typed.complaint("order", &error.to_string()),
                    false => error.into(),
                });
            };
            let message = error.to_string();
            Ok(ReduceAnswer { status, message, order_before, seconds, ..ReduceAnswer::nothing() })
        }
    }
}

enum Method {
    Balanced(OrderRule, Removal),
    Weighted(OrderRule, Removal),
    Hankel(OrderRule),
    Minimal(Option<f64>),
}

impl Method {
    fn read(file: &ProblemFile, weighted: bool) -> Result<Self> {
        let typed = file.options(&OPTIONS)?;
        let removal = match typed.word("method")? {
            None | Some("truncate") => Removal::Truncate,
            Some("residualize") => Removal::Residualize,
            Some("hankel" | "minimal") if weighted => {
                return Err(typed.complaint("method", "expected `truncate` or `residualize` with a weight"));
            }
            Some("hankel") => return Ok(Self::Hankel(order_rule(&typed)?)),
            Some("minimal") => {
                for key in ["order", "error_max", "relative_error_max"] {
                    if typed.has(key) {
                        return Err(typed
                            .complaint(key, "has no meaning for method `minimal`, which takes `tolerance`"));
                    }
                }
                let allowed = |v: f64| (0.0..1.0).contains(&v);
                return Ok(Self::Minimal(typed.number_in("tolerance", "from 0 to below 1", allowed)?));
            }
            Some(_) => {
                return Err(
                    typed.complaint("method", "expected `truncate`, `residualize`, `hankel` or `minimal`")
                );
            }
        };
        if typed.has("tolerance") {
            return Err(typed.complaint("tolerance", "has a meaning for method `minimal` only"));
        }
        let order = order_rule(&typed)?;
        Ok(if weighted { Self::Weighted(order, removal) } else { Self::Balanced(order, removal) })
    }

    fn apply<T: TimeDomain>(
        self,
        sys: &StateSpace<T>,
        weights: Weights<'_, T>,
    ) -> Result<ReduceAnswer, Error> {
        let solved = |sys: &StateSpace<T>| ReduceAnswer {
            status: Status::Ok,
            order: Some(sys.n_states()),
            system: Some(sys.into()),
            ..ReduceAnswer::nothing()
        };
        Ok(match self {
            Self::Balanced(order, removal) => {
                let done = reduce(sys, &ReduceOptions { removal, ..ReduceOptions::new(order) })?;
                ReduceAnswer {
                    n_unstable_kept: Some(done.n_unstable_kept),
                    error_bound: Some(done.error_bound),
                    error: Some(done.error.value),
                    hankel_singular_values: Some(done.hankel_singular_values),
                    message: "the error is that of the two systems' difference, measured".to_owned(),
                    ..solved(&done.sys)
                }
            }
            Self::Weighted(order, removal) => {
                let done = reduce_weighted(sys, weights, order, removal)?;
                ReduceAnswer {
                    n_unstable_kept: Some(done.n_unstable_kept),
                    error: Some(done.weighted_error.value),
                    hankel_singular_values: Some(done.weighted_singular_values),
                    message: "the error is the weighted one, measured; no theory bounds it".to_owned(),
                    ..solved(&done.sys)
                }
            }
            Self::Hankel(order) => {
                let done = hankel_approximation(sys, order)?;
                ReduceAnswer {
                    n_unstable_kept: Some(done.n_unstable_kept),
                    error_bound: Some(done.error_bound),
                    error: Some(done.error.value),
                    hankel_error: Some(done.hankel_error),
                    message: format!(
                        "no system of this order has an error of less than {} in the Hankel norm",
                        done.optimal_hankel_error
                    ),
                    hankel_singular_values: Some(done.hankel_singular_values),
                    ..solved(&done.sys)
                }
            }
            Self::Minimal(tolerance) => {
                let done = minimal_realization(sys, tolerance)?;
                ReduceAnswer {
                    error: Some(done.response_error),
                    message: format!(
                        "{} states that no input moves and {} that no output sees were left out, at a tolerance of {:e}",
                        done.n_uncontrollable, done.n_unobservable, done.tolerance
                    ),
                    ..solved(&done.sys)
                }
            }
        })
    }
}

/// One of `order`, `error_max`, `relative_error_max`; none of them: the largest gap of the Hankel singular values.
fn order_rule(typed: &ProblemFile) -> Result<OrderRule> {
    let order = typed.count("order")?;
    let bound = |key: &str| typed.number_in(key, "0 or more", |v| v >= 0.0);
    let (error, relative) = (bound("error_max")?, bound("relative_error_max")?);
    match (order, error, relative) {
        (Some(order), None, None) => Ok(OrderRule::Count(order)),
        (None, Some(error), None) => Ok(OrderRule::ErrorAtMost(error)),
        (None, None, Some(relative)) => Ok(OrderRule::RelativeErrorAtMost(relative)),
        (None, None, None) => Ok(OrderRule::LargestGap),
        _ => Err(typed
            .complaint("order", "expected one of `order`, `error_max`, `relative_error_max`, found several")),
    }
}

impl ReduceAnswer {
    fn nothing() -> Self {
        Self {
            status: Status::NotConverged,
            system: None,
            order: None,
            order_before: 0,
            hankel_singular_values: None,
            n_unstable_kept: None,
            error_bound: None,
            error: None,
            hankel_error: None,
            message: String::new(),
            seconds: 0.0,
        }
    }
}

impl Answer for ReduceAnswer {
    fn status(&self) -> Status {
        self.status
    }

    fn lines(&self) -> Vec<String> {
        let Some(order) = self.order else { return vec![self.message.clone()] };
        let mut lines = vec![format!("{order} of {} states kept", self.order_before)];
        lines.extend(self.error_bound.map(|bound| format!("error bound {bound}")));
        lines.extend(self.error.map(|error| format!("error {error}")));
        lines.push(self.message.clone());
        lines
    }
}
