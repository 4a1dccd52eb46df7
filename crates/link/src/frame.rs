//! The wire format: one packet is one datagram of at most 1200 bytes. All numbers are big-endian; an `f64` travels as its bit pattern.
//!
//! | offset | bytes | field |
//! |---|---|---|
//! | 0 | 4 | magic `TPLS` |
//! | 4 | 1 | version, here 1 |
//! | 5 | 1 | kind: 1 Hello, 2 Data, 3 Ack, 4 End, 5 EndAck, 6 Ping, 7 Pong, 8 Reject |
//! | 6 | 2 | flags: bit 0 of Data = sent before; all others 0 |
//! | 8 | 8 | session |
//! | 16 | 4 | sequence of Data; else 0 |
//! | 20 | 2 | payload length n |
//! | 22 | n | payload |
//! | 22 + n | 4 | CRC-32 (IEEE) of all bytes before |
//!
//! Magic, version and the CRC at the end stay where they are in every version, so a packet of another version is told from a damaged one.
//!
//! | kind | payload |
//! |---|---|
//! | Hello | sample rate `f64`, samples `u64`, SHA-256 32 bytes, samples per frame `u16`, unit and title each as length `u16` + UTF-8 |
//! | Data | first sample `u64`, sender's clock in ns `u64`, samples `f64` |
//! | Ack | next expected sequence `u32`, bitmap `u64`: bit i = sequence next + i is there |
//! | End | number of frames `u32` |
//! | EndAck | status `u8`: 0 complete, 1 hash mismatch |
//! | Ping | t1 `u64` |
//! | Pong | t1, t2, t3 `u64` |
//! | Reject | reason `u8`: 1 version, 2 busy, 3 header not acceptable |

use crate::{
    Ack, Body, Data, EndStatus, Hello, MAX_PACKET_BYTES, Packet, PacketFault, RejectReason, Sha256Digest,
    StreamHeader, WIRE_VERSION,
};

const MAGIC: [u8; 4] = *b"TPLS";
const HEADER_BYTES: usize = 22;
const CRC_BYTES: usize = 4;
const FLAG_SENT_BEFORE: u16 = 1;

impl Packet {
    /// The bytes of the packet; never more than [`MAX_PACKET_BYTES`].
    #[must_use]
    pub fn encode(&self) -> Vec<u8> {
        let (kind, flags, sequence) = match &self.body {
            Body::Hello(_) => (1, 0, 0),
            Body::Data(data) => (2, if data.sent_before() { FLAG_SENT_BEFORE } else { 0 }, data.sequence()),
            Body::Ack(_) => (3, 0, 0),
            Body::End { .. } => (4, 0, 0),
            Body::EndAck(_) => (5, 0, 0),
            Body::Ping { .. } => (6, 0, 0),
            Body::Pong { .. } => (7, 0, 0),
            Body::Reject(_) => (8, 0, 0),
        };
        let mut out = Vec::with_capacity(MAX_PACKET_BYTES);
        out.extend_from_slice(&MAGIC);
        out.extend_from_slice(&[WIRE_VERSION, kind]);
        out.extend_from_slice(&u16::to_be_bytes(flags));
        out.extend_from_slice(&self.session.to_be_bytes());
        out.extend_from_slice(&sequence.to_be_bytes());
        out.extend_from_slice(&[0, 0]);
        encode_payload(&self.body, &mut out);
        let n_payload = (out.len() - HEADER_BYTES) as u16;
        out[HEADER_BYTES - 2..HEADER_BYTES].copy_from_slice(&n_payload.to_be_bytes());
        let crc = crc32fast::hash(&out);
        out.extend_from_slice(&crc.to_be_bytes());
        assert!(out.len() <= MAX_PACKET_BYTES, "the constructors bound every payload");
        out
    }

    /// Reads a packet from a datagram.
    ///
    /// **Method**: length, magic, checksum, version, then each field; nothing may be left over and no unused bit may be set, so that every
    /// accepted packet encodes to the same bytes again.
    ///
    /// # Errors
    /// A [`PacketFault`]; it never panics, whatever the bytes.
    pub fn decode(bytes: &[u8]) -> Result<Self, PacketFault> {
        let malformed = |field| PacketFault::Malformed { field };
        if bytes.len() < HEADER_BYTES + CRC_BYTES {
            return Err(PacketFault::Truncated { n_bytes: bytes.len() });
        }
        if bytes[..4] != MAGIC {
            return Err(PacketFault::Foreign);
        }
        let (content, crc) = bytes.split_at(bytes.len() - CRC_BYTES);
        if crc32fast::hash(content).to_be_bytes() != crc {
            return Err(PacketFault::Corrupted);
        }
        if bytes[4] != WIRE_VERSION {
            return Err(PacketFault::WrongVersion { found: bytes[4] });
        }
        if bytes.len() > MAX_PACKET_BYTES {
            return Err(malformed("packet length"));
        }
        let kind = bytes[5];
        let mut fields = Fields(&content[6..]);
        let flags = fields.u16("flags")?;
        let session = fields.u64("session")?;
        let sequence = fields.u32("sequence")?;
        if usize::from(fields.u16("payload length")?) != fields.0.len() {
            return Err(malformed("payload length"));
        }
        if kind != 2 && flags != 0 || flags & !FLAG_SENT_BEFORE != 0 {
            return Err(malformed("flags"));
        }
        if kind != 2 && sequence != 0 {
            return Err(malformed("sequence"));
        }
        let body = match kind {
            1 => Body::Hello(decode_hello(&mut fields)?),
            2 => Body::Data(decode_data(&mut fields, sequence, flags & FLAG_SENT_BEFORE != 0)?),
            3 => Body::Ack(Ack { next_expected: fields.u32("ack")?, bitmap: fields.u64("ack bitmap")? }),
            4 => Body::End { n_frames: fields.u32("number of frames")? },
            5 => Body::EndAck(match fields.u8("status")? {
                0 => EndStatus::Complete,
                1 => EndStatus::HashMismatch,
                _ => return Err(malformed("status")),
            }),
            6 => Body::Ping { t1_ns: fields.u64("t1")? },
            7 => Body::Pong { t1_ns: fields.u64("t1")?, t2_ns: fields.u64("t2")?, t3_ns: fields.u64("t3")? },
            8 => Body::Reject(match fields.u8("reject reason")? {
                1 => RejectReason::Version,
                2 => RejectReason::Busy,
                3 => RejectReason::Header,
                _ => return Err(malformed("reject reason")),
            }),
            _ => return Err(malformed("kind")),
        };
        if !fields.0.is_empty() {
            return Err(malformed("payload length"));
        }
        Ok(Self { session, body })
    }
}

fn encode_payload(body: &Body, out: &mut Vec<u8>) {
    match body {
        Body::Hello(hello) => {
            let header = hello.header();
            out.extend_from_slice(&header.sample_rate_hz().to_bits().to_be_bytes());
            out.extend_from_slice(&header.n_samples().to_be_bytes());
            out.extend_from_slice(&header.sha256().0);
            out.extend_from_slice(&(hello.samples_per_frame() as u16).to_be_bytes());
            for text in [header.unit(), header.title()] {
                out.extend_from_slice(&(text.len() as u16).to_be_bytes());
                out.extend_from_slice(text.as_bytes());
            }
        }
        Body::Data(data) => {
            out.extend_from_slice(&data.first_sample().to_be_bytes());
            out.extend_from_slice(&data.sent_ns().to_be_bytes());
            for sample in data.samples() {
                out.extend_from_slice(&sample.to_bits().to_be_bytes());
            }
        }
        Body::Ack(ack) => {
            out.extend_from_slice(&ack.next_expected.to_be_bytes());
            out.extend_from_slice(&ack.bitmap.to_be_bytes());
        }
        Body::End { n_frames } => out.extend_from_slice(&n_frames.to_be_bytes()),
        Body::EndAck(EndStatus::Complete) => out.push(0),
        Body::EndAck(EndStatus::HashMismatch) => out.push(1),
        Body::Ping { t1_ns } => out.extend_from_slice(&t1_ns.to_be_bytes()),
        Body::Pong { t1_ns, t2_ns, t3_ns } => {
            for time_ns in [t1_ns, t2_ns, t3_ns] {
                out.extend_from_slice(&time_ns.to_be_bytes());
            }
        }
        Body::Reject(reason) => out.push(match reason {
            RejectReason::Version => 1,
            RejectReason::Busy => 2,
            RejectReason::Header => 3,
        }),
    }
}

fn decode_hello(fields: &mut Fields<'_>) -> Result<Hello, PacketFault> {
    let sample_rate_hz = f64::from_bits(fields.u64("sample rate")?);
    let n_samples = fields.u64("number of samples")?;
    let sha256 = Sha256Digest(fields.array("SHA-256")?);
    let samples_per_frame = fields.u16("samples per frame")?;
    let unit = fields.text("unit")?;
    let title = fields.text("title")?;
    let header = StreamHeader::new(unit, title, sample_rate_hz, n_samples, sha256)
        .map_err(|_| PacketFault::Malformed { field: "stream header" })?;
    Hello::new(header, usize::from(samples_per_frame))
        .map_err(|_| PacketFault::Malformed { field: "samples per frame" })
}

fn decode_data(fields: &mut Fields<'_>, sequence: u32, sent_before: bool) -> Result<Data, PacketFault> {
    let first_sample = fields.u64("first sample")?;
    let sent_ns = fields.u64("send time")?;
    // Bounded by the packet length: at most 144 samples.
    let mut samples = Vec::with_capacity(fields.0.len() / 8);
    while !fields.0.is_empty() {
        samples.push(f64::from_bits(fields.u64("sample")?));
    }
    Data::new(sequence, first_sample, sent_ns, sent_before, samples)
        .map_err(|_| PacketFault::Malformed { field: "number of samples" })
}

/// The bytes not yet read.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn bytes(&mut self, n_bytes: usize, field: &'static str) -> Result<&'a [u8], PacketFault> {
        let (head, rest) = self.0.split_at_checked(n_bytes).ok_or(PacketFault::Malformed { field })?;
        self.0 = rest;
        Ok(head)
    }

    fn array<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N], PacketFault> {
        let mut array = [0; N];
        array.copy_from_slice(self.bytes(N, field)?);
        Ok(array)
    }

    fn u8(&mut self, field: &'static str) -> Result<u8, PacketFault> {
        Ok(u8::from_be_bytes(self.array(field)?))
    }

    fn u16(&mut self, field: &'static str) -> Result<u16, PacketFault> {
        Ok(u16::from_be_bytes(self.array(field)?))
    }

    fn u32(&mut self, field: &'static str) -> Result<u32, PacketFault> {
        Ok(u32::from_be_bytes(self.array(field)?))
    }

    fn u64(&mut self, field: &'static str) -> Result<u64, PacketFault> {
        Ok(u64::from_be_bytes(self.array(field)?))
    }

    fn text(&mut self, field: &'static str) -> Result<&'a str, PacketFault> {
        let n_bytes = self.u16(field)?;
        let bytes = self.bytes(usize::from(n_bytes), field)?;
        std::str::from_utf8(bytes).map_err(|_| PacketFault::Malformed { field })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MAX_SAMPLES_PER_FRAME;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    fn random_text(rng: &mut Pcg64Mcg, max_chars: usize) -> String {
        (0..rng.random_range(1..=max_chars))
            .map(|_| ['m', 'Å', ' ', '7', '脉'][rng.random_range(0..5)])
            .collect()
    }

    fn random_packet(rng: &mut Pcg64Mcg) -> Packet {
        let body = match rng.random_range(0..8) {
            0 => {
                let header = StreamHeader::new(
                    &random_text(rng, 10),
                    &random_text(rng, 85),
                    rng.random_range(0.1..1e6),
                    rng.random_range(1..1 << 30),
                    Sha256Digest(rng.random()),
                )
                .expect("valid header");
                Body::Hello(Hello::new(header, rng.random_range(1..=128)).expect("valid hello"))
            }
            1 => {
                let n_samples = rng.random_range(1..=MAX_SAMPLES_PER_FRAME);
                // Any bit pattern, not only numbers.
                let samples = (0..n_samples).map(|_| f64::from_bits(rng.random())).collect();
                Body::Data(
                    Data::new(rng.random(), rng.random(), rng.random(), rng.random(), samples)
                        .expect("valid data"),
                )
            }
            2 => Body::Ack(Ack { next_expected: rng.random(), bitmap: rng.random() }),
            3 => Body::End { n_frames: rng.random() },
            4 => Body::EndAck(if rng.random() { EndStatus::Complete } else { EndStatus::HashMismatch }),
            5 => Body::Ping { t1_ns: rng.random() },
            6 => Body::Pong { t1_ns: rng.random(), t2_ns: rng.random(), t3_ns: rng.random() },
            _ => Body::Reject(
                [RejectReason::Version, RejectReason::Busy, RejectReason::Header][rng.random_range(0..3)],
            ),
        };
        Packet { session: rng.random(), body }
    }

    #[test]
    fn law_decode_inverts_encode_bit_for_bit() {
        for seed in 0..2000 {
            let packet = random_packet(&mut Pcg64Mcg::seed_from_u64(seed));
            let bytes = packet.encode();
            assert!(bytes.len() <= MAX_PACKET_BYTES);
            let back = Packet::decode(&bytes).unwrap_or_else(|fault| panic!("seed {seed}: {fault}"));
            // Compared as bytes, because NaN is not equal to itself.
            assert_eq!(back.encode(), bytes, "seed {seed}");
        }
    }

    #[test]
    fn law_layout_is_the_documented_one() {
        let data = Data::new(7, 1, 2, true, vec![1.0]).expect("valid data");
        let bytes = Packet { session: 0x0102_0304_0506_0708, body: Body::Data(data) }.encode();
        let expected = [
            &b"TPLS\x01\x02\x00\x01\x01\x02\x03\x04\x05\x06\x07\x08\x00\x00\x00\x07\x00\x18"[..],
            b"\0\0\0\0\0\0\0\x01\0\0\0\0\0\0\0\x02\x3f\xf0\0\0\0\0\0\0",
        ]
        .concat();
        assert_eq!(bytes[..46], expected);
        assert_eq!(bytes.len(), 50);
    }

    #[test]
    fn edge_every_flip_of_up_to_three_bits_is_detected() {
        // CRC-32 (IEEE) has Hamming distance 4 for far more than 1200 bytes.
        for seed in 0..3000 {
            let mut rng = Pcg64Mcg::seed_from_u64(seed);
            let mut bytes = random_packet(&mut rng).encode();
            let first = rng.random_range(0..bytes.len() * 8);
            let mut flips = vec![first];
            for _ in 0..rng.random_range(0..3) {
                let other = rng.random_range(0..bytes.len() * 8);
                if !flips.contains(&other) {
                    flips.push(other);
                }
            }
            for flip in &flips {
                bytes[flip / 8] ^= 1 << (flip % 8);
            }
            assert!(Packet::decode(&bytes).is_err(), "seed {seed}: flips {flips:?} went unnoticed");
        }
    }

    #[test]
    fn edge_random_bytes_and_truncations_never_panic() {
        for seed in 0..5000 {
            let mut rng = Pcg64Mcg::seed_from_u64(seed);
            let noise: Vec<u8> = (0..rng.random_range(0..1500)).map(|_| rng.random()).collect();
            assert!(Packet::decode(&noise).is_err(), "seed {seed}");
            let bytes = random_packet(&mut rng).encode();
            let cut = rng.random_range(0..bytes.len());
            assert!(Packet::decode(&bytes[..cut]).is_err(), "seed {seed}: cut at {cut}");
        }
    }

    #[test]
    fn edge_wrong_content_with_a_right_checksum_never_panics() {
        // Damage first, checksum afterwards: this reaches every branch behind the checksum.
        let mut n_accepted = 0;
        for seed in 0..20_000 {
            let mut rng = Pcg64Mcg::seed_from_u64(seed);
            let mut bytes = random_packet(&mut rng).encode();
            bytes.truncate(bytes.len() - CRC_BYTES);
            match rng.random_range(0..3) {
                0 => bytes.truncate(rng.random_range(HEADER_BYTES..=bytes.len())),
                1 => bytes.extend((0..rng.random_range(0..40)).map(|_| rng.random::<u8>())),
                _ => {}
            }
            for _ in 0..rng.random_range(1..6) {
                let idx = rng.random_range(4..bytes.len());
                bytes[idx] = rng.random();
            }
            if rng.random() {
                let n_payload = (bytes.len() - HEADER_BYTES) as u16;
                bytes[20..22].copy_from_slice(&n_payload.to_be_bytes());
            }
            let crc = crc32fast::hash(&bytes);
            bytes.extend_from_slice(&crc.to_be_bytes());
            if let Ok(packet) = Packet::decode(&bytes) {
                assert_eq!(packet.encode(), bytes, "seed {seed}: accepted packets must be canonical");
                n_accepted += 1;
            }
        }
        assert!(n_accepted > 0);
    }

    #[test]
    fn edge_faults_are_told_apart() {
        let good = Packet { session: 1, body: Body::Ping { t1_ns: 3 } }.encode();
        assert_eq!(Packet::decode(&good[..20]), Err(PacketFault::Truncated { n_bytes: 20 }));
        assert_eq!(Packet::decode(&good[..good.len() - 1]), Err(PacketFault::Corrupted));
        let mut other = good.clone();
        other[0] = b'X';
        assert_eq!(Packet::decode(&other), Err(PacketFault::Foreign));
        // A damaged version byte is damage; a version byte with a right checksum is another version.
        let mut version = good;
        version[4] = 2;
        assert_eq!(Packet::decode(&version), Err(PacketFault::Corrupted));
        let n = version.len() - CRC_BYTES;
        let crc = crc32fast::hash(&version[..n]);
        version[n..].copy_from_slice(&crc.to_be_bytes());
        assert_eq!(Packet::decode(&version), Err(PacketFault::WrongVersion { found: 2 }));
    }
}
