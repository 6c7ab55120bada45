//! Rays followed exactly and read off at given arc lengths: what tables are made from.
//!
//! In: rays and arc lengths. Out: an array (ray, arc length, channel) with four channels of
//! displacement ([`Lift::encode`]) and the quaternion x, y, z, w of the transported rotation, twisted
//! as the lift says.

use super::{FanSpace, Start};
use crate::{
    geodesic::{End, Ray, Settings, Sink, Step, follow},
    manifold::Carried,
};
use glam::DVec3;
use ndarray::{Array3, ArrayViewMut2, Axis};
use rayon::prelude::*;

/// Channels of a sample.
pub const CHANNELS: usize = 8;

/// The first channel of the rotation.
pub const ROTATION: usize = 4;

/// Rays handed to one thread at once: long enough to keep lanes full, short enough to share.
const BLOCK: usize = 512;

/// Follows `rays` (chart point, unit tangent) to the last of `lengths` (ascending, positive) and
/// samples them there. Exits are passed by; where the metric ends the last tangent is continued
/// straight in the chart. NaN only where the very start is singular.
pub fn sample(
    space: &FanSpace,
    tolerance: f64,
    frame: bool,
    rays: &[(DVec3, DVec3)],
    lengths: &[f64],
) -> Array3<f64> {
    let mut samples = Array3::from_elem((rays.len(), lengths.len(), CHANNELS), f64::NAN);
    let settings = Settings {
        tolerance,
        carried: Carried {
            frame,
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
            follow(space.manifold(), settings, starts, &mut sampler);
        });
    samples
}

/// Arc length, point, tangent and rotation.
type Last = (f64, DVec3, DVec3, [f64; 4]);

struct Sampler<'a> {
    space: &'a FanSpace,
    starts: Vec<Start>,
    lengths: &'a [f64],
    /// The next arc length to be sampled, for each ray.
    next: Vec<usize>,
    /// The end of the last step, if its ray has samples left.
    last: Option<Last>,
    rows: Vec<ArrayViewMut2<'a, f64>>,
}

impl Sampler<'_> {
    fn put(&mut self, ray: usize, u: DVec3, q: [f64; 4]) {
        let at = self.next[ray];
        let lift = self.space.lift();
        let displacement = lift.encode(&self.starts[ray], u, self.lengths[at]);
        let row = &mut self.rows[ray];
        for k in 0..4 {
            row[[at, k]] = displacement[k];
            row[[at, ROTATION + k]] = q[k];
        }
        self.next[ray] += 1;
    }

    /// The transported rotation, twisted, at `s`, of a sign that is continuous along the ray: the
    /// integrated quaternion's and the twist's are.
    fn quaternion(&self, step: &Step, s: f64) -> [f64; 4] {
        step.rotation(s).map_or([0.0, 0.0, 0.0, 1.0], |q| {
            (self.space.lift().twist(step.position(s)) * q).to_array()
        })
    }
}

impl Sink for Sampler<'_> {
    fn wants(&self, ray: usize, to: f64) -> bool {
        self.lengths.get(self.next[ray]).is_some_and(|s| *s <= to)
    }

    fn step(&mut self, ray: usize, step: &Step) {
        while let Some(&s) = self.lengths.get(self.next[ray])
            && s <= step.end
        {
            self.put(ray, step.position(s), self.quaternion(step, s));
        }
        let (s, left) = (step.end, self.next[ray] < self.lengths.len());
        self.last = left.then(|| {
            let q = self.quaternion(step, s);
            (s, step.position(s), step.tangent(s), q)
        });
    }

    fn end(&mut self, ray: usize, _: End, reached: f64, _: usize) {
        // The step before was this ray's, unless it never took one.
        let last = self.last.take().filter(|_| reached > 0.0);
        while let (Some(&s), Some((end, u, v, q))) = (self.lengths.get(self.next[ray]), last) {
            self.put(ray, u + v * (s - end), q);
        }
    }
}
