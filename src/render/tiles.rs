//! Samples of one of the largest tiles: what they see.
//!
//! In: a divided tile of the lattice, or directions alone. Out: outcomes, and the samples that the
//! tracer cannot give, put off so that they are traced together.

use super::{
    curve::Ending,
    desk::Desk,
    endings::EndingFinder,
    lanes::LANES,
    last_pieces::LastPieces,
    lattice::{Divided, Ends, LARGEST_TILE, Leaf, Tile},
    lone::Lone,
    outcome::{Seen, beyond},
    packet::{Bicubic, Target},
    ribbon::{Chords, Ribbon},
    sheaf::Sheaf,
    strands::{Strand, Strands},
    tracer::GridTracer,
    view::View,
    world::World,
};
use crate::expr::vectorised;
use glam::{DVec2, DVec3};
use ndarray::{Array3, ArrayViewMut3, Axis};
use std::time::{Duration, Instant};

/// Row, column and number of a sample.
pub type Place = (usize, usize, usize);

/// Work done and time spent, summed over threads.
#[derive(Debug, Clone, Copy, Default)]
pub struct Tally {
    /// Paths looked up or followed at common knots.
    pub paths: usize,
    /// Samples interpolated.
    pub interpolated: usize,
    /// Samples traced one by one.
    pub traced: usize,
    /// Time for paths and for dividing tiles.
    pub lattice: Duration,
    /// Time for tubes and chords.
    pub tiles: Duration,
    /// Time for samples.
    pub pixels: Duration,
}

impl std::ops::AddAssign for Tally {
    fn add_assign(&mut self, other: Self) {
        self.paths += other.paths;
        self.interpolated += other.interpolated;
        self.traced += other.traced;
        self.lattice += other.lattice;
        self.tiles += other.tiles;
        self.pixels += other.pixels;
    }
}

/// The picture's samples and what they may meet.
#[derive(Clone, Copy)]
pub struct Samples<'a> {
    /// The scene.
    pub world: &'a World,
    /// The picture.
    pub view: &'a View,
    /// Where in a pixel its samples are, in [0, 1]².
    pub offsets: &'a [DVec2],
}

/// What the samples of one of the largest tiles find.
pub struct Found<'o> {
    /// The tile's upper left pixel: row and column.
    pub corner: (usize, usize),
    /// Its outcomes, axes (row, column, sample) from the corner.
    pub outcomes: ArrayViewMut3<'o, Seen>,
    /// Samples put off.
    pub pending: Vec<Place>,
    /// Work and time.
    pub tally: Tally,
}

impl<'o> Found<'o> {
    /// Nothing yet.
    pub fn new(corner: (usize, usize), outcomes: ArrayViewMut3<'o, Seen>) -> Self {
        Self {
            corner,
            outcomes,
            pending: Vec::new(),
            tally: Tally::default(),
        }
    }

    /// The outcomes of each of the largest tiles, row by row; they do not overlap.
    pub fn split(outcomes: &'o mut Array3<Seen>) -> Vec<Self> {
        let mut tiles = Vec::new();
        let bands = outcomes.axis_chunks_iter_mut(Axis(0), LARGEST_TILE);
        for (row, band) in bands.enumerate() {
            let (mut rest, mut x) = (band, 0);
            while rest.len_of(Axis(1)) > 0 {
                let width = LARGEST_TILE.min(rest.len_of(Axis(1)));
                let (first, others) = rest.split_at(Axis(1), width);
                tiles.push(Found::new((row * LARGEST_TILE, x), first));
                (rest, x) = (others, x + width);
            }
        }
        tiles
    }

    /// The tile.
    pub fn tile(&self) -> Tile {
        Tile {
            x: self.corner.1,
            y: self.corner.0,
            side: LARGEST_TILE,
        }
    }

    fn put(&mut self, (y, x, k): Place, seen: Seen) {
        self.outcomes[(y - self.corner.0, x - self.corner.1, k)] = seen;
    }
}

impl Samples<'_> {
    /// The samples of a tile that the lattice divided.
    pub fn interpolate(
        &self,
        divided: &Divided,
        tracer: &dyn GridTracer,
        desk: &mut Desk<'_>,
        found: &mut Found<'_>,
    ) {
        found.tally.paths += divided.strands.len();
        let mut lost = Vec::new();
        for leaf in &divided.leaves {
            let known = (tracer, &mut desk.endings);
            self.leaf(known, divided, leaf, found, &mut lost);
        }
        lost.extend(divided.lost.iter().flat_map(|tile| self.places(*tile)));
        self.trace(&lost, tracer, desk, found);
    }

    /// The chords of a tile with its paths.
    pub fn ribbon(
        &self,
        tracer: &dyn GridTracer,
        divided: &Divided,
        (leaf, sheaf): (&Leaf, &Sheaf<'_>),
    ) -> Ribbon {
        let mut ribbon = Ribbon::default();
        let within = divided.chord_error;
        ribbon.flatten(sheaf, (tracer, self.world), &leaf.touched, within);
        ribbon
    }

    fn leaf(
        &self,
        (tracer, endings): (&dyn GridTracer, &mut EndingFinder<'_>),
        divided: &Divided,
        leaf: &Leaf,
        found: &mut Found<'_>,
        lost: &mut Vec<Place>,
    ) {
        let began = Instant::now();
        let sheaf = divided.sheaf(leaf);
        let ribbon = self.ribbon(tracer, divided, (leaf, &sheaf));
        let finish = match &leaf.ends {
            Ends::Alike => Finish::Alike,
            Ends::Within(pieces) => Finish::Within(LastPieces::new(&sheaf, tracer, pieces)),
            Ends::Each => Finish::Each,
        };
        let flat = Instant::now();
        found.tally.tiles += flat - began;
        let target = Target::new(self.world, &sheaf, &ribbon);
        for part in leaf.tile.parts(PART) {
            let narrowed = match ribbon.chords.is_empty() || part == leaf.tile {
                true => None,
                false => Some(ribbon.within(self.world, &Bicubic::new(&grid(leaf.tile, part)))),
            };
            let chords = narrowed.as_ref().unwrap_or(&ribbon.chords);
            let places = self.places(part);
            for places in places.chunks(LANES) {
                let place = |l: usize| places[l.min(places.len() - 1)];
                let at = std::array::from_fn(|l| self.fraction(leaf.tile, place(l)));
                let show = |l: usize, seen: Seen| {
                    if let Some(place) = places.get(l) {
                        found.put(*place, seen);
                    }
                };
                // A kernel for each: one for all would be slower for the one that most tiles need.
                match &finish {
                    Finish::Alike => vectorised(
                        #[inline(always)]
                        || target.see(&Bicubic::new(&at), chords, show),
                    ),
                    Finish::Within(last) => vectorised(
                        #[inline(always)]
                        || {
                            let mixing = Bicubic::new(&at);
                            let ends = last.endings(&mixing, endings);
                            target.see_before(&mixing, chords, &ends, show);
                        },
                    ),
                    Finish::Each => {
                        let ends = self.endings(places, (tracer, endings), lost);
                        see_before(&target, &at, chords, (&ends, show));
                    }
                }
            }
            found.tally.interpolated += places.len();
        }
        found.tally.pixels += flat.elapsed();
    }

    /// How the samples at at most sixteen `places` end; those of which that is not known are `lost`.
    fn endings(
        &self,
        places: &[Place],
        (tracer, endings): (&dyn GridTracer, &mut EndingFinder<'_>),
        lost: &mut Vec<Place>,
    ) -> [Ending; LANES] {
        let addresses: Vec<DVec3> = places.iter().map(|place| self.address(*place)).collect();
        let known = tracer.endings(&addresses, endings);
        let mut ends = [Ending::Nowhere; LANES];
        for ((end, known), place) in ends.iter_mut().zip(known).zip(places) {
            match known {
                Some(known) => *end = known,
                None => lost.push(*place),
            }
        }
        ends
    }

    /// The samples at `places`, each by a path of its own.
    pub fn trace(
        &self,
        places: &[Place],
        tracer: &dyn GridTracer,
        desk: &mut Desk<'_>,
        found: &mut Found<'_>,
    ) {
        let began = Instant::now();
        let addresses: Vec<DVec3> = places.iter().map(|place| self.address(*place)).collect();
        let Desk {
            endings,
            singles,
            lone,
            ..
        } = desk;
        for (places, addresses) in places.chunks(BLOCK).zip(addresses.chunks(BLOCK)) {
            singles.clear();
            tracer.add(addresses, endings, singles);
            for (first, places) in places.chunks(LANES).enumerate() {
                let first = LANES * first;
                self.lone((tracer, lone), singles, first, places, found);
            }
            found.tally.traced += places.len();
            found.tally.paths += places.len();
        }
        found.tally.pixels += began.elapsed();
    }

    /// The samples at `places`, close together, whose paths are `strands` from number `first` on.
    fn lone(
        &self,
        (tracer, lone): (&dyn GridTracer, &mut Lone),
        strands: &Strands,
        first: usize,
        places: &[Place],
        found: &mut Found<'_>,
    ) {
        let all: [Strand<'_>; LANES] =
            std::array::from_fn(|l| strands.strand(first + l.min(places.len() - 1)));
        lone.surround(&all, tracer, self.world);
        for (strand, (l, place)) in all.into_iter().zip(places.iter().enumerate()) {
            match strand.ending {
                None => found.pending.push(*place),
                Some(ending) => {
                    let seen = lone.seen((l, strand), &ending, tracer, self.world);
                    found.put(*place, seen);
                }
            }
        }
    }

    /// The samples of `tile` in the picture, by squares of 4 × 4 pixels so that sixteen in a
    /// row are close together.
    pub fn places(&self, tile: Tile) -> Vec<Place> {
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

    /// Tells if a sample shows anything.
    pub fn shows(&self, place: Place) -> bool {
        let at = self.point(place);
        self.view.shows(at.x, at.y)
    }

    /// Tells if any point of a tile shows anything.
    pub fn shows_some(&self, tile: Tile) -> bool {
        let along = |corner: usize| corner as f64..(corner + tile.side) as f64;
        self.view.shows_some(along(tile.x), along(tile.y))
    }

    /// Finds where a sample is in the picture.
    pub fn point(&self, (y, x, k): Place) -> DVec2 {
        DVec2::new(x as f64, y as f64) + self.offsets[k]
    }

    /// Where in a tile a sample is, as fractions of its side.
    fn fraction(&self, tile: Tile, place: Place) -> DVec2 {
        (self.point(place) - DVec2::new(tile.x as f64, tile.y as f64)) * (1.0 / tile.side as f64)
    }

    /// Returns what tells a tracer which ray a sample's is.
    pub fn address(&self, place: Place) -> DVec3 {
        let at = self.point(place);
        self.view.address(at.x, at.y)
    }
}

/// How the samples of a tile end.
enum Finish {
    Alike,
    Within(LastPieces),
    Each,
}

/// Shows what sixteen samples at these places in their tile see whose ends are known.
fn see_before(
    target: &Target<'_>,
    at: &[DVec2; LANES],
    chords: &Chords,
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
/// as much as sixteen samples do. With it frames take two to four hundredths less.
const PART: usize = 16;

/// The places of 4 × 4 paths that span a part of a tile, as fractions of the tile's side.
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
