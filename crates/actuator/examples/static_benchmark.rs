//! Times static solves of set A's membrane, cold and warm, at two degrees, and prints one line of JSON for each.
//!
//! `benches/versus_python_membrane.py` sets these times beside its own on the same machine.

#![allow(clippy::print_stdout)]

use std::hint::black_box;
use std::time::Instant;

use telepulse_actuator::Error;
use telepulse_actuator::statics::{
    Electrodes, Load, Material, Prestretch, Sheet, SheetSpec, StaticPoint, StaticSolver,
};

const FORCE_N: f64 = 0.980_665;
const CALLS: usize = 200;
const ROUNDS: usize = 31;

fn main() -> Result<(), Error> {
    let sheet = Sheet::new(SheetSpec {
        material: Material::Gent { mu_pa: 37_220.0, limit: 110.0 },
        inner_radius_m: 0.0127,
        outer_radius_m: 0.068_58,
        thickness_m: 1e-3,
        prestretch_inner: 2.0,
        prestretch_outer: 2.0,
        prestretch: Prestretch::AtLeastOne,
        relative_permittivity: 5.8,
    })?;
    for degree in [16, 24] {
        let mut solver = StaticSolver::with_degree(&sheet, degree)?;
        // 20 V to and fro around 2.5 kV, as a control loop moves; each solve starts from the one before.
        let mut voltages = [2490.0, 2500.0, 2510.0, 2500.0].into_iter().cycle();
        let mut warm = |load: Load| -> Result<(f64, StaticPoint), Error> {
            let mut last = solver.solve(load, Electrodes::VoltageV(2500.0))?;
            let time = median(|| {
                for _ in 0..CALLS {
                    let voltage_v = voltages.next().unwrap_or(0.0);
                    last = solver.solve_near(black_box(load), Electrodes::VoltageV(voltage_v))?;
                }
                Ok(())
            })?;
            Ok((time, last))
        };
        let (by_force, point) = warm(Load::ForceN(FORCE_N))?;
        let (by_displacement, _) = warm(Load::DisplacementM(point.displacement_m))?;
        // Another working point each time: 0 or 5 kV, 0.5 or 1 N.
        let mut far = [(0.0, 1.0), (5000.0, 0.5)].into_iter().cycle();
        let jump = median(|| {
            for _ in 0..CALLS {
                let (voltage_v, part) = far.next().unwrap_or((0.0, 1.0));
                solver.solve_near(Load::ForceN(part * FORCE_N), Electrodes::VoltageV(voltage_v))?;
            }
            Ok(())
        })?;
        let cold = median(|| {
            for _ in 0..CALLS {
                let mut solver = StaticSolver::with_degree(black_box(&sheet), degree)?;
                black_box(solver.solve(Load::ForceN(FORCE_N), Electrodes::VoltageV(2500.0))?);
            }
            Ok(())
        })?;
        let derivatives = median(|| {
            for _ in 0..CALLS {
                black_box(solver.derivatives()?);
            }
            Ok(())
        })?;
        println!(
            "{{\"degree\": {degree}, \"warm_force_us\": {by_force:.2}, \"warm_displacement_us\": {by_displacement:.2}, \
             \"warm_far_us\": {jump:.2}, \"cold_us\": {cold:.2}, \"derivatives_us\": {derivatives:.2}, \
             \"iterations\": {}, \"displacement_m\": {}}}",
            point.iterations, point.displacement_m
        );
    }
    Ok(())
}

/// Median over the rounds, microseconds for one call.
fn median(mut round: impl FnMut() -> Result<(), Error>) -> Result<f64, Error> {
    let mut times = Vec::with_capacity(ROUNDS);
    for _ in 0..ROUNDS {
        let start = Instant::now();
        round()?;
        times.push(start.elapsed().as_secs_f64() / CALLS as f64 * 1e6);
    }
    times.sort_by(f64::total_cmp);
    Ok(times[ROUNDS / 2])
}
