//! The part of a tile's tube that may meet the scene, as chords.
//!
//! In: a sheaf and the pieces whose boxes meet leaves of the scene's tree ([`Touched`]). Out: a
//! [`Ribbon`]: each such piece flattened into as many chords as keep it within a tolerance of the
//! cubic, those whose own boxes miss everything left out, and for each of the others the few
//! subtrees that it can meet. Glued coordinates: a chord is tried in every period in which the
//! scene's box is.

use super::{
    cubics::Cubics,
    intersect::{is_glued, shifts},
    lanes::{LANES, SinglePoints, more},
    packet::Bicubic,
    sheaf::{Offsets, PathPatch, TUBE_MARGIN, Tube, Vertex, widened},
    strands::PathView,
    tracer::GridTracer,
    world::World,
};
use geofan_expr::vectorised;
use glam::{DVec3, Vec3};
use std::ops::Range;

/// Chords of sixteen paths, in order of arc length.
#[derive(Debug, Clone, Default)]
pub struct Ribbon {
    /// Ends of chords.
    pub vertices: Vec<Vertex>,
    /// The chords.
    pub chords: Chords,
}

/// Chords of a ribbon, and what each can meet.
#[derive(Debug, Clone, Default)]
pub struct Chords {
    list: Vec<RibbonChord>,
    roots: Vec<u32>,
}

/// A chord of all paths.
#[derive(Debug, Clone)]
pub struct RibbonChord {
    /// The vertex where it begins; it ends at the next.
    pub from: usize,
    /// By how much glued coordinates are shifted to reach the scene.
    pub shift: DVec3,
    roots: Range<usize>,
}

impl Chords {
    /// The chords, in order.
    #[inline(always)]
    pub fn iter(&self) -> impl Iterator<Item = &RibbonChord> {
        self.list.iter()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// The roots of the subtrees that `chord` may meet.
    #[inline(always)]
    pub fn roots(&self, chord: &RibbonChord) -> &[u32] {
        &self.roots[chord.roots.clone()]
    }

    fn clear(&mut self) {
        self.list.clear();
        self.roots.clear();
    }

    /// The chord from vertex `from`, in the box from `low` to `high`, if it meets anything when moved by
    /// `shift`: below `those` roots, if it is a part of the chord to which they belong.
    fn add(
        &mut self,
        world: &World,
        from: usize,
        ((low, high), shift): ((DVec3, DVec3), DVec3),
        those: Option<&[u32]>,
    ) {
        let around = widened((low + shift, high + shift), TUBE_MARGIN);
        let first = self.roots.len();
        if world.accelerator.roots(around, those, &mut self.roots) {
            self.list.push(RibbonChord {
                from,
                shift,
                roots: first..self.roots.len(),
            });
        }
    }
}

/// Most chords of one piece: pieces are short already, so more means a broken curve.
const MOST_CHORDS: f64 = 64.0;

/// Pieces of one path or of several side by side that may meet the scene.
#[derive(Debug, Clone, Default)]
pub struct Touched {
    /// Their numbers, ascending.
    pub pieces: Vec<usize>,
    tube: Tube,
}

impl Touched {
    /// The pieces between the first `last` knots of `strands` whose boxes, widened by `margin` and
    /// `slack` (see [`Tube::surround`]), meet a leaf of the scene's tree.
    pub fn find(
        &mut self,
        strands: &[PathView<'_>],
        last: usize,
        world: &World,
        margin: f64,
        slack: f64,
    ) {
        self.pieces.clear();
        if world.faces.is_empty() {
            return;
        }
        vectorised(
            #[inline(always)]
            || {
                self.tube.surround(strands, last, margin, slack);
                for first in (0..self.tube.pieces()).step_by(LANES) {
                    let met = met(world, &self.tube.sixteen(first));
                    let count = LANES.min(self.tube.pieces() - first);
                    let pieces = (0..count).filter(|l| met[*l]);
                    self.pieces.extend(pieces.map(|l| first + l));
                }
            },
        );
    }

    /// For each of the pieces which of the `strands` touch it, without a margin.
    pub fn by_strand(
        &self,
        strands: &[PathView<'_>; LANES],
        world: &World,
        slack: f64,
    ) -> Vec<[bool; LANES]> {
        let touches = |k: &usize| {
            vectorised(
                #[inline(always)]
                || met(world, &boxes(strands, *k, slack)),
            )
        };
        self.pieces.iter().map(touches).collect()
    }
}

/// Corners of the boxes around piece `k` of the `strands`, widened by the angle `slack`.
#[inline(always)]
fn boxes(strands: &[PathView<'_>; LANES], k: usize, slack: f64) -> (SinglePoints, SinglePoints) {
    let [from, to] = [strands[0].knots[k], strands[0].knots[k + 1]];
    let (mut low, mut high) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
    let mut longest = [0.0; LANES];
    for c in 0..3 {
        for l in 0..LANES {
            (low[c][l], high[c][l]) = (strands[l].side(c)[k], strands[l].side(3 + c)[k]);
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
    (low, high)
}

/// Which of sixteen boxes meet a leaf of the scene's tree, in any period; those inside out meet none.
#[inline(always)]
fn met(world: &World, (low, high): &(SinglePoints, SinglePoints)) -> [bool; LANES] {
    let (accelerator, domain) = (&world.accelerator, &world.manifold.domain);
    if !is_glued(domain) {
        return accelerator.touched(low, high);
    }
    let corner = |of: &SinglePoints, l: usize| Vec3::new(of[0][l], of[1][l], of[2][l]).as_dvec3();
    std::array::from_fn(|l| {
        let (low, high) = (corner(low, l), corner(high, l));
        // One inside out is none.
        let periods = match low.x <= high.x {
            true => shifts(accelerator, domain, low, high),
            false => Vec::new(),
        };
        let touches = |shift: &DVec3| accelerator.touches(low + *shift, high + *shift);
        periods.iter().any(touches)
    })
}

impl Ribbon {
    /// The chords of the `pieces` of `sheaf` that may meet something, within `tolerance` radians of
    /// the paths of `tracer`; replaces what was here.
    pub fn flatten(
        &mut self,
        sheaf: &PathPatch<'_>,
        (tracer, world): (&dyn GridTracer, &World),
        pieces: &[usize],
        tolerance: f64,
    ) {
        self.vertices.clear();
        self.chords.clear();
        let mut s = Vec::new();
        let mut begins = Vec::new();
        let (strands, slack) = (sheaf.all(), tracer.slack());
        let mut show = |[from, to]: [f64; 2]| {
            if s.last() != Some(&from) {
                begins.push(s.len());
                s.push(from);
            }
            s.push(to);
        };
        for &k in pieces {
            vectorised(
                #[inline(always)]
                || cut(&Cubics::new(strands, k), tolerance, slack, world, &mut show),
            );
        }
        sheaf.vertices(tracer, &s, &mut self.vertices);
        for from in 0..s.len().saturating_sub(1) {
            if !begins.contains(&(from + 1)) {
                self.add_chord(world, from);
            }
        }
    }

    /// The chord from the vertex numbered `from`, in every period in which it may meet something.
    fn add_chord(&mut self, world: &World, from: usize) {
        let [a, b] = [from, from + 1].map(|v| self.vertices[v].point.bounds());
        let (low, high) = around(a, b);
        let domain = &world.manifold.domain;
        match is_glued(domain) {
            false => self
                .chords
                .add(world, from, ((low, high), DVec3::ZERO), None),
            true => {
                let (least, most) = widened((low, high), TUBE_MARGIN);
                for shift in shifts(&world.accelerator, domain, least, most) {
                    self.chords.add(world, from, ((low, high), shift), None);
                }
            }
        }
    }

    /// Those of its chords that a part of the tile may meet something with, where `mixing` gives 4 × 4
    /// paths over that part.
    pub fn within(&self, world: &World, mixing: &Bicubic) -> Chords {
        let mut chords = Chords::default();
        let mut before: Option<(usize, (DVec3, DVec3))> = None;
        for chord in self.chords.iter() {
            let bounds = |vertex: usize| {
                vectorised(
                    #[inline(always)]
                    || mixing.mix_spread(self.point(vertex)).bounds(),
                )
            };
            let start = match before {
                Some((vertex, bounds)) if vertex == chord.from => bounds,
                _ => bounds(chord.from),
            };
            let end = bounds(chord.from + 1);
            let those = Some(self.chords.roots(chord));
            chords.add(world, chord.from, (around(start, end), chord.shift), those);
            before = Some((chord.from + 1, end));
        }
        chords
    }

    /// The points of the vertex numbered `v`.
    #[inline(always)]
    pub fn point(&self, v: usize) -> &Offsets {
        &self.vertices[v].point
    }
}

/// The box around two boxes.
fn around(a: (DVec3, DVec3), b: (DVec3, DVec3)) -> (DVec3, DVec3) {
    (a.0.min(b.0), a.1.max(b.1))
}

/// Cuts a piece into chords that keep within `tolerance` radians of it, and shows the arc lengths of
/// the ends of those that may meet something, in order. The cubics, which may be off by the angle
/// `slack`, tell: most chords meet nothing, and then their ends need not be known better.
#[inline(always)]
fn cut(cubics: &Cubics, tolerance: f64, slack: f64, world: &World, mut show: impl FnMut([f64; 2])) {
    let [from, to] = cubics.s;
    let count = chords(cubics.bend(), tolerance * to);
    let margin = DVec3::splat(SLACKS * slack * to * cubics.most_speed());
    let along = |j: usize| match j == count {
        true => to,
        false => from + (to - from) * j as f64 / count as f64,
    };
    let mut start = cubics.bounds(0.0);
    for first in (0..count).step_by(LANES) {
        let chords = LANES.min(count - first);
        let mut boxes = ([[f32::INFINITY; LANES]; 3], [[f32::NEG_INFINITY; LANES]; 3]);
        for l in 0..chords {
            let end = cubics.bounds((first + l + 1) as f64 / count as f64);
            let (low, high) = widened(around(start, end), TUBE_MARGIN);
            let (low, high) = rounded_outwards((low - margin, high + margin));
            for c in 0..3 {
                (boxes.0[c][l], boxes.1[c][l]) = (low[c], high[c]);
            }
            start = end;
        }
        let met = met(world, &boxes);
        for j in (0..chords).filter(|l| met[*l]).map(|l| first + l) {
            show([along(j), along(j + 1)]);
        }
    }
}

/// A box in single precision around one in double.
#[inline(always)]
fn rounded_outwards((low, high): (DVec3, DVec3)) -> (Vec3, Vec3) {
    let rounding = f64::from(f32::EPSILON);
    let (low, high) = (low - low.abs() * rounding, high + high.abs() * rounding);
    (low.as_vec3(), high.as_vec3())
}

/// By how many times its slack a cubic is trusted to miss the path at most: some miss it by more than
/// once.
const SLACKS: f64 = 2.0;

/// How many chords keep within `allowed` of a piece: the distance falls with the square of their
/// number.
fn chords(sagitta: f64, allowed: f64) -> usize {
    let count = (sagitta / allowed).sqrt().ceil();
    // One where that is not known.
    MOST_CHORDS.min(count).max(1.0) as usize
}
