//! What can be said between the two ends: the packets as types whose constructors bound everything that goes on the wire.

use crate::Error;
use crate::stream::StreamHeader;

/// Version of the wire format.
pub const WIRE_VERSION: u8 = 1;
/// Longest packet: fits every path of the internet without fragments, with room for a tunnel.
pub const MAX_PACKET_BYTES: usize = 1200;
/// Most samples in one data packet.
pub const MAX_SAMPLES_PER_FRAME: usize = 128;
/// Most data packets under way, and most that a receiver keeps while one is missing: the bits of an [`Ack`].
pub const MAX_WINDOW: usize = 64;

/// Why bytes are not a packet that this program can use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum PacketFault {
    /// Shorter than the shortest packet.
    #[error("packet of {n_bytes} bytes is too short")]
    Truncated {
        /// Bytes found.
        n_bytes: usize,
    },
    /// It does not begin with the magic bytes.
    #[error("packet does not belong to this protocol")]
    Foreign,
    /// The checksum is wrong.
    #[error("packet has a wrong checksum")]
    Corrupted,
    /// Another version of the wire format.
    #[error("packet has wire format {found}, supported is {WIRE_VERSION}")]
    WrongVersion {
        /// Version found.
        found: u8,
    },
    /// The checksum is right, the content is not allowed.
    #[error("packet has an invalid {field}")]
    Malformed {
        /// The first field that is not allowed.
        field: &'static str,
    },
}

/// One datagram.
#[derive(Debug, Clone, PartialEq)]
pub struct Packet {
    /// Number that the sender drew for this stream.
    pub session: u64,
    /// What it says.
    pub body: Body,
}

/// What a packet says.
#[derive(Debug, Clone, PartialEq)]
pub enum Body {
    /// Sender to receiver: what will come.
    Hello(Hello),
    /// Sender to receiver: samples.
    Data(Data),
    /// Receiver to sender: what is there.
    Ack(Ack),
    /// Sender to receiver: everything has been acknowledged.
    End {
        /// Number of data packets of the stream.
        n_frames: u32,
    },
    /// Receiver to sender: the verdict; sender to receiver: the verdict is known, no need to repeat it.
    EndAck(EndStatus),
    /// Receiver to sender: a question for the clock, at the receiver's `t1_ns`.
    Ping {
        /// Receiver's clock when it left.
        t1_ns: u64,
    },
    /// Sender to receiver: the answer.
    Pong {
        /// Copied from the Ping.
        t1_ns: u64,
        /// Sender's clock when the Ping arrived.
        t2_ns: u64,
        /// Sender's clock when the Pong left.
        t3_ns: u64,
    },
    /// Receiver to sender: no.
    Reject(RejectReason),
}

/// The description of a stream and how it is cut.
#[derive(Debug, Clone, PartialEq)]
pub struct Hello {
    header: StreamHeader,
    samples_per_frame: u16,
    n_frames: u32,
}

impl Hello {
    /// A header and the samples in each data packet but the last.
    ///
    /// # Errors
    /// [`Error::Setting`] unless `samples_per_frame` is 1 to [`MAX_SAMPLES_PER_FRAME`] and there are fewer than 2^32 packets.
    pub fn new(header: StreamHeader, samples_per_frame: usize) -> Result<Self, Error> {
        if !(1..=MAX_SAMPLES_PER_FRAME).contains(&samples_per_frame) {
            return Err(Error::setting("samples per frame", "1 to 128", samples_per_frame));
        }
        let n_frames = header.n_samples().div_ceil(samples_per_frame as u64);
        match u32::try_from(n_frames) {
            // A margin of one window keeps sequence arithmetic from overflowing.
            Ok(n_frames) if n_frames <= u32::MAX - MAX_WINDOW as u32 => {
                Ok(Self { header, samples_per_frame: samples_per_frame as u16, n_frames })
            }
            _ => Err(Error::setting("number of frames", "less than 2^32 - 64", n_frames)),
        }
    }

    /// The description of the samples.
    #[must_use]
    pub fn header(&self) -> &StreamHeader {
        &self.header
    }

    /// Samples in each data packet but the last.
    #[must_use]
    pub fn samples_per_frame(&self) -> usize {
        usize::from(self.samples_per_frame)
    }

    /// Number of data packets.
    #[must_use]
    pub fn n_frames(&self) -> u32 {
        self.n_frames
    }

    /// Index of the first sample of data packet `sequence`.
    #[must_use]
    pub fn first_sample(&self, sequence: u32) -> u64 {
        u64::from(sequence) * u64::from(self.samples_per_frame)
    }

    /// Number of samples in data packet `sequence`.
    #[must_use]
    pub fn n_samples(&self, sequence: u32) -> usize {
        let left = self.header.n_samples().saturating_sub(self.first_sample(sequence));
        left.min(u64::from(self.samples_per_frame)) as usize
    }
}

/// Consecutive samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Data {
    sequence: u32,
    first_sample: u64,
    sent_ns: u64,
    sent_before: bool,
    samples: Vec<f64>,
}

impl Data {
    /// Data packet `sequence`, holding `samples` from index `first_sample` on, sent at `sent_ns` of the sender's clock.
    ///
    /// # Errors
    /// [`Error::Setting`] unless there are 1 to [`MAX_SAMPLES_PER_FRAME`] samples.
    pub fn new(
        sequence: u32,
        first_sample: u64,
        sent_ns: u64,
        sent_before: bool,
        samples: Vec<f64>,
    ) -> Result<Self, Error> {
        if !(1..=MAX_SAMPLES_PER_FRAME).contains(&samples.len()) {
            return Err(Error::setting("samples in a data packet", "1 to 128", samples.len()));
        }
        Ok(Self { sequence, first_sample, sent_ns, sent_before, samples })
    }

    /// Position in the stream of packets, from 0.
    #[must_use]
    pub fn sequence(&self) -> u32 {
        self.sequence
    }

    /// Index of its first sample in the stream.
    #[must_use]
    pub fn first_sample(&self) -> u64 {
        self.first_sample
    }

    /// Sender's clock when it left, in nanoseconds.
    #[must_use]
    pub fn sent_ns(&self) -> u64 {
        self.sent_ns
    }

    /// True in every transmission but the first.
    #[must_use]
    pub fn sent_before(&self) -> bool {
        self.sent_before
    }

    /// The samples.
    #[must_use]
    pub fn samples(&self) -> &[f64] {
        &self.samples
    }

    pub(crate) fn into_samples(self) -> Vec<f64> {
        self.samples
    }
}

/// What a receiver has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ack {
    /// All data packets before this one are there and have been handed on.
    pub next_expected: u32,
    /// Bit `i` is set where `next_expected + i` is there.
    pub bitmap: u64,
}

/// The receiver's verdict on a complete stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EndStatus {
    /// The samples have the announced hash.
    Complete,
    /// They do not.
    HashMismatch,
}

/// Why a receiver refused a stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum RejectReason {
    /// It does not speak that version.
    #[error("wire format version not supported")]
    Version,
    /// It is receiving another stream.
    #[error("receiver is busy with another stream")]
    Busy,
    /// The header is not acceptable, for example too many samples.
    #[error("stream header not acceptable")]
    Header,
}
