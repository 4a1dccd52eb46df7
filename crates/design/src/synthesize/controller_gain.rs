//! The peak gain of a controller, stable or not.

use nalgebra::DMatrix;
use telepulse_lti::{Continuous, StateSpace, hinf_norm, riccati};

use crate::Error;

/// Returns the largest singular value of the frequency response over all frequencies.
///
/// **Method**: a right coprime factorization `K = N M⁻¹` with `M` inner mirrors the unstable poles; on the imaginary axis
/// `M` is unitary, so the stable `N` has the singular values of `K`.
///
/// **Source**: Zhou, Doyle and Glover 1996, theorem 13.37.
///
/// **Errors**: [`telepulse_lti::Error::Unstable`] for a pole on the imaginary axis, where the gain is infinite.
pub(super) fn peak_gain(controller: &StateSpace<Continuous>) -> Result<f64, Error> {
    let poles = controller.poles()?;
    if poles.iter().all(|pole| pole.re < 0.0) {
        return Ok(hinf_norm(controller)?.upper);
    }
    let (a, b, c, d) = (controller.a(), controller.b(), controller.c(), controller.d());
    let n = controller.n_states();
    let axis = || {
        let nearest = poles.iter().min_by(|p, q| p.re.abs().total_cmp(&q.re.abs()));
        telepulse_lti::Error::Unstable { pole: nearest.copied().unwrap_or_default() }
    };
    // Aᵀ X + X A - X B Bᵀ X = 0 with A - B Bᵀ X stable.
    let x = riccati::continuous(a, &(b * b.transpose()), &DMatrix::zeros(n, n)).map_err(|_| axis())?.x;
    let f = -b.tr_mul(&x);
    let mirrored = StateSpace::<Continuous>::new(a + b * &f, b.clone(), c + d * f, d.clone())?;
    Ok(hinf_norm(&mirrored)?.upper)
}

#[cfg(test)]
mod tests {
    use super::*;
    use telepulse_lti::TransferFunction;

    #[test]
    fn law_a_mirrored_pole_keeps_the_gain() {
        // |1 / (jω ± 2)| peaks at 1/2; |10 / ((jω)² ± 0.2 jω + 1)| peaks at 10 / (0.2 sqrt(0.99)).
        for (numerator, denominator, exact) in [
            (vec![1.0], vec![1.0, 2.0], 0.5),
            (vec![1.0], vec![1.0, -2.0], 0.5),
            (vec![10.0], vec![1.0, 0.2, 1.0], 50.0 / 0.99_f64.sqrt()),
            (vec![10.0], vec![1.0, -0.2, 1.0], 50.0 / 0.99_f64.sqrt()),
        ] {
            let k = TransferFunction::new(&numerator, &denominator).expect("proper").to_state_space();
            let found = peak_gain(&k).expect("no pole on the axis");
            assert!((found / exact - 1.0).abs() < 1e-8, "{found} {exact}");
        }
    }

    #[test]
    fn edge_an_integrator_has_no_peak() {
        let k = TransferFunction::new(&[1.0], &[1.0, 0.0]).expect("proper").to_state_space();
        assert!(matches!(peak_gain(&k), Err(Error::System(telepulse_lti::Error::Unstable { .. }))));
    }
}
