//! Skies in the samples of a row, sixteen at a time.
//!
//! In: the exits and directions of a row of samples and of the rows above and below. Out: the
//! colours of those that see a sky. What a sample stands for is measured by the changes to the
//! pixels beside and below (or before, above) that leave through the same exit.

use crate::{
    expr::vectorised,
    render::{
        lanes::LANES,
        outcome::{Outcome, Seen},
        sky::{self, Across, Mask, Vectors, first, lane, mask},
        world::World,
    },
};
use glam::Vec3;
use ndarray::ArrayView2;

/// In place of an exit where no sky is seen.
const NONE: u32 = u32::MAX;

/// What a row of samples sees, number by number so that vectors of neighbours can be loaded. There
/// is a pixel that sees nothing before the first, and enough after the last.
pub(super) struct Line {
    /// Samples of one pixel.
    count: usize,
    exits: Vec<u32>,
    directions: [Vec<f32>; 3],
    surfaces: Vec<usize>,
}

impl Line {
    /// A row (column, sample), or the nothing around the picture.
    pub(super) fn new(
        world: &World,
        width: usize,
        count: usize,
        row: Option<ArrayView2<'_, Outcome>>,
    ) -> Self {
        let length = (width + 2) * count + LANES;
        let mut exits = vec![NONE; length];
        let [mut x, mut y, mut z] = std::array::from_fn(|_| vec![0.0; length]);
        let mut surfaces = Vec::new();
        for (i, outcome) in row.iter().flatten().enumerate() {
            let (exit, direction) = match outcome.seen {
                Seen::Surface(_) => {
                    surfaces.push(i);
                    continue;
                }
                Seen::Sky {
                    exit, direction, ..
                } => (exit, direction),
                // The same light everywhere: that of the last sky at its top.
                Seen::Nothing => (world.skies.len() as u32 - 1, Vec3::Z),
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

    /// The samples that see a surface.
    pub(super) fn surfaces(&self) -> impl Iterator<Item = usize> {
        self.surfaces.iter().copied()
    }

    /// Sixteen samples from `start` on, counted from the pixel before the first.
    #[inline(always)]
    fn sixteen(&self, start: usize) -> Sixteen {
        let mut exits = [NONE; LANES];
        exits.copy_from_slice(&self.exits[start..start + LANES]);
        let mut directions = [[0.0; LANES]; 3];
        for c in 0..3 {
            directions[c].copy_from_slice(&self.directions[c][start..start + LANES]);
        }
        Sixteen { exits, directions }
    }
}

/// The exits and directions of sixteen samples.
struct Sixteen {
    exits: [u32; LANES],
    directions: Vectors,
}

/// Colours skies.
pub(super) struct Skies<'w> {
    pub(super) world: &'w World,
    /// The angle of one pixel.
    pub(super) pixel: f32,
    /// The distance of samples, in pixels; 0 asks for points.
    pub(super) spacing: f32,
}

impl Skies<'_> {
    /// Colours the samples of the middle one of three rows that see a sky.
    pub(super) fn light(&self, lines: [&Line; 3], row: &mut [f32]) {
        vectorised(
            #[inline(always)]
            || {
                for (i, row) in row.chunks_mut(3 * LANES).enumerate() {
                    self.sixteen(lines, i * LANES, row);
                }
            },
        );
    }

    #[inline(always)]
    fn sixteen(&self, [above, line, below]: [&Line; 3], start: usize, row: &mut [f32]) {
        let count = line.count;
        let here = line.sixteen(start + count);
        let beside = [line.sixteen(start + 2 * count), line.sixteen(start)];
        let under = [below.sixteen(start + count), above.sixteen(start + count)];
        let mut rest = here.exits;
        rest[row.len() / 3..].fill(NONE);
        let mut pending = mask(
            #[inline(always)]
            |l| rest[l] != NONE,
        );
        if first(&pending).is_none() {
            return;
        }
        let across = self.across(&here, &beside, &under);
        while let Some(l) = first(&pending) {
            let exit = rest[l];
            let wanted = mask(
                #[inline(always)]
                |l| rest[l] == exit,
            );
            if let Some(sky) = &self.world.skies[exit as usize] {
                put(
                    row,
                    &wanted,
                    &sky.lights(&here.directions, &across, &wanted),
                );
            }
            pending = mask(
                #[inline(always)]
                |l| pending[l] & !wanted[l],
            );
        }
    }

    /// How the sky's direction changes from sample to sample, where those `beside` and `under` are
    /// the next and the one before.
    #[inline(always)]
    fn across(&self, here: &Sixteen, beside: &[Sixteen; 2], under: &[Sixteen; 2]) -> Across {
        let mut to = Across::default();
        for l in 0..LANES {
            let direction = lane(&here.directions, l);
            let right = change(here, beside, l);
            let down = change(here, under, l);
            let across = across(direction, right, down, self.pixel);
            for (to, across) in to.iter_mut().zip(across) {
                sky::put(to, l, across * self.spacing);
            }
        }
        to
    }
}

/// The change from lane `l` to the next or, turned round, to the one before, if either leaves
/// through the same exit.
#[inline(always)]
fn change(here: &Sixteen, [next, before]: &[Sixteen; 2], l: usize) -> (bool, Vec3) {
    let d = lane(&here.directions, l);
    let on = next.exits[l] == here.exits[l];
    let back = before.exits[l] == here.exits[l];
    let (ahead, behind) = (
        lane(&next.directions, l) - d,
        d - lane(&before.directions, l),
    );
    (on | back, if on { ahead } else { behind })
}

/// From the changes to the right and down, where there are any.
#[inline(always)]
fn across(d: Vec3, right: (bool, Vec3), down: (bool, Vec3), pixel: f32) -> [Vec3; 2] {
    let round = d.any_orthonormal_vector() * pixel;
    let one = if down.0 { down.1 } else { round };
    let one = if right.0 { right.1 } else { one };
    // One side alone tells the size, as if the picture were not sheared here.
    let other = d.cross(one);
    let two = right.0 & down.0;
    [one, if two { down.1 } else { other }]
}

/// Puts the colours of the lanes that are `wanted` in their places of `row`.
#[inline(always)]
fn put(row: &mut [f32], wanted: &Mask, light: &Vectors) {
    for (l, colour) in row.chunks_exact_mut(3).enumerate() {
        if wanted[l] {
            colour.copy_from_slice(&lane(light, l).to_array());
        }
    }
}
