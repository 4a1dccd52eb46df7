//! Patient to doctor: a recording crosses an unreliable network and arrives exactly once, in order, bit for bit, with a log that proves it.
//!
//! ```text
//! patient                                             doctor
//! send --> Sender ==== packets over UDP ====> Receiver --> samples --> PlayoutBuffer
//!            ^---- Ack, Pong <==> Ping -----------'  `--> LogWriter --> verify_log
//! ```
//! [`Sender`] and [`Receiver`] are state machines: bytes and the time go in; bytes, events and the next deadline come out. Sockets and
//! clocks live in [`net`], files in [`record`].
//!
//! **Limits**: nothing is encrypted or authenticated. Session numbers and checksums guard against accidents, not against an attacker: use a
//! trusted network or a tunnel. There is no congestion control beyond a fixed window of at most 64 packets.

mod clock_sync;
mod error;
mod frame;
pub mod net;
mod packet;
mod playout;
mod receiver;
pub mod record;
mod round_trip;
mod sender;
mod stream;

pub use clock_sync::{ClockEstimate, ClockSync};
pub use error::{Error, SilentPhase};
pub use packet::{
    Ack, Body, Data, EndStatus, Hello, MAX_PACKET_BYTES, MAX_SAMPLES_PER_FRAME, MAX_WINDOW, Packet,
    PacketFault, RejectReason, WIRE_VERSION,
};
pub use playout::{Playout, PlayoutBuffer, PlayoutSettings};
pub use receiver::{Delivered, Handled, Receiver, ReceiverEvent, ReceiverSettings};
pub use round_trip::RoundTrip;
pub use sender::{Pace, SendCounts, Sender, SenderSettings};
pub use stream::{PacketCounts, Sha256Digest, StreamHeader};
