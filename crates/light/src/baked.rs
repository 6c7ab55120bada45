//! Light on surfaces that do not move, computed once.
//!
//! In: lamps and a layout of points. Out: a [`Lightmap`]: irradiance on both sides of every triangle, at
//! points that lie as close as the budget allows where light changes.

use crate::Lamps;
use geofan_render::{
    SurfacePoint,
    lightmap::{FacetLayout, Light, Lightmap},
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

/// Lights the points of `layout`, and up to `added` more; `done` is told how many more are finished, and
/// how many there are to be.
pub fn bake_light(
    lamps: &Lamps<'_>,
    mut layout: FacetLayout,
    added: usize,
    done: impl Fn(usize, usize) + Sync,
) -> Lightmap {
    let most = layout.len() + added;
    let done = |more: usize| done(more, most);
    let mut values = Vec::new();
    loop {
        values.extend(lit(lamps, &layout.points[values.len()..], &done));
        if !layout.refine(&values, most) {
            return Lightmap::new(layout, values).expect("every point has been lit");
        }
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
