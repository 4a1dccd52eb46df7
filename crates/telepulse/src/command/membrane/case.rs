//! Case files of `telepulse membrane`: JSON that describes a sheet, and what holds plate and electrodes.

use std::collections::BTreeSet;
use std::io::Read;
use std::path::Path;

use anyhow::{Context, Result, anyhow, bail, ensure};
use serde::de::{Error as _, MapAccess, Visitor};
use serde::{Deserialize, Deserializer};
use serde_json::{Map, Value};
use telepulse_actuator::Error;
use telepulse_actuator::failure::{FailureCriteria, Margin, Mechanism};
use telepulse_actuator::statics::{Electrodes, Load, Material, Prestretch, Sheet, SheetSpec};

use super::judged::{self, Grids};
use crate::artefact;

/// A checked case.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Case {
    /// Where it came from, for messages.
    pub(super) name: String,
    pub(super) sheet: Sheet,
    pub(super) load: Load,
    pub(super) electrodes: Electrodes,
    /// What the state is judged by.
    pub(super) criteria: FailureCriteria,
    /// Whether the case gives criteria of its own; then no command answers with a state that fails by them.
    pub(super) gives_criteria: bool,
    /// Axes of maps.
    pub(super) grids: Grids,
    /// Keys that mean nothing here.
    pub(super) unread: Vec<String>,
}

/// Keys of a case.
const KEYS: [&str; 15] = [
    "material",
    "a_m",
    "b_m",
    "thickness_m",
    "prestretch",
    "allow_prestretch_below_one",
    "relative_permittivity",
    "voltage_v",
    "charge_c",
    "force_n",
    "displacement_m",
    "breakdown",
    "rupture_stretch",
    "amplifier",
    "map",
];
/// Keys that collections of cases carry to tell them apart.
pub(super) const DESCRIPTIVE: [&str; 6] = ["id", "name", "category", "source", "note", "comment"];
/// Names of the materials.
const MATERIALS: &str = "\"neo-hookean\", \"gent\" or \"ogden\"";

impl Case {
    /// Reads a file, or standard input where the path is `-`.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let (fields, name) = read_fields(path)?;
        Self::from_fields(&fields, &name).map_err(|error| error.context(format!("in {name}")))
    }

    fn from_fields(fields: &Map<String, Value>, name: &str) -> Result<Self> {
        let [prestretch_inner, prestretch_outer] = prestretch(fields)?;
        let below_one = match fields.get("allow_prestretch_below_one") {
            None | Some(Value::Null | Value::Bool(false)) => Prestretch::AtLeastOne,
            Some(Value::Bool(true)) => Prestretch::BelowOneAllowed,
            Some(other) => bail!("key `allow_prestretch_below_one`: expected true or false, found {other}"),
        };
        let spec = SheetSpec {
            material: material(fields)?,
            inner_radius_m: number(fields, "a_m")?,
            outer_radius_m: number(fields, "b_m")?,
            thickness_m: number(fields, "thickness_m")?,
            prestretch_inner,
            prestretch_outer,
            prestretch: below_one,
            relative_permittivity: number(fields, "relative_permittivity")?,
        };
        let sheet = Sheet::new(spec).map_err(|error| match error {
            // The chain limit is the one check that involves two keys.
            Error::GentLimit { .. } => {
                anyhow!("key `prestretch`, found {prestretch_inner}: {}", said(&error))
            }
            error => anyhow!(error),
        })?;
        let load = match (present(fields, "force_n"), present(fields, "displacement_m")) {
            (true, false) => Load::ForceN(number(fields, "force_n")?),
            (false, true) => Load::DisplacementM(number(fields, "displacement_m")?),
            (true, true) => {
                bail!("keys `force_n` and `displacement_m`: one of them follows from the other, give one")
            }
            (false, false) => {
                bail!("key `force_n` or `displacement_m` is missing: one of them holds the plate")
            }
        };
        let electrodes = match (present(fields, "voltage_v"), present(fields, "charge_c")) {
            (_, false) => Electrodes::VoltageV(not_negative(fields, "voltage_v")?),
            (false, true) => Electrodes::ChargeC(not_negative(fields, "charge_c")?),
            (true, true) => bail!("keys `voltage_v` and `charge_c`: one follows from the other, give one"),
        };
        let (criteria, gives_criteria) = judged::criteria(fields)?;
        let grids = judged::grids(fields)?;
        let known: BTreeSet<&str> = KEYS.into_iter().chain(DESCRIPTIVE).collect();
        let unread = fields.keys().filter(|key| !known.contains(key.as_str())).cloned().collect();
        Ok(Self { name: name.to_owned(), sheet, load, electrodes, criteria, gives_criteria, grids, unread })
    }

    fn load_key(&self) -> String {
        match self.load {
            Load::ForceN(force) => format!("key `force_n`, found {force}"),
            Load::DisplacementM(x) => format!("key `displacement_m`, found {x}"),
        }
    }

    /// Nothing where the electrodes carry no charge.
    fn electric_key(&self) -> Option<String> {
        match self.electrodes {
            Electrodes::VoltageV(v) if v > 0.0 => Some(format!("key `voltage_v`, found {v}")),
            Electrodes::ChargeC(charge) if charge > 0.0 => Some(format!("key `charge_c`, found {charge}")),
            _ => None,
        }
    }

    /// Refuses a state in which a margin is used up, with the key that is to blame.
    pub(super) fn require_left(&self, margins: &[Margin]) -> Result<()> {
        let Some(worst) = margins.iter().filter(|m| m.left < 0.0).min_by(|a, b| a.left.total_cmp(&b.left))
        else {
            return Ok(());
        };
        let key = match worst.mechanism {
            Mechanism::Rupture => self.load_key(),
            _ => self.electric_key().unwrap_or_else(|| self.load_key()),
        };
        bail!("in {}: {key}: {}", self.name, judged::failed(worst))
    }

    fn is_slack_when_flat(&self) -> bool {
        let spec = self.sheet.spec();
        spec.prestretch_inner.min(spec.prestretch_outer) < 1.0
    }

    /// Adds to a refusal which key of the case it is about.
    pub(super) fn explain(&self, error: Error) -> anyhow::Error {
        let load = self.load_key();
        let electric = self.electric_key();
        let key = match &error {
            Error::Request { .. } => String::new(),
            Error::GentLimit { .. } => format!("{load}: "),
            // Where the load alone was borne, it is the voltage that goes too far.
            Error::BeyondLimitPoint { reached_voltage_v, .. } if *reached_voltage_v == 0.0 => {
                format!("{load}: ")
            }
            Error::NotConverged { .. } | Error::Slack { .. } if self.is_slack_when_flat() => {
                let spec = self.sheet.spec();
                let least = spec.prestretch_inner.min(spec.prestretch_outer);
                format!("key `prestretch`, found {least}, slack before it is loaded: ")
            }
            _ => format!("{}: ", electric.unwrap_or(load)),
        };
        anyhow!("in {}: {key}{}", self.name, said(&error))
    }
}

/// The keys of a file, or of standard input where the path is `-`, and its name for messages.
pub(super) fn read_fields(path: &Path) -> Result<(Map<String, Value>, String)> {
    let (text, name) = if path.as_os_str() == "-" {
        let mut text = String::new();
        std::io::stdin().read_to_string(&mut text).context("cannot read standard input")?;
        (text, "standard input".to_owned())
    } else {
        (artefact::read_text(path)?, path.display().to_string())
    };
    match serde_json::from_str(&text).map_err(|error| anyhow!("in {name}: {}", unreadable(&text, &error)))? {
        Value::Object(_) => {}
        value => bail!("in {name}: expected an object with the keys of a case, found {value}"),
    }
    // Read once more: a map keeps the last of two equal keys and tells nobody.
    let Fields(fields) = serde_json::from_str(&text).map_err(|error| anyhow!("in {name}: {error}"))?;
    Ok((fields, name))
}

/// Why a text is no JSON; a value that is no number, which JSON does not know, with its key.
fn unreadable(text: &str, error: &serde_json::Error) -> String {
    let line_start: usize =
        text.split_inclusive('\n').take(error.line().saturating_sub(1)).map(str::len).sum();
    let at = line_start + error.column().saturating_sub(1);
    let rest = text.get(at..).unwrap_or_default().trim_start_matches('-');
    // The parser stops inside of the word, or before it.
    let word = ["NaN", "nan", "Infinity", "inf"].into_iter().find(|word| {
        rest.starts_with(word)
            || text
                .get(..at)
                .is_some_and(|before| before.ends_with(&word[..1]) && rest.starts_with(&word[1..]))
    });
    let key =
        text.get(..at).and_then(|before| before.rsplit_once("\":")?.0.rsplit_once('"').map(|(_, key)| key));
    match (word, key) {
        (Some(word), Some(key)) => {
            format!(
                "key `{key}`: found {word}, must be a number (line {}): {word} measures nothing",
                error.line()
            )
        }
        _ => error.to_string(),
    }
}

/// The keys of a case, each once.
struct Fields(Map<String, Value>);

impl<'de> Deserialize<'de> for Fields {
    fn deserialize<D: Deserializer<'de>>(source: D) -> Result<Self, D::Error> {
        source.deserialize_map(FieldsVisitor)
    }
}

struct FieldsVisitor;

impl<'de> Visitor<'de> for FieldsVisitor {
    type Value = Fields;

    fn expecting(&self, to: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        to.write_str("an object with the keys of a case")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Fields, A::Error> {
        let mut fields = Map::new();
        while let Some((key, value)) = entries.next_entry::<String, Value>()? {
            if fields.contains_key(&key) {
                return Err(A::Error::custom(format!("key `{key}` stands twice, give it once")));
            }
            fields.insert(key, value);
        }
        Ok(Fields(fields))
    }
}

pub(super) fn present(fields: &Map<String, Value>, key: &str) -> bool {
    fields.get(key).is_some_and(|value| !value.is_null())
}

/// A number that must be there, of a size that some device could have.
pub(super) fn number(fields: &Map<String, Value>, key: &str) -> Result<f64> {
    let found = match fields.get(key) {
        None | Some(Value::Null) => bail!("key `{key}` is missing, expected a number"),
        Some(value) => {
            value.as_f64().ok_or_else(|| anyhow!("key `{key}`: expected a number, found {value}"))?
        }
    };
    ensure!(
        found == 0.0 || (SMALLEST..=LARGEST).contains(&found.abs()),
        "key `{key}`: found {found:e}, allowed 0 or a size of {SMALLEST:e} to {LARGEST:e}: no device has such numbers, and the \
         equations lose theirs"
    );
    Ok(found)
}

/// Sizes of numbers in SI units, far beyond any device; a case may be in units of its own.
const SMALLEST: f64 = 1e-30;
const LARGEST: f64 = 1e30;
/// A reason longer than this holds a number with hundreds of digits.
const LONGEST_REASON: usize = 400;

/// The reason of a refusal, without numbers that are none.
pub(super) fn said(error: &Error) -> String {
    let text = error.to_string();
    let is_number = |word: &str| !word.contains("NaN") && word.trim_matches('-') != "inf";
    if text.len() <= LONGEST_REASON && text.split(' ').all(is_number) {
        return text;
    }
    "no equilibrium can be computed: loads, stiffness and voltage lie too many orders of magnitude apart"
        .to_owned()
}

fn not_negative(fields: &Map<String, Value>, key: &str) -> Result<f64> {
    let found = number(fields, key)?;
    ensure!(found >= 0.0, "key `{key}`: must not be negative, found {found}: force goes with its square");
    Ok(found)
}

/// One number, or one for the plate and one for the frame.
fn prestretch(fields: &Map<String, Value>) -> Result<[f64; 2]> {
    match fields.get("prestretch") {
        Some(Value::Array(both)) => match both.iter().map(Value::as_f64).collect::<Vec<_>>()[..] {
            [Some(inner), Some(outer)] => Ok([inner, outer]),
            _ => bail!(
                "key `prestretch`: expected a number, or two for plate and frame, found {}",
                Value::from(both.clone())
            ),
        },
        _ => Ok([number(fields, "prestretch")?; 2]),
    }
}

pub(super) fn material(fields: &Map<String, Value>) -> Result<Material> {
    let found = match fields.get("material") {
        None | Some(Value::Null) => bail!("key `material` is missing, expected an object with `model`"),
        Some(Value::Object(found)) => found,
        Some(other) => bail!("key `material`: expected an object with `model`, found {other}"),
    };
    let inside = |error: anyhow::Error| anyhow!("key `material`: {error}");
    let value = |key: &str| number(found, key).map_err(inside);
    let (material, known): (Material, &[&str]) = match found.get("model").and_then(Value::as_str) {
        Some("neo-hookean") => (Material::NeoHookean { mu_pa: value("mu_pa")? }, &["mu_pa"]),
        Some("gent") => (Material::Gent { mu_pa: value("mu_pa")?, limit: value("J")? }, &["mu_pa", "J"]),
        Some("ogden") => (Material::Ogden { terms: terms(found)? }, &["terms"]),
        Some(other) => bail!("key `material`: `model` \"{other}\" is unknown, expected {MATERIALS}"),
        None => bail!("key `material`: `model` is missing or no word, expected {MATERIALS}"),
    };
    for key in found.keys().filter(|key| *key != "model" && !found[*key].is_null()) {
        ensure!(known.contains(&key.as_str()), "key `material`: `{key}` has no meaning for this `model`");
    }
    Ok(material)
}

fn terms(found: &Map<String, Value>) -> Result<Vec<[f64; 2]>> {
    let expected = "expected pairs [mu_pa, alpha]";
    let Some(Value::Array(rows)) = found.get("terms") else {
        bail!("key `material`: `terms` is missing or no list, {expected}");
    };
    rows.iter()
        .map(|row| match row.as_array().map(Vec::as_slice) {
            Some([mu_pa, alpha]) => match (mu_pa.as_f64(), alpha.as_f64()) {
                (Some(mu_pa), Some(alpha)) => Ok([mu_pa, alpha]),
                _ => Err(anyhow!("key `material`: `terms`: {expected}, found {row}")),
            },
            _ => Err(anyhow!("key `material`: `terms`: {expected}, found {row}")),
        })
        .collect()
}
