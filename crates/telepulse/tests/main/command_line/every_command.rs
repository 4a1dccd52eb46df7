//! What holds for every subcommand, and for the whole chain of them.

use std::process::Stdio;

use super::Bench;

#[test]
fn edge_a_file_of_another_kind() {
    let bench = Bench::with_artefacts();
    let design = ["design", "h.recipe.json", "--study", "st", "--out", "made/r.recipe.json"];
    bench.refused(&design, &["h.recipe.json", "unknown field `law`", "`nominal`", "line 3"]);
    bench.refused(
        &["verify", "--model", "h.recipe.json", "--study", "st"],
        &["h.recipe.json", "unknown field `law`", "`nominal`"],
    );
    bench.refused(
        &["verify", "model.json", "--model", "model.json", "--study", "st"],
        &["model.json", "unknown field `version`", "`numerator`"],
    );
    bench.refused(&["design", "sweep.csv", "--study", "st"], &["sweep.csv", "expected value", "line 1"]);
    bench.refused(&["pulse", "info", "sweep.csv"], &["sweep.csv", "line 1", "column `time_s` is missing"]);
    bench.refused(
        &["identify", "--study", "st", "--sweep", "pulse.csv"],
        &["pulse.csv", "line 1", "column `frequency_hz` is missing"],
    );
    bench.refused(&["identify", "--study", "model.json"], &["model.json", "line 1"]);
}

#[test]
fn edge_a_mistyped_command_line_exits_with_2() {
    let bench = Bench::new();
    for arguments in
        [&["frobnicate"][..], &["identify", "--frob"], &["send"], &["replay", "a", "b", "--mode", "c"]]
    {
        let output = bench.run(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(output.stdout.is_empty() && !output.stderr.is_empty(), "{arguments:?}");
    }
    bench.refused(&["--out", "made", "pulse", "info", "x.csv"], &["`--out` before a subcommand"]);
}

#[test]
fn edge_a_reader_that_closes_early_is_no_failure() {
    let bench = Bench::new();
    for arguments in
        [&["pulse", "info", "st/or_abp_40s.csv"][..], &["pulse", "analyze", "st/or_abp_40s.csv", "--json"]]
    {
        let mut child = bench
            .command(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        drop(child.stdout.take());
        let output = child.wait_with_output().expect("it ends");
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!((output.status.code(), said.as_ref()), (Some(0), ""), "{arguments:?}");
    }
}

// ---- the stages, from file to file ----

#[test]
fn law_help_and_version_of_every_command() {
    let bench = Bench::new();
    let commands: [&[&str]; 15] = [
        &[],
        &["study"],
        &["study", "run"],
        &["study", "new"],
        &["identify"],
        &["design"],
        &["verify"],
        &["track"],
        &["relay"],
        &["pulse"],
        &["pulse", "info"],
        &["send"],
        &["receive"],
        &["replay"],
        &["report"],
    ];
    for command in commands {
        let help = bench.done(&[command, &["--help"]].concat());
        assert!(help.contains("Usage: telepulse"), "{command:?}: {help}");
        assert!(help.contains("--json"), "{command:?} knows no --json");
        let version = bench.done(&[command, &["--version"]].concat());
        assert!(version.trim_end().ends_with(env!("CARGO_PKG_VERSION")), "{command:?}: {version}");
    }
}

/// Every number of the first is that of the second to a relative 1e-9; names and texts are equal except at `record`.
fn assert_same_model(first: &serde_json::Value, second: &serde_json::Value) {
    use serde_json::Value;
    match (first, second) {
        (Value::Number(a), Value::Number(b)) => {
            let (a, b) = (a.as_f64().expect("finite"), b.as_f64().expect("finite"));
            // A sweep survives its file bit for bit, so nothing but summation order could differ.
            assert!((a - b).abs() <= 1e-9 * a.abs(), "{a} and {b}");
        }
        (Value::Array(a), Value::Array(b)) => {
            assert_eq!(a.len(), b.len());
            a.iter().zip(b).for_each(|(a, b)| assert_same_model(a, b));
        }
        (Value::Object(a), Value::Object(b)) => {
            assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
            for (key, value) in a.iter().filter(|(key, _)| *key != "record") {
                assert_same_model(value, &b[key]);
            }
        }
        (a, b) => assert_eq!(a, b),
    }
}

#[test]
fn oracle_every_stage_starts_from_the_files_of_the_one_before() {
    let bench = Bench::with_artefacts();
    let parse = |name: &str| -> serde_json::Value { serde_json::from_str(&bench.text(name)).expect("JSON") };

    let again = ["identify", "--study", "st", "--sweep", "sweep.csv", "--out", "again.json"];
    let answer = bench.json(&[&again[..], &["--save-sweep", "again.csv"]].concat());
    assert_eq!(bench.text("sweep.csv"), bench.text("again.csv"), "a sweep survives its file bit for bit");
    assert_same_model(&parse("model.json"), &parse("again.json"));
    let identified = &answer["identified"];
    assert_eq!(identified["bound_violations"], 0);
    let omega_n = identified["omega_n_rad_s"].as_f64().expect("a number");
    // The device of the study is the one behind (16), whose resonance is at 38.0 rad/s.
    assert!((omega_n / 38.0 - 1.0).abs() < 0.02, "{omega_n}");

    let answer = bench.json(&["design", "again.json", "--study", "st", "--out", "again.recipe.json"]);
    let gamma = |key: &str| answer["synthesis"][key].as_f64().expect("a number");
    assert!(gamma("gamma_lower") <= gamma("gamma_achieved"));
    assert_eq!(answer["certificate"]["holds"], true);
    assert_same_model(&parse("h.recipe.json")["law"], &parse("again.recipe.json")["law"]);

    let answer = bench.json(&["verify", "--model", "model.json", "--study", "st"]);
    assert_eq!(answer["holds"], true);
    bench.put("own.json", r#"{"numerator": [5.0], "denominator": [1.0, 0.001]}"#);
    let answer = bench.json(&["verify", "own.json", "--model", "model.json", "--study", "st"]);
    assert_eq!(answer["holds"], true);

    let track =
        ["track", "h.recipe.json", "--reference", "reference.csv", "--study", "st", "--out", "t.json"];
    let answer = bench.json(&track);
    let error_mm = answer["mean_abs_error_mm"].as_f64().expect("a number");
    // The printed controller reaches 0.011 mm on (25), which is slower than this reference.
    assert!(error_mm < 0.05, "{error_mm}");
    parse("t.json");
    bench.json(&["identify", "--mode", "force", "--study", "st", "--out", "held.json"]);
    bench.json(&["design", "held.json", "--study", "st", "--out", "f.recipe.json"]);
    for (mode, recipe) in [("displacement", "h.recipe.json"), ("force", "f.recipe.json")] {
        let replay = ["replay", recipe, "pulse.csv", "--study", "st", "--mode", mode, "--out", "r.json"];
        let answer = bench.json(&replay);
        let nrmse = answer["nrmse"].as_f64().expect("a number");
        assert!(nrmse < 0.2, "{mode}: {nrmse}");
        assert_eq!(parse("r.json")["mode"], mode);
    }
    assert_eq!(bench.json(&["pulse", "info", "pulse.csv"])["samples"], 500);
    let rate = bench.json(&["pulse", "analyze", "pulse.csv"])["heart_rate_bpm"].as_f64().expect("a number");
    // 1.2 beats per second.
    assert!((rate - 72.0).abs() < 1.0, "{rate}");
}
