//! Tracers that integrate: from (camera, directions) to paths.
//!
//! In: directions in the standard frame at the camera. Out: [`Curve`]s of [`ExactTracer`], each with
//! its own knots, or [`PathBatch`] on common knots of a [`GridTracer`], so that they can be interpolated. The other
//! grid tracer looks paths up: [`super::TableTracer`].
//!
//! The paths of [`ExactGridTracer`] are integrated adaptively and then sampled at knots, fine enough that the cubics
//! between them stay within `KNOT_ERROR` of the path. A path that they do not follow that closely, or that ends early,
//! is left to the exact tracer.

use super::{
    curve::{Cubic, Curve, Ending, ending_at},
    endings::EventLocator,
    lanes::{LANES, Vectors},
    lookup::{Lookup, choose_knots, worst_middle},
    path_batch::{PathBatch, PathOrigin, PathView, ROWS, put},
};
use geofan_core::{
    geodesic::{
        End, Ray, Settings, Sink, Step, beside, fixed_steps, follow, follow_past_poles, meets_pole,
    },
    manifold::{LocalFrame, Manifold},
};
use glam::DVec3;
use std::sync::Arc;

/// A tracer whose paths can be interpolated between directions, because all have the same knots.
pub trait GridTracer: Sync {
    /// Returns the knots' arc lengths.
    fn knots(&self) -> &Arc<[f64]>;

    /// Appends the paths in `directions` to `batch`, which has these knots; a path that the tracer cannot
    /// give on them has no ending. Directions are what [`super::View::address`] tells.
    fn add(&self, directions: &[DVec3], events: &mut EventLocator<'_>, batch: &mut PathBatch);

    /// Returns how the paths in `directions` end, where that is known without the paths.
    fn endings(&self, directions: &[DVec3], _: &mut EventLocator<'_>) -> Vec<Option<Ending>> {
        vec![None; directions.len()]
    }

    /// Writes points and tangents of a path that [`GridTracer::add`] made, at ascending arc lengths `s`, into
    /// six rows as long as `s`: as close as the tracer can, where the cubics between knots only serve to
    /// find what may be met.
    fn refine(&self, path: PathView<'_>, s: &[f64], rows: &mut [f64]);

    /// Returns points and tangents of sixteen such paths.
    fn refine_sixteen(&self, paths: &[PathView<'_>; LANES], s: &[f64]) -> Vec<[Vectors; 2]> {
        refine_each(self, paths, s)
    }

    /// Returns by how much the cubics between knots may miss the path, radians at the camera.
    fn slack(&self) -> f64;

    /// Tells whether a path that [`GridTracer::add`] made may meet an edge of the metric in one of these `pieces` between knots: no
    /// cubic, and none of the paths between it and others, follows it there.
    fn meets_edge(&self, _path: PathView<'_>, _pieces: &[usize]) -> bool {
        false
    }

    /// Returns the arc lengths at which it meets edges, ascending.
    fn edges(&self, _path: PathView<'_>) -> Vec<f64> {
        Vec::new()
    }

    /// Returns the tracer of the paths that cannot be given.
    fn fallback(&self) -> Option<&ExactTracer<'_>>;

    /// Returns the table in which paths are looked up again beyond the last knot; `None` where they are not asked for farther.
    fn restarts(&self) -> Option<&Lookup<'_>> {
        None
    }
}

/// Computes [`GridTracer::refine_sixteen`] path by path.
pub(super) fn refine_each<T: GridTracer + ?Sized>(
    tracer: &T,
    paths: &[PathView<'_>; LANES],
    s: &[f64],
) -> Vec<[Vectors; 2]> {
    let mut states = vec![[[[0.0; LANES]; 3]; 2]; s.len()];
    let mut rows = vec![0.0; ROWS * s.len()];
    for (l, path) in paths.iter().enumerate() {
        tracer.refine(*path, s, &mut rows);
        for (i, state) in states.iter_mut().enumerate() {
            for c in 0..ROWS {
                state[c / 3][c % 3][l] = rows[c * s.len() + i];
            }
        }
    }
    states
}

/// Follows each ray by integration.
#[derive(Debug, Clone)]
pub struct ExactTracer<'m> {
    manifold: &'m Manifold,
    u: DVec3,
    local: LocalFrame,
    length: f64,
    tolerance: f64,
}

/// Angle (radians) by which a cubic piece may depart from the integrator's quintic: a hundredth of
/// a mrad, below anything a picture shows.
const PIECE_ERROR: f64 = 1e-5;

impl<'m> ExactTracer<'m> {
    /// Makes the tracer of rays from `u` over `length` at a local tolerance.
    pub fn new(manifold: &'m Manifold, u: DVec3, length: f64, tolerance: f64) -> Self {
        Self {
            manifold,
            u,
            local: manifold.local_frame(u),
            length,
            tolerance,
        }
    }
}

impl ExactTracer<'_> {
    /// Returns the space that it follows rays through.
    pub fn manifold(&self) -> &Manifold {
        self.manifold
    }

    /// Returns how far it follows rays.
    pub fn length(&self) -> f64 {
        self.length
    }

    /// Returns its local tolerance.
    pub fn tolerance(&self) -> f64 {
        self.tolerance
    }

    /// Follows the rays in `directions`, in order.
    pub fn trace(&self, directions: &[DVec3]) -> Vec<Curve> {
        self.curves(directions, true)
    }

    /// Follows them to the end of the domain, or, without `events`, as far as the metric allows.
    pub(super) fn curves(&self, directions: &[DVec3], events: bool) -> Vec<Curve> {
        let starts = directions.iter().map(|&d| (self.u, self.local.tangent(d)));
        self.follow_beside_poles(&starts.collect::<Vec<_>>(), events)
    }

    /// Follows the curves from chart points with unit tangents, in order.
    pub fn trace_from(&self, starts: &[(DVec3, DVec3)]) -> Vec<Curve> {
        self.follow_beside_poles(starts, true)
    }

    /// Does so, where a curve that meets a pole of the chart, at which the metric ends and the space does not, is
    /// turned by far less than a pixel and followed again.
    fn follow_beside_poles(&self, starts: &[(DVec3, DVec3)], events: bool) -> Vec<Curve> {
        let follow = |starts: &[(DVec3, DVec3)]| self.follow_all(starts, events);
        let turned = |start: &(DVec3, DVec3), side: usize| self.turned(*start, side);
        let curves = follow_past_poles(starts, follow, |(_, curve)| curve.4, turned);
        let curve = |(_, (s, u, v, ending, _)): (_, Growing)| Curve {
            s: s.into(),
            u,
            v,
            ending,
        };
        curves.into_iter().map(curve).collect()
    }

    /// Turns a start to one of two sides, across each other.
    fn turned(&self, (u, v): (DVec3, DVec3), side: usize) -> (DVec3, DVec3) {
        let local = self.manifold.local_frame(u);
        (u, local.tangent(beside(&local, v, BESIDE_POLE)[side]))
    }

    /// Follows the curves from these starts.
    fn follow_all(&self, starts: &[(DVec3, DVec3)], events: bool) -> Vec<Growing> {
        let settings = Settings {
            events,
            ..Settings::bare(self.tolerance)
        };
        let rays = starts
            .iter()
            .map(|&(u, v)| Ray::without_spread(u, v, self.length));
        let growing =
            |&(u, v): &(DVec3, DVec3)| (vec![0.0], vec![u], vec![v], Ending::Length, false);
        let mut sink = CurveSink {
            manifold: self.manifold,
            crossings: vec![0; starts.len()],
            curves: starts.iter().map(growing).collect(),
        };
        follow(self.manifold, settings, rays, &mut sink);
        sink.curves
    }
}

/// Angle (radians) by which a ray that meets a pole is turned: a twentieth of a pixel of a view 90° wide
/// and 8000 pixels across. A smaller one passes the pole closer, in more steps, and shows nothing.
const BESIDE_POLE: f64 = 1e-5;

/// A curve being made: arc lengths, points, tangents, how it ends, and whether that is at a pole of the chart.
type Growing = (Vec<f64>, Vec<DVec3>, Vec<DVec3>, Ending, bool);

/// Collects the steps of rays as cubics.
struct CurveSink<'m> {
    manifold: &'m Manifold,
    curves: Vec<Growing>,
    /// Faces of a glued space that each has crossed.
    crossings: Vec<u32>,
}

impl Sink for CurveSink<'_> {
    fn step(&mut self, ray: usize, step: &Step) {
        let (s, u, v, ..) = &mut self.curves[ray];
        if step.crossings != self.crossings[ray] {
            // The path goes on elsewhere.
            self.crossings[ray] = step.crossings;
            s.push(step.start);
            u.push(step.position(step.start));
            v.push(step.tangent(step.start));
        }
        let count = cubic_count(step);
        for k in 1..=count {
            let at = step.start + (step.end - step.start) * k as f64 / count as f64;
            s.push(at);
            u.push(step.position(at));
            v.push(step.tangent(at));
        }
    }

    fn end(&mut self, ray: usize, end: End, s: f64, _: usize) {
        let (_, u, v, ending, at_pole) = &mut self.curves[ray];
        let (u, v) = (u[u.len() - 1], v[v.len() - 1]);
        *at_pole = meets_pole(self.manifold, end, u);
        *ending = ending_at(self.manifold, end, s, u, v);
    }
}

/// Cuts a step into cubics.
pub fn pieces(step: &Step) -> impl Iterator<Item = Cubic> {
    let count = cubic_count(step);
    let at = move |k: usize| step.start + (step.end - step.start) * k as f64 / count as f64;
    (0..count).map(move |k| cubic(step, [at(k), at(k + 1)]))
}

/// Makes the cubic of a step between two arc lengths.
fn cubic(step: &Step, s: [f64; 2]) -> Cubic {
    Cubic {
        s,
        u: s.map(|s| step.position(s)),
        v: s.map(|s| step.tangent(s)),
    }
}

/// Returns how many cubics replace the quintic of `step`: the middle of one cubic decides, and the error
/// falls with the fourth power of the length.
fn cubic_count(step: &Step) -> usize {
    let (a, b) = (step.start, step.end);
    let one = cubic(step, [a, b]);
    let error = (one.middle() - step.position(0.5 * (a + b))).length();
    let allowed = PIECE_ERROR * b * one.v[0].length();
    if error <= allowed {
        return 1;
    }
    (error / allowed).powf(0.25).ceil().min(16.0) as usize
}

/// Follows each ray by equal steps in single precision: the rival that a table must beat at equal
/// error.
#[derive(Debug, Clone)]
pub struct FixedTracer<'m> {
    manifold: &'m Manifold,
    u: DVec3,
    local: LocalFrame,
    knots: Arc<[f64]>,
}

impl<'m> FixedTracer<'m> {
    /// Makes the tracer of rays from `u` over `length` in `steps` steps.
    pub fn new(manifold: &'m Manifold, u: DVec3, length: f64, steps: usize) -> Self {
        Self {
            manifold,
            u,
            local: manifold.local_frame(u),
            knots: even_knots(length, steps),
        }
    }
}

impl GridTracer for FixedTracer<'_> {
    fn knots(&self) -> &Arc<[f64]> {
        &self.knots
    }

    fn add(&self, directions: &[DVec3], events: &mut EventLocator<'_>, batch: &mut PathBatch) {
        let rays: Vec<_> = directions
            .iter()
            .map(|&d| (self.u, self.local.tangent(d)))
            .collect();
        let steps = self.knots.len() - 1;
        let paths = fixed_steps::<f32>(self.manifold, &rays, self.knots[steps], steps);
        for (direction, (u, v)) in directions.iter().zip(paths) {
            let fill = |_: &[f64], rows: &mut [f64]| {
                for (k, (u, v)) in u.iter().zip(&v).enumerate() {
                    put(rows, k, (*u, *v));
                }
                u.len()
            };
            batch.push((*direction, PathOrigin::Knots), fill, |path| {
                Some(events.ending(path).unwrap_or(Ending::Length))
            });
        }
    }

    /// Samples the cubics between its steps: they are its path, on which equal error is measured.
    fn refine(&self, path: PathView<'_>, s: &[f64], rows: &mut [f64]) {
        path.sample(s, rows);
    }

    fn slack(&self) -> f64 {
        0.0
    }

    fn fallback(&self) -> Option<&ExactTracer<'_>> {
        None
    }
}

/// Returns the ends of `n` equal intervals of [0, `length`].
pub(super) fn even_knots(length: f64, n: usize) -> Arc<[f64]> {
    (0..=n).map(|k| length * k as f64 / n as f64).collect()
}

/// Most error of the cubics between knots, radians at the camera. Points come from the cubics, so it has to
/// be below what a picture shows: a third of a pixel of 1920 in 90°. Smaller takes more knots, and with them
/// more time for every path.
const KNOT_ERROR: f64 = 3e-4;

/// Integrates paths and hands them out at common knots.
#[derive(Debug, Clone)]
pub struct ExactGridTracer<'m> {
    exact: ExactTracer<'m>,
    knots: Arc<[f64]>,
}

impl<'m> ExactGridTracer<'m> {
    /// Chooses knots for paths of `length` from the camera region, or from `u` if the manifold has none.
    /// It integrates a sample of paths, which takes longer than a frame: once for each scene.
    pub fn choose_knots(manifold: &Manifold, u: DVec3, length: f64, tolerance: f64) -> Arc<[f64]> {
        choose_knots(manifold, u, [length, tolerance, KNOT_ERROR])
    }

    /// Makes the tracer of rays from `u` at `knots`, at a local tolerance.
    pub fn new(manifold: &'m Manifold, u: DVec3, knots: Arc<[f64]>, tolerance: f64) -> Self {
        let length = knots.last().copied().unwrap_or_default();
        Self {
            exact: ExactTracer::new(manifold, u, length, tolerance),
            knots,
        }
    }
}

impl GridTracer for ExactGridTracer<'_> {
    fn knots(&self) -> &Arc<[f64]> {
        &self.knots
    }

    fn add(&self, directions: &[DVec3], events: &mut EventLocator<'_>, batch: &mut PathBatch) {
        // On past exits: neighbours that leave later are interpolated with what is there.
        let curves = self.exact.curves(directions, false);
        for (direction, curve) in directions.iter().zip(curves) {
            let close = worst_middle(&curve, &self.knots) <= KNOT_ERROR;
            let source = (*direction, PathOrigin::Knots);
            batch.push(
                source,
                |knots, rows| fill(&curve, knots, rows),
                |path| {
                    let event = close.then(|| events.ending(path))?;
                    event.or((path.known == path.knots.len()).then_some(Ending::Length))
                },
            );
        }
    }

    fn refine(&self, path: PathView<'_>, s: &[f64], rows: &mut [f64]) {
        path.sample(s, rows);
    }

    fn slack(&self) -> f64 {
        KNOT_ERROR
    }

    fn fallback(&self) -> Option<&ExactTracer<'_>> {
        Some(&self.exact)
    }
}

/// Writes the states of `curve` at `knots` into six rows, and returns how many it has.
fn fill(curve: &Curve, knots: &[f64], rows: &mut [f64]) -> usize {
    for (k, s) in knots.iter().enumerate() {
        let Some(state) = curve.state(*s) else {
            return k;
        };
        put(rows, k, state);
    }
    knots.len()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Stage,
        frame::{Paths, offsets, trace},
        intersect::Seen,
    };
    use std::path::Path;

    #[test]
    fn the_lattice_of_exact_paths_sees_what_each_exact_path_sees() {
        let file = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../assets/scenes/wormhole-gallery.toml"
        );
        let stage = Stage::load(Path::new(file), &[]).unwrap();
        let view = stage.view(&stage.scene.camera, (64, 36)).unwrap();
        let (manifold, length) = (&stage.world.manifold, 24.0);
        let knots = ExactGridTracer::choose_knots(manifold, view.u, length, 1e-7);
        let grid = ExactGridTracer::new(manifold, view.u, knots, 1e-7);
        let exact = ExactTracer::new(manifold, view.u, length, 1e-8);
        let seen = |paths| trace(&stage.world, &view, paths, &offsets(1)).outcomes;
        let (fast, slow) = (
            seen(Paths::Lattice(&grid, 5e-4)),
            seen(Paths::Exact(&exact)),
        );
        let alike = |(a, b): (&Seen, &Seen)| match (a, b) {
            (
                Seen::Sky {
                    exit, direction, ..
                },
                Seen::Sky {
                    exit: other,
                    direction: known,
                    ..
                },
            ) => exit == other && direction.angle_between(*known) < 5e-3,
            (Seen::Surface(a), Seen::Surface(b)) => {
                let way = stage.world.point(a) - stage.world.point(b);
                way.length() < 1e-2
            }
            (a, b) => a == b,
        };
        let same = fast.iter().zip(&slow).filter(|pair| alike(*pair)).count();
        // Pixels at silhouettes and at the rim of the throat may fall either way.
        assert!(
            same as f64 > 0.98 * slow.len() as f64,
            "{same} of {}",
            slow.len()
        );
    }
}
