//! A point of a surface as light meets it.
//!
//! In: a hit. Out: a [`SurfaceInteraction`]: frames, normals on the side from which the ray came, the light
//! it gives off and its scattering. Light is scattered in the frame of the surface: of what moves, in coordinates that
//! move with it.

use super::bsdf::{Bsdf, ShadingFrame};
use geofan_core::manifold::LocalFrame;
use geofan_render::{Footprint, Hit, SurfacePoint, World, redshift::SurfaceState, shade};
use glam::{DMat3, DVec3};

/// Describes a surface where a ray has met it.
#[derive(Debug, Clone, Copy)]
pub struct SurfaceInteraction {
    /// The hit of the ray.
    pub hit: Hit,
    /// The point, for lamps.
    pub point: SurfacePoint,
    /// The normal observer there, the same in coordinates that move with the surface, and the metric.
    local: LocalFrame,
    moving: LocalFrame,
    metric: DMat3,
    /// The frame of the surface, and its inverse.
    frame: DMat3,
    inverse: DMat3,
    /// How far the surface moves for each unit of arc length of lines of sight, chart components.
    pace: DVec3,
    /// Directions around the normal, on the side of the ray.
    pub around: ShadingFrame,
    /// Towards where the ray came from, around the normal.
    pub wo: DVec3,
    /// Set if that is the side to which the mesh's normal points.
    pub outside: bool,
    /// The flat triangle's normal on that side, around the shading normal.
    flat: DVec3,
    /// Radiance given off, but as a black body.
    emitted: [f32; 3],
    /// How it moves and how hot it is; `None` where frequencies of light and motion do not matter.
    pub state: Option<SurfaceState>,
    pub bsdf: Bsdf,
}

impl SurfaceInteraction {
    /// Describes what each of `hits` met.
    pub fn of_hits(world: &World, hits: &[Hit]) -> Vec<Self> {
        let points: Vec<DVec3> = hits.iter().map(|hit| world.point(hit)).collect();
        let locals = world.manifold.local_frames(&points);
        let triangles = hits.iter().map(|hit| hit.triangle);
        let places: Vec<(DVec3, u32)> = points.iter().copied().zip(triangles).collect();
        let states = world.surface_states(&places);
        let observers = points.into_iter().zip(locals).enumerate();
        let surface = |(hit, (i, (u, local)))| {
            let state = states.as_ref().map(|states| states[i]);
            Self::new(world, hit, (u, local), state)
        };
        hits.iter().zip(observers).map(surface).collect()
    }

    /// Describes what `hit` met, at the chart point `u` with this `local`, and in this `state`.
    fn new(
        world: &World,
        hit: &Hit,
        (u, local): (DVec3, LocalFrame),
        state: Option<SurfaceState>,
    ) -> Self {
        let pace = state.map_or(DVec3::ZERO, |state| state.pace());
        let moving = match pace == DVec3::ZERO {
            true => local,
            false => local.moving(pace),
        };
        let metric = match moving.wind {
            Some(_) => world.manifold.metric(u),
            None => DMat3::IDENTITY,
        };
        let frame = moving.rest_frame(metric);
        let face = &world.faces[hit.triangle as usize];
        let material = &world.materials[face.material as usize];
        let tilted = |covector: DVec3| state.map_or(covector, |state| state.tilted(covector));
        let covector = tilted(world.covector(hit));
        let inverse = frame.inverse();
        let back = -(inverse * (hit.v.as_dvec3() - pace)).normalize_or_zero();
        let [p, q, r] = world.accelerator.triangles()[hit.triangle as usize];
        let across = (frame.transpose() * tilted((q - p).cross(r - p))).normalize_or_zero();
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
        let chosen = inverse.transpose() * normal;
        let emitted = shade::emission(world, hit, &Footprint::POINT);
        let bsdf = Bsdf::new(material, shade::diffuse(world, hit, &Footprint::POINT))
            .covering(f64::from(world.coverage(hit)));
        let glows = state.is_some_and(|state| state.glows());
        Self {
            hit: *hit,
            point: SurfacePoint {
                u,
                normal: state.map_or(chosen, |state| state.untilted(chosen)),
                triangle: hit.triangle,
            },
            local,
            moving,
            metric,
            frame,
            inverse,
            pace,
            wo: around.local(back),
            flat: around.local(flat),
            around,
            outside,
            emitted,
            state,
            bsdf: if glows { bsdf.black() } else { bsdf },
        }
    }

    /// Returns the radiance that it gives off, seen at `g` times the frequencies that it has there.
    pub fn emitted(&self, g: f64) -> DVec3 {
        let light = match &self.state {
            Some(state) => state.sent(self.emitted, g),
            None => self.emitted,
        };
        DVec3::from_array(light.map(f64::from)) * self.bsdf.solid()
    }

    /// Returns the direction (around the normal) of a path with the tangent `v`, of any length.
    pub fn direction(&self, v: DVec3) -> DVec3 {
        let along = self.inverse * (v - self.pace);
        self.around.local(along.normalize_or_zero())
    }

    /// Returns the tangent of the path in a direction around the normal.
    pub fn tangent(&self, w: DVec3) -> DVec3 {
        let along = self.frame * self.around.global(w);
        match self.moving.wind {
            Some(_) => self.moving.along(self.metric, along) + self.pace,
            None => along,
        }
    }

    /// Returns the direction around the normal that the normal observer sees as `d` (standard frame).
    pub fn around_normal(&self, d: DVec3) -> DVec3 {
        match self.moving.wind {
            Some(_) => self.direction(self.local.tangent(d)),
            None => self.around.local(d),
        }
    }

    /// Inverts [`Self::around_normal`].
    pub fn sight_of(&self, w: DVec3) -> DVec3 {
        match self.moving.wind {
            Some(_) => self.local.direction(self.tangent(w)),
            None => self.around.global(w),
        }
    }

    /// Tells how much larger a solid angle around the direction `w` is to the normal observer.
    pub fn spread_to_sight(&self, w: DVec3) -> f64 {
        let tangent = || self.tangent(w) - self.pace;
        match self.moving.wind {
            Some(_) => self.moving.spread_against_rest(self.metric, tangent()),
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
