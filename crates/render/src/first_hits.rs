//! First hits of samples: of sixteen whose paths are interpolated, and of single paths.
//!
//! In: a patch of a tile's paths and its chords, how the paths of sixteen samples come from the patch's
//! ([`Bicubic`]); or the paths of a tracer one by one. Out: what each sample sees.

use super::{
    accel::PacketHits,
    chords::{Candidates, ChordList, PatchChord},
    curve::Ending,
    intersect::{CHORD_ERROR, Hit, HitSearch, Seen, beyond},
    lanes::{LANES, Lanes, Mask, SingleLanes, SingleVectors, each, range, single, single_lane},
    path_batch::{PathView, ROWS, knots_until},
    path_patch::{Bicubic, Offsets, PathPatch, Vertex},
    tracer::GridTracer,
    world::World,
};
use glam::DVec3;

/// Everything that the samples of a tile have in common.
pub struct InterpolatedPaths<'a> {
    world: &'a World,
    /// The ends of the tile's chords.
    vertices: &'a [Vertex],
    /// The exit of all.
    exit: Option<usize>,
    limits: Lanes,
    skies: Offsets,
}

/// The first hits of sixteen samples.
#[repr(C, align(64))]
struct FirstHits {
    /// Arc lengths of the hits; of the endings where there are none.
    s: Lanes,
    hit: Mask,
    triangle: [u32; LANES],
    weights: [SingleLanes; 2],
    tangent: SingleVectors,
}

impl<'a> InterpolatedPaths<'a> {
    /// Takes a patch, and the ends of its chords.
    pub fn new(world: &'a World, patch: &PathPatch<'_>, vertices: &'a [Vertex]) -> Self {
        Self {
            world,
            vertices,
            exit: patch.exit().flatten(),
            limits: patch.limits(),
            skies: Offsets::of(&patch.skies()),
        }
    }

    /// Shows what each of sixteen samples sees, where they may meet something on `chords` and all leave
    /// through the exit of the patch.
    #[inline(always)]
    pub fn see(&self, mixing: &Bicubic, chords: &ChordList, mut show: impl FnMut(usize, Seen)) {
        // An infinite limit times a weight is no number.
        let limits = match self.exit {
            Some(_) => mixing.mix(&self.limits),
            None => [f64::INFINITY; LANES],
        };
        let hits = self.first_hits(mixing, chords, &limits);
        let sky = directions(&mixing.mix_offsets(&self.skies));
        for l in 0..LANES {
            let seen = match (hits.hit[l], self.exit) {
                (true, _) => Seen::Surface(hits.hit(l)),
                (false, Some(exit)) => Seen::Sky {
                    exit: exit as u32,
                    s: hits.s[l] as f32,
                    direction: single_lane(&sky, l),
                },
                (false, None) => Seen::Length,
            };
            show(l, seen);
        }
    }

    /// Shows what each of sixteen samples sees whose paths end each in its own way.
    #[inline(always)]
    pub fn see_before(
        &self,
        mixing: &Bicubic,
        chords: &ChordList,
        endings: &[Ending; LANES],
        mut show: impl FnMut(usize, Seen),
    ) {
        let limits = each(|l| endings[l].limit());
        let hits = self.first_hits(mixing, chords, &limits);
        for l in 0..LANES {
            let seen = match hits.hit[l] {
                true => Seen::Surface(hits.hit(l)),
                false => beyond(&endings[l]),
            };
            show(l, seen);
        }
    }

    /// Holds the chords in order against the scene. The interpolated ends of a chord are often those of the
    /// next one too: each stays in the place that the parity of its number gives it.
    #[inline(always)]
    fn first_hits(&self, mixing: &Bicubic, chords: &ChordList, limits: &Lanes) -> FirstHits {
        let mut first = FirstHits {
            s: *limits,
            hit: [false; LANES],
            triangle: [0; LANES],
            weights: [[0.0; LANES]; 2],
            tangent: [[0.0; LANES]; 3],
        };
        let mut numbers: [Option<usize>; 2] = [None; 2];
        let mut points: [Offsets; 2] = Default::default();
        for chord in chords.iter() {
            // How far each lane still asks, as a fraction of the chord.
            let [from, to] = [chord.from, chord.from + 1];
            let (s, next) = (self.vertices[from].s, self.vertices[to].s);
            let share = 1.0 / (next - s);
            let most = single(|l| ((first.s[l] - s) * share).min(1.0) as f32);
            if !(range(&most)[1] >= 0.0) {
                break;
            }
            for vertex in [from, to] {
                if numbers[vertex % 2] != Some(vertex) {
                    points[vertex % 2] = mixing.mix_offsets(&self.vertices[vertex].point);
                    numbers[vertex % 2] = Some(vertex);
                }
            }
            let roots = chords.roots(chord);
            let accelerator = &self.world.accelerator;
            let ends = [&points[from % 2], &points[to % 2]];
            let chords = (ends, [s, next]);
            if let Some(hits) = accelerator.first_hits(roots, chords, chord.shift, &most) {
                self.keep(mixing, chord, &hits, &mut first);
            }
        }
        first
    }

    /// Takes over the hits of one chord, which are nearer than what was known.
    #[inline(always)]
    fn keep(&self, mixing: &Bicubic, chord: &PatchChord, hits: &PacketHits, first: &mut FirstHits) {
        // Arc length and triangle.
        let [from, to] = [chord.from, chord.from + 1].map(|v| &self.vertices[v]);
        let (s, length) = (from.s, to.s - from.s);
        for l in 0..LANES {
            let hit = hits.t[l] < f32::INFINITY;
            let at = s + f64::from(hits.t[l]) * length;
            first.hit[l] |= hit;
            first.s[l] = if hit { at } else { first.s[l] };
            first.triangle[l] = if hit {
                hits.triangle[l]
            } else {
                first.triangle[l]
            };
        }
        for k in 0..2 {
            put(&mut first.weights[k], &hits.weights[k], &hits.t);
        }
        // The tangent, linear along the chord.
        let start = mixing.mix_offsets(&from.tangent);
        let end = mixing.mix_offsets(&to.tangent);
        for c in 0..3 {
            let (a, b) = (start.middle[c] as f32, end.middle[c] as f32);
            let tangent = single(|l| {
                let (a, b) = (a + start.differences[c][l], b + end.differences[c][l]);
                a + hits.t[l] * (b - a)
            });
            put(&mut first.tangent[c], &tangent, &hits.t);
        }
    }
}

/// Puts the numbers of the lanes with a finite place `t` into `to`.
#[inline(always)]
fn put(to: &mut SingleLanes, from: &SingleLanes, t: &SingleLanes) {
    for l in 0..LANES {
        to[l] = if t[l] < f32::INFINITY { from[l] } else { to[l] };
    }
}

/// Makes sixteen vectors unit vectors; zero stays.
#[inline(always)]
fn directions(vectors: &Offsets) -> SingleVectors {
    let middle: DVec3 = vectors.middle;
    let mut to = vectors.differences;
    for c in 0..3 {
        let middle = middle[c] as f32;
        to[c] = single(|l| middle + vectors.differences[c][l]);
    }
    let length = single(|l| {
        let squared = to[0][l] * to[0][l] + to[1][l] * to[1][l] + to[2][l] * to[2][l];
        1.0 / squared.max(f32::MIN_POSITIVE).sqrt()
    });
    for c in 0..3 {
        for l in 0..LANES {
            to[c][l] *= length[l];
        }
    }
    to
}

impl FirstHits {
    /// Returns the hit in one lane.
    #[inline(always)]
    fn hit(&self, l: usize) -> Hit {
        let [b, c] = &self.weights;
        Hit {
            s: self.s[l] as f32,
            v: single_lane(&self.tangent, l),
            triangle: self.triangle[l],
            barycentric: [b[l], c[l]],
        }
    }
}

/// Returns how many cubics replace one piece whose cubic may be off by the angle `slack`: a cubic's error
/// falls with the fourth power of its length.
fn finer(slack: f64) -> usize {
    (slack / CHORD_ERROR).max(1.0).powf(0.25).ceil() as usize
}

/// Returns how many knots matter to a path: up to its end, or, if that is not known, as far as it is.
fn last_knot(path: &PathView<'_>) -> usize {
    match path.ending {
        Some(ending) => knots_until(path.knots, ending.limit()),
        None => path.known,
    }
}

/// Finds what single paths see.
///
/// The pieces of several paths close together whose boxes meet leaves of the scene's tree are looked at
/// for each path again: where its own box does, it is sampled, as finely as makes the cubics between the
/// samples as good as chords have to be, and those cubics are intersected in order.
#[derive(Debug, Clone, Default)]
pub struct SinglePaths {
    /// Pieces that any of the paths may meet something on, and for each of those the paths that may.
    together: Candidates,
    touching: Vec<Mask>,
    /// The pieces of one path.
    touched: Vec<usize>,
    lengths: Vec<f64>,
    /// The first ends of its cubics, among the lengths.
    cubics: Vec<usize>,
    rows: Vec<f64>,
}

/// Shares of the way to an edge at which a path is sampled, before and behind it.
const BESIDE_EDGE: [f64; 2] = [1.0 - 1e-9, 1.0 + 1e-9];

impl SinglePaths {
    /// Makes ready for `paths` of `tracer`, which are close together.
    pub fn surround(
        &mut self,
        paths: &[PathView<'_>; LANES],
        tracer: &dyn GridTracer,
        world: &World,
    ) {
        let lasts = paths.iter().map(last_knot);
        let last = lasts.max().unwrap_or(0);
        self.together.find(paths, last, world, 0.0, tracer.slack());
        self.touching = self.together.by_path(paths, world, tracer.slack());
    }

    /// Returns what the path in lane `l` sees in `world`; `None` where its ending is not known and it meets nothing as
    /// far as it is.
    pub fn seen(
        &mut self,
        (l, path): (usize, PathView<'_>),
        tracer: &dyn GridTracer,
        world: &World,
    ) -> Option<Seen> {
        let hit = match self.together.pieces.is_empty() {
            true => None,
            false => self.first_hit((l, path), tracer, world),
        };
        hit.map(Seen::Surface)
            .or_else(|| path.ending.as_ref().map(beyond))
    }

    /// Returns where the path in lane `l` first meets something.
    fn first_hit(
        &mut self,
        (l, path): (usize, PathView<'_>),
        tracer: &dyn GridTracer,
        world: &World,
    ) -> Option<Hit> {
        // Its own pieces, sampled.
        let limit = path.ending.map_or(f64::INFINITY, |ending| ending.limit());
        let last = last_knot(&path);
        let pieces = self.together.pieces.iter().zip(&self.touching);
        let own = pieces.filter(|(k, touching)| touching[l] && **k + 1 < last);
        self.touched.clear();
        self.touched.extend(own.map(|(k, _)| *k));
        self.sample(path, tracer);
        // The cubics between the samples.
        let closer = PathView {
            knots: &self.lengths,
            rows: &self.rows,
            boxes: &[],
            known: self.lengths.len(),
            ..path
        };
        let mut search = HitSearch::new(world);
        let mut cubics = self.cubics.iter();
        cubics.find_map(|i| search.first_hit(&closer.piece(*i), limit))
    }

    /// Samples the path at the ends of finer cubics along each piece that may be hit, and on both sides of each edge there.
    fn sample(&mut self, path: PathView<'_>, tracer: &dyn GridTracer) {
        let per_piece = finer(tracer.slack());
        self.lengths.clear();
        self.cubics.clear();
        let edges = match self.touched.is_empty() {
            true => Vec::new(),
            false => tracer.edges(path),
        };
        for &k in &self.touched {
            let [from, to] = [path.knots[k], path.knots[k + 1]];
            let along = |j: usize| from + (to - from) * j as f64 / per_piece as f64;
            let first = self.lengths.len();
            self.lengths.extend((0..=per_piece).map(along));
            let sides = edges
                .iter()
                .flat_map(|edge| BESIDE_EDGE.map(|share| share * edge));
            self.lengths.extend(sides.filter(|s| from < *s && *s < to));
            self.lengths[first..].sort_by(f64::total_cmp);
            self.cubics.extend(first..self.lengths.len() - 1);
        }
        self.rows.clear();
        self.rows.resize(ROWS * self.lengths.len(), 0.0);
        if !self.lengths.is_empty() {
            tracer.refine(path, &self.lengths, &mut self.rows);
        }
    }
}
