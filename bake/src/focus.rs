//! How far away the rays of a table had best aim.
//!
//! In: the rays of a space. Out: the parallax of [`Focus`](geofan::fan::Focus) with which paths from
//! neighbouring cameras are most alike. Looked at are small random parts of the matrices cameras ×
//! directions of some cells and faces: the fewer singular values count, the smaller are tensor trains.

use crate::{lift::random_rays, refine::order};
use faer::Mat;
use geofan::{
    bundle::{
        PlanRecord,
        measure::{probe, stored_settings},
    },
    fan::{FanSpace, Mirror, cell, direction::direction, parallel, sample},
    random::Stream,
};
use glam::{DMat3, DVec2, DVec3};

/// Seed of the random parts.
const SEED: u64 = 0x0066_6f63_7573;

/// Parts looked at, their cameras and their directions.
const PARTS: usize = 8;
const CAMERAS: usize = 48;
const DIRECTIONS: usize = 12;

/// Random paths on which lengths of coordinates are taken.
const PATHS: usize = 256;

/// Places along each path, as shares of its length.
const PLACES: [f64; 3] = [0.3, 0.6, 0.95];

/// Spheres tried: the parallax of the farthest corner of a cell.
const TRIED: [f64; 6] = [0.2, 0.3, 0.4, 0.5, 0.6, 0.7];

/// By what share fewer bits must be promised to aim nearer. The strongest parallax is never worth it: it
/// crowds directions (a Gaussian lens takes 102 kB with 0.4, 117 kB with the 0.6 that promises 0.7 %
/// fewer bits).
const WORTH: f64 = 0.004;

/// The best parallax for the rays of `plan`, whose own does not count (columns of W).
pub fn best(space: &FanSpace, plan: &PlanRecord) -> [[f64; 3]; 3] {
    let none = [[0.0; 3]; 3];
    if space.planar() || space.cameras().is_empty() {
        return none;
    }
    let trial = Trial::new(space, plan);
    let unit = Mirror::averaged(&plan.mirrors, DMat3::from_diagonal(trial.scales()));
    let reach = trial.reach(unit);
    if !(reach > 0.0 && reach.is_finite()) {
        return none;
    }
    let mut best = (trial.bits(none), none);
    for share in TRIED {
        let focus = (unit * (share / reach)).to_cols_array_2d();
        let bits = trial.bits(focus);
        if !(bits < (1.0 - WORTH) * best.0) {
            break;
        }
        best = (bits, focus);
    }
    best.1
}

/// A part of the table: its cell, in it cameras in [−1, 1], and the unit vectors that rays are known by, in
/// a face or anywhere.
struct Part {
    cell: Vec<usize>,
    cameras: Vec<Vec<f64>>,
    aims: Vec<DVec3>,
}

/// Random parts of a table.
struct Trial<'a> {
    space: &'a FanSpace,
    plan: &'a PlanRecord,
    cells: Vec<usize>,
    parts: Vec<Part>,
}

impl<'a> Trial<'a> {
    fn new(space: &'a FanSpace, plan: &'a PlanRecord) -> Self {
        let mut stream = Stream::new(&[SEED]);
        let cells: Vec<usize> = plan.cells.iter().map(|n| *n as usize).collect();
        let part = |number: usize| {
            let cell = cells.iter().map(|n| stream.bits() as usize % n).collect();
            let mut points = |count: usize, axes: usize| -> Vec<Vec<f64>> {
                let point = |_| (0..axes).map(|_| stream.between(-1.0, 1.0)).collect();
                (0..count).map(point).collect()
            };
            let cameras = points(CAMERAS, cells.len());
            let directions = points(DIRECTIONS, space.directions());
            let aim = |d: &Vec<f64>| match plan.sphere() {
                Some(sphere) => sphere.direction([d[0], parallel(d[1])]),
                None => direction(number % space.faces(), DVec2::new(d[0], d[1])),
            };
            Part {
                cell,
                cameras,
                aims: directions.iter().map(aim).collect(),
            }
        };
        Self {
            parts: (0..PARTS).map(part).collect(),
            space,
            plan,
            cells,
        }
    }

    /// The stored parameters of a camera.
    fn parameters(&self, cell: &[usize], inner: &[f64]) -> Vec<f64> {
        cell::parameters(&self.cells, self.space.cameras(), cell, inner)
    }

    /// How much length a unit of each chart coordinate is, in the median of points on random paths.
    fn scales(&self) -> DVec3 {
        let rays = random_rays(self.space, PATHS);
        let lengths = |_: usize, _: f64| self.lengths().to_vec();
        let settings = stored_settings(self.space, self.plan.tolerance);
        let manifold = self.space.manifold();
        let paths = probe(manifold, settings, self.plan.length, &rays, lengths);
        let probes = || paths.iter().flat_map(|path| &path.probes);
        let metrics: Vec<DMat3> = probes().map(|probe| manifold.metric(probe.u)).collect();
        let scale = |k: usize| {
            let sizes = metrics.iter().map(|g| g.col(k)[k].sqrt());
            let mut sizes: Vec<f64> = sizes.collect();
            sizes.sort_by(f64::total_cmp);
            sizes.get(sizes.len() / 2).map_or(1.0, |s| *s)
        };
        DVec3::from_array([0, 1, 2].map(scale))
    }

    /// The arc lengths of [`PLACES`].
    fn lengths(&self) -> [f64; PLACES.len()] {
        PLACES.map(|share| share * self.plan.length)
    }

    /// The largest parallax of the corners of cells.
    fn reach(&self, parallax: DMat3) -> f64 {
        let axes = self.cells.len();
        let corner = |part: &Part, number: usize| {
            let side = |axis: usize| if number >> axis & 1 == 0 { -1.0 } else { 1.0 };
            let inner: Vec<f64> = (0..axes).map(side).collect();
            let at = |inner: &[f64]| self.space.stored_point(&self.parameters(&part.cell, inner));
            (parallax * (at(&inner) - at(&vec![0.0; axes]))).length()
        };
        let all = self.parts.iter();
        let all = all.flat_map(|part| (0..1 << axes).map(move |number| corner(part, number)));
        all.fold(0.0, f64::max)
    }

    /// About the bits that the parts take with rays aimed with the parallax `focus`.
    fn bits(&self, focus: [[f64; 3]; 3]) -> f64 {
        let plan = PlanRecord {
            focus,
            ..self.plan.clone()
        };
        let space = plan.applied(self.space.clone());
        let bits = self.parts.iter().map(|part| self.bits_of(part, &space));
        bits.sum()
    }

    fn bits_of(&self, part: &Part, space: &FanSpace) -> f64 {
        let manifold = space.manifold();
        let rays = part.cameras.iter().flat_map(|camera| {
            let camera = self.parameters(&part.cell, camera);
            let ray = move |aim: &DVec3| -> (DVec3, DVec3) {
                let (u, d) = space.ray_aimed(&camera, *aim);
                (u, manifold.observer(u).tangent(d))
            };
            part.aims.iter().map(ray)
        });
        let rays: Vec<(DVec3, DVec3)> = rays.collect();
        let lengths = self.lengths();
        let samples = sample(space, self.plan.tolerance, &rays, &lengths);
        let channels = space.channels();
        let width = lengths.len() * channels.len();
        order::bits(&Mat::from_fn(CAMERAS, DIRECTIONS * width, |i, j| {
            let (ray, rest) = (i * DIRECTIONS + j / width, j % width);
            let found = samples[[ray, rest / channels.len(), channels[rest % channels.len()]]];
            if found.is_finite() { found } else { 0.0 }
        }))
    }
}
