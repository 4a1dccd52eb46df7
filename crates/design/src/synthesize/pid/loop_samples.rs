//! A loop with a PID controller on a grid of frequencies: quick looks at peaks and margins, before anything is proven.

use num_complex::Complex64;

use super::DelayedPlant;
use super::convex_step::frequency_grid;
use super::stability::Characteristic;
use crate::Result;
use crate::implement::PidSettings;

/// A plant on a grid.
pub(super) struct LoopSamples<'a> {
    plant: &'a DelayedPlant,
    points: Vec<(f64, Complex64)>,
}

/// What the grid shows of a loop.
#[derive(Debug, Clone, Copy)]
pub(super) struct Glimpse {
    pub(super) peak_s: f64,
    pub(super) peak_t: f64,
    /// Least phase margin of all crossings between grid points, in degrees; 180 where there is none.
    pub(super) phase_margin_deg: f64,
}

impl<'a> LoopSamples<'a> {
    pub(super) fn new(plant: &'a DelayedPlant) -> Result<Self> {
        let grid = frequency_grid(plant, 0.0, &[])?;
        let points =
            grid.into_iter().map(|w| (w, plant.at(w))).filter(|(_, g)| g.norm().is_finite()).collect();
        Ok(Self { plant, points })
    }

    /// Ends of the grid in rad/s.
    pub(super) fn ends(&self) -> [f64; 2] {
        let at = |k: usize| self.points.get(k).map_or(1.0, |p| p.0);
        [at(0), at(self.points.len().saturating_sub(1))]
    }

    pub(super) fn glimpse(&self, settings: &PidSettings) -> Glimpse {
        let mut found = Glimpse { peak_s: 0.0, peak_t: 0.0, phase_margin_deg: 180.0 };
        let mut before: Option<Complex64> = None;
        for &(omega, g) in &self.points {
            let loop_ = g * response(settings, omega);
            let s = (1.0 + loop_).inv().norm();
            found.peak_s = found.peak_s.max(s);
            found.peak_t = found.peak_t.max(s * loop_.norm());
            if let Some(last) = before.filter(|last| (last.norm() > 1.0) != (loop_.norm() > 1.0)) {
                // Logarithm of the gain and phase as straight lines between the points.
                let share = last.norm().ln() / (last.norm() / loop_.norm()).ln();
                let angle = (-last).arg() + share * (loop_ / last).arg();
                let turned = Complex64::from_polar(1.0, angle).arg().to_degrees().abs();
                found.phase_margin_deg = found.phase_margin_deg.min(turned);
            }
            before = Some(loop_);
        }
        found
    }

    /// Whether the closed loop is stable; one that cannot be judged does not count.
    pub(super) fn is_stable(&self, settings: &PidSettings) -> Result<bool> {
        let controller = settings.transfer_function()?;
        let characteristic = Characteristic::new(self.plant.rational(), &controller, self.plant.delay_s());
        Ok(matches!(characteristic.n_unstable(), Ok(0)))
    }
}

/// `P + I/s + D N s/(s + N)` at `s = j omega`.
pub(super) fn response(settings: &PidSettings, omega: f64) -> Complex64 {
    let PidSettings { p, i_per_s, d_s, n_rad_s } = *settings;
    let derivative = if d_s == 0.0 { Complex64::ZERO } else { d_s * filtered_derivative(omega, n_rad_s) };
    Complex64::new(p, -i_per_s / omega) + derivative
}

/// `N s/(s + N)` at `s = j omega`.
pub(super) fn filtered_derivative(omega: f64, n_rad_s: f64) -> Complex64 {
    let s = Complex64::new(0.0, omega);
    s / (1.0 + s / n_rad_s)
}
