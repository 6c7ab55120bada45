//! Connections and what casts shadows on them.
//!
//! In: geodesics from a lamp to points of surfaces. Out: the end of each, unless a surface casts a
//! shadow on it ([`Shadows`]), and the share of light that surfaces which are not solid let through.
//! Intersection goes along with integration, so a shadow costs no ray of its own, and a ray in shadow
//! is given up where the shadow begins.

use geofan_core::{
    geodesic::{End, Ray, Settings, Sink, Step, follow},
    manifold::{LocalFrame, Manifold},
};
use geofan_render::{
    Cubic, SurfacePoint, World,
    intersect::{Hit, HitSearch, may_meet, region},
    tracer::pieces,
};
use glam::DVec3;

/// Says what casts shadows.
#[derive(Clone, Copy)]
pub(crate) enum Shadows<'a> {
    /// Nothing.
    Ignored,
    /// The surfaces of the world, up to the surface point with the geodesic's number.
    Cast(&'a World, &'a [SurfacePoint]),
}

/// Says how far a geodesic has come.
#[expect(
    clippy::large_enum_variant,
    reason = "lives for a moment, most are ends"
)]
pub(super) enum FollowedRay {
    /// To its end.
    Arrived(RayEnd),
    /// Not so far: the space ended before.
    Ended,
    /// To a surface that casts a shadow on its end.
    Shadowed,
}

/// The end of a geodesic.
#[derive(Debug, Clone, Copy)]
pub(super) struct RayEnd {
    /// Chart point, and unit tangent there.
    pub u: DVec3,
    pub v: DVec3,
    /// The two deviations, if they were carried.
    pub spread: Option<[DVec3; 2]>,
    /// The standard frame there.
    pub local: LocalFrame,
    /// The share of the light that surfaces on the way have let through.
    pub through: f64,
}

/// Share of the arc length by which a ray may stop short of its point and still have reached it: the
/// curve that is intersected departs from the exact one by a tenth of that. Farther from the
/// surface, shadows begin to come off what casts them.
const SHORT: f64 = 5e-4;

/// Light of which less than this share is let through is none.
const FAINT: f64 = 1e-3;

/// Distance beyond a surface that lets light through from which the next is looked for, as a share of the arc
/// length: arc lengths of hits are in single precision.
const BEYOND: f64 = 1e-6;

/// The triangle of the point itself may be met as much earlier, where light grazes it.
const GRAZING: f64 = 0.1;

/// Follows `rays` until a surface casts a shadow on them; `numbers` are those of their surface points.
pub(super) fn follow_shadowed(
    manifold: &Manifold,
    settings: Settings,
    rays: Vec<Ray>,
    numbers: Vec<usize>,
    shadows: Shadows<'_>,
) -> Vec<FollowedRay> {
    let state = |(ray, number): (&Ray, usize)| RayState {
        length: ray.length,
        number,
        met: false,
        shadowed: false,
        through: 1.0,
        end: None,
        search: match shadows {
            Shadows::Ignored => None,
            Shadows::Cast(world, _) => Some(HitSearch::new(world)),
        },
    };
    let states = rays.iter().zip(numbers).map(state).collect();
    let mut sink = ShadowSink { states, shadows };
    follow(manifold, settings, rays, &mut sink);
    with_frames(manifold, &sink.states)
}

/// Adds the standard frames at the ends, all computed together.
fn with_frames(manifold: &Manifold, states: &[RayState<'_>]) -> Vec<FollowedRay> {
    let ends = |f: &RayState<'_>| f.end.map(|(u, ..)| u);
    let ends: Vec<DVec3> = states.iter().filter_map(ends).collect();
    let mut locals = manifold.local_frames(&ends).into_iter();
    let followed = |f: &RayState<'_>| match (f.shadowed, f.end) {
        (true, _) => FollowedRay::Shadowed,
        (false, None) => FollowedRay::Ended,
        (false, Some((u, v, spread))) => {
            let local = locals.next().expect("as many locals as ends");
            FollowedRay::Arrived(RayEnd {
                u,
                v,
                spread,
                local,
                through: f.through,
            })
        }
    };
    states.iter().map(followed).collect()
}

/// A ray being followed.
struct RayState<'w> {
    length: f64,
    number: usize,
    /// Set once the surface of its point has been met.
    met: bool,
    /// Set once another surface has been met before.
    shadowed: bool,
    /// The share of light that has been let through so far.
    through: f64,
    /// Point, tangent and deviations at its end.
    end: Option<(DVec3, DVec3, Option<[DVec3; 2]>)>,
    /// What it meets, if anything casts shadows.
    search: Option<HitSearch<'w>>,
}

/// Intersects the integrator's steps with what casts shadows.
struct ShadowSink<'a> {
    states: Vec<RayState<'a>>,
    shadows: Shadows<'a>,
}

impl Sink for ShadowSink<'_> {
    fn wants(&self, ray: usize, _: f64) -> bool {
        matches!(self.shadows, Shadows::Cast(..)) && !self.states[ray].met
    }

    fn region(&self) -> Option<(DVec3, DVec3)> {
        match self.shadows {
            Shadows::Ignored => None,
            Shadows::Cast(world, _) => region(world),
        }
    }

    fn wants_carried(&self) -> bool {
        false
    }

    fn step(&mut self, ray: usize, step: &Step) {
        let state = &mut self.states[ray];
        if let Shadows::Cast(world, points) = self.shadows
            && !state.met
        {
            match state.meets(world, points, step) {
                Some(true) => state.met = true,
                Some(false) => {
                    state.shadowed = true;
                    return;
                }
                None => {}
            }
        }
        if step.end >= state.length {
            let s = state.length;
            state.end = Some((step.position(s), step.tangent(s), step.deviation(s)));
        }
    }

    fn wants_more(&self, ray: usize) -> bool {
        !self.states[ray].shadowed
    }

    fn end(&mut self, _: usize, _: End, _: f64, _: usize) {}
}

impl RayState<'_> {
    /// Tells whether the step meets the surface of the ray's point, or one before it that stops light;
    /// `None` if it meets neither.
    fn meets(&mut self, world: &World, points: &[SurfacePoint], step: &Step) -> Option<bool> {
        if !may_meet(world, step.bounds()) {
            return None;
        }
        for piece in pieces(step) {
            let mut rest = piece;
            while let Some(hit) = self.first_hit(&rest) {
                let s = f64::from(hit.s);
                let at_point = hit.triangle == points[self.number].triangle;
                let own = at_point && s > (1.0 - GRAZING) * self.length;
                if own || s >= (1.0 - SHORT) * self.length {
                    return Some(true);
                }
                if !self.passes(world, &hit) {
                    return Some(false);
                }
                let Some(beyond) = rest.after(s + BEYOND * self.length) else {
                    break;
                };
                rest = beyond;
            }
        }
        None
    }

    /// Finds the first hit of a piece.
    fn first_hit(&mut self, piece: &Cubic) -> Option<Hit> {
        self.search.as_mut()?.first_hit(piece, f64::INFINITY)
    }

    /// Takes the share that a surface lets through; tells whether that is any.
    fn passes(&mut self, world: &World, hit: &Hit) -> bool {
        self.through *= 1.0 - f64::from(world.opacity(hit));
        self.through > FAINT
    }
}
