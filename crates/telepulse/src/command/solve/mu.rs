//! `telepulse solve mu`: both bounds of the structured singular value of a complex matrix.

use anyhow::Result;
use nalgebra::DMatrix;
use num_complex::Complex64;
use serde::Serialize;
use telepulse_design::uncertain::{Block, BlockStructure, BlockValue, MuBounds, MuLowerOptions, mu_bounds};

use super::Answer;
use super::answer::{Rows, Status, Watch, design_status};
use super::input::{ProblemFile, Size};

#[derive(Serialize)]
pub(super) struct MuAnswer {
    status: Status,
    /// A proof: no perturbation with a norm below `1 / upper` makes `I - M Delta` singular.
    upper: Option<f64>,
    /// An example: `perturbation` does, and its norm is `1 / lower`.
    lower: Option<f64>,
    /// Blocks of the example in their order, real and imaginary part; null where none was found.
    perturbation: Option<Vec<ComplexRows>>,
    /// Smallest singular value of `I - M Delta` at the example, relative.
    residual: Option<f64>,
    message: String,
    seconds: f64,
}

#[derive(Serialize)]
struct ComplexRows {
    re: Rows,
    im: Rows,
}

pub(super) fn solve(file: &ProblemFile) -> Result<MuAnswer> {
    let m = complex_matrix(file)?;
    let structure = structure(file, &m)?;
    let watch = Watch::start();
    let outcome = mu_bounds(&m, &structure, &MuLowerOptions::default());
    let seconds = watch.seconds();
    match outcome {
        Ok(bounds) => Ok(MuAnswer::solved(&bounds, seconds)),
        Err(error) => {
            let Some(status) = design_status(&error) else { return Err(error.into()) };
            let message = error.to_string();
            Ok(MuAnswer {
                status,
                upper: None,
                lower: None,
                perturbation: None,
                residual: None,
                message,
                seconds,
            })
        }
    }
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
fn structure(file: &ProblemFile, m: &DMatrix<Complex64>) -> Result<BlockStructure> {
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
    let structure =
        BlockStructure::new(blocks).map_err(|error| file.complaint("blocks", &error.to_string()))?;
    if m.shape() != (structure.n_z(), structure.n_w()) {
        let (rows, cols) = m.shape();
        let (n_z, n_w) = (structure.n_z(), structure.n_w());
        return Err(
            file.complaint("M", &format!("expected {n_z} x {n_w} by `blocks`, found {rows} x {cols}"))
        );
    }
    Ok(structure)
}

impl MuAnswer {
    fn solved(bounds: &MuBounds, seconds: f64) -> Self {
        let block = |value: &BlockValue| {
            let m = match value {
                BlockValue::Real(v) => DMatrix::from_element(1, 1, Complex64::new(*v, 0.0)),
                BlockValue::Complex(v) => DMatrix::from_element(1, 1, *v),
                BlockValue::Full(m) => m.clone(),
            };
            ComplexRows { re: (&m.map(|v| v.re)).into(), im: (&m.map(|v| v.im)).into() }
        };
        Self {
            status: Status::Ok,
            upper: Some(bounds.upper.value),
            lower: Some(bounds.lower.value),
            perturbation: bounds.lower.perturbation.as_ref().map(|p| p.values.iter().map(block).collect()),
            residual: bounds.lower.residual.is_finite().then_some(bounds.lower.residual),
            message: "repeated scalars are given once".to_owned(),
            seconds,
        }
    }
}

impl Answer for MuAnswer {
    fn status(&self) -> Status {
        self.status
    }

    fn lines(&self) -> Vec<String> {
        match (self.lower, self.upper) {
            (Some(lower), Some(upper)) => vec![format!("mu is from {lower} to {upper}")],
            _ => vec![self.message.clone()],
        }
    }
}

/// Largest size of a block that a file may ask for.
const SIZE_MAX: f64 = 1e4;
