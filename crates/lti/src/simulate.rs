//! Time responses: exact at the sampling instants, no integration error.

use crate::{Continuous, Discrete, Error, SampleTime, StateSpace};
use nalgebra::{DMatrix, DVector};

/// The response to a unit step at one input.
#[derive(Debug, Clone, PartialEq)]
pub struct StepResponse {
    /// Sampling instants in seconds, from zero.
    pub time_s: Vec<f64>,
    /// Outputs, one row per instant and one column per output.
    pub outputs: DMatrix<f64>,
}

impl StateSpace<Discrete> {
    /// The outputs for the given inputs and initial state.
    ///
    /// **Shapes**: `inputs: n_samples × n_u`, `initial_state: n_x`, result `n_samples × n_y`. Row `k` of the result
    /// belongs to row `k` of the inputs.
    ///
    /// # Errors
    /// [`Error::Shape`] where inputs or state do not fit, [`Error::NotFinite`] for an input that is no number or an
    /// unstable response that left the range of floating point.
    ///
    /// # Example
    /// ```
    /// use nalgebra::{DVector, dmatrix};
    /// use telepulse_lti::{Discrete, SampleTime, StateSpace};
    /// // y[k] = u[k - 1]
    /// let delay = StateSpace::<Discrete>::new(
    ///     dmatrix![0.0], dmatrix![1.0], dmatrix![1.0], dmatrix![0.0], SampleTime::new(0.1)?)?;
    /// let y = delay.simulate(&dmatrix![1.0; 2.0; 3.0], &DVector::zeros(1))?;
    /// assert_eq!(y, dmatrix![0.0; 1.0; 2.0]);
    /// # Ok::<(), telepulse_lti::Error>(())
    /// ```
    pub fn simulate(
        &self,
        inputs: &DMatrix<f64>,
        initial_state: &DVector<f64>,
    ) -> Result<DMatrix<f64>, Error> {
        let (n_x, n_u, n_samples) = (self.n_states(), self.n_inputs(), inputs.nrows());
        if inputs.ncols() != n_u {
            return Err(shape_error("inputs", (n_samples, n_u), inputs.shape()));
        }
        if initial_state.len() != n_x {
            return Err(shape_error("initial_state", (n_x, 1), initial_state.shape()));
        }
        check_all_finite("inputs", inputs)?;
        // Samples as columns: each step reads and writes memory in a row.
        let inputs = inputs.transpose();
        let mut outputs = self.d() * &inputs;
        let (mut x, mut next) = (initial_state.clone(), DVector::zeros(n_x));
        for k in 0..n_samples {
            outputs.column_mut(k).gemv(1.0, self.c(), &x, 1.0);
            next.gemv(1.0, self.a(), &x, 0.0);
            next.gemv(1.0, self.b(), &inputs.column(k), 1.0);
            std::mem::swap(&mut x, &mut next);
        }
        check_all_finite("outputs", &outputs)?;
        Ok(outputs.transpose())
    }
}

impl StateSpace<Continuous> {
    /// The outputs at the sampling instants for inputs that are held between them, from rest.
    ///
    /// **Shapes**: `inputs: n_samples × n_u`, result `n_samples × n_y`.
    ///
    /// **Method**: [`StateSpace::to_discrete_zoh`], so the samples are exact up to rounding for any sample time.
    ///
    /// # Errors
    /// As [`StateSpace::simulate`] and [`StateSpace::to_discrete_zoh`].
    pub fn simulate_zoh(
        &self,
        inputs: &DMatrix<f64>,
        sample_time: SampleTime,
    ) -> Result<DMatrix<f64>, Error> {
        let held = self.to_discrete_zoh(sample_time)?;
        held.simulate(inputs, &DVector::zeros(self.n_states()))
    }

    /// The response to a unit step at one input, from rest, until `duration_s` is reached or just passed.
    ///
    /// # Errors
    /// [`Error::PortIndex`] for an input beyond the last, [`Error::Duration`] unless the duration is positive and
    /// finite, and as [`Self::simulate_zoh`].
    ///
    /// # Example
    /// ```
    /// use telepulse_lti::{SampleTime, TransferFunction};
    /// let lag = TransferFunction::new(&[2.0], &[0.5, 1.0])?.to_state_space();
    /// let step = lag.step_response(0, 1.0, SampleTime::new(0.25)?)?;
    /// assert!((step.outputs[(4, 0)] - 2.0 * (1.0 - (-2.0f64).exp())).abs() < 1e-14);
    /// # Ok::<(), telepulse_lti::Error>(())
    /// ```
    pub fn step_response(
        &self,
        input_idx: usize,
        duration_s: f64,
        sample_time: SampleTime,
    ) -> Result<StepResponse, Error> {
        let count = self.n_inputs();
        if input_idx >= count {
            return Err(Error::PortIndex { port: "input", count, index: input_idx });
        }
        if !(duration_s > 0.0 && duration_s.is_finite()) {
            return Err(Error::Duration { quantity: "duration", seconds: duration_s });
        }
        // A duration that is a multiple up to rounding does not get a further sample.
        let n_samples = (duration_s / sample_time.seconds() * (1.0 - 4.0 * f64::EPSILON)).ceil() as usize + 1;
        let mut inputs = DMatrix::zeros(n_samples, count);
        inputs.column_mut(input_idx).fill(1.0);
        let outputs = self.simulate_zoh(&inputs, sample_time)?;
        let time_s = (0..n_samples).map(|k| k as f64 * sample_time.seconds()).collect();
        Ok(StepResponse { time_s, outputs })
    }
}

fn shape_error(matrix: &'static str, expected: (usize, usize), found: (usize, usize)) -> Error {
    Error::Shape {
        matrix,
        expected_rows: expected.0,
        expected_cols: expected.1,
        rows: found.0,
        cols: found.1,
    }
}

fn check_all_finite(quantity: &'static str, m: &DMatrix<f64>) -> Result<(), Error> {
    match m.iter().enumerate().find(|(_, v)| !v.is_finite()) {
        Some((index, &value)) => Err(Error::NotFinite { quantity, index, value }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::TransferFunction;
    use nalgebra::dmatrix;

    fn lag() -> StateSpace<Continuous> {
        TransferFunction::new(&[1.0], &[1.0, 1.0]).expect("valid").to_state_space()
    }

    #[test]
    fn law_a_sinusoid_settles_to_the_frequency_response() {
        let ts = SampleTime::new(0.01).expect("positive");
        let sys = TransferFunction::new(&[3.0, 50.0], &[1.0, 6.0, 90.0]).expect("valid").to_state_space();
        let discrete = sys.to_discrete_tustin(ts).expect("regular");
        let omega = 7.0;
        let inputs = DMatrix::from_fn(4000, 1, |k, _| (omega * k as f64 * ts.seconds()).sin());
        let outputs = discrete.simulate(&inputs, &DVector::zeros(2)).expect("stable");
        let gain = discrete.at(omega).expect("no pole")[(0, 0)];
        for k in 3000..4000 {
            let expected = gain.norm() * (omega * k as f64 * ts.seconds() + gain.arg()).sin();
            // The transient has died out by exp(-3 * 30).
            assert!((outputs[(k, 0)] - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn law_free_response_follows_the_initial_state() {
        let ts = SampleTime::new(0.5).expect("positive");
        let held = lag().to_discrete_zoh(ts).expect("finite");
        let y = held.simulate(&DMatrix::zeros(3, 1), &DVector::from_element(1, 2.0)).expect("stable");
        // `lag` has C B = 1, and its state may carry any power of two.
        let start = held.c()[(0, 0)] * 2.0;
        for (k, value) in y.iter().enumerate() {
            assert!((value - start * (-0.5 * k as f64).exp()).abs() < 1e-14);
        }
    }

    #[test]
    fn edge_simulation_refuses_what_does_not_fit() {
        let ts = SampleTime::new(0.5).expect("positive");
        let held = lag().to_discrete_zoh(ts).expect("finite");
        let zero = DVector::zeros(1);
        assert!(matches!(
            held.simulate(&DMatrix::zeros(4, 2), &zero),
            Err(Error::Shape { matrix: "inputs", .. })
        ));
        let state = DVector::zeros(2);
        assert!(matches!(held.simulate(&DMatrix::zeros(4, 1), &state), Err(Error::Shape { .. })));
        assert!(matches!(held.simulate(&dmatrix![1.0; f64::NAN], &zero), Err(Error::NotFinite { .. })));
        assert!(matches!(lag().step_response(1, 1.0, ts), Err(Error::PortIndex { .. })));
        assert!(matches!(lag().step_response(0, -1.0, ts), Err(Error::Duration { .. })));
        assert_eq!(held.simulate(&DMatrix::zeros(0, 1), &zero).expect("no samples").nrows(), 0);
    }

    #[test]
    fn edge_an_unstable_response_that_overflows_is_an_error() {
        let ts = SampleTime::new(1.0).expect("positive");
        let unstable =
            StateSpace::<Discrete>::new(dmatrix![1e10], dmatrix![1.0], dmatrix![1.0], dmatrix![0.0], ts);
        let run = unstable.expect("valid").simulate(&DMatrix::from_element(100, 1, 1.0), &DVector::zeros(1));
        assert!(matches!(run, Err(Error::NotFinite { quantity: "outputs", .. })));
    }

    #[test]
    fn edge_a_step_response_ends_on_its_duration() {
        let step = lag().step_response(0, 0.3, SampleTime::new(0.1).expect("positive")).expect("stable");
        assert_eq!(step.time_s.len(), 4);
        assert_eq!(step.outputs.shape(), (4, 1));
    }
}
