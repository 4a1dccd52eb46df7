//! What a case may say about failure and grids, and the refusal of a state that has failed.

use anyhow::{Result, anyhow, bail, ensure};
use serde::Serialize;
use serde_json::{Map, Value};
use telepulse_actuator::failure::{
    AmplifierLimits, BreakdownLaw, FailureCriteria, Margin, Mechanism, Source, Standing,
};

/// Most points of one axis of a map.
const MAX_POINTS: usize = 400;

/// Equidistant values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Grid {
    from: f64,
    to: f64,
    n_points: usize,
}

impl Grid {
    /// From `from` to `to` in `n_points`, at least 2.
    pub(super) fn new(from: f64, to: f64, n_points: usize) -> Self {
        Self { from, to, n_points }
    }

    pub(super) fn values(&self) -> Vec<f64> {
        let step = (self.to - self.from) / (self.n_points - 1) as f64;
        (0..self.n_points).map(|idx| self.from + step * idx as f64).collect()
    }
}

/// Axes of maps that the case asks for.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Grids {
    pub(super) displacement_m: Option<Grid>,
    pub(super) force_n: Option<Grid>,
    pub(super) voltage_v: Option<Grid>,
}

/// Criteria by name, as answers show them.
#[derive(Debug, Serialize)]
pub(super) struct StatedCriteria {
    breakdown_law: &'static str,
    breakdown_source: Source,
    rupture_stretch: f64,
    rupture_standing: Standing,
    amplifier: AmplifierLimits,
}

impl StatedCriteria {
    pub(super) fn of(criteria: &FailureCriteria) -> Self {
        Self {
            breakdown_law: criteria.breakdown().name(),
            breakdown_source: criteria.breakdown().source(),
            rupture_stretch: criteria.rupture_stretch(),
            rupture_standing: criteria.rupture_standing(),
            amplifier: criteria.amplifier(),
        }
    }
}

/// The criteria of a case, and whether it gives any of its own.
pub(super) fn criteria(fields: &Map<String, Value>) -> Result<(FailureCriteria, bool)> {
    let mut criteria = FailureCriteria::default();
    let mut own = false;
    match fields.get("breakdown") {
        None | Some(Value::Null) => {}
        Some(Value::String(name)) => {
            let law = BreakdownLaw::named(name).map_err(|error| anyhow!("key `breakdown`: {error}"))?;
            (criteria, own) = (criteria.with_breakdown(law), true);
        }
        Some(value) => match value.as_f64() {
            Some(field) => {
                (criteria, own) = (criteria.with_breakdown(BreakdownLaw::constant(field)?), true);
            }
            None => bail!("key `breakdown`: expected a law's name or a field in V/m, found {value}"),
        },
    }
    if let Some(value) = fields.get("rupture_stretch").filter(|value| !value.is_null()) {
        let stretch = value
            .as_f64()
            .ok_or_else(|| anyhow!("key `rupture_stretch`: expected a number, found {value}"))?;
        (criteria, own) = (criteria.with_rupture_stretch(stretch)?, true);
    }
    if let Some(value) = fields.get("amplifier").filter(|value| !value.is_null()) {
        (criteria, own) = (criteria.with_amplifier(amplifier(value)?)?, true);
    }
    Ok((criteria, own))
}

fn amplifier(value: &Value) -> Result<AmplifierLimits> {
    let Value::Object(fields) = value else {
        bail!("key `amplifier`: expected an object, found {value}");
    };
    let mut amplifier = AmplifierLimits::default();
    for (key, value) in fields {
        let slot = match key.as_str() {
            "max_v" => &mut amplifier.max_v,
            "current_a" => &mut amplifier.current_a,
            "slew_v_per_s" => &mut amplifier.slew_v_per_s,
            "leak_resistance_ohm" => &mut amplifier.leak_resistance_ohm,
            _ => bail!(
                "key `amplifier`: `{key}` is unknown, expected `max_v`, `current_a`, `slew_v_per_s` or `leak_resistance_ohm`"
            ),
        };
        let found = value.as_f64();
        ensure!(found.is_some(), "key `amplifier.{key}`: expected a number, found {value}");
        *slot = found;
    }
    Ok(amplifier)
}

/// The axes under the key `map`.
pub(super) fn grids(fields: &Map<String, Value>) -> Result<Grids> {
    let mut grids = Grids::default();
    let asked = match fields.get("map") {
        None | Some(Value::Null) => return Ok(grids),
        Some(Value::Object(asked)) => asked,
        Some(other) => bail!("key `map`: expected an object of axes, found {other}"),
    };
    for (key, value) in asked {
        let slot = match key.as_str() {
            "displacement_m" => &mut grids.displacement_m,
            "force_n" => &mut grids.force_n,
            "voltage_v" => &mut grids.voltage_v,
            _ => bail!("key `map`: `{key}` is unknown, expected `displacement_m`, `force_n` or `voltage_v`"),
        };
        let numbers: Option<Vec<f64>> =
            value.as_array().and_then(|list| list.iter().map(Value::as_f64).collect());
        let Some([from, to, n_points]) = numbers.as_deref() else {
            bail!("key `map.{key}`: expected [from, to, number of points], found {value}");
        };
        let whole = n_points.fract() == 0.0 && (2.0..=MAX_POINTS as f64).contains(n_points);
        ensure!(whole, "key `map.{key}`: expected 2 to {MAX_POINTS} points, found {n_points}");
        ensure!(from < to, "key `map.{key}`: expected an end above {from}, found {to}");
        let not_negative = key != "voltage_v" || *from >= 0.0;
        ensure!(
            not_negative,
            "key `map.voltage_v`: must not be negative, found {from}: force goes with its square"
        );
        *slot = Some(Grid::new(*from, *to, *n_points as usize));
    }
    Ok(grids)
}

/// The reason why a state is refused whose margin is used up.
pub(super) fn failed(margin: &Margin) -> String {
    let Margin { value, limit, unit, .. } = margin;
    let basis =
        if margin.unverified { " (a number that has not been checked against its source)" } else { "" };
    match margin.mechanism {
        Mechanism::Breakdown => format!(
            "electrical breakdown: the true field of {value} {unit} exceeds the elastomer's strength of {limit} {unit}{basis}"
        ),
        Mechanism::Rupture => {
            format!(
                "rupture: the largest stretch of {value} exceeds the {limit} at which the material tears{basis}"
            )
        }
        Mechanism::LossOfTension | Mechanism::PullIn => {
            format!("{}: {value} {unit}, which ends at {limit} {unit}", margin.mechanism.words())
        }
        mechanism => format!("{}: {value} {unit} exceeds the limit of {limit} {unit}", mechanism.words()),
    }
}
