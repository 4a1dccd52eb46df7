//! The paper's loop under its uncertainty weight `W_s`: plain S/KS synthesis against D-K iteration with the same weights.
//!
//! ```text
//! cargo run --release -p telepulse-design --example dk_paper
//! ```
//!
//! For one additive block the worst case at a frequency is known in closed form: every loop function is divided by
//! `1 + W_s K S Delta`, so its worst magnitude is the nominal one over `1 - |W_s K S|`.

#![allow(clippy::print_stdout, clippy::approx_constant)]

use std::f64::consts::PI;

use telepulse_design::Error;
use telepulse_design::synthesize::dk::{DkDesign, DkOptions, FullBlock, FullBlocks, dk_iteration};
use telepulse_design::synthesize::{HinfOptions, LoopWeights, mixsyn};
use telepulse_lti::{Continuous, Diagram, GeneralizedPlant, StateSpace, TransferFunction};

type System = StateSpace<Continuous>;

fn system(numerator: &[f64], denominator: &[f64]) -> Result<System, Error> {
    Ok(TransferFunction::new(numerator, denominator)?.to_state_space())
}

struct Paper {
    /// Eqs. (16), (17), (19), (20).
    g: System,
    ws: System,
    wu: System,
    we: System,
}

impl Paper {
    fn new() -> Result<Self, Error> {
        Ok(Self {
            g: system(&[1350.14], &[0.0045, 1.07182, 22.458, 1444.0])?,
            ws: system(&[487.5], &[1.0, 45.0, 2500.0])?,
            wu: system(&[0.1, 0.0006283], &[0.0001, 62.83])?,
            we: system(&[0.2, 6.283], &[1.0, 0.0006283])?,
        })
    }

    /// From `(delta, r, u)` to `(W_s u, performance [W_e e; effort W_u u], e)` with `e = r - G u - delta`.
    fn uncertain(&self, performance: f64, effort: f64) -> Result<GeneralizedPlant, Error> {
        let (we, wu) = (self.we.scale(performance)?, self.wu.scale(performance * effort)?);
        let named = Diagram::new()
            .external_inputs([("delta", 1), ("r", 1), ("u", 1)])
            .block(&self.g, ["u"], [("p", 1)])
            .sum("e = r - p - delta")
            .block(&self.ws, ["u"], [("to_delta", 1)])
            .block(&we, ["e"], [("ze", 1)])
            .block(&wu, ["u"], [("zu", 1)])
            .external_outputs(["to_delta", "ze", "zu", "e"])
            .connect()?;
        Ok(named.generalized_plant(&["u"], &["e"])?)
    }
}

/// What a loop does, nominal and in the worst case.
#[derive(Clone, Copy, Debug)]
struct Loop {
    nominal_cost: f64,
    worst_cost: f64,
    peak_s: f64,
    worst_s: f64,
    peak_ks: f64,
    worst_ks: f64,
    small_gain: f64,
    bandwidth_hz: f64,
    /// Of the reference (25), in mm: root mean square and bound of the peak, nominal and worst.
    rms_mm: [f64; 2],
    peak_mm: [f64; 2],
}

fn judge(paper: &Paper, k: &System) -> Result<Loop, Error> {
    let one = System::from_gain(nalgebra::DMatrix::identity(1, 1))?;
    let s = one.feedback(&k.series(&paper.g)?)?;
    let ks = s.series(k)?;
    let at = |omega: f64| -> Result<[f64; 5], Error> {
        let abs = |sys: &System| -> Result<f64, Error> { Ok(sys.at(omega)?[(0, 0)].norm()) };
        let (s, ks) = (abs(&s)?, abs(&ks)?);
        let cost = (abs(&paper.we)? * s).hypot(abs(&paper.wu)? * ks);
        let t = abs(&paper.g)? * ks;
        Ok([s, ks, cost, abs(&paper.ws)? * ks, t])
    };
    let mut l = Loop {
        nominal_cost: 0.0,
        worst_cost: 0.0,
        peak_s: 0.0,
        worst_s: 0.0,
        peak_ks: 0.0,
        worst_ks: 0.0,
        small_gain: 0.0,
        bandwidth_hz: f64::NAN,
        rms_mm: [0.0; 2],
        peak_mm: [0.0; 2],
    };
    for step in 0..=20_000 {
        let omega = 1e-4 * 10_f64.powf(f64::from(step) / 2000.0);
        let [s, ks, cost, small, t] = at(omega)?;
        let worse = 1.0 / (1.0 - small);
        l.nominal_cost = l.nominal_cost.max(cost);
        l.worst_cost = l.worst_cost.max(cost * worse);
        l.peak_s = l.peak_s.max(s);
        l.worst_s = l.worst_s.max(s * worse);
        l.peak_ks = l.peak_ks.max(ks);
        l.worst_ks = l.worst_ks.max(ks * worse);
        l.small_gain = l.small_gain.max(small);
        if l.bandwidth_hz.is_nan() && t < 0.5_f64.sqrt() {
            l.bandwidth_hz = omega / (2.0 * PI);
        }
    }
    for (amplitude_mm, omega) in [(0.2, 0.4 * PI), (0.2, 0.1 * PI), (0.1, 0.8 * PI)] {
        let [s, _, _, small, _] = at(omega)?;
        for (case, worse) in [1.0, 1.0 / (1.0 - small)].into_iter().enumerate() {
            let error_mm = amplitude_mm * s * worse;
            l.rms_mm[case] += 0.5 * error_mm * error_mm;
            l.peak_mm[case] += error_mm;
        }
    }
    l.rms_mm = l.rms_mm.map(f64::sqrt);
    Ok(l)
}

/// D-K with the performance weighted by the inverse of the worst case reached, until that does not fall any more.
fn worst_case_design(paper: &Paper, effort: f64, start: f64) -> Result<(DkDesign, Loop), Error> {
    let blocks = FullBlocks::new(vec![FullBlock { n_w: 1, n_z: 1 }, FullBlock { n_w: 1, n_z: 2 }])?;
    let mut level = start;
    let mut best: Option<(DkDesign, Loop)> = None;
    for _ in 0..4 {
        let design = dk_iteration(&paper.uncertain(1.0 / level, effort)?, &blocks, &DkOptions::default())?;
        let judged = judge(paper, &design.controller)?;
        println!(
            "  performance / {level:.5}: mu {:.4} -> {:.4} in {} controllers ({:?}), worst cost {:.5}, order {}, reduced {:?}",
            design.history[0].mu_peak_proven,
            design.mu_peak_proven,
            design.history.len(),
            design.stop,
            judged.worst_cost,
            design.controller.n_states(),
            design.reduced.as_ref().map(|r| r.controller.n_states())
        );
        let next = level * design.mu_peak_proven;
        if best.as_ref().is_none_or(|(_, b)| judged.worst_cost < b.worst_cost) {
            best = Some((design, judged));
        }
        if (next / level - 1.0).abs() < 1e-3 {
            break;
        }
        level = next;
    }
    best.ok_or(Error::EmptyList { key: "designs" })
}

fn main() -> Result<(), Error> {
    let paper = Paper::new()?;
    let options = HinfOptions { backoff: 1.003, ..HinfOptions::default() };
    let weights = LoopWeights { w1: Some(&paper.we), w2: Some(&paper.wu), w3: None };
    let plain = mixsyn(&paper.g, &weights, &options)?;
    let printed = system(&[30.4975, 1232.4466, 81241.5075], &[1.0, 17.5212, 5833.5515, 3.6648])?;
    let printed = judge(&paper, &printed)?;
    let plain = judge(&paper, &plain.hinf.controller)?;
    println!("D-K, weights as printed:");
    let (_, same) = worst_case_design(&paper, 1.0, plain.worst_cost)?;
    println!("D-K, W_u times 1.2, which makes the peak of K S that of plain S/KS:");
    let (_, equal) = worst_case_design(&paper, 1.2, plain.worst_cost)?;
    println!("\n{:<44}{:>10}{:>10}{:>10}{:>12}{:>9}", "", "printed K", "S/KS", "D-K", "D-K, effort", "ratio");
    let row = |name: &str, of: &dyn Fn(&Loop) -> f64| {
        let [a, b, c, d] = [&printed, &plain, &same, &equal].map(of);
        println!("{name:<44}{a:>10.5}{b:>10.5}{c:>10.5}{d:>12.5}{:>9.4}", d / b);
    };
    row("weighted cost |[We S; Wu K S]|, nominal", &|l| l.nominal_cost);
    row("weighted cost, worst |Delta| <= 1", &|l| l.worst_cost);
    row("peak |S|, nominal", &|l| l.peak_s);
    row("peak |S|, worst", &|l| l.worst_s);
    row("peak |K S|, nominal", &|l| l.peak_ks);
    row("peak |K S|, worst", &|l| l.worst_ks);
    row("peak |Ws K S|", &|l| l.small_gain);
    row("bandwidth (-3 dB of T), Hz", &|l| l.bandwidth_hz);
    row("reference (25), rms error, mm, nominal", &|l| l.rms_mm[0]);
    row("reference (25), rms error, mm, worst", &|l| l.rms_mm[1]);
    row("reference (25), bound of peak, mm, nominal", &|l| l.peak_mm[0]);
    row("reference (25), bound of peak, mm, worst", &|l| l.peak_mm[1]);
    println!(
        "\nthe errors of (25) are those of the steady state; the ratio is D-K at equal effort over S/KS"
    );
    Ok(())
}
