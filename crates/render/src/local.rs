//! The local view: the picture to first order in the distance, at once.
//!
//! In: samples of a picture. Out: their outcomes if light goes straight in the chart. A chart point `u`
//! lies at `p = (S R)ᵀ G (u − u_cam)` in the camera's axes, and on the picture at `p` divided by its
//! depth; since `(S R)ᵀ G = (S R)⁻¹`, that is the chart's straight line from the camera. It is right near
//! the camera, and off by an angle that grows in proportion to the distance.
//!
//! Triangles are cut at a plane in front of the camera, projected and filled with a depth for every
//! sample; where a picture is no plane, each sample's line is intersected. Where nothing is met, the skies of sixteen lines are
//! found at once. In glued coordinates the scene is drawn in the periods next to the camera's too.

use super::{
    accel::TimedChord,
    curve::{Cubic, Curve, Ending},
    endings::EventLocator,
    frame::Outcomes,
    intersect::{Hit, HitSearch, Seen, beyond},
    lanes::{LANES, each_vector},
    tiles::{PixelSamples, SamplePlace},
    tracer::even_knots,
    view::{Optics, View},
    world::World,
};
use geofan_core::manifold::{DeckTransformation, LocalFrame};
use geofan_core::parallel::*;
use glam::{DMat3, DVec2, DVec3};
use ndarray::{ArrayViewMut3, Axis};

/// Returns `(S R)ᵀ G (u − u_cam)`: `u` in the axes of the view's camera (right, up, backwards). In a
/// wind, which has blown light off on its way, where it is seen.
pub fn projection(world: &World, view: &View, u: DVec3) -> DVec3 {
    let axes = view.camera().axes(&world.manifold);
    let (g, local) = (
        world.manifold.metric(view.u),
        world.manifold.local_frame(view.u),
    );
    axes.transpose() * g * local.toward(g, u - view.u)
}

/// Finds what `samples` see along straight lines, followed over `length` to the skies.
pub(super) fn trace_straight(samples: &PixelSamples<'_>, length: f64) -> Outcomes {
    let (world, count) = (samples.world, samples.offsets.len());
    let (width, height) = samples.view.size;
    let straight = StraightLines::new(world, samples.view);
    // Triangles have straight sides on a plane only, seen by a camera at rest, and where they do not move while light is on
    // its way.
    let flat = matches!(samples.view.optics(), Optics::Perspective { .. });
    let at_rest = samples.view.velocity() == DVec3::ZERO && !world.accelerator.moves();
    let flat = flat && samples.view.is_central() && at_rest;
    let picture = flat.then(|| Projection::new(world, samples.view));
    let mut outcomes = Outcomes::from_elem((height, width, count), Seen::Nothing);
    outcomes
        .axis_chunks_iter_mut(Axis(0), BAND)
        .into_par_iter()
        .enumerate()
        .for_each_init(
            || EventLocator::new(&world.manifold),
            |events, (band, rows)| {
                let picture = picture.as_ref();
                straight.fill(samples, picture, (band * BAND, rows), (length, events));
            },
        );
    outcomes
}

/// Rows filled by one thread at a time; every band looks at every triangle's box.
const BAND: usize = 64;

/// Pieces of a straight line on which its exit is looked for.
const INTERVALS: usize = 64;

/// Depth at which triangles are cut, as a share of the greatest depth. What is cut off is nearer than
/// anything that a picture is made for; a hundred times nearer, corners beside the camera lie so far
/// outside the picture that the weights lose their digits.
const NEAR: f64 = 1e-5;

/// A triangle of the scene, or a part that cutting leaves of it, on the picture.
struct ProjectedTriangle {
    /// Its number.
    triangle: u32,
    /// Number of the map that carries it to where it is seen.
    image: u32,
    /// Corners on the picture, in pixels.
    at: [DVec2; 3],
    /// One over the depths.
    nearness: [f64; 3],
    /// Weights of the whole triangle's second and third corner at these corners, over the depths.
    weights: [DVec2; 3],
    /// Rows and columns that it may cover.
    low: DVec2,
    high: DVec2,
}

/// A triangle that is in the picture. It is projected again where it is drawn: a list of all projections would be
/// most of what a page remembers.
struct PicturedTriangle {
    /// Its number.
    triangle: u32,
    /// Number of the map that carries it to where it is seen.
    image: u32,
    /// Rows between which it lies.
    rows: [f32; 2],
}

/// The triangles of a scene on a picture that is a plane.
struct Projection<'w> {
    world: &'w World,
    view: &'w View,
    axes: DMat3,
    /// The metric and the observer at the camera.
    metric: DMat3,
    local: LocalFrame,
    /// Carries ways in the chart into the camera's axes.
    into: DMat3,
    triangles: Vec<PicturedTriangle>,
    images: Vec<SceneImage>,
    /// Depth at which triangles are cut.
    near: f64,
}

impl<'w> Projection<'w> {
    /// Finds all triangles on the picture, in all periods next to the camera's.
    fn new(world: &'w World, view: &'w View) -> Self {
        let camera = view.camera();
        let axes = camera.axes(&world.manifold);
        let metric = world.manifold.metric(view.u);
        let into = axes.transpose() * metric;
        let farthest = world.accelerator.bounds().map_or(1.0, |(low, high)| {
            (into * (low - view.u))
                .length()
                .max((into * (high - view.u)).length())
        });
        let mut picture = Self {
            world,
            view,
            axes,
            metric,
            local: world.manifold.local_frame(view.u),
            into,
            triangles: Vec::new(),
            images: neighbouring_images(world),
            near: NEAR * farthest,
        };
        for image in 0..picture.images.len() as u32 {
            let numbers = 0..world.accelerator.triangles().len() as u32;
            let pictured = numbers.into_par_iter();
            let pictured = pictured.filter_map(|triangle| picture.pictured(image, triangle));
            let pictured: Vec<PicturedTriangle> = pictured.collect();
            picture.triangles.extend(pictured);
        }
        picture
    }

    /// Returns where an image of a triangle is in the picture; `None` if it is outside.
    fn pictured(&self, image: u32, triangle: u32) -> Option<PicturedTriangle> {
        let parts = self.project(image, triangle);
        let low = parts.iter().map(|part| part.low.y).reduce(f64::min)?;
        let high = parts.iter().map(|part| part.high.y).reduce(f64::max)?;
        Some(PicturedTriangle {
            triangle,
            image,
            rows: [low.floor() as f32, high.ceil() as f32],
        })
    }

    /// Projects the parts of a triangle's image that lie in front of the camera and in the picture.
    fn project(&self, image: u32, triangle: u32) -> Vec<ProjectedTriangle> {
        let map = &self.images[image as usize];
        let corners = self.world.accelerator.triangles()[triangle as usize];
        let corners = corners.map(|u| self.seen(map.point(u)));
        let weights = [DVec2::ZERO, DVec2::X, DVec2::Y];
        let polygon: Vec<(DVec3, DVec2)> = corners.into_iter().zip(weights).collect();
        let cut = cut_at(&polygon, self.near);
        let fan = (2..cut.len()).map(|k| [cut[0], cut[k - 1], cut[k]]);
        fan.filter_map(|corners| self.project_part((image, triangle), corners))
            .collect()
    }

    /// Returns a chart point in the axes of the camera, as it sees it.
    fn seen(&self, u: DVec3) -> DVec3 {
        let (view, frame) = (self.view, &self.local.frame);
        let way = self.local.toward(self.metric, u - view.u);
        match view.velocity() == DVec3::ZERO {
            true => self.into * way,
            false => self.axes.inverse() * *frame * view.in_camera(frame.inverse() * way),
        }
    }

    /// Projects a triangle whose corners have these weights; `None` if it is outside the picture.
    fn project_part(
        &self,
        (image, triangle): (u32, u32),
        corners: [(DVec3, DVec2); 3],
    ) -> Option<ProjectedTriangle> {
        let camera = DMat3::from_quat(self.view.camera().rotation);
        let pixel = |p: DVec3| {
            self.view
                .own_pixel(camera * p)
                .map(|(x, y)| DVec2::new(x, y))
        };
        let [a, b, c] = corners.map(|(p, _)| pixel(p));
        let at = [a?, b?, c?];
        let (low, high) = (at[0].min(at[1]).min(at[2]), at[0].max(at[1]).max(at[2]));
        let size = DVec2::new(self.view.size.0 as f64, self.view.size.1 as f64);
        let visible = low.cmplt(size).all() && high.cmpgt(DVec2::ZERO).all();
        visible.then(|| ProjectedTriangle {
            triangle,
            image,
            at,
            nearness: corners.map(|(p, _)| -1.0 / p.z),
            weights: corners.map(|(p, w)| w / -p.z),
            low,
            high,
        })
    }

    /// Fills the rows from `first` with the nearest triangles, as far as `length`.
    fn fill(
        &self,
        (first, length): (usize, f64),
        offsets: &[DVec2],
        mut part: ArrayViewMut3<'_, Seen>,
    ) {
        let (height, width, samples) = part.dim();
        let mut nearest = vec![0.0; height * width * samples];
        let end = (first + height) as f64;
        let reaches = |t: &&PicturedTriangle| {
            let [low, high] = t.rows.map(f64::from);
            low < end && high > first as f64
        };
        let pictured = self.triangles.iter().filter(reaches);
        for projected in pictured.flat_map(|t| self.project(t.image, t.triangle)) {
            let range = |low: f64, high: f64, limit: usize| {
                let from = (low - 1.0).max(0.0) as usize;
                from..((high + 1.0).max(0.0) as usize).min(limit)
            };
            let rows = range(
                projected.low.y - first as f64,
                projected.high.y - first as f64,
                height,
            );
            for y in rows {
                for x in range(projected.low.x, projected.high.x, width) {
                    for (k, offset) in offsets.iter().enumerate() {
                        let at = DVec2::new(x as f64, (first + y) as f64) + *offset;
                        let slot = &mut nearest[(y * width + x) * samples + k];
                        let Some((nearness, weights)) = projected.meet(at) else {
                            continue;
                        };
                        if nearness > *slot
                            && !self.is_open(projected.triangle, weights)
                            && let Some(seen) = self.hit(&projected, weights, length)
                        {
                            *slot = nearness;
                            part[(y, x, k)] = seen;
                        }
                    }
                }
            }
        }
    }

    /// Tells whether a triangle has a hole at these weights.
    fn is_open(&self, triangle: u32, weights: DVec2) -> bool {
        let weights = weights.as_vec2().to_array();
        self.world.accelerator.is_open(triangle, weights)
    }

    /// Returns the hit at the place of a triangle with these weights; `None` if it is farther away than `length`.
    fn hit(&self, seen: &ProjectedTriangle, weights: DVec2, length: f64) -> Option<Seen> {
        let [a, b, c] = self.world.accelerator.triangles()[seen.triangle as usize];
        let u = a + (b - a) * weights.x + (c - a) * weights.y;
        let map = &self.images[seen.image as usize];
        let way = map.point(u) - self.view.u;
        let s = (self.axes.inverse() * self.local.toward(self.metric, way)).length();
        (s <= length).then(|| {
            Seen::Surface(Hit {
                s: s as f32,
                v: map.back(u, way / s).as_vec3(),
                triangle: seen.triangle,
                barycentric: weights.as_vec2().to_array(),
            })
        })
    }
}

/// The straight lines of the chart from the camera.
struct StraightLines<'w> {
    view: &'w View,
    /// The observer at the camera.
    local: LocalFrame,
}

impl<'w> StraightLines<'w> {
    fn new(world: &World, view: &'w View) -> Self {
        Self {
            view,
            local: world.manifold.local_frame(view.u),
        }
    }

    /// Returns the chart's straight line of the point `at` of the picture: its start and its tangent.
    fn line(&self, at: DVec2) -> (DVec3, DVec3) {
        let ray = self.view.ray(at.x, at.y);
        let start = self.view.u + self.local.frame * ray.offset;
        (start, self.local.tangent(ray.direction))
    }

    /// Fills the rows from `first` on: with the triangles of `picture`, without one with what each line meets within
    /// `length`, and with skies.
    fn fill(
        &self,
        samples: &PixelSamples<'_>,
        picture: Option<&Projection<'_>>,
        (first, mut rows): (usize, ArrayViewMut3<'_, Seen>),
        (length, events): (f64, &mut EventLocator<'_>),
    ) {
        if let Some(picture) = picture {
            picture.fill((first, length), samples.offsets, rows.view_mut());
        }
        let place = |(y, x, k): SamplePlace| samples.point((first + y, x, k));
        let mut beyond_all = Vec::new();
        for (index, slot) in rows.indexed_iter_mut() {
            let at = place(index);
            if *slot != Seen::Nothing || !self.view.shows(at.x, at.y) {
                continue;
            }
            let met = match picture {
                Some(_) => None,
                None => self.met(samples.world, at, length),
            };
            match met {
                Some(hit) => *slot = hit,
                None => beyond_all.push(index),
            }
        }
        for sixteen in beyond_all.chunks(LANES) {
            let skies = self.skies(|l| place(sixteen[l]), sixteen.len(), length, events);
            for (index, sky) in sixteen.iter().zip(skies) {
                rows[*index] = sky;
            }
        }
    }

    /// Finds what that line meets within `length`.
    fn met(&self, world: &World, at: DVec2, length: f64) -> Option<Seen> {
        let (u, v) = self.line(at);
        let piece = Cubic {
            s: [0.0, length],
            u: [u, u + v * length],
            v: [v, v],
        };
        let hit = HitSearch::new(world).first_hit(&piece, length);
        hit.map(Seen::Surface)
    }

    /// Finds the skies at the ends of `count` such lines, at most [`LANES`].
    fn skies(
        &self,
        at: impl Fn(usize) -> DVec2,
        count: usize,
        length: f64,
        events: &mut EventLocator<'_>,
    ) -> [Seen; LANES] {
        let lines = std::array::from_fn(|l| self.line(at(l.min(count - 1))));
        endings_of(&lines, length, events).map(|ending| beyond(&ending))
    }

    /// Finds the surface on the line through `at` behind so many others, as far as `reach`.
    fn behind(&self, world: &World, at: DVec2, passed: usize, reach: f64) -> Option<Hit> {
        let (u, v) = self.line(at);
        let [start, end] = [0.0, reach].map(|s| u + v * s);
        let mut from = 0.0;
        let mut found = None;
        for _ in 0..=passed {
            let hits = neighbouring_periods(world).into_iter().filter_map(|shift| {
                let chord = TimedChord {
                    ends: [start.lerp(end, from) - shift, end - shift],
                    s: [from * reach, reach],
                };
                world.accelerator.first_hit_on_chord(&chord)
            });
            let hit = hits.min_by(|a, b| a.t.total_cmp(&b.t))?;
            let t = from + hit.t * (1.0 - from);
            found = Some(Hit {
                s: (t * reach) as f32,
                v: v.as_vec3(),
                triangle: hit.triangle,
                barycentric: [hit.barycentric.0 as f32, hit.barycentric.1 as f32],
            });
            from = t + BEYOND;
        }
        found
    }
}

/// Finds the endings of straight lines of the chart over `length`, by their starts and tangents.
fn endings_of(
    lines: &[(DVec3, DVec3); LANES],
    length: f64,
    events: &mut EventLocator<'_>,
) -> [Ending; LANES] {
    let starts = each_vector(|c, l| lines[l].0[c]);
    let tangents = each_vector(|c, l| lines[l].1[c]);
    events.endings_of_lines((&starts, &tangents), (length, INTERVALS))
}

/// Returns the chart's straight line from `u` in `direction` (standard frame, unit) as a path over `length`, with the
/// ending that the local view shows.
pub fn straight_curve(world: &World, u: DVec3, direction: DVec3, length: f64) -> Curve {
    let v = world.manifold.local_frame(u).tangent(direction);
    let s = even_knots(length, INTERVALS);
    let mut events = EventLocator::new(&world.manifold);
    let [ending, ..] = endings_of(&[(u, v); LANES], length, &mut events);
    Curve {
        ending,
        u: s.iter().map(|s| u + v * s).collect(),
        v: vec![v; s.len()],
        s,
    }
}

/// Distance beyond a surface from which the next is looked for, as a share of the whole line: more than rounding.
const BEYOND: f64 = 1e-9;

/// Finds what `samples` at these places see along straight lines, each behind as many surfaces as it has `passed`; lines are
/// followed over `length` to the skies.
pub(super) fn straight_behind(
    samples: &PixelSamples<'_>,
    length: f64,
    passed: &[(SamplePlace, usize)],
) -> Vec<Seen> {
    let (world, view) = (samples.world, samples.view);
    let lines = StraightLines::new(world, view);
    let corners = world.accelerator.bounds().map(|(low, high)| [low, high]);
    let shifts = neighbouring_periods(world);
    let farthest = corners.into_iter().flatten().flat_map(|corner| {
        let from = corner - view.u;
        shifts.iter().map(move |shift| (from + *shift).length())
    });
    // Corners of a box are no farther apart than thrice two opposite ones are.
    let reach = |v: DVec3, farthest: f64| 3.0 * farthest / v.length();
    let farthest = farthest.fold(0.0, f64::max);
    let sixteen = |events: &mut EventLocator<'_>, passed: &[(SamplePlace, usize)]| {
        let place = |l: usize| samples.point(passed[l].0);
        let skies = lines.skies(place, passed.len(), length, events);
        let seen = passed
            .iter()
            .zip(skies)
            .enumerate()
            .map(|(l, ((_, passed), sky))| {
                let at = place(l);
                let v = lines.local.tangent(view.direction(at.x, at.y));
                let hit = lines.behind(world, at, *passed, reach(v, farthest));
                hit.map_or(sky, Seen::Surface)
            });
        seen.collect::<Vec<_>>()
    };
    let found = passed.par_chunks(LANES);
    let found = found.map_init(|| EventLocator::new(&world.manifold), sixteen);
    found.collect::<Vec<_>>().concat()
}

impl ProjectedTriangle {
    /// Returns one over the depth, and the weights of the whole triangle's corners, at a point of the
    /// picture; `None` outside.
    fn meet(&self, at: DVec2) -> Option<(f64, DVec2)> {
        let [a, b, c] = self.at.map(|corner| corner - at);
        let edges = [b.perp_dot(c), c.perp_dot(a), a.perp_dot(b)];
        let sum: f64 = edges.iter().sum();
        let inside = edges.iter().all(|e| e * sum >= 0.0) && sum != 0.0;
        inside.then(|| {
            let share = edges.map(|e| e / sum);
            let nearness = (0..3).map(|k| share[k] * self.nearness[k]).sum::<f64>();
            let weights: DVec2 = (0..3).map(|k| self.weights[k] * share[k]).sum();
            (nearness, weights / nearness)
        })
    }
}

/// Returns the part of a polygon (camera's axes, and weights) at depths of at least `near`.
fn cut_at(polygon: &[(DVec3, DVec2)], near: f64) -> Vec<(DVec3, DVec2)> {
    let mut cut = Vec::new();
    for (i, &(p, w)) in polygon.iter().enumerate() {
        let (q, x) = polygon[(i + 1) % polygon.len()];
        let (depth, next) = (-p.z - near, -q.z - near);
        if depth >= 0.0 {
            cut.push((p, w));
        }
        if (depth >= 0.0) != (next >= 0.0) {
            let t = depth / (depth - next);
            cut.push((p.lerp(q, t), w.lerp(x, t)));
        }
    }
    cut
}

/// Carries the scene to a copy of it.
enum SceneImage {
    /// By whole periods.
    Shifted(DVec3),
    /// Behind a face of a glued domain, or into it.
    Glued(DeckTransformation),
}

impl SceneImage {
    /// Carries a point of the chart.
    fn point(&self, u: DVec3) -> DVec3 {
        match self {
            Self::Shifted(shift) => u + *shift,
            Self::Glued(deck) => deck.point(u),
        }
    }

    /// Carries a vector at the image of `u` back to `u`.
    fn back(&self, u: DVec3, v: DVec3) -> DVec3 {
        match self {
            Self::Shifted(_) => v,
            Self::Glued(deck) => deck.apply(u).1.inverse() * v,
        }
    }
}

/// Returns the maps to the copies next to the camera's: by whole periods, or into a glued domain and behind its faces.
fn neighbouring_images(world: &World) -> Vec<SceneImage> {
    match &world.copies {
        Some(copies) => {
            let beside = copies.beside_domain().into_iter();
            beside.map(SceneImage::Glued).collect()
        }
        None => {
            let shifts = neighbouring_periods(world).into_iter();
            shifts.map(SceneImage::Shifted).collect()
        }
    }
}

/// Returns the displacements by −1, 0 and 1 periods of every glued coordinate.
fn neighbouring_periods(world: &World) -> Vec<DVec3> {
    let mut shifts = vec![DVec3::ZERO];
    for k in 0..3 {
        if let Some(period) = world.manifold.domain.period(k) {
            let along = |n: f64| move |s: &DVec3| *s + DVec3::AXES[k] * (n * period);
            let moved = [-1.0, 1.0].map(|n| shifts.iter().map(along(n)).collect::<Vec<_>>());
            shifts.extend(moved.concat());
        }
    }
    shifts
}
