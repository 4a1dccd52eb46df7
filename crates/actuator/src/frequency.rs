//! Small vibrations of the full viscoelastic membrane about a bias: one complex solve for each frequency.

use nalgebra::{Complex, DMatrix, DVector};

use crate::material::{electrical, neo_hookean};
use crate::statics::{Electrodes, Load, StaticSolver};
use crate::{ActuatorParameters, Error};

/// A fractional branch ("spring-pot") beside the Maxwell branches: complex modulus mu (j omega tau)^alpha.
///
/// **Source**: Scott Blair 1947; the limits alpha = 0 and 1 are a spring and a dashpot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FractionalBranch {
    /// Modulus mu, Pa.
    pub modulus_pa: f64,
    /// Time tau, s.
    pub time_s: f64,
    /// Exponent alpha, between 0 and 1.
    pub exponent: f64,
}

/// Complex derivatives of the force F(x, V) at one frequency.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DynamicTangent {
    /// dF/dx at held voltage, N/m.
    pub stiffness_n_per_m: Complex<f64>,
    /// dF/dV at held displacement, N/V.
    pub dforce_dvoltage_n_per_v: Complex<f64>,
}

/// The actuator at rest under its load at a bias, all branches relaxed there, ready to be shaken.
///
/// **Method**: about a relaxed state a branch adds `m(j omega) = sum mu_i j omega tau_i/(1 + j omega tau_i)` times the
/// tangent of a relaxed neo-Hookean network, 4/l1^2, 2/(l1 l2), 4/l2^2, at every node: no reduction to a few coordinates. The
/// condensed equations of [`StaticSolver`] are solved with these complex moduli.
///
/// **Source**: branches by Foo, Cai, Koh, Bauer, Suo 2012, linearised.
///
/// **Accuracy**: the membrane's own inertia is left out (first mode about 120 Hz).
///
/// **Example**
/// ```
/// use telepulse_actuator::{ParameterSet, frequency::MembraneResponse};
/// let response = MembraneResponse::new(&ParameterSet::A.parameters(), 2500.0)?;
/// // Slow changes see the relaxed membrane.
/// let slow = response.displacement_mm_per_unit(1e-6)?;
/// assert!((slow.re - 0.971_572_337).abs() < 1e-6);
/// # Ok::<(), telepulse_actuator::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct MembraneResponse {
    parameters: ActuatorParameters,
    fractional: Option<FractionalBranch>,
    bias_v: f64,
    displacement_m: f64,
    differentiation: DMatrix<f64>,
    nodes: Vec<Node>,
    length_scale_m: f64,
    force_scale_n: f64,
    field_scale_per_v2: f64,
}

/// A node of the bias state; moduli over mu.
#[derive(Debug, Clone, Copy)]
struct Node {
    rho: f64,
    weight: f64,
    /// cos(theta) and -sin(theta).
    direction: [f64; 2],
    /// s1/l1.
    geometric: f64,
    /// ds1/dl1, ds1/dl2, ds2/dl2 of network and field.
    moduli: [f64; 3],
    /// The same of a branch of modulus mu, relaxed here.
    branch: [f64; 3],
    /// ds1, ds2 by v^2.
    by_field: [f64; 2],
}

/// A node's derivatives at one frequency with q eliminated.
struct Condensed {
    p_p: Complex<f64>,
    p_r: Complex<f64>,
    s2_r: Complex<f64>,
    by_p: Complex<f64>,
    by_r: Complex<f64>,
    by_force: Complex<f64>,
    /// P, s2 and q by v^2.
    p_field: Complex<f64>,
    s2_field: Complex<f64>,
    by_field: Complex<f64>,
}

impl MembraneResponse {
    /// At rest under the weight of plate and load at `bias_v`.
    ///
    /// # Errors
    /// [`Error::ZeroBias`], where the input gain vanishes; those of [`StaticSolver::solve`].
    pub fn new(parameters: &ActuatorParameters, bias_v: f64) -> Result<Self, Error> {
        if bias_v == 0.0 {
            return Err(Error::ZeroBias { bias_v });
        }
        let sheet = parameters.sheet()?;
        let mut solver = StaticSolver::new(&sheet)?;
        let point = solver.solve(Load::ForceN(parameters.weight_n()), Electrodes::VoltageV(bias_v))?;
        let (grid, state) = (solver.grid(), solver.profile()?);
        let field = sheet.field_scale_per_v2() * bias_v * bias_v;
        let (length, mu_pa) = (sheet.length_scale_m(), sheet.shear_modulus_pa());
        let mut nodes = Vec::with_capacity(grid.n_nodes());
        for j in 0..grid.n_nodes() {
            let (l1, l2, theta) = (state.lambda1[j], state.lambda2[j], state.theta_rad[j]);
            let mut total = sheet.law().stress(l1, l2).ok_or(Error::NoEquilibrium)?;
            let electric = electrical(l1, l2);
            total.add_scaled(&electric, field);
            // A relaxed branch: W(l1/xi1, l2/xi2) at xi = l.
            let relaxed = neo_hookean(1.0, 1.0);
            nodes.push(Node {
                rho: state.radius_undeformed_m[j] / length,
                weight: grid.weights()[j],
                direction: [theta.cos(), -theta.sin()],
                geometric: state.s1_pa[j] / mu_pa / l1,
                moduli: [total.s11, total.s12, total.s22],
                branch: [relaxed.s11 / (l1 * l1), relaxed.s12 / (l1 * l2), relaxed.s22 / (l2 * l2)],
                by_field: [electric.s1, electric.s2],
            });
        }
        Ok(Self {
            parameters: parameters.clone(),
            fractional: None,
            bias_v,
            displacement_m: point.displacement_m,
            differentiation: grid.differentiation().clone(),
            nodes,
            length_scale_m: length,
            force_scale_n: sheet.force_scale_n(),
            field_scale_per_v2: sheet.field_scale_per_v2(),
        })
    }

    /// The same actuator with a fractional branch beside the others.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a modulus or time that is not positive, or an exponent outside of 0..1.
    pub fn with_fractional(mut self, branch: FractionalBranch) -> Result<Self, Error> {
        for (key, found) in [("modulus_pa", branch.modulus_pa), ("time_s", branch.time_s)] {
            if !(found.is_finite() && found > 0.0) {
                return Err(Error::Parameter { key, allowed: "finite and positive", found });
            }
        }
        if !(0.0..=1.0).contains(&branch.exponent) {
            let (key, allowed) = ("exponent", "between 0 (spring) and 1 (dashpot)");
            return Err(Error::Parameter { key, allowed, found: branch.exponent });
        }
        self.fractional = Some(branch);
        Ok(self)
    }

    /// Displacement of the plate below the frame at the bias, m.
    #[must_use]
    pub fn displacement_m(&self) -> f64 {
        self.displacement_m
    }

    /// Complex modulus of all branches over mu.
    fn branch_modulus(&self, omega_rad_s: f64) -> Complex<f64> {
        let s = Complex::new(0.0, omega_rad_s);
        let spec = self.parameters.spec();
        let maxwell: Complex<f64> = spec
            .branches
            .iter()
            .map(|branch| {
                let turn = s * branch.relaxation_time_s;
                turn / (turn + 1.0) * branch.modulus_pa
            })
            .sum();
        let fractional = self.fractional.map_or(Complex::new(0.0, 0.0), |branch| {
            let size = branch.modulus_pa * (omega_rad_s * branch.time_s).powf(branch.exponent);
            Complex::from_polar(size, branch.exponent * std::f64::consts::FRAC_PI_2)
        });
        (maxwell + fractional) / spec.mu_pa
    }

    /// Derivatives of the force at `omega_rad_s`.
    ///
    /// # Errors
    /// [`Error::Request`] for a frequency that is negative or no number; [`Error::SingularTangent`].
    pub fn tangent(&self, omega_rad_s: f64) -> Result<DynamicTangent, Error> {
        if !(omega_rad_s.is_finite() && omega_rad_s >= 0.0) {
            let (quantity, allowed) = ("omega_rad_s", "finite and not negative");
            return Err(Error::Request { quantity, allowed, found: omega_rad_s });
        }
        let modulus = self.branch_modulus(omega_rad_s);
        let points: Vec<Condensed> = self.nodes.iter().map(|node| node.condense(modulus)).collect();
        let (matrix, causes) = self.assemble(&points);
        let solved = matrix
            .lu()
            .solve(&causes)
            .ok_or(Error::SingularTangent { voltage_v: self.bias_v, displacement_m: self.displacement_m })?;
        let last = solved.nrows() - 1;
        let per_v2 = self.force_scale_n * self.field_scale_per_v2;
        Ok(DynamicTangent {
            stiffness_n_per_m: solved[(last, 0)] * (self.force_scale_n / self.length_scale_m),
            dforce_dvoltage_n_per_v: solved[(last, 1)] * (2.0 * self.bias_v * per_v2),
        })
    }

    /// Displacement (mm) for a drive of one unit at `omega_rad_s`, through circuit, membrane and plate.
    ///
    /// # Errors
    /// Those of [`MembraneResponse::tangent`].
    pub fn displacement_mm_per_unit(&self, omega_rad_s: f64) -> Result<Complex<f64>, Error> {
        let tangent = self.tangent(omega_rad_s)?;
        let spec = self.parameters.spec();
        let s = Complex::new(0.0, omega_rad_s);
        // (m s^2 + c s + K) x = -F_V V, V = u/(1 + s R C).
        let plate = s * s * spec.mass_kg + s * spec.damping_n_s_per_m + tangent.stiffness_n_per_m;
        let voltage = Complex::from(spec.full_scale_v) / (s * spec.rc_s + 1.0);
        Ok(-tangent.dforce_dvoltage_n_per_v * voltage / plate * 1e3)
    }

    /// Matrix over (dr at inner nodes, df), and its right-hand sides for unit changes of x and of v^2.
    fn assemble(&self, points: &[Condensed]) -> (DMatrix<Complex<f64>>, DMatrix<Complex<f64>>) {
        let d = &self.differentiation;
        let n = points.len() - 1;
        let size = n;
        let mut matrix = DMatrix::<Complex<f64>>::zeros(size, size);
        let mut causes = DMatrix::<Complex<f64>>::zeros(size, 2);
        let column = |values: &dyn Fn(&Condensed) -> Complex<f64>| {
            DVector::from_iterator(n + 1, points.iter().map(values))
        };
        let derivative = |values: &DVector<Complex<f64>>, i: usize| -> Complex<f64> {
            values.iter().enumerate().map(|(j, value)| value * d[(i, j)]).sum()
        };
        let (force, field) = (column(&|point| -point.by_p), column(&|point| point.p_field));
        for i in 1..n {
            for k in 1..n {
                let product: Complex<f64> =
                    points.iter().enumerate().map(|(j, point)| point.p_p * (d[(i, j)] * d[(j, k)])).sum();
                matrix[(i - 1, k - 1)] = product + (points[k].p_r - points[i].p_r) * d[(i, k)];
            }
            matrix[(i - 1, i - 1)] -= points[i].s2_r;
            matrix[(i - 1, n - 1)] = derivative(&force, i) + points[i].by_r;
            causes[(i - 1, 1)] = points[i].s2_field - derivative(&field, i);
        }
        // x = -sum w q with dq = -(by_p dp + by_r dr + by_force df + by_field dv^2).
        for (j, (point, node)) in points.iter().zip(&self.nodes).enumerate() {
            for k in 1..n {
                matrix[(n - 1, k - 1)] += point.by_p * (node.weight * d[(j, k)]);
            }
            if (1..n).contains(&j) {
                matrix[(n - 1, j - 1)] += point.by_r * node.weight;
            }
            matrix[(n - 1, n - 1)] += point.by_force * node.weight;
            causes[(n - 1, 1)] -= point.by_field * node.weight;
        }
        causes[(n - 1, 0)] = Complex::new(1.0, 0.0);
        (matrix, causes)
    }
}

impl Node {
    /// The node with complex moduli and q eliminated; see `statics::linearised`.
    fn condense(&self, branch_modulus: Complex<f64>) -> Condensed {
        let [s11, s12, s22]: [Complex<f64>; 3] =
            std::array::from_fn(|k| branch_modulus * self.branch[k] + self.moduli[k]);
        let [c, d] = self.direction;
        let (rho, geometric) = (self.rho, self.geometric);
        let p_q = (s11 - geometric) * (rho * c * d);
        let q_q = (s11 * (d * d) + geometric * c * c) * rho;
        let by_force = q_q.inv();
        let (by_p, by_r) = (p_q * by_force, s12 * d * by_force);
        let q_field = rho * self.by_field[0] * d;
        Condensed {
            p_p: (s11 * (c * c) + geometric * d * d) * rho - p_q * by_p,
            p_r: s12 * c - p_q * by_r,
            s2_r: s22 / rho - s12 * d * by_r,
            by_p,
            by_r,
            by_force,
            p_field: Complex::from(rho * self.by_field[0] * c) - by_p * q_field,
            s2_field: Complex::from(self.by_field[1]) - by_r * q_field,
            by_field: by_force * q_field,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linearize::linearize;
    use crate::{ActuatorSpec, MaxwellBranch, ParameterSet};

    fn response(set: ParameterSet) -> MembraneResponse {
        MembraneResponse::new(&set.parameters(), 2500.0).expect("taut")
    }

    fn omega(hz: f64) -> f64 {
        2.0 * std::f64::consts::PI * hz
    }

    #[test]
    fn oracle_slow_and_fast_ends_of_set_a() {
        // device_examples.json at 2.5 kV: relaxed and frozen stiffness and gain.
        let a = response(ParameterSet::A);
        let slow = a.tangent(0.0).expect("regular");
        let fast = a.tangent(1e9).expect("regular");
        for (found, expected) in [
            (slow.stiffness_n_per_m, 139.162_200_519_959_98),
            (slow.dforce_dvoltage_n_per_v, -2.704_122_888_541_604_7e-5),
            (fast.stiffness_n_per_m, 144.428_331_812_940_23),
            (fast.dforce_dvoltage_n_per_v, -2.696_464_567_109_036e-5),
        ] {
            // The stored frozen values have 9 digits; at 1e9 rad/s the branches are frozen to 1e-9.
            assert!((found - expected).norm() < 1e-8 * expected.abs(), "{found} {expected}");
        }
    }

    #[test]
    fn paper_eq16_set_a_stays_within_its_stated_ratio_from_0_1_to_13_hz() {
        let a = response(ParameterSet::A);
        for idx in 0..=60 {
            let w = omega(0.1 * 130.0_f64.powf(f64::from(idx) / 60.0));
            let s = Complex::new(0.0, w);
            let printed = 1350.14 / ((s * 0.0045 + 1.0) * (s * s + s * 15.96 + 1444.0));
            let ratio = a.displacement_mm_per_unit(w).expect("regular").norm() / printed.norm();
            // Stated 0.998-1.012, to three digits.
            assert!((0.9975..=1.0125).contains(&ratio), "{w} rad/s: {ratio}");
        }
    }

    #[test]
    fn law_branch_states_of_the_linearisation_follow_the_full_field() {
        // Two coordinates stand for a field of strains: exact without branches, 0.1 % and 0.1 degree for A.
        for (set, allowed) in [(ParameterSet::C, 1e-9), (ParameterSet::A, 1e-3)] {
            let (full, linear) = (response(set), linearize(&set.parameters(), 2500.0).expect("taut"));
            for idx in 0..=40 {
                let w = omega(0.01 * 1300.0_f64.powf(f64::from(idx) / 40.0));
                let expected = full.displacement_mm_per_unit(w).expect("regular");
                let found = linear.system.at(w).expect("no pole on the axis")[(0, 0)];
                assert!(
                    (found - expected).norm() < allowed * expected.norm(),
                    "{set:?}, {w}: {found} {expected}"
                );
            }
        }
    }

    #[test]
    fn law_fractional_branch_is_a_spring_a_dashpot_and_lossy_between() {
        let elastic = ParameterSet::C.parameters();
        let with = |exponent| {
            let branch = FractionalBranch { modulus_pa: 2e4, time_s: 0.01, exponent };
            response(ParameterSet::C).with_fractional(branch).expect("valid")
        };
        // A dashpot of 200 Pa s is the slow end of a stiff Maxwell branch with the same product of modulus and time.
        let dashpot = ActuatorSpec {
            branches: vec![MaxwellBranch { modulus_pa: 2e10, relaxation_time_s: 1e-8 }],
            ..elastic.spec().clone()
        };
        let dashpot = ActuatorParameters::new(dashpot).expect("valid");
        let dashpot = MembraneResponse::new(&dashpot, 2500.0).expect("taut");
        let w = omega(3.0);
        let stiffness = |response: &MembraneResponse| response.tangent(w).expect("regular").stiffness_n_per_m;
        let (expected, found) = (stiffness(&dashpot), stiffness(&with(1.0)));
        // The branch's own relaxation at w tau = 2e-7.
        assert!((found - expected).norm() < 1e-6 * expected.norm(), "{found} {expected}");
        let spring = stiffness(&with(0.0));
        assert!(spring.im.abs() < 1e-9 && spring.re > stiffness(&response(ParameterSet::C)).re);
        let between = stiffness(&with(0.3));
        assert!(between.im > 0.0, "a passive branch dissipates: {between}");
    }

    #[test]
    fn edge_zero_bias_bad_frequency_and_bad_branch_are_refused() {
        let a = ParameterSet::A.parameters();
        assert_eq!(MembraneResponse::new(&a, 0.0).err(), Some(Error::ZeroBias { bias_v: 0.0 }));
        let a = response(ParameterSet::A);
        assert!(matches!(a.tangent(f64::NAN), Err(Error::Request { quantity: "omega_rad_s", .. })));
        let branch = FractionalBranch { modulus_pa: 1e4, time_s: 1.0, exponent: 1.5 };
        assert!(matches!(a.with_fractional(branch), Err(Error::Parameter { key: "exponent", .. })));
    }
}
