//! The doctor's side as a state machine: packets and the time go in; samples in order, packets and the next deadline come out.
//!
//! ```text
//! Waiting --Hello--> Receiving --all there, End--> Lingering --EndAck or time--> Closed
//!                        `---------- silence ----------------------------------> Closed
//! ```

use std::collections::VecDeque;
use std::time::Duration;

use crate::sender::nanoseconds;
use crate::stream::{SampleHasher, crc32_of};
use crate::{
    Ack, Body, ClockEstimate, ClockSync, Data, EndStatus, Error, Hello, MAX_WINDOW, Packet, PacketCounts,
    PacketFault, RejectReason, SilentPhase,
};

/// Events that wait for the application. While the queue is full, packets stay in the window and the sender stops by itself.
const MAX_EVENTS: usize = 256;
/// Times that the verdict is sent while lingering, unless its arrival is confirmed.
const VERDICT_REPEATS: u32 = 20;
/// Questions for the clock that wait for an answer.
const MAX_PINGS: usize = 8;

/// How a stream is received.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReceiverSettings {
    /// Longest stream accepted, in samples.
    pub max_samples: u64,
    /// Longest time without a valid packet from the sender.
    pub max_silence: Duration,
    /// How long the verdict is repeated, every twentieth of this time, for a sender that has not confirmed it. If all of them are lost the
    /// sender reports a failure although everything arrived; no protocol can exclude that.
    pub linger: Duration,
    /// Time between questions for the clock.
    pub ping_interval: Duration,
}

impl Default for ReceiverSettings {
    /// Ten million samples (22 hours at 125 Hz), 5 s of silence, 2 s of linger, a question every 100 ms.
    fn default() -> Self {
        Self {
            max_samples: 10_000_000,
            max_silence: Duration::from_secs(5),
            linger: Duration::from_secs(2),
            ping_interval: Duration::from_millis(100),
        }
    }
}

/// Samples of one data packet, in order.
#[derive(Debug, Clone, PartialEq)]
pub struct Delivered {
    /// Position in the stream of packets, from 0.
    pub sequence: u32,
    /// Index of the first sample in the stream.
    pub first_sample: u64,
    /// The samples, bit for bit.
    pub samples: Vec<f64>,
    /// CRC-32 of the samples' bytes.
    pub crc32: u32,
    /// When the packet arrived (not: when its turn came).
    pub arrival: Duration,
    /// Sender's clock when it left, in nanoseconds.
    pub sent_ns: u64,
    /// True where the accepted copy was not the first one sent.
    pub retransmitted: bool,
    /// Further copies that were discarded before its turn came.
    pub duplicates: u32,
}

/// What the application is told, in this order: `Opened`, `Delivered` for each packet, `Finished`.
#[derive(Debug, Clone, PartialEq)]
pub enum ReceiverEvent {
    /// A stream began.
    Opened {
        /// Its session.
        session: u64,
        /// Its description.
        hello: Hello,
    },
    /// The next samples.
    Delivered(Delivered),
    /// All samples came and their hash was checked, or the stream failed.
    Finished(Result<(), Error>),
}

/// What became of a datagram.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Handled {
    /// It belongs to the stream.
    Accepted,
    /// It was counted and dropped.
    Ignored,
    /// It was refused; these bytes say so and go back to where it came from.
    Refused(Vec<u8>),
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Phase {
    Waiting,
    Receiving,
    Lingering { until: Duration },
    Closed,
}

#[derive(Debug, Clone)]
struct Pending {
    data: Data,
    arrival: Duration,
    duplicates: u32,
}

#[derive(Debug, Clone)]
struct Stream {
    session: u64,
    hello: Hello,
    /// First packet that has not been handed on.
    next: u32,
    highest: Option<u32>,
    /// Packet `sequence` waits in slot `sequence % MAX_WINDOW`.
    waiting: Vec<Option<Pending>>,
    hasher: SampleHasher,
    verdict: Option<EndStatus>,
    ack_due: bool,
    /// When the verdict is sent next.
    next_verdict: Duration,
    next_ping: Duration,
    pings: VecDeque<u64>,
}

/// A stream coming in.
///
/// **Method**: packets within 64 of the first missing one are kept and handed on in order; every data packet is answered with what is there.
/// A packet that is there already is counted and dropped, so each sample is handed on exactly once.
#[derive(Debug, Clone)]
pub struct Receiver {
    settings: ReceiverSettings,
    phase: Phase,
    stream: Option<Stream>,
    events: VecDeque<ReceiverEvent>,
    last_heard: Duration,
    clock_sync: ClockSync,
    counts: PacketCounts,
}

impl Receiver {
    /// A receiver that waits for a stream.
    #[must_use]
    pub fn new(settings: ReceiverSettings) -> Self {
        Self {
            settings,
            phase: Phase::Waiting,
            stream: None,
            events: VecDeque::with_capacity(MAX_EVENTS),
            last_heard: Duration::ZERO,
            clock_sync: ClockSync::default(),
            counts: PacketCounts::default(),
        }
    }

    /// What came in.
    #[must_use]
    pub fn counts(&self) -> PacketCounts {
        self.counts
    }

    /// The sender's clock against this one, as far as known.
    #[must_use]
    pub fn clock(&self) -> Option<ClockEstimate> {
        self.clock_sync.estimate()
    }

    /// True once nothing more will be sent or accepted.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.phase == Phase::Closed
    }

    /// The next event; call until `None`.
    pub fn poll_event(&mut self) -> Option<ReceiverEvent> {
        let event = self.events.pop_front();
        // The space just made may release packets that waited for it.
        self.hand_on();
        event
    }

    /// Takes in one datagram from the sender, or from anyone before a stream is open.
    pub fn handle(&mut self, now: Duration, bytes: &[u8]) -> Handled {
        self.counts.received += 1;
        let packet = match Packet::decode(bytes) {
            Ok(packet) => packet,
            Err(fault) => return self.refuse_fault(fault),
        };
        let Some(stream) = &self.stream else {
            return match packet.body {
                Body::Hello(hello) if self.phase == Phase::Waiting => self.open(now, packet.session, hello),
                _ => self.ignore_session(),
            };
        };
        if packet.session != stream.session {
            return match packet.body {
                Body::Hello(_) if self.phase != Phase::Closed => self.refuse_busy(packet.session),
                _ => self.ignore_session(),
            };
        }
        if self.phase == Phase::Closed {
            return Handled::Ignored;
        }
        self.handle_own(now, packet.body)
    }

    /// Takes in one datagram that came from another address than the sender's.
    pub fn handle_stranger(&mut self, bytes: &[u8]) -> Handled {
        self.counts.received += 1;
        match Packet::decode(bytes) {
            Err(fault) => self.refuse_fault(fault),
            Ok(Packet { session, body: Body::Hello(_) }) => self.refuse_busy(session),
            Ok(_) => self.ignore_session(),
        }
    }

    /// The next datagram for the sender at `now`; call until `None`. Timeouts are noticed here.
    pub fn poll_transmit(&mut self, now: Duration) -> Option<Vec<u8>> {
        self.notice_time(now);
        let receiving = self.phase == Phase::Receiving;
        let (ping_interval, verdict_interval) =
            (self.settings.ping_interval, self.settings.linger / VERDICT_REPEATS);
        let stream = self.stream.as_mut()?;
        if self.phase == Phase::Closed {
            return None;
        }
        let verdict = stream.verdict.filter(|_| now >= stream.next_verdict);
        let body = if let Some(verdict) = verdict {
            // Never zero, or this would be called for ever.
            stream.next_verdict = now.saturating_add(verdict_interval.max(Duration::from_millis(1)));
            Body::EndAck(verdict)
        } else if stream.ack_due {
            stream.ack_due = false;
            stream.ack()
        } else if receiving && now >= stream.next_ping {
            let t1_ns = nanoseconds(now);
            if stream.pings.len() == MAX_PINGS {
                stream.pings.pop_front();
            }
            stream.pings.push_back(t1_ns);
            stream.next_ping = now.saturating_add(ping_interval.max(Duration::from_millis(1)));
            // The acknowledgement that reopened the sender's window may have been lost.
            stream.ack_due = true;
            Body::Ping { t1_ns }
        } else {
            return None;
        };
        Some(Packet { session: stream.session, body }.encode())
    }

    /// When [`poll_transmit`](Self::poll_transmit) must be called next, even if nothing comes in.
    #[must_use]
    pub fn next_deadline(&self) -> Option<Duration> {
        let stream = self.stream.as_ref()?;
        match self.phase {
            Phase::Waiting | Phase::Closed => None,
            Phase::Receiving if stream.ack_due => Some(self.last_heard),
            Phase::Receiving => {
                Some(stream.next_ping.min(self.last_heard.saturating_add(self.settings.max_silence)))
            }
            Phase::Lingering { .. } if stream.ack_due => Some(self.last_heard),
            Phase::Lingering { until } => Some(until.min(stream.next_verdict)),
        }
    }

    fn refuse_fault(&mut self, fault: PacketFault) -> Handled {
        self.counts.count(fault);
        match fault {
            // The other version's session number cannot be read; its sender knows this packet by its version.
            PacketFault::WrongVersion { .. } => refusal(0, RejectReason::Version),
            _ => Handled::Ignored,
        }
    }

    fn refuse_busy(&mut self, session: u64) -> Handled {
        self.counts.foreign_session += 1;
        refusal(session, RejectReason::Busy)
    }

    fn ignore_session(&mut self) -> Handled {
        self.counts.foreign_session += 1;
        Handled::Ignored
    }

    fn open(&mut self, now: Duration, session: u64, hello: Hello) -> Handled {
        if hello.header().n_samples() > self.settings.max_samples {
            return refusal(session, RejectReason::Header);
        }
        self.events.push_back(ReceiverEvent::Opened { session, hello: hello.clone() });
        self.stream = Some(Stream {
            session,
            hello,
            next: 0,
            highest: None,
            waiting: vec![None; MAX_WINDOW],
            hasher: SampleHasher::default(),
            verdict: None,
            ack_due: true,
            next_verdict: Duration::ZERO,
            next_ping: now,
            pings: VecDeque::with_capacity(MAX_PINGS),
        });
        self.phase = Phase::Receiving;
        self.last_heard = now;
        Handled::Accepted
    }

    fn handle_own(&mut self, now: Duration, body: Body) -> Handled {
        let Some(stream) = &mut self.stream else { return Handled::Ignored };
        match body {
            Body::Hello(hello) if hello == stream.hello => stream.ack_due = true,
            Body::Data(data) if stream.fits(&data) => {
                stream.ack_due = true;
                match stream.store(data, now) {
                    Stored::New { reordered } => self.counts.reordered += u64::from(reordered),
                    Stored::Duplicate => self.counts.duplicate += 1,
                }
                self.hand_on();
            }
            Body::End { n_frames } if n_frames == stream.hello.n_frames() => self.handle_end(now),
            Body::EndAck(_) if stream.verdict.is_some() => self.phase = Phase::Closed,
            Body::Pong { t1_ns, t2_ns, t3_ns } => {
                // Each question is used once: a duplicated answer would count twice.
                if let Some(idx) = stream.pings.iter().position(|ping| *ping == t1_ns) {
                    stream.pings.remove(idx);
                    self.clock_sync.push(t1_ns, t2_ns, t3_ns, nanoseconds(now));
                }
            }
            _ => {
                self.counts.malformed += 1;
                return Handled::Ignored;
            }
        }
        self.last_heard = now;
        Handled::Accepted
    }

    /// Moves packets whose turn has come to the application, as far as its queue has room.
    fn hand_on(&mut self) {
        let Some(stream) = &mut self.stream else { return };
        // One place stays free for `Finished`.
        while self.events.len() < MAX_EVENTS - 1 {
            let slot = stream.next as usize % MAX_WINDOW;
            let Some(Pending { data, arrival, duplicates }) = stream.waiting[slot].take() else { break };
            stream.next += 1;
            stream.ack_due = true;
            stream.hasher.update(data.samples());
            self.events.push_back(ReceiverEvent::Delivered(Delivered {
                sequence: data.sequence(),
                first_sample: data.first_sample(),
                crc32: crc32_of(data.samples()),
                arrival,
                sent_ns: data.sent_ns(),
                retransmitted: data.sent_before(),
                duplicates,
                samples: data.into_samples(),
            }));
        }
    }

    fn handle_end(&mut self, now: Duration) {
        let Some(stream) = &mut self.stream else { return };
        if stream.next != stream.hello.n_frames() {
            // Something is missing or waits for the application: say what is there, the sender asks again.
            stream.ack_due = true;
            return;
        }
        stream.next_verdict = now;
        if stream.verdict.is_some() {
            return;
        }
        let (expected, received) = (stream.hello.header().sha256(), stream.hasher.finish());
        let (verdict, outcome) = if expected == received {
            (EndStatus::Complete, Ok(()))
        } else {
            (EndStatus::HashMismatch, Err(Error::HashMismatch { expected, received }))
        };
        stream.verdict = Some(verdict);
        self.events.push_back(ReceiverEvent::Finished(outcome));
        self.phase = Phase::Lingering { until: now.saturating_add(self.settings.linger) };
    }

    fn notice_time(&mut self, now: Duration) {
        match self.phase {
            Phase::Lingering { until } if now >= until => self.phase = Phase::Closed,
            Phase::Receiving if now >= self.last_heard.saturating_add(self.settings.max_silence) => {
                self.phase = Phase::Closed;
                let (after, phase) = (self.settings.max_silence, SilentPhase::Streaming);
                self.events.push_back(ReceiverEvent::Finished(Err(Error::PeerSilent { after, phase })));
            }
            _ => {}
        }
    }
}

enum Stored {
    New { reordered: bool },
    Duplicate,
}

impl Stream {
    /// Whether a packet says of itself what the header says of it, and lies within the window.
    fn fits(&self, data: &Data) -> bool {
        data.sequence() < self.hello.n_frames()
            && data.first_sample() == self.hello.first_sample(data.sequence())
            && data.samples().len() == self.hello.n_samples(data.sequence())
            && data.sequence() < self.next + MAX_WINDOW as u32
    }

    fn store(&mut self, data: Data, arrival: Duration) -> Stored {
        let sequence = data.sequence();
        if sequence < self.next {
            return Stored::Duplicate;
        }
        let slot = &mut self.waiting[sequence as usize % MAX_WINDOW];
        if let Some(pending) = slot {
            pending.duplicates += 1;
            return Stored::Duplicate;
        }
        *slot = Some(Pending { data, arrival, duplicates: 0 });
        let reordered = self.highest.is_some_and(|highest| sequence < highest);
        self.highest = self.highest.max(Some(sequence));
        Stored::New { reordered }
    }

    fn ack(&self) -> Body {
        let mut bitmap = 0;
        for offset in 0..MAX_WINDOW {
            if self.waiting[(self.next as usize + offset) % MAX_WINDOW].is_some() {
                bitmap |= 1 << offset;
            }
        }
        Body::Ack(Ack { next_expected: self.next, bitmap })
    }
}

fn refusal(session: u64, reason: RejectReason) -> Handled {
    Handled::Refused(Packet { session, body: Body::Reject(reason) }.encode())
}
