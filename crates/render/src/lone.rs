//! One path by itself: what it meets first.
//!
//! In: strands of a tracer close together. Out: what each sees. The pieces of all together whose boxes
//! meet leaves of the scene's tree are looked at for each strand again: where its own box does, it is
//! sampled, as finely as makes the cubics between the samples as good as chords have to be, and those
//! cubics are intersected in order.

use super::{
    curve::Ending,
    intersect::{CHORD_ERROR, first_hit},
    lanes::LANES,
    outcome::{Seen, beyond},
    ribbon::Touched,
    strands::{PathView, ROWS, knots_until},
    tracer::GridTracer,
    world::World,
};

/// How many cubics replace one piece whose cubic may be off by the angle `slack`: a cubic's error
/// falls with the fourth power of its length.
fn finer(slack: f64) -> usize {
    (slack / CHORD_ERROR).max(1.0).powf(0.25).ceil() as usize
}

/// Finds what single paths see.
#[derive(Debug, Clone, Default)]
pub struct SinglePaths {
    /// What all together touch, and which of them touch each of those pieces.
    together: Touched,
    touching: Vec<[bool; LANES]>,
    /// The pieces that one touches.
    touched: Vec<usize>,
    lengths: Vec<f64>,
    rows: Vec<f64>,
}

impl SinglePaths {
    /// Makes ready for `strands` of `tracer`, which are close together.
    pub fn surround(
        &mut self,
        strands: &[PathView<'_>; LANES],
        tracer: &dyn GridTracer,
        world: &World,
    ) {
        let limits = strands.iter().filter_map(|strand| strand.ending);
        let limit = limits.map(|ending| ending.limit()).fold(0.0, f64::max);
        let last = knots_until(tracer.knots(), limit);
        self.together
            .find(strands, last, world, 0.0, tracer.slack());
        self.touching = self.together.by_strand(strands, world, tracer.slack());
    }

    /// What the one in lane `l`, whose ending is known, sees in `world`.
    pub fn seen(
        &mut self,
        (l, strand): (usize, PathView<'_>),
        ending: &Ending,
        tracer: &dyn GridTracer,
        world: &World,
    ) -> Seen {
        if self.together.pieces.is_empty() {
            return beyond(ending);
        }
        let limit = ending.limit();
        let last = knots_until(strand.knots, limit);
        let pieces = self.together.pieces.iter().zip(&self.touching);
        let own = pieces.filter(|(k, touching)| touching[l] && **k + 1 < last);
        self.touched.clear();
        self.touched.extend(own.map(|(k, _)| *k));
        let per_piece = finer(tracer.slack());
        self.sample(strand, tracer, per_piece);
        let closer = PathView {
            knots: &self.lengths,
            rows: &self.rows,
            boxes: &[],
            known: self.lengths.len(),
            ..strand
        };
        let (accelerator, domain) = (&world.accelerator, &world.manifold.domain);
        for first in (0..closer.known).step_by(per_piece + 1) {
            for i in first..first + per_piece {
                let piece = closer.piece(i);
                if let Some(hit) = first_hit(accelerator, domain, &piece, limit) {
                    return Seen::Surface(hit);
                }
            }
        }
        beyond(ending)
    }

    /// The path at the ends of the finer cubics, so many for each of its touched pieces.
    fn sample(&mut self, strand: PathView<'_>, tracer: &dyn GridTracer, per_piece: usize) {
        self.lengths.clear();
        for &k in &self.touched {
            let [from, to] = [strand.knots[k], strand.knots[k + 1]];
            let along = |j: usize| from + (to - from) * j as f64 / per_piece as f64;
            self.lengths.extend((0..=per_piece).map(along));
        }
        self.rows.clear();
        self.rows.resize(ROWS * self.lengths.len(), 0.0);
        if !self.lengths.is_empty() {
            tracer.refine(strand, &self.lengths, &mut self.rows);
        }
    }
}
