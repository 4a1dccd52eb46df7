//! A system brought into the form in which its response is cheap and accurate: no states that no port sees, balanced,
//! the direct term diagonal, the state matrix in Hessenberg form.

use nalgebra::DMatrix;
use num_complex::Complex64;

use crate::eigenvalues::eigenvalues;
use crate::{Error, StateSpace, TimeDomain};

/// The reduced system; its response has the same singular values as the one it was made from.
pub(super) struct Reduced {
    /// Balanced state matrix of the states that both an input and an output see, for the final evaluation.
    pub(super) balanced: DMatrix<f64>,
    /// Balanced input and output matrices, wide systems transposed: `n_u <= n_y`.
    pub(super) b: DMatrix<f64>,
    pub(super) c: DMatrix<f64>,
    pub(super) d: DMatrix<f64>,
    /// Upper Hessenberg state matrix with its input and output matrices.
    pub(super) hessenberg: DMatrix<f64>,
    pub(super) hessenberg_b: DMatrix<f64>,
    pub(super) hessenberg_c: DMatrix<f64>,
    /// Poles of these states.
    pub(super) poles: Vec<Complex64>,
    /// Sample time in seconds of a discrete system.
    pub(super) sample_time_s: Option<f64>,
}

impl Reduced {
    /// Also returns the poles of all states, those that no port sees included.
    pub(super) fn new<D: TimeDomain>(sys: &StateSpace<D>) -> Result<(Self, Vec<Complex64>), Error> {
        let kept = seen_states(sys.a(), sys.b(), sys.c());
        let all_kept = kept.len() == sys.n_states();
        let hidden_poles = if all_kept { Vec::new() } else { eigenvalues(sys.a())? };
        let part;
        let sys = if all_kept {
            sys
        } else {
            let a = sys.a().select_rows(&kept).select_columns(&kept);
            let (b, c) = (sys.b().select_rows(&kept), sys.c().select_columns(&kept));
            part = StateSpace::from_valid_parts(a, b, c, sys.d().clone(), *sys.domain());
            &part
        };
        let balanced_sys = sys.balanced();
        let wide = sys.n_inputs() > sys.n_outputs();
        let (balanced, b, c, d) = if wide {
            let s = &balanced_sys;
            (s.a().transpose(), s.c().transpose(), s.b().transpose(), s.d().transpose())
        } else {
            (
                balanced_sys.a().clone(),
                balanced_sys.b().clone(),
                balanced_sys.c().clone(),
                balanced_sys.d().clone(),
            )
        };
        let (mut hessenberg, mut hessenberg_b, mut hessenberg_c) = (balanced.clone(), b.clone(), c.clone());
        to_hessenberg(&mut hessenberg, &mut hessenberg_b, &mut hessenberg_c);
        // Not of the transpose: what is block triangular in the given order stays so.
        let poles = eigenvalues(balanced_sys.a())?;
        let all_poles = if all_kept { poles.clone() } else { hidden_poles };
        let sample_time_s = sys.domain().sample_time_of().map(crate::SampleTime::seconds);
        let reduced =
            Self { balanced, b, c, d, hessenberg, hessenberg_b, hessenberg_c, poles, sample_time_s };
        Ok((reduced, all_poles))
    }

    /// Distance of a pole from the stability boundary: relative to its size in continuous time, negative beyond it.
    pub(super) fn damping_of(&self, pole: Complex64) -> f64 {
        match self.sample_time_s {
            None if pole.re == 0.0 => 0.0,
            None => -pole.re / pole.norm(),
            Some(_) => 1.0 - pole.norm(),
        }
    }

    /// Half width of the resonance that a pole makes.
    pub(super) fn damping_width(&self, pole: Complex64) -> f64 {
        match self.sample_time_s {
            None => pole.re.abs(),
            Some(_) => (1.0 - pole.norm()).abs(),
        }
    }

    /// The pole whose resonance is closest to a frequency, in units of its width.
    pub(super) fn nearest_pole(&self, frequency: f64) -> Complex64 {
        let distance = |pole: &Complex64| (self.point(frequency) - pole).norm();
        let nearest = self.poles.iter().min_by(|x, y| distance(x).total_cmp(&distance(y)));
        nearest.copied().unwrap_or(Complex64::ZERO)
    }

    /// The resonance of every complex pair and the corner of every real pole, each with its half width.
    ///
    /// **Source**: Bruinsma and Steinbuch 1990 for the shift of a damped resonance.
    pub(super) fn start_frequencies(&self) -> Vec<(f64, f64)> {
        let mut starts: Vec<(f64, f64)> = Vec::with_capacity(self.poles.len());
        for &pole in self.poles.iter().filter(|p| p.im >= 0.0) {
            let width = self.damping_width(pole);
            let frequency = match self.sample_time_s {
                None => {
                    let damping = pole.re / pole.norm().max(f64::MIN_POSITIVE);
                    pole.norm() * (1.0 - 2.0 * damping * damping).max(0.25).sqrt()
                }
                Some(_) if pole.im == 0.0 => continue,
                Some(_) => pole.arg(),
            };
            let near = |&(known, other): &(f64, f64)| (known - frequency).abs() < 0.05 * width.min(other);
            if !starts.iter().any(near) {
                starts.push((frequency, width));
            }
        }
        starts
    }

    /// The point of the complex plane at a frequency: rad/s, or radians per sample in discrete time.
    pub(super) fn point(&self, frequency: f64) -> Complex64 {
        match self.sample_time_s {
            None => Complex64::new(0.0, frequency),
            // The Nyquist frequency is no floating point number, but its point is.
            Some(_) if frequency == std::f64::consts::PI => Complex64::new(-1.0, 0.0),
            Some(_) => Complex64::new(frequency.cos(), frequency.sin()),
        }
    }
}

/// Indices of the states that the inputs reach and that reach the outputs, through entries that are not zero.
fn seen_states(a: &DMatrix<f64>, b: &DMatrix<f64>, c: &DMatrix<f64>) -> Vec<usize> {
    let n = a.nrows();
    let mut reached: Vec<bool> = b.row_iter().map(|row| row.iter().any(|&v| v != 0.0)).collect();
    let mut seen: Vec<bool> = c.column_iter().map(|column| column.iter().any(|&v| v != 0.0)).collect();
    if reached.iter().chain(&seen).all(|&v| v) {
        return (0..n).collect();
    }
    spread(&mut reached, |from, to| a[(to, from)] != 0.0);
    spread(&mut seen, |from, to| a[(from, to)] != 0.0);
    (0..n).filter(|&i| reached[i] && seen[i]).collect()
}

/// Marks everything that `edge` connects to what is marked.
fn spread(marked: &mut [bool], edge: impl Fn(usize, usize) -> bool) {
    let mut open: Vec<usize> = (0..marked.len()).filter(|&i| marked[i]).collect();
    while let Some(from) = open.pop() {
        for (to, mark) in marked.iter_mut().enumerate() {
            if !*mark && edge(from, to) {
                *mark = true;
                open.push(to);
            }
        }
    }
}

/// Brings `A` to upper Hessenberg form by reflections that are applied to `B` and `C` as well.
///
/// **Source**: Golub and Van Loan 2013, algorithm 7.4.2.
fn to_hessenberg(a: &mut DMatrix<f64>, b: &mut DMatrix<f64>, c: &mut DMatrix<f64>) {
    let n = a.nrows();
    let mut v = vec![0.0; n];
    let mut w = vec![0.0; n];
    for k in 0..n.saturating_sub(2) {
        let below = &a.as_slice()[k * n + k + 2..(k + 1) * n];
        if below.iter().all(|&x| x == 0.0) {
            continue;
        }
        let v = &mut v[..n - k - 1];
        v.copy_from_slice(&a.as_slice()[k * n + k + 1..(k + 1) * n]);
        let scale = v.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        v.iter_mut().for_each(|x| *x /= scale);
        let norm = v.iter().map(|x| x * x).sum::<f64>().sqrt();
        let alpha = -norm.copysign(v[0]);
        v[0] -= alpha;
        let factor = 2.0 / v.iter().map(|x| x * x).sum::<f64>();
        let column = &mut a.as_mut_slice()[k * n..(k + 1) * n];
        column[k + 1] = alpha * scale;
        column[k + 2..].fill(0.0);
        reflect_rows(a, k + 1, k + 1, v, factor);
        reflect_rows(b, k + 1, 0, v, factor);
        reflect_columns(a, k + 1, v, factor, &mut w);
        reflect_columns(c, k + 1, v, factor, &mut w);
    }
}

/// `M <- (I - factor v vᵀ) M` on the rows from `top` and the columns from `left`.
fn reflect_rows(m: &mut DMatrix<f64>, top: usize, left: usize, v: &[f64], factor: f64) {
    let rows = m.nrows();
    for column in m.as_mut_slice().chunks_exact_mut(rows.max(1)).skip(left) {
        let part = &mut column[top..];
        let dot = factor * part.iter().zip(v).map(|(x, y)| x * y).sum::<f64>();
        part.iter_mut().zip(v).for_each(|(x, y)| *x -= dot * y);
    }
}

/// `M <- M (I - factor v vᵀ)` on the columns from `left`.
fn reflect_columns(m: &mut DMatrix<f64>, left: usize, v: &[f64], factor: f64, work: &mut Vec<f64>) {
    let rows = m.nrows();
    work.clear();
    work.resize(rows, 0.0);
    for (column, &x) in m.as_slice().chunks_exact(rows.max(1)).skip(left).zip(v) {
        work.iter_mut().zip(column).for_each(|(w, y)| *w += x * y);
    }
    for (column, &x) in m.as_mut_slice().chunks_exact_mut(rows.max(1)).skip(left).zip(v) {
        column.iter_mut().zip(&*work).for_each(|(y, w)| *y -= factor * x * w);
    }
}
