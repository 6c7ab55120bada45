//! An interval of the parameter of a ray family.
//!
//! In: the interval's paths at Chebyshev nodes. Out: points and tangents at all knots and at the path's end,
//! in the plane in which paths are stored, as polynomials in the parameter ([`FamilyInterval`]), if those
//! through a few paths have converged; and from them one path ([`FamilyPath`]): a few dozen sums in place
//! of a patch's rows and Chebyshev sums along the arc. What is between two knots is known as well, once it
//! has been asked for.

use super::edge_pieces::pieces_with_edges;
use crate::{
    curve::Ending,
    endings::{Event, EventLocator},
    lanes::{LANES, Lanes, SingleLanes, Vectors, each, single},
    path_batch::{PathOrigin, PathView, ROWS, knots_until, put},
};
use geofan_bundle::{Fan, PathCoefficients, TablePath, chebyshev, double_product, rays::Orbit};
use geofan_expr::vectorised;
use glam::{DMat3, DVec3};
use std::sync::{Arc, LazyLock, OnceLock};

/// Number of paths along an interval. On the wormhole gallery's near half frames with 6 take 10 % longer
/// (more intervals), with 10 some percent (longer sums).
const NODES: usize = 8;

/// Bound of the last two coefficients, as an angle at the camera: a small part of any promise, and the
/// next ones are smaller still.
const TOLERANCE: f64 = 1e-5;

/// Rounding of a path's slope by sums in single precision, as a share of the largest slope: measured on infalling
/// paths, whose points and directions at a horizon are off by up to this.
const ROUNDING: f64 = 8.0 * f32::EPSILON as f64;

/// Most of the table's promise that rounding may take without being searched any closer.
const NOISE_SHARE: f64 = 0.4;

/// Number of components that differ from zero in the stored plane: x, y and those of the tangent.
const PLANE: usize = 4;

/// Rows of a path that hold those components.
const STORED: [usize; PLANE] = [0, 1, 3, 4];

/// Coefficients of a point and a tangent, axes (degree, [`PLANE`]).
type Coefficients = [[f64; PLANE]; NODES];

/// Coefficients at the knots of a block, axes (degree, [`PLANE`], knot).
#[repr(align(64))]
#[derive(Clone)]
struct KnotBlock([[SingleLanes; PLANE]; NODES]);

/// The paths of an interval.
pub(crate) struct FamilyInterval<'f> {
    face: usize,
    /// The ends of the interval.
    parameters: [f64; 2],
    /// The paths at the nodes.
    paths: Vec<TablePath<'f>>,
    knots: Arc<[f64]>,
    /// Coefficients at the knots, a block of them after the other.
    table: Vec<KnotBlock>,
    /// Coefficients at sixteen arc lengths from each knot to the next.
    between: Box<[OnceLock<Box<[Coefficients; LANES]>>]>,
    end: Option<FamilyEnd>,
    /// The pieces between knots in which paths may meet edges of the metric.
    edges: Vec<usize>,
}

/// The end of all paths of an interval.
enum FamilyEnd {
    /// Their length is used up.
    Length,
    /// All leave through one exit, whose sky turns with them: arc length and the sky's direction.
    Exit(usize, [[f64; 4]; NODES]),
    /// All meet one event: its arc length, and the stored plane's point and tangent there.
    Event(usize, [[f64; 1 + PLANE]; NODES]),
}

/// One path of an interval.
pub(crate) struct FamilyPath<'p, 'f> {
    interval: &'p FamilyInterval<'f>,
    weights: [f64; NODES],
    /// Takes the stored plane to the true one.
    rotation: DMat3,
}

impl<'f> FamilyInterval<'f> {
    /// Makes the interval `parameters` of a face of `fan`, whose table makes this promise, at these knots; `None` if
    /// its polynomials have not converged, or the table gave up on one of its paths.
    pub(super) fn new(
        fan: &'f Fan,
        (face, parameters): (usize, [f64; 2]),
        (knots, promise): (&Arc<[f64]>, f64),
        events: &mut EventLocator<'_>,
    ) -> Option<Self> {
        // The paths at the nodes, and polynomials through them.
        let n = knots.len();
        let [low, high] = parameters;
        let along = |x: &f64| fan.stored_path(face, [low + 0.5 * (x + 1.0) * (high - low), 0.0]);
        let paths: Vec<_> = chebyshev::nodes(NODES).iter().map(along).collect();
        let edges = match fan.space().manifold().switching_functions() {
            Some(_) => pieces_with_edges(&paths, knots)?,
            None => Vec::new(),
        };
        let sampled: Option<Vec<Vec<f64>>> = paths.iter().map(|path| sample(path, knots)).collect();
        let sampled = sampled?;
        let coefficients = transformed(&in_plane(&sampled));
        let allowed = tolerances(&coefficients, n, promise);
        let converged = converged_knots(&coefficients, knots, &allowed);
        // Nothing is promised of paths behind their ends, so that those have to be known first.
        let end = match fan.space().ends_alike() {
            true => {
                let mut met = Vec::with_capacity(NODES);
                for (path, rows) in paths.iter().zip(&sampled) {
                    met.push(first_event(path, knots, rows, events));
                    if converged < needed_knots(&met, knots) {
                        return None;
                    }
                }
                let skies = fan.space().skies_turn().then_some(events);
                let last = needed_knots(&met, knots) - 1;
                FamilyEnd::of(&met, skies, allowed[last])
            }
            false if converged < n => return None,
            false => None,
        };
        Some(Self {
            face,
            parameters,
            table: in_blocks(&coefficients, n),
            between: (1..n).map(|_| OnceLock::new()).collect(),
            knots: knots.clone(),
            paths,
            end,
            edges,
        })
    }

    /// Tells whether the end of all paths is known.
    pub(super) fn knows_end(&self) -> bool {
        self.end.is_some()
    }

    /// Tells whether a path is in the interval.
    pub(super) fn holds(&self, orbit: &Orbit) -> bool {
        let [low, high] = self.parameters;
        self.face == orbit.face && low <= orbit.parameter && orbit.parameter < high
    }

    /// Returns a path of the interval.
    pub(super) fn path(&self, orbit: &Orbit) -> FamilyPath<'_, 'f> {
        let [low, high] = self.parameters;
        let x = (orbit.parameter - 0.5 * (low + high)) / (0.5 * (high - low));
        let mut weights = [0.0; NODES];
        chebyshev::values(x, &mut weights);
        FamilyPath {
            interval: self,
            weights,
            rotation: orbit.rotation,
        }
    }

    /// Finds ascending arc lengths on cubics between sixteen points from each knot to the next: the error of
    /// cubics between knots falls by fifteen to the fourth. See [`FamilyInterval::cubic`].
    fn along(&self, s: &[f64]) -> impl Iterator<Item = ([&Coefficients; 2], [[f64; 4]; 2])> {
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

    /// Finds arc length `at` on the cubic between two of sixteen points from knot `k` to the next: the coefficients at both
    /// ends of the cubic, and Hermite's weights of point and tangent at both ends, for the point and for the tangent.
    fn cubic(&self, k: usize, at: f64) -> ([&Coefficients; 2], [[f64; 4]; 2]) {
        let [from, to] = [self.knots[k], self.knots[k + 1]];
        let width = (to - from) / (LANES - 1) as f64;
        let place = (at - from) / width;
        let first = (place as usize).min(LANES - 2);
        let between = self.between(k);
        let ends = [&between[first], &between[first + 1]];
        (ends, hermite(place - first as f64, width))
    }

    /// Returns the coefficients at sixteen arc lengths evenly from knot `k` to the next.
    fn between(&self, k: usize) -> &[Coefficients; LANES] {
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

/// Computes the state on a cubic from those at both ends.
#[inline(always)]
fn mixed([point, tangent]: &[[f64; 4]; 2], [a, b]: [&[f64; PLANE]; 2]) -> [f64; PLANE] {
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

/// Computes Hermite's weights, of point and tangent at both ends of a cubic of this width, for its point and
/// its tangent at the fraction `t`.
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

/// Samples six rows of a path at the arc lengths `s`; `None` where the table gave up.
fn sample(path: &TablePath<'_>, s: &[f64]) -> Option<Vec<f64>> {
    let mut rows = vec![0.0; ROWS * s.len()];
    (path.sample_into(s, &mut rows) == s.len()).then_some(rows)
}

/// Collects those rows of several paths that differ from zero.
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

/// Computes columns of coefficients from the columns' values at the nodes, one row for each node.
fn transformed(values: &[f64]) -> Vec<f64> {
    static TRANSFORM: LazyLock<Vec<f64>> =
        LazyLock::new(|| chebyshev::transform(NODES).into_iter().collect());
    double_product(&TRANSFORM, NODES, values)
}

/// Returns the angle that the last two coefficients may have at each of `n` knots: the tolerance, or what sums of the
/// table's numbers in single precision leave unknown of paths that have become slow in the chart, which more
/// intervals would not tell either.
fn tolerances(coefficients: &[f64], n: usize, promise: f64) -> Vec<f64> {
    let speed = |k: usize| coefficients[2 * n + k].hypot(coefficients[3 * n + k]);
    let most = (0..n).map(speed).fold(0.0, f64::max);
    let noise = |k: usize| ROUNDING * most / speed(k);
    (0..n)
        .map(|k| TOLERANCE.max(noise(k).min(NOISE_SHARE * promise)))
        .collect()
}

/// Returns up to which of the knots points and tangents are known within the angles `allowed`.
fn converged_knots(coefficients: &[f64], knots: &[f64], allowed: &[f64]) -> usize {
    let n = knots.len();
    let at = |degree: usize, c: usize, k: usize| coefficients[(degree * PLANE + c) * n + k];
    let tail = |c: usize, k: usize| at(NODES - 1, c, k).abs().max(at(NODES - 2, c, k).abs());
    let is_known = |k: &usize| {
        let k = *k;
        let allowed = allowed[k] * at(0, 2, k).hypot(at(0, 3, k));
        // At the camera itself all paths are at one point.
        tail(0, k).max(tail(1, k)) <= allowed * knots[k].max(knots[1])
            && tail(2, k).max(tail(3, k)) <= allowed
    };
    (0..n).take_while(is_known).count()
}

/// Returns how many of the knots matter to paths with these events.
fn needed_knots(events: &[Option<Event>], knots: &[f64]) -> usize {
    let limits = events
        .iter()
        .map(|event| event.as_ref().map_or(f64::INFINITY, |event| event.s));
    knots_until(knots, limits.fold(0.0, f64::max))
}

impl KnotBlock {
    /// Sums the coefficients with these weights of the degrees.
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

/// Arranges rows of `n` in blocks; behind the last knot are zeros.
fn in_blocks(coefficients: &[f64], n: usize) -> Vec<KnotBlock> {
    let mut blocks = vec![KnotBlock([[[0.0; LANES]; PLANE]; NODES]); n.div_ceil(LANES)];
    for (i, row) in coefficients.chunks_exact(n).enumerate() {
        for (block, from) in blocks.iter_mut().zip(row.chunks(LANES)) {
            for (to, from) in block.0[i / PLANE][i % PLANE].iter_mut().zip(from) {
                *to = *from as f32;
            }
        }
    }
    blocks
}

/// Finds the first event on a path that is known at the knots.
fn first_event(
    path: &TablePath<'_>,
    knots: &[f64],
    rows: &[f64],
    events: &mut EventLocator<'_>,
) -> Option<Event> {
    let view = PathView {
        knots,
        direction: DVec3::ZERO,
        rows,
        boxes: &[],
        known: knots.len(),
        ending: None,
        source: (&PathCoefficients::default(), &PathOrigin::Knots),
    };
    events.refined_event(view, &|s, rows| path.sample_into(s, rows))
}

impl FamilyEnd {
    /// Makes the end from the events at the nodes: by skies, if those turn with paths and can be looked up;
    /// `None` if paths end in different ways.
    fn of(
        events: &[Option<Event>],
        skies: Option<&mut EventLocator<'_>>,
        allowed: f64,
    ) -> Option<Self> {
        let kinds = || events.iter().map(|event| event.as_ref().map(|e| e.kind));
        let first = kinds().next()?;
        if kinds().any(|kind| kind != first) {
            return None;
        }
        let Some(kind) = first else {
            return Some(Self::Length);
        };
        let events = events.iter().flatten();
        match skies {
            Some(skies) => {
                let endings: Vec<Ending> = events.map(|e| skies.ending_of(e)).collect();
                Self::by_skies(&endings, allowed)
            }
            None => Self::by_states(kind, events, allowed),
        }
    }

    /// Makes the end from the endings at the nodes.
    fn by_skies(endings: &[Ending], allowed: f64) -> Option<Self> {
        let Some(exit) = endings[0].exit() else {
            return Some(Self::Length);
        };
        let columns = endings.iter().filter_map(|ending| match *ending {
            Ending::Exit { s, sky, .. } => Some([s, sky.x, sky.y, sky.z]),
            Ending::Length | Ending::Singular => None,
        });
        let (rows, tails) = expanded(columns);
        let good =
            tails[0] <= allowed * rows[0][0] && tails[1..].iter().all(|tail| *tail <= allowed);
        good.then_some(Self::Exit(exit, rows))
    }

    /// Makes the end from the events at the nodes, all of one kind.
    fn by_states<'e>(
        kind: usize,
        events: impl Iterator<Item = &'e Event>,
        allowed: f64,
    ) -> Option<Self> {
        let columns = events.map(|e| [e.s, e.u.x, e.u.y, e.v.x, e.v.y]);
        let (rows, tails) = expanded(columns);
        let [s, _, _, vx, vy] = rows[0];
        let speed = vx.hypot(vy);
        let good = tails[0] <= allowed * s
            && tails[1].max(tails[2]) <= allowed * s * speed
            && tails[3].max(tails[4]) <= allowed * speed;
        good.then_some(Self::Event(kind, rows))
    }
}

/// Computes the coefficients of columns from their values at the nodes, and the larger of the last two of
/// each.
fn expanded<const C: usize>(
    values: impl Iterator<Item = [f64; C]>,
) -> ([[f64; C]; NODES], [f64; C]) {
    let values: Vec<f64> = values.flatten().collect();
    let mut rows = [[0.0; C]; NODES];
    let coefficients = transformed(&values);
    for (to, from) in rows.iter_mut().zip(coefficients.as_chunks::<C>().0) {
        *to = *from;
    }
    let tails = std::array::from_fn(|c| rows[NODES - 1][c].abs().max(rows[NODES - 2][c].abs()));
    (rows, tails)
}

impl FamilyPath<'_, '_> {
    /// Tells whether both are in one interval.
    fn shares_interval(&self, other: &Self) -> bool {
        std::ptr::eq(self.interval, other.interval)
    }

    /// Returns the pieces between knots in which it may meet edges of the metric.
    pub(crate) fn edges(&self) -> &[usize] {
        &self.interval.edges
    }

    /// Returns how the path ends; `None` if that has to be searched for.
    pub(crate) fn ending(&self, events: &mut EventLocator<'_>) -> Option<Ending> {
        Some(match self.interval.end.as_ref()? {
            FamilyEnd::Length => Ending::Length,
            FamilyEnd::Exit(exit, coefficients) => {
                let [s, x, y, z] = self.sum(coefficients);
                Ending::Exit {
                    exit: *exit,
                    s,
                    sky: (self.rotation * DVec3::new(x, y, z)).normalize_or_zero(),
                }
            }
            FamilyEnd::Event(kind, coefficients) => {
                let [s, x, y, vx, vy] = self.sum(coefficients);
                events.ending_of(&Event {
                    kind: *kind,
                    s,
                    u: self.rotation * DVec3::new(x, y, 0.0),
                    v: self.rotation * DVec3::new(vx, vy, 0.0),
                })
            }
        })
    }

    /// Writes points and tangents at the knots into six rows.
    pub(crate) fn fill(&self, rows: &mut [f64]) {
        let n = rows.len() / ROWS;
        let axes = [self.rotation.x_axis, self.rotation.y_axis];
        let [along, across] = axes.map(|axis| axis.as_vec3().to_array());
        let weights = self.weights.map(|weight| weight as f32);
        vectorised(
            #[inline(always)]
            || {
                for (first, block) in (0..n).step_by(LANES).zip(&self.interval.table) {
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

    /// Writes points and tangents at ascending arc lengths into six rows.
    pub(crate) fn refine(&self, s: &[f64], rows: &mut [f64]) {
        vectorised(
            #[inline(always)]
            || {
                for (i, (ends, weights)) in self.interval.along(s).enumerate() {
                    // One path at both ends: fewer terms than all coefficients on the cubic.
                    let ends = [self.sum(ends[0]), self.sum(ends[1])];
                    put(rows, i, self.turned(&mixed(&weights, [&ends[0], &ends[1]])));
                }
            },
        );
    }

    /// Sums coefficients to what they are on this path.
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

    /// Turns a state of the stored plane to the path's point and tangent.
    #[inline(always)]
    fn turned(&self, [x, y, vx, vy]: &[f64; PLANE]) -> (DVec3, DVec3) {
        let [along, across] = [self.rotation.x_axis, self.rotation.y_axis];
        (along * *x + across * *y, along * *vx + across * *vy)
    }
}

/// Writes a block of a row, or its beginning into the rest of the row.
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

/// Writes the beginning of a block; it would slow [`widen`] down if it were inlined.
#[cold]
#[inline(never)]
fn widen_some(to: &mut [f64], from: SingleLanes) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = f64::from(from);
    }
}

/// Returns points and tangents of sixteen paths at ascending arc lengths: coefficients there are made ready
/// once for all paths of an interval.
pub(crate) fn refine_sixteen(paths: &[FamilyPath<'_, '_>; LANES], s: &[f64]) -> Vec<[Vectors; 2]> {
    let mut states = vec![[[[0.0; LANES]; 3]; 2]; s.len()];
    let mut sums = vec![[[0.0; LANES]; PLANE]; s.len()];
    vectorised(
        #[inline(always)]
        || {
            for (l, path) in paths.iter().enumerate() {
                // Once for each interval, by the first of its paths.
                if !paths[..l].iter().any(|other| other.shares_interval(path)) {
                    add_interval(path, paths, s, &mut sums);
                }
            }
            for (state, sums) in states.iter_mut().zip(&sums) {
                for c in 0..3 {
                    let x = each(|l| paths[l].rotation.x_axis[c]);
                    let y = each(|l| paths[l].rotation.y_axis[c]);
                    state[0][c] = each(|l| x[l] * sums[0][l] + y[l] * sums[1][l]);
                    state[1][c] = each(|l| x[l] * sums[2][l] + y[l] * sums[3][l]);
                }
            }
        },
    );
    states
}

/// Adds the states in the stored plane of those of the `paths` that are in the interval of `one`.
#[inline(always)]
fn add_interval(
    one: &FamilyPath<'_, '_>,
    paths: &[FamilyPath<'_, '_>; LANES],
    s: &[f64],
    sums: &mut [[Lanes; PLANE]],
) {
    let mut weights = [[0.0; LANES]; NODES];
    for (l, path) in paths
        .iter()
        .enumerate()
        .filter(|(_, path)| path.shares_interval(one))
    {
        for degree in 0..NODES {
            weights[degree][l] = path.weights[degree];
        }
    }
    for (sums, (ends, hermite)) in sums.iter_mut().zip(one.interval.along(s)) {
        let mut more = *sums;
        for (degree, weights) in weights.iter().enumerate() {
            let coefficients = mixed(&hermite, [&ends[0][degree], &ends[1][degree]]);
            for c in 0..PLANE {
                for l in 0..LANES {
                    more[c][l] += weights[l] * coefficients[c];
                }
            }
        }
        *sums = more;
    }
}
