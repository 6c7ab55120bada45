//! Values on the axis of textbook coordinates, where formulas give none and the space is as smooth as
//! anywhere.
//!
//! In: a point, and numbers that are smooth functions of the point around it. Out: what they tend to
//! there, from points on both sides.

use glam::DVec3;

/// How far the nearest points are from the one asked for, as shares of its distance from the chart's
/// origin (in chart units at the origin itself). Near by, rounding spoils what is made of angles about
/// the axis; far away, the space is another. What differs least between two orders is taken.
const NEAREST: [f64; 6] = [3e-2, 1e-2, 3e-3, 1e-3, 1e-4, 1e-6];

/// From the point asked for to others: beside all coordinate axes and planes through it.
const BESIDE: DVec3 = DVec3::new(0.48, 0.6, 0.64);

/// Extrapolates what `values` tends to at `u`; not numbers if it is none around it.
pub(crate) fn around(u: DVec3, mut values: impl FnMut(DVec3) -> Vec<f64>) -> Vec<f64> {
    let scale = match u.length() {
        length if length > 0.0 => length,
        _ => 1.0,
    };
    let mut best: Option<(f64, Vec<f64>)> = None;
    for nearest in NEAREST {
        let (found, doubt) = extrapolated(u, BESIDE * (nearest * scale), &mut values);
        if best
            .as_ref()
            .is_none_or(|(least, _)| doubt < *least || least.is_nan())
        {
            best = Some((doubt, found));
        }
    }
    best.map(|(_, found)| found).unwrap_or_default()
}

/// Extrapolates the means of both sides at one, two and three times `by` to the point itself; and tells how far
/// that is, at most, from what the first two alone say.
fn extrapolated(
    u: DVec3,
    by: DVec3,
    values: &mut impl FnMut(DVec3) -> Vec<f64>,
) -> (Vec<f64>, f64) {
    let [one, two, three] = [1.0, 2.0, 3.0].map(|k| {
        let (a, b) = (values(u + by * k), values(u - by * k));
        a.iter()
            .zip(b)
            .map(|(a, b)| 0.5 * (a + b))
            .collect::<Vec<_>>()
    });
    let mut doubt = 0.0;
    let mut found = Vec::with_capacity(one.len());
    for ((a, b), c) in one.iter().zip(two).zip(three) {
        // Even functions of the distance: terms of the second and of the fourth power fall out.
        let all = (15.0 * a - 6.0 * b + c) / 10.0;
        let off = (all - (4.0 * a - b) / 3.0).abs();
        doubt = if off <= doubt { doubt } else { off };
        found.push(all);
    }
    (found, doubt)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smooth_values_are_found_whatever_the_size_of_the_space() {
        for size in [1e-3, 1.0, 1e4] {
            let u = DVec3::new(0.0, 0.0, 2.0 * size);
            let values = |u: DVec3| {
                let (x, y) = (u.x / size, u.y / size);
                let rho2 = x * x + y * y;
                // sin ρ/ρ in disguise, with an odd function beside it.
                vec![rho2.sqrt().sin() / rho2.sqrt() + x, (u.z / size).cos()]
            };
            assert!(!values(u)[0].is_finite());
            let found = around(u, values);
            assert!((found[0] - 1.0).abs() < 1e-11, "{}", found[0]);
            assert!((found[1] - 2.0_f64.cos()).abs() < 1e-11, "{}", found[1]);
        }
    }
}
