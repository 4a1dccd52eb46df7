//! Time of every route to fewer states, over the number of states.
//!
//! `cargo bench -p telepulse-lti --bench reduction` takes about twenty seconds. Random stable systems of two inputs and two
//! outputs from one seed.

#![allow(missing_docs)]

use std::hint::black_box;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use nalgebra::DMatrix;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use telepulse_lti::reduce::{
    OrderRule, ReduceOptions, Removal, hankel_approximation, minimal_realization, reduce,
};
use telepulse_lti::{Continuous, StateSpace};

const SIZES: [usize; 4] = [5, 10, 20, 50];
const SEED: u64 = 11;

type System = StateSpace<Continuous>;

/// Systems with `n` states; of `redundant`, the last fifth (rounded up) is not reached by the inputs.
struct Problem {
    n: usize,
    minimal: System,
    redundant: System,
}

impl Problem {
    fn new(n: usize) -> Self {
        let mut rng = Pcg64::seed_from_u64(SEED + n as u64);
        let mut matrix = |rows, cols| DMatrix::from_fn(rows, cols, |_, _| rng.random_range(-1.0..1.0));
        // The spectrum is in a disk of radius one around -1.5.
        let shift = DMatrix::identity(n, n) * 1.5;
        let mut a: DMatrix<f64> = matrix(n, n) * (3.0 / n as f64).sqrt() - shift;
        let (mut b, c): (DMatrix<f64>, DMatrix<f64>) = (matrix(n, 2), matrix(2, n));
        let d = DMatrix::zeros(2, 2);
        let minimal = System::new(a.clone(), b.clone(), c.clone(), d.clone()).expect("shapes fit");
        let reached = n - n.div_ceil(5);
        b.rows_mut(reached, n - reached).fill(0.0);
        a.view_mut((reached, 0), (n - reached, reached)).fill(0.0);
        // An orthogonal change of coordinates hides which states those are.
        let q: DMatrix<f64> = matrix(n, n).qr().q();
        let redundant =
            System::new(&q * a * q.transpose(), &q * b, c * q.transpose(), d).expect("shapes fit");
        Self { n, minimal, redundant }
    }

    fn half(&self) -> OrderRule {
        OrderRule::Count(self.n / 2)
    }

    fn reached(&self) -> usize {
        self.n - self.n.div_ceil(5)
    }
}

fn over_sizes(criterion: &mut Criterion, name: &str, mut solve: impl FnMut(&Problem) -> bool) {
    let mut group = criterion.benchmark_group(name);
    group
        .sample_size(10)
        .warm_up_time(Duration::from_millis(100))
        .measurement_time(Duration::from_millis(500));
    for n in SIZES {
        let problem = Problem::new(n);
        assert!(solve(&problem), "{name} has no answer for n = {n}");
        group.bench_with_input(BenchmarkId::from_parameter(n), &problem, |bencher, problem| {
            bencher.iter(|| black_box(solve(black_box(problem))));
        });
    }
    group.finish();
}

fn reduction(criterion: &mut Criterion) {
    over_sizes(criterion, "reduce_truncate", |p| {
        reduce(&p.minimal, &ReduceOptions::new(p.half())).is_ok_and(|r| r.sys.n_states() == p.n / 2)
    });
    over_sizes(criterion, "reduce_residualize", |p| {
        let options = ReduceOptions { removal: Removal::Residualize, ..ReduceOptions::new(p.half()) };
        reduce(&p.minimal, &options).is_ok_and(|r| r.sys.n_states() == p.n / 2)
    });
    over_sizes(criterion, "hankel_approximation", |p| hankel_approximation(&p.minimal, p.half()).is_ok());
    over_sizes(criterion, "minimal_realization", |p| {
        minimal_realization(&p.redundant, None).is_ok_and(|r| r.sys.n_states() == p.reached())
    });
}

criterion_group!(benches, reduction);
criterion_main!(benches);
