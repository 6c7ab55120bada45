//! The exponential map and its differential.
//!
//! In: a chart point `u` and a tangent vector `w` there. Out: where the geodesic with velocity `w`
//! arrives after unit time, `exp_u(w)`, with the differential by `w`, which comes from the geodesic
//! deviation: along `w` it is the tangent, across it `J/|w|` (M. do Carmo, *Riemannian Geometry*,
//! ch. 5, cor. 2.5).

use super::{End, Ray, Settings, Step, paths};
use crate::manifold::{Carried, Manifold};
use glam::{DMat3, DQuat, DVec3};

/// `exp_u(w)` and what belongs to it. Vectors are in chart components.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exponential {
    /// The point reached. A glued coordinate is not brought back inside its limits.
    pub point: DVec3,
    /// The velocity on arrival: as long as `w`.
    pub velocity: DVec3,
    /// `∂point/∂w`; singular where the point is conjugate to `u`.
    pub differential: DMat3,
    /// The transported rotation, relative to the standard frames.
    pub rotation: DQuat,
}

/// `exp_u(w)`, each step exact to `tolerance`; `None` where the geodesic ends before. Exits do not end
/// it, and no wind blows it off.
pub fn exponential(manifold: &Manifold, u: DVec3, w: DVec3, tolerance: f64) -> Option<Exponential> {
    let manifold = &*manifold.still();
    let s = manifold.standard_frame(u);
    let components = s.inverse() * w;
    let length = components.length();
    if length == 0.0 {
        return Some(Exponential {
            point: u,
            velocity: w,
            differential: DMat3::IDENTITY,
            rotation: DQuat::IDENTITY,
        });
    }
    let ray = Ray::new(manifold, u, components / length, length);
    let settings = Settings {
        tolerance,
        carried: Carried {
            frame: true,
            deviation: true,
        },
        events: false,
    };
    let path = paths(manifold, settings, [ray]).pop()?;
    match (path.end, path.steps.last()) {
        (End::Length, Some(step)) => arrival(&ray, step),
        _ => None,
    }
}

fn arrival(ray: &Ray, step: &Step) -> Option<Exponential> {
    let s = ray.length;
    let (v, j) = (step.tangent(s), step.deviation(s)?);
    // Columns: how the end moves with w along the ray, and across it.
    let moved = DMat3::from_cols(v, j[0] / s, j[1] / s);
    let start = DMat3::from_cols(ray.v, ray.spread[0], ray.spread[1]);
    Some(Exponential {
        point: step.position(s),
        velocity: v * s,
        differential: moved * start.inverse(),
        rotation: step.rotation(s)?,
    })
}
