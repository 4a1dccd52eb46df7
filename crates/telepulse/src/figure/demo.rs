//! Figures of every kind, for tests and for looking at.

use std::f64::consts::TAU;

use super::*;

/// Bode diagram with measured points, fit and cover.
pub fn bode() -> Figure {
    let response = |f: f64| {
        let w = TAU * f;
        let (re, im) = (1444.0 - 1.07182 * w * w, 22.458 * w - 0.0045 * w.powi(3));
        (1350.14 / re.hypot(im), -im.atan2(re).to_degrees().rem_euclid(360.0))
    };
    let f: Vec<f64> = (0..200).map(|i| 0.1 * 130f64.powf(f64::from(i) / 199.0)).collect();
    let measured: Vec<f64> = f.iter().copied().step_by(9).collect();
    let magnitude = |f: &[f64], scale: f64| f.iter().map(|&f| scale * response(f).0).collect::<Vec<_>>();
    let phase = |f: &[f64], shift: f64| f.iter().map(|&f| response(f).1 + shift).collect::<Vec<_>>();
    let points =
        |y: Vec<f64>, name: &str, colour, marker| Series::points(name, measured.clone(), y, colour, marker);
    Figure::new("bode", "Frequency response of the plant")
        .caption("Measured at three amplitudes about a bias of 0.5, with the fitted model.")
        .shared_x()
        .panel(
            Panel::new(Axis::log("frequency, Hz"), Axis::log("gain, mm/unit"))
                .note("stepped sine, FFT over whole periods")
                .series(Series::line("fitted third-order model", f.clone(), magnitude(&f, 1.0), Colour::Blue))
                .series(points(
                    magnitude(&measured, 1.03),
                    "measured, 0.2 of full scale",
                    Colour::Vermilion,
                    Marker::Circle,
                ))
                .series(points(
                    magnitude(&measured, 0.96),
                    "measured, 0.4 of full scale",
                    Colour::Green,
                    Marker::Square,
                ))
                .series(points(
                    magnitude(&measured, 0.93),
                    "measured, 0.5 of full scale",
                    Colour::Orange,
                    Marker::Diamond,
                )),
        )
        .panel(
            Panel::new(Axis::log("frequency, Hz"), Axis::degrees("phase, deg"))
                .series(Series::line("fitted third-order model", f.clone(), phase(&f, 0.0), Colour::Blue))
                .series(points(
                    phase(&measured, 3.0),
                    "measured, 0.2 of full scale",
                    Colour::Vermilion,
                    Marker::Circle,
                ))
                .series(points(
                    phase(&measured, -4.0),
                    "measured, 0.4 of full scale",
                    Colour::Green,
                    Marker::Square,
                ))
                .series(points(
                    phase(&measured, -7.0),
                    "measured, 0.5 of full scale",
                    Colour::Orange,
                    Marker::Diamond,
                )),
        )
}

/// 80 000 samples with three panels: reference and output, error, voltage.
pub fn time_series() -> Figure {
    let t: Vec<f64> = (0..80_000).map(|i| f64::from(i) / 2000.0).collect();
    let reference =
        |t: f64| 0.2 * (TAU * 0.1 * t).sin() + 0.2 * (TAU * t).sin() + 0.1 * (TAU * 3.0 * t).sin();
    let curve = |f: &dyn Fn(f64) -> f64| t.iter().map(|&t| f(t)).collect::<Vec<_>>();
    let ripple = |t: f64| 0.01 * (TAU * 50.0 * t).sin() * (1.0 + 0.5 * (0.9 * t).sin());
    Figure::new("tracking", "Tracking of reference (25) with constant disturbance and sensing noise")
        .caption("Upper: reference and output. Middle: error. Lower: drive voltage with its limits.")
        .shared_x()
        .panel(
            Panel::new(Axis::linear("time, s"), Axis::linear("displacement, mm"))
                .title("Displacement")
                .series(Series::line("reference", t.clone(), curve(&reference), Colour::Ink))
                .series(Series::dashed(
                    "output",
                    t.clone(),
                    curve(&|t| reference(t - 0.02)),
                    Colour::Vermilion,
                    Dash::Dashed,
                )),
        )
        .panel(
            Panel::new(Axis::linear("time, s"), Axis::linear("error, mm"))
                .title("Error")
                .series(Series::line("error", t.clone(), curve(&ripple), Colour::Blue)),
        )
        .panel(
            Panel::new(Axis::linear("time, s"), Axis::linear("voltage, V").range(0.0, 5200.0))
                .title("Voltage")
                .series(Series::line(
                    "voltage",
                    t.clone(),
                    curve(&|t| 2500.0 + 3000.0 * reference(t)),
                    Colour::Purple,
                ))
                .series(Series::level("limit", 0.0, 40.0, 5000.0, Colour::Grey)),
        )
}

/// Line spectrum on linear axes.
pub fn spectrum() -> Figure {
    let f: Vec<f64> = (0..32).map(|k| f64::from(k) * 0.390_625).collect();
    let a = f.iter().map(|f| {
        120.0 * (-((f - 1.2) / 0.5f64).powi(2)).exp() + 60.0 * (-((f - 2.7) / 0.4f64).powi(2)).exp()
    });
    let a: Vec<f64> = a.collect();
    let peaks = [3, 7];
    Figure::new("spectrum", "Amplitude spectrum of the pulse").caption("N = 256 at 100 Hz.").panel(
        Panel::new(Axis::linear("frequency, Hz"), Axis::linear("amplitude, Pa"))
            .note("peaks at bins 3, 7 and 10")
            .series(Series::stems("spectrum", f.clone(), a.clone(), Colour::Blue))
            .series(Series::points(
                "peak",
                peaks.iter().map(|&k| f[k]).collect(),
                peaks.iter().map(|&k| a[k]).collect(),
                Colour::Vermilion,
                Marker::Circle,
            )),
    )
}

/// Step response with a gap, and a logarithmic magnitude over many decades.
pub fn step() -> Figure {
    let t: Vec<f64> = (0..500).map(|i| f64::from(i) / 250.0).collect();
    let y = |t: f64| 0.935 * (1.0 - (-8.0 * t).exp() * ((37.15 * t).cos() + 0.215 * (37.15 * t).sin()));
    let mut measured: Vec<f64> = t.iter().map(|&t| y(t) * 1.01).collect();
    measured[200..230].fill(f64::NAN);
    let f: Vec<f64> = (0..300).map(|i| 10f64.powf(f64::from(i) / 299.0 * 7.0 - 3.0)).collect();
    let low_pass = f.iter().map(|f| 1.0 / (1.0 + (f / 20.0).powi(2))).collect();
    let title = "Step of 5 kV, and a filter over seven decades, under a title that needs two lines to fit";
    Figure::new("step", title)
        .panel(
            Panel::new(Axis::linear("time, s"), Axis::linear("displacement, mm"))
                .title("Step")
                .series(Series::line("model", t.clone(), t.iter().map(|&t| y(t)).collect(), Colour::Blue))
                .series(Series::dashed(
                    "measured, with a gap",
                    t.clone(),
                    measured,
                    Colour::Vermilion,
                    Dash::DashDot,
                )),
        )
        .panel(
            Panel::new(Axis::log("frequency, Hz"), Axis::log("gain")).title("Filter").series(Series::dashed(
                "second-order low-pass",
                f,
                low_pass,
                Colour::Green,
                Dash::Dotted,
            )),
        )
}

pub fn all() -> Vec<Figure> {
    vec![bode(), time_series(), spectrum(), step()]
}

/// A page with everything a page can hold.
pub fn page() -> ReportPage {
    let table = Table::new(
        "Tracking error, mean absolute, mm",
        ["condition", "paper", "printed K", "ours", "limit", "met"],
    )
    .row([
        Cell::text("normal"),
        Cell::number(0.0107, 3),
        Cell::number(0.00932, 3),
        Cell::number(0.000842, 3),
        Cell::number(0.001, 2),
        Cell::check(Status::Pass, "yes"),
    ])
    .row([
        Cell::text("disturbance and noise"),
        Cell::number(0.0117, 3),
        Cell::number(0.0108, 3),
        Cell::number(0.00176, 3),
        Cell::number(0.001, 2),
        Cell::check(Status::Fail, "no"),
    ])
    .row([
        Cell::text("not printed"),
        Cell::Empty,
        Cell::number(12.5, 3),
        Cell::number(f64::NAN, 3),
        Cell::Empty,
        Cell::check(Status::Note, "unstable"),
    ]);
    let mut page = ReportPage::new("Diaphragm 2017: robust control and pulse replay")
        .subtitle("Every number of this page is in report.json with its unit.")
        .summary("Identified plant", "DC gain 0.935 mm/unit, 38.0 rad/s, damping 0.21", Some(Status::Pass))
        .summary("Certificate", "max |Ws K S| = 0.209 < 1", Some(Status::Pass))
        .summary("Pulse replay", "lag \u{2212}1.5 ms, NRMSE 1.9 %", None)
        .section("Identification")
        .paragraph("The gain & phase were measured at 3 amplitudes; a < b holds.")
        .figure(&bode())
        .subsection("Step")
        .figure(&step())
        .section("Tracking")
        .table(table)
        .note("Assumption: the paper gives no disturbance size; 10 mN is used.")
        .figure(&time_series())
        .section("Pulse")
        .list(["one", "two"])
        .preformatted("cargo run --release\ncargo test --workspace --release");
    page = page.figure(&spectrum());
    page.footer("telepulse 0.1.0, seed 1")
}

/// Writes the demonstration page and drawings to the folder in `TELEPULSE_FIGURE_DEMO`, for a look in a
/// browser; without it, does nothing.
#[test]
fn law_the_demonstration_renders() {
    let html = page().render();
    assert!(html.ends_with("</html>\n"));
    if let Some(folder) = std::env::var_os("TELEPULSE_FIGURE_DEMO") {
        let folder = std::path::PathBuf::from(folder);
        std::fs::create_dir_all(&folder).expect("folder can be made");
        std::fs::write(folder.join("page.html"), html).expect("page can be written");
        for figure in all() {
            std::fs::write(folder.join(format!("{}.svg", figure.id())), svg::render(&figure))
                .expect("drawing can be written");
        }
    }
}
