//! The adaptive screen lattice: few paths, interpolated to every pixel.
//!
//! In: a tracer whose curves share their knots. Out: the [`Outcome`] of every sample. The picture is
//! divided into square tiles; each is spanned by 4 × 4 curves at even spacing, and curves at other
//! points tell whether the bicubic through the sixteen is within the budget. If not, or if the
//! sixteen leave through different exits, the tile is quartered; the smallest are traced sample by
//! sample. A tile whose tube of paths meets no leaf of the scene's tree goes straight to its sky.

use super::{
    curve::{Curve, Ending, EndingFinder, Piece},
    intersect::first_hit,
    outcome::{Outcome, Seen, beyond, outcome},
    tracer::GridTracer,
    view::View,
    world::World,
};
use glam::{DVec2, DVec3};
use ndarray::ArrayViewMut3;
use std::{
    ops::Range,
    sync::Arc,
    time::{Duration, Instant},
};

/// Pixels along a side of the largest tiles.
pub const LARGEST_TILE: usize = 32;

/// Pixels along a side of the smallest tiles: the 16 + 3 curves of a tile of 4 × 4 pixels would
/// cost more than its 16 pixels.
const SMALLEST_TILE: usize = 8;

/// Points of a tile, as fractions of its side, at which the interpolation is compared: the middle
/// and two places where the cubic's error is largest, off the diagonals' symmetry.
const CHECKS: [DVec2; 3] = [
    DVec2::new(0.5, 0.5),
    DVec2::new(0.13, 0.85),
    DVec2::new(0.84, 0.17),
];

/// Every so many knots the paths themselves are compared, besides the sky's direction.
const CHECK_STRIDE: usize = 4;

/// As for screen error (DESIGN §1): magnifications are raised to this before dividing by them.
const LEAST_MAGNIFICATION: f64 = 0.25;

/// A square of pixels.
#[derive(Debug, Clone, Copy)]
pub struct Tile {
    /// Upper left pixel.
    pub x: usize,
    /// Upper left pixel.
    pub y: usize,
    /// Pixels along a side; tiles may reach over the picture's edge.
    pub side: usize,
}

impl Tile {
    fn quarters(self) -> [Tile; 4] {
        let side = self.side / 2;
        [(0, 0), (side, 0), (0, side), (side, side)].map(|(dx, dy)| Tile {
            x: self.x + dx,
            y: self.y + dy,
            side,
        })
    }
}

/// Work done and time spent, summed over threads.
#[derive(Debug, Clone, Copy, Default)]
pub struct LatticeTally {
    /// Curves looked up.
    pub curves: usize,
    /// Samples interpolated.
    pub interpolated: usize,
    /// Samples traced one by one, or put off.
    pub traced: usize,
    /// Time for curves and checks.
    pub lattice: Duration,
    /// Time for samples: interpolation, intersection, and rays traced one by one.
    pub pixels: Duration,
    /// Time for the samples put off, by the clock.
    pub pending: Duration,
}

impl LatticeTally {
    /// The sum of two tallies.
    pub fn plus(self, other: Self) -> Self {
        Self {
            curves: self.curves + other.curves,
            interpolated: self.interpolated + other.interpolated,
            traced: self.traced + other.traced,
            lattice: self.lattice + other.lattice,
            pixels: self.pixels + other.pixels,
            pending: self.pending + other.pending,
        }
    }
}

/// The lattice over one picture.
pub struct Lattice<'a> {
    /// Where the curves come from.
    pub tracer: &'a dyn GridTracer,
    /// What they may meet.
    pub world: &'a World,
    /// The picture.
    pub view: &'a View,
    /// Where in a pixel its samples are, in [0, 1]².
    pub offsets: &'a [DVec2],
    /// Largest error of the interpolation, radians at the camera.
    pub budget: f64,
}

/// Row, column and number of a sample.
pub type Place = (usize, usize, usize);

/// What the samples of one of the largest tiles find.
pub struct Found<'o> {
    /// The tile's upper left pixel: row and column.
    pub corner: (usize, usize),
    /// Its outcomes, axes (row, column, sample) from the corner.
    pub outcomes: ArrayViewMut3<'o, Outcome>,
    /// Samples put off, with their directions: to be traced together, so that lanes are full.
    pub pending: Vec<(Place, DVec3)>,
    /// Work and time.
    pub tally: LatticeTally,
}

impl<'o> Found<'o> {
    /// Nothing yet.
    pub fn new(corner: (usize, usize), outcomes: ArrayViewMut3<'o, Outcome>) -> Self {
        Self {
            corner,
            outcomes,
            pending: Vec::new(),
            tally: LatticeTally::default(),
        }
    }

    fn put(&mut self, (y, x, k): Place, outcome: Outcome) {
        self.outcomes[(y - self.corner.0, x - self.corner.1, k)] = outcome;
    }
}

impl<'a> Lattice<'a> {
    /// All samples of `tile`, into `found`.
    pub fn tile(&self, tile: Tile, endings: &mut EndingFinder<'_>, found: &mut Found<'_>) {
        if tile.x >= self.view.size.0 || tile.y >= self.view.size.1 {
            return;
        }
        let began = Instant::now();
        let sheet = self.sheet(tile, endings, &mut found.tally);
        found.tally.lattice += began.elapsed();
        let began = Instant::now();
        match sheet {
            Some(sheet) => self.interpolate(tile, &sheet, found),
            None if tile.side > SMALLEST_TILE => {
                for quarter in tile.quarters() {
                    self.tile(quarter, endings, found);
                }
                return;
            }
            None => self.trace(tile, endings, found),
        }
        found.tally.pixels += began.elapsed();
    }

    /// The sixteen curves of a tile, if they can be interpolated within the budget.
    fn sheet(
        &self,
        tile: Tile,
        endings: &mut EndingFinder<'_>,
        tally: &mut LatticeTally,
    ) -> Option<Sheet> {
        let mut curve = |at: DVec2| {
            tally.curves += 1;
            let (x, y) = (
                tile.x as f64 + at.x * tile.side as f64,
                tile.y as f64 + at.y * tile.side as f64,
            );
            self.tracer.on_knots(self.view.direction(x, y), endings)
        };
        let mut curves: Vec<Curve> = Vec::with_capacity(16);
        for i in 0..16 {
            let next = curve(DVec2::new((i % 4) as f64, (i / 4) as f64) / 3.0)?;
            if curves
                .first()
                .is_some_and(|c| c.ending.exit() != next.ending.exit())
            {
                return None;
            }
            curves.push(next);
        }
        let sheet = Sheet { curves };
        let pixel = self.view.pixel_angle() * tile.side as f64;
        for at in CHECKS {
            let truth = curve(at)?;
            if !(sheet.error(at, &truth, pixel) <= self.budget) {
                return None;
            }
        }
        Some(sheet)
    }

    /// Rows and columns of the tile that are in the picture.
    fn extent(&self, tile: Tile) -> (Range<usize>, Range<usize>) {
        (
            tile.y..(tile.y + tile.side).min(self.view.size.1),
            tile.x..(tile.x + tile.side).min(self.view.size.0),
        )
    }

    fn interpolate(&self, tile: Tile, sheet: &Sheet, found: &mut Found<'_>) {
        let touched = sheet.touched(self.world);
        let side = tile.side as f64;
        let (rows, columns) = self.extent(tile);
        for y in rows {
            for (k, offset) in self.offsets.iter().enumerate() {
                let row = sheet.row(&touched, ((y - tile.y) as f64 + offset.y) / side);
                for x in columns.clone() {
                    let weights = cubic(((x - tile.x) as f64 + offset.x) / side);
                    let (seen, flagged) = (self.seen(&row, &touched, weights), false);
                    found.put((y, x, k), Outcome { seen, flagged });
                }
                found.tally.interpolated += columns.len();
            }
        }
    }

    fn seen(&self, row: &Row, touched: &Touched, weights: [f64; 4]) -> Seen {
        let ending = row.ending(weights);
        for (k, at) in touched.pieces.iter().zip(&touched.knot_of) {
            let piece = Piece {
                s: [touched.s[*k], touched.s[*k + 1]],
                u: [at, &(at + 1)].map(|&i| blend(&row.u[i], weights)),
                v: [at, &(at + 1)].map(|&i| blend(&row.v[i], weights)),
            };
            if piece.s[0] >= ending.limit() {
                break;
            }
            let domain = &self.world.manifold.domain;
            if let Some(hit) = first_hit(&self.world.accelerator, domain, &piece, ending.limit()) {
                return Seen::Surface(hit);
            }
        }
        beyond(&ending)
    }

    /// The samples of `tile` one by one; those that the tracer cannot give on its knots are put off.
    fn trace(&self, tile: Tile, endings: &mut EndingFinder<'_>, found: &mut Found<'_>) {
        let (rows, columns) = self.extent(tile);
        for (y, x) in rows.flat_map(|y| columns.clone().map(move |x| (y, x))) {
            for (k, offset) in self.offsets.iter().enumerate() {
                let direction = self
                    .view
                    .direction(x as f64 + offset.x, y as f64 + offset.y);
                match self.tracer.on_knots(direction, endings) {
                    Some(curve) => found.put((y, x, k), outcome(self.world, &curve)),
                    None => found.pending.push(((y, x, k), direction)),
                }
            }
        }
    }
}

/// Sixteen curves with common knots and a common exit.
struct Sheet {
    curves: Vec<Curve>,
}

/// Weights of the sixteen curves at a point of the tile.
struct Weights([f64; 16]);

impl Weights {
    fn at(t: DVec2) -> Self {
        Self::product(cubic(t.x), cubic(t.y))
    }

    /// Weights that give the derivatives along both sides of the tile.
    fn slopes(t: DVec2) -> [Self; 2] {
        [
            Self::product(cubic_slope(t.x), cubic(t.y)),
            Self::product(cubic(t.x), cubic_slope(t.y)),
        ]
    }

    fn product(x: [f64; 4], y: [f64; 4]) -> Self {
        Self(std::array::from_fn(|i| x[i % 4] * y[i / 4]))
    }
}

/// Lagrange's cubic weights at `t` for nodes 0, 1/3, 2/3, 1.
fn cubic(t: f64) -> [f64; 4] {
    let (a, b, c, d) = (t, t - 1.0 / 3.0, t - 2.0 / 3.0, t - 1.0);
    [
        -4.5 * b * c * d,
        13.5 * a * c * d,
        -13.5 * a * b * d,
        4.5 * a * b * c,
    ]
}

/// The derivatives of [`cubic`].
fn cubic_slope(t: f64) -> [f64; 4] {
    let (a, b, c, d) = (t, t - 1.0 / 3.0, t - 2.0 / 3.0, t - 1.0);
    [
        -4.5 * (c * d + b * d + b * c),
        13.5 * (c * d + a * d + a * c),
        -13.5 * (b * d + a * d + a * b),
        4.5 * (b * c + a * c + a * b),
    ]
}

impl Sheet {
    fn sum(&self, weights: &Weights, value: impl Fn(&Curve) -> DVec3) -> DVec3 {
        self.curves
            .iter()
            .zip(weights.0)
            .map(|(c, w)| value(c) * w)
            .sum()
    }

    /// The four curves to blend along a row of samples at the fraction `t` of the tile's height.
    fn row(&self, touched: &Touched, t: f64) -> Row {
        let weights = cubic(t);
        let column = |x: usize, value: &dyn Fn(&Curve) -> DVec3| -> DVec3 {
            (0..4)
                .map(|y| value(&self.curves[4 * y + x]) * weights[y])
                .sum()
        };
        let four = |value: &dyn Fn(&Curve) -> DVec3| [0, 1, 2, 3].map(|x| column(x, value));
        let limit = |x: usize| -> f64 {
            (0..4)
                .map(|y| self.curves[4 * y + x].ending.limit() * weights[y])
                .sum()
        };
        Row {
            exit: self.curves[0].ending.exit(),
            limit: [0, 1, 2, 3].map(limit),
            sky: four(&sky),
            u: touched.knots.iter().map(|&k| four(&|c| c.u[k])).collect(),
            v: touched.knots.iter().map(|&k| four(&|c| c.v[k])).collect(),
        }
    }

    /// The knots up to which the curves matter.
    fn last(&self) -> usize {
        let s = &self.curves[0].s;
        let known = self.curves.iter().map(|c| c.u.len()).min().unwrap_or(0);
        let limit = self
            .curves
            .iter()
            .map(|c| c.ending.limit())
            .fold(0.0, f64::max);
        (s.partition_point(|s| *s < limit) + 1).min(known)
    }

    /// The pieces whose tube may meet the scene. The tube's box holds the sixteen curves and a
    /// margin for what the interpolation adds between them.
    fn touched(&self, world: &World) -> Touched {
        let mut touched = Touched {
            s: self.curves[0].s.clone(),
            pieces: Vec::new(),
            knot_of: Vec::new(),
            knots: Vec::new(),
        };
        if world.faces.is_empty() {
            return touched;
        }
        let periodic = world.manifold.domain.periodic.iter().any(|p| *p);
        for k in 0..self.last().saturating_sub(1) {
            let mut boxes = self.curves.iter().map(|c| c.piece(k).bounds());
            let (mut low, mut high) = boxes.next().unwrap_or_default();
            for (l, h) in boxes {
                (low, high) = (low.min(l), high.max(h));
            }
            let margin = DVec3::splat(0.15 * (high - low).max_element());
            // Glued coordinates: the pieces themselves are tried in all periods.
            if periodic || world.accelerator.touches(low - margin, high + margin) {
                if touched.knots.last() != Some(&k) {
                    touched.knots.push(k);
                }
                touched.knot_of.push(touched.knots.len() - 1);
                touched.knots.push(k + 1);
                touched.pieces.push(k);
            }
        }
        touched
    }

    /// The largest error of the interpolation at `at`, as an angle at the camera: of the points of
    /// the path and of the sky's direction, against `truth`. `side` is the tile's angle.
    fn error(&self, at: DVec2, truth: &Curve, side: f64) -> f64 {
        if truth.ending.exit() != self.curves[0].ending.exit() {
            return f64::INFINITY;
        }
        let (weights, slopes) = (Weights::at(at), Weights::slopes(at));
        let compare = |value: &dyn Fn(&Curve) -> DVec3, along: DVec3, unit: f64| {
            let e = self.sum(&weights, value) - value(truth);
            let columns = slopes.each_ref().map(|w| self.sum(w, value) / side);
            angle(e, columns, along, unit)
        };
        let mut worst: f64 = 0.0;
        if truth.ending.exit().is_some() {
            worst = compare(&sky, DVec3::ZERO, 1.0);
        }
        let last = self.last().min(truth.u.len());
        for k in (CHECK_STRIDE..last).step_by(CHECK_STRIDE) {
            let v = truth.v[k];
            let error = compare(&|c| c.u[k], v.normalize_or_zero(), truth.s[k] * v.length());
            worst = if error > worst || error.is_nan() {
                error
            } else {
                worst
            };
        }
        worst
    }
}

/// The pieces of a tile's curves that may meet the scene, and the knots they need.
struct Touched {
    /// Arc lengths of all knots.
    s: Arc<[f64]>,
    /// The pieces.
    pieces: Vec<usize>,
    /// For each, the place of its first knot in `knots`; its second follows.
    knot_of: Vec<usize>,
    /// The knots, ascending.
    knots: Vec<usize>,
}

/// What is blended along one row of samples: four values of everything.
struct Row {
    exit: Option<usize>,
    limit: [f64; 4],
    sky: [DVec3; 4],
    u: Vec<[DVec3; 4]>,
    v: Vec<[DVec3; 4]>,
}

impl Row {
    fn ending(&self, weights: [f64; 4]) -> Ending {
        let Some(exit) = self.exit else {
            return Ending::Nowhere;
        };
        Ending::Exit {
            exit,
            s: self.limit.iter().zip(weights).map(|(s, w)| s * w).sum(),
            sky: blend(&self.sky, weights).normalize_or_zero(),
        }
    }
}

fn blend(values: &[DVec3; 4], w: [f64; 4]) -> DVec3 {
    values[0] * w[0] + values[1] * w[1] + values[2] * w[2] + values[3] * w[3]
}

fn sky(curve: &Curve) -> DVec3 {
    match curve.ending {
        Ending::Exit { sky, .. } => sky,
        Ending::Nowhere => DVec3::ZERO,
    }
}

/// The angle at the camera that looks like the displacement `e` across `along`, where the columns
/// are displacement per radian in two directions of the picture and `unit` is what one radian moves
/// in flat space: damped least squares, and what they leave over at the least magnification.
fn angle(e: DVec3, columns: [DVec3; 2], along: DVec3, unit: f64) -> f64 {
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
    fn cubic_weights_reproduce_cubics_and_their_slopes() {
        let f = |t: f64| 1.0 - 2.0 * t + 3.0 * t * t - 4.0 * t * t * t;
        let slope = |t: f64| -2.0 + 6.0 * t - 12.0 * t * t;
        let nodes = [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0].map(f);
        for t in [0.0, 0.1, 0.5, 0.77, 1.0] {
            let sum = |w: [f64; 4]| w.iter().zip(nodes).map(|(w, f)| w * f).sum::<f64>();
            assert!((sum(cubic(t)) - f(t)).abs() < 1e-14);
            assert!((sum(cubic_slope(t)) - slope(t)).abs() < 1e-13);
        }
    }

    #[test]
    fn displacements_become_angles_by_the_magnification() {
        let columns = [DVec3::X * 8.0, DVec3::Y * 8.0];
        let found = angle(DVec3::new(0.8, 0.0, 5.0), columns, DVec3::Z, 4.0);
        // Damping leaves over a part, which counts at the least magnification: a tenth too much.
        assert!((0.1..0.115).contains(&found), "{found}");
    }
}
