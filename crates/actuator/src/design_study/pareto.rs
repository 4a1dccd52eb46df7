//! Which variants no other one beats, and where to look next.

use super::space::Variant;

/// Indices of the points that no other point beats in both coordinates, by rising first coordinate; larger is better. Of
/// equal points the first is kept.
///
/// **Method**: sorted by falling first coordinate, a point is kept where its second exceeds all before it.
#[must_use]
pub fn pareto_front(points: &[[f64; 2]]) -> Vec<usize> {
    let mut order: Vec<usize> =
        (0..points.len()).filter(|&idx| !points[idx].iter().any(|v| v.is_nan())).collect();
    order.sort_by(|&i, &j| {
        let (a, b) = (points[i], points[j]);
        b[0].total_cmp(&a[0]).then(b[1].total_cmp(&a[1])).then(i.cmp(&j))
    });
    let mut best = f64::NEG_INFINITY;
    let mut front: Vec<usize> = Vec::new();
    for idx in order {
        if points[idx][1] > best {
            best = points[idx][1];
            front.push(idx);
        }
    }
    front.reverse();
    front
}

/// New variants between the members of the front and their neighbours on the grid: for each variable the middles to the next
/// lower and the next higher of `levels`, one variable at a time.
///
/// **Shapes and units**: `levels` holds the ascending values of each variable that were tried so far and receives the new
/// ones.
#[must_use]
pub fn refined(front: &[Variant], levels: &mut [Vec<f64>]) -> Vec<Variant> {
    let mut fresh: Vec<Variant> = Vec::new();
    let mut added: Vec<Vec<f64>> = vec![Vec::new(); levels.len()];
    for member in front {
        for (k, tried) in levels.iter().enumerate() {
            let at = tried.partition_point(|value| *value < member[k]);
            let neighbours = [at.checked_sub(1).map(|below| tried[below]), tried.get(at + 1).copied()];
            for neighbour in neighbours.into_iter().flatten() {
                let mut variant = member.clone();
                variant[k] = 0.5 * (member[k] + neighbour);
                if !fresh.contains(&variant) {
                    added[k].push(variant[k]);
                    fresh.push(variant);
                }
            }
        }
    }
    for (tried, new) in levels.iter_mut().zip(added) {
        tried.extend(new);
        tried.sort_by(f64::total_cmp);
        tried.dedup();
    }
    fresh
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_front_is_what_no_point_beats() {
        let mut seed = 17_u64;
        let mut random = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((seed >> 11) as f64 * 0.5_f64.powi(53) * 20.0).floor()
        };
        let points: Vec<[f64; 2]> = (0..200).map(|_| [random(), random()]).collect();
        let front = pareto_front(&points);
        let beats = |a: [f64; 2], b: [f64; 2]| a[0] >= b[0] && a[1] >= b[1] && a != b;
        for (idx, &point) in points.iter().enumerate() {
            let beaten = points.iter().any(|&other| beats(other, point));
            let kept = front.iter().any(|&member| points[member] == point);
            assert_eq!(kept, !beaten, "{idx}: {point:?}");
        }
        assert!(front.windows(2).all(|pair| points[pair[0]][0] < points[pair[1]][0]));
    }

    #[test]
    fn edge_empty_and_unknown_points() {
        assert!(pareto_front(&[]).is_empty());
        assert_eq!(pareto_front(&[[f64::NAN, 1.0], [1.0, 1.0], [1.0, 1.0]]), [1]);
    }

    #[test]
    fn law_refinement_halves_the_way_to_each_neighbour_once() {
        let mut levels = vec![vec![1.0, 2.0, 4.0], vec![10.0, 20.0]];
        let fresh = refined(&[vec![2.0, 10.0]], &mut levels);
        assert_eq!(fresh, [vec![1.5, 10.0], vec![3.0, 10.0], vec![2.0, 15.0]]);
        assert_eq!(levels, [vec![1.0, 1.5, 2.0, 3.0, 4.0], vec![10.0, 15.0, 20.0]]);
    }
}
