//! Why an operation on a linear system was refused or gave no answer.

use num_complex::Complex64;
use thiserror::Error;

/// Every way in which this crate declines to answer.
///
/// Wrong input, an ill-posed question, a singular point and a failed iteration are different variants, because a
/// caller does different things about them.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum Error {
    /// A matrix does not have the shape that its neighbours ask for.
    #[error("{matrix} must be {expected_rows} x {expected_cols}, found {rows} x {cols}")]
    Shape {
        /// Which matrix.
        matrix: &'static str,
        /// Rows asked for.
        expected_rows: usize,
        /// Columns asked for.
        expected_cols: usize,
        /// Rows found.
        rows: usize,
        /// Columns found.
        cols: usize,
    },
    /// The rows of a matrix that was read differ in length.
    #[error("row {row} of {matrix} must have {expected} entries, found {found}")]
    RaggedRow {
        /// Which matrix.
        matrix: &'static str,
        /// Row number, from zero.
        row: usize,
        /// Entries in the first row.
        expected: usize,
        /// Entries in this row.
        found: usize,
    },
    /// A system needs at least one input and one output.
    #[error("a system needs at least one input and one output, found {n_inputs} and {n_outputs}")]
    NoPorts {
        /// Inputs found.
        n_inputs: usize,
        /// Outputs found.
        n_outputs: usize,
    },
    /// The ports of two systems do not fit together.
    #[error("{operation} needs {expected} {port}, found {found}")]
    PortCount {
        /// What was to be built.
        operation: &'static str,
        /// Which ports were counted.
        port: &'static str,
        /// Ports asked for.
        expected: usize,
        /// Ports found.
        found: usize,
    },
    /// An input or output number is beyond the last one.
    #[error("{port} index must be below {count}, found {index}")]
    PortIndex {
        /// `input` or `output`.
        port: &'static str,
        /// How many there are.
        count: usize,
        /// The number asked for, from zero.
        index: usize,
    },
    /// The operation is for systems with one input and one output.
    #[error("expected one input and one output, found {n_inputs} and {n_outputs}")]
    NotSiso {
        /// Inputs found.
        n_inputs: usize,
        /// Outputs found.
        n_outputs: usize,
    },
    /// The operation is for systems with as many inputs as outputs.
    #[error("expected as many inputs as outputs, found {n_inputs} and {n_outputs}")]
    NotSquare {
        /// Inputs found.
        n_inputs: usize,
        /// Outputs found.
        n_outputs: usize,
    },
    /// A number is NaN or infinite.
    #[error("{quantity} must be finite, found {value} at index {index}")]
    NotFinite {
        /// What the numbers are.
        quantity: &'static str,
        /// Position, column by column for a matrix.
        index: usize,
        /// The value found.
        value: f64,
    },
    /// A sample time or a duration must be positive and finite.
    #[error("{quantity} must be positive and finite, found {seconds} s")]
    Duration {
        /// What the time is for.
        quantity: &'static str,
        /// The value found, in seconds.
        seconds: f64,
    },
    /// Two systems that are to be connected are sampled differently.
    #[error("sample times must agree, found {left_s} s and {right_s} s")]
    SampleTimeMismatch {
        /// Sample time of the first system in seconds.
        left_s: f64,
        /// Sample time of the second system in seconds.
        right_s: f64,
    },
    /// A stored system names a sample time but is read as continuous, or the reverse.
    #[error("a {expected} system was expected, found sample_time_s {}", match sample_time_s { Some(s) => s.to_string(), None => "absent".to_owned() })]
    WrongTimeDomain {
        /// `continuous` or `discrete`.
        expected: &'static str,
        /// The sample time found, in seconds.
        sample_time_s: Option<f64>,
    },
    /// Frequencies must be finite, not negative, and increasing.
    #[error(
        "frequencies must be finite, not negative and increasing, found {omega_rad_s} rad/s at index {index}"
    )]
    FrequencyGrid {
        /// Position in the grid.
        index: usize,
        /// The frequency found, in rad/s.
        omega_rad_s: f64,
    },
    /// The pre-warping frequency must lie strictly between zero and the Nyquist frequency.
    #[error("pre-warping frequency must lie in (0, {nyquist_rad_s}) rad/s, found {omega_rad_s} rad/s")]
    PrewarpFrequency {
        /// The frequency found, in rad/s.
        omega_rad_s: f64,
        /// Half the sampling frequency in rad/s.
        nyquist_rad_s: f64,
    },
    /// A polynomial without coefficients, or with zeros only, where one with a leading term is needed.
    #[error("{polynomial} must have a coefficient other than zero")]
    ZeroPolynomial {
        /// Which polynomial.
        polynomial: &'static str,
    },
    /// The numerator has a higher degree than the denominator.
    #[error(
        "transfer function must be proper, found numerator degree {numerator_degree} over denominator degree {denominator_degree}"
    )]
    Improper {
        /// Degree of the numerator.
        numerator_degree: usize,
        /// Degree of the denominator.
        denominator_degree: usize,
    },
    /// A loop whose direct terms leave its signals undefined.
    #[error(
        "algebraic loop: the loop's direct term is singular, smallest singular value {smallest_singular_value:e} against {threshold:e}"
    )]
    AlgebraicLoop {
        /// Smallest singular value of `I - D L`, with `L` the gain that closes the loop.
        smallest_singular_value: f64,
        /// The value below which the loop counts as singular.
        threshold: f64,
    },
    // ---- connect ----
    /// A name of a signal, or of a part of one, cannot be read.
    #[error("signal name must be like `y`, `y[1]` or `y[0..2]`, found `{name}`")]
    SignalName {
        /// The text found.
        name: String,
    },
    /// A sum cannot be read.
    #[error("sum must be like `e = r - 0.5*y[1]` with {reason}, found `{expression}`")]
    SumExpression {
        /// The text found.
        expression: String,
        /// What is missing.
        reason: &'static str,
    },
    /// A name that nothing makes.
    #[error(
        "signal `{signal}`, read by {place}, is not the output of any block or sum, nor an external input"
    )]
    UnknownSignal {
        /// The name.
        signal: String,
        /// What reads it.
        place: String,
    },
    /// A name that is made twice.
    #[error("signal `{signal}` must be made once, found a second block, sum or external input of this name")]
    DuplicateSignal {
        /// The name.
        signal: String,
    },
    /// A signal that nothing reads.
    #[error("signal `{signal}` is read by nothing: connect it or leave it open explicitly")]
    UnconnectedSignal {
        /// The name.
        signal: String,
    },
    /// A signal has another number of channels than its place.
    #[error("{place} must be {expected} channels wide, found {found} in `{signal}`")]
    SignalWidth {
        /// The name or names.
        signal: String,
        /// Where it is made or read.
        place: String,
        /// Channels asked for.
        expected: usize,
        /// Channels found.
        found: usize,
    },
    /// A channel beyond the last one.
    #[error("channel of signal `{signal}` must be below {width}, found {index}")]
    SignalIndex {
        /// The name.
        signal: String,
        /// Number of channels.
        width: usize,
        /// The channel asked for, from zero.
        index: usize,
    },
    /// A loop of direct terms leaves these signals undefined.
    #[error(
        "algebraic loop through {}: smallest singular value {smallest_singular_value:e} against {threshold:e}",
        signals.join(", ")
    )]
    SignalLoop {
        /// The signals in the loop.
        signals: Vec<String>,
        /// Smallest singular value of `I - D L`, with `L` the gain that closes the loop.
        smallest_singular_value: f64,
        /// The value below which the loop counts as singular.
        threshold: f64,
    },
    /// A diagram without blocks has no time domain.
    #[error("a diagram needs at least one block, found none")]
    NoBlocks,
    // ---- response ----
    /// A response was asked for at a pole.
    #[error("the response has a pole at the frequency {omega_rad_s} rad/s")]
    PoleAtFrequency {
        /// The frequency in rad/s.
        omega_rad_s: f64,
    },
    /// A pole sits where the bilinear map sends it to infinity.
    #[error("the bilinear transformation is singular for a pole at {pole}")]
    BilinearPole {
        /// The point, in the plane of the system that was to be converted.
        pole: f64,
    },
    /// The determinant of a square system vanishes for every frequency, so every number is a zero of it.
    #[error("the system has no full normal rank, so its transmission zeros are undefined")]
    RankDeficientSystem,
    /// The QR iteration for eigenvalues did not end within its bound.
    #[error("eigenvalues of a {n} x {n} matrix did not converge in {iterations} iterations")]
    EigenvaluesNotConverged {
        /// Size of the matrix.
        n: usize,
        /// Iterations allowed.
        iterations: usize,
    },
    /// A conversion overflowed the range of floating point.
    #[error("{operation} left the range of floating point")]
    Overflow {
        /// What was computed.
        operation: &'static str,
    },
    /// Complex numbers were to be the roots of a real polynomial but are not closed under conjugation.
    #[error("roots of a real polynomial must come in conjugate pairs, found {root} without its partner")]
    UnpairedRoot {
        /// The root without a partner.
        root: Complex64,
    },
    /// Two neighbouring diagonal blocks of a real Schur form could not be swapped within rounding.
    #[error("schur blocks could not be swapped: {discarded:e} of their norm would have been discarded")]
    SwapFailed {
        /// What the swap would have set to zero, relative to the norm of the two blocks.
        discarded: f64,
    },
    /// The matrix must be symmetric.
    #[error("{matrix} must be symmetric, found a relative asymmetry of {asymmetry:e}")]
    NotSymmetric {
        /// Which matrix.
        matrix: &'static str,
        /// Norm of the antisymmetric part over the norm of the matrix.
        asymmetry: f64,
    },
    /// A Hamiltonian matrix has eigenvalues on the imaginary axis, so it has no stable subspace of full dimension.
    #[error(
        "the hamiltonian matrix has eigenvalues on the imaginary axis, nearest {re:e} rad/s off it at {omega_rad_s} rad/s"
    )]
    HamiltonianAxis {
        /// Distance from the axis of the nearest eigenvalue, in rad/s.
        re: f64,
        /// Its imaginary part in rad/s.
        omega_rad_s: f64,
    },
    /// The stable subspace of a Hamiltonian matrix is not the graph of a matrix `X`.
    #[error(
        "the riccati equation has no finite stabilizing solution: reciprocal condition {reciprocal_condition:e}"
    )]
    NoStabilizingSolution {
        /// Smallest over largest singular value of the upper half of the subspace's basis.
        reciprocal_condition: f64,
    },
    /// A matrix that has to be inverted is singular.
    #[error("{matrix} must be invertible, found the reciprocal condition {reciprocal_condition:e}")]
    Singular {
        /// Which matrix.
        matrix: &'static str,
        /// Smallest over largest singular value.
        reciprocal_condition: f64,
    },
    /// A Lyapunov equation whose matrix has two eigenvalues with the forbidden sum or product has no unique solution.
    #[error(
        "the lyapunov equation is singular: two eigenvalues of a {relation}, pivot {pivot:e} against {threshold:e}"
    )]
    LyapunovSingular {
        /// `sum to zero` or `multiply to one`.
        relation: &'static str,
        /// Smallest pivot met.
        pivot: f64,
        /// The value below which the equation counts as singular.
        threshold: f64,
    },
    // ---- matrix equations ----
    /// A Sylvester equation whose matrices have eigenvalues with the forbidden sum or product has no unique solution.
    #[error(
        "the sylvester equation is singular: eigenvalues of its two matrices {relation}, pivot {pivot:e} against {threshold:e}"
    )]
    SylvesterSingular {
        /// `sum to zero` or `multiply to one`.
        relation: &'static str,
        /// Smallest pivot met.
        pivot: f64,
        /// The value below which the equation counts as singular.
        threshold: f64,
    },
    /// The inputs cannot move an unstable mode, so no feedback stabilizes it.
    #[error("no input reaches the mode at {pole}: smallest singular value {smallest_singular_value:e}")]
    NotStabilizable {
        /// The mode, in rad/s (continuous) or in the z plane (discrete).
        pole: Complex64,
        /// Smallest singular value of `[A - pole I, B]` in balanced coordinates, over its norm.
        smallest_singular_value: f64,
    },
    /// A symplectic pencil has eigenvalues on the unit circle, so the discrete equation has no stabilizing solution.
    #[error("the symplectic pencil has eigenvalues on the unit circle, nearest {point}")]
    SymplecticCircle {
        /// The nearest eigenvalue, in the z plane.
        point: Complex64,
    },
    /// No route to the solution of a Riccati equation left a small residual and a stable closed loop.
    #[error(
        "the riccati equation is too ill conditioned: best relative residual {residual_relative:e}, condition {condition:e}"
    )]
    RiccatiIllConditioned {
        /// Smallest residual of any route, relative to the terms of the equation.
        residual_relative: f64,
        /// Estimate of the condition at that solution; infinite where its closed loop is not stable.
        condition: f64,
    },
    /// The second route to a Riccati solution ran into its bound.
    #[error("the {route} iteration for a riccati equation did not converge in {iterations} steps")]
    RiccatiNotConverged {
        /// Which iteration.
        route: &'static str,
        /// Steps allowed.
        iterations: usize,
    },
    // ---- reduce ----
    /// A setting of a reduction lies outside of what is allowed.
    #[error("{setting} must be {allowed}, found {found}")]
    ReductionSetting {
        /// Name of the setting.
        setting: &'static str,
        /// What was found.
        found: f64,
        /// What is allowed, in words.
        allowed: &'static str,
    },
    /// A reduced order that cannot be had.
    #[error("reduced order must be from {min} (modes that have to be kept) to {max}, found {found}")]
    ReductionOrder {
        /// Order asked for.
        found: usize,
        /// Number of modes that are kept in any case.
        min: usize,
        /// Order of the system.
        max: usize,
    },
    /// An order that would cut between equal Hankel singular values, where no optimal approximation is defined.
    #[error("order {order} cuts between the equal hankel singular values {kept:e} and {dropped:e}")]
    HankelGap {
        /// Order asked for.
        order: usize,
        /// Smallest value on the kept side.
        kept: f64,
        /// Largest value on the other side.
        dropped: f64,
    },
    /// Two parts of a system share a pole to working precision, so they cannot be separated.
    #[error("the two parts share a pole to working precision: pivot {pivot:e} against {threshold:e}")]
    SpectraOverlap {
        /// Smallest pivot met.
        pivot: f64,
        /// The value below which the poles count as equal.
        threshold: f64,
    },
    /// A reduction whose method does not promise stability lost it.
    #[error("the system of order {order} that the reduction left is unstable, with a pole at {pole}")]
    ReducedUnstable {
        /// Order of the reduced system.
        order: usize,
        /// The pole at fault.
        pole: Complex64,
    },
    /// The H2 norm of a continuous system with a direct term is infinite.
    #[error("the H2 norm of a continuous system is infinite unless D is zero, found a D of norm {norm}")]
    DirectTerm {
        /// Frobenius norm of `D`.
        norm: f64,
    },
    /// The question makes sense for stable systems only.
    #[error("expected a stable system, found a pole at {pole}")]
    Unstable {
        /// The least stable pole, in rad/s (continuous) or in the unit of the z plane (discrete).
        pole: Complex64,
    },
    /// The peak gain was found but no level above it could be shown to be free of crossings.
    #[error("peak gain at least {lower} could not be bounded from above: last level tried {level}")]
    PeakNotBounded {
        /// Largest gain seen.
        lower: f64,
        /// Last level tried.
        level: f64,
    },
}
