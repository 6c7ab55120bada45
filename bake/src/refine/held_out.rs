//! Random rays of a box that its polynomials are not fitted to, and what a table gets wrong on them.

use super::{Refiner, region::Region, scout::weigh};
use geofan::{
    bundle::{
        Polynomial, Tensor, arc,
        measure::{Probe, Probed, probe, stored_settings, tangents_at_exits},
    },
    fan::{CHANNELS, Start},
    geodesic::End,
    random::Stream,
};
use rayon::prelude::*;
use std::sync::atomic::Ordering;

/// The fewest held-out rays of a box. Fewer miss narrow failures, and let steps pass that other rays
/// would not (S³ and H³: 99th percentiles 0.98 of the promise with 48, 0.9 with 96; a lens from one point: 1.02 with
/// 96).
const FEWEST: usize = 144;

/// The most, and how many rays a box may be fitted to for each. Boxes of many axes have more places
/// for failures to hide, and can afford to look: the sky of the Gaussian lens came to 1.07 of the promise with
/// 480, to 1.04 with 960.
const MOST: usize = 960;
const FITTED_EACH: usize = 40;

/// How many times as many the whole sphere of directions has, and the most: it stands for six faces.
const ON_SPHERE: usize = 3;
const MOST_ON_SPHERE: usize = 1920;

/// How often as many rays again are followed where too few get to the arc lengths of the box, because
/// most end at an exit before: in the corner that is left a table failed by radians (Sol) when two
/// rays out of 48 had vouched for it.
const BATCHES: usize = 16;

/// Arc lengths at which each is compared.
const LENGTHS: usize = 6;

/// Share of a box's comparisons that may exceed the promise, rounded down to a whole number. The promise
/// is a 99th percentile, but the step is the coarsest that these few rays let pass, and others find more:
/// with 0.01 certificates exceed it by up to 5 %. From 0.01 to 0.007 costs 2 % of the bytes.
const EXCEEDING: f64 = 0.007;

/// The same of the whole sphere, where more rays are compared and one patch is most of a table. With
/// 0.0085 certificates exceed it by up to 3 %.
const EXCEEDING_ON_SPHERE: f64 = 0.0075;

/// How many rays tell whether a tensor is so far from the promise that the others need not be asked, and how
/// far that is: among so many few decide.
const GLANCE: usize = 480;
const NEAR: [f64; 2] = [0.8, 1.25];

/// Errors of rounding that do not matter, in units of the promise.
const NOTHING: f64 = 0.01;

/// The most rays that judge a polynomial, and how many of them come first, to find out most failures.
/// All the others follow in parts of twice as many each: reading the coefficients takes as long as
/// summing them for a few rays.
const JUDGES: usize = 160;
const FIRST: usize = 16;

/// How many rays are followed before a polynomial is judged at all: as many as fill all lanes. Half of
/// the boxes of a wormhole fail on the first of them.
const AT_ONCE: usize = 32;

/// A held-out ray.
struct HeldOutRay {
    /// Parameters in [−1, 1] of the box: camera…, direction….
    parameters: Vec<f64>,
    start: Start,
    probes: Vec<Probe>,
    /// Whether an exit in the box ends it: the last probe is there.
    exits: bool,
}

/// The exact truth about the held-out rays of a box.
pub struct HeldOut<'a> {
    refiner: &'a Refiner<'a>,
    chunk: usize,
    region: &'a Region,
    stream: Stream,
    rays: Vec<HeldOutRay>,
    /// The first rays that have not been followed yet, and the key of their arc lengths.
    pending: Vec<Vec<f64>>,
    key: u64,
    /// Arc lengths of the box.
    interval: [f64; 2],
    /// Share of comparisons that may exceed the promise.
    exceeding: f64,
    /// Whether the metric ended a ray within the box: the table cannot know that.
    pub singular: bool,
}

impl<'a> HeldOut<'a> {
    /// Those of `region` of `chunk`, of which `lenience` times the usual share may miss the promise. Only
    /// the first are followed, all others when they are asked for.
    pub fn new(refiner: &'a Refiner<'a>, chunk: usize, region: &'a Region, lenience: f64) -> Self {
        let usual = match region.face {
            Some(_) => EXCEEDING,
            None => EXCEEDING_ON_SPHERE,
        };
        let mut held_out = Self {
            refiner,
            chunk,
            region,
            stream: Stream::new(&region.path),
            rays: Vec::new(),
            pending: Vec::new(),
            key: 0,
            interval: region.arc_interval(refiner.plan.length),
            exceeding: lenience * usual,
            singular: false,
        };
        held_out.draw();
        held_out.follow(AT_ONCE);
        if held_out.rays.len() < FIRST {
            held_out.complete();
        }
        held_out
    }

    /// How many rays are drawn at once.
    fn count(&self) -> usize {
        let count = (self.refiner.plan.most_rays as usize / FITTED_EACH).clamp(FEWEST, MOST);
        match self.region.face {
            Some(_) => count,
            None => (ON_SPHERE * count).min(MOST_ON_SPHERE),
        }
    }

    /// Draws more rays.
    fn draw(&mut self) {
        let (count, region) = (self.count(), self.region);
        let parameters = (0..count).map(|_| region.ray(&mut self.stream));
        self.pending = parameters.collect();
        self.key = self.stream.bits();
    }

    /// Follows all rays, and more, until enough of them get as far as the box's arc lengths or hardly any
    /// do.
    pub fn complete(&mut self) {
        if self.pending.is_empty() {
            return;
        }
        self.follow(usize::MAX);
        let enough = self.count() / 3;
        for _ in 1..BATCHES {
            if self.singular || self.rays.len() >= enough {
                break;
            }
            self.draw();
            self.follow(usize::MAX);
        }
    }

    /// Follows the next `count` rays that have been drawn and keeps those that get to the box's arc lengths.
    fn follow(&mut self, count: usize) {
        let (refiner, [start, end]) = (self.refiner, self.interval);
        let (space, plan) = (refiner.space, refiner.plan);
        let manifold = space.manifold();
        let first = self.count() - self.pending.len();
        let later = self.pending.split_off(count.min(self.pending.len()));
        let parameters = std::mem::replace(&mut self.pending, later);
        let rays = parameters.iter();
        let rays: Vec<_> = rays
            .map(|x| refiner.ray(self.chunk, self.region, x))
            .collect();
        let key = self.key;
        let lengths = |ray: usize, length: f64| {
            let mut stream = Stream::new(&[key, (first + ray) as u64]);
            let end = end.min(length);
            let count = if end > start { LENGTHS } else { 0 };
            let within = (0..count).map(|_| end - (end - start) * stream.uniform());
            within.chain((count > 0).then_some(end)).collect()
        };
        let settings = stored_settings(space, plan.tolerance);
        let probed = probe(manifold, settings, end, &rays, lengths);
        let tried = rays.len() as u64;
        refiner.tally.rays.fetch_add(tried, Ordering::Relaxed);
        let ended = |p: &Probed| p.end == End::Singular && p.length >= start;
        self.singular |= probed.iter().any(ended);
        let rays = parameters.into_iter().zip(&rays).zip(probed);
        let rays = rays.filter(|(_, probed)| !probed.probes.is_empty());
        self.rays
            .extend(rays.map(|((parameters, &(u, d)), mut probed)| {
                let exits = probed.exits();
                if !exits {
                    probed.probes.pop();
                }
                HeldOutRay {
                    parameters,
                    start: space.lift().start(u, manifold.observer(u).tangent(d)),
                    probes: probed.probes,
                    exits,
                }
            }));
    }

    /// Whether the box has the whole sphere of directions.
    pub fn on_sphere(&self) -> bool {
        self.region.face.is_none()
    }

    /// Whether no ray gets as far as the box: whatever is stored will not be read.
    pub fn is_empty(&self) -> bool {
        self.rays.is_empty()
    }

    /// The error in mrad that an error of one unit in a displacement channel usually causes: the
    /// upper decile.
    pub fn weight(&self) -> f64 {
        let space = self.refiner.space;
        let mut found = Vec::new();
        for probe in self.rays.iter().flat_map(|ray| &ray.probes) {
            let mut weights = [0.0; CHANNELS];
            weigh(space, false, probe, &mut weights);
            let largest = weights.iter().copied().fold(0.0, f64::max);
            found.extend(Some(largest).filter(|w| *w > 0.0 && w.is_finite()));
        }
        found.sort_by(f64::total_cmp);
        found.get(found.len() * 9 / 10).map_or(1.0, |w| *w)
    }

    /// The error of `tensor` that all but the allowed share of comparisons keep, of points or of
    /// tangents, in units of the promise; of one that is far from it as the first rays tell. An error of
    /// `unit` in a displacement uses up the promise.
    pub fn error(&self, tensor: &Tensor, unit: f64) -> f64 {
        let (first, others) = self.rays.split_at(self.rays.len().min(GLANCE));
        let read = match self.in_single(unit) {
            true => Tensor::at_many_in_single,
            false => Tensor::at_many,
        };
        let mut errors = self.errors_of(first, |points| read(tensor, points));
        let error = self.most_of(&errors);
        if others.is_empty() || !(NEAR[0]..NEAR[1]).contains(&error) {
            return error;
        }
        errors.extend(self.errors_of(others, |points| read(tensor, points)));
        self.most_of(&errors)
    }

    /// Whether the rounding errors of single precision are far below the promise: of displacements no
    /// larger than the arc length.
    fn in_single(&self, unit: f64) -> bool {
        f64::from(f32::EPSILON) * self.refiner.plan.length < NOTHING * unit
    }

    /// What all but the allowed share of these errors keep, in units of the promise.
    fn most_of(&self, errors: &[Errors]) -> f64 {
        Errors::of(errors).most(self.exceeding) / self.refiner.plan.max_error
    }

    /// The same of a polynomial. One that fails is given up as soon as enough rays show it; its error
    /// is then that of those rays, and the others may not have been followed.
    pub fn error_of(&mut self, polynomial: &Polynomial) -> f64 {
        let most = self.refiner.plan.max_error;
        let (mut all, mut from, mut count) = (Vec::<Errors>::new(), 0, FIRST);
        while from < self.rays.len().min(JUDGES) {
            let to = (from + count).min(self.rays.len()).min(JUDGES);
            let rays = &self.rays[from..to];
            all.extend(self.errors_of(rays, |points| polynomial.at(points)));
            let failures = all.iter().map(|e| e.exceeding(most)).sum();
            if self.allowed() < failures {
                break;
            }
            self.complete();
            (from, count) = (to, 2 * count);
        }
        self.most_of(&all)
    }

    /// How many comparisons of those with judges may exceed the promise; of rays that have not been
    /// followed as many may be compared as possible.
    fn allowed(&self) -> usize {
        let judges = &self.rays[..self.rays.len().min(JUDGES)];
        let comparisons: usize = judges.iter().map(|ray| ray.probes.len()).sum();
        let others = self.pending.len().min(JUDGES - judges.len());
        allowed(self.exceeding, comparisons + others * (LENGTHS + 1))
    }

    /// The errors of what `read` gives at the parameters of `rays`.
    fn errors_of(
        &self,
        rays: &[HeldOutRay],
        read: impl FnOnce(&[&[f64]]) -> Vec<Vec<f64>>,
    ) -> Vec<Errors> {
        let points: Vec<&[f64]> = rays.iter().map(|r| r.parameters.as_slice()).collect();
        let stored = read(&points);
        let errors = rays.par_iter().zip(&stored);
        errors
            .map(|(ray, stored)| self.errors(ray, stored))
            .collect()
    }

    /// What a table gets wrong that has `stored` these coefficients for the ray.
    fn errors(&self, ray: &HeldOutRay, stored: &[f64]) -> Errors {
        let refiner = self.refiner;
        let channels = refiner.space.channels().len();
        let mut rows = Vec::new();
        arc::unfold(stored, channels, self.interval, &mut rows);
        let mut errors = Errors::default();
        let only_exits = tangents_at_exits(refiner.space);
        for (i, probe) in ray.probes.iter().enumerate() {
            let sums = arc::sums(&rows, channels, self.interval, &[probe.s]);
            let (u, v) = arc::state(refiner.space, &ray.start, &sums, 0, probe.s);
            errors.points.push(probe.screen_mrad(u - probe.u));
            let exit = ray.exits && i + 1 == ray.probes.len();
            if refiner.plan.frames && (exit || !only_exits) {
                errors.tangents.push(probe.sky_mrad(v - probe.v));
            }
        }
        errors
    }
}

/// Errors in mrad.
#[derive(Default)]
struct Errors {
    points: Vec<f64>,
    tangents: Vec<f64>,
}

impl Errors {
    fn of(rays: &[Self]) -> Self {
        let mut all = Self::default();
        for ray in rays {
            all.points.extend(&ray.points);
            all.tangents.extend(&ray.tangents);
        }
        all
    }

    /// How many points or tangents miss the promise `most`.
    fn exceeding(&self, most: f64) -> usize {
        let count = |errors: &[f64]| errors.iter().filter(|e| !(**e <= most)).count();
        count(&self.points).max(count(&self.tangents))
    }

    /// What all points and all tangents keep but this share of them.
    fn most(self, exceeding: f64) -> f64 {
        quantile(self.points, exceeding).max(quantile(self.tangents, exceeding))
    }
}

/// How many of so many comparisons a share of them is, rounded down.
fn allowed(share: f64, comparisons: usize) -> usize {
    (share * comparisons as f64) as usize
}

/// The error that all but this share of `errors` keep; infinite if it is not a number.
fn quantile(mut errors: Vec<f64>, exceeding: f64) -> f64 {
    errors
        .iter_mut()
        .filter(|e| e.is_nan())
        .for_each(|e| *e = f64::INFINITY);
    let exceeding = allowed(exceeding, errors.len());
    errors.sort_by(|a, b| b.total_cmp(a));
    errors.get(exceeding).map_or(0.0, |e| *e)
}
