//! Series along lines through a box: how fast their coefficients fall.
//!
//! In: rays along a line, or along the arc length of a path. Out: [`SeriesTails`], which tell how many
//! terms the promise takes. Along a face of directions the series are Chebyshev polynomials. Around the
//! whole sphere they are sines and cosines: along its parallels, and, for the polar angle, around whole
//! meridians.

use geofan_bundle::{
    PlanRecord, Variables, chebyshev,
    measure::{Probe, probe, stored_settings, tangents_at_exits},
    rays::{BetweenEdges, CHANNELS, DISPLACEMENT, RaySpace, sample},
    spherical,
};
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
    pub fn tails(&self, allowed: f64) -> SeriesTails {
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
        plan: &PlanRecord,
        rays: &[(DVec3, DVec3)],
        (lengths, between): (&[f64], Option<BetweenEdges<'_>>),
    ) -> Self {
        let manifold = space.manifold();
        let tangents = rays
            .iter()
            .map(|&(u, d)| (u, manifold.local_frame(u).tangent(d)));
        let tangents: Vec<_> = tangents.collect();
        let values = sample(space, plan.tolerance, &tangents, (lengths, between));
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
        let settings = stored_settings(space, plan.tolerance);
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
    let lift = space.lift();
    for channel in space.channels() {
        let mut unit = [0.0; 4];
        unit[*channel] = 1.0;
        let change = lift.chart_change(probe.u, DVec4::from_array(unit));
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
