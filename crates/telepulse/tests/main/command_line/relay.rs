//! `telepulse relay`: the critical point by experiment, and the controller from it.

use std::f64::consts::PI;

use num_complex::Complex64;

use super::Bench;

/// The plant of `model.json` behind the study's filter (26), by plain arithmetic.
fn loop_gain(bench: &Bench, omega: f64) -> Complex64 {
    let model: serde_json::Value = serde_json::from_str(&bench.text("model.json")).expect("JSON");
    let value = |part: &str| {
        let list = model["nominal"][part].as_array().expect("coefficients");
        list.iter().fold(Complex64::new(0.0, 0.0), |sum, c| {
            sum * Complex64::new(0.0, omega) + c.as_f64().expect("a number")
        })
    };
    let corner = 2.0 * PI * 20.0;
    value("numerator") / value("denominator") * corner / Complex64::new(corner, omega)
}

#[test]
fn law_the_critical_point_is_near_that_of_the_identified_model_and_the_recipe_runs() {
    let bench = Bench::with_artefacts();
    let answer = bench.json(&["relay", "--study", "st", "--step", "0.1", "--out", "pid.recipe.json"]);
    let number = |key: &str| answer[key].as_f64().expect("a number");
    let (gain, period) = (number("ultimate_gain_unit_per_mm"), number("ultimate_period_s"));
    // Where the phase of the model behind the filter is half a turn.
    let (mut low, mut high) = (10.0, 300.0);
    for _ in 0..60 {
        let middle: f64 = f64::sqrt(low * high);
        if loop_gain(&bench, middle).im < 0.0 { low = middle } else { high = middle }
    }
    let exact_gain = 1.0 / loop_gain(&bench, low).norm();
    // The describing function leaves out the harmonics, hysteresis and the tick of delay move the point down, and the model is
    // that of the sweep's amplitudes, not of the relay's: 15 % in all, 25 % for the gain.
    assert!((period * low / (2.0 * PI) - 1.0).abs() < 0.15, "{answer}");
    assert!((gain / exact_gain - 1.0).abs() < 0.25, "{answer}");
    // The rule by its own numbers: Kc = Ku/3.2, Ti = 2.2 Tu.
    let settings = |key: &str| answer["settings"][key].as_f64().expect("a number");
    assert!((settings("p") * 3.2 / gain - 1.0).abs() < 1e-9, "{answer}");
    assert!((settings("p") / settings("i_per_s") / (2.2 * period) - 1.0).abs() < 1e-9, "{answer}");
    let run = bench.json(&["track", "pid.recipe.json", "--study", "st", "--reference", "reference.csv"]);
    assert!(run["nrmse"].is_number(), "{run}");
    assert!(run["provenance"].as_str().expect("text").contains("relay experiment"), "{run}");
    let again = bench.json(&["relay", "--study", "st", "--step", "0.1", "--out", "again.recipe.json"]);
    assert_eq!(again["ultimate_period_s"], answer["ultimate_period_s"]);
}

#[test]
fn edge_an_experiment_that_says_nothing_is_refused_and_leaves_no_file() {
    let bench = Bench::new();
    let with = |more: &[&'static str]| [&["relay", "--study", "st", "--out", "made.json"][..], more].concat();
    // 0.95 + 0.1 of 5000 V.
    bench.refused(&with(&["--bias", "0.95"]), &["5250 V", "allowed are the study's 0 to 5000 V"]);
    bench.refused(&with(&["--hysteresis-mm", "2", "--settle-s", "2"]), &["no steady oscillation", "2 mm"]);
    bench.refused(&with(&["--timeout-s", "0.1", "--settle-s", "2"]), &["no steady oscillation within 0.1 s"]);
    bench.refused(&with(&["--step", "0.7"]), &["`--step`", "0.7", "0.5"]);
    bench.refused(&with(&["--settle-s", "nan"]), &["`--settle-s`"]);
    assert!(!bench.path("made.json").exists());
}

#[test]
fn edge_setpoint_weights_of_a_study_are_refused_by_their_key() {
    let bench = Bench::new();
    bench.edit_study(
        "d = 0.0443\nn_rad_s = 9630.0667",
        "d = 0.0443\nn_rad_s = 9630.0667\nsetpoint_weights = { b = 1.5, c = 0.0 }",
    );
    bench.refused(
        &["identify", "--study", "st"],
        &["study.toml", "`pid.auto.setpoint_weights.b`", "1.5", "0 to 1"],
    );
    bench.edit_study("b = 1.5", "b = 0.5, e = 1.0");
    bench.refused(&["identify", "--study", "st"], &["study.toml", "unknown field `e`"]);
    bench.edit_study("b = 0.5, e = 1.0", "b = 0.5");
    bench.edit_study("i = 48.662", "i = 0.0");
    bench
        .refused(&["identify", "--study", "st"], &["`pid.auto.setpoint_weights.b`", "without integral gain"]);
}
