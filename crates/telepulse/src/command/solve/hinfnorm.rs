//! `telepulse solve hinfnorm`: the peak gain of a stable system, bracketed.

use anyhow::Result;
use serde::Serialize;
use telepulse_lti::{Continuous, Discrete, PeakGain, SampleTime, StateSpace, hinf_norm};

use super::Answer;
use super::answer::{Status, Watch, system_status};
use super::input::{ProblemFile, Size};

#[derive(Serialize)]
pub(super) struct NormAnswer {
    status: Status,
    /// Largest gain of the frequency response.
    value: Option<f64>,
    /// The norm is not below it.
    lower: Option<f64>,
    /// The norm is not above it.
    upper: Option<f64>,
    /// Where the largest gain lies, in rad/s; null where only the limit reaches it.
    omega_rad_s: Option<f64>,
    message: String,
    seconds: f64,
}

pub(super) fn solve(file: &ProblemFile) -> Result<NormAnswer> {
    let parts = SystemParts::read(file)?;
    let watch = Watch::start();
    let peak = match parts.sample_time {
        None => parts.continuous()?.hinf_norm(),
        Some(sample_time) => hinf_norm(&parts.discrete(sample_time)?),
    };
    let seconds = watch.seconds();
    match peak {
        Ok(PeakGain { value, lower, upper, omega_rad_s }) => Ok(NormAnswer {
            status: Status::Ok,
            value: Some(value),
            lower: Some(lower),
            upper: Some(upper),
            omega_rad_s: omega_rad_s.is_finite().then_some(omega_rad_s),
            message: "the upper end is a level that no singular value reaches".to_owned(),
            seconds,
        }),
        Err(error) => {
            let Some(status) = system_status(&error) else { return Err(error.into()) };
            let (value, lower, upper, omega_rad_s) = (None, None, None, None);
            Ok(NormAnswer { status, value, lower, upper, omega_rad_s, message: error.to_string(), seconds })
        }
    }
}

/// A system as its file has it.
pub(super) struct SystemParts {
    a: nalgebra::DMatrix<f64>,
    b: nalgebra::DMatrix<f64>,
    c: nalgebra::DMatrix<f64>,
    d: nalgebra::DMatrix<f64>,
    pub(super) sample_time: Option<SampleTime>,
}

impl SystemParts {
    /// `A`, `B`, `C`, `D` and `dt`; sizes from `n`, `m`, `p` where they are given, else from the matrices.
    pub(super) fn read(file: &ProblemFile) -> Result<Self> {
        Self::read_with_ports(file, file.size("m")?, file.size("p")?)
    }

    /// The same with numbers of inputs and outputs that something else tells.
    pub(super) fn read_with_ports(file: &ProblemFile, m: Size, p: Size) -> Result<Self> {
        let (a, n) = file.state_count(&[])?;
        let b = match file.optional_matrix("B", n, m)? {
            Some(b) => b,
            None => return Err(file.complaint("B", "is missing")),
        };
        // A file without rows in B does not tell the number of inputs: D does.
        let known = |found: usize| (a.nrows() > 0).then_some(found);
        let m = Size { value: m.value.or(known(b.ncols())), ..m };
        let c = file.matrix("C", p, n)?;
        let p = Size { value: p.value.or((!file.has("D")).then_some(c.nrows())), ..p };
        let d = if file.has("D") {
            let p = Size { value: p.value.or(known(c.nrows())), ..p };
            file.matrix("D", p, m)?
        } else {
            file.matrix_or_zeros("D", p, m)?
        };
        let b = if b.nrows() == 0 { nalgebra::DMatrix::zeros(0, d.ncols()) } else { b };
        let c = if a.nrows() == 0 { nalgebra::DMatrix::zeros(d.nrows(), 0) } else { c };
        Ok(Self { a, b, c, d, sample_time: sample_time(file)? })
    }

    pub(super) fn continuous(self) -> Result<StateSpace<Continuous>> {
        Ok(StateSpace::<Continuous>::new(self.a, self.b, self.c, self.d)?)
    }

    pub(super) fn discrete(self, sample_time: SampleTime) -> Result<StateSpace<Discrete>> {
        Ok(StateSpace::<Discrete>::new(self.a, self.b, self.c, self.d, sample_time)?)
    }
}

/// `dt` in seconds; absent, null and zero mean continuous time.
pub(super) fn sample_time(file: &ProblemFile) -> Result<Option<SampleTime>> {
    match file.number("dt")? {
        None => Ok(None),
        Some(0.0) => Ok(None),
        Some(dt) => match SampleTime::new(dt) {
            Ok(sample_time) => Ok(Some(sample_time)),
            Err(_) => {
                Err(file
                    .complaint("dt", &format!("expected seconds, positive (0: continuous time), found {dt}")))
            }
        },
    }
}

impl Answer for NormAnswer {
    fn status(&self) -> Status {
        self.status
    }

    fn lines(&self) -> Vec<String> {
        match (self.value, self.lower, self.upper) {
            (Some(value), Some(lower), Some(upper)) => {
                let place = self.omega_rad_s.map_or_else(|| "infinity".to_owned(), |w| format!("{w} rad/s"));
                vec![format!("{value} at {place}, proven to lie within {lower} and {upper}")]
            }
            _ => vec![self.message.clone()],
        }
    }
}
