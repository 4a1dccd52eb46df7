//! The page that shows a study.

use telepulse_actuator::twin::Fidelity;

use super::figures::controller_style;
use crate::figure::{Cell, Figure, ReportPage, Status, Table};
use crate::study::outcome::{CertificateSummary, Outcome, Synthesis, Tracking};

/// Table 1 of the paper: error in mm, effort index, power in W, by condition.
const TABLE_1: [(&str, &str, f64, f64, f64); 4] = [
    ("normal", "Normal", 0.0107, 0.3431, 0.3186),
    ("disturbance", "Constant disturbance", 0.0114, 0.3008, 0.2678),
    ("noise", "Sensing noise", 0.0107, 0.3565, 0.3355),
    ("both", "Disturbance and noise", 0.0117, 0.2935, 0.2589),
];

/// Controllers in the order in which tables name them.
const CONTROLLERS: [&str; 5] = ["printed_k", "hinf", "best", "pid_auto", "pid_manual"];

fn status(holds: bool) -> Status {
    if holds { Status::Pass } else { Status::Fail }
}

fn name(controller: &str) -> String {
    match controller.strip_suffix("_force") {
        Some(base) => format!("{}, force mode", controller_style(base).0),
        None => controller_style(controller).0.to_owned(),
    }
}

/// The whole page as HTML.
#[must_use]
pub fn render(outcome: &Outcome, figures: &[Figure]) -> String {
    let draw = |page: ReportPage, ids: &[&str]| {
        ids.iter().fold(page, |page, id| match figures.iter().find(|figure| figure.id() == *id) {
            Some(figure) => page.figure(figure),
            None => page,
        })
    };
    let mut page = summary(outcome);
    page = page.section("The tracked pulse").paragraph(
        "A recorded pulse was sent from a patient process to a doctor process and replayed there on the virtual rig.",
    );
    page = draw(page, &["tracked-pulse"]);
    page = device(page, outcome);
    page = draw(page, &["fig09-step"]);
    page = identification(page, outcome);
    page = draw(page, &["fig07-frequency-response", "fig08-uncertainty"]);
    page = design(page, outcome);
    page = draw(page, &["fig12-closed-loop"]);
    page = stroke(page, outcome);
    page = draw(page, &["bias-sweep"]);
    page = tracking(page, outcome);
    page = draw(page, &["fig13-tracking", "fig14-pid", "fig15-disturbance-noise"]);
    page = pulse(page, outcome);
    page = draw(page, &["fig16-pulse", "fig17-spectrum", "fig18-displacement", "fig20-force"]);
    page = recorded(page, outcome);
    page = draw(page, &["pulse-horizon"]);
    page = closing(page, outcome);
    page.render()
}

fn summary(outcome: &Outcome) -> ReportPage {
    let mut page = ReportPage::new(&outcome.title)
        .subtitle(format!("study {}, {}, seed {}", outcome.study, outcome.program, outcome.seed));
    let best = |condition: &str| outcome.tracking.get("best").and_then(|runs| runs.get(condition));
    if let Some(error) = best("normal").and_then(|run| run.mean_abs_error_mm) {
        page = page.summary(
            "Mean error on (25), our best",
            format!("{error:.5} mm (the paper: 0.0107 mm)"),
            Some(status(error <= 0.001)),
        );
    }
    if let Some(run) = outcome.pulse.get("best").and_then(|runs| runs.get("displacement"))
        && let (Some(lag_ms), Some(nrmse)) = (run.lag_ms, run.nrmse)
    {
        page = page.summary(
            "Real pulse, our best",
            format!("lag {lag_ms:.2} ms, NRMSE {:.2} % (the paper: nearly 40 ms)", 100.0 * nrmse),
            Some(status(lag_ms.abs() <= 2.0 && nrmse <= 0.03)),
        );
    }
    page = page.summary(
        "Synthesis on the printed plant",
        format!(
            "gamma {:.5}, no controller below {:.5} (the printed K: {:.4})",
            outcome.synthesis.gamma_achieved, outcome.synthesis.gamma_lower, outcome.printed.gamma
        ),
        Some(status(outcome.synthesis.gamma_achieved <= 0.324)),
    );
    let certified =
        outcome.certificates.iter().filter(|(_, c)| c.holds).map(|(n, _)| name(n)).collect::<Vec<_>>();
    page = page.summary("Certified controllers", certified.join(", "), Some(status(!certified.is_empty())));
    let fragile: Vec<String> = CONTROLLERS
        .iter()
        .filter_map(|c| outcome.unstable_from(c).map(|bias| format!("{} from bias {bias}", name(c))))
        .collect();
    page = page.summary("Unstable elsewhere in the stroke", fragile.join(", "), Some(Status::Note));
    page.summary(
        "Transmission",
        format!(
            "{} of {} samples, {} lost, {} duplicated, {} out of order, bit exact: {}",
            outcome.link.received,
            outcome.link.sent,
            outcome.link.lost,
            outcome.link.duplicated,
            outcome.link.out_of_order,
            outcome.link.bit_exact
        ),
        Some(status(outcome.link.bit_exact)),
    )
}

fn coefficients(values: &[f64]) -> String {
    let order = values.len().saturating_sub(1);
    values
        .iter()
        .enumerate()
        .map(|(idx, value)| match order - idx {
            0 => format!("{value:.6}"),
            1 => format!("{value:.6} s"),
            power => format!("{value:.6} s^{power}"),
        })
        .collect::<Vec<_>>()
        .join(" + ")
}

fn identification(page: ReportPage, outcome: &Outcome) -> ReportPage {
    let mut table = Table::new(
        "Identified third-order model beside the printed one",
        [
            "model",
            "DC gain, mm/unit",
            "omega_n, rad/s",
            "zeta",
            "RC, ms",
            "rms residual, mm/unit",
            "points above the bound",
        ],
    )
    .row([
        Cell::text("printed (16), (17)"),
        Cell::number(0.935, 4),
        Cell::number(38.0, 4),
        Cell::number(0.21, 3),
        Cell::number(4.5, 3),
        Cell::Empty,
        Cell::Empty,
    ]);
    for (label, model) in [
        ("complex least squares", &outcome.identified),
        ("magnitude only, as the paper", &outcome.identified_magnitude_only),
        ("command = square of the voltage", &outcome.identified_square_root),
    ] {
        table = table.row([
            Cell::text(label),
            Cell::number(model.dc_gain_mm_per_unit, 4),
            Cell::number(model.omega_n_rad_s, 4),
            Cell::number(model.zeta, 3),
            Cell::number(1e3 * model.rc_s, 3),
            Cell::number(model.residual_rms, 3),
            Cell::text(format!("{} of {}", model.bound_violations, model.bound_points)),
        ]);
    }
    let systems = Table::new("Printed and identified systems", ["system", "printed", "identified"])
        .row([
            Cell::text("G numerator, (16)"),
            Cell::text("1350.14"),
            Cell::text(coefficients(&outcome.identified.numerator)),
        ])
        .row([
            Cell::text("G denominator"),
            Cell::text("0.0045 s^3 + 1.07182 s^2 + 22.458 s + 1444"),
            Cell::text(coefficients(&outcome.identified.denominator)),
        ])
        .row([
            Cell::text("W_s numerator, (17)"),
            Cell::text("487.5"),
            Cell::text(coefficients(&outcome.identified.bound_numerator)),
        ])
        .row([
            Cell::text("W_s denominator"),
            Cell::text("s^2 + 45 s + 2500"),
            Cell::text(coefficients(&outcome.identified.bound_denominator)),
        ]);
    page.section("Identification")
        .paragraph("Parameter set A was itself fitted to (16), so agreement with (16) is no evidence for the membrane model.")
        .table(table)
        .table(systems)
        .paragraph(nonlinear(outcome))
}

/// What the nonlinear model leaves of its record.
fn nonlinear(outcome: &Outcome) -> String {
    let Some(model) = &outcome.nonlinear_model else { return String::new() };
    let held_back = model
        .rms_held_back_mm
        .map_or_else(String::new, |rms| format!(", {rms:.5} mm of the part that it was not fitted to"));
    let branches: Vec<String> = model
        .relaxation_times_s
        .iter()
        .zip(&model.branch_shares)
        .map(|(time, share)| format!("{:.1} % in {time:.3} s", 100.0 * share))
        .collect();
    format!(
        "The feedforward's nonlinear model (third-degree polynomial in displacement and squared voltage, damping, creep branches) leaves \
         {:.5} mm rms of a record of steps and multisines up to {:.3} mm{held_back}. Stiffness that relaxes: {}.",
        model.rms_residual_mm,
        model.displacement_max_mm,
        branches.join(", ")
    )
}

fn synthesis_row(label: &str, s: &Synthesis) -> [Cell; 8] {
    [
        Cell::text(label),
        Cell::number(s.gamma_achieved, 5),
        Cell::number(s.gamma_lower, 5),
        Cell::number(s.fastest_pole_rad_s, 4),
        Cell::number(s.peak_ks, 4),
        Cell::number(s.peak_s, 4),
        Cell::number(s.peak_t, 4),
        Cell::number(s.bandwidth_hz, 4),
    ]
}

fn certificate_row(controller: &str, c: &CertificateSummary) -> [Cell; 8] {
    let verdict = if c.holds {
        format!("certified for {}", c.scope)
    } else {
        format!("uncertified: {}", c.reason.clone().unwrap_or_default())
    };
    [
        Cell::text(name(controller)),
        Cell::check(status(c.holds), verdict),
        Cell::optional(c.norm_ms, 4),
        Cell::optional(c.norm_ws, 4),
        Cell::optional(c.norm_product, 4),
        Cell::optional(c.frequency_wise, 4),
        Cell::optional(c.gain_margin, 3),
        Cell::optional(c.phase_margin_deg, 3),
    ]
}

fn design(page: ReportPage, outcome: &Outcome) -> ReportPage {
    let synthesis = Table::new(
        "S/KS synthesis",
        [
            "plant",
            "gamma",
            "lower bound",
            "fastest pole, rad/s",
            "peak K S",
            "peak S",
            "peak T",
            "bandwidth, Hz",
        ],
    )
    .row(synthesis_row("printed (16)", &outcome.synthesis))
    .row(synthesis_row("identified", &outcome.synthesis_identified))
    .row(synthesis_row("identified, square of the voltage, with filter (26)", &outcome.synthesis_best));
    let printed =
        Table::new("Small-gain test with the printed systems", ["quantity", "printed", "recomputed"])
            .row([
                Cell::text("norm of M_s, (22)"),
                Cell::number(1.7687, 5),
                Cell::number(outcome.printed.norm_ms, 5),
            ])
            .row([
                Cell::text("norm of W_s, (17)"),
                Cell::number(0.2426, 4),
                Cell::number(outcome.printed.norm_ws, 6),
            ])
            .row([
                Cell::text("1/norm of W_s, (24)"),
                Cell::number(4.1218, 5),
                Cell::number(outcome.printed.small_gain_limit, 5),
            ])
            .row([Cell::text("max |W_s K S|"), Cell::Empty, Cell::number(outcome.printed.frequency_wise, 4)]);
    let mut certificates = Table::new(
        "Certificates, each on the identified plant of its own input and its own bound, with the filter (26) in the loop",
        [
            "controller",
            "verdict",
            "norm K S",
            "norm W_s",
            "product",
            "max |W_s K S|",
            "gain margin",
            "phase margin, deg",
        ],
    );
    for (controller, certificate) in &outcome.certificates {
        certificates = certificates.row(certificate_row(controller, certificate));
    }
    page.section("Design and certificate")
        .paragraph(
            "printed K: the controller (21). own S/KS: H-infinity design on the identified plant with the weights (19), (20). best: \
             square root at the amplifier, preview feedforward from the known reference, H-infinity feedback.",
        )
        .table(synthesis).table(printed).table(certificates).note(
        "A loop is certified where it is stable, either the norm test (23) or the frequency-wise test is below one at the bias of the sweep, and, in displacement mode, it is stable at every other bias examined.",
    )
}

fn stroke(page: ReportPage, outcome: &Outcome) -> ReportPage {
    let mut table = Table::new(
        "Each loop on the plant as it is at other biases, with the filter (26)",
        ["controller", "bias", "static gain, mm/unit", "omega_n, rad/s", "gain margin", "stable"],
    );
    for point in &outcome.bias_sweep {
        let verdict = if point.stable { "stable" } else { "UNSTABLE" };
        table = table.row([
            Cell::text(name(&point.controller)),
            Cell::number(point.bias, 2),
            Cell::number(point.dc_gain_mm_per_unit, 4),
            Cell::number(point.omega_n_rad_s, 4),
            Cell::optional(point.gain_margin, 3),
            Cell::check(status(point.stable), verdict),
        ]);
    }
    page.subsection("Over the stroke")
        .paragraph(
            "The certificates above hold at the bias and the amplitudes of the sweep. Force goes with voltage squared, so the \
             plant's gain grows with the bias, and a certificate at one bias says nothing about another.",
        )
        .table(table)
}

fn cell_of(run: Option<&Tracking>, of: impl Fn(&Tracking) -> Option<f64>, digits: usize) -> Cell {
    match run {
        Some(run) if run.unstable => Cell::check(Status::Fail, "unstable"),
        Some(run) => Cell::optional(of(run), digits),
        None => Cell::Empty,
    }
}

fn tracking(page: ReportPage, outcome: &Outcome) -> ReportPage {
    let run = |controller: &str, condition: &str| {
        outcome.tracking.get(controller).and_then(|runs| runs.get(condition))
    };
    let mut header = vec!["condition".to_owned(), "the paper".to_owned()];
    header.extend(CONTROLLERS.iter().map(|c| name(c)));
    let mut error = Table::new("Table 1: mean absolute error, mm", header.clone());
    let mut effort = Table::new("Table 1: control effort index", header.clone());
    let mut power = Table::new("Table 1: average power, W", header);
    for (condition, label, paper_error, paper_effort, paper_power) in TABLE_1 {
        let row = |paper: f64, of: fn(&Tracking) -> Option<f64>| {
            let mut cells = vec![Cell::text(label), Cell::number(paper, 4)];
            cells.extend(CONTROLLERS.iter().map(|c| cell_of(run(c, condition), of, 3)));
            cells
        };
        error = error.row(row(paper_error, |run| run.mean_abs_error_mm));
        effort = effort.row(row(paper_effort, |run| run.effort_index));
        power = power.row(row(paper_power, |run| run.average_power_w));
    }
    let mut noisy = Table::new(
        "Mean absolute error with the laser's own noise on top, mm",
        std::iter::once("condition".to_owned()).chain(CONTROLLERS.iter().map(|c| name(c))),
    );
    for (condition, label, ..) in TABLE_1 {
        let of = |controller: &str| {
            let run = outcome.tracking_laser_noise.get(controller).and_then(|runs| runs.get(condition));
            cell_of(run, |run| run.mean_abs_error_mm, 3)
        };
        noisy = noisy.row(std::iter::once(Cell::text(label)).chain(CONTROLLERS.iter().map(|c| of(c))));
    }
    let mut page = page.section("Tracking of (25)").table(error).table(effort).table(power).table(noisy).paragraph(
        "Table 1's conditions name no noise but their own sine, so those runs have an ideal laser; the last table adds the laser's noise \
         and steps as assumed. Power comes from the assumed leak across the amplifier's output, which was read off the paper's own \
         Table 1: its agreement with the paper is no evidence.",
    );
    for controller in CONTROLLERS {
        let Some(normal) = run(controller, "normal") else { continue };
        let noisy = outcome.tracking_laser_noise.get(controller).and_then(|runs| runs.get("normal"));
        let mut text = format!("{}: {}", name(controller), normal.provenance);
        if let Some(reason) = &normal.unstable_reason {
            text.push_str(&format!(". Normal condition: {reason}"));
        } else if let Some(reason) = noisy.and_then(|run| run.unstable_reason.as_ref()) {
            text.push_str(&format!(". With the laser's noise: {reason}"));
        }
        page = page.note(text);
    }
    page.paragraph(why_not_robust(outcome))
}

/// What the auto-tuned PID's certificate and stroke say, in words.
fn why_not_robust(outcome: &Outcome) -> String {
    let Some(c) = outcome.certificates.get("pid_auto") else { return String::new() };
    let (Some(product), Some(gain), Some(phase)) = (c.norm_product, c.gain_margin, c.phase_margin_deg) else {
        return "The auto-tuned PID is unstable on the identified plant.".into();
    };
    let bias = outcome.unstable_from("pid_auto").map_or_else(String::new, |bias| {
        format!(" The plant's gain outgrows that margin within the stroke: the loop is unstable from bias {bias} on.")
    });
    format!(
        "Why the auto-tuned PID is not robust: at the bias of the sweep it is stable, but the norm test (23) fails with a \
         product of {product:.2}, and with the filter (26) its phase margin is {phase:.1} degrees and its gain margin \
         {gain:.2}.{bias} The rig of the paper lost its stability with these gains."
    )
}

fn pulse(page: ReportPage, outcome: &Outcome) -> ReportPage {
    let mut table = Table::new(
        "Replay of the real pulse; the lag comes on top of the play-out delay",
        [
            "mode",
            "controller",
            "lag, ms",
            "NRMSE, %",
            "NRMSE after delay removal, %",
            "lowest, V",
            "highest, V",
        ],
    );
    for mode in ["displacement", "force"] {
        for controller in CONTROLLERS {
            let Some(run) = outcome.pulse.get(controller).and_then(|runs| runs.get(mode)) else { continue };
            if run.unstable {
                let why = run.unstable_reason.clone().unwrap_or_default();
                table = table.row([
                    Cell::text(mode),
                    Cell::text(name(controller)),
                    Cell::check(Status::Fail, format!("unstable: {why}")),
                    Cell::Empty,
                    Cell::Empty,
                    Cell::Empty,
                    Cell::Empty,
                ]);
                continue;
            }
            table = table.row([
                Cell::text(mode),
                Cell::text(name(controller)),
                Cell::optional(run.lag_ms, 3),
                Cell::optional(run.nrmse.map(|x| 100.0 * x), 3),
                Cell::optional(run.nrmse_aligned.map(|x| 100.0 * x), 3),
                Cell::optional(run.min_voltage_v, 4),
                Cell::optional(run.max_voltage_v, 4),
            ]);
        }
    }
    let link = &outcome.link;
    page.section("The pulse")
        .paragraph(format!(
            "{} beats, {:.1} per minute. Sent from one process to another: {} samples, {} frames sent again, {} duplicate \
             frames dropped; SHA-256 of the samples {}.",
            outcome.pulse_spectrum.beats,
            outcome.pulse_spectrum.heart_rate_bpm,
            link.sent,
            link.retransmitted_frames,
            link.duplicate_frames_dropped,
            link.sha256
        ))
        .table(table)
}

/// Recorded pulses by horizon.
fn recorded(page: ReportPage, outcome: &Outcome) -> ReportPage {
    if outcome.pulse_files.is_empty() {
        return page;
    }
    let mut table = Table::new(
        "Recorded pulses in displacement mode, best controller",
        ["recording", "known ahead, ms", "lag, ms", "NRMSE, %", "NRMSE after delay removal, %"],
    );
    for (name, by_horizon) in &outcome.pulse_files {
        let mut runs: Vec<_> = by_horizon.iter().collect();
        runs.sort_by_key(|(key, _)| std::cmp::Reverse(key.parse::<u32>().unwrap_or(0)));
        for (horizon, run) in runs {
            let lag = match &run.unstable_reason {
                Some(why) => Cell::check(Status::Fail, format!("unstable: {why}")),
                None => Cell::optional(run.lag_ms, 3),
            };
            table = table.row([
                Cell::text(name.as_str()),
                Cell::text(horizon.as_str()),
                lag,
                Cell::optional(run.nrmse.map(|x| 100.0 * x), 3),
                Cell::optional(run.nrmse_aligned.map(|x| 100.0 * x), 3),
            ]);
        }
    }
    page.subsection("Other recordings")
        .paragraph(
            "Each is scaled to the study's peak-to-peak pressure. The feedforward inverts a nonlinear model that was fitted to one record of \
             the rig; it reads the pulse as far ahead as stated and bends it, as little as possible, where it asks for more voltage than there is.",
        )
        .table(table)
        .table(force_table(outcome))
}

/// Recorded pulses in force mode.
fn force_table(outcome: &Outcome) -> Table {
    let mut table = Table::new(
        "Recorded pulses in force mode at the play-out delay, best controller, worst of contact stiffness x 0.5, 1 and 1.5",
        ["recording", "lag, ms", "NRMSE, %"],
    );
    for (name, run) in &outcome.pulse_force {
        table = table.row([
            Cell::text(name.as_str()),
            Cell::number(run.lag_ms, 3),
            Cell::number(100.0 * run.nrmse, 3),
        ]);
    }
    table
}

fn device(page: ReportPage, outcome: &Outcome) -> ReportPage {
    let page = page.section("Device").paragraph(
        "The virtual device is derived from the corrected model; identification sees its sensor and its drive only.",
    );
    let Some(device) = &outcome.device else { return page };
    let stated = match (device.stated_error_step_percent, device.stated_error_reference_percent) {
        (Some(step), Some(reference)) => {
            format!("{step:.4} % of stroke over a step to full scale, {reference:.4} % over (25)")
        }
        _ => "not measured".to_owned(),
    };
    let moved = match device.fidelity {
        Fidelity::Reduced => "reduced twin, built from the field-level model",
        Fidelity::Field => "field-level model: every node of the membrane with its branches",
    };
    let sensor = match (device.sensing_error_max_mm, device.sensing_standard_deviation_max_mm) {
        (Some(error), Some(spread)) => format!(
            "{}: readings within {error:.4} mm of the true mean over their window, stated standard deviation up to {spread:.4} mm",
            device.sensor.word()
        ),
        _ => device.sensor.word().to_owned(),
    };
    let voltage = format!(
        "{:.0} V, {}; allowed up to {:.0} V ({} at {:.0} V{})",
        device.max_v,
        if device.max_v_derived { "from the failure envelope" } else { "stated" },
        device.envelope_max_v,
        device.envelope_limited_by,
        device.envelope_first_failure_v,
        if device.envelope_unverified {
            "; holds limits that are not verified against their source"
        } else {
            ""
        }
    );
    let slew = device.slew_v_per_s.map_or_else(|| "not limited".to_owned(), |slew| format!("{slew:.0} V/s"));
    let rows = [
        ("parameter set", format!("{:?}", device.parameter_set)),
        ("fidelity", moved.to_owned()),
        ("error of the reduced twin against the field-level model", stated),
        ("sensor of displacement runs", sensor),
        ("highest voltage", voltage),
        ("slew", slew),
    ];
    let table =
        rows.iter().fold(Table::new("Device and limits", ["what", "value"]), |table, (name, value)| {
            table.row([Cell::text(*name), Cell::text(value)])
        });
    page.table(table)
}

fn closing(page: ReportPage, outcome: &Outcome) -> ReportPage {
    let mut disagreements = Table::new(
        "What the paper prints and what follows from it",
        ["item", "printed", "recomputed", "note"],
    );
    for row in &outcome.disagreements {
        disagreements = disagreements.row([
            Cell::text(&row.item),
            Cell::text(&row.printed),
            Cell::text(&row.recomputed),
            Cell::text(&row.note),
        ]);
    }
    let mut assumptions = Table::new("What the paper does not give", ["quantity", "value", "why"]);
    for row in &outcome.assumptions {
        assumptions = assumptions.row([Cell::text(&row.name), Cell::text(&row.value), Cell::text(&row.why)]);
    }
    let inputs =
        outcome.inputs.iter().map(|(name, hash)| format!("{name}: SHA-256 {hash}")).collect::<Vec<_>>();
    page.section("Disagreements")
        .table(disagreements)
        .section("Assumptions")
        .table(assumptions)
        .section("Provenance")
        .list(inputs)
        .note("The virtual rig stands for the device. Nothing here is a medical device.")
        .footer(format!("{}; every number is in report.json", outcome.program))
}
