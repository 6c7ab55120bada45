//! Many paths at common arc lengths, side by side.
//!
//! In: chart points and tangents at knots, six rows for each path. Out: a [`PathBatch`], from which
//! tiles take what they interpolate, and one of its paths as a [`PathView`]. Components of one path are
//! contiguous, so that everything that is computed knot by knot is computed in vectors.

use super::{
    curve::{Cubic, Ending},
    lanes::{LANES, less, more, single},
};
use geofan_bundle::{PathCoefficients, rays::Orbit};
use geofan_expr::vectorised;
use glam::DVec3;
use std::{
    mem::{replace, take},
    ops::Range,
    sync::Arc,
};

/// Rows of a path: x, y, z and the components of the tangent.
pub const ROWS: usize = 6;

/// Paths at common knots.
#[derive(Debug, Clone)]
pub struct PathBatch {
    knots: Arc<[f64]>,
    /// Directions at the camera, in the standard frame.
    directions: Vec<DVec3>,
    /// Their rows; behind the last path is the rest of earlier ones.
    blocks: Vec<RowBlock>,
    known: Vec<usize>,
    endings: Vec<Option<Ending>>,
    /// Coefficients that a tracer took from its table for some of the paths.
    coefficients: PathCoefficients,
    sources: Vec<PathOrigin>,
}

/// Paths of a [`RowBlock`].
const BLOCK: usize = 32;

/// Room for the rows of [`BLOCK`] paths. Thousands of paths take megabytes: in one list they would be copied whenever
/// it grows, and take up to three times as much while that is done.
#[derive(Debug, Clone)]
struct RowBlock {
    /// Six rows for each path, each as long as there are knots.
    values: Vec<f64>,
    /// [`PathView::boxes`] of each path.
    boxes: Vec<f32>,
}

impl RowBlock {
    fn new(knots: usize) -> Self {
        Self {
            values: vec![0.0; BLOCK * ROWS * knots],
            boxes: vec![0.0; BLOCK * ROWS * pieces_row(knots)],
        }
    }
}

/// The place that a tracer took a path from, to take more from there.
#[derive(Debug, Clone, Copy)]
pub(super) enum PathOrigin {
    /// The path on its knots is all there is.
    Knots,
    /// From a table, with this number among the coefficients.
    Table(usize),
    /// From a family.
    Family(Orbit),
}

/// One path at knots, most often of a [`PathBatch`].
#[derive(Debug, Clone, Copy)]
pub struct PathView<'a> {
    /// Arc lengths of the knots.
    pub knots: &'a [f64],
    /// Direction at the camera, in the standard frame.
    pub direction: DVec3,
    /// Six rows, each as long as `knots`.
    pub(super) rows: &'a [f64],
    /// Boxes around the cubics between knots: the least x, y and z of each piece, then the largest, in rows
    /// of [`pieces_row`] numbers. Empty for a path outside a [`PathBatch`].
    pub(super) boxes: &'a [f32],
    /// Number of knots that are known.
    pub known: usize,
    /// Its end; `None` where the tracer cannot give it on these knots.
    pub ending: Option<Ending>,
    /// The coefficients that its tracer took from a table, and where the path is.
    pub(super) source: (&'a PathCoefficients, &'a PathOrigin),
}

impl PathBatch {
    /// Makes an empty batch at `knots`.
    pub fn new(knots: Arc<[f64]>) -> Self {
        Self {
            knots,
            directions: Vec::new(),
            blocks: Vec::new(),
            known: Vec::new(),
            endings: Vec::new(),
            coefficients: PathCoefficients::default(),
            sources: Vec::new(),
        }
    }

    /// Returns the number of paths.
    pub fn len(&self) -> usize {
        self.known.len()
    }

    /// Tells whether there are none.
    pub fn is_empty(&self) -> bool {
        self.known.is_empty()
    }

    /// Moves all paths out; an empty batch at the same knots stays.
    pub fn take(&mut self) -> Self {
        let none = Self::new(self.knots.clone());
        replace(self, none)
    }

    /// Forgets all paths and keeps their memory.
    pub fn clear(&mut self) {
        self.directions.clear();
        self.known.clear();
        self.endings.clear();
        self.coefficients.clear();
        self.sources.clear();
    }

    /// Lets `add` add paths, some of them with coefficients.
    pub(super) fn with_coefficients(&mut self, add: impl FnOnce(&mut Self, &mut PathCoefficients)) {
        let mut coefficients = take(&mut self.coefficients);
        add(self, &mut coefficients);
        self.coefficients = coefficients;
    }

    /// Makes room for `count` more.
    pub fn reserve(&mut self, count: usize) {
        let (blocks, knots) = ((self.len() + count).div_ceil(BLOCK), self.knots.len());
        let blocks = blocks.max(self.blocks.len());
        self.blocks.resize_with(blocks, || RowBlock::new(knots));
    }

    /// Adds the path in `direction`, which comes from `source`: `fill` writes its rows and returns the
    /// number of known knots, `end` returns its ending.
    pub(super) fn push(
        &mut self,
        (direction, source): (DVec3, PathOrigin),
        fill: impl FnOnce(&[f64], &mut [f64]) -> usize,
        end: impl FnOnce(PathView<'_>) -> Option<Ending>,
    ) {
        self.reserve(1);
        // The rows, and boxes around what is between them.
        let (block, [values, boxes]) = self.place(self.len());
        let block = &mut self.blocks[block];
        let rows = &mut block.values[values.clone()];
        let known = fill(&self.knots, rows);
        stay(rows, self.knots.len(), known);
        surround(&self.knots, rows, &mut block.boxes[boxes.clone()]);
        // The ending, found on the path as it is so far.
        let path = PathView {
            knots: &self.knots,
            direction,
            rows: &block.values[values],
            boxes: &block.boxes[boxes],
            known,
            ending: None,
            source: (&self.coefficients, &source),
        };
        self.endings.push(end(path));
        self.directions.push(direction);
        self.known.push(known);
        self.sources.push(source);
    }

    /// Widens the boxes of the last path in the `pieces` in which it meets an edge of the metric: it runs along the tangent at one
    /// of their ends and then along that at the other.
    pub(super) fn widen_at_edges(&mut self, pieces: impl Iterator<Item = usize>) {
        let last = self.len() - 1;
        let (block, [_, boxes]) = self.place(last);
        let width = pieces_row(self.knots.len());
        for k in pieces.take_while(|k| k + 1 < self.known[last]) {
            let Cubic { s, u, v } = self.path(last).piece(k);
            let ways = [u[0] + v[0] * (s[1] - s[0]), u[1] - v[1] * (s[1] - s[0])];
            let boxes = &mut self.blocks[block].boxes[boxes.clone()];
            for (way, c) in ways.iter().flat_map(|way| (0..3).map(move |c| (way, c))) {
                let rounding = f64::from(f32::EPSILON) * way[c].abs();
                let (low, high) = ((way[c] - rounding) as f32, (way[c] + rounding) as f32);
                let [least, most] = [c, 3 + c].map(|side| side * width + k);
                (boxes[least], boxes[most]) = (less(low, boxes[least]), more(high, boxes[most]));
            }
        }
    }

    /// Returns the arc lengths of the knots.
    pub fn knots(&self) -> &Arc<[f64]> {
        &self.knots
    }

    /// Returns the block of the path numbered `i`, and there the places of its rows and its boxes.
    fn place(&self, i: usize) -> (usize, [Range<usize>; 2]) {
        let (knots, within) = (self.knots.len(), i % BLOCK);
        let places = [knots, pieces_row(knots)];
        let places = places.map(|row| within * ROWS * row..(within + 1) * ROWS * row);
        (i / BLOCK, places)
    }

    /// Returns the path numbered `i`.
    pub fn path(&self, i: usize) -> PathView<'_> {
        let (block, [values, boxes]) = self.place(i);
        let block = &self.blocks[block];
        PathView {
            knots: &self.knots,
            direction: self.directions[i],
            rows: &block.values[values],
            boxes: &block.boxes[boxes],
            known: self.known[i],
            ending: self.endings[i],
            source: (&self.coefficients, &self.sources[i]),
        }
    }
}

/// Lets a path stay where it is beyond its known knots, so that boxes around it stay small.
pub fn stay(rows: &mut [f64], knots: usize, known: usize) {
    if known == knots {
        return;
    }
    for (c, row) in rows.chunks_exact_mut(knots).enumerate() {
        let last = match known {
            1.. if c < 3 => row[known - 1],
            _ => 0.0,
        };
        row[known..].fill(last);
    }
}

/// Returns the length of a row with a number for each piece between `knots` knots, padded to whole vectors.
pub fn pieces_row(knots: usize) -> usize {
    knots.saturating_sub(1).next_multiple_of(LANES)
}

/// Computes the [`PathView::boxes`] of a path: around the control points of its cubics, rounded outwards.
/// By whole vectors as far as there are; paths of a table have no rest.
fn surround(knots: &[f64], rows: &[f64], boxes: &mut [f32]) {
    let (n, width) = (knots.len(), pieces_row(knots.len()));
    let whole = n - n % LANES;
    vectorised(
        #[inline(always)]
        || {
            for first in (0..whole).step_by(LANES) {
                let [from, to] = ends(knots, first, |x| x);
                let thirds = single(|l| third(from[l], to[l]));
                for c in 0..3 {
                    let [a, d] = ends(&rows[c * n..(c + 1) * n], first, |x| x as f32);
                    let [v, w] = ends(&rows[(3 + c) * n..(4 + c) * n], first, |x| x as f32);
                    let (mut low, mut high) = ([0.0; LANES], [0.0; LANES]);
                    for l in 0..LANES {
                        (low[l], high[l]) = interval(thirds[l], [a[l], d[l]], [v[l], w[l]]);
                    }
                    for (row, numbers) in [(c, low), (3 + c, high)] {
                        boxes[row * width + first..][..LANES].copy_from_slice(&numbers);
                    }
                }
            }
            for k in whole..n - 1 {
                let third = third(knots[k], knots[k + 1]);
                for c in 0..3 {
                    let at = |row: usize| [0, 1].map(|end| rows[row * n + k + end] as f32);
                    let (low, high) = interval(third, at(c), at(3 + c));
                    (boxes[c * width + k], boxes[(3 + c) * width + k]) = (low, high);
                }
            }
        },
    );
}

/// Returns a third of the distance from one knot to the next.
#[inline(always)]
fn third(from: f64, to: f64) -> f32 {
    ((to - from) * (1.0 / 3.0)) as f32
}

/// Returns the interval around one component of a cubic whose control points are a `third` of its length
/// apart, with these values and slopes at its ends. Single precision moves a control point by at most four
/// last places of the largest one: one of slope and third, for a step that is at most twice as large, and
/// of each sum.
#[inline(always)]
fn interval(third: f32, [a, d]: [f32; 2], [v, w]: [f32; 2]) -> (f32, f32) {
    let (b, c) = (a + v * third, d - w * third);
    let (low, high) = (less(less(a, b), less(c, d)), more(more(a, b), more(c, d)));
    let rounding = 4.0 * f32::EPSILON * more(-low, high);
    (low - rounding, high + rounding)
}

/// Returns the numbers of a row, converted once, at both ends of sixteen pieces from `first` on; behind the last piece
/// both are equal.
#[inline(always)]
fn ends<T: Copy>(row: &[f64], first: usize, convert: impl Fn(f64) -> T) -> [[T; LANES]; 2] {
    let numbers = &row[first..first + LANES];
    let mut from = [convert(numbers[0]); LANES];
    for l in 0..LANES {
        from[l] = convert(numbers[l]);
    }
    let mut to = from;
    to[..LANES - 1].copy_from_slice(&from[1..]);
    to[LANES - 1] = convert(*row.get(first + LANES).unwrap_or(&numbers[LANES - 1]));
    [from, to]
}

/// Returns how many of the `knots` matter to a path that ends at `limit`: up to the first that is not
/// before it.
pub fn knots_until(knots: &[f64], limit: f64) -> usize {
    (knots.partition_point(|s| *s < limit) + 1).min(knots.len())
}

/// Returns the number of the piece between two `knots` in which the arc length `s` is.
pub fn piece_at(knots: &[f64], s: f64) -> usize {
    knots_until(knots, s).saturating_sub(2)
}

/// Writes a point and a tangent into column `i` of six rows.
pub fn put(rows: &mut [f64], i: usize, (u, v): (DVec3, DVec3)) {
    let n = rows.len() / ROWS;
    for c in 0..3 {
        (rows[c * n + i], rows[(3 + c) * n + i]) = (u[c], v[c]);
    }
}

impl<'a> PathView<'a> {
    /// Returns component `c` (below 6) at all knots.
    #[inline(always)]
    pub fn row(&self, c: usize) -> &'a [f64] {
        let n = self.knots.len();
        &self.rows[c * n..(c + 1) * n]
    }

    /// Returns the chart point at knot `k`.
    #[inline(always)]
    pub fn point(&self, k: usize) -> DVec3 {
        DVec3::new(self.row(0)[k], self.row(1)[k], self.row(2)[k])
    }

    /// Returns the tangent at knot `k`.
    #[inline(always)]
    pub fn tangent(&self, k: usize) -> DVec3 {
        DVec3::new(self.row(3)[k], self.row(4)[k], self.row(5)[k])
    }

    /// Returns one side of the boxes around all pieces: sides 0 to 2 are the least x, y, z, then come the
    /// largest.
    #[inline(always)]
    pub(super) fn side(&self, side: usize) -> &'a [f32] {
        let width = self.boxes.len() / ROWS;
        &self.boxes[side * width..(side + 1) * width]
    }

    /// Returns the cubic from knot `k` to the next.
    pub fn piece(&self, k: usize) -> Cubic {
        Cubic {
            s: [self.knots[k], self.knots[k + 1]],
            u: [self.point(k), self.point(k + 1)],
            v: [self.tangent(k), self.tangent(k + 1)],
        }
    }

    /// Returns the chart point at arc length `s` on the cubics between the knots; `None` beyond the last
    /// known knot.
    pub fn position(&self, s: f64) -> Option<DVec3> {
        let next = self.knots.partition_point(|knot| *knot < s).max(1);
        if next >= self.known {
            return None;
        }
        let piece = self.piece(next - 1);
        Some(piece.position(piece.fraction(s)))
    }

    /// Samples points and tangents at the ascending arc lengths `s` on the cubics between the knots, into
    /// six rows as long as `s`.
    pub fn sample(&self, s: &[f64], rows: &mut [f64]) {
        for (i, &at) in s.iter().enumerate() {
            let next = self.knots.partition_point(|knot| *knot < at);
            let piece = self.piece(next.clamp(1, self.knots.len() - 1) - 1);
            let t = piece.fraction(at);
            put(rows, i, (piece.position(t), piece.tangent(t)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::random::Stream;

    #[test]
    fn boxes_hold_the_cubics_between_any_number_of_knots() {
        let mut stream = Stream::new(&[5]);
        for count in [2, 16, 17, 20, 33] {
            let knots: Arc<[f64]> = (0..count).map(|k| 0.7 * k as f64).collect();
            let mut paths = PathBatch::new(knots);
            for _ in 0..20 {
                let size = 10_f64.powf(stream.between(-3.0, 3.0));
                let fill = |_: &[f64], rows: &mut [f64]| {
                    rows.fill_with(|| size * stream.between(-1.0, 1.0));
                    count
                };
                paths.push((DVec3::X, PathOrigin::Knots), fill, |_| None);
            }
            for path in (0..paths.len()).map(|i| paths.path(i)) {
                for (k, t) in (0..count - 1).flat_map(|k| (0..=20).map(move |t| (k, t))) {
                    let at = path.piece(k).position(f64::from(t) / 20.0);
                    for c in 0..3 {
                        let [low, high] = [c, 3 + c].map(|side| f64::from(path.side(side)[k]));
                        assert!(
                            low <= at[c] && at[c] <= high,
                            "{count} {k} {low} {} {high}",
                            at[c]
                        );
                    }
                }
            }
        }
    }
}
