//! Rays from anywhere: each followed exactly until it meets the scene, leaves, or is used up.
//!
//! In: chart points with unit tangents and lengths. Out: what each finds. Rays run over the lanes of
//! the integrator and are given up at their first hit, so a short one costs little.

use super::{
    curve::{Ending, ending_at},
    intersect::{first_hit, may_meet, region},
    outcome::{Seen, beyond},
    tracer::pieces,
    world::World,
};
use geofan_core::{
    geodesic::{End, Ray, Settings, Sink, Step, follow},
    manifold::Carried,
};
use glam::DVec3;

/// A ray to follow until it finds something.
#[derive(Debug, Clone, Copy)]
pub struct Probe {
    /// Chart point.
    pub u: DVec3,
    /// Unit tangent, chart components.
    pub v: DVec3,
    /// How far (arc length).
    pub length: f64,
}

/// What each of `rays` finds first, at a local tolerance.
pub fn first_seen(world: &World, rays: &[Probe], tolerance: f64) -> Vec<Seen> {
    let settings = Settings {
        tolerance,
        carried: Carried::default(),
        events: true,
    };
    let starts = rays.iter().map(|probe| Ray {
        u: probe.u,
        v: probe.v,
        length: probe.length,
        spread: [DVec3::ZERO; 2],
    });
    let state = |probe: &Probe| (probe.u, probe.v, None);
    let mut sink = FirstSeen {
        world,
        rays: rays.iter().map(state).collect(),
    };
    follow(&world.manifold, settings, starts, &mut sink);
    let seen = |(_, _, seen): (DVec3, DVec3, Option<Seen>)| seen.unwrap_or(Seen::Nothing);
    sink.rays.into_iter().map(seen).collect()
}

struct FirstSeen<'w> {
    world: &'w World,
    /// The end of the last step, and what was found.
    rays: Vec<(DVec3, DVec3, Option<Seen>)>,
}

impl Sink for FirstSeen<'_> {
    fn region(&self) -> Option<(DVec3, DVec3)> {
        region(&self.world.accelerator, &self.world.manifold.domain)
    }

    fn step(&mut self, ray: usize, step: &Step) {
        let (accelerator, domain) = (&self.world.accelerator, &self.world.manifold.domain);
        let (u, v, seen) = &mut self.rays[ray];
        if may_meet(accelerator, domain, step.bounds()) {
            let hit = |piece| first_hit(accelerator, domain, &piece, f64::INFINITY);
            if let Some(hit) = pieces(step).find_map(hit) {
                *seen = Some(Seen::Surface(hit));
                return;
            }
        }
        (*u, *v) = (step.position(step.end), step.tangent(step.end));
    }

    fn wants_more(&self, ray: usize) -> bool {
        self.rays[ray].2.is_none()
    }

    fn end(&mut self, ray: usize, end: End, s: f64, _: usize) {
        let (u, v, seen) = &mut self.rays[ray];
        if seen.is_none()
            && let ending @ Ending::Exit { .. } = ending_at(&self.world.manifold, end, s, *u, *v)
        {
            *seen = Some(beyond(&ending));
        }
    }
}
