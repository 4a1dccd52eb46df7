//! Patient and doctor as two processes on loopback.

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, Stdio};

use anyhow::{Context, Result, ensure};

use super::config::Study;
use super::outcome::Link;
use crate::station::doctor::{LISTENING, Received};
use crate::station::replay::Replayed;
use crate::{artefact, recording};

/// The doctor's process at work, with the patient's beside it.
#[derive(Debug)]
pub struct Transmission {
    doctor: Doctor,
    patient: Child,
    folder: PathBuf,
    sent: telepulse_pulse::PulseRecording,
}

/// The doctor's process; it is ended with its owner.
#[derive(Debug)]
struct Doctor {
    process: Child,
    messages: BufReader<ChildStderr>,
}

impl Drop for Doctor {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// What came of it.
#[derive(Debug, Clone)]
pub struct Transmitted {
    /// For the report.
    pub link: Link,
    /// The replays of the doctor's process.
    pub replays: Vec<Replayed>,
}

/// Starts the doctor's process, waits until it listens, and starts the patient's process.
///
/// # Errors
/// Where one of them cannot be started, or the doctor's side does not come to listen.
pub fn start(study: &Study, program: &Path, recipes: &Path, folder: &Path) -> Result<Transmission> {
    let recording_path = study.path(&study.pulse.recording);
    let sent = recording::read(&recording_path)?
        .scaled_to_peak_to_peak(study.pulse.peak_to_peak_pa, telepulse_pulse::Unit::Pascal)
        .with_context(|| format!("in {}", recording_path.display()))?;
    let mut process = Command::new(program)
        .args(["receive", "--json", "--listen", "127.0.0.1:0", "--out"])
        .arg(folder)
        .arg("--study")
        .arg(&study.file)
        .arg("--recipes")
        .arg(recipes)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .with_context(|| format!("cannot start the doctor's process, {}", program.display()))?;
    let stderr = process.stderr.take().context("the doctor's process has no standard error")?;
    let mut doctor = Doctor { process, messages: BufReader::new(stderr) };
    let mut line = String::new();
    doctor.messages.read_line(&mut line).context("the doctor's process does not speak")?;
    let address = line
        .strip_prefix(LISTENING)
        .with_context(|| format!("the doctor's process could not listen: {}", line.trim()))?
        .trim()
        .to_owned();
    let patient = Command::new(program)
        .args(["send", "--json", "--to", &address, "--peak-to-peak-pa"])
        .arg(study.pulse.peak_to_peak_pa.to_string())
        .arg(&recording_path)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .with_context(|| format!("cannot start the patient's process, {}", program.display()))?;
    Ok(Transmission { doctor, patient, folder: folder.to_path_buf(), sent })
}

impl Transmission {
    /// Waits for both processes and compares what was received with what was sent, bit by bit.
    ///
    /// # Errors
    /// Where one of them failed, with what it said.
    pub fn finish(mut self) -> Result<Transmitted> {
        let patient_id = self.patient.id();
        let patient = self.patient.wait_with_output().context("the patient's process was lost")?;
        ensure!(
            patient.status.success(),
            "the patient's process failed: {}",
            String::from_utf8_lossy(&patient.stderr).trim()
        );
        let status = self.doctor.process.wait().context("the doctor's process was lost")?;
        let mut said = String::new();
        let _ = self.doctor.messages.read_to_string(&mut said);
        // 1 says that a replay was unstable: that is a result, not a failure.
        ensure!(matches!(status.code(), Some(0 | 1)), "the doctor's process failed: {}", said.trim());

        let path = self.folder.join("replay.json");
        let received: Received = serde_json::from_str(&artefact::read_text(&path)?)
            .with_context(|| format!("in {}", path.display()))?;
        let stored = recording::read(&self.folder.join("received.csv"))?;
        let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<u64>>();
        let same = bits(stored.values()) == bits(self.sent.values());
        let own = std::process::id();
        ensure!(
            received.process != own && patient_id != own && received.process != patient_id,
            "patient and doctor did not run as processes of their own"
        );
        let link = Link {
            sent: self.sent.n_samples() as u64,
            received: received.received,
            lost: received.lost,
            duplicated: received.duplicated,
            out_of_order: received.out_of_order,
            bit_exact: received.bit_exact && same,
            processes: 2,
            retransmitted_frames: received.retransmitted_frames,
            duplicate_frames_dropped: received.duplicate_frames_dropped,
            sha256: received.sha256,
        };
        Ok(Transmitted { link, replays: received.replays })
    }
}
