//! `telepulse send FILE --to ADDRESS`: the patient's side.

use std::net::ToSocketAddrs;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use clap::Args;
use serde::Serialize;
use telepulse_link::net::{SendOptions, send};
use telepulse_link::{Pace, SenderSettings, StreamHeader};
use telepulse_pulse::Unit;

use super::{Verdict, answer};
use crate::recording;

#[derive(Debug, Args)]
pub(super) struct SendArguments {
    /// CSV with the columns time_s,value,unit.
    file: PathBuf,
    /// Address and port of the doctor's side, such as 127.0.0.1:47000.
    #[arg(long, value_name = "ADDRESS")]
    to: String,
    /// Scale the pulse to this peak-to-peak pressure and send it in Pa above its minimum.
    #[arg(long, value_name = "PA", allow_negative_numbers = true)]
    peak_to_peak_pa: Option<f64>,
    /// Send each sample at its own time instead of as fast as the link takes it.
    #[arg(long)]
    realtime: bool,
    /// Give up after this many seconds.
    #[arg(long, value_name = "S", default_value_t = 60.0, allow_negative_numbers = true)]
    timeout_s: f64,
}

/// What was sent.
#[derive(Debug, Serialize)]
struct Sent {
    session: String,
    samples: u64,
    frames: u32,
    retransmitted_frames: u64,
    unit: String,
    sample_rate_hz: f64,
    sha256: String,
    elapsed_s: f64,
}

pub(super) fn run(typed: &SendArguments, json: bool) -> Result<Verdict> {
    ensure!(
        typed.timeout_s > 0.0 && typed.timeout_s <= 86_400.0,
        "`--timeout-s`: found {}, allowed above 0 to 86400",
        typed.timeout_s
    );
    typed.to.to_socket_addrs().map(drop).with_context(|| {
        format!("`--to`: found {}, allowed an address with a port, such as 127.0.0.1:47000", typed.to)
    })?;
    let mut found = recording::read(&typed.file)?;
    if let Some(peak_to_peak_pa) = typed.peak_to_peak_pa {
        ensure!(
            peak_to_peak_pa > 0.0 && peak_to_peak_pa.is_finite(),
            "`--peak-to-peak-pa`: found {peak_to_peak_pa}, allowed above 0"
        );
        found = found
            .scaled_to_peak_to_peak(peak_to_peak_pa, Unit::Pascal)
            .with_context(|| format!("in {}", typed.file.display()))?;
    }
    let header =
        StreamHeader::describe(found.values(), found.unit().symbol(), &found.title, found.sample_rate_hz())?;
    let pace = if typed.realtime { Pace::RealTime } else { Pace::AsFastAsPossible };
    let options = SendOptions {
        sender: SenderSettings { pace, ..SenderSettings::default() },
        total_timeout: Duration::from_secs_f64(typed.timeout_s),
    };
    let report = send(typed.to.as_str(), &header, found.values(), &options, &mut |_| {})
        .with_context(|| format!("sending {} to {}", typed.file.display(), typed.to))?;
    let sent = Sent {
        session: format!("{:016x}", report.session),
        samples: report.n_samples,
        frames: report.n_frames,
        retransmitted_frames: report.counts.repeated,
        unit: found.unit().symbol().to_owned(),
        sample_rate_hz: found.sample_rate_hz(),
        sha256: header.sha256().to_string(),
        elapsed_s: report.elapsed.as_secs_f64(),
    };
    answer(json, &sent, || {
        vec![format!(
            "sent {} samples of {} at {} Hz in {} frames, {} of them again; SHA-256 {}",
            sent.samples, sent.unit, sent.sample_rate_hz, sent.frames, sent.retransmitted_frames, sent.sha256
        )]
    })?;
    Ok(Verdict::Done)
}
