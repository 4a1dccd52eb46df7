//! `telepulse solve pid`: a PID controller for a plant with dead time, and what its loop is worth.

use anyhow::Result;
use serde::Serialize;
use telepulse_design::Error;
use telepulse_design::implement::PidSettings;
use telepulse_design::synthesize::pid::{
    DelayedPlant, PidLimit, PidLimits, PidLoopCheck, PidStructure, RuleTerms, SimcOptions,
    maximize_integral_gain, tune_simc,
};
use telepulse_lti::TransferFunction;

use super::Answer;
use super::answer::{Status, Watch, design_status};
use super::input::{ProblemFile, Size};

#[derive(Serialize)]
pub(super) struct PidAnswer {
    status: Status,
    /// Gains of `p + i_per_s / s + d_s n_rad_s s / (s + n_rad_s)`.
    settings: Option<PidSettings>,
    /// Peaks with their brackets, and margins of the loop with the plant as given.
    check: Option<PidLoopCheck>,
    /// Limits that hold the integral gain back; method `max_ki` only.
    #[serde(skip_serializing_if = "Option::is_none")]
    binding: Option<Vec<PidLimit>>,
    message: String,
    seconds: f64,
}

const OPTIONS: [&str; 9] = [
    "method",
    "structure",
    "derivative_filter_rad_s",
    "ms_max",
    "mt_max",
    "ks_max",
    "ws",
    "closed_loop_time_s",
    "filter_ratio",
];

pub(super) fn solve(file: &ProblemFile) -> Result<PidAnswer> {
    let delay_s = file.number("delay_s")?.unwrap_or(0.0);
    let plant = DelayedPlant::new(transfer_function(file)?, delay_s)?;
    let method = Method::read(&file.options(&OPTIONS)?)?;
    let watch = Watch::start();
    let outcome = method.apply(&plant);
    let seconds = watch.seconds();
    match outcome {
        Ok(answer) => Ok(PidAnswer { seconds, ..answer }),
        Err(error) => {
            let Some(status) = design_status(&error) else { return Err(error.into()) };
            let (settings, check, binding) = (None, None, None);
            Ok(PidAnswer { status, settings, check, binding, message: error.to_string(), seconds })
        }
    }
}

/// `numerator` over `denominator`, highest power first.
fn transfer_function(file: &ProblemFile) -> Result<TransferFunction> {
    let (one, any) = (Size { name: "1", value: Some(1) }, Size { name: "any", value: None });
    let numerator = file.matrix("numerator", one, any)?;
    let denominator = file.matrix("denominator", one, any)?;
    TransferFunction::new(numerator.as_slice(), denominator.as_slice())
        .map_err(|error| file.complaint("denominator", &error.to_string()))
}

enum Method {
    MaximumIntegralGain(PidStructure, PidLimits),
    Simc(RuleTerms, SimcOptions),
}

impl Method {
    fn read(typed: &ProblemFile) -> Result<Self> {
        let with_derivative = match typed.word("structure")? {
            None | Some("pi") => false,
            Some("pid") => true,
            Some(_) => return Err(typed.complaint("structure", "expected `pi` or `pid`")),
        };
        match typed.word("method")? {
            None | Some("max_ki") => {
                let structure = match (with_derivative, typed.number("derivative_filter_rad_s")?) {
                    (false, _) => PidStructure::Pi,
                    (true, Some(n_rad_s)) => PidStructure::Pid { n_rad_s },
                    (true, None) => {
                        let what =
                            "is missing: method `max_ki` takes the pole of the derivative filter as given";
                        return Err(typed.complaint("derivative_filter_rad_s", what));
                    }
                };
                let default = PidLimits::default();
                let limits = PidLimits {
                    ms_max: typed.number("ms_max")?.unwrap_or(default.ms_max),
                    mt_max: typed.number("mt_max")?.unwrap_or(default.mt_max),
                    ks_max: typed.number("ks_max")?,
                    ws: typed
                        .part("ws", &["numerator", "denominator"])?
                        .map(|ws| transfer_function(&ws))
                        .transpose()?,
                };
                Ok(Self::MaximumIntegralGain(structure, limits))
            }
            Some("simc") => {
                let terms = if with_derivative { RuleTerms::Pid } else { RuleTerms::Pi };
                let default = SimcOptions::default();
                let options = SimcOptions {
                    closed_loop_time_s: typed.number("closed_loop_time_s")?,
                    filter_ratio: typed.number("filter_ratio")?.unwrap_or(default.filter_ratio),
                };
                Ok(Self::Simc(terms, options))
            }
            Some(_) => Err(typed.complaint("method", "expected `max_ki` or `simc`")),
        }
    }

    fn apply(&self, plant: &DelayedPlant) -> Result<PidAnswer, Error> {
        let solved = |settings, check| PidAnswer {
            status: Status::Ok,
            settings: Some(settings),
            check: Some(check),
            binding: None,
            message: "negative feedback: u = C (r - y)".to_owned(),
            seconds: 0.0,
        };
        Ok(match self {
            Self::MaximumIntegralGain(structure, limits) => {
                let design = maximize_integral_gain(plant, *structure, limits)?;
                PidAnswer { binding: Some(design.binding), ..solved(design.settings, design.check) }
            }
            Self::Simc(terms, options) => {
                let design = tune_simc(plant, *terms, options)?;
                PidAnswer {
                    message: format!(
                        "closed-loop time {} s; the check is that of the plant itself, not of the rule's model",
                        design.closed_loop_time_s
                    ),
                    ..solved(design.settings, design.check)
                }
            }
        })
    }
}

impl Answer for PidAnswer {
    fn status(&self) -> Status {
        self.status
    }

    fn lines(&self) -> Vec<String> {
        let (Some(settings), Some(check)) = (&self.settings, &self.check) else {
            return vec![self.message.clone()];
        };
        vec![
            format!(
                "p {}, i {} per s, d {} s, filter {} rad/s",
                settings.p, settings.i_per_s, settings.d_s, settings.n_rad_s
            ),
            format!(
                "peak of S {}, of T {}, of C S {}",
                check.peak_s.upper, check.peak_t.upper, check.peak_ks.upper
            ),
            self.message.clone(),
        ]
    }
}
