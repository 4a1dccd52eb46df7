//! `telepulse membrane`: case files in, answers or one line of refusal out.

use std::io::Write;
use std::process::{Command, Output, Stdio};

use serde_json::{Value, json};

fn run(case: &str) -> Output {
    let mut child = Command::new(env!("CARGO_BIN_EXE_telepulse"))
        .args(["membrane", "solve", "-", "--json"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    child.stdin.take().expect("piped").write_all(case.as_bytes()).expect("written");
    child.wait_with_output().expect("the program ends")
}

/// Set A at rest under its weight.
fn set_a() -> Value {
    json!({
        "material": {"model": "gent", "mu_pa": 37220.0, "J": 110.0},
        "a_m": 0.0127, "b_m": 0.06858, "thickness_m": 0.001, "prestretch": 2.0,
        "relative_permittivity": 5.8, "voltage_v": 5000.0, "force_n": 0.980665
    })
}

#[test]
fn oracle_set_a_at_full_scale_with_exactly_the_agreed_keys() {
    let output = run(&set_a().to_string());
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let answer: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let mut keys: Vec<&str> = answer.as_object().expect("an object").keys().map(String::as_str).collect();
    let mut agreed = [
        "displacement_m",
        "force_n",
        "lambda1_inner",
        "lambda1_outer",
        "theta_inner",
        "theta_outer",
        "s1_inner_pa",
        "s2_min_pa",
        "capacitance_f",
        "stiffness_n_per_m",
        "dforce_dvoltage_n_per_v",
        "field_max_v_per_m",
        "residual",
        "margins",
    ];
    keys.sort_unstable();
    agreed.sort_unstable();
    assert_eq!(keys, agreed);
    // Another solver's values (testdata/actuator/membrane_static.json), with its discretisation error.
    for (key, expected, relative) in [
        ("displacement_m", 7.887857133673037e-3, 1e-10),
        ("theta_inner", 0.3501735289852888, 1e-9),
        ("lambda1_inner", 2.1319285860427746, 1e-9),
        ("capacitance_f", 2.978701651554214e-9, 1e-10),
        ("stiffness_n_per_m", 125.02640586131709, 1e-9),
        ("dforce_dvoltage_n_per_v", -6.0399016965306807e-05, 1e-9),
        ("field_max_v_per_m", 21.319285860427744e6, 1e-9),
    ] {
        let found = answer[key].as_f64().expect("a number");
        assert!((found / expected - 1.0).abs() < relative, "{key}: {found}");
    }
    let limit = answer["margins"]["limit_voltage_v"].as_f64().expect("a limit point");
    assert!((10_750.0..10_850.0).contains(&limit), "{limit}");
    // What was found by force is found by displacement.
    let mut held = set_a();
    held.as_object_mut().expect("an object").remove("force_n");
    held["displacement_m"] = answer["displacement_m"].clone();
    let back: Value = serde_json::from_slice(&run(&held.to_string()).stdout).expect("JSON");
    let force = back["force_n"].as_f64().expect("a number");
    assert!((force - 0.980665).abs() < 1e-11, "{force}");
}

#[test]
fn edge_each_bad_case_is_refused_with_key_value_and_reason() {
    type Damage = fn(&mut Value);
    let cases: [(&[&str], Damage); 18] = [
        (&["`thickness_m`", "-0.001", "positive"], |c| c["thickness_m"] = json!(-0.001)),
        (&["`thickness_m`", "0", "positive"], |c| c["thickness_m"] = json!(0.0)),
        (&["`a_m`", "0.07", "smaller than b_m"], |c| c["a_m"] = json!(0.07)),
        (&["`prestretch`", "0.8", "slack"], |c| c["prestretch"] = json!(0.8)),
        (&["`prestretch`", "7", "Gent limit 110"], |c| c["prestretch"] = json!(8.7)),
        (&["`voltage_v`", "11000", "limit point"], |c| c["voltage_v"] = json!(11_000.0)),
        (&["`voltage_v`", "10500", "slack"], |c| c["voltage_v"] = json!(10_500.0)),
        (&["`voltage_v`", "-5", "negative"], |c| c["voltage_v"] = json!(-5.0)),
        (&["`material`", "\"rubber\"", "neo-hookean"], |c| c["material"]["model"] = json!("rubber")),
        (&["`material`", "`J` is missing"], |c| c["material"] = json!({"model": "gent", "mu_pa": 1e5})),
        (&["`material`", "`terms`", "[1.0]"], |c| {
            c["material"] = json!({"model": "ogden", "terms": [[1.0]]})
        }),
        (&["`J`", "-3", "positive"], |c| c["material"]["J"] = json!(-3.0)),
        (&["`relative_permittivity`", "missing"], |c| c["relative_permittivity"] = Value::Null),
        (&["`b_m`", "expected a number", "wide"], |c| c["b_m"] = json!("wide")),
        (&["`force_n`", "`displacement_m`", "one"], |c| c["displacement_m"] = json!(0.01)),
        (&["`force_n`", "missing"], |c| c["force_n"] = Value::Null),
        (&["`charge_c`", "`voltage_v`", "one"], |c| c["charge_c"] = json!(1e-6)),
        (&["`displacement_m`", "0.5", "Gent limit 110"], |c| {
            c["force_n"] = Value::Null;
            c["displacement_m"] = json!(0.5);
        }),
    ];
    for (parts, damage) in cases {
        let mut case = set_a();
        damage(&mut case);
        let output = run(&case.to_string());
        let said = String::from_utf8(output.stderr).expect("UTF-8");
        assert_eq!(output.status.code(), Some(2), "{case}: {said}");
        assert!(output.stdout.is_empty(), "{case}: answered all the same");
        assert_eq!(said.lines().count(), 1, "{case}: {said}");
        for part in parts {
            assert!(said.contains(part), "{case}: `{part}` is not in: {said}");
        }
    }
    for text in ["{\"a_m\": 1", "[1, 2]", ""] {
        let output = run(text);
        assert_eq!(output.status.code(), Some(2), "{text}");
    }
}

#[test]
fn edge_pre_stretch_below_one_needs_its_flag() {
    let mut case = set_a();
    // 2 N stretch it by more than what is missing.
    case["prestretch"] = json!([0.98, 0.98]);
    case["force_n"] = json!(2.0);
    case["allow_prestretch_below_one"] = json!(true);
    case["voltage_v"] = json!(0.0);
    let output = run(&case.to_string());
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
}
