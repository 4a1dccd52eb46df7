//! `telepulse send` and `telepulse receive`: two processes and the wire between them.

use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Stdio};

use super::Bench;

#[test]
fn edge_addresses_that_do_not_serve() {
    let bench = Bench::with_artefacts();
    // 192.0.2.0/24 is reserved for documentation (RFC 5737): it is nobody's, so not this machine's either.
    for address in ["127.0.0.1", "127.0.0.1:99999", "192.0.2.1:5000"] {
        bench.refused(
            &["receive", "--listen", address, "--out", "made/doctor", "--timeout-s", "1"],
            &[address, "allowed is an address of this machine with a port"],
        );
    }
    bench.refused_after(
        &["receive", "--out", "made/doctor", "--timeout-s", "0.2"],
        &["no stream arrived within 200ms"],
        1,
    );
    bench.refused(
        &["receive", "--out", "pulse.csv", "--timeout-s", "0.2"],
        &["cannot write into pulse.csv", "no folder"],
    );
    bench.refused(
        &["receive", "--out", "made", "--study", "st", "--recipes", "st", "--timeout-s", "0.2"],
        &["st holds no recipe", "best.force.recipe.json"],
    );
    // Port 9 (discard) answers nobody.
    bench.refused(
        &["send", "pulse.csv", "--to", "127.0.0.1:9", "--timeout-s", "0.3"],
        &["pulse.csv", "127.0.0.1:9", "did not finish within 300ms", "0 of 500 samples"],
    );
    bench.refused(
        &["send", "pulse.csv", "--to", "127.0.0.1"],
        &["`--to`", "found 127.0.0.1,", "allowed an address with a port"],
    );
    for (value, named) in [("-1", "found -1"), ("0", "found 0"), ("nan", "found NaN")] {
        let send = ["send", "pulse.csv", "--to", "127.0.0.1:9", "--timeout-s", value];
        bench.refused(&send, &["`--timeout-s`", named, "allowed above 0 to 86400"]);
        bench.refused(&["receive", "--out", "made", "--timeout-s", value], &["`--timeout-s`", named]);
        let scaled = ["send", "pulse.csv", "--to", "127.0.0.1:9", "--peak-to-peak-pa", value];
        bench.refused(&scaled, &["`--peak-to-peak-pa`", named, "allowed above 0"]);
    }
}

#[test]
fn edge_a_stream_that_breaks_off_leaves_its_log_and_no_recording() {
    let bench = Bench::with_artefacts();
    let (doctor, address) = listen(&bench, &["--timeout-s", "3"]);
    let patient = bench.run(&["send", "pulse.csv", "--realtime", "--to", &address, "--timeout-s", "0.6"]);
    let said = String::from_utf8_lossy(&patient.stderr);
    assert_eq!(patient.status.code(), Some(2), "{said}");
    assert!(said.contains("did not finish within 600ms"), "{said}");
    let (code, _, said) = end(doctor);
    assert_eq!(code, Some(2), "{said}");
    assert_eq!(said.lines().count(), 1, "{said}");
    assert!(said.contains("session.failed.jsonl"), "{said}");
    let left: Vec<_> = fs::read_dir(bench.path("doctor"))
        .expect("readable")
        .map(|entry| entry.expect("readable").file_name())
        .collect();
    assert_eq!(left, ["session.failed.jsonl"]);
}

/// Starts `receive` into `doctor` and waits for its address.
fn listen(bench: &Bench, more: &[&str]) -> (Child, String) {
    let arguments = [&["receive", "--json", "--listen", "127.0.0.1:0", "--out", "doctor"], more].concat();
    let mut child = bench
        .command(&arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    // Byte by byte, so that what comes later stays in the pipe.
    let mut line = String::new();
    let stderr = child.stderr.as_mut().expect("piped");
    BufReader::with_capacity(1, stderr).read_line(&mut line).expect("readable");
    let address = line.trim().strip_prefix("listening on ").unwrap_or_else(|| panic!("{line}")).to_owned();
    (child, address)
}

/// Exit code, standard output and the rest of standard error.
fn end(mut child: Child) -> (Option<i32>, String, String) {
    let (mut answered, mut said) = (String::new(), String::new());
    child.stdout.take().expect("piped").read_to_string(&mut answered).expect("UTF-8");
    child.stderr.take().expect("piped").read_to_string(&mut said).expect("UTF-8");
    (child.wait().expect("it ends").code(), answered, said)
}

#[test]
fn oracle_a_pulse_crosses_to_another_process_bit_for_bit() {
    let bench = Bench::with_artefacts();
    fs::create_dir(bench.path("recipes")).expect("a new folder");
    fs::copy(bench.path("h.recipe.json"), bench.path("recipes/hinf.displacement.recipe.json"))
        .expect("copied");
    let (doctor, address) = listen(&bench, &["--study", "st", "--recipes", "recipes", "--timeout-s", "30"]);
    let sent = bench.json(&["send", "pulse.csv", "--to", &address, "--peak-to-peak-pa", "800"]);
    let (code, answered, said) = end(doctor);
    assert_eq!(code, Some(0), "{said}");
    let received: serde_json::Value = serde_json::from_str(&answered).expect("JSON");
    assert_eq!(received["bit_exact"], true);
    assert_eq!((&received["received"], &received["lost"]), (&500.into(), &0.into()));
    assert_eq!((&received["duplicated"], &received["out_of_order"]), (&0.into(), &0.into()));
    assert_eq!(received["sha256"], sent["sha256"]);
    assert_eq!(received["replays"][0]["controller"], "hinf");
    let stored: serde_json::Value = serde_json::from_str(&bench.text("doctor/replay.json")).expect("JSON");
    assert_eq!(stored, received);

    // What arrived may be sent on: the file is then the same, byte for byte.
    let first = bench.text("doctor/received.csv");
    fs::rename(bench.path("doctor"), bench.path("first")).expect("renamed");
    let (doctor, address) = listen(&bench, &["--timeout-s", "30"]);
    bench.json(&["send", "first/received.csv", "--to", &address]);
    let (code, _, said) = end(doctor);
    assert_eq!(code, Some(0), "{said}");
    assert_eq!(bench.text("doctor/received.csv"), first);
    assert!(bench.path("doctor/session.jsonl").is_file());
}
