//! Times the reduced twin and prints one line of JSON for each measurement: building with its stated error, 10 s at steps of
//! 1 ms on one core, and a batch of 10 000 scattered variants over 10 s on all cores, with the peak memory of the process.

#![allow(clippy::print_stdout)]

use std::hint::black_box;
use std::time::Instant;

use telepulse_actuator::batch::{BatchDrive, BatchRecord, simulate};
use telepulse_actuator::twin::{Inputs, Twin, TwinModel};
use telepulse_actuator::{ActuatorSpec, Error, ParameterSet};

const TICKS: usize = 10_000;
const TICK_S: f64 = 1e-3;
const ROUNDS: usize = 21;
const VARIANTS: usize = 10_000;

fn main() -> Result<(), Error> {
    let parameters = ParameterSet::A.parameters();
    let start = Instant::now();
    let model = TwinModel::new(&parameters)?;
    let build_ms = start.elapsed().as_secs_f64() * 1e3;
    let start = Instant::now();
    let stated = TwinModel::with_stated_error(&parameters)?.stated_error();
    let stated_ms = start.elapsed().as_secs_f64() * 1e3;
    println!("{{\"build_ms\": {build_ms:.2}, \"build_with_stated_error_ms\": {stated_ms:.0}}}");
    if let Some(error) = stated {
        println!(
            "{{\"step_error_percent\": {:.4}, \"reference_error_percent\": {:.4}}}",
            error.step.percent_of_stroke(),
            error.reference.percent_of_stroke()
        );
    }

    // A drive that never rests, so that nothing can be reused from tick to tick.
    let drive: Vec<f64> = (0..TICKS).map(|k| 2500.0 + 2000.0 * (7.5 * k as f64 * TICK_S).sin()).collect();
    let mut times = Vec::with_capacity(ROUNDS);
    for _ in 0..ROUNDS {
        let mut twin = Twin::new(&model);
        let start = Instant::now();
        for &drive_v in &drive {
            twin.advance(TICK_S, Inputs { drive_v: black_box(drive_v), disturbance_n: 0.0 });
        }
        times.push(start.elapsed().as_secs_f64() * 1e3);
        black_box(twin.displacement_mm());
    }
    times.sort_by(f64::total_cmp);
    println!(
        "{{\"single_10_s_ms_median\": {:.3}, \"single_10_s_ms_best\": {:.3}}}",
        times[ROUNDS / 2],
        times[0]
    );

    let variants = scattered(parameters.spec());
    let drive = BatchDrive::new(TICK_S, drive, 0.0)?;
    for _ in 0..3 {
        let start = Instant::now();
        let runs = simulate(&variants, &drive, BatchRecord::Statistics)?;
        let batch_s = start.elapsed().as_secs_f64();
        let failed = runs.iter().filter(|run| run.is_err()).count();
        let strokes: Vec<f64> = runs.iter().flatten().map(|run| run.max_mm).collect();
        println!(
            "{{\"variants\": {VARIANTS}, \"batch_s\": {batch_s:.3}, \"failed\": {failed}, \"largest_stroke_mm\": {:.4}, \
             \"peak_memory_mb\": {:.0}}}",
            strokes.iter().copied().fold(0.0, f64::max),
            peak_memory_mb()
        );
    }
    Ok(())
}

/// Variants spread evenly over +-10 % in seven parameters, by the fractional parts of multiples of irrational numbers.
fn scattered(nominal: &ActuatorSpec) -> Vec<ActuatorSpec> {
    let roots = [2.0_f64, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0].map(f64::sqrt);
    (1..=VARIANTS)
        .map(|k| {
            let factor = |j: usize| 0.9 + 0.2 * (k as f64 * roots[j]).fract();
            let mut spec = nominal.clone();
            spec.mu_pa *= factor(0);
            spec.relative_permittivity *= factor(1);
            spec.thickness_m *= factor(2);
            spec.damping_n_s_per_m *= factor(3);
            spec.rc_s *= factor(4);
            for branch in &mut spec.branches {
                branch.modulus_pa *= factor(5);
                branch.relaxation_time_s *= factor(6);
            }
            spec
        })
        .collect()
}

/// Largest resident memory so far, from the kernel's own account; 0 where there is none.
fn peak_memory_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap_or_default();
    line.split_whitespace().next().and_then(|kb| kb.parse::<f64>().ok()).unwrap_or(0.0) / 1024.0
}
