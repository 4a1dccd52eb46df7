//! Collocation against shooting on random membranes.

use telepulse_actuator::Error;
use telepulse_actuator::statics::{Electrodes, Load, Material, Sheet, Solution, shooting, solve};

use crate::statics::{MU_PA, OUTER_M, sheet, voltage_v};
use crate::{assert_close, uniform};

const CASES: usize = 1000;

struct Random(u64);

impl Random {
    fn between(&mut self, lower: f64, upper: f64) -> f64 {
        lower + (upper - lower) * uniform(&mut self.0)
    }

    fn material(&mut self) -> Material {
        match (3.0 * uniform(&mut self.0)) as usize {
            0 => Material::NeoHookean { mu_pa: MU_PA },
            1 => Material::Gent { mu_pa: MU_PA, limit: self.between(30.0, 200.0) },
            _ => {
                let exponents = [self.between(1.2, 2.2), self.between(3.0, 5.0), self.between(-3.0, -1.0)];
                let shares = [1.0, self.between(0.0, 0.05), self.between(0.0, 0.1)];
                let sum: f64 = shares.iter().sum();
                // Shares of the shear modulus, which is half the sum of mu alpha.
                let term = |k: usize| [2.0 * MU_PA * shares[k] / sum / exponents[k], exponents[k]];
                Material::Ogden { terms: vec![term(0), term(1), term(2)] }
            }
        }
    }
}

/// Compares everything that both methods report.
fn compare(ours: &Solution, other: &Solution, what: &str) {
    let close = |name: &str, a: f64, b: f64, relative: f64| {
        assert_close(a, b, relative, 0.0, &format!("{name}, {what}"));
    };
    let (a, b) = (&ours.point, &other.point);
    close("displacement", a.displacement_m, b.displacement_m, 1e-9);
    close("force", a.force_n, b.force_n, 1e-9);
    close("voltage", a.voltage_v, b.voltage_v, 1e-9);
    close("capacitance", a.capacitance_f, b.capacitance_f, 1e-9);
    close("lambda1 inner", ours.lambda1_inner(), other.lambda1_inner(), 1e-9);
    close("lambda1 outer", ours.lambda1_outer(), other.lambda1_outer(), 1e-9);
    close("theta inner", ours.theta_inner_rad(), other.theta_inner_rad(), 1e-9);
    close("theta outer", ours.theta_outer_rad(), other.theta_outer_rad(), 1e-9);
    // Stresses may pass through zero: they are compared with mu.
    let stress = |value: f64| value / MU_PA + 1.0;
    close("s1 inner", stress(ours.s1_inner_pa()), stress(other.s1_inner_pa()), 1e-9);
    close("s2 min", stress(a.s2_min_pa), stress(b.s2_min_pa), 1e-8);
    // Derivatives divide by a tension that may be small: required is 1e-6.
    let (a, b) = (&ours.derivatives, &other.derivatives);
    close("stiffness", a.stiffness_n_per_m, b.stiffness_n_per_m, 1e-8);
    close("dF/d(V^2)", a.dforce_dvoltage_squared_n_per_v2, b.dforce_dvoltage_squared_n_per_v2, 1e-8);
    // The capacitance hardly changes near the flat state: 1e-9 of C/B and of C/V is all that rounding leaves.
    let c = ours.point.capacitance_f;
    let (by_x, by_v) = (1e-9 * c / OUTER_M, 1e-9 * c / voltage_v(1.0));
    let what = format!("dC, {what}");
    assert_close(a.dcapacitance_dx_f_per_m, b.dcapacitance_dx_f_per_m, 1e-8, by_x, &what);
    assert_close(a.dcapacitance_dvoltage_f_per_v, b.dcapacitance_dvoltage_f_per_v, 1e-8, by_v, &what);
}

/// A random sheet with load and voltage, which need not have an equilibrium.
fn draw(random: &mut Random) -> (Sheet, Load, Electrodes) {
    loop {
        let inner = random.between(1.1, 2.6);
        // One third with an unequal pre-stretch.
        let outer = if uniform(&mut random.0) < 0.33 { inner * random.between(0.95, 1.2) } else { inner };
        let ratio = random.between(0.08, 0.6);
        let Ok(sheet) = sheet(random.material(), ratio, [inner, outer.max(1.05)]) else { continue };
        let v = voltage_v(random.between(0.0, 0.45));
        let load = if uniform(&mut random.0) < 0.5 {
            Load::ForceN(random.between(0.005, 0.4) * sheet.force_scale_n())
        } else {
            Load::DisplacementM(random.between(0.01, 0.8) * OUTER_M)
        };
        return (sheet, load, Electrodes::VoltageV(v));
    }
}

#[test]
fn law_collocation_and_shooting_agree_on_1000_random_membranes() {
    let seed = 2017_u64;
    let mut random = Random(seed);
    let (mut valid, mut drawn) = (0, 0);
    let mut refused = [0_usize; 5];
    while valid < CASES {
        drawn += 1;
        assert!(drawn < 4 * CASES, "too few valid cases: {valid} of {drawn}, refused {refused:?}");
        let (sheet, load, electrodes) = draw(&mut random);
        let what = format!("draw {drawn} of seed {seed}: {:?}, {load:?}, {electrodes:?}", sheet.spec());
        let ours = match solve(&sheet, load, electrodes) {
            Ok(ours) => ours,
            Err(error) => {
                let kind = match error {
                    Error::Slack { .. } => 0,
                    Error::BeyondLimitPoint { .. } => 1,
                    Error::GentLimit { .. } => 2,
                    Error::NotConverged { .. } => 3,
                    Error::PullIn { .. } => 4,
                    other => panic!("{what}: {other}"),
                };
                refused[kind] += 1;
                // What collocation refuses, shooting must not find. A failing search takes long: every third is tried.
                if drawn % 3 == 0
                    && let Ok(found) = shooting::solve(&sheet, load, electrodes)
                {
                    panic!("{what}: refused with {error}, but shooting finds {:?}", found.point);
                }
                continue;
            }
        };
        let other = shooting::solve(&sheet, load, electrodes)
            .unwrap_or_else(|error| panic!("{what}: {error}; collocation finds {:?}", ours.point));
        compare(&ours, &other, &what);
        valid += 1;
    }
    // Slack and unstable cases occur among the draws; a membrane without a reason does not.
    assert_eq!(refused[3], 0, "{refused:?} of {drawn}");
    assert!(refused[0] > 5 && refused[4] > 5, "{refused:?}");
}

#[test]
fn law_both_methods_agree_with_charge_held_and_upward_loads() {
    let gent = Material::Gent { mu_pa: MU_PA, limit: 80.0 };
    let sheet = sheet(gent, 0.25, [1.8, 1.9]).expect("valid");
    let base = solve(&sheet, Load::DisplacementM(0.3 * OUTER_M), Electrodes::VoltageV(voltage_v(0.15)))
        .expect("taut");
    for load in [
        Load::DisplacementM(0.2 * OUTER_M),
        Load::DisplacementM(-0.2 * OUTER_M),
        Load::ForceN(base.point.force_n),
        Load::ForceN(-base.point.force_n),
    ] {
        let charge = Electrodes::ChargeC(base.point.charge_c);
        let ours = solve(&sheet, load, charge).expect("taut");
        let other = shooting::solve(&sheet, load, charge).expect("taut");
        compare(&ours, &other, &format!("{load:?} with charge held"));
    }
}
