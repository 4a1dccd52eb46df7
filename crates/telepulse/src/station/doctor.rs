//! The doctor's process: receives a pulse, proves its arrival, replays it.

use std::io::{BufWriter, Write};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};
use telepulse_actuator::twin::TwinModel;
use telepulse_link::net::{Listener, ReceiveOptions};
use telepulse_link::record::verify_log_file;
use telepulse_pulse::{PulseRecording, Unit};

use super::device;
use super::replay::{Job, Replayed, read_recipes, replay_all};
use crate::artefact::{self, GrowingFile};
use crate::recording;
use crate::study::config::Study;

/// How the line begins that tells on which address the doctor's side listens.
pub const LISTENING: &str = "listening on ";

/// What the doctor's process is asked to do.
#[derive(Debug, Clone)]
pub struct Order {
    /// Address to listen on.
    pub listen: String,
    /// Folder for the results.
    pub out: PathBuf,
    /// Study and folder of recipes to replay with.
    pub replay: Option<(PathBuf, PathBuf)>,
    /// Longest time for the transmission.
    pub timeout_s: f64,
}

/// What arrived, what the log proves, and the replays.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Received {
    /// Process number of the doctor's side.
    pub process: u32,
    /// Address of the sender.
    pub peer: String,
    /// Unit of the samples.
    pub unit: String,
    /// Their rate.
    pub sample_rate_hz: f64,
    /// Samples announced.
    pub sent: u64,
    /// Samples handed on.
    pub received: u64,
    /// Samples never handed on.
    pub lost: u64,
    /// Samples handed on twice.
    pub duplicated: u64,
    /// Samples handed on out of order.
    pub out_of_order: u64,
    /// Hash as announced, as received and as computed from what was stored are one.
    pub bit_exact: bool,
    /// Frames that were sent again.
    pub retransmitted_frames: u64,
    /// Frames that arrived again and were dropped.
    pub duplicate_frames_dropped: u64,
    /// SHA-256 of the samples.
    pub sha256: String,
    /// One for each recipe.
    pub replays: Vec<Replayed>,
}

/// Receives one stream, writes `received.csv` and `session.jsonl`, checks the log against the stored samples, and replays.
///
/// Where no stream comes, nothing is written. Where one breaks off, its log stays as `session.failed.jsonl`, which ends
/// with the reason: what went wrong at a patient's side is evidence, but no session to replay.
///
/// # Errors
/// Where the socket cannot be opened, the stream fails, the log does not prove the samples, or a replay cannot run.
pub fn receive(order: &Order, announce: &mut dyn FnMut(SocketAddr)) -> Result<Received> {
    // What the replay needs is read before anybody is told to send.
    let replay = order
        .replay
        .as_ref()
        .map(|(study, recipes)| {
            let study = Study::load(study)?;
            let twin = device::twin(&study)?;
            let jobs = read_recipes(recipes)?;
            Ok::<(Study, TwinModel, Vec<Job>), anyhow::Error>((study, twin, jobs))
        })
        .transpose()?;
    ensure!(
        !order.out.exists() || order.out.is_dir(),
        "cannot write into {}: it is no folder",
        order.out.display()
    );
    let listener = Listener::bind(order.listen.as_str())
        .context("allowed is an address of this machine with a port, such as 127.0.0.1:0")?;
    announce(listener.local_addr()?);

    let mut log = SessionLog { folder: &order.out, file: None };
    let options = ReceiveOptions {
        total_timeout: Duration::from_secs_f64(order.timeout_s),
        ..ReceiveOptions::default()
    };
    let stream = match listener.receive(&options, &mut log, &mut |_| {}) {
        Ok(stream) => stream,
        Err(error) => {
            let kept = log.keep_as("session.failed.jsonl")?;
            return Err(match kept {
                Some(path) => anyhow::Error::new(error).context(format!("log kept in {}", path.display())),
                None => error.into(),
            });
        }
    };
    let log_path = log.keep_as("session.jsonl")?.context("the session has no log")?;

    let mut arrived = PulseRecording::new(
        Unit::from_symbol(stream.header.unit()),
        stream.header.sample_rate_hz(),
        stream.samples.clone(),
    )?;
    arrived.title = stream.header.title().to_owned();
    let stored_path = order.out.join("received.csv");
    recording::write(&stored_path, &arrived)?;
    // The proof is made from the file on disk, not from what this process still remembers.
    let stored = recording::read(&stored_path)?;
    let proof = verify_log_file(&log_path, stored.values())
        .with_context(|| format!("{} does not prove {}", log_path.display(), stored_path.display()))?;

    let replays = match &replay {
        Some((study, twin, jobs)) => replay_all(study, twin, jobs, &arrived)
            .with_context(|| format!("replaying {}", stored_path.display()))?,
        None => Vec::new(),
    };
    let summary = &stream.summary;
    let received = Received {
        process: std::process::id(),
        peer: stream.peer.to_string(),
        unit: stream.header.unit().to_owned(),
        sample_rate_hz: stream.header.sample_rate_hz(),
        sent: summary.sent,
        received: summary.received,
        lost: summary.lost,
        duplicated: summary.duplicated,
        out_of_order: summary.out_of_order,
        bit_exact: summary.bit_exact && proof.sha256 == stream.header.sha256(),
        retransmitted_frames: u64::from(proof.n_retransmitted),
        duplicate_frames_dropped: summary.packets.duplicate,
        sha256: proof.sha256.to_string(),
        replays,
    };
    if replay.is_some() {
        artefact::write_file(&order.out.join("replay.json"), &serde_json::to_vec(&received)?)?;
    }
    Ok(received)
}

/// The session log while it grows: on disk from its first line on, under a name of its own until the session has ended.
struct SessionLog<'a> {
    folder: &'a Path,
    file: Option<BufWriter<GrowingFile>>,
}

impl SessionLog<'_> {
    /// Gives the log a name in the folder; `None` where no line was written.
    fn keep_as(self, name: &str) -> Result<Option<PathBuf>> {
        let Some(file) = self.file else { return Ok(None) };
        let path = self.folder.join(name);
        let file = file
            .into_inner()
            .map_err(std::io::IntoInnerError::into_error)
            .with_context(|| format!("cannot write {}", path.display()))?;
        file.commit_as(&path)?;
        Ok(Some(path))
    }
}

impl Write for SessionLog<'_> {
    fn write(&mut self, content: &[u8]) -> std::io::Result<usize> {
        let file = match &mut self.file {
            Some(file) => file,
            None => {
                let file = GrowingFile::beside(&self.folder.join("session.jsonl"))
                    .map_err(|error| std::io::Error::other(format!("{error:#}")))?;
                self.file.insert(BufWriter::new(file))
            }
        };
        file.write(content)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.file.as_mut().map_or(Ok(()), Write::flush)
    }
}
