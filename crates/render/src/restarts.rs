//! Paths of a frame in a glued space beyond the length of its table, looked up again where they have come to.
//!
//! In: the samples whose paths end by the table's length, and the states that they have there. Out: what they see
//! farther on. Each part of a path is brought into the domain and has a fan of its own there; the copies of the scene
//! about the domain are those that it meets.

use super::{
    curve::Ending,
    endings::EventLocator,
    frame::Outcomes,
    intersect::{HitSearch, Seen, beyond},
    lookup::{Lookup, ending},
    path_batch::{PathBatch, PathOrigin, PathView, ROWS, stay},
    tiles::{PixelSamples, SamplePlace},
    tracer::{GridTracer, even_knots},
    world::World,
};
use geofan_bundle::PathCoefficients;
use geofan_core::parallel::*;
use glam::DVec3;
use std::sync::Arc;

/// Intervals between the places where a part is sampled, for one of the table's knots: cubics between those may miss
/// the path by far more than what is seen may.
const FINER: usize = 4;

/// Samples that one thread works on at a time.
const BLOCK: usize = 256;

/// Looks paths up again where a table ends.
#[derive(Clone, Copy)]
pub struct Restarts<'f> {
    lookup: &'f Lookup<'f>,
    /// The length up to which they are followed.
    length: f64,
}

/// Memory for one thread.
struct RestartScratch<'w> {
    events: EventLocator<'w>,
    search: HitSearch<'w>,
    rows: Vec<f64>,
    s: Arc<[f64]>,
}

impl<'f> Restarts<'f> {
    /// Prepares paths of a table over `length`.
    pub fn new(lookup: &'f Lookup<'f>, length: f64) -> Self {
        Self { lookup, length }
    }

    /// Returns the length up to which paths are followed.
    pub fn length(&self) -> f64 {
        self.length
    }

    /// Goes on with all samples whose paths end by the length of `tracer`'s; lists those that no look-up serves.
    pub fn go_on(
        &self,
        samples: &PixelSamples<'_>,
        tracer: &dyn GridTracer,
        outcomes: &mut Outcomes,
    ) -> Vec<SamplePlace> {
        let ended = outcomes.indexed_iter();
        let ended = ended.filter(|(_, seen)| **seen == Seen::Length);
        let ended: Vec<SamplePlace> = ended.map(|(place, _)| place).collect();
        let blocks = ended.par_chunks(BLOCK);
        let found = blocks.flat_map_iter(|places| self.block(samples, tracer, places));
        let found: Vec<Option<Seen>> = found.collect();
        let mut lost = Vec::new();
        for (place, seen) in ended.into_iter().zip(found) {
            match seen {
                Some(seen) => outcomes[place] = seen,
                None => lost.push(place),
            }
        }
        lost
    }

    fn block(
        &self,
        samples: &PixelSamples<'_>,
        tracer: &dyn GridTracer,
        places: &[SamplePlace],
    ) -> Vec<Option<Seen>> {
        let world = samples.world;
        let addresses: Vec<DVec3> = places.iter().map(|p| samples.address(*p)).collect();
        let knots = tracer.knots();
        let mut scratch = RestartScratch {
            events: EventLocator::new(&world.manifold),
            search: HitSearch::new(world),
            rows: Vec::new(),
            s: even_knots(self.lookup.table.length, FINER * (knots.len() - 1)),
        };
        let mut batch = PathBatch::new(knots.clone());
        tracer.add(&addresses, &mut scratch.events, &mut batch);
        let last = knots.len() - 1;
        let paths = (0..batch.len()).map(|i| batch.path(i));
        paths
            .map(|path| {
                let state = (path.known > last).then(|| (path.point(last), path.tangent(last)));
                self.seen(world, state?, &mut scratch)
            })
            .collect()
    }

    /// Returns what the path sees that has this state where the table ends; `None` where the table has no path from
    /// there.
    fn seen(
        &self,
        world: &World,
        mut state: (DVec3, DVec3),
        scratch: &mut RestartScratch<'_>,
    ) -> Option<Seen> {
        let reach = self.lookup.table.length;
        let mut from = reach;
        while from < self.length {
            let (u, v, _) = world.manifold.brought_in(state.0, state.1)?;
            let (fan, direction) = self.lookup.table.restarted(u, v).ok()?;
            let path = fan.path(direction);
            let RestartScratch {
                events,
                search,
                rows,
                s,
            } = scratch;
            rows.clear();
            rows.resize(ROWS * s.len(), 0.0);
            let known = path.sample_into(s, rows);
            stay(rows, s.len(), known);
            let view = PathView {
                knots: s,
                direction,
                rows,
                boxes: &[],
                known,
                ending: None,
                source: (&PathCoefficients::default(), &PathOrigin::Knots),
            };
            let end = ending(&path, view, events)?;
            let limit = end.limit().min(self.length - from);
            let pieces = (0..known - 1).take_while(|k| s[*k] < limit);
            search.go_on_from(from);
            let mut hits = pieces.filter_map(|k| search.first_hit(&view.piece(k), limit));
            if let Some(hit) = hits.next() {
                return Some(Seen::Surface(hit));
            }
            match end {
                Ending::Length => {}
                Ending::Exit { s, .. } if s <= limit => return Some(beyond(&end.farther(from))),
                Ending::Exit { .. } => return Some(Seen::Length),
                Ending::Singular => return Some(Seen::Singular),
            }
            let last = s.len() - 1;
            state = (view.point(last), view.tangent(last));
            from += reach;
        }
        Some(Seen::Length)
    }
}
