//! A sender and a receiver, first over a simulated network in virtual time, then over a real socket.
#![allow(clippy::unwrap_used)]

mod endpoints;
mod loopback;
mod network;
