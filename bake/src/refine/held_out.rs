//! Held-out rays: random rays of a box that its polynomials are not fitted to, followed exactly.
//!
//! In: a box and its error budget. Out: the error of a polynomial or tensor on the rays, in units of the
//! promise, measured as the certificate measures it. It holds the promise where it is at most 1.

use super::{Refiner, line_series::channel_weights, refinement_tree::ParameterBox};
use crate::plan::divides_paths;
use geofan_bundle::{
    Polynomial, Tensor,
    measure::{Probe, Probed, probe, stored_settings, tangents_at_exits},
    path_coefficients,
    rays::{CHANNELS, EdgePiece, LiftedStart, end_at},
};
use geofan_core::{geodesic::End, random::Stream};
use rayon::prelude::*;
use std::num::NonZeroU32;

/// The fewest held-out rays of a box. Fewer miss narrow failures, and let steps pass that other rays
/// would not (S³ and H³: 99th percentiles 0.98 of the promise with 48, 0.9 with 96; a lens from one point:
/// 1.02 with 96).
const FEWEST: usize = 144;

/// The most, and how many rays a box may be fitted to for each. Boxes of many axes have more places
/// for failures to hide, and can afford to look: the sky of the Gaussian lens came to 1.07 of the promise
/// with 480, to 1.04 with 960.
const MOST: usize = 960;
const FITTED_EACH: usize = 40;

/// The same where edges and ends divide paths: there are many small boxes, whose misses the promise counts together, and
/// their held-out rays, with what is carried along, take as long as those that they are fitted to.
const FITTED_EACH_DIVIDED: usize = 2 * FITTED_EACH;

/// Factor by which the whole sphere of directions has more, and the most: it stands for six faces.
const ON_SPHERE: usize = 3;
const MOST_ON_SPHERE: usize = 1920;

/// Largest number of draws of as many rays again where too few get to the arc lengths of the box, because
/// most end at an exit before: in the corner that is left a table failed by radians (Sol) when two
/// rays out of 48 had vouched for it.
const BATCHES: usize = 16;

/// Arc lengths at which each is compared.
const LENGTHS: usize = 6;

/// Share of a box's comparisons that may exceed the promise, rounded down to a whole number. The promise
/// is a 99th percentile, but the step is the coarsest that these few rays let pass, and others find more:
/// with 0.01 certificates exceed it by up to 5 %. From 0.01 to 0.007 costs 2 % of the bytes.
const EXCEEDING: f64 = 0.007;

/// Share for the whole sphere, where more rays are compared and one patch is most of a table. With
/// 0.0085 certificates exceed it by up to 3 %.
const EXCEEDING_ON_SPHERE: f64 = 0.0075;

/// Rays that tell whether a tensor is so far from the promise that the others need not be asked, and the
/// bounds of what is not far: among so many few decide.
const GLANCE: usize = 480;
const NEAR: [f64; 2] = [0.8, 1.25];

/// Errors of rounding that do not matter, in units of the promise.
const NOTHING: f64 = 0.01;

/// The most rays that judge a polynomial, and how many of them come first, to find out most failures.
/// All the others follow in parts of twice as many each: reading the coefficients takes as long as
/// summing them for a few rays.
const JUDGES: usize = 160;
const FIRST: usize = 16;

/// Rays followed before a polynomial is judged at all: as many as fill all lanes. Half of the boxes of a
/// wormhole fail on the first of them.
const AT_ONCE: usize = 32;

/// The least share of a box's arc lengths that either side of an edge counts as.
const LEAST_SHARE: f64 = 0.01;

/// A held-out ray.
struct HeldOutRay {
    /// Parameters in [−1, 1] of the box: camera…, direction….
    parameters: Vec<f64>,
    start: LiftedStart,
    /// Its arc lengths in the box.
    interval: [f64; 2],
    probes: Vec<Probe>,
    /// The edges that it meets: where, and their numbers.
    edges: (Vec<f64>, Vec<NonZeroU32>),
    /// Set if an exit in the box ends it: the last probe is there.
    exits: bool,
}

impl HeldOutRay {
    /// Takes what was probed on a ray that gets to its `interval`: the last probe is at its end, and kept where that is an
    /// exit in the box.
    fn new(
        parameters: Vec<f64>,
        start: LiftedStart,
        interval: [f64; 2],
        mut probed: Probed,
    ) -> Self {
        let exits = probed.exits() && probed.length <= interval[1];
        if !exits {
            probed.probes.pop();
        }
        Self {
            parameters,
            start,
            interval,
            probes: probed.probes,
            edges: probed.edges.into_iter().unzip(),
            exits,
        }
    }
}

/// The held-out rays of a box with their exact paths.
pub struct HeldOutRays<'a> {
    refiner: &'a Refiner<'a>,
    chunk: usize,
    bounds: &'a ParameterBox,
    stream: Stream,
    rays: Vec<HeldOutRay>,
    /// Parameters of rays that have been drawn and not followed yet, and the key of their arc lengths.
    pending: Vec<Vec<f64>>,
    key: u64,
    /// Set when as many have been followed as there can be.
    completed: bool,
    /// The edges that bound the box.
    piece: EdgePiece,
    /// Share of comparisons that may exceed the promise.
    exceeding: f64,
    /// Set if the metric ended a ray within the box: the table cannot know that.
    pub singular: bool,
}

impl<'a> HeldOutRays<'a> {
    /// Draws those of the box `bounds` of `chunk`, which may miss the promise as often as its error
    /// `budget` says. Only the first are followed, all others when they are asked for.
    pub fn new(
        refiner: &'a Refiner<'a>,
        chunk: usize,
        bounds: &'a ParameterBox,
        budget: f64,
    ) -> Self {
        let usual = match bounds.face {
            Some(_) => EXCEEDING,
            None => EXCEEDING_ON_SPHERE,
        };
        let mut held_out = Self {
            refiner,
            chunk,
            bounds,
            stream: Stream::new(&bounds.name),
            rays: Vec::new(),
            pending: Vec::new(),
            key: 0,
            completed: false,
            piece: bounds.piece(),
            exceeding: budget * usual,
            singular: false,
        };
        held_out.draw();
        held_out.follow(AT_ONCE);
        if held_out.rays.len() < FIRST {
            held_out.complete();
        }
        held_out
    }

    /// Returns the number of rays drawn at once.
    fn count(&self) -> usize {
        let each = match divides_paths(self.refiner.plan) {
            true => FITTED_EACH_DIVIDED,
            false => FITTED_EACH,
        };
        let count = (self.refiner.plan.most_rays as usize / each).clamp(FEWEST, MOST);
        match self.bounds.face {
            Some(_) => count,
            None => (ON_SPHERE * count).min(MOST_ON_SPHERE),
        }
    }

    /// Draws more rays.
    fn draw(&mut self) {
        let (count, bounds) = (self.count(), self.bounds);
        let parameters = (0..count).map(|_| bounds.random_ray(&mut self.stream));
        self.pending = parameters.collect();
        self.key = self.stream.bits();
    }

    /// Follows as many rays as judge a polynomial.
    pub fn look_closer(&mut self) {
        let first = self.count() - self.pending.len();
        self.follow(JUDGES.saturating_sub(first));
    }

    /// Follows all rays, and more, until enough of them get as far as the box's arc lengths or hardly any
    /// do.
    pub fn complete(&mut self) {
        if std::mem::replace(&mut self.completed, true) {
            return;
        }
        self.follow(usize::MAX);
        let enough = self.count() / 3;
        for _ in 1..BATCHES {
            let stopped = self.refiner.tally.stop().told();
            if self.singular || self.rays.len() >= enough || stopped {
                break;
            }
            self.draw();
            self.follow(usize::MAX);
        }
    }

    /// Follows the next `count` rays that have been drawn and keeps those that get to the box's arc
    /// lengths.
    fn follow(&mut self, count: usize) {
        let (refiner, length) = (self.refiner, self.refiner.plan.length);
        let manifold = refiner.space.manifold();
        // The next rays, out of those pending.
        let first = self.count() - self.pending.len();
        let later = self.pending.split_off(count.min(self.pending.len()));
        let parameters = std::mem::replace(&mut self.pending, later);
        let rays = parameters.iter();
        let rays: Vec<_> = rays
            .map(|x| refiner.ray(self.chunk, self.bounds, x))
            .collect();
        let intervals = self.bounds.arc_intervals(&parameters, length);
        if !refiner.tally.go_on(rays.len()) {
            return;
        }
        // Random arc lengths in the box, and the end of the path.
        let key = self.key;
        let lengths = |ray: usize, length: f64| {
            let [start, end] = intervals[ray];
            let mut stream = Stream::new(&[key, (first + ray) as u64]);
            let end = end.min(length);
            let count = if end > start { LENGTHS } else { 0 };
            let within = (0..count).map(|_| end - (end - start) * stream.uniform());
            within.chain((count > 0).then_some(end)).collect()
        };
        let settings = stored_settings(refiner.space, refiner.tolerance(self.bounds));
        let reach = |interval: &[f64; 2]| self.piece.reach(refiner.space, *interval);
        let farthest = intervals.iter().map(reach).fold(0.0, f64::max).min(length);
        let mut probed = probe(manifold, settings, farthest, &rays, lengths);
        for path in &mut probed {
            if let End::Exit(exit) = path.end {
                path.edges.extend(end_at(refiner.space, exit, path.length));
            }
        }
        // What was found about them.
        let ended = |(p, [start, end]): (&Probed, &[f64; 2])| {
            p.end == End::Singular && p.length >= *start && p.length <= *end
        };
        self.singular |= probed.iter().zip(&intervals).any(ended);
        let found = parameters.into_iter().zip(&rays).zip(intervals).zip(probed);
        let found = found.filter(|(_, probed)| !probed.probes.is_empty());
        let chart_map = refiner.space.chart_map();
        self.rays
            .extend(found.map(|(((parameters, &(u, d)), interval), probed)| {
                let start = chart_map.start(u, manifold.local_frame(u).tangent(d));
                HeldOutRay::new(parameters, start, interval, probed)
            }));
    }

    /// Counts the rays followed.
    pub fn len(&self) -> usize {
        self.rays.len()
    }

    /// Lists the parameters of the rays in the box with the edges that each meets.
    pub fn kinds(&self) -> impl Iterator<Item = (&Vec<f64>, Option<&[NonZeroU32]>)> + Clone {
        let rays = self.rays.iter().enumerate();
        rays.map(|(number, ray)| (&ray.parameters, self.edges_met(number)))
    }

    /// Tells whether any ray meets an edge in the box or before it.
    pub fn meets_edges(&self) -> bool {
        (0..self.rays.len()).any(|ray| self.edges_met(ray).is_some_and(|edges| !edges.is_empty()))
    }

    /// Lists the edges that a ray meets before the box, and the first one in it or at its end; `None` if there is no
    /// such ray.
    pub fn edges_met(&self, ray: usize) -> Option<&[NonZeroU32]> {
        let ray = self.rays.get(ray)?;
        let (places, edges) = &ray.edges;
        let count = match self.piece.next {
            Some(_) => edges.len(),
            None => places.partition_point(|s| *s < ray.interval[1]),
        };
        Some(&edges[..count.min(self.piece.before.len() + 1)])
    }

    /// Tells whether in the first half of the box all rays are between the same edges as those of its neighbours.
    pub fn first_half_is_alike(&self) -> bool {
        self.rays.iter().all(|ray| {
            let (places, edges) = &ray.edges;
            let middle = 0.5 * (ray.interval[0] + ray.interval[1]);
            edges[..places.partition_point(|s| *s < middle)] == self.piece.before
        })
    }

    /// Lists where the rays meet the first edge in the box.
    fn places(&self) -> impl Iterator<Item = f64> {
        let number = self.piece.before.len();
        let places = self.rays.iter().map(move |ray| ray.edges.0.get(number));
        places.map(|place| place.copied().unwrap_or(f64::NAN))
    }

    /// Measures the error, as a share of the arc length, of what `read` gives as the places of the first edge at the
    /// parameters of the rays, which all but the allowed share of them keep.
    pub fn place_error(&self, read: impl FnOnce(&[&[f64]]) -> Vec<Vec<f64>>) -> f64 {
        let points: Vec<&[f64]> = self.rays.iter().map(|r| r.parameters.as_slice()).collect();
        let found = read(&points).into_iter().zip(self.places());
        let errors = found.map(|(row, place)| (row[0] / place - 1.0).abs());
        quantile(errors.collect(), self.exceeding)
    }

    /// Returns the arc length before which hardly any ray meets the first edge.
    pub fn least_place(&self) -> f64 {
        let mut places: Vec<f64> = self.places().collect();
        places.sort_by(f64::total_cmp);
        places.get(places.len() / 10).map_or(1.0, |s| *s)
    }

    /// Returns the share of the box's arc lengths before the first edge, in the mean.
    pub fn share_before_edge(&self) -> f64 {
        let rays = self.rays.iter().zip(self.places());
        let share = |(ray, place): (&HeldOutRay, f64)| {
            let [start, end] = ray.interval;
            (place - start) / (end - start)
        };
        let mean = rays.map(share).sum::<f64>() / self.rays.len().max(1) as f64;
        mean.clamp(LEAST_SHARE, 1.0 - LEAST_SHARE)
    }

    /// Tells whether the box has the whole sphere of directions.
    pub fn on_sphere(&self) -> bool {
        self.bounds.face.is_none()
    }

    /// Tells whether no ray gets as far as the box: nothing of it will be read.
    pub fn is_empty(&self) -> bool {
        self.rays.is_empty()
    }

    /// Returns the error in mrad that an error of one unit in a displacement channel usually causes: the
    /// upper decile.
    pub fn weight(&self) -> f64 {
        let space = self.refiner.space;
        let mut found = Vec::new();
        for probe in self.rays.iter().flat_map(|ray| &ray.probes) {
            let mut weights = [0.0; CHANNELS];
            channel_weights(space, None, probe, &mut weights);
            let largest = weights.iter().copied().fold(0.0, f64::max);
            found.extend(Some(largest).filter(|w| *w > 0.0 && w.is_finite()));
        }
        found.sort_by(f64::total_cmp);
        found.get(found.len() * 9 / 10).map_or(1.0, |w| *w)
    }

    /// Measures the error of `tensor` that all but the allowed share of comparisons keep, of points or of
    /// tangents, in units of the promise; of one that is far from it by the first rays alone. An error of
    /// `unit` in a displacement uses up the promise.
    pub fn error(&self, tensor: &Tensor, unit: f64) -> f64 {
        let (first, others) = self.rays.split_at(self.rays.len().min(GLANCE));
        let read = match self.in_single(unit) {
            true => Tensor::at_many_in_single,
            false => Tensor::at_many,
        };
        let mut errors = self.errors_of(first, |points| read(tensor, points));
        let error = self.deciding_error(&errors);
        let goes_on = || {
            self.refiner
                .tally
                .stop()
                .goes_on(others.len() * tensor.integers())
        };
        if others.is_empty() || !(NEAR[0]..NEAR[1]).contains(&error) || !goes_on() {
            return error;
        }
        errors.extend(self.errors_of(others, |points| read(tensor, points)));
        self.deciding_error(&errors)
    }

    /// Tells whether the rounding errors of single precision are far below the promise: of displacements
    /// no larger than the arc length.
    fn in_single(&self, unit: f64) -> bool {
        f64::from(f32::EPSILON) * self.refiner.plan.length < NOTHING * unit
    }

    /// Returns the error that all but the allowed share of `errors` keep, in units of the promise.
    fn deciding_error(&self, errors: &[HeldOutErrors]) -> f64 {
        let all = HeldOutErrors::together(errors);
        all.quantile(self.exceeding) / self.refiner.plan.max_error
    }

    /// Measures the error of a polynomial likewise. One that fails is given up as soon as enough rays show
    /// it; its error is then that of those rays, and the others may not have been followed.
    pub fn error_of(&mut self, polynomial: &Polynomial) -> f64 {
        let most = self.refiner.plan.max_error;
        let (mut all, mut from, mut count) = (Vec::<HeldOutErrors>::new(), 0, FIRST);
        while from < self.rays.len().min(JUDGES) {
            let to = (from + count).min(self.rays.len()).min(JUDGES);
            let rays = &self.rays[from..to];
            let numbers = polynomial.coefficients.len();
            if !self.refiner.tally.stop().goes_on(rays.len() * numbers) {
                break;
            }
            all.extend(self.errors_of(rays, |points| polynomial.at(points)));
            let failures = all.iter().map(|e| e.exceeding(most)).sum();
            if self.allowed() < failures {
                break;
            }
            self.complete();
            (from, count) = (to, 2 * count);
        }
        self.deciding_error(&all)
    }

    /// Counts the comparisons of the judges that may exceed the promise; rays that have not been followed
    /// may be compared at as many places as possible.
    fn allowed(&self) -> usize {
        let judges = &self.rays[..self.rays.len().min(JUDGES)];
        let comparisons: usize = judges.iter().map(|ray| ray.probes.len()).sum();
        let others = self.pending.len().min(JUDGES - judges.len());
        allowed(self.exceeding, comparisons + others * (LENGTHS + 1))
    }

    /// Measures what `read` gives at the parameters of `rays`.
    fn errors_of(
        &self,
        rays: &[HeldOutRay],
        read: impl FnOnce(&[&[f64]]) -> Vec<Vec<f64>>,
    ) -> Vec<HeldOutErrors> {
        let points: Vec<&[f64]> = rays.iter().map(|r| r.parameters.as_slice()).collect();
        let stored = read(&points);
        let errors = rays.par_iter().zip(&stored);
        errors
            .map(|(ray, stored)| self.errors(ray, stored))
            .collect()
    }

    /// Compares a table that has `stored` these coefficients for the ray with its exact path.
    fn errors(&self, ray: &HeldOutRay, stored: &[f64]) -> HeldOutErrors {
        let refiner = self.refiner;
        let channels = refiner.space.channels().len();
        let mut rows = Vec::new();
        path_coefficients::unfold(stored, channels, ray.interval, &mut rows);
        let mut errors = HeldOutErrors::default();
        let only_exits = tangents_at_exits(refiner.space);
        let tangents = refiner.plan.tangent_weight();
        for (i, probe) in ray.probes.iter().enumerate() {
            let sums = path_coefficients::sums(&rows, channels, ray.interval, &[probe.s]);
            let (u, v) = path_coefficients::state(refiner.space, &ray.start, &sums, 0, probe.s);
            errors.points.push(probe.screen_mrad(u - probe.u));
            let exit = ray.exits && i + 1 == ray.probes.len();
            if let Some(factor) = tangents.filter(|_| exit || !only_exits) {
                errors.tangents.push(factor * probe.sky_mrad(v - probe.v));
            }
        }
        errors
    }
}

/// Errors on some rays in mrad, those of tangents as they count beside points.
#[derive(Default)]
struct HeldOutErrors {
    points: Vec<f64>,
    tangents: Vec<f64>,
}

impl HeldOutErrors {
    /// Puts those of several rays together.
    fn together(rays: &[Self]) -> Self {
        let mut all = Self::default();
        for ray in rays {
            all.points.extend(&ray.points);
            all.tangents.extend(&ray.tangents);
        }
        all
    }

    /// Counts the points or tangents that miss the promise `most`.
    fn exceeding(&self, most: f64) -> usize {
        let count = |errors: &[f64]| errors.iter().filter(|e| !(**e <= most)).count();
        count(&self.points).max(count(&self.tangents))
    }

    /// Returns the error that all points and all tangents keep but this share of them.
    fn quantile(self, exceeding: f64) -> f64 {
        quantile(self.points, exceeding).max(quantile(self.tangents, exceeding))
    }
}

/// Returns a `share` of a number of comparisons, rounded down.
fn allowed(share: f64, comparisons: usize) -> usize {
    (share * comparisons as f64) as usize
}

/// Returns the error that all but this share of `errors` keep; infinite if it is not a number.
fn quantile(mut errors: Vec<f64>, exceeding: f64) -> f64 {
    errors
        .iter_mut()
        .filter(|e| e.is_nan())
        .for_each(|e| *e = f64::INFINITY);
    let exceeding = allowed(exceeding, errors.len());
    errors.sort_by(|a, b| b.total_cmp(a));
    errors.get(exceeding).map_or(0.0, |e| *e)
}
