//! Minimal realisation by orthogonal staircase forms.

use nalgebra::DMatrix;

use crate::zeros::row_compression;
use crate::{Error, StateSpace, TimeDomain};

/// A system without states that no input moves or no output sees.
#[derive(Debug, Clone, PartialEq)]
pub struct MinimalRealization<D: TimeDomain> {
    /// The system.
    pub sys: StateSpace<D>,
    /// States removed because no input moves them.
    pub n_uncontrollable: usize,
    /// States removed, of those left, because no output sees them.
    pub n_unobservable: usize,
    /// The tolerance that decided, relative to the norm of the state matrix.
    pub tolerance: f64,
    /// Largest change of the response over the frequencies examined, relative to its largest value there.
    pub response_error: f64,
}

/// The part of a system that its ports see, stable or not.
///
/// **Shapes and units**: `tolerance` is relative to the norm of `A` after balancing, with `B` and `C` scaled to that norm; `None`
/// means `100 n² eps`, the rounding of the transformations and what a staircase with weak steps makes of it.
///
/// **Method**: controllability staircase by orthogonal compressions, then the same for the transposed system on what is left. The
/// response before and after is compared at 200 frequencies around the poles.
///
/// **Source**: Van Dooren 1981, "The generalized eigenstructure problem in linear system theory", IEEE Trans. Autom.
/// Control 26(1), 111-129.
///
/// **Accuracy**: a rank decision depends on the tolerance; near-cancellations above it are left in, and [`super::reduce()`] can tell
/// what their removal costs.
///
/// **Errors**: [`Error::ReductionSetting`] for a tolerance that is negative or not below one.
///
/// **Example**: a cancelled pole, unstable at that.
/// ```
/// use telepulse_lti::{TransferFunction, reduce::minimal_realization};
/// let sys = TransferFunction::new(&[1.0, -1.0], &[1.0, 1.0, -2.0])?.to_state_space();
/// let done = minimal_realization(&sys, None)?;
/// assert_eq!((done.sys.n_states(), done.n_uncontrollable + done.n_unobservable), (1, 1));
/// assert!((done.sys.poles()?[0].re + 2.0).abs() < 1e-13);
/// # Ok::<(), telepulse_lti::Error>(())
/// ```
pub fn minimal_realization<D: TimeDomain>(
    sys: &StateSpace<D>,
    tolerance: Option<f64>,
) -> Result<MinimalRealization<D>, Error> {
    let n = sys.n_states();
    let tolerance = tolerance.unwrap_or(100.0 * (n * n) as f64 * f64::EPSILON);
    if !(0.0..1.0).contains(&tolerance) {
        let (setting, allowed) = ("tolerance", "from 0 to below 1");
        return Err(Error::ReductionSetting { setting, found: tolerance, allowed });
    }
    let balanced = sys.balanced();
    let first = controllable_part(balanced.a(), balanced.b(), balanced.c(), tolerance);
    let second =
        controllable_part(&first.a.transpose(), &first.c.transpose(), &first.b.transpose(), tolerance);
    let small = StateSpace::with_domain(
        second.a.transpose(),
        second.c.transpose(),
        second.b.transpose(),
        sys.d().clone(),
        *sys.domain(),
    )?;
    Ok(MinimalRealization {
        n_uncontrollable: n - first.a.nrows(),
        n_unobservable: first.a.nrows() - second.a.nrows(),
        tolerance,
        response_error: response_error(sys, &small)?,
        sys: small,
    })
}

struct Part {
    a: DMatrix<f64>,
    b: DMatrix<f64>,
    c: DMatrix<f64>,
}

/// The leading block of the controllability staircase.
fn controllable_part(a: &DMatrix<f64>, b: &DMatrix<f64>, c: &DMatrix<f64>, tolerance: f64) -> Part {
    let n = a.nrows();
    let (mut a, mut b, mut c) = (a.clone(), b.clone(), c.clone());
    let norm = a.norm().max(f64::MIN_POSITIVE);
    let input_norm = b.norm();
    let mut n_found = 0;
    let mut step = if input_norm > 0.0 { &b * (norm / input_norm) } else { b.clone() };
    // Each pass finds at least one state or ends.
    while n_found < n {
        let rest = n - n_found;
        let (u, rank) = row_compression(&step, tolerance * norm);
        if rank == 0 {
            break;
        }
        let rows = u.tr_mul(&a.rows(n_found, rest));
        a.rows_mut(n_found, rest).copy_from(&rows);
        let columns = a.columns(n_found, rest) * &u;
        a.columns_mut(n_found, rest).copy_from(&columns);
        let rows = u.tr_mul(&b.rows(n_found, rest));
        b.rows_mut(n_found, rest).copy_from(&rows);
        let columns = c.columns(n_found, rest) * &u;
        c.columns_mut(n_found, rest).copy_from(&columns);
        step = a.view((n_found + rank, n_found), (rest - rank, rank)).into_owned();
        n_found += rank;
    }
    Part {
        a: a.view((0, 0), (n_found, n_found)).into_owned(),
        b: b.rows(0, n_found).into_owned(),
        c: c.columns(0, n_found).into_owned(),
    }
}

fn response_error<D: TimeDomain>(full: &StateSpace<D>, small: &StateSpace<D>) -> Result<f64, Error> {
    let domain = full.domain();
    let sizes: Vec<f64> = full.poles()?.iter().map(|p| p.norm()).filter(|&size| size > 0.0).collect();
    let (low, high) = match domain.sample_time_of() {
        Some(ts) => (1e-5 * ts.nyquist_rad_s(), ts.nyquist_rad_s()),
        None => {
            let slowest = sizes.iter().copied().fold(f64::INFINITY, f64::min);
            let fastest = sizes.iter().copied().fold(0.0, f64::max);
            if sizes.is_empty() { (0.1, 10.0) } else { (0.1 * slowest, 10.0 * fastest) }
        }
    };
    let (mut largest, mut worst): (f64, f64) = (0.0, 0.0);
    for k in 0..FREQUENCIES {
        // Off round numbers, where poles on the axis like to be.
        let omega = 0.987 * low * (high / low).powf(f64::from(k) / f64::from(FREQUENCIES - 1));
        let (Ok(expected), Ok(found)) = (full.at(omega), small.at(omega)) else { continue };
        largest = largest.max(expected.norm());
        worst = worst.max((expected - found).norm());
    }
    Ok(if largest > 0.0 { worst / largest } else { worst })
}

const FREQUENCIES: i32 = 200;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reduce::testing;
    use crate::{Continuous, TransferFunction};

    #[test]
    fn law_hidden_states_are_found_and_the_response_stays() {
        for seed in 0..40 {
            let core = testing::continuous(seed, 1 + seed as usize % 6, 2, 2);
            // Two states that no input moves, one that no output sees, mixed by a random similarity; unstable for odd seeds.
            let n = core.n_states();
            let extra = testing::continuous(seed + 99, n + 3, n + 3, 3);
            let mut a = DMatrix::zeros(n + 3, n + 3);
            a.view_mut((0, 0), (n, n)).copy_from(core.a());
            for (k, pole) in [-3.3, 2.0, -50.0].into_iter().enumerate() {
                a[(n + k, n + k)] = pole;
            }
            // The uncontrollable states act on the core; the unobservable one is acted on.
            a.view_mut((0, n), (n, 2)).copy_from(&extra.b().view((0, 0), (n, 2)));
            a.view_mut((n + 2, 0), (1, n + 2)).copy_from(&extra.b().view((0, 0), (1, n + 2)));
            let (b, c) = (
                core.b().clone().resize_vertically(n + 3, 0.0),
                core.c().clone().resize_horizontally(n + 3, 0.0),
            );
            let mut b = b;
            b[(n + 2, 0)] = 1.7;
            let q = extra.b().clone().qr().q();
            let moved = StateSpace::<Continuous>::new(
                q.transpose() * a * &q,
                q.transpose() * b,
                c * &q,
                core.d().clone(),
            );
            let done = minimal_realization(&moved.expect("shapes"), None).expect("finite");
            assert_eq!(done.sys.n_states(), n, "seed {seed}: {done:?}");
            assert_eq!((done.n_uncontrollable, done.n_unobservable), (2, 1), "seed {seed}");
            assert!(done.response_error < 1e-10, "seed {seed}: {:e}", done.response_error);
            for omega in [0.0, 2.0, 30.0] {
                let off = (done.sys.at(omega).expect("stable") - core.at(omega).expect("stable")).norm();
                assert!(off < 1e-9 * (1.0 + core.at(omega).expect("stable").norm()), "seed {seed}: {off:e}");
            }
        }
    }

    #[test]
    fn law_units_of_time_and_ports_do_not_matter() {
        let sys = TransferFunction::new(&[1.0, 3.0], &[1.0, 7.0, 12.0]).expect("proper").to_state_space();
        for (time, gain) in [(1e-9, 1.0), (1e9, 1e12), (1.0, 1e-15)] {
            let (a, b) = (sys.a() * time, sys.b() * time);
            let scaled = StateSpace::<Continuous>::new(a, b, sys.c() * gain, sys.d() * gain).expect("shapes");
            assert_eq!(
                minimal_realization(&scaled, None).expect("finite").sys.n_states(),
                1,
                "{time} {gain}"
            );
        }
    }

    #[test]
    fn edge_nothing_left_nothing_to_do_and_bad_tolerances() {
        let silent = StateSpace::<Continuous>::new(
            nalgebra::dmatrix![2.0],
            nalgebra::dmatrix![0.0],
            nalgebra::dmatrix![1.0],
            nalgebra::dmatrix![0.5],
        );
        let done = minimal_realization(&silent.expect("shapes"), None).expect("finite");
        assert_eq!((done.sys.n_states(), done.n_uncontrollable), (0, 1));
        let gain = StateSpace::<Continuous>::from_gain(nalgebra::dmatrix![2.0]).expect("port");
        assert_eq!(minimal_realization(&gain, None).expect("finite").sys, gain);
        for tolerance in [-1.0, 1.0, f64::NAN] {
            assert!(matches!(
                minimal_realization(&gain, Some(tolerance)),
                Err(Error::ReductionSetting { .. })
            ));
        }
    }
}
