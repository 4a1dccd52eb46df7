//! The model whose simulation comes closest to a record.

use nalgebra::{DMatrix, DVector};

use super::model::{CreepBranch, GreyBoxModel};
use super::sensitivity::Parametrization;
use crate::identify::least_squares::{Linearized, Stop, minimize};
use crate::identify::{RcPole, ThirdOrderFit};
use crate::{Error, Result};

/// Drive and response of an experiment that began at rest.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct GreyBoxRecord {
    /// Voltage that was applied, units of full scale, held from its sample to the next.
    pub voltage_unit: Vec<f64>,
    /// Displacement in mm, read at the instant that the voltage of the same sample is applied.
    pub response_mm: Vec<f64>,
    /// Time between samples, s.
    pub sample_time_s: f64,
}

/// How a record is fitted.
#[derive(Debug, Clone, PartialEq)]
pub struct GreyBoxFitOptions {
    /// The circuit: known, or fitted too.
    pub rc: RcPole,
    /// Relaxation times at which the branches start, s; their number is that of the branches, 0 to 4.
    pub relaxation_times_s: Vec<f64>,
    /// Share of the record, at its end, that is not fitted but predicted.
    pub held_back: f64,
}

impl Default for GreyBoxFitOptions {
    /// A known circuit of 4.5 ms (Eq. 14), branches at 0.5, 5 and 50 s, and the last tenth held back.
    fn default() -> Self {
        Self { rc: RcPole::Known(0.0045), relaxation_times_s: vec![0.5, 5.0, 50.0], held_back: 0.1 }
    }
}

/// A fitted model and how far it may be trusted.
#[derive(Debug, Clone, PartialEq)]
pub struct GreyBoxFit {
    /// The model.
    pub model: GreyBoxModel,
    /// What the sensor reads at rest, mm.
    pub offset_mm: f64,
    /// Root mean square of what the model leaves of the fitted part, mm, after averaging over four samples.
    pub rms_residual_mm: f64,
    /// The same over the part that was held back, mm; none where nothing was.
    pub rms_held_back_mm: Option<f64>,
    /// Standard deviation of each parameter: the nine coefficients in units of omega_0^2 (by rising total power, those of the displacement first),
    /// then, relative, damping, stiffness over relaxation time of each branch, relaxation times, a free circuit; then the reading at rest, mm.
    pub standard_errors: Vec<f64>,
    /// Condition number of the Jacobian with unit columns: how far the parameters can be told apart.
    pub condition: f64,
    /// Iterations of the fit.
    pub iterations: usize,
}

/// Samples that are averaged into one residual, of record and simulation alike.
const BLOCK: usize = 4;

/// Fits a grey-box model to a record that began at rest.
///
/// **Method**: least squares of the simulation error by Levenberg and Marquardt, derivatives by the variational equations; it starts from a
/// linear model (`start`: displacement from squared voltage, as a sweep gives it). The reading at rest is fitted along.
///
/// **Accuracy**: the simulation error is what counts for a feedforward; it weighs what the record contains. Branches whose relaxation time is
/// longer than the record are not determined by it, see [`GreyBoxFit::standard_errors`].
///
/// # Errors
/// [`Error::SampleCount`], [`Error::SampleNotFinite`], [`Error::OutOfRange`] for a record or options that cannot be fitted;
/// [`Error::FitNotConverged`].
pub fn fit_grey_box(
    record: &GreyBoxRecord,
    start: &ThirdOrderFit,
    options: &GreyBoxFitOptions,
) -> Result<GreyBoxFit> {
    check(record, options)?;
    let n_fitted =
        ((record.voltage_unit.len() as f64 * (1.0 - options.held_back)) as usize / BLOCK).max(1) * BLOCK;
    let parametrization = parametrization(start, options);
    let first = first_parameters(&parametrization, start);
    let coarse = coarse(record, n_fitted);
    let near = minimize(first, Stop::WithinNoise, |parameters| {
        linearize(&parametrization, parameters, &coarse, coarse.voltage_unit.len(), 1)
    })?;
    let fitted = minimize(near.parameters, Stop::WithinNoise, |parameters| {
        linearize(&parametrization, parameters, record, n_fitted, BLOCK)
    })?;
    let n_p = parametrization.n_parameters();
    let offset_mm = fitted.parameters[n_p];
    let top = record.response_mm.iter().fold(0.0, |top: f64, y| top.max(y - offset_mm));
    let model = parametrization.model(&fitted.parameters, top)?;
    let residual = &fitted.linearized.residual;
    let rms_residual_mm = rms(residual.as_slice());
    let rms_held_back_mm = (n_fitted + BLOCK <= record.voltage_unit.len()).then(|| {
        let all = linearize(
            &parametrization,
            &fitted.parameters,
            record,
            record.voltage_unit.len() / BLOCK * BLOCK,
            BLOCK,
        );
        rms(&all.residual.as_slice()[n_fitted / BLOCK..])
    });
    let (standard_errors, condition) = spread(&fitted.linearized.jacobian, rms_residual_mm);
    Ok(GreyBoxFit {
        model,
        offset_mm,
        rms_residual_mm,
        rms_held_back_mm,
        standard_errors,
        condition,
        iterations: near.iterations + fitted.iterations,
    })
}

fn parametrization(start: &ThirdOrderFit, options: &GreyBoxFitOptions) -> Parametrization {
    let omega_squared = start.omega_n_rad_s.powi(2);
    let branch = |time: &f64| CreepBranch {
        stiffness_per_s2: FIRST_BRANCH_SHARE * omega_squared,
        relaxation_time_s: *time,
    };
    let (rc_s, rc_is_free) = match options.rc {
        RcPole::Known(rc_s) => (rc_s, false),
        RcPole::Free => (start.rc_s, true),
    };
    Parametrization {
        omega_squared,
        damping: 2.0 * start.zeta * start.omega_n_rad_s,
        rc_s,
        rc_is_free,
        branches: options.relaxation_times_s.iter().map(branch).collect(),
    }
}

/// Stiffness of each branch at the start, as a share of the whole.
const FIRST_BRANCH_SHARE: f64 = 0.01;

/// The linear model, and the sensor's reading at rest at zero.
fn first_parameters(parametrization: &Parametrization, start: &ThirdOrderFit) -> DVector<f64> {
    let mut parameters = DVector::zeros(parametrization.n_parameters() + 1);
    // The order of `POWERS`: the spring, then the drive.
    parameters[0] = -(1.0 - FIRST_BRANCH_SHARE * parametrization.branches.len() as f64);
    parameters[1] = start.dc_gain_mm_per_unit;
    parameters
}

/// A record with one sample for [`BLOCK`]: the drive by its mean square, the response where the block begins. Its minimum lies near that of the
/// whole record and is found in a quarter of the time.
fn coarse(record: &GreyBoxRecord, n_samples: usize) -> GreyBoxRecord {
    let mean_square = |block: &[f64]| (block.iter().map(|v| v * v).sum::<f64>() / block.len() as f64).sqrt();
    GreyBoxRecord {
        voltage_unit: record.voltage_unit[..n_samples].chunks(BLOCK).map(mean_square).collect(),
        response_mm: record.response_mm[..n_samples].iter().copied().step_by(BLOCK).collect(),
        sample_time_s: BLOCK as f64 * record.sample_time_s,
    }
}

fn linearize(
    parametrization: &Parametrization,
    parameters: &DVector<f64>,
    record: &GreyBoxRecord,
    n_samples: usize,
    block_samples: usize,
) -> Linearized {
    let n_p = parametrization.n_parameters();
    let n_blocks = n_samples / block_samples;
    let mut residual = DVector::zeros(n_blocks);
    // Row by row as the simulation goes, then transposed: nalgebra stores columns.
    let mut rows = DMatrix::zeros(n_p + 1, n_blocks);
    let mut sample_idx = 0;
    let drive = &record.voltage_unit[..n_samples];
    parametrization.simulate(parameters, drive, record.sample_time_s, |dual| {
        let block = sample_idx / block_samples;
        let share = 1.0 / block_samples as f64;
        residual[block] += share * (dual[0] + parameters[n_p] - record.response_mm[sample_idx]);
        for (p, slope) in dual[1..].iter().enumerate() {
            rows[(p, block)] += share * slope;
        }
        rows[(n_p, block)] = 1.0;
        sample_idx += 1;
    });
    Linearized { residual, jacobian: rows.transpose() }
}

/// Standard errors of the parameters, and the condition number of the scaled Jacobian.
fn spread(jacobian: &DMatrix<f64>, rms: f64) -> (Vec<f64>, f64) {
    let norms: Vec<f64> = jacobian.column_iter().map(|column| column.norm().max(f64::MIN_POSITIVE)).collect();
    let mut scaled = jacobian.clone();
    for (mut column, norm) in scaled.column_iter_mut().zip(&norms) {
        column /= *norm;
    }
    let svd = scaled.qr().r().svd(false, true);
    let values = &svd.singular_values;
    let condition = values.max() / values.min();
    let Some(v_t) = &svd.v_t else { return (Vec::new(), condition) };
    let error = |p: usize| {
        let sum: f64 = (0..values.len()).map(|k| (v_t[(k, p)] / values[k]).powi(2)).sum();
        rms * sum.sqrt() / norms[p]
    };
    ((0..norms.len()).map(error).collect(), condition)
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

fn check(record: &GreyBoxRecord, options: &GreyBoxFitOptions) -> Result<()> {
    let n = record.voltage_unit.len();
    if record.response_mm.len() != n {
        return Err(Error::SampleCount { signal: "response", expected: n, found: record.response_mm.len() });
    }
    if n < RECORD_MIN {
        return Err(Error::SampleCount { signal: "grey-box record", expected: RECORD_MIN, found: n });
    }
    for (signal, values) in [("voltage", &record.voltage_unit), ("response", &record.response_mm)] {
        if let Some(sample_idx) = values.iter().position(|v| !v.is_finite()) {
            return Err(Error::SampleNotFinite { signal, sample_idx, found: values[sample_idx] });
        }
    }
    let times = &options.relaxation_times_s;
    let rules = [
        ("sample_time_s", record.sample_time_s, record.sample_time_s > 0.0, "above 0"),
        ("held_back", options.held_back, (0.0..0.9).contains(&options.held_back), "0 to 0.9"),
        (
            "number of relaxation times",
            times.len() as f64,
            times.len() <= super::model::BRANCHES_MAX,
            "0 to 4",
        ),
    ];
    let bad = rules.into_iter().find(|(_, found, ok, _)| !(*ok && found.is_finite()));
    if let Some((key, found, _, allowed)) = bad {
        return Err(Error::OutOfRange { key, found, allowed });
    }
    match times.iter().find(|time| !(**time > 0.0 && time.is_finite())) {
        Some(found) => {
            Err(Error::OutOfRange { key: "relaxation_times_s", found: *found, allowed: "above 0" })
        }
        None => Ok(()),
    }
}

/// Fewer samples than this cannot determine a score of parameters.
const RECORD_MIN: usize = 1000;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::{GreyBoxExperiment, GreyBoxExperimentOptions, PullTerm};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;
    use telepulse_lti::TransferFunction;

    fn truth() -> GreyBoxModel {
        let term = |i, j, coefficient| PullTerm { displacement_power: i, drive_power: j, coefficient };
        let terms = vec![
            term(1, 0, -1400.0),
            term(0, 1, 1310.0),
            term(2, 0, -25.0),
            term(1, 1, 170.0),
            term(0, 2, 9.0),
            term(3, 0, 5.0),
            term(2, 1, -6.0),
            term(1, 2, 2.0),
            term(0, 3, -1.0),
        ];
        let branch =
            |stiffness_per_s2, relaxation_time_s| CreepBranch { stiffness_per_s2, relaxation_time_s };
        GreyBoxModel::new(
            0.0045,
            16.0,
            terms,
            vec![branch(20.0, 0.6), branch(25.0, 6.6), branch(11.0, 61.0)],
            1.0,
        )
        .expect("valid")
    }

    fn start() -> ThirdOrderFit {
        let transfer_function =
            TransferFunction::new(&[1300.0], &[0.0045, 1.07, 22.5, 1444.0]).expect("proper");
        ThirdOrderFit {
            dc_gain_mm_per_unit: 0.9,
            omega_n_rad_s: 38.0,
            zeta: 0.21,
            rc_s: 0.0045,
            standard_errors: crate::identify::ParameterErrors {
                dc_gain_mm_per_unit: 0.0,
                omega_n_rad_s: 0.0,
                zeta: 0.0,
                rc_s: None,
            },
            transfer_function,
            rms_residual_mm_per_unit: 0.0,
            rms_complex_mm_per_unit: 0.0,
            condition: 1.0,
            n_points: 1,
            iterations: 1,
        }
    }

    fn record(model: &GreyBoxModel, noise_mm: f64) -> GreyBoxRecord {
        let experiment = GreyBoxExperiment::new(&GreyBoxExperimentOptions::default()).expect("valid");
        let mut random = Pcg64Mcg::seed_from_u64(7);
        let mut state = model.at_rest();
        let mut record = GreyBoxRecord { sample_time_s: 5e-4, ..GreyBoxRecord::default() };
        for w in experiment.drive() {
            // Three uniform numbers: near enough to a normal one, of unit variance.
            let noise: f64 = (0..3).map(|_| f64::from(random.next_u32()) / f64::from(u32::MAX) - 0.5).sum();
            record.response_mm.push(0.02 + state.displacement_mm + 2.0 * noise_mm * noise);
            record.voltage_unit.push(w.sqrt());
            model.advance(&mut state, w.sqrt(), 5e-4);
        }
        record
    }

    #[test]
    fn law_a_model_comes_back_from_its_own_noisy_record() {
        let truth = truth();
        let fit =
            fit_grey_box(&record(&truth, 0.003), &start(), &GreyBoxFitOptions::default()).expect("fits");
        assert!((fit.offset_mm - 0.02).abs() < 5.0 * fit.standard_errors[16], "{}", fit.offset_mm);
        let pairs = fit.model.terms().iter().zip(truth.terms());
        for (idx, (found, true_term)) in pairs.enumerate() {
            // Terms are fitted in the order of the model's own; in units of omega_0^2.
            let same = truth.terms().iter().find(|term| {
                (term.displacement_power, term.drive_power) == (found.displacement_power, found.drive_power)
            });
            let expected = same.unwrap_or(true_term).coefficient;
            let error = (found.coefficient - expected).abs() / 1444.0;
            assert!(error < 5.0 * fit.standard_errors[idx], "{found:?} for {expected}");
        }
        assert!((fit.model.damping_per_s() / 16.0 - 1.0).abs() < 5.0 * fit.standard_errors[9]);
        for (k, branch) in truth.branches().iter().enumerate() {
            let ratio = fit.model.branches()[k].relaxation_time_s / branch.relaxation_time_s;
            assert!(ratio.ln().abs() < 5.0 * fit.standard_errors[13 + k], "{ratio}");
        }
        // White noise of 3 um, averaged over four samples, and nothing else is left; 5 standard errors of its rms are 2 %.
        assert!((fit.rms_residual_mm / 0.0015 - 1.0).abs() < 0.02, "{}", fit.rms_residual_mm);
        let held_back = fit.rms_held_back_mm.expect("a tenth is held back");
        assert!((held_back / 0.0015 - 1.0).abs() < 0.06, "{held_back}");
    }

    #[test]
    fn law_derivatives_are_those_of_the_simulation() {
        let options = GreyBoxFitOptions { rc: RcPole::Free, ..GreyBoxFitOptions::default() };
        let parametrization = parametrization(&start(), &options);
        let n_p = parametrization.n_parameters();
        let mut parameters = first_parameters(&parametrization, &start());
        for (k, value) in parameters.iter_mut().enumerate() {
            *value += 0.02 * ((k as f64) * 1.7).sin();
        }
        let mut short = record(&truth(), 0.0);
        short.voltage_unit.drain(..1000);
        short.response_mm.drain(..1000);
        let at = |p: &DVector<f64>| linearize(&parametrization, p, &short, 8000, BLOCK);
        let here = at(&parameters);
        for p in 0..=n_p {
            let step = 1e-5;
            let moved = |sign: f64| {
                let mut other = parameters.clone();
                other[p] += sign * step;
                at(&other).residual
            };
            let quotient = (moved(1.0) - moved(-1.0)) / (2.0 * step);
            let column = here.jacobian.column(p);
            // Central differences are off by the third derivative times 1e-10 and by rounding over 1e-5.
            assert!((&quotient - column).amax() < 1e-6 * (1.0 + column.amax()), "parameter {p}");
        }
    }

    #[test]
    fn edge_records_that_cannot_be_fitted_are_refused() {
        let good = record(&truth(), 0.0);
        let refused = |record: &GreyBoxRecord, options: &GreyBoxFitOptions| {
            fit_grey_box(record, &start(), options).expect_err("refused").to_string()
        };
        let options = GreyBoxFitOptions::default();
        let mut gap = good.clone();
        gap.response_mm[77] = f64::NAN;
        assert!(refused(&gap, &options).contains("77"));
        let mut cut = good.clone();
        cut.response_mm.pop();
        assert!(refused(&cut, &options).contains("response"));
        let five = GreyBoxFitOptions { relaxation_times_s: vec![1.0; 5], ..options.clone() };
        assert!(refused(&good, &five).contains("relaxation times"));
        let all = GreyBoxFitOptions { held_back: 0.95, ..options };
        assert!(refused(&good, &all).contains("held_back"));
    }
}
