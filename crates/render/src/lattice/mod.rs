//! The adaptive screen lattice: few paths, interpolated to every pixel.
//!
//! In: a tracer whose paths share their knots. Out: for one of the largest tiles, part by part ([`Lattice::refine`]),
//! the tiles into which it was divided, each spanned by 4 × 4 paths at even spacing, and the pixels
//! that have to be traced one by one. Paths at three more points of a tile tell whether the bicubic
//! through the sixteen is within the budget; if not, the tile is quartered. Where the sixteen leave
//! through different exits, or some not at all, the ends of the interpolated paths are found pixel by
//! pixel, if those paths are within the budget up to there. All these points lie on one grid, so that
//! a tile's paths serve its quarters and its neighbours too, and are looked up together, level by
//! level.

mod patch_checks;

use super::{
    chords::{Candidates, TUBE_MARGIN},
    endings::EventLocator,
    lanes::LANES,
    path_batch::PathBatch,
    path_patch::PathPatch,
    tracer::GridTracer,
    view::View,
    world::World,
};
pub use patch_checks::{LATTICE_SHARE, angle as seen_angle};
use patch_checks::{Nodes, PatchChecks};
use std::ops::Range;

/// Pixels along a side of the largest tiles: the pieces in which threads share a picture. Chosen, not
/// measured: smaller ones share fewer paths, larger ones keep fewer threads busy.
pub const LARGEST_TILE: usize = 64;

/// Angle of the widest tile, radians: its paths are a third of it apart, and what is smaller in space itself, such as a ball
/// of glass, they may all miss. Of a small picture each tile is wide.
const WIDEST_TILE: f64 = 0.25;

/// A tile brings nine paths of its own (the others serve its neighbours too), so one with fewer
/// samples than this is not worth its paths. Measured on the wormhole gallery, 16 takes as long: what
/// smaller tiles save in single paths they cost in paths of their own.
const FEWEST_SAMPLES: usize = 64;

/// The share of what else is allowed that paths may be off where they end, if not all end alike: what
/// a sky's direction is off by is not compared itself there. With 1 the 99th percentile over all
/// pixels of three bumps rose from 0.17 to 0.21 mrad, with 0.5 and with this to 0.19.
const END_SHARE: f64 = 0.25;

/// The share of the budget by which chords may miss the interpolated paths. With half of it frames of
/// the wormhole gallery take 1.01 to 1.08 times as long.
const CHORD_SHARE: f64 = 0.2;

/// Most pieces that may meet something of a tile in which the end of each sample is looked up: where
/// there are more, its paths are so unlike that following each is cheaper. On the wormhole gallery as many
/// as there are cost a tenth of a frame.
const EACH_PIECES: usize = 3;

/// Most paths held at once: a picture of many samples beside the silhouette of space needs ten thousand for one of the
/// largest tiles, and a page keeps the memory that it once had: 2 kB each. Paths along a border between tiles that are
/// divided by turns are looked up twice.
const MOST_PATHS: usize = 2048;

/// Paths that a tile brings beside those that serve its neighbours too: nine, and three that check it.
const PATHS_OF_TILE: usize = 12;

/// A square of pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tile {
    /// Upper left pixel.
    pub x: usize,
    /// Upper left pixel.
    pub y: usize,
    /// Pixels along a side; tiles may reach over the picture's edge.
    pub side: usize,
}

impl Tile {
    /// Divides it into four.
    fn quarters(self) -> [Tile; 4] {
        let side = self.side / 2;
        [(0, 0), (side, 0), (0, side), (side, side)].map(|(dx, dy)| Tile {
            x: self.x + dx,
            y: self.y + dy,
            side,
        })
    }

    /// Divides it into squares of at most `side` pixels, row by row.
    pub fn parts(self, side: usize) -> impl Iterator<Item = Tile> {
        let side = side.min(self.side);
        let steps = move || (0..self.side).step_by(side);
        let part = move |(dy, dx)| Tile {
            x: self.x + dx,
            y: self.y + dy,
            side,
        };
        steps()
            .flat_map(move |dy| steps().map(move |dx| (dy, dx)))
            .map(part)
    }

    /// Returns rows and columns of the tile that are in a picture of `size` (across, down).
    pub fn extent(self, size: (usize, usize)) -> (Range<usize>, Range<usize>) {
        (
            self.y..(self.y + self.side).min(size.1),
            self.x..(self.x + self.side).min(size.0),
        )
    }

    /// Returns the square of the distance of its middle from a pixel.
    pub fn squared_distance(self, (x, y): (usize, usize)) -> usize {
        let along = |corner: usize, at: usize| (corner + self.side / 2).abs_diff(at).pow(2);
        along(self.x, x) + along(self.y, y)
    }

    fn is_outside(self, size: (usize, usize)) -> bool {
        self.x >= size.0 || self.y >= size.1
    }
}

/// Returns the side of the smallest tiles worth their paths, with `samples` for each pixel.
pub fn smallest_tile(samples: usize) -> usize {
    let mut side = LARGEST_TILE;
    while side > 1 && side * side / 4 * samples >= FEWEST_SAMPLES {
        side /= 2;
    }
    side
}

/// The lattice over one picture.
#[derive(Clone, Copy)]
pub struct Lattice<'a> {
    /// Makes the paths.
    pub tracer: &'a dyn GridTracer,
    /// The scene that they may meet.
    pub world: &'a World,
    /// The picture.
    pub view: &'a View,
    /// Largest error of the interpolation, radians at the camera.
    pub budget: f64,
    /// Side of the smallest tiles.
    pub smallest: usize,
}

/// A tile whose sixteen paths can be interpolated.
pub struct Leaf {
    /// The pixels.
    pub tile: Tile,
    /// The numbers of its paths, row by row.
    pub members: [usize; LANES],
    /// Pieces that may meet the scene.
    pub touched: Vec<usize>,
    /// The way in which its paths end.
    pub ends: Ends,
}

/// The way in which the paths of a tile end.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Ends {
    /// All through the same exit, or all by their length.
    Alike,
    /// Not alike, but in these pieces.
    Within(Range<usize>),
    /// In skies that change too fast to be interpolated: the end of each sample is looked up.
    Each,
}

/// Tiles divided together.
pub struct Divided {
    /// All paths looked up for them.
    pub paths: PathBatch,
    /// Tiles to be interpolated.
    pub leaves: Vec<Leaf>,
    /// Tiles whose pixels are to be traced one by one.
    pub lost: Vec<Tile>,
    /// Error of the chords of its paths, radians at the camera.
    pub chord_error: f64,
}

impl Divided {
    /// Returns the paths of one of its tiles.
    pub fn patch(&self, leaf: &Leaf) -> PathPatch<'_> {
        PathPatch::new(&self.paths, &leaf.members)
    }
}

impl Lattice<'_> {
    /// Returns the tiles of the largest one at (`x`, `y`) with which [`Lattice::refine`] begins.
    pub fn undivided(&self, (x, y): (usize, usize)) -> Vec<Tile> {
        let side = LARGEST_TILE;
        let parts = Tile { x, y, side }.parts(self.widest_side().max(self.smallest));
        parts
            .filter(|part| !part.is_outside(self.view.size))
            .collect()
    }

    /// Divides tiles from the end of `undivided`, all of the same largest one, as far as thousands of paths are enough for;
    /// those of their parts that need more join the others. The paths take the place of `spare`, which has the tracer's
    /// knots.
    pub fn refine(
        &self,
        undivided: &mut Vec<Tile>,
        spare: PathBatch,
        events: &mut EventLocator<'_>,
    ) -> Divided {
        let first = undivided.len().saturating_sub(MOST_PATHS / PATHS_OF_TILE);
        let mut level = undivided.split_off(first);
        let pixel = level.first().map_or((0, 0), |tile| (tile.x, tile.y));
        let mut nodes = Nodes::new(pixel, self.smallest, spare);
        let (mut leaves, mut lost) = (Vec::new(), Vec::new());
        let mut touched = Candidates::default();
        if self.widest_side() < self.smallest {
            lost.append(&mut level);
        }
        while !level.is_empty() {
            nodes.trace(&level, self, events);
            let mut next = Vec::new();
            for tile in level {
                match self.leaf(tile, &nodes, events, &mut touched) {
                    Some(leaf) => leaves.push(leaf),
                    None if tile.side <= self.smallest => lost.push(tile),
                    None => next.extend(self.quarters(tile)),
                }
            }
            level = next;
            if nodes.paths().len() + PATHS_OF_TILE * level.len() > MOST_PATHS {
                undivided.append(&mut level);
            }
        }
        Divided {
            paths: nodes.into_paths(),
            leaves,
            lost,
            chord_error: CHORD_SHARE * self.budget,
        }
    }

    /// Iterates over the quarters of a tile that are in the picture.
    fn quarters(&self, tile: Tile) -> impl Iterator<Item = Tile> {
        let size = self.view.size;
        let quarters = tile.quarters().into_iter();
        quarters.filter(move |quarter| !quarter.is_outside(size))
    }

    /// Returns the side of the widest tiles, in pixels; 0 if a pixel is wider.
    fn widest_side(&self) -> usize {
        let most = WIDEST_TILE / self.view.pixel_angle();
        let mut side = LARGEST_TILE;
        while side as f64 > most {
            side /= 2;
        }
        side
    }

    /// Returns the tile's paths, if they can be interpolated within the budget.
    fn leaf(
        &self,
        tile: Tile,
        nodes: &Nodes,
        events: &mut EventLocator<'_>,
        touched: &mut Candidates,
    ) -> Option<Leaf> {
        let angle = self.view.pixel_angle() * tile.side as f64;
        let members = nodes.members(tile)?;
        let patch = PathPatch::new(nodes.paths(), &members);
        if !patch.is_known() {
            return None;
        }
        let (truths, reach) = (nodes.checks(tile)?, self.view.reach());
        let one_colour = |exit| self.world.has_one_colour(exit);
        let checks = PatchChecks::new(&patch, truths, angle, reach, one_colour);
        let allowed = LATTICE_SHARE * self.budget;
        // The sky is cheap to compare and rules most tiles out.
        let each = || tile.side <= self.smallest && self.knows_end(tile, events);
        let ends = ends(&checks, [checks.sky(), allowed], each)?;
        let (last, slack) = (patch.last(), self.tracer.slack());
        // Between paths that end in all ways those that check them tell a little more.
        match ends {
            Ends::Each => touched.find(&checks.all(), last, self.world, TUBE_MARGIN, slack),
            _ => touched.find(patch.paths(), last, self.world, TUBE_MARGIN, slack),
        }
        // Smaller tiles are narrower, single paths not wide at all.
        if touched.wide {
            return None;
        }
        let pieces = &touched.pieces;
        if self.meets_edge(&checks, pieces, &ends) {
            return None;
        }
        if ends == Ends::Each && pieces.len() > EACH_PIECES {
            return None;
        }
        if !(checks.path(pieces) <= allowed) {
            return None;
        }
        Some(Leaf {
            tile,
            members,
            touched: pieces.clone(),
            ends,
        })
    }

    /// Tells whether paths may meet an edge of the metric in the `pieces` or where they end: nothing is interpolated across
    /// one.
    fn meets_edge(&self, checks: &PatchChecks<'_>, pieces: &[usize], ends: &Ends) -> bool {
        if self.world.manifold.switching_functions().is_none() {
            return false;
        }
        let last = match ends {
            Ends::Within(last) => last.clone(),
            Ends::Alike | Ends::Each => 0..0,
        };
        let pieces: Vec<usize> = pieces.iter().copied().chain(last).collect();
        let paths = checks.all();
        paths
            .iter()
            .any(|path| self.tracer.meets_edge(*path, &pieces))
    }

    /// Tells whether the tracer knows the end of the path in the middle of a tile, and so most likely of all.
    fn knows_end(&self, tile: Tile, events: &mut EventLocator<'_>) -> bool {
        let [x, y] = [tile.x, tile.y].map(|corner| corner as f64 + 0.5 * tile.side as f64);
        let known = self.tracer.endings(&[self.view.address(x, y)], events);
        known.iter().all(Option::is_some)
    }
}

/// Returns the way in which the paths of a tile end, if the error of the `sky` that they see there is within what
/// is `allowed` or `each` says that the end of each can be looked up.
fn ends(
    checks: &PatchChecks<'_>,
    [sky, allowed]: [f64; 2],
    each: impl FnOnce() -> bool,
) -> Option<Ends> {
    if sky <= allowed {
        return Some(Ends::Alike);
    }
    let each = || each().then_some(Ends::Each);
    if sky < f64::INFINITY {
        return each();
    }
    match checks.last_pieces() {
        Some(pieces) if checks.endings(&pieces) <= END_SHARE * allowed => {
            Some(Ends::Within(pieces))
        }
        _ => each(),
    }
}
