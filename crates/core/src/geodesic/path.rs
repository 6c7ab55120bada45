//! Whole geodesics with dense output: their samples, the time that light takes along them, and where they arrive.
//!
//! In: [`Ray`]s. Out: [`Path`]s; equally spaced [`Sample`]s of one, from arc length 0 to the path's end, both
//! included, vectors in chart components, glued coordinates inside their limits; the time of the spacetime
//! that passes along it.
//!
//! The exponential map takes a tangent vector `w` at a chart point `u` to where the geodesic with velocity `w`
//! arrives after unit time, `exp_u(w)`. Its differential by `w` comes from the geodesic deviation: along `w` it is
//! the tangent, across it `J/|w|` (M. do Carmo, *Riemannian Geometry*, ch. 5, cor. 2.5).

use super::{End, Ray, Settings, Sink, Step, follow, signed_area};
use crate::manifold::{Carried, Manifold};
use glam::{DMat3, DQuat, DVec3};
use std::num::NonZeroU32;

/// A geodesic as its steps.
#[derive(Debug, Clone)]
pub struct Path {
    /// The steps in order, without gaps.
    pub steps: Vec<Step>,
    /// The reason of its end.
    pub end: End,
    /// The arc length at which it ended.
    pub length: f64,
    /// Number of steps tried, rejected ones included.
    pub tried: usize,
}

impl Path {
    /// Lists the edges that the path meets: where, and their numbers (see [`Step::edge`]).
    pub fn edges(&self) -> impl Iterator<Item = (f64, NonZeroU32)> {
        self.steps
            .iter()
            .filter_map(|step| Some((step.start, step.edge?)))
    }

    /// The step that covers arc length `s`; `None` for a path that ended at its start.
    pub fn step_at(&self, s: f64) -> Option<&Step> {
        let after = self.steps.partition_point(|step| step.end < s);
        self.steps
            .get(after.min(self.steps.len().saturating_sub(1)))
    }
}

/// Follows `rays` and keeps their paths.
pub fn paths(
    manifold: &Manifold,
    settings: Settings,
    rays: impl IntoIterator<Item = Ray>,
) -> Vec<Path> {
    let mut kept = Vec::new();
    follow(manifold, settings, rays, &mut kept);
    kept
}

/// Follows `rays` and keeps the last step of each, with the arc length at which it ended; `None`
/// for a ray that ended at its start.
pub fn ends(
    manifold: &Manifold,
    settings: Settings,
    rays: impl IntoIterator<Item = Ray>,
) -> Vec<Option<(Step, f64)>> {
    let mut last = LastSteps(Vec::new());
    follow(manifold, settings, rays, &mut last);
    last.0
}

struct LastSteps(Vec<Option<(Step, f64)>>);

impl Sink for LastSteps {
    fn wants(&self, _: usize, _: f64) -> bool {
        false
    }

    fn step(&mut self, ray: usize, step: &Step) {
        if self.0.len() <= ray {
            self.0.resize(ray + 1, None);
        }
        self.0[ray] = Some((step.clone(), step.end));
    }

    fn end(&mut self, ray: usize, _: End, _: f64, _: usize) {
        if self.0.len() <= ray {
            self.0.resize(ray + 1, None);
        }
    }
}

/// A list keeps whole paths, each at the number of its ray.
impl Sink for Vec<Path> {
    fn step(&mut self, ray: usize, step: &Step) {
        path_of(self, ray).steps.push(step.clone());
    }

    fn end(&mut self, ray: usize, end: End, s: f64, steps: usize) {
        let path = path_of(self, ray);
        (path.end, path.length, path.tried) = (end, s, steps);
    }
}

/// Returns the path of a ray among those kept, empty at first.
fn path_of(kept: &mut Vec<Path>, ray: usize) -> &mut Path {
    let nothing = || Path {
        steps: Vec::new(),
        end: End::Length,
        length: 0.0,
        tried: 0,
    };
    if kept.len() <= ray {
        kept.resize_with(ray + 1, nothing);
    }
    &mut kept[ray]
}

/// State of a path at one arc length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Arc length from the start.
    pub s: f64,
    /// Chart point, inside the limits of glued coordinates.
    pub u: DVec3,
    /// Tangent, of unit length (against the wind, where there is one).
    pub v: DVec3,
    /// Columns: the transported vectors that start as the standard frame. `None` when the frame
    /// was not carried, but for a path that ended where it starts.
    pub frame: Option<DMat3>,
    /// The area by which a unit solid angle has spread. `None` when deviation was not carried, but for a path that ended
    /// where it starts.
    pub area: Option<f64>,
    /// Faces of a glued domain crossed up to here.
    pub crossings: u32,
    /// Set if they have turned right into left.
    pub reversed: bool,
}

/// `count` equally spaced samples of `path`, which must be the path of `ray`; at least two. A path
/// that ended at its start gives its start `count` times.
pub fn samples(manifold: &Manifold, ray: &Ray, path: &Path, count: usize) -> Vec<Sample> {
    let last = count.max(2) - 1;
    (0..=last)
        .map(|i| path.length * (i as f64 / last as f64))
        .map(|s| sample(manifold, ray, path, s))
        .collect()
}

/// Computes the sample of `path`, which must be the path of `ray`, at arc length `s` up to its end.
pub fn sample(manifold: &Manifold, ray: &Ray, path: &Path, s: f64) -> Sample {
    match path.step_at(s) {
        Some(step) => on_step(manifold, step, s),
        None => at_start(manifold, ray),
    }
}

fn on_step(manifold: &Manifold, step: &Step, s: f64) -> Sample {
    let u = manifold.domain.wrap(step.position(s));
    let local = manifold.local_frame(u);
    let v = local.restored(manifold.metric(u), step.tangent(s));
    let area = |j| signed_area(&local, v, j).abs();
    Sample {
        s,
        u,
        v,
        frame: step.frame(s).map(|carried| local.frame * carried),
        area: step.deviation(s).map(area),
        crossings: step.crossings,
        reversed: step.reversed,
    }
}

fn at_start(manifold: &Manifold, ray: &Ray) -> Sample {
    let u = manifold.domain.wrap(ray.u);
    Sample {
        s: 0.0,
        u,
        v: ray.v,
        frame: Some(manifold.standard_frame(u)),
        area: Some(0.0),
        crossings: 0,
        reversed: false,
    }
}

/// Nodes and weights of Gauss's rule of order twelve on [−1, 1], those of one side.
const GAUSS: [(f64, f64); 3] = [
    (0.238_619_186_083_196_9, 0.467_913_934_572_691_1),
    (0.661_209_386_466_264_5, 0.360_761_573_048_138_6),
    (0.932_469_514_203_152, 0.171_324_492_379_170_36),
];

/// The time that light takes from the start of `path` to the parameter `s`.
pub fn elapsed(manifold: &Manifold, path: &Path, s: f64) -> f64 {
    if !manifold.has_drift() {
        return s;
    }
    let mut time = 0.0;
    for step in path.steps.iter().take_while(|step| step.start < s) {
        let to = step.end.min(s);
        let (middle, half) = (0.5 * (step.start + to), 0.5 * (to - step.start));
        let rate = |x: f64| {
            let s = middle + half * x;
            manifold.time_rate(step.position(s), step.tangent(s))
        };
        for (x, weight) in GAUSS {
            time += half * weight * (rate(x) + rate(-x));
        }
    }
    time
}

/// `exp_u(w)` and what belongs to it. Vectors are in chart components.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exponential {
    /// The point reached. A glued coordinate is not brought back inside its limits.
    pub point: DVec3,
    /// The velocity on arrival: as long as `w`.
    pub velocity: DVec3,
    /// `∂point/∂w`; singular where the point is conjugate to `u`.
    pub differential: DMat3,
    /// The transported rotation, relative to the standard frames.
    pub rotation: DQuat,
}

/// `exp_u(w)`, each step exact to `tolerance`; `None` where the geodesic ends before. Exits do not end
/// it, and no wind blows it off.
pub fn exponential(manifold: &Manifold, u: DVec3, w: DVec3, tolerance: f64) -> Option<Exponential> {
    let manifold = &*manifold.still();
    let s = manifold.standard_frame(u);
    let components = s.inverse() * w;
    let length = components.length();
    if length == 0.0 {
        return Some(Exponential {
            point: u,
            velocity: w,
            differential: DMat3::IDENTITY,
            rotation: DQuat::IDENTITY,
        });
    }
    let ray = Ray::new(manifold, u, components / length, length);
    let settings = Settings {
        tolerance,
        carried: Carried {
            frame: true,
            deviation: true,
        },
        events: false,
    };
    let path = paths(manifold, settings, [ray]).pop()?;
    match (path.end, path.steps.last()) {
        (End::Length, Some(step)) => arrival(&ray, step),
        _ => None,
    }
}

fn arrival(ray: &Ray, step: &Step) -> Option<Exponential> {
    let s = ray.length;
    let (v, j) = (step.tangent(s), step.deviation(s)?);
    // Columns: how the end moves with w along the ray, and across it.
    let moved = DMat3::from_cols(v, j[0] / s, j[1] / s);
    let start = DMat3::from_cols(ray.v, ray.spread[0], ray.spread[1]);
    Some(Exponential {
        point: step.position(s),
        velocity: v * s,
        differential: moved * start.inverse(),
        rotation: step.rotation(s)?,
    })
}
