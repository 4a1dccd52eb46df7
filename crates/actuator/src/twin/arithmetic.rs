//! Arithmetic of twins that are stepped singly or four abreast: the same formulas run on both.
//!
//! A release build for `x86_64` may use two lanes and no fused multiply-add; the processors in use have four and
//! eight. `pulp` supplies the wide instructions and the safe choice at run time.
//!
//! ```text
//!              One                 Four
//! Single       one number          four numbers of one twin, in one register
//! Abreast      four twins' number  four registers, each with four twins' number
//! ```

use std::fmt::Debug;

use pulp::f64x4;

/// Operations on one number of each twin (`One`), and on four numbers of each twin that are treated alike (`Four`).
pub(crate) trait Arithmetic: Copy {
    /// One number of each twin.
    type One: PerTwin<Four = Self::Four>;
    /// Four numbers of each twin.
    type Four: Copy + Debug + PartialEq;

    /// The same number for all twins.
    fn all(self, value: f64) -> Self::One;
    fn add(self, a: Self::One, b: Self::One) -> Self::One;
    fn sub(self, a: Self::One, b: Self::One) -> Self::One;
    fn mul(self, a: Self::One, b: Self::One) -> Self::One;
    fn div(self, a: Self::One, b: Self::One) -> Self::One;
    /// `a b + c`.
    fn mul_add(self, a: Self::One, b: Self::One, c: Self::One) -> Self::One;
    /// `a b - c`.
    fn mul_sub(self, a: Self::One, b: Self::One, c: Self::One) -> Self::One;
    /// `a - b c`.
    fn less_mul(self, a: Self::One, b: Self::One, c: Self::One) -> Self::One;
    /// Held within -1..1.
    fn within_one(self, a: Self::One) -> Self::One;
    /// True where the number of any twin is outside of -1..1, or none.
    fn outside_one(self, a: Self::One) -> bool;

    /// `a b`.
    fn scale(self, a: Self::Four, b: Self::One) -> Self::Four;
    /// `a b + c`.
    fn scale_add(self, a: Self::Four, b: Self::One, c: Self::Four) -> Self::Four;
    /// `a b - c`.
    fn scale_sub(self, a: Self::Four, b: Self::One, c: Self::Four) -> Self::Four;
    /// One of the four; `K` below 4.
    fn pick<const K: usize>(self, a: Self::Four) -> Self::One;
    /// Takes from the second of the four.
    fn less_in_second(self, a: Self::Four, b: Self::One) -> Self::Four;
    /// Zero in place of the first of the four, unless `b` is zero.
    fn clear_first_unless_zero(self, a: Self::Four, b: Self::One) -> Self::Four;
    /// Sum of the products of the third and the fourth.
    fn dot_upper(self, a: Self::Four, b: Self::Four) -> Self::One;
}

/// A number of each twin, as it is stored.
pub(crate) trait PerTwin: Copy + Debug + PartialEq {
    /// Four numbers of each twin, as they are stored.
    type Four: Copy + Debug + PartialEq;
    /// From the number of each twin.
    fn gather(of: impl Fn(usize) -> f64) -> Self;
    /// The number of one twin.
    fn of_twin(self, idx: usize) -> f64;
    /// Puts four side by side.
    fn four(numbers: [Self; 4]) -> Self::Four;
}

impl PerTwin for f64 {
    type Four = f64x4;
    #[inline(always)]
    fn gather(of: impl Fn(usize) -> f64) -> Self {
        of(0)
    }
    #[inline(always)]
    fn of_twin(self, _idx: usize) -> f64 {
        self
    }
    fn four([a, b, c, d]: [Self; 4]) -> f64x4 {
        f64x4(a, b, c, d)
    }
}

impl PerTwin for f64x4 {
    type Four = [f64x4; 4];
    #[inline(always)]
    fn gather(of: impl Fn(usize) -> f64) -> Self {
        Self(of(0), of(1), of(2), of(3))
    }
    #[inline(always)]
    fn of_twin(self, idx: usize) -> f64 {
        [self.0, self.1, self.2, self.3][idx]
    }
    fn four(numbers: [Self; 4]) -> [f64x4; 4] {
        numbers
    }
}

/// One twin.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Single<P>(pub(crate) P);

/// Four twins.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Abreast<P>(pub(crate) P);

/// A processor's way with four numbers, and with one.
pub(crate) trait Processor: Copy {
    fn mul_add_one(self, a: f64, b: f64, c: f64) -> f64;
    fn splat(self, a: f64) -> f64x4;
    fn add(self, a: f64x4, b: f64x4) -> f64x4;
    fn sub(self, a: f64x4, b: f64x4) -> f64x4;
    fn mul(self, a: f64x4, b: f64x4) -> f64x4;
    fn div(self, a: f64x4, b: f64x4) -> f64x4;
    fn min(self, a: f64x4, b: f64x4) -> f64x4;
    fn max(self, a: f64x4, b: f64x4) -> f64x4;
    fn mul_add(self, a: f64x4, b: f64x4, c: f64x4) -> f64x4;
    fn mul_sub(self, a: f64x4, b: f64x4, c: f64x4) -> f64x4;
    fn less_mul(self, a: f64x4, b: f64x4, c: f64x4) -> f64x4;
    fn outside_one(self, a: f64x4) -> bool;
}

impl<P: Processor> Arithmetic for Single<P> {
    type One = f64;
    type Four = f64x4;

    #[inline(always)]
    fn all(self, value: f64) -> f64 {
        value
    }
    #[inline(always)]
    fn add(self, a: f64, b: f64) -> f64 {
        a + b
    }
    #[inline(always)]
    fn sub(self, a: f64, b: f64) -> f64 {
        a - b
    }
    #[inline(always)]
    fn mul(self, a: f64, b: f64) -> f64 {
        a * b
    }
    #[inline(always)]
    fn div(self, a: f64, b: f64) -> f64 {
        a / b
    }
    #[inline(always)]
    fn mul_add(self, a: f64, b: f64, c: f64) -> f64 {
        self.0.mul_add_one(a, b, c)
    }
    #[inline(always)]
    fn mul_sub(self, a: f64, b: f64, c: f64) -> f64 {
        self.0.mul_add_one(a, b, -c)
    }
    #[inline(always)]
    fn less_mul(self, a: f64, b: f64, c: f64) -> f64 {
        self.0.mul_add_one(-b, c, a)
    }
    #[inline(always)]
    fn within_one(self, a: f64) -> f64 {
        a.clamp(-1.0, 1.0)
    }
    #[inline(always)]
    fn outside_one(self, a: f64) -> bool {
        // A NaN is nowhere.
        !(-1.0..=1.0).contains(&a)
    }
    #[inline(always)]
    fn scale(self, a: f64x4, b: f64) -> f64x4 {
        self.0.mul(a, self.0.splat(b))
    }
    #[inline(always)]
    fn scale_add(self, a: f64x4, b: f64, c: f64x4) -> f64x4 {
        self.0.mul_add(a, self.0.splat(b), c)
    }
    #[inline(always)]
    fn scale_sub(self, a: f64x4, b: f64, c: f64x4) -> f64x4 {
        self.0.mul_sub(a, self.0.splat(b), c)
    }
    #[inline(always)]
    fn pick<const K: usize>(self, a: f64x4) -> f64 {
        [a.0, a.1, a.2, a.3][K]
    }
    #[inline(always)]
    fn less_in_second(self, a: f64x4, b: f64) -> f64x4 {
        self.0.add(a, f64x4(0.0, -b, 0.0, 0.0))
    }
    #[inline(always)]
    fn clear_first_unless_zero(self, a: f64x4, b: f64) -> f64x4 {
        f64x4(if b == 0.0 { a.0 } else { 0.0 }, a.1, a.2, a.3)
    }
    #[inline(always)]
    fn dot_upper(self, a: f64x4, b: f64x4) -> f64 {
        let products = self.0.mul(a, b);
        products.2 + products.3
    }
}

impl<P: Processor> Arithmetic for Abreast<P> {
    type One = f64x4;
    type Four = [f64x4; 4];

    #[inline(always)]
    fn all(self, value: f64) -> f64x4 {
        self.0.splat(value)
    }
    #[inline(always)]
    fn add(self, a: f64x4, b: f64x4) -> f64x4 {
        self.0.add(a, b)
    }
    #[inline(always)]
    fn sub(self, a: f64x4, b: f64x4) -> f64x4 {
        self.0.sub(a, b)
    }
    #[inline(always)]
    fn mul(self, a: f64x4, b: f64x4) -> f64x4 {
        self.0.mul(a, b)
    }
    #[inline(always)]
    fn div(self, a: f64x4, b: f64x4) -> f64x4 {
        self.0.div(a, b)
    }
    #[inline(always)]
    fn mul_add(self, a: f64x4, b: f64x4, c: f64x4) -> f64x4 {
        self.0.mul_add(a, b, c)
    }
    #[inline(always)]
    fn mul_sub(self, a: f64x4, b: f64x4, c: f64x4) -> f64x4 {
        self.0.mul_sub(a, b, c)
    }
    #[inline(always)]
    fn less_mul(self, a: f64x4, b: f64x4, c: f64x4) -> f64x4 {
        self.0.less_mul(a, b, c)
    }
    #[inline(always)]
    fn within_one(self, a: f64x4) -> f64x4 {
        self.0.max(self.0.min(a, self.0.splat(1.0)), self.0.splat(-1.0))
    }
    #[inline(always)]
    fn outside_one(self, a: f64x4) -> bool {
        self.0.outside_one(a)
    }
    #[inline(always)]
    fn scale(self, a: [f64x4; 4], b: f64x4) -> [f64x4; 4] {
        [self.0.mul(a[0], b), self.0.mul(a[1], b), self.0.mul(a[2], b), self.0.mul(a[3], b)]
    }
    #[inline(always)]
    fn scale_add(self, a: [f64x4; 4], b: f64x4, c: [f64x4; 4]) -> [f64x4; 4] {
        [
            self.0.mul_add(a[0], b, c[0]),
            self.0.mul_add(a[1], b, c[1]),
            self.0.mul_add(a[2], b, c[2]),
            self.0.mul_add(a[3], b, c[3]),
        ]
    }
    #[inline(always)]
    fn scale_sub(self, a: [f64x4; 4], b: f64x4, c: [f64x4; 4]) -> [f64x4; 4] {
        [
            self.0.mul_sub(a[0], b, c[0]),
            self.0.mul_sub(a[1], b, c[1]),
            self.0.mul_sub(a[2], b, c[2]),
            self.0.mul_sub(a[3], b, c[3]),
        ]
    }
    #[inline(always)]
    fn pick<const K: usize>(self, a: [f64x4; 4]) -> f64x4 {
        a[K]
    }
    #[inline(always)]
    fn less_in_second(self, a: [f64x4; 4], b: f64x4) -> [f64x4; 4] {
        [a[0], self.0.sub(a[1], b), a[2], a[3]]
    }
    #[inline(always)]
    fn clear_first_unless_zero(self, a: [f64x4; 4], b: f64x4) -> [f64x4; 4] {
        let first = each(a[0], b, |a, b| if b == 0.0 { a } else { 0.0 });
        [first, a[1], a[2], a[3]]
    }
    #[inline(always)]
    fn dot_upper(self, a: [f64x4; 4], b: [f64x4; 4]) -> f64x4 {
        // Rounded as for a single twin.
        self.0.add(self.0.mul(a[2], b[2]), self.0.mul(a[3], b[3]))
    }
}

/// Any processor, two lanes at most.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Baseline;

#[inline(always)]
fn each(a: f64x4, b: f64x4, f: impl Fn(f64, f64) -> f64) -> f64x4 {
    f64x4(f(a.0, b.0), f(a.1, b.1), f(a.2, b.2), f(a.3, b.3))
}

impl Processor for Baseline {
    #[inline(always)]
    fn mul_add_one(self, a: f64, b: f64, c: f64) -> f64 {
        a * b + c
    }
    #[inline(always)]
    fn splat(self, a: f64) -> f64x4 {
        f64x4(a, a, a, a)
    }
    #[inline(always)]
    fn add(self, a: f64x4, b: f64x4) -> f64x4 {
        each(a, b, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, a: f64x4, b: f64x4) -> f64x4 {
        each(a, b, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, a: f64x4, b: f64x4) -> f64x4 {
        each(a, b, |a, b| a * b)
    }
    #[inline(always)]
    fn div(self, a: f64x4, b: f64x4) -> f64x4 {
        each(a, b, |a, b| a / b)
    }
    #[inline(always)]
    fn min(self, a: f64x4, b: f64x4) -> f64x4 {
        each(a, b, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn max(self, a: f64x4, b: f64x4) -> f64x4 {
        each(a, b, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn mul_add(self, a: f64x4, b: f64x4, c: f64x4) -> f64x4 {
        self.add(self.mul(a, b), c)
    }
    #[inline(always)]
    fn mul_sub(self, a: f64x4, b: f64x4, c: f64x4) -> f64x4 {
        self.sub(self.mul(a, b), c)
    }
    #[inline(always)]
    fn less_mul(self, a: f64x4, b: f64x4, c: f64x4) -> f64x4 {
        self.sub(a, self.mul(b, c))
    }
    #[inline(always)]
    fn outside_one(self, a: f64x4) -> bool {
        [a.0, a.1, a.2, a.3].iter().any(|a| !(-1.0..=1.0).contains(a))
    }
}

#[cfg(target_arch = "x86_64")]
impl Processor for pulp::x86::V3 {
    #[inline(always)]
    fn mul_add_one(self, a: f64, b: f64, c: f64) -> f64 {
        a.mul_add(b, c)
    }
    #[inline(always)]
    fn splat(self, a: f64) -> f64x4 {
        pulp::Simd::splat_f64s(self, a)
    }
    #[inline(always)]
    fn add(self, a: f64x4, b: f64x4) -> f64x4 {
        pulp::Simd::add_f64s(self, a, b)
    }
    #[inline(always)]
    fn sub(self, a: f64x4, b: f64x4) -> f64x4 {
        pulp::Simd::sub_f64s(self, a, b)
    }
    #[inline(always)]
    fn mul(self, a: f64x4, b: f64x4) -> f64x4 {
        pulp::Simd::mul_f64s(self, a, b)
    }
    #[inline(always)]
    fn div(self, a: f64x4, b: f64x4) -> f64x4 {
        pulp::Simd::div_f64s(self, a, b)
    }
    #[inline(always)]
    fn min(self, a: f64x4, b: f64x4) -> f64x4 {
        pulp::Simd::min_f64s(self, a, b)
    }
    #[inline(always)]
    fn max(self, a: f64x4, b: f64x4) -> f64x4 {
        pulp::Simd::max_f64s(self, a, b)
    }
    #[inline(always)]
    fn mul_add(self, a: f64x4, b: f64x4, c: f64x4) -> f64x4 {
        pulp::Simd::mul_add_f64s(self, a, b, c)
    }
    #[inline(always)]
    fn mul_sub(self, a: f64x4, b: f64x4, c: f64x4) -> f64x4 {
        self.mul_sub_f64x4(a, b, c)
    }
    #[inline(always)]
    fn less_mul(self, a: f64x4, b: f64x4, c: f64x4) -> f64x4 {
        self.negate_mul_add_f64x4(b, c, a)
    }
    #[inline(always)]
    fn outside_one(self, a: f64x4) -> bool {
        let outside = self.cmp_not_le_f64x4(pulp::Simd::abs_f64s(self, a), self.splat_f64x4(1.0));
        pulp::Simd::first_true_m64s(self, outside) < 4
    }
}

/// A computation that is worth compiling for wide registers. All that it calls must be `#[inline(always)]`.
pub(crate) trait Kernel {
    /// What it returns.
    type Output;
    /// Runs it on a processor.
    fn run(self, processor: impl Processor) -> Self::Output;
}

/// Runs the widest version that the processor supports.
#[inline]
pub(crate) fn run<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    if let Some(wide) = pulp::x86::V3::try_new() {
        return wide.vectorize(Wide(kernel, wide));
    }
    kernel.run(Baseline)
}

#[cfg(target_arch = "x86_64")]
struct Wide<K>(K, pulp::x86::V3);

#[cfg(target_arch = "x86_64")]
impl<K: Kernel> pulp::NullaryFnOnce for Wide<K> {
    type Output = K::Output;
    #[inline(always)]
    fn call(self) -> K::Output {
        self.0.run(self.1)
    }
}
