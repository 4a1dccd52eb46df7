//! `telepulse membrane calibrate`: records in, parameters with errors or one line of refusal out.

use std::process::Command;

use serde_json::{Value, json};

use crate::membrane_program::{assert_refused, run};

/// The printed plant as rows of a sweep: Eq. (16) once more, independent of the program's own.
fn printed_rows() -> Vec<[f64; 3]> {
    (0..=20)
        .map(|idx| {
            let hz = 0.1 * 130.0_f64.powf(f64::from(idx) / 20.0);
            let w = 2.0 * std::f64::consts::PI * hz;
            let (re, im) = (1444.0 - 1.07182 * w * w, 22.458 * w - 0.0045 * w.powi(3));
            [hz, 1350.14 / re.hypot(im), -im.atan2(re).to_degrees()]
        })
        .collect()
}

fn case() -> Value {
    json!({
        "start": "C",
        "free": ["mu_pa", {"key": "relative_permittivity", "bounds": [3.0, 9.0]}, "damping_n_s_per_m"],
        "records": [
            {"kind": "sweep", "name": "figure 7", "bias_v": 2500.0, "noise_mm_per_unit": 0.001, "rows": printed_rows()}
        ]
    })
}

#[test]
fn paper_eq16_as_rows_gives_set_c() {
    let output = run("calibrate", &case().to_string(), &[]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let answer: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    for (idx, (key, expected)) in
        [("mu_pa", 38_635.0), ("relative_permittivity", 6.0109), ("damping_n_s_per_m", 1.596)]
            .into_iter()
            .enumerate()
    {
        let fitted = &answer["fitted"][idx];
        assert_eq!(fitted["key"], key);
        let value = fitted["value"].as_f64().expect("a number");
        // The expanded denominators are printed to five digits.
        assert!((value / expected - 1.0).abs() < 1e-4, "{key}: {value}");
        assert_eq!(fitted["determined"], true);
    }
    assert_eq!(answer["meets_records"], true);
    assert_eq!(answer["parameters"]["mu_pa"], answer["fitted"][0]["value"]);
    assert_eq!(answer["correlation"].as_array().expect("rows").len(), 3);
    assert!(answer["combinations"][0]["name"].as_str().expect("a name").contains("mu_pa"));
}

#[test]
fn edge_each_bad_case_is_refused_with_key_value_and_reason() {
    type Damage = fn(&mut Value);
    let cases: [(&[&str], Damage); 14] = [
        (&["`figure 7`", "`magnitude`", "row 3", "null"], |c| {
            c["records"][0]["rows"][2][1] = Value::Null;
        }),
        (&["`figure 7`", "`frequency_hz`", "row 2", "ascend"], |c| {
            c["records"][0]["rows"][1][0] = json!(0.05);
        }),
        (&["`figure 7`", "`frequency_hz`", "row 21", "90", "inertia"], |c| {
            c["records"][0]["rows"][20][0] = json!(90.0);
        }),
        (&["`figure 7`", "row 1", "[1.0]"], |c| c["records"][0]["rows"][0] = json!([1.0])),
        (&["`figure 7`", "`bias_v`", "0", "zero bias"], |c| c["records"][0]["bias_v"] = json!(0.0)),
        (&["`figure 7`", "`noise_mm_per_unit`", "missing"], |c| {
            c["records"][0]["noise_mm_per_unit"] = Value::Null;
        }),
        (&["`figure 7`", "`noise_mm_per_unit`", "-1", "positive"], |c| {
            c["records"][0]["noise_mm_per_unit"] = json!(-1.0);
        }),
        (&["`kind`", "\"sweep\"", "ramp"], |c| c["records"][0]["kind"] = json!("ramp")),
        (&["`free`", "`mu_kpa`", "unknown"], |c| c["free"][0] = json!("mu_kpa")),
        (&["`free`", "`branches[0].modulus_pa`", "unknown"], |c| {
            c["free"][0] = json!("branches[0].modulus_pa");
        }),
        (&["`free`", "`relative_permittivity`", "within its bounds"], |c| {
            c["free"][1]["bounds"] = json!([7.0, 9.0]);
        }),
        (&["`start`", "\"D\""], |c| c["start"] = json!("D")),
        (&["`records`", "0 values"], |c| c["records"] = json!([])),
        (&["`colour`", "no meaning"], |c| c["colour"] = json!("red")),
    ];
    for (parts, damage) in cases {
        let mut case = case();
        damage(&mut case);
        let output = run("calibrate", &case.to_string(), &[]);
        assert_refused(&case.to_string(), output, parts);
    }
}

#[test]
fn edge_a_file_with_gaps_names_column_row_and_reason() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).expect("written");
        path
    };
    let case = at(
        "case.json",
        r#"{"start": "A", "free": ["mu_pa"], "records": [{"kind": "creep", "to_v": 4000, "noise_mm": 0.003, "file": "creep.csv"}]}"#,
    );
    for (text, parts) in [
        ("time_s,displacement_mm\n1,0.6\n2,\n3,0.61\n", ["`displacement_mm`", "row 2"]),
        ("time_s,displacement_mm\n1,0.6\n2,NaN\n3,0.61\n", ["`displacement_mm`", "row 2"]),
        ("time_s,displacement_mm\n1,0.6\n2,0.6\n3,0.61\n90,0.62\n91,0.62\n", ["`time_s`", "gap"]),
        ("time_s,displacement_mm\n2,0.6\n1,0.6\n", ["`time_s`", "ascend"]),
        ("time_s,x_mm\n1,0.6\n", ["`displacement_mm`", "no column"]),
        ("time_s,displacement_mm\n", ["creep.csv", "no rows"]),
    ] {
        at("creep.csv", text);
        let output = Command::new(env!("CARGO_BIN_EXE_telepulse"))
            .args(["membrane", "calibrate"])
            .arg(&case)
            .output()
            .expect("the program runs");
        let said = String::from_utf8(output.stderr).expect("UTF-8");
        assert_eq!(output.status.code(), Some(2), "{text}: {said}");
        for part in parts {
            assert!(said.contains(part), "`{part}` is not in: {said}");
        }
    }
}
