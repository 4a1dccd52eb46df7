//! From measurements to a model with a bound on its error.
//!
//! - [`SweepPlan`]: which sine when, as samples to send to a drive; takes the recorded response back;
//! - [`SweepRecord`]: the measured points, as text that a user can supply instead;
//! - [`fit_third_order`]: gain, resonance and circuit pole, with standard errors;
//! - [`cap_additive_error`]: a second-order weight that lies on or above the error of every point;
//! - [`cover_family`]: the same for any family of responses, several ports, any order up to eight;
//! - [`PlantModel`]: what the synthesis works from.

mod certified_touch;
mod cover;
mod envelope;
mod family;
mod first_order;
mod fit;
mod grey_box;
mod least_squares;
mod magnitude_design;
mod minimum_phase;
mod model;
mod plan;
mod record;
mod record_csv;
mod spectrum;
mod third_order;

pub use cover::{
    CoverOptions, ErrorPoint, ErrorSeries, UncertaintyBound, cap_additive_error, cap_family_error,
};
pub use family::{
    Between, FamilyCover, FamilyOptions, FamilyWeight, OrderChoice, UncertaintyForm, WeightStructure,
    central_response, cover_family, cover_family_around,
};
pub use first_order::{FirstOrderFit, fit_first_order};
pub use fit::{FitOptions, Residual, ThirdOrderFit, Weighting, fit_third_order};
pub use grey_box::{
    CreepBranch, GreyBoxExperiment, GreyBoxExperimentOptions, GreyBoxFit, GreyBoxFitOptions, GreyBoxModel,
    GreyBoxRecord, GreyBoxState, PullTerm, fit_grey_box,
};
pub use magnitude_design::{BoundShape, ORDER_MAX};
pub(crate) use magnitude_design::{Design as MagnitudeDesign, Row as MagnitudeRow, design_magnitude};
pub(crate) use minimum_phase::MinimumPhase;
pub use model::{Controlled, InputLinearisation, ModelProvenance, PlantModel};
pub use plan::{SweepOptions, SweepPlan, SweepSegment, log_spaced};
pub use record::{Distortion, SweepPoint, SweepRecord};
pub use spectrum::{Line, extract_line};
pub use third_order::{ParameterErrors, RcPole};
