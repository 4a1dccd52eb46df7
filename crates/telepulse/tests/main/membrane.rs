//! `telepulse membrane`: case files in, answers or one line of refusal out.

use serde_json::{Value, json};

use crate::membrane_program::{assert_refused, run};

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
    let output = run("solve", &set_a().to_string(), &[]);
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
    let back: Value = serde_json::from_slice(&run("solve", &held.to_string(), &[]).stdout).expect("JSON");
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
        let output = run("solve", &case.to_string(), &[]);
        assert_refused(&case.to_string(), output, parts);
    }
    for text in ["{\"a_m\": 1", "[1, 2]", ""] {
        let output = run("solve", text, &[]);
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
    let output = run("solve", &case.to_string(), &[]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn law_map_agrees_with_single_solves_and_writes_its_figures() {
    let folder = std::env::temp_dir().join(format!("telepulse-membrane-map-{}", std::process::id()));
    let mut case = set_a();
    case["map"] = json!({"displacement_m": [0.004, 0.010, 3], "voltage_v": [0, 5000, 2]});
    let path = folder.to_str().expect("UTF-8").to_owned();
    let output = run("map", &case.to_string(), &["--figures", &path]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let map: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let mut held = set_a();
    held.as_object_mut().expect("an object").remove("force_n");
    held["displacement_m"] = map["displacement_m"][1].clone();
    let alone: Value = serde_json::from_slice(&run("solve", &held.to_string(), &[]).stdout).expect("JSON");
    for key in ["force_n", "capacitance_f", "stiffness_n_per_m", "dforce_dvoltage_n_per_v"] {
        let [found, expected] = [&map[key][1][1], &alone[key]].map(|v| v.as_f64().expect("a number"));
        // Two solves of one state, both to 1e-12; derivatives lose two digits.
        assert!((found / expected - 1.0).abs() < 1e-9, "{key}: {found}, {expected}");
    }
    for name in ["membrane-shape", "membrane-fields", "membrane-map"] {
        let svg = std::fs::read_to_string(folder.join(format!("{name}.svg"))).expect("a figure");
        assert!(svg.ends_with("</svg>\n") && svg.contains(", mm"), "{name}");
    }
    std::fs::remove_dir_all(&folder).expect("a folder of ours");
}

#[test]
fn oracle_failure_of_set_a_names_each_limit_and_what_is_unverified() {
    let mut case = set_a();
    case["breakdown"] = json!("koh-2011");
    let output = run("failure", &case.to_string(), &[]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let answer: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let limit = |mechanism: &str| {
        let limits = answer["voltage_limits"].as_array().expect("a list");
        limits.iter().find(|limit| limit["mechanism"] == mechanism).expect("listed").clone()
    };
    // Stored by another solver on a grid of 50 V: the first slack point.
    let slack = limit("loss-of-tension")["voltage_v"].as_f64().expect("reached");
    assert!(slack > 10_200.0 && slack <= 10_250.0, "{slack}");
    assert_eq!(limit("breakdown")["unverified"], json!(true));
    assert_eq!(limit("loss-of-tension")["unverified"], json!(false));
    assert_eq!(answer["criteria"]["breakdown_source"]["standing"]["status"], json!("unverified"));
    assert!(answer["supervisor"]["max_v"].as_f64().expect("a limit") > 5000.0);
    assert_eq!(answer["map"]["curves"][0]["mechanism"], json!("loss-of-tension"));
}

#[test]
fn edge_failed_states_and_bad_criteria_are_refused_with_key_value_and_reason() {
    type Damage = fn(&mut Value);
    let cases: [(&str, &[&str], Damage); 8] = [
        ("failure", &["`voltage_v`", "9500", "electrical breakdown"], |c| c["voltage_v"] = json!(9500.0)),
        ("failure", &["`force_n`", "rupture", "2.05"], |c| c["rupture_stretch"] = json!(2.05)),
        ("failure", &["`voltage_v`", "11000", "limit point"], |c| c["voltage_v"] = json!(11_000.0)),
        ("solve", &["`voltage_v`", "5000", "breakdown"], |c| c["breakdown"] = json!(1e7)),
        ("solve", &["`breakdown`", "\"paschen\"", "huang-2012"], |c| c["breakdown"] = json!("paschen")),
        ("solve", &["`amplifier.current_a`", "-1", "positive"], |c| {
            c["amplifier"] = json!({"current_a": -1})
        }),
        ("map", &["`map.voltage_v`", "[from, to"], |c| c["map"] = json!({"voltage_v": [0, 1]})),
        ("map", &["`map`", "`speed` is unknown"], |c| c["map"] = json!({"speed": [0, 1, 2]})),
    ];
    for (task, parts, damage) in cases {
        let mut case = set_a();
        damage(&mut case);
        let output = run(task, &case.to_string(), &[]);
        assert_refused(&case.to_string(), output, parts);
    }
}
