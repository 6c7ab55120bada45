//! Rays followed exactly and read off at given arc lengths: what tables are made from.
//!
//! In: rays and arc lengths. Out: an array (ray, arc length, channel) with four channels of the slope
//! that is stored ([`ChartMap::slope`]) and, from [`DISPLACEMENT`] on, four of the displacement that it
//! adds up to ([`ChartMap::displacement`]).
//!
//! [`ChartMap::slope`]: super::ChartMap::slope
//! [`ChartMap::displacement`]: super::ChartMap::displacement

use super::{
    ChartMap, LiftedStart, RaySpace,
    piece::{EdgePiece, state_on},
};
use geofan_core::geodesic::{End, Path, Ray, Settings, Sink, Step, follow, paths};
use geofan_core::parallel::*;
use glam::{DVec3, DVec4};
use ndarray::Array3;
use std::ops::Range;

/// Channels of a sample.
pub const CHANNELS: usize = 8;

/// The first channel of the displacement.
pub const DISPLACEMENT: usize = 4;

/// Rays handed to one thread at once: long enough to keep lanes full, short enough to share.
const BLOCK: usize = 512;

/// How far paths of a table go on behind their end, as a share of the way from the exit to there: not at all would leave
/// them without a direction.
const WAY_BEHIND_END: f64 = 0.25;

/// Returns the speed of paths behind their end, which is `behind` their exit as a share of the arc length, on a piece
/// with this interval of arc lengths.
pub fn speed_behind_end(behind: f64, [low, high]: [f64; 2]) -> f64 {
    (WAY_BEHIND_END * behind * low / (high - low)).min(1.0)
}

/// State of a ray at one arc length: [`CHANNELS`] numbers.
pub type SampleNumbers = [f64; CHANNELS];

/// Follows `rays` (chart point, unit tangent) to the last of `lengths` (ascending, positive) and
/// samples them there, or `between` edges at shares of what is there. Exits are passed by; where the metric ends the
/// last tangent is continued straight in the chart. NaN only where the very start is singular.
pub fn sample(
    space: &RaySpace,
    tolerance: f64,
    rays: &[(DVec3, DVec3)],
    (lengths, between): (&[f64], Option<BetweenEdges<'_>>),
) -> Array3<f64> {
    let samples = SamplingPlan {
        space,
        tolerance,
        lengths,
        width: CHANNELS,
        between,
    };
    let all = |_: usize, sample: &SampleNumbers, to: &mut [f64]| to.copy_from_slice(sample);
    let samples = samples.of(rays.len(), |block| rays[block].to_vec(), all);
    let shape = (rays.len(), lengths.len(), CHANNELS);
    Array3::from_shape_vec(shape, samples).expect("a sample of each ray at each length")
}

/// What is sampled of rays, and how much of each sample is kept.
#[derive(Debug, Clone, Copy)]
pub struct SamplingPlan<'a> {
    /// The rays.
    pub space: &'a RaySpace,
    /// The tolerance of the exact tracer.
    pub tolerance: f64,
    /// Arc lengths, ascending.
    pub lengths: &'a [f64],
    /// Number of values kept of each sample.
    pub width: usize,
    /// The pieces of the paths that are sampled, if not from their starts on.
    pub between: Option<BetweenEdges<'a>>,
}

/// Pieces of paths between edges. Arc lengths are then shares of their intervals, and samples of rays that meet
/// other edges are not numbers.
#[derive(Debug, Clone, Copy)]
pub struct BetweenEdges<'a> {
    /// The piece.
    pub piece: &'a EdgePiece,
    /// Its arc lengths on the path of each ray.
    pub intervals: &'a [[f64; 2]],
}

impl SamplingPlan<'_> {
    /// Samples `count` rays, as `rays` gives those of a range of numbers (chart point, unit tangent), what
    /// `keep` writes for the sample at the arc length of a number: (ray, arc length, number kept), the
    /// last running fastest. Ranges for which `rays` gives none are left out.
    pub fn of(
        &self,
        count: usize,
        rays: impl Fn(Range<usize>) -> Vec<(DVec3, DVec3)> + Sync,
        keep: impl Fn(usize, &SampleNumbers, &mut [f64]) + Sync,
    ) -> Vec<f64> {
        let row = self.lengths.len() * self.width;
        let mut samples = vec![0.0; count * row];
        let blocks = samples.par_chunks_mut((BLOCK * row).max(1)).enumerate();
        blocks.for_each(|(block, samples)| {
            samples.fill(f64::NAN);
            let first = block * BLOCK;
            let rays = rays(first..count.min(first + BLOCK));
            if rays.is_empty() {
                return;
            }
            match self.between {
                Some(between) => self.block_between(between, (first, rays), &keep, samples),
                None => self.block(rays, &keep, samples),
            }
        });
        samples
    }

    /// Samples pieces of paths between edges, those of the rays from number `first` on.
    fn block_between(
        &self,
        between: BetweenEdges<'_>,
        (first, rays): (usize, Vec<(DVec3, DVec3)>),
        keep: impl Fn(usize, &SampleNumbers, &mut [f64]),
        samples: &mut [f64],
    ) {
        let intervals = &between.intervals[first..first + rays.len()];
        let behind_end = between.piece.behind_end(self.space);
        let starts = rays.iter().zip(intervals).map(|(&(u, v), interval)| {
            Ray::without_spread(u, v, between.piece.reach(self.space, *interval))
        });
        let found = paths(
            self.space.manifold(),
            Settings::bare(self.tolerance),
            starts,
        );
        let rows = samples.chunks_exact_mut((self.lengths.len() * self.width).max(1));
        let each = found.iter().zip(&rays).zip(intervals).zip(rows);
        for (((path, &(u, v)), interval), row) in each {
            let Some(steps) = between.piece.steps(self.space, path, interval[1]) else {
                continue;
            };
            let start = self.space.lift().start(u, v);
            self.read_piece(
                (path, steps),
                (&start, behind_end),
                *interval,
                |at, sample| {
                    keep(at, sample, &mut row[at * self.width..(at + 1) * self.width]);
                },
            );
        }
    }

    /// Samples the piece of `path` with the steps `first` up to `end`, whose arc lengths are `interval`; one behind the
    /// end of its path nearly stands still.
    fn read_piece(
        &self,
        (path, [first, end]): (&Path, [usize; 2]),
        (start, behind_end): (&LiftedStart, Option<f64>),
        [low, high]: [f64; 2],
        mut put: impl FnMut(usize, &SampleNumbers),
    ) {
        let lift = self.space.lift();
        let (mut point, mut at) = (start.x, 0);
        for (number, share) in self.lengths.iter().enumerate() {
            let s = low + share * (high - low);
            let steps = &path.steps[first..end];
            if steps.is_empty() {
                return;
            }
            let (known, speed) = match behind_end {
                Some(behind) => (low, speed_behind_end(behind, [low, high])),
                None => (s, 1.0),
            };
            let within = steps.partition_point(|step| step.end < known);
            let step = first + within.min(steps.len() - 1);
            // Turns are counted step by step.
            for step in &path.steps[at..step] {
                point = lift.continued(step.position(step.end), point);
            }
            at = step;
            let (u, v) = state_on(&path.steps[step], known);
            point = lift.continued(u, point);
            let mut sample = [0.0; CHANNELS];
            sample[..DISPLACEMENT].copy_from_slice(&lift.slope(start, u, v * speed));
            sample[DISPLACEMENT..].copy_from_slice(&lift.displacement(start, point, s));
            put(number, &sample);
        }
    }

    fn block(
        &self,
        rays: Vec<(DVec3, DVec3)>,
        keep: impl Fn(usize, &SampleNumbers, &mut [f64]),
        samples: &mut [f64],
    ) {
        let settings = Settings::bare(self.tolerance);
        let starts = rays.iter().map(|&(u, v)| self.space.lift().start(u, v));
        let starts: Vec<LiftedStart> = starts.collect();
        let mut sampler = Sampler {
            of: *self,
            points: starts.iter().map(|start| start.x).collect(),
            starts,
            next: vec![0; rays.len()],
            last: None,
            keep,
            samples,
        };
        let farthest = self.lengths.last().copied().unwrap_or(0.0);
        let rays = rays
            .into_iter()
            .map(|(u, v)| Ray::without_spread(u, v, farthest));
        follow(self.space.manifold(), settings, rays, &mut sampler);
    }
}

struct Sampler<'a, K> {
    of: SamplingPlan<'a>,
    starts: Vec<LiftedStart>,
    /// The last lifted point of each ray.
    points: Vec<DVec4>,
    /// The next arc length to be sampled, for each ray.
    next: Vec<usize>,
    /// The end of the last step, if its ray has samples left: arc length, point and tangent.
    last: Option<(f64, DVec3, DVec3)>,
    keep: K,
    samples: &'a mut [f64],
}

impl<K: Fn(usize, &SampleNumbers, &mut [f64])> Sampler<'_, K> {
    fn put(&mut self, ray: usize, u: DVec3, v: DVec3) {
        let at = self.next[ray];
        let SamplingPlan {
            space,
            lengths,
            width,
            ..
        } = self.of;
        let (lift, start) = (space.lift(), &self.starts[ray]);
        let slope = lift.slope(start, u, v);
        self.points[ray] = lift.continued(u, self.points[ray]);
        let displacement = lift.displacement(start, self.points[ray], lengths[at]);
        let mut sample = [0.0; CHANNELS];
        sample[..DISPLACEMENT].copy_from_slice(&slope);
        sample[DISPLACEMENT..].copy_from_slice(&displacement);
        let row = (ray * lengths.len() + at) * width;
        (self.keep)(at, &sample, &mut self.samples[row..row + width]);
        self.next[ray] += 1;
    }

    /// Samples `step`.
    fn read(&mut self, ray: usize, step: &Step) {
        while let Some(&s) = self.of.lengths.get(self.next[ray]) {
            if s > step.end {
                break;
            }
            self.put(ray, step.position(s), step.tangent(s));
        }
        let (s, left) = (step.end, self.next[ray] < self.of.lengths.len());
        self.last = left.then(|| (s, step.position(s), step.tangent(s)));
        if let (ChartMap::Polar, Some((_, u, _))) = (self.of.space.lift(), self.last) {
            self.points[ray] = ChartMap::Polar.continued(u, self.points[ray]);
        }
    }
}

impl<K: Fn(usize, &SampleNumbers, &mut [f64])> Sink for Sampler<'_, K> {
    fn wants(&self, ray: usize, to: f64) -> bool {
        let next = self.of.lengths.get(self.next[ray]);
        // Turns are counted step by step.
        let counted = self.of.space.lift() == ChartMap::Polar;
        next.is_some_and(|s| *s <= to || counted)
    }

    fn step(&mut self, ray: usize, step: &Step) {
        self.read(ray, step);
    }

    fn end(&mut self, ray: usize, _: End, reached: f64, _: usize) {
        // The step before was this ray's, unless it never took one.
        let last = self.last.take().filter(|_| reached > 0.0);
        while let (Some(&s), Some((end, u, v))) = (self.of.lengths.get(self.next[ray]), last) {
            self.put(ray, u + v * (s - end), v);
        }
    }
}
