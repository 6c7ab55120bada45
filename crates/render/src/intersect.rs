//! Paths against triangles: what a ray sees, first and through surfaces that are not solid.
//!
//! In: a cubic piece of a path. Out: its first [`Hit`]. A piece whose box meets no leaf of the tree is
//! skipped; another is flattened into as many chords as keep it within [`CHORD_ERROR`] of the cubic, and
//! each chord is a straight segment. Glued coordinates: the piece is tried in every period in which the
//! scene's box is. From that: what a whole path sees ([`Seen`]), the meeting point of all tracers and the
//! input of shading, and what rays from anywhere see ([`first_seen`]).
//!
//! In: what samples see first, and its colours as if it were solid. Out: for each sample the colours
//! of all that it sees, from front to back, each weighed by its opacity and by what those before it
//! let through (`SeenBehind`; T. Porter, T. Duff, *Compositing digital images*, 1984). Behind a surface a table knows
//! no paths, so there they are integrated; straight lines stay straight.

use super::{
    accel::{Accelerator, TimedChord},
    copies::{CopySearch, SceneCopies},
    curve::{Cubic, Curve, Ending, ending_at},
    frame::{Outcomes, Paths, trace_each},
    local::straight_behind,
    redshift::shift_colours,
    shade::{Colours, Footprints, shade},
    tiles::{PixelSamples, SamplePlace},
    tracer::{ExactTracer, pieces},
    world::World,
};
use geofan_core::{
    geodesic::{End, Ray, Settings, Sink, Step, follow, meets_pole},
    manifold::{Domain, Manifold},
    parallel::*,
};
use glam::{DVec3, Vec3};
use ndarray::{Array3, ArrayView3, s};
use std::ops::ControlFlow;

/// A point of a path on a triangle; its chart point is [`super::World::point`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Arc length.
    pub s: f32,
    /// Tangent, chart components, of about unit length ([`Hit::tangent`]).
    pub v: Vec3,
    /// Index of the triangle.
    pub triangle: u32,
    /// Weights of its second and third corners.
    pub barycentric: [f32; 2],
}

impl Hit {
    /// Returns the tangent at the chart point `u` of the hit as integration asks for it, of unit length against the wind:
    /// what is kept is in single precision, and of an interpolated path as close as the picture asks for.
    pub fn tangent(&self, manifold: &Manifold, u: DVec3) -> DVec3 {
        let local = manifold.local_frame(u);
        local.restored(manifold.metric(u), self.v.as_dvec3())
    }
}

/// The end of a line of sight. Kept small (32 bytes), because a frame writes and reads one for every sample:
/// with 48 bytes frames of 1280 × 720 take 15 % longer on two threads.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Seen {
    /// A triangle.
    Surface(Hit),
    /// A sky, by exit, in a direction.
    Sky {
        /// Index in [`geofan_core::manifold::Manifold::exits`].
        exit: u32,
        /// Arc length at the exit.
        s: f32,
        /// Unit vector.
        direction: Vec3,
    },
    /// Nothing, as there is no path.
    #[default]
    Nothing,
    /// Nothing as far as the path was followed: its length was used up before anything.
    Length,
    /// Nothing: the metric ended the path before anything.
    Singular,
}

/// Angle (radians) by which chords may depart from the path: a twentieth of a mrad, a small part of a
/// pixel.
pub const CHORD_ERROR: f64 = 5e-5;

/// Most chords of one piece: pieces are short already, so more means a broken path.
pub(super) const MOST_CHORDS: f64 = 64.0;

/// Finds the first hits of pieces of a path, quickest for pieces in order.
pub struct HitSearch<'w> {
    world: &'w World,
    copies: Option<CopySearch<'w>>,
    /// Arc length from the camera to where the pieces' own begins.
    before: f64,
}

impl<'w> HitSearch<'w> {
    /// Begins a search along paths from a camera.
    pub fn new(world: &'w World) -> Self {
        let copies = world.copies.as_ref().and_then(SceneCopies::search);
        Self {
            world,
            copies,
            before: 0.0,
        }
    }

    /// Goes on along paths that begin at this arc length from a camera.
    pub fn go_on_from(&mut self, before: f64) {
        self.before = before;
    }

    /// Finds the first hit of `piece` before arc length `limit` of its own; that of the hit is from the camera.
    pub fn first_hit(&mut self, piece: &Cubic, limit: f64) -> Option<Hit> {
        let hit = self.first_hit_on(piece, limit)?;
        let s = (self.before + f64::from(hit.s)) as f32;
        Some(Hit { s, ..hit })
    }

    fn first_hit_on(&mut self, piece: &Cubic, limit: f64) -> Option<Hit> {
        let (accelerator, domain) = (&self.world.accelerator, &self.world.manifold.domain);
        let before = self.before;
        let hit_shifted = |piece: &Cubic, shift: DVec3, bounds: (DVec3, DVec3)| {
            hit_shifted(accelerator, piece, (before, limit), shift, bounds)
        };
        if let Some(copies) = &mut self.copies {
            let mut first: Option<Hit> = None;
            copies.show_cubics(piece, |cubic| {
                if first.is_some_and(|first| f64::from(first.s) < cubic.s[0]) {
                    return ControlFlow::Break(());
                }
                let bounds = cubic.bounds();
                let hit = hit_shifted(&cubic, DVec3::ZERO, bounds);
                first = nearer(first, hit);
                ControlFlow::Continue(())
            });
            return first;
        }
        let (low, high) = piece.bounds();
        if !is_glued(domain) {
            return hit_shifted(piece, DVec3::ZERO, (low, high));
        }
        let shifts = shifts(accelerator, domain, low, high).into_iter();
        let hits = shifts.map(|shift| hit_shifted(piece, shift, (low, high)));
        hits.fold(None, nearer)
    }
}

/// Returns the nearer of two hits.
fn nearer(first: Option<Hit>, other: Option<Hit>) -> Option<Hit> {
    match (first, other) {
        (Some(first), Some(other)) if other.s < first.s => Some(other),
        (first, other) => first.or(other),
    }
}

/// Tells whether a path inside the box may meet anything: cheaper than to divide it into pieces.
pub fn may_meet(world: &World, (low, high): (DVec3, DVec3)) -> bool {
    match &world.copies {
        Some(copies) => copies.may_meet((low, high)),
        None => is_glued(&world.manifold.domain) || world.accelerator.touches(low, high),
    }
}

/// Returns the box outside which paths meet nothing; `None` if that is not known.
pub fn region(world: &World) -> Option<(DVec3, DVec3)> {
    world.accelerator.bounds().filter(|_| !repeats(world))
}

/// Tells whether things are in several places of the chart.
fn repeats(world: &World) -> bool {
    world.copies.is_some() || is_glued(&world.manifold.domain)
}

/// Tells whether any coordinate is glued.
pub fn is_glued(domain: &Domain) -> bool {
    domain.periodic.iter().any(|p| *p)
}

/// Returns the displacements by whole periods that bring the box into reach of the scene.
pub fn shifts(accelerator: &Accelerator, domain: &Domain, low: DVec3, high: DVec3) -> Vec<DVec3> {
    let Some((least, most)) = accelerator.bounds() else {
        return Vec::new();
    };
    let mut shifts = vec![DVec3::ZERO];
    for k in 0..3 {
        if let Some(period) = domain.period(k) {
            let from = ((least[k] - high[k]) / period).ceil() as i64;
            let to = ((most[k] - low[k]) / period).floor() as i64;
            shifts = shifts
                .iter()
                .flat_map(|s| {
                    (from..=to).map(move |n| {
                        let mut shift = *s;
                        shift[k] = n as f64 * period;
                        shift
                    })
                })
                .collect();
        }
    }
    shifts
}

/// Finds the first hit of `piece`, whose box is known and which begins at an arc length from the camera, moved by `shift`.
fn hit_shifted(
    accelerator: &Accelerator,
    piece: &Cubic,
    (before, limit): (f64, f64),
    shift: DVec3,
    (low, high): (DVec3, DVec3),
) -> Option<Hit> {
    if !accelerator.touches(low + shift, high + shift) {
        return None;
    }
    // As many chords as keep close to the cubic.
    let allowed = CHORD_ERROR * piece.s[1] * piece.v[1].length().min(piece.v[0].length());
    let chords = (piece.sagitta() / allowed)
        .sqrt()
        .ceil()
        .clamp(1.0, MOST_CHORDS);
    // The first that hits decides.
    let mut from = piece.u[0] + shift;
    let arc = |i: usize| before + piece.s[0] + (piece.s[1] - piece.s[0]) * (i as f64 / chords);
    for i in 0..chords as usize {
        let end = (i + 1) as f64 / chords;
        let to = piece.position(end) + shift;
        let chord = TimedChord {
            ends: [from, to],
            s: [arc(i), arc(i + 1)],
        };
        if let Some(hit) = accelerator.first_hit_on_chord(&chord) {
            let t = (i as f64 + hit.t) / chords;
            let s = piece.arc(t);
            return (s <= limit).then(|| Hit {
                s: s as f32,
                v: piece.tangent(t).as_vec3(),
                triangle: hit.triangle,
                barycentric: [hit.barycentric.0 as f32, hit.barycentric.1 as f32],
            });
        }
        from = to;
    }
    None
}

/// Returns what a whole path sees.
pub fn seen_along(world: &World, curve: &Curve) -> Seen {
    let limit = curve.ending.limit();
    let mut search = HitSearch::new(world);
    let mut pieces = curve.pieces();
    match pieces.find_map(|piece| search.first_hit(&piece, limit)) {
        Some(hit) => Seen::Surface(hit),
        None => beyond(&curve.ending),
    }
}

/// Returns what is seen where no surface is in the way.
pub fn beyond(ending: &Ending) -> Seen {
    match *ending {
        Ending::Exit { exit, s, sky } => Seen::Sky {
            exit: exit as u32,
            s: s as f32,
            direction: sky.as_vec3(),
        },
        Ending::Length => Seen::Length,
        Ending::Singular => Seen::Singular,
    }
}

/// Follows `rays` at a local tolerance, each exactly until it meets the scene, leaves, or is used up, and
/// returns what each sees. Rays run over the lanes of the integrator and are given up at their first hit,
/// so a short one costs little. Each begins at an arc length from the camera, 0 or, if its light has come farther,
/// more; what it sees is as far from the camera.
pub fn first_seen(world: &World, rays: &[(Ray, f64)], tolerance: f64) -> Vec<Seen> {
    let followed = follow_until_seen(world, &world.manifold, rays, tolerance).into_iter();
    followed.map(|(seen, _)| seen).collect()
}

/// Returns what `tracer` sees along the curves from chart points with unit tangents, each followed until it meets the
/// scene or ends. What a curve sees that meets a pole of the chart is told by its neighbour ([`ExactTracer::trace_from`]).
pub fn seen_from(world: &World, tracer: &ExactTracer<'_>, starts: &[(DVec3, DVec3)]) -> Vec<Seen> {
    let ray = |&(u, v): &(DVec3, DVec3)| (Ray::without_spread(u, v, tracer.length()), 0.0);
    let rays: Vec<_> = starts.iter().map(ray).collect();
    let followed = follow_until_seen(world, tracer.manifold(), &rays, tracer.tolerance());
    let (mut seen, at_pole): (Vec<_>, Vec<_>) = followed.into_iter().unzip();
    let lost: Vec<usize> = (0..seen.len()).filter(|i| at_pole[*i]).collect();
    let starts: Vec<_> = lost.iter().map(|i| starts[*i]).collect();
    for (i, curve) in lost.into_iter().zip(tracer.trace_from(&starts)) {
        seen[i] = seen_along(world, &curve);
    }
    seen
}

/// Follows `rays` through `manifold`, that of the world or its cover, as [`first_seen`] does, and tells which of
/// those that see nothing met a pole of the chart.
fn follow_until_seen(
    world: &World,
    manifold: &Manifold,
    rays: &[(Ray, f64)],
    tolerance: f64,
) -> Vec<(Seen, bool)> {
    let settings = Settings::bare(tolerance).with_events();
    let state = |(ray, before): &(Ray, f64)| RayProgress {
        before: *before,
        u: ray.u,
        v: ray.v,
        search: None,
        seen: None,
        at_pole: false,
    };
    let mut sink = FirstSeen {
        world,
        manifold,
        rays: rays.iter().map(state).collect(),
    };
    let all = rays.iter().map(|(ray, _)| *ray);
    follow(manifold, settings, all, &mut sink);
    let followed = sink.rays.into_iter();
    followed
        .map(|ray| (ray.seen.unwrap_or(Seen::Length), ray.at_pole))
        .collect()
}

/// Holds the steps of rays against the scene.
struct FirstSeen<'w> {
    world: &'w World,
    manifold: &'w Manifold,
    rays: Vec<RayProgress<'w>>,
}

/// A ray on its way.
struct RayProgress<'w> {
    /// Arc length from the camera to its start.
    before: f64,
    /// Point and tangent at the end of the last step.
    u: DVec3,
    v: DVec3,
    /// Begun where it may first meet something.
    search: Option<HitSearch<'w>>,
    /// What it sees, once that is known.
    seen: Option<Seen>,
    /// Set if it ended at a pole of the chart.
    at_pole: bool,
}

impl Sink for FirstSeen<'_> {
    fn region(&self) -> Option<(DVec3, DVec3)> {
        region(self.world)
    }

    fn step(&mut self, ray: usize, step: &Step) {
        let world = self.world;
        let ray = &mut self.rays[ray];
        if may_meet(world, step.bounds()) {
            let search = ray.search.get_or_insert_with(|| HitSearch::new(world));
            search.go_on_from(ray.before);
            let hit = |piece| search.first_hit(&piece, f64::INFINITY);
            if let Some(hit) = pieces(step).find_map(hit) {
                ray.seen = Some(Seen::Surface(hit));
                return;
            }
        }
        (ray.u, ray.v) = (step.position(step.end), step.tangent(step.end));
    }

    fn wants_more(&self, ray: usize) -> bool {
        self.rays[ray].seen.is_none()
    }

    fn end(&mut self, ray: usize, end: End, s: f64, _: usize) {
        let ray = &mut self.rays[ray];
        if ray.seen.is_none() {
            let ending = ending_at(self.manifold, end, s, ray.u, ray.v);
            ray.at_pole = meets_pole(self.manifold, end, ray.u);
            ray.seen = Some(beyond(&ending.farther(ray.before)));
        }
    }
}

/// Light below this share of a sample is not followed any farther: a quarter of the step of a file
/// with eight bits.
const FAINT: f32 = 1e-3;

/// Most surfaces behind each other: twice as many as are faint together of the least opacity that a texture with eight
/// bits has.
const MOST_SURFACES: usize = 4096;

/// Distance at which a path goes on beyond a surface, as a share of the arc length at which it was
/// met and of a hundredth of the whole: rounding is a thousand times smaller.
const OFFSET: f64 = 1e-6;

/// Rays given to one thread at once: enough to keep its lanes full.
const BLOCK: usize = 256;

/// Shows what lies behind surfaces.
pub(super) struct SeenBehind<'a> {
    /// The samples of one pass.
    pub samples: PixelSamples<'a>,
    /// The tracer of their paths.
    pub paths: Paths<'a>,
    /// Samples of a pixel in all passes.
    pub of_pixel: usize,
    /// Set if colours are averaged over footprints.
    pub footprints: Footprints,
}

/// A sample that sees through surfaces.
struct Through {
    place: SamplePlace,
    /// The last surface, and the arc length between it and what was before it.
    hit: Hit,
    way: f64,
    /// Number of surfaces passed.
    passed: usize,
    /// Share of light that they let through.
    share: f32,
}

impl Through {
    /// Returns the arc length from the camera.
    fn s(&self) -> f64 {
        self.hit.s.into()
    }
}

impl SeenBehind<'_> {
    /// Adds what lies behind the surfaces of `outcomes` to `colours`.
    pub(super) fn show(&self, outcomes: ArrayView3<'_, Seen>, colours: &mut Colours) {
        if !self.samples.world.clear {
            return;
        }
        let mut open = Vec::new();
        for (place, seen) in outcomes.indexed_iter() {
            let before = (place, 0.0, 0, 1.0);
            let share = self.pass(before, seen, &mut open);
            if share < 1.0 {
                add(colours, place, |_, own| own * share);
            }
        }
        while !open.is_empty() {
            let seen = self.seen(&open);
            let mut layer: Outcomes = Array3::from_elem(outcomes.dim(), Seen::Nothing);
            for (through, seen) in open.iter().zip(&seen) {
                layer[through.place] = *seen;
            }
            let PixelSamples { world, view, .. } = self.samples;
            let mut lit = shade(world, view, layer.view(), self.of_pixel, self.footprints);
            shift_colours(world, view, &layer, self.samples.offsets, &mut lit);
            let mut next = Vec::new();
            for (through, seen) in open.iter().zip(&seen) {
                let before = (through.place, through.s(), through.passed, through.share);
                let share = self.pass(before, seen, &mut next);
                let (y, x, k) = through.place;
                add(colours, through.place, |c, own| {
                    own + share * lit[(y, x, k, c)]
                });
            }
            open = next;
        }
    }

    /// Returns the share of a sample that comes from what it sees, after surfaces up to an arc length, so many,
    /// that let a share through. If something comes from behind it, that is put into `open`.
    fn pass(
        &self,
        (place, s, passed, share): (SamplePlace, f64, usize, f32),
        seen: &Seen,
        open: &mut Vec<Through>,
    ) -> f32 {
        let Seen::Surface(hit) = seen else {
            return share;
        };
        let opacity = self.samples.world.opacity(hit);
        let rest = share * (1.0 - opacity);
        if rest <= FAINT || passed == MOST_SURFACES {
            return share;
        }
        open.push(Through {
            place,
            hit: *hit,
            way: f64::from(hit.s) - s,
            passed: passed + 1,
            share: rest,
        });
        share * opacity
    }

    /// Finds what the samples see next.
    fn seen(&self, open: &[Through]) -> Vec<Seen> {
        let (length, tolerance) = self.paths.reach();
        if matches!(self.paths, Paths::Straight(_)) {
            let passed = |through: &Through| (through.place, through.passed);
            let passed: Vec<_> = open.iter().map(passed).collect();
            return straight_behind(&self.samples, length, &passed);
        }
        let world = self.samples.world;
        let ray = |(through, hit): (&Through, Hit)| {
            let on_surface = world.point(&hit);
            let v = hit.tangent(&world.manifold, on_surface);
            let off = OFFSET * (through.way + 1e-2 * length);
            let s = f64::from(hit.s);
            (Ray::without_spread(on_surface + v * off, v, length - s), s)
        };
        let block = |open: &[Through]| {
            let hits = open.iter().zip(self.hits(open));
            let rays: Vec<(Ray, f64)> = hits.map(ray).collect();
            first_seen(world, &rays, tolerance)
        };
        open.par_chunks(BLOCK).flat_map(block).collect()
    }

    /// Returns the hits from which rays go on. Where the metric may jump, first ones are found again by exact paths: between two
    /// knots an interpolated path is turned by an edge that lies there, and what is behind shows that.
    fn hits(&self, open: &[Through]) -> Vec<Hit> {
        let PixelSamples { world, view, .. } = self.samples;
        let is_interpolated = matches!(self.paths, Paths::Direct(_) | Paths::Lattice(..))
            && open.iter().all(|through| through.passed == 1);
        if !is_interpolated || world.manifold.switching_functions().is_none() {
            return open.iter().map(|through| through.hit).collect();
        }
        let tracer = self.paths.integrated(world, view.u);
        let places: Vec<SamplePlace> = open.iter().map(|through| through.place).collect();
        let mut exact = trace_each(&self.samples, &tracer, &places)
            .into_iter()
            .peekable();
        let hit = |through: &Through| match exact.next_if(|(place, _)| *place == through.place) {
            Some((_, Seen::Surface(hit))) => hit,
            _ => through.hit,
        };
        open.iter().map(hit).collect()
    }
}

/// Changes the colour of a sample.
fn add(colours: &mut Colours, (y, x, k): SamplePlace, change: impl Fn(usize, f32) -> f32) {
    let mut colour = colours.slice_mut(s![y, x, k, ..]);
    for (c, own) in colour.iter_mut().enumerate() {
        *own = change(c, *own);
    }
}
