//! Calibration: the printed plant, recovery from noisy records, refusals.

use nalgebra::{Complex, DVector};
use telepulse_actuator::calibration::{
    Calibration, FreeParameter, Quantity, Record, Refusal, SweepRecord, TimeRecord, calibrate,
    printed_response, printed_sweep,
};
use telepulse_actuator::field::FieldTwin;
use telepulse_actuator::frequency::MembraneResponse;
use telepulse_actuator::twin::{Inputs, Twin, TwinModel};
use telepulse_actuator::{ActuatorParameters, ActuatorSpec, Error, ParameterSet};

use crate::{assert_close, uniform};

const PLANT: [Quantity; 3] = [Quantity::ShearModulus, Quantity::Permittivity, Quantity::Damping];

fn fit(start: &ActuatorSpec, quantities: &[Quantity], records: &[Record]) -> Result<Calibration, Error> {
    let free = quantities.iter().map(|&quantity| FreeParameter::about(quantity, start));
    let free = free.collect::<Result<Vec<_>, _>>()?;
    calibrate(&ActuatorParameters::new(start.clone())?, &free, records)
}

fn gaussian(state: &mut u64) -> f64 {
    let (u, v) = (1.0 - uniform(state), uniform(state));
    (-2.0 * u.ln()).sqrt() * (2.0 * std::f64::consts::PI * v).cos()
}

fn noisy_sweep(truth: &ActuatorParameters, noise: f64, n_rows: i32, seed: &mut u64) -> Record {
    let response = MembraneResponse::new(truth, 2500.0).expect("taut");
    let rows = (0..n_rows).map(|idx| {
        let hz = 0.1 * 130.0_f64.powf(f64::from(idx) / f64::from(n_rows - 1));
        let exact = response.displacement_mm_per_unit(2.0 * std::f64::consts::PI * hz).expect("regular");
        (hz, exact + Complex::new(gaussian(seed), gaussian(seed)) * noise)
    });
    let (name, rows) = ("sweep".to_owned(), rows.collect());
    Record::Sweep(SweepRecord { name, bias_v: 2500.0, noise_mm_per_unit: noise, rows })
}

fn noisy_step(truth: &TwinModel, to_v: f64, times: &[f64], noise: f64, seed: &mut u64) -> Record {
    let mut twin = Twin::new(truth);
    let mut now = 0.0;
    let rows = times.iter().map(|&time| {
        twin.advance(time - now, Inputs { drive_v: to_v, disturbance_n: 0.0 });
        now = time;
        (time, twin.displacement_mm() + noise * gaussian(seed))
    });
    let rows = rows.collect();
    Record::Time(TimeRecord { name: format!("to {to_v} V"), from_v: 0.0, to_v, noise_mm: noise, rows })
}

/// Error of the logarithms in units of their covariance: squared length.
fn distance(found: &Calibration, truth: &ActuatorSpec) -> f64 {
    let error = found.fitted.iter().map(|fitted| {
        let expected = fitted.quantity.value(truth).expect("same branches");
        (fitted.value / expected).ln()
    });
    let error = DVector::from_iterator(found.fitted.len(), error);
    let inverse = found.covariance.clone().try_inverse().expect("regular");
    error.dot(&(inverse * &error))
}

fn figure_9() -> Record {
    // 2 mm at 5 kV once the oscillation has died; read off the figure to about 2 %.
    let rows = (0..20).map(|idx| (1.0 + 0.1 * f64::from(idx), 2.0)).collect();
    let name = "figure 9".to_owned();
    Record::Time(TimeRecord { name, from_v: 0.0, to_v: 5000.0, noise_mm: 0.04, rows })
}

fn away(set: ParameterSet) -> ActuatorSpec {
    let spec = set.parameters().spec().clone();
    ActuatorSpec { mu_pa: 20e3, relative_permittivity: 4.0, damping_n_s_per_m: 0.5, ..spec }
}

#[test]
fn paper_eq16_set_c_is_found_again_to_its_five_digits() {
    let printed = Record::Sweep(printed_sweep(2500.0, 1e-4));
    let found = fit(&away(ParameterSet::C), &PLANT, &[printed]).expect("fits");
    let spec = found.parameters.spec();
    // Half a unit of the last digit that set C is given to.
    assert_close(spec.mu_pa, 38_635.0, 0.0, 0.5, "mu");
    assert_close(spec.relative_permittivity, 6.0109, 0.0, 0.5e-4, "permittivity");
    assert_close(spec.damping_n_s_per_m, 1.596, 0.0, 0.5e-3, "damping");
    // An elastic membrane in this circuit *is* of the form (16): nothing is left over.
    // The fit ends where a hundredth of the noise is all that could still be gained.
    assert!(found.records[0].rms_over_noise < 1e-2, "{:?}", found.records);
    assert_eq!(found.undetermined().count(), 0);
}

#[test]
fn paper_eq16_set_a_is_found_again_given_its_branches() {
    let printed = Record::Sweep(printed_sweep(2500.0, 1e-3));
    let found = fit(&away(ParameterSet::A), &PLANT, &[printed]).expect("fits");
    let spec = found.parameters.spec();
    // Set A was fitted with other weights and rounded: 0.3 %.
    assert_close(spec.mu_pa, 37_220.0, 1e-3, 0.0, "mu");
    assert_close(spec.relative_permittivity, 5.80, 3e-3, 0.0, "permittivity");
    assert_close(spec.damping_n_s_per_m, 1.589, 2e-3, 0.0, "damping");
    // (16) has no creep, so branches leave 0.0046 mm per unit, half a percent of the gain, that nothing else takes up.
    let left = found.records[0].rms_over_noise;
    assert!((4.0..5.0).contains(&left) && !found.meets_records(), "{left}");
}

#[test]
fn paper_eq16_does_not_determine_branches_or_chain_limit() {
    let a = ParameterSet::A.parameters().spec().clone();
    let printed = Record::Sweep(printed_sweep(2500.0, 1e-3));
    let found = fit(&a, &Quantity::all(&a), &[printed]).expect("fits");
    // Left free, the branches go where 0.1-13 Hz hardly sees them: towards the elastic membrane that (16) is.
    assert!(found.meets_records() && found.records[0].rms_over_noise < 0.5);
    let keys = found.keys();
    let unknown: Vec<String> = found.undetermined().map(|combination| combination.name(&keys)).collect();
    assert!(unknown.iter().any(|name| name.contains("gent_limit")), "{unknown:?}");
    assert!(unknown.iter().any(|name| name.contains("modulus_pa")), "{unknown:?}");
    // Three numbers is what (16) holds: stiffness, gain and damping.
    assert_eq!(found.combinations.len() - unknown.len(), 3, "{unknown:?}");
}

#[test]
fn paper_eq16_and_figure_9_cannot_be_met_by_one_plant() {
    let a = ParameterSet::A.parameters().spec().clone();
    let printed = || Record::Sweep(printed_sweep(2500.0, 0.02));
    let branches = (0..3).map(Quantity::BranchModulus);
    let with_branches: Vec<Quantity> = PLANT.into_iter().chain(branches).collect();
    for quantities in [PLANT.to_vec(), with_branches] {
        let both = fit(&a, &quantities, &[printed(), figure_9()]).expect("fits");
        assert!(!both.meets_records());
        // The best compromise still falls short of 2 mm by 0.5 mm or more.
        assert!(both.records[1].rms_over_noise * 0.04 > 0.5, "{:?}", both.records);
    }
    // Figure 9 alone is met by permittivity alone, at 1.6 times or more of the printed gain.
    let alone = fit(&a, &[Quantity::Permittivity], &[figure_9()]).expect("fits");
    let gain = MembraneResponse::new(&alone.parameters, 2500.0).expect("taut");
    let ratio = gain.displacement_mm_per_unit(0.0).expect("regular").re / printed_response(0.0).re;
    assert!(alone.meets_records() && ratio > 1.6, "{ratio}");
}

#[test]
fn law_errors_over_many_draws_are_as_stated_for_a_sweep() {
    let truth = ParameterSet::C.parameters();
    let (draws, mut seed) = (60, 20_261_128);
    let (mut sum, mut within_one, mut within_two) = (0.0, 0, 0);
    for _ in 0..draws {
        let record = noisy_sweep(&truth, 0.005, 25, &mut seed);
        let found = fit(&away(ParameterSet::C), &PLANT, &[record]).expect("fits");
        assert!(found.meets_records());
        sum += distance(&found, truth.spec());
        for fitted in &found.fitted {
            let expected = fitted.quantity.value(truth.spec()).expect("present");
            let error = (fitted.value / expected).ln().abs() / fitted.relative_standard_error.expect("free");
            within_one += u32::from(error < 1.0);
            within_two += u32::from(error < 2.0);
        }
    }
    // Chi squared of 180 values: 180 +- 4 sqrt(360).
    assert!((sum - 180.0).abs() < 76.0, "{sum}");
    // 68.3 % and 95.4 % of 180, three by three correlated: within four standard deviations of 60 independent draws.
    assert!((within_one as f64 / 180.0 - 0.683).abs() < 0.24, "{within_one}");
    assert!(within_two as f64 / 180.0 > 0.954 - 0.11, "{within_two}");
}

#[test]
fn law_sweep_step_and_creep_together_give_back_branches() {
    let truth = ParameterSet::A.parameters();
    let model = TwinModel::new(&truth).expect("taut");
    let mut quantities = PLANT.to_vec();
    quantities.extend([Quantity::BranchModulus(0), Quantity::BranchTime(0), Quantity::BranchModulus(1)]);
    let mut start = truth.spec().clone();
    (start.mu_pa, start.relative_permittivity, start.damping_n_s_per_m) = (32e3, 5.0, 1.2);
    (start.branches[0].modulus_pa, start.branches[0].relaxation_time_s) = (15e3, 1.0);
    start.branches[1].modulus_pa = 40e3;
    let step_times: Vec<f64> = (1..=150).map(|idx| 0.01 * f64::from(idx)).collect();
    let creep_times: Vec<f64> = (0..=50).map(|idx| 0.5 * 40.0_f64.powf(f64::from(idx) / 50.0)).collect();
    let (draws, mut seed, mut sum) = (4, 4_711, 0.0);
    for _ in 0..draws {
        let records = [
            // Quiet enough that errors of first order are all that is seen: 2 to 5 % in the branches.
            noisy_sweep(&truth, 0.001, 25, &mut seed),
            noisy_step(&model, 5000.0, &step_times, 0.0006, &mut seed),
            noisy_step(&model, 4000.0, &creep_times, 0.0006, &mut seed),
        ];
        let found = fit(&start, &quantities, &records).expect("fits");
        assert!(found.meets_records(), "{:?}", found.records);
        sum += distance(&found, truth.spec());
    }
    // Chi squared of 24 values, five standard deviations.
    assert!(sum < 24.0 + 5.0 * 48.0_f64.sqrt(), "{sum}");
}

#[test]
fn law_a_step_of_the_field_level_model_gives_back_its_plant() {
    let truth = ParameterSet::A.parameters();
    let (mut field, mut seed) = (FieldTwin::new(&truth, 12).expect("taut"), 99);
    let rows = (1..=300).map(|idx| {
        field.step(2e-3, 4000.0).expect("solvable");
        (2e-3 * f64::from(idx), field.displacement_mm() + 0.003 * gaussian(&mut seed))
    });
    let rows = rows.collect();
    let step = TimeRecord { name: "step".to_owned(), from_v: 0.0, to_v: 4000.0, noise_mm: 0.003, rows };
    let found = fit(&away(ParameterSet::A), &PLANT, &[Record::Time(step)]).expect("fits");
    for fitted in &found.fitted {
        let expected = fitted.quantity.value(truth.spec()).expect("present");
        let error = (fitted.value / expected).ln().abs();
        // Four standard errors, and the reduction's own error of 0.1 % of the stroke.
        let allowed = 4.0 * fitted.relative_standard_error.expect("free") + 1e-3;
        assert!(error < allowed, "{fitted:?}: {error} {allowed}");
    }
}

#[test]
fn edge_bad_records_and_bad_parameters_are_refused_with_the_place() {
    let truth = ParameterSet::C.parameters();
    let start = truth.spec();
    let sweep = || printed_sweep(2500.0, 1e-3);
    let time = |rows: &[(f64, f64)]| TimeRecord {
        name: "creep".to_owned(),
        from_v: 0.0,
        to_v: 4000.0,
        noise_mm: 1e-3,
        rows: rows.to_vec(),
    };
    type Damage = fn(&mut SweepRecord);
    let sweeps: [(&str, usize, Damage); 5] = [
        ("real_mm_per_unit", 5, |s| s.rows[4].1.re = f64::NAN),
        ("imag_mm_per_unit", 1, |s| s.rows[0].1.im = f64::INFINITY),
        ("frequency_hz", 3, |s| s.rows.swap(1, 2)),
        ("frequency_hz", 1, |s| s.rows[0].0 = -0.1),
        ("frequency_hz", 41, |s| s.rows[40].0 = 300.0),
    ];
    let mut cases: Vec<(&str, usize, Record)> = sweeps
        .into_iter()
        .map(|(key, row, damage)| {
            let mut record = sweep();
            damage(&mut record);
            (key, row, Record::Sweep(record))
        })
        .collect();
    let gap = [(0.1, 1.0), (0.2, 1.0), (0.3, 1.0), (5.0, 1.0), (5.1, 1.0)];
    cases.extend([
        ("time_s", 2, Record::Time(time(&[(1.0, 1.0), (1.0, 1.0)]))),
        ("time_s", 1, Record::Time(time(&[(-1.0, 1.0), (1.0, 1.0)]))),
        ("displacement_mm", 2, Record::Time(time(&[(1.0, 1.0), (2.0, f64::NAN)]))),
        ("time_s", 4, Record::Time(time(&gap))),
    ]);
    for (key, row, record) in cases {
        match fit(start, &PLANT, &[record]) {
            Err(Error::Calibration(Refusal::Row { key: found_key, row: found_row, .. })) => {
                assert_eq!((found_key, found_row), (key, row));
            }
            other => panic!("{key}, row {row}: {other:?}"),
        }
    }
    let setting = |record: Record| match fit(start, &PLANT, &[record]) {
        Err(Error::Calibration(Refusal::Setting { key, .. })) => key,
        other => panic!("{other:?}"),
    };
    let pair = [(1.0, 1.0), (2.0, 1.0)];
    assert_eq!(setting(Record::Sweep(SweepRecord { bias_v: 0.0, ..sweep() })), "bias_v");
    assert_eq!(setting(Record::Sweep(SweepRecord { rows: Vec::new(), ..sweep() })), "rows");
    assert_eq!(setting(Record::Time(TimeRecord { noise_mm: 0.0, ..time(&pair) })), "noise_mm");
    assert_eq!(setting(Record::Time(TimeRecord { to_v: 6000.0, ..time(&pair) })), "to_v");
    // Parameters: no start for a logarithm, the same twice, more than there are values.
    let still = ActuatorSpec { damping_n_s_per_m: 0.0, ..start.clone() };
    let no_start = fit(&still, &[Quantity::Damping], &[Record::Sweep(sweep())]);
    assert!(matches!(no_start, Err(Error::Calibration(Refusal::Free { .. }))));
    let twice = fit(start, &[Quantity::Damping; 2], &[Record::Sweep(sweep())]);
    assert!(matches!(twice, Err(Error::Calibration(Refusal::Free { .. }))));
    let few = fit(start, &PLANT, &[Record::Time(time(&pair))]);
    assert_eq!(few.err(), Some(Error::Calibration(Refusal::TooFew { n_values: 2, n_free: 3 })));
}
