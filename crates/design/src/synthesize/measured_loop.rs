//! The norm of a loop, and what forming the loop has cost it.
//!
//! Where a controller has gains of `1e6` and more, the entries of the closed loop's matrices are sums of terms that leave
//! few digits of the plant, and their norm is that of another loop. The response at one frequency can be had without them:
//! plant and controller stand side by side in one set of equations, every coefficient of which is an entry as given.

use nalgebra::DMatrix;
use num_complex::Complex64;
use telepulse_lti::doubled_matrix::DoubledMatrix;
use telepulse_lti::{Continuous, GeneralizedPlant, PeakGain, StateSpace};

use crate::Error;

/// The closed loop as one system.
pub(super) struct FormedLoop {
    pub(super) sys: StateSpace<Continuous>,
    /// Its poles in rad/s, stable.
    pub(super) poles: Vec<Complex64>,
    /// Its norm.
    pub(super) peak: PeakGain,
}

/// Returns the norm of the loop of plant and controller.
///
/// **Method**: the norm of the closed loop's matrices, if at its peak and at its slowest pole their response is that of the
/// [`ImplicitLoop`]. Otherwise the peak is sought anew among responses of the implicit loop, from the frequencies of all
/// poles, and evaluated there in doubled precision.
///
/// **Accuracy**: `value` is a gain of the loop of plant and controller as given. The ends are those of the closed loop's
/// matrices, moved apart by what these were seen to be off.
///
/// **Errors**: [`Error::IllConditioned`] at `gamma` where the two norms differ by more than [`LOSS_MAX`], so that whoever
/// forms the closed loop finds another norm.
pub(super) fn measured(
    plant: &GeneralizedPlant,
    controller: &StateSpace<Continuous>,
    formed: &FormedLoop,
    gamma: f64,
) -> Result<PeakGain, Error> {
    let FormedLoop { sys: closed_loop, poles, peak } = formed;
    if closed_loop.n_states() == 0 {
        return Ok(*peak);
    }
    let sizes = || poles.iter().map(|pole| pole.norm());
    let (slowest, fastest) = sizes().fold((f64::INFINITY, 0.0_f64), |(s, f), v| (s.min(v), f.max(v)));
    let at_peak = if peak.omega_rad_s.is_finite() { peak.omega_rad_s } else { BEYOND * fastest };
    let lost = Error::IllConditioned { gamma, achieved: f64::INFINITY };
    let implicit = ImplicitLoop::new(plant, controller);
    let agreed = |omega| {
        let response = closed_loop.at(omega).ok()?;
        Some((implicit.response(omega)? - response).norm() <= AGREED * peak.value)
    };
    match (agreed(at_peak), agreed(slowest)) {
        (Some(true), Some(true)) => return Ok(*peak),
        (None, _) | (_, None) => return Err(lost),
        _ => {}
    }
    let mut frequencies = vec![0.0, at_peak, BEYOND * fastest];
    frequencies.extend(poles.iter().flat_map(|pole| [pole.norm(), pole.im.abs()]));
    let step = (fastest / slowest).powf(1.0 / GRID as f64);
    frequencies.extend((0..GRID).map(|k| slowest * step.powi(k)));
    frequencies.sort_by(f64::total_cmp);
    frequencies.dedup_by(|a, b| *a <= *b * (1.0 + APART));
    let seen: Vec<Look> = frequencies.iter().filter_map(|omega| implicit.at(*omega)).collect();
    let top = implicit.highest(&seen).ok_or(lost.clone())?;
    let exact = |omega| implicit.gain_doubled(omega).ok_or(lost.clone());
    let (at_new, at_old) = (exact(top.omega_rad_s)?, exact(at_peak)?);
    let value = at_new.max(at_old);
    // By how much the two ways of evaluating the loop disagree on its norm.
    let loss = (peak.value - value).abs().max((top.gain - at_new).abs());
    if loss > LOSS_MAX * value.max(NOTHING * implicit.open_gain(top.omega_rad_s)) {
        return Err(Error::IllConditioned { gamma, achieved: value });
    }
    Ok(PeakGain {
        value,
        omega_rad_s: if at_new >= at_old { top.omega_rad_s } else { peak.omega_rad_s },
        lower: value - loss.min(value),
        upper: value.max(peak.upper) + loss,
    })
}

/// A gain of the implicit loop.
#[derive(Clone, Copy)]
struct Look {
    omega_rad_s: f64,
    gain: f64,
}

/// Plant and controller in one set of equations.
///
/// ```text
///     [ s I - A          -B2        ] [ x  ]   [ B1  ]
///     [         s I - AK       -BK  ] [ xK ] = [  0  ] w        z = C1 x + D12 u + D11 w
///     [          -CK      I    -DK  ] [ u  ]   [  0  ]
///     [ -C2              -D22   I   ] [ y  ]   [ D21 ]
/// ```
struct ImplicitLoop {
    /// The coefficients without `s`.
    matrix: DMatrix<f64>,
    /// The first so many unknowns are states.
    n_states: usize,
    right: DMatrix<f64>,
    outputs: DMatrix<f64>,
    direct: DMatrix<f64>,
    plant: StateSpace<Continuous>,
}

impl ImplicitLoop {
    fn new(plant: &GeneralizedPlant, controller: &StateSpace<Continuous>) -> Self {
        let (n, n_k, n_u, n_y) = (plant.n_states(), controller.n_states(), plant.n_u(), plant.n_y());
        let (k, u, y) = (n, n + n_k, n + n_k + n_u);
        let size = y + n_y;
        let mut matrix = DMatrix::zeros(size, size);
        let mut set = |at: (usize, usize), m: &DMatrix<f64>| matrix.view_mut(at, m.shape()).copy_from(&-m);
        set((0, 0), &plant.a());
        set((0, u), &plant.b2());
        set((k, k), controller.a());
        set((k, y), controller.b());
        set((u, k), controller.c());
        set((u, u), &-DMatrix::identity(n_u, n_u));
        set((u, y), controller.d());
        set((y, 0), &plant.c2());
        set((y, u), &plant.d22());
        set((y, y), &-DMatrix::identity(n_y, n_y));
        let mut right = DMatrix::zeros(size, plant.n_w());
        right.rows_mut(0, n).copy_from(&plant.b1());
        right.rows_mut(y, n_y).copy_from(&plant.d21());
        let mut outputs = DMatrix::zeros(plant.n_z(), size);
        outputs.columns_mut(0, n).copy_from(&plant.c1());
        outputs.columns_mut(u, n_u).copy_from(&plant.d12());
        Self { matrix, n_states: n + n_k, right, outputs, direct: plant.d11(), plant: plant.sys().clone() }
    }

    /// Powers of two that bring rows and columns of the equations at a frequency to like size.
    fn equilibration(&self, omega_rad_s: f64) -> (Vec<f64>, Vec<f64>) {
        let mut sizes = self.matrix.abs();
        for i in 0..self.n_states {
            sizes[(i, i)] += omega_rad_s;
        }
        let size = sizes.nrows();
        let (mut rows, mut cols) = (vec![1.0; size], vec![1.0; size]);
        for _ in 0..EQUILIBRATION_SWEEPS {
            for (i, row) in rows.iter_mut().enumerate() {
                let unit = unit_below(sizes.row(i).max());
                sizes.row_mut(i).scale_mut(unit);
                *row *= unit;
            }
            for (j, col) in cols.iter_mut().enumerate() {
                let unit = unit_below(sizes.column(j).max());
                sizes.column_mut(j).scale_mut(unit);
                *col *= unit;
            }
        }
        (rows, cols)
    }

    /// The coefficients, right-hand sides and outputs in scaled rows and columns, and the weights of `s`.
    fn scaled(&self, omega_rad_s: f64) -> Scaled {
        let (rows, cols) = self.equilibration(omega_rad_s);
        Scaled {
            matrix: self.matrix.map_with_location(|i, j, v| v * rows[i] * cols[j]),
            omega: (0..self.n_states).map(|i| omega_rad_s * rows[i] * cols[i]).collect(),
            right: self.right.map_with_location(|i, _, v| v * rows[i]),
            outputs: self.outputs.map_with_location(|_, j, v| v * cols[j]),
        }
    }

    /// The response from `w` to `z`; `None` where the equations are singular.
    fn response(&self, omega_rad_s: f64) -> Option<DMatrix<Complex64>> {
        let scaled = self.scaled(omega_rad_s);
        let mut matrix = scaled.matrix.map(Complex64::from);
        for (i, omega) in scaled.omega.iter().enumerate() {
            matrix[(i, i)].im = *omega;
        }
        let x = matrix.lu().solve(&scaled.right.map(Complex64::from))?;
        let response = scaled.outputs.map(Complex64::from) * x + self.direct.map(Complex64::from);
        response.iter().all(|v| v.is_finite()).then_some(response)
    }

    /// The largest gain, from equations in real and imaginary parts that are solved in doubled precision.
    fn gain_doubled(&self, omega_rad_s: f64) -> Option<f64> {
        let scaled = self.scaled(omega_rad_s);
        let (size, n_w) = scaled.right.shape();
        let mut matrix = DMatrix::zeros(2 * size, 2 * size);
        matrix.view_mut((0, 0), (size, size)).copy_from(&scaled.matrix);
        matrix.view_mut((size, size), (size, size)).copy_from(&scaled.matrix);
        for (i, omega) in scaled.omega.iter().enumerate() {
            matrix[(i, size + i)] = -omega;
            matrix[(size + i, i)] = *omega;
        }
        let mut right = DMatrix::zeros(2 * size, n_w);
        right.rows_mut(0, size).copy_from(&scaled.right);
        let exact = |m: &DMatrix<f64>| DoubledMatrix::from(m);
        let x = exact(&matrix).solve(&exact(&right))?;
        let part = |start| exact(&scaled.outputs).times(&x.block((start, 0), (size, n_w)));
        let (re, im) = (part(0).plus(&exact(&self.direct)).rounded(), part(size).rounded());
        Some(largest_gain(&re.zip_map(&im, Complex64::new)))
    }

    fn at(&self, omega_rad_s: f64) -> Option<Look> {
        Some(Look { omega_rad_s, gain: largest_gain(&self.response(omega_rad_s)?) })
    }

    /// The highest gain between the neighbours of the highest few, by golden sections.
    fn highest(&self, seen: &[Look]) -> Option<Look> {
        let mut order: Vec<usize> = (0..seen.len()).collect();
        order.sort_by(|i, j| seen[*j].gain.total_cmp(&seen[*i].gain));
        let mut best = *seen.get(*order.first()?)?;
        for &k in order.iter().take(PEAKS_MAX) {
            let mut left = seen[k.saturating_sub(1)].omega_rad_s;
            let mut right = seen.get(k + 1).map_or(2.0 * seen[k].omega_rad_s, |look| look.omega_rad_s);
            for _ in 0..SECTIONS_MAX {
                let width = right - left;
                if width <= SECTION_MIN * right {
                    break;
                }
                let points = [right - GOLDEN * width, left + GOLDEN * width].map(|omega| self.at(omega));
                let [Some(low), Some(high)] = points else { break };
                if low.gain > high.gain {
                    right = high.omega_rad_s;
                } else {
                    left = low.omega_rad_s;
                }
                for look in [low, high] {
                    if look.gain > best.gain {
                        best = look;
                    }
                }
            }
        }
        Some(best)
    }

    /// Size of what the loop has to cancel: the gain of the plant from `w` to `z`.
    fn open_gain(&self, omega_rad_s: f64) -> f64 {
        let (n_z, n_w) = self.direct.shape();
        self.plant.at(omega_rad_s).map_or(0.0, |p| largest_gain(&p.view((0, 0), (n_z, n_w)).into_owned()))
    }
}

/// The equations of [`ImplicitLoop`] at one frequency.
struct Scaled {
    matrix: DMatrix<f64>,
    omega: Vec<f64>,
    right: DMatrix<f64>,
    outputs: DMatrix<f64>,
}

fn largest_gain(response: &DMatrix<Complex64>) -> f64 {
    match response.len() {
        0 => 0.0,
        1 => response[(0, 0)].norm(),
        _ => response.singular_values().max(),
    }
}

/// One over the power of two next to a size, 1 for 0.
fn unit_below(size: f64) -> f64 {
    if size > 0.0 && size.is_finite() { (-size.log2().round().clamp(-500.0, 500.0)).exp2() } else { 1.0 }
}

/// Relative difference of the two responses that needs no further look.
const AGREED: f64 = 1e-9;
/// Relative difference of the two norms beyond which the loop as formed is another one.
const LOSS_MAX: f64 = 1e-3;
/// Part of the plant's own gain below which a norm is nothing but rounding.
const NOTHING: f64 = 1e-9;
/// Frequencies between the slowest and the fastest pole that are looked at besides those of the poles.
const GRID: i32 = 40;
/// Times the fastest pole, a frequency that is as good as infinite.
const BEYOND: f64 = 1e6;
/// Relative distance of frequencies that are looked at.
const APART: f64 = 1e-3;
/// Peaks that are followed.
const PEAKS_MAX: usize = 3;
/// Golden sections of one: each leaves 0.62 of the width.
const SECTIONS_MAX: usize = 40;
/// Relative width that is narrow enough: the gain at a peak is flat.
const SECTION_MIN: f64 = 1e-6;
/// Ratio of the golden section.
const GOLDEN: f64 = 0.618_033_988_749_894_9;
/// Passes over rows and columns.
const EQUILIBRATION_SWEEPS: usize = 3;

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;
    use telepulse_lti::hinf_norm::hinf_norm_and_poles;

    fn matrix(value: &Value, key: &str) -> DMatrix<f64> {
        let rows: Vec<Vec<f64>> = serde_json::from_value(value[key].clone()).expect("rows");
        DMatrix::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j])
    }

    fn system(value: &Value) -> StateSpace<Continuous> {
        let [a, b, c, d] = ["A", "B", "C", "D"].map(|key| matrix(value, key));
        StateSpace::<Continuous>::new(a, b, c, d).expect("shapes")
    }

    #[test]
    fn oracle_a_norm_is_within_a_thousandth_of_240_bit_arithmetic_or_refused() {
        let file = include_str!("../../../../testdata/hinfsyn/lossy_loops.json");
        let file: Value = serde_json::from_str(file).expect("json");
        let (mut n_refused, mut n_mended) = (0, 0);
        for case in file["loops"].as_array().expect("a list") {
            let size = |key: &str| case[key].as_u64().expect("a count") as usize;
            let (n_w, n_u, n_z, n_y) = (size("nw"), size("nu"), size("nz"), size("ny"));
            let plant = GeneralizedPlant::new(system(&case["plant"]), n_w, n_u, n_z, n_y).expect("ports");
            let controller = system(&case["controller"]);
            let sys = plant.lower_lft(&controller).expect("well posed");
            let (peak, poles) = hinf_norm_and_poles(&sys).expect("stable");
            let (id, exact) = (&case["id"], case["norm"].as_f64().expect("a number"));
            let loss = (peak.value / exact - 1.0).abs();
            match measured(&plant, &controller, &FormedLoop { sys, poles, peak }, 1.0) {
                Ok(found) => {
                    let error = (found.value / exact - 1.0).abs();
                    // The gain is exact to rounding, its frequency is not: it comes from responses in working precision, whose
                    // noise hides how flat the peak is. 1.3e-6 was seen; a thousandth is promised.
                    assert!(error < 1e-5, "{id}: {found:?} is not {exact}");
                    assert!(found.lower <= exact && exact <= found.upper * (1.0 + 1e-9), "{id}: {found:?}");
                    n_mended += usize::from(loss > 1e-5);
                }
                Err(Error::IllConditioned { .. }) => {
                    // Refused only where the norm of the formed loop really is another one.
                    assert!(loss > 0.5 * LOSS_MAX, "{id}: refused though off by {loss}");
                    n_refused += 1;
                }
                Err(other) => panic!("{id}: {other}"),
            }
        }
        assert!(n_refused >= 3 && n_mended >= 3, "{n_refused} refused, {n_mended} mended");
    }
}
