//! Refinement of one chunk of the table: boxes halved until held-out rays meet the promise.
//!
//! In: a plan and a chunk number. Out: its [`Tree`], a pure function of both: neither threads nor
//! other chunks matter.
//!
//! A few lines through a box tell how many nodes it needs (`line_series`). If the plan allows as many it is sampled at
//! the tensor grid of Chebyshev nodes and fitted; its coefficients are rounded as coarsely as random held-out rays
//! allow, measured as the certificate measures them (`held_out`, `quantise`). Otherwise it is halved along the axis
//! that needs it most; one too small for that is flagged. A box may take minutes: its work looks whether it goes on
//! between pieces of a second and less ([`RefinementTally::stop`], which also counts it), and what is decided is kept
//! for after an interruption (`decision_log`). Boxes whose paths meet edges of the metric are divided there (`edges`).
//! The boxes of one level share an error budget (`refinement_tree`).

mod decision_log;
mod edges;
mod held_out;
pub(crate) mod line_series;
mod quantise;
mod refinement_tree;
mod separatrix;
#[cfg(test)]
mod stop_tests;
pub mod tensor_train;

pub use decision_log::DecisionLog;
pub(crate) use edges::rough_exits;

use crate::plan::divides_paths;
use geofan_bundle::{
    Division, PlanRecord, Polynomial, StepSize, Train, Tree, Variables, chebyshev,
    path_coefficients,
    rays::{
        DISPLACEMENT, FACES, RaySpace, SampleNumbers, SamplingPlan, StoredCamera,
        parameters_in_cell,
    },
};
use geofan_core::Stop;
use glam::DVec3;
use held_out::HeldOutRays;
use line_series::{Resolution, tail};
use ndarray::ArrayD;
use rayon::prelude::*;
use refinement_tree::{Decision, ParameterBox, RefinementTree};
use std::{
    ops::Range,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
};

/// Names the version of refinement: what another one has decided or finished is baked again.
pub const GENERATOR: &str = env!("CARGO_PKG_VERSION");

/// Factor by which the smallest boxes may exceed the promise along lines and still be fitted: the
/// quantile often forgives it.
const HOPE: f64 = 4.0;

/// Share of the promise that a polynomial may miss before more nodes are tried: what it leaves is
/// for rounding, and coarser steps save more bytes than the nodes cost.
const ROOMY: f64 = 0.5;

/// Factor by which the first half of the arc lengths must be smoother than the whole for the arc
/// length to be halved instead: neighbouring paths part exponentially, and what is sharp at their
/// ends is not where they begin.
const LATE: f64 = 10.0;

/// The most nodes along the arc length of a patch of the whole sphere: files have room for few more.
const MOST_ALONG_ARC: usize = 60;

/// The most rays that a patch of the whole sphere is fitted to: they take so much memory.
const MOST_RAYS: usize = 1_000_000;

/// Operations for each sample that a polynomial is fitted to: its axes have some twenty nodes each.
const FITTING: usize = 100;

/// Refines one chunk at a time.
pub struct Refiner<'a> {
    /// The rays.
    pub space: &'a RaySpace,
    /// The plan.
    pub plan: &'a PlanRecord,
    /// Division of the table into chunks.
    pub division: &'a Division,
    /// Progress.
    pub tally: &'a RefinementTally<'a>,
    /// The share of the chunk that is flagged instead of halved further, where one is asked for.
    pub flagged: Option<f64>,
    /// Keeps decisions for after an interruption.
    pub log: Option<&'a DecisionLog>,
}

/// Decisions about boxes.
impl Refiner<'_> {
    /// Returns the tree of `chunk`; `None` if told to stop.
    pub fn chunk(&self, chunk: usize) -> Option<Tree> {
        let name = vec![self.plan.seed, chunk as u64];
        let face = match self.space.sphere() {
            Some(_) => None,
            None => Some(self.division.of(chunk).1),
        };
        let root = ParameterBox::whole(self.plan.nodes.len(), face, name);
        let mut tree = RefinementTree::new(root);
        while tree.open().len() > 0 {
            let budget = tree.error_budget();
            let open: Vec<&ParameterBox> = tree.open().collect();
            let decide = |bounds: &ParameterBox| self.decide_once(chunk, bounds, budget);
            let decisions: Option<Vec<Decision>> = open.into_par_iter().map(decide).collect();
            // Those in the midst of which it was stopped are none.
            let mut decisions = decisions.filter(|_| !self.tally.stop().told())?;
            if divides_paths(self.plan) || self.flagged.is_some() {
                let given_up = tree.settle(&mut decisions, self.flagged) as u64;
                self.tally.add(WorkCounts {
                    patches: given_up,
                    ..WorkCounts::default()
                });
            }
            tree.grow(decisions);
        }
        Some(tree.into_tree())
    }

    /// Decides about a box like [`Refiner::decide`], or as an earlier run did; `None` if told to stop.
    fn decide_once(&self, chunk: usize, bounds: &ParameterBox, budget: f64) -> Option<Decision> {
        if let Some((decision, counts)) = self.log.and_then(|log| log.earlier(bounds, budget)) {
            self.tally.add(counts);
            return Some(decision);
        }
        if !self.tally.stop().goes_on(0) {
            return None;
        }
        let tally = self.tally.of_box();
        let refiner = Refiner {
            tally: &tally,
            ..*self
        };
        let decision = refiner.decide(chunk, bounds, budget);
        // One that was stopped in the midst of it is none, and that of a whole chunk is kept as the chunk.
        let whole = bounds.share == 1.0 && matches!(decision, Decision::Fitted(_));
        if let Some(log) = self.log.filter(|_| !whole && !tally.stop().told()) {
            log.add(bounds, budget, &decision, tally.counts());
        }
        Some(decision)
    }

    /// Decides about a box whose error budget is `budget` times its volume's share.
    fn decide(&self, chunk: usize, bounds: &ParameterBox, budget: f64) -> Decision {
        if let Some(behind) = bounds.piece().behind_end(self.space) {
            return Decision::Unread(self.behind_end(chunk, bounds, behind));
        }
        let mut held_out = HeldOutRays::new(self, chunk, bounds, budget);
        if held_out.is_empty() && !held_out.singular {
            self.count_finished(bounds, 1);
            return Decision::Unread(self.straight_lines(bounds));
        }
        if bounds.face.is_none() {
            return self.decide_sphere(chunk, bounds, &mut held_out);
        }
        if let Some(decision) = self.decide_edges(chunk, bounds, &mut held_out) {
            return decision;
        }
        let resolution = Resolution::new(self, chunk, bounds);
        let may_halve = self.may_halve(bounds);
        // A box is fitted if lines through it are resolved, the last ones also if they nearly are.
        let resolved = resolution.excess.iter().all(|e| *e <= 1.0);
        let hopeful = resolution.excess.iter().all(|e| *e <= HOPE);
        let affordable = resolution.rays() <= self.most_rays(bounds);
        let last = !may_halve.iter().any(|m| *m);
        if affordable && !held_out.singular && (resolved || (last && hopeful)) {
            match self.fitted(chunk, bounds, resolution.clone(), &mut held_out) {
                Ok(tree) => return Decision::Fitted(tree),
                // The coefficients do not show what ends within the box.
                Err(_) if held_out.singular => {}
                Err(urgency) => {
                    if let Some(axis) = most_urgent(&urgency, &may_halve) {
                        return Decision::Halve(axis);
                    }
                }
            }
        }
        let urgency = self.urgency_of_halving(bounds, &resolution, resolved);
        match most_urgent(&urgency, &may_halve) {
            Some(axis) => Decision::Halve(axis),
            None => {
                self.count_finished(bounds, 1);
                Decision::Unread(Tree::Flagged)
            }
        }
    }

    /// Decides about a box with the whole sphere of directions: one patch, or its faces are refined each by
    /// itself, because they need different halving.
    fn decide_sphere(
        &self,
        chunk: usize,
        bounds: &ParameterBox,
        held_out: &mut HeldOutRays<'_>,
    ) -> Decision {
        if held_out.meets_edges() {
            return Decision::Faces;
        }
        let resolution = Resolution::new(self, chunk, bounds);
        let resolved = resolution.excess.iter().all(|e| *e <= 1.0);
        let affordable = resolution.rays() <= self.most_rays(bounds);
        if held_out.singular || !resolved || !affordable {
            return Decision::Faces;
        }
        let tree = self.fitted(chunk, bounds, resolution, held_out);
        tree.map_or(Decision::Faces, Decision::Fitted)
    }

    /// Rates each axis by the use of halving a box along it: by the excess of its error; where the nodes
    /// are only too many in all, by the number of them (halving the arc length saves no rays).
    fn urgency_of_halving(
        &self,
        bounds: &ParameterBox,
        resolution: &Resolution,
        resolved: bool,
    ) -> Vec<f64> {
        let arc = bounds.arc();
        if resolved {
            let mut counts: Vec<f64> = resolution.nodes.iter().map(|n| *n as f64).collect();
            counts[arc] = 0.0;
            return counts;
        }
        let mut urgency = resolution.excess.clone();
        let most = urgency.iter().copied().fold(0.0, f64::max);
        if resolution.early_excess * LATE < most {
            urgency[arc] = f64::INFINITY;
        }
        urgency
    }

    /// Fits the patch of a box, with more nodes than needed along lines if those do not hold or leave no room
    /// for rounding; the error is the urgency of halving along each axis.
    fn fitted(
        &self,
        chunk: usize,
        bounds: &ParameterBox,
        mut resolution: Resolution,
        held_out: &mut HeldOutRays<'_>,
    ) -> Result<Tree, Vec<f64>> {
        loop {
            if bounds.face.is_none() {
                // Waves come in pairs.
                resolution.nodes[bounds.arc() - 2] |= 1;
            }
            let polynomial = self.fit(chunk, bounds, &resolution.nodes)?;
            let spectra = polynomial.spectra();
            let left = held_out.error_of(&polynomial);
            let limits = (&self.most_nodes(bounds)[..], self.most_rays(bounds));
            if left > ROOMY && !held_out.singular && resolution.raise(limits, &spectra, left) {
                continue;
            }
            let urgency: Vec<f64> = spectra.iter().map(|s| tail(s)).collect();
            let holds = left <= 1.0 && !held_out.singular;
            let found = holds
                .then(|| self.quantise(&polynomial, held_out))
                .flatten();
            let tensor = found.ok_or(urgency)?;
            self.count_finished(bounds, tensor.bytes());
            return Ok(Tree::Leaf(Arc::new(tensor)));
        }
    }

    /// Makes the patch of a box that no ray gets to: straight lines.
    fn straight_lines(&self, bounds: &ParameterBox) -> Tree {
        let mut shape = vec![1; self.plan.nodes.len()];
        shape.push(self.space.channels().len());
        let straight = Polynomial {
            coefficients: ArrayD::zeros(shape),
            variables: self.variables(bounds),
        };
        let straight = Train::plain(&straight);
        let rounded = straight.rounded(StepSize::near(1.0));
        Tree::Leaf(Arc::new(rounded.expect("zeros")))
    }

    /// Counts a box as finished.
    fn count_finished(&self, bounds: &ParameterBox, bytes: usize) {
        let chunks = self.division.chunks() as f64;
        let share = bounds.share / chunks * f64::from(u32::MAX);
        self.tally.add(WorkCounts {
            rays: 0,
            patches: 1,
            bytes: bytes as u64,
            volume: share as u64,
        });
    }

    /// Tells along which axes the box may be halved.
    fn may_halve(&self, bounds: &ParameterBox) -> Vec<bool> {
        let small = bounds.volume() <= self.plan.least_volume;
        let mut may = vec![!small; bounds.intervals.len()];
        may[bounds.arc()] = bounds.arc_halvings() < self.plan.most_arc_halvings;
        may
    }

    /// Returns the tracer's local tolerance for the rays of a box.
    fn tolerance(&self, bounds: &ParameterBox) -> f64 {
        match bounds.beside {
            Some(_) => separatrix::finer(self.plan.tolerance),
            None => self.plan.tolerance,
        }
    }

    /// Returns the most nodes along each axis of a box. Around the whole sphere there are four faces, from
    /// pole to pole two; and along the arc it needs what the worst of its faces does.
    fn most_nodes(&self, bounds: &ParameterBox) -> Vec<usize> {
        let mut most: Vec<usize> = self.plan.nodes.iter().map(|n| *n as usize).collect();
        if bounds.face.is_none() {
            let arc = bounds.arc();
            most[arc - 2] = 4 * most[arc - 2] - 1;
            most[arc - 1] *= 2;
            most[arc] = (5 * most[arc] / 4).min(MOST_ALONG_ARC);
        }
        most
    }

    /// Returns the most rays that a box is fitted to.
    fn most_rays(&self, bounds: &ParameterBox) -> usize {
        let most = self.plan.most_rays as usize;
        match bounds.face {
            Some(_) => most,
            None => (FACES * most).min(MOST_RAYS.max(most)),
        }
    }
}

/// Rays of boxes and the polynomials through them.
impl Refiner<'_> {
    /// Fits the polynomial through exact samples on the tensor grid of `nodes`, its rows along the arc
    /// length as [`path_coefficients`] unfolds them. Where some of the rays meet other edges than the box's, returns
    /// the urgency of halving each axis instead.
    fn fit(
        &self,
        chunk: usize,
        bounds: &ParameterBox,
        nodes: &[usize],
    ) -> Result<Polynomial, Vec<f64>> {
        // A box that begins at the start of paths stores no displacement there.
        let count = nodes[..bounds.arc()].iter().product();
        let parameters = self.grid_parameters(bounds, nodes);
        let pieces = self.pieces(bounds, &parameters);
        let interval = match &pieces {
            Some((_, intervals)) => intervals[0],
            None => bounds.arc_interval(self.plan.length),
        };
        let starts = usize::from(path_coefficients::stores_start(interval));
        let mut lengths = vec![if pieces.is_some() { 0.0 } else { interval[0] }; starts];
        lengths.extend(self.arc_lengths(bounds, nodes[bounds.arc()]));
        // Exact samples: slopes at the nodes, and the displacement that they add to.
        let channels = self.space.channels();
        let samples = SamplingPlan {
            space: self.space,
            tolerance: self.tolerance(bounds),
            lengths: &lengths,
            width: channels.len(),
            between: pieces.as_ref().map(edges::between),
        };
        let keep = |at: usize, sample: &SampleNumbers, to: &mut [f64]| {
            let first = if at < starts { DISPLACEMENT } else { 0 };
            for (to, channel) in to.iter_mut().zip(channels) {
                *to = sample[first + channel];
            }
        };
        let samples = samples.of(count, self.grid(chunk, bounds, nodes), keep);
        if !self.tally.stop().goes_on(samples.len() * FITTING) {
            return Err(vec![0.0; nodes.len()]);
        }
        let width = samples.len() / count.max(1);
        if pieces.is_some() && samples.iter().step_by(width).any(|x| x.is_nan()) {
            let numbers = samples.iter().step_by(width).map(|x| x.is_nan());
            return Err(edges::parting(bounds, parameters.iter().zip(numbers)));
        }
        // Their polynomial.
        let mut shape = nodes[..bounds.arc()].to_vec();
        shape.extend([lengths.len(), channels.len()]);
        let samples = ArrayD::from_shape_vec(shape, samples);
        Ok(Polynomial::fit(
            samples.expect("one sample for each node"),
            starts,
            self.variables(bounds),
        ))
    }

    /// Says how the parameters of rays enter the polynomials of a box.
    fn variables(&self, bounds: &ParameterBox) -> Variables {
        bounds.variables(self.space.cameras().len(), self.plan.mapping)
    }

    /// Returns the `count` Chebyshev nodes of the box's arc lengths; between edges as shares of them.
    fn arc_lengths(&self, bounds: &ParameterBox, count: usize) -> Vec<f64> {
        let [start, end] = match bounds.edges {
            Some(_) => [0.0, 1.0],
            None => bounds.arc_interval(self.plan.length),
        };
        let nodes = chebyshev::nodes(count);
        let at = |t: &f64| start + 0.5 * (t + 1.0) * (end - start);
        nodes.iter().map(at).collect()
    }

    /// Returns the stored ray at box parameters `x` (camera…, direction…): chart point and direction in the
    /// standard frame.
    fn ray(&self, chunk: usize, bounds: &ParameterBox, x: &[f64]) -> (DVec3, DVec3) {
        let camera = self.camera(chunk, bounds, &x[..self.space.cameras().len()]);
        (camera.u, self.direction(&camera, bounds, x))
    }

    /// Returns the camera at box parameters `x` (camera…).
    fn camera(&self, chunk: usize, bounds: &ParameterBox, x: &[f64]) -> StoredCamera {
        let division = self.division;
        let (cell, _) = division.of(chunk);
        let inner: Vec<f64> = (0..x.len()).map(|j| bounds.at(j, x[j])).collect();
        let cameras = self.space.cameras();
        let parameters = parameters_in_cell(&division.cells, cameras, &cell, &inner);
        self.space.stored_camera(&parameters)
    }

    /// Returns the direction in the standard frame of the ray from `camera` at box parameters `x`
    /// (camera…, direction…).
    fn direction(&self, camera: &StoredCamera, bounds: &ParameterBox, x: &[f64]) -> DVec3 {
        let inner = bounds.in_chunk(x).split_off(self.space.cameras().len());
        match (bounds.face, self.space.sphere()) {
            (None, Some(sphere)) => camera.direction(sphere.direction([inner[0], inner[1]])),
            (face, _) => self.space.direction_from(camera, face.unwrap_or(0), &inner),
        }
    }

    /// Lists the parameters of the rays of the tensor grid of `nodes`; none if no edges bound the box.
    fn grid_parameters(&self, bounds: &ParameterBox, nodes: &[usize]) -> Vec<Vec<f64>> {
        match bounds.edges {
            Some(_) => self.all_parameters(bounds, nodes),
            None => Vec::new(),
        }
    }

    /// Lists the parameters of the rays of the tensor grid of `nodes`.
    fn all_parameters(&self, bounds: &ParameterBox, nodes: &[usize]) -> Vec<Vec<f64>> {
        let inputs = &nodes[..bounds.arc()];
        let count = inputs.iter().product();
        let variables = self.variables(bounds);
        let along = |(axis, n): (usize, &usize)| variables.places(axis, *n);
        let axes: Vec<Vec<f64>> = inputs.iter().enumerate().map(along).collect();
        (0..count).map(|number| grid_node(&axes, number)).collect()
    }

    /// Gives the rays of the tensor grid of `nodes` (chart point, unit tangent) by their number, the last
    /// axis running fastest, and counts them; none when it is stopped.
    fn grid(
        &self,
        chunk: usize,
        bounds: &ParameterBox,
        nodes: &[usize],
    ) -> impl Fn(Range<usize>) -> Vec<(DVec3, DVec3)> + Sync {
        let inputs = &nodes[..bounds.arc()];
        let variables = self.variables(bounds);
        let along = |(axis, n): (usize, &usize)| variables.places(axis, *n);
        let mut cameras: Vec<Vec<f64>> = inputs.iter().enumerate().map(along).collect();
        let directions = cameras.split_off(self.space.cameras().len());
        let each: usize = directions.iter().map(Vec::len).product();
        move |numbers| {
            if !self.tally.go_on(numbers.len()) {
                return Vec::new();
            }
            let mut rays = Vec::with_capacity(numbers.len());
            // Camera by camera, because each has one frame.
            for number in numbers.start / each..numbers.end.div_ceil(each) {
                let place = grid_node(&cameras, number);
                let camera = self.camera(chunk, bounds, &place);
                let local = self.space.manifold().local_frame(camera.u);
                let first = numbers.start.max(number * each);
                let own = first..numbers.end.min((number + 1) * each);
                rays.extend(own.map(|ray| {
                    let x = [&place[..], &grid_node(&directions, ray % each)].concat();
                    (camera.u, local.tangent(self.direction(&camera, bounds, &x)))
                }));
            }
            rays
        }
    }
}

/// Returns the node of this `number` in a tensor grid, the last axis running fastest.
fn grid_node(axes: &[Vec<f64>], number: usize) -> Vec<f64> {
    let mut rest = number;
    let mut x = vec![0.0; axes.len()];
    for (x, axis) in x.iter_mut().zip(axes).rev() {
        *x = axis[rest % axis.len()];
        rest /= axis.len();
    }
    x
}

/// Returns the axis with the largest urgency of those allowed.
fn most_urgent(urgency: &[f64], allowed: &[bool]) -> Option<usize> {
    (0..urgency.len())
        .filter(|&axis| allowed[axis])
        .max_by(|&a, &b| urgency[a].total_cmp(&urgency[b]).then(b.cmp(&a)))
}

/// Operations that following a ray takes: some dozens of steps of thousands each.
const RAY: usize = 300_000;

/// Says how much work was done.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub struct WorkCounts {
    /// Rays integrated.
    pub rays: u64,
    /// Patches finished.
    pub patches: u64,
    /// Bytes of them.
    pub bytes: u64,
    /// Volume finished, in units of 2⁻³² of all chunks.
    pub volume: u64,
}

/// Counts the work of refinement while it runs, and stops it.
#[derive(Debug, Default)]
pub struct RefinementTally<'a> {
    rays: AtomicU64,
    patches: AtomicU64,
    bytes: AtomicU64,
    volume: AtomicU64,
    stop: Stop,
    /// That of the whole chunk, if this is a box's.
    whole: Option<&'a RefinementTally<'a>>,
}

impl RefinementTally<'_> {
    /// Counts the work on a chunk that `stop` ends.
    pub fn new(stop: Stop) -> Self {
        Self {
            stop,
            ..Self::default()
        }
    }

    /// Counts the work on one box by itself; this tally counts it, too.
    pub fn of_box(&self) -> RefinementTally<'_> {
        RefinementTally {
            whole: Some(self),
            ..RefinementTally::default()
        }
    }

    /// Returns what ends the work.
    pub fn stop(&self) -> &Stop {
        self.whole.map_or(&self.stop, RefinementTally::stop)
    }

    /// Counts so many rays that are to be followed together, if the work goes on.
    pub fn go_on(&self, rays: usize) -> bool {
        let goes_on = self.stop().goes_on(rays * RAY);
        if goes_on {
            self.add(WorkCounts {
                rays: rays as u64,
                ..WorkCounts::default()
            });
        }
        goes_on
    }

    /// Adds work that was done.
    pub fn add(&self, counts: WorkCounts) {
        self.rays.fetch_add(counts.rays, Relaxed);
        self.patches.fetch_add(counts.patches, Relaxed);
        self.bytes.fetch_add(counts.bytes, Relaxed);
        self.volume.fetch_add(counts.volume, Relaxed);
        if let Some(whole) = self.whole {
            whole.add(counts);
        }
    }

    /// Takes note that the whole chunk has so many bytes: coded by itself each patch takes some percent more.
    pub fn settle(&self, bytes: u64) {
        self.bytes.store(bytes, Relaxed);
    }

    /// Returns what was counted so far.
    pub fn counts(&self) -> WorkCounts {
        WorkCounts {
            rays: self.rays.load(Relaxed),
            patches: self.patches.load(Relaxed),
            bytes: self.bytes.load(Relaxed),
            volume: self.volume.load(Relaxed),
        }
    }
}
