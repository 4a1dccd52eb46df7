//! Singular problems: a regular plant next to the one given, and how near it has to be.
//!
//! The formulas need `D12` of full column rank, `D21` of full row rank and no zeros on the imaginary axis. Where a plant
//! lacks that, signals are appended to `z` and `w`:
//!
//! ```text
//!     z_e = [ z                ]          w_e = [ w  v_y  v_x ]
//!           [ epsilon s_u V'u  ]          y   = ... + epsilon s_y U v_y
//!           [ epsilon s_x x    ]          x'  = ... + epsilon s_b v_x
//! ```
//!
//! with `V` and `U` the directions of `u` and `y` that the direct terms miss and the `s` the plant's own size. Whatever the
//! controller, the enlarged closed loop contains the given one, so its norm is an upper bound; and as `epsilon` goes to
//! zero its optimum goes to the infimum of the given plant.

use nalgebra::DMatrix;
use telepulse_lti::{Continuous, GeneralizedPlant, StateSpace};

use super::hinfsyn::{HinfDesign, HinfOptions, Regularization, Repaired, regular_design};
use crate::Error;

/// Returns the best controller among those of enlarged plants with ever smaller additions.
///
/// **Method**: `epsilon` falls by decades from [`EPSILON_FIRST`] while that lowers the norm on the plant as given by more
/// than [`WORTHWHILE`]. What has to be repaired is found by trying: an error names what is missing.
///
/// **Errors**: the reason why the first enlarged plant could not be solved either.
pub(super) fn regularized_design(
    plant: &GeneralizedPlant,
    options: &HinfOptions,
    reason: Error,
) -> Result<HinfDesign, Error> {
    let mut repairs = Repairs::default();
    repairs.add(&reason);
    let balanced =
        GeneralizedPlant::new(plant.sys().balanced(), plant.n_w(), plant.n_u(), plant.n_z(), plant.n_y())?;
    let sizes = Sizes::of(&balanced);
    let mut best: Option<HinfDesign> = None;
    let mut last = reason.clone();
    let mut n_idle = 0;
    for step in 0..EPSILONS_MAX {
        let epsilon = EPSILON_FIRST * 0.1_f64.powi(step);
        match solve(&balanced, &sizes, &mut repairs, epsilon, options) {
            Ok(design) => {
                let improvement = best.as_ref().map_or(f64::INFINITY, |b| {
                    if design.achieved.value > 0.0 {
                        b.achieved.value / design.achieved.value - 1.0
                    } else {
                        0.0
                    }
                });
                if improvement > 0.0 {
                    best = Some(design);
                }
                n_idle = if improvement > WORTHWHILE { 0 } else { n_idle + 1 };
            }
            Err(error @ (Error::NotStabilizable { .. } | Error::NotDetectable { .. })) => return Err(error),
            Err(error) => {
                last = error;
                n_idle += 1;
            }
        }
        if n_idle >= IDLE_MAX && (best.is_some() || step > STEPS_WITHOUT_ANSWER) {
            break;
        }
    }
    best.ok_or(if matches!(reason, Error::Infeasible { .. }) { reason } else { last })
}

/// Designs for one `epsilon`, adding repairs until the enlarged plant is regular.
fn solve(
    plant: &GeneralizedPlant,
    sizes: &Sizes,
    repairs: &mut Repairs,
    epsilon: f64,
    options: &HinfOptions,
) -> Result<HinfDesign, Error> {
    let mut result = regular_design(&repairs.enlarged(plant, sizes, epsilon)?, plant, options, DESIGNS_EACH);
    for _ in 0..REPAIRS {
        let Err(error) = &result else { break };
        if !repairs.add(error) {
            break;
        }
        result = regular_design(&repairs.enlarged(plant, sizes, epsilon)?, plant, options, DESIGNS_EACH);
    }
    let mut design = result?;
    design.regularization = Some(Regularization {
        epsilon,
        d12: repairs.d12,
        d21: repairs.d21,
        axis_zeros: match (repairs.states_weighted, repairs.states_disturbed) {
            (Repaired::No, Repaired::No) => Repaired::No,
            _ => Repaired::Yes,
        },
        gamma_enlarged: design.gamma_upper,
    });
    // The bracket of the enlarged plant bounds the given one from above only.
    design.gamma_lower = sizes.lower_bound.min(design.achieved.value);
    design.gamma_upper = design.achieved.upper;
    Ok(design)
}

/// What has to be appended.
struct Repairs {
    d12: Repaired,
    d21: Repaired,
    states_weighted: Repaired,
    states_disturbed: Repaired,
}

impl Default for Repairs {
    fn default() -> Self {
        Self {
            d12: Repaired::No,
            d21: Repaired::No,
            states_weighted: Repaired::No,
            states_disturbed: Repaired::No,
        }
    }
}

impl Repairs {
    /// Takes up what an error names; whether that was news.
    fn add(&mut self, error: &Error) -> bool {
        let slot = match error {
            Error::SingularD12 { .. } => &mut self.d12,
            Error::SingularD21 { .. } => &mut self.d21,
            Error::AxisZero { path, .. } if *path == super::assumptions::CONTROL_PATH => {
                &mut self.states_weighted
            }
            Error::AxisZero { .. } => &mut self.states_disturbed,
            // No reason that can be named: everything helps.
            Error::IllConditioned { .. } | Error::NotConverged { .. } | Error::Infeasible { .. } => {
                let all =
                    [&mut self.d12, &mut self.d21, &mut self.states_weighted, &mut self.states_disturbed];
                let mut news = false;
                for slot in all {
                    news |= *slot == Repaired::No;
                    *slot = Repaired::Yes;
                }
                return news;
            }
            _ => return false,
        };
        let news = *slot == Repaired::No;
        *slot = Repaired::Yes;
        news
    }

    fn enlarged(
        &self,
        plant: &GeneralizedPlant,
        sizes: &Sizes,
        epsilon: f64,
    ) -> Result<GeneralizedPlant, Error> {
        let (n, n_w, n_u, n_z, n_y) = (plant.n_states(), plant.n_w(), plant.n_u(), plant.n_z(), plant.n_y());
        let none = |n_rows| DMatrix::zeros(n_rows, 0);
        let of =
            |repaired, m: DMatrix<f64>| if repaired == Repaired::Yes { m * epsilon } else { none(m.nrows()) };
        // Columns here, rows of the plant: the directions of u and the states that get a weight.
        let u = of(self.d12, sizes.u_directions.clone());
        let xz = of(self.states_weighted, DMatrix::identity(n, n) * sizes.state_weight);
        let y = of(self.d21, sizes.y_directions.clone());
        let xw = of(self.states_disturbed, DMatrix::identity(n, n) * sizes.state_disturbance);
        let (more_z, more_w) = (u.ncols() + xz.ncols(), y.ncols() + xw.ncols());
        let mut b = DMatrix::zeros(n, n_w + more_w + n_u);
        b.columns_mut(0, n_w).copy_from(&plant.b1());
        b.columns_mut(n_w + y.ncols(), xw.ncols()).copy_from(&xw);
        b.columns_mut(n_w + more_w, n_u).copy_from(&plant.b2());
        let mut c = DMatrix::zeros(n_z + more_z + n_y, n);
        c.rows_mut(0, n_z).copy_from(&plant.c1());
        c.rows_mut(n_z + u.ncols(), xz.ncols()).copy_from(&xz.transpose());
        c.rows_mut(n_z + more_z, n_y).copy_from(&plant.c2());
        let mut d = DMatrix::zeros(n_z + more_z + n_y, n_w + more_w + n_u);
        d.view_mut((0, 0), (n_z, n_w)).copy_from(&plant.d11());
        d.view_mut((0, n_w + more_w), (n_z, n_u)).copy_from(&plant.d12());
        d.view_mut((n_z, n_w + more_w), (u.ncols(), n_u)).copy_from(&u.transpose());
        d.view_mut((n_z + more_z, 0), (n_y, n_w)).copy_from(&plant.d21());
        d.view_mut((n_z + more_z, n_w), (n_y, y.ncols())).copy_from(&y);
        d.view_mut((n_z + more_z, n_w + more_w), (n_y, n_u)).copy_from(&plant.d22());
        let sys = StateSpace::<Continuous>::new(plant.a(), b, c, d)?;
        Ok(GeneralizedPlant::new(sys, n_w + more_w, n_u, n_z + more_z, n_y)?)
    }
}

/// Directions to be repaired, each as long as the plant's own signals there.
struct Sizes {
    /// Columns: directions of `u` that `D12` misses.
    u_directions: DMatrix<f64>,
    /// Columns: directions of `y` that `D21` misses.
    y_directions: DMatrix<f64>,
    /// Size of `C1` and `B1` for one state; the states of the plant are balanced.
    state_weight: f64,
    state_disturbance: f64,
    /// No controller gets below this.
    lower_bound: f64,
}

impl Sizes {
    fn of(plant: &GeneralizedPlant) -> Self {
        let frequencies = super::pointwise_bound::frequencies(plant);
        let median = |pick: &dyn Fn(&DMatrix<num_complex::Complex64>) -> f64| {
            let mut gains: Vec<f64> = frequencies
                .iter()
                .filter_map(|omega| plant.sys().at(*omega).ok())
                .map(|response| pick(&response))
                .filter(|gain| *gain > 0.0 && gain.is_finite())
                .collect();
            gains.sort_by(f64::total_cmp);
            gains.get(gains.len() / 2).copied().unwrap_or(1.0)
        };
        let (n_w, n_u, n_z, n_y) = (plant.n_w(), plant.n_u(), plant.n_z(), plant.n_y());
        let (d12, d21) = (plant.d12(), plant.d21());
        let mut u_directions = missed(&d12);
        let mut y_directions = missed(&d21.transpose());
        for mut v in u_directions.column_iter_mut() {
            let direction = v.map(|value| num_complex::Complex64::new(value, 0.0));
            let gain = median(&|p| (p.view((0, n_w), (n_z, n_u)) * &direction).norm());
            v.scale_mut(gain.max(d12.norm()));
        }
        for mut v in y_directions.column_iter_mut() {
            let direction = v.map(|value| num_complex::Complex64::new(value, 0.0));
            let gain = median(&|p| (direction.transpose() * p.view((n_z, 0), (n_y, n_w))).norm());
            v.scale_mut(gain.max(d21.norm()));
        }
        let typical =
            |size: f64| if size > 0.0 { size / (plant.n_states().max(1) as f64).sqrt() } else { 1.0 };
        Self {
            u_directions,
            y_directions,
            state_weight: typical(plant.c1().norm()),
            state_disturbance: typical(plant.b1().norm()),
            lower_bound: super::pointwise_bound::pointwise_bound(plant, &frequencies).value(),
        }
    }
}

/// Orthonormal directions that a matrix does not see, as columns.
fn missed(m: &DMatrix<f64>) -> DMatrix<f64> {
    let n = m.ncols();
    let eigen = nalgebra::SymmetricEigen::new(m.tr_mul(m));
    let largest = eigen.eigenvalues.max().max(0.0);
    let columns: Vec<_> = (0..n)
        .filter(|&k| eigen.eigenvalues[k] <= MISSED * MISSED * largest || largest == 0.0)
        .map(|k| eigen.eigenvectors.column(k).into_owned())
        .collect();
    if columns.is_empty() { DMatrix::zeros(n, 0) } else { DMatrix::from_columns(&columns) }
}

/// Size of the first addition relative to the plant.
const EPSILON_FIRST: f64 = 1e-2;
/// Decades tried.
const EPSILONS_MAX: i32 = 7;
/// A decade that lowers the norm by less than this is idle.
const WORTHWHILE: f64 = 2e-3;
/// Idle decades after which smaller ones are not tried.
const IDLE_MAX: usize = 2;
/// Decades without any controller after which smaller ones are not tried.
const STEPS_WITHOUT_ANSWER: i32 = 2;
/// Kinds of repair.
const REPAIRS: usize = 4;
/// Singular values of a direct term, relative to the largest, below which a direction counts as missed.
const MISSED: f64 = EPSILON_FIRST;
/// Designs for one enlarged plant: others beside it may do better than its fifth.
const DESIGNS_EACH: usize = 4;
