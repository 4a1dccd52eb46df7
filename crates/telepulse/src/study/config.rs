//! `study.toml`: what was typed, and what it means once checked.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail, ensure};
use serde::{Deserialize, Serialize};
use telepulse_actuator::ParameterSet;
use telepulse_actuator::twin::Fidelity;
use telepulse_design::implement::{PidSettings, SetpointWeights};
use telepulse_lti::TransferFunction;
use toml::de::{DeTable, DeValue};

use crate::station::device;

/// A study as typed in `study.toml`. Units are in the names; unknown keys are refused.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Study {
    /// Version of this file format; 1.
    pub version: u32,
    /// Name of the study: a folder name under `out/`.
    pub name: String,
    /// Title of the report.
    pub title: String,
    /// Which device the virtual rig is.
    pub actuator: Actuator,
    /// How the device is identified.
    pub identify: Identify,
    /// Own plant in place of an identified one.
    pub plant: Option<OwnPlant>,
    /// Weights of the mixed-sensitivity design.
    pub weights: Weights,
    /// Printed systems of the paper the study is compared with.
    pub printed: Printed,
    /// Sampling, filter and limits.
    pub control: Control,
    /// The multi-sine reference.
    pub reference: Reference,
    /// Disturbance and sensing noise.
    pub conditions: Conditions,
    /// PID settings.
    pub pid: PidPair,
    /// The pulse to replay.
    pub pulse: Pulse,
    /// Folder of `study.toml`; paths in it are relative to this.
    #[serde(skip)]
    pub folder: PathBuf,
    /// The file itself.
    #[serde(skip)]
    pub file: PathBuf,
}

/// `[actuator]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Actuator {
    /// `A`, `B` or `C`.
    pub parameter_set: ParameterSet,
    /// Seed of the sensor noise.
    pub seed: u64,
    /// Which model of the device moves: the reduced twin unless given.
    #[serde(default)]
    pub fidelity: Fidelity,
    /// What reads the plate in displacement runs: the laser unless given. Sweeps are read by the laser in any case.
    #[serde(default)]
    pub sensor: SensorChoice,
}

/// What reads the plate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SensorChoice {
    /// A laser above it.
    #[default]
    Laser,
    /// Its own capacitance, by a carrier on the drive.
    Capacitance,
}

impl SensorChoice {
    /// The word in files.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Laser => "laser",
            Self::Capacitance => "capacitance",
        }
    }
}

/// `[identify]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Identify {
    /// Bias of the drive, fraction of full scale.
    pub bias: f64,
    /// Amplitudes of the sine, fractions of full scale.
    pub amplitudes: Vec<f64>,
    /// Lowest frequency.
    pub frequency_min_hz: f64,
    /// Highest frequency.
    pub frequency_max_hz: f64,
    /// Number of frequencies, log-spaced.
    pub n_frequencies: usize,
    /// Time constant of the circuit: seconds, or `"free"`.
    pub rc_s: RcTime,
    /// Own sweep in place of one on the virtual rig.
    pub sweep_csv: Option<PathBuf>,
}

/// A time constant that is known, or left to the fit.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(untagged, expecting = "expected a time in seconds or \"free\"")]
pub enum RcTime {
    /// Known, in seconds.
    Known(f64),
    /// The word `free`.
    Free(FreeWord),
}

/// The word `free`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FreeWord {
    /// Left to the fit.
    Free,
}

/// A transfer function as typed: coefficients in descending powers of s.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Polynomials {
    /// Numerator coefficients.
    pub numerator: Vec<f64>,
    /// Denominator coefficients.
    pub denominator: Vec<f64>,
}

/// `[plant]`: mm per unit of full scale, with the bound of its additive uncertainty.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OwnPlant {
    /// Nominal plant.
    pub nominal: Polynomials,
    /// Bound of the additive uncertainty.
    pub uncertainty: Polynomials,
}

/// `[weights]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Weights {
    /// Weight of the control input, `W_u`.
    pub control: Polynomials,
    /// Weight of the tracking error, `W_e`.
    pub error: Polynomials,
}

/// `[printed]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Printed {
    /// Eq. (16).
    pub plant: Polynomials,
    /// Eq. (17).
    pub uncertainty: Polynomials,
    /// Eq. (21).
    pub controller: Polynomials,
}

/// `[control]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Control {
    /// Ticks per second.
    pub sample_rate_hz: f64,
    /// Corner of the measurement filter, Eq. (26).
    pub filter_hz: f64,
    /// Lowest voltage.
    pub min_v: f64,
    /// Highest voltage that may be commanded, as typed; where it is not, it follows from the failure envelope.
    #[serde(rename = "max_v", default)]
    pub stated_max_v: Option<f64>,
    /// Fastest change of the command, V/s, as typed; where it is not, it follows from `current_a`, if that is given.
    #[serde(rename = "slew_v_per_s", default)]
    pub stated_slew_v_per_s: Option<f64>,
    /// Largest current of the amplifier.
    #[serde(default)]
    pub current_a: Option<f64>,
    /// Highest voltage that may be commanded.
    #[serde(skip)]
    pub max_v: f64,
    /// Fastest change of the command, V/s; infinite where nothing limits it.
    #[serde(skip)]
    pub slew_v_per_s: f64,
    /// Voltage of one unit: what the printed controllers, the sweep and the effort index are normalised by. Not a limit.
    pub full_scale_v: f64,
}

/// `[reference]`: offset plus sines, Eq. (25).
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reference {
    /// Offset from the rest position.
    pub offset_mm: f64,
    /// The sines.
    pub sines: Vec<Sine>,
    /// Time before the measured window.
    pub settle_s: f64,
    /// Length of the measured window.
    pub window_s: f64,
}

/// One sine of the reference: `amplitude_mm * sin(2 pi frequency_hz t + phase_rad)`.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sine {
    /// Amplitude.
    pub amplitude_mm: f64,
    /// Frequency.
    pub frequency_hz: f64,
    /// Phase at t = 0.
    pub phase_rad: f64,
}

/// `[conditions]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Conditions {
    /// Force step on the plate, positive downwards.
    pub disturbance_n: f64,
    /// When the force steps in.
    pub disturbance_start_s: f64,
    /// Amplitude of the sine on the sensor.
    pub noise_mm: f64,
    /// Its frequency.
    pub noise_hz: f64,
}

/// `[pid]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PidPair {
    /// Tuned by a tool.
    pub auto: Pid,
    /// Tuned by hand.
    pub manual: Pid,
}

/// Parallel PID with a filtered derivative: `p + i/s + d n s/(s + n)`, units per mm.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pid {
    /// Proportional gain.
    pub p: f64,
    /// Integral gain, per second.
    pub i: f64,
    /// Derivative gain, seconds.
    pub d: f64,
    /// Corner of the derivative filter.
    pub n_rad_s: f64,
    /// How much of a change of the reference the proportional and the derivative part see; all of it unless given.
    pub setpoint_weights: Option<SetpointWeights>,
}

/// `[pulse]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pulse {
    /// The recording, a CSV with `time_s,value,unit`.
    pub recording: PathBuf,
    /// The recording is scaled to this.
    pub peak_to_peak_pa: f64,
    /// Pressure that makes 1 mm.
    pub pa_per_mm: f64,
    /// Radius of the plate that turns pressure into force.
    pub plate_radius_mm: f64,
    /// How long the doctor's side holds the pulse back.
    pub playout_delay_s: f64,
    /// More recordings that the best controller follows, each a CSV as above.
    #[serde(default)]
    pub files: Vec<PathBuf>,
    /// How far ahead it knows them, one run for each.
    #[serde(default)]
    pub horizons_s: Vec<f64>,
}

impl Polynomials {
    /// The transfer function they describe.
    ///
    /// # Errors
    /// Names `key` where the coefficients do not make a proper transfer function.
    pub fn to_transfer_function(&self, key: &str) -> Result<TransferFunction> {
        for (part, list) in [("numerator", &self.numerator), ("denominator", &self.denominator)] {
            ensure!(!list.is_empty(), "key `{key}.{part}`: found no coefficient, allowed one or more");
        }
        TransferFunction::new(&self.numerator, &self.denominator).with_context(|| format!("key `{key}`"))
    }
}

impl Pid {
    /// The same settings, as the design knows them.
    #[must_use]
    pub fn settings(&self) -> PidSettings {
        PidSettings { p: self.p, i_per_s: self.i, d_s: self.d, n_rad_s: self.n_rad_s }
    }
}

impl Reference {
    /// The reference at `t_s` seconds, in mm from the rest position. Eq. (25).
    #[must_use]
    pub fn at(&self, t_s: f64) -> f64 {
        self.offset_mm
            + self
                .sines
                .iter()
                .map(|s| s.amplitude_mm * (std::f64::consts::TAU * s.frequency_hz * t_s + s.phase_rad).sin())
                .sum::<f64>()
    }
}

impl Study {
    /// Reads and checks `folder/study.toml` (or the file itself).
    ///
    /// # Errors
    /// Names the file, and the key or line, what was found and what is allowed.
    pub fn load(path: &Path) -> Result<Self> {
        let file = if path.is_dir() { path.join("study.toml") } else { path.to_path_buf() };
        let text =
            std::fs::read_to_string(&file).with_context(|| format!("cannot read {}", file.display()))?;
        let mut study: Self = toml::from_str(&text)
            .map_err(|error| anyhow!("in {}: {}", file.display(), one_line(&error, &text)))?;
        study.folder = match file.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent.to_path_buf(),
            _ => PathBuf::from("."),
        };
        study.derive_limits().with_context(|| format!("in {}", file.display()))?;
        study.check().with_context(|| format!("in {}", file.display()))?;
        study.file = file;
        Ok(study)
    }

    /// A path of the study, relative to its folder.
    #[must_use]
    pub fn path(&self, relative: &Path) -> PathBuf {
        self.folder.join(relative)
    }

    /// The recordings that controllers are judged on: `pulse.files`, or the one that is sent where there are none.
    #[must_use]
    pub fn recordings(&self) -> Vec<PathBuf> {
        if self.pulse.files.is_empty() {
            return vec![self.path(&self.pulse.recording)];
        }
        self.pulse.files.iter().map(|file| self.path(file)).collect()
    }

    /// The sweep of the user's own, if the study names one.
    #[must_use]
    pub fn own_sweep(&self) -> Option<PathBuf> {
        self.identify.sweep_csv.as_ref().map(|path| self.path(path))
    }

    /// Where a mistake lies, for a message: the file and a key in it.
    #[must_use]
    pub fn at_key(&self, key: &str) -> String {
        format!("in {}: key `{key}`", self.file.display())
    }

    /// The time between two ticks.
    #[must_use]
    pub fn sample_time_s(&self) -> f64 {
        1.0 / self.control.sample_rate_hz
    }

    /// Takes the limits as typed, and those that are not from the failure envelope of the device.
    fn derive_limits(&mut self) -> Result<()> {
        let control = &mut self.control;
        for (key, found) in [
            ("control.max_v", control.stated_max_v),
            ("control.slew_v_per_s", control.stated_slew_v_per_s),
            ("control.current_a", control.current_a),
        ] {
            if let Some(found) = found {
                ensure!(
                    found.is_finite() && found > 0.0,
                    "key `{key}`: found {found}, allowed finite and above 0"
                );
            }
        }
        let follows = control.stated_max_v.is_none()
            || (control.stated_slew_v_per_s.is_none() && control.current_a.is_some());
        let limits = if follows {
            Some(device::envelope_limits(self.actuator.parameter_set, control.current_a)?)
        } else {
            None
        };
        control.max_v = match (control.stated_max_v, &limits) {
            (Some(stated), _) => stated,
            // Whole volts, downwards: nobody types more.
            (None, Some(limits)) => limits.max_v.floor(),
            (None, None) => unreachable!("limits follow where none is stated"),
        };
        let derived = limits.and_then(|limits| limits.slew_v_per_s);
        control.slew_v_per_s = control.stated_slew_v_per_s.or(derived).unwrap_or(f64::INFINITY);
        Ok(())
    }

    fn check(&self) -> Result<()> {
        ensure!(self.version == 1, "key `version`: found {}, allowed 1", self.version);
        let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
        ensure!(
            !self.name.is_empty() && !self.name.starts_with('.') && self.name.chars().all(plain),
            "key `name`: found {:?}, allowed letters, digits, '-', '_' and '.', not starting with '.'",
            self.name
        );
        within("identify.bias", self.identify.bias, 0.01, 0.99)?;
        ensure!(
            !self.identify.amplitudes.is_empty(),
            "key `identify.amplitudes`: found none, allowed one or more"
        );
        for &amplitude in &self.identify.amplitudes {
            let room = self.identify.bias.min(1.0 - self.identify.bias);
            within("identify.amplitudes", amplitude, 1e-3, room)?;
        }
        within("identify.frequency_min_hz", self.identify.frequency_min_hz, 1e-3, 1e3)?;
        within("identify.frequency_max_hz", self.identify.frequency_max_hz, 1e-3, 1e3)?;
        ensure!(
            self.identify.frequency_min_hz < self.identify.frequency_max_hz,
            "key `identify.frequency_max_hz`: found {}, allowed above frequency_min_hz = {}",
            self.identify.frequency_max_hz,
            self.identify.frequency_min_hz
        );
        within("identify.n_frequencies", self.identify.n_frequencies as f64, 6.0, 1000.0)?;
        if let RcTime::Known(rc_s) = self.identify.rc_s {
            within("identify.rc_s", rc_s, 1e-6, 10.0)?;
        }
        self.check_systems()?;
        within("control.sample_rate_hz", self.control.sample_rate_hz, 200.0, 20_000.0)?;
        within("control.filter_hz", self.control.filter_hz, 0.1, self.control.sample_rate_hz / 4.0)?;
        within("control.min_v", self.control.min_v, 0.0, 5000.0)?;
        within("control.max_v", self.control.max_v, 1.0, 5000.0)?;
        within("control.full_scale_v", self.control.full_scale_v, 100.0, 5000.0)?;
        for &amplitude in &self.identify.amplitudes {
            let (low, high) = (self.identify.bias - amplitude, self.identify.bias + amplitude);
            ensure!(
                low * self.control.full_scale_v >= self.control.min_v
                    && high * self.control.full_scale_v <= self.control.max_v,
                "key `identify.amplitudes`: found {amplitude} about a bias of {}, allowed where the drive stays within min_v = {} V and max_v = {} V",
                self.identify.bias,
                self.control.min_v,
                self.control.max_v
            );
        }
        ensure!(
            self.control.min_v < self.control.max_v,
            "key `control.max_v`: found {} V, allowed above min_v = {} V",
            self.control.max_v,
            self.control.min_v
        );
        self.check_signals()
    }

    fn check_systems(&self) -> Result<()> {
        for (key, typed) in [
            ("weights.control", &self.weights.control),
            ("weights.error", &self.weights.error),
            ("printed.plant", &self.printed.plant),
            ("printed.uncertainty", &self.printed.uncertainty),
            ("printed.controller", &self.printed.controller),
        ] {
            let system = typed.to_transfer_function(key)?;
            ensure!(
                typed.numerator.iter().any(|c| *c != 0.0),
                "key `{key}.numerator`: found only zeros, allowed one coefficient other than zero at least"
            );
            ensure!(
                system.is_stable()?,
                "key `{key}`: found a pole on or right of the imaginary axis, allowed stable systems"
            );
        }
        if let Some(own) = &self.plant {
            own.nominal.to_transfer_function("plant.nominal")?;
            ensure!(
                own.nominal.numerator.iter().any(|c| *c != 0.0),
                "key `plant.nominal.numerator`: found only zeros, allowed one coefficient other than zero at least"
            );
            let bound = own.uncertainty.to_transfer_function("plant.uncertainty")?;
            ensure!(
                bound.is_stable()?,
                "key `plant.uncertainty`: found an unstable pole, allowed stable systems"
            );
        }
        Ok(())
    }

    fn check_signals(&self) -> Result<()> {
        let reference = &self.reference;
        within("reference.offset_mm", reference.offset_mm, 0.0, 10.0)?;
        ensure!(!reference.sines.is_empty(), "key `reference.sines`: found none, allowed one or more");
        for sine in &reference.sines {
            within("reference.sines.amplitude_mm", sine.amplitude_mm, 0.0, 10.0)?;
            within("reference.sines.frequency_hz", sine.frequency_hz, 1e-4, 100.0)?;
            within("reference.sines.phase_rad", sine.phase_rad, -100.0, 100.0)?;
        }
        within("reference.settle_s", reference.settle_s, 0.0, 1000.0)?;
        within("reference.window_s", reference.window_s, 0.1, 1000.0)?;
        let n_ticks = (reference.settle_s + reference.window_s) * self.control.sample_rate_hz;
        ensure!(
            n_ticks <= N_TICKS_MAX,
            "key `reference.window_s`: found {} s after {} s at {} Hz, allowed are up to {N_TICKS_MAX} ticks in all",
            reference.window_s,
            reference.settle_s,
            self.control.sample_rate_hz
        );
        within("conditions.disturbance_n", self.conditions.disturbance_n, -1.0, 1.0)?;
        within("conditions.disturbance_start_s", self.conditions.disturbance_start_s, 0.0, 2000.0)?;
        within("conditions.noise_mm", self.conditions.noise_mm, 0.0, 1.0)?;
        within("conditions.noise_hz", self.conditions.noise_hz, 0.0, self.control.sample_rate_hz / 2.0)?;
        for (key, pid) in [("pid.auto", self.pid.auto), ("pid.manual", self.pid.manual)] {
            for (name, value) in [("p", pid.p), ("i", pid.i), ("d", pid.d)] {
                within(&format!("{key}.{name}"), value, 0.0, 1e6)?;
            }
            within(&format!("{key}.n_rad_s"), pid.n_rad_s, 1.0, 1e6)?;
            if let Some(SetpointWeights { b, c }) = pid.setpoint_weights {
                within(&format!("{key}.setpoint_weights.b"), b, 0.0, 1.0)?;
                within(&format!("{key}.setpoint_weights.c"), c, 0.0, 1.0)?;
                ensure!(
                    pid.i > 0.0 || b == 1.0,
                    "key `{key}.setpoint_weights.b`: found {b} without integral gain, allowed 1: the loop would stay off the reference"
                );
            }
        }
        within("pulse.peak_to_peak_pa", self.pulse.peak_to_peak_pa, 1.0, 1e5)?;
        within("pulse.pa_per_mm", self.pulse.pa_per_mm, 1.0, 1e6)?;
        within("pulse.plate_radius_mm", self.pulse.plate_radius_mm, 0.1, 100.0)?;
        within("pulse.playout_delay_s", self.pulse.playout_delay_s, 0.0, 10.0)?;
        for &horizon_s in &self.pulse.horizons_s {
            within("pulse.horizons_s", horizon_s, 0.0, self.pulse.playout_delay_s)?;
        }
        let mut stems: Vec<_> = self.pulse.files.iter().map(|file| file.file_stem()).collect();
        stems.sort_unstable();
        if let Some(pair) = stems.windows(2).find(|pair| pair[0] == pair[1]) {
            bail!(
                "key `pulse.files`: found {:?} twice, allowed once: the report names recordings by their file stem",
                pair[0]
            );
        }
        Ok(())
    }
}

/// A mistake in a TOML file as one line: place, key, what was found and what is allowed.
fn one_line(error: &toml::de::Error, text: &str) -> String {
    // What Rust calls the types means nothing to whoever writes a study.
    let message = error
        .message()
        .trim()
        .replace('\n', ", ")
        .replace("expected f64", "expected a number")
        .replace("expected usize", "expected a whole number of 0 or more")
        .replace("expected u64", "expected a whole number of 0 or more")
        .replace("expected u32", "expected a whole number of 0 or more");
    let start = error.span().map_or(0, |span| span.start.min(text.len()));
    let before = &text[..start];
    let line = 1 + before.matches('\n').count();
    let column = 1 + before.chars().rev().take_while(|c| *c != '\n').count();
    let mut path = Vec::new();
    let parsed = DeTable::parse(text);
    let known = parsed.as_ref().is_ok_and(|table| key_at(table.get_ref(), start, &mut path));
    if let Some(missing) = message.strip_prefix("missing field `").and_then(|rest| rest.strip_suffix('`')) {
        // The file as a whole spans its first line, which says nothing about where the key belongs.
        let (at_table, table) = match (known && start > 0, path.join(".")) {
            (true, table) => (format!("line {line}: "), format!("{table}.")),
            _ => Default::default(),
        };
        return format!("{at_table}key `{table}{missing}` is missing");
    }
    if known {
        return format!("line {line}, column {column}, key `{}`: {message}", path.join("."));
    }
    // A text that is no TOML at all has no keys; then the line itself must do.
    let found = text.lines().nth(line - 1).unwrap_or_default().trim();
    format!("line {line}, column {column}, found `{found}`: {message}")
}

/// Finds the innermost key whose name or value stands at a byte of the text; `path` becomes the way to it.
///
/// The depth is bounded by that of the file, which the parser limits.
fn key_at(table: &DeTable<'_>, byte: usize, path: &mut Vec<String>) -> bool {
    table.iter().any(|(key, value)| {
        path.push(key.get_ref().to_string());
        // The span of a `[table]` is its header alone, so what stands below it is searched in any case.
        let found =
            key_in(value.get_ref(), byte, path) || key.span().contains(&byte) || value.span().contains(&byte);
        if !found {
            path.pop();
        }
        found
    })
}

fn key_in(value: &DeValue<'_>, byte: usize, path: &mut Vec<String>) -> bool {
    match value {
        DeValue::Table(table) => key_at(table, byte, path),
        DeValue::Array(entries) => entries.iter().any(|entry| key_in(entry.get_ref(), byte, path)),
        _ => false,
    }
}

/// A run is kept in memory while it is judged: six series of this length are 48 MB.
const N_TICKS_MAX: f64 = 1e6;

/// Refuses a value that is no number or lies outside of its range.
fn within(key: &str, value: f64, min: f64, max: f64) -> Result<()> {
    if !(value >= min && value <= max) {
        bail!("key `{key}`: found {value}, allowed {min} to {max}");
    }
    Ok(())
}
