//! The envelope over load and voltage.

use serde::Serialize;

use super::criteria::Mechanism;
use super::envelope::Envelope;
use crate::Error;
use crate::statics::{Electrodes, Load};

/// Voltage at which a mechanism sets in, load by load.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MapCurve {
    /// Which.
    pub mechanism: Mechanism,
    /// One voltage for each load, V; none where it does not come before the path's end.
    pub voltage_v: Vec<Option<f64>>,
    /// True where the limit has not been checked against its source.
    pub unverified: bool,
}

/// What ends the membrane where, over dead load and voltage.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FailureMap {
    /// Dead loads, N.
    pub force_n: Vec<f64>,
    /// Voltages of the grid, V.
    pub voltage_v: Vec<f64>,
    /// Limits as curves over the load.
    pub curves: Vec<MapCurve>,
    /// `[load][voltage]`: the mechanism with the least left; none where there is no state.
    pub nearest: Vec<Vec<Option<Mechanism>>>,
    /// `[load][voltage]`: how much is left to it, see [`super::Margin::left`]; none where there is no state.
    pub left: Vec<Vec<Option<f64>>>,
    /// Why a load without voltage has no state, for those that have none.
    pub refused: Vec<String>,
}

/// Mechanisms of the curves.
const CURVES: [Mechanism; 7] = [
    Mechanism::LossOfTension,
    Mechanism::LimitPoint,
    Mechanism::PullIn,
    Mechanism::Breakdown,
    Mechanism::Rupture,
    Mechanism::AmplifierVoltage,
    Mechanism::AmplifierCurrent,
];

impl Envelope {
    /// Limits and margins over dead loads and voltages.
    ///
    /// A load that the membrane does not bear even without voltage leaves its row empty and its reason in `refused`.
    ///
    /// # Errors
    /// [`Error::Request`] for a load or voltage that is not finite, or a negative voltage.
    pub fn map(&mut self, force_n: &[f64], voltage_v: &[f64]) -> Result<FailureMap, Error> {
        for &found in force_n {
            if !found.is_finite() {
                return Err(Error::Request { quantity: "force_n", allowed: "finite", found });
            }
        }
        for &found in voltage_v {
            if !(found.is_finite() && found >= 0.0) {
                let allowed = "finite and not negative";
                return Err(Error::Request { quantity: "voltage_v", allowed, found });
            }
        }
        let curve = |mechanism| MapCurve {
            mechanism,
            voltage_v: Vec::new(),
            unverified: self.criteria.is_unverified(mechanism),
        };
        let mut map = FailureMap {
            force_n: force_n.to_vec(),
            voltage_v: voltage_v.to_vec(),
            curves: CURVES.map(curve).into(),
            nearest: Vec::new(),
            left: Vec::new(),
            refused: Vec::new(),
        };
        for &force in force_n {
            let limits = self.voltage_limits(force);
            for curve in &mut map.curves {
                curve.voltage_v.push(limits.as_ref().ok().and_then(|limits| limits.of(curve.mechanism)));
            }
            let limit_v = limits.as_ref().ok().and_then(|limits| limits.of(Mechanism::LimitPoint));
            if let Err(error) = limits {
                map.refused.push(error.to_string());
                map.nearest.push(vec![None; voltage_v.len()]);
                map.left.push(vec![None; voltage_v.len()]);
                continue;
            }
            let (nearest, left) = self.row(force, voltage_v, limit_v)?;
            map.nearest.push(nearest);
            map.left.push(left);
        }
        // What never comes in reach is no curve.
        map.curves.retain(|curve| curve.voltage_v.iter().any(Option::is_some));
        Ok(map)
    }

    fn row(&mut self, force_n: f64, voltage_v: &[f64], limit_v: Option<f64>) -> Result<Row, Error> {
        let flat = self.solver.solve_even_slack(Load::ForceN(force_n), Electrodes::VoltageV(0.0))?;
        let mut row = Row::default();
        for &voltage in voltage_v {
            let beyond = limit_v.is_some_and(|limit| voltage >= limit);
            let state = if beyond { None } else { self.near(Load::ForceN(force_n), voltage).ok() };
            let least = match state {
                None => None,
                Some(point) => {
                    let mut all: Vec<(Mechanism, f64)> = self
                        .material_margins(&point, &flat)?
                        .iter()
                        .map(|margin| (margin.mechanism, margin.left))
                        .collect();
                    all.extend(limit_v.map(|limit| (Mechanism::LimitPoint, 1.0 - voltage / limit)));
                    let amplifier = self.criteria.amplifier;
                    all.extend(
                        amplifier.max_v.map(|limit| (Mechanism::AmplifierVoltage, 1.0 - voltage / limit)),
                    );
                    all.into_iter().min_by(|a, b| a.1.total_cmp(&b.1))
                }
            };
            row.0.push(least.map(|(mechanism, _)| mechanism));
            row.1.push(least.map(|(_, left)| left));
        }
        Ok(row)
    }
}

/// Nearest mechanism and what is left to it, for one load.
type Row = (Vec<Option<Mechanism>>, Vec<Option<f64>>);
