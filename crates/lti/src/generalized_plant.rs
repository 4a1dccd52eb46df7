//! The generalized plant of robust control.

use crate::{Continuous, Error, StateSpace, TimeDomain};
use nalgebra::{DMatrix, DMatrixView};

/// A system with its inputs and outputs in two groups, as robust synthesis sees it; continuous unless said otherwise.
///
/// ```text
///                 +-------------------+
///    w  --------->|  A  | B1    B2    |---------> z
///   exogenous     | ----+------------ |   performance
///    input        |  C1 | D11   D12   |     output
///            +--->|  C2 | D21   D22   |----+
///            |    +-------------------+    |
///          u |                             | y
///   control  |       +-----------+         | measured
///   input    +-------|     K     |<--------+ output
///                    +-----------+                  u = K y
/// ```
///
/// **Shapes**: `A: n_x × n_x`, `B1: n_x × n_w`, `B2: n_x × n_u`, `C1: n_z × n_x`, `C2: n_y × n_x`, `D11: n_z × n_w`,
/// `D12: n_z × n_u`, `D21: n_y × n_w`, `D22: n_y × n_u`. Feedback is positive here; a tracking loop has its minus sign
/// in `C2`.
///
/// **Source**: Zhou and Doyle 1998, section 9.1.
///
/// **Example**: tracking with an integrator as the plant; `z` is the error `r - G u`, and so is `y`.
/// ```
/// use nalgebra::dmatrix;
/// use telepulse_lti::{Continuous, GeneralizedPlant, StateSpace};
/// let sys = StateSpace::<Continuous>::new(
///     dmatrix![0.0], dmatrix![0.0, 1.0], dmatrix![-1.0; -1.0], dmatrix![1.0, 0.0; 1.0, 0.0])?;
/// let plant = GeneralizedPlant::new(sys, 1, 1, 1, 1)?;
/// let closed = plant.lower_lft(&StateSpace::<Continuous>::from_gain(dmatrix![4.0])?)?;
/// assert!((closed.poles()?[0].re + 4.0).abs() < 1e-15);
/// assert!(closed.dc_gain()?[(0, 0)].abs() < 1e-15);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct GeneralizedPlant<D: TimeDomain = Continuous> {
    sys: StateSpace<D>,
    n_w: usize,
    n_u: usize,
    n_z: usize,
    n_y: usize,
}

impl<D: TimeDomain> GeneralizedPlant<D> {
    /// A generalized plant from a system whose inputs are `(w, u)` and whose outputs are `(z, y)`.
    ///
    /// # Errors
    /// [`Error::PortCount`] unless every group has at least one signal and the groups add up to the ports of the
    /// system.
    pub fn new(sys: StateSpace<D>, n_w: usize, n_u: usize, n_z: usize, n_y: usize) -> Result<Self, Error> {
        let operation = "a generalized plant";
        for (port, found) in
            [("signals in w", n_w), ("signals in u", n_u), ("signals in z", n_z), ("signals in y", n_y)]
        {
            if found == 0 {
                return Err(Error::PortCount { operation, port, expected: 1, found });
            }
        }
        for (port, expected, found) in
            [("inputs", n_w + n_u, sys.n_inputs()), ("outputs", n_z + n_y, sys.n_outputs())]
        {
            if expected != found {
                return Err(Error::PortCount { operation, port, expected, found });
            }
        }
        Ok(Self { sys, n_w, n_u, n_z, n_y })
    }

    /// The system with inputs `(w, u)` and outputs `(z, y)`.
    #[must_use]
    pub fn sys(&self) -> &StateSpace<D> {
        &self.sys
    }

    /// Number of exogenous inputs `w`.
    #[must_use]
    pub fn n_w(&self) -> usize {
        self.n_w
    }

    /// Number of control inputs `u`.
    #[must_use]
    pub fn n_u(&self) -> usize {
        self.n_u
    }

    /// Number of performance outputs `z`.
    #[must_use]
    pub fn n_z(&self) -> usize {
        self.n_z
    }

    /// Number of measured outputs `y`.
    #[must_use]
    pub fn n_y(&self) -> usize {
        self.n_y
    }

    /// Number of states.
    #[must_use]
    pub fn n_states(&self) -> usize {
        self.sys.n_states()
    }

    /// `A`, `n_x × n_x`.
    #[must_use]
    pub fn a(&self) -> DMatrix<f64> {
        self.sys.a().clone()
    }

    /// `B1`, from `w` to the states.
    #[must_use]
    pub fn b1(&self) -> DMatrix<f64> {
        self.sys.b().columns(0, self.n_w).into_owned()
    }

    /// `B2`, from `u` to the states.
    #[must_use]
    pub fn b2(&self) -> DMatrix<f64> {
        self.sys.b().columns(self.n_w, self.n_u).into_owned()
    }

    /// `C1`, from the states to `z`.
    #[must_use]
    pub fn c1(&self) -> DMatrix<f64> {
        self.sys.c().rows(0, self.n_z).into_owned()
    }

    /// `C2`, from the states to `y`.
    #[must_use]
    pub fn c2(&self) -> DMatrix<f64> {
        self.sys.c().rows(self.n_z, self.n_y).into_owned()
    }

    /// `D11`, from `w` to `z`.
    #[must_use]
    pub fn d11(&self) -> DMatrix<f64> {
        self.direct(0, 0, self.n_z, self.n_w).into_owned()
    }

    /// `D12`, from `u` to `z`.
    #[must_use]
    pub fn d12(&self) -> DMatrix<f64> {
        self.direct(0, self.n_w, self.n_z, self.n_u).into_owned()
    }

    /// `D21`, from `w` to `y`.
    #[must_use]
    pub fn d21(&self) -> DMatrix<f64> {
        self.direct(self.n_z, 0, self.n_y, self.n_w).into_owned()
    }

    /// `D22`, from `u` to `y`.
    #[must_use]
    pub fn d22(&self) -> DMatrix<f64> {
        self.direct(self.n_z, self.n_w, self.n_y, self.n_u).into_owned()
    }

    fn direct(&self, row: usize, col: usize, n_rows: usize, n_cols: usize) -> DMatrixView<'_, f64> {
        self.sys.d().view((row, col), (n_rows, n_cols))
    }

    /// The closed loop from `w` to `z` with `u = K y`.
    ///
    /// # Errors
    /// [`Error::PortCount`] unless the controller takes `y` and gives `u`, [`Error::AlgebraicLoop`] where
    /// `I - D22 D_K` is singular.
    pub fn lower_lft(&self, controller: &StateSpace<D>) -> Result<StateSpace<D>, Error> {
        let operation = "closing a generalized plant";
        let counts = [
            ("inputs of the controller", self.n_y, controller.n_inputs()),
            ("outputs of the controller", self.n_u, controller.n_outputs()),
        ];
        for (port, expected, found) in counts {
            if expected != found {
                return Err(Error::PortCount { operation, port, expected, found });
            }
        }
        self.sys.lower_lft(controller)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ports 2 + 1 in, 3 + 1 out, entries that tell where they came from.
    fn plant() -> GeneralizedPlant {
        let number = |base: f64| move |i: usize, j: usize| base + 10.0 * i as f64 + j as f64;
        let sys = StateSpace::<Continuous>::new(
            DMatrix::from_fn(2, 2, number(100.0)),
            DMatrix::from_fn(2, 3, number(200.0)),
            DMatrix::from_fn(4, 2, number(300.0)),
            DMatrix::from_fn(4, 3, number(400.0)),
        );
        GeneralizedPlant::new(sys.expect("valid"), 2, 1, 3, 1).expect("ports add up")
    }

    #[test]
    fn law_the_blocks_tile_the_system() {
        let p = plant();
        assert_eq!(p.b1().shape(), (2, 2));
        assert_eq!(p.b2(), DMatrix::from_row_slice(2, 1, &[202.0, 212.0]));
        assert_eq!(p.c1().shape(), (3, 2));
        assert_eq!(p.c2(), DMatrix::from_row_slice(1, 2, &[330.0, 331.0]));
        assert_eq!(p.d11().shape(), (3, 2));
        assert_eq!(p.d12(), DMatrix::from_row_slice(3, 1, &[402.0, 412.0, 422.0]));
        assert_eq!(p.d21(), DMatrix::from_row_slice(1, 2, &[430.0, 431.0]));
        assert_eq!(p.d22()[(0, 0)], 432.0);
        assert_eq!(p.a(), *p.sys().a());
    }

    #[test]
    fn edge_groups_must_add_up_to_the_ports() {
        let sys = plant().sys().clone();
        assert!(matches!(
            GeneralizedPlant::new(sys.clone(), 1, 1, 3, 1),
            Err(Error::PortCount { port: "inputs", .. })
        ));
        assert!(matches!(
            GeneralizedPlant::new(sys.clone(), 2, 1, 2, 1),
            Err(Error::PortCount { port: "outputs", .. })
        ));
        assert!(matches!(
            GeneralizedPlant::new(sys, 3, 0, 3, 1),
            Err(Error::PortCount { port: "signals in u", .. })
        ));
        let wide = StateSpace::<Continuous>::from_gain(DMatrix::zeros(1, 2)).expect("valid");
        assert!(matches!(plant().lower_lft(&wide), Err(Error::PortCount { .. })));
    }
}
