//! Evidence for the actuator: membrane against stored solutions, twin against field-level model, rigs end to end.

mod batch;
mod calibration;
mod design_study;
mod failure;
mod field;
mod membrane;
mod printed;
mod rig;
mod sensing;
mod statics;
mod twin;
mod two_methods;

/// Panics unless `found` lies within `relative` of `expected`, or within `absolute` where that is larger.
#[track_caller]
pub(crate) fn assert_close(found: f64, expected: f64, relative: f64, absolute: f64, what: &str) {
    let allowed = (relative * expected.abs()).max(absolute);
    assert!(
        (found - expected).abs() <= allowed,
        "{what}: found {found}, expected {expected}, difference {:e}, allowed {allowed:e}",
        found - expected
    );
}

/// Uniform numbers in 0..1 from a printed seed.
pub(crate) fn uniform(state: &mut u64) -> f64 {
    // Knuth's MMIX generator; the upper bits are good enough to scatter test points.
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*state >> 11) as f64 * 0.5_f64.powi(53)
}
