//! The plan of a bake: everything that a chunk's content depends on, besides the manifold.
//!
//! In: the rays of a space, a length and a promise. Out: a [`PlanRecord`]: sizes of patches, the chart map
//! under which paths are smoothest, the discrete symmetries, the tolerance of the exact tracer; how
//! directions are parametrised is in `directions`. All is measured along random paths and equal for any
//! number of threads. Arc lengths are in the metric's unit, errors in mrad.
//!
//! Planning takes a bounded number of rays, but a stiff space makes each of them long: they are followed
//! in batches, and between batches the observer is told and asked.

use crate::{
    USUAL_PROMISE,
    directions::{REFERENCE_SPHERE_WORK, reference_sphere, sphere_axes},
    refine::{
        line_series::{LineSamples, SeriesTails},
        rough_exits,
    },
};
use geofan_bundle::{
    MOST_CHUNKS, MappedChebyshev, PlanRecord, TangentPromise, chebyshev,
    measure::{Probed, probe, stored_settings},
    rays::{ChartMap, Mirror, RaySpace},
};
use geofan_core::{Error, Observer, Progress, Result, random::Stream};
use glam::DVec3;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Counts up when refinement changes: parts of another count are baked again.
pub const REFINEMENT: u32 = 14;

/// The like count of what is done where paths meet edges of the metric; added for metrics that have any.
const REFINEMENT_AT_EDGES: u32 = 4 << 17;

/// The tracer's local tolerance while the plan is made.
const FIRST_TOLERANCE: f64 = 1e-8;

/// Stretch of the Chebyshev nodes (α of Kosloff and Tal-Ezer) along boxes of three and more axes, which
/// are rough all over (three bumps take 10 to 20 % fewer bytes than with plain nodes).
const STRETCH: f64 = 0.85;

/// Factor by which directions along a path may be farther off than points, in mrad, where no sky is looked up
/// by them: they only shade what is met, and a change of 2 mrad in the angle at which light is reflected
/// changes its brightness by less than a step of an eight-bit picture.
const SHADING: f64 = 4.0;

/// The like count of what is done where paths end at exits behind which they are rough; added for such spaces.
const REFINEMENT_AT_ENDS: u32 = 6 << 17;

/// Tells whether the paths of `plan` are divided at edges or ends.
pub fn divides_paths(plan: &PlanRecord) -> bool {
    plan.refinement >= REFINEMENT_AT_EDGES
}

/// Factor by which boxes of such spaces seen from one place may be smaller: what parts paths that end from those that go
/// on is a line among directions, and only small boxes beside it hold either. Of more axes there would be too many.
const LEAST_AT_ENDS: f64 = 0.25;

/// The most rays that a patch of such spaces is fitted to where rays have four axes: boxes beside what divides paths are
/// fitted to many and fail. Up to the eighth halving of the region about Kerr's hole, as many boxes are fitted as with
/// 400,000, by two fifths of the rays.
const MOST_RAYS_DIVIDED: u32 = 50_000;

/// Returns the promise of tangents when none is asked for: that of points where paths may end at a sky.
pub fn usual_tangents(space: &RaySpace, max_error: f64) -> TangentPromise {
    match space.manifold().domain.ends_rays() {
        true => TangentPromise::AsPoints,
        false => TangentPromise::Own(SHADING * max_error),
    }
}

/// Plans the bake of the rays of `space`; returns it with the space as it is stored.
///
/// # Errors
/// The observer ends it.
pub fn plan(
    space: RaySpace,
    length: f64,
    max_error: f64,
    tangents: TangentPromise,
    observer: &dyn Observer,
) -> Result<(RaySpace, PlanRecord)> {
    let first = first_plan(&space, length, max_error, tangents);
    complete_plan(space, first, observer)
}

/// Plans like [`plan`] with so many cells along each camera parameter: more than usual are more chunks, smaller ones,
/// so that more machines can share a long bake and less of it is lost when one fails.
///
/// # Errors
/// There are no camera parameters, more chunks than a bundle can have, or the observer ends it.
pub fn plan_in_cells(
    space: RaySpace,
    (length, max_error): (f64, f64),
    tangents: TangentPromise,
    cells: u32,
    observer: &dyn Observer,
) -> Result<(RaySpace, PlanRecord)> {
    let wrong = |message: String| Err(Error::input("cells", message));
    let cameras = space.cameras().len();
    if cameras == 0 {
        return wrong("the table has no camera parameters, so there is nothing to divide".into());
    }
    let chunks = u64::from(cells).saturating_pow(cameras as u32);
    let chunks = chunks.saturating_mul(space.faces() as u64);
    if !(1..=MOST_CHUNKS).contains(&chunks) {
        return wrong(format!(
            "{cells} along each of {cameras} parameters make {chunks} chunks; there are 1 to {MOST_CHUNKS}"
        ));
    }
    let mut first = first_plan(&space, length, max_error, tangents);
    first.cells = vec![cells; cameras];
    complete_plan(space, first, observer)
}

/// Finds out by trial what a first plan leaves open.
fn complete_plan(
    space: RaySpace,
    mut plan: PlanRecord,
    observer: &dyn Observer,
) -> Result<(RaySpace, PlanRecord)> {
    let watch = PlanWatch::new(observer);
    plan.mirrors = mirrors(&space, &plan, &watch)?;
    watch.reach(MIRROR_WORK)?;
    if meets_edges(&space, &plan, &watch)? {
        plan.refinement += REFINEMENT_AT_EDGES;
    }
    plan.chart_map = best_chart_map(&space, &plan, &watch)?;
    watch.reach(MIRROR_WORK + CHART_WORK)?;
    plan.tolerance = needed_tolerance(&space, &plan, &watch)?;
    watch.reach(MIRROR_WORK + CHART_WORK + TOLERANCE_WORK)?;
    let ends = rough_exits(&space, &plan, &watch)?;
    let divided = divides_paths(&plan) || ends.iter().any(Option::is_some);
    if divided && plan.nodes.len() == 5 {
        plan.most_rays = MOST_RAYS_DIVIDED;
    }
    if ends.iter().any(Option::is_some) {
        plan.refinement += REFINEMENT_AT_ENDS;
        if space.cameras().is_empty() {
            plan.least_volume *= LEAST_AT_ENDS;
        }
    }
    let space = space.ending_behind(ends);
    plan.sphere = sphere_axes(&space, &plan);
    plan.parallax = reference_sphere(&space, &plan, &watch)?;
    watch.reach(WORK)?;
    Ok((plan.applied(space), plan))
}

/// Finds the discrete symmetries that a bake of `space` over `length` uses.
///
/// # Errors
/// The observer ends it.
pub fn discrete_symmetries(
    space: &RaySpace,
    length: f64,
    observer: &dyn Observer,
) -> Result<Vec<Mirror>> {
    let plan = first_plan(space, length, USUAL_PROMISE, TangentPromise::AsPoints);
    mirrors(space, &plan, &PlanWatch::new(observer))
}

/// Work of the parts of planning in the unit of [`PlanWatch`]: rays followed with frame and deviation, at
/// most.
const MIRROR_WORK: u64 = 2 * MIRROR_PATHS as u64;
const CHART_WORK: u64 = (RADII.len() as u64 + 3) * CHART_PATHS as u64;
const TOLERANCE_WORK: u64 = 2 * (TOLERANCES.len() * TOLERANCE_RAYS) as u64;
const WORK: u64 = MIRROR_WORK + CHART_WORK + TOLERANCE_WORK + REFERENCE_SPHERE_WORK;

/// Rays followed between two looks at the observer: enough to fill all lanes for long.
const BATCH: usize = 64;

/// Tells the observer of planning how far it is.
pub struct PlanWatch<'a> {
    observer: &'a dyn Observer,
    done: AtomicU64,
}

impl<'a> PlanWatch<'a> {
    /// Begins.
    fn new(observer: &'a dyn Observer) -> Self {
        Self {
            observer,
            done: AtomicU64::new(0),
        }
    }

    /// Counts so many more rays.
    ///
    /// # Errors
    /// The observer ends the work.
    pub fn add(&self, rays: u64) -> Result<()> {
        let done = self.done.fetch_add(rays, Ordering::Relaxed) + rays;
        // Where more rays are asked than were counted on, planning still ends with its last step.
        self.tell(done.min(WORK - 1))
    }

    /// Goes on to the work `done`, which may have taken fewer rays.
    fn reach(&self, done: u64) -> Result<()> {
        self.tell(self.done.fetch_max(done, Ordering::Relaxed).max(done))
    }

    /// Reports the work `done`.
    fn tell(&self, done: u64) -> Result<()> {
        self.observer.progress(Progress {
            work: "planning",
            done: done.min(WORK),
            total: WORK,
            detail: "",
        });
        match self.observer.cancelled() {
            true => Err(Error::Interrupted {
                resume: "planning begins anew with the same command".into(),
            }),
            false => Ok(()),
        }
    }

    /// Follows rays and probes them like [`probe`], batch by batch.
    ///
    /// # Errors
    /// As [`PlanWatch::add`].
    pub fn probe(
        &self,
        space: &RaySpace,
        (length, tolerance): (f64, f64),
        rays: &[(DVec3, DVec3)],
        lengths: impl Fn(usize, f64) -> Vec<f64> + Sync,
    ) -> Result<Vec<Probed>> {
        let settings = stored_settings(space, tolerance);
        let manifold = space.manifold();
        let batches = rays.par_chunks(BATCH).enumerate();
        let probed = batches.map(|(number, batch)| {
            self.add(batch.len() as u64)?;
            let lengths = |ray: usize, end: f64| lengths(number * BATCH + ray, end);
            Ok(probe(manifold, settings, length, batch, lengths))
        });
        let probed: Vec<Vec<Probed>> = probed.collect::<Result<_>>()?;
        Ok(probed.into_iter().flatten().collect())
    }
}

/// Plans again without discrete symmetries.
pub fn unmirrored(space: RaySpace, mut plan: PlanRecord) -> (RaySpace, PlanRecord) {
    plan.mirrors = Vec::new();
    // Faces are counted as if each were stored by itself.
    plan.sphere = None;
    plan.sphere = sphere_axes(&space, &plan);
    (plan.applied(space), plan)
}

/// Begins a plan with the sizes for as many axes as `space` has besides the arc length.
fn first_plan(
    space: &RaySpace,
    length: f64,
    max_error: f64,
    tangents: TangentPromise,
) -> PlanRecord {
    let cameras = space.cameras().len();
    let axes = cameras + space.directions();
    // The most nodes along a camera or direction axis (many where few axes share them: large patches of
    // high degree win on bytes) and along the arc length; the most rays one patch is fitted to; how often
    // a chunk may be halved; and the cells along each camera parameter: what a camera has to decode.
    let (most_nodes, most_along_arc, most_rays, halvings, cells) = match axes {
        0 | 1 => (32, 60, 32, 11, 4),
        2 if cameras == 0 => (24, 48, 576, 11, 1),
        2 => (14, 48, 196, 11, 4),
        3 => (32, 40, 20_000, 14, 2),
        4 => (32, 32, 400_000, 14, 2),
        _ => (18, 24, 700_000, 15, 2),
    };
    let mut nodes = vec![most_nodes; axes];
    nodes.push(most_along_arc);
    PlanRecord {
        tangents,
        tolerance: FIRST_TOLERANCE,
        most_rays,
        refinement: REFINEMENT,
        least_volume: 0.5_f64.powi(halvings),
        most_arc_halvings: 3,
        mapping: mapping(axes),
        ..PlanRecord::new(length, max_error, vec![cells; cameras], nodes)
    }
}

/// Chooses the stretch of nodes. Boxes of few axes are halved towards what is rough in them, which then
/// lies at their ends, where plain Chebyshev polynomials have their nodes (Schwarzschild takes 4 % more
/// bytes with α = 0.8).
fn mapping(axes: usize) -> MappedChebyshev {
    match axes {
        ..3 => MappedChebyshev::NONE,
        _ => MappedChebyshev::new(STRETCH),
    }
}

/// Seed of the random rays.
const RANDOM_RAYS: u64 = 0x6c69_6674;

/// Draws random stored rays of a space: chart point and direction in the standard frame.
pub fn random_stored_rays(space: &RaySpace, count: usize) -> Vec<(DVec3, DVec3)> {
    let mut stream = Stream::new(&[RANDOM_RAYS]);
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

/// Random paths on which symmetries are tested. A part of the space that breaks a symmetry and that only
/// one path in a hundred comes near is met all but surely.
const MIRROR_PATHS: usize = 768;

/// Places along each.
const MIRROR_PLACES: usize = 24;

/// Claimed symmetries are checked at every so many of these places.
const CLAIMS_EVERY: usize = 3;

/// Finds the discrete symmetries of the rays of `plan`. No file claims them, so they are tested where it
/// matters: at points all along random paths; there those that the file claims are checked, too.
fn mirrors(space: &RaySpace, plan: &PlanRecord, watch: &PlanWatch<'_>) -> Result<Vec<Mirror>> {
    let rays = random_stored_rays(space, MIRROR_PATHS);
    let along = |_: usize, length: f64| {
        let places = 0..MIRROR_PLACES;
        places
            .map(|k| length * k as f64 / (MIRROR_PLACES - 1) as f64)
            .collect()
    };
    let probed = watch.probe(space, (plan.length, plan.tolerance), &rays, along)?;
    let probes = probed.iter().flat_map(|path| &path.probes);
    let states: Vec<_> = probes.map(|probe| (probe.u, probe.v)).collect();
    if states.is_empty() {
        return Ok(Vec::new());
    }
    let places: Vec<_> = states
        .iter()
        .step_by(CLAIMS_EVERY)
        .map(|(u, _)| *u)
        .collect();
    space.manifold().check_symmetry(&places)?;
    let cancelled = || watch.observer.cancelled();
    match Mirror::find(space, &states, &cancelled) {
        Some(mirrors) => Ok(mirrors),
        None => watch.add(0).map(|()| Vec::new()),
    }
}

/// Random paths that are followed to see whether the metric has edges.
const EDGE_PATHS: usize = 256;

/// Tells whether random paths meet edges of the metric.
fn meets_edges(space: &RaySpace, plan: &PlanRecord, watch: &PlanWatch<'_>) -> Result<bool> {
    if space.manifold().switching_functions().is_none() {
        return Ok(false);
    }
    let rays = random_stored_rays(space, EDGE_PATHS);
    let nowhere = |_: usize, _: f64| Vec::new();
    let paths = watch.probe(space, (plan.length, plan.tolerance), &rays, nowhere)?;
    Ok(paths.iter().any(|path| !path.edges.is_empty()))
}

/// Random paths on which chart maps are compared.
const CHART_PATHS: usize = 96;

/// Nodes along each: enough to tell a path that leaves through infinity from one that does not.
const CHART_NODES: usize = 40;

/// Factors by which the error of the highest coefficients must fall to leave the chart: for a sphere,
/// because the chart's plain coordinates need fewer channels; for polar coordinates, which need as many.
const SPHERE_GAIN: f64 = 20.0;
const POLAR_GAIN: f64 = 2.0;

/// Radii tried, in units of the median distance of paths from the chart's origin.
const RADII: [f64; 3] = [0.5, 1.0, 2.0];

/// Finds the chart map under which polynomials in the arc length fall off fastest along the paths of
/// `plan`: a path that leaves the chart through infinity is smooth on a sphere.
fn best_chart_map(space: &RaySpace, plan: &PlanRecord, watch: &PlanWatch<'_>) -> Result<ChartMap> {
    let rays = random_stored_rays(space, CHART_PATHS);
    let half = 0.5 * plan.length;
    let nodes = chebyshev::nodes(CHART_NODES);
    let lengths: Vec<f64> = nodes.iter().map(|t| half * (t + 1.0)).collect();
    let roughness = |map: ChartMap| {
        roughness(
            &space.clone().with_chart_map(map),
            plan,
            &rays,
            &lengths,
            watch,
        )
    };
    // The candidates, each with the gain that it must bring.
    let middle = median_distance(space, plan, &rays, &lengths, watch)?;
    let mut tried: Vec<(ChartMap, f64)> = Vec::new();
    if middle.is_finite() && middle > 0.0 {
        let sphere = |r: f64| ChartMap::Sphere { radius: r * middle };
        tried.extend(RADII.map(|r| (sphere(r), SPHERE_GAIN)));
    }
    if space.planar() {
        tried.push((ChartMap::Polar, POLAR_GAIN));
    }
    // The best of them, if it is better than the plain chart.
    let costs = tried
        .iter()
        .map(|(map, gain)| Ok((*map, gain * roughness(*map)?)));
    let costs = costs.collect::<Result<Vec<_>>>()?;
    let best = costs.into_iter().min_by(|(_, a), (_, b)| a.total_cmp(b));
    match best {
        Some((map, cost)) if cost < roughness(ChartMap::None)? => Ok(map),
        _ => Ok(ChartMap::None),
    }
}

/// Measures the error of polynomials in the arc length along nearly all of `rays`, in units of the promise.
fn roughness(
    space: &RaySpace,
    plan: &PlanRecord,
    rays: &[(DVec3, DVec3)],
    lengths: &[f64],
    watch: &PlanWatch<'_>,
) -> Result<f64> {
    let mut tails = SeriesTails::of_polynomials(CHART_NODES, plan.max_error);
    for batch in rays.chunks(BATCH) {
        watch.add(batch.len() as u64)?;
        LineSamples::new(space, (plan, plan.tolerance), batch, (lengths, None))
            .along_paths(&mut tails);
    }
    Ok(tails.excess())
}

/// Returns the median distance of the points at `lengths` on the paths of `rays` from the chart's origin.
fn median_distance(
    space: &RaySpace,
    plan: &PlanRecord,
    rays: &[(DVec3, DVec3)],
    lengths: &[f64],
    watch: &PlanWatch<'_>,
) -> Result<f64> {
    let at = |_: usize, _: f64| lengths.to_vec();
    let paths = watch.probe(space, (plan.length, plan.tolerance), rays, at)?;
    let probes = paths.iter().flat_map(|path| &path.probes);
    let mut distances: Vec<f64> = probes.map(|probe| probe.u.length()).collect();
    distances.sort_by(f64::total_cmp);
    Ok(distances.get(distances.len() / 2).map_or(0.0, |d| *d))
}

/// Random rays on which tolerances are compared.
const TOLERANCE_RAYS: usize = 256;

/// Share of the promise that the tracer's own error may take, as 99th percentile.
const TRACER_SHARE: f64 = 0.02;

/// Tolerances tried, loosest first, in units of the promise in radians.
const TOLERANCES: [f64; 6] = [1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7];

/// Factor by which the tolerance of the reference is tighter.
const REFERENCE: f64 = 1e-3;

/// Bounds of a sensible tolerance: rounding errors below, wrong paths above.
const TOLERANCE_BOUNDS: [f64; 2] = [1e-13, 1e-6];

/// Finds the loosest local tolerance at which the tracer's own errors do not count for the promise of
/// `plan`. It is measured: where neighbouring paths part exponentially, a local error of a billionth becomes
/// a visible one, and polynomials cannot follow it because it differs from ray to ray (Sol over length 5 at
/// a tolerance a millionth of the promise: 2 % of rays flagged for it); where they do not, a tight tolerance
/// is time lost.
fn needed_tolerance(space: &RaySpace, plan: &PlanRecord, watch: &PlanWatch<'_>) -> Result<f64> {
    let rays = random_stored_rays(space, TOLERANCE_RAYS);
    let [tightest, loosest] = TOLERANCE_BOUNDS;
    let tolerances =
        TOLERANCES.map(|share| (share * 1e-3 * plan.max_error).clamp(tightest, loosest));
    for tolerance in tolerances {
        let error = tracer_error(space, plan, &rays, tolerance, watch)?;
        if error <= TRACER_SHARE * plan.max_error {
            return Ok(tolerance);
        }
    }
    Ok(tightest)
}

/// Measures the 99th percentile of the screen errors of the tracer, mrad, at `tolerance`; infinite if no path can be
/// compared.
fn tracer_error(
    space: &RaySpace,
    plan: &PlanRecord,
    rays: &[(DVec3, DVec3)],
    tolerance: f64,
    watch: &PlanWatch<'_>,
) -> Result<f64> {
    // Every second ray near its end, where errors have grown most; the others on the way.
    let lengths = |ray: usize, end: f64| {
        let share = if ray.is_multiple_of(2) { 1.0 } else { 0.7 };
        vec![share * end.min(plan.length) * (1.0 - 1e-6)]
    };
    let reference = (REFERENCE * tolerance).max(TOLERANCE_BOUNDS[0]);
    let exact = watch.probe(space, (plan.length, reference), rays, lengths)?;
    // At the same arc length, unless the ray ends before: then something else than its path has changed.
    let same = |ray: usize, end: f64| {
        let probe = exact[ray].probes.first().filter(|probe| probe.s <= end);
        probe.map(|probe| probe.s).into_iter().collect()
    };
    let found = watch.probe(space, (plan.length, tolerance), rays, same)?;
    let pairs = found.iter().zip(&exact);
    let pairs = pairs.filter_map(|(found, exact)| found.probes.first().zip(exact.probes.first()));
    let mut errors: Vec<f64> = pairs.map(|(a, b)| b.screen_mrad(a.u - b.u)).collect();
    errors.sort_by(f64::total_cmp);
    // Of what cannot be compared nothing is known.
    let none = if rays.is_empty() { 0.0 } else { f64::INFINITY };
    Ok(errors.get(errors.len() * 99 / 100).map_or(none, |e| *e))
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::{diagnostic::SourceText, manifold::Manifold};
    use std::sync::{Arc, Mutex, atomic::AtomicBool};

    /// With an edge and an exit, so that every phase of planning has something to do.
    const SPACE: &str = r#"
name = "step"
coordinates = ["x", "y", "z"]
metric = { conformal = "if(x^2 + y^2 + z^2 < 1, 1.2, 1 + 0.1*exp(-x^2))" }
[[exit]]
name = "sky"
when = "x^2 + y^2 + z^2 - 20"
[cameras]
parameters = { c = [1.5, 2] }
at = ["c", "0.3", "0.1"]
length = 6.0
"#;

    /// Ends the work after so many reports.
    struct Patience {
        left: AtomicU64,
        over: AtomicBool,
        told: Mutex<Vec<u64>>,
    }

    impl Observer for Patience {
        fn progress(&self, progress: Progress<'_>) {
            assert!(progress.work == "planning" && progress.done <= progress.total);
            self.told.lock().unwrap().push(progress.done);
            let left = self.left.fetch_sub(1, Ordering::Relaxed);
            self.over.fetch_or(left <= 1, Ordering::Relaxed);
        }

        fn cancelled(&self) -> bool {
            self.over.load(Ordering::Relaxed)
        }
    }

    /// Plans with so many reports; returns how it ended and how much work was told.
    fn planned(reports: u64) -> (Result<PlanRecord>, Vec<u64>) {
        let source = SourceText::new("step.toml", SPACE);
        let space = RaySpace::new(Arc::new(Manifold::from_source(source, &[]).unwrap())).unwrap();
        let patience = Patience {
            left: reports.into(),
            over: AtomicBool::new(false),
            told: Mutex::default(),
        };
        let promised = TangentPromise::AsPoints;
        let planned = plan(space, 6.0, 3.0, promised, &patience).map(|(_, plan)| plan);
        (planned, patience.told.into_inner().unwrap())
    }

    #[test]
    fn planning_ends_wherever_the_user_ends_it_and_its_work_is_bounded() {
        let (whole, told) = planned(u64::MAX);
        assert!(whole.is_ok() && told.iter().max() == Some(&WORK));
        let reports = told.len() as u64;
        assert!(reports > 20, "{reports}");
        for at in (1..reports).step_by(reports as usize / 7) {
            let (ended, _) = planned(at);
            assert_eq!(
                ended.unwrap_err().exit_code(),
                75,
                "after {at} of {reports}"
            );
        }
    }
}
