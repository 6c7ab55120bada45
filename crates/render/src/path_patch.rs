//! Sixteen paths that span a tile, and the interpolation between them.
//!
//! In: 4 × 4 paths of a batch at even spacing over a tile ([`PathPatch`]). Out: their common exit, their
//! points at any arc length ([`Vertex`]), and the weights with which the paths of sixteen samples come
//! from them ([`Bicubic`]).

use super::{
    curve::Ending,
    lanes::{
        LANES, Lanes, SingleLanes, SingleVectors, Vectors, each, each_vector, lane, range,
        single_lane,
    },
    path_batch::{PathBatch, PathView, knots_until},
    tracer::GridTracer,
};
use geofan_expr::{real::Real, vectorised};
use glam::{DVec2, DVec3};
use std::ops::Range;

/// Intervals into which each of the last pieces of a patch is divided. Between two points the path is a
/// cubic, whose error falls with the fourth power of their distance: that between knots, some mrad, falls
/// to a few millionths.
pub const PER_PIECE: usize = 8;

/// Sixteen paths of a batch, row by row over their tile.
pub struct PathPatch<'a> {
    batch: &'a PathBatch,
    paths: [PathView<'a>; LANES],
}

impl<'a> PathPatch<'a> {
    /// Takes the paths with these numbers.
    pub fn new(batch: &'a PathBatch, members: &[usize; LANES]) -> Self {
        Self {
            batch,
            paths: std::array::from_fn(|lane| batch.path(members[lane])),
        }
    }

    /// Returns all sixteen.
    #[inline(always)]
    pub fn paths(&self) -> &[PathView<'a>; LANES] {
        &self.paths
    }

    /// Returns the arc lengths of the knots.
    pub fn knots(&self) -> &'a [f64] {
        self.batch.knots()
    }

    /// Returns any path of the batch.
    pub fn in_batch(&self, number: usize) -> PathView<'a> {
        self.batch.path(number)
    }

    /// Returns the exit that all share (`Some(None)`: none ends through one); `None` if they differ or one
    /// is not known.
    pub fn exit(&self) -> Option<Option<usize>> {
        let [first, others @ ..] = &self.paths;
        let first = first.ending?.exit();
        let same = |path: &PathView<'_>| path.ending.is_some_and(|e| e.exit() == first);
        others.iter().all(same).then_some(first)
    }

    /// Returns the arc lengths beyond which nothing counts.
    pub fn limits(&self) -> Lanes {
        each(|l| self.paths[l].ending.map_or(0.0, |e| e.limit()))
    }

    /// Returns the directions of their skies; zero without one.
    pub fn skies(&self) -> Vectors {
        let mut skies = [[0.0; LANES]; 3];
        for l in 0..LANES {
            if let Some(Ending::Exit { sky, .. }) = self.paths[l].ending {
                for c in 0..3 {
                    skies[c][l] = sky[c];
                }
            }
        }
        skies
    }

    /// Returns how many knots matter: up to the first at which all have ended.
    pub fn last(&self) -> usize {
        let limit = self.limits().into_iter().fold(0.0, f64::max);
        knots_until(self.knots(), limit)
    }

    /// Tells whether all paths are known at all knots that matter.
    pub fn is_known(&self) -> bool {
        let last = self.last();
        self.paths.iter().all(|path| path.known >= last)
    }

    /// Appends all paths at the ascending arc lengths `s` to `vertices`.
    pub fn vertices(&self, tracer: &dyn GridTracer, s: &[f64], vertices: &mut Vec<Vertex>) {
        // Arc lengths of knots, and those between, which the tracer refines.
        let knots = self.knots();
        let numbers = s
            .iter()
            .map(|s| knots.binary_search_by(|knot| knot.total_cmp(s)).ok());
        let numbers: Vec<Option<usize>> = numbers.collect();
        let between = s
            .iter()
            .zip(&numbers)
            .filter(|(_, number)| number.is_none());
        let between: Vec<f64> = between.map(|(s, _)| *s).collect();
        let paths = &self.paths;
        let mut refined = tracer.refine_sixteen(paths, &between).into_iter();
        // Both in order.
        vertices.reserve(s.len());
        vectorised(
            #[inline(always)]
            || {
                for (&s, number) in s.iter().zip(&numbers) {
                    // At the knots paths are known as well as they can be.
                    let at = number.map(|k| {
                        [0, 3].map(|first| each_vector(|c, l| paths[l].row(first + c)[k]))
                    });
                    let Some([point, tangent]) = at.or_else(|| refined.next()) else {
                        break;
                    };
                    vertices.push(Vertex {
                        s,
                        point: Offsets::of(&point),
                        tangent: Offsets::of(&tangent),
                    });
                }
            },
        );
    }

    /// Samples the paths in the `pieces` in which they end, through whatever exit.
    pub fn last_vertices(&self, tracer: &dyn GridTracer, pieces: &Range<usize>) -> Vec<Vertex> {
        let knots = self.knots();
        let mut s = vec![knots[pieces.start]];
        for k in pieces.clone() {
            let along = |j: usize| j as f64 / PER_PIECE as f64;
            s.extend((1..=PER_PIECE).map(|j| knots[k] + (knots[k + 1] - knots[k]) * along(j)));
        }
        let mut vertices = Vec::new();
        self.vertices(tracer, &s, &mut vertices);
        vertices
    }
}

/// Points and tangents of sixteen paths at one arc length.
#[derive(Debug, Clone)]
pub struct Vertex {
    /// Arc length.
    pub s: f64,
    /// Chart points.
    pub point: Offsets,
    /// Tangents.
    pub tangent: Offsets,
}

/// Sixteen points as their differences from one of them: single precision is enough for those, and half
/// as much work.
#[derive(Debug, Clone, Default)]
#[repr(C, align(64))]
pub struct Offsets {
    /// The differences, in each lane.
    pub differences: SingleVectors,
    /// The point that they are measured from.
    pub middle: DVec3,
}

impl Offsets {
    /// Measures points from the one in the middle lane.
    #[inline(always)]
    pub fn of(points: &Vectors) -> Self {
        let middle = lane(points, LANES / 2);
        let mut differences = [[0.0; LANES]; 3];
        for c in 0..3 {
            for l in 0..LANES {
                differences[c][l] = (points[c][l] - middle[c]) as f32;
            }
        }
        Self {
            middle,
            differences,
        }
    }

    /// Returns the point in one lane.
    pub fn point(&self, l: usize) -> DVec3 {
        self.middle + single_lane(&self.differences, l).as_dvec3()
    }

    /// Returns the points.
    pub fn points(&self) -> Vectors {
        each_vector(|c, l| self.middle[c] + f64::from(self.differences[c][l]))
    }

    /// Returns the corners of the box around the points.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        let [x, y, z] = self.differences.each_ref().map(range);
        let corner = |k: usize| DVec3::new(x[k].into(), y[k].into(), z[k].into());
        (self.middle + corner(0), self.middle + corner(1))
    }
}

/// The weights of the sixteen paths of a patch, for sixteen samples at once. In single precision, which is
/// enough for differences between neighbours.
#[repr(align(64))]
pub struct Bicubic([SingleLanes; LANES]);

impl Bicubic {
    /// Computes the weights of 4 × 4 paths at even spacing, at places in the tile as fractions of its side.
    #[inline(always)]
    pub fn new(places: &[DVec2; LANES]) -> Self {
        let x = cubic_lanes(|l| places[l].x);
        let y = cubic_lanes(|l| places[l].y);
        let mut weights = [[0.0; LANES]; LANES];
        for i in 0..LANES {
            for l in 0..LANES {
                weights[i][l] = x[i % 4][l] * y[i / 4][l];
            }
        }
        Self(weights)
    }

    /// Interpolates one number of each path.
    #[inline(always)]
    pub fn mix(&self, values: &Lanes) -> Lanes {
        let offsets = Offsets::of(&[*values, [0.0; LANES], [0.0; LANES]]);
        let [mixed] = self.mix_components([&offsets.differences[0]]);
        each(|l| offsets.middle.x + f64::from(mixed[l]))
    }

    /// Interpolates points.
    #[inline(always)]
    pub fn mix_points(&self, points: &Offsets) -> Vectors {
        let mixed = self.mix_offsets(points);
        each_vector(|c, l| mixed.middle[c] + f64::from(mixed.differences[c][l]))
    }

    /// Interpolates points as differences from the same middle: the weights sum to 1, so only differences
    /// need them.
    #[inline(always)]
    pub fn mix_offsets(&self, points: &Offsets) -> Offsets {
        Offsets {
            middle: points.middle,
            differences: self.mix_components(points.differences.each_ref()),
        }
    }

    /// Interpolates several components at once: the sums of one alone would wait for each other.
    #[inline(always)]
    fn mix_components<const N: usize>(&self, differences: [&SingleLanes; N]) -> [SingleLanes; N] {
        let mut sums = [[0.0; LANES]; N];
        for i in 0..LANES {
            let weights = &self.0[i];
            for n in 0..N {
                let difference = differences[n][i];
                for l in 0..LANES {
                    sums[n][l] += weights[l] * difference;
                }
            }
        }
        sums
    }
}

/// Computes Lagrange's cubic weights at `t` for nodes 0, 1/3, 2/3, 1.
#[inline(always)]
pub fn cubic<T: Real>(t: T) -> [T; 4] {
    let number = T::from_f64;
    let (a, b) = (t, t - number(1.0 / 3.0));
    let (c, d) = (t - number(2.0 / 3.0), t - T::ONE);
    [
        number(-4.5) * b * c * d,
        number(13.5) * a * c * d,
        number(-13.5) * a * b * d,
        number(4.5) * a * b * c,
    ]
}

/// Computes [`cubic`] in every lane.
#[inline(always)]
fn cubic_lanes(t: impl Fn(usize) -> f64) -> [SingleLanes; 4] {
    let mut weights = [[0.0; LANES]; 4];
    for l in 0..LANES {
        let w = cubic(t(l) as f32);
        for i in 0..4 {
            weights[i][l] = w[i];
        }
    }
    weights
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cubic_weights_reproduce_cubics() {
        let f = |t: f64| 1.0 - 2.0 * t + 3.0 * t * t - 4.0 * t * t * t;
        let nodes = [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0].map(f);
        for t in [0.0, 0.1, 0.5, 0.77, 1.0] {
            let sum: f64 = cubic(t).iter().zip(nodes).map(|(w, f)| w * f).sum();
            assert!((sum - f(t)).abs() < 1e-14);
        }
    }
}
