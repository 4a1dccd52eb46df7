//! Solves every plant of a JSON file and prints one JSON line for each: what was reached and the median time of a call.
//!
//! ```text
//! cargo run --release -p telepulse-design --example hinfsyn_benchmark -- plants.json [calls per plant]
//! ```
//!
//! The file holds `{"problems": [...]}`, each with `id`, the sizes `n`, `nw`, `nu`, `nz`, `ny` and the nine matrices as
//! lists of rows.
#![allow(clippy::print_stdout)]

use std::time::Instant;

use nalgebra::DMatrix;
use serde_json::{Value, json};
use telepulse_design::synthesize::{HinfDesign, HinfOptions, hinfsyn};
use telepulse_lti::{Continuous, GeneralizedPlant, StateSpace};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("expected the path of a JSON file with plants")?;
    let n_calls: usize = arguments.next().map_or(Ok(1), |text| text.parse())?;
    let file: Value = serde_json::from_str(&std::fs::read_to_string(&path)?)?;
    let problems = file["problems"].as_array().ok_or("expected a list named `problems`")?;
    for problem in problems {
        let plant = plant(problem)?;
        let mut seconds = Vec::with_capacity(n_calls);
        let mut result = None;
        for _ in 0..n_calls.max(1) {
            let start = Instant::now();
            result = Some(hinfsyn(&plant, &HinfOptions::default()));
            seconds.push(start.elapsed().as_secs_f64());
        }
        seconds.sort_by(f64::total_cmp);
        let mut line = match result {
            Some(Ok(design)) => answer(&design),
            Some(Err(error)) => json!({ "status": "error", "message": error.to_string() }),
            None => json!({}),
        };
        line["id"] = problem["id"].clone();
        line["seconds"] = json!(seconds[seconds.len() / 2]);
        println!("{line}");
    }
    Ok(())
}

fn answer(design: &HinfDesign) -> Value {
    let k = &design.controller;
    json!({
        "status": "ok",
        "gamma_lower": design.gamma_lower,
        "gamma_upper": design.gamma_upper,
        "gamma_design": design.gamma_design,
        "achieved_norm": design.achieved.value,
        "achieved_upper": design.achieved.upper,
        "n_tests": design.n_feasibility_tests, "isotropy": design.isotropy_error,
        "binding_condition": design.binding_condition,
        "regularization": design.regularization.map(|r| format!("{r:?}")),
        "controller": { "A": rows(k.a()), "B": rows(k.b()), "C": rows(k.c()), "D": rows(k.d()) },
    })
}

fn rows(m: &DMatrix<f64>) -> Vec<Vec<f64>> {
    m.row_iter().map(|row| row.iter().copied().collect()).collect()
}

fn plant(problem: &Value) -> Result<GeneralizedPlant, Box<dyn std::error::Error>> {
    let size =
        |key: &str| problem[key].as_u64().map(|v| v as usize).ok_or(format!("expected the size `{key}`"));
    let (n, nw, nu, nz, ny) = (size("n")?, size("nw")?, size("nu")?, size("nz")?, size("ny")?);
    let matrix = |key: &str, n_rows: usize, n_cols: usize| {
        let values: Option<Vec<f64>> = problem[key].as_array().and_then(|rows| {
            rows.iter().flat_map(|row| row.as_array().into_iter().flatten()).map(Value::as_f64).collect()
        });
        match values {
            Some(values) if values.len() == n_rows * n_cols => {
                Ok(DMatrix::from_row_slice(n_rows, n_cols, &values))
            }
            _ => Err(format!("expected `{key}` to be {n_rows} x {n_cols}")),
        }
    };
    let (mut b, mut c) = (DMatrix::zeros(n, nw + nu), DMatrix::zeros(nz + ny, n));
    let mut d = DMatrix::zeros(nz + ny, nw + nu);
    b.columns_mut(0, nw).copy_from(&matrix("B1", n, nw)?);
    b.columns_mut(nw, nu).copy_from(&matrix("B2", n, nu)?);
    c.rows_mut(0, nz).copy_from(&matrix("C1", nz, n)?);
    c.rows_mut(nz, ny).copy_from(&matrix("C2", ny, n)?);
    d.view_mut((0, 0), (nz, nw)).copy_from(&matrix("D11", nz, nw)?);
    d.view_mut((0, nw), (nz, nu)).copy_from(&matrix("D12", nz, nu)?);
    d.view_mut((nz, 0), (ny, nw)).copy_from(&matrix("D21", ny, nw)?);
    d.view_mut((nz, nw), (ny, nu)).copy_from(&matrix("D22", ny, nu)?);
    let sys = StateSpace::<Continuous>::new(matrix("A", n, n)?, b, c, d)?;
    Ok(GeneralizedPlant::new(sys, nw, nu, nz, ny)?)
}
