//! The patient's side as a state machine: packets and the time go in, packets and the next deadline come out.
//!
//! ```text
//! Opening --Ack--> Streaming --all acknowledged--> Closing --EndAck--> Done
//!    `----------------`------ silence, too many tries, Reject ------`---> Failed
//! ```

use std::collections::VecDeque;
use std::time::Duration;

use crate::round_trip::RoundTrip;
use crate::{
    Ack, Body, Data, EndStatus, Error, Hello, MAX_WINDOW, Packet, PacketCounts, PacketFault, SilentPhase,
    StreamHeader, WIRE_VERSION,
};

/// Answers that wait to be sent; further ones are dropped, and the peer asks again.
const MAX_REPLIES: usize = 8;
/// Acknowledged later packets after which a missing one is repeated without waiting for its timeout (RFC 5681 uses the same number).
const FAST_REPEAT_AFTER: u32 = 3;

/// When samples may leave.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Pace {
    /// As soon as the window allows.
    #[default]
    AsFastAsPossible,
    /// Not before a sensor would have delivered them: sample `k` at `k / sample_rate_hz` after the stream was opened.
    RealTime,
}

/// How a stream is sent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SenderSettings {
    /// When samples may leave.
    pub pace: Pace,
    /// Samples in each packet, 1 to 128; `None` takes 128, or 20 ms of signal in [`Pace::RealTime`].
    pub samples_per_frame: Option<usize>,
    /// Most packets under way, 1 to 64.
    pub window: usize,
    /// Timeout before the first round trip was measured.
    pub initial_timeout: Duration,
    /// Shortest timeout.
    pub min_timeout: Duration,
    /// Longest timeout.
    pub max_timeout: Duration,
    /// Most transmissions of one packet.
    pub max_tries: u32,
    /// Longest time without a valid packet from the receiver.
    pub max_silence: Duration,
}

impl Default for SenderSettings {
    /// As fast as possible, 32 packets under way, timeouts 20 to 500 ms beginning with 200 ms, 64 tries, 5 s of silence.
    fn default() -> Self {
        Self {
            pace: Pace::AsFastAsPossible,
            samples_per_frame: None,
            window: 32,
            initial_timeout: Duration::from_millis(200),
            min_timeout: Duration::from_millis(20),
            max_timeout: Duration::from_millis(500),
            max_tries: 64,
            max_silence: Duration::from_secs(5),
        }
    }
}

/// What the sender did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SendCounts {
    /// All packets sent.
    pub packets: u64,
    /// Data packets sent for the first time.
    pub data: u64,
    /// Data packets sent again.
    pub repeated: u64,
}

#[derive(Debug, Clone, PartialEq)]
enum Phase {
    Opening,
    Streaming,
    Closing,
    Done,
    Failed(Error),
}

#[derive(Debug, Clone, Copy)]
struct InFlight {
    sent_at: Duration,
    tries: u32,
    acknowledged: bool,
    repeat_now: bool,
}

/// Header and end are sent one at a time.
#[derive(Debug, Clone, Copy, Default)]
struct Single {
    sent_at: Duration,
    tries: u32,
}

/// A stream on its way.
///
/// **Method**: selective repeat. At most `window` data packets are under way; each has its own timeout with back-off; a gap that three later
/// acknowledgements prove is repeated once at once. `now` is the time since any fixed moment of a clock that never steps back.
#[derive(Debug, Clone)]
pub struct Sender {
    session: u64,
    hello: Hello,
    samples: Vec<f64>,
    settings: SenderSettings,
    phase: Phase,
    /// First packet that was not handed on to the receiver's application; front of `in_flight`.
    base: u32,
    in_flight: VecDeque<InFlight>,
    single: Single,
    opened_at: Duration,
    last_heard: Duration,
    round_trip: RoundTrip,
    replies: VecDeque<Packet>,
    counts: SendCounts,
    received: PacketCounts,
}

impl Sender {
    /// A sender of `samples` as session `session` (draw it at random), beginning at `now`.
    ///
    /// # Errors
    /// [`Error::Setting`] for a header that does not describe the samples, or settings outside of their ranges.
    pub fn new(
        header: StreamHeader,
        samples: Vec<f64>,
        session: u64,
        settings: SenderSettings,
        now: Duration,
    ) -> Result<Self, Error> {
        if header.n_samples() != samples.len() as u64 {
            return Err(Error::setting("samples", "as many as the header says", samples.len()));
        }
        if !(1..=MAX_WINDOW).contains(&settings.window) {
            return Err(Error::setting("window in packets", "1 to 64", settings.window));
        }
        if settings.max_tries == 0 {
            return Err(Error::setting("transmissions of one packet", "at least 1", 0));
        }
        if settings.min_timeout.is_zero() || settings.min_timeout > settings.max_timeout {
            return Err(Error::setting(
                "shortest timeout",
                "greater than zero and at most the longest",
                format!("{:?}", settings.min_timeout),
            ));
        }
        let samples_per_frame = settings
            .samples_per_frame
            .unwrap_or_else(|| default_frame(settings.pace, header.sample_rate_hz()));
        Ok(Self {
            session,
            hello: Hello::new(header, samples_per_frame)?,
            samples,
            phase: Phase::Opening,
            base: 0,
            in_flight: VecDeque::with_capacity(settings.window),
            single: Single::default(),
            opened_at: now,
            last_heard: now,
            round_trip: RoundTrip::new(settings.initial_timeout, settings.min_timeout, settings.max_timeout),
            settings,
            replies: VecDeque::with_capacity(MAX_REPLIES),
            counts: SendCounts::default(),
            received: PacketCounts::default(),
        })
    }

    /// The session number.
    #[must_use]
    pub fn session(&self) -> u64 {
        self.session
    }

    /// The stream as announced.
    #[must_use]
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// Samples that the receiver has handed on to its application.
    #[must_use]
    pub fn acknowledged_samples(&self) -> u64 {
        self.hello.first_sample(self.base).min(self.hello.header().n_samples())
    }

    /// What was sent.
    #[must_use]
    pub fn counts(&self) -> SendCounts {
        self.counts
    }

    /// What came in.
    #[must_use]
    pub fn received(&self) -> PacketCounts {
        self.received
    }

    /// The round-trip estimate.
    #[must_use]
    pub fn round_trip(&self) -> RoundTrip {
        self.round_trip
    }

    /// `None` while the stream is under way, then the outcome: `Ok` when the receiver confirmed samples and hash.
    #[must_use]
    pub fn outcome(&self) -> Option<Result<(), Error>> {
        match &self.phase {
            Phase::Done => Some(Ok(())),
            Phase::Failed(error) => Some(Err(error.clone())),
            _ => None,
        }
    }

    /// Takes in one datagram.
    pub fn handle(&mut self, now: Duration, bytes: &[u8]) {
        self.received.received += 1;
        let packet = match Packet::decode(bytes) {
            Ok(packet) => packet,
            Err(fault) => {
                self.received.count(fault);
                if let (PacketFault::WrongVersion { found }, Phase::Opening) = (fault, &self.phase) {
                    self.phase = Phase::Failed(Error::WireVersion { found, supported: WIRE_VERSION });
                }
                return;
            }
        };
        if packet.session != self.session {
            self.received.foreign_session += 1;
            return;
        }
        if self.outcome().is_some() {
            // The receiver repeats its verdict until it knows that it was heard.
            if let Body::EndAck(status) = packet.body {
                self.reply(Body::EndAck(status));
            }
            return;
        }
        match packet.body {
            Body::Ack(ack) => self.handle_ack(now, ack),
            Body::EndAck(status) => self.handle_verdict(status),
            Body::Ping { t1_ns } => {
                let now_ns = nanoseconds(now);
                self.reply(Body::Pong { t1_ns, t2_ns: now_ns, t3_ns: now_ns });
            }
            Body::Reject(reason) if self.phase == Phase::Opening => {
                self.phase = Phase::Failed(Error::Rejected(reason));
            }
            _ => {
                self.received.malformed += 1;
                return;
            }
        }
        self.last_heard = now;
    }

    /// The next datagram to send at `now`; call until `None`. Timeouts are noticed here.
    pub fn poll_transmit(&mut self, now: Duration) -> Option<Vec<u8>> {
        // The last answer, to the verdict, leaves even when the stream is done.
        let packet = match self.replies.pop_front() {
            Some(reply) => reply,
            None => {
                self.notice_silence(now);
                let body = match self.phase {
                    Phase::Opening => self.poll_single(now, Body::Hello(self.hello.clone()), "header")?,
                    Phase::Streaming => self.poll_data(now)?,
                    Phase::Closing => {
                        self.poll_single(now, Body::End { n_frames: self.hello.n_frames() }, "end")?
                    }
                    Phase::Done | Phase::Failed(_) => return None,
                };
                Packet { session: self.session, body }
            }
        };
        self.counts.packets += 1;
        Some(packet.encode())
    }

    /// When [`poll_transmit`](Self::poll_transmit) must be called next, even if nothing comes in; `None` once there is an outcome.
    #[must_use]
    pub fn next_deadline(&self) -> Option<Duration> {
        if !self.replies.is_empty() {
            return Some(self.last_heard);
        }
        let silence = self.last_heard.saturating_add(self.settings.max_silence);
        let work = match self.phase {
            Phase::Done | Phase::Failed(_) => return None,
            Phase::Opening | Phase::Closing => self.single_due(),
            Phase::Streaming => {
                let repeats =
                    self.in_flight.iter().filter(|f| !f.acknowledged).map(|f| self.repeat_due(f)).min();
                let fresh = self.next_fresh().map(|sequence| self.available_at(sequence));
                [repeats, fresh].into_iter().flatten().min().unwrap_or(silence)
            }
        };
        Some(work.min(silence))
    }

    fn notice_silence(&mut self, now: Duration) {
        let phase = match self.phase {
            Phase::Opening => SilentPhase::Opening,
            Phase::Streaming => SilentPhase::Streaming,
            Phase::Closing => SilentPhase::Closing,
            Phase::Done | Phase::Failed(_) => return,
        };
        if now >= self.last_heard.saturating_add(self.settings.max_silence) {
            self.phase = Phase::Failed(Error::PeerSilent { after: self.settings.max_silence, phase });
        }
    }

    fn handle_ack(&mut self, now: Duration, ack: Ack) {
        let next_unsent = self.base + self.in_flight.len() as u32;
        let acknowledges = |sequence: u32| {
            sequence < ack.next_expected
                || ack.bitmap.checked_shr(sequence - ack.next_expected).is_some_and(|bits| bits & 1 == 1)
        };
        if ack.next_expected > next_unsent {
            self.received.malformed += 1;
            return;
        }
        if self.phase == Phase::Opening {
            self.phase = Phase::Streaming;
            self.opened_at = now;
            if self.single.tries == 1 {
                self.round_trip.measure(now.saturating_sub(self.single.sent_at));
            }
            return;
        }
        let mut newest_sample = None;
        for (sequence, frame) in (self.base..).zip(&mut self.in_flight) {
            if !frame.acknowledged && acknowledges(sequence) {
                frame.acknowledged = true;
                if frame.tries == 1 {
                    newest_sample = Some(now.saturating_sub(frame.sent_at));
                }
            }
        }
        if let Some(round_trip) = newest_sample {
            self.round_trip.measure(round_trip);
        }
        // Only what was handed on leaves the window: a slow application stops the sender.
        while self.base < ack.next_expected {
            self.in_flight.pop_front();
            self.base += 1;
        }
        let mut later_acknowledged = 0;
        for frame in self.in_flight.iter_mut().rev() {
            if frame.acknowledged {
                later_acknowledged += 1;
            } else if later_acknowledged >= FAST_REPEAT_AFTER && frame.tries == 1 {
                frame.repeat_now = true;
            }
        }
        if self.phase == Phase::Streaming && self.base == self.hello.n_frames() {
            self.phase = Phase::Closing;
            self.single = Single::default();
        }
    }

    fn handle_verdict(&mut self, status: EndStatus) {
        if self.phase != Phase::Closing {
            self.received.malformed += 1;
            return;
        }
        self.reply(Body::EndAck(status));
        self.phase = match status {
            EndStatus::Complete => Phase::Done,
            EndStatus::HashMismatch => Phase::Failed(Error::HashMismatch {
                expected: self.hello.header().sha256(),
                received: crate::Sha256Digest::of(&self.samples),
            }),
        };
    }

    fn reply(&mut self, body: Body) {
        if self.replies.len() < MAX_REPLIES {
            self.replies.push_back(Packet { session: self.session, body });
        }
    }

    fn single_due(&self) -> Duration {
        match self.single.tries {
            0 => Duration::ZERO,
            tries => self.single.sent_at + self.round_trip.timeout(tries),
        }
    }

    fn poll_single(&mut self, now: Duration, body: Body, what: &'static str) -> Option<Body> {
        if now < self.single_due() {
            return None;
        }
        if self.single.tries == self.settings.max_tries {
            let tries = self.single.tries;
            self.phase = Phase::Failed(Error::Unacknowledged { what, sequence: None, tries });
            return None;
        }
        self.single = Single { sent_at: now, tries: self.single.tries + 1 };
        Some(body)
    }

    fn poll_data(&mut self, now: Duration) -> Option<Body> {
        if let Some(idx) = self.in_flight.iter().position(|f| !f.acknowledged && now >= self.repeat_due(f)) {
            let sequence = self.base + idx as u32;
            let frame = &mut self.in_flight[idx];
            if frame.tries == self.settings.max_tries {
                let tries = frame.tries;
                self.phase =
                    Phase::Failed(Error::Unacknowledged { what: "data", sequence: Some(sequence), tries });
                return None;
            }
            frame.tries += 1;
            frame.sent_at = now;
            frame.repeat_now = false;
            self.counts.repeated += 1;
            return Some(self.data(sequence, now, true));
        }
        let sequence = self.next_fresh()?;
        if now < self.available_at(sequence) {
            return None;
        }
        self.in_flight.push_back(InFlight { sent_at: now, tries: 1, acknowledged: false, repeat_now: false });
        self.counts.data += 1;
        Some(self.data(sequence, now, false))
    }

    fn repeat_due(&self, frame: &InFlight) -> Duration {
        if frame.repeat_now { Duration::ZERO } else { frame.sent_at + self.round_trip.timeout(frame.tries) }
    }

    /// The next packet that was never sent, if the window has room for it.
    fn next_fresh(&self) -> Option<u32> {
        let sequence = self.base + self.in_flight.len() as u32;
        (self.in_flight.len() < self.settings.window && sequence < self.hello.n_frames()).then_some(sequence)
    }

    /// When the last sample of a packet exists.
    fn available_at(&self, sequence: u32) -> Duration {
        match self.settings.pace {
            Pace::AsFastAsPossible => Duration::ZERO,
            Pace::RealTime => {
                let last_sample =
                    self.hello.first_sample(sequence) + self.hello.n_samples(sequence) as u64 - 1;
                let after_s = last_sample as f64 / self.hello.header().sample_rate_hz();
                self.opened_at.saturating_add(Duration::try_from_secs_f64(after_s).unwrap_or(Duration::MAX))
            }
        }
    }

    fn data(&self, sequence: u32, now: Duration, sent_before: bool) -> Body {
        let first_sample = self.hello.first_sample(sequence);
        let first_idx = first_sample as usize;
        let samples = self.samples[first_idx..first_idx + self.hello.n_samples(sequence)].to_vec();
        let data = Data::new(sequence, first_sample, nanoseconds(now), sent_before, samples);
        Body::Data(data.expect("`Hello` bounds the samples of a packet to 1..=128"))
    }
}

/// Nanoseconds of a clock that began with the program; wraps after 584 years.
pub(crate) fn nanoseconds(now: Duration) -> u64 {
    now.as_nanos() as u64
}

/// 20 ms of signal when in real time, so that packing adds less delay than a play-out buffer holds.
fn default_frame(pace: Pace, sample_rate_hz: f64) -> usize {
    match pace {
        Pace::AsFastAsPossible => crate::MAX_SAMPLES_PER_FRAME,
        Pace::RealTime => (sample_rate_hz * 0.02).clamp(1.0, crate::MAX_SAMPLES_PER_FRAME as f64) as usize,
    }
}
