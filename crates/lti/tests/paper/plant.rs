//! The identified plant, Eq. (14) to (16).

use super::systems::{circuit, mechanics, plant};
use super::{assert_rounds_to, first_fall_below, rad_s};

#[test]
fn paper_eq16_is_the_product_of_eq14_and_eq15_times_a_gain() {
    let product = circuit().multiply(&mechanics()).unwrap().scale(1350.14).unwrap();
    assert_eq!(product.numerator(), [1350.14]);
    assert_eq!(product.denominator().len(), 4);
    // The paper prints every digit of the products; two roundings each.
    for (found, printed) in product.denominator().iter().zip([0.0045, 1.07182, 22.458, 1444.0]) {
        assert!((found - printed).abs() <= 2.0 * f64::EPSILON * printed, "{found} is not {printed}");
    }
}

#[test]
fn paper_eq16_gain_poles_and_damping() {
    let g = plant();
    assert_rounds_to(g.dc_gain().unwrap(), "0.935");
    let poles = g.poles().unwrap();
    let real = poles.iter().find(|pole| pole.im == 0.0).unwrap();
    let pair = poles.iter().find(|pole| pole.im > 0.0).unwrap();
    assert_eq!(poles.len(), 3);
    assert_rounds_to(real.re, "-222.22");
    assert_rounds_to(pair.re, "-7.98");
    assert_rounds_to(pair.im, "37.1527");
    assert_rounds_to(pair.norm(), "38.00");
    assert_rounds_to(-pair.re / pair.norm(), "0.2100");
}

#[test]
fn paper_eq16_realization_has_the_same_poles_gain_and_coefficients() {
    let sys = plant().to_state_space();
    assert_rounds_to(sys.dc_gain().unwrap()[(0, 0)], "0.935");
    assert!(sys.is_stable().unwrap());
    let back = sys.to_transfer_function().unwrap();
    assert_eq!(back.relative_degree(), 3);
    // Monic on the way back. Three roots of size 38 to 222 and a product: a dozen roundings.
    for (found, printed) in back.denominator().iter().zip([0.0045, 1.07182, 22.458, 1444.0]) {
        assert!((found * 0.0045 - printed).abs() <= 1e-13 * printed, "{found}");
    }
    assert!((back.numerator()[0] * 0.0045 - 1350.14).abs() <= 1e-12 * 1350.14);
}

#[test]
fn paper_fig07_the_plant_is_back_at_its_static_gain_at_8_hz() {
    // "The cut-off frequency of the DE actuator was 8 Hz": the magnitude is then back at its static value, after the
    // resonance. At -3 dB it arrives later.
    let g = plant();
    let static_gain = g.dc_gain().unwrap();
    let relative = |hz: f64| g.at(rad_s(hz)).norm() / static_gain;
    let resonance_hz = 6.0;
    assert!(relative(resonance_hz) > 1.0);
    assert_rounds_to(first_fall_below(1.0, resonance_hz, relative), "8.10");
    assert_rounds_to(first_fall_below(0.5f64.sqrt(), resonance_hz, relative), "9.01");
}
