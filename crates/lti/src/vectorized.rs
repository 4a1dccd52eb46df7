//! Inner loops over contiguous columns, compiled once for the baseline processor and once for AVX2 with fused
//! multiply-add, and chosen at run time.
//!
//! A release build for `x86_64` may use two lanes and no fused multiply-add; the processors in use have four and
//! eight. The loops here are plain Rust that the compiler vectorises; `pulp` supplies the safe dispatch.

/// A computation that is worth compiling for wide registers. All that it calls must be `#[inline(always)]`.
pub(crate) trait Kernel {
    /// What it returns.
    type Output;
    /// Runs it; `FUSED` says whether the processor has a fused multiply-add.
    fn run<const FUSED: bool>(self) -> Self::Output;
}

/// Runs the widest version that the processor supports.
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

/// `a * b + c`, fused where that is one instruction.
#[inline(always)]
pub(crate) fn multiply_add<const FUSED: bool>(a: f64, b: f64, c: f64) -> f64 {
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}

/// Scalar product, summed in eight lanes.
#[inline(always)]
pub(crate) fn dot<const FUSED: bool>(x: &[f64], y: &[f64]) -> f64 {
    let (x_lanes, x_rest) = x.as_chunks::<8>();
    let (y_lanes, y_rest) = y.as_chunks::<8>();
    let mut sums = [0.0; 8];
    for (a, b) in x_lanes.iter().zip(y_lanes) {
        for k in 0..8 {
            sums[k] = multiply_add::<FUSED>(a[k], b[k], sums[k]);
        }
    }
    let mut sum = ((sums[0] + sums[4]) + (sums[1] + sums[5])) + ((sums[2] + sums[6]) + (sums[3] + sums[7]));
    for (a, b) in x_rest.iter().zip(y_rest) {
        sum = multiply_add::<FUSED>(*a, *b, sum);
    }
    sum
}

/// `y += a x`.
#[inline(always)]
pub(crate) fn axpy<const FUSED: bool>(y: &mut [f64], a: f64, x: &[f64]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y = multiply_add::<FUSED>(a, *x, *y);
    }
}

/// An elementary reflector `I - tau v vᵀ` with `v[0] = 1`, and what it makes of the vector it was built from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reflection {
    /// Zero where the vector already is a multiple of the first unit vector.
    pub tau: f64,
    /// The first entry after reflection.
    pub beta: f64,
}

/// Overwrites `v` with the reflector that takes it to a multiple of the first unit vector.
///
/// **Source**: LAPACK `dlarfg`; the vector is rescaled where its squares would leave the range of floating point.
#[inline(always)]
pub(crate) fn reflector<const FUSED: bool>(v: &mut [f64]) -> Reflection {
    let Some((&mut alpha, tail)) = v.split_first_mut() else {
        return Reflection { tau: 0.0, beta: 0.0 };
    };
    let square = dot::<FUSED>(tail, tail);
    let mut scale = 1.0;
    let (mut head, mut sum) = (alpha, square);
    if square == 0.0 || !(SQUARE_MIN..SQUARE_MAX).contains(&(square + alpha * alpha)) {
        let largest = tail.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        if largest == 0.0 {
            v[0] = 1.0;
            return Reflection { tau: 0.0, beta: alpha };
        }
        scale = 1.0 / largest.max(alpha.abs()).max(f64::MIN_POSITIVE);
        head *= scale;
        sum = 0.0;
        for x in tail.iter_mut() {
            *x *= scale;
            sum += *x * *x;
        }
    }
    let norm = multiply_add::<FUSED>(head, head, sum).sqrt();
    let beta = -norm.copysign(head);
    let tau = (beta - head) / beta;
    let inverse = 1.0 / (head - beta);
    for x in tail.iter_mut() {
        *x *= inverse;
    }
    v[0] = 1.0;
    Reflection { tau, beta: beta / scale }
}

/// Squares between these bounds can be summed without care.
const SQUARE_MIN: f64 = 1e-270;
const SQUARE_MAX: f64 = 1e270;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_a_reflector_of_any_magnitude_is_orthogonal_and_annihilates() {
        for scale in [1e-300, 1e-150, 1.0, 1e150, 1e300] {
            let x = [0.3 * scale, -0.4 * scale, 1.2 * scale];
            let mut v = x;
            let r = reflector::<false>(&mut v);
            assert!((r.beta.abs() / scale - 1.3).abs() < 1e-15);
            assert!((r.tau * dot::<false>(&v, &v) - 2.0).abs() < 1e-15);
            let projection = r.tau * dot::<false>(&v, &x.map(|x| x / scale));
            for k in 1..3 {
                assert!((x[k] / scale - projection * v[k]).abs() < 1e-15);
            }
        }
    }
}
