//! Four twins abreast under one drive.

use pulp::f64x4;

use super::arithmetic::{self, Abreast, Kernel, PerTwin, Processor};
use super::kernel::{Motion, Plant};
use super::pace::{Pace, PaceOf};
use super::{Twin, TwinModel};

/// Twins that are stepped together.
pub(crate) const N_ABREAST: usize = 4;

/// What a run of one twin comes to.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Passage {
    /// Largest and smallest displacement from rest at the ends of the intervals, mm, and the interval of the largest.
    pub(crate) max_mm: f64,
    pub(crate) max_idx: usize,
    pub(crate) min_mm: f64,
    /// Sums of displacement and of its square, mm and mm^2.
    pub(crate) sum_mm: f64,
    pub(crate) sum_mm2: f64,
    pub(crate) final_mm: f64,
    pub(crate) left_map: bool,
    /// Displacement at every so manieth end of an interval, mm.
    pub(crate) trace_mm: Vec<f64>,
}

/// Four twins from the settled state at `bias_v`, through intervals of `interval_s` with these voltages held.
///
/// Each interval takes `n_steps` steps. `trace_every` 0 keeps no trace.
pub(crate) fn run_abreast(
    models: [&TwinModel; N_ABREAST],
    bias_v: f64,
    interval_s: f64,
    n_steps: usize,
    drive_v: &[f64],
    trace_every: usize,
) -> [Passage; N_ABREAST] {
    let settled = models.map(|model| {
        let mut twin = Twin::new(model);
        twin.settle(bias_v);
        twin
    });
    let mass = models.map(|model| model.parameters().spec().mass_kg);
    let paces = models.map(|model| PaceOf::new(model.parameters(), model.parameters().spec().mass_kg));
    let empty = || Passage {
        max_mm: f64::NEG_INFINITY,
        max_idx: 0,
        min_mm: f64::INFINITY,
        sum_mm: 0.0,
        sum_mm2: 0.0,
        final_mm: 0.0,
        left_map: false,
        trace_mm: Vec::with_capacity(drive_v.len().checked_div(trace_every).unwrap_or(0)),
    };
    arithmetic::run(Run {
        plant: Plant::new(&models, &mass),
        pace: Pace::new(&paces, interval_s / n_steps as f64),
        motion: gather(&settled),
        rest: models.map(|model| model.rest_sag_m()),
        full_scale: models.map(|model| model.parameters().spec().full_scale_v),
        n_steps,
        drive_v,
        trace_every,
        passages: [empty(), empty(), empty(), empty()],
    })
}

struct Run<'a> {
    plant: Plant<f64x4>,
    pace: Pace<f64x4>,
    motion: Motion<f64x4>,
    rest: [f64; N_ABREAST],
    full_scale: [f64; N_ABREAST],
    n_steps: usize,
    drive_v: &'a [f64],
    trace_every: usize,
    passages: [Passage; N_ABREAST],
}

impl Kernel for Run<'_> {
    type Output = [Passage; N_ABREAST];

    #[inline(always)]
    fn run(self, processor: impl Processor) -> Self::Output {
        let Self { plant, pace, mut motion, rest, full_scale, n_steps, drive_v, trace_every, mut passages } =
            self;
        let by = Abreast(processor);
        let nothing = f64x4::gather(|_| 0.0);
        let mut until_trace = trace_every;
        for (idx, &volts) in drive_v.iter().enumerate() {
            // Each amplifier saturates at its own full scale.
            let drive = f64x4::gather(|k| volts.clamp(0.0, full_scale[k]));
            for _ in 0..n_steps {
                plant.step(by, &pace, &mut motion, drive, nothing);
            }
            if plant.is_outside(by, motion.x) {
                for (k, passage) in passages.iter_mut().enumerate() {
                    passage.left_map |= !(-1.0..=1.0).contains(&plant.normalized(by, motion.x).of_twin(k));
                }
            }
            let traced = until_trace == 1;
            until_trace = if traced { trace_every } else { until_trace.saturating_sub(1) };
            for (k, passage) in passages.iter_mut().enumerate() {
                let at_mm = (motion.x.of_twin(k) - rest[k]) * 1e3;
                passage.sum_mm += at_mm;
                passage.sum_mm2 += at_mm * at_mm;
                passage.min_mm = if at_mm < passage.min_mm { at_mm } else { passage.min_mm };
                if at_mm > passage.max_mm {
                    (passage.max_mm, passage.max_idx) = (at_mm, idx);
                }
                passage.final_mm = at_mm;
                if traced {
                    passage.trace_mm.push(at_mm);
                }
            }
        }
        passages
    }
}

fn gather(twins: &[Twin; N_ABREAST]) -> Motion<f64x4> {
    let each = |f: &dyn Fn(&Motion<f64>) -> f64| f64x4::gather(|k| f(&twins[k].motion));
    let fours = |f: &dyn Fn(&Motion<f64>) -> f64x4| {
        f64x4::four(std::array::from_fn(|place| {
            each(&|motion| {
                let four = f(motion);
                [four.0, four.1, four.2, four.3][place]
            })
        }))
    };
    Motion {
        x: each(&|m| m.x),
        v: each(&|m| m.v),
        membrane_v: each(&|m| m.membrane_v),
        zeta: std::array::from_fn(|i| fours(&|m| m.zeta[i])),
        free: each(&|m| m.free),
        strain: fours(&|m| m.strain),
    }
}
