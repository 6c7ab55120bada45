//! Rays followed exactly and read off at given arc lengths, over their whole length or between the edges of the metric that
//! they meet: what tables are made from.
//!
//! In: rays and arc lengths. Out: an array (ray, arc length, channel) with four channels of the slope
//! that is stored ([`ChartMap::slope`]) and, from [`DISPLACEMENT`] on, four of the displacement that it
//! adds up to ([`ChartMap::displacement`]).
//!
//! In: the edges that bound a piece, and exact paths. Out: the steps of the piece, if the path meets the same
//! edges as its neighbours do, and points and tangents of it.
//!
//! A path jumps in direction where it meets an edge, and no polynomial follows it across. Between two edges it
//! is smooth, and so it is from ray to ray, as long as all of them meet the same edges in the same sense.
//!
//! An exit behind which paths get rough counts as an edge, too: nobody looks behind it, and what comes there takes many
//! times the coefficients of all before it. Where only the metric bends light, paths come to rest near a horizon by
//! themselves; in a wind they cross it, and are soon torn about a singularity. Behind such an *end*, which is a little
//! behind the exit, paths of a table nearly stand still: there they are within what the exit bounds, and nobody who looks
//! for it from knot to knot misses it.
//!
//! [`ChartMap::slope`]: super::ChartMap::slope
//! [`ChartMap::displacement`]: super::ChartMap::displacement

use super::{ChartMap, LiftedStart, RaySpace};
use geofan_core::{
    geodesic::{End, Path, Ray, Settings, Sink, Step, first_event, follow, paths},
    parallel::*,
};
use glam::{DVec3, DVec4};
use ndarray::Array3;
use std::{num::NonZeroU32, ops::Range};

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
            let start = self.space.chart_map().start(u, v);
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
        let chart_map = self.space.chart_map();
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
                point = chart_map.continued(step.position(step.end), point);
            }
            at = step;
            let (u, v) = state_on(&path.steps[step], known);
            point = chart_map.continued(u, point);
            let mut sample = [0.0; CHANNELS];
            sample[..DISPLACEMENT].copy_from_slice(&chart_map.slope(start, u, v * speed));
            sample[DISPLACEMENT..].copy_from_slice(&chart_map.displacement(start, point, s));
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
        let starts = rays
            .iter()
            .map(|&(u, v)| self.space.chart_map().start(u, v));
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
        let (chart_map, start) = (space.chart_map(), &self.starts[ray]);
        let slope = chart_map.slope(start, u, v);
        self.points[ray] = chart_map.continued(u, self.points[ray]);
        let displacement = chart_map.displacement(start, self.points[ray], lengths[at]);
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
        if let (ChartMap::Polar, Some((_, u, _))) = (self.of.space.chart_map(), self.last) {
            self.points[ray] = ChartMap::Polar.continued(u, self.points[ray]);
        }
    }
}

impl<K: Fn(usize, &SampleNumbers, &mut [f64])> Sink for Sampler<'_, K> {
    fn wants(&self, ray: usize, to: f64) -> bool {
        let next = self.of.lengths.get(self.next[ray]);
        // Turns are counted step by step.
        let counted = self.of.space.chart_map() == ChartMap::Polar;
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

/// Factor by which paths are followed farther than to an edge.
const BEHIND_EDGE: f64 = 1.01;

/// Numbers of ends begin here, beyond those of edges: one for each exit.
const FIRST_END: u32 = 1 << 31;

/// Tells whether an edge of this number is an end.
fn is_end(number: NonZeroU32) -> bool {
    number.get() >= FIRST_END
}

/// Where a path meets an edge, or its end.
#[derive(Debug, Clone, Copy)]
struct EdgeMet {
    /// Arc length.
    place: f64,
    /// The edge, as [`Step::edge`] numbers it, or the end.
    number: NonZeroU32,
    /// The step behind an edge; of an end, the one in which it is.
    step: usize,
}

/// Lists the edges that an exact path meets up to its end.
fn edges_met(space: &RaySpace, path: &Path) -> Vec<EdgeMet> {
    let steps = path.steps.iter().enumerate();
    let edges = steps.filter_map(|(number, step)| {
        Some(EdgeMet {
            place: step.start,
            number: step.edge?,
            step: number,
        })
    });
    match end_met(space, path) {
        Some(end) => edges
            .take_while(|edge| edge.place < end.place)
            .chain([end])
            .collect(),
        None => edges.collect(),
    }
}

/// Finds the end of a path, if it has one, whether or not it was followed past its exits.
fn end_met(space: &RaySpace, path: &Path) -> Option<EdgeMet> {
    let (exit, place) = match path.end {
        _ if !space.has_ends() => return None,
        End::Exit(exit) => (exit, path.length),
        _ => exit_met(space, path, path.length)?,
    };
    let (place, number) = end_at(space, exit, place)?;
    let after = path.steps.partition_point(|step| step.end < place);
    Some(EdgeMet {
        place,
        number,
        step: after.min(path.steps.len() - 1),
    })
}

/// Returns the arc length and the number of the end of a path that meets the exit of a number at arc length `s`; `None`
/// if paths have no end there.
pub fn end_at(space: &RaySpace, exit: usize, s: f64) -> Option<(f64, NonZeroU32)> {
    let number = FIRST_END.checked_add(u32::try_from(exit).ok()?)?;
    let share = space.end_behind(exit)?;
    Some((s * (1.0 + share), NonZeroU32::new(number)?))
}

/// A piece of paths that meet the same edges.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct EdgePiece {
    /// Edges that are met before it, in order, as [`Step::edge`] numbers them.
    pub before: Vec<NonZeroU32>,
    /// The edge that ends it; `None` if it goes on to the end of the path.
    pub next: Option<NonZeroU32>,
}

impl EdgePiece {
    /// Tells whether the piece is up to the end of its paths.
    pub fn is_at_end(&self) -> bool {
        self.next.is_some_and(is_end)
    }

    /// Returns how far the end of the paths of `space` is behind their exit, as a share of the arc length; `None` if the
    /// piece is not behind their end.
    pub fn behind_end(&self, space: &RaySpace) -> Option<f64> {
        let exit = self.before.last()?.get().checked_sub(FIRST_END)?;
        space.end_behind(exit as usize)
    }

    /// Returns how far a path is to be followed on which the piece has the interval from `low` to `high`: an edge that
    /// ends it is seen from a little behind where it should be, and behind the end of a path nobody looks.
    pub fn reach(&self, space: &RaySpace, [low, high]: [f64; 2]) -> f64 {
        match (self.behind_end(space), self.next) {
            (Some(_), _) => BEHIND_EDGE * low,
            (None, Some(_)) => BEHIND_EDGE * high,
            (None, None) => high,
        }
    }

    /// Returns the piece of a path that meets `edges`.
    fn number(&self, edges: &[EdgeMet]) -> Option<usize> {
        let count = self.before.len();
        let numbers = edges.iter().map(|edge| edge.number);
        let same =
            edges.len() >= count && numbers.clone().take(count).eq(self.before.iter().copied());
        let ends = self.next.is_none() || numbers.clone().nth(count) == self.next;
        (same && ends).then_some(count)
    }

    /// Returns the place where a path meets the edge that ends the piece; not a number for one that meets others.
    pub fn end(&self, space: &RaySpace, path: &Path) -> f64 {
        self.end_among(&edges_met(space, path))
    }

    /// Returns it for a path that meets no edge of the metric and was followed to its exit: from how it ends alone.
    pub fn end_at_exit(&self, space: &RaySpace, (end, s): (End, f64)) -> f64 {
        let met = match end {
            End::Exit(exit) => end_at(space, exit, s),
            _ => None,
        };
        let met = met.map(|(place, number)| EdgeMet {
            place,
            number,
            step: 0,
        });
        self.end_among(met.as_slice())
    }

    /// Returns the place of the edge that ends the piece among those that a path meets; not a number if it meets others.
    fn end_among(&self, edges: &[EdgeMet]) -> f64 {
        let end = self
            .number(edges)
            .filter(|_| self.next.is_some())
            .and_then(|number| edges.get(number));
        end.map_or(f64::NAN, |edge| edge.place)
    }

    /// Returns the numbers of the first step of the piece and of the first behind it; `None` if the path meets
    /// others, or more of them up to the arc length `end`.
    pub(super) fn steps(&self, space: &RaySpace, path: &Path, end: f64) -> Option<[usize; 2]> {
        let edges = edges_met(space, path);
        let number = self.number(&edges)?;
        let first = match number {
            0 => 0,
            _ => edges[number - 1].step,
        };
        let Some(last) = edges.get(number) else {
            return Some([first, path.steps.len()]);
        };
        // Nobody looks at edges behind the end of a path.
        let more = self.next.is_none() && last.place < end;
        let kept = !more || exit_met(space, path, last.place).is_some();
        // The step with an end in it goes on behind it.
        kept.then_some([first, last.step + usize::from(is_end(last.number))])
    }
}

/// Finds the first exit that a path meets before the arc length `s`, and where, if all who see the path end there.
pub fn exit_met(space: &RaySpace, path: &Path, s: f64) -> Option<(usize, f64)> {
    if !space.ends_alike() {
        return None;
    }
    let curve = |s: f64| match path.step_at(s) {
        Some(step) => state_on(step, s),
        None => (DVec3::NAN, DVec3::NAN),
    };
    match first_event(&space.manifold().domain, s, curve)? {
        (End::Exit(exit), place) => Some((exit, place)),
        // The limits of the domain.
        (_, place) => Some((usize::MAX, place)),
    }
}

/// Returns point and tangent at arc length `s` on `step`, or straight on beside it.
fn state_on(step: &Step, s: f64) -> (DVec3, DVec3) {
    let at = s.clamp(step.start, step.end);
    let v = step.tangent(at);
    (step.position(at) + v * (s - at), v)
}

#[cfg(test)]
mod tests {
    use super::*;
    use geofan_core::{diagnostic::SourceText, manifold::Manifold};
    use std::sync::Arc;

    const SLAB: &str = r#"
name = "two halves"
coordinates = ["x", "y", "z"]
metric = { conformal = "if(x > 1, 1.5, 1)" }
[cameras]
at = ["0", "0", "0"]
length = 4.0
"#;

    #[test]
    fn the_piece_behind_an_edge_begins_there_and_others_are_told_apart() {
        let manifold = Manifold::from_source(SourceText::new("slab", SLAB), &[]).unwrap();
        let space = RaySpace::new(Arc::new(manifold)).unwrap();
        let manifold = space.manifold();
        let settings = Settings::bare(1e-9);
        let ray = |d: DVec3| Ray::new(manifold, DVec3::ZERO, d.normalize(), 4.0);
        let rays = [ray(DVec3::new(0.8, 0.6, 0.0)), ray(DVec3::NEG_X)];
        let found = paths(manifold, settings, rays);
        let edges: Vec<_> = found[0].edges().collect();
        assert_eq!(edges.len(), 1);
        assert!((edges[0].0 - 1.25).abs() < 1e-9);
        assert_eq!(found[1].edges().count(), 0);
        let before = EdgePiece {
            before: Vec::new(),
            next: Some(edges[0].1),
        };
        let behind = EdgePiece {
            before: vec![edges[0].1],
            next: None,
        };
        assert!((before.end(&space, &found[0]) - 1.25).abs() < 1e-9);
        assert!(
            before.end(&space, &found[1]).is_nan()
                && behind.steps(&space, &found[1], 4.0).is_none()
        );
        let [first, last] = behind.steps(&space, &found[0], 4.0).unwrap();
        assert_eq!(last, found[0].steps.len());
        assert_eq!(before.steps(&space, &found[0], 1.25), Some([0, first]));
        // A path that meets an edge is not one that meets none.
        assert!(EdgePiece::default().steps(&space, &found[0], 4.0).is_none());
    }
}
