//! Random rays of a box that its polynomials are not fitted to, and what a table gets wrong on them.

use super::{Refiner, region::Region, scout::weigh};
use geofan::{
    bundle::{
        Polynomial, Tensor, arc,
        measure::{Probe, Probed, probe, stored_settings, tangents_at_exits},
    },
    fan::{CHANNELS, FanSpace, Start},
    geodesic::End,
    random::Stream,
};
use rayon::prelude::*;
use std::sync::atomic::Ordering;

/// The fewest held-out rays of a box. Fewer miss narrow failures, and let steps pass that other rays
/// would not (S³ and H³: 99th percentiles 0.98 of the promise with 48, 0.9 with 96).
const FEWEST: usize = 96;

/// The most, and how many rays a box may be fitted to for each. Boxes of many axes have more places
/// for failures to hide, and can afford to look.
const MOST: usize = 480;
const FITTED_EACH: usize = 40;

/// How many times as many the whole sphere of directions has: it stands for six faces.
const ON_SPHERE: usize = 3;

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
/// 0.0095 the certificate of three bumps on a floor exceeded the promise by 1 %.
const EXCEEDING_ON_SPHERE: f64 = 0.0085;

/// The most rays that judge a polynomial, and how many of them come first, to find out most failures.
/// All the others follow in parts of twice as many each: reading the coefficients takes as long as
/// summing them for a few rays.
const JUDGES: usize = 160;
const FIRST: usize = 16;

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
pub struct HeldOut {
    rays: Vec<HeldOutRay>,
    /// Arc lengths of the box.
    interval: [f64; 2],
    /// Share of comparisons that may exceed the promise.
    exceeding: f64,
    /// Whether the metric ended a ray within the box: the table cannot know that.
    pub singular: bool,
}

impl HeldOut {
    /// Follows held-out rays of `region` of `chunk`, until enough of them get as far as the box's arc
    /// lengths or hardly any do.
    pub fn new(refiner: &Refiner<'_>, chunk: usize, region: &Region) -> Self {
        let count = (refiner.plan.most_rays as usize / FITTED_EACH).clamp(FEWEST, MOST);
        let (count, exceeding) = match region.face {
            Some(_) => (count, EXCEEDING),
            None => (ON_SPHERE * count, EXCEEDING_ON_SPHERE),
        };
        let mut stream = Stream::new(&region.path);
        let mut held_out = Self {
            rays: Vec::new(),
            interval: region.arc_interval(refiner.plan.length),
            exceeding,
            singular: false,
        };
        for _ in 0..BATCHES {
            held_out.follow(refiner, chunk, region, (count, &mut stream));
            if held_out.singular || held_out.rays.len() >= count / 3 {
                break;
            }
        }
        held_out
    }

    /// Follows `count` more rays and keeps those that get to the box's arc lengths.
    fn follow(
        &mut self,
        refiner: &Refiner<'_>,
        chunk: usize,
        region: &Region,
        (count, stream): (usize, &mut Stream),
    ) {
        let (space, plan) = (refiner.space, refiner.plan);
        let manifold = space.manifold();
        let parameters = (0..count).map(|_| region.ray(stream));
        let parameters: Vec<Vec<f64>> = parameters.collect();
        let rays: Vec<_> = parameters
            .iter()
            .map(|x| refiner.ray(chunk, region, x))
            .collect();
        let [start, end] = self.interval;
        let key = stream.bits();
        let lengths = |ray: usize, length: f64| {
            let mut stream = Stream::new(&[key, ray as u64]);
            let end = end.min(length);
            let count = if end > start { LENGTHS } else { 0 };
            let within = (0..count).map(|_| end - (end - start) * stream.uniform());
            within.chain((count > 0).then_some(end)).collect()
        };
        let probed = probe(
            manifold,
            stored_settings(space, plan.tolerance),
            end,
            &rays,
            lengths,
        );
        let tried = count as u64;
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
                    start: space.lift().start(u, manifold.standard_frame(u) * d),
                    probes: probed.probes,
                    exits,
                }
            }));
    }

    /// Whether no ray gets as far as the box: whatever is stored will not be read.
    pub fn is_empty(&self) -> bool {
        self.rays.is_empty()
    }

    /// The error in mrad that an error of one unit in a displacement channel usually causes: the
    /// upper decile.
    pub fn weight(&self, space: &FanSpace) -> f64 {
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
    /// tangents, in units of the promise.
    pub fn error(&self, refiner: &Refiner<'_>, tensor: &Tensor) -> f64 {
        let points: Vec<&[f64]> = self.rays.iter().map(|r| r.parameters.as_slice()).collect();
        let stored = tensor.at_many(&points);
        let errors = self.rays.par_iter().zip(&stored);
        let errors = errors.map(|(ray, stored)| self.errors(refiner, ray, stored));
        Errors::of(errors.collect()).most(self.exceeding) / refiner.plan.max_error
    }

    /// The same of a polynomial. One that fails is given up as soon as enough rays show it; its error
    /// is then that of those rays.
    pub fn error_of(&self, refiner: &Refiner<'_>, polynomial: &Polynomial) -> f64 {
        let judges = &self.rays[..self.rays.len().min(JUDGES)];
        let comparisons: usize = judges.iter().map(|ray| ray.probes.len()).sum();
        let mut all: Vec<Errors> = Vec::new();
        let (mut left, mut count) = (judges, FIRST);
        while !left.is_empty() {
            let (rays, after) = left.split_at(count.min(left.len()));
            (left, count) = (after, 2 * count);
            let points: Vec<&[f64]> = rays.iter().map(|r| r.parameters.as_slice()).collect();
            let stored = polynomial.at(&points);
            let errors = rays.par_iter().zip(&stored);
            let errors = errors.map(|(ray, stored)| self.errors(refiner, ray, stored));
            all.par_extend(errors);
            let failures = all
                .iter()
                .map(|e| e.exceeding(refiner.plan.max_error))
                .sum();
            if allowed(self.exceeding, comparisons) < failures {
                break;
            }
        }
        Errors::of(all).most(self.exceeding) / refiner.plan.max_error
    }

    /// What a table gets wrong that has `stored` these coefficients for the ray.
    fn errors(&self, refiner: &Refiner<'_>, ray: &HeldOutRay, stored: &[f64]) -> Errors {
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
    fn of(rays: Vec<Self>) -> Self {
        let mut all = Self::default();
        for ray in rays {
            all.points.extend(ray.points);
            all.tangents.extend(ray.tangents);
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
