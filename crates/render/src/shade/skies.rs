//! Skies in the samples of a row, sixteen at a time.
//!
//! In: the exits and directions of a row of samples and of the rows above and below. Out: the
//! colours of those that see a sky. The footprint of a sample is measured by the changes to the
//! pixels beside and below (or before, above) that leave through the same exit.

use super::Shader;
use crate::{
    filter::Across,
    intersect::Seen,
    lanes::{LANES, Mask, SingleVectors, first, mask, single_lane, single_vector},
    world::World,
};
use geofan_expr::vectorised;
use glam::Vec3;
use ndarray::ArrayView2;

/// In place of an exit where no sky is seen.
const NONE: u32 = u32::MAX;

/// The skies that a row of samples sees, number by number so that vectors of neighbours can be loaded. There
/// is a pixel that sees nothing before the first, and enough after the last.
pub(super) struct SkyRow {
    /// Samples of one pixel.
    count: usize,
    exits: Vec<u32>,
    directions: [Vec<f32>; 3],
    surfaces: Vec<usize>,
}

impl SkyRow {
    /// Sorts a row (column, sample), or the nothing around the picture.
    pub(super) fn new(
        world: &World,
        width: usize,
        count: usize,
        row: Option<ArrayView2<'_, Seen>>,
    ) -> Self {
        let length = (width + 2) * count + LANES;
        let mut exits = vec![NONE; length];
        let [mut x, mut y, mut z] = std::array::from_fn(|_| vec![0.0; length]);
        let mut surfaces = Vec::new();
        for (i, seen) in row.iter().flatten().enumerate() {
            let (exit, direction) = match *seen {
                Seen::Surface(_) => {
                    surfaces.push(i);
                    continue;
                }
                Seen::Sky {
                    exit, direction, ..
                } => (exit, direction),
                // The same light everywhere: that of the last sky at its top.
                Seen::Nothing | Seen::Length | Seen::Singular => {
                    (world.skies.len() as u32 - 1, Vec3::Z)
                }
            };
            exits[count + i] = exit;
            [x[count + i], y[count + i], z[count + i]] = direction.to_array();
        }
        Self {
            count,
            exits,
            directions: [x, y, z],
            surfaces,
        }
    }

    /// Returns the samples that see a surface.
    pub(super) fn surfaces(&self) -> &[usize] {
        &self.surfaces
    }

    /// Returns sixteen samples from `start` on, counted from the pixel before the first.
    #[inline(always)]
    fn sixteen(&self, start: usize) -> Sixteen {
        let mut exits = [NONE; LANES];
        exits.copy_from_slice(&self.exits[start..start + LANES]);
        let mut directions = [[0.0; LANES]; 3];
        for c in 0..3 {
            directions[c].copy_from_slice(&self.directions[c][start..start + LANES]);
        }
        (exits, directions)
    }
}

/// The exits and directions of sixteen samples.
type Sixteen = ([u32; LANES], SingleVectors);

impl Shader<'_> {
    /// Colours the samples of the middle one of three rows that see a sky.
    pub(super) fn light_skies(&self, rows: [&SkyRow; 3], row: &mut [f32]) {
        vectorised(
            #[inline(always)]
            || {
                for (i, row) in row.chunks_mut(3 * LANES).enumerate() {
                    self.light_sixteen(rows, i * LANES, row);
                }
            },
        );
    }

    /// Colours sixteen of them from `start` on.
    #[inline(always)]
    fn light_sixteen(&self, [above, middle, below]: [&SkyRow; 3], start: usize, row: &mut [f32]) {
        // The samples, and those around them.
        let count = middle.count;
        let here = middle.sixteen(start + count);
        let beside = [middle.sixteen(start + 2 * count), middle.sixteen(start)];
        let under = [below.sixteen(start + count), above.sixteen(start + count)];
        let (mut rest, directions) = here;
        rest[row.len() / 3..].fill(NONE);
        let mut pending = mask(
            #[inline(always)]
            |l| rest[l] != NONE,
        );
        if first(&pending).is_none() {
            return;
        }
        // Sky by sky.
        let across = self.across(&here, &beside, &under);
        while let Some(l) = first(&pending) {
            let exit = rest[l];
            let wanted = mask(
                #[inline(always)]
                |l| rest[l] == exit,
            );
            if let Some(sky) = &self.world.skies[exit as usize] {
                put(row, &wanted, &sky.lights(&directions, &across, &wanted));
            }
            pending = mask(
                #[inline(always)]
                |l| pending[l] & !wanted[l],
            );
        }
    }

    /// Returns the change of the sky's direction from sample to sample, where those `beside` and `under` are
    /// the next and the one before.
    #[inline(always)]
    fn across(&self, here: &Sixteen, beside: &[Sixteen; 2], under: &[Sixteen; 2]) -> Across {
        let (to_right, right) = changes(here, beside);
        let (downward, down) = changes(here, under);
        let one = single_vector(
            #[inline(always)]
            |l| {
                let round = single_lane(&here.1, l).any_orthonormal_vector() * self.pixel;
                let either = if downward[l] {
                    single_lane(&down, l)
                } else {
                    round
                };
                let one = if to_right[l] {
                    single_lane(&right, l)
                } else {
                    either
                };
                one * self.spacing
            },
        );
        let two = single_vector(
            #[inline(always)]
            |l| {
                // One side alone tells the size, as if the picture were not sheared here.
                let other = single_lane(&here.1, l).cross(single_lane(&one, l));
                let down = single_lane(&down, l) * self.spacing;
                if to_right[l] & downward[l] {
                    down
                } else {
                    other
                }
            },
        );
        [one, two]
    }
}

/// Returns the changes from each lane to the next or, turned round, to the one before, in the lanes where
/// either leaves through the same exit.
#[inline(always)]
fn changes(here: &Sixteen, [next, before]: &[Sixteen; 2]) -> (Mask, SingleVectors) {
    let mut known = [false; LANES];
    let mut changes = SingleVectors::default();
    for l in 0..LANES {
        known[l] = (next.0[l] == here.0[l]) | (before.0[l] == here.0[l]);
    }
    for c in 0..3 {
        let (next_c, here_c, before_c) = (&next.1[c], &here.1[c], &before.1[c]);
        for l in 0..LANES {
            let (ahead, behind) = (next_c[l] - here_c[l], here_c[l] - before_c[l]);
            changes[c][l] = if next.0[l] == here.0[l] {
                ahead
            } else {
                behind
            };
        }
    }
    (known, changes)
}

/// Puts the colours of the lanes that are `wanted` in their places of `row`.
#[inline(always)]
fn put(row: &mut [f32], wanted: &Mask, light: &SingleVectors) {
    for (l, colour) in row.chunks_exact_mut(3).enumerate() {
        if wanted[l] {
            colour.copy_from_slice(&single_lane(light, l).to_array());
        }
    }
}
