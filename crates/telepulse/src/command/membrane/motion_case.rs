//! Case files of `telepulse membrane simulate`: an actuator, a drive, and how to run it.

use std::path::Path;

use anyhow::{Result, anyhow, bail, ensure};
use serde_json::{Map, Value};
use telepulse_actuator::failure::FailureCriteria;
use telepulse_actuator::statics::Material;
use telepulse_actuator::twin::Fidelity;
use telepulse_actuator::{ActuatorParameters, ActuatorSpec, Error, MaxwellBranch, ParameterSet};

use super::case::{DESCRIPTIVE, material, number, present, read_fields, said};
use super::drive::Drive;
use super::judged;

/// A checked case.
#[derive(Debug, Clone)]
pub(super) struct MotionCase {
    /// Where it came from, for messages.
    pub(super) name: String,
    pub(super) parameters: ActuatorParameters,
    pub(super) fidelity: Fidelity,
    pub(super) drive: Drive,
    pub(super) interval_s: f64,
    pub(super) n_intervals: usize,
    /// Intervals from sample to sample in the answer.
    pub(super) sample_every: usize,
    pub(super) scatter: Option<Scatter>,
    /// What the run is judged by.
    pub(super) criteria: FailureCriteria,
    /// Whether the case gives criteria of its own; then a run that fails by them is refused.
    pub(super) gives_criteria: bool,
    /// Keys that mean nothing here.
    pub(super) unread: Vec<String>,
}

/// Variants whose parameters lie anywhere within a part of the nominal one, each as likely as the other.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Scatter {
    pub(super) n_variants: usize,
    pub(super) seed: u64,
    /// Parameter and largest relative deviation.
    pub(super) relative: Vec<(&'static str, f64)>,
}

/// Parameters as files name them, with their place in the specification. The branches move together.
type Place = fn(&mut ActuatorSpec) -> &mut f64;
const NUMBERS: [(&str, Place); 11] = [
    ("a_m", |s| &mut s.inner_radius_m),
    ("b_m", |s| &mut s.outer_radius_m),
    ("thickness_m", |s| &mut s.thickness_m),
    ("prestretch", |s| &mut s.prestretch),
    ("relative_permittivity", |s| &mut s.relative_permittivity),
    ("mass_kg", |s| &mut s.mass_kg),
    ("damping_n_s_per_m", |s| &mut s.damping_n_s_per_m),
    ("rc_s", |s| &mut s.rc_s),
    ("full_scale_v", |s| &mut s.full_scale_v),
    ("gravity_m_per_s2", |s| &mut s.gravity_m_per_s2),
    ("leak_resistance_ohm", |s| &mut s.leak_resistance_ohm),
];
/// Scattered beside the numbers above.
const MODULI: [&str; 3] = ["mu_pa", "branch_moduli_pa", "relaxation_times_s"];
const OTHERS: [&str; 11] = [
    "parameter_set",
    "material",
    "branches",
    "fidelity",
    "drive",
    "duration_s",
    "step_s",
    "sample_s",
    "breakdown",
    "rupture_stretch",
    "amplifier",
];
/// Longest run, intervals.
const INTERVALS_MAX: f64 = 1e7;
/// Most samples in an answer.
const SAMPLES_MAX: usize = 1_000_000;
const VARIANTS_MAX: u64 = 1_000_000;

impl MotionCase {
    pub(super) fn read(path: &Path) -> Result<Self> {
        let (fields, name) = read_fields(path)?;
        let folder = path.parent().unwrap_or_else(|| Path::new("."));
        Self::from_fields(&fields, &name, folder).map_err(|error| error.context(format!("in {name}")))
    }

    fn from_fields(fields: &Map<String, Value>, name: &str, folder: &Path) -> Result<Self> {
        let parameters = ActuatorParameters::new(spec(fields)?).map_err(as_typed)?;
        let fidelity = match fields.get("fidelity") {
            None | Some(Value::Null) => Fidelity::default(),
            Some(word) => serde_json::from_value(word.clone())
                .map_err(|_| anyhow!("key `fidelity`: expected \"reduced\" or \"field\", found {word}"))?,
        };
        let drive = Drive::parse(fields, folder, parameters.spec().full_scale_v)?;
        let or = |key: &str, default: Option<f64>| match (present(fields, key), default) {
            (false, Some(default)) => Ok(default),
            _ => number(fields, key),
        };
        let interval_s = or("step_s", Some(fidelity.usual_step_s()))?;
        ensure!(
            interval_s > 0.0 && interval_s <= 0.1,
            "key `step_s`: must be positive and at most 0.1 s, found {interval_s}: the drive is held over it"
        );
        let duration_s = or("duration_s", drive.duration_s())?;
        let n = (duration_s / interval_s).round();
        ensure!(
            (1.0..=INTERVALS_MAX).contains(&n),
            "key `duration_s`: must hold 1 to {INTERVALS_MAX} steps of {interval_s} s, found {duration_s}"
        );
        let sample_s = or("sample_s", Some(0.01_f64.max(interval_s)))?;
        let every = (sample_s / interval_s).round();
        ensure!(
            every >= 1.0 && every <= n,
            "key `sample_s`: must lie within `step_s` and `duration_s`, found {sample_s}"
        );
        ensure!(
            n / every <= SAMPLES_MAX as f64,
            "key `sample_s`: at most {SAMPLES_MAX} samples are given, found {sample_s}"
        );
        let scatter = scatter(fields)?;
        let (criteria, gives_criteria) = judged::criteria(fields)?;
        ensure!(
            scatter.is_none() || fidelity == Fidelity::Reduced,
            "key `scatter`: batches run on the reduced twin, found `fidelity` \"field\""
        );
        let known = |key: &str| {
            OTHERS.contains(&key)
                || DESCRIPTIVE.contains(&key)
                || key == "scatter"
                || NUMBERS.iter().any(|(name, _)| *name == key)
        };
        Ok(Self {
            name: name.to_owned(),
            parameters,
            fidelity,
            drive,
            interval_s,
            n_intervals: n as usize,
            sample_every: every as usize,
            scatter,
            criteria,
            gives_criteria,
            unread: fields.keys().filter(|key| !known(key)).cloned().collect(),
        })
    }
}

/// The keys as the user knows them.
pub(super) fn as_typed(error: Error) -> anyhow::Error {
    let renamed = |key| match key {
        "inner_radius_m" => "a_m",
        "outer_radius_m" => "b_m",
        "gent_limit" => "J",
        other => other,
    };
    match error {
        Error::Parameter { key, allowed, found } => {
            let allowed = match allowed {
                "smaller than outer_radius_m" => "smaller than b_m",
                other => other,
            };
            anyhow!(Error::Parameter { key: renamed(key), allowed, found })
        }
        error => anyhow!(said(&error)),
    }
}

/// Ranges in which a simulation keeps its digits and ends in bounded time.
const RANGES: [(&str, f64, f64); 10] = [
    ("a_m", 1e-6, 10.0),
    ("b_m", 1e-6, 10.0),
    ("thickness_m", 1e-7, 1.0),
    ("prestretch", 0.0, 50.0),
    ("relative_permittivity", 0.0, 1e6),
    ("mass_kg", 1e-6, 1e6),
    ("damping_n_s_per_m", 0.0, 1e6),
    ("rc_s", 1e-7, 1e4),
    ("full_scale_v", 1e-3, 1e7),
    ("leak_resistance_ohm", 1.0, 1e20),
];

/// Refuses what would take endless steps; a number that is not positive has its own refusal.
fn require_in_range(fields: &Map<String, Value>, key: &str, found: f64) -> Result<f64> {
    let range = RANGES.iter().find(|(known, ..)| *known == key);
    if let Some((_, min, max)) = range.filter(|_| present(fields, key) && found > 0.0) {
        ensure!(
            (*min..=*max).contains(&found),
            "key `{key}`: found {found:e}, allowed {min:e} to {max:e}: beyond, steps become endless or digits are lost"
        );
    }
    Ok(found)
}

/// The parameter set named, or none, with what the case says in its place.
fn spec(fields: &Map<String, Value>) -> Result<ActuatorSpec> {
    let based = present(fields, "parameter_set");
    let set: ParameterSet = match fields.get("parameter_set") {
        None | Some(Value::Null) => ParameterSet::C,
        Some(word) => serde_json::from_value(word.clone())
            .map_err(|_| anyhow!("key `parameter_set`: expected \"A\", \"B\" or \"C\", found {word}"))?,
    };
    let mut spec = set.parameters().spec().clone();
    // These have usual values; what makes up the device must be told.
    let usual = ["gravity_m_per_s2", "leak_resistance_ohm", "full_scale_v", "damping_n_s_per_m"];
    if !based {
        spec.damping_n_s_per_m = 0.0;
    }
    for (key, place) in NUMBERS {
        if present(fields, key) || !(based || usual.contains(&key)) {
            *place(&mut spec) = require_in_range(fields, key, number(fields, key)?)?;
        }
    }
    if !based || present(fields, "material") {
        (spec.mu_pa, spec.gent_limit) = match material(fields)? {
            Material::NeoHookean { mu_pa } => (mu_pa, None),
            Material::Gent { mu_pa, limit } => (mu_pa, Some(limit)),
            Material::Ogden { .. } => bail!(
                "key `material`: `model` \"ogden\" has no dynamics here, expected \"neo-hookean\" or \"gent\": branches and linearisation are \
                 written for one shear modulus and a chain limit"
            ),
        };
    }
    if present(fields, "branches") {
        spec.branches = branches(&fields["branches"])?;
    }
    Ok(spec)
}

fn branches(found: &Value) -> Result<Vec<MaxwellBranch>> {
    let wrong = |what: &Value| {
        anyhow!("key `branches`: expected pairs [modulus_pa, relaxation_time_s], found {what}")
    };
    let rows = found.as_array().ok_or_else(|| wrong(found))?;
    rows.iter()
        .map(|row| match row.as_array().map(|pair| pair.iter().map(Value::as_f64).collect::<Vec<_>>()) {
            Some(pair) => match pair[..] {
                [Some(modulus_pa), Some(relaxation_time_s)] => {
                    // Faster than the plate can move by orders of magnitude is no branch but a stiffer network.
                    ensure!(
                        relaxation_time_s <= 0.0 || (1e-5..=1e12).contains(&relaxation_time_s),
                        "key `branches`: relaxation time: found {relaxation_time_s:e}, allowed 1e-5 to 1e12 s: a faster branch \
                         never acts, a slower one never yields"
                    );
                    Ok(MaxwellBranch { modulus_pa, relaxation_time_s })
                }
                _ => Err(wrong(row)),
            },
            None => Err(wrong(row)),
        })
        .collect()
}

fn scatter(fields: &Map<String, Value>) -> Result<Option<Scatter>> {
    let expected = "an object with `n_variants`, `seed` and `relative`";
    let found = match fields.get("scatter") {
        None | Some(Value::Null) => return Ok(None),
        Some(Value::Object(found)) => found,
        Some(other) => bail!("key `scatter`: expected {expected}, found {other}"),
    };
    for key in found.keys() {
        let known = ["n_variants", "seed", "relative"].contains(&key.as_str());
        ensure!(known, "key `scatter`: `{key}` is unknown, expected {expected}");
    }
    let whole = |key: &str, max: u64| match found.get(key).and_then(Value::as_u64) {
        Some(value) if value <= max => Ok(value),
        _ => Err(anyhow!(
            "key `scatter`: `{key}` must be a whole number up to {max}, found {}",
            found.get(key).unwrap_or(&Value::Null)
        )),
    };
    let n_variants = whole("n_variants", VARIANTS_MAX)? as usize;
    ensure!(n_variants >= 1, "key `scatter`: `n_variants` must be at least 1, found {n_variants}");
    let Some(Value::Object(parts)) = found.get("relative") else {
        bail!("key `scatter`: `relative` is missing or no object, expected {{\"mu_pa\": 0.1, ..}}");
    };
    let mut relative = Vec::with_capacity(parts.len());
    for (key, part) in parts {
        let scattered = MODULI.into_iter().chain(NUMBERS.map(|(name, _)| name));
        let Some(name) = scattered.clone().find(|name| name == key) else {
            let names: Vec<&str> = scattered.collect();
            bail!("key `scatter`: `{key}` cannot be scattered, expected one of {}", names.join(", "));
        };
        match part.as_f64() {
            Some(part) if (0.0..=10.0).contains(&part) => relative.push((name, part)),
            _ => bail!(
                "key `scatter`: `{key}` must be a part between 0 and 10 of its nominal value, found {part}"
            ),
        }
    }
    Ok(Some(Scatter { n_variants, seed: whole("seed", u64::MAX)?, relative }))
}

/// Multiplies one parameter.
pub(super) fn multiply(spec: &mut ActuatorSpec, name: &str, factor: f64) {
    match name {
        "mu_pa" => spec.mu_pa *= factor,
        "branch_moduli_pa" => spec.branches.iter_mut().for_each(|b| b.modulus_pa *= factor),
        "relaxation_times_s" => spec.branches.iter_mut().for_each(|b| b.relaxation_time_s *= factor),
        _ => {
            if let Some((_, place)) = NUMBERS.iter().find(|(known, _)| *known == name) {
                *place(spec) *= factor;
            }
        }
    }
}
