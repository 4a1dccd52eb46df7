//! `telepulse membrane failure`: what ends the membrane of a case, and how far its state is from that.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use serde::Serialize;
use telepulse_actuator::Error;
use telepulse_actuator::failure::{
    Envelope, FailureMap, SafetyFactors, StateMargins, SupervisorLimits, VoltageLimit,
};
use telepulse_actuator::statics::{Electrodes, Load};

use super::super::{Verdict, answer, notify};
use super::case::Case;
use super::figures;
use super::judged::{Grid, StatedCriteria};

#[derive(Debug, Args)]
pub(super) struct FailureArguments {
    /// Case as JSON; `-` for standard input. docs/manual/membrane.md lists the keys.
    file: PathBuf,
    /// Folder for the failure map as SVG.
    #[arg(long, value_name = "DIR")]
    figures: Option<PathBuf>,
}

#[derive(Debug, Serialize)]
struct Failure {
    criteria: StatedCriteria,
    /// The state of the case.
    state: StateMargins,
    /// Dead load of the limits: the case's own, or the force at its displacement without voltage.
    dead_load_n: f64,
    /// Voltages at which something sets in under it.
    voltage_limits: Vec<VoltageLimit>,
    /// The lowest of them.
    first: Option<VoltageLimit>,
    supervisor: Option<SupervisorLimits>,
    map: FailureMap,
}

/// Points where the case names no axis.
const LOADS: usize = 19;
const VOLTAGES: usize = 23;

pub(super) fn run(typed: &FailureArguments, json: bool) -> Result<Verdict> {
    let case = Case::read(&typed.file)?;
    if !case.unread.is_empty() {
        notify(&format!("telepulse: keys without a meaning here: {}", case.unread.join(", ")));
    }
    let found = judge(&case)?;
    if let Some(folder) = &typed.figures {
        figures::write(folder, &[figures::failure(&found.map, &case.criteria, &found.state)])?;
    }
    answer(json, &found, || lines(&found))?;
    Ok(Verdict::Done)
}

fn judge(case: &Case) -> Result<Failure> {
    let explain = |error: Error| case.explain(error);
    let mut envelope = Envelope::new(&case.sheet, case.criteria)?;
    let state = envelope.at(case.load, case.electrodes).map_err(explain)?;
    case.require_left(&state.margins)?;
    let dead_load_n = match case.load {
        Load::ForceN(force_n) => force_n,
        Load::DisplacementM(_) => envelope.at(case.load, Electrodes::VoltageV(0.0)).map_err(explain)?.force_n,
    };
    let limits = envelope.voltage_limits(dead_load_n).map_err(explain)?;
    let supervisor = match envelope.supervisor_limits(dead_load_n, SafetyFactors::default()) {
        Ok(limits) => Some(limits),
        Err(Error::NoVoltageBorne { .. }) => None,
        Err(error) => return Err(explain(error)),
    };
    let loads = case.grids.force_n.unwrap_or(Grid::new(
        dead_load_n - 0.8 * dead_load_n.abs().max(1e-3),
        dead_load_n + dead_load_n.abs().max(1e-3),
        LOADS,
    ));
    let highest = limits.limits.iter().filter_map(|limit| limit.voltage_v).fold(0.0, f64::max);
    let voltages = case.grids.voltage_v.unwrap_or(Grid::new(0.0, 1.1 * highest.max(1.0), VOLTAGES));
    let map = envelope.map(&loads.values(), &voltages.values()).map_err(explain)?;
    Ok(Failure {
        criteria: StatedCriteria::of(&case.criteria),
        state,
        dead_load_n,
        first: limits.first(),
        voltage_limits: limits.limits,
        supervisor,
        map,
    })
}

fn lines(found: &Failure) -> Vec<String> {
    let doubt = |unverified: bool| if unverified { "  [limit not verified against its source]" } else { "" };
    let state = &found.state;
    let mut lines = vec![format!(
        "state         {} mm, {} N, {} V",
        state.displacement_m * 1e3,
        state.force_n,
        state.voltage_v
    )];
    lines.extend(state.margins.iter().map(|margin| {
        format!(
            "{:<22}{:.1} % left: {} of {} {}{}",
            margin.mechanism.words(),
            100.0 * margin.left,
            margin.value,
            margin.limit,
            margin.unit,
            doubt(margin.unverified)
        )
    }));
    lines.push(format!("under a dead load of {} N", found.dead_load_n));
    lines.extend(found.voltage_limits.iter().map(|limit| {
        let voltage =
            limit.voltage_v.map_or_else(|| "not before the path ends".to_owned(), |v| format!("at {v} V"));
        format!("{:<22}{voltage}{}", limit.mechanism.words(), doubt(limit.unverified))
    }));
    if let Some(limits) = &found.supervisor {
        lines.push(format!(
            "supervisor    at most {} V ({} at {} V){}",
            limits.max_v,
            limits.limited_by.words(),
            limits.first_failure_v,
            limits.slew_v_per_s.map_or_else(String::new, |slew| format!(", {slew} V/s"))
        ));
    }
    lines
}
