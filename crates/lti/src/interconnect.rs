//! Connecting systems: series, parallel, side by side, feedback, linear fractional transformations.
//!
//! All of them are special cases of one closure, [`StateSpace::close_loop`], applied to systems that stand side by side.

use crate::{Error, StateSpace, TimeDomain};
use nalgebra::DMatrix;

/// Which signals of a system drive its inputs, and which of them are seen from outside.
///
/// ```text
///              +---------------+
///   v ---+---->|      sys      |----+---> y ----> [outputs] ---> z
///        ^     +---------------+    |
///        |                          |
///       (+)<------- [feedback] <----+        v = feedback y + external r
///        ^                                   z = outputs y
///        +--[external]<-- r
/// ```
///
/// **Shapes**: for a system with `n_v` inputs and `n_y` outputs, `feedback: n_v × n_y`, `external: n_v × n_r`,
/// `outputs: n_z × n_y`.
#[derive(Debug, Clone, PartialEq)]
pub struct Wiring {
    /// From the outputs of the system to its inputs; positive sign.
    pub feedback: DMatrix<f64>,
    /// From the external inputs to the inputs of the system.
    pub external: DMatrix<f64>,
    /// From the outputs of the system to the external outputs.
    pub outputs: DMatrix<f64>,
}

impl<D: TimeDomain> StateSpace<D> {
    /// The system from `r` to `z` that the wiring makes of this one.
    ///
    /// **Method**: with `N = (I - D L)^-1` and the feedback `L`, `y = N (C x + D S r)`, inserted into state and output
    /// equation.
    ///
    /// # Errors
    /// [`Error::Shape`] where the wiring does not fit, [`Error::AlgebraicLoop`] where `I - D L` is singular,
    /// [`Error::NotFinite`] where a product overflows.
    pub fn close_loop(&self, wiring: &Wiring) -> Result<Self, Error> {
        let (n_v, n_y) = (self.n_inputs(), self.n_outputs());
        let Wiring { feedback, external, outputs } = wiring;
        check_shape("feedback", feedback, n_v, n_y)?;
        check_shape("external", external, n_v, external.ncols())?;
        check_shape("outputs", outputs, outputs.nrows(), n_y)?;
        let loop_gain = self.d() * feedback;
        let inverse = inverse_of_well_posed(&(DMatrix::identity(n_y, n_y) - loop_gain))?;
        let y_of_x = &inverse * self.c();
        let y_of_r = &inverse * (self.d() * external);
        let a = self.a() + self.b() * (feedback * &y_of_x);
        let b = self.b() * (external + feedback * &y_of_r);
        Self::with_domain(a, b, outputs * y_of_x, outputs * y_of_r, *self.domain())
    }

    /// This system followed by `next`: `y = next(self(u))`.
    ///
    /// # Errors
    /// [`Error::PortCount`] unless `next` has as many inputs as this system has outputs, [`Error::SampleTimeMismatch`].
    ///
    /// # Example
    /// ```
    /// use telepulse_lti::TransferFunction;
    /// let (g, h) = (TransferFunction::new(&[2.0], &[1.0, 3.0])?, TransferFunction::new(&[1.0], &[1.0, 4.0])?);
    /// let both = g.to_state_space().series(&h.to_state_space())?;
    /// assert!((both.at(1.5)?[(0, 0)] - g.at(1.5) * h.at(1.5)).norm() < 1e-15);
    /// # Ok::<(), telepulse_lti::Error>(())
    /// ```
    pub fn series(&self, next: &Self) -> Result<Self, Error> {
        check_count("a series connection", "inputs of the second system", self.n_outputs(), next.n_inputs())?;
        check_domains(self, next)?;
        let (n1, n2) = (self.n_states(), next.n_states());
        let a = blocks(self.a(), &DMatrix::zeros(n1, n2), &(next.b() * self.c()), next.a());
        let b = stack(self.b(), &(next.b() * self.d()));
        let c = beside(&(next.d() * self.c()), next.c());
        Self::with_domain(a, b, c, next.d() * self.d(), *self.domain())
    }

    /// The sum of two systems with the same inputs: `y = self(u) + other(u)`.
    ///
    /// # Errors
    /// [`Error::PortCount`] unless the ports agree in number, [`Error::SampleTimeMismatch`].
    pub fn parallel(&self, other: &Self) -> Result<Self, Error> {
        check_count(
            "a parallel connection",
            "inputs of the second system",
            self.n_inputs(),
            other.n_inputs(),
        )?;
        check_count(
            "a parallel connection",
            "outputs of the second system",
            self.n_outputs(),
            other.n_outputs(),
        )?;
        check_domains(self, other)?;
        let a = block_diagonal(self.a(), other.a());
        let (b, c) = (stack(self.b(), other.b()), beside(self.c(), other.c()));
        Self::with_domain(a, b, c, self.d() + other.d(), *self.domain())
    }

    /// Two systems side by side, with the ports of `other` after those of this one.
    ///
    /// # Errors
    /// [`Error::SampleTimeMismatch`].
    pub fn augment(&self, other: &Self) -> Result<Self, Error> {
        check_domains(self, other)?;
        Ok(Self::from_valid_parts(
            block_diagonal(self.a(), other.a()),
            block_diagonal(self.b(), other.b()),
            block_diagonal(self.c(), other.c()),
            block_diagonal(self.d(), other.d()),
            *self.domain(),
        ))
    }

    /// The negative feedback loop of this system `G` with `H` in the return path: `(I + G H)^-1 G`.
    ///
    /// ```text
    ///   r --->(+)---> G ---+---> y
    ///          ^-          |
    ///          +---- H <---+
    /// ```
    ///
    /// # Errors
    /// [`Error::PortCount`] unless the ports of `return_path` mirror those of this system,
    /// [`Error::AlgebraicLoop`] where `I + D_G D_H` is singular, [`Error::SampleTimeMismatch`].
    ///
    /// # Example
    /// ```
    /// use telepulse_lti::TransferFunction;
    /// let integrator = TransferFunction::new(&[5.0], &[1.0, 0.0])?.to_state_space();
    /// let unity = TransferFunction::from_gain(1.0)?.to_state_space();
    /// let closed = integrator.feedback(&unity)?;
    /// assert!((closed.poles()?[0].re + 5.0).abs() < 1e-15);
    /// # Ok::<(), telepulse_lti::Error>(())
    /// ```
    pub fn feedback(&self, return_path: &Self) -> Result<Self, Error> {
        let (n_u, n_y) = (self.n_inputs(), self.n_outputs());
        check_count("a feedback loop", "inputs of the return path", n_y, return_path.n_inputs())?;
        check_count("a feedback loop", "outputs of the return path", n_u, return_path.n_outputs())?;
        // Inputs (u, input of H), outputs (y, output of H): u = r - H, input of H = y.
        let wiring = Wiring {
            feedback: blocks(
                &DMatrix::zeros(n_u, n_y),
                &-DMatrix::identity(n_u, n_u),
                &DMatrix::identity(n_y, n_y),
                &DMatrix::zeros(n_y, n_u),
            ),
            external: stack(&DMatrix::identity(n_u, n_u), &DMatrix::zeros(n_y, n_u)),
            outputs: beside(&DMatrix::identity(n_y, n_y), &DMatrix::zeros(n_y, n_u)),
        };
        self.augment(return_path)?.close_loop(&wiring)
    }

    /// The lower linear fractional transformation: the last inputs and outputs of this system are closed through `k`.
    ///
    /// ```text
    ///        +---------+
    ///   w -->|         |--> z
    ///        |   self  |
    ///    +-->|         |---+
    ///    | u +---------+ y |
    ///    |                 |
    ///    +------- k <------+      positive sign: u = k y
    /// ```
    ///
    /// # Errors
    /// [`Error::PortCount`] unless this system has more inputs than `k` has outputs and more outputs than `k` has
    /// inputs, [`Error::AlgebraicLoop`], [`Error::SampleTimeMismatch`].
    pub fn lower_lft(&self, k: &Self) -> Result<Self, Error> {
        let (n_u, n_y) = (k.n_outputs(), k.n_inputs());
        check_more("a lower LFT", "inputs", n_u, self.n_inputs())?;
        check_more("a lower LFT", "outputs", n_y, self.n_outputs())?;
        let (n_w, n_z) = (self.n_inputs() - n_u, self.n_outputs() - n_y);
        // Inputs (w, u, input of k), outputs (z, y, output of k).
        let mut feedback = DMatrix::zeros(n_w + n_u + n_y, n_z + n_y + n_u);
        feedback.view_mut((n_w, n_z + n_y), (n_u, n_u)).fill_with_identity();
        feedback.view_mut((n_w + n_u, n_z), (n_y, n_y)).fill_with_identity();
        let external = DMatrix::identity(n_w + n_u + n_y, n_w);
        let outputs = DMatrix::identity(n_z, n_z + n_y + n_u);
        self.augment(k)?.close_loop(&Wiring { feedback, external, outputs })
    }

    /// The upper linear fractional transformation: the first inputs and outputs of this system are closed through
    /// `delta`.
    ///
    /// ```text
    ///    +----- delta <----+      positive sign: d = delta e
    ///    |                 |
    ///    | d +---------+ e |
    ///    +-->|         |---+
    ///        |   self  |
    ///   w -->|         |--> z
    ///        +---------+
    /// ```
    ///
    /// # Errors
    /// As [`Self::lower_lft`].
    pub fn upper_lft(&self, delta: &Self) -> Result<Self, Error> {
        check_more("an upper LFT", "inputs", delta.n_outputs(), self.n_inputs())?;
        check_more("an upper LFT", "outputs", delta.n_inputs(), self.n_outputs())?;
        // Moving the closed ports from first to last makes it a lower one.
        let inputs = rotated(self.n_inputs(), delta.n_outputs());
        let outputs = rotated(self.n_outputs(), delta.n_inputs());
        self.select(&outputs, &inputs)?.lower_lft(delta)
    }
}

/// The inverse of the matrix that decides whether a loop is well posed.
fn inverse_of_well_posed(matrix: &DMatrix<f64>) -> Result<DMatrix<f64>, Error> {
    let n = matrix.nrows();
    // Rows and columns by powers of two to like size, so that the units of the signals do not decide.
    let mut scaled = matrix.clone();
    let (mut rows, mut cols) = (vec![1.0; n], vec![1.0; n]);
    for _ in 0..EQUILIBRATION_SWEEPS {
        for (k, factor) in rows.iter_mut().enumerate() {
            let step = unit_of(scaled.row(k).amax());
            scaled.row_mut(k).unscale_mut(step);
            *factor *= step;
        }
        for (k, factor) in cols.iter_mut().enumerate() {
            let step = unit_of(scaled.column(k).amax());
            scaled.column_mut(k).unscale_mut(step);
            *factor *= step;
        }
    }
    let singular = scaled.singular_values();
    let (largest, smallest) = (singular.max(), singular.min());
    let threshold = 8.0 * n as f64 * f64::EPSILON * largest;
    let ill_posed = Error::AlgebraicLoop { smallest_singular_value: smallest, threshold };
    if !smallest.is_finite() || smallest <= threshold {
        return Err(ill_posed);
    }
    let mut inverse = scaled.try_inverse().ok_or(ill_posed)?;
    for (k, factor) in rows.iter().enumerate() {
        inverse.column_mut(k).unscale_mut(*factor);
    }
    for (k, factor) in cols.iter().enumerate() {
        inverse.row_mut(k).unscale_mut(*factor);
    }
    Ok(inverse)
}

/// The power of two next to a size, 1 for 0 and for what is not finite.
fn unit_of(size: f64) -> f64 {
    if size > 0.0 && size.is_finite() { size.log2().round().clamp(-500.0, 500.0).exp2() } else { 1.0 }
}

/// Passes over rows and columns; the first does most of it.
const EQUILIBRATION_SWEEPS: usize = 3;

fn check_domains<D: TimeDomain>(left: &StateSpace<D>, right: &StateSpace<D>) -> Result<(), Error> {
    if left.domain() == right.domain() {
        return Ok(());
    }
    // Only discrete domains can differ, and they do so in their sample time alone.
    let seconds = |sys: &StateSpace<D>| sys.domain().sample_time_of().map_or(0.0, |ts| ts.seconds());
    Err(Error::SampleTimeMismatch { left_s: seconds(left), right_s: seconds(right) })
}

fn check_count(
    operation: &'static str,
    port: &'static str,
    expected: usize,
    found: usize,
) -> Result<(), Error> {
    if expected == found { Ok(()) } else { Err(Error::PortCount { operation, port, expected, found }) }
}

/// The closed ports must leave at least one open.
fn check_more(operation: &'static str, port: &'static str, closed: usize, found: usize) -> Result<(), Error> {
    if found > closed {
        Ok(())
    } else {
        Err(Error::PortCount { operation, port, expected: closed + 1, found })
    }
}

fn check_shape(matrix: &'static str, m: &DMatrix<f64>, rows: usize, cols: usize) -> Result<(), Error> {
    if m.shape() == (rows, cols) {
        return Ok(());
    }
    Err(Error::Shape { matrix, expected_rows: rows, expected_cols: cols, rows: m.nrows(), cols: m.ncols() })
}

/// `first, first + 1, ..., count - 1, 0, ..., first - 1`.
fn rotated(count: usize, first: usize) -> Vec<usize> {
    (first..count).chain(0..first).collect()
}

/// `[[a, b], [c, d]]` from four blocks of matching shapes.
pub(crate) fn blocks(a: &DMatrix<f64>, b: &DMatrix<f64>, c: &DMatrix<f64>, d: &DMatrix<f64>) -> DMatrix<f64> {
    stack(&beside(a, b), &beside(c, d))
}

pub(crate) fn block_diagonal(a: &DMatrix<f64>, d: &DMatrix<f64>) -> DMatrix<f64> {
    blocks(a, &DMatrix::zeros(a.nrows(), d.ncols()), &DMatrix::zeros(d.nrows(), a.ncols()), d)
}

/// `upper` over `lower`.
pub(crate) fn stack(upper: &DMatrix<f64>, lower: &DMatrix<f64>) -> DMatrix<f64> {
    let mut m = DMatrix::zeros(upper.nrows() + lower.nrows(), upper.ncols());
    m.rows_mut(0, upper.nrows()).copy_from(upper);
    m.rows_mut(upper.nrows(), lower.nrows()).copy_from(lower);
    m
}

/// `left` beside `right`.
pub(crate) fn beside(left: &DMatrix<f64>, right: &DMatrix<f64>) -> DMatrix<f64> {
    let mut m = DMatrix::zeros(left.nrows(), left.ncols() + right.ncols());
    m.columns_mut(0, left.ncols()).copy_from(left);
    m.columns_mut(left.ncols(), right.ncols()).copy_from(right);
    m
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Continuous, Discrete, SampleTime};
    use nalgebra::dmatrix;
    use num_complex::Complex64;
    use rand::{RngExt, SeedableRng};

    type Response = DMatrix<Complex64>;

    /// A random system with direct term; its response is compared with arithmetic on response matrices.
    fn random(rng: &mut rand_pcg::Pcg64, n_x: usize, n_y: usize, n_u: usize) -> StateSpace<Continuous> {
        let mut m = |r, c| DMatrix::from_fn(r, c, |_, _| rng.random_range(-1.0..1.0));
        let (a, b, c, d) = (m(n_x, n_x), m(n_x, n_u), m(n_y, n_x), m(n_y, n_u));
        StateSpace::<Continuous>::new(a, b, c, d * 0.3).expect("shapes fit")
    }

    fn assert_close(found: &Response, expected: &Response) {
        assert!((found - expected).norm() <= 1e-11 * (1.0 + expected.norm()), "{found} against {expected}");
    }

    fn identity(n: usize) -> Response {
        DMatrix::identity(n, n)
    }

    #[test]
    fn law_connections_agree_with_pointwise_arithmetic() {
        let rng = &mut rand_pcg::Pcg64::seed_from_u64(3);
        for _ in 0..20 {
            let (g, h) = (random(rng, 4, 2, 3), random(rng, 3, 3, 2));
            let other = random(rng, 2, 2, 3);
            for omega in [0.0, 0.7, 12.0] {
                let at = |sys: &StateSpace<Continuous>| sys.at(omega).expect("no pole");
                let (gv, hv, ov) = (at(&g), at(&h), at(&other));
                assert_close(&at(&g.series(&h).expect("fits")), &(&hv * &gv));
                assert_close(&at(&g.parallel(&other).expect("fits")), &(&gv + &ov));
                let inverse = (identity(2) + &gv * &hv).try_inverse().expect("regular");
                assert_close(&at(&g.feedback(&h).expect("well posed")), &(inverse * &gv));
                let side = at(&g.augment(&h).expect("fits"));
                assert_close(&side.view((2, 3), (3, 2)).into_owned(), &hv);
                assert_eq!(side.view((0, 3), (2, 2)).norm(), 0.0);
            }
        }
    }

    #[test]
    fn law_linear_fractional_transformations_agree_with_pointwise_arithmetic() {
        let rng = &mut rand_pcg::Pcg64::seed_from_u64(5);
        for _ in 0..20 {
            let (p, k) = (random(rng, 4, 3, 4), random(rng, 2, 2, 1));
            let (pv, kv) = (p.at(0.9).expect("no pole"), k.at(0.9).expect("no pole"));
            // Lower: two outputs of k drive the last two inputs of p, its input is the last output of p.
            let block = |r: usize, c: usize, nr: usize, nc: usize| pv.view((r, c), (nr, nc)).into_owned();
            let inner = (identity(1) - block(2, 2, 1, 2) * &kv).try_inverse().expect("regular");
            let lower = block(0, 0, 2, 2) + block(0, 2, 2, 2) * &kv * inner * block(2, 0, 1, 2);
            assert_close(&p.lower_lft(&k).expect("fits").at(0.9).expect("no pole"), &lower);
            // Upper: the same with the first ports.
            let inner = (identity(1) - block(0, 0, 1, 2) * &kv).try_inverse().expect("regular");
            let upper = block(1, 2, 2, 2) + block(1, 0, 2, 2) * &kv * inner * block(0, 2, 1, 2);
            assert_close(&p.upper_lft(&k).expect("fits").at(0.9).expect("no pole"), &upper);
        }
    }

    #[test]
    fn law_similarity_does_not_change_the_closed_loop() {
        let rng = &mut rand_pcg::Pcg64::seed_from_u64(9);
        let (g, h) = (random(rng, 3, 1, 1), random(rng, 2, 1, 1));
        let t = dmatrix![2.0, 0.1, 0.4; 0.3, 1.0, 0.0; 0.0, 0.2, 3.0];
        let inverse = t.clone().try_inverse().expect("regular");
        let moved =
            StateSpace::<Continuous>::new(&inverse * g.a() * &t, &inverse * g.b(), g.c() * &t, g.d().clone());
        let loops = [g.feedback(&h), moved.expect("valid").feedback(&h)].map(|l| l.expect("well posed"));
        for omega in [0.0, 1.0, 30.0] {
            assert_close(&loops[0].at(omega).expect("no pole"), &loops[1].at(omega).expect("no pole"));
        }
    }

    #[test]
    fn edge_an_algebraic_loop_is_an_error_of_its_own() {
        let gain = |k: f64| StateSpace::<Continuous>::from_gain(dmatrix![k]).expect("valid");
        assert!(matches!(gain(2.0).feedback(&gain(-0.5)), Err(Error::AlgebraicLoop { .. })));
        let closed = gain(2.0).feedback(&gain(0.5)).expect("well posed");
        assert_eq!(closed.d()[(0, 0)], 1.0);
    }

    #[test]
    fn edge_ports_and_sample_times_must_fit() {
        let one = StateSpace::<Continuous>::from_gain(dmatrix![1.0]).expect("valid");
        let two = StateSpace::<Continuous>::from_gain(DMatrix::identity(2, 2)).expect("valid");
        assert!(matches!(one.series(&two), Err(Error::PortCount { expected: 1, found: 2, .. })));
        assert!(matches!(one.parallel(&two), Err(Error::PortCount { .. })));
        assert!(matches!(one.feedback(&two), Err(Error::PortCount { .. })));
        assert!(matches!(one.lower_lft(&one), Err(Error::PortCount { expected: 2, found: 1, .. })));
        assert!(matches!(one.upper_lft(&two), Err(Error::PortCount { .. })));
        let bad = Wiring {
            feedback: DMatrix::zeros(2, 1),
            external: DMatrix::zeros(1, 1),
            outputs: DMatrix::zeros(1, 1),
        };
        assert!(matches!(one.close_loop(&bad), Err(Error::Shape { matrix: "feedback", .. })));
        let sampled = |seconds: f64| {
            let domain = Discrete::new(SampleTime::new(seconds).expect("positive"));
            let empty = |r, c| DMatrix::zeros(r, c);
            StateSpace::with_domain(empty(0, 0), empty(0, 1), empty(1, 0), dmatrix![1.0], domain)
                .expect("valid")
        };
        assert!(matches!(sampled(0.1).series(&sampled(0.2)), Err(Error::SampleTimeMismatch { .. })));
    }
}
