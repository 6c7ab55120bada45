//! Series along lines through a box, and the resolution that they ask for: how many nodes it needs along each axis.
//!
//! In: rays along a line, or along the arc length of a path. Out: [`SeriesTails`], which tell how many
//! terms the promise takes. Along a face of directions the series are Chebyshev polynomials. Around the
//! whole sphere they are sines and cosines: along its parallels, and, for the polar angle, around whole
//! meridians.
//!
//! In: a box. Out: its [`Resolution`]. Fitting a box costs the product of its nodes in rays; a few random
//! lines along each axis cost their sum, and the coefficients along them tell how many of the nodes are
//! needed, and which axis must be halved because no number allowed is enough.

use super::{Refiner, edges::between, refinement_tree::ParameterBox};
use geofan_bundle::{
    PlanRecord, Variables, chebyshev,
    measure::{Probe, probe, stored_settings, tangents_at_exits},
    rays::{BetweenEdges, CHANNELS, DISPLACEMENT, RaySpace, sample},
    spherical,
};
use geofan_core::random::Stream;
use glam::{DVec3, DVec4};
use ndarray::{Array2, Array3, ArrayView2, Axis};

/// Share of the places, the worst, whose series may need more terms: the promise is a quantile too, and
/// held-out rays find what the worst places cost. From 0.01 to 0.15 the bytes are the same to 2 %.
const IGNORED: f64 = 0.05;

/// A line through a box, by the axis that varies and where its rays are on it.
pub enum ProbeLine {
    /// From end to end of an interval, for polynomials.
    Interval(usize, Vec<f64>),
    /// Around a parallel of the sphere of directions, for sines and cosines.
    Parallel(usize, Vec<f64>),
    /// Around a whole meridian, for sines and cosines: angles in half turns from the pole; the axis is
    /// the polar angle's.
    Meridian(usize, Vec<f64>),
}

impl ProbeLine {
    /// Lays a line along `axis`, with at least as many rays as are needed to tell up to `most` nodes.
    pub fn new(variables: Variables, axis: usize, most: usize) -> Self {
        match (variables.sphere, axis.checked_sub(variables.cameras)) {
            (true, Some(1)) => {
                let around = spherical::azimuths(2 * most - 1);
                Self::Meridian(axis, around.iter().map(|a| a + 1.0).collect())
            }
            (true, Some(0)) => Self::Parallel(axis, variables.places(axis, most)),
            _ => Self::Interval(axis, variables.places(axis, most)),
        }
    }

    /// Prepares to look at series along it of which `allowed` mrad may be missed.
    pub(super) fn tails(&self, allowed: f64) -> SeriesTails {
        match self {
            Self::Interval(_, places) => SeriesTails::of_polynomials(places.len(), allowed),
            Self::Parallel(_, places) | Self::Meridian(_, places) => {
                SeriesTails::of_waves(places.len(), allowed)
            }
        }
    }

    /// Counts the nodes that the axis needs if a series along the line needs so many terms.
    pub fn nodes(&self, terms: usize) -> usize {
        match self {
            Self::Interval(..) => terms,
            // Sine and cosine of each frequency.
            Self::Parallel(..) => terms | 1,
            Self::Meridian(..) => terms / 2 + 1,
        }
    }

    /// Returns the parameters of the line's rays, which differ from `x` along the line alone.
    pub fn through(&self, x: &[f64]) -> Vec<Vec<f64>> {
        let at = |place: &f64| {
            let mut x = x.to_vec();
            match self {
                Self::Interval(axis, _) | Self::Parallel(axis, _) => x[*axis] = *place,
                Self::Meridian(axis, _) if *place <= 1.0 => x[*axis] = 2.0 * place - 1.0,
                // Beyond the other pole.
                Self::Meridian(axis, _) => {
                    x[*axis] = 2.0 * (2.0 - place) - 1.0;
                    x[axis - 1] += if x[axis - 1] < 0.0 { 1.0 } else { -1.0 };
                }
            }
            x
        };
        let (Self::Interval(_, places) | Self::Parallel(_, places) | Self::Meridian(_, places)) =
            self;
        places.iter().map(at).collect()
    }
}

/// Exact paths from the places of a line.
pub struct LineSamples {
    /// Stored numbers of each path: (place, arc length, channel).
    values: Array3<f64>,
    /// Factors that turn errors of the values into mrad; zero where no one will look.
    weights: Array3<f64>,
}

impl LineSamples {
    /// Follows `rays` (chart point, direction in the standard frame) to the arc lengths, or `between` edges to
    /// shares of what is there.
    pub fn new(
        space: &RaySpace,
        (plan, tolerance): (&PlanRecord, f64),
        rays: &[(DVec3, DVec3)],
        (lengths, between): (&[f64], Option<BetweenEdges<'_>>),
    ) -> Self {
        let manifold = space.manifold();
        let tangents = rays
            .iter()
            .map(|&(u, d)| (u, manifold.local_frame(u).tangent(d)));
        let tangents: Vec<_> = tangents.collect();
        let values = sample(space, tolerance, &tangents, (lengths, between));
        // The magnification of each path, up to its end.
        let at = |ray: usize, s: f64| match between {
            Some(BetweenEdges { intervals, .. }) => {
                let [low, high] = intervals[ray];
                low + s * (high - low)
            }
            None => s,
        };
        let last = lengths.last().copied().unwrap_or(0.0);
        let farthest = (0..rays.len()).map(|ray| at(ray, last)).fold(0.0, f64::max);
        let within = |ray: usize, end: f64| {
            let lengths = lengths.iter().map(|s| at(ray, *s));
            lengths.filter(|s| *s <= end).collect()
        };
        let settings = stored_settings(space, tolerance);
        let probed = probe(manifold, settings, farthest, rays, within);
        // Errors beyond the end of a path have no weight.
        let only_exits = tangents_at_exits(space);
        let mut weights = Array3::zeros(values.dim());
        for (mut rows, probed) in weights.outer_iter_mut().zip(&probed) {
            let last = probed.probes.len().saturating_sub(1);
            let shown = |i: usize| match only_exits {
                true => i == last && probed.exits(),
                false => true,
            };
            for (i, (mut row, probe)) in rows.outer_iter_mut().zip(&probed.probes).enumerate() {
                let row = row.as_slice_mut().expect("contiguous");
                let tangents = plan.tangent_weight().filter(|_| shown(i));
                channel_weights(space, tangents, probe, row);
            }
        }
        Self { values, weights }
    }

    /// Divides into the parts before and after the arc length number `middle`.
    pub fn halves(&self, middle: usize) -> [Self; 2] {
        let (values, weights) = (self.values.view(), self.weights.view());
        let (early, late) = values.split_at(Axis(1), middle);
        let (early_weights, late_weights) = weights.split_at(Axis(1), middle);
        [(early, early_weights), (late, late_weights)].map(|(values, weights)| Self {
            values: values.to_owned(),
            weights: weights.to_owned(),
        })
    }

    /// Adds the series along the arc length, from every place of the line, to `tails`.
    pub fn along_paths(&self, tails: &mut SeriesTails) {
        self.add_series(Axis(0), tails);
    }

    /// Adds the series along the line, at every arc length, to `tails`.
    pub fn along_line(&self, tails: &mut SeriesTails) {
        self.add_series(Axis(1), tails);
    }

    /// Adds all series across `axis`.
    fn add_series(&self, axis: Axis, tails: &mut SeriesTails) {
        let weights = self.weights.axis_iter(axis);
        for (values, weights) in self.values.axis_iter(axis).zip(weights) {
            tails.add(values, weights);
        }
    }
}

/// Finds the factors that turn errors of the channels at `probe` into mrad: those of displacements, and
/// those of slopes where tangents are promised, times the factor by which their errors count.
pub fn channel_weights(
    space: &RaySpace,
    tangents: Option<f64>,
    probe: &Probe,
    weights: &mut [f64],
) {
    let chart_map = space.chart_map();
    for channel in space.channels() {
        let mut unit = [0.0; 4];
        unit[*channel] = 1.0;
        let change = chart_map.chart_change(probe.u, DVec4::from_array(unit));
        weights[DISPLACEMENT + channel] = probe.screen_mrad(change * probe.s);
        if let Some(factor) = tangents {
            weights[*channel] = factor * probe.sky_mrad(change);
        }
    }
}

/// Errors of series that are cut off after too few terms, at many places.
pub struct SeriesTails {
    most: usize,
    /// Error allowed, mrad.
    allowed: f64,
    /// Value of term `k` at node `i`: `[i, k]`.
    values: Array2<f64>,
    /// Samples to coefficients.
    transform: Array2<f64>,
    /// The number of coefficients needed at each place.
    counts: Vec<usize>,
    /// The error without the last two coefficients, in units of what is allowed.
    ends: Vec<f64>,
}

impl SeriesTails {
    /// Begins with no series; they will be of `most` Chebyshev polynomials.
    pub fn of_polynomials(most: usize, allowed: f64) -> Self {
        let (values, transform) = (
            chebyshev::inverse_transform(most),
            chebyshev::transform(most),
        );
        Self::new([values, transform], most, allowed)
    }

    /// Begins with no series; they will be of `most` sines and cosines.
    pub fn of_waves(most: usize, allowed: f64) -> Self {
        Self::new(spherical::azimuth_transforms(most), most, allowed)
    }

    fn new([values, transform]: [Array2<f64>; 2], most: usize, allowed: f64) -> Self {
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

    /// Adds the errors at node `place`, in `channels` with their weights: terms are left out from the
    /// highest on, until more is missed than is allowed.
    fn add_place(&mut self, coefficients: &Array2<f64>, place: usize, channels: &[(usize, f64)]) {
        let mut missed = [0.0; CHANNELS];
        let (mut count, mut end) = (1, 0.0);
        for k in (1..self.most).rev() {
            let value = self.values[[place, k]];
            // Squares of the errors of tangents and of points.
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

    /// Returns the rank of the place that decides, behind which the worst are ignored.
    fn deciding_rank(&self) -> usize {
        ((1.0 - IGNORED) * self.counts.len().saturating_sub(1) as f64).round() as usize
    }

    /// Returns the number of terms that is enough at nearly all places.
    pub fn terms(&self) -> usize {
        let mut counts = self.counts.clone();
        counts.sort_unstable();
        counts.get(self.deciding_rank()).map_or(1, |n| *n)
    }

    /// Returns the factor by which the error with two terms fewer than the most exceeds what is allowed,
    /// at nearly all places.
    pub fn excess(&self) -> f64 {
        let mut ends = self.ends.clone();
        ends.sort_by(f64::total_cmp);
        ends.get(self.deciding_rank()).map_or(0.0, |e| *e)
    }
}

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
pub(super) struct Resolution {
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
            let plan = (refiner.plan, refiner.tolerance(bounds));
            LineSamples::new(refiner.space, plan, rays, (&lengths, between))
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

#[cfg(test)]
mod tests {
    use super::*;

    fn tails(sizes: impl Fn(usize) -> f64) -> SeriesTails {
        let nodes = chebyshev::nodes(12);
        let samples = Array2::from_shape_fn((12, 1), |(i, _)| {
            let mut values = [0.0; 12];
            chebyshev::values(nodes[i], &mut values);
            values.iter().enumerate().map(|(k, t)| sizes(k) * t).sum()
        });
        let mut tails = SeriesTails::of_polynomials(12, 1e-3);
        tails.add(samples.view(), Array2::ones((12, 1)).view());
        tails
    }

    #[test]
    fn coefficients_that_fall_need_as_many_terms_as_exceed_what_is_allowed() {
        let falling = tails(|k| 0.1_f64.powi(k as i32));
        assert!((4..=5).contains(&falling.terms()));
        assert!(falling.excess() < 1e-6);
    }

    #[test]
    fn coefficients_that_do_not_fall_exceed_what_is_allowed() {
        let flat = tails(|_| 1.0);
        assert!(flat.terms() > 10 && flat.excess() > 500.0);
        assert_eq!(tails(|_| f64::NAN).excess(), f64::INFINITY);
    }
}
