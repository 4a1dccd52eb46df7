//! Times field-level simulations of 10 s at steps of 4 ms on one core, and prints one line of JSON for each.

#![allow(clippy::print_stdout)]

use std::time::Instant;

use telepulse_actuator::field::{FieldEffort, FieldSetup, FieldTwin};
use telepulse_actuator::{Error, ParameterSet};

const STEP_S: f64 = 4e-3;
const STEPS: usize = 2500;
const ROUNDS: usize = 7;

/// Command (V) at a time (s).
type Command = fn(f64) -> f64;

fn main() -> Result<(), Error> {
    let pulse = |t: f64| {
        // 1.3 Hz and two harmonics about half scale.
        let turn = 2.0 * std::f64::consts::PI * 1.3 * t;
        2500.0 + 1000.0 * turn.sin() + 600.0 * (2.0 * turn).sin() + 300.0 * (3.0 * turn).sin()
    };
    let commands: [(&str, Command); 2] = [("step to 5 kV", |_| 5000.0), ("pulse of 1.3 Hz", pulse)];
    for set in [ParameterSet::C, ParameterSet::A, ParameterSet::B] {
        let parameters = set.parameters();
        for (name, command) in commands {
            for (circuit, setup) in [
                ("constant RC", FieldSetup::plain(&parameters)),
                ("deformable", FieldSetup::deformable(&parameters)?),
            ] {
                for degree in [16, 24] {
                    let rest = FieldTwin::with_setup(&parameters, degree, setup.clone())?;
                    let mut times = Vec::with_capacity(ROUNDS);
                    let (mut end_mm, mut effort) = (0.0, FieldEffort::default());
                    for _ in 0..ROUNDS {
                        let mut twin = rest.clone();
                        let start = Instant::now();
                        for k in 0..STEPS {
                            twin.step(STEP_S, command((k as f64 + 0.5) * STEP_S))?;
                        }
                        times.push(start.elapsed().as_secs_f64());
                        (end_mm, effort) = (twin.displacement_mm(), twin.effort());
                    }
                    times.sort_by(f64::total_cmp);
                    println!(
                        "{{\"set\": \"{set:?}\", \"command\": \"{name}\", \"circuit\": \"{circuit}\", \"degree\": {degree}, \
                         \"median_s\": {:.4}, \"least_s\": {:.4}, \"end_mm\": {end_mm:.9}, \"sweeps\": {}, \"iterations\": {}, \"factorizations\": {}}}",
                        times[ROUNDS / 2],
                        times[0],
                        effort.sweeps,
                        effort.iterations,
                        effort.factorizations
                    );
                }
            }
        }
    }
    Ok(())
}
