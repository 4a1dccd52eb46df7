//! `telepulse track`, and recipes wherever they are read.

use super::Bench;

#[test]
fn edge_a_recipe_that_is_not_what_it_was() {
    let bench = Bench::with_artefacts();
    let recipe = bench.text("h.recipe.json");
    let edited = recipe.replacen("\"d\": 0.0", "\"d\": 0.1", 1);
    assert_ne!(edited, recipe, "the direct term was changed");
    let cases: [(String, &[&str]); 6] = [
        (edited, &["law", "not the one that was certified"]),
        (recipe.replacen("\"version\": 1", "\"version\": 7", 1), &["version 7", "allowed is 1"]),
        (recipe.replacen('{', "{\"gain\": 1,", 1), &["unknown field `gain`", "`law`", "line 1"]),
        (recipe[..recipe.len() / 2].to_owned(), &["EOF", "line"]),
        (String::new(), &["EOF", "line 1"]),
        (bench.text("model.json"), &["unknown field `nominal`", "expected one of", "line 3"]),
    ];
    for (text, named) in cases {
        bench.put("x.recipe.json", &text);
        let named = [&["x.recipe.json"], named].concat();
        let study = ["--study", "st", "--out", "made/run.json"];
        bench.refused(&[&["replay", "x.recipe.json", "pulse.csv"], &study[..]].concat(), &named);
        bench.refused(
            &[&["track", "x.recipe.json", "--reference", "reference.csv"], &study[..]].concat(),
            &named,
        );
        bench.put("recipes/best.force.recipe.json", &text);
        let receive = ["receive", "--out", "made", "--study", "st", "--recipes", "recipes"];
        bench.refused(&receive, &["best.force.recipe.json", named[1]]);
    }
}

#[test]
fn edge_a_reference_in_a_unit_that_would_be_scaled_silently() {
    let bench = Bench::with_artefacts();
    for unit in ["um", "cm", "m", "V"] {
        bench.put("other.csv", &bench.text("reference.csv").replace(",mm\n", &format!(",{unit}\n")));
        let named = ["other.csv", "column `unit`", unit, "`Pa`", "mmHg"];
        bench.refused(&["track", "h.recipe.json", "--reference", "other.csv", "--study", "st"], &named);
        bench.refused(&["replay", "h.recipe.json", "other.csv", "--study", "st"], &named);
    }
}

#[test]
fn edge_a_recipe_for_another_study() {
    let bench = Bench::with_artefacts();
    bench.edit_study("sample_rate_hz = 2000.0", "sample_rate_hz = 1000.0");
    let named = ["h.recipe.json", "study.toml", "sample time of 0.0005 s", "0.001 s"];
    bench.refused(
        &["replay", "h.recipe.json", "pulse.csv", "--study", "st", "--out", "made/run.json"],
        &named,
    );
    bench.refused(&["track", "h.recipe.json", "--reference", "reference.csv", "--study", "st"], &named);
    bench.edit_study("sample_rate_hz = 1000.0", "sample_rate_hz = 2000.0");
    bench.edit_study("\nmax_v = 5000.0", "\nmax_v = 4000.0");
    bench.edit_study("amplitudes = [0.2, 0.4, 0.5]", "amplitudes = [0.2]");
    let named = ["h.recipe.json", "study.toml", "0 to 5000 V", "0 to 4000 V"];
    bench.refused(&["replay", "h.recipe.json", "pulse.csv", "--study", "st"], &named);
    // The same controller in the other mode would be a certified recipe in front of another plant.
    bench.refused(
        &["replay", "h.recipe.json", "pulse.csv", "--study", "st", "--mode", "force"],
        &["h.recipe.json", "the displacement of the plate", "the relief of the load cell"],
    );
}

/// The recipe of the bench with a well damped PID instead of its law, and weights where they are given.
fn pid_recipe(bench: &Bench, weights: Option<[f64; 2]>) -> String {
    let mut recipe: serde_json::Value = serde_json::from_str(&bench.text("h.recipe.json")).expect("JSON");
    recipe["law"] = serde_json::json!({"pid": {"p": 1.5, "i_per_s": 10.0, "d_s": 0.03, "n_rad_s": 1000.0}});
    recipe["provenance"] =
        serde_json::json!({"uncertified": {"reason": "two degrees of freedom, for a test"}});
    if let Some([b, c]) = weights {
        recipe["settings"]["setpoint_weights"] = serde_json::json!({"b": b, "c": c});
    }
    recipe.to_string()
}

#[test]
fn law_setpoint_weights_of_a_recipe_shape_the_step_and_nothing_else() {
    let bench = Bench::with_artefacts();
    // 0.3 mm, and after 3 s 0.5 mm.
    let lines =
        (0..600).map(|k| format!("{:.2},{},mm\n", f64::from(k) * 0.01, if k < 300 { 0.3 } else { 0.5 }));
    bench.put("step.csv", &format!("time_s,value,unit\n{}", lines.collect::<String>()));
    let run = |name: &str, weights: Option<[f64; 2]>| {
        bench.put("x.recipe.json", &pid_recipe(&bench, weights));
        bench.done(&["track", "x.recipe.json", "--reference", "step.csv", "--study", "st", "--out", name]);
        let trace: serde_json::Value = serde_json::from_str(&bench.text(name)).expect("JSON");
        let series = |key: &str| -> Vec<f64> {
            trace[key].as_array().expect("a series").iter().map(|v| v.as_f64().expect("a number")).collect()
        };
        [series("time_s"), series("output"), series("voltage_kv")]
    };
    let one = run("one.json", None);
    // Weights of one are no weights, to the last bit.
    assert_eq!(one, run("same.json", Some([1.0, 1.0])));
    let two = run("two.json", Some([0.2, 0.0]));
    assert!(one[0].len() == two[0].len() && one[0].len() > 1000);
    let most = |series: &[f64]| series.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let [overshoot_mm, weighted_mm] = [&one, &two].map(|run| most(&run[1]) - 0.5);
    // What the reference kicks is gone: most of the overshoot, and the drive no longer reaches its limit of 5 kV.
    assert!(overshoot_mm > 0.02 && weighted_mm < 0.25 * overshoot_mm, "{overshoot_mm} {weighted_mm}");
    assert!(most(&one[2]) == 5.0 && most(&two[2]) < 4.5, "{} {}", most(&one[2]), most(&two[2]));
    // Integral action brings both to the reference: within 1 % of it in a quarter second before the step and one near the end.
    for (from_s, reference_mm) in [(2.0, 0.3), (5.5, 0.5)] {
        for run in [&one, &two] {
            let settled = run[0].iter().zip(&run[1]).filter(|(t, _)| (from_s..from_s + 0.25).contains(*t));
            let off = settled.map(|(_, y)| (y - reference_mm).abs()).fold(0.0, f64::max);
            assert!(off < 0.01 * reference_mm, "{from_s} s: off by {off} mm");
        }
    }
}

#[test]
fn edge_setpoint_weights_out_of_range_or_of_another_law() {
    let bench = Bench::with_artefacts();
    let track =
        ["track", "x.recipe.json", "--reference", "reference.csv", "--study", "st", "--out", "made/run.json"];
    let replay = ["replay", "x.recipe.json", "pulse.csv", "--study", "st", "--out", "made/run.json"];
    for (weights, named) in
        [([1.5, 0.0], ["setpoint_weights.b", "1.5"]), ([0.5, -0.1], ["setpoint_weights.c", "-0.1"])]
    {
        bench.put("x.recipe.json", &pid_recipe(&bench, Some(weights)));
        let named = [&["x.recipe.json", "0 to 1"][..], &named].concat();
        bench.refused(&track, &named);
        bench.refused(&replay, &named);
    }
    let good = pid_recipe(&bench, Some([0.5, 0.0]));
    for (old, new, named) in [
        // A half of the pair, a third weight, and a controller that would rest at half of the reference.
        ("\"b\":0.5,", "", ["missing field `b`", "x.recipe.json"]),
        ("\"b\":0.5,", "\"b\":0.5,\"d\":1.0,", ["unknown field `d`", "x.recipe.json"]),
        ("\"i_per_s\":10.0", "\"i_per_s\":0.0", ["setpoint_weights.b", "without integral gain"]),
    ] {
        assert_eq!(good.matches(old).count(), 1, "{old}");
        bench.put("x.recipe.json", &good.replace(old, new));
        bench.refused(&track, &named);
    }
    // The certified state-space law has nothing to weigh.
    let mut recipe: serde_json::Value = serde_json::from_str(&bench.text("h.recipe.json")).expect("JSON");
    recipe["settings"]["setpoint_weights"] = serde_json::json!({"b": 0.5, "c": 0.0});
    bench.put("x.recipe.json", &recipe.to_string());
    bench.refused(&track, &["x.recipe.json", "`setpoint_weights`", "PID"]);
}

/// A run of the bench's recipe with a line added to `[actuator]`.
fn tracked_with(line: &str) -> serde_json::Value {
    let bench = Bench::with_artefacts();
    bench.edit_study("seed = 20170728", &format!("seed = 20170728\n{line}"));
    bench.json(&["track", "h.recipe.json", "--reference", "reference.csv", "--study", "st"])
}

#[test]
fn law_field_level_run_agrees_with_the_reduced_one_within_the_stated_error() {
    let [reduced, field] = ["reduced", "field"].map(|fidelity| {
        let answer = tracked_with(&format!("fidelity = \"{fidelity}\""));
        assert_eq!(answer["fidelity"], fidelity);
        answer
    });
    let number = |answer: &serde_json::Value, key: &str| answer[key].as_f64().expect("a number");
    // Stated for set A: 1.2e-4 mm over a step to full scale, 4e-5 mm over (25); the larger one.
    for key in ["mean_abs_error_mm", "max_abs_error_mm"] {
        let difference = (number(&reduced, key) - number(&field, key)).abs();
        assert!(difference < 1.2e-4, "{key}: {difference} mm");
        assert!(difference > 0.0, "{key}: two models, not one twice");
    }
}

#[test]
fn law_run_on_self_sensing_is_stable_and_says_how_far_it_was_from_the_truth() {
    let answer = tracked_with("sensor = \"capacitance\"");
    assert_eq!(answer["sensor"], "capacitance");
    assert!(answer["unstable"] != true, "{answer}");
    let number = |key: &str| answer[key].as_f64().expect("a number");
    // 0.02 mm beside the noise, of which the largest of 40 000 readings is 4.3 standard deviations.
    assert!(number("sensing_error_max_mm") < 0.02 + 4.3 * number("sensing_standard_deviation_max_mm"));
    assert!(number("mean_abs_error_mm") < 0.02);
    let provenance = answer["provenance"].as_str().expect("text");
    assert!(provenance.contains("the lag of self-sensing is in no certificate"), "{provenance}");
    let laser = tracked_with("sensor = \"laser\"");
    assert!(laser.get("sensing_error_max_mm").is_none());
}

#[test]
fn edge_limits_that_follow_from_the_envelope_and_those_beyond_it() {
    let track = ["track", "h.recipe.json", "--reference", "reference.csv", "--study", "st"];
    let bench = Bench::with_artefacts();
    bench.edit_study("\nmax_v = 5000.0", "");
    bench.json(&track);
    // 0.5 mA charge 2.98 nF at up to 73 kV/s beside the leak, with a factor of 0.8.
    bench.edit_study("full_scale_v = 5000.0", "full_scale_v = 5000.0\ncurrent_a = 0.0005");
    bench.json(&track);
    bench.edit_study("current_a = 0.0005", "current_a = 0.0005\nslew_v_per_s = 100000.0");
    bench.refused(&track, &["study.toml", "`control.slew_v_per_s`", "100000", "current"]);
    bench.edit_study("slew_v_per_s = 100000.0", "slew_v_per_s = -1.0");
    bench.refused(&track, &["study.toml", "`control.slew_v_per_s`", "-1"]);
    // A current that the leak takes up: 0.08 mA through 27.4 Mohm are 2192 V.
    bench.edit_study("current_a = 0.0005\nslew_v_per_s = -1.0", "current_a = 0.0001\nmax_v = 4000.0");
    bench.edit_study("amplitudes = [0.2, 0.4, 0.5]", "amplitudes = [0.2]");
    bench.refused(&track, &["`control.max_v`", "4000", "2192", "amplifier current"]);
    let bench = Bench::with_artefacts();
    for (typed, named) in
        [("fidelity = \"exact\"", ["fidelity", "exact"]), ("sensor = \"eye\"", ["sensor", "eye"])]
    {
        bench.edit_study("seed = 20170728", &format!("seed = 20170728\n{typed}"));
        bench.refused(&track, &["study.toml", named[0], named[1]]);
        bench.edit_study(&format!("seed = 20170728\n{typed}"), "seed = 20170728");
    }
}
