//! Batches against twins of their own.

use telepulse_actuator::batch::{BatchDrive, BatchRecord, VariantRun, simulate};
use telepulse_actuator::twin::{Inputs, Twin, TwinModel};
use telepulse_actuator::{ActuatorParameters, ActuatorSpec, Error, ParameterSet};

use crate::{assert_close, uniform};

const TICK_S: f64 = 1e-3;

/// A drive with jumps, ramps and rests.
fn voltages() -> Vec<f64> {
    (0..1500)
        .map(|k| match k / 300 {
            0 => 5000.0,
            1 => 1000.0 + 5.0 * f64::from(k - 300),
            2 => 0.0,
            3 => 3000.0 + 1500.0 * (0.03 * f64::from(k)).sin(),
            // Beyond full scale: the amplifier saturates.
            _ => 6000.0,
        })
        .collect()
}

fn batch_drive() -> BatchDrive {
    BatchDrive::new(TICK_S, voltages(), 1000.0).expect("valid")
}

fn set(set: ParameterSet) -> ActuatorSpec {
    set.parameters().spec().clone()
}

/// Every parameter that scales, within 15 %; sizes too.
fn scattered(n: usize, seed: u64) -> Vec<ActuatorSpec> {
    let mut random = seed;
    (0..n)
        .map(|_| {
            let mut factor = || 0.85 + 0.3 * uniform(&mut random);
            let mut spec = set(ParameterSet::A);
            spec.mu_pa *= factor();
            spec.relative_permittivity *= factor();
            spec.thickness_m *= factor();
            spec.damping_n_s_per_m *= factor();
            spec.mass_kg *= factor();
            spec.rc_s *= factor();
            let size = factor();
            spec.inner_radius_m *= size;
            spec.outer_radius_m = spec.inner_radius_m * (0.068_58 / 0.0127);
            for branch in &mut spec.branches {
                branch.modulus_pa *= factor();
                branch.relaxation_time_s *= factor();
            }
            spec
        })
        .collect()
}

/// The displacement of a twin of its own at the end of every tick.
fn alone(spec: &ActuatorSpec) -> Vec<f64> {
    let parameters = ActuatorParameters::new(spec.clone()).expect("valid");
    let mut twin = Twin::new(&TwinModel::new(&parameters).expect("taut"));
    twin.settle(1000.0);
    let mut at_mm = Vec::new();
    for drive_v in voltages() {
        twin.advance(TICK_S, Inputs { drive_v, disturbance_n: 0.0 });
        at_mm.push(twin.displacement_mm());
    }
    at_mm
}

fn run(specs: &[ActuatorSpec]) -> Vec<Result<VariantRun, Error>> {
    simulate(specs, &batch_drive(), BatchRecord::Trace { every: 1 }).expect("valid request")
}

fn trace(run: &Result<VariantRun, Error>) -> &[f64] {
    &run.as_ref().expect("runs").trace_mm
}

#[test]
fn law_lanes_equal_the_single_path_to_rounding() {
    // Three shapes of membrane or fewer than share their maps: each has a model of its own, the same as alone.
    let mut wider = set(ParameterSet::A);
    wider.prestretch = 2.1;
    // A light plate takes shorter steps than the others, and goes in a row of its own.
    let mut light = set(ParameterSet::A);
    light.mass_kg = 0.012;
    let specs = [set(ParameterSet::A), set(ParameterSet::B), set(ParameterSet::C), wider, light];
    for (idx, (run, spec)) in run(&specs).iter().zip(&specs).enumerate() {
        let alone = alone(spec);
        for (found, expected) in trace(run).iter().zip(&alone) {
            // 1500 steps, each with rounding of 1e-16 of 10 mm in either path.
            assert_close(*found, *expected, 0.0, 1e-11, &format!("variant {idx}"));
        }
        let run = run.as_ref().expect("runs");
        let n = alone.len() as f64;
        assert_close(run.mean_mm, alone.iter().sum::<f64>() / n, 1e-10, 0.0, "mean");
        let square = alone.iter().map(|mm| mm * mm).sum::<f64>() / n;
        assert_close(run.rms_mm, square.sqrt(), 1e-10, 0.0, "rms");
        let max = alone.iter().copied().fold(f64::MIN, f64::max);
        assert_close(run.max_mm, max, 1e-10, 0.0, "largest");
        let tick = (run.max_at_s / TICK_S).round() as usize - 1;
        assert_close(alone[tick], max, 1e-10, 0.0, "when it was largest");
        assert_close(run.min_mm, alone.iter().copied().fold(f64::MAX, f64::min), 1e-10, 1e-11, "smallest");
        assert_close(run.final_mm, alone[alone.len() - 1], 1e-10, 0.0, "last");
    }
}

#[test]
fn law_shared_maps_move_the_plate_as_its_own_do() {
    let seed = 5;
    let specs = scattered(23, seed);
    let mut largest: f64 = 0.0;
    for (run, spec) in run(&specs).iter().zip(&specs) {
        let alone = alone(spec);
        let stroke = alone.iter().copied().fold(0.0, f64::max);
        for (found, expected) in trace(run).iter().zip(&alone) {
            largest = largest.max((found - expected).abs() / stroke);
        }
    }
    // What the internal mode's stiffness is off where the moduli's ratio is not the reference's.
    assert!(largest < 1e-4, "seed {seed}: {largest} of the stroke");
    assert!(largest > 1e-12, "seed {seed}: the maps were not shared");
}

#[test]
fn edge_bad_variants_are_named_in_their_place_and_change_nothing_else() {
    let good = scattered(11, 3);
    let expected = run(&good);
    let mut specs = good.clone();
    let damaged = |damage: &dyn Fn(&mut ActuatorSpec)| {
        let mut spec = set(ParameterSet::A);
        damage(&mut spec);
        spec
    };
    specs.insert(2, damaged(&|s| s.thickness_m = -1e-3));
    specs.insert(5, damaged(&|s| s.mu_pa = f64::NAN));
    // 12 kV is beyond what this membrane bears.
    specs.insert(9, damaged(&|s| s.full_scale_v = 12_000.0));
    // So does the field here, in a membrane that has fifty times the permittivity.
    specs.push(damaged(&|s| s.relative_permittivity *= 50.0));
    let found = run(&specs);
    assert_eq!(found.len(), specs.len());
    let refusal = |idx: usize| found[idx].as_ref().err().unwrap_or_else(|| panic!("variant {idx} has run"));
    let key = |idx: usize| match refusal(idx) {
        Error::Parameter { key, .. } => *key,
        other => panic!("{idx}: {other}"),
    };
    assert_eq!(key(2), "thickness_m");
    assert_eq!(key(5), "mu_pa");
    for idx in [9, 14] {
        let physical = matches!(
            refusal(idx),
            Error::Slack { .. } | Error::PullIn { .. } | Error::BeyondLimitPoint { .. }
        );
        assert!(physical, "{idx}: {}", refusal(idx));
    }
    let kept: Vec<&Result<VariantRun, Error>> = found
        .iter()
        .enumerate()
        .filter(|(idx, _)| ![2, 5, 9, 14].contains(idx))
        .map(|(_, run)| run)
        .collect();
    assert_eq!(kept.len(), expected.len());
    for (found, expected) in kept.into_iter().zip(&expected) {
        for (a, b) in trace(found).iter().zip(trace(expected)) {
            assert_close(*a, *b, 0.0, 1e-12, "beside bad ones");
        }
    }
}

#[test]
fn law_results_do_not_depend_on_the_number_of_cores() {
    let specs = scattered(30, 8);
    let on = |n_threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().expect("threads");
        pool.install(|| run(&specs))
    };
    let one = on(1);
    assert_eq!(one, on(2));
    assert_eq!(one, on(5));
}

#[test]
fn edge_drives_and_traces_out_of_range_are_refused() {
    let refused = |drive: Result<BatchDrive, Error>, part: &str| {
        let said = drive.expect_err("out of range").to_string();
        assert!(said.contains(part), "{said}");
    };
    refused(BatchDrive::new(0.0, vec![1.0], 0.0), "interval_s");
    refused(BatchDrive::new(f64::NAN, vec![1.0], 0.0), "interval_s");
    refused(BatchDrive::new(1e-3, vec![], 0.0), "number of drive voltages");
    refused(BatchDrive::new(1e-3, vec![1.0, -1.0], 0.0), "drive voltage");
    refused(BatchDrive::new(1e-3, vec![1.0], f64::INFINITY), "drive voltage");
    let drive = BatchDrive::new(1e-3, vec![0.0; 10_000], 0.0).expect("valid");
    let many = vec![set(ParameterSet::C); 10_000];
    for every in [0, 1] {
        let said = simulate(&many, &drive, BatchRecord::Trace { every }).expect_err("800 MB").to_string();
        assert!(said.contains("256 MiB"), "{said}");
    }
    assert_eq!(simulate(&[], &drive, BatchRecord::Statistics), Ok(vec![]));
}
