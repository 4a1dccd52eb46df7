//! Integration of smooth equations over an interval by extrapolated midpoint steps.

/// Columns of the extrapolation table: order 2 to 16.
const COLUMNS: usize = 8;
/// Halvings of an interval before integration gives up.
const MAX_HALVINGS: u32 = 4;

/// Advances `y` from `from` to `to`; `None` where the right-hand side has no value or the tolerance is not met.
///
/// **Method**: Gragg's modified midpoint rule with 2, 4, .. 16 substeps, extrapolated to zero step in the square of the
/// step; an interval that does not converge by then is halved.
///
/// **Accuracy**: two neighbouring entries of the table agree within `tolerance`, relative to the larger of 1 and the entry.
///
/// **Source**: Hairer, Norsett, Wanner 1993, Solving Ordinary Differential Equations I, section II.9.
pub(super) fn integrate<const N: usize>(
    y: &mut [f64; N],
    from: f64,
    to: f64,
    tolerance: f64,
    rate: &mut impl FnMut(f64, &[f64; N]) -> Option<[f64; N]>,
) -> Option<()> {
    let mut pieces = 1_u64;
    let mut done = 0_u64;
    let mut halvings = 0;
    // Pieces are counted in units of the present halving; at most 2^MAX_HALVINGS of them.
    while done < pieces {
        let width = (to - from) / pieces as f64;
        let start = from + done as f64 * width;
        match extrapolate(y, start, width, tolerance, rate) {
            Some(end) => {
                *y = end;
                done += 1;
            }
            None if halvings < MAX_HALVINGS => {
                halvings += 1;
                (pieces, done) = (2 * pieces, 2 * done);
            }
            None => return None,
        }
    }
    Some(())
}

fn extrapolate<const N: usize>(
    y: &[f64; N],
    start: f64,
    width: f64,
    tolerance: f64,
    rate: &mut impl FnMut(f64, &[f64; N]) -> Option<[f64; N]>,
) -> Option<[f64; N]> {
    let first = rate(start, y)?;
    let mut row = [[0.0; N]; COLUMNS];
    for k in 0..COLUMNS {
        let substeps = 2 * (k + 1);
        let mut entry = midpoint(y, &first, start, width, substeps, rate)?;
        let mut worst = f64::INFINITY;
        for (column, stored) in row.iter_mut().enumerate().take(k) {
            let ratio = (substeps as f64 / (2 * (k - column)) as f64).powi(2);
            let before = std::mem::replace(stored, entry);
            worst = 0.0;
            for i in 0..N {
                let correction = (entry[i] - before[i]) / (ratio - 1.0);
                entry[i] += correction;
                worst = worst.max(correction.abs() / entry[i].abs().max(1.0));
            }
        }
        row[k] = entry;
        if k >= 2 && worst <= tolerance {
            return Some(entry);
        }
    }
    None
}

/// Gragg's rule with an even number of substeps, without smoothing.
fn midpoint<const N: usize>(
    y: &[f64; N],
    first: &[f64; N],
    start: f64,
    width: f64,
    substeps: usize,
    rate: &mut impl FnMut(f64, &[f64; N]) -> Option<[f64; N]>,
) -> Option<[f64; N]> {
    let h = width / substeps as f64;
    let mut before = *y;
    let mut now: [f64; N] = std::array::from_fn(|i| y[i] + h * first[i]);
    for step in 1..substeps {
        let slope = rate(start + step as f64 * h, &now)?;
        let next = std::array::from_fn(|i| before[i] + 2.0 * h * slope[i]);
        (before, now) = (now, next);
    }
    Some(now)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_integrates_to_rounding_and_refuses_a_pole() {
        let mut y = [1.0, 0.0];
        integrate(&mut y, 0.0, 10.0, 1e-14, &mut |_, y: &[f64; 2]| Some([-y[1], y[0]])).expect("smooth");
        assert!((y[0] - 10.0_f64.cos()).abs() < 1e-12 && (y[1] - 10.0_f64.sin()).abs() < 1e-12, "{y:?}");
        // y' = y^2 from 1 has its pole at 1.
        let mut y = [1.0];
        let ended = integrate(&mut y, 0.0, 2.0, 1e-13, &mut |_, y: &[f64; 1]| {
            (y[0].abs() < 1e9).then_some([y[0] * y[0]])
        });
        assert_eq!(ended, None);
    }
}
