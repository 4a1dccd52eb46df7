//! A cascade of sections of first and second order.

use nalgebra::dmatrix;
use num_complex::Complex64;
use telepulse_lti::{Continuous, StateSpace, hinf_norm, polynomial};

use super::delta_system::DeltaSystem;
use super::program::{Node, Operator, StepProgram, Update};
use crate::{Error, Result};

/// How the gain is spread over the sections.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SectionScaling {
    /// No sine of amplitude one exceeds one behind any section but the last.
    #[default]
    PeakGain,
    /// White input of variance one keeps variance one behind every section but the last.
    Variance,
    /// All of it in the last section.
    None,
}

/// One section `(n0 p² + n1 p + n2)/(p² + d1 p + d2)`, or of first order with `n0 p + n1` over `p + d1`; `p` is `z` or `z - 1`.
#[derive(Debug, Clone, PartialEq)]
pub struct Section {
    /// Numerator in descending powers, as long as the denominator.
    pub numerator: Vec<f64>,
    /// Monic denominator in descending powers.
    pub denominator: Vec<f64>,
}

/// A system with one input and one output as a cascade of sections.
///
/// **Method**: real poles and zeros are taken in pairs of neighbours; from the pole pair nearest to the unit circle on, each takes
/// the zeros nearest to it; the cascade runs from the best damped section to the least damped one. Zeros and poles stay in
/// `z - 1` until a section is formed. Each section is in controller form.
///
/// **Source**: Jackson 1970, "Roundoff-noise analysis for fixed-point digital filters realized in cascade or parallel form",
/// IEEE Trans. Audio Electroacoust. 18(2), 107-122, for pairing, order and scaling.
#[derive(Debug, Clone, PartialEq)]
pub struct SectionForm {
    /// One tick.
    pub program: StepProgram,
    /// The sections in the order of the signal.
    pub sections: Vec<Section>,
    /// In which operator.
    pub operator: Operator,
}

impl SectionForm {
    /// The cascade form of a system. A system that is not stable has no norm to scale by: all gain then is in its last section.
    ///
    /// # Errors
    /// A system error for more than one input or output, or eigenvalues that do not converge.
    pub fn new(sys: &DeltaSystem, operator: Operator, scaling: SectionScaling) -> Result<Self> {
        let tf = sys.increment().to_transfer_function()?;
        let gain = tf.numerator().iter().copied().find(|&v| v != 0.0).unwrap_or(0.0);
        let poles = sys.increment().poles()?;
        let zeros = if gain == 0.0 { Vec::new() } else { sys.increment().zeros()? };
        let groups = paired(&poles, &zeros)?;
        let scaling = if sys.is_stable()? && gain != 0.0 { scaling } else { SectionScaling::None };
        let mut parts = Vec::with_capacity(groups.len());
        let mut product: Option<StateSpace<Continuous>> = None;
        let mut left_over = gain;
        for (k, group) in groups.iter().enumerate() {
            // Unit leading coefficient, gain still to come.
            let mut part = group.section(Operator::Delta, 1.0)?.state_space()?;
            let mut share = if k + 1 == groups.len() { left_over } else { 1.0 };
            if k + 1 < groups.len() && scaling != SectionScaling::None {
                let so_far = match &product {
                    None => part.clone(),
                    Some(product) => product.series(&part)?,
                };
                let so_far = DeltaSystem::new(so_far, sys.sample_time());
                let size = match scaling {
                    SectionScaling::Variance => variance_gain(&so_far)?,
                    _ => hinf_norm(&so_far.continuous_image()?)?.value,
                };
                share = if size > 0.0 && size.is_finite() { 1.0 / size } else { 1.0 };
                left_over /= share;
            }
            part = part.scale(share)?;
            product = Some(match product {
                None => part,
                Some(product) => product.series(&part)?,
            });
            parts.push(group.section(operator, share)?);
        }
        let direct = if groups.is_empty() { gain } else { 1.0 };
        let program = cascade(&parts, operator, sys, direct);
        Ok(Self { program, sections: parts, operator })
    }
}

impl Section {
    /// Controller form.
    fn state_space(&self) -> Result<StateSpace<Continuous>> {
        let (n, d) = (&self.numerator, &self.denominator);
        let b0 = n[0];
        let sys = if d.len() == 2 {
            StateSpace::<Continuous>::new(
                dmatrix![-d[1]],
                dmatrix![1.0],
                dmatrix![n[1] - b0 * d[1]],
                dmatrix![b0],
            )
        } else {
            StateSpace::<Continuous>::new(
                dmatrix![-d[1], -d[2]; 1.0, 0.0],
                dmatrix![1.0; 0.0],
                dmatrix![n[1] - b0 * d[1], n[2] - b0 * d[2]],
                dmatrix![b0],
            )
        };
        Ok(sys?)
    }
}

/// Poles of one section and the zeros that it takes.
struct Group {
    poles: Vec<Complex64>,
    zeros: Vec<Complex64>,
}

impl Group {
    fn section(&self, operator: Operator, gain: f64) -> Result<Section> {
        let moved = |roots: &[Complex64]| match operator {
            Operator::Delta => roots.to_vec(),
            Operator::Shift => roots.iter().map(|r| r + 1.0).collect(),
        };
        let denominator = polynomial::from_roots(&moved(&self.poles))?;
        let mut numerator = vec![0.0; self.poles.len() - self.zeros.len()];
        numerator.extend(polynomial::from_roots(&moved(&self.zeros))?.iter().map(|v| v * gain));
        Ok(Section { numerator, denominator })
    }
}

fn paired(poles: &[Complex64], zeros: &[Complex64]) -> Result<Vec<Group>> {
    let grouped = |roots: &[Complex64]| {
        let mut groups: Vec<Vec<Complex64>> =
            roots.iter().filter(|r| r.im > 0.0).map(|r| vec![*r, r.conj()]).collect();
        let n_pairs = groups.len();
        let mut real: Vec<Complex64> = roots.iter().filter(|r| r.im == 0.0).copied().collect();
        real.sort_by(|p, q| p.re.total_cmp(&q.re));
        groups.extend(real.chunks(2).map(<[Complex64]>::to_vec));
        (groups, n_pairs)
    };
    let (mut pole_groups, _) = grouped(poles);
    let radius = |group: &[Complex64]| group.iter().map(|d| (d + 1.0).norm()).fold(0.0, f64::max);
    // Least damped first: it chooses first, and ends up last in the cascade.
    pole_groups.sort_by(|p, q| radius(q).total_cmp(&radius(p)));
    let mut groups: Vec<Group> =
        pole_groups.into_iter().map(|poles| Group { poles, zeros: Vec::new() }).collect();
    let (zero_groups, n_pairs) = grouped(zeros);
    let distance = |group: &Group, zero: Complex64| {
        group.poles.iter().map(|p| (p - zero).norm()).fold(f64::INFINITY, f64::min)
    };
    // Complex pairs need a whole section; real zeros then fill what is left, one by one.
    let mut pairs: Vec<Vec<Complex64>> = zero_groups[..n_pairs].to_vec();
    for group in groups.iter_mut().filter(|g| g.poles.len() == 2) {
        let nearest = (0..pairs.len())
            .min_by(|&p, &q| distance(group, pairs[p][0]).total_cmp(&distance(group, pairs[q][0])));
        if let Some(nearest) = nearest {
            group.zeros = pairs.swap_remove(nearest);
        }
    }
    for zero in zero_groups[n_pairs..].iter().flatten().copied() {
        let free = groups.iter_mut().filter(|g| g.zeros.len() < g.poles.len());
        let nearest = free.min_by(|p, q| distance(p, zero).total_cmp(&distance(q, zero)));
        // A proper system has no more zeros than poles.
        nearest.ok_or(Error::System(telepulse_lti::Error::RankDeficientSystem))?.zeros.push(zero);
    }
    groups.reverse();
    Ok(groups)
}

/// Sections in controller form, the output of each being the input of the next.
fn cascade(sections: &[Section], operator: Operator, sys: &DeltaSystem, direct: f64) -> StepProgram {
    let n: usize = sections.iter().map(|s| s.denominator.len() - 1).sum();
    let mut program = StepProgram::empty(n, 1, sys.sample_time());
    let mut signal: Option<Node> = Some(n);
    let mut start = 0;
    for section in sections {
        let (num, den) = (&section.numerator, &section.denominator);
        let order = den.len() - 1;
        let with_input = |mut terms: Vec<(f64, Node)>, gain: f64| {
            terms.extend(signal.map(|node| (gain, node)));
            terms
        };
        let state = with_input((0..order).map(|k| (-den[k + 1], start + k)).collect(), 1.0);
        let output =
            with_input((0..order).map(|k| (num[k + 1] - num[0] * den[k + 1], start + k)).collect(), num[0]);
        let value = program.dot(&state);
        let wrap = |node| match operator {
            Operator::Shift => Update::Replace(node),
            Operator::Delta => Update::Increment(node),
        };
        program.updates[start] = wrap(value);
        if order == 2 {
            program.updates[start + 1] = wrap(Some(start));
        }
        signal = program.dot(&output);
        start += order;
    }
    program.outputs = vec![match signal {
        Some(node) if direct != 1.0 => program.dot(&[(direct, node)]),
        other => other,
    }];
    program
}

/// Root of the output variance for white input of variance one.
pub(super) fn variance_gain(sys: &DeltaSystem) -> Result<f64> {
    // The bilinear image has the same Gramian.
    let image = sys.continuous_image()?;
    let p = telepulse_lti::lyapunov::continuous(image.a(), &(image.b() * image.b().transpose()))?.x;
    let (c, d) = (sys.increment().c(), sys.increment().d());
    Ok(((c * p * c.transpose()).trace() + d.norm_squared()).max(0.0).sqrt())
}
