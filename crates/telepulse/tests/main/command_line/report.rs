//! `telepulse report`: what is no study that was run.

use super::Bench;

#[test]
fn edge_a_report_of_nothing() {
    let bench = Bench::new();
    bench.put("full/note.txt", "mine");
    bench.refused(&["report", "full"], &["cannot read", "report.json"]);
    bench.refused(&["report", "full", "--out", "made"], &["cannot read", "report.json"]);
    bench.refused(&["report", "nowhere"], &["cannot read", "report.json"]);
    bench.put("full/report.json", "{}");
    bench.refused(&["report", "full"], &["report.json", "not the report of a study", "line 1"]);
}
