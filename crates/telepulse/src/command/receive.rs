//! `telepulse receive --out DIR`: the doctor's side.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;

use super::{Verdict, answer};
use crate::station::doctor::{self, Order};

#[derive(Debug, Args)]
pub(super) struct ReceiveArguments {
    /// Address and port to listen on; port 0 lets the system choose. The choice is printed on standard error.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:0")]
    listen: String,
    /// Folder for received.csv, session.jsonl and, with --study, replay.json.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Replay what arrives on the virtual rig of this study, with the recipes of --recipes.
    #[arg(long, value_name = "DIR", requires = "recipes")]
    study: Option<PathBuf>,
    /// Folder with recipes such as best.displacement.recipe.json.
    #[arg(long, value_name = "DIR", requires = "study")]
    recipes: Option<PathBuf>,
    /// Give up after this many seconds, the wait for the sender included.
    #[arg(long, value_name = "S", default_value_t = 60.0, allow_negative_numbers = true)]
    timeout_s: f64,
}

pub(super) fn run(typed: &ReceiveArguments, json: bool) -> Result<Verdict> {
    anyhow::ensure!(
        typed.timeout_s > 0.0 && typed.timeout_s <= 86_400.0,
        "`--timeout-s`: found {}, allowed above 0 to 86400",
        typed.timeout_s
    );
    let order = Order {
        listen: typed.listen.clone(),
        out: typed.out.clone(),
        replay: typed.study.clone().zip(typed.recipes.clone()),
        timeout_s: typed.timeout_s,
    };
    let received =
        doctor::receive(&order, &mut |address| super::notify(&format!("{}{address}", doctor::LISTENING)))
            .with_context(|| format!("receiving on {}", typed.listen))?;
    answer(json, &received, || {
        let mut lines = vec![format!(
            "received {} of {} samples of {} at {} Hz from {}, bit exact: {}",
            received.received,
            received.sent,
            received.unit,
            received.sample_rate_hz,
            received.peer,
            received.bit_exact
        )];
        for replayed in &received.replays {
            lines.push(super::replay::line(replayed));
        }
        lines
    })?;
    Ok(if received.bit_exact { Verdict::Done } else { Verdict::CheckFailed })
}
