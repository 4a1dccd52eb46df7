//! Families of responses and the weights around them.

use nalgebra::DMatrix;
use num_complex::Complex64;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use telepulse_design::Error;
use telepulse_design::identify::{
    Between, FamilyCover, FamilyOptions, OrderChoice, UncertaintyForm, WeightStructure, central_response,
    cover_family, cover_family_around,
};
use telepulse_lti::{Continuous, FrequencyResponse, StateSpace, TransferFunction};

use crate::printed;

fn log_grid(low: f64, high: f64, n: usize) -> Vec<f64> {
    (0..n).map(|k| low * (high / low).powf(k as f64 / (n - 1) as f64)).collect()
}

fn fixed(order: usize) -> FamilyOptions {
    FamilyOptions { order: OrderChoice::Fixed(order), ..FamilyOptions::default() }
}

/// A stable 2 x 2 system about a given one.
fn scattered(random: &mut Pcg64, size: f64) -> StateSpace<Continuous> {
    let mut entry = |gain: f64, corner: f64| {
        let mut scatter = || 1.0 + size * random.random_range(-1.0..1.0);
        TransferFunction::new(&[gain * scatter()], &[1.0 / (corner * scatter()), 1.0])
            .expect("proper")
            .to_state_space()
    };
    let (a, b, c, d) = (entry(2.0, 1.0), entry(0.7, 5.0), entry(-0.5, 0.4), entry(1.5, 10.0));
    let sum = DMatrix::from_row_slice(2, 4, &[1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0]);
    let split = DMatrix::from_row_slice(4, 2, &[1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0]);
    let gain = |m: DMatrix<f64>| StateSpace::<Continuous>::from_gain(m).expect("finite");
    let all = a.augment(&b).and_then(|s| s.augment(&c)).and_then(|s| s.augment(&d)).expect("continuous");
    gain(split).series(&all).and_then(|s| s.series(&gain(sum))).expect("ports fit")
}

/// Smallest `norm(Delta)` that makes the member of the nominal response with the weight of the cover.
fn delta_size(
    cover: &FamilyCover,
    nominal: &DMatrix<Complex64>,
    member: &DMatrix<Complex64>,
    omega: f64,
) -> f64 {
    let w = cover
        .weight_system()
        .expect("valid")
        .at(omega)
        .expect("stable")
        .try_inverse()
        .expect("minimum phase");
    let difference = member - nominal;
    let inverse = || nominal.clone().try_inverse().expect("invertible");
    let delta = match cover.options.form {
        UncertaintyForm::Additive => w * difference,
        UncertaintyForm::OutputMultiplicative => w * difference * inverse(),
        UncertaintyForm::InputMultiplicative => inverse() * difference * w,
    };
    delta.singular_values().max()
}

#[test]
fn law_every_form_and_structure_covers_random_mimo_families_at_their_points() {
    let seed = 4711;
    let mut random = Pcg64::seed_from_u64(seed);
    for trial in 0..6 {
        let nominal = scattered(&mut random, 0.0);
        // Each member on a grid of its own.
        let family: Vec<FrequencyResponse> = (0..4)
            .map(|_| {
                let member = scattered(&mut random, 0.3);
                let grid = log_grid(0.02, 80.0, 12 + random.random_range(0..8));
                member.frequency_response(&grid).expect("stable")
            })
            .collect();
        for form in [
            UncertaintyForm::Additive,
            UncertaintyForm::InputMultiplicative,
            UncertaintyForm::OutputMultiplicative,
        ] {
            for structure in [WeightStructure::Scalar, WeightStructure::Diagonal] {
                let options = FamilyOptions { form, structure, ..fixed(trial % 4) };
                let cover = cover_family(&nominal, &family, &options).expect("feasible");
                assert_eq!(cover.weights.len(), if structure == WeightStructure::Scalar { 1 } else { 2 });
                for member in &family {
                    for (&omega, value) in member.omega_rad_s.iter().zip(&member.values) {
                        let size = delta_size(&cover, &nominal.at(omega).expect("stable"), value, omega);
                        assert!(size <= 1.0, "seed {seed} trial {trial} {options:?}: {size} at {omega}");
                    }
                }
                for w in &cover.weights {
                    assert!((w.worst_ratio * options.margin - 1.0).abs() < 1e-9, "{w:?}");
                    assert!(w.weight.is_stable().expect("poles"));
                    assert!(w.weight.zeros().expect("zeros").iter().all(|z| z.re < 0.0));
                }
            }
        }
    }
}

#[test]
fn law_the_true_error_between_points_is_covered_where_the_assumption_on_it_holds() {
    // The error of each member is known at all frequencies. Its slope stays within two powers of the frequency, so a cover
    // that assumes this must hold everywhere, however sparse the points.
    let seed = 99;
    let mut random = Pcg64::seed_from_u64(seed);
    let nominal = printed::g();
    let mut straight_failed = 0;
    for trial in 0..40 {
        // An additive error k (s + z)/((s + p)(s + q)): slopes between +1 and -2.
        let mut corner = || 10_f64.powf(random.random_range(0.0..2.5));
        let (z, p, q) = (corner(), corner(), corner());
        let k = 0.1 * p * q / z;
        let error = TransferFunction::new(&[k, k * z], &[1.0, p + q, p * q]).expect("proper");
        let member = nominal.add(&error).expect("proper");
        let grid = log_grid(1.0, 300.0, 5 + trial % 7);
        let family = [member.frequency_response(&grid).expect("stable")];
        let cover = |between| {
            let options = FamilyOptions { between, ..fixed(3) };
            cover_family(&nominal.to_state_space(), &family, &options).expect("feasible").weights.remove(0)
        };
        let (safe, straight) = (cover(Between::Slope(2.0)), cover(Between::Straight));
        let mut violated = false;
        for omega in log_grid(1.0, 300.0, 3001) {
            let truth = error.at(omega).norm();
            let bound = safe.weight.at(omega).norm();
            assert!(truth <= bound, "seed {seed} trial {trial}: {truth} above {bound} at {omega}");
            violated |= truth > straight.weight.at(omega).norm();
        }
        straight_failed += usize::from(violated);
    }
    // Such errors bend between the points, and the assumption that they do not shows it (measured: 24 of 40).
    assert!(straight_failed > 5, "{straight_failed}");
}

#[test]
fn law_straight_curves_are_never_above_the_weight_on_a_fine_grid() {
    let seed = 2;
    let mut random = Pcg64::seed_from_u64(seed);
    let zero = TransferFunction::from_gain(0.0).expect("finite").to_state_space();
    for trial in 0..60 {
        let n = random.random_range(2..9);
        let mut omegas: Vec<f64> = (0..n).map(|_| 10_f64.powf(random.random_range(-1.0..2.0))).collect();
        omegas.sort_by(f64::total_cmp);
        let sizes: Vec<f64> = (0..n).map(|_| 10_f64.powf(random.random_range(-1.5..0.0))).collect();
        let values = sizes.iter().map(|e| DMatrix::from_element(1, 1, Complex64::new(0.0, *e))).collect();
        let family = [FrequencyResponse { omega_rad_s: omegas.clone(), values }];
        let options = fixed(trial % 9);
        let cover = cover_family(&zero, &family, &options).expect("feasible");
        let weight = &cover.weights[0];
        let mut closest = f64::INFINITY;
        for (pair, e) in omegas.windows(2).zip(sizes.windows(2)) {
            for k in 0..=2000 {
                let share = f64::from(k) / 2000.0;
                let omega = pair[0] * (pair[1] / pair[0]).powf(share);
                let error = e[0] * (e[1] / e[0]).powf(share);
                closest = closest.min(weight.weight.at(omega).norm() / error);
            }
        }
        assert!(closest >= 1.0, "seed {seed} trial {trial}: {closest}");
        // It touches: on a grid this fine, 1e-5 above the margin at most.
        assert!(closest <= options.margin * (1.0 + 1e-4), "seed {seed} trial {trial}: {closest}");
    }
}

#[test]
fn paper_eq17_covers_errors_as_large_as_itself_and_comes_back() {
    let (plant, error) = (printed::g(), printed::ws());
    let grid = log_grid(0.6, 82.0, 60);
    let family: Vec<FrequencyResponse> = [1.0, -1.0, 0.6]
        .map(|sign| plant.add(&error.scale(sign).expect("finite")).expect("proper"))
        .iter()
        .map(|member| member.frequency_response(&grid).expect("stable"))
        .collect();
    let options = FamilyOptions { relative_degree: 2, neighbourhood: 1.0, ..fixed(2) };
    let cover = cover_family(&plant.to_state_space(), &family, &options).expect("feasible");
    let weight = &cover.weights[0];
    for (c, printed) in weight.weight.denominator().iter().zip([1.0, 45.0, 2500.0]) {
        assert!((c / printed - 1.0).abs() < 0.03, "{:?}", weight.weight);
    }
    assert!(weight.loosest_ratio < 1.01, "{}", weight.loosest_ratio);
    // The centre of members at +1 and -1 is the plant itself.
    let centre = central_response(&family).expect("one grid");
    for (omega, value) in centre.omega_rad_s.iter().zip(&centre.values) {
        assert!((value[(0, 0)] - plant.at(*omega)).norm() < 1e-12);
    }
}

#[test]
fn law_a_full_numerator_and_the_order_that_is_chosen_are_tighter() {
    // The device's resonance moves by 6 %: the error has two humps with a null between them.
    let device = |omega_n: f64| {
        TransferFunction::new(&[0.935 * omega_n * omega_n], &[1.0, 0.42 * omega_n, omega_n * omega_n])
            .expect("proper")
    };
    let grid = log_grid(0.6, 300.0, 60);
    let family: Vec<FrequencyResponse> = [35.0, 37.0, 39.0, 41.0]
        .iter()
        .map(|w| device(*w).frequency_response(&grid).expect("stable"))
        .collect();
    let nominal = device(38.0).to_state_space();
    let ratio = |options: FamilyOptions| {
        let cover = cover_family(&nominal, &family, &options).expect("feasible");
        let weight = cover.weights.into_iter().next().expect("one");
        (weight.weight.order(), weight.loosest_ratio, weight.ratio_of_order)
    };
    let second = ratio(fixed(2));
    let fourth = ratio(fixed(4));
    let (order, chosen, tried) =
        ratio(FamilyOptions { order: OrderChoice::UpTo(6), ..FamilyOptions::default() });
    // Measured: 12, 1.8 and, at the order that is chosen, 1.6.
    assert!(fourth.1 < 0.25 * second.1, "{fourth:?} against {second:?}");
    let ratios: Vec<f64> = tried.iter().filter_map(|(_, ratio)| *ratio).collect();
    assert!(ratios.len() >= 6 && ratios.windows(2).all(|pair| pair[1] <= pair[0] * 1.01), "{tried:?}");
    assert!((3..=6).contains(&order) && chosen < 2.0, "{order}: {chosen}");
}

#[test]
fn edge_families_that_do_not_fit_are_refused() {
    let nominal = printed::g().to_state_space();
    let response = printed::ws().frequency_response(&[1.0, 2.0, 3.0]).expect("stable");
    let refused = |family: &[FrequencyResponse], options: &FamilyOptions| {
        cover_family(&nominal, family, options).expect_err("refused")
    };
    let options = FamilyOptions::default();
    assert!(matches!(refused(&[], &options), Error::EmptyList { .. }));
    let mut bad = response.clone();
    bad.omega_rad_s[0] = 0.0;
    assert!(matches!(refused(&[response.clone(), bad], &options), Error::FamilyGrid { member_idx: 1, .. }));
    let mut bad = response.clone();
    bad.values[2][(0, 0)].im = f64::NAN;
    assert!(matches!(refused(&[bad], &options), Error::FamilyNotFinite { point_idx: 2, .. }));
    let mut bad = response.clone();
    bad.values[1] = DMatrix::zeros(2, 1);
    assert!(matches!(refused(&[bad], &options), Error::FamilyShape { rows: 2, .. }));
    let mut bad = response.clone();
    bad.values.pop();
    assert!(matches!(refused(&[bad], &options), Error::FamilyGrid { .. }));
    let family = [response];
    assert!(matches!(refused(&family, &fixed(9)), Error::OutOfRange { key: "order", .. }));
    let options = FamilyOptions { margin: f64::NAN, ..FamilyOptions::default() };
    assert!(matches!(refused(&family, &options), Error::OutOfRange { key: "margin", .. }));
    let options = FamilyOptions { form: UncertaintyForm::OutputMultiplicative, ..fixed(1) };
    let flat = |_| Ok(DMatrix::zeros(1, 1));
    let found = cover_family_around(flat, (1, 1), &family, &options);
    assert!(matches!(found, Err(Error::NominalNotInvertible { .. })), "{found:?}");
    let itself = [printed::g().frequency_response(&[1.0, 2.0]).expect("stable")];
    assert!(matches!(refused(&itself, &fixed(1)), Error::CoverNoError));
}
