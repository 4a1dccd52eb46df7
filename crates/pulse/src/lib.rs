//! The body signal: recordings and their formats, resampling, spectrum, synthesis, beats, calibration and the
//! fidelity of a replay.
//!
//! Everything works on plain slices and on [`PulseRecording`], a checked, uniformly sampled channel with its
//! unit and its origin.
//!
//! Absent here: control, network, clocks. Only [`formats`] sees bytes, and it sees them through `Read` and
//! `Write`; nothing opens a file.

pub mod beats;
pub mod calibration;
pub mod error;
pub mod fidelity;
pub mod formats;
pub mod recording;
pub mod resample;
pub mod spectrum;
pub mod synth;

pub use error::Error;
pub use recording::{Provenance, PulseRecording, SignalKind, Unit};
