//! How many nodes a box needs along each axis, found from a few lines through it.
//!
//! In: a box. Out: [`Needs`]. Fitting a box costs the product of its nodes in rays; a few random
//! lines along each axis cost their sum, and their Chebyshev coefficients tell how many of the nodes
//! are needed, and which axis must be halved because no number allowed is enough.

use super::{
    Refiner,
    region::Region,
    sweep::{Basis, Sweep},
};
use geofan::{
    bundle::{
        PlanRecord, chebyshev,
        measure::{Probe, probe, stored_settings, tangents_at_exits},
        spherical,
    },
    fan::{CHANNELS, DISPLACEMENT, FanSpace, sample},
    random::Stream,
};
use glam::{DVec3, DVec4};
use ndarray::{Array2, Array3, ArrayView2, Axis};
use std::sync::atomic::Ordering;

/// Lines along each axis. With two, one in a flat part of the box hides what the other would show;
/// four find hardly more than three.
const LINES: usize = 3;

/// The share of the promise that what lies beyond the last node may cost along one axis: the errors
/// of all axes add up. Nodes that prove too few are raised after the fit, so little depends on it:
/// from 0.2 to 1 tables of five and six axes take the same bytes to 4 %. Of the rays, 0.25 takes 0.5 to
/// 0.8 of those that 0.6 takes, because fewer boxes are fitted again.
const SHARE: f64 = 0.25;

/// The share of line positions, the worst, that need not be met: the promise is a quantile too, and
/// held-out rays find what the worst positions cost. From 0.01 to 0.15 the bytes are the same to 2 %.
const IGNORED: f64 = 0.05;

/// The error aimed at when nodes are raised, in units of the promise; the next where the plan has no
/// room for the first.
const AIMS: [f64; 2] = [0.35, 0.8];

/// By what share more nodes than the plan allows may seem to be needed and it is still tried with as
/// many as it allows.
const HOPEFUL: f64 = 1.15;

/// The most nodes that are believed to be missing along one axis: more is as hopeless.
const FARTHEST: f64 = 100.0;

/// How fast and how slowly coefficients are believed to fall from degree to degree.
const FASTEST: f64 = 0.2;
const SLOWEST: f64 = 0.9;

/// What a box needs.
#[derive(Debug, Clone)]
pub struct Needs {
    /// Nodes along each axis (camera…, direction…, arc length), at most those of the plan.
    pub nodes: Vec<usize>,
    /// By what factor the error exceeds its share where all nodes of the plan are not enough; at
    /// most 1 where they are.
    pub excess: Vec<f64>,
    /// The largest excess in the first half of the arc lengths.
    pub early_excess: f64,
}

impl Needs {
    /// Of `region` of `chunk`.
    pub fn new(refiner: &Refiner<'_>, chunk: usize, region: &Region) -> Self {
        let all = Self::all(refiner, region);
        match all.rays() <= refiner.most_rays(region) {
            true => all,
            false => Self::along_lines(refiner, chunk, region),
        }
    }

    fn along_lines(refiner: &Refiner<'_>, chunk: usize, region: &Region) -> Self {
        let most = refiner.most_nodes(region);
        let variables = refiner.variables(region);
        let lengths = refiner.arc_lengths(region, most[region.arc()]);
        let mut stream = Stream::new(&[&region.path[..], &[u64::MAX]].concat());
        let allowed = SHARE * refiner.plan.max_error;
        let mut along_arc = Tails::new(Basis::Polynomials, most[region.arc()], allowed);
        let mut early_excess = 0.0_f64;
        let (mut nodes, mut excess) = (Vec::new(), Vec::new());
        for axis in 0..region.arc() {
            let sweep = Sweep::new(variables, axis, most[axis]);
            let mut halves = [0, 1].map(|_| Tails::new(sweep.basis(), sweep.count(), allowed));
            for _ in 0..LINES {
                let points = sweep.through(&region.ray(&mut stream));
                let rays: Vec<_> = points
                    .iter()
                    .map(|x| refiner.ray(chunk, region, x))
                    .collect();
                let count = rays.len() as u64;
                refiner.tally.rays.fetch_add(count, Ordering::Relaxed);
                let line = Line::new(refiner.space, refiner.plan, &rays, &lengths);
                line.each(Axis(0), &mut along_arc);
                let middle = lengths.len() / 2;
                let [early, late] = line.halves(middle);
                early.each(Axis(1), &mut halves[0]);
                late.each(Axis(1), &mut halves[1]);
            }
            let [early, late] = halves;
            early_excess = early_excess.max(early.excess());
            nodes.push(sweep.nodes(early.nodes().max(late.nodes())));
            excess.push(early.excess().max(late.excess()));
        }
        nodes.push(along_arc.nodes());
        excess.push(along_arc.excess());
        Self {
            nodes,
            excess,
            early_excess,
        }
    }

    /// All nodes of the plan: where they are few, looking first costs more than it saves.
    fn all(refiner: &Refiner<'_>, region: &Region) -> Self {
        let nodes = refiner.most_nodes(region);
        Self {
            excess: vec![0.0; nodes.len()],
            nodes,
            early_excess: 0.0,
        }
    }

    /// As many more nodes as the fall of the coefficients of each degree (`spectra`) promises to be
    /// needed, if `limits` (nodes along each axis, rays) have room for them: `left` is the error with the present ones, in units of
    /// the promise.
    pub fn raise(&mut self, limits: (&[usize], usize), spectra: &[Vec<f64>], left: f64) -> bool {
        let (most, most_rays) = limits;
        AIMS.iter().any(|aim| {
            let shares = self.shares(most, spectra, left / aim);
            let wanted = shares.iter().zip(most);
            let raised = wanted.zip(&self.nodes).map(|((share, most), n)| {
                let more = ((share * *most as f64).round() as usize).saturating_sub(*n);
                (n + more.min(n.div_ceil(2))).min(*most)
            });
            let more = Self {
                nodes: raised.collect(),
                ..self.clone()
            };
            let fits = shares.iter().all(|share| *share <= HOPEFUL)
                && more.rays() <= most_rays
                && more.nodes != self.nodes;
            if fits {
                *self = more;
            }
            fits
        })
    }

    /// The nodes along each axis that promise to reduce the error by `factor`, as shares of the `most`.
    fn shares(&self, most: &[usize], spectra: &[Vec<f64>], factor: f64) -> Vec<f64> {
        let wanted = self.nodes.iter().zip(additional(spectra, factor));
        let shares = wanted.zip(most);
        shares
            .map(|((n, more), most)| (n + more) as f64 / *most as f64)
            .collect()
    }

    /// Rays of a full grid.
    pub fn rays(&self) -> usize {
        self.nodes[..self.nodes.len() - 1].iter().product()
    }
}

/// The nodes along each axis that are to be added to reduce the error by `factor`.
fn additional(spectra: &[Vec<f64>], factor: f64) -> impl Iterator<Item = usize> {
    let tails: Vec<f64> = spectra.iter().map(|s| tail(s)).collect();
    let all = tails.iter().map(|t| t * t).sum::<f64>().sqrt();
    let share = all / (factor * (spectra.len() as f64).sqrt());
    spectra.iter().zip(tails).map(move |(spectrum, tail)| {
        let more = (tail / share).ln() / -fall(spectrum).ln();
        more.clamp(0.0, FARTHEST).ceil() as usize
    })
}

/// The size of the two highest coefficients.
pub fn tail(spectrum: &[f64]) -> f64 {
    let n = spectrum.len();
    let last = &spectrum[n.saturating_sub(2)..];
    last.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// By what factor coefficients fall from one degree to the next, in the upper half of them.
fn fall(spectrum: &[f64]) -> f64 {
    let (n, half) = (spectrum.len(), spectrum.len() / 2);
    let fall = tail(spectrum) / tail(&spectrum[..(n - half).max(1)]);
    let fall = fall.powf(1.0 / half.max(1) as f64);
    if fall.is_nan() {
        SLOWEST
    } else {
        fall.clamp(FASTEST, SLOWEST)
    }
}

/// Exact paths from the nodes of a line.
pub struct Line {
    /// Node, arc length, channel.
    values: Array3<f64>,
    /// By what an error of each value is to be multiplied to be one in mrad; zero where no one will
    /// look.
    weights: Array3<f64>,
}

impl Line {
    /// Follows `rays` (chart point, direction in the standard frame) to the arc lengths.
    pub fn new(
        space: &FanSpace,
        plan: &PlanRecord,
        rays: &[(DVec3, DVec3)],
        lengths: &[f64],
    ) -> Self {
        let manifold = space.manifold();
        let tangents = rays
            .iter()
            .map(|&(u, d)| (u, manifold.observer(u).tangent(d)));
        let tangents: Vec<_> = tangents.collect();
        let values = sample(space, plan.tolerance, &tangents, lengths);
        let farthest = lengths.last().copied().unwrap_or(0.0);
        let within = |_: usize, end: f64| lengths.iter().copied().filter(|s| *s <= end).collect();
        let settings = stored_settings(space, plan.tolerance);
        let probed = probe(manifold, settings, farthest, rays, within);
        let only_exits = tangents_at_exits(space);
        let mut weights = Array3::zeros(values.dim());
        for (mut rows, probed) in weights.outer_iter_mut().zip(&probed) {
            let last = probed.probes.len().saturating_sub(1);
            let seen = |i: usize| match only_exits {
                true => i == last && probed.exits(),
                false => true,
            };
            for (i, (mut row, probe)) in rows.outer_iter_mut().zip(&probed.probes).enumerate() {
                weigh(
                    space,
                    plan.frames && seen(i),
                    probe,
                    row.as_slice_mut().expect("contiguous"),
                );
            }
        }
        Self { values, weights }
    }

    /// The parts before and after the arc length number `middle`.
    fn halves(&self, middle: usize) -> [Self; 2] {
        let (values, weights) = (self.values.view(), self.weights.view());
        let (early, late) = values.split_at(Axis(1), middle);
        let (early_weights, late_weights) = weights.split_at(Axis(1), middle);
        [(early, early_weights), (late, late_weights)].map(|(values, weights)| Self {
            values: values.to_owned(),
            weights: weights.to_owned(),
        })
    }

    /// Adds the tails of all series across `axis` (0: along the arc length, 1: along the line).
    pub fn each(&self, axis: Axis, tails: &mut Tails) {
        let weights = self.weights.axis_iter(axis);
        for (values, weights) in self.values.axis_iter(axis).zip(weights) {
            tails.add(values, weights);
        }
    }
}

/// The factors that make errors of the channels at `probe` mrad: of displacements, and of slopes
/// where tangents matter.
pub fn weigh(space: &FanSpace, frames: bool, probe: &Probe, weights: &mut [f64]) {
    let lift = space.lift();
    for channel in space.channels() {
        let mut unit = [0.0; 4];
        unit[*channel] = 1.0;
        let change = lift.chart_change(probe.u, DVec4::from_array(unit));
        weights[DISPLACEMENT + channel] = probe.screen_mrad(change * probe.s);
        if frames {
            weights[*channel] = probe.sky_mrad(change);
        }
    }
}

/// What polynomials of too few degrees miss, at many places.
pub struct Tails {
    most: usize,
    allowed: f64,
    /// Of term `k` at node `i` at `[i, k]`.
    values: Array2<f64>,
    /// Samples to coefficients.
    transform: Array2<f64>,
    /// The number of coefficients needed at each place.
    counts: Vec<usize>,
    /// What the last two coefficients contribute, in units of what is allowed.
    ends: Vec<f64>,
}

impl Tails {
    /// None yet, of series of `most` nodes of a `basis`, with `allowed` mrad to be missed.
    pub fn new(basis: Basis, most: usize, allowed: f64) -> Self {
        let [values, transform] = match basis {
            Basis::Polynomials => [
                chebyshev::inverse_transform(most),
                chebyshev::transform(most),
            ],
            Basis::Waves => spherical::azimuth_transforms(most),
        };
        Self {
            most,
            allowed,
            values,
            transform,
            counts: Vec::new(),
            ends: Vec::new(),
        }
    }

    /// Adds a series of samples (node, channel) with its weights.
    fn add(&mut self, samples: ArrayView2<'_, f64>, weights: ArrayView2<'_, f64>) {
        let coefficients = self.transform.dot(&samples);
        for (place, weights) in weights.outer_iter().enumerate() {
            let channels = (0..weights.len()).filter(|c| weights[*c] > 0.0);
            let channels: Vec<(usize, f64)> = channels.map(|c| (c, weights[c])).collect();
            if !channels.is_empty() {
                self.add_place(&coefficients, place, &channels);
            }
        }
    }

    /// Adds what is missed at node `place`, in `channels` with their weights.
    fn add_place(&mut self, coefficients: &Array2<f64>, place: usize, channels: &[(usize, f64)]) {
        let mut missed = [0.0; CHANNELS];
        let (mut count, mut end) = (1, 0.0);
        for k in (1..self.most).rev() {
            let value = self.values[[place, k]];
            // Of tangents and of points.
            let mut squares = [0.0; 2];
            for (c, weight) in channels {
                missed[*c] += weight * value * coefficients[[k, *c]];
                squares[*c / DISPLACEMENT] += missed[*c] * missed[*c];
            }
            // `max` forgets what is not a number.
            let worst = match squares[0] >= squares[1] || squares[0].is_nan() {
                true => squares[0],
                false => squares[1],
            };
            let excess = worst.sqrt() / self.allowed;
            if k + 2 >= self.most {
                end = excess;
            }
            if count == 1 && !(excess <= 1.0) {
                count = k + 1;
            }
            if count > 1 && k + 2 <= self.most {
                break;
            }
        }
        self.counts.push(count);
        self.ends
            .push(if end.is_finite() { end } else { f64::INFINITY });
    }

    fn rank(&self) -> usize {
        ((1.0 - IGNORED) * self.counts.len().saturating_sub(1) as f64).round() as usize
    }

    /// The number of nodes that is enough at nearly all places.
    pub fn nodes(&self) -> usize {
        let mut counts = self.counts.clone();
        counts.sort_unstable();
        counts.get(self.rank()).map_or(1, |n| *n)
    }

    /// By what factor what is missed with two nodes fewer than the most exceeds what is allowed.
    pub fn excess(&self) -> f64 {
        let mut ends = self.ends.clone();
        ends.sort_by(f64::total_cmp);
        ends.get(self.rank()).map_or(0.0, |e| *e)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tails(sizes: impl Fn(usize) -> f64) -> Tails {
        let nodes = chebyshev::nodes(12);
        let samples = Array2::from_shape_fn((12, 1), |(i, _)| {
            let mut values = [0.0; 12];
            chebyshev::values(nodes[i], &mut values);
            values.iter().enumerate().map(|(k, t)| sizes(k) * t).sum()
        });
        let mut tails = Tails::new(Basis::Polynomials, 12, 1e-3);
        tails.add(samples.view(), Array2::ones((12, 1)).view());
        tails
    }

    #[test]
    fn what_falls_off_needs_the_nodes_above_what_is_allowed() {
        let falling = tails(|k| 0.1_f64.powi(k as i32));
        assert!((4..=5).contains(&falling.nodes()));
        assert!(falling.excess() < 1e-6);
    }

    #[test]
    fn what_does_not_fall_off_exceeds() {
        let flat = tails(|_| 1.0);
        assert!(flat.nodes() > 10 && flat.excess() > 500.0);
        assert_eq!(tails(|_| f64::NAN).excess(), f64::INFINITY);
    }
}
