//! `telepulse solve pid`: a PID controller for a plant with dead time, and what its loop is worth.

use anyhow::Result;
use serde::Serialize;
use telepulse_design::Error;
use telepulse_design::implement::PidSettings;
use telepulse_design::synthesize::pid::{
    DelayedPlant, DesignFocus, MarginTarget, MarginTerms, PidLimit, PidLimits, PidLoopCheck, PidStructure,
    RuleTerms, SimcOptions, maximize_integral_gain, tune_phase_margin, tune_simc,
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
    /// Crossover that was asked for or chosen, in rad/s; method `phase_margin` only.
    #[serde(skip_serializing_if = "Option::is_none")]
    crossover_rad_s: Option<f64>,
    message: String,
    seconds: f64,
}

const OPTIONS: [&str; 12] = [
    "method",
    "structure",
    "derivative_filter_rad_s",
    "ms_max",
    "mt_max",
    "ks_max",
    "ws",
    "closed_loop_time_s",
    "filter_ratio",
    "crossover_rad_s",
    "phase_margin_deg",
    "focus",
];

pub(super) fn solve(file: &ProblemFile) -> Result<PidAnswer> {
    let allowed = |v: f64| v == 0.0 || (1e-12..=1e12).contains(&v);
    let delay_s = file.number_in("delay_s", "0, or 1e-12 to 1e12", allowed)?.unwrap_or(0.0);
    let function = transfer_function(file)?;
    if function.numerator().iter().all(|&v| v == 0.0) {
        return Err(file.complaint("numerator", "expected a coefficient other than zero, found none"));
    }
    let plant = DelayedPlant::new(function, delay_s)?;
    let options = file.options(&OPTIONS)?;
    let method = Method::read(&options)?;
    if let Some(key) = options.unread().first() {
        return Err(options.complaint(key, &format!("has no meaning with method `{}`", method.name())));
    }
    let watch = Watch::start();
    let outcome = method.apply(&plant);
    let seconds = watch.seconds();
    match outcome {
        Ok(answer) => Ok(PidAnswer { seconds, ..answer }),
        Err(error) => {
            let Some(status) = design_status(&error) else { return Err(error.into()) };
            Ok(PidAnswer {
                status,
                settings: None,
                check: None,
                binding: None,
                crossover_rad_s: None,
                message: error.to_string(),
                seconds,
            })
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
    PhaseMargin(MarginTerms, MarginTarget),
}

impl Method {
    fn read(typed: &ProblemFile) -> Result<Self> {
        match typed.word("method")? {
            None | Some("max_ki") => Self::read_maximum_integral_gain(typed),
            Some("simc") => {
                let terms = if has_derivative(typed)? { RuleTerms::Pid } else { RuleTerms::Pi };
                let default = SimcOptions::default();
                let options = SimcOptions {
                    closed_loop_time_s: above(typed, "closed_loop_time_s", 0.0)?,
                    filter_ratio: above(typed, "filter_ratio", 0.0)?.unwrap_or(default.filter_ratio),
                };
                Ok(Self::Simc(terms, options))
            }
            Some("phase_margin") => Self::read_phase_margin(typed),
            Some(_) => Err(typed.complaint("method", "expected `max_ki`, `simc` or `phase_margin`")),
        }
    }

    fn read_maximum_integral_gain(typed: &ProblemFile) -> Result<Self> {
        let structure = match (has_derivative(typed)?, above(typed, "derivative_filter_rad_s", 0.0)?) {
            (false, _) => PidStructure::Pi,
            (true, Some(n_rad_s)) => PidStructure::Pid { n_rad_s },
            (true, None) => {
                let what = "is missing: method `max_ki` takes the pole of the derivative filter as given";
                return Err(typed.complaint("derivative_filter_rad_s", what));
            }
        };
        let default = PidLimits::default();
        let limits = PidLimits {
            ms_max: above(typed, "ms_max", 1.0)?.unwrap_or(default.ms_max),
            mt_max: above(typed, "mt_max", 1.0)?.unwrap_or(default.mt_max),
            ks_max: above(typed, "ks_max", 0.0)?,
            ws: typed
                .part("ws", &["numerator", "denominator"])?
                .map(|ws| transfer_function(&ws))
                .transpose()?,
        };
        Ok(Self::MaximumIntegralGain(structure, limits))
    }

    fn read_phase_margin(typed: &ProblemFile) -> Result<Self> {
        let terms = match typed.word("structure")? {
            Some("p") => MarginTerms::P,
            Some("i") => MarginTerms::I,
            None | Some("pi") => MarginTerms::Pi,
            Some("pd") => MarginTerms::Pd,
            Some("pid") => MarginTerms::Pid,
            Some("pidf") => MarginTerms::Pidf,
            Some(_) => {
                return Err(typed.complaint("structure", "expected `p`, `i`, `pi`, `pd`, `pid` or `pidf`"));
            }
        };
        let focus = match typed.word("focus")? {
            None | Some("balanced") => DesignFocus::Balanced,
            Some("reference") => DesignFocus::Reference,
            Some("disturbance") => DesignFocus::Disturbance,
            Some(_) => {
                return Err(typed.complaint("focus", "expected `balanced`, `reference` or `disturbance`"));
            }
        };
        let default = MarginTarget::default();
        let target = MarginTarget {
            crossover_rad_s: above(typed, "crossover_rad_s", 0.0)?,
            phase_margin_deg: typed
                .number_in("phase_margin_deg", "between 0 and 180", |v| v > 0.0 && v < 180.0)?
                .unwrap_or(default.phase_margin_deg),
            filter_ratio: above(typed, "filter_ratio", 1.0)?.unwrap_or(default.filter_ratio),
            ms_max: above(typed, "ms_max", 1.0)?.unwrap_or(default.ms_max),
            focus,
        };
        Ok(Self::PhaseMargin(terms, target))
    }

    /// As the file has it.
    fn name(&self) -> &'static str {
        match self {
            Self::MaximumIntegralGain(..) => "max_ki",
            Self::Simc(..) => "simc",
            Self::PhaseMargin(..) => "phase_margin",
        }
    }

    fn apply(&self, plant: &DelayedPlant) -> Result<PidAnswer, Error> {
        let solved = |settings, check| PidAnswer {
            status: Status::Ok,
            settings: Some(settings),
            check: Some(check),
            binding: None,
            crossover_rad_s: None,
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
            Self::PhaseMargin(terms, target) => {
                let design = tune_phase_margin(plant, *terms, target)?;
                let crossover_rad_s = Some(design.crossover_rad_s);
                PidAnswer { crossover_rad_s, ..solved(design.settings, design.check) }
            }
        })
    }
}

/// A number above a limit.
fn above(typed: &ProblemFile, key: &str, limit: f64) -> Result<Option<f64>> {
    typed.number_in(key, &format!("a number above {limit}"), |v| v > limit)
}

/// `structure` of the methods that know two.
fn has_derivative(typed: &ProblemFile) -> Result<bool> {
    match typed.word("structure")? {
        None | Some("pi") => Ok(false),
        Some("pid") => Ok(true),
        Some(_) => Err(typed.complaint("structure", "expected `pi` or `pid`")),
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
