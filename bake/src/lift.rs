//! Which way of storing chart points makes paths smoothest.
//!
//! In: the rays of a space. Out: the [`ChartMap`] under which polynomials in the arc length fall off
//! fastest along random paths.

use crate::refine::{
    scout::{Line, Tails},
    sweep::Basis,
};
use geofan_bundle::{
    PlanRecord, chebyshev,
    measure::{probe, stored_settings},
    rays::{ChartMap, RaySpace},
};
use geofan_core::random::Stream;
use glam::DVec3;
use ndarray::Axis;

/// Seed of the random paths.
const SEED: u64 = 0x6c69_6674;

/// Random paths looked at.
const PATHS: usize = 96;

/// Nodes along each: enough to tell a path that leaves through infinity from one that does not.
const NODES: usize = 40;

/// By what factor the error of the highest coefficients must fall to leave the chart for a sphere:
/// its plain coordinates need fewer channels. For polar coordinates: they need as many.
const SPHERE_GAIN: f64 = 20.0;
const POLAR_GAIN: f64 = 2.0;

/// Radii tried, in units of the median distance of paths from the chart's origin.
const RADII: [f64; 3] = [0.5, 1.0, 2.0];

/// The lift for the paths of `plan`.
pub fn best_lift(space: &RaySpace, plan: &PlanRecord) -> ChartMap {
    let trial = Trial::new(space, plan);
    let middle = trial.middle_distance();
    let mut tried: Vec<(ChartMap, f64)> = Vec::new();
    if middle.is_finite() && middle > 0.0 {
        let sphere = |r: f64| ChartMap::Sphere { radius: r * middle };
        tried.extend(RADII.map(|r| (sphere(r), SPHERE_GAIN)));
    }
    if space.planar() {
        tried.push((ChartMap::Polar, POLAR_GAIN));
    }
    let costs = tried
        .iter()
        .map(|(lift, gain)| gain * trial.roughness(*lift));
    let best = tried
        .iter()
        .zip(costs)
        .min_by(|(_, a), (_, b)| a.total_cmp(b));
    match best {
        Some(((lift, _), cost)) if cost < trial.roughness(ChartMap::None) => *lift,
        _ => ChartMap::None,
    }
}

/// Random stored rays of a space: chart point and direction in the standard frame.
pub fn random_rays(space: &RaySpace, count: usize) -> Vec<(DVec3, DVec3)> {
    let mut stream = Stream::new(&[SEED]);
    let ray = |_| {
        let cameras = space.cameras().iter();
        let camera: Vec<f64> = cameras.map(|[a, b]| stream.between(*a, *b)).collect();
        let directions: Vec<f64> = (0..space.directions())
            .map(|_| stream.between(-1.0, 1.0))
            .collect();
        let face = (stream.bits() % space.faces() as u64) as usize;
        space.ray(face, &camera, &directions)
    };
    (0..count).map(ray).collect()
}

/// Random paths of a space.
struct Trial<'a> {
    space: &'a RaySpace,
    plan: &'a PlanRecord,
    /// Chart points and directions in the standard frame.
    rays: Vec<(DVec3, DVec3)>,
    lengths: Vec<f64>,
}

impl<'a> Trial<'a> {
    fn new(space: &'a RaySpace, plan: &'a PlanRecord) -> Self {
        let nodes = chebyshev::nodes(NODES);
        let half = 0.5 * plan.length;
        Self {
            space,
            plan,
            rays: random_rays(space, PATHS),
            lengths: nodes.iter().map(|t| half * (t + 1.0)).collect(),
        }
    }

    /// What polynomials in the arc length miss along nearly all paths, in units of the promise.
    fn roughness(&self, lift: ChartMap) -> f64 {
        let space = self.space.clone().lifted(lift);
        let mut tails = Tails::new(Basis::Polynomials, NODES, self.plan.max_error);
        Line::new(&space, self.plan, &self.rays, &self.lengths).each(Axis(0), &mut tails);
        tails.excess()
    }

    /// The median distance of points on paths from the chart's origin.
    fn middle_distance(&self) -> f64 {
        let settings = stored_settings(self.space, self.plan.tolerance);
        let manifold = self.space.manifold();
        let lengths = |_: usize, _: f64| self.lengths.clone();
        let paths = probe(manifold, settings, self.plan.length, &self.rays, lengths);
        let probes = paths.iter().flat_map(|path| &path.probes);
        let mut distances: Vec<f64> = probes.map(|probe| probe.u.length()).collect();
        distances.sort_by(f64::total_cmp);
        distances.get(distances.len() / 2).map_or(0.0, |d| *d)
    }
}
