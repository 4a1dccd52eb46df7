//! What is sent: a description of the samples, and counts of what happened to the packets.

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::{Error, PacketFault};

/// Longest unit, in bytes of UTF-8.
pub(crate) const MAX_UNIT_BYTES: usize = 32;
/// Longest title, in bytes of UTF-8.
pub(crate) const MAX_TITLE_BYTES: usize = 256;

/// A SHA-256 over samples, each as the 8 bytes of its IEEE 754 bit pattern, big-endian. Displayed and stored as 64 hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct Sha256Digest(pub [u8; 32]);

impl Sha256Digest {
    /// The digest of `samples`.
    #[must_use]
    pub fn of(samples: &[f64]) -> Self {
        let mut hasher = SampleHasher::default();
        hasher.update(samples);
        hasher.finish()
    }
}

impl std::fmt::Display for Sha256Digest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl std::fmt::Debug for Sha256Digest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Sha256Digest({self})")
    }
}

impl From<Sha256Digest> for String {
    fn from(digest: Sha256Digest) -> Self {
        digest.to_string()
    }
}

impl TryFrom<String> for Sha256Digest {
    type Error = Error;

    fn try_from(text: String) -> Result<Self, Error> {
        let refuse = || Error::setting("SHA-256", "64 hexadecimal digits", &text);
        if text.len() != 64 || !text.bytes().all(|b| b.is_ascii_hexdigit()) {
            return Err(refuse());
        }
        let mut bytes = [0; 32];
        for (idx, byte) in bytes.iter_mut().enumerate() {
            *byte = u8::from_str_radix(&text[2 * idx..2 * idx + 2], 16).map_err(|_| refuse())?;
        }
        Ok(Self(bytes))
    }
}

/// Hashes samples as they come, in pieces of any size.
#[derive(Debug, Clone, Default)]
pub(crate) struct SampleHasher(Sha256);

impl SampleHasher {
    pub(crate) fn update(&mut self, samples: &[f64]) {
        for sample in samples {
            self.0.update(sample.to_bits().to_be_bytes());
        }
    }

    pub(crate) fn finish(&self) -> Sha256Digest {
        let mut bytes = [0; 32];
        bytes.copy_from_slice(&self.0.clone().finalize());
        Sha256Digest(bytes)
    }
}

/// The CRC-32 (IEEE) of samples in the byte order of [`Sha256Digest`].
pub(crate) fn crc32_of(samples: &[f64]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    for sample in samples {
        hasher.update(&sample.to_bits().to_be_bytes());
    }
    hasher.finalize()
}

/// What a stream of samples is.
///
/// **Example**
/// ```
/// let header = telepulse_link::StreamHeader::describe(&[0.0, 0.5, 1.0], "mm", "finger test", 125.0)?;
/// assert_eq!(header.n_samples(), 3);
/// # Ok::<(), telepulse_link::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct StreamHeader {
    unit: String,
    title: String,
    sample_rate_hz: f64,
    n_samples: u64,
    sha256: Sha256Digest,
}

impl StreamHeader {
    /// The header of `samples`, with their hash.
    ///
    /// # Errors
    /// [`Error::Setting`] for no samples, a unit of more than 32 bytes or none, a title of more than 256 bytes, control characters in
    /// either, or a rate that is not finite and positive. The samples themselves may be any bit pattern.
    pub fn describe(samples: &[f64], unit: &str, title: &str, sample_rate_hz: f64) -> Result<Self, Error> {
        Self::new(unit, title, sample_rate_hz, samples.len() as u64, Sha256Digest::of(samples))
    }

    /// A header from its parts, as it comes from the wire.
    ///
    /// # Errors
    /// As [`describe`](Self::describe).
    pub fn new(
        unit: &str,
        title: &str,
        sample_rate_hz: f64,
        n_samples: u64,
        sha256: Sha256Digest,
    ) -> Result<Self, Error> {
        if unit.is_empty() || unit.len() > MAX_UNIT_BYTES || unit.chars().any(char::is_control) {
            return Err(Error::setting(
                "unit",
                "1 to 32 bytes without control characters",
                format!("{unit:?}"),
            ));
        }
        if title.len() > MAX_TITLE_BYTES || title.chars().any(char::is_control) {
            return Err(Error::setting(
                "title",
                "at most 256 bytes without control characters",
                format!("{title:?}"),
            ));
        }
        if !(sample_rate_hz.is_finite() && sample_rate_hz > 0.0) {
            return Err(Error::setting("sample rate in Hz", "finite and greater than zero", sample_rate_hz));
        }
        if n_samples == 0 {
            return Err(Error::setting("number of samples", "at least 1", n_samples));
        }
        Ok(Self { unit: unit.to_owned(), title: title.to_owned(), sample_rate_hz, n_samples, sha256 })
    }

    /// The unit of the samples.
    #[must_use]
    pub fn unit(&self) -> &str {
        &self.unit
    }

    /// The title of the recording; may be empty.
    #[must_use]
    pub fn title(&self) -> &str {
        &self.title
    }

    /// Samples per second.
    #[must_use]
    pub fn sample_rate_hz(&self) -> f64 {
        self.sample_rate_hz
    }

    /// The number of samples in the stream.
    #[must_use]
    pub fn n_samples(&self) -> u64 {
        self.n_samples
    }

    /// The hash of all samples.
    #[must_use]
    pub fn sha256(&self) -> Sha256Digest {
        self.sha256
    }
}

/// What happened to the packets that came in at one end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PacketCounts {
    /// All packets, usable or not.
    pub received: u64,
    /// Too short to be a packet.
    pub truncated: u64,
    /// Not of this protocol.
    pub foreign: u64,
    /// Of this protocol, but of another session or from another address.
    pub foreign_session: u64,
    /// Wrong checksum.
    pub corrupted: u64,
    /// Another version of the wire format.
    pub wrong_version: u64,
    /// Right checksum, but a content that the protocol does not allow.
    pub malformed: u64,
    /// Data packets whose samples were there already; discarded.
    pub duplicate: u64,
    /// Data packets that arrived after a later one; put back into order.
    pub reordered: u64,
}

impl PacketCounts {
    pub(crate) fn count(&mut self, fault: PacketFault) {
        match fault {
            PacketFault::Truncated { .. } => self.truncated += 1,
            PacketFault::Foreign => self.foreign += 1,
            PacketFault::Corrupted => self.corrupted += 1,
            PacketFault::WrongVersion { .. } => self.wrong_version += 1,
            PacketFault::Malformed { .. } => self.malformed += 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn oracle_sha256_of_known_bytes() {
        // printf '\x3f\xf0\0\0\0\0\0\0' | sha256sum (GNU coreutils 9.1): the bytes of 1.0, big-endian.
        let expected = "54ade53a579f5389ecae3af42df9e96aa30fcf3fc02a7475afc18c3e4835f6f7";
        assert_eq!(Sha256Digest::of(&[1.0]).to_string(), expected);
        // The same bytes through zlib.crc32 of Python 3.11.
        assert_eq!(crc32_of(&[1.0]), 0x5db1_a461);
        let empty = Sha256Digest::of(&[]).to_string();
        // FIPS 180-4: SHA-256 of the empty message.
        assert_eq!(empty, "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
    }

    #[test]
    fn law_digest_text_round_trip() {
        let digest = Sha256Digest::of(&[1.0, f64::NAN]);
        assert_eq!(Sha256Digest::try_from(digest.to_string()), Ok(digest));
        for bad in ["", "zz", &"g".repeat(64), &"é".repeat(32)] {
            assert!(Sha256Digest::try_from(bad.to_owned()).is_err());
        }
    }

    #[test]
    fn edge_bad_headers_are_refused() {
        let samples = [1.0];
        assert!(StreamHeader::describe(&[], "mm", "", 1.0).is_err());
        assert!(StreamHeader::describe(&samples, "", "", 1.0).is_err());
        assert!(StreamHeader::describe(&samples, "m\nm", "", 1.0).is_err());
        assert!(StreamHeader::describe(&samples, "mm", &"t".repeat(257), 1.0).is_err());
        for rate in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(StreamHeader::describe(&samples, "mm", "", rate).is_err());
        }
    }
}
