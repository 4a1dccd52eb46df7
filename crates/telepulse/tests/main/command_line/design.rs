//! `telepulse design` and `telepulse verify`: plants and weights that have no controller, loops that have no certificate.

use super::{Bench, plant, pulse_csv};

#[test]
fn edge_weights_of_wrong_order_or_unstable() {
    let error = "error = { numerator = [0.2, 6.283], denominator = [1.0, 0.0006283] }";
    let control = "control = { numerator = [0.1, 0.0006283], denominator = [0.0001, 62.83] }";
    let cases: [(&str, &str, &[&str]); 7] = [
        (
            error,
            "error = { numerator = [1.0, 0.2, 6.283], denominator = [1.0, 0.0006283] }",
            &["key `weights.error`", "must be proper", "numerator degree 2", "denominator degree 1"],
        ),
        (
            error,
            "error = { numerator = [0.2, 6.283], denominator = [1.0, -0.0006283] }",
            &["key `weights.error`", "found a pole", "allowed stable"],
        ),
        (
            error,
            "error = { numerator = [0.2, 6.283], denominator = [1.0, 0.0] }",
            &["key `weights.error`", "imaginary axis", "allowed stable"],
        ),
        (
            error,
            "error = { numerator = [0.2, 6.283], denominator = [0.0, 0.0] }",
            &["key `weights.error`", "denominator", "other than zero"],
        ),
        (
            control,
            "control = { numerator = [0.0], denominator = [0.0001, 62.83] }",
            &["key `weights.control.numerator`", "only zeros", "other than zero"],
        ),
        (
            control,
            "control = { numerator = [], denominator = [0.0001, 62.83] }",
            &["key `weights.control.numerator`", "found no coefficient", "one or more"],
        ),
        // Proper, but it leaves the command free at high frequencies.
        (
            control,
            "control = { numerator = [0.1], denominator = [0.0001, 62.83] }",
            &["key `weights`", "model.json", "D12", "no direct weight"],
        ),
    ];
    for (old, new, named) in cases {
        let bench = Bench::with_artefacts();
        bench.edit_study(old, new);
        let named = [&["study.toml"], named].concat();
        bench.refused(&["design", "model.json", "--study", "st", "--out", "made/r.recipe.json"], &named);
    }
}

#[test]
fn edge_an_own_plant_that_cannot_be_controlled() {
    let bound = "1.0, 45.0, 2500.0";
    let cases: [(String, &[&str]); 7] = [
        // It moves against its command: a certified controller would run it into its limits.
        (plant("-1350.14", "0.0045, 1.07182, 22.458, 1444.0", bound), &["key `plant`", "positive", "-0.93"]),
        // Two integrators: a controller of this kind cannot act on what the weights do not see.
        (plant("1.0", "1.0, 0.0, 0.0", bound), &["key `weights` with `plant`", "no H-infinity controller"]),
        // The unstable pole at 1 rad/s is cancelled by a zero: no feedback sees or moves it.
        (
            plant("1.0, -1.0", "1.0, 1.0, -2.0", bound),
            &["key `weights` with `plant`", "no H-infinity controller"],
        ),
        (plant("1.0", "1.0, 2.0", "1.0, -10.0"), &["key `plant.uncertainty`", "unstable", "allowed stable"]),
        (plant("1.0, 2.0, 3.0", "1.0, 2.0", bound), &["key `plant.nominal`", "must be proper", "degree 2"]),
        (plant("0.0", "1.0, 2.0", bound), &["key `plant.nominal.numerator`", "only zeros"]),
        (plant("1.0, nan", "1.0, 2.0, 1.0", bound), &["key `plant.nominal`", "finite", "NaN"]),
    ];
    for (text, named) in cases {
        let bench = Bench::new();
        bench.edit_study("[weights]", &text);
        let named = [&["study.toml"], named].concat();
        bench.refused(&["design", "--study", "st", "--out", "made/r.recipe.json"], &named);
    }
    let bench = Bench::new();
    bench.refused(
        &["design", "--study", "st"],
        &["study.toml", "key `plant`", "found none", "telepulse identify"],
    );
    bench.refused(&["verify", "--study", "st"], &["study.toml", "key `plant`", "found none"]);
}

#[test]
fn edge_a_loop_that_cannot_be_certified_is_a_failed_check() {
    let bench = Bench::new();
    bench.edit_study("[weights]", &plant("1.0", "1.0, -2.0", "1.0, 45.0, 2500.0"));
    // The printed controller does not stabilise this plant: the program could run, and the answer is no.
    let output = bench.run(&["verify", "--study", "st"]);
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.starts_with("UNCERTIFIED: ") && said.contains("stable"), "{said}");
}

#[test]
fn law_an_own_plant_needs_no_model() {
    let bench = Bench::new();
    bench.edit_study("[weights]", &plant("1350.14", "0.0045, 1.07182, 22.458, 1444.0", "1.0, 45.0, 2500.0"));
    let answer = bench.json(&["design", "--study", "st", "--out", "own.recipe.json"]);
    // This is (16) with (17): the optimum of (19) and (20) is 0.32064, delivered is at most 1 % above.
    let gamma = answer["synthesis"]["gamma_achieved"].as_f64().expect("a number");
    assert!(gamma > 0.3206 && gamma <= 0.3240, "{gamma}");
    assert_eq!(answer["certificate"]["holds"], true);
    assert_eq!(bench.json(&["verify", "--study", "st"])["holds"], true);
    bench.put("pulse.csv", &pulse_csv());
    bench.json(&["replay", "own.recipe.json", "pulse.csv", "--study", "st"]);
}
