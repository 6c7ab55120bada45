//! Light on surfaces that do not move, computed once.
//!
//! In: a world with lights. Out: [`Baked`]: irradiance on both sides of every triangle, at the points
//! of a layout that is as fine as the budget allows where light changes, linear in between.

use super::{
    Lamps, SurfacePoint,
    facets::{Layout, Light},
};
use rayon::prelude::*;

/// Points spread evenly over a whole scene. On a floor that fills the picture they are four or five
/// pixels of a thousand apart: what is smaller casts no shadow.
pub const EVEN: usize = 16_000;

/// Points added where light changes. Behind a bump one core lights 15,000 points a second, so both
/// together take two seconds on two.
pub const ADDED: usize = 24_000;

/// Points lit by one thread at a time: enough to fill the integrator's lanes many times over.
const BLOCK: usize = 256;

/// Irradiance on the triangles of a world.
#[derive(Debug, Clone, PartialEq)]
pub struct Baked {
    layout: Layout,
    /// Irradiance on the front (red, green, blue), then on the back, one for each point.
    pub values: Vec<Light>,
}

impl Baked {
    /// Lights the points of `layout`, and up to `added` more; `done` is told how many more are
    /// finished, and how many there are to be.
    pub fn new(
        lamps: &Lamps<'_>,
        mut layout: Layout,
        added: usize,
        done: impl Fn(usize, usize) + Sync,
    ) -> Self {
        let most = layout.len() + added;
        let done = |more: usize| done(more, most);
        let mut values = Vec::new();
        loop {
            values.extend(lit(lamps, &layout.points[values.len()..], &done));
            if !layout.refine(&values, most) {
                return Self { layout, values };
            }
        }
    }

    /// Puts known values on a layout after dividing it; `None` if they do not fit.
    pub fn from_values(mut layout: Layout, divided: &[u32], values: Vec<Light>) -> Option<Self> {
        for facet in divided {
            layout.divide(*facet)?;
        }
        (values.len() == layout.len()).then_some(Self { layout, values })
    }

    /// The facets of the layout that have been divided, in order.
    pub fn divided(&self) -> &[u32] {
        self.layout.divided()
    }

    /// Irradiance at the place with weights `barycentric` of `triangle`, on the front or the back.
    pub fn at(&self, triangle: u32, barycentric: [f32; 2], front: bool) -> [f32; 3] {
        let side = if front { 0 } else { 3 };
        let (corners, weights) = self.layout.around(triangle, barycentric);
        let lights = corners.map(|number| &self.values[number as usize]);
        let part = |k: usize| {
            (0..3)
                .map(|i| lights[i][side + k] * weights[i])
                .sum::<f32>()
        };
        [part(0), part(1), part(2)].map(|x| x.max(0.0))
    }
}

/// The light at points; `done` is told how many more are finished.
fn lit(lamps: &Lamps<'_>, points: &[SurfacePoint], done: &(impl Fn(usize) + Sync)) -> Vec<Light> {
    let block = |points: &[SurfacePoint]| -> Vec<Light> {
        let mut sums = vec![[0.0_f64; 6]; points.len()];
        for (index, arrival) in lamps.arrivals(points).0 {
            let side = if arrival.front { 0 } else { 3 };
            for k in 0..3 {
                sums[index][side + k] += arrival.irradiance[k];
            }
        }
        done(points.len());
        sums.into_iter().map(|s| s.map(|x| x as f32)).collect()
    };
    points.par_chunks(BLOCK).flat_map_iter(block).collect()
}
