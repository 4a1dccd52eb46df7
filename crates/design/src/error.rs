//! Everything that can go wrong at the desk.

use num_complex::Complex64;
use thiserror::Error;

use crate::synthesize::Condition;
use crate::synthesize::pid::PidLimit;

/// Why a stage of identification, synthesis, verification or implementation gave no answer.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum Error {
    /// A system of `telepulse-lti` could not be built or evaluated.
    #[error(transparent)]
    System(#[from] telepulse_lti::Error),

    // ---- identify ----
    /// An option or a setting lies outside of what is allowed.
    #[error("{key} must be {allowed}, found {found}")]
    OutOfRange {
        /// Name of the setting, with its unit.
        key: &'static str,
        /// What was found.
        found: f64,
        /// What is allowed, in words.
        allowed: &'static str,
    },
    /// A list that must hold something holds nothing.
    #[error("{key} must hold at least one value, found none")]
    EmptyList {
        /// Name of the list.
        key: &'static str,
    },
    /// The sine would drive the amplifier out of its range 0 to 1.
    #[error("bias {bias} with amplitude {amplitude} leaves the drive range 0 to 1")]
    DriveRange {
        /// Bias, fraction of full scale.
        bias: f64,
        /// Amplitude of the sine, fraction of full scale.
        amplitude: f64,
    },
    /// Two frequencies become one when each is fitted to a whole number of samples.
    #[error(
        "frequencies {first_hz} Hz and {second_hz} Hz are the same at the sample rate, allowed are distinct ones"
    )]
    SameFrequency {
        /// The one that comes first.
        first_hz: f64,
        /// The one that comes second.
        second_hz: f64,
    },
    /// A recording has not the length that the plan asks for.
    #[error("{signal} must hold {expected} samples, found {found}")]
    SampleCount {
        /// Which signal.
        signal: &'static str,
        /// Samples expected.
        expected: usize,
        /// Samples found.
        found: usize,
    },
    /// A recording holds a value that is not a number.
    #[error("{signal} must be finite, found {found} at sample {sample_idx}")]
    SampleNotFinite {
        /// Which signal.
        signal: &'static str,
        /// Where.
        sample_idx: usize,
        /// What was found.
        found: f64,
    },
    /// The recording holds no line at the frequency of excitation.
    #[error(
        "{signal} must have a line at {frequency_hz} Hz, found amplitude {found} (frozen sensor or drive not connected)"
    )]
    NoLine {
        /// Which signal.
        signal: &'static str,
        /// Frequency of the excitation in Hz.
        frequency_hz: f64,
        /// Amplitude found there.
        found: f64,
    },
    /// The sweep text holds no table.
    #[error("sweep must start with the header `{expected}`, found an empty file")]
    SweepEmpty {
        /// The header expected.
        expected: &'static str,
    },
    /// A column of the sweep is missing.
    #[error("line {line}: column `{column}` is missing, found `{found}`, expected `{expected}`")]
    SweepColumnMissing {
        /// Line number, from 1.
        line: usize,
        /// Name of the column.
        column: &'static str,
        /// The header found.
        found: String,
        /// The header expected.
        expected: &'static str,
    },
    /// A column that the format does not know, or one that is named twice.
    #[error("line {line}: column `{found}` is unknown or repeated, allowed is `{expected}`")]
    SweepColumnUnknown {
        /// Line number, from 1.
        line: usize,
        /// The column found.
        found: String,
        /// The header expected.
        expected: &'static str,
    },
    /// A line of the sweep has too many or too few fields.
    #[error("line {line}: expected {expected} fields, found {found}")]
    SweepFieldCount {
        /// Line number, from 1.
        line: usize,
        /// Fields expected.
        expected: usize,
        /// Fields found.
        found: usize,
    },
    /// A field of the sweep cannot be used.
    #[error("line {line}, column `{column}`: allowed is {allowed}, found `{found}`")]
    SweepField {
        /// Line number, from 1.
        line: usize,
        /// Name of the column or of the key in a `# key: value` line.
        column: &'static str,
        /// The text found.
        found: String,
        /// What is allowed, in words.
        allowed: &'static str,
    },
    /// The same frequency and amplitude occur twice.
    #[error(
        "line {line}: {frequency_hz} Hz at amplitude {amplitude} was given before in line {first_line}, allowed is once"
    )]
    SweepDuplicate {
        /// Line number of the second, from 1 (point number where there is no text).
        line: usize,
        /// Line number of the first.
        first_line: usize,
        /// Frequency in Hz.
        frequency_hz: f64,
        /// Amplitude, fraction of full scale.
        amplitude: f64,
    },
    /// A sweep has too few different frequencies to carry a third-order model.
    #[error("sweep must hold at least {needed} different frequencies, found {found}")]
    SweepTooFewFrequencies {
        /// Needed.
        needed: usize,
        /// Found.
        found: usize,
    },
    /// The data do not determine the parameters.
    #[error(
        "the sweep does not determine the model: condition number {condition} of the scaled Jacobian, allowed {condition_max}"
    )]
    FitIllConditioned {
        /// Condition number found.
        condition: f64,
        /// Largest condition number allowed.
        condition_max: f64,
    },
    /// The least-squares iteration ended without meeting its stop test.
    #[error(
        "fit did not converge in {iterations} iterations: last relative step {relative_step}, allowed {relative_step_max}; rms residual {rms_residual}"
    )]
    FitNotConverged {
        /// Iterations made.
        iterations: usize,
        /// Last step relative to the parameters.
        relative_step: f64,
        /// Largest step that counts as converged.
        relative_step_max: f64,
        /// Root mean square of the residual where it stopped.
        rms_residual: f64,
    },
    /// The measured points equal the model, so there is no error to bound.
    #[error("all errors are zero: there is nothing to bound")]
    CoverNoError,
    /// The linear program behind the bound ended without a usable answer.
    #[error("bound of the errors not found: no weight of this order within a factor {ratio_max} of the data")]
    CoverInfeasible {
        /// Largest ratio of bound to error that was tried.
        ratio_max: f64,
    },

    // ---- families of responses ----
    /// A member of a family has other ports than the nominal response.
    #[error("member {member_idx} must be {expected_rows} x {expected_cols}, found {rows} x {cols}")]
    FamilyShape {
        /// Which member.
        member_idx: usize,
        /// Outputs of the nominal response.
        expected_rows: usize,
        /// Inputs of the nominal response.
        expected_cols: usize,
        /// Outputs found.
        rows: usize,
        /// Inputs found.
        cols: usize,
    },
    /// A member of a family holds a value that is not a number.
    #[error("member {member_idx} must be finite, found another value at point {point_idx}")]
    FamilyNotFinite {
        /// Which member.
        member_idx: usize,
        /// Which of its frequencies, from 0.
        point_idx: usize,
    },
    /// The frequencies of a member cannot be used.
    #[error("member {member_idx} must have {expected}")]
    FamilyGrid {
        /// Which member.
        member_idx: usize,
        /// What is expected, in words.
        expected: &'static str,
    },
    /// A multiplicative error needs an inverse of the nominal response.
    #[error(
        "nominal response must have a {side} inverse, found singular values from {smallest:e} to {largest:e} at {omega_rad_s} rad/s"
    )]
    NominalNotInvertible {
        /// On which side.
        side: &'static str,
        /// Where, in rad/s.
        omega_rad_s: f64,
        /// Smallest singular value.
        smallest: f64,
        /// Largest singular value.
        largest: f64,
    },

    // ---- implement: controller order ----
    /// No controller of lower order keeps the norm of the loop within its limit.
    #[error(
        "no controller below order {n_states} keeps the loop's norm at or below {limit}: the best found has order {best_order} and norm {best_norm}"
    )]
    ControllerNotReducible {
        /// Order of the controller as given.
        n_states: usize,
        /// The limit.
        limit: f64,
        /// Order of the best controller found.
        best_order: usize,
        /// Norm of its loop; infinite where none was stable.
        best_norm: f64,
    },

    // ---- implement ----
    /// A file was written by a version of the format that is not known here.
    #[error("{what} has version {found}, allowed is {allowed}")]
    Version {
        /// Which file.
        what: &'static str,
        /// Version found.
        found: u32,
        /// Version known here.
        allowed: u32,
    },
    /// A certificate needs a bound of the plant's error.
    #[error("plant model has no uncertainty bound, which a certificate needs")]
    NoUncertainty,
    /// Model and settings mean different commands.
    #[error("input linearization of the plant model and of the recipe must be the same")]
    LinearisationMismatch,
    /// The loop is stable, but neither robustness test passes.
    #[error(
        "loop is not robust: peak of |Ws Ms| is {frequency_wise} and the product of the norms is {norm_product}, one of them must be below 1"
    )]
    NotRobust {
        /// Peak of `|W_s M_s|`.
        frequency_wise: f64,
        /// Product of the norms of `M_s` and `W_s`.
        norm_product: f64,
    },
    /// A stored law differs from the controller that its certificate is about.
    #[error("law of the controller recipe is not the one that was certified")]
    LawChanged,
    /// A controller must have one input and one output.
    #[error("controller must have 1 input and 1 output, found {n_inputs} and {n_outputs}")]
    NotSiso {
        /// Inputs found.
        n_inputs: usize,
        /// Outputs found.
        n_outputs: usize,
    },
    /// The modes of a controller lie so close together that a modal form would lose the response.
    #[error(
        "modes of the controller are too close: condition number {condition} of the modal transformation, allowed {condition_max}"
    )]
    ModesIllConditioned {
        /// Condition number of the eigenvectors, columns scaled.
        condition: f64,
        /// Largest condition number allowed.
        condition_max: f64,
    },
    /// A pole of the controller has no image at this sample time.
    #[error("controller pole {pole_rad_s} rad/s has no bilinear image at sample time {sample_time_s} s")]
    PoleAtTwoOverT {
        /// Real part of the pole in rad/s.
        pole_rad_s: f64,
        /// Sample time in s.
        sample_time_s: f64,
    },
    /// The realised controller does not have the response that it was made from.
    #[error("realised controller is off by {found} (relative) at {omega_rad_s} rad/s, allowed {allowed}")]
    RealizationError {
        /// Relative error found.
        found: f64,
        /// Where, in rad/s.
        omega_rad_s: f64,
        /// Relative error allowed.
        allowed: f64,
    },
    /// A recipe controls another quantity than its model describes.
    #[error("the recipe controls another quantity than the certified model describes")]
    ControlledMismatch,
    /// Set-point weights of a law that has no parts to weigh.
    #[error("set-point weights (`setpoint_weights`) belong to a PID controller, found a state-space law")]
    WeightsWithoutPid,
    /// A certified recipe's feedforward is not the one of its model.
    #[error(
        "the feedforward of the recipe is not the preview filter of the certified model: it was changed, or made for another plant"
    )]
    FeedforwardMismatch,
    /// A plant that moves against its command.
    #[error("the plant's gain at rest must be positive, found {dc_gain}: reverse the sign of the response")]
    NegativeGain {
        /// Gain at rest.
        dc_gain: f64,
    },
    /// A bound that is zero certifies anything.
    #[error(
        "the bound of the uncertainty must not be zero: a model without any error certifies every stable loop"
    )]
    ZeroBound,
    /// A static curve does not rise strictly.
    #[error("static curve must rise strictly, found {previous} then {found} in {column} at row {row}")]
    NotMonotone {
        /// Which column.
        column: &'static str,
        /// Row of the second value, from 0.
        row: usize,
        /// The value before.
        previous: f64,
        /// The value found.
        found: f64,
    },
    /// The preview filter would need more taps than the bound on its length.
    #[error("preview filter needs more than {taps_max} taps: widen its transition or lower the sample rate")]
    PreviewTooLong {
        /// Largest number of taps.
        taps_max: usize,
    },
    /// The plant cannot be inverted at a frequency inside the pass band.
    #[error("plant response is zero at {frequency_hz} Hz, inside the pass band of the preview filter")]
    PreviewPlantZero {
        /// Frequency in Hz.
        frequency_hz: f64,
    },

    // ---- synthesize ----
    /// A weight of the synthesis has a pole on the closed right half plane.
    #[error("weight {weight} must be stable, found a pole at {pole} rad/s")]
    WeightNotStable {
        /// Which weight.
        weight: &'static str,
        /// The pole in rad/s.
        pole: Complex64,
    },
    /// The control input does not reach the performance output directly in all its directions.
    #[error(
        "D12 ({n_z} x {n_u}) must have full column rank, found singular values from {smallest:e} to {largest:e}: some control input has no direct weight"
    )]
    SingularD12 {
        /// Rows, performance outputs.
        n_z: usize,
        /// Columns, control inputs.
        n_u: usize,
        /// Largest singular value.
        largest: f64,
        /// Smallest singular value.
        smallest: f64,
    },
    /// The measured output is not disturbed directly in all its directions.
    #[error(
        "D21 ({n_y} x {n_w}) must have full row rank, found singular values from {smallest:e} to {largest:e}: some measurement is free of noise"
    )]
    SingularD21 {
        /// Rows, measured outputs.
        n_y: usize,
        /// Columns, exogenous inputs.
        n_w: usize,
        /// Largest singular value.
        largest: f64,
        /// Smallest singular value.
        smallest: f64,
    },
    /// An unstable mode is out of reach of the control input.
    #[error("plant must be stabilizable, found the unreachable mode {mode} rad/s")]
    NotStabilizable {
        /// The mode in rad/s.
        mode: Complex64,
    },
    /// An unstable mode does not show in the measured output.
    #[error("plant must be detectable, found the invisible mode {mode} rad/s")]
    NotDetectable {
        /// The mode in rad/s.
        mode: Complex64,
    },
    /// A path of the generalized plant has a zero on the imaginary axis.
    #[error("the path from {path} must have no zero on the imaginary axis, found one at {omega_rad_s} rad/s")]
    AxisZero {
        /// The path.
        path: &'static str,
        /// Frequency of the zero in rad/s.
        omega_rad_s: f64,
    },
    /// No controller reaches any norm up to the largest one tried.
    #[error("no controller reaches a norm of {gamma_max:e} or less{}", match binding { Some(c) => format!(", violated: {c:?}"), None => String::new() })]
    Infeasible {
        /// Largest gamma tried.
        gamma_max: f64,
        /// The condition that failed there.
        binding: Option<Condition>,
    },
    /// The search for the smallest gamma did not end within its bound.
    #[error("gamma did not converge, it lies between {gamma_lower} and {gamma_upper}")]
    NotConverged {
        /// Largest gamma known to be out of reach.
        gamma_lower: f64,
        /// Smallest gamma known to be within reach.
        gamma_upper: f64,
    },
    /// Rounding spoils every controller that was tried.
    #[error(
        "problem is ill-conditioned: a controller designed for gamma {gamma} gave a closed-loop norm of {achieved}"
    )]
    IllConditioned {
        /// Gamma of the last design.
        gamma: f64,
        /// Norm that its closed loop has; infinite where it is unstable or could not be formed.
        achieved: f64,
    },
    /// No design within the allowed relaxation keeps the controller's poles below the limit.
    #[error("controller pole must be at most {limit_rad_s} rad/s, found {pole_rad_s} rad/s at gamma {gamma}")]
    ControllerTooFast {
        /// Gamma of the last design.
        gamma: f64,
        /// Its fastest pole in rad/s.
        pole_rad_s: f64,
        /// The limit in rad/s.
        limit_rad_s: f64,
    },
    /// No design within the allowed relaxation keeps the controller's gain below the limit.
    #[error("controller gain must be at most {limit}, found {gain} at gamma {gamma}")]
    ControllerGainTooHigh {
        /// Gamma of the last design.
        gamma: f64,
        /// Its peak gain.
        gain: f64,
        /// The limit.
        limit: f64,
    },

    // ---- pid ----
    /// A plant that does nothing cannot be controlled.
    #[error("plant must not be zero")]
    PidPlantZero,
    /// A zero at the origin blocks integral action.
    #[error("plant must have no zero at s = 0: integral action cannot reach its output")]
    PidPlantZeroAtOrigin,
    /// The closed loop has poles that are not stable.
    #[error("closed loop must be stable, found {n_unstable} poles that are not")]
    PidLoopUnstable {
        /// Poles with real part at least zero.
        n_unstable: usize,
    },
    /// A dead time in a loop whose gain does not fall below one makes infinitely many unstable poles.
    #[error("loop gain at infinite frequency must be below 1, found {gain}")]
    PidLoopNeutral {
        /// Loop gain at infinite frequency.
        gain: f64,
    },
    /// The two counts of unstable poles do not agree, or a pole lies on the axis as far as rounding can tell.
    #[error(
        "stability of the loop is not certain: {direct} unstable poles by the direct method, {nyquist:?} by the argument principle"
    )]
    PidStabilityUncertain {
        /// Count by the direct method; negative where it contradicts itself or was not made.
        direct: i64,
        /// Count by the argument principle.
        nyquist: Option<usize>,
    },
    /// No gains were found that stabilise the plant.
    #[error(
        "no stabilizing PID controller was found for a plant with {n_unstable_plant} poles that are not stable"
    )]
    PidNotStabilized {
        /// Poles of the plant with real part at least zero.
        n_unstable_plant: usize,
    },
    /// Stabilising gains were found, but none that keep the limits.
    #[error(
        "no PID controller was found within the limits: least violation is a peak of {violation} times its limit"
    )]
    PidLimitsNotMet {
        /// Largest ratio of a peak to its limit for the best gains that were seen.
        violation: f64,
    },
    /// No controller with integral action can keep this limit.
    #[error(
        "limit {limit:?} cannot be met with integral action: at rest the function is {at_rest}, allowed is below {allowed}"
    )]
    PidLimitImpossible {
        /// Which limit.
        limit: PidLimit,
        /// Value at frequency zero, the same for all such controllers.
        at_rest: f64,
        /// The limit.
        allowed: f64,
    },
    /// The limits leave the integral gain free to grow.
    #[error(
        "limits do not bound the integral gain: it was still growing at {i_per_s} per s (limit the noise gain or slow the derivative filter)"
    )]
    PidGainUnbounded {
        /// Integral gain where the search was stopped.
        i_per_s: f64,
    },

    // ---- pid: forms, rules, margins ----
    /// The zeros of a PID controller are not both real and stable.
    #[error(
        "controller must have real stable zeros for a series form, found numerator coefficients {numerator:?} in descending powers"
    )]
    PidNoSeriesForm {
        /// Numerator over `s (s + N)`, or without derivative over `s`.
        numerator: [f64; 3],
    },
    /// A pole or zero that the half rule has no reduction for.
    #[error("the half rule needs real stable poles and real zeros, found {root} rad/s")]
    PidHalfRule {
        /// The pole or zero in rad/s.
        root: Complex64,
    },
    /// Proportional control does not bring the plant to its stability boundary.
    #[error("plant must become unstable under a large enough proportional gain and be stable below it")]
    PidNoCriticalPoint,
    /// The controller cannot turn the phase as far as the margin needs.
    #[error(
        "controller phase at {omega_rad_s} rad/s must be {needed_deg} degrees, within reach are {min_deg} to {max_deg}"
    )]
    PidPhaseOutOfReach {
        /// Crossover frequency in rad/s.
        omega_rad_s: f64,
        /// Phase the margin needs, in degrees.
        needed_deg: f64,
        /// Least phase within reach.
        min_deg: f64,
        /// Largest phase within reach.
        max_deg: f64,
    },
    /// The loop crosses gain one elsewhere with a smaller phase margin.
    #[error("phase margin must be at least {wanted_deg} degrees, found {found_deg} at {omega_rad_s} rad/s")]
    PidMarginNotMet {
        /// Phase margin asked for, in degrees.
        wanted_deg: f64,
        /// Least phase margin of all crossings, in degrees.
        found_deg: f64,
        /// Where it is, in rad/s.
        omega_rad_s: f64,
    },
    /// No crossover frequency gives a loop that is stable and has the margins asked for.
    #[error(
        "no crossover from {bottom_rad_s} to {top_rad_s} rad/s gives a stable loop with a phase margin of {phase_margin_deg} degrees and a peak of S below {ms_max}"
    )]
    PidNoCrossover {
        /// Lowest frequency that was tried, in rad/s.
        bottom_rad_s: f64,
        /// Highest frequency that was tried, in rad/s.
        top_rad_s: f64,
        /// Phase margin asked for, in degrees.
        phase_margin_deg: f64,
        /// Limit of the peak of S.
        ms_max: f64,
    },

    // ---- synthesize: mixed sensitivity, H2, loop shaping ----
    /// A mixed-sensitivity problem without any weight asks for nothing.
    #[error("mixed sensitivity needs at least one of the weights W1, W2, W3, found none")]
    NoWeight,
    /// The closed loop passes white noise directly whatever the controller does.
    #[error(
        "H2 norm is infinite for every controller: {direct_term:e} of D11 cannot be cancelled by static feedback"
    )]
    InfiniteH2Norm {
        /// Norm of the part of `D11` that no static feedback cancels.
        direct_term: f64,
    },
    /// The shaped plant of a loop-shaping problem cannot be stabilized.
    #[error("shaped plant must be stabilizable and detectable (was a mode cancelled by a weight?): {reason}")]
    ShapedPlant {
        /// What the Riccati equation ran into.
        reason: telepulse_lti::Error,
    },

    // ---- uncertain ----
    /// A perturbation needs at least one block.
    #[error("an uncertainty structure must have at least one block, found none")]
    NoUncertainBlocks,
    /// A block of the perturbation has no ports.
    #[error("uncertainty block {index} must have at least one row and one column, found {rows} x {cols}")]
    EmptyBlock {
        /// Number of the block, from zero.
        index: usize,
        /// Rows found.
        rows: usize,
        /// Columns found.
        cols: usize,
    },
    /// The value of a block is not of the kind or size of the block.
    #[error(
        "the value of uncertainty block {index} does not fit the block, or there are too few or too many values"
    )]
    BlockMismatch {
        /// Number of the block, from zero.
        index: usize,
    },
    /// The ends of a parameter do not make a range.
    #[error("parameter `{name}` must have finite ends, the lower below the upper, found {lower} and {upper}")]
    ParameterRange {
        /// The parameter.
        name: String,
        /// Lower end found.
        lower: f64,
        /// Upper end found.
        upper: f64,
    },
    /// There are more or fewer values, or systems, than parameters.
    #[error("expected one entry for each of {expected} parameters, found {found}")]
    ParameterCount {
        /// Parameters.
        expected: usize,
        /// Entries found.
        found: usize,
    },
    /// A parameter changes how many states, inputs or outputs a system has.
    #[error("states, inputs and outputs must not change in number with parameter `{parameter}`")]
    ParameterShape {
        /// The parameter, or those that were moved together.
        parameter: String,
    },
    /// A model is not affine in its parameters.
    #[error(
        "E, A, B, C, D must be affine in `{parameter}` to {allowed:e}, found a relative deviation of {deviation:e} at {values:?}: take the product or quotient as a parameter of its own, or a mass into E"
    )]
    NotAffine {
        /// The parameter, or those that were moved together.
        parameter: String,
        /// Their values there.
        values: Vec<f64>,
        /// Largest deviation of an entry, relative to its size.
        deviation: f64,
        /// Largest deviation allowed.
        allowed: f64,
    },
    /// Nothing changes with a parameter.
    #[error("parameter `{parameter}` must have an effect on the system, found none beyond rounding")]
    ParameterWithoutEffect {
        /// The parameter.
        parameter: String,
    },
    /// The matrix of the derivatives has no inverse.
    #[error(
        "E must be invertible with the parameters at their centres, found scaled singular values from {smallest:e} to {largest:e}"
    )]
    SingularDescriptor {
        /// Smallest singular value of the scaled matrix.
        smallest: f64,
        /// Largest one.
        largest: f64,
    },
    /// Rounding spoils every proof of an upper bound of the structured singular value.
    #[error("the upper bound {level:e} of the structured singular value cannot be proven within rounding")]
    MuNotProven {
        /// The last level tried.
        level: f64,
    },

    // ---- synthesize: D-K iteration ----
    /// A matrix has no singular value decomposition within the bound of the iteration.
    #[error("singular values did not converge")]
    SingularValuesNotConverged,
    /// A stage of a D-K iteration must give as many scales as there are blocks, each positive and finite.
    #[error("{stage} must give {expected} positive scales, found {found}")]
    StageScales {
        /// Which stage.
        stage: &'static str,
        /// Blocks of the perturbation.
        expected: usize,
        /// Usable scales found.
        found: usize,
    },

    // ---- verify ----
    /// The closed loop is not stable, so it has no certificate.
    #[error("closed loop must be stable, found poles at {} rad/s", list(poles))]
    UnstableLoop {
        /// The closed-loop poles that are not stable, in rad/s.
        poles: Vec<Complex64>,
    },
    /// A system that must be stable by itself is not.
    #[error("{system} must be stable, found a pole at {pole} rad/s")]
    UnstableElement {
        /// Which system.
        system: &'static str,
        /// The pole in rad/s.
        pole: Complex64,
    },
    /// A loop that is to be broken channel by channel must have as many inputs as outputs.
    #[error("loop must have {expected}, found {n_inputs} inputs and {n_outputs} outputs")]
    NotSquareLoop {
        /// Inputs found.
        n_inputs: usize,
        /// Outputs found.
        n_outputs: usize,
        /// What is expected, in words.
        expected: &'static str,
    },
}

fn list(poles: &[Complex64]) -> String {
    let texts: Vec<String> = poles.iter().map(|pole| format!("{pole:.4}")).collect();
    texts.join(", ")
}
