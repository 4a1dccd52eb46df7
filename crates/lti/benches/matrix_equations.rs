//! Time of every solver of a matrix equation, and of the norm, over the number of states.
//!
//! `cargo bench -p telepulse-lti` runs all of it in about two minutes; `-- care` only what contains that word. Random
//! matrices from one seed; `benches/versus_slycot_equations.py` times the same sizes with a peer.

#![allow(missing_docs)]

use std::hint::black_box;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use nalgebra::DMatrix;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use telepulse_lti::eigenvalues::eigenvalues;
use telepulse_lti::riccati::{self, SecondRoute, Terms, care, dare};
use telepulse_lti::schur::RealSchur;
use telepulse_lti::{Continuous, StateSpace, hinf_norm, lyapunov, sylvester};

const SIZES: [usize; 5] = [5, 10, 20, 50, 100];
const SEED: u64 = 7;

/// A random problem of each size; `a` has its spectrum in a disk of radius one.
struct Problem {
    a: DMatrix<f64>,
    b: DMatrix<f64>,
    c: DMatrix<f64>,
    q: DMatrix<f64>,
    r: DMatrix<f64>,
    stable: DMatrix<f64>,
}

impl Problem {
    fn new(n: usize) -> Self {
        let mut rng = Pcg64::seed_from_u64(SEED + n as u64);
        let mut matrix = |rows, cols| DMatrix::from_fn(rows, cols, |_, _| rng.random_range(-1.0..1.0));
        let a: DMatrix<f64> = matrix(n, n) * (3.0 / n as f64).sqrt();
        let (b, c): (DMatrix<f64>, DMatrix<f64>) = (matrix(n, 2), matrix(2, n));
        let stable = &a - DMatrix::identity(n, n) * 1.5;
        let q = c.tr_mul(&c);
        Self { a, b, c, q, r: DMatrix::identity(2, 2), stable }
    }

    fn terms(&self) -> Terms<'_> {
        Terms { a: &self.stable, b: &self.b, q: &self.q, r: &self.r, s: None }
    }
}

fn over_sizes(criterion: &mut Criterion, name: &str, mut solve: impl FnMut(&Problem) -> bool) {
    let mut group = criterion.benchmark_group(name);
    group.sample_size(10).warm_up_time(Duration::from_millis(200)).measurement_time(Duration::from_secs(1));
    for n in SIZES {
        let problem = Problem::new(n);
        assert!(solve(&problem), "{name} has no answer for n = {n}");
        group.bench_with_input(BenchmarkId::from_parameter(n), &problem, |bencher, problem| {
            bencher.iter(|| black_box(solve(black_box(problem))));
        });
    }
    group.finish();
}

fn factorizations(criterion: &mut Criterion) {
    over_sizes(criterion, "eigenvalues", |p| eigenvalues(&p.a).is_ok());
    over_sizes(criterion, "schur", |p| RealSchur::new(&p.a).is_ok());
    over_sizes(criterion, "ordered_schur", |p| {
        RealSchur::new(&p.a).and_then(|s| s.order(|l| l.re < 0.0)).is_ok()
    });
}

fn linear_equations(criterion: &mut Criterion) {
    over_sizes(criterion, "lyapunov_continuous", |p| lyapunov::continuous(&p.stable, &p.q).is_ok());
    over_sizes(criterion, "lyapunov_discrete", |p| lyapunov::discrete(&p.a, &p.q).is_ok());
    over_sizes(criterion, "sylvester_continuous", |p| {
        sylvester::continuous(&p.stable, &p.stable, &p.q).is_ok()
    });
    over_sizes(criterion, "sylvester_discrete", |p| sylvester::discrete(&p.a, &p.stable, &p.q).is_ok());
}

fn riccati_equations(criterion: &mut Criterion) {
    over_sizes(criterion, "care", |p| care(&p.terms(), SecondRoute::IfNeeded).is_ok());
    over_sizes(criterion, "dare", |p| {
        let a = &p.a * 0.5;
        dare(&Terms { a: &a, ..p.terms() }, SecondRoute::IfNeeded).is_ok()
    });
    over_sizes(criterion, "care_both_routes", |p| care(&p.terms(), SecondRoute::Always).is_ok());
    over_sizes(criterion, "riccati_continuous", |p| {
        riccati::continuous(&p.stable, &(&p.b * p.b.transpose()), &p.q).is_ok()
    });
}

fn norms(criterion: &mut Criterion) {
    over_sizes(criterion, "hinf_norm", |p| {
        let d = DMatrix::zeros(2, 2);
        let sys = StateSpace::<Continuous>::new(p.stable.clone(), p.b.clone(), p.c.clone(), d);
        sys.and_then(|sys| hinf_norm(&sys)).is_ok()
    });
}

criterion_group!(benches, factorizations, linear_equations, riccati_equations, norms);
criterion_main!(benches);
