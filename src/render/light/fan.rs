//! The geodesics of a light in all directions, as cells of space in which its rays lie.
//!
//! In: a light's chart point and a length. Out: [`LightFan`]: exact rays on a triangle mesh of
//! directions, fine where they diverge or fold, cut by arc length into prisms. A point that the
//! light reaches lies in a prism for every geodesic that reaches it.

use super::{
    boxes::Boxes,
    cell::{Cell, Guess},
    icosphere,
};
use crate::{
    geodesic::{End, Ray, Settings, Sink, Step, follow, signed_area},
    manifold::{Carried, Manifold, Observer},
};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::collections::HashMap;

/// A box of the chart, by its corners.
pub type Region = (DVec3, DVec3);

/// Halvings of the icosahedron's edges before rays are compared: 162 rays, 16° apart.
const FIRST_LEVEL: usize = 2;

/// Most halvings: directions 0.5° apart. Light that needs finer ones (that has circled a black hole)
/// has spread over so much area that nobody sees it.
const LAST_LEVEL: usize = 7;

/// Most halvings because rays fold or end at different places: directions 2° apart. That has no
/// natural end: the edges of caustics and shadows cross triangles of any size.
const LAST_EDGE_LEVEL: usize = 5;

/// Rays of one fan beyond which it is refined no further, for its memory: about 5 kB each.
const MOST_RAYS: usize = 12_000;

/// A triangle of rays is fine enough if the middle of each edge lies within this share of the edge
/// from where interpolation puts it. Guesses are then so close that two or three steps of Newton's
/// method finish them; twice the share costs a step, half of it four times the rays.
const BEND: f64 = 0.08;

/// Intervals of arc length, and how many at most. They are doubled while more than a tenth of the
/// rays miss the middle of a cubic by more than [`BEND`] of it. A cubic that misses by more than
/// [`BROKEN`] of it stands for nothing (the ray has turned back, or has passed the chart's infinity).
const BROKEN: f64 = 0.5;
const INTERVALS: usize = 32;
const MOST_INTERVALS: usize = 256;

/// Rays traced by one thread at a time.
const BLOCK: usize = 64;

/// Tolerance of the fan's rays; they serve as guesses only.
const TOLERANCE: f64 = 1e-6;

/// A ray of the fan at the knots it reaches; the last two may be extrapolated, so that the cells
/// reach as far as the space does.
#[derive(Debug, Clone, Default)]
pub(super) struct FanRay {
    pub direction: DVec3,
    pub knots: Vec<Knot>,
}

/// A ray at one arc length: what a cell needs of it lies together.
#[derive(Debug, Clone, Copy)]
pub(super) struct Knot {
    pub u: DVec3,
    pub v: DVec3,
    /// How the point moves when the direction turns towards each of its perpendiculars.
    pub spread: [Vec3; 2],
    /// Whether the area is negative.
    pub reversed: bool,
}

/// Room to look for guesses in.
#[derive(Default)]
pub(super) struct Room {
    around: Vec<u32>,
    /// Cells, and roughly where in them the point is.
    places: Vec<(u32, DVec3)>,
    known: Vec<Guess>,
}

/// The rays of a light.
pub struct LightFan<'m> {
    pub(super) manifold: &'m Manifold,
    /// The light's chart point.
    pub u: DVec3,
    /// The observer there.
    pub(super) observer: Observer,
    /// How far its light is followed.
    pub length: f64,
    /// Where connections are asked for.
    region: Region,
    pub(super) rays: Vec<FanRay>,
    /// The rays' directions once more, close together: most cells need no more of their rays.
    pub(super) directions: Vec<DVec3>,
    /// Arc lengths at which rays are sampled: the ends of intervals and, in between, their middles.
    pub(super) knots: Vec<f64>,
    cells: Vec<Cell>,
    boxes: Boxes,
}

impl<'m> LightFan<'m> {
    /// The rays from `u` over `length`, for connections to points in `region`.
    pub fn new(manifold: &'m Manifold, u: DVec3, length: f64, region: Region) -> Self {
        let mut fan = Self {
            manifold,
            u,
            observer: manifold.observer(u),
            length,
            region: widened(manifold, region),
            rays: Vec::new(),
            directions: Vec::new(),
            knots: Vec::new(),
            cells: Vec::new(),
            boxes: Boxes::new(&[]),
        };
        fan.choose_knots();
        let triangles = fan.refine();
        fan.directions = fan.rays.iter().map(|ray| ray.direction).collect();
        let (cells, boxes): (Vec<Cell>, Vec<Region>) = triangles
            .par_iter()
            .flat_map_iter(|corners| fan.cells_of(*corners))
            .unzip();
        fan.boxes = Boxes::new(&boxes);
        fan.cells = cells;
        fan
    }

    /// The cells of a triangle of rays that matter, with the boxes around them.
    fn cells_of(&self, corners: [usize; 3]) -> Vec<(Cell, Region)> {
        let rays = corners.map(|i| &self.rays[i]);
        let reach = rays.iter().map(|r| r.knots.len()).min().unwrap_or(0);
        let starts = (0..reach.saturating_sub(2)).step_by(2);
        let sound = starts.filter(|k| rays.iter().all(|r| r.miss(*k, self.knots[1]) <= BROKEN));
        let cells = sound.map(|k| {
            let cell = Cell::new(self, corners, k);
            let bounds = cell.bounds(self);
            (cell, bounds)
        });
        cells
            .filter(|(_, bounds)| meet(*bounds, self.region))
            .collect()
    }

    fn even_knots(&self, count: usize) -> Vec<f64> {
        (0..=count)
            .map(|k| self.length * k as f64 / count as f64)
            .collect()
    }

    /// The fewest intervals on which cubics follow most rays.
    fn choose_knots(&mut self) {
        let directions = icosphere::corners();
        let mut count = INTERVALS;
        loop {
            self.knots = self.even_knots(2 * count);
            let rays = self.trace(&directions);
            let coarse = |ray: &&FanRay| {
                let starts = (0..ray.knots.len().saturating_sub(3)).step_by(2);
                let mut inside = starts.filter(|k| holds(self.region, ray.knots[*k].u));
                inside.any(|k| ray.miss(k, self.knots[1]) > BEND)
            };
            let bad = rays.iter().filter(coarse).count();
            if 10 * bad <= directions.len() || 2 * count > MOST_INTERVALS {
                return;
            }
            count *= 2;
        }
    }

    /// Fills `rays` and returns the triangles of them.
    fn refine(&mut self) -> Vec<[usize; 3]> {
        let corners = icosphere::corners();
        let mut open = icosphere::faces(&corners);
        self.rays = self.trace(&corners);
        let mut middles: HashMap<[usize; 2], usize> = HashMap::new();
        let mut done = Vec::new();
        for level in 1..=LAST_LEVEL {
            self.trace_middles(&open, &mut middles);
            let full = self.rays.len() > MOST_RAYS;
            let mut next = Vec::new();
            for triangle in open {
                let children = children(triangle, &middles);
                let fine = level > FIRST_LEVEL && self.is_fine(triangle, &middles, level);
                let list = if fine || full || level == LAST_LEVEL {
                    &mut done
                } else {
                    &mut next
                };
                list.extend(children);
            }
            open = next;
        }
        done
    }

    /// Traces the middles of all edges that have none yet.
    fn trace_middles(
        &mut self,
        triangles: &[[usize; 3]],
        middles: &mut HashMap<[usize; 2], usize>,
    ) {
        let mut directions = Vec::new();
        for [a, b, c] in triangles {
            for (i, j) in [(*a, *b), (*b, *c), (*c, *a)] {
                middles.entry(edge(i, j)).or_insert_with(|| {
                    let middle = self.rays[i].direction + self.rays[j].direction;
                    directions.push(middle.normalize());
                    self.rays.len() + directions.len() - 1
                });
            }
        }
        let rays = self.trace(&directions);
        self.rays.extend(rays);
    }

    /// Whether interpolation between the triangle's rays is close to the rays in the middles, as far
    /// as they are in the region.
    fn is_fine(
        &self,
        [a, b, c]: [usize; 3],
        middles: &HashMap<[usize; 2], usize>,
        level: usize,
    ) -> bool {
        [(a, b), (b, c), (c, a)].into_iter().all(|(i, j)| {
            let [p, q, m] = [i, j, middles[&edge(i, j)]].map(|k| &self.rays[k]);
            let reach = [p, q, m].map(|r| r.knots.len());
            let (least, most) = reach
                .iter()
                .fold((usize::MAX, 0), |(a, b), r| (a.min(*r), b.max(*r)));
            let mut inside = (1..least).filter(|k| {
                [p, q, m]
                    .iter()
                    .any(|ray| holds(self.region, ray.knots[*k].u))
            });
            let whole = level >= LAST_EDGE_LEVEL
                || most - least <= 4.max(most / 10)
                    && inside
                        .clone()
                        .all(|k| p.knots[k].reversed == q.knots[k].reversed);
            whole
                && inside.all(|k| {
                    let [p, q, m] = [p, q, m].map(|ray| ray.knots[k].u);
                    (0.5 * (p + q) - m).length() <= BEND * (p - q).length()
                })
        })
    }

    /// Exact rays, sampled at the knots.
    fn trace(&self, directions: &[DVec3]) -> Vec<FanRay> {
        let settings = Settings {
            tolerance: TOLERANCE,
            carried: Carried {
                frame: false,
                deviation: true,
            },
            events: true,
        };
        let block = |directions: &[DVec3]| -> Vec<FanRay> {
            let mut sampler = Sampler {
                fan: self,
                rays: directions.iter().map(|d| self.first_knot(*d)).collect(),
            };
            let rays = directions
                .iter()
                .map(|d| Ray::seen_by(&self.observer, self.u, *d, self.length));
            follow(self.manifold, settings, rays, &mut sampler);
            sampler.rays
        };
        directions.par_chunks(BLOCK).flat_map(block).collect()
    }

    fn first_knot(&self, direction: DVec3) -> FanRay {
        FanRay {
            direction,
            knots: vec![Knot {
                u: self.u,
                v: self.observer.tangent(direction),
                spread: [Vec3::ZERO; 2],
                reversed: false,
            }],
        }
    }

    /// Guesses of all geodesics to the chart point `x`, with the image of `x` that each is for (in
    /// glued coordinates, a point whole periods away).
    pub(super) fn guesses(&self, x: DVec3, room: &mut Room) -> Vec<(DVec3, Guess)> {
        let mut guesses: Vec<(DVec3, Guess)> = Vec::new();
        for image in self.images(x) {
            self.boxes.around(image, &mut room.around);
            room.places.clear();
            let place = |i: &u32| Some((*i, self.cells[*i as usize].place(image)?));
            room.places.extend(room.around.iter().filter_map(place));
            // The cell that the point is in first: what it finds spares the search in its neighbours.
            let doubt = |(i, place): &(u32, DVec3)| self.cells[*i as usize].doubt(*place);
            room.places.sort_by(|a, b| doubt(a).total_cmp(&doubt(b)));
            room.known.clear();
            for (i, place) in &room.places {
                self.cells[*i as usize].guesses(self, image, *place, &mut room.known);
            }
            guesses.extend(room.known.iter().map(|guess| (image, *guess)));
        }
        guesses
    }

    /// The points whole periods from `x` within reach of the fan.
    fn images(&self, x: DVec3) -> Vec<DVec3> {
        let Some((low, high)) = self.boxes.bounds() else {
            return Vec::new();
        };
        let mut images = vec![x];
        for k in 0..3 {
            if let Some(period) = self.manifold.domain.period(k) {
                let from = ((low[k] - x[k]) / period).ceil() as i64;
                let to = ((high[k] - x[k]) / period).floor() as i64;
                let along = |p: &DVec3| -> Vec<DVec3> {
                    let p = *p;
                    (from..=to)
                        .map(|n| p + DVec3::AXES[k] * (n as f64 * period))
                        .collect()
                };
                images = images.iter().flat_map(along).collect();
            }
        }
        images
    }
}

impl FanRay {
    /// How far the cubic over the interval from knot `k` misses the ray in the middle, as a share of
    /// the interval's chord; `half` is half the interval's arc length.
    fn miss(&self, k: usize, half: f64) -> f64 {
        let [p, m, q] = [k, k + 1, k + 2].map(|k| &self.knots[k]);
        let cubic = 0.5 * (p.u + q.u) + (p.v - q.v) * (0.25 * half);
        (cubic - m.u).length() / (q.u - p.u).length()
    }
}

/// The region with half its size around it, and without end along glued coordinates.
fn widened(manifold: &Manifold, (low, high): Region) -> Region {
    let margin = 0.5 * (high - low).max_element();
    let mut wide = (low - margin, high + margin);
    for k in (0..3).filter(|k| manifold.domain.period(*k).is_some()) {
        (wide.0[k], wide.1[k]) = (f64::NEG_INFINITY, f64::INFINITY);
    }
    wide
}

fn holds((low, high): Region, u: DVec3) -> bool {
    u.cmpge(low).all() && u.cmple(high).all()
}

fn meet(a: Region, b: Region) -> bool {
    a.0.cmple(b.1).all() && b.0.cmple(a.1).all()
}

/// Two rays, the lower number first.
fn edge(i: usize, j: usize) -> [usize; 2] {
    [i.min(j), i.max(j)]
}

fn children([a, b, c]: [usize; 3], middles: &HashMap<[usize; 2], usize>) -> [[usize; 3]; 4] {
    let [m, n, o] = [edge(a, b), edge(b, c), edge(c, a)].map(|e| middles[&e]);
    [[a, m, o], [m, b, n], [o, n, c], [m, n, o]]
}

/// Samples steps at the knots.
struct Sampler<'f, 'm> {
    fan: &'f LightFan<'m>,
    rays: Vec<FanRay>,
}

impl Sink for Sampler<'_, '_> {
    fn step(&mut self, ray: usize, step: &Step) {
        let ray = &mut self.rays[ray];
        while let Some(&s) = self.fan.knots.get(ray.knots.len())
            && s <= step.end
        {
            let (u, v) = (step.position(s), step.tangent(s));
            let observer = self.fan.manifold.observer(u);
            let spread = step.deviation(s).unwrap_or_default();
            ray.knots.push(Knot {
                u,
                v,
                spread: spread.map(|j| j.as_vec3()),
                reversed: signed_area(&observer, v, spread) < 0.0,
            });
        }
    }

    fn end(&mut self, ray: usize, _: End, _: f64, _: usize) {
        let ray = &mut self.rays[ray];
        let at = ray.knots.len() - 1;
        let last = ray.knots[at];
        for s in self.fan.knots.iter().skip(at + 1).take(2) {
            let u = last.u + last.v * (s - self.fan.knots[at]);
            ray.knots.push(Knot { u, ..last });
        }
    }
}
