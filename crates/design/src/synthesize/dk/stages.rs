//! The three stages of a D-K iteration, each of which a caller may replace.

use nalgebra::DMatrix;
use num_complex::Complex64;
use telepulse_lti::{Continuous, GeneralizedPlant, StateSpace};

use super::blocks::FullBlocks;
use super::mu_step::ScaledGain;
use super::scale_fit::{FittedScales, ScaleSample};
use crate::Error;

/// What the controller stage gives.
#[derive(Clone, Debug, PartialEq)]
pub struct SynthesizedController {
    /// The controller, `u = K y`.
    pub controller: StateSpace<Continuous>,
    /// The norm that it was designed for; only reported.
    pub gamma: f64,
}

/// Makes a controller that stabilizes a plant and makes its norm from `w` to `z` small.
pub trait ControllerStage {
    /// The controller of the scaled plant.
    ///
    /// **Errors**: whatever keeps the stage from an answer.
    fn controller(&self, scaled: &GeneralizedPlant) -> Result<SynthesizedController, Error>;
}

/// Bounds the structured singular value of one matrix and gives the scales of the bound, one per block.
pub trait AnalysisStage {
    /// The bound at one frequency.
    ///
    /// **Errors**: whatever keeps the stage from an answer.
    fn bound(&self, response: &DMatrix<Complex64>, blocks: &FullBlocks) -> Result<ScaledGain, Error>;
}

/// Turns scales at frequencies into systems.
pub trait FitStage {
    /// The scales of the next plant.
    ///
    /// **Errors**: whatever keeps the stage from an answer.
    fn fit(&self, samples: &[ScaleSample], blocks: &FullBlocks) -> Result<FittedScales, Error>;
}

impl<F: Fn(&GeneralizedPlant) -> Result<SynthesizedController, Error>> ControllerStage for F {
    fn controller(&self, scaled: &GeneralizedPlant) -> Result<SynthesizedController, Error> {
        self(scaled)
    }
}

impl<F: Fn(&DMatrix<Complex64>, &FullBlocks) -> Result<ScaledGain, Error>> AnalysisStage for F {
    fn bound(&self, response: &DMatrix<Complex64>, blocks: &FullBlocks) -> Result<ScaledGain, Error> {
        self(response, blocks)
    }
}

impl<F: Fn(&[ScaleSample], &FullBlocks) -> Result<FittedScales, Error>> FitStage for F {
    fn fit(&self, samples: &[ScaleSample], blocks: &FullBlocks) -> Result<FittedScales, Error> {
        self(samples, blocks)
    }
}

/// The stages of a D-K iteration; functions and closures are stages too.
#[derive(Clone, Copy)]
pub struct DkStages<'a> {
    /// K step.
    pub controller: &'a dyn ControllerStage,
    /// Analysis of mu at one frequency.
    pub analysis: &'a dyn AnalysisStage,
    /// D step.
    pub fit: &'a dyn FitStage,
}
