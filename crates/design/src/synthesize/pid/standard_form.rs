//! Textbook forms of a PID controller and what they are in parallel gains.

use serde::{Deserialize, Serialize};

use crate::implement::PidSettings;
use crate::{Error, Result};

/// `K (1 + 1/(Ti s) + Td s/(1 + s Td/n))`: the standard (ideal, ISA) form.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StandardPid {
    /// Gain K, unit of command per unit of output.
    pub gain: f64,
    /// Integral time Ti in s; infinite for no integral action.
    pub integral_time_s: f64,
    /// Derivative time Td in s; zero for no derivative action.
    pub derivative_time_s: f64,
}

/// `K (1 + 1/(Ti s)) (1 + Td s)/(1 + s Td/n)`: the series (cascade, interacting) form.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SeriesPid {
    /// Gain K, unit of command per unit of output.
    pub gain: f64,
    /// Integral time Ti in s.
    pub integral_time_s: f64,
    /// Derivative time Td in s; zero for no derivative action.
    pub derivative_time_s: f64,
}

impl StandardPid {
    /// The parallel gains `P = K`, `I = K/Ti`, `D = K Td`, `N = n/Td`; `filter_ratio` is n, usually 5 to 20.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] for a gain that is not finite, times that are not positive, or a ratio that is not.
    ///
    /// # Example
    /// ```
    /// use telepulse_design::synthesize::pid::StandardPid;
    /// let pid = StandardPid { gain: 2.0, integral_time_s: 4.0, derivative_time_s: 0.5 }.parallel(10.0)?;
    /// assert_eq!((pid.i_per_s, pid.d_s, pid.n_rad_s), (0.5, 1.0, 20.0));
    /// # Ok::<(), telepulse_design::Error>(())
    /// ```
    pub fn parallel(&self, filter_ratio: f64) -> Result<PidSettings> {
        check(self.gain, self.integral_time_s, self.derivative_time_s, filter_ratio)?;
        let (k, td) = (self.gain, self.derivative_time_s);
        let n_rad_s = if td > 0.0 { filter_ratio / td } else { 0.0 };
        Ok(PidSettings { p: k, i_per_s: k / self.integral_time_s, d_s: k * td, n_rad_s })
    }

    /// The standard form of parallel gains: the same transfer function.
    ///
    /// It exists where P is not zero and I and D, where present, have its sign.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] where no standard form exists, or a derivative comes without a filter pole above zero.
    pub fn from_parallel(settings: &PidSettings) -> Result<WithFilter<Self>> {
        let PidSettings { p, i_per_s, d_s, n_rad_s } = *settings;
        check_parallel(settings)?;
        if p == 0.0 {
            return Err(Error::OutOfRange {
                key: "p",
                found: p,
                allowed: "other than 0 for a standard form",
            });
        }
        for (key, found) in [("i_per_s", i_per_s), ("d_s", d_s)] {
            if found / p < 0.0 {
                return Err(Error::OutOfRange {
                    key,
                    found,
                    allowed: "of the sign of p for a standard form",
                });
            }
        }
        let integral_time_s = if i_per_s == 0.0 { f64::INFINITY } else { p / i_per_s };
        let form = Self { gain: p, integral_time_s, derivative_time_s: d_s / p };
        let filter_ratio = (d_s != 0.0).then_some(n_rad_s * form.derivative_time_s);
        Ok(WithFilter { form, filter_ratio })
    }
}

impl SeriesPid {
    /// The parallel gains with the derivative filter at `N = filter_ratio/Td`: the same transfer function, not an
    /// approximation.
    ///
    /// # Errors
    /// As [`StandardPid::parallel`].
    ///
    /// # Example
    /// ```
    /// use telepulse_design::synthesize::pid::SeriesPid;
    /// let pid = SeriesPid { gain: 1.0, integral_time_s: 2.0, derivative_time_s: 1.0 }.parallel(1e9)?;
    /// // Without filter K (1 + Td/Ti), K/Ti, K Td.
    /// assert!((pid.p - 1.5).abs() < 1e-8 && pid.i_per_s == 0.5 && (pid.d_s - 1.0).abs() < 1e-8);
    /// # Ok::<(), telepulse_design::Error>(())
    /// ```
    pub fn parallel(&self, filter_ratio: f64) -> Result<PidSettings> {
        check(self.gain, self.integral_time_s, self.derivative_time_s, filter_ratio)?;
        let (k, ti, td) = (self.gain, self.integral_time_s, self.derivative_time_s);
        let i_per_s = k / ti;
        if td == 0.0 {
            return Ok(PidSettings { p: k, i_per_s, d_s: 0.0, n_rad_s: 0.0 });
        }
        // k (1 + Ti s)(1 + Td s) N/(Ti s (s + N)) = ((P + D N) s^2 + (P N + I) s + I N)/(s (s + N))
        let n_rad_s = filter_ratio / td;
        let p = k + k * td / ti - i_per_s / n_rad_s;
        Ok(PidSettings { p, i_per_s, d_s: k * td - p / n_rad_s, n_rad_s })
    }

    /// The series form of parallel gains: the same transfer function; the longer time is the integral one.
    ///
    /// It exists where the zeros of the controller, filter included, are real and stable: without a filter, where a standard form
    /// exists with `Ti >= 4 Td`.
    ///
    /// # Errors
    /// [`Error::PidNoSeriesForm`] where it does not exist, [`Error::OutOfRange`] for gains that are not finite or a derivative
    /// without a filter pole above zero.
    ///
    /// # Example
    /// ```
    /// use telepulse_design::{implement::PidSettings, synthesize::pid::SeriesPid};
    /// let settings = PidSettings { p: 1.5, i_per_s: 0.5, d_s: 1.0, n_rad_s: 1e9 };
    /// let series = SeriesPid::from_parallel(&settings)?.form;
    /// assert!((series.integral_time_s - 2.0).abs() < 1e-7 && (series.derivative_time_s - 1.0).abs() < 1e-7);
    /// # Ok::<(), telepulse_design::Error>(())
    /// ```
    pub fn from_parallel(settings: &PidSettings) -> Result<WithFilter<Self>> {
        check_parallel(settings)?;
        let PidSettings { p, i_per_s, d_s, n_rad_s: n } = *settings;
        // a s^2 + b s + c over s (s + N), or over s without a derivative.
        let [a, b, c] =
            if d_s == 0.0 { [0.0, p, i_per_s] } else { [p + d_s * n, p * n + i_per_s, i_per_s * n] };
        let none = Error::PidNoSeriesForm { numerator: [a, b, c] };
        if c == 0.0 {
            // Without integral action: K (1 + Td s), with its filter.
            let derivative_time_s = if d_s == 0.0 { 0.0 } else { a / b };
            if p == 0.0 || (d_s != 0.0 && !(derivative_time_s.is_finite() && derivative_time_s > 0.0)) {
                return Err(none);
            }
            let form = Self { gain: p, integral_time_s: f64::INFINITY, derivative_time_s };
            return Ok(WithFilter { form, filter_ratio: (d_s != 0.0).then_some(n * derivative_time_s) });
        }
        // c (1 + Ti s)(1 + Td s)
        let (sum, product) = (b / c, a / c);
        let discriminant = sum * sum - 4.0 * product;
        // A double zero may come out as a pair that rounding has split.
        let root =
            if discriminant < 0.0 && discriminant >= -1e-12 * sum * sum { 0.0 } else { discriminant.sqrt() };
        let integral_time_s = 0.5 * (sum + root);
        let derivative_time_s = if d_s == 0.0 { 0.0 } else { product / integral_time_s };
        let exists = integral_time_s.is_finite()
            && integral_time_s > 0.0
            && (d_s == 0.0 || (derivative_time_s.is_finite() && derivative_time_s > 0.0));
        if !exists {
            return Err(none);
        }
        let form = Self { gain: i_per_s * integral_time_s, integral_time_s, derivative_time_s };
        Ok(WithFilter { form, filter_ratio: (d_s != 0.0).then_some(n * derivative_time_s) })
    }
}

/// A form together with the derivative filter that its parallel gains had.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WithFilter<F> {
    /// Gain and times.
    pub form: F,
    /// `N Td`: how far the filter's corner lies above that of the derivative; `None` without a derivative.
    pub filter_ratio: Option<f64>,
}

fn check_parallel(settings: &PidSettings) -> Result<()> {
    let PidSettings { p, i_per_s, d_s, n_rad_s } = *settings;
    for (key, found) in [("p", p), ("i_per_s", i_per_s), ("d_s", d_s)] {
        if !found.is_finite() {
            return Err(Error::OutOfRange { key, found, allowed: "finite" });
        }
    }
    if d_s != 0.0 && !(n_rad_s.is_finite() && n_rad_s > 0.0) {
        return Err(Error::OutOfRange { key: "n_rad_s", found: n_rad_s, allowed: "finite and above 0" });
    }
    Ok(())
}

fn check(gain: f64, ti: f64, td: f64, filter_ratio: f64) -> Result<()> {
    if !gain.is_finite() {
        return Err(Error::OutOfRange { key: "gain", found: gain, allowed: "finite" });
    }
    if ti.is_nan() || ti <= 0.0 {
        return Err(Error::OutOfRange { key: "integral_time_s", found: ti, allowed: "above 0" });
    }
    if !(td.is_finite() && td >= 0.0) {
        return Err(Error::OutOfRange {
            key: "derivative_time_s",
            found: td,
            allowed: "finite and at least 0",
        });
    }
    if !(filter_ratio.is_finite() && filter_ratio > 0.0) {
        return Err(Error::OutOfRange {
            key: "filter_ratio",
            found: filter_ratio,
            allowed: "finite and above 0",
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use num_complex::Complex64;

    use super::*;

    #[test]
    fn law_series_form_and_its_parallel_gains_have_one_response() {
        for (k, ti, td, n) in [(1.3, 2.0, 1.2, 10.0), (-0.4, 0.3, 0.9, 4.0), (2.0, 5.0, 0.0, 8.0)] {
            let settings =
                SeriesPid { gain: k, integral_time_s: ti, derivative_time_s: td }.parallel(n).expect("valid");
            let system = settings.transfer_function().expect("finite");
            for omega in [0.01, 0.7, 13.0, 900.0] {
                let s = Complex64::new(0.0, omega);
                let expected = k * (1.0 + 1.0 / (ti * s)) * (1.0 + td * s) / (1.0 + s * td / n);
                assert!((system.at(omega) - expected).norm() < 1e-12 * expected.norm());
            }
        }
    }

    #[test]
    fn law_forms_and_parallel_gains_go_back_and_forth() {
        for (k, ti, td, n) in [
            (-3.0, 0.7, 0.1, 8.0),
            (2.0, 3.0, 0.5, 20.0),
            (1.0, f64::INFINITY, 0.3, 5.0),
            (4.0, 2.0, 0.0, 9.0),
        ] {
            let form = StandardPid { gain: k, integral_time_s: ti, derivative_time_s: td };
            let back = StandardPid::from_parallel(&form.parallel(n).expect("valid")).expect("one sign");
            assert!((back.form.derivative_time_s - td).abs() < 1e-14 && (back.form.gain - k).abs() < 1e-14);
            assert!(back.form.integral_time_s == ti || (back.form.integral_time_s - ti).abs() < 1e-14);
            let form = SeriesPid { gain: k, integral_time_s: ti, derivative_time_s: td };
            let back = SeriesPid::from_parallel(&form.parallel(n).expect("valid")).expect("real zeros");
            assert!(
                (back.form.derivative_time_s - td).abs() < 1e-12 && (back.form.gain - k).abs() < 1e-12,
                "{back:?}"
            );
            assert!(
                back.form.integral_time_s == ti || (back.form.integral_time_s - ti).abs() < 1e-12,
                "{back:?}"
            );
            assert!(back.filter_ratio.is_none_or(|found| (found - n).abs() < 1e-10), "{back:?}");
        }
        // Double zero: Ti = Td, at the border of existence.
        let double = SeriesPid { gain: 0.7, integral_time_s: 0.3, derivative_time_s: 0.3 };
        let back = SeriesPid::from_parallel(&double.parallel(11.0).expect("valid")).expect("real zeros").form;
        assert!((back.integral_time_s - 0.3).abs() < 1e-6 && (back.derivative_time_s - 0.3).abs() < 1e-6);
    }

    #[test]
    fn law_series_form_exists_where_the_zeros_are_real_and_stable() {
        // Without a filter that is Ti >= 4 Td; a very fast one moves the border by as little.
        for (ratio, exists) in [(4.01, true), (3.99, false), (0.5, false), (100.0, true)] {
            let form = StandardPid { gain: 2.0, integral_time_s: ratio * 0.2, derivative_time_s: 0.2 };
            let series = SeriesPid::from_parallel(&form.parallel(1e8).expect("valid"));
            assert_eq!(series.is_ok(), exists, "{series:?}");
        }
        // Opposite signs put a zero on the right.
        let mixed = PidSettings { p: 1.0, i_per_s: -1.0, d_s: 0.0, n_rad_s: 0.0 };
        assert!(matches!(SeriesPid::from_parallel(&mixed), Err(Error::PidNoSeriesForm { .. })));
        let pure_integral = PidSettings { p: 0.0, i_per_s: 1.0, ..mixed };
        assert!(matches!(SeriesPid::from_parallel(&pure_integral), Err(Error::PidNoSeriesForm { .. })));
    }

    #[test]
    fn edge_forms_that_do_not_exist_are_refused() {
        let mixed = PidSettings { p: 1.0, i_per_s: -1.0, d_s: 0.0, n_rad_s: 0.0 };
        assert!(StandardPid::from_parallel(&mixed).is_err());
        assert!(StandardPid::from_parallel(&PidSettings { p: 0.0, ..mixed }).is_err());
        let form = StandardPid { gain: f64::NAN, integral_time_s: 1.0, derivative_time_s: 0.0 };
        assert!(form.parallel(10.0).is_err());
        let no_filter = PidSettings { p: 1.0, i_per_s: 1.0, d_s: 1.0, n_rad_s: 0.0 };
        assert!(
            StandardPid::from_parallel(&no_filter).is_err() && SeriesPid::from_parallel(&no_filter).is_err()
        );
        assert!(StandardPid { gain: 1.0, integral_time_s: 0.0, ..form }.parallel(10.0).is_err());
        assert!(StandardPid { gain: 1.0, ..form }.parallel(0.0).is_err());
    }
}
