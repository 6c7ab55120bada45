//! The ranges of what is left of cameras when symmetry has been taken out.
//!
//! In: the camera region. Out: intervals that hold the invariants, and the angular momenta, of all its
//! points: a search on a grid, then from its best point downhill, because extremes lie between the
//! points of a grid.

use super::RaySpace;

/// Number of places at which the region is searched for the range of an invariant.
const RANGE_SAMPLES: usize = 4096;

/// How finely the camera's interval is searched for its least angular momentum.
const ORBIT_SAMPLES: usize = 256;

impl RaySpace {
    /// Returns whether the radius only rises or only falls over a region of one parameter, or none.
    pub(super) fn radius_is_monotonic(&self) -> bool {
        let region = self.region();
        let radius = |i: usize| region.at(&region.lerp(&[i as f64 / 256.0])).length();
        if region.dimension() == 0 {
            return true;
        }
        let rises: Vec<bool> = (0..256).map(|i| radius(i + 1) > radius(i)).collect();
        rises.iter().all(|r| *r) || rises.iter().all(|r| !*r)
    }

    /// Of the largest angular momentum of a ray from a stored camera, the least and the largest over them;
    /// without a wind, those of their areal radii.
    pub(super) fn largest_momenta(&self) -> [f64; 2] {
        let radius = |t: &[f64]| {
            let camera = self.cameras.iter().zip(t);
            let camera: Vec<f64> = camera
                .map(|([low, high], t)| low + (high - low) * t)
                .collect();
            self.radius(self.stored_point(&camera)).most()
        };
        let step = 1.0 / ORBIT_SAMPLES as f64;
        [1.0, -1.0].map(|sign| {
            let value = |t: &[f64]| sign * radius(t);
            let grid = (0..=ORBIT_SAMPLES).map(|i| i as f64 * step);
            let best = grid.min_by(|a, b| value(&[*a]).total_cmp(&value(&[*b])));
            sign * descend(value, vec![best.unwrap_or(0.5)], step)
        })
    }

    /// The intervals of the invariants over the region.
    pub(super) fn ranges(&self) -> Vec<[f64; 2]> {
        let k = self.region().dimension();
        let side = (RANGE_SAMPLES as f64).powf(1.0 / k.max(1) as f64).round() as usize;
        let count = if k == 0 { 1 } else { side.pow(k as u32) };
        let place = |i: usize| -> Vec<f64> {
            let along = |j: usize| i / side.pow(j as u32) % side;
            (0..k)
                .map(|j| along(j) as f64 / (side - 1) as f64)
                .collect()
        };
        let values = |t: &[f64]| self.invariants(self.region().at(&self.region().lerp(t)));
        let grid: Vec<Vec<f64>> = (0..count).map(|i| values(&place(i))).collect();
        let extreme = |j: usize, sign: f64| {
            let value = |t: &[f64]| sign * values(t)[j];
            let best = (0..count).min_by(|&a, &b| {
                let [a, b] = [a, b].map(|i| sign * grid[i][j]);
                a.total_cmp(&b)
            });
            sign * descend(value, place(best.unwrap_or(0)), 1.0 / side as f64)
        };
        let invariants = grid[0].len();
        (0..invariants)
            .map(|j| [extreme(j, 1.0), extreme(j, -1.0)])
            .collect()
    }
}

/// The least value near `t` in the unit cube, by trying both ways along each axis with steps that
/// halve when none helps.
fn descend(value: impl Fn(&[f64]) -> f64, mut t: Vec<f64>, mut step: f64) -> f64 {
    let mut least = value(&t);
    while step > 1e-12 {
        let mut better = false;
        for j in 0..t.len() {
            for to in [t[j] - step, t[j] + step].map(|x| x.clamp(0.0, 1.0)) {
                let before = std::mem::replace(&mut t[j], to);
                let found = value(&t);
                if found < least {
                    (least, better) = (found, true);
                } else {
                    t[j] = before;
                }
            }
        }
        step *= if better { 1.0 } else { 0.5 };
    }
    least
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::{diagnostic::SourceText, manifold::Manifold};
    use glam::DVec3;
    use std::sync::Arc;

    #[test]
    fn the_least_radius_of_a_box_around_the_centre_is_found() {
        let text = r#"
name = "flat"
coordinates = ["x", "y", "z"]
metric = { conformal = "1" }
[symmetry]
rotation = "origin"
[cameras]
parameters = { a = [-1, 2], b = [-2, 1], c = [-1, 1] }
at = ["a", "b", "c"]
"#;
        let source = SourceText::new("flat", text);
        let manifold = Arc::new(Manifold::from_source(source, &[]).unwrap());
        let space = RaySpace::new(manifold).unwrap();
        let [least, most] = space.cameras()[0];
        assert!(least.abs() < 1e-9 && (most - 3.0).abs() < 1e-12);
        assert!(space.place(DVec3::new(1e-3, 0.0, 0.0)).is_ok());
    }
}
