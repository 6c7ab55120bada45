//! Path tracing in a curved space: a random, unbiased solution of the rendering equation.
//!
//! In: a world, a view, a seed and a number of samples. Out: one sample of every pixel for every pass,
//! and radiance of every pixel with its variance over passes ([`PassAccumulator`]).
//!
//! A path starts at the camera and is reflected at random (`surface`); between surfaces it follows
//! exact geodesics. The paths of a block of pixels go from surface to surface together: all rays of a
//! bounce are traced in one batch over the integrator's lanes, then all geodesics that connect to
//! lamps, then all shadow rays. Light is gathered where a path meets a surface that gives it off or a sky, and
//! directly: from point lights through every geodesic that connects them to the surface ([`crate`]),
//! from surfaces that shine or glow through the one that Newton's method finds from a chart-straight guess
//! (`emitters`). Radiance does not change along a geodesic; only the area that a solid angle covers
//! does. Where the scene asks for it, radiance goes with the fourth power of the frequency, from each surface to the
//! next and to the camera.
//!
//! Every sample depends on nothing but the seed, its pixel of the whole picture and its number, and pixels are summed
//! pass by pass: the same picture comes from any number of threads, from any interruptions, and in parts.

mod emitters;
mod passes;
mod surface;

pub use passes::{PanelTracers, PassAccumulator};

use crate::{Connection, Lamps};
use emitters::{EmitterPoint, Emitters, is_same_geodesic, principal_connections};
use geofan_core::{
    geodesic::{Ray, Settings as PathSettings, Step, ends},
    parallel::*,
    random::Stream,
};
use geofan_render::{
    Footprint, Hit, Seen, SurfacePoint, View, World, first_seen,
    redshift::{SurfaceState, brighter},
    starts::{RayStart, starts},
};
use glam::{DVec2, DVec3, Vec3};
use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};
use surface::{SurfaceInteraction, balance};

/// Decides a picture, together with world and view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathTracerSettings {
    /// Another seed gives another picture of the same light.
    pub seed: u64,
    /// Arc length over which light is followed between surfaces.
    pub length: f64,
    /// Local tolerance of geodesics.
    pub tolerance: f64,
    /// Light that has been reflected more often than this is left out: `u32::MAX` for all light, 1
    /// for direct light alone.
    pub bounces: u32,
    /// The way of gathering light.
    pub estimator: Estimator,
}

/// Says how light is gathered; both give the same picture in the end.
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
    settings: PathTracerSettings,
    lamps: Option<Arc<Lamps<'w>>>,
    emitters: Option<Arc<Emitters>>,
    rays: Arc<AtomicU64>,
    /// Rays from surfaces, and those of them that ended by their length: light from farther away is left out.
    scattered: Arc<[AtomicU64; 2]>,
    /// The place of `view` among the parts of the picture, which have other noise.
    part: usize,
}

/// Fewest and most pixels whose paths go together: enough that the lanes stay full while most paths
/// have ended, and few enough that their states stay small.
const BLOCKS: [usize; 2] = [4096, 16384];

/// Blocks for each thread, if they are not too small: the last to finish keeps the others waiting for
/// an eighth of the time at most.
const BLOCKS_OF_A_THREAD: usize = 8;

/// Bounces that are never cut short: most light that matters arrives within them, and a path that is
/// cut earlier adds more noise than it saves time.
const SURE_BOUNCES: u32 = 3;

/// Most chance to go on: in a closed white room paths would never end.
const MOST_SURVIVAL: f64 = 0.95;

/// Up to so many bounces a path that only mirrors and glass have turned is ended by chance for what it has lost alone. With
/// [`MOST_SURVIVAL`] from the start, one in 145 would be left here, 145 times as bright: a speck. More would take longer
/// where light is caught between mirrors for ever.
const MIRRORED_BOUNCES: u32 = 100;

/// Distance at which rays start beside a surface, as a share of the arc length at which it was met
/// and of a hundredth of the whole length. Rounding is a thousand times smaller; a distance a
/// thousand times larger would let light through corners.
const OFFSET: f64 = 1e-6;

/// Share of the arc length by which shadow rays stop short of an emitter.
const SHORT: f64 = 5e-4;

/// A path that is under way.
struct PathState {
    pixel: usize,
    random: Stream,
    ray: Ray,
    throughput: DVec3,
    /// How many times the frequency of light at the end of the ray's path is what the camera measures, in three parts: of
    /// the pieces before this ray; what its start measures of light of energy 1 along it; and up to the surface that it
    /// has met. All are 1 where frequencies do not matter.
    shift: f64,
    received: f64,
    shift_at_surface: f64,
    bounce: u32,
    /// Arc length from the camera to the ray's start, where it matters when light was sent; else 0.
    before: f64,
    /// The surface point (chart) that the path comes from; the camera's at first.
    from: DVec3,
    /// Direction in the standard frame there, and its probability by solid angle; `None` if light had
    /// no other direction to go.
    scattered: Option<(DVec3, f64)>,
    /// Set once a rough surface has scattered it: what it sees then is the light of a point, not a pixel of a picture.
    diffused: bool,
}

impl PathState {
    /// Returns the arc length of the ray to the surface that it has met.
    fn way_to(&self, hit: &Hit) -> f64 {
        f64::from(hit.s) - self.before
    }
}

/// A path with the surface that it has met.
type MetSurface = (PathState, SurfaceInteraction);

impl<'w> PathTracer<'w> {
    /// Prepares pictures of `world` as `view` sees it.
    pub fn new(world: &'w World, view: &'w View, settings: PathTracerSettings) -> Self {
        let connected = settings.estimator == Estimator::Connected;
        let lamps = || Lamps::new(world, settings.length, settings.tolerance);
        Self {
            world,
            view,
            settings,
            lamps: connected
                .then(lamps)
                .filter(|lamps| !lamps.is_empty())
                .map(Arc::new),
            emitters: connected
                .then(|| Emitters::new(world))
                .filter(|e| !e.is_empty())
                .map(Arc::new),
            rays: Arc::default(),
            scattered: Arc::default(),
            part: 0,
        }
    }

    /// Makes the tracer of the part numbered `part` of the whole picture; rays are counted together.
    #[must_use]
    pub fn through(&self, view: &'w View, part: usize) -> Self {
        Self {
            world: self.world,
            view,
            settings: self.settings,
            lamps: self.lamps.clone(),
            emitters: self.emitters.clone(),
            rays: self.rays.clone(),
            scattered: self.scattered.clone(),
            part,
        }
    }

    /// Returns the number of geodesics followed so far.
    pub fn rays(&self) -> u64 {
        self.rays.load(Ordering::Relaxed)
    }

    /// Returns the share of rays from surfaces, so far, that ended by their length, where light from farther away is left
    /// out.
    pub fn cut_short(&self) -> f64 {
        let [all, ended] = [0, 1].map(|k| self.scattered[k].load(Ordering::Relaxed) as f64);
        ended / all.max(1.0)
    }

    /// Renders one sample of every pixel, row by row, as radiance. `stop` is asked before each block;
    /// `None` if it said so.
    pub fn pass(&self, number: u64, stop: impl Fn() -> bool + Sync) -> Option<Vec<DVec3>> {
        let (width, height) = self.view.size;
        let pixels: Vec<usize> = (0..width * height).collect();
        self.part(&pixels, number, stop)
    }

    /// Renders one sample of each of these `pixels`, in ascending order of their numbers row by row: the same light as
    /// [`Self::pass`] gives them.
    pub fn part(
        &self,
        pixels: &[usize],
        number: u64,
        stop: impl Fn() -> bool + Sync,
    ) -> Option<Vec<DVec3>> {
        // A pixel's light does not depend on those that go with it.
        let blocks = threads() * BLOCKS_OF_A_THREAD;
        let block = (pixels.len() / blocks).clamp(BLOCKS[0], BLOCKS[1]);
        let blocks: Option<Vec<Vec<DVec3>>> = pixels
            .par_chunks(block)
            .map(|pixels| (!stop()).then(|| self.block(pixels, number)))
            .collect();
        Some(blocks?.concat())
    }

    /// Renders pixels in ascending order.
    fn block(&self, pixels: &[usize], pass: u64) -> Vec<DVec3> {
        let first = pixels.first().copied().unwrap_or(0);
        let end = pixels.last().map_or(0, |last| last + 1);
        let mut light = vec![DVec3::ZERO; end - first];
        let mut paths = self.start(pixels, pass);
        while !paths.is_empty() {
            paths = self.bounce(paths, &mut |pixel, part| light[pixel - first] += part);
        }
        pixels.iter().map(|pixel| light[pixel - first]).collect()
    }

    /// Starts paths at random places of those pixels that show something.
    fn start(&self, pixels: &[usize], pass: u64) -> Vec<PathState> {
        let width = self.view.size.0;
        let place = |pixel: &usize| {
            let (column, row) = (pixel % width, pixel / width);
            let number = self.view.number_in_whole(column, row, self.part);
            let mut random = Stream::new(&[self.settings.seed, number, pass]);
            let (x, y) = (random.uniform(), random.uniform());
            let at = DVec2::new(column as f64 + x, row as f64 + y);
            (*pixel, random, at)
        };
        let shown = pixels.iter().map(place);
        let shown: Vec<_> = shown
            .filter(|(_, _, at)| self.view.shows(at.x, at.y))
            .collect();
        let points = shown.iter().map(|(_, _, at)| *at);
        let starts = starts(&self.world.manifold, self.view, points);
        let path = |((pixel, random, _), start): ((usize, Stream, DVec2), Option<RayStart>)| {
            let start = start?;
            Some(PathState {
                pixel,
                random,
                ray: Ray::without_spread(start.u, start.v, self.settings.length),
                throughput: DVec3::ONE,
                shift: 1.0,
                received: self.received(&start),
                shift_at_surface: 1.0,
                bounce: 0,
                before: 0.0,
                from: start.u,
                scattered: None,
                diffused: false,
            })
        };
        shown.into_iter().zip(starts).filter_map(path).collect()
    }

    /// Returns the frequency that the camera measures of light of energy 1 along a ray from `start`, if frequencies matter.
    fn received(&self, start: &RayStart) -> f64 {
        if !self.world.redshift {
            return 1.0;
        }
        let manifold = &self.world.manifold;
        let n = manifold.standard_frame(start.u) * start.direction;
        manifold.normal_frequency(start.u, n) * self.view.blueshift(start.direction)
    }

    /// Follows rays to the first thing that each sees.
    fn seen(&self, probes: &[(Ray, f64)]) -> Vec<Seen> {
        self.rays.fetch_add(probes.len() as u64, Ordering::Relaxed);
        first_seen(self.world, probes, self.settings.tolerance)
    }

    /// Takes all paths to the next surface; returns those that go on. `add` takes a pixel and light.
    fn bounce(&self, paths: Vec<PathState>, add: &mut dyn FnMut(usize, DVec3)) -> Vec<PathState> {
        let probes = paths.iter().map(|path| (path.ray, path.before));
        let probes: Vec<(Ray, f64)> = probes.collect();
        let mut met: Vec<(PathState, Hit)> = Vec::new();
        let mut scattered = [0; 2];
        // Paths that leave the space bring the light of its sky.
        for (path, seen) in paths.into_iter().zip(self.seen(&probes)) {
            if path.bounce > 0 {
                scattered[0] += 1;
                scattered[1] += u64::from(matches!(seen, Seen::Length));
            }
            match seen {
                Seen::Surface(hit) => met.push((path, hit)),
                Seen::Sky {
                    exit, direction, ..
                } => {
                    let light = self.sky(exit as usize, direction, path.diffused);
                    let brighter = brighter(path.shift * path.received);
                    add(path.pixel, path.throughput * light * brighter);
                }
                Seen::Nothing | Seen::Length | Seen::Singular => {
                    let nowhere = self.world.skies.len() - 1;
                    let light = self.sky(nowhere, Vec3::Z, true) * brighter(path.shift);
                    add(path.pixel, path.throughput * light);
                }
            }
        }
        for (sum, more) in self.scattered.iter().zip(scattered) {
            sum.fetch_add(more, Ordering::Relaxed);
        }
        // The others gather light where they have met a surface, and are scattered there.
        let met = self.interactions(met);
        self.add_emitted(&met, add);
        // Those that may not be reflected any more may still go through unturned.
        let (mut met, last): (Vec<MetSurface>, Vec<MetSurface>) =
            met.into_iter().partition(|(path, _)| self.goes_on(path));
        self.add_lamps(&met, add);
        self.add_emitters(&mut met, add);
        let all = met.into_iter().chain(last);
        all.filter_map(|m| self.scattered(m)).collect()
    }

    /// Tells whether light that has come so far may be reflected once more.
    fn goes_on(&self, path: &PathState) -> bool {
        path.bounce < self.settings.bounces
    }

    /// Computes what each path needs to know of the surface that it has met.
    fn interactions(&self, met: Vec<(PathState, Hit)>) -> Vec<MetSurface> {
        let hits: Vec<Hit> = met.iter().map(|(_, hit)| *hit).collect();
        let surfaces = SurfaceInteraction::of_hits(self.world, &hits);
        let paths = met.into_iter().map(|(path, _)| path);
        let shifted = |(mut path, surface): MetSurface| {
            let sent = self.frequency(surface.state.as_ref(), surface.hit.v.as_dvec3());
            path.shift_at_surface = path.shift * path.received / sent;
            (path, surface)
        };
        paths.zip(surfaces).map(shifted).collect()
    }

    /// Returns the frequency that a surface in this `state` measures of light of energy 1 along the tangent `v`; 1 where
    /// frequencies do not matter.
    fn frequency(&self, state: Option<&SurfaceState>, v: DVec3) -> f64 {
        match state {
            Some(state) if self.world.redshift => state.frequency(v),
            _ => 1.0,
        }
    }

    /// Looks a sky up: averaged over a pixel, or at the direction itself for light that was `diffused` on its way.
    fn sky(&self, exit: usize, direction: Vec3, diffused: bool) -> DVec3 {
        let footprint = match diffused {
            true => Footprint::POINT,
            false => Footprint::round(direction, self.view.pixel_angle() as f32),
        };
        let radiance = self.world.skies[exit]
            .as_ref()
            .map(|sky| sky.filtered(direction, &footprint));
        radiance.map_or(DVec3::ZERO, |r| DVec3::from_array(r.map(f64::from)))
    }

    /// Adds light of surfaces that paths have met by chance, weighed against having been connected to.
    fn add_emitted(&self, met: &[MetSurface], add: &mut dyn FnMut(usize, DVec3)) {
        let mut weighed: Vec<(&MetSurface, DVec3, (DVec3, f64))> = Vec::new();
        for one in met {
            let (path, surface) = one;
            let light = path.throughput * surface.emitted(path.shift_at_surface);
            match (path.scattered, &self.emitters) {
                _ if light == DVec3::ZERO => {}
                (Some(scattered), Some(emitters)) if emitters.has(surface.hit.triangle) => {
                    weighed.push((one, light, scattered));
                }
                _ => add(path.pixel, light),
            }
        }
        let pairs = weighed.iter().map(|((p, s), ..)| (p.from, s.point.u));
        let pairs: Vec<(DVec3, DVec3)> = pairs.collect();
        let connections = self.principal(&pairs);
        for ((one, light, (direction, probability)), c) in weighed.into_iter().zip(connections) {
            let (path, surface) = one;
            // Only a principal connection could have been chosen.
            let hit = &surface.hit;
            let chosen = match (c, &self.emitters) {
                (Some(c), Some(emitters)) if is_same_geodesic(&c, direction, path.way_to(hit)) => {
                    emitters.probability(self.world, hit, &c)
                }
                _ => 0.0,
            };
            let weight = balance(probability, chosen);
            add(path.pixel, light * weight);
        }
    }

    /// Finds principal connections of pairs of points.
    fn principal(&self, pairs: &[(DVec3, DVec3)]) -> Vec<Option<Connection>> {
        let tolerance = self.settings.tolerance;
        let (connections, followed) = principal_connections(self.world, pairs, tolerance);
        self.rays.fetch_add(followed as u64, Ordering::Relaxed);
        connections
    }

    /// Adds light of point lights, by every geodesic.
    fn add_lamps(&self, met: &[MetSurface], add: &mut dyn FnMut(usize, DVec3)) {
        let Some(lamps) = &self.lamps else { return };
        let rough = met.iter().filter(|(_, s)| s.bsdf.is_rough());
        let rough: Vec<&MetSurface> = rough.collect();
        let points: Vec<SurfacePoint> = rough.iter().map(|(_, s)| s.point).collect();
        let (incident, followed) = lamps.incident_light(&points);
        self.rays.fetch_add(followed as u64, Ordering::Relaxed);
        for (k, light) in incident {
            let (path, surface) = rough[k];
            let wi = surface.direction(-light.v);
            if surface.is_possible(wi) {
                let reflected = surface.bsdf.reflectance(surface.wo, wi);
                let irradiance =
                    DVec3::from_array(light.irradiance) * brighter(path.shift_at_surface);
                add(path.pixel, path.throughput * reflected * irradiance);
            }
        }
    }

    /// Adds light of emitting surfaces, each path connected to one point of them.
    fn add_emitters(&self, met: &mut [MetSurface], add: &mut dyn FnMut(usize, DVec3)) {
        let Some(emitters) = &self.emitters else {
            return;
        };
        // A random point for each path, and the geodesic to it.
        let mut chosen: Vec<(&MetSurface, EmitterPoint)> = Vec::new();
        for one in met.iter_mut().filter(|(_, s)| s.bsdf.is_rough()) {
            let point = emitters.choose(self.world, &mut one.0.random);
            chosen.push((one, point));
        }
        let pairs = chosen.iter().map(|((_, s), c)| (s.point.u, c.u));
        let pairs: Vec<(DVec3, DVec3)> = pairs.collect();
        // Pixels with their light, if nothing casts a shadow on the way of the probe and that comes to the end of the connection.
        let (mut lights, mut probes, mut aims) = (Vec::new(), Vec::new(), Vec::new());
        let ends: Vec<(DVec3, u32)> = chosen.iter().map(|(_, c)| (c.u, c.triangle)).collect();
        let states = self.world.surface_states(&ends);
        let connected = chosen.iter().zip(self.principal(&pairs)).enumerate();
        for (i, ((met, chosen), connection)) in connected {
            let state = states.as_ref().map(|states| &states[i]);
            let lit = connection.and_then(|c| Some((self.lit(met, (chosen, state), &c)?, c.u)));
            if let Some(((light, probe), aim)) = lit {
                lights.push((met.0.pixel, light));
                probes.push(probe);
                aims.push(aim);
            }
        }
        let arrive = self.arrive(&probes, &aims).into_iter();
        for (((pixel, light), seen), arrives) in
            lights.into_iter().zip(self.seen(&probes)).zip(arrive)
        {
            if arrives && matches!(seen, Seen::Nothing | Seen::Length | Seen::Singular) {
                add(pixel, light);
            }
        }
    }

    /// Tells which probes come to what they aim at: connections know nothing of mirrors and portals, by which a probe comes
    /// elsewhere.
    fn arrive(&self, probes: &[(Ray, f64)], aims: &[DVec3]) -> Vec<bool> {
        let manifold = &self.world.manifold;
        if manifold.follows_cover() {
            return vec![true; probes.len()];
        }
        let rays = probes.iter().map(|(ray, _)| *ray);
        let ends = ends(manifold, PathSettings::bare(self.settings.tolerance), rays);
        let comes_there = |(i, end): (usize, &Option<(Step, f64)>)| {
            let ((ray, _), aim) = (&probes[i], aims[i]);
            let Some((step, s)) = end else { return false };
            let rest = step.tangent(*s) * (ray.length * SHORT);
            let there = manifold.located(step.position(*s) + rest);
            (there - manifold.located(aim)).length() <= rest.length()
        };
        ends.iter().enumerate().map(comes_there).collect()
    }

    /// Computes the light that a connection to an emitter brings, and the ray that is to find out
    /// whether it is in shadow; `None` if it brings nothing.
    fn lit(
        &self,
        (path, surface): &MetSurface,
        (chosen, state): (&EmitterPoint, Option<&SurfaceState>),
        connection: &Connection,
    ) -> Option<(DVec3, (Ray, f64))> {
        let hit = &surface.hit;
        let wi = surface.around_normal(connection.direction);
        let same = chosen.triangle == hit.triangle;
        if same || connection.s > self.settings.length || !surface.is_possible(wi) {
            return None;
        }
        let probability =
            chosen.by_solid_angle(self.world, connection) * surface.spread_to_sight(wi);
        let reflected = surface.bsdf.reflectance(surface.wo, wi) * wi.z.max(0.0);
        let weight = balance(probability, surface.bsdf.probability(surface.wo, wi));
        let tangent = surface.tangent(wi);
        let received = self.frequency(surface.state.as_ref(), tangent);
        let g = path.shift_at_surface * received / self.frequency(state, connection.v);
        let radiance = chosen.radiance(state, g);
        let light = path.throughput * reflected * radiance * (weight / probability);
        let probe = || {
            let start = surface.beside(wi, self.offset(path.way_to(hit)));
            let ray = Ray::without_spread(start, tangent, connection.s * (1.0 - SHORT));
            (ray, self.before(hit))
        };
        (light.is_finite() && light != DVec3::ZERO).then(|| (light, probe()))
    }

    /// Returns the distance from a surface at which rays start, at the end of a ray of arc length `s`.
    fn offset(&self, s: f64) -> f64 {
        OFFSET * (s + 1e-2 * self.settings.length)
    }

    /// Returns the arc length from the camera to a surface, where it matters when light was sent; else 0.
    fn before(&self, hit: &Hit) -> f64 {
        match self.world.accelerator.moves() {
            true => hit.s.into(),
            false => 0.0,
        }
    }

    /// Sends the path on from the surface; `None` if it ends there.
    fn scattered(&self, (mut path, surface): MetSurface) -> Option<PathState> {
        let scattered = surface
            .bsdf
            .scatter(surface.wo, surface.outside, &mut path.random)?;
        if !surface.is_possible(scattered.wi) {
            return None;
        }
        path.throughput *= scattered.weight;
        let way = path.way_to(&surface.hit);
        let mut length = self.settings.length;
        if scattered.unturned {
            length = path.ray.length - way;
        } else if self.goes_on(&path) {
            path.bounce += 1;
        } else {
            return None;
        }
        // Russian roulette.
        if path.bounce > SURE_BOUNCES {
            let most = match path.diffused || path.bounce > MIRRORED_BOUNCES {
                true => MOST_SURVIVAL,
                false => 1.0,
            };
            let survival = path.throughput.max_element().min(most);
            if path.random.uniform() >= survival {
                return None;
            }
            path.throughput /= survival;
        }
        let tangent = surface.tangent(scattered.wi);
        if !scattered.unturned {
            path.shift = path.shift_at_surface;
            path.received = self.frequency(surface.state.as_ref(), tangent);
        }
        path.diffused |= scattered.probability.is_some();
        let direction = || surface.sight_of(scattered.wi);
        path.from = surface.point.u;
        let spread = || surface.spread_to_sight(scattered.wi);
        path.scattered = scattered.probability.map(|p| (direction(), p / spread()));
        let start = surface.beside(scattered.wi, self.offset(way));
        path.ray = Ray::without_spread(start, tangent, length);
        path.before = self.before(&surface.hit);
        (path.throughput.is_finite() && path.throughput != DVec3::ZERO).then_some(path)
    }
}
