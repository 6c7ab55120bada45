//! One chunk of the table: boxes halved until held-out rays meet the promise.
//!
//! In: a plan and a chunk number. Out: its [`Tree`], a pure function of both: neither threads nor
//! other chunks matter.
//!
//! A few lines through a box tell how many nodes it needs (`scout`). If the plan allows as many it
//! is sampled at the tensor grid of Chebyshev nodes and fitted; its coefficients are rounded as
//! coarsely as random held-out rays allow, measured as the certificate measures them
//! (`held_out`, `quantise`). Otherwise it is halved along the axis that needs it most; one too
//! small for that is flagged.

pub(crate) mod decompose;
mod growth;
mod held_out;
pub(crate) mod order;
mod quantise;
mod region;
pub(crate) mod scout;
pub(crate) mod sweep;

use geofan::{
    bundle::{Division, PlanRecord, Polynomial, Step, Train, Tree, Variables, arc, chebyshev},
    fan::{DISPLACEMENT, FACES, FanSpace, Sample, Samples, StoredCamera, cell},
};
use glam::DVec3;
use growth::{Growth, Verdict};
use held_out::HeldOut;
use ndarray::ArrayD;
use rayon::prelude::*;
use region::Region;
use scout::{Needs, tail};
use std::{
    ops::Range,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
};

/// By what factor the smallest boxes may exceed the promise along lines and still be fitted: the
/// quantile often forgives it.
const HOPE: f64 = 4.0;

/// The share of the promise that a polynomial may miss before more nodes are tried: what it leaves is
/// for rounding, and coarser steps save more bytes than the nodes cost.
const ROOMY: f64 = 0.5;

/// By what factor the first half of the arc lengths must be smoother than the whole for the arc
/// length to be halved instead: neighbouring paths part exponentially, and what is sharp at their
/// ends is not where they begin.
const LATE: f64 = 10.0;

/// The most nodes along the arc length of a patch of the whole sphere: files have room for few more.
const MOST_ALONG_ARC: usize = 60;

/// The most rays that a patch of the whole sphere is fitted to: what they take of memory.
const MOST_RAYS: usize = 1_000_000;

/// What refinement tells while it runs.
#[derive(Debug, Default)]
pub struct Tally {
    /// Rays integrated.
    pub rays: AtomicU64,
    /// Patches finished.
    pub patches: AtomicU64,
    /// Bytes of them.
    pub bytes: AtomicU64,
    /// Volume finished, in units of 2⁻³² of all chunks.
    pub volume: AtomicU64,
    /// Set from outside to stop early.
    pub stop: AtomicBool,
}

/// Refines one chunk at a time.
pub struct Refiner<'a> {
    /// The rays.
    pub space: &'a FanSpace,
    /// The plan.
    pub plan: &'a PlanRecord,
    /// How the table is divided into chunks.
    pub division: &'a Division,
    /// Progress.
    pub tally: &'a Tally,
}

impl Refiner<'_> {
    /// The tree of `chunk`; `None` if told to stop.
    pub fn chunk(&self, chunk: usize) -> Option<Tree> {
        let name = vec![self.plan.seed, chunk as u64];
        let face = match self.space.sphere() {
            Some(_) => None,
            None => Some(self.division.of(chunk).1),
        };
        let root = Region::whole(self.plan.nodes.len(), face, name);
        let mut growth = Growth::new(root);
        while growth.open().len() > 0 {
            let lenience = growth.lenience();
            let open: Vec<&Region> = growth.open().collect();
            let judge = |region: &Region| {
                let go_on = !self.tally.stop.load(Ordering::Relaxed);
                go_on.then(|| self.judge(chunk, region, lenience))
            };
            let verdicts: Option<Vec<Verdict>> = open.into_par_iter().map(judge).collect();
            growth.grow(verdicts?);
        }
        Some(growth.into_tree())
    }

    /// What becomes of a box with the whole sphere of directions: one patch, or its faces are refined
    /// each by itself, because they need different halving.
    fn judge_sphere(&self, chunk: usize, region: &Region, held_out: &mut HeldOut<'_>) -> Verdict {
        let needs = Needs::new(self, chunk, region);
        let resolved = needs.excess.iter().all(|e| *e <= 1.0);
        let affordable = needs.rays() <= self.most_rays(region);
        if held_out.singular || !resolved || !affordable {
            return Verdict::Part;
        }
        let tree = self.fitted(chunk, region, needs, held_out);
        tree.map_or(Verdict::Part, Verdict::Fitted)
    }

    /// What becomes of a box that is allowed `lenience` times as many misses as its volume's share.
    fn judge(&self, chunk: usize, region: &Region, lenience: f64) -> Verdict {
        let mut held_out = HeldOut::new(self, chunk, region, lenience);
        if held_out.is_empty() && !held_out.singular {
            self.finished(region, 1);
            return Verdict::Unread(self.unread(region));
        }
        if region.face.is_none() {
            return self.judge_sphere(chunk, region, &mut held_out);
        }
        let needs = Needs::new(self, chunk, region);
        let may_halve = self.may_halve(region);
        let resolved = needs.excess.iter().all(|e| *e <= 1.0);
        let hopeful = needs.excess.iter().all(|e| *e <= HOPE);
        let affordable = needs.rays() <= self.most_rays(region);
        let last = !may_halve.iter().any(|m| *m);
        if affordable && !held_out.singular && (resolved || (last && hopeful)) {
            match self.fitted(chunk, region, needs.clone(), &mut held_out) {
                Ok(tree) => return Verdict::Fitted(tree),
                // What ends within the box is not to be seen in its coefficients.
                Err(_) if held_out.singular => {}
                Err(urgency) => {
                    if let Some(axis) = largest(&urgency, &may_halve) {
                        return Verdict::Halve(axis);
                    }
                }
            }
        }
        // What exceeds most is halved; where the nodes are only too many in all, the axis with most.
        let mut urgency: Vec<f64> = match resolved {
            true => self.crowding(region, &needs),
            false => needs.excess.clone(),
        };
        let most = urgency.iter().copied().fold(0.0, f64::max);
        if !resolved && needs.early_excess * LATE < most {
            urgency[region.arc()] = f64::INFINITY;
        }
        match largest(&urgency, &may_halve) {
            Some(axis) => Verdict::Halve(axis),
            None => {
                self.finished(region, 1);
                Verdict::Unread(Tree::Flagged)
            }
        }
    }

    /// The number of nodes of each camera and direction axis: halving the arc length saves no rays.
    fn crowding(&self, region: &Region, needs: &Needs) -> Vec<f64> {
        let mut counts: Vec<f64> = needs.nodes.iter().map(|n| *n as f64).collect();
        counts[region.arc()] = 0.0;
        counts
    }

    /// The patch, with more nodes than needed along lines if those do not hold or leave no room for
    /// rounding, or how urgent halving is along each axis.
    fn fitted(
        &self,
        chunk: usize,
        region: &Region,
        mut needs: Needs,
        held_out: &mut HeldOut<'_>,
    ) -> Result<Tree, Vec<f64>> {
        loop {
            if region.face.is_none() {
                // Waves come in pairs.
                needs.nodes[region.arc() - 2] |= 1;
            }
            let polynomial = self.fit(chunk, region, &needs.nodes);
            let spectra = polynomial.spectra();
            let left = held_out.error_of(&polynomial);
            let limits = (&self.most_nodes(region)[..], self.most_rays(region));
            if left > ROOMY && !held_out.singular && needs.raise(limits, &spectra, left) {
                continue;
            }
            let urgency: Vec<f64> = spectra.iter().map(|s| tail(s)).collect();
            let holds = left <= 1.0 && !held_out.singular;
            let found = holds
                .then(|| self.quantise(&polynomial, held_out))
                .flatten();
            let tensor = found.ok_or(urgency)?;
            self.finished(region, tensor.bytes());
            return Ok(Tree::Leaf(Arc::new(tensor)));
        }
    }

    /// The patch of a box that no ray gets to: straight lines.
    fn unread(&self, region: &Region) -> Tree {
        let mut shape = vec![1; self.plan.nodes.len()];
        shape.push(self.space.channels().len());
        let straight = Polynomial {
            coefficients: ArrayD::zeros(shape),
            variables: self.variables(region),
        };
        let straight = Train::plain(&straight);
        let rounded = straight.rounded(Step::near(1.0));
        Tree::Leaf(Arc::new(rounded.expect("zeros")))
    }

    fn finished(&self, region: &Region, bytes: usize) {
        let chunks = self.division.chunks() as f64;
        let share = region.share / chunks * f64::from(u32::MAX);
        self.tally.volume.fetch_add(share as u64, Ordering::Relaxed);
        self.tally.patches.fetch_add(1, Ordering::Relaxed);
        self.tally.bytes.fetch_add(bytes as u64, Ordering::Relaxed);
    }

    /// Along which axes the box may be halved.
    fn may_halve(&self, region: &Region) -> Vec<bool> {
        let small = region.volume() <= self.plan.least_volume;
        let mut may = vec![!small; region.intervals.len()];
        may[region.arc()] = region.arc_halvings() < self.plan.most_arc_halvings;
        may
    }

    /// The stored ray at box parameters `x` (camera…, direction…).
    fn ray(&self, chunk: usize, region: &Region, x: &[f64]) -> (DVec3, DVec3) {
        let (camera, directions) = x.split_at(self.space.cameras().len());
        let camera = self.camera(chunk, region, camera);
        (camera.u, self.direction(&camera, region, directions))
    }

    /// The camera at box parameters `x` (camera…).
    fn camera(&self, chunk: usize, region: &Region, x: &[f64]) -> StoredCamera {
        let division = self.division;
        let (cell, _) = division.of(chunk);
        let inner: Vec<f64> = (0..x.len()).map(|j| region.at(j, x[j])).collect();
        let cameras = self.space.cameras();
        let parameters = cell::parameters(&division.cells, cameras, &cell, &inner);
        self.space.stored_camera(&parameters)
    }

    /// The direction in the standard frame of the ray from `camera` at box parameters `x` (direction…).
    fn direction(&self, camera: &StoredCamera, region: &Region, x: &[f64]) -> DVec3 {
        let first = self.space.cameras().len();
        let inner: Vec<f64> = (0..x.len()).map(|j| region.at(first + j, x[j])).collect();
        match (region.face, self.space.sphere()) {
            (None, Some(sphere)) => camera.direction(sphere.direction([inner[0], inner[1]])),
            (face, _) => self.space.direction_from(camera, face.unwrap_or(0), &inner),
        }
    }

    /// The `count` Chebyshev nodes of the box's arc lengths.
    fn arc_lengths(&self, region: &Region, count: usize) -> Vec<f64> {
        let [start, end] = region.arc_interval(self.plan.length);
        let nodes = chebyshev::nodes(count);
        let at = |t: &f64| start + 0.5 * (t + 1.0) * (end - start);
        nodes.iter().map(at).collect()
    }

    /// The polynomial through exact samples on the tensor grid of `nodes`, its rows along the arc
    /// length as [`arc`] unfolds them.
    fn fit(&self, chunk: usize, region: &Region, nodes: &[usize]) -> Polynomial {
        let interval = region.arc_interval(self.plan.length);
        let starts = usize::from(arc::stores_start(interval));
        let mut lengths = vec![interval[0]; starts];
        lengths.extend(self.arc_lengths(region, nodes[region.arc()]));
        let channels = self.space.channels();
        let samples = Samples {
            space: self.space,
            tolerance: self.plan.tolerance,
            lengths: &lengths,
            width: channels.len(),
        };
        let keep = |at: usize, sample: &Sample, to: &mut [f64]| {
            let first = if at < starts { DISPLACEMENT } else { 0 };
            for (to, channel) in to.iter_mut().zip(channels) {
                *to = sample[first + channel];
            }
        };
        let count = nodes[..region.arc()].iter().product();
        let samples = samples.of(count, self.grid(chunk, region, nodes), keep);
        self.tally.rays.fetch_add(count as u64, Ordering::Relaxed);
        let mut shape = nodes[..region.arc()].to_vec();
        shape.extend([lengths.len(), channels.len()]);
        let samples = ArrayD::from_shape_vec(shape, samples);
        Polynomial::fit(
            samples.expect("one sample for each node"),
            starts,
            self.variables(region),
        )
    }

    /// How the parameters of rays enter the polynomials of a box.
    fn variables(&self, region: &Region) -> Variables {
        region.variables(self.space.cameras().len(), self.plan.stretch)
    }

    /// The most nodes along each axis of a box. Around the whole sphere there are four faces, from pole
    /// to pole two; and along the arc it needs what the worst of its faces does.
    fn most_nodes(&self, region: &Region) -> Vec<usize> {
        let mut most: Vec<usize> = self.plan.nodes.iter().map(|n| *n as usize).collect();
        if region.face.is_none() {
            let arc = region.arc();
            most[arc - 2] = 4 * most[arc - 2] - 1;
            most[arc - 1] *= 2;
            most[arc] = (5 * most[arc] / 4).min(MOST_ALONG_ARC);
        }
        most
    }

    /// The most rays that a box is fitted to.
    fn most_rays(&self, region: &Region) -> usize {
        let most = self.plan.most_rays as usize;
        match region.face {
            Some(_) => most,
            None => (FACES * most).min(MOST_RAYS.max(most)),
        }
    }

    /// The rays of the tensor grid of `nodes` (chart point, unit tangent) by their number, the last
    /// axis running fastest.
    fn grid(
        &self,
        chunk: usize,
        region: &Region,
        nodes: &[usize],
    ) -> impl Fn(Range<usize>) -> Vec<(DVec3, DVec3)> + Sync {
        let inputs = &nodes[..region.arc()];
        let variables = self.variables(region);
        let along = |(axis, n): (usize, &usize)| variables.places(axis, *n);
        let mut cameras: Vec<Vec<f64>> = inputs.iter().enumerate().map(along).collect();
        let directions = cameras.split_off(self.space.cameras().len());
        let each: usize = directions.iter().map(Vec::len).product();
        move |numbers| {
            let mut rays = Vec::with_capacity(numbers.len());
            for number in numbers.start / each..numbers.end.div_ceil(each) {
                let camera = self.camera(chunk, region, &node(&cameras, number));
                let observer = self.space.manifold().observer(camera.u);
                let first = numbers.start.max(number * each);
                let own = first..numbers.end.min((number + 1) * each);
                rays.extend(own.map(|ray| {
                    let x = node(&directions, ray % each);
                    (
                        camera.u,
                        observer.tangent(self.direction(&camera, region, &x)),
                    )
                }));
            }
            rays
        }
    }
}

/// The place in a tensor grid of the node of this `number`, the last axis running fastest.
fn node(grids: &[Vec<f64>], number: usize) -> Vec<f64> {
    let mut rest = number;
    let mut x = vec![0.0; grids.len()];
    for (x, grid) in x.iter_mut().zip(grids).rev() {
        *x = grid[rest % grid.len()];
        rest /= grid.len();
    }
    x
}

/// The axis with the largest value of those allowed.
fn largest(values: &[f64], allowed: &[bool]) -> Option<usize> {
    (0..values.len())
        .filter(|&axis| allowed[axis])
        .max_by(|&a, &b| values[a].total_cmp(&values[b]).then(b.cmp(&a)))
}
