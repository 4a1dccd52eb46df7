//! Two endpoints in virtual time: what holds on every network, and what happens when it cannot hold.

use std::ops::Range;
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use telepulse_link::record::{LogSummary, LogWriter, verify_log};
use telepulse_link::{
    Body, Error, Handled, Hello, Pace, Packet, Receiver, ReceiverEvent, ReceiverSettings, RejectReason,
    Sender, SenderSettings, Sha256Digest, SilentPhase, StreamHeader,
};

use crate::network::{Conditions, Outcome, transmit, transmit_as};

const MS: Duration = Duration::from_millis(1);
const QUIET: Conditions =
    Conditions { loss: 0.0, duplication: 0.0, corruption: 0.0, min_delay: MS, jitter: Duration::ZERO };

fn random_samples(rng: &mut Pcg64Mcg, n_samples: usize) -> Vec<f64> {
    // Any bit pattern: NaN with payload, infinities, negative zero and subnormal numbers included.
    (0..n_samples).map(|_| f64::from_bits(rng.random())).collect()
}

/// Writes the events to a log, checks order and content, and returns the log and its summary.
fn log_of(outcome: &Outcome, seed: u64) -> (Vec<u8>, LogSummary, Vec<f64>) {
    let mut out = Vec::new();
    let mut samples = Vec::new();
    let mut events = outcome.events.iter();
    let Some(ReceiverEvent::Opened { session, hello }) = events.next() else {
        panic!("seed {seed}: stream was not opened")
    };
    let mut log = LogWriter::new(&mut out, *session, "simulated", hello).unwrap();
    let mut finished = None;
    for event in events {
        match event {
            ReceiverEvent::Delivered(delivered) => {
                assert!(finished.is_none(), "seed {seed}: samples after the end");
                log.frame(delivered).unwrap();
                samples.extend_from_slice(&delivered.samples);
            }
            ReceiverEvent::Finished(outcome) => finished = Some(outcome),
            ReceiverEvent::Opened { .. } => panic!("seed {seed}: opened twice"),
        }
    }
    let failure = finished.and_then(|outcome| outcome.as_ref().err());
    let summary = log.finish(outcome.receiver.counts(), outcome.receiver.clock(), failure).unwrap();
    (out, summary, samples)
}

/// The seeds to run: those given, or `LINK_SEEDS=first..end` to replay a failure or to search for one.
fn seeds(usual: Range<u64>) -> Range<u64> {
    let Ok(text) = std::env::var("LINK_SEEDS") else { return usual };
    let (first, end) = text.split_once("..").expect("LINK_SEEDS is first..end");
    first.parse().expect("LINK_SEEDS begins with a number")
        ..end.parse().expect("LINK_SEEDS ends with a number")
}

fn bits(samples: &[f64]) -> Vec<u64> {
    samples.iter().map(|sample| sample.to_bits()).collect()
}

#[test]
fn law_every_sample_arrives_exactly_once_in_order_bit_for_bit() {
    let (mut n_repeated, mut n_duplicate, mut n_reordered, mut n_corrupted) = (0, 0, 0, 0);
    for seed in seeds(0..200) {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let n_samples = rng.random_range(1..4000);
        let samples = random_samples(&mut rng, n_samples);
        let conditions = Conditions {
            loss: rng.random_range(0.0..=0.3),
            duplication: rng.random_range(0.0..=0.2),
            corruption: rng.random_range(0.0..=0.1),
            min_delay: MS.mul_f64(rng.random_range(0.0..50.0)),
            jitter: MS.mul_f64(rng.random_range(0.0..80.0)),
        };
        let settings = SenderSettings {
            samples_per_frame: Some(rng.random_range(1..=128)),
            window: rng.random_range(1..=64),
            ..SenderSettings::default()
        };
        let outcome = transmit(&samples, settings, ReceiverSettings::default(), conditions, seed);
        let context = format!(
            "{conditions:?} {settings:?}; replay with LINK_SEEDS={seed}..{} cargo test -p telepulse-link law_every",
            seed + 1
        );
        assert_eq!(outcome.sent, Some(Ok(())), "{context}");
        assert!(
            matches!(outcome.events.last(), Some(ReceiverEvent::Finished(Ok(())))),
            "{context}: {:?}",
            outcome.events.last()
        );
        let (log, summary, received) = log_of(&outcome, seed);
        assert_eq!(bits(&received), bits(&samples), "{context}");
        assert!(summary.bit_exact, "{context}");
        verify_log(&log[..], &samples).unwrap_or_else(|error| panic!("{context}: {error}"));
        n_repeated += outcome.sender.counts().repeated;
        n_duplicate += outcome.receiver.counts().duplicate;
        n_reordered += outcome.receiver.counts().reordered;
        n_corrupted += outcome.receiver.counts().corrupted;
    }
    // The networks were as bad as they claim.
    let all = std::env::var_os("LINK_SEEDS").is_none();
    assert!(!all || n_repeated > 1000 && n_duplicate > 1000 && n_reordered > 1000 && n_corrupted > 200);
}

#[test]
fn law_a_quiet_network_needs_each_packet_once() {
    let samples = vec![0.25; 128 * 100];
    let outcome = transmit(&samples, SenderSettings::default(), ReceiverSettings::default(), QUIET, 1);
    assert_eq!(outcome.sent, Some(Ok(())));
    let counts = outcome.sender.counts();
    assert_eq!((counts.data, counts.repeated), (100, 0));
    let received = outcome.receiver.counts();
    assert_eq!((received.duplicate, received.reordered, received.malformed), (0, 0, 0));
    // 100 packets through a window of 32 and a round trip of 2 ms, with opening and closing.
    assert!(outcome.now < MS * 20, "{:?}", outcome.now);
    assert!(outcome.n_steps < 500, "{}", outcome.n_steps);
}

#[test]
fn law_the_clock_offset_is_found_through_a_bad_network() {
    let conditions = Conditions { loss: 0.2, jitter: MS * 30, ..QUIET };
    let settings = SenderSettings { pace: Pace::RealTime, ..SenderSettings::default() };
    let outcome = transmit(&vec![1.0; 125 * 4], settings, ReceiverSettings::default(), conditions, 5);
    assert_eq!(outcome.sent, Some(Ok(())));
    let clock = outcome.receiver.clock().unwrap();
    // Both ends of the simulation read the same clock.
    assert!(clock.offset_ns.unsigned_abs() <= clock.error_bound_ns, "{clock:?}");
    assert!(clock.n_exchanges >= 10, "{clock:?}");
}

#[test]
fn law_real_time_pace_follows_the_sample_rate() {
    // 500 samples at 125 Hz: the last one exists 3.992 s after the opening.
    let settings = SenderSettings { pace: Pace::RealTime, ..SenderSettings::default() };
    let outcome = transmit(&vec![1.0; 500], settings, ReceiverSettings::default(), QUIET, 2);
    assert_eq!(outcome.sent, Some(Ok(())));
    assert!(outcome.now > MS * 3992 && outcome.now < MS * 4020, "{:?}", outcome.now);
    for event in &outcome.events {
        if let ReceiverEvent::Delivered(delivered) = event {
            let last_sample = delivered.first_sample + delivered.samples.len() as u64 - 1;
            let age = delivered.arrival - MS * (8 * last_sample as u32);
            // Opening takes a round trip of 2 ms, the way 1 ms.
            assert!(age >= MS * 3 && age < MS * 5, "sample {last_sample}: {age:?}");
        }
    }
}

#[test]
fn law_a_slow_application_stops_the_sender_and_loses_nothing() {
    let samples: Vec<f64> = (0..2000).map(f64::from).collect();
    let header = StreamHeader::describe(&samples, "mm", "slow", 125.0).unwrap();
    let settings = SenderSettings { samples_per_frame: Some(1), window: 64, ..SenderSettings::default() };
    let mut sender = Sender::new(header, samples.clone(), 9, settings, Duration::ZERO).unwrap();
    let mut receiver = Receiver::new(ReceiverSettings::default());
    let mut received = Vec::new();
    let mut finished = false;
    for step in 0..20_000_u32 {
        let now = MS * step;
        while let Some(packet) = sender.poll_transmit(now) {
            assert_eq!(receiver.handle(now, &packet), Handled::Accepted);
        }
        while let Some(packet) = receiver.poll_transmit(now) {
            sender.handle(now, &packet);
        }
        // One event each millisecond.
        match receiver.poll_event() {
            Some(ReceiverEvent::Delivered(delivered)) => received.extend(delivered.samples),
            Some(ReceiverEvent::Finished(outcome)) => {
                assert_eq!(outcome, Ok(()));
                finished = true;
            }
            _ => {}
        }
        if finished {
            break;
        }
    }
    assert!(finished);
    assert_eq!(received, samples);
}

#[test]
fn edge_a_total_blackout_ends_with_a_typed_error() {
    let blackout = Conditions { loss: 1.0, ..QUIET };
    let outcome = transmit(&[1.0], SenderSettings::default(), ReceiverSettings::default(), blackout, 3);
    let after = Duration::from_secs(5);
    assert_eq!(outcome.sent, Some(Err(Error::PeerSilent { after, phase: SilentPhase::Opening })));
    assert!(outcome.now <= after, "{:?}", outcome.now);
    assert!(outcome.events.is_empty());
    // Back-off: not more than a few packets a second.
    assert!(outcome.sender.counts().packets <= 15, "{:?}", outcome.sender.counts());
}

#[test]
fn edge_a_blackout_in_the_middle_ends_both_sides() {
    let samples: Vec<f64> = (0..10_000).map(f64::from).collect();
    let header = StreamHeader::describe(&samples, "mm", "cut", 125.0).unwrap();
    let mut sender = Sender::new(header, samples, 4, SenderSettings::default(), Duration::ZERO).unwrap();
    let mut receiver = Receiver::new(ReceiverSettings::default());
    let mut outcome = None;
    for step in 0..20_000_u32 {
        let now = MS * step;
        let connected = step < 2;
        while let Some(packet) = sender.poll_transmit(now) {
            if connected {
                receiver.handle(now, &packet);
            }
        }
        while let Some(packet) = receiver.poll_transmit(now) {
            if connected {
                sender.handle(now, &packet);
            }
        }
        while let Some(event) = receiver.poll_event() {
            if let ReceiverEvent::Finished(finished) = event {
                outcome = Some(finished);
            }
        }
    }
    let expected = Error::PeerSilent { after: Duration::from_secs(5), phase: SilentPhase::Streaming };
    assert_eq!(outcome, Some(Err(expected.clone())));
    assert!(receiver.is_closed());
    assert_eq!(sender.outcome(), Some(Err(expected)));
}

#[test]
fn edge_a_packet_that_never_passes_is_given_up() {
    // The receiver's packets pass, the sender's data does not: silence never triggers, the bounded tries do.
    let header = StreamHeader::describe(&[1.0], "mm", "", 125.0).unwrap();
    let mut sender = Sender::new(header, vec![1.0], 4, SenderSettings::default(), Duration::ZERO).unwrap();
    let mut receiver = Receiver::new(ReceiverSettings::default());
    let mut now = Duration::ZERO;
    while sender.outcome().is_none() {
        assert!(now < Duration::from_secs(60), "the tries must be bounded");
        while let Some(packet) = sender.poll_transmit(now) {
            let data = matches!(Packet::decode(&packet).unwrap().body, Body::Data(_));
            if !data {
                receiver.handle(now, &packet);
            }
        }
        while let Some(packet) = receiver.poll_transmit(now) {
            sender.handle(now, &packet);
        }
        now += MS;
    }
    let expected = Error::Unacknowledged { what: "data", sequence: Some(0), tries: 64 };
    assert_eq!(sender.outcome(), Some(Err(expected)));
}

#[test]
fn edge_a_wrong_hash_is_reported_to_both_sides() {
    let lie = StreamHeader::new("mm", "lie", 125.0, 300, Sha256Digest([7; 32])).unwrap();
    let samples = vec![1.0; 300];
    let outcome =
        transmit_as(lie, &samples, SenderSettings::default(), ReceiverSettings::default(), QUIET, 6);
    let expected =
        Error::HashMismatch { expected: Sha256Digest([7; 32]), received: Sha256Digest::of(&samples) };
    assert_eq!(outcome.sent, Some(Err(expected.clone())));
    assert_eq!(outcome.events.last(), Some(&ReceiverEvent::Finished(Err(expected))));
    let (log, summary, _) = log_of(&outcome, 6);
    assert!(!summary.bit_exact && summary.lost == 0 && summary.failure.is_some());
    assert!(verify_log(&log[..], &samples).is_err());
}

#[test]
fn edge_foreign_packets_are_counted_and_change_nothing() {
    let header = StreamHeader::describe(&[1.0, 2.0], "mm", "", 125.0).unwrap();
    let hello = Packet { session: 1, body: Body::Hello(Hello::new(header, 2).unwrap()) };
    let mut receiver = Receiver::new(ReceiverSettings::default());
    let now = Duration::ZERO;
    // Before a stream is open.
    assert_eq!(receiver.handle(now, b"GET / HTTP/1.1\r\nHost: nobody\r\n\r\n"), Handled::Ignored);
    let end = |session| Packet { session, body: Body::End { n_frames: 1 } }.encode();
    assert_eq!(receiver.handle(now, &end(1)), Handled::Ignored);
    assert_eq!(receiver.handle(now, &hello.encode()), Handled::Accepted);
    // Another session, another sender, another version, half a packet, a packet that contradicts the header.
    assert_eq!(receiver.handle(now, &end(2)), Handled::Ignored);
    let busy = Handled::Refused(Packet { session: 2, body: Body::Reject(RejectReason::Busy) }.encode());
    let other = Packet { session: 2, ..hello.clone() }.encode();
    assert_eq!(receiver.handle(now, &other), busy);
    assert_eq!(receiver.handle_stranger(&other), busy);
    assert_eq!(receiver.handle_stranger(&end(1)), Handled::Ignored);
    let version = with_version(&end(1), 9);
    let refused = Handled::Refused(Packet { session: 0, body: Body::Reject(RejectReason::Version) }.encode());
    assert_eq!(receiver.handle(now, &version), refused);
    assert_eq!(receiver.handle(now, &end(1)[..25]), Handled::Ignored);
    let data = telepulse_link::Data::new(0, 1, 0, false, vec![1.0, 2.0]).unwrap();
    assert_eq!(
        receiver.handle(now, &Packet { session: 1, body: Body::Data(data) }.encode()),
        Handled::Ignored
    );
    let counts = receiver.counts();
    assert_eq!(
        (counts.foreign, counts.foreign_session, counts.wrong_version, counts.truncated, counts.malformed),
        (1, 5, 1, 1, 1)
    );
    assert_eq!(counts.received, 10);
}

/// The same packet with another version byte and a right checksum.
fn with_version(packet: &[u8], version: u8) -> Vec<u8> {
    let mut bytes = packet[..packet.len() - 4].to_vec();
    bytes[4] = version;
    let crc = crc32fast::hash(&bytes);
    bytes.extend_from_slice(&crc.to_be_bytes());
    bytes
}

#[test]
fn edge_another_version_ends_the_sender_at_once() {
    let header = StreamHeader::describe(&[1.0], "mm", "", 125.0).unwrap();
    let mut sender = Sender::new(header, vec![1.0], 4, SenderSettings::default(), Duration::ZERO).unwrap();
    assert!(sender.poll_transmit(Duration::ZERO).is_some());
    let reply = Packet { session: 4, body: Body::Reject(RejectReason::Version) }.encode();
    sender.handle(MS, &with_version(&reply, 2));
    assert_eq!(sender.outcome(), Some(Err(Error::WireVersion { found: 2, supported: 1 })));
}

#[test]
fn edge_too_long_a_stream_is_rejected() {
    let settings = ReceiverSettings { max_samples: 10, ..ReceiverSettings::default() };
    let outcome = transmit(&[0.0; 11], SenderSettings::default(), settings, QUIET, 7);
    assert_eq!(outcome.sent, Some(Err(Error::Rejected(RejectReason::Header))));
    assert!(outcome.events.is_empty());
}

#[test]
fn edge_bad_settings_are_refused() {
    let header = StreamHeader::describe(&[1.0], "mm", "", 125.0).unwrap();
    let build = |settings, samples: &[f64]| {
        Sender::new(header.clone(), samples.to_vec(), 1, settings, Duration::ZERO).map(|_| ())
    };
    let good = SenderSettings::default();
    assert!(build(good, &[1.0]).is_ok());
    assert!(build(good, &[1.0, 2.0]).is_err());
    for bad in [
        SenderSettings { window: 0, ..good },
        SenderSettings { window: 65, ..good },
        SenderSettings { samples_per_frame: Some(0), ..good },
        SenderSettings { samples_per_frame: Some(129), ..good },
        SenderSettings { max_tries: 0, ..good },
        SenderSettings { min_timeout: Duration::ZERO, ..good },
    ] {
        assert!(build(bad, &[1.0]).is_err(), "{bad:?}");
    }
}

#[test]
fn edge_noise_at_both_ends_never_panics() {
    for seed in 0..200 {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let header = StreamHeader::describe(&[1.0; 500], "mm", "", 125.0).unwrap();
        let settings = SenderSettings { samples_per_frame: Some(2), ..SenderSettings::default() };
        let mut sender = Sender::new(header, vec![1.0; 500], 1, settings, Duration::ZERO).unwrap();
        let mut receiver = Receiver::new(ReceiverSettings::default());
        for step in 0..200_u32 {
            let now = MS * step;
            // Well-formed packets of the right session with random content.
            let body = match rng.random_range(0..5) {
                0 => Body::Ack(telepulse_link::Ack {
                    next_expected: rng.random_range(0..300),
                    bitmap: rng.random(),
                }),
                1 => Body::End { n_frames: rng.random_range(249..252) },
                2 => Body::Ping { t1_ns: rng.random() },
                3 => Body::Pong { t1_ns: rng.random(), t2_ns: rng.random(), t3_ns: rng.random() },
                _ => {
                    let n_samples = rng.random_range(1..=3);
                    let sequence = rng.random_range(0..400);
                    let data = telepulse_link::Data::new(
                        sequence,
                        u64::from(sequence) * 2,
                        rng.random(),
                        rng.random(),
                        vec![1.0; n_samples],
                    );
                    Body::Data(data.unwrap())
                }
            };
            let bytes = Packet { session: 1, body }.encode();
            sender.handle(now, &bytes);
            receiver.handle(now, &bytes);
            if let Some(packet) = sender.poll_transmit(now) {
                receiver.handle(now, &packet);
            }
            if let Some(packet) = receiver.poll_transmit(now) {
                sender.handle(now, &packet);
            }
        }
    }
}
