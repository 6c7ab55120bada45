//! Samples of one of the largest tiles: what they see.
//!
//! In: a divided tile of the lattice, or directions alone, and memory that a thread works with
//! ([`TileScratch`]). Out: outcomes, and the samples that the tracer cannot give, put off so that they are
//! traced together.

use super::{
    chords::ChordList,
    curve::Ending,
    endings::EventLocator,
    first_hits::{InterpolatedPaths, SinglePaths},
    frame::{Clock, FrameStatistics},
    intersect::{Seen, beyond},
    lanes::LANES,
    lattice::{Divided, Ends, LARGEST_TILE, Leaf, Tile},
    path_batch::{PathBatch, PathView},
    path_patch::{Bicubic, PathPatch, Vertex},
    tracer::GridTracer,
    view::View,
    world::World,
};
use geofan_core::manifold::Manifold;
use geofan_expr::vectorised;
use glam::{DVec2, DVec3};
use ndarray::{Array3, ArrayViewMut3, Axis};
use std::sync::Arc;

/// Row, column and number of a sample.
pub type SamplePlace = (usize, usize, usize);

/// Memory that one thread works with on tile after tile: made once, as memory for paths is slow to get.
pub struct TileScratch<'m> {
    /// Finds how paths end.
    pub events: EventLocator<'m>,
    /// Paths of a lattice.
    pub paths: PathBatch,
    /// Single paths.
    pub singles: PathBatch,
    /// Finds what single paths see.
    single_paths: SinglePaths,
}

impl<'m> TileScratch<'m> {
    /// Makes it for paths in `manifold` with these knots.
    pub fn new(manifold: &'m Manifold, knots: &Arc<[f64]>) -> Self {
        Self {
            events: EventLocator::new(manifold),
            paths: PathBatch::new(knots.clone()),
            singles: PathBatch::new(knots.clone()),
            single_paths: SinglePaths::default(),
        }
    }
}

/// The picture's samples and what they may meet.
#[derive(Clone, Copy)]
pub struct PixelSamples<'a> {
    /// The scene.
    pub world: &'a World,
    /// The picture.
    pub view: &'a View,
    /// Places of its samples in a pixel, in [0, 1]².
    pub offsets: &'a [DVec2],
    /// Tells the time.
    pub clock: Clock<'a>,
}

/// The outcomes of one of the largest tiles.
pub struct TileOutcomes<'o> {
    /// The tile's upper left pixel: row and column.
    pub corner: (usize, usize),
    /// Its outcomes, axes (row, column, sample) from the corner.
    pub outcomes: ArrayViewMut3<'o, Seen>,
    /// Samples put off.
    pub pending: Vec<SamplePlace>,
    /// Work and time.
    pub work: FrameStatistics,
}

impl<'o> TileOutcomes<'o> {
    /// Takes the part of the outcomes from `corner` on, of which nothing is known yet.
    pub fn new(corner: (usize, usize), outcomes: ArrayViewMut3<'o, Seen>) -> Self {
        Self {
            corner,
            outcomes,
            pending: Vec::new(),
            work: FrameStatistics::default(),
        }
    }

    /// Splits the outcomes into those of each of the largest tiles, row by row; they do not overlap.
    pub fn split(outcomes: &'o mut Array3<Seen>) -> Vec<Self> {
        let mut tiles = Vec::new();
        let bands = outcomes.axis_chunks_iter_mut(Axis(0), LARGEST_TILE);
        for (row, band) in bands.enumerate() {
            let (mut rest, mut x) = (band, 0);
            while rest.len_of(Axis(1)) > 0 {
                let width = LARGEST_TILE.min(rest.len_of(Axis(1)));
                let (first, others) = rest.split_at(Axis(1), width);
                tiles.push(Self::new((row * LARGEST_TILE, x), first));
                (rest, x) = (others, x + width);
            }
        }
        tiles
    }

    /// Returns the tile.
    pub fn tile(&self) -> Tile {
        Tile {
            x: self.corner.1,
            y: self.corner.0,
            side: LARGEST_TILE,
        }
    }

    fn put(&mut self, (y, x, k): SamplePlace, seen: Seen) {
        self.outcomes[(y - self.corner.0, x - self.corner.1, k)] = seen;
    }
}

impl PixelSamples<'_> {
    /// Finds what the samples of a tile that the lattice divided see.
    pub fn interpolate(
        &self,
        divided: &Divided,
        tracer: &dyn GridTracer,
        scratch: &mut TileScratch<'_>,
        tile: &mut TileOutcomes<'_>,
    ) {
        tile.work.paths += divided.paths.len();
        let mut lost = Vec::new();
        for leaf in &divided.leaves {
            let known = (tracer, &mut scratch.events);
            self.leaf(known, divided, leaf, tile, &mut lost);
        }
        lost.extend(divided.lost.iter().flat_map(|tile| self.places(*tile)));
        self.trace(&lost, tracer, scratch, tile);
    }

    /// Flattens the paths of a leaf into chords.
    pub fn flatten(
        &self,
        tracer: &dyn GridTracer,
        divided: &Divided,
        (leaf, patch): (&Leaf, &PathPatch<'_>),
    ) -> (Vec<Vertex>, ChordList) {
        let known = (tracer, self.world);
        ChordList::flatten(patch, known, &leaf.touched, divided.chord_error)
    }

    /// Finds what the samples of a leaf see; those whose end is not known are `lost`.
    fn leaf(
        &self,
        (tracer, events): (&dyn GridTracer, &mut EventLocator<'_>),
        divided: &Divided,
        leaf: &Leaf,
        tile: &mut TileOutcomes<'_>,
        lost: &mut Vec<SamplePlace>,
    ) {
        // The chords that all samples have in common, and where their paths may end.
        let began = (self.clock)();
        let patch = divided.patch(leaf);
        let (vertices, all_chords) = self.flatten(tracer, divided, (leaf, &patch));
        let last = match &leaf.ends {
            Ends::Within(pieces) => patch.last_vertices(tracer, pieces),
            Ends::Alike | Ends::Each => Vec::new(),
        };
        let flat = (self.clock)();
        tile.work.tiles += flat.saturating_sub(began);
        // Part by part with the chords that a part may meet something with.
        let target = InterpolatedPaths::new(self.world, &patch, &vertices);
        for part in leaf.tile.parts(PART) {
            let narrowed = match all_chords.is_empty() || part == leaf.tile {
                true => None,
                false => {
                    let mixing = Bicubic::new(&grid(leaf.tile, part));
                    Some(all_chords.within(self.world, &vertices, &mixing))
                }
            };
            let chords = narrowed.as_ref().unwrap_or(&all_chords);
            let places = self.places(part);
            for places in places.chunks(LANES) {
                let (known, paths) = ((tracer, &mut *events), (leaf, &target, &last[..]));
                self.see_sixteen(known, paths, chords, places, (tile, lost));
            }
            tile.work.interpolated += places.len();
        }
        tile.work.pixels += (self.clock)().saturating_sub(flat);
    }

    /// Finds what the samples at at most sixteen `places` of a leaf see. There is a kernel for each way
    /// in which paths may end: one for all would be slower for the one that most tiles need.
    fn see_sixteen(
        &self,
        (tracer, events): (&dyn GridTracer, &mut EventLocator<'_>),
        (leaf, target, last): (&Leaf, &InterpolatedPaths<'_>, &[Vertex]),
        chords: &ChordList,
        places: &[SamplePlace],
        (tile, lost): (&mut TileOutcomes<'_>, &mut Vec<SamplePlace>),
    ) {
        let place = |l: usize| places[l.min(places.len() - 1)];
        let at = std::array::from_fn(|l| self.fraction(leaf.tile, place(l)));
        let show = |l: usize, seen: Seen| {
            if let Some(place) = places.get(l) {
                tile.put(*place, seen);
            }
        };
        match &leaf.ends {
            Ends::Alike => vectorised(
                #[inline(always)]
                || target.see(&Bicubic::new(&at), chords, show),
            ),
            Ends::Within(_) => vectorised(
                #[inline(always)]
                || {
                    let mixing = Bicubic::new(&at);
                    let ends = events.endings_between(last, &mixing);
                    target.see_before(&mixing, chords, &ends, show);
                },
            ),
            Ends::Each => {
                let ends = self.endings(places, (tracer, events), lost);
                see_before(target, &at, chords, (&ends, show));
            }
        }
    }

    /// Looks up how the samples at at most sixteen `places` end; those of which that is not known are `lost`.
    fn endings(
        &self,
        places: &[SamplePlace],
        (tracer, events): (&dyn GridTracer, &mut EventLocator<'_>),
        lost: &mut Vec<SamplePlace>,
    ) -> [Ending; LANES] {
        let addresses: Vec<DVec3> = places.iter().map(|place| self.address(*place)).collect();
        let known = tracer.endings(&addresses, events);
        let mut ends = [Ending::Length; LANES];
        for ((end, known), place) in ends.iter_mut().zip(known).zip(places) {
            match known {
                Some(known) => *end = known,
                None => lost.push(*place),
            }
        }
        ends
    }

    /// Finds what the samples at `places` see, each by a path of its own.
    pub fn trace(
        &self,
        places: &[SamplePlace],
        tracer: &dyn GridTracer,
        scratch: &mut TileScratch<'_>,
        tile: &mut TileOutcomes<'_>,
    ) {
        let began = (self.clock)();
        let addresses: Vec<DVec3> = places.iter().map(|place| self.address(*place)).collect();
        let TileScratch {
            events,
            singles,
            single_paths,
            ..
        } = scratch;
        for (places, addresses) in places.chunks(BLOCK).zip(addresses.chunks(BLOCK)) {
            singles.clear();
            tracer.add(addresses, events, singles);
            for (first, places) in places.chunks(LANES).enumerate() {
                let first = LANES * first;
                self.see_singles((tracer, single_paths), singles, first, places, tile);
            }
            tile.work.traced += places.len();
            tile.work.paths += places.len();
        }
        tile.work.pixels += (self.clock)().saturating_sub(began);
    }

    /// Finds what the samples at `places` see, close together, whose paths are in `batch` from number `first`
    /// on.
    fn see_singles(
        &self,
        (tracer, single_paths): (&dyn GridTracer, &mut SinglePaths),
        batch: &PathBatch,
        first: usize,
        places: &[SamplePlace],
        tile: &mut TileOutcomes<'_>,
    ) {
        let all: [PathView<'_>; LANES] =
            std::array::from_fn(|l| batch.path(first + l.min(places.len() - 1)));
        single_paths.surround(&all, tracer, self.world);
        for (path, (l, place)) in all.into_iter().zip(places.iter().enumerate()) {
            match single_paths.seen((l, path), tracer, self.world) {
                None => tile.pending.push(*place),
                Some(seen) => tile.put(*place, seen),
            }
        }
    }

    /// Returns the samples of `tile` in the picture, by squares of 4 × 4 pixels so that sixteen in a row are
    /// close together.
    pub fn places(&self, tile: Tile) -> Vec<SamplePlace> {
        let (rows, columns) = tile.extent(self.view.size);
        let mut places = Vec::with_capacity(rows.len() * columns.len() * self.offsets.len());
        for top in rows.clone().step_by(SQUARE) {
            for left in columns.clone().step_by(SQUARE) {
                for y in top..(top + SQUARE).min(rows.end) {
                    for x in left..(left + SQUARE).min(columns.end) {
                        places.extend((0..self.offsets.len()).map(|k| (y, x, k)));
                    }
                }
            }
        }
        places
    }

    /// Tells whether a sample shows anything.
    pub fn shows(&self, place: SamplePlace) -> bool {
        let at = self.point(place);
        self.view.shows(at.x, at.y)
    }

    /// Tells whether any point of a tile shows anything.
    pub fn shows_some(&self, tile: Tile) -> bool {
        let along = |corner: usize| corner as f64..(corner + tile.side) as f64;
        self.view.shows_some(along(tile.x), along(tile.y))
    }

    /// Finds where a sample is in the picture.
    pub fn point(&self, (y, x, k): SamplePlace) -> DVec2 {
        DVec2::new(x as f64, y as f64) + self.offsets[k]
    }

    /// Returns the place of a sample in a tile, as fractions of its side.
    fn fraction(&self, tile: Tile, place: SamplePlace) -> DVec2 {
        (self.point(place) - DVec2::new(tile.x as f64, tile.y as f64)) * (1.0 / tile.side as f64)
    }

    /// Returns the address by which a tracer knows the ray of a sample ([`View::address`]).
    pub fn address(&self, place: SamplePlace) -> DVec3 {
        let at = self.point(place);
        self.view.address(at.x, at.y)
    }
}

/// Shows what sixteen samples at these places in their tile see whose ends are known.
fn see_before(
    target: &InterpolatedPaths<'_>,
    at: &[DVec2; LANES],
    chords: &ChordList,
    (ends, mut show): (&[Ending; LANES], impl FnMut(usize, Seen)),
) {
    match chords.is_empty() {
        true => (0..LANES).for_each(|l| show(l, beyond(&ends[l]))),
        false => vectorised(
            #[inline(always)]
            || target.see_before(&Bicubic::new(at), chords, ends, show),
        ),
    }
}

/// Pixels along a side of the parts of a tile for which chords are looked at again: each look costs about
/// as much as sixteen samples do. With it frames take 2 to 4 % less time.
const PART: usize = 16;

/// Returns the places of 4 × 4 paths that span a part of a tile, as fractions of the tile's side.
fn grid(tile: Tile, part: Tile) -> [DVec2; LANES] {
    let corner = DVec2::new((part.x - tile.x) as f64, (part.y - tile.y) as f64);
    let step = part.side as f64 / 3.0;
    std::array::from_fn(|i| {
        (corner + step * DVec2::new((i % 4) as f64, (i / 4) as f64)) / tile.side as f64
    })
}

/// Pixels along a side of the squares of one packet at one sample for each.
const SQUARE: usize = 4;

/// Paths followed at once: enough to keep the tracer's lanes full, few enough to stay in the cache.
const BLOCK: usize = 256;
