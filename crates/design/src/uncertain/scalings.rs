//! The D,G-scales of an upper bound, and the test that they prove it.

use nalgebra::DMatrix;
use num_complex::Complex64;

use super::hermitian::cholesky;
use super::lmi::Lmi;
use super::structure::{Block, BlockStructure};
use crate::Error;

/// Scales that commute with every perturbation of a structure.
///
/// They prove that the structured singular value of `M` is below `beta` where
///
/// ```text
///   Mᴴ D_L M + j (G M - Mᴴ G) < beta² D_R,     D_L, D_R > 0
/// ```
///
/// **Shapes**: per block, `d` is `size × size`, Hermitian and positive definite for a repeated scalar, and `1 × 1` for a full
/// block, where `D_L = d I_cols` and `D_R = d I_rows`; `g` is `size × size` and Hermitian for a repeated real scalar and
/// `0 × 0` for the others. In the usual notation `D M D^-1` the scale is the square root of this `d`.
///
/// **Source**: Fan, Tits and Doyle 1991, IEEE Trans. Automatic Control 36(1), theorem 3.
#[derive(Clone, Debug, PartialEq)]
pub struct Scalings {
    /// `D`, one matrix per block.
    pub d: Vec<DMatrix<Complex64>>,
    /// `G`, one matrix per block, empty unless the block is real.
    pub g: Vec<DMatrix<Complex64>>,
}

impl Scalings {
    /// The scales `D = I`, `G = 0`, with which the bound is the largest singular value.
    #[must_use]
    pub fn identity(structure: &BlockStructure) -> Self {
        let size = |b: &Block| if matches!(b, Block::Full { .. }) { 1 } else { b.rows() };
        let real = |b: &Block| if b.is_real() { b.rows() } else { 0 };
        Self {
            d: structure.blocks().iter().map(|b| DMatrix::identity(size(b), size(b))).collect(),
            g: structure.blocks().iter().map(|b| DMatrix::zeros(real(b), real(b))).collect(),
        }
    }

    /// Whether these scales prove that the structured singular value of `m` is below `level`.
    ///
    /// **Method**: Cholesky factorisation of `D` and of `level² D_R - Mᴴ D_L M - j (G M - Mᴴ G)`.
    ///
    /// **Accuracy**: exact up to the rounding of the factorisation, about `n eps` of each diagonal entry.
    ///
    /// **Errors**: [`telepulse_lti::Error::Shape`] or [`telepulse_lti::Error::NotFinite`] for a matrix that the structure
    /// does not close.
    pub fn prove(
        &self,
        m: &DMatrix<Complex64>,
        structure: &BlockStructure,
        level: f64,
    ) -> Result<bool, Error> {
        structure.check(m)?;
        let lmi = Lmi::new(structure, m.as_slice().to_vec());
        Ok(self.hold_in(&lmi, structure.n_w(), level))
    }

    pub(crate) fn hold_in(&self, lmi: &Lmi, n_w: usize, level: f64) -> bool {
        let mut flat_d = Vec::new();
        let mut flat_g = Vec::new();
        for (d, g) in self.d.iter().zip(&self.g) {
            if !cholesky(&mut d.as_slice().to_vec(), d.nrows()) {
                return false;
            }
            flat_d.extend_from_slice(d.as_slice());
            if g.is_empty() {
                flat_g.extend(std::iter::repeat_n(Complex64::new(0.0, 0.0), d.len()));
            } else {
                flat_g.extend_from_slice(g.as_slice());
            }
        }
        let mut s = vec![Complex64::new(0.0, 0.0); n_w * n_w];
        lmi.assemble(&flat_d, &flat_g, level * level, &mut s);
        cholesky(&mut s, n_w)
    }

    /// `D_L`, `n_z × n_z`.
    #[must_use]
    pub fn left(&self, structure: &BlockStructure) -> DMatrix<Complex64> {
        self.place(structure, structure.n_z(), |at| (at.col, at.block.cols()))
    }

    /// `D_R`, `n_w × n_w`.
    #[must_use]
    pub fn right(&self, structure: &BlockStructure) -> DMatrix<Complex64> {
        self.place(structure, structure.n_w(), |at| (at.row, at.block.rows()))
    }

    /// `G`, `n_w × n_z`, zero outside of the real blocks.
    #[must_use]
    pub fn g_matrix(&self, structure: &BlockStructure) -> DMatrix<Complex64> {
        let mut all = DMatrix::zeros(structure.n_w(), structure.n_z());
        for (at, g) in structure.placed().zip(&self.g) {
            all.view_mut((at.row, at.col), g.shape()).copy_from(g);
        }
        all
    }

    fn place(
        &self,
        structure: &BlockStructure,
        n: usize,
        side: impl Fn(super::structure::PlacedBlock) -> (usize, usize),
    ) -> DMatrix<Complex64> {
        let mut all = DMatrix::zeros(n, n);
        for (at, d) in structure.placed().zip(&self.d) {
            let (start, count) = side(at);
            if d.nrows() == count {
                all.view_mut((start, start), d.shape()).copy_from(d);
            } else {
                (start..start + count).for_each(|k| all[(k, k)] = d[(0, 0)]);
            }
        }
        all
    }
}
