//! The program as its users meet it: files in, files out, exit codes, and what it says about bad input.
//!
//! Each test runs the built program in a folder of its own.

mod design;
mod every_command;
mod identify;
mod relay;
mod replay;
mod report;
mod send_receive;
mod study;
mod track;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;

use tempfile::TempDir;

const STUDY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../studies/diaphragm-2017");

/// A folder with a study in `st`, and the program.
struct Bench {
    folder: TempDir,
}

impl Bench {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        fs::create_dir(folder.path().join("st")).expect("a new folder");
        for name in ["study.toml", "or_abp_40s.csv"] {
            fs::copy(Path::new(STUDY).join(name), folder.path().join("st").join(name)).expect("the study");
        }
        Self { folder }
    }

    /// A bench that has been through `identify` and `design`: `sweep.csv`, `model.json` and `h.recipe.json` are there.
    ///
    /// The stages run once for all tests.
    fn with_artefacts() -> Self {
        // Contents, not a folder: nothing drops a static, so its folder would stay behind.
        static MADE: OnceLock<[(&str, String); 3]> = OnceLock::new();
        let made = MADE.get_or_init(|| {
            let bench = Self::new();
            bench.done(&["identify", "--study", "st", "--out", "model.json", "--save-sweep", "sweep.csv"]);
            bench.done(&["design", "model.json", "--study", "st", "--out", "h.recipe.json"]);
            ["sweep.csv", "model.json", "h.recipe.json"].map(|name| (name, bench.text(name)))
        });
        let bench = Self::new();
        for (name, content) in made {
            bench.put(name, content);
        }
        bench.put("pulse.csv", &pulse_csv());
        bench.put("reference.csv", &reference_csv());
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn put(&self, name: &str, content: &str) {
        let path = self.path(name);
        fs::create_dir_all(path.parent().expect("inside of the bench")).expect("a folder");
        fs::write(path, content).expect("a file");
    }

    fn text(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    /// Replaces a passage of `st/study.toml`, which must be there once.
    fn edit_study(&self, old: &str, new: &str) {
        let text = self.text("st/study.toml");
        assert_eq!(text.matches(old).count(), 1, "`{old}` must stand once in study.toml");
        self.put("st/study.toml", &text.replace(old, new));
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_telepulse"));
        command.args(arguments).current_dir(self.folder.path()).stdin(Stdio::null());
        command
    }

    fn run(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().expect("the program starts")
    }

    /// Runs what must end with exit code 0; returns standard output.
    fn done(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {said}");
        String::from_utf8(output.stdout).expect("UTF-8")
    }

    /// As [`done`](Self::done), with `--json`.
    fn json(&self, arguments: &[&str]) -> serde_json::Value {
        let text = self.done(&[arguments, &["--json"]].concat());
        serde_json::from_str(&text).unwrap_or_else(|error| panic!("{arguments:?}: {error}: {text}"))
    }

    /// Every file and folder of the bench, with its content.
    fn tree(&self) -> BTreeMap<PathBuf, Vec<u8>> {
        let mut found = BTreeMap::new();
        let mut folders = vec![self.folder.path().to_path_buf()];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(&folder).expect("readable") {
                let path = entry.expect("readable").path();
                if path.is_dir() {
                    found.insert(path.clone(), Vec::new());
                    folders.push(path);
                } else {
                    found.insert(path.clone(), fs::read(&path).expect("readable"));
                }
            }
        }
        found
    }

    /// Runs what must be refused: exit code 2, one line on standard error that names all of `named`, and every file as it was.
    fn refused(&self, arguments: &[&str], named: &[&str]) {
        self.refused_after(arguments, named, 0);
    }

    /// As [`refused`](Self::refused), with lines of progress before the message.
    fn refused_after(&self, arguments: &[&str], named: &[&str], n_progress_lines: usize) {
        let before = self.tree();
        let output = self.run(arguments);
        let said = String::from_utf8(output.stderr).expect("UTF-8");
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert_eq!(said.lines().count(), 1 + n_progress_lines, "{arguments:?}: {said}");
        let message = said.lines().last().unwrap_or_default();
        assert!(message.starts_with("telepulse: "), "{arguments:?}: {message}");
        for part in named {
            assert!(message.contains(part), "{arguments:?}: `{part}` is not in: {message}");
        }
        assert!(output.stdout.is_empty(), "{arguments:?}: something was answered all the same");
        let after = self.tree();
        let names = |tree: &BTreeMap<PathBuf, Vec<u8>>| tree.keys().cloned().collect::<Vec<_>>();
        assert_eq!(names(&before), names(&after), "{arguments:?}: files or folders differ");
        assert!(before == after, "{arguments:?}: a file was changed");
    }
}

/// A pulse of 4 s at 125 Hz.
fn pulse_csv() -> String {
    let lines = (0..500).map(|k| {
        let t = f64::from(k) * 0.008;
        let x = std::f64::consts::TAU * 1.2 * t;
        format!("{t:.3},{},mmHg\n", 80.0 + 20.0 * x.sin() + 8.0 * (2.0 * x).sin())
    });
    format!("time_s,value,unit\n{}", lines.collect::<String>())
}

/// A displacement of 4 s at 100 Hz.
fn reference_csv() -> String {
    let lines = (0..400).map(|k| {
        let t = f64::from(k) * 0.01;
        format!("{t:.2},{},mm\n", 0.45 + 0.2 * (std::f64::consts::PI * t).sin())
    });
    format!("time_s,value,unit\n{}", lines.collect::<String>())
}

/// The response of (16) at eight frequencies: magnitude from a resonance at 38 rad/s.
fn sweep_csv() -> String {
    let lines = [0.1, 0.5, 1.0, 2.0, 4.0, 6.0, 9.0, 13.0].map(|hz: f64| {
        let w = std::f64::consts::TAU * hz;
        let (re, im) = (1444.0 - w * w, 2.0 * 0.21 * 38.0 * w);
        let magnitude = 0.935 * 1444.0 / re.hypot(im) / (0.0045 * w).hypot(1.0);
        let phase_deg = -(im.atan2(re) + (0.0045 * w).atan()).to_degrees();
        // The uneven remainder gives the bound something to bound.
        format!("{hz},0.2,{},{phase_deg}\n", magnitude * (1.0 + 0.02 * (3.0 * w).sin()))
    });
    format!("frequency_hz,amplitude,magnitude,phase_deg\n{}", lines.concat())
}

/// The text with its line `number` (from 1) replaced by what `change` makes of it; an empty result drops the line.
fn with_line(text: &str, number: usize, change: impl Fn(&str) -> String) -> String {
    let mut changed = String::new();
    for (line_idx, line) in text.lines().enumerate() {
        let line = if line_idx + 1 == number { change(line) } else { line.to_owned() };
        if !line.is_empty() {
            changed.push_str(&line);
            changed.push('\n');
        }
    }
    changed
}

fn field(line: &str, column: usize, value: &str) -> String {
    let mut fields: Vec<&str> = line.split(',').collect();
    fields[column] = value;
    fields.join(",")
}

/// A `[plant]` as text.
fn plant(numerator: &str, denominator: &str, bound_denominator: &str) -> String {
    format!(
        "[plant]\nnominal = {{ numerator = [{numerator}], denominator = [{denominator}] }}\n\
         uncertainty = {{ numerator = [487.5], denominator = [{bound_denominator}] }}\n\n[weights]"
    )
}
