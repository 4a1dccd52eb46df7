//! `telepulse replay` and `telepulse pulse`: what a recording must be.

use super::{Bench, field, pulse_csv, with_line};

#[test]
fn edge_a_recording_that_is_no_recording() {
    let good = pulse_csv();
    let cases: [(&str, String, &[&str]); 6] = [
        (
            "a missing column",
            good.replace("time_s,value,unit", "time_s,value"),
            &["line 1", "column `unit` is missing", "time_s, value"],
        ),
        (
            "a NaN",
            with_line(&good, 7, |line| field(line, 1, "NaN")),
            &["line 7, column `value`", "expected a finite number", "found `NaN`"],
        ),
        ("an empty file", String::new(), &["the file is empty", "time_s,value,unit"]),
        (
            "a gap",
            with_line(&good, 100, |_| String::new()),
            &["line 100, column `time_s`", "expected about 0.784 s", "found 0.792 s"],
        ),
        (
            "another unit",
            with_line(&good, 9, |line| field(line, 2, "Pa")),
            &["line 9, column `unit`", "expected `mmHg`", "found `Pa`"],
        ),
        (
            "time that runs backwards",
            with_line(&good, 9, |line| field(line, 0, "0.001")),
            &["line 9, column `time_s`", "expected a time after 0.048 s", "found 0.001 s"],
        ),
    ];
    let bench = Bench::with_artefacts();
    for (what, text, named) in cases {
        assert_ne!(text, good, "{what}");
        bench.put("r.csv", &text);
        let named = [&["r.csv"], named].concat();
        let study = ["--study", "st", "--out", "made/run.json"];
        for command in [
            &["pulse", "info", "r.csv"][..],
            &["pulse", "analyze", "r.csv"],
            &["send", "r.csv", "--to", "127.0.0.1:9"],
            &[&["replay", "h.recipe.json", "r.csv"], &study[..]].concat(),
            &[&["track", "h.recipe.json", "--reference", "r.csv"], &study[..]].concat(),
        ] {
            bench.refused(command, &named);
        }
    }
}

#[test]
fn edge_a_recording_that_cannot_be_replayed() {
    let bench = Bench::with_artefacts();
    let replay = ["replay", "h.recipe.json", "r.csv", "--study", "st", "--out", "made/run.json"];
    let track = ["track", "h.recipe.json", "--reference", "r.csv", "--study", "st", "--out", "made/run.json"];
    let series = |unit: &str, n: u32, value: &dyn Fn(u32) -> f64| {
        let lines = (0..n).map(|k| format!("{:.2},{},{unit}\n", f64::from(k) / 100.0, value(k)));
        format!("time_s,value,unit\n{}", lines.collect::<String>())
    };
    bench.put("r.csv", &series("mmHg", 300, &|_| 5.0));
    bench.refused(&replay, &["r.csv", "constant"]);
    // Twenty samples at 100 Hz span 0.19 s, and one tick of 0.5 ms more.
    bench.put("r.csv", &series("mmHg", 20, &|k| f64::from(k % 7)));
    bench.refused(&replay, &["r.csv", "lasts 0.1905 s", "allowed at least 1.2 s"]);
    bench.refused(&track, &["r.csv", "lasts 0.1905 s", "allowed at least 1.2 s"]);
    bench.put("r.csv", &series("Pa", 300, &|k| 1e4 * f64::from(k % 7)));
    bench.refused(&replay, &["r.csv", "allowed 0 to 2.5 mm", "`reference.offset_mm`", "`pulse.pa_per_mm`"]);
    bench.refused(&track, &["r.csv", "allowed 0 to 2.5 mm"]);
    bench.put("r.csv", &series("mm", 300, &|k| 0.5 * f64::from(k)));
    bench.refused(&track, &["r.csv", "column `value`", "found 3 mm", "allowed 0 to 2.5 mm"]);
}
