//! A network that loses, doubles, delays, reorders and damages packets, all from one seed and in virtual time.

use std::collections::BTreeMap;
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use telepulse_link::{
    Error, Handled, Receiver, ReceiverEvent, ReceiverSettings, Sender, SenderSettings, StreamHeader,
};

/// What the network does to each packet.
#[derive(Debug, Clone, Copy)]
pub struct Conditions {
    pub loss: f64,
    pub duplication: f64,
    pub corruption: f64,
    pub min_delay: Duration,
    /// Added at random, so that packets overtake each other.
    pub jitter: Duration,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    Sender,
    Receiver,
}

/// What came out of a simulated transmission.
pub struct Outcome {
    pub sender: Sender,
    pub receiver: Receiver,
    pub sent: Option<Result<(), Error>>,
    pub events: Vec<ReceiverEvent>,
    pub now: Duration,
    pub n_steps: u64,
}

/// A bound that no test comes near; a protocol that spins would.
const MAX_STEPS: u64 = 2_000_000;

struct Network {
    conditions: Conditions,
    rng: Pcg64Mcg,
    /// Keyed by arrival and a running number, which keeps equal times apart.
    under_way: BTreeMap<(Duration, u64), (End, Vec<u8>)>,
    n_sent: u64,
}

impl Network {
    fn carry(&mut self, now: Duration, to: End, packet: Vec<u8>) {
        let copies = 1 + u32::from(self.rng.random_bool(self.conditions.duplication));
        for _ in 0..copies {
            if self.rng.random_bool(self.conditions.loss) {
                continue;
            }
            let mut bytes = packet.clone();
            if self.rng.random_bool(self.conditions.corruption) {
                for _ in 0..self.rng.random_range(1..=3) {
                    let bit = self.rng.random_range(0..bytes.len() * 8);
                    bytes[bit / 8] ^= 1 << (bit % 8);
                }
                if self.rng.random_bool(0.2) {
                    bytes.truncate(self.rng.random_range(0..bytes.len()));
                }
            }
            let delay = self.conditions.min_delay + self.conditions.jitter.mul_f64(self.rng.random());
            self.n_sent += 1;
            self.under_way.insert((now + delay, self.n_sent), (to, bytes));
        }
    }
}

/// Sends `samples` from one end to the other and runs until both are done or the sender has failed and the receiver closed.
pub fn transmit(
    samples: &[f64],
    sender_settings: SenderSettings,
    receiver_settings: ReceiverSettings,
    conditions: Conditions,
    seed: u64,
) -> Outcome {
    let header = StreamHeader::describe(samples, "mm", "simulated", 125.0).expect("valid header");
    transmit_as(header, samples, sender_settings, receiver_settings, conditions, seed)
}

/// As [`transmit`], with a header that may not be true.
pub fn transmit_as(
    header: StreamHeader,
    samples: &[f64],
    sender_settings: SenderSettings,
    receiver_settings: ReceiverSettings,
    conditions: Conditions,
    seed: u64,
) -> Outcome {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let session = rng.random();
    let mut network = Network { conditions, rng, under_way: BTreeMap::new(), n_sent: 0 };
    let mut now = Duration::ZERO;
    let mut sender =
        Sender::new(header, samples.to_vec(), session, sender_settings, now).expect("valid settings");
    let mut receiver = Receiver::new(receiver_settings);
    let mut events = Vec::new();
    let mut n_steps = 0;
    loop {
        n_steps += 1;
        assert!(n_steps < MAX_STEPS, "seed {seed}: no end after {MAX_STEPS} steps");
        while let Some(packet) = sender.poll_transmit(now) {
            network.carry(now, End::Receiver, packet);
        }
        while let Some(packet) = receiver.poll_transmit(now) {
            network.carry(now, End::Sender, packet);
        }
        while let Some(event) = receiver.poll_event() {
            events.push(event);
        }
        let arrival = network.under_way.keys().next().map(|(arrival, _)| *arrival);
        let Some(next) =
            [arrival, sender.next_deadline(), receiver.next_deadline()].into_iter().flatten().min()
        else {
            break;
        };
        now = now.max(next);
        while let Some(packet) = network.under_way.first_entry().filter(|entry| entry.key().0 <= now) {
            let (to, bytes) = packet.remove();
            match to {
                End::Sender => sender.handle(now, &bytes),
                End::Receiver => {
                    if let Handled::Refused(reply) = receiver.handle(now, &bytes) {
                        network.carry(now, End::Sender, reply);
                    }
                }
            }
        }
    }
    Outcome { sent: sender.outcome(), sender, receiver, events, now, n_steps }
}
