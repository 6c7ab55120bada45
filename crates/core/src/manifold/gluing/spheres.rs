//! Faces that are planes or spheres of the chart, as those of most spaces are: their values without a tape.
//!
//! In: the tape of all faces. Out: [`Spheres`] where every value is linear in (u, |u|², 1). Points are brought back
//! into a domain many times for every pixel; so each time costs a tenth.

use super::deck::{on_cone, solve};
use geofan_expr::Tape;
use glam::DVec3;

/// Share of its terms by which a value may differ from the tape's.
const SAME_VALUE: f64 = 1e-11;

/// How far from their middle points are pushed to look at faces outside the domain, as multiples of their distance.
const OUTSIDE: [f64; 4] = [1.0, 1.7, 4.0, 30.0];

/// The faces as linear functions of (u, |u|², 1).
#[derive(Debug, Clone)]
pub(super) struct Spheres(Vec<[f64; 5]>);

impl Spheres {
    /// Finds the functions that the tape agrees with at `points` in general position and farther out, if it does.
    pub fn of(values: &Tape, faces: usize, points: &[DVec3]) -> Option<Self> {
        let stride = points.len() / 5;
        let chosen: Vec<DVec3> = (0..5)
            .map(|i| points.get(i * stride).copied())
            .collect::<Option<_>>()?;
        let at: Vec<Vec<f64>> = chosen.iter().map(|u| values.at(&u.to_array())).collect();
        let mut rows = Vec::with_capacity(faces);
        for first in (0..faces).step_by(5) {
            let mut system = [[0.0; 10]; 5];
            for (row, (u, values)) in system.iter_mut().zip(chosen.iter().zip(&at)) {
                row[..5].copy_from_slice(&on_cone(*u));
                for (to, value) in row[5..].iter_mut().zip(&values[first..faces]) {
                    *to = *value;
                }
            }
            let solved = solve(system)?;
            let count = 5.min(faces - first);
            rows.extend((0..count).map(|k| std::array::from_fn(|j| solved[j][k])));
        }
        let spheres = Self(rows);
        let middle = points.iter().sum::<DVec3>() / points.len() as f64;
        let mut places = points.iter().flat_map(|u| {
            let pushed = |factor: &f64| middle + (*u - middle) * *factor;
            OUTSIDE.iter().map(pushed).collect::<Vec<_>>()
        });
        let agrees = |u: DVec3| {
            let values = values.at(&u.to_array());
            (0..faces).all(|k| (spheres.value(k, u) - values[k]).abs() <= spheres.rounding(k, u))
        };
        places.all(agrees).then_some(spheres)
    }

    /// Computes the value of face `k` at `u`.
    #[inline(always)]
    pub fn value(&self, k: usize, u: DVec3) -> f64 {
        let [a, b, c, d, e] = self.0[k];
        a * u.x + b * u.y + c * u.z + d * u.length_squared() + e
    }

    /// Computes the gradient of face `k` at `u`.
    #[inline(always)]
    pub fn gradient(&self, k: usize, u: DVec3) -> DVec3 {
        let [a, b, c, d, _] = self.0[k];
        DVec3::new(a, b, c) + u * (2.0 * d)
    }

    /// Returns by how much the value of face `k` at `u` may be off.
    fn rounding(&self, k: usize, u: DVec3) -> f64 {
        let terms = self.0[k].iter().zip(on_cone(u));
        SAME_VALUE * terms.map(|(a, x)| (a * x).abs()).sum::<f64>()
    }
}
