//! What sixteen samples stand for, as places and sizes on a sky.
//!
//! In: how directions change to the next samples ([`Across`]). Out: for each sample its footprints
//! ([`LaneTaps`]) and what a sky gives on average over them.

use super::sixteen::{Mask, Numbers, Vectors, each, each_vector, lane, largest, mask, put};
use crate::{footprint::Footprint, lanes::LANES};
use glam::Vec3;

/// The changes to the next sample on the right and the next below, in each lane.
pub type Across = [Vectors; 2];

/// [`crate::footprint::Taps`] in each lane.
#[derive(Default)]
pub struct LaneTaps {
    /// The displacement of the first.
    first: Vectors,
    /// From each to the next: the longer axis of each.
    pub step: Vectors,
    /// How many.
    count: Numbers,
    /// How wide each is across `step`.
    pub width: Numbers,
}

impl LaneTaps {
    /// Of samples that change so, none longer than it is wide or than `longest` if it can be helped.
    #[inline(always)]
    pub fn of(across: &Across, longest: f32) -> Self {
        let mut to = Self::default();
        for l in 0..LANES {
            let across = [lane(&across[0], l), lane(&across[1], l)];
            let taps = Footprint { across }.taps(longest);
            put(&mut to.first, l, taps.first);
            put(&mut to.step, l, taps.step);
            to.count[l] = taps.count;
            to.width[l] = taps.width;
        }
        to
    }

    /// The length of the longest of all footprints that are `wanted`.
    #[inline(always)]
    pub fn longest(&self, wanted: &Mask) -> f32 {
        largest(&each(
            #[inline(always)]
            |l| {
                let length = self.count[l] * lane(&self.step, l).length();
                if wanted[l] { length } else { 0.0 }
            },
        ))
    }

    /// The mean of the `light` at the footprints around the directions `d`, in the lanes that are `wanted`;
    /// `light` is told which it is asked for.
    #[inline(always)]
    pub fn mean(
        &self,
        d: &Vectors,
        wanted: &Mask,
        light: impl Fn(&Vectors, &Mask) -> Vectors,
    ) -> Vectors {
        let counts = each(
            #[inline(always)]
            |l| if wanted[l] { self.count[l] } else { 0.0 },
        );
        let mut sum = Vectors::default();
        for i in 0..largest(&counts) as u32 {
            let i = i as f32;
            let places = each_vector(
                #[inline(always)]
                |l| {
                    let tap = lane(&self.first, l) + lane(&self.step, l) * i;
                    (lane(d, l) + tap).normalize_or(Vec3::X)
                },
            );
            let within = mask(
                #[inline(always)]
                |l| counts[l] > i,
            );
            add(&mut sum, &light(&places, &within), &within);
        }
        each_vector(
            #[inline(always)]
            |l| lane(&sum, l) / self.count[l],
        )
    }
}

/// Adds light in the lanes that are `wanted`.
#[inline(always)]
pub fn add(sum: &mut Vectors, light: &Vectors, wanted: &Mask) {
    for c in 0..3 {
        let old = sum[c];
        sum[c] = each(
            #[inline(always)]
            |l| old[l] + if wanted[l] { light[c][l] } else { 0.0 },
        );
    }
}
