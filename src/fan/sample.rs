//! Rays followed exactly and read off at given arc lengths: what tables are made from.
//!
//! In: rays and arc lengths. Out: an array (ray, arc length, channel) with four channels of the slope
//! that is stored ([`Lift::slope`]) and, from [`DISPLACEMENT`] on, four of the displacement that it
//! adds up to ([`Lift::displacement`]).
//!
//! [`Lift::slope`]: super::Lift::slope
//! [`Lift::displacement`]: super::Lift::displacement

use super::{FanSpace, Lift, Start};
use crate::{
    geodesic::{End, Ray, Settings, Sink, Step, follow},
    manifold::Carried,
};
use glam::{DVec3, DVec4};
use ndarray::{Array3, ArrayViewMut2, Axis};
use rayon::prelude::*;

/// Channels of a sample.
pub const CHANNELS: usize = 8;

/// The first channel of the displacement.
pub const DISPLACEMENT: usize = 4;

/// Rays handed to one thread at once: long enough to keep lanes full, short enough to share.
const BLOCK: usize = 512;

/// Follows `rays` (chart point, unit tangent) to the last of `lengths` (ascending, positive) and
/// samples them there. Exits are passed by; where the metric ends the last tangent is continued
/// straight in the chart. NaN only where the very start is singular.
pub fn sample(
    space: &FanSpace,
    tolerance: f64,
    rays: &[(DVec3, DVec3)],
    lengths: &[f64],
) -> Array3<f64> {
    let mut samples = Array3::from_elem((rays.len(), lengths.len(), CHANNELS), f64::NAN);
    let settings = Settings {
        tolerance,
        carried: Carried {
            frame: false,
            deviation: false,
        },
        events: false,
    };
    let farthest = lengths.last().copied().unwrap_or(0.0);
    samples
        .axis_chunks_iter_mut(Axis(0), BLOCK)
        .into_par_iter()
        .zip(rays.par_chunks(BLOCK))
        .for_each(|(mut samples, rays)| {
            let starts = rays.iter().map(|&(u, v)| space.lift().start(u, v));
            let mut sampler = Sampler {
                space,
                points: Vec::new(),
                starts: starts.collect(),
                lengths,
                next: vec![0; rays.len()],
                last: None,
                rows: samples.axis_iter_mut(Axis(0)).collect(),
            };
            let starts = rays.iter().map(|&(u, v)| Ray {
                u,
                v,
                length: farthest,
                spread: [DVec3::ZERO; 2],
            });
            sampler.points = sampler.starts.iter().map(|start| start.x).collect();
            follow(space.manifold(), settings, starts, &mut sampler);
        });
    samples
}

/// Arc length, point and tangent.
type Last = (f64, DVec3, DVec3);

struct Sampler<'a> {
    space: &'a FanSpace,
    starts: Vec<Start>,
    /// The last lifted point of each ray.
    points: Vec<DVec4>,
    lengths: &'a [f64],
    /// The next arc length to be sampled, for each ray.
    next: Vec<usize>,
    /// The end of the last step, if its ray has samples left.
    last: Option<Last>,
    rows: Vec<ArrayViewMut2<'a, f64>>,
}

impl Sampler<'_> {
    fn put(&mut self, ray: usize, u: DVec3, v: DVec3) {
        let at = self.next[ray];
        let (lift, start) = (self.space.lift(), &self.starts[ray]);
        let slope = lift.slope(start, u, v);
        self.points[ray] = lift.continued(u, self.points[ray]);
        let displacement = lift.displacement(start, self.points[ray], self.lengths[at]);
        let row = &mut self.rows[ray];
        for k in 0..4 {
            row[[at, k]] = slope[k];
            row[[at, DISPLACEMENT + k]] = displacement[k];
        }
        self.next[ray] += 1;
    }
}

impl Sink for Sampler<'_> {
    fn wants(&self, ray: usize, to: f64) -> bool {
        let next = self.lengths.get(self.next[ray]);
        // Turns are counted step by step.
        next.is_some_and(|s| *s <= to || self.space.lift() == Lift::Polar)
    }

    fn step(&mut self, ray: usize, step: &Step) {
        while let Some(&s) = self.lengths.get(self.next[ray])
            && s <= step.end
        {
            self.put(ray, step.position(s), step.tangent(s));
        }
        let (s, left) = (step.end, self.next[ray] < self.lengths.len());
        self.last = left.then(|| (s, step.position(s), step.tangent(s)));
        if let (Lift::Polar, Some((_, u, _))) = (self.space.lift(), self.last) {
            self.points[ray] = Lift::Polar.continued(u, self.points[ray]);
        }
    }

    fn end(&mut self, ray: usize, _: End, reached: f64, _: usize) {
        // The step before was this ray's, unless it never took one.
        let last = self.last.take().filter(|_| reached > 0.0);
        while let (Some(&s), Some((end, u, v))) = (self.lengths.get(self.next[ray]), last) {
            self.put(ray, u + v * (s - end), v);
        }
    }
}
