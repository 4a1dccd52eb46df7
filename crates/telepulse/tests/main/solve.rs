//! `telepulse solve`: problem files in, answers out, judged by arithmetic of their own.

// A skipped test must say so.
#![allow(clippy::print_stderr)]

use std::io::Write;
use std::process::{Command, Output, Stdio};

use num_complex::Complex64;
use serde_json::{Value, json};

/// Runs `telepulse solve PROBLEM - --json` on a problem given through standard input.
fn run(problem: &str, file: &str) -> Output {
    let mut child = Command::new(env!("CARGO_BIN_EXE_telepulse"))
        .args(["solve", problem, "-", "--json"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    child.stdin.take().expect("piped").write_all(file.as_bytes()).expect("written");
    child.wait_with_output().expect("the program ends")
}

fn solved(problem: &str, file: &Value) -> Value {
    let output = run(problem, &file.to_string());
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{said} {}", String::from_utf8_lossy(&output.stdout));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// Exit code 2, nothing on standard output, one line that names all of `named`.
fn refused(problem: &str, file: &str, named: &[&str]) {
    let output = run(problem, file);
    let said = String::from_utf8(output.stderr).expect("UTF-8");
    assert_eq!(output.status.code(), Some(2), "{file}: {said}");
    assert!(output.stdout.is_empty(), "{file}: answered all the same");
    assert_eq!(said.lines().count(), 1, "{file}: {said}");
    for part in named {
        assert!(said.contains(part), "{file}: `{part}` is not in: {said}");
    }
}

/// `z = [x + w1; u]`, `y = x + w2` for the unstable plant `x' = x + w1 + u`.
fn unstable_plant() -> Value {
    json!({
        "A": [[1]], "B1": [[1, 0]], "B2": [[1]], "C1": [[1], [0]], "C2": [[1]],
        "D11": [[0, 0], [0, 0]], "D12": [[0], [1]], "D21": [[0, 1]], "D22": [[0]],
        "n": 1, "nw": 2, "nu": 1, "nz": 2, "ny": 1, "id": "unstable"
    })
}

#[test]
fn law_a_synthesized_controller_stabilizes_by_the_plainest_arithmetic() {
    let answer = solved("hinfsyn", &unstable_plant());
    assert_eq!(answer["status"], "ok");
    // X and Y of this plant solve 2x - x² (1 - 1/g²) + 1 = 0 alike; with x = y, x² < g² binds: x = g gives
    // 2g - g² + 2 = 0, so the optimum is 1 + sqrt(3).
    let optimum = 1.0 + 3.0_f64.sqrt();
    let number = |key: &str| answer[key].as_f64().expect("a number");
    assert!(number("gamma_lower") <= optimum && optimum <= number("gamma_upper"), "{answer}");
    assert!(number("gamma_upper") / number("gamma_lower") < 1.0 + 1e-3);
    assert!(number("achieved_norm") <= 1.01 * optimum && number("achieved_norm") >= optimum * (1.0 - 1e-9));
    // The closed loop x' = x + u, u = c xk + d y, xk' = a xk + b y has the characteristic polynomial
    // s² - (1 + d + a) s + a (1 + d) - b c.
    let k = |part: &str| answer["controller"][part][0][0].as_f64().expect("one state");
    let (a, b, c, d) = (k("A"), k("B"), k("C"), k("D"));
    assert!(1.0 + d + a < 0.0 && a * (1.0 + d) - b * c > 0.0, "{answer}");
    assert!(answer["regularization"].is_null() && answer["binding_condition"].is_string());
    assert_eq!(answer["stable"], true);
    assert_eq!(answer["closed_loop_poles"].as_array().map(Vec::len), Some(2));
}

#[test]
fn law_a_sampled_plant_has_the_optimum_of_its_bilinear_image() {
    // x' = x/3 + w1 + u, z = [x; u], y = x + w2 has the optimum g with 2g/3 - g² + 2 = 0; s = (z - 1)/(z + 1) keeps it.
    let (b, d) = (1.5 * 2.0_f64.sqrt(), 1.5);
    let plant = json!({
        "A": [[2]], "B1": [[b, 0]], "B2": [[b]], "C1": [[b], [0]], "C2": [[b]],
        "D11": [[d, 0], [0, 0]], "D12": [[d], [1]], "D21": [[d, 1]], "D22": [[d]], "dt": 2
    });
    let answer = solved("hinfsyn", &plant);
    let optimum = 1.0 / 3.0 + (1.0_f64 / 9.0 + 2.0).sqrt();
    let number = |key: &str| answer[key].as_f64().expect("a number");
    assert!(
        number("gamma_lower") <= optimum * (1.0 + 1e-9) && optimum <= number("gamma_upper") * (1.0 + 1e-9),
        "{answer}"
    );
    assert!(number("achieved_norm") <= 1.01 * optimum && number("achieved_norm") >= optimum * (1.0 - 1e-9));
    assert_eq!(answer["controller"]["dt"], 2.0);
    // 1 - P22 K with P22 = 1.5 (z + 1)/(z - 2) and K = d + b c/(z - a), by Jury's conditions.
    let k = |part: &str| answer["controller"][part][0][0].as_f64().expect("one state");
    let (a, bc, d) = (k("A"), k("B") * k("C"), k("D"));
    let p2 = 1.0 - 1.5 * d;
    let p1 = -(2.0 + a) - 1.5 * (d - d * a + bc);
    let p0 = 2.0 * a - 1.5 * (bc - d * a);
    assert!((p0 / p2).abs() < 1.0 && (p1 / p2).abs() < 1.0 + p0 / p2, "{answer}");
}

#[test]
fn law_sizes_are_learned_from_the_matrices() {
    let mut plant = unstable_plant();
    let fields = plant.as_object_mut().expect("an object");
    for key in ["n", "nw", "nu", "nz", "ny", "D11", "D22"] {
        fields.remove(key);
    }
    let full = solved("hinfsyn", &unstable_plant());
    assert_eq!(solved("hinfsyn", &plant)["achieved_norm"], full["achieved_norm"]);
}

#[test]
fn edge_an_answer_that_is_no_controller_has_a_status_and_exit_code_1() {
    let mut hidden = unstable_plant();
    hidden["B2"] = json!([[0]]);
    let mut blind = unstable_plant();
    blind["C2"] = json!([[0]]);
    let mut tight = unstable_plant();
    tight["options"] = json!({"gamma_max": 2.0});
    let mut singular = unstable_plant();
    singular["D12"] = json!([[0], [0]]);
    singular["options"] = json!({"singular": "refuse"});
    for (plant, status) in [
        (hidden, "not_stabilizable"),
        (blind, "not_detectable"),
        (tight, "infeasible"),
        (singular, "singular"),
    ] {
        let output = run("hinfsyn", &plant.to_string());
        assert_eq!(output.status.code(), Some(1), "{status}");
        let answer: Value = serde_json::from_slice(&output.stdout).expect("JSON");
        assert_eq!(answer["status"], status, "{answer}");
        assert!(answer["controller"].is_null() && answer["achieved_norm"].is_null());
        assert!(!answer["message"].as_str().expect("text").is_empty());
    }
}

#[test]
fn law_norms_of_systems_that_can_be_solved_by_hand() {
    // 1 / (s² + 2 zeta s + 1) peaks at 1 / (2 zeta sqrt(1 - zeta²)), at sqrt(1 - 2 zeta²).
    let zeta = 0.05_f64;
    let lag = json!({"A": [[0, 1], [-1, -2.0 * zeta]], "B": [[0], [1]], "C": [[1, 0]], "D": [[0]]});
    let answer = solved("hinfnorm", &lag);
    let exact = 1.0 / (2.0 * zeta * (1.0 - zeta * zeta).sqrt());
    let number = |answer: &Value, key: &str| answer[key].as_f64().expect("a number");
    assert!((number(&answer, "value") / exact - 1.0).abs() < 1e-9, "{answer}");
    assert!(
        number(&answer, "lower") <= exact * (1.0 + 1e-12)
            && exact <= number(&answer, "upper") * (1.0 + 1e-12)
    );
    assert!((number(&answer, "omega_rad_s") - (1.0 - 2.0 * zeta * zeta).sqrt()).abs() < 1e-4);
    // z / (z - 0.5) at z = 1 is 2; the same matrices in continuous time are unstable.
    let sampled = json!({"A": [[0.5]], "B": [[1]], "C": [[0.5]], "D": [[1]], "dt": 0.1});
    assert!((number(&solved("hinfnorm", &sampled), "value") - 2.0).abs() < 1e-9);
    let mut unstable = sampled;
    unstable["dt"] = json!(0);
    let output = run("hinfnorm", &unstable.to_string());
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(serde_json::from_slice::<Value>(&output.stdout).expect("JSON")["status"], "unstable");
    // No states.
    let gain = json!({"A": [], "B": [], "C": [[], []], "D": [[3, 0], [0, 4]], "n": 0, "m": 2, "p": 2});
    assert!((number(&solved("hinfnorm", &gain), "value") - 4.0).abs() < 1e-14);
}

#[test]
fn law_matrix_equations_of_one_unknown() {
    let x = |answer: &Value| answer["X"][0][0].as_f64().expect("one unknown");
    // -2x - (x + 1)² + 2 = 0.
    let care = json!({"A": [[-1]], "B": [[1]], "Q": [[2]], "R": [[1]], "S": [[1]]});
    assert!((x(&solved("care", &care)) - (5.0_f64.sqrt() - 2.0)).abs() < 1e-14);
    let lyap = json!({"A": [[-2]], "Q": [[1]]});
    assert!((x(&solved("lyap", &lyap)) - 0.25).abs() < 1e-15);
    // A Sylvester equation 2 x + 3 x - 10 = 0, and x = 4 x/(1 + x) + 1 as a discrete Riccati equation with a = 2, q = 1:
    // x = 4 x - 4 x²/(1 + x) + 1, so x² - 4 x - 1 = 0.
    let sylvester = json!({"A": [[2]], "B": [[3]], "C": [[-10]]});
    assert!((x(&solved("lyap", &sylvester)) - 2.0).abs() < 1e-14);
    let dare = json!({"A": [[2]], "B": [[1]], "Q": [[1]], "R": [[1]], "dt": 1});
    let answer = solved("care", &dare);
    assert!((x(&answer) - (2.0 + 5.0_f64.sqrt())).abs() < 1e-13, "{answer}");
    assert!(
        answer["residual_relative"].as_f64().expect("a number") < 1e-14 && answer["condition"].is_number()
    );
    let stein = json!({"A": [[0.5]], "Q": [[3]], "dt": 1});
    assert!((x(&solved("lyap", &stein)) - 4.0).abs() < 1e-14);
}

#[test]
fn regress_a_riccati_equation_without_a_solution_is_an_answer_in_discrete_time_too() {
    // Once refused with exit code 2, as if the file could not be read. x = x/(1 + x) - 1 is x² + x + 1 = 0, without a real
    // root; in continuous time -x² - 1 = 0 has none either.
    let mut equation = json!({"A": [[1]], "B": [[1]], "Q": [[-1]], "R": [[1]], "dt": 1});
    for (dt, place) in [(1, "unit circle"), (0, "imaginary axis")] {
        equation["dt"] = json!(dt);
        if dt == 0 {
            equation["A"] = json!([[0]]);
        }
        let output = run("care", &equation.to_string());
        assert_eq!(output.status.code(), Some(1), "{place}");
        let answer: Value = serde_json::from_slice(&output.stdout).expect("JSON");
        assert_eq!(answer["status"], "infeasible", "{answer}");
        assert!(
            answer["X"].is_null() && answer["message"].as_str().expect("text").contains(place),
            "{answer}"
        );
    }
    // The same weights with the sign that has a solution: x² - x - 1 = 0.
    let solvable = json!({"A": [[1]], "B": [[1]], "Q": [[1]], "R": [[1]], "dt": 1});
    let x = solved("care", &solvable)["X"][0][0].as_f64().expect("one unknown");
    assert!((x - 0.5 * (1.0 + 5.0_f64.sqrt())).abs() < 1e-13, "{x}");
}

#[test]
fn law_bounds_of_mu_enclose_what_can_be_solved_by_hand() {
    let number = |answer: &Value, key: &str| answer[key].as_f64().expect("a number");
    // Two scalar blocks around [0 a; b 0]: the geometric mean. One full block: the largest singular value. A repeated scalar:
    // the spectral radius.
    for (blocks, exact) in [
        (json!([[1, 1], [1, 1]]), 2.0),
        (json!([[2, 2]]), 4.0),
        (json!([[2, 0]]), 2.0),
        (json!([[-2, 0]]), 2.0),
    ] {
        let answer = solved("mu", &json!({"M": [[0, 4], [1, 0]], "blocks": blocks}));
        let (lower, upper) = (number(&answer, "lower"), number(&answer, "upper"));
        assert!(lower <= exact * (1.0 + 1e-6) && exact <= upper * (1.0 + 1e-9), "{blocks}: {answer}");
        assert!(upper / lower < 1.0 + 1e-6, "{blocks}: {answer}");
    }
    // A real parameter cannot cancel an imaginary gain.
    let rotated = json!({"M": [[0]], "M_imaginary": [[3]], "blocks": [[-1, 0]]});
    assert!(number(&solved("mu", &rotated), "upper") < 1e-6);
    refused("mu", "{\"M\": [[1, 2]], \"blocks\": [[2, 2]]}", &["`M`", "2 x 2", "1 x 2"]);
    refused("mu", "{\"M\": [[1]], \"blocks\": [[0, 1]]}", &["`blocks`", "block 0"]);
}

#[test]
fn law_the_peak_of_mu_is_proven_between_frequencies_and_has_its_place() {
    let number = |answer: &Value, key: &str| answer[key].as_f64().expect("a number");
    // One full block: the peak of |1/(s² + 2 zeta s + 1)|, 1/(2 zeta sqrt(1 - zeta²)), whose width is 1e-4 of the axis.
    let zeta = 5e-5_f64;
    let mut lag = json!({"A": [[0, 1], [-1, -2.0 * zeta]], "B": [[0], [1]], "C": [[1, 0]], "D": [[0]], "blocks": [[1, 1]]});
    let exact = 1.0 / (2.0 * zeta * (1.0 - zeta * zeta).sqrt());
    let answer = solved("mu", &lag);
    let (lower, upper) = (number(&answer, "lower"), number(&answer, "upper"));
    assert!(lower <= exact * (1.0 + 1e-9) && exact <= upper * (1.0 + 1e-9), "{answer}");
    // The default tolerance is 1e-3, and both ends have it.
    assert!(upper / lower < 1.002, "{answer}");
    assert!((number(&answer, "omega_rad_s") - 1.0).abs() < 1e-4, "{answer}");
    assert!((number(&answer, "upper_omega_rad_s") - 1.0).abs() < 1e-4, "{answer}");
    assert!(answer["intervals"].as_u64().expect("a count") >= 1);
    // The example: 1 - g delta = 0 at that frequency, so delta = 1 - w² + 2 j zeta w.
    let w = number(&answer, "omega_rad_s");
    let delta = |part: &str| answer["perturbation"][0][part][0][0].as_f64().expect("one block");
    // Rounding of a response of 1e4 against a delta of 1e-4.
    assert!(
        (delta("re") - (1.0 - w * w)).abs() < 1e-11 && (delta("im") - 2.0 * zeta * w).abs() < 1e-11,
        "{answer}"
    );
    // A real parameter only sees the gain at rest, where the response is real.
    lag["blocks"] = json!([[-1, 0]]);
    let answer = solved("mu", &lag);
    assert!(number(&answer, "upper") >= 1.0 && number(&answer, "upper") < 1.01, "{answer}");
    assert!(
        (number(&answer, "lower") - 1.0).abs() < 1e-9 && number(&answer, "omega_rad_s") == 0.0,
        "{answer}"
    );
    // [0 4; 1 0]/(s + 1) between two scalars: the geometric mean at rest. A finer proof on request.
    let pair = json!({"A": [[-1, 0], [0, -1]], "B": [[1, 0], [0, 1]], "C": [[0, 4], [1, 0]], "blocks": [[1, 1], [1, 1]],
        "options": {"tolerance": 1e-5}});
    let answer = solved("mu", &pair);
    assert!(number(&answer, "upper") >= 2.0 && number(&answer, "upper") < 2.0 * (1.0 + 1.1e-5), "{answer}");
    assert!((number(&answer, "lower") - 2.0).abs() < 1e-6, "{answer}");
    // Without states the peak is everywhere, and that of a matrix.
    let gain =
        json!({"A": [], "B": [], "C": [[], []], "D": [[0, 9], [1, 0]], "n": 0, "blocks": [[1, 1], [1, 1]]});
    assert!((number(&solved("mu", &gain), "lower") - 3.0).abs() < 1e-6);
    // The form with one matrix has no place.
    let matrix = solved("mu", &json!({"M": [[1]], "blocks": [[1, 1]]}));
    assert!(matrix.get("omega_rad_s").is_none() && matrix.get("intervals").is_none(), "{matrix}");
}

#[test]
fn law_the_peak_of_mu_of_a_sampled_system_is_found_up_to_its_nyquist_frequency() {
    let number = |answer: &Value, key: &str| answer[key].as_f64().expect("a number");
    // 1/(z + 0.5) is 2 at z = -1; 1/(z - 0.5) is 2 at z = 1; s/(s + 1) in continuous time is 1 at infinity only.
    for (pole, omega) in [(-0.5, std::f64::consts::PI / 0.01), (0.5, 0.0)] {
        let sampled = json!({"A": [[pole]], "B": [[1]], "C": [[1]], "dt": 0.01, "blocks": [[1, 1]]});
        let answer = solved("mu", &sampled);
        assert!(
            (number(&answer, "lower") - 2.0).abs() < 1e-6 && number(&answer, "upper") < 2.005,
            "{answer}"
        );
        assert!((number(&answer, "omega_rad_s") - omega).abs() < 1e-6 * (1.0 + omega), "{answer}");
    }
    let high = json!({"A": [[-1]], "B": [[1]], "C": [[-1]], "D": [[1]], "blocks": [[1, 1]]});
    let answer = solved("mu", &high);
    assert!((number(&answer, "lower") - 1.0).abs() < 1e-6, "{answer}");
    assert!(answer["omega_rad_s"].is_null() && answer["upper_omega_rad_s"].is_null(), "{answer}");
    assert!(!answer["perturbation"].is_null(), "{answer}");
    // Unstable in one time and not in the other.
    for (pole, dt, pole_named) in [(0.5, 0.0, "0.5"), (-2.0, 0.1, "-2")] {
        let unstable = json!({"A": [[pole]], "B": [[1]], "C": [[1]], "dt": dt, "blocks": [[1, 1]]});
        let output = run("mu", &unstable.to_string());
        assert_eq!(output.status.code(), Some(1));
        let answer: Value = serde_json::from_slice(&output.stdout).expect("JSON");
        assert_eq!(answer["status"], "unstable", "{answer}");
        assert!(
            answer["upper"].is_null() && answer["message"].as_str().expect("text").contains(pole_named),
            "{answer}"
        );
    }
}

#[test]
fn edge_a_system_that_does_not_fit_its_blocks_is_refused_with_key_and_sizes() {
    let system = |key: &str, value: Value| {
        let mut system = json!({"A": [[-1]], "B": [[1, 0]], "C": [[1], [0]], "D": [[0, 0], [0, 0]], "blocks": [[1, 1], [1, 1]]});
        system[key] = value;
        system.to_string()
    };
    refused("mu", &system("B", json!([[1]])), &["`B`", "1 (n, by `A`) x 2 (w of `blocks`), found 1 x 1"]);
    refused(
        "mu",
        &system("C", json!([[1], [0], [0]])),
        &["`C`", "2 (z of `blocks`) x 1 (n, by `A`), found 3 x 1"],
    );
    refused(
        "mu",
        &system("D", json!([[0, 0]])),
        &["`D`", "2 (z of `blocks`) x 2 (w of `blocks`), found 1 x 2"],
    );
    refused("mu", &system("A", json!([[-1, 0]])), &["`A`", "1 x 2"]);
    refused("mu", &system("A", json!([["x"]])), &["`A`", "row 0, column 0", "\"x\""]);
    refused("mu", &system("B", Value::Null), &["`B`", "missing"]);
    refused("mu", &system("blocks", Value::Null), &["`blocks`", "missing"]);
    refused("mu", &system("blocks", json!([[1.5, 1]])), &["`blocks`", "block 0", "1.5"]);
    refused("mu", &system("blocks", json!([[1, 1, 1]])), &["`blocks`", "1 x 3"]);
    refused("mu", &system("m", json!(3)), &["`m`", "expected 2 by `blocks`, found 3"]);
    refused("mu", &system("p", json!(1)), &["`p`", "expected 2 by `blocks`, found 1"]);
    refused("mu", &system("dt", json!(-0.1)), &["`dt`", "-0.1"]);
    refused("mu", &system("M", json!([[1]])), &["`M`", "beside a system"]);
    refused("mu", &system("M_imaginary", json!([[1]])), &["`M_imaginary`", "beside a system"]);
    refused("mu", &system("options", json!({"tolerance": 0})), &["`tolerance`", "0.000001 to 1, found 0"]);
    refused("mu", &system("options", json!({"tolerence": 0.1})), &["`tolerence`", "tolerance"]);
    refused("mu", "{\"blocks\": [[1, 1]]}", &["`M`", "missing", "`A`, `B`, `C`, `D`"]);
}

#[test]
fn law_a_reduced_system_keeps_its_bound() {
    // 1/(s + 1) + 1/(s + 100): the fast mode has the Hankel singular value near 1/200.
    let sys = json!({"A": [[-1, 0], [0, -100]], "B": [[1], [1]], "C": [[1, 1]], "D": [[0]]});
    for method in ["truncate", "residualize", "hankel"] {
        let mut file = sys.clone();
        file["options"] = json!({"method": method, "order": 1});
        let answer = solved("reduce", &file);
        let number = |key: &str| answer[key].as_f64().expect("a number");
        assert_eq!(answer["order"], 1);
        assert!(
            number("error") <= number("error_bound") * (1.0 + 1e-9) && number("error") > 1e-4,
            "{answer}"
        );
        // The error at rest of what is left: 1.01 minus its gain.
        let part = |key: &str| answer["system"][key][0][0].as_f64().expect("one state");
        let at_rest = part("D") - part("C") * part("B") / part("A");
        assert!((at_rest - 1.01).abs() <= number("error") * (1.0 + 1e-9), "{method}: {answer}");
    }
    // (s - 1)/((s - 1)(s + 2)) without the common factor, unstable as it is.
    let cancelled = json!({"A": [[0, 1], [2, -1]], "B": [[0], [1]], "C": [[-1, 1]], "D": [[0]],
        "options": {"method": "minimal"}});
    assert_eq!(solved("reduce", &cancelled)["order"], 1);
    let mut file = sys.clone();
    file["options"] = json!({"order": 7});
    refused("reduce", &file.to_string(), &["7"]);
    file["options"] = json!({"order": 1, "error_max": 0.1});
    refused("reduce", &file.to_string(), &["`order`", "several"]);
}

#[test]
fn law_pid_settings_keep_their_limits_by_a_grid_of_its_own() {
    let plant =
        json!({"numerator": [1], "denominator": [1, 3, 3, 1], "options": {"ms_max": 2.0, "mt_max": 2.0}});
    let answer = solved("pid", &plant);
    let gain = |key: &str| answer["settings"][key].as_f64().expect("a number");
    let (p, i) = (gain("p"), gain("i_per_s"));
    // |1 + G C|² by real arithmetic: (1 + j w)³ and C = p - j i / w.
    for k in 0..2000 {
        let w = 10f64.powf(-3.0 + f64::from(k) * 0.003);
        let (re, im) = (1.0 - 3.0 * w * w, 3.0 * w - w.powi(3));
        let (sum_re, sum_im) = (re + p, im - i / w);
        let s = (re * re + im * im).sqrt() / (sum_re * sum_re + sum_im * sum_im).sqrt();
        assert!(s <= 2.0 * (1.0 + 1e-9), "{w}: {s}");
    }
    assert!((i - 0.685).abs() < 2e-3, "{answer}");
    let simc =
        json!({"numerator": [1], "denominator": [1, 1], "delay_s": 0.5, "options": {"method": "simc"}});
    // First order plus delay, tight: k = tau / (2 theta), Ti = min(tau, 8 theta).
    let answer = solved("pid", &simc);
    assert!((answer["settings"]["p"].as_f64().expect("a number") - 1.0).abs() < 1e-12, "{answer}");
    assert!((answer["settings"]["i_per_s"].as_f64().expect("a number") - 1.0).abs() < 1e-12, "{answer}");
    refused("pid", "{\"numerator\": [1, 0, 0], \"denominator\": [1, 1]}", &["`denominator`"]);
}

/// `C(j w) / (j w + 1)³` with the delay, by the formula of the settings.
fn loop_of_three_lags(answer: &Value, omega: f64, delay_s: f64) -> Complex64 {
    let gain = |key: &str| answer["settings"][key].as_f64().expect("a number");
    let s = Complex64::new(0.0, omega);
    let derivative = if gain("d_s") == 0.0 {
        Complex64::ZERO
    } else {
        gain("d_s") * gain("n_rad_s") * s / (s + gain("n_rad_s"))
    };
    let integral = if gain("i_per_s") == 0.0 { Complex64::ZERO } else { gain("i_per_s") / s };
    (gain("p") + integral + derivative) * (-s * delay_s).exp() / (s + 1.0).powi(3)
}

fn three_lags(options: &Value) -> Value {
    json!({"numerator": [1], "denominator": [1, 3, 3, 1], "delay_s": 0.2, "options": options})
}

#[test]
fn law_pid_by_phase_margin_crosses_where_and_as_it_is_told() {
    for (structure, omega) in [("pi", 0.4), ("pd", 1.2), ("pid", 0.9), ("pidf", 0.9)] {
        for focus in ["balanced", "reference", "disturbance"] {
            let answer = solved(
                "pid",
                &three_lags(&json!({"method": "phase_margin", "structure": structure, "focus": focus,
                    "crossover_rad_s": omega, "phase_margin_deg": 50, "filter_ratio": 40, "ms_max": 2})),
            );
            let found = loop_of_three_lags(&answer, omega, 0.2);
            // e^{j (50 - 180) degrees}; rounding alone is between them.
            let wanted = Complex64::from_polar(1.0, (-130.0_f64).to_radians());
            assert!((found - wanted).norm() < 1e-9, "{structure} {focus}: {answer}");
            assert_eq!(answer["crossover_rad_s"], omega);
            let n_rad_s = answer["settings"]["n_rad_s"].as_f64().expect("a number");
            match structure {
                "pi" => assert_eq!(answer["settings"]["d_s"], 0.0),
                "pidf" => assert!(n_rad_s <= 40.0 * omega * (1.0 + 1e-12), "{answer}"),
                _ => assert!((n_rad_s / (40.0 * omega) - 1.0).abs() < 1e-12, "{answer}"),
            }
            assert!(answer.get("binding").is_none());
        }
    }
    // One term only crosses where it is told, with the margin or more.
    for (structure, omega) in [("p", 0.4), ("i", 0.1)] {
        let options = json!({"method": "phase_margin", "structure": structure, "crossover_rad_s": omega});
        let found = loop_of_three_lags(&solved("pid", &three_lags(&options)), omega, 0.2);
        assert!(
            (found.norm() - 1.0).abs() < 1e-9 && found.arg().to_degrees() > -120.0,
            "{structure}: {found}"
        );
    }
}

#[test]
fn law_pid_by_phase_margin_chooses_a_crossover_within_the_peak_of_s() {
    let options =
        json!({"method": "phase_margin", "structure": "pid", "phase_margin_deg": 55, "ms_max": 1.6});
    let answer = solved("pid", &three_lags(&options));
    let mut peak = 0.0_f64;
    for k in 0..4000 {
        let omega = 10f64.powf(-3.0 + f64::from(k) * 0.0015);
        let open = loop_of_three_lags(&answer, omega, 0.2);
        peak = peak.max((1.0 + open).norm().recip());
        // Where the gain is one to a grid step's slope, the phase is 55 degrees or more above -180.
        if (open.norm().ln()).abs() < 1e-3 {
            assert!(180.0 - open.arg().to_degrees().abs() > 54.8, "{omega}: {answer}");
        }
    }
    assert!(peak <= 1.6 && peak > 1.2, "{peak}: {answer}");
    let crossover = answer["crossover_rad_s"].as_f64().expect("chosen");
    assert!((loop_of_three_lags(&answer, crossover, 0.2).norm() - 1.0).abs() < 1e-9, "{answer}");
}

#[test]
fn edge_a_margin_out_of_reach_is_infeasible_and_a_wrong_option_is_refused() {
    let unstable = |options: Value| json!({"numerator": [1], "denominator": [1, -1], "delay_s": 0.9, "options": options});
    for (problem, part) in [
        // A PI controller gives no lead: three lags are at -253 degrees there.
        (three_lags(&json!({"method": "phase_margin", "crossover_rad_s": 10})), "within reach"),
        // Three lags at 1 rad/s leave 45 degrees less the delay's 11.
        (three_lags(&json!({"method": "phase_margin", "structure": "p", "crossover_rad_s": 1})), "33.5"),
        (unstable(json!({"method": "phase_margin"})), "no crossover"),
    ] {
        let output = run("pid", &problem.to_string());
        assert_eq!(output.status.code(), Some(1), "{part}: {}", String::from_utf8_lossy(&output.stderr));
        let answer: Value = serde_json::from_slice(&output.stdout).expect("JSON");
        assert_eq!(answer["status"], "infeasible", "{answer}");
        assert!(
            answer["settings"].is_null() && answer["message"].as_str().expect("text").contains(part),
            "{answer}"
        );
    }
    let options = |key: &str, value: Value| {
        let mut options = json!({"method": "phase_margin"});
        options[key] = value;
        three_lags(&options).to_string()
    };
    refused("pid", &options("focus", json!("speed")), &["`focus`", "`reference`"]);
    refused("pid", &options("structure", json!("pii")), &["`structure`", "`pidf`"]);
    refused("pid", &options("phase_margin_deg", json!(200)), &["phase_margin_deg", "200", "0 and 180"]);
    refused("pid", &options("filter_ratio", json!(0.5)), &["filter_ratio", "0.5", "above 1"]);
    refused("pid", &options("ms_max", json!(1)), &["ms_max", "above 1"]);
    refused("pid", &options("crossover_rad_s", json!(-1)), &["crossover_rad_s", "-1", "above 0"]);
    refused("pid", &options("crossover_rad_s", json!("1")), &["`crossover_rad_s`", "expected a number"]);
    refused("pid", &options("mt_max", json!(2)), &["`mt_max`", "no meaning", "`phase_margin`"]);
    refused("pid", &options("method", json!("margin")), &["`method`", "`phase_margin`"]);
    let other = three_lags(&json!({"method": "simc", "focus": "reference"}));
    refused("pid", &other.to_string(), &["`focus`", "no meaning", "`simc`"]);
}

#[test]
fn edge_what_cannot_be_read_is_refused_with_key_and_sizes() {
    let plant = |key: &str, value: Value| {
        let mut plant = unstable_plant();
        plant[key] = value;
        plant.to_string()
    };
    refused("hinfsyn", &plant("B2", json!([[1], [2]])), &["`B2`", "expected 1 (n) x 1 (nu), found 2 x 1"]);
    refused("hinfsyn", &plant("D21", json!([[0, 1, 2]])), &["`D21`", "1 (ny) x 2 (nw), found 1 x 3"]);
    refused(
        "hinfsyn",
        &plant("C1", json!([[1], [0, 1]])),
        &["`C1`", "row 1 has 2 entries where row 0 has 1"],
    );
    refused("hinfsyn", &plant("A", json!([["x"]])), &["`A`", "row 0, column 0", "\"x\""]);
    refused("hinfsyn", &plant("A", json!(null)), &["`A`", "missing"]);
    refused("hinfsyn", &plant("nw", json!(-2)), &["`nw`", "whole number", "-2"]);
    refused("hinfsyn", &plant("options", json!({"backof": 2})), &["`backof`", "backoff"]);
    refused("hinfsyn", &plant("options", json!({"backoff": 0.5})), &["backoff", "0.5"]);
    refused("hinfsyn", "{\"A\": [[NaN]]}", &["`A`", "NaN"]);
    refused("hinfsyn", "[]", &["object"]);
    refused("hinfnorm", "{\"A\": [[1, 2]]}", &["`A`", "1 x 2"]);
    let mismatch = json!({"A": [[-1]], "B": [[1, 2]], "C": [[1]], "D": [[0]]}).to_string();
    refused("hinfnorm", &mismatch, &["`D`", "1 (p) x 2 (m), found 1 x 1"]);
    refused("hinfnorm", "{\"A\": [[-1]], \"B\": [[1]], \"C\": [[1]], \"dt\": -1}", &["`dt`", "-1"]);
    refused("care", "{\"A\": [[1]], \"Q\": [[1]]}", &["`B`", "missing"]);
    refused(
        "lyap",
        "{\"A\": [[-1]], \"Q\": [[1, 2]]}",
        &["`Q`", "1 (n, by `A`) x 1 (n, by `A`), found 1 x 2"],
    );
}

/// The gold cases, where they lie beside the project.
#[test]
fn oracle_reference_problems_are_solved_within_one_per_cent() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/reference/hinfsyn_examples.json");
    let Ok(text) = std::fs::read_to_string(path) else {
        eprintln!("skipped: no reference problems beside the project");
        return;
    };
    let collection: Value = serde_json::from_str(&text).expect("JSON");
    for problem in collection["problems"].as_array().expect("a list") {
        let output = run("hinfsyn", &problem.to_string());
        let answer: Value = serde_json::from_slice(&output.stdout).expect("JSON");
        assert!(answer["seconds"].as_f64().expect("seconds") < 1.0, "{}", problem["id"]);
        if let Some(reference) = problem["gamma_ref"].as_f64() {
            let achieved = answer["achieved_norm"].as_f64().unwrap_or(f64::INFINITY);
            assert!(achieved <= 1.01 * reference, "{}: {achieved} against {reference}", problem["id"]);
        } else {
            assert!(answer["status"] == "ok" || answer["status"] == "singular", "{}", problem["id"]);
        }
    }
}

#[test]
fn regress_mistaken_keys_are_refused_and_keys_of_a_collection_may_hold_anything() {
    // A slip of the pen would leave a matrix at zero or an option at its default.
    let norm = |more: &str| format!("{{\"A\": [[-1]], \"B\": [[1]], \"C\": [[1]]{more}}}");
    refused("hinfsyn", "{\"optoins\": {}}", &["`optoins`", "unknown", "`options` may be meant"]);
    refused("hinfnorm", &norm(", \"d\": [[0]]"), &["`d`", "unknown", "`D` may be meant"]);
    refused("pid", "{\"numerater\": [1]}", &["`numerater`", "`numerator` may be meant"]);
    refused("reduce", &norm(", \"input_weigth\": 1"), &["`input_weigth`", "`input_weight` may be meant"]);
    refused("hinfnorm", &norm(", \"options\": {}"), &["`options`", "unknown"]);
    let free = ", \"name\": 1, \"comment\": [\"x\"], \"gamma_ref\": NaN, \"expect\": {}, \"any\": null";
    assert_eq!(run("hinfnorm", &norm(free)).status.code(), Some(0));
    // Known, but not beside the others.
    let both = "{\"A\": [[-1]], \"G\": [[1]], \"Q\": [[1]], \"S\": [[1]]}";
    refused("care", both, &["`S`", "no meaning"]);
    let of_matrix = "{\"M\": [[1]], \"blocks\": [[1, 1]], \"options\": {\"tolerance\": 0.1}}";
    refused("mu", of_matrix, &["`options`", "no meaning"]);
}

#[test]
fn regress_messages_name_the_key_at_fault() {
    let reduce = |options: Value| {
        json!({"A": [[-1, 0], [0, -2]], "B": [[1], [1]], "C": [[1, 1]], "options": options}).to_string()
    };
    refused("reduce", &reduce(json!({"error_max": -1})), &["`error_max`", "0 or more", "-1"]);
    refused("reduce", &reduce(json!({"relative_error_max": -2})), &["`relative_error_max`", "-2"]);
    refused("reduce", &reduce(json!({"order": 7})), &["`order`", "7"]);
    refused("reduce", &reduce(json!({"method": "minimal", "tolerance": 1})), &["`tolerance`", "below 1"]);
    let pid = |key: &str, value: Value| {
        let mut problem = json!({"numerator": [1], "denominator": [1, 1]});
        problem[key] = value;
        problem.to_string()
    };
    refused("pid", &pid("numerator", json!([0])), &["`numerator`", "other than zero"]);
    refused("pid", &pid("delay_s", json!(-1)), &["`delay_s`", "-1"]);
    for (key, found) in [("ms_max", 0.5), ("mt_max", 1.0), ("ks_max", -1.0)] {
        let mut options = json!({});
        options[key] = json!(found);
        refused("pid", &pid("options", options), &[&format!("`{key}`"), "above"]);
    }
    let pole = json!({"structure": "pid", "derivative_filter_rad_s": -1});
    refused("pid", &pid("options", pole), &["`derivative_filter_rad_s`", "-1"]);
    // A is at fault where all others agree; of two, the message names both.
    let b = json!([[1], [1]]);
    let q = json!([[1, 0], [0, 1]]);
    let equation = json!({"A": [[1]], "B": b, "Q": q, "R": [[1]]}).to_string();
    refused("care", &equation, &["`A`", "expected 2 x 2", "`Q` and `B`", "1 x 1"]);
    refused("lyap", &json!({"A": [[1]], "Q": q}).to_string(), &["`Q`", "by `A`", "2 x 2"]);
    // 1e300 was taken for an unstable pole, once squared.
    refused("hinfnorm", "{\"A\": [[-1e300]], \"B\": [[1]], \"C\": [[1]]}", &["`A`", "1e100", "1e300"]);
    refused("pid", &pid("numerator", json!([1e300])), &["`numerator`", "1e100"]);
    let mut plant = unstable_plant();
    let mut options = |options: Value| {
        plant["options"] = options;
        plant.to_string()
    };
    refused("hinfsyn", &options(json!({"backoff": 3})), &["`backoff`", "`relaxation_max`", "3"]);
    refused("hinfsyn", &options(json!({"relaxation_max": 1.001})), &["`relaxation_max`", "1.001"]);
    refused("hinfsyn", &options(json!({"gamma_max": 0})), &["`gamma_max`", "positive"]);
    refused("hinfsyn", &options(json!({"gamma_tolerance": 1})), &["`gamma_tolerance`", "1e-12 to 0.1"]);
    plant["dt"] = json!(0.1);
    plant["options"] = json!({"max_controller_pole_rad_s": 10});
    refused("hinfsyn", &plant.to_string(), &["`max_controller_pole_rad_s`", "`dt`"]);
}
