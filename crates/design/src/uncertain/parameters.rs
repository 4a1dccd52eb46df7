//! Physical parameters in ranges: from a model that depends on them to a system with real blocks around it.

use nalgebra::DMatrix;
use telepulse_lti::{Continuous, StateSpace};

use super::affine_factor::{Factors, factor};
use super::descriptor::{DescriptorSystem, solve};
use super::structure::{Block, BlockStructure, BlockValue, Perturbation};
use super::system::UncertainSystem;
use crate::Error;

/// A parameter that lies somewhere between two ends.
#[derive(Clone, Debug, PartialEq)]
pub struct ParameterRange {
    name: String,
    lower: f64,
    upper: f64,
}

impl ParameterRange {
    /// A range, in the unit in which the model takes the parameter.
    ///
    /// **Errors**: [`Error::ParameterRange`] unless both ends are finite and `lower < upper`.
    pub fn new(name: impl Into<String>, lower: f64, upper: f64) -> Result<Self, Error> {
        let name = name.into();
        // The width, too: ends of 1e308 with opposite signs have none that is a number.
        if lower < upper && (upper - lower).is_finite() {
            return Ok(Self { name, lower, upper });
        }
        Err(Error::ParameterRange { name, lower, upper })
    }

    /// How messages call the parameter.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The parameter at `delta`: -1 is the lower end, 0 the centre, 1 the upper end; beyond, the line goes on.
    #[must_use]
    pub fn value(&self, delta: f64) -> f64 {
        0.5 * self.lower + 0.5 * self.upper + delta * (0.5 * self.upper - 0.5 * self.lower)
    }

    /// The `delta` at which the parameter has this value.
    #[must_use]
    pub fn delta(&self, value: f64) -> f64 {
        (value - self.value(0.0)) / (0.5 * self.upper - 0.5 * self.lower)
    }
}

/// The systems with one parameter at its ends and all others at their centres.
#[derive(Clone, Debug, PartialEq)]
pub struct RangeEnds {
    /// With the parameter at its lower end.
    pub lower: DescriptorSystem,
    /// With the parameter at its upper end.
    pub upper: DescriptorSystem,
}

/// A system that depends on parameters in ranges, with one real block for each of them.
///
/// **Example**: a mass on a spring with a damper, moved by a force.
/// ```
/// use nalgebra::dmatrix;
/// use telepulse_design::uncertain::{Block, DescriptorSystem, ParameterRange, ParametricSystem};
/// let parameters = vec![
///     ParameterRange::new("m", 0.9, 1.1)?, ParameterRange::new("c", 0.2, 0.4)?, ParameterRange::new("k", 0.8, 1.2)?,
/// ];
/// let plant = ParametricSystem::from_model(parameters, |p| DescriptorSystem::new(
///     dmatrix![1.0, 0.0; 0.0, p[0]], dmatrix![0.0, 1.0; -p[2], -p[1]],
///     dmatrix![0.0; 1.0], dmatrix![1.0, 0.0], dmatrix![0.0]))?;
/// assert_eq!(plant.system().structure().blocks(), [Block::RepeatedReal { size: 1 }; 3]);
/// let exact = 1.0 / num_complex::Complex64::new(0.85 - 1.05 * 4.0, 2.0 * 0.25);
/// assert!((plant.at(&[1.05, 0.25, 0.85])?.at(2.0)?[(0, 0)] - exact).norm() < 1e-14);
/// # Ok::<(), telepulse_design::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct ParametricSystem {
    parameters: Vec<ParameterRange>,
    system: UncertainSystem,
}

impl ParametricSystem {
    /// A system from its model, which is called with the values of the parameters in their order.
    ///
    /// **Method**: [`Self::from_ends`] on the model at the centre and the ends. The model is then compared with its affine form inside of
    /// each range, at the four corners of each pair of ranges and at up to 256 corners of all of them.
    ///
    /// **Accuracy**: outside of the points that were compared, the model is taken at its word to be affine in `E, A, B, C, D`.
    ///
    /// **Errors**: those of the model and of [`Self::from_ends`]; [`Error::NotAffine`] names the parameter, or the two, at fault.
    pub fn from_model(
        parameters: Vec<ParameterRange>,
        model: impl Fn(&[f64]) -> Result<DescriptorSystem, Error>,
    ) -> Result<Self, Error> {
        let at = |deltas: &[f64]| {
            let values: Vec<f64> = parameters.iter().zip(deltas).map(|(p, &delta)| p.value(delta)).collect();
            model(&values)
        };
        let n = parameters.len();
        let single = |index: usize, delta: f64| {
            let mut deltas = vec![0.0; n];
            deltas[index] = delta;
            deltas
        };
        let nominal = at(&vec![0.0; n])?;
        let ends = (0..n)
            .map(|i| Ok(RangeEnds { lower: at(&single(i, -1.0))?, upper: at(&single(i, 1.0))? }))
            .collect::<Result<Vec<_>, Error>>()?;
        let affine = Affine::new(&parameters, &nominal, &ends)?;
        for index in 0..n {
            for delta in INSIDE {
                let deltas = single(index, delta);
                affine.check(&parameters, &deltas, &at(&deltas)?)?;
            }
        }
        for first in 0..n {
            for second in 0..first {
                for (x, y) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
                    let mut deltas = single(first, x);
                    deltas[second] = y;
                    affine.check(&parameters, &deltas, &at(&deltas)?)?;
                }
            }
        }
        for corner in 0..1_usize << n.min(CORNER_BITS_MAX) {
            let deltas: Vec<f64> =
                (0..n).map(|i| if corner >> (i % CORNER_BITS_MAX) & 1 == 1 { 1.0 } else { -1.0 }).collect();
            affine.check(&parameters, &deltas, &at(&deltas)?)?;
        }
        affine.system(parameters, &nominal)
    }

    /// A system from the one with all parameters at their centres and those with one of them at an end.
    ///
    /// **Method**: the change of `[A B -E; C D 0]` from the centre to an end is factored through its rank, after scaling that takes out
    /// the units, and the block of the parameter is that large.
    ///
    /// **Accuracy**: the system with the parameters put in is that of the affine form to rounding. Products of two parameters do not show
    /// in these systems; [`Self::from_model`] looks for them.
    ///
    /// **Errors**: [`Error::NoUncertainBlocks`] without parameters, [`Error::ParameterCount`] unless there is one pair of ends
    /// for each, [`Error::ParameterShape`] where an end has other sizes than the centre, [`Error::NotAffine`] where the
    /// centre is not midway between the ends, [`Error::ParameterWithoutEffect`], [`Error::SingularDescriptor`].
    pub fn from_ends(
        parameters: Vec<ParameterRange>,
        nominal: &DescriptorSystem,
        ends: &[RangeEnds],
    ) -> Result<Self, Error> {
        Affine::new(&parameters, nominal, ends)?.system(parameters, nominal)
    }

    /// The parameters in the order of their blocks.
    #[must_use]
    pub fn parameters(&self) -> &[ParameterRange] {
        &self.parameters
    }

    /// The system with a real block for each parameter at its first ports.
    #[must_use]
    pub fn system(&self) -> &UncertainSystem {
        &self.system
    }

    /// The system with these values of the parameters, inside of their ranges or not.
    ///
    /// **Errors**: [`Error::ParameterCount`], [`telepulse_lti::Error::NotFinite`], and as [`UncertainSystem::close`].
    pub fn at(&self, values: &[f64]) -> Result<StateSpace<Continuous>, Error> {
        if values.len() != self.parameters.len() {
            return Err(Error::ParameterCount { expected: self.parameters.len(), found: values.len() });
        }
        let deltas = self.parameters.iter().zip(values).map(|(p, &value)| BlockValue::Real(p.delta(value)));
        let delta = Perturbation { values: deltas.collect() }.matrix(self.system.structure())?;
        self.system.close(&StateSpace::<Continuous>::from_gain(delta.map(|v| v.re))?)
    }

    /// The values of the parameters at a perturbation whose first blocks are those of this system.
    ///
    /// **Errors**: [`Error::BlockMismatch`] where a block is missing or not real.
    pub fn values(&self, perturbation: &Perturbation) -> Result<Vec<f64>, Error> {
        let value = |(index, p): (usize, &ParameterRange)| match perturbation.values.get(index) {
            Some(BlockValue::Real(delta)) => Ok(p.value(*delta)),
            _ => Err(Error::BlockMismatch { index }),
        };
        self.parameters.iter().enumerate().map(value).collect()
    }
}

/// `[A B -E; C D 0]` as its value at the centre and its change from there to the upper ends.
struct Affine {
    centre: DMatrix<f64>,
    changes: Vec<DMatrix<f64>>,
    /// Largest magnitude that each entry has at the centre or an end.
    sizes: DMatrix<f64>,
}

impl Affine {
    fn new(
        parameters: &[ParameterRange],
        nominal: &DescriptorSystem,
        ends: &[RangeEnds],
    ) -> Result<Self, Error> {
        if parameters.is_empty() {
            return Err(Error::NoUncertainBlocks);
        }
        if ends.len() != parameters.len() {
            return Err(Error::ParameterCount { expected: parameters.len(), found: ends.len() });
        }
        let centre = nominal.coefficients();
        let mut sizes = centre.abs();
        let mut changes = Vec::with_capacity(ends.len());
        for (parameter, pair) in parameters.iter().zip(ends) {
            for end in [&pair.lower, &pair.upper] {
                same_sizes(nominal, end, || parameter.name.clone())?;
                sizes = sizes.zip_map(&end.coefficients(), |size, v| size.max(v.abs()));
            }
            changes.push(pair.upper.coefficients() * 0.5 - pair.lower.coefficients() * 0.5);
        }
        let affine = Self { centre, changes, sizes };
        for (index, pair) in ends.iter().enumerate() {
            for (delta, end) in [(-1.0, &pair.lower), (1.0, &pair.upper)] {
                let mut deltas = vec![0.0; ends.len()];
                deltas[index] = delta;
                affine.check(parameters, &deltas, end)?;
            }
        }
        Ok(affine)
    }

    /// Whether the affine form gives this system, entry by entry.
    fn check(
        &self,
        parameters: &[ParameterRange],
        deltas: &[f64],
        found: &DescriptorSystem,
    ) -> Result<(), Error> {
        let moved: Vec<usize> = (0..deltas.len()).filter(|&i| deltas[i] != 0.0).collect();
        let names = || moved.iter().map(|&i| parameters[i].name.clone()).collect::<Vec<_>>().join("`, `");
        let found = found.coefficients();
        if found.shape() != self.centre.shape() {
            return Err(Error::ParameterShape { parameter: names() });
        }
        let mut form = self.centre.clone();
        for &i in &moved {
            form += &self.changes[i] * deltas[i];
        }
        let mut deviation = 0.0_f64;
        for ((form, found), size) in form.iter().zip(&found).zip(&self.sizes) {
            let size = size.max(found.abs());
            if size > 0.0 {
                deviation = deviation.max((found - form).abs() / size);
            }
        }
        if deviation <= AFFINE_TOLERANCE {
            return Ok(());
        }
        let values: Vec<f64> = moved.iter().map(|&i| parameters[i].value(deltas[i])).collect();
        Err(Error::NotAffine { parameter: names(), values, deviation, allowed: AFFINE_TOLERANCE })
    }

    /// The linear fractional form, with `w_i = delta_i z_i` where `change_i = L_i R_i`:
    ///
    /// ```text
    ///   E x' = A x + B u + sum L_i1 w_i,   y = C x + D u + sum L_i2 w_i,   z_i = R_i [x; u; x']
    /// ```
    fn system(
        self,
        parameters: Vec<ParameterRange>,
        nominal: &DescriptorSystem,
    ) -> Result<ParametricSystem, Error> {
        let [n, m, p] = nominal.sizes();
        let noise = &self.sizes * (NOISE * f64::EPSILON);
        let (mut left, mut right) = (DMatrix::zeros(n + p, 0), DMatrix::zeros(0, n + m + n));
        let mut blocks = Vec::with_capacity(parameters.len());
        for (parameter, change) in parameters.iter().zip(&self.changes) {
            let Factors { left: l, right: r } = factor(change, &noise)?;
            if l.ncols() == 0 {
                return Err(Error::ParameterWithoutEffect { parameter: parameter.name.clone() });
            }
            blocks.push(Block::RepeatedReal { size: l.ncols() });
            let at = left.ncols();
            left = left.insert_columns(at, l.ncols(), 0.0);
            left.columns_mut(at, l.ncols()).copy_from(&l);
            right = right.insert_rows(at, r.nrows(), 0.0);
            right.rows_mut(at, r.nrows()).copy_from(&r);
        }
        let n_w = left.ncols();
        let part = |rows: (usize, usize), cols: (usize, usize)| {
            self.centre.view((rows.0, cols.0), (rows.1, cols.1)).into_owned()
        };
        // x' = F [x; w; u].
        let mut forces = DMatrix::zeros(n, n + n_w + m);
        forces.columns_mut(0, n).copy_from(&part((0, n), (0, n)));
        forces.columns_mut(n, n_w).copy_from(&left.rows(0, n));
        forces.columns_mut(n + n_w, m).copy_from(&part((0, n), (n, m)));
        let derivative = solve(&-part((0, n), (n + m, n)), &forces)?;
        let mut out = DMatrix::zeros(n_w + p, n + n_w + m);
        out.view_mut((0, 0), (n_w, n)).copy_from(&right.columns(0, n));
        out.view_mut((0, n + n_w), (n_w, m)).copy_from(&right.columns(n, m));
        let through = right.columns(n + m, n) * &derivative;
        let mut z = out.rows_mut(0, n_w);
        z += through;
        out.view_mut((n_w, 0), (p, n)).copy_from(&part((n, p), (0, n)));
        out.view_mut((n_w, n), (p, n_w)).copy_from(&left.rows(n, p));
        out.view_mut((n_w, n + n_w), (p, m)).copy_from(&part((n, p), (n, m)));
        let sys = StateSpace::<Continuous>::new(
            derivative.columns(0, n).into_owned(),
            derivative.columns(n, n_w + m).into_owned(),
            out.columns(0, n).into_owned(),
            out.columns(n, n_w + m).into_owned(),
        )?;
        let system = UncertainSystem::new(sys, BlockStructure::new(blocks)?)?;
        Ok(ParametricSystem { parameters, system })
    }
}

fn same_sizes(
    nominal: &DescriptorSystem,
    other: &DescriptorSystem,
    name: impl Fn() -> String,
) -> Result<(), Error> {
    if nominal.sizes() == other.sizes() { Ok(()) } else { Err(Error::ParameterShape { parameter: name() }) }
}

/// Places inside of a range at which a model is compared with its affine form: no polynomial of degree six or less that
/// vanishes at both ends and the centre vanishes here as well.
const INSIDE: [f64; 4] = [-0.6, -0.25, 0.4, 0.8];
/// Of an entry, relative to the largest value it has: far above rounding, far below what a margin can show.
const AFFINE_TOLERANCE: f64 = 1e-9;
/// Rounding of an entry and of the difference of two, in units of the last place.
const NOISE: f64 = 16.0;
/// Corners of the box of all ranges that are looked at: two to this power.
const CORNER_BITS_MAX: usize = 8;
