//! Paths from one camera along an interval of the single parameter that tells them apart.
//!
//! In: an interval. Out: the stored plane's points and tangents at all knots and at the path's end as
//! polynomials in the parameter ([`FamilyInterval`]), if those through a few paths have converged, and from
//! them one path ([`FamilyPath`]): a few dozen sums in place of a patch's rows and Chebyshev sums along the
//! arc. What is between two knots is known as well, once it has been asked for.

mod end;
mod sixteen;

pub(super) use sixteen::refine_sixteen;

use super::{
    endings::EventLocator,
    lanes::{LANES, SingleLanes, single},
    strands::{ROWS, put},
};
use end::{End, event};
use geofan_bundle::{Fan, TablePath, chebyshev, product};
use geofan_expr::vectorised;
use glam::{DMat3, DVec3};
use std::sync::{Arc, LazyLock, OnceLock};

/// Paths along an interval. On the wormhole gallery's near half frames with 6 take a tenth longer (more
/// intervals), with 10 some hundredths (longer sums).
const NODES: usize = 8;

/// What the last two coefficients may be, as an angle at the camera: a small part of any promise, and
/// the next ones are smaller still.
const TOLERANCE: f64 = 1e-5;

/// x, y and the tangent's two components: what differs from zero in the stored plane.
const PLANE: usize = 4;

/// Where those are among the rows of a path.
const STORED: [usize; PLANE] = [0, 1, 3, 4];

/// Coefficients of a point and a tangent, axes (degree, [`PLANE`]).
type Coefficients = [[f64; PLANE]; NODES];

/// Those at sixteen arc lengths.
type Between = Box<[Coefficients; LANES]>;

/// Coefficients at the knots of a block, axes (degree, [`PLANE`], knot).
#[repr(align(64))]
#[derive(Clone)]
struct Block([[SingleLanes; PLANE]; NODES]);

/// The paths of one interval.
pub(super) struct FamilyInterval<'f> {
    /// Those at the nodes.
    paths: Vec<TablePath<'f>>,
    knots: Arc<[f64]>,
    /// Coefficients at the knots, a block of them after the other.
    table: Vec<Block>,
    /// The same at sixteen arc lengths from each knot to the next, by state.
    between: Box<[OnceLock<Between>]>,
    end: Option<End>,
}

/// A path in its strip.
pub(super) struct FamilyPath<'p, 'f> {
    strip: &'p FamilyInterval<'f>,
    weights: [f64; NODES],
    /// Takes the stored plane to the true one.
    rotation: DMat3,
}

impl<'f> FamilyInterval<'f> {
    /// The paths of an interval of a face of `fan`; `None` if more would have to be known of them, or
    /// the table gave up on one.
    pub(super) fn new(
        fan: &'f Fan,
        (face, [low, high]): (usize, [f64; 2]),
        knots: &Arc<[f64]>,
        endings: &mut EventLocator<'_>,
    ) -> Option<Self> {
        let n = knots.len();
        let along = |x: &f64| fan.stored_path(face, [low + 0.5 * (x + 1.0) * (high - low), 0.0]);
        let paths: Vec<_> = chebyshev::nodes(NODES).iter().map(along).collect();
        let sampled: Option<Vec<Vec<f64>>> = paths.iter().map(|path| sample(path, knots)).collect();
        let sampled = sampled?;
        let coefficients = transformed(&in_plane(&sampled));
        if !has_converged(&coefficients, knots) {
            return None;
        }
        let end = match fan.space().ends_alike() {
            true => {
                let both = paths.iter().zip(&sampled);
                let events: Vec<_> = both
                    .map(|(path, rows)| event(path, knots, rows, endings))
                    .collect();
                End::of(&events, fan.space().skies_turn().then_some(endings))
            }
            false => None,
        };
        Some(Self {
            table: in_blocks(&coefficients, n),
            between: (1..n).map(|_| OnceLock::new()).collect(),
            knots: knots.clone(),
            paths,
            end,
        })
    }

    /// Whether the end of all paths is known.
    pub(super) fn knows_end(&self) -> bool {
        self.end.is_some()
    }

    /// The path at the place `x` in [−1, 1] of the interval, with the stored plane turned by `rotation`.
    pub(super) fn rung(&self, x: f64, rotation: DMat3) -> FamilyPath<'_, 'f> {
        let mut weights = [0.0; NODES];
        chebyshev::values(x, &mut weights);
        FamilyPath {
            strip: self,
            weights,
            rotation,
        }
    }

    /// Where ascending arc lengths are on cubics between sixteen points from each knot to the next: what
    /// those between knots miss the path by falls by fifteen to the fourth.
    fn along(&self, s: &[f64]) -> impl Iterator<Item = OnCubic<'_>> {
        let mut known: Option<usize> = None;
        s.iter().map(move |&at| {
            // What ends a piece belongs to it, what begins one does not ask for the piece before.
            let k = known.filter(|k| at <= self.knots[k + 1]);
            let k = k.unwrap_or_else(|| {
                let next = self.knots.partition_point(|knot| *knot <= at);
                next.clamp(1, self.knots.len() - 1) - 1
            });
            known = Some(k);
            self.cubic(k, at)
        })
    }

    /// Where arc length `at` is on the cubic between two of sixteen points from knot `k` to the next.
    fn cubic(&self, k: usize, at: f64) -> OnCubic<'_> {
        let [from, to] = [self.knots[k], self.knots[k + 1]];
        let width = (to - from) / (LANES - 1) as f64;
        let place = (at - from) / width;
        let first = (place as usize).min(LANES - 2);
        let between = self.between(k);
        OnCubic {
            ends: [&between[first], &between[first + 1]],
            weights: hermite(place - first as f64, width),
        }
    }

    /// Coefficients of the states at sixteen arc lengths evenly from knot `k` to the next.
    fn between(&self, k: usize) -> &Between {
        self.between[k].get_or_init(|| {
            let piece = [self.knots[k], self.knots[k + 1]];
            let s: [f64; LANES] = std::array::from_fn(|l| {
                piece[0] + (piece[1] - piece[0]) * l as f64 / (LANES - 1) as f64
            });
            // All knots are known, so this is.
            let sampled: Vec<_> = self
                .paths
                .iter()
                .filter_map(|path| sample(path, &s))
                .collect();
            let table = transformed(&in_plane(&sampled));
            let at = |degree: usize, c: usize, l: usize| table[(degree * PLANE + c) * LANES + l];
            Box::new(std::array::from_fn(|l| {
                std::array::from_fn(|degree| std::array::from_fn(|c| at(degree, c, l)))
            }))
        })
    }
}

/// A place on the cubics of all paths of an interval.
struct OnCubic<'a> {
    /// Coefficients of the states at both ends.
    ends: [&'a Coefficients; 2],
    /// Of point and tangent at both ends, for the point and for the tangent.
    weights: [[f64; 4]; 2],
}

impl OnCubic<'_> {
    /// The state there from those at both ends.
    #[inline(always)]
    fn mixed(&self, [a, b]: [&[f64; PLANE]; 2]) -> [f64; PLANE] {
        let [point, tangent] = &self.weights;
        let mut to = [0.0; PLANE];
        for c in 0..2 {
            let known = [a[c], a[2 + c], b[c], b[2 + c]];
            for i in 0..4 {
                to[c] += point[i] * known[i];
                to[2 + c] += tangent[i] * known[i];
            }
        }
        to
    }

    /// The coefficients of states there.
    #[inline(always)]
    fn coefficients(&self) -> Coefficients {
        let mut to = [[0.0; PLANE]; NODES];
        for degree in 0..NODES {
            to[degree] = self.mixed([&self.ends[0][degree], &self.ends[1][degree]]);
        }
        to
    }
}

/// Hermite's weights, of point and tangent at both ends of a cubic of this width, for its point and its
/// tangent at the fraction `t`.
fn hermite(t: f64, width: f64) -> [[f64; 4]; 2] {
    let r = 1.0 - t;
    let slope = 6.0 * t * r / width;
    [
        [
            (1.0 + 2.0 * t) * r * r,
            t * r * r * width,
            t * t * (3.0 - 2.0 * t),
            -t * t * r * width,
        ],
        [-slope, r * (1.0 - 3.0 * t), slope, t * (3.0 * t - 2.0)],
    ]
}

/// Six rows of a path at the arc lengths `s`; `None` where the table gave up.
fn sample(path: &TablePath<'_>, s: &[f64]) -> Option<Vec<f64>> {
    let mut rows = vec![0.0; ROWS * s.len()];
    (path.sample_into(s, &mut rows) == s.len()).then_some(rows)
}

/// Of the rows of several paths those that differ from zero.
fn in_plane(sampled: &[Vec<f64>]) -> Vec<f64> {
    let mut values = Vec::with_capacity(sampled.iter().map(Vec::len).sum());
    for rows in sampled {
        let n = rows.len() / ROWS;
        STORED
            .iter()
            .for_each(|c| values.extend_from_slice(&rows[c * n..(c + 1) * n]));
    }
    values
}

impl FamilyPath<'_, '_> {
    /// Whether both are in one strip.
    fn is_beside(&self, other: &Self) -> bool {
        std::ptr::eq(self.strip, other.strip)
    }

    /// Points and tangents at the knots into six rows.
    pub(super) fn fill(&self, rows: &mut [f64]) {
        let n = rows.len() / ROWS;
        let axes = [self.rotation.x_axis, self.rotation.y_axis];
        let [along, across] = axes.map(|axis| axis.as_vec3().to_array());
        let weights = self.weights.map(|weight| weight as f32);
        vectorised(
            #[inline(always)]
            || {
                for (first, block) in (0..n).step_by(LANES).zip(&self.strip.table) {
                    let [x, y, vx, vy] = block.sums(&weights);
                    for c in 0..3 {
                        let (a, b) = (along[c], across[c]);
                        let point = single(|l| a * x[l] + b * y[l]);
                        let tangent = single(|l| a * vx[l] + b * vy[l]);
                        widen(&mut rows[c * n..(c + 1) * n][first..], &point);
                        widen(&mut rows[(3 + c) * n..(4 + c) * n][first..], &tangent);
                    }
                }
            },
        );
    }

    /// Points and tangents at ascending arc lengths into six rows.
    pub(super) fn refine(&self, s: &[f64], rows: &mut [f64]) {
        vectorised(
            #[inline(always)]
            || {
                for (i, place) in self.strip.along(s).enumerate() {
                    // One path at both ends: fewer terms than all coefficients on the cubic.
                    let ends = [self.sum(place.ends[0]), self.sum(place.ends[1])];
                    put(rows, i, self.turned(&place.mixed([&ends[0], &ends[1]])));
                }
            },
        );
    }

    /// What is known of the path by coefficients.
    #[inline(always)]
    fn sum<const C: usize>(&self, coefficients: &[[f64; C]; NODES]) -> [f64; C] {
        let mut sums = [0.0; C];
        for (row, weight) in coefficients.iter().zip(self.weights) {
            for c in 0..C {
                sums[c] += row[c] * weight;
            }
        }
        sums
    }

    /// Point and tangent from what is in the stored plane.
    #[inline(always)]
    fn turned(&self, [x, y, vx, vy]: &[f64; PLANE]) -> (DVec3, DVec3) {
        let [along, across] = [self.rotation.x_axis, self.rotation.y_axis];
        (along * *x + across * *y, along * *vx + across * *vy)
    }
}

/// Columns of coefficients from the columns' values at the nodes, one row for each node.
fn transformed(values: &[f64]) -> Vec<f64> {
    static TRANSFORM: LazyLock<Vec<f64>> =
        LazyLock::new(|| chebyshev::transform(NODES).into_iter().collect());
    product(&TRANSFORM, NODES, values)
}

/// Whether points and tangents at all knots are known within the tolerance.
fn has_converged(coefficients: &[f64], knots: &[f64]) -> bool {
    let n = knots.len();
    let at = |degree: usize, c: usize, k: usize| coefficients[(degree * PLANE + c) * n + k];
    let tail = |c: usize, k: usize| at(NODES - 1, c, k).abs().max(at(NODES - 2, c, k).abs());
    (0..n).all(|k| {
        let speed = at(0, 2, k).hypot(at(0, 3, k));
        let allowed = TOLERANCE * speed;
        // At the camera itself all paths are at one point.
        tail(0, k).max(tail(1, k)) <= allowed * knots[k].max(knots[1])
            && tail(2, k).max(tail(3, k)) <= allowed
    })
}

impl Block {
    /// Their sums with these weights of the degrees.
    #[inline(always)]
    fn sums(&self, weights: &[f32; NODES]) -> [SingleLanes; PLANE] {
        // One by one: the loops of all together are not over knots in vectors, but over the four.
        let sum = |c: usize| {
            let mut sum = [0.0; LANES];
            for degree in 0..NODES {
                let row = &self.0[degree][c];
                for l in 0..LANES {
                    sum[l] += weights[degree] * row[l];
                }
            }
            sum
        };
        [sum(0), sum(1), sum(2), sum(3)]
    }
}

/// Writes a block of a row, or its beginning into what is left of the row.
#[inline(always)]
fn widen(to: &mut [f64], from: &SingleLanes) {
    match to.first_chunk_mut::<LANES>() {
        // Nearly always: a loop of a length that is known takes whole vectors.
        Some(to) => {
            for l in 0..LANES {
                to[l] = f64::from(from[l]);
            }
        }
        None => widen_some(to, *from),
    }
}

/// The rest of [`widen`], which would slow it down if it were inlined.
#[cold]
#[inline(never)]
fn widen_some(to: &mut [f64], from: SingleLanes) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = f64::from(from);
    }
}

/// Rows of `n` in blocks; behind the last knot are zeros.
fn in_blocks(coefficients: &[f64], n: usize) -> Vec<Block> {
    let mut blocks = vec![Block([[[0.0; LANES]; PLANE]; NODES]); n.div_ceil(LANES)];
    for (i, row) in coefficients.chunks_exact(n).enumerate() {
        for (block, from) in blocks.iter_mut().zip(row.chunks(LANES)) {
            for (to, from) in block.0[i / PLANE][i % PLANE].iter_mut().zip(from) {
                *to = *from as f32;
            }
        }
    }
    blocks
}
