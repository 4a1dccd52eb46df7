//! Numbers side by side: one for a twin, several for a batch. The same code steps both.
//!
//! A release build for `x86_64` may use two lanes and no fused multiply-add; the processors in use have four and
//! eight. The loops here are plain Rust that the compiler turns into vector instructions; `pulp` supplies the safe
//! choice at run time.

use std::ops::{Add, Mul, Sub};

/// `L` numbers with the arithmetic of one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Lanes<const L: usize>(pub(crate) [f64; L]);

impl<const L: usize> Lanes<L> {
    pub(crate) const ZERO: Self = Self([0.0; L]);

    #[inline(always)]
    pub(crate) fn all(value: f64) -> Self {
        Self([value; L])
    }

    #[inline(always)]
    pub(crate) fn from_fn(lane: impl FnMut(usize) -> f64) -> Self {
        Self(std::array::from_fn(lane))
    }

    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f64, f64) -> f64) -> Self {
        let mut out = self;
        for (a, b) in out.0.iter_mut().zip(other.0) {
            *a = f(*a, b);
        }
        out
    }

    /// `self * b + c`; `FUSED` says whether that is one instruction.
    #[inline(always)]
    pub(crate) fn times_plus<const FUSED: bool>(self, b: Self, c: Self) -> Self {
        let mut out = self;
        for k in 0..L {
            out.0[k] = if FUSED { self.0[k].mul_add(b.0[k], c.0[k]) } else { self.0[k] * b.0[k] + c.0[k] };
        }
        out
    }

    #[inline(always)]
    pub(crate) fn over(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }

    #[inline(always)]
    pub(crate) fn min(self, other: Self) -> Self {
        // Unlike f64::min, one instruction; a NaN passes through.
        self.zip(other, |a, b| if b < a { b } else { a })
    }

    #[inline(always)]
    pub(crate) fn max(self, other: Self) -> Self {
        self.zip(other, |a, b| if b > a { b } else { a })
    }

    /// Held within -1..1.
    #[inline(always)]
    pub(crate) fn within_one(self) -> Self {
        self.min(Self::all(1.0)).max(Self::all(-1.0))
    }

    /// True where any lane is not zero.
    #[inline(always)]
    pub(crate) fn any(self) -> bool {
        let mut sum = 0.0;
        for a in self.0 {
            sum += a.abs();
        }
        sum != 0.0
    }
}

impl<const L: usize> Add for Lanes<L> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
}

impl<const L: usize> Sub for Lanes<L> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
}

impl<const L: usize> Mul for Lanes<L> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
}

/// A computation that is worth compiling for wide registers. All that it calls must be `#[inline(always)]`.
pub(crate) trait Kernel {
    /// What it returns.
    type Output;
    /// Runs it; `FUSED` says whether the processor has a fused multiply-add.
    fn run<const FUSED: bool>(self) -> Self::Output;
}

/// Runs the widest version that the processor supports.
#[inline]
pub(crate) fn run<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    if let Some(wide) = pulp::x86::V3::try_new() {
        return wide.vectorize(Wide(kernel));
    }
    kernel.run::<{ cfg!(any(target_feature = "fma", target_arch = "aarch64")) }>()
}

#[cfg(target_arch = "x86_64")]
struct Wide<K>(K);

#[cfg(target_arch = "x86_64")]
impl<K: Kernel> pulp::NullaryFnOnce for Wide<K> {
    type Output = K::Output;
    #[inline(always)]
    fn call(self) -> K::Output {
        self.0.run::<true>()
    }
}
