//! The part of a tile's paths that may meet the scene, as chords.
//!
//! In: a patch of sixteen paths. First come the pieces whose boxes meet leaves of the scene's tree
//! ([`Candidates`]). Out: those pieces flattened into as many chords as keep them within a tolerance of
//! the cubics ([`ChordList`]). Chords whose own boxes miss everything are left out; each of the others
//! names the few subtrees that it can meet. Glued coordinates: a chord is tried in every period in which
//! the scene's box is.

use super::{
    copies::{CopySearch, SceneCopies},
    curve::CubicPacket,
    intersect::{MOST_CHORDS, is_glued, shifts},
    lanes::{BoxPacket, LANES, Mask, SingleLanes, SingleVectors, less, more, single_lane},
    path_batch::{PathView, ROWS, pieces_row},
    path_patch::{Bicubic, PathPatch, Vertex},
    tracer::GridTracer,
    world::World,
};
use geofan_expr::vectorised;
use glam::{DVec3, Vec3};
use std::ops::Range;

/// Margin of a box around sixteen paths, as a share of its longest side, for what the bicubic between them
/// adds. Chosen, not measured: a box too narrow loses hits at a tile's edge, one too wide only costs time.
/// The weights of the cubic through four points sum to at most 1.63 in magnitude, so a tube as wide as its
/// box is long could leave it; tubes are usually long and thin.
pub const TUBE_MARGIN: f64 = 0.15;

/// Pieces, of one path or of several side by side, that may meet the scene.
#[derive(Debug, Clone, Default)]
pub struct Candidates {
    /// Their numbers, ascending.
    pub pieces: Vec<usize>,
    /// Set if the box of one of them is so wide that not all copies of the scene in it are looked at.
    pub wide: bool,
    /// Boxes around all pieces: the least x, y and z of each, then the largest; whole vectors.
    sides: [Vec<f32>; ROWS],
    /// The margin by which each box is widened.
    margin: Vec<f32>,
}

impl Candidates {
    /// Finds the pieces between the first `last` knots of `paths` whose boxes, widened by `margin` of their
    /// longest side and by the angle `slack`, meet a leaf of the scene's tree.
    pub fn find(
        &mut self,
        paths: &[PathView<'_>],
        last: usize,
        world: &World,
        margin: f64,
        slack: f64,
    ) {
        self.pieces.clear();
        self.wide = false;
        if world.faces.is_empty() {
            return;
        }
        vectorised(
            #[inline(always)]
            || {
                self.surround(paths, last, margin, slack);
                let count = last.saturating_sub(1);
                let mut meeting = MeetingTest::new(world);
                for first in (0..count).step_by(LANES) {
                    let lanes = LANES.min(count - first);
                    let boxes = self.boxes(first);
                    let met = meeting.met(&boxes, lanes);
                    for l in (0..lanes).filter(|l| met[*l]) {
                        self.pieces.push(first + l);
                        self.wide = self.wide || meeting.is_wide(&boxes, l);
                    }
                }
            },
        );
    }

    /// Marks for each of the pieces the `paths` that touch a leaf there, without a margin.
    pub fn by_path(&self, paths: &[PathView<'_>; LANES], world: &World, slack: f64) -> Vec<Mask> {
        let mut meeting = MeetingTest::new(world);
        let touches = |k: &usize| {
            vectorised(
                #[inline(always)]
                || meeting.met(&boxes(paths, *k, slack), LANES),
            )
        };
        self.pieces.iter().map(touches).collect()
    }

    /// Puts boxes around the pieces of all `paths` together.
    #[inline(always)]
    fn surround(&mut self, paths: &[PathView<'_>], last: usize, margin: f64, slack: f64) {
        let width = pieces_row(last);
        for (c, side) in self.sides.iter_mut().enumerate() {
            side.clear();
            for first in (0..width).step_by(LANES) {
                side.extend_from_slice(&match c < 3 {
                    true => merged(paths, c, first, less),
                    false => merged(paths, c, first, more),
                });
            }
        }
        self.widen(&paths[0].knots[..last], margin, slack);
    }

    /// Widens the boxes by `margin` of their longest side and by the angle `slack`: a piece is about as long
    /// as its box in the chart.
    #[inline(always)]
    fn widen(&mut self, knots: &[f64], margin: f64, slack: f64) {
        let width = self.sides[0].len();
        self.margin.clear();
        self.margin.resize(width, 0.0);
        // The longest sides.
        let (lows, highs) = self.sides.split_at_mut(3);
        for (low, high) in lows.iter().zip(&*highs) {
            let (low, high) = (&low[..width], &high[..width]);
            for (k, widest) in self.margin.iter_mut().enumerate() {
                *widest = more(high[k] - low[k], *widest);
            }
        }
        // The shares of them.
        for (widest, pair) in self.margin.iter_mut().zip(knots.windows(2)) {
            *widest *= (margin + slack * pair[1] / (pair[1] - pair[0])) as f32;
        }
        for (low, high) in lows.iter_mut().zip(highs) {
            for (k, margin) in self.margin.iter().enumerate() {
                low[k] -= margin;
                high[k] += margin;
            }
        }
    }

    /// Returns the boxes of sixteen pieces from `first` on, a multiple of sixteen; behind the last piece they
    /// are meaningless.
    #[inline(always)]
    fn boxes(&self, first: usize) -> BoxPacket {
        let corners = |sides: &[Vec<f32>]| -> SingleVectors {
            let mut corners = [[0.0; LANES]; 3];
            for (to, side) in corners.iter_mut().zip(sides) {
                to.copy_from_slice(&side[first..first + LANES]);
            }
            corners
        };
        BoxPacket {
            low: corners(&self.sides[..3]),
            high: corners(&self.sides[3..]),
        }
    }
}

/// Merges side `c` of the boxes of all `paths` around the sixteen pieces from `first` on: of two numbers the
/// `better` one.
#[inline(always)]
fn merged(
    paths: &[PathView<'_>],
    c: usize,
    first: usize,
    better: impl Fn(f32, f32) -> f32,
) -> SingleLanes {
    let block = |path: &PathView<'_>| -> SingleLanes {
        let mut block = [0.0; LANES];
        block.copy_from_slice(&path.side(c)[first..first + LANES]);
        block
    };
    let mut best = block(&paths[0]);
    for path in &paths[1..] {
        let other = block(path);
        for l in 0..LANES {
            best[l] = better(best[l], other[l]);
        }
    }
    best
}

/// Returns the box around piece `k` of each of the `paths`, widened by the angle `slack`.
#[inline(always)]
fn boxes(paths: &[PathView<'_>; LANES], k: usize, slack: f64) -> BoxPacket {
    let [from, to] = [paths[0].knots[k], paths[0].knots[k + 1]];
    let (mut low, mut high) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
    let mut longest = [0.0; LANES];
    for c in 0..3 {
        for l in 0..LANES {
            (low[c][l], high[c][l]) = (paths[l].side(c)[k], paths[l].side(3 + c)[k]);
        }
        for l in 0..LANES {
            longest[l] = more(high[c][l] - low[c][l], longest[l]);
        }
    }
    let share = (slack * to / (to - from)) as f32;
    for c in 0..3 {
        for l in 0..LANES {
            low[c][l] -= share * longest[l];
            high[c][l] += share * longest[l];
        }
    }
    BoxPacket { low, high }
}

/// Tells which boxes along paths meet a leaf of the scene's tree, in any period or copy of a glued domain.
struct MeetingTest<'w> {
    world: &'w World,
    search: Option<CopySearch<'w>>,
}

impl<'w> MeetingTest<'w> {
    fn new(world: &'w World) -> Self {
        let search = world.copies.as_ref().and_then(SceneCopies::search);
        Self { world, search }
    }

    /// Marks which of the first `lanes` of sixteen boxes do.
    #[inline(always)]
    fn met(&mut self, boxes: &BoxPacket, lanes: usize) -> Mask {
        let (accelerator, domain) = (&self.world.accelerator, &self.world.manifold.domain);
        if self.world.copies.is_some() {
            return self.met_by_copies(boxes, lanes);
        }
        if !is_glued(domain) {
            return accelerator.touched(boxes);
        }
        std::array::from_fn(|l| {
            let [low, high] = [&boxes.low, &boxes.high].map(|of| single_lane(of, l).as_dvec3());
            // A box that is inside out meets nothing.
            let periods = match low.x <= high.x {
                true => shifts(accelerator, domain, low, high),
                false => Vec::new(),
            };
            let touches = |shift: &DVec3| accelerator.touches(low + *shift, high + *shift);
            periods.iter().any(touches)
        })
    }

    /// Tells whether more copies of the scene may be in one of the boxes than are looked at.
    fn is_wide(&mut self, boxes: &BoxPacket, l: usize) -> bool {
        let [low, high] = [&boxes.low, &boxes.high].map(|of| single_lane(of, l).as_dvec3());
        let half = (high - low) * 0.5;
        let search = self.search.as_mut();
        search.is_some_and(|search| search.is_wide((low + half, half)))
    }

    fn met_by_copies(&mut self, boxes: &BoxPacket, lanes: usize) -> Mask {
        let (accelerator, search) = (&self.world.accelerator, &mut self.search);
        let maybe = match &self.world.copies {
            Some(copies) => copies.touched(boxes),
            None => [false; LANES],
        };
        std::array::from_fn(|l| {
            if !maybe[l] {
                return false;
            }
            let [low, high] = [&boxes.low, &boxes.high].map(|of| single_lane(of, l).as_dvec3());
            let half = (high - low) * 0.5;
            // A box that is inside out meets nothing.
            let search = search.as_mut().filter(|_| l < lanes && low.x <= high.x);
            let touches = |low, high| accelerator.touches(low, high);
            search.is_some_and(|search| search.may_meet((low + half, half), touches))
        })
    }
}

/// Chords of a patch's paths in order of arc length, and the subtrees that each can meet.
#[derive(Debug, Clone, Default)]
pub struct ChordList {
    chords: Vec<PatchChord>,
    roots: Vec<u32>,
}

/// A chord of all sixteen paths, between two [`Vertex`]es.
#[derive(Debug, Clone)]
pub struct PatchChord {
    /// The number of the vertex where it begins; it ends at the next.
    pub from: usize,
    /// The shift of glued coordinates that reaches the scene.
    pub shift: DVec3,
    roots: Range<usize>,
}

impl ChordList {
    /// Cuts the `pieces` of `patch` into chords within `tolerance` radians of the paths of `tracer`. Returns
    /// the ends of chords, and the chords that may meet something.
    pub fn flatten(
        patch: &PathPatch<'_>,
        (tracer, world): (&dyn GridTracer, &World),
        pieces: &[usize],
        tolerance: f64,
    ) -> (Vec<Vertex>, Self) {
        // The arc lengths of their ends, and the places among these where a new row of chords begins.
        let (mut s, mut begins) = (Vec::new(), Vec::new());
        let (paths, slack) = (patch.paths(), tracer.slack());
        let mut show = |[from, to]: [f64; 2]| {
            if s.last() != Some(&from) {
                begins.push(s.len());
                s.push(from);
            }
            s.push(to);
        };
        let mut meeting = MeetingTest::new(world);
        for &k in pieces {
            vectorised(
                #[inline(always)]
                || {
                    cut(
                        &CubicPacket::new(paths, k),
                        tolerance,
                        slack,
                        &mut meeting,
                        &mut show,
                    )
                },
            );
        }
        let mut vertices = Vec::new();
        patch.vertices(tracer, &s, &mut vertices);
        let mut list = Self::default();
        let whole = |from: &usize| !begins.contains(&(from + 1));
        let chords = (0..s.len().saturating_sub(1)).filter(whole);
        match world.copies.as_ref().and_then(SceneCopies::search) {
            None => chords.for_each(|from| list.add(world, from, &vertices)),
            Some(search) => {
                let mut images = VertexImages::new(search);
                chords.for_each(|from| list.add_copies(world, from, &mut images, &mut vertices));
            }
        }
        (vertices, list)
    }

    /// Adds the chord from the vertex numbered `from`, in every period in which it may meet something.
    fn add(&mut self, world: &World, from: usize, vertices: &[Vertex]) {
        let [a, b] = [from, from + 1].map(|v| vertices[v].point.bounds());
        let bounds = around(a, b);
        let domain = &world.manifold.domain;
        match is_glued(domain) {
            false => self.add_shifted(world, from, (bounds, DVec3::ZERO), None),
            true => {
                let (least, most) = widened(bounds, TUBE_MARGIN);
                for shift in shifts(&world.accelerator, domain, least, most) {
                    self.add_shifted(world, from, (bounds, shift), None);
                }
            }
        }
    }

    /// Adds the chord from the vertex numbered `from` in every copy of a glued domain in which it may meet
    /// something, with vertices of its own.
    fn add_copies(
        &mut self,
        world: &World,
        from: usize,
        images: &mut VertexImages<'_>,
        vertices: &mut Vec<Vertex>,
    ) {
        let [a, b] = [from, from + 1].map(|v| vertices[v].point.bounds());
        let (low, high) = widened(around(a, b), TUBE_MARGIN);
        let half = (high - low) * 0.5;
        let VertexImages {
            search,
            before,
            after,
            inside,
        } = images;
        search.around(low + half, half, |copy| {
            let (low, high) = copy.image_of_box(half);
            if !world.accelerator.touches(low, high) {
                return;
            }
            let place = copy.place_of(*inside);
            let known = before
                .iter()
                .find(|image| (image.of, image.place) == (from, place));
            let start = match known {
                Some(image) => vertices[image.number].clone(),
                None => copy.vertex(&vertices[from]),
            };
            let ends = [start, copy.vertex(&vertices[from + 1])];
            let bounds = ends.each_ref().map(|vertex| vertex.point.bounds());
            let (first, count) = (vertices.len(), self.chords.len());
            let bounds = (around(bounds[0], bounds[1]), DVec3::ZERO);
            self.add_shifted(world, first, bounds, None);
            if self.chords.len() > count {
                vertices.extend(ends);
                after.push(VertexImage {
                    of: from + 1,
                    place,
                    number: first + 1,
                });
            }
        });
        std::mem::swap(before, after);
        after.clear();
    }

    /// Adds the chord from vertex `from`, in the box from `low` to `high`, if it meets anything when moved by
    /// `shift`: below `those` roots, if it is a part of the chord to which they belong.
    fn add_shifted(
        &mut self,
        world: &World,
        from: usize,
        ((low, high), shift): ((DVec3, DVec3), DVec3),
        those: Option<&[u32]>,
    ) {
        let around = widened((low + shift, high + shift), TUBE_MARGIN);
        let first = self.roots.len();
        if world.accelerator.roots(around, those, &mut self.roots) {
            self.chords.push(PatchChord {
                from,
                shift,
                roots: first..self.roots.len(),
            });
        }
    }

    /// Returns the chords that a part of the tile may meet something with, where `mixing` gives 4 × 4 paths
    /// over that part.
    pub fn within(&self, world: &World, vertices: &[Vertex], mixing: &Bicubic) -> Self {
        let mut list = Self::default();
        let mut before: Option<(usize, (DVec3, DVec3))> = None;
        for chord in &self.chords {
            let bounds = |vertex: usize| {
                vectorised(
                    #[inline(always)]
                    || mixing.mix_offsets(&vertices[vertex].point).bounds(),
                )
            };
            let start = match before {
                Some((vertex, bounds)) if vertex == chord.from => bounds,
                _ => bounds(chord.from),
            };
            let end = bounds(chord.from + 1);
            let those = Some(self.roots(chord));
            list.add_shifted(world, chord.from, (around(start, end), chord.shift), those);
            before = Some((chord.from + 1, end));
        }
        list
    }

    /// Iterates over the chords, in order.
    #[inline(always)]
    pub fn iter(&self) -> impl Iterator<Item = &PatchChord> {
        self.chords.iter()
    }

    /// Tells whether there are none.
    pub fn is_empty(&self) -> bool {
        self.chords.is_empty()
    }

    /// Returns the roots of the subtrees that `chord` may meet.
    #[inline(always)]
    pub fn roots(&self, chord: &PatchChord) -> &[u32] {
        &self.roots[chord.roots.clone()]
    }
}

/// Carries the vertices of chords into copies of a scene, each only once.
struct VertexImages<'w> {
    search: CopySearch<'w>,
    /// The ends of the images of the last chord, and of the present one.
    before: Vec<VertexImage>,
    after: Vec<VertexImage>,
    /// A point of the domain.
    inside: DVec3,
}

/// The image of a vertex.
struct VertexImage {
    of: usize,
    /// Where its transformation takes the point of the domain.
    place: DVec3,
    number: usize,
}

impl<'w> VertexImages<'w> {
    fn new(search: CopySearch<'w>) -> Self {
        Self {
            inside: search.inside(),
            search,
            before: Vec::new(),
            after: Vec::new(),
        }
    }
}

/// Returns the box around two boxes.
fn around(a: (DVec3, DVec3), b: (DVec3, DVec3)) -> (DVec3, DVec3) {
    (a.0.min(b.0), a.1.max(b.1))
}

/// Returns the box widened by `margin` of its longest side.
fn widened((low, high): (DVec3, DVec3), margin: f64) -> (DVec3, DVec3) {
    let margin = DVec3::splat(margin * (high - low).max_element());
    (low - margin, high + margin)
}

/// Cuts a piece into chords that keep within `tolerance` radians of it, and shows the arc lengths of the
/// ends of those that may meet something, in order. The cubics, which may be off by the angle `slack`,
/// decide: most chords meet nothing, and then their ends need not be known better.
#[inline(always)]
fn cut(
    cubics: &CubicPacket,
    tolerance: f64,
    slack: f64,
    meeting: &mut MeetingTest<'_>,
    mut show: impl FnMut([f64; 2]),
) {
    let [from, to] = cubics.s;
    let count = chords(cubics.bend(), tolerance * to);
    let margin = DVec3::splat(SLACKS * slack * to * cubics.most_speed());
    let along = |j: usize| match j == count {
        true => to,
        false => from + (to - from) * j as f64 / count as f64,
    };
    let mut start = cubics.bounds(0.0);
    for first in (0..count).step_by(LANES) {
        // The boxes of sixteen chords, those behind the last inside out.
        let chords = LANES.min(count - first);
        let mut boxes = BoxPacket {
            low: [[f32::INFINITY; LANES]; 3],
            high: [[f32::NEG_INFINITY; LANES]; 3],
        };
        for l in 0..chords {
            let end = cubics.bounds((first + l + 1) as f64 / count as f64);
            let (low, high) = widened(around(start, end), TUBE_MARGIN);
            let (low, high) = rounded_outwards((low - margin, high + margin));
            for c in 0..3 {
                (boxes.low[c][l], boxes.high[c][l]) = (low[c], high[c]);
            }
            start = end;
        }
        let met = meeting.met(&boxes, chords);
        for j in (0..chords).filter(|l| met[*l]).map(|l| first + l) {
            show([along(j), along(j + 1)]);
        }
    }
}

/// Returns a box in single precision around one in double.
#[inline(always)]
fn rounded_outwards((low, high): (DVec3, DVec3)) -> (Vec3, Vec3) {
    let rounding = f64::from(f32::EPSILON);
    let (low, high) = (low - low.abs() * rounding, high + high.abs() * rounding);
    (low.as_vec3(), high.as_vec3())
}

/// The multiple of its slack by which a cubic is trusted to miss the path at most: some miss it by more
/// than once the slack.
const SLACKS: f64 = 2.0;

/// Returns how many chords keep within `allowed` of a piece: the distance falls with the square of their
/// number.
fn chords(sagitta: f64, allowed: f64) -> usize {
    let count = (sagitta / allowed).sqrt().ceil();
    // One where that is not known.
    MOST_CHORDS.min(count).max(1.0) as usize
}
