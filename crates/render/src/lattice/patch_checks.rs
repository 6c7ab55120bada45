//! The check of an interpolation: the bicubic through sixteen paths against paths between them.
//!
//! In: tiles, a patch and the paths at [`CHECKS`]. Out: the numbers of a tile's 4 × 4 paths and of the three that check
//! them, in the grid of paths under one of the largest tiles ([`Nodes`]); and the largest error as an angle at the
//! camera, of the sky's direction and of the points of the path where it may meet something. Tiles of side `t` need
//! paths every `t/3` pixels and are checked where their quarters have paths, every `t/6`.

use super::{LARGEST_TILE, Lattice, Tile};
use crate::{
    curve::{Ending, comes_to_a_stop},
    endings::EventLocator,
    lanes::{LANES, Lanes},
    path_batch::{PathBatch, PathView, knots_until},
    path_patch::{PathPatch, cubic},
};
use glam::DVec3;
use std::{ops::Range, sync::LazyLock};

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
    /// Makes a grid without paths under the largest tile with these pixels; `paths` are forgotten, and their memory used again.
    pub(super) fn new((x, y): (usize, usize), smallest: usize, mut paths: PathBatch) -> Self {
        paths.clear();
        let [x, y] = [x, y].map(|at| at / LARGEST_TILE * LARGEST_TILE);
        let root = Tile {
            x,
            y,
            side: LARGEST_TILE,
        };
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

/// The share of the lattice's budget that its error may reach at the points where it is checked; chords
/// take the rest. Three points do not see the largest error: at 640 × 360 with a budget of 0.5 mrad the 99th percentile
/// over all pixels is at most 0.44 mrad in every scene of the gallery, but single pixels reach 18, so a maximum is not
/// bounded by it. With 0.5 frames took 3 to 5 % longer when that was measured, before an error of length counted less.
pub const LATTICE_SHARE: f64 = 0.8;

/// Knots from the end of the piece in which the first of a tile's paths ends back to where ends are
/// looked for: one piece earlier, as a path between them may end a little before.
const LEAD: usize = 3;

/// Most pieces in which the ends of a tile's paths are looked for: each pixel pays for all.
const MOST_LAST_PIECES: usize = 6;

/// As for screen error: magnifications are raised to this before dividing by them.
const LEAST_MAGNIFICATION: f64 = 0.25;

/// Weights of the sixteen paths at each check, and the slopes of the weights along both sides.
static WEIGHTS: LazyLock<[(Lanes, [Lanes; 2]); CHECKS.len()]> = LazyLock::new(|| {
    CHECKS.map(|(i, j)| {
        let [x, y] = [i, j].map(|k| k as f64 / 6.0);
        let product = |x: [f64; 4], y: [f64; 4]| std::array::from_fn(|i| x[i % 4] * y[i / 4]);
        let slopes = [
            product(cubic_slope(x), cubic(y)),
            product(cubic(x), cubic_slope(y)),
        ];
        (product(cubic(x), cubic(y)), slopes)
    })
});

/// Computes the derivatives of [`cubic`].
fn cubic_slope(t: f64) -> [f64; 4] {
    let (a, b, c, d) = (t, t - 1.0 / 3.0, t - 2.0 / 3.0, t - 1.0);
    [
        -4.5 * (c * d + b * d + b * c),
        13.5 * (c * d + a * d + a * c),
        -13.5 * (b * d + a * d + a * b),
        4.5 * (b * c + a * c + a * b),
    ]
}

/// A patch and the paths that it is compared with.
pub(super) struct PatchChecks<'a> {
    patch: &'a PathPatch<'a>,
    truths: [PathView<'a>; CHECKS.len()],
    /// The angle of the tile's side.
    side: f64,
    /// Length by which one radian moves a path in flat space, if it is equal at all arc lengths.
    reach: Option<f64>,
    /// Set if the sky that all paths end in tells where they go: not one of a single colour.
    sky_tells: bool,
}

impl<'a> PatchChecks<'a> {
    /// Compares `patch` with the paths numbered `truths`, where the skies behind some exits are of `one_colour`.
    pub(super) fn new(
        patch: &'a PathPatch<'a>,
        truths: [usize; CHECKS.len()],
        side: f64,
        reach: Option<f64>,
        one_colour: impl Fn(usize) -> bool,
    ) -> Self {
        let tells_nothing = |exit: Option<usize>| exit.is_none_or(one_colour);
        Self {
            sky_tells: !patch.exit().is_some_and(tells_nothing),
            patch,
            truths: truths.map(|i| patch.in_batch(i)),
            side,
            reach,
        }
    }

    /// Returns all paths: the sixteen, and those that check them.
    pub(super) fn all(&self) -> Vec<PathView<'a>> {
        [&self.patch.paths()[..], &self.truths].concat()
    }

    /// Returns the largest error of the sky's direction; infinite if paths leave in several ways, and zero where the sky
    /// tells nothing.
    pub(super) fn sky(&self) -> f64 {
        let sky = |path: &PathView<'_>| match path.ending {
            Some(Ending::Exit { sky, .. }) => sky,
            _ => DVec3::ZERO,
        };
        let exit = |path: &PathView<'_>| path.ending.map(|ending| ending.exit());
        let first = self.patch.exit();
        if first.is_none() || self.truths.iter().any(|truth| exit(truth) != first) {
            return f64::INFINITY;
        }
        if !self.sky_tells {
            return 0.0;
        }
        self.turned(sky)
    }

    /// Returns the pieces in which all paths end, through whatever exit; `None` if they are too many.
    pub(super) fn last_pieces(&self) -> Option<Range<usize>> {
        let (mut first, mut last) = (f64::INFINITY, 0.0_f64);
        for path in self.patch.paths().iter().chain(&self.truths) {
            let limit = path.ending?.limit();
            (first, last) = (first.min(limit), last.max(limit));
        }
        let knots = self.patch.knots();
        let first = knots_until(knots, first).saturating_sub(LEAD);
        let last = knots_until(knots, last);
        let known = self.truths.iter().all(|truth| truth.known >= last);
        (known && last <= first + MOST_LAST_PIECES).then_some(first..last - 1)
    }

    /// Returns the largest error of the paths and of their directions in `pieces`: as much as the event that
    /// ends them and the sky there may be off; infinite where a path comes to a stop.
    pub(super) fn endings(&self, pieces: &Range<usize>) -> f64 {
        let stops = |path: &PathView<'_>| {
            let mut pairs = pieces
                .clone()
                .map(|k| [path.tangent(k), path.tangent(k + 1)]);
            pairs.any(comes_to_a_stop)
        };
        if self.patch.paths().iter().chain(&self.truths).any(stops) {
            return f64::INFINITY;
        }
        let mut worst = 0.0;
        for k in pieces.start.max(1)..=pieces.end {
            let direction = |path: &PathView<'_>| path.tangent(k).normalize_or_zero();
            worst = larger(larger(worst, self.at_knot(k)), self.turned(direction));
        }
        worst
    }

    /// Returns the largest error of the points at both ends of the `pieces` of the path, and, where the sky tells nothing,
    /// of the last before their end: tubes around paths that nothing is known of may miss what these meet.
    pub(super) fn path(&self, pieces: &[usize]) -> f64 {
        let known = self.truths.iter().map(|t| t.known).min().unwrap_or(0);
        let last = self.patch.last().min(known);
        let mut worst = 0.0;
        let mut checked = 0;
        let ends = pieces.iter().flat_map(|k| [*k, k + 1]);
        for k in ends.filter(|k| *k < last) {
            // Shared ends once; at the camera there is nothing to compare.
            if k > checked {
                worst = larger(worst, self.at_knot(k));
                checked = k;
            }
        }
        if !self.sky_tells {
            // The last knot lies behind an exit, where the chart may end.
            let back = 1 + usize::from(self.patch.exit() != Some(None));
            if last > back {
                worst = larger(worst, self.at_knot(last - back));
            }
        }
        worst
    }

    /// Returns the largest error of the points at knot `k`.
    fn at_knot(&self, k: usize) -> f64 {
        self.worst(
            |path| path.point(k),
            |e, columns, truth| {
                let v = truth.tangent(k);
                let reach = self.reach.unwrap_or(truth.knots[k]);
                angle(e, columns, v.normalize_or_zero(), reach * v.length())
            },
        )
    }

    /// Returns the largest error of directions over the checks. Mixed directions are made unit vectors, so that an error of
    /// their length does not show. It counts all the same, at the largest magnification: where directions turn evenly, those
    /// between the checks are off by about as much, across.
    fn turned(&self, direction: impl Fn(&PathView<'_>) -> DVec3) -> f64 {
        self.worst(&direction, |e, columns, truth| {
            let along = direction(truth);
            let fastest = columns[0].length().max(columns[1].length());
            let of_length = e.dot(along).abs() / fastest.max(LEAST_MAGNIFICATION);
            angle(e, columns, along, 1.0) + of_length
        })
    }

    /// Returns the largest error of `value` over the checks, as the angle that `seen` makes of what a mixed value is off and
    /// of how it changes with the two directions of the picture.
    fn worst(
        &self,
        value: impl Fn(&PathView<'_>) -> DVec3,
        seen: impl Fn(DVec3, [DVec3; 2], &PathView<'_>) -> f64,
    ) -> f64 {
        let sixteen = self.patch.paths().each_ref().map(&value);
        let sum =
            |weights: &Lanes| -> DVec3 { weights.iter().zip(&sixteen).map(|(w, x)| *x * *w).sum() };
        let mut worst = 0.0;
        for (truth, (weights, slopes)) in self.truths.iter().zip(WEIGHTS.iter()) {
            let e = sum(weights) - value(truth);
            let columns = slopes.each_ref().map(|w| sum(w) / self.side);
            worst = larger(worst, seen(e, columns, truth));
        }
        worst
    }
}

/// Returns the larger of two; not a number if `new` is not.
fn larger(worst: f64, new: f64) -> f64 {
    if new <= worst { worst } else { new }
}

/// Returns the angle at the camera that looks like the displacement `e` across `along`, where the columns
/// are displacement per radian in two directions of the picture and `unit` is what one radian moves
/// in flat space: damped least squares, and the rest that they leave over at the least magnification.
pub fn angle(e: DVec3, columns: [DVec3; 2], along: DVec3, unit: f64) -> f64 {
    let across = |x: DVec3| x - along * along.dot(x);
    let (e, [a, b]) = (across(e), columns.map(across));
    let floor = LEAST_MAGNIFICATION * unit;
    let damping = floor * floor;
    let (aa, ab, bb) = (a.dot(a) + damping, a.dot(b), b.dot(b) + damping);
    let determinant = aa * bb - ab * ab;
    let (ae, be) = (a.dot(e), b.dot(e));
    let x = (bb * ae - ab * be) / determinant;
    let y = (aa * be - ab * ae) / determinant;
    let rest = e - a * x - b * y;
    x.hypot(y) + rest.length() / floor
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cubic_slopes_are_the_derivatives_of_cubics() {
        let f = |t: f64| 1.0 - 2.0 * t + 3.0 * t * t - 4.0 * t * t * t;
        let slope = |t: f64| -2.0 + 6.0 * t - 12.0 * t * t;
        let nodes = [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0].map(f);
        for t in [0.0, 0.1, 0.5, 0.77, 1.0] {
            let sum: f64 = cubic_slope(t).iter().zip(nodes).map(|(w, f)| w * f).sum();
            assert!((sum - slope(t)).abs() < 1e-13);
        }
    }

    #[test]
    fn displacements_become_angles_by_the_magnification() {
        let columns = [DVec3::X * 8.0, DVec3::Y * 8.0];
        let found = angle(DVec3::new(0.8, 0.0, 5.0), columns, DVec3::Z, 4.0);
        // Damping leaves over a part, which counts at the least magnification: a tenth too much.
        assert!((0.1..0.115).contains(&found), "{found}");
        // Along the direction nothing shows.
        let along = angle(DVec3::Z * 0.1, columns, DVec3::Z, 4.0);
        assert_eq!(along, 0.0);
    }
}
