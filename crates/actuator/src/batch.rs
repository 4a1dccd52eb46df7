//! Many variants of the actuator under one drive: four abreast on each core.
//!
//! Variants whose membranes have one shape (ratio of radii, pre-stretch, chain limit) share one set of membrane solves; all
//! others get a model of their own. Statistics are kept, and traces if asked for, but never all samples.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::twin::{N_ABREAST, Passage, TwinFamily, TwinModel, run_abreast, shape};
use crate::{ActuatorParameters, ActuatorSpec, Error};

/// The drive of all variants: voltages that are each held for one interval.
#[derive(Debug, Clone, PartialEq)]
pub struct BatchDrive {
    interval_s: f64,
    voltages: Vec<f64>,
    bias_v: f64,
}

/// Longest interval, s: the drive is held over it.
const INTERVAL_MAX_S: f64 = 0.1;

impl BatchDrive {
    /// Voltages in V, each held for `interval_s`; before, all variants have settled at `bias_v`.
    ///
    /// # Errors
    /// [`Error::Request`] where a number is out of range, or there is no voltage.
    pub fn new(interval_s: f64, voltages: Vec<f64>, bias_v: f64) -> Result<Self, Error> {
        if !(interval_s > 0.0 && interval_s <= INTERVAL_MAX_S) {
            return Err(Error::Request {
                quantity: "interval_s",
                allowed: "positive and at most 0.1 s",
                found: interval_s,
            });
        }
        if voltages.is_empty() {
            return Err(Error::Request {
                quantity: "number of drive voltages",
                allowed: "at least 1",
                found: 0.0,
            });
        }
        for &found in voltages.iter().chain([&bias_v]) {
            if !(found.is_finite() && found >= 0.0) {
                return Err(Error::Request {
                    quantity: "drive voltage, V,",
                    allowed: "finite and not negative",
                    found,
                });
            }
        }
        Ok(Self { interval_s, voltages, bias_v })
    }

    /// Length of the run, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.interval_s * self.voltages.len() as f64
    }
}

/// What is kept of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum BatchRecord {
    /// Statistics alone.
    #[default]
    Statistics,
    /// Statistics, and the displacement at the end of every so manieth interval.
    Trace {
        /// Intervals from sample to sample; at least 1.
        every: usize,
    },
}

/// Largest memory for traces, bytes.
const TRACE_BYTES_MAX: usize = 256 << 20;

/// How one variant moved, taken at the ends of the intervals. Displacements are from the variant's own rest position, mm, positive
/// down.
#[derive(Debug, Clone, PartialEq)]
pub struct VariantRun {
    /// Displacement of the variant below the frame at rest, m.
    pub rest_sag_m: f64,
    /// Largest displacement.
    pub max_mm: f64,
    /// When it was reached, s.
    pub max_at_s: f64,
    /// Smallest displacement.
    pub min_mm: f64,
    /// Mean.
    pub mean_mm: f64,
    /// Root of the mean square.
    pub rms_mm: f64,
    /// Displacement at the end.
    pub final_mm: f64,
    /// True where the plate has left the range of its maps, beyond which they are continued linearly.
    pub left_map: bool,
    /// What [`BatchRecord::Trace`] asked for.
    pub trace_mm: Vec<f64>,
}

/// Runs all variants; what is wrong with one is said in its place, and the others go on.
///
/// **Method**: see [`crate::twin::Twin`]; steps divide the interval into as many as the variant's plate needs. Results are the same
/// to the last bit whatever the number of cores.
///
/// **Accuracy**: equal to a twin of its own but for rounding and for what shared maps cost, 1e-4 of the stroke for branch moduli
/// within 20 % of the first variant's (tests). Maps are shared by variants of one shape whose load, size and squared field are
/// within a factor of 1.8 of the first one's.
///
/// # Errors
/// [`Error::Request`] where traces of all variants would not fit in 256 MiB. In place of a variant: those of
/// [`ActuatorParameters::new`] and [`TwinModel::new`], and [`Error::Diverged`].
///
/// **Example**
/// ```
/// use telepulse_actuator::batch::{BatchDrive, BatchRecord, simulate};
/// use telepulse_actuator::{ActuatorSpec, ParameterSet};
/// let nominal = ParameterSet::A.parameters().spec().clone();
/// let soft = ActuatorSpec { mu_pa: 35_000.0, ..nominal.clone() };
/// let impossible = ActuatorSpec { thickness_m: -1.0, ..nominal.clone() };
/// let drive = BatchDrive::new(1e-3, vec![5000.0; 1000], 0.0)?;
/// let runs = simulate(&[nominal, soft, impossible], &drive, BatchRecord::Statistics)?;
/// let reached = |k: usize| runs[k].as_ref().map_or(0.0, |run| run.final_mm);
/// assert!(reached(1) > 1.05 * reached(0));
/// assert!(runs[2].is_err());
/// # Ok::<(), telepulse_actuator::Error>(())
/// ```
pub fn simulate(
    variants: &[ActuatorSpec],
    drive: &BatchDrive,
    record: BatchRecord,
) -> Result<Vec<Result<VariantRun, Error>>, Error> {
    let every = match record {
        BatchRecord::Statistics => 0,
        BatchRecord::Trace { every } => {
            let samples = variants.len() * (drive.voltages.len() / every.max(1));
            if every == 0 || samples * size_of::<f64>() > TRACE_BYTES_MAX {
                return Err(Error::Request {
                    quantity: "intervals between samples of a trace",
                    allowed: "at least 1, and so many that the traces of all variants fit in 256 MiB",
                    found: every as f64,
                });
            }
            every
        }
    };
    let checked: Vec<Result<ActuatorParameters, Error>> =
        variants.iter().map(|spec| ActuatorParameters::new(spec.clone())).collect();
    let mut runs: Vec<Result<VariantRun, Error>> = Vec::with_capacity(variants.len());
    let families = families(&checked);
    let mut models = Vec::with_capacity(variants.len());
    checked
        .into_par_iter()
        .map(|parameters| {
            let parameters = parameters?;
            let family = families.get(&shape(&parameters));
            match family.and_then(|family| family.member(&parameters)) {
                Some(model) => Ok(model),
                None => TwinModel::new(&parameters),
            }
        })
        .collect_into_vec(&mut models);
    // By the number of steps of an interval, so that no variant waits for another's.
    let mut by_steps: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (idx, model) in models.iter().enumerate() {
        match model {
            Ok(model) => {
                by_steps.entry(model.n_steps(drive.interval_s)).or_default().push(idx);
                // Overwritten below by what happened.
                runs.push(Err(Error::NoEquilibrium));
            }
            Err(error) => runs.push(Err(error.clone())),
        }
    }
    let rows: Vec<(usize, &[usize])> = by_steps
        .iter()
        .flat_map(|(n_steps, members)| members.chunks(N_ABREAST).map(|row| (*n_steps, row)))
        .collect();
    let done: Vec<Vec<(usize, Result<VariantRun, Error>)>> = rows
        .par_iter()
        .map(|(n_steps, row)| {
            // A row that is not full is filled up with its first: whose second run is dropped.
            let twins: Vec<&TwinModel> =
                (0..N_ABREAST).filter_map(|k| models[*row.get(k).unwrap_or(&row[0])].as_ref().ok()).collect();
            let Ok(abreast) = <[&TwinModel; N_ABREAST]>::try_from(twins) else {
                unreachable!("rows are made of models");
            };
            let passages =
                run_abreast(abreast, drive.bias_v, drive.interval_s, *n_steps, &drive.voltages, every);
            row.iter()
                .zip(passages)
                .zip(abreast)
                .map(|((idx, passage), model)| (*idx, finish(model, passage, drive)))
                .collect()
        })
        .collect();
    for (idx, run) in done.into_iter().flatten() {
        runs[idx] = run;
    }
    Ok(runs)
}

/// Fewest variants of one shape for which shared maps cost less than maps of their own.
const FAMILY_MIN: usize = 5;

/// Families by shape. One that has no maps is left out: its members then say themselves what is wrong.
fn families(checked: &[Result<ActuatorParameters, Error>]) -> BTreeMap<[u64; 3], TwinFamily> {
    let mut members: BTreeMap<[u64; 3], Vec<&ActuatorParameters>> = BTreeMap::new();
    for parameters in checked.iter().flatten() {
        members.entry(shape(parameters)).or_default().push(parameters);
    }
    members
        .into_par_iter()
        .filter(|(_, members)| members.len() >= FAMILY_MIN)
        .filter_map(|(shape, members)| TwinFamily::covering(&members).ok().map(|family| (shape, family)))
        .collect()
}

fn finish(model: &TwinModel, passage: Passage, drive: &BatchDrive) -> Result<VariantRun, Error> {
    let n = drive.voltages.len() as f64;
    if !passage.final_mm.is_finite() || !passage.sum_mm2.is_finite() {
        return Err(Error::Diverged { duration_s: drive.duration_s() });
    }
    Ok(VariantRun {
        rest_sag_m: model.rest_sag_m(),
        max_mm: passage.max_mm,
        max_at_s: (passage.max_idx + 1) as f64 * drive.interval_s,
        min_mm: passage.min_mm,
        mean_mm: passage.sum_mm / n,
        rms_mm: (passage.sum_mm2 / n).sqrt(),
        final_mm: passage.final_mm,
        left_map: passage.left_map,
        trace_mm: passage.trace_mm,
    })
}
