//! The perturbation blocks of a D-K iteration.

use nalgebra::DMatrix;
use num_complex::Complex64;

use crate::Error;

/// One full complex block of the perturbation: it reads `n_z` signals of the plant's `z` and drives `n_w` of its `w`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FullBlock {
    /// Signals of `w` that come from the block.
    pub n_w: usize,
    /// Signals of `z` that go to the block.
    pub n_z: usize,
}

/// The full blocks of `Delta`, in the order of their signals; a performance specification is one of them.
///
/// ```text
///            +--- diag(Delta_1, .., Delta_m) <---+
///          w |                                   | z
///            +---------->  P  -------------------+        z: performance output goes to the block of performance
///                   u +-> P -> y, u = K y
/// ```
///
/// **Example**: multiplicative uncertainty of two inputs, and a performance block from two disturbances to two errors.
/// ```
/// use telepulse_design::synthesize::dk::{FullBlock, FullBlocks};
/// let blocks = FullBlocks::new(vec![FullBlock { n_w: 2, n_z: 2 }; 2])?;
/// assert_eq!((blocks.n_w(), blocks.n_z()), (4, 4));
/// # Ok::<(), telepulse_design::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FullBlocks(Vec<FullBlock>);

impl FullBlocks {
    /// Blocks in the order of their signals.
    ///
    /// **Errors**: [`Error::EmptyList`] for no block, [`telepulse_lti::Error::PortCount`] for one without signals.
    pub fn new(blocks: Vec<FullBlock>) -> Result<Self, Error> {
        if blocks.is_empty() {
            return Err(Error::EmptyList { key: "blocks" });
        }
        for block in &blocks {
            for (port, found) in [("signals in w", block.n_w), ("signals in z", block.n_z)] {
                if found == 0 {
                    let operation = "a perturbation block";
                    return Err(
                        telepulse_lti::Error::PortCount { operation, port, expected: 1, found }.into()
                    );
                }
            }
        }
        Ok(Self(blocks))
    }

    /// The blocks in order.
    #[must_use]
    pub fn blocks(&self) -> &[FullBlock] {
        &self.0
    }

    /// Signals of `w` that come from blocks.
    #[must_use]
    pub fn n_w(&self) -> usize {
        self.0.iter().map(|b| b.n_w).sum()
    }

    /// Signals of `z` that go to blocks.
    #[must_use]
    pub fn n_z(&self) -> usize {
        self.0.iter().map(|b| b.n_z).sum()
    }

    pub(super) fn check_ports(&self, n_w: usize, n_z: usize) -> Result<(), Error> {
        let operation = "perturbation blocks";
        for (port, expected, found) in [("signals in w", n_w, self.n_w()), ("signals in z", n_z, self.n_z())]
        {
            if expected != found {
                return Err(telepulse_lti::Error::PortCount { operation, port, expected, found }.into());
            }
        }
        Ok(())
    }

    /// The block that owns each signal of `z`.
    pub(super) fn owners_z(&self) -> Vec<usize> {
        self.0.iter().enumerate().flat_map(|(i, b)| std::iter::repeat_n(i, b.n_z)).collect()
    }

    /// The block that owns each signal of `w`.
    pub(super) fn owners_w(&self) -> Vec<usize> {
        self.0.iter().enumerate().flat_map(|(i, b)| std::iter::repeat_n(i, b.n_w)).collect()
    }

    /// `D_L M D_R^-1` for one scale per block.
    pub(super) fn scaled(&self, m: &DMatrix<Complex64>, scales: &[f64]) -> DMatrix<Complex64> {
        let (rows, cols) = (self.owners_z(), self.owners_w());
        DMatrix::from_fn(m.nrows(), m.ncols(), |i, j| m[(i, j)] * (scales[rows[i]] / scales[cols[j]]))
    }
}
