//! One chunk of the table: boxes halved until held-out rays meet the promise.
//!
//! In: a [`Plan`] and a chunk number. Out: its [`Tree`], a pure function of both: neither threads
//! nor other chunks matter.
//!
//! A box is sampled at tensor Chebyshev nodes and fitted; its coefficients are rounded with the
//! coarsest step whose table still carries random held-out rays within the promise, measured as
//! the certificate measures them. A box that no step saves is halved along the axis whose highest
//! coefficients are largest; one too small for that is flagged.

use crate::plan::Plan;
use geofan::{
    bundle::{
        Contracted, Patch, Polynomial, Tensor, Tree, chebyshev,
        measure::{Probe, probe},
    },
    fan::{CHANNELS, FanSpace, sample},
    random::Stream,
};
use glam::{DQuat, DVec3};
use ndarray::{ArrayD, Axis, IxDyn};
use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicU64, Ordering},
};

/// Held-out rays of a box. Fewer miss narrow failures; more cost as much as sampling itself in
/// boxes of two axes (144 rays).
const HELD_OUT: usize = 48;

/// Arc lengths at which each is compared.
const HELD_OUT_LENGTHS: usize = 6;

/// Quantisation steps tried, coarsest first, as multiples of the step at which rounding alone would
/// use up the promise in the worst case of one coefficient.
const STEPS: [f64; 7] = [2.0, 1.0, 0.5, 0.25, 0.1, 0.03, 0.01];

/// Share of the comparisons that may exceed the promise: the promise is a 99th percentile.
const EXCEEDING: f64 = 0.01;

/// Share of the promise that the transported rotation may be off: the direction of a sky follows
/// from it, and the path's own error adds to that.
const ROTATION_SHARE: f64 = 0.5;

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

/// A box of the table: an interval of [−1, 1] of each axis of the chunk, and its place in the tree.
#[derive(Debug, Clone)]
struct Region {
    intervals: Vec<[f64; 2]>,
    /// One bit for each halving, with a leading one: names the box.
    path: Vec<u64>,
}

impl Region {
    fn volume(&self) -> f64 {
        let all = &self.intervals[..self.intervals.len() - 1];
        all.iter().map(|[a, b]| 0.5 * (b - a)).product()
    }

    fn arc_halvings(&self) -> u32 {
        let [a, b] = self.intervals[self.intervals.len() - 1];
        (2.0 / (b - a)).log2().round() as u32
    }

    fn half(&self, axis: usize, side: usize) -> Self {
        let mut half = self.clone();
        let [a, b] = half.intervals[axis];
        half.intervals[axis][1 - side] = 0.5 * (a + b);
        half.path.push((2 * axis + side) as u64);
        half
    }

    /// The point of the box at `x` in [−1, 1] of `axis`.
    fn at(&self, axis: usize, x: f64) -> f64 {
        let [a, b] = self.intervals[axis];
        0.5 * (a + b) + 0.5 * (b - a) * x
    }
}

/// Refines one chunk at a time.
pub struct Refiner<'a> {
    /// The rays.
    pub space: &'a FanSpace,
    /// The plan.
    pub plan: &'a Plan,
    /// Progress.
    pub tally: &'a Tally,
}

/// The exact truth about the held-out rays of a box.
struct HeldOut {
    /// Parameters in [−1, 1] of the box (camera…, direction…), stored start and tangent, probes.
    rays: Vec<(Vec<f64>, DVec3, DVec3, Vec<Probe>)>,
    /// Whether the metric ended a ray within the box: the table cannot know that.
    singular: bool,
}

impl Refiner<'_> {
    /// The tree of `chunk`; `None` if told to stop.
    pub fn chunk(&self, chunk: usize) -> Option<Tree> {
        let region = Region {
            intervals: vec![[-1.0, 1.0]; self.plan.nodes.len()],
            path: vec![self.plan.seed, chunk as u64],
        };
        self.refine(chunk, region)
    }

    fn refine(&self, chunk: usize, region: Region) -> Option<Tree> {
        if self.tally.stop.load(Ordering::Relaxed) {
            return None;
        }
        let (displacement, rotation) = self.fit(chunk, &region);
        let held_out = self.held_out(chunk, &region);
        if let Some(patch) = self.quantise(&region, &displacement, &rotation, &held_out) {
            self.finished(&region, patch.bytes());
            return Some(Tree::Leaf(Arc::new(patch)));
        }
        let Some(axis) = self.axis_to_halve(&region, &displacement) else {
            self.finished(&region, 1);
            return Some(Tree::Flagged);
        };
        let (low, high) = rayon::join(
            || self.refine(chunk, region.half(axis, 0)),
            || self.refine(chunk, region.half(axis, 1)),
        );
        Some(Tree::Split {
            axis,
            halves: Box::new([low?, high?]),
        })
    }

    fn finished(&self, region: &Region, bytes: usize) {
        let chunks = self.plan.division(self.space).chunks() as f64;
        let arc = 0.5_f64.powi(region.arc_halvings() as i32);
        let share = region.volume() * arc / chunks * f64::from(u32::MAX);
        self.tally.volume.fetch_add(share as u64, Ordering::Relaxed);
        self.tally.patches.fetch_add(1, Ordering::Relaxed);
        self.tally.bytes.fetch_add(bytes as u64, Ordering::Relaxed);
    }

    /// The axis whose halving promises most; `None` where the box is too small already.
    fn axis_to_halve(&self, region: &Region, displacement: &Polynomial) -> Option<usize> {
        let arc = region.intervals.len() - 1;
        let small = region.volume() <= self.plan.least_volume;
        let allowed = |axis: &usize| match *axis == arc {
            true => region.arc_halvings() < self.plan.most_arc_halvings,
            false => !small,
        };
        let mut tails = displacement.tails();
        if !displacement.is_finite() {
            // Nothing is known: halve the longest side.
            tails = region.intervals.iter().map(|[a, b]| b - a).collect();
        }
        (0..=arc)
            .filter(allowed)
            .max_by(|&a, &b| tails[a].total_cmp(&tails[b]).then(b.cmp(&a)))
    }

    /// The stored ray at box parameters `x` (camera…, direction…).
    fn ray(&self, chunk: usize, region: &Region, x: &[f64]) -> (DVec3, DVec3) {
        let division = self.plan.division(self.space);
        let (cell, face) = division.of(chunk);
        let k = self.space.cameras().len();
        let camera: Vec<f64> = (0..k)
            .map(|j| {
                let [low, high] = self.space.cameras()[j];
                let t =
                    (cell[j] as f64 + 0.5 * (region.at(j, x[j]) + 1.0)) / division.cells[j] as f64;
                low + (high - low) * t
            })
            .collect();
        let directions: Vec<f64> = (k..x.len()).map(|j| region.at(j, x[j])).collect();
        self.space.ray(face, &camera, &directions)
    }

    fn arc_interval(&self, region: &Region) -> [f64; 2] {
        let [a, b] = region.intervals[region.intervals.len() - 1];
        [a, b].map(|t| 0.5 * (t + 1.0) * self.plan.length)
    }

    /// Exact samples on the tensor grid of nodes, fitted: displacement and rotation.
    fn fit(&self, chunk: usize, region: &Region) -> (Polynomial, Polynomial) {
        let (arc_nodes, nodes) = self.plan.nodes.split_last().expect("an arc axis");
        let grids: Vec<Vec<f64>> = nodes.iter().map(|&n| chebyshev::nodes(n)).collect();
        let count: usize = nodes.iter().product();
        let manifold = self.space.manifold();
        let rays: Vec<(DVec3, DVec3)> = ndarray::indices(IxDyn(nodes))
            .into_iter()
            .map(|i| {
                let x: Vec<f64> = grids.iter().enumerate().map(|(a, g)| g[i[a]]).collect();
                let (u, d) = self.ray(chunk, region, &x);
                (u, manifold.standard_frame(u) * d)
            })
            .collect();
        let [start, end] = self.arc_interval(region);
        let lengths: Vec<f64> = chebyshev::nodes(*arc_nodes)
            .iter()
            .map(|t| start + 0.5 * (t + 1.0) * (end - start))
            .collect();
        let samples = sample(
            manifold,
            self.plan.tolerance,
            self.plan.frames,
            &rays,
            &lengths,
        );
        self.tally.rays.fetch_add(count as u64, Ordering::Relaxed);
        let mut shape = self.plan.nodes.clone();
        shape.push(CHANNELS);
        let samples: ArrayD<f64> = samples
            .into_shape_with_order(IxDyn(&shape))
            .expect("one sample for each node");
        let channels = Axis(shape.len() - 1);
        let displacement = samples.select(channels, self.space.displacement_channels());
        let turning: Vec<usize> = self
            .space
            .rotation_channels()
            .iter()
            .map(|c| 3 + c)
            .collect();
        let rotation = samples.select(channels, &turning);
        (
            Polynomial::fit(displacement.view()),
            Polynomial::fit(rotation.view()),
        )
    }

    fn held_out(&self, chunk: usize, region: &Region) -> HeldOut {
        let manifold = self.space.manifold();
        let axes = region.intervals.len() - 1;
        let mut stream = Stream::new(&region.path);
        let parameters: Vec<Vec<f64>> = (0..HELD_OUT)
            .map(|_| (0..axes).map(|_| stream.between(-1.0, 1.0)).collect())
            .collect();
        let rays: Vec<_> = parameters
            .iter()
            .map(|x| self.ray(chunk, region, x))
            .collect();
        let [start, end] = self.arc_interval(region);
        let key = stream.bits();
        let lengths = |ray: usize, length: f64| {
            let mut stream = Stream::new(&[key, ray as u64]);
            let end = end.min(length);
            let count = if end > start { HELD_OUT_LENGTHS } else { 0 };
            (0..count)
                .map(|_| end - (end - start) * stream.uniform())
                .collect()
        };
        let probed = probe(manifold, self.plan.tolerance, end, &rays, lengths);
        self.tally
            .rays
            .fetch_add(HELD_OUT as u64, Ordering::Relaxed);
        let singular = probed
            .iter()
            .any(|p| p.end == geofan::geodesic::End::Singular && p.length >= start);
        let rays = parameters
            .into_iter()
            .zip(&rays)
            .zip(probed)
            .map(|((x, &(u, d)), p)| (x, u, manifold.standard_frame(u) * d, p.probes))
            .collect();
        HeldOut { rays, singular }
    }

    /// The coarsest quantisation that keeps the promise on the held-out rays.
    fn quantise(
        &self,
        region: &Region,
        displacement: &Polynomial,
        rotation: &Polynomial,
        held_out: &HeldOut,
    ) -> Option<Patch> {
        if held_out.singular || !displacement.is_finite() || !rotation.is_finite() {
            return None;
        }
        let probes = held_out.rays.iter().flat_map(|r| &r.3);
        let stretch = probes.map(Probe::stretch).fold(0.0, f64::max);
        let unit = 1e-3 * self.plan.max_error;
        let by = unit / stretch.max(f64::MIN_POSITIVE);
        let displacement = self.coarsest(displacement, by, |polynomial| {
            self.holds(region, polynomial, held_out, Self::screen_error)
        })?;
        let rotation = match self.plan.frames {
            false => None,
            true => Some(
                self.coarsest(rotation, ROTATION_SHARE * unit, |polynomial| {
                    self.holds(region, polynomial, held_out, Self::rotation_error)
                })?,
            ),
        };
        Some(Patch {
            displacement,
            rotation,
        })
    }

    /// `polynomial` rounded with the coarsest of the steps (in units of `unit`) that `holds`. The
    /// finest is tried first: where it fails the box must be halved.
    fn coarsest(
        &self,
        polynomial: &Polynomial,
        unit: f64,
        holds: impl Fn(&Polynomial) -> bool,
    ) -> Option<Tensor> {
        let finest = STEPS[STEPS.len() - 1];
        if !holds(&polynomial.rounded(finest * unit)?) {
            return None;
        }
        STEPS.iter().find_map(|step| {
            let rounded = polynomial.rounded(step * unit)?;
            (*step == finest || holds(&rounded)).then(|| rounded.encode(step * unit))
        })
    }

    /// Whether at most the allowed share of comparisons exceeds the promise.
    fn holds(
        &self,
        region: &Region,
        polynomial: &Polynomial,
        held_out: &HeldOut,
        error: impl Fn(&Self, &[f64], DVec3, DVec3, &Probe) -> f64,
    ) -> bool {
        let k = self.space.cameras().len();
        let [start, end] = self.arc_interval(region);
        let (mut compared, mut exceeding) = (0, 0);
        for (x, u, v, probes) in &held_out.rays {
            if probes.is_empty() {
                continue;
            }
            let contracted = polynomial.contract(&x[..k]);
            for probe in probes {
                let t = 2.0 * (probe.s - start) / (end - start) - 1.0;
                let sums = evaluate(&contracted, &x[k..], t);
                compared += 1;
                exceeding +=
                    usize::from(!(error(self, &sums, *u, *v, probe) <= self.plan.max_error));
            }
        }
        exceeding as f64 <= EXCEEDING * f64::from(compared)
    }

    fn screen_error(&self, sums: &[f64], u: DVec3, v: DVec3, probe: &Probe) -> f64 {
        let mut displacement = DVec3::ZERO;
        for (channel, x) in self.space.displacement_channels().iter().zip(sums) {
            displacement[*channel] = *x;
        }
        let found = u + (v + displacement) * probe.s;
        probe.deviation(found, None).screen_mrad
    }

    fn rotation_error(&self, sums: &[f64], _: DVec3, _: DVec3, probe: &Probe) -> f64 {
        let mut q = [0.0; 4];
        for (channel, x) in self.space.rotation_channels().iter().zip(sums) {
            q[*channel] = *x;
        }
        let q = DQuat::from_array(q).normalize();
        probe
            .deviation(probe.u, Some(q))
            .rotation_mrad
            .map_or(f64::NAN, |mrad| mrad / ROTATION_SHARE)
    }
}

/// The channels at direction parameters `direction` and arc parameter `t`.
fn evaluate(contracted: &Contracted, direction: &[f64], t: f64) -> Vec<f64> {
    let mut rows = Vec::new();
    let q = direction.get(1).copied().unwrap_or(0.0);
    contracted.direction(direction[0], q, &mut rows);
    let (lengths, channels) = contracted.shape();
    let mut weights = vec![0.0; lengths];
    chebyshev::values(t, &mut weights);
    let mut sums = vec![0.0; channels];
    for (row, w) in rows.chunks_exact(channels).zip(weights) {
        for (sum, c) in sums.iter_mut().zip(row) {
            *sum += w * c;
        }
    }
    sums
}
