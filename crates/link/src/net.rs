//! The transport: the two state machines on UDP sockets, with a real clock. Both calls block until done, failed or out of time.

use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::{ErrorKind, Write};
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs, UdpSocket};
use std::time::{Duration, Instant};

use crate::record::{LogSummary, LogWriter};
use crate::{
    Delivered, Error, Handled, Hello, PacketCounts, Receiver, ReceiverEvent, ReceiverSettings, SendCounts,
    Sender, SenderSettings, StreamHeader,
};

/// No datagram is longer; with a shorter buffer some systems report an error for a stranger's long one.
const BUFFER_BYTES: usize = 65_536;
/// Shortest wait on a socket: zero would mean "for ever".
const MIN_WAIT: Duration = Duration::from_micros(100);
/// Longest wait on a socket without looking at the clock.
const MAX_WAIT: Duration = Duration::from_millis(100);

/// How far a transmission is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// Samples acknowledged so far.
    pub samples: u64,
    /// Samples of the stream.
    pub n_samples: u64,
}

/// How [`send`] behaves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SendOptions {
    /// Pace, window and timeouts.
    pub sender: SenderSettings,
    /// Longest time for everything.
    pub total_timeout: Duration,
}

impl Default for SendOptions {
    /// As fast as possible, within 60 s.
    fn default() -> Self {
        Self { sender: SenderSettings::default(), total_timeout: Duration::from_secs(60) }
    }
}

/// What [`send`] did.
#[derive(Debug, Clone, PartialEq)]
pub struct SendReport {
    /// The session number it drew.
    pub session: u64,
    /// Samples that the receiver confirmed, with their hash.
    pub n_samples: u64,
    /// Data packets of the stream.
    pub n_frames: u32,
    /// Packets sent.
    pub counts: SendCounts,
    /// Packets that came back.
    pub received: PacketCounts,
    /// Smoothed round-trip time, if one was measured.
    pub round_trip: Option<Duration>,
    /// Time for everything.
    pub elapsed: Duration,
}

/// Sends `samples` to `address` and returns when the receiver has confirmed all of them and their hash.
///
/// `progress` is called whenever more samples were acknowledged.
///
/// # Errors
/// The error of the stream ([`Error::PeerSilent`], [`Error::Rejected`], …), [`Error::Timeout`], or [`Error::Io`] for the socket.
pub fn send(
    address: impl ToSocketAddrs,
    header: &StreamHeader,
    samples: &[f64],
    options: &SendOptions,
    progress: &mut dyn FnMut(Progress),
) -> Result<SendReport, Error> {
    let address = resolve(address)?;
    let any: SocketAddr =
        if address.is_ipv4() { (Ipv4Addr::UNSPECIFIED, 0).into() } else { (Ipv6Addr::UNSPECIFIED, 0).into() };
    let socket = UdpSocket::bind(any).map_err(|error| Error::io("open a socket", &error))?;
    socket.connect(address).map_err(|error| Error::io("connect the socket", &error))?;
    let clock = Instant::now();
    let mut sender =
        Sender::new(header.clone(), samples.to_vec(), random_session(), options.sender, Duration::ZERO)?;
    let mut buffer = vec![0; BUFFER_BYTES];
    let mut reported = 0;
    loop {
        let now = clock.elapsed();
        while let Some(packet) = sender.poll_transmit(now) {
            tolerate(socket.send(&packet))?;
        }
        let samples = sender.acknowledged_samples();
        if samples > reported {
            reported = samples;
            progress(Progress { samples, n_samples: header.n_samples() });
        }
        match sender.outcome() {
            Some(Ok(())) => break,
            Some(Err(error)) => return Err(error),
            None => {}
        }
        let Some(left) = options.total_timeout.checked_sub(now) else {
            let (allowed, n_samples) = (options.total_timeout, header.n_samples());
            return Err(Error::Timeout { allowed, samples, n_samples });
        };
        wait_at_most(&socket, sender.next_deadline(), now, left)?;
        if let Some(n_bytes) = tolerate(socket.recv(&mut buffer))? {
            sender.handle(clock.elapsed(), &buffer[..n_bytes]);
        }
    }
    Ok(SendReport {
        session: sender.session(),
        n_samples: header.n_samples(),
        n_frames: sender.hello().n_frames(),
        counts: sender.counts(),
        received: sender.received(),
        round_trip: sender.round_trip().smoothed(),
        elapsed: clock.elapsed(),
    })
}

/// How [`Listener::receive`] behaves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReceiveOptions {
    /// Limits of the stream.
    pub receiver: ReceiverSettings,
    /// Longest time for everything, the wait for the sender included.
    pub total_timeout: Duration,
}

impl Default for ReceiveOptions {
    /// Within 60 s.
    fn default() -> Self {
        Self { receiver: ReceiverSettings::default(), total_timeout: Duration::from_secs(60) }
    }
}

/// Samples that have just been handed on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrived<'a> {
    /// The stream they belong to.
    pub header: &'a StreamHeader,
    /// The samples of one packet, in order.
    pub delivered: &'a Delivered,
    /// Samples so far, these included.
    pub samples: u64,
}

/// A stream that arrived completely; its hash is the announced one.
#[derive(Debug, Clone, PartialEq)]
pub struct ReceivedStream {
    /// What the sender announced.
    pub header: StreamHeader,
    /// The samples, bit for bit.
    pub samples: Vec<f64>,
    /// The session number.
    pub session: u64,
    /// Address of the sender.
    pub peer: SocketAddr,
    /// The last line of the session log.
    pub summary: LogSummary,
}

/// A socket on which one stream at a time can arrive.
#[derive(Debug)]
pub struct Listener {
    socket: UdpSocket,
}

impl Listener {
    /// Opens a socket at `address`; port 0 lets the system choose, see [`local_addr`](Self::local_addr).
    ///
    /// # Errors
    /// [`Error::Io`] when the address is not free or not of this machine.
    pub fn bind(address: impl ToSocketAddrs) -> Result<Self, Error> {
        let socket = UdpSocket::bind(address).map_err(|error| Error::io("open a socket", &error))?;
        Ok(Self { socket })
    }

    /// The address to send to.
    ///
    /// # Errors
    /// [`Error::Io`] when the system does not tell.
    pub fn local_addr(&self) -> Result<SocketAddr, Error> {
        self.socket.local_addr().map_err(|error| Error::io("read the socket's address", &error))
    }

    /// Waits for a stream and returns when all of it is there.
    ///
    /// The session log goes to `log` line by line, with a summary even when the stream fails. `arrived` is called for each packet's samples
    /// in order, at once: this is where a live play-out buffer is fed.
    ///
    /// # Errors
    /// [`Error::NoStream`], [`Error::PeerSilent`], [`Error::HashMismatch`], [`Error::Timeout`], or [`Error::Io`] for socket and log.
    pub fn receive(
        &self,
        options: &ReceiveOptions,
        log: &mut dyn Write,
        arrived: &mut dyn FnMut(Arrived<'_>),
    ) -> Result<ReceivedStream, Error> {
        let clock = Instant::now();
        let mut receiver = Receiver::new(options.receiver);
        let mut intake = Intake { out: Some(log), open: None, outcome: None };
        let mut peer = None;
        let mut buffer = vec![0; BUFFER_BYTES];
        while !receiver.is_closed() {
            let now = clock.elapsed();
            while let (Some(packet), Some(peer)) = (receiver.poll_transmit(now), peer) {
                tolerate(self.socket.send_to(&packet, peer))?;
            }
            while let Some(event) = receiver.poll_event() {
                intake.take(event, peer, arrived)?;
            }
            let Some(left) = options.total_timeout.checked_sub(now) else { break };
            wait_at_most(&self.socket, receiver.next_deadline(), now, left)?;
            let Some((n_bytes, from)) = tolerate(self.socket.recv_from(&mut buffer))? else { continue };
            let stranger = peer.is_some_and(|peer| peer != from);
            let handled = if stranger {
                receiver.handle_stranger(&buffer[..n_bytes])
            } else {
                receiver.handle(clock.elapsed(), &buffer[..n_bytes])
            };
            match handled {
                Handled::Accepted => peer = Some(from),
                Handled::Ignored => {}
                Handled::Refused(reply) => {
                    tolerate(self.socket.send_to(&reply, from))?;
                }
            }
        }
        intake.close(&receiver, options.total_timeout)
    }
}

/// What [`Listener::receive`] has in hand.
struct Intake<'a> {
    /// Where the log goes; taken when a stream opens.
    out: Option<&'a mut dyn Write>,
    open: Option<Open<'a>>,
    /// Set by the last event.
    outcome: Option<Result<(), Error>>,
}

struct Open<'a> {
    session: u64,
    peer: SocketAddr,
    hello: Hello,
    samples: Vec<f64>,
    log: LogWriter<&'a mut dyn Write>,
}

impl Intake<'_> {
    fn take(
        &mut self,
        event: ReceiverEvent,
        from: Option<SocketAddr>,
        arrived: &mut dyn FnMut(Arrived<'_>),
    ) -> Result<(), Error> {
        match (event, &mut self.open) {
            (ReceiverEvent::Opened { session, hello }, None) => {
                if let (Some(peer), Some(out)) = (from, self.out.take()) {
                    let log = LogWriter::new(out, session, &peer.to_string(), &hello)?;
                    self.open = Some(Open { session, peer, hello, samples: Vec::new(), log });
                }
            }
            (ReceiverEvent::Delivered(delivered), Some(open)) => {
                open.log.frame(&delivered)?;
                open.samples.extend_from_slice(&delivered.samples);
                let (header, samples) = (open.hello.header(), open.samples.len() as u64);
                arrived(Arrived { header, delivered: &delivered, samples });
            }
            (ReceiverEvent::Finished(outcome), Some(_)) => self.outcome = Some(outcome),
            // The receiver opens once, and delivers only after that.
            (ReceiverEvent::Opened { .. }, Some(_)) | (_, None) => {}
        }
        Ok(())
    }

    /// Writes the summary and turns everything into the result.
    fn close(self, receiver: &Receiver, allowed: Duration) -> Result<ReceivedStream, Error> {
        let counts = receiver.counts();
        let Some(Open { session, peer, hello, samples, log }) = self.open else {
            let (corrupted, wrong_version) = (counts.corrupted + counts.truncated, counts.wrong_version);
            let foreign = counts.foreign + counts.foreign_session;
            return Err(Error::NoStream { allowed, corrupted, wrong_version, foreign });
        };
        let header = hello.header().clone();
        let outcome = self.outcome.unwrap_or_else(|| {
            let (n_arrived, n_samples) = (samples.len() as u64, header.n_samples());
            Err(Error::Timeout { allowed, samples: n_arrived, n_samples })
        });
        let summary = log.finish(counts, receiver.clock(), outcome.as_ref().err())?;
        outcome.map(|()| ReceivedStream { header, samples, session, peer, summary })
    }
}

fn resolve(address: impl ToSocketAddrs) -> Result<SocketAddr, Error> {
    let mut addresses =
        address.to_socket_addrs().map_err(|error| Error::io("resolve the address", &error))?;
    let none = || std::io::Error::new(ErrorKind::NotFound, "the name has no address");
    addresses.next().ok_or_else(|| Error::io("resolve the address", &none()))
}

/// A number nobody else has drawn: the standard library seeds its hash maps from the system's random source.
fn random_session() -> u64 {
    RandomState::new().build_hasher().finish()
}

fn wait_at_most(
    socket: &UdpSocket,
    deadline: Option<Duration>,
    now: Duration,
    left: Duration,
) -> Result<(), Error> {
    let wait = deadline.map_or(MAX_WAIT, |deadline| deadline.saturating_sub(now));
    let wait = wait.min(left).clamp(MIN_WAIT, MAX_WAIT);
    socket.set_read_timeout(Some(wait)).map_err(|error| Error::io("set the socket's timeout", &error))
}

/// Separates what UDP does in normal operation from failures. A refused or unreachable peer may come up later; the protocol's own timeouts
/// decide how long to try.
fn tolerate<T>(result: std::io::Result<T>) -> Result<Option<T>, Error> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(error) => match error.kind() {
            ErrorKind::WouldBlock
            | ErrorKind::TimedOut
            | ErrorKind::Interrupted
            | ErrorKind::ConnectionRefused
            | ErrorKind::ConnectionReset
            | ErrorKind::HostUnreachable
            | ErrorKind::NetworkUnreachable => Ok(None),
            _ => Err(Error::io("use the socket", &error)),
        },
    }
}
