//! A point of a surface as light meets it.
//!
//! In: a hit. Out: a [`SurfaceInteraction`]: frames, normals on the side from which the ray came, the light
//! it gives off and its scattering.

use super::bsdf::{Bsdf, ShadingFrame};
use geofan_core::manifold::LocalFrame;
use geofan_render::{Footprint, Hit, SurfacePoint, World, shade};
use glam::{DMat3, DVec3};

/// Describes a surface where a ray has met it.
#[derive(Debug, Clone, Copy)]
pub struct SurfaceInteraction {
    /// The hit of the ray.
    pub hit: Hit,
    /// The point, for lamps.
    pub point: SurfacePoint,
    /// The observer there, and the metric.
    local: LocalFrame,
    metric: DMat3,
    /// The frame of what is at rest there, as surfaces are, and its inverse.
    frame: DMat3,
    inverse: DMat3,
    /// Directions around the normal, on the side of the ray.
    pub around: ShadingFrame,
    /// Towards where the ray came from, around the normal.
    pub wo: DVec3,
    /// Set if that is the side to which the mesh's normal points.
    pub outside: bool,
    /// The flat triangle's normal on that side, around the shading normal.
    flat: DVec3,
    /// Radiance given off.
    pub emitted: DVec3,
    pub bsdf: Bsdf,
}

impl SurfaceInteraction {
    /// Describes what each of `hits` met.
    pub fn of_hits(world: &World, hits: &[Hit]) -> Vec<Self> {
        let points: Vec<DVec3> = hits.iter().map(|hit| world.point(hit)).collect();
        let locals = world.manifold.local_frames(&points);
        let surface = |((hit, u), local)| Self::new(world, hit, u, local);
        hits.iter().zip(points).zip(locals).map(surface).collect()
    }

    /// Describes what `hit` met, at the chart point `u` with this `local`.
    fn new(world: &World, hit: &Hit, u: DVec3, local: LocalFrame) -> Self {
        let metric = match local.wind {
            Some(_) => world.manifold.metric(u),
            None => DMat3::IDENTITY,
        };
        let frame = local.rest_frame(metric);
        let face = &world.faces[hit.triangle as usize];
        let material = &world.materials[face.material as usize];
        let covector = world.covector(hit);
        let inverse = frame.inverse();
        let back = -(inverse * hit.v.as_dvec3()).normalize_or_zero();
        let [p, q, r] = world.accelerator.triangles()[hit.triangle as usize];
        let across = (frame.transpose() * (q - p).cross(r - p)).normalize_or_zero();
        let flat = if across.dot(back) < 0.0 {
            -across
        } else {
            across
        };
        let smooth = (frame.transpose() * covector).normalize_or(flat);
        let outside = smooth.dot(flat) >= 0.0;
        let facing = if outside { smooth } else { -smooth };
        // A smoothed normal that looks away from the viewer is not used.
        let normal = if facing.dot(back) > 0.0 { facing } else { flat };
        let around = ShadingFrame::new(normal);
        let emitted = shade::emission(world, hit, &Footprint::POINT);
        let bsdf = Bsdf::new(material, shade::diffuse(world, hit, &Footprint::POINT))
            .covering(f64::from(world.coverage(hit)));
        Self {
            hit: *hit,
            point: SurfacePoint {
                u,
                normal: inverse.transpose() * normal,
                triangle: hit.triangle,
            },
            local,
            metric,
            frame,
            inverse,
            wo: around.local(back),
            flat: around.local(flat),
            around,
            outside,
            emitted: DVec3::from_array(emitted.map(f64::from)) * bsdf.solid(),
            bsdf,
        }
    }

    /// Returns the direction (around the normal) of a chart vector.
    pub fn direction(&self, v: DVec3) -> DVec3 {
        self.around.local((self.inverse * v).normalize_or_zero())
    }

    /// Returns the tangent of the path in a direction around the normal.
    pub fn tangent(&self, w: DVec3) -> DVec3 {
        let along = self.frame * self.around.global(w);
        match self.local.wind {
            Some(_) => self.local.along(self.metric, along),
            None => along,
        }
    }

    /// Returns the direction around the normal that the normal observer sees as `d` (standard frame).
    pub fn around_normal(&self, d: DVec3) -> DVec3 {
        match self.local.wind {
            Some(_) => self.direction(self.local.tangent(d)),
            None => self.around.local(d),
        }
    }

    /// Inverts [`Self::around_normal`].
    pub fn sight_of(&self, w: DVec3) -> DVec3 {
        match self.local.wind {
            Some(_) => self.local.direction(self.tangent(w)),
            None => self.around.global(w),
        }
    }

    /// Tells how much larger a solid angle around the direction `w` is to the normal observer.
    pub fn spread_to_sight(&self, w: DVec3) -> f64 {
        match self.local.wind {
            Some(_) => self.local.spread_against_rest(self.metric, self.tangent(w)),
            None => 1.0,
        }
    }

    /// Tells whether the smooth surface and the flat triangle agree about which side `w` is on.
    pub fn is_possible(&self, w: DVec3) -> bool {
        (w.z > 0.0) == (w.dot(self.flat) > 0.0)
    }

    /// Returns the chart point a distance `off` (in the metric) from the triangle, on the side of `w`: rays
    /// that start there do not meet the triangle again by rounding.
    pub fn beside(&self, w: DVec3, off: f64) -> DVec3 {
        let side = off.copysign(w.dot(self.flat));
        self.point.u + self.frame * self.around.global(self.flat) * side
    }
}
