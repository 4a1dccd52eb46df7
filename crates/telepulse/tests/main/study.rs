//! The study of the paper, run once by the program itself, and what it must show.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use serde_json::Value;
use telepulse::link::record::verify_log_file;
use telepulse::lti::TransferFunction;
use telepulse::recording;

const CONDITIONS: [&str; 4] = ["normal", "disturbance", "noise", "both"];

struct Ran {
    folder: PathBuf,
    report: Value,
    // Removes the results when the tests end.
    _out: tempfile::TempDir,
}

/// The default study, run by the binary into a temporary folder, once for all tests.
fn ran() -> &'static Ran {
    static RAN: OnceLock<Ran> = OnceLock::new();
    RAN.get_or_init(|| {
        let out = tempfile::tempdir().expect("a temporary folder");
        let study = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../studies/diaphragm-2017");
        let done = Command::new(env!("CARGO_BIN_EXE_telepulse"))
            .args(["study", "run"])
            .arg(&study)
            .arg("--out")
            .arg(out.path())
            .arg("--json")
            .output()
            .expect("the program runs");
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        let folder = out.path().join("diaphragm-2017");
        let text = std::fs::read_to_string(folder.join("report.json")).expect("report.json");
        let report: Value = serde_json::from_str(&text).expect("JSON");
        let printed: Value = serde_json::from_slice(&done.stdout).expect("--json prints JSON");
        assert_eq!(printed, report, "standard output and report.json must hold the same facts");
        Ran { folder, report, _out: out }
    })
}

fn number(path: &[&str]) -> f64 {
    let mut value = &ran().report;
    for key in path {
        value = &value[*key];
    }
    value.as_f64().unwrap_or_else(|| panic!("report.json has no number at {path:?}, found {value}"))
}

#[test]
fn paper_eq16_is_identified_on_twin_a() {
    // Tolerances of the issue: 2 %, 2 % and 0.03. Twin A was fitted to (16), so this judges the identification, not the membrane.
    assert!((number(&["identified", "dc_gain_mm_per_unit"]) / 0.935 - 1.0).abs() <= 0.02);
    assert!((number(&["identified", "omega_n_rad_s"]) / 38.0 - 1.0).abs() <= 0.02);
    assert!((number(&["identified", "zeta"]) - 0.21).abs() <= 0.03);
}

#[test]
fn law_bound_lies_above_every_point_of_the_sweep_file() {
    // Recomputed from the files a user gets, not from the study's own count.
    let identified = &ran().report["identified"];
    let system = |numerator: &str, denominator: &str| {
        let list = |key: &str| -> Vec<f64> {
            identified[key]
                .as_array()
                .expect("a list")
                .iter()
                .map(|c| c.as_f64().expect("a number"))
                .collect()
        };
        TransferFunction::new(&list(numerator), &list(denominator)).expect("proper")
    };
    let plant = system("numerator", "denominator");
    let bound = system("bound_numerator", "bound_denominator");
    let sweep = std::fs::read_to_string(ran().folder.join("identify/sweep.csv")).expect("sweep.csv");
    let mut points = 0;
    for line in sweep.lines().filter(|line| line.starts_with(|c: char| c.is_ascii_digit())) {
        let fields: Vec<f64> = line.split(',').map(|field| field.parse().expect("a number")).collect();
        let omega = std::f64::consts::TAU * fields[0];
        let measured = num_complex::Complex64::from_polar(fields[2], fields[3].to_radians());
        let error = (measured - plant.at(omega)).norm();
        assert!(error <= bound.at(omega).norm(), "{} Hz at {}: error {error}", fields[0], fields[1]);
        points += 1;
    }
    assert_eq!(points, 90, "30 frequencies at 3 amplitudes");
}

#[test]
fn paper_eq19_eq20_own_synthesis_is_near_the_optimum() {
    // Optimum 0.320641 from a high-precision bracket; 1 % back-off.
    let gamma = number(&["synthesis", "gamma_achieved"]);
    assert!((0.32064..=0.3240).contains(&gamma), "{gamma}");
    assert!(number(&["synthesis", "fastest_pole_rad_s"]) < 1e5);
}

#[test]
fn paper_eq24_small_gain_test_of_the_printed_systems() {
    // Half a unit of the last printed digit; 1.7687 is printed where 1.76890 is right.
    assert!((number(&["printed", "norm_ms"]) - 1.7689).abs() < 5e-5);
    assert!((number(&["printed", "norm_ws"]) - 0.24262).abs() < 5e-6);
    assert!((number(&["printed", "frequency_wise"]) - 0.209).abs() < 5e-4);
}

#[test]
fn paper_table_1_errors_on_twin_a() {
    for condition in CONDITIONS {
        // The paper: 0.0107 to 0.0117 mm. Nothing was fitted to it.
        let printed = number(&["tracking", "printed_k", condition, "mean_abs_error_mm"]);
        assert!((0.008..=0.014).contains(&printed), "{condition}: {printed}");
        for table in ["tracking", "tracking_laser_noise"] {
            let best = number(&[table, "best", condition, "mean_abs_error_mm"]);
            assert!(best <= 0.0010, "{table} {condition}: {best}");
        }
    }
}

#[test]
fn paper_sec51_printed_k_is_fragile_and_ours_is_not() {
    // PAPER: gain margin with the filter 1.09 at 0.7 and 0.91 at 0.8 of full scale on the twin.
    let points = ran().report["bias_sweep"].as_array().expect("a list");
    let margin = |controller: &str, bias: f64| {
        let found = points.iter().find(|p| p["controller"] == controller && p["bias"] == bias);
        found.and_then(|p| p["gain_margin"].as_f64()).expect("a margin")
    };
    assert!((margin("printed_k", 0.7) - 1.09).abs() < 0.03);
    assert!((margin("printed_k", 0.8) - 0.91).abs() < 0.03);
    assert_eq!(ran().report["certificates"]["printed_k"]["holds"], false);
    for point in points.iter().filter(|p| p["controller"] == "best" || p["controller"] == "hinf") {
        assert_eq!(point["stable"], true, "{point}");
    }
    assert!(margin("best", 0.9) > 3.0);
}

#[test]
fn paper_fig18_fig20_real_pulse_without_lag() {
    for mode in ["displacement", "force"] {
        assert!(number(&["pulse", "best", mode, "lag_ms"]).abs() <= 2.0);
        assert!(number(&["pulse", "best", mode, "nrmse"]) <= 0.03);
    }
    // The printed controller lags by tens of milliseconds, as the paper says of itself.
    assert!(number(&["pulse", "printed_k", "displacement", "lag_ms"]) > 25.0);
}

#[test]
fn law_voltage_stays_within_0_and_5_kv_in_every_run() {
    let mut runs = 0;
    for table in ["tracking", "tracking_laser_noise", "pulse"] {
        for controller in ran().report[table].as_object().expect("controllers").values() {
            for run in controller.as_object().expect("conditions or modes").values() {
                if let (Some(low), Some(high)) =
                    (run["min_voltage_v"].as_f64(), run["max_voltage_v"].as_f64())
                {
                    assert!(low >= 0.0 && high <= 5000.0, "{run}");
                    runs += 1;
                } else {
                    assert_eq!(run["unstable"], true, "{run}");
                }
            }
        }
    }
    // Without figures are the PIDs: the hand-set one always, the tool's in most runs.
    assert!(runs >= 30, "only {runs} runs have figures");
    for condition in CONDITIONS {
        assert_eq!(ran().report["tracking_laser_noise"]["pid_auto"][condition]["unstable"], true);
        assert_eq!(ran().report["tracking"]["pid_manual"][condition]["unstable"], true);
    }
}

#[test]
fn law_report_names_the_fidelity_with_its_stated_error_and_the_envelope() {
    let device = &ran().report["device"];
    assert_eq!((&device["fidelity"], &device["sensor"]), (&"reduced".into(), &"laser".into()));
    // Required of set A: at most 1 % of stroke over a 5 kV step and over (25).
    for key in ["stated_error_step_percent", "stated_error_reference_percent"] {
        let percent = device[key].as_f64().expect("measured");
        assert!(percent > 0.0 && percent <= 1.0, "{key}: {percent}");
    }
    assert_eq!(device["max_v_derived"], false);
    assert_eq!(device["envelope_limited_by"], "amplifier voltage");
    assert_eq!(device["envelope_unverified"], true, "rupture is assumed");
    let page = std::fs::read_to_string(ran().folder.join("report.html")).expect("report.html");
    for said in ["reduced twin, built from the field-level model", "not verified against their source"] {
        assert!(page.contains(said), "`{said}` is not on the page");
    }
}

#[test]
fn law_doctor_s_log_proves_what_the_patient_sent() {
    let study = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../studies/diaphragm-2017");
    let sent = recording::read(&study.join("or_abp_40s.csv"))
        .expect("the recording")
        .scaled_to_peak_to_peak(827.3709, telepulse::pulse::Unit::Pascal)
        .expect("a pulse");
    let proof = verify_log_file(&ran().folder.join("doctor/session.jsonl"), sent.values()).expect("a proof");
    assert_eq!(proof.n_samples, 5000);
    let received = recording::read(&ran().folder.join("doctor/received.csv")).expect("received.csv");
    let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(received.values()), bits(sent.values()));
    let link = &ran().report["link"];
    assert_eq!(link["bit_exact"], true);
    assert_eq!(link["processes"], 2);
    // One altered bit must be noticed.
    let mut altered = sent.values().to_vec();
    altered[1234] = f64::from_bits(altered[1234].to_bits() ^ 1);
    assert!(verify_log_file(&ran().folder.join("doctor/session.jsonl"), &altered).is_err());
}

#[test]
fn law_report_is_made_again_from_its_data_alone() {
    let again = tempfile::tempdir().expect("a temporary folder");
    let done = Command::new(env!("CARGO_BIN_EXE_telepulse"))
        .arg("report")
        .arg(&ran().folder)
        .arg("--out")
        .arg(again.path())
        .output()
        .expect("the program runs");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    for name in ["report.html", "figures/fig13-tracking.svg", "figures/tracked-pulse.svg"] {
        let read = |folder: &Path| std::fs::read(folder.join(name)).expect(name);
        assert!(read(again.path()) == read(&ran().folder), "{name} differs");
    }
}

#[test]
fn law_paper_md_names_tests_that_exist() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut sources = String::new();
    let mut folders = vec![root.join("crates")];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                sources.push_str(&std::fs::read_to_string(&path).expect("a source file"));
            }
        }
    }
    let text = std::fs::read_to_string(root.join("docs/paper.md")).expect("docs/paper.md");
    let mut named = 0;
    for name in text.split('`').filter(|part| {
        ["paper_", "law_", "oracle_"].iter().any(|kind| part.starts_with(kind)) && !part.contains(' ')
    }) {
        assert!(sources.contains(&format!("fn {name}(")), "docs/paper.md names `{name}`, which is no test");
        named += 1;
    }
    assert!(named >= 15, "docs/paper.md names only {named} tests");
}

#[test]
fn law_a_campaign_repeats_on_any_number_of_threads_and_counts_what_is_unstable() {
    use telepulse::station::replay::read_recipe;
    use telepulse::study::campaign::{campaign, replay};
    use telepulse::study::config::Study;
    let study = Study::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../studies/diaphragm-2017"))
        .expect("valid");
    let recipe = |name: &str| {
        let path = ran().folder.join(format!("recipes/{name}.displacement.recipe.json"));
        (name.to_owned(), read_recipe(&path).expect("a recipe"))
    };
    // The hand-tuned PI is unstable on the device as identified.
    let recipes = vec![recipe("best"), recipe("pid_manual")];
    let on = |n_threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().expect("threads");
        pool.install(|| campaign(&study, &recipes, 6, 3, &|| {})).expect("runs")
    };
    let found = on(1);
    assert_eq!(found, on(2));
    let (best, manual) = (&found["best"], &found["pid_manual"]);
    assert_eq!((best.samples, best.unstable, best.voltage_violations, best.field_violations), (6, 0, 0, 0));
    assert!(manual.unstable > 0, "{manual:?}");
    let worst = best.worst_sample.expect("six samples");
    let again = replay(&study, &recipes, 3, worst).expect("runs");
    assert_eq!(again["best"].mean_abs_error_mm, best.worst_mean_abs_error_mm);
    assert!(campaign(&study, &recipes, 0, 3, &|| {}).is_err());
}
