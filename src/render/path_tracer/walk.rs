//! Paths at random, many at once.
//!
//! In: a world, a view and settings. Out: one sample of every pixel for every pass. The paths of a
//! block of pixels go from surface to surface together: all rays of a bounce are traced in one batch
//! over the integrator's lanes, then all geodesics that connect to lights, then all shadow rays.

use super::{
    bsdf::balance,
    emitters::{Chosen, Emitters, is_same, principal},
    surface::Surface,
};
use crate::{
    random::Stream,
    render::{
        Footprint, Hit, Probe, Seen, View, World, first_seen,
        light::{Connection, Lamps, SurfacePoint},
    },
};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// What decides a picture besides world and view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Another seed gives another picture of the same light.
    pub seed: u64,
    /// How far light is followed between surfaces (arc length).
    pub length: f64,
    /// Local tolerance of geodesics.
    pub tolerance: f64,
    /// Light that has been reflected more often than this is left out: `u32::MAX` for all light, 1
    /// for direct light alone.
    pub bounces: u32,
    /// How light is gathered.
    pub estimator: Estimator,
}

/// How light is gathered; both give the same picture in the end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Estimator {
    /// Lights are connected to at every bounce, weighed against meeting them by chance.
    Connected,
    /// Light is only met by chance. Point lights never are.
    Scattered,
}

/// Renders passes.
pub struct PathTracer<'w> {
    world: &'w World,
    view: &'w View,
    settings: Settings,
    lamps: Option<Lamps<'w>>,
    emitters: Option<Emitters>,
    rays: AtomicU64,
}

/// Fewest and most pixels whose paths go together: enough that the lanes stay full while most paths
/// have ended, and few enough that what is kept of them stays small.
const BLOCKS: [usize; 2] = [4096, 16384];

/// Blocks for each thread, if they are not too small: the last to finish keeps the others waiting for
/// an eighth of the time at most.
const BLOCKS_OF_A_THREAD: usize = 8;

/// Bounces that are never cut short: most light that matters arrives within them, and a path that is
/// cut earlier adds more noise than it saves time.
const SURE_BOUNCES: u32 = 3;

/// Most chance to go on: in a closed white room paths would never end.
const MOST_SURVIVAL: f64 = 0.95;

/// Distance at which rays start beside a surface, as a share of the arc length at which it was met
/// and of a hundredth of the whole length. Rounding is a thousand times smaller; a distance a
/// thousand times larger would let light through corners.
const OFFSET: f64 = 1e-6;

/// Share of the arc length by which shadow rays stop short of an emitter.
const SHORT: f64 = 5e-4;

/// A path that is under way.
struct Walk {
    pixel: usize,
    random: Stream,
    ray: Probe,
    throughput: DVec3,
    bounce: u32,
    /// The last scattering; `None` if light had no other direction to go.
    scattered: Option<Departure>,
}

/// A path at a surface.
struct Meeting {
    walk: Walk,
    hit: Hit,
    surface: Surface,
}

/// Where and how a path left a rough surface.
#[derive(Debug, Clone, Copy)]
struct Departure {
    u: DVec3,
    /// Direction in the standard frame, and its probability by solid angle.
    direction: DVec3,
    probability: f64,
}

/// A connection that brings light if nothing is in the way.
struct Candidate {
    pixel: usize,
    probe: Probe,
    light: DVec3,
}

impl<'w> PathTracer<'w> {
    /// For pictures of `world` as `view` sees it.
    pub fn new(world: &'w World, view: &'w View, settings: Settings) -> Self {
        let connected = settings.estimator == Estimator::Connected;
        let lamps = || Lamps::new(world, settings.length, settings.tolerance);
        Self {
            world,
            view,
            settings,
            lamps: connected.then(lamps).filter(|lamps| !lamps.is_empty()),
            emitters: connected
                .then(|| Emitters::new(world))
                .filter(|e| !e.is_empty()),
            rays: AtomicU64::new(0),
        }
    }

    /// How many geodesics have been followed so far.
    pub fn rays(&self) -> u64 {
        self.rays.load(Ordering::Relaxed)
    }

    /// Radiance of one sample of every pixel, row by row. `stop` is asked before each block; `None`
    /// if it said so.
    pub fn pass(&self, number: u64, stop: impl Fn() -> bool + Sync) -> Option<Vec<DVec3>> {
        let (width, height) = self.view.size;
        let pixels: Vec<usize> = (0..width * height).collect();
        // A pixel's light does not depend on those that go with it.
        let threads = rayon::current_num_threads() * BLOCKS_OF_A_THREAD;
        let block = (pixels.len() / threads).clamp(BLOCKS[0], BLOCKS[1]);
        let blocks: Option<Vec<Vec<DVec3>>> = pixels
            .par_chunks(block)
            .map(|pixels| (!stop()).then(|| self.block(pixels, number)))
            .collect();
        Some(blocks?.concat())
    }

    fn block(&self, pixels: &[usize], pass: u64) -> Vec<DVec3> {
        let mut light = vec![DVec3::ZERO; pixels.len()];
        let mut walks: Vec<Walk> = pixels.iter().map(|p| self.start(*p, pass)).collect();
        let first = pixels.first().copied().unwrap_or(0);
        while !walks.is_empty() {
            walks = self.bounce(walks, &mut |pixel, part| light[pixel - first] += part);
        }
        light
    }

    fn start(&self, pixel: usize, pass: u64) -> Walk {
        let mut random = Stream::new(&[self.settings.seed, pixel as u64, pass]);
        let width = self.view.size.0;
        let (x, y) = (random.uniform(), random.uniform());
        let d = self
            .view
            .direction((pixel % width) as f64 + x, (pixel / width) as f64 + y);
        Walk {
            pixel,
            random,
            ray: Probe {
                u: self.view.u,
                v: self.world.manifold.standard_frame(self.view.u) * d,
                length: self.settings.length,
            },
            throughput: DVec3::ONE,
            bounce: 0,
            scattered: None,
        }
    }

    fn seen(&self, probes: &[Probe]) -> Vec<Seen> {
        self.rays.fetch_add(probes.len() as u64, Ordering::Relaxed);
        first_seen(self.world, probes, self.settings.tolerance)
    }

    /// Takes all paths to the next surface; returns those that go on. `add` takes a pixel and light.
    fn bounce(&self, walks: Vec<Walk>, add: &mut dyn FnMut(usize, DVec3)) -> Vec<Walk> {
        let probes: Vec<Probe> = walks.iter().map(|w| w.ray).collect();
        let mut met: Vec<(Walk, Hit)> = Vec::new();
        for (walk, seen) in walks.into_iter().zip(self.seen(&probes)) {
            match seen {
                Seen::Surface(hit) => met.push((walk, hit)),
                Seen::Sky {
                    exit, direction, ..
                } => add(
                    walk.pixel,
                    walk.throughput * self.sky(exit as usize, direction),
                ),
                Seen::Nothing => {
                    let nowhere = self.world.skies.len() - 1;
                    add(walk.pixel, walk.throughput * self.sky(nowhere, Vec3::Z));
                }
            }
        }
        let met = self.meetings(met);
        self.add_emitted(&met, add);
        // The others may still go through unturned.
        let (mut met, last): (Vec<Meeting>, Vec<Meeting>) =
            met.into_iter().partition(|m| self.goes_on(&m.walk));
        self.add_lamps(&met, add);
        self.add_emitters(&mut met, add);
        let all = met.into_iter().chain(last);
        all.filter_map(|m| self.scattered(m)).collect()
    }

    /// Whether light that has come so far may be reflected once more.
    fn goes_on(&self, walk: &Walk) -> bool {
        walk.bounce < self.settings.bounces
    }

    fn meetings(&self, met: Vec<(Walk, Hit)>) -> Vec<Meeting> {
        let hits: Vec<Hit> = met.iter().map(|(_, hit)| *hit).collect();
        let surfaces = Surface::all(self.world, &hits);
        let meeting = |((walk, hit), surface)| Meeting { walk, hit, surface };
        met.into_iter().zip(surfaces).map(meeting).collect()
    }

    fn sky(&self, exit: usize, direction: Vec3) -> DVec3 {
        let footprint = Footprint::round(direction, self.view.pixel_angle() as f32);
        let radiance = self.world.skies[exit]
            .as_ref()
            .map(|sky| sky.filtered(direction, &footprint));
        radiance.map_or(DVec3::ZERO, |r| DVec3::from_array(r.map(f64::from)))
    }

    /// Light of surfaces that paths have met by chance, weighed against having been connected to.
    fn add_emitted(&self, met: &[Meeting], add: &mut dyn FnMut(usize, DVec3)) {
        let mut weighed: Vec<(&Meeting, Departure)> = Vec::new();
        for meeting in met.iter().filter(|m| m.surface.emitted != DVec3::ZERO) {
            let walk = &meeting.walk;
            match (walk.scattered, &self.emitters) {
                (Some(departure), Some(_)) => weighed.push((meeting, departure)),
                _ => add(walk.pixel, walk.throughput * meeting.surface.emitted),
            }
        }
        let pairs: Vec<(DVec3, DVec3)> = weighed
            .iter()
            .map(|(m, d)| (d.u, m.surface.point.u))
            .collect();
        for ((meeting, departure), connection) in weighed.into_iter().zip(self.principal(&pairs)) {
            let Meeting { walk, hit, surface } = meeting;
            let chosen = match (connection, &self.emitters) {
                (Some(c), Some(emitters)) if is_same(&c, departure.direction, hit.s.into()) => {
                    emitters.probability(self.world, hit, &c)
                }
                _ => 0.0,
            };
            let weight = balance(departure.probability, chosen);
            add(walk.pixel, walk.throughput * surface.emitted * weight);
        }
    }

    fn principal(&self, pairs: &[(DVec3, DVec3)]) -> Vec<Option<Connection>> {
        let (connections, followed) = principal(self.world, pairs, self.settings.tolerance);
        self.rays.fetch_add(followed as u64, Ordering::Relaxed);
        connections
    }

    /// Light of point lights, by every geodesic.
    fn add_lamps(&self, met: &[Meeting], add: &mut dyn FnMut(usize, DVec3)) {
        let Some(lamps) = &self.lamps else { return };
        let rough: Vec<&Meeting> = met.iter().filter(|m| m.surface.bsdf.is_rough()).collect();
        let points: Vec<SurfacePoint> = rough.iter().map(|m| m.surface.point).collect();
        let (arrivals, followed) = lamps.arrivals(&points);
        self.rays.fetch_add(followed as u64, Ordering::Relaxed);
        for (k, arrival) in arrivals {
            let Meeting { walk, surface, .. } = rough[k];
            let wi = surface.direction(-arrival.v);
            if surface.is_possible(wi) {
                let reflected = surface.bsdf.reflectance(surface.wo, wi);
                let irradiance = DVec3::from_array(arrival.irradiance);
                add(walk.pixel, walk.throughput * reflected * irradiance);
            }
        }
    }

    /// Light of emitting surfaces, each path connected to one point of them.
    fn add_emitters(&self, met: &mut [Meeting], add: &mut dyn FnMut(usize, DVec3)) {
        let Some(emitters) = &self.emitters else {
            return;
        };
        let mut chosen: Vec<(&Meeting, Chosen)> = Vec::new();
        for meeting in met.iter_mut().filter(|m| m.surface.bsdf.is_rough()) {
            let point = emitters.choose(self.world, &mut meeting.walk.random);
            chosen.push((meeting, point));
        }
        let pairs: Vec<(DVec3, DVec3)> = chosen
            .iter()
            .map(|(m, c)| (m.surface.point.u, c.u))
            .collect();
        let mut candidates: Vec<Candidate> = Vec::new();
        for ((meeting, chosen), connection) in chosen.iter().zip(self.principal(&pairs)) {
            let candidate = |c: Connection| self.candidate(meeting, chosen, &c);
            candidates.extend(connection.and_then(candidate));
        }
        let probes: Vec<Probe> = candidates.iter().map(|c| c.probe).collect();
        for (candidate, seen) in candidates.iter().zip(self.seen(&probes)) {
            if seen == Seen::Nothing {
                add(candidate.pixel, candidate.light);
            }
        }
    }

    fn candidate(
        &self,
        Meeting { walk, hit, surface }: &Meeting,
        chosen: &Chosen,
        connection: &Connection,
    ) -> Option<Candidate> {
        let wi = surface.around.inside(connection.direction);
        let same = chosen.triangle == hit.triangle;
        if same || connection.s > self.settings.length || !surface.is_possible(wi) {
            return None;
        }
        let probability = chosen.by_solid_angle(self.world, connection);
        let reflected = surface.bsdf.reflectance(surface.wo, wi) * wi.z.max(0.0);
        let weight = balance(probability, surface.bsdf.probability(surface.wo, wi));
        let light = walk.throughput * reflected * chosen.radiance * (weight / probability);
        (light.is_finite() && light != DVec3::ZERO).then(|| Candidate {
            pixel: walk.pixel,
            probe: Probe {
                u: surface.beside(wi, self.offset(hit)),
                v: surface.tangent(wi),
                length: connection.s * (1.0 - SHORT),
            },
            light,
        })
    }

    fn offset(&self, hit: &Hit) -> f64 {
        OFFSET * (f64::from(hit.s) + 1e-2 * self.settings.length)
    }

    /// The path after the surface; `None` if it ends there.
    fn scattered(&self, meeting: Meeting) -> Option<Walk> {
        let Meeting {
            mut walk,
            hit,
            surface,
        } = meeting;
        let scattered = surface
            .bsdf
            .scatter(surface.wo, surface.outside, &mut walk.random)?;
        if !surface.is_possible(scattered.wi) {
            return None;
        }
        walk.throughput *= scattered.weight;
        let mut length = self.settings.length;
        if scattered.unturned {
            length = walk.ray.length - f64::from(hit.s);
        } else if self.goes_on(&walk) {
            walk.bounce += 1;
        } else {
            return None;
        }
        if walk.bounce > SURE_BOUNCES {
            let survival = walk.throughput.max_element().min(MOST_SURVIVAL);
            if walk.random.uniform() >= survival {
                return None;
            }
            walk.throughput /= survival;
        }
        walk.scattered = scattered.probability.map(|probability| Departure {
            u: surface.point.u,
            direction: surface.around.out_of(scattered.wi),
            probability,
        });
        walk.ray = Probe {
            u: surface.beside(scattered.wi, self.offset(&hit)),
            v: surface.tangent(scattered.wi),
            length,
        };
        (walk.throughput.is_finite() && walk.throughput != DVec3::ZERO).then_some(walk)
    }
}
