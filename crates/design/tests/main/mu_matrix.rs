//! Bounds of the structured singular value of one matrix.

use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use rand::{RngExt, SeedableRng};
use telepulse_design::Error;
use telepulse_design::uncertain::{
    Block, BlockStructure, BlockValue, MuBounds, MuLowerOptions, Perturbation, mu_bounds, mu_upper_bound,
};

type Rng = rand_pcg::Pcg64;

fn random(rng: &mut Rng, rows: usize, cols: usize) -> DMatrix<Complex64> {
    DMatrix::from_fn(rows, cols, |_, _| {
        Complex64::new(rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0))
    })
}

fn unitary(rng: &mut Rng, n: usize) -> DMatrix<Complex64> {
    random(rng, n, n).qr().q()
}

fn structure(blocks: &[Block]) -> BlockStructure {
    BlockStructure::new(blocks.to_vec()).expect("blocks with ports")
}

fn bounds(m: &DMatrix<Complex64>, structure: &BlockStructure) -> MuBounds {
    mu_bounds(m, structure, &MuLowerOptions::default()).expect("finite matrix")
}

const fn full(rows: usize, cols: usize) -> Block {
    Block::Full { rows, cols }
}

const fn real(size: usize) -> Block {
    Block::RepeatedReal { size }
}

const fn repeated(size: usize) -> Block {
    Block::RepeatedComplex { size }
}

fn assert_close(found: f64, expected: f64, relative: f64, what: &str) {
    assert!((found - expected).abs() <= relative * expected.abs(), "{what}: {found} against {expected}");
}

/// Structures with every kind of block, with the shape of the matrix that they close.
fn structures() -> Vec<BlockStructure> {
    vec![
        structure(&[full(1, 1); 2]),
        structure(&[full(1, 1); 3]),
        structure(&[full(1, 1); 5]),
        structure(&[full(2, 3), full(1, 2)]),
        structure(&[full(2, 1), full(1, 1), full(1, 3)]),
        structure(&[repeated(2), full(2, 2)]),
        structure(&[repeated(2), repeated(2)]),
        structure(&[real(1), full(1, 1)]),
        structure(&[real(2), full(2, 1)]),
        structure(&[real(1), real(1), repeated(1), full(1, 2)]),
        structure(&[real(1), real(2), repeated(2)]),
    ]
}

#[test]
fn law_one_full_block_gives_the_largest_singular_value() {
    let mut rng = Rng::seed_from_u64(31);
    for (rows, cols) in [(1, 1), (2, 2), (3, 1), (1, 4), (4, 3)] {
        let m = random(&mut rng, cols, rows);
        let sigma = m.singular_values().max();
        let found = bounds(&m, &structure(&[full(rows, cols)]));
        assert_close(found.upper.value, sigma, 1e-12, "upper");
        assert_close(found.lower.value, sigma, 1e-12, "lower");
    }
}

#[test]
fn law_one_repeated_complex_scalar_gives_the_spectral_radius() {
    let mut rng = Rng::seed_from_u64(32);
    for n in 1..=5 {
        for _ in 0..5 {
            // A similarity of a known diagonal: no eigenvalue solver on this side of the comparison.
            let values: Vec<Complex64> = random(&mut rng, n, 1).iter().copied().collect();
            let t = DMatrix::identity(n, n) + random(&mut rng, n, n) * Complex64::new(0.4, 0.0);
            let inverse = t.clone().try_inverse().expect("near the identity");
            let m = t * DMatrix::from_diagonal(&DVector::from_vec(values.clone())) * inverse;
            let radius = values.iter().map(|v| v.norm()).fold(0.0, f64::max);
            let found = bounds(&m, &structure(&[repeated(n)]));
            assert_close(found.upper.value, radius, 1e-6, "upper");
            assert_close(found.lower.value, radius, 1e-9, "lower");
        }
    }
}

#[test]
fn law_multiples_of_the_identity_have_their_size_in_every_structure() {
    for blocks in [vec![full(1, 1); 4], vec![repeated(4)], vec![full(2, 2), repeated(2)], vec![full(4, 4)]] {
        let m = DMatrix::identity(4, 4) * Complex64::from_polar(2.5, 0.7);
        let found = bounds(&m, &structure(&blocks));
        assert_close(found.upper.value, 2.5, 1e-8, "upper");
        assert_close(found.lower.value, 2.5, 1e-12, "lower");
    }
    for blocks in [vec![real(4)], vec![real(1), real(3)], vec![real(2), full(2, 2)]] {
        let m = DMatrix::identity(4, 4) * Complex64::new(-2.5, 0.0);
        let found = bounds(&m, &structure(&blocks));
        assert_close(found.upper.value, 2.5, 1e-8, "real upper");
        assert_close(found.lower.value, 2.5, 1e-12, "real lower");
    }
}

#[test]
fn law_rank_one_with_complex_blocks_has_its_closed_form() {
    // det(I - a bᴴ Delta) = 1 - bᴴ Delta a vanishes first where every block turns its part of a onto its part of b.
    let mut rng = Rng::seed_from_u64(33);
    let blocks = [full(1, 1), full(2, 3), full(1, 2), full(2, 1)];
    for _ in 0..20 {
        let (a, b) = (random(&mut rng, 7, 1), random(&mut rng, 6, 1));
        let m = &a * b.adjoint();
        let (mut row, mut col, mut expected) = (0, 0, 0.0);
        for block in &blocks {
            expected += b.rows(row, block.rows()).norm() * a.rows(col, block.cols()).norm();
            (row, col) = (row + block.rows(), col + block.cols());
        }
        let found = bounds(&m, &structure(&blocks));
        assert_close(found.upper.value, expected, 1e-8, "upper");
        assert_close(found.lower.value, expected, 1e-8, "lower");
    }
}

#[test]
fn law_rank_one_with_one_parameter_has_its_closed_form() {
    // 1 = delta c + e with |e| <= r: for |delta| <= t the real part reaches t c' + sqrt(r² t² - ...), maximised on a fine grid.
    let mut rng = Rng::seed_from_u64(34);
    for _ in 0..20 {
        let (a, b) = (random(&mut rng, 2, 1), random(&mut rng, 2, 1));
        let m = &a * b.adjoint();
        let c = b[0].conj() * a[0];
        let r = (b[1].conj() * a[1]).norm();
        let mut expected = 0.0_f64;
        let count = 200_000;
        for k in 0..=count {
            let delta = -1.0 + 2.0 * f64::from(k) / f64::from(count);
            let rest = r * r - (delta * c.im).powi(2);
            if rest >= 0.0 {
                expected = expected.max(delta * c.re + rest.sqrt());
            }
        }
        let found = bounds(&m, &structure(&[real(1), full(1, 1)]));
        assert_close(found.upper.value, expected, 1e-6, "upper");
        assert_close(found.lower.value, expected, 1e-6, "lower");
    }
}

#[test]
fn law_three_complex_blocks_leave_no_gap() {
    let mut rng = Rng::seed_from_u64(35);
    for blocks in
        [vec![full(1, 1); 3], vec![full(2, 2), full(1, 3), full(2, 1)], vec![repeated(2), full(2, 2)]]
    {
        let s = structure(&blocks);
        for trial in 0..20 {
            let m = random(&mut rng, s.n_z(), s.n_w());
            let found = bounds(&m, &s);
            let what = format!("seed 35 trial {trial} {blocks:?}");
            assert_close(found.lower.value, found.upper.value, 1e-6, &what);
        }
    }
}

#[test]
fn law_the_lower_bound_is_shown_by_its_perturbation_and_below_the_upper_bound() {
    let mut rng = Rng::seed_from_u64(36);
    for s in structures() {
        for trial in 0..10 {
            let m = random(&mut rng, s.n_z(), s.n_w());
            let found = bounds(&m, &s);
            assert!(found.lower.value <= found.upper.value * (1.0 + 1e-9), "seed 36 trial {trial} {s:?}");
            assert!(found.upper.scalings.prove(&m, &s, found.upper.value).expect("fits"), "{s:?}");
            if let Some(p) = &found.lower.perturbation {
                let delta = p.matrix(&s).expect("fits");
                assert_close(1.0 / p.norm(), found.lower.value, 1e-12, "size");
                let determinant = (DMatrix::identity(s.n_z(), s.n_z()) - &m * delta).determinant();
                assert!(determinant.norm() < 1e-9, "seed 36 trial {trial} {s:?}: {determinant}");
            }
        }
    }
}

#[test]
fn law_no_random_perturbation_beats_the_upper_bound() {
    // An admissible perturbation of size one has no real positive eigenvalue of M Delta above the bound; complex structures
    // have no eigenvalue at all above it.
    let mut rng = Rng::seed_from_u64(37);
    for s in structures() {
        let m = random(&mut rng, s.n_z(), s.n_w());
        let upper = mu_upper_bound(&m, &s).expect("finite").value;
        for trial in 0..400 {
            let values = s.blocks().iter().map(|block| match *block {
                Block::RepeatedReal { .. } => BlockValue::Real(rng.random_range(-1.0..=1.0)),
                Block::RepeatedComplex { .. } => {
                    BlockValue::Complex(Complex64::from_polar(1.0, rng.random_range(0.0..6.3)))
                }
                Block::Full { rows, cols } => {
                    let (u, v) =
                        (random(&mut rng, rows, 1).normalize(), random(&mut rng, cols, 1).normalize());
                    BlockValue::Full(u * v.adjoint())
                }
            });
            let p = Perturbation { values: values.collect() };
            let m_delta = &m * p.matrix(&s).expect("fits");
            // det(I - t M Delta) has no zero for 0 < t < 1 / upper: its argument cannot wind, and it stays away from zero.
            let steps = 40;
            for k in 0..=steps {
                let t = f64::from(k) / f64::from(steps) * (1.0 - 1e-6) / upper;
                let smallest = (DMatrix::identity(s.n_z(), s.n_z()) - &m_delta * Complex64::new(t, 0.0))
                    .determinant()
                    .norm();
                assert!(smallest > 0.0, "seed 37 trial {trial} {s:?}");
            }
            if !s.has_real() {
                let radius = power_radius(&m_delta);
                assert!(radius <= upper * (1.0 + 1e-9), "seed 37 trial {trial} {s:?}: {radius} {upper}");
            }
        }
    }
}

/// A lower estimate of the spectral radius by repeated squaring: `|A^256|^(1/256)` with the trace.
fn power_radius(a: &DMatrix<Complex64>) -> f64 {
    let n = a.nrows() as f64;
    let (mut power, mut log, mut exponent) = (a.clone(), 0.0, 1.0);
    for _ in 0..8 {
        let size = power.norm();
        if size == 0.0 {
            return 0.0;
        }
        power /= Complex64::new(size, 0.0);
        log = 2.0 * (log + size.ln());
        power = &power * &power;
        exponent *= 2.0;
    }
    // |trace(A^k)| <= n rho^k.
    ((log + (power.trace().norm() / n).ln()) / exponent).exp()
}

#[test]
fn law_scaling_transposition_and_structured_unitaries_change_nothing() {
    let mut rng = Rng::seed_from_u64(38);
    for s in structures() {
        let m = random(&mut rng, s.n_z(), s.n_w());
        let value = mu_upper_bound(&m, &s).expect("finite").value;
        let again = |m: &DMatrix<Complex64>, s: &BlockStructure, what: &str| {
            assert_close(mu_upper_bound(m, s).expect("finite").value, value, 1e-7, what);
        };
        let mirrored: Vec<Block> = s
            .blocks()
            .iter()
            .map(|b| match *b {
                Block::Full { rows, cols } => full(cols, rows),
                other => other,
            })
            .collect();
        again(&m.transpose(), &structure(&mirrored), "transposed");
        let factor = Complex64::new(-1e5, 0.0);
        let scaled = mu_upper_bound(&(&m * factor), &s).expect("finite").value;
        assert_close(scaled, 1e5 * value, 1e-7, "scaled");
        if !s.has_real() {
            again(&(&m * Complex64::from_polar(1.0, 1.1)), &s, "turned");
        }
        let (mut left, mut right) =
            (DMatrix::identity(s.n_z(), s.n_z()), DMatrix::identity(s.n_w(), s.n_w()));
        let (mut row, mut col) = (0, 0);
        for block in s.blocks() {
            let (u, v) = match *block {
                Block::Full { rows, cols } => (unitary(&mut rng, rows), unitary(&mut rng, cols)),
                Block::RepeatedReal { size } | Block::RepeatedComplex { size } => {
                    let u = unitary(&mut rng, size);
                    (u.adjoint(), u)
                }
            };
            right.view_mut((row, row), u.shape()).copy_from(&u);
            left.view_mut((col, col), v.shape()).copy_from(&v);
            (row, col) = (row + block.rows(), col + block.cols());
        }
        again(&(left * &m * right), &s, "unitaries");
    }
}

#[test]
fn paper_packard_doyle_1993_four_blocks_leave_a_gap() {
    // Packard and Doyle 1993, section 9.2, after Morton and Doyle: the bound is 1, mu about 0.87.
    let (gamma, beta) = (3.0 + 3.0_f64.sqrt(), 3.0_f64.sqrt() - 1.0);
    let a = Complex64::new((2.0 / gamma).sqrt(), 0.0);
    let b = Complex64::new(1.0 / gamma.sqrt(), 0.0);
    let (c, d) = (b, Complex64::new(-(beta / gamma).sqrt(), 0.0));
    let f = Complex64::new(1.0, 1.0) * (1.0 / (gamma * beta)).sqrt();
    let (o, j) = (Complex64::new(0.0, 0.0), Complex64::new(0.0, 1.0));
    let u = DMatrix::from_row_slice(4, 2, &[a, o, b, b, c, j * c, d, f]);
    let v = DMatrix::from_row_slice(4, 2, &[o, a, b, -b, c, -j * c, -j * f, -d]);
    let found = bounds(&(u * v.adjoint()), &structure(&[full(1, 1); 4]));
    println!("packard-doyle {} {}", found.lower.value, found.upper.value);
    assert_close(found.upper.value, 1.0, 1e-6, "upper");
    assert!(found.lower.value > 0.86 && found.lower.value < 0.88, "{}", found.lower.value);
}

#[test]
fn oracle_ab13md_upper_bounds() {
    let text = include_str!("../../../../testdata/mu/ab13md.json");
    let data: serde_json::Value = serde_json::from_str(text).expect("valid json");
    let number = |v: &serde_json::Value| v.as_f64().expect("a number");
    let mut largest_excess = 0.0_f64;
    for (index, case) in data["cases"].as_array().expect("cases").iter().enumerate() {
        let blocks: Vec<Block> = case["blocks"]
            .as_array()
            .expect("blocks")
            .iter()
            .map(|b| {
                let size = usize::try_from(b[1].as_u64().expect("a size")).expect("small");
                if b[0] == "real" { real(size) } else { full(size, size) }
            })
            .collect();
        let s = structure(&blocks);
        let m = DMatrix::from_fn(s.n_z(), s.n_w(), |i, j| {
            Complex64::new(number(&case["re"][i][j]), number(&case["im"][i][j]))
        });
        let (ours, theirs) = (mu_upper_bound(&m, &s).expect("finite").value, number(&case["ab13md"]));
        assert!(ours <= theirs * (1.0 + 1e-8), "case {index}: {ours} against {theirs}");
        largest_excess = largest_excess.max(theirs / ours - 1.0);
    }
    println!("ab13md lies above by up to {largest_excess:e}");
    assert!(largest_excess < 1e-2, "{largest_excess}");
}

#[test]
fn edge_matrices_that_have_no_answer_or_a_trivial_one() {
    let s = structure(&[full(1, 1); 2]);
    let zero = DMatrix::zeros(2, 2);
    assert_eq!(mu_upper_bound(&zero, &s).expect("finite").value, 0.0);
    assert!(bounds(&zero, &s).lower.perturbation.is_none());
    let nan = DMatrix::from_element(2, 2, Complex64::new(0.0, f64::NAN));
    assert!(matches!(mu_upper_bound(&nan, &s), Err(Error::System(telepulse_lti::Error::NotFinite { .. }))));
    let wide = DMatrix::zeros(2, 3);
    assert!(matches!(mu_upper_bound(&wide, &s), Err(Error::System(telepulse_lti::Error::Shape { .. }))));
    // Block triangular: mu is that of the diagonal, the scales go to infinity.
    let triangular = DMatrix::from_row_slice(2, 2, &[1.0, 1e6, 0.0, 0.5].map(|v| Complex64::new(v, 0.0)));
    let found = bounds(&triangular, &s);
    assert_close(found.upper.value, 1.0, 1e-6, "triangular");
    // Nilpotent: no perturbation at all.
    let nilpotent = DMatrix::from_row_slice(2, 2, &[0.0, 3.0, 0.0, 0.0].map(|v| Complex64::new(v, 0.0)));
    assert!(mu_upper_bound(&nilpotent, &s).expect("finite").value < 1e-5);
    // A parameter cannot cancel an imaginary loop.
    let turned = DMatrix::from_element(1, 1, Complex64::new(0.3, 2.0));
    let found = bounds(&turned, &structure(&[real(1)]));
    assert!(found.upper.value < 1e-6 && found.lower.value == 0.0, "{found:?}");
    // Extreme sizes.
    for size in [1e-150, 1e150] {
        let m = DMatrix::from_row_slice(2, 2, &[0.0, 4.0, 1.0, 0.0].map(|v| Complex64::new(v * size, 0.0)));
        assert_close(bounds(&m, &s).upper.value, 2.0 * size, 1e-8, "extreme size");
    }
    let graded = DMatrix::from_row_slice(2, 2, &[1.0, 1e100, 1e-100, 1.0].map(|v| Complex64::new(v, 0.0)));
    assert_close(bounds(&graded, &s).upper.value, 2.0, 1e-8, "graded");
}

#[test]
fn regress_a_strictly_triangular_matrix_with_real_blocks_has_its_small_bound() {
    // Its structured singular value is zero; the scales that prove less and less go to infinity, and rounding spoiled the proof
    // where a repeated block was among them.
    let upper = |n: usize, entry: f64, seed: u64| {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        DMatrix::from_fn(n, n, |i, j| {
            let v = if j > i { entry.powf(rng.random_range(-1.0..=1.0)) } else { 0.0 };
            Complex64::new(v, 0.0)
        })
    };
    let real = |size| Block::RepeatedReal { size };
    let one = Block::Full { rows: 1, cols: 1 };
    for seed in 0..40 {
        for blocks in [vec![real(2), one], vec![real(2), real(2)], vec![real(1); 4], vec![real(3), one, one]]
        {
            let s = BlockStructure::new(blocks).expect("blocks");
            let m = upper(s.n_w(), 10.0, seed);
            let norm = m.singular_values().max();
            let bounds = mu_bounds(&m, &s, &MuLowerOptions::default()).expect("a bound");
            assert_eq!(bounds.lower.value, 0.0, "seed {seed}");
            assert!(bounds.upper.scalings.prove(&m, &s, bounds.upper.value).expect("fits"), "seed {seed}");
            assert!(bounds.upper.value < 1e-3 * norm, "seed {seed} {s:?}: {} of {norm}", bounds.upper.value);
        }
    }
}
