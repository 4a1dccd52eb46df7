//! Random systems for the tests of this folder; a seed names each.

use nalgebra::DMatrix;
use rand::{RngExt, SeedableRng};

use crate::{Continuous, Discrete, SampleTime, StateSpace};

/// A stable continuous system with poles over about two decades.
pub(crate) fn continuous(seed: u64, n: usize, n_u: usize, n_y: usize) -> StateSpace<Continuous> {
    let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
    let rates =
        DMatrix::from_fn(n, n, |i, j| if i == j { 10f64.powf(2.0 * i as f64 / n as f64) } else { 0.0 });
    let mut matrix = |r, c| DMatrix::from_fn(r, c, |_, _| rng.random_range(-1.0..1.0));
    let mut a = rates * matrix(n, n);
    let (b, c, d) = (matrix(n, n_u), matrix(n_y, n), matrix(n_y, n_u));
    let right =
        crate::eigenvalues::eigenvalues(&a).expect("finite").iter().fold(f64::MIN, |m, p| m.max(p.re));
    if n > 0 {
        a -= DMatrix::identity(n, n) * (right + 0.1);
    }
    StateSpace::<Continuous>::new(a, b, c, d).expect("shapes")
}

/// A stable discrete system with spectral radius 0.95.
pub(crate) fn discrete(seed: u64, n: usize, n_u: usize, n_y: usize) -> StateSpace<Discrete> {
    let mut rng = rand_pcg::Pcg64::seed_from_u64(seed + 10_000);
    let mut matrix = |r, c| DMatrix::from_fn(r, c, |_, _| rng.random_range(-1.0..1.0));
    let mut a = matrix(n, n);
    let (b, c, d) = (matrix(n, n_u), matrix(n_y, n), matrix(n_y, n_u));
    let radius =
        crate::eigenvalues::eigenvalues(&a).expect("finite").iter().fold(0.0, |m: f64, p| m.max(p.norm()));
    if radius > 0.0 {
        a *= 0.95 / radius;
    }
    StateSpace::<Discrete>::new(a, b, c, d, SampleTime::new(0.01).expect("positive")).expect("shapes")
}
