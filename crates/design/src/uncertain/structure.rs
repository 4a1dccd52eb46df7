//! Which perturbations are admitted: the blocks of `Delta` and their order.

use nalgebra::DMatrix;
use num_complex::Complex64;

use crate::Error;

/// One block of the perturbation `Delta`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Block {
    /// `delta I`, `delta` real: a parameter that enters `size` times.
    RepeatedReal {
        /// Rows and columns of the block.
        size: usize,
    },
    /// `delta I`, `delta` complex.
    RepeatedComplex {
        /// Rows and columns of the block.
        size: usize,
    },
    /// Any complex matrix: unmodelled dynamics, or the fictitious block of a performance specification.
    Full {
        /// Rows: signals that leave the block.
        rows: usize,
        /// Columns: signals that enter the block.
        cols: usize,
    },
}

impl Block {
    /// Signals that leave the block, which are inputs of `M`.
    #[must_use]
    pub fn rows(self) -> usize {
        match self {
            Self::RepeatedReal { size } | Self::RepeatedComplex { size } => size,
            Self::Full { rows, .. } => rows,
        }
    }

    /// Signals that enter the block, which are outputs of `M`.
    #[must_use]
    pub fn cols(self) -> usize {
        match self {
            Self::RepeatedReal { size } | Self::RepeatedComplex { size } => size,
            Self::Full { cols, .. } => cols,
        }
    }

    /// Whether the block is a real parameter.
    #[must_use]
    pub fn is_real(self) -> bool {
        matches!(self, Self::RepeatedReal { .. })
    }
}

/// The block-diagonal structure of a perturbation.
///
/// ```text
///         +------- Delta <-------+
///         |   diag(D_1, D_2, ..) |        w = Delta z,  z = M w
///       w |                      | z
///         +-------->  M  --------+        Delta: n_w × n_z,  M: n_z × n_w
/// ```
///
/// **Example**: a parameter that enters twice, beside unmodelled dynamics from three signals to one.
/// ```
/// use telepulse_design::uncertain::{Block, BlockStructure};
/// let blocks = vec![Block::RepeatedReal { size: 2 }, Block::Full { rows: 1, cols: 3 }];
/// let structure = BlockStructure::new(blocks)?;
/// assert_eq!((structure.n_w(), structure.n_z()), (3, 5));
/// # Ok::<(), telepulse_design::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BlockStructure {
    blocks: Vec<Block>,
}

/// A block with its place in `Delta`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlacedBlock {
    pub(crate) block: Block,
    /// First row: the first of its signals in `w`.
    pub(crate) row: usize,
    /// First column: the first of its signals in `z`.
    pub(crate) col: usize,
}

impl BlockStructure {
    /// A structure from its blocks, in the order of their signals.
    ///
    /// **Errors**: [`Error::NoUncertainBlocks`] for an empty list, [`Error::EmptyBlock`] for a block without rows or
    /// columns.
    pub fn new(blocks: Vec<Block>) -> Result<Self, Error> {
        if blocks.is_empty() {
            return Err(Error::NoUncertainBlocks);
        }
        if let Some(index) = blocks.iter().position(|b| b.rows() == 0 || b.cols() == 0) {
            return Err(Error::EmptyBlock { index, rows: blocks[index].rows(), cols: blocks[index].cols() });
        }
        Ok(Self { blocks })
    }

    /// The blocks in order.
    #[must_use]
    pub fn blocks(&self) -> &[Block] {
        &self.blocks
    }

    /// Rows of `Delta`, which are the inputs of `M`.
    #[must_use]
    pub fn n_w(&self) -> usize {
        self.blocks.iter().map(|b| b.rows()).sum()
    }

    /// Columns of `Delta`, which are the outputs of `M`.
    #[must_use]
    pub fn n_z(&self) -> usize {
        self.blocks.iter().map(|b| b.cols()).sum()
    }

    /// Whether any block is a real parameter.
    #[must_use]
    pub fn has_real(&self) -> bool {
        self.blocks.iter().any(|b| b.is_real())
    }

    /// The structure with the blocks of `other` after those of this one.
    #[must_use]
    pub fn followed_by(&self, other: &Self) -> Self {
        Self { blocks: self.blocks.iter().chain(&other.blocks).copied().collect() }
    }

    /// The chosen blocks, in the order given.
    pub(crate) fn restricted(&self, indices: &[usize]) -> Self {
        Self { blocks: indices.iter().map(|&i| self.blocks[i]).collect() }
    }

    pub(crate) fn placed(&self) -> impl Iterator<Item = PlacedBlock> + '_ {
        self.blocks.iter().scan((0, 0), |at, &block| {
            let placed = PlacedBlock { block, row: at.0, col: at.1 };
            at.0 += block.rows();
            at.1 += block.cols();
            Some(placed)
        })
    }

    /// Whether `m` is a finite matrix that this structure closes.
    pub(crate) fn check(&self, m: &DMatrix<Complex64>) -> Result<(), Error> {
        if m.shape() != (self.n_z(), self.n_w()) {
            let (expected_rows, expected_cols) = (self.n_z(), self.n_w());
            let (rows, cols) = m.shape();
            let shape = telepulse_lti::Error::Shape { matrix: "m", expected_rows, expected_cols, rows, cols };
            return Err(shape.into());
        }
        for (index, v) in m.iter().enumerate() {
            if !v.re.is_finite() || !v.im.is_finite() {
                let value = if v.re.is_finite() { v.im } else { v.re };
                return Err(telepulse_lti::Error::NotFinite { quantity: "m", index, value }.into());
            }
        }
        Ok(())
    }
}

/// The value of one block.
#[derive(Clone, Debug, PartialEq)]
pub enum BlockValue {
    /// A real parameter.
    Real(f64),
    /// A complex scalar.
    Complex(Complex64),
    /// A full block, `rows × cols`.
    Full(DMatrix<Complex64>),
}

impl BlockValue {
    /// The size of the block: absolute value, or largest singular value.
    #[must_use]
    pub fn norm(&self) -> f64 {
        match self {
            Self::Real(v) => v.abs(),
            Self::Complex(v) => v.norm(),
            Self::Full(m) => m.singular_values().max(),
        }
    }
}

/// A constant complex perturbation with a given structure.
#[derive(Clone, Debug, PartialEq)]
pub struct Perturbation {
    /// One value per block.
    pub values: Vec<BlockValue>,
}

impl Perturbation {
    /// The largest block: the size that the structured singular value compares with.
    #[must_use]
    pub fn norm(&self) -> f64 {
        self.values.iter().map(BlockValue::norm).fold(0.0, f64::max)
    }

    /// `Delta` as one matrix, `n_w × n_z`.
    ///
    /// **Errors**: [`Error::BlockMismatch`] where a value does not fit its block.
    pub fn matrix(&self, structure: &BlockStructure) -> Result<DMatrix<Complex64>, Error> {
        if self.values.len() != structure.blocks().len() {
            return Err(Error::BlockMismatch { index: self.values.len().min(structure.blocks().len()) });
        }
        let mut delta = DMatrix::zeros(structure.n_w(), structure.n_z());
        for (index, (at, value)) in structure.placed().zip(&self.values).enumerate() {
            let mut diagonal = |v: Complex64| {
                for k in 0..at.block.rows() {
                    delta[(at.row + k, at.col + k)] = v;
                }
            };
            match (at.block, value) {
                (Block::RepeatedReal { .. }, BlockValue::Real(v)) => diagonal(Complex64::new(*v, 0.0)),
                (Block::RepeatedComplex { .. }, BlockValue::Complex(v)) => diagonal(*v),
                (Block::Full { rows, cols }, BlockValue::Full(m)) if m.shape() == (rows, cols) => {
                    delta.view_mut((at.row, at.col), (rows, cols)).copy_from(m);
                }
                _ => return Err(Error::BlockMismatch { index }),
            }
        }
        Ok(delta)
    }

    /// Every block multiplied by `factor`.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        let values = self.values.iter().map(|value| match value {
            BlockValue::Real(v) => BlockValue::Real(v * factor),
            BlockValue::Complex(v) => BlockValue::Complex(v * factor),
            BlockValue::Full(m) => BlockValue::Full(m.map(|v| v * factor)),
        });
        Self { values: values.collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edge_a_structure_needs_blocks_with_ports() {
        assert!(matches!(BlockStructure::new(vec![]), Err(Error::NoUncertainBlocks)));
        let empty = vec![Block::Full { rows: 1, cols: 1 }, Block::Full { rows: 0, cols: 2 }];
        assert!(matches!(BlockStructure::new(empty), Err(Error::EmptyBlock { index: 1, rows: 0, cols: 2 })));
    }

    #[test]
    fn edge_a_value_must_fit_its_block() {
        let structure = BlockStructure::new(vec![Block::RepeatedReal { size: 2 }]).expect("valid");
        let wrong = Perturbation { values: vec![BlockValue::Complex(Complex64::new(0.0, 1.0))] };
        assert!(matches!(wrong.matrix(&structure), Err(Error::BlockMismatch { index: 0 })));
        assert!(matches!(
            Perturbation { values: vec![] }.matrix(&structure),
            Err(Error::BlockMismatch { index: 0 })
        ));
        let right = Perturbation { values: vec![BlockValue::Real(-0.5)] };
        let delta = right.matrix(&structure).expect("fits");
        assert_eq!((delta[(1, 1)].re, delta[(0, 1)].re), (-0.5, 0.0));
    }
}
