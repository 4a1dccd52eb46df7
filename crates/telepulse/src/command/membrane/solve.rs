//! `telepulse membrane solve`: one equilibrium from a case file.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use clap::Args;
use serde::Serialize;
use telepulse_actuator::failure::Envelope;
use telepulse_actuator::material::first_invariant;
use telepulse_actuator::statics::{Load, Material, Sheet, Solution, StaticSolver, solve};

use super::super::{Verdict, answer, notify};
use super::case::Case;

#[derive(Debug, Args)]
pub(super) struct SolveArguments {
    /// Case as JSON; `-` for standard input. docs/manual/membrane.md lists the keys.
    file: PathBuf,
}

#[derive(Debug, Serialize)]
struct Equilibrium {
    displacement_m: f64,
    force_n: f64,
    lambda1_inner: f64,
    lambda1_outer: f64,
    theta_inner: f64,
    theta_outer: f64,
    s1_inner_pa: f64,
    s2_min_pa: f64,
    capacitance_f: f64,
    stiffness_n_per_m: f64,
    dforce_dvoltage_n_per_v: f64,
    field_max_v_per_m: f64,
    /// Largest residual of the collocated equations over the shear modulus.
    residual: f64,
    margins: Margins,
}

/// Distance to what ends the model; a margin that is null does not apply.
#[derive(Debug, Serialize)]
struct Margins {
    /// Smallest nominal stress in either direction, Pa: zero where the membrane starts to wrinkle.
    tension_min_pa: f64,
    /// Smallest of ds1/dl1 and ds2/dl2, Pa: zero where the voltage thins the membrane without bound.
    modulus_min_pa: f64,
    /// Largest voltage that the dead load bears, V.
    limit_voltage_v: Option<f64>,
    /// Voltage over the limit voltage.
    voltage_over_limit: Option<f64>,
    /// Largest true field, V/m, to be compared with the material's breakdown strength.
    field_max_v_per_m: f64,
    /// Largest (I1 - 3)/J.
    chain_extension_max: Option<f64>,
}

pub(super) fn run(typed: &SolveArguments, json: bool) -> Result<Verdict> {
    let case = Case::read(&typed.file)?;
    if !case.unread.is_empty() {
        notify(&format!("telepulse: keys without a meaning here: {}", case.unread.join(", ")));
    }
    let found = solve(&case.sheet, case.load, case.electrodes).map_err(|error| case.explain(error))?;
    // A state that no degree resolves is no answer.
    ensure!(
        found.point.residual <= RESIDUAL_MAX,
        "in {}: keys `a_m` and `b_m`: the equations are met to {:e} of the shear modulus only, allowed is {RESIDUAL_MAX:e}: the \
         radii lie too far apart to be resolved",
        case.name,
        found.point.residual
    );
    if case.gives_criteria {
        let mut envelope = Envelope::new(&case.sheet, case.criteria)?;
        let judged = envelope.at(case.load, case.electrodes).map_err(|error| case.explain(error))?;
        case.require_left(&judged.margins)?;
    }
    let equilibrium = Equilibrium {
        displacement_m: found.point.displacement_m,
        force_n: found.point.force_n,
        lambda1_inner: found.lambda1_inner(),
        lambda1_outer: found.lambda1_outer(),
        theta_inner: found.theta_inner_rad(),
        theta_outer: found.theta_outer_rad(),
        s1_inner_pa: found.s1_inner_pa(),
        s2_min_pa: found.point.s2_min_pa,
        capacitance_f: found.point.capacitance_f,
        stiffness_n_per_m: found.derivatives.stiffness_n_per_m,
        dforce_dvoltage_n_per_v: found.derivatives.dforce_dvoltage_n_per_v,
        field_max_v_per_m: found.point.field_max_v_per_m,
        residual: found.point.residual,
        margins: margins(&case, &found),
    };
    answer(json, &equilibrium, || lines(&equilibrium))?;
    Ok(Verdict::Done)
}

/// Residuals of resolved states are below 1e-10; gold values are met to 1e-9 there.
const RESIDUAL_MAX: f64 = 1e-8;

fn margins(case: &Case, found: &Solution) -> Margins {
    let point = &found.point;
    // Only a dead load has a limit point; a material may also bear every voltage up to the search's end.
    let limit_voltage_v = match case.load {
        Load::ForceN(force_n) => limit_voltage(&case.sheet, force_n),
        Load::DisplacementM(_) => None,
    };
    let chain_extension_max = match case.sheet.spec().material {
        Material::Gent { limit, .. } => {
            let stretches = found.profile.lambda1.iter().zip(&found.profile.lambda2);
            Some(stretches.map(|(&l1, &l2)| (first_invariant(l1, l2) - 3.0) / limit).fold(0.0, f64::max))
        }
        _ => None,
    };
    Margins {
        tension_min_pa: point.s1_min_pa.min(point.s2_min_pa),
        modulus_min_pa: point.modulus_min_pa,
        limit_voltage_v,
        voltage_over_limit: limit_voltage_v.map(|limit| point.voltage_v / limit),
        field_max_v_per_m: point.field_max_v_per_m,
        chain_extension_max,
    }
}

fn limit_voltage(sheet: &Sheet, force_n: f64) -> Option<f64> {
    let mut solver = StaticSolver::new(sheet).ok()?;
    solver.limit_voltage(force_n).ok().map(|point| point.voltage_v)
}

fn lines(found: &Equilibrium) -> Vec<String> {
    let mut lines = vec![
        format!("displacement  {} mm", found.displacement_m * 1e3),
        format!("force         {} N", found.force_n),
        format!("stiffness     {} N/m", found.stiffness_n_per_m),
        format!("dF/dV         {} N/V", found.dforce_dvoltage_n_per_v),
        format!("capacitance   {} nF", found.capacitance_f * 1e9),
        format!(
            "at the plate  stretch {}, slope {} rad, stress {} Pa",
            found.lambda1_inner, found.theta_inner, found.s1_inner_pa
        ),
        format!("at the frame  stretch {}, slope {} rad", found.lambda1_outer, found.theta_outer),
        format!(
            "least hoop stress {} Pa, largest field {} MV/m",
            found.s2_min_pa,
            found.field_max_v_per_m * 1e-6
        ),
        format!("residual      {:e} of the shear modulus", found.residual),
    ];
    if let Some(limit) = found.margins.limit_voltage_v {
        lines.push(format!("the load is borne up to {limit} V"));
    }
    lines
}
