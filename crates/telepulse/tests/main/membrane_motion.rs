//! `telepulse membrane simulate`: case files in, motions or one line of refusal out.

use std::process::{Command, Output};

use serde_json::{Value, json};

use crate::membrane_program::assert_refused;

fn run(case: &Value, folder: &std::path::Path) -> Output {
    let file = folder.join("case.json");
    std::fs::write(&file, case.to_string()).expect("written");
    Command::new(env!("CARGO_BIN_EXE_telepulse"))
        .args(["membrane", "simulate"])
        .arg(&file)
        .arg("--json")
        .output()
        .expect("the program runs")
}

fn answer(case: &Value) -> Value {
    let folder = tempfile::tempdir().expect("a folder");
    let output = run(case, folder.path());
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

fn step() -> Value {
    json!({"parameter_set": "A", "drive": {"shape": "step", "voltage_v": 5000.0}, "duration_s": 0.5})
}

fn number(answer: &Value, key: &str) -> f64 {
    answer[key].as_f64().unwrap_or_else(|| panic!("{key} is no number in {answer}"))
}

#[test]
fn oracle_step_of_set_a_at_both_fidelities() {
    let reduced = answer(&step());
    let mut case = step();
    case["fidelity"] = json!("field");
    let field = answer(&case);
    for found in [&reduced, &field] {
        // Field-level simulations by other code, printed to these digits.
        assert!((number(found, "displacement_max_m") - 1.48e-3).abs() < 5e-6, "{found}");
        assert!((number(found, "displacement_end_m") - 1.006e-3).abs() < 0.7e-6, "{found}");
        assert!((number(found, "rest_sag_m") - 6.840664085e-3).abs() < 1e-9, "{found}");
    }
    let stated = &reduced["stated_error_percent"];
    for key in ["full_scale_step", "reference_25"] {
        let percent = number(stated, key);
        assert!(percent > 0.0 && percent < 1.0, "{key}: {percent}");
    }
    assert_eq!(field["stated_error_percent"], Value::Null);
    assert_eq!(reduced["samples"]["time_s"].as_array().map(Vec::len), Some(50));
}

#[test]
fn law_table_of_a_step_moves_the_plate_as_the_step_does() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("drive.csv"), "time_s,voltage_v\n0,0\n0.1,5000\n0.6,5000\n")
        .expect("written");
    let mut case = step();
    case["drive"] = json!({"shape": "csv", "file": "drive.csv"});
    case.as_object_mut().expect("an object").remove("duration_s");
    let output = run(&case, folder.path());
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let table: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let mut later = step();
    later["drive"]["start_s"] = json!(0.1);
    later["duration_s"] = json!(0.6);
    assert_eq!(table["samples"], answer(&later)["samples"]);
}

#[test]
fn law_scatter_repeats_and_names_its_bad_variants() {
    let mut case = step();
    case["scatter"] = json!({"n_variants": 40, "seed": 3, "relative": {"mu_pa": 0.1, "thickness_m": 1.5}});
    let found = answer(&case);
    assert_eq!(found, answer(&case));
    let variants = found["variants"].as_array().expect("a list");
    assert_eq!(variants.len(), 40);
    let mut n_failed = 0;
    for variant in variants {
        let thickness = number(&variant["factors"], "thickness_m");
        if thickness <= 0.0 {
            let said = variant["error"].as_str().expect("a reason");
            assert!(said.contains("thickness_m") && said.contains("positive"), "{said}");
        }
        // A thin membrane may also be slack or beyond its limit; then that is what is said.
        match variant["error"].as_str() {
            Some(_) => n_failed += 1,
            None => assert!(number(variant, "displacement_max_m") > 0.0),
        }
    }
    assert!(n_failed > 0 && n_failed < 40);
    assert_eq!(number(&found, "n_failed"), f64::from(n_failed));
}

#[test]
fn edge_each_bad_case_is_refused_with_key_value_and_reason() {
    type Damage = fn(&mut Value);
    let cases: [(&[&str], Damage); 14] = [
        (&["`parameter_set`", "\"D\""], |c| c["parameter_set"] = json!("D")),
        (&["`thickness_m`", "-1", "positive"], |c| c["thickness_m"] = json!(-1.0)),
        (&["`a_m`", "0.07"], |c| c["a_m"] = json!(0.07)),
        (&["`prestretch`", "0.9", "slack"], |c| c["prestretch"] = json!(0.9)),
        (&["`fidelity`", "\"exact\"", "reduced"], |c| c["fidelity"] = json!("exact")),
        (&["`drive`", "missing"], |c| c["drive"] = Value::Null),
        (&["`drive`", "\"ramp\""], |c| c["drive"]["shape"] = json!("ramp")),
        (&["`drive`", "`voltage_v`", "9000", "amplifier"], |c| c["drive"]["voltage_v"] = json!(9000)),
        (&["`drive`", "`hertz`"], |c| c["drive"]["hertz"] = json!(1)),
        (&["`full_scale_v`", "12000"], |c| c["full_scale_v"] = json!(12_000.0)),
        (&["`step_s`", "0.5"], |c| c["step_s"] = json!(0.5)),
        (&["`duration_s`", "0"], |c| c["duration_s"] = json!(0.0)),
        (&["`branches`", "[1.0]"], |c| c["branches"] = json!([[1.0]])),
        (&["`scatter`", "`colour`"], |c| {
            c["scatter"] = json!({"n_variants": 2, "seed": 1, "relative": {"colour": 0.1}})
        }),
    ];
    let folder = tempfile::tempdir().expect("a folder");
    for (parts, damage) in cases {
        let mut case = step();
        damage(&mut case);
        let output = run(&case, folder.path());
        assert_refused(&case.to_string(), output, parts);
    }
    for (rows, part) in [
        ("time_s,voltage_v\n0,1\n0,2\n", "rise"),
        ("time_s,voltage_v\n0,NaN\n", "finite"),
        ("time_s,voltage_v\n", "none"),
        ("t,v\n0,1\n", "columns"),
    ] {
        std::fs::write(folder.path().join("bad.csv"), rows).expect("written");
        let mut case = step();
        case["drive"] = json!({"shape": "csv", "file": "bad.csv"});
        let output = run(&case, folder.path());
        let said = String::from_utf8(output.stderr).expect("UTF-8");
        assert_eq!(output.status.code(), Some(2), "{rows}: {said}");
        assert!(said.contains("`drive`") && said.contains(part), "{rows}: {said}");
    }
}
