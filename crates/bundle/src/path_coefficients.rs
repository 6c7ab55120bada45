//! Coefficients of paths in the arc length, taken from the patches of a fan.
//!
//! In: a ray in stored parameters, and the patches that hold it. Each stores rows of channels: the
//! displacement at the start of its arc lengths if that is not the start of the path, and the Chebyshev
//! coefficients of the departure's slope ([`ChartMap::slope`](crate::rays::ChartMap::slope)). Out:
//! [`PathCoefficients`], and departures and slopes at arc lengths, with the points and tangents there.
//!
//! The departure is the integral of its slope, coefficient by coefficient (L. N. Trefethen,
//! *Approximation Theory and Approximation Practice*, exercise 2.8 and chapter 21):
//! `b_k = h (a_{k−1} − a_{k+1})/2k`, with `a₀` doubled, for `h` half the length of the interval. Slopes
//! are stored and not departures, because tangents keep the promise too.

use crate::{
    contracted::{CoefficientRow, Contracted, EMPTY_ROW},
    contraction::ContractedTree,
    rays::{LiftedStart, Located, RaySpace},
    table::Table,
    train_core::MOST_DEGREES,
    tree::{Tree, divided_at_edge, half},
};
use geofan_core::manifold::Isometry;
use geofan_expr::vectorised;
use glam::DVec3;
use std::ops::Range;

/// Takes the coefficients of one direction from a patch.
pub(crate) type Evaluate = for<'r> fn(&Contracted, f64, f64, &'r mut CoefficientRow) -> &'r [f64];

/// Paths of a fan, side by side, as polynomials in the arc length.
#[derive(Debug, Clone, Default)]
pub struct PathCoefficients {
    rays: Vec<StoredRay>,
    /// In order of arc length.
    pieces: Vec<PathPiece>,
    /// Rows as [`unfold`] makes them.
    coefficients: Vec<f64>,
}

/// The stored ray of a path, and its pieces.
#[derive(Debug, Clone)]
pub(crate) struct StoredRay {
    pub start: LiftedStart,
    /// Its chart point and tangent at the start.
    pub u: DVec3,
    pub v: DVec3,
    /// Takes the stored ray to the true one.
    pub isometry: Isometry,
    pieces: Range<usize>,
}

/// A piece of a path.
#[derive(Debug, Clone)]
pub(crate) struct PathPiece {
    /// Its arc lengths.
    pub interval: [f64; 2],
    /// Set if an edge of the metric is at its start.
    pub behind_edge: bool,
    /// The numbers of its rows; `None` where the patch is flagged.
    rows: Option<Range<usize>>,
}

impl PathPiece {
    /// Tells whether the table gives up this piece.
    pub fn is_flagged(&self) -> bool {
        self.rows.is_none()
    }
}

impl PathCoefficients {
    /// Forgets all paths.
    pub fn clear(&mut self) {
        self.rays.clear();
        self.pieces.clear();
        self.coefficients.clear();
    }

    /// Returns the stored ray of a path.
    pub(crate) fn ray(&self, number: usize) -> &StoredRay {
        &self.rays[number]
    }

    /// Returns the pieces of a path.
    pub(crate) fn pieces(&self, number: usize) -> &[PathPiece] {
        &self.pieces[self.rays[number].pieces.clone()]
    }

    /// Iterates over the arc lengths at which the path with this number meets an edge of the metric, or an exit behind which
    /// paths get rough.
    pub fn edges(&self, number: usize) -> impl Iterator<Item = f64> {
        let behind = self.pieces(number).iter().filter(|piece| piece.behind_edge);
        behind.map(|piece| piece.interval[0])
    }

    /// Returns the rows of a piece; none where it is flagged.
    pub(crate) fn rows(&self, piece: &PathPiece) -> &[f64] {
        &self.coefficients[piece.rows.clone().unwrap_or_default()]
    }

    /// Appends the path of a ray of `table` from the patches of `tree` around it, and returns its number.
    pub(crate) fn add(
        &mut self,
        table: &Table,
        tree: &ContractedTree,
        located: Located,
        evaluate: Evaluate,
    ) -> usize {
        let first = self.pieces.len();
        // The direction in the parameters of the whole chunk.
        let direction = match table.space.sphere() {
            Some(sphere) => sphere.parameters(located.aim()),
            None => located.direction,
        };
        let arc_axis = table.space.directions();
        let from = (&located, arc_axis);
        self.collect(tree, from, direction, [0.0, table.length], evaluate);
        // The ray itself, as the chunk stores it.
        self.rays.push(StoredRay {
            start: table.space.chart_map().start(located.u, located.v),
            u: located.u,
            v: located.v,
            isometry: located.isometry,
            pieces: first..self.pieces.len(),
        });
        self.rays.len() - 1
    }

    /// Takes the polynomials of the located ray from all patches that hold it, at parameters `direction`
    /// of the box that `tree` covers; `arc_axis` is the number of the axis of arc length.
    fn collect(
        &mut self,
        tree: &ContractedTree,
        (located, arc_axis): (&Located, usize),
        mut direction: [f64; 2],
        interval: [f64; 2],
        evaluate: Evaluate,
    ) {
        let from = (located, arc_axis);
        match tree {
            Tree::Section(section) => {
                self.collect(section.tree(), from, direction, interval, evaluate);
            }
            Tree::Flagged => self.pieces.push(PathPiece {
                interval,
                behind_edge: false,
                rows: None,
            }),
            Tree::Faces(faces) => {
                let face = &faces[located.face];
                self.collect(face, from, located.direction, interval, evaluate);
            }
            Tree::Edge { place, parts } => {
                let mut row = EMPTY_ROW;
                let place = evaluate(place, direction[0], direction[1], &mut row)[0];
                let [before, behind] = divided_at_edge(interval, place);
                self.collect(&parts[0], from, direction, before, evaluate);
                let first = self.pieces.len();
                self.collect(&parts[1], from, direction, behind, evaluate);
                self.pieces[first].behind_edge = true;
            }
            Tree::Split { axis, halves } if *axis == arc_axis => {
                let middle = 0.5 * (interval[0] + interval[1]);
                let parts = [[interval[0], middle], [middle, interval[1]]];
                for (half, part) in halves.iter().zip(parts) {
                    self.collect(half, from, direction, part, evaluate);
                }
            }
            Tree::Split { axis, halves } => {
                let (side, inner) = half(direction[*axis]);
                direction[*axis] = inner;
                self.collect(&halves[side], from, direction, interval, evaluate);
            }
            Tree::Separatrix {
                place,
                reach,
                sides,
            } => {
                let mut row = EMPTY_ROW;
                let place = place.direction(direction[0], direction[1], &mut row)[0];
                let side = reach.enter(&mut direction, place);
                self.collect(&sides[side], from, direction, interval, evaluate);
            }
            Tree::Leaf(patch) => {
                let mut row = EMPTY_ROW;
                let stored = evaluate(patch, direction[0], direction[1], &mut row);
                let (start, channels) = (self.coefficients.len(), patch.channels());
                unfold(stored, channels, interval, &mut self.coefficients);
                let rows = Some(start..self.coefficients.len());
                self.pieces.push(PathPiece {
                    interval,
                    behind_edge: false,
                    rows,
                });
            }
        }
    }
}

/// Departures and their slopes in the arc length: four channels each, at `W` arc lengths.
pub type ArcSums<const W: usize> = [[[f64; W]; 4]; 2];

/// Tells whether patches of the arc lengths `interval` store their displacement at its start.
pub fn stores_start(interval: [f64; 2]) -> bool {
    interval[0] > 0.0
}

/// Appends to `rows`, for each degree, the coefficients of the departures and then those of the
/// slopes, from what is `stored` for one path. Returns how many degrees there are.
pub fn unfold(stored: &[f64], channels: usize, interval: [f64; 2], rows: &mut Vec<f64>) -> usize {
    match channels {
        1 => unfold_of::<1>(stored, interval, rows),
        2 => unfold_of::<2>(stored, interval, rows),
        3 => unfold_of::<3>(stored, interval, rows),
        _ => unfold_of::<4>(stored, interval, rows),
    }
}

/// Unfolds `C` channels.
fn unfold_of<const C: usize>(stored: &[f64], interval: [f64; 2], rows: &mut Vec<f64>) -> usize {
    let stored = stored.as_chunks::<C>().0;
    let (starts, slopes) = stored.split_at(usize::from(stores_start(interval)));
    let (first, degrees) = (rows.len(), slopes.len() + 1);
    // Slopes first; one degree more, whose slope is zero like that of the last.
    rows.resize(first + 2 * C * (degrees + 1), 0.0);
    let pairs = rows[first..].as_chunks_mut::<C>().0.as_chunks_mut::<2>().0;
    for (pair, slope) in pairs.iter_mut().zip(slopes) {
        pair[1] = *slope;
    }
    // Departures, integrated coefficient by coefficient.
    let half = 0.5 * (interval[1] - interval[0]);
    let mut constant = match starts.first() {
        Some(start) => start.map(|d| d * interval[0]),
        None => [0.0; C],
    };
    for k in 1..degrees {
        let scale = half * HALF_RECIPROCALS[k];
        let (doubled, sign) = (
            if k == 1 { 2.0 } else { 1.0 },
            if k % 2 == 0 { 1.0 } else { -1.0 },
        );
        for c in 0..C {
            let departure = scale * (doubled * pairs[k - 1][1][c] - pairs[k + 1][1][c]);
            pairs[k][0][c] = departure;
            // T_k(−1) = ±1: the departure starts where it is stored to.
            constant[c] -= sign * departure;
        }
    }
    pairs[0][0] = constant;
    rows.truncate(first + 2 * C * degrees);
    degrees
}

/// 1/2k for every degree `k`: divisions would take longer than all the rest.
static HALF_RECIPROCALS: [f64; MOST_DEGREES + 1] = {
    let mut table = [0.0; MOST_DEGREES + 1];
    let mut k = 1;
    while k <= MOST_DEGREES {
        table[k] = 0.5 / k as f64;
        k += 1;
    }
    table
};

/// Sums unfolded `rows` at `W` arc lengths of their interval at once.
pub fn sums<const W: usize>(
    rows: &[f64],
    channels: usize,
    interval: [f64; 2],
    s: &[f64; W],
) -> ArcSums<W> {
    match channels {
        1 => sums_of::<1, W>(rows, interval, s),
        2 => sums_of::<2, W>(rows, interval, s),
        3 => sums_of::<3, W>(rows, interval, s),
        _ => sums_of::<4, W>(rows, interval, s),
    }
}

/// Sums rows of `C` channels: known beforehand, all sums stay in vector registers.
fn sums_of<const C: usize, const W: usize>(
    rows: &[f64],
    interval: [f64; 2],
    s: &[f64; W],
) -> ArcSums<W> {
    vectorised(
        #[inline(always)]
        || sums_inline::<C, W>(rows, interval, s),
    )
}

/// Sums rows of `C` channels inside of a kernel that is compiled for vectors already.
#[inline(always)]
pub(crate) fn sums_inline<const C: usize, const W: usize>(
    rows: &[f64],
    [low, high]: [f64; 2],
    s: &[f64; W],
) -> ArcSums<W> {
    let scale = 2.0 / (high - low);
    let t = s.map(|s| scale * (s - low) - 1.0);
    // Local, so that no sum might overlap what it is made of (see `render::lanes`).
    let mut departures = [[0.0; W]; C];
    let mut slopes = [[0.0; W]; C];
    let (mut value, mut next) = ([1.0; W], t);
    for row in rows.chunks_exact(2 * C) {
        for c in 0..C {
            departures[c] = plus(&departures[c], &value, row[c]);
            slopes[c] = plus(&slopes[c], &value, row[C + c]);
        }
        let after = std::array::from_fn(|l| 2.0 * t[l] * next[l] - value[l]);
        (value, next) = (next, after);
    }
    let mut sums = [[[0.0; W]; 4]; 2];
    sums[0][..C].copy_from_slice(&departures);
    sums[1][..C].copy_from_slice(&slopes);
    sums
}

/// Adds `x value` to `sum`, lane by lane.
#[inline(always)]
fn plus<const W: usize>(sum: &[f64; W], value: &[f64; W], x: f64) -> [f64; W] {
    let mut to = [0.0; W];
    for l in 0..W {
        to[l] = sum[l] + value[l] * x;
    }
    to
}

/// Computes chart point and tangent of the stored ray from `start` at arc length `s`, whose departure and
/// slope are in the lane `lane` of `sums`.
#[inline]
pub fn state<const W: usize>(
    space: &RaySpace,
    start: &LiftedStart,
    sums: &ArcSums<W>,
    lane: usize,
    s: f64,
) -> (DVec3, DVec3) {
    let [mut departure, mut slope] = [[0.0; 4]; 2];
    for (k, channel) in space.channels().iter().enumerate() {
        departure[*channel] = sums[0][k][lane];
        slope[*channel] = sums[1][k][lane];
    }
    space.chart_map().state(start, departure, slope, s)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One channel: 0.3 T₀ − 0.2 T₁ + 0.1 T₂ + 0.05 T₃ in t.
    fn slope(t: f64) -> f64 {
        0.3 - 0.2 * t + 0.1 * (2.0 * t * t - 1.0) + 0.05 * (4.0 * t * t * t - 3.0 * t)
    }

    #[test]
    fn the_departure_is_the_integral_of_the_slope_from_where_it_starts() {
        let coefficients = [0.3, -0.2, 0.1, 0.05];
        for (interval, stored) in [
            ([0.0, 3.0], coefficients.to_vec()),
            ([2.0, 3.0], [&[0.7][..], &coefficients].concat()),
        ] {
            let mut rows = Vec::new();
            assert_eq!(unfold(&stored, 1, interval, &mut rows), 5);
            let at = |s: f64| sums(&rows, 1, interval, &[s]);
            let [low, high] = interval;
            assert!((at(low)[0][0][0] - 0.7 * low).abs() < 1e-14);
            let step = 1e-3;
            let mut integral = at(low)[0][0][0];
            let mut s = low;
            while s < high - 0.5 * step {
                let t = |s: f64| 2.0 * (s - low) / (high - low) - 1.0;
                let [a, b, c] = [s, s + 0.5 * step, s + step].map(|s| slope(t(s)));
                integral += step * (a + 4.0 * b + c) / 6.0;
                s += step;
                let found = at(s);
                assert!((found[0][0][0] - integral).abs() < 1e-12);
                assert!((found[1][0][0] - c).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn a_patch_without_slopes_is_straight() {
        let mut rows = Vec::new();
        assert_eq!(unfold(&[0.5, -0.25], 2, [4.0, 8.0], &mut rows), 1);
        let found = sums(&rows, 2, [4.0, 8.0], &[7.0]);
        assert_eq!(found[0][0][0], 2.0);
        assert_eq!(found[0][1][0], -1.0);
        assert_eq!(found[1][0][0], 0.0);
    }
}
