//! Computes the H-infinity norm of every system in a JSON file and times it: one line of JSON per system.
//!
//! Usage: `norm_benchmark FILE.json [SECONDS]`. The file holds a list of objects with the keys `A`, `B`, `C`, `D` (rows of
//! numbers) and optionally `dt`. Each system is solved once and then, if `SECONDS` is given, again and again for that
//! long; `seconds` is the median over batches. `benches/versus_slycot_norm.py` compares the answers with a peer.

use std::time::Instant;

use nalgebra::DMatrix;
use serde_json::{Value, json};
use telepulse_lti::{Continuous, Discrete, Error, PeakGain, SampleTime, StateSpace, hinf_norm};

enum System {
    Continuous(StateSpace<Continuous>),
    Discrete(StateSpace<Discrete>),
}

impl System {
    fn norm(&self) -> Result<PeakGain, Error> {
        match self {
            Self::Continuous(sys) => hinf_norm(sys),
            Self::Discrete(sys) => hinf_norm(sys),
        }
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("usage: norm_benchmark FILE.json [SECONDS]")?;
    let budget: f64 = arguments.next().map_or(Ok(0.0), |text| text.parse())?;
    let systems: Vec<Value> = serde_json::from_str(&std::fs::read_to_string(path)?)?;
    let mut lines = String::new();
    for (index, value) in systems.iter().enumerate() {
        let sys = parse(value).map_err(|error| format!("system {index}: {error}"))?;
        let line = match sys.norm() {
            Ok(peak) => json!({
                "value": peak.value, "lower": peak.lower, "upper": peak.upper,
                "omega_rad_s": if peak.omega_rad_s.is_finite() { json!(peak.omega_rad_s) } else { json!(null) },
                "seconds": median_seconds(&sys, budget),
            }),
            Err(error) => json!({ "error": error.to_string() }),
        };
        lines.push_str(&line.to_string());
        lines.push('\n');
    }
    std::io::Write::write_all(&mut std::io::stdout().lock(), lines.as_bytes())?;
    Ok(())
}

/// Median over batches of the time of one call.
fn median_seconds(sys: &System, budget: f64) -> f64 {
    let start = Instant::now();
    let mut batches = Vec::new();
    let mut calls = 1_u32;
    while start.elapsed().as_secs_f64() < budget {
        let batch = Instant::now();
        for _ in 0..calls {
            std::hint::black_box(sys.norm()).ok();
        }
        let seconds = batch.elapsed().as_secs_f64();
        batches.push(seconds / f64::from(calls));
        if seconds < budget / 50.0 {
            calls *= 2;
        }
    }
    batches.sort_by(f64::total_cmp);
    batches.get(batches.len() / 2).copied().unwrap_or(0.0)
}

fn parse(value: &Value) -> Result<System, Box<dyn std::error::Error>> {
    let d = rows(&value["D"])?;
    let a = rows(&value["A"])?;
    let (n, n_y, n_u) = (a.len(), d.len(), d.first().map_or(0, Vec::len));
    let matrix = |rows: Vec<Vec<f64>>, n_rows: usize, n_cols: usize| {
        DMatrix::from_row_iterator(n_rows, n_cols, rows.into_iter().flatten().collect::<Vec<_>>())
    };
    let (b, c) = (matrix(rows(&value["B"])?, n, n_u), matrix(rows(&value["C"])?, n_y, n));
    let (a, d) = (matrix(a, n, n), matrix(d, n_y, n_u));
    match value["dt"].as_f64() {
        None => Ok(System::Continuous(StateSpace::<Continuous>::new(a, b, c, d)?)),
        Some(dt) => Ok(System::Discrete(StateSpace::<Discrete>::new(a, b, c, d, SampleTime::new(dt)?)?)),
    }
}

fn rows(value: &Value) -> Result<Vec<Vec<f64>>, Box<dyn std::error::Error>> {
    Ok(serde_json::from_value(value.clone())?)
}
