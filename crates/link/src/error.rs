//! Why a transmission or the check of its log failed.

use std::time::Duration;

use crate::{PacketFault, RejectReason, Sha256Digest};

/// What a peer was expected to say when it fell silent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SilentPhase {
    /// An answer to the stream header.
    Opening,
    /// Acknowledgements or samples.
    Streaming,
    /// The confirmation that the stream is complete.
    Closing,
}

impl std::fmt::Display for SilentPhase {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Opening => "opening the stream",
            Self::Streaming => "streaming",
            Self::Closing => "closing the stream",
        })
    }
}

/// The error of this crate.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// A stream header or setting is not usable.
    #[error("{field} must be {allowed}, found {found}")]
    Setting {
        /// The field, with its unit.
        field: &'static str,
        /// What is allowed.
        allowed: &'static str,
        /// What was found.
        found: String,
    },
    /// A packet could not be read.
    #[error(transparent)]
    Packet(#[from] PacketFault),
    /// Nothing valid came from the peer for the stated time.
    #[error("peer was silent for {after:?} while {phase}")]
    PeerSilent {
        /// Time without a valid packet.
        after: Duration,
        /// What was going on.
        phase: SilentPhase,
    },
    /// One packet was repeated as often as allowed and never acknowledged.
    #[error("{what} was sent {tries} times without an acknowledgement")]
    Unacknowledged {
        /// `header`, `data` or `end`.
        what: &'static str,
        /// Its sequence number, where it has one.
        sequence: Option<u32>,
        /// Transmissions made.
        tries: u32,
    },
    /// The peer refused the stream.
    #[error("peer refused the stream: {0}")]
    Rejected(RejectReason),
    /// The peer speaks another version of the wire format.
    #[error("peer speaks wire format {found}, this program speaks {supported}")]
    WireVersion {
        /// The peer's version.
        found: u8,
        /// This program's version.
        supported: u8,
    },
    /// Everything arrived, but it is not what the header announced.
    #[error("samples have SHA-256 {received}, the header announced {expected}")]
    HashMismatch {
        /// From the header.
        expected: Sha256Digest,
        /// Of the samples.
        received: Sha256Digest,
    },
    /// The whole transmission took longer than allowed.
    #[error("transmission did not finish within {allowed:?} ({samples} of {n_samples} samples)")]
    Timeout {
        /// The time allowed.
        allowed: Duration,
        /// Samples that had arrived or were acknowledged.
        samples: u64,
        /// Samples of the stream.
        n_samples: u64,
    },
    /// No stream began in the time allowed.
    #[error(
        "no stream arrived within {allowed:?} (unusable packets: {corrupted} corrupted, {wrong_version} of another version, {foreign} foreign)"
    )]
    NoStream {
        /// The time allowed.
        allowed: Duration,
        /// Packets with a wrong checksum.
        corrupted: u64,
        /// Packets of another wire version.
        wrong_version: u64,
        /// Packets that belong to something else.
        foreign: u64,
    },
    /// The operating system refused a socket or file operation.
    #[error("could not {action}: {message}")]
    Io {
        /// What was attempted.
        action: &'static str,
        /// Kind of failure.
        kind: std::io::ErrorKind,
        /// The system's words.
        message: String,
    },
    /// A line of a session log is not what the format allows.
    #[error("session log line {line}: {problem}")]
    LogSyntax {
        /// Line, from 1.
        line: usize,
        /// What is wrong with it.
        problem: String,
    },
    /// A session log contradicts itself or the samples.
    #[error("session log line {line}: {item} should be {expected}, found {found}")]
    LogDisagrees {
        /// Line, from 1.
        line: usize,
        /// The quantity.
        item: &'static str,
        /// What continuity, samples or header demand.
        expected: String,
        /// What the log says.
        found: String,
    },
    /// A session log ends before its summary.
    #[error("session log ends after line {lines} without a {missing}")]
    LogTruncated {
        /// Lines found.
        lines: usize,
        /// `header` or `summary`.
        missing: &'static str,
    },
    /// The play-out buffer has no room for samples that far ahead.
    #[error("play-out buffer of {capacity} samples cannot hold sample {sample}")]
    PlayoutFull {
        /// Capacity in samples.
        capacity: usize,
        /// Index of the sample that did not fit.
        sample: u64,
    },
}

impl Error {
    pub(crate) fn io(action: &'static str, error: &std::io::Error) -> Self {
        Self::Io { action, kind: error.kind(), message: error.to_string() }
    }

    pub(crate) fn setting(field: &'static str, allowed: &'static str, found: impl ToString) -> Self {
        Self::Setting { field, allowed, found: found.to_string() }
    }
}
