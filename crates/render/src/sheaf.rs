//! Sixteen paths that span a tile.
//!
//! In: strands. Out: their common exit, and a box around the tube that they span between each two
//! knots ([`Tube`]).

use super::{
    curve::Ending,
    lanes::{
        LANES, Lanes, Points, SingleLanes, SinglePoints, each, each_point, lane, less, more, range,
    },
    strands::{PathBatch, PathView, ROWS, knots_until, pieces_row},
    tracer::GridTracer,
};
use geofan_expr::vectorised;
use glam::DVec3;

/// Sixteen of many strands.
pub struct PathPatch<'a> {
    among: &'a PathBatch,
    strands: [PathView<'a>; LANES],
}

/// Points and tangents of sixteen paths at one arc length.
#[derive(Debug, Clone)]
pub struct Vertex {
    /// Arc length.
    pub s: f64,
    /// Chart points.
    pub point: Offsets,
    /// Tangents.
    pub tangent: Offsets,
}

/// Sixteen points by how they differ from one of them: single precision is enough for that, and half
/// as much work.
#[derive(Debug, Clone, Default)]
#[repr(C, align(64))]
pub struct Offsets {
    /// The differences, in each lane.
    pub differences: SinglePoints,
    /// The one.
    pub middle: DVec3,
}

impl Offsets {
    /// Of these points.
    #[inline(always)]
    pub fn of(points: &Points) -> Self {
        let middle = lane(points, LANES / 2);
        let mut differences = [[0.0; LANES]; 3];
        for c in 0..3 {
            for l in 0..LANES {
                differences[c][l] = (points[c][l] - middle[c]) as f32;
            }
        }
        Self {
            middle,
            differences,
        }
    }

    /// Corners of the box around the points.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        let [x, y, z] = self.differences.each_ref().map(range);
        let corner = |k: usize| DVec3::new(x[k].into(), y[k].into(), z[k].into());
        (self.middle + corner(0), self.middle + corner(1))
    }
}

/// Boxes around pieces of a tube.
#[derive(Debug, Clone, Default)]
pub struct Tube {
    /// The least x, y and z of each, then the largest; whole vectors.
    sides: [Vec<f32>; ROWS],
    /// By how much each is widened.
    margin: Vec<f32>,
    pieces: usize,
}

impl<'a> PathPatch<'a> {
    /// The strands with these numbers.
    pub fn new(among: &'a PathBatch, members: &[usize; LANES]) -> Self {
        Self {
            among,
            strands: std::array::from_fn(|lane| among.strand(members[lane])),
        }
    }

    /// All sixteen.
    #[inline(always)]
    pub fn all(&self) -> &[PathView<'a>; LANES] {
        &self.strands
    }

    /// The arc lengths of the knots.
    pub fn knots(&self) -> &'a [f64] {
        self.among.knots()
    }

    /// Any of the strands that these sixteen are of.
    pub fn among(&self, number: usize) -> PathView<'a> {
        self.among.strand(number)
    }

    /// The exit that all share (`Some(None)`: none ends through one); `None` if they differ or one is
    /// not known.
    pub fn exit(&self) -> Option<Option<usize>> {
        let [first, others @ ..] = &self.strands;
        let first = first.ending?.exit();
        let same = |strand: &PathView<'_>| strand.ending.is_some_and(|e| e.exit() == first);
        others.iter().all(same).then_some(first)
    }

    /// The arc lengths beyond which nothing counts.
    pub fn limits(&self) -> Lanes {
        each(|l| self.strands[l].ending.map_or(0.0, |e| e.limit()))
    }

    /// The directions of their skies; zero without one.
    pub fn skies(&self) -> Points {
        let mut skies = [[0.0; LANES]; 3];
        for l in 0..LANES {
            if let Some(Ending::Exit { sky, .. }) = self.strands[l].ending {
                for c in 0..3 {
                    skies[c][l] = sky[c];
                }
            }
        }
        skies
    }

    /// How many knots matter: up to the first at which all have ended.
    pub fn last(&self) -> usize {
        let limit = self.limits().into_iter().fold(0.0, f64::max);
        knots_until(self.knots(), limit)
    }

    /// Whether all paths are known at all knots that matter.
    pub fn is_known(&self) -> bool {
        let last = self.last();
        self.strands.iter().all(|strand| strand.known >= last)
    }

    /// All paths at the ascending arc lengths `s`, appended to `vertices`.
    pub fn vertices(&self, tracer: &dyn GridTracer, s: &[f64], vertices: &mut Vec<Vertex>) {
        let knots = self.knots();
        let numbers = s
            .iter()
            .map(|s| knots.binary_search_by(|knot| knot.total_cmp(s)).ok());
        let numbers: Vec<Option<usize>> = numbers.collect();
        let between = s
            .iter()
            .zip(&numbers)
            .filter(|(_, number)| number.is_none());
        let between: Vec<f64> = between.map(|(s, _)| *s).collect();
        let strands = &self.strands;
        let mut refined = tracer.refine_sixteen(strands, &between).into_iter();
        vertices.reserve(s.len());
        vectorised(
            #[inline(always)]
            || {
                for (&s, number) in s.iter().zip(&numbers) {
                    // At the knots paths are known as well as they can be.
                    let at = number.map(|k| {
                        [0, 3].map(|first| each_point(|c, l| strands[l].row(first + c)[k]))
                    });
                    let Some([point, tangent]) = at.or_else(|| refined.next()) else {
                        break;
                    };
                    vertices.push(Vertex {
                        s,
                        point: Offsets::of(&point),
                        tangent: Offsets::of(&tangent),
                    });
                }
            },
        );
    }
}

impl Tube {
    /// Boxes around the pieces between the first `last` knots of all `strands`, widened by `margin` of their
    /// longest side and by the angle `slack` (a piece is about as long as its box in the chart).
    #[inline(always)]
    pub fn surround(&mut self, strands: &[PathView<'_>], last: usize, margin: f64, slack: f64) {
        self.pieces = last.saturating_sub(1);
        let width = pieces_row(last);
        for (c, side) in self.sides.iter_mut().enumerate() {
            side.clear();
            for first in (0..width).step_by(LANES) {
                side.extend_from_slice(&match c < 3 {
                    true => merged(strands, c, first, less),
                    false => merged(strands, c, first, more),
                });
            }
        }
        self.widen(&strands[0].knots[..last], margin, slack);
    }

    #[inline(always)]
    fn widen(&mut self, knots: &[f64], margin: f64, slack: f64) {
        let width = self.sides[0].len();
        self.margin.clear();
        self.margin.resize(width, 0.0);
        let (lows, highs) = self.sides.split_at_mut(3);
        for (low, high) in lows.iter().zip(&*highs) {
            let (low, high) = (&low[..width], &high[..width]);
            for (k, widest) in self.margin.iter_mut().enumerate() {
                *widest = more(high[k] - low[k], *widest);
            }
        }
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

    /// How many pieces there are.
    #[inline(always)]
    pub fn pieces(&self) -> usize {
        self.pieces
    }

    /// Corners of the boxes of sixteen pieces from `first` on, a multiple of sixteen; behind the last they are
    /// of no piece.
    #[inline(always)]
    pub fn sixteen(&self, first: usize) -> (SinglePoints, SinglePoints) {
        let mut corners = [[[0.0; LANES]; 3]; 2];
        for (corner, sides) in corners.iter_mut().zip(self.sides.chunks_exact(3)) {
            for (to, side) in corner.iter_mut().zip(sides) {
                to.copy_from_slice(&side[first..first + LANES]);
            }
        }
        let [low, high] = corners;
        (low, high)
    }
}

/// What `better` leaves of side `c` of the boxes of all `strands` around the sixteen pieces from `first` on.
#[inline(always)]
fn merged(
    strands: &[PathView<'_>],
    c: usize,
    first: usize,
    better: impl Fn(f32, f32) -> f32,
) -> SingleLanes {
    let block = |strand: &PathView<'_>| -> SingleLanes {
        let mut block = [0.0; LANES];
        block.copy_from_slice(&strand.side(c)[first..first + LANES]);
        block
    };
    let mut best = block(&strands[0]);
    for strand in &strands[1..] {
        let other = block(strand);
        for l in 0..LANES {
            best[l] = better(best[l], other[l]);
        }
    }
    best
}

/// What a box around sixteen paths is widened by, as a share of its longest side, for what the
/// bicubic between them adds. Chosen, not measured: a box too narrow loses hits at a tile's edge, one
/// too wide only costs time. The weights of the cubic through four points sum to at most 1.63 in
/// magnitude, so a tube as wide as its box is long could leave it; tubes are usually long and thin.
pub const TUBE_MARGIN: f64 = 0.15;

/// The box widened by `margin` of its longest side.
pub fn widened((low, high): (DVec3, DVec3), margin: f64) -> (DVec3, DVec3) {
    let margin = DVec3::splat(margin * (high - low).max_element());
    (low - margin, high + margin)
}
