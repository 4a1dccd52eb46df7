//! Reduction of the Maxwell branches from strain fields to a few coordinates.
//!
//! A neo-Hookean branch near its relaxed state stores (mu_i/2) |E - Z_i|^2, where E is the field of logarithmic strains
//! (ln l1, ln l2), Z_i that of its dashpots, and the norm integrates 4 e1^2 + 4 e1 e2 + 4 e2^2 over the membrane's volume:
//! a flat space. The dashpots follow by Z_i' = (E - Z_i)/tau_i in every component. So the branches see nothing but the
//! projection of E on a fixed orthonormal basis that holds the strains which occur.

use nalgebra::{DMatrix, DVector};

use super::model::{BRANCH_POINTS_V2, BRANCH_POINTS_X, Slack, sweep};
use super::surface::{Axis, Surface};
use crate::Error;
use crate::membrane::{Dashpots, Equilibrium, Membrane};

/// Coordinates of the strain: one along the internal mode, the others along the strains of the relaxed membrane.
pub(super) const STRAIN_MODES: usize = 3;

/// The branches' view of the membrane.
///
/// ```text
/// E_k(x, V^2, a) = c_k(x, V^2) + a (k = 0 only)      0 = K a + sum_i mu_i (c_0 + a - zeta_i0)
/// F = F_relaxed + sum_i mu_i sum_k (E_k - zeta_ik) dc_k/dx + (a^2/2) dK/dx
/// ```
/// `a` is the amplitude of the internal mode: frozen branches do not let the membrane take its relaxed shape.
///
/// **Shapes and units**: c_k in m^1.5 (square root of volume), K in Pa.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct BranchMaps {
    /// `[power of V^2][power of x][c_0, c_1, c_2, K]`: side by side, so that one pass evaluates all of them.
    coefficients: [BranchSlice; BRANCH_POINTS_V2],
}

/// c_k and K.
pub(super) const CHANNELS: usize = STRAIN_MODES + 1;

/// The maps at one voltage: ascending powers of normalized x.
pub(super) type BranchSlice = [[f64; CHANNELS]; BRANCH_POINTS_X];

/// The maps at one voltage and displacement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct BranchPoint {
    /// c_k, m^1.5.
    pub(super) strain: [f64; STRAIN_MODES],
    /// dc_k by normalized x.
    pub(super) strain_slope: [f64; STRAIN_MODES],
    /// K, Pa.
    pub(super) stiffness: f64,
}

/// Evaluates a slice and its slope at normalized `u` in -1..1; beyond, by `excess`, the strains go on linearly and K stays.
#[inline]
pub(super) fn branch_point(slice: &BranchSlice, u: f64, excess: f64) -> BranchPoint {
    let mut value = slice[BRANCH_POINTS_X - 1];
    let mut slope = [0.0; CHANNELS];
    for row in slice[..BRANCH_POINTS_X - 1].iter().rev() {
        for k in 0..CHANNELS {
            slope[k] = slope[k] * u + value[k];
            value[k] = value[k] * u + row[k];
        }
    }
    let mut point = BranchPoint {
        strain: [0.0; STRAIN_MODES],
        strain_slope: [0.0; STRAIN_MODES],
        stiffness: value[STRAIN_MODES],
    };
    for k in 0..STRAIN_MODES {
        point.strain[k] = value[k] + excess * slope[k];
        point.strain_slope[k] = slope[k];
    }
    point
}

/// Strains at one grid point, in orthonormal coordinates of the flat space.
struct Snapshot {
    strain: DVector<f64>,
    by_displacement: DVector<f64>,
    /// Frozen minus relaxed response to displacement and to V^2, at a comparable scale.
    internal: [DVector<f64>; 2],
    stiffness_relaxed: f64,
    stiffness_frozen: f64,
}

impl BranchMaps {
    /// Maps of a membrane without branches: no strain matters, and the internal mode is held by K = 1 Pa.
    pub(super) fn absent() -> Self {
        let mut coefficients = [[[0.0; CHANNELS]; BRANCH_POINTS_X]; BRANCH_POINTS_V2];
        coefficients[0][0][STRAIN_MODES] = 1.0;
        Self { coefficients }
    }

    /// Builds the maps for a membrane with at least one branch.
    pub(super) fn new(
        membrane: &Membrane,
        rest: &Equilibrium,
        x_axis: Axis,
        v2_axis: Axis,
    ) -> Result<Self, Error> {
        Ok(Self::from_channels(&channels(membrane, rest, x_axis, v2_axis, Slack::Refused)?))
    }

    /// From the surfaces of c_0, c_1, c_2 and K.
    pub(super) fn from_channels(channels: &[Surface<BRANCH_POINTS_X, BRANCH_POINTS_V2>; CHANNELS]) -> Self {
        let coefficients = std::array::from_fn(|iy| {
            std::array::from_fn(|ix| std::array::from_fn(|c| channels[c].coefficients()[iy][ix]))
        });
        Self { coefficients }
    }

    /// Coefficients: `[power of y][power of x][channel]`.
    pub(super) fn coefficients(&self) -> &[BranchSlice; BRANCH_POINTS_V2] {
        &self.coefficients
    }

    /// The maps at normalized V^2.
    pub(super) fn slice(&self, y: f64) -> BranchSlice {
        let mut slice = self.coefficients[BRANCH_POINTS_V2 - 1];
        for coefficients in self.coefficients[..BRANCH_POINTS_V2 - 1].iter().rev() {
            for (row, add) in slice.iter_mut().zip(coefficients) {
                for k in 0..CHANNELS {
                    row[k] = row[k] * y + add[k];
                }
            }
        }
        slice
    }
}

/// Surfaces of c_0, c_1, c_2 and K, from membrane solves at the tensor of Chebyshev points.
///
/// **Method**: internal mode by singular value decomposition of the frozen-minus-relaxed responses over the grid; the
/// other modes likewise of the relaxed strains, orthogonal to it. K is chosen so that the frozen stiffness of the
/// reduction equals that of the membrane at every grid point.
pub(super) fn channels<const NX: usize, const NY: usize>(
    membrane: &Membrane,
    rest: &Equilibrium,
    x_axis: Axis,
    v2_axis: Axis,
    slack: Slack,
) -> Result<[Surface<NX, NY>; CHANNELS], Error> {
    let modulus = membrane.parameters().branch_modulus_pa();
    let xs = x_axis.points(NX);
    let mut rows = Vec::with_capacity(NY);
    for v2 in v2_axis.points(NY) {
        let states = sweep(membrane, rest, &xs, v2.max(0.0).sqrt(), slack)?;
        let row: Result<Vec<Snapshot>, Error> =
            states.iter().map(|state| snapshot(membrane, state, rest, x_axis, v2_axis)).collect();
        rows.push(row?);
    }
    let basis = strain_basis(&rows);
    let mut values = [[[0.0; NX]; NY]; CHANNELS];
    for (iy, row) in rows.iter().enumerate() {
        for (ix, snapshot) in row.iter().enumerate() {
            for (k, mode) in basis.iter().enumerate() {
                values[k][iy][ix] = mode.dot(&snapshot.strain);
            }
            values[STRAIN_MODES][iy][ix] = internal_stiffness(snapshot, &basis, modulus);
        }
    }
    Ok(values.map(|values| Surface::interpolate(&values)))
}

/// K from k_frozen = k_relaxed + m |dc/dx|^2 - (m dc_0/dx)^2/(K + m), m the sum of the branch moduli.
fn internal_stiffness(snapshot: &Snapshot, basis: &[DVector<f64>], modulus: f64) -> f64 {
    let gradient: Vec<f64> = basis.iter().map(|mode| mode.dot(&snapshot.by_displacement)).collect();
    let along: f64 = gradient.iter().map(|g| g * g).sum();
    let softening = snapshot.stiffness_relaxed + modulus * along - snapshot.stiffness_frozen;
    let coupling = modulus * gradient[0];
    // A vanishing softening means a mode that does not move: as stiff as it pleases.
    let stiffness = coupling * coupling / softening - modulus;
    if softening > 0.0 && stiffness.is_finite() && stiffness > 0.0 { stiffness } else { LOCKED * modulus }
}

/// Stiffness of an internal mode that does not move, relative to the branch modulus.
const LOCKED: f64 = 1e6;

fn snapshot(
    membrane: &Membrane,
    state: &Equilibrium,
    rest: &Equilibrium,
    x_axis: Axis,
    v2_axis: Axis,
) -> Result<Snapshot, Error> {
    let relaxed = membrane.sensitivity(state, &Dashpots::absent())?;
    let frozen = membrane.sensitivity(state, &Dashpots::relaxed_at(membrane, state))?;
    let strain = membrane.flat_coordinates((0..state.lambda1().len()).map(|j| {
        [(state.lambda1()[j] / rest.lambda1()[j]).ln(), (state.lambda2()[j] / rest.lambda2()[j]).ln()]
    }));
    let internal = [
        (&frozen.strain_by_displacement - &relaxed.strain_by_displacement) * x_axis.half(),
        (&frozen.strain_by_voltage_squared - &relaxed.strain_by_voltage_squared) * v2_axis.half(),
    ];
    Ok(Snapshot {
        strain,
        by_displacement: relaxed.strain_by_displacement,
        internal,
        stiffness_relaxed: relaxed.tangent.stiffness_n_per_m,
        stiffness_frozen: frozen.tangent.stiffness_n_per_m,
    })
}

fn strain_basis(rows: &[Vec<Snapshot>]) -> Vec<DVector<f64>> {
    let internal: Vec<DVector<f64>> = rows.iter().flatten().flat_map(|s| s.internal.clone()).collect();
    let first = leading(&internal, 1);
    let rest: Vec<DVector<f64>> = rows
        .iter()
        .flatten()
        .map(|snapshot| {
            let mut strain = snapshot.strain.clone();
            for mode in &first {
                strain -= mode * mode.dot(&snapshot.strain);
            }
            strain
        })
        .collect();
    first.into_iter().chain(leading(&rest, STRAIN_MODES - 1)).collect()
}

/// The `n` leading left singular vectors of the columns.
fn leading(columns: &[DVector<f64>], n: usize) -> Vec<DVector<f64>> {
    let svd = DMatrix::from_columns(columns).svd(true, false);
    // U was asked for, so it is there; singular values come in descending order.
    svd.u.map_or_else(Vec::new, |u| (0..n).map(|k| u.column(k).into_owned()).collect())
}
