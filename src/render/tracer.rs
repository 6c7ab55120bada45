//! Tracers: everything that turns (camera, directions) into curves.
//!
//! In: directions in the standard frame at the camera. Out: [`Curve`]s. [`ExactTracer`] integrates,
//! [`TableTracer`] looks up; where the table gave up it integrates too, and says so.

use super::curve::{Curve, Ending, EndingFinder, LANES, Piece, ending_at};
use crate::{
    bundle::{Fan, FanPath},
    geodesic::{End, Ray, Settings, Sink, Step, fixed_steps, follow},
    manifold::{Carried, Manifold},
};
use glam::{DMat3, DVec3};
use std::sync::Arc;

/// Turns directions into curves.
pub trait Tracer: Sync {
    /// The curves in `directions`, in order.
    fn trace(&self, directions: &[DVec3]) -> Vec<Curve>;
}

/// A tracer whose curves can be interpolated between directions, because all have the same knots.
pub trait GridTracer: Tracer {
    /// The knots' arc lengths.
    fn knots(&self) -> &Arc<[f64]>;

    /// The curve in `direction`; `None` where the tracer cannot give it on the common knots.
    fn on_knots(&self, direction: DVec3, endings: &mut EndingFinder<'_>) -> Option<Curve>;
}

/// Follows each ray by integration.
#[derive(Debug, Clone)]
pub struct ExactTracer<'m> {
    manifold: &'m Manifold,
    u: DVec3,
    frame: DMat3,
    length: f64,
    tolerance: f64,
}

/// Angle (radians) by which a cubic piece may depart from the integrator's quintic: a hundredth of
/// a mrad, below anything a picture shows.
const PIECE_ERROR: f64 = 1e-5;

impl<'m> ExactTracer<'m> {
    /// Rays from `u` over `length` at a local tolerance.
    pub fn new(manifold: &'m Manifold, u: DVec3, length: f64, tolerance: f64) -> Self {
        Self {
            manifold,
            u,
            frame: manifold.standard_frame(u),
            length,
            tolerance,
        }
    }
}

impl Tracer for ExactTracer<'_> {
    fn trace(&self, directions: &[DVec3]) -> Vec<Curve> {
        let settings = Settings {
            tolerance: self.tolerance,
            carried: Carried::default(),
            events: true,
        };
        let rays = directions.iter().map(|&d| Ray {
            u: self.u,
            v: self.frame * d,
            length: self.length,
            spread: [DVec3::ZERO; 2],
        });
        let mut sink = CurveSink {
            manifold: self.manifold,
            curves: directions
                .iter()
                .map(|&d| {
                    (
                        vec![0.0],
                        vec![self.u],
                        vec![self.frame * d],
                        Ending::Nowhere,
                    )
                })
                .collect(),
        };
        follow(self.manifold, settings, rays, &mut sink);
        let curve = |(s, u, v, ending): Growing| Curve {
            s: s.into(),
            u,
            v,
            ending,
            flagged: false,
        };
        sink.curves.into_iter().map(curve).collect()
    }
}

/// A curve being made: arc lengths, points, tangents, and how it ends.
type Growing = (Vec<f64>, Vec<DVec3>, Vec<DVec3>, Ending);

struct CurveSink<'m> {
    manifold: &'m Manifold,
    curves: Vec<Growing>,
}

impl Sink for CurveSink<'_> {
    fn step(&mut self, ray: usize, step: &Step) {
        let (s, u, v, _) = &mut self.curves[ray];
        let count = cubics(step);
        for k in 1..=count {
            let at = step.start + (step.end - step.start) * k as f64 / count as f64;
            s.push(at);
            u.push(step.position(at));
            v.push(step.tangent(at));
        }
    }

    fn end(&mut self, ray: usize, end: End, s: f64, _: usize) {
        let (_, u, v, ending) = &mut self.curves[ray];
        let (u, v) = (u[u.len() - 1], v[v.len() - 1]);
        *ending = ending_at(self.manifold, end, s, u, v);
    }
}

/// The step as cubics.
pub(super) fn pieces(step: &Step) -> impl Iterator<Item = Piece> {
    let count = cubics(step);
    let at = move |k: usize| step.start + (step.end - step.start) * k as f64 / count as f64;
    (0..count).map(move |k| {
        let s = [at(k), at(k + 1)];
        Piece {
            s,
            u: s.map(|s| step.position(s)),
            v: s.map(|s| step.tangent(s)),
        }
    })
}

/// How many cubics replace the quintic of `step`: the middle of one cubic tells, and the error
/// falls with the fourth power of the length.
fn cubics(step: &Step) -> usize {
    let (a, b) = (step.start, step.end);
    let (v0, v1) = (step.tangent(a), step.tangent(b));
    let cubic = (step.position(a) + step.position(b)) * 0.5 + (v0 - v1) * ((b - a) / 8.0);
    let error = (cubic - step.position(0.5 * (a + b))).length();
    let allowed = PIECE_ERROR * b * v0.length();
    if error <= allowed {
        return 1;
    }
    (error / allowed).powf(0.25).ceil().min(16.0) as usize
}

/// Follows each ray by equal steps in single precision: the rival that a table must beat at equal
/// error (DESIGN §7).
#[derive(Debug, Clone)]
pub struct FixedTracer<'m> {
    manifold: &'m Manifold,
    u: DVec3,
    frame: DMat3,
    knots: Arc<[f64]>,
}

impl<'m> FixedTracer<'m> {
    /// Rays from `u` over `length` in `steps` steps.
    pub fn new(manifold: &'m Manifold, u: DVec3, length: f64, steps: usize) -> Self {
        Self {
            manifold,
            u,
            frame: manifold.standard_frame(u),
            knots: even_knots(length, steps),
        }
    }
}

impl Tracer for FixedTracer<'_> {
    fn trace(&self, directions: &[DVec3]) -> Vec<Curve> {
        let mut endings = EndingFinder::new(self.manifold);
        let rays: Vec<_> = directions
            .iter()
            .map(|&d| (self.u, self.frame * d))
            .collect();
        let steps = self.knots.len() - 1;
        let knots = fixed_steps::<f32>(self.manifold, &rays, self.knots[steps], steps);
        let curve = |(u, v): (Vec<DVec3>, Vec<DVec3>)| Curve {
            ending: endings.ending(&self.knots, &u, &v),
            s: self.knots.clone(),
            u,
            v,
            flagged: false,
        };
        knots.into_iter().map(curve).collect()
    }
}

/// The ends of `n` equal intervals of [0, `length`].
fn even_knots(length: f64, n: usize) -> Arc<[f64]> {
    (0..=n).map(|k| length * k as f64 / n as f64).collect()
}

/// Looks rays up in a fan.
pub struct TableTracer<'f, 't> {
    fan: &'f Fan<'t>,
    manifold: &'f Manifold,
    knots: Arc<[f64]>,
    exact: ExactTracer<'f>,
}

impl<'f, 't> TableTracer<'f, 't> {
    /// Rays of `fan` over `length`, the table's; `error` is its promise in radians. Rays that it
    /// gave up on are integrated at `tolerance`, or at a small share of the promise if that is wider.
    pub fn new(
        fan: &'f Fan<'t>,
        manifold: &'f Manifold,
        length: f64,
        error: f64,
        tolerance: f64,
    ) -> Self {
        let tolerance = tolerance.max(FALLBACK_SHARE * error);
        let exact = ExactTracer::new(manifold, fan.place.u, length, tolerance);
        Self {
            fan,
            manifold,
            knots: choose_knots(&exact, KNOT_SHARE * error),
            exact,
        }
    }

    /// The curve of `path`, a block of knots at a time until it ends; `None` if the table gives up
    /// before.
    fn curve(&self, path: &FanPath<'_, '_>, endings: &mut EndingFinder<'_>) -> Option<Curve> {
        let knots = &self.knots;
        let (mut u, mut v) = (
            Vec::with_capacity(knots.len()),
            Vec::with_capacity(knots.len()),
        );
        let flagged = path.flagged_from();
        let known = knots.partition_point(|s| *s < flagged);
        endings.start();
        let mut ending = None;
        while ending.is_none() && u.len() < known {
            let range = u.len()..(u.len() + LANES).min(known);
            path.sample(&knots[range.clone()], &mut u, &mut v);
            ending = endings.ending_between(knots, &u, &v, range);
        }
        if ending.is_none() && known < knots.len() {
            return None;
        }
        Some(Curve {
            s: knots.clone(),
            u,
            v,
            ending: self.sharpened(ending.unwrap_or(Ending::Nowhere), path),
            flagged: false,
        })
    }

    /// The ending with its sky's direction from the transported tangent, which is closer than the
    /// slope of the interpolated curve.
    fn sharpened(&self, mut ending: Ending, path: &FanPath<'_, '_>) -> Ending {
        if let Ending::Exit { exit, s, sky } = &mut ending
            && let Some((u, v)) = path.state_at(*s)
        {
            *sky = self.manifold.sky_direction(Some(*exit), u, v);
        }
        ending
    }
}

impl Tracer for TableTracer<'_, '_> {
    fn trace(&self, directions: &[DVec3]) -> Vec<Curve> {
        let mut endings = EndingFinder::new(self.manifold);
        let mut curves: Vec<Option<Curve>> = directions
            .iter()
            .map(|&d| self.on_knots(d, &mut endings))
            .collect();
        let missing: Vec<usize> = (0..curves.len()).filter(|&i| curves[i].is_none()).collect();
        let rest: Vec<DVec3> = missing.iter().map(|&i| directions[i]).collect();
        for (i, mut curve) in missing.into_iter().zip(self.exact.trace(&rest)) {
            curve.flagged = true;
            curves[i] = Some(curve);
        }
        curves.into_iter().flatten().collect()
    }
}

impl GridTracer for TableTracer<'_, '_> {
    fn knots(&self) -> &Arc<[f64]> {
        &self.knots
    }

    fn on_knots(&self, direction: DVec3, endings: &mut EndingFinder<'_>) -> Option<Curve> {
        self.curve(&self.fan.path(direction), endings)
    }
}

/// Local tolerance of the rays that the table gave up on, as a share of its promise: their error is
/// then far below the promise, and they cost half of what the finest tolerance does.
const FALLBACK_SHARE: f64 = 1e-3;

/// Share of the table's own error that cubics between knots may add.
const KNOT_SHARE: f64 = 0.2;

/// Paths on which the knots are chosen.
const KNOT_PATHS: usize = 48;

/// The fewest equal intervals (of a few) between which cubics follow a sample of exact paths to
/// `allowed` radians, all but one in twelve. Exact paths, because the slopes of the table's own
/// polynomials carry noise that finer knots would only follow.
fn choose_knots(exact: &ExactTracer<'_>, allowed: f64) -> Arc<[f64]> {
    let directions: Vec<DVec3> = (0..KNOT_PATHS).map(fibonacci_direction).collect();
    let curves = exact.trace(&directions);
    let good = |n: &usize| {
        let knots = even_knots(exact.length, *n);
        let errors = curves.iter().map(|curve| worst_middle(curve, &knots));
        errors.filter(|e| *e > allowed).count() <= KNOT_PATHS / 12
    };
    let counts = [12, 16, 24, 32, 48, 64, 96, 128];
    even_knots(exact.length, counts.into_iter().find(good).unwrap_or(192))
}

/// The largest angle by which the middles of cubics between `knots` miss the curve.
fn worst_middle(curve: &Curve, knots: &[f64]) -> f64 {
    let end = curve.ending.limit();
    let mut worst = 0.0_f64;
    for pair in knots.windows(2).take_while(|pair| pair[1] < end) {
        let middle = 0.5 * (pair[0] + pair[1]);
        let (Some((u0, v0)), Some((u1, v1)), Some((u, v))) = (
            curve.state(pair[0]),
            curve.state(pair[1]),
            curve.state(middle),
        ) else {
            break;
        };
        let cubic = (u0 + u1) * 0.5 + (v0 - v1) * ((pair[1] - pair[0]) / 8.0);
        worst = worst.max((cubic - u).length() / (middle * v.length()));
    }
    worst
}

/// Directions spread evenly over the sphere.
fn fibonacci_direction(i: usize) -> DVec3 {
    let z = 1.0 - (2.0 * i as f64 + 1.0) / KNOT_PATHS as f64;
    let phi = i as f64 * 2.399_963_229_728_653;
    let r = (1.0 - z * z).sqrt();
    DVec3::new(r * phi.cos(), r * phi.sin(), z)
}
