//! A path as equally spaced samples.
//!
//! In: a [`Ray`] and its [`Path`]. Out: [`Sample`]s from arc length 0 to the path's end, both
//! included. Vectors are in chart components; a glued coordinate is given inside its limits.

use super::{Path, Ray, Step, signed_area};
use crate::manifold::Manifold;
use glam::{DMat3, DVec3};

/// What is known at one arc length of a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Arc length from the start.
    pub s: f64,
    /// Chart point, inside the limits of glued coordinates.
    pub u: DVec3,
    /// Tangent, of unit length (against the wind, where there is one).
    pub v: DVec3,
    /// Columns: the transported vectors that start as the standard frame. `None` when the frame
    /// was not carried.
    pub frame: Option<DMat3>,
    /// The area by which a unit solid angle has spread. `None` when deviation was not carried.
    pub area: Option<f64>,
}

/// `count` equally spaced samples of `path`, which must be the path of `ray`; at least two. A path
/// that ended at its start gives its start `count` times.
pub fn samples(manifold: &Manifold, ray: &Ray, path: &Path, count: usize) -> Vec<Sample> {
    let last = count.max(2) - 1;
    (0..=last)
        .map(|i| path.length * (i as f64 / last as f64))
        .map(|s| match path.step_at(s) {
            Some(step) => on_step(manifold, step, s),
            None => at_start(manifold, ray),
        })
        .collect()
}

fn on_step(manifold: &Manifold, step: &Step, s: f64) -> Sample {
    let u = manifold.domain.wrap(step.position(s));
    let local = manifold.local_frame(u);
    let v = local.restored(manifold.metric(u), step.tangent(s));
    let turned = |q| local.frame * DMat3::from_quat(q);
    let area = |j| signed_area(&local, v, j).abs();
    Sample {
        s,
        u,
        v,
        frame: step.rotation(s).map(turned),
        area: step.deviation(s).map(area),
    }
}

fn at_start(manifold: &Manifold, ray: &Ray) -> Sample {
    let u = manifold.domain.wrap(ray.u);
    Sample {
        s: 0.0,
        u,
        v: ray.v,
        frame: Some(manifold.standard_frame(u)),
        area: Some(0.0),
    }
}
