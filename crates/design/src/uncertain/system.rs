//! A plant with a perturbation around it: margins and the worst gain.

use nalgebra::DMatrix;
use telepulse_lti::{Continuous, StateSpace, hinf_norm};

use super::interpolate::with_performance;
use super::mu_peak::{Aim, MuPeak, check_tolerance, mu_peak, peak_above};
use super::structure::{BlockStructure, Perturbation};
use crate::Error;

/// A system whose first ports are closed through an unknown perturbation, `|Delta| <= 1`.
///
/// ```text
///      +---- Delta <----+
///      | w_D  +---+ z_D |
///      +----->|   |-----+
///             | M |
///   w ------->|   |-------> z
///             +---+
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct UncertainSystem {
    m: StateSpace<Continuous>,
    structure: BlockStructure,
}

/// How large a perturbation the loop bears, as a multiple of the size one.
#[derive(Clone, Debug, PartialEq)]
pub struct RobustMargin {
    /// Every admissible perturbation smaller than this is borne; proven on all frequencies.
    pub lower: f64,
    /// A perturbation of this size is not borne; infinite where none was found.
    pub upper: f64,
    /// The structured singular value behind it.
    pub peak: MuPeak,
}

/// The largest gain that a perturbation of size one can cause.
#[derive(Clone, Debug, PartialEq)]
pub struct WorstCaseGain {
    /// No admissible perturbation gives a larger gain; infinite where stability is not proven.
    pub upper: f64,
    /// The gain with `delta`, its H-infinity norm computed.
    pub lower: f64,
    /// The worst perturbation found: stable, of norm one at most.
    pub delta: StateSpace<Continuous>,
    /// Frequency at which `delta` was fitted, in rad/s.
    pub omega_rad_s: f64,
}

impl UncertainSystem {
    /// A system from `M` and the blocks at its first ports.
    ///
    /// **Errors**: [`telepulse_lti::Error::PortCount`] unless `m` has an input and an output beyond those of the blocks.
    pub fn new(m: StateSpace<Continuous>, structure: BlockStructure) -> Result<Self, Error> {
        let operation = "an uncertain system";
        for (port, blocks, found) in
            [("inputs", structure.n_w(), m.n_inputs()), ("outputs", structure.n_z(), m.n_outputs())]
        {
            if found <= blocks {
                let expected = blocks + 1;
                return Err(telepulse_lti::Error::PortCount { operation, port, expected, found }.into());
            }
        }
        Ok(Self { m, structure })
    }

    /// The system with the ports of the perturbation first.
    #[must_use]
    pub fn m(&self) -> &StateSpace<Continuous> {
        &self.m
    }

    /// The blocks of the perturbation.
    #[must_use]
    pub fn structure(&self) -> &BlockStructure {
        &self.structure
    }

    /// The system from `w` to `z` with the given perturbation; zero gives the nominal one.
    ///
    /// **Errors**: as [`StateSpace::upper_lft`].
    pub fn close(&self, delta: &StateSpace<Continuous>) -> Result<StateSpace<Continuous>, Error> {
        let (rows, cols) = (self.structure.n_w(), self.structure.n_z());
        if (delta.n_outputs(), delta.n_inputs()) != (rows, cols) {
            return Err(Error::BlockMismatch { index: 0 });
        }
        Ok(self.m.upper_lft(delta)?)
    }

    /// The system from `w` to `z` without perturbation.
    ///
    /// **Errors**: none for a system that was constructed.
    pub fn nominal(&self) -> Result<StateSpace<Continuous>, Error> {
        let (n_w, n_z) = (self.structure.n_w(), self.structure.n_z());
        let outputs: Vec<usize> = (n_z..self.m.n_outputs()).collect();
        let inputs: Vec<usize> = (n_w..self.m.n_inputs()).collect();
        Ok(self.m.select(&outputs, &inputs)?)
    }

    /// How large the perturbation may be before the loop loses its stability.
    ///
    /// **Errors**: as [`mu_peak`].
    pub fn robust_stability_margin(&self, tolerance: f64) -> Result<RobustMargin, Error> {
        margin(mu_peak(&self.uncertain_part()?, &self.structure, tolerance)?)
    }

    /// `M` between the ports of its blocks.
    fn uncertain_part(&self) -> Result<StateSpace<Continuous>, Error> {
        let outputs: Vec<usize> = (0..self.structure.n_z()).collect();
        let inputs: Vec<usize> = (0..self.structure.n_w()).collect();
        Ok(self.m.select(&outputs, &inputs)?)
    }

    /// The largest `k` for which every perturbation smaller than `k` leaves the gain from `w` to `z` below `1 / k`.
    ///
    /// **Errors**: as [`mu_peak`].
    pub fn robust_performance_margin(&self, tolerance: f64) -> Result<RobustMargin, Error> {
        margin(mu_peak(&self.m, &self.whole_structure()?, tolerance)?)
    }

    /// The largest gain from `w` to `z` over all perturbations of size one.
    ///
    /// **Method**: bisection on `gamma` until the structured singular value of `M` with `z / gamma` and a full performance
    /// block is proven to be below one on all frequencies. The worst perturbation there is interpolated by a stable
    /// system ([`Perturbation::interpolated`]) and the norm of the loop with it computed.
    ///
    /// **Accuracy**: `upper` is within `tolerance` of what the bound by D,G-scales gives.
    ///
    /// **Errors**: as [`mu_peak`].
    pub fn worst_case_gain(&self, tolerance: f64) -> Result<WorstCaseGain, Error> {
        check_tolerance(tolerance)?;
        let tolerance = tolerance.clamp(1e-5, 1.0);
        let nominal = hinf_norm(&self.nominal()?)?.upper;
        let zero =
            StateSpace::<Continuous>::from_gain(DMatrix::zeros(self.structure.n_w(), self.structure.n_z()))?;
        let mut worst = WorstCaseGain { upper: f64::INFINITY, lower: nominal, delta: zero, omega_rad_s: 0.0 };
        let stability =
            peak_above(&self.uncertain_part()?, &self.structure, tolerance * 0.1, BELOW_ONE, Aim::Test)?;
        if stability.upper >= 1.0 {
            return Ok(worst);
        }
        let structure = self.whole_structure()?;
        let (mut low, mut high) = (nominal, nominal.max(f64::MIN_POSITIVE.sqrt()));
        let mut is_bounded = false;
        for _ in 0..GAIN_STEPS_MAX {
            let gamma = if is_bounded { low.sqrt() * high.sqrt() } else { high };
            let peak = peak_above(&self.scaled(gamma)?, &structure, tolerance * 0.1, BELOW_ONE, Aim::Test)?;
            self.improve(&peak, &mut worst)?;
            if peak.upper < 1.0 {
                (high, is_bounded) = (gamma, true);
                worst.upper = gamma;
                low = low.max(worst.lower.min(high));
            } else {
                low = gamma;
                high = if is_bounded { high } else { 2.0 * gamma };
            }
            if is_bounded && high <= low * (1.0 + 0.5 * tolerance) {
                break;
            }
        }
        Ok(worst)
    }

    fn improve(&self, peak: &MuPeak, worst: &mut WorstCaseGain) -> Result<(), Error> {
        let Some(p) = &peak.lower.perturbation else { return Ok(()) };
        let own = Perturbation { values: p.values[..self.structure.blocks().len()].to_vec() };
        let own = own.scaled((1.0 - 1e-12) / own.norm().max(1.0));
        let delta = own.interpolated(&self.structure, peak.omega_rad_s)?;
        let Ok(gain) = self.close(&delta).and_then(|loop_| Ok(hinf_norm(&loop_)?)) else { return Ok(()) };
        if gain.lower > worst.lower {
            (worst.lower, worst.delta, worst.omega_rad_s) = (gain.lower, delta, peak.omega_rad_s);
        }
        Ok(())
    }

    fn whole_structure(&self) -> Result<BlockStructure, Error> {
        let n_in = self.m.n_inputs() - self.structure.n_w();
        with_performance(&self.structure, n_in, self.m.n_outputs() - self.structure.n_z())
    }

    /// `M` with its performance outputs divided by `gamma`.
    fn scaled(&self, gamma: f64) -> Result<StateSpace<Continuous>, Error> {
        let (mut c, mut d) = (self.m.c().clone(), self.m.d().clone());
        for row in self.structure.n_z()..self.m.n_outputs() {
            c.row_mut(row).scale_mut(1.0 / gamma);
            d.row_mut(row).scale_mut(1.0 / gamma);
        }
        Ok(StateSpace::<Continuous>::new(self.m.a().clone(), self.m.b().clone(), c, d)?)
    }
}

fn margin(peak: MuPeak) -> Result<RobustMargin, Error> {
    Ok(RobustMargin { lower: 1.0 / peak.upper, upper: 1.0 / peak.lower.value, peak })
}

const GAIN_STEPS_MAX: usize = 60;
/// The level whose proof shows that the structured singular value is below one.
const BELOW_ONE: f64 = 1.0 - 1e-9;
