//! `telepulse study`: what a study may say, and what a run leaves behind.

use std::fs;

use super::{Bench, plant, sweep_csv};

#[test]
fn edge_a_study_that_says_something_else() {
    let cases: [(&str, &str, &[&str]); 17] = [
        ("bias = 0.5", "bias = 0.5\nbiass = 1", &["line ", "column 1, key `identify.biass`", "`bias`"]),
        ("[pid.auto]", "[pidd]\nx = 1\n[pid.auto]", &["key `pidd`", "unknown field", "`pid`"]),
        ("amplitude_mm = 0.1,", "amplitud_mm = 0.1,", &["key `reference.sines.amplitud_mm`", "`phase_rad`"]),
        (
            "bias = 0.5",
            "bias = \"half\"",
            &["line ", "column 8, key `identify.bias`", "\"half\"", "a number"],
        ),
        ("n_frequencies = 30", "n_frequencies = -3", &["key `identify.n_frequencies`", "-3", "whole number"]),
        ("rc_s = 0.0045", "rc_s = \"fre\"", &["key `identify.rc_s`", "seconds or \"free\""]),
        ("parameter_set = \"A\"", "parameter_set = \"D\"", &["key `actuator.parameter_set`", "`D`", "`A`"]),
        ("bias = 0.5", "bias = = 0.5", &["line ", "column 8, found `bias = = 0.5`"]),
        ("bias = 0.5\n", "", &["line ", "key `identify.bias` is missing"]),
        ("version = 1\n", "", &["key `version` is missing"]),
        ("version = 1", "version = 2", &["key `version`", "found 2", "allowed 1"]),
        ("name = \"diaphragm-2017\"", "name = \"../x\"", &["key `name`", "found \"../x\"", "letters"]),
        (
            "sample_rate_hz = 2000.0",
            "sample_rate_hz = 20.0",
            &["`control.sample_rate_hz`", "20", "200 to 20000"],
        ),
        ("frequency_min_hz = 0.1", "frequency_min_hz = -0.1", &["`identify.frequency_min_hz`", "found -0.1"]),
        ("bias = 0.5", "bias = nan", &["key `identify.bias`", "found NaN", "allowed 0.01 to 0.99"]),
        ("max_v = 5000.0", "max_v = 7000.0", &["key `control.max_v`", "found 7000", "allowed 1 to 5000"]),
        (
            "recording = \"or_abp_40s.csv\"",
            "recording = \"nobody.csv\"",
            &["key `pulse.recording`", "cannot read", "nobody.csv"],
        ),
    ];
    for (old, new, named) in cases {
        let bench = Bench::new();
        bench.edit_study(old, new);
        bench.refused(&["study", "run", "st", "--out", "made"], &[&["study.toml"], named].concat());
    }
    let bench = Bench::new();
    bench.edit_study("n_frequencies = 30", "n_frequencies = 30\nsweep_csv = \"mine.csv\"");
    for command in
        [&["study", "run", "st", "--out", "made"][..], &["identify", "--study", "st", "--out", "m.json"]]
    {
        bench.refused(command, &["study.toml", "key `identify.sweep_csv`", "cannot read", "mine.csv"]);
    }
    bench.put("st/mine.csv", &sweep_csv().replace("frequency_hz", "f"));
    bench.refused(
        &["study", "run", "st", "--out", "made"],
        &["study.toml", "key `identify.sweep_csv`", "mine.csv", "line 1", "column `frequency_hz` is missing"],
    );
    bench.refused(&["study", "run", "nowhere", "--out", "made"], &["cannot read nowhere"]);
    bench.refused(&[], &["studies/diaphragm-2017", "study run DIR"]);
}

#[test]
fn edge_a_study_that_fails_at_work_leaves_nothing() {
    let bench = Bench::new();
    // Twelve points instead of ninety: the sweeps are not what is tested.
    bench.edit_study("n_frequencies = 30", "n_frequencies = 12");
    bench.edit_study("amplitudes = [0.2, 0.4, 0.5]", "amplitudes = [0.2]");
    bench.edit_study("frequency_min_hz = 0.1", "frequency_min_hz = 0.5");
    bench.edit_study("control = { numerator = [0.1, 0.0006283]", "control = { numerator = [0.1]");
    bench.refused(
        &["study", "run", "st", "--out", "made/deep"],
        &["study.toml", "no H-infinity controller", "D12"],
    );
}

#[test]
fn edge_a_study_of_a_device_that_the_rig_is_not() {
    let bench = Bench::new();
    bench.edit_study("[weights]", &plant("1350.14", "0.0045, 1.07182, 22.458, 1444.0", "1.0, 45.0, 2500.0"));
    bench.refused(&["study", "run", "st", "--out", "made"], &["study.toml", "`plant`", "virtual rig"]);
}

#[test]
fn edge_what_is_not_ours_is_left_alone() {
    let bench = Bench::new();
    bench.put("full/note.txt", "mine");
    bench.refused(&["study", "new", "full"], &["full exists", "not an empty folder", "left alone"]);
    bench.refused(&["study", "new", "full/note.txt"], &["note.txt exists", "left alone"]);
    bench.put("out/diaphragm-2017/note.txt", "mine");
    bench.refused(
        &["study", "run", "st", "--out", "out"],
        &["diaphragm-2017 exists", "no report.json", "left alone"],
    );
    bench.refused(&["study", "run", "st", "--out", "full/note.txt"], &["cannot make folder full/note.txt"]);
    bench.put("s.csv", &sweep_csv());
    let identify = ["identify", "--study", "st", "--sweep", "s.csv", "--save-sweep", "made/s.csv", "--out"];
    bench.refused(&[&identify[..], &["full"]].concat(), &["cannot write full", "a folder"]);
    bench.refused(&[&identify[..], &["s.csv/m.json"]].concat(), &["cannot make folder s.csv"]);
}

#[test]
fn law_a_new_study_is_the_default_one_and_its_report_can_be_made_anew() {
    let bench = Bench::new();
    let answer = bench.json(&["study", "new", "mine"]);
    assert_eq!(answer["files"].as_array().map(Vec::len), Some(10));
    assert_eq!(bench.text("mine/study.toml"), bench.text("st/study.toml"));

    let outcome = bench.json(&["study", "run", "mine", "--out", "out"]);
    let folder = "out/diaphragm-2017";
    let report: serde_json::Value =
        serde_json::from_str(&bench.text(&format!("{folder}/report.json"))).expect("JSON");
    assert_eq!(outcome, report);
    assert_eq!(outcome["link"]["bit_exact"], true);
    let page = bench.text(&format!("{folder}/report.html"));
    let answer = bench.json(&["report", folder, "--out", "again"]);
    assert!(answer["files"].as_array().is_some_and(|files| files.len() > 10));
    assert_eq!(bench.text("again/report.html"), page);
    // A second run takes the place of the first one.
    let left: Vec<_> = fs::read_dir(bench.path("out")).expect("readable").collect();
    assert_eq!(left.len(), 1, "only the results stay: {left:?}");
}
