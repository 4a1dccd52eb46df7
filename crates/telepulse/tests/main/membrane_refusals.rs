//! What the `membrane` commands refuse, point by point: one line with key, value and reason, exit code 2, nothing half-written.

use serde_json::{Value, json};

use crate::membrane_program::{assert_refused, run};

type Damage = fn(&mut Value);

fn set_a() -> Value {
    json!({
        "material": {"model": "gent", "mu_pa": 37220.0, "J": 110.0},
        "a_m": 0.0127, "b_m": 0.06858, "thickness_m": 0.001, "prestretch": 2.0,
        "relative_permittivity": 5.8, "voltage_v": 5000.0, "force_n": 0.980665
    })
}

fn motion_a() -> Value {
    json!({"parameter_set": "A", "drive": {"shape": "step", "voltage_v": 5000.0}, "duration_s": 0.1})
}

/// What every command that reads a sheet refuses.
const SHEET: [(&[&str], Damage); 20] = [
    (&["`thickness_m`", "-0.001", "positive"], |c| c["thickness_m"] = json!(-0.001)),
    (&["`thickness_m`", "0", "positive"], |c| c["thickness_m"] = json!(0)),
    (&["`thickness_m`", "1e-300", "1e-30"], |c| c["thickness_m"] = json!(1e-300)),
    (&["`b_m`", "1e300", "1e30"], |c| c["b_m"] = json!(1e300)),
    (&["`a_m`", "0.06858", "smaller than b_m"], |c| c["a_m"] = json!(0.06858)),
    (&["`a_m`", "0.1", "smaller than b_m"], |c| c["a_m"] = json!(0.1)),
    (&["`prestretch`", "0.9", "slack"], |c| c["prestretch"] = json!(0.9)),
    (&["`prestretch`", "8.7", "Gent limit 110"], |c| c["prestretch"] = json!(8.7)),
    (&["`force_n`", "1000", "limit point"], |c| c["force_n"] = json!(1000)),
    (&["`voltage_v`", "11000", "limit point"], |c| c["voltage_v"] = json!(11_000)),
    (&["`voltage_v`", "9500", "electrical breakdown", "strength"], |c| {
        c["voltage_v"] = json!(9500);
        c["breakdown"] = json!("smirnov-2018");
    }),
    (&["`displacement_m`", "10", "Gent limit 110"], |c| {
        c.as_object_mut().expect("an object").remove("force_n");
        c["displacement_m"] = json!(10);
    }),
    (&["`material`", "\"rubber\"", "neo-hookean"], |c| c["material"]["model"] = json!("rubber")),
    (&["`force_n` and `displacement_m`", "give one"], |c| c["displacement_m"] = json!(0.001)),
    (&["`force_n` or `displacement_m` is missing"], |c| c["force_n"] = Value::Null),
    (&["`a_m` is missing"], |c| c["a_m"] = Value::Null),
    (&["`a_m`", "a number", "\"0.0127\""], |c| c["a_m"] = json!("0.0127")),
    (&["`voltage_v`", "a number", "[1]"], |c| c["voltage_v"] = json!([1])),
    (&["`relative_permittivity`", "positive", "-5.8"], |c| c["relative_permittivity"] = json!(-5.8)),
    (&["`material`", "`mu_pa`", "1e300"], |c| c["material"]["mu_pa"] = json!(1e300)),
];

#[test]
fn edge_sheets_and_states_that_none_of_three_commands_takes() {
    for (parts, damage) in SHEET {
        let mut case = set_a();
        damage(&mut case);
        let text = case.to_string();
        for task in ["solve", "failure"] {
            assert_refused(&text, run(task, &text, &[]), parts);
        }
        // A map's axes leave the state: it judges no breakdown.
        if !parts.contains(&"electrical breakdown") {
            assert_refused(&text, run("map", &text, &[]), parts);
        }
    }
}

#[test]
fn edge_text_that_is_no_case() {
    let good = set_a().to_string();
    for (text, parts) in [
        (good.replace("5000.0", "NaN"), ["`voltage_v`", "NaN"]),
        (good.replace("0.0127", "-Infinity"), ["`a_m`", "Infinity"]),
        (good.replacen('{', "{\"a_m\": 0.01, ", 1), ["`a_m`", "twice"]),
        (good[..40].to_owned(), ["EOF", "line 1"]),
        ("[]".to_owned(), ["an object", "[]"]),
        (String::new(), ["EOF", "line 1"]),
    ] {
        for task in ["solve", "map", "failure", "simulate", "calibrate", "optimize"] {
            assert_refused(&text, run(task, &text, &[]), &parts);
        }
    }
}

#[test]
fn edge_a_refused_map_leaves_no_figures_behind() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let figures = folder.path().join("figures");
    let mut case = set_a();
    case["voltage_v"] = json!(11_000);
    for task in ["map", "failure"] {
        let output = run(task, &case.to_string(), &["--figures", figures.to_str().expect("UTF-8")]);
        assert_refused(task, output, &["`voltage_v`", "limit point"]);
        assert!(!figures.exists(), "{task}: half-written");
    }
}

#[test]
fn edge_motions_that_are_refused() {
    let cases: [(&[&str], Damage); 12] = [
        (&["`thickness_m`", "-1", "positive"], |c| c["thickness_m"] = json!(-1)),
        (&["`a_m`", "0.1", "smaller than b_m"], |c| c["a_m"] = json!(0.1)),
        (&["`prestretch`", "0.5", "slack"], |c| c["prestretch"] = json!(0.5)),
        (&["`mass_kg`", "100", "Gent limit"], |c| c["mass_kg"] = json!(100)),
        (&["`mass_kg`", "1e-20", "1e-6"], |c| c["mass_kg"] = json!(1e-20)),
        (&["`rc_s`", "1e-20", "1e-7"], |c| c["rc_s"] = json!(1e-20)),
        (&["`branches`", "1e-20", "never acts"], |c| c["branches"] = json!([[1e4, 1e-20]])),
        (&["`drive`", "6000", "5000"], |c| c["drive"]["voltage_v"] = json!(6000)),
        (&["`full_scale_v`", "12000", "slack"], |c| c["full_scale_v"] = json!(12_000)),
        (&["`material`", "ogden", "no dynamics"], |c| {
            c["material"] = json!({"model": "ogden", "terms": [[1e4, 2.0]]});
        }),
        (&["`drive`", "electrical breakdown", "1000000"], |c| c["breakdown"] = json!(1e6)),
        (&["`scatter`", "\"field\""], |c| {
            c["fidelity"] = json!("field");
            c["scatter"] = json!({"n_variants": 2, "seed": 1, "relative": {"mu_pa": 0.1}});
        }),
    ];
    for (parts, damage) in cases {
        let mut case = motion_a();
        damage(&mut case);
        let text = case.to_string();
        assert_refused(&text, run("simulate", &text, &[]), parts);
    }
}

#[test]
fn edge_batches_tell_of_each_bad_variant_and_go_on() {
    let optimize = json!({
        "base": "A", "limits": {"amplifier_v": 5000.0, "field_v_per_m": 35e6, "voltage_margin": 1.25},
        "sweep": {"thickness_m": [-1e-3, 1e-300, 1e-3, 1e300], "inner_radius_m": [0.0127, 0.1]}
    });
    let output = run("optimize", &optimize.to_string(), &[]);
    assert_eq!(output.status.code(), Some(0));
    let answer: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let (n, failed) = (answer["n_variants"].as_u64(), answer["failed"].as_array().expect("a list"));
    assert_eq!((n, failed.len()), (Some(8), answer["n_failed"].as_u64().expect("a count") as usize));
    assert!((5..8).contains(&failed.len()), "{failed:?}");
    for variant in failed {
        let reason = variant["reason"].as_str().expect("a reason");
        assert!(reason.len() > 10 && reason.len() < 400 && !reason.contains("NaN"), "{reason}");
    }
    let mut scatter = motion_a();
    scatter["scatter"] = json!({"n_variants": 12, "seed": 1, "relative": {"mu_pa": 3.0}});
    let output = run("simulate", &scatter.to_string(), &[]);
    assert_eq!(output.status.code(), Some(0));
    let answer: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let variants = answer["variants"].as_array().expect("a list");
    let (bad, good): (Vec<&Value>, Vec<&Value>) = variants.iter().partition(|v| v["error"].is_string());
    assert!(!bad.is_empty() && !good.is_empty(), "{} bad of {}", bad.len(), variants.len());
    for variant in good {
        assert!(variant["displacement_end_m"].is_f64(), "{variant}");
    }
    // A map tells which of its points have no state.
    let mut map = set_a();
    map["map"] = json!({"displacement_m": [0.0, 0.012, 3], "voltage_v": [0.0, 12_000.0, 4]});
    let output = run("map", &map.to_string(), &[]);
    assert_eq!(output.status.code(), Some(0));
    let answer: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let empty =
        answer["force_n"].as_array().expect("rows").iter().flat_map(|row| row.as_array().expect("a row"));
    let n_refused = answer["refused"].as_array().expect("a list").len();
    assert_eq!(empty.filter(|value| value.is_null()).count(), n_refused);
    assert!(n_refused > 0);
}

#[test]
fn edge_calibration_records_with_gaps_or_without_numbers() {
    let rows = |change: fn(usize) -> Option<[f64; 2]>| -> Value {
        (0..30)
            .map(|k| {
                let t = 0.05 * k as f64;
                change(k).map_or_else(|| json!([t, 1.0 - (-t).exp()]), |row| json!(row))
            })
            .collect::<Vec<Value>>()
            .into()
    };
    let case = |rows: Value| {
        json!({"start": "C", "free": ["mu_pa"],
               "records": [{"kind": "step", "to_v": 5000, "noise_mm": 0.01, "rows": rows}]})
        .to_string()
    };
    let good = case(rows(|_| None));
    for (text, parts) in [
        (case(rows(|k| (k >= 10).then_some([5.0 + 0.05 * k as f64, 0.9]))), ["`time_s`", "row 11", "gap"]),
        (case(rows(|k| (k == 3).then_some([0.05, 0.1]))), ["`time_s`", "row 4", "ascend"]),
        (good.replacen("[0.0,0.0]", "[0.0,null]", 1), ["`displacement_mm`", "row 1", "null"]),
        (good.replacen("[0.0,0.0]", "[0.0,NaN]", 1), ["`rows`", "NaN", "number"]),
        (good.replace("5000", "100000"), ["`to_v`", "100000", "full_scale_v"]),
        (good.replace("0.01,", "-0.01,"), ["`noise_mm`", "-0.01", "positive"]),
    ] {
        assert_refused(&text, run("calibrate", &text, &[]), &parts);
    }
}

#[test]
fn law_marks_of_unverified_limits_are_in_the_answers() {
    for (law, unverified) in [("koh-2011", true), ("huang-2012", true), ("smirnov-2018", false)] {
        let mut case = set_a();
        case["breakdown"] = json!(law);
        let answer: Value =
            serde_json::from_slice(&run("failure", &case.to_string(), &[]).stdout).expect("JSON");
        let standing = &answer["criteria"]["breakdown_source"]["standing"];
        assert_eq!(standing["status"] == "unverified", unverified, "{law}: {standing}");
        assert_eq!(answer["criteria"]["rupture_standing"]["status"], "unverified");
        let marked = |list: &Value, mechanism: &str| {
            let all = list.as_array().expect("a list");
            all.iter().find(|m| m["mechanism"] == mechanism).expect("judged")["unverified"] == true
        };
        for list in [&answer["state"]["margins"], &answer["voltage_limits"]] {
            assert_eq!(marked(list, "breakdown"), unverified, "{law}");
            assert!(marked(list, "rupture"), "rupture is assumed");
        }
        let mut motion = motion_a();
        motion["breakdown"] = json!(law);
        let answer: Value =
            serde_json::from_slice(&run("simulate", &motion.to_string(), &[]).stdout).expect("JSON");
        let worst = answer["margins"]["worst"].as_array().expect("a list");
        let found = worst.iter().find(|w| w["margin"]["mechanism"] == "breakdown").expect("judged");
        assert_eq!(found["margin"]["unverified"], unverified, "{law}");
        assert_eq!(answer["criteria"]["breakdown_law"], law);
    }
}

#[test]
fn law_margins_of_a_motion_hold_its_overshoot_in_both_fidelities() {
    let mut state = set_a();
    state["amplifier"] = json!({"max_v": 6000.0});
    let rest: Value = serde_json::from_slice(&run("failure", &state.to_string(), &[]).stdout).expect("JSON");
    let left = |list: &Value, mechanism: &str| {
        let all = list.as_array().expect("a list");
        let margin =
            |entry: &Value| if entry["margin"].is_object() { entry["margin"].clone() } else { entry.clone() };
        let found = all.iter().map(margin).find(|m| m["mechanism"] == mechanism).expect("judged");
        found["left"].as_f64().expect("a number")
    };
    let mut lefts = Vec::new();
    for fidelity in ["reduced", "field"] {
        let mut case = motion_a();
        case["duration_s"] = json!(1.0);
        case["step_s"] = json!(2e-3);
        case["fidelity"] = json!(fidelity);
        let answer: Value =
            serde_json::from_slice(&run("simulate", &case.to_string(), &[]).stdout).expect("JSON");
        assert!(answer["margins"]["first_failure_s"].is_null());
        let found = ["rupture", "breakdown", "loss-of-tension"].map(|m| left(&answer["margins"]["worst"], m));
        assert!(found[0] < left(&rest["state"]["margins"], "rupture"), "the overshoot stretches further");
        lefts.push(found);
    }
    for (reduced, field) in lefts[0].iter().zip(&lefts[1]) {
        // The two plates differ by 1e-4 mm of 1.5 mm.
        assert!((reduced - field).abs() < 1e-3, "{lefts:?}");
    }
}
