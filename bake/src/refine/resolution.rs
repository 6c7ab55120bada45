//! The resolution of a box: how many nodes it needs along each axis, found by probing a few lines.
//!
//! In: a box. Out: its [`Resolution`]. Fitting a box costs the product of its nodes in rays; a few random
//! lines along each axis cost their sum, and the coefficients along them tell how many of the nodes are
//! needed, and which axis must be halved because no number allowed is enough.

use super::{
    Refiner,
    edges::between,
    line_series::{LineSamples, ProbeLine, SeriesTails},
    tree::ParameterBox,
};
use geofan_core::random::Stream;
use glam::DVec3;

/// Lines along each axis. With two, one in a flat part of the box hides what the other would show;
/// four find hardly more than three.
const LINES: usize = 3;

/// Share of the promise that terms beyond the last node may cost along one axis: the errors of all axes
/// add up. Nodes that prove too few are raised after the fit, so little depends on it: from 0.2 to 1
/// tables of five and six axes take the same bytes to 4 %. Fitting with 0.25 takes 0.5 to 0.8 of the rays
/// that 0.6 takes, because fewer boxes are fitted again.
const SHARE: f64 = 0.25;

/// The error aimed at when nodes are raised, in units of the promise; the next where the plan has no
/// room for the first.
const AIMS: [f64; 2] = [0.35, 0.8];

/// Factor by which the nodes that seem to be needed may exceed the plan's so that it is still tried with
/// as many as it allows.
const HOPEFUL: f64 = 1.15;

/// The most nodes that are believed to be missing along one axis: more is as hopeless.
const FARTHEST: f64 = 100.0;

/// Fastest and slowest fall of coefficients from degree to degree that is believed.
const FASTEST: f64 = 0.2;
const SLOWEST: f64 = 0.9;

/// Nodes of a box, and where they are not enough.
#[derive(Debug, Clone)]
pub struct Resolution {
    /// Nodes along each axis (camera…, direction…, arc length), at most those of the plan.
    pub nodes: Vec<usize>,
    /// Factor by which the error exceeds its share, for each axis, where all nodes of the plan are not
    /// enough; at most 1 where they are.
    pub excess: Vec<f64>,
    /// The largest excess in the first half of the arc lengths.
    pub early_excess: f64,
}

impl Resolution {
    /// Finds the resolution of the box `bounds` of `chunk`.
    pub fn new(refiner: &Refiner<'_>, chunk: usize, bounds: &ParameterBox) -> Self {
        let all = Self::all(refiner, bounds);
        match all.rays() <= refiner.most_rays(bounds) {
            true => all,
            false => Self::along_lines(refiner, chunk, bounds),
        }
    }

    /// Probes lines along each axis.
    fn along_lines(refiner: &Refiner<'_>, chunk: usize, bounds: &ParameterBox) -> Self {
        let most = refiner.most_nodes(bounds);
        let variables = refiner.variables(bounds);
        let lengths = refiner.arc_lengths(bounds, most[bounds.arc()]);
        let samples_on = |points: &[Vec<f64>], rays: &[(DVec3, DVec3)]| {
            let pieces = refiner.pieces(bounds, points);
            let between = pieces.as_ref().map(between);
            LineSamples::new(refiner.space, refiner.plan, rays, (&lengths, between))
        };
        let mut stream = Stream::new(&[&bounds.name[..], &[u64::MAX]].concat());
        let allowed = SHARE * refiner.plan.max_error;
        let mut along_arc = SeriesTails::of_polynomials(most[bounds.arc()], allowed);
        let mut early_excess = 0.0_f64;
        let (mut nodes, mut excess) = (Vec::new(), Vec::new());
        for axis in 0..bounds.arc() {
            let line = ProbeLine::new(variables, axis, most[axis]);
            let [mut early, mut late] = [0, 1].map(|_| line.tails(allowed));
            for _ in 0..LINES {
                // Exact paths from a random line.
                let points = line.through(&bounds.random_ray(&mut stream));
                let rays: Vec<_> = points
                    .iter()
                    .map(|x| refiner.ray(chunk, bounds, x))
                    .collect();
                if !refiner.tally.go_on(rays.len()) {
                    break;
                }
                let samples = samples_on(&points, &rays);
                // Their series along the arc length, and along the line in both halves of it.
                samples.along_paths(&mut along_arc);
                let [early_samples, late_samples] = samples.halves(lengths.len() / 2);
                early_samples.along_line(&mut early);
                late_samples.along_line(&mut late);
            }
            early_excess = early_excess.max(early.excess());
            nodes.push(line.nodes(early.terms().max(late.terms())));
            excess.push(early.excess().max(late.excess()));
        }
        nodes.push(along_arc.terms());
        excess.push(along_arc.excess());
        Self {
            nodes,
            excess,
            early_excess,
        }
    }

    /// Takes these nodes.
    pub fn of_nodes(nodes: Vec<usize>) -> Self {
        Self {
            excess: vec![0.0; nodes.len()],
            nodes,
            early_excess: 0.0,
        }
    }

    /// Takes all nodes of the plan: where they are few, looking first costs more than it saves.
    fn all(refiner: &Refiner<'_>, bounds: &ParameterBox) -> Self {
        Self::of_nodes(refiner.most_nodes(bounds))
    }

    /// Adds as many nodes as the fall of the coefficients of each degree (`spectra`) suggests, if `limits`
    /// (nodes along each axis, rays) have room for them; tells whether it did. `left` is the error with the
    /// present ones, in units of the promise.
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

    /// Returns the nodes along each axis that should reduce the error by `factor`, as shares of the `most`.
    fn shares(&self, most: &[usize], spectra: &[Vec<f64>], factor: f64) -> Vec<f64> {
        let wanted = self.nodes.iter().zip(additional_nodes(spectra, factor));
        let shares = wanted.zip(most);
        shares
            .map(|((n, more), most)| (n + more) as f64 / *most as f64)
            .collect()
    }

    /// Counts the rays of a full grid.
    pub fn rays(&self) -> usize {
        self.nodes[..self.nodes.len() - 1].iter().product()
    }
}

/// Estimates the nodes along each axis that must be added to reduce the error by `factor`.
fn additional_nodes(spectra: &[Vec<f64>], factor: f64) -> impl Iterator<Item = usize> {
    let tails: Vec<f64> = spectra.iter().map(|s| tail(s)).collect();
    let all = tails.iter().map(|t| t * t).sum::<f64>().sqrt();
    let share = all / (factor * (spectra.len() as f64).sqrt());
    spectra.iter().zip(tails).map(move |(spectrum, tail)| {
        let more = (tail / share).ln() / -fall(spectrum).ln();
        more.clamp(0.0, FARTHEST).ceil() as usize
    })
}

/// Returns the size of the two highest coefficients.
pub fn tail(spectrum: &[f64]) -> f64 {
    let n = spectrum.len();
    let last = &spectrum[n.saturating_sub(2)..];
    last.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Returns the factor by which coefficients fall from one degree to the next, in the upper half of them.
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
