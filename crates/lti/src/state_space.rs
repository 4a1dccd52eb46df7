//! The state space model and what can be read off it: ports, poles, response.

use crate::eigenvalues::eigenvalues;
use crate::{Continuous, Discrete, Error, FrequencyResponse, SampleTime, TimeDomain};
use nalgebra::DMatrix;
use num_complex::Complex64;
use serde::{Deserialize, Serialize};

/// A linear time-invariant system in the time domain `D`.
///
/// **Shapes and units**: with `n_x` states, `n_u` inputs and `n_y` outputs,
/// `A: n_x × n_x`, `B: n_x × n_u`, `C: n_y × n_x`, `D: n_y × n_u`.
///
/// ```text
///   continuous:  dx/dt = A x + B u        discrete:  x[k+1] = A x[k] + B u[k]
///                    y = C x + D u                     y[k] = C x[k] + D u[k]
/// ```
///
/// A system has at least one input and one output, finite entries, and may have no states at all.
///
/// **Example**: an undamped clock of 2 rad/s has its poles on the axis.
/// ```
/// use nalgebra::{dmatrix};
/// use telepulse_lti::{Continuous, StateSpace};
/// let sys = StateSpace::<Continuous>::new(
///     dmatrix![0.0, 2.0; -2.0, 0.0], dmatrix![0.0; 1.0], dmatrix![1.0, 0.0], dmatrix![0.0])?;
/// assert!((sys.poles()?[0].im.abs() - 2.0).abs() < 1e-15);
/// assert!(!sys.is_stable()?);
/// assert!((sys.dc_gain()?[(0, 0)] - 0.5).abs() < 1e-15);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "PlainStateSpace", into = "PlainStateSpace", bound = "")]
pub struct StateSpace<D: TimeDomain> {
    a: DMatrix<f64>,
    b: DMatrix<f64>,
    c: DMatrix<f64>,
    d: DMatrix<f64>,
    domain: D,
}

impl StateSpace<Continuous> {
    /// A continuous system from its four matrices.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NoPorts`] or [`Error::NotFinite`].
    pub fn new(a: DMatrix<f64>, b: DMatrix<f64>, c: DMatrix<f64>, d: DMatrix<f64>) -> Result<Self, Error> {
        Self::with_domain(a, b, c, d, Continuous)
    }

    /// A continuous system without states: `y = gain u`.
    ///
    /// # Errors
    /// [`Error::NoPorts`] or [`Error::NotFinite`].
    pub fn from_gain(gain: DMatrix<f64>) -> Result<Self, Error> {
        let (n_y, n_u) = gain.shape();
        Self::new(DMatrix::zeros(0, 0), DMatrix::zeros(0, n_u), DMatrix::zeros(n_y, 0), gain)
    }
}

impl StateSpace<Discrete> {
    /// A discrete system from its four matrices and its sample time.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NoPorts`] or [`Error::NotFinite`].
    pub fn new(
        a: DMatrix<f64>,
        b: DMatrix<f64>,
        c: DMatrix<f64>,
        d: DMatrix<f64>,
        sample_time: SampleTime,
    ) -> Result<Self, Error> {
        Self::with_domain(a, b, c, d, Discrete::new(sample_time))
    }

    /// The sample time.
    #[must_use]
    pub fn sample_time(&self) -> SampleTime {
        self.domain.sample_time()
    }
}

impl<D: TimeDomain> StateSpace<D> {
    /// A system in the given time domain from its four matrices.
    ///
    /// # Errors
    /// [`Error::Shape`] where the matrices do not fit, [`Error::NoPorts`] without an input or an output,
    /// [`Error::NotFinite`] where an entry is NaN or infinite.
    pub fn with_domain(
        a: DMatrix<f64>,
        b: DMatrix<f64>,
        c: DMatrix<f64>,
        d: DMatrix<f64>,
        domain: D,
    ) -> Result<Self, Error> {
        let (n_x, (n_y, n_u)) = (a.nrows(), d.shape());
        check_matrix("a", &a, n_x, n_x)?;
        check_matrix("b", &b, n_x, n_u)?;
        check_matrix("c", &c, n_y, n_x)?;
        check_matrix("d", &d, n_y, n_u)?;
        if n_u == 0 || n_y == 0 {
            return Err(Error::NoPorts { n_inputs: n_u, n_outputs: n_y });
        }
        Ok(Self { a, b, c, d, domain })
    }

    /// For results of this crate whose shapes are right by construction.
    pub(crate) fn from_valid_parts(
        a: DMatrix<f64>,
        b: DMatrix<f64>,
        c: DMatrix<f64>,
        d: DMatrix<f64>,
        domain: D,
    ) -> Self {
        debug_assert!(a.is_square() && a.nrows() == b.nrows() && a.ncols() == c.ncols());
        debug_assert!(d.nrows() == c.nrows() && d.ncols() == b.ncols());
        Self { a, b, c, d, domain }
    }

    /// The state matrix, `n_x × n_x`.
    #[must_use]
    pub fn a(&self) -> &DMatrix<f64> {
        &self.a
    }

    /// The input matrix, `n_x × n_u`.
    #[must_use]
    pub fn b(&self) -> &DMatrix<f64> {
        &self.b
    }

    /// The output matrix, `n_y × n_x`.
    #[must_use]
    pub fn c(&self) -> &DMatrix<f64> {
        &self.c
    }

    /// The direct term, `n_y × n_u`.
    #[must_use]
    pub fn d(&self) -> &DMatrix<f64> {
        &self.d
    }

    /// The time domain.
    #[must_use]
    pub fn domain(&self) -> &D {
        &self.domain
    }

    /// Number of states.
    #[must_use]
    pub fn n_states(&self) -> usize {
        self.a.nrows()
    }

    /// Number of inputs.
    #[must_use]
    pub fn n_inputs(&self) -> usize {
        self.d.ncols()
    }

    /// Number of outputs.
    #[must_use]
    pub fn n_outputs(&self) -> usize {
        self.d.nrows()
    }

    /// The poles: rad/s in continuous time, points of the z plane in discrete time.
    ///
    /// # Errors
    /// [`Error::EigenvaluesNotConverged`].
    pub fn poles(&self) -> Result<Vec<Complex64>, Error> {
        eigenvalues(&self.a)
    }

    /// Whether every mode dies out; modes that no port sees count as well.
    ///
    /// # Errors
    /// [`Error::EigenvaluesNotConverged`].
    pub fn is_stable(&self) -> Result<bool, Error> {
        Ok(self.poles()?.into_iter().all(|pole| self.domain.is_stable_pole(pole)))
    }

    /// The response matrix at one frequency, `n_y × n_u`.
    ///
    /// **Method**: complex LU of `p I - A` with `p = j omega`, or `exp(j omega T)`.
    ///
    /// # Errors
    /// [`Error::PoleAtFrequency`] where `p I - A` is singular or the result overflows, [`Error::NotFinite`] for a
    /// frequency that is no number.
    pub fn at(&self, omega_rad_s: f64) -> Result<DMatrix<Complex64>, Error> {
        if !omega_rad_s.is_finite() {
            return Err(Error::NotFinite { quantity: "omega_rad_s", index: 0, value: omega_rad_s });
        }
        let response = self.evaluate(self.domain.point(omega_rad_s));
        response.ok_or(Error::PoleAtFrequency { omega_rad_s })
    }

    /// `C (p I - A)^-1 B + D`, or `None` where that does not exist in floating point.
    pub(crate) fn evaluate(&self, point: Complex64) -> Option<DMatrix<Complex64>> {
        if self.n_states() == 0 {
            return Some(complex(&self.d));
        }
        let mut resolvent = self.a.map(|v| Complex64::new(-v, 0.0));
        for i in 0..self.n_states() {
            resolvent[(i, i)] += point;
        }
        let states = resolvent.lu().solve(&complex(&self.b))?;
        let response = complex(&self.c) * states + complex(&self.d);
        response.iter().all(|v| v.re.is_finite() && v.im.is_finite()).then_some(response)
    }

    /// The gain for constant signals, `n_y × n_u`.
    ///
    /// # Errors
    /// [`Error::PoleAtFrequency`] for a system that integrates.
    pub fn dc_gain(&self) -> Result<DMatrix<f64>, Error> {
        Ok(self.at(0.0)?.map(|v| v.re))
    }

    /// The response on a grid of frequencies in rad/s.
    ///
    /// # Errors
    /// [`Error::FrequencyGrid`] unless the frequencies are finite, not negative and increasing;
    /// [`Error::PoleAtFrequency`] where one of them hits a pole.
    pub fn frequency_response(&self, omega_rad_s: &[f64]) -> Result<FrequencyResponse, Error> {
        FrequencyResponse::sample(omega_rad_s, |omega| self.at(omega))
    }

    /// The system from the chosen inputs to the chosen outputs, in the order given; a port may be repeated.
    ///
    /// # Errors
    /// [`Error::PortIndex`] for a number beyond the last port, [`Error::NoPorts`] for an empty choice.
    pub fn select(&self, output_indices: &[usize], input_indices: &[usize]) -> Result<Self, Error> {
        check_ports("output", output_indices, self.n_outputs())?;
        check_ports("input", input_indices, self.n_inputs())?;
        let d = self.d.select_rows(output_indices).select_columns(input_indices);
        let (b, c) = (self.b.select_columns(input_indices), self.c.select_rows(output_indices));
        Self::with_domain(self.a.clone(), b, c, d, self.domain)
    }

    /// The system with every output multiplied by `gain`.
    ///
    /// # Errors
    /// [`Error::NotFinite`] where the gain or a product is not finite.
    pub fn scale(&self, gain: f64) -> Result<Self, Error> {
        Self::with_domain(self.a.clone(), self.b.clone(), &self.c * gain, &self.d * gain, self.domain)
    }
}

/// The stored form of a system: rows of numbers and, for a discrete system, its sample time.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PlainStateSpace {
    a: Vec<Vec<f64>>,
    b: Vec<Vec<f64>>,
    c: Vec<Vec<f64>>,
    d: Vec<Vec<f64>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    sample_time_s: Option<SampleTime>,
}

impl<D: TimeDomain> From<StateSpace<D>> for PlainStateSpace {
    fn from(sys: StateSpace<D>) -> Self {
        let rows = |m: &DMatrix<f64>| m.row_iter().map(|row| row.iter().copied().collect()).collect();
        Self {
            a: rows(&sys.a),
            b: rows(&sys.b),
            c: rows(&sys.c),
            d: rows(&sys.d),
            sample_time_s: sys.domain.sample_time_of(),
        }
    }
}

impl<D: TimeDomain> TryFrom<PlainStateSpace> for StateSpace<D> {
    type Error = Error;

    fn try_from(plain: PlainStateSpace) -> Result<Self, Error> {
        let domain = D::from_sample_time(plain.sample_time_s)?;
        // Without rows a matrix does not tell its width; that of `a` and `b` then follows from their neighbours.
        let n_u = plain.d.first().map_or(0, Vec::len);
        let a = matrix_from_rows("a", &plain.a, plain.a.len())?;
        let b = matrix_from_rows("b", &plain.b, n_u)?;
        let c = matrix_from_rows("c", &plain.c, plain.a.len())?;
        let d = matrix_from_rows("d", &plain.d, n_u)?;
        Self::with_domain(a, b, c, d, domain)
    }
}

fn matrix_from_rows(
    matrix: &'static str,
    rows: &[Vec<f64>],
    cols_if_empty: usize,
) -> Result<DMatrix<f64>, Error> {
    let n_cols = rows.first().map_or(cols_if_empty, Vec::len);
    if let Some((row, entries)) = rows.iter().enumerate().find(|(_, entries)| entries.len() != n_cols) {
        return Err(Error::RaggedRow { matrix, row, expected: n_cols, found: entries.len() });
    }
    Ok(DMatrix::from_fn(rows.len(), n_cols, |i, j| rows[i][j]))
}

fn check_matrix(
    matrix: &'static str,
    m: &DMatrix<f64>,
    expected_rows: usize,
    expected_cols: usize,
) -> Result<(), Error> {
    let (rows, cols) = m.shape();
    if (rows, cols) != (expected_rows, expected_cols) {
        return Err(Error::Shape { matrix, expected_rows, expected_cols, rows, cols });
    }
    match m.iter().enumerate().find(|(_, v)| !v.is_finite()) {
        Some((index, &value)) => Err(Error::NotFinite { quantity: matrix, index, value }),
        None => Ok(()),
    }
}

fn check_ports(port: &'static str, indices: &[usize], count: usize) -> Result<(), Error> {
    match indices.iter().find(|&&index| index >= count) {
        Some(&index) => Err(Error::PortIndex { port, count, index }),
        None => Ok(()),
    }
}

/// A real matrix as a complex one.
fn complex(m: &DMatrix<f64>) -> DMatrix<Complex64> {
    m.map(|v| Complex64::new(v, 0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::dmatrix;
    use rand::{RngExt, SeedableRng};

    fn lag() -> StateSpace<Continuous> {
        StateSpace::<Continuous>::new(dmatrix![-2.0], dmatrix![1.0, 3.0], dmatrix![4.0], dmatrix![0.0, 0.5])
            .expect("valid")
    }

    #[test]
    fn law_similarity_changes_neither_response_nor_poles() {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(21);
        for case in 0..20 {
            let mut m = |r, c| DMatrix::from_fn(r, c, |_, _| rng.random_range(-1.0..1.0));
            let (a, b, c, d) = (m(6, 6), m(6, 2), m(3, 6), m(3, 2));
            let t: DMatrix<f64> = DMatrix::identity(6, 6) + m(6, 6) * 0.3;
            let inverse = t.clone().try_inverse().expect("diagonally dominant");
            let sys =
                StateSpace::<Continuous>::new(a.clone(), b.clone(), c.clone(), d.clone()).expect("valid");
            let moved =
                StateSpace::<Continuous>::new(&inverse * a * &t, &inverse * b, c * &t, d).expect("valid");
            for omega in [0.0, 0.4, 3.0, 1e3] {
                let (found, expected) = (moved.at(omega).expect("no pole"), sys.at(omega).expect("no pole"));
                assert!((&found - &expected).norm() < 1e-11 * expected.norm(), "seed 21 case {case}");
            }
            let (found, expected) = (moved.poles().expect("converged"), sys.poles().expect("converged"));
            for pole in expected {
                let distance = found.iter().map(|p| (p - pole).norm()).fold(f64::INFINITY, f64::min);
                assert!(distance < 1e-10, "seed 21 case {case}: {pole} off by {distance:e}");
            }
        }
    }

    #[test]
    fn law_response_at_infinity_is_the_direct_term() {
        let far = lag().at(1e12).expect("no pole").map(|v| v.re);
        assert!((far - lag().d()).norm() < 1e-11);
    }

    #[test]
    fn edge_shapes_must_fit() {
        let z = |r, c| DMatrix::<f64>::zeros(r, c);
        let build = StateSpace::<Continuous>::new;
        assert!(matches!(build(z(2, 3), z(2, 1), z(1, 2), z(1, 1)), Err(Error::Shape { matrix: "a", .. })));
        assert!(matches!(build(z(2, 2), z(3, 1), z(1, 2), z(1, 1)), Err(Error::Shape { matrix: "b", .. })));
        assert!(matches!(build(z(2, 2), z(2, 1), z(1, 3), z(1, 1)), Err(Error::Shape { matrix: "c", .. })));
        assert!(matches!(build(z(2, 2), z(2, 1), z(1, 2), z(1, 2)), Err(Error::Shape { matrix: "b", .. })));
        assert!(matches!(build(z(2, 2), z(2, 0), z(1, 2), z(1, 0)), Err(Error::NoPorts { n_inputs: 0, .. })));
        let nan = StateSpace::<Continuous>::new(dmatrix![f64::NAN], z(1, 1), z(1, 1), z(1, 1));
        assert!(matches!(nan, Err(Error::NotFinite { quantity: "a", .. })));
    }

    #[test]
    fn edge_an_integrator_has_no_static_gain() {
        let sys = StateSpace::<Continuous>::new(dmatrix![0.0], dmatrix![1.0], dmatrix![1.0], dmatrix![0.0]);
        let sys = sys.expect("valid");
        assert_eq!(sys.dc_gain(), Err(Error::PoleAtFrequency { omega_rad_s: 0.0 }));
        assert!(matches!(sys.at(f64::NAN), Err(Error::NotFinite { .. })));
        assert!(!sys.is_stable().expect("one pole"));
    }

    #[test]
    fn edge_selected_ports_must_exist() {
        let second = lag().select(&[0], &[1]).expect("exists");
        assert_eq!((second.b()[(0, 0)], second.d()[(0, 0)]), (3.0, 0.5));
        assert!(matches!(
            lag().select(&[0], &[2]),
            Err(Error::PortIndex { port: "input", count: 2, index: 2 })
        ));
        assert!(matches!(lag().select(&[1], &[0]), Err(Error::PortIndex { port: "output", .. })));
        assert!(matches!(lag().select(&[], &[0]), Err(Error::NoPorts { .. })));
    }

    #[test]
    fn edge_a_stored_system_is_checked_and_keeps_its_time() {
        let text = serde_json::to_string(&lag()).expect("plain");
        assert_eq!(text, r#"{"a":[[-2.0]],"b":[[1.0,3.0]],"c":[[4.0]],"d":[[0.0,0.5]]}"#);
        assert_eq!(serde_json::from_str::<StateSpace<Continuous>>(&text).expect("valid"), lag());
        assert!(serde_json::from_str::<StateSpace<Discrete>>(&text).is_err());
        let discrete = lag().to_discrete_zoh(SampleTime::new(0.125).expect("positive")).expect("finite");
        let text = serde_json::to_string(&discrete).expect("plain");
        assert!(text.ends_with(r#""sample_time_s":0.125}"#), "{text}");
        assert_eq!(serde_json::from_str::<StateSpace<Discrete>>(&text).expect("valid"), discrete);
        assert!(serde_json::from_str::<StateSpace<Continuous>>(&text).is_err());
        for bad in [
            r#"{"a":[[1.0]],"b":[[1.0]],"c":[[1.0]],"d":[[1.0]],"gain":2.0}"#,
            r#"{"a":[[1.0]],"b":[[1.0]],"c":[[1.0]],"d":[[1.0, 2.0]]}"#,
            r#"{"a":[[1.0],[2.0, 3.0]],"b":[[1.0],[1.0]],"c":[[1.0, 1.0]],"d":[[1.0]]}"#,
            r#"{"a":[[1.0]],"b":[[1.0]],"c":[[1.0]],"d":[]}"#,
            r#"{"a":[[1.0]],"b":[[1.0]],"c":[[1.0]]}"#,
        ] {
            assert!(serde_json::from_str::<StateSpace<Continuous>>(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn edge_a_static_gain_is_stored_without_states() {
        let gain = StateSpace::<Continuous>::from_gain(dmatrix![1.0, 2.0; 3.0, 4.0]).expect("valid");
        let text = serde_json::to_string(&gain).expect("plain");
        assert_eq!(serde_json::from_str::<StateSpace<Continuous>>(&text).expect("valid"), gain);
        assert_eq!(gain.dc_gain().expect("no states"), *gain.d());
        assert!(gain.poles().expect("none").is_empty() && gain.is_stable().expect("no poles"));
    }
}
