//! The grid of paths under one of the largest tiles.
//!
//! In: tiles. Out: the numbers of their 4 × 4 paths and of the three that check them. Tiles of side
//! `t` need paths every `t/3` pixels and are checked where their quarters have paths, every `t/6`.

use super::{Lattice, Tile};
use crate::{endings::EventLocator, lanes::LANES, path_batch::PathBatch};
use glam::DVec3;

/// Paths by their place.
pub(super) struct Nodes {
    root: Tile,
    /// Grid steps along a pixel, times 6 because the finest tiles have six steps along their side.
    steps: usize,
    smallest: usize,
    /// Places along a side of the grid.
    side: usize,
    numbers: Vec<Option<u32>>,
    paths: PathBatch,
}

/// Places where a tile is checked, in sixths of its side: near the middle of the squares where a cubic's
/// error is largest. The errors along both sides weigh differently from check to check: where they
/// weigh alike everywhere, as at (3, 3), (1, 5) and (5, 1), they can cancel unseen.
pub(super) const CHECKS: [(usize, usize); 3] = [(1, 3), (3, 5), (5, 1)];

impl Nodes {
    /// Makes a grid without paths; `paths` are forgotten, and their memory used again.
    pub(super) fn new(root: Tile, smallest: usize, mut paths: PathBatch) -> Self {
        paths.clear();
        let steps = 6;
        let side = root.side / smallest * steps + 1;
        Self {
            root,
            steps,
            smallest,
            side,
            numbers: vec![None; side * side],
            paths,
        }
    }

    /// Returns the place in the grid of the point (`i`, `j`), in sixths of the side of `tile`.
    fn place(&self, tile: Tile, (i, j): (usize, usize)) -> usize {
        let stride = tile.side / self.smallest;
        let column = (tile.x - self.root.x) / self.smallest * self.steps + i * stride;
        let row = (tile.y - self.root.y) / self.smallest * self.steps + j * stride;
        row * self.side + column
    }

    /// Looks up all paths of `tiles` that are not known yet.
    pub(super) fn trace(
        &mut self,
        tiles: &[Tile],
        lattice: &Lattice<'_>,
        events: &mut EventLocator<'_>,
    ) {
        let mut directions: Vec<DVec3> = Vec::new();
        for tile in tiles {
            for at in corners().chain(CHECKS) {
                let place = self.place(*tile, at);
                if self.numbers[place].is_none() {
                    self.numbers[place] = Some((self.paths.len() + directions.len()) as u32);
                    let sixth = tile.side as f64 / 6.0;
                    directions.push(lattice.view.address(
                        tile.x as f64 + at.0 as f64 * sixth,
                        tile.y as f64 + at.1 as f64 * sixth,
                    ));
                }
            }
        }
        lattice.tracer.add(&directions, events, &mut self.paths);
    }

    /// Returns the numbers of the sixteen paths of `tile`, row by row.
    pub(super) fn members(&self, tile: Tile) -> Option<[usize; LANES]> {
        let mut members = [0; LANES];
        for (member, at) in members.iter_mut().zip(corners()) {
            *member = self.numbers[self.place(tile, at)]? as usize;
        }
        Some(members)
    }

    /// Returns the numbers of the paths that check `tile`.
    pub(super) fn checks(&self, tile: Tile) -> Option<[usize; CHECKS.len()]> {
        let mut numbers = [0; CHECKS.len()];
        for (number, at) in numbers.iter_mut().zip(CHECKS) {
            *number = self.numbers[self.place(tile, at)]? as usize;
        }
        Some(numbers)
    }

    /// Returns all paths.
    pub(super) fn paths(&self) -> &PathBatch {
        &self.paths
    }

    /// Returns all paths and keeps nothing.
    pub(super) fn into_paths(self) -> PathBatch {
        self.paths
    }
}

/// Iterates over the places of a tile's sixteen paths, in sixths of its side, row by row.
fn corners() -> impl Iterator<Item = (usize, usize)> {
    (0..LANES).map(|i| (i % 4 * 2, i / 4 * 2))
}
