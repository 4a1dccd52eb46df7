//! `telepulse membrane optimize`: a grid of designs in, a Pareto front and a drawing out.

use std::io::Write;
use std::process::{Command, Output, Stdio};

use serde_json::{Value, json};

use crate::membrane_program::{assert_refused, run};

fn case() -> Value {
    json!({
        "base": "A",
        "limits": {"amplifier_v": 10_000.0, "field_v_per_m": 35e6, "voltage_margin": 1.25},
        "sweep": {"prestretch": [0.5, 2.0, 2.5, 3.0], "mass_kg": {"from": 0.05, "to": 0.15, "n": 3}},
        "refinements": 1
    })
}

fn answer(output: &Output) -> Value {
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

#[test]
fn law_front_is_not_beaten_and_failures_do_not_stop_the_run() {
    let folder = tempfile::tempdir().expect("a folder");
    let drawing = folder.path().join("pareto.svg");
    let found =
        answer(&run("optimize", &case().to_string(), &["--figure", drawing.to_str().expect("UTF-8")]));
    let front = found["front"].as_array().expect("a list");
    let of = |design: &Value, key: &str| design[key].as_f64().expect("a number");
    assert!(front.len() >= 2);
    for pair in front.windows(2) {
        assert!(of(&pair[0], "stroke_mm") < of(&pair[1], "stroke_mm"));
        assert!(of(&pair[0], "bandwidth_hz") > of(&pair[1], "bandwidth_hz"));
    }
    for design in front {
        assert!(of(design, "field_max_v_per_m") <= 35e6 * (1.0 + 1e-9) && of(design, "voltage_v") <= 1e4);
        assert!(of(design, "tension_min_pa") > 0.0);
        let (base, best) = (&found["base"], &found["best_product"]);
        assert!(of(best, "product_mm_hz") >= of(design, "product_mm_hz"));
        // No design of the front is beaten by the base.
        let beaten = of(base, "stroke_mm") > of(design, "stroke_mm")
            && of(base, "bandwidth_hz") > of(design, "bandwidth_hz");
        assert!(!beaten);
    }
    // The three variants with a pre-stretch below 1, each with its reason.
    let failed = found["failed"].as_array().expect("a list");
    assert!(failed.len() >= 3 && found["n_failed"] == failed.len());
    assert!(failed[0]["reason"].as_str().expect("words").contains("slack"), "{failed:?}");
    assert!(found["n_variants"].as_u64().expect("a count") > 12);
    let drawn = std::fs::read_to_string(&drawing).expect("drawn");
    assert!(drawn.starts_with("<svg") && drawn.contains("Pareto front"));
}

#[test]
fn law_answers_do_not_depend_on_the_number_of_threads() {
    let one = Command::new(env!("CARGO_BIN_EXE_telepulse"));
    let with = |mut command: Command, threads: &str| {
        let mut child = command
            .args(["membrane", "optimize", "-", "--json"])
            .env("RAYON_NUM_THREADS", threads)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("the program starts");
        child.stdin.take().expect("piped").write_all(case().to_string().as_bytes()).expect("written");
        child.wait_with_output().expect("the program ends").stdout
    };
    let two = Command::new(env!("CARGO_BIN_EXE_telepulse"));
    assert_eq!(with(one, "1"), with(two, "2"));
}

#[test]
fn edge_each_bad_case_is_refused_with_key_value_and_reason() {
    type Damage = fn(&mut Value);
    let cases: [(&[&str], Damage); 9] = [
        (&["`limits`", "missing"], |c| c["limits"] = Value::Null),
        (&["`limits`", "`voltage_margin`", "0.9", "fails in use"], |c| {
            c["limits"]["voltage_margin"] = json!(0.9);
        }),
        (&["`limits`", "`field_v_per_m`", "-1", "positive"], |c| {
            c["limits"]["field_v_per_m"] = json!(-1.0);
        }),
        (&["`sweep`", "`colour`", "prestretch"], |c| c["sweep"]["colour"] = json!([1.0])),
        (&["`sweep`", "`mass_kg`", "whole", "2.5"], |c| c["sweep"]["mass_kg"]["n"] = json!(2.5)),
        (&["`sweep`", "`prestretch`", "at least one"], |c| c["sweep"]["prestretch"] = json!([])),
        (&["`sweep`", "100000 variants"], |c| {
            c["sweep"]["mass_kg"]["n"] = json!(1000);
            c["sweep"]["thickness_m"] = json!({"from": 5e-4, "to": 1e-3, "n": 1000});
        }),
        (&["`refinements`", "0 to 8", "9"], |c| c["refinements"] = json!(9)),
        (&["`base`", "missing"], |c| c["base"] = Value::Null),
    ];
    for (parts, damage) in cases {
        let mut case = case();
        damage(&mut case);
        let output = run("optimize", &case.to_string(), &[]);
        assert_refused(&case.to_string(), output, parts);
    }
}

#[test]
fn edge_no_variant_that_holds_is_a_failed_check() {
    let mut case = case();
    case["sweep"] = json!({"prestretch": [0.5, 0.6]});
    let output = run("optimize", &case.to_string(), &[]);
    assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stderr));
    let found: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(found["n_failed"], 2);
    assert!(found["front"].as_array().expect("a list").is_empty());
}
