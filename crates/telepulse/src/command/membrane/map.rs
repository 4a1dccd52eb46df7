//! `telepulse membrane map`: F(x, V) and C(x, V) with their derivatives on a grid.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use serde::Serialize;
use telepulse_actuator::Error;
use telepulse_actuator::failure::Envelope;
use telepulse_actuator::statics::{Electrodes, Load, Solution, StaticSolver, solve};

use super::super::{Verdict, answer, notify};
use super::case::{Case, said};
use super::figures;
use super::judged::Grid;

#[derive(Debug, Args)]
pub(super) struct MapArguments {
    /// Case as JSON; `-` for standard input. docs/manual/membrane.md lists the keys.
    file: PathBuf,
    /// Folder for figures as SVG: shape, fields along the radius, and the map.
    #[arg(long, value_name = "DIR")]
    figures: Option<PathBuf>,
}

/// Rows are displacements, columns voltages; null where the membrane has no taut state.
#[derive(Debug, Serialize)]
pub(super) struct StaticMap {
    pub(super) displacement_m: Vec<f64>,
    pub(super) voltage_v: Vec<f64>,
    pub(super) force_n: Vec<Vec<Option<f64>>>,
    capacitance_f: Vec<Vec<Option<f64>>>,
    stiffness_n_per_m: Vec<Vec<Option<f64>>>,
    dforce_dvoltage_n_per_v: Vec<Vec<Option<f64>>>,
    dcapacitance_dx_f_per_m: Vec<Vec<Option<f64>>>,
    s2_min_pa: Vec<Vec<Option<f64>>>,
    field_max_v_per_m: Vec<Vec<Option<f64>>>,
    refused: Vec<Refusal>,
}

#[derive(Debug, Serialize)]
struct Refusal {
    displacement_m: f64,
    voltage_v: f64,
    reason: String,
}

/// Points where the case names no axis.
const DISPLACEMENTS: usize = 13;
const VOLTAGES: usize = 6;
/// Part of the first limit up to which voltages go where neither axis nor state names one.
const REACH: f64 = 0.9;

pub(super) fn run(typed: &MapArguments, json: bool) -> Result<Verdict> {
    let case = Case::read(&typed.file)?;
    if !case.unread.is_empty() {
        notify(&format!("telepulse: keys without a meaning here: {}", case.unread.join(", ")));
    }
    let at = solve(&case.sheet, case.load, case.electrodes).map_err(|error| case.explain(error))?;
    let found = grid(&case, &at)?;
    if let Some(folder) = &typed.figures {
        let shapes = states(&case, &found.voltage_v)?;
        figures::write(
            folder,
            &[figures::shape(&case.sheet, &shapes), figures::fields(&shapes), figures::map(&found)],
        )?;
    }
    answer(json, &found, || lines(&found))?;
    Ok(Verdict::Done)
}

/// The map on the case's axes, or on axes about its state.
fn grid(case: &Case, at: &Solution) -> Result<StaticMap> {
    let x = at.point.displacement_m;
    let reach = if x.abs() > 0.0 { x.abs() } else { 0.1 * case.sheet.length_scale_m() };
    let displacements =
        case.grids.displacement_m.unwrap_or(Grid::new(x - 0.75 * reach, x + 0.75 * reach, DISPLACEMENTS));
    let voltages = match case.grids.voltage_v {
        Some(voltages) => voltages,
        None if at.point.voltage_v > 0.0 => Grid::new(0.0, at.point.voltage_v, VOLTAGES),
        None => {
            let limits = Envelope::new(&case.sheet, case.criteria)?
                .voltage_limits(at.point.force_n)
                .map_err(|error| case.explain(error))?;
            let first = limits.first().and_then(|limit| limit.voltage_v).filter(|v| *v > 0.0);
            Grid::new(0.0, first.map_or(1000.0, |v| REACH * v), VOLTAGES)
        }
    };
    let mut map = StaticMap {
        displacement_m: displacements.values(),
        voltage_v: voltages.values(),
        force_n: Vec::new(),
        capacitance_f: Vec::new(),
        stiffness_n_per_m: Vec::new(),
        dforce_dvoltage_n_per_v: Vec::new(),
        dcapacitance_dx_f_per_m: Vec::new(),
        s2_min_pa: Vec::new(),
        field_max_v_per_m: Vec::new(),
        refused: Vec::new(),
    };
    let mut solver = StaticSolver::with_degree(&case.sheet, at.profile.r_m.len() - 1)?;
    for displacement_m in map.displacement_m.clone() {
        let mut row: [Vec<Option<f64>>; 7] = Default::default();
        for &voltage_v in &map.voltage_v {
            let point = match point(&mut solver, displacement_m, voltage_v) {
                Ok(values) => values.map(Some),
                Err(error) => {
                    map.refused.push(Refusal { displacement_m, voltage_v, reason: said(&error) });
                    [None; 7]
                }
            };
            for (values, value) in row.iter_mut().zip(point) {
                values.push(value);
            }
        }
        let [force, capacitance, stiffness, by_voltage, by_x, tension, field] = row;
        map.force_n.push(force);
        map.capacitance_f.push(capacitance);
        map.stiffness_n_per_m.push(stiffness);
        map.dforce_dvoltage_n_per_v.push(by_voltage);
        map.dcapacitance_dx_f_per_m.push(by_x);
        map.s2_min_pa.push(tension);
        map.field_max_v_per_m.push(field);
    }
    Ok(map)
}

fn point(solver: &mut StaticSolver, displacement_m: f64, voltage_v: f64) -> Result<[f64; 7], Error> {
    let found = solver.solve_near(Load::DisplacementM(displacement_m), Electrodes::VoltageV(voltage_v))?;
    let derivatives = solver.derivatives()?;
    Ok([
        found.force_n,
        found.capacitance_f,
        derivatives.stiffness_n_per_m,
        derivatives.dforce_dvoltage_n_per_v,
        derivatives.dcapacitance_dx_f_per_m,
        found.s2_min_pa,
        found.field_max_v_per_m,
    ])
}

/// States of the case's own load at no voltage, half and all of the largest voltage.
fn states(case: &Case, voltage_v: &[f64]) -> Result<Vec<Solution>> {
    let largest = voltage_v.iter().copied().fold(0.0, f64::max);
    [0.0, 0.5 * largest, largest]
        .into_iter()
        .map(|voltage| {
            solve(&case.sheet, case.load, Electrodes::VoltageV(voltage)).map_err(|error| case.explain(error))
        })
        .collect()
}

fn lines(found: &StaticMap) -> Vec<String> {
    let mut lines = vec!["displacement_mm voltage_v force_n capacitance_nf stiffness_n_per_m".to_owned()];
    for (row, x) in found.displacement_m.iter().enumerate() {
        for (column, voltage) in found.voltage_v.iter().enumerate() {
            let shown = |values: &[Vec<Option<f64>>], scale: f64| {
                values[row][column].map_or_else(|| "-".to_owned(), |value| (value * scale).to_string())
            };
            lines.push(format!(
                "{} {voltage} {} {} {}",
                x * 1e3,
                shown(&found.force_n, 1.0),
                shown(&found.capacitance_f, 1e9),
                shown(&found.stiffness_n_per_m, 1.0)
            ));
        }
    }
    lines.extend(
        found
            .refused
            .iter()
            .map(|r| format!("{} mm, {} V: {}", r.displacement_m * 1e3, r.voltage_v, r.reason)),
    );
    lines
}
