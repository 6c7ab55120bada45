//! Whether light comes all the way to where it should.
//!
//! In: geodesics from a light to just at points of surfaces. Out: the end of each, unless something
//! is in its way ([`Way`]), and the share that surfaces which are not solid let through. Intersection
//! goes along with integration, so a shadow costs no ray of its own, and a ray in shadow is given up
//! where it begins.

use super::SurfacePoint;
use crate::{
    geodesic::{End, Ray, Settings, Sink, Step, follow},
    manifold::Manifold,
    render::{
        World,
        intersect::{Hit, first_hit, may_meet, region},
        tracer::pieces,
    },
};
use glam::{DMat3, DVec3};

/// What may be in the way of a geodesic.
#[derive(Clone, Copy)]
pub(crate) enum Way<'a> {
    /// Anything.
    Any,
    /// Nothing of the world, up to the surface point with the geodesic's number.
    Clear(&'a World, &'a [SurfacePoint]),
}

/// How far a geodesic has come.
pub(super) enum Reached {
    /// To its end.
    End(Arrival),
    /// Not so far.
    Nothing,
    /// To a surface that is in its way.
    Blocked,
}

/// The end of a geodesic.
#[derive(Debug, Clone, Copy)]
pub(super) struct Arrival {
    /// Chart point, and unit tangent there.
    pub u: DVec3,
    pub v: DVec3,
    /// The two deviations, if they were carried.
    pub spread: Option<[DVec3; 2]>,
    /// The standard frame there.
    pub frame: DMat3,
    /// The share of the light that surfaces on the way have let through.
    pub through: f64,
}

/// Share of the arc length by which a ray may stop short of its point and still have reached it: the
/// curve that is intersected departs from the exact one by a tenth of that. Farther from the
/// surface, shadows begin to come off what casts them.
const SHORT: f64 = 5e-4;

/// Light of which less than this share is let through is none.
const FAINT: f64 = 1e-3;

/// How far beyond a surface that lets light through the next is looked for, as a share of the arc
/// length: arc lengths of hits are in single precision.
const BEYOND: f64 = 1e-6;

/// The triangle of the point itself may be met as much earlier, where light grazes it.
const GRAZING: f64 = 0.1;

/// Follows `rays` along their `way`; `numbers` are those of their surface points.
pub(super) fn reached(
    manifold: &Manifold,
    settings: Settings,
    rays: Vec<Ray>,
    numbers: Vec<usize>,
    way: Way<'_>,
) -> Vec<Reached> {
    let flight = |(ray, number): (&Ray, usize)| Flight {
        length: ray.length,
        number,
        met: false,
        blocked: false,
        through: 1.0,
        end: None,
    };
    let flights = rays.iter().zip(numbers).map(flight).collect();
    let mut sink = Flights { flights, way };
    follow(manifold, settings, rays, &mut sink);
    with_frames(manifold, &sink.flights)
}

/// What the flights have reached.
fn with_frames(manifold: &Manifold, flights: &[Flight]) -> Vec<Reached> {
    let ends = |f: &Flight| f.end.map(|(u, ..)| u);
    let ends: Vec<DVec3> = flights.iter().filter_map(ends).collect();
    let mut frames = manifold.standard_frames(&ends).into_iter();
    let reached = |f: &Flight| match (f.blocked, f.end) {
        (true, _) => Reached::Blocked,
        (false, None) => Reached::Nothing,
        (false, Some((u, v, spread))) => {
            let frame = frames.next().expect("as many frames as ends");
            Reached::End(Arrival {
                u,
                v,
                spread,
                frame,
                through: f.through,
            })
        }
    };
    flights.iter().map(reached).collect()
}

struct Flight {
    length: f64,
    number: usize,
    /// Whether the surface of its point has been met.
    met: bool,
    /// Whether something is in its way.
    blocked: bool,
    /// What has been let through so far.
    through: f64,
    /// Point, tangent and deviations at its end.
    end: Option<(DVec3, DVec3, Option<[DVec3; 2]>)>,
}

struct Flights<'a> {
    flights: Vec<Flight>,
    way: Way<'a>,
}

impl Sink for Flights<'_> {
    fn wants(&self, ray: usize, _: f64) -> bool {
        matches!(self.way, Way::Clear(..)) && !self.flights[ray].met
    }

    fn region(&self) -> Option<(DVec3, DVec3)> {
        match self.way {
            Way::Any => None,
            Way::Clear(world, _) => region(&world.accelerator, &world.manifold.domain),
        }
    }

    fn wants_carried(&self) -> bool {
        false
    }

    fn step(&mut self, ray: usize, step: &Step) {
        let flight = &mut self.flights[ray];
        if let Way::Clear(world, points) = self.way
            && !flight.met
        {
            match flight.meets(world, points, step) {
                Some(true) => flight.met = true,
                Some(false) => {
                    flight.blocked = true;
                    return;
                }
                None => {}
            }
        }
        if step.end >= flight.length {
            let s = flight.length;
            flight.end = Some((step.position(s), step.tangent(s), step.deviation(s)));
        }
    }

    fn wants_more(&self, ray: usize) -> bool {
        !self.flights[ray].blocked
    }

    fn end(&mut self, _: usize, _: End, _: f64, _: usize) {}
}

impl Flight {
    /// Whether what the step meets is the surface of the flight's point; `None` if it meets nothing
    /// that stops it.
    fn meets(&mut self, world: &World, points: &[SurfacePoint], step: &Step) -> Option<bool> {
        let domain = &world.manifold.domain;
        if !may_meet(&world.accelerator, domain, step.bounds()) {
            return None;
        }
        for piece in pieces(step) {
            let mut rest = piece;
            while let Some(hit) = first_hit(&world.accelerator, domain, &rest, f64::INFINITY) {
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

    /// Whether anything gets through the surface.
    fn passes(&mut self, world: &World, hit: &Hit) -> bool {
        self.through *= 1.0 - f64::from(world.opacity(hit));
        self.through > FAINT
    }
}
