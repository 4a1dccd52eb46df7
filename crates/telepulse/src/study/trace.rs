//! Series thinned for figures.

use serde::{Deserialize, Serialize};

/// Samples per second that a trace keeps: enough for the 50 Hz of the sensing noise.
const TRACE_RATE_HZ: f64 = 250.0;

/// A run as a figure shows it: every few ticks, from `start` on.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Trace {
    /// Time since the first tick kept.
    pub time_s: Vec<f64>,
    /// Reference, in the unit of the figure.
    pub reference: Vec<f64>,
    /// True output, in the unit of the figure.
    pub output: Vec<f64>,
    /// Voltage.
    pub voltage_kv: Vec<f64>,
}

impl Trace {
    /// Every few ticks of three series of equal length, from tick `start` on.
    #[must_use]
    pub fn thin(
        reference: &[f64],
        output: &[f64],
        voltage_v: &[f64],
        sample_time_s: f64,
        start: usize,
    ) -> Self {
        let stride = ((1.0 / (sample_time_s * TRACE_RATE_HZ)).round() as usize).max(1);
        let n = reference.len().min(output.len()).min(voltage_v.len());
        let kept = || (start..n).step_by(stride);
        Self {
            time_s: kept().map(|idx| (idx - start) as f64 * sample_time_s).collect(),
            reference: kept().map(|idx| reference[idx]).collect(),
            output: kept().map(|idx| output[idx]).collect(),
            voltage_kv: kept().map(|idx| voltage_v[idx] * 1e-3).collect(),
        }
    }

    /// Output minus reference.
    #[must_use]
    pub fn error(&self) -> Vec<f64> {
        self.output.iter().zip(&self.reference).map(|(y, r)| y - r).collect()
    }
}
