//! One convex step of the search for the largest integral gain.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettingsBuilder, DefaultSolver, IPSolver, NonnegativeConeT, SecondOrderConeT, SolverStatus,
    SupportedConeT,
};
use num_complex::Complex64;

use super::DelayedPlant;
use crate::Result;
use crate::implement::PidSettings;

/// Gains `[P, I, D]`.
pub(super) type Gains = [f64; 3];

/// Plant, controller terms and limits on a grid of frequencies.
#[derive(Debug, Clone)]
pub(super) struct Samples {
    pub(super) rows: Vec<Sample>,
    /// Pole of the derivative filter; zero for a PI controller.
    pub(super) n_rad_s: f64,
    /// Sign of the integral gain.
    pub(super) sign: f64,
    pub(super) ms_max: f64,
    pub(super) mt_max: f64,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    pub(super) omega: f64,
    /// Plant.
    g: Complex64,
    /// What each gain is multiplied by: `1`, `1/s`, `s N/(s + N)`.
    terms: [Complex64; 3],
    /// Weight of `C S`, zero without a limit.
    weight: f64,
}

/// What a step is to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Aim {
    /// Largest integral gain with every limit kept.
    IntegralGain,
    /// Smallest violation of the limits.
    Feasibility,
}

impl Samples {
    pub(super) fn sample(&self, plant: &DelayedPlant, omega: f64, weight: f64) -> Option<Sample> {
        let (g, s) = (plant.at(omega), Complex64::new(0.0, omega));
        let derivative =
            if self.n_rad_s > 0.0 { s * self.n_rad_s / (s + self.n_rad_s) } else { Complex64::ZERO };
        let usable = g.norm().is_finite() && g.norm() > 0.0 && omega > 0.0;
        usable.then_some(Sample { omega, g, terms: [Complex64::ONE, s.inv(), derivative], weight })
    }

    pub(super) fn settings(&self, gains: Gains) -> PidSettings {
        PidSettings { p: gains[0], i_per_s: gains[1], d_s: gains[2], n_rad_s: self.n_rad_s }
    }

    /// Largest ratio of a peak on the grid to its limit.
    pub(super) fn violation(&self, gains: Gains) -> f64 {
        self.rows.iter().fold(0.0, |worst, row| {
            let c = row.controller(gains);
            let (l, distance) = (row.g * c, (1.0 + row.g * c).norm());
            let s = 1.0 / (distance * self.ms_max);
            let t = l.norm() / (distance * self.mt_max);
            worst.max(s).max(t).max(row.weight * c.norm() / distance)
        })
    }

    /// Sizes of gains that matter: each would give a loop gain of one where the loop gain is one.
    pub(super) fn scale(&self, gains: Gains) -> Gains {
        let middle = self.crossover(gains);
        let unit = 1.0 / middle.g.norm();
        [unit, unit * middle.omega, unit / middle.omega]
    }

    /// Whether two sets of gains differ by more than a small share of what matters.
    pub(super) fn far_apart(&self, a: Gains, b: Gains) -> bool {
        let scale = self.scale(a);
        (0..3).any(|k| (a[k] - b[k]).abs() > 0.15 * scale[k])
    }

    /// Loop gain at the highest frequency of the grid.
    pub(super) fn gain_at_top(&self, gains: Gains) -> f64 {
        self.rows.last().map_or(0.0, |row| (row.g * row.controller(gains)).norm())
    }

    /// Frequency at which the loop gain is nearest to one.
    fn crossover(&self, gains: Gains) -> &Sample {
        let off = |row: &Sample| (row.g * row.controller(gains)).norm().ln().abs();
        // The grid is not empty: its constructor puts at least its two ends.
        self.rows.iter().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(&self.rows[0])
    }

    /// The gains that are best for `aim` among those that keep every limit, each limit replaced by a convex one that is
    /// stricter and touches it at `gains`; `None` where the program has no usable answer.
    ///
    /// **Method**: with `u` the unit vector along `1 + L` at the present gains, `Re(conj(u) (1 + L)) <= |1 + L|`. So
    /// `Re(conj(u)(1 + L)) >= 1/Ms`, `>= |L|/Mt` and `>= |W C|` are convex in the gains and imply the limits. They also keep the
    /// Nyquist locus in half planes without -1, so that a stable loop stays stable. Second-order cone program, clarabel.
    ///
    /// **Source**: Hast, Åström, Bernhardsson and Boyd 2013, "PID design by convex-concave optimization", ECC.
    pub(super) fn step(&self, gains: Gains, aim: Aim) -> Option<Gains> {
        let scale = self.scale(gains);
        let n_gains = if self.n_rad_s > 0.0 { 3 } else { 2 };
        let n_var = n_gains + 1;
        let mut program = Program { a: Vec::new(), b: Vec::new(), cones: Vec::new(), n_var };
        for row in &self.rows {
            self.add_row(&mut program, row, gains, scale, n_gains, aim);
        }
        let slack = n_gains;
        let mut integral = vec![0.0; n_var];
        integral[1] = -self.sign;
        let floor = match aim {
            Aim::IntegralGain => 0.0,
            Aim::Feasibility => KEPT_INTEGRAL * self.sign * gains[1] / scale[1],
        };
        program.a.push(integral.clone());
        program.b.push(-floor);
        // Slack is free for feasibility, and bounded below so that the program is bounded; unused otherwise.
        let mut bounded = vec![0.0; n_var];
        bounded[slack] = -1.0;
        program.a.push(bounded.clone());
        program.b.push(1.0);
        bounded[slack] = 1.0;
        program.a.push(bounded);
        program.b.push(if aim == Aim::IntegralGain { 0.0 } else { 1e3 });
        // No gain may grow by more than this in one step: an unbounded problem then shows as growth.
        for k in 0..n_gains {
            for sign in [1.0, -1.0] {
                let mut row = vec![0.0; n_var];
                row[k] = sign;
                program.a.push(row);
                program.b.push((gains[k] / scale[k]).abs() + GROWTH_MAX);
            }
        }
        program.cones.push(NonnegativeConeT(3 + 2 * n_gains));
        let mut objective = vec![0.0; n_var];
        match aim {
            Aim::IntegralGain => objective[1] = -self.sign,
            Aim::Feasibility => objective[slack] = 1.0,
        }
        let x = program.solve(&objective)?;
        let mut found = [0.0; 3];
        for k in 0..n_gains {
            found[k] = x[k] * scale[k];
        }
        found.iter().all(|v| v.is_finite()).then_some(found)
    }

    fn add_row(
        &self,
        program: &mut Program,
        row: &Sample,
        gains: Gains,
        scale: Gains,
        n_gains: usize,
        aim: Aim,
    ) {
        let towards = 1.0 + row.g * row.controller(gains);
        let distance = towards.norm();
        if distance == 0.0 {
            return;
        }
        let unit = towards.conj() / distance;
        let size = 1.0 / distance.max(1.0);
        // Re(conj(u)(1 + L)) = fixed + slope . x
        let fixed = unit.re * size;
        let mut slope = vec![0.0; n_gains + 1];
        let mut loop_ = vec![Complex64::ZERO; n_gains];
        let mut controller = vec![Complex64::ZERO; n_gains];
        for k in 0..n_gains {
            controller[k] = row.terms[k] * scale[k] * size;
            loop_[k] = row.g * controller[k];
            slope[k] = (unit * loop_[k]).re;
        }
        if aim == Aim::Feasibility {
            slope[n_gains] = 1.0;
        }
        let negative = |v: &[f64]| v.iter().map(|x| -x).collect::<Vec<f64>>();
        program.a.push(negative(&slope));
        program.b.push(fixed - size / self.ms_max);
        program.cones.push(NonnegativeConeT(1));
        if aim == Aim::Feasibility {
            let mut hard = slope.clone();
            hard[n_gains] = 0.0;
            program.a.push(negative(&hard));
            program.b.push(fixed - KEPT_DISTANCE * distance * size);
            program.cones.push(NonnegativeConeT(1));
        }
        let mut cone = |vector: &[Complex64], factor: f64| {
            program.a.push(negative(&slope));
            program.b.push(fixed);
            for part in [|z: &Complex64| z.re, |z: &Complex64| z.im] {
                let mut entries: Vec<f64> = vector.iter().map(|z| -part(z) * factor).collect();
                entries.push(0.0);
                program.a.push(entries);
                program.b.push(0.0);
            }
            program.cones.push(SecondOrderConeT(3));
        };
        cone(&loop_, 1.0 / self.mt_max);
        if row.weight > 0.0 {
            cone(&controller, row.weight);
        }
    }
}

impl Sample {
    pub(super) fn controller(&self, gains: Gains) -> Complex64 {
        self.terms[0] * gains[0] + self.terms[1] * gains[1] + self.terms[2] * gains[2]
    }
}

/// `minimise q x` with `b - A x` in the cones.
struct Program {
    a: Vec<Vec<f64>>,
    b: Vec<f64>,
    cones: Vec<SupportedConeT<f64>>,
    n_var: usize,
}

impl Program {
    fn solve(&self, q: &[f64]) -> Option<Vec<f64>> {
        let settings = DefaultSettingsBuilder::default().verbose(false).max_iter(100).build().ok()?;
        let p = CscMatrix::zeros((self.n_var, self.n_var));
        let a = CscMatrix::from(&self.a);
        let mut solver = DefaultSolver::new(&p, q, &a, &self.b, &self.cones, settings).ok()?;
        solver.solve();
        let usable = matches!(solver.solution.status, SolverStatus::Solved | SolverStatus::AlmostSolved);
        usable.then(|| solver.solution.x.clone())
    }
}

/// A grid over everything that bends a response of plant, filter or weight, with more points at sharp resonances.
///
/// # Errors
/// Where poles or zeros cannot be found.
pub(super) fn frequency_grid(plant: &DelayedPlant, n_rad_s: f64, others: &[Complex64]) -> Result<Vec<f64>> {
    let mut corners = plant.corner_frequencies()?;
    corners.extend(others.iter().map(|root| root.norm()).filter(|w| *w > 0.0));
    if n_rad_s > 0.0 {
        corners.push(n_rad_s);
    }
    let bottom = BELOW * corners.iter().copied().fold(f64::INFINITY, f64::min);
    let top = ABOVE * corners.iter().copied().fold(0.0, f64::max);
    let n = ((top / bottom).log10() * POINTS_PER_DECADE).ceil().clamp(2.0, POINTS_MAX) as usize;
    let mut grid: Vec<f64> = (0..=n).map(|k| bottom * (top / bottom).powf(k as f64 / n as f64)).collect();
    let mut roots = plant.rational().poles()?;
    roots.extend(plant.rational().zeros()?);
    roots.extend(others);
    for root in roots.iter().filter(|r| r.im > 0.0 && r.re.abs() < 0.2 * r.im) {
        let width = root.re.abs().max(1e-6 * root.im);
        for step in [-3.0, -1.5, -0.7, -0.3, 0.0, 0.3, 0.7, 1.5, 3.0] {
            grid.push(root.im + step * width);
        }
    }
    grid.retain(|w| *w > 0.0);
    grid.sort_by(f64::total_cmp);
    grid.dedup();
    Ok(grid)
}

/// Share of the integral gain that the search for feasibility keeps.
const KEPT_INTEGRAL: f64 = 0.3;
/// Share of the distance from -1 that it keeps along the present direction, so that no encirclement is lost.
const KEPT_DISTANCE: f64 = 0.1;
/// Growth of a gain in one step, in units of the inverse plant at crossover.
const GROWTH_MAX: f64 = 100.0;
const POINTS_PER_DECADE: f64 = 40.0;
const POINTS_MAX: f64 = 600.0;
const BELOW: f64 = 1e-2;
const ABOVE: f64 = 30.0;
