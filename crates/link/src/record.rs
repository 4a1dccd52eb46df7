//! The session log: JSON lines that prove, against the samples, that each arrived exactly once, in order, bit for bit.
//!
//! The first line is a [`LogHeader`], then one [`LogFrame`] for each data packet in the order in which it was handed on, then a
//! [`LogSummary`]; the key `kind` is `header`, `frame` or `summary`. Unknown keys are errors. [`verify_log`] trusts none of its statements:
//! it recomputes continuity, the checksum of each packet and the hash of the whole from the samples it is given.

use std::io::{BufRead, Write};
use std::path::Path;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::sender::nanoseconds;
use crate::stream::{SampleHasher, crc32_of};
use crate::{ClockEstimate, Delivered, Error, Hello, PacketCounts, Sha256Digest, WIRE_VERSION};

/// Version of the log format.
pub const LOG_VERSION: u32 = 1;

/// First line: what is expected, from whom.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LogHeader {
    /// Version of this format.
    pub log_version: u32,
    /// Version of the wire format.
    pub wire_version: u8,
    /// Program and version that wrote the log.
    pub program: String,
    /// Session number, 16 hexadecimal digits.
    pub session: String,
    /// Address of the sender.
    pub peer: String,
    /// Title of the recording.
    pub title: String,
    /// Unit of the samples.
    pub unit: String,
    /// Samples per second.
    pub sample_rate_hz: f64,
    /// Samples announced.
    pub n_samples: u64,
    /// Data packets announced.
    pub n_frames: u32,
    /// Samples in each packet but the last.
    pub samples_per_frame: usize,
    /// Hash announced.
    pub sha256_expected: Sha256Digest,
}

/// One line for each data packet that was handed on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LogFrame {
    /// Position in the stream of packets.
    pub sequence: u32,
    /// Index of the first sample.
    pub first_sample: u64,
    /// Number of samples.
    pub n_samples: usize,
    /// CRC-32 of the samples' big-endian bytes, 8 hexadecimal digits.
    pub crc32: String,
    /// Receiver's clock at arrival, in nanoseconds since it began to wait.
    pub arrival_ns: u64,
    /// Sender's clock at departure, in nanoseconds since it began.
    pub sent_ns: u64,
    /// True where the accepted copy was not the first one sent.
    pub retransmitted: bool,
    /// Further copies that were discarded before this packet's turn came.
    pub duplicates: u32,
}

/// Last line: what came of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LogSummary {
    /// Samples announced by the sender.
    pub sent: u64,
    /// Samples handed on.
    pub received: u64,
    /// Samples that were never handed on.
    pub lost: u64,
    /// Samples that were handed on more than once.
    pub duplicated: u64,
    /// Packets that were handed on before an earlier one.
    pub out_of_order: u64,
    /// Packets that came with a wrong checksum and were dropped.
    pub corrupted: u64,
    /// Hash announced.
    pub sha256_expected: Sha256Digest,
    /// Hash of the samples in the order in which they were handed on.
    pub sha256_received: Sha256Digest,
    /// Nothing lost, duplicated or out of order, and the hashes agree.
    pub bit_exact: bool,
    /// Time from the first to the last packet, in nanoseconds.
    pub duration_ns: u64,
    /// What happened on the wire, before duplicates were dropped and order was restored.
    pub packets: PacketCounts,
    /// The sender's clock against the receiver's, if there was time to ask.
    pub clock: Option<ClockEstimate>,
    /// Why the stream failed, if it did.
    pub failure: Option<String>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
enum LogLine {
    Header(LogHeader),
    Frame(LogFrame),
    Summary(LogSummary),
}

/// Writes a session log and judges, independently of the protocol, what is handed on.
#[derive(Debug)]
pub struct LogWriter<W: Write> {
    out: W,
    n_samples: u64,
    expected: Sha256Digest,
    hasher: SampleHasher,
    received: u64,
    /// Index after the highest sample handed on so far.
    end: u64,
    missed: u64,
    duplicated: u64,
    out_of_order: u64,
    first_arrival: Option<Duration>,
    last_arrival: Duration,
}

impl<W: Write> LogWriter<W> {
    /// Writes the header of a log.
    ///
    /// # Errors
    /// [`Error::Io`] when `out` refuses.
    pub fn new(mut out: W, session: u64, peer: &str, hello: &Hello) -> Result<Self, Error> {
        let header = hello.header();
        let line = LogHeader {
            log_version: LOG_VERSION,
            wire_version: WIRE_VERSION,
            program: concat!("telepulse-link ", env!("CARGO_PKG_VERSION")).to_owned(),
            session: format!("{session:016x}"),
            peer: peer.to_owned(),
            title: header.title().to_owned(),
            unit: header.unit().to_owned(),
            sample_rate_hz: header.sample_rate_hz(),
            n_samples: header.n_samples(),
            n_frames: hello.n_frames(),
            samples_per_frame: hello.samples_per_frame(),
            sha256_expected: header.sha256(),
        };
        write_line(&mut out, &LogLine::Header(line))?;
        Ok(Self {
            out,
            n_samples: header.n_samples(),
            expected: header.sha256(),
            hasher: SampleHasher::default(),
            received: 0,
            end: 0,
            missed: 0,
            duplicated: 0,
            out_of_order: 0,
            first_arrival: None,
            last_arrival: Duration::ZERO,
        })
    }

    /// Writes one packet, in the order in which it was handed on.
    ///
    /// # Errors
    /// [`Error::Io`] when the output refuses.
    pub fn frame(&mut self, delivered: &Delivered) -> Result<(), Error> {
        let n_samples = delivered.samples.len() as u64;
        let end = delivered.first_sample + n_samples;
        if delivered.first_sample > self.end {
            self.missed += delivered.first_sample - self.end;
        } else if delivered.first_sample < self.end {
            // Either a repetition or the late filling of a gap; both break "exactly once, in order".
            self.out_of_order += 1;
            self.duplicated += n_samples.min(self.end - delivered.first_sample);
        }
        self.end = self.end.max(end);
        self.received += n_samples;
        self.hasher.update(&delivered.samples);
        self.first_arrival.get_or_insert(delivered.arrival);
        self.last_arrival = self.last_arrival.max(delivered.arrival);
        let line = LogFrame {
            sequence: delivered.sequence,
            first_sample: delivered.first_sample,
            n_samples: delivered.samples.len(),
            crc32: format!("{:08x}", delivered.crc32),
            arrival_ns: nanoseconds(delivered.arrival),
            sent_ns: delivered.sent_ns,
            retransmitted: delivered.retransmitted,
            duplicates: delivered.duplicates,
        };
        write_line(&mut self.out, &LogLine::Frame(line))
    }

    /// Writes the summary and returns it.
    ///
    /// # Errors
    /// [`Error::Io`] when the output refuses.
    pub fn finish(
        mut self,
        packets: PacketCounts,
        clock: Option<ClockEstimate>,
        failure: Option<&Error>,
    ) -> Result<LogSummary, Error> {
        let sha256_received = self.hasher.finish();
        let lost = self.missed + self.n_samples.saturating_sub(self.end);
        let summary = LogSummary {
            sent: self.n_samples,
            received: self.received,
            lost,
            duplicated: self.duplicated,
            out_of_order: self.out_of_order,
            corrupted: packets.corrupted,
            sha256_expected: self.expected,
            sha256_received,
            bit_exact: lost == 0
                && self.duplicated == 0
                && self.out_of_order == 0
                && self.received == self.n_samples
                && sha256_received == self.expected,
            duration_ns: self.first_arrival.map_or(0, |first| nanoseconds(self.last_arrival - first)),
            packets,
            clock,
            failure: failure.map(ToString::to_string),
        };
        write_line(&mut self.out, &LogLine::Summary(summary.clone()))?;
        self.out.flush().map_err(|error| Error::io("write the session log", &error))?;
        Ok(summary)
    }
}

fn write_line(out: &mut impl Write, line: &LogLine) -> Result<(), Error> {
    let mut text = serde_json::to_string(line)
        .map_err(|error| Error::io("write the session log", &std::io::Error::other(error)))?;
    text.push('\n');
    out.write_all(text.as_bytes()).map_err(|error| Error::io("write the session log", &error))
}

/// What [`verify_log`] has established.
#[derive(Debug, Clone, PartialEq)]
pub struct Proof {
    /// The header of the log, in agreement with the samples.
    pub header: LogHeader,
    /// The summary of the log, in agreement with its lines and the samples.
    pub summary: LogSummary,
    /// Packets checked.
    pub n_frames: u32,
    /// Samples checked.
    pub n_samples: u64,
    /// Their hash, computed here.
    pub sha256: Sha256Digest,
    /// Packets that had to be sent again.
    pub n_retransmitted: u32,
}

/// Proves from a session log that `samples` arrived exactly once, in order, bit for bit.
///
/// **Method**: each packet's line must begin where the one before ended and carry the checksum of exactly those of `samples`; the last one
/// must end at the last sample; the hash of `samples` must be the announced and the received one; the summary must say the same.
///
/// # Errors
/// [`Error::LogSyntax`], [`Error::LogDisagrees`] or [`Error::LogTruncated`] with the line; [`Error::Io`] when the log cannot be read.
pub fn verify_log(log: impl BufRead, samples: &[f64]) -> Result<Proof, Error> {
    let mut check =
        Check { samples, sha256: Sha256Digest::of(samples), sequence: 0, end: 0, n_retransmitted: 0 };
    let (mut header, mut summary) = (None, None);
    let mut n_lines = 0;
    for text in log.lines() {
        n_lines += 1;
        let text = text.map_err(|error| Error::io("read the session log", &error))?;
        let syntax = |problem: String| Error::LogSyntax { line: n_lines, problem };
        let line = serde_json::from_str(&text).map_err(|error| syntax(error.to_string()))?;
        match (line, &header, &summary) {
            (_, _, Some(_)) => return Err(syntax("nothing may follow the summary".to_owned())),
            (LogLine::Header(line), None, None) => header = Some(check.header(line)?),
            (LogLine::Header(_), Some(_), None) => return Err(syntax("a second header".to_owned())),
            (_, None, None) => return Err(syntax("the first line must be the header".to_owned())),
            (LogLine::Frame(line), Some(header), None) => check.frame(n_lines, header, &line)?,
            (LogLine::Summary(line), Some(header), None) => {
                summary = Some(check.summary(n_lines, header, line)?);
            }
        }
    }
    let header = header.ok_or(Error::LogTruncated { lines: n_lines, missing: "header" })?;
    let summary = summary.ok_or(Error::LogTruncated { lines: n_lines, missing: "summary" })?;
    Ok(Proof {
        header,
        summary,
        n_frames: check.sequence,
        n_samples: check.end,
        sha256: check.sha256,
        n_retransmitted: check.n_retransmitted,
    })
}

/// [`verify_log`] on a file.
///
/// # Errors
/// As [`verify_log`].
pub fn verify_log_file(path: &Path, samples: &[f64]) -> Result<Proof, Error> {
    let file = std::fs::File::open(path).map_err(|error| Error::io("open the session log", &error))?;
    verify_log(std::io::BufReader::new(file), samples)
}

struct Check<'a> {
    samples: &'a [f64],
    sha256: Sha256Digest,
    sequence: u32,
    end: u64,
    n_retransmitted: u32,
}

impl Check<'_> {
    fn header(&self, line: LogHeader) -> Result<LogHeader, Error> {
        demand(1, "log_version", LOG_VERSION, line.log_version)?;
        demand(1, "wire_version", WIRE_VERSION, line.wire_version)?;
        demand(1, "n_samples", self.samples.len() as u64, line.n_samples)?;
        demand(1, "sha256_expected", self.sha256, line.sha256_expected)?;
        Ok(line)
    }

    fn frame(&mut self, at: usize, header: &LogHeader, line: &LogFrame) -> Result<(), Error> {
        demand(at, "sequence", self.sequence, line.sequence)?;
        demand(at, "first_sample", self.end, line.first_sample)?;
        let n_left = self.samples.len() as u64 - self.end;
        let n_expected = n_left.min(header.samples_per_frame as u64);
        demand(at, "n_samples", n_expected, line.n_samples as u64)?;
        if n_expected == 0 {
            return Err(Error::LogSyntax { line: at, problem: "a frame after the last sample".to_owned() });
        }
        let first_idx = self.end as usize;
        let crc32 = crc32_of(&self.samples[first_idx..first_idx + n_expected as usize]);
        demand(at, "crc32", format!("{crc32:08x}"), line.crc32.clone())?;
        self.sequence += 1;
        self.end += n_expected;
        self.n_retransmitted += u32::from(line.retransmitted);
        Ok(())
    }

    fn summary(&self, at: usize, header: &LogHeader, line: LogSummary) -> Result<LogSummary, Error> {
        let n_samples = self.samples.len() as u64;
        demand(at, "samples in all frames", n_samples, self.end)?;
        demand(at, "number of frames", header.n_frames, self.sequence)?;
        demand(at, "sent", n_samples, line.sent)?;
        demand(at, "received", n_samples, line.received)?;
        demand(at, "lost", 0, line.lost)?;
        demand(at, "duplicated", 0, line.duplicated)?;
        demand(at, "out_of_order", 0, line.out_of_order)?;
        demand(at, "corrupted", line.packets.corrupted, line.corrupted)?;
        demand(at, "sha256_expected", self.sha256, line.sha256_expected)?;
        demand(at, "sha256_received", self.sha256, line.sha256_received)?;
        demand(at, "bit_exact", true, line.bit_exact)?;
        demand(at, "failure", "none", line.failure.as_deref().unwrap_or("none"))?;
        Ok(line)
    }
}

fn demand<T: PartialEq + ToString>(
    line: usize,
    item: &'static str,
    expected: T,
    found: T,
) -> Result<(), Error> {
    if expected == found {
        return Ok(());
    }
    Err(Error::LogDisagrees { line, item, expected: expected.to_string(), found: found.to_string() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::StreamHeader;

    fn samples() -> Vec<f64> {
        (0..10).map(|idx| f64::from(idx) * 0.1).collect()
    }

    fn delivered(sequence: u32, samples: &[f64]) -> Delivered {
        let first_idx = sequence as usize * 4;
        let samples = samples[first_idx..(first_idx + 4).min(samples.len())].to_vec();
        Delivered {
            sequence,
            first_sample: u64::from(sequence) * 4,
            crc32: crc32_of(&samples),
            samples,
            arrival: Duration::from_millis(u64::from(sequence)),
            sent_ns: 5,
            retransmitted: sequence == 1,
            duplicates: 0,
        }
    }

    fn log_of(sequences: &[u32]) -> (String, LogSummary) {
        let samples = samples();
        let header = StreamHeader::describe(&samples, "mm", "line", 125.0).expect("valid header");
        let hello = Hello::new(header, 4).expect("valid hello");
        let mut out = Vec::new();
        let mut writer = LogWriter::new(&mut out, 0xabc, "127.0.0.1:9", &hello).expect("memory accepts all");
        for sequence in sequences {
            writer.frame(&delivered(*sequence, &samples)).expect("memory accepts all");
        }
        let summary = writer.finish(PacketCounts::default(), None, None).expect("memory accepts all");
        (String::from_utf8(out).expect("JSON is UTF-8"), summary)
    }

    #[test]
    fn law_a_true_log_is_a_proof() {
        let (log, summary) = log_of(&[0, 1, 2]);
        assert!(summary.bit_exact);
        let proof = verify_log(log.as_bytes(), &samples()).expect("true log");
        assert_eq!((proof.n_frames, proof.n_samples, proof.n_retransmitted), (3, 10, 1));
        assert_eq!(proof.summary, summary);
        assert_eq!(proof.header.session, "0000000000000abc");
    }

    #[test]
    fn edge_wrong_deliveries_are_counted_and_refused() {
        for (sequences, lost, duplicated, out_of_order) in
            [(&[0, 2][..], 4, 0, 0), (&[0, 1, 1, 2], 0, 4, 1), (&[0, 1], 2, 0, 0), (&[], 10, 0, 0)]
        {
            let (log, summary) = log_of(sequences);
            assert_eq!(
                (summary.lost, summary.duplicated, summary.out_of_order),
                (lost, duplicated, out_of_order)
            );
            assert!(!summary.bit_exact, "{sequences:?}");
            assert!(verify_log(log.as_bytes(), &samples()).is_err(), "{sequences:?}");
        }
        let (log, summary) = log_of(&[1, 0, 2]);
        assert!(summary.out_of_order == 1 && !summary.bit_exact);
        assert!(matches!(
            verify_log(log.as_bytes(), &samples()),
            Err(Error::LogDisagrees { line: 2, item: "sequence", .. })
        ));
    }

    #[test]
    fn edge_one_changed_bit_in_any_sample_is_found() {
        let (log, _) = log_of(&[0, 1, 2]);
        for idx in 0..10 {
            let mut other = samples();
            other[idx] = f64::from_bits(other[idx].to_bits() ^ 1);
            assert!(verify_log(log.as_bytes(), &other).is_err(), "sample {idx}");
        }
    }

    #[test]
    fn edge_edited_logs_are_refused() {
        let (log, _) = log_of(&[0, 1, 2]);
        let lines: Vec<&str> = log.lines().collect();
        let joined = |keep: &[usize]| keep.iter().map(|idx| format!("{}\n", lines[*idx])).collect::<String>();
        for keep in
            [&[0, 1, 2, 3][..], &[1, 2, 3, 4], &[0, 1, 3, 4], &[0, 1, 2, 3, 4, 4], &[0, 0, 1, 2, 3, 4], &[]]
        {
            assert!(verify_log(joined(keep).as_bytes(), &samples()).is_err(), "{keep:?}");
        }
        for (from, to) in [
            ("\"first_sample\":4", "\"first_sample\":5"),
            ("\"crc32\":\"", "\"crc32\":\"0"),
            ("\"bit_exact\":true", "\"bit_exact\":false"),
            ("\"lost\":0", "\"lost\":1"),
            ("\"kind\":\"frame\"", "\"kind\":\"frame\",\"unknown\":1"),
            ("\"failure\":null", "\"failure\":\"no\""),
        ] {
            let edited = log.replacen(from, to, 1);
            assert_ne!(edited, log, "{from}");
            assert!(verify_log(edited.as_bytes(), &samples()).is_err(), "{to}");
        }
    }
}
