//! The light of one lamp in all directions, as segments of beams.
//!
//! In: a lamp's chart point, the length over which its light is followed, and the box in which
//! connections are asked for. Out: a [`LightFan`]: exact rays through the corners of a triangle mesh
//! on the sphere of directions, fine where rays diverge or fold. Three neighbouring rays bound a
//! beam; arc length cuts it into [`BeamSegment`]s. A point that the light reaches lies in one segment
//! for every geodesic that reaches it, so a box tree over the segments gives guesses of all of them.
//!
//! Symbols: `u` chart point, `v` unit tangent (chart components), `s` arc length, `d` direction
//! (standard frame at the lamp, unit).

use crate::{
    beam::{BeamSegment, Guess},
    fan_refinement::{BEND, icosahedron_corners},
    ray_leg::{KnotSampler, RayLeg, Region, common, holds, meet},
};
use geofan_core::{
    geodesic::{Ray, Settings, follow, perpendiculars},
    manifold::{DeckTransformation, GluedFace, LocalFrame, Manifold},
    parallel::*,
};
use geofan_render::accel::BoxTree;
use glam::DVec3;
use std::ops::Range;

/// A cubic that misses the middle of its interval by more than this share of the interval says
/// nothing about the ray (which has turned back, or has passed the chart's infinity).
const BROKEN: f64 = 0.5;

/// Intervals of arc length, and how many at most. They are doubled while more than a tenth of the
/// rays miss the middle of a cubic by more than [`BEND`] of the interval.
const INTERVALS: usize = 32;
const MOST_INTERVALS: usize = 256;

/// Rays traced by one thread at a time.
const BLOCK: usize = 64;

/// Margin around the images of points of its faces within which a copy of a glued domain lies, as a share of how far these
/// are apart: between those points faces bulge. Chosen, not measured.
const COPY_MARGIN: f64 = 0.5;

/// Share of the size of a segment's box below which a copy's points stand for all of it. Chosen, not measured.
const SMALL: f64 = 0.25;

/// Most copies of a glued domain into which the light of a lamp is followed, and that to one point: a lamp's are gone through for
/// each point that it lights, those to one point once. So many are enough for 1,102 images in the space of Seifert and Weber.
const MOST_COPIES: usize = 20_000;
const POINT_COPIES: usize = 200_000;

/// Knots reach at least this many times as far as the first rays matter, if rays are to be followed so far: knots at
/// arc lengths where no ray matters leave fewer for those before, and up to here that costs nothing.
const SPARE: f64 = 4.0;

/// Tolerance of the fan's rays; they serve as guesses only.
const TOLERANCE: f64 = 1e-6;

/// The rays of a lamp, ready to be connected with points.
pub struct LightFan<'m> {
    pub(super) manifold: &'m Manifold,
    /// The lamp's chart point.
    pub u: DVec3,
    /// The observer there.
    pub(super) local: LocalFrame,
    /// Arc length over which its light is followed.
    pub length: f64,
    /// Arc length up to which there are knots: less where all rays end long before `length`, or have left for good the
    /// region in which connections are asked for.
    reach: f64,
    /// Where connections are asked for.
    pub(super) region: Region,
    /// The rays' legs at the arc lengths they reach. The last knots may be extrapolated, so that the segments reach
    /// as far as the space does, or beyond a border, and so may the first behind one.
    pub(super) legs: Vec<RayLeg>,
    /// The numbers of the legs of each ray.
    pub(super) rays: Vec<Range<usize>>,
    /// Arc lengths of the knots: the ends of intervals and, in between, their middles.
    pub(super) arc_lengths: Vec<f64>,
    segments: Vec<BeamSegment>,
    /// From the domain of a glued space to its copies within reach.
    copies: Vec<DeckTransformation>,
    /// The one point for which all geodesics are asked for, as a box without size; endless like `region`.
    pub(super) target: Option<Region>,
    /// The numbers of the segments, by the boxes around them.
    boxes: BoxTree<(u32, Region)>,
}

impl<'m> LightFan<'m> {
    /// Follows the light from `u` over `length`, for connections to points in `region`.
    pub fn new(manifold: &'m Manifold, u: DVec3, length: f64, region: Region) -> Self {
        Self::made((manifold, u), length, region, None)
    }

    /// Does so for the one point `to`, about which cubics are to be close as far as `margin`: rays that may come there are
    /// followed as finely as it takes, also light that has circled a black hole.
    pub fn to_point(
        manifold: &'m Manifold,
        u: DVec3,
        length: f64,
        (to, margin): (DVec3, f64),
    ) -> Self {
        let around = DVec3::splat(margin);
        let region = (to - around, to + around);
        Self::made((manifold, u), length, region, Some((to, to)))
    }

    fn made(
        (manifold, u): (&'m Manifold, DVec3),
        length: f64,
        region: Region,
        target: Option<Region>,
    ) -> Self {
        let mut fan = Self {
            target: target.map(|target| widened(manifold, target)),
            manifold,
            u,
            local: manifold.local_frame(u),
            length,
            reach: length,
            region: widened(manifold, region),
            legs: Vec::new(),
            rays: Vec::new(),
            arc_lengths: Vec::new(),
            segments: Vec::new(),
            copies: Vec::new(),
            boxes: BoxTree::default(),
        };
        fan.choose_reach();
        let triangles = loop {
            fan.choose_arc_lengths();
            let triangles = fan.refine();
            if fan.has_knots_enough() {
                break triangles;
            }
            fan.go_farther();
        };
        let beams = fan.beams(&triangles);
        let (segments, boxes): (Vec<BeamSegment>, Vec<Vec<Region>>) = beams
            .par_iter()
            .flat_map_iter(|corners| fan.segments_of(*corners))
            .unzip();
        let numbered = (0..).zip(boxes);
        let numbered: Vec<(u32, Region)> = numbered
            .flat_map(|(number, boxes)| boxes.into_iter().map(move |region| (number, region)))
            .collect();
        fan.boxes = BoxTree::build(&numbered, |(_, region)| *region);
        fan.segments = segments;
        fan.copies = fan.copies_in_reach(target.map(|(to, _)| to));
        fan
    }

    /// Returns the beams between neighbouring rays, by the legs of three rays that bound each. Where a triangle's rays
    /// meet different borders, each leg bounds a beam with legs nearby that are made of it.
    fn beams(&mut self, triangles: &[[usize; 3]]) -> Vec<[usize; 3]> {
        let mut beams = Vec::new();
        // From which leg on each ray is parted from others, and the widest of the triangles.
        let mut parted: Vec<(usize, f64)> = vec![(usize::MAX, 0.0); self.rays.len()];
        for rays in triangles {
            let shared = self.shared(*rays);
            let starts = rays.map(|ray| self.rays[ray].start);
            beams.extend((0..shared).map(|n| starts.map(|start| start + n)));
            let [p, q, o] = rays.map(|ray| self.direction(ray));
            let width = (q - p).length().max((o - q).length()).max((p - o).length());
            for ray in rays {
                let (from, widest) = &mut parted[*ray];
                if shared < self.rays[*ray].len() {
                    (*from, *widest) = ((*from).min(shared), widest.max(width));
                }
            }
        }
        for (ray, (from, width)) in parted.into_iter().enumerate() {
            for leg in self.rays[ray].clone().skip(from) {
                if self.is_of_interest(&self.legs[leg], 2.0 * width) {
                    beams.push(self.surround(leg, width));
                }
            }
        }
        beams
    }

    /// Makes three legs around a leg, so that all directions within `angle` of it are between them.
    fn surround(&mut self, leg: usize, angle: f64) -> [usize; 3] {
        let (sin, cos) = (std::f64::consts::TAU / 3.0).sin_cos();
        [(1.0, 0.0), (cos, sin), (cos, -sin)].map(|(x, y)| {
            let leg = &self.legs[leg];
            let [e1, e2] = perpendiculars(leg.direction);
            let turn = (e1 * x + e2 * y) * (2.0 * angle);
            self.legs.push(leg.beside(leg.direction + turn));
            self.legs.len() - 1
        })
    }

    /// Returns the legs of a ray.
    pub(super) fn legs_of(&self, ray: usize) -> &[RayLeg] {
        &self.legs[self.rays[ray].clone()]
    }

    /// Returns the direction of a ray.
    pub(super) fn direction(&self, ray: usize) -> DVec3 {
        self.legs[self.rays[ray].start].direction
    }

    /// Returns how many legs of three rays are behind the same borders.
    pub(super) fn shared(&self, rays: [usize; 3]) -> usize {
        let [p, q, o] = rays.map(|ray| self.legs_of(ray));
        let all = p.iter().zip(q).zip(o);
        all.take_while(|((p, q), o)| p.borders == q.borders && p.borders == o.borders)
            .count()
    }

    /// Cuts the beam between three legs into segments; returns those that matter, with the boxes around them.
    fn segments_of(&self, corners: [usize; 3]) -> Vec<(BeamSegment, Vec<Region>)> {
        let legs = corners.map(|i| &self.legs[i]);
        let [first, end] = common(legs);
        let starts = (first.next_multiple_of(2)..end.saturating_sub(2)).step_by(2);
        let half = self.arc_lengths[1];
        let sound = starts.filter(|k| legs.iter().all(|leg| leg.cubic_miss(*k, half) <= BROKEN));
        let segments = sound.map(|k| {
            let segment = BeamSegment::new(self, corners, k);
            let mut boxes = Vec::with_capacity(1);
            segment.bounds(self, |bounds| {
                if meet(bounds, self.region) {
                    boxes.push(bounds);
                }
            });
            (segment, boxes)
        });
        segments.filter(|(_, boxes)| !boxes.is_empty()).collect()
    }

    /// Sets the reach to several times as far as rays in the directions of the coarsest mesh matter.
    fn choose_reach(&mut self) {
        self.arc_lengths = vec![0.0, self.length];
        let rays = self.trace(&icosahedron_corners());
        let legs = || rays.iter().flatten();
        let matter = legs()
            .map(|leg| self.matters_up_to(leg))
            .fold(0.0, f64::max);
        let end = legs().filter_map(|leg| leg.end).fold(0.0, f64::max);
        let farthest = if matter > 0.0 { matter } else { end };
        if farthest > 0.0 {
            self.reach = self.length.min(SPARE * farthest);
        }
    }

    /// Returns the arc length up to which a leg matters: as far as it is in the region; to its end where one point is asked for,
    /// to which light may come between rays that do not.
    fn matters_up_to(&self, leg: &RayLeg) -> f64 {
        match self.target {
            Some(_) => leg.end.unwrap_or(0.0),
            None => leg.inside,
        }
    }

    /// Tells whether there are knots as far as any ray matters.
    fn has_knots_enough(&self) -> bool {
        let far = |leg: &RayLeg| self.matters_up_to(leg) > self.reach;
        self.reach >= self.length || !self.legs.iter().any(far)
    }

    /// Begins anew with knots that reach farther.
    fn go_farther(&mut self) {
        self.reach = self.length.min(SPARE * self.reach);
        self.legs.clear();
        self.rays.clear();
    }

    /// Returns `count` equal intervals of the fan's reach, by their ends.
    fn even_arc_lengths(&self, count: usize) -> Vec<f64> {
        (0..=count)
            .map(|k| self.reach * k as f64 / count as f64)
            .collect()
    }

    /// Sets the fewest intervals on which cubics follow most rays.
    fn choose_arc_lengths(&mut self) {
        let directions = icosahedron_corners();
        let mut count = INTERVALS;
        loop {
            self.arc_lengths = self.even_arc_lengths(2 * count);
            let rays = self.trace(&directions);
            // Only what happens where connections are asked for counts.
            let coarse = |legs: &&Vec<RayLeg>| legs.iter().any(|leg| self.is_coarse(leg));
            let bad = rays.iter().filter(coarse).count();
            if 10 * bad <= directions.len() || 2 * count > MOST_INTERVALS {
                return;
            }
            count *= 2;
        }
    }

    /// Tells whether a cubic over an interval of the leg misses it.
    fn is_coarse(&self, leg: &RayLeg) -> bool {
        let Range { start, end } = leg.numbers();
        let starts = (start.next_multiple_of(2)..end.saturating_sub(3)).step_by(2);
        let mut inside = starts.filter(|k| holds(self.region, leg.knot(*k).u));
        inside.any(|k| leg.cubic_miss(k, self.arc_lengths[1]) > BEND)
    }

    /// Integrates the rays in `directions` and samples them at the knots.
    pub(super) fn trace(&self, directions: &[DVec3]) -> Vec<Vec<RayLeg>> {
        let settings = Settings::bare(TOLERANCE).with_deviation().with_events();
        let block = |directions: &[DVec3]| -> Vec<Vec<RayLeg>> {
            let space = (self.manifold, &self.arc_lengths[..], self.region);
            let mut sampler = KnotSampler::new(space, (self.u, &self.local), directions);
            let rays = directions
                .iter()
                .map(|d| Ray::seen_by(&self.local, self.u, *d, self.length));
            follow(self.manifold, settings, rays, &mut sampler);
            sampler.into_legs()
        };
        directions.par_chunks(BLOCK).flat_map(block).collect()
    }

    /// Guesses all geodesics to each of the chart `points`: the number of the point, the image of it
    /// that the guess is for (in glued coordinates, a point whole periods away), and the guess.
    pub(super) fn guesses(
        &self,
        points: impl Iterator<Item = DVec3>,
    ) -> Vec<(usize, DVec3, Guess)> {
        // Buffers of the segments around a point, with its place in each, and of their guesses.
        let (mut around, mut places, mut known) = (Vec::new(), Vec::new(), Vec::new());
        let mut guesses = Vec::new();
        // For each segment the last question for which it was found: it may have several boxes.
        let mut found = vec![0_u32; self.segments.len()];
        let mut question = 0;
        for (index, x) in points.enumerate() {
            for image in self.images(x) {
                around.clear();
                question += 1;
                self.boxes.visit(image, image, |(number, region)| {
                    let last = &mut found[*number as usize];
                    if *last != question && holds(*region, image) {
                        *last = question;
                        around.push(*number);
                    }
                });
                let segment = |i: u32| &self.segments[i as usize];
                let place = |i: &u32| Some((segment(*i), segment(*i).locate(image)?));
                places.clear();
                places.extend(around.iter().filter_map(place));
                // The segment that holds the point comes first: what it finds spares the search in
                // its neighbours.
                let outside = |(segment, at): &(&BeamSegment, DVec3)| segment.outside_by(*at);
                places.sort_by(|a, b| outside(a).total_cmp(&outside(b)));
                known.clear();
                for (segment, at) in &places {
                    segment.guesses(self, image, *at, &mut known);
                }
                guesses.extend(known.iter().map(|guess| (index, image, *guess)));
            }
        }
        guesses
    }

    /// Makes the transformations to the copies of a glued domain that light may reach, where connections are asked for to
    /// all points of the domain or to one.
    fn copies_in_reach(&self, to: Option<DVec3>) -> Vec<DeckTransformation> {
        let Some(gluing) = self.manifold.gluing_below() else {
            return Vec::new();
        };
        // Paths that go on elsewhere stay in the domain.
        if self.manifold.gluing().is_some() {
            return vec![gluing.identity()];
        }
        // A box around the images of the domain's outline: far from the chart's middle copies are not of the form that
        // they have to first order.
        let to = to.and_then(|to| gluing.locate(to)).map(|(to, _)| to);
        let outline: Vec<DVec3> = gluing.outline().iter().copied().chain(to).collect();
        // Large ones first: near an ideal boundary there is no end of small ones.
        let rank = |deck: &DeckTransformation, place: DVec3| {
            let images = outline.iter().map(|u| deck.point(*u));
            let images: Vec<DVec3> = images.chain([place]).collect();
            self.volume_within_reach(&images)
        };
        gluing.copies(rank, self.most_copies())
    }

    fn most_copies(&self) -> usize {
        match self.target {
            Some(_) => POINT_COPIES,
            None => MOST_COPIES,
        }
    }

    /// Returns the volume of the box around a copy of the domain in which points of the outline lie so; `None` if it can hold
    /// nothing of a segment.
    fn volume_within_reach(&self, outline: &[DVec3]) -> Option<f64> {
        let (low, high) = outline
            .iter()
            .fold((outline[0], outline[0]), |(a, b), u| (a.min(*u), b.max(*u)));
        let size = (high - low).max_element();
        // Where the chart's infinity is in the copy, it is everywhere.
        if !size.is_finite() {
            return Some(f64::INFINITY);
        }
        let margin = DVec3::splat(COPY_MARGIN * size);
        // Boxes reach far beyond beams. A copy that is small beside a segment is nearer to its outline than what the segment
        // takes for its own.
        let reached = self
            .boxes
            .any(low - margin, high + margin, |(number, region)| {
                let is_small = size < SMALL * (region.1 - region.0).max_element();
                let segment = &self.segments[*number as usize];
                !is_small || outline.iter().any(|u| segment.locate(*u).is_some())
            });
        reached.then_some((high - low).element_product())
    }

    /// Tells whether all copies of a glued domain that the light may reach are looked into, which are only so many.
    pub fn reaches_all_copies(&self) -> bool {
        self.copies.len() < self.most_copies()
    }

    /// Returns the points whole periods from `x` within reach of the fan, `x` included, or its images in the copies
    /// of a glued domain.
    fn images(&self, x: DVec3) -> Vec<DVec3> {
        if let Some(gluing) = self.manifold.gluing_below() {
            let x = gluing.locate(x).map_or(x, |(x, _)| x);
            return self.copies.iter().map(|deck| deck.point(x)).collect();
        }
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

/// Adds half the region's size around it, and makes it endless along glued coordinates and where faces bring points
/// into the domain.
fn widened(manifold: &Manifold, (low, high): Region) -> Region {
    let margin = 0.5 * (high - low).max_element();
    let mut wide = (low - margin, high + margin);
    let brings_in = manifold.gluing_below().is_some_and(|gluing| {
        let bounds = |face: &GluedFace| !face.is_portal() && !face.is_mirror();
        gluing.faces().iter().any(bounds)
    });
    let repeats = |k: &usize| brings_in || manifold.domain.period(*k).is_some();
    for k in (0..3).filter(repeats) {
        (wide.0[k], wide.1[k]) = (f64::NEG_INFINITY, f64::INFINITY);
    }
    wide
}
