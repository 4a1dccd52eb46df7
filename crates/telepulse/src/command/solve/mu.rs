//! `telepulse solve mu`: both bounds of the structured singular value of a complex matrix, or of its peak over all frequencies.

use anyhow::Result;
use nalgebra::DMatrix;
use num_complex::Complex64;
use serde::Serialize;
use telepulse_design::Error;
use telepulse_design::uncertain::{
    Block, BlockStructure, BlockValue, MuLower, MuLowerOptions, MuPeak, mu_bounds, mu_peak, mu_peak_discrete,
};

use super::Answer;
use super::answer::{Rows, Status, Watch, design_status};
use super::hinfnorm::SystemParts;
use super::input::{ProblemFile, Size};

#[derive(Serialize)]
pub(super) struct MuAnswer {
    status: Status,
    /// A proof: no perturbation with a norm below `1 / upper` makes `I - M Delta` singular; of a system at any frequency.
    upper: Option<f64>,
    /// An example: `perturbation` does, and its norm is `1 / lower`.
    lower: Option<f64>,
    /// Blocks of the example in their order, real and imaginary part; null where none was found.
    perturbation: Option<Vec<ComplexRows>>,
    /// Smallest singular value of `I - M Delta` at the example, recomputed; null where there is none.
    residual: Option<f64>,
    /// Where the peak of a system lies.
    #[serde(flatten)]
    place: Option<PeakPlace>,
    message: String,
    seconds: f64,
}

#[derive(Serialize)]
struct ComplexRows {
    re: Rows,
    im: Rows,
}

/// Frequencies of a peak.
#[derive(Serialize)]
struct PeakPlace {
    /// Where the example makes the loop singular, in rad/s; null at infinite frequency, and where there is no example.
    omega_rad_s: Option<f64>,
    /// Where the proof is tightest, in rad/s; null at infinite frequency.
    upper_omega_rad_s: Option<f64>,
    /// Frequency intervals, each with a proof of its own, that cover the axis.
    intervals: usize,
}

pub(super) fn solve(file: &ProblemFile) -> Result<MuAnswer> {
    let (seconds, outcome) = if file.has("A") { of_system(file)? } else { of_matrix(file)? };
    match outcome {
        Ok(answer) => Ok(MuAnswer { seconds, ..answer }),
        Err(error) => {
            let Some(status) = design_status(&error) else { return Err(error.into()) };
            let message = error.to_string();
            Ok(MuAnswer {
                status,
                upper: None,
                lower: None,
                perturbation: None,
                residual: None,
                place: None,
                message,
                seconds,
            })
        }
    }
}

/// Time of the solution alone, and its outcome.
type Timed = (f64, Result<MuAnswer, Error>);

fn of_matrix(file: &ProblemFile) -> Result<Timed> {
    if !file.has("M") {
        return Err(file.complaint("M", "is missing: expected `M`, or a system `A`, `B`, `C`, `D`"));
    }
    let m = complex_matrix(file)?;
    let structure = structure(file)?;
    if m.shape() != (structure.n_z(), structure.n_w()) {
        let (rows, cols) = m.shape();
        let (n_z, n_w) = (structure.n_z(), structure.n_w());
        let what = format!("expected {n_z} x {n_w} by `blocks`, found {rows} x {cols}");
        return Err(file.complaint("M", &what));
    }
    let watch = Watch::start();
    let bounds = mu_bounds(&m, &structure, &MuLowerOptions::default());
    let seconds = watch.seconds();
    Ok((seconds, bounds.map(|bounds| MuAnswer::solved(bounds.upper.value, &bounds.lower, None))))
}

fn of_system(file: &ProblemFile) -> Result<Timed> {
    for key in ["M", "M_imaginary"] {
        if file.has(key) {
            return Err(file.complaint(key, "has no meaning beside a system `A`, `B`, `C`, `D`"));
        }
    }
    let structure = structure(file)?;
    let parts = system(file, &structure)?;
    let tolerance = tolerance(file)?;
    let (outcome, watch) = match parts.sample_time {
        None => {
            let sys = parts.continuous()?;
            let watch = Watch::start();
            (mu_peak(&sys, &structure, tolerance), watch)
        }
        Some(sample_time) => {
            let sys = parts.discrete(sample_time)?;
            let watch = Watch::start();
            (mu_peak_discrete(&sys, &structure, tolerance), watch)
        }
    };
    let seconds = watch.seconds();
    Ok((seconds, outcome.map(|peak| MuAnswer::solved(peak.upper, &peak.lower, Some(PeakPlace::new(&peak))))))
}

/// The system of a file; the blocks say how many inputs and outputs it has.
fn system(file: &ProblemFile, structure: &BlockStructure) -> Result<SystemParts> {
    let (w, z) = (structure.n_w(), structure.n_z());
    for (key, expected) in [("m", w), ("p", z)] {
        if let Some(found) = file.count(key)?
            && found != expected
        {
            return Err(file.complaint(key, &format!("expected {expected} by `blocks`, found {found}")));
        }
    }
    let w = Size { name: "w of `blocks`", value: Some(w) };
    SystemParts::read_with_ports(file, w, Size { name: "z of `blocks`", value: Some(z) })
}

/// `tolerance` of the options.
fn tolerance(file: &ProblemFile) -> Result<f64> {
    let options = file.options(&["tolerance"])?;
    let tolerance = options.number("tolerance")?.unwrap_or(TOLERANCE);
    if (TOLERANCE_MIN..=TOLERANCE_MAX).contains(&tolerance) {
        return Ok(tolerance);
    }
    let what = format!("expected {TOLERANCE_MIN} to {TOLERANCE_MAX}, found {tolerance}");
    Err(options.complaint("tolerance", &what))
}

/// `M`, or `M` and `M_imaginary`.
fn complex_matrix(file: &ProblemFile) -> Result<DMatrix<Complex64>> {
    let size = |name: &'static str| Size { name, value: None };
    let re = file.matrix("M", size("rows"), size("cols"))?;
    let rows = Size { name: "rows of M", value: Some(re.nrows()) };
    let cols = Size { name: "cols of M", value: Some(re.ncols()) };
    let im = file.matrix_or_zeros("M_imaginary", rows, cols)?;
    Ok(re.zip_map(&im, Complex64::new))
}

/// Pairs as other tools write them: `[-r, 0]` a real parameter that enters `r` times, `[r, 0]` a complex one, `[r, c]` a full
/// block of `r` rows and `c` columns, `[1, 1]` among them.
fn structure(file: &ProblemFile) -> Result<BlockStructure> {
    let pairs =
        file.matrix("blocks", Size { name: "blocks", value: None }, Size { name: "2", value: Some(2) })?;
    let mut blocks = Vec::with_capacity(pairs.nrows());
    for (index, pair) in pairs.row_iter().enumerate() {
        let (r, c) = (pair[0], pair[1]);
        let whole = |v: f64| v.fract() == 0.0 && v.abs() <= SIZE_MAX;
        let size = r.abs() as usize;
        blocks.push(match () {
            () if !(whole(r) && whole(c)) || r == 0.0 || c < 0.0 || (r < 0.0 && c != 0.0) => {
                let what = format!("block {index}: expected [-r, 0], [r, 0] or [r, c], found [{r}, {c}]");
                return Err(file.complaint("blocks", &what));
            }
            () if r < 0.0 => Block::RepeatedReal { size },
            () if c == 0.0 => Block::RepeatedComplex { size },
            () => Block::Full { rows: size, cols: c as usize },
        });
    }
    BlockStructure::new(blocks).map_err(|error| file.complaint("blocks", &error.to_string()))
}

impl MuAnswer {
    fn solved(upper: f64, lower: &MuLower, place: Option<PeakPlace>) -> Self {
        let block = |value: &BlockValue| {
            let m = match value {
                BlockValue::Real(v) => DMatrix::from_element(1, 1, Complex64::new(*v, 0.0)),
                BlockValue::Complex(v) => DMatrix::from_element(1, 1, *v),
                BlockValue::Full(m) => m.clone(),
            };
            ComplexRows { re: (&m.map(|v| v.re)).into(), im: (&m.map(|v| v.im)).into() }
        };
        let everywhere = if place.is_some() { "the upper bound holds at every frequency; " } else { "" };
        Self {
            status: Status::Ok,
            upper: Some(upper),
            lower: Some(lower.value),
            perturbation: lower.perturbation.as_ref().map(|p| p.values.iter().map(block).collect()),
            residual: lower.perturbation.as_ref().map(|_| lower.residual),
            place,
            message: format!("{everywhere}repeated scalars are given once"),
            seconds: 0.0,
        }
    }
}

impl PeakPlace {
    fn new(peak: &MuPeak) -> Self {
        let finite = |omega_rad_s: f64| omega_rad_s.is_finite().then_some(omega_rad_s);
        Self {
            omega_rad_s: peak.lower.perturbation.as_ref().and_then(|_| finite(peak.omega_rad_s)),
            upper_omega_rad_s: finite(peak.upper_omega_rad_s),
            intervals: peak.intervals,
        }
    }
}

impl Answer for MuAnswer {
    fn status(&self) -> Status {
        self.status
    }

    fn lines(&self) -> Vec<String> {
        let (Some(lower), Some(upper)) = (self.lower, self.upper) else {
            return vec![self.message.clone()];
        };
        let Some(place) = &self.place else { return vec![format!("mu is from {lower} to {upper}")] };
        let binding = place.upper_omega_rad_s.map_or_else(|| "infinity".to_owned(), |w| format!("{w} rad/s"));
        vec![
            format!("the peak of mu over all frequencies is from {lower} to {upper}"),
            format!("{} intervals; the upper bound binds at {binding}", place.intervals),
        ]
    }
}

/// Largest size of a block that a file may ask for.
const SIZE_MAX: f64 = 1e4;
/// Gap above the largest bound met that a proof between frequencies may leave, relative.
const TOLERANCE: f64 = 1e-3;
/// What [`mu_peak`] honours.
const TOLERANCE_MIN: f64 = 1e-6;
const TOLERANCE_MAX: f64 = 1.0;
