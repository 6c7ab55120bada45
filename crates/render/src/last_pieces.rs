//! The pieces in which the paths of a tile end, through whatever exit.
//!
//! In: a sheaf and those pieces. Out: how each of sixteen samples ends ([`LastPieces::endings`]): its
//! path comes from the sheaf's like every other point of it, so that an edge between two skies, or
//! between a sky and paths that end nowhere, runs through the tile where it should.

use super::{
    curve::Ending,
    endings::EventLocator,
    lanes::LANES,
    packet::Bicubic,
    sheaf::{PathPatch, Vertex},
    tracer::GridTracer,
};
use std::ops::Range;

/// Intervals into which each piece is divided. Between two points the path is a cubic, whose error
/// falls with the fourth power of their distance: that between knots, some mrad, falls to a few
/// millionths.
const PER_PIECE: usize = 8;

/// Where paths of a tile end.
pub struct LastPieces {
    vertices: Vec<Vertex>,
    pieces: usize,
}

impl LastPieces {
    /// The paths of `sheaf` in `pieces`.
    pub fn new(sheaf: &PathPatch<'_>, tracer: &dyn GridTracer, pieces: &Range<usize>) -> Self {
        let knots = sheaf.knots();
        let mut s = vec![knots[pieces.start]];
        for k in pieces.clone() {
            let along = |j: usize| j as f64 / PER_PIECE as f64;
            s.extend((1..=PER_PIECE).map(|j| knots[k] + (knots[k + 1] - knots[k]) * along(j)));
        }
        let mut vertices = Vec::new();
        sheaf.vertices(tracer, &s, &mut vertices);
        let pieces = pieces.len();
        Self { vertices, pieces }
    }

    /// How the paths of sixteen samples end.
    #[inline(always)]
    pub fn endings(&self, mixing: &Bicubic, finder: &mut EventLocator<'_>) -> [Ending; LANES] {
        finder.endings_of_sixteen(
            (self.pieces, PER_PIECE),
            #[inline(always)]
            |i| {
                (
                    self.vertices[i].s,
                    mixing.mix_points(&self.vertices[i].point),
                )
            },
            #[inline(always)]
            |i| mixing.mix_points(&self.vertices[i].tangent),
        )
    }
}
