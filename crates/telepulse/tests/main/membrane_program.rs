//! The program's `membrane` commands as a test calls them: a case on standard input, an answer or one line of refusal out.

use std::io::Write;
use std::process::{Command, Output, Stdio};

/// Runs `telepulse membrane TASK - --json MORE` on a case.
pub(crate) fn run(task: &str, case: &str, more: &[&str]) -> Output {
    let mut child = Command::new(env!("CARGO_BIN_EXE_telepulse"))
        .args(["membrane", task, "-", "--json"])
        .args(more)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    child.stdin.take().expect("piped").write_all(case.as_bytes()).expect("written");
    child.wait_with_output().expect("the program ends")
}

/// Exit code 2, no answer, and one line that holds every part.
pub(crate) fn assert_refused(case: &str, output: Output, parts: &[&str]) {
    let said = String::from_utf8(output.stderr).expect("UTF-8");
    assert_eq!(output.status.code(), Some(2), "{case}: {said}");
    assert!(output.stdout.is_empty(), "{case}: answered all the same");
    assert_eq!(said.lines().count(), 1, "{case}: {said}");
    for part in parts {
        assert!(said.contains(part), "{case}: `{part}` is not in: {said}");
    }
}
