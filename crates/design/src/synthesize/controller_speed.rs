//! Removal of controller modes that are too fast to be run.

use nalgebra::DMatrix;
use telepulse_lti::schur::RealSchur;
use telepulse_lti::{Continuous, StateSpace};

use crate::Error;

/// Returns the controller with every mode beyond `limit_rad_s` replaced by its static gain.
///
/// `None` where that is impossible: a mode that is to go is not stable (its static gain is no approximation of it).
///
/// **Method**: ordered real Schur form, slow modes first: `[A11 A12; 0 A22]`. With `x2' = 0`,
/// `x2 = -A22⁻¹ B2 y`, so the slow modes keep their poles exactly and the DC gain does not change.
///
/// **Source**: Kokotovic, Khalil and O'Reilly 1986, singular perturbation.
///
/// **Errors**: those of the Schur form.
pub(super) fn slowed_down(
    controller: &StateSpace<Continuous>,
    limit_rad_s: f64,
) -> Result<Option<StateSpace<Continuous>>, Error> {
    let n = controller.n_states();
    let ordered = RealSchur::new(controller.a())?.order(|pole| pole.norm() <= limit_rad_s)?;
    let n_slow = ordered.n_selected;
    let (q, t) = (&ordered.form.q, &ordered.form.t);
    if ordered.form.eigenvalues()[n_slow..].iter().any(|pole| pole.re >= 0.0) {
        return Ok(None);
    }
    let (b, c) = (q.tr_mul(controller.b()), controller.c() * q);
    let n_fast = n - n_slow;
    let a22 = t.view((n_slow, n_slow), (n_fast, n_fast)).into_owned();
    let Some(static_state) = a22.lu().solve(&b.rows(n_slow, n_fast).into_owned()) else { return Ok(None) };
    let a12: DMatrix<f64> = t.view((0, n_slow), (n_slow, n_fast)).into_owned();
    let slow = StateSpace::<Continuous>::new(
        t.view((0, 0), (n_slow, n_slow)).into_owned(),
        b.rows(0, n_slow) - a12 * &static_state,
        c.columns(0, n_slow).into_owned(),
        controller.d() - c.columns(n_slow, n_fast) * static_state,
    )?;
    Ok(Some(slow.balanced()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use telepulse_lti::TransferFunction;

    #[test]
    fn law_slow_poles_and_dc_gain_are_kept() {
        // (s + 3) / ((s + 1)(s + 2)(s + 1e6)) · 1e6
        let k = TransferFunction::new(&[1e6, 3e6], &[1.0, 1e6 + 3.0, 3e6 + 2.0, 2e6])
            .expect("proper")
            .to_state_space();
        let slow = slowed_down(&k, 1e4).expect("schur").expect("the fast mode is stable");
        assert_eq!(slow.n_states(), 2);
        let mut poles: Vec<f64> = slow.poles().expect("qr").iter().map(|p| p.re).collect();
        poles.sort_by(f64::total_cmp);
        assert!((poles[0] + 2.0).abs() < 1e-8 && (poles[1] + 1.0).abs() < 1e-8, "{poles:?}");
        let (before, after) = (k.dc_gain().expect("stable")[(0, 0)], slow.dc_gain().expect("stable")[(0, 0)]);
        assert!((before - after).abs() < 1e-9 * before.abs());
    }

    #[test]
    fn edge_an_unstable_fast_mode_is_not_replaced() {
        let k = TransferFunction::new(&[1.0], &[1.0, -1e6]).expect("proper").to_state_space();
        assert!(slowed_down(&k, 1e4).expect("schur").is_none());
    }
}
