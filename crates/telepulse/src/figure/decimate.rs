//! Fewer points for the same picture.

/// Horizontal and vertical values, equally many.
#[derive(Debug, Clone, PartialEq)]
pub struct Points {
    /// Horizontal values.
    pub x: Vec<f64>,
    /// Vertical values.
    pub y: Vec<f64>,
}

/// At most `n_points_max` samples of the curve that keep its envelope.
///
/// **Method**: M4. The samples are cut into runs of equal count; of each run the first, the last, the lowest
/// and the highest sample survive, and one non-finite sample if there is any, so that gaps stay gaps. A
/// series that is short enough is returned unchanged. A line drawn at no more pixels than there are runs
/// looks the same as the full one.
///
/// **Source**: Jugel, Jerzak, Hackenbroich, Markl 2014, "M4: a visualization-oriented time series data
/// aggregation".
///
/// **Accuracy**: global minimum and maximum are kept exactly. Meant for series that advance in x, such as
/// time series; of a closed curve only the extremes in y are sure to survive.
///
/// **Panics** if `n_points_max < 5` or the lengths differ.
pub fn decimate(x: &[f64], y: &[f64], n_points_max: usize) -> Points {
    assert!(n_points_max >= KEPT_PER_RUN && x.len() == y.len());
    if x.len() <= n_points_max {
        return Points { x: x.to_vec(), y: y.to_vec() };
    }
    let n_runs = n_points_max / KEPT_PER_RUN;
    let mut kept = Points { x: Vec::with_capacity(n_points_max), y: Vec::with_capacity(n_points_max) };
    for run in 0..n_runs {
        let begin = run * y.len() / n_runs;
        let end = (run + 1) * y.len() / n_runs;
        let mut survivors = survivors(&y[begin..end]);
        survivors.sort_unstable();
        let mut previous = None;
        for offset in survivors {
            if previous != Some(offset) {
                kept.x.push(x[begin + offset]);
                kept.y.push(y[begin + offset]);
            }
            previous = Some(offset);
        }
    }
    kept
}

/// Offsets of the first, last, lowest, highest and (if any) first non-finite sample of a run that is not
/// empty.
fn survivors(y: &[f64]) -> [usize; KEPT_PER_RUN] {
    let mut lowest = 0;
    let mut highest = 0;
    let mut gap = 0;
    for (offset, &value) in y.iter().enumerate() {
        // Comparisons with NaN are false, so a run that starts with one has to be helped over it.
        if value < y[lowest] || !y[lowest].is_finite() {
            lowest = offset;
        }
        if value > y[highest] || !y[highest].is_finite() {
            highest = offset;
        }
        if !value.is_finite() && y[gap].is_finite() {
            gap = offset;
        }
    }
    [0, y.len() - 1, lowest, highest, gap]
}

const KEPT_PER_RUN: usize = 5;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_extremes_ends_and_order_survive() {
        let n = 80_000;
        let x: Vec<f64> = (0..n).map(|i| i as f64 / 2000.0).collect();
        let mut y: Vec<f64> = x.iter().map(|t| (t * 7.0).sin()).collect();
        y[12_345] = 9.0;
        y[54_321] = -7.0;
        let kept = decimate(&x, &y, 4000);
        assert!(kept.x.len() <= 4000 && kept.x.len() > 1500);
        assert!(kept.y.contains(&9.0) && kept.y.contains(&-7.0));
        assert_eq!((kept.x[0], kept.x.last()), (0.0, x.last()));
        assert!(kept.x.windows(2).all(|pair| pair[0] < pair[1]));
    }

    #[test]
    fn law_short_series_are_untouched() {
        let x = [0.0, 1.0, 2.0];
        let y = [1.0, f64::NAN, 3.0];
        let kept = decimate(&x, &y, 5);
        assert_eq!(kept.x, x);
        assert!(kept.y[1].is_nan());
    }

    #[test]
    fn edge_gaps_stay_gaps() {
        let x: Vec<f64> = (0..1000).map(f64::from).collect();
        let mut y = vec![1.0; 1000];
        y[500] = f64::NAN;
        y[0] = f64::INFINITY;
        let kept = decimate(&x, &y, 50);
        assert_eq!(kept.y.iter().filter(|v| !v.is_finite()).count(), 2);
    }
}
