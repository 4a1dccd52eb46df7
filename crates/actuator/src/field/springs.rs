//! Neo-Hookean springs of unit modulus at all nodes, behind dashpots that move within an implicit stage.

use crate::material::Stress;

/// Two values at every node, meridional and hoop, in one array each.
pub(super) type Pairs = [Vec<f64>; 2];

pub(super) fn pairs(n_nodes: usize) -> Pairs {
    [vec![0.0; n_nodes], vec![0.0; n_nodes]]
}

/// The springs of one branch in one stage.
///
/// **Method**: with the logarithmic strains e = ln(l/xi) and t_k = l_k s_k, the stage's equation is
/// e + phi M t(e) = ln l - known, phi = h L_ii/tau. It is local to a node, so the membrane sees only what is left after e is
/// eliminated. Newton runs side by side with that of the membrane: one local step for each of its steps. M is symmetric, so
/// the stage has a potential and its tangent by ln l, (T^-1 + phi M)^-1, is symmetric.
///
/// **Source**: rates by Foo, Cai, Koh, Bauer, Suo 2012: M = [1, -1/2; -1/2, 1]/3.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Springs {
    strain: Pairs,
    /// exp(2 e).
    squares: Pairs,
}

/// Stress of all branches with its consistent tangent by the logarithmic stretches, for one value at every node.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct BranchStress {
    t1: Vec<f64>,
    t2: Vec<f64>,
    h11: Vec<f64>,
    h12: Vec<f64>,
    h22: Vec<f64>,
}

/// Largest change of a logarithmic strain in one step.
const LARGEST_STEP: f64 = 0.5;

impl Springs {
    pub(super) fn new(n_nodes: usize) -> Self {
        Self { strain: pairs(n_nodes), squares: [vec![1.0; n_nodes], vec![1.0; n_nodes]] }
    }

    pub(super) fn strain(&self) -> &Pairs {
        &self.strain
    }

    /// Puts the strains to `strain(k, node)`.
    pub(super) fn set(&mut self, strain: impl Fn(usize, usize) -> f64) {
        for (k, (values, squares)) in self.strain.iter_mut().zip(&mut self.squares).enumerate() {
            for (node, (value, square)) in values.iter_mut().zip(squares).enumerate() {
                *value = strain(k, node);
                *square = exp(2.0 * *value);
            }
        }
    }

    /// One Newton step of the stage's equation at all nodes, `logs` being ln l.
    pub(super) fn relax(&mut self, logs: &Pairs, known: &Pairs, phi: f64) {
        let n = self.strain[0].len();
        let ([e1, e2], [w1, w2]) = (&mut self.strain, &mut self.squares);
        let (e1, e2, w1, w2) = (&mut e1[..n], &mut e2[..n], &mut w1[..n], &mut w2[..n]);
        let (log1, log2, known1, known2) = (&logs[0][..n], &logs[1][..n], &known[0][..n], &known[1][..n]);
        wide(
            #[inline(always)]
            || {
                for j in 0..n {
                    let at = Node::new(w1[j], w2[j], phi);
                    let r1 = e1[j] + at.third * (at.t1 - 0.5 * at.t2) - (log1[j] - known1[j]);
                    let r2 = e2[j] + at.third * (at.t2 - 0.5 * at.t1) - (log2[j] - known2[j]);
                    let step1 = at.inverse * (at.j12 * r2 - at.j22 * r1);
                    let step2 = at.inverse * (at.j21 * r1 - at.j11 * r2);
                    let step1 = step1.clamp(-LARGEST_STEP, LARGEST_STEP);
                    let step2 = step2.clamp(-LARGEST_STEP, LARGEST_STEP);
                    e1[j] += step1;
                    e2[j] += step2;
                    w1[j] *= exp(2.0 * step1);
                    w2[j] *= exp(2.0 * step2);
                }
            },
        );
    }

    /// Adds `ratio` times stress and tangent to `sum`.
    pub(super) fn add_stress(&self, phi: f64, ratio: f64, sum: &mut BranchStress) {
        let n = self.strain[0].len();
        let (w1, w2) = (&self.squares[0][..n], &self.squares[1][..n]);
        let BranchStress { t1, t2, h11, h12, h22 } = sum;
        let (t1, t2) = (&mut t1[..n], &mut t2[..n]);
        let (h11, h12, h22) = (&mut h11[..n], &mut h12[..n], &mut h22[..n]);
        wide(
            #[inline(always)]
            || {
                for j in 0..n {
                    let at = Node::new(w1[j], w2[j], phi);
                    // H = T J^-1 with T = 2 [w1 + w3, w3; w3, w2 + w3].
                    let (a, b, d) = (2.0 * (w1[j] + at.w3), 2.0 * at.w3, 2.0 * (w2[j] + at.w3));
                    let scale = ratio * at.inverse;
                    t1[j] += ratio * at.t1;
                    t2[j] += ratio * at.t2;
                    h11[j] += scale * (a * at.j22 - b * at.j21);
                    h12[j] += scale * (b * at.j11 - a * at.j12);
                    h22[j] += scale * (d * at.j11 - b * at.j12);
                }
            },
        );
    }

    /// Puts the rates of the dashpots into `rates`.
    pub(super) fn rates(&self, rate_per_s: f64, rates: &mut Pairs) {
        let n = self.strain[0].len();
        let (w1, w2) = (&self.squares[0][..n], &self.squares[1][..n]);
        let [r1, r2] = rates;
        let (r1, r2) = (&mut r1[..n], &mut r2[..n]);
        wide(
            #[inline(always)]
            || {
                for j in 0..n {
                    let at = Node::new(w1[j], w2[j], rate_per_s);
                    r1[j] = at.third * (at.t1 - 0.5 * at.t2);
                    r2[j] = at.third * (at.t2 - 0.5 * at.t1);
                }
            },
        );
    }

    /// Adds `ratio` times the power that the dashpots dissipate to `power`.
    pub(super) fn add_power(&self, rates: &Pairs, ratio: f64, power: &mut [f64]) {
        for (node, power) in power.iter_mut().enumerate() {
            let at = Node::new(self.squares[0][node], self.squares[1][node], 0.0);
            *power += ratio * (at.t1 * rates[0][node] + at.t2 * rates[1][node]);
        }
    }
}

impl BranchStress {
    pub(super) fn new(n_nodes: usize) -> Self {
        let zeros = || vec![0.0; n_nodes];
        Self { t1: zeros(), t2: zeros(), h11: zeros(), h12: zeros(), h22: zeros() }
    }

    pub(super) fn clear(&mut self) {
        let Self { t1, t2, h11, h12, h22 } = self;
        for values in [t1, t2, h11, h12, h22] {
            values.fill(0.0);
        }
    }

    /// Nominal stress and its tangent at a node.
    #[inline]
    pub(super) fn at(&self, node: usize, l1: f64, l2: f64) -> Stress {
        let (i1, i2) = (1.0 / l1, 1.0 / l2);
        let (t1, t2) = (self.t1[node], self.t2[node]);
        Stress {
            s1: t1 * i1,
            s2: t2 * i2,
            s11: (self.h11[node] - t1) * i1 * i1,
            s12: self.h12[node] * i1 * i2,
            s22: (self.h22[node] - t2) * i2 * i2,
        }
    }
}

/// A spring's stress and the matrix I + phi M T with the inverse of its determinant.
#[derive(Debug, Clone, Copy)]
struct Node {
    /// exp(-2 e1 - 2 e2).
    w3: f64,
    t1: f64,
    t2: f64,
    third: f64,
    j11: f64,
    j12: f64,
    j21: f64,
    j22: f64,
    inverse: f64,
}

impl Node {
    #[inline(always)]
    fn new(w1: f64, w2: f64, phi: f64) -> Self {
        let third = phi / 3.0;
        let w3 = 1.0 / (w1 * w2);
        // M T = (2/3) [w1 + w3/2, (w3 - w2)/2; (w3 - w1)/2, w2 + w3/2].
        let (j11, j12) = (1.0 + third * (2.0 * w1 + w3), third * (w3 - w2));
        let (j21, j22) = (third * (w3 - w1), 1.0 + third * (2.0 * w2 + w3));
        let inverse = 1.0 / (j11 * j22 - j12 * j21);
        Self { w3, t1: w1 - w3, t2: w2 - w3, third, j11, j12, j21, j22, inverse }
    }
}

/// Runs a loop over nodes compiled for the widest registers there are; results do not depend on the width.
#[inline(always)]
fn wide<R>(run: impl FnOnce() -> R) -> R {
    #[cfg(target_arch = "x86_64")]
    if let Some(processor) = pulp::x86::V3::try_new() {
        return processor.vectorize(run);
    }
    run()
}

/// exp(x) without branches, exact to 3e-16; beyond 700 it stays at the value there.
///
/// **Method**: x = k ln 2 + r, Taylor's series in r, |r| <= 0.35.
#[inline(always)]
fn exp(x: f64) -> f64 {
    let x = x.clamp(-700.0, 700.0);
    let shifted = x * std::f64::consts::LOG2_E + ROUNDER;
    let k = shifted - ROUNDER;
    let r = (x - k * LN_2_HIGH) - k * LN_2_LOW;
    let mut series = TAYLOR[0];
    for coefficient in &TAYLOR[1..] {
        series = series * r + coefficient;
    }
    let power = f64::from_bits((shifted.to_bits() << 52).wrapping_add(1.0_f64.to_bits()));
    series * power
}

/// 1.5 2^52: the sum holds the nearest integer in its last bits.
const ROUNDER: f64 = 6_755_399_441_055_744.0;
/// ln 2 to 32 bits, whose products with integers up to 2000 are exact, and the rest.
const LN_2_HIGH: f64 = 0.693_147_180_369_123_8;
const LN_2_LOW: f64 = 1.908_214_929_270_587_7e-10;
/// 1/13! down to 1/0!: what follows is below 0.35^14/14! = 5e-18.
const TAYLOR: [f64; 14] = [
    1.0 / 6_227_020_800.0,
    1.0 / 479_001_600.0,
    1.0 / 39_916_800.0,
    1.0 / 3_628_800.0,
    1.0 / 362_880.0,
    1.0 / 40_320.0,
    1.0 / 5_040.0,
    1.0 / 720.0,
    1.0 / 120.0,
    1.0 / 24.0,
    1.0 / 6.0,
    0.5,
    1.0,
    1.0,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_exponential_is_that_of_the_standard_library() {
        for k in -4000..=4000 {
            let x = f64::from(k) * 0.0173;
            // Three roundings, of which that of the last product and sum count.
            assert!((exp(x) / x.exp() - 1.0).abs() < 5e-16, "{x}");
        }
        assert!(exp(-1e9) > 0.0 && exp(1e9).is_finite() && exp(f64::NAN).is_nan());
    }

    #[test]
    fn law_stage_tangent_is_the_slope_of_the_stage_stress() {
        for phi in [0.0, 0.003, 0.7, 40.0] {
            let (known, d) = ([vec![0.3], vec![0.9]], 1e-5);
            let at = |d1: f64, d2: f64| {
                let logs = [vec![0.8 + d1], vec![0.6 + d2]];
                let mut springs = Springs::new(1);
                // Newton from zero strain: quadratic well before this.
                for _ in 0..30 {
                    springs.relax(&logs, &known, phi);
                }
                let mut sum = BranchStress::new(1);
                springs.add_stress(phi, 1.0, &mut sum);
                (springs, sum)
            };
            let (springs, here) = at(0.0, 0.0);
            let mut moved = pairs(1);
            springs.rates(phi, &mut moved);
            for (k, trial) in [0.5, -0.3].into_iter().enumerate() {
                // The stage's equation, e + phi M t = ln l - known.
                let left = springs.strain()[k][0] + moved[k][0] - trial;
                assert!(left.abs() < 1e-14 * (1.0 + phi), "{phi}: {left}");
            }
            let (along1, along2) = ((at(d, 0.0).1, at(-d, 0.0).1), (at(0.0, d).1, at(0.0, -d).1));
            for (found, expected) in [
                (here.h11[0], (along1.0.t1[0] - along1.1.t1[0]) / (2.0 * d)),
                (here.h12[0], (along1.0.t2[0] - along1.1.t2[0]) / (2.0 * d)),
                (here.h12[0], (along2.0.t1[0] - along2.1.t1[0]) / (2.0 * d)),
                (here.h22[0], (along2.0.t2[0] - along2.1.t2[0]) / (2.0 * d)),
            ] {
                // Central differences: 1e-10 times third derivatives, rounding 1e-15/1e-5.
                assert!(
                    (found - expected).abs() < 4e-9 * (1.0 + expected.abs()),
                    "{phi}: {found} {expected}"
                );
            }
        }
    }
}
