//! `telepulse identify`: what a sweep must be.

use super::{Bench, field, sweep_csv, with_line};

// ---- bad input ----

#[test]
fn edge_a_sweep_that_is_no_sweep() {
    let good = sweep_csv();
    let header = "frequency_hz,amplitude,magnitude,phase_deg";
    let cases: [(&str, String, &[&str]); 10] = [
        (
            "a missing column",
            good.replace("magnitude,", ""),
            &["line 1", "column `magnitude` is missing", "found `frequency_hz,amplitude,phase_deg`", header],
        ),
        (
            "a NaN",
            with_line(&good, 4, |line| field(line, 2, "NaN")),
            &["line 4, column `magnitude`", "allowed is a number above 0", "found `NaN`"],
        ),
        (
            "a word",
            with_line(&good, 4, |line| field(line, 3, "late")),
            &["line 4, column `phase_deg`", "a number", "found `late`"],
        ),
        // Once here: the fit never ended with numbers whose squares overflow.
        (
            "a magnitude beyond any device",
            with_line(&good, 4, |line| field(line, 2, "1e200")),
            &["line 4, column `magnitude`", "allowed is a number from 1e-9 to 1e6"],
        ),
        ("an empty file", String::new(), &["found an empty file", header]),
        ("a header alone", format!("{header}\n"), &["at least 5 different frequencies", "found 0"]),
        (
            "a negative frequency",
            with_line(&good, 2, |line| field(line, 0, "-0.1")),
            &["line 2, column `frequency_hz`", "allowed is a number above 0", "found `-0.1`"],
        ),
        (
            "a point given twice",
            with_line(&good, 3, |line| field(line, 0, "0.1")),
            &["line 3: 0.1 Hz at amplitude 0.2", "line 2", "allowed is once"],
        ),
        (
            "too few frequencies",
            good.lines().take(5).map(|line| format!("{line}\n")).collect(),
            &["at least 5 different frequencies", "found 4"],
        ),
        (
            "a line too short",
            with_line(&good, 4, |line| line.rsplit_once(',').map_or(String::new(), |(rest, _)| rest.into())),
            &["line 4", "expected 4 fields", "found 3"],
        ),
    ];
    let bench = Bench::new();
    for (what, text, named) in cases {
        assert_ne!(text, good, "{what}");
        bench.put("s.csv", &text);
        let out = ["--out", "made/model.json", "--save-sweep", "made/sweep.csv"];
        let named = [&["s.csv"], named].concat();
        bench.refused(&[&["identify", "--study", "st", "--sweep", "s.csv"], &out[..]].concat(), &named);
    }
    // The good one is taken, so what was refused was refused for its fault.
    bench.put("s.csv", &good);
    bench.done(&["identify", "--study", "st", "--sweep", "s.csv", "--out", "made/model.json"]);
    bench.refused(&["identify", "--study", "st", "--sweep", "none.csv"], &["cannot read none.csv"]);
}
